"""Distance constraints of the soft step, solved together: a pull acts along a whole chain at once.

Impulses keep distances as they are in a substep, also while points circle each other, and thus
conserve the energy. Distance errors are pushed out by a pseudo-velocity, which moves bodies and is
then dropped, so that it adds none.
"""

from copy import copy
from functools import lru_cache

import numpy as np
from scipy.linalg.lapack import dpbtrf, dpbtrs
from scipy.sparse import csgraph, csr_array

from Quaternion import multiply
from rbs.geometry.vectors import cross, dot, indices, mat_vec, norm, take
from rbs.softstep.contacts import push_speeds
from rbs.softstep.manifolds import ROUNDING, TINY
from rbs.softstep.rows import SWEEPS, TOLERANCE, inverted
from rbs.stepping.constraints import ConstraintRows
from rbs.stepping.flight import quaternions, rotated, rotation_vectors
from rbs.stepping.kernels import distance_error

# Softness of pushes, and of infeasible constraints, as a fraction of each one's own response: where
# they push against each other, bodies move across them by the error over the softness. With less,
# they tremble; with more, the heavy end of a chain is drawn up more slowly, and it gives way.
SOFTNESS = 0.1
# Greatest length of a joint, as a fraction of the lesser radius. With less, pulls turn short bars
# by radians in a substep, which takes energy; with more, the directions that joints keep show.
JOINT = 0.01


