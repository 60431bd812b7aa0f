"""Makes the report's videos, with close-ups, one file per section: `python report/videos.py NAME`.

Each consists of a few segments of a simulation. The times of the events that the captions name are
found from the states (`videos`, an experiment).
"""

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from experiments import heap_scene, lowest_vertices, overlap_and_sinking, silent
from pictures import RESTING, Camera, eight_boxes, thrown_cubes

from rbs.appearance.pictureoptions import PictureOptions
from rbs.pictures.backends import find_backend
from rbs.pictures.capture import start_view, take_picture
from rbs.recordings.encoder import Encoder
from rbs.scenes.files import atomic_write
from rbs.scenes.scenefiles import find_scene
from rbs.scenes.simulation import Settings, Simulation

FOLDER = Path(__file__).resolve().parent / "videos"
SIZE = (600, 380)
RATE = 25
MOST_BYTES = 400_000
# H.264 constant rate factors, tried in turn until the file is small enough.
QUALITIES = (24, 28, 31, 34, 37, 40)


class Segment(NamedTuple):
    """Steps `begin` to `end`, a picture every `every` steps, each held for `hold` frames.

    The text names an event; `event` tells whether it happens in a state.
    """

    what: str
    simulation: Simulation
    camera: Camera
    begin: int
    end: int
    every: int
    event: object
    hold: int = 1
    colouring: str = "body"


def scene(name, **settings):
    return Simulation(find_scene(name), Settings(**settings))


def movement():
    boxes, cubes = eight_boxes(), thrown_cubes()
    yield Segment(
        "overlap",
        boxes,
        Camera((25, 20, 38), (0, 10.5, 0), 36),
        0,
        130,
        1,
        lambda s: overlap_and_sinking(s.meshes[:8])[0] > 1.0,
    )
    yield Segment(
        "through",
        cubes,
        Camera((-4, 15, 25), (0.5, 4.5, 0.5), 42),
        0,
        14,
        1,
        lambda s: s.meshes[3].position[0, 0] > 1.5,
        hold=6,
    )


def post_hit(simulation):
    """Whether a box of the left chain touches a post in the scene of two chains."""
    posts = range(18, 26)
    return any(c.body1 in range(1, 9) and c.body2 in posts for c in simulation.report.contacts)


def constraints():
    yield Segment(
        "pressed",
        scene("cube"),
        Camera((11, 3.2, 20), (0, 3.4, 0), 40),
        95,
        220,
        1,
        lambda s: lowest_vertices(s).min() < -0.7,
    )
    chains = scene("two_chain")
    x, y, z = chains.meshes[20].position[0]
    yield Segment(
        "post", chains, Camera((x + 30, y + 18, z + 42), (x, y + 6, z), 40), 330, 430, 1, post_hit
    )


def friction():
    slopes = scene("incline", friction=0.4)
    start = slopes.meshes[1].position.copy()
    yield Segment(
        "slides",
        slopes,
        Camera((14, 26, 62), (0, 10, 0), 36),
        0,
        300,
        2,
        lambda s: np.linalg.norm(s.meshes[1].position - start) > 6.0,
    )


def scale():
    heap = Simulation(heap_scene(1000), Settings(broadPhase="grid", **RESTING))
    low = np.min([mesh.position[0] for mesh in heap.meshes], axis=0)
    high = np.max([mesh.position[0] for mesh in heap.meshes], axis=0)
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low))
    target = middle * [1, 0.55, 1]
    look = Camera(target + size * np.array([0.25, 0.28, 0.75]), target, 40)
    yield Segment(
        "collapses",
        heap,
        look,
        0,
        240,
        2,
        lambda s: max(m.position[0, 1] for m in s.meshes) < 0.7 * high[1],
    )


def resting():
    look = Camera((80, 56, 172), (4, 41, 0), 36)
    basic = scene("pyramid", broadPhase="grid", **RESTING)
    yield Segment(
        "falls", basic, look, 0, 280, 2, lambda s: max(m.position[0, 1] for m in s.meshes) < 75
    )
    soft = scene("pyramid", contactSolver="soft-step", **RESTING)
    yield Segment(
        "sleeps", soft, look, 0, 120, 2, lambda s: s.report.isAsleep.all(), colouring="sleep"
    )
    heap = Simulation(heap_scene(200), Settings(contactSolver="soft-step", **RESTING))
    yield Segment(
        "heapSleeps",
        heap,
        Camera((75, 60, 120), (0, 8, 0), 36),
        150,
        850,
        6,
        lambda s: s.report.isAsleep.mean() > 0.5,
        colouring="sleep",
    )


VIDEOS = {f.__name__: f for f in (movement, constraints, friction, scale, resting)}


def frames(name):
    """Steps through a video; yields `(Segment, isNew)` for every picture."""
    for segment in VIDEOS[name]():
        isNew = True
        while True:
            step = segment.simulation.stepCount
            if step >= segment.begin and (step - segment.begin) % segment.every == 0:
                yield segment, isNew
                isNew = False
            if step >= segment.end:
                break
            segment.simulation.step()


NEVER = "never"  # of an event that does not happen, which contradicts the caption


def clock(frame):
    """Formats the time of a frame in minutes and seconds, as a player does."""
    seconds = int(frame / RATE)
    return f"{seconds // 60}:{seconds % 60:02d}"


@silent
def videos():
    """Times of the events: the first frame of each segment in which its event happens."""
    numbers = {}
    for name in VIDEOS:
        frame, seen, shown = 0, {}, set()
        for segment, _ in frames(name):
            shown.add(segment.what)
            if (
                segment.what not in seen
                and segment.simulation.report
                and segment.event(segment.simulation)
            ):
                seen[segment.what] = clock(frame)
            frame += segment.hold
        numbers |= {what: seen.get(what, NEVER) for what in shown}
        numbers[f"{name}Length"] = clock(frame)
    return numbers


def make(name):
    """Writes videos/<name>.mp4, of at most MOST_BYTES."""
    backend = find_backend(window=False)
    if backend.name is None:
        sys.exit(f"cannot draw videos: {backend.reason}. {backend.remedy}")
    view, pictures = None, []
    for segment, isNew in frames(name):
        if view is None:
            options = PictureOptions(SIZE)
            view = start_view(segment.simulation, backend, options)
        elif isNew:
            view.rebuild(segment.simulation)
        if isNew:
            view.colouring = segment.colouring
            segment.camera.apply(view)
        view.refresh()
        pictures += segment.hold * [take_picture(view, isStill=False)]
    FOLDER.mkdir(exist_ok=True)
    with atomic_write(FOLDER / f"{name}.mp4") as partial:
        for quality in QUALITIES:
            encoder = Encoder(
                partial,
                SIZE,
                RATE,
                (
                    "-vcodec",
                    "libx264",
                    "-pix_fmt",
                    "yuv420p",
                    "-crf",
                    str(quality),
                    "-preset",
                    "slow",
                    "-movflags",
                    "+faststart",
                ),
            )
            for picture in pictures:
                encoder.write(picture)
            encoder.finish()
            size = partial.stat().st_size
            if size <= MOST_BYTES:
                break
        else:
            sys.exit(f"video {name} has {size} bytes, more than the {MOST_BYTES} allowed")
    print(f"{name}: {len(pictures)} frames, quality {quality}, {size / 1e3:.0f} kB", flush=True)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        make(name)
