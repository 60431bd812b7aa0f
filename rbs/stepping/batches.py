"""Contacts of many bodies: detected in batches, with the bits of one pair after the other.

The coursework detects and resolves the pairs i < j in that order, each seeing the corrections of
the earlier ones. Two pairs without a common body that can move do not see each other, so pairs are
put into batches that keep the order of those that do: a pair's batch is the one after the last
batches of its two bodies. Within a batch all pairs are looked at together.

Which pairs can touch is not known beforehand, since corrections move bodies. So a pass is
speculative: it takes the pairs that are near each other when every body has a margin. Afterwards,
pairs are looked for that it has missed: that touch where sequential execution would have had them.
If there are any, the positions are rolled back, and the pass is made again with larger margins.
"""

import itertools
from functools import lru_cache

import numpy as np

from rbs.geometry.arrays import find_sorted, indices, row_minima, take
from rbs.geometry.broadphase import grid_overlaps, overlap_limits, overlaps_of
from rbs.geometry.facets import CachedAxes, find_facets
from rbs.geometry.hulls import FEATURE_TOLERANCE, TOUCH_TOLERANCE
from rbs.geometry.patches import contact_points
from rbs.geometry.vectors import dot, norm
from rbs.stepping.kernels import shifts

# A body's margin at least, relative to its radius: corrections move most bodies less.
LEAST_MARGIN = 0.01
# A body gets this many times its displacement in one step as its margin in the next, or when the
# pass is made again. More of it makes more pairs near, less of it misses more.
MARGIN_GROWTH = 1.3


def find_contacts(bodies):
    """`(contacts, candidatePairs)`: corrects the positions of bodies that touch.

    contacts : `Contacts`; candidatePairs : how many pairs the broad phase has found
    """
    start, memory = bodies.position.copy(), memory_of(tuple(bodies.meshes))
    margin = np.maximum(LEAST_MARGIN * bodies.hulls.radius, MARGIN_GROWTH * memory.displacement)
    while True:
        attempt = Pass(bodies, margin, memory)
        contacts = attempt.run()
        history = PositionHistory(start, contacts)
        memory.displacement = history.displacement
        if not attempt.has_missed(history):
            return contacts, len(attempt.keys)
        bodies.position[:] = start
        margin = np.maximum(margin, MARGIN_GROWTH * history.displacement)


class Memory:
    """What a step has found out about pairs, to save time in the next one. It changes no result.

    keys : (P,), sorted; i · n + j of the pairs whose boxes were near each other
    axis : (3, P), along which the pair overlapped least, or was furthest apart
    displacement : (n,), how far corrections moved each body at most within the step
    """

    def __init__(self, meshes):
        self.keys, self.axis = np.zeros(0, dtype=np.int64), np.zeros((3, 0))
        self.displacement = np.zeros(len(meshes))

    def axes(self, keys):
        """Axes (3, P) for `CachedAxes`: zero for pairs that were not near."""
        if len(self.keys) == 0:
            return np.zeros((3, len(keys)))
        known = find_sorted(keys, self.keys)
        return np.where(known >= 0, take(self.axis, known, axis=1), 0.0)


# The memories of the scenes at hand.
memory_of = lru_cache(maxsize=4)(Memory)


