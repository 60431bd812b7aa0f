"""Opens the window on a scene, and writes its state for the test that drives it.

    python window_program.py FILE STATUS.json

STATUS.json is written after each frame. Ctrl-C closes the window.
"""

import contextlib
import itertools
import json
import os
import sys
from pathlib import Path

import polyscope as ps

from rbs.pictures.backends import find_backend
from rbs.pictures.viewpoint import present_camera
from rbs.recordings.lookup import SceneOpener
from rbs.window.panel import Panel, show_window


def status_of(panel):
    viewer = panel.viewer
    simulation, view = viewer.simulation, viewer.view
    return {
        "isPlaying": viewer.isPlaying,
        "step": simulation.stepCount,
        "bodies": view.pixels_of([mesh.position[0] for mesh in simulation.meshes]).tolist(),
        "picked": view.picked,
        "event": panel.glass.place if panel.glass.events else None,
        "ahead": present_camera().axes[2].tolist(),
        "windowSize": ps.get_window_size(),
        "frameRate": panel.frameRate,
    }


def main(scene, statusPath):
    frame, frameCount = Panel.frame, itertools.count()

    def told_frame(panel):
        frame(panel)
        part = Path(statusPath + ".part")
        part.write_text(json.dumps({**status_of(panel), "frameCount": next(frameCount)}))
        os.replace(part, statusPath)

    Panel.frame = told_frame
    backend = find_backend(window=True)
    if not backend.opensWindow:
        sys.exit(backend.reason)
    with contextlib.suppress(KeyboardInterrupt):
        opener = SceneOpener()
        show_window(opener.open(scene), backend, opener)


main(*sys.argv[1:])
