"""Distance constraints of the soft step: soft bounds on the distance between two points.

A sweep visits them before the contacts, in batches in which no two share a movable body. Arms and
directions are updated every substep, because constant ones let a net gain energy.
"""

import numpy as np

from rbs.geometry.vectors import cross, dot, indices, mat_vec, norm, take
from rbs.softstep.contacts import SLEEP_SECONDS
from rbs.softstep.manifolds import TINY
from rbs.softstep.rows import MOST_SWEEPS, TOLERANCE, inverted, spring
from rbs.stepping.constraints import ConstraintRows, coloured_batches
from rbs.stepping.flight import turn_matrix
from rbs.stepping.kernels import distance_error

# Natural frequency of the springs, as a fraction of the substep frequency. With a higher one, a
# heavy weight on a chain shakes; with a lower one, a net gives way visibly.
FREQUENCY = 0.5
# Damping ratio. With more, a net gives way visibly; with less, down to critical, a heavy weight on
# a chain never comes to rest.
DAMPING = 2.0
# Passes over all constraints per sweep. More cost time. A pull travels by one body per pass, so
# with one, a chain with a load of 100 times its links gains energy as it swings.
PASSES = 4


class SoftConstraints:
    """R pairs of points with a bounded distance L: lower ≤ L ≤ upper.

    With d the unit vector of p1 - p2, the distance changes by

        u = d · (v1 + ω1 × r1 - v2 - ω2 × r2) = J v,   J = [d, r1 × d, -d, -(r2 × d)].

    An impulse λ along d on the first body, and against it on the second, enforces the bounds. It
    pulls, λ ≤ 0, at the upper bound and pushes, λ ≥ 0, at the lower one. A sweep considers the
    bound that is nearer or more violated. If the bounds coincide, λ may have either sign.

    key : (6, R), body, vertex, body, vertex, lower, upper
    columns : (2, R), of `Motion`; batches : list of constraints (K,) that can move, and columns
    """

    def __init__(self, key, frames, motion, kept, h, ratio):
        """kept : `SolverState`; h, ratio : as for `SoftContacts`"""
        self.ends, vertices = (key[k:4:2].astype(np.intp) for k in (0, 1))
        self.lower, self.upper = key[4:]
        self.isRigid, self.count, self.visits = self.lower >= self.upper, len(key[0]), 0
        self.impulse = np.zeros(self.count)
        if np.array_equal(key, kept.constraint):
            self.impulse = ratio * kept.constraintImpulse
        (self.rate, self.softness), self.h = spring(FREQUENCY, DAMPING, h), h
        self.fallRate = motion.fallRate
        self.passes = PASSES if ratio == 1.0 else MOST_SWEEPS
        self._arms = frames.bodies.arms(self.ends, vertices).reshape(3, -1)
        self.position, self.columns = frames.position, take(motion.column, self.ends)
        self._stiffen(motion, h)
        moves, self.batches = (self.columns < len(motion.moving)).any(axis=0), []
        for batch in coloured_batches(*np.ascontiguousarray(self.ends), frames.bodies.isFixed):
            batch = batch[moves[batch]]
            if len(batch):
                self.batches.append((batch, self.columns[:, batch]))

    def _stiffen(self, motion, h):
        """Adds to the inertia of light bodies that strong pulls would turn to and fro too fast.

        A pull P at the arm r is a torsion spring of the stiffness P r. With the inertia P r h², the
        body turns by one radian of its swing in a substep, which is stable (Andrews, Teichmann,
        Kövecses: Geometric Stiffness for Real-time Constrained Multibody Dynamics. Computer
        Graphics Forum, 2017). Contacts have the same inertia.
        """
        pull = np.abs(self.impulse) * h * norm(self._arms).reshape(2, -1)
        swing = np.bincount(self.columns.ravel(), pull.ravel(), len(motion.invMass))
        inverse = motion.invInertia.reshape(3, 3, -1)
        some = indices(swing * inverse.trace() > 1.0)
        if len(some):
            inverse = inverse[..., some]
            more = np.eye(3)[..., None] * (swing[some] - 1.0 / inverse.trace())
            motion.invInertia[:, some] = inverted(inverted(inverse) + more).reshape(9, -1)

    def _renew(self, motion):
        """Updates distances, Jacobians and effective masses to the present poses."""
        ends, columns = self.ends.ravel(), self.columns.ravel()
        turn = turn_matrix(take(motion.turn, columns, axis=1))
        arm = mat_vec(np.stack(turn), self._arms)
        point = take(self.position, ends, axis=1) + take(motion.shift, columns, axis=1) + arm
        count = self.count
        self.length, d = distance_error(point[:, :count], point[:, count:], 0.0)
        d = np.concatenate((d, -d), axis=1)
        rCrossD = cross(arm, d)
        angular = mat_vec(take(motion.invInertia, columns, axis=1), rCrossD)
        invMass = take(motion.invMass, columns)
        K = (invMass + dot(rCrossD, angular)).reshape(2, count).sum(axis=0)
        self.mass = 1.0 / np.where(K > 0.0, K, np.inf)
        self.J = np.concatenate((d, rCrossD)).reshape(6, 2, count)
        self.MJ = np.concatenate((invMass * d, angular)).reshape(6, 2, count)

    def strained(self):
        """Columns of `Motion` (2, S), (2, K) that constraints join whose springs push faster than
        bodies fall, and of these, such as cannot be satisfied.

        A spring pulls by C ω² per mass, and thus across the distance L by C ω²/L. If two that pull
        against each other do so by 4/h² or more, explicit integration does not bear it. Loads
        stretch feasible ones by less.
        """
        if not self.batches:
            return self.columns[:, :0], self.columns[:, :0]
        error = np.maximum(self.length - self.upper, self.lower - self.length)
        lever = np.maximum(self.length, norm(self._arms).reshape(2, -1).max(axis=0))
        fall = np.maximum(np.sqrt(self.fallRate * lever), lever / SLEEP_SECONDS)
        bounds = fall / self.rate, 0.5 * lever / (np.pi * FREQUENCY) ** 2
        return tuple(self.columns[:, error > bound] for bound in bounds)

    def sweep(self, motion, isSoft):
        """Passes over all constraints; the soft sweep starts with the impulses of the last substep,
        and corrects violations with springs.
        """
        self._renew(motion)
        for batch, ends in self.batches if isSoft else ():
            motion.velocity[:, ends] += self.MJ[..., batch] * self.impulse[batch]
        isUpper = self.length - self.upper >= self.lower - self.length
        C = self.length - np.where(isUpper, self.upper, self.lower)
        isSlack = np.where(isUpper, C < 0.0, C > 0.0) & ~self.isRigid
        bias = np.where(isSlack, C / self.h, self.rate * C if isSoft else 0.0)
        softness = np.where(isSlack | (not isSoft), 1.0, self.softness)
        lowest = np.where(isUpper | self.isRigid, -np.inf, 0.0)
        highest = np.where(isUpper & ~self.isRigid, 0.0, np.inf)
        columns = bias, self.mass, softness, lowest, highest
        rows = [
            (batch, ends, self.J[..., batch], self.MJ[..., batch], *(c[batch] for c in columns))
            for batch, ends in self.batches
        ]
        for _ in range(PASSES if isSoft else self.passes):
            largest = 0.0
            for batch, ends, J, MJ, bias, mass, softness, lowest, highest in rows:
                old = self.impulse[batch]
                speed = (J * motion.velocity[:, ends]).sum(axis=(0, 1))
                impulse = np.clip(softness * (old - mass * (speed + bias)), lowest, highest)
                self.impulse[batch] = impulse
                motion.velocity[:, ends] += MJ * (impulse - old)
                self.visits += len(batch)
                if self.passes > PASSES:
                    largest = max(largest, np.abs((impulse - old) / np.maximum(mass, TINY)).max())
            if self.passes > PASSES and largest <= TOLERANCE * np.abs(motion.velocity).max():
                break


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