class Pass:
    """One pass over the pairs that can touch, in batches.

    All pairs that touch are among them as long as no body moves further than its margin (n,), and
    often beyond.

    keys : (Q,), i · n + j of the pairs whose boxes are near each other; axis (3, Q), along which
        each overlaps least, or is apart by gap (Q,), -inf for the pairs that are in the batches

    Of the P pairs in the batches, sorted by batch and then in the order i < j:

    bodyPair : (2, P); rank : (P,), where each stands in the order i < j
    starts : (B + 1,), where the batches begin
    facets : `Facets`; facetPair : (K,), the pair of each facet, counted from the batch's first one,
        and facetStart (P,), where the facets of a pair begin, likewise
    invMasses : (2, P), of the bodies
    t : (3, P), translations that the facets were found at
    apart : (P,), the penetration below which a pair counts as apart; tolerance (P,), see
        `contact_points`
    """

    def __init__(self, bodies, margin, memory):
        self.bodies, self.margin = bodies, margin
        radius = bodies.hulls.radius
        first, second = grid_overlaps(bodies.box - margin, bodies.isFixed)
        self.keys = first * len(radius) + second
        t = take(bodies.position, second, axis=1) - take(bodies.position, first, axis=1)
        axes = CachedAxes(bodies.hulls, first, second, t, memory.axes(self.keys))
        pairMargin = margin[first] + margin[second]
        facets = find_facets(bodies.hulls, first, second, t, pairMargin, axes)
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
        begin = take(self.starts, batch)  # of each pair's batch
        self.facetStart = self.facets.start[:-1] - self.facets.start[begin]
        self.facetPair = (np.arange(len(rows)) - begin).repeat(np.diff(self.facets.start))
        self.invMasses = take(bodies.invMass, self.bodyPair)
        self.t = take(t, rows, axis=1)
        self.apart, self.tolerance = -TOUCH_TOLERANCE * size[rows], FEATURE_TOLERANCE * size[rows]

    def run(self):
        """Detects the pairs batch by batch, and moves those that touch apart: the `Contacts`."""
        found = [self._resolve_batch(*ends) for ends in itertools.pairwise(self.starts.tolist())]
        return Contacts(self, found)

    def _resolve_batch(self, begin, end):
        """Of the pairs from `begin` to `end`: `(pairs (H,), depth, normal, before, after, shift)`
        of those that touch, as in `Contacts`."""
        bodies, some = self.bodies, slice(begin, end)
        pairs = self.bodyPair[:, some]
        position = take(bodies.position, pairs, axis=1)
        penetration, normal = self._penetrations(begin, end, position[:, 1] - position[:, 0])
        touches = penetration >= self.apart[some]
        # where hulls overlap by more than rounding, so do their boxes
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
        """`(penetration (m,), normal (3, m))` at the translations t, exact where a pair touches."""
        facets, some = self.facets, slice(begin, end)
        columns = slice(facets.start[begin], facets.start[end])
        normals, pair = facets.normal[:, columns], self.facetPair[columns]
        penetrations = facets.offset[columns] - dot(normals, take(t, pair, axis=1))
        penetration, nearest = row_minima(penetrations, pair, self.facetStart[some])
        normal = take(normals, nearest, axis=1)
        isValid = facets.still_valid(some, penetration, t - self.t[:, some])
        stale = indices((penetration >= self.apart[some]) & ~isValid)
        if len(stale):
            exact = find_facets(
                self.bodies.hulls,
                *self.bodyPair[:, begin + stale],
                t[:, stale],
                np.zeros(len(stale)),
                normal[:, stale],
            )
            penetration[stale], normal[:, stale] = exact.minimal_penetrations(t[:, stale])
        return penetration, normal

    def has_missed(self, history):
        """Whether pairs that are not in the batches would have touched at their turn.

        They are looked at in the positions that sequential execution would have had.
        """
        bodies, displacement = self.bodies, history.displacement
        count = len(displacement)
        i, j = np.divmod(self.keys, count)
        # pairs that were too far apart, but whose bodies have moved far enough to close the gap
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
        position1, position2 = history.positions_at_turn(first, second)
        limits = overlap_limits(bodies.box_at(second, position2))
        meet = indices((bodies.box_at(first, position1) <= limits).all(axis=0))
        if len(meet) == 0:
            return False
        first, second = first[meet], second[meet]
        t = take(position2 - position1, meet, axis=1)
        facets = find_facets(
            bodies.hulls, first, second, t, np.zeros(len(meet)), take(axis, meet, axis=1)
        )
        size = bodies.hulls.radius[first] + bodies.hulls.radius[second]
        return bool((facets.minimal_penetrations(t)[0] >= -TOUCH_TOLERANCE * size).any())


