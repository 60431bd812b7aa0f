"""Contacts of the soft step: velocity constraints on all manifolds, and restitution.

All manifolds are solved simultaneously from the same velocities, so that the result depends on
their order only by rounding, which a pile may amplify to 1e-5 m. For convergence, the mass of a
body is split between its manifolds, while the impulses act on the whole body (Tonge, Benevolenski,
Voroshilov: Mass Splitting for Jitter-Free Parallel Rigid Body Simulation. SIGGRAPH 2012).
Over-relaxation makes impulses travel faster through a stack.
"""

import numpy as np
from scipy.sparse import csc_array

from rbs.geometry import triples
from rbs.geometry.arrays import indices, take
from rbs.geometry.broadphase import islands
from rbs.geometry.vectors import cross, dot, mat_vec, rotate_tensor
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
# Places of 1, -y, x, x² + y² and 0 in the matrix Bᵀ B of a point, see `Sliders`.
SPREAD = np.array((0, 4, 1, 4, 0, 2, 1, 2, 3))
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


class ContactRows:
    """Contacts of a step as rows of velocity constraints, for M manifolds at once; constant.

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

    ends : (2, M), columns of `Motion`; isPoint : (4, M)
    X : (3, 3, m + 1), upper right part of X, the matrix of x ×
    XM : (3, 6, m + 1), lower half of M⁻¹ Xᵀ; the upper one only divides forces by masses
    R : (6, 7, M), transposed; GT : see `differences`
    limits : (2, 4, M), of friction and of the twist about n, per normal impulse
    levers : (5, 4, M), of each point 1, -y, x, x² + y² and 0 with its coordinates x along t1
        and y along t2 from the centre, so that it slips by t1 and t2 plus spin times -y and x
    gyration : (M,), mean of x² + y² over the points
    moments : (7, 3, 2, M), r × e of the rows, with the arms r from the two COMs
    """

    def __init__(self, placed, ends, frames, motion, mu):
        """placed : `PlacedManifolds`"""
        self.ends, self.isPoint = ends, placed.isPoint
        isPoint, n, count = placed.isPoint, placed.normal, len(motion.invMass)
        weight = isPoint / np.maximum(np.add.reduce(isPoint), 1)
        middle = np.add.reduce(weight * placed.arm, axis=1)
        arm = placed.arm - middle[:, None]
        x, y = dot(arm, placed.tangent1[:, None]), dot(arm, placed.tangent2[:, None])
        self.levers = np.zeros((5, *x.shape))
        self.levers[0], self.levers[1], self.levers[2], self.levers[3] = 1.0, -y, x, x * x + y * y
        self.limits = mu * isPoint * np.sqrt(self.levers[:4:3])
        self.gyration = np.add.reduce(weight * self.levers[3])

        self.R, arms = np.zeros((6, 7, placed.count)), np.empty((3, 6, placed.count))
        axes = self.R[:3]
        np.multiply(n[:, None], isPoint, out=axes[:, :POINTS])
        axes[:, 4], axes[:, 5] = placed.tangent1, placed.tangent2
        # the centre lies midway between the points of the two bodies, which are `gap` apart
        centre = middle + 0.5 * np.add.reduce(weight * placed.gap) * n
        arms[:, :POINTS], arms[:, POINTS:] = placed.arm, centre[:, None]
        position = np.append(take(frames.position, motion.moving, axis=1), np.zeros((3, 1)), axis=1)
        origin = position.sum(axis=1, keepdims=True) / count
        position -= origin
        # arms from the common origin and from the two COMs
        self.moments = np.empty((7, 3, 2, placed.count))
        tables = self.R[3:], *self.moments.transpose(2, 1, 0, 3)
        for moments, o in zip(tables, (origin - placed.start1, 0.0 * n, placed.t), strict=True):
            moments[:, :6] = triples.cross(arms - o[:, None], axes[:, :6])
            moments[:, 6] = n

        self.X = LEVI_CIVITA @ position
        invInertia = motion.invInertia.reshape(3, 3, -1)
        ofForces = np.einsum("ikn,jkn->ijn", invInertia, self.X)
        self.XM = np.concatenate((ofForces, invInertia), axis=1)
        self._make_responses(motion)

    def of(self, some, isActive, motion):
        """Returns the rows of manifolds `some` (K,) as if there were no others.

        isActive : (4, K), points whose impulses may change
        """
        part = object.__new__(ContactRows)
        part.X, part.XM, part.isPoint = self.X, self.XM, isActive
        for name in ("ends", "R", "moments", "limits", "levers", "gyration"):
            setattr(part, name, take(getattr(self, name), some, -1))
        part._make_responses(motion)
        return part

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
        self.GT = differences(self.ends, len(motion.invMass))
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
        inverse, determinant = adjugate(friction)
        inverse /= np.where(determinant > 0.0, determinant, 1.0)
        self.frictionResponse, self.frictionMass = friction, inverse
        ofNormals = np.einsum("ikm,kjm->ijm", inverse, A[POINTS:, :POINTS])
        self.slip = np.concatenate((ofNormals, inverse), axis=1)
        self.slip[2] *= isSpun

    def speeds(self, motion):
        """Speeds (7, M) of the rows; those of the points are > 0 if separating."""
        moving = motion.velocity.copy()
        moving[:3] += np.einsum("ijn,jn->in", self.X, moving[3:])
        relative = take(moving, self.ends[1], axis=1) - take(moving, self.ends[0], axis=1)
        return np.einsum("irm,im->rm", self.R, relative)

    def apply(self, motion, impulse):
        """Applies impulses (7, M) to the bodies."""
        wrench = self.GT @ np.einsum("irm,rm->im", self.R, impulse).ravel()
        wrench = wrench.reshape(6, -1)
        motion.velocity[:3] += motion.invMass * wrench[:3]
        motion.velocity[3:] += np.einsum("ijn,jn->in", self.XM, wrench)

    def solved(self, before, speed, bias, softness=None, most=None, sliders=None):
        """Returns the impulses (7, M) after one sweep: λ ← s (λ - m (u + bias)), λ ≥ 0.

        before, speed : (7, M), impulses, and the speeds of the rows with them; bias : (4, M)
        softness, most : (4, M), s, and the most by which it lowers λ; None in the relaxing sweep
        sliders : `Sliders`, or None if all friction is that of points that stick

        The points of a manifold are visited in order, as in the Gauss-Seidel method, and then
        friction. Alternating the order would make tall stacks sway. In the relaxing sweep, all
        points first share the impulse that would stop their mean speed, if it pushes: without it,
        the point visited first takes most of a blow, and a box that lands flat tilts.
        In the soft sweep, sliding manifolds keep their friction, which would otherwise exceed the
        limit of the points.
        """
        impulse, change = np.empty_like(before), np.empty_like(before)
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
        sliding = () if sliders is None else sliders.rows
        if softness is not None and len(sliding):
            friction = np.where(sliders.isSlider, before[POINTS:], friction)
        size = friction * friction
        size[0] += size[1]
        size = np.sqrt(size[::2])
        share, twistShare = limit / np.maximum(np.maximum(size, limit), TINY)
        np.multiply(friction[:2], share, out=impulse[4:6])
        np.multiply(friction[2], twistShare, out=impulse[6])
        if softness is None and len(sliding):
            size /= np.maximum(limit, TINY)
            impulse[POINTS:, sliding] = sliders.friction(impulse, friction, size, speed)
        return impulse


