"""Tables of bodies: the state of thousands of meshes in a few arrays.

Reading order: the state of meshes as arrays, and its checks; free flight; `Bodies`.
"""

import math
import reprlib
from contextlib import contextmanager
from functools import lru_cache
from operator import attrgetter, is_

import numpy as np

from Quaternion import exponentials, multiply, rotation_matrices
from rbs.geometry.arrays import indices, ranges, row_minima, take
from rbs.geometry.hulls import FEATURE_TOLERANCE, NO_HULL, HullSet, rotate_columns
from rbs.geometry.triples import (
    ZERO,
    add,
    cross,
    floats,
    mat_vec,
    rotate_tensor,
    scale,
    sub,
    transpose,
)
from rbs.stepping.settings import EARTH

# Largest number allowed in a state, in any unit. Products of four such numbers are still finite; no
# useful scene comes near it.
LARGEST_NUMBER = 1e75

# glibc gives large freed arrays back to the system, and each step faults in the same pages anew, a
# quarter of the time of a step in batches. It keeps arrays smaller than the largest one freed so
# far, up to 32 MB (M_MMAP_THRESHOLD in mallopt(3)). These bytes are never touched.
_freed = np.empty(31 << 20, dtype=np.uint8)
del _freed

# Parts in which a step integrates the rotation of a tumbling body. More cost time. With two, a body
# that spins about its middle axis at 5 rad/s turns over 0.7 s too early after a minute.
FLIGHT_PARTS = 4

# Attributes that form the state of a mesh, and how many numbers each has.
STATE_WIDTHS = {"position": 3, "orientation": 4, "linVelocity": 3, "angVelocity": 3}
_state = attrgetter(*STATE_WIDTHS)


class StateError(ArithmeticError):
    """A step would give a body a number that is NaN, infinite or beyond LARGEST_NUMBER."""


def check_numbers(columns, meshes, when):
    """Raises StateError, which names the body, if a number is NaN, infinite or too large.

    columns : from `state_columns`; when : what the step has just done, for the message
    """
    for name, table in columns.items():
        isFine = abs(table) <= LARGEST_NUMBER  # false for NaN
        if not isFine.all():
            b = int(isFine.all(axis=0).argmin())
            value = float(table[~isFine[:, b], b][0])
            raise StateError(f"body {b}, {meshes[b].name!r}: {name} holds {value:g} after {when}")


def check_states(meshes, when):
    """Raises StateError, as `check_numbers`, if a number in the state of meshes is invalid."""
    values = [value for mesh in meshes for value in _state(mesh)]
    try:
        table = np.concatenate(values, axis=1)
    except ValueError:  # slow path: different shapes, or no mesh
        table = np.concatenate([np.zeros(1), *values], axis=None)
    if not np.abs(table).max() <= LARGEST_NUMBER:
        check_numbers(state_columns(meshes), meshes, when)


def check_distinct(meshes):
    """Raises ValueError if a mesh is listed twice, because it cannot collide with itself."""
    if len({id(mesh) for mesh in meshes}) < len(meshes):
        twice = next(k for k, mesh in enumerate(meshes) if any(mesh is m for m in meshes[:k]))
        raise ValueError(f"mesh {twice}, {meshes[twice].name!r}, is listed twice")


@contextmanager
def undone_on_error(meshes, mayBeHalfDone):
    """Restores the meshes' state after an error if mayBeHalfDone, and names an invalid mesh."""
    before = {}
    try:
        if mayBeHalfDone:
            before = state_columns(meshes)
        yield
    except BaseException as error:
        for name, columns in before.items():
            for mesh, value in zip(meshes, columns.T[:, None].copy(), strict=True):
                setattr(mesh, name, value)
        if isinstance(error, AttributeError | TypeError | ValueError):
            _name_fault(meshes)
        raise


