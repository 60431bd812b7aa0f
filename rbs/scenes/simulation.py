"""`SceneSimulation`, a scene with its settings and its steps; `Beside`, ours beside a student's.

Units: metres, kilograms, seconds. The y axis points up and the ground is the plane y = 0.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from Quaternion import Q2RotMatrix
from rbs.geometry.triples import shown_value
from rbs.glass.mistakes import mistake_in
from rbs.glass.model import in_world_axes
from rbs.glass.trace import Difference, first_difference, labels, same, state_difference
from rbs.scenes.messages import check_kind, counted, did_you_mean
from rbs.scenes.scene import Scene
from rbs.scenes.scenefiles import BodySource, SceneSource, check_shape, scene_name
from rbs.scenes.state import STATE_NAMES, State, removed_from, rows_of, set_numbers, without_body
from rbs.softstep.step import SolverState
from rbs.stepping.meshes import Snapshot, StateError
from rbs.stepping.reports import GROUND
from rbs.stepping.settings import BY_PARAMETER, SETTINGS, Settings
from RBSFunctions import Mesh, ground, run_timestep

if TYPE_CHECKING:
    from typing import Self  # since Python 3.11

TURNED_BACK = "get_rotated_inv_IT gives Rᵀ I⁻¹ R, but R I⁻¹ Rᵀ is right; allowed for"
# The orientation in which tensors are compared. No small multiple of its angle is a full turn, so
# that R², Rᵀ and R³ differ.
TURN = np.array([[0.9, 0.1, -0.3, 0.3]])
# Names in other programs, and ours.
MEANT = {
    **dict.fromkeys(("velocity", "linearVelocity", "vel", "v"), "linVelocity"),
    **dict.fromkeys(("angularVelocity", "omega", "spin", "w"), "angVelocity"),
    **dict.fromkeys(("rotation", "quaternion", "quat"), "orientation"),
    **dict.fromkeys(("inertia", "inertiaTensor", "I"), "IT"),
    **dict.fromkeys(("force", "torque"), "set_force"),
    **dict.fromkeys(("fixed", "static", "kinematic"), "isFixed"),
    **dict.fromkeys(("bodies", "objects"), "meshes"),
    **dict.fromkeys(("pos", "x", "com"), "position"),
    **dict.fromkeys(("dt", "h"), "settings.change('timeStep', ...)"),
}


class SceneSimulation(Scene):
    """A scene that is simulated.

    Attributes, besides those of `Scene`: solverState, kept by the soft-step solver for the next
    step; startState, the `State` at the start, and startSettings, a copy of the settings then.
    """

    solverState: SolverState
    startState: State
    startSettings: Settings

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
        self.solverState, self._known = SolverState(), list(self.meshes)
        self.startState = self.state()
        self.startState.settings = None

    @classmethod
    def from_meshes(
        cls,
        meshes: Iterable[Mesh],
        constraints: Sequence = (),
        settings: Settings | None = None,
        name: str = "scene",
        ground: bool | None = None,
    ) -> Self:
        """Makes a simulation of copies of meshes, with their velocities, without files.

        constraints : rows [m1, v1, m2, v2, refValue, upper], see `run_timestep`
        settings : by default, those of the coursework
        name : the title of pages and recordings
        ground : whether there is a ground y = 0; by default as in the settings, where there is

        Raises TypeError or ValueError if something in the list is no Mesh, or a constraint names a
        missing vertex; AttributeError for an attribute that means nothing to a Mesh.
        """
        check_kind("meshes", meshes, Iterable, "Meshes in a list")
        meshes = list(meshes)
        source = BodySource.of_meshes(meshes, constraints, name)
        check_attributes(meshes)
        made = cls(source, settings)
        if ground is not None:
            made.settings.change("ground", ground)
        return made

    def __repr__(self):
        kind, name = type(self).__name__, scene_name(self.scenePath)
        bodies = counted(len(self.meshes), "body")
        links = counted(len(self.constraints), "constraint")
        return f"{kind}({name!r}, {bodies}, {links}, step {self.stepCount}, {self.time:g} s)"

    def reset(self) -> None:
        """Returns to the start, with the present settings."""
        self.restore(self.startState)

    def state(self) -> State:
        """Returns the present moment, a `State`."""
        self._note_removed()
        state = super().state()
        state.solver = SolverState()
        state.solver.replace(self.solverState)  # its arrays are never modified
        state.beside = self.beside and self.beside.ours.state()
        return state

    def _restore(self, state):
        super()._restore(state)
        self.solverState, self._known = SolverState(), list(self.meshes)
        if state.solver is not None:
            self.solverState.replace(state.solver)
        if self.beside is not None:
            self.beside.ours.restore(state.beside or state)

    def add(self, mesh: Mesh) -> Mesh:
        """Adds a copy of a Mesh with its pose and velocity; returns the copy, the last of `meshes`.

        `reset` removes it.
        """
        check_kind("mesh", mesh, Mesh, "a Mesh")
        check_attributes([mesh])
        check_shape("mesh", mesh)
        state = mesh.density, mesh.position, mesh.orientation, False
        made = Mesh(mesh.name, mesh.givenVertices, mesh.faces, mesh.tets, *state)
        set_numbers([made], rows_of([mesh]))
        self.meshes = [*self.meshes, made]
        if self.beside is not None:
            self.beside.ours.add(mesh)
        return made

    def remove(self, body: Mesh | int) -> None:
        """Removes a body and its constraints; bodies after it move up in `meshes`."""
        body = index_of(body, self.meshes)
        self.meshes = self.meshes[:body] + self.meshes[body + 1 :]
        self.constraints = without_body(self.constraints, body)
        self.report = None  # it has the indices of before
        if self.beside is not None:
            self.beside.ours.remove(body)

    def _note_removed(self):
        """Tells the solver which bodies have gone from `meshes` since its last step."""
        if self._known != self.meshes:
            for body in removed_from(self._known, self.meshes):
                self.solverState.remove(body)
            self._known = list(self.meshes)

    def advance(self, observer: Callable | None = None) -> None:
        """Makes one time step. observer : see `run_timestep`

        Raises StateError, naming step and body, if a number would become NaN, infinite or absurdly
        large. The simulation then stays as it was before the step.
        """
        settings = self.settings
        self._note_removed()
        if settings.contactSolver == "impulse":
            self.solverState.replace(SolverState())  # out of date after a step of this solver
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
            if self.beside is not None:
                self.beside.fail(self)
            raise StateError(f"step {self.stepCount + 1} cannot be made: {error}") from None
        self.stepSeconds = time.perf_counter() - begin
        self.stepCount += 1
        # a multiple of the time step, as long as this stays the same
        steps = round(self.time / settings.timeStep)
        isMultiple = self.time == steps * settings.timeStep
        self.time = (steps + 1) * settings.timeStep if isMultiple else self.time + settings.timeStep
        if self.beside is not None:
            self.beside.follow(self)


def go_beside(run):
    """Lets our simulation run beside one whose steps a student's functions make."""
    if run.isEditable and run.submitted is not None and run.beside is None:
        run.beside = Beside(SceneSimulation(run.source, run.settings), run)


