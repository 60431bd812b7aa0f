"""The soft-step contact solver: piles that rest.

A step is cut into substeps of length h, and each makes one pass over all contacts: Macklin et al.:
Small Steps in Physics Simulation. SCA 2019. Contacts are springs and dampers that are integrated
implicitly, which takes the form of an impulse with a mass and a memory that are scaled down: Catto:
Soft Constraints. Game Developers Conference 2011; Solver2D and Box2D v3 call it soft step. Within a
substep: gravity; the impulses of the substep before, as a start; one sweep in which penetration
pushes out; the move; one relaxing sweep without the push, which takes its speed out again.
Restitution comes after the last substep.

All manifolds are solved at once from the same velocities, so that nothing depends on an order. To
make that converge, a body that is in N manifolds counts in each with a mass of m/N, and the
impulses act on the whole of it: Tonge, Benevolenski, Voroshilov: Mass Splitting for Jitter-Free
Parallel Rigid Body Simulation. SIGGRAPH 2012.

Nothing here has a unit of its own: times are counted in substeps, speeds in √(g r).
"""

import math

import numpy as np
from scipy.sparse import csc_array, csr_array

from rbs.arrays import indices, take
from rbs.bodies import Bodies, check_numbers
from rbs.contactdetection import StepContacts, detect
from rbs.flight import GRAVITY, turned
from rbs.manifolds import ANGLE_OF_CHORD, POINTS
from rbs.reports import GROUND, StepReport
from rbs.sleeping import Sleep, lost_links, speeds
from rbs.softconstraints import SoftConstraints
from rbs.solverstate import CONTACT_SOLVERS as CONTACT_SOLVERS  # of this room, for its users
from rbs.solverstate import SolverState
from rbs.vectors import cross, dot, mat_vec, norm

# How stiff contacts are. The frequency is relative to that of the substeps, 60 Hz at 1/400 s: with
# split masses, half of it is visibly soft, and with a fifth more a tower of rings bounces on itself
# ever higher. A damping ratio far above 1 pushes out slowly.
FREQUENCY = 0.15
DAMPING = 10.0
# The largest speed that penetration is pushed out with, in √(g r) of the smaller body: 3 m/s for a
# cube of a metre. More of it lets bodies that start inside each other burst apart.
PUSH_SPEED = 1.0
# A load doubles from substep to substep at most: a weight that is put on a tower is carried after
# some of them.
LOAD_GROWTH = 2.0
# Restitution: closing speeds up to this many times what gravity adds in a step belong to resting.
REST_STEPS = 2.0
# With one sweep for restitution, what one contact gives back disturbs the others, and with one pass
# over the points of a manifold, a box that falls flat starts to spin.
RESTITUTION_SWEEPS = 8
RESTITUTION_PASSES = 4


