"""The coursework: rigid bodies, their integration, collisions, constraints and the time step.

Reading order: `run_timestep` and `basic_step`, which follow the coursework's text; `Mesh`; contacts
with friction; distance constraints. Elsewhere stand what a mesh can do between steps
(rbs/stepping/meshes.py) and other steps (rbs/stepping/batches.py, rbs/softstep/step.py).

Lengths and masses have the units of the scene, time is in seconds, and gravity is by default 9.8
length units per second squared along -y. Vectors of one mesh are rows (1, 3), and quaternions are
rows (1, 4) with the scalar part first; (3,) and (4,) are accepted as well. The formulas work on one
body or pair, in tuples of floats, because NumPy's overhead dominates for arrays of three numbers.

Sources. Integration, impulses, inertia in world axes: Baraff, Rigid Body Simulation, SIGGRAPH 2001.
Inertia of a tetrahedron: Tonon, Explicit exact formulas for the 3-D tetrahedron inertia tensor,
J. Mathematics and Statistics 1(1), 2005. One impulse per contact, with friction: Mirtich,
Impulse-based dynamic simulation of rigid body systems, 1996. Position correction: Müller et al.,
Position based dynamics, 2007. Velocity constraints: Catto, Modeling and solving constraints, Game
Developers Conference 2009.
"""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import GJK
from Quaternion import exponential, multiply, rotation_matrices
from rbs.geometry.hulls import RotatedHull, build_hull
from rbs.geometry.triples import (
    ZERO,
    add,
    cross,
    divide,
    dot,
    floats,
    inverse_symmetric,
    mat_vec,
    matrix,
    mul_add,
    norm,
    number,
    rotate_tensor,
    row,
    scale,
    sub,
    vector,
)
from rbs.stepping.meshes import MeshTools, bytes_of, check_methods, check_states, refresh_vertices
from rbs.stepping.reports import GROUND, Step, StepReport, check_arguments
from rbs.stepping.settings import EARTH, Settings, step_arguments

# This module, whatever its name stands for later: a student's module may take it.
THIS_MODULE = sys.modules[__name__]
# Normal of the ground, and the direction that separates coincident points of a constraint.
UPWARDS = (0.0, 1.0, 0.0)
# Bounding box of a mesh without vertices, which overlaps no other.
EMPTY_BOX = (math.inf,) * 3 + (-math.inf,) * 3


def run_timestep(
    meshes: list[Mesh],
    groundMesh: Mesh | None,
    timeStep: float | None = None,
    CRCoeff: float | None = None,
    enforceConstraints: bool | None = None,
    constraints: Sequence = (),
    maxIterations: int | None = None,
    tolerance: float | None = None,
    *,
    settings: Settings | None = None,
    functions: ModuleType | None = None,
    solverState: Any = None,
    observer: Callable | None = None,
    **others: Any,
) -> StepReport:
    """Advances a scene by one time step, in place. An exception leaves everything unchanged.

    meshes : list of Mesh
    groundMesh : fixed Mesh without vertices, which stands for y ≤ 0, or None for free space. Its
        velocities are those of a conveyor belt: it may slide along its plane and turn about y
    timeStep : seconds ≥ 0. Collisions are detected after the motion, so that fast bodies may tunnel
    CRCoeff : see `resolve_collision`
    enforceConstraints : bool, by default True
    constraints : list of [m1, v1, m2, v2, refValue, upper]. The distance between rest vertex v1 of
        meshes[m1] and rest vertex v2 of meshes[m2] is ≤ refValue if upper, otherwise ≥ refValue, a
        length ≥ 0
    maxIterations : most constraint visits, by default 1000; each constraint is visited at least
        once. Visits count as in the coursework's text, also those that a schedule can omit. The
        report counts only those that are made: calls of `resolve_position_constraint`, each
        followed by one of `resolve_velocity_constraint` if it corrects
    tolerance : length by which a constraint may be violated before it is corrected, and speed at
        which its distance may then still change; by default 0.001
    others : further settings by name, see rbs/stepping/settings.py: mu, as for `resolve_collision`;
        gravity, three floats, acceleration of free fall; …
    settings : `Settings`, used for what is not given; without it, timeStep and CRCoeff are required
    functions : module whose `resolve_collision`, `resolve_position_constraint` and
        `resolve_velocity_constraint` are called; by default, this one
    solverState : SolverState of rbs/softstep/step.py, carried from one soft step to the next and
        changed in place; None starts cold
    observer : function that is called with each `Event` of the step, see rbs/glass/events.py.
        Contacts in batches then go pair by pair, with the same bits. The soft step has one event
        for each contact point, at its end, and constraints in batches have none

    Returns the step's `StepReport`.

    Raises TypeError or ValueError if an argument is invalid, a mesh is listed twice, a constraint
    refers to a mesh or vertex that does not exist or links a mesh to itself, or a step on arrays
    would not call a method that a subclass of Mesh overrides; rbs.stepping.meshes.StateError if a
    number would become NaN, infinite or absurdly large.
    """
    given = {"timeStep": timeStep, "CRCoeff": CRCoeff, "enforceConstraints": enforceConstraints}
    given |= {"maxIterations": maxIterations, "tolerance": tolerance, **others}
    check_arguments(meshes, groundMesh, constraints, functions, solverState, observer)
    functions = THIS_MODULE if functions is None else functions
    values = step_arguments(settings, given, len(constraints))
    scene = meshes, groundMesh, constraints
    step = Step(*scene, values, functions, solverState, isObserved=observer is not None)
    with step.undone_on_error():
        if step.isOnArrays or step.constraintScheduling == "batches":
            check_methods(meshes, Mesh)
            if functions is not THIS_MODULE:
                raise ValueError("functions would not be called on arrays")
        if observer is not None:
            from rbs.glass.events import Watch

            step.watch = Watch(observer, step)
        if step.contactSolver == "soft-step":
            from rbs.softstep.step import soft_step

            soft_step(step)
            if step.watch is not None:
                step.watch.report_points()
        elif step.isOnArrays:
            from rbs.stepping.batches import resolve_contacts

            resolve_contacts(step)
            resolve_constraints(step)
        else:
            basic_step(step)
    return step.report


