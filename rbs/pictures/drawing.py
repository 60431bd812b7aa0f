"""What pictures need before Polyscope is loaded: their options, checked, and a place to draw."""

import os
import threading
from functools import cache, partial
from pathlib import Path

import numpy as np

from rbs.appearance.camera import (
    LOOKS,
    PICTURE_SIZES,
    Camera,
    PictureOptions,
    load_camera,
    video_timing,
)
from rbs.appearance.colours import COLOURINGS
from rbs.geometry.triples import shown_value
from rbs.pictures.backends import find_backend
from rbs.pictures.overlays import OVERLAYS
from rbs.scenes.files import interrupts_held
from rbs.scenes.messages import InputError
from rbs.stepping.meshes import checked_count, checked_numbers

# The process and the thread that draw.
drawer = {}
# Returns the `Backend` for pictures. Finding it takes a second.
backend = cache(partial(find_backend, window=False))


def picture_options(given):
    """Returns PictureOptions of a dict of options. Raises ValueError or TypeError, naming one."""
    known = vars(options := PictureOptions())
    if unknown := next(filter(lambda name: name not in known, given), ""):
        raise TypeError(f"a picture has no option {unknown}; there are {', '.join(known)}")
    known.update(given)
    if not isinstance(options.overlays, list | tuple):
        options.overlays = (options.overlays,)
    for name, values, choices in (
        ("look", [options.look], LOOKS),
        ("colouring", [options.colouring], COLOURINGS),
        ("overlays", options.overlays, OVERLAYS),
    ):
        for value in values:
            if value not in [*choices]:
                names = ", ".join(choices)
                raise ValueError(f"{name} must be one of {names}, not {shown_value(value)}")
    size = checked_numbers("size", options.size, 2, 1, np.int64)[0].tolist()
    options.size = tuple(checked_count(one, "each side of size", *PICTURE_SIZES) for one in size)
    if isinstance(options.camera, str | Path):
        options.camera = load_camera(options.camera)
    elif not isinstance(options.camera, Camera | None):
        given = shown_value(options.camera)
        raise TypeError(f"camera must be the path of a camera file, not {given}")
    return options


def start_drawing(simulation, options, known=None):
    """Starts Polyscope; returns the `SceneView`. Raises InputError if it cannot draw here.

    known : a `Backend`, or None to find one
    """
    this = os.getpid(), threading.current_thread()
    if drawer.setdefault("first", this) != this:  # there, OpenGL would crash or hang
        raise InputError("only the first thread and process that draws can draw; spawn another")
    found = known or backend()
    if found.name is None:
        raise InputError(f"cannot draw pictures: {found.reason}. {found.remedy}")
    if options.look == "studio" and found.opensWindow:
        raise InputError("the studio look needs EGL, which is missing here")
    with interrupts_held():  # raised while Polyscope is loaded, they would abort the process
        from rbs.pictures.capture import start_view

        return start_view(simulation, found, options)


def frames_of(view, every=None):
    """Returns what a `Video` needs: a function that draws a frame, and `video_timing`."""
    from rbs.pictures.capture import draw_frame

    return partial(draw_frame, view), *video_timing(view.simulation.settings.timeStep, every)
