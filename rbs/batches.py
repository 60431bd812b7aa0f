"""Ordered batches: many pairs detected at once, with the bits of one pair after the other.

The coursework detects and resolves the pairs i < j in that order, each seeing the corrections of
the earlier ones. Two pairs without a common body that can move do not see each other, so pairs are
put into batches that keep the order of those that do: a pair's batch is the one after the last
batches of its two bodies. Within a batch all pairs are looked at together.

Which pairs can touch is not known beforehand, since corrections move bodies. So the pass is
speculative: it takes the pairs whose boxes are near each other when every body has a margin, and
afterwards `OrderedBatches.validate` looks for missed pairs. If there are any, the positions are
rolled back and the pass is made again with them.

This is bookkeeping and detection. What a contact does to its bodies is in RBSFunctions, which walks
through the batches, corrects positions, and applies the impulses after the last pass: within a step
no position depends on a velocity.
"""

import itertools

import numpy as np

from rbs.arrays import find_sorted, indices, row_minima, take
from rbs.bodies import BodyState
from rbs.broadphase import grid_overlaps, overlap_limits, overlaps_of
from rbs.facets import CachedAxes, Facets, find_facets
from rbs.hulls import FEATURE_TOLERANCE, TOUCH_TOLERANCE
from rbs.patches import contact_points
from rbs.vectors import dot, norm

# A body's margin at least, relative to its radius: corrections move most bodies less.
LEAST_MARGIN = 0.005

# A body gets this many times its displacement in one step as its margin in the next, or when the
# pass is made again.
MARGIN_GROWTH = 2.0

# What a pair's margin is of those of its two bodies together, or of the corrections that are
# predicted: bodies that are pushed seldom go apart, or meet, by as much as both of them move.
PAIR_MARGIN = 0.85


