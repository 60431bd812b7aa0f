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
from rbs.contactdetection import StepContacts, detect, sizes
from rbs.flight import GRAVITY, turned
from rbs.impactenergy import ImpactEnergy
from rbs.manifolds import KEEP, POINTS
from rbs.offsets import converted, lasting, ratios
from rbs.reports import GROUND, StepReport
from rbs.sleeping import Sleep, lost_links, speeds
from rbs.softconstraints import SoftConstraints
from rbs.solverstate import SolverState
from rbs.vectors import cross, dot, mat_vec

# How stiff contacts are. The frequency is relative to that of the substeps, 60 Hz at 1/400 s: with
# split masses, half of it is visibly soft, and with a fifth more a tower of rings bounces on itself
# ever higher: one sweep a substep lets the impulses lag behind, and they act as an undamped spring
# of about 0.22. A damping ratio far above 1 pushes out slowly.
FREQUENCY = 0.15
DAMPING = 10.0
# The largest speed that penetration is pushed out with, in √(g r) of the smaller body: 3 m/s for a
# cube of a metre. More of it lets bodies that start inside each other burst apart.
PUSH_SPEED = 1.0
# A load doubles from substep to substep at most: a weight that is put on a tower is carried after
# some of them. Where bodies part faster than gravity moves them in a step, it is halved, down to
# what the step has begun with: a sweep takes back too little of what a heavy body has pressed out
# of a light one, and the rest would throw them apart.
LOAD_GROWTH = 2.0
# Where points still come together this many times faster than what gravity adds in a step, there is
# a second sweep: a light body between a heavy one and the ground would be pressed into either.
HIT_STEPS = 10.0
# Restitution: closing speeds up to this many times what gravity adds in a step belong to resting.
REST_STEPS = 2.0
# With one sweep for restitution, what one contact gives back disturbs the others, and with one pass
# over the points of a manifold, a box that falls flat starts to spin.
RESTITUTION_SWEEPS = 8
RESTITUTION_PASSES = 4
# In place of zero under a fraction.
TINY = np.finfo(float).tiny


def soft_step(
    meshes, hasGround, timeStep, CRCoeff, mu, constraints, substeps, sleeping, isGyroscopic, state
):
    """`run_timestep` with the soft-step solver; see there. Returns a `StepReport`.

    state : `SolverState` or None; it changes at the end, when nothing can go wrong any more
    """
    report = StepReport()
    if len(meshes) == 0 or timeStep == 0.0:
        return report
    with report.phase("gather"):
        bodies = Bodies(meshes)
        bodies.follow_orientations()
        state = SolverState() if state is None else state
        kept = state.begun(bodies)
        isDisturbed = kept.sleep.disturbed(bodies)
        if isGyroscopic:
            bodies.turn_gyroscopically(timeStep)
        check_numbers(bodies.columns(), meshes, "the last step")
    with report.phase("collisions"):
        isStill = (kept.sleep.isAsleep | bodies.isFixed) & ~isDisturbed
        manifolds, frames = detect(bodies, hasGround, isStill, kept, timeStep)
        distances = SoftConstraints(constraints, bodies, kept)
        isAsleep = _still_asleep(sleeping, kept, bodies, isDisturbed, manifolds, distances)
    with report.phase("contactSolver"):
        motion = _Motion(bodies, isAsleep)
        fall = abs(GRAVITY) * timeStep
        contacts = _ContactSolver(manifolds, frames, motion, bodies, mu, fall, timeStep / substeps)
        distances.begin(motion, frames, timeStep / substeps)
        closing = contacts.impact_speeds(motion) if CRCoeff else None
        _make_substeps(motion, contacts, distances, substeps, timeStep / substeps)
        manifolds = contacts.store(manifolds)
        if CRCoeff:
            contacts.restitute(motion, CRCoeff, closing, bodies, distances.links())
    with report.phase("writeBack"):
        bodies.motion, bodies.orientation = motion.result(bodies)
        check_numbers(bodies.columns(), meshes, "contacts and constraints")
        kept.manifolds = manifolds
        kept.sleep = _settled(sleeping, kept, bodies, isAsleep, distances, timeStep)
        distances.store(kept)
        bodies.write_back()
        state.replace(kept)
    report.isAsleep, report.candidatePairs = kept.sleep.isAsleep, len(kept.pairKey)
    report.constraintVisits = distances.visits
    contacts.tell(report)
    return report


