"""Reading text files line by line, with errors that name file and line.

From the top: `SceneError`; reading whole files; `LineReader`; parsing of numbers.
"""

import io
import math
import re

from rbs.scenes.files import read_bytes
from rbs.scenes.messages import InputError, one_line, short


class SceneError(InputError):
    """A file that cannot be used. The message reads "file:line: cause"."""

    def __init__(self, path, lineNumber, cause):
        """lineNumber : counted from 1, or None for the whole file"""
        place = f"{path}:{lineNumber}" if lineNumber else f"{path}"
        super().__init__(f"{place}: {cause}")


def read_content(path):
    """Returns the bytes of a file. Raises SceneError."""
    try:
        return read_bytes(path)
    except FileNotFoundError:
        raise SceneError(path, None, "no such file") from None
    except IsADirectoryError:
        raise SceneError(path, None, "a folder, not a file") from None
    except (OSError, ValueError) as error:  # a NUL in the name raises ValueError
        raise SceneError(path, None, f"cannot be read ({one_line(error)})") from None


def read_text(path):
    """Returns the text of a UTF-8 file, without a byte-order mark. Raises SceneError.

    In comments and quotes, characters of another encoding, such as Latin-1, become question marks.
    """
    text = read_content(path).decode("utf-8-sig", "surrogateescape")
    isForeign = not text.isascii() and re.search(r'(?m)^[^#"\n]*[\udc80-\udcff]', text)
    if "\0" in text or isForeign:
        raise SceneError(path, None, "not a text file")
    return text if text.isascii() else re.sub(r"[\udc80-\udcff]", "?", text)


class LineReader:
    """Reads the lines of a text file in order, split into fields.

    fieldsOf : function that splits a line into a list of str, by default at blanks

    A comment reaches from `#` to the end of the line. Blank lines, tabs, CR-LF and a byte-order
    mark make no difference. Numbers may have Fortran's exponents, as 1.5D+03. Errors are
    SceneErrors that name the file and the last line read.
    """

    def __init__(self, path, fieldsOf=lambda line: line.split("#", 1)[0].split(), text=None):
        """text : content of the file, or None to read it. Raises SceneError."""
        self.path = path
        self._fieldsOf = fieldsOf
        self.lineNumber = None
        self._rest = []  # fields of the current line that `field` has not returned yet
        # numbers and fields of the lines that are left and not blank, the last one first
        self._lines = list(self._split(read_text(path) if text is None else text))[::-1]
        if not self._lines:
            raise self.error("the file is empty")

    def _split(self, text):
        """Yields (line number, fields) of the lines that are not blank."""
        for number, line in enumerate(io.StringIO(text, newline=None), start=1):
            if fields := self._fieldsOf(line):
                yield number, fields

    def error(self, cause):
        """Returns a SceneError for the current line, for the caller to raise."""
        return SceneError(self.path, self.lineNumber, cause)

    def at_end(self):
        """Returns whether all remaining lines are blank."""
        return not self._lines and not self._rest

    def lines_left(self):
        """Returns how many lines follow that are not blank, or None within a line."""
        return None if self._rest else len(self._lines)

    def row(self, what, columns=None):
        """Returns the fields of the next line, a list of str.

        what : name of the line, for errors
        Raises SceneError if the line is missing, or does not have `columns` fields.
        """
        if not self._lines:
            raise self.error(f"the file ends before {what}")
        self.lineNumber, fields = self._lines.pop()
        if columns is not None and len(fields) != columns:
            width = "1 column" if columns == 1 else f"{columns} columns"
            raise self.error(f"{what} must have {width}, not {len(fields)}: '{short(*fields)}'")
        return fields

    def field(self, what):
        """Returns the next field of a file that is a stream of them, on whichever line it stands.

        what : name of the field, for errors
        """
        if not self._rest:
            self._rest = self.row(what)[::-1]
        return self._rest.pop()

    def count(self, what, low=0, kind=""):
        """Reads a line with one whole number ≥ low, the number of `what`. Returns the number.

        kind : kind of file that begins with this line, for errors
        """
        number = f"not {kind}: the number of {what}" if kind else f"the number of {what}"
        (field,) = self.row(number, columns=1)
        return self.integer(field, number, low)

    def rows(self, count, what, columns=None):
        """Yields the fields of the next `count` lines."""
        for index in range(count):
            yield self.row(f"{what} {index + 1} of {count}", columns)

    def number(self, field, what, largest=math.inf):
        """Returns the float that `field` spells, finite and between -largest and largest."""
        try:
            value = plain_float(field.replace("D", "E").replace("d", "e"))
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
        """Raises SceneError unless the remaining lines are blank. announced : as "3 bodies"."""
        if not self.at_end():
            fields = self._rest[::-1] or self.row("the end")
            raise self.error(f"unexpected line after {announced}: '{short(*fields)}'")


def plain_float(text):
    """Returns the float that a text spells. Raises ValueError, also for Python's 1_000."""
    if "_" in text or not text.isascii():
        raise ValueError(f"not a number: {text!r}")
    return float(text)


def plain_int(text):
    """Returns the whole number that a text spells. Raises ValueError, also for Python's 1_000."""
    if "_" in text or not text.isascii():
        raise ValueError(f"not a whole number: {text!r}")
    return int(text)
