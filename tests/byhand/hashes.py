"""Prints a hash of the state that scenes reach, to compare machines and versions of the program.

Two lines are the same exactly when every position, orientation and velocity has the same bits.
"""

from hashlib import sha256

from benchmark import describe_machine

from rbs.scenes.messages import InputError
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


def main(options):
    print(describe_machine())
    found = [(path, 500, {}) for folder in options.folders for path in list_scenes(folder)]
    if options.folders and not found:
        raise InputError(f"no scenes in {', '.join(options.folders)}")
    for scene, steps, settings in found or RUNS:
        simulation = SceneSimulation(find_scene(scene), Settings(**settings))
        for _ in range(steps):
            simulation.step()
        content = b"".join(values.tobytes() for values in simulation.state().values())
        words = [str(scene), str(steps), *(f"{name}={value}" for name, value in settings.items())]
        print(sha256(content).hexdigest()[:32], *words, flush=True)
