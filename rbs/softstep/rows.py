"""Contacts of a step as rows of velocity constraints, solved in sweeps.

All manifolds are solved simultaneously from the same velocities, so that the result depends on
their order only by rounding, which a pile may amplify to 1e-5 m. It also depends on which of two
bodies is the first, with which the normal turns while a contact lasts, and on the order in which
the points of a manifold are visited.

For convergence, the mass of a body is split between its manifolds, while the impulses act on the
whole body (Tonge, Benevolenski, Voroshilov: Mass Splitting for Jitter-Free Parallel Rigid Body
Simulation. SIGGRAPH 2012). Over-relaxation makes impulses travel faster through a stack.
"""

import numpy as np

from rbs.geometry import triples
from rbs.geometry.broadphase import islands
from rbs.geometry.vectors import dot, indices, mat_vec, take
from rbs.softstep.manifolds import POINTS, TINY
from rbs.stepping.flight import turn_matrix

# Over-relaxation ω: a body with N manifolds counts as m ω/N in each, but at most as m. With less,
# impulses travel more slowly, and the same stiffness takes a third more substeps; with 2, sweeps
# diverge, and stacks burst.
RELAXATION = 1.6
# Most sweeps until impulses converge, and most rounds of bounces, each of the points that the last
# one makes close. More cost time. With fewer, corners that slide as they land bounce, bodies that
# carry a thousand times their weight creep, and a blow takes several steps to pass a row of balls.
SWEEPS = 12
# Error at which sweeps end, and slip at which friction reaches its limit where points slide, as a
# fraction of the speed that gravity adds per step and substep, or of the largest one. With more,
# what rests creeps, and rows of balls lose energy; with less, rounding shows, and sweeps are more.
TOLERANCE = 1e-4


