"""Contacts of the soft step: velocity constraints on all manifolds, and restitution.

All manifolds are solved simultaneously from the same velocities, so that the result depends on
their order only by rounding, which a pile may amplify to 1e-5 m. For convergence, the mass of a
body is split between its manifolds, while the impulses act on the whole body (Tonge, Benevolenski,
Voroshilov: Mass Splitting for Jitter-Free Parallel Rigid Body Simulation. SIGGRAPH 2012).
Over-relaxation makes impulses travel faster through a stack.
"""

from copy import copy

import numpy as np
from scipy.sparse import csc_array

from Quaternion import rotation_matrices
from rbs.geometry import triples
from rbs.geometry.broadphase import islands
from rbs.geometry.vectors import cross, dot, indices, mat_vec, rotate_tensor, take
from rbs.softstep.detection import GROUND_AXES
from rbs.softstep.manifolds import POINTS, turn_points
from rbs.softstep.springs import Spring, lasting
from rbs.stepping.reports import GROUND
from rbs.stepping.settings import GRAVITY

# Natural frequency of contact springs, as a fraction of the substep frequency. A higher one makes
# stacks bounce, because the impulses of one sweep per substep lag behind: with 0.2, a stack of
# ten boxes never comes to rest. A lower one is visibly soft.
FREQUENCY = 0.165
# Over-relaxation ω: a body with N manifolds counts as m ω/N in each, but at most as m. With less,
# impulses travel more slowly, and the same stiffness takes a third more substeps; with 2, sweeps
# diverge, and stacks burst.
RELAXATION = 1.6
# Damping ratio of contact springs. With more, penetration is pushed out more slowly, and a tower
# takes longer to come to rest; with less, down to critical, heavy bodies sink through light ones
# below them.
DAMPING = 6.0
# Largest speed at which a spring on the ground, or on what is still, yields, in √(g r) of the body.
# With more, blows that constraints or heavier bodies pass on press a body into the ground; with
# less, a load a thousand times as heavy as the body below it never comes to rest.
YIELD = 0.1
# Largest growth of an impulse from one warm start to the next, as a factor. With more, the impulse
# of an impact is repeated in the next substep and throws bodies apart; less delays a new load.
LOAD_GROWTH = 2.0
# Closing speed that calls for a second sweep, in multiples of the speed that gravity adds per step.
# With more, a light body between a heavy one and the ground is pressed into both, and a collapsing
# heap into itself; less costs time.
HIT_STEPS = 10.0
# Most sweeps for one round of bounces. More cost time. With fewer, a box that lands flat starts to
# spin, because points disturb each other.
BOUNCE_SWEEPS = 16
# Most rounds of bounces in a step; each is of the points that the last one makes close. More cost
# time; with fewer than bodies in a row, a blow takes several steps to pass, and loses energy.
BOUNCE_ROUNDS = 10
# Least closing speed of these points, as a fraction of the largest one in the step. More delays
# blows that have lost energy on their way; less costs time in heaps.
BOUNCE_SHARE = 0.9
# Largest error of a bounce, as a fraction of the largest speed of separation.
BOUNCE_TOLERANCE = 1e-4
# Slip from which friction opposes that of each point, in multiples of the speed that gravity adds
# per step. With more, a body that spins as it slides has too much friction; less costs time.
FAST_SLIP = 1.0
# Slip speed down to which friction is at its limit where points slide, as a fraction of the speed
# that gravity adds per substep. With more, resting bodies creep; with less, rounding shows.
LEAST_SLIP = 1e-4
# ε_ijk, as a matrix of rows i k that turns x into the matrix of x ×.
LEVI_CIVITA = np.cross(np.eye(3)[:, None], np.eye(3)[None]).transpose(0, 2, 1)
# Places of 1, -y, x, x² + y² and 0 in the matrix Bᵀ B of a point, see `Sliders`, whose rows and
# columns x y z x y are repeated so that its cofactors are products of adjacent entries.
SPREAD = np.array((0, 4, 1, 0, 4, 4, 0, 2, 4, 0, 1, 2, 3, 1, 2, 0, 4, 1, 0, 4, 4, 0, 2, 4, 0))
CYCLE = np.array((0, 1, 2, 0, 1))
# Least divisor, in place of zero.
TINY = 1e-100


