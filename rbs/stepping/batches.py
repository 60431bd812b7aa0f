"""Contacts of many bodies, detected in batches, bitwise identical to one pair after the other.

The coursework detects and resolves the pairs i < j in order, so that each pair sees the corrections
of the earlier ones. Two pairs without a common movable body do not affect each other. Pairs are
therefore put into batches that preserve the order of pairs with a common body: the batch of a pair
follows the last batches of its two bodies. The pairs of a batch are processed together.

Corrections move bodies, so the pairs that can touch are not known beforehand. A pass is therefore
speculative. It processes the pairs that are near each other if every body has a margin. Afterwards
it searches for missed pairs: other pairs that overlap at the positions that sequential execution
would have had. If there are any, it rolls the positions back and repeats with larger margins.
"""

import itertools
from functools import lru_cache

import numpy as np

from rbs.geometry.arrays import find_sorted, indices, row_minima, take
from rbs.geometry.broadphase import grid_overlaps, overlap_limits, overlaps_of
from rbs.geometry.facets import Pairs, find_facets
from rbs.geometry.hulls import FEATURE_TOLERANCE, TOUCH_TOLERANCE
from rbs.geometry.patches import contact_points
from rbs.geometry.vectors import dot, norm
from rbs.stepping.kernels import shifts

# Least margin of a body, as a fraction of its radius. Corrections move most bodies less. More makes
# more candidate pairs; less misses more pairs.
LEAST_MARGIN = 0.01
# Margin of a body in the next step or pass, as a multiple of its displacement in this one. More
# makes more candidate pairs; less misses more pairs.
MARGIN_GROWTH = 1.3


def find_contacts(bodies):
    """Corrects the positions of bodies that touch; returns `(contacts, candidatePairs)`.

    contacts : `Contacts`; candidatePairs : number of pairs that the broad phase found
    """
    memory = memory_of(tuple(bodies.meshes))
    margin = np.maximum(LEAST_MARGIN * bodies.hulls.radius, MARGIN_GROWTH * memory.displacement)
    while True:
        attempt = Pass(bodies, margin, memory)
        contacts = attempt.run()
        memory.displacement = contacts.displacement
        if not attempt.has_missed(contacts):
            return contacts, len(attempt.keys)
        bodies.position[:] = attempt.start
        margin = np.maximum(margin, MARGIN_GROWTH * contacts.displacement)


class Memory:
    """Results about pairs that save time in the next step, without changing its result.

    keys : (P,), sorted; i · n + j for the pairs with nearby boxes
    axis : (3, P), axes of least penetration or of separation
    displacement : (n,), largest distance by which corrections moved each body in the step
    """

    def __init__(self, meshes):
        self.keys, self.axis = np.zeros(0, dtype=np.int64), np.zeros((3, 0))
        self.displacement = np.zeros(len(meshes))

    def axes(self, keys):
        """Returns the axes (3, P) for `CachedAxes`, zero for pairs that were not near."""
        if len(self.keys) == 0:
            return np.zeros((3, len(keys)))
        known = find_sorted(keys, self.keys)
        return np.where(known >= 0, take(self.axis, known, axis=1), 0.0)


# Memories of the present scenes.
memory_of = lru_cache(maxsize=4)(Memory)


