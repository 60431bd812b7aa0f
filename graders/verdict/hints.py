"""Finds mistakes that explain wrong numbers, by computing the numbers that they give.

Each mistake of the table `mistakes.md` is tried, alone and together with one other: `rigidModel`
computes the numbers of a program with it, for all samples. A hint is given if they are within the
graders' error bound of the student's numbers; sizes of errors do not count. A mistake that
changes no number cannot be found.
"""

import itertools
from pathlib import Path
from typing import NamedTuple

import numpy as np
from reference.graderData import ERROR_BOUND

# The number of mistakes that are tried together, at most. More finds more, but takes longer.
MOST_TOGETHER = 2

# Mistakes that cut numbers off, and the share of the wrong samples in which the last bit may decide
# how.
ROUNDED, MOST_ROUNDED = {"integer arms", "rounded arms", "J of integers"}, 0.15

# The families of mistakes that a function can have beside its own.
SHARED = {
    "get_rotated_inv_IT": ("tensors",),
    "resolve_collision": ("weights", "impulses", "tensors", "pairs of tensors"),
    "resolve_position_constraint": ("weights",),
    "resolve_velocity_constraint": ("impulses", "tensors", "pairs of tensors"),
}


class Mistake(NamedTuple):
    """A row of the table. names : frozenset of str, as `rigidModel` knows them"""

    function: str
    group: str
    names: frozenset
    text: str


_LINES = (Path(__file__).parent / "mistakes.md").read_text(encoding="utf-8").splitlines()
_ROWS = [line.strip("| ").split(" | ") for line in _LINES if line.startswith("| ")][1:]
# The rows of the table.
TABLE = [Mistake(f, group, frozenset(n.split("; ")), hint) for f, group, n, hint in _ROWS]


def mistakes_of(function):
    """The mistakes that can be made in a function, in the order in which they are tried."""
    families = (function, *SHARED.get(function, ()))
    return [one for family in families for one in TABLE if one.function == family]


def right_by_chance(part, key, data):
    """Where a quantity is right though nothing is written: bools of all samples."""
    stubs = [one for one in mistakes_of(part.function) if one.text.startswith("not implemented")]
    results, expected = [part.after_mistakes(data, one.names) for one in stubs], part.expected(data)
    isRight = np.full(len(expected[key]), bool(stubs))
    for one in results:
        isRight &= np.abs(one[key] - expected[key]).max(axis=1) < ERROR_BOUND
    return isRight


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

    One or two mistakes that explain all quantities of all parts come first, then those that explain
    a whole part, then those that explain a single quantity.

    outcomes : list of (Part, values) of the parts that call the function; values : dict from
        quantity to array (n, w), NaN where nothing was computed

    Returns a dict from quantity to list of hints.
    """
    judged = [_Judged(part, values, data) for part, values in outcomes]
    wrong = [key for one in judged for key in one.wrong]
    ofParts, ofQuantities = {}, {}
    if not wrong:
        return {}
    with np.errstate(all="ignore"):
        for texts, names in _trials(function):
            explainsAll, before = True, (dict(ofParts), dict(ofQuantities))
            for one in judged:
                # Saves time: pairs are tried on further parts only if they explain the first.
                if explainsAll or len(texts) < MOST_TOGETHER:
                    share = MOST_ROUNDED if names & ROUNDED else 0.0
                    explained = one.agreeing(one.part.after_mistakes(data, names), share)
                    isWhole = len(explained) == len(one.finite)
                    explainsAll &= isWhole
                    for key in filter(explained.__contains__, one.wrong):
                        (ofParts if isWhole else ofQuantities).setdefault(key, texts)
            if explainsAll:
                return dict.fromkeys(wrong, texts)
            if any(one.startswith("not implemented") for one in texts):  # some of it is
                ofParts, ofQuantities = before
    return ofQuantities | ofParts


class _Judged:
    """A part's quantities: `finite` ones lack no number; of these, the `wrong` ones differ."""

    def __init__(self, part, values, data):
        self.part, self._values, self._samples = part, values, part.samples(data)
        comparable = {key: part.comparable(key, self._samples, values) for key in part.shapes}
        self.finite = [
            key for key, some in comparable.items() if np.isfinite(values[key][some]).all()
        ]
        expected = part.expected(data)
        self._counts = {key: self._differing(key, expected) for key in self.finite}
        right = self.agreeing(expected)
        self.wrong = [key for key in self.finite if key not in right]

    def _differing(self, key, others):
        """At how many samples another table has other numbers."""
        some = self.part.comparable(key, self._samples, self._values, others)
        gaps = np.abs(self._values[key] - others[key])[some].max(axis=1, initial=0.0)
        return int(np.sum(~(gaps < ERROR_BOUND)))

    def agreeing(self, others, share=0.0):
        """The quantities whose numbers another table has, but for a share of the wrong ones."""
        return [
            key for key in self.finite if self._differing(key, others) <= share * self._counts[key]
        ]


def _trials(function):
    """Yields (texts, names) of one mistake, and of two, in the order of the table."""
    for count in range(1, MOST_TOGETHER + 1):
        for chosen in itertools.combinations(mistakes_of(function), count):
            if len({one.group for one in chosen}) == count:
                names = frozenset().union(*(one.names for one in chosen))
                yield [one.text for one in chosen], names
