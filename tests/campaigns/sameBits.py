"""Steps scenes pair by pair, by the grid and in batches, and compares the states bit by bit.

    python tests/campaigns/sameBits.py [SCENE …] [--steps 500] [--mu 0.4]

Scenes are files or names; without any, all those of data/ apart from the largest pile are run. A
scene's constraints are used. Prints a line a scene; exit code 1 if one differs, in the state or in
the contacts that the step reports.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from oracles import outcome

from rbs.scenes.scenefiles import DATA_FOLDER, find_scene
from rbs.scenes.simulation import SceneSimulation, Settings

# Ways to make the same step.
WAYS = {"all": {}, "grid": {"broadPhase": "grid"}, "batches": {"contactScheduling": "batches"}}


def compare(scene, steps, mu):
    """`(bodies, contacts, step, seconds)`: contacts between bodies; step, the first that differs.

    seconds : the median time of a step, in each of the WAYS
    """
    simulations = [
        SceneSimulation(find_scene(scene), Settings(friction=mu, **way)) for way in WAYS.values()
    ]
    contacts, seconds = 0, []
    for step in range(1, steps + 1):
        spent = []
        for simulation in simulations:
            start = time.perf_counter()
            simulation.step()
            spent.append(time.perf_counter() - start)
        seconds.append(spent)
        outcomes = [outcome(simulation.meshes, simulation.report) for simulation in simulations]
        if any(other != outcomes[0] for other in outcomes):
            return len(simulations[0].meshes), contacts, step, np.median(seconds, axis=0)
        contacts += sum(contact.body2 >= 0 for contact in simulations[0].report.contacts)
    return len(simulations[0].meshes), contacts, None, np.median(seconds, axis=0)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", metavar="SCENE")
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--mu", type=float, default=0.0)
    options = parser.parse_args()
    paths = [str(path) for path in sorted(DATA_FOLDER.glob("*-scene.txt"))]
    # hours, pair by pair
    scenes = options.scenes or [p for p in paths if "pile_1000" not in p and "heap-" not in p]
    print(f"{'scene':28} {'bodies':>6} {'contacts':>8}   ms a step: {', '.join(WAYS)}   same bits")
    differs = False
    for scene in scenes:
        bodies, contacts, step, seconds = compare(scene, options.steps, options.mu)
        name = Path(scene).name.removesuffix("-scene.txt")
        verdict = f"yes, {options.steps} steps" if step is None else f"NO, from step {step}"
        print(
            f"{name:28} {bodies:6d} {contacts:8d}  "
            + "".join(f" {1e3 * one:9.2f}" for one in seconds)
            + f"   {verdict}",
            flush=True,
        )
        differs |= step is not None
    return int(differs)


if __name__ == "__main__":
    sys.exit(main())
