"""`SceneSimulation`, a scene with its settings and its steps, and settings that a scene suggests.

Those stand in a comment of the scene file, which other programs ignore; the words are the names of
command-line options without dashes:

    # suggests friction 0.5 restitution 0.2 scheduling queue broad-phase grid

Units: metres, kilograms, seconds. The y axis points up and the ground is the plane y = 0.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from difflib import get_close_matches
from typing import TYPE_CHECKING

import numpy as np

from rbs.geometry.triples import shown_value
from rbs.glass.beside import Beside
from rbs.scenes.files import SceneError
from rbs.scenes.messages import InputError, counted, print_error, short, shown_path
from rbs.scenes.scene import Scene
from rbs.scenes.scenefiles import BodySource, SceneSource, check_shape, scene_name
from rbs.scenes.state import (
    STATE_NAMES,
    State,
    removed_from,
    rows_of,
    set_numbers,
    without_body,
)
from rbs.softstep.step import SolverState
from rbs.stepping.meshes import StateError
from rbs.stepping.settings import (
    BY_OPTION,
    BY_PARAMETER,
    SETTINGS,
    IgnoredSetting,
    Settings,
    shown,
    used_settings,
)
from RBSFunctions import Mesh, ground, run_timestep

if TYPE_CHECKING:
    from typing import Self  # since Python 3.11

# What is called otherwise elsewhere.
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
        if not isinstance(meshes, Iterable):
            raise TypeError(f"meshes must be Meshes in a list, not {type(meshes).__name__}")
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
        if not isinstance(mesh, Mesh):
            raise TypeError(f"mesh must be a Mesh, not {type(mesh).__name__}")
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
    meant, near = MEANT.get(name), get_close_matches(name, known, 1)
    if setting := SETTINGS.get(name) or BY_PARAMETER.get(name):
        meant = f"settings.change({setting.name!r}, ...)"
    meant = meant or " or ".join(near)
    return f"{what} has no attribute {name}" + f"; did you mean {meant}?" * bool(meant)


def index_of(body, meshes):
    """Returns the index of a body, which is a Mesh of the list, or an index. Raises ValueError."""
    for k, mesh in enumerate(meshes):
        if mesh is body:
            return k
    isIndex = isinstance(body, int | np.integer) and not isinstance(body, bool)
    if not isIndex or not 0 <= body < len(meshes):
        raise ValueError(f"{shown_value(body)} is no body of this simulation")
    return int(body)


# A comment line that recommends settings: "# suggests friction 0.5".
_SUGGESTION = re.compile(r"\s*#+\s*suggests\s+(.*)")


def recommended_values(source):
    """Returns the settings that a SceneSource recommends: dict from field to value.

    Raises SceneError, with file and line, if a recommendation is invalid.
    """
    values = {}
    for lineNumber, line in enumerate(source.scene.splitlines(), start=1):
        found = _SUGGESTION.match(line)
        words = iter(found[1].split() if found else ())
        try:
            for word in words:
                if word not in BY_OPTION:
                    known = ", ".join(BY_OPTION)
                    raise ValueError(f"unknown setting '{short(word)}'; known are {known}")
                one = BY_OPTION[word]
                if one.name in values:
                    raise ValueError(f"{word} is recommended twice")
                value = not one.default if one.kind is bool else next(words, "")
                try:
                    values[one.name] = one.parsed(value)
                except ValueError as error:
                    raise ValueError(f"{word} {error}") from None
            Settings(**values)
        except ValueError as error:
            raise SceneError(source.path, lineNumber, f"recommended settings: {error}") from None
    return values


def apply_settings(simulation, given, isBasic=False, isStrict=True):
    """Gives a simulation the settings that its scene recommends, overridden by those given.

    given : dict of values by field
    isBasic : whether recommendations are ignored
    isStrict : whether a given setting that the solver ignores is an error; if not, it is left out

    Raises SceneError if a recommendation is invalid, InputError for such an error.
    """
    recommended = {} if isBasic else recommended_values(simulation.source)
    if not isStrict:
        chosen = {"contactSolver": Settings().contactSolver} | recommended | given
        given = used_settings(given, chosen["contactSolver"])
    try:
        simulation.settings = Settings(**recommended).changed(**given)
    except IgnoredSetting as error:
        cause = error.inOptions
        if "contactSolver" in recommended and "contactSolver" not in given:
            cause += f", which {shown_path(simulation.scenePath)} recommends; --basic ignores that"
        raise InputError(cause) from None
    chosen = vars(simulation.settings)
    simulation.recommended = ", ".join(
        one.label if one.kind is bool else f"{one.option} {shown(chosen[name])}"
        for name, one in SETTINGS.items()
        if name in recommended and recommended[name] == chosen[name]
    )
    simulation.startSettings = replace(simulation.settings)


def note_recommended(simulation):
    """Prints a line if a scene uses settings that it recommends."""
    if simulation.recommended:
        path, used = shown_path(simulation.scenePath), simulation.recommended
        print_error(f"using the settings recommended in {path} ({used}); --basic ignores them")
