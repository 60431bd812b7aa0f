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

# Depth up to which bodies touch, or sink in a substep if another sweep would stop it, and height up
# to which one does not rise above a support, as a fraction of the lesser radius. Normals differ,
# and planes lean, by more than the angle at which a radius recedes by as much. With more, low steps
# stop nothing, balls with many faces stop at seams, and fast heavy bodies press light ones into
# others; with less, unevenness stops what slides, and sweeps take more time.
FLUSH = 2e-3
# The angle at which a radius recedes by FLUSH of it, in radians.
SLANT = np.sqrt(2.0 * FLUSH)


def deferring(frames, ends, normal, asked, heights):
    """`(normal (3, K), isContact (K,))` of K pairs that may touch: one that defers to a support
    takes over its normal, and one for which supports cross has no contact.

    ends : (2, C), bodies; the ground is body n. normal : (3, C), unit, from the first to the second
    asked : slice of the K of these that may defer
    heights : (2, V), of the planes of the first V of these, see `PlacedManifolds.heights`; the
        others land on the ground

    A contact that may itself defer is no support. Of several supports, the one along which the two
    approach least counts.
    """
    planes, isFirm = _planes(frames, ends, normal, heights), np.ones(len(ends[0]), dtype=bool)
    ends, normal = ends[:, asked], normal[:, asked].copy()
    pair, contact, m = _in_the_way(frames, ends, normal, *planes)
    isOther = dot(m, take(normal, pair, axis=1)) < 1.0 - FLUSH
    isFirm[asked][pair[isOther]] = False
    approach = np.subtract(*take(frames.glide, ends, axis=1).swapaxes(0, 1))
    closing = np.maximum(dot(m, take(approach, pair, axis=1)), 0.0)
    order = np.lexsort((closing, pair))
    order = order[isFirm[contact[order]]]
    isBest = np.diff(pair[order], prepend=-1) > 0
    best, isContact = order[isBest], np.ones(len(normal[0]), dtype=bool)
    isCrossed = dot(take(m, order, axis=1), take(m, best[isBest.cumsum() - 1], axis=1)) < SLANT
    isContact[pair[order[isCrossed]]] = False
    best = best[isOther[best]]
    normal[:, pair[best]] = take(m, best, axis=1)
    return normal, isContact


def _planes(frames, ends, normal, heights):
    """`(body, base, outward (3, 2 C), level, depth)`, (2 C,) each, of C contacts: the planes along
    which the first bodies lie on the second, and then the second on the first.

    outward : from the base to the body; level : height over the base's COM; depth : of the contact
    ends, normal, heights : see `deferring`
    """
    (body, base), count = np.concatenate((ends, ends[::-1]), axis=1), len(ends[0])
    outward, level = np.concatenate((-normal, normal), axis=1), np.zeros(2 * count)
    landing = slice(count + len(heights[0]), 2 * count)
    level[landing] = -supports(frames.hulls, base[landing], -outward[:, landing])[0]
    level.reshape(2, count)[:, : len(heights[0])] = heights[::-1]
    depth = level[:count] + level[count:] - dot(normal, frames.translations(*ends))
    return body, base, outward, level, np.tile(depth, 2)


def _in_the_way(frames, ends, normal, body, base, outward, level, depth):
    """`(pair (Q,), contact (Q,), m (3, Q))`: contacts of one body of a pair beyond whose planes the
    other one does not rise, and their normals, from the first body of the pair to the second.

    ends, normal : (2, K), (3, K), of the pairs; body and so on : `_planes`
    """
    count, (own, other) = len(ends[0]), np.concatenate((ends, ends[::-1]), axis=1)
    # the planes along which movable bodies touch, body by body
    body = np.where(frames.bodies.invMass[body] > 0.0, body, frames.count)
    number = np.bincount(body)
    row, place = ranges(take(number.cumsum() - number, own), take(number, own))
    plane = take(body.argsort(kind="stable"), place)
    j, under, m = take(other, row), take(base, plane), take(outward, plane, axis=1)
    height = dot(m, take(frames.position, j, axis=1) - take(frames.position, under, axis=1))
    height -= take(level, plane)
    some = indices((height <= 0.0) & (j != under))
    row, plane, j, under, m, height = (take(x, some, -1) for x in (row, plane, j, under, m, height))
    rise = dot(m, take(frames.glide, j, axis=1) - take(frames.glide, under, axis=1))
    # the support has sunk about as deep under the body as the body into it
    sunk = 2.0 * np.maximum(take(depth, plane), 0.0)
    slack = FLUSH * frames.sizes(take(own, row), j)[1] + sunk - np.maximum(rise, 0.0)
    # the extent of j, at least, seen along m and a normal that leans
    extent = (1.0 - SLANT) * take(frames.thickness, j) - SLANT * take(frames.radius, j)
    some = indices(height <= slack - extent)
    row, plane, j, height, slack = (take(x, some) for x in (row, plane, j, height, slack))
    m, pair, sign = take(m, some, axis=1), row % count, np.where(row < count, 1.0, -1.0)
    # seen along a normal that leans as much, so that a slab that tilts does not rise
    away = SLANT * take(normal, pair, axis=1) * sign
    directions = np.concatenate((away, away - m), axis=1)
    nearest, farthest = supports(frames.hulls, np.tile(j, 2), directions)[0].reshape(2, -1)
    some = indices(height + nearest - farthest <= slack)
    return take(pair, some), take(plane, some) % (len(level) // 2), take(-sign * m, some, axis=1)
