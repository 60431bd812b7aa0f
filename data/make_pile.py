"""Write a scene of N bodies that fall into a pile: `python data/make_pile.py N > FILE-scene.txt`.

    python data/make_pile.py 1000 --out data/pile_1000-scene.txt
    python data/make_pile.py 1000 --spread --shapes box octahedron --seed 7 --out wide-scene.txt
    python data/make_pile.py 1000 --heap --out heap-scene.txt

The bodies are turned at random and do not touch at the start. They stand on a jittered lattice: a
block of four layers, which drops and carpets the ground after 250 steps of 0.02 s, or with --spread
a single layer with little to collide with. With --heap they are packed bounding box to bounding box
into a block as high as wide, up to 130 m, which within 200 steps collapses into a heap, with
friction one of 2 to 3 contacts a body. They suggest the settings with which they come to rest. The
same arguments give the same bytes. The meshes are those of this folder, so the scene has to lie
here. heap-scene.txt, pile_200-scene.txt and pile_1000-scene.txt are made here.
"""

import argparse
import math
import random
import sys
from pathlib import Path

import numpy as np
from make_data import (
    MESHES,
    RESTING,
    Body,
    random_orientation,
    scene_lines,
    suggestion_line,
    turn,
    write_lines,
)

PILE_SHAPES = ["box", "tetrahedron", "octahedron", "cylinder"]
DENSITY = 50.0  # kg / m³
CLEARANCE = 1.0  # metres between the lowest bodies and the ground
JITTER = 0.5  # metres, along each axis, up and down
# Layers of a block. Of more, the highest would fall for longer, and hit at higher speeds.
LAYERS = 4
# Neighbours of a single layer are this many times as far apart as those of a block.
SPREAD = 2.0

# A heap is packed in whole millimetres, so that sums are exact.
MILLIMETRES = 1000
# Millimetres between boxes that face each other: a position is rounded by half of one.
GAP = 2
# What the boxes of a heap fill of the block that they are packed into.
FILL = 0.46
# Metres. From there bodies reach 50 m/s, which is 1 m in a step of 0.02 s; from higher up, they
# would begin to pass through one another.
MOST_HEIGHT = 130.0


def diameter(name):
    """Twice the largest distance of a vertex from the middle of the corners, in metres."""
    vertices = MESHES[name][0]
    return 2 * float(np.linalg.norm(vertices - vertices.mean(axis=0), axis=1).max())


def shuffled(shapes, count, generator):
    """`count` names, the shapes taking turns in random order."""
    order = [shapes[i % len(shapes)] for i in range(count)]
    generator.shuffle(order)
    return order


def make_pile(count, shapes, isSpread, seed):
    """A list of `count` bodies on a lattice.

    count : int ≥ 1; shapes : names of MESHES; isSpread : a layer instead of a block; seed : int
    """
    generator = random.Random(seed)
    pitch = max(map(diameter, shapes)) + 2 * JITTER
    side = math.ceil(math.sqrt(count if isSpread else count / LAYERS))
    if isSpread:
        pitch *= SPREAD
    bodies = []
    for i, shape in enumerate(shuffled(shapes, count, generator)):
        layer, place = divmod(i, side * side)
        row, column = divmod(place, side)
        middle = (side - 1) / 2
        jitter = [generator.uniform(-JITTER, JITTER) for _ in range(3)]
        position = (
            round(pitch * (column - middle) + jitter[0], 3),
            round(pitch * (layer + 0.5) + CLEARANCE + jitter[1], 3),
            round(pitch * (row - middle) + jitter[2], 3),
        )
        bodies.append(Body(f"{shape}.mesh", DENSITY, position, random_orientation(generator)))
    return bodies


def half_sides(name, orientation):
    """Half the sides (3,) of a bounding box of a turned mesh, in whole millimetres.

    The box is centred at the centre of mass, which all meshes have in the middle of their corners,
    and so reaches as far to either side as the mesh does to one.
    """
    vertices = MESHES[name][0]
    turned = turn(orientation, vertices - vertices.mean(axis=0))
    return np.ceil(MILLIMETRES * np.abs(turned).max(axis=0)).astype(int)


def pack_boxes(sides, width):
    """Places boxes in a block: the least corners (n, 3), in whole millimetres.

    sides : (n, 3), in millimetres; width : of the block along x and z, at least that of the boxes

    The boxes stand side by side in rows along x, as words do in lines. Each is pushed back, against
    the direction of z, to what stands in its layer, and then comes down, against that of y, to what
    lies below. A layer ends where the next box would jut out of the block.
    """
    low, high = np.zeros_like(sides), np.zeros_like(sides)
    layer = x = 0  # the first box of the layer; where the next one goes
    for i, side in enumerate(sides):
        if x + side[0] > width:
            x = 0
        behind = (low[layer:i, 0] < x + side[0]) & (high[layer:i, 0] > x)
        z = high[layer:i, 2][behind].max(initial=0)
        if z + side[2] > width:
            layer, x, z = i, 0, 0
        below = (low[:i, 0] < x + side[0]) & (high[:i, 0] > x)
        below &= (low[:i, 2] < z + side[2]) & (high[:i, 2] > z)
        low[i] = x, high[:i, 1][below].max(initial=0), z
        high[i] = low[i] + side
        x += side[0]
    return low


def make_heap(count, shapes, seed):
    """A list of `count` bodies packed into a block that is as high as wide, or MOST_HEIGHT high.

    count : int ≥ 1; shapes : names of MESHES; seed : int
    """
    generator = random.Random(seed)
    order = shuffled(shapes, count, generator)
    orientations = [random_orientation(generator) for _ in order]
    halves = np.array([half_sides(*body) for body in zip(order, orientations, strict=True)])
    sides = 2 * halves + GAP
    volume = sides.prod(axis=1).sum() / FILL
    height = min(volume ** (1 / 3), MILLIMETRES * MOST_HEIGHT)
    width = max(math.sqrt(volume / height), sides.max())
    centres = pack_boxes(sides, width) + halves - [[width / 2, 0, width / 2]]
    positions = centres / MILLIMETRES + [[0, CLEARANCE, 0]]
    return [
        Body(f"{shape}.mesh", DENSITY, tuple(round(x, 3) for x in position.tolist()), orientation)
        for shape, position, orientation in zip(order, positions, orientations, strict=True)
    ]


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("count", metavar="N", type=int, help="number of bodies")
    parser.add_argument(
        "--shapes",
        nargs="+",
        default=PILE_SHAPES,
        choices=MESHES,
        metavar="NAME",
        help=f"of {', '.join(MESHES)} (default: {' '.join(PILE_SHAPES)})",
    )
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument("--spread", action="store_true", help="one wide layer, not a block")
    kind.add_argument("--heap", action="store_true", help="a dense block, as high as wide")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="(default: 1)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="(default: to standard output)")
    options = parser.parse_args()
    if options.count < 1:
        parser.error("N has to be at least 1")
    if options.heap:
        bodies = make_heap(options.count, options.shapes, options.seed)
    else:
        bodies = make_pile(options.count, options.shapes, options.spread, options.seed)
    lines = [suggestion_line(RESTING), *scene_lines(bodies)]
    if options.out is None:
        sys.stdout.write("\n".join(lines) + "\n")
    else:
        write_lines(options.out, lines)


if __name__ == "__main__":
    main()
