"""Convex against convex: who touches whom, how deep, along which normal, and where.

`is_collide` answers for one pair of vertex sets. The kernels below it answer for arrays of pairs
with the same elementwise formulas, so that a pair's result has the same bits whatever else is in
the batch: sums of products are written out, minima are taken by `argmin` (the first one wins), and
nothing goes through BLAS, `einsum` or a pairwise sum, apart from guesses at where to look first.

The picture behind all of it is the Minkowski difference M = A - B of two hulls, each relative to
its own centre. With t = centreB - centreA the hulls meet exactly when t lies in M, and the least
translation that parts them is the distance from t to the surface of M:

    depth(t) = min over the facets k of M of  pen_k(t),    pen_k(t) = h_k - n_k · t,

n_k being the outward unit normal of the facet and h_k its distance from the origin. Moving B by
depth · n_k of the minimal facet parts the pair. A facet of M is a face of A, a face of B turned
round, or the parallelogram of an edge of A and an edge of B whose arcs on the Gauss map cross.

Three stages share the work. GJK decides whether two hulls are apart and stops at the first
separating axis [1, 2]. For the rest, the facets of M near t are found among the faces and, with
the Gauss map [3], the edge pairs; where these are many, a bound excludes most: a facet with the
normal n has, for every pair of points a of A and b of B on it, pen ≥ n · (a - b - t). At last the
two features that support the minimal facet give the contact patch and its centre. As n_k and h_k
do not depend on t, the planes of a pair stay right while its bodies only translate. A simulation
asks for the facets at once: an axis from its last step does what GJK does, and bounds them too.

Layout: a vector of P pairs is an array (3, P), a table of K vectors for each pair (3, K, P): the
long axis is the last one. Vectors may also be tuples of three floats wherever only `dot`, `cross`
and arithmetic are used.

[1] Gilbert, Johnson, Keerthi: A fast procedure for computing the distance between complex objects
    in three-dimensional space. IEEE J. Robotics and Automation 4(2), 1988.
[2] van den Bergen: Collision Detection in Interactive 3D Environments, chapter 4. 2003.
[3] Gregorius: The separating axis test between convex polyhedra. Game Developers Conference 2013.
"""

import copy
import itertools
import math
from functools import lru_cache

import numpy as np
from scipy.spatial import ConvexHull, QhullError

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
# By how much the sides of a patch are moved out again when that has left nothing of it.
SLACK_GROWTH = 8

# Two edges with a sine below this are parallel and span no facet: the neighbouring facets are then
# within this angle times the edges' length of the truth.
PARALLEL_SINE = 1e-12

# Where an edge makes a larger sine than this with both faces of the other one, their facet is
# beyond the doubts of rounding, for coordinates up to a million times the size of the bodies.
SURE_SINE = 1e-5

# GJK stops when an iteration brings the origin's distance closer by less than this fraction.
GJK_PROGRESS = 1e-12
# GJK ends in a few iterations; rounding can make it cycle. Whatever it has not parted by then goes
# on to the facets, which settle it.
GJK_ITERATIONS = 48

# An axis that is guessed parts a pair only when the gap exceeds this fraction of the size; below it
# the sign of the facets' least pen_k decides, so that one rule stands behind every touching pair.
GUESS_GAP = 1e-6

# A point set whose extent along a principal axis is below this fraction of the largest one is flat
# there: closer to rounding than to a thickness.
FLAT_EXTENT = 1e-13
# Below this aspect Qhull is given the points stretched to a cube, lest it merge the thin sides.
THIN_ASPECT = 1e-3

# To rule out facets takes some hundred calls of NumPy, which is longer than to look at all of up to
# this many combinations of edges.
FEW_COMBINATIONS = 4000

# Table entries that are worked on at a time: their vectors stay in the processor's cache.
BLOCK_ENTRIES = 200_000
# With more shapes than this, to go through them one by one takes longer than to list all vertices.
MOST_SHAPES = 20
# Bodies whose tables are turned at a time, which stay in the cache too.
ROTATED_BODIES = 256


# The components x y z x y: what a product of vectors multiplies stands next to each other in it.
_CYCLE = np.array([0, 1, 2, 0, 1])


def take(table, index, axis=None):
    """`table.take(index, axis)` for indices that are known to be in range.

    To clip them is twice as fast as to check them; without an axis, the table counts as flat.
    """
    return table.take(index, axis=axis, mode="clip")


def indices(mask):
    """Where (K,) a mask (n,) is true; `np.flatnonzero` takes four times as long for short ones."""
    return mask.nonzero()[0]


def ranges(first, length):
    """`(row, place)`: for each row k of the arrays, the places first[k] … + length[k], one after
    the other."""
    row = np.arange(len(first)).repeat(length)
    place = np.arange(len(row))
    place += take(first + length - length.cumsum(), row)
    return row, place


def _blocks(length):
    """Slices of consecutive rows that have up to BLOCK_ENTRIES entries together, or are single.

    length : (R,), the entries of each row. Of no rows, an empty slice.
    """
    if length.sum() <= BLOCK_ENTRIES:
        yield slice(0, len(length))
        return
    end = length.cumsum()
    begin = 0
    while begin < len(length):
        limit = end[begin] - length[begin] + BLOCK_ENTRIES
        stop = max(begin + 1, int(end.searchsorted(limit, side="right")))
        yield slice(begin, stop)
        begin = stop


def least_of_rows(values, row, start):
    """`(least (R,), place (R,))`: the least value of each row, and of equals the first one's place.

    values, row : (K,), one row after the other, none of them empty; start : (R,), where they begin
    """
    least = np.minimum.reduceat(values, start)
    places = indices(values == take(least, row))
    return least, take(places, places.searchsorted(start))


def dot(a, b):
    """Scalar product of vectors by component: tuples of floats, or arrays with first axis 3."""
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):  # the same in fewer calls
        products = a * b
        total = products[0]
        total += products[1]
        total += products[2]
        return total
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a, b):
    """Vector product by component, a tuple or an array as the arguments; those as for `dot`."""
    if isinstance(a, np.ndarray):
        a, b = a.take(_CYCLE, axis=0), b.take(_CYCLE, axis=0)
        return a[1:4] * b[2:5] - a[2:5] * b[1:4]
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def difference(a, b):
    """a - b; arguments as for `dot`."""
    if isinstance(a, np.ndarray):
        return a - b
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def moved(v, factor, direction):
    """v + factor · direction; arguments as for `dot`."""
    if isinstance(v, np.ndarray):
        return v + factor * direction
    return (
        v[0] + factor * direction[0],
        v[1] + factor * direction[1],
        v[2] + factor * direction[2],
    )


