"""Files that the window writes: pictures, viewpoints, videos, pages and recordings."""

from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

from rbs.appearance.camera import video_timing
from rbs.pictures.capture import draw_frame, save_picture
from rbs.pictures.viewpoint import save_camera
from rbs.recordings.writers import OUTPUTS
from rbs.scenes.messages import InputError, one_line
from rbs.scenes.scene import Writer


class Running(NamedTuple):
    """A file that grows with the run: its button, ending, and row of OUTPUTS."""

    label: str
    tooltip: str
    ending: str
    output: str


# By name, with which the files' names begin.
RUNNING = {
    "video": Running("Video", "Film until Stop", ".mp4", "video"),
    "page": Running("Page", "Write a page that plays the run", ".html", "export"),
    "recording": Running("Record", "Record the run and what you do to it", ".h5", "record"),
}


class Outputs(Writer):
    """The files that a Viewer writes.

    writers : dict of name in RUNNING and `Writer` of files that are being written
    written : paths of the complete files of this session
    """

    def __init__(self, viewer):
        self._viewer, self.writers, self.written = viewer, {}, []

    def add(self, simulation):
        """Hands the present state to the files that are being written."""
        for name, writer in list(self.writers.items()):
            with self.reporting(name):
                writer.add(simulation)

    def before(self, simulation):
        """Records what was assigned to bodies directly."""
        if "recording" in self.writers:
            with self.reporting("recording"):
                self.writers["recording"].before(simulation)

    def flush(self):
        """Makes all steps of a recording readable, while paused."""
        if recording := self.writers.get("recording"):
            with self.reporting("recording"):
                recording.flush()

    @contextmanager
    def reporting(self, name=None):
        """Reports an error of the `with` block, which ends the writer of this name."""
        try:
            yield
        except (OSError, InputError) as error:
            isTold = isinstance(error, InputError)
            self._viewer.message = str(error) if isTold else f"cannot write: {one_line(error)}"
            if writer := self.writers.pop(name, None):
                with suppress(OSError):  # reported above
                    writer.close()

    def _path(self, stem, ending):
        """Returns a path in out/<scene> that does not exist yet. Creates the folder."""
        folder = Path("out") / self._viewer.name()
        folder.mkdir(parents=True, exist_ok=True)
        path, number = folder / (stem + ending), 1
        while path.exists():
            number += 1
            path = folder / f"{stem}-{number}{ending}"
        return path

    def _tell(self, path):
        self.written.append(Path(path).resolve())
        self._viewer.message = f"{self._viewer.message}\nsaved {self.written[-1]}".strip()

    def save_picture(self):
        """Saves the view, without panels."""
        stem = f"picture_{self._viewer.simulation.stepCount:06d}"
        self._write(stem, ".png", partial(save_picture, view=self._viewer.view))

    def save_camera(self):
        """Saves the viewpoint, for --camera or to be dropped onto the window."""
        self._write("camera", ".json", save_camera)

    def _write(self, stem, ending, write):
        self._viewer.message = ""
        with self.reporting():
            path = self._path(stem, ending)
            write(path)
            self._tell(path)

    def toggle(self, name):
        """Starts writing one of RUNNING, or ends it."""
        viewer = self._viewer
        viewer.message = ""
        if name in self.writers:
            return self.stop(name)
        kind, options = RUNNING[name], ()
        if name == "video":
            timing = video_timing(viewer.simulation.settings.timeStep)
            options = partial(draw_frame, viewer.view), *timing
        with self.reporting(name):
            self.writers[name] = OUTPUTS[kind.output].start(self._path(name, kind.ending), *options)
            self.writers[name].add(viewer.simulation)

    def stop(self, *names):
        """Ends those of RUNNING, or all, that are being written."""
        for name in names or RUNNING:
            if (writer := self.writers.get(name)) is not None:
                with self.reporting(name):
                    writer.save(self._viewer.simulation)
                    self._tell(writer.path)
                self.writers.pop(name, None)
