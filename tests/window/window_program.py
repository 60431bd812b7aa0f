"""Opens the window on a scene, and writes where everything is for the test that drives it.

    python window_program.py FILE STATUS.json

STATUS.json is written after each frame. It holds the middles of the widgets, by label, as they were
drawn last, and the state that the test waits for. Ctrl-C closes the window.
"""

import contextlib
import itertools
import json
import os
import sys
from pathlib import Path

import polyscope as ps
import polyscope.imgui as psim
from hands import WIDGETS, noting

from rbs.pictures.backends import find_backend
from rbs.recordings.lookup import SceneOpener
from rbs.window.panel import Panel, show_window


def status_of(panel):
    viewer = panel.viewer
    simulation, view = viewer.simulation, viewer.view
    mesh = view.picked_mesh
    return {
        "isPlaying": viewer.isPlaying,
        "step": simulation.stepCount,
        "friction": simulation.settings.friction,
        "picked": view.picked,
        "velocity": None if mesh is None else mesh.linVelocity[0].tolist(),
        "saved": viewer.saved,
        "windowSize": ps.get_window_size(),
        "frameRate": panel.frameRate,
        "bodies": view.pixels_of([mesh.position[0] for mesh in simulation.meshes]).tolist(),
    }


def main(scene, statusPath):
    places, frameCount = {}, itertools.count()

    def note(label, *place):
        places[label] = place

    for kind in WIDGETS:
        setattr(psim, kind, noting(getattr(psim, kind), note))
    frame = Panel.frame

    def told_frame(panel):
        places.clear()
        frame(panel)
        part = Path(statusPath + ".part")
        status = {**status_of(panel), "frameCount": next(frameCount), "places": places}
        part.write_text(json.dumps(status))
        os.replace(part, statusPath)

    Panel.frame = told_frame
    backend = find_backend(window=True)
    if not backend.opensWindow:
        sys.exit(backend.reason)
    with contextlib.suppress(KeyboardInterrupt):
        opener = SceneOpener()
        show_window(opener.open(scene), backend, opener)


main(*sys.argv[1:])