# --------------------------------------------------------------------------------------------------
# Hulls: what one convex body looks like at rest
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

    Equal points give the same object: hulls are read only.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0:
        raise ValueError(f"expected at least one point as rows of 3, got shape {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError("a point of the hull is not finite")
    return _hull_of_bytes(points.tobytes())


@lru_cache(maxsize=512)
def _hull_of_bytes(data):
    points = np.frombuffer(data, dtype=np.float64).reshape(-1, 3)
    centred = points - points.mean(axis=0)
    # three rows of zeros give even one or two points three principal axes
    axes = np.linalg.svd(np.vstack((centred, np.zeros((3, 3)))), full_matrices=False)[2]
    if np.linalg.det(axes) < 0:  # keep the handedness: facets keep their orientation
        axes[2] = -axes[2]
    principal = centred @ axes.T
    extents = np.abs(principal).max(axis=0)
    dimension = int(np.count_nonzero(extents > FLAT_EXTENT * extents.max()))
    if dimension == 3:
        thin = extents.min() < THIN_ASPECT * extents.max()
        try:
            return _solid_hull(points, principal / extents if thin else points)
        except QhullError:  # nothing but rounding holds the third dimension up
            dimension = 2
    if dimension == 2:
        return _polygon_hull(points, principal, axes)
    if dimension == 1:
        return _segment_hull(points, principal, axes)
    return _point_hull(points)


def _solid_hull(points, stretched):
    """Hull of a solid point set; `stretched` is a well-conditioned affine image of the points."""
    qhull = ConvexHull(stretched)
    triangles = qhull.simplices
    corners = stretched[triangles]
    turned = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = (turned * qhull.equations[:, :3]).sum(axis=1) < 0
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
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
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


class HullSet:
    """The hulls of n bodies in flat tables, rotated to where the bodies are.

    vertices : (3, ΣV), relative to the bodies' centres; at rest, or turned by `rotated`. Body b has
        vertexCount[b] of them from vertexStart[b] on
    entries : (9, n), rotation matrices row by row; None at rest
    radius : (n,), of each hull about its centre
    ofCount : list of `(bodies (m,), columns (V, m))`: the bodies with as many vertices, and their
        columns in `vertices`

    The rest is there once for each shape, that is, for all bodies with the same hull, at rest.

    shape : (n,), the number of each body's hull among the distinct ones; shapes : their vertices,
        (3, V) each
    directions : (3, ΣD), outward unit normals of the faces; offsets : (ΣD,). Body b has
        faceCount[b] from faceStart[b] on
    edges : (3, ΣE), vectors; edgeTail : (ΣE,), a vertex, and edgeFaces : (2, ΣE), two faces,
        counted from the body's first one. Body b has edgeCount[b] from edgeStart[b] on
    """

    def __init__(self, hulls):
        distinct = {id(hull): hull for hull in hulls}
        number = {key: k for k, key in enumerate(distinct)}
        distinct = list(distinct.values())
        self.shape = np.array([number[id(hull)] for hull in hulls], dtype=np.intp)

        def table(hulls, name):
            return np.ascontiguousarray(np.concatenate([getattr(h, name) for h in hulls]).T)

        def parts(name):  # of each body: how many, and where they begin
            count = np.array([len(getattr(hull, name)) for hull in distinct], dtype=np.intp)
            return count[self.shape], (count.cumsum() - count)[self.shape]

        self.vertices = table(hulls, "vertices")
        self.vertexCount, _ = parts("vertices")
        self.vertexStart = self.vertexCount.cumsum() - self.vertexCount
        self.ofCount = []
        for count in np.unique(self.vertexCount).tolist():
            bodies = indices(self.vertexCount == count)
            self.ofCount.append((bodies, self.vertexStart[bodies] + np.arange(count)[:, None]))
        self.shapes = [np.ascontiguousarray(hull.vertices.T) for hull in distinct]
        self.faceCount, self.faceStart = parts("directions")
        self.directions = table(distinct, "directions")
        self.offsets = table(distinct, "offsets")
        self.edgeCount, self.edgeStart = parts("edgeTail")
        self.edges = table(distinct, "edgeVector")
        self.edgeTail = table(distinct, "edgeTail")
        self.edgeFaces = table(distinct, "edgeFaces")
        self.radius = np.array([h.radius for h in hulls])
        self.entries = None
        self.entryCount = self.vertexCount + self.faceCount + self.edgeCount

    def rotated(self, entries, vertices=None):
        """These hulls, each turned.

        entries : (9, n), each body's rotation matrix row by row
        vertices : (3, ΣV), the turned vertices, where they are at hand
        """
        turned = copy.copy(self)
        if vertices is None:
            vertices = rotate_columns(entries, self.vertices, self.vertexCount)
        turned.vertices = vertices
        turned.entries = entries
        return turned

    def boxes(self):
        """Least and greatest coordinates (3, n), (3, n) of each hull relative to its centre."""
        least, greatest = np.empty((2, 3, len(self.vertexCount)))
        for bodies, columns in self.ofCount:
            vertices = take(self.vertices, columns, axis=1)
            least[:, bodies], greatest[:, bodies] = vertices.min(axis=1), vertices.max(axis=1)
        return least, greatest

    def body_vertices(self, b):
        """View (3, V) of the vertices of body b."""
        return self.vertices[:, self.vertexStart[b] : self.vertexStart[b] + self.vertexCount[b]]


def _turn(entries, vectors):
    """Vectors (3, K), each turned by its rotation matrix, entries (9, K) row by row."""
    products = entries.reshape(3, 3, -1) * vectors
    turned = products[:, 0]
    turned += products[:, 1]
    turned += products[:, 2]
    return turned


def rotate_columns(entries, table, count):
    """A table (3, K) of count[b] columns for each body b, turned by its rotation entries[:, b].

    entries : (9, n), rotation matrices row by row; count : (n,)
    """
    turned = np.empty_like(table)
    ends = count.cumsum()
    begin = 0
    for b in range(0, len(count), ROTATED_BODIES):
        some = slice(b, b + ROTATED_BODIES)
        end = int(ends[some][-1])
        own = entries[:, some].repeat(count[some], axis=1)
        turned[:, begin:end] = _turn(own, table[:, begin:end])
        begin = end
    return turned


def lowest_features(hulls, bodies, directions, tolerance=None):
    """`(level (R,), first (R,), last (R,), count (R,))`: what of a body is lowest in a direction.

    bodies : (R,); directions : (3, R); tolerance : (R,), by default zeros; vertices that are higher
    than the lowest one, which is at the level, by up to this belong to the feature too
    first, last : columns in the set, of the feature's vertices; count : how many it has
    """
    length, begin = take(hulls.vertexCount, bodies), take(hulls.vertexStart, bodies)
    parts = []
    for some in _blocks(length):
        count = length[some]
        row, column = ranges(begin[some], count)
        heights = dot(
            directions[:, some].repeat(count, axis=1), take(hulls.vertices, column, axis=1)
        )
        end = count.cumsum()
        start = end - count
        least = level = np.minimum.reduceat(heights, start)
        if tolerance is not None:
            least = least + tolerance[some]
        places = (heights <= take(least, row)).nonzero()[0]
        begins, ends = places.searchsorted(start), places.searchsorted(end)
        first, last = take(column, take(places, begins)), take(column, take(places, ends - 1))
        parts.append((level, first, last, ends - begins))
    if len(parts) == 1:
        return parts[0]
    return tuple(np.concatenate(part) for part in zip(*parts, strict=True))


def lowest_vertices(hulls, bodies, directions):
    """`(level, vertex)`: level and first of `lowest_features`, but up to rounding.

    The directions are turned into the frames of the shapes instead, of which there are few, and
    BLAS multiplies, whose rounding depends on the machine and on the company.
    """
    if len(hulls.shapes) > MOST_SHAPES:
        return lowest_features(hulls, bodies, directions)[:2]
    if hulls.entries is not None:
        transposed = take(hulls.entries, bodies, axis=1)[[0, 3, 6, 1, 4, 7, 2, 5, 8]]
        directions = _turn(transposed, directions)
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
    return -lowest_features(hulls, first, -normal)[0] - lowest_features(hulls, second, normal)[0]


def _axes_or_centres(axes, translation):
    """The axes (3, P), and in place of columns of zeros the unit vectors along the translation."""
    length = np.sqrt(dot(translation, translation))
    # two centres in one place have no axis, and any other will do
    centres = translation / np.where(length > 0, length, 1.0)
    centres[0] += length == 0
    return centres if axes is None else np.where(dot(axes, axes) > 0, axes, centres)


# --------------------------------------------------------------------------------------------------
# Stage 1: GJK decides
# --------------------------------------------------------------------------------------------------

# The simplex in play has four slots, unused ones holding copies. Its boundary is made of six
# segments and four triangles: the slots of each, and whether a slot has a part in it.
_SEGMENTS = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]).T
_TRIANGLES = np.array([(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)]).T
_OPPOSITE = np.arange(4)


