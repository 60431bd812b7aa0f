"""Write a scene of N bodies that fall into a pile, to standard output or a file.

    python data/scripts/make_pile.py 1000 --out data/pile_1000-scene.txt
    python data/scripts/make_pile.py 1000 --spread --shapes box octahedron --seed 7 --out wide.txt
    python data/scripts/make_pile.py 1000 --heap --out heap-scene.txt

The bodies have random orientations and do not touch at the start. They lie on a jittered lattice: a
block of four layers, which falls and covers the ground, or with --spread a single wide layer with
few collisions. With --heap they are packed bounding box to bounding box into a block as high as
wide, up to 130 m, which collapses into a heap. The scene recommends settings with which the bodies
come to rest. The same arguments give the same bytes. The scene must lie in data/, beside its
meshes. heap-scene.txt, pile_200-scene.txt and pile_1000-scene.txt are made here.
"""

import argparse
import math
import random
import sys
from pathlib import Path

import numpy as np
from make_data import MESHES, RESTING, Body, random_orientation, scene_lines, turn, write_lines

PILE_SHAPES = ["box", "tetrahedron", "octahedron", "cylinder"]
DENSITY = 50.0  # kg / m³
CLEARANCE = 1.0  # m between the lowest bodies and the ground
JITTER = 0.5  # m, the largest random shift along each axis
# Layers of a block. With more, the highest bodies fall longer and hit faster.
LAYERS = 4
# Distance of neighbours in a single layer, relative to a block.
SPREAD = 2.0

# Per metre. A heap is packed in whole millimetres, so that sums are exact.
MILLIMETRES = 1000
# mm between neighbouring boxes, more than the rounding of their positions.
GAP = 2
# Fraction of the block that the boxes of a heap fill. Less makes the block larger.
FILL = 0.46
# m, the greatest height of a heap. Bodies that fall from higher up would be so fast that they pass
# through one another.
MOST_HEIGHT = 130.0


def diameter(name):
    """Return twice the largest distance, in metres, of a vertex from the mean of the vertices."""
    vertices = MESHES[name][0]
    return 2 * float(np.linalg.norm(vertices - vertices.mean(axis=0), axis=1).max())


def shuffled(shapes, count, generator):
    """Return `count` names in random order, equally many of each shape."""
    order = [shapes[i % len(shapes)] for i in range(count)]
    generator.shuffle(order)
    return order


def make_pile(count, shapes, isSpread, seed):
    """Return a list of `count` bodies on a lattice.

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
    """Return half the sides (3,) of the bounding box of a rotated mesh, in whole millimetres.

    The box is centred at the centre of mass, which is the mean of the vertices in all meshes.
    """
    vertices = MESHES[name][0]
    turned = turn(orientation, vertices - vertices.mean(axis=0))
    return np.ceil(MILLIMETRES * np.abs(turned).max(axis=0)).astype(int)


def pack_boxes(sides, width):
    """Packs boxes into a block. Returns their least corners (n, 3), in whole millimetres.

    sides : (n, 3), in millimetres; width : of the block along x and z, at least that of the boxes

    The boxes stand side by side in rows along x, like words in lines. Each is pushed along -z until
    it meets a box of its layer, and then drops along -y onto the boxes below. A new layer begins
    when the next box would project from the block.
    """
    low, high = np.zeros_like(sides), np.zeros_like(sides)
    layer = x = 0  # the first box of the layer; the position of the next
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
    """Return a list of `count` bodies in a block as high as wide, or MOST_HEIGHT high.

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
    form = {"nargs": "+", "default": PILE_SHAPES, "choices": MESHES, "metavar": "NAME"}
    text = f"shapes, of {', '.join(MESHES)} (default: {' '.join(PILE_SHAPES)})"
    parser.add_argument("--shapes", **form, help=text)
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument("--spread", action="store_true", help="one wide layer, not a block")
    kind.add_argument("--heap", action="store_true", help="a dense block, as high as wide")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="random seed (default: 1)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="(default: standard output)")
    options = parser.parse_args()
    if options.count < 1:
        parser.error("N must be at least 1")
    if options.heap:
        bodies = make_heap(options.count, options.shapes, options.seed)
    else:
        bodies = make_pile(options.count, options.shapes, options.spread, options.seed)
    lines = scene_lines(bodies, RESTING)
    if options.out is None:
        sys.stdout.write("\n".join(lines) + "\n")
    else:
        write_lines(options.out, lines)


if __name__ == "__main__":
    main()
