"""A step with its contacts in batches, on arrays, bitwise identical to one pair after the other.

The coursework detects and resolves the pairs i < j in order, so that each pair sees the corrections
of the earlier ones. Two pairs without a common movable body do not affect each other. Pairs are
therefore put into batches that preserve the order of pairs with a common body, and the pairs of a
batch are processed together.

Corrections move bodies, so the pairs that touch, and the facets that are nearest when they do, are
not known beforehand. A pass therefore processes the pairs, with the facets, that are near at its
start. Afterwards, it checks at the positions of each pair's turn whether a pair that was left out
touched, or another facet was nearer. If so, the pass is made again with what was found. Impulses
follow at the end, because no position depends on a velocity.
"""

import itertools
from typing import NamedTuple

import numpy as np

from rbs.geometry import vectors
from rbs.geometry.broadphase import boxes_meet
from rbs.geometry.facets import Facets, Pairs, find_facets
from rbs.geometry.hulls import FEATURE_TOLERANCE, TOUCH_TOLERANCE
from rbs.geometry.patches import contact_points
from rbs.geometry.vectors import cross, cycled, dot, indices, norm, take
from rbs.stepping.constraints import linked_keys
from rbs.stepping.kernels import collide, inverse_effective_mass, position_corrections
from rbs.stepping.reports import GROUND, ContactColumns

# Least margin of a body, as a fraction of its radius, and what is added, as a multiple of its
# displacement in the step before. With more, more pairs are processed; with less, more passes made.
LEAST_MARGIN = 0.0025
MARGIN_GROWTH = 1.0
# Change of a pair's translation for which its facets are found, as a multiple of its margins. With
# more, more facets are found; with less, more passes are made.
FACET_MARGIN = 0.5


def resolve_contacts(step):
    """Makes the part of a `Step` before the constraints."""
    if len(step.meshes) == 0:
        return
    bodies, report = step.bodies, step.report
    with report.phase("integrate"):
        bodies.integrate(step.timeStep, step.gyroscopic)
        bodies.check("free flight")
    with report.phase("collisions"):
        linked = linked_keys(step, len(step.meshes))
        contacts, report.candidatePairs = find_contacts(bodies, linked)
        _resolve_pairs(step, contacts)
    with report.phase("ground"):
        if step.groundMesh is not None:
            _resolve_ground(step)
    with report.phase("writeBack"):
        bodies.check("contacts")
        bodies.write_back()


def _resolve_pairs(step, contacts):
    """Applies the impulses of contacts whose positions are corrected."""
    if len(contacts.rank) == 0:
        return
    bodies, hulls = step.bodies, step.bodies.hulls
    order, starts = in_batches(*contacts.bodies, bodies.isFixed)
    contacts = contacts.of(order)
    ends, t, n = contacts.bodies, contacts.translations(), contacts.normal
    radius = take(hulls.radius, ends)
    tolerance = FEATURE_TOLERANCE * (radius[0] + radius[1])
    penPoint = contact_points(hulls, *ends, t, n, tolerance) + contacts.before[:, 1]
    apply_impulses(step, contacts, penPoint, starts)


def _resolve_ground(step):
    """Corrects the bodies that reach the ground, which is body 2, and applies the impulses."""
    bodies = step.bodies
    b, penPoint = bodies.lowest_points()
    if len(b) == 0:
        return
    ends = np.array((b, np.full(len(b), len(bodies.meshes))))
    depth, n = -penPoint[1], -np.tile([[0.0], [1.0], [0.0]], len(b))  # zeros are -0.0
    correction = position_corrections(take(bodies.invMass, ends), depth)
    before = take(bodies.state[:3], ends, axis=1)
    after = before + correction * n[:, None]
    bodies.position[:, b] = after[:, 0]
    rank = np.full(len(b), np.iinfo(np.intp).max)  # last
    contacts = PairContacts(rank, ends, depth, n, before, after)
    apply_impulses(step, contacts, penPoint, np.array([0, len(b)]))


