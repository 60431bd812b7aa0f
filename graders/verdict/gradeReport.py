"""Compares results with the data: quantities and their errors, causes and hints, table, verdict."""

import functools
import math
from dataclasses import dataclass, field

import numpy as np
from reference import rigidModel
from reference.graderData import ERROR_BOUND, EXACT
from reference.rigidModel import inertia_of

from rbs.glass.model import INERTIA_DIVISOR, in_world_axes, rotation_matrices
from rbs.glass.trace import same
from rbs.scenes.messages import one_line
from verdict.hints import FRICTION, MISSING, PROPORTIONAL, acts_across, explain, right_by_chance

# By whether the data are the release's, and whether the tensor or its turn differs.
INERTIA_REMARKS = {
    (False, 0): "IT is six times too small, as in the released skeleton",
    (True, 0): "IT is right, but the data were made with the skeleton's, six times too small",
    (False, 1): "get_rotated_inv_IT gives Rᵀ I⁻¹ R, as in the release, but R I⁻¹ Rᵀ is right",
    (True, 1): "get_rotated_inv_IT gives R I⁻¹ Rᵀ, but the data were made with Rᵀ I⁻¹ R",
}
ALLOWED = "; the verdict allows for it"
UNSHAPED = "; hint: QExp returns (4,) for a body that does not spin: QExp(...).reshape(1, 4)"


@dataclass(frozen=True)
class Quantity:
    """One row of the table.

    part : name of its Part
    error : the largest error, NaN if a number is missing, None if nothing was compared; the number
        of differences if the quantity is a bool (isFlag)
    worst : the sample with the largest error, or None; count : number of samples compared
    share : the share of right samples if the others gave no number at all; otherwise 0 or 1. The
        lesser of those in the file and of the fresh ones
    """

    part: str
    name: str
    error: float | None
    isFlag: bool
    worst: int | None
    count: int
    isRight: bool
    share: float

    @property
    def function(self):
        return self.part.split()[0]

    def cells(self):
        if self.error is None:
            error = "-"
        elif math.isnan(self.error):
            error = "not a number"
        else:
            error = f"{int(self.error)} differ" if self.isFlag else f"{self.error:.3e}"
        sample = "-" if self.worst is None else str(self.worst)
        return self.name, error, sample, str(self.count), "" if self.isRight else "<-- wrong"


@dataclass
class Grade:
    """The outcome of one grader.

    title, remarks : head of the report; quantities : list of Quantity
    notes : list of (names of quantities or of the function, text): causes and hints
    """

    title: str
    remarks: list
    quantities: list = field(default_factory=list)
    notes: list = field(default_factory=list)

    @property
    def wrong(self):
        return [one for one in self.quantities if not one.isRight]

    @property
    def told(self):
        """The notes as texts, each of which begins with what it is about."""
        notes = self.notes
        return [one if one.startswith(what) else f"{what}: {one}" for what, one in notes]

    @property
    def largest_error(self):
        """The largest error of all quantities but bools; NaN if there is none."""
        errors = [q.error for q in self.quantities if q.error is not None and not q.isFlag]
        return max((error for error in errors if not math.isnan(error)), default=math.nan)

    def verdict(self):
        count, wrong = len(self.quantities), self.wrong
        if wrong:
            functions = ", ".join(dict.fromkeys(one.function for one in wrong))
            are = "is" if len(wrong) == 1 else "are"
            return f"FAIL: {len(wrong)} of {count} quantities {are} wrong, of {functions}"
        bound = f"{ERROR_BOUND:g}, largest error {self.largest_error:.3e}"
        return f"PASS: all {count} quantities below {bound}"

    def table(self):
        rows = [("quantity", "largest error", "at sample", "samples", "")]
        rows += [quantity.cells() for quantity in self.quantities]
        first, *others, _mark = (max(map(len, column)) for column in zip(*rows, strict=True))
        rows = [(name.ljust(first), *map(str.rjust, row, others), row[-1]) for name, *row in rows]
        return ["   ".join(row).rstrip() for row in rows]

    def lines(self, *blocks):
        """Returns the report: head, table, notes, further blocks of lines, and verdict."""
        head, lines = [self.title, *self.remarks], []
        for block in filter(None, (head, self.table(), self.told, *blocks)):
            lines += [*map(one_line, block), ""]
        return [*lines, self.verdict()]


