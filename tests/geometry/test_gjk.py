"""GJK.py against independent depths, closed forms, and the purpose of a contact.

Throughout, `size` is the sum of the two hulls' radii, to which the tolerances are relative, and
hull 2 separates from hull 1 along the normal.
"""

import re

import numpy as np
import pytest
from campaigns import run_campaign
from oracles import assert_contact, box, quaternion, random_quaternions, turned

import GJK

# What the campaign `pairs` counts, and has to hit.
HITS = "judged in whole numbers,judged by Qhull,kissing,far from the origin,of extreme size"


def test_random_pairs_are_judged_as_by_whole_numbers_and_qhull():
    """Verdict, depth, normal and point of pairs of all sizes, near the origin and far from it."""
    counts, failures = run_campaign(range(150), seed=8)
    assert failures == []
    assert 0.3 < counts["collide"] / counts["cases"] < 0.7
    assert min(counts[kind] for kind in HITS.split(",")) > 15, counts


UP = np.array([0.0, 1.0, 0.0])


@pytest.mark.parametrize("exponent", [4, 8, 11])
def test_nearly_parallel_edges(exponent):
    """Two square beams edge on edge, 2 long, one turned about the vertical by φ = 10^-k.

    Their edges cross in the middle. At a depth of δ, they separate by δ along the vertical, or
    sideways along a face, at 45°, where the end of the tilted edge reaches sin φ farther, by
    (δ + sin φ)/√2 up to terms in φ². For δ < 2.4 φ the facet between the edges is the nearest
    one. It is about φ wide and must not get lost.
    """
    phi, half, q = 10.0**-exponent, np.sqrt(0.5), quaternion([2, 3, -1], 55)
    beam = turned(box(2, half, half), quaternion([1, 0, 0], 45))  # edges 1/2 above and below
    tilted = turned(beam, quaternion(UP, np.degrees(phi)))
    for delta in (phi / 2, 2 * phi, 10 * phi, 0.1, -phi / 2):
        pair = turned(beam, q), turned(tilted + (1 - delta) * UP, q)
        result = GJK.is_collide(*pair)
        assert result[0] is (delta > 0), delta
        if delta > 0:
            assert_contact(*pair, result)
            error = abs(result[1] - min(delta, (delta + np.sin(phi)) * half))
            assert error < 2e-15 + 0.1 * phi**2, delta


@pytest.mark.parametrize("sink", [0.0, 0.1])
def test_box_flat_on_box(sink):
    """A box 4 × 2 × 4 over one of 12 × 6 × 8: wholly on it, over a side, and over a corner.

    At any angle, near the origin and up to 1e5 from it.
    """
    # x from 4 to 6 of 4 … 8: middle 5, z wholly on it; and x from 3 to 6, z from 1 to 4
    places = (1.5, -2, 1.5, -2), (6, 1, 5, 1), (5, 3, 4.5, 2.5)
    rng = np.random.default_rng(1)
    for k, q in enumerate(random_quaternions(rng, 60)):
        (x, z, *centre), away = places[k % 3], 10.0 ** (k % 6) * rng.normal(size=3)
        pair = turned(box(12, 6, 8), q) + away, turned(box(4, 2, 4) + [x, 4 - sink, z], q) + away
        result = GJK.is_collide(*pair)
        # the lower side of hull 2 is at 3 - sink
        position = turned([centre[0], 3 - sink, centre[1]], q) + away
        assert_contact(*pair, result, depth=sink, position=position)
        assert np.abs(result[2] - turned(UP, q)).max() < 1e-12 + 1e-15 * np.abs(away).max()


def test_what_is_no_solid_point_set_is_refused():
    cube = box(2, 2, 2)
    for points, message in (
        (np.zeros((9, 2)), "not shape (9, 2)"),
        (cube[:3], "expected at least four points as rows of 3, not shape (3, 3)"),
        (cube * [1, 1, 1e-10], "the points are flat, so their hull has no volume"),
        (cube * [1, 1, np.nan], "a coordinate is not finite or beyond 1e+12"),
    ):
        for pair in ((points, 20.0 * cube), (20.0 * cube, points)):
            with pytest.raises(ValueError, match=re.escape(message)):
                GJK.is_collide(*pair)