class Beside:
    """Our simulation of a scene beside a student's, from the same start.

    ours : until the two differ, each of its steps begins with the student's state
    difference : their first `Difference`, or None
    remark : a slip of theirs that is allowed for, or ""
    """

    def __init__(self, ours, theirs):
        self.ours, self.difference, self.remark = ours, None, ""
        ours.restore(theirs.state())
        if theirs.submitted.is_turned_back(theirs.meshes):
            self.remark = TURNED_BACK
            for mesh in ours.meshes:
                mesh.__class__ = turned_back(type(mesh))

    def begin(self, theirs):
        """Is called before each step of theirs."""
        self.ours.settings, self.ours.constraints = theirs.settings, theirs.constraints
        self._put_ground_back(theirs)
        if self.difference is None:
            self._start = theirs.state()
            self.ours.set_state(self._start)

    def _put_ground_back(self, theirs):
        """Puts their ground where ours is, which their functions may have moved."""
        if theirs.groundMesh is not None:
            Snapshot.of([self.ours.groundMesh]).restore([theirs.groundMesh])

    def follow(self, theirs):
        """Makes our step after theirs, and looks for the first difference."""
        self.ours.advance()
        if self.difference is not None:
            return
        names = labels([*range(len(theirs.meshes)), GROUND], theirs.meshes)
        ours, others = ([*one.meshes, one.groundMesh][: len(names)] for one in (self.ours, theirs))
        if state := state_difference(ours, others, names):
            found = self._explain(theirs, theirs.stepCount)
            self.difference = found or Difference(None, None, state=state, step=theirs.stepCount)

    def fail(self, theirs):
        """Looks for the first difference in the step that theirs could not make."""
        if self.difference is None:
            found = self._explain(theirs, theirs.stepCount + 1)
            self.difference = found if found and found.other else None

    def _explain(self, theirs, step):
        """Makes a step of both once more; returns the event in which they first differ, or None."""
        both = []
        with theirs.undone(self._start):  # and ours with it
            theirs.beside = None
            for simulation in (self.ours, theirs):
                simulation.set_state(self._start)
                self._put_ground_back(simulation)
                both.append(events := [])
                with suppress(StateError):
                    simulation.advance(events.append)
            found = first_difference(*both, self.ours.meshes)
        if found is None:
            return None
        hint = mistake_in(found.other, both[1]) if found.symbols else ""
        return found._replace(step=step, hint=hint)


