"""Rows of tests/byhand/experiments.txt that have a closed form or an independent predictor."""

import experiments as laws
import numpy as np
import pytest


def rows_with_a_tolerance():
    for one in (one for one in laws.ROWS if one.within is not None):
        marks = pytest.mark.slow if one.withinText.startswith("slow ") else ()
        yield pytest.param(one, id=one.what, marks=marks)


@pytest.mark.parametrize("one", list(rows_with_a_tolerance()))
def test_the_soft_step_gives_what_is_due(one):
    assert np.all(abs(one.measure("soft step") - one.due) <= one.within)
