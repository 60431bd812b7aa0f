"""Simulations from Python, with recordings and pictures: `Simulation` as a notebook wants it.

Units: metres, kilograms, seconds. The y axis points up and the ground is the plane y = 0.
"""

from contextlib import contextmanager

from rbs.program.headless import step_progress
from rbs.program.results import Results, check_ending
from rbs.recordings.recording import RECORDING_ENDINGS, Recorder, Recording
from rbs.recordings.replay import Replay
from rbs.scenes import simulation
from rbs.scenes.scenefiles import SceneSource, find_scene, scene_name


class Simulation(Results, simulation.Simulation):
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

    def __init__(self, scene, settings=None, constraintPath=None):
        if not isinstance(scene, SceneSource):
            scene = SceneSource.of_files(find_scene(scene), constraintPath)
        self._recorders = []
        super().__init__(scene, settings)

    def step(self):
        """Goes on by one time step.

        Raises
        ------
        StateError
            If a number would become NaN, infinite or absurdly large. The simulation stays as it
            was before the step.
        """
        super().step()
        for recorder in self._recorders:
            recorder.add(self)

    def change(self, change):
        """Applies a `Change` to the bodies; recordings know of it."""
        super().change(change)
        for recorder in self._recorders:
            recorder.note(self, change)

    def steps(self, count):
        """Yields the StepReport of each of `count` steps, and shows the progress in a terminal."""
        with step_progress(count) as advance:
            for _ in range(count):
                self.step()
                advance()
                yield self.report

    def run(self, count):
        """Makes `count` steps; returns the simulation."""
        for _ in self.steps(count):
            pass
        return self

    @contextmanager
    def record(self, path):
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
    def open(path):
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
