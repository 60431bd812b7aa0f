"""The coursework: rigid bodies, the integrator, collisions, constraints, and the step of them all.

From the top: `run_timestep`, which reads as the coursework's text; `Mesh`; free flight; contacts
with friction; distance constraints; and the accelerated step, which applies the same formulas to
thousands of bodies at once. Which pairs and which constraints, and when, is decided in rbs/.

Units are whatever the scene uses, lengths and masses alike, with seconds and a gravity of 9.8
length units per second squared along -y. Vectors of one mesh are rows (1, 3), quaternions (1, 4)
with the scalar part first; (3,) and (4,) are accepted wherever one is passed in or assigned. The
formulas stand once, on components, tuples or arrays: see rbs/vectors.py.

Sources. Impulses and the inertia of a rotated body: Baraff, Rigid Body Simulation, SIGGRAPH course
notes, 2001. Inertia of a tetrahedron: Tonon, Explicit exact formulas for the 3-D tetrahedron
inertia tensor, J. Mathematics and Statistics 1(1), 2005. One impulse a contact, with friction along
the sliding: Mirtich, Impulse-based dynamic simulation of rigid body systems, 1996. Positions
corrected in proportion to the inverse masses: Müller et al., Position based dynamics, 2007.
Constraints on velocities: Catto, Modeling and solving constraints, Game Developers Conference 2009.
"""

import itertools
import math
from functools import partial
from typing import NamedTuple

import numpy as np