def basic_step(step):
    """The coursework's step."""
    integrate(step)
    resolve_pairs(step)
    resolve_ground(step)
    resolve_constraints(step)


def integrate(step):
    """Moves all meshes in free flight."""
    # a subclass may take the coursework's argument only, which is enough by default
    flight = (step.timeStep,) if step.gravity == EARTH else (step.timeStep, step.gravity)
    with step.report.phase("integrate"):
        for mesh in step.meshes:
            integrate = mesh.integrate_tumbling if step.gyroscopic else mesh.integrate_timestep
            if mesh.load is None:
                integrate(*flight)
            else:
                integrate(step.timeStep, mesh.apply_torque(step.timeStep, step.gravity))
            if mesh.isFixed:
                mesh.follow_velocity(step.timeStep)
        if step.watch is not None:
            step.watch.report_flights()
        check_states(step.meshes, "free flight")


def resolve_pairs(step):
    """Detects and resolves the collisions of all pairs i < j, in this order.

    Each detection sees the corrections of the earlier pairs. Only pairs whose bounding boxes are
    apart when it is their turn are left out, with every broad phase, which changes no result.
    """
    meshes, count = step.meshes, 0
    with step.report.phase("collisions"):
        boxes = [mesh.bounding_box() for mesh in meshes]
        pairs = itertools.combinations(range(len(meshes)), 2)
        if step.broadPhase == "grid":
            from rbs.geometry.broadphase import grid_pairs

            pairs = grid_pairs(boxes, [mesh.isFixed for mesh in meshes])
        if not step.linkedBodiesCollide:
            from rbs.stepping.constraints import linked_keys

            linked = set(linked_keys(step, len(meshes)).tolist())
            pairs = ((i, j) for i, j in pairs if i * len(meshes) + j not in linked)
        for i, j in pairs:
            count += 1
            if not boxes_meet(boxes[i], boxes[j]):
                continue
            m1, m2 = meshes[i], meshes[j]
            isCollision, *contact = m1.detect_collision(m2)
            if isCollision:
                begun, last = step.begin_contact(i, j, contact), step.contactSettings
                impulses = step.functions.resolve_collision(m1, m2, *contact, *last)
                step.end_contact(i, j, contact, impulses, begun)
                boxes[i], boxes[j] = m1.bounding_box(), m2.bounding_box()
        step.report.candidatePairs = count


