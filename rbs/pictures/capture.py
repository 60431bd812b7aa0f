"""Pictures and videos of a scene, in either look, drawn off-screen or from the window."""

import numpy as np
import polyscope as ps
from PIL import Image

from rbs.appearance.camera import frame_still
from rbs.appearance.pixels import PictureInk
from rbs.pictures.backends import OFFSCREEN_BACKEND
from rbs.pictures.studio import take_studio
from rbs.pictures.view import SceneView, start_polyscope
from rbs.pictures.viewpoint import apply_camera, kept_camera
from rbs.scenes.files import atomic_write
from rbs.scenes.messages import InputError

# Factor by which pictures are drawn larger along each side and then averaged, and the largest
# number of pixels for it: 4K.
SUPERSAMPLING = 2
MOST_SUPERSAMPLED = 3840 * 2160


def start_view(simulation, backend, options):
    """Starts Polyscope for pictures with these PictureOptions; returns the SceneView.

    backend : name of a `Backend`. Raises InputError if the scene has no bodies.
    """
    if not simulation.meshes:
        raise InputError("there is nothing to draw: the scene has no bodies")
    start_polyscope(backend, options.size)
    view = SceneView(simulation)
    view.look, view.framesStills = options.look, options.camera is None
    if options.camera is not None:
        apply_camera(options.camera)
    elif options.look == "studio":
        apply_camera(frame_still(simulation.meshes, options.size))
    view.spread_ground()
    view.colouring = options.colouring
    for name in options.overlays:
        view.show(name, True)
    return view


def take_picture(view, isStill=True):
    """Returns the camera's picture, (height, width, 3), uint8; a still may take longer."""
    if view.look == "plain":
        return _take_plain(view, isStill)
    with kept_camera():
        if isStill and view.framesStills:
            apply_camera(frame_still(view.simulation.meshes, ps.get_window_size()))
        view.spread_ground()
        view.resize_lines()
        return _with_marks(take_studio(view, isStill), view, SUPERSAMPLING)


def _with_marks(picture, view, factor):
    image = Image.fromarray(picture)
    ink = PictureInk(image.size, factor, ps.get_window_size())
    view.draw_marks(ink)
    if ink.layer.getbbox():
        layer = ink.layer.reduce(factor)
        image.paste(layer, mask=layer)
    return np.array(image)


def _take_plain(view, isStill):
    """Takes a picture in the look of the window.

    Edges are smooth, because the picture is drawn larger and averaged. Polyscope's own
    supersampling has no effect off-screen with EGL.
    """
    width, height = ps.get_window_size()
    # a window changes its size at once only off-screen
    isOffscreen = ps.get_render_engine_backend_name() == OFFSCREEN_BACKEND
    factor = SUPERSAMPLING if isOffscreen and width * height <= MOST_SUPERSAMPLED else 1
    isSmooth = view.isSmooth
    with view.viewpoint.whole_width():
        view.resize_lines()
        view.set_supersampling(isSmooth or isStill and not isOffscreen)
        try:
            if factor > 1:
                ps.set_window_size(factor * width, factor * height)
            picture = ps.screenshot_to_buffer(transparent_bg=False)[:, :, :3]
        finally:
            view.set_supersampling(isSmooth)
            if factor > 1:
                ps.set_window_size(width, height)
        picture = np.array(Image.fromarray(picture).reduce(factor))
        return _with_marks(picture, view, factor)


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
    """Writes a picture of the present state as PNG, of all bodies unless a camera was given."""
    view.refresh()
    if view.framesStills:
        view.viewpoint.frame_all()
    save_picture(path, view)
