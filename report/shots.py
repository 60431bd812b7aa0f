"""Pictures and videos of the report: `python report/shots.py still|video NAME`.

Pairs show one scene with the basic step and with the soft step, at one moment from one camera.
Words stand in a band above the picture. An arrow ends beside the effect, where it is measured in
the state; if it is not there, neither arrow nor word is drawn. Stills go to figures/, videos to
videos/.
"""

import itertools
import math
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from gallery import StagedColours, aim, along_row, by_shape, mp4, rgb
from laws import (
    BOX,
    CUBE,
    RAMP,
    RAMP_FRICTION,
    RAMP_SECONDS,
    SOFT,
    TUNNEL_SPEED,
    WALL,
    H,
    box,
    coulomb,
    finish,
    lowest_body,
    overlap_of,
    run,
    scene,
    silent,
    slide_on,
    stacked,
    throw,
)
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial import ConvexHull
from timings import RESTING

from Quaternion import QRotate
from rbs.appearance.camera import PictureOptions
from rbs.pictures.backends import find_backend
from rbs.pictures.capture import start_view, take_picture
from rbs.recordings.encoder import Encoder
from rbs.scenes.files import atomic_write
from RigidBodySimulation import Settings, Simulation

FOLDER = Path(__file__).resolve().parent
RATE = 25
VERMILION, GREEN, DARK, PAPER = (213, 94, 0), (0, 130, 95), (40, 43, 48), (255, 255, 255)
MAGENTA = (190, 0, 120)
LABELS = (("basic step", VERMILION), ("soft step", GREEN))
BAND = 0.075  # height of the band of words, as a fraction of a half's width
ARROW_GAP = 0.8  # from an arrow's tip to what it marks, as a fraction of the band's unit
HALF = (640, 592)  # of a video, without the band


class Camera(NamedTuple):
    """A camera: position and target (3,) in metres, and horizontal field of view in degrees."""

    position: tuple
    target: tuple
    fieldOfView: float

    def half_height(self, size):
        """Returns what is seen above the target, a metre away, in a picture of this size."""
        return math.tan(math.radians(self.fieldOfView) / 2) * size[1] / size[0]

    def apply(self, view, size):
        angle = 2 * math.degrees(math.atan(self.half_height(size)))
        aim(view, self.position, self.target, angle)

    def pixel(self, point, size):
        """Returns where a point (3,) is seen in a picture of this size."""
        ahead = np.subtract(self.target, self.position)
        ahead = ahead / np.linalg.norm(ahead)
        right = np.cross(ahead, (0.0, 1.0, 0.0))
        right /= np.linalg.norm(right)
        away = np.subtract(point, self.position)
        scale = size[1] / 2 / self.half_height(size) / (away @ ahead)
        x, y = scale * (away @ right), scale * (away @ np.cross(right, ahead))
        return size[0] / 2 + x, size[1] / 2 - y


class Pair(NamedTuple):
    """A scene with the basic step and with the soft step.

    make : function of settings that returns a Simulation; colours : of its meshes
    effect : function of a simulation → `(point (3,), word, whether it is to be marked)`
    first, last, every : steps of the video; still : step of the still, or None, and its size
    filmed : camera of the video, if it is another one
    arrow : from its tip to its tail, to the right and down
    draws : function of a simulation, an `ImageDraw`, a function from points to pixels, and a unit
        of length in pixels, which draws more; or None
    """

    make: Callable
    colours: Callable
    camera: Camera
    effect: Callable
    first: int
    last: int
    every: int
    still: int | None = None
    size: tuple = (880, 800)
    filmed: Camera | None = None
    arrow: tuple = (3.2, -1.6)
    draws: Callable | None = None

    def halves(self):
        """Yields the simulations of both halves, with 0 or 1."""
        for k, settings in enumerate(({"contactScheduling": "batches"}, SOFT)):
            yield k, self.make(**settings)


def stack_scene(**settings):
    return Simulation.from_meshes(stacked(), settings=Settings(**settings), name="stack")


def deepest_overlap(simulation):
    meshes = simulation.meshes
    depths = [a.detect_collision(b)[1] for a, b in zip(meshes[:-1], meshes[1:], strict=True)]
    k = int(np.argmax(depths))
    right = max(mesh.currVertices[:, 0].max() for mesh in meshes[k : k + 2])
    edge = (right, (meshes[k].position[0, 1] + meshes[k + 1].position[0, 1]) / 2, -BOX[2] / 2)
    return edge, f"{overlap_of(meshes):.1f} m of overlap", max(depths) > 1.0