def apply_impulses(step, contacts, penPoint, starts):
    """Applies the impulses by batch; whatever ignores velocities is computed for all at once.

    starts : (B + 1,), first contact of each batch
    """
    bodies = step.bodies
    rank, ends, depth, n, _, after = contacts
    invMasses, invInertias = take(bodies.invMass, ends), take(bodies.invInertia, ends, axis=1)
    arms = cycled((penPoint + position_corrections(invMasses, depth)[1] * n)[:, None] - after)
    K, response = inverse_effective_mass(invMasses, invInertias, cross(arms, n[:, None]))
    impulse, friction, velocities = np.empty(depth.shape), np.empty(n.shape), bodies.state[3:9]
    for some in itertools.starmap(slice, itertools.pairwise(starts.tolist())):
        b = ends[:, some]
        velocity = take(velocities, b, axis=1)
        contact = (table[..., some] for table in (invMasses, invInertias, arms, n, K, response))
        impulse[some], friction[:, some] = collide(velocity, *contact, step)
        velocities[:, b] = velocity
    ends = np.where(ends == len(bodies.meshes), GROUND, ends)
    columns = rank, *ends, depth, n, penPoint, impulse, friction, arms[:3, 0]
    step.report.add_columns(ContactColumns(*columns))


def find_contacts(bodies, linked):
    """Corrects the positions of bodies that touch: `(PairContacts, number of candidate pairs)`."""
    # what saves time and changes no result: keys of near pairs, their axes, displacements (n,)
    keys, axes, displacement = bodies.memory or (np.zeros(0, dtype=np.int64), np.zeros((3, 0)), 0.0)
    margin = LEAST_MARGIN * bodies.hulls.radius + MARGIN_GROWTH * displacement
    while True:
        attempt = Pass(bodies, margin, keys, axes, linked)
        contacts = attempt.run()
        bodies.memory = keys, axes, _ = attempt.keys, attempt.axes, attempt.displacement
        if not attempt.has_missed():
            bodies.position[:] = attempt.end
            return contacts, len(attempt.keys)
        margin = margin + attempt.displacement


