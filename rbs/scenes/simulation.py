"""`SceneSimulation`, a scene with its settings and its steps.

Units: metres, kilograms, seconds. The y axis points up and the ground is the plane y = 0.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rbs.glass.beside import Beside
from rbs.scenes.changes import Change
from rbs.scenes.messages import counted
from rbs.scenes.scenefiles import BodySource, SceneSource, scene_name
from rbs.scenes.state import STATE_NAMES, STATE_WIDTH, Scene, State
from rbs.softstep.step import SolverState
from rbs.stepping.meshes import StateError
from rbs.stepping.settings import Settings
from RBSFunctions import Mesh, ground, run_timestep

if TYPE_CHECKING:
    from typing import Self  # since Python 3.11


class SceneSimulation(Scene):
    """A scene that is simulated.

    Attributes, besides those of `Scene`: solverState, kept by the soft-step solver for the next
    step; startSettings, a copy of the settings at the start.
    """

    def __init__(self, scene, settings=None, constraintPath=None, *, submitted=None):
        """Loads the scene. Raises SceneError.

        scene : path of a scene file, or a SceneSource
        settings : Settings, by default the coursework's behaviour
        constraintPath : by default NAME-constraints.txt of NAME-scene.txt, if it exists
        submitted : `SubmittedSteps` that replace run_timestep, or None
        """
        if not isinstance(scene, SceneSource):
            scene = SceneSource.of_files(scene, constraintPath)
        super().__init__(scene, *scene.make())
        self.submitted = submitted
        self.settings = Settings() if settings is None else settings
        self.startSettings = replace(self.settings)
        self.groundMesh = ground()
        self.solverState = SolverState()
        self._start = self.state()
        self._start.settings = None

    @classmethod
    def from_meshes(
        cls,
        meshes: list[Mesh],
        constraints: Sequence = (),
        settings: Settings | None = None,
        name: str = "scene",
    ) -> Self:
        """Makes a simulation of copies of meshes, with their velocities, without files.

        constraints : rows [m1, v1, m2, v2, refValue, upper], see `run_timestep`
        settings : by default, those of the coursework
        name : the title of pages and recordings

        Raises TypeError or ValueError if something in the list is no Mesh, or a constraint names a
        missing vertex; AttributeError for an attribute that means nothing to a Mesh.
        """
        source = BodySource.of_meshes(meshes, constraints, name)
        check_attributes(meshes)
        return cls(source, settings)

    def __repr__(self):
        kind, name = type(self).__name__, scene_name(self.scenePath)
        bodies = counted(len(self.meshes), "body")
        links = counted(len(self.constraints), "constraint")
        return f"{kind}({name!r}, {bodies}, {links}, step {self.stepCount}, {self.time:g} s)"

    def reset(self) -> None:
        """Returns to the start, with the present settings."""
        self.restore(self._start)

    def state(self) -> State:
        """Returns the present moment, a `State`."""
        state = super().state()
        state.solver = SolverState()
        state.solver.replace(self.solverState)  # its arrays are never modified
        state.beside = self.beside and self.beside.ours.state()
        return state

    def _restore(self, state):
        super()._restore(state)
        self.solverState = SolverState()
        if state.solver is not None:
            self.solverState.replace(state.solver)
        if self.beside is not None:
            self.beside.ours.restore(state.beside or state)

    def accounted_state(self) -> State:
        """Returns the `State` that `changes` lead to from the start; with the present positions and
        velocities, if steps were made.
        """
        with self.undone() as now:
            self._restore(self._start)
            for one in now.changes:
                self._apply(one)
            state = super().state()
        state.meshes = now.meshes
        if now.stepCount:
            state.rows[:, :STATE_WIDTH] = now.rows[:, :STATE_WIDTH]
        return state

    def go_beside(self) -> None:
        """Lets our simulation run beside this one, if a student's functions make its steps."""
        if self.submitted is not None and self.beside is None:
            self.beside = Beside(SceneSimulation(self.source, self.settings), self)

    def change(self, change: Change) -> None:
        """Applies a `Change` between two steps. Raises ValueError if that is impossible."""
        if not change.isOfOneBody:
            self.tell_writers("before", self)
        self._apply(change)
        if self.beside is not None:
            self.beside.ours.change(change)
        if change.kind == "remove":
            self.solverState.remove(change.body)
            self.report = None  # it has the indices of before
        self.tell_writers("note", self, change)

    def advance(self, observer: Callable | None = None) -> None:
        """Makes one time step. observer : see `run_timestep`

        Raises StateError, naming step and body, if a number would become NaN, infinite or absurdly
        large. The simulation then stays as it was before the step.
        """
        settings = self.settings
        if settings.contactSolver == "impulse":
            self.solverState.clear()  # out of date after a step of this solver
        if self.beside is not None:
            self.beside.begin(self)
        begin = time.perf_counter()
        advance = run_timestep if self.submitted is None else self.submitted.step
        try:
            with np.errstate(all="ignore"):  # an overflow is reported in one line below
                self.report = advance(
                    self.meshes,
                    self.groundMesh,
                    constraints=self.constraints,
                    settings=settings,
                    solverState=self.solverState,
                    observer=observer,
                )
        except StateError as error:
            raise StateError(f"step {self.stepCount + 1} cannot be made: {error}") from None
        self.stepSeconds = time.perf_counter() - begin
        self.stepCount += 1
        self.time += settings.timeStep
        if self.beside is not None:
            self.beside.follow(self)


def check_attributes(meshes):
    """Raises AttributeError if a Mesh was given an attribute that means nothing to it."""
    known = {*vars(ground()), *STATE_NAMES.values()}
    for k, mesh in enumerate(meshes):
        if type(mesh) is Mesh and (others := set(vars(mesh)) - known):
            raise AttributeError(f"body {k}, {mesh.name!r}: a Mesh has no attribute {min(others)}")
