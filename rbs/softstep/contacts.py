"""Contacts of the soft step: all manifolds at once, as constraints on velocities; and restitution.

Penetration is pushed out by springs, see rbs/softstep/springs.py. All manifolds are solved at once
from the same velocities, so that nothing depends on an order. To make that converge, a body that is
in N manifolds counts in each with a mass of m/N, and the impulses act on the whole of it: Tonge,
Benevolenski, Voroshilov: Mass Splitting for Jitter-Free Parallel Rigid Body Simulation. SIGGRAPH
2012.
"""

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from Quaternion import rotation_matrices
from rbs.geometry.arrays import indices, take
from rbs.geometry.vectors import cross, dot, mat_vec, rotate_tensor
from rbs.softstep.detection import StepContacts
from rbs.softstep.manifolds import POINTS
from rbs.softstep.springs import Spring, lasting
from rbs.stepping.bodies import GRAVITY
from rbs.stepping.reports import GROUND

# How stiff contacts are. The frequency is relative to that of the substeps, 60 Hz at 1/400 s: with
# split masses, half of it is visibly soft, and with a fifth more a tower of rings bounces on itself
# ever higher: one sweep a substep lets the impulses lag behind, and they act as an undamped spring
# of about 0.22. With critical damping, what is heavy sinks through what is light below it.
FREQUENCY, DAMPING = 0.15, 10.0
# The largest speed that penetration is pushed out with, in √(g r) of the smaller body: 3 m/s for a
# cube of a metre. Without it, bodies that start inside each other burst apart.
PUSH_SPEED = 1.0
# From substep to substep, an impulse may at most double: a blow is over with its substep, and to
# begin the next one with it throws bodies apart. Without this, Newton's cradle loses its swing.
LOAD_GROWTH = 2.0
# Where points still close this many times faster than gravity adds speed in a step, there is a
# second sweep. Without it, a light body between a heavy one and the ground is pressed into both.
HIT_STEPS = 10.0
# With fewer sweeps for restitution, what one point gives back disturbs the others: a box that falls
# flat starts to spin.
RESTITUTION_SWEEPS = 16
# The rows of ξ that have a linear part, along n, t1 and t2.
LINEAR = [0, 3, 4]
# In place of zero under a fraction.
TINY = np.finfo(float).tiny


