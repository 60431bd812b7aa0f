"""GJK.py against Qhull's Minkowski differences, closed forms, and the purpose of a contact.

Throughout, `size` is the sum of the two hulls' radii, which the tolerances are relative to, and
hull 2 separates from hull 1 along the normal.
"""

import itertools
import re
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from oracles import (
    IDENTITY,
    SHAPES,
    box,
    frozen,
    gap_along,
    height_over_surface,
    minkowski_depth,
    quaternion,
    random_quaternions,
    rotation,
    size_of,
    turned,
    vertices_of,
)
from scipy.optimize import nnls
from scipy.spatial import Delaunay, HalfspaceIntersection

import GJK
from rbs.geometry.facets import PARALLEL_SINE
from rbs.geometry.hulls import FEATURE_TOLERANCE

EPS = np.finfo(float).eps
# The contract of the depth, relative to the size.
DEPTH = 1e-9
# Some ten operations on numbers of the order of the size.
ROUNDING = 1e-14
# A contact point may be as far from the surface as FEATURE_TOLERANCE lets a vertex be from the
# plane of the feature that it counts to, twice: once on each hull.
SURFACE = 2 * FEATURE_TOLERANCE


def distance_to_hull(points, p):
    """About the distance of p (3,) from the hull of points (n, 3).

    Non-negative least squares: weights λ ≥ 0 that bring Σ λ_i x_i to p and Σ λ_i to 1. What is left
    over is 0 for a p in the hull, else within a small factor of its distance.
    """
    unit = np.abs(points - p).max() or 1.0
    rows = np.vstack(((points - p).T / unit, np.ones(len(points))))
    return nnls(rows, np.array([0.0, 0.0, 0.0, 1.0]))[1] * unit


def assert_contact(points1, points2, result, depth=None, position=None):
    """A contact does what it is for. Optionally also: it has this depth, and this position.

    Moved by depth · normal hull 2 touches hull 1: the gap along the normal is nil. The point
    belongs to hull 2 and to its lowest plane along the normal, hence to its surface; moved along
    it belongs to hull 1's surface.
    """
    isCollision, found, normal, point = result
    assert isCollision is True and isinstance(found, float) and found >= 0
    assert normal.shape == point.shape == (1, 3)
    assert abs(np.linalg.norm(normal) - 1) < ROUNDING
    size = size_of(points1, points2)
    # Coordinates far from the origin are rounded by more than the size calls for.
    reach = EPS * max(np.abs(points1).max(), np.abs(points2).max())
    tolerance = 1e-12 * size + 8 * reach
    assert abs(gap_along(points1, points2 + found * normal, normal)) <= tolerance
    for points, p, side in ((points2, point, -1), (points1, point + found * normal, 1)):
        assert distance_to_hull(points, p[0]) <= SURFACE * size + 8 * reach
        height = (points - p) @ normal[0]
        assert abs((side * height).max()) <= tolerance
    if depth is not None:
        assert abs(found - depth) <= 1e-13 * size + 4 * reach
    if position is not None:
        assert np.abs(point - position).max() <= 1e-12 * size + 4 * reach


def assert_apart(result):
    isCollision, depth, normal, point = result
    assert isCollision is False and depth == 0.0
    assert np.array_equal(normal, np.zeros((1, 3))) and np.array_equal(point, np.zeros((1, 3)))


PAIRS_OF_EACH_COMBINATION = 15
COMBINATIONS = list(itertools.combinations_with_replacement(SHAPES, 2))
KINDS = ("random rotations", "the same rotation", "no rotation", "quarter turns", "along an axis")


def random_pair(rng, names, kind):
    """Two hulls about the origin, then moved: `(points1, points2, common offset)`.

    Sizes from 1e-3 to 1e3, the second up to ten times larger or smaller; offsets up to 1e4.
    Hull 2 is shifted by up to 1.3 times what parts it in some direction.
    """
    turns = random_quaternions(rng, 2)
    if kind == "the same rotation":
        turns[1] = turns[0]
    elif kind == "no rotation":
        turns[:] = IDENTITY
    elif kind == "quarter turns":
        axes = np.eye(3)[rng.integers(3, size=2)]
        turns = [quaternion(axis, 90 * rng.integers(4)) for axis in axes]
    # the shapes are about 10 across
    scale = 10 ** rng.uniform(-3, 3) / 10 * np.array([1, 10 ** rng.uniform(-1, 1)])
    points1, points2 = (turned(vertices_of(names[k]), turns[k]) * scale[k] for k in range(2))
    if kind == "along an axis":
        direction = np.eye(3)[rng.integers(3)]
    else:
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
    shift = -gap_along(points1, points2, direction) * rng.uniform(0, 1.3) * direction
    offset = np.zeros(3)
    if rng.random() < 0.5:
        offset = rng.choice([-1, 1], size=3) * 10 ** rng.uniform(0, 4, size=3)
    return points1 + offset, points2 + shift + offset