class Pass:
    """One pass over the candidate pairs, whose boxes meet if each body has its margin (n,).

    It is exact if has_missed is false afterwards. start, end : (3, n), positions before and after

    pairs : the Q `Pairs`, at the start, in the order i < j; the rank of a pair is its index
    ends : (2, Q), their bodies
    gap : (Q,), distance that the bodies of a pair can move together without touching
    isExpected : (Q,) bool, pairs that are processed, because they may touch
    facets : `Facets` found so far; t : (3, R), translations at which they were found
    latest : (Q,), index of each pair's latest facets in these
    """

    def __init__(self, bodies, margin, knownKeys, knownAxes, linked):
        self.bodies, self.margin, self.linked, self.start = bodies, margin, linked, bodies.position
        self.ends = first, second = self._pairs(bodies.box - margin, bodies.isFixed)
        self.keys = first * len(margin) + second
        self.t = t = take(self.start, second, axis=1) - take(self.start, first, axis=1)
        axes = vectors.known_columns(self.keys, knownKeys, knownAxes)
        self.pairs = Pairs(bodies.hulls, first, second, t).along(axes)
        reach = margin[first] + margin[second]
        self.facets = find_facets(self.pairs, FACET_MARGIN * reach, reach)
        penetration, self.axes = self.facets.minimal_penetrations(t)
        self.gap = -penetration - FEATURE_TOLERANCE * self.pairs.size
        self.isExpected, self.latest = self.gap <= reach, np.arange(len(first))

    def _pairs(self, box, isFixed):
        """Pairs i < j (2, P) whose boxes overlap, in this order, but for linked and fixed ones."""
        pair = self.bodies.near_pairs(box, isFixed, self.start - self.bodies.start["position"])
        return pair[:, vectors.find_sorted(pair[0] * len(isFixed) + pair[1], self.linked) < 0]

    def run(self):
        """Separates the pairs that touch, as if in the order i < j: `PairContacts`."""
        while True:
            contacts = self.process()
            b, after = contacts.bodies.ravel(), contacts.after.reshape(3, -1)
            self.displacement = np.zeros(len(self.margin))
            np.maximum.at(self.displacement, b, norm(after - take(self.start, b, axis=1)))
            # positions of each body at the start and after each contact, body by body
            first, width = np.arange(len(self.margin)), len(self.keys) + 1
            turns = np.append(first * width, contacts.bodies * width + contacts.rank + 1)
            order, places = turns.argsort(), np.append(self.start, after, axis=1)
            self._turns, self._places = turns[order], take(places, order, axis=1)
            # what comes first in the order i < j is not wrong again, so this ends
            if not self._correct(contacts):
                return contacts

    def process(self):
        """Separates the expected pairs that touch, batch by batch: `PairContacts`."""
        bodies, rank, self.end = self.bodies, indices(self.isExpected), self.start.copy()
        order, starts = in_batches(*take(self.ends, rank, axis=1), bodies.isFixed)
        rank = rank[order]
        pair, facets = take(self.ends, rank, axis=1), self.facets.of_pairs(self.latest[rank])
        size = take(bodies.hulls.radius, pair).sum(axis=0)
        weights = position_corrections(take(bodies.invMass, pair), 1.0)
        # hulls that overlap by more than rounding have overlapping boxes
        least, sure = -TOUCH_TOLERANCE * size, FEATURE_TOLERANCE * size
        facetStarts, found = np.append(0, facets.count.cumsum())[starts], []
        batches, columns = (map(slice, x[:-1], x[1:]) for x in (starts, facetStarts))
        for some, ofThese in zip(batches, columns, strict=True):
            ends, row = pair[:, some], facets.row[ofThese] - some.start
            position = take(self.end, ends, axis=1)
            normals, t = facets.normal[:, ofThese], position[:, 1] - position[:, 0]
            penetrations = facets.offset[ofThese] - dot(normals, take(t, row, axis=1))
            penetration, nearest = vectors.row_minima(penetrations, row)
            touches = penetration >= least[some]
            doubtful = indices(touches & (penetration <= sure[some]))
            if len(doubtful):
                box = bodies.box_at(ends[:, doubtful], position[..., doubtful])
                touches[doubtful] = boxes_meet(*box.swapaxes(0, 1))
            depth, normal = np.maximum(penetration, 0.0), take(normals, nearest, axis=1)
            correction = weights[:, some] * depth * normal[:, None]
            after = np.add(position, correction, out=position.copy(), where=touches)
            self.end[:, ends] = after
            found.append((touches, depth, normal, position, after))
        touches, *columns = vectors.joined(*found)
        return PairContacts(rank, pair, *columns).of(indices(touches))

    def _positions(self, b, rank):
        """Positions of bodies b after their last contacts before pairs of these ranks."""
        turn = b * (len(self.keys) + 1) + rank
        return take(self._places, self._turns.searchsorted(turn, side="right") - 1, axis=1)

    def _correct(self, contacts):
        """Finds the facets of the pairs whose results are wrong; returns whether there are any."""
        rank, t, axes, depth = self._doubtful(contacts)
        if len(rank) == 0:
            return False
        pairs = Pairs(self.bodies.hulls, *take(self.ends, rank, axis=1), t).along(axes)
        facets = find_facets(pairs, np.zeros(len(rank)))
        penetration, normal = facets.minimal_penetrations(t)
        touches = penetration >= -TOUCH_TOLERANCE * pairs.size
        isWrong = np.where(touches, np.maximum(penetration, 0.0), -1.0) != depth
        # compares the bits, because 0.0 equals -0.0
        isWrong |= touches & (normal.view(np.int64) != axes.view(np.int64)).any(axis=0)
        if isWrong.any():
            self.isExpected[rank[isWrong]] = True
            self.latest[rank] = len(self.t[0]) + np.arange(len(rank))
            self.t = np.append(self.t, t, axis=1)
            self.facets = Facets(*vectors.joined(self.facets, facets))
        return isWrong.any()

    def _doubtful(self, contacts):
        """Pairs whose results are not proved: `(rank (m,), t (3, m), axes (3, m), depth (m,))`.

        t : translations when it was their turn; axes : of least penetration, as far as known
        depth : by which they were found to overlap, or -1 if they were not processed
        """
        # contacts for which a nearer facet may have been omitted: since the facets were found, no
        # penetration has changed by more than the translation
        latest = self.latest[contacts.rank]
        shift = norm(contacts.translations() - take(self.t, latest, axis=1))
        stale = contacts.of(indices(contacts.depth + shift > self.facets.completeUpTo[latest]))
        # other pairs that their axes may not separate any more
        displacement = take(self.displacement, self.ends).sum(axis=0)
        rank = indices((displacement >= self.gap) & ~self.isExpected)
        position = self._positions(take(self.ends, rank, axis=1), rank)
        t, axes = position[:, 1] - position[:, 0], take(self.axes, rank, axis=1)
        gap = self.gap[rank] + dot(axes, t - take(self.pairs.t, rank, axis=1))
        near = indices(gap <= 0.0)
        return (
            np.append(stale.rank, rank[near]),
            np.append(stale.translations(), t[:, near], axis=1),
            np.append(stale.normal, axes[:, near], axis=1),
            np.append(stale.depth, np.full(len(near), -1.0)),
        )

    def has_missed(self):
        """Whether a pair of bodies that was not listed touched when its turn would have come."""
        isKnown = self.displacement <= self.margin
        if isKnown.all():
            return False
        bodies = self.bodies
        # the tolerance is for rounding
        reach = self.displacement + FEATURE_TOLERANCE * bodies.hulls.radius
        pair = self._pairs(bodies.box - reach, bodies.isFixed | isKnown)
        keys = pair[0] * len(reach) + pair[1]
        others = indices(vectors.find_sorted(keys, self.keys) < 0)
        pair, rank = pair[:, others], self.keys.searchsorted(keys[others])
        position = self._positions(pair, rank)
        near = indices(boxes_meet(*bodies.box_at(pair, position).swapaxes(0, 1)))
        if len(near) == 0:
            return False
        t = position[:, 1, near] - position[:, 0, near]
        pairs = Pairs(bodies.hulls, *pair[:, near], t).along()
        penetration, _ = find_facets(pairs, np.zeros(len(near))).minimal_penetrations(t)
        return bool((penetration >= -TOUCH_TOLERANCE * pairs.size).any())


