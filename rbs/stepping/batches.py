"""Contacts of many bodies, detected in batches, bitwise identical to one pair after the other.

The coursework detects and resolves the pairs i < j in order, so that each pair sees the corrections
of the earlier ones. Two pairs without a common movable body do not affect each other. Pairs are
therefore put into batches that preserve the order of pairs with a common body, and the pairs of a
batch are processed together.

Corrections move bodies, so the pairs that can touch are not known beforehand. A pass is therefore
speculative. It processes the pairs that are near each other if every body has a margin. If the
corrections then turn out to bring other pairs together, the positions are rolled back, and the pass
is repeated with larger margins.
"""

import itertools
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from rbs.geometry.arrays import find_sorted, indices, row_minima, take
from rbs.geometry.broadphase import grid_overlaps
from rbs.geometry.facets import Pairs, find_facets
from rbs.geometry.hulls import FEATURE_TOLERANCE, TOUCH_TOLERANCE
from rbs.geometry.vectors import dot, norm
from rbs.stepping.kernels import shifts

# Least margin of a body, as a fraction of its radius. Corrections move most bodies less. More makes
# more candidate pairs; less misses more pairs.
LEAST_MARGIN = 0.01
# Margin of a body in the next step or pass, as a multiple of its displacement in this one. More
# makes more candidate pairs; less misses more pairs.
MARGIN_GROWTH = 1.2
# Separation beyond the margins up to which a pair is processed, as a fraction of its size. More
# makes more batches; less misses more pairs.
NEAR = 0.05


def find_contacts(bodies):
    """Corrects the positions of bodies that touch: `(Contacts, number of candidate pairs)`."""
    memory, start = memory_of(tuple(bodies.meshes)), bodies.position.copy()
    margin = np.maximum(LEAST_MARGIN * bodies.hulls.radius, MARGIN_GROWTH * memory.displacement)
    while True:
        attempt = Pass(bodies, margin, memory)
        contacts = attempt.run()
        b, after = contacts.bodies.ravel(), contacts.after.reshape(3, -1)
        displacement = memory.displacement = np.zeros(len(margin))
        np.maximum.at(displacement, b, norm(after - take(start, b, axis=1)))
        if not attempt.has_missed(start, b, after, displacement):
            return contacts, len(attempt.keys)
        bodies.position[:] = start
        margin = np.maximum(margin, MARGIN_GROWTH * displacement)


class Memory:
    """Results of a step that save time in the next one, without changing its result.

    keys, axis : (P,), i · n + j for the pairs with nearby boxes, and (3, P), their axes of least
        penetration or of separation; keys are sorted
    displacement : (n,), largest distance by which corrections moved each body
    """

    def __init__(self, meshes):
        self.keys, self.axis = np.zeros(0, dtype=np.int64), np.zeros((3, 0))
        self.displacement = np.zeros(len(meshes))


# Memories of the present scenes.
memory_of = lru_cache(maxsize=4)(Memory)


