"""What is searched for among the features of hulls, against a look at all of them."""

import tracemalloc

import numpy as np
import pytest
from oracles import SHAPES, random_quaternions, vertices_of
from scipy.spatial.transform import Rotation

from Quaternion import Q2RotMatrix
from rbs.geometry import facets as search, vectors
from rbs.geometry.facets import Pairs
from rbs.geometry.hulls import FEATURE_TOLERANCE, LEAST_GAP, TOUCH_TOLERANCE, HullSet, build_hull
from rbs.geometry.lowest import support_features, supports
from rbs.geometry.patches import Polygons, overlap_corners


def find_facets(hulls, first, second, t, margin, axes=None):
    return search.find_facets(Pairs(hulls, first, second, t).along(axes), margin)


def test_the_memory_for_a_pair_does_not_grow_with_the_product_of_its_corners():
    """With all pairs of its edges at once, this would be 380 MB."""
    points = np.random.default_rng(4).normal(size=(2, 1500, 3))
    points /= np.linalg.norm(points, axis=2, keepdims=True)
    hulls, t = HullSet([build_hull(p) for p in points]), np.array([[1.8], [0.0], [0.0]])
    tracemalloc.start()
    found = find_facets(hulls, np.array([0]), np.array([1]), t, np.array([0.3]))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found.count[0] > 1000 and peak < 60e6


def test_the_lowest_vertices_are_those_of_all():
    """Along any direction, normals of faces, and edges of the cells."""
    rng = np.random.default_rng(4)
    rotations = np.stack([Q2RotMatrix(q).ravel() for q in random_quaternions(rng, 60)], axis=1)
    hulls = HullSet([build_hull(vertices_of(name)) for name in SHAPES] * 10).rotated(rotations)
    bodies = rng.integers(0, 60, size=3000)
    face = hulls.faceStart[bodies] + rng.integers(0, hulls.faceCount[bodies])
    towards = rng.choice((-1.0, 0.0, 0.2, 1.0, 1e-12), size=(3, 1000)) + [[0.0], [0.0], [1e-9]]
    directions = hulls.normals[:, face]
    directions[:, :1000] = rng.normal(size=(3, 1000))
    directions[:, 1000:2000] = vectors.mat_vec(hulls.rotation[:, bodies[1000:2000]], towards)
    directions /= vectors.norm(directions)
    tolerance = rng.choice((0.0, 1e-10, 1e-4, 0.3), size=3000)
    level, vertex = supports(hulls, bodies, directions)
    levels, count, column = support_features(hulls, bodies, directions, tolerance)
    assert np.array_equal(level, levels)
    crowded = 0
    for k, (b, found) in enumerate(zip(bodies, np.split(column, count.cumsum()[:-1]), strict=True)):
        columns = hulls.vertexStart[b] + np.arange(hulls.vertexCount[b])
        heights = vectors.dot(directions[:, k, None], hulls.vertices[:, columns])
        assert (level[k], vertex[k]) == (heights.min(), columns[heights.argmin()])
        assert np.array_equal(found, columns[heights <= level[k] + tolerance[k]])
        crowded += len(found) > 4
    assert crowded > 100


@pytest.mark.parametrize("gap", [0.0, 1e-15, 1e-13, 1e-10, 1e-5])
def test_a_cached_axis_decides_nothing_where_hulls_nearly_touch(gap):
    """Tip to tip, the axis separates two octahedra farther than any facet does."""
    tip = build_hull(vertices_of("octahedron") / 3.4)
    pair = HullSet([tip, tip]), np.array([0]), np.array([1])
    t = np.array([[2.0 + gap], [0.0], [0.0]])
    for sine in (0.0, 0.3, 1.0):
        cached = np.array([[np.sqrt(1 - sine**2)], [sine], [0.0]])
        facets = find_facets(*pair, t, np.zeros(1), cached)
        penetration = facets.minimal_penetrations(t)[0][0]
        # a facet's normal is the diagonal of a cube
        expected = pytest.approx(-gap / np.sqrt(3), abs=1e-15)
        assert penetration == expected or penetration < -LEAST_GAP
        touches = penetration >= -TOUCH_TOLERANCE * 2
        assert touches == (gap / np.sqrt(3) < TOUCH_TOLERANCE * 2)


def test_sides_in_line_that_do_not_meet_leave_nothing_beyond_their_ends():
    """The overlap of features in a plane is within both of them."""
    rng = np.random.default_rng(5)
    for angle in rng.uniform(0.0, 2.0 * np.pi, size=200):
        (c, s), (u0, u1, u2) = (np.cos(angle), np.sin(angle)), rng.uniform(0.1, 1.0, size=3)
        R = np.array([[c, -s], [s, c]])
        long = R @ np.array([[0, u0 + u1, u0 + u1, 0], [0, 0, 1, 1]])
        short = R @ np.array([[u0, u0 + u1 + u2], [0, 0]])
        figures = Polygons(np.array([4, 2]), np.concatenate((long, short), axis=1))
        row, uv = overlap_corners(figures, np.array([1e-9]))
        along = (R.T @ uv)[0]
        assert not row.any()
        assert along.min() == pytest.approx(u0, abs=1e-8)
        assert along.max() == pytest.approx(u0 + u1, abs=1e-8)


def test_a_hulls_corners_and_offsets_are_those_of_all_its_vertices():
    """The search from neighbour to neighbour finds what a table of all heights has.

    The cube has 98 points on each face, four of them corners of Qhull's triangles; all points of
    the ball are corners. Both are turned, so that points lie off the faces' planes by rounding.
    """
    rng = np.random.default_rng(5)
    turn = Rotation.from_quat(rng.normal(size=4)).as_matrix()
    grid = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 8)] * 3)).reshape(3, -1).T
    ball = rng.normal(size=(600, 3))
    corners = []
    for points in (grid @ turn.T, ball / np.linalg.norm(ball, axis=1)[:, None]):
        hull = build_hull(points)
        table = vectors.dot(hull.directions.T[:, :, None], hull.vertices.T[:, None, :])
        assert np.array_equal(hull.offsets, table.max(axis=1))
        isCorner = table >= hull.offsets[:, None] - FEATURE_TOLERANCE * hull.radius
        found = np.split(hull.corners, hull.cornerCount.cumsum()[:-1])
        for face, row in zip(found, isCorner, strict=True):
            assert sorted(face) == np.flatnonzero(row).tolist()
        corners.append(hull.cornerCount)
    assert len(corners[0]) == 6 and (corners[1] == 3).all() and len(corners[1]) == 1196
