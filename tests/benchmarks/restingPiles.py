"""Measures how piles rest with the soft-step solver.

    python tests/benchmarks/restingPiles.py [ROW …]

Bodies have friction 0.5 and restitution 0, a step is 0.02 s, and sleeping is off unless a row is
about it. Boxes are those of data/box.mesh, 12 × 6 × 8, or cubes of 2. Each line gives what was
measured and the goal. Penetration is measured on the final poses by the hull of the
Minkowski difference (tests/oracles.py), not by the solver's own test.
"""

import argparse
import copy
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarkPiles import make_heap
from oracles import BOX, body, box_body, ground, penetrations

from rbs.scenes.scenefiles import load_scene_file
from rbs.softstep.step import SolverState
from rbs.stepping.settings import SETTINGS
from RBSFunctions import run_timestep

SUBSTEPS = SETTINGS["substeps"].default


class Pile:
    """Meshes with the soft-step solver and its state."""

    def __init__(self, meshes, **settings):
        self.meshes, self.state = meshes, SolverState()
        self.settings = {"contactSolver": "soft-step", "mu": 0.5, "sleeping": False, **settings}
        self.start = self.positions()

    def run(self, steps):
        """Makes steps; returns the seconds of processor time of each."""
        seconds = []
        for _ in range(steps):
            begin = time.process_time()
            run_timestep(self.meshes, ground(), 0.02, 0.0, solverState=self.state, **self.settings)
            seconds.append(time.process_time() - begin)
        return np.array(seconds)

    def positions(self):
        return np.array([m.position[0] for m in self.meshes])

    def speeds(self):
        return np.linalg.norm([m.linVelocity[0] for m in self.meshes], axis=1)

    def tell(self, what, asked):
        """Prints how far the bodies have drifted and sunk, and how fast they are."""
        moved, speed = self.positions() - self.start, self.speeds().max()
        drift, sinks = np.hypot(*moved[:, [0, 2]].T).max(), -moved[:, 1].min()
        tell(what, f"drift {drift:.4f}, sinks {sinks:.3f}, speed {speed:.2g}", asked)


def tell(what, measured, asked):
    print(f"{what:<44} {measured}; to reach: {asked}", flush=True)


def stack():
    kinds = {"boxes": (6, BOX), "cubes": (2, (2, 2, 2))}
    for count, asked in ((10, "drift 0.01"), (20, "drift 0.02"), (40, "drift 0.1")):
        for name, (height, sides) in kinds.items():
            substeps = 20 if (count, name) == (40, "cubes") else SUBSTEPS
            boxes = [box_body(*sides, (0, (i + 0.5) * height, 0)) for i in range(count)]
            pile = Pile(boxes, substeps=substeps)
            pile.run(2000)
            pile.tell(f"stack of {count} {name}, {substeps} substeps", f"{asked}, speed 0.02")


def pyramid():
    for rows, asked in ((15, 1e-3), (30, 5e-3)):
        places = [(c - (rows - 1 - r) / 2, r) for r in range(rows) for c in range(rows - r)]
        pile = Pile([body("box", (12.2 * x, 3 + 6 * r, 0)) for x, r in places])
        pile.run(1000)
        pile.tell(f"pyramid of {rows} rows, 1000 steps", f"speed {asked:g}")


def masses():
    light = [box_body(2, 2, 2, (x, 1, z)) for x in (-2, 2) for z in (-2, 2)]
    heavy = box_body(6, 2, 6, (0, 3, 0), density=400 * 8 / 72)
    pile = Pile([*light, heavy])
    pile.run(1000)
    pile.tell("one of 100 times their mass on four cubes", "sinks 0.15, rests")
    for name, height, sides, substeps in (("boxes", 6, BOX, SUBSTEPS), ("cubes", 2, (2, 2, 2), 20)):
        places = [(0, (i + 0.5) * height, 0) for i in range(4)]
        boxes = [box_body(*sides, p, density=10.0**i) for i, p in enumerate(places)]
        pile = Pile(boxes, substeps=substeps)
        pile.run(1000)
        pile.tell(f"{name} of density 1 to 1000, {substeps} substeps", "stands")


def heap(count=1000):
    with tempfile.TemporaryDirectory() as folder:
        meshes = load_scene_file(make_heap(count, folder))
    pile = Pile(meshes)
    for steps, asked in ((600, "speed 0.01, p95 0.012, max 0.06"), (400, "speed 0.001")):
        seconds = pile.run(steps)
        depths = penetrations(meshes)
        speed, p95 = np.median(pile.speeds()), np.percentile(depths, 95)
        measured = f"median speed {speed:.4f}, penetration p95 {p95:.4f}, max {depths.max():.4f}"
        milliseconds = 1e3 * np.median(seconds[-50:])
        tell(f"heap of {count}, {steps} steps", f"{measured}, {milliseconds:.1f} ms", asked)


def asleep(count=1000, seeds=(4, 3, 2, 1)):
    shares = []
    for seed in seeds:
        with tempfile.TemporaryDirectory() as folder:
            meshes = load_scene_file(make_heap(count, folder, seed))
        pile = Pile(meshes)
        pile.run(600)
        pile.settings["sleeping"] = True
        pile.run(500)
        shares.append(100 * pile.state.sleep.isAsleep.mean())
    # the last heap's state without sleeping, in turns
    awake = Pile([copy.copy(mesh) for mesh in meshes])
    awake.state = SolverState.from_arrays(pile.state.arrays())
    seconds = np.array([(pile.run(1)[0], awake.run(1)[0]) for _ in range(100)])
    sleeping, awake = np.median(seconds[10:], axis=0)
    single = ", ".join(f"{share:.1f}" for share in shares)
    share = f"{np.mean(shares):.1f} % ({single})"
    measured = f"{share}, a step takes {sleeping / awake:.2f} of one awake"
    tell(f"{len(seeds)} heaps of {count} asleep 10 s after step 600", measured, "95 %, 0.3")


ROWS = {f.__name__: f for f in (stack, pyramid, masses, heap, asleep)}


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("rows", metavar="ROW", nargs="*", choices=[[], *ROWS], help=", ".join(ROWS))
    for name in parser.parse_args().rows or ROWS:
        ROWS[name]()


if __name__ == "__main__":
    main()
