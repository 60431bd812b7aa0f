"""What is done by hand: the spring that drags, and pushes."""

import math

import numpy as np
import pytest
from oracles import body

from rbs.scenes.grabbing import GRAB_FREQUENCY, Grab, spring_impulse

OMEGA = 2.0 * math.pi * GRAB_FREQUENCY


@pytest.mark.parametrize(("timeStep", "density"), [(1e-4, 60.0), (0.02, 1e-3), (1.0, 1e6)])
def test_spring_at_the_centre_of_mass_is_critically_damped(timeStep, density):
    mesh = body("box", density=density)
    target = np.array([3.0, -2.0, 7.0])
    start, speed = mesh.position[0] - target, np.array([5.0, 0.0, -1.0])
    mesh.linVelocity = speed[None]
    # Both eigenvalues of the step are 1 / (1 + ω h): x_n = (a + b n) λⁿ, with a and b from the
    # start and the first step, x_1 = x_0 + h v_1 and v_1 = (v_0 - h ω² x_0) λ².
    decay = 1.0 / (1.0 + OMEGA * timeStep)
    first = start + timeStep * (speed - timeStep * OMEGA**2 * start) * decay**2
    slope = first / decay - start
    for n in range(1, 40):
        point = mesh.position[0]
        mesh.push(spring_impulse(mesh, point, target, timeStep), point)
        mesh.position = mesh.position + timeStep * mesh.linVelocity
        expected = (start + n * slope) * decay**n
        np.testing.assert_allclose(mesh.position[0] - target, expected, rtol=1e-8, atol=1e-9)
    np.testing.assert_array_equal(mesh.angVelocity, np.zeros((1, 3)))


@pytest.mark.parametrize(("density", "timeStep"), [(1e-4, 0.3), (1e5, 1e-3)])
@pytest.mark.parametrize("name", ["box", "long-octahedron"])
def test_spring_is_stable_whatever_it_holds_and_wherever(name, density, timeStep):
    """A body that is held somewhere near its rim comes to hang or to rest; it is never driven."""
    generator = np.random.default_rng(8)
    mesh = body(name, density=density, orientation=generator.normal(size=4))
    corner = mesh.currVertices[generator.integers(len(mesh.currVertices))]
    grab, largest = Grab(mesh, 0, corner), []
    grab.target = corner + generator.normal(size=3) * 20.0
    for _ in range(250):
        grab.pull(mesh, timeStep)
        largest.append(np.linalg.norm(grab.point(mesh) - grab.target))
        mesh.integrate_timestep(timeStep)
    # It hangs within a few sizes of the hand, and swings no further out than at the start.
    sag = 9.8 / OMEGA**2 * (1.0 + OMEGA * timeStep) ** 2
    assert max(largest[-60:]) < 0.5 * largest[0] + sag
    assert np.linalg.norm(mesh.linVelocity) < 1e3
