"""Rigid bodies: their state, the integrator, collisions, and the time step that runs them all.

Units are whatever the scene uses, lengths and masses alike, with seconds and a gravity of 9.8
length units per second squared along -y. Vectors of one mesh are rows (1, 3), quaternions (1, 4)
with the scalar part first; (3,) and (4,) are accepted wherever one is passed in or assigned.

A step gathers the meshes' state into arrays with one column per body, works on those, and hands
the meshes their columns back. The formulas stand once, on components: vectors are tuples of
floats for a single pair, and arrays (3, n) for many.
"""

import itertools
import math
import time
from contextlib import contextmanager
from functools import lru_cache
from typing import NamedTuple

import numpy as np

import GJK
from GJK import cross, difference, dot, indices, least_of_rows, moved, ranges, take
from Quaternion import QRotate, exponential, multiply, rotation_entries

__version__ = "0.1.0"

# Acceleration of free fall along y, length units / s².
GRAVITY = -9.8

# A pair's facet planes are kept for translations that change by up to this fraction of the two
# radii within a step. Larger: more planes are carried along; smaller: more pairs are looked at
# anew because corrections have moved them further.
PLANE_REACH = 0.02

# No number of a state may be larger: products of four of them are still finite, and nothing that
# is to be looked at is as far away or as fast.
LARGEST_NUMBER = 1e75


# A step makes and drops hundreds of arrays of some hundred kilobytes. The C library of Linux gives
# such memory back to the system each time, and getting it again costs as much as the arithmetic,
# until a larger block has been freed: it then keeps up to twice that size (mallopt(3), dynamic
# M_MMAP_THRESHOLD, below 32 MiB). The block is not touched, so it takes no memory.
KEPT_MEMORY = 31 * 2**20
np.empty(KEPT_MEMORY, dtype=np.uint8)


class StateError(ArithmeticError):
    """A step that would give a body a number that is NaN, infinite or beyond LARGEST_NUMBER."""


def _floats(value, count):
    """`count` Python floats out of an array of any shape with that many entries."""
    return tuple(np.asarray(value, dtype=np.float64).reshape(count).tolist())


def _float(value):
    """A Python float out of a number, or of an array that holds one."""
    return _floats(value, 1)[0]


def _row(value, count):
    """A new (1, count) array out of anything with `count` entries."""
    return np.array(value, dtype=np.float64).reshape(1, count)


# --------------------------------------------------------------------------------------------------
# Formulas, on components: floats for one body, arrays for many
# --------------------------------------------------------------------------------------------------


def _apply(matrix, v):
    """Matrix, nine entries row by row, times vector."""
    if isinstance(v, np.ndarray):
        products = matrix.reshape(3, 3, -1) * v
        return products[:, 0] + products[:, 1] + products[:, 2]
    return (dot(matrix[0:3], v), dot(matrix[3:6], v), dot(matrix[6:9], v))


def _rotated_tensor(r, tensor):
    """R T Rᵀ for a symmetric tensor T, both given as nine entries row by row; symmetric again."""
    columns = [_apply(r, tensor[k::3]) for k in range(3)]  # of R T
    rows = [tuple(column[k] for column in columns) for k in range(3)]
    xx, yy, zz = dot(rows[0], r[0:3]), dot(rows[1], r[3:6]), dot(rows[2], r[6:9])
    xy, xz, yz = dot(rows[0], r[3:6]), dot(rows[0], r[6:9]), dot(rows[1], r[6:9])
    return (xx, xy, xz, xy, yy, yz, xz, yz, zz)


def _sum(a, b):
    """a + b."""
    if isinstance(a, np.ndarray):
        return a + b
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _scaled(factor, v):
    """factor · v."""
    if isinstance(v, np.ndarray):
        return factor * v
    return (factor * v[0], factor * v[1], factor * v[2])


def _divided(v, divisor):
    """v / divisor, which rounds otherwise than 1 / divisor · v."""
    if isinstance(v, np.ndarray):
        return v / divisor
    return (v[0] / divisor, v[1] / divisor, v[2] / divisor)


def _velocity_at(linVelocity, angVelocity, arm):
    """Velocity of the body's point at `arm` from its COM: v + ω × arm."""
    return _sum(linVelocity, cross(angVelocity, arm))


class _BodyState:
    """What a collision reads and changes of a body: components, as floats or as arrays.

    Where only positions or only velocities are worked on, the rest may be None.
    """

    __slots__ = ("angVelocity", "invInertia", "invMass", "linVelocity", "position")

    def __init__(self, invMass, invInertia, position, linVelocity, angVelocity):
        self.invMass = invMass
        self.invInertia = invInertia  # nine entries, world axes
        self.position = position
        self.linVelocity = linVelocity
        self.angVelocity = angVelocity

    def entries(self):
        """What `__init__` takes."""
        return self.invMass, self.invInertia, self.position, self.linVelocity, self.angVelocity

    def moving(self):
        """What a contact changes, as in `_Bodies.motion`."""
        return self.position, self.linVelocity, self.angVelocity

    def push(self, impulse, direction, turn):
        """Applies the impulse `impulse · direction`; turn : as `_response` gives it."""
        self.linVelocity = moved(self.linVelocity, impulse * self.invMass, direction)
        self.angVelocity = moved(self.angVelocity, impulse, turn)


def _response(body, arm, direction):
    """What a unit impulse along `direction` at `arm` from the COM does: `(inverseMass, turn)`.

    turn : the change of the angular velocity, I⁻¹ (r × n)
    inverseMass : the change of the speed at the arm along the direction. Linear part m⁻¹; the
        turning moves the point by turn × r, and ((I⁻¹ (r × n)) × r) · n = (r × n) · I⁻¹ (r × n)
    """
    lever = cross(arm, direction)
    turn = _apply(body.invInertia, lever)
    return body.invMass + dot(lever, turn), turn


class ContactLaw(NamedTuple):
    """How contacts are resolved; see `resolve_collision`."""

    CRCoeff: float
    closingOnly: bool
    mu: float


def _contact_law(CRCoeff, closingOnly, mu):
    """The ContactLaw of a caller's arguments; raises ValueError."""
    law = ContactLaw(_float(CRCoeff), bool(closingOnly), _float(mu))
    if not math.isfinite(law.CRCoeff):
        raise ValueError(f"the restitution must be finite, not {law.CRCoeff:g}")
    if not 0.0 <= law.mu < math.inf:
        raise ValueError(f"the friction must be finite and not negative, not {law.mu:g}")
    return law


def _shares(invMass1, invMass2):
    """What part each of two bodies has in a correction; not both inverse masses may be 0."""
    total = invMass1 + invMass2
    return invMass1 / total, invMass2 / total


def _part(body1, body2, distance, direction):
    """Moves body 2 along the direction and body 1 against it, by `distance` in all.

    Each gives way in proportion to its inverse mass; not both may be 0. Returns how far body 2 has
    moved.
    """
    share1, share2 = _shares(body1.invMass, body2.invMass)
    body1.position = moved(body1.position, -(share1 * distance), direction)
    body2.position = moved(body2.position, share2 * distance, direction)
    return share2 * distance


def _approach(body1, body2, arm1, arm2, direction):
    """Speed at which body 1, at arm1, approaches body 2, at arm2, along the direction."""
    velocity1 = _velocity_at(body1.linVelocity, body1.angVelocity, arm1)
    velocity2 = _velocity_at(body2.linVelocity, body2.angVelocity, arm2)
    return dot(difference(velocity1, velocity2), direction)


def _responses(body1, body2, arm1, arm2, direction):
    """`(inverseMass, turn1, turn2)` of two bodies that touch: the sum of both inverse masses, and
    what turns each; see `_response`."""
    inverseMass1, turn1 = _response(body1, arm1, direction)
    inverseMass2, turn2 = _response(body2, arm2, direction)
    return inverseMass1 + inverseMass2, turn1, turn2


def _slow_down(body1, body2, responses, direction, change, limit=None):
    """Lowers the approach along the direction by `change`; returns the impulse that does it.

    responses : as `_responses` gives them
    An impulse -j n on body 1 and +j n on body 2 lowers the approach by j K, with K the sum of both
    bodies' inverse masses along n. Hence j = change / K, or the limit where that is less.
    """
    inverseMass, turn1, turn2 = responses
    impulse = change / inverseMass
    if limit is not None:
        impulse = min(impulse, limit) if isinstance(impulse, float) else np.minimum(impulse, limit)
    body1.push(-impulse, direction, turn1)
    body2.push(impulse, direction, turn2)
    return impulse


def _resolve(body1, body2, depth, normal, penPoint, law):
    """One contact, in place: `resolve_collision` on components. Not both inverse masses are 0.

    Returns `(impulse, friction, arm1)`: what body 2 receives along the normal, and across it, a
    vector; and where that happens, from the COM of body 1.
    """
    point = moved(penPoint, _part(body1, body2, depth, normal), normal)
    arm1 = difference(point, body1.position)
    arm2 = difference(point, body2.position)
    responses = _responses(body1, body2, arm1, arm2, normal)
    return *_bounce(body1, body2, arm1, arm2, normal, responses, law), arm1


def _bounce(body1, body2, arm1, arm2, normal, responses, law):
    """The impulses of a contact, in place: `(impulse, friction)` as `_resolve` returns them.

    responses : along the normal, as `_responses` gives them
    """
    # Restitution asks that an approach of c become one of -e c.
    change = (1.0 + law.CRCoeff) * _approach(body1, body2, arm1, arm2, normal)
    if law.closingOnly:
        change = change * (change > 0)
    impulse = _slow_down(body1, body2, responses, normal, change)
    if law.mu == 0:
        return impulse, NO_FRICTION
    return impulse, _rub(body1, body2, arm1, arm2, normal, law.mu * impulse)


NO_FRICTION = (0.0, 0.0, 0.0)