def make_grade(grader, outcomes, data):
    """Returns the Grade of a grader's outcomes, a list of (Part, Results)."""
    remarks = [text for _, one in outcomes for text in one.remarks]
    data, told = matched(outcomes, data)
    remarks += told
    if data["convention"] != EXACT:
        remarks.append(f"data of the convention {data['convention']}")
    grade = Grade(grader.title, list(dict.fromkeys(remarks)))
    own = with_own_tensors(outcomes, data)
    for function in dict.fromkeys(part.function for part, _results in outcomes):
        some = [one for one in outcomes if one[0].function == function]
        _add_function(grade, function, some, data, own)
    return grade


def matched(outcomes, data):
    """Returns the data with the inertia of the graded class, and remarks.

    The skeleton's tensor is six times too small, which is not the student's work. How it is turned
    to world axes is; the release's way is admitted with the release's data or tensor.
    """
    given = next((one.inertia for _part, one in outcomes if one.inertia), [])
    if not given or all(part.call != "rotate_tensor" for part, _results in outcomes):
        return data, []
    usual, right = inertia_of(data), np.linalg.inv(data["solids"][2].tensor)
    isSmall = [same(given[0], factor * right) for factor in (1, INERTIA_DIVISOR)]
    if not any(isSmall):
        return data, []
    isTurned, R = usual[1], rotation_matrices(data["randomOrientations"][:1])[0]
    if len(given) > 1 and (isSmall[1] or usual[0]):
        ways = [same(given[1], in_world_axes(R, given[0], way)) for way in (False, True)]
        isTurned = ways[1] if any(ways) else isTurned
    inertia = isSmall[1], isTurned
    remarks = [INERTIA_REMARKS[usual[k], k] + ALLOWED for k in (0, 1) if inertia[k] != usual[k]]
    return data | {"inertia": inertia, "isOther": inertia != usual}, remarks


OWN = "resolve_collision is judged by the tensors that get_rotated_inv_IT gives"


def with_own_tensors(outcomes, data):
    """The data with the tensors of a student's get_rotated_inv_IT; None if they are ours."""
    for part, one in outcomes:
        if part.call == "rotate_tensor" and len(one.inertia) == 5:
            (key,) = part.shapes
            own = one.values[key]
            if np.abs(own - part.expected(data)[key]).max() >= ERROR_BOUND:  # false for NaN
                tensors = zip([(1, True), (1, False), (0, True)], one.inertia[2:], strict=True)
                own = own.reshape(-1, 3, 3) * rigidModel.tensor_unit(data)
                return data | {"ownTensor2": own, "ownTensors": dict(tensors), "isOther": True}
    return None


def _add_function(grade, function, outcomes, data, own):
    """Adds the quantities and notes of the parts that call a function.

    own : the data with the student's tensors, or None
    """
    fit = _Fit(function, outcomes, data)
    if own and function == "resolve_collision":
        fit = _better_fit(_Fit(function, outcomes, own), fit)
    if fit.data is own:
        grade.remarks.append(OWN)
    grade.quantities += fit.quantities
    grade.notes += _problem_notes(outcomes, fit.data) + _hint_notes(fit)


class _Fit:
    """How the numbers of a function's parts fit some data.

    quantities : list of Quantity; marks : the sum of their shares; wrong : names of those not right
    """

    def __init__(self, function, outcomes, data):
        self.function, self.outcomes, self.data = function, outcomes, data
        self.quantities = [
            _compared(part, key, results, data) for part, results in outcomes for key in part.shapes
        ]
        self.marks = sum(one.share for one in self.quantities)
        self.wrong = {one.name for one in self.quantities if not one.isRight}

    @functools.cached_property
    def hints(self):
        """The hints of `explain`, which takes seconds where it tries all and nothing explains."""
        values = [(part, results.values) for part, results in self.outcomes]
        return explain(self.function, values, self.data)

    @property
    def explained(self):
        """Names of the quantities that the hints explain."""
        return set().union(*self.hints.values())