def turned_tensor(mesh):
    """The inverse inertia tensor that a mesh gives in world axes, at the orientation TURN."""
    before, mesh.orientation = mesh.orientation, TURN
    try:
        return mesh.get_rotated_inv_IT()
    finally:
        mesh.orientation = before


def is_turned_back(mesh):
    """Whether the tensor that a mesh gives in world axes is Rᵀ I⁻¹ R and not R I⁻¹ Rᵀ."""
    found, R = turned_tensor(mesh), Q2RotMatrix(TURN)
    right, released = (in_world_axes(R, mesh.invIT, way) for way in (False, True))
    return same(found, released) and not same(found, right)


@cache
def turned_back(Mesh):
    """Returns a subclass of our Mesh whose tensor is turned as the release's."""

    class TurnedBack(Mesh):
        isTurnedBack = True

        def get_rotated_inv_IT(self):
            return in_world_axes(Q2RotMatrix(self.orientation), self.invIT, True)

    return TurnedBack


def check_attributes(meshes):
    """Raises AttributeError if a Mesh was given an attribute that means nothing to it."""
    own = vars(ground())
    known = {*own, *STATE_NAMES.values()}
    for k, mesh in enumerate(meshes):
        if type(mesh) is Mesh and (others := set(vars(mesh)) - known):
            told = no_attribute("a Mesh", min(others), [name for name in known if name[0] != "_"])
            raise AttributeError(f"body {k}, {mesh.name!r}: {told}")


def no_attribute(what, name, known):
    """Returns a line that says that there is no attribute of a name, and which one was meant."""
    meant = MEANT.get(name)
    if setting := SETTINGS.get(name) or BY_PARAMETER.get(name):
        meant = f"settings.change({setting.name!r}, ...)"
    remedy = f"; did you mean {meant}?" if meant else did_you_mean(name, known)
    return f"{what} has no attribute {name}{remedy}"


def index_of(body, meshes):
    """Returns the index of a body, which is a Mesh of the list, or an index. Raises ValueError."""
    for k, mesh in enumerate(meshes):
        if mesh is body:
            return k
    isIndex = isinstance(body, int | np.integer) and not isinstance(body, bool)
    if not isIndex or not 0 <= body < len(meshes):
        raise ValueError(f"{shown_value(body)} is no body of this simulation")
    return int(body)