def _closest_on_simplex(w):
    """The point of each tetrahedron, given by corners w (3, 4, P), that is nearest to the origin.

    Corners may coincide. Returns `(inside, v, used)`: inside (P,), whether the origin is in the
    interior; v (3, P), the nearest boundary point; used (4, P), the corners that it is made of.
    """
    pairs = w.shape[2]
    columns = np.arange(pairs)
    p, q = w[:, _SEGMENTS[0]], w[:, _SEGMENTS[1]]
    d = q - p
    length2 = dot(d, d)
    s = np.clip(-dot(p, d) / np.where(length2 > 0, length2, 1.0), 0.0, 1.0)
    onSegment = p + s * d

    a, b, c = (w[:, slots] for slots in _TRIANGLES)
    n = cross(b - a, c - a)
    area2 = dot(n, n)
    height = dot(a, n)
    flat = area2 == 0
    safe = np.where(flat, 1.0, area2)
    # the weight of a corner is the area that the projected origin spans with the other two
    within = (dot(cross(b, c), n) > 0) & (dot(cross(c, a), n) > 0) & (dot(cross(a, b), n) > 0)
    onTriangle = n * (height / safe)
    # the origin and the opposite corner on the same side of all four faces
    inside = (height * dot(w[:, _OPPOSITE] - a, n) < 0).all(axis=0)

    points = np.concatenate((onSegment, onTriangle), axis=1)
    distance2 = dot(points, points)
    distance2[6:][~within | flat] = np.inf
    best = distance2.argmin(axis=0)
    v = points[:, best, columns]

    used = np.zeros((4, pairs), dtype=bool)
    seg = np.minimum(best, 5)
    isSegment = best < 6
    sBest = s[seg, columns]
    used[_SEGMENTS[0][seg], columns] |= isSegment & (sBest < 1.0)
    used[_SEGMENTS[1][seg], columns] |= isSegment & (sBest > 0.0)
    tri = np.maximum(best - 6, 0)
    for corner in _TRIANGLES:
        used[corner[tri], columns] |= ~isSegment
    return inside, v, used


def separating_axes(hulls, first, second, translation, gap, guess=None):
    """GJK on P pairs: which are further apart than `gap`, and along which axis.

    hulls : HullSet
    first, second : (P,), the bodies of each pair
    translation : (3, P), centre of the second minus centre of the first
    gap : (P,), ≥ 0; distance that has to be exceeded
    guess : (3, P), unit axes to try first; where a column is zero, and by default, those from
        centre to centre

    Returns `(separated, axis, distance)`: (P,) bool; and where separated, else zeros, (3, P) unit
    and (P,): every vertex of the second lies further along the axis than every vertex of the first,
    by at least the distance, which exceeds the gap.
    """
    count = len(first)
    separated, axis, distance = np.zeros(count, dtype=bool), np.zeros((3, count)), np.zeros(count)
    least2 = np.maximum(gap, TOUCH_TOLERANCE * (hulls.radius[first] + hulls.radius[second])) ** 2
    active, t = np.arange(count), translation
    # D = A - B - t holds the origin when the pair meets. The first v is a direction, the later
    # ones are the points of a simplex in D that are nearest to the origin.
    v = -_axes_or_centres(guess, translation)
    simplex = np.zeros((3, 4, count))
    used = np.zeros((4, count), dtype=bool)
    for iteration in range(GJK_ITERATIONS):
        # w, the point of D that is least along v: all of D lies beyond it
        bodies = np.concatenate((first[active], second[active]))
        _, lowest, *_ = lowest_features(hulls, bodies, np.concatenate((v, -v), axis=1))
        a, b = take(hulls.vertices, lowest.reshape(2, -1), axis=1).transpose(1, 0, 2)
        w = a - b - t
        v2, vw = dot(v, v), dot(v, w)
        length = np.sqrt(v2)
        apart = vw > gap[active] * length
        found = active[apart]
        separated[found] = True
        axis[:, found] = -v[:, apart] / length[apart]
        distance[found] = vw[apart] / length[apart]
        on = ~apart
        if iteration > 0:  # v is a point of D: no gap is wider than its length
            on &= (v2 > least2[active]) & (v2 - vw > GJK_PROGRESS * v2)
        on = indices(on)
        if len(on) == 0:
            break
        active, t, w, used, simplex = (
            take(table, on, axis=-1) for table in (active, t, w, used, simplex)
        )
        simplex = np.where(used, simplex, w[:, None])
        inside, v, used = _closest_on_simplex(simplex)
        on = indices(~inside)
        if len(on) == 0:
            break
        active, t, v, used, simplex = (
            take(table, on, axis=-1) for table in (active, t, v, used, simplex)
        )
    return separated, axis, distance