def _make_substeps(motion, contacts, distances, substeps, h):
    """The substeps: gravity, warm start, soft sweep, move, relaxing sweep."""
    for _ in range(substeps):
        motion.fall(h)
        contacts.warm_start()
        if distances.count:
            contacts.apply(motion)
            distances.warm_start(motion)
            distances.sweep(motion, isSoft=True)
        contacts.measure(motion)
        contacts.soft_sweep()
        contacts.measure(motion)
        if contacts.are_hit():
            contacts.soft_sweep()
            contacts.measure(motion)
        motion.move(h)
        contacts.move()
        if distances.count:
            distances.sweep(motion, isSoft=False)
            contacts.measure(motion)
        contacts.relaxing_sweep()
    contacts.apply(motion)


def _still_asleep(sleeping, kept, bodies, isDisturbed, manifolds, distances):
    """Which bodies (n,) sleep through this step; see rbs/sleeping.py."""
    if not sleeping:
        return np.zeros(len(isDisturbed), dtype=bool)
    links = np.concatenate((manifolds.bodies(kept.count), distances.links()), axis=1)
    lost = lost_links(manifolds.key, kept.manifolds.key, kept.count + 1)
    speed = speeds(bodies.velocity, bodies.hulls.radius)
    isAsleep = kept.sleep.woken(isDisturbed, links, lost, speed, bodies.hulls.radius, GRAVITY)
    return isAsleep & ~bodies.isFixed


def _settled(sleeping, kept, bodies, isAsleep, distances, timeStep):
    """The `Sleep` at the end of the step; what falls asleep stands still."""
    timer = np.zeros(len(isAsleep))
    if sleeping:
        isPressed = (kept.manifolds.impulse > 0.0).any(axis=0)
        links = kept.manifolds.bodies(kept.count)[:, isPressed]
        links = np.concatenate((links, distances.links()), axis=1)
        speed = speeds(bodies.velocity, bodies.hulls.radius)
        isAsleep, timer = kept.sleep.settled(
            isAsleep, bodies.isFixed, links, speed, bodies.hulls.radius, GRAVITY, timeStep
        )
        bodies.motion[3:9] = np.where(isAsleep, 0.0, bodies.motion[3:9])
    return Sleep(
        isAsleep=isAsleep, timer=timer, position=bodies.position.copy(),
        orientation=bodies.orientation.copy(), velocity=bodies.velocity.copy(),
    )  # fmt: skip


