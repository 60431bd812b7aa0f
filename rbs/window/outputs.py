"""Files that the window writes: pictures, viewpoints, videos, pages and recordings."""

from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

from rbs.pictures.capture import save_picture, take_picture
from rbs.pictures.viewpoint import save_camera
from rbs.recordings.writers import OUTPUTS
from rbs.scenes.messages import InputError, one_line
from rbs.scenes.state import Writer

# Frames per second of videos, which show what is seen.
VIDEO_RATE = 30


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
    moment : of the history, the last one that recording and page have

    Recording and page follow the run, and the video shows what is seen. Looking back at earlier
    moments ends none of them, but what is made from one of those is no part of the run.
    """

    def __init__(self, viewer):
        self._viewer, self.writers, self.written, self.moment = viewer, {}, [], None
        self._filmed = 0.0  # seconds

    @property
    def _followers(self):
        return {name: one for name, one in self.writers.items() if name != "video"}

    def check(self):
        """Ends recording and page if the present moment, from which something new is to be made,
        is not the last one that they have.
        """
        viewer = self._viewer
        if self._followers and viewer.history.now is not self.moment:
            self.stop_following()
            ends = self.moment.stepCount, viewer.simulation.stepCount
            viewer.message += "\nends at step {}, since the run went on from step {}".format(*ends)

    def stop_following(self):
        """Ends recording and page."""
        if self._followers:
            self.stop(*self._followers)

    def go_on(self, before):
        """Hands the present moment on, which was kept, if `before`, the one before it, is the last
        that recording and page have.
        """
        viewer, moment = self._viewer, self._viewer.history.now
        if not self._followers or before is not self.moment or moment is before:
            return
        history, simulation, self.moment = viewer.history, viewer.simulation, moment
        for change in simulation.changes[len(before.scene.changes) :]:
            self.note(simulation, change)
        if moment.isStep:
            if not viewer.isReplay:
                moment.begin(simulation, before)
                self.before(simulation)
                history.go(history.place)
            self.add(simulation)
        else:
            self.before(simulation)

    def add(self, simulation):
        """Hands the present state to recording and page."""
        for name, writer in self._followers.items():
            with self.reporting(name):
                writer.add(simulation)

    def film(self, elapsed):
        """Films what is seen, `elapsed` seconds after the last frame."""
        if (video := self.writers.get("video")) is not None:
            self._filmed += elapsed
            with self.reporting("video"):
                video.film(self._filmed)

    def before(self, simulation):
        """Records what was assigned to bodies directly."""
        if "recording" in self.writers:
            with self.reporting("recording"):
                self.writers["recording"].before(simulation)

    def note(self, simulation, change):
        """Records a `Change` made by hand."""
        if recording := self.writers.get("recording"):
            recording.note(simulation, change)

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
        self.check()
        if name == "video":
            options, self._filmed = (partial(take_picture, viewer.view, False), VIDEO_RATE, 1), 0.0
        with self.reporting(name):
            self.writers[name] = OUTPUTS[kind.output].start(self._path(name, kind.ending), *options)
        self.moment = viewer.history.now
        if name in self._followers:
            with self.reporting(name):
                self.writers[name].add(viewer.simulation)

    def stop(self, *names):
        """Ends those of RUNNING, or all, that are being written."""
        for name in names or RUNNING:
            if (writer := self.writers.get(name)) is not None:
                with self.reporting(name):
                    writer.save(self._viewer.simulation)
                    self._tell(writer.path)
                self.writers.pop(name, None)
