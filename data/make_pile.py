"""Write a scene of N bodies that fall into a pile: `python data/make_pile.py N > FILE-scene.txt`.

    python data/make_pile.py 1000 --out data/pile_1000-scene.txt
    python data/make_pile.py 1000 --spread --shapes box octahedron --seed 7 --out wide-scene.txt

The bodies stand on a lattice, jittered and turned at random, and do not touch at the start: a block
of four layers, which drops and lies on the ground in a heap after 250 steps of 0.02 s, or with
--spread a single layer with little to collide with. The same arguments give the same bytes. The
meshes are those of this folder, so the scene has to lie here.
"""

import argparse
import math
import random
import sys
from pathlib import Path

import numpy as np
from make_data import MESHES, Body, random_orientation, scene_lines, write_lines

PILE_SHAPES = ["box", "tetrahedron", "octahedron", "cylinder"]
DENSITY = 50.0          # kg / m³
CLEARANCE = 1.0         # metres between the lowest bodies and the ground
JITTER = 0.5            # metres, along each axis, up and down
# Layers of a block. Of more, the highest would fall for longer, and hit at higher speeds.
LAYERS = 4
# Neighbours of a single layer are this many times as far apart as those of a block.
SPREAD = 2.0


def diameter(name):
    """Twice the largest distance of a vertex from the middle of the corners, in metres."""
    vertices = MESHES[name][0]
    return 2 * float(np.linalg.norm(vertices - vertices.mean(axis=0), axis=1).max())


def make_pile(count, shapes, isSpread, seed):
    """A list of `count` bodies, the shapes taking turns in random order.

    count : int ≥ 1; shapes : names of MESHES; isSpread : a layer instead of a block; seed : int
    """
    generator = random.Random(seed)
    pitch = max(map(diameter, shapes)) + 2 * JITTER
    side = math.ceil(math.sqrt(count if isSpread else count / LAYERS))
    if isSpread:
        pitch *= SPREAD
    order = [shapes[i % len(shapes)] for i in range(count)]
    generator.shuffle(order)
    bodies = []
    for i, shape in enumerate(order):
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


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("count", metavar="N", type=int, help="number of bodies")
    parser.add_argument("--shapes", nargs="+", default=PILE_SHAPES, choices=MESHES, metavar="NAME",
                        help=f"of {', '.join(MESHES)} (default: {' '.join(PILE_SHAPES)})")
    parser.add_argument("--spread", action="store_true", help="one wide layer, not a block")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="(default: 1)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="(default: to standard output)")
    options = parser.parse_args()
    if options.count < 1:
        parser.error("N has to be at least 1")
    lines = scene_lines(make_pile(options.count, options.shapes, options.spread, options.seed))
    if options.out is None:
        sys.stdout.write("\n".join(lines) + "\n")
    else:
        write_lines(options.out, lines)


if __name__ == "__main__":
    main()