def _rub(body1, body2, arm1, arm2, normal, limit):
    """Coulomb friction at a contact, in place; returns the impulse, a vector, that body 2 receives.

    limit : μ times the normal impulse; none where that is negative, as nothing is pressed there.

    With u the velocity of body 1 relative to body 2 at the contact and t the unit vector of its
    part across the normal, an impulse -j t on body 1 and +j t on body 2 lowers u · t by j K, K
    being both bodies' inverse mass along t. The sliding stops at j = u · t / K; friction gives
    that much or its limit, whichever is less, and so never turns the sliding round. The kinetic
    energy changes by -j u · t + j² K / 2, which is at most 0 for 0 ≤ j ≤ u · t / K.
    """
    velocity1 = _velocity_at(body1.linVelocity, body1.angVelocity, arm1)
    velocity2 = _velocity_at(body2.linVelocity, body2.angVelocity, arm2)
    u = difference(velocity1, velocity2)
    across = moved(u, -dot(u, normal), normal)
    squared = dot(across, across)
    if isinstance(squared, float):
        speed = length = math.sqrt(squared)
        if speed == 0.0 or limit <= 0.0:
            return NO_FRICTION
    else:
        speed = np.sqrt(squared)
        length = np.where(speed > 0.0, speed, 1.0)
        limit = np.maximum(limit, 0.0)
    t = _divided(across, length)
    responses = _responses(body1, body2, arm1, arm2, t)
    impulse = _slow_down(body1, body2, responses, t, speed, limit)
    return _scaled(impulse, t)


# When the two points of a constraint coincide, no direction parts them better than another: they
# are parted along this one.
COINCIDENT_DIRECTION = (0.0, 1.0, 0.0)


def _stretch(point1, point2, refValue):
    """`(C, n)` of a distance constraint: C = ‖p1 - p2‖ - refValue, n the unit vector of p1 - p2."""
    d = difference(point1, point2)
    squared = dot(d, d)
    if isinstance(squared, float):
        length = math.sqrt(squared)
        if length == 0.0:
            return -refValue, COINCIDENT_DIRECTION
        return length - refValue, _divided(d, length)
    length = np.sqrt(squared)
    safe = np.where(length > 0, length, 1.0)
    return length - refValue, np.where(length > 0, d / safe, np.array([COINCIDENT_DIRECTION]).T)


def _violates(C, upper, tolerance):
    """Whether a bound is exceeded: C > tolerance for an upper one, C < -tolerance for a lower."""
    return (C > tolerance) & upper | (C < -tolerance) & (upper ^ True)


def _correct_distance(body1, body2, arm1, arm2, C, n, tolerance):
    """Corrects a violated bound on the distance of two points, in place: positions, velocities.

    arm1, arm2 : from each COM to its point. Moving a body leaves the arms and, as the points move
    along the line that joins them, n as they are.

    The COMs move along n until C = 0, and an impulse along n stops the change of the distance,
    J v = 0, unless |J v| ≤ tolerance. J = [n, r1 × n, -n, -(r2 × n)], so J v is the approach along
    n and J M⁻¹ Jᵀ the two inverse masses along it: the impulse is a collision's without
    restitution.
    """
    _part(body1, body2, C, n)
    approach = _approach(body1, body2, arm1, arm2, n)
    responses = _responses(body1, body2, arm1, arm2, n)
    _slow_down(body1, body2, responses, n, approach * (abs(approach) > tolerance))


# --------------------------------------------------------------------------------------------------
# Mesh
# --------------------------------------------------------------------------------------------------


# What a step reads of a mesh, and the shape of each.
STEP_ATTRIBUTES = {
    "position": (1, 3),
    "orientation": (1, 4),
    "linVelocity": (1, 3),
    "angVelocity": (1, 3),
    "invIT": (3, 3),
    "invMass": (),
}
STEP_NAMES = (*STEP_ATTRIBUTES, "currVertices")


class _RowOf:
    """An attribute that is the mesh's row in the tables of its last step, until it is assigned.

    What is assigned lies in the mesh itself, and the tables are told. So a step reads and hands
    out the state of a thousand meshes without touching one of them.
    """

    def __set_name__(self, owner, name):
        self.name = name

    def __get__(self, mesh, owner=None):
        if mesh is None:
            return self
        own = mesh.__dict__
        if self.name in own:
            return own[self.name]
        if own.get("_rows") is None:
            raise AttributeError(f"the mesh has no {self.name} yet")
        return own["_rows"].of(self.name, own["_place"])

    def __set__(self, mesh, value):
        own = mesh.__dict__
        own[self.name] = value
        if own.get("_rows") is not None:
            own["_rows"].assigned[own["_place"]] = None


class Mesh:
    """A rigid body: a tetrahedral mesh with a density, and where it is and how it moves.

    name : str
    origVertices : (V, 3); rest vertices. They are translated so that the COM is the origin, and
        never change afterwards
    faces : (F, 3) int; boundary triangles, counter-clockwise seen from outside
    tets : (T, 4) int; tetrahedra that fill the body without overlap, in any orientation
    density : float > 0, mass per volume
    position : (1, 3); the COM in the world
    orientation : (1, 4), not zero; unit quaternion from rest to world, normalised on entry
    isFixed : bool; a fixed mesh has infinite mass: nothing moves it

    The arrays are copied. Raises ValueError when an array has the wrong shape, an index points
    nowhere, or vertices come without mass. A mesh with no vertices is the ground: like a fixed one,
    without shape.

    Further attributes: currVertices (V, 3), the vertices in the world; linVelocity (1, 3), of the
    COM; angVelocity (1, 3), rad/s, world axes; mass; invMass, 0 if fixed; IT (3, 3), inertia
    tensor about the COM at rest; invIT (3, 3), its inverse, 0 if fixed; volume, of the tetrahedra;
    hullVolume, of the convex hull that collides in its stead; hull, a `GJK.Hull`.
    """

    position, orientation, linVelocity, angVelocity = _RowOf(), _RowOf(), _RowOf(), _RowOf()
    invMass, invIT, currVertices = _RowOf(), _RowOf(), _RowOf()

    def __init__(self, name, origVertices, faces, tets, density, position, orientation, isFixed):
        self.name = name
        self.origVertices = self._table("origVertices", origVertices, 3, np.float64)
        self.faces = self._table("faces", faces, 3, np.int64)
        self.tets = self._table("tets", tets, 4, np.int64)
        self.density = _float(density)
        self.position = _row(position, 3)
        self.orientation = _row(orientation, 4)
        length = math.hypot(*self.orientation[0].tolist())
        if not 0 < length < math.inf:
            raise ValueError(f"mesh {name}: the orientation has no direction")
        self.orientation /= length
        self.linVelocity = np.zeros((1, 3))
        self.angVelocity = np.zeros((1, 3))

        self.mass, self.volume, self.hullVolume, self.hull = 0.0, 0.0, 0.0, None
        self.IT = np.zeros((3, 3))
        if len(self.origVertices) > 0:
            self._init_mass_properties()
        self.set_fixed(isFixed)
        self._refresh_vertices()

    def __getstate__(self):
        """What copies and pickles take along: the attributes, not the tables that they are in."""
        state = {name: getattr(self, name) for name in STEP_NAMES}
        return {**vars(self), **state, "_rows": None}

    def _table(self, what, rows, width, dtype):
        """A copy of `rows` as (n, width); ValueError when it has another shape."""
        table = np.array(rows, dtype=dtype)
        if table.size == 0:
            return table.reshape(0, width)
        if table.ndim != 2 or table.shape[1] != width:
            raise ValueError(
                f"mesh {self.name}: {what} has shape {table.shape} in place of (n, {width})"
            )
        return table

    def _init_mass_properties(self):
        """Sets volume, mass and IT, moves the rest vertices to their COM, and builds the hull.

        Over a tetrahedron with the corners x_i, the integral of x is V (Σ x_i) / 4, and that of
        x xᵀ is V/20 (Σ x_i x_iᵀ + (Σ x_i)(Σ x_i)ᵀ). With C the sum of the latter times the
        density, about the COM, the inertia tensor is tr(C) 1 - C.
        """
        for corners, what in ((self.faces, "face"), (self.tets, "tetrahedron")):
            if corners.size and not 0 <= corners.min() <= corners.max() < len(self.origVertices):
                raise ValueError(f"mesh {self.name}: a {what} names a vertex that is not there")
        corners = self.origVertices[self.tets]  # (T, 4, 3)
        edges = corners[:, 1:] - corners[:, :1]
        volumes = np.abs((edges[:, 0] * np.cross(edges[:, 1], edges[:, 2])).sum(axis=1)) / 6.0
        self.volume = float(volumes.sum())
        self.mass = self.density * self.volume
        if not 0 < self.mass < math.inf:
            raise ValueError(
                f"mesh {self.name}: density {self.density:g} times volume {self.volume:g} "
                "gives no mass"
            )
        centreOfMass = (volumes[:, None] * corners.mean(axis=1)).sum(axis=0) / self.volume
        self.origVertices -= centreOfMass
        corners = corners - centreOfMass
        sums = corners.sum(axis=1)
        outer = (corners[:, :, :, None] * corners[:, :, None, :]).sum(axis=1)
        outer += sums[:, :, None] * sums[:, None, :]
        covariance = self.density * (volumes[:, None, None] / 20.0 * outer).sum(axis=0)
        self.IT = np.trace(covariance) * np.eye(3) - covariance
        self.hull = GJK.build_hull(self.origVertices)
        self.hullVolume = self.hull.volume

    def _refresh_vertices(self):
        """currVertices from rest vertices, orientation and COM."""
        if len(self.origVertices) == 0:
            self.currVertices = np.zeros((0, 3))
        else:
            rotated = QRotate(self.orientation, self.origVertices)
            self.currVertices = rotated + np.reshape(self.position, (1, 3))

    def set_fixed(self, isFixed):
        """Fixes the mesh, at rest where it is, or frees it: from the next step on."""
        self.isFixed = bool(isFixed)
        if self.isFixed:
            self.linVelocity, self.angVelocity = np.zeros((1, 3)), np.zeros((1, 3))
        if self.isFixed or len(self.origVertices) == 0:
            self.invMass = 0.0
            self.invIT = np.zeros((3, 3))
        else:
            self.invMass = 1.0 / self.mass
            self.invIT = np.linalg.inv(self.IT)

    def push(self, impulse, point):
        """Applies an impulse (3,), mass · speed, at a point (3,) of the world; nothing if fixed.

        With r from the COM to the point, v ← v + J / m and ω ← ω + R I⁻¹ Rᵀ (r × J).
        """
        arm = np.reshape(point, (1, 3)) - self.position
        turn = np.cross(arm, np.reshape(impulse, (1, 3)))
        self.linVelocity = self.linVelocity + self.invMass * np.reshape(impulse, (1, 3))
        self.angVelocity = self.angVelocity + turn @ self.get_rotated_inv_IT().T

    def integrate_timestep(self, timeStep):
        """Moves the mesh on by timeStep seconds of free flight; a fixed mesh stays as it is.

        Semi-implicit Euler: v ← v + g h, COM ← COM + v h with the new velocity, orientation ←
        exp(ω h/2) ∘ orientation. The angular velocity stays: the gyroscopic term is left out.
        """
        if self.invMass == 0.0:
            return
        linVelocity, position, orientation = _integrated(
            np.array(_floats(self.linVelocity, 3))[:, None],
            np.array(_floats(self.angVelocity, 3))[:, None],
            np.array(_floats(self.position, 3))[:, None],
            np.array(_floats(self.orientation, 4))[:, None],
            _float(timeStep),
        )
        self.linVelocity, self.position = linVelocity.T.copy(), position.T.copy()
        self.orientation = orientation.T.copy()
        self._refresh_vertices()

    def get_rotated_inv_IT(self):
        """Inverse inertia tensor in world axes, R I⁻¹ Rᵀ: (3, 3)."""
        r = rotation_entries(_floats(self.orientation, 4))
        return np.array(_rotated_tensor(r, _floats(self.invIT, 9))).reshape(3, 3)

    def bounding_box_collision(self, m):
        """Whether the axis-aligned boxes of currVertices of this mesh and of m overlap or touch."""
        if len(self.currVertices) == 0 or len(m.currVertices) == 0:
            return False
        low, high = self.currVertices.min(axis=0), self.currVertices.max(axis=0)
        lowM, highM = m.currVertices.min(axis=0), m.currVertices.max(axis=0)
        return bool((high >= lowM).all() and (highM >= low).all())

    def detect_collision(self, m):
        """Collision of the convex hulls of this mesh and of m, where currVertices says they are.

        Returns `(isCollision, depth, intNormal, intPosition)` as `GJK.is_collide` does, this mesh
        being hull 1: m has to move by depth along intNormal (1, 3) to part, and intPosition (1, 3)
        is the point of m that is deepest inside this mesh. Two fixed meshes never collide.
        """
        if (self.isFixed and m.isFixed) or not self.bounding_box_collision(m):
            return False, 0.0, np.zeros((1, 3)), np.zeros((1, 3))
        return GJK.is_collide(
            self.currVertices[self.hull.vertexIndex], m.currVertices[m.hull.vertexIndex]
        )

    def _body_state(self):
        return _BodyState(
            float(self.invMass), _floats(self.get_rotated_inv_IT(), 9), _floats(self.position, 3),
            _floats(self.linVelocity, 3), _floats(self.angVelocity, 3),
        )  # fmt: skip

    def _take(self, state):
        self.position = _row(state.position, 3)
        self.linVelocity = _row(state.linVelocity, 3)
        self.angVelocity = _row(state.angVelocity, 3)
        self._refresh_vertices()


