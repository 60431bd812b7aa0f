"""benchmarkPiles.py: its windows and rows, and the friction of the peers."""

import csv
import subprocess
import sys

import benchmarkPiles
import numpy as np
import pytest
from oracles import ROOT

GRAVITY = 9.8


def test_there_is_a_row_for_each_run_and_window(tmp_path):
    command = [
        sys.executable,
        benchmarkPiles.__file__,
        "--sizes",
        "6",
        "12",
        "--kinds",
        "heap",
        "--windows",
        "1-3",
        "2-5",
        "--all-up-to",
        "6",
        "--out",
        tmp_path,
    ]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    with (tmp_path / "piles.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    found = [(row["bodies"], row["material"], row["steps"], row["run"]) for row in rows]
    assert found == [
        (bodies, material, steps, run)
        for bodies in ("6", "12")
        for material in ("no friction", "friction 0.5")
        for steps in ("1-3", "2-5")
        for run in (("all pairs", "grid") if bodies == "6" else ("grid",))
    ]
    for row in rows:
        assert float(row["contacts a body"]) == pytest.approx(
            float(row["contacts"]) / int(row["bodies"]), abs=0.005
        )
        assert f"{row['contacts a body']} contacts a body" in printed
    # between the sizes, for each material and window of the only run that has both
    assert printed.count("time grows as N^") == 4


def test_windows_get_their_steps_and_no_others():
    class Run:
        steps = 0

        def step(self):
            self.steps += 1

        def counts(self):
            return None, self.steps, {}

    runs = {"one": Run(), "other": Run()}
    windows = [benchmarkPiles.read_window(text) for text in ("2-5", "4-8")]
    kept = benchmarkPiles.measure(runs, windows)
    assert list(kept) == [(window, name) for window in windows for name in runs]
    for (window, _), steps in kept.items():
        # a step is counted after it has been made
        assert [counts[1] for _, counts in steps] == [step + 1 for step in window]
    assert all(run.steps == 8 for run in runs.values())


@pytest.mark.parametrize("text", ["5-5", "6-5", "-1-4", "5", "x-7"])
def test_windows_without_steps_are_refused(text):
    with pytest.raises(ValueError):
        benchmarkPiles.read_window(text)


@pytest.fixture(params=benchmarkPiles.PEERS)
def peer(request):
    package, make = benchmarkPiles.PEERS[request.param]
    pytest.importorskip(package)
    return make


@pytest.fixture
def slab(tmp_path):
    """A scene with one slab that lies on the ground."""
    path = tmp_path / "slab-scene.txt"
    path.write_text(f"1\n{ROOT / 'data' / 'slab.mesh'} 50 0 0 1 0 1 0 0 0\n")
    return benchmarkPiles.Simulation(path, allowOutsideMeshes=True)


def slide(run, speed, steps):
    """How far a run's only body slides along x from a start at `speed`, in metres."""
    if isinstance(run, benchmarkPiles.MuJoCoRun):
        run.data.qvel[0] = speed
    else:
        run.pybullet.resetBaseVelocity(1, (speed, 0, 0), physicsClientId=run.client)
    for _ in range(steps):
        run.step()
    if isinstance(run, benchmarkPiles.MuJoCoRun):
        return run.data.qpos[0]
    return run.pybullet.getBasePositionAndOrientation(1, physicsClientId=run.client)[0][0]


def test_peers_slide_as_far_as_coulomb_says(peer, slab):
    """With friction v² / (2 μ g), and without on and on."""
    friction, speed, steps = 0.5, 5.0, 100
    distance = slide(peer(slab, benchmarkPiles.Material(friction, 0.0)), speed, steps)
    # one step's way, and what soft contacts creep
    assert distance == pytest.approx(speed**2 / (2 * friction * GRAVITY), abs=0.15)
    distance = slide(peer(slab, benchmarkPiles.Material(0.0, 0.0)), speed, steps)
    assert distance == pytest.approx(speed * steps * benchmarkPiles.TIME_STEP, rel=0.01)


def test_pybullet_bounces_as_restitution_says(slab):
    pytest.importorskip("pybullet")
    speeds = {}
    for restitution in (0.0, 0.5):
        run = benchmarkPiles.PyBulletRun(slab, benchmarkPiles.Material(0.0, restitution))
        run.pybullet.resetBaseVelocity(1, (0, -4.0, 0), physicsClientId=run.client)
        heights = []
        for _ in range(10):
            run.step()
            velocity, _ = run.pybullet.getBaseVelocity(1, physicsClientId=run.client)
            heights.append(velocity[1])
        speeds[restitution] = np.max(heights)
    assert speeds[0.5] == pytest.approx(0.5 * 4.0, abs=0.3)
    assert speeds[0.0] < 0.3
