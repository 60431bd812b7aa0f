"""Messages to the user, each one line; standard streams, and how a program begins."""

import os
import signal
import sys
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path

# The beginning of every message on stderr: the installed command, or the script.
COMMAND = "rigid-body-simulation"
PROGRAM_NAME = COMMAND if Path(sys.argv[0]).stem == COMMAND else "RigidBodySimulation.py"
# Prefixes of units, and their values.
PREFIXES = {"T": 1e12, "G": 1e9, "M": 1e6, "k": 1e3, "": 1.0}


def prepare():
    """Lets Ctrl-C end the program without a traceback, until its `main` begins."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    open_streams()


def open_streams():
    """Opens the standard streams that are closed, because the next pipe or file would get their
    numbers; and lets the others print what a terminal has no characters for.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        stream = getattr(sys, name)
        if stream is None:  # open takes the lowest number that is free
            setattr(sys, name, stream := open(os.devnull, mode))
            os.set_inheritable(stream.fileno(), True)
        elif hasattr(stream, "reconfigure"):  # a program that runs this one may replace them
            stream.reconfigure(errors="backslashreplace")


class InputError(ValueError):
    """Invalid input. The message is one line."""

    def __init__(self, message):
        super().__init__(one_line(message))


def import_optional(package, failure, Error):
    """Imports a package that the project does not require. Raises an Error that names the remedy.

    package : as pip calls it; failure : the beginning of the message
    """
    try:
        return import_module(package.replace("-", "_"))
    except ImportError:
        raise Error(
            f"{failure}: {package} is missing. Install it: {pip_install(package)}"
        ) from None


def pip_install(package):
    """Returns the command that installs a package for the Python that runs this, which need not be
    the one whose pip the terminal finds.
    """
    python = Path(sys.executable or "python")
    if python.is_relative_to(Path.cwd()):
        python = python.relative_to(Path.cwd())
    python = f'"{python}"' if " " in str(python) else python
    return f"{python} -m pip install {package}"


def did_you_mean(text, known):
    """Returns the end of a message that names what is similar to a text, or ""."""
    similar = " or ".join(map(short, get_close_matches(text, known)))
    return f"; did you mean {similar}?" if similar else ""


def print_error(message):
    """Prints an exception or a note on stderr, if that is open, as one line, unless it is empty."""
    if message and sys.stderr is not None:
        print(f"{PROGRAM_NAME}: {cause_of(message)}", file=sys.stderr, flush=True)


def cause_of(error):
    """`one_line`, but an OSError begins with the name of its file."""
    place = f"{error.filename or 'cannot write'}: " if isinstance(error, OSError) else ""
    return place + one_line(error)


def one_line(text):
    """Returns a text, or the reason of an exception, as one printable line.

    That is the message of an OSError without its number and path. An exception without a message is
    named by its type.
    """
    if isinstance(text, MemoryError):
        return "not enough memory"
    if isinstance(text, FileExistsError):  # of what would make a folder
        return "a file, not a folder"
    if isinstance(text, IsADirectoryError):
        return "a folder, not a file"
    line = "".join(c if c.isprintable() else " " for c in str(getattr(text, "strerror", 0) or text))
    return line if line or isinstance(text, str) else type(text).__name__


def short(*words, limit=40):
    """Returns the words as one line of at most `limit` characters, with single blanks."""
    text = " ".join(" ".join(map(one_line, words)).split())
    return text if len(text) <= limit else text[: limit - 3] + "..."


def counted(count, noun):
    """Returns a count with its noun: 1 contact, 2 contacts, 3 bodies."""
    plural = noun[:-1] + "ies" if noun.endswith("y") else noun + "s"
    return f"{count} {noun if count == 1 else plural}"


def check_kind(name, value, kind, what):
    """Raises TypeError, naming an argument, unless it is of a type. what : the type in words"""
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not object):
        raise TypeError(f"{name} must be {what}, not {type(value).__name__}")


def prefix_of(value):
    """Returns the largest of PREFIXES that a value reaches; "" if it reaches none or is NaN."""
    return next((prefix for prefix, size in PREFIXES.items() if value >= size), "")


def measured(value, unit, digits=3):
    """Returns a quantity with its unit, to so many significant digits: 0.25 N, 1.6 kN."""
    prefix = prefix_of(abs(value))
    return f"{value / PREFIXES[prefix]:.{digits}g} {prefix}{unit}"


def shown_path(path):
    """Returns a path inside the current folder as a relative one, and others unchanged."""
    real = Path(os.path.realpath(path))
    return real.relative_to(Path.cwd()) if real.is_relative_to(Path.cwd()) else Path(path)
