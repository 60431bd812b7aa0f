"""Prints a hash of the state that scenes reach, to compare machines: `python tests/stateHashes.py`.

Two lines are the same exactly when every position, orientation and velocity has the same bits.
`--only` runs the scenes whose names are given.
"""

import argparse
import platform
import sys
from pathlib import Path

import numpy as np
import scipy

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rbs.scenes import find_scene
from rbs.simulation import Settings, Simulation
from rbs.state import hash_of

# Scene, steps, settings: contacts of all shapes, constraints, friction, the arrays of the grid.
RUNS = (
    ("mixed", 300, {}),
    ("tower", 300, {}),
    ("stress", 150, {"friction": 0.4}),
    ("roll", 300, {"friction": 0.4, "closingOnly": True}),
    ("cube", 200, {}),
    ("net", 30, {"constraintScheduling": "batches"}),
    ("pile_200", 80, {"broadPhase": "grid"}),
)


def state_hash(scene, steps, settings):
    """The hash, as 32 hexadecimal digits, of the state after so many steps."""
    simulation = Simulation(find_scene(scene), Settings(**settings))
    for _ in range(steps):
        simulation.step()
    return hash_of(simulation.state()).tobytes().hex()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", metavar="SCENE", nargs="+")
    only = parser.parse_args().only
    print(f"Python {platform.python_version()}, NumPy {np.__version__}, SciPy {scipy.__version__}, "
          f"{platform.system()} {platform.machine()}")
    for scene, steps, settings in RUNS:
        if only is None or scene in only:
            what = " ".join([scene, str(steps), *(f"{k}={v}" for k, v in settings.items())])
            print(state_hash(scene, steps, settings), what, flush=True)


if __name__ == "__main__":
    main()
