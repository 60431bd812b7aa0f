"""Short campaigns and long runs cut short find nothing, and notice a fault that is put in."""

import math

import numpy as np
import pytest
from campaigns import run_campaign
from longRuns import RUNS, Watch, run_long
from oracles import (
    exact_depth,
    minkowski_depth,
    random_quaternions,
    thin_depth,
    turned,
    vertices_of as vertices,
)

import GJK
from rbs.scenes.scenefiles import find_scene
from rbs.scenes.simulation import SceneSimulation
from rbs.softstep.step import SolverState

# How many cases hit all that a campaign is for, and counts that must not be 0.
SHORT = {
    "pairs": (
        150,
        "aligned needles and blades, collide, far from the origin, kissing, of extreme size, "
        "refused in words, judged by Qhull, judged in whole numbers",
    ),
    "bits": (
        12,
        "contacts, resumed, steps with constraints, soft-step: restored, soft-step: contacts",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SHORT)
def test_a_short_campaign_finds_nothing(name):
    cases, hits = SHORT[name]
    counts, failures = run_campaign(name, range(cases), math.inf, seed=4)
    assert failures == []
    assert counts["cases"] == cases and all(counts[name] > 0 for name in hits.split(", ")), counts


# --------------------------------------------------------------------------------------------------
# Faults
# --------------------------------------------------------------------------------------------------


def too_tolerant(patch):
    """Counts hulls as touching if they are a hundredth of their size apart."""
    patch.setattr(GJK, "TOUCH_TOLERANCE", 1e-2)


def forgetful(patch):
    """A solver state that is saved without its impulses."""
    arrays = SolverState.arrays

    def without(self):
        return {k: v * (k != "manifolds.impulse") for k, v in arrays(self).items()}

    patch.setattr(SolverState, "arrays", without)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "fault", "cases"),
    [
        ("pairs", too_tolerant, range(300)),
        ("bits", forgetful, range(30)),
    ],
)
def test_a_fault_is_noticed(name, fault, cases, monkeypatch):
    """One of the cases fails, and passes again without the fault."""
    for case in cases:
        with monkeypatch.context() as patch:
            fault(patch)
            found = run_campaign(name, [case], math.inf, seed=1)[1]
        if found:
            assert run_campaign(name, [case], math.inf, seed=1)[1] == []
            return
    pytest.fail("no case noticed the fault")


def test_oracles_of_depth_agree():
    """Whole numbers, Qhull, and Qhull on what is stretched, where all of them are right."""
    rng = np.random.default_rng(12)
    hits = 0
    for k in range(36):
        points1, points2 = (
            turned(vertices(("tetrahedron", "box", "octahedron")[j % 3]), q) / 8
            for j, q in zip((k, k // 3), random_quaternions(rng, 2), strict=True)
        )
        points2 = points2 + 0.6 * rng.normal(size=3)
        depth = exact_depth(points1, points2)
        for other in (minkowski_depth(points1, points2)[0], thin_depth(points1, points2)):
            assert (other > 0) == (depth > 0)
            assert depth < 0 or abs(other - depth) < 1e-14
        hits += depth > 0
    assert 10 < hits < 35


@pytest.mark.slow
def test_bounds_hold_in_a_short_run(capsys):
    assert set(RUNS) == {"tower", "cube", "pile_200"}
    assert run_long("cube", 130) and run_long("pile_200", 15)
    assert "BROKEN" not in capsys.readouterr().out


def test_long_runs_notice_what_they_watch():
    simulation = SceneSimulation(find_scene("tower"))
    watch, mesh = Watch(simulation, 10), simulation.meshes[3]
    mesh.orientation = mesh.orientation * (1 + 3e-12)
    mesh.currVertices = mesh.currVertices - (0.0, 100.0, 0.0)
    mesh.linVelocity = np.array([[0.0, 1e4, 0.0]])
    watch.look(simulation)
    assert watch.unitError == pytest.approx(3e-12, rel=1e-3)
    assert watch.lowest == mesh.currVertices[:, 1].min() < -40
    gained = 0.5 * mesh.mass * 1e8
    assert watch.energy - watch.startEnergy == pytest.approx(gained, rel=1e-9)
    mesh.linVelocity = np.array([[0.0, np.nan, 0.0]])
    watch.look(simulation)
    watch.memoryGrowth = 9.0
    assert not any(holds for _, holds in watch.rows(depth=1e-9))
