"""Parsing of command lines: a parser and types of values, each with errors of one line."""

import argparse
import re
import sys
from contextlib import suppress
from difflib import get_close_matches

from rbs.scenes.messages import one_line, short
from rbs.scenes.textfiles import plain_number

# Largest number of steps, or of visits: more than time allows, and exact as a float.
MOST_STEPS = 10**15
# The beginning of a negative number, or of several.
NUMBER = re.compile(r"-[\d.]")


class OneLineParser(argparse.ArgumentParser):
    """Reports an invalid command line in one line, without the usage that argparse adds."""

    def parse_args(self, args=None, namespace=None):
        words = []
        for word in map(str, sys.argv[1:] if args is None else args):
            isValue = words and re.fullmatch("--[^=]+", words[-1])
            if isValue and NUMBER.match(word):  # argparse takes some numbers for options
                words[-1] += f"={word}"
            else:
                words.append(word)
            if words[-1].startswith("--") and words[-1].endswith("=--"):  # argparse drops it
                self.error(f"argument {words[-1][:-3]}: '--' is not a value")
        return super().parse_args(words, namespace)

    def error(self, message):
        unknown = re.search(r"unrecognized arguments: (--[^ =]+)", message)
        similar = unknown and get_close_matches(unknown[1], self._option_string_actions, 1, 0.7)
        if similar and similar[0] != unknown[1]:  # which may stand after "--"
            message += f"; did you mean {similar[0]}?"
        self.exit(2, f"{self.prog}: {one_line(message)} (--help lists the options)\n")


def option_type(convert, check, kind):
    """Returns an argparse type with clear errors.

    convert : text -> value; check : value -> value; either may raise ValueError; kind : what the
        value is, for the message
    """

    def parse(text):
        try:
            value = convert(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"'{short(text)}' is not a {kind}") from None
        try:
            return check(value)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return parse


def at_least(low, high):
    """Returns a check that low ≤ number ≤ high."""

    def check(value):
        if not low <= value <= high:
            bound = f"{low} or more" if value < low else f"{high} or less"
            raise ValueError(f"must be {bound}, not {short(str(value))}")
        return value

    return check


def path_type(what, check=lambda path: path):
    """Returns an argparse type of paths. what : with an article; check : path -> path"""

    def checked(path):
        if not path:
            raise ValueError(f"the name of {what} must not be empty")
        if path == "-":
            raise ValueError(f"must name {what}; standard input and output cannot be used")
        return check(path)

    return option_type(str, checked, "path")


def setting_type(one):
    """Returns the argparse type of a Setting."""
    return option_type(str, one.parsed, "text")


def _own_parameters(text):
    """Returns a dict of NAME=VALUE,...: numbers, true, false, or texts. Raises ValueError."""
    found = {}
    for one in text.split(","):
        name, sign, value = one.partition("=")
        if not sign or not name.isidentifier():
            raise ValueError(f"'{short(one)}' is not NAME=VALUE")
        found[name] = {"true": True, "false": False}.get(value.lower(), value)
        for kind in (float, int):
            with suppress(ValueError):
                found[name] = kind(value)
    return found


OWN_PARAMETERS = option_type(str, _own_parameters, "parameter")
WHOLE_NUMBER = option_type(plain_number, at_least(0, MOST_STEPS), "whole number")
POSITIVE_NUMBER = option_type(plain_number, at_least(1, MOST_STEPS), "whole number")
PATH = path_type("a file or folder")
