"""Convex hulls: `Hull` of a shape, `RotatedHull` of a body, `HullSet` of many bodies in tables."""

import copy
import math
from functools import cached_property, lru_cache

import numpy as np

from rbs.geometry.vectors import cross, dot, mat_vec, norm, ranges, take

EPS = np.finfo(np.float64).eps

# Separation up to which hulls touch, as a fraction of their size: the rounding of a rotation and a
# translation. Less loses the contact of a box that stands exactly on another.
TOUCH_TOLERANCE = 64 * EPS
# Distance from a supporting plane up to which vertices belong to its feature, as a fraction of the
# hulls' size. Less loses corners of a resting face; more moves contact points off the surface.
FEATURE_TOLERANCE = 1e-10
# Rounding error of a few operations on coordinates, as a fraction of the coordinates.
ROUNDING = 16 * EPS
# Sine of the angle below which two edges are parallel and span no facet. The adjacent facets then
# err by at most this angle times the length of the edges.
PARALLEL_SINE = 1e-12
# Sine of the angle between an edge and both faces of another one beyond which their facet cannot be
# due to rounding, for coordinates up to a million times the size of the bodies.
SURE_SINE = 1e-5
# Least gap along a cached axis that proves separation, as a fraction of the size. Below it, the
# sign of the least penetration decides, so that one rule applies to every touching pair.
LEAST_GAP = 1e-6
# Largest coordinate allowed, in the unit of the points. Rounding of larger ones becomes visible.
LARGEST_COORDINATE = 1e12
# Least thickness of a hull, as a fraction of its length. With less, both sides are one feature.
LEAST_ASPECT = 10.0 * FEATURE_TOLERANCE