def top_of_pyramid(simulation):
    top = simulation.meshes[-1]
    height = 15 * BOX[1] - BOX[1] / 2
    sunk = height - top.position[0, 1]
    return top.position[0], f"top {sunk:.1f} m too low", sunk > 2.0


def deepest_vertex(simulation):
    point = lowest_body(simulation).lowest_vertex()
    return point * [1, 0, 1], f"{-point[1]:.2f} m below ground", point[1] < -0.3


def front_edge(mesh):
    """Returns the middle of the lower front edge of a box on a slope (3,)."""
    return mesh.position[0] + QRotate(mesh.orientation, np.array([BOX * [0.5, -0.5, 0.0]]))[0]


def creeping_box(simulation):
    mesh, start = simulation.meshes[3], simulation.source.make(False)[0][3]
    way = float(np.linalg.norm(mesh.position - start.position))
    return front_edge(mesh) + [0, 0, BOX[2] / 2], f"has crept {way:.1f} m", way > 0.5


def draw_starts(simulation, draw, pixel, unit):
    """Draws a line on each slope where its box began, and writes its angle and the friction."""
    meshes, font = simulation.source.make(False)[0], ImageFont.load_default(1.15 * unit)
    words = [((-24, -4, 17), "lm", f"friction {simulation.settings.friction:g}")]
    for slab, mesh in zip(meshes[::2], meshes[1::2], strict=True):
        downhill, normal = QRotate(np.repeat(slab.orientation, 2, axis=0), np.eye(3)[:2])
        edge = front_edge(mesh) + [0, 0, BOX[2] / 2]
        rim = edge + [0, 0, 3]  # slabs are 48 m long, 2 m thick and 14 m wide
        line = [pixel(point) for point in (edge, rim, rim - 2 * normal)]
        draw.line(line, fill=DARK, width=max(3, round(unit / 6)))
        beside = slab.position[0] - 25 * downhill + [0, 0, 7]
        words.append((beside, "rm", f"{math.degrees(math.asin(-downhill[1])):.0f}°"))
    for point, anchor, word in words:
        draw.text(pixel(point), word, DARK, font, anchor=anchor)


def draw_sunk(simulation, draw, pixel, unit):
    """Shades what is below the ground of the lowest body. It is convex, and so is its picture."""
    if not deepest_vertex(simulation)[2]:
        return
    corners, mesh = [], lowest_body(simulation)
    for face in mesh.currVertices[mesh.faces]:
        for a, b in zip(face, np.roll(face, -1, axis=0), strict=True):
            if a[1] < 0:
                corners.append(a)
            if (a[1] < 0) != (b[1] < 0):
                corners.append(a + (b - a) * a[1] / (a[1] - b[1]))
    pixels = np.array([pixel(corner) for corner in corners])
    outline = [tuple(pixels[k]) for k in ConvexHull(pixels).vertices]
    draw.polygon(outline, fill=(*MAGENTA, 150))
    draw.line([*outline, outline[0]], fill=MAGENTA, width=max(2, round(unit / 9)))


PAIRS = {
    "stack": Pair(
        stack_scene,
        along_row,
        Camera((62, 33, 88), (0, 23.5, 0), 33),
        deepest_overlap,
        0,
        190,
        2,
        100,
    ),
    "cube": Pair(
        partial(scene, "cube"),
        along_row,
        Camera((13, 5.5, 46), (0, 6.6, 0), 32.5),
        deepest_vertex,
        92,
        240,
        1,
        121,
        filmed=Camera((16, 9, 58), (0, 9.2, 0), 34),
        arrow=(3.2, 1.6),
        draws=draw_sunk,
    ),
    "slope": Pair(
        partial(scene, "incline", friction=0.4),
        by_shape,
        Camera((16, 38, 86), (-3, 9, 3), 38.5),
        creeping_box,
        0,
        350,
        4,
        arrow=(1.6, 3.2),
        draws=draw_starts,
    ),
    "pyramid": Pair(
        partial(scene, "pyramid", **RESTING),
        along_row,
        Camera((96, 64, 350), (0, 44, 0), 37),
        top_of_pyramid,
        0,
        300,
        4,
        140,
        (1000, 440),
    ),
}


