"""`State`, a moment of a run, and `Scene`, a run that can be asked for its states.

Going back in time stands here, for simulations and replays alike: `Scene.state` takes a `State`,
`Scene.restore` returns to it. The measures of a state follow.

Units: metres, kilograms, seconds.
"""

from __future__ import annotations

import copy
import hashlib
import math
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from Quaternion import QConj, QRotate
from rbs.glass.trace import differs
from rbs.scenes.messages import counted, shown_path
from rbs.stepping.meshes import STATE_WIDTHS, Snapshot, inertias_of, set_inertia
from RBSFunctions import refresh_vertices

if TYPE_CHECKING:
    from pathlib import Path
    from typing import Self  # since Python 3.11

    from rbs.stepping.reports import StepReport
    from rbs.stepping.settings import Settings
    from RBSFunctions import Mesh

# Ten seconds with the default time step, long enough for every scene in data/ to settle.
DEFAULT_STEPS = 500
# The arrays of a state, and their columns in `rows_of`; the attribute of a body that each holds.
COLUMNS = {
    "positions": slice(0, 3),
    "orientations": slice(3, 7),
    "linVelocities": slice(7, 10),
    "angVelocities": slice(10, 13),
}
STATE_NAMES, STATE_WIDTH = dict(zip(COLUMNS, STATE_WIDTHS, strict=True)), 13
# Signals that ask a program to end, and their names for messages. Windows has no SIGHUP.
SIGNAL_NAMES = {
    getattr(signal, name): text
    for name, text in {"SIGINT": "Ctrl-C", "SIGTERM": "kill", "SIGHUP": "a hang-up"}.items()
    if hasattr(signal, name)
}
# Seconds that a student's step may take after the first signal.
PATIENCE = 2.0


class State(dict):
    """A moment of a run, to go back to; copies and pickles of it serve as well.

    A dict of positions (n, 3), orientations (n, 4), linVelocities and angVelocities (n, 3); if it
    is empty, the bodies stay where they are.
    Attributes: meshes, the bodies; rows, see `rows_of`, names and restVertices of them;
    constraints; settings, or None to keep those of the run; stepCount; time in s; report and
    stepSeconds of the last step, which copies lack; changes; and of a simulation its solver and
    beside. In a copy, `meshes` has numbers in place of the bodies of the scene file.
    """

    solver = beside = None

    def __getstate__(self):
        """Returns the attributes of a copy."""
        number = {id(mesh): k for k, mesh in enumerate(self.sceneMeshes or [])}
        meshes = [number.get(id(mesh), mesh) for mesh in self.meshes]
        others = {"meshes": meshes, "sceneMeshes": None, "report": None, "stepSeconds": None}
        return vars(self) | others

    def is_like(self, other: State) -> bool:
        """Returns whether positions and velocities of two states agree up to rounding."""
        return not any(map(differs, self.values(), other.values()))


class Writer:
    """The base of all outputs: follows a run, as one of the `writers` of a Scene, and writes it.

    The methods do nothing unless a subclass has them.
    path : of its file; label : in the summary of a run
    needsEachStep : whether the run must not go back in time meanwhile
    """

    path, label, needsEachStep = None, "", False

    def add(self, simulation):
        """Takes the present state of a run, at its start and after every step."""

    def before(self, simulation):
        """Is called before each step, and before a change that is not of one body."""

    def note(self, simulation, change):
        """Takes a `Change` that was made since the last state."""

    def save(self, simulation):
        """Completes the output after the last state. Raises OSError."""

    def close(self):
        """Ends an output that was not saved. Does nothing after `save`."""

    def summary(self, simulation):
        """Returns name and text of its row in the summary of a run."""
        return self.label, str(shown_path(self.path))


@contextmanager
def interrupts_held(patience=None):
    """Lets signals with a handler, such as Ctrl-C, act at the end of the `with` block, or at once
    the second time. The first counts as the second after `patience` seconds, if given.
    """
    noted, handlers, timers = [], {}, []

    def note(number, frame):
        noted.append(number)
        if len(noted) > 1:
            handlers[number](number, frame)
        elif patience is not None:
            timers.append(threading.Timer(patience, signal.raise_signal, [number]))
            timers[0].start()

    isMain = threading.current_thread() is threading.main_thread()
    for number in SIGNAL_NAMES if isMain else ():
        if callable(handler := signal.getsignal(number)):
            handlers[number] = handler
            signal.signal(number, note)
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for timer in timers:
            timer.cancel()
    if noted:
        handlers[noted[0]](noted[0], None)