class ContactRows:
    """Contacts of a step as rows of velocity constraints, for M manifolds at once.

    A manifold has seven rows, each with a speed and an impulse λ: the normal speeds u of its four
    points, and the three on which friction acts, at the centre of the points: the speeds along t1
    and t2, and the spin about n. With the arms r from the two COMs to the point or centre, and its
    axis e,

        u = e · v2 + (r2 × e) · ω2 - e · v1 - (r1 × e) · ω1,        spin = n · ω2 - n · ω1

    are the rows of u = J v. Impulses λ change the velocities by M⁻¹ Jᵀ λ.

    With split masses, the rows of a manifold respond to its own impulses by A = J S M⁻¹ Jᵀ, 7 × 7,
    where S = max(N/ω, 1) for a body with N manifolds, and ω is RELAXATION.

    J acts on the bodies' relative linear and own angular velocities. From substep to substep, the
    arms turn with their bodies. Otherwise, a body that rolls would rise along the tangent of its
    circle, and lose energy as it falls back.

    ends : (2, M), columns of `Motion`; isPoint : (4, M), 1 or 0
    places : (12 M,), where the forces on the two bodies, and the torques, are added up
    J : (9, 7, M), transposed: e, -r1 × e and r2 × e
    limits : (2, 4, M), of friction and of the twist about n, per normal impulse
    levers : (4, 4, M), of each point 1, -y, x and x² + y² with its coordinates x along t1 and y
        along t2 from the centre, so that it slips by t1 and t2 plus spin times -y and x
    spread : (M,), mean of x² + y² over the points
    applied : (9, M), Jᵀ λ of all impulses so far, each with the arms that it was applied with
    mass : (4, M), of each point alone
    K[k] : (4, M), response of all points' speeds to the impulse of point k, times their masses
    shared : (4, M), minus the mass of all points together; mutual : (4, M), response of the
        other points' speeds to a unit impulse at each of them, times minus the point's mass
    normal, friction : (4, 4, M), (3, 3, M), A of the points, and of the friction rows alone
    slip : (3, 7, M), impulses along the friction rows that stop the slip due to changes of the
        normal impulses, and then, by A⁻¹ of `friction`, the slip that there is
    leastSlip : (M,), see `let_slide`; sliding : (K,), manifolds whose points slide
    """

    def __init__(self, motion, masses, geometry, turning):
        """geometry : `ends`, `isPoint`, `J`, `limits`, `levers`, `spread`

        masses : see `split_masses`
        turning : (6, 6, M), change of the arms in J in a substep
        """
        self.ends, self.isPoint, self.J, self.limits, self.levers, self.spread = geometry
        self.turning, self.applied = turning, np.zeros_like(self.J[:, 0])
        self.leastSlip = np.zeros_like(self.spread)
        axes = len(motion.invMass) * np.arange(6).reshape(2, 1, 3, 1)
        self.places = (self.ends[:, None] + axes).reshape(12, -1)
        self.weigh(masses)

    def weigh(self, masses):
        """Takes over the masses with which bodies respond, see `split_masses`."""
        A, isSpun = self._responses(masses), self.limits[1].any(axis=0)
        self.normal, self.friction = A[:POINTS, :POINTS], A[POINTS:, POINTS:]
        self.friction[(0, 1, 2, 2), (2, 2, 0, 1)] *= isSpun  # a single point resists no spin
        mass = inverted(self.friction)
        ofNormals = np.einsum("ikm,kjm->ijm", mass, A[POINTS:, :POINTS])
        self.slip = np.concatenate((ofNormals, mass), axis=1)
        self.slip[2] *= isSpun
        self._prepare()

    def _prepare(self):
        """Sets what sweeps need of the points and of the slip that they have."""
        isPoint, diagonal = self.isPoint, self.normal.diagonal().T
        self.mass = isPoint / np.where(diagonal > 0.0, diagonal, 1.0)
        self.K = self.mass * self.normal
        total = np.einsum("jm,jkm,km->m", isPoint, self.normal, isPoint)
        self.shared = isPoint / -np.where(total > 0.0, total, 1.0)
        self.mutual = isPoint - np.einsum("jm,jkm->km", isPoint, self.K)
        self.let_slide(self.leastSlip)

    def _responses(self, masses):
        """A (7, 7, M), symmetric; masses : see `split_masses`"""
        invInertia, moments = masses[1:].reshape(3, 3, 2, -1), self.J[3:]
        angular, A = np.empty_like(moments), np.empty((7, 7, len(moments[0, 0])))
        for k in range(6):  # three times as fast as all in one sum
            end, i = divmod(k, 3)
            own = moments[3 * end : 3 * end + 3]
            np.einsum("jm,jrm->rm", invInertia[i, :, end], own, out=angular[k])
        for row in range(7):
            A[: row + 1, row] = np.einsum("im,irm->rm", moments[:, row], angular[:, : row + 1])
            A[row, :row] = A[:row, row]
        for row in (slice(0, POINTS), 4, 5):
            A[row, row] += masses[0].sum(axis=0)
        return A

    def let_slide(self, leastSlip):
        """Lets friction act at the points of the manifolds with a leastSlip (M,) > 0, m/s, to which
        their slip counts; in others, it is that of points that stick.
        """
        self.leastSlip, self.sliding = leastSlip, indices(leastSlip)
        given = leastSlip, self.spread, self.levers, self.limits, self.friction
        given = *given, self.slip[:, POINTS:]
        self._ofSliding = [take(x, self.sliding, -1) for x in given]

    def turn(self, substeps=1.0):
        """Turns the arms with their bodies."""
        self.J[3:, :6] += self.turning if substeps == 1.0 else substeps * self.turning

    def speeds(self, motion):
        """Speeds (7, M) of the rows; those of the points are > 0 if separating."""
        v = take(motion.velocity, self.places)
        v[3:6] -= v[:3]
        return np.einsum("irm,im->rm", self.J, v[3:])

    def apply(self, motion, impulse):
        """Applies impulses (7, M) to the bodies."""
        wrench = np.einsum("irm,rm->im", self.J, impulse)
        self.applied += wrench
        self.push(motion, wrench)

    def push(self, motion, wrench):
        """Applies forces, and torques on the first and the second bodies, (9, M), times seconds."""
        parts, total = np.concatenate((-wrench[:3], wrench)), np.zeros((6, len(motion.invMass)))
        np.add.at(total.reshape(-1), self.places.ravel(), parts.ravel())  # faster than `bincount`
        motion.velocity[:3] += motion.invMass * total[:3]
        inertia = motion.invInertia.reshape(3, 3, -1)
        motion.velocity[3:] += np.einsum("ijn,jn->in", inertia, total[3:])

    def solved(self, before, speed, bias, softness=None, most=None):
        """Returns the impulses (7, M) after one sweep: λ ← s (λ - m (u + bias)), λ ≥ 0.

        before, speed : (7, M), impulses, and the speeds of the rows with them; bias : (4, M)
        softness, most : (4, M), s, and the most by which it lowers λ; None in the relaxing sweep

        The points of a manifold are visited in order, as in the Gauss-Seidel method, and then
        friction. Alternating the order would make tall stacks sway. In the relaxing sweep, all
        points first share the impulse that would stop their mean speed, if it pushes: otherwise,
        the point visited first takes most of a blow, and a box that lands flat tilts. In the soft
        sweep, sliding manifolds keep their friction, which would exceed the limit of the points.
        """
        isSoft, normal, friction = softness is not None, before[:POINTS], before[POINTS:]
        pressed = self._pressed(normal, speed[:POINTS] + bias, softness, most)
        change = np.concatenate((pressed - normal, speed[POINTS:]))
        sticking = friction - np.einsum("irm,rm->im", self.slip, change)
        if isSoft:
            np.copyto(sticking, friction, where=self.leastSlip > 0.0)
        friction = self._limited(pressed, sticking)
        if not isSoft and len(self.sliding):
            given = pressed, friction, sticking, speed[POINTS:]
            given = (take(x, self.sliding, -1) for x in given)
            friction[:, self.sliding] = self._sliding(*given)
        return np.concatenate((pressed, friction))

    def _pressed(self, before, error, softness, most):
        """Normal impulses (4, M); error : (4, M), u + bias"""
        impulse, more = before - self.mass * error, np.empty_like(before)
        if softness is None:
            common = self.isPoint * np.maximum(np.einsum("km,km->m", self.shared, error), 0.0)
            impulse += self.mutual * common
            before = before + common
        for k, wanted in enumerate(impulse):
            if k > 0:  # points that have been visited
                wanted -= np.einsum("jm,jm->m", self.K[:k, k], more[:k])
            if softness is not None:
                np.maximum(softness[k] * wanted, wanted - most[k], out=wanted)
            np.maximum(wanted, 0.0, out=wanted)
            np.subtract(wanted, before[k], out=more[k])
        return impulse

    def _limited(self, pressed, friction):
        """Friction (3, M) within Coulomb's limits; pressed : (4, M), normal impulses"""
        limit, size = coulomb_limits(self.limits, pressed, friction)
        return friction * take(limit / np.maximum(np.maximum(size, limit), TINY), (0, 0, 1), axis=0)

    def _sliding(self, pressed, friction, sticking, speed):
        """Friction (3, K) of the manifolds whose points slide, each point's against its slip.

        pressed : (4, K); friction : (3, K), of points that stick; speed : (3, K)
        sticking : (3, K), f*, impulses that would stop the slip w = A (f - f*) of the rows

        Some slide if, about, (S/L)² + (T/M)² > 1 for the friction S and the twist T of f*, with the
        limits L of S alone and M of T alone: f* is to be divided by the root, `size`.

        A point that slips by u = B w receives f = -μ λ u/|u|. With c = μ λ/|u| for an estimate of
        |u| and C = Σ Bᵀ c B, f = -C w, and thus -w = (A⁻¹ + C)⁻¹ f*. A point that would then slip
        faster than estimated receives no more than μ λ. The estimate is the slip with f = f*/size,
        scaled down to the measured slip of all points: with that of each, spins oscillate, and
        without it, cubes creep under 1000 times their mass.
        """
        leastSlip, spread, levers, limits, response, mass = self._ofSliding

        def slip(w):
            """Slip speeds (4, K) of the points; w : (3, K), speeds of the friction rows."""
            u = levers[1:3] * w[2]
            u += w[:2, None]
            u *= u
            return np.sqrt(u[0] + u[1])

        def resistance(c):
            """C (3, 3, K), for c (4, K)."""
            one, y, x, square = np.einsum("ikm,km->im", levers, c)
            zero = np.zeros_like(one)
            return np.array(((one, zero, y), (zero, one, x), (y, x, square)))

        limit, size = coulomb_limits(limits, pressed, sticking)
        size /= np.maximum(limit, TINY)
        size, limit = np.sqrt(np.add.reduce(size * size)), limits[0] * pressed
        scaled = np.einsum("ijm,jm->im", response, sticking * (1.0 / np.maximum(size, 1.0) - 1.0))
        ratio = mean_squares(speed, spread) / np.maximum(mean_squares(scaled, spread), TINY)
        estimate = np.maximum(slip(scaled * np.sqrt(np.minimum(ratio, 1.0))), leastSlip)
        mass = inverted(mass + resistance(limit / estimate))
        w = np.einsum("ijm,jm->im", mass, sticking)
        limit /= np.maximum(estimate, slip(w))
        sliding = np.einsum("ijm,jm->im", resistance(limit), w)
        return np.where(size > 1.0, sliding, friction)