@pytest.fixture(scope="module")
def sweep():
    """All pairs with the oracle's answer and that of `is_collide`, in units of their size.

    The oracle looks at the coordinates as they are in the end, rounded by the offset, but from
    near by: a difference of two near numbers is exact.
    """
    rng = np.random.default_rng(8)
    found = []
    for names in COMBINATIONS:
        for k in range(PAIRS_OF_EACH_COMBINATION):
            kind = KINDS[k % len(KINDS)]
            order = names if rng.random() < 0.5 else names[::-1]
            points1, points2 = (frozen(p) for p in random_pair(rng, order, kind))
            result = GJK.is_collide(points1, points2)
            size = size_of(points1, points2)
            origin = points1.mean(axis=0)
            near1, near2 = (points1 - origin) / size, (points2 - origin) / size
            isCollision, depth, normal, point = result
            found.append(
                SimpleNamespace(
                    label=(order, kind, k),
                    points1=points1,
                    points2=points2,
                    size=size,
                    near1=near1,
                    near2=near2,
                    oracle=minkowski_depth(near1, near2)[0],
                    isCollision=isCollision,
                    depth=depth / size,
                    normal=normal[0],
                    point=(point[0] - origin) / size,
                    # what the rounding of the coordinates is in units of the size
                    blur=EPS * max(np.abs(points1).max(), np.abs(points2).max()) / size,
                )
            )
    return found


def test_collisions_and_depths_are_those_of_the_oracle(sweep):
    hits = Counter(name for pair in sweep for name in pair.label[0] if pair.isCollision)
    tries = Counter(name for pair in sweep for name in pair.label[0])
    assert len(sweep) > 300 and all(0.3 < hits[name] / tries[name] < 0.7 for name in SHAPES)
    sizes = [pair.size for pair in sweep]
    assert min(sizes) < 5e-3 and max(sizes) > 1e3
    # Hulls closer than the rounding of their coordinates may count as touching or not.
    clear = [pair for pair in sweep if abs(pair.oracle) > 1e-12 + 8 * pair.blur]
    assert len(clear) > 0.99 * len(sweep)
    assert [pair.label for pair in clear if pair.isCollision != (pair.oracle > 0)] == []
    near = [pair for pair in sweep if pair.isCollision and pair.blur < 1e-14]
    far = [pair for pair in sweep if pair.isCollision and pair.blur >= 1e-14]
    assert len(near) > 80 and len(far) > 30
    for pairs, tolerance in ((near, 1e-13), (far, DEPTH)):
        assert max(abs(pair.depth - pair.oracle) for pair in pairs) < tolerance
    for pair in sweep:
        if not pair.isCollision:
            assert pair.depth == 0.0 and not pair.normal.any()


def test_moved_by_depth_times_normal_they_touch(sweep):
    hits = [pair for pair in sweep if pair.isCollision]
    for pair in hits:
        assert abs(np.linalg.norm(pair.normal) - 1) < ROUNDING
        gap = gap_along(pair.near1, pair.near2 + pair.depth * pair.normal, pair.normal)
        assert abs(gap) < 1e-13, pair.label
    # The gap says no more than that they are parted. That no shorter way parts them is the oracle's
    # word above, for the depth is the distance to the nearest facet; here once more by the move
    # itself, which leaves a hair of the old depth, or of air.
    for pair in hits[::2]:
        for change, stillMeets in ((-1e-9 - 8 * pair.blur, True), (1e-9 + 8 * pair.blur, False)):
            moved = pair.near2 + (pair.depth + change) * pair.normal
            if pair.depth + change > 0:
                assert GJK.is_collide(pair.near1, moved)[0] is stillMeets, pair.label