class PlacedManifolds:
    """Geometry of manifolds `rows` (M,) in world axes.

    first, second : (M,), bodies; the ground is body n
    t : (3, M), see `Frames.translations`; normal, tangent1, tangent2 : (3, M), unit
    arm : (3, 4, M), from the first COM to the points on the first body
    gap : (4, M), separation at the start of the step, along the normal
    """

    def __init__(self, manifolds, frames, rows):
        self.rows, self.count = rows, len(rows)
        manifolds = manifolds.rows(rows)
        self.first, self.second = manifolds.bodies(frames.count)
        self.start1 = take(frames.position, self.first, axis=1)
        self.t = frames.translations(self.first, self.second)
        self.isPoint = manifolds.isPoint
        axes = np.stack((manifolds.normal, manifolds.tangent), axis=1)
        vectors = np.concatenate((axes, manifolds.anchor1), axis=1)
        turned = turn_points(take(frames.rotation, self.first, axis=1), vectors)
        axes = np.where(self.second == frames.count, GROUND_AXES, turned[:, :2])
        self.normal, self.tangent1, self.arm = axes[:, 0], axes[:, 1], turned[:, 2:]
        self.tangent2 = cross(self.normal, self.tangent1)
        across = turn_points(take(frames.rotation, self.second, axis=1), manifolds.anchor2)
        self.gap = dot(across + self.t[:, None] - self.arm, self.normal[:, None])

    def add_to_report(self, report, total):
        """Reports every point that touches or received an impulse, at the start of the step.

        total : (7, M), impulses of the rows, see `SoftContacts`

        A manifold's friction is divided in proportion to the normal impulses of its points.
        """
        impulse, friction = total[:POINTS], total[POINTS:]
        k, m = np.nonzero((impulse > 0.0) | (self.isPoint & (self.gap <= 0.0)))
        total = np.add.reduce(impulse)
        share = friction[:2] / np.where(total > 0.0, total, 1.0)
        friction = self.tangent1 * share[0] + self.tangent2 * share[1]
        first, second, normal = self.first[m], self.second[m], self.normal[:, m]
        arm, impulse = self.arm[:, k, m], impulse[k, m]
        ground = len(report.isAsleep)
        other, depth = np.where(second == ground, GROUND, second), -self.gap[k, m]
        columns = first, other, np.maximum(depth, 0.0), normal, self.start1[:, m] + arm, impulse
        report.add_columns(first * (ground + 1) + second, *columns, friction[:, m] * impulse, arm)