def resolve_ground(step):
    """Resolves the collision of each mesh whose lowest vertex has y ≤ 0 with the ground."""
    with step.report.phase("ground"):
        for i, mesh in enumerate(step.meshes if step.groundMesh is not None else ()):
            lowest = mesh.lowest_vertex()
            if lowest is not None and lowest[1] <= 0.0:
                # the normal points into the body, and the depth is negative to match
                contact = float(lowest[1]), row(UPWARDS), lowest[None]
                last = step.contactSettings
                begun, ends = step.begin_contact(i, GROUND, contact), (mesh, step.groundMesh)
                impulses = step.functions.resolve_collision(*ends, *contact, *last)
                step.end_contact(i, GROUND, contact, impulses, begun)
        check_states(step.meshes, "contacts")


def resolve_constraints(step):
    """Visits all constraints, over and over, until a whole sweep corrects none.

    Queue and batches, which leave out visits or change their order: rbs/stepping/constraints.py.
    """
    if len(step.constraints) == 0:
        return
    with step.report.phase("constraints"):
        from rbs.stepping.constraints import ConstraintRows, project_in_batches, queue, sweep

        meshes = step.meshes
        rows = ConstraintRows(step.constraints, meshes, step.tolerance)
        most = max(step.maxIterations, rows.total) if len(rows.index) else 0
        if step.constraintScheduling == "batches":
            visits = project_in_batches(step, rows, most)
        else:
            step.tensor = cache(lambda b: meshes[b].get_rotated_inv_IT())
            schedule = queue if step.constraintScheduling == "queue" else sweep
            visits = schedule(partial(visit, step), rows.links(meshes), rows.total, most)
        step.report.constraintVisits = visits
        check_states(meshes, "contacts and constraints")


def visit(step, link):
    """Corrects two bodies for each bound of a `Link` that is violated; returns whether one was."""
    b1, b2, invMasses = link.body1, link.body2, link.invMasses
    m1, m2 = step.meshes[b1], step.meshes[b2]
    points, isCorrected, watch, tolerance = None, False, step.watch, step.tolerance
    for bound in link.bounds:
        _, refValue, upper = bound
        before = watch and watch.states(b1, b2)
        if points is None:  # at first, and after a correction
            positions = x1, x2 = m1.position, m2.position
            points = x1 + link.arm1, x2 + link.arm2
        positionWasValid, (x1, x2) = step.functions.resolve_position_constraint(
            positions, points, refValue, invMasses, upper, tolerance
        )
        if not positionWasValid:
            # the points stay on one line, so that arms and direction still hold
            linVelocities = m1.linVelocity, m2.linVelocity
            angVelocities = m1.angVelocity, m2.angVelocity
            tensors = step.tensor(b1), step.tensor(b2)
            _, (v1, v2), (omega1, omega2) = step.functions.resolve_velocity_constraint(
                positions, points, linVelocities, angVelocities, invMasses, tensors, tolerance
            )
            if invMasses[0]:
                m1.position, m1.linVelocity, m1.angVelocity = x1, v1, omega1
            if invMasses[1]:
                m2.position, m2.linVelocity, m2.angVelocity = x2, v2, omega2
            points, isCorrected = None, True
        if watch is not None:
            watch.report_visit(link, bound, before, positionWasValid)
    return isCorrected


# Mesh