class _Motion:
    """The velocities of the n bodies and of the ground, and how far they have come in the step.

    velocity : (n + 1, 6), linear and angular; shift, turn : (n, 3), sums of v h and of ω h: the
        orientation is exp(turn/2) ∘ q
    isStill : (n + 1,) bool, what is fixed or asleep, and the ground; for these, invMass : (n + 1,),
        invInertia : (9, n + 1) and gravity : (n + 1,) are 0
    """

    def __init__(self, bodies, isAsleep):
        count = len(isAsleep) + 1
        isStill = self.isStill = np.append(isAsleep | bodies.isFixed, True)
        self.velocity = np.zeros((count, 6))
        self.velocity[:-1] = bodies.velocity.T
        self.invMass = np.where(isStill, 0.0, np.append(bodies.invMass, 0.0))
        self.invInertia = np.zeros((9, count))
        self.invInertia[:, :-1] = np.where(isStill[:-1], 0.0, bodies.invInertia)
        self.gravity = np.where(isStill, 0.0, GRAVITY)
        self.shift, self.turn = np.zeros((count - 1, 3)), np.zeros((count - 1, 3))
        self.start = bodies.position

    def fall(self, h):
        self.velocity[:, 1] += self.gravity * h

    def move(self, h):
        self.shift += h * self.velocity[:-1, :3]
        self.turn += h * self.velocity[:-1, 3:]

    def result(self, bodies):
        """`(motion (9, n), orientation (4, n))` at the end of the step; see `Bodies`."""
        orientation = np.stack(turned(bodies.orientation, np.ascontiguousarray(self.turn.T)))
        moved = np.concatenate((bodies.position + self.shift.T, self.velocity[:-1].T))
        isStill = self.isStill[:-1]
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
    its points, is a twist ξ of six numbers: Δv · n, Δω · t1, Δω · t2, which the normals see, and
    Δv · t1, Δv · t2, Δω · n, which friction sees. With the arms r_i from the COMs to the middle and
    e one of the three axes,

        Δv · e = e · v2 + (r2 × e) · ω2 - e · v1 - (r1 × e) · ω1,        Δω · e = e · ω2 - e · ω1,

    the rows of the Jacobian: ξ = J v. A wrench w in the same frame changes the velocities by
    M⁻¹ Jᵀ w. The points stand x along t1 and y along t2 from the middle; there, the normal speed is
    u_k = ξ_0 + y_k ξ_1 - x_k ξ_2, or u = Bᵀ ξ, and impulses λ_k along n make the wrench B λ, that
    is, w_0 = Σ λ, w_1 = Σ y λ, w_2 = -Σ x λ. Friction acts in the middle, along t1 and t2, with a
    twist about n: w_3, w_4, w_5.

    With masses split, the twist of a manifold responds to its own wrench by A = J N M⁻¹ Jᵀ, 6 × 6,
    N the number of manifolds of each body. J and M⁻¹ Jᵀ are sparse, and frozen within the step.
    """

    def __init__(self, manifolds, frames, motion, bodies, mu, fall, h):
        """Of the manifolds, those with a body that can move.

        fall : the speed that gravity adds within the step; h : s, of a substep
        """
        self.mu, self.fall, self.h = mu, fall, h
        first, second = manifolds.bodies(len(motion.shift))
        self.rows = indices(~(motion.isStill[first] & motion.isStill[second]))
        manifolds = manifolds.rows(self.rows)
        self.contacts = contacts = StepContacts(manifolds, frames)
        self.count = len(contacts.first)
        self._place_points()
        self._make_rows(motion)
        self._soften(bodies.hulls.radius)
        self.pending = None
        self.impulse = manifolds.impulse * contacts.isPoint
        self.friction = manifolds.friction.copy() if mu > 0.0 else np.zeros((3, self.count))
        self.offset = manifolds.offset
        self._convert(ratios(h, manifolds.substep), sizes(bodies, contacts.first, contacts.second))
        self.separation = contacts.separation + self.offset
        self._renew()
        self.load = self.started = self.impulse
        self.weight = self.mass * (abs(GRAVITY) * h)
        self.parts = np.zeros((POINTS, self.count), dtype=bool)
        self.totalImpulse = np.zeros((POINTS, self.count))
        self.totalFriction = np.zeros((3, self.count))
        self.start1 = take(motion.start, contacts.first, axis=1)

    def _place_points(self):
        """The middles of the manifolds, and where their points stand around them."""
        contacts, isPoint = self.contacts, self.contacts.isPoint
        weight = isPoint / np.maximum(isPoint.sum(axis=0), 1)
        middle = sum(weight[k] * contacts.arm[:, k] for k in range(POINTS))
        # the points of the two bodies are `separation` apart: the middle is between them
        gap = sum(weight[k] * contacts.separation[k] for k in range(POINTS))
        away = contacts.arm - middle[:, None]
        x, y = (
            dot(away, axis[:, None]) * isPoint for axis in (contacts.tangent1, contacts.tangent2)
        )
        self.B = np.stack((isPoint.astype(float), y, -x))  # (3, 4, M)
        # what limits friction and the twist about n, for each unit of a normal impulse
        self.limits = self.mu * np.stack((self.B[0], np.sqrt(x * x + y * y)))
        middle = middle + 0.5 * gap * contacts.normal
        self.arms = middle, middle - contacts.t

    def _make_rows(self, motion):
        """The rows of J for either body, without the sign, M⁻¹ times them, and the blocks of A."""
        contacts = self.contacts
        n, t1, t2 = contacts.normal, contacts.tangent1, contacts.tangent2
        bodies = contacts.first, contacts.second
        load = np.bincount(np.concatenate(bodies), minlength=len(motion.invMass))
        normals = frictions = coupling = 0.0
        blocks = []
        linear = np.stack((n, t1, t2), axis=1)  # (3, 3, M)
        for body, arm in zip(bodies, self.arms, strict=True):
            angular = np.stack((cross(arm, n), t1, t2, cross(arm, t1), cross(arm, t2), n), axis=1)
            invInertia = take(motion.invInertia, body, axis=1).reshape(3, 3, 1, -1)
            products = invInertia * angular
            turning = products[:, 0] + products[:, 1] + products[:, 2]
            invMass, split = take(motion.invMass, body), take(load, body)
            normal = _products(angular[:, :3], turning[:, :3])
            friction = _products(angular[:, 3:], turning[:, 3:])
            for block, k in ((normal, 0), (friction, 0), (friction, 1)):
                block[k, k] += invMass
            normals = normals + split * normal
            frictions = frictions + split * friction
            coupling = coupling + split * _products(angular[:, 3:], turning[:, :3])
            blocks.append((linear, angular, invMass * linear, turning))
        self.coupling = coupling.reshape(9, -1)
        self._make_sparse(*bodies, blocks, len(motion.invMass))
        self._make_normal_rows(normals)
        self._make_friction_rows(frictions)

    def _make_sparse(self, first, second, blocks, count):
        """J, 6 M × 6 (n + 1), row r of manifold m at r M + m, and M⁻¹ Jᵀ."""
        (lin1, ang1, linR1, angR1), (lin2, ang2, linR2, angR2) = blocks
        column1, column2 = 6 * first[:, None], 6 * second[:, None]
        six, three = np.arange(6), np.arange(3, 6)
        wide = np.concatenate((column1 + six, column2 + six), axis=1).ravel()
        narrow = np.concatenate((column1 + three, column2 + three), axis=1).ravel()
        linearRow = {0: 0, 3: 1, 4: 2}  # of the rows, those that have a linear part
        index = np.concatenate([wide if r in linearRow else narrow for r in range(6)])
        length = np.repeat([12 if r in linearRow else 6 for r in range(6)], self.count)
        start = np.concatenate(([0], length.cumsum()))
        index, start = index.astype(np.int32), start.astype(np.int32)

        def values(linear1, angular1, linear2, angular2):
            parts = []
            for r in range(6):
                row = [-angular1[:, r], angular2[:, r]]
                if r in linearRow:
                    k = linearRow[r]
                    row = [-linear1[:, k], row[0], linear2[:, k], row[1]]
                parts.append(np.concatenate(row).T.ravel())
            return np.concatenate(parts)

        shape = 6 * self.count, 6 * count
        self.J = csr_array((values(lin1, ang1, lin2, ang2), index, start), shape=shape)
        data = values(linR1, angR1, linR2, angR2)
        self.MJ = csc_array((data, index, start), shape=shape[::-1])

    def _make_normal_rows(self, A):
        """K = Bᵀ A B, (4, 4, M): how the normal speeds respond to the impulses."""
        B = self.B
        AB = A[:, 0, None] * B[0] + A[:, 1, None] * B[1] + A[:, 2, None] * B[2]
        self.K = B[0][:, None] * AB[0] + B[1][:, None] * AB[1] + B[2][:, None] * AB[2]
        diagonal = np.stack([self.K[k, k] for k in range(POINTS)])
        self.mass = B[0] / np.where(diagonal > 0.0, diagonal, 1.0)

    def _make_friction_rows(self, A):
        """The inverse of the response of friction's three rows, which is symmetric."""
        c0, c1, c2 = A[:, 0], A[:, 1], A[:, 2]
        r0, r1, r2 = cross(c1, c2), cross(c2, c0), cross(c0, c1)
        determinant = dot(c0, r0)
        safe = np.where(determinant > 0.0, determinant, 1.0)
        self.frictionMass = np.concatenate((r0, r1, r2)) / safe

    def _soften(self, radius):
        """Catto's soft constraint: with the angular frequency ω and the damping ratio ζ, a spring
        and damper that are integrated implicitly over h are an impulse

            j = -m a₂/(1 + a₂) (u + ω/a₁ C) - λ/(1 + a₂),   a₁ = 2 ζ + h ω,  a₂ = h ω a₁.
        """
        angle = 2.0 * math.pi * FREQUENCY  # h ω
        a1 = 2.0 * DAMPING + angle
        a2 = angle * a1
        self.biasRate = angle / (self.h * a1)
        self.softMass, self.softMemory = a2 / (1.0 + a2) * self.mass, 1.0 - 1.0 / (1.0 + a2)
        first, second = self.contacts.first, self.contacts.second
        isBody = second < len(radius)
        smaller = np.minimum(radius[first], radius[np.where(isBody, second, first)])
        self.push = PUSH_SPEED * np.sqrt(abs(GRAVITY) * smaller)

    def _convert(self, ratio, size):
        """Brings what substeps of another length have left to that of these; see rbs/offsets.py.

        ratio : (M,), of the lengths; size : (M,), of `sizes`
        """
        if (ratio == 1.0).all():
            return
        # of substeps of that length: the spring's m ω² h, and by what it gives way at PUSH_SPEED
        stiffness = (2.0 * math.pi * FREQUENCY) ** 2 * self.mass * ratio / self.h
        most = self.push / (self.biasRate * ratio)
        give = np.minimum(self.impulse / np.where(stiffness > 0.0, stiffness, np.inf), most)
        depth = -self.contacts.separation
        self.offset = converted(self.offset, give, depth, ratio, KEEP * size)
        self.impulse, self.friction = self.impulse * ratio, self.friction * ratio

    def impact_speeds(self, motion):
        """How fast (4, M) points come together when free flight has closed their gaps s: with the
        relative acceleration a along the normal, u² = u₀² - 2 a s."""
        self.measure(motion)
        contacts, speed = self.contacts, self.speed
        gravity = motion.gravity[contacts.second] - motion.gravity[contacts.first]
        gain = -2.0 * contacts.normal[1] * gravity * np.maximum(self.separation, 0.0)
        return -np.sqrt(np.maximum(speed * speed + gain, 0.0)) * (speed < 0.0)

    def measure(self, motion):
        """Works out the twists ξ, (6, M), and the speeds along the normals u = Bᵀ ξ, (4, M), which
        are positive where the bodies part."""
        self.apply(motion)
        self.twist = (self.J @ motion.velocity.ravel()).reshape(6, -1)
        self.speed = self.twist[0] + self.B[1] * self.twist[1] + self.B[2] * self.twist[2]

    def warm_start(self):
        """Begins with the impulses of the substep before, as far as they are a load.

        A blow is over with its substep. To begin with it again would throw bodies apart that share
        their mass with other contacts, since a sweep takes only a part of it back. So an impulse
        grows by LOAD_GROWTH from one start to the next, or to what holds the bodies' own weight.
        """
        shrunk = np.maximum(self.started / LOAD_GROWTH, self.load)
        limit = np.where(self.parts, shrunk, LOAD_GROWTH * self.started)
        limit = np.maximum(limit, self.weight)
        started = np.minimum(self.impulse, limit)
        if self.mu > 0.0:
            total = np.maximum(self.impulse.sum(axis=0), TINY)
            self.friction = self.friction * (started.sum(axis=0) / total)
        self.impulse = self.started = started
        self._add((self.B * started).sum(axis=1), self.friction)

    def apply(self, motion):
        """Gives the bodies the impulses that have come together since the last time."""
        if self.pending is not None:
            motion.velocity += (self.MJ @ self.pending.ravel()).reshape(-1, 6)
            self.pending = None

    def _add(self, normals, friction):
        """Adds a wrench, three rows of either, to what `apply` gives the bodies."""
        wrench = np.concatenate((normals, friction))
        self.pending = wrench if self.pending is None else self.pending + wrench

    def move(self):
        """The points come as far apart as the bodies have moved in a substep."""
        self.separation += self.h * self.speed
        self._renew()

    def _renew(self):
        """What depends on the separations: `gapSpeed`, and bias, masses and memory when soft.

        A gap may close within a substep, and no more. What is closed pushes out.
        """
        isApart = self.separation > 0.0
        self.gapSpeed = np.maximum(self.separation, 0.0) / self.h
        push = np.maximum(self.biasRate * self.separation, -self.push)
        self.soft = (
            np.where(isApart, self.gapSpeed, push),
            np.where(isApart, self.mass, self.softMass),
            np.where(isApart, 1.0, self.softMemory),
        )

    def soft_sweep(self):
        """One pass over all contacts in which penetration pushes out."""
        self.parts = self.speed > self.fall
        self._solve(*self.soft)

    def are_hit(self):
        """Whether points are about to meet at such a speed that one sweep is not enough."""
        isHit = self.speed + self.gapSpeed < -HIT_STEPS * self.fall
        return (isHit & self.contacts.isPoint).any()

    def relaxing_sweep(self):
        """One pass over all contacts that takes the speed of pushing out away again."""
        self._solve(self.gapSpeed, self.mass, 1.0)
        self.totalImpulse += self.impulse
        self.totalFriction += self.friction

    def restitute(self, motion, CRCoeff, closing, bodies, links):
        """Where bodies came together faster than at rest and have touched, they part with e times
        that speed, as far as their energy allows.

        closing : (4, M), of `impact_speeds`; links : (2, R), bodies that constraints hold together
        """
        bounces = (closing < -REST_STEPS * self.fall) & (self.totalImpulse > 0.0)
        if not bounces.any():
            return
        bias = np.where(bounces, CRCoeff * closing, self.gapSpeed)
        self.apply(motion)
        before, velocity = (self.impulse, self.friction), motion.velocity[:-1].copy()
        for _ in range(RESTITUTION_SWEEPS):
            self.measure(motion)
            self._solve(bias, self.mass, 1.0, RESTITUTION_PASSES)
        self.apply(motion)
        first, second = self.contacts.first, self.contacts.second
        energy = ImpactEnergy(bodies, motion.isStill[:-1], motion.shift, motion.result(bodies)[1])
        links = np.concatenate(((first, second), links), axis=1)
        share = energy.share(velocity, motion.velocity[:-1], links)
        taken = (share - 1.0)[:, None] * (motion.velocity[:-1] - velocity)
        motion.velocity[:-1] += taken
        share = take(share, np.where(motion.isStill[first], second, first))
        self.totalImpulse += share * (self.impulse - before[0])
        self.totalFriction += share * (self.friction - before[1])

    def _solve(self, bias, mass, memory, passes=1):
        """Solves all manifolds for impulses, of the motion that has been measured, and notes what
        they have changed by.

        passes : of Gauss and Seidel's method over the normals of a manifold, each λ ≥ 0; friction
            follows. The order is always the same: where it alternates, high stacks sway
        """
        before = self.impulse
        impulse = before * memory
        speed = self.speed + bias
        last = before
        for _ in range(passes):
            for k in range(POINTS):
                new = np.maximum(impulse[k] - mass[k] * speed[k], 0.0)
                left = slice(k + 1 if passes == 1 else 0, POINTS)
                speed[left] += self.K[k, left] * (new - last[k])
                impulse[k] = new
            last = impulse
        wrench = (self.B * (impulse - before)).sum(axis=1)
        friction = self.friction
        if self.mu > 0.0:
            slip = self.twist[3:] + mat_vec(self.coupling, wrench)
            friction = self._limited(friction - mat_vec(self.frictionMass, slip), impulse)
        self._add(wrench, friction - self.friction)
        self.impulse, self.friction = impulse, friction

    def _limited(self, friction, impulse):
        """Coulomb's law: friction of at most μ Σ λ, a twist of at most μ Σ λ times the lever."""
        limit, twistLimit = (self.limits * impulse).sum(axis=1)
        size = np.sqrt(friction[0] * friction[0] + friction[1] * friction[1])
        friction[:2] *= limit / np.maximum(np.maximum(size, limit), TINY)
        friction[2] = np.minimum(np.maximum(friction[2], -twistLimit), twistLimit)
        return friction

    def store(self, manifolds):
        """The manifolds with what they start the next step with."""
        columns = {
            name: getattr(manifolds, name).copy()
            for name in ("impulse", "friction", "offset", "substep")
        }
        if self.offset.any():
            self.offset = lasting(self.offset, self.offset - self.separation)
        for name in ("impulse", "friction", "offset"):
            columns[name][:, self.rows] = getattr(self, name)
        columns["substep"][self.rows] = self.h
        return manifolds.renewed(**columns)

    def tell(self, report):
        """Notes every point that has given an impulse or touches, at the start of the step.

        A manifold's friction is shared out by the normal impulses of its points.
        """
        contacts, impulse = self.contacts, self.totalImpulse
        k, m = np.nonzero((impulse > 0.0) | (contacts.isPoint & (contacts.separation <= 0.0)))
        first, second, normal = contacts.first[m], contacts.second[m], contacts.normal[:, m]
        total = impulse.sum(axis=0)[m]
        share = impulse[k, m] / np.where(total > 0.0, total, 1.0)
        along, across = self.totalFriction[0][m] * share, self.totalFriction[1][m] * share
        friction = contacts.tangent1[:, m] * along + contacts.tangent2[:, m] * across
        arm = contacts.arm[:, k, m]
        ground = len(report.isAsleep)
        report.add_columns(
            first * (ground + 1) + second, first, np.where(second == ground, GROUND, second),
            np.maximum(-contacts.separation[k, m], 0.0), normal, self.start1[:, m] + arm,
            impulse[k, m], friction, arm,
        )  # fmt: skip
