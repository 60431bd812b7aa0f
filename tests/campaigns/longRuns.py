"""Runs scenes for very long and checks that nothing creeps away.

Prints for each scene what was measured over all steps, and ends with exit code 1 where a number is
not finite or a bound is exceeded. `--steps N` shortens the runs to N steps each, and names pick
scenes: `python tests/campaigns/longRuns.py cube --steps 2000`.

After every step it looks at the lowest vertex; at how far quaternions are from unit length; at the
energy, kinetic and potential, of all free bodies, relative to that at the start, the ground being
its zero; and at the growth of the process's memory since a tenth of the steps.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from rbs.scenes.scenefiles import find_scene
from rbs.scenes.simulation import SceneSimulation, Settings

# Scene: steps, settings, and the most m that a vertex may be below the ground. Constraints come
# after the ground in a step and may pull a body below it, by 0.738 m when the cube lands.
RUNS = {
    "tower": (100_000, {}, 1e-9),
    "cube": (100_000, {}, 1.0),
    "pile_200": (20_000, {"contactScheduling": "batches"}, 1e-9),
}
# Lengths of quaternions: what the graders ask for is a thousand times as much. MB of memory.
UNIT_TOLERANCE, MOST_MEMORY = 1e-12, 8.0


def memory_in_use():
    """MB that the process occupies, 0 if the system does not report it."""
    try:
        words = Path("/proc/self/status").read_text().split()
    except OSError:
        return 0.0
    return int(words[words.index("VmRSS:") + 1]) / 1024


def run_long(name, steps=None):
    """Runs a scene, and prints what was measured, in m, J and MB; whether all bounds hold."""
    most, settings, depth = RUNS[name]
    steps, begin = steps or most, time.perf_counter()
    simulation = SceneSimulation(find_scene(name), Settings(**settings))
    energies, memory = [], []
    isFinite, lowest, unitError = True, np.inf, 0.0
    for step in range(steps + 1):
        if step > 0:
            simulation.step()
        heights = np.concatenate([mesh.currVertices[:, 1] for mesh in simulation.meshes])
        turns = np.concatenate([mesh.orientation for mesh in simulation.meshes])
        energies.append(simulation.kinetic_energy() + simulation.potential_energy())
        isFinite &= bool(np.isfinite(energies[-1]) and np.isfinite(heights).all())
        lowest = min(lowest, heights.min())
        unitError = max(unitError, np.abs(np.linalg.norm(turns, axis=1) - 1).max())
        if step >= steps // 10 and step % 100 == 0:
            memory.append(memory_in_use())
    times = max(energies) / energies[0]
    growth = max(memory, default=0.0) - (memory or [0.0])[0]
    rows = [
        ("all numbers are finite", isFinite),
        (f"lowest vertex {lowest:.3g} m", lowest >= -depth),
        (f"unit quaternions to {unitError:.2g}", unitError <= UNIT_TOLERANCE),
        (f"energy at most {times:.6g} times that at the start", times <= 1.0),
        (f"up to {growth:.1f} MB more memory", growth <= MOST_MEMORY),
    ]
    print(f"{name}: {steps} steps in {time.perf_counter() - begin:.0f} s", flush=True)
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
