"""The Python interface: `Simulation`, with recordings and pictures, for programs and notebooks.

Units: metres, kilograms, seconds. The y axis points up and the ground is the plane y = 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from Quaternion import QConj, QRotate
from rbs.glass.trace import trace_lines
from rbs.program.results import Results
from rbs.recordings.recording import RECORDING_ENDINGS, Recorder, Recording
from rbs.recordings.replay import Replay
from rbs.scenes import changes
from rbs.scenes.files import check_ending
from rbs.scenes.scenefiles import SceneSource, find_scene, scene_name
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping.settings import Settings
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
        By default, those of the coursework.
    constraintPath : str or Path, optional
        By default, the constraint file that belongs to the scene by its name, if any.

    Attributes
    ----------
    meshes : list of Mesh
    constraints : list of [m1, v1, m2, v2, refValue, upper]
    settings : Settings
        May be changed between steps by `settings.change(name, value)`.
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
    ) -> None:
        if not isinstance(scene, SceneSource):
            scene = SceneSource.of_files(find_scene(scene), constraintPath)
        super().__init__(scene, settings)

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

    def move(self, body: Mesh | int, position: ArrayLike) -> None:
        """Moves a body's centre of mass to a position (3,) before the next step."""
        self.change(changes.move(self._index(body), position))

    def fix(self, body: Mesh | int, isFixed: bool = True) -> None:
        """Fixes a body, or frees it, before the next step."""
        self.change(changes.fix(self._index(body), isFixed))

    def add(self, mesh: Mesh) -> Mesh:
        """Adds a copy of a Mesh with its pose and velocity; returns the copy, the last of `meshes`.

        `reset` removes it.
        """
        if not isinstance(mesh, Mesh):
            raise TypeError(f"mesh must be a Mesh, not {type(mesh).__name__}")
        index = len(self.meshes)
        self.change(changes.add_mesh(index, mesh))
        if mesh.isFixed:
            self.fix(index)
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
        for index, point in zip(bodies, (point1, point2), strict=True):
            mesh = self.meshes[index]
            if np.ndim(point) == 0:
                ends.append(mesh.currVertices[point])
                rests.append(mesh.origVertices[point])
            else:
                ends.append(np.reshape(point, 3))
                rests.append(QRotate(QConj(mesh.orientation), ends[-1] - mesh.position))
        distance = math.dist(*ends)
        lower, upper = (distance if one is None else float(one) for one in (lower, upper))
        if not 0.0 <= lower <= upper < math.inf:
            raise ValueError(f"the bounds must be 0 ≤ lower ≤ upper, not {lower} and {upper}")
        self.change(changes.link(bodies[0], rests[0], bodies[1], rests[1], lower, upper))

    def _index(self, body):
        """Returns the index of a Mesh of this simulation, or of a number. Raises ValueError."""
        for k, mesh in enumerate(self.meshes):
            if mesh is body or k == body:
                return k
        raise ValueError(f"{body!r} is no body of this simulation")

    @contextmanager
    def record(self, path: str | Path, contacts: bool = False) -> Iterator[Self]:
        """Returns a context in which the present state and each step are recorded.

        Parameters
        ----------
        path : str or Path
            An .h5 file, which the program replays, resumes and verifies.
        contacts : bool
            Whether the contacts of each step are recorded, too; see `Recording.contacts`.

        Raises
        ------
        OSError
            If the file cannot be written.
        ValueError
            If its name does not end in .h5 or .hdf5.
        """
        check_ending(path, RECORDING_ENDINGS, "a recording")
        with closing(Recorder(path, contacts)) as recorder:
            try:
                with self.followed_by(recorder):
                    yield self
            except BaseException:
                if recorder.frameCount > 1:  # otherwise, an older file stays
                    recorder.save()
                raise
            recorder.save()

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
    to the next one; `contacts()` lists its contacts, if they were recorded. It cannot be changed;
    `--resume` continues a recording.
    """

    def change(self, change: changes.Change) -> None:
        """Raises ValueError: a recording cannot be changed."""
        raise ValueError("a recording cannot be changed; --resume continues it")

    def __repr__(self):
        name, steps = scene_name(self.scenePath), f"steps {self.firstStep} to {self.lastStep}"
        return f"OpenedRecording({name!r}, {steps}, at {self.stepCount}, {self.time:g} s)"
