"""Opens the window on a scene, and writes where everything is for the test that drives it.

    python window_program.py FILE STATUS.json

STATUS.json is written after each frame. It holds the middles of the widgets, by label, as they were
drawn last, and the state that the test waits for. Ctrl-C closes the window.
"""

import itertools
import json
import os
import sys
from pathlib import Path

import numpy as np
import polyscope as ps
import polyscope.imgui as psim

from rbs.opening.lookup import open_file
from rbs.opening.suggestions import SceneOpener, apply_settings
from rbs.pictures.backends import find_backend
from rbs.window.panel import Panel, show_window

WIDGETS = "Button Selectable BeginCombo InputDouble InputTextWithHint Checkbox CollapsingHeader "
WIDGETS = (WIDGETS + "SliderInt SliderFloat SmallButton").split()
# A field's rectangle holds its label, and buttons: its number is at the left.
INTO_FIELD = 15.0


def noting(draw, places):
    """The widget's function, noting where it has drawn: label to [x, y, width]."""

    def noted(label, *arguments, **options):
        answer = draw(label, *arguments, **options)
        (left, top), (right, bottom) = psim.GetItemRectMin(), psim.GetItemRectMax()
        name = label.split("###")[0] or label.split("###")[1]
        places[name] = [left + INTO_FIELD, 0.5 * (top + bottom), right - left]
        return answer

    return noted


def status_of(panel):
    viewer = panel.viewer
    simulation, view = viewer.simulation, viewer.view
    mesh = viewer.picked()
    return {
        "scene": simulation.scenePath.name,
        "isPlaying": viewer.isPlaying,
        "step": simulation.stepCount,
        "friction": simulation.settings.friction,
        "shown": sorted(view.shown),
        "picked": view.picked,
        "velocity": None if mesh is None else mesh.linVelocity[0].tolist(),
        "isFixed": mesh is not None and mesh.isFixed,
        "message": viewer.message,
        "saved": viewer.saved,
        "plotted": len(viewer.history),
        "bodyCount": len(simulation.meshes),
        "follows": view.follows,
        "grabbed": None if viewer.grab is None else viewer.grab.body,
        "recorded": viewer.recorder and viewer.recorder.frameCount,
        "layout": panel.layout,
        "positions": [mesh.position[0].tolist() for mesh in simulation.meshes],
        "windowSize": ps.get_window_size(),
        "frameRate": panel.frameRate,
        "changes": [one.kind for one in getattr(simulation, "changes", ())],
        "bodies": [project(mesh.position[0]) for mesh in simulation.meshes],
    }


def project(point):
    """The pixel (x, y) at which a point (3,) is seen."""
    camera = ps.get_view_camera_parameters()
    arm = point - np.array(camera.get_position())
    axes = camera.get_right_dir(), camera.get_up_dir(), camera.get_look_dir()
    x, y, z = (float(arm @ np.array(axis)) for axis in axes)
    width, height = ps.get_window_size()
    scale = 0.5 * height / np.tan(np.radians(camera.get_fov_vertical_deg()) / 2.0) / z
    return [0.5 * width + scale * x, 0.5 * height - scale * y]


def main(scene, statusPath):
    places, frameCount = {}, itertools.count()
    for kind in WIDGETS:
        setattr(psim, kind, noting(getattr(psim, kind), places))
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
    try:
        simulation = open_file(scene)
        if simulation.isEditable:
            apply_settings(simulation, {})
        show_window(simulation, backend, SceneOpener())
    except KeyboardInterrupt:
        pass


main(*sys.argv[1:])
