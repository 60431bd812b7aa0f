"""Contacts of a step: near pairs, and their old and new manifolds."""

import numpy as np

from Quaternion import multiply
from rbs.geometry.arrays import find_sorted, indices, take
from rbs.geometry.broadphase import grid_overlaps
from rbs.geometry.facets import Pairs
from rbs.geometry.hulls import approximate_supports, tangents
from rbs.geometry.vectors import cross, dot, mat_vec, norm, transpose
from rbs.softstep.manifolds import (
    KEEP,
    KEEP_MOVING,
    NO_MANIFOLDS,
    RIDGE,
    STEPS_KEPT,
    Manifolds,
    contact_normals,
    ground_manifolds,
    pair_manifolds,
    turn_points,
)

# Columns (3, 2, 1): the normal from a body towards the ground, and the first tangent of friction.
GROUND_AXES = np.array([[0.0, 1.0], [-1.0, 0.0], [0.0, 0.0]])[:, :, None]


class Frames:
    """Poses of n bodies and of the ground, at the origin, in n + 1 columns, and their free flight.

    position : (3, n + 1); orientation : (4, n + 1); rotation : (9, n + 1)
    shift, turn : (3, n), displacements and rotation vectors of the step's free flight; reach :
        (n,), largest distance that points of each body move in it
    box : (6, n), bounding boxes of the whole flight, with a margin that keeps the manifolds of
        resting pairs and lets sleeping bodies sleep
    """

    def __init__(self, bodies, timeStep):
        def with_ground(table, ground):
            return np.concatenate((table, np.reshape(ground, (-1, 1))), axis=1)

        self.bodies, self.hulls, self.count = bodies, bodies.hulls, len(bodies.invMass)
        self.position = with_ground(bodies.position, np.zeros(3))
        self.orientation = with_ground(bodies.orientation, (1.0, 0.0, 0.0, 0.0))
        self.rotation = with_ground(bodies.hulls.rotation, np.eye(3))
        sizes = np.stack((self.hulls.thickness, self.hulls.radius))
        self._sizes = with_ground(sizes, (np.inf, np.inf))
        fall = np.where(bodies.isFixed, 0.0, timeStep * np.reshape(bodies.gravity, (3, 1)))
        self.shift = timeStep * (bodies.linVelocity + fall)
        self.turn = timeStep * bodies.angVelocity
        spin = norm(self.turn) * self.hulls.radius
        self.reach = norm(self.shift) + spin
        self.box = bodies.box - (spin + KEEP * self.hulls.thickness)
        self.box += np.minimum(np.concatenate((self.shift, -self.shift)), 0.0)

    def sizes(self, first, second):
        """Returns the lesser thickness and the lesser radius of the two hulls, (2, P)."""
        return np.minimum(take(self._sizes, first, axis=1), take(self._sizes, second, axis=1))

    def translations(self, first, second):
        """Vectors (3, P) from the first COM to the second, or to the ground right below."""
        t = take(self.position, second, axis=1) - take(self.position, first, axis=1)
        t[0::2] = np.where(second == self.count, 0.0, t[0::2])
        return t

    def relative_poses(self, first, second):
        """`(translation (3, P), rotation (4, P))` of the second bodies in the first's frames."""
        t = self.translations(first, second)
        translation = mat_vec(transpose(take(self.rotation, first, axis=1)), t)
        a, b = (take(self.orientation, bodies, axis=1) for bodies in (first, second))
        return translation, np.stack(multiply((a[0], *-a[1:]), b))

    def advances(self, pairs):
        """Distances (P,) by which the flight brings the bodies of `Pairs` closer along their axes.

        A body that withdraws counts as still, because the impulse of another one may stop it.
        """
        bodies = np.concatenate((pairs.second, pairs.first))
        away = np.concatenate((pairs.axis, -pairs.axis), axis=1)
        # n · (r + φ × r) = (n + n × φ) · r
        later = away + cross(away, take(self.turn, bodies, axis=1))
        change = approximate_supports(self.hulls, bodies, later)[0] - pairs.level.ravel()
        change += dot(take(self.shift, bodies, axis=1), away)
        return -np.minimum(change, 0.0).reshape(2, -1).sum(axis=0)