def _integrated(linVelocity, angVelocity, position, orientation, timeStep):
    """Free flight of n bodies: new `(linVelocity, position, orientation)`, one column a body."""
    linVelocity = linVelocity + np.array([[0.0], [GRAVITY], [0.0]]) * timeStep
    position = position + linVelocity * timeStep
    half = angVelocity * (0.5 * timeStep)
    turn = exponential((np.zeros(half.shape[1]), *half))
    orientation = np.stack(multiply(turn, orientation))
    # a product of unit quaternions drifts from unit length by rounding
    length = np.sqrt(orientation[0] * orientation[0] + dot(orientation[1:], orientation[1:]))
    return linVelocity, position, orientation / length


def resolve_collision(m1, m2, depth, contactNormal, penPoint, CRCoeff, closingOnly=False, mu=0.0):
    """Parts two meshes that interpenetrate and lets them bounce, changing both in place.

    depth : length they interpenetrate by. A negative one moves the meshes the other way, as the
        ground asks for, whose normal points into the mesh
    contactNormal : (1, 3), unit; m2 moves along it, m1 against it
    penPoint : (1, 3); the point of m2 that is deepest inside m1
    CRCoeff : coefficient of restitution, 0 (they stay together) to 1 (they bounce off). The formula
        is followed beyond that too: above 1 every contact gains energy, and a negative one leaves
        the part -CRCoeff of the closing speed as it was
    closingOnly : when true, a contact that already separates receives no impulse. By default the
        impulse is applied whatever the sign of the closing velocity, as the coursework's reference
        does
    mu : coefficient of friction ≥ 0. Unless it is 0, a second impulse at the same point, of at most
        mu times the first one, slows or stops the sliding. A huge one stops any sliding where
        bodies are pressed together, and never turns it round

    The interpenetration is split by inverse mass; one impulse at the contact point, which moves
    along with m2, reverses the closing speed and scales it by the restitution. Two meshes that
    cannot move stay as they are.

    Raises ValueError for a restitution that is not finite, and a friction that is negative or not
    finite.
    """
    law = _contact_law(CRCoeff, closingOnly, mu)
    body1, body2 = m1._body_state(), m2._body_state()
    if body1.invMass + body2.invMass == 0.0:
        return
    depth, normal = _float(depth), _floats(contactNormal, 3)
    if depth < 0 or (depth == 0 and len(m2.origVertices) == 0):
        depth, normal = -depth, (-normal[0], -normal[1], -normal[2])
    _resolve(body1, body2, depth, normal, _floats(penPoint, 3), law)
    m1._take(body1)
    m2._take(body2)


# --------------------------------------------------------------------------------------------------
# The state of all bodies during a step
# --------------------------------------------------------------------------------------------------


class _Shapes:
    """What never changes of a list of meshes: rest vertices and hulls, in tables.

    vertices : (3, ΣV), rest vertices of all meshes; body b has vertexStart[b] … of them
    hulls : GJK.HullSet at rest; a mesh without vertices has a point for a hull
    hullColumn : (ΣVh,), the columns in `vertices` of the hulls' vertices; None where that is all
    hasShape : (n,) bool
    memory : `_Memory` of these meshes
    rows : `_Rows` of these meshes
    """

    def __init__(self, meshes):
        self.vertexCount = np.array([len(m.origVertices) for m in meshes], dtype=np.intp)
        self.vertexStart = self.vertexCount.cumsum() - self.vertexCount
        self.hasShape = self.vertexCount > 0
        self.vertices = np.ascontiguousarray(np.concatenate([m.origVertices for m in meshes]).T)
        point = GJK.build_hull(np.zeros((1, 3)))
        hulls = [point if m.hull is None else m.hull for m in meshes]
        self.hulls = GJK.HullSet(hulls)
        # where a mesh has no vertices, any column does for its point: it meets nothing
        starts = np.minimum(self.vertexStart, max(0, len(self.vertices.T) - 1))
        self.hullColumn = np.concatenate(
            [hull.vertexIndex + start for hull, start in zip(hulls, starts, strict=True)]
        )
        if np.array_equal(self.hullColumn, np.arange(self.vertices.shape[1])):
            self.hullColumn = None
        self.memory = _Memory(len(meshes))
        self.rows = _Rows(self.vertexStart, self.vertexCount)


class _Rows:
    """The tables that a list of meshes has its state in, a row a mesh. See `_RowOf`.

    tables : dict, per attribute of STEP_ATTRIBUTES a table (n, …)
    makeVertices : function that gives currVertices (ΣV, 3); called when somebody asks for them
    assigned : dict, its keys the places of the meshes that something has been assigned to
    isLeft : whether a mesh has its state elsewhere: before the first step, or after one of another
        list of meshes

    A step makes new tables, so that what somebody has kept of the old ones stays as it was.
    """

    def __init__(self, vertexStart, vertexCount):
        self.starts = vertexStart.tolist()
        self.ends = (vertexStart + vertexCount).tolist()
        self.tables = {}
        self.makeVertices = None
        self._currVertices = None
        self.assigned = {}
        self.isLeft = True

    def of(self, name, place):
        """The row of the mesh in this place; of its vertices, all rows."""
        if name == "currVertices":
            if self._currVertices is None:
                self._currVertices = self.makeVertices()
            return self._currVertices[self.starts[place] : self.ends[place]]
        row = self.tables[name][place]
        return row if row.ndim else row.item()

    def gather(self, meshes):
        """Brings the tables up to date with what users have assigned.

        What they have written into their rows is in the tables already.
        """
        if self.isLeft:
            self.assigned = dict.fromkeys(range(len(meshes)))
            for name, shape in STEP_ATTRIBUTES.items():
                table = _table([getattr(m, name) for m in meshes], math.prod(shape))
                self.tables[name] = table.reshape(-1, *shape)
        elif self.assigned:
            self.tables = {name: table.copy() for name, table in self.tables.items()}
            for b in self.assigned:
                for name, shape in STEP_ATTRIBUTES.items():
                    self.tables[name][b] = np.reshape(getattr(meshes[b], name), shape)

    def hand_out(self, meshes, tables, makeVertices):
        """Puts new tables in place of those named, and gives the meshes their rows."""
        self.tables = {**self.tables, **tables}
        self.makeVertices, self._currVertices = makeVertices, None
        for b in self.assigned:
            own = meshes[b].__dict__
            for name in STEP_NAMES:
                own.pop(name, None)
            if own.get("_rows") not in (None, self):
                own["_rows"].isLeft = True
            own["_rows"], own["_place"] = self, b
        self.assigned = {}
        self.isLeft = False


def _places(keys, known):
    """Where (m,) each key stands among the known ones, ≥ 1 and in ascending order; or -1."""
    place = np.minimum(known.searchsorted(keys), len(known) - 1)
    return np.where(known[place] == keys, place, -1)


class _Memory:
    """What the last step found out, to save time in the next one. It never changes a result.

    keys : (P,), sorted; i · n + j of the pairs whose boxes were near each other
    axis : (3, P), along which the pair overlapped least, or was furthest apart
    displaced : (n,), how far corrections moved each body within the step
    """

    def __init__(self, count):
        self.count = count
        self.keys = np.zeros(0, dtype=np.int64)
        self.axis = np.zeros((3, 0))
        self.displaced = np.zeros(count)

    def recall(self, first, second):
        """Axes (3, P) for a `GJK.AxisGuess`: zero for pairs that were not near."""
        if len(self.keys) == 0:
            return np.zeros((3, len(first)))
        place = _places(first * self.count + second, self.keys)
        return np.where(place >= 0, take(self.axis, place, axis=1), 0.0)

    def note(self, first, second, axis):
        """Remembers the pairs of a step, sorted by the order i < j, and their axes (3, P)."""
        self.keys = first * self.count + second
        self.axis = axis


