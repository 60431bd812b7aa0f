"""Measures milliseconds per step.

    python tests/benchmarks/benchmark.py SCENE … [--steps N] [--from K] [--recommended]

Prints the median, with the quartiles, of the whole step and of each of its phases, over the steps
from K to N, and on which scene and machine that was. If several scenes or schedulings are given,
they take turns step by step, so that a busy machine is busy for all of them.
"""

import argparse
import itertools
import os
import platform
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import scipy

from rbs.scenes.scenefiles import find_scene, scene_name
from rbs.scenes.simulation import SceneSimulation, Settings
from rbs.scenes.suggestions import recommended_values
from rbs.stepping.settings import SETTINGS


def describe_machine():
    """Processor, cores and versions, for the first line of what is printed."""
    processor = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").is_file():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
        processor = names[0] if names else processor
    return (
        f"{processor}, {os.cpu_count()} cores, Python {platform.python_version()}, "
        f"NumPy {np.__version__}, SciPy {scipy.__version__}"
    )


def recommended_simulation(scene):
    """`SceneSimulation` with the settings that the scene recommends, except that no body sleeps."""
    simulation = SceneSimulation(scene)
    values = recommended_values(simulation.source)
    if "contactSolver" in values:
        values["sleeping"] = False
    simulation.settings = Settings(**values)
    return simulation


def measure(simulations, steps, begin):
    """Runs simulations side by side; returns `(seconds, StepReport)` of each, from step `begin`."""
    series = [[] for _ in simulations]
    for step in range(steps):
        for simulation, kept in zip(simulations, series, strict=True):
            simulation.step()
            if step >= begin:
                kept.append((simulation.stepSeconds, simulation.report))
    return series


def quartiles(seconds):
    """Median and quartiles in milliseconds, as text."""
    low, median, high = np.percentile(1e3 * np.array(seconds), (25, 50, 75))
    return f"{median:8.2f} ({low:.2f} – {high:.2f})"


def print_result(title, kept):
    """One block of the output: the step, its phases, and what was counted."""
    seconds, reports = zip(*kept, strict=True)
    print(f"\n{title}\n  {'whole step':<13} {quartiles(seconds)} ms")
    for phase in reports[0].seconds:
        parts = [report.seconds.get(phase, 0.0) for report in reports]
        print(f"  {phase:<13} {quartiles(parts)} ms")
    contacts = np.median([len(report.contacts) for report in reports])
    visits = np.mean([report.constraintVisits for report in reports])
    print(f"  {contacts:g} contacts (median), {visits:g} constraint visits (mean)")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", metavar="SCENE", nargs="+", help="file, or name of one in data/")
    parser.add_argument("--steps", type=int, default=300, metavar="N")
    parser.add_argument("--from", type=int, default=100, metavar="K", dest="begin")
    known = SETTINGS["constraintScheduling"].kind
    names = {"nargs": "+", "choices": known, "default": ["sweep"]}
    text = ", ".join(known)
    parser.add_argument("--scheduling", metavar="NAME", help=text, **names)
    text = "with the settings that each scene recommends, and no body asleep"
    parser.add_argument("--recommended", action="store_true", help=text)
    options = parser.parse_args()

    runs = list(itertools.product(map(find_scene, options.scenes), options.scheduling))
    if options.recommended:
        simulations = [recommended_simulation(scene) for scene, _ in runs]
    else:
        simulations = [
            SceneSimulation(scene, Settings(constraintScheduling=scheduling))
            for scene, scheduling in runs
        ]
    print(describe_machine())
    print(f"steps {options.begin} to {options.steps}, median (quartiles)")
    series = measure(simulations, options.steps, options.begin)
    for (scene, _), simulation, kept in zip(runs, simulations, series, strict=True):
        constraints = len(simulation.constraints)
        title = f"{scene_name(scene)}: {len(simulation.meshes)} bodies"
        if constraints:
            title += f", {constraints} constraints, {simulation.settings.constraintScheduling}"
        print_result(title, kept)


if __name__ == "__main__":
    main()