# --------------------------------------------------------------------------------------------------
# Stage 2: the facets of the Minkowski difference near the translation
# --------------------------------------------------------------------------------------------------


class FacetPlanes:
    """Facets of the Minkowski differences of P pairs, those that can be the nearest ones.

    start : (P + 1,); pair p has the columns start[p] … start[p + 1]
    normal : (3, K), unit; the second body moves along it to part
    offset : (K,); pen_k(t) = offset_k - normal_k · t
    bound : (P,); every facet with pen ≤ bound, at the translation that they were made at, is among
        them. -inf where the planes can only prove that the pair is apart
    complete : (P,) bool; whether they can do more

    A translation by Δ changes no pen_k by more than |Δ|. So where the least one at t + Δ is at most
    bound - |Δ|, it is that of the nearest facet: see `hold`.
    """

    def __init__(self, start, normal, offset, bound):
        self.start = start
        self.normal = normal
        self.offset = offset
        self.bound = bound

    complete = property(lambda self: self.bound > -np.inf)

    @classmethod
    def gathered(cls, parts, bound):
        """From a list of `(pair (K,), normal (3, K), offset (K,))`, in this order for each pair."""
        pair, normal, offset = (np.concatenate(part, axis=-1) for part in zip(*parts, strict=True))
        order = pair.argsort(kind="stable")
        start = pair[order].searchsorted(np.arange(len(bound) + 1))
        return cls(start, take(normal, order, axis=1), offset[order], bound)

    @classmethod
    def joined(cls, sets):
        """The pairs of several `FacetPlanes`, one set after the other."""
        start, normal, offset, bound = zip(
            *((planes.start, planes.normal, planes.offset, planes.bound) for planes in sets),
            strict=True,
        )
        count = np.concatenate([np.diff(s) for s in start])
        return cls(
            np.concatenate(([0], count.cumsum())), np.concatenate(normal, axis=1),
            np.concatenate(offset), np.concatenate(bound),
        )  # fmt: skip

    def of_pairs(self, pairs):
        """The planes of these pairs (Q,), in this order, as new `FacetPlanes`."""
        count = np.diff(self.start)[pairs]
        column = ranges(self.start[pairs], count)[1]
        return FacetPlanes(
            np.concatenate(([0], count.cumsum())), take(self.normal, column, axis=1),
            self.offset[column], self.bound[pairs],
        )  # fmt: skip

    def hold(self, p, pen, shift):
        """Whether pen, the least one of pair p at a translation `shift` from where its planes were
        made, is that of its nearest facet. p, pen : a number or (m,); shift : (3,) or (3, m)
        """
        return pen + np.sqrt(dot(shift, shift)) <= self.bound[p]

    def nearest(self, p, t):
        """`(pen, normal)` of pair p's nearest facet at the translation t, a tuple of 3 floats.

        pen < 0 proves that the pair is apart.
        """
        own = slice(self.start[p], self.start[p + 1])
        n = self.normal[:, own]
        pen = self.offset[own] - dot(n, t)
        k = pen.argmin()
        return float(pen[k]), tuple(n[:, k].tolist())

    def nearest_of_all(self, t):
        """`nearest` for all pairs at once: `(pen (P,), normal (3, P))` from t (3, P)."""
        count = np.diff(self.start)
        pair = np.repeat(np.arange(len(count)), count)
        pen = self.offset - dot(self.normal, take(t, pair, axis=1))
        least, place = least_of_rows(pen, pair, self.start[:-1])
        return least, take(self.normal, place, axis=1)


class AxisGuess:
    """An axis for each of P pairs that may part it, or be near the nearest facet's normal.

    axis : (3, P), unit
    offset : (P,); pen (P,) = offset - axis · translation: by how much the hulls overlap along the
        axis, which is no less than their depth, or are apart where it is negative; up to rounding
    vertex : (2, P), columns in the set: the vertex of the second hull that is least along the axis,
        and that of the first one that is foremost
    """

    def __init__(self, hulls, first, second, translation, axes=None):
        """axes : (3, P), unit; where a column is zero, and by default, those between the centres"""
        self.axis = _axes_or_centres(axes, translation)
        bodies = np.concatenate((second, first))
        level, vertex = lowest_vertices(
            hulls, bodies, np.concatenate((self.axis, -self.axis), axis=1)
        )
        level, self.vertex = level.reshape(2, -1), vertex.reshape(2, -1)
        self.offset = -level[1] - level[0]
        self.pen = self.offset - dot(self.axis, translation)


def facet_planes(hulls, first, second, translation, reach, guess=None):
    """The facet planes of P pairs that can be nearest within `reach` of the given translations.

    hulls, first, second, translation : as for `separating_axes`
    reach : (P,), ≥ 0; how far the translation may change before the planes have to be made anew.
        A facet that is nearest at t + Δ has pen ≤ depth(t) + 2 |Δ| at t, hence the rest is dropped.
        Few pairs keep all their facets, with a bound of inf
    guess : `AxisGuess`, or the axes (3, P) that it takes. The better they are, the less there is to
        do; they do not change what `FacetPlanes.nearest` says of a pair that collides

    Returns `FacetPlanes`, a pair's planes in the order: faces of the first, faces of the second,
    edge pairs. The order does not depend on the translation, so the same facet wins a tie. A pair
    that is further apart than its reach need not be complete: one plane shows that it is apart.
    """
    if 0 < (hulls.edgeCount[first] * hulls.edgeCount[second]).sum() <= FEW_COMBINATIONS:
        facets = _NearFacets(hulls, first, second, translation)
        facets.find_all()
        return FacetPlanes.gathered(facets.parts, facets.kept)
    if not isinstance(guess, AxisGuess):
        guess = AxisGuess(hulls, first, second, translation, guess)
    size = hulls.radius[first] + hulls.radius[second]
    limit = -reach - TOUCH_TOLERANCE * size
    isApart = guess.pen < np.minimum(limit, -GUESS_GAP * size)
    apart, near = indices(isApart), indices(~isApart)
    offset = guess.offset[apart] + ROUNDING * size[apart]
    parts = [(apart, take(guess.axis, apart, axis=1), offset)]
    bound = np.full(len(first), -np.inf)
    i, j = first[near], second[near]
    for some in _blocks(hulls.entryCount[i] + hulls.entryCount[j]) if len(near) else ():
        rows = near[some]
        facets = _NearFacets(hulls, i[some], j[some], take(translation, rows, axis=1))
        facets.find_near(
            guess.pen[rows], take(guess.vertex, rows, axis=1), reach[rows], limit[rows], size[rows]
        )
        parts += [(take(rows, pair), *planes) for pair, *planes in facets.parts]
        bound[rows] = facets.kept
    return FacetPlanes.gathered(parts, bound)


