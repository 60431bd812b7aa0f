"""Supports: planes beyond which a body cannot get, so that it meets others only along them.

Let a body touch another one, its support, with the outward normal m. What does not rise above that
support, seen along m, cannot be hit from the side: the support is in the way. The normal of such a
pair is therefore m. Otherwise, a box that slides over flush tiles would stop at the side of each.
How deep the body has sunk into its support does not matter, nor how it moves. Where the same holds
of each of the two bodies along planes that cross, they touch nowhere: a corner that has just left
one tile for the next cannot hit the first one's side.
"""

import numpy as np

from rbs.geometry.hulls import support_levels
from rbs.geometry.vectors import dot, indices, ranges, take

# Least angle between a pair's normal and a support's, as one minus its cosine. With more, balls
# with many faces stop at seams; with less, rounding counts.
LEAST_TURN = 1e-3
# Largest cosine of the angle between planes that cross. With more, a body has no contact with tiles
# that lean a little; with less, bodies that spin stop at seams between free blocks.
CROSSING = 0.5


def deferring(frames, ends, normal, asked):
    """`(normal (3, K), isContact (K,))` of K pairs that may touch: one that defers to a support
    takes over its normal, and one for which supports cross has no contact.

    ends : (2, C), bodies; the ground is body n. normal : (3, C), unit, from the first to the second
    asked : slice of the K of these that may defer

    A contact that may itself do so is no support. Of several, that along which the two approach
    least counts.
    """
    count = len(normal[0])
    body, base = np.concatenate((ends, ends[::-1]), axis=1)
    isMovable = ~np.append(frames.bodies.isFixed, True)
    some = indices(isMovable[body])
    some = some[body[some].argsort(kind="stable")]
    body, base, contact = take(body, some), take(base, some), some % count
    outward = take(normal, contact, axis=1) * np.where(some < count, -1.0, 1.0)
    perBody = np.bincount(body, minlength=frames.count + 1)
    start = perBody.cumsum() - perBody
    level = np.zeros(len(base))  # largest height of the base, from its COM
    some = indices(base < frames.count)
    level[some] = -support_levels(frames.hulls, base[some], -take(outward, some, axis=1))

    first, second, normal = *ends[:, asked], normal[:, asked]
    count = len(first)
    body, other = np.concatenate(((first, second), (second, first)), axis=1)
    row, column = ranges(take(start, body), take(perBody, body))
    i, j, base = take(body, row), take(other, row), take(base, column)
    m, level = take(outward, column, axis=1), take(level, column)
    t = take(frames.position, j, axis=1) - take(frames.position, base, axis=1)
    isBelow = dot(m, t) <= level
    some = indices(isBelow & (j != base) & (j < frames.count))
    row, column, i, j, base, level = (take(x, some) for x in (row, column, i, j, base, level))
    m, t = take(m, some, axis=1), take(t, some, axis=1)
    # seen along a normal that leans by LEAST_TURN, so that a slab that tilts does not rise
    slant = np.sqrt(2.0 * LEAST_TURN)  # the angle
    away = slant * take(normal, row % count, axis=1) * np.where(row < count, 1.0, -1.0)
    nearest, farthest = support_levels(
        frames.hulls, np.concatenate((j, j)), np.concatenate((away, away - m), axis=1)
    ).reshape(2, -1)
    height = dot(m, t) + nearest - farthest - level
    rise = dot(m, take(frames.glide, j, axis=1) - take(frames.glide, base, axis=1))
    # the support has sunk about as deep under the body as the body into it
    depth = take(frames.position, base, axis=1) - take(frames.position, i, axis=1)
    depth = level + dot(m, depth) - support_levels(frames.hulls, i, m)
    slack = frames.slop(i, j) + 2.0 * np.maximum(depth - frames.give, 0.0)
    some = indices(height + np.maximum(rise, 0.0) <= slack)
    row, column = take(row, some), take(column, some)
    m = take(m, some, axis=1) * np.where(row < count, -1.0, 1.0)
    row %= count
    isOther = dot(m, take(normal, row, axis=1)) < 1.0 - LEAST_TURN
    isFirm = np.ones(len(ends[0]), dtype=bool)
    isFirm[asked][row[isOther]] = False
    approach = take(frames.glide, first, axis=1) - take(frames.glide, second, axis=1)
    closing = np.maximum(dot(m, take(approach, row, axis=1)), 0.0)
    order = np.lexsort((closing, row))
    order = order[isFirm[contact[column[order]]]]
    leading, which = np.unique(row[order], return_index=True, return_inverse=True)[1:]
    best = order[leading]
    isCrossed = dot(take(m, order, axis=1), take(m, best[which], axis=1)) < CROSSING
    isContact, normal = np.ones(count, dtype=bool), normal.copy()
    isContact[row[order[isCrossed]]] = False
    best = best[isOther[best]]
    normal[:, row[best]] = take(m, best, axis=1)
    return normal, isContact
