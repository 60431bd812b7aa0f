"""Contact manifolds in world axes, and their report."""

import numpy as np

from rbs.geometry.vectors import cross, dot, mat_vec, take
from rbs.softstep.manifolds import POINTS
from rbs.stepping.reports import GROUND, ContactColumns

# Columns (3, 2, 1): the normal from a body towards the ground, and the first tangent of friction.
GROUND_AXES = np.array([[0.0, 1.0], [-1.0, 0.0], [0.0, 0.0]])[:, :, None]


class PlacedManifolds:
    """Geometry of manifolds `rows` (M,), ascending, in world axes.

    first, second : (M,), bodies; the ground is body n, but GROUND in `other`
    t : (3, M), see `Frames.translations`; normal, tangent1, tangent2 : (3, M), unit
    arm : (3, 4, M), from the first COM to the points on the first body
    gap : (4, M), separation at the start of the step, along the normal
    """

    def __init__(self, manifolds, frames, rows):
        self.rows, self.count = rows, len(rows)
        manifolds = manifolds if len(rows) == len(manifolds.key) else manifolds.rows(rows)
        self.key, (self.first, self.second) = manifolds.key, manifolds.bodies(frames.count)
        self.start1 = take(frames.position, self.first, axis=1)
        self.t = frames.translations(self.first, self.second)
        self.isPoint = manifolds.isPoint
        axes = manifolds.normal[:, None], manifolds.tangent[:, None]
        vectors = np.concatenate((*axes, manifolds.anchor1), axis=1)
        turned = mat_vec(take(frames.rotation, self.first, axis=1)[:, None], vectors)
        isOnGround = self.second == frames.count
        self.other = np.where(isOnGround, GROUND, self.second)
        axes = np.where(isOnGround, GROUND_AXES, turned[:, :2])
        self.normal, self.tangent1, self.arm = axes[:, 0], axes[:, 1], turned[:, 2:]
        self.tangent2 = cross(self.normal, self.tangent1)
        across = mat_vec(take(frames.rotation, self.second, axis=1)[:, None], manifolds.anchor2)
        self.gap = dot(across + self.t[:, None] - self.arm, self.normal[:, None])

    def heights(self):
        """Heights (2, M) of the deepest points on the first and on the second body, from its COM
        towards the other body: of the planes that they support it with.
        """
        gap = np.where(self.isPoint, self.gap, np.inf)
        deepest = gap.argmin(axis=0), np.arange(self.count)
        height = dot(self.arm, self.normal[:, None])[deepest]
        return np.array((height, dot(self.t, self.normal) - height - gap[deepest]))

    def reported(self, total):
        """`ContactColumns` of every point that touches or received an impulse, at the start of the
        step.

        total : (7, M), impulses of the rows, see `SoftContacts`

        A manifold's friction is divided in proportion to the normal impulses of its points.
        """
        impulse, load = total[:POINTS], np.add.reduce(total[:POINTS])
        k, m = ((impulse > 0.0) | (self.isPoint & (self.gap <= 0.0))).nonzero()
        share = total[POINTS:] / np.where(load > 0.0, load, 1.0)
        friction = take(self.tangent1 * share[0] + self.tangent2 * share[1], m, axis=1)
        impulse, arm = impulse[k, m], self.arm[:, k, m]
        depth, point = np.maximum(-self.gap[k, m], 0.0), take(self.start1, m, axis=1) + arm
        bodies = (take(x, m) for x in (self.key, self.first, self.other))
        normal, friction = take(self.normal, m, axis=1), friction * impulse
        return ContactColumns(*bodies, depth, normal, point, impulse, friction, arm)