class Mesh(MeshTools):
    """A rigid body: a tetrahedral mesh with a density, a pose and a velocity.

    The arrays are copied. A mesh without vertices is the ground: fixed, and without a shape.

    origVertices : (V, 3), rest vertices. They are translated so that the COM is the origin, and
        then read-only, because mass, inertia and hull follow from them
    faces : (F, 3) int, boundary triangles, counter-clockwise seen from outside
    tets : (T, 4) int, tetrahedra that fill the body without overlap, in either orientation; none if
        the faces are a closed surface that is not to be filled, such as a torus
    density : mass per volume, > 0
    position : (1, 3), COM in the world
    orientation : (1, 4), quaternion from rest to world, not zero; normalised on entry
    isFixed : bool; a fixed mesh has infinite mass. It moves only if it is given a velocity
        afterwards, like a conveyor, a turntable or a paddle; contacts do not change that velocity

    Its attributes, besides these:

    currVertices : (V, 3), vertices in the world, at the present pose
    linVelocity, angVelocity : (1, 3), velocity of the COM, and angular velocity in rad/s
    density, mass, invMass : floats; invMass is 0 if the mesh is fixed
    IT, invIT : (3, 3), inertia tensor about the COM at rest, and its inverse, 0 if fixed. They,
        invMass and the state may be assigned; shape, density, mass and volume are read-only
    load : (force, torque) that act in each step, see `set_force`, or None
    volume, hullVolume : of the tetrahedra, and of the convex hull, which is what collides
    hull : rbs.geometry.hulls.Hull
    cachedAxes : dict, by the id of another mesh: the axis of separation or of least penetration
        last found, and whether the two touched. It saves time and changes no result

    Raises ValueError if an argument has a wrong shape, value or index, or vertices have no mass.
    """

    def __init__(
        self,
        name: str,
        origVertices: ArrayLike,
        faces: ArrayLike,
        tets: ArrayLike,
        density: float,
        position: ArrayLike,
        orientation: ArrayLike,
        isFixed: bool,
    ) -> None:
        self.name = name
        self._table, self._row = None, 0  # where a step on arrays has left the state
        self._origVertices = self._numbers("origVertices", origVertices, 3)
        self.givenVertices = self._origVertices  # as they were given, not relative to the COM
        self._faces = self._numbers("faces", faces, 3, dtype=np.int64)
        self._tets = self._numbers("tets", tets, 4, dtype=np.int64)
        self._density = float(self._numbers("density", density, 1, 1)[0, 0])
        self.position = self._numbers("position", position, 3, 1)
        self.orientation = self._numbers("orientation", orientation, 4, 1)
        length = math.hypot(*self.orientation[0].tolist())
        if not 0 < length < math.inf:
            raise ValueError(f"mesh {name}: the orientation is zero or not finite")
        self.orientation /= length
        self.linVelocity = np.zeros((1, 3))
        self.angVelocity = np.zeros((1, 3))

        self._mass, self._volume, self._hullVolume, self._hull = 0.0, 0.0, 0.0, None
        self.IT = np.zeros((3, 3))
        if len(self.origVertices) > 0:
            self._init_mass_properties()
        for shape in (self._origVertices, self._faces, self._tets):
            shape.flags.writeable = False
        self.isFixed, self.load = isFixed, None
        self.cachedAxes = {}
        # each with the bytes of its pose
        self._rotatedHull = self._currVertices = None, None

    def _init_mass_properties(self):
        """Sets volume, mass and IT, centres the rest vertices on the COM, and builds the hull.

        Over a tetrahedron of volume V with corners x_i, the integral of x is V (Σ x_i) / 4, and
        that of x xᵀ is V/20 (Σ x_i x_iᵀ + (Σ x_i)(Σ x_i)ᵀ) (Tonon 2005). With C the sum of the
        latter, about the COM, times the density, the inertia tensor is tr(C) 1 - C. Without
        tetrahedra, those from vertex 0 to each face count, with V negative for a face seen from
        behind: parts outside a closed surface cancel.
        """
        for corners, what in ((self.faces, "face"), (self.tets, "tetrahedron")):
            if corners.size and not 0 <= corners.min() <= corners.max() < len(self.origVertices):
                raise ValueError(f"mesh {self.name}: a {what} refers to vertices out of range")
        tets = self.tets if len(self.tets) else np.insert(self.faces, 0, 0, axis=1)
        corners = self.origVertices[tets]  # (T, 4, 3)
        e1, e2, e3 = (corners[:, k] - corners[:, 0] for k in (1, 2, 3))
        volumes = np.sum(e1 * np.cross(e2, e3), axis=1) / 6.0
        if len(self.tets):
            volumes = np.abs(volumes)
        self._volume = float(volumes.sum())
        self._mass = self.density * self.volume
        if not 0 < self.mass < math.inf:
            what = f"density {self.density:g} and volume {self.volume:g}"
            raise ValueError(f"mesh {self.name}: {what} give no positive, finite mass")
        centreOfMass = (volumes[:, None] * corners.mean(axis=1)).sum(axis=0) / self.volume
        self._origVertices = self.origVertices - centreOfMass
        try:
            self._hull = build_hull(self.origVertices)
        except ValueError as error:
            raise ValueError(f"mesh {self.name}: {error}") from None
        self._hullVolume = self.hull.volume
        corners -= centreOfMass
        sums = corners.sum(axis=1)
        outer = (corners[:, :, :, None] * corners[:, :, None, :]).sum(axis=1)
        outer += sums[:, :, None] * sums[:, None, :]
        covariance = self.density * (volumes[:, None, None] / 20.0 * outer).sum(axis=0)
        try:
            self.IT = np.trace(covariance) * np.eye(3) - covariance
        except ValueError:
            isSolid = len(self.tets) > 0
            what = "it is too thin" if isSolid else "its faces are not closed and turned outwards"
            raise ValueError(f"mesh {self.name} has no inertia tensor: {what}") from None

    @property
    def isFixed(self) -> bool:
        """Whether the mesh cannot move. Assigning True fixes it at rest, and False frees it."""
        return self._invMass == 0.0

    @isFixed.setter
    def isFixed(self, isFixed: bool) -> None:
        if self._flag("isFixed", isFixed):
            self.linVelocity, self.angVelocity = np.zeros((1, 3)), np.zeros((1, 3))
        if isFixed or len(self.origVertices) == 0:
            self.invMass, self.invIT = 0.0, np.zeros((3, 3))
        else:
            self.invMass = 1.0 / self.mass
            try:
                self.invIT = np.array(inverse_symmetric(floats(self.IT, 9))).reshape(3, 3)
            except (ValueError, ZeroDivisionError):
                what = "its inertia tensor has no inverse, because it is too small or too thin"
                raise ValueError(f"mesh {self.name}: {what}") from None

    def integrate_timestep(self, timeStep: float, gravity: tuple = EARTH) -> None:
        """Integrates timeStep seconds of free flight under gravity g. A fixed mesh stays.

        Semi-implicit Euler: v ← v + g h, COM ← COM + v h with the new velocity, and
        orientation ← exp(ω h/2) ∘ orientation. The angular velocity stays.
        """
        if not self.isFixed:
            self._integrate(number(timeStep), gravity)

    def _integrate(self, h, gravity):
        linVelocity = mul_add(vector(self.linVelocity), h, gravity)
        position = mul_add(vector(self.position), h, linVelocity)
        turn = exponential((0.0, *scale(0.5, scale(h, vector(self.angVelocity)))))
        w, x, y, z = multiply(turn, floats(self.orientation, 4))
        # rounding makes a product of unit quaternions drift from unit length
        length = math.sqrt(w * w + (x * x + y * y + z * z))
        self.linVelocity, self.position = row(linVelocity), row(position)
        self.orientation = np.array([[w / length, x / length, y / length, z / length]])

    def bounding_box_collision(self, m: Mesh) -> bool:
        """Whether the axis-aligned boxes of this mesh and of m overlap or touch."""
        return boxes_meet(self.bounding_box(), m.bounding_box())

    def detect_collision(self, m: Mesh) -> tuple:
        """Tests the convex hulls of this mesh and of m for collision at their present poses.

        Returns `(isCollision, depth, intNormal, intPosition)` as `GJK.is_collide` does, with this
        mesh as hull 1: moving m by depth along intNormal (1, 3) separates the two, and intPosition
        (1, 3) is the point of m deepest inside this mesh. Two fixed meshes never collide.
        """
        if (self.isFixed and m.isFixed) or not self.bounding_box_collision(m):
            return GJK.NO_COLLISION
        position1, position2 = vector(self.position), vector(m.position)
        t, cached = sub(position2, position1), self.cachedAxes.get(id(m), ())
        given = self.rotated_hull(), m.rotated_hull(), t, *cached
        isCollision, depth, normal, point = GJK.collide_rotated(*given)
        self.cachedAxes[id(m)] = normal, isCollision
        if not isCollision:
            return GJK.NO_COLLISION
        return True, depth, row(normal), row(add(point, position2))

    def lowest_vertex(self) -> np.ndarray | None:
        """Returns the first lowest vertex in the world (3,), or None if the mesh is fixed."""
        if self.isFixed:
            return None
        vertices, position = self.rotated_hull().points, vector(self.position)
        column = (vertices[1] + position[1]).argmin()
        return np.array(add(vertices[:, column].tolist(), position))

    def get_rotated_inv_IT(self) -> np.ndarray:
        """Inverse inertia tensor in world axes, R I⁻¹ Rᵀ: (3, 3); 0 if the mesh is fixed."""
        if self.isFixed:
            return np.zeros((3, 3))
        rotation = rotation_matrices(floats(self.orientation, 4))
        return np.array(rotate_tensor(rotation, matrix(self.invIT))).reshape(3, 3)

    def body_state(self) -> Body:
        """Returns the present state as a `Body`, for the formulas of a contact."""
        state = self.position, self.linVelocity, self.angVelocity
        tensor = matrix(self.get_rotated_inv_IT())
        return Body(self.invMass, tensor, *map(vector, state))

    def set_body_state(self, body: Body) -> None:
        """Stores the position and velocities of a `Body`. An immovable mesh keeps its own."""
        if body.invMass != 0.0:
            self.position = row(body.position)
            self.linVelocity = row(body.linVelocity)
            self.angVelocity = row(body.angVelocity)

    def rotated_hull(self) -> RotatedHull | None:
        """Returns the `RotatedHull` at the present orientation; None without vertices."""
        orientation = bytes_of(self.orientation)
        if self._rotatedHull[0] != orientation and self._hull is not None:
            rotation = rotation_matrices(floats(self.orientation, 4))
            self._rotatedHull = orientation, RotatedHull(self.hull, self.origVertices, rotation)
        return self._rotatedHull[1]

    def bounding_box(self) -> tuple:
        """Returns the least and greatest x, y, z of the hull in the world: six floats."""
        if self._hull is None:
            return EMPTY_BOX
        x, y, z = vector(self.position)
        (a, b, c), (d, e, f) = (rotated := self.rotated_hull()).low, rotated.high
        return a + x, b + y, c + z, d + x, e + y, f + z

    @property
    def currVertices(self) -> np.ndarray:
        """Vertices in the world (V, 3), read-only. An assignment lasts until the pose changes."""
        if self._currVertices[0] != self.pose():
            refresh_vertices([self])
        return self._currVertices[1]

    @currVertices.setter
    def currVertices(self, vertices: np.ndarray) -> None:
        vertices = self._numbers("currVertices", vertices, 3, len(self.origVertices))
        self._currVertices = self.pose(), vertices