# The tables of the scenes at hand: making them costs more than a step of a small scene.
_shapes = lru_cache(maxsize=4)(_Shapes)


def _table(values, width):
    """A table (n, width) of values with that many entries each, whatever their shapes."""
    try:
        table = np.array(values, dtype=np.float64)
    except ValueError:  # shapes that differ
        table = np.concatenate([np.ravel(value) for value in values], dtype=np.float64)
    return table.reshape(len(values), width)


def _columns(table):
    """A table (n, …), a row a body, as (w, n), a column a body."""
    return np.ascontiguousarray(table.reshape(len(table), -1).T)


class _Bodies:
    """The meshes of one step as arrays, one column a body.

    motion : (9, n); its parts are position, linVelocity, angVelocity, (3, n) each, the last two
        together velocity
    orientation : (4, n)
    invMass : (n,); invInertia : (9, n), world axes, row by row
    box : (6, n), bounding boxes in the world before the collisions: least coordinates, then
        greatest ones negated, so that boxes a and b overlap when box_a ≤ facing_b. A mesh without
        vertices has none
    shapes : `_Shapes`
    hulls : GJK.HullSet, turned to the orientations
    vertices : (3, ΣV), all vertices, turned, relative to their COMs
    """

    def __init__(self, meshes):
        self.meshes = meshes
        self.shapes = _shapes(tuple(meshes))
        rows = self.shapes.rows
        rows.gather(meshes)
        columns = {name: _columns(table) for name, table in rows.tables.items()}
        self.motion = np.concatenate(
            (columns["position"], columns["linVelocity"], columns["angVelocity"])
        )
        self.orientation = columns["orientation"]
        self.restInvInertia = columns["invIT"]
        self.invMass = rows.tables["invMass"]
        self.isFixed = self.invMass == 0.0

    position = property(lambda self: self.motion[0:3])
    velocity = property(lambda self: self.motion[3:9])
    linVelocity = property(lambda self: self.motion[3:6])
    angVelocity = property(lambda self: self.motion[6:9])

    def integrate(self, timeStep):
        """Free flight of all bodies that are not fixed; then everything that turns with them."""
        self.timeStep = timeStep
        free = ~self.isFixed
        linVelocity, position, orientation = _integrated(
            self.linVelocity, self.angVelocity, self.position, self.orientation, timeStep
        )
        moving = np.concatenate((position, linVelocity, self.angVelocity))
        self.motion = np.where(free, moving, self.motion)
        self.orientation = np.where(free, orientation, self.orientation)

        entries = np.stack(rotation_entries(self.orientation))
        self.invInertia = np.stack(_rotated_tensor(entries, self.restInvInertia))
        shapes = self.shapes
        self.vertices = GJK.rotate_columns(entries, shapes.vertices, shapes.vertexCount)
        corners = self.vertices
        if shapes.hullColumn is not None:
            corners = take(corners, shapes.hullColumn, axis=1) if corners.size else None
        self.hulls = shapes.hulls.rotated(entries, corners)
        low, high = self.hulls.boxes()
        self.relativeBox = np.where(shapes.hasShape, np.concatenate((low, -high)), np.inf)
        self.box = self.box_of(np.arange(len(self.meshes)), self.position)

    def check_numbers(self, when):
        """Raises StateError, which names the body, where a number is NaN, infinite or too large.

        when : what the step has just done, for the message
        """
        # NaN is the maximum of whatever holds it, and not less than anything
        largest = abs(self.motion).max(), abs(self.orientation).max()
        if largest[0] <= LARGEST_NUMBER and largest[1] <= LARGEST_NUMBER:
            return
        for name in ("position", "orientation", "linVelocity", "angVelocity"):
            values = getattr(self, name)
            wrong = ~(abs(values) <= LARGEST_NUMBER)
            if wrong.any():
                b = int(wrong.any(axis=0).argmax())
                value = float(values[wrong[:, b], b][0])
                raise StateError(
                    f"body {b}, {self.meshes[b].name!r}: {name} holds {value:g} after {when}"
                )

    def box_of(self, b, position):
        """The boxes of a body b or the bodies b (m,) at these positions, as in `box`."""
        return take(self.relativeBox, b, axis=1) + np.concatenate((position, -position))

    def state(self, b):
        """`_BodyState` of body b, in floats."""
        return _BodyState(
            float(self.invMass[b]), self.invInertia[:, b].tolist(), self.position[:, b].tolist(),
            self.linVelocity[:, b].tolist(), self.angVelocity[:, b].tolist(),
        )  # fmt: skip

    def states(self, b):
        """`_BodyState` of the bodies b (m,), in arrays."""
        motion = take(self.motion, b, axis=1)
        return _BodyState(
            take(self.invMass, b), take(self.invInertia, b, axis=1),
            motion[0:3], motion[3:6], motion[6:9],
        )  # fmt: skip

    def take(self, b, state):
        """Sets a body b, or bodies (m,), to a state that something has changed."""
        self.motion[:, b] = np.concatenate(state.moving())

    def write_back(self):
        """Hands the meshes their state: rows of the step's tables."""
        tables = {
            name: np.ascontiguousarray(getattr(self, name).T)[:, None]
            for name in ("position", "orientation", "linVelocity", "angVelocity")
        }
        self.shapes.rows.hand_out(self.meshes, tables, self.current_vertices)

    def current_vertices(self):
        """The vertices in the world, a row each: (ΣV, 3)."""
        owner = np.arange(len(self.meshes)).repeat(self.shapes.vertexCount)
        return np.ascontiguousarray((self.vertices + take(self.position, owner, axis=1)).T)


# --------------------------------------------------------------------------------------------------
# Collisions of a step
# --------------------------------------------------------------------------------------------------


# Boxes to compare with all others at a time when near pairs are looked for: 256 of them make
# tables of some megabytes with a few thousand bodies.
BOX_ROWS = 256

# A level of the grid has columns as wide as its largest box and holds boxes down to this fraction
# of it. Smaller ones would crowd the columns, and more levels would cost more look-ups.
GRID_SHRINK = 1 / 8
# Up to so many cells along a side, a cell's number is its place; beyond, only cells in use count.
MOST_CELLS = 1e6


def _facing(box):
    """What the box (6, …) of another body has to be at most, in each row, to overlap this one."""
    return -np.concatenate((box[3:], box[:3]))


def all_overlaps(box, isFixed):
    """Pairs i < j whose boxes overlap, `(first, second)` in that order, by comparing all of them.

    box : (6, n), least coordinates and greatest ones negated; isFixed : (n,) bool, two such bodies
    are no pair
    """
    facing = _facing(box)
    found = [np.zeros((0, 2), dtype=np.intp)]
    for begin in range(0, box.shape[1], BOX_ROWS):
        rows = slice(begin, begin + BOX_ROWS)
        near = box[0, begin:] <= facing[0, rows, None]
        for k in range(1, 6):
            near &= box[k, begin:] <= facing[k, rows, None]
        near &= ~(isFixed[rows, None] & isFixed[begin:])
        found.append(np.argwhere(np.triu(near, 1)) + begin)
    return np.concatenate(found).T


def grid_levels(box):
    """Sorts boxes into the levels of a grid, from the largest: yields `(level, smaller, width)`.

    box : (6, n), as for `all_overlaps`; level, smaller : indices of the boxes of this level and of
    all later ones; width : the largest side of this level's boxes
    """
    extent = (-box[3:] - box[:3]).max(axis=0)
    rest = indices(np.isfinite(extent))
    while len(rest):
        sides = extent[rest]
        largest = float(sides.max())
        isLarge = sides >= GRID_SHRINK * largest
        level, rest = rest[isLarge], rest[~isLarge]
        yield level, rest, max(largest, np.finfo(float).tiny)


def grid_overlaps(box, isFixed):
    """The same pairs in the same order as `all_overlaps`, by uniform grids.

    Boxes are sorted into levels by their largest side. Each level is a grid over y and z whose
    columns are as wide as its largest box, and within a column the boxes are sorted along x. A box
    stands in the one column that holds its least corner; of two boxes that overlap, the columns are
    the same or neighbours, and along x the least corner of one lies in the other. A box looks into
    its own level and into those of larger boxes, so one huge floor among small boxes is a level of
    its own and costs each of them one candidate.
    """
    found = []
    for level, smaller, width in grid_levels(box):
        found.append(_level_overlaps(box, level, level, width))
        if len(smaller):
            found.append(_level_overlaps(box, level, smaller, width))
    return np.stack(np.divmod(_pair_keys(found, isFixed), max(1, len(isFixed))))


def _pair_keys(found, isFixed):
    """The keys i · n + j of pairs i < j, in ascending order, as often as they were found.

    found : list of pairs (2, m), in any order; what are two fixed bodies, or one, is left out
    """
    first, second = np.concatenate([np.zeros((2, 0), dtype=np.intp), *found], axis=1)
    some = indices((first != second) & ~(isFixed[first] & isFixed[second]))
    first, second = first[some], second[some]
    keys = np.minimum(first, second) * len(isFixed) + np.maximum(first, second)
    keys.sort()
    return keys


def _ranks(values):
    """Whole numbers ≥ 1 for whole floats: neighbours (±1) stay neighbours, and others do not become
    any."""
    least = values.min()
    if values.max() - least < MOST_CELLS:
        return (values - least).astype(np.int64) + 1
    distinct, rank = np.unique(values, return_inverse=True)
    steps = np.minimum(np.diff(distinct, prepend=distinct[:1]), 2.0)
    return steps.cumsum().astype(np.int64)[rank] + 1


def _level_overlaps(box, level, looking, width):
    """Pairs (2, P) of a body in `level` and one in `looking` whose boxes overlap, each pair once.

    level : indices of boxes with sides of at most `width`; looking : the same array, or indices of
    other boxes, none larger.
    """
    inside = looking is level
    bodies = level if inside else np.concatenate((level, looking))
    y = _ranks(np.floor(box[1, bodies] / width))
    z = _ranks(np.floor(box[2, bodies] / width))
    stride = int(z.max()) + 2
    column = y * stride + z
    # the level's boxes by column, and along x within a column
    along = box[0, level].argsort()
    lowX = box[0, level][along]
    place = np.empty(len(level), dtype=np.int64)
    place[along] = np.arange(len(level))
    count = len(level)
    key = column[:count] * (count + 1) + place
    entries = key.argsort()
    key = key[entries]
    if inside:  # bisection is faster for what comes in order
        looking, place, column = level[entries], place[entries], column[entries]
    # the range along x, in places, that can overlap a looking box
    end = lowX.searchsorted(-box[3, looking], side="right")
    begin = place + 1 if inside else lowX.searchsorted(box[0, looking] - width, side="left")

    near = np.array([dy * stride + dz for dy in (-1, 0, 1) for dz in (-1, 0, 1)])
    near = (column[-len(looking) :] + near[:, None]) * (count + 1)
    first = key.searchsorted((near + begin).ravel())
    length = key.searchsorted((near + end).ravel()) - first
    some = indices(length > 0)
    row, place = ranges(take(first, some), take(length, some))
    i, j = level[entries[place]], looking[some[row] % len(looking)]
    # within a level, the range along x holds exactly those that overlap there
    return _overlapping(box, i, j, (2, 1) if inside else (2, 1, 0))


