"""Convex hulls: what a body looks like to the collision test.

`build_hull` makes the `Hull` of a point set, once a shape; a `HullSet` has the hulls of many bodies
in flat tables, rotated to where the bodies are, and answers what lies foremost in a direction.

Lengths are those of the points; every tolerance here is relative to the size of the hulls.
"""

import copy
import math
from functools import lru_cache

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from rbs.arrays import indices, ranges, take
from rbs.vectors import dot, mat_vec, transpose

EPS = np.finfo(np.float64).eps

# Hulls closer than this, relative to their size, touch: the rounding of a rotation and a
# translation of the vertices. Larger, and bodies would be held together by it; smaller, and a box
# that stands exactly on another would lose its contact to rounding.
TOUCH_TOLERANCE = 64 * EPS

# Vertices this close to a supporting plane, relative to the size of the hulls, belong to the
# feature that rests on it. It must exceed what rounding tilts a resting face by, and it bounds how
# far a contact point may lie from the surface.
FEATURE_TOLERANCE = 1e-10

# What a few operations on coordinates lose, relative to the coordinates.
ROUNDING = 16 * EPS

# A point set whose extent along a principal axis is below this fraction of the largest one is flat
# there: closer to rounding than to a thickness.
FLAT_EXTENT = 1e-13
# Of smaller extents, products of three would vanish: a set of less is a point.
LEAST_EXTENT = 1e-75
# Coordinates may not be larger: products of three of them would be beyond all numbers.
LARGEST_COORDINATE = 1e75
# Below this aspect Qhull is given the points stretched to a cube, lest it merge the thin sides.
THIN_ASPECT = 1e-3


# --------------------------------------------------------------------------------------------------
# One hull
# --------------------------------------------------------------------------------------------------


class Hull:
    """The convex hull of a point set: vertices, face directions and edges, in the points' frame.

    vertices : (V, 3); the extreme points
    vertexIndex : (V,); their rows in the point set
    directions : (D, 3), unit; the outward normals of the faces, coplanar triangles merged
    offsets : (D,); the largest directions[k] · v over the vertices
    edgeTail : (E,); row in `vertices` of the point where the edge begins
    edgeVector : (E, 3); from there to its end, along directions[f1] × directions[f2]
    edgeFaces : (E, 2); the faces f1, f2 that meet there; the arc between their normals holds the
        edge's normals
    radius : the largest |v|
    volume : of the hull; 0 when it is flat

    A flat point set (a polygon, a segment, a point) gets its normals completed, so that the arcs of
    its edges still cover every normal of the edge: the in-plane normals of a polygon's sides split
    the half circles from its upper to its lower normal, four perpendiculars those of a segment.
    """

    def __init__(self, vertices, vertexIndex, directions, edgeTail, edgeVector, edgeFaces, volume):
        self.vertices = vertices
        self.vertexIndex = vertexIndex
        self.directions = directions
        self.edgeTail = edgeTail
        self.edgeVector = edgeVector
        self.edgeFaces = edgeFaces
        self.volume = volume
        projections = dot(directions.T[:, :, None], vertices.T[:, None, :])
        self.offsets = projections.max(axis=1)
        self.radius = math.sqrt(dot(vertices.T, vertices.T).max())

    def translated(self, shift):
        """The same hull moved by shift (3,)."""
        return Hull(
            self.vertices + shift, self.vertexIndex, self.directions,
            self.edgeTail, self.edgeVector, self.edgeFaces, self.volume,
        )  # fmt: skip