def boxes_meet(a, b):
    """Whether two bounding boxes, six floats each, overlap or touch."""
    if a[0] > b[3] or b[0] > a[3] or a[1] > b[4] or b[1] > a[4]:
        return False
    return a[2] <= b[5] and b[2] <= a[5]


def ground() -> Mesh:
    """Returns the ground y ≤ 0: a fixed Mesh without vertices, at the origin."""
    return Mesh("ground", [], [], [], 0.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), True)


# Contacts


@dataclass(slots=True)
class Body:
    """State of a body that a contact changes; vectors are tuples of three."""

    invMass: float  # 0 if immovable
    invInertia: tuple  # nine entries row by row, world axes; 0 if immovable
    position: tuple
    linVelocity: tuple = ZERO
    angVelocity: tuple = ZERO


def resolve_collision(m1, m2, depth, contactNormal, penPoint, CRCoeff, mu=0.0):
    """Separates two penetrating meshes and applies the contact impulses, in place.

    The position correction is split by inverse mass, see `position_corrections`. For the impulses,
    let n be the normal, u the velocity of body 1 relative to body 2 at the contact point, which has
    moved along with m2, and K the sum of both inverse effective masses. An impulse -j n on body 1
    and +j n on body 2 lowers the closing speed u · n by j K. Restitution requires it to become
    -e (u · n), hence j = (1 + e) (u · n) / K.

    m1, m2 : Mesh
    depth : penetration depth. A negative one moves the meshes the opposite way, as for the ground,
        whose normal points into the mesh
    contactNormal : (1, 3), unit; m2 moves along it, m1 against it
    penPoint : (1, 3), the point of m2 deepest inside m1
    CRCoeff : coefficient of restitution e, 0 (no bounce) to 1 (no loss); e > 1 adds energy, and
        e < 0 keeps the fraction -e of the closing speed
    mu : coefficient of friction ≥ 0. It limits the friction impulse to mu times the normal impulse

    Returns `(impulse, friction, arm)`: the impulses on body 2, along the normal and across it, and
    the contact point from the COM of body 1. Returns None if neither mesh can move.
    """
    e, mu = number(CRCoeff), number(mu)
    body1, body2 = m1.body_state(), m2.body_state()
    if body1.invMass + body2.invMass == 0.0:
        return None
    depth, n, point = number(depth), vector(contactNormal), vector(penPoint)
    # A depth of 0 has no sign. On the ground, the normal then points into m1.
    if depth < 0.0 or (depth == 0.0 and len(m2.origVertices) == 0):
        depth, n = -depth, scale(-1.0, n)

    correction1, correction2 = position_corrections(body1.invMass, body2.invMass, depth)
    body1.position = mul_add(body1.position, correction1, n)
    body2.position = mul_add(body2.position, correction2, n)
    point = mul_add(point, correction2, n)
    r1, r2 = sub(point, body1.position), sub(point, body2.position)

    k1, response1 = inverse_effective_mass(body1.invMass, body1.invInertia, cross(r1, n))
    k2, response2 = inverse_effective_mass(body2.invMass, body2.invInertia, cross(r2, n))
    j = (1.0 + e) * dot(relative_velocity(body1, body2, r1, r2), n) / (k1 + k2)
    apply_impulse(body1, body2, j, n, response1, response2)
    friction = apply_friction(body1, body2, r1, r2, n, mu * j) if mu else ZERO
    m1.set_body_state(body1)
    m2.set_body_state(body2)
    return j, friction, r1


