"""`Bodies`: the state of thousands of meshes in a few arrays, for the steps on arrays."""

import itertools
import math
from operator import attrgetter

import numpy as np

from Quaternion import multiply, rotation_matrices
from rbs.geometry.broadphase import grid_overlaps, overlapping
from rbs.geometry.hulls import FEATURE_TOLERANCE, HullSet, build_hull, rotate_columns
from rbs.geometry.triples import vector
from rbs.geometry.vectors import indices, mat_vec, norm, ranges, rotate_tensor, row_minima, take
from rbs.stepping.flight import rotation_vectors, torque_free_velocities, turned
from rbs.stepping.meshes import LARGEST_NUMBER, Snapshot, check_distinct, columns_of, table_of
from rbs.stepping.settings import EARTH

# Bytes. glibc returns large freed arrays to the system, so that each step faults in their pages
# again, which takes a quarter of a step in batches. It keeps arrays smaller than the largest one
# freed so far, up to 32 MB (M_MMAP_THRESHOLD in mallopt(3)).
MOST_KEPT = 31 << 20
# Margin of a body's reach, in largest sides of its box, and steps for which it may go on, by up to
# a side. With more, more pairs are compared in each step; with less, they are sought more often.
REACH, AHEAD = 0.2, 8.0
# What stands for a mesh without vertices in a `HullSet`: any hull, because its box is empty.
NO_HULL = build_hull(np.eye(4, 3))
# Rows of the state in a table, and the state of a ground without velocity.
ROWS = {"position": slice(0, 3), "orientation": slice(9, 13)}
ROWS |= {"linVelocity": slice(3, 6), "angVelocity": slice(6, 9)}
STILL = (*np.zeros(9), 1.0, 0.0, 0.0, 0.0)


def bodies_of(meshes, gravity=EARTH, ground=None):
    """Returns the `Bodies` of meshes, in which a step begins: those of the last step, if any."""
    bodies = table_of(meshes) or Bodies(meshes)
    bodies.begin(gravity, ground)
    return bodies


def _without_ground(*rows):
    return property(lambda self: self.state[slice(*rows), :-1])


