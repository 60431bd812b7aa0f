"""What comes of a grader: quantities with their errors, causes and hints; the table and verdict."""

import math
from dataclasses import dataclass, field

import numpy as np
from gradingTools import ERROR_BOUND, FAILED, PASSED
from hints import explain


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
        if self.error is None:
            error = "-"
        elif math.isnan(self.error):
            error = "not a number"
        else:
            error = f"{int(self.error)} differ" if self.isFlag else f"{self.error:.3e}"
        return self.name, error, "-" if self.worst is None else str(self.worst), str(self.count)


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
        below, count, wrong = f"below {ERROR_BOUND:g}", len(self.quantities), self.failures
        if wrong:
            return f"FAIL: {len(wrong)} of {count} quantities are not {below}: {'; '.join(wrong)}"
        return f"PASS: all {count} quantities {below}, largest error {self.largest_error:.3e}"

    def table(self):
        """The lines of the table, columns three blanks apart."""
        rows = [("quantity", "largest error", "at sample", "samples")]
        rows += [quantity.cells() for quantity in self.quantities]
        first, *others = (max(map(len, column)) for column in zip(*rows, strict=True))
        return [
            "   ".join([name.ljust(first), *map(str.rjust, cells, others)]) for name, *cells in rows
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
    remarks = dict.fromkeys(text for _part, results in outcomes for text in results.remarks)
    grade = Grade(grader.title, [*grader.remarks(data), *remarks])
    for function in dict.fromkeys(part.function for part, _results in outcomes):
        _add_function(grade, function, [o for o in outcomes if o[0].function == function], data)
    return grade


def _add_function(grade, function, outcomes, data):
    """Adds the quantities and notes of the parts that call a function."""
    causes, wrong = {}, set()
    for part, results in outcomes:
        expected, tried = part.expected(data), part.samples(data)
        for key in part.shapes:
            samples = part.comparable(key, tried, results.values, expected)
            row = _compared(part, key, results, expected[key], samples)
            grade.quantities.append(row)
            wrong |= set() if row.isRight else {key}
        for key, (cause, count, first) in results.problems.items():
            where = f" (in {count} of {len(tried)} samples, first in {first})"
            where = where if count < len(tried) else ""
            causes.setdefault(cause, (where, []))[1].append(key)
    parts = [part for part, _results in outcomes]
    for cause, (where, keys) in causes.items():
        grade.notes.append((_named(keys, parts, lambda shapes: shapes), cause + where))
    hints = {}
    for key, texts in explain(function, [(p, r.values) for p, r in outcomes], data).items():
        for text in texts:
            hints.setdefault(text, set()).add(key)
    for text, keys in hints.items():
        known = text if text.startswith("not implemented") else f"hint: {text}"
        of = function if keys >= wrong else _named(keys, parts, wrong.intersection)
        grade.notes.append((of, known))


def _named(keys, parts, quantities):
    """Names of quantities, or of a part where it is about all of its quantities."""
    names = []
    for part in parts:
        own = [key for key in part.shapes if key in keys]
        names += [part.name] if own and set(own) >= set(quantities(part.shapes)) else own
    return "; ".join(names)


def _compared(part, key, results, wanted, samples):
    """The Quantity of one key, compared at these samples."""
    isFlag, hasProblem = part.shapes[key] is bool, key in results.problems
    values = results.values[key]
    if len(samples) == 0 or hasProblem and not np.isfinite(values).any():
        return Quantity(part.name, key, None, isFlag, None, 0, not hasProblem)
    # A NaN on either side makes its row's error NaN, which max and argmax put first.
    with np.errstate(all="ignore"):
        errors = np.abs(values - wanted)[samples].max(axis=1)
    if isFlag:
        errors[np.isnan(errors)] = 1.0  # no answer is a wrong one
    error = float(errors.sum() if isFlag else errors.max())
    worst = int(samples[np.argmax(errors)]) if np.any(errors != 0) else None
    isRight = bool(np.all(errors < ERROR_BOUND)) and not hasProblem
    return Quantity(part.name, key, error, isFlag, worst, len(samples), isRight)