class SoftConstraints:
    """R pairs of points with a bounded distance L, lower ≤ L ≤ upper, with K equations.

    With d the unit vector of p1 - p2, the distance changes by

        u = d · (v1 + ω1 × r1 - v2 - ω2 × r2) = J v,   J = [d, r1 × d, -d, -(r2 × d)].

    An impulse λ along d on the first body, and against it on the second, enforces the bounds. It
    pulls, λ ≤ 0, at the upper bound and pushes, λ ≥ 0, at the lower one, whichever is nearer or
    more violated. If no distance is between them, λ may have either sign. Impulses λ change the
    speeds by A λ = J M⁻¹ Jᵀ λ.

    Where L can only be about 0, d is undefined, or turns by radians in a substep. Such a pair is a
    ball joint: in a step, it keeps the vector p1 - p2, by three equations along fixed axes d.

    key : (6, R), body, vertex, body, vertex, lower, upper
    impulse : (4, R), the greatest of a substep, before or after relaxing, inf before the first one,
        the greatest that has lasted for two, which gives links the mass that they keep if the time
        step changes, and the speeds with which the lower and upper bounds have changed
    movable : (K,), the pair of each equation, of those that can move; all that follows is of these
    share : (K,), 1, and a third in joints; pulls : (K,), impulses of the present substep
    visits : number of rows of all systems of equations that the step has factored
    columns : (2, K), of `Motion`; response : (K,), diagonal of A, on average over a pair
    length, lever : (K,), L, or the part along d, and what errors are compared with; isOff : (K,)
    C, gap : (K,), L minus its bound if violated, and if not, or else 0
    rate : (K,), speed with which this bound changes
    isInfeasible : (K,), those of islands in which some bounds cannot be met
    ends, rows : (2, P), pairs of ends (2 K,) on one moving body, and the equations that have them
    """

    def __init__(self, key, impulse, frames, motion, h, ratio):
        """impulse : as `carried` returns it; h, ratio : as for `SoftContacts`"""
        bodies, vertices = (key[k:4:2].astype(np.intp) for k in (0, 1))
        # the force, and the masses of links, stay
        rates = impulse[4:] / motion.timeStep
        self.impulse = np.concatenate(([ratio * impulse[0], impulse[1] / ratio], rates))
        # only speeds that last for two steps: what jumps is pushed
        rates = rates.clip(*np.sort((impulse[2:4], np.zeros_like(rates)), axis=0))
        columns, radius = take(motion.column, bodies), frames.sizes(*bodies)[1]
        isJoint = key[4:].max(axis=0) <= JOINT * radius
        parts = np.where(isJoint, 3, 1) * (motion.invMass[columns] > 0.0).any(axis=0)
        some = self.movable = np.arange(len(parts)).repeat(parts)
        self.count, self.visits, self.h, self._left = len(some), 0, h, motion.timeStep
        self.columns, self.share, self.isJoint = columns[:, some], 1.0 / parts[some], isJoint[some]
        self._rates, self.rate = rates[:, some] * ~self.isJoint, np.zeros(self.count)
        self.isInfeasible = np.zeros(self.count, dtype=bool)
        if self.count == 0:
            return
        bodies, vertices, bounds = bodies[:, some], vertices[:, some], key[4:, some]
        self._column, arms = self.columns.ravel(), frames.bodies.arms(bodies, vertices)
        self._arms, self._centres = arms.reshape(3, -1), frames.position[:, bodies.ravel()]
        self._axes = np.eye(3)[:, np.arange(self.count) - some.searchsorted(some)]
        self._rotation = quaternions(motion.turn)
        way = self._way(motion.shift, self._arms)
        length = norm(way)
        along = length.clip(*bounds) / np.maximum(length, TINY) * dot(self._axes, way)
        self._bounds = np.where(self.isJoint, along, bounds)
        self._reach, self.pushSpeed = norm(arms), push_speeds(motion, radius[some])
        self._places = (self._column + len(motion.invMass) * np.arange(6)[:, None]).ravel()
        isMoving = motion.invMass[self._column] > 0.0
        given = self._column.tobytes(), isMoving.tobytes()
        self.ends, self.rows, self._order, self._island, self._tied = _paired(*given)
        # the first pull counts as one that lasts, or light links would fly off
        self._last, lasting = self.impulse[:2, some]
        self.pulls = np.where(self._last < np.inf, self._last, 0.0)
        if ratio > 1.0:  # links must bear the pull of a longer substep at once
            lasting = np.maximum(lasting, self.pulls)
        self._free, self._lasting = motion.inverse.copy(), np.zeros(self.count)
        self._update(motion, lasting)
        trial = copy(self)
        self.isInfeasible, self.visits = trial.infeasible(motion), trial.visits

    def _update(self, motion, pull):
        """Updates distances, bounds, J, and responses for the present poses, and masses and
        inertias for a `pull` (K,) that has lasted for two substeps.
        """
        rotation = take(self._rotation, self._column, 1)
        self._arm = rotated(rotation, self._arms)
        way = self._way(motion.shift, self._arm)
        self._axis = np.where(self.isJoint, self._axes, distance_error(way, 0.0, 0.0)[1])
        self.length = dot(self._axis, way)
        self.lever = np.maximum(self.length, self._reach.max(axis=0))
        if (pull > self._lasting).any():
            self._lasting = np.maximum(pull, self._lasting)
            self._stiffen(motion)
        d = np.concatenate((self._axis, -self._axis), axis=1)
        rCrossD = cross(self._arm, d)
        inverse = take(motion.invInertia, self._column, axis=1)
        if motion.drift is not None:  # velocities stand for momenta, as inertias were at the start
            rotation = np.eye(4)[:, :1]
        back = rotation * np.array([[1.0], [-1.0], [-1.0], [-1.0]])
        angular = rotated(rotation, mat_vec(inverse, rotated(back, rCrossD)))
        self.J = np.concatenate((d, rCrossD))
        self.MJ = np.concatenate((take(motion.invMass, self._column) * d, angular))
        diagonal = np.add.reduce(self.J * self.MJ).reshape(2, -1).sum(axis=0)
        self.response = self._summed(self.share * diagonal)
        self.A = np.add.reduce(take(self.J, self.ends[0], 1) * take(self.MJ, self.ends[1], 1))
        self._factors = {}
        lower, upper = self._bounds - self._left * self._rates
        isUpper = self.length - upper >= lower - self.length
        bound, self.rate = np.where(isUpper, (upper, self._rates[1]), (lower, self._rates[0]))
        self.lowest = np.where(bound >= upper, -np.inf, 0.0)
        self.highest = np.where(bound <= lower, np.inf, 0.0)
        self.C = self.length - bound
        self.gap = self.C + (-self.C).clip(self.lowest, self.highest)
        self.C -= self.gap
        self.isOff = np.abs(self.C) > TOLERANCE * self.lever

    def _summed(self, x):
        """Sums (K,) over the equations of each pair."""
        return np.bincount(self.movable, x)[self.movable] if self.isJoint.any() else x

    def _way(self, shift, arm):
        """Vectors p1 - p2 (3, K) after bodies were displaced; arm : (3, 2 K)"""
        point = self._centres + take(shift, self._column, axis=1) + arm
        return point[:, : self.count] - point[:, self.count :]

    def _move(self, motion, change):
        """Displaces bodies; change : (6, m + 1), their turn comes after those so far.

        What constraints pull turns about other axes in each substep, so that rotation vectors do
        not add up.
        """
        self._rotation = np.array(multiply(quaternions(change[3:]), self._rotation))
        motion.displacement += change
        motion.turn[:, self._tied] = rotation_vectors(take(self._rotation, self._tied, 1))

    def _stiffen(self, motion):
        """Adds to the masses and inertias of light bodies that strong pulls would move too fast.

        A pull P along the length L is a spring of the stiffness k = P/L across it, and at the arm r
        a torsion spring of (P + k r) r. With such masses, k h², and inertias, bodies swing by one
        radian in a substep, which is stable (Andrews, Teichmann, Kövecses: Geometric Stiffness for
        Real-time Constrained Multibody Dynamics. Computer Graphics Forum, 2017). Masses that fall
        again with the pull would drive the swing: the largest one counts that has ever lasted for
        two substeps, unlike a blow's.
        """
        r, pull = self._reach, self.h * self.share * self._lasting
        spring = pull / np.maximum(self.length, r)
        both, count = (spring, (pull + spring * r) * r), len(motion.invMass)
        across, turning = (np.bincount(self._column, x.ravel(), count) for x in both)
        mass, inertia = self._free[0], self._free[1:].reshape(3, 3, -1)
        motion.invMass[:] = np.minimum(mass, 1.0 / np.maximum(across, TINY))
        some = indices(turning * inertia.trace() > 1.0)
        if len(some):
            inertia = inertia[..., some]
            more = np.eye(3)[..., None] * (turning[some] - 1.0 / inertia.trace())
            motion.invInertia[:, some] = inverted(inverted(inertia) + more).reshape(9, -1)

    def infeasible(self, motion):
        """`isInfeasible`: with supports and bounds as they are when the step ends, Newton's method
        leaves errors, and more than half of their sum over the island. The constraints are left at
        the poses at which it ended.
        """
        ahead = motion.timeStep * motion.rates() * (motion.invMass == 0.0)
        begin, self._left = motion.displacement.copy(), 0.0
        if ahead.any() or self._rates.any():
            self._move(motion, ahead)
            self._update(motion, self._lasting)
        most = 0.5 * np.bincount(self._island, np.abs(self.C))
        for _ in range(SWEEPS):
            if not self.isOff.any():
                break
            answer = self._answer(self.gap == 0.0, self.C, ROUNDING)
            self._move(motion, self._changes(motion, answer))
            self._update(motion, self._lasting)
        isOver = np.bincount(self._island, np.abs(self.C)) > most
        motion.displacement[:] = begin
        return self._greatest(self.isOff) & isOver[self._island]

    def pull(self, motion):
        """Keeps distances as they are, or within their bounds, in the motion that follows: as the
        force in the middle of the substep, which also keeps points on the circles on which they
        turn. Solves again while that halves the errors, as where links turn fast.
        Adds, and returns, the pseudo-velocity (6, m + 1) that pushes them to their bounds.
        """
        h, isNear = self.h, np.abs(self.gap) <= TOLERANCE * self.length
        isPulling = self.pulls != 0.0
        self.pulls, error, mayChange = np.zeros(self.count), self._predicted(motion), True
        for _ in range(SWEEPS):
            self._solve(motion, error / h, isPulling, isNear, mayChange)
            isPulling, before = self.pulls != 0.0, self._most(error)
            if (before <= TOLERANCE).all():  # so is what is left
                break
            error = self._predicted(motion)
            most = self._most(error)
            mayChange = mayChange & (most > TOLERANCE) & (most < 0.5 * before)
            if not mayChange.any():
                break
        speed = (self.C / h).clip(-self.pushSpeed, self.pushSpeed)
        pushed = self._changes(motion, self._answer(self.isOff, speed, SOFTNESS))
        motion.velocity += pushed
        return pushed

    def _most(self, error):
        """Largest errors (K,) of what pulls in each island, as fractions of levers."""
        return self._greatest((self.pulls != 0.0) * np.abs(error) / self.lever)

    def _greatest(self, x):
        """Greatest x (K,) in the island of each equation."""
        most = np.zeros_like(x)
        np.maximum.at(most, self._island, x)
        return take(most, self._island)

    def _predicted(self, motion):
        """Errors (K,) at the end of the substep, along the directions d at its start: to the circle
        of the distance or, from a gap, of the bound.
        """
        change = self.h * motion.rates()
        arm = rotated(take(quaternions(change[3:]), self._column, 1), self._arm)
        way, bound = self._way(motion.shift + change[:3], arm), self.length - self.gap
        size, along = norm(way), dot(self._axis, way)
        excess = size * size - bound * bound
        root = along + np.sqrt(np.maximum(along * along - excess, 0.0))
        error = excess / np.maximum(np.maximum(root, size), TINY)
        return np.where(self.isJoint, along - bound, error) - self.h * self.rate

    def relax(self, motion, pushed):
        """Moves bodies, drops the pseudo-velocity of `pull`, and stops what violates the bounds."""
        self._move(motion, self.h * motion.rates())
        motion.velocity -= pushed
        self._left -= self.h
        size = np.sqrt(self._summed(self.pulls**2))
        self._update(motion, np.minimum(self._last, size))
        error = self._speeds(motion.rates()) + self.gap / self.h - self.rate
        self._solve(motion, error, self.pulls != 0.0)
        self._last = np.maximum(size, np.sqrt(self._summed(self.pulls**2)))
        self.impulse[:2, self.movable] = self._last, self._lasting

    def _solve(self, motion, error, isActive, isNear=False, mayChange=True):
        """Changes pulls and velocities so that no speed exceeds its bound.

        error : (K,), by how much speeds exceed their bounds
        isActive, isNear : (K,), constraints that are tried first, and once one is missing: a whole
            chain begins to pull at once
        mayChange : (K,), of islands whose pulls may change; others keep theirs

        Active constraints are equations. Those whose impulse would have the wrong sign leave, and
        those whose bound would be exceeded join in, until there are none.
        """
        least = np.where(mayChange, TOLERANCE * self._greatest(np.abs(error)), np.inf)
        isActive = isActive | ((-error).clip(self.lowest, self.highest) == -error)
        before = self._changes(motion, self.pulls)
        free = error - self._speeds(before)
        for _ in range(SWEEPS):
            answer = self._answer(isActive, free)
            wanted, isMissing = answer.clip(self.lowest, self.highest), ~isActive
            wanted = np.where(mayChange, wanted, self.pulls)
            isWrong = self.response * np.abs(wanted - answer) > least
            change = self._changes(motion, wanted)
            if isMissing.any():
                left = -free - self._speeds(change)
                isMissing &= np.abs(left.clip(self.lowest, self.highest)) > least
            if not (isWrong | isMissing).any():
                break
            isActive = (isActive & ~isWrong) | isMissing | (isNear & self._greatest(isMissing))
            isNear = False
        motion.velocity += change - before
        self.pulls = wanted

    def _answer(self, isActive, speed, softness=None):
        """Impulses (K,) of active rows that stop speeds u (K,): (A + softness diag A) λ = -u

        softness : a number; None stands for the constraints' own, by whether they are infeasible
        """
        order = self._order[isActive[self._order]]
        answer, count = np.zeros(self.count), len(order)
        if count == 0:
            return answer
        key = isActive.tobytes(), softness
        if key not in self._factors:
            place = np.empty(self.count, dtype=np.intp)
            place[order] = np.arange(count)
            some = indices(isActive[self.rows].all(axis=0))
            i, j = place[take(self.rows, some, 1)]
            width, place = int((i - j).max()) + 1, (i - j) * count + j
            band = np.bincount(place, self.A[some], width * count).reshape(width, count)
            if softness is None:
                softness = np.where(self.isInfeasible[order], SOFTNESS, ROUNDING)
            added, info, scale = softness * self.response[order], 1, 1.0
            while info and scale < np.inf:  # indefinite by rounding, as of a needle
                band[0] += scale * added
                self._factors[key], info = dpbtrf(band, lower=True)
                scale *= 10.0
            self.visits += count
        answer[order], _ = dpbtrs(self._factors[key], -speed[order], lower=True)
        return answer

    def _speeds(self, velocity):
        """Speeds (K,) at which distances change, with velocities (6, m + 1): J v"""
        return (self.J * take(velocity, self._column, 1)).reshape(12, -1).sum(axis=0)

    def _changes(self, motion, impulse):
        """Changes (6, m + 1) of velocities by impulses (K,): M⁻¹ Jᵀ λ"""
        count = len(motion.invMass)
        if not impulse.any():
            return np.zeros((6, count))
        change = self.MJ.reshape(6, 2, -1) * impulse
        return np.bincount(self._places, change.ravel(), 6 * count).reshape(6, count)