def detect(bodies, hasGround, isStill, kept, timeStep):
    """Detects the contacts of a step: the `Manifolds` of all pairs near enough, and the `Frames`.

    isStill : (n,) bool, bodies that did not move since the last step and will not start to
    kept : `SolverState`, whose pairs are replaced by those of this step; timeStep : s
    """
    frames = Frames(bodies, timeStep)
    first, second = grid_overlaps(frames.box, bodies.isFixed)
    key = first * (frames.count + 1) + second
    axis, known = np.zeros((3, len(key))), find_sorted(key, kept.pairKey)
    axis[:, known >= 0] = kept.pairAxis[:, known[known >= 0]]
    valid = _valid_manifolds(kept.manifolds, frames, key)
    asked = indices(~(isStill[first] & isStill[second]) & (find_sorted(key, valid.key) < 0))
    new, axis[:, asked] = _new_manifolds(frames, first[asked], second[asked], axis[:, asked])
    kept.pairKey, kept.pairAxis = key, axis
    if hasGround:
        new = new.joined(_new_ground_manifolds(frames, valid.key))
    new.inherit(kept.manifolds)
    return valid.joined(new), frames


def _valid_manifolds(manifolds, frames, nearKey):
    """Returns the manifolds of pairs that are still near and in nearly the same relative pose.

    nearKey : (Q,), sorted keys of the near pairs
    """
    first, second = manifolds.bodies(frames.count)
    isNear = find_sorted(manifolds.key, nearKey) >= 0
    isNear |= (second == frames.count) & ~frames.bodies.isFixed[first]
    translation, rotation = frames.relative_poses(first, second)
    # between unit quaternions q and q', the rotation by θ ≤ π has |q · q'| = cos θ/2 and
    # θ ≤ π √(1 - cos θ/2)
    cosine = np.abs((manifolds.rotation * rotation).sum(axis=0))
    angle = np.pi * np.sqrt(np.maximum(1.0 - cosine, 0.0))
    size, radius = frames.sizes(first, second)
    change = norm(translation - manifolds.translation) + angle * radius
    # on the ground, where it shows most and costs least, manifolds are kept no longer
    way = STEPS_KEPT * np.append(frames.reach, -np.inf)
    limit = np.clip(way[first] + way[second], KEEP * size, KEEP_MOVING * size)
    return manifolds.rows(indices(isNear & (change <= limit)))


def _new_manifolds(frames, first, second, axis):
    """`(Manifolds, axis (3, K))` of K pairs; axis : their axes of least penetration, or 0.

    A pair that an axis separates, now and after the flight, has no manifold.
    """
    if len(first) == 0:
        return NO_MANIFOLDS, axis
    pairs = Pairs(frames.hulls, first, second, frames.translations(first, second)).along(axis)
    axis, size = pairs.axis, frames.sizes(first, second)[0]
    reach = frames.reach[first] + frames.reach[second]
    near = indices(pairs.penetration >= -(reach + KEEP * size))
    some = pairs.of(near)
    near = near[some.penetration >= -(frames.advances(some) + KEEP * size[near])]
    if len(near) == 0:
        return NO_MANIFOLDS, axis
    pairs, size, reach = pairs.of(near), size[near], reach[near]
    separation = reach + KEEP * size
    penetration, normal = contact_normals(pairs, separation, RIDGE * size)
    axis[:, near] = normal
    met = indices(penetration >= -separation)
    pairs, normal = pairs.of(met), take(normal, met, axis=1)
    points = pair_manifolds(pairs, normal, penetration[met], size[met], reach[met])
    columns = pairs.first, pairs.second, normal, tangents(normal)
    return _table(frames, *columns, *points), axis


def _new_ground_manifolds(frames, known):
    """Manifolds of bodies near the ground without a valid one; known : keys of the valid ones."""
    isNear = (frames.box[1] <= 0.0) & ~frames.bodies.isFixed
    first, second = np.divmod(known, frames.count + 1)
    isNear[first[second == frames.count]] = False
    body = indices(isNear)
    if len(body) == 0:
        return NO_MANIFOLDS
    ground = np.full(len(body), frames.count)
    arm, isPoint = ground_manifolds(frames, body)
    normal, tangent = (GROUND_AXES[:, k].repeat(len(body), axis=1) for k in range(2))
    below = arm - frames.translations(body, ground)[:, None]
    below[1] = 0.0
    return _table(frames, body, ground, normal, tangent, arm, below, isPoint)


def _table(frames, first, second, normal, tangent, point1, point2, isPoint):
    """Sorted `Manifolds` without impulses; points (3, 4, K) from the COMs, in world axes."""
    into1 = transpose(take(frames.rotation, first, axis=1))
    into2 = transpose(take(frames.rotation, second, axis=1))
    translation, rotation = frames.relative_poses(first, second)
    impulse, offset = np.zeros((2, *isPoint.shape))
    return Manifolds(
        key=first * (frames.count + 1) + second,
        normal=mat_vec(into1, normal),
        tangent=mat_vec(into1, tangent),
        anchor1=turn_points(into1, point1),
        anchor2=turn_points(into2, point2),
        isPoint=isPoint,
        translation=translation,
        rotation=rotation,
        impulse=impulse,
        friction=np.zeros_like(normal),
        offset=offset,
    )
