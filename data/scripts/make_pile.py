"""Write a scene of N bodies that fall into a pile, to standard output or a file.

    python data/scripts/make_pile.py 1000 --out data/pile_1000-scene.txt
    python data/scripts/make_pile.py 1000 --heap --out heap-scene.txt

The bodies have random orientations and do not touch at the start. They lie on a jittered lattice of
four layers, which falls and covers the ground. With --heap they are packed bounding box to bounding
box into a block as high as wide, up to 130 m, which collapses. The scene recommends settings with
which the bodies come to rest. The same arguments give the same bytes. The scene must lie in data/,
beside its meshes. heap-scene.txt, pile_200-scene.txt and pile_1000-scene.txt are made here.
"""

import argparse
import math
import random
import sys
from pathlib import Path

import numpy as np
from make_data import RESTING, body, random_orientation, scene_lines, turn, write_lines
from meshes import MESHES

SHAPES = ["box", "tetrahedron", "octahedron", "cylinder"]
# Vertices (V, 3) about the centre of mass, which is their mean.
CENTRED = {name: MESHES[name][0] - MESHES[name][0].mean(axis=0) for name in SHAPES}
DENSITY = 50.0  # kg / m³
CLEARANCE = 1.0  # m between the lowest bodies and the ground
JITTER = 0.5  # m, the largest random shift along each axis
# Layers of a block. With more, the highest bodies fall longer and hit faster.
LAYERS = 4

# Per metre. A heap is packed in whole millimetres, so that sums are exact.
MILLIMETRES = 1000
# mm between neighbouring boxes, more than the rounding of their positions.
GAP = 2
# Fraction of the block that the boxes of a heap fill. Less makes the block larger.
FILL = 0.46
# m, the greatest height of a heap. Bodies that fall from higher up would be so fast that they pass
# through one another.
MOST_HEIGHT = 130.0


def shuffled(count, generator):
    """Return `count` names in random order, equally many of each shape."""
    order = [SHAPES[i % len(SHAPES)] for i in range(count)]
    generator.shuffle(order)
    return order


def make_pile(count, seed):
    """Return a list of `count` bodies on a lattice."""
    generator = random.Random(seed)
    diameters = [2 * float(np.linalg.norm(CENTRED[name], axis=1).max()) for name in SHAPES]
    pitch, side = max(diameters) + 2 * JITTER, math.ceil(math.sqrt(count / LAYERS))
    middle, bodies = (side - 1) / 2, []
    for i, shape in enumerate(shuffled(count, generator)):
        layer, place = divmod(i, side * side)
        row, column = divmod(place, side)
        x, y, z = (generator.uniform(-JITTER, JITTER) for _ in range(3))
        x, z = x + pitch * (column - middle), z + pitch * (row - middle)
        position = x, y + pitch * (layer + 0.5) + CLEARANCE, z
        bodies.append(body(shape, DENSITY, position, random_orientation(generator), decimals=3))
    return bodies


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


def make_heap(count, seed):
    """Return a list of `count` bodies in a block as high as wide, or MOST_HEIGHT high."""
    generator = random.Random(seed)
    order = shuffled(count, generator)
    turns = [random_orientation(generator) for _ in order]
    reaches = [turn(q, CENTRED[name]) for name, q in zip(order, turns, strict=True)]
    halves = np.array([np.ceil(MILLIMETRES * np.abs(one).max(axis=0)) for one in reaches]).astype(
        int
    )
    sides = 2 * halves + GAP
    volume = sides.prod(axis=1).sum() / FILL
    height = min(volume ** (1 / 3), MILLIMETRES * MOST_HEIGHT)
    width = max(math.sqrt(volume / height), sides.max())
    centres = pack_boxes(sides, width) + halves - [[width / 2, 0, width / 2]]
    positions = centres / MILLIMETRES + [[0, CLEARANCE, 0]]
    rows = zip(order, positions, turns, strict=True)
    return [body(name, DENSITY, place, q, decimals=3) for name, place, q in rows]


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("count", metavar="N", type=int, help="number of bodies")
    parser.add_argument("--heap", action="store_true", help="a dense block, as high as wide")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="random seed (default: 1)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="(default: standard output)")
    options = parser.parse_args()
    if options.count < 1:
        parser.error("N must be at least 1")
    make = make_heap if options.heap else make_pile
    lines = scene_lines(make(options.count, options.seed), RESTING)
    if options.out is None:
        sys.stdout.write("\n".join(lines) + "\n")
    else:
        write_lines(options.out, lines)


if __name__ == "__main__":
    main()