class SoftContacts:
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
    N the number of manifolds of each body. J is sparse, and frozen within the step.
    """

    def __init__(self, manifolds, frames, motion, mu, timeStep, h):
        """Of the manifolds, those with a body that can move; h : s, of a substep."""
        self.mu, self.h, self.fallRate = mu, h, motion.fallRate
        self.fall = self.fallRate * timeStep  # the speed that gravity adds within the step
        first, second = manifolds.bodies(len(motion.shift))
        self.rows = indices(~(motion.isStill[first] & motion.isStill[second]))
        manifolds = manifolds.rows(self.rows)
        self.contacts = contacts = StepContacts(manifolds, frames)
        self.count = len(contacts.first)
        self._place_points()
        self._make_rows(motion)
        smaller = np.minimum(frames.radius[contacts.first], frames.radius[contacts.second])
        self.push = PUSH_SPEED * np.sqrt(max(self.fallRate, -GRAVITY) * smaller)
        self.impulse = manifolds.impulse * contacts.isPoint
        self.friction = manifolds.friction if mu > 0.0 else np.zeros((3, self.count))
        self.offset = manifolds.offset
        self.spring = Spring(FREQUENCY, DAMPING, h)
        ratio = self.spring.ratios(manifolds.substep)
        if (ratio != 1.0).any():
            self.offset = self.spring.converted(
                self.offset, self.impulse, self.mass, -contacts.separation, ratio
            )
            self.impulse, self.friction = self.impulse * ratio, self.friction * ratio
        self.separation = contacts.separation + self.offset
        self.started = self.impulse
        self.pending = np.zeros((6, self.count))
        self.totalImpulse = np.zeros((POINTS, self.count))
        self.totalFriction = np.zeros((3, self.count))
        self.start1 = take(frames.position, contacts.first, axis=1)

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
        """The rows of J for either body, without the sign, and what follows from A.

        K : Bᵀ A B, (4, 4, M), how the normal speeds respond to the impulses; mass : (4, M), of
        each point alone; coupling : (9, M), how friction's rows respond to the normals' wrench;
        frictionMass : (9, M), the inverse of their response to their own
        """
        contacts = self.contacts
        n, t1, t2 = contacts.normal, contacts.tangent1, contacts.tangent2
        bodies = contacts.first, contacts.second
        load = np.bincount(np.concatenate(bodies), minlength=len(motion.invMass))
        A, parts = 0.0, []
        for body, arm in zip(bodies, self.arms, strict=True):
            angular = np.stack((cross(arm, n), t1, t2, cross(arm, t1), cross(arm, t2), n), axis=1)
            products = take(motion.invInertia, body, axis=1).reshape(3, 3, 1, -1) * angular
            turning = products[:, 0] + products[:, 1] + products[:, 2]
            response = angular[0][:, None] * turning[0]
            response += angular[1][:, None] * turning[1]
            response += angular[2][:, None] * turning[2]
            response[LINEAR, LINEAR] += take(motion.invMass, body)
            A = A + take(load, body) * response
            parts.append(angular)
        self.J = self._sparse_rows(bodies, (n, t1, t2), parts, len(motion.invMass))
        self.JT = self.J.T
        B = self.B
        AB = A[:3, 0, None] * B[0] + A[:3, 1, None] * B[1] + A[:3, 2, None] * B[2]
        self.K = B[0][:, None] * AB[0] + B[1][:, None] * AB[1] + B[2][:, None] * AB[2]
        diagonal = self.K[range(POINTS), range(POINTS)]
        self.mass = B[0] / np.where(diagonal > 0.0, diagonal, 1.0)
        self.coupling = A[3:, :3].reshape(9, -1)
        c0, c1, c2 = A[3:, 3], A[3:, 4], A[3:, 5]  # symmetric
        r0, r1, r2 = cross(c1, c2), cross(c2, c0), cross(c0, c1)
        determinant = dot(c0, r0)
        self.frictionMass = np.concatenate((r0, r1, r2))
        self.frictionMass /= np.where(determinant > 0.0, determinant, 1.0)

    def _sparse_rows(self, bodies, linear, angular, count):
        """J, 6 M × 6 (n + 1), row r of manifold m at r M + m.

        linear : (3, M) each, of the rows LINEAR; angular : (3, 6, M), of either body
        """
        columns = 6 * np.stack(bodies, axis=1)[:, :, None] + np.arange(6)  # (M, 2, 6)
        values, index, length = [], [], []
        for r in range(6):
            row = [-angular[0][:, r], angular[1][:, r]]
            if r in LINEAR:
                row = [-linear[LINEAR.index(r)], row[0], linear[LINEAR.index(r)], row[1]]
            values.append(np.concatenate(row).T.ravel())
            index.append((columns if r in LINEAR else columns[:, :, 3:]).ravel())
            length.append(np.full(self.count, 12 if r in LINEAR else 6))
        start = np.concatenate(([0], *length)).cumsum()
        place = np.concatenate(index).astype(np.int32), start.astype(np.int32)
        return csr_array((np.concatenate(values), *place), shape=(6 * self.count, 6 * count))

    def impact_speeds(self, motion):
        """How fast (4, M) points come together when free flight has closed their gaps s: with the
        relative acceleration a along the normal, u² = u₀² - 2 a s."""
        self.measure(motion)
        contacts, speed = self.contacts, self.speed
        gravity = motion.gravity[contacts.second] - motion.gravity[contacts.first]
        gain = -2.0 * dot(contacts.normal, gravity.T) * np.maximum(self.separation, 0.0)
        return -np.sqrt(np.maximum(speed * speed + gain, 0.0)) * (speed < 0.0)

    def measure(self, motion):
        """Works out the twists ξ, (6, M), and the speeds along the normals u = Bᵀ ξ, (4, M), which
        are positive where the bodies part."""
        self.apply(motion)
        self.twist = (self.J @ motion.velocity.ravel()).reshape(6, -1)
        self.speed = self.twist[0] + self.B[1] * self.twist[1] + self.B[2] * self.twist[2]

    def apply(self, motion):
        """Gives the bodies the wrenches that have come together since the last time."""
        motion.push((self.JT @ self.pending.ravel()).reshape(-1, 6))
        self.pending = np.zeros((6, self.count))

    def warm_start(self):
        """Begins with the impulses of the substep before, as far as they are a load."""
        limit = np.maximum(LOAD_GROWTH * self.started, self.mass * (self.fallRate * self.h))
        started = np.minimum(self.impulse, limit)
        if self.mu > 0.0:
            total = np.maximum(self.impulse.sum(axis=0), TINY)
            self.friction = self.friction * (started.sum(axis=0) / total)
        self.impulse = self.started = started
        self.pending += np.concatenate(((self.B * self.impulse).sum(axis=1), self.friction))

    def move(self):
        """The points come as far apart as the bodies have moved in a substep."""
        self.separation += self.h * self.speed

    def soft_sweep(self):
        """One pass over all contacts in which penetration pushes out.

        A gap may close within the substep, and no more.
        """
        isApart = self.separation > 0.0
        push = np.maximum(self.spring.rate * self.separation, -self.push)
        self._solve(
            np.where(isApart, self.separation / self.h, push),
            np.where(isApart, 1.0, self.spring.softness),
        )

    def are_hit(self):
        """Whether points are about to meet at such a speed that one sweep is not enough."""
        gap = np.maximum(self.separation, 0.0)
        isHit = self.speed + gap / self.h < -HIT_STEPS * self.fall
        return (isHit & self.contacts.isPoint).any()

    def relaxing_sweep(self):
        """One pass over all contacts that takes the speed of pushing out away again."""
        self._solve(np.maximum(self.separation, 0.0) / self.h)
        self.totalImpulse += self.impulse
        self.totalFriction += self.friction

    def _solve(self, bias, softness=1.0):
        """Solves all manifolds for impulses, of the motion that has been measured, and notes what
        they have changed by: λ ← s (λ - m (u + bias)), λ ≥ 0.

        The points of a manifold come one after the other, as in Gauss and Seidel's method, and
        friction follows. Where their order alternates, high stacks sway.
        """
        before = self.impulse
        impulse, mass = before * softness, self.mass * softness
        speed = self.speed + bias
        for k in range(POINTS):
            impulse[k] = np.maximum(impulse[k] - mass[k] * speed[k], 0.0)
            speed[k + 1 :] += self.K[k, k + 1 :] * (impulse[k] - before[k])
        wrench = (self.B * (impulse - before)).sum(axis=1)
        friction = self.friction
        if self.mu > 0.0:
            slip = self.twist[3:] + mat_vec(self.coupling, wrench)
            friction = friction - mat_vec(self.frictionMass, slip)
            # Coulomb's law: at most μ Σ λ, and a twist of at most μ Σ λ times the lever
            limit, twistLimit = (self.limits * impulse).sum(axis=1)
            size = np.sqrt(friction[0] * friction[0] + friction[1] * friction[1])
            friction[:2] *= limit / np.maximum(np.maximum(size, limit), TINY)
            friction[2] = np.clip(friction[2], -twistLimit, twistLimit)
        self.pending += np.concatenate((wrench, friction - self.friction))
        self.impulse, self.friction = impulse, friction

    def restitute(self, motion, CRCoeff, closing, bodies, links):
        """Where bodies came together faster than by what gravity adds in a step, which belongs to
        resting, and have touched, they part with e times that speed, as far as energy allows.

        closing : (4, M), of `impact_speeds`; links : (2, R), bodies that constraints hold together
        """
        bounces = (closing < -self.fall) & (self.totalImpulse > 0.0)
        if not bounces.any():
            return
        bias = np.where(bounces, CRCoeff * closing, np.maximum(self.separation, 0.0) / self.h)
        self.apply(motion)
        before, velocity = (self.impulse, self.friction), motion.velocity[:-1].copy()
        for _ in range(RESTITUTION_SWEEPS):
            self.measure(motion)
            self._solve(bias)
        self.apply(motion)
        first, second = self.contacts.first, self.contacts.second
        links = np.concatenate(((first, second), links), axis=1)
        share = energy_share(bodies, motion, velocity, links)
        motion.velocity[:-1] += (share - 1.0)[:, None] * (motion.velocity[:-1] - velocity)
        share = take(share, np.where(motion.isStill[first], second, first))
        self.totalImpulse += share * (self.impulse - before[0])
        self.totalFriction += share * (self.friction - before[1])

    def store(self, manifolds):
        """The manifolds with what they start the next step with."""
        names = ("impulse", "friction", "offset", "substep")
        columns = {name: getattr(manifolds, name).copy() for name in names}
        if self.offset.any():
            self.offset = lasting(self.offset, self.offset - self.separation)
        for name in names[:3]:
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
            first * (ground + 1) + second,
            first,
            np.where(second == ground, GROUND, second),
            np.maximum(-contacts.separation[k, m], 0.0),
            normal,
            self.start1[:, m] + arm,
            impulse[k, m],
            friction,
            arm,
        )


# --------------------------------------------------------------------------------------------------
# The energy of restitution
# --------------------------------------------------------------------------------------------------


def energy_share(bodies, motion, before, links):
    """The part (n,) of what restitution changes in velocities that the energy allows.

    bodies : `Bodies`, at the start of the step; motion : `Motion`, with restitution
    before : (n, 6), velocities without; links : (2, L), bodies that touch or are held together

    Newton's law of restitution lets two points part with e times the speed that they met with.
    Where several pairs meet in one step, this can ask for more energy than there was: Stronge:
    Rigid body collisions with friction. Proceedings of the Royal Society A, 1990. So an island, of
    bodies that hang together, keeps the largest share with which its energy is no higher than at
    the start of the step. As that is the same for all of the island, momentum is kept.
    """
    isStill = motion.isStill[:-1]
    mass = np.where(isStill, 0.0, 1.0 / np.where(isStill, 1.0, bodies.invMass))

    def tensors(invInertia):
        matrices = np.where(isStill, np.eye(3).reshape(9, 1), invInertia).T.reshape(-1, 3, 3)
        return np.where(isStill[:, None, None], 0.0, np.linalg.inv(matrices))

    def products(inertia, v, w):
        """vᵀ M w (n,) of velocities (n, 6)."""
        turning = (inertia @ w[:, 3:, None])[:, :, 0]
        return mass * (v[:, :3] * w[:, :3]).sum(axis=1) + (v[:, 3:] * turning).sum(axis=1)

    start = bodies.velocity.T
    limit = 0.5 * products(tensors(bodies.invInertia), start, start)
    limit += mass * dot(np.reshape(bodies.gravity, (3, 1)), motion.shift.T)
    rotation = np.stack(rotation_matrices(motion.result(bodies)[1]))
    inertia = tensors(np.stack(rotate_tensor(rotation, bodies.restInvInertia)))
    # the energy is that before plus b s + a s²
    change = motion.velocity[:-1] - before
    island = islands(links, ~isStill)
    a = np.bincount(island, 0.5 * products(inertia, change, change))
    b = np.bincount(island, products(inertia, before, change))
    left = np.bincount(island, limit - 0.5 * products(inertia, before, before))
    root = np.sqrt(np.maximum(b * b + 4.0 * a * left, 0.0))
    share = np.where(a + b > left, (root - b) / np.where(a > 0.0, 2.0 * a, 1.0), 1.0)
    return np.clip(share, 0.0, 1.0)[island]


def islands(links, isFree):
    """The island (n,) of each body, a number from 0: of those that hang together.

    links : (2, L), bodies that do; n or -1 is the ground
    isFree : (n,) bool; what is not free, and the ground, connects nothing
    """
    count = len(isFree)
    first, second = links[:, np.append(isFree, False)[links].all(axis=0)]
    graph = csr_array((np.ones(len(first)), (first, second)), shape=(count, count))
    return connected_components(graph, directed=False)[1]