@lru_cache(maxsize=8)
def _paired(columns, isMoving):
    """`(ends, rows, order, island, bodies)`: those of `SoftConstraints`; an order (K,) in which
    constraints are near each other that share a body; the island (K,) of each; and the columns that
    they join. From the bytes of the columns of all ends, and which move.
    """
    columns, isMoving = np.frombuffer(columns, np.intp), np.frombuffer(isMoving, bool)
    count, end = len(columns) // 2, indices(isMoving)
    bodies, which = np.unique(columns, return_inverse=True)
    body = csr_array((np.ones(len(end)), (end, which[end])), (2 * count, len(bodies)))
    ends = np.array((body @ body.T).nonzero()).astype(np.intp)
    rows = ends % count
    shared = csr_array((np.ones(len(rows[0])), tuple(rows)), (count, count))
    order = csgraph.reverse_cuthill_mckee(shared, True)
    place = order.argsort()[rows]
    some = indices(place[0] >= place[1])
    island = csgraph.connected_components(shared, directed=False)[1].astype(np.intp)
    return take(ends, some, 1), take(rows, some, 1), order, island, bodies


def pair_numbers(ends):
    """A number (K,) for each pair of points (4, K), the same for the same pairs."""
    points = ends[0::2] * (ends[1::2].max(initial=0) + 1) + ends[1::2]
    which = np.unique(points, return_inverse=True)[1].reshape(2, -1)
    return which[0] * points.size + which[1]


