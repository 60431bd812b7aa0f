"""Facets and contact points: a pair has the same bits alone, in tuples, and in any company."""

import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest
from oracles import IDENTITY, SHAPES, random_quaternions, vertices_of
from scipy.spatial.transform import Rotation

import GJK
from Quaternion import Q2RotMatrix
from rbs.geometry import facets as search, vectors
from rbs.geometry.facets import Pairs
from rbs.geometry.hulls import (
    FEATURE_TOLERANCE,
    LEAST_GAP,
    TOUCH_TOLERANCE,
    HullSet,
    RotatedHull,
    build_hull,
)
from rbs.geometry.lowest import support_features, supports
from rbs.geometry.patches import Polygons, contact_points, overlap_corners

PAIRS = 300


def is_complete(facets):
    """Which pairs (P,) have all facets that can be nearest, not just one that separates them."""
    return facets.completeUpTo > -np.inf


@pytest.fixture(scope="module")
def batch():
    """Sixty hulls of all shapes and 300 pairs, about half of them meeting.

    Two hulls in three are not turned, so that there are faces and edges that rest on each other.
    """
    rng = np.random.default_rng(9)
    rest = [build_hull(vertices_of(name)) for name in SHAPES] * 10
    turns = random_quaternions(rng, 60)
    turns[np.arange(60) % 3 > 0] = IDENTITY
    rotations = np.stack([Q2RotMatrix(q).ravel() for q in turns], axis=1)
    first, second = rng.permuted(np.tile(np.arange(60), (PAIRS, 1)), axis=1)[:, :2].T
    hulls = HullSet(rest).rotated(rotations)
    size = hulls.radius[first] + hulls.radius[second]
    direction = rng.normal(size=(3, PAIRS))
    t = direction / np.linalg.norm(direction, axis=0) * size * rng.uniform(0, 1, size=PAIRS)
    margin = size * rng.choice([0.0, 0.02, 0.1], size=PAIRS)
    found = {"rest": rest, "rotations": rotations, "hulls": hulls, "first": first}
    return SimpleNamespace(**found, second=second, t=t, margin=margin)


def find_facets(hulls, first, second, t, margin, axes=None):
    return search.find_facets(Pairs(hulls, first, second, t).along(axes), margin)


def rotated_hulls(batch, p):
    """The two bodies of pair p as `RotatedHull`s."""
    bodies = batch.first[p], batch.second[p]
    hulls = ((batch.rest[b], tuple(batch.rotations[:, b].tolist())) for b in bodies)
    return [RotatedHull(hull, hull.vertices, rotation) for hull, rotation in hulls]


def nearest(facets, p, t):
    """`(penetration, normal)` of pair p along its nearest facet, at the translation t (3,)."""
    penetration, normal = facets.of_pairs(np.array([p])).minimal_penetrations(t[:, None])
    return penetration[0], tuple(normal[:, 0])


def alone(batch, p):
    """`(hulls, first, second, t, margin)` of pair p as the only pair of the only two bodies."""
    bodies = [batch.first[p], batch.second[p]]
    hulls = HullSet([batch.rest[b] for b in bodies]).rotated(batch.rotations[:, bodies])
    one = slice(p, p + 1)
    return hulls, np.array([0]), np.array([1]), batch.t[:, one], batch.margin[one]


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


def test_the_nearest_facet_of_a_pair_has_the_same_bits_as_in_a_batch(batch):
    """In tuples and on arrays, at the translation of the batch and at shorter ones."""
    rng = np.random.default_rng(12)
    hits = ofEdges = 0
    for p in range(PAIRS):
        hulls, first, second, *_ = alone(batch, p)
        pair = rotated_hulls(batch, p)
        normals = np.concatenate((pair[0].normals, -pair[1].normals), axis=1)
        for t in (batch.t[:, p], batch.t[:, p] * rng.uniform(0, 1)):
            many = find_facets(hulls, first, second, t[:, None], np.array([1e-3]))
            found = GJK.nearest_facet(*pair, tuple(t.tolist()))
            if is_complete(many)[0] and found[0] >= 0.0:
                assert found == nearest(many, 0, t)
                hits += 1
                ofEdges += not (normals == np.array([found[1]]).T).all(axis=0).any()
            else:
                assert found[0] < 0.0 and nearest(many, 0, t)[0] < 0.0
    assert 300 < hits < 2 * PAIRS - 50 and 50 < ofEdges < hits - 50


def test_contact_points_have_the_same_bits_alone_and_in_a_batch(batch):
    facets = find_facets(batch.hulls, batch.first, batch.second, batch.t, batch.margin)
    penetrations, normals = facets.minimal_penetrations(batch.t)
    pairs = np.flatnonzero((penetrations >= 0) & is_complete(facets))
    # hulls that are not turned have edges and faces that rest on each other along these
    patches = np.flatnonzero(batch.first % 3 * (batch.second % 3) > 0)
    pairs = np.concatenate((pairs, patches))
    normals[:, patches] = np.array([[0.0], [1.0], [0.0]])
    first, second = batch.first[pairs], batch.second[pairs]
    t, normal = batch.t[:, pairs], normals[:, pairs]
    t[1] *= np.arange(len(pairs)) < len(pairs) - len(patches)
    tolerance = FEATURE_TOLERANCE * (batch.hulls.radius[first] + batch.hulls.radius[second])
    together = contact_points(batch.hulls, first, second, t, normal, tolerance)
    corners = 0
    for k, p in enumerate(pairs):
        hulls, *bodies, _, _ = alone(batch, p)
        one = slice(k, k + 1)
        single = contact_points(hulls, *bodies, t[:, one], normal[:, one], tolerance[one])
        assert np.array_equal(single[:, 0], together[:, k])
        of = (tuple(x[:, k].tolist()) for x in (t, normal))
        assert GJK.contact_point(*rotated_hulls(batch, p), *of, tolerance[k]) == tuple(single[:, 0])
        begin = batch.hulls.vertexStart[second[k]]
        vertices = batch.hulls.vertices[:, begin : begin + batch.hulls.vertexCount[second[k]]]
        corners += (vertices == together[:, k, None]).all(axis=0).any()
    # of the rest, some are below a corner of the first hull, some centres of patches
    assert len(pairs) > 150 and 20 < corners < len(pairs) - 60


def test_the_lowest_vertices_are_those_of_all(batch):
    """Along any direction, normals of faces, and edges of the cells."""
    rng, hulls = np.random.default_rng(4), batch.hulls
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
        penetration, _ = nearest(find_facets(*pair, t, np.zeros(1), cached), 0, t[:, 0])
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
