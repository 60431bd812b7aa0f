"""Contacts of a step: near pairs, and their old and new manifolds."""

import numpy as np

from Quaternion import multiply
from rbs.geometry import vectors
from rbs.geometry.broadphase import islands, overlapping
from rbs.geometry.facets import Pairs
from rbs.geometry.hulls import tangents
from rbs.geometry.vectors import cross, dot, find_sorted, indices, norm, take, vec_mat
from rbs.softstep.manifolds import (
    GROUND_AXES,
    Manifolds,
    PlacedManifolds,
    contact_normals,
    four_points,
    pair_corners,
)
from rbs.softstep.supports import FLUSH, deferring

# Lengths are fractions of the thickness of the thinner body.

# Change of the relative pose after which the manifold of two bodies is rebuilt, and height over the
# deepest point up to which others count. With more, its normal becomes visibly outdated, and
# cylinders that roll sink between points too far apart; with less, time is spent on finding the
# same manifold again.
KEEP = 0.03
# Gap, beyond what free flight closes in the step, up to which a pair has a manifold. With more,
# time is spent on pairs that do not touch; with less, bodies that are pushed overlap first.
MARGIN = 0.01


class Poses:
    """Poses of n bodies and of the ground, at the origin, in n + 1 columns.

    position : (3, n + 1); orientation : (4, n + 1); rotation : (9, n + 1)
    thickness, radius : (n + 1,), of the hulls; inf of the ground
    """

    def __init__(self, bodies):
        self.bodies, self.hulls, self.count = bodies, bodies.hulls, len(bodies.meshes)
        self.position, self.orientation = bodies.state[:3], bodies.state[9:]
        self.rotation = bodies.rotation
        self._sizes = np.full((2, self.count + 1), np.inf)
        self._sizes[:, :-1] = self.hulls.thickness, self.hulls.radius
        self.thickness, self.radius = self._sizes

    def sizes(self, first, second):
        """Returns the lesser thickness and the lesser radius of the two hulls, (2, P)."""
        return np.minimum(take(self._sizes, first, axis=1), take(self._sizes, second, axis=1))

    def translations(self, first, second):
        """Vectors (3, P) from the first COM to the second, or to the ground right below."""
        t = take(self.position, second, axis=1) - take(self.position, first, axis=1)
        t[0::2] *= second < self.count
        return t

    def relative_orientations(self, first, second):
        """Orientations (4, P) of the second bodies in the first's frames."""
        a, b = (take(self.orientation, bodies, axis=1) for bodies in (first, second))
        return np.array(multiply((a[0], *-a[1:]), b))


