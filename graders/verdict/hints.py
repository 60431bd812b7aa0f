"""Finds mistakes that explain wrong numbers, by computing the numbers that they give.

Each row of the table in `rbs.glass.mistakes` is tried alone, and together with one other: a hint is
given if the edited formulas lead to the student's numbers in all samples, within the graders' error
bound. A mistake that changes no number cannot be found.
"""

import itertools
from contextlib import suppress

import numpy as np
from reference.graderData import ERROR_BOUND

from rbs.glass.mistakes import mistakes_of

# How the texts of mistakes begin that say that something is not implemented.
MISSING = "not implemented"
# The least change that a factor is told of: far above rounding.
LEAST_CHANGE = 1e-3
# Where so many mistakes explain the same numbers, all are told; where more do, none.
MOST_ALIKE = 2
# Samples on which two mistakes together are tried first.
FEW = 3


def stub_of(function):
    """The mistake that is to leave a function as its stub."""
    return next(one for one in mistakes_of(function) if function in one.stubOf)


def right_by_chance(part, key, data):
    """Where a quantity is right though nothing is written: bools of all samples."""
    expected = part.expected(data)[key]
    stub = part.after_mistakes(part.given(data), stub_of(part.function).edits)[key]
    return np.abs(stub - expected).max(axis=1) < ERROR_BOUND


PROPORTIONAL = ", in all samples"
FRICTION = "friction acts, though the call names no coefficient: its default must be 0"


def acts_across(outcome, data):
    """Whether velocities differ by an impulse across the normal: friction that is not asked for.

    outcome : (Part, Results) of `resolve_collision`
    """
    part, results = outcome
    hit, n, expected = data["isCollision"], data["intNormal"], part.expected(data)
    keys = [f"resultLinVelocities, mesh {k}" for k in (1, 2)]
    one, two = ((results.values[key] - expected[key])[hit] for key in keys)
    along = [np.sum(error * n[hit], axis=1) for error in (one, two)]
    return bool(np.all(np.abs(along) < ERROR_BOUND) and np.abs(two).max() > ERROR_BOUND)


def explain(function, outcomes, data):
    """Explains the wrong numbers of a function.

    One or two mistakes that explain all quantities of all parts, or else one that explains all of a
    part. Something that is not implemented explains all parts, or none. Where nothing explains a
    quantity, a factor does that is the same in all samples.

    outcomes : list of (Part, values) of the parts that call the function; values : dict from
        quantity to array (n, w), NaN where nothing was computed

    Returns a dict from hint to list of quantities.
    """
    judged = [_Judged(part, values, data) for part, values in outcomes]
    wrong = [key for one in judged for key in one.wrong]
    if not wrong:
        return {}
    with np.errstate(all="ignore"):
        rows = mistakes_of(function)
        fits = {row: [one.agrees(row.edits) for one in judged] for row in rows}
        whole = list(dict.fromkeys(row.text for row in rows if all(fits[row])))
        if whole:
            return {" - or ".join(whole): wrong} if len(whole) <= MOST_ALIKE else {}
        # A mistake of two changes nothing that is right.
        some = [row for row in rows if not any(one.spoils(row.edits) for one in judged)]
        for first, second in itertools.combinations(some, 2):
            edits = first.edits + second.edits
            isApart = not any(a in b or b in a for a, _ in first.edits for b, _ in second.edits)
            with suppress(Exception):  # two edits of one formula may make no sense together
                if not (isApart and all(one.agrees(edits, isQuick=True) for one in judged)):
                    continue
                if all(one.agrees(edits) for one in judged):
                    return {first.text: wrong, second.text: wrong}
        found = {}
        for k, one in enumerate(judged):
            texts = [row.text for row in rows if fits[row][k] and not row.text.startswith(MISSING)]
            texts = list(dict.fromkeys(texts))
            for key in one.wrong:
                isKnown = 0 < len(texts) <= MOST_ALIKE
                if text := " - or ".join(texts) if isKnown else one.tendency(key):
                    found.setdefault(text, []).append(key)
    return found


class _Judged:
    """A part's quantities: `finite` ones lack no number; of these, the `wrong` ones differ."""

    def __init__(self, part, values, data):
        samples, expected = part.samples(data), part.expected(data)
        self.part = part
        self._values = {key: values[key][samples] for key in part.shapes}
        self._expected = {key: expected[key][samples] for key in part.shapes}
        self.finite = [key for key, rows in self._values.items() if np.isfinite(rows).all()]
        self.wrong = [key for key in self.finite if self._differs(key, self._expected)]
        gaps = {key: np.abs(self._values[key] - self._expected[key]) for key in self.finite}
        isWrong = {key: gaps[key].max(axis=1) >= ERROR_BOUND for key in self.wrong}
        speeds = (self._values[key][rows] for key, rows in isWrong.items() if "elocities" in key)
        speeds = np.vstack([np.zeros((1, 3)), *speeds])
        self._most = float(np.abs(speeds).max()), float(np.linalg.norm(speeds, axis=1).max())
        # samples that are wrong exclude most mistakes
        few = np.flatnonzero([*isWrong.values(), np.full(len(samples), True)][0])[:FEW]
        self._all, self._few = (
            (part.given(data, samples[some]), some) for some in (np.arange(len(samples)), few)
        )

    def _differs(self, key, table, some=slice(None)):
        return not np.all(np.abs(self._values[key][some] - table[key]) < ERROR_BOUND)

    def agrees(self, edits, isQuick=False):
        """Whether formulas give the student's numbers; if isQuick, in a few samples."""
        given, some = self._few if isQuick else self._all
        table = self.part.after_mistakes(given, edits, self._most)
        return not any(self._differs(key, table, some) for key in self.finite)

    def spoils(self, edits):
        right = [key for key in self.finite if key not in self.wrong]
        table = self.part.after_mistakes(self._all[0], edits, self._most) if right else {}
        return any(self._differs(key, table) for key in right)

    def tendency(self, key):
        """What is true of a wrong quantity in all samples, as text; "" if samples differ in it."""
        if self.part.shapes[key] == "bool":
            return ""
        isTensor = self.part.call == "rotate_tensor"
        before = self.part.after_mistakes(self._all[0], stub_of(self.part.function).edits)[key]
        before = before * (not isTensor)
        theirs, right = self._values[key] - before, self._expected[key] - before
        if not np.abs(right).max(initial=0.0) > LEAST_CHANGE:
            return "" if "currVertices" in key else "changes, but must stay as it was"
        factor = np.sum(theirs * right) / np.sum(right * right)
        if np.all(np.abs(theirs - factor * right) < ERROR_BOUND * max(1.0, abs(factor))):
            if abs(factor) < ERROR_BOUND:
                return "stays as it was" + PROPORTIONAL
            does, should = ("is", "should be") if isTensor else ("changes by", "should")
            return f"{does} {round(factor, 6):g} times what it {should}{PROPORTIONAL}"
        if isTensor:
            theirs, right = theirs.reshape(-1, 3, 3), right.reshape(-1, 3, 3)
            if np.abs(theirs - np.swapaxes(theirs, 1, 2)).max() > ERROR_BOUND:
                return "your tensor is not symmetric, as R I⁻¹ Rᵀ is"
            gap = np.linalg.eigvalsh(theirs) - np.linalg.eigvalsh(right)
            if np.abs(gap).max() < ERROR_BOUND:
                return (
                    "your tensor has the right principal moments, but other axes: R is another one"
                )
            return "your tensor has other principal moments than I⁻¹, which no rotation R changes"
        return ""