class SoftContacts(PlacedManifolds):
    """Contacts of a step as velocity constraints, for M manifolds at once.

    A manifold has seven rows, each with a speed and an impulse λ: the normal speeds u of its four
    points, and the three on which friction acts, at the centre of the points: the speeds along t1
    and t2, and the spin about n. With the arms r from the two COMs to the point or centre, and its
    axis e,

        u = e · v2 + (r2 × e) · ω2 - e · v1 - (r1 × e) · ω1,        spin = n · ω2 - n · ω1

    are the rows of u = J v. Impulses λ change the velocities by M⁻¹ Jᵀ λ.

    With split masses, the rows of a manifold respond to its own impulses by A = J S M⁻¹ Jᵀ, 7 × 7,
    where S = max(N/ω, 1) for a body with N manifolds, and ω is RELAXATION.

    J = R G X is constant within the step. X, 6 × 6 for each body, moves its velocity from its COM x
    to a common origin: v - ω × x, ω. G takes the difference between the two bodies, and R, 7 × 6
    for each manifold, has the rows above for arms from the origin, which both bodies share.
    """

    def __init__(self, manifolds, frames, motion, mu, timeStep, h, ratio):
        """Selects the manifolds that have a movable body.

        h : s, length of a substep, `ratio` times that of the last step
        """
        self.h, self.timeStep = h, timeStep
        self.fall = motion.fallRate * timeStep  # speed that gravity adds in a step
        columns = take(motion.column, manifolds.bodies(frames.count))
        isMovable = (motion.invMass[columns] > 0.0).any(axis=0)
        self.others = indices(~isMovable)
        super().__init__(manifolds, frames, indices(isMovable))
        manifolds = manifolds.rows(self.rows)
        self.ends = take(columns, self.rows, axis=1)
        self._make_factors(frames, motion, mu)
        self._make_responses(motion)
        # Penetration is pushed out at up to √(g r) of the smaller body. If this were faster, bodies
        # that start inside each other would burst apart.
        radius = frames.sizes(self.first, self.second)[1]
        self.push = -np.sqrt(max(motion.fallRate, -GRAVITY) * radius)
        self.impulse = np.concatenate((manifolds.impulse * self.isPoint, manifolds.friction))
        self.offset = manifolds.offset
        self.spring = Spring(FREQUENCY, DAMPING, h)
        if ratio != 1.0:
            loads = self.impulse[:POINTS], self.mass, -self.gap
            self.offset = self.spring.converted(self.offset, *loads, ratio)
            self.impulse *= ratio
        self.separation = self.gap + self.offset
        isOnStill = self.ends.max(axis=0) == len(motion.moving)
        self.yielding = np.where(isOnStill, -YIELD * self.push, 1.0 / TINY)
        self.started = self.impulse[:POINTS]
        self.carried = np.add.reduce(self.started) * (timeStep / h)  # in a step as the last substep
        self.least = self.mass * (motion.fallRate * h)
        self.leastSlip = LEAST_SLIP * max(motion.fallRate, -GRAVITY) * h
        self.nothing, self.total, self.change = np.zeros((3, 7, self.count))
        self.pending, self.sliders = self.nothing, None

    def _make_factors(self, frames, motion, mu):
        """Computes the factors of J and M⁻¹ Jᵀ, and the limits of friction.

        X : (3, 3, m + 1), upper right part of X, the matrix of x ×
        XM : (3, 6, m + 1), lower half of M⁻¹ Xᵀ; the upper one only divides forces by masses
        R : (6, 7, M), transposed; GT : see `differences`
        limits : (2, 4, M), of friction and of the twist about n, per normal impulse
        levers : (5, 4, M), of each point 1, -y, x, x² + y² and 0 with its coordinates x along t1
            and y along t2 from the centre, so that it slips by t1 and t2 plus spin times -y and x
        gyration : (M,), mean of x² + y² over the points
        moments : (7, 3, 2, M), r × e of the rows, with the arms r from the two COMs
        """
        isPoint, n, count = self.isPoint, self.normal, len(motion.invMass)
        weight = isPoint / np.maximum(np.add.reduce(isPoint), 1)
        middle = np.add.reduce(weight * self.arm, axis=1)
        arm = self.arm - middle[:, None]
        x, y = dot(arm, self.tangent1[:, None]), dot(arm, self.tangent2[:, None])
        self.levers = np.zeros((5, *x.shape))
        self.levers[0], self.levers[1], self.levers[2], self.levers[3] = 1.0, -y, x, x * x + y * y
        self.limits = mu * isPoint * np.sqrt(self.levers[:4:3])
        self.gyration = np.add.reduce(weight * self.levers[3])

        self.R, arms = np.zeros((6, 7, self.count)), np.empty((3, 6, self.count))
        axes = self.R[:3]
        np.multiply(n[:, None], isPoint, out=axes[:, :POINTS])
        axes[:, 4], axes[:, 5] = self.tangent1, self.tangent2
        # the centre lies midway between the points of the two bodies, which are `gap` apart
        centre = middle + 0.5 * np.add.reduce(weight * self.gap) * n
        arms[:, :POINTS], arms[:, POINTS:] = self.arm, centre[:, None]
        position = np.append(take(frames.position, motion.moving, axis=1), np.zeros((3, 1)), axis=1)
        origin = position.sum(axis=1, keepdims=True) / count
        position -= origin
        # arms from the common origin and from the two COMs
        self.moments = np.empty((7, 3, 2, self.count))
        tables = self.R[3:], *self.moments.transpose(2, 1, 0, 3)
        for moments, o in zip(tables, (origin - self.start1, 0.0 * n, self.t), strict=True):
            moments[:, :6] = triples.cross(arms - o[:, None], axes[:, :6])
            moments[:, 6] = n

        self.X = LEVI_CIVITA @ position
        invInertia = motion.invInertia.reshape(3, 3, -1)
        ofForces = np.einsum("ikn,jkn->ijn", invInertia, self.X)
        self.XM = np.concatenate((ofForces, invInertia), axis=1)
        self.GT = differences(self.ends, count)

    def _make_responses(self, motion):
        """Computes what follows from the responses A.

        mass : (4, M), of each point alone; K[k] : (3 - k, M), response of the speeds of the points
            after point k to its impulse, times their masses
        shared : (4, M), minus the mass of all points together; mutual : (4, M), response of the
            other points' speeds to a unit impulse at each of them, times minus the point's mass
        frictionResponse, frictionMass : (3, 3, M), A and A⁻¹ of the friction rows alone
        slip : (3, 7, M), impulses along the friction rows that stop what changes of the normal
            impulses and the present speeds make them slip
        """
        ends = self.ends.ravel()
        count = np.bincount(ends, minlength=len(motion.invMass))
        load = np.maximum(count / RELAXATION, 1.0)
        invInertia = take(load * motion.invInertia, ends, axis=1).reshape(3, 3, 2, -1)
        angular = np.einsum("ijem,rjem->riem", invInertia, self.moments).reshape(7, 6, -1)
        A = np.einsum("rim,sim->rsm", self.moments.reshape(7, 6, -1), angular)
        invMass = take(load * motion.invMass, ends).reshape(2, -1).sum(axis=0)
        for row in (slice(0, POINTS), 4, 5):
            A[row, row] += invMass
        diagonal = A.diagonal().T[:POINTS]
        self.mass = self.isPoint / np.where(diagonal > 0.0, diagonal, 1.0)
        K = self.mass * A[:POINTS, :POINTS]
        self.K = [K[k, k + 1 :] for k in range(POINTS)]
        isPoint = 1.0 * self.isPoint
        total = np.einsum("jm,jkm,km->m", isPoint, A[:POINTS, :POINTS], isPoint)
        self.shared = isPoint / -np.where(total > 0.0, total, 1.0)
        self.mutual = isPoint - np.einsum("jm,jkm->km", isPoint, K)
        friction = A[POINTS:, POINTS:]  # symmetric
        isSpun = self.limits[1].any(axis=0)  # a single point resists no spin
        friction[2, :2] *= isSpun
        friction[:2, 2] *= isSpun
        inverse = cross(friction[:, [1, 2, 0]], friction[:, [2, 0, 1]])
        determinant = dot(friction[:, 0], inverse[:, 0])
        inverse /= np.where(determinant > 0.0, determinant, 1.0)
        self.frictionResponse, self.frictionMass = friction, inverse
        ofNormals = np.einsum("ikm,kjm->ijm", inverse, A[POINTS:, :POINTS])
        self.slip = np.concatenate((ofNormals, inverse), axis=1)
        self.slip[2] *= isSpun

    def impact_speeds(self, motion):
        """Normal speeds (4, M) at which points meet after free flight has closed their gaps s.

        u² = u₀² - 2 a s, with the relative acceleration a along the normal.
        """
        self.measure(motion)
        speed = self.speed[:POINTS]
        gravity = motion.gravity[:, self.ends[1]] - motion.gravity[:, self.ends[0]]
        gain = -2.0 * dot(self.normal, gravity) * np.maximum(self.separation, 0.0)
        return -np.sqrt(np.maximum(speed * speed + gain, 0.0)) * (speed < 0.0)

    def measure(self, motion):
        """Computes the speeds (7, M) of the rows; those of the points are > 0 if separating."""
        self.apply(motion)
        moving = motion.velocity.copy()
        moving[:3] += np.einsum("ijn,jn->in", self.X, moving[3:])
        relative = take(moving, self.ends[1], axis=1) - take(moving, self.ends[0], axis=1)
        self.speed = np.einsum("irm,im->rm", self.R, relative)

    def apply(self, motion):
        """Applies the impulses accumulated since the last call to the bodies."""
        wrench = self.GT @ np.einsum("irm,rm->im", self.R, self.pending).ravel()
        wrench = wrench.reshape(6, -1)
        motion.velocity[:3] += motion.invMass * wrench[:3]
        motion.velocity[3:] += np.einsum("ijn,jn->in", self.XM, wrench)
        self.pending = self.nothing

    def warm_start(self):
        """Starts with the impulses of the last substep, limited by LOAD_GROWTH."""
        normal, friction = self.impulse[:POINTS], self.impulse[POINTS:]
        self.started = np.minimum(normal, np.maximum(LOAD_GROWTH * self.started, self.least))
        share = np.add.reduce(self.started) / np.maximum(np.add.reduce(normal), TINY)
        self.impulse = np.concatenate((self.started, friction * share))
        self.pending = self.pending + self.impulse

    def soft_sweep(self, motion):
        """Pushes penetration out; a second pass follows if points still close fast."""
        approach = self.separation / self.h  # a gap may close within the substep, but not more
        bias = np.maximum(np.maximum(self.spring.rate * self.separation, self.push), approach)
        softness = np.maximum(self.separation > 0.0, self.spring.softness)  # 1 for a gap
        springs = softness, self.mass * (self.yielding - np.minimum(bias, 0.0))
        self.measure(motion)
        if self.sliders is None:
            self.sliders = Sliders(self)
        self._solve(bias, *springs)
        self.measure(motion)
        closing = self.speed[:POINTS] + np.maximum(approach, 0.0)
        if closing.min(initial=0.0) < -HIT_STEPS * self.fall:
            self._solve(bias, *springs)
            self.measure(motion)
        self.separation += self.h * self.speed[:POINTS]

    def relax(self):
        """Removes the velocity added by the springs."""
        self._solve(np.maximum(self.separation, 0.0) / self.h)
        self.total += self.impulse

    def _solve(self, bias, softness=None, most=None):
        """Solves all manifolds from the measured motion: λ ← s (λ - m (u + bias)), λ ≥ 0.

        softness, most : (4, M), s, and the most by which it lowers λ; None in the relaxing sweep

        The points of a manifold are visited in order, as in the Gauss-Seidel method, and then
        friction. Alternating the order would make tall stacks sway. In the relaxing sweep, all
        points first share the impulse that would stop their mean speed, if it pushes: without it,
        the point visited first takes most of a blow, and a box that lands flat tilts.
        In the soft sweep, sliding manifolds keep their friction, which would otherwise exceed the
        limit of the points.
        """
        before, speed, change = self.impulse, self.speed, self.change
        impulse = self.impulse = np.empty_like(before)
        error, start = speed[:POINTS] + bias, before[:POINTS]
        left = start - self.mass * error
        if softness is None:
            common = np.maximum(np.einsum("km,km->m", self.shared, error), 0.0)
            left += self.mutual * common
            start = start + common
        for k, K in enumerate(self.K):
            wanted = left[k]
            if softness is not None:
                wanted = np.maximum(softness[k] * wanted, wanted - most[k])
            np.maximum(wanted, 0.0, out=impulse[k])
            np.subtract(impulse[k], start[k], out=change[k])
            if k < POINTS - 1:
                left[k + 1 :] -= K * change[k]
        if softness is None:
            change[:POINTS] += common
        change[POINTS:] = speed[POINTS:]
        friction = before[POINTS:] - np.einsum("irm,rm->im", self.slip, change)
        # Coulomb's law: at most μ Σ λ, and a twist of at most μ Σ λ times the lever arm
        limit = np.einsum("ikm,km->im", self.limits, impulse[:POINTS])
        sliding = () if self.sliders is None else self.sliders.rows
        if softness is not None and len(sliding):
            friction = np.where(self.sliders.isSlider, before[POINTS:], friction)
        size = friction * friction
        size[0] += size[1]
        size = np.sqrt(size[::2])
        share, twistShare = limit / np.maximum(np.maximum(size, limit), TINY)
        np.multiply(friction[:2], share, out=impulse[4:6])
        np.multiply(friction[2], twistShare, out=impulse[6])
        if softness is None and len(sliding):
            size /= np.maximum(limit, TINY)
            impulse[POINTS:, sliding] = self.sliders.friction(impulse, friction, size, speed)
        self.pending = impulse - before

    def restitute(self, motion, CRCoeff, closing, bodies, links):
        """Makes points that closed faster than one step of gravity separate at e times that speed,
        as far as energy allows; then the points that this makes close, and so on.

        closing : (4, M), from `impact_speeds`; links : (2, R), bodies connected by constraints

        First, the other manifolds lose e times the blows that they took in the substeps. Each then
        passes its blow on in turn, as in a row of balls. Points that still close after the last
        round bounce in the next step.
        """
        links = np.concatenate((self.ends, take(motion.column, links)), axis=1)
        energies = IslandEnergies(bodies, motion, links, self.timeStep)
        self._keep(motion, energies.free, energies.share(energies.free, 0.0), self.nothing)
        bounces = (closing < -self.fall) & (self.total[:POINTS] > 0.0)
        if not bounces.any():
            return
        least = max(self.fall, -BOUNCE_SHARE * closing[bounces].min())
        before, velocity = self.total, motion.velocity[:, :-1].copy()
        touches = (before[:POINTS] > 0.0) | (self.isPoint & (self.separation <= 0.0))
        touches = self.isPoint & touches.any(axis=0)
        load = np.add.reduce(before[:POINTS])
        blow = load - self.carried
        isBlow = (np.add.reduce(self.mass) * blow > self.fall) & ~bounces.any(axis=0)
        self.total = before * np.where(isBlow, 1.0 - CRCoeff * blow / np.maximum(load, TINY), 1.0)
        self.pending = self.total - before
        for _ in range(BOUNCE_ROUNDS):
            self.apply(motion)
            some = indices(bounces.any(axis=0))
            bias = np.where(bounces, CRCoeff * closing, np.maximum(self.separation, 0.0) / self.h)
            self.total[:, some] = self._bounced(some, take(bias, some, 1), motion)
            self.measure(motion)
            closing = self.speed[:POINTS]
            bounces = touches & (closing < -least) & (self.separation < -self.timeStep * closing)
            if not bounces.any():
                break
        self._keep(motion, velocity, energies.share(velocity), before)

    def _keep(self, motion, velocity, share, total):
        """Keeps a share (m,) of the changes since these velocities (6, m) and impulses."""
        motion.velocity[:, :-1] += (share - 1.0) * (motion.velocity[:, :-1] - velocity)
        share = take(share, self.ends.min(axis=0))  # of the first end that moves
        self.total = total + share * (self.total - total)

    def _bounced(self, some, bias, motion):
        """Solves manifolds `some` (K,) alone for a bias (4, K); returns their `total`."""
        part = copy(self)
        for name in ("ends", "R", "moments", "limits", "isPoint", "change", "nothing"):
            setattr(part, name, take(getattr(self, name), some, -1))
        part._make_responses(motion)
        part.GT = differences(part.ends, len(motion.invMass))
        part.impulse, part.pending, part.sliders = take(self.total, some, 1), part.nothing, None
        most = -BOUNCE_TOLERANCE * bias.min()
        for _ in range(BOUNCE_SWEEPS):
            part.measure(motion)
            error = part.speed[:POINTS] + bias
            if np.where(part.impulse[:POINTS] > 0.0, np.abs(error), -error).max() <= most:
                break
            part._solve(bias)
        part.apply(motion)
        return part.impulse

    def store(self, manifolds):
        """Returns the manifolds with the values from which the next step starts."""
        values = {"impulse": self.impulse[:POINTS], "friction": self.impulse[POINTS:]}
        values["offset"] = lasting(self.offset, self.offset - self.separation)
        for name, value in values.items():
            values[name] = getattr(manifolds, name).copy()
            values[name][..., self.rows] = value
        return manifolds.renewed(**values)


