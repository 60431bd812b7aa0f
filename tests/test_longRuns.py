"""A shortened form of tests/longRuns.py, and whether its bounds notice what they are for."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from longRuns import RUNS, Watch, run_long
from oracles import ROOT

from rbs.scenes import find_scene
from rbs.simulation import Simulation


@pytest.mark.parametrize("scene, steps", [("tower", 300), ("cube", 300), ("pile_200", 60)])
def test_bounds_hold_in_a_short_run(scene, steps):
    process = subprocess.run(
        [sys.executable, ROOT / "tests" / "longRuns.py", scene, "--steps", str(steps)],
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert process.returncode == 0, process.stdout + process.stderr
    assert process.stdout.startswith(f"{scene}: {steps} steps in ")
    assert "BROKEN" not in process.stdout


def test_each_bound_is_looked_at():
    run = RUNS["cube"]
    watch, _ = run_long(run, 60)
    assert watch.broken(run) == []
    assert watch.lowest < 20 and 0 < watch.lastEnergy < watch.startEnergy
    (cause,) = watch.broken(replace(run, energy=0.5))
    assert cause == "the energy is 1 times the start's at step 0, bound 0.5"
    (cause,) = watch.broken(replace(run, memory=-1.0))
    assert "MB more memory" in cause
    (cause,) = watch.broken(replace(run, depth=-1e3))
    assert "below the ground" in cause


def test_what_is_watched_is_found():
    simulation = Simulation(find_scene("tower"))
    watch = Watch(simulation, 10)
    mesh = simulation.meshes[3]
    mesh.orientation = mesh.orientation * (1 + 3e-12)
    mesh.currVertices = mesh.currVertices - (0.0, 100.0, 0.0)
    mesh.linVelocity = np.array([[0.0, 1e4, 0.0]])
    watch.look(simulation)
    assert watch.unitError == pytest.approx(3e-12, rel=1e-3)
    assert watch.lowest == mesh.currVertices[:, 1].min() < -40
    gained = 0.5 * mesh.mass * 1e8
    assert watch.energy - watch.startEnergy == pytest.approx(gained, rel=1e-9)
    assert len(watch.broken(RUNS["tower"])) == 3
    mesh.linVelocity = np.array([[0.0, np.nan, 0.0]])
    watch.look(simulation)
    assert "a number is not finite" in watch.broken(RUNS["tower"])
