"""Parsing of command lines: a parser and types of values, each with errors of one line."""

import argparse
import re
from difflib import get_close_matches

from rbs.scenes.files import plain_number
from rbs.scenes.messages import one_line, short

# Largest number of steps, or of visits: more than time allows, and exact as a float.
MOST_STEPS = 10**15


class OneLineParser(argparse.ArgumentParser):
    """Reports an invalid command line in one line, without the usage that argparse adds."""

    def __init__(self, **options):
        super().__init__(**options)
        # several, too, as in --gravity -1,-9.8,0
        self._negative_number_matcher = re.compile("-[.]?[0-9]")

    def error(self, message):
        unknown = re.search(r"unrecognized arguments: (-[^ =]+)", message)
        similar = unknown and get_close_matches(unknown[1], self._option_string_actions, 1, 0.7)
        if similar and similar[0] != unknown[1]:  # which may stand after "--"
            message += f"; did you mean {similar[0]}?"
        self.exit(2, f"{self.prog}: {one_line(message)} (--help lists the options)\n")


def option_type(read):
    """Returns an argparse type that reports a ValueError of a function in its own words."""

    def parse(text):
        try:
            return read(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return parse


def number_type(kind, low, high=MOST_STEPS):
    """Returns an argparse type of numbers from low to high. kind : int or float"""

    def read(text):
        try:
            value = plain_number(text, kind)
        except ValueError:
            what = "whole number" if kind is int else "number"
            raise ValueError(f"'{short(text)}' is not a {what}") from None
        if not low <= value <= high:
            bound = f"{low} or more" if value < low else f"{high} or less"
            raise ValueError(f"must be {bound}, not {short(text)}")
        return value

    return option_type(read)


def path_of(text):
    """Returns a path as it is. Raises ValueError for "" and "-"."""
    if text in ("", "-"):
        raise ValueError(f"must be the name of a file or folder, not '{text}'")
    return text
