"""What is done by hand: the spring that drags."""

import numpy as np
import pytest
from oracles import body

from rbs.window.hand import Grab


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("density", "timeStep"), [(1e-4, 0.3), (60.0, 0.02), (1e5, 4e-3)])
def test_a_body_that_is_dragged_comes_to_the_hand_and_is_never_driven(density, timeStep, seed):
    """Whatever its mass and the step: held at its centre without gravity, it does not overshoot;
    held at a corner with gravity, it swings no further out, and comes to hang below the hand.
    """
    rng = np.random.default_rng(seed)
    for isAtCentre in (True, False):
        mesh = body("long-octahedron", density=density, orientation=rng.normal(size=4))
        grab = Grab(mesh, 0, mesh.position[0] if isAtCentre else mesh.currVertices[0])
        start, gaps = grab.target.copy(), []
        grab.target = start + rng.normal(size=3) * 20.0
        for _ in range(int(2.0 / timeStep) + 200):
            grab.pull(mesh, timeStep)
            gaps.append(grab.target - grab.point(mesh))
            if isAtCentre:
                mesh.position = mesh.position + timeStep * mesh.linVelocity
            else:
                mesh.integrate_timestep(timeStep)
        left, sizes = np.array(gaps) @ (grab.target - start), np.linalg.norm(gaps, axis=1)
        if isAtCentre:
            assert (left >= -1e-9 * left[0]).all() and (np.diff(left) <= 1e-9 * left[0]).all()
            assert sizes[-1] < 1e-3 * sizes[0] and not mesh.angVelocity.any()
        else:
            assert sizes.max() <= 1.5 * sizes[0] and np.abs(mesh.linVelocity).max() < 1e3
            assert sizes[-60:].max() < 0.5 * sizes[0]
