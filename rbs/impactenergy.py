"""The energy that restitution may give back: no more than the contacts have taken in the step.

Newton's law of restitution lets two points part with e times the speed that they met with. Where
several pairs meet in one step, this can ask for more energy than there was: Stronge: Rigid body
collisions with friction. Proceedings of the Royal Society A, 1990. So of what restitution changes
in the velocities of an island, of bodies that touch or that constraints hold together, it keeps a
share: the largest with which its energy is no higher than at the start of the step. As the share is
the same for a whole island, momentum is kept.
"""

import numpy as np

from Quaternion import rotation_matrices
from rbs.bodies import GRAVITY
from rbs.islands import islands
from rbs.vectors import rotate_tensor


class ImpactEnergy:
    """What the energy of n bodies may be at the end of a step.

    mass : (n,); inertia : (n, 3, 3), world axes, at the end of the step; both 0 of what stays still
    limit : (n,), the kinetic energy that each has at the end if it loses none
    """

    def __init__(self, bodies, isStill, shift, orientation):
        """bodies : `Bodies`, at the start of the step; isStill : (n,) bool, fixed or asleep
        shift : (n, 3), how far each has moved in the step; orientation : (4, n), at its end
        """
        self.isStill = isStill
        self.mass = np.where(isStill, 0.0, 1.0 / np.where(isStill, 1.0, bodies.invMass))
        start, inertia = bodies.velocity.T, self._inertia(bodies.invInertia)
        self.limit = 0.5 * self._products(inertia, start, start)
        self.limit += self.mass * GRAVITY * shift[:, 1]
        rotation = np.stack(rotation_matrices(orientation))
        self.inertia = self._inertia(np.stack(rotate_tensor(rotation, bodies.restInvInertia)))

    def share(self, before, after, links):
        """The part (n,) of the change of velocities that the energy allows.

        before, after : (n, 6), without and with restitution
        links : (2, L), bodies that touch or are held together; the ground is body n
        """
        island = islands(links, ~self.isStill)
        # the energy is that before plus b s + a s²
        change = after - before
        a = np.bincount(island, 0.5 * self._products(self.inertia, change, change))
        b = np.bincount(island, self._products(self.inertia, before, change))
        kinetic = 0.5 * self._products(self.inertia, before, before)
        left = np.bincount(island, self.limit - kinetic)
        root = np.sqrt(np.maximum(b * b + 4.0 * a * left, 0.0))
        share = np.where(a + b > left, (root - b) / np.where(a > 0.0, 2.0 * a, 1.0), 1.0)
        return np.clip(share, 0.0, 1.0)[island]

    def _inertia(self, invInertia):
        """The tensors (n, 3, 3) of inverse ones (9, n)."""
        matrices = np.where(self.isStill, np.eye(3).reshape(9, 1), invInertia).T.reshape(-1, 3, 3)
        return np.where(self.isStill[:, None, None], 0.0, np.linalg.inv(matrices))

    def _products(self, inertia, v, w):
        """vᵀ M w (n,) of velocities (n, 6)."""
        turning = (inertia @ w[:, 3:, None])[:, :, 0]
        return self.mass * (v[:, :3] * w[:, :3]).sum(axis=1) + (v[:, 3:] * turning).sum(axis=1)
