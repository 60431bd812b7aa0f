"""The coursework: rigid bodies, the integrator, collisions, constraints, and the step of them all.

From the top: `run_timestep`, which reads as the coursework's text; `Mesh`; contacts with friction;
distance constraints. Everything here is for one body, or a pair. The steps for thousands of bodies,
rbs/stepping/gridstep.py and rbs/softstep/step.py, have rooms of their own: they are handed the
meshes and return a report.

Units are whatever the scene uses, lengths and masses alike, with seconds and a gravity of 9.8
length units per second squared along -y. Vectors of one mesh are rows (1, 3), quaternions (1, 4)
with the scalar part first; (3,) and (4,) are accepted wherever one is passed in or assigned. The
formulas are on tuples of floats: for three numbers, that is ten times as fast as arrays.

Sources. The integrator, impulses and the inertia of a rotated body: Baraff, Rigid Body Simulation,
SIGGRAPH course notes, 2001. Inertia of a tetrahedron: Tonon, Explicit exact formulas for the 3-D
tetrahedron inertia tensor, J. Mathematics and Statistics 1(1), 2005. One impulse a contact, with
friction along the sliding: Mirtich, Impulse-based dynamic simulation of rigid body systems, 1996.
Positions corrected in proportion to the inverse masses: Müller et al., Position based dynamics,
2007. Constraints on velocities: Catto, Modeling and solving constraints, Game Developers Conference
2009.
"""

import itertools
import math
import reprlib
from dataclasses import dataclass
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

import GJK
from Quaternion import exponential, multiply, rotation_matrices
from rbs.geometry import vectors
from rbs.geometry.hulls import build_hull, rotate_columns
from rbs.geometry.triples import (
    add,
    cross,
    divide,
    dot,
    floats,
    mat_vec,
    mul_add,
    norm,
    number,
    rotate_tensor,
    scale,
    sub,
)
from rbs.stepping.bodies import (
    EARTH,
    check_distinct,
    check_numbers,
    check_objects,
    gyroscopic_velocity,
    named_faults,
    restored_on_error,
    state_columns,
)
from rbs.stepping.bodies import (
    GRAVITY as GRAVITY,
)
from rbs.stepping.reports import GROUND, StepReport

# The methods of Mesh that all pairs, one after the other, call in a step.
STEP_METHODS = (
    "integrate_timestep",
    "apply_gyroscopic_term",
    "bounding_box_collision",
    "detect_collision",
    "lowest_vertex",
    "get_rotated_inv_IT",
)
# The ground's normal. It points into the body, which is why the depth there is negative.
UPWARDS = (0.0, 1.0, 0.0)
# Where the two points of a constraint coincide, no direction separates them better than another:
# they are moved apart along this one.
COINCIDENT_DIRECTION = (0.0, 1.0, 0.0)