def position_corrections(invMass1, invMass2, distance):
    """Displacements of both bodies along n, which move body 2 by a distance relative to body 1.

    Each is proportional to w_i = m_i⁻¹ / (m_1⁻¹ + m_2⁻¹): the common COM stays. One mass is finite.
    """
    total = invMass1 + invMass2
    return -(invMass1 / total * distance), invMass2 / total * distance


def relative_velocity(body1, body2, r1, r2):
    """Velocity of body 1 relative to body 2 at their arms: v1 + ω1 × r1 - (v2 + ω2 × r2)."""
    return sub(
        add(body1.linVelocity, cross(body1.angVelocity, r1)),
        add(body2.linVelocity, cross(body2.angVelocity, r2)),
    )


def inverse_effective_mass(invMass, invInertia, rCrossN):
    """Response of a body to a unit impulse n at an arm r: `(k, response)`. K is the sum of both k.

    response : I⁻¹ (r × n), the change of the angular velocity
    k : the change along n of the velocity at the arm. The motion of the COM contributes m⁻¹, and
        the rotation ((I⁻¹ (r × n)) × r) · n = (r × n) · I⁻¹ (r × n)
    """
    response = mat_vec(invInertia, rCrossN)
    return invMass + dot(rCrossN, response), response


def apply_impulse(body1, body2, j, n, response1, response2):
    """Applies -j n to body 1 and +j n to body 2: v ← v ∓ j m⁻¹ n and ω ← ω ∓ j I⁻¹ (r × n)."""
    for body, impulse, response in ((body1, -j, response1), (body2, j, response2)):
        body.linVelocity = mul_add(body.linVelocity, impulse * body.invMass, n)
        body.angVelocity = mul_add(body.angVelocity, impulse, response)


