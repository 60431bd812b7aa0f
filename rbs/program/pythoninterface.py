"""The Python interface: `Simulation`, with recordings and pictures, for programs and notebooks.

Units: metres, kilograms, seconds. The y axis points up and the ground is the plane y = 0.
"""

from contextlib import contextmanager
from functools import lru_cache

from rbs.appearance.pictureoptions import PictureOptions
from rbs.pictures.backends import find_backend
from rbs.program.headless import step_progress
from rbs.recordings.recording import Recorder
from rbs.scenes.messages import InputError
from rbs.scenes.scenefiles import SceneSource, find_scene
from rbs.scenes.simulation import SceneSimulation


class Simulation(SceneSimulation):
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

    def run(self, count):
        """Makes `count` steps; returns the simulation. Raises ValueError if count < 0."""
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
        """
        recorder = Recorder(path)
        try:
            recorder.add(self)
            self._recorders.append(recorder)
            yield self
            recorder.save()
        finally:
            self._recorders = [one for one in self._recorders if one is not recorder]
            recorder.close()

    def picture(self, path, **options):
        """Draws the present state into a PNG file.

        Parameters
        ----------
        path : str or Path
        **options
            The fields of `PictureOptions`: size (width, height) in pixels, look ("plain" or
            "studio"), overlays, colouring, hasLegend, camera, isTransparent.

        Raises
        ------
        InputError
            If Polyscope cannot draw here.
        """
        options = PictureOptions(**options)
        backend = _backend()
        if backend.name is None:
            raise InputError(f"no pictures: {backend.reason}. {backend.remedy}")
        from rbs.pictures.capture import save_picture, start_view

        view = start_view(self, backend, options)
        save_picture(path, view, options.isTransparent)


@lru_cache
def _backend():
    """The `Backend` for pictures; to find it takes a second."""
    return find_backend(window=False)
