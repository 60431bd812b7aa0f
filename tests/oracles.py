"""Independent answers for the tests to compare with, and the shapes and bodies that they share.

Nothing here uses the code that it judges: rotations are SciPy's, and depths come from Qhull's hull
of the Minkowski difference. The arrays of a shape are read only.
"""

import itertools
import math
from fractions import Fraction
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from RBSFunctions import Mesh
from RigidBodySimulation import load_mesh_file

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT / "data"
COURSE = ROOT.parent / "shared" / "course"

SHAPES = ("tetrahedron", "box", "octahedron", "long-octahedron", "cylinder", "ellipsoid")
BOX = (12.0, 6.0, 8.0)  # the sizes of data/box.mesh along x, y, z
IDENTITY = (1.0, 0.0, 0.0, 0.0)
# How far from the plane of a face a vertex may count to it, relative to the size.
FEATURE = 1e-10


@lru_cache
def shape(name):
    """(vertices (V, 3), faces (F, 3), tets (T, 4)) of data/<name>.mesh, read only."""
    tables = load_mesh_file(DATA / f"{name}.mesh")
    for table in tables:
        table.setflags(write=False)
    return tables


def vertices_of(name):
    """The vertices (V, 3) of a shape about the middle of its bounding box."""
    points = shape(name)[0]
    return points - 0.5 * (points.min(axis=0) + points.max(axis=0))


def box(x, y, z):
    """The eight corners (8, 3) of a box about the origin."""
    return shape("box")[0] * (np.array([x, y, z]) / BOX)


def body(name, position=(0, 0, 0), orientation=IDENTITY, density=1.0, isFixed=False, size=1.0):
    """A `Mesh` of a shape; `size` scales it, by one factor or by three."""
    vertices, faces, tets = shape(name)
    return Mesh(name, vertices * size, faces, tets, density, position, orientation, isFixed)


def box_body(x, y, z, position, **settings):
    return body("box", position, size=np.array([x, y, z]) / BOX, **settings)


def ground():
    noRows = np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros((0, 4), int)
    return Mesh("ground", *noRows, 0.0, np.zeros((1, 3)), np.array([IDENTITY]), True)


STATE = ("position", "orientation", "linVelocity", "angVelocity")


def state_of(meshes):
    """Copies of positions, orientations and velocities of all meshes, one row (13,) a mesh."""
    rows = [np.concatenate([np.ravel(getattr(m, name)) for name in STATE]) for m in meshes]
    return np.array(rows).reshape(len(meshes), 13)


def restore(meshes, rows):
    """Gives meshes the state that `state_of` took, as a caller does: by assigning attributes."""
    for m, row in zip(meshes, rows, strict=True):
        m.position, m.orientation = row[None, 0:3].copy(), row[None, 3:7].copy()
        m.linVelocity, m.angVelocity = row[None, 7:10].copy(), row[None, 10:13].copy()


def rotation(q):
    """SciPy's `Rotation` of quaternions with the scalar part first: (4,), (1, 4) or (n, 4)."""
    return Rotation.from_quat(np.asarray(q)[..., [1, 2, 3, 0]])


def quaternion(axis, degrees):
    """The unit quaternion (4,) that turns by an angle about an axis."""
    axis = np.asarray(axis, dtype=float)
    half = np.radians(degrees) / 2
    return np.concatenate(([np.cos(half)], np.sin(half) * axis / np.linalg.norm(axis)))


