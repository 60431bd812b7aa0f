"""What the program tells its user: every message is one line, fit for a terminal.

From the top: the error that input causes; printing; the pieces that messages are made of.
"""

import os
import sys
from pathlib import Path

# What every message on stderr begins with.
PROGRAM_NAME = "RigidBodySimulation.py"


class InputError(ValueError):
    """Something that came from outside and cannot be used; its message is one line."""

    def __init__(self, message):
        super().__init__(one_line(message))


def print_error(message):
    """Prints one line on stderr: what is wrong, or worth knowing."""
    print(f"{PROGRAM_NAME}: {one_line(message)}", file=sys.stderr, flush=True)


def print_note(message):
    """Prints one line on stderr, unless it is empty."""
    if message:
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


def counted(count, noun):
    """So many of something: 1 contact, 2 contacts, 3 bodies."""
    plural = noun[:-1] + "ies" if noun.endswith("y") else noun + "s"
    return f"{count} {noun if count == 1 else plural}"


def shown_path(path):
    """Returns the path relative to the current folder if it lies in it, which is shorter."""
    real = Path(os.path.realpath(path))
    return real.relative_to(Path.cwd()) if real.is_relative_to(Path.cwd()) else Path(path)
