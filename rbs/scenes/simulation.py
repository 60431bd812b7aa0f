"""A scene that is simulated: `Simulation`.

Units: metres, kilograms, seconds. The y axis points up and the ground is the plane y = 0.
"""

import time
from dataclasses import replace
from functools import partial

import numpy as np

from rbs.scenes.messages import counted
from rbs.scenes.scenefiles import BodySource, SceneSource, scene_name
from rbs.scenes.state import Scene
from rbs.softstep.step import SolverState
from rbs.stepping.bodies import StateError
from rbs.stepping.settings import CONSTRAINT_TOLERANCE, Settings
from RBSFunctions import ground, run_timestep

# Constraint visits in a step: as many sweeps as a chain needs to pass a tug along itself a few
# times over, and what the coursework allows where the constraints are few.
SWEEPS = 20
LEAST_VISITS = 1000


class Simulation(Scene):
    """A scene, what it is simulated with, and how far it has come.

    Attributes: see `Scene`; of its own: solverState, what the soft-step solver has left to the next
    step; changes, list of `Change`, what has been done to the bodies by hand: all but the pushes
    before the last step; startSettings, a copy of the settings that it began with.
    """

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
        self.groundMesh = ground()
        if not isinstance(scene, SceneSource):
            scene = SceneSource.of_files(scene, constraintPath)
        self.source, self.scenePath = scene, scene.path
        self.meshes, self.constraints = scene.make(allowOutsideMeshes)
        self._startFixed = [mesh.isFixed for mesh in self.meshes]
        self._begin()
        self._startState = self.state()

    @classmethod
    def from_meshes(cls, meshes, constraints=(), settings=None, name="scene"):
        """Makes a simulation of meshes, without files.

        The simulation has copies of the meshes, with their velocities: they are the state that
        `reset` returns to.

        Parameters
        ----------
        meshes : list of Mesh
        constraints : list of [m1, v1, m2, v2, refValue, upper]
            See `run_timestep`.
        settings : Settings, optional
            By default, those of the coursework.
        name : str
            The title of plots and recordings.

        Returns
        -------
        Simulation

        Raises
        ------
        TypeError, ValueError
            If something in the list is no Mesh, or a constraint names a missing vertex.
        """
        return cls(BodySource.of_meshes(meshes, constraints, name), settings)

    def __repr__(self):
        name, bodies = scene_name(self.scenePath), counted(len(self.meshes), "body")
        links = counted(len(self.constraints), "constraint")
        return f"Simulation({name!r}, {bodies}, {links}, step {self.stepCount}, {self.time:g} s)"

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
        arguments = settings.arguments()
        if settings.contactSolver == "impulse":
            arguments["maxIterations"] = self.max_iterations()
            arguments["tolerance"] = CONSTRAINT_TOLERANCE  # a student's default may be another one
            self.solverState.clear()  # what the other solver has left is out of date
        else:
            arguments["solverState"] = self.solverState
        begin = time.perf_counter()
        advance = run_timestep
        if self.submitted is not None:
            advance = partial(self.submitted.step, self.source)
        try:
            with np.errstate(all="ignore"):  # what overflows is told in one line below
                self.report = advance(
                    self.meshes, self.groundMesh, constraints=self.constraints, **arguments
                )
        except StateError as error:
            raise StateError(f"step {self.stepCount + 1} cannot be made: {error}") from None
        self.stepSeconds = time.perf_counter() - begin
        self.changes = [one for one in self.changes if one.kind != "push"]
        self.stepCount += 1
        self.time += settings.timeStep
