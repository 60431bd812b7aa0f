"""Lines of the physics that no scene reaches, called directly."""

import numpy as np
import pytest
from oracles import body, ground, random_quaternions, rotation, state_of

import GJK
from rbs.patches import overlap_centre
from RBSFunctions import Mesh, run_timestep

SQUARE = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]


def test_a_push_gives_its_momentum_and_its_moment():
    rng = np.random.default_rng(8)
    for isFixed in (False, True):
        mesh = body("long-octahedron", (1, 2, 3), random_quaternions(rng, 1)[0], isFixed=isFixed)
        v, w = mesh.linVelocity[0].copy(), mesh.angVelocity[0].copy()
        impulse, point = rng.normal(size=(2, 3)) * 50
        mesh.push(impulse, point)
        R = rotation(mesh.orientation[0]).as_matrix()
        momentum = mesh.mass * (mesh.linVelocity[0] - v)
        spin = R @ mesh.IT @ R.T @ (mesh.angVelocity[0] - w)
        moment = np.cross(point - mesh.position[0], impulse)
        free = not isFixed
        np.testing.assert_allclose(momentum, impulse * free, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(spin, moment * free, rtol=1e-11, atol=1e-9)


def test_overlap_of_points_with_figures_is_the_point():
    point = [(0.25, 0.5), (0.25, 0.5)]
    assert overlap_centre(point, SQUARE, 1e-10) == (0.25, 0.5)
    assert overlap_centre(SQUARE, point, 1e-10) == (0.25, 0.5)


@pytest.mark.parametrize("gap", [1e-14, 1e-12])
def test_figures_that_rounding_has_parted_meet_between_them(gap):
    """The sides move out until something is left: the centre of the side that they had shared."""
    shifted = [(u + 1 + gap, v + 0.5) for u, v in SQUARE]
    u, v = overlap_centre(SQUARE, shifted, 1e-10)
    assert abs(u - 1) < 1e-10 and abs(v - 0.75) < 1e-9


def test_a_guessed_axis_changes_no_verdict():
    """The gap between the boxes is along x; guesses along each axis, and none."""
    hull = GJK.build_hull(body("box").origVertices)
    hulls = GJK.HullSet([hull, hull])
    first, second = np.array([0]), np.array([1])
    for distance, expected in ((11.9, False), (12.2, True)):
        t = np.array([[distance], [0.3], [-0.2]])
        for guess in (None, *np.eye(3)[:, :, None]):
            separated, axis, along = GJK.separating_axes(
                hulls, first, second, t, np.array([0.1]), guess
            )
            assert separated[0] == expected
            if expected:
                assert axis[0, 0] > 0.9 and 0.1 < along[0] <= 0.2 + 1e-12


def test_a_mesh_without_state_says_so():
    with pytest.raises(AttributeError, match="the mesh has no position yet"):
        _ = Mesh.__new__(Mesh).position
    assert Mesh.position.name == "position"  # asked of the class, the attribute itself


def test_a_single_body_by_the_grid_falls_as_by_the_loop():
    one, other = [body("box", (0, 9, 0))], [body("box", (0, 9, 0))]
    for _ in range(60):
        report = run_timestep(one, ground(), 0.02, 0.5, broadPhase="grid")
        run_timestep(other, ground(), 0.02, 0.5)
    assert report.candidatePairs == 0
    np.testing.assert_array_equal(state_of(one), state_of(other))
