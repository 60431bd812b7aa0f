"""Contacts of a step: near pairs, and their old and new manifolds.

Nothing here modifies the stored state. New objects are returned, which the step stores at its end.
"""

import numpy as np

from rbs.geometry.arrays import find_sorted, indices, take
from rbs.geometry.broadphase import grid_overlaps
from rbs.geometry.facets import CachedAxes
from rbs.geometry.hulls import approximate_supports, tangents
from rbs.geometry.vectors import cross, dot, mat_vec, norm, transpose
from rbs.softstep.manifolds import (
    KEEP,
    POINTS,
    RIDGE,
    Manifolds,
    contact_normals,
    ground_manifolds,
    pair_manifolds,
    pose_changes,
    relative_poses,
    thickness,
    turn_points,
)

# Columns (3, 2, 1): the normal from a body towards the ground, and the first tangent of friction.
GROUND_AXES = np.array([[0.0, 1.0], [-1.0, 0.0], [0.0, 0.0]])[:, :, None]


class BodyFrames:
    """Poses of n bodies and of the ground, in n + 1 columns; the ground is at the origin.

    position : (3, n + 1); orientation : (4, n + 1); rotation : (9, n + 1)
    radius, size : (n + 1,), of the hulls, and their `thickness`; inf for the ground
    """

    def __init__(self, bodies):
        self.position = np.concatenate((bodies.position, np.zeros((3, 1))), axis=1)
        identity = np.array([[1.0], [0.0], [0.0], [0.0]])
        self.orientation = np.concatenate((bodies.orientation, identity), axis=1)
        identity = np.eye(3).reshape(9, 1)
        self.rotation = np.concatenate((bodies.hulls.rotation, identity), axis=1)
        count = len(bodies.invMass)
        self.radius = np.append(bodies.hulls.radius, np.inf)
        self.size = np.append(thickness(bodies.hulls, np.arange(count)), np.inf)

    def sizes(self, first, second):
        """Returns the size (P,) of the thinner body of each pair."""
        return np.minimum(take(self.size, first), take(self.size, second))

    def translations(self, first, second):
        """Vectors (3, P) from the first COM to the second, or to the ground right below."""
        t = take(self.position, second, axis=1) - take(self.position, first, axis=1)
        t[0::2] = np.where(second == self.position.shape[1] - 1, 0.0, t[0::2])
        return t


class Flight:
    """Free flight of the bodies in a step, which predicts the pairs that can touch.

    shift, turn : (3, n), displacements and rotation vectors; reach : (n,), largest distance that
        points of each body move
    box : (6, n), bounding boxes of the whole flight, as in `Bodies`
    """

    def __init__(self, bodies, timeStep):
        fall = np.where(bodies.isFixed, 0.0, timeStep * np.reshape(bodies.gravity, (3, 1)))
        self.shift = timeStep * (bodies.linVelocity + fall)
        self.turn = timeStep * bodies.angVelocity
        spin = norm(self.turn) * bodies.hulls.radius
        self.reach = norm(self.shift) + spin
        self.box = bodies.box - spin
        self.box += np.minimum(np.concatenate((self.shift, -self.shift)), 0.0)

    def advances(self, hulls, first, second, axes):
        """Distances (P,) by which the bodies of each pair approach along their `CachedAxes`.

        A body that withdraws counts as still, because the impulse of another one may stop it.
        """
        bodies = np.concatenate((second, first))
        away = np.concatenate((axes.axis, -axes.axis), axis=1)
        # n · (r + φ × r) = (n + n × φ) · r
        later = away + cross(away, take(self.turn, bodies, axis=1))
        change = approximate_supports(hulls, bodies, later)[0] - axes.level.ravel()
        change += dot(take(self.shift, bodies, axis=1), away)
        return -np.minimum(change, 0.0).reshape(2, -1).sum(axis=0)


def detect(bodies, hasGround, isStill, kept, timeStep):
    """Detects the contacts of a step: `(manifolds, frames)`.

    isStill : (n,) bool, bodies that did not move since the last step and will not start to
    kept : `SolverState`, whose pairs are replaced by those of this step; timeStep : s

    Returns the `Manifolds` of all pairs near enough to have one, with their warm-starting impulses,
    and the `BodyFrames`.
    """
    count = len(isStill) + 1
    frames = BodyFrames(bodies)
    flight = Flight(bodies, timeStep)
    # the margin keeps the manifolds of resting pairs, and lets sleeping bodies sleep
    box = flight.box - KEEP * frames.size[:-1]
    first, second = grid_overlaps(box, bodies.isFixed)
    key = first * count + second
    axis, known = np.zeros((3, len(key))), find_sorted(key, kept.pairKey)
    axis[:, known >= 0] = kept.pairAxis[:, known[known >= 0]]
    valid = _valid_manifolds(kept.manifolds, frames, bodies, key)
    asked = indices(~(isStill[first] & isStill[second]) & (find_sorted(key, valid.key) < 0))
    new, axis[:, asked] = _new_pair_manifolds(
        bodies, frames, first[asked], second[asked], flight, axis[:, asked]
    )
    kept.pairKey, kept.pairAxis = key, axis
    if hasGround:
        new = new.joined(_new_ground_manifolds(bodies, frames, flight, valid.key, box[1] <= 0.0))
    new.inherit(kept.manifolds, frames.sizes(*new.bodies(count - 1)))
    return valid.joined(new), frames