class Scene:
    """Bodies and constraints in some state; the base of `SceneSimulation` and `Replay`.

    Views and writers use only these attributes and methods. A Scene that is not editable is a
    Replay, with `seek`, firstStep, lastStep and lastTime: its bodies and settings cannot be
    changed, and its steps end.
    """

    source: Any  # SceneSource
    scenePath: Path
    meshes: list[Mesh]
    groundMesh: Mesh | None = None
    constraints: list[list]  # rows [m1, v1, m2, v2, refValue, upper]
    settings: Settings
    stepCount: int = 0
    time: float = 0.0  # s
    report: StepReport | None = None  # of the last step
    reportError: str = ""  # why a replay's step has no report
    stepSeconds: float | None = None  # duration of the last step
    recommended: str = ""  # text of the recommended settings that are used
    submitted: Any = None  # `SubmittedSteps`, if a student's functions make the steps
    beside: Any = None  # `Beside`, our simulation that runs beside a student's
    isEditable: bool = True
    changes: tuple = ()  # `Change`s since the start, but for those of one body
    writers: list[Writer]  # which take the state after every step

    def __init__(self, source=None, meshes=(), constraints=()):
        """source : SceneSource, from which meshes and constraints were made"""
        self.source, self.scenePath = source, source and source.path
        self.meshes, self.constraints, self.writers = meshes, constraints, []
        self._sceneMeshes = list(meshes)
        texts = source and (source.scene, source.constraints)
        content = repr((texts, [mesh.mass for mesh in meshes]))
        self._sceneKey = hashlib.sha256(content.encode("utf-8", "surrogateescape")).hexdigest()

    def __getstate__(self):
        """Returns the attributes of a copy, which nobody records."""
        return vars(self) | {"writers": []}

    def __copy__(self) -> Self:
        return copy.deepcopy(self)  # a run that shares its bodies with another would wreck both

    @property
    def sceneCount(self) -> int:
        """The number of bodies in the scene file."""
        return len(self._sceneMeshes)

    def step(self, observer: Callable | None = None) -> None:
        """Makes one step, and hands the new state to all writers.

        observer : function of each `Event` of the step; see `run_timestep`
        """
        if not (observer is None or callable(observer)):
            raise TypeError(
                f"observer must be a function, not {observer!r}; run makes several steps"
            )
        if not self.writers:
            return self.advance(observer)
        with interrupts_held(None if self.submitted is None else PATIENCE):
            self.tell_writers("before", self)
            self.advance(observer)
            self.tell_writers("add", self)

    def tell_writers(self, name: str, *given: Any) -> None:
        """Calls a method of all writers, in order, even if that of one raises an error."""
        with ExitStack() as stack:
            for one in reversed(self.writers):
                stack.callback(getattr(one, name), *given)

    @contextmanager
    def followed_by(self, writer: Writer) -> Iterator[Self]:
        """Returns a context in which a writer takes the present state and that of every step."""
        with interrupts_held():
            writer.add(self)
        self.writers.append(writer)
        try:
            yield self
        finally:
            self.writers.remove(writer)

    def steps_of_run(self, count: int | None = None) -> int:
        """Returns how many steps a run makes: count, by default 500."""
        return DEFAULT_STEPS if count is None else count

    def go_beside(self) -> None:
        """Lets our simulation run beside a student's; see `SceneSimulation.go_beside`."""

    def find_report(self) -> None:
        """Sets `report` to that of the last step. A simulation has it already."""

    def state(self) -> State:
        """Returns the present moment, a `State` that later steps do not change."""
        meshes, rows = list(self.meshes), rows_of(self.meshes)
        state = State(arrays_of(rows))
        state.meshes, state.rows = meshes, rows
        state.sceneMeshes, state.sceneKey = self._sceneMeshes, self._sceneKey
        state.names = [mesh.name for mesh in meshes]
        state.restVertices = [mesh.origVertices for mesh in meshes]
        state.constraints = [list(row) for row in self.constraints]
        state.settings = copy.copy(self.settings)
        state.stepCount, state.time, state.changes = self.stepCount, self.time, self.changes
        state.report, state.stepSeconds = self.report, self.stepSeconds
        return state

    def restore(self, state: State) -> None:
        """Returns to a `State` of this scene: bodies, constraints, settings, and what is kept from
        step to step, so that the next steps have the same bits again.

        If bodies were added or removed since, `meshes` becomes a new list. A copy of a state, or
        one of another run of the scene, brings copies of the bodies that were added. Raises
        ValueError or TypeError if it is no state of this scene, and ValueError while the run is
        recorded.
        """
        if any(one.needsEachStep for one in self.writers):
            raise ValueError("a run that is being recorded cannot go back; end the recording first")
        self._restore(state)

    def _restore(self, state):
        meshes = self._own_meshes(state)
        if meshes != self.meshes:
            self.meshes = meshes
        isOther = differing_bits(rows_of(meshes), state.rows)[:, STATE_WIDTH:].any(axis=1)
        for b in np.flatnonzero(isOther).tolist():
            set_inertia(meshes[b], state.rows[b, STATE_WIDTH:-6])
            meshes[b].set_force(state.rows[b, -6:-3], state.rows[b, -3:])
        for mesh, name, vertices in zip(meshes, state.names, state.restVertices, strict=True):
            mesh.name = name
            own = mesh.origVertices  # with more vertices if a constraint holds a point without one
            if own is not vertices and not np.array_equal(own, vertices):
                mesh.keep_vertices(vertices)
        if state:
            self.set_state(state)
        self.constraints = [list(row) for row in state.constraints]
        if state.settings is not None:
            vars(self.settings).update(vars(state.settings))
        self.stepCount, self.time, self.changes = state.stepCount, state.time, state.changes
        self.report, self.stepSeconds = state.report, state.stepSeconds

    def _apply(self, change):
        """Makes a `Change` of bodies or constraints. Raises ValueError if that is impossible."""
        # new lists, since a loop may be going through the old ones
        meshes, constraints = list(self.meshes), list(self.constraints)
        change.apply(meshes, constraints)
        self.meshes, self.constraints = meshes, constraints
        if not change.isOfOneBody:
            self.changes = *self.changes, change

    def _own_meshes(self, state):
        """Returns this run's bodies of a `State`. Raises TypeError or ValueError."""
        if not isinstance(state, State):
            raise TypeError(f"state must be a State, not {type(state).__name__}")
        if state.sceneMeshes is self._sceneMeshes:
            return list(state.meshes)
        if state.sceneKey != self._sceneKey:
            count = counted(len(state.meshes), "body")
            raise ValueError(f"a state of {count} is not one of {self!r}")
        meshes = state.__getstate__()["meshes"]
        return [self._sceneMeshes[m] if isinstance(m, int) else copy.copy(m) for m in meshes]

    @contextmanager
    def undone(self) -> Iterator[State]:
        """Returns a context whose steps are undone at its end; it yields the present state."""
        state, beside = self.state(), self.beside
        try:
            yield state
        finally:
            self.beside = beside
            self._restore(state)

    def set_state(self, state: dict) -> None:
        """Puts the bodies into positions, orientations and velocities, as in `state()`."""
        for plural, name in STATE_NAMES.items():
            rows = np.array(state[plural], dtype=np.float64)[:, None]
            for mesh, row in zip(self.meshes, rows, strict=True):
                setattr(mesh, name, row)

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


def rows_of(meshes):
    """Returns all numbers of n bodies that may be assigned and that a step reads, (n, 38).

    The columns are the state, `inertias_of`, and the force and the torque of `Mesh.load`. Raises
    ValueError, which names the body.
    """
    loads = np.zeros((len(meshes), 6))
    for row, mesh in zip(loads, meshes, strict=True):
        if mesh.load is not None:
            try:
                row[:] = np.ravel(mesh.load)
            except ValueError:
                what = "load must be a force and a torque, of 3 numbers each"
                raise ValueError(f"mesh {mesh.name}: {what}") from None
    columns = [table.T for table in Snapshot.of(meshes).values()]
    return np.concatenate([*columns, inertias_of(meshes), loads], axis=1)


def arrays_of(rows):
    """Returns the arrays of a `State`, by name, as views of rows (..., 38) of `rows_of`."""
    return {name: rows[..., columns] for name, columns in COLUMNS.items()}


def differing_bits(one, other):
    """Returns where two arrays of floats differ in any bit, bool of their shape."""
    return np.asarray(one).view(np.uint64) != np.asarray(other).view(np.uint64)