def build_hull(points):
    """The `Hull` of points (n, 3), n ≥ 1. Flat sets are hulls too.

    Equal points give the same object: hulls are read only. Raises ValueError where the points are
    not finite, or beyond LARGEST_COORDINATE.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0:
        raise ValueError(f"expected at least one point as rows of 3, got shape {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError("a point of the hull is not finite")
    if np.abs(points).max() > LARGEST_COORDINATE:
        raise ValueError(f"a coordinate of the hull is beyond {LARGEST_COORDINATE:g}")
    return _hull_of_bytes(points.tobytes())


@lru_cache(maxsize=512)
def _hull_of_bytes(data):
    points = np.frombuffer(data, dtype=np.float64).reshape(-1, 3)
    # from near by: far from the origin, a mean of the points themselves is rounded as they are
    centred = points - points[0]
    centred -= centred.mean(axis=0)
    # three rows of zeros give even one or two points three principal axes
    axes = np.linalg.svd(np.vstack((centred, np.zeros((3, 3)))), full_matrices=False)[2]
    if np.linalg.det(axes) < 0:  # keep the handedness: facets keep their orientation
        axes[2] = -axes[2]
    principal = centred @ axes.T
    extents = np.abs(principal).max(axis=0)
    dimension = np.count_nonzero(extents > max(FLAT_EXTENT * extents.max(), LEAST_EXTENT))
    if dimension == 3:
        thin = extents.min() < THIN_ASPECT * extents.max()
        try:
            return _solid_hull(points, principal / extents if thin else points)
        except QhullError:  # nothing but rounding holds the third dimension up
            dimension = 2
    if dimension == 2:
        try:
            return _polygon_hull(points, principal, axes)
        except QhullError:  # nor the second one
            dimension = 1
    if dimension == 1:
        return _segment_hull(points, principal, axes)
    return _point_hull(points)


def _solid_hull(points, stretched):
    """Hull of a solid point set; `stretched` is a well-conditioned affine image of the points."""
    qhull = ConvexHull(stretched)
    triangles = qhull.simplices
    corners = stretched[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = (normal * qhull.equations[:, :3]).sum(axis=1) < 0
    triangles = np.where(inward[:, None], triangles[:, [0, 2, 1]], triangles)
    neighbours = np.where(inward[:, None], qhull.neighbors[:, [0, 2, 1]], qhull.neighbors)

    # Qhull gives the triangles of one flat facet one equation.
    face = np.unique(qhull.equations, axis=0, return_inverse=True)[1].reshape(-1)
    corners = points[triangles]
    # The vector product at the corner opposite to the longest side: two long sides that are nearly
    # parallel would lose most of it to rounding.
    sides = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]
    apex = dot(sides.transpose(2, 0, 1), sides.transpose(2, 0, 1)).argmax(axis=1)
    order = (apex[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(corners, order[:, :, None], axis=1)
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros((face.max() + 1, 3))
    np.add.at(normals, face, areas)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    if not lengths.all():
        raise QhullError("a face has no area")
    normals /= lengths
    volume = dot(corners[:, 0].T - points[qhull.vertices[0]][:, None], areas.T).sum() / 6.0

    # Triangle i, counter-clockwise seen from outside, has its side opposite to corner j in common
    # with neighbours[i, j]; walked that way round, the side points along n_i × n_neighbour.
    i, j = np.nonzero(
        (np.arange(len(triangles))[:, None] < neighbours) & (face[:, None] != face[neighbours])
    )
    tail, head = triangles[i, (j + 1) % 3], triangles[i, (j + 2) % 3]
    row = np.full(len(points), -1)
    vertexIndex = np.sort(qhull.vertices)
    row[vertexIndex] = np.arange(len(vertexIndex))
    return Hull(
        points[vertexIndex], vertexIndex, normals,
        row[tail], points[head] - points[tail],
        np.stack((face[i], face[neighbours[i, j]]), axis=1), float(volume),
    )  # fmt: skip


def _polygon_hull(points, principal, axes):
    """Hull of points in a plane: the two sides, and half circles split at each side's normal."""
    ring = ConvexHull(principal[:, :2] / np.abs(principal[:, :2]).max(axis=0)).vertices
    vertices = points[ring]  # counter-clockwise about the third axis
    up = axes[2]
    count = len(ring)
    vectors = np.roll(vertices, -1, axis=0) - vertices
    outward = np.cross(vectors, up)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    side = np.arange(count)
    faces = np.concatenate(
        (
            np.stack((np.zeros(count, int), side + 2), axis=1),  # from up to outward
            np.stack((side + 2, np.ones(count, int)), axis=1),  # from outward to down
        )
    )
    return Hull(
        vertices, ring, np.vstack((up, -up, outward)),
        np.tile(side, 2), np.tile(vectors, (2, 1)), faces, 0.0,
    )  # fmt: skip