def test_points_are_on_both_surfaces(sweep):
    for pair in sweep:
        if pair.isCollision:
            tolerance = SURFACE + 8 * pair.blur
            across = pair.point + pair.depth * pair.normal
            assert abs(height_over_surface(pair.near2, pair.point)) < tolerance, pair.label
            assert abs(height_over_surface(pair.near1, across)) < tolerance, pair.label


def test_gjk_finds_an_axis_exactly_where_there_is_one(sweep):
    """One that proves it: all of hull 2 lies beyond all of hull 1, by more than the gap."""
    found = 0
    for pair in sweep:
        t, gap = pair.near2.mean(axis=0) - pair.near1.mean(axis=0), 1e-6
        vertices = [(p - p.mean(axis=0)).T for p in (pair.near1, pair.near2)]
        axis = GJK.separating_axis(*vertices, tuple(t.tolist()), gap)
        if axis is None:
            # the facets' gap is no more than the distance
            assert pair.oracle > -gap, pair.label
        else:
            found += 1
            assert pair.oracle < 0 and gap_along(pair.near1, pair.near2, axis) > gap - 1e-13
    assert 0.3 < found / len(sweep) < 0.7


# --------------------------------------------------------------------------------------------------
# Touching, and a hair apart
# --------------------------------------------------------------------------------------------------

UP = np.array([0.0, 1.0, 0.0])
HALF = np.sqrt(0.5)
# A beam edge upwards, along x and along z; the tips of an octahedron.
BEAM = turned(box(4, 2, 2), quaternion([1, 0, 0], 45))
CROSSED = turned(box(2, 2, 4), quaternion([0, 0, 1], 45))
TIPS = vertices_of("octahedron") / 3.4

# name: (hull 1, hull 2 such that they touch, the direction to part them by)
KISSES = {
    "face on face": (box(4, 2, 6), box(2, 2, 2) + [0.5, 2, 1], UP),
    "face on face, flush sides": (box(4, 2, 6), box(4, 2, 6) + [0, 2, 0], UP),
    "faces that share an edge only": (box(2, 2, 2), box(2, 2, 2) + [2, 2, 0], UP + [1, 0, 0]),
    "faces that share a corner only": (box(2, 2, 2), box(2, 2, 2) + [2, 2, 2], np.ones(3)),
    "edges crossed": (BEAM, CROSSED + 2 * np.sqrt(2) * UP, UP),
    "parallel edges": (BEAM, BEAM + 2 * np.sqrt(2) * UP + [1, 0, 0], UP),
    "corner on face": (box(8, 2, 8), TIPS + 2 * UP, UP),
    "corner on corner": (TIPS, TIPS + 2 * UP, UP),
    "edge on face": (box(8, 2, 8), CROSSED + (1 + np.sqrt(2)) * UP, UP),
}


@pytest.mark.parametrize("name", KISSES)
@pytest.mark.parametrize("pose", ["as it is", "turned and far away"])
def test_kissing_hulls_collide_and_a_hair_apart_they_do_not(name, pose):
    points1, points2, apart = KISSES[name]
    apart = apart / np.linalg.norm(apart)
    offset = np.zeros(3)
    if pose == "turned and far away":
        q = quaternion([3, -1, 2], 40)
        points1, points2, apart = (turned(x, q) for x in (points1, points2, apart))
        offset = np.array([900.0, -700.0, 500.0])  # whose rounding, 1e-13, is far below a hair
    size = size_of(points1, points2)
    result = GJK.is_collide(points1 + offset, points2 + offset)
    assert_contact(points1 + offset, points2 + offset, result, depth=0)
    # corners that miss each other by rounding have normals in a whole cone; none points backwards
    assert result[2][0] @ apart > 0
    hair = 1e-9 * size * apart
    assert_apart(GJK.is_collide(points1 + offset, points2 + hair + offset))
    result = GJK.is_collide(points1 + offset, points2 - hair + offset)
    assert_contact(points1 + offset, points2 - hair + offset, result)
    assert result[1] <= 1.001e-9 * size


