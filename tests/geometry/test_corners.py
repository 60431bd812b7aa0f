"""Lines of the physics that no scene reaches, called directly."""

import numpy as np
import pytest
from oracles import body, box_body, ground, random_quaternions, rotation, state_of

from rbs.geometry.hulls import HullSet
from rbs.geometry.patches import Polygons, contact_points, overlap_corners
from RBSFunctions import run_timestep


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


def contact_of_bodies(body1, body2):
    """`(depth, point)` of two bodies that touch along y, by the patch between their features."""
    hulls = HullSet([body1.hull, body2.hull])
    t = (body2.position - body1.position).T
    normal, tolerance = np.array([[0.0], [1.0], [0.0]]), np.array([1e-9])
    point = contact_points(hulls, np.array([0]), np.array([1]), t, normal, tolerance)
    return point[:, 0] + body2.position[0]


@pytest.mark.parametrize("gap", [0.0, 1e-14, 1e-12, 1e-7, 1e-4])
def test_features_that_rounding_has_parted_meet_between_them(gap):
    """The sides move out until something is left: the centre of the side that they had shared."""
    lower, upper = box_body(4, 2, 4, (0, 0, 0)), box_body(4, 2, 4, (4 + gap, 2, 1))
    # they share the side x = 2, z from -1 to 2
    assert contact_of_bodies(lower, upper) == pytest.approx([2, 1, 0.5], abs=2e-9 + 2000 * gap)


def test_sides_in_line_that_do_not_meet_leave_nothing_beyond_their_ends():
    """Of features in a plane, the overlap goes no further than either of them."""
    rng = np.random.default_rng(5)
    for angle in rng.uniform(0.0, 2.0 * np.pi, size=200):
        (c, s), (u0, u1, u2) = (np.cos(angle), np.sin(angle)), rng.uniform(0.1, 1.0, size=3)
        R = np.array([[c, -s], [s, c]])
        long = R @ np.array([[0, u0 + u1, u0 + u1, 0], [0, 0, 1, 1]])
        short = R @ np.array([[u0, u0 + u1 + u2], [0, 0]])
        a, b = Polygons(np.array([4]), long), Polygons(np.array([2]), short)
        row, uv = overlap_corners(a, b, np.array([1e-9]))
        along = (R.T @ uv)[0]
        assert not row.any()
        assert along.min() == pytest.approx(u0, abs=1e-8)
        assert along.max() == pytest.approx(u0 + u1, abs=1e-8)


def test_a_single_body_by_the_grid_falls_as_by_the_loop():
    one, other = [body("box", (0, 9, 0))], [body("box", (0, 9, 0))]
    for _ in range(60):
        report = run_timestep(one, ground(), 0.02, 0.5, broadPhase="grid")
        run_timestep(other, ground(), 0.02, 0.5)
    assert report.candidatePairs == 0
    np.testing.assert_array_equal(state_of(one), state_of(other))