def annotated(name, simulation, picture, label, camera, note=""):
    """Returns a picture of a pair's half below a band of words; the effect is marked if there.

    label : (text, colour); note : written at the right
    """
    pair = PAIRS[name]
    point, word, isMarked = pair.effect(simulation)
    size = picture.shape[1::-1]
    band = round(BAND * size[0])
    image = Image.new("RGB", (size[0], size[1] + band), PAPER)
    image.paste(Image.fromarray(picture), (0, band))
    draw, unit = ImageDraw.Draw(image, "RGBA"), band / 2.1
    small, large = ImageFont.load_default(1.15 * unit), ImageFont.load_default(1.5 * unit)
    draw.text((0.3 * unit, band * 0.45), *label, large, anchor="lm")
    draw.text((size[0] - 0.3 * unit, band * 0.45), note, DARK, small, anchor="rm")

    def pixel(point):
        x, y = camera.pixel(point, size)
        return x, y + band

    if pair.draws:
        pair.draws(simulation, draw, pixel, unit)
    if isMarked:
        font = small if note else large
        draw.text((size[0] * 0.62, band * 0.45), word, VERMILION, font, anchor="mm")
        tail = np.array(pair.arrow)
        along = -tail / np.linalg.norm(tail)
        tip = np.array(pixel(point)) - ARROW_GAP * unit * along
        shaft = [*(tip + unit * tail), *(tip - 0.5 * unit * along)]
        draw.line(shaft, fill=VERMILION, width=max(3, round(unit / 5)))
        across = 0.45 * np.array([-along[1], along[0]])
        head = [tip, tip - unit * (along - across), tip - unit * (along + across)]
        draw.polygon([tuple(corner) for corner in head], fill=VERMILION)
    return np.asarray(image)


def view_of(simulation, camera, size, colours, view=None):
    """Returns a SceneView in the studio look; Polyscope starts only once."""
    if view is None:
        backend = find_backend(window=False)
        if backend.name is None:
            sys.exit(f"cannot draw: {backend.reason}. {backend.remedy}")
        view = start_view(simulation, backend, PictureOptions(size))
    else:
        view.rebuild(simulation)
    view.bodyColours = StagedColours(colours)
    camera.apply(view, size)
    view.refresh()
    return view


def halves_of(name):
    """Returns a picture of both halves of a pair."""
    pair, view, halves = PAIRS[name], None, []
    for k, simulation in pair.halves():
        simulation.run(pair.still)
        _, word, isMarked = pair.effect(simulation)
        if isMarked == bool(k):
            sys.exit(f"{name}, half {k}: {word}")
        colours = pair.colours(simulation.meshes)
        view = view_of(simulation, pair.camera, pair.size, colours, view)
        halves.append(annotated(name, simulation, take_picture(view), LABELS[k], pair.camera))
    gap = np.full((len(halves[0]), 14, 3), 255, np.uint8)
    return np.concatenate((halves[0], gap, halves[1]), 1)


def single(meshes, colours, camera, size):
    """Returns a picture of meshes that stand for moments of several runs."""
    simulation = Simulation.from_meshes(meshes)
    return take_picture(view_of(simulation, camera, size, colours))


STROBE, STROBE_CAMERA = (1000, 460), Camera((0.2, 9.0, 10.5), (-0.9, 0.1, -0.15), 52)
LANES = (-1.7, 1.7)


def strobe():
    """A cube after each step: the basic step lets it cross a wall, the soft step does not.

    Each step has a colour. Both runs have restitution 0; the basic one leaves out impulses between
    separating bodies.
    """
    meshes, colours, ends = [], [], []
    for lane, options in zip(LANES, ({"closingOnly": True}, SOFT), strict=True):
        wall = box((WALL, 1.4, 1.7), (0, 0.7, lane), isFixed=True)
        meshes.append(wall)
        colours.append(rgb(["a9a7a2"])[0])
        begin = -(WALL + CUBE) / 2 - TUNNEL_SPEED * H * 3.15
        cube = throw(box((CUBE,) * 3, (begin, 0.5, lane)), (TUNNEL_SPEED, 0, 0))
        places = [cube.position.copy()]
        for _ in run([wall, cube], 6, e=0.0, ground=False, gravity=(0, 0, 0), **options):
            places.append(cube.position.copy())
        ends.append(float(cube.position[0, 0]))
        # of a cube that has stopped, the last one
        isLast = np.abs(np.diff([place[0, 0] for place in places], append=np.inf)) > CUBE / 2
        meshes += [box((CUBE,) * 3, place) for place in itertools.compress(places, isLast)]
        colours += list(along_row(places)[isLast])
    if not (ends[0] > 0 > ends[1]):
        sys.exit(f"strobe: the cubes end at {ends}")
    picture = single(meshes, np.array(colours), STROBE_CAMERA, STROBE)
    image = Image.fromarray(picture)
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(34)
    for label, y in zip(LABELS, (40, 380), strict=True):  # above the far row, below the near one
        draw.text((60, y), label[0], label[1], font, anchor="lm")
    return np.asarray(image)


RAMP_SIZE, RAMP_CAMERA = (1000, 510), Camera((84, 74, 14), (-7, 11.5, -1.2), 34.5)


