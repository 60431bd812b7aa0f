"""Pictures and videos of the default beside its cure: `python report/shots.py still|video NAME`.

Both halves show one scene at one moment from one camera. An arrow and a word mark the effect where
it is measured in the state; if it is not there, nothing is drawn. Stills go to figures/, videos to
videos/.
"""

import math
import sys
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from laws import BOX, SOFT, H, lowest_vertices, overlap_of, scene, silent, stacked
from PIL import Image, ImageDraw, ImageFont
from timings import RESTING, SIZES, heap_at_rest

from rbs.appearance.pictureoptions import PictureOptions
from rbs.pictures.backends import find_backend
from rbs.pictures.capture import StudioLook, start_view, take_picture
from rbs.recordings.encoder import Encoder
from rbs.scenes.files import atomic_write
from rbs.scenes.simulation import SceneSimulation, Settings

FOLDER = Path(__file__).resolve().parent
TALL, WIDE, VIDEO = (880, 990), (880, 700), (640, 720)  # sizes of a half
HEAP = (1760, 880)
RATE = 25
CODEC = "-f mp4 -vcodec libx264 -pix_fmt yuv420p -crf 28 -preset slow -movflags +faststart"
VERMILION, GREEN, DARK = (213, 94, 0), (0, 130, 95), (40, 43, 48)


class Camera(NamedTuple):
    """A camera: position and target (3,) in metres, and horizontal field of view in degrees."""

    position: tuple
    target: tuple
    fieldOfView: float

    def half_height(self, size):
        """Returns what is seen above the target, a metre away, in a picture of this size."""
        return math.tan(math.radians(self.fieldOfView) / 2) * size[1] / size[0]

    def apply(self, view, size):
        import polyscope as ps

        ps.set_vertical_fov_degrees(2 * math.degrees(math.atan(self.half_height(size))))
        ps.look_at(self.position, self.target)
        view.spread_ground()

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
    """A scene with the basic step, by grid, and with the soft step.

    make : function of settings that returns a SceneSimulation
    effect : function of a simulation, `(point (3,), word, whether it is to be marked)`
    steps : of the video; every : steps per frame; still : step of the still, or None, and its size
    """

    make: object
    camera: Camera
    effect: object
    steps: int
    every: int
    still: int | None = None
    size: tuple = TALL

    def halves(self):
        """Yields the simulations of both halves, with 0 or 1."""
        for k, settings in enumerate(({"contactScheduling": "batches"}, SOFT)):
            yield k, self.make(**settings)


def stack_scene(**settings):
    return SceneSimulation.from_meshes(stacked(), settings=Settings(**settings), name="stack")


def deepest_overlap(simulation):
    meshes = simulation.meshes
    depths = [a.detect_collision(b)[1] for a, b in zip(meshes[:-1], meshes[1:], strict=True)]
    k = int(np.argmax(depths))
    point = (meshes[k].position[0] + meshes[k + 1].position[0]) / 2
    edge = point + [BOX[0] / 2, 0, BOX[2] / 2]
    return edge, f"{overlap_of(meshes):.1f} m of overlap", max(depths) > 1.0


def top_of_pyramid(simulation):
    top = simulation.meshes[-1]
    height = 15 * BOX[1] - BOX[1] / 2
    sunk = height - top.position[0, 1]
    return top.position[0], f"top {sunk:.1f} m too low", sunk > 2.0


def deepest_vertex(simulation):
    meshes = [mesh for mesh in simulation.meshes if not mesh.isFixed]
    low = lowest_vertices(simulation)
    mesh = meshes[int(low.argmin())]
    point = np.array(mesh.lowest_vertex()) * [1, 0, 1]
    return point, f"{-low.min():.2f} m below the ground", low.min() < -0.3


def creeping_box(simulation):
    place = simulation.meshes[3].position[0]
    start = simulation.source.make(False)[0][3].position[0]
    way = float(np.linalg.norm(place - start))
    return place - [0, 1, 0], f"has crept {way:.1f} m", way > 0.5


STACK_CAMERA = Camera((62, 34, 88), (0, 23, 0), 28.6)
CUBE_CAMERA = Camera((12.5, 7.8, 51), (0, 6.5, 0), 30.4)
SLOPE_CAMERA = Camera((10, 34, 92), (0, 10, 2), 34.0)
PYRAMID_CAMERA = Camera((116, 80, 370), (4, 46, 0), 29.6)
HEAP_CAMERA = Camera((150, 120, 430), (0, 8, 0), 37)
PAIRS = {
    "stack": Pair(stack_scene, STACK_CAMERA, deepest_overlap, 190, 1, 100),
    "cube": Pair(partial(scene, "cube"), CUBE_CAMERA, deepest_vertex, 121, 1, 121),
    "slope": Pair(partial(scene, "incline", friction=0.4), SLOPE_CAMERA, creeping_box, 350, 2),
    "pyramid": Pair(
        partial(scene, "pyramid", **RESTING), PYRAMID_CAMERA, top_of_pyramid, 300, 4, 140, WIDE
    ),
}
LABELS = (("basic step", VERMILION), ("soft step", GREEN))


