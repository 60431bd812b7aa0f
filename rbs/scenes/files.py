"""Files: text that is read line by line, files that are written whole, and checks of paths.

From the top: paths; `LineReader`, whose errors name file and line; `atomic_write`; signals, such as
Ctrl-C, held back.
"""

import errno
import io
import math
import os
import signal
import threading
from contextlib import ExitStack, contextmanager, suppress
from itertools import chain, count
from pathlib import Path

from rbs.scenes.messages import InputError, check_kind, counted, one_line, short

RECORDING_ENDINGS = (".h5", ".hdf5")
# Beginnings of files that bear the name of another kind, and what these files are.
STRAYS = {
    b"version https://git-lfs": "a pointer of Git LFS; git lfs pull fetches the file itself",
    b"<!doctype html": "a page of HTML",
    b"<html": "a page of HTML",
    b"\x1f\x8b": "a gzip archive; unpack it first",
    b"PK\x03\x04": "a ZIP archive; unpack it first",
}
# Byte-order marks of UTF-16.
UTF16_MARKS = b"\xff\xfe", b"\xfe\xff"


def check_path(path, what="a file"):
    """Raises TypeError unless this is the name of a file. what : kind of file, as `a video`"""
    check_kind(f"the name of {what}", path, str | os.PathLike, "a path")


def check_readable(path):
    """Raises OSError if this is a pipe or a device, which may never end."""
    if os.path.exists(path) and not (os.path.isfile(path) or os.path.isdir(path)):
        raise OSError(errno.EINVAL, "not a regular file", str(path))


def check_ending(path, endings, what):
    """Raises TypeError or ValueError unless the name of a file has one of these endings, in any
    case. what : kind of file
    """
    check_path(path, what)
    if Path(path).suffix.lower() not in endings:
        raise ValueError(f"the name of {what} must end in {' or '.join(endings)}, not '{path}'")


def plain_number(text, kind=int):
    """Returns the number that a text spells in plain digits. Raises ValueError for 1_000 or ٣."""
    if "_" in text or not text.isascii():
        raise ValueError(f"not a number: {text!r}")
    return kind(text)


class SceneError(InputError):
    """A file that cannot be used. The message reads "file:line: cause"."""

    def __init__(self, path, lineNumber, cause):
        """lineNumber : counted from 1, or None for the whole file"""
        place = f"{path}:{lineNumber}" if lineNumber else f"{path}"
        super().__init__(f"{place}: {cause}")


def read_content(path):
    """Returns the bytes of a file. Raises SceneError, also if it is one of STRAYS."""
    check_path(path)
    try:
        check_readable(path)
        content = Path(path).read_bytes()
    except (OSError, ValueError) as error:  # a NUL in the name raises ValueError
        raise SceneError(path, None, one_line(error)) from None
    begin = content[:100].lstrip().lower()
    for mark, what in STRAYS.items():
        if begin.startswith(mark.lower()):
            raise SceneError(path, None, f"this is {what}")
    return content


def read_text(path):
    """Returns the text of a UTF-8 file, without a byte-order mark. Raises SceneError.

    Characters of another encoding, such as Latin-1 in a comment, are replaced.
    """
    content = read_content(path)
    if content.startswith(UTF16_MARKS):
        raise SceneError(path, None, "this is UTF-16; save it as UTF-8")
    text = content.decode("utf-8-sig", "replace")
    if "\0" in text:
        raise SceneError(path, None, "not a text file")
    return text


class LineReader:
    """Reads the lines of a text file in order, split into fields.

    fieldsOf : function that splits a line into a list of str, by default at blanks

    A comment reaches from `#` to the end of the line. Blank lines, tabs, CR-LF and a byte-order
    mark make no difference. Numbers may have Fortran's exponents, as 1.5D+03. Errors are
    SceneErrors that name the file and the last line read.
    """

    def __init__(self, path, fieldsOf=lambda line: line.split("#", 1)[0].split(), text=None):
        """text : content of the file, or None to read it. Raises SceneError."""
        self.path, self.lineNumber, self._line = path, None, ""
        self._rest = []  # fields of the current line that `field` has not returned yet
        text = io.StringIO(read_text(path) if text is None else text, newline=None)
        lines = [(number, line, fieldsOf(line)) for number, line in enumerate(text, start=1)]
        # number, text and fields of the lines that are left and not blank, the last one first
        self._lines = [line for line in lines[::-1] if line[2]]
        if not self._lines:
            raise self.error("the file is empty")

    def error(self, cause):
        """Returns a SceneError for the current line, for the caller to raise."""
        return SceneError(self.path, self.lineNumber, cause)

    def at_end(self):
        """Returns whether all remaining lines are blank."""
        return not self._lines and not self._rest

    def row(self, what, columns=None):
        """Returns the fields of the next line, a list of str.

        what : name of the line, for errors
        Raises SceneError if the line is missing, or does not have `columns` fields.
        """
        if not self._lines:
            raise self.error(f"the file ends before {what}")
        self.lineNumber, self._line, fields = self._lines.pop()
        if columns is not None and len(fields) != columns:
            raise self.wrong_width(what, columns, fields)
        return fields

    def wrong_width(self, what, columns, fields):
        """Returns a SceneError for a line with too many or too few fields."""
        width, found = counted(columns, "column"), f"{len(fields)}: '{short(self._line)}'"
        return self.error(f"{what} must have {width}, not {found}")

    def field(self, what):
        """Returns the next field of a file that is a stream of them, on whichever line it stands.

        what : name of the field, for errors
        """
        if not self._rest:
            self._rest = self.row(what)[::-1]
        return self._rest.pop()

    def number(self, field, what, largest=math.inf):
        """Returns the float that `field` spells, finite and between -largest and largest."""
        try:
            value = plain_number(field.replace("D", "E").replace("d", "e"), float)
        except ValueError:
            raise self.error(f"{what} must be a number, not '{short(field)}'") from None
        if not math.isfinite(value):
            raise self.error(f"{what} must be finite, not '{short(field)}'")
        if abs(value) > largest:
            raise self.error(f"{what} must not exceed {largest:g}, but is '{short(field)}'")
        return value

    def numbers(self, fields, what, largest=math.inf):
        """Returns the floats that the fields spell, as `number` does."""
        return [self.number(field, what, largest) for field in fields]

    def integer(self, field, what, low=0, high=None):
        """Returns the whole number that `field` spells, between low and high."""
        try:
            value = plain_number(field)
        except ValueError:
            raise self.error(f"{what} must be a whole number, not '{short(field)}'") from None
        if value < low or (high is not None and value > high):
            allowed = f"{low} or more" if high is None else f"{low} to {high}"
            if high is not None and high - low < 2:
                allowed = " or ".join(map(str, range(low, high + 1)))
            raise self.error(f"{what} must be {allowed}, not {short(str(value))}")
        return value

    def expect_end(self, count, noun):
        """Raises SceneError unless the remaining lines are blank, after `count` of a noun."""
        if not self.at_end():
            self.row("the end")
            line, place = short(self._line), counted(count, noun)
            raise self.error(f"unexpected line after {place}: '{line}'")