def in_batches(first, second, isFixed):
    """`(order (P,), starts (B + 1,), batch (P,))`: which pair is worked on when, where each batch
    begins, and the batch of each pair in this order.

    A pair's batch is the one after the last batches of its two bodies: pairs that share a body
    which can move keep their order, hence the bits of one pair at a time.
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
    """The pairs that touched in a pass, H of them, in batches of their own.

    They are fewer, and larger, than those of all pairs that could have touched.

    starts : (B + 1,), where each batch of them begins
    bodies : (2, H); rank : (H,), where they stand in the order i < j
    depth : (H,), ≥ 0; normal : (3, H), unit, from the first to the second
    before, after : (3, 2, H), where the bodies were and where they are then
    shift : (H,), how far the second body moved along the normal
    tolerance : (H,), see `contact_points`
    """

    def __init__(self, attempt, found):
        """attempt : `Pass`; found : list of what it has found in each batch"""
        nothing = (
            np.zeros(0, dtype=np.intp),
            np.zeros(0),
            np.zeros((3, 0)),
            np.zeros((3, 2, 0)),
            np.zeros((3, 2, 0)),
            np.zeros(0),
        )
        columns = zip(nothing, *found, strict=True)
        rows, *columns = (np.concatenate(column, axis=-1) for column in columns)
        inOrder = take(attempt.rank, rows).argsort()
        first, second = take(attempt.bodyPair, rows[inOrder], axis=1)
        order, self.starts, _ = in_batches(first, second, attempt.bodies.isFixed)
        order = inOrder[order]
        rows = rows[order]
        self.bodies = take(attempt.bodyPair, rows, axis=1)
        self.rank, self.tolerance = attempt.rank[rows], attempt.tolerance[rows]
        self.depth, self.normal, self.before, self.after, self.shift = (
            take(column, order, axis=-1) for column in columns
        )

    def points(self, hulls):
        """The point (3, H) of each second body that lies deepest in the first before they move."""
        t = self.before[:, 1] - self.before[:, 0]
        point = contact_points(hulls, *self.bodies, t, self.normal, self.tolerance)
        return point + self.before[:, 1]

    def batches(self):
        """The slices of the contacts that belong to one batch, in order."""
        return itertools.starmap(slice, itertools.pairwise(self.starts.tolist()))


class PositionHistory:
    """Where contacts have put the bodies during a pass.

    start : (3, n), the bodies' positions before
    key : (K,), of each contact of a body: body · n² + i · n + j, in ascending order, for the pair
        i, j; a body meets its pairs in this order
    position : (3, K), where the body is after it
    displacement : (n,), how far each body has been from its start
    """

    def __init__(self, start, contacts):
        self.start = start
        count = start.shape[1]
        self.square = count * count
        self.displacement = np.zeros(count)
        body = contacts.bodies.ravel()
        position = contacts.after.reshape(3, -1)
        turn = contacts.bodies[0] * count + contacts.bodies[1]
        away = position - take(start, body, axis=1)
        np.maximum.at(self.displacement, body, norm(away))
        key = body * self.square + np.concatenate((turn, turn))
        order = key.argsort()
        self.key, self.position = key[order], take(position, order, axis=1)

    def positions_at_turn(self, first, second):
        """Where the bodies of the pairs first, second (m,) are at their turn: (3, m), (3, m)."""
        count = len(first)
        bodies = np.concatenate((first, second))
        turn = first * len(self.displacement) + second
        turn = np.concatenate((turn, turn))
        index = self.key.searchsorted(bodies * self.square + turn) - 1
        known = indices(index >= 0)
        known = known[self.key[index[known]] // self.square == bodies[known]]
        position = take(self.start, bodies, axis=1)
        position[:, known] = take(self.position, index[known], axis=1)
        return position[:, :count], position[:, count:]
