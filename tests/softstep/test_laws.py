"""Experiments of tests/benchmarks/laws.py that have a closed form or an independent predictor."""

import laws
import numpy as np
import pytest


@pytest.mark.parametrize(
    "sides, velocity, spin",
    [
        ((1.0, 0.5, 1.0), (3.0, 0.0, 0.0), 0.0),
        ((1.0, 0.5, 1.0), (3.0, 0.0, 0.0), 10.0),
        ((1.0, 0.5, 1.0), (2.4, 0.0, 1.8), 20.0),
        ((2.0, 0.5, 1.0), (0.0, 0.0, 3.0), -3.6),
    ],
)
def test_friction_opposes_the_slip_of_each_corner(sides, velocity, spin):
    x, _, z = velocity
    predicted = np.hypot(*laws.four_corners(sides[::-1], (z, x), spin, 0.3))
    assert laws.slide(sides, velocity, spin, 0.3, **laws.SOFT) == pytest.approx(predicted, rel=0.02)