class Frames(Poses):
    """`Poses` at the start of a step, and the free flight in which bodies may meet.

    velocity : (6, n + 1); the ground stays where it is even if it has one, as a conveyor belt
    displacement : (6, n + 1), and rotation vectors, without gravity, forces and torques
    glide : (3, n + 1), these displacements alone
    flight : (6, n + 1), displacements with gravity and forces, relative to what bodies may meet,
        and rotation vectors. Islands that can meet nothing fixed move relative to their mean
    reach : (n + 1,), largest distance that points of each body move in the flight
    tiedReach : (n + 1,), the same of what constraints join it to, or 0
    isNearGround : (n,), bodies that may meet the ground in the flight
    isStill : (n,), bodies that do not move
    pairs : (2, P), bodies i < j, in this order, that may meet in the flight, unless both are still
    """

    def __init__(self, step, isStill, tied):
        """step : `Step`; tied : (2, R), bodies that constraints join"""
        super().__init__(step.bodies)
        bodies, hasGround, timeStep = step.bodies, step.groundMesh is not None, step.timeStep
        self.timeStep, self.velocity, self.isStill = timeStep, bodies.state[3:9], isStill
        self.isGroundMoving = self.velocity[:, -1].any()
        self.displacement = timeStep * self.velocity
        self.glide = self.displacement[:3]
        drop = np.where(bodies.isFixed, 0.0, timeStep * bodies.acceleration[:3])
        self.flight = np.zeros((6, self.count + 1))
        shift, turn = self.flight[:3, :-1], self.flight[3:, :-1]
        shift[:] = timeStep * (bodies.linVelocity + drop)
        # in the frame of the ground, of what is fixed, or else of all bodies
        held = self.glide[:, -1:]
        if not hasGround:
            isHeld = bodies.isFixed if bodies.isFixed.any() else ~bodies.isFixed
            held = shift[:, isHeld].mean(axis=1, keepdims=True)
        shift -= held
        turn[:] = timeStep * (bodies.angVelocity + timeStep * bodies.acceleration[3:])

        self.pairs = bodies.near_pairs(self._place_boxes(hasGround, tied), isStill, shift)
        isHeld = bodies.isFixed | self.isNearGround
        links = np.concatenate((self.pairs, tied), axis=1)
        island = islands(links, np.ones(self.count, dtype=bool))
        isFree = (np.bincount(island, isHeld) == 0.0)[island]
        if isFree[self.pairs].any():
            total = np.array([np.bincount(island, x)[island] for x in shift])
            shift -= np.where(isFree, total / np.bincount(island)[island], 0.0)
            self.pairs = overlapping(self._place_boxes(hasGround, tied), *self.pairs)

    def _place_boxes(self, hasGround, tied):
        """Sets reaches and isNearGround for the present flight. Returns boxes (6, n) of the bodies
        in all of it, with a margin that keeps manifolds of resting pairs, and sleepers asleep.
        """
        shift, turn = self.flight[:3, :-1], self.flight[3:, :-1]
        spinReach = norm(turn) * self.hulls.radius
        own = np.append(norm(shift) + spinReach, 0.0)
        self.tiedReach = np.zeros(self.count + 1)
        # constraints may make a body as fast as the one it is tied to
        np.maximum.at(self.tiedReach, tied, own[tied[::-1]])
        self.reach = np.maximum(own, self.tiedReach)
        margin = spinReach + self.tiedReach[:-1] + MARGIN * self.hulls.thickness
        way = np.concatenate((shift, -shift))
        box = self.bodies.box + np.minimum(way, 0.0) - margin
        self.isNearGround = hasGround & (box[1] <= 0.0) & ~self.bodies.isFixed
        return box

    def advances(self, first, second, axis):
        """Gaps (P,) that pairs may close in the flight, along axes (3, P), unit."""
        ends, axis = np.array((first, second)), axis[:, None]
        flight, size = take(self.flight, ends, axis=1), self.sizes(first, second)[0]
        # a body that withdraws counts as still, because the impulse of another one may stop it
        along, turn = dot(flight[:3], axis), norm(cross(flight[3:], axis))
        way = np.maximum(along[0], 0.0) - np.minimum(along[1], 0.0) + MARGIN * size
        return way + (turn * take(self.radius, ends) + take(self.tiedReach, ends)).sum(axis=0)


def detect(step, frames, state, tied):
    """Detects the contacts of a `Step`: the `Manifolds` of all pairs near enough.

    state : `SolverState`, whose pairs are replaced by those of this step; tied : as for `Frames`
    """
    first, second = frames.pairs
    key = first * (frames.count + 1) + second
    if not step.linkedBodiesCollide:
        low, high = np.sort(tied, axis=0)
        others = indices(~np.isin(key, low * (frames.count + 1) + high))
        first, second, key = first[others], second[others], key[others]
    axis = vectors.known_columns(key, state.pairKey, state.pairAxis)
    valid = _valid_manifolds(state.manifolds, frames, key)
    asked = indices(find_sorted(key, valid.key) < 0)
    landing = indices(frames.isNearGround)
    landing = landing[find_sorted(landing * (frames.count + 1) + frames.count, valid.key) < 0]
    state.pairKey, state.pairAxis = key, axis
    if len(asked) + len(landing) == 0:
        return valid
    ground = _ground_contacts(frames, landing)
    pairs, axis[:, asked] = _facing_pairs(frames, first[asked], second[asked], take(axis, asked, 1))
    contacts = _with_pairs(frames, pairs, valid, ground) if len(pairs.first) else ground
    new = _new_manifolds(frames, *contacts)
    new.inherit(state.manifolds)
    return valid.joined(new)


