"""Rows of tests/byhand/experiments.txt that have a closed form or an independent predictor."""

import experiments as laws
import numpy as np
import pytest
from oracles import box_body, rotation


def rows_with_a_tolerance():
    for one in (one for one in laws.ROWS if one.within is not None):
        marks = pytest.mark.slow if one.withinText.startswith("slow ") else ()
        yield pytest.param(one, id=one.what, marks=marks)


@pytest.mark.parametrize("one", list(rows_with_a_tolerance()))
def test_the_soft_step_gives_what_is_due(one):
    assert np.all(abs(one.measure("soft step") - one.due) <= one.within)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["basic step", "batches"])
def test_a_tumbling_body_keeps_its_angular_momentum_in_all_steps(engine):
    momentum, energy, flips, first = laws.tumbling(engine)
    due = laws.tumbling_ode(20.0)
    assert momentum < 1e-12 and energy < 1e-3
    assert flips == len(due) >= 4 and first == pytest.approx(due[0], abs=0.02)


@pytest.mark.parametrize("engine", laws.OWN)
def test_a_fixed_body_moves_with_its_velocity_in_all_steps(engine):
    mesh = box_body(1, 2, 3, (1.0, 5.0, 2.0), isFixed=True)
    other = box_body(1, 1, 1, (9.0, 5.0, 2.0), isFixed=True)
    laws.throw(mesh, (0.5, 1.0, -2.0), (0.0, 0.3, 0.0))
    before = rotation(mesh.orientation[0])
    laws.run(engine, [mesh, other], 1.0)
    np.testing.assert_allclose(mesh.position, [[1.5, 6.0, 0.0]], atol=1e-12)
    turn = (rotation(mesh.orientation[0]) * before.inv()).as_rotvec()
    np.testing.assert_allclose(turn, [0.0, 0.3, 0.0], atol=1e-12)
    assert np.array_equal(mesh.linVelocity, [[0.5, 1.0, -2.0]])
    assert np.array_equal(other.position, [[9.0, 5.0, 2.0]])
