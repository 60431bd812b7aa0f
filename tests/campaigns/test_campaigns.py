"""A short campaign finds nothing; another one is in tests/geometry/test_gjk.py."""

import math

import pytest
from campaigns import run_campaign

HITS = "contacts,resumed,steps with constraints,soft-step: restored,soft-step: contacts"


@pytest.mark.slow
def test_a_short_campaign_finds_nothing():
    counts, failures = run_campaign("bits", range(12), math.inf, seed=4)
    assert failures == [] and min(counts[name] for name in HITS.split(",")) > 0, counts
