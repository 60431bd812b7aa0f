"""Contacts of the soft step: simultaneous velocity constraints on all manifolds, and restitution.

Springs push penetration out, see rbs/softstep/springs.py. All manifolds are solved simultaneously
from the same velocities, so that the result does not depend on an order. For convergence, the mass
of a body with N manifolds is split: it counts as m/N in each of them, while the impulses act on the
whole body (Tonge, Benevolenski, Voroshilov: Mass Splitting for Jitter-Free Parallel Rigid Body
Simulation. SIGGRAPH 2012).
"""

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from Quaternion import rotation_matrices
from rbs.geometry.arrays import indices, take
from rbs.geometry.vectors import cross, dot, rotate_tensor
from rbs.softstep.detection import StepContacts
from rbs.softstep.manifolds import POINTS
from rbs.softstep.springs import Spring, lasting
from rbs.stepping.bodies import GRAVITY
from rbs.stepping.reports import GROUND

# Natural frequency of contact springs, as a fraction of the substep frequency, and damping ratio.
# Lower frequencies are visibly soft. Higher ones make tall stacks bounce, because the impulses of
# one sweep per substep lag behind, like an undamped spring. With less damping, down to critical,
# heavy bodies sink through light ones below them.
FREQUENCY, DAMPING = 0.15, 10.0
# Largest speed at which penetration is pushed out, in √(g r) of the smaller body. With more, bodies
# that start inside each other burst apart; with less, they separate slowly.
PUSH_SPEED = 1.0
# Largest growth of an impulse from one warm start to the next, as a factor. With more, the impulse
# of an impact is repeated in the next substep and throws bodies apart; less delays a new load.
LOAD_GROWTH = 2.0
# Closing speed that calls for a second sweep, in multiples of the speed that gravity adds per step.
# With more, a light body between a heavy one and the ground is pressed into both; less costs time.
HIT_STEPS = 10.0
# Number of sweeps for restitution. With fewer, the impulses at one point disturb the others, so
# that a box that lands flat starts to spin; more cost time.
RESTITUTION_SWEEPS = 16
# Rows of ξ with a linear part: those along n, t1 and t2.
LINEAR = [0, 3, 4]
# Least divisor, in place of zero.
TINY = np.finfo(float).tiny


