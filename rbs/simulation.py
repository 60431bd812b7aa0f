"""A scene that is simulated: `Simulation`, its `Settings`, and which values these may have.

From the top: the simulation; the settings; the checks of single values, which the command line and
the window use too; the ground.

Units: metres, kilograms, seconds. The y axis points up and the ground is the plane y = 0.
"""

import math
import operator
import time
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from rbs.bodies import StateError
from rbs.broadphase import BROAD_PHASES
from rbs.messages import short
from rbs.scenes import SceneSource
from rbs.schedules import CONSTRAINT_SCHEDULINGS
from rbs.solverstate import CONTACT_SOLVERS, DEFAULT_SUBSTEPS, SolverState
from rbs.state import Scene
from RBSFunctions import Mesh, run_timestep

# Bodies keep half of their closing speed: the first falls visibly bounce and a pile comes to rest
# within ten seconds. With 1, the other natural choice, nothing in a scene would ever settle.
DEFAULT_RESTITUTION = 0.5
# 50 steps a second: what a bounce needs to look smooth, and what the coursework's scenes are
# laid out for.
DEFAULT_TIME_STEP = 0.02
# Metres: a constraint between bodies of the usual size, 5 to 20 m, is violated by a millimetre at
# most when all is well. Nobody sees that, and a chain of ten settles on it within a few sweeps.
CONSTRAINT_TOLERANCE = 1e-3
# Constraint visits in a step: as many sweeps as a chain needs to pass a tug along itself a few
# times over, and what the coursework allows where the constraints are few.
SWEEPS = 20
LEAST_VISITS = 1000
# Substeps in a step at most: a thousand of them already take seconds for a heap.
MOST_SUBSTEPS = 1000
# Seconds. Outside of these a step changes nothing to be seen, or all there is to be seen; numbers
# made of it soon overflow.
TIME_STEPS = (1e-12, 1e3)


class Simulation(Scene):
    """A scene, what it is simulated with, and how far it has come.

    Attributes: source, a SceneSource, and scenePath, its path; meshes, list of Mesh; constraints,
    a list as `load_constraint_file` gives it; groundMesh; settings; stepCount, the whole steps
    since the start; solverState, what the soft-step solver has left to the next step; report, the
    last step's `StepReport`, and stepSeconds, how long it took (None before the first); suggestion,
    what the scene suggests of its settings, in words, or ""; changes, list of `Change`, what has
    been done to the bodies by hand: all but the pushes before the last step; startSettings, a copy
    of those that it began with, or that the scene suggests.
    """

    suggestion = ""  # `rbs.suggestions`
    submitted = None  # `SubmittedSteps` that make the steps in place of run_timestep

    def __init__(self, scene, settings=None, constraintPath=None, *, allowOutsideMeshes=False):
        """Loads the scene; raises SceneError.

        scene : the path of a scene file, or a SceneSource
        constraintPath : a constraint file; by default the one that belongs to the scene by its
            name, if there is one
        allowOutsideMeshes : see `load_scene_file`
        """
        self.settings = Settings() if settings is None else settings
        self.startSettings = replace(self.settings)
        self.groundMesh = make_ground()
        if not isinstance(scene, SceneSource):
            scene = SceneSource.of_files(scene, constraintPath)
        self.source, self.scenePath = scene, scene.path
        self.meshes, self.constraints = scene.make(allowOutsideMeshes)
        self._startState = self.state()
        self._startFixed = [mesh.isFixed for mesh in self.meshes]
        self._begin()

    def _begin(self):
        self.changes = []
        self.stepCount = 0
        self.time = 0.0
        self.solverState = SolverState()
        self.stepSeconds = self.report = None

    def reset(self):
        """Puts every body back to where the scene has it, at rest, and free or fixed as it was.

        Bodies that have been added are taken out: `meshes` is another list then.
        """
        if len(self.meshes) > self.sceneCount:
            self.meshes = self.meshes[: self.sceneCount]
        for mesh, isFixed in zip(self.meshes, self._startFixed, strict=True):
            mesh.isFixed = isFixed
        self.set_state(self._startState)
        self._begin()

    def change(self, change):
        """Does a `Change` to the bodies, between two steps; raises ValueError where it cannot."""
        change.apply(self.meshes)
        self.changes.append(change)

    @property
    def sceneCount(self):
        """How many bodies the scene has, without those that have been added."""
        return len(self._startFixed)

    def max_iterations(self):
        """Constraint visits in a step at most: as set, or twenty sweeps and at least a thousand."""
        if self.settings.maxIterations is not None:
            return self.settings.maxIterations
        return max(LEAST_VISITS, SWEEPS * len(self.constraints))

    def step(self):
        """Goes on by one time step.

        raises StateError, which names the step and the body, where a number would become NaN,
        infinite or absurdly large; the simulation then stays as it was before the step
        """
        settings = self.settings
        isImpulse = settings.contactSolver == "impulse"
        if isImpulse:  # what the other one has left is out of date
            self.solverState.clear()
        begin = time.perf_counter()
        advance = run_timestep
        if self.submitted is not None:
            advance = partial(self.submitted.step, self.source)
        try:
            with np.errstate(all="ignore"):  # what overflows is told in one line below
                self.report = advance(
                    self.meshes,
                    self.groundMesh,
                    settings.timeStep,
                    settings.restitution,
                    settings.enforceConstraints,
                    self.constraints,
                    self.max_iterations(),
                    CONSTRAINT_TOLERANCE,
                    closingOnly=settings.closingOnly,
                    constraintScheduling=settings.constraintScheduling,
                    mu=settings.friction,
                    broadPhase=settings.broadPhase,
                    contactSolver=settings.contactSolver,
                    substeps=settings.substeps,
                    sleeping=settings.sleeping,
                    gyroscopic=settings.gyroscopic,
                    solverState=None if isImpulse else self.solverState,
                )
        except StateError as error:
            raise StateError(f"step {self.stepCount + 1} cannot be made: {error}") from None
        self.stepSeconds = time.perf_counter() - begin
        self.changes = [one for one in self.changes if one.kind != "push"]
        self.stepCount += 1
        self.time += settings.timeStep