def _valid_manifolds(manifolds, frames, nearKey):
    """Returns the manifolds of pairs that are still near and in nearly the same relative pose, and
    those of two bodies that do not move.

    nearKey : (Q,), sorted keys of the near pairs of which one body moves
    """
    ends = manifolds.bodies(frames.count)
    isValid = take(np.append(frames.isStill, True), ends).all(axis=0)
    isNear = find_sorted(manifolds.key, nearKey) >= 0
    isNear |= (ends[1] == frames.count) & take(frames.isNearGround, ends[0])
    moved = indices(~isValid & isNear)
    first, second = take(ends, moved, axis=1)
    rotation1 = take(frames.rotation, first, axis=1)
    translation = vec_mat(frames.translations(first, second), rotation1)
    rotation = frames.relative_orientations(first, second)
    # between unit quaternions q and q', the rotation by θ ≤ π has |q · q'| = cos θ/2 and
    # θ ≤ π √(1 - cos θ/2)
    cosine = np.abs((take(manifolds.rotation, moved, axis=1) * rotation).sum(axis=0))
    angle = np.pi * np.sqrt(np.maximum(1.0 - cosine, 0.0))
    change = norm(translation - take(manifolds.translation, moved, axis=1))
    change += angle * frames.sizes(first, second)[1]
    isValid[moved] = change <= take(manifolds.breakingThreshold, moved)
    return manifolds if isValid.all() else manifolds.rows(indices(isValid))


def _facing_pairs(frames, first, second, axis):
    """`(pairs, axis (3, K))`: those of K pairs that may touch in the step, along the normals of
    `contact_normals`, and the axes of least penetration of all.

    axis : their axes in the last step, or 0
    A pair with a separating axis, now and after the flight, has no contact.
    """
    pairs = Pairs(frames.hulls, first, second, frames.translations(first, second)).along(axis)
    axis, advance = pairs.axis, frames.advances(first, second, pairs.axis)
    near = indices(pairs.penetration >= -advance)
    pairs = pairs.of(near)
    if len(near) == 0:
        return pairs, axis
    size, radius = frames.sizes(pairs.first, pairs.second)
    separation = frames.reach[pairs.first] + frames.reach[pairs.second] + MARGIN * size
    approach = take(frames.glide, pairs.first, axis=1) - take(frames.glide, pairs.second, axis=1)
    penetration, normal = contact_normals(pairs, separation, approach, FLUSH * radius)
    axis[:, near] = normal
    some = indices(penetration >= -frames.advances(pairs.first, pairs.second, normal))
    return pairs.of(some).along(take(normal, some, axis=1)), axis


def _with_pairs(frames, pairs, valid, ground):
    """Contacts with the ground and those of pairs, see `_facing_pairs`, as for `_new_manifolds`;
    pairs that defer to a support, among these and the valid `Manifolds`, take over its normal.

    A pair whose faces, seen along the normal, do not overlap touches nowhere. Along a support's
    normal, a manifold does not show how deep the two bodies are in each other, and is soon rebuilt.
    """
    isAsked = np.zeros(frames.count + 1, dtype=bool)
    isAsked[pairs.first] = isAsked[pairs.second] = True
    near = indices(isAsked[valid.bodies(frames.count)].any(axis=0))
    known = PlacedManifolds(valid, frames, near)
    asked = slice(known.count, known.count + len(pairs.first))
    ends = (known.first, known.second), (pairs.first, pairs.second), ground[:2]
    normals = np.concatenate((known.normal, pairs.axis, ground[2]), axis=1)
    heights = np.concatenate((known.heights(), -pairs.level[::-1]), axis=1)
    ends = np.concatenate(ends, axis=1)
    normal, isContact = deferring(frames, ends, normals, asked, heights)
    tangent, isOther = tangents(normal), (normal != pairs.axis).any(axis=0)
    if isOther.any():
        pairs.vertex[:, isOther] = pairs.of(indices(isOther)).along(normal[:, isOther]).vertex
    row, corners = pair_corners(pairs, normal, tangent)
    kept = indices(isContact[row])
    isMet = np.bincount(row[kept], minlength=len(pairs.first)) > 0
    met, row = indices(isMet), take(isMet.cumsum() - 1, row[kept]) + len(ground[0])
    keep = np.where(isOther, FLUSH, KEEP)
    found = [take(x, met, axis=-1) for x in (pairs.first, pairs.second, normal, tangent, keep)]
    return vectors.joined(ground, (*found, row, take(corners, kept, axis=1)))


