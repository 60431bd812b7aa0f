"""What the basic step does that bodies do not: its known limits, in numbers.

    python tests/limits.py [NAME …] [--steps N]

Energy: how much of the start's, the ground being the zero of heights, the bodies gain at most with
restitution 1, in 1500 steps of 0.02 s. Spin: the angular velocity of a box of 2 m that turns at 10
rad/s flat on a fixed one, with friction 0.5, after 4 s. Ground: how far below it the constraints
press a vertex of the cube scene, in 500 steps and in the last 100 of them, and how far constraints
are violated; again, with every body lifted out of the ground once more after the constraints. Each
as the coursework has it, with --closing-only, and with --solver soft-step. README.md has this
table, and a test runs some of it again.
"""

import argparse
import sys
import warnings
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from oracles import box_body

from rbs.scenes import find_scene
from rbs.simulation import Settings, Simulation

WAYS = {
    "basic": {},
    "--closing-only": {"closingOnly": True},
    "--solver soft-step": {"contactSolver": "soft-step"},
}
ENERGY_STEPS, SPIN_STEPS, GROUND_STEPS = 1500, 200, 500


def simulation_of(meshes, **settings):
    """A `Simulation` of these meshes in place of those of a scene file."""
    simulation = Simulation(find_scene("singlebox"), Settings(**settings))
    simulation.meshes = meshes
    return simulation


def flat_cube(**settings):
    """A cube of 1 m that falls 1 m on its lower side."""
    return simulation_of([box_body(1.0, 1.0, 1.0, (0.0, 1.5, 0.0))], **settings)


def scene(name):
    return lambda **settings: Simulation(find_scene(name), Settings(**settings))


def energy_gain(make, steps, **settings):
    """The largest energy over the first `steps` steps, in % more than at the start."""
    simulation = make(restitution=1.0, **settings)
    start = largest = simulation.kinetic_energy() + simulation.potential_energy()
    for _ in range(steps):
        simulation.step()
        largest = max(largest, simulation.kinetic_energy() + simulation.potential_energy())
    return 100.0 * (largest / start - 1.0)


def spin_left(steps, **settings):
    """rad/s of a box that turned flat on a fixed one at 10 rad/s."""
    table = box_body(10.0, 2.0, 10.0, (0.0, 1.0, 0.0), isFixed=True)
    top = box_body(2.0, 2.0, 2.0, (0.0, 3.0, 0.0))
    top.angVelocity = np.array([[0.0, 10.0, 0.0]])
    simulation = simulation_of([table, top], restitution=0.0, friction=0.5, **settings)
    for _ in range(steps):
        simulation.step()
    return float(np.linalg.norm(top.angVelocity))


def depth_below_ground(steps, isPassedAgain=False, **settings):
    """`(deepest, deepest of the last fifth, violation)` of the cube scene, in m.

    The depth is that of its lowest vertex; the violation, of the constraints, the largest.
    isPassedAgain : whether every body that is in the ground after a step is lifted out of it
    """
    simulation = Simulation(find_scene("cube"), Settings(**settings))
    lowest, violation = [], 0.0
    for _ in range(steps):
        simulation.step()
        for mesh in simulation.meshes if isPassedAgain else ():
            height = min(0.0, mesh.lowest_vertex()[1])
            mesh.position = mesh.position - np.array([[0.0, height, 0.0]])
        lowest.append(simulation.lowest_point()[0])
        violation = max(violation, simulation.largest_violation())
    return *(max(0.0, -min(part)) for part in (lowest, lowest[-steps // 5 :])), violation


SCENES = {"flat cube": flat_cube} | {name: scene(name) for name in ("mixed", "tower", "stress")}


def measured(name, way, steps=None):
    """A number of the table, as text. name : of NAMES; way : of WAYS"""
    settings = WAYS[way]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if name == "spin":
            return f"{spin_left(steps or SPIN_STEPS, **settings):.1f} rad/s"
        if name.startswith("ground"):
            depths = depth_below_ground(steps or GROUND_STEPS, name == "ground again", **settings)
            return "{:.2f} m, at last {:.2f}; {:.3f} m".format(*depths)
        return f"{energy_gain(SCENES[name], steps or ENERGY_STEPS, **settings):.1f} %"


def row_of(name, steps=None):
    """A row of the table, as README.md has it."""
    return f"| {name} | {' | '.join(measured(name, way, steps) for way in WAYS)} |"


NAMES = (*SCENES, "spin", "ground", "ground again")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(NAMES)}")
    parser.add_argument("--steps", type=int, help="of each (default: as above)")
    options = parser.parse_args()
    if unknown := sorted(set(options.names) - set(NAMES)):
        parser.error(f"there is no {unknown[0]}; there are {', '.join(NAMES)}")
    print(f"| | {' | '.join(WAYS)} |\n|---|{'---|' * len(WAYS)}")
    for name in options.names or NAMES:
        print(row_of(name, options.steps), flush=True)


if __name__ == "__main__":
    main()
