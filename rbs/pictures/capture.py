"""Pictures and videos of a scene, drawn off-screen or from the window.

Reading order: starting Polyscope; pictures in either look; frames and stills.
"""

from contextlib import nullcontext

import numpy as np
import polyscope as ps
from PIL import Image

from rbs.appearance.pixels import PictureInk, averaged, laid_over
from rbs.pictures.backends import OFFSCREEN_BACKEND
from rbs.pictures.studio import take_studio
from rbs.pictures.view import SceneView, start_polyscope
from rbs.pictures.viewpoint import apply_camera
from rbs.scenes.files import atomic_write
from rbs.scenes.messages import InputError
from rbs.scenes.state import Scene

# Factor by which pictures are drawn larger along each side and then averaged, and the largest
# number of pixels for it: 4K, supersampled.
SUPERSAMPLING = 2
MOST_DRAWN_PIXELS = 4 * 3840 * 2160


def start_view(simulation, backend, options):
    """Starts Polyscope for pictures with these PictureOptions; returns the SceneView.

    backend : name of a `Backend`. Raises InputError if the scene has no bodies.
    """
    if not simulation.meshes:
        raise InputError("there is nothing to draw: the scene has no bodies")
    start_polyscope(backend, options.size)
    view = SceneView(simulation)
    if options.camera is not None:
        apply_camera(options.camera)
    elif options.look == "studio":
        view.viewpoint.frame_still()
    view.spread_ground()
    view.look, view.framesStills = options.look, options.camera is None
    view.colouring = options.colouring
    for name in options.overlays:
        view.show(name, True)
    return view


def take_picture(view, isStill=True):
    """Returns the camera's picture, (height, width, 3), uint8.

    isStill : bool; True allows a slower and better picture than a frame of a video
    """
    if view.look == "plain":
        return _take_plain(view, isStill)
    with view.viewpoint.framed_still() if isStill and view.framesStills else nullcontext():
        return _completed(take_studio(view, isStill), view)


def _completed(picture, view):
    """Returns a picture with its marks. The camera must be that of the picture."""
    height, width = picture.shape[:2]
    if view.hasMarks:
        factor = 1 if _is_large(width, height) else SUPERSAMPLING
        ink = PictureInk((width, height), factor, ps.get_window_size())
        view.draw_marks(ink)
        picture = laid_over(averaged(np.asarray(ink.layer), factor), picture)
    return picture


def _is_large(width, height):
    """Whether a picture of this size is too large to be supersampled."""
    return SUPERSAMPLING**2 * width * height > MOST_DRAWN_PIXELS


def _take_plain(view, isStill):
    """Takes a picture in the look of the window.

    Edges are smooth, because the picture is drawn larger and averaged. Polyscope's own
    supersampling has no effect off-screen with EGL.
    """
    width, height = ps.get_window_size()
    # a window changes its size at once only off-screen
    isOffscreen = ps.get_render_engine_backend_name() == OFFSCREEN_BACKEND
    factor = SUPERSAMPLING if isOffscreen and not _is_large(width, height) else 1
    isSmooth = view.isSmooth
    isChanged = isStill and not isOffscreen
    if isChanged:
        view.set_supersampling(True)
    with view.viewpoint.whole_width():
        view.resize_lines()
        try:
            if factor > 1:
                ps.set_window_size(factor * width, factor * height)
            picture = ps.screenshot_to_buffer(transparent_bg=False)[:, :, :3]
        finally:
            if isChanged:
                view.set_supersampling(isSmooth)
            if factor > 1:
                ps.set_window_size(width, height)
        return _completed(averaged(picture, factor), view)


def save_picture(path, view):
    """Writes the camera's picture as PNG, replacing an old file atomically; returns the picture."""
    picture = take_picture(view)
    with atomic_write(path) as partial:
        Image.fromarray(picture).save(partial, "PNG")
    return picture


def draw_frame(view):
    """Returns a frame of a video, of the present state: (height, width, 3), uint8."""
    view.refresh()
    return take_picture(view, isStill=False)


def draw_still(view, path):
    """Writes a picture of the present state as PNG."""
    view.refresh()
    save_picture(path, view)


class Shown(Scene):
    """What a picture shows of a simulation or a replay, to be sent to another process."""

    def __init__(self, simulation):
        names = "meshes constraints settings report reportError stepCount"
        vars(self).update({name: getattr(simulation, name) for name in names.split()})