def _segment_hull(points, principal, axes):
    """Hull of points on a line: two ends, and the circle of normals about it as four arcs."""
    ends = np.array([principal[:, 0].argmin(), principal[:, 0].argmax()])
    along, p, q = axes
    around = np.arange(4)
    return Hull(
        points[ends], ends, np.array((p, q, -p, -q, along, -along)),
        np.zeros(4, int), np.tile(points[ends[1]] - points[ends[0]], (4, 1)),
        np.stack((around, (around + 1) % 4), axis=1), 0.0,
    )  # fmt: skip


def _point_hull(points):
    """Hull of a single place: six directions and one edge without length."""
    return Hull(
        points[:1], np.zeros(1, int), np.vstack((np.eye(3), -np.eye(3))),
        np.zeros(1, int), np.zeros((1, 3)), np.zeros((1, 2), int), 0.0,
    )  # fmt: skip


# --------------------------------------------------------------------------------------------------
# The hulls of many bodies
# --------------------------------------------------------------------------------------------------


class HullSet:
    """The hulls of n bodies in flat tables, rotated to where the bodies are.

    vertices : (3, ΣV), relative to the bodies' centres, at rest or rotated. Body b has
        vertexCount[b] of them from vertexStart[b] on
    rotation : (9, n), matrices row by row; None at rest
    radius : (n,), of each hull about its centre
    bySize : list of `(bodies (m,), columns (V, m))`: the bodies with the same number of vertices,
        and their columns in `vertices`

    The rest is there once for each shape, that is, for all bodies with the same hull, at rest.

    shape : (n,), the number of each body's hull among the distinct ones; distinct : a tuple of
        those; shapes : their vertices, (3, V) each
    directions : (3, ΣD), outward unit normals of the faces; offsets : (ΣD,). Body b has
        faceCount[b] from faceStart[b] on
    edges : (3, ΣE), vectors; edgeTail : (ΣE,), a vertex, and edgeFaces : (2, ΣE), two faces,
        counted from the body's first one. Body b has edgeCount[b] from edgeStart[b] on
    """

    def __init__(self, hulls):
        distinct = {id(hull): hull for hull in hulls}
        number = {key: k for k, key in enumerate(distinct)}
        self.distinct = distinct = tuple(distinct.values())
        self.shape = np.array([number[id(hull)] for hull in hulls], dtype=np.intp)

        def table(hulls, name):
            return np.ascontiguousarray(np.concatenate([getattr(h, name) for h in hulls]).T)

        def parts(name):  # of each body: how many, and where they begin
            count = np.array([len(getattr(hull, name)) for hull in distinct], dtype=np.intp)
            return count[self.shape], (count.cumsum() - count)[self.shape]

        self.vertices = table(hulls, "vertices")
        self.vertexCount, _ = parts("vertices")
        self.vertexStart = self.vertexCount.cumsum() - self.vertexCount
        self.bySize = []
        for count in np.unique(self.vertexCount).tolist():
            bodies = indices(self.vertexCount == count)
            self.bySize.append((bodies, self.vertexStart[bodies] + np.arange(count)[:, None]))
        self.shapes = [np.ascontiguousarray(hull.vertices.T) for hull in distinct]
        self.faceCount, self.faceStart = parts("directions")
        self.directions = table(distinct, "directions")
        self.offsets = table(distinct, "offsets")
        self.edgeCount, self.edgeStart = parts("edgeTail")
        self.edges = table(distinct, "edgeVector")
        self.edgeTail = table(distinct, "edgeTail")
        self.edgeFaces = table(distinct, "edgeFaces")
        self.radius = np.array([h.radius for h in hulls])
        self.rotation = None
        self.entryCount = self.vertexCount + self.faceCount + self.edgeCount

    def rotated(self, rotation, vertices=None):
        """These hulls, each rotated.

        rotation : (9, n), each body's matrix row by row
        vertices : (3, ΣV), the rotated vertices, where they are at hand
        """
        result = copy.copy(self)
        if vertices is None:
            vertices = rotate_columns(rotation, self.vertices, self.vertexCount)
        result.vertices = vertices
        result.rotation = rotation
        return result

    def boxes(self):
        """Least and greatest coordinates (3, n), (3, n) of each hull relative to its centre."""
        least, greatest = np.empty((2, 3, len(self.vertexCount)))
        for bodies, columns in self.bySize:
            vertices = take(self.vertices, columns, axis=1)
            least[:, bodies], greatest[:, bodies] = vertices.min(axis=1), vertices.max(axis=1)
        return least, greatest

    def body_vertices(self, b):
        """View (3, V) of the vertices of body b."""
        return self.vertices[:, self.vertexStart[b] : self.vertexStart[b] + self.vertexCount[b]]


