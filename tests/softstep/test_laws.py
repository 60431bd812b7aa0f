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


@pytest.mark.parametrize("step", [laws.BASIC, laws.BASIC | {"broadPhase": "grid"}, laws.SOFT])
def test_a_tumbling_body_keeps_its_angular_momentum_and_flips_as_eulers_equation_has_it(step):
    momentum, energy, flips = laws.tumbling(step, 20.0)
    predicted = laws.tumbling_ode(laws.box_body(*laws.SPINNER, (0, 0, 0)).IT, 20.0)
    assert momentum < 1e-12 and energy < 1e-3
    assert len(predicted) >= 4 and flips == pytest.approx(predicted, abs=0.02)
