"""Draws the gallery: `python report/gallery.py [NAME ...]`, such as `heap` or `wall.mp4`.

Every picture is in the studio look, drawn at twice its size and scaled down. A shot without a
camera is framed as by the command line, to which report/README.md gives the arguments.
"""

from rbs.scenes.messages import prepare

if __name__ == "__main__":
    prepare()

from functools import partial
from pathlib import Path

import numpy as np
from staging import Shot, choose, still, video

from RigidBodySimulation import Settings, Simulation

FOLDER = Path(__file__).resolve().parent / "gallery"
SIZE, DRAWN = (960, 540), (1920, 1080)
# Colours by the beginning of a mesh's name.
SHAPES = {"cylinder": "2a6f97", "box": "e9c46a", "tet": "e76f51", "oct": "f4a261"}
SHAPES |= {"ell": "61a5c2", "long": "8ab17d"}
BRICKS = "a8482f b85a3a c46a45 9c3f2c b04e38 c97b57".split()
SUNSET = "f2e2b0 efb366 dd7a4f b04a5a 6d3b66 2f3d6b".split()
IRON, STEEL, STONE = "33383f", "8c8f94", "a9a7a2"


def rgb(colours):
    """Returns hexadecimal colours as numbers from 0 to 1, (n, 3)."""
    return np.array([list(bytes.fromhex(colour)) for colour in colours]) / 255.0


def by_shape(meshes):
    """A colour for each shape; fixed bodies are grey."""
    names = [next((key for key in SHAPES if mesh.name.startswith(key)), "box") for mesh in meshes]
    return rgb(STEEL if m.isFixed else SHAPES[key] for key, m in zip(names, meshes, strict=True))


def in_brick(meshes):
    """Brick reds for boxes, iron for the ball, steel for its chain."""
    own, some = {"ball": IRON, "octahedron": STEEL}, np.random.default_rng(3)
    kinds = [mesh.name.split()[0] for mesh in meshes]
    return rgb(own.get(kind, BRICKS[some.integers(len(BRICKS))]) for kind in kinds)


def in_stone(meshes):
    """Greys that differ by a few per cent, so that joints show."""
    shade = 1.0 + 0.14 * np.sin(7.0 * np.arange(len(meshes)))
    return rgb([STONE]) * shade[:, None]


def along_row(meshes):
    """Blends from the first body to the last."""
    place = np.linspace(0.0, len(SUNSET) - 1.0, len(meshes))
    return np.stack([np.interp(place, range(len(SUNSET)), c) for c in rgb(SUNSET).T], axis=1)


def shot(scene, *moments, camera=None, settings=None, **others):
    """Returns a `Shot` without a band of a scene, by default with the settings it recommends."""
    make = partial(Simulation, scene, settings)
    return Shot({"": make}, camera, size=DRAWN, moments=moments, **others)


FORCES, SPEEDS = ("contacts", "impulses", "friction impulses"), ("velocities",)
RUBBED = Settings(friction=0.5)
BEHIND, ABOVE = ((3, 3, 41), (12.5, 16, 0), 48), ((80, 66, 182), (-2, 6, 8), 32.5)
PICTURES = {
    "wrecking_ball": shot("wrecking_ball", 289, camera=BEHIND, colours=in_brick),
    "net": shot("net", 140),
    "pile": shot("pile_200", 150, camera=((108, 74, 246), (-2, 6, 0), 31), colours=by_shape),
    "stress": shot("stress", 130, settings=RUBBED, camera=ABOVE, colours=by_shape, shown=SPEEDS),
    "heap": shot("heap", 600, camera=((150, 100, 300), (-9, 3, 1.7), 37)),
    "card_house": shot("card_house", 15, camera=((34, 18, 84), (0, 19.3, 0), 31), shown=FORCES),
    "arch": shot("arch", 40, camera=((24, 16, 96), (0, 22, 0), 34), colours=in_stone, shown=FORCES),
    "arch_blow": shot("arch_blow", 190),
    "dominoes": shot("dominoes", 150, colours=along_row),
    "wall": shot("wall", 302, camera=((-30, 6, -86), (0, 27.5, 0), 51), colours=in_brick),
}
WIDE_WALL = (-52, 20, -205), (4, 27, -20), 29
LARGE = {"size": (1280, 720)}
VIDEOS = {
    "wall.mp4": PICTURES["wall"]._replace(camera=WIDE_WALL, steps=range(210, 461, 2), **LARGE),
    "dominoes.mp4": PICTURES["dominoes"]._replace(steps=range(0, 401, 2), **LARGE),
}

if __name__ == "__main__":
    for name in choose((*PICTURES, *VIDEOS), __doc__.splitlines()[0]):
        if name in VIDEOS:
            video(VIDEOS[name], FOLDER / name, 20)
        else:
            still(PICTURES[name], FOLDER / f"{name}.jpg", SIZE, 95)