class SoftContacts(PlacedManifolds):
    """Impulses of a step on the `ContactRows` of the manifolds that have a movable body.

    impulse, total : (7, M), in the last substep, and in all of them; separation : (4, M)
    """

    def __init__(self, manifolds, frames, motion, mu, timeStep, h, ratio):
        """h : s, length of a substep, `ratio` times that of the last step
        """
        self.h, self.timeStep = h, timeStep
        self.fall = motion.fallRate * timeStep  # speed that gravity adds in a step
        columns = take(motion.column, manifolds.bodies(frames.count))
        isMovable = (motion.invMass[columns] > 0.0).any(axis=0)
        self.others = indices(~isMovable)
        super().__init__(manifolds, frames, indices(isMovable))
        manifolds = manifolds.rows(self.rows)
        self.ends = take(columns, self.rows, axis=1)
        self.system = ContactRows(self, self.ends, frames, motion, mu)
        # Penetration is pushed out at up to √(g r) of the smaller body. If this were faster, bodies
        # that start inside each other would burst apart.
        radius = frames.sizes(self.first, self.second)[1]
        self.push = -np.sqrt(max(motion.fallRate, -GRAVITY) * radius)
        self.impulse = np.concatenate((manifolds.impulse * self.isPoint, manifolds.friction))
        self.offset = manifolds.offset
        self.spring = Spring(FREQUENCY, DAMPING, h)
        if ratio != 1.0:
            loads = self.impulse[:POINTS], self.system.mass, -self.gap
            self.offset = self.spring.converted(self.offset, *loads, ratio)
            self.impulse *= ratio
        self.separation = self.gap + self.offset
        isOnStill = self.ends.max(axis=0) == len(motion.moving)
        self.yielding = np.where(isOnStill, -YIELD * self.push, 1.0 / TINY)
        self.started = self.impulse[:POINTS]
        self.carried = np.add.reduce(self.started) * (timeStep / h)  # in a step as the last substep
        self.least = self.system.mass * (motion.fallRate * h)
        self.leastSlip = LEAST_SLIP * max(motion.fallRate, -GRAVITY) * h
        self.pending, self.total = np.zeros((2, 7, self.count))
        self.sliders = None

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
        """Computes the speeds (7, M) of the rows, with all impulses applied."""
        self.apply(motion)
        self.speed = self.system.speeds(motion)

    def apply(self, motion):
        """Applies the impulses accumulated since the last call to the bodies."""
        self.system.apply(motion, self.pending)
        self.pending = np.zeros_like(self.pending)

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
        most = self.system.mass * (self.yielding - np.minimum(bias, 0.0))
        self.measure(motion)
        if self.sliders is None:
            self.sliders = Sliders(self)
        self._sweep(bias, softness, most)
        self.measure(motion)
        closing = self.speed[:POINTS] + np.maximum(approach, 0.0)
        if closing.min(initial=0.0) < -HIT_STEPS * self.fall:
            self._sweep(bias, softness, most)
            self.measure(motion)
        self.separation += self.h * self.speed[:POINTS]

    def relax(self):
        """Removes the velocity added by the springs."""
        self._sweep(np.maximum(self.separation, 0.0) / self.h)
        self.total += self.impulse

    def _sweep(self, bias, softness=None, most=None):
        before = self.impulse
        given = bias, softness, most, self.sliders
        self.impulse = self.system.solved(before, self.speed, *given)
        self.pending = self.impulse - before

    def impact(self, motion, CRCoeff, closing, bodies, links):
        """Solves the blows of the step, and bounds the energy that it has added.

        closing : (4, M), from `impact_speeds`; links : (2, R), bodies connected by constraints

        Points are struck that closed faster than one step of gravity. With the restitution e, the
        impulses of the step become (1 - e) P + e E, and the velocities likewise. P are plastic ones,
        with which struck bodies do not separate; E elastic ones.
        """
        self.apply(motion)
        isStruck = (closing < -self.fall) & (self.total[:POINTS] > 0.0)
        if isStruck.any():
            before = motion.velocity.copy()
            plastic = self._plastic(motion, isStruck) if CRCoeff < 1.0 else self.total
            velocity = motion.velocity.copy()
            if CRCoeff > 0.0:
                motion.velocity[:] = before
                elastic = self._elastic(motion, isStruck, closing)
                motion.velocity += (1.0 - CRCoeff) * (velocity - motion.velocity)
                plastic = plastic + CRCoeff * (elastic - plastic)
            self.total = plastic
        bound_energies(bodies, motion, self, take(motion.column, links))

    def _plastic(self, motion, isStruck):
        """Returns total impulses with which no point of a struck body separates that was pressed.

        All manifolds of struck bodies take part: others are what they are pressed against.
        """
        isHit = np.zeros(len(motion.invMass), dtype=bool)
        isHit[self.ends[:, isStruck.any(axis=0)]] = True
        isHit &= motion.invMass > 0.0
        isPressed = self.total[:POINTS] > 0.0
        some = indices(isHit[self.ends].any(axis=0) & isPressed.any(axis=0))
        bias = np.where(isPressed, 0.0, np.maximum(self.separation, 0.0) / self.h)
        return self._solved(motion, some, bias, self.isPoint)

    def _elastic(self, motion, bounces, closing):
        """Returns total impulses with which points separate as fast as they closed, then the points
        that this makes close, and so on, as in a row of balls.

        First, other manifolds lose the blows that they took in the substeps. Points that still
        close after the last round bounce in the next step.
        """
        least = max(self.fall, -BOUNCE_SHARE * closing[bounces].min())
        load = np.add.reduce(self.total[:POINTS])
        isTouching = (self.total[:POINTS] > 0.0) | (self.isPoint & (self.separation <= 0.0))
        isPressed = self.isPoint & isTouching.any(axis=0)
        blow = load - self.carried
        isBlow = blow > self.fall * np.add.reduce(self.system.mass)
        share = np.where(isBlow, np.minimum(self.carried / np.maximum(load, TINY), 1.0), 1.0)
        total = self.total * share
        self.system.apply(motion, total - self.total)
        slow = BOUNCE_TOLERANCE * least
        for _ in range(BOUNCE_ROUNDS):
            some = indices(bounces.any(axis=0))
            speed = self.system.speeds(motion)[:POINTS]
            isActive = bounces | (isTouching & (speed <= slow))
            self.total = total
            total = self._solved(motion, some, np.where(bounces, closing, 0.0), isActive)
            closing = self.system.speeds(motion)[:POINTS]
            bounces = isPressed & (closing < -least) & (self.separation < -self.timeStep * closing)
            if not bounces.any():
                break
        return total

    def _solved(self, motion, some, bias, isActive):
        """Solves manifolds `some` (K,) for a bias (4, M); returns the total impulses.

        isActive : (4, M), points whose impulses may change
        """
        system = self.system.of(some, take(isActive, some, 1), motion)
        bias, impulse = take(bias, some, 1), take(self.total, some, 1)
        speed = system.speeds(motion)
        most = BOUNCE_TOLERANCE * max(-bias.min(initial=0.0), self.fall)
        for _ in range(BOUNCE_SWEEPS):
            error = np.where(system.isPoint, speed[:POINTS] + bias, 0.0)
            if np.where(impulse[:POINTS] > 0.0, np.abs(error), -error).max(initial=0.0) <= most:
                break
            before, impulse = impulse, system.solved(impulse, speed, bias)
            system.apply(motion, impulse - before)
            speed = system.speeds(motion)
        total = self.total.copy()
        total[:, some] = impulse
        return total

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