class SoftContacts:
    """Contacts of a step as velocity constraints, for M manifolds at once.

    The relative motion of the two bodies of a manifold is a twist ξ of six numbers, in the frame n,
    t1, t2 at the centre of its points: Δv · n, Δω · t1 and Δω · t2, on which the normal impulses
    act, and Δv · t1, Δv · t2 and Δω · n, on which friction acts. With the arms r_i from the COMs to
    the centre, and e one of the three axes,

        Δv · e = e · v2 + (r2 × e) · ω2 - e · v1 - (r1 × e) · ω1,        Δω · e = e · ω2 - e · ω1

    are the rows of the Jacobian: ξ = J v. A wrench w in the same frame changes the velocities by
    M⁻¹ Jᵀ w. The point k, at x_k along t1 and y_k along t2 from the centre, has the normal speed
    u_k = ξ_0 + y_k ξ_1 - x_k ξ_2, or u = Bᵀ ξ. Impulses λ_k along n form the wrench B λ, that is,
    w_0 = Σ λ, w_1 = Σ y λ, w_2 = -Σ x λ. Friction acts at the centre, along t1 and t2 and as a
    twist about n: w_3, w_4, w_5.

    With split masses, the twist of a manifold responds to its own wrench by A = J N M⁻¹ Jᵀ, 6 × 6,
    where N is the number of manifolds of each body.

    J = T G X is constant within the step, and is applied in its factors. X, 6 × 6 for each body,
    moves its velocity from its COM x to a common origin: v - ω × x, ω. G takes the difference
    between the two bodies, and T, 6 × 6 for each manifold, has the rows above for the arm c from
    the origin to the centre, which both bodies share.
    """

    def __init__(self, manifolds, frames, motion, mu, timeStep, h):
        """Selects the manifolds that have a movable body; h : s, length of a substep."""
        self.mu, self.h, self.fallRate = mu, h, motion.fallRate
        self.fall = self.fallRate * timeStep  # speed that gravity adds in a step
        first, second = manifolds.bodies(len(motion.isStill) - 1)
        self.rows = indices(~(motion.isStill[first] & motion.isStill[second]))
        manifolds = manifolds.rows(self.rows)
        self.contacts = contacts = StepContacts(manifolds, frames)
        self.count = len(contacts.first)
        self._place_points()
        self.ends = np.concatenate((contacts.first, contacts.second))
        self._make_response(motion)
        self._make_factors(frames, motion)
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
        """Computes the centres of the manifolds, and the positions of their points around them."""
        contacts, isPoint = self.contacts, self.contacts.isPoint
        weight = isPoint / np.maximum(isPoint.sum(axis=0), 1)
        middle = sum(weight[k] * contacts.arm[:, k] for k in range(POINTS))
        # the centre lies midway between the points of the two bodies, which are `separation` apart
        gap = sum(weight[k] * contacts.separation[k] for k in range(POINTS))
        away = contacts.arm - middle[:, None]
        x, y = (
            dot(away, axis[:, None]) * isPoint for axis in (contacts.tangent1, contacts.tangent2)
        )
        self.B = np.stack((isPoint.astype(float), y, -x))  # (3, 4, M)
        # limits of friction and of the twist about n, per unit of normal impulse
        self.limits = self.mu * np.stack((self.B[0], np.sqrt(x * x + y * y)))
        middle = middle + 0.5 * gap * contacts.normal
        self.arms = middle, middle - contacts.t

    def _make_response(self, motion):
        """Computes the response A of the manifolds, in parts.

        K : Bᵀ A B, (4, 4, M), response of the normal speeds to the impulses; mass : (4, M), of each
            point alone; coupling : (3, 3, M), response of the friction rows to the normal wrench;
            frictionMass : (3, 3, M), inverse of their response to their own wrench
        """
        contacts = self.contacts
        n, t1, t2 = contacts.normal, contacts.tangent1, contacts.tangent2
        load = np.bincount(self.ends, minlength=len(motion.invMass))
        A = 0.0
        for body, arm in zip((contacts.first, contacts.second), self.arms, strict=True):
            angular = np.stack((cross(arm, n), t1, t2, cross(arm, t1), cross(arm, t2), n))
            invInertia = take(motion.invInertia, body, axis=1).reshape(3, 3, -1)
            turning = np.einsum("ijm,rjm->rim", invInertia, angular)
            response = np.einsum("rim,sim->rsm", angular, turning)
            response[LINEAR, LINEAR] += take(motion.invMass, body)
            A = A + take(load, body) * response
        B = self.B
        AB = A[:3, 0, None] * B[0] + A[:3, 1, None] * B[1] + A[:3, 2, None] * B[2]
        self.K = B[0][:, None] * AB[0] + B[1][:, None] * AB[1] + B[2][:, None] * AB[2]
        diagonal = self.K[range(POINTS), range(POINTS)]
        self.mass = B[0] / np.where(diagonal > 0.0, diagonal, 1.0)
        self.coupling = A[3:, :3]
        c0, c1, c2 = A[3:, 3], A[3:, 4], A[3:, 5]  # symmetric
        r0, r1, r2 = cross(c1, c2), cross(c2, c0), cross(c0, c1)
        determinant = dot(c0, r0)
        self.frictionMass = np.stack((r0, r1, r2)) / np.where(determinant > 0.0, determinant, 1.0)

    def _make_factors(self, frames, motion):
        """Computes the factors of J and of M⁻¹ Jᵀ, the response of the bodies to wrenches.

        X, T : (6, 6, n + 1), (6, 6, M); GT : (n + 1, M), sparse, transpose of G
        XM : (6, 6, n + 1), M⁻¹ Xᵀ
        """
        contacts, count = self.contacts, len(motion.invMass)
        origin = frames.position[:, :-1].mean(axis=1, keepdims=True)
        position = frames.position - origin
        self.X, self.XM = np.zeros((2, 6, 6, count))
        self.X[range(6), range(6)] = 1.0
        self.X[[2, 0, 1], [4, 5, 3]], self.X[[1, 2, 0], [5, 3, 4]] = position, -position
        self.XM[range(3), range(3)] = motion.invMass
        invInertia = motion.invInertia.reshape(3, 3, -1)
        self.XM[3:] = np.einsum("ikn,jkn->ijn", invInertia, self.X[:, 3:])
        centre = take(position, contacts.first, axis=1) + self.arms[0]
        self.T = np.zeros((6, 6, self.count))
        n, t1, t2 = axes = contacts.normal, contacts.tangent1, contacts.tangent2
        for row, axis in zip(LINEAR, axes, strict=True):
            self.T[row, :3], self.T[row, 3:] = axis, cross(centre, axis)
        self.T[1, 3:], self.T[2, 3:], self.T[5, 3:] = t1, t2, n
        order = self.ends.argsort(kind="stable")
        start = self.ends[order].searchsorted(np.arange(count + 1))
        sign = np.where(order < self.count, -1.0, 1.0)
        self.GT = csr_array((sign, order % max(self.count, 1), start), shape=(count, self.count))

    def impact_speeds(self, motion):
        """Normal speeds (4, M) at which points meet after free flight has closed their gaps s.

        u² = u₀² - 2 a s, with the relative acceleration a along the normal.
        """
        self.measure(motion)
        contacts, speed = self.contacts, self.speed
        gravity = motion.gravity[:, contacts.second] - motion.gravity[:, contacts.first]
        gain = -2.0 * dot(contacts.normal, gravity) * np.maximum(self.separation, 0.0)
        return -np.sqrt(np.maximum(speed * speed + gain, 0.0)) * (speed < 0.0)

    def measure(self, motion):
        """Computes the twists ξ, (6, M), and normal speeds u = Bᵀ ξ, (4, M), > 0 if separating."""
        self.apply(motion)
        moving = times(self.X, motion.velocity)
        first, second = self.contacts.first, self.contacts.second
        relative = take(moving, second, axis=1) - take(moving, first, axis=1)
        self.twist = times(self.T, relative)
        self.speed = transposed_times(self.B, self.twist[:3])

    def apply(self, motion):
        """Applies the wrenches accumulated since the last call to the bodies."""
        wrench = transposed_times(self.T, self.pending)
        wrench = np.ascontiguousarray((self.GT @ wrench.T).T)
        motion.velocity += times(self.XM, wrench)
        self.pending = np.zeros((6, self.count))

    def warm_start(self):
        """Starts with the impulses of the last substep, limited by LOAD_GROWTH."""
        limit = np.maximum(LOAD_GROWTH * self.started, self.mass * (self.fallRate * self.h))
        started = np.minimum(self.impulse, limit)
        if self.mu > 0.0:
            total = np.maximum(self.impulse.sum(axis=0), TINY)
            self.friction = self.friction * (started.sum(axis=0) / total)
        self.impulse = self.started = started
        self.pending += np.concatenate(((self.B * self.impulse).sum(axis=1), self.friction))

    def move(self):
        """Advances the separations by one substep."""
        self.separation += self.h * self.speed

    def soft_sweep(self):
        """Makes one pass over all contacts in which springs push penetration out.

        A gap may close within the substep, but not more.
        """
        isApart = self.separation > 0.0
        push = np.maximum(self.spring.rate * self.separation, -self.push)
        self._solve(
            np.where(isApart, self.separation / self.h, push),
            np.where(isApart, 1.0, self.spring.softness),
        )

    def are_hit(self):
        """Whether any points approach so fast that one sweep is not enough."""
        gap = np.maximum(self.separation, 0.0)
        isHit = self.speed + gap / self.h < -HIT_STEPS * self.fall
        return (isHit & self.contacts.isPoint).any()

    def relaxing_sweep(self):
        """Makes one pass over all contacts that removes the velocity added by the springs."""
        self._solve(np.maximum(self.separation, 0.0) / self.h)
        self.totalImpulse += self.impulse
        self.totalFriction += self.friction

    def _solve(self, bias, softness=1.0):
        """Solves all manifolds from the measured motion: λ ← s (λ - m (u + bias)), λ ≥ 0.

        The points of a manifold are visited in order, as in the Gauss-Seidel method, and then
        friction. Alternating the order would make tall stacks sway.
        """
        before = self.impulse
        impulse, mass = before * softness, self.mass * softness
        speed, change = self.speed + bias, np.empty_like(before)
        for k in range(POINTS):
            impulse[k] = np.maximum(impulse[k] - mass[k] * speed[k], 0.0)
            change[k] = impulse[k] - before[k]
            speed[k + 1 :] += self.K[k, k + 1 :] * change[k]
        wrench = times(self.B, change)
        friction = self.friction
        if self.mu > 0.0:
            slip = self.twist[3:] + times(self.coupling, wrench)
            friction = friction - times(self.frictionMass, slip)
            # Coulomb's law: at most μ Σ λ, and a twist of at most μ Σ λ times the lever arm
            limit, twistLimit = times(self.limits, impulse)
            size = np.sqrt(friction[0] * friction[0] + friction[1] * friction[1])
            friction[:2] *= limit / np.maximum(np.maximum(size, limit), TINY)
            friction[2] = np.clip(friction[2], -twistLimit, twistLimit)
        self.pending += np.concatenate((wrench, friction - self.friction))
        self.impulse, self.friction = impulse, friction

    def restitute(self, motion, CRCoeff, closing, bodies, links):
        """Applies restitution where bodies met faster than gravity accelerates them in a step.

        Points that have touched separate with e times that speed, as far as energy allows.

        closing : (4, M), from `impact_speeds`; links : (2, R), bodies connected by constraints
        """
        bounces = (closing < -self.fall) & (self.totalImpulse > 0.0)
        if not bounces.any():
            return
        bias = np.where(bounces, CRCoeff * closing, np.maximum(self.separation, 0.0) / self.h)
        self.apply(motion)
        before, velocity = (self.impulse, self.friction), motion.velocity[:, :-1].copy()
        for _ in range(RESTITUTION_SWEEPS):
            self.measure(motion)
            self._solve(bias)
        self.apply(motion)
        first, second = self.contacts.first, self.contacts.second
        links = np.concatenate(((first, second), links), axis=1)
        share = energy_share(bodies, motion, velocity, links)
        motion.velocity[:, :-1] += (share - 1.0) * (motion.velocity[:, :-1] - velocity)
        share = take(share, np.where(motion.isStill[first], second, first))
        self.totalImpulse += share * (self.impulse - before[0])
        self.totalFriction += share * (self.friction - before[1])

    def store(self, manifolds):
        """Returns the manifolds with the values from which the next step starts."""
        names = ("impulse", "friction", "offset", "substep")
        columns = {name: getattr(manifolds, name).copy() for name in names}
        if self.offset.any():
            self.offset = lasting(self.offset, self.offset - self.separation)
        for name in names[:3]:
            columns[name][:, self.rows] = getattr(self, name)
        columns["substep"][self.rows] = self.h
        return manifolds.renewed(**columns)

    def tell(self, report):
        """Reports every point that touches or received an impulse, at the start of the step.

        A manifold's friction is divided in proportion to the normal impulses of its points.
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
    """Returns the fraction (n,) of restitution's velocity changes that energy permits.

    bodies : `Bodies`, at the start of the step; motion : `Motion`, with restitution
    before : (6, n), velocities without it; links : (2, L), bodies that touch or are tied

    Newton's law of restitution lets two points separate with e times their closing speed. If
    several pairs collide in one step, this may require more energy than there was (Stronge: Rigid
    body collisions with friction. Proceedings of the Royal Society A, 1990). Each island of
    connected bodies therefore keeps the largest fraction that does not raise its energy above that
    at the start of the step. One fraction for the whole island conserves momentum.
    """
    isStill = motion.isStill[:-1]
    mass = np.where(isStill, 0.0, 1.0 / np.where(isStill, 1.0, bodies.invMass))

    def tensors(invInertia):
        matrices = np.where(isStill, np.eye(3).reshape(9, 1), invInertia).T.reshape(-1, 3, 3)
        return np.where(isStill[:, None, None], 0.0, np.linalg.inv(matrices))

    def products(inertia, v, w):
        """Returns vᵀ M w (n,) for velocities (6, n)."""
        return mass * dot(v[:3], w[:3]) + np.einsum("in,nij,jn->n", v[3:], inertia, w[3:])

    start = bodies.velocity
    limit = 0.5 * products(tensors(bodies.invInertia), start, start)
    limit += mass * dot(np.reshape(bodies.gravity, (3, 1)), motion.shift)
    rotation = np.stack(rotation_matrices(motion.result(bodies)[1]))
    inertia = tensors(np.stack(rotate_tensor(rotation, bodies.restInvInertia)))
    # with the fraction s, the energy is that without restitution plus b s + a s²
    change = motion.velocity[:, :-1] - before
    island = islands(links, ~isStill)
    a = np.bincount(island, 0.5 * products(inertia, change, change))
    b = np.bincount(island, products(inertia, before, change))
    left = np.bincount(island, limit - 0.5 * products(inertia, before, before))
    root = np.sqrt(np.maximum(b * b + 4.0 * a * left, 0.0))
    share = np.where(a + b > left, (root - b) / np.where(a > 0.0, 2.0 * a, 1.0), 1.0)
    return np.clip(share, 0.0, 1.0)[island]


def times(matrices, vectors):
    """Matrices (r, c, m) times vectors (c, m): (r, m), without temporary arrays."""
    return np.einsum("rcm,cm->rm", matrices, vectors)


def transposed_times(matrices, vectors):
    """Transposed matrices (r, c, m) times vectors (r, m): (c, m)."""
    return np.einsum("rcm,rm->cm", matrices, vectors)


def islands(links, isFree):
    """Returns the island (n,) of each body, a number from 0: its connected component.

    links : (2, L), connected bodies; n or -1 is the ground
    isFree : (n,) bool; bodies that are not free, and the ground, connect nothing
    """
    count = len(isFree)
    first, second = links[:, np.append(isFree, False)[links].all(axis=0)]
    graph = csr_array((np.ones(len(first)), (first, second)), shape=(count, count))
    return connected_components(graph, directed=False)[1]