def _overlapping(box, i, j, axes=(2, 1, 0)):
    """Those of the pairs i (m,), j (m,) whose boxes overlap along the axes: (2, P)."""
    for k in axes:
        overlap = (take(box[k], i) <= -take(box[k + 3], j)) & (
            take(box[k], j) <= -take(box[k + 3], i)
        )
        i, j = i[overlap], j[overlap]
    return np.stack((i, j))


BROAD_PHASES = {"all": all_overlaps, "grid": grid_overlaps}


def _overlapping_pairs(bodies):
    """Yields the pairs i < j, in that order, whose boxes overlap when their turn comes.

    The boxes may be moved between two pairs. Pairs of two fixed bodies are left out.
    """
    for i in range(len(bodies.meshes)):
        later = i + 1
        while later < len(bodies.meshes):
            limit = _facing(bodies.box[:, i])
            overlap = (bodies.box[:, later:] <= limit[:, None]).all(axis=0)
            if bodies.isFixed[i]:
                overlap &= ~bodies.isFixed[later:]
            following = int(overlap.argmax())
            if not overlap[following]:
                break
            later += following + 1
            yield i, later - 1


def _near_planes(bodies, first, second, reach, foresee=False):
    """`(planes, t, pen, normal, isNear)` of the pairs whose boxes are near each other at the start.

    first, second : (P,), sorted by the order i < j; reach : (n,), how far a body may move
    foresee : whether the reach is more where contacts are going to move bodies further
    planes : GJK.FacetPlanes; t : (3, P), centre of the second minus centre of the first
    pen : (P,), by how much the pair overlaps now, or is at least apart where that is negative
    normal : (3, P), along which it does
    isNear : (P,) bool; the rest stay apart however their bodies move within their reach
    """
    memory = bodies.shapes.memory
    t = take(bodies.position, second, axis=1) - take(bodies.position, first, axis=1)
    both = reach[first] + reach[second]
    guess = memory.recall(first, second)
    if foresee:
        guess = GJK.AxisGuess(bodies.hulls, first, second, t, guess)
        both = np.maximum(both, _foreseen_moves(bodies, first, second, guess.pen))
    planes = GJK.facet_planes(bodies.hulls, first, second, t, both, guess)
    pen, normal = planes.nearest_of_all(t)
    isNear = pen >= -both
    memory.note(first, second, normal)
    return planes, t, pen, normal, isNear


def _foreseen_moves(bodies, first, second, pen):
    """How far (P,) contacts are likely to move the two bodies of a pair, together.

    pen : (P,), by how much each pair overlaps at most

    A body gives way to the deepest of its contacts by its share. As the axes that tell the overlap
    are guesses, it counts up to what the two bodies have travelled in this step.
    """
    share1, share2 = _shares(take(bodies.invMass, first), take(bodies.invMass, second))
    # fixed bodies are at rest, and nothing has pushed the others since their flight
    travel = np.sqrt(dot(bodies.linVelocity, bodies.linVelocity)) * bodies.timeStep
    travelled = take(travel, first) + take(travel, second)
    depth = np.minimum(np.maximum(pen, 0.0), travelled)
    moves = np.zeros(len(bodies.invMass))
    np.maximum.at(moves, first, share1 * depth)
    np.maximum.at(moves, second, share2 * depth)
    return take(moves, first) + take(moves, second)


def _pair_contact(bodies, i, j, planes, starts, row):
    """`(depth, normal, point)` of the pair i, j in the present positions, or None.

    depth ≥ 0; normal and point as tuples, for body j as the second one
    planes, starts, row : GJK.FacetPlanes and the translations (3, P) that they were made at, and
        which of their pairs this is. If None, or where the planes do not hold at the present
        translation, the pair is worked out now.
    """
    position1, position2 = bodies.position[:, i].tolist(), bodies.position[:, j].tolist()
    t = difference(position2, position1)
    size = float(bodies.hulls.radius[i] + bodies.hulls.radius[j])
    apart = -GJK.TOUCH_TOLERANCE * size
    if row is not None:
        pen, normal = planes.nearest(row, t)
        if pen < apart:
            return None
    if row is None or not planes.hold(row, pen, difference(t, starts[:, row].tolist())):
        pair = np.array([[i], [j]])
        guess = None if row is None else np.array([normal]).T
        exact = GJK.facet_planes(bodies.hulls, *pair, np.array([t]).T, np.zeros(1), guess)
        pen, normal = exact.nearest(0, t)
        if pen < apart:
            return None
    vertices1, vertices2 = bodies.hulls.body_vertices(i), bodies.hulls.body_vertices(j)
    tolerance = GJK.FEATURE_TOLERANCE * size
    point = GJK.contact_point(vertices1, vertices2, t, normal, tolerance)
    return max(pen, 0.0), normal, _sum(point, position2)


def _resolve_pairs(bodies, law, report):
    """Detects and resolves every pair i < j, in that order, each seeing the earlier corrections.

    Resolutions only translate bodies, so what depends on orientations alone, the facet planes of
    the Minkowski differences, is worked out for all near pairs together at the step's start. At a
    pair's turn the planes meet its present translation.
    """
    if len(bodies.meshes) < 2:
        return
    reach = PLANE_REACH * bodies.hulls.radius
    first, second = all_overlaps(bodies.box - reach, bodies.isFixed)
    planes, t, *_ = _near_planes(bodies, first, second, reach)
    rows = {pair: row for row, pair in enumerate(zip(first.tolist(), second.tolist(), strict=True))}
    for i, j in _overlapping_pairs(bodies):
        report.candidatePairs += 1
        contact = _pair_contact(bodies, i, j, planes, t, rows.get((i, j)))
        if contact is not None:
            body1, body2 = bodies.state(i), bodies.state(j)
            impulses = _resolve(body1, body2, *contact, law)
            for b, body in ((i, body1), (j, body2)):
                bodies.take(b, body)
                bodies.box[:, b] = bodies.box_of(b, bodies.position[:, b])
            report.add(Contact(i, j, *contact, *impulses))


# What a body's reach is at least, relative to its radius: corrections move most bodies less.
LEAST_REACH = 0.005

# A body gets this many times its displacement in one step as its reach in the next, or when the
# step's collisions are done again.
REACH_GROWTH = 2.0