def soft_step(
    meshes, hasGround, timeStep, CRCoeff, mu, constraints, substeps, sleeping, isGyroscopic, state
):
    """`run_timestep` with the soft-step solver; see there. Returns a `StepReport`.

    state : `SolverState` or None; it changes at the end, when nothing can go wrong any more
    """
    report = StepReport()
    if len(meshes) == 0 or timeStep == 0.0:
        return report
    kept = SolverState() if state is None else state
    with report.phase("gather"):
        bodies = Bodies(meshes)
        bodies.follow_orientations()
        kept.start(bodies)
        radius = bodies.hulls.radius
        isDisturbed = kept.sleep.disturbed(bodies)
        path = kept.pairs.path + np.where(isDisturbed, _way_since(kept.sleep, bodies), 0.0)
        if isGyroscopic:
            bodies.turn_gyroscopically(timeStep)
        check_numbers(bodies.columns(), meshes, "the last step")
    with report.phase("collisions"):
        speed = speeds(bodies.velocity, radius)
        isAsleep = kept.sleep.isAsleep & ~bodies.isFixed & ~isDisturbed
        fall = abs(GRAVITY) * timeStep
        reach = np.where(bodies.isFixed & (speed == 0.0) | isAsleep, 0.0, (speed + fall) * timeStep)
        pairs, manifolds, frames = detect(bodies, hasGround, reach, path, kept)
        joints = SoftConstraints(constraints, bodies, kept)
        report.candidatePairs = len(pairs.key)
        if sleeping:
            isAsleep = _still_asleep(manifolds, joints, kept, bodies, isDisturbed, speed)
        else:
            isAsleep = np.zeros(len(meshes), dtype=bool)
        isStill = np.append(isAsleep | bodies.isFixed, True)  # the ground too
        first, second = _pairs_of(manifolds, len(isStill))
        rows = indices(~(isStill[first] & isStill[second]))
        active = manifolds.rows(rows)
        contacts = StepContacts(active, frames)
    with report.phase("constraints"):
        motion = _Motion(bodies, isStill)
        h = timeStep / substeps
        solver = _ContactSolver(contacts, active, motion, radius, mu, h)
        joints.begin(motion, isStill, frames, h)
        for _ in range(substeps):
            motion.velocity[:, 1] += motion.gravity * h
            solver.warm_start()
            if joints.count:
                solver.apply(motion)
                joints.warm_start(motion)
                joints.sweep(motion, isSoft=True)
            solver.soft_sweep(motion)
            solver.apply(motion)
            motion.move(h)
            solver.move(motion, joints.count > 0)
            joints.sweep(motion, isSoft=False)
            solver.relaxing_sweep(motion)
            solver.sum_impulses()
        manifolds = _with_impulses(manifolds, rows, solver)
        if CRCoeff != 0.0:
            solver.restitute(motion, CRCoeff, REST_STEPS * fall)
        solver.apply(motion)
        report.constraintVisits = joints.visits
    with report.phase("writeBack"):
        bodies.motion, bodies.orientation = motion.result(bodies, isStill[:-1])
        check_numbers(bodies.columns(), meshes, "contacts and constraints")
        timer = np.zeros(len(meshes))
        if sleeping:
            isPressed = (manifolds.impulse > 0.0).any(axis=0)
            links = _pairs_of(manifolds, len(isStill))[:, isPressed]
            links = np.concatenate((links, joints.links()), axis=1)
            speed = speeds(bodies.velocity, radius)
            isAsleep, timer = kept.sleep.settled(
                isAsleep, bodies.isFixed, links, speed, radius, GRAVITY, timeStep
            )
            bodies.motion[3:9] = np.where(isAsleep, 0.0, bodies.motion[3:9])
        bodies.write_back()
        way = norm(motion.shift.T) + norm(motion.turn.T) * radius
        pairs.path = path + np.where(isStill[:-1], 0.0, way)
        kept.pairs, kept.manifolds = pairs, manifolds
        kept.sleep = Sleep(
            isAsleep=isAsleep, timer=timer, position=bodies.position.copy(),
            orientation=bodies.orientation.copy(), velocity=bodies.velocity.copy(),
        )  # fmt: skip
        joints.store(kept)
        report.isAsleep = isAsleep
        _report_contacts(report, contacts, solver, len(isStill))
    return report


def _pairs_of(manifolds, count):
    """The bodies (2, M) of manifolds; count : of bodies, and the ground."""
    return np.stack(np.divmod(manifolds.key, count))


def _still_asleep(manifolds, joints, kept, bodies, isDisturbed, speed):
    """Which bodies (n,) sleep through this step; see rbs/sleeping.py."""
    count = len(speed) + 1
    links = np.concatenate((_pairs_of(manifolds, count), joints.links()), axis=1)
    lost = lost_links(manifolds.key, kept.manifolds.key, count)
    radius = bodies.hulls.radius
    isAsleep = kept.sleep.woken(isDisturbed, links, lost, speed, radius, GRAVITY)
    return isAsleep & ~bodies.isFixed


def _with_impulses(manifolds, rows, solver):
    """The manifolds with the impulses of the last substep, of the `rows` that were solved."""
    impulse, friction = manifolds.impulse.copy(), manifolds.friction.copy()
    impulse[:, rows], friction[:, rows] = solver.impulse, solver.friction
    return manifolds.renewed(impulse=impulse, friction=friction)


def _way_since(sleep, bodies):
    """How far (n,) points of the bodies are at most from where the last step has left them."""
    cosine = np.zeros(len(bodies.invMass))
    for k in range(4):
        cosine += sleep.orientation[k] * bodies.orientation[k]
    chord = np.sqrt(np.maximum(2.0 - 2.0 * np.abs(cosine), 0.0))
    way = norm(bodies.position - sleep.position)
    return way + ANGLE_OF_CHORD * chord * bodies.hulls.radius


