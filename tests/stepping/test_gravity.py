"""Gravity as a setting: closed forms on the Moon, on Earth and sideways, in all three steps."""

import numpy as np
import pytest
from oracles import IDENTITY, box_body, ground, rotation, shape

from rbs.softstep.step import SolverState
from RBSFunctions import Mesh, run_timestep

STEPS = {
    "all pairs": {},
    "grid": {"broadPhase": "grid"},
    "batches": {"contactScheduling": "batches"},
    "soft step": {"contactSolver": "soft-step", "substeps": 8},
}
H = 0.02


def run(meshes, count, step, **options):
    options |= STEPS[step]
    if step == "soft step":
        options["solverState"] = SolverState()
    for _ in range(count):
        run_timestep(meshes, ground(), H, 0.0, **options)


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("g", [(0, -1.62, 0), (0, -9.8, 0), (3.0, -9.8, -2.0), (0, 0, 0)])
def test_free_fall_is_the_sum_of_its_steps(g, step):
    """Σ v h over N steps of h is N (N + 1)/2 g h², and N v h: N are substeps in the soft step."""
    body, v, count = box_body(12, 6, 8, (0, 100, 0)), np.array([1.0, 2.0, 3.0]), 40
    body.linVelocity, body.angVelocity = v[None], np.array([[0.0, 2.0, 0.0]])
    run([body], count, step, gravity=g)
    h, n = (H / 8, 8 * count) if step == "soft step" else (H, count)
    expected = [0, 100, 0] + count * H * v + n * (n + 1) / 2 * h * h * np.array(g)
    np.testing.assert_allclose(body.position[0], expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(body.linVelocity[0], v + count * H * np.array(g), atol=1e-12)
    turn = rotation(body.orientation[0]).as_rotvec()
    np.testing.assert_allclose(turn, [0, 2.0 * count * H, 0], atol=1e-12)


class Floating(Mesh):
    """A student's variant that knows no gravity."""

    def integrate_timestep(self, timeStep):
        pass


@pytest.mark.parametrize("step", ["batches", "soft step"])
def test_a_step_on_arrays_refuses_a_subclass_by_name(step):
    body = Floating("", *shape("box"), 1.0, (0, 9, 0), IDENTITY, False)
    with pytest.raises(ValueError, match="Floating.integrate_timestep would not be called"):
        run([body], 1, step)
