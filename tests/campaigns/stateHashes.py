"""Prints a hash of the state that scenes reach, to compare machines and versions of the program.

    python tests/campaigns/stateHashes.py                                   seven runs
    python tests/campaigns/stateHashes.py data ../shared/course             500 steps of all scenes

Two lines are the same exactly when every position, orientation and velocity has the same bits.
"""

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

versions = f"NumPy {np.__version__}, SciPy {scipy.__version__}"
print(f"Python {platform.python_version()}, {versions}, {platform.system()} {platform.machine()}")
folders = map(list_scenes, sys.argv[1:])
for scene, steps, settings in [(path, 500, {}) for paths in folders for path in paths] or RUNS:
    simulation = SceneSimulation(find_scene(scene), Settings(**settings))
    for _ in range(steps):
        simulation.step()
    content = b"".join(values.tobytes() for values in simulation.state().values())
    words = [str(scene), str(steps), *(f"{name}={value}" for name, value in settings.items())]
    print(sha256(content).hexdigest()[:32], *words, flush=True)