class Hull:
    """Convex hull of a point set: vertices, faces and edges, in the frame of the points.

    vertices : (V, 3), extreme points; vertexIndex : (V,), their rows in the point set
    directions : (D, 3), unit outward normals of the faces, with coplanar triangles merged
    offsets : (D,), largest directions[k] · v over the vertices
    corners : (ΣC,), rows in `vertices`, face by face, counter-clockwise seen from outside
    cornerCount : (D,), number of corners of each face
    vertexFaces : (ΣA,), faces at each vertex, ascending, vertex by vertex
    vertexFaceCount : (V,), number of faces at each vertex
    edgeTail : (E,), row in `vertices` of the start of the edge
    edgeVector : (E, 3), from there to its end, along directions[f1] × directions[f2]
    edgeFaces : (E, 2), adjacent faces f1, f2; the arc between their normals is the edge's Gauss map
    radius : largest |v|; volume
    """

    def __init__(self, points):
        """points : (n, 3). Raises QhullError if they have no volume."""
        from scipy.spatial import ConvexHull, QhullError  # takes long to import

        # The vector product of each triangle is that of its two shorter sides: rounding would be
        # much larger with two nearly parallel long ones.
        qhull = ConvexHull(points)
        corners = points[qhull.simplices]
        sides = (corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]).transpose(2, 0, 1)
        order = (dot(sides, sides).argmax(axis=1)[:, None] + np.arange(3)) % 3
        corners = np.take_along_axis(corners, order[:, :, None], axis=1)
        areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        inward = (areas * qhull.equations[:, :3]).sum(axis=1, keepdims=True) < 0
        areas = np.where(inward, -areas, areas)
        tables = qhull.simplices, qhull.neighbors
        triangles, neighbours = (np.where(inward, one[:, [0, 2, 1]], one) for one in tables)
        # Qhull gives the triangles of one flat facet one equation
        face = np.unique(qhull.equations, axis=0, return_inverse=True)[1].reshape(-1)
        normals = np.zeros((face.max() + 1, 3))
        np.add.at(normals, face, areas)
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        if not lengths.all():
            raise QhullError("a face has no area")
        heights = corners[:, 0].T - points[qhull.vertices[0]][:, None]
        self.volume = float(dot(heights, areas.T).sum()) / 6.0

        # Triangle i shares the side opposite corner j with neighbours[i, j]. Counter-clockwise seen
        # from outside, this side points along n_i × n_neighbour.
        isFirst = np.arange(len(triangles))[:, None] < neighbours
        i, j = np.nonzero(isFirst & (face[:, None] != face[neighbours]))
        tail, head = triangles[i, (j + 1) % 3], triangles[i, (j + 2) % 3]
        self.vertexIndex = np.sort(qhull.vertices)
        self.vertices = vertices = points[self.vertexIndex]
        self.directions = normals / lengths
        ends = self.vertexIndex.searchsorted(triangles)
        vertex, self.vertexFaces = np.unique((ends.ravel(), face.repeat(3)), axis=1)
        self.vertexFaceCount = np.bincount(vertex)
        self.edgeTail = self.vertexIndex.searchsorted(tail)
        self.edgeVector = points[head] - points[tail]
        self.edgeFaces = np.stack((face[i], face[neighbours[i, j]]), axis=1)
        self.radius = math.sqrt(dot(vertices.T, vertices.T).max())
        self.offsets, face, corners = self._find_corners(face.repeat(3), ends)
        u = tangents(self.directions.T)
        axes = (take(axis, face, axis=1) for axis in (u, cross(self.directions.T, u)))
        order = by_angle(face, *(dot(axis, vertices[corners].T) for axis in axes))
        self.corners, self.cornerCount = corners[order], np.bincount(face)

    def _find_corners(self, face, ends):
        """Offsets (D,), and faces and vertices (ΣC,) of all corners, face by face.

        Any vertex up to FEATURE_TOLERANCE below a face is a corner of it. The vertices above a
        level are connected, so that the search goes from the triangles' corners to neighbours.
        """
        count, depth = len(self.vertices), FEATURE_TOLERANCE * self.radius
        links = np.unique(ends[:, [0, 1, 1, 2, 2, 0, 1, 0, 2, 1, 0, 2]].reshape(-1, 2), axis=0)
        degree = np.bincount(links[:, 0])
        start = degree.cumsum() - degree
        offsets = np.full(len(self.directions), -np.inf)
        known, found = np.zeros(0, dtype=np.intp), face * count + ends.ravel()
        while len(found):
            face, heights = found // count, self._heights(found)
            np.maximum.at(offsets, face, heights)
            new = np.setdiff1d(found[heights >= offsets[face] - depth], known)
            known = np.union1d(known, new)
            face, vertex = np.divmod(new, count)
            row, link = ranges(start[vertex], degree[vertex])
            found = face[row] * count + links[link, 1]
        isCorner = self._heights(known) >= offsets[known // count] - depth
        return offsets, *np.divmod(known[isCorner], count)

    def _heights(self, keys):  # keys : direction · V + vertex
        direction, vertex = np.divmod(keys, len(self.vertices))
        return dot(self.directions[direction].T, self.vertices[vertex].T)


def build_hull(points):
    """Returns the `Hull` of points (n, 3); equal points give the same read-only object.

    Raises ValueError if the points have no volume, or as `checked_points` does.
    """
    return _hull_of_bytes(checked_points(points).tobytes())


def checked_points(points):
    """Returns points as a contiguous array (n, 3). Raises ValueError if they are fewer than four,
    or a coordinate is not finite or beyond LARGEST_COORDINATE.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4:
        raise ValueError(f"expected at least four points as rows of 3, not shape {points.shape}")
    if not np.abs(points).max() <= LARGEST_COORDINATE:
        raise ValueError(f"a coordinate is not finite or beyond {LARGEST_COORDINATE:g}")
    return points


@lru_cache(maxsize=512)
def _hull_of_bytes(data):
    from scipy.spatial import QhullError

    points = np.frombuffer(data, dtype=np.float64).reshape(-1, 3)
    try:
        hull = Hull(points)
    except QhullError:
        hull = None
    if hull is None or _is_flat(hull, LEAST_ASPECT * np.ptp(points, axis=0).max()):
        raise ValueError("the points are flat, so their hull has no volume")
    return hull


def _is_flat(hull, least):
    # mostly, a ball about the mean shows that it is not
    if 2.0 * (hull.offsets - hull.directions @ hull.vertices.mean(axis=0)).min() >= least:
        return False
    return any(np.ptp(hull.vertices @ direction) < least for direction in hull.directions)


class RotatedHull:
    """The hull of one body at its orientation.

    hull : `Hull`, at rest; rotation : nine floats, matrix row by row
    points : (3, n), the rotated point set; vertices : (3, V), those of the hull
    low, high : three floats each, bounding box of the hull
    """

    def __init__(self, hull, points, rotation):
        """points : (n, 3), at rest."""
        self.hull, self.rotation = hull, rotation
        self.points = mat_vec(np.array(rotation), points.T)
        self.vertices = self.points.take(hull.vertexIndex, axis=1)
        self.low = self.vertices.min(axis=1).tolist()
        self.high = self.vertices.max(axis=1).tolist()

    @cached_property
    def normals(self):
        """Outward unit normals (3, F) of the faces."""
        return mat_vec(np.array(self.rotation), self.hull.directions.T)


def tangents(normal):
    """Unit vectors u (3, M) along n × the axis farthest from n (3, M): u, n × u, n is a frame."""
    axis = np.abs(normal).argmin(axis=0)
    across = cross(normal, (np.arange(3)[:, None] == axis).astype(float))
    return across / norm(across)


def by_angle(row, u, v):
    """Order that sorts points (u, v) by row and, within it, counter-clockwise about their mean."""
    count = np.maximum(np.bincount(row), 1)
    du, dv = (x - take(np.bincount(row, x) / count, row) for x in (u, v))
    length = np.abs(du) + np.abs(dv)
    # increases with the angle, from -2 to 2; unlike arctan2, it has the same bits on all machines
    turn = np.copysign(1.0 - du / np.where(length > 0.0, length, 1.0), dv)
    return np.lexsort((turn, row))


class HullSet:
    """Hulls of n bodies in flat tables, rotated to the bodies' orientations.

    The tables are those of `Hull`, as columns, with count and start: body b has vertexCount[b]
    vertices from vertexStart[b] on, and likewise faces and edges; face k its corners from
    cornerStart[k] on; vertex k its faces, positions in `normals`, from vertexFaceStart[k] on.
    Edges are stored at rest, once for each of the `distinct` hulls.

    rotation : (9, n), matrices row by row; shape : (n,), index of each body's hull in `distinct`
    radius, thickness : (n,), from each body's centre to its farthest vertex and its nearest face
    """

    def __init__(self, hulls):
        number = {hull: k for k, hull in enumerate(dict.fromkeys(hulls))}
        self.distinct = tuple(number)
        self.shape = np.array([number[hull] for hull in hulls], dtype=np.intp)

        def table(name, hulls=hulls):
            return np.ascontiguousarray(np.concatenate([getattr(h, name) for h in hulls]).T)

        def parts(name, hulls=hulls):  # count and start, of each hull
            count = np.array([len(getattr(hull, name)) for hull in hulls], dtype=np.intp)
            return count, count.cumsum() - count

        self.vertices, self.normals = table("vertices"), table("directions")
        self.vertexCount, self.vertexStart = parts("vertices")
        self.faceCount, self.faceStart = parts("directions")
        self.offsets, self.corners = table("offsets"), table("corners")
        self.cornerCount = table("cornerCount")
        self.cornerStart = self.cornerCount.cumsum() - self.cornerCount
        self.vertexFaceCount = table("vertexFaceCount")
        self.vertexFaceStart = self.vertexFaceCount.cumsum() - self.vertexFaceCount
        self.vertexFaces = table("vertexFaces") + self.faceStart.repeat(parts("vertexFaces")[0])
        ofEdges = "edgeVector", "edgeTail", "edgeFaces"
        self.edges, self.edgeTail, self.edgeFaces = (table(n, self.distinct) for n in ofEdges)
        count, start = parts("edgeTail", self.distinct)
        self.edgeCount, self.edgeStart = count[self.shape], start[self.shape]
        self.rotation = np.eye(3).reshape(9, 1).repeat(len(hulls), axis=1)
        self.radius = np.array([hull.radius for hull in hulls])
        self.thickness = np.array([hull.offsets.min() for hull in hulls])
        self.entryCount = self.vertexCount + self.faceCount + self.edgeCount

    def rotated(self, rotation, vertices=None):
        """Returns a copy of these rest hulls, rotated.

        rotation : (9, n), matrices row by row; vertices : (3, ΣV), rotated vertices, if known
        """
        result = copy.copy(self)
        if vertices is None:
            vertices = rotate_columns(rotation, self.vertices, self.vertexCount)
        result.vertices, result.rotation = vertices, rotation
        result.normals = rotate_columns(rotation, self.normals, self.faceCount)
        return result


def rotate_columns(rotation, table, count):
    """Rotates a table (3, K) with count[b] columns for each body b by its matrix rotation[:, b]."""
    return np.array([dot(rotation[k : k + 3].repeat(count, axis=1), table) for k in (0, 3, 6)])


def face_corners(hulls, bodies, face):
    """Corners of a face (K,) of each body, from its centre: `(row (C,), (3, C), count (K,))`."""
    count = take(hulls.cornerCount, face)
    row, corner = ranges(take(hulls.cornerStart, face), count)
    corner = take(hulls.corners, corner) + take(take(hulls.vertexStart, bodies), row)
    return row, take(hulls.vertices, corner, axis=1), count