class _ContactBatches:
    """The pairs that can touch in this step, in batches that are worked on one after the other.

    No two pairs of a batch share a body which can move. All pairs are known beforehand as long as
    no body moves further than its reach (n,), and often beyond: see `overlooked`.

    first, second : (P,), sorted by batch, and within a batch by the order i < j
    rank : (P,), place of each pair in the order i < j
    starts : (B + 1,), where the batches begin
    planes : GJK.FacetPlanes of the pairs; planeStart (P,), where those of a pair begin, and
        place (K,), the pair of each plane, both counted from the batch's first one
    invMass : of the first and of the second bodies, (P,) each
    t (3, P) : translations that the planes were made at
    apart (P,) : the pen below which a pair counts as apart; tolerance (P,), see GJK.contact_point
    keys : (Q,), of the pairs whose boxes are near each other, i · n + j; gap (Q,), by how much each
        is apart, -inf for the pairs that are in the batches, along the axis (3, Q)
    """

    def __init__(self, bodies, reach, broadPhase, pairOrder):
        self.bodies = bodies
        self.reach = reach
        self.pairOrder = pairOrder
        first, second = BROAD_PHASES[broadPhase](bodies.box - reach, bodies.isFixed)
        self.keys = first * len(reach) + second
        planes, t, pen, self.axis, isNear = _near_planes(bodies, first, second, reach, foresee=True)
        size = bodies.hulls.radius[first] + bodies.hulls.radius[second]
        self.gap = np.where(isNear, -np.inf, -pen - GJK.FEATURE_TOLERANCE * size)
        near = indices(isNear)
        self._arrange(first[near], second[near], near, planes, t)

    def _arrange(self, first, second, rows, planes, t):
        """Sorts pairs, given in the order i < j, into batches.

        rows : where each pair is in planes and t
        """
        bodies = self.bodies
        assign = PAIR_ORDERS[self.pairOrder]
        batch = assign(first.tolist(), second.tolist(), bodies.isFixed.tolist())
        self.rank = batch.argsort(kind="stable")
        self.starts = batch[self.rank].searchsorted(np.arange(batch.max(initial=-1) + 2))
        self.first, self.second = first[self.rank], second[self.rank]
        rows = rows[self.rank]
        self.planes = planes.of_pairs(rows)
        begin = self.starts[batch[self.rank]]  # of each pair's batch
        self.planeStart = self.planes.start[:-1] - self.planes.start[begin]
        self.place = (np.arange(len(rows)) - begin).repeat(np.diff(self.planes.start))
        self.invMass = take(bodies.invMass, self.first), take(bodies.invMass, self.second)
        self.t = take(t, rows, axis=1)
        size = bodies.hulls.radius[self.first] + bodies.hulls.radius[self.second]
        self.apart = -GJK.TOUCH_TOLERANCE * size
        self.tolerance = GJK.FEATURE_TOLERANCE * size

    def part(self):
        """Parts the pairs that touch at their turn, batch by batch; returns the `_Contacts`."""
        found = [
            self._part_batch(begin, end) for begin, end in itertools.pairwise(self.starts.tolist())
        ]
        return _Contacts(self, found)

    def _part_batch(self, begin, end):
        """Parts the pairs from `begin` to `end` that touch now.

        Returns `(touches, depth, normal, before1, before2, after1, after2, shift2)`, (m,) or (3, m)
        for all pairs of the batch: whether they touch, how deep and along which normal; where their
        bodies were and, if they touch, are; how far the second one has moved along the normal.
        """
        bodies, planes = self.bodies, self.planes
        some = slice(begin, end)
        first, second = self.first[some], self.second[some]
        before1 = take(bodies.position, first, axis=1)
        before2 = take(bodies.position, second, axis=1)
        t = before2 - before1
        # the pair's deepest plane, or the one that parts it most
        columns = slice(planes.start[begin], planes.start[end])
        normals, place = planes.normal[:, columns], self.place[columns]
        pens = planes.offset[columns] - dot(normals, take(t, place, axis=1))
        pen, nearest = least_of_rows(pens, place, self.planeStart[some])
        normal = take(normals, nearest, axis=1)
        apart, tolerance = self.apart[some], self.tolerance[some]
        touches = pen >= apart
        stale = indices(touches & ~planes.hold(some, pen, t - self.t[:, some]))
        if len(stale):
            exact = GJK.facet_planes(
                bodies.hulls, first[stale], second[stale], t[:, stale], np.zeros(len(stale)),
                normal[:, stale],
            )  # fmt: skip
            pen[stale], normal[:, stale] = exact.nearest_of_all(t[:, stale])
            touches = pen >= apart
        # where hulls overlap by more than rounding, so do their boxes
        doubtful = indices(touches & (pen <= tolerance))
        if len(doubtful):
            box1 = bodies.box_of(first[doubtful], before1[:, doubtful])
            box2 = bodies.box_of(second[doubtful], before2[:, doubtful])
            touches[doubtful] = (box1 <= _facing(box2)).all(axis=0)
        depth = np.maximum(pen, 0.0)
        body1, body2 = (
            _BodyState(invMass[some], None, position, None, None)
            for invMass, position in zip(self.invMass, (before1, before2), strict=True)
        )
        shift2 = _part(body1, body2, depth, normal)
        hits = indices(touches)
        for own, body in ((first, body1), (second, body2)):
            bodies.position[:, own[hits]] = take(body.position, hits, axis=1)
        return touches, depth, normal, before1, before2, body1.position, body2.position, shift2

    def include(self, first, second, displaced):
        """Adds pairs that were overlooked. The bodies are back where they were at the start.

        displaced : (n,), how far from there each has been
        """
        count = len(displaced)
        keys = first * count + second
        known = _places(keys, self.keys)
        self.gap[known[known >= 0]] = -np.inf
        new = np.sort(keys[known < 0])
        place = self.keys.searchsorted(new)
        self.keys = np.insert(self.keys, place, new)
        self.gap = np.insert(self.gap, place, -np.inf)
        self.axis = np.insert(self.axis, place, 0.0, axis=1)

        bodies = self.bodies
        t = take(bodies.position, second, axis=1) - take(bodies.position, first, axis=1)
        reach = np.maximum(self.reach, REACH_GROWTH * displaced)
        planes = GJK.facet_planes(bodies.hulls, first, second, t, reach[first] + reach[second])
        # all pairs in the order i < j
        keys = np.concatenate((self.first * count + self.second, keys))
        order = keys.argsort()
        keys = keys[order]
        planes = GJK.FacetPlanes.joined((self.planes, planes))
        t = np.concatenate((self.t, t), axis=1)
        self._arrange(*np.divmod(keys, count), order, planes, t)

    def overlooked(self, visits):
        """Pairs `(first, second)` that are not among these and would have touched at their turn.

        visits : `_Visits`, after all batches
        """
        bodies, displaced = self.bodies, visits.furthest
        count = len(displaced)
        strays = indices(displaced > self.reach)
        # pairs that were too far apart, but whose bodies have been far enough from their places to
        # close the gap, and at their turn are so along the axis
        i, j = np.divmod(self.keys, count)
        met = indices((displaced[i] + displaced[j] >= self.gap) & (self.gap > -np.inf))
        first, second = i[met], j[met]
        start1, start2 = take(visits.start, first, axis=1), take(visits.start, second, axis=1)
        position1, position2 = visits.places(first, second)
        approach = (position2 - start2) - (position1 - start1)
        gap = self.gap[met] + dot(take(self.axis, met, axis=1), approach)
        met = indices(gap <= 0.0)
        first, second = first[met], second[met]
        if len(strays):
            wider = bodies.box - np.maximum(displaced, self.reach)
            keys = _overlaps_of(strays, wider, bodies.isFixed)
            others = np.divmod(keys[_places(keys, self.keys) < 0], count)
            first, second = np.concatenate(((first, second), others), axis=1)
        position1, position2 = visits.places(first, second)
        boxes = bodies.box_of(first, position1) <= _facing(bodies.box_of(second, position2))
        meet = indices(boxes.all(axis=0))
        first, second = first[meet], second[meet]
        if len(first) == 0:
            return first, second
        t = take(position2, meet, axis=1) - take(position1, meet, axis=1)
        none = np.zeros(len(meet))
        pen, _ = GJK.facet_planes(bodies.hulls, first, second, t, none).nearest_of_all(t)
        size = bodies.hulls.radius[first] + bodies.hulls.radius[second]
        touching = pen >= -GJK.TOUCH_TOLERANCE * size
        return first[touching], second[touching]


def _overlaps_of(some, box, isFixed):
    """The keys, as of `_pair_keys`, of the overlaps that have a body of `some` (m,), each once.

    The boxes of each level are sorted along x, so that those near a box of `some` are a range.
    """
    found = []
    for level, _, width in grid_levels(box):
        along = level[box[0, level].argsort()]
        lowX = box[0, along]
        begin = lowX.searchsorted(box[0, some] - width, side="left")
        end = lowX.searchsorted(-box[3, some], side="right")
        row, place = ranges(begin, np.maximum(end - begin, 0))
        found.append(_overlapping(box, some[row], along[place]))
    keys = _pair_keys(found, isFixed)
    return keys[np.diff(keys, prepend=-1) > 0]  # two of `some` have found each other twice


class _Contacts:
    """The pairs that a step has parted, H of them in the order of work.

    starts : (B + 1,), where each batch of them begins
    first, second : (H,), their bodies; rank : (H,), their places in the order i < j
    tolerance : (H,), see GJK.contact_point
    depth … shift2 : as `_ContactBatches._part_batch` gives them
    """

    def __init__(self, batches, found):
        """found : what `_part_batch` has given for each batch, at least one"""
        touches, *columns = (np.concatenate(part, axis=-1) for part in zip(*found, strict=True))
        rows = indices(touches)
        self.starts = rows.searchsorted(batches.starts)
        columns += batches.first, batches.second, batches.rank, batches.tolerance
        (
            self.depth, self.normal, self.before1, self.before2, self.after1, self.after2,
            self.shift2, self.first, self.second, self.rank, self.tolerance,
        ) = (take(column, rows, axis=-1) for column in columns)  # fmt: skip

    def bounce(self, bodies, law, report):
        """Applies the impulses batch by batch, and notes the contacts in the report.

        Nothing in a step makes positions depend on velocities, so all that an impulse needs to know
        but the velocities is worked out for all contacts together.
        """
        first, second, normal = self.first, self.second, self.normal
        t = self.before2 - self.before1
        point = GJK.contact_points(bodies.hulls, first, second, t, normal, self.tolerance)
        point = point + self.before2
        moving = moved(point, self.shift2, normal)
        arm1, arm2 = moving - self.after1, moving - self.after2
        start1, start2 = bodies.states(first), bodies.states(second)
        responses = _responses(start1, start2, arm1, arm2, normal)
        impulses = []
        for begin, end in itertools.pairwise(self.starts.tolist()):
            some = slice(begin, end)
            body1, body2 = (
                _BodyState(
                    start.invMass[some], start.invInertia[:, some], None,
                    *take(bodies.velocity, own[some], axis=1).reshape(2, 3, -1),
                )
                for own, start in ((first, start1), (second, start2))
            )  # fmt: skip
            impulses.append(
                _bounce(
                    body1, body2, arm1[:, some], arm2[:, some], normal[:, some],
                    tuple(response[..., some] for response in responses), law,
                )
            )  # fmt: skip
            for own, body in ((first, body1), (second, body2)):
                velocity = np.concatenate((body.linVelocity, body.angVelocity))
                bodies.velocity[:, own[some]] = velocity
        impulse, friction = zip(*impulses, strict=True)
        friction = NO_FRICTION if law.mu == 0 else np.concatenate(friction, axis=1)
        columns = self.rank, first, second, self.depth, normal, point
        report.add_columns(*columns, np.concatenate(impulse), friction, arm1)