class OrderedBatches:
    """The pairs that can touch in this step, in batches that are worked on one after the other.

    All pairs are known beforehand as long as no body moves further than its margin (n,), and often
    beyond.

    bodyPair : (2, P), sorted by batch, and within a batch by the order i < j
    rank : (P,), where each pair stands in the order i < j
    starts : (B + 1,), where the batches begin
    facets : `Facets` of the pairs; facetStart (P,), where those of a pair begin, and facetPair
        (K,), the pair of each facet, both counted from the batch's first one
    invMass : (2, P), of the bodies
    t : (3, P), translations that the facets were found at
    apart : (P,), the penetration below which a pair counts as apart; tolerance (P,), see
        `contact_point`
    keys : (Q,), of the pairs whose boxes are near each other, i · n + j; gap (Q,), by how much each
        is apart along the axis (3, Q), -inf for the pairs that are in the batches
    """

    def __init__(self, bodies, mass_weights):
        """mass_weights : each body's part in a correction, (2, m), of inverse masses (2, m)

        It predicts how far contacts are going to move the bodies, which no result depends on.
        """
        self.bodies = bodies
        self.start = bodies.position.copy()
        radius = bodies.hulls.radius
        self.margin = np.maximum(LEAST_MARGIN * radius, MARGIN_GROWTH * bodies.axes.displacement)
        bodies.axes.displacement = np.zeros(len(radius))
        first, second = grid_overlaps(bodies.box - self.margin, bodies.isFixed)
        self.keys = first * len(radius) + second
        t = take(bodies.position, second, axis=1) - take(bodies.position, first, axis=1)
        axes = CachedAxes(bodies.hulls, first, second, t, bodies.axes.lookup(first, second))
        moves = _predicted_corrections(bodies, first, second, axes.penetration, mass_weights)
        margin = PAIR_MARGIN * np.maximum(self.margin[first] + self.margin[second], moves)
        facets = find_facets(bodies.hulls, first, second, t, margin, axes)
        penetration, self.axis = facets.minimal_penetrations(t)
        bodies.axes.store(first, second, self.axis)
        isNear = penetration >= -margin
        size = radius[first] + radius[second]
        self.gap = np.where(isNear, -np.inf, -penetration - FEATURE_TOLERANCE * size)
        near = indices(isNear)
        self._arrange(first[near], second[near], near, facets, t)

    def _arrange(self, first, second, rows, facets, t):
        """Sorts pairs, given in the order i < j, into batches.

        rows : where each pair is in facets and t
        """
        bodies = self.bodies
        self.rank, self.starts, batch = _in_batches(first, second, bodies.isFixed)
        self.bodyPair = take(np.stack((first, second)), self.rank, axis=1)
        rows = rows[self.rank]
        self.facets = facets.of_pairs(rows)
        begin = take(self.starts, batch)  # of each pair's batch
        self.facetStart = self.facets.start[:-1] - self.facets.start[begin]
        self.facetPair = (np.arange(len(rows)) - begin).repeat(np.diff(self.facets.start))
        self.invMass = take(bodies.invMass, self.bodyPair)
        self.t = take(t, rows, axis=1)
        radius1, radius2 = take(bodies.hulls.radius, self.bodyPair)
        size = radius1 + radius2
        self.apart = -TOUCH_TOLERANCE * size
        self.tolerance = FEATURE_TOLERANCE * size

    def detect(self):
        """One pass: yields the `Batch` of each batch in turn, which has to be stored before the
        next one."""
        self._stored = []
        for begin, end in itertools.pairwise(self.starts.tolist()):
            yield self._detect_batch(begin, end)

    def _detect_batch(self, begin, end):
        """The pairs from `begin` to `end` in the present positions."""
        bodies, facets = self.bodies, self.facets
        some = slice(begin, end)
        pairs = self.bodyPair[:, some]
        position = take(bodies.position, pairs, axis=1)
        t = position[:, 1] - position[:, 0]
        # the pair's nearest facet, or the one that it is furthest apart along
        columns = slice(facets.start[begin], facets.start[end])
        normals, pair = facets.normal[:, columns], self.facetPair[columns]
        penetrations = facets.offset[columns] - dot(normals, take(t, pair, axis=1))
        penetration, nearest = row_minima(penetrations, pair, self.facetStart[some])
        normal = take(normals, nearest, axis=1)
        apart, tolerance = self.apart[some], self.tolerance[some]
        touches = penetration >= apart
        isValid = facets.still_valid(some, penetration, t - self.t[:, some])
        stale = indices(touches & ~isValid)
        if len(stale):
            exact = find_facets(
                bodies.hulls, *pairs[:, stale], t[:, stale], np.zeros(len(stale)),
                normal[:, stale],
            )  # fmt: skip
            penetration[stale], normal[:, stale] = exact.minimal_penetrations(t[:, stale])
            touches = penetration >= apart
        # where hulls overlap by more than rounding, so do their boxes
        doubtful = indices(touches & (penetration <= tolerance))
        if len(doubtful):
            box = bodies.box_at(pairs[:, doubtful], position[..., doubtful])
            touches[doubtful] = (box[:, 0] <= overlap_limits(box[:, 1])).all(axis=0)
        return Batch(
            pairs, indices(touches), np.maximum(penetration, 0.0), normal, position,
            BodyState(self.invMass[:, some], None, position, None, None),
        )  # fmt: skip

    def store(self, batch, shift):
        """Moves the bodies that touch to where the body states of a batch are now.

        shift : (m,), how far each second body has moved along the normal
        """
        hits = batch.hits
        self.bodies.position[:, batch.pairs[:, hits]] = take(batch.bodies.position, hits, axis=2)
        self._stored.append((batch, shift))

    def validate(self):
        """The `Contacts` of the last pass if it was complete. Otherwise None, and it has to be made
        again: the positions are rolled back, and the missed pairs added."""
        contacts = Contacts(self, self._stored)
        history = PositionHistory(self.start, contacts)
        self.bodies.axes.displacement = history.maximumDisplacement
        first, second = self._missed_pairs(history)
        if len(first) == 0:
            return contacts
        self.bodies.position[:] = self.start
        self._add_missed_pairs(first, second, history.maximumDisplacement)
        return None

    def _missed_pairs(self, history):
        """Pairs `(first, second)` that are not in the batches and would have touched at their turn.

        Those are looked at in the positions that sequential execution would have had.
        """
        bodies, displacement = self.bodies, history.maximumDisplacement
        count = len(displacement)
        # pairs that were too far apart, but whose bodies have been far enough from where they
        # started to close the gap, and at their turn are so along the axis
        i, j = np.divmod(self.keys, count)
        met = indices((displacement[i] + displacement[j] >= self.gap) & (self.gap > -np.inf))
        first, second = i[met], j[met]
        start1, start2 = take(history.start, first, axis=1), take(history.start, second, axis=1)
        position1, position2 = history.positions_at_turn(first, second)
        approach = (position2 - start2) - (position1 - start1)
        gap = self.gap[met] + dot(take(self.axis, met, axis=1), approach)
        met = indices(gap <= 0.0)
        first, second = first[met], second[met]
        beyondMargin = indices(displacement > self.margin)
        if len(beyondMargin):
            wider = bodies.box - np.maximum(displacement, self.margin)
            keys = overlaps_of(beyondMargin, wider, bodies.isFixed)
            others = np.divmod(keys[find_sorted(keys, self.keys) < 0], count)
            first, second = np.concatenate(((first, second), others), axis=1)
        position1, position2 = history.positions_at_turn(first, second)
        limits = overlap_limits(bodies.box_at(second, position2))
        meet = indices((bodies.box_at(first, position1) <= limits).all(axis=0))
        first, second = first[meet], second[meet]
        if len(first) == 0:
            return first, second
        t = take(position2, meet, axis=1) - take(position1, meet, axis=1)
        facets = find_facets(bodies.hulls, first, second, t, np.zeros(len(meet)))
        penetration, _ = facets.minimal_penetrations(t)
        size = bodies.hulls.radius[first] + bodies.hulls.radius[second]
        touching = penetration >= -TOUCH_TOLERANCE * size
        return first[touching], second[touching]

    def _add_missed_pairs(self, first, second, displacement):
        """Adds pairs to the batches. The bodies are back where they were at the start.

        displacement : (n,), how far from there each has been
        """
        count = len(displacement)
        keys = first * count + second
        known = find_sorted(keys, self.keys)
        self.gap[known[known >= 0]] = -np.inf
        new = np.sort(keys[known < 0])
        index = self.keys.searchsorted(new)
        self.keys = np.insert(self.keys, index, new)
        self.gap = np.insert(self.gap, index, -np.inf)
        self.axis = np.insert(self.axis, index, 0.0, axis=1)

        bodies = self.bodies
        t = take(bodies.position, second, axis=1) - take(bodies.position, first, axis=1)
        margin = np.maximum(self.margin, MARGIN_GROWTH * displacement)
        facets = find_facets(bodies.hulls, first, second, t, margin[first] + margin[second])
        # all pairs in the order i < j
        keys = np.concatenate((self.bodyPair[0] * count + self.bodyPair[1], keys))
        order = keys.argsort()
        keys = keys[order]
        facets = Facets.joined((self.facets, facets))
        t = np.concatenate((self.t, t), axis=1)
        self._arrange(*np.divmod(keys, count), order, facets, t)