def _valid_manifolds(manifolds, frames, bodies, nearKey):
    """Returns the manifolds of pairs that are still near and in nearly the same relative pose.

    nearKey : (Q,), sorted keys of the near pairs
    """
    count = len(frames.radius)
    first, second = manifolds.bodies(count - 1)
    isGround = (second == count - 1) & ~np.append(bodies.isFixed, True)[first]
    manifolds = manifolds.rows(indices(isGround | (find_sorted(manifolds.key, nearKey) >= 0)))
    first, second = manifolds.bodies(count - 1)
    t = frames.translations(first, second)
    poses = relative_poses(first, second, t, frames.rotation, frames.orientation)
    smaller = np.minimum(frames.radius[first], frames.radius[second])
    change = pose_changes(manifolds.translation, manifolds.rotation, *poses, smaller)
    return manifolds.rows(indices(change <= KEEP * frames.sizes(first, second)))


def _new_pair_manifolds(bodies, frames, first, second, flight, axis):
    """`(Manifolds, normal (3, K))` of K pairs; axis : (3, K), their last normals, or 0.

    A pair that an axis separates, now and after the flight, is left out.
    """
    hulls, size = bodies.hulls, frames.sizes(first, second)
    axes = CachedAxes(hulls, first, second, frames.translations(first, second), axis)
    normal = axes.axis
    separation = flight.reach[first] + flight.reach[second] + KEEP * size
    near = indices(axes.penetration >= -separation)
    advance = flight.advances(hulls, first[near], second[near], axes.of_pairs(near))
    near = near[axes.penetration[near] >= -(advance + KEEP * size[near])]
    if len(near) == 0:
        return Manifolds.none(), normal
    first, second, size, separation = (table[near] for table in (first, second, size, separation))
    t, axes = frames.translations(first, second), axes.of_pairs(near)
    penetration, along = contact_normals(hulls, first, second, t, axes, separation, RIDGE * size)
    normal[:, near] = along
    met = indices(penetration >= -separation)
    first, second, t, along = first[met], second[met], take(t, met, axis=1), take(along, met, axis=1)
    reach = flight.reach[first] + flight.reach[second]
    points = pair_manifolds(hulls, first, second, t, along, penetration[met], reach)
    return _table(frames, first, second, t, along, tangents(along), *points), normal


def _new_ground_manifolds(bodies, frames, flight, known, isNear):
    """Manifolds of bodies near the ground that have no valid one.

    known : keys of the valid ones; isNear : (n,)
    """
    count = len(isNear) + 1
    isNear &= ~bodies.isFixed
    isNear[known[known % count == count - 1] // count] = False
    body = indices(isNear)
    if len(body) == 0:
        return Manifolds.none()
    ground = np.full(len(body), count - 1)
    t = frames.translations(body, ground)
    shift, turn = flight.shift[:, body], flight.turn[:, body]
    height = bodies.position[1, body]
    arm, isPoint = ground_manifolds(bodies.hulls, body, height, flight.reach[body], shift, turn)
    normal, tangent = (GROUND_AXES[:, k].repeat(len(body), axis=1) for k in range(2))
    below = arm - t[:, None]
    below[1] = 0.0
    return _table(frames, body, ground, t, normal, tangent, arm, below, isPoint)


def _table(frames, first, second, t, normal, tangent, point1, point2, isPoint):
    """Sorted `Manifolds` without impulses; points (3, 4, K) from the COMs, in world axes."""
    into1 = transpose(take(frames.rotation, first, axis=1))
    into2 = transpose(take(frames.rotation, second, axis=1))
    translation, rotation = relative_poses(first, second, t, frames.rotation, frames.orientation)
    key = first * frames.position.shape[1] + second
    return Manifolds(
        key,
        normal=mat_vec(into1, normal),
        tangent=mat_vec(into1, tangent),
        anchor1=turn_points(into1, point1),
        anchor2=turn_points(into2, point2),
        isPoint=isPoint,
        translation=translation,
        rotation=rotation,
        impulse=np.zeros((POINTS, len(key))),
        friction=np.zeros((3, len(key))),
        offset=np.zeros((POINTS, len(key))),
        substep=np.zeros(len(key)),
    )