def differences(ends, bodies):
    """Returns Gᵀ, sparse, (6 bodies, 6 M), for wrenches as (6 M,).

    G has -1 at the first and 1 at the second of `ends` (2, M). Sums are in the order of the
    manifolds. A dense product, by BLAS, would have other bits on other processors.
    """
    count = 6 * ends.shape[1]
    rows = ends.T.ravel() + bodies * np.arange(6)[:, None]
    entries = np.tile((-1.0, 1.0), count), rows.ravel(), np.arange(0, 2 * count + 1, 2)
    return csc_array(entries, shape=(6 * bodies, count))


class Sliders:
    """Friction of manifolds `rows` (K,) whose points slide, each point's against its slip.

    A point that slips by u = B w, with the speeds w of the friction rows, receives -μ λ u/|u|.

    isSlider : (M,) bool, these manifolds among all
    """

    def __init__(self, contacts):
        """Selects manifolds that slip fast and may touch within the step, by measured speeds."""
        least = FAST_SLIP * max(contacts.fall, TINY)
        x, y, spin = contacts.speed[POINTS:]
        isFast = x * x + y * y + contacts.gyration * (spin * spin) > least * least
        closing = contacts.timeStep * (contacts.fall - contacts.speed[:POINTS])
        isNear = contacts.isPoint & (contacts.separation < closing)
        self.isSlider = isFast & isNear.any(axis=0) & contacts.limits[1].any(axis=0)
        self.rows = some = indices(self.isSlider)
        if len(some) == 0:
            return
        self.weights = np.ones((3, len(some)))
        self.weights[2] = take(contacts.gyration, some)
        self.levers, self.limits = take(contacts.levers, some, 2), take(contacts.limits[0], some, 1)
        self.response = take(contacts.frictionResponse, some, 2)
        mass = take(contacts.frictionMass, some, 2)
        self.mass, self.least = take(take(mass, CYCLE, 0), CYCLE, 1), contacts.leastSlip

    def friction(self, impulse, sticking, size, speed):
        """Impulses (3, K) along the friction rows.

        impulse : (7, M), of all rows, whose friction is that of points that stick
        sticking : (3, M), f*, impulses that would stop the slip w = A (f - f*) of the rows
        size : (2, M), friction and twist of f*, each relative to its limit without the other
        speed : (7, M), of all rows
        """
        impulse, sticking = take(impulse, self.rows, 1), take(sticking, self.rows, 1)
        # some points slide if, about, (S/L)² + (T/M)² > 1 for the friction S and the twist T, with
        # the limits L of S alone and M of T alone
        size = take(size, self.rows, 1)
        size = np.sqrt(np.add.reduce(size * size))
        speed = take(speed[POINTS:], self.rows, 1)
        sliding = self._sliding(impulse[:POINTS], sticking, np.maximum(size, 1.0), speed)
        return np.where(size > 1.0, sliding, impulse[POINTS:])

    def _sliding(self, impulse, sticking, size, speed):
        """Friction (3, K) if points slide.

        size : (K,), about what f* is to be divided by to reach the limit; speed : (3, K)

        With c = μ λ/|u| for an estimate of |u| and C = Σ Bᵀ c B, f = -C w, and thus
        -w = (A⁻¹ + C)⁻¹ f*. A point that would then slip faster than estimated receives no more
        than μ λ. The estimate is the slip with f = f*/size, scaled down to the measured slip of all
        points; that of each would make spins oscillate.
        """
        limit = self.limits * impulse
        scaled = np.einsum("ijm,jm->im", self.response, sticking * (1.0 / size - 1.0))
        ratio = self._mean_square(speed) / np.maximum(self._mean_square(scaled), TINY)
        estimate = self._slip(scaled * np.sqrt(np.minimum(ratio, 1.0)))
        np.maximum(estimate, self.least, out=estimate)
        matrix = self.mass + self._resistance(limit / estimate)
        cofactors = matrix[1:4, 1:4] * matrix[2:, 2:] - matrix[1:4, 2:] * matrix[2:, 1:4]
        w = np.einsum("ijm,jm->im", cofactors, sticking)
        w /= np.einsum("jm,jm->m", cofactors[0], matrix[0, :3])  # the determinant
        limit /= np.maximum(estimate, self._slip(w))
        return np.einsum("ijm,jm->im", self._resistance(limit)[:3, :3], w)

    def _resistance(self, c):
        """C, as repeated by SPREAD (5, 5, K), for c (4, K)."""
        return take(np.einsum("ikm,km->im", self.levers, c), SPREAD, 0).reshape(5, 5, -1)

    def _mean_square(self, w):
        """Mean squares (K,) of `_slip`."""
        return np.einsum("im,im->m", self.weights, w * w)

    def _slip(self, w):
        """Slip speeds (4, K) of the points; w : (3, K), speeds of the friction rows."""
        u = self.levers[1:3] * w[2]
        u += w[:2, None]
        u *= u
        u[0] += u[1]
        return np.sqrt(u[0])


