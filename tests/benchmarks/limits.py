"""The known errors of the basic step, in numbers.

    python tests/benchmarks/limits.py [NAME …]

Each is measured in the basic step, with --closing-only, and with --solver soft-step.
tests/README.md has this table and explains the rows; a test runs some of them again.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from oracles import box_body

from rbs.scenes.scenefiles import find_scene
from rbs.scenes.simulation import SceneSimulation, Settings

WAYS = {
    "basic": {},
    "--closing-only": {"closingOnly": True},
    "--solver soft-step": {"contactSolver": "soft-step"},
}
NAMES = ("flat cube", "mixed", "tower", "stress", "spin", "ground")


def energy_gain(name, **settings):
    """The largest energy over 1500 steps, in % more than at the start, as text.

    name : a scene, or "flat cube" for a cube of 1 m that falls 1 m on its lower side
    """
    scene = find_scene("singlebox" if name == "flat cube" else name)
    simulation = SceneSimulation(scene, Settings(restitution=1.0, **settings))
    if name == "flat cube":
        simulation.meshes = [box_body(1.0, 1.0, 1.0, (0.0, 1.5, 0.0))]
    energies = []
    for _ in range(1501):
        energies.append(simulation.kinetic_energy() + simulation.potential_energy())
        simulation.step()
    return f"{100.0 * (max(energies) / energies[0] - 1.0):.1f} %"


def spin_left(**settings):
    """The angular velocity of a box that turned flat on a fixed one, as text."""
    top = box_body(2.0, 2.0, 2.0, (0.0, 3.0, 0.0))
    top.angVelocity = np.array([[0.0, 10.0, 0.0]])
    settings = Settings(restitution=0.0, friction=0.5, **settings)
    simulation = SceneSimulation(find_scene("singlebox"), settings)
    simulation.meshes = [box_body(10.0, 2.0, 10.0, (0.0, 1.0, 0.0), isFixed=True), top]
    for _ in range(200):
        simulation.step()
    return f"{np.linalg.norm(top.angVelocity):.1f} rad/s"


def depth_below_ground(steps, **settings):
    """Depth of the cube scene's lowest vertex, at most and in the last fifth, as text."""
    simulation = SceneSimulation(find_scene("cube"), Settings(**settings))
    depths, violation = [], 0.0
    for _ in range(steps):
        simulation.step()
        depths.append(max(0.0, -simulation.lowest_point()[0]))
        violation = max(violation, simulation.largest_violation())
    return f"{max(depths):.2f} m, at last {max(depths[-steps // 5 :]):.2f}; {violation:.3f} m"


def row_of(name):
    """A row of the table, as in tests/README.md."""
    cells = []
    for settings in WAYS.values():
        if name == "spin":
            cells.append(spin_left(**settings))
        elif name == "ground":
            cells.append(depth_below_ground(500, **settings))
        else:
            cells.append(energy_gain(name, **settings))
    return f"| {name} | {' | '.join(cells)} |"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(NAMES)}")
    print(f"| | {' | '.join(WAYS)} |\n|---|{'---|' * len(WAYS)}")
    for name in parser.parse_args().names or NAMES:
        print(row_of(name), flush=True)


if __name__ == "__main__":
    main()
