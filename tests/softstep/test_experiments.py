"""Rows of tests/benchmarks/experiments.py that have a closed form or an independent predictor."""

import experiments as laws
import numpy as np
import pytest

from rbs.scenes.simulation import SceneSimulation, Settings

SQUARE = (1.0, 0.5, 1.0)
SLIDES = [(SQUARE, (3.0, 0.0, 0.0), 0.0), (SQUARE, (3.0, 0.0, 0.0), 10.0)]
SLIDES += [(SQUARE, (2.4, 0.0, 1.8), 20.0), ((2.0, 0.5, 1.0), (0.0, 0.0, 3.0), -3.6)]


@pytest.mark.slow
@pytest.mark.parametrize("sides, velocity, spin", SLIDES)
def test_friction_opposes_the_slip_of_each_corner(sides, velocity, spin):
    x, _, z = velocity
    predicted = np.hypot(*laws.four_corners(sides[::-1], (z, x), spin, 0.3))
    assert laws.slide(sides, velocity, spin, 0.3, **laws.SOFT) == pytest.approx(predicted, rel=0.02)


@pytest.mark.parametrize(
    "count, gap", [(5, 0.0), (9, 0.0), (7, 1e-4), (9, 1e-4), (9, 1e-3), (5, 0.05)]
)
def test_the_last_of_an_elastic_row_has_nearly_all_of_the_energy(count, gap):
    last, total = laws.row_energy(count, gap, laws.SOFT)
    assert last > 0.99
    assert total < 1.0 + 1e-9


@pytest.mark.parametrize("height", [1.5, 1.51, 1.52, 1.56])
def test_a_box_that_lands_flat_stops_at_once_and_does_not_turn(height):
    speed, spin = laws.plastic_rest(laws.SOFT, height)
    assert speed < 0.0019 and spin < 0.005


@pytest.mark.slow
@pytest.mark.parametrize(
    "step",
    [{}, {"contactScheduling": "batches"}, laws.SOFT],
)
def test_a_tumbling_body_keeps_its_angular_momentum_and_flips_as_eulers_equation_has_it(step):
    momentum, energy, flips = laws.tumbling(step, 20.0)
    predicted = laws.tumbling_ode(laws.box_body(*laws.SPINNER, (0, 0, 0)).IT, 20.0)
    assert momentum < 1e-12 and energy < 1e-3
    assert len(predicted) >= 4 and flips == pytest.approx(predicted, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(laws.disturbances()))
def test_what_sleeps_feels_what_changes_slowly(name):
    awake, asleep = (laws.tilted_distance(name, sleeping) for sleeping in (False, True))
    assert awake > 1.0 and asleep == pytest.approx(awake, rel=1e-2)


def test_what_sleeps_feels_a_small_push_and_the_end_of_a_tie():
    assert laws.pushed_speed(0.05, True) == pytest.approx(0.1 * laws.G, rel=1e-6)
    # semi-implicit Euler in six substeps of each of 25 steps
    fall = laws.G * (laws.TIME_STEP / 6) ** 2 * 150 * 151 / 2
    assert laws.hanging_fall() == pytest.approx(fall, rel=1e-2)


def test_the_contacts_of_sleeping_bodies_carry_their_weight():
    assert laws.resting_weight() == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize("kind", laws.CARRIED)
def test_a_fixed_body_with_a_velocity_carries_what_it_touches(kind):
    assert laws.carried(kind, laws.SOFT) == pytest.approx(laws.CARRIED[kind], rel=5e-3)


@pytest.mark.parametrize(
    "options", [{}, {"contactScheduling": "batches"}, {"contactSolver": "soft-step"}]
)
def test_a_fixed_body_moves_with_its_velocity_in_all_steps(options):
    mesh = laws.box_body(1, 2, 3, (1.0, 5.0, 2.0), isFixed=True)
    other = laws.box_body(1, 1, 1, (9.0, 5.0, 2.0), isFixed=True)
    mesh.linVelocity = np.array([[0.5, 1.0, -2.0]])
    mesh.angVelocity = np.array([[0.0, 0.3, 0.0]])
    before = laws.rotation(mesh.orientation[0])
    laws.run([mesh, other], 1.0, **options)
    np.testing.assert_allclose(mesh.position, [[1.5, 6.0, 0.0]], atol=1e-12)
    turn = (laws.rotation(mesh.orientation[0]) * before.inv()).as_rotvec()
    np.testing.assert_allclose(turn, [0.0, 0.3, 0.0], atol=1e-12)
    assert np.array_equal(mesh.linVelocity, [[0.5, 1.0, -2.0]])
    assert np.array_equal(other.position, [[9.0, 5.0, 2.0]])


def test_a_step_that_is_too_long_for_a_small_body_is_told_with_one_that_is_not():
    cubes = [laws.box_body(size, size, size, (0, 0.75 * size, 0)) for size in (0.003, 1.0)]
    simulation = SceneSimulation.from_meshes(cubes[1:], settings=Settings(0.02))
    assert simulation.step_advice() == ""
    simulation = SceneSimulation.from_meshes(cubes, settings=Settings(0.02))
    assert simulation.step_advice().startswith("a time step of 0.02 s is too long for")
    least = float(simulation.step_advice().split()[-2])
    assert 9.8 * least**2 < 0.2 * 0.003 < 9.8 * (2 * least) ** 2
    laws.run(cubes[:1], 1.0, least, **laws.SOFT)
    assert cubes[0].currVertices[:, 1].min() > -0.05 * 0.003


def test_a_pendulum_keeps_its_energy():
    """Its constraint is a spring, which takes energy and gives it back."""
    assert laws.swing_energy(laws.SOFT, 6.0) == pytest.approx(1.0, abs=0.01)
