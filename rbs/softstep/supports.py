"""Supports: planes beyond which a body cannot get, so that it meets others only along them.

Let a body touch another one, its support, with the outward normal m. What does not rise above that
support, seen along m, cannot be hit from the side: the support is in the way. The normal of such a
pair is therefore m. Otherwise, a box that slides over flush tiles would stop at the side of each.
How deep the body has sunk into its support does not matter, nor how it moves. Where the same holds
of each of the two bodies along planes that cross, they touch nowhere: a corner that has just left
one tile for the next cannot hit the first one's side.
"""

import numpy as np

from rbs.geometry.lowest import supports
from rbs.geometry.vectors import dot, indices, ranges, take

# Depth up to which bodies touch, and height up to which one does not rise above a support, as a
# fraction of the lesser radius. Normals differ, and planes lean, by more than the angle at which a
# radius recedes by as much. With more, low steps stop nothing, and balls with many faces stop at
# seams; with less, unevenness does.
FLUSH = 2e-3


def deferring(frames, ends, normal, asked, heights):
    """`(normal (3, K), isContact (K,))` of K pairs that may touch: one that defers to a support
    takes over its normal, and one for which supports cross has no contact.

    ends : (2, C), bodies; the ground is body n. normal : (3, C), unit, from the first to the second
    asked : slice of the K of these that may defer
    heights : (2, V), of the planes of the first V of these, see `PlacedManifolds.heights`; the
        others meet along the normal of least penetration, and so with the ends of both bodies

    A contact that may itself defer is no support. Of several supports, the one along which the two
    approach least counts.
    """
    (first, second), count, hulls = ends, len(normal[0]), frames.hulls
    # each contact twice: the second body under the first, and the first under the second
    body, base = np.concatenate((ends, ends[::-1]), axis=1)
    outward, level = np.concatenate((-normal, normal), axis=1), np.zeros(2 * count)
    some = indices(np.tile(np.arange(count) >= len(heights[0]), 2) & (base < frames.count))
    level[some] = -supports(hulls, take(base, some), -take(outward, some, axis=1))[0]
    level.reshape(2, count)[:, : len(heights[0])] = heights[::-1]
    t = take(frames.position, second, axis=1) - take(frames.position, first, axis=1)
    depth = level[:count] + level[count:] - dot(normal, t)
    some = indices(~np.append(frames.bodies.isFixed, True)[body])
    some = some[body[some].argsort(kind="stable")]
    perBody = np.bincount(body[some], minlength=frames.count + 1)
    start = perBody.cumsum() - perBody

    first, second, normal = *ends[:, asked], normal[:, asked]
    body, other = np.concatenate(((first, second), (second, first)), axis=1)
    row, column = ranges(take(start, body), take(perBody, body))
    column, j = take(some, column), take(other, row)
    base, m = take(base, column), take(outward, column, axis=1)
    height = dot(m, take(frames.position, j, axis=1) - take(frames.position, base, axis=1))
    height -= take(level, column)
    some = indices((height <= 0.0) & (j != base))
    row, column, j, base, height = (take(x, some) for x in (row, column, j, base, height))
    m, contact = take(m, some, axis=1), column % count
    count = len(first)
    rise = dot(m, take(frames.glide, j, axis=1) - take(frames.glide, base, axis=1))
    # the support has sunk about as deep under the body as the body into it
    sunk = 2.0 * np.maximum(take(depth, contact), 0.0)
    slack = FLUSH * frames.sizes(take(body, row), j)[1] + sunk - np.maximum(rise, 0.0)
    slant = np.sqrt(2.0 * FLUSH)  # the angle
    # the extent of j, at least, seen along m and a normal that leans
    extent = (1.0 - slant) * take(frames.thickness, j) - slant * take(frames.radius, j)
    some, isContact = indices(height <= slack - extent), np.ones(count, dtype=bool)
    if len(some) == 0:
        return normal, isContact
    row, contact, j, height, slack = (take(x, some) for x in (row, contact, j, height, slack))
    m = take(m, some, axis=1)
    # seen along a normal that leans as much, so that a slab that tilts does not rise
    away = slant * take(normal, row % count, axis=1) * np.where(row < count, 1.0, -1.0)
    directions = np.concatenate((away, away - m), axis=1)
    nearest, farthest = supports(hulls, np.concatenate((j, j)), directions)[0].reshape(2, -1)
    some = indices(height + nearest - farthest <= slack)
    row, contact = take(row, some), take(contact, some)
    m = take(m, some, axis=1) * np.where(row < count, -1.0, 1.0)
    row %= count
    isOther = dot(m, take(normal, row, axis=1)) < 1.0 - FLUSH
    isFirm = np.ones(len(ends[0]), dtype=bool)
    isFirm[asked][row[isOther]] = False
    approach = take(frames.glide, first, axis=1) - take(frames.glide, second, axis=1)
    closing = np.maximum(dot(m, take(approach, row, axis=1)), 0.0)
    order = np.lexsort((closing, row))
    order = order[isFirm[contact[order]]]
    isBest = np.diff(row[order], prepend=-1) > 0
    best = order[isBest]
    isCrossed = dot(take(m, order, axis=1), take(m, best[isBest.cumsum() - 1], axis=1)) < slant
    isContact[row[order[isCrossed]]] = False
    best, normal = best[isOther[best]], normal.copy()
    normal[:, row[best]] = take(m, best, axis=1)
    return normal, isContact