@dataclass
class Settings:
    """What a scene is simulated with, apart from its bodies. The defaults are the basic behaviour.

    restitution : 0 to 1; timeStep : s; closingOnly : see `resolve_collision`; friction : μ ≥ 0
    enforceConstraints : whether a scene's constraints are used
    constraintScheduling : a name of CONSTRAINT_SCHEDULINGS
    maxIterations : constraint visits in a step at most, or None for the default
    broadPhase : a name of BROAD_PHASES; contactSolver : a name of CONTACT_SOLVERS
    substeps, sleeping : of the soft-step solver; gyroscopic : see `run_timestep`
    """

    restitution: float = DEFAULT_RESTITUTION
    timeStep: float = DEFAULT_TIME_STEP
    closingOnly: bool = False
    friction: float = 0.0
    enforceConstraints: bool = True
    constraintScheduling: str = "sweep"
    maxIterations: int | None = None
    broadPhase: str = "all"
    contactSolver: str = "impulse"
    substeps: int = DEFAULT_SUBSTEPS
    sleeping: bool = True
    gyroscopic: bool = False

    def change(self, name, value):
        """Sets a field; raises ValueError, and changes nothing, where it cannot have this value."""
        setattr(self, name, getattr(replace(self, **{name: value}), name))

    def __post_init__(self):
        """Raises ValueError or TypeError for what has no sense: a recording may say anything."""
        self.restitution = checked_restitution(float(self.restitution))
        self.timeStep = checked_time_step(float(self.timeStep))
        self.friction = checked_friction(float(self.friction))
        for name in ("closingOnly", "enforceConstraints", "sleeping", "gyroscopic"):
            if not isinstance(getattr(self, name), bool):
                raise ValueError(f"{name} must be true or false")
        if self.constraintScheduling not in CONSTRAINT_SCHEDULINGS:
            raise ValueError(f"there is no scheduling {self.constraintScheduling!r}")
        if self.broadPhase not in BROAD_PHASES:
            raise ValueError(f"there is no broad phase {self.broadPhase!r}")
        if self.contactSolver not in CONTACT_SOLVERS:
            raise ValueError(f"there is no contact solver {self.contactSolver!r}")
        if self.contactSolver == "soft-step" and self.closingOnly:
            raise ValueError("closingOnly has no meaning for soft-step: no contact ever pulls")
        at_least(1, MOST_SUBSTEPS)(operator.index(self.substeps))
        if self.maxIterations is not None:
            at_least(0)(operator.index(self.maxIterations))


def checked_restitution(value):
    """The value, if it lies in [0, 1]; else ValueError. Above, every contact would add energy."""
    if not 0.0 <= value <= 1.0:
        raise ValueError(f"the restitution must lie between 0 and 1, not {value:g}")
    return value


def checked_time_step(value):
    """The value in seconds, if it is positive and within TIME_STEPS; else ValueError."""
    if not 0.0 < value < math.inf:
        raise ValueError(f"the time step must be positive and finite, not {value:g}")
    low, high = TIME_STEPS
    if not low <= value <= high:
        raise ValueError(f"the time step must be between {low:g} and {high:g} s, not {value:g}")
    return value


def checked_friction(value):
    """The value, if it is finite and not negative; else ValueError."""
    if not 0.0 <= value < math.inf:
        raise ValueError(f"the friction must be finite and not negative, not {value:g}")
    return value


def at_least(low, high=math.inf):
    """A check that numbers are not below `low`, and not above `high`."""

    def check(value):
        if value < low:
            raise ValueError(f"must be {low} or more, not {short(str(value))}")
        if value > high:
            raise ValueError(f"must be {high} or less, not {short(str(value))}")
        return value

    return check


def make_ground():
    """The ground as the contract has it: a fixed mesh of nothing at the origin."""
    noTriangles, noTets = np.empty((0, 3), dtype=np.int64), np.empty((0, 4), dtype=np.int64)
    return Mesh(
        "ground", np.empty((0, 3)), noTriangles, noTets,
        0.0, np.zeros((1, 3)), [[1.0, 0.0, 0.0, 0.0]], True,
    )  # fmt: skip
