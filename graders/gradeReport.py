"""What comes of a grader: quantities with their errors, causes and hints; the table and verdict."""

import math
from dataclasses import dataclass, field

import numpy as np
from gradingTools import ERROR_BOUND, FAILED, PASSED
from hints import explain
from trials import comparable


@dataclass(frozen=True)
class Quantity:
    """One row of the table.

    part : name of the Part that it belongs to
    error : the largest error, NaN if a number is missing or not a number; None if nothing was
        compared. Of bools, the number that differ
    isFlag : whether it is one of bools; worst : the sample with the largest error, or None
    count : how many samples were compared; isRight : whether the quantity passes
    """

    part: str
    name: str
    error: float | None
    isFlag: bool
    worst: int | None
    count: int
    isRight: bool

    def cells(self):
        """The row as texts: name, error, sample, number of samples."""
        error = "-"
        if self.error is not None:
            error = f"{int(self.error)} differ" if self.isFlag else f"{self.error:.3e}"
            if math.isnan(self.error):
                error = "not a number"
        worst = "-" if self.worst is None else str(self.worst)
        return self.name, error, worst, str(self.count)


@dataclass
class Grade:
    """The outcome of one grader.

    title, remarks : for the head of the report; quantities : list of Quantity
    notes : list of (names of quantities or of what was called, text): causes and hints
    """

    title: str
    remarks: list
    quantities: list = field(default_factory=list)
    notes: list = field(default_factory=list)

    @property
    def failures(self):
        """Names of the quantities that do not pass."""
        return [quantity.name for quantity in self.quantities if not quantity.isRight]

    @property
    def largest_error(self):
        """Of all quantities but bools; NaN if all that there is is not a number."""
        errors = [q.error for q in self.quantities if q.error is not None and not q.isFlag]
        finite = [error for error in errors if not math.isnan(error)]
        return max(finite, default=math.nan if errors else 0.0)

    def verdict(self):
        """The last line of the report."""
        count = len(self.quantities)
        if self.failures:
            return (
                f"FAIL: {len(self.failures)} of {count} quantities are not below "
                f"{ERROR_BOUND:g}: {'; '.join(self.failures)}"
            )
        return (
            f"PASS: all {count} quantities below {ERROR_BOUND:g}, "
            f"largest error {self.largest_error:.3e}"
        )

    def table(self):
        """The lines of the table, columns three blanks apart."""
        rows = [("quantity", "largest error", "at sample", "samples")]
        rows += [quantity.cells() for quantity in self.quantities]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return [
            "   ".join(
                cell.rjust(width) if k else cell.ljust(width)
                for k, (cell, width) in enumerate(zip(row, widths, strict=True))
            )
            for row in rows
        ]

    def report(self):
        """Prints table, notes and verdict; returns PASSED or FAILED."""
        lines = [self.title, *self.remarks, "", *self.table(), ""]
        lines += [f"{what}: {text}" for what, text in self.notes]
        lines += [""] * bool(self.notes)
        print("\n".join([*lines, self.verdict()]))
        return FAILED if self.failures else PASSED


def make_grade(grader, outcomes, data):
    """The Grade of what has been computed.

    outcomes : list of (Part, Results)
    """
    grade = Grade(grader.title, grader.remarks(data))
    for part, results in outcomes:
        expected = part.expected(data)
        tried = part.samples(data)
        rows = [
            _compared(part, key, results, expected, comparable(
                part, key, results.values, expected, tried
            ))
            for key in part.shapes
        ]  # fmt: skip
        grade.quantities += rows
        causes = {}
        for key, (cause, count, first) in results.problems.items():
            if count < len(tried):
                cause += f" (in {count} of {len(tried)} samples, first in {first})"
            causes.setdefault(cause, []).append(key)
        grade.notes += _named(causes, part.name, part.shapes)
        wrong = [row.name for row in rows if not row.isRight]
        hints = {}
        for key, texts in explain(part, results.values, data).items():
            for text in texts:
                hints.setdefault(_marked(text), []).append(key)
        grade.notes += _named(hints, part.name, wrong)
    return grade


def _marked(text):
    """A hint as such; what is not implemented is no guess."""
    return text if text.startswith("not implemented") else f"hint: {text}"


def _named(notes, partName, quantities):
    """(names, text) of notes: the quantities' names, or the part's where it is about all of them.

    notes : dict from text to list of quantities
    """
    return [
        (partName if set(keys) >= set(quantities) else "; ".join(keys), text)
        for text, keys in notes.items()
    ]


def _compared(part, key, results, expected, samples):
    """The Quantity of one key, compared at these samples."""
    wanted = np.asarray(expected[key])
    isFlag = wanted.dtype == np.bool_
    if key in results.problems and not np.isfinite(results.values[key]).any():
        return Quantity(part.name, key, None, isFlag, None, 0, False)
    if len(samples) == 0:
        return Quantity(part.name, key, None, isFlag, None, 0, key not in results.problems)
    # A NaN on either side makes its row's error NaN, which max and argmax put first.
    with np.errstate(all="ignore"):
        errors = np.abs(results.values[key] - wanted.astype(float))[samples]
    errors = errors.reshape(len(samples), -1).max(axis=1)
    if isFlag:
        errors[np.isnan(errors)] = 1.0  # no answer is a wrong one
    error = errors.sum() if isFlag else errors.max()
    worst = int(samples[np.argmax(errors)]) if np.any(errors != 0) else None
    isRight = bool(np.all(errors < ERROR_BOUND)) and key not in results.problems
    return Quantity(part.name, key, float(error), isFlag, worst, len(samples), isRight)