def apply_friction(body1, body2, r1, r2, n, limit):
    """Applies Coulomb friction at a contact and returns the impulse vector on body 2.

    body1, body2 : `Body`; r1, r2 : arms; n : unit normal
    limit : μ times the normal impulse; no friction acts if it is negative

    Let u be the `relative_velocity`, t the unit vector of its part perpendicular to n, and K the
    sum of the inverse effective masses along t. The impulse j = u · t / K stops the slip along t;
    the bodies may then slip in another direction, or close. Friction applies the lesser of this and
    its limit, and thus never reverses the slip along t. The kinetic energy changes by
    -j u · t + j² K / 2, which is at most 0 for 0 ≤ j ≤ u · t / K.
    """
    u = relative_velocity(body1, body2, r1, r2)
    across = mul_add(u, -dot(u, n), n)
    speed = norm(across)
    t = divide(across, speed or 1.0)
    k1, response1 = inverse_effective_mass(body1.invMass, body1.invInertia, cross(r1, t))
    k2, response2 = inverse_effective_mass(body2.invMass, body2.invInertia, cross(r2, t))
    j = min(speed / (k1 + k2), max(limit, 0.0) + 0.0)  # turns -0.0 into 0.0
    apply_impulse(body1, body2, j, t, response1, response2)
    return scale(j, t)


