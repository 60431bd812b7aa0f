"""Distance constraints of the soft-step solver: each a soft bound on the speed of two points.

They are visited one batch after the other, no two of a batch moving the same body, before the
contacts of the same sweep. Arms and directions are those of the substep: frozen ones let a net gain
energy.
"""

import math

import numpy as np

from rbs.arrays import take
from rbs.constraints import ConstraintRows, distance_error
from rbs.schedules import coloured_batches
from rbs.vectors import cross, dot, mat_vec

# Of the substeps' frequency, and the damping ratio: stiffer than contacts, since a mechanism that
# gives way looks wrong.
FREQUENCY = 0.25
DAMPING = 2.0
# Passes over all joints in a sweep: a pull passes through a net by one body a pass.
PASSES = 4


class SoftConstraints:
    """C distance constraints: `|p1 - p2| ≤ refValue` where upper, else ≥.

    With d the unit vector of p1 - p2, the speed u = d · (v1 + ω1 × r1 - v2 - ω2 × r2) changes the
    distance, and an impulse λ along d on the first body and against it on the second bounds it:
    λ ≤ 0 for an upper bound, which pulls, λ ≥ 0 for a lower one.
    """

    def __init__(self, constraints, bodies, kept):
        rows = ConstraintRows(constraints, bodies.isFixed, bodies.vertexCount, 0.0)
        self.rows = rows
        self.count = len(rows.index)
        self.body1, self.body2, self.sign = rows.body1, rows.body2, np.where(rows.upper, -1.0, 1.0)
        self.key = np.stack(
            (rows.body1, rows.vertex1, rows.body2, rows.vertex2, rows.refValue, rows.upper)
        ).astype(float)
        isKnown = np.array_equal(self.key, kept.tie)
        self.impulse = kept.tieImpulse.copy() if isKnown else np.zeros(self.count)
        self.isFixed = bodies.isFixed
        self.visits = 0
        self._arms = tuple(
            take(bodies.vertices, bodies.vertexStart[body] + vertex, axis=1)
            for body, vertex in ((rows.body1, rows.vertex1), (rows.body2, rows.vertex2))
        )

    def links(self):
        """The bodies (2, C) that are tied."""
        return np.stack((self.body1, self.body2))

    def store(self, kept):
        kept.tie, kept.tieImpulse = self.key, self.impulse

    def begin(self, motion, isStill, frames, h):
        self.h = h
        self.position = frames.position
        angle = 2.0 * math.pi * FREQUENCY
        a1 = 2.0 * DAMPING + angle
        a2 = angle * a1
        self.biasRate = angle / (h * a1)
        self.massScale, self.impulseScale = a2 / (1.0 + a2), 1.0 / (1.0 + a2)
        isStill = isStill[:-1]
        self.batches = []
        for batch in coloured_batches(self.body1, self.body2, self.isFixed):
            moves = ~(isStill[self.body1[batch]] & isStill[self.body2[batch]])
            if moves.any():
                self.batches.append(batch[moves])

    def _renew(self, motion):
        """Arms, directions, masses and errors, where the bodies are now."""
        arms = []
        points = []
        for body, arm in zip((self.body1, self.body2), self._arms, strict=True):
            arm = _rotated(motion.turn[body].T, arm)
            arms.append(arm)
            points.append(take(self.position, body, axis=1) + motion.shift[body].T + arm)
        self.C, d = distance_error(*points, self.rows.refValue)
        self.d = d
        self.levers, self.turning = [], []
        K = np.zeros(self.count)
        for body, arm in zip((self.body1, self.body2), arms, strict=True):
            lever = cross(arm, d)
            turning = mat_vec(take(motion.invInertia, body, axis=1), lever)
            K = K + take(motion.invMass, body) + dot(lever, turning)
            self.levers.append(lever)
            self.turning.append(turning)
        self.mass = np.where(K > 0.0, 1.0 / np.where(K > 0.0, K, 1.0), 0.0)

    def _apply(self, motion, batch, impulse):
        for body, turning, sign in (
            (self.body1, self.turning[0], 1.0), (self.body2, self.turning[1], -1.0)
        ):  # fmt: skip
            b = body[batch]
            push = sign * impulse
            motion.velocity[b, :3] += (push * motion.invMass[b] * self.d[:, batch]).T
            motion.velocity[b, 3:] += (push * turning[:, batch]).T

    def warm_start(self, motion):
        if not self.batches:
            return
        self._renew(motion)
        for batch in self.batches:
            self._apply(motion, batch, self.impulse[batch])

    def sweep(self, motion, isSoft):
        """Passes over all joints; in the soft sweep, the errors are pulled out."""
        if not self.batches:
            return
        if not isSoft:
            self._renew(motion)
        # > 0 where the bound leaves room
        room = self.sign * self.C
        isSlack = room > 0.0
        bias = np.where(isSlack, self.C / self.h, self.biasRate * self.C if isSoft else 0.0)
        scale = np.where(isSlack | (not isSoft), 1.0, self.massScale)
        memory = np.where(isSlack | (not isSoft), 1.0, 1.0 - self.impulseScale)
        for _ in range(PASSES):
            for batch in self.batches:
                self._visit(motion, batch, bias, scale, memory)
                self.visits += len(batch)

    def _visit(self, motion, batch, bias, scale, memory):
        d = self.d[:, batch]
        speed = np.zeros(len(batch))
        for body, lever, sign in (
            (self.body1, self.levers[0], 1.0), (self.body2, self.levers[1], -1.0)
        ):  # fmt: skip
            velocity = motion.velocity[body[batch]].T
            speed = speed + sign * (dot(d, velocity[:3]) + dot(lever[:, batch], velocity[3:]))
        old = self.impulse[batch]
        change = scale[batch] * self.mass[batch] * (speed + bias[batch])
        impulse = old * memory[batch] - change
        sign = self.sign[batch]
        impulse = sign * np.maximum(sign * impulse, 0.0)
        self.impulse[batch] = impulse
        self._apply(motion, batch, impulse - old)


def _rotated(angle, v):
    """Vectors (3, m) turned by rotation vectors (3, m): Rodrigues' formula."""
    length = np.sqrt(dot(angle, angle))
    safe = np.where(length > 0.0, length, 1.0)
    axis = angle / safe
    c, s = np.cos(length), np.sin(length)
    return v * c + cross(axis, v) * s + axis * (dot(axis, v) * (1.0 - c))