def in_batches(first, second, isFixed):
    """Assigns ordered pairs of bodies (P,) to batches: `(order (P,), starts (B + 1,))`.

    The batch of a pair follows the last batches of its movable bodies. Without pairs, there is one
    empty batch.
    """
    isFixed, following, batch = isFixed.tolist(), [0] * len(isFixed), []
    for i, j in zip(first.tolist(), second.tolist(), strict=True):
        number = following[i] if following[i] > following[j] else following[j]
        batch.append(number)
        if not isFixed[i]:
            following[i] = number + 1
        if not isFixed[j]:
            following[j] = number + 1
    batch = np.array(batch, dtype=np.intp)
    order = batch.argsort(kind="stable")
    return order, batch[order].searchsorted(np.arange(batch.max(initial=0) + 2))


class PairContacts(NamedTuple):
    """The H pairs that touched in a pass; those with a common movable body in the order i < j."""

    rank: np.ndarray  # (H,)
    bodies: np.ndarray  # (2, H)
    depth: np.ndarray  # (H,), ≥ 0
    normal: np.ndarray  # (3, H), unit, from the first body to the second
    before: np.ndarray  # (3, 2, H), positions of the bodies before the correction
    after: np.ndarray  # (3, 2, H), and after it

    def of(self, rows):
        """Returns the selected contacts."""
        return PairContacts(*(take(column, rows, axis=-1) for column in self))

    def translations(self):
        """Translations (3, H) from the first body to the second, before the correction."""
        return self.before[:, 1] - self.before[:, 0]