class Pass:
    """One pass over the candidate pairs, in batches.

    It includes all pairs that touch as long as no body moves by more than its margin (n,).

    keys, gap : (Q,), i · n + j for the pairs with nearby boxes, and the distance that their bodies
        can move together without touching; inf for pairs in the batches

    For the P pairs in the batches, sorted by batch and then in the order i < j:

    bodyPair : (2, P); rank : (P,), position in the order i < j; size : (P,), sum of the radii
    starts : (B + 1,), start of each batch
    t : (3, P), translations at which the facets were found
    facets : `Facets`; facetPair : (K,), pair of each facet, and facetStart : (P,), first facet of
        each pair, both relative to the start of the batch
    """

    def __init__(self, bodies, margin, memory):
        self.bodies, self.margin = bodies, margin
        radius = bodies.hulls.radius
        first, second = grid_overlaps(bodies.box - margin, bodies.isFixed)
        self.keys = first * len(radius) + second
        t = take(bodies.position, second, axis=1) - take(bodies.position, first, axis=1)
        axes, known = np.zeros((3, len(t[0]))), find_sorted(self.keys, memory.keys)
        axes[:, known >= 0] = memory.axis[:, known[known >= 0]]
        pairs, pairMargin = Pairs(bodies.hulls, first, second, t), margin[first] + margin[second]
        facets = find_facets(pairs.along(axes), pairMargin)
        penetration, axes = facets.minimal_penetrations(t)
        memory.keys, memory.axis = self.keys, axes
        gap = -penetration - FEATURE_TOLERANCE * pairs.size
        isNear = gap <= pairMargin + NEAR * pairs.size
        self.gap = np.where(isNear, np.inf, gap)

        near = indices(isNear)  # pairs in the batches
        self.rank, self.starts = in_batches(first[near], second[near], bodies.isFixed)
        rows = near[self.rank]
        self.bodyPair, self.size = np.stack((first[rows], second[rows])), pairs.size[rows]
        self.t, self.facets = take(t, rows, axis=1), facets.of_pairs(rows)
        begin = self.starts[:-1].repeat(np.diff(self.starts))  # start of each pair's batch
        self.facetStart = self.facets.start[:-1] - self.facets.start[begin]
        self.facetPair = (np.arange(len(rows)) - begin).repeat(np.diff(self.facets.start))

    def run(self):
        """Detects the pairs batch by batch and separates those that touch: `Contacts`."""
        found = itertools.starmap(self._resolve_batch, itertools.pairwise(self.starts.tolist()))
        rows, *columns = (np.concatenate(column, axis=-1) for column in zip(*found, strict=True))
        inOrder = self.rank[rows].argsort()
        pairs = take(self.bodyPair, rows[inOrder], axis=1)
        order, starts = in_batches(*pairs, self.bodies.isFixed)
        rows = rows[inOrder[order]]
        columns = (take(column, inOrder[order], axis=-1) for column in columns)
        return Contacts(starts, self.rank[rows], take(pairs, order, axis=1), *columns)

    def _resolve_batch(self, begin, end):
        """Separates the pairs from `begin` to `end` that touch; returns columns of `Contacts`.

        In order: pairs (H,), depth, normal, before, after.
        """
        bodies, some = self.bodies, slice(begin, end)
        pairs = self.bodyPair[:, some]
        position = take(bodies.position, pairs, axis=1)
        penetration, normal = self._penetrations(begin, end, position[:, 1] - position[:, 0])
        touches = penetration >= -TOUCH_TOLERANCE * self.size[some]
        # hulls that overlap by more than rounding have overlapping boxes
        doubtful = indices(touches & (penetration <= FEATURE_TOLERANCE * self.size[some]))
        if len(doubtful):
            box = bodies.box_at(pairs[:, doubtful], position[..., doubtful])
            touches[doubtful] = (box[:3] <= -box[3:, ::-1]).all(axis=(0, 1))
        hits = indices(touches)
        depth, normal = np.maximum(take(penetration, hits), 0.0), take(normal, hits, axis=1)
        pairs, before = take(pairs, hits, axis=1), take(position, hits, axis=2)
        after = before + shifts(take(bodies.invMass, pairs), depth) * normal[:, None]
        bodies.position[:, pairs] = after
        return hits + begin, depth, normal, before, after

    def _penetrations(self, begin, end, t):
        """`(penetration (m,), normal (3, m))` at the translations t, exact for pairs that touch."""
        facets, some = self.facets, slice(begin, end)
        columns = slice(facets.start[begin], facets.start[end])
        normals, pair = facets.normal[:, columns], self.facetPair[columns]
        penetrations = facets.offset[columns] - dot(normals, take(t, pair, axis=1))
        penetration, nearest = row_minima(penetrations, pair, self.facetStart[some])
        normal = take(normals, nearest, axis=1)
        isValid = facets.still_valid(some, penetration, t - self.t[:, some])
        stale = indices((penetration >= -TOUCH_TOLERANCE * self.size[some]) & ~isValid)
        if len(stale):
            bodies, t = self.bodyPair[:, begin + stale], t[:, stale]
            pairs = Pairs(self.bodies.hulls, *bodies, t).along(normal[:, stale])
            exact = find_facets(pairs, np.zeros(len(stale)))
            penetration[stale], normal[:, stale] = exact.minimal_penetrations(t)
        return penetration, normal

    def has_missed(self, start, b, after, displacement):
        """Whether a pair outside the batches may have touched in sequential execution.

        start : (3, n), positions before the pass
        b, after : (M,), (3, M), positions of bodies after their contacts
        displacement : (n,), largest distance of each body from its position before the pass
        """
        # within the margins, only pairs in the batches can touch
        beyond = indices(displacement > self.margin)
        if len(beyond) == 0:
            return False
        # of each body, the box of all its positions
        box = self.bodies.box.copy()
        np.minimum.at(box, (slice(None), b), self.bodies.box_at(b, after))
        low, high = box[:3], -box[3:]
        meet = low[:, beyond, None] <= high[:, None]
        meet &= low[:, None] <= high[:, beyond, None]
        i, second = meet.all(axis=0).nonzero()
        some = indices(beyond[i] != second)
        first, second = beyond[i[some]], second[some]
        key = np.minimum(first, second) * len(displacement) + np.maximum(first, second)
        known = find_sorted(key, self.keys)
        gap = np.where(known < 0, 0.0, take(self.gap, known))
        way = displacement[first] + displacement[second]
        meet = indices(way >= gap)
        first, second = first[meet], second[meet]
        t = take(start, second, axis=1) - take(start, first, axis=1)
        pairs = Pairs(self.bodies.hulls, first, second, t).along()
        return bool((way[meet] >= -pairs.penetration - FEATURE_TOLERANCE * pairs.size).any())


def in_batches(first, second, isFixed):
    """Assigns pairs to batches: `(order (P,), starts (B + 1,))`, of processing and in this order.

    The batch of a pair follows the last batches of its two bodies, so that pairs with a common
    movable body keep their order. Without pairs, there is one empty batch.
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
    return order, batch[order].searchsorted(np.arange(batch.max(initial=0) + 2))


class Contacts(NamedTuple):
    """The H pairs that touched in a pass, in batches of their own, which are fewer and larger."""

    starts: np.ndarray  # (B + 1,), start of each batch
    rank: np.ndarray  # (H,), position in the order i < j
    bodies: np.ndarray  # (2, H)
    depth: np.ndarray  # (H,), ≥ 0
    normal: np.ndarray  # (3, H), unit, from the first body to the second
    before: np.ndarray  # (3, 2, H), positions of the bodies before the correction
    after: np.ndarray  # (3, 2, H), and after it