class PartRows(ContactRows):
    """Rows of K of M manifolds, which are solved until they converge, while others stay.

    some : (K,), these; island : (K,), theirs
    Their responses are those of the M rows: for masses split among all, and arms as they were then.
    """

    SHARED = "ends", "places", "J", "limits", "levers", "spread", "normal", "friction", "slip"

    def __init__(self, rows, isPart, isActive, motion, leastSlip):
        """rows : `ContactRows` of all; isPart : (M,); isActive : (4, M), points that may change
        leastSlip : (M,), see `let_slide`
        """
        self.some = indices(isPart)
        for name in self.SHARED:
            setattr(self, name, take(getattr(rows, name), self.some, -1))
        given = 1.0 * isActive, leastSlip, np.zeros_like(rows.applied)
        self.isPoint, self.leastSlip, self.applied = (take(x, self.some, -1) for x in given)
        self.island = islands_of(self.ends, motion.invMass)
        self._prepare()

    def converged(self, motion, impulse, tolerance, *terms, sweeps=SWEEPS):
        """Applies impulses to the bodies by up to `sweeps` sweeps; returns those (7, M) of all.

        impulse : (7, M), before; tolerance : (M,), m/s, error at which sweeps end
        terms : (4, M), bias and so on, see `solved`

        Each is followed by a step of the nonsmooth nonlinear conjugate gradient method, in each
        island (Silcowitz, Niebe, Erleben: A Nonsmooth Nonlinear Conjugate Gradient Method for
        Interactive Contact Force Problems. The Visual Computer, 2010).
        """
        result, given = impulse.copy(), (impulse, tolerance, *terms)
        impulse, tolerance, *terms = (take(x, self.some, -1) for x in given)
        way, before = np.zeros_like(impulse), np.zeros(len(motion.invMass))
        for _ in range(sweeps):
            solved = self.solved(impulse, self.speeds(motion), *terms)
            change = solved - impulse
            size = np.bincount(self.island, np.add.reduce(change[:6] * change[:6]), len(before))
            share = np.where(size < before, size / np.maximum(before, TINY), 0.0)[self.island]
            solved += share * way
            np.maximum(solved[:POINTS], 0.0, out=solved[:POINTS])
            solved[POINTS:] = self._limited(solved[:POINTS], solved[POINTS:])
            way, before = share * way + change, size
            self.apply(motion, solved - impulse)
            impulse = solved
            if (np.abs(change[:POINTS]) <= tolerance * self.mass).all():
                break
        result[:, self.some] = impulse
        return result