def _report_contacts(report, contacts, solver, count):
    """Notes every point that has given an impulse or touches, at the start of the step.

    A manifold's friction is shared out by the normal impulses of its points.
    """
    impulse = solver.totalImpulse
    k, m = np.nonzero((impulse > 0.0) | (contacts.isPoint & (contacts.separation <= 0.0)))
    first, second, normal = contacts.first[m], contacts.second[m], contacts.normal[:, m]
    total = impulse.sum(axis=0)[m]
    share = impulse[k, m] / np.where(total > 0.0, total, 1.0)
    along, across = solver.totalFriction[0][m] * share, solver.totalFriction[1][m] * share
    friction = contacts.tangent1[:, m] * along + contacts.tangent2[:, m] * across
    arm = contacts.arm[:, k, m]
    point = solver.start1[:, m] + arm
    report.add_columns(
        first * count + second, first, np.where(second == count - 1, GROUND, second),
        np.maximum(-contacts.separation[k, m], 0.0), normal, point, impulse[k, m], friction, arm,
    )  # fmt: skip


class _Motion:
    """The velocities of the n bodies and of the ground, and how far they have come in the step.

    velocity : (n + 1, 6), linear and angular; shift, turn : (n, 3), sums of v h and of ω h: the
        orientation is exp(turn/2) ∘ q
    invMass : (n + 1,), invInertia : (9, n + 1), 0 for what stands still; gravity : (n + 1,)
    """

    def __init__(self, bodies, isStill):
        count = len(isStill)
        self.velocity = np.zeros((count, 6))
        self.velocity[:-1] = bodies.velocity.T
        self.invMass = np.where(isStill, 0.0, np.append(bodies.invMass, 0.0))
        self.invInertia = np.zeros((9, count))
        self.invInertia[:, :-1] = np.where(isStill[:-1], 0.0, bodies.invInertia)
        self.gravity = np.where(isStill, 0.0, GRAVITY)
        self.shift, self.turn = np.zeros((count - 1, 3)), np.zeros((count - 1, 3))
        self.start = bodies.position

    def move(self, h):
        self.shift += h * self.velocity[:-1, :3]
        self.turn += h * self.velocity[:-1, 3:]

    def result(self, bodies, isStill):
        """`(motion (9, n), orientation (4, n))` at the end of the step; see `Bodies`."""
        orientation = np.stack(turned(bodies.orientation, np.ascontiguousarray(self.turn.T)))
        moved = np.concatenate((bodies.position + self.shift.T, self.velocity[:-1].T))
        return (
            np.where(isStill, bodies.motion, moved),
            np.where(isStill, bodies.orientation, orientation),
        )


def _products(a, b):
    """aᵀ b of matrices (3, 3, M)."""
    products = a[0][:, None] * b[0]
    products += a[1][:, None] * b[1]
    products += a[2][:, None] * b[2]
    return products