class _Visits:
    """Where contacts have put the bodies during the collisions of a step.

    start : (3, n), the bodies' places before
    key : (K,), of each visit: body · n² + i · n + j, in ascending order, for the pair i, j that the
        body was in; bodies are then visited in this order
    position : (3, K), where the body is after it
    furthest : (n,), how far each body has been from its start
    """

    def __init__(self, start, contacts, isSequential):
        """contacts : `_Contacts`; isSequential : whether pairs of a body are in the order i < j"""
        self.start = start
        count = start.shape[1]
        self.square = count * count
        self.furthest = np.zeros(count)
        self.isSequential = isSequential
        body = np.concatenate((contacts.first, contacts.second))
        position = np.concatenate((contacts.after1, contacts.after2), axis=1)
        turn = np.arange(len(contacts.first))
        if isSequential:
            turn = contacts.first * count + contacts.second
        away = position - take(start, body, axis=1)
        np.maximum.at(self.furthest, body, np.sqrt(dot(away, away)))
        key = body * self.square + np.concatenate((turn, turn))
        order = key.argsort()
        self.key, self.position = key[order], take(position, order, axis=1)

    def places(self, first, second):
        """Where the bodies of the pairs first, second (m,) are at their turn: (3, m), (3, m).

        If not sequential, each pair is taken as the last of all.
        """
        count = len(first)
        bodies = np.concatenate((first, second))
        turn = self.square - 1
        if self.isSequential:
            turn = first * len(self.furthest) + second
            turn = np.concatenate((turn, turn))
        place = self.key.searchsorted(bodies * self.square + turn) - 1
        known = indices(place >= 0)
        known = known[self.key[place[known]] // self.square == bodies[known]]
        position = take(self.start, bodies, axis=1)
        position[:, known] = take(self.position, place[known], axis=1)
        return position[:, :count], position[:, count:]


def _sequential_batches(first, second, isFixed):
    """The batch (P,) of each pair: one more than the last batches of its two bodies.

    Pairs that share a body which can move keep their order, hence the bits of one pair at a time.
    """
    last = [-1] * len(isFixed)
    batch = []
    for i, j in zip(first, second, strict=True):
        number = (last[i] if last[i] > last[j] else last[j]) + 1
        if not isFixed[i]:
            last[i] = number
        if not isFixed[j]:
            last[j] = number
        batch.append(number)
    return np.array(batch, dtype=np.intp)


def _coloured_batches(first, second, isFixed):
    """The batch (P,) of each pair: the first that has neither of its bodies, fixed ones apart.

    The bits of an integer tell which batches have a body.
    """
    taken = [0] * len(isFixed)
    batch = []
    for i, j in zip(first, second, strict=True):
        free = ~(taken[i] | taken[j])
        bit = free & -free
        if not isFixed[i]:
            taken[i] |= bit
        if not isFixed[j]:
            taken[j] |= bit
        batch.append(bit.bit_length() - 1)
    return np.array(batch, dtype=np.intp)


PAIR_ORDERS = {"sequential": _sequential_batches, "coloured": _coloured_batches}


def _resolve_pairs_in_batches(bodies, law, broadPhase, pairOrder, report):
    """`_resolve_pairs` for many bodies: the pairs in batches, with the same bits if sequential.

    Where corrections move bodies out of their reach, and pairs have been overlooked that touched at
    their turn, the batches are done again from the state before them, with these pairs included.
    The impulses come last: within a step, no position depends on a velocity.
    """
    if len(bodies.meshes) < 2:
        return
    memory = bodies.shapes.memory
    reach = np.maximum(LEAST_REACH * bodies.hulls.radius, REACH_GROWTH * memory.displaced)
    batches = _ContactBatches(bodies, reach, broadPhase, pairOrder)
    start = bodies.position.copy()
    memory.displaced = np.zeros(len(reach))
    while len(batches.first) > 0:
        contacts = batches.part()
        if len(contacts.first) == 0:
            break
        visits = _Visits(start, contacts, pairOrder == "sequential")
        memory.displaced = visits.furthest
        first, second = batches.overlooked(visits)
        if len(first) == 0:
            contacts.bounce(bodies, law, report)
            break
        bodies.position[:] = start
        batches.include(first, second, visits.furthest)
    report.candidatePairs = len(batches.keys)


def _resolve_ground(bodies, groundMesh, law, report):
    """Lets every body that reaches down to y = 0 bounce off the ground with its lowest vertex."""
    shapes = bodies.shapes
    # the hull's lowest corner; a vertex that is none may lie below it by rounding
    corner = bodies.relativeBox[1] + bodies.position[1]
    near = indices((corner <= GJK.FEATURE_TOLERANCE * bodies.hulls.radius) & ~bodies.isFixed)
    if len(near) == 0:
        return
    count = shapes.vertexCount[near]
    row, column = ranges(shapes.vertexStart[near], count)
    heights = bodies.vertices[1][column] + bodies.position[1][near[row]]
    lowest, place = least_of_rows(heights, row, count.cumsum() - count)
    below = indices(lowest <= 0.0)
    b, lowest, vertex = near[below], lowest[below], column[place[below]]
    if len(b) == 0:
        return
    point = take(bodies.vertices, vertex, axis=1) + take(bodies.position, b, axis=1)
    # The ground is hull 2: the body moves up, against the normal, by how deep the vertex is.
    normal = np.tile([[0.0], [-1.0], [0.0]], len(b))
    body, ground = bodies.states(b), groundMesh._body_state()
    still = _BodyState(*(np.reshape(value, (-1, 1)) for value in ground.entries()))
    impulse, friction, arm = _resolve(body, still, -lowest, normal, point, law)
    bodies.take(b, body)
    rank, second = np.full(len(b), AFTER_ALL_PAIRS), np.full(len(b), GROUND)
    impulse = np.ravel(impulse)  # a row, as the ground's inverse mass is
    report.add_columns(rank, b, second, -lowest, normal, point, impulse, friction, arm)


# The place of a contact with the ground in the order i < j.
AFTER_ALL_PAIRS = np.iinfo(np.intp).max


# --------------------------------------------------------------------------------------------------
# Distance constraints
# --------------------------------------------------------------------------------------------------


def resolve_position_constraint(
    currPositions, currConstPoints, refValue, invMasses, upper, tolerance
):
    """Moves two bodies so that a bound on the distance of two of their points holds.

    currPositions : pair of (1, 3), the COMs
    currConstPoints : pair of (1, 3), p1 and p2; C = ‖p1 - p2‖ - refValue
    refValue : length ≥ 0, the bound
    invMasses : pair of inverse masses; 0 for what cannot move
    upper : bool; an upper bound is valid when C ≤ tolerance, a lower one when C ≥ -tolerance

    Returns `(positionWasValid, correctedPositions)`: a bool and a pair of new (1, 3) arrays, the
    COMs, moved along p1 - p2 in proportion to the inverse masses until C = 0. Coincident points are
    parted along y, the first one upwards. Bodies that both cannot move stay where they are.
    """
    upper, tolerance = bool(upper), _float(tolerance)
    body1, body2 = (
        _BodyState(_float(invMasses[k]), None, _floats(currPositions[k], 3), None, None)
        for k in range(2)
    )
    points = [_floats(point, 3) for point in currConstPoints]
    C, n = _stretch(*points, _float(refValue))
    violated = _violates(C, upper, tolerance)
    if violated and body1.invMass + body2.invMass > 0:
        _part(body1, body2, C, n)
    return not violated, (_row(body1.position, 3), _row(body2.position, 3))


def resolve_velocity_constraint(
    currPositions,
    currConstPoints,
    currLinVelocities,
    currAngVelocities,
    invMasses,
    invInertiaTensors,
    tolerance,
):
    """Stops the change of the distance of two points of two bodies by an impulse between them.

    currPositions, currConstPoints, invMasses : as for `resolve_position_constraint`
    currLinVelocities, currAngVelocities : pairs of (1, 3)
    invInertiaTensors : pair of (3, 3), inverse inertia tensors in world axes
    tolerance : speed; valid when |J v| ≤ tolerance, with J v the rate at which ‖p1 - p2‖ grows

    Returns `(velocityWasValid, correctedLinVelocities, correctedAngVelocities)`: a bool and two
    pairs of new (1, 3) arrays, with J v = 0 unless it was valid. Δv = -M⁻¹Jᵀ (J M⁻¹ Jᵀ)⁻¹ J v.
    Bodies that both cannot move keep their velocities.
    """
    bodies, arms = [], []
    points = [_floats(point, 3) for point in currConstPoints]
    for k in range(2):
        position = _floats(currPositions[k], 3)
        arms.append(difference(points[k], position))
        bodies.append(
            _BodyState(
                _float(invMasses[k]),
                _floats(invInertiaTensors[k], 9),
                position,
                _floats(currLinVelocities[k], 3),
                _floats(currAngVelocities[k], 3),
            )  # fmt: skip
        )
    n = _stretch(*points, 0.0)[1]
    approach = _approach(*bodies, *arms, n)
    wasValid = abs(approach) <= _float(tolerance)
    if not wasValid and bodies[0].invMass + bodies[1].invMass > 0:
        _slow_down(*bodies, _responses(*bodies, *arms, n), n, approach)
    return (
        wasValid,
        tuple(_row(body.linVelocity, 3) for body in bodies),
        tuple(_row(body.angVelocity, 3) for body in bodies),
    )


class _Constraints:
    """The constraints of a step as columns: those that can be corrected at all.

    A constraint whose meshes are both fixed, or between two vertices of one mesh, is never
    corrected: no motion of the bodies changes its distance. Nor is a lower bound of no more than
    the tolerance, a rope's: every distance satisfies it.

    index : (C,), place in the caller's list, whose length is `total`
    body1, body2 : (C,); arm1, arm2 : (3, C), from the COMs to the points, world axes
    refValue : (C,); upper : (C,) bool
    """

    def __init__(self, bodies, constraints, tolerance):
        self.total = len(constraints)
        table = np.array([tuple(row) for row in constraints], dtype=np.float64).reshape(-1, 6).T
        body1, vertex1, body2, vertex2 = table[:4].astype(np.intp)
        movable = (body1 != body2) & ~(bodies.isFixed[body1] & bodies.isFixed[body2])
        movable &= (table[5] != 0) | (table[4] > tolerance)
        self.index = indices(movable)
        self.body1, self.body2 = body1[movable], body2[movable]
        self.arm1 = bodies.vertices[:, bodies.shapes.vertexStart[self.body1] + vertex1[movable]]
        self.arm2 = bodies.vertices[:, bodies.shapes.vertexStart[self.body2] + vertex2[movable]]
        self.refValue = table[4, movable]
        self.upper = table[5, movable] != 0

    def rows(self):
        """The columns as a list of tuples `(body1, body2, arm1, arm2, refValue, upper)`."""
        columns = (self.body1, self.body2, self.arm1.T, self.arm2.T, self.refValue, self.upper)
        return list(zip(*(column.tolist() for column in columns), strict=True))


def _project_constraints(bodies, constraints, maxIterations, tolerance, scheduling):
    """Visits the constraints until they hold or the visits are used up; returns their number."""
    if scheduling not in CONSTRAINT_SCHEDULINGS:
        names = ", ".join(CONSTRAINT_SCHEDULINGS)
        raise ValueError(f"no constraint scheduling {scheduling!r}; there are {names}")
    columns = _Constraints(bodies, constraints, tolerance)
    allowed = max(int(maxIterations), columns.total)
    return CONSTRAINT_SCHEDULINGS[scheduling](bodies, columns, allowed, tolerance)


class _OneByOne:
    """The constraints of a step, to be visited one at a time, on floats."""

    def __init__(self, bodies, columns, tolerance):
        self.rows = dict(zip(columns.index.tolist(), columns.rows(), strict=True))
        used = np.unique(np.concatenate((columns.body1, columns.body2))).tolist()
        self.states = {b: bodies.state(b) for b in used}
        self.tolerance = tolerance

    def visit(self, c):
        """Looks at constraint c, corrects it if it is violated, and returns whether it was."""
        b1, b2, arm1, arm2, refValue, upper = self.rows[c]
        body1, body2 = self.states[b1], self.states[b2]
        C, n = _stretch(_sum(body1.position, arm1), _sum(body2.position, arm2), refValue)
        if not _violates(C, upper, self.tolerance):
            return False
        _correct_distance(body1, body2, arm1, arm2, C, n, self.tolerance)
        return True

    def write_back(self, bodies):
        for b, state in self.states.items():
            bodies.take(b, state)


def _sweep(bodies, columns, allowed, tolerance):
    """Visits in the list's order, over and over, until as many as there are found nothing.

    A visit of a constraint that cannot be corrected counts as one that found nothing.
    """
    work = _OneByOne(bodies, columns, tolerance)
    visits = idle = 0
    while idle < columns.total and visits < allowed:
        c = visits % columns.total
        idle = 0 if c in work.rows and work.visit(c) else idle + 1
        visits += 1
    work.write_back(bodies)
    return visits


def _queue(bodies, columns, allowed, tolerance):
    """The sweep without the visits that cannot find anything: same result, bit for bit.

    A visit depends on the positions of two bodies, so a constraint that was found to hold is clean
    until a body of it moves. The dirty ones are the bits of one integer: `dirty & -dirty` is the
    lowest that is set, the next constraint in the sweep's order, and a body that moves sets those
    of its constraints with a single `or`. Visits that are left out count as made, so that the
    allowed number ends at the same constraint.
    """
    work = _OneByOne(bodies, columns, tolerance)
    using = dict.fromkeys(work.states, 0)
    dirty = 0
    for c, (b1, b2, *_) in work.rows.items():
        dirty |= 1 << c
        for b in (b1, b2):
            if not bodies.isFixed[b]:  # a fixed one never moves
                using[b] |= 1 << c
    visits = begin = c = 0  # visits made; the sweep's count at constraint 0; where it is
    while dirty:
        ahead = dirty >> c
        if not ahead:  # the next dirty one belongs to the next sweep
            begin, c = begin + columns.total, 0
            continue
        c += (ahead & -ahead).bit_length() - 1
        if begin + c >= allowed:
            break
        dirty ^= 1 << c
        if work.visit(c):
            b1, b2, *_ = work.rows[c]
            dirty |= using[b1] | using[b2]
        visits += 1
        c += 1
    work.write_back(bodies)
    return visits


@lru_cache(maxsize=8)
def _batches(body1, body2, isFixed):
    """Constraints split into batches in which no two move the same body: arrays of columns.

    body1, body2, isFixed : the bytes of the arrays in `_Constraints` and `_Bodies`
    """
    bodies = (np.frombuffer(body, np.intp).tolist() for body in (body1, body2))
    batch = _coloured_batches(*bodies, np.frombuffer(isFixed, bool).tolist())
    return [indices(batch == k) for k in range(batch.max(initial=-1) + 1)]


def _batched(bodies, columns, allowed, tolerance):
    """Visits batch by batch, each a NumPy array of constraints that move no body in common.

    Same visits as the sweep's, in another order, and as many of them: the result differs.
    """
    batches = _batches(columns.body1.tobytes(), columns.body2.tobytes(), bodies.isFixed.tobytes())
    left = columns.total - len(columns.index)  # visits that find nothing, counted once a sweep
    visits = idle = 0
    while batches and visits < allowed:
        visits = min(visits + left, allowed)
        for batch in batches:
            batch = batch[: max(0, allowed - visits)]
            visits += len(batch)
            if _visit_batch(bodies, columns, batch, tolerance):
                idle = 0
            else:
                idle += len(batch)
            if idle >= len(columns.index) or visits >= allowed:
                return visits
    return visits


def _visit_batch(bodies, columns, batch, tolerance):
    """Looks at the constraints in the columns `batch`; returns whether one had to be corrected."""
    b1, b2 = columns.body1[batch], columns.body2[batch]
    arm1, arm2 = columns.arm1[:, batch], columns.arm2[:, batch]
    C, n = _stretch(
        take(bodies.position, b1, axis=1) + arm1,
        take(bodies.position, b2, axis=1) + arm2,
        columns.refValue[batch],
    )
    violated = indices(_violates(C, columns.upper[batch], tolerance))
    if len(violated) == 0:
        return False
    b1, b2 = b1[violated], b2[violated]
    arm1, arm2, n = (take(table, violated, axis=1) for table in (arm1, arm2, n))
    body1, body2 = bodies.states(b1), bodies.states(b2)
    _correct_distance(body1, body2, arm1, arm2, C[violated], n, tolerance)
    bodies.take(b1, body1)
    bodies.take(b2, body2)
    return True


CONSTRAINT_SCHEDULINGS = {"sweep": _sweep, "queue": _queue, "batches": _batched}


# --------------------------------------------------------------------------------------------------
# The step
# --------------------------------------------------------------------------------------------------

# Stands for the ground where a contact names its second body.
GROUND = -1


class Contact(NamedTuple):
    """One contact that a step has resolved. Vectors are tuples of 3 in world axes."""

    body1: int  # index of the mesh
    body2: int  # likewise, or GROUND
    depth: float  # ≥ 0, before the correction
    normal: tuple  # unit, from body 1 to body 2
    point: tuple  # the point of body 2 that is deepest in body 1; body 1's lowest one on the ground
    impulse: float  # mass · speed, what body 2 receives along the normal
    friction: tuple  # mass · speed, what it receives across
    arm: tuple  # from the COM of body 1 to where the impulses act; it goes along with body 1


# The phases of a step that are timed, in their order.
PHASES = ("gather", "integrate", "collisions", "ground", "constraints", "writeBack")


class StepReport:
    """What a step did: for the eye and for benchmarks, never read by the simulation.

    candidatePairs : number of pairs whose boxes overlapped at their turn
    constraintVisits : number of constraints looked at
    seconds : dict, the time spent in each phase
    """

    def __init__(self):
        self._contacts = []
        self._pending = []
        self.candidatePairs = 0
        self.constraintVisits = 0
        self.seconds = {}

    @property
    def contacts(self):
        """List of `Contact` in the order i < j, the ground last."""
        pending, self._pending = self._pending, []
        rows = []
        for *columns, impulse, friction, arm in pending:
            friction = np.broadcast_to(np.reshape(friction, (3, -1)), arm.shape)
            columns = (*columns, impulse, friction, arm)
            rows += zip(*(column.T.tolist() for column in columns), strict=True)
        for _, i, j, depth, n, point, impulse, friction, arm in sorted(rows):
            vectors = tuple(n), tuple(point), impulse, tuple(friction), tuple(arm)
            self._contacts.append(Contact(i, j, depth, *vectors))
        return self._contacts

    def add(self, contact):
        """Notes a `Contact`."""
        self._contacts.append(contact)

    def add_columns(self, *columns):
        """Notes contacts that arrays describe; they become `Contact`s when they are asked for.

        columns : rank (m,), the place in the order i < j; then what a `Contact` holds: body1 (m,),
            body2 (m,), depth (m,), normal (3, m), point (3, m), impulse (m,), friction (3, m) or a
            single vector for all, arm (3, m)
        """
        self._pending.append(columns)

    @contextmanager
    def phase(self, name):
        """Times what is done inside the `with` block."""
        start = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - start


def run_timestep(
    meshes,
    groundMesh,
    timeStep,
    CRCoeff,
    enforceConstraints=True,
    constraints=(),
    maxIterations=1000,
    tolerance=1e-3,
    closingOnly=False,
    constraintScheduling="sweep",
    mu=0.0,
    broadPhase="all",
    pairOrder="sequential",
):
    """Moves a scene on by one time step, in place, and returns a `StepReport`.

    meshes : list of Mesh
    groundMesh : a fixed Mesh without vertices, the half space y ≤ 0; None for free space
    timeStep : seconds ≥ 0. What a body crosses within one of them it does not hit
    CRCoeff : coefficient of restitution, see `resolve_collision`
    enforceConstraints : whether the constraints are looked at
    constraints : rows `[m1, v1, m2, v2, refValue, upper]`: the distance between rest vertex v1 of
        meshes[m1] and rest vertex v2 of meshes[m2] is at most refValue if upper, else at least
    maxIterations : constraint visits at most, but never less than one of each
    tolerance : how far, as a length, a constraint may be violated before it is corrected; as a
        speed, how fast its distance may change when it is
    closingOnly : see `resolve_collision`
    constraintScheduling : "sweep" visits the constraints in order until as many visits as there are
        constraints found nothing to correct; "queue" gives the same bits and leaves out visits that
        cannot find anything; "batches" visits constraints without a common body together, which
        ends elsewhere within the same bounds, and suits hundreds of constraints
    mu : see `resolve_collision`
    broadPhase : how pairs with overlapping boxes are found: "all" looks at every pair in turn;
        "grid" finds them through uniform grids and resolves them in batches, with the same bits
    pairOrder : "sequential" resolves the pairs as if in the order i < j; "coloured" in rounds of
        pairs without a common body, few by greedy colouring: another order, hardly faster

    Raises ValueError for a name that is not known, a time step that is negative or not finite, and
    what `resolve_collision` refuses; StateError, which names the body, where a number would become
    NaN, infinite or larger than LARGEST_NUMBER. The meshes are then as they were before the step.
    """
    report = StepReport()
    timeStep, tolerance = _float(timeStep), _float(tolerance)
    if not 0.0 <= timeStep < math.inf:
        raise ValueError(f"the time step must be finite and not negative, not {timeStep:g}")
    law = _contact_law(CRCoeff, closingOnly, mu)
    for what, name, known in (
        ("broad phase", broadPhase, BROAD_PHASES),
        ("pair order", pairOrder, PAIR_ORDERS),
    ):
        if name not in known:
            raise ValueError(f"no {what} {name!r}; there are {', '.join(known)}")
    if len(meshes) == 0:
        return report
    with report.phase("gather"):
        bodies = _Bodies(meshes)
    with report.phase("integrate"):
        bodies.integrate(timeStep)
        bodies.check_numbers("free flight")
    with report.phase("collisions"):
        if broadPhase == "all" and pairOrder == "sequential":
            _resolve_pairs(bodies, law, report)
        else:
            _resolve_pairs_in_batches(bodies, law, broadPhase, pairOrder, report)
    with report.phase("ground"):
        if groundMesh is not None:
            _resolve_ground(bodies, groundMesh, law, report)
    with report.phase("constraints"):
        if enforceConstraints and len(constraints) > 0:
            report.constraintVisits = _project_constraints(
                bodies, constraints, maxIterations, tolerance, constraintScheduling
            )
    with report.phase("writeBack"):
        bodies.check_numbers("contacts and constraints")
        bodies.write_back()
    return report