def rotate_columns(rotation, table, count):
    """A table (3, K) of count[b] columns for each body b, rotated by the matrix rotation[:, b].

    rotation : (9, n), matrices row by row; count : (n,)
    """
    return mat_vec(rotation.repeat(count, axis=1), table)


# --------------------------------------------------------------------------------------------------
# What lies foremost
# --------------------------------------------------------------------------------------------------


def support_features(hulls, bodies, directions, tolerance=None):
    """The feature of each body that is lowest along a direction: its support along the opposite.

    bodies : (R,); directions : (3, R)
    tolerance : (R,), lengths, by default zeros; vertices up to this much higher than the lowest one
        belong to the feature too

    Returns `(level, first, last, count)`, (R,) each: how high the lowest vertex is along the
    direction; the feature's first and last vertices, columns in the set; how many it has.
    """
    count, begin = take(hulls.vertexCount, bodies), take(hulls.vertexStart, bodies)
    row, column = ranges(begin, count)
    heights = dot(directions.repeat(count, axis=1), take(hulls.vertices, column, axis=1))
    end = count.cumsum()
    start = end - count
    level = np.minimum.reduceat(heights, start)
    highest = level if tolerance is None else level + tolerance
    lowest = indices(heights <= take(highest, row))
    begins, ends = lowest.searchsorted(start), lowest.searchsorted(end)
    first, last = take(column, take(lowest, begins)), take(column, take(lowest, ends - 1))
    return level, first, last, ends - begins


def approximate_supports(hulls, bodies, directions):
    """`(level, vertex)`: level and first of `support_features`, up to rounding and in less time.

    The directions are rotated into the frames of the shapes, of which there are few, for BLAS to
    multiply. Its rounding differs between machines and with the number of rows: a hint only.
    """
    if hulls.rotation is not None:
        inverse = transpose(take(hulls.rotation, bodies, axis=1))
        directions = mat_vec(inverse, directions)
    shape = hulls.shape[bodies]
    level, vertex = np.empty(len(bodies)), hulls.vertexStart[bodies]
    for k, vertices in enumerate(hulls.shapes):
        rows = indices(shape == k)
        heights = take(directions, rows, axis=1).T @ vertices
        lowest = heights.argmin(axis=1)
        vertex[rows] += lowest
        level[rows] = take(heights, np.arange(len(rows)) * heights.shape[1] + lowest)
    return level, vertex


def support_offsets(hulls, first, second, normal):
    """Distance (P,) from the origin of the supporting plane of A - B with the normals (3, P)."""
    return -support_features(hulls, first, -normal)[0] - support_features(hulls, second, normal)[0]