def _ground_contacts(frames, body):
    """Contacts of the bodies (K,) with the ground, as for `_new_manifolds`.

    They are soon rebuilt, too: between old points, a cylinder that wobbles on its edge would sink
    in, and gain energy as it is pushed out.
    """
    ground, keep = np.full(len(body), frames.count), np.full(len(body), FLUSH)
    axes = (GROUND_AXES[:, k].repeat(len(body), axis=1) for k in range(2))
    hulls = frames.hulls
    row, column = vectors.ranges(take(hulls.vertexStart, body), take(hulls.vertexCount, body))
    x, y, z = take(hulls.vertices, column, axis=1)
    height = y + take(frames.position[1, body], row)
    return body, ground, *axes, keep, row, np.array((x, z, -height, np.zeros_like(x)))


def _new_manifolds(frames, first, second, normal, tangent, keep, row, corners):
    """Builds the `Manifolds` of K contacts; not sorted, and without impulses.

    first, second : (K,), bodies; normal, tangent : (3, K), unit
    keep : (K,), change after which they are rebuilt, as a fraction of the lesser thickness
    row, corners : (Q,), contact of each corner, and (4, Q), see `pair_corners`
    """
    order = row.argsort(kind="stable")
    row, corners = take(row, order), take(corners, order, axis=1)
    u, v, height1, height2 = corners
    t, size = frames.translations(first, second), frames.sizes(first, second)[0]
    displacements = take(frames.displacement, np.array((first, second)), axis=1)
    growth = separation_growths(normal, tangent, t, displacements, row, u, v)
    margin = KEEP * size + take(frames.tiedReach, first) + take(frames.tiedReach, second)
    chosen, isPoint = four_points(row, u, v, height2 - height1, growth, size, margin)
    # a point and its partner lie on one line along the normal
    u, v, height1, height2 = take(corners, chosen, axis=1)  # (4, K) each
    flat = tangent[:, None] * u + cross(normal, tangent)[:, None] * v
    point1 = flat + height1 * normal[:, None] + t[:, None]
    point2 = flat + height2 * normal[:, None]
    rotation1, rotation2 = (take(frames.rotation, bodies, axis=1) for bodies in (first, second))
    return Manifolds(
        key=first * (frames.count + 1) + second,
        normal=vec_mat(normal, rotation1),
        tangent=vec_mat(tangent, rotation1),
        anchor1=vec_mat(point1, rotation1[:, None]),
        anchor2=vec_mat(point2, rotation2[:, None]),
        isPoint=isPoint,
        translation=vec_mat(t, rotation1),
        rotation=frames.relative_orientations(first, second),
        breakingThreshold=keep * size,
        impulse=np.zeros(isPoint.shape),
        friction=np.zeros_like(normal),
    )


def separation_growths(normal, tangent, t, displacements, row, u, v):
    """By how much the separations (Q,) of corners at u, v (Q,) grow in a step, to first order.

    n · (d2 + θ2 × r - d1 - θ1 × (r + t)), with r from the second COM

    normal, tangent, t : (3, K), see `Poses.translations`; row : (Q,), of each corner
    displacements : (6, 2, K), and rotation vectors, of the two bodies in the step, without gravity
    """
    (d1, d2), (turn1, turn2) = displacements.reshape(2, 3, 2, -1).swapaxes(1, 2)
    slope = cross(normal, turn2 - turn1)
    growth = dot(normal, d2 - d1) - dot(cross(normal, turn1), t)
    slopes = dot(slope, tangent), dot(slope, cross(normal, tangent))
    return take(growth, row) + take(slopes[0], row) * u + take(slopes[1], row) * v