def random_quaternions(rng, count):
    """(count, 4), uniform over all rotations."""
    q = rng.normal(size=(count, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def turned(points, q):
    """The points (n, 3) turned by a quaternion (4,)."""
    return rotation(q).apply(np.array(points))  # a copy: SciPy refuses read-only ones


def minkowski_depth(points1, points2):
    """The depth of two solid hulls: how far point set 2 must move to separate.

    The hulls meet if A - B contains the origin; the shortest translation that takes the origin out
    of it, along the normal of a facet, separates them. Qhull is given A - B stretched to a cube,
    because thin hulls would lose facets: an affine map takes facets to facets. The penetrations
    along them are worked out in extended precision, at the points as they are. A negative depth
    says that they are apart but is no distance.
    """
    differences = (points1[:, None] - points2[None]).reshape(-1, 3)
    centred = differences - differences.mean(axis=0)
    axes = np.linalg.svd(centred, full_matrices=False)[2]
    extents = np.abs(centred @ axes.T).max(axis=0)
    normals = ConvexHull(differences @ axes.T / extents).equations[:, :3] / extents @ axes
    normals = normals.astype(np.longdouble)
    normals /= np.sqrt((normals * normals).sum(axis=1, keepdims=True))
    return float(((points1 @ normals.T).max(axis=0) - (points2 @ normals.T).min(axis=0)).min())


def exact_depth(points1, points2):
    """Depth of two hulls of few points, in whole numbers: only the result is rounded.

    The directions tried are those perpendicular to any two lines between points of a set, which
    include the normals of all facets of A - B. A negative depth is the widest gap along
    one of them, or from point to point or from point to line, and so minus the distance.
    """
    unit, sets = _whole_numbers(points1, points2)
    lines = {}
    for points in sets:
        for a, b in itertools.combinations(points, 2):
            d = (b - a) // math.gcd(*(b - a))
            lines[max(tuple(d), tuple(-d))] = d
    lines = np.array([*lines.values()])
    pairs = np.triu_indices(len(lines), 1)
    least = _least_overlap(*sets, np.cross(*lines[np.stack(pairs)]))
    if least < 0:
        between = (sets[0][:, None] - sets[1]).reshape(-1, 1, 3)
        shares = (between * lines).sum(axis=2)[..., None]
        across = (lines * lines).sum(axis=1)[:, None] * between - shares * lines
        for normals in (between, across):
            least = min(least, _least_overlap(*sets, normals.reshape(-1, 3)))
    digits = 2 * max(0, 80 + (least.denominator.bit_length() - least.numerator.bit_length()) // 2)
    root = math.isqrt((abs(least.numerator) << digits) // least.denominator)
    return math.copysign(float(root * unit / 2 ** (digits // 2)), least)


def _whole_numbers(*tables):
    """`(unit, sets)`: each table's points once, as arrays of Python's whole numbers of units."""
    fractions = [[tuple(map(Fraction, row)) for row in table.tolist()] for table in tables]
    denominator = max(x.denominator for rows in fractions for row in rows for x in row)
    whole = [[[int(x * denominator) for x in row] for row in dict.fromkeys(f)] for f in fractions]
    shift = math.gcd(*(x for rows in whole for row in rows for x in row)) or 1
    return Fraction(shift, denominator), [np.array(rows, dtype=object) // shift for rows in whole]


def _least_overlap(points1, points2, normals):
    """The least overlap of two sets along the normals and against them: its square, with a sign."""
    heights1, heights2 = points1 @ normals.T, points2 @ normals.T
    overlaps = np.minimum(heights1.max(0) - heights2.min(0), heights2.max(0) - heights1.min(0))
    lengths2 = (normals * normals).sum(axis=1)
    return min(Fraction(o * abs(o), n) for o, n in zip(overlaps, lengths2, strict=True) if n)


def penetrations(meshes):
    """Depths of the bodies in each other and in the ground: array (Q,) of those above 0.

    Uses the Minkowski difference of every pair whose boxes overlap, unless both are fixed.
    """
    vertices = [m.currVertices[m.hull.vertexIndex] for m in meshes]
    low = np.array([v.min(axis=0) for v in vertices])
    high = np.array([v.max(axis=0) for v in vertices])
    meet = (low[:, None] <= high[None]).all(axis=2)
    meet &= meet.T
    depths = [-low[k, 1] for k, m in enumerate(meshes) if not m.isFixed]
    for i, j in zip(*np.nonzero(np.triu(meet, 1)), strict=True):
        if not (meshes[i].isFixed and meshes[j].isFixed):
            depths.append(minkowski_depth(vertices[i], vertices[j]))
    depths = np.array(depths)
    return depths[depths > 0]


def gap_along(points1, points2, normal):
    """Distance of the lowest of points2 above the highest of points1 along the normal."""
    normal = np.ravel(normal)
    return (points2 @ normal).min() - (points1 @ normal).max()


def distance_to_hull(points, p):
    """About the distance of p (3,) from the hull of points (n, 3).

    Non-negative least squares: weights λ ≥ 0 that bring Σ λ_i x_i to p and Σ λ_i to 1. The
    residual is 0 for a p in the hull, else within a small factor of its distance.
    """
    unit = np.abs(points - p).max() or 1.0
    rows = np.vstack(((points - p).T / unit, np.ones(len(points))))
    return nnls(rows, np.array([0.0, 0.0, 0.0, 1.0]))[1] * unit


def assert_contact(points1, points2, result, depth=None, position=None):
    """Asserts that a contact separates the hulls, with this depth and position if they are given.

    Moved by depth · normal, hull 2 touches hull 1: the gap along the normal is 0. The point belongs
    to hull 2 and to its lowest plane along the normal, hence to its surface. Moved likewise, it
    belongs to hull 1's surface, within the tolerance of features.
    """
    isCollision, found, normal, point = result
    assert isCollision is True and isinstance(found, float) and found >= 0
    assert normal.shape == point.shape == (1, 3)
    assert abs(np.linalg.norm(normal) - 1) < 1e-14
    size = size_of(points1, points2)
    # Coordinates far from the origin are rounded by more than the size calls for.
    reach = np.finfo(float).eps * max(np.abs(points1).max(), np.abs(points2).max())
    tolerance = 1e-12 * size + 8 * reach
    assert abs(gap_along(points1, points2 + found * normal, normal)) <= tolerance
    for points, p, side in ((points2, point, -1), (points1, point + found * normal, 1)):
        assert distance_to_hull(points, p[0]) <= 2 * FEATURE * size + 8 * reach
        height = (points - p) @ normal[0]
        assert abs((side * height).max()) <= tolerance
    if depth is not None:
        assert abs(found - depth) <= 1e-13 * size + 4 * reach
    if position is not None:
        assert np.abs(point - position).max() <= 1e-12 * size + 4 * reach


def size_of(points1, points2):
    """The sum of both point sets' radii, to which tolerances are relative, as in GJK.py."""
    centred = (p - 0.5 * (p.min(axis=0) + p.max(axis=0)) for p in (points1, points2))
    return sum(np.linalg.norm(p, axis=1).max() for p in centred)