def adjugate(matrix):
    """Returns the adjugate of symmetric matrices (3, 3, M), and their determinants (M,)."""
    result = cross(matrix[:, [1, 2, 0]], matrix[:, [2, 0, 1]])
    return result, dot(matrix[:, 0], result[:, 0])


class Sliders:
    """Friction of manifolds `rows` (K,) whose points slide, each point's against its slip.

    A point that slips by u = B w, with the speeds w of the friction rows, receives -μ λ u/|u|.

    isSlider : (M,) bool, these manifolds among all
    """

    def __init__(self, contacts):
        """Selects manifolds that slip fast and may touch within the step, by measured speeds."""
        system = contacts.system
        least = FAST_SLIP * max(contacts.fall, TINY)
        x, y, spin = contacts.speed[POINTS:]
        isFast = x * x + y * y + system.gyration * (spin * spin) > least * least
        closing = contacts.timeStep * (contacts.fall - contacts.speed[:POINTS])
        isNear = contacts.isPoint & (contacts.separation < closing)
        self.isSlider = isFast & isNear.any(axis=0) & system.limits[1].any(axis=0)
        self.rows = some = indices(self.isSlider)
        if len(some) == 0:
            return
        self.weights = np.ones((3, len(some)))
        self.weights[2] = take(system.gyration, some)
        self.levers, self.limits = take(system.levers, some, 2), take(system.limits[0], some, 1)
        self.response = take(system.frictionResponse, some, 2)
        self.mass, self.least = take(system.frictionMass, some, 2), contacts.leastSlip

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
        cofactors, determinant = adjugate(matrix)
        w = np.einsum("ijm,jm->im", cofactors, sticking) / determinant
        limit /= np.maximum(estimate, self._slip(w))
        return np.einsum("ijm,jm->im", self._resistance(limit), w)

    def _resistance(self, c):
        """C (3, 3, K), for c (4, K)."""
        return take(np.einsum("ikm,km->im", self.levers, c), SPREAD, 0).reshape(3, 3, -1)

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