@pytest.mark.parametrize("name", ["box", "octahedron"])
def test_closed_forms_on_a_lattice(name):
    """Shifts for which GJK's simplices have the origin on a face, an edge or a corner, exactly.

    The Minkowski difference of a cube of side 2 with itself is one of side 4: the depth at t is
    2 - max |t_k|. That of two octahedra |x| + |y| + |z| ≤ 2 is the one with 4, whose facets are
    4/√3 from its centre: (4 - Σ |t_k|)/√3.
    """
    if name == "box":
        points, shifts = box(2, 2, 2), range(-3, 4)
    else:
        points, shifts = vertices_of(name) / 3.4 * 2, range(-4, 5)
    outcomes = Counter()
    for t in itertools.product(shifts, repeat=3):
        size = np.abs(t)
        depth = 2 - size.max() if name == "box" else (4 - size.sum()) / np.sqrt(3)
        result = GJK.is_collide(points, points + t)
        if depth < 0:
            assert_apart(result)
        else:
            assert_contact(points, points + t, result, depth=depth)
        outcomes["apart" if depth < 0 else "touching" if depth == 0 else "deep"] += 1
    # Cubes: 5³ of 7³ shifts meet, 3³ of them deep. Octahedra: the lattice has 129 points with
    # Σ |t_k| ≤ 4 and 63 with ≤ 3, out of 9³.
    expected = {"box": (27, 98, 218), "octahedron": (63, 66, 600)}[name]
    assert expected == tuple(outcomes[kind] for kind in ("deep", "touching", "apart"))


SIGNS = np.array(list(itertools.product([-1.0, 1.0], repeat=3)))


@pytest.mark.parametrize("exponent", [4, 8, 11, 13])
def test_nearly_parallel_edges(exponent):
    """Two square beams edge on edge, 2 long, one turned about the vertical by a tilt φ = 10^-k.

    Their edges cross in the middle, so pushed δ into each other they part by δ along the vertical,
    or sideways along a face, at 45°. There the end of the tilted edge reaches sin φ farther, and
    the way is (δ + sin φ)/√2 but for terms in φ². For δ < 2.4 φ the facet between the edges is the
    nearest one. It is about φ wide and must not get lost.
    """
    phi = 10.0**-exponent
    half = np.array([1.0, HALF / 2, HALF / 2])  # the edges are 1/2 above and below the middle
    q = quaternion([2, 3, -1], 55)
    R1, tilt, turn = (
        rotation(p).as_matrix()
        for p in (quaternion([1, 0, 0], 45), quaternion(UP, np.degrees(phi)), q)
    )
    R1, R2, up = turn @ R1, turn @ tilt @ R1, turn @ UP
    tolerance = 2e-15 + 0.1 * phi**2
    if phi < 2 * PARALLEL_SINE:  # they count as parallel: a face stands in for the facet
        tolerance += phi
    for delta in (phi / 2, 2 * phi, 10 * phi, 0.1, -phi / 2, -10 * phi, -1e-9, -1e-6):
        if -2 * PARALLEL_SINE < delta < 0:
            continue
        t = (1 - delta) * up
        points1, points2 = (SIGNS * half) @ R1.T, (SIGNS * half) @ R2.T + t
        result = GJK.is_collide(points1, points2)
        assert result[0] is (delta > 0), delta
        if delta > 0:
            assert_contact(points1, points2, result)
            error = abs(result[1] - min(delta, (delta + np.sin(phi)) * HALF))
            assert error < tolerance, delta
        if delta == phi / 2 and phi > 2 * PARALLEL_SINE:
            assert result[2][0] @ up > 1 - 1e-9


# --------------------------------------------------------------------------------------------------
# The contact patch
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sink", [0.0, 0.1])
def test_box_flat_on_box(sink):
    """A box 4 × 2 × 4 over one of 12 × 6 × 8: wholly on it, over a side, and over a corner."""
    q = quaternion([1, -2, 2], 25)
    # x from 4 to 6 of 4 … 8: middle 5, z wholly on it; and x from 3 to 6, z from 1 to 4
    for shift, centre in (((1.5, -2), (1.5, -2)), ((6, 1), (5, 1)), ((5, 3), (4.5, 2.5))):
        lower, upper = box(12, 6, 8), box(4, 2, 4) + [shift[0], 4 - sink, shift[1]]
        points1, points2 = turned(lower, q), turned(upper, q)
        result = GJK.is_collide(points1, points2)
        # the lower side of hull 2 is at 3 - sink
        position = turned([centre[0], 3 - sink, centre[1]], q)
        assert_contact(points1, points2, result, depth=sink, position=position)
        assert np.abs(result[2] - turned(UP, q)).max() < 1e-12


