"""The Python interface: `Simulation`, with recordings and pictures, for programs and notebooks.

Units: metres, kilograms, seconds. The y axis points up and the ground is the plane y = 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from rbs.glass.events import Event
from rbs.glass.trace import trace_lines
from rbs.program.headless import step_progress
from rbs.program.results import Results
from rbs.recordings.recording import RECORDING_ENDINGS, Recorder, Recording
from rbs.recordings.replay import Replay
from rbs.scenes import changes
from rbs.scenes.files import check_ending
from rbs.scenes.scenefiles import SceneSource, find_scene, scene_name
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping.reports import StepReport
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
        self._recorders = []
        super().__init__(scene, settings)

    def step(self, observer: Callable[[Event], None] | None = None) -> None:
        """Goes on by one time step.

        Parameters
        ----------
        observer : function, optional
            Called with each `Event` of the step, such as `list.append`. See rbs/glass/events.py.

        Raises
        ------
        StateError
            If a number would become NaN, infinite or absurdly large. The simulation stays as it
            was before the step.
        """
        super().step(observer)
        for recorder in self._recorders:
            recorder.add(self)

    def trace(self, body: Mesh | int | None = None) -> str:
        """Goes on by one time step, and returns a table of what happened in it.

        Parameters
        ----------
        body : Mesh or int, optional
            Only the events of this one.
        """
        events, index = [], None if body is None else self._index(body)
        self.step(events.append)
        return "\n".join(trace_lines(events, self.meshes, index))

    def change(self, change):
        """Applies a `Change` to the bodies; recordings know of it."""
        super().change(change)
        for recorder in self._recorders:
            recorder.note(self, change)

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
            If it is no body of the simulation. So do the methods below.
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
        self.change(changes.add_mesh(len(self.meshes), mesh))
        if mesh.isFixed:
            self.fix(len(self.meshes) - 1)
        return self.meshes[-1]

    def _index(self, body):
        """Returns the index of a Mesh of this simulation, or of a number. Raises ValueError."""
        if isinstance(body, Mesh):
            found = [k for k, mesh in enumerate(self.meshes) if mesh is body]
        else:
            found = [k for k in range(len(self.meshes)) if k == body]
        if not found:
            raise ValueError(f"{body!r} is no body of this simulation")
        return found[0]

    def steps(self, count: int) -> Iterator[StepReport]:
        """Yields the StepReport of each of `count` steps, and shows the progress in a terminal.

        Raises ValueError if count < 0.
        """
        if count < 0:
            raise ValueError(f"count must be 0 or more, not {count}")
        with step_progress(count) as advance:
            for _ in range(count):
                self.step()
                advance()
                yield self.report

    def run(self, count: int) -> Self:
        """Makes `count` steps; returns the simulation. Raises ValueError if count < 0."""
        for _ in self.steps(count):
            pass
        return self

    @contextmanager
    def record(self, path: str | Path) -> Iterator[Self]:
        """Within it, the present state and each step go into a recording.

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
        check_ending(path, RECORDING_ENDINGS, "recording")
        recorder = Recorder(path)
        try:
            recorder.add(self)
            self._recorders.append(recorder)
            yield self
            recorder.save()
        finally:
            self._recorders = [one for one in self._recorders if one is not recorder]
            recorder.close()

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
    to the next one. It cannot be changed; `--resume` continues a recording.
    """

    def change(self, change):
        """Raises ValueError: a recording cannot be changed."""
        raise ValueError("a recording cannot be changed; --resume continues it")

    def __repr__(self):
        name, steps = scene_name(self.scenePath), f"steps {self.firstStep} to {self.lastStep}"
        return f"OpenedRecording({name!r}, {steps}, at {self.stepCount}, {self.time:g} s)"
