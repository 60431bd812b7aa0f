"""Short campaigns and long runs cut short find nothing, and notice a fault that is put in.

A short campaign `pairs` is in tests/geometry/test_gjk.py.
"""

import math

import pytest
from campaigns import run_campaign

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