# Distance constraints


def resolve_position_constraint(
    currPositions, currConstPoints, refValue, invMasses, upper, tolerance
):
    """Moves two bodies so that a bound on the distance between two of their points holds.

    A violated bound moves the bodies along p1 - p2, in proportion to their inverse masses, until
    C = ‖p1 - p2‖ - refValue is 0. Coincident points separate along y, the first one upwards.

    currPositions, currConstPoints : pairs of arrays (1, 3), the COMs, and the points p1 and p2
    refValue : length ≥ 0
    invMasses : pair of inverse masses, 0 if immovable. Two immovable bodies stay as they are
    upper : an upper bound is valid if C ≤ tolerance, a lower one if C ≥ -tolerance
    tolerance : length

    Returns `(positionWasValid, correctedPositions)`, the latter a pair of arrays (1, 3), new COMs;
    the given pair if they stay.
    """
    d = sub(vector(currConstPoints[0]), vector(currConstPoints[1]))
    length = norm(d)
    C = length - number(refValue)
    if not (C > tolerance if upper else C < -tolerance):
        return True, currPositions
    invMass1, invMass2 = number(invMasses[0]), number(invMasses[1])
    if invMass1 + invMass2 == 0.0:
        return False, currPositions
    x1, x2 = vector(currPositions[0]), vector(currPositions[1])
    n = direction(d, length)
    correction1, correction2 = position_corrections(invMass1, invMass2, C)
    return False, (row(mul_add(x1, correction1, n)), row(mul_add(x2, correction2, n)))


def resolve_velocity_constraint(
    currPositions,
    currConstPoints,
    currLinVelocities,
    currAngVelocities,
    invMasses,
    invInertiaTensors,
    tolerance,
):
    """Stops the change of the distance between two points of two bodies.

    With n the unit vector of p1 - p2 and J = [n, r1 × n, -n, -(r2 × n)], J v is the rate at which
    ‖p1 - p2‖ grows, and J M⁻¹ Jᵀ is the inverse effective mass K. The correction
    Δv = -M⁻¹Jᵀ (J M⁻¹ Jᵀ)⁻¹ J v makes J v zero: it is the impulse of a collision without
    restitution. Two immovable bodies keep their velocities.

    currPositions, currConstPoints, invMasses : as for `resolve_position_constraint`
    currLinVelocities, currAngVelocities : pairs of arrays (1, 3)
    invInertiaTensors : pair of arrays (3, 3), inverse inertia tensors in world axes
    tolerance : speed. The velocities are valid if |J v| ≤ tolerance

    Returns `(velocityWasValid, correctedLinVelocities, correctedAngVelocities)`, the last two pairs
    of arrays (1, 3); the given pairs if they stay.
    """
    p1, p2 = vector(currConstPoints[0]), vector(currConstPoints[1])
    v1, v2 = vector(currLinVelocities[0]), vector(currLinVelocities[1])
    omega1, omega2 = vector(currAngVelocities[0]), vector(currAngVelocities[1])
    d = sub(p1, p2)
    n = direction(d, norm(d))
    r1CrossN = cross(sub(p1, vector(currPositions[0])), n)
    r2CrossN = cross(sub(p2, vector(currPositions[1])), n)
    Jv = dot(n, v1) + dot(r1CrossN, omega1) - dot(n, v2) - dot(r2CrossN, omega2)
    invMass1, invMass2 = number(invMasses[0]), number(invMasses[1])
    wasValid = abs(Jv) <= number(tolerance)
    if wasValid or invMass1 + invMass2 == 0.0:
        return wasValid, currLinVelocities, currAngVelocities
    k1, response1 = inverse_effective_mass(invMass1, matrix(invInertiaTensors[0]), r1CrossN)
    k2, response2 = inverse_effective_mass(invMass2, matrix(invInertiaTensors[1]), r2CrossN)
    impulse = -Jv / (k1 + k2)
    return (
        False,
        (row(mul_add(v1, impulse * invMass1, n)), row(mul_add(v2, -impulse * invMass2, n))),
        (row(mul_add(omega1, impulse, response1)), row(mul_add(omega2, -impulse, response2))),
    )


def direction(d, length):
    """Unit vector n of d = p1 - p2, of this length, upwards if the points coincide."""
    return divide(d, length) if length > 0.0 else UPWARDS
