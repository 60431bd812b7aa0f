"""A scene in some state: what a simulation and a replay of a recording have in common.

From the top: the four arrays that a state consists of; `Scene`, which gets and sets
the state of its bodies and measures it.

Units: metres, kilograms, seconds.
"""

import math

import numpy as np

from Quaternion import QConj, QRotate
from rbs.stepping import bodies
from RBSFunctions import refresh_vertices

# The state of a body: the rest of it follows from these and from what never changes.
STATE_NAMES = {
    "positions": "position",
    "orientations": "orientation",
    "linVelocities": "linVelocity",
    "angVelocities": "angVelocity",
}
STATE_WIDTHS = {plural: bodies.STATE_WIDTHS[name] for plural, name in STATE_NAMES.items()}
# The shapes of the values of a body that its energies and momenta are made of.
_ROWS = {
    "mass": (1,),
    "IT": (3, 3),
    "position": (3,),
    "orientation": (4,),
    "linVelocity": (3,),
    "angVelocity": (3,),
}


class Scene:
    """Bodies and their constraints in some state: what a simulation and a replay have in common.

    Whoever shows, writes or measures a scene uses nothing but these attributes, and `step`, one
    step on, and `reset`, back to the start:

    source, scenePath : a SceneSource, and its path; meshes : list of Mesh; groundMesh : Mesh
    constraints : rows [m1, v1, m2, v2, refValue, upper]; settings : Settings
    stepCount, time : steps since the start, and s; report, stepSeconds : the last step's
        `StepReport`, and how long it took; None before the first one, and in a replay
    recommended : the settings that the scene file recommends and that are used, in words, or ""
    isReplay : whether it is a recording, with `seek`, firstStep, lastStep and lastTime
    """

    source = scenePath = groundMesh = settings = report = stepSeconds = None
    meshes = constraints = ()
    stepCount, time = 0, 0.0
    recommended = ""
    isReplay = False

    def step(self):
        """One step on."""
        raise NotImplementedError

    def reset(self):
        """Back to the start."""
        raise NotImplementedError

    def state(self):
        """Copies of positions (n, 3), orientations (n, 4), linVelocities and angVelocities (n, 3).

        returns a dict with these four names
        """
        columns = bodies.state_columns(self.meshes)
        return {plural: columns[name].T.copy() for plural, name in STATE_NAMES.items()}

    def set_state(self, state):
        """Puts the bodies into a state that `state()` gave, in this scene."""
        for plural, name in STATE_NAMES.items():
            for mesh, row in zip(self.meshes, state[plural], strict=True):
                setattr(mesh, name, np.array(row, dtype=np.float64).reshape(1, -1))

    def _free(self, *names):
        """Attributes of all free bodies as arrays with a row for each of the m bodies."""
        free = [mesh for mesh in self.meshes if not mesh.isFixed]
        return [
            np.array([getattr(mesh, name) for mesh in free]).reshape(len(free), *_ROWS[name])
            for name in names
        ]

    def _spin(self):
        """(m, 3) each: the free bodies' ω and I ω in body axes, where I = IT."""
        q, angVelocity, IT = self._free("orientation", "angVelocity", "IT")
        spin = QRotate(QConj(q), angVelocity)
        return spin, np.einsum("mij,mj->mi", IT, spin)

    def kinetic_energy(self):
        """Of all free bodies, in J: ½ m v² + ½ ωᵀ I ω."""
        mass, v = self._free("mass", "linVelocity")
        spin, spinMomentum = self._spin()
        return float(0.5 * np.sum(mass * v * v) + 0.5 * np.sum(spin * spinMomentum))

    def momentum(self):
        """(3,) of all free bodies, in kg m/s: m v."""
        mass, v = self._free("mass", "linVelocity")
        return np.sum(mass * v, axis=0)

    def angular_momentum(self):
        """(3,) of all free bodies about the origin, in kg m²/s: m r × v + R I Rᵀ ω."""
        mass, r, v, q = self._free("mass", "position", "linVelocity", "orientation")
        return np.sum(np.cross(r, mass * v) + QRotate(q, self._spin()[1]), axis=0)

    def potential_energy(self):
        """Of all free bodies over the ground, in J: m g y of their centres of mass."""
        return sum(
            float(self.settings.gravity * mesh.mass * mesh.position[0, 1])
            for mesh in self.meshes
            if not mesh.isFixed
        )

    def largest_violation(self):
        """How far the distance of a constraint is beyond its bound at most, in m; 0 if none is."""
        if self.constraints:
            refresh_vertices(self.meshes)
        largest = 0.0
        for m1, v1, m2, v2, refValue, upper in self.constraints:
            distance = math.dist(self.meshes[m1].currVertices[v1], self.meshes[m2].currVertices[v2])
            largest = max(largest, distance - refValue if upper else refValue - distance)
        return largest

    def lowest_point(self):
        """(y in m, name of the body) of the lowest vertex; (nan, "") where there is no body."""
        refresh_vertices(self.meshes)
        heights = [(float(np.min(mesh.currVertices[:, 1])), mesh.name) for mesh in self.meshes]
        return min(heights, default=(math.nan, ""))

    def is_finite(self):
        """Whether no number of the state is NaN or infinite."""
        return all(bool(np.all(np.isfinite(values))) for values in self.state().values())