class Pass:
    """One pass over the candidate pairs, in batches.

    It includes all pairs that touch as long as no body moves by more than its margin (n,).

    start : (3, n), positions before the pass
    keys, axis, gap : (Q,), i · n + j for the pairs with nearby boxes; (3, Q), axes of least
        penetration or of separation; (Q,), separations, -inf for pairs in the batches

    For the P pairs in the batches, sorted by batch and then in the order i < j:

    bodyPair : (2, P); rank : (P,), position in the order i < j
    starts : (B + 1,), start of each batch
    facets : `Facets`; facetPair : (K,), pair of each facet, and facetStart : (P,), first facet of
        each pair, both relative to the start of the batch
    invMasses : (2, P); t : (3, P), translations at which the facets were found
    apart : (P,), penetration below which a pair counts as separated; tolerance : (P,), see
        `contact_points`
    """

    def __init__(self, bodies, margin, memory):
        self.bodies, self.margin, self.start = bodies, margin, bodies.position.copy()
        radius = bodies.hulls.radius
        first, second = grid_overlaps(bodies.box - margin, bodies.isFixed)
        self.keys = first * len(radius) + second
        t = take(bodies.position, second, axis=1) - take(bodies.position, first, axis=1)
        pairs = Pairs(bodies.hulls, first, second, t).along(memory.axes(self.keys))
        pairMargin = margin[first] + margin[second]
        facets = find_facets(pairs, pairMargin)
        penetration, self.axis = facets.minimal_penetrations(t)
        memory.keys, memory.axis = self.keys, self.axis
        isNear = penetration >= -pairMargin
        size = radius[first] + radius[second]
        self.gap = np.where(isNear, -np.inf, -penetration - FEATURE_TOLERANCE * size)

        near = indices(isNear)
        self.rank, self.starts, batch = in_batches(first[near], second[near], bodies.isFixed)
        rows = near[self.rank]
        self.bodyPair = np.stack((first[rows], second[rows]))
        self.facets = facets.of_pairs(rows)
        begin = take(self.starts, batch)  # start of each pair's batch
        self.facetStart = self.facets.start[:-1] - self.facets.start[begin]
        self.facetPair = (np.arange(len(rows)) - begin).repeat(np.diff(self.facets.start))
        self.invMasses = take(bodies.invMass, self.bodyPair)
        self.t = take(t, rows, axis=1)
        self.apart, self.tolerance = -TOUCH_TOLERANCE * size[rows], FEATURE_TOLERANCE * size[rows]

    def run(self):
        """Detects the pairs batch by batch and separates those that touch: `Contacts`."""
        ends = itertools.pairwise(self.starts.tolist()) if len(self.rank) else [(0, 0)]
        return Contacts(self, itertools.starmap(self._resolve_batch, ends))

    def _resolve_batch(self, begin, end):
        """Separates the pairs from `begin` to `end` that touch; returns columns of `Contacts`.

        In order: pairs (H,), depth, normal, before, after, shift.
        """
        bodies, some = self.bodies, slice(begin, end)
        pairs = self.bodyPair[:, some]
        position = take(bodies.position, pairs, axis=1)
        penetration, normal = self._penetrations(begin, end, position[:, 1] - position[:, 0])
        touches = penetration >= self.apart[some]
        # hulls that overlap by more than rounding have overlapping boxes
        doubtful = indices(touches & (penetration <= self.tolerance[some]))
        if len(doubtful):
            box = bodies.box_at(pairs[:, doubtful], position[..., doubtful])
            touches[doubtful] = (box[:, 0] <= overlap_limits(box[:, 1])).all(axis=0)
        hits = indices(touches)
        depth, normal = np.maximum(take(penetration, hits), 0.0), take(normal, hits, axis=1)
        shift = shifts(take(self.invMasses[:, some], hits, axis=1), depth)
        before = take(position, hits, axis=2)
        after = before + shift * normal[:, None]
        bodies.position[:, take(pairs, hits, axis=1)] = after
        return hits + begin, depth, normal, before, after, shift[1]

    def _penetrations(self, begin, end, t):
        """`(penetration (m,), normal (3, m))` at the translations t, exact for pairs that touch."""
        facets, some = self.facets, slice(begin, end)
        columns = slice(facets.start[begin], facets.start[end])
        normals, pair = facets.normal[:, columns], self.facetPair[columns]
        penetrations = facets.offset[columns] - dot(normals, take(t, pair, axis=1))
        penetration, nearest = row_minima(penetrations, pair, self.facetStart[some])
        normal = take(normals, nearest, axis=1)
        isValid = facets.still_valid(some, penetration, t - self.t[:, some])
        stale = indices((penetration >= self.apart[some]) & ~isValid)
        if len(stale):
            some, t = self.bodyPair[:, begin + stale], t[:, stale]
            pairs = Pairs(self.bodies.hulls, *some, t).along(normal[:, stale])
            exact = find_facets(pairs, np.zeros(len(stale)))
            penetration[stale], normal[:, stale] = exact.minimal_penetrations(t)
        return penetration, normal

    def has_missed(self, contacts):
        """Whether a pair outside the batches overlaps at the positions of sequential execution."""
        bodies, displacement = self.bodies, contacts.displacement
        count = len(displacement)
        i, j = np.divmod(self.keys, count)
        # separated pairs whose bodies have moved far enough to close the gap
        met = (displacement[i] + displacement[j] >= self.gap) & (self.gap > -np.inf)
        keys, axis = self.keys[met], self.axis[:, met]
        beyond = indices(displacement > self.margin)
        if len(beyond):
            box = bodies.box - np.maximum(displacement, self.margin)
            others = overlaps_of(beyond, box, bodies.isFixed)
            others = others[find_sorted(others, self.keys) < 0]
            keys = np.concatenate((keys, others))
            axis = np.concatenate((axis, np.zeros((3, len(others)))), axis=1)
        first, second = np.divmod(keys, count)
        position1, position2 = contacts.positions_at_turn(first, second)
        limits = overlap_limits(bodies.box_at(second, position2))
        meet = indices((bodies.box_at(first, position1) <= limits).all(axis=0))
        if len(meet) == 0:
            return False
        first, second = first[meet], second[meet]
        t = take(position2 - position1, meet, axis=1)
        axes = take(axis, meet, axis=1)
        facets = find_facets(Pairs(bodies.hulls, first, second, t).along(axes), np.zeros(len(meet)))
        size = bodies.hulls.radius[first] + bodies.hulls.radius[second]
        return bool((facets.minimal_penetrations(t)[0] >= -TOUCH_TOLERANCE * size).any())


