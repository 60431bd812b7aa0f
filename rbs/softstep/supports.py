"""Supports: planes beyond which a body cannot get, so that it meets others only along them.

Let a body touch another one, its support, with the outward normal m. What does not rise above that
support, seen along m, cannot be hit from the side: the support is in the way. The normal of such a
pair is therefore m. Otherwise, a box that slides over flush tiles would stop at the side of each.
How deep the body has sunk into its support does not matter, nor how it moves.
"""

import numpy as np

from rbs.geometry.hulls import support_levels
from rbs.geometry.vectors import cross, dot, indices, ranges, take

# Height up to which a body does not rise above a support, as a fraction of the lesser radius of the
# pair, beyond what contacts give by. With more, low steps stop nothing; with less, unevenness does.
FLUSH = 2e-3
# Largest depth in a support that counts, as a fraction of the same radius.
MOST_SUNK = 0.02
# Least angle between a pair's normal and a support's, as one minus its cosine. With more, balls
# with many faces stop at seams; with less, rounding counts.
LEAST_TURN = 1e-3
# Cosine of the angle between them from which a pair that is apart along its own normal still has a
# contact along the support's. With more, bodies that land on an edge sink in; with less, bodies are
# held beyond an edge.
SAME_SIDE = 0.95


class Supports:
    """S pairs of a movable body and a support of it, sorted by the body.

    base : (S,), the supports; the ground is body n
    contact : (S,), the contact of `deferring` that each is, or their number if it is none of them
    normal : (3, S), unit, towards the body
    level : (S,), largest height of the base along the normal, from its COM
    start, count : (n + 1,), first row of each body, and how many it has
    """

    def __init__(self, frames, body, base, contact, normal):
        """body, base, contact, normal : in any order"""
        some = indices(~frames.bodies.isFixed[np.minimum(body, frames.count - 1)])
        some = some[body[some].argsort(kind="stable")]
        self.frames, self.base, self.normal = frames, take(base, some), take(normal, some, axis=1)
        self.contact = take(contact, some)
        self.count = np.bincount(take(body, some), minlength=frames.count + 1)
        self.start = self.count.cumsum() - self.count
        self.level = np.zeros(len(some))
        some = indices(self.base < frames.count)
        bodies, normal = self.base[some], take(self.normal, some, axis=1)
        self.level[some] = -support_levels(frames.hulls, bodies, -normal)

    def deferring(self, first, second, normal, give):
        """`(row (K,), normal (3, K))` of those of P contacts that take over another normal.

        normal : (3, P), from the first body to the second, as that of the result; give : m, depth
            of a body at rest

        A contact that may itself do so is no support. Of several, that along which the two approach
        least counts, then that which the other body is farthest below.
        """
        frames, count = self.frames, len(first)
        body, other = np.concatenate(((first, second), (second, first)), axis=1)
        row, column = ranges(take(self.start, body), take(self.count, body))
        i, j, base = take(body, row), take(other, row), take(self.base, column)
        m, level = take(self.normal, column, axis=1), take(self.level, column)
        radius = take(np.minimum(frames.radius[body], frames.radius[other]), row)
        t = take(frames.position, j, axis=1) - take(frames.position, base, axis=1)
        # a ball about the COM already rises above most supports
        isBelow = dot(m, t) + take(frames.thickness, j) <= level + MOST_SUNK * radius + 2.0 * give
        some = indices(isBelow & (j != base) & (j < frames.count))
        columns = row, column, i, j, base, level, radius
        row, column, i, j, base, level, radius = (take(x, some) for x in columns)
        m, t = take(m, some, axis=1), take(t, some, axis=1)
        # points r of the other body rise above the base by (s + φ × r - S - Φ × (t + r)) · m
        turn = take(frames.spin, j, axis=1) - take(frames.spin, base, axis=1)
        shift = take(frames.glide, j, axis=1) - take(frames.glide, base, axis=1)
        shift -= cross(take(frames.spin, base, axis=1), t)
        now, later = -support_levels(
            frames.hulls, np.concatenate((j, j)), np.concatenate((-m, -m - cross(m, turn)), axis=1)
        ).reshape(2, -1)
        height, rise = dot(m, t) + now - level, np.maximum(later - now + dot(m, shift), 0.0)
        # the support has sunk about as deep under the body as the body into it
        depth = take(frames.position, base, axis=1) - take(frames.position, i, axis=1)
        depth = level + dot(m, depth) - support_levels(frames.hulls, i, m)
        slack = FLUSH * radius + np.clip(2.0 * depth, 2.0 * give, MOST_SUNK * radius + 2.0 * give)
        some = indices(height + rise <= slack)
        row, column, height = take(row, some), take(column, some), take(height, some)
        m = take(m, some, axis=1) * np.where(row < count, -1.0, 1.0)
        row %= count
        isOther = dot(m, take(normal, row, axis=1)) < 1.0 - LEAST_TURN
        isFirm = np.ones(count + 1, dtype=bool)
        isFirm[row[isOther]] = False
        approach = take(frames.glide, first, axis=1) - take(frames.glide, second, axis=1)
        closing = np.maximum(dot(m, take(approach, row, axis=1)), 0.0)
        order = np.lexsort((height, closing, row))
        order = order[isFirm[take(self.contact, column[order])]]
        best = order[np.unique(row[order], return_index=True)[1]]
        best = best[isOther[best]]
        return row[best], take(m, best, axis=1)