def _name_fault(meshes):
    """Raises TypeError or ValueError for the first thing that is not a Mesh with a valid state."""
    if not isinstance(meshes, list | tuple):
        raise TypeError(f"meshes must be a list of Mesh, not {reprlib.repr(meshes)}") from None
    for b, mesh in enumerate(meshes):
        for name, width in STATE_WIDTHS.items():
            try:
                floats(getattr(mesh, name), width)
            except AttributeError:
                raise TypeError(f"meshes[{b}] must be a Mesh, not {mesh!r}") from None
            except (TypeError, ValueError):
                what = f"{name} must be {width} numbers, not {reprlib.repr(getattr(mesh, name))}"
                raise ValueError(f"body {b}, {mesh.name!r}: {what}") from None


class TableRow:
    """Descriptor of a `Mesh`'s attribute: its own value, or its row in the last step's `Tables`."""

    def __set_name__(self, kind, name):
        self._name = name

    def __get__(self, mesh, kind=None):
        if mesh is None:
            return self
        vars(mesh)[self._name] = row = mesh._tables.state[self._name][mesh._row]
        return row


def state_columns(meshes):
    """Returns the state of meshes as a dict of new tables (w, n), by name in STATE_WIDTHS."""
    tables = getattr(meshes[0], "_tables", None) if len(meshes) else None
    if tables is not None and tables.meshes == tuple(meshes) and tables.hold_all():
        return tables.columns()
    return {name: _columns(meshes, name, width) for name, width in STATE_WIDTHS.items()}


def _columns(meshes, name, width):
    """Returns an attribute of `width` numbers of all meshes as a table (width, n)."""
    values = list(map(attrgetter(name), meshes))
    try:
        table = np.concatenate(values)
    except ValueError:  # slow path: different shapes, or no mesh
        table = np.concatenate([np.empty(0), *values], axis=None)
    return np.ascontiguousarray(table.reshape(-1, width).T, dtype=np.float64)


def turned(orientation, angle):
    """Unit orientations (4, n) after rotation by vectors φ (3, n): exp(φ/2) ∘ q."""
    rotation = exponentials((0.0, *(0.5 * angle)))
    w, x, y, z = multiply(rotation, orientation)
    return np.stack((w, x, y, z)) / np.sqrt(w * w + (x * x + y * y + z * z))


def torque_free_velocities(angVelocity, orientation, inertia, invInertia, timeStep):
    """Angular velocities without torque: `(mean, end)`, three components each, in world axes.

    mean : constant velocity that leads to the orientation after timeStep seconds
    end : velocity at that time
    angVelocity : world axes; orientation : (w, x, y, z); inertia, invInertia : nine entries, at
        rest about the COM. Components may be floats or arrays (n,)

    Without torque, L = I ω is constant in world axes, and ω = I⁻¹ L follows from the orientation
    alone. After a rotation by the vector θ from the start, with its matrix E, ω = E I₀⁻¹ Eᵀ L, and
    θ' = ω - θ × ω/2 + θ × (θ × ω)/12 - θ × (θ × (θ × (θ × ω)))/720 + …. Four stages of Runge and
    Kutta integrate θ (Munthe-Kaas: Runge-Kutta Methods on Lie Groups. BIT 38, 1998).
    """
    rotation = rotation_matrices(orientation)
    momentum = mat_vec(rotate_tensor(rotation, inertia), angVelocity)
    atStart = rotate_tensor(rotation, invInertia)

    def velocity(angle):
        E = rotation_matrices(exponentials((0.0, *scale(0.5, angle))))
        return mat_vec(E, mat_vec(atStart, mat_vec(transpose(E), momentum)))

    def rate(angle):
        omega = velocity(angle)
        once = cross(angle, omega)
        twice = cross(angle, once)
        fourTimes = cross(angle, cross(angle, twice))
        change = sub(scale(1.0 / 12.0, twice), add(scale(0.5, once), scale(1.0 / 720.0, fourTimes)))
        return add(omega, change)

    h, angle = timeStep / FLIGHT_PARTS, ZERO
    for _ in range(FLIGHT_PARTS):
        k1 = rate(angle)
        k2 = rate(add(angle, scale(0.5 * h, k1)))
        k3 = rate(add(angle, scale(0.5 * h, k2)))
        k4 = rate(add(angle, scale(h, k3)))
        angle = add(angle, scale(h / 6.0, add(add(k1, k4), scale(2.0, add(k2, k3)))))
    mean = scale(1.0 / timeStep if timeStep else 0.0, angle)
    return mean, velocity(angle)


