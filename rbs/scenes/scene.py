"""`Scene`, a run that can be asked for its states, and `Writer`, what follows it.

Going back in time stands here, for simulations and replays alike: `Scene.state` takes a `State`,
`Scene.restore` returns to it.

Units: metres, kilograms, seconds.
"""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from typing import TYPE_CHECKING, Any

import numpy as np

from rbs.scenes.files import interrupts_held
from rbs.scenes.messages import check_kind, counted, shown_path
from rbs.scenes.state import COLUMNS, STATE_NAMES, Energies, State, arrays_of, rows_of, set_numbers
from rbs.stepping.meshes import STATE_WIDTHS, checked_numbers
from RBSFunctions import ground

if TYPE_CHECKING:
    from pathlib import Path
    from typing import Self  # since Python 3.11

    from rbs.stepping.reports import StepReport
    from rbs.stepping.settings import Settings
    from RBSFunctions import Mesh

# Ten seconds with the default time step.
DEFAULT_STEPS = 500


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
        """Is called before each step, with what was done to the bodies since the last one."""

    def save(self, simulation, isWhole=True):
        """Completes the output after the last state. Raises OSError.

        isWhole : whether the run came to its end; if not, an older file is not replaced
        """

    def close(self):
        """Ends an output that was not saved. Does nothing after `save`."""

    def summary(self):
        """Returns the text of its row in the summary of a run, beside its label."""
        return str(shown_path(self.path))


class Scene(Energies):
    """Bodies and constraints in some state; the base of `SceneSimulation` and `Replay`.

    Views and writers use only these attributes and methods. A Scene that is not editable is a
    Replay, with `seek`, firstStep and lastStep: its bodies and settings cannot be changed, and its
    steps end.
    """

    source: Any  # SceneSource
    scenePath: Path
    meshes: list[Mesh]
    constraints: list[list]  # rows [m1, v1, m2, v2, refValue, upper]
    settings: Settings
    stepCount: int = 0
    time: float = 0.0  # s
    report: StepReport | None = None  # of the last step
    reportError: str = ""  # why a replay's step has no report
    stepSeconds: float | None = None  # duration of the last step
    recommended: str = ""  # text of the recommended settings that are used
    isEditable: bool = True
    writers: list[Writer]  # which take the state after every step

    def __init__(self, source=None, meshes=(), constraints=()):
        """source : SceneSource, from which meshes and constraints were made"""
        self.source, self.scenePath = source, source and source.path
        self.meshes, self.constraints, self.writers = meshes, constraints, []
        self._ground = ground()
        # `SubmittedSteps`, if a student's functions make the steps, and `Beside`, our simulation
        # that runs beside a student's
        vars(self).update(submitted=None, beside=None)
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

    @property
    def groundMesh(self) -> Mesh | None:
        """The ground y ≤ 0, a fixed Mesh without vertices; None without settings.ground."""
        return self._ground if self.settings.ground else None

    @groundMesh.setter
    def groundMesh(self, mesh):
        self.settings.ground = mesh is not None
        self._ground = mesh or self._ground

    def step(self, observer: Callable | None = None) -> None:
        """Makes one step, and hands the new state to all writers.

        observer : function of each `Event` of the step; see `run_timestep`
        """
        if not (observer is None or callable(observer)):
            raise TypeError(f"observer must be a function, not {observer!r}; run makes many steps")
        # a student's step may never end, and is undone wherever a signal stops it
        isHeld = self.writers and self.submitted is None
        with interrupts_held() if isHeld else nullcontext():
            self._tell("before")
            self.advance(observer)
            self._tell("add")

    def _tell(self, name):
        """Calls a method of all writers, in order, even if that of one raises an error."""
        with interrupts_held() if self.writers else nullcontext(), ExitStack() as stack:
            for one in reversed(self.writers):
                stack.callback(getattr(one, name), self)

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
        state.stepCount, state.time = self.stepCount, self.time
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
        for mesh, name, vertices in zip(meshes, state.names, state.restVertices, strict=True):
            mesh.name = name
            own = mesh.origVertices  # with more vertices if a constraint holds a point without one
            if own is not vertices and not np.array_equal(own, vertices):
                mesh.keep_vertices(vertices)
        rows, arrays = state.rows.copy(), state or arrays_of(rows_of(meshes))
        for name, columns in COLUMNS.items():
            rows[:, columns] = arrays[name]
        set_numbers(meshes, rows)
        self.constraints = [list(row) for row in state.constraints]
        if state.settings is not None:
            vars(self.settings).update(vars(state.settings))
        self.stepCount, self.time = state.stepCount, state.time
        self.report, self.stepSeconds = state.report, state.stepSeconds

    def _own_meshes(self, state):
        """Returns this run's bodies of a `State`. Raises TypeError or ValueError."""
        check_kind("state", state, State, "a State")
        if state.sceneMeshes is self._sceneMeshes:
            return list(state.meshes)
        if state.sceneKey != self._sceneKey:
            count = counted(len(state.meshes), "body")
            raise ValueError(f"a state of {count} is not one of {self!r}")
        meshes = state.__getstate__()["meshes"]
        return [self._sceneMeshes[m] if isinstance(m, int) else copy.copy(m) for m in meshes]

    @contextmanager
    def undone(self, start: State) -> Iterator[None]:
        """Returns a context that begins in a `State`, and whose steps are undone at its end."""
        state, beside = self.state(), self.beside
        try:
            self._restore(start)
            yield
        finally:
            self.beside = beside
            self._restore(state)

    def set_state(self, state: dict) -> None:
        """Puts the n bodies into a state, as `state()` returns it: a dict of positions (n, 3),
        orientations (n, 4), linVelocities and angVelocities (n, 3). Raises ValueError.
        """
        check_kind("state", state, dict, "a dict")
        tables, count = {}, len(self.meshes)
        for plural, name in STATE_NAMES.items():
            if plural not in state:
                raise ValueError(f"state must have {', '.join(STATE_NAMES)}, but lacks {plural}")
            width = STATE_WIDTHS[name]
            tables[name] = checked_numbers(plural, state[plural], width, count)[:, None]
        for name, rows in tables.items():
            for mesh, row in zip(self.meshes, rows, strict=True):
                setattr(mesh, name, row)


@contextmanager
def followed_by(run, writer):
    """Returns a context in which a writer takes the present state of a Scene, and every step's."""
    with interrupts_held():
        writer.add(run)
    run.writers.append(writer)
    try:
        yield run
    finally:
        run.writers.remove(writer)


def steps_of_run(run, count=None):
    """Returns how many steps a run makes: count, by default 500; of a replay, at most all left."""
    if run.isEditable:
        return DEFAULT_STEPS if count is None else count
    left = run.lastStep - run.stepCount
    return left if count is None else min(count, left)