def _in_batches(first, second, isFixed):
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


def _predicted_corrections(bodies, first, second, penetration, mass_weights):
    """How far (P,) contacts are likely to move the two bodies of a pair, together.

    penetration : (P,), of each pair at most

    A body gives way to the deepest of its contacts by its weight. As cached axes overestimate the
    penetration, it counts up to what the two bodies have travelled in this step.
    """
    weight1, weight2 = mass_weights(take(bodies.invMass, np.stack((first, second))))
    travel = norm(bodies.travel)
    depth = np.maximum(penetration, 0.0)
    depth = np.minimum(depth, take(travel, first) + take(travel, second))
    moves = np.zeros(len(bodies.invMass))
    np.maximum.at(moves, first, weight1 * depth)
    np.maximum.at(moves, second, weight2 * depth)
    return take(moves, first) + take(moves, second)


class Batch:
    """Pairs that no common body which can move makes depend on each other, as they are found.

    pairs : (2, m), the bodies; hits : (H,), which of the pairs touch
    depth : (m,), ≥ 0; normal : (3, m), unit, from the first to the second
    position : (3, 2, m), where the bodies are
    bodies : `BodyState` with the inverse masses and positions, to be corrected
    """

    def __init__(self, pairs, hits, depth, normal, position, bodies):
        self.pairs, self.hits, self.depth, self.normal = pairs, hits, depth, normal
        self.position, self.bodies = position, bodies


