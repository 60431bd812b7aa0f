"""The Python interface: `Simulation`, with recordings and pictures, for programs and notebooks.

Units: metres, kilograms, seconds. The y axis points up and the ground is the plane y = 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path, PurePath
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from Quaternion import QConj, QRotate
from rbs.glass.trace import trace_lines
from rbs.program.results import Results, check_kind, checked_count
from rbs.recordings.recording import Recorder, Recording
from rbs.recordings.replay import Replay
from rbs.scenes import changes
from rbs.scenes.files import RECORDING_ENDINGS, check_ending
from rbs.scenes.scenefiles import SceneSource, find_scene, scene_name
from rbs.scenes.simulation import SceneSimulation, check_attributes
from rbs.scenes.suggestions import apply_settings
from rbs.stepping.meshes import inertias_of
from rbs.stepping.settings import SETTINGS, Settings
from RBSFunctions import Mesh

if TYPE_CHECKING:
    from typing import Self  # since Python 3.11


class Simulation(Results, SceneSimulation):
    """A scene that is simulated from Python.

    Parameters
    ----------
    scene : str or Path
        A scene file, or the name of one of our scenes. `from_meshes` takes meshes instead.
    settings : Settings, optional
        By default, those that the scene recommends, as on the command line. Given ones replace
        them all.
    constraintPath : str or Path, optional
        By default, the constraint file that belongs to the scene by its name, if any.
    recommended : bool
        False ignores what the scene recommends.

    Attributes
    ----------
    meshes : list of Mesh
        A new list once bodies were added or removed. What is assigned to a body, such as
        `mesh.linVelocity`, counts from the next step on, and is recorded.
    constraints : list of [m1, v1, m2, v2, refValue, upper]
    settings : Settings
        May be changed between steps by `settings.change(name, value)`.
    recommended : str
        The recommended settings that are used, or "".
    stepCount, time : int, float
        Steps since the start, and seconds.
    report : StepReport or None
        Contacts, counters and times of the last step.
    """

    def __init__(
        self,
        scene: str | Path,
        settings: Settings | None = None,
        constraintPath: str | Path | None = None,
        recommended: bool = True,
    ) -> None:
        if settings is not None:
            check_kind("settings", settings, Settings, "Settings")
        if not isinstance(scene, SceneSource):
            what = "a path or a name (from_meshes takes meshes)"
            check_kind("scene", scene, str | PurePath, what)
            scene = SceneSource.of_files(find_scene(scene), constraintPath)
        super().__init__(scene, settings)
        if settings is None:
            apply_settings(self, {}, not recommended)

    if not TYPE_CHECKING:  # for a type checker, it would allow every name

        def __setattr__(self, name, value):
            """Refuses a name that a simulation does not have; a subclass may have its own."""
            isKnown = hasattr(type(self), name) or name in vars(self) or "_start" not in vars(self)
            if not isKnown and type(self) is Simulation:
                remedy = f"; there is settings.{name}" if name in SETTINGS else ""
                raise AttributeError(f"a Simulation has no attribute {name}{remedy}")
            if name == "settings":
                check_kind(name, value, Settings, "Settings")
            super().__setattr__(name, value)

    def trace(self, body: Mesh | int | None = None) -> str:
        """Makes one time step; returns a table of its events, or of those of one body."""
        events, index = [], None if body is None else self._index(body)
        self.step(events.append)
        return "\n".join(trace_lines(events, self.meshes, index))

    def push(self, body: Mesh | int, impulse: ArrayLike, point: ArrayLike | None = None) -> None:
        """Applies an impulse to a body before the next step.

        Parameters
        ----------
        body : Mesh or int
            One of `meshes`, or its index.
        impulse : (3,)
            In N s, in world axes.
        point : (3,), optional
            Where it is applied, in world axes. By default, at the centre of mass.

        Raises
        ------
        ValueError
            If the body is not in the simulation. The methods below raise it, too.
        """
        index = self._index(body)
        point = self.meshes[index].position if point is None else point
        self.change(changes.push(index, impulse, point))

    def move(
        self, body: Mesh | int, position: ArrayLike, orientation: ArrayLike | None = None
    ) -> None:
        """Moves a body's centre of mass to a position (3,) before the next step.

        orientation : quaternion (4,) from rest to world; by default, the body is not turned
        """
        self.change(changes.move(self._index(body), position, orientation))

    def set_velocity(
        self, body: Mesh | int, linear: ArrayLike, angular: ArrayLike = (0.0, 0.0, 0.0)
    ) -> None:
        """Gives a body a velocity (3,), in m/s at its centre of mass, and an angular one, in rad/s.

        A fixed body moves on with it, like a conveyor or a gripper, and nothing slows it down.
        """
        self.change(changes.velocity(self._index(body), linear, angular))

    def fix(self, body: Mesh | int, isFixed: bool = True) -> None:
        """Fixes a body, or frees it, before the next step."""
        self.change(changes.fix(self._index(body), isFixed))

    def add(self, mesh: Mesh) -> Mesh:
        """Adds a copy of a Mesh with its pose and velocity; returns the copy, the last of `meshes`.

        `reset` removes it.
        """
        check_kind("mesh", mesh, Mesh, "a Mesh")
        check_attributes([mesh])
        index = len(self.meshes)
        self.change(changes.add(index, mesh))
        self.change(changes.inertia(index, *np.split(inertias_of([mesh])[0], [1, 10])))
        if mesh.load is not None:
            self.set_force(index, *mesh.load)
        return self.meshes[index]

    def remove(self, body: Mesh | int) -> None:
        """Removes a body and its constraints; bodies after it move up in `meshes`."""
        self.change(changes.remove(self._index(body)))

    def set_force(
        self, body: Mesh | int, force: ArrayLike, torque: ArrayLike = (0.0, 0.0, 0.0)
    ) -> None:
        """Lets a force (3,) in N at the centre of mass, and a torque (3,) in N m, act on a body.

        Both are in world axes, act from the next step on, and replace earlier ones. A body under a
        force does not fall asleep.
        """
        self.change(changes.force(self._index(body), force, torque))

    def constrain(
        self,
        body1: Mesh | int,
        point1: ArrayLike,
        body2: Mesh | int,
        point2: ArrayLike,
        lower: float | None = None,
        upper: float | None = None,
    ) -> None:
        """Links two bodies by a bounded distance, from the next step on.

        Parameters
        ----------
        point1, point2 : (3,) or int
            A point of each body, in world axes at its present pose, or the index of a vertex.
        lower, upper : float, optional
            Bounds of the distance, in m. By default, the present distance: a rod. A rope has the
            lower bound 0; a joint, both bounds 0 and one point. Linked bodies collide as others do.

        Raises
        ------
        ValueError
            If a point lies outside its body, or not 0 ≤ lower ≤ upper.
        """
        bodies, ends, rests = (self._index(body1), self._index(body2)), [], []
        if bodies[0] == bodies[1]:
            raise ValueError("a body cannot be linked to itself")
        for index, point in zip(bodies, (point1, point2), strict=True):
            mesh = self.meshes[index]
            if np.ndim(point) == 0:
                vertex, last = checked_count(point, "a vertex"), len(mesh.origVertices) - 1
                if vertex > last:
                    raise ValueError(f"a vertex must be one of 0 to {last}, not {vertex}")
                ends.append(mesh.currVertices[vertex])
                rests.append(mesh.origVertices[vertex])
            else:
                ends.append(np.array(changes.checked("a point", point)))
                rests.append(QRotate(QConj(mesh.orientation), ends[-1] - mesh.position))
        distance = math.dist(*ends)
        bounds = (distance if one is None else one for one in (lower, upper))
        lower, upper = (changes.checked("a bound", one, 1)[0] for one in bounds)
        if not 0.0 <= lower <= upper:
            raise ValueError(f"the bounds must be 0 ≤ lower ≤ upper, not {lower} and {upper}")
        self.change(changes.link(*bodies, *rests, lower, upper))

    def _index(self, body):
        """Returns the index of a Mesh of this simulation, or of a number. Raises ValueError."""
        for k, mesh in enumerate(self.meshes):
            if mesh is body:
                return k
        with suppress(TypeError, ValueError):
            if (index := checked_count(body, "a body")) < len(self.meshes):
                return index
        raise ValueError(f"{body!r} is no body of this simulation")

    @contextmanager
    def record(self, path: str | Path) -> Iterator[Self]:
        """Returns a context in which the present state and each step are recorded.

        So is what is changed by hand, by methods or by assignment.

        Parameters
        ----------
        path : str or Path
            An .h5 file, which the program replays, resumes and verifies.

        Raises
        ------
        OSError
            If the file cannot be written.
        ValueError
            If its name does not end in .h5 or .hdf5.
        """
        check_ending(path, RECORDING_ENDINGS, "a recording")
        with closing(Recorder(path)) as recorder:
            try:
                with self.followed_by(recorder):
                    yield self
            except BaseException:
                if recorder.count > 1:  # otherwise, an older file stays
                    recorder.save(self)
                raise
            recorder.save(self)

    @staticmethod
    def open(path: str | Path) -> OpenedRecording:
        """Opens a recording; returns an `OpenedRecording`, at its first step.

        Raises RecordingError if it cannot be read.
        """
        return OpenedRecording(Recording(path))


class OpenedRecording(Results, Replay):
    """A recording that is opened from Python.

    It has the attributes of a `Simulation`, and what can be made of one: `picture`, `video`,
    `export`, `stats`, `show`. `seek(step)` goes to any step from `firstStep` to `lastStep`, `step`
    to the next one; `contacts()` lists its contacts. It cannot be changed; `--resume` continues a
    recording.
    """

    def change(self, change: changes.Change) -> None:
        """Raises ValueError: a recording cannot be changed."""
        raise ValueError("a recording cannot be changed; --resume continues it")

    def __repr__(self):
        name, steps = scene_name(self.scenePath), f"steps {self.firstStep} to {self.lastStep}"
        return f"OpenedRecording({name!r}, {steps}, at {self.stepCount}, {self.time:g} s)"
