"""A studio picture drawn by another process, so that the window can be used meanwhile.

Polyscope has one window per process, so the other process draws the same view off-screen.
"""

import multiprocessing

from rbs.appearance.camera import PictureOptions
from rbs.pictures.backends import OFFSCREEN_BACKEND, Backend
from rbs.pictures.capture import StudioLook, save_picture, start_view
from rbs.scenes.messages import one_line
from rbs.scenes.state import Scene

# Attributes of a simulation or a replay that a picture shows.
SHOWN_ATTRIBUTES = ("meshes", "constraints", "settings", "report", "reportError", "stepCount")


class PictureProcess:
    """Draws the present picture of a SceneView to a PNG at `path`."""

    def __init__(self, path, view):
        self.path = path
        shown = Scene()
        for name in SHOWN_ATTRIBUTES:
            setattr(shown, name, getattr(view.simulation, name))
        # not forked, because a copy of this process would share its connection to the display
        context = multiprocessing.get_context("spawn")
        self._receiver, sender = context.Pipe(duplex=False)
        job = str(path), shown, view.memory(), *view.picture_camera(), sender
        self._process = context.Process(target=_draw, args=job)
        self._process.start()
        sender.close()
        self.fraction, self.error = 0.0, ""

    def poll(self):
        """Updates `fraction`, the progress from 0 to 1, and `error`, a line or "".

        Returns whether the process is still drawing.
        """
        try:
            while self._receiver.poll():
                vars(self).update(self._receiver.recv())
        except EOFError:
            self._process.join()
            if self._process.exitcode != 0 and not self.error:
                self.error = f"the drawing process ended with code {self._process.exitcode}"
            return False
        return True


def _draw(path, simulation, memory, size, camera, sender):
    """Draws in the other process; arguments as in `SceneView.memory` and `picture_camera`."""
    try:
        options = PictureOptions(size, camera)
        view = start_view(simulation, Backend(OFFSCREEN_BACKEND), options)
        view.recall(memory)
        view.studio = StudioLook(False, lambda done: sender.send({"fraction": done}))
        save_picture(path, view)
    except Exception as error:  # any error is shown in the window
        sender.send({"error": one_line(error)})