def test_edges_on_faces_and_on_edges():
    table, root = box(10, 2, 10), np.sqrt(2)
    # A beam 6 long lies with an edge on a face that reaches from -5 to 5: shifted by 5 along the
    # edge it touches from 2 to 5. The other way round the point is on the table, above the edge.
    beam = turned(box(2, 2, 6), quaternion([0, 0, 1], 45)) + [0, 1 + root - 0.01, 5]
    assert_contact(table, beam, GJK.is_collide(table, beam), 0.01, (0, 0.99, 3.5))
    assert_contact(beam, table, GJK.is_collide(beam, table), 0.01, (0, 1.0, 3.5))
    # Beams 4 long, edge on edge, the upper one shifted by 1: they share [-1, 2].
    result = GJK.is_collide(BEAM, BEAM + [1, 2 * root, 0])
    assert_contact(BEAM, BEAM + [1, 2 * root, 0], result, 0, (0.5, root, 0))
    # crossed: edge 1 is at z = 0, edge 2 at x = 0.7, and 0.02 lower
    other = CROSSED + [0.7, 2 * root - 0.02, 0.3]
    assert_contact(BEAM, other, GJK.is_collide(BEAM, other), 0.02, (0.7, root - 0.02, 0))


def overlap_of(polygon1, polygon2):
    """Corners (n, 2) of the overlap of two convex polygons, by the intersection of half planes.

    polygons : (k, 2), counter-clockwise, both around the origin
    """
    halfPlanes = []
    for polygon in (polygon1, polygon2):
        sides = np.roll(polygon, -1, axis=0) - polygon
        outward = np.stack((sides[:, 1], -sides[:, 0]), axis=1)
        halfPlanes.append(np.column_stack((outward, -(outward * polygon).sum(axis=1))))
    return HalfspaceIntersection(np.vstack(halfPlanes), np.zeros(2)).intersections


def polygon_centroid(points):
    """Centroid (2,) of the convex hull of points (n, 2) in the plane."""
    corners = points[Delaunay(points).simplices]
    areas = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    return areas @ corners.mean(axis=1) / areas.sum()


@pytest.mark.parametrize(("degrees", "shift"), [(30, (0, 0)), (77, (2, -1.5))])
def test_box_turned_about_the_vertical_on_a_box(degrees, shift):
    # An 8 × 8 box on one of 12 × 8: up to eight corners of the overlap, none of which is theirs.
    lower = box(12, 6, 8)
    upper = turned(box(8, 2, 8), quaternion(UP, degrees)) + [shift[0], 3.9, shift[1]]
    rectangle = np.array([[-6, -4], [6, -4], [6, 4], [-6, 4.0]])
    # x to the right and z upwards turn the other way about y than angles are counted
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    square = np.array([[-4, -4], [4, -4], [4, 4], [-4, 4.0]]) @ np.array([[c, -s], [s, c]]) + shift
    corners = overlap_of(rectangle, square)
    assert len(corners) >= 5
    x, z = polygon_centroid(corners)
    result = GJK.is_collide(lower, upper)
    # 0.1 deep; the lower side of hull 2 is at 2.9
    assert_contact(lower, upper, result, depth=0.1, position=[[x, 2.9, z]])
    # from the other side the patch is the same, and its point is on the rectangle
    swapped = GJK.is_collide(upper, lower)
    assert_contact(upper, lower, swapped, depth=0.1, position=[[x, 3, z]])


def test_what_is_no_solid_point_set_is_refused():
    cube = box(2, 2, 2)
    for points, message in (
        (np.zeros((9, 2)), "not shape (9, 2)"),
        (cube[:3], "expected at least four points as rows of 3, not shape (3, 3)"),
        (cube * [1, 1, 1e-7], "the points are flat, so their hull has no volume"),
        (cube * [1, 1, np.nan], "a coordinate is not finite or beyond 1e+12"),
        (cube * 3e-12, "one point set is over 1e+12 times as large as the other"),
    ):
        for pair in ((points, 20.0 * cube), (20.0 * cube, points)):
            with pytest.raises(ValueError, match=re.escape(message)):
                GJK.is_collide(*pair)


def test_facets_of_a_pair_in_tuples_and_on_arrays_give_the_same_bits(sweep, monkeypatch):
    for pair in sweep[::3]:
        answers = []
        for few in (0, 10**9):
            monkeypatch.setattr("GJK.FEW_DISTANCES", few)
            answers.append(GJK.is_collide(pair.points1, pair.points2))
        for one, other in zip(*answers, strict=True):
            assert np.array_equal(one, other), pair.label