import GJK
from Quaternion import rotation_matrices
from rbs.arrays import indices, take
from rbs.batches import OrderedBatches
from rbs.bodies import (
    Bodies,
    BodyState,
    MeshStates,
    StateColumn,
    check_distinct,
    check_numbers,
    restored_on_error,
    state_columns,
)
from rbs.constraints import Anchor, ConstraintRows, distance_error
from rbs.flight import GRAVITY as GRAVITY  # it is asked for here
from rbs.flight import free_flight, gyroscopic_velocity
from rbs.hulls import build_hull
from rbs.poses import Posed
from rbs.reports import GROUND, StepReport
from rbs.schedules import batches, queue, sweep
from rbs.settings import check_arguments
from rbs.softstep import soft_step
from rbs.vectors import (
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

# The ground's normal. It points into the body, which is why the depth there is negative.
UPWARDS = (0.0, 1.0, 0.0)


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
        with `sleeping`, what rests is left out until it is disturbed. See rbs/softstep.py
    gyroscopic : whether the angular velocity changes in free flight, as Euler's equation has it
    solverState : `rbs.softstep.SolverState`, what a soft step leaves to the next, changed in
        place; None starts cold

    Raises ValueError, which says what, for options that it refuses, a mesh that is in the list
    twice, and a constraint of what is not there; `rbs.bodies.StateError`, which names the body,
    where a number would become NaN, infinite or absurdly large. Whatever is raised, the meshes are
    then as they were before the step.
    """
    checked = check_arguments(
        timeStep=timeStep, CRCoeff=CRCoeff, enforceConstraints=enforceConstraints,
        maxIterations=maxIterations, tolerance=tolerance, closingOnly=closingOnly,
        constraintScheduling=constraintScheduling, mu=mu, broadPhase=broadPhase,
        contactSolver=contactSolver, substeps=substeps, sleeping=sleeping, gyroscopic=gyroscopic,
    )  # fmt: skip
    timeStep, tolerance = checked["timeStep"], checked["tolerance"]
    contactSettings = ContactSettings(*(checked[name] for name in ContactSettings._fields))
    if not enforceConstraints:
        constraints = ()
    project = partial(
        project_constraints, constraints=constraints, maxIterations=maxIterations,
        tolerance=tolerance, scheduling=constraintScheduling,
    )  # fmt: skip
    if contactSolver == "soft-step":
        return soft_step(meshes, groundMesh is not None, timeStep, contactSettings.CRCoeff,
                         contactSettings.mu, constraints, checked["substeps"], sleeping, gyroscopic,
                         solverState)  # fmt: skip
    if broadPhase == "grid":
        return _accelerated_step(meshes, groundMesh, timeStep, contactSettings, project, gyroscopic)

    check_distinct(meshes)
    report = StepReport()
    extensions = {"closingOnly": closingOnly, "mu": mu} if closingOnly or mu else {}
    with restored_on_error(meshes):
        with report.phase("integrate"):
            for mesh in meshes:
                if gyroscopic:
                    mesh.apply_gyroscopic_term(timeStep)
                mesh.integrate_timestep(timeStep)
            check_numbers(state_columns(meshes), meshes, "free flight")
        with report.phase("collisions"):
            for (i, m1), (j, m2) in itertools.combinations(enumerate(meshes), 2):
                isCollision, depth, normal, point = m1.detect_collision(m2)
                if isCollision:
                    contact = depth, normal, point
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
        with report.phase("constraints"):
            report.constraintVisits = project(MeshStates(meshes))
        check_numbers(state_columns(meshes), meshes, "contacts and constraints")
    return report


class ContactSettings(NamedTuple):
    """How contacts are resolved; see `resolve_collision`."""

    CRCoeff: float
    closingOnly: bool
    mu: float


def contact_settings(CRCoeff, closingOnly, mu):
    """The ContactSettings of a caller's arguments; raises ValueError."""
    return ContactSettings(**check_arguments(CRCoeff=CRCoeff, closingOnly=closingOnly, mu=mu))


# --------------------------------------------------------------------------------------------------
# Mesh
# --------------------------------------------------------------------------------------------------


class Mesh(Posed):
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
    its stead; hull, a `rbs.hulls.Hull`.
    """

    position, orientation = StateColumn(), StateColumn()
    linVelocity, angVelocity = StateColumn(), StateColumn()
    invMass, invIT = StateColumn(), StateColumn()

    def __init__(self, name, origVertices, faces, tets, density, position, orientation, isFixed):
        self.name = name
        self.origVertices = self._table("origVertices", origVertices, 3, np.float64)
        self.faces = self._table("faces", faces, 3, np.int64)
        self.tets = self._table("tets", tets, 4, np.int64)
        self.density = number(density)
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
        self.isFixed = isFixed
        self._forget()

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
        if isFixed:
            self.linVelocity, self.angVelocity = np.zeros((1, 3)), np.zeros((1, 3))
        if isFixed or len(self.origVertices) == 0:
            self.invMass, self.invIT = 0.0, np.zeros((3, 3))
        else:
            self.invMass, self.invIT = 1.0 / self.mass, np.linalg.inv(self.IT)

    def integrate_timestep(self, timeStep):
        """Moves the mesh on by timeStep seconds of free flight; a fixed mesh stays as it is.

        Semi-implicit Euler: v ← v + g h, COM ← COM + v h with the new velocity, orientation ←
        exp(ω h/2) ∘ orientation. The angular velocity stays: the gyroscopic term is left out.
        """
        if self.isFixed:
            return
        linVelocity, position, orientation = free_flight(
            floats(self.linVelocity, 3), floats(self.angVelocity, 3),
            floats(self.position, 3), floats(self.orientation, 4), number(timeStep),
        )  # fmt: skip
        self.linVelocity, self.position = _row(linVelocity, 3), _row(position, 3)
        self.orientation = _row(orientation, 4)

    def apply_gyroscopic_term(self, timeStep):
        """Turns the angular velocity as torque-free motion does; see `gyroscopic_velocity`."""
        if self.invMass != 0.0:
            angVelocity = gyroscopic_velocity(
                floats(self.angVelocity, 3), floats(self.orientation, 4), floats(self.IT, 9),
                number(timeStep),
            )  # fmt: skip
            self.angVelocity = _row(angVelocity, 3)

    def bounding_box_collision(self, m):
        """Whether the axis-aligned boxes of this mesh and of m overlap or touch."""
        pose1, pose2 = self.pose(), m.pose()
        if pose1 is None or pose2 is None:
            return False
        a, b = pose1.box, pose2.box  # the least x, y, z and the greatest
        return (
            a[0] <= b[3] and b[0] <= a[3]
            and a[1] <= b[4] and b[1] <= a[4]
            and a[2] <= b[5] and b[2] <= a[5]
        )  # fmt: skip

    def detect_collision(self, m):
        """Collision of the convex hulls of this mesh and of m, at their positions and orientations.

        Returns `(isCollision, depth, intNormal, intPosition)` as `GJK.is_collide` does, this mesh
        being hull 1: m has to move by depth along intNormal (1, 3) to separate, and intPosition
        (1, 3) is the point of m that is deepest inside this mesh. Two fixed meshes never collide.
        """
        if not self.bounding_box_collision(m) or (self.isFixed and m.isFixed):
            return GJK.NO_COLLISION
        pose1, pose2 = self.pose(), m.pose()
        t = sub(pose2.position, pose1.position)
        isCollision, depth, normal, point = GJK.collide_rotated(
            pose1.rotated, pose2.rotated, t, self.cachedAxes.get(m)
        )
        self.cachedAxes[m] = normal
        if not isCollision:
            return GJK.NO_COLLISION
        return True, depth, _row(normal, 3), _row(add(point, pose2.position), 3)

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
        """What a contact or a constraint reads and changes, in floats: `BodyState`."""
        invInertia = np.zeros((3, 3)) if self.isFixed else self.get_rotated_inv_IT()
        return BodyState(
            float(self.invMass), floats(invInertia, 9), floats(self.position, 3),
            floats(self.linVelocity, 3), floats(self.angVelocity, 3),
        )  # fmt: skip

    def set_body_state(self, state):
        """Takes over position and velocities; what cannot move stays as it is."""
        if state.invMass == 0.0:
            return
        self.position = _row(state.position, 3)
        self.linVelocity = _row(state.linVelocity, 3)
        self.angVelocity = _row(state.angVelocity, 3)


def _row(value, count):
    """A new (1, count) array out of anything with `count` entries."""
    return np.array(value, dtype=np.float64).reshape(1, count)


# --------------------------------------------------------------------------------------------------
# Contacts
# --------------------------------------------------------------------------------------------------

NO_FRICTION = (0.0, 0.0, 0.0)


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

    The interpenetration is split by inverse mass; one impulse at the contact point, which moves
    along with m2, reverses the closing speed and scales it by the restitution.

    Returns the `ContactImpulses`, None of two meshes that cannot move, which stay as they are.
    Raises ValueError for a restitution that is not finite, or a friction that is negative or not.
    """
    settings = contact_settings(CRCoeff, closingOnly, mu)
    body1, body2 = m1.body_state(), m2.body_state()
    if body1.invMass + body2.invMass == 0.0:
        return None
    depth, normal = number(depth), floats(contactNormal, 3)
    # A depth of 0 does not tell which way the normal points; on the ground, it is into m1.
    isGround = len(m2.origVertices) == 0
    if depth < 0.0 or (depth == 0.0 and isGround):
        depth, normal = -depth, scale(-1.0, normal)
    bodies = body1, body2
    arms = correct_positions(bodies, depth, normal, floats(penPoint, 3))
    impulse, friction = apply_contact_impulses(bodies, arms, normal, settings)
    m1.set_body_state(body1)
    m2.set_body_state(body2)
    return ContactImpulses(impulse, friction, arms[0])


# From here on, vectors are components: tuples of floats for one contact, arrays (3, m) for many.
# The two bodies of a contact are a pair of `BodyState`, with a pair of arms; or one, whose arrays
# have both bodies along the last axis but one, as the arms then: (2, m), (3, 2, m), (9, 2, m). What
# is done to both bodies of many contacts then takes as few calls as for one body.

# The impulse that body 1 receives is opposite to that on body 2, and so are corrections.
_OPPOSITE = np.array([[-1.0], [1.0]])


def mass_weights(invMasses):
    """w_i = m_i⁻¹ / (m_1⁻¹ + m_2⁻¹), each body's part in a correction; not both masses infinite.

    invMasses : pair of numbers, or (2, m); so are the weights
    """
    invMass1, invMass2 = invMasses
    total = invMass1 + invMass2
    if isinstance(invMasses, np.ndarray):
        return invMasses / total
    return invMass1 / total, invMass2 / total


def separate(bodies, distance, direction):
    """Position correction: moves body 2 along the direction and body 1 against it.

    By `distance` in all, each in proportion to its inverse mass. Returns how far body 2 has moved.
    """
    if isinstance(bodies, BodyState):
        shift = _OPPOSITE * mass_weights(bodies.invMass) * distance
        bodies.position = mul_add(bodies.position, shift, direction[:, None])
        return shift[1]
    body1, body2 = bodies
    weight1, weight2 = mass_weights((body1.invMass, body2.invMass))
    body1.position = mul_add(body1.position, -(weight1 * distance), direction)
    body2.position = mul_add(body2.position, weight2 * distance, direction)
    return weight2 * distance


def correct_positions(bodies, depth, normal, penPoint):
    """Separates two bodies that touch; returns the arms from their COMs to the contact point,
    which is penPoint, moved along with body 2."""
    point = mul_add(penPoint, separate(bodies, depth, normal), normal)
    if isinstance(bodies, BodyState):
        return point[:, None] - bodies.position
    return sub(point, bodies[0].position), sub(point, bodies[1].position)


def velocity_at(body, arm):
    """Velocity of a body's point at an arm from its COM, v + ω × r."""
    return add(body.linVelocity, cross(body.angVelocity, arm))


def relative_velocity(bodies, arms):
    """Velocity of body 1 at its arm minus that of body 2 at its own."""
    if isinstance(bodies, BodyState):
        velocity = velocity_at(bodies, arms)
        return velocity[:, 0] - velocity[:, 1]
    return sub(velocity_at(bodies[0], arms[0]), velocity_at(bodies[1], arms[1]))


def response_at(body, arm, direction):
    """`(k, invInertiaRxN)`: how a body responds to a unit impulse along a direction n at an arm r.

    invInertiaRxN : I⁻¹ (r × n), the change of the angular velocity
    k : the change of the velocity of the point along n. It gains m⁻¹ from the motion of the COM
        and, from the rotation, ((I⁻¹ (r × n)) × r) · n = (r × n) · I⁻¹ (r × n)
    """
    rCrossN = cross(arm, direction)
    invInertiaRxN = mat_vec(body.invInertia, rCrossN)
    return body.invMass + dot(rCrossN, invInertiaRxN), invInertiaRxN


def inverse_effective_mass(bodies, arms, direction):
    """`(K, responses)`: how two bodies that touch respond to an impulse between them.

    K : the change of the closing speed by a unit impulse, the sum of the bodies' own
    responses : I_i⁻¹ (r_i × n) of both; see `response_at`
    """
    if isinstance(bodies, BodyState):
        k, responses = response_at(bodies, arms, direction[:, None])
        return k[0] + k[1], responses
    k1, response1 = response_at(bodies[0], arms[0], direction)
    k2, response2 = response_at(bodies[1], arms[1], direction)
    return k1 + k2, (response1, response2)


def receive_impulse(body, impulse, direction, invInertiaRxN):
    """Changes a body by an impulse j along n: v ← v + j m⁻¹ n and ω ← ω + j I⁻¹ (r × n)."""
    body.linVelocity = mul_add(body.linVelocity, impulse * body.invMass, direction)
    body.angVelocity = mul_add(body.angVelocity, impulse, invInertiaRxN)


def apply_impulse(bodies, K, responses, direction, change, limit=None):
    """Lowers the closing speed along the direction by `change`; returns the impulse that does it.

    K, responses : as of `inverse_effective_mass`; limit : of the impulse, if there is one

    The impulse j acts as -j n on body 1 and as +j n on body 2. It lowers the closing speed by j K;
    hence j = change / K, or the limit where that is less.
    """
    impulse = change / K
    if limit is not None:
        isArray = isinstance(impulse, np.ndarray)
        impulse = np.minimum(impulse, limit) if isArray else min(impulse, limit)
    if isinstance(bodies, BodyState):
        receive_impulse(bodies, impulse * _OPPOSITE, direction[:, None], responses)
    else:
        receive_impulse(bodies[0], -impulse, direction, responses[0])
        receive_impulse(bodies[1], impulse, direction, responses[1])
    return impulse


def apply_contact_impulses(bodies, arms, normal, settings, response=None):
    """The impulses of a contact: `(impulse, friction)`, what body 2 receives along and across.

    response : what `inverse_effective_mass` gives along the normal, if it is at hand

    Restitution asks that a closing speed of c become one of -e c: with u = v1 + ω1 × r1 - v2 -
    ω2 × r2 the impulse is j = (1 + e) (u · n) / K, K as of `inverse_effective_mass`.
    """
    if response is None:
        response = inverse_effective_mass(bodies, arms, normal)
    closingSpeed = dot(relative_velocity(bodies, arms), normal)
    change = (1.0 + settings.CRCoeff) * closingSpeed
    if settings.closingOnly:
        change = change * (change > 0)
    impulse = apply_impulse(bodies, *response, normal, change)
    if settings.mu == 0:
        return impulse, NO_FRICTION
    limit = settings.mu * impulse
    return impulse, apply_friction(bodies, arms, normal, limit)


def apply_friction(bodies, arms, normal, limit):
    """Coulomb friction at a contact; returns the impulse, a vector, that body 2 receives.

    limit : μ times the normal impulse; none where that is negative, as nothing is pressed there

    With u the velocity of body 1 relative to body 2 at the contact and t the unit vector of its
    part across the normal, an impulse -j t on body 1 and +j t on body 2 lowers u · t by j K, K
    being both bodies' inverse effective mass along t. The sliding stops at j = u · t / K; friction
    gives that much or its limit, whichever is less, and so never turns the sliding round. The
    kinetic energy changes by -j u · t + j² K / 2, which is at most 0 for 0 ≤ j ≤ u · t / K.
    """
    u = relative_velocity(bodies, arms)
    across = mul_add(u, -dot(u, normal), normal)
    speed = norm(across)
    if isinstance(speed, np.ndarray):
        length, limit = np.where(speed > 0.0, speed, 1.0), np.maximum(limit, 0.0)
    else:
        length, limit = speed or 1.0, max(limit, 0.0)
    limit = limit + 0.0  # a zero has no sign, whichever of two zeros is taken for the greater
    t = divide(across, length)
    response = inverse_effective_mass(bodies, arms, t)
    impulse = apply_impulse(bodies, *response, t, speed, limit)
    return scale(impulse, t)


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

    Of vectors given as tuples of three floats, the corrected positions are such tuples.
    """
    point1, point2 = floats(currConstPoints[0], 3), floats(currConstPoints[1], 3)
    position1, position2 = floats(currPositions[0], 3), floats(currPositions[1], 3)
    C, n = distance_error(point1, point2, number(refValue))
    if not is_violated(C, bool(upper), number(tolerance)):
        return True, _as_given(currPositions, (position1, position2))
    body1 = BodyState(number(invMasses[0]), None, position1, None, None)
    body2 = BodyState(number(invMasses[1]), None, position2, None, None)
    if body1.invMass + body2.invMass > 0.0:
        separate((body1, body2), C, n)
    return False, _as_given(currPositions, (body1.position, body2.position))


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

    currPositions, currConstPoints, invMasses : as for `resolve_position_constraint`. An `Anchor`
        brings its arm along; of other points it is the difference to the COM
    currLinVelocities, currAngVelocities : pairs of (1, 3)
    invInertiaTensors : pair of (3, 3), inverse inertia tensors in world axes
    tolerance : speed; valid when |J v| ≤ tolerance, with J v the rate at which ‖p1 - p2‖ grows

    J = [n, r1 × n, -n, -(r2 × n)], so that J v is the closing speed along n, and J M⁻¹ Jᵀ the
    inverse effective mass: Δv = -M⁻¹Jᵀ (J M⁻¹ Jᵀ)⁻¹ J v is a collision's impulse without
    restitution.

    Returns `(velocityWasValid, correctedLinVelocities, correctedAngVelocities)`: a bool and two
    pairs of new (1, 3) arrays, with J v = 0 unless it was valid. Bodies that both cannot move keep
    their velocities. Of vectors given as tuples of three floats, the results are such tuples.
    """
    bodies = body1, body2 = tuple(
        BodyState(
            number(invMasses[k]), floats(invInertiaTensors[k], 9), None,
            floats(currLinVelocities[k], 3), floats(currAngVelocities[k], 3),
        )
        for k in range(2)
    )  # fmt: skip
    point1, point2 = floats(currConstPoints[0], 3), floats(currConstPoints[1], 3)
    arms = tuple(
        point.arm if isinstance(point, Anchor) else sub(point, floats(position, 3))
        for point, position in zip((point1, point2), currPositions, strict=True)
    )
    _, n = distance_error(point1, point2, 0.0)
    Jv = dot(relative_velocity(bodies, arms), n)
    wasValid = abs(Jv) <= number(tolerance)
    if not wasValid and body1.invMass + body2.invMass > 0.0:
        apply_impulse(bodies, *inverse_effective_mass(bodies, arms, n), n, Jv)
    return (
        wasValid,
        _as_given(currLinVelocities, (body1.linVelocity, body2.linVelocity)),
        _as_given(currAngVelocities, (body1.angVelocity, body2.angVelocity)),
    )


def _as_given(given, pair):
    """A pair of vectors in the form that a caller has given such a pair in: tuples, or rows."""
    if isinstance(given[0], tuple) and isinstance(given[1], tuple):
        return pair
    return _row(pair[0], 3), _row(pair[1], 3)


# On components: tuples of floats for one constraint, arrays for many, as for contacts.


def is_violated(C, upper, tolerance):
    """Whether a bound is exceeded: C > tolerance for an upper one, C < -tolerance for a lower."""
    return (C > tolerance) & upper | (C < -tolerance) & (upper ^ True)


def solve_distance_constraint(bodies, arms, C, n, tolerance):
    """Corrects violated bounds by position and velocity, in place: both functions above, on arrays.

    arms : (3, 2, m), from each COM to its point; C, n : as of `distance_error`

    Moving the COMs along n leaves the arms and, as the points stay on one line, n as they are.
    """
    separate(bodies, C, n)
    Jv = dot(relative_velocity(bodies, arms), n)
    response = inverse_effective_mass(bodies, arms, n)
    apply_impulse(bodies, *response, n, Jv * (abs(Jv) > tolerance))


def project_constraints(bodies, constraints, maxIterations, tolerance, scheduling):
    """Visits the constraints until they hold or the visits are used up; returns their number.

    bodies : `Bodies` or `MeshStates`; the rest as for `run_timestep`
    """
    if len(constraints) == 0:
        return 0
    rows = ConstraintRows(constraints, bodies.isFixed, bodies.vertexCount, tolerance)
    maximumVisits = max(int(maxIterations), rows.total)
    if scheduling == "batches":
        with bodies.in_tables() as bodies:
            return _project_in_batches(bodies, rows, tolerance, maximumVisits)

    anchored = rows.anchored(bodies.arm)
    states = {b: bodies.state(b) for b in rows.bodies()}

    def visit(c):
        """Looks at constraint c, corrects it if it is violated, and returns whether it was."""
        b1, b2, arm1, arm2, refValue, upper = anchored[c]
        body1, body2 = states[b1], states[b2]
        invMasses = body1.invMass, body2.invMass
        point1, point2 = add(body1.position, arm1), add(body2.position, arm2)
        isValid, positions = resolve_position_constraint(
            (body1.position, body2.position), (point1, point2), refValue, invMasses, upper,
            tolerance,
        )  # fmt: skip
        if isValid:
            return False
        # the points stay on the line that joins them: the direction is the same afterwards
        _, linVelocities, angVelocities = resolve_velocity_constraint(
            positions, (Anchor(point1, arm1), Anchor(point2, arm2)),
            (body1.linVelocity, body2.linVelocity), (body1.angVelocity, body2.angVelocity),
            invMasses, (body1.invInertia, body2.invInertia), tolerance,
        )  # fmt: skip
        body1.position, body2.position = positions
        body1.linVelocity, body2.linVelocity = linVelocities
        body1.angVelocity, body2.angVelocity = angVelocities
        return True

    if scheduling == "queue":
        visits = queue(visit, rows.movable_bodies(bodies.isFixed), rows.total, maximumVisits)
    else:
        visits = sweep(visit, anchored, rows.total, maximumVisits)
    for b, state in states.items():
        bodies.store(b, state)
    return visits


def _project_in_batches(bodies, rows, tolerance, maximumVisits):
    """`project_constraints` for many at once. bodies : `Bodies`; rows : `ConstraintRows`"""
    ends, vertices = np.stack((rows.body1, rows.body2)), np.stack((rows.vertex1, rows.vertex2))
    allArms = take(bodies.vertices, bodies.vertexStart[ends] + vertices, axis=1)

    def visit_batch(batch):
        """Corrects what is violated of the constraints (m,); returns whether anything was."""
        b, arms = take(ends, batch, axis=1), take(allArms, batch, axis=2)
        points = take(bodies.position, b, axis=1) + arms
        C, n = distance_error(points[:, 0], points[:, 1], rows.refValue[batch])
        violated = indices(is_violated(C, rows.upper[batch], tolerance))
        if len(violated) == 0:
            return False
        b, arms, n = (take(table, violated, axis=-1) for table in (b, arms, n))
        states = bodies.states(b)
        solve_distance_constraint(states, arms, C[violated], n, tolerance)
        bodies.store(b, states)
        return True

    return batches(
        visit_batch, rows.body1, rows.body2, bodies.isFixed, rows.total, maximumVisits
    )


# --------------------------------------------------------------------------------------------------
# The accelerated step
# --------------------------------------------------------------------------------------------------


def _accelerated_step(meshes, groundMesh, timeStep, settings, project, gyroscopic=False):
    """`run_timestep` on arrays, with the same bits; see there.

    The formulas are those above. Methods that a subclass of Mesh has of its own are not called.
    """
    report = StepReport()
    if len(meshes) == 0:
        return report
    with report.phase("gather"):
        bodies = Bodies(meshes)
    with report.phase("integrate"):
        if gyroscopic:
            bodies.turn_gyroscopically(timeStep)
        linVelocity, position, orientation = free_flight(
            bodies.linVelocity, bodies.angVelocity, bodies.position, bodies.orientation, timeStep
        )
        bodies.place(position, linVelocity, np.stack(orientation))
        check_numbers(bodies.columns(), meshes, "free flight")
    with report.phase("collisions"):
        _resolve_pairs(bodies, settings, report)
    with report.phase("ground"):
        if groundMesh is not None:
            _resolve_ground(bodies, groundMesh, settings, report)
    with report.phase("constraints"):
        report.constraintVisits = project(bodies)
    with report.phase("writeBack"):
        check_numbers(bodies.columns(), meshes, "contacts and constraints")
        bodies.write_back()
    return report


def _resolve_pairs(bodies, settings, report):
    """Detects and resolves the pairs in batches, with the bits of one after the other.

    The impulses come last: within a step, no position depends on a velocity.
    """
    if len(bodies.meshes) < 2:
        return
    pairs = OrderedBatches(bodies, mass_weights)
    report.candidatePairs = len(pairs.keys)
    contacts = None
    while contacts is None and len(pairs.rank) > 0:
        for batch in pairs.detect():
            shift = separate(batch.bodies, batch.depth, batch.normal)
            pairs.store(batch, shift)
        contacts = pairs.validate()
    if contacts is not None:
        _apply_impulses(bodies, contacts, settings, report)


def _apply_impulses(bodies, contacts, settings, report):
    """The impulses batch by batch; what does not depend on velocities, for all contacts at once."""
    ends, normal = contacts.bodies, contacts.normal
    if ends.shape[1] == 0:
        return
    penPoint = contacts.points(bodies.hulls)
    arms = mul_add(penPoint, contacts.shift, normal)[:, None] - contacts.after
    states = bodies.states(ends)
    K, responses = inverse_effective_mass(states, arms, normal)
    impulses, frictions = [], []
    for some in contacts.batches():
        b = ends[:, some]
        velocity = take(bodies.velocity, b, axis=1)
        both = BodyState(
            states.invMass[:, some], states.invInertia[..., some], None, velocity[:3], velocity[3:]
        )
        impulse, friction = apply_contact_impulses(
            both, arms[..., some], normal[:, some], settings, (K[some], responses[..., some])
        )
        bodies.velocity[:, b] = np.concatenate((both.linVelocity, both.angVelocity))
        impulses.append(impulse)
        frictions.append(friction)
    friction = NO_FRICTION if settings.mu == 0 else np.concatenate(frictions, axis=1)
    columns = contacts.rank, *ends, contacts.depth, normal, penPoint
    report.add_columns(*columns, np.concatenate(impulses), friction, arms[:, 0])


def _resolve_ground(bodies, groundMesh, settings, report):
    """`resolve_collision` of every body that reaches the ground, at its lowest vertex."""
    b, point = bodies.lowest_points()
    if len(b) == 0:
        return
    # The ground is hull 2: the body moves up, against the normal, by how deep the vertex is.
    normal = np.tile([[0.0], [-1.0], [0.0]], len(b))
    body, still = bodies.states(b), groundMesh.body_state()
    ground = BodyState(*(
        np.reshape(value, (-1, 1)) for value in
        (still.invMass, still.invInertia, still.position, still.linVelocity, still.angVelocity)
    ))  # fmt: skip
    depth = -point[1]
    arms = correct_positions((body, ground), depth, normal, point)
    impulse, friction = apply_contact_impulses((body, ground), arms, normal, settings)
    bodies.store(b, body)
    rank, second = np.full(len(b), np.iinfo(np.intp).max), np.full(len(b), GROUND)  # after all
    impulse = np.ravel(impulse)  # a row, as the ground's inverse mass is
    report.add_columns(rank, b, second, depth, normal, point, impulse, friction, arms[0])