def _better_fit(own, ours):
    """The one with more marks, or else with more that hints explain: ours if both are alike, but
    the student's own if all that is wrong is explained with it.
    """
    if own.marks != ours.marks:
        return max(own, ours, key=lambda fit: fit.marks)
    isAllExplained = bool(own.hints) and len(own.explained) == len(own.wrong)
    return own if isAllExplained or len(own.explained) > len(ours.explained) else ours


def _problem_notes(outcomes, data):
    """Notes on what kept quantities from being computed, one for each cause."""
    causes = {}
    for part, results in outcomes:
        tried = part.samples(data)
        for key, (cause, count, first) in results.problems.items():
            cause += UNSHAPED * _fails_unspun(part, results.values[key], data)
            where = f" (in {count} of {len(tried)} samples, first in {first})"
            where = where if count < len(tried) else ""
            causes.setdefault(cause, (where, []))[1].append(key)
    parts = [part for part, _results in outcomes]
    return [
        (_named(keys, parts, lambda shapes: shapes), cause + where)
        for cause, (where, keys) in causes.items()
    ]


def _hint_notes(fit):
    """Notes with the hints of a fit, each with what it explains."""
    parts, hints, notes = [part for part, _results in fit.outcomes], fit.hints, []
    if fit.function == "resolve_collision" and not hints:
        hints = {FRICTION: fit.wrong} if acts_across(fit.outcomes[0], fit.data) else {}
    for text, keys in hints.items():
        if text.endswith(PROPORTIONAL):
            what = "; ".join(keys)
        else:
            isAll = fit.wrong <= {*keys}
            what = fit.function if isAll else _named(keys, parts, fit.wrong.intersection)
        notes.append((what, text if text.startswith(MISSING) else f"hint: {text}"))
    return notes


def _fails_unspun(part, values, data):
    """Whether integrate_timestep fails for the bodies that do not spin, and for no others."""
    tried = part.samples(data)
    isUnspun = ~np.any(data["randomAngVelocities"][tried] != 0.0, axis=1)
    isMissing = np.isnan(values[tried]).any(axis=1)
    isAsked = part.function == "integrate_timestep" and isUnspun.any()
    return isAsked and np.array_equal(isMissing, isUnspun)


def _named(keys, parts, quantities):
    """The names of quantities, or of a part if they are all of its quantities."""
    names = []
    for part in parts:
        own = [key for key in part.shapes if key in keys]
        names += [part.name] if own and set(own) >= set(quantities(part.shapes)) else own
    return "; ".join(names)


def _compared(part, key, results, data):
    isFlag, hasProblem = part.shapes[key] == "bool", key in results.problems
    values, expected = results.values[key], part.expected(data)
    samples = part.samples(data)
    if len(samples) == 0 or hasProblem and not np.isfinite(values).any():
        return Quantity(part.name, key, None, isFlag, None, 0, not hasProblem, not hasProblem)
    # A NaN on either side makes its row's error NaN, which max and argmax put first.
    with np.errstate(all="ignore"):
        errors = np.abs(values - expected[key])[samples].max(axis=1)
    if isFlag:
        errors[np.isnan(errors)] = 1.0  # a missing flag is wrong
    error = float(errors.sum() if isFlag else errors.max())
    worst = int(samples[np.argmax(errors)]) if np.any(errors != 0) else None
    isRightAt, isMissing = errors < ERROR_BOUND, np.isnan(values[samples]).any(axis=1)
    isRight = bool(np.all(isRightAt)) and not hasProblem
    share = float(isRight)
    # half of the samples do not call resolve_collision
    if not isRight and part.function != "resolve_collision" and np.all(isRightAt | isMissing):
        isEarned, isFresh = ~right_by_chance(part, key, data)[samples], samples >= data["inFile"]
        some = [isEarned & isFresh, isEarned & ~isFresh]
        shares = [np.mean(isRightAt[one]) for one in some if one.any()]
        share = float(min(shares, default=np.mean(isRightAt)))
    return Quantity(part.name, key, error, isFlag, worst, len(samples), isRight, share)