class _NearFacets:
    """What `facet_planes` finds for a block of pairs, at least one.

    parts : list of `(pair (K,), normal (3, K), offset (K,))`: faces, and edge pairs; each sorted by
        pair, faces and edges
    kept : (P,); the pen up to which all facets of a pair are among them; -inf where they only prove
        that it is apart

    The faces of each hull are compared with points of the other. A face of A with the normal n has,
    for every point x of B, pen ≥ how deep x lies below it: so of the faces, only those count below
    which every point that is looked at lies no deeper than the depth of the pair can be. The points
    are the vertex of B that is least along the guess, and the vertex that is deepest below the face
    that the first one is least below. The guess and that face also bound the depth. Few pairs get
    all facets instead.

    Everything is worked out for both hulls of P pairs together, in rows: row p has the faces and
    edges of the first one, row P + p those of the second.
    """

    def __init__(self, hulls, first, second, t):
        self.hulls = hulls
        self.own, self.other = np.concatenate((first, second)), np.concatenate((second, first))
        self.t = np.concatenate((t, -t), axis=1)
        self.parts = []
        self._list_faces()

    def find_all(self):
        """All facets."""
        self.kept = np.full(len(self.own) // 2, np.inf)
        self._take_faces(np.arange(len(self.row)))
        self.depths = self.nearPen, self.nearPen  # a bound of inf leaves nothing out
        self._keep_faces(self.kept)
        self._find_edges(self.kept, np.ones(len(self.kept), dtype=bool))

    def find_near(self, pen, vertex, reach, limit, size):
        """The facets within the reach.

        pen, vertex : as of `AxisGuess`; reach : as for `facet_planes`; limit : (P,), the least
        depth of a pair whose facets are asked for; size : (P,), of the pair
        """
        # Ties at rounding level have to survive: FEATURE_TOLERANCE is far above rounding.
        extra = 2.0 * reach + FEATURE_TOLERANCE * size
        # Of a pair that is apart, some facet has pen < 0, but none need be as low as the guess.
        depth = self._find_faces(vertex.ravel(), np.maximum(pen, 0.0), extra)
        complete = depth >= limit
        bound = depth + extra
        self._keep_faces(np.where(complete, bound, depth))
        self.kept = np.where(complete, depth + 2.0 * reach, -np.inf)
        self._find_edges(bound, complete)

    def _list_faces(self):
        """The faces of all rows: count, start : (2 P,); row, offset : (F,); normal : (3, F)."""
        hulls = self.hulls
        self.count = take(hulls.faceCount, self.own)
        self.start = self.count.cumsum() - self.count
        self.row, face = ranges(take(hulls.faceStart, self.own), self.count)
        self.normal = take(hulls.directions, face, axis=1)
        if hulls.entries is not None:
            entries = take(hulls.entries, self.own, axis=1)
            self.normal = rotate_columns(entries, self.normal, self.count)
        self.offset = take(hulls.offsets, face)

    def _depths_below_faces(self, vertex):
        """How deep (F,) the vertex (2 P,) of each row's other hull lies below the row's faces."""
        x = take(self.hulls.vertices, vertex, axis=1) + self.t
        return self.offset - dot(self.normal, x.repeat(self.count, axis=1))

    def _find_faces(self, vertex, pen, extra):
        """Lists the faces that can have a pen ≤ the depth + extra, see `_take_faces`.

        Returns the least pen (P,) of a pair's faces and its guess.
        """
        half = len(pen)
        first = self._depths_below_faces(vertex)
        best = least_of_rows(first, self.row, self.start)[1]
        _, vertex = lowest_vertices(self.hulls, self.other, take(self.normal, best, axis=1))
        second = self._depths_below_faces(vertex)
        self.depths = first, second
        # to the bit what the faces are compared by, so that a pair that is far apart keeps one
        bestPen = np.maximum(first[best], second[best])
        bound = np.minimum(np.minimum(bestPen[:half], bestPen[half:]), pen) + extra
        bound = np.concatenate((bound, bound)).repeat(self.count)
        self._take_faces(indices((first <= bound) & (second <= bound)))
        depth = pen.copy()
        np.minimum.at(depth, take(self.row, self.near) % half, self.nearPen)
        return depth

    def _take_faces(self, near):
        """Lists these faces (N,), in `near`.

        Their offsets, of the Minkowski difference, and pens are in nearOffset and nearPen.
        """
        row, normal = take(self.row, near), take(self.normal, near, axis=1)
        level = lowest_features(self.hulls, take(self.other, row), normal)[0]
        self.near = near
        self.nearOffset = self.offset[near] - level
        self.nearPen = self.nearOffset - dot(normal, take(self.t, row, axis=1))

    def _keep_faces(self, bound):
        """Adds the faces with pen ≤ bound (P,) to the parts."""
        half = len(bound)
        keep = self.nearPen <= take(bound, take(self.row, self.near) % half)
        row, face = take(self.row, self.near[keep]), self.near[keep]
        normal = take(self.normal, face, axis=1) * np.where(row < half, 1.0, -1.0)
        self.parts.append((row % half, normal, self.nearOffset[keep]))

    def _find_edges(self, bound, complete):
        """Adds the edge-edge facets with pen ≤ bound (P,) of the complete pairs to the parts.

        On the arc between the normals n1, n2 of an edge, with an end a of it and any point x of
        the other side, pen(n) ≥ n · (a - x). With n = (α n1 + β n2)/|…|, α, β ≥ 0, that is at
        least the smaller of n1 · (a - x) and n2 · (a - x), how deep x lies below the two faces,
        where both are positive. The points x are those of the faces and the middle between them:
        where two edges cross, each face of this side's edge has one end of the other's below it.
        """
        hulls, half = self.hulls, len(bound)
        limit = np.where(complete, bound, -np.inf)
        limit = np.concatenate((limit, limit)).repeat(self.count)
        one, other = self.depths
        # a bit for each point
        near = (one <= limit).view(np.uint8)
        near = near | (other <= limit).view(np.uint8) << 1
        near |= (0.5 * (one + other) <= limit).view(np.uint8) << 2
        rows = indices(np.concatenate((complete, complete)))
        own = self.own[rows]
        count = hulls.edgeCount[own]
        row, edge = ranges(hulls.edgeStart[own], count)
        ofFaces = take(hulls.edgeFaces, edge, axis=1) + self.start[rows].repeat(count)
        nearOne, nearOther = take(near, ofFaces)
        kept = indices((nearOne | nearOther) == 0b111)
        row, edge = take(rows, row[kept]), edge[kept]
        normals = take(self.normal, take(ofFaces, kept, axis=1), axis=1)
        edges = _Edges(hulls, edge, self.own[row], normals)
        for pair, normal, offset, isDoubtful in _edge_planes(edges, row, half):
            near = offset - dot(normal, take(self.t, pair, axis=1)) <= take(bound, pair)
            doubtful = indices(near & isDoubtful)
            if len(doubtful):
                own = pair[doubtful]
                i, j = self.own[own], self.other[own]
                offset[doubtful] = support_offsets(hulls, i, j, take(normal, doubtful, axis=1))
            near = indices(near)
            planes = take(pair, near), take(normal, near, axis=1), take(offset, near)
            self.parts.append(planes)


class _Edges:
    """Edges (K,) of the bodies (K,): vector, tail : (3, K); normals : (3, 2, K), of their faces.

    length2 : (K,), the squares of their lengths
    """

    def __init__(self, hulls, edge, bodies, normals):
        self.normals = normals
        self.vector = take(hulls.edges, edge, axis=1)
        if hulls.entries is not None:
            self.vector = _turn(take(hulls.entries, bodies, axis=1), self.vector)
        self.length2 = dot(self.vector, self.vector)
        tail = take(hulls.edgeTail, edge) + hulls.vertexStart[bodies]
        self.tail = take(hulls.vertices, tail, axis=1)


def _edge_planes(edges, row, count):
    """Yields `(pair (K,), normal (3, K), offset (K,), isDoubtful (K,))`: what edges span together.

    edges : `_Edges`; row : of each edge, in ascending order: pair p's of the first hull have p,
        those of the second count + p; count : how many pairs there are
    isDoubtful : bool; where rounding may have let two arcs cross that only touch. There, the offset
        has to be that of the supporting plane, not of the two edges, so that no vertex lies beyond

    The facets are sorted by pair, by edge of A and by edge of B.
    """
    ofRow = np.bincount(row, minlength=2 * count)
    begin = ofRow.cumsum() - ofRow
    pairA = row[: begin[count]]
    start, length = begin[count + pairA], ofRow[count + pairA]
    for some in _blocks(length):
        a, b = ranges(start[some], length[some])  # all combinations of a pair's edges
        a, b, side, sine2 = _crossing_arcs(edges, a + some.start, b)
        vectorA, vectorB = take(edges.vector, a, axis=1), take(edges.vector, b, axis=1)
        lengthA2, lengthB2 = edges.length2[a], edges.length2[b]
        normal = cross(vectorA, vectorB)
        length2 = dot(normal, normal)
        spans = length2 > PARALLEL_SINE**2 * lengthA2 * lengthB2
        normal = normal / np.where(spans, np.copysign(np.sqrt(length2), side), 1.0)
        # what rounding left along nearly parallel edges is taken out again
        normal = normal - vectorA * (dot(normal, vectorA) / lengthA2)
        normal = normal - vectorB * (dot(normal, vectorB) / lengthB2)
        normal = normal / np.sqrt(np.where(spans, dot(normal, normal), 1.0))
        offset = dot(normal, take(edges.tail, a, axis=1) - take(edges.tail, b, axis=1))
        spans = indices(spans)
        yield (
            take(pairA, take(a, spans)), take(normal, spans, axis=1), take(offset, spans),
            sine2[spans] < SURE_SINE**2,
        )  # fmt: skip


def _crossing_arcs(edges, a, b):
    """`(a, b, side, sine2)` of those combinations of edges a (K,) of A and b (K,) of B that span a
    facet.

    side : positive where their facet's normal is along eA × eB, negative where it is opposite
    sine2 : the square of the least sine between one edge and a face at the other

    An edge of A with the arc α1 α2 and an edge of B with the arc β1 β2 span a facet of A - B when
    the arcs α1 α2 and -β1 -β2 cross. Each edge vector is the pole of its arc, so with
    s_i = -eA · β_i and r_i = eB · α_i that is s1 s2 < 0, r1 r2 < 0 and s1 r2 > 0, the last one
    telling the crossing from its antipode [3]; the normal is on the side of r1.
    """
    r = dot(take(edges.normals, a, axis=2), take(edges.vector, b, axis=1)[:, None])
    kept = indices(r[0] * r[1] < 0)  # most are ruled out by now
    a, b, r = take(a, kept), take(b, kept), take(r, kept, axis=1)
    s = -dot(take(edges.normals, b, axis=2), take(edges.vector, a, axis=1)[:, None])
    kept = indices((s[0] * s[1] < 0) & (s[0] * r[1] > 0))
    a, b, r, s = take(a, kept), take(b, kept), take(r, kept, axis=1), take(s, kept, axis=1)
    sine2 = np.minimum(
        (r * r).min(axis=0) / take(edges.length2, b), (s * s).min(axis=0) / take(edges.length2, a)
    )
    return a, b, r[0], sine2


# --------------------------------------------------------------------------------------------------
# Stage 3: where they touch
# --------------------------------------------------------------------------------------------------


def contact_point(verticesA, verticesB, t, normal, tolerance):
    """Centre of the contact patch on B, relative to the centre of B, for one pair.

    verticesA, verticesB : (3, V), each hull's vertices relative to its centre
    t : tuple of 3, centre of B minus centre of A; normal : tuple of 3, unit, from A to B
    tolerance : vertices this close to a supporting plane belong to the feature that rests on it

    The patch is where the feature of A that is highest along the normal and the feature of B that
    is lowest overlap, seen along the normal. Returns a tuple of 3 floats p: p lies on the feature
    of B, and p + t + depth · normal on that of A, depth being that of the pair along the normal.
    """
    heightsB = dot(normal, verticesB)
    lowest = heightsB.argmin()
    level = float(heightsB[lowest])
    inB = heightsB <= level + tolerance
    if np.count_nonzero(inB) == 1:
        return tuple(verticesB[:, lowest].tolist())
    heightsA = dot(normal, verticesA)
    highest = heightsA.argmax()
    inA = heightsA >= heightsA[highest] - tolerance
    if np.count_nonzero(inA) == 1:
        return _below_corner(verticesA[:, highest].tolist(), t, normal, level)
    return _patch_centre(verticesA[:, inA], verticesB[:, inB], t, normal, level, tolerance)


def contact_points(hulls, first, second, t, normal, tolerance):
    """`contact_point` for P pairs of a HullSet: (3, P) from t and normal (3, P), tolerance (P,)."""
    count = len(first)
    level, *ends, vertices = lowest_features(
        hulls, np.concatenate((first, second)), np.concatenate((-normal, normal), axis=1),
        np.concatenate((tolerance, tolerance)),
    )  # fmt: skip
    countA, countB = vertices[:count], vertices[count:]
    ends = take(hulls.vertices, np.concatenate(ends), axis=1)
    a0, b0, a1, b1 = (ends[:, k * count : (k + 1) * count] for k in range(4))
    point = np.where(countB == 1, b0, _below_corner(a0, t, normal, level[count:]))
    edges = indices((countA == 2) & (countB == 2))
    crossing = edges
    if len(edges):
        a0, a1, b0, b1, t2, n2 = (take(v, edges, axis=1) for v in (a0, a1, b0, b1, t, normal))
        turn, part, length2 = _crossing_terms(a0, a1, b0, b1, t2, n2)
        crosses = np.abs(turn) > tolerance[edges] * np.sqrt(length2)
        crossing = edges[crosses]
        s = np.minimum(np.maximum(part / np.where(crosses, turn, 1.0), 0.0), 1.0)
        point[:, crossing] = (b0 + s * (b1 - b0))[:, crosses]
    patch = (countA > 1) & (countB > 1)
    patch[crossing] = False
    for p in indices(patch).tolist():
        point[:, p] = contact_point(
            hulls.body_vertices(first[p]), hulls.body_vertices(second[p]), tuple(t[:, p].tolist()),
            tuple(normal[:, p].tolist()), float(tolerance[p]),
        )  # fmt: skip
    return point


def _below_corner(corner, t, normal, level):
    """The corner of A, as seen from B's centre, lowered along the normal to B's lowest plane."""
    seen = difference(corner, t)
    return moved(seen, level - dot(normal, seen), normal)


def _patch_centre(featureA, featureB, t, normal, level, tolerance):
    """`contact_point` for features (3, ≥ 2) that are edges or faces."""
    if featureA.shape[1] == 2 and featureB.shape[1] == 2:
        a0, a1 = featureA.T.tolist()
        b0, b1 = featureB.T.tolist()
        s = _crossing(a0, a1, b0, b1, t, normal, tolerance)
        if s is not None:
            return moved(b0, s, difference(b1, b0))
    # In the frame of B and in its lowest plane. The axes u, v span that plane.
    u, v = _tangents(normal)
    shiftU, shiftV = dot(u, t), dot(v, t)
    flatA = np.stack((dot(u, featureA) - shiftU, dot(v, featureA) - shiftV), axis=1).tolist()
    flatB = np.stack((dot(u, featureB), dot(v, featureB)), axis=1).tolist()
    cu, cv = overlap_centre(flatA, flatB, tolerance)
    return tuple(u[k] * cu + v[k] * cv + normal[k] * level for k in range(3))


def _crossing(a0, a1, b0, b1, t, normal, tolerance):
    """Where the edge b0 b1 of B crosses the edge a0 a1 of A, as a fraction of it, in [0, 1].

    None where they are parallel: where their ends are within the tolerance of being so.
    """
    turn, part, length2 = _crossing_terms(a0, a1, b0, b1, t, normal)
    if abs(turn) <= tolerance * math.sqrt(length2):
        return None
    return min(max(part / turn, 0.0), 1.0)


def _crossing_terms(a0, a1, b0, b1, t, normal):
    """`(turn, part, length2)` of two edges: they cross at part / turn of the edge of B.

    length2 : the square of the longer one; the edges are parallel where turn is small beside it

    Seen along the normal, a0 - t + x d = b0 + s e, with d and e along the edges of A and B; times
    normal × d, x vanishes.
    """
    d, e = difference(a1, a0), difference(b1, b0)
    across = cross(normal, d)
    d2, e2 = dot(d, d), dot(e, e)
    length2 = max(d2, e2) if isinstance(d2, float) else np.maximum(d2, e2)
    return dot(across, e), dot(across, difference(difference(a0, t), b0)), length2


def _tangents(normal):
    """Two unit vectors (tuples) that make a right-handed frame with the unit vector `normal`."""
    smallest = min(range(3), key=lambda k: abs(normal[k]))
    u = cross(normal, tuple(float(k == smallest) for k in range(3)))
    length = math.sqrt(dot(u, u))
    u = (u[0] / length, u[1] / length, u[2] / length)
    return u, cross(normal, u)


def overlap_centre(pointsA, pointsB, tolerance):
    """Centre of the overlap of two convex figures in the plane that are known to meet.

    pointsA, pointsB : lists of (u, v), the corners in any order: polygons, segments or points
    tolerance : below it, lengths count as nothing

    Returns (u, v): the centroid of an overlap with an area, the middle of a segment.
    """
    a, b = _convex_order(pointsA, tolerance), _convex_order(pointsB, tolerance)
    if len(b) == 1:
        return b[0]
    if len(a) == 1:
        return a[0]
    if len(a) == 2 and len(b) == 2:
        (a0, a1), (b0, b1) = ([(*point, 0.0) for point in figure] for figure in (a, b))
        s = _crossing(a0, a1, b0, b1, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), tolerance)
        if s is None:
            return _middle_of_both(a, b)
        return b0[0] + s * (b1[0] - b0[0]), b0[1] + s * (b1[1] - b0[1])
    # Cut the figure with fewer corners, a segment if there is one, by the sides of the other. Where
    # the two only touch, rounding can leave nothing; then the sides are moved outwards.
    figure, cutter = (b, a) if len(b) <= len(a) else (a, b)
    extent = max(abs(x) for point in figure + cutter for x in point)
    slack = ROUNDING * extent
    overlap = _cut_by_sides(figure, cutter, slack)
    while not overlap and slack < extent:
        slack *= SLACK_GROWTH
        overlap = _cut_by_sides(figure, cutter, slack)
    return _centroid(overlap or b, tolerance)


