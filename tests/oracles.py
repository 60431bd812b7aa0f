"""Independent answers for the tests to compare with, and the shapes and bodies that they share.

Nothing here uses the code that it judges: rotations are SciPy's, depths come from Qhull's hull of
the Minkowski difference, and the arrays of a shape are read only, so that whoever changes an
argument in place raises at once.
"""

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull, Delaunay
from scipy.spatial.transform import Rotation

from RBSFunctions import Mesh
from RigidBodySimulation import load_mesh_file

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT / "data"
COURSE = ROOT.parent / "shared" / "course"

needs_course = pytest.mark.skipif(
    not COURSE.is_dir(), reason=f"the coursework's own files are not at {COURSE}"
)

SHAPES = ("tetrahedron", "box", "octahedron", "long-octahedron", "cylinder", "ellipsoid")
BOX = (12.0, 6.0, 8.0)  # the sizes of data/box.mesh along x, y, z
IDENTITY = (1.0, 0.0, 0.0, 0.0)


# --------------------------------------------------------------------------------------------------
# Shapes and bodies
# --------------------------------------------------------------------------------------------------


def body_count(path):
    """How many bodies a scene file announces, in its first line that is no comment."""
    lines = (line.split("#")[0].split() for line in path.read_text().splitlines())
    return int(next(fields[0] for fields in lines if fields))


def frozen(array):
    """The array, made read only."""
    array.setflags(write=False)
    return array


@lru_cache
def shape(name):
    """(vertices (V, 3), faces (F, 3), tets (T, 4)) of data/<name>.mesh, read only."""
    return tuple(frozen(array) for array in load_mesh_file(DATA / f"{name}.mesh"))


def vertices_of(name):
    """The vertices (V, 3) of a shape about the middle of its bounding box."""
    points = shape(name)[0]
    return points - 0.5 * (points.min(axis=0) + points.max(axis=0))


def box(x, y, z):
    """The eight corners (8, 3) of a box about the origin."""
    return shape("box")[0] * (np.array([x, y, z]) / BOX)


def body(
    name, position=(0.0, 0.0, 0.0), orientation=IDENTITY, density=1.0, isFixed=False, size=1.0
):
    """A `Mesh` of a shape; `size` scales it, by one factor or by three."""
    vertices, faces, tets = shape(name)
    return Mesh(name, vertices * size, faces, tets, density, position, orientation, isFixed)


def box_body(x, y, z, position, **settings):
    """A `Mesh` that is a box with the sizes x, y, z."""
    return body("box", position, size=np.array([x, y, z]) / BOX, **settings)


def ground():
    """The ground as the contract has it."""
    return Mesh("ground", np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros((0, 4), int),
                0.0, np.zeros((1, 3)), np.array([IDENTITY]), True)  # fmt: skip


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


# --------------------------------------------------------------------------------------------------
# Rotations
# --------------------------------------------------------------------------------------------------


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


# --------------------------------------------------------------------------------------------------
# Collision
# --------------------------------------------------------------------------------------------------


def minkowski_depth(points1, points2):
    """`(depth, normal)` of two solid hulls: how far and where point set 2 must move to part.

    The hulls meet where A - B holds the origin, and what moves the origin out of it the shortest
    way parts them. A facet with the outward normal n is at -n · x = offset; Qhull stores
    n · x + offset = 0, offset < 0 with the origin inside. A negative depth says that they are apart
    but is no distance.
    """
    differences = (points1[:, None] - points2[None]).reshape(-1, 3)
    equations = ConvexHull(differences).equations
    nearest = equations[:, 3].argmax()
    return -equations[nearest, 3], equations[nearest, :3]


def penetrations(meshes):
    """How deep the bodies are in each other and in the ground, array (Q,) of what is above 0.

    By the Minkowski difference of every pair whose boxes overlap; of two fixed ones, nothing.
    """
    vertices = [m.currVertices[m.hull.vertexIndex] for m in meshes]
    low = np.array([v.min(axis=0) for v in vertices])
    high = np.array([v.max(axis=0) for v in vertices])
    meet = (low[:, None] <= high[None]).all(axis=2)
    meet &= meet.T
    depths = [-low[k, 1] for k, m in enumerate(meshes) if not m.isFixed]
    for i, j in zip(*np.nonzero(np.triu(meet, 1)), strict=True):
        if not (meshes[i].isFixed and meshes[j].isFixed):
            depths.append(minkowski_depth(vertices[i], vertices[j])[0])
    depths = np.array(depths)
    return depths[depths > 0]


def gap_along(points1, points2, normal):
    """How far the lowest of points2 stands above the highest of points1 along the normal."""
    normal = np.ravel(normal)
    return (points2 @ normal).min() - (points1 @ normal).max()


def height_over_surface(points, p):
    """How far p (3,) lies outside the hull's farthest face plane: 0 on the surface, < 0 inside."""
    equations = ConvexHull(points).equations
    return (equations[:, :3] @ np.ravel(p) + equations[:, 3]).max()


def size_of(points1, points2):
    """What a tolerance is relative to: the sum of both point sets' radii, as in GJK.py."""
    return sum(np.linalg.norm(p - 0.5 * (p.min(axis=0) + p.max(axis=0)), axis=1).max()
               for p in (points1, points2))  # fmt: skip


def polygon_centroid(points):
    """Centroid (2,) of the convex hull of points (n, 2) in the plane."""
    corners = points[Delaunay(points).simplices]
    areas = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    return areas @ corners.mean(axis=1) / areas.sum()