class Tables:
    """Tables of a list of meshes: constant rest vertices and hulls, and the state.

    state : dict, by name in STATE_WIDTHS, of tables (n, 1, w) that the last step has made. A mesh
        has the attribute only once it is read or assigned; see `TableRow`
    vertices : (3, ΣV), at rest; those of body b are vertexCount[b] from vertexStart[b] on
    hulls : HullSet at rest; NO_HULL stands for a mesh without vertices
    """

    def __init__(self, meshes):
        check_distinct(meshes)
        self.meshes, self.state = meshes, {}
        self._invITs = [None] * len(meshes)
        self.vertexCount = np.array([len(m.origVertices) for m in meshes], dtype=np.intp)
        self.vertexStart = self.vertexCount.cumsum() - self.vertexCount
        self.vertices = np.ascontiguousarray(np.concatenate([m.origVertices for m in meshes]).T)
        self.hulls = HullSet([NO_HULL if m.hull is None else m.hull for m in meshes])
        self._rotation, self._rotated = self.hulls.rotation, None

    def hold_all(self):
        """Whether the tables are the whole state: no mesh has read or been assigned any of it."""
        if not all([mesh._tables is self for mesh in self.meshes]):
            return False
        own = [mesh.__dict__ for mesh in self.meshes]
        return not any([name in attributes for name in STATE_WIDTHS for attributes in own])

    def inverse_tensors(self):
        """Returns the invIT of all meshes (9, n), and makes them rows of one table."""
        if not all(map(is_, map(attrgetter("invIT"), self.meshes), self._invITs)):
            self._invIT = _columns(self.meshes, "invIT", 9)
            self._invITs = list(self._invIT.T.reshape(-1, 3, 3))
            for mesh, row in zip(self.meshes, self._invITs, strict=True):
                mesh.invIT = row
        return self._invIT

    def rotated_hulls(self, rotation):
        """Returns the hulls, rotated by matrices (9, n).

        If fewer than half have turned since the last call, as when most bodies sleep, only these
        are rotated: a step of a heap asleep takes a twelfth less. Otherwise the hulls are not kept,
        because they would displace other arrays from the processor's cache.
        """
        turned = indices((rotation != self._rotation).any(axis=0))
        areFew = 2 * len(turned) < len(self.meshes)
        if areFew and self._rotated is not None:
            hulls = self._rotated.with_turned(turned, rotation, self.hulls)
        else:
            hulls = self.hulls.rotated(rotation)
        self._rotation, self._rotated = rotation, hulls if areFew else None
        return hulls

    def columns(self):
        """Returns a copy of the state, as `state_columns`."""
        return {name: table[:, 0].T.copy(order="C") for name, table in self.state.items()}

    def keep(self, columns, holdsAll):
        """Takes over the state of the meshes from tables (w, n), as from `state_columns`.

        holdsAll : result of `hold_all` before the step
        """
        # new tables, so that references to old rows keep their values
        self.state = {n: np.ascontiguousarray(table.T)[:, None] for n, table in columns.items()}
        if not holdsAll:
            for row, mesh in enumerate(self.meshes):
                for name in STATE_WIDTHS:
                    vars(mesh).pop(name, None)
                mesh._tables, mesh._row = self, row


# Tables of the scenes in use. Building them costs more than a step of a small scene.
tables_of = lru_cache(maxsize=4)(Tables)


