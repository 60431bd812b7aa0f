"""Command lines of the graders: errors in one line. Needs nothing but Python."""

import argparse

from rbs.scenes.messages import one_line


class OneLineParser(argparse.ArgumentParser):
    """Reports an invalid command line in one line, without the usage that argparse adds."""

    def error(self, message):
        self.exit(2, f"{self.prog}: {one_line(message)} (--help lists the options)\n")


def between(kind, low, high):
    """Returns an argparse type: a number of a kind, int or float, from low to high."""

    def parse(text):
        try:
            value = kind(text)
        except ValueError:
            what = "whole number" if kind is int else "number"
            raise argparse.ArgumentTypeError(f"'{text[:40]}' is not a {what}") from None
        if not low <= value <= high:
            bound = f"{low} or more" if not value >= low else f"{high} or less"
            raise argparse.ArgumentTypeError(f"must be {bound}, not {str(value)[:40]}")
        return value

    return parse


def checked(parse):
    """Returns an argparse type of a function that raises ValueError."""

    def parsed(text):
        try:
            return parse(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return parsed
