"""Prints a hash of the state that scenes reach, to compare machines.

Two lines are the same exactly when every position, orientation and velocity has the same bits.
`--folders` runs all scenes of some folders instead, with default settings:

    python tests/campaigns/stateHashes.py --folders data ../shared/course --steps 500
"""

import argparse
import platform
import sys
from hashlib import sha256
from pathlib import Path

import numpy as np
import scipy

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from rbs.scenes.scenefiles import find_scene, list_scenes
from rbs.scenes.simulation import SceneSimulation, Settings

# Scene, steps, settings: contacts of all shapes, constraints, friction, contacts on arrays.
RUNS = (
    ("mixed", 300, {}),
    ("tower", 300, {}),
    ("stress", 150, {"friction": 0.4}),
    ("roll", 300, {"friction": 0.4, "gyroscopic": True}),
    ("cube", 200, {}),
    ("net", 30, {"constraintScheduling": "batches"}),
    ("pile_200", 80, {"contactScheduling": "batches"}),
)


def state_hash(scene, steps, settings):
    """The hash, as 32 hexadecimal digits, of the state after so many steps."""
    simulation = SceneSimulation(find_scene(scene), Settings(**settings))
    for _ in range(steps):
        simulation.step()
    content = b"".join(values.tobytes() for values in simulation.state().values())
    return sha256(content).hexdigest()[:32]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folders", metavar="DIR", nargs="+")
    parser.add_argument("--steps", metavar="N", type=int, default=500, help="with --folders")
    options = parser.parse_args()
    runs = RUNS
    if options.folders:
        paths = [path for folder in options.folders for path in list_scenes(folder)]
        runs = [(path, options.steps, {}) for path in paths]
    print(
        f"Python {platform.python_version()}, NumPy {np.__version__}, SciPy {scipy.__version__}, "
        f"{platform.system()} {platform.machine()}"
    )
    for scene, steps, settings in runs:
        what = " ".join([str(scene), str(steps), *(f"{k}={v}" for k, v in settings.items())])
        print(state_hash(scene, steps, settings), what, flush=True)


if __name__ == "__main__":
    main()