def partial_path(path):
    """Makes an empty file to write to until it is whole, film.part.mp4 for film.mp4; its path.

    If there is one of that name, it is film.part2.mp4, and so on. A target that exists and is not a
    regular file, such as /dev/null or a pipe, is written in place and is its own partial path.
    Links are followed. Raises OSError, naming `path`.
    """
    target = Path(os.path.realpath(path))
    if os.path.isdir(target):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if os.path.exists(target) and not os.path.isfile(target):
        return target
    if not target.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, f"there is no folder {Path(path).parent}", str(path))
    for number in chain([""], count(2)):
        partial = target.with_name(f"{target.stem}.part{number}{target.suffix}")
        with suppress(FileExistsError), named_errors(path):
            open(partial, "x").close()
            return partial


def put_in_place(partial, path):
    """Renames a file from its partial path to `path`, replacing an old file.

    Raises OSError, naming `path`, also if somebody has removed the file.
    """
    target = Path(os.path.realpath(path))
    with named_errors(path):
        if partial != target:
            os.replace(partial, target)
        else:
            os.stat(target)


@contextmanager
def named_errors(path):
    """Makes an OSError name `path` instead of the partial path."""
    try:
        yield
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None


@contextmanager
def atomic_write(path):
    """Yields the path of a temporary file, which replaces `path` if no error is raised.

    Raises OSError, naming `path`. An old file of that name then stays as it was.
    """
    partial = partial_path(path)
    try:
        with named_errors(path):
            yield partial
        put_in_place(partial, path)
    finally:
        remove_partial(partial)


def remove_partial(partial):
    """Removes a partial file, if it is still there."""
    if partial.is_file():
        partial.unlink()


def check_outputs(outputs, inputs):
    """Checks the output files of a run before it begins.

    outputs : dict from the name of an option to its path
    inputs : paths of the files that the run reads

    Raises InputError if the run would overwrite an input, or write a file twice; OSError if a file
    cannot be written.
    """
    taken = {os.path.realpath(path): "this run reads it" for path in inputs}
    for option, path in outputs.items():
        target = os.path.realpath(path)
        if target in taken:
            raise InputError(f"{option} {path}: not written, because {taken[target]}")
        taken[target] = f"{option} writes it too"
    for path in outputs.values():
        remove_partial(partial_path(path))


# Their names for messages. Windows has no SIGHUP.
SIGNAL_NAMES = {
    getattr(signal, name): text
    for name, text in {"SIGINT": "Ctrl-C", "SIGTERM": "kill", "SIGHUP": "a hang-up"}.items()
    if hasattr(signal, name)
}


_noted = []  # signals that no `signals_kept` has passed on yet


@contextmanager
def signals_raised():
    """Makes kill and a hang-up raise KeyboardInterrupt, as Ctrl-C does, with the signal's number.

    Respects nohup.
    """

    def interrupt(number, frame):
        _noted.append(number)
        raise KeyboardInterrupt(number)

    with ExitStack() as stack:
        for number in SIGNAL_NAMES:
            if signal.getsignal(number) != signal.SIG_IGN or number == signal.SIGINT:
                stack.callback(signal.signal, number, signal.signal(number, interrupt))
        yield


@contextmanager
def signals_kept():
    """Raises KeyboardInterrupt for a signal in the `with` block that NumPy or a student's code has
    dropped, or made another error of.
    """
    try:
        yield
    except Exception:
        if not _noted:
            raise
    finally:
        numbers = _noted[:]
        _noted.clear()
    if numbers:
        raise KeyboardInterrupt(numbers[0])


@contextmanager
def interrupts_held():
    """Lets signals with a handler, such as Ctrl-C, act at the end of the `with` block, or at once
    the second time.
    """
    noted, handlers = [], {}

    def note(number, frame):
        noted.append(number)
        if len(noted) > 1:
            handlers[number](number, frame)

    isMain = threading.current_thread() is threading.main_thread()
    for number in SIGNAL_NAMES if isMain else ():
        if callable(handler := signal.getsignal(number)):
            handlers[number] = handler
            signal.signal(number, note)
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        if noted:
            handlers[noted[0]](noted[0], None)
