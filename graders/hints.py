"""Which mistakes explain wrong numbers: tried out, and told only if they give those very numbers.

A mistake of the table `mistakes.md` is tried by computing what a program with it would give
(`rigidModel`), for all samples, alone and together with another one. One that comes out within the
graders' error bound of what the student has computed is a hint; there is no guessing from the size
of an error. Mistakes that change no number, such as a contact point that is not moved along the
normal, cannot be noticed.
"""

import itertools
from pathlib import Path
from typing import NamedTuple

import numpy as np
from gradingTools import ERROR_BOUND

# Mistakes that are tried together, at most.
MOST_TOGETHER = 2

# What is told where there is no mistake, and the data do not fit all the same.
OTHER_DATA = "these are the numbers of --convention {}, but not those of the data"

# The families of mistakes that a function can have beside its own.
SHARED = {
    "get_rotated_inv_IT": ("tensors",),
    "resolve_collision": ("weights", "impulses", "tensors", "pairs of tensors"),
    "resolve_position_constraint": ("weights",),
    "resolve_velocity_constraint": ("impulses", "tensors", "pairs of tensors"),
}


class Mistake(NamedTuple):
    """A row of the table. names : frozenset of str"""

    function: str
    group: str
    names: frozenset
    text: str


def read_table():
    """The rows of the table, a list of Mistake."""
    text = (Path(__file__).parent / "mistakes.md").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    cells = [line.strip("| ").split(" | ") for line in lines[1:]]
    return [Mistake(f, group, frozenset(n.split("; ")), told) for f, group, n, told in cells]


TABLE = read_table()


def mistakes_of(function):
    """The mistakes that can be made in a function, in the order in which they are tried."""
    families = (function, *SHARED.get(function, ()))
    return [one for family in families for one in TABLE if one.function == family]


def explain(function, outcomes, data):
    """What explains the wrong numbers of a function: dict from quantity to list of hints.

    outcomes : list of (Part, values) of the parts that call it; values : dict from quantity to what
        was computed, (n, w), NaN where nothing
    A mistake, or two, that explain all the quantities of all parts come first; then those that
    explain a part; then those that explain a single quantity.
    """
    judged = [_Judged(part, values, data) for part, values in outcomes]
    wrong = [key for one in judged for key in one.wrong]
    ofParts, ofQuantities = {}, {}
    if not wrong:
        return {}
    with np.errstate(all="ignore"):
        for texts, names in _trials(function, data):
            explainsAll = True
            for one in judged:
                # Two mistakes are many trials: the further parts only confirm what the first shows.
                if explainsAll or len(texts) < MOST_TOGETHER:
                    explained = one.explained(names)
                    isWhole = len(explained) == len(one.finite)
                    explainsAll &= isWhole
                    for key in filter(explained.__contains__, one.wrong):
                        (ofParts if isWhole else ofQuantities).setdefault(key, texts)
            if explainsAll:
                return dict.fromkeys(wrong, texts)
    return ofQuantities | ofParts


class _Judged:
    """The numbers of a part. finite : quantities with a number wherever there must be one; wrong :
    those of them that differ from what is expected"""

    def __init__(self, part, values, data):
        self._part, self._values, self._data = part, values, data
        self._samples = part.samples(data)
        self.finite = [
            key
            for key in part.shapes
            if np.isfinite(values[key][part.comparable(key, self._samples, values)]).all()
        ]
        right = self._agreeing(part.expected(data))
        self.wrong = [key for key in self.finite if key not in right]

    def explained(self, names):
        """The quantities that come out as computed if these mistakes are made."""
        return self._agreeing(self._part.after_mistakes(self._data, names))

    def _agreeing(self, others):
        agreeing = []
        for key in self.finite:
            some = self._part.comparable(key, self._samples, self._values, others)
            if np.all(np.abs(self._values[key] - others[key])[some] < ERROR_BOUND):
                agreeing.append(key)
        return agreeing


def _trials(function, data):
    """Yields (texts, names) of no mistake, of one, and of two, in the order of the table."""
    yield [OTHER_DATA.format(data["convention"])], frozenset()
    for count in range(1, MOST_TOGETHER + 1):
        for chosen in itertools.combinations(mistakes_of(function), count):
            if len({one.group for one in chosen}) == count:
                yield (
                    [one.text for one in chosen],
                    frozenset().union(*(one.names for one in chosen)),
                )
