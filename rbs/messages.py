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


class QuietStream:
    """Standard error, or nothing where it is closed or broken: no message is worth a run.

    As a text stream it has `write` and `flush`, which never raise. What standard error could not
    take is dropped, and it is not tried again: Python would try at its end, and fail.
    """

    def write(self, text):
        """Writes what can be written; returns its length, as a text stream does."""
        self._try(lambda: sys.stderr.write(text))
        return len(text)

    def flush(self):
        """Passes on what has been written, if it can be."""
        self._try(lambda: sys.stderr.flush())

    def isatty(self):
        """Whether a person watches."""
        try:
            return sys.stderr is not None and sys.stderr.isatty()
        except ValueError:  # it has been closed
            return False

    def fileno(self):
        """For those who ask how wide the terminal is."""
        return sys.stderr.fileno()

    @property
    def encoding(self):
        """Which signs there are."""
        return getattr(sys.stderr, "encoding", None) or "ascii"

    def _try(self, act):
        if sys.stderr is None:
            return
        try:
            act()
        except (OSError, ValueError):
            with suppress(OSError, ValueError):
                drop_stream(sys.stderr)


def drop_stream(stream):
    """Sends what a stream still holds, and is still to be given, to nowhere."""
    number = stream.fileno()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, number)
    os.close(nowhere)


def print_error(message):
    """Tells what is wrong, or worth knowing, in one line on stderr, if there is one."""
    stream = QuietStream()
    stream.write(f"{PROGRAM_NAME}: {one_line(message)}\n")
    stream.flush()


def print_note(message):
    """Tells what is worth knowing, unless it is empty."""
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
    """The path relative to the current folder where it lies in it, which is shorter to read."""
    try:
        return Path(os.path.realpath(path)).relative_to(Path.cwd())
    except (ValueError, OSError):  # it lies elsewhere, or the current folder has been deleted
        return Path(path)
