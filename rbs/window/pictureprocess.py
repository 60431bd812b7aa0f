"""A studio picture that another process draws, so that the window can be used meanwhile.

Polyscope has one window a process: the other one is handed what is seen, and draws it off-screen.
"""

import multiprocessing
from dataclasses import dataclass
from types import SimpleNamespace

from rbs.appearance.pictureoptions import PictureOptions
from rbs.pictures.backends import OFFSCREEN_BACKEND, Backend
from rbs.pictures.capture import StudioLook, save_picture, start_view
from rbs.scenes.messages import one_line

# What a picture shows of a simulation or a replay.
SHOWN_ATTRIBUTES = ("meshes", "constraints", "settings", "report", "stepCount")


@dataclass
class Job:
    """What is to be drawn, as it can be sent to another process.

    path : of the PNG; simulation : with SHOWN_ATTRIBUTES; memory : of the `SceneView`; size :
    (width, height) in pixels; camera : as `load_camera` gives it
    """

    path: str
    simulation: SimpleNamespace
    memory: dict
    size: tuple
    camera: dict


class PictureProcess:
    """Draws what a SceneView shows now, and writes it as PNG at `path`."""

    def __init__(self, path, view):
        self.path = path
        shown = {name: getattr(view.simulation, name) for name in SHOWN_ATTRIBUTES}
        job = Job(str(path), SimpleNamespace(**shown), view.memory(), *view.picture_camera())
        # not forked: a copy of this process would share its connection to the display
        context = multiprocessing.get_context("spawn")
        self._receiver, sender = context.Pipe(duplex=False)
        self._process = context.Process(target=_draw, args=(job, sender))
        self._process.start()
        sender.close()
        self.fraction, self.error = 0.0, ""

    def poll(self):
        """Notes `fraction`, what is done, from 0 to 1, and `error`, a line or "". Whether it still
        draws."""
        try:
            while self._receiver.poll():
                said = self._receiver.recv()
                if isinstance(said, str):
                    self.error = said
                else:
                    self.fraction = said
        except EOFError:
            self._process.join()
            if self._process.exitcode != 0 and not self.error:
                self.error = f"the process that draws ended with code {self._process.exitcode}"
            return False
        return True


def _draw(job, sender):
    """Draws in the other process."""
    try:
        options = PictureOptions(job.size, job.camera)
        view = start_view(job.simulation, Backend(OFFSCREEN_BACKEND), options)
        view.recall(job.memory)
        view.studio = StudioLook(framesAnew=False, report=sender.send)
        save_picture(job.path, view)
    except Exception as error:  # whatever it is, the window says it
        sender.send(one_line(error))
