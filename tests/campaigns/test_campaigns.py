"""Short campaigns find nothing, hit what they are for, and notice a fault that is put in."""

import math
import subprocess
import sys

import numpy as np
import pytest
from campaigns import CAMPAIGNS, run_campaign
from oracles import (
    ROOT,
    exact_depth,
    minkowski_depth,
    random_quaternions,
    thin_depth,
    turned,
    vertices_of as vertices,
)

import GJK
import RBSFunctions
from rbs.softstep.step import SolverState

# How many cases hit all that a campaign is for, and counts that must not be 0.
SHORT = {
    "pairs": (
        150,
        (
            "aligned needles and blades",
            "collide",
            "far from the origin",
            "kissing",
            "of extreme size",
            "refused in words",
            "judged by Qhull",
            "judged in whole numbers",
        ),
    ),
    "bits": (
        12,
        (
            "contacts",
            "resumed",
            "steps with constraints",
            "soft-step: restored",
            "soft-step: contacts",
        ),
    ),
    "changes": (
        8,
        ("contacts", "copied", "fixed or freed", "moved in place", "ordered anew", "put back"),
    ),
}


@pytest.mark.parametrize("name", SHORT)
def test_a_short_campaign_finds_nothing(name):
    cases, hits = SHORT[name]
    counts, failures = run_campaign(name, range(cases), math.inf, seed=4)
    assert failures == []
    assert counts["cases"] == cases and all(counts[what] > 0 for what in hits), counts


def test_the_command_prints_counts_and_ends_with_0():
    command = [sys.executable, ROOT / "tests/campaigns/campaigns.py", "changes", "--cases", "2"]
    process = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert process.returncode == 0, process.stdout + process.stderr
    counts = dict(line.rsplit(None, 1) for line in process.stdout.splitlines())
    assert counts["cases"] == "2" and int(counts["steps"]) == 60 and counts["failures"] == "none"
    assert set(CAMPAIGNS) == set(SHORT)


# --------------------------------------------------------------------------------------------------
# Faults
# --------------------------------------------------------------------------------------------------


def too_tolerant(patch):
    """Hulls that are a hundredth of their size apart touch."""
    patch.setattr(GJK, "TOUCH_TOLERANCE", 1e-2)


def unsigned_zeros(patch):
    """The formula of friction as it was: it leaves -0.0 alone where nothing is pressed."""
    friction = RBSFunctions.apply_friction

    def leaving(body1, body2, arm1, arm2, normal, limit):
        if limit <= 0.0:
            return RBSFunctions.NO_FRICTION
        return friction(body1, body2, arm1, arm2, normal, limit)

    patch.setattr(RBSFunctions, "apply_friction", leaving)


def forgetful(patch):
    """A solver state that is saved without its impulses."""
    arrays = SolverState.arrays

    def without(self):
        return {k: v * (k != "manifolds.impulse") for k, v in arrays(self).items()}

    patch.setattr(SolverState, "arrays", without)


def a_kept_box(patch):
    """A bounding box that is looked up by the orientation alone."""
    box = RBSFunctions.Mesh.bounding_box

    def kept(self):
        key = np.ravel(self.orientation).tobytes()
        if getattr(self, "kept", (None, None))[0] != key:
            self.kept = key, box(self)
        return self.kept[1]

    patch.setattr(RBSFunctions.Mesh, "bounding_box", kept)


@pytest.mark.parametrize(
    ("name", "fault", "cases"),
    [
        ("pairs", too_tolerant, range(300)),
        ("bits", unsigned_zeros, range(60)),
        ("bits", forgetful, range(30)),
        ("changes", a_kept_box, range(10)),
    ],
)
def test_a_fault_is_noticed(name, fault, cases, monkeypatch):
    """In one of these cases, none of which fails without the fault."""
    for case in cases:
        with monkeypatch.context() as patch:
            fault(patch)
            found = run_campaign(name, [case], math.inf, seed=1)[1]
        if found:
            assert run_campaign(name, [case], math.inf, seed=1)[1] == []
            return
    pytest.fail("nobody noticed")


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
