"""Pictures and videos in the studio look, for the report and the gallery.

A picture shows panes side by side: moments of one run, or several runs. A pane with a name stands
below a band with the name and, where wanted, with what is measured in the state that it shows.
"""

import argparse
import itertools
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import imageio_ffmpeg
import matplotlib
import numpy as np
import polyscope as ps
from PIL import Image, ImageDraw, ImageFont

from rbs.appearance.camera import PictureOptions
from rbs.appearance.colours import BodyColours
from rbs.pictures.backends import find_backend
from rbs.pictures.capture import start_view, take_picture
from rbs.scenes.files import atomic_write

GAP, INSET = 12, 24  # pixels between panes; of words in a band
BAND = 0.055  # height, as a part of a pane's width
FONT = Path(matplotlib.get_data_path()) / "fonts/ttf/DejaVuSans.ttf"  # it has Greek letters
DARK, PAPER = (40, 43, 48), (255, 255, 255)


class Shot(NamedTuple):
    """A still, a video, or both.

    panes : name → function that returns a Simulation
    camera : position (3,), target (3,) and vertical angle in degrees; name → such cameras of the
        panes; or None to show everything
    colours : function of the meshes, (n, 3), or None
    size : of a pane in pixels; band : height of its band, as a part of its width
    moments : steps of the still, one for each pane, or several of a single one
    steps : range of the video's frames; rate : frames per second; isStacked : its panes one below
        the other
    readout : function of the simulation → text; shown : overlays
    draws : function of the simulation, an `ImageDraw`, and a function from points to pixels
    """

    panes: dict
    camera: tuple | None = None
    colours: Callable | None = None
    size: tuple = (640, 560)
    band: float = BAND
    isStacked: bool = False
    moments: tuple = ()
    steps: range = range(0)
    rate: float = 25.0
    readout: Callable | None = None
    shown: tuple = ()
    draws: Callable | None = None


class StagedColours(BodyColours):
    """The colours of a shot."""

    def __init__(self, colours):
        self._colours = colours

    def of(self, simulation, colouring):
        return self._colours


def opened(shot, name, view=None):
    """Returns the simulation of a pane and its SceneView.

    view : that of the pane before, since Polyscope starts only once
    """
    simulation = shot.panes[name]()
    if view is None:
        backend = find_backend(window=False)
        if backend.name is None:
            sys.exit(f"cannot draw: {backend.reason}. {backend.remedy}")
        look = {"look": "studio", "overlays": shot.shown}
        view = start_view(simulation, backend, PictureOptions(shot.size, **look))
    else:
        view.rebuild(simulation)
    if shot.colours:
        view.bodyColours = StagedColours(shot.colours(simulation.meshes))
    if shot.camera:
        camera = shot.camera[name] if isinstance(shot.camera, dict) else shot.camera
        position, target, angle = camera
        ps.set_vertical_fov_degrees(angle)
        ps.look_at(position, target)
        view.spread_ground()
        view.framesStills = False
    return simulation, view


def taken(shot, view, simulation, words=(), isStill=True):
    """Returns a picture; words : at the left and right of the band, which is left out without."""
    view.refresh()
    image = Image.fromarray(take_picture(view, isStill=isStill))
    share = shot.band if isStill else BAND  # videos say more
    band = 2 * round(share * image.width / 2) if any(words) else 0  # even, as videos need it
    picture = Image.new("RGB", (image.width, image.height + band), PAPER)
    picture.paste(image, (0, band))
    draw = ImageDraw.Draw(picture)
    places = (INSET, "lm"), (image.width - INSET, "rm")
    for word, (x, anchor) in zip(words if band else (), places, strict=False):
        draw.text((x, band / 2), word, DARK, ImageFont.truetype(FONT, 0.55 * band), anchor=anchor)
    if shot.draws:
        shot.draws(simulation, draw, lambda point: tuple(view.pixels_of(point)[0] + (0, band)))
    return np.asarray(picture)


def joined(pictures, axis=1):
    """Puts pictures side by side, or with axis 0 one below the other."""
    shape = list(pictures[0].shape)
    shape[axis] = GAP
    gap = np.full(shape, 255, np.uint8)
    return np.concatenate([part for picture in pictures for part in (gap, picture)][1:], axis)


def still(shot, path, size=None, quality=90):
    """Writes a shot's still as .jpg; size : that it is scaled down to."""
    view, pictures, isRow = None, [], len(shot.panes) > 1
    panes = list(shot.panes) * (1 if isRow else len(shot.moments))
    for word, moment in zip(panes, shot.moments, strict=True):
        simulation, view = opened(shot, word, view)
        simulation.run(moment)
        words = (word, shot.readout(simulation) if shot.readout else "") if isRow else ()
        pictures.append(taken(shot, view, simulation, words))
    picture = Image.fromarray(joined(pictures))
    with atomic_write(path) as partial:
        picture = picture.resize(size, Image.LANCZOS) if size else picture
        picture.save(partial, "JPEG", quality=quality, subsampling=0, optimize=True)


def video(shot, path, crf=24):
    """Writes a shot's video; a lower crf is better, and larger."""
    view, panes = None, []
    for word in shot.panes:
        simulation, view = opened(shot, word, view)
        panes.append([])
        simulation.run(shot.steps.start)
        for step in shot.steps:
            notes = [shot.readout(simulation)] if shot.readout else []
            if word and len(panes) == 1:
                h = simulation.settings.timeStep
                pace = shot.rate * shot.steps.step * h
                notes[:0] = [f"{step * h:.1f} s", f"{pace:g}x real time".removeprefix("1x ")]
            words = word, "    ".join(notes)
            panes[-1].append(taken(shot, view, simulation, words, isStill=False))
            simulation.run(shot.steps.step)
    frames = (joined(pictures, 1 - shot.isStacked) for pictures in zip(*panes, strict=True))
    with atomic_write(path) as partial:
        write_mp4(partial, frames, shot.rate, crf)


def write_mp4(path, frames, rate, crf):
    first = next(frames)
    options = ["-f", "mp4", "-crf", str(crf), "-preset", "slow", "-movflags", "+faststart"]
    how = {"fps": rate, "quality": None, "macro_block_size": 2, "output_params": options}
    writer = imageio_ffmpeg.write_frames(str(path), first.shape[1::-1], **how)
    writer.send(None)
    for frame in itertools.chain([first], frames):
        writer.send(np.ascontiguousarray(frame))
    writer.close()


def choose(names, description):
    """Returns the names in the arguments of the command line, or all; says what there is."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(names))
    chosen = parser.parse_args().names
    for name in chosen:
        if name not in names:
            parser.error(f"there is no {name!r}, only {', '.join(names)}")
    return chosen or names