class Bodies:
    """The meshes of one step as arrays, one column per body.

    motion : (9, n), made up of position, linVelocity and angVelocity; the last two are velocity
    orientation : (4, n); isFixed : (n,) bool; isKinematic : (n,) bool, fixed bodies with a velocity
    invMass : (n,); invInertia : (9, n), world axes, row by row; both 0 if fixed
    box : (6, n), bounding boxes in the world at the last `follow_orientations`: least coordinates,
        then negated greatest ones; inf for a mesh without vertices
    hulls : HullSet, rotated to the orientations
    fallRate : acceleration of free fall
    acceleration : (6, n) or (6, 1), linear by gravity and forces, and angular by torques
    isDriven : (n,) bool, bodies on which a force or torque acts
    vertexCount, vertexStart : (n,), of each body in the table of all vertices

    Call `integrate` or `follow_orientations` before using what depends on the orientations.
    """

    def __init__(self, meshes, gravity=EARTH):
        self.meshes, self.fallRate = meshes, math.hypot(*gravity)
        self._tables = tables_of(tuple(meshes))
        self.vertexStart, self.vertexCount = self._tables.vertexStart, self._tables.vertexCount
        self._isHeld = self._tables.hold_all()
        columns = self._tables.columns() if self._isHeld else state_columns(meshes)
        self.orientation = columns.pop("orientation")
        self.motion = np.concatenate(tuple(columns.values()))
        self._start, self.hulls = self.motion.copy(), self._tables.hulls
        self.invMass = np.array([m.invMass for m in meshes], dtype=np.float64)
        self.isFixed = self.invMass == 0.0
        self.isKinematic = self.isFixed & self.velocity.any(axis=0)
        self.restInvInertia = np.where(self.isFixed, 0.0, self._tables.inverse_tensors())
        self.isDriven = np.array([m.load is not None for m in meshes])
        self.acceleration = np.array([*gravity, 0.0, 0.0, 0.0]).reshape(6, 1)
        if self.isDriven.any():
            self._add_loads()

    def _add_loads(self):
        """Adds the accelerations by forces and torques, as `Mesh.follow_load`."""
        load = np.array([np.ravel(m.load or np.zeros(6)) for m in self.meshes]).T
        inverse = rotate_tensor(rotation_matrices(self.orientation), self.restInvInertia)
        change = self.invMass * load[:3], np.stack(mat_vec(inverse, load[3:]))
        self.acceleration = self.acceleration + np.concatenate(change)

    position = property(lambda self: self.motion[0:3])
    velocity = property(lambda self: self.motion[3:9])
    linVelocity = property(lambda self: self.motion[3:6])
    angVelocity = property(lambda self: self.motion[6:9])

    def arms(self, b, vertex):
        """Vertices (3, …) of the bodies b (…), rotated, relative to the COMs."""
        atRest = take(self._tables.vertices, self.vertexStart[b] + vertex, axis=1)
        return np.stack(mat_vec(take(self.hulls.rotation, b, axis=1), atRest))

    def columns(self):
        """Returns the state as a dict of tables (w, n), by name in STATE_WIDTHS."""
        return {name: getattr(self, name) for name in STATE_WIDTHS}

    def integrate(self, timeStep, gyroscopic=False):
        """Integrates free flight, as the methods of `Mesh`; nothing accelerates fixed bodies."""
        if self.isDriven.any():
            self.motion[6:9] = self.angVelocity + timeStep * self.acceleration[3:]
        mean = end = self.angVelocity
        if gyroscopic:
            mean, end = self.tumbling_velocities(timeStep)
        fall = timeStep * np.where(self.isFixed, 0.0, self.acceleration[:3])
        linVelocity = self.linVelocity + fall
        position = self.position + timeStep * linVelocity
        orientation = turned(self.orientation, timeStep * mean)
        moved = np.concatenate((position, linVelocity, end))
        stays = self.isFixed & ~self.isKinematic
        self.motion = np.where(stays, self.motion, moved)
        self.orientation = np.where(stays, self.orientation, orientation)
        self.follow_orientations()

    def tumbling_velocities(self, timeStep):
        """`(mean, end)` (3, n) each, see `torque_free_velocities`."""
        inertia = self.inertias()
        state = self.angVelocity, self.orientation, inertia, self.restInvInertia
        both = torque_free_velocities(*state, timeStep)
        return [np.where(self.isFixed, self.angVelocity, np.stack(one)) for one in both]

    def inertias(self):
        """Inertia tensors (9, n) in the bodies' frames."""
        return _columns(self.meshes, "IT", 9)

    def angular_momenta(self):
        """Angular momenta (3, n) about the COMs, in world axes."""
        rotation = rotation_matrices(self.orientation)
        inertia = rotate_tensor(rotation, self.inertias())
        return np.stack(mat_vec(inertia, self.angVelocity))

    def set_angular_momenta(self, momenta):
        """Sets the angular velocities of the bodies that are not fixed; momenta : (3, n)."""
        inverse = rotate_tensor(rotation_matrices(self.orientation), self.restInvInertia)
        after = np.stack(mat_vec(inverse, momenta))
        self.motion[6:9] = np.where(self.isFixed, self.angVelocity, after)

    def follow_orientations(self):
        """Computes what depends on the orientations: hulls, boxes, inertia."""
        rotation = np.stack(rotation_matrices(self.orientation))
        self.invInertia = np.stack(rotate_tensor(rotation, self.restInvInertia))
        self.hulls = self._tables.rotated_hulls(rotation)
        corners, starts = self.hulls.vertices, self.hulls.vertexStart
        low = np.minimum.reduceat(corners, starts, axis=1)
        high = np.maximum.reduceat(corners, starts, axis=1)
        self._relativeBox = np.where(self.vertexCount > 0, np.concatenate((low, -high)), np.inf)
        self.box = self.box_at(np.arange(len(self.meshes)), self.position)

    def box_at(self, b, position):
        """Returns the boxes of the bodies b (m,) at the positions (3, m), as in `box`."""
        return take(self._relativeBox, b, axis=1) + np.concatenate((position, -position))

    def start_moved(self, position, orientation, timeStep):
        """Makes fixed bodies that somebody has moved since the last step move during this one.

        position, orientation : (3, n), (4, n), poses after the last step. A body starts there with
            the velocity that brings it to its present pose, unless it has a velocity of its own, or
            has jumped by more than its radius
        """
        displacement = self.position - position
        isMoved = displacement.any(axis=0) | (self.orientation != orientation).any(axis=0)
        isMoved &= self.isFixed & ~self.isKinematic
        isMoved &= np.sqrt((displacement * displacement).sum(axis=0)) <= self.hulls.radius
        self._end = None
        if isMoved.any():
            self._end = isMoved, self._start, self.orientation
            w, *xyz = multiply(self.orientation, (orientation[0], *-orientation[1:]))
            xyz = np.where(w < 0.0, -1.0, 1.0) * xyz
            sine = np.sqrt((xyz * xyz).sum(axis=0))
            turn = xyz * (2.0 * np.arctan2(sine, np.abs(w)) / np.where(sine > 0.0, sine, 1.0))
            moving = np.concatenate((position, displacement / timeStep, turn / timeStep))
            self.motion = np.where(isMoved, moving, self.motion)
            self.orientation = np.where(isMoved, orientation, self.orientation)
            self.isKinematic = self.isKinematic | isMoved

    def end_moved(self):
        """Ends the motion of `start_moved` exactly where the bodies were, at rest."""
        if self._end is not None:
            isMoved, motion, orientation = self._end
            self.motion = np.where(isMoved, motion, self.motion)
            self.orientation = np.where(isMoved, orientation, self.orientation)

    def lowest_points(self):
        """`(b (m,), point (3, m))`: bodies that reach y ≤ 0, and their lowest vertices."""
        # lowest vertex of the hull; rounding may put another vertex of the mesh below it
        corner = self._relativeBox[1] + self.position[1]
        near = indices((corner <= FEATURE_TOLERANCE * self.hulls.radius) & ~self.isFixed)
        count = self.vertexCount[near]
        row, column = ranges(self.vertexStart[near], count)
        rotation = take(self.hulls.rotation, near, axis=1)
        vertices = rotate_columns(rotation, take(self._tables.vertices, column, axis=1), count)
        heights = vertices[1] + self.position[1][near[row]]
        lowest, index = row_minima(heights, row, count.cumsum() - count)
        below = indices(lowest <= 0.0)
        b = near[below]
        return b, take(vertices, index[below], axis=1) + take(self.position, b, axis=1)

    def write_back(self):
        """Stores the state of the meshes; fixed meshes without a velocity keep theirs."""
        self.motion = np.where(self.isFixed & ~self.isKinematic, self._start, self.motion)
        self._tables.keep(self.columns(), self._isHeld)