def ramp():
    """Five boxes on one slope after the same time, with lines where Coulomb's law has them."""
    slab, meshes, lines = None, [], []
    for k, mu in enumerate(RAMP_FRICTION):
        lane = 11.0 * (k - 2)
        slab, mesh, downhill, normal = slide_on(RAMP, lane, (50.0, 2.0, 58.0), 12.0)
        start = mesh.position[0].copy()
        finish(run([slab, mesh], round(RAMP_SECONDS / H), ground=False, mu=mu))
        meshes.append(mesh)
        foot = start + (BOX[0] / 2 + coulomb(RAMP, mu, RAMP_SECONDS)) * downhill
        foot = foot - (BOX[1] / 2 - 0.05) * normal
        front = start + BOX[0] / 2 * downhill - (BOX[1] / 2 - 0.05) * normal
        lines.append((foot - [0, 0, BOX[2] / 2 + 1], foot + [0, 0, BOX[2] / 2 + 1]))
    colours = np.concatenate([rgb(["c9c7c2"]), along_row(meshes)])
    picture = single([slab, *meshes], colours, RAMP_CAMERA, RAMP_SIZE)
    image = Image.fromarray(picture)
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(30)
    for mu, line in zip(RAMP_FRICTION, lines, strict=True):
        pixels = [RAMP_CAMERA.pixel(end, RAMP_SIZE) for end in line]
        draw.line([*pixels[0], *pixels[1]], fill=VERMILION, width=9)
        middle = np.mean(pixels, axis=0) + [4, 28]
        draw.text(tuple(middle), f"{mu:g}", DARK, font, anchor="mm")
    for gap in ((28, 4.7), (-5.2, -6.8), (-17.3, -28)):  # the start, where no box hides it
        draw.line([RAMP_CAMERA.pixel((*front[:2], z), RAMP_SIZE) for z in gap], fill=DARK, width=4)
    return np.asarray(image)


STILLS = {"strobe": strobe, "ramp": ramp}
STILLS |= {name: partial(halves_of, name) for name, pair in PAIRS.items() if pair.still}


def still(name):
    """Writes figures/<name>.jpg."""
    picture = STILLS[name]()
    with atomic_write(FOLDER / "figures" / f"{name}.jpg") as partial_file:
        Image.fromarray(picture).save(partial_file, "JPEG", quality=90, subsampling=0)


@silent
def videos():
    """First full second on the clock of each video at which its effect is in view."""
    pyramid = PAIRS["pyramid"]
    numbers = {"pyramidStill": pyramid.still * H, "pyramidCount": len(pyramid.make().meshes)}
    for name, pair in PAIRS.items():
        (_, simulation), step = next(pair.halves()), 0
        while not pair.effect(simulation)[2]:
            simulation.step()
            step += 1
        numbers[name] = math.ceil(step * H)
    numbers |= {"rampAngle": RAMP, "rampSeconds": RAMP_SECONDS}
    numbers |= {"rampLeast": min(RAMP_FRICTION), "rampMost": max(RAMP_FRICTION)}
    return numbers


def tempo(pair):
    """Simulated seconds per second of the video, in words."""
    factor = pair.every * H * RATE
    return {0.5: "half speed", 1.0: "real time", 2.0: "double speed"}[factor]


def video(name):
    """Writes videos/<name>.mp4."""
    pair, view, halves = PAIRS[name], None, []
    camera = pair.filmed or pair.camera
    for k, simulation in pair.halves():
        pictures = []
        simulation.run(pair.first)
        colours = pair.colours(simulation.meshes)
        view = view_of(simulation, camera, HALF, colours, view)
        for step in range(pair.first, pair.last + 1):
            if (step - pair.first) % pair.every == 0:
                view.refresh()
                picture = take_picture(view, isStill=False)
                note = f"{tempo(pair)}   {step * H:.1f} s" if k else ""
                pictures.append(annotated(name, simulation, picture, LABELS[k], camera, note))
            simulation.step()
        halves.append(pictures)
    target = FOLDER / "videos" / f"{name}.mp4"
    target.parent.mkdir(exist_ok=True)
    height, width = halves[0][0].shape[:2]
    with atomic_write(target) as partial_file:
        # five videos share 2 MB
        encoder = Encoder(partial_file, (2 * width, height), RATE, mp4(27))
        for left, right in zip(*halves, strict=True):
            encoder.write(np.ascontiguousarray(np.concatenate((left, right), axis=1)))
        encoder.finish()


if __name__ == "__main__":
    for argument in sys.argv[2:]:
        {"still": still, "video": video}[sys.argv[1]](argument)