class _ContactSolver:
    """The contacts of a step as constraints on velocities, M manifolds at once.

    The relative motion of the two bodies of a manifold, in its frame n, t1, t2 about the middle of
    its points, is a twist ξ of six numbers: Δv along n, t1, t2 and Δω about n, t1, t2. With the
    arms r_i from the COMs to the middle and e one of the three axes,

        Δv · e = e · v2 + (r2 × e) · ω2 - e · v1 - (r1 × e) · ω1,        Δω · e = e · ω2 - e · ω1,

    the rows of the Jacobian: ξ = J v. A wrench w in the same frame changes the velocities by
    M⁻¹ Jᵀ w. The points stand x along t1 and y along t2 from the middle; there, the normal speed is
    u_k = ξ_0 + y_k ξ_4 - x_k ξ_5, and impulses λ_k along n make the wrench with
    w_0 = Σ λ, w_4 = Σ y λ, w_5 = -Σ x λ. Friction acts in the middle, along t1 and t2, with a twist
    about n: w_1, w_2, w_3.

    With masses split, the twist of a manifold responds to its own wrench by A = J N M⁻¹ Jᵀ, 6 × 6,
    N the number of manifolds of each body. J and M⁻¹ Jᵀ are sparse, and frozen within the step.
    """

    # What of the twist the normals see, and what friction does.
    NORMALS, FRICTIONS = [0, 4, 5], [1, 2, 3]

    def __init__(self, contacts, manifolds, motion, radius, mu, h):
        self.mu, self.h = mu, h
        first, second = contacts.first, contacts.second
        self.count = len(first)
        isPoint = contacts.isPoint
        weight = isPoint / np.maximum(isPoint.sum(axis=0), 1)
        middle = sum(weight[k] * contacts.arm[:, k] for k in range(POINTS))
        # the points of the two bodies are `separation` apart: the middle is between them
        gap = sum(weight[k] * contacts.separation[k] for k in range(POINTS))
        axes = contacts.normal, contacts.tangent1, contacts.tangent2
        away = contacts.arm - middle[:, None]
        self.x, self.y = (dot(away, axis[:, None]) * isPoint for axis in axes[1:])
        self.lever = np.sqrt(self.x * self.x + self.y * self.y)
        middle = middle + 0.5 * gap * contacts.normal
        arms = middle, middle - contacts.t
        self.separation = contacts.separation.copy()
        self.start1 = take(motion.start, first, axis=1)

        # rows e of J for either body, without the sign, and M⁻¹ times them
        load = np.bincount(np.concatenate((first, second)), minlength=len(motion.invMass))
        normals = frictions = coupling = 0.0
        blocks = []
        for body, arm in zip((first, second), arms, strict=True):
            angular = np.stack([cross(arm, e) for e in axes] + list(axes), axis=1)  # (3, 6, M)
            invInertia = take(motion.invInertia, body, axis=1).reshape(3, 3, 1, -1)
            products = invInertia * angular
            turning = products[:, 0] + products[:, 1] + products[:, 2]
            invMass, split = take(motion.invMass, body), take(load, body)
            leverN, leverT = angular[:, self.NORMALS], angular[:, self.FRICTIONS]
            turningN, turningT = turning[:, self.NORMALS], turning[:, self.FRICTIONS]
            normal, friction = _products(leverN, turningN), _products(leverT, turningT)
            for block, k in ((normal, 0), (friction, 0), (friction, 1)):
                block[k, k] += invMass
            normals = normals + split * normal
            frictions = frictions + split * friction
            coupling = coupling + split * _products(leverT, turningN)
            linear = np.stack(axes, axis=1)  # (3, 3, M)
            blocks.append((linear, angular, invMass * linear, turning))
        self.coupling = coupling.reshape(9, -1)
        self.twist = self.pending = None
        self._make_sparse(first, second, blocks, len(motion.invMass))
        self._make_normal_rows(normals, isPoint)
        self._make_friction_rows(frictions)
        self._soften(radius, first, second)
        self._renew()
        self.impulse = manifolds.impulse * isPoint
        self.friction = manifolds.friction.copy() if mu > 0.0 else np.zeros((3, self.count))
        self.started, self.weight = self.impulse, self.mass * (abs(GRAVITY) * h)
        self.closing = self._impact_speeds(motion, first, second, contacts.normal[1])
        self.totalImpulse = np.zeros((POINTS, self.count))
        self.totalFriction = np.zeros((3, self.count))

    def _make_sparse(self, first, second, blocks, count):
        """J, 6 M × 6 (n + 1), row r of manifold m at r M + m, and M⁻¹ Jᵀ."""
        (lin1, ang1, linR1, angR1), (lin2, ang2, linR2, angR2) = blocks
        column1, column2 = 6 * first[:, None], 6 * second[:, None]
        six, three = np.arange(6), np.arange(3, 6)
        wide = np.concatenate((column1 + six, column2 + six), axis=1).ravel()
        narrow = np.concatenate((column1 + three, column2 + three), axis=1).ravel()
        index = np.concatenate((wide, wide, wide, narrow, narrow, narrow)).astype(np.int32)
        length = np.repeat(np.array([12, 12, 12, 6, 6, 6]), self.count)
        start = np.concatenate(([0], length.cumsum())).astype(np.int32)

        def values(linear1, angular1, linear2, angular2):
            parts = []
            for r in range(6):
                row = [-angular1[:, r], angular2[:, r]]
                if r < 3:
                    row = [-linear1[:, r], row[0], linear2[:, r], row[1]]
                parts.append(np.concatenate(row).T.ravel())
            return np.concatenate(parts)

        shape = 6 * self.count, 6 * count
        self.J = csr_array((values(lin1, ang1, lin2, ang2), index, start), shape=shape)
        data = values(linR1, angR1, linR2, angR2)
        self.MJ = csc_array((data, index, start), shape=shape[::-1])

    def _make_normal_rows(self, A, isPoint):
        """K = B A Bᵀ, (4, 4, M): how the normal speeds respond to the impulses, B = (1, y, -x)."""
        B = np.stack((np.ones_like(self.x), self.y, -self.x))  # (3, 4, M)
        AB = A[:, 0, None] * B[0] + A[:, 1, None] * B[1] + A[:, 2, None] * B[2]
        self.K = B[0][:, None] * AB[0] + B[1][:, None] * AB[1] + B[2][:, None] * AB[2]
        diagonal = np.stack([self.K[k, k] for k in range(POINTS)])
        self.mass = isPoint / np.where(diagonal > 0.0, diagonal, 1.0)

    def _make_friction_rows(self, A):
        """The inverse of the response of friction's three rows, which is symmetric."""
        c0, c1, c2 = A[:, 0], A[:, 1], A[:, 2]
        r0, r1, r2 = cross(c1, c2), cross(c2, c0), cross(c0, c1)
        determinant = dot(c0, r0)
        safe = np.where(determinant > 0.0, determinant, 1.0)
        self.frictionMass = np.concatenate((r0, r1, r2)) / safe

    def _soften(self, radius, first, second):
        """Catto's soft constraint: with the angular frequency ω and the damping ratio ζ, a spring
        and damper that are integrated implicitly over h are an impulse

            j = -m a₂/(1 + a₂) (u + ω/a₁ C) - λ/(1 + a₂),   a₁ = 2 ζ + h ω,  a₂ = h ω a₁.
        """
        angle = 2.0 * math.pi * FREQUENCY  # h ω
        a1 = 2.0 * DAMPING + angle
        a2 = angle * a1
        self.biasRate = angle / (self.h * a1)
        self.massScale, self.impulseScale = a2 / (1.0 + a2), 1.0 / (1.0 + a2)
        isBody = second < len(radius)
        smaller = np.minimum(radius[first], radius[np.where(isBody, second, first)])
        self.push = PUSH_SPEED * np.sqrt(abs(GRAVITY) * smaller)

    def _impact_speeds(self, motion, first, second, normalY):
        """How fast (4, M) points come together when free flight has closed their gaps s: with the
        relative acceleration a along the normal, u² = u₀² - 2 a s."""
        speed = self.normal_speeds(self.twists(motion))
        gravity = normalY * (motion.gravity[second] - motion.gravity[first])
        gain = -2.0 * gravity * np.maximum(self.separation, 0.0)
        return -np.sqrt(np.maximum(speed * speed + gain, 0.0)) * (speed < 0.0)

    def twists(self, motion):
        """ξ, (6, M)."""
        self.apply(motion)
        return (self.J @ motion.velocity.ravel()).reshape(6, -1)

    def normal_speeds(self, twist):
        """u, (4, M): positive where the bodies part."""
        return twist[0] + self.y * twist[4] - self.x * twist[5]

    def warm_start(self):
        """Begins with the impulses of the substep before, as far as they are a load.

        A blow is over with its substep. To begin with it again would throw bodies apart that share
        their mass with other contacts, since a sweep takes only a part of it back. So an impulse
        grows by LOAD_GROWTH from one start to the next, or to what holds the bodies' own weight.
        """
        limit = np.maximum(LOAD_GROWTH * self.started, self.weight)
        started = np.minimum(self.impulse, limit)
        if self.mu > 0.0:
            total = self.impulse.sum(axis=0)
            self.friction = self.friction * (
                started.sum(axis=0) / np.where(total > 0.0, total, 1.0)
            )
        self.impulse = self.started = started
        self._add(self._wrench(started, self.friction))

    def _wrench(self, impulse, friction):
        """w, (6, M), of impulses along n and of friction."""
        wrench = np.empty((6, self.count))
        wrench[0] = impulse.sum(axis=0)
        wrench[1:4] = friction
        wrench[4] = (self.y * impulse).sum(axis=0)
        wrench[5] = -(self.x * impulse).sum(axis=0)
        return wrench

    def apply(self, motion):
        """Gives the bodies the impulses that have come together since the last time."""
        if self.pending is not None:
            motion.velocity += (self.MJ @ self.pending.ravel()).reshape(-1, 6)
            self.pending = None

    def _add(self, wrench):
        self.pending = wrench if self.pending is None else self.pending + wrench

    def move(self, motion, hasTies):
        """The points come as far apart as the bodies have moved in a substep."""
        self.twist = self.twists(motion)
        self.separation += self.h * self.normal_speeds(self.twist)
        if hasTies:
            self.twist = None
        self._renew()

    def _renew(self):
        """What depends on the separations: `gapSpeed`, and bias, masses and memory when soft.

        A gap may close within a substep, and no more. What is closed pushes out.
        """
        isApart = self.separation > 0.0
        self.gapSpeed = np.maximum(self.separation, 0.0) / self.h
        push = np.minimum(np.maximum(self.biasRate * self.separation, -self.push), 0.0)
        scale = np.where(isApart, 1.0, self.massScale)
        memory = np.where(isApart, 1.0, 1.0 - self.impulseScale)
        self.soft = self.gapSpeed + push, scale * self.mass, memory

    def soft_sweep(self, motion):
        """One pass over all contacts in which penetration pushes out."""
        twist = self.twists(motion)
        self._solve(twist, self.normal_speeds(twist), *self.soft)

    def relaxing_sweep(self, motion):
        """One pass over all contacts that takes the speed of pushing out away again."""
        # since the move, only distance constraints can have changed the velocities
        twist = self.twist if self.twist is not None else self.twists(motion)
        self._solve(twist, self.normal_speeds(twist), self.gapSpeed, self.mass, 1.0)

    def restitute(self, motion, CRCoeff, threshold):
        """Where bodies came together faster than the threshold and have touched, they part with e
        times that speed."""
        bounces = (self.closing < -threshold) & (self.totalImpulse > 0.0)
        if not bounces.any():
            return
        bias = np.where(bounces, CRCoeff * self.closing, np.maximum(self.separation, 0.0) / self.h)
        before = self.impulse.copy(), self.friction.copy()
        for _ in range(RESTITUTION_SWEEPS):
            twist = self.twists(motion)
            speed = self.normal_speeds(twist)
            self._solve(twist, speed, bias, self.mass, 1.0, RESTITUTION_PASSES)
        self.totalImpulse += self.impulse - before[0]
        self.totalFriction += self.friction - before[1]

    def _solve(self, twist, speed, bias, mass, memory, passes=1):
        """Solves all manifolds for impulses, and applies what they have changed by.

        twist : (6, M), and speed (4, M), along the normal at the points, at present
        passes : of Gauss and Seidel's method over the normals of a manifold, each λ ≥ 0; friction
            follows. The order is always the same: where it alternates, high stacks sway
        """
        before = self.impulse
        impulse = before * memory
        speed = speed + bias
        last = before
        for _ in range(passes):
            for k in range(POINTS):
                new = np.maximum(impulse[k] - mass[k] * speed[k], 0.0)
                left = slice(k + 1 if passes == 1 else 0, POINTS)
                speed[left] += self.K[k, left] * (new - last[k])
                impulse[k] = new
            last = impulse
        change = impulse - before
        self.impulse = impulse
        friction = self.friction
        if self.mu > 0.0:
            wrench = np.stack(
                (change.sum(axis=0), (self.y * change).sum(axis=0), -(self.x * change).sum(axis=0))
            )
            slip = twist[1:4] + mat_vec(self.coupling, wrench)
            friction = self._limited(self.friction - mat_vec(self.frictionMass, slip), impulse)
        wrench = self._wrench(change, friction - self.friction)
        self.friction = friction
        self._add(wrench)

    def _limited(self, friction, impulse):
        """Coulomb's law: friction of at most μ Σ λ, a twist of at most μ Σ λ times the lever."""
        limit = self.mu * impulse.sum(axis=0)
        size = np.sqrt(friction[0] * friction[0] + friction[1] * friction[1])
        friction[:2] *= np.minimum(limit / np.where(size > 0.0, size, 1.0), 1.0)
        limit = self.mu * (self.lever * impulse).sum(axis=0)
        friction[2] = np.minimum(np.maximum(friction[2], -limit), limit)
        return friction

    def sum_impulses(self):
        self.totalImpulse += self.impulse
        self.totalFriction += self.friction