# --------------------------------------------------------------------------------------------------
# The step
# --------------------------------------------------------------------------------------------------


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
    contactSolver="impulse",
    substeps=8,
    sleeping=True,
    gyroscopic=False,
    solverState=None,
    gravity=EARTH,
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
    closingOnly, mu : see `resolve_collision`
    constraintScheduling : "sweep" visits the constraints in order until as many visits as there are
        constraints found nothing to correct; "queue" gives the same bits and leaves out visits that
        cannot find anything; "batches" visits constraints without a common body together, which
        ends elsewhere within the same bounds, and suits hundreds of constraints
    broadPhase : "all" detects and resolves the pairs one after the other; "grid" gives the same
        bits through uniform grids and batches of pairs, and suits hundreds of bodies. It applies
        the formulas to arrays: what a subclass of Mesh has in place of a method is not called
    contactSolver : "impulse" resolves one contact after the other; "soft-step" all contacts and
        constraints together, several points a contact, in `substeps` substeps, so that piles rest;
        with `sleeping`, what rests is left out until it is disturbed. See rbs/softstep/step.py
    gyroscopic : whether the angular velocity changes in free flight, as Euler's equation has it
    solverState : `rbs.softstep.step.SolverState`, what a soft step leaves to the next, changed in
        place; None starts cold
    gravity : three numbers, the acceleration of free fall in m/s²

    Raises ValueError, which says what, for options that it refuses, a mesh that is in the list
    twice, and a constraint of what is not there; `rbs.stepping.bodies.StateError`, which names the
    body, where a number would become NaN, infinite or absurdly large. Whatever is raised, the
    meshes are then as they were before the step.
    """
    from rbs.stepping.settings import check_arguments

    checked = check_arguments(locals())
    timeStep, contact = checked["timeStep"], (checked["CRCoeff"], closingOnly, checked["mu"])
    flight = gyroscopic, checked["gravity"]
    constraints = constraints if enforceConstraints else ()
    check_objects(groundMesh, solverState)
    with named_faults(meshes):
        if contactSolver == "soft-step":
            from rbs.softstep.step import soft_step

            check_methods(meshes, contactSolver)
            solver = checked["substeps"], sleeping, solverState
            return soft_step(meshes, groundMesh, timeStep, *contact, *flight, constraints, *solver)
        # the grid step changes nothing unless it succeeds
        with restored_on_error(meshes if broadPhase == "all" or len(constraints) else ()):
            if broadPhase == "grid":
                from rbs.stepping.gridstep import grid_step

                check_methods(meshes, broadPhase)
                report = grid_step(meshes, groundMesh, timeStep, *contact, *flight)
            else:
                report = all_pairs_step(meshes, groundMesh, timeStep, *contact, *flight)
            with report.phase("constraints"):
                report.constraintVisits = project_constraints(
                    meshes, constraints, maxIterations, checked["tolerance"], constraintScheduling
                )
                if report.constraintVisits:
                    check_numbers(state_columns(meshes), meshes, "contacts and constraints")
    return report


def all_pairs_step(meshes, groundMesh, timeStep, CRCoeff, closingOnly, mu, gyroscopic, gravity):
    """`run_timestep` as far as the constraints, one body and one pair after the other; see there.

    Each detection sees the corrections of the earlier pairs. Returns the `StepReport`.
    """
    check_distinct(meshes)
    report = StepReport()
    extensions = {"closingOnly": closingOnly, "mu": mu} if closingOnly or mu else {}
    pull = () if gravity == EARTH else (gravity,)
    with report.phase("integrate"):
        for mesh in meshes:
            if gyroscopic:
                mesh.apply_gyroscopic_term(timeStep)
            mesh.integrate_timestep(timeStep, *pull)
        check_numbers(state_columns(meshes), meshes, "free flight")
    with report.phase("collisions"):
        for (i, m1), (j, m2) in itertools.combinations(enumerate(meshes), 2):
            isCollision, *contact = m1.detect_collision(m2)
            if isCollision:
                impulses = resolve_collision(m1, m2, *contact, CRCoeff, **extensions)
                report.add_contact(i, j, *contact, impulses)
        report.candidatePairs = math.comb(len(meshes), 2)
    with report.phase("ground"):
        for i, mesh in enumerate(meshes if groundMesh is not None else ()):
            lowest = mesh.lowest_vertex()
            if lowest is not None and lowest[1] <= 0.0:
                contact = lowest[1], UPWARDS, lowest
                impulses = resolve_collision(mesh, groundMesh, *contact, CRCoeff, **extensions)
                report.add_contact(i, GROUND, *contact, impulses)
    check_numbers(state_columns(meshes), meshes, "contacts")
    return report


def check_methods(meshes, step):
    """Raises ValueError if a subclass of Mesh has a method of its own that a step would not call.

    step : the name of the broad phase or of the contact solver, which apply the formulas to arrays
    """
    for kind in dict.fromkeys(map(type, meshes)):
        for name in STEP_METHODS:
            if getattr(kind, name, None) is not getattr(Mesh, name):
                raise ValueError(f"{kind.__name__}.{name} would not be called with {step!r}")


# --------------------------------------------------------------------------------------------------
# Mesh
# --------------------------------------------------------------------------------------------------


class RotatedHull:
    """What the collision test reads of a mesh: what follows from its orientation.

    hull : `Hull`, at rest; rotation : nine floats, matrix row by row
    vertices : (3, V), relative to the COM; hullVertices : (3, Vh), those of the hull
    low, high : three floats each, the box of the hull relative to the COM
    """

    def __init__(self, mesh):
        self.hull = mesh.hull
        self.rotation = rotation_matrices(floats(mesh.orientation, 4))
        self.vertices = vectors.mat_vec(np.array(self.rotation), mesh.origVertices.T)
        self.hullVertices = self.vertices.take(self.hull.vertexIndex, axis=1)
        self.low = self.hullVertices.min(axis=1).tolist()
        self.high = self.hullVertices.max(axis=1).tolist()


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

    Further attributes: currVertices (V, 3), the vertices in the world, always those of the present
    position and orientation; linVelocity (1, 3), of the COM; angVelocity (1, 3), rad/s, world axes;
    mass; invMass, 0 if fixed; IT (3, 3), inertia tensor about the COM at rest; invIT (3, 3), its
    inverse, 0 if fixed; volume, of the tetrahedra; hullVolume, of the convex hull that collides in
    its stead; hull, a `rbs.geometry.hulls.Hull`; cachedAxes, by other mesh, the axis along which
    the two were apart, or overlapped least, when they were last looked at.
    """

    def __init__(self, name, origVertices, faces, tets, density, position, orientation, isFixed):
        self.name = name
        self.origVertices = self._table("origVertices", origVertices, 3)
        self.faces = self._table("faces", faces, 3, np.int64)
        self.tets = self._table("tets", tets, 4, np.int64)
        self.density = float(self._entry("density", density, 1)[0, 0])
        self.position = self._entry("position", position, 3)
        self.orientation = self._entry("orientation", orientation, 4)
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
        self.isFixed = isFixed
        self._forget_pose()
        self.cachedAxes = WeakKeyDictionary()

    def __repr__(self):
        x, y, z = floats(self.position, 3)
        mass = "fixed" if self.isFixed else f"{self.mass:.4g} kg"
        where = f"({x:.4g}, {y:.4g}, {z:.4g})"
        return f"Mesh({self.name!r}, {len(self.origVertices)} vertices, {mass}, at {where})"

    def _table(self, what, rows, width, dtype=np.float64):
        """A copy of `rows` as (n, width); raises ValueError if it is anything else."""
        try:
            table = np.array(rows, dtype=np.float64)
        except (TypeError, ValueError):
            table = np.array(np.nan)
        if table.size == 0:
            return np.empty((0, width), dtype)
        if table.ndim != 2 or table.shape[1] != width:
            found = f"of shape {table.shape}" if table.ndim else reprlib.repr(rows)
            raise ValueError(f"mesh {self.name}: {what} must be (n, {width}), not {found}")
        if not np.isfinite(table).all() or (table != table.astype(dtype)).any():
            kind = "finite" if dtype is np.float64 else "whole"
            raise ValueError(f"mesh {self.name}: {what} must be {kind} numbers")
        return table.astype(dtype)

    def _entry(self, what, value, width):
        """`width` finite numbers as (1, width); raises ValueError if it is anything else."""
        try:
            row = np.array(value, dtype=np.float64).reshape(1, width)
        except (TypeError, ValueError):
            row = np.array(np.nan)
        if not np.isfinite(row).all():
            count = "a finite number" if width == 1 else f"{width} finite numbers"
            raise ValueError(f"mesh {self.name}: {what} must be {count}, not {reprlib.repr(value)}")
        return row

    def _init_mass_properties(self):
        """Sets volume, mass and IT, moves the rest vertices to their COM, and builds the hull.

        Over a tetrahedron with the corners x_i, the integral of x is V (Σ x_i) / 4, and that of
        x xᵀ is V/20 (Σ x_i x_iᵀ + (Σ x_i)(Σ x_i)ᵀ) (Tonon 2005). With C the sum of the latter times
        the density, about the COM, the inertia tensor is tr(C) 1 - C.
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
        self.hull = build_hull(self.origVertices)
        self.hullVolume = self.hull.volume

    @property
    def isFixed(self):
        """Whether nothing moves the mesh. Assigning fixes it, at rest where it is, or frees it."""
        return self.invMass == 0.0

    @isFixed.setter
    def isFixed(self, isFixed):
        if isFixed not in (True, False):
            raise ValueError(f"mesh {self.name}: isFixed must be True or False, not {isFixed!r}")
        if isFixed:
            self.linVelocity, self.angVelocity = np.zeros((1, 3)), np.zeros((1, 3))
        if isFixed or len(self.origVertices) == 0:
            self.invMass, self.invIT = 0.0, np.zeros((3, 3))
        else:
            self.invMass, self.invIT = 1.0 / self.mass, np.linalg.inv(self.IT)

    def integrate_timestep(self, timeStep, gravity=EARTH):
        """Moves the mesh on by timeStep seconds of free flight; a fixed mesh stays as it is.

        Semi-implicit Euler: v ← v + g h, COM ← COM + v h with the new velocity, orientation ←
        exp(ω h/2) ∘ orientation. The angular velocity stays: the gyroscopic term is left out.
        """
        if self.isFixed:
            return
        h = number(timeStep)
        linVelocity = mul_add(floats(self.linVelocity, 3), h, gravity)
        position = mul_add(floats(self.position, 3), h, linVelocity)
        turn = exponential((0.0, *scale(0.5, scale(h, floats(self.angVelocity, 3)))))
        w, x, y, z = multiply(turn, floats(self.orientation, 4))
        # a product of unit quaternions drifts from unit length by rounding
        length = math.sqrt(w * w + (x * x + y * y + z * z))
        self.linVelocity, self.position = _row(linVelocity), _row(position)
        self.orientation = _row((w, x, y, z)) / length

    def apply_gyroscopic_term(self, timeStep):
        """Turns the angular velocity as torque-free motion does; see `gyroscopic_velocity`."""
        if self.invMass != 0.0:
            angVelocity = gyroscopic_velocity(
                floats(self.angVelocity, 3),
                floats(self.orientation, 4),
                floats(self.IT, 9),
                number(timeStep),
            )
            self.angVelocity = _row(angVelocity)

    def bounding_box_collision(self, m):
        """Whether the axis-aligned boxes of this mesh and of m overlap or touch."""
        a, b = self.bounding_box(), m.bounding_box()
        if a is None or b is None:
            return False
        return (
            a[0] <= b[3]
            and b[0] <= a[3]
            and a[1] <= b[4]
            and b[1] <= a[4]
            and a[2] <= b[5]
            and b[2] <= a[5]
        )

    def detect_collision(self, m):
        """Collision of the convex hulls of this mesh and of m, at their positions and orientations.

        Returns `(isCollision, depth, intNormal, intPosition)` as `GJK.is_collide` does, this mesh
        being hull 1: m has to move by depth along intNormal (1, 3) to separate, and intPosition
        (1, 3) is the point of m that is deepest inside this mesh. Two fixed meshes never collide.
        """
        if not self.bounding_box_collision(m) or (self.isFixed and m.isFixed):
            return GJK.NO_COLLISION
        position1, position2 = floats(self.position, 3), floats(m.position, 3)
        isCollision, depth, normal, point = GJK.collide_rotated(
            self.rotated_hull(), m.rotated_hull(), sub(position2, position1), self.cachedAxes.get(m)
        )
        self.cachedAxes[m] = normal
        if not isCollision:
            return GJK.NO_COLLISION
        return True, depth, _row(normal), _row(add(point, position2))

    def lowest_vertex(self):
        """The lowest of the vertices in the world (3,), of equally low ones the first.

        None of a mesh that nothing moves: the ground leaves it where it is.
        """
        if self.isFixed:
            return None
        vertices = self.currVertices
        return vertices[vertices[:, 1].argmin()].copy()

    def get_rotated_inv_IT(self):
        """Inverse inertia tensor in world axes, R I⁻¹ Rᵀ: (3, 3)."""
        rotation = rotation_matrices(floats(self.orientation, 4))
        return np.array(rotate_tensor(rotation, floats(self.invIT, 9))).reshape(3, 3)

    def push(self, impulse, point):
        """Applies an impulse (3,), mass · speed, at a point (3,) of the world; nothing if fixed.

        With r from the COM to the point, v ← v + J / m and ω ← ω + R I⁻¹ Rᵀ (r × J).
        """
        arm = np.reshape(point, (1, 3)) - self.position
        torque = np.cross(arm, np.reshape(impulse, (1, 3)))
        self.linVelocity = self.linVelocity + self.invMass * np.reshape(impulse, (1, 3))
        self.angVelocity = self.angVelocity + torque @ self.get_rotated_inv_IT().T

    def body_state(self):
        """What a contact reads and changes, in floats: `Body`."""
        invInertia = np.zeros((3, 3)) if self.isFixed else self.get_rotated_inv_IT()
        return Body(
            float(self.invMass),
            floats(invInertia, 9),
            floats(self.position, 3),
            floats(self.linVelocity, 3),
            floats(self.angVelocity, 3),
        )

    def set_body_state(self, body):
        """Takes over position and velocities; what cannot move stays as it is."""
        if body.invMass == 0.0:
            return
        self.position = _row(body.position)
        self.linVelocity = _row(body.linVelocity)
        self.angVelocity = _row(body.angVelocity)

    # What follows from the pose is worked out when it is first asked for, and kept until position
    # or orientation change, by assignment or in place: they are compared by their bytes.

    def rotated_hull(self):
        """The `RotatedHull` at the present orientation; None without vertices."""
        self._follow_pose()
        if self._rotatedHull is None and self.hull is not None:
            self._rotatedHull = RotatedHull(self)
        return self._rotatedHull

    def bounding_box(self):
        """Least and greatest x, y, z of the hull in the world, six floats; None likewise."""
        if (
            self._boundingBox is None
            or self.position.tobytes() != self._positionKey
            or self.orientation.tobytes() != self._orientationKey
        ) and self.hull is not None:
            rotated, position = self.rotated_hull(), floats(self.position, 3)
            self._boundingBox = add(rotated.low, position) + add(rotated.high, position)
        return self._boundingBox

    @property
    def currVertices(self):
        """They cannot be written into: they follow from the pose. What is assigned can be."""
        self._follow_pose()
        if self._currVertices is None:
            rotated = self.rotated_hull()
            rows = self.origVertices.T if rotated is None else rotated.vertices
            rows = rows + np.reshape(self.position, (3, 1))
            self._currVertices = np.ascontiguousarray(rows.T)
            self._currVertices.flags.writeable = False
        return self._currVertices

    @currVertices.setter
    def currVertices(self, vertices):
        """Holds until position or orientation change."""
        self._follow_pose()
        self._currVertices = vertices

    def _follow_pose(self):
        """Drops what has been worked out for another position or orientation."""
        position, orientation = self.position.tobytes(), self.orientation.tobytes()
        if orientation != self._orientationKey:
            self._forget_pose()
            self._positionKey, self._orientationKey = position, orientation
        elif position != self._positionKey:
            self._positionKey, self._boundingBox, self._currVertices = position, None, None

    def _forget_pose(self):
        self._positionKey = self._orientationKey = None
        self._rotatedHull = self._boundingBox = self._currVertices = None

    def __getstate__(self):
        """What copies and pickles take along: the attributes, not what is kept to save time."""
        return {name: value for name, value in vars(self).items() if name not in _KEPT_NAMES}

    def __setstate__(self, state):
        self.__dict__.update(state)
        self._forget_pose()
        self.cachedAxes = WeakKeyDictionary()


_KEPT_NAMES = (
    "_positionKey",
    "_orientationKey",
    "_rotatedHull",
    "_boundingBox",
    "_currVertices",
    "cachedAxes",
)


def ground():
    """Returns the ground y ≤ 0: a fixed Mesh without vertices, at the origin."""
    return Mesh("ground", [], [], [], 0.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), True)


def refresh_vertices(meshes):
    """Works out the currVertices that are not at hand of all these meshes, in one go.

    For those who look at all of them: mesh by mesh, NumPy's calls would take most of the time.
    Returns the currVertices of one mesh after the other, (ΣV, 3), to be read only.
    """
    for m in meshes:
        m._follow_pose()
    stale = [m for m in meshes if m._currVertices is None]
    if stale:
        counts = np.array([len(m.origVertices) for m in stale])
        columns = state_columns(stale)
        rotation = np.stack(rotation_matrices(columns["orientation"]))
        rest = np.concatenate([m.origVertices for m in stale]).T
        vertices = rotate_columns(rotation, rest, counts)
        vertices = np.ascontiguousarray((vertices + columns["position"].repeat(counts, axis=1)).T)
        vertices.flags.writeable = False
        for m, end in zip(stale, counts.cumsum().tolist(), strict=True):
            m._currVertices = vertices[end - len(m.origVertices) : end]
        if len(stale) == len(meshes):
            return vertices
    return np.concatenate([np.empty((0, 3)), *(m._currVertices for m in meshes)])


def _row(value):
    """A new array of one row, out of a tuple of floats or an array."""
    return np.array(value).reshape(1, -1)


# --------------------------------------------------------------------------------------------------
# Contacts
# --------------------------------------------------------------------------------------------------

NO_FRICTION = (0.0, 0.0, 0.0)


@dataclass(slots=True)
class Body:
    """What a contact or a constraint reads and changes of a mesh, in floats.

    invMass : 1 / kg, 0 for what cannot move; invInertia : nine entries row by row, world axes
    position, linVelocity, angVelocity : tuples of three
    """

    invMass: float
    invInertia: tuple
    position: tuple
    linVelocity: tuple
    angVelocity: tuple


class ContactImpulses(NamedTuple):
    """What a contact did: the impulse that body 2 receives along the normal, mass · speed, and
    across it, a vector; and the arm, from the COM of body 1 to where they act."""

    impulse: float
    friction: tuple
    arm: tuple


def resolve_collision(m1, m2, depth, contactNormal, penPoint, CRCoeff, closingOnly=False, mu=0.0):
    """Separates two meshes that interpenetrate and lets them bounce, changing both in place.

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

    The interpenetration is split by inverse mass, see `shifts`. Restitution asks that a closing
    speed of c become one of -e c: with u the velocity of body 1 relative to body 2 at the contact
    point, which has moved along with m2, and K the sum of both bodies' inverse effective masses,
    an impulse -j n on body 1 and +j n on body 2 lowers u · n by j K, hence j = (1 + e) (u · n) / K.

    Returns the `ContactImpulses`, None of two meshes that cannot move, which stay as they are.
    Raises ValueError for a restitution that is not finite, or a friction that is negative or not.
    """
    e, mu = number(CRCoeff), number(mu)
    if not math.isfinite(e):
        raise ValueError(f"CRCoeff must be a finite number, not {e:g}")
    if not 0.0 <= mu < math.inf:
        raise ValueError(f"mu must be a finite number of 0 or more, not {mu:g}")
    body1, body2 = m1.body_state(), m2.body_state()
    if body1.invMass + body2.invMass == 0.0:
        return None
    depth, n, point = number(depth), floats(contactNormal, 3), floats(penPoint, 3)
    # A depth of 0 does not tell which way the normal points; on the ground, it is into m1.
    if depth < 0.0 or (depth == 0.0 and len(m2.origVertices) == 0):
        depth, n = -depth, scale(-1.0, n)

    shift1, shift2 = shifts(body1.invMass, body2.invMass, depth)
    body1.position = mul_add(body1.position, shift1, n)
    body2.position = mul_add(body2.position, shift2, n)
    point = mul_add(point, shift2, n)
    r1, r2 = sub(point, body1.position), sub(point, body2.position)

    change = (1.0 + e) * dot(relative_velocity(body1, body2, r1, r2), n)
    if closingOnly:
        change = change * (change > 0.0)
    k1, turning1 = inverse_effective_mass(body1, r1, n)
    k2, turning2 = inverse_effective_mass(body2, r2, n)
    j = change / (k1 + k2)
    receive_impulse(body1, -j, n, turning1)
    receive_impulse(body2, j, n, turning2)

    friction = apply_friction(body1, body2, r1, r2, n, mu * j) if mu else NO_FRICTION
    m1.set_body_state(body1)
    m2.set_body_state(body2)
    return ContactImpulses(j, friction, r1)


def shifts(invMass1, invMass2, distance):
    """How far two bodies move along the direction from 1 to 2 to be `distance` further apart.

    Each in proportion to its inverse mass, w_i = m_i⁻¹ / (m_1⁻¹ + m_2⁻¹), so that their common COM
    stays. Not both masses may be infinite.
    """
    total = invMass1 + invMass2
    return -(invMass1 / total * distance), invMass2 / total * distance


def relative_velocity(body1, body2, r1, r2):
    """Velocity of body 1 at its arm relative to body 2: v1 + ω1 × r1 - (v2 + ω2 × r2)."""
    return sub(
        add(body1.linVelocity, cross(body1.angVelocity, r1)),
        add(body2.linVelocity, cross(body2.angVelocity, r2)),
    )


def inverse_effective_mass(body, r, n):
    """`(k, turning)`: how a body responds to a unit impulse along n at an arm r.

    turning : I⁻¹ (r × n), the change of the angular velocity
    k : the change of the velocity of the point along n. It gains m⁻¹ from the motion of the COM
        and, from the rotation, ((I⁻¹ (r × n)) × r) · n = (r × n) · I⁻¹ (r × n)
    """
    rCrossN = cross(r, n)
    turning = mat_vec(body.invInertia, rCrossN)
    return body.invMass + dot(rCrossN, turning), turning


def receive_impulse(body, j, n, turning):
    """Changes a body by an impulse j along n: v ← v + j m⁻¹ n and ω ← ω + j I⁻¹ (r × n)."""
    body.linVelocity = mul_add(body.linVelocity, j * body.invMass, n)
    body.angVelocity = mul_add(body.angVelocity, j, turning)


def apply_friction(body1, body2, r1, r2, n, limit):
    """Coulomb friction at a contact; returns the impulse, a vector, that body 2 receives.

    limit : μ times the normal impulse; none where that is negative, as nothing is pressed there

    With u the velocity of body 1 relative to body 2 at the contact and t the unit vector of its
    part across the normal, an impulse -j t on body 1 and +j t on body 2 lowers u · t by j K, K
    being both bodies' inverse effective mass along t. The sliding stops at j = u · t / K; friction
    gives that much or its limit, whichever is less, and so never turns the sliding round. The
    kinetic energy changes by -j u · t + j² K / 2, which is at most 0 for 0 ≤ j ≤ u · t / K.
    """
    u = relative_velocity(body1, body2, r1, r2)
    across = mul_add(u, -dot(u, n), n)
    speed = norm(across)
    t = divide(across, speed or 1.0)
    k1, turning1 = inverse_effective_mass(body1, r1, t)
    k2, turning2 = inverse_effective_mass(body2, r2, t)
    j = min(speed / (k1 + k2), max(limit, 0.0) + 0.0)  # a zero has no sign
    receive_impulse(body1, -j, t, turning1)
    receive_impulse(body2, j, t, turning2)
    return scale(j, t)


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
    moved apart along y, the first one upwards. Bodies that both cannot move stay where they are.
    """
    (x1, x2), (p1, p2) = floats_of(currPositions), floats_of(currConstPoints)
    invMass1, invMass2 = number(invMasses[0]), number(invMasses[1])
    tolerance = number(tolerance)
    C, n = distance_error(p1, p2, number(refValue))
    isViolated = C > tolerance if upper else C < -tolerance
    if isViolated and invMass1 + invMass2 > 0.0:
        shift1, shift2 = shifts(invMass1, invMass2, C)
        x1, x2 = mul_add(x1, shift1, n), mul_add(x2, shift2, n)
    return not isViolated, Pair(x1, x2)


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

    J = [n, r1 × n, -n, -(r2 × n)], so that J v is the closing speed along n, and J M⁻¹ Jᵀ the
    inverse effective mass: Δv = -M⁻¹Jᵀ (J M⁻¹ Jᵀ)⁻¹ J v is a collision's impulse without
    restitution.

    Returns `(velocityWasValid, correctedLinVelocities, correctedAngVelocities)`: a bool and two
    pairs of new (1, 3) arrays, with J v = 0 unless it was valid. Bodies that both cannot move keep
    their velocities.
    """
    (x1, x2), (p1, p2) = floats_of(currPositions), floats_of(currConstPoints)
    (v1, v2), (omega1, omega2) = floats_of(currLinVelocities), floats_of(currAngVelocities)
    invInertia1, invInertia2 = floats_of(invInertiaTensors, 9)
    body1 = Body(number(invMasses[0]), invInertia1, x1, v1, omega1)
    body2 = Body(number(invMasses[1]), invInertia2, x2, v2, omega2)
    r1, r2 = getattr(currConstPoints, "arms", None) or (sub(p1, x1), sub(p2, x2))
    _, n = distance_error(p1, p2, 0.0)
    Jv = dot(relative_velocity(body1, body2, r1, r2), n)
    wasValid = abs(Jv) <= number(tolerance)
    if not wasValid and body1.invMass + body2.invMass > 0.0:
        k1, turning1 = inverse_effective_mass(body1, r1, n)
        k2, turning2 = inverse_effective_mass(body2, r2, n)
        j = Jv / (k1 + k2)
        receive_impulse(body1, -j, n, turning1)
        receive_impulse(body2, j, n, turning2)
    return (
        wasValid,
        Pair(body1.linVelocity, body2.linVelocity),
        Pair(body1.angVelocity, body2.angVelocity),
    )


class Pair:
    """A pair of vectors, as the two functions above take and return it.

    Arrays of their own for whoever indexes it, rows (1, 3) or of another shape; and `floats`, two
    tuples, so that a sweep of a thousand visits makes no arrays. Points may bring their exact
    `arms` along: their difference to the COMs would lose the digits that the COMs' distance from
    the origin takes up.
    """

    __slots__ = ("arms", "floats", "shape")

    def __init__(self, first, second, shape=(1, 3), arms=None):
        self.floats, self.shape, self.arms = (first, second), shape, arms

    def __len__(self):
        return 2

    def __getitem__(self, k):
        return np.reshape(self.floats[k], self.shape)

    def __iter__(self):
        return iter((self[0], self[1]))


def floats_of(pair, count=3):
    """Two tuples of floats, of a `Pair` or any other pair of arrays with so many entries."""
    try:
        return pair.floats
    except AttributeError:
        return floats(pair[0], count), floats(pair[1], count)


def distance_error(p1, p2, refValue):
    """`(C, n)` of a distance constraint: C = ‖p1 - p2‖ - refValue, n the unit vector of p1 - p2."""
    d = sub(p1, p2)
    length = norm(d)
    return length - refValue, divide(d, length) if length > 0.0 else COINCIDENT_DIRECTION


def project_constraints(meshes, constraints, maxIterations, tolerance, scheduling):
    """Visits the constraints until they hold or the visits are used up; returns their number.

    A visit looks at one constraint, and corrects positions and velocities where it is violated.
    Arguments as for `run_timestep`; see rbs/stepping/constraints.py for the schedules.
    """
    if len(constraints) == 0:
        return 0
    from rbs.stepping.constraints import ConstraintRows, project_in_batches, queue

    isFixed = np.array([m.isFixed for m in meshes], dtype=bool)
    vertexCount = np.array([len(m.origVertices) for m in meshes], dtype=np.intp)
    rows = ConstraintRows(constraints, isFixed, vertexCount, tolerance)
    maximumVisits = max(int(maxIterations), rows.total)
    if scheduling == "batches":
        return project_in_batches(meshes, rows, tolerance, maximumVisits)

    table = rows.tolist()
    ends = np.unique(np.concatenate((rows.body1, rows.body2))).tolist()
    bodies = {b: meshes[b].body_state() for b in ends}
    vertices = {b: meshes[b].rotated_hull().vertices for b in ends}
    ties = {
        c: (
            bodies[b1],
            tuple(vertices[b1][:, v1].tolist()),
            bodies[b2],
            tuple(vertices[b2][:, v2].tolist()),
            refValue,
            upper,
        )
        for c, b1, v1, b2, v2, refValue, upper in table
    }

    def visit(c):
        """Looks at constraint c, corrects it if it is violated, and returns whether it was."""
        body1, r1, body2, r2, refValue, upper = ties[c]
        x1, x2, invMasses = body1.position, body2.position, (body1.invMass, body2.invMass)
        points = Pair(add(x1, r1), add(x2, r2), arms=(r1, r2))
        isValid, positions = resolve_position_constraint(
            Pair(x1, x2), points, refValue, invMasses, upper, tolerance
        )
        if isValid:
            return False
        # the points stay on the line that joins them: the direction is the same afterwards
        _, linVelocities, angVelocities = resolve_velocity_constraint(
            positions,
            points,
            Pair(body1.linVelocity, body2.linVelocity),
            Pair(body1.angVelocity, body2.angVelocity),
            invMasses,
            Pair(body1.invInertia, body2.invInertia, (3, 3)),
            tolerance,
        )
        body1.position, body2.position = floats_of(positions)
        body1.linVelocity, body2.linVelocity = floats_of(linVelocities)
        body1.angVelocity, body2.angVelocity = floats_of(angVelocities)
        return True

    if scheduling == "queue":
        movable = {c: [b for b in (b1, b2) if not isFixed[b]] for c, b1, _, b2, *_ in table}
        visits = queue(visit, movable, rows.total, maximumVisits)
    else:
        visits = sweep(visit, ties, rows.total, maximumVisits)
    for b, body in bodies.items():
        meshes[b].set_body_state(body)
    return visits


def sweep(visit, constraints, total, maximumVisits):
    """Visits in the list's order, over and over, until as many in a row as there are found nothing.

    visit : function of an index; constraints : indices that can be corrected, a dict or set; total
    Returns the number of visits.
    """
    visits = satisfiedInARow = 0
    while satisfiedInARow < total and visits < maximumVisits:
        c = visits % total
        satisfiedInARow = 0 if c in constraints and visit(c) else satisfiedInARow + 1
        visits += 1
    return visits
