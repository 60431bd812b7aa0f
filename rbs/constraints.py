"""A scene's constraints as columns, those that can be corrected at all; and anchors."""

import numpy as np

from rbs.arrays import indices
from rbs.vectors import divide, norm, sub

# When the two points of a constraint coincide, no direction separates them better than another:
# they are moved apart along this one.
COINCIDENT_DIRECTION = (0.0, 1.0, 0.0)


class ConstraintRows:
    """The constraints that a step has to look at, C of them.

    A constraint whose meshes are both fixed, or between two vertices of one mesh, is never
    corrected: no motion of the bodies changes its distance. Nor is a lower bound of no more than
    the tolerance, a rope's: every distance satisfies it.

    index : (C,), where each stands in the caller's list, whose length is `total`
    body1, vertex1, body2, vertex2 : (C,); refValue : (C,); upper : (C,) bool
    """

    def __init__(self, constraints, isFixed, vertexCount, tolerance):
        """constraints : rows `[m1, v1, m2, v2, refValue, upper]`; isFixed (n,) bool, vertexCount
        (n,) : of the meshes; raises ValueError, which names constraint, mesh and vertex"""
        self.total = len(constraints)
        table = _table(constraints)
        _check_ends(table, vertexCount)
        body1, vertex1, body2, vertex2 = table[:4].astype(np.intp)
        movable = (body1 != body2) & ~(isFixed[body1] & isFixed[body2])
        movable &= (table[5] != 0) | (table[4] > tolerance)
        self.index = indices(movable)
        self.body1, self.vertex1 = body1[movable], vertex1[movable]
        self.body2, self.vertex2 = body2[movable], vertex2[movable]
        self.refValue = table[4, movable]
        self.upper = table[5, movable] != 0

    def bodies(self):
        """The bodies that are constrained, in ascending order."""
        return np.unique(np.concatenate((self.body1, self.body2))).tolist()

    def anchored(self, arm):
        """Dict of each index: `(body1, body2, arm1, arm2, refValue, upper)`.

        arm : function of a body and a vertex of it, from the COM to it
        """
        columns = (self.index, self.body1, self.vertex1, self.body2, self.vertex2, self.refValue,
                   self.upper)  # fmt: skip
        return {
            c: (b1, b2, arm(b1, v1), arm(b2, v2), refValue, upper)
            for c, b1, v1, b2, v2, refValue, upper in zip(
                *(column.tolist() for column in columns), strict=True
            )
        }

    def movable_bodies(self, isFixed):
        """Dict of each index: the bodies of it that are not fixed."""
        ends = zip(self.index.tolist(), self.body1.tolist(), self.body2.tolist(), strict=True)
        return {c: [b for b in pair if not isFixed[b]] for c, *pair in ends}


def _table(constraints):
    """The rows as columns (6, C) of floats; a number may be an array that holds one."""
    if len(constraints) == 0:
        return np.zeros((6, 0))
    try:
        rows = np.array([tuple(row) for row in constraints], dtype=np.float64)
    except (TypeError, ValueError):  # arrays of one among numbers
        rows = np.array(
            [[np.asarray(value, dtype=np.float64).item() for value in row] for row in constraints]
        )
    if rows.ndim != 2 or rows.shape[1] != 6:
        raise ValueError("a constraint is a row of six: m1, v1, m2, v2, refValue, upper")
    return rows.T


def _check_ends(table, vertexCount):
    """Raises ValueError where a constraint names a mesh or a vertex that is not there."""
    for mesh, vertex in (table[0:2], table[2:4]):
        known = (mesh >= 0) & (mesh < len(vertexCount)) & (mesh == np.floor(mesh))
        count = vertexCount[np.where(known, mesh, 0).astype(np.intp)]
        fits = known & (vertex >= 0) & (vertex < count) & (vertex == np.floor(vertex))
        if not fits.all():
            c = int(fits.argmin())
            if not known[c]:
                raise ValueError(
                    f"constraint {c}: there is no mesh {mesh[c]:g}, only 0 to "
                    f"{len(vertexCount) - 1}"
                )
            raise ValueError(
                f"constraint {c}: mesh {mesh[c]:g} has no vertex {vertex[c]:g}, only 0 to "
                f"{count[c] - 1}"
            )
    if not np.isfinite(table[4]).all():
        c = int(np.isfinite(table[4]).argmin())
        raise ValueError(f"constraint {c}: the reference value must be finite")


class Anchor(tuple):
    """A point of a body in the world, three floats, that knows its exact arm from the COM.

    The difference of the point and the COM would lose the digits that the COM's distance from the
    origin takes up.
    """

    def __new__(cls, point, arm):
        anchor = super().__new__(cls, point)
        anchor.arm = arm
        return anchor


def distance_error(point1, point2, refValue):
    """`(C, n)` of a distance constraint: C = ‖p1 - p2‖ - refValue, n the unit vector of p1 - p2."""
    d = sub(point1, point2)
    length = norm(d)
    if isinstance(length, np.ndarray):
        safe = np.where(length > 0, length, 1.0)
        return length - refValue, np.where(length > 0, d / safe, np.array([COINCIDENT_DIRECTION]).T)
    if length == 0.0:
        return -refValue, COINCIDENT_DIRECTION
    return length - refValue, divide(d, length)