class IslandEnergies:
    """Bounds the energy that contacts give to each island of connected bodies.

    If several pairs collide in one step, Newton's law of restitution may require more energy than
    there was (Stronge: Rigid body collisions with friction. Proceedings of the Royal Society A,
    1990), and a single relaxing sweep leaves some of the velocity with which overlaps are pushed
    out. Each island therefore keeps the largest fraction of its velocity changes that does not
    raise its energy. One fraction per island conserves momentum.

    free : (6, m), velocities after free flight
    """

    def __init__(self, bodies, motion, links, timeStep):
        """bodies : `Bodies`, at the start of the step; links : (2, L), connected columns"""
        moving = motion.moving
        self._motion, self._mass = motion, np.array([bodies.meshes[b].mass for b in moving])
        tensors, start = take(bodies.inertias(), moving, 1), take(bodies.velocity, moving, 1)
        atEnd = np.stack(rotation_matrices(motion.orientations(bodies)))
        self._inertia, atEnd = (
            np.stack(rotate_tensor(rotation, tensors))
            for rotation in (take(bodies.hulls.rotation, moving, 1), atEnd)
        )
        self._limit = 0.5 * self._products(start, start)
        self._limit += self._mass * dot(motion.gravity, motion.shift)[:-1]
        self._inertia = atEnd
        self.free = start.copy()
        self.free[:3] += timeStep * motion.gravity[:, :-1]
        self._island = islands(links, np.ones(len(moving), dtype=bool))
        # kinematic bodies and torques do work
        isWorking = (motion.invMass == 0.0) | motion.spinUp.any(axis=0)
        self._works = np.bincount(self._island, isWorking[:-1]) > 0.0

    def _products(self, v, w):
        """Returns vᵀ M w (m,) for velocities (6, m)."""
        return self._mass * dot(v[:3], w[:3]) + dot(v[3:], mat_vec(self._inertia, w[3:]))

    def share(self, before, least=-np.inf):
        """Returns the fraction (m,) of the changes since these velocities (6, m) that may stay.

        least : J by which the energy may grow in any case, even beyond the limit
        """
        # with the fraction s, the energy is that before plus b s + a s²
        left = np.bincount(self._island, self._limit - 0.5 * self._products(before, before))
        left = np.maximum(left, least)
        change = self._motion.velocity[:, :-1] - before
        a = np.bincount(self._island, 0.5 * self._products(change, change))
        b = np.bincount(self._island, self._products(before, change))
        left = np.where(self._works, np.maximum(left, a + b), left)
        root = np.sqrt(np.maximum(b * b + 4.0 * a * left, 0.0))
        share = np.where(a + b > left, (root - b) / np.where(a > 0.0, 2.0 * a, 1.0), 1.0)
        return np.clip(share, 0.0, 1.0)[self._island]