def _cut_by_sides(figure, cutter, slack):
    """What of a convex figure lies within the sides of a convex polygon, moved out by `slack`."""
    for k, tail in enumerate(cutter):
        figure = _clip(figure, tail, cutter[(k + 1) % len(cutter)], slack)
    return figure


def _left_of(p, q, point):
    """Twice the area of the triangle p, q, point: positive to the left of the line from p to q."""
    return (q[0] - p[0]) * (point[1] - p[1]) - (q[1] - p[1]) * (point[0] - p[0])


def _convex_order(points, tolerance):
    """The corners counter-clockwise, points that coincide within the tolerance once."""
    distinct = []
    for p in points:
        if all(abs(p[0] - q[0]) + abs(p[1] - q[1]) > tolerance for q in distinct):
            distinct.append(p)
    if len(distinct) < 3:
        return distinct
    centreU = sum(p[0] for p in distinct) / len(distinct)
    centreV = sum(p[1] for p in distinct) / len(distinct)
    ordered = sorted(distinct, key=lambda p: math.atan2(p[1] - centreV, p[0] - centreU))
    far = max(ordered, key=lambda p: _distance2(p, ordered[0]))
    reach = math.sqrt(_distance2(far, ordered[0]))
    width = max(abs(_left_of(ordered[0], far, p)) for p in ordered) / reach
    if width <= 2 * tolerance:  # all on a line
        other = max(ordered, key=lambda p: _distance2(p, far))
        return [other, far]
    return ordered


