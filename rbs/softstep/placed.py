"""Contact manifolds in world axes, and their report."""

import numpy as np

from rbs.geometry.vectors import cross, dot, take
from rbs.softstep.manifolds import POINTS, turn_points
from rbs.stepping.reports import GROUND

# Columns (3, 2, 1): the normal from a body towards the ground, and the first tangent of friction.
GROUND_AXES = np.array([[0.0, 1.0], [-1.0, 0.0], [0.0, 0.0]])[:, :, None]


class PlacedManifolds:
    """Geometry of manifolds `rows` (M,) in world axes.

    first, second : (M,), bodies; the ground is body n
    t : (3, M), see `Frames.translations`; normal, tangent1, tangent2 : (3, M), unit
    arm : (3, 4, M), from the first COM to the points on the first body
    gap : (4, M), separation at the start of the step, along the normal
    """

    def __init__(self, manifolds, frames, rows):
        self.rows, self.count, self.bodyCount = rows, len(rows), frames.count
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

    def point_speeds(self, frames):
        """Speeds (4, M) of points of the first body, and of the second one, towards the other."""
        arms, speeds = (self.arm, self.arm - self.t[:, None]), []
        for end, arm, sign in zip((self.first, self.second), arms, (1.0, -1.0), strict=True):
            v, w = take(frames.velocity, end, 1).reshape(2, 3, 1, -1)
            velocity = v + cross(np.broadcast_to(w, arm.shape), arm)
            speeds.append(sign * dot(self.normal[:, None], velocity))
        return speeds

    def reported(self, total):
        """Columns, as for `StepReport.add_columns`, of every point that touches or received an
        impulse, at the start of the step.

        total : (7, M), impulses of the rows, see `SoftContacts`

        A manifold's friction is divided in proportion to the normal impulses of its points.
        """
        impulse, friction = total[:POINTS], total[POINTS:]
        k, m = np.nonzero((impulse > 0.0) | (self.isPoint & (self.gap <= 0.0)))
        total = np.add.reduce(impulse)
        share = friction[:2] / np.where(total > 0.0, total, 1.0)
        friction = self.tangent1 * share[0] + self.tangent2 * share[1]
        impulse = impulse[k, m]
        return self.columns(k, m, impulse, friction[:, m] * impulse)

    def columns(self, k, m, impulse, friction):
        """Columns of the points k of the rows m; impulse, friction : (Q,), (3, Q)"""
        first, second, arm = self.first[m], self.second[m], self.arm[:, k, m]
        rank = first * (self.bodyCount + 1) + second
        other = np.where(second == self.bodyCount, GROUND, second)
        depth, point = np.maximum(-self.gap[k, m], 0.0), self.start1[:, m] + arm
        return rank, first, other, depth, self.normal[:, m], point, impulse, friction, arm