def in_batches(first, second, isFixed):
    """Assigns pairs to batches: `(order (P,), starts (B + 1,), batch (P,))`.

    The results are the order of processing, the start of each batch, and the batch of each pair in
    this order. The batch of a pair follows the last batches of its two bodies, so that pairs with a
    common movable body keep their order, and with it their results bit for bit.
    """
    isFixed = isFixed.tolist()
    last = [-1] * len(isFixed)
    batch = []
    for i, j in zip(first.tolist(), second.tolist(), strict=True):
        number = (last[i] if last[i] > last[j] else last[j]) + 1
        if not isFixed[i]:
            last[i] = number
        if not isFixed[j]:
            last[j] = number
        batch.append(number)
    batch = np.array(batch, dtype=np.intp)
    order = batch.argsort(kind="stable")
    batch = batch[order]
    return order, batch.searchsorted(np.arange(batch.max(initial=-1) + 2)), batch


class Contacts:
    """The H pairs that touched in a pass, in batches of their own, which are fewer and larger.

    starts : (B + 1,), start of each batch
    bodies : (2, H); rank : (H,), position in the order i < j
    depth : (H,), ≥ 0; normal : (3, H), unit, from the first body to the second
    before, after : (3, 2, H), positions of the bodies before and after the correction
    shift : (H,), displacement of the second body along the normal; tolerance : (H,), see
        `contact_points`
    displacement : (n,), largest distance of each body from its position before the pass
    """

    def __init__(self, attempt, found):
        """attempt : `Pass`; found : list of its results, batch by batch"""
        rows, *columns = (np.concatenate(column, axis=-1) for column in zip(*found, strict=True))
        inOrder = take(attempt.rank, rows).argsort()
        first, second = take(attempt.bodyPair, rows[inOrder], axis=1)
        order, self.starts, _ = in_batches(first, second, attempt.bodies.isFixed)
        order = inOrder[order]
        rows = rows[order]
        self.bodies = take(attempt.bodyPair, rows, axis=1)
        self.rank, self.tolerance = attempt.rank[rows], attempt.tolerance[rows]
        columns = (take(column, order, axis=-1) for column in columns)
        self.depth, self.normal, self.before, self.after, self.shift = columns

        start, count = attempt.start, attempt.start.shape[1]
        body, after = self.bodies.ravel(), self.after.reshape(3, -1)
        self.displacement = np.zeros(count)
        np.maximum.at(self.displacement, body, norm(after - take(start, body, axis=1)))
        # each body's start, and its positions after its contacts, in the order of its pairs
        keys = self._keys(self.bodies).ravel()
        keys = np.concatenate((np.arange(count) * count * count, keys))
        order = keys.argsort()
        self._known = keys[order]
        self._positions = take(np.concatenate((start, after), axis=1), order, axis=1)

    def _keys(self, pairs):
        """Keys (2, m) of both bodies' positions after the contacts of the pairs (2, m), ascending
        by body and then by pair."""
        count = len(self.displacement)
        return pairs * count * count + (pairs[0] * count + pairs[1] + 1)

    def positions_at_turn(self, first, second):
        """Positions (3, m), (3, m) of the pairs' bodies at their turn in sequential execution."""
        index = self._known.searchsorted(self._keys(np.stack((first, second)))) - 1
        return take(self._positions, index, axis=1).swapaxes(0, 1)

    def points(self, hulls):
        """Points (3, H) of the second bodies deepest inside the first ones before correction."""
        t = self.before[:, 1] - self.before[:, 0]
        point = contact_points(hulls, *self.bodies, t, self.normal, self.tolerance)
        return point + self.before[:, 1]

    def batches(self):
        """Slices of the contacts, one per batch, in order."""
        return itertools.starmap(slice, itertools.pairwise(self.starts.tolist()))
