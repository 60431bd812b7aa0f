"""Distance constraints of the soft step: bounds on the distance between two points.

They are solved together, as a chain pulls at once along its whole length. Impulses keep distances
as they are in a substep, also where points turn about each other, and thus keep the energy. What a
distance is off its bound is pushed out at a velocity that moves bodies and is dropped: it gives
none.
"""

from functools import lru_cache

import numpy as np
from scipy.linalg.lapack import dpbsv
from scipy.sparse import csgraph, csr_array

from rbs.geometry.vectors import cross, indices, mat_vec, norm, take
from rbs.softstep.contacts import SLEEP_SECONDS
from rbs.softstep.manifolds import ROUNDING
from rbs.softstep.rows import SWEEPS, TOLERANCE, inverted
from rbs.stepping.constraints import ConstraintRows
from rbs.stepping.flight import turn_matrix
from rbs.stepping.kernels import distance_error

# Softness of what pushes distances to their bounds, as a part of each one's own response: where
# infeasible constraints push against each other, bodies move across them by their error over it.
# With less, such bodies tremble, and from errors of this part of the length on, they would be
# thrown; with more, the heavy end of a chain is drawn up more slowly, and the chain gives way.
SOFTNESS = 0.1


class SoftConstraints:
    """R pairs of points with a bounded distance L, lower ≤ L ≤ upper, of which K can move.

    With d the unit vector of p1 - p2, the distance changes by

        u = d · (v1 + ω1 × r1 - v2 - ω2 × r2) = J v,   J = [d, r1 × d, -d, -(r2 × d)].

    An impulse λ along d on the first body, and against it on the second, enforces the bounds. It
    pulls, λ ≤ 0, at the upper bound and pushes, λ ≥ 0, at the lower one. The bound counts that is
    nearer or more violated. If the bounds coincide, λ may have either sign. Impulses λ change the
    speeds by A λ = J M⁻¹ Jᵀ λ. Rows are scaled, so that A is 1 on its diagonal.

    key : (6, R), body, vertex, body, vertex, lower, upper
    impulse : (R,), of a substep; some : (K,), rows that can move; all that follows is of these
    columns : (2, K), of `Motion`; scale : (K,), by which rows are multiplied
    rows, sides : (2, P), pairs of rows that share a body that moves, and on which side of each
    """

    def __init__(self, key, frames, motion, kept, h, ratio):
        """kept : `SolverState`; h, ratio : as for `SoftContacts`"""
        ends, vertices = (key[k:4:2].astype(np.intp) for k in (0, 1))
        self.impulse = np.zeros(len(key[0]))
        if np.array_equal(key, kept.constraint):
            self.impulse = ratio * kept.constraintImpulse
        columns = take(motion.column, ends)
        self.some = indices((motion.invMass[columns] > 0.0).any(axis=0))
        self.count, self.visits, self.h = len(self.some), 0, h
        self.columns = take(columns, self.some, 1)
        if self.count == 0:
            return
        ends, vertices = take(ends, self.some, 1), take(vertices, self.some, 1)
        self.lower, self.upper = take(key[4:], self.some, 1)
        self.isRigid = self.lower >= self.upper
        self._flat = self.columns.ravel()
        self._arms = frames.bodies.arms(ends, vertices).reshape(3, -1)
        self._centres = take(frames.position, ends.ravel(), axis=1)
        self._reach, radius = norm(self._arms).reshape(2, -1), frames.sizes(*ends)[1]
        # no faster than the smaller body falls by its radius, as contacts
        self.pushSpeed = np.maximum(np.sqrt(motion.fallRate * radius), radius / SLEEP_SECONDS)
        moves = motion.invMass[self._flat] > 0.0
        self.rows, self.sides, self._order = _paired(self._flat.tobytes(), moves.tobytes())
        self._free, self._pull = motion.invInertia.copy(), np.zeros(self.count)
        self._last = np.abs(self.impulse[self.some])
        self._update(motion, self._last)

    def _update(self, motion, impulse):
        """Updates distances, bounds, Jacobians and responses to the present poses, and after
        `impulse` (K,), inertias, see `_stiffen`."""
        self._stiffen(motion, impulse)
        point, arm = self._points(motion.shift, motion.turn)
        self.length, d = distance_error(*point, 0.0)
        d = np.concatenate((d, -d), axis=1)
        rCrossD = cross(arm, d)
        angular = mat_vec(take(motion.invInertia, self._flat, axis=1), rCrossD)
        self.J = np.concatenate((d, rCrossD))
        self.MJ = np.concatenate((take(motion.invMass, self._flat) * d, angular))
        (i, j), (p, q) = self.rows, self.sides
        A = np.add.reduce(take(self.J, p, 1) * take(self.MJ, q, 1))
        self.scale = 1.0 / np.sqrt(np.bincount(i[i == j], A[i == j], self.count))
        self.A = A * take(self.scale, i) * take(self.scale, j)
        isUpper = self.length - self.upper >= self.lower - self.length
        self.C = self.length - np.where(isUpper, self.upper, self.lower)
        self.isSlack = np.where(isUpper, self.C < 0.0, self.C > 0.0) & ~self.isRigid
        self.lowest = np.where(isUpper | self.isRigid, -np.inf, 0.0)
        self.highest = np.where(isUpper & ~self.isRigid, 0.0, np.inf)

    def _points(self, shift, turn):
        """`((3, K), (3, K))`, both points after displacements of the bodies, and (3, 2 K), arms."""
        arm = mat_vec(np.stack(turn_matrix(take(turn, self._flat, axis=1))), self._arms)
        point = self._centres + take(shift, self._flat, axis=1) + arm
        return (point[:, : self.count], point[:, self.count :]), arm

    def _stiffen(self, motion, impulse):
        """Adds to the inertia of light bodies that strong pulls would turn to and fro too fast.

        A pull P at the arm r is a torsion spring of the stiffness P r. With the inertia P r h², the
        body turns by one radian of its swing in a substep, which is stable (Andrews, Teichmann,
        Kövecses: Geometric Stiffness for Real-time Constrained Multibody Dynamics. Computer
        Graphics Forum, 2017). Contacts have the same inertia. The largest pull of a step counts
        that lasts for two substeps, as those of blows do not.
        """
        before, self._last = self._last, np.abs(impulse)
        self._pull = np.maximum(self._pull, np.minimum(self._last, before))
        pull = self._pull * self.h * self._reach
        swing = np.bincount(self._flat, pull.ravel(), len(motion.invMass))
        inverse = self._free.reshape(3, 3, -1)
        some = indices(swing * inverse.trace() > 1.0)
        if len(some):
            inverse = inverse[..., some]
            more = np.eye(3)[..., None] * (swing[some] - 1.0 / inverse.trace())
            motion.invInertia[:, some] = inverted(inverted(inverse) + more).reshape(9, -1)

    def infeasible(self):
        """Columns of `Motion` (2, I) that constraints join which cannot be satisfied: those that
        are violated by more than pushing can mend, see SOFTNESS."""
        if self.count == 0:
            return self.columns
        lever = np.maximum(self.length, self._reach.max(axis=0))
        return self.columns[:, ~self.isSlack & (np.abs(self.C) > SOFTNESS * lever)]

    def pull(self, motion):
        """Keeps distances as they are, or within their bounds, in the motion that follows, and adds
        the velocity that pushes them to the bounds.

        A point that turns about another gets away from it along the tangent of its circle. The
        impulse makes up for this, and thus acts as the force in the middle of the substep.
        """
        v, h, isNear = motion.velocity, self.h, self.impulse[self.some] != 0.0
        (first, second), _ = self._points(motion.shift + h * v[:3], motion.turn + h * v[3:])
        change = norm(first - second) - self.length + np.where(self.isSlack, self.C, 0.0)
        self._scaled = self._solve(motion, np.zeros(self.count), change / h, isNear)
        speed = np.clip(self.C / h, -self.pushSpeed, self.pushSpeed) * self.scale
        isOff = ~self.isSlack & (np.abs(self.C) > TOLERANCE * self.length)
        self._pushed = self._changes(motion, self._answer(isOff, speed, SOFTNESS))
        motion.velocity += self._pushed

    def relax(self, motion):
        """Drops the velocity that has pushed, and stops what still violates the bounds."""
        motion.velocity -= self._pushed
        self._update(motion, self._scaled * self.scale)
        old = self._scaled
        error = self._speeds(motion.velocity) + np.where(self.isSlack, self.C / self.h, 0.0)
        self._scaled = self._solve(motion, old, error, old != 0.0)
        self.impulse[self.some] = self._scaled * self.scale

    def _solve(self, motion, old, error, isActive):
        """Changes velocities so that no speed exceeds its bound; returns the scaled impulses (K,).

        old : (K,), scaled impulses so far; error : (K,), by how much speeds exceed their bounds
        isActive : (K,), rows that are tried first

        Rows are solved together as equations. Those whose impulse would have the wrong sign leave,
        and those whose bound would be exceeded join in, until there are none.
        """
        error = error * self.scale
        least = TOLERANCE * np.abs(error).max()
        isActive = isActive | self.isRigid | (np.clip(-error, self.lowest, self.highest) != 0.0)
        error += ROUNDING * old  # of several solutions, about the least
        for _ in range(SWEEPS):
            known = np.where(isActive, 0.0, -old)
            change = known + self._answer(isActive, error + self._response(known), ROUNDING)
            wanted = np.clip(old + change, self.lowest, self.highest)
            left = np.clip(-error - self._response(change), self.lowest, self.highest)
            isWrong, isMissing = wanted != old + change, ~isActive & (np.abs(left) > least)
            if not (isWrong | isMissing).any():
                break
            isActive = (isActive & ~isWrong) | isMissing
        motion.velocity += self._changes(motion, wanted - old)
        return wanted

    def _answer(self, isActive, speed, softness):
        """Scaled impulses (K,) of active rows that stop the speeds (K,): (A + softness) λ = -u"""
        order = self._order[isActive[self._order]]
        answer, count = np.zeros(self.count), len(order)
        if count == 0:
            return answer
        place = np.empty(self.count, dtype=np.intp)
        place[order] = np.arange(count)
        some = indices(isActive[self.rows].all(axis=0))
        i, j = place[take(self.rows, some, 1)]
        width = int((i - j).max()) + 1
        band = np.bincount((i - j) * count + j, self.A[some], width * count).reshape(width, count)
        band[0] += softness
        answer[order] = dpbsv(band, -speed[order], lower=True)[1]
        self.visits += count
        return answer

    def _speeds(self, velocity):
        """Speeds (K,) at which distances change: J v"""
        return (self.J * take(velocity, self._flat, 1)).reshape(6, 2, -1).sum(axis=(0, 1))

    def _response(self, impulse):
        """Speeds (K,) of rows with scaled impulses (K,): A λ"""
        i, j = self.rows
        speed = np.bincount(i, self.A * impulse[j], self.count)
        return speed + np.bincount(j, self.A * impulse[i], self.count) - impulse

    def _changes(self, motion, impulse):
        """Changes (6, m + 1) of velocities by scaled impulses (K,): M⁻¹ Jᵀ λ"""
        change, count = self.MJ * np.tile(impulse * self.scale, 2), len(motion.invMass)
        places = self._flat + count * np.arange(6)[:, None]
        return np.bincount(places.ravel(), change.ravel(), 6 * count).reshape(6, count)


