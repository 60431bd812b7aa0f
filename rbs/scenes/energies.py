"""Energies and momenta of a state. Units: metres, kilograms, seconds."""

import math

import numpy as np

from Quaternion import QConj, QRotate
from RBSFunctions import refresh_vertices


class Energies:
    """The measures of a `Scene`."""

    def _free(self, name, *shape):
        """Returns an attribute of all m free bodies, (m, *shape)."""
        values = [getattr(mesh, name) for mesh in self.meshes if not mesh.isFixed]
        return np.array(values, dtype=np.float64).reshape(-1, *shape)

    def _spin(self):
        """Returns ω and I ω of the free bodies in body axes, (m, 3) each. I is IT."""
        spin = QRotate(QConj(self._free("orientation", 4)), self._free("angVelocity", 3))
        return spin, np.einsum("mij,mj->mi", self._free("IT", 3, 3), spin)

    def kinetic_energy(self) -> float:
        """Returns the kinetic energy of all free bodies, in J: ½ m v² + ½ ωᵀ I ω."""
        v, (spin, spinMomentum) = self._free("linVelocity", 3), self._spin()
        return float(
            0.5 * np.sum(self._free("mass", 1) * v * v) + 0.5 * np.sum(spin * spinMomentum)
        )

    def momentum(self) -> np.ndarray:
        """Returns the momentum (3,) of all free bodies, in kg m/s: m v."""
        return np.sum(self._free("mass", 1) * self._free("linVelocity", 3), axis=0)

    def angular_momentum(self) -> np.ndarray:
        """Returns Σ m r × v + R I Rᵀ ω (3,) of all free bodies, about the origin, in kg m²/s."""
        r, p = self._free("position", 3), self._free("mass", 1) * self._free("linVelocity", 3)
        spin = QRotate(self._free("orientation", 4), self._spin()[1])
        return np.sum(np.cross(r, p) + spin, axis=0)

    def potential_energy(self) -> float:
        """Returns the potential energy of all free bodies, zero at the origin, in J: −m g · r."""
        height = self._free("position", 3) @ np.array(self.settings.acceleration)
        return float(-np.sum(self._free("mass", 1) * height[:, None]))

    def largest_violation(self) -> float:
        """Returns the largest violation of a constraint, in m; 0 if none is violated."""
        if self.constraints:
            refresh_vertices(self.meshes)
        largest = 0.0
        for m1, v1, m2, v2, refValue, upper in self.constraints:
            distance = math.dist(self.meshes[m1].currVertices[v1], self.meshes[m2].currVertices[v2])
            largest = max(largest, distance - refValue if upper else refValue - distance)
        return largest
