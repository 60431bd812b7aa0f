"""Short campaigns and long runs cut short find nothing, and notice a fault that is put in.

A short campaign `pairs` is in tests/geometry/test_gjk.py.
"""

import math

import numpy as np
import oracles
import pytest
from campaigns import run_campaign
from longRuns import run_long
from oracles import exact_depth, minkowski_depth, random_quaternions, thin_depth, turned

import GJK
from rbs.softstep.step import SolverState

HITS = "contacts,resumed,steps with constraints,soft-step: restored,soft-step: contacts"


@pytest.mark.slow
def test_a_short_campaign_finds_nothing():
    counts, failures = run_campaign("bits", range(12), math.inf, seed=4)
    assert failures == [] and min(counts[name] for name in HITS.split(",")) > 0, counts


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
@pytest.mark.parametrize(("name", "fault"), [("pairs", too_tolerant), ("bits", forgetful)])
def test_a_fault_is_noticed(name, fault, monkeypatch):
    """One of the cases fails, and passes again without the fault."""
    for case in range(300):
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
            turned(oracles.vertices_of(("tetrahedron", "box", "octahedron")[j % 3]), q) / 8
            for j, q in zip((k, k // 3), random_quaternions(rng, 2), strict=True)
        )
        points2 = points2 + 0.6 * rng.normal(size=3)
        depth = exact_depth(points1, points2)
        for other in (minkowski_depth(points1, points2), thin_depth(points1, points2)):
            assert (other > 0) == (depth > 0)
            assert depth < 0 or abs(other - depth) < 1e-14
        hits += depth > 0
    assert 10 < hits < 35


@pytest.mark.slow
def test_bounds_hold_in_a_short_run(capsys):
    assert run_long("cube", 130) and run_long("pile_200", 15)
    assert "BROKEN" not in capsys.readouterr().out