@lru_cache(maxsize=8)
def _paired(columns, moves):
    """`(rows, sides, order)`: those of `SoftConstraints`, and an order (K,) in which rows are near
    each other that share a body. From the bytes of the flat columns, and of which of them move.
    """
    columns, moves = np.frombuffer(columns, dtype=np.intp), np.frombuffer(moves, dtype=bool)
    count, ends = len(columns) // 2, indices(moves)
    body = csr_array((np.ones(len(ends)), (ends, columns[ends])), (2 * count, columns.max() + 1))
    sides = np.array((body @ body.T).nonzero()).astype(np.intp)
    i, j = sides % count
    order = csgraph.reverse_cuthill_mckee(
        csr_array((np.ones(len(i)), (i, j)), (count, count)), True
    )
    place = order.argsort()
    some = indices(place[i] >= place[j])
    return (sides % count)[:, some], sides[:, some], order


def changed_ends(key, before):
    """Bodies (K,) of constraints that only one of two `SoftConstraints.key`s has."""
    if np.array_equal(key, before):
        return np.zeros(0, dtype=np.intp)
    columns, count = np.unique(np.concatenate((key, before), axis=1), axis=1, return_counts=True)
    return columns[0:4:2, count == 1].ravel().astype(np.intp)


def bounds(constraints, bodies):
    """Returns `SoftConstraints.key` of the constraints of `run_timestep`; bodies : `Bodies`.

    Constraints of the same two points become one column.
    """
    if len(constraints) == 0:
        return np.zeros((6, 0))
    rows = ConstraintRows(constraints, bodies.meshes, 0.0)
    points, first, row = np.unique(rows.ends, axis=1, return_index=True, return_inverse=True)
    lower, upper = np.full(len(first), -np.inf), np.full(len(first), np.inf)
    row = row.ravel()
    np.minimum.at(upper, row[rows.upper], rows.refValue[rows.upper])
    np.maximum.at(lower, row[~rows.upper], rows.refValue[~rows.upper])
    order = first.argsort()  # in the scene's order, so that chains are visited from end to end
    return np.concatenate((points, [lower], [upper])).astype(float)[:, order]