def contact_rows(placed, masses, frames, motion, mu):
    """Returns the `ContactRows` of `SoftContacts`; masses : see `split_masses`"""
    ends, isPoint, n = placed.ends, 1.0 * placed.isPoint, placed.normal
    weight = isPoint / np.maximum(np.add.reduce(isPoint), 1.0)
    middle = np.add.reduce(weight * placed.arm, axis=1)
    arm = placed.arm - middle[:, None]
    x, y = dot(arm, placed.tangent1[:, None]), dot(arm, placed.tangent2[:, None])
    levers = np.array((np.ones_like(x), -y, x, x * x + y * y))
    limits = mu * isPoint * np.sqrt(levers[::3])

    # the centre lies midway between the points of the two bodies, which are `gap` apart
    centre = (middle + 0.5 * np.add.reduce(weight * placed.gap) * n)[:, None].repeat(2, axis=1)
    arms = [np.concatenate((placed.arm, centre), axis=1)]
    arms.append(np.concatenate((placed.arm + placed.gap * n[:, None], centre), axis=1))
    arms[1] -= (take(frames.position, placed.second, axis=1) - placed.start1)[:, None]
    axes = n[:, None] * isPoint, placed.tangent1[:, None], placed.tangent2[:, None]
    axes, turn = np.concatenate(axes, axis=1), turn_matrix(motion.timeStep * motion.begin[3:])
    rate = (np.stack(turn) - np.eye(3).reshape(9, 1)) * (placed.h / motion.timeStep)
    J, turning = np.zeros((3, 3, 7, placed.count)), np.empty((2, 3, 6, placed.count))
    J[0, :, :6] = axes
    for k, sign in enumerate((-1.0, 1.0)):
        own = sign * arms[k]
        J[k + 1, :, :6], J[k + 1, :, 6] = triples.cross(own, axes), sign * n
        turning[k] = triples.cross(mat_vec(take(rate, ends[k], 1)[:, None], own), axes)
    spread = np.add.reduce(weight * levers[3])
    geometry = ends, isPoint, J.reshape(9, 7, -1), limits, levers, spread
    return ContactRows(motion, masses, geometry, turning.reshape(6, 6, -1))


