"""Files that the window writes: pictures, viewpoints, videos, pages and recordings."""

from functools import partial
from pathlib import Path
from typing import NamedTuple

from rbs.pictures.capture import save_picture, take_picture
from rbs.pictures.viewpoint import save_camera
from rbs.recordings import outputs
from rbs.recordings.encoder import Video
from rbs.recordings.page import PageWriter
from rbs.recordings.recording import Recorder
from rbs.scenes.messages import cause_of

# Those that follow the run; the video shows what is seen.
FOLLOWING = "recording", "page"
# Frames per second of videos, and the most seconds that a frame of the window counts. Repeated
# pictures take time to encode: with more, a slow window stops; with fewer, its films are too short.
VIDEO_RATE, LONGEST_FRAME = 30, 2.0


class Film(Video):
    """A video of what is seen, as time passes."""

    def add(self, simulation):
        """Takes the first frame; `film` takes the others."""
        self.film(0.0)


class Running(NamedTuple):
    """A file that grows with the run: its button, ending, and `Writer`."""

    label: str
    tooltip: str
    ending: str
    writer: type


# By name, with which the files' names begin.
RUNNING = {
    "video": Running("Video", "Film what is seen", ".mp4", Film),
    "page": Running("Page", "Write a page that plays the run", ".html", PageWriter),
    "recording": Running("Record", "Record the run and what you do to it", ".h5", Recorder),
}


class Outputs(outputs.Outputs):
    """The files that a Viewer writes, by name in RUNNING.

    written : paths of the complete files of this session
    moment : of the history, the last one that recording and page have

    Recording and page follow the run, the video shows what is seen. Looking back ends none of them,
    but a run that continues from an earlier moment is another one, and ends recording and page.
    """

    def __init__(self, viewer):
        super().__init__(self._tell_error)
        self._viewer, self.written, self.moment = viewer, [], None
        self._filmed = 0.0  # seconds

    def check(self):
        """Ends recording and page if the run does not go on from the last moment that they have."""
        viewer = self._viewer
        if self.writers.keys() - {"video"} and viewer.history.now is not self.moment:
            self.stop(*FOLLOWING)
            ends = self.moment.stepCount, viewer.simulation.stepCount
            viewer.message += "\nIt ends at step {}, as the run goes on from step {}.".format(*ends)

    def go_on(self, before):
        """Hands the present moment on, which was kept, if `before`, the one before it, is the last
        that recording and page have.
        """
        history, simulation, moment = self._viewer.history, self._viewer.simulation, self.moment
        if moment is not before or history.now is before or not self.writers:
            return
        self.moment = history.now
        if history.now.isStep and simulation.isEditable:
            history.now.begin(simulation, before)
            self.before(simulation)
            history.go(history.place)
        (self.add if history.now.isStep else self.before)(simulation)

    def film(self, elapsed):
        """Films what is seen, `elapsed` seconds after the last frame."""
        if video := self.writers.get("video"):
            self._filmed += min(elapsed, LONGEST_FRAME)
            with self.reporting("video"):
                video.film(self._filmed)

    def flush(self):
        """Makes all steps of a recording readable, while paused."""
        if recording := self.writers.get("recording"):
            with self.reporting("recording"):
                recording.flush()

    def _tell_error(self, error):
        self._viewer.message = cause_of(error)

    def _path(self, stem, ending):
        """Returns a path in out/<scene> that does not exist yet. Creates the folder."""
        folder = Path("out") / self._viewer.name
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
        if name in FOLLOWING:
            self.check()
            self.moment = viewer.history.now
        else:
            options, self._filmed = (partial(take_picture, viewer.view, False), VIDEO_RATE, 1), 0.0
        with self.reporting(name):
            self.writers[name] = kind.writer(self._path(name, kind.ending), *options)
            self.writers[name].add(viewer.simulation)

    def stop(self, *names):
        """Ends those of RUNNING, or all, that are being written."""
        for name in names or RUNNING:
            if (writer := self.writers.get(name)) is not None:
                with self.reporting(name):
                    writer.save(self._viewer.simulation)
                    self._tell(writer.path)
                self.writers.pop(name, None)