def carried(key, before, impulse):
    """`(impulse (6, R), bodies (K,))`: `SoftConstraints.impulse` of constraints that join the same
    points, by how much their bounds have changed, and bodies whose constraints have been added,
    removed or changed.

    key, before : `SoftConstraints.key` of this step and of the last; impulse : of the last step
    """
    if np.array_equal(key, before):
        return np.concatenate((impulse[:4], np.zeros_like(key[4:]))), np.zeros(0, dtype=np.intp)
    count, both = len(key[0]), np.concatenate((key, before), axis=1)
    points = np.split(pair_numbers(both[:4].astype(np.intp)), [count])
    _, now, last = np.intersect1d(*points, return_indices=True)
    kept, ends = np.zeros((6, count)), (key[4:, now], before[4:, last])
    kept[0] = np.inf
    change = np.subtract(*ends, where=np.not_equal(*ends), out=np.zeros_like(ends[0]))
    kept[:, now] = np.concatenate((impulse[:4, last], change))
    isSame = (key[:, now] == before[:, last]).all(axis=0)
    others = np.delete(both, np.concatenate((now[isSame], count + last[isSame])), axis=1)
    return kept, others[0:4:2].ravel().astype(np.intp)


def constraint_keys(constraints, bodies):
    """Returns `SoftConstraints.key` of the constraints of `run_timestep`; bodies : `Bodies`.

    Constraints of the same two points become one column, in the order of the first of them.
    """
    if len(constraints) == 0:
        return np.zeros((6, 0))
    rows = ConstraintRows(constraints, bodies.meshes, 0.0)
    points = pair_numbers(rows.ends)
    _, first, row = np.unique(points, return_index=True, return_inverse=True)
    lower, upper = np.full(len(first), -np.inf), np.full(len(first), np.inf)
    np.minimum.at(upper, row[rows.upper], rows.refValue[rows.upper])
    np.maximum.at(lower, row[~rows.upper], rows.refValue[~rows.upper])
    return np.concatenate((rows.ends[:, first], [lower], [upper])).astype(float)[:, first.argsort()]