def coulomb_limits(limits, pressed, friction):
    """`(limit, size)`, (2, M) each, of friction (3, M) and its twist: at most μ Σ λ, and that times
    the lever arm. limits : see `ContactRows`; pressed : (4, M), λ
    """
    size = friction * friction
    size[0] += size[1]
    return np.einsum("ikm,km->im", limits, pressed), np.sqrt(size[::2])


def mean_squares(speed, spread):
    """Mean squares (M,) of the slip of points; speed : (3, M), of the friction rows"""
    along, across, spin = speed * speed
    return along + across + spread * spin


def split_masses(placed, ends, inverse, motion):
    """Inverse masses and inertias (10, 2, M) of the parts of bodies in each of their manifolds.

    placed : `SoftContacts`; ends : (2, N), bodies of all manifolds, also between sleepers
    inverse : (10, n + 1), of whole bodies

    What sleeps takes part in springs as if it were awake, but is not lighter than what touches it.
    Otherwise, springs on it would be stiffer, and jam what is between.
    """
    count = np.bincount(ends.ravel(), minlength=inverse.shape[1])
    parts = take(inverse * np.maximum(count / RELAXATION, 1.0), ends[:, placed.rows], axis=1)
    most = np.minimum(parts[0, ::-1] / np.maximum(parts[0], TINY), 1.0)
    return parts * np.where(motion.invMass[placed.ends] == 0.0, most, 1.0)


def islands_of(ends, invMass):
    """Returns the island (M,) of each of the `ends` (2, M) of contacts; invMass : (m + 1,)"""
    isMovable = invMass > 0.0
    return islands(ends, isMovable[:-1])[np.where(isMovable[ends[0]], *ends)]


def reached(isSource, speed, mass, links, least):
    """Which bodies (n,) may share the momentum, or the force, of some. The fewer do, the more each
    gets.

    isSource, speed : (n,), bodies that have some, and their velocity or acceleration
    mass : (n,), 0 if fixed; links : (2, L), bodies, in which n is fixed
    least : (n,) or a number, the least that counts

    The momentum of bodies passes on to those linked to them, and to those linked to these, as long
    as all that share it would move together at `least`. What moves together strikes together:
    linked bodies that have some add theirs.
    """
    least, isSource = np.broadcast_to(least, mass.shape), isSource & (mass > 0.0)
    if not isSource.any():
        return isSource
    links = links[:, (np.append(mass, 0.0)[links] > 0.0).all(axis=0)]
    source = np.where(isSource, islands(links, isSource), -1)
    both = mass * speed, mass
    momentum, total = (np.bincount(source[isSource], x[isSource], len(mass)) for x in both)
    first, second = np.concatenate((links, links[::-1]), axis=1)
    while True:
        some = indices((source[first] >= 0) & (source[second] < 0))
        some = some[np.lexsort((momentum[source[first[some]]], second[some]))]
        some = some[np.diff(second[some], append=-1) != 0]  # of several, the greatest
        body, origin = second[some], source[first[some]]
        share = total + np.bincount(origin, mass[body], len(mass))
        isReached = momentum[origin] >= least[body] * share[origin]
        if not isReached.any():
            return source >= 0
        body, origin = body[isReached], origin[isReached]
        total += np.bincount(origin, mass[body], len(mass))
        source[body] = origin


def inverted(matrix):
    """Returns the inverses of symmetric matrices (3, 3, M); zero where there is none."""
    result, determinant = triples.adjugate(matrix.reshape(9, -1))
    return np.reshape(result, matrix.shape) / np.where(determinant > 0.0, determinant, np.inf)
