"""Measures milliseconds per step of scenes: medians, with quartiles, of the step and its phases.

Several scenes or schedulings take turns step by step, so that a busy machine is busy for all.
"""

import itertools
import os
import platform
from pathlib import Path

import numpy as np
import scipy

from rbs.scenes.scenefiles import find_scene
from rbs.scenes.settingtexts import apply_settings
from rbs.scenes.simulation import SceneSimulation, Settings


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


def print_row(what, seconds):
    low, median, high = np.percentile(1e3 * np.array(seconds), (25, 50, 75))
    print(f"  {what:<13} {median:8.2f} ({low:.2f} – {high:.2f}) ms")


def main(options):
    simulations = []
    for scene, name in itertools.product(map(find_scene, options.scenes), options.scheduling):
        simulations.append(SceneSimulation(scene, Settings(constraintScheduling=name)))
        if options.recommended:
            apply_settings(simulations[-1], {"sleeping": False}, isStrict=False)
    series = [[] for _ in simulations]
    for step in range(options.steps):
        for simulation, kept in zip(simulations, series, strict=True):
            simulation.step()
            if step >= options.begin:
                kept.append((simulation.stepSeconds, simulation.report))
    print(describe_machine())
    print(f"steps {options.begin} to {options.steps}, median (quartiles)")
    for simulation, kept in zip(simulations, series, strict=True):
        seconds, reports = zip(*kept, strict=True)
        print(f"\n{simulation}, {simulation.settings}")
        print_row("whole step", seconds)
        for phase in reports[0].seconds:
            print_row(phase, [report.seconds.get(phase, 0.0) for report in reports])
        contacts = np.median([len(report.contacts) for report in reports])
        visits = np.mean([report.constraintVisits for report in reports])
        print(f"  {contacts:g} contacts (median), {visits:g} constraint visits (mean)")
