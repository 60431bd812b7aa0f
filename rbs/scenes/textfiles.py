"""Text files, read line by line; whatever is wrong with one is told with file and line number.

From the top: the error; the reader; numbers as people write them.
"""

import io
import math

from rbs.scenes.files import read_bytes
from rbs.scenes.messages import InputError, reason_of, short


class SceneError(InputError):
    """A file, or a name of one, that cannot be used. Reads "file:line: cause" in one line."""

    def __init__(self, path, lineNumber, cause):
        """lineNumber : counted from 1, or None where the file as a whole is meant."""
        place = f"{path}:{lineNumber}" if lineNumber else f"{path}"
        super().__init__(f"{place}: {cause}")


def read_text(path):
    """Returns the text of a file in UTF-8, with or without a byte-order mark; raises SceneError."""
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except FileNotFoundError:
        raise SceneError(path, None, "there is no such file") from None
    except IsADirectoryError:
        raise SceneError(path, None, "this is a folder, not a file") from None
    except UnicodeDecodeError:
        raise SceneError(path, None, "this is not a text file") from None
    except (OSError, ValueError) as error:  # a ValueError for a NUL in the name
        raise SceneError(path, None, f"cannot be read ({reason_of(error)})") from None
    if "\0" in text:
        raise SceneError(path, None, "this is not a text file")
    return text


class LineReader:
    """The lines of a text file that hold something, split into fields, one after the other.

    fieldsOf : function that splits a line into a list of str; by default at blanks

    Anything from a `#` to the end of its line is a comment. Blank lines, tabs, CR-LF and a
    byte-order mark make no difference. Whatever is wrong is raised as a SceneError that names the
    file and the line read last.
    """

    def __init__(self, path, fieldsOf=lambda line: line.split("#", 1)[0].split(), text=None):
        """text : what the file holds, or None to read it; then raises SceneError."""
        self.path = path
        self._fieldsOf = fieldsOf
        self.lineNumber = None
        self._lines = self._split(read_text(path) if text is None else text)
        self._next = next(self._lines, None)
        if self._next is None:
            raise self.error("the file is empty")

    def _split(self, text):
        """Yields (line number, fields) of the lines with something in them, one at a time."""
        for number, line in enumerate(io.StringIO(text, newline=None), start=1):
            if fields := self._fieldsOf(line):
                yield number, fields

    def error(self, cause):
        """The SceneError that stands at the current line. To be raised by the caller."""
        return SceneError(self.path, self.lineNumber, cause)

    def at_end(self):
        """Whether no line with something in it is left."""
        return self._next is None

    def row(self, what, columns=None):
        """The fields of the next line, a list of str; as many as `columns`, if given.

        what : names the line in the error that is raised where it is missing or has another width
        """
        if self._next is None:
            raise self.error(f"the file ends before {what}")
        self.lineNumber, fields = self._next
        self._next = next(self._lines, None)
        if columns is not None and len(fields) != columns:
            width = "1 column" if columns == 1 else f"{columns} columns"
            raise self.error(f"{what} takes {width}, not {len(fields)}: '{short(*fields)}'")
        return fields

    def count(self, what, low=0, kind=""):
        """A line that holds nothing but a whole number ≥ low, the number of `what`.

        kind : what a file cannot be that begins otherwise, for the error
        """
        number = f"this is not {kind}: the number of {what}" if kind else f"the number of {what}"
        (field,) = self.row(number, columns=1)
        return self.integer(field, number, low)

    def rows(self, count, what, columns=None):
        """The next `count` lines as lists of fields, one at a time."""
        for index in range(count):
            yield self.row(f"{what} {index + 1} of {count}", columns)

    def number(self, field, what, largest=math.inf):
        """The finite float that `field` spells, between -largest and largest."""
        try:
            value = plain_float(field)
        except ValueError:
            raise self.error(f"{what} must be a number, not '{short(field)}'") from None
        if not math.isfinite(value):
            raise self.error(f"{what} must be finite, not '{short(field)}'")
        if abs(value) > largest:
            raise self.error(f"{what} must not exceed {largest:g}, as '{short(field)}' does")
        return value

    def numbers(self, fields, what, largest=math.inf):
        """The finite floats that the fields spell, as a list."""
        return [self.number(field, what, largest) for field in fields]

    def integer(self, field, what, low=0, high=None):
        """The whole number that `field` spells, low ≤ number and, if `high` is given, ≤ high."""
        try:
            value = plain_int(field)
        except ValueError:
            raise self.error(f"{what} must be a whole number, not '{short(field)}'") from None
        if value < low or (high is not None and value > high):
            allowed = f"between {low} and {high}"
            if high is None:
                allowed = f"at least {low}"
            elif high == low:
                allowed = f"{low}"
            raise self.error(f"{what} must be {allowed}, not {short(str(value))}")
        return value

    def expect_end(self, announced):
        """Raises unless all that is left is blank. `announced`: what the count had promised."""
        if not self.at_end():
            fields = self.row("the end")
            raise self.error(f"more lines than the {announced} announced: '{short(*fields)}'")


def plain_float(text):
    """The float that a text spells; ValueError for what only Python takes for one, as 1_000."""
    if "_" in text or not text.isascii():
        raise ValueError(f"not a number: {text!r}")
    return float(text)


def plain_int(text):
    """The whole number that a text spells; ValueError for what only Python takes for one."""
    if "_" in text or not text.isascii():
        raise ValueError(f"not a whole number: {text!r}")
    return int(text)
