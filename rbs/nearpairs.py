"""Near pairs: which pairs of bodies may touch in a step, remembered from one step to the next.

Bodies have fat boxes, as in Box2D's broad phase: a box holds its body, and what the body can reach
within a step, with a margin. Only where a body leaves its box are pairs looked for again. A pair
that has been found apart is not looked at until its bodies have come far enough to close the gap.
"""

import numpy as np

from rbs.arrays import find_sorted, indices, take
from rbs.broadphase import grid_overlaps, overlaps_of

# A fat box's margin: of the body's radius, and of what the body can reach within a step.
MARGIN = 0.05
MARGIN_STEPS = 2.0
# From this part of all boxes on, all pairs are looked for at once.
MANY = 0.2


class NearPairs:
    """P pairs of bodies whose fat boxes overlap, in the order i < j.

    fatBox : (6, n), as of `Bodies`; isFixed : (n,) bool
    path : (n,), how far points of each body have come since the start of the memory
    key : (P,), i · (n + 1) + j
    axis : (3, P), along which the pair was found apart, or penetrating; 0 where it is unknown
    gap : (P,), by how much it was found apart, -inf otherwise; mark (P,), the sum of the paths then
    """

    COLUMNS = ("fatBox", "isFixed", "path", "key", "axis", "gap", "mark")

    def __init__(self, **columns):
        for name in self.COLUMNS:
            setattr(self, name, columns[name])

    @classmethod
    def none(cls, count):
        return cls(
            fatBox=np.full((6, count), np.nan), isFixed=np.zeros(count, dtype=bool),
            path=np.zeros(count), key=np.zeros(0, dtype=np.int64), axis=np.zeros((3, 0)),
            gap=np.zeros(0), mark=np.zeros(0),
        )  # fmt: skip

    def resized(self, count):
        """The `NearPairs` of as many bodies: some more, or less, at the end of the list."""
        old = len(self.path)
        first, second = np.divmod(self.key, old + 1)
        left = indices(second < count)
        more = NearPairs.none(max(count - old, 0))
        columns = {
            name: np.concatenate((getattr(self, name)[..., :count], getattr(more, name)), axis=-1)
            for name in ("fatBox", "isFixed", "path")
        }
        for name in ("axis", "gap", "mark"):
            columns[name] = take(getattr(self, name), left, axis=-1)
        return NearPairs(key=first[left] * (count + 1) + second[left], **columns)

    def noted(self, asked, axis, gap, mark):
        """The same with what has been found out about the pairs `asked` (K,)."""
        columns = {name: getattr(self, name) for name in self.COLUMNS}
        for name, found in (("axis", axis), ("gap", gap), ("mark", mark)):
            columns[name] = columns[name].copy()
            columns[name][..., asked] = found
        return NearPairs(**columns)

    def updated(self, box, radius, isFixed, reach, path):
        """The `NearPairs` of this step; the present ones stay as they are.

        box : (6, n), at present; reach : (n,), how far a body can come within the step
        """
        count = len(radius)
        inside = box - reach >= self.fatBox
        inside |= np.isinf(box)
        isOut = ~inside.all(axis=0) | (isFixed != self.isFixed)
        out = indices(isOut)
        if len(out) == 0:
            return NearPairs(**{n: getattr(self, n) for n in self.COLUMNS} | {"path": path})
        fatBox = np.where(isOut, box - (MARGIN * radius + MARGIN_STEPS * reach), self.fatBox)
        if len(out) > MANY * count:
            first, second = grid_overlaps(fatBox, isFixed)
            key = first * (count + 1) + second
        else:
            first, second = np.divmod(self.key, count + 1)
            kept = self.key[~(isOut[first] | isOut[second])]
            first, second = np.divmod(overlaps_of(out, fatBox, isFixed), count)
            key = np.sort(np.concatenate((kept, first * (count + 1) + second)))
        known = find_sorted(key, self.key) if len(self.key) else np.full(len(key), -1)
        isKnown = known >= 0
        axis = np.zeros((3, len(key)))
        gap, mark = np.full(len(key), -np.inf), np.zeros(len(key))
        known = known[isKnown]
        axis[:, isKnown] = take(self.axis, known, axis=1)
        gap[isKnown], mark[isKnown] = self.gap[known], self.mark[known]
        return NearPairs(
            fatBox=fatBox, isFixed=isFixed.copy(), path=path, key=key, axis=axis, gap=gap, mark=mark
        )