def _distance2(p, q):
    return (p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2


def _middle_of_both(a, b):
    """The middle, on segment b, of what two parallel segments share."""
    (au, av), (bu, bv) = a[0], b[0]
    du, dv = a[1][0] - au, a[1][1] - av
    eu, ev = b[1][0] - bu, b[1][1] - bv
    # the ends of a as fractions of b
    length2 = eu * eu + ev * ev
    s0 = ((au - bu) * eu + (av - bv) * ev) / length2
    s1 = s0 + (du * eu + dv * ev) / length2
    low, high = max(min(s0, s1), 0.0), min(max(s0, s1), 1.0)
    s = min(max(0.5 * (low + high), 0.0), 1.0)
    return bu + s * eu, bv + s * ev


def _clip(figure, p, q, slack):
    """What of a convex figure, its corners in order, lies left of the line p q moved out by slack.

    One step of Sutherland and Hodgman: Reentrant polygon clipping. Comm. ACM 17(1), 1974.
    """
    slack *= math.sqrt(_distance2(p, q))
    sides = [_left_of(p, q, point) + slack for point in figure]
    kept = []
    for k, point in enumerate(figure):
        following = (k + 1) % len(figure)
        if sides[k] >= 0:
            kept.append(point)
        if sides[k] * sides[following] < 0 and not (len(figure) == 2 and k == 1):
            s = sides[k] / (sides[k] - sides[following])
            u, v = figure[following]
            kept.append((point[0] + s * (u - point[0]), point[1] + s * (v - point[1])))
    return kept


def _centroid(figure, tolerance):
    """Centroid of a convex polygon given by its corners in order; the middle of a thin one."""
    anchor = figure[0]
    area = momentU = momentV = 0.0
    for p, q in itertools.pairwise(figure[1:]):
        part = _left_of(anchor, p, q)
        area += part
        momentU += part * (p[0] + q[0] - 2 * anchor[0])
        momentV += part * (p[1] + q[1] - 2 * anchor[1])
    far = max(figure, key=lambda p: _distance2(p, anchor))
    reach = math.sqrt(_distance2(far, anchor))
    if abs(area) <= tolerance * reach or area == 0.0:
        other = max(figure, key=lambda p: _distance2(p, far))
        return 0.5 * (far[0] + other[0]), 0.5 * (far[1] + other[1])
    return anchor[0] + momentU / (3 * area), anchor[1] + momentV / (3 * area)


# --------------------------------------------------------------------------------------------------
# One pair
# --------------------------------------------------------------------------------------------------


def is_collide(vertices1, vertices2):
    """Whether the convex hulls of two point sets meet, and the least translation that parts them.

    vertices1, vertices2 : (n1, 3), (n2, 3), finite; in any order, inner points allowed. Flat sets,
        down to a single point, are allowed too.

    Returns `(isCollision, depth, intNormal, intPosition)`:
    isCollision : bool; hulls that touch within rounding collide, with a depth of 0
    depth : float ≥ 0; the length of the least translation that parts the hulls
    intNormal : (1, 3), unit; hull 2 moves along it, by depth, to part
    intPosition : (1, 3); the point of hull 2 that is deepest inside hull 1, the centre of the
        contact patch where a feature and not a vertex is deepest. intPosition + depth · intNormal
        lies on the surface of hull 1.
    Without a collision the last three are zero.
    """
    centred = []
    centres = []
    reach = 0.0
    for vertices in (vertices1, vertices2):
        hull = build_hull(vertices)
        centre = 0.5 * (hull.vertices.min(axis=0) + hull.vertices.max(axis=0))
        centres.append(centre)
        centred.append(hull.translated(-centre))
        reach = max(reach, float(np.abs(hull.vertices).max()))
    hulls = HullSet(centred)
    t = centres[1] - centres[0]
    size = float(hulls.radius.sum())
    # coordinates far from the origin are rounded themselves
    tolerance = TOUCH_TOLERANCE * size + 4 * EPS * reach
    apart = (False, 0.0, np.zeros((1, 3)), np.zeros((1, 3)))

    bodies = np.array([0]), np.array([1])
    separated, *_ = separating_axes(hulls, *bodies, t[:, None], np.array([tolerance]))
    if separated[0]:
        return apart
    planes = facet_planes(hulls, *bodies, t[:, None], np.array([tolerance]))
    pen, normal = planes.nearest(0, tuple(t.tolist()))
    if pen < -tolerance:
        return apart
    depth = max(pen, 0.0)
    # a face's vertices are off its plane by their rounding, and by more at its far end
    patchTolerance = FEATURE_TOLERANCE * size + 32 * EPS * reach
    point = contact_point(
        hulls.body_vertices(0), hulls.body_vertices(1), tuple(t.tolist()), normal, patchTolerance
    )
    return True, depth, np.array([normal]), np.array([point]) + centres[1]