class Bodies:
    """A list of n meshes as arrays, one column per body, kept from step to step.

    The last of n + 1 columns of state, rotation, invMass and invInertia is the ground: fixed, at
    height 0, with the velocity of its mesh. The other arrays have n columns.

    Between steps, the state of a mesh is its column here, unless somebody has read or assigned the
    attribute; see `TableRow`. A step begins with `begin`, and ends with `write_back`, before which
    the meshes do not change. Arrays that a step leaves are never modified.

    Of the meshes: vertices (3, ΣV), at rest, those of body b are vertexCount[b] from vertexStart[b]
    on; memory, what the last step in batches found; isLeft, whether one has another table by now;
    isOutdated, whether somebody has assigned a mass, a tensor or a load since the last step.

    Of a step, from `begin` on:
    start : `Snapshot`
    state : (13, n + 1), position, linVelocity, angVelocity and orientation. Of these, position,
        motion (9, n), which is the first three, velocity (6, n), … are views without the ground
    invMass : (n + 1,); fallRate : acceleration of free fall
    acceleration : (6, n) or (6, 1), linear by gravity and forces, and angular by torques
    isFixed, isKinematic, isDriven : (n,) bool; fixed with a velocity; under a force or torque

    What follows from the orientations, from `integrate` or `update_rotations` on:
    rotation, invInertia : (9, n + 1), world axes, row by row; the latter is 0 if fixed
    box : (6, n), in the world: least coordinates, then negated greatest ones; inf without vertices
    hulls : HullSet, rotated
    """

    def __init__(self, meshes):
        check_distinct(meshes)
        np.empty(MOST_KEPT, dtype=np.uint8)  # freed at once, and never touched
        self.meshes, self.memory, self._near = tuple(meshes), None, None
        self.isLeft, self.isOutdated = False, True
        self._attributes = [vars(mesh) for mesh in meshes]
        self.vertexCount = np.array([len(m.origVertices) for m in meshes], dtype=np.intp)
        self.vertexStart = self.vertexCount.cumsum() - self.vertexCount
        self.vertices = np.concatenate([np.zeros((0, 3)), *(m.origVertices for m in meshes)])
        self.vertices = np.ascontiguousarray(self.vertices.T)
        self._atRest = HullSet([m.hull or NO_HULL for m in meshes])
        self._state, self._rows = np.tile(np.reshape(STILL, (13, 1)), len(meshes) + 1), {}
        for k, mesh in enumerate(meshes):
            vars(mesh).update({name: getattr(mesh, name) for name in ROWS})  # until `begin`
            mesh._tell_table("isLeft")
            mesh._table, mesh._row = self, k

    def snapshot(self):
        """Returns the present state of the meshes, a `Snapshot`."""
        return snapshot_of(self._present()[0])

    def row(self, name, b):
        """Returns an attribute of body b after the last step, (1, w)."""
        if name not in self._rows:  # a new table, so that references to old rows keep their values
            self._rows[name] = np.ascontiguousarray(self._state[ROWS[name]].T)[:, None]
        return self._rows[name][b]

    def _present(self):
        """`(state (13, n + 1), meshes)`: the state, and those that have rows of their own."""
        p, q, v, w = ROWS
        own = [k for k, m in enumerate(self._attributes) if p in m or q in m or v in m or w in m]
        state = self._state.copy() if own else self._state
        for name, rows in ROWS.items() if own else ():
            state[rows, own] = columns_of(self.meshes, name, own)
        return state, [self.meshes[k] for k in own]

    def begin(self, gravity, ground):
        state, changed = self._present()
        if changed:
            snapshot_of(state).check_start(self.meshes)
            self._state, self._rows = state, {}
            for mesh, name in itertools.product(changed, ROWS):
                mesh.__dict__.pop(name, None)
        self.start = snapshot_of(state)
        self.state = state.copy()
        self.state[:, -1] = STILL
        if ground is not None:
            (x, _, z), velocity = vector(ground.position), vector(ground.linVelocity)
            self.state[:9, -1] = x, 0.0, z, *velocity, *vector(ground.angVelocity)
        self.fallRate, self.hulls = math.hypot(*gravity), self._atRest
        if self.isOutdated:
            self.invMass = np.array([*map(attrgetter("_invMass"), self.meshes), 0.0])
            self.isFixed = self.invMass[:-1] == 0.0
            self.isDriven = np.array([m._load is not None for m in self.meshes], dtype=bool)
            self._invIT, self.isOutdated = self._tensors("invIT"), False
            for mesh, tensor in zip(self.meshes, self._invIT.T.reshape(-1, 3, 3), strict=True):
                mesh._invIT = tensor  # a row of the table
        self.isKinematic = self.isFixed & self.velocity.any(axis=0)
        self.restInvInertia = np.where(self.isFixed, 0.0, self._invIT)
        self.acceleration = np.array([*gravity, 0.0, 0.0, 0.0]).reshape(6, 1)
        if self.isDriven.any():  # as by `Mesh.apply_torque`
            load = np.array([np.ravel(m._load or np.zeros(6)) for m in self.meshes]).T
            angular = mat_vec(self._rotated(self.restInvInertia), load[3:])
            change = self.invMass[:-1] * load[:3], angular
            self.acceleration = self.acceleration + np.concatenate(change)

    motion, velocity, orientation = (_without_ground(*rows) for rows in ((9,), (3, 9), (9, 13)))
    position, linVelocity, angVelocity = (_without_ground(k, k + 3) for k in (0, 3, 6))

    def arms(self, b, vertex):
        """Vertices (3, …) of the bodies b (…), rotated, relative to the COMs."""
        atRest = take(self.vertices, self.vertexStart[b] + vertex, axis=1)
        return mat_vec(take(self.rotation, b, axis=1), atRest)

    def integrate(self, timeStep, gyroscopic=False):
        """Integrates free flight, as the methods of `Mesh`; nothing accelerates fixed bodies."""
        if self.isDriven.any():
            self.angVelocity[:] = self.angVelocity + timeStep * self.acceleration[3:]
        mean = end = self.angVelocity
        if gyroscopic:
            mean, end = self.tumbling_velocities(timeStep)
        fall = timeStep * np.where(self.isFixed, 0.0, self.acceleration[:3])
        linVelocity = self.linVelocity + fall
        position = self.position + timeStep * linVelocity
        orientation = turned(self.orientation, timeStep * mean)
        moved = np.concatenate((position, linVelocity, end, orientation))
        self._store(moved, ~self.isFixed | self.isKinematic)
        self.update_rotations()

    def _store(self, columns, isTheirs):
        """Makes a new state: that of `columns` (13, n) for some bodies (n,)."""
        bodies = np.where(isTheirs, columns, self.state[:, :-1])
        self.state = np.column_stack((bodies, self.state[:, -1]))

    def tumbling_velocities(self, timeStep):
        """`(mean, end)` (3, n) each, see `torque_free_velocities`."""
        inertia = self._tensors("IT")
        state = self.angVelocity, self.orientation, inertia, self.restInvInertia
        both = torque_free_velocities(*state, timeStep)
        return [np.where(self.isFixed, self.angVelocity, np.stack(one)) for one in both]

    def _tensors(self, name):
        """Returns an attribute (3, 3) of all meshes as a new table (9, n)."""
        tensors = np.array(list(map(attrgetter(name), self.meshes)), dtype=np.float64)
        return np.ascontiguousarray(tensors.reshape(-1, 9).T)

    def _rotated(self, tensor):
        """Tensors (9, n) in world axes, at the present orientations."""
        return rotate_tensor(np.array(rotation_matrices(self.orientation)), tensor)

    def turn_freely(self, b, orientation):
        """Gives bodies b (m,) orientations (4, m); angular momenta about the COMs stay the same."""
        momenta = mat_vec(self._rotated(self._tensors("IT")), self.angVelocity)
        self.orientation[:, b] = orientation
        after = mat_vec(self._rotated(self.restInvInertia), momenta)
        self.angVelocity[:] = np.where(self.isFixed, self.angVelocity, after)

    def update_rotations(self):
        self.rotation = np.array(rotation_matrices(self.state[9:]))
        rotation = np.ascontiguousarray(self.rotation[:, :-1])
        invInertia = rotate_tensor(rotation, self.restInvInertia)
        self.invInertia = np.append(invInertia, np.zeros((9, 1)), axis=1)
        self.hulls = self._atRest.rotated(rotation)
        corners, starts = self.hulls.vertices, self.hulls.vertexStart
        low = np.minimum.reduceat(corners, starts, axis=1)
        high = np.maximum.reduceat(corners, starts, axis=1)
        self._relativeBox = np.where(self.vertexCount > 0, np.concatenate((low, -high)), np.inf)
        self.box = self._relativeBox + np.concatenate((self.position, -self.position))

    def box_at(self, b, position):
        """Returns the boxes of the bodies b (m,) at the positions (3, m), as in `box`."""
        return take(self._relativeBox, b, axis=1) + np.concatenate((position, -position))

    def near_pairs(self, box, isStill, way):
        """Returns the pairs i < j (2, P), in this order, whose boxes (6, n) overlap, but for two
        that are still, isStill (n,); way : (3, n), of the bodies in a step

        They are among those of an earlier call as long as each box lies within its reach then.
        """
        if self._near is None or not (box >= self._near[0]).all():
            side = (-box[3:] - box[:3]).max(axis=0)
            reach = box - REACH * side + np.clip(AHEAD * np.concatenate((way, -way)), -side, 0.0)
            self._near = reach, grid_overlaps(reach)
        pairs = overlapping(box, *self._near[1])
        return take(pairs, indices(~take(isStill, pairs).all(axis=0)), axis=1)

    def start_moved(self, position, orientation, timeStep):
        """Lets fixed bodies that somebody has moved since the last step move during this one: from
        their poses then, (3, n) and (4, n), unless they have a velocity of their own, or have
        jumped by more than their radius.
        """
        displacement = self.position - position
        isMoved = displacement.any(axis=0) | (self.orientation != orientation).any(axis=0)
        isMoved &= self.isFixed & ~self.isKinematic & (norm(displacement) <= self.hulls.radius)
        if isMoved.any():
            q = np.array(multiply(self.orientation, (orientation[0], *-orientation[1:])))
            turn = rotation_vectors(np.where(q[0] < 0.0, -q, q))
            moving = position, displacement / timeStep, turn / timeStep, orientation
            self._store(np.concatenate(moving), isMoved)
            self.isKinematic = self.isKinematic | isMoved

    def end_moved(self):
        """Ends the motion of `start_moved` exactly where the bodies were, at rest."""
        isMoved = self.isKinematic & ~self._state[3:9, :-1].any(axis=0)
        if isMoved.any():
            self._store(self._state[:, :-1], isMoved)

    def lowest_points(self):
        """`(b (m,), point (3, m))`: bodies that reach y ≤ 0, and their lowest vertices."""
        # lowest vertex of the hull; rounding may put another vertex of the mesh below it
        corner = self._relativeBox[1] + self.position[1]
        near = indices((corner <= FEATURE_TOLERANCE * self.hulls.radius) & ~self.isFixed)
        count = self.vertexCount[near]
        row, column = ranges(self.vertexStart[near], count)
        rotation = take(self.hulls.rotation, near, axis=1)
        vertices = rotate_columns(rotation, take(self.vertices, column, axis=1), count)
        heights = vertices[1] + self.position[1][near[row]]
        lowest, index = row_minima(heights, row)
        below = indices(lowest <= 0.0)
        b = near[below]
        return b, take(vertices, index[below], axis=1) + take(self.position, b, axis=1)

    def check(self, when):
        """Raises StateError as `Snapshot.check`; when : what the step has just done"""
        if not (np.abs(self.state[:, :-1]) <= LARGEST_NUMBER).all():
            snapshot_of(self.state).check(self.meshes, when)

    def write_back(self):
        """Stores the state of the meshes; fixed meshes without a velocity keep theirs."""
        stays = self.isFixed & ~self.isKinematic
        motion = np.where(stays, self._state[:9, :-1], self.motion)
        self._state, self._rows, self.hulls = self.state.copy(), {}, self._atRest
        self._state[:9, :-1] = motion


def snapshot_of(state):
    """Returns a state (13, n + 1) as a `Snapshot`, whose tables are views."""
    return Snapshot({name: state[rows, :-1] for name, rows in ROWS.items()})
