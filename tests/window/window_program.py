"""Opens the window on a scene, and writes its state after each frame for the test that drives it.

    python window_program.py FILE STATUS.json

Ctrl-C closes the window.
"""

import contextlib
import itertools
import json
import os
import sys

import polyscope as ps

from rbs.appearance.camera import PictureOptions
from rbs.pictures.backends import find_backend
from rbs.pictures.viewpoint import present_camera
from rbs.recordings.lookup import SceneOpener
from rbs.window.panel import Panel, show_window

SCENE, STATUS = sys.argv[1:]
frame, count = Panel.frame, itertools.count()


def told_frame(panel):
    frame(panel)
    simulation, view = panel.viewer.simulation, panel.viewer.view
    status = {
        "frameCount": next(count),
        "isPlaying": panel.viewer.isPlaying,
        "step": simulation.stepCount,
        "bodies": view.pixels_of([mesh.position[0] for mesh in simulation.meshes]).tolist(),
        "picked": view.picked,
        "event": panel.glass.place if panel.glass.events else None,
        "ahead": present_camera().axes[2].tolist(),
        "windowSize": ps.get_window_size(),
        "frameRate": panel.frameRate,
    }
    with open(f"{STATUS}.part", "w") as file:
        json.dump(status, file)
    os.replace(f"{STATUS}.part", STATUS)


Panel.frame = told_frame
with contextlib.suppress(KeyboardInterrupt):
    opener = SceneOpener()
    show_window(opener.open(SCENE), find_backend(window=True), opener, PictureOptions())