class Contacts:
    """The pairs that touched in a pass, H of them, in batches of their own.

    They are fewer, and larger, than those of all pairs that could have touched.

    starts : (B + 1,), where each batch of them begins
    bodies : (2, H); rank : (H,), where they stand in the order i < j
    depth : (H,); normal : (3, H); shift : (H,), how far the second body moved along the normal
    before, after : (3, 2, H), where the bodies were and where they are then
    """

    def __init__(self, batches, stored):
        """stored : list of `(Batch, shift)`"""
        begins = batches.starts[:-1].tolist()
        hits = [batch.hits for batch, _ in stored]
        rows = [own + begin for own, begin in zip(hits, begins, strict=True)]
        rows = np.concatenate([np.zeros(0, dtype=np.intp), *rows])
        rows = rows[take(batches.rank, rows).argsort()]
        first, second = take(batches.bodyPair, rows, axis=1)
        order, self.starts, _ = _in_batches(first, second, batches.bodies.isFixed)
        rows = rows[order]
        self.bodies = take(batches.bodyPair, rows, axis=1)
        self.rank, self.tolerance = batches.rank[rows], batches.tolerance[rows]
        columns = [
            (batch.depth, batch.normal, batch.position, batch.bodies.position, shift)
            for batch, shift in stored
        ]
        joined = (np.concatenate(column, axis=-1) for column in zip(*columns, strict=True))
        self.depth, self.normal, self.before, self.after, self.shift = (
            take(column, rows, axis=-1) for column in joined
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
    maximumDisplacement : (n,), how far each body has been from its start
    """

    def __init__(self, start, contacts):
        self.start = start
        count = start.shape[1]
        self.square = count * count
        self.maximumDisplacement = np.zeros(count)
        body = contacts.bodies.ravel()
        position = contacts.after.reshape(3, -1)
        turn = contacts.bodies[0] * count + contacts.bodies[1]
        away = position - take(start, body, axis=1)
        np.maximum.at(self.maximumDisplacement, body, norm(away))
        key = body * self.square + np.concatenate((turn, turn))
        order = key.argsort()
        self.key, self.position = key[order], take(position, order, axis=1)

    def positions_at_turn(self, first, second):
        """Where the bodies of the pairs first, second (m,) are at their turn: (3, m), (3, m)."""
        count = len(first)
        bodies = np.concatenate((first, second))
        turn = first * len(self.maximumDisplacement) + second
        turn = np.concatenate((turn, turn))
        index = self.key.searchsorted(bodies * self.square + turn) - 1
        known = indices(index >= 0)
        known = known[self.key[index[known]] // self.square == bodies[known]]
        position = take(self.start, bodies, axis=1)
        position[:, known] = take(self.position, index[known], axis=1)
        return position[:, :count], position[:, count:]
