"""`Scene`, the base of simulations and replays: the state of the bodies, and its measures.

Units: metres, kilograms, seconds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from Quaternion import QConj, QRotate
from rbs.scenes.messages import shown_path
from rbs.stepping import bodies
from RBSFunctions import refresh_vertices

if TYPE_CHECKING:
    from typing import Self  # since Python 3.11

# Ten seconds with the default time step, long enough for every scene in data/ to settle.
DEFAULT_STEPS = 500
# The arrays of a state, and the attribute of a body that each holds.
STATE_NAMES = {
    "positions": "position",
    "orientations": "orientation",
    "linVelocities": "linVelocity",
    "angVelocities": "angVelocity",
}
ARRAY_WIDTHS = {plural: bodies.STATE_WIDTHS[name] for plural, name in STATE_NAMES.items()}
# Shapes of the attributes of a body that its energies and momenta depend on.
_ROWS = {
    "mass": (1,),
    "IT": (3, 3),
    "position": (3,),
    "orientation": (4,),
    "linVelocity": (3,),
    "angVelocity": (3,),
}


class Writer:
    """The base of all outputs: follows a run, as one of the `writers` of a Scene, and writes it.

    The methods do nothing unless a subclass has them.
    path : of its file; label : in the summary of a run
    """

    path, label = None, ""

    def add(self, simulation):
        """Takes the present state of a run, at its start and after every step."""

    def note(self, simulation, change):
        """Takes a `Change` that was made since the last state."""

    def save(self, simulation):
        """Completes the output after the last state. Raises OSError."""

    def close(self):
        """Ends an output that was not saved. Does nothing after `save`."""

    def summary(self, simulation):
        """Returns name and text of its row in the summary of a run."""
        return self.label, str(shown_path(self.path))


class Scene:
    """Bodies and constraints in some state; the base of `SceneSimulation` and `Replay`.

    Views and writers use only these attributes and methods.
    source, scenePath : SceneSource and its path
    meshes, groundMesh : list of Mesh; Mesh
    constraints : rows [m1, v1, m2, v2, refValue, upper]
    settings : Settings
    stepCount, time : steps, and s, since the start
    report, stepSeconds : the last step's `StepReport` and duration, or None
    reportError : why a replay's step has no report, or ""
    recommended : text of the recommended settings that are used, or ""
    submitted : `SubmittedSteps`, if a student's functions make the steps, or None
    beside : `Beside`, our simulation that runs beside a student's, or None
    isEditable : whether bodies and settings can be changed, and steps be made without end; if not,
        it is a Replay, with `seek`, firstStep, lastStep and lastTime
    writers : list of `Writer`s, which take the state after every step
    """

    source = scenePath = groundMesh = settings = report = stepSeconds = submitted = None
    beside = None
    meshes = constraints = ()
    stepCount, time = 0, 0.0
    recommended = reportError = ""
    isEditable = True

    def __init__(self):
        self.writers = []

    def step(self, observer: Callable | None = None) -> None:
        """Makes one step, and hands the new state to all writers.

        observer : function of each `Event` of the step; see `run_timestep`
        """
        self.advance(observer)
        for one in list(self.writers):
            one.add(self)

    def advance(self, observer: Callable | None = None) -> None:
        """Makes one step."""
        raise NotImplementedError

    @contextmanager
    def followed_by(self, writer: Writer) -> Iterator[Self]:
        """Returns a context in which a writer takes the present state and that of every step."""
        writer.add(self)
        self.writers.append(writer)
        try:
            yield self
        finally:
            self.writers.remove(writer)

    def steps_of_run(self, count: int | None = None) -> int:
        """Returns how many steps a run makes: count, by default 500."""
        return DEFAULT_STEPS if count is None else count

    def step_advice(self) -> str:
        """Returns a line if the time step is too long for the scene, or ""."""
        return ""

    def go_beside(self) -> None:
        """Lets our simulation run beside a student's; see `SceneSimulation.go_beside`."""

    def reset(self) -> None:
        """Goes back to the start."""
        raise NotImplementedError

    def find_report(self) -> None:
        """Sets `report` to that of the last step. A simulation has it already."""

    def state(self) -> dict:
        """Returns a dict of copies: positions (n, 3), orientations (n, 4), linVelocities (n, 3) and
        angVelocities (n, 3).
        """
        columns = bodies.state_columns(self.meshes)
        return {plural: columns[name].T.copy() for plural, name in STATE_NAMES.items()}

    def set_state(self, state: dict) -> None:
        """Puts the bodies into a state of this scene, as returned by `state()`."""
        for plural, name in STATE_NAMES.items():
            rows = np.array(state[plural], dtype=np.float64)[:, None]
            for mesh, row in zip(self.meshes, rows, strict=True):
                setattr(mesh, name, row)

    def _free(self, *names):
        """Returns attributes of all m free bodies, each an array with m rows."""
        free = [mesh for mesh in self.meshes if not mesh.isFixed]
        return [
            np.array([getattr(mesh, name) for mesh in free]).reshape(len(free), *_ROWS[name])
            for name in names
        ]

    def _spin(self):
        """Returns ω and I ω of the free bodies in body axes, (m, 3) each. I is IT."""
        q, angVelocity, IT = self._free("orientation", "angVelocity", "IT")
        spin = QRotate(QConj(q), angVelocity)
        return spin, np.einsum("mij,mj->mi", IT, spin)

    def kinetic_energy(self) -> float:
        """Returns the kinetic energy of all free bodies, in J: ½ m v² + ½ ωᵀ I ω."""
        mass, v = self._free("mass", "linVelocity")
        spin, spinMomentum = self._spin()
        return float(0.5 * np.sum(mass * v * v) + 0.5 * np.sum(spin * spinMomentum))

    def momentum(self) -> np.ndarray:
        """Returns the momentum (3,) of all free bodies, in kg m/s: m v."""
        mass, v = self._free("mass", "linVelocity")
        return np.sum(mass * v, axis=0)

    def angular_momentum(self) -> np.ndarray:
        """Returns Σ m r × v + R I Rᵀ ω (3,) of all free bodies, about the origin, in kg m²/s."""
        mass, r, v, q = self._free("mass", "position", "linVelocity", "orientation")
        return np.sum(np.cross(r, mass * v) + QRotate(q, self._spin()[1]), axis=0)

    def potential_energy(self) -> float:
        """Returns the potential energy of all free bodies, zero at the origin, in J: −m g · r."""
        mass, r = self._free("mass", "position")
        return float(-np.sum(mass * (r @ np.array(self.settings.acceleration))[:, None]))

    def largest_violation(self) -> float:
        """Returns the largest violation of a constraint, in m; 0 if none is violated."""
        if self.constraints:
            refresh_vertices(self.meshes)
        largest = 0.0
        for m1, v1, m2, v2, refValue, upper in self.constraints:
            distance = math.dist(self.meshes[m1].currVertices[v1], self.meshes[m2].currVertices[v2])
            largest = max(largest, distance - refValue if upper else refValue - distance)
        return largest

    def lowest_point(self) -> tuple[float, str]:
        """Returns (y in m, name of the body) of the lowest vertex, or (nan, "") without bodies."""
        refresh_vertices(self.meshes)
        heights = [(float(np.min(mesh.currVertices[:, 1])), mesh.name) for mesh in self.meshes]
        return min(heights, default=(math.nan, ""))

    def is_finite(self) -> bool:
        """Returns whether all numbers of the state are finite."""
        return all(bool(np.all(np.isfinite(values))) for values in self.state().values())