def bound_energies(bodies, motion, contacts, links):
    """Bounds the energy that contacts give to each island of connected bodies.

    bodies : `Bodies`, at the start of the step; links : (2, L), connected columns

    If several pairs collide in one step, Newton's law of restitution may require more energy than
    there was (Stronge: Rigid body collisions with friction. Proceedings of the Royal Society A,
    1990). Springs that push overlaps out give some, too, and so does friction that is not solved
    exactly. An island has no more energy after a step than before, and gravity's work.

    Where it has, its velocities shrink if it rests on something, and otherwise its impulses, which
    conserve momentum. Islands on which kinematic bodies, forces or torques work are left alone.
    """
    moving, isTouched = motion.moving, (contacts.total[:POINTS] > 0.0).any(axis=0)
    if len(moving) == 0:
        return
    links = np.concatenate((take(contacts.ends, indices(isTouched), 1), links), axis=1)
    island = islands(links, np.append(motion.invMass[:-1] > 0.0, False)[:-1])
    count = int(island.max()) + 1
    start = take(bodies.velocity, moving, axis=1)
    mass = np.where(motion.invMass > 0.0, 1.0 / np.where(motion.invMass > 0.0, motion.invMass, 1.0), 0.0)[:-1]
    tensors = take(bodies.inertias(), moving, 1)
    inertia = np.stack(rotate_tensor(take(bodies.hulls.rotation, moving, 1), tensors))

    def products(v, w):
        return mass * dot(v[:3], w[:3]) + dot(v[3:], mat_vec(inertia, w[3:]))

    limit = 0.5 * products(start, start) + mass * dot(motion.gravity, motion.shift)[:-1]
    now = motion.velocity[:, :-1]
    isWorking = (motion.invMass[:-1] == 0.0) | motion.spinUp[:, :-1].any(axis=0)
    worked = np.zeros(len(moving) + 1, dtype=bool)
    worked[:-1] = isWorking
    hit = links[:, worked[links].any(axis=0)]
    worked[hit.ravel()] = True
    works = np.bincount(island, worked[:-1], count) > 0.0
    limit = np.bincount(island, limit, count)
    energy = np.bincount(island, 0.5 * products(now, now), count)
    isOver = (energy > limit) & ~works
    if not isOver.any():
        return
    # islands on something
    fixed = np.zeros(count, dtype=bool)
    touched = links[:, (links == len(moving)).any(axis=0)].min(axis=0)
    fixed[island[touched[touched < len(moving)]]] = True
    shrink = np.sqrt(np.maximum(limit, 0.0) / np.maximum(energy, TINY))
    free = start.copy()
    free[:3] += contacts.timeStep * motion.gravity[:, :-1]
    change = now - free
    a = np.bincount(island, 0.5 * products(change, change), count)
    b = np.bincount(island, products(free, change), count)
    left = np.maximum(limit - np.bincount(island, 0.5 * products(free, free), count), 0.0)
    root = np.sqrt(np.maximum(b * b + 4.0 * a * left, 0.0))
    share = np.clip((root - b) / np.where(a > 0.0, 2.0 * a, 1.0), 0.0, 1.0)
    ofChange = np.where(isOver & ~fixed, share, 1.0)[island]
    ofAll = np.where(isOver & fixed, shrink, 1.0)[island]
    motion.velocity[:, :-1] = ofAll * (free + ofChange * change)
    ends = contacts.ends.min(axis=0)
    contacts.total = contacts.total * take(np.append(ofChange, 1.0), ends)