def annotate(picture, pair, k, mark, note=""):
    """Draws the label of half k, the note, and the arrow of a mark `(point, word)`."""
    image = Image.fromarray(picture)
    draw, size = ImageDraw.Draw(image), image.size
    unit = size[0] / (32 if note else 21)
    small, large = ImageFont.load_default(1.3 * unit), ImageFont.load_default(1.7 * unit)
    draw.text((unit, 0.7 * unit), *LABELS[k], large)
    draw.text((size[0] - unit, 0.9 * unit), note, DARK, small, anchor="ra")
    if mark:
        tip, word = np.array(pair.camera.pixel(mark[0], size)), mark[1]
        side = -1 if tip[0] > size[0] * 2 / 3 else 1  # the label is on the left
        tail = tip + unit * np.array([4.8 * side, -2.6])
        draw.line([*tail, *tip], fill=VERMILION, width=round(unit / 5))
        along = (tip - tail) / np.linalg.norm(tip - tail)
        across = np.array([-along[1], along[0]])
        head = [tip, tip - unit * (along - across / 2), tip - unit * (along + across / 2)]
        draw.polygon([tuple(point) for point in head], fill=VERMILION)
        box = draw.textbbox(tuple(tail), word, font=small, anchor="ms")
        shift = max(0.5 * unit - box[0], 0) - max(box[2] + 0.5 * unit - size[0], 0)
        box = np.array(box) + [shift, -unit / 2, shift, -unit / 2]
        draw.rectangle([*(box[:2] - unit / 4), *(box[2:] + unit / 4)], fill=(255, 255, 255))
        draw.text((tail[0] + shift, tail[1] - unit / 2), word, VERMILION, small, anchor="ms")
    return np.asarray(image)


def view_of(simulation, camera, size, view=None):
    """Returns a SceneView of the simulation; Polyscope starts only once."""
    if view is None:
        backend = find_backend(window=False)
        if backend.name is None:
            sys.exit(f"cannot draw: {backend.reason}. {backend.remedy}")
        view = start_view(simulation, backend, PictureOptions(size))
    else:
        view.rebuild(simulation)
    camera.apply(view, size)
    return view


def studio_picture(simulation, camera, size, view=None):
    """Returns a picture in the studio look, and the view."""
    view = view_of(simulation, camera, size, view)
    view.studio = StudioLook(framesAnew=False)
    view.refresh()
    return take_picture(view), view


def halves_of(name):
    """Returns a picture of both halves of a pair."""
    pair, view, halves = PAIRS[name], None, []
    for k, simulation in pair.halves():
        for _ in range(pair.still):
            simulation.step()
        *mark, isMarked = pair.effect(simulation)
        if isMarked == bool(k):
            sys.exit(f"{name}, half {k}: {mark[1]}")
        picture, view = studio_picture(simulation, pair.camera, pair.size, view)
        halves.append(annotate(picture, pair, k, mark if isMarked else None))
    return np.concatenate((halves[0], np.full((pair.size[1], 12, 3), 255, np.uint8), halves[1]), 1)


def still(name):
    """Writes figures/<name>.jpg: both halves of a pair, or the heap from which engines start."""
    if name == "heap":
        picture, _ = studio_picture(heap_at_rest(SIZES[1]), HEAP_CAMERA, HEAP)
    else:
        picture = halves_of(name)
    with atomic_write(FOLDER / "figures" / f"{name}.jpg") as partial:
        Image.fromarray(picture).save(partial, "JPEG", quality=90, subsampling=0)


@silent
def videos():
    """Seconds of each video, rounded up, from which its effect stays in view; of one still."""
    numbers = {"pyramidStill": PAIRS["pyramid"].still * H}
    for name, pair in PAIRS.items():
        (_, simulation), first = next(pair.halves()), 0
        for step in range(pair.steps):
            simulation.step()
            if not pair.effect(simulation)[2]:
                first = step + 2
        numbers[name] = math.ceil(first / pair.every / RATE)
    return numbers


def tempo(pair):
    """Simulated seconds per second of the video, in words."""
    factor = pair.every * H * RATE
    return {0.5: "half speed", 1.0: "real time", 2.0: "double speed"}[factor]


def video(name):
    """Writes videos/<name>.mp4, whose last second stands still."""
    pair, view, halves = PAIRS[name], None, []
    for k, simulation in pair.halves():
        pictures = []
        view = view_of(simulation, pair.camera, VIDEO, view)
        for step in range(pair.steps + 1):
            if step % pair.every == 0:
                mark = None
                if simulation.report:
                    *mark, isMarked = pair.effect(simulation)
                    mark = mark if isMarked else None
                view.refresh()
                picture = take_picture(view, isStill=False)
                note = f"{step * H:.1f} s" if k else f"{tempo(pair)}  {step * H:.1f} s"
                pictures.append(annotate(picture, pair, k, mark, note))
            simulation.step()
        halves.append(pictures + RATE * pictures[-1:])
    target = FOLDER / "videos" / f"{name}.mp4"
    target.parent.mkdir(exist_ok=True)
    with atomic_write(target) as partial:
        encoder = Encoder(partial, (2 * VIDEO[0], VIDEO[1]), RATE, CODEC.split())
        for left, right in zip(*halves, strict=True):
            encoder.write(np.ascontiguousarray(np.concatenate((left, right), axis=1)))
        encoder.finish()


if __name__ == "__main__":
    for argument in sys.argv[2:]:
        {"still": still, "video": video}[sys.argv[1]](argument)
