"""What the program tells its user: every message is one line, fit for a terminal.

From the top: the error that input causes; printing; the pieces that messages are made of.
"""

import os
import sys
from contextlib import suppress
from pathlib import Path

# What every message on stderr begins with.
PROGRAM_NAME = "RigidBodySimulation.py"


class InputError(ValueError):
    """Something that came from outside and cannot be used; its message is one line."""

    def __init__(self, message):
        super().__init__(one_line(message))


def print_error(message):
    """Tells what is wrong, or worth knowing, in one line on stderr."""
    print(f"{PROGRAM_NAME}: {one_line(message)}", file=sys.stderr)


def print_note(message):
    """Tells what is worth knowing, unless it is empty or stderr cannot take it."""
    if message:
        with suppress(OSError):
            print_error(message)


def one_line(text, limit=None):
    """What an error or a file says, fit for one line, and for a terminal."""
    line = "".join(c if c.isprintable() else " " for c in str(text)[:limit])
    return line or type(text).__name__


def reason_of(error):
    """What an OSError says, in one line, without the number and the path that str(error) adds."""
    return one_line(getattr(error, "strerror", None) or error)


def short(*words, limit=40):
    """The words as one string that fits into an error line."""
    text = " ".join(words)
    return text if len(text) <= limit else text[: limit - 3] + "..."


def shown_path(path):
    """The path relative to the current folder where it lies in it, which is shorter to read."""
    try:
        return Path(os.path.realpath(path)).relative_to(Path.cwd())
    except ValueError:
        return Path(path)
