"""Convex against convex: who touches whom, how deep, along which normal, and where.

`is_collide` answers for two sets of points, `collide_rotated` for two hulls that a simulation has
rotated. GJK itself is `separating_axes`. The rest has rooms of its own: hulls in rbs/hulls.py, the
facets of the Minkowski difference in rbs/facets.py, contact patches in rbs/patches.py. They work on
arrays of pairs with elementwise formulas, so that a pair's result has the same bits whatever else
is in the array.

The picture behind all of it is the Minkowski difference M = A - B of two hulls, each relative to
its own centre. With t = centreB - centreA the hulls meet exactly when t lies in M, and the least
translation that separates them is the distance from t to the surface of M:

    depth(t) = min over the facets k of M of  h_k - n_k · t,

n_k being the outward unit normal of the facet and h_k its distance from the origin. Moving B by
depth · n_k of the minimal facet separates the pair. A facet of M is a face of A, a face of B turned
round, or the parallelogram of an edge of A and an edge of B whose arcs on the Gauss map cross.

Three stages share the work of `is_collide`. GJK decides whether two hulls are apart and stops at
the first separating axis [1, 2]. For the rest, the facets of M near t are found among the faces
and, with the Gauss map [3], the edge pairs; where these are many, a bound excludes most: a facet
with the normal n has, for every pair of points a of A and b of B on it, a penetration ≥ n · (a - b
- t). At last the two features that support the minimal facet give the contact patch and its centre.
As n_k and h_k do not depend on t, the facets of a pair stay right while its bodies only translate.
A simulation asks for the facets at once: an axis cached from its last step does what GJK does, and
bounds them too.

[1] Gilbert, Johnson, Keerthi: A fast procedure for computing the distance between complex objects
    in three-dimensional space. IEEE J. Robotics and Automation 4(2), 1988.
[2] van den Bergen: Collision Detection in Interactive 3D Environments, chapter 4. 2003.
[3] Gregorius: The separating axis test between convex polyhedra. Game Developers Conference 2013.
"""

import math
from functools import lru_cache

import numpy as np

from rbs import triples
from rbs.arrays import indices, take
from rbs.facets import LEAST_GAP, Facets, all_facets, axes_or_centre_lines, find_facets
from rbs.hulls import (
    EPS,
    FEATURE_TOLERANCE,
    FLAT_EXTENT,
    THIN_ASPECT,
    TOUCH_TOLERANCE,
    HullSet,
    build_hull,
    support_features,
    support_offsets,
)
from rbs.patches import contact_point
from rbs.vectors import cross, dot

# GJK stops when an iteration brings the origin's distance closer by less than this fraction.
GJK_PROGRESS = 1e-12
# GJK ends in a few iterations; rounding can make it cycle. Whatever it has not separated by then
# goes on to the facets, which settle it.
GJK_ITERATIONS = 48

# To rule out facets of a pair takes longer than to look at all of up to this many combinations of
# its edges.
FEW_COMBINATIONS = 4000

_ZERO = np.zeros((1, 3))
_ZERO.setflags(write=False)
# What `is_collide` returns where there is no collision. The arrays are read only.
NO_COLLISION = (False, 0.0, _ZERO, _ZERO)

# The pair of a `HullSet` of two.
_PAIR = np.array([0]), np.array([1])


def is_collide(vertices1, vertices2):
    """Whether the convex hulls of two point sets meet, and the least translation to separate them.

    vertices1, vertices2 : (n1, 3), (n2, 3), finite; in any order, inner points allowed. Flat sets,
        down to a single point, are allowed too

    Returns `(isCollision, depth, intNormal, intPosition)`:
    isCollision : bool; hulls that touch within rounding collide, with a depth of 0
    depth : float ≥ 0; the length of the least translation that separates the hulls
    intNormal : (1, 3), unit; hull 2 moves along it, by depth, to separate
    intPosition : (1, 3); the point of hull 2 that is deepest inside hull 1, the centre of the
        contact patch where a feature and not a vertex is deepest. intPosition + depth · intNormal
        lies on the surface of hull 1.
    Without a collision the last three are zero, and read only. Raises ValueError where points are
    not finite, or the depth would not be.
    """
    centred = []
    centres = []
    largest = 0.0
    # By a power of two, which loses nothing, so that no product is beyond all numbers.
    unit = _power_of_two(vertices1, vertices2)
    for vertices in (vertices1, vertices2):
        hull = build_hull(np.asarray(vertices, dtype=np.float64) / unit)
        centre = 0.5 * (hull.vertices.min(axis=0) + hull.vertices.max(axis=0))
        centres.append(centre)
        centred.append(hull.translated(-centre))
        largest = max(largest, float(np.abs(hull.vertices).max()))
    hulls = HullSet(centred)
    t = centres[1] - centres[0]
    size = float(hulls.radius.sum())
    # coordinates far from the origin are rounded themselves
    tolerance = TOUCH_TOLERANCE * size + 4 * EPS * largest
    isSeparated, *_ = separating_axes(hulls, *_PAIR, t[:, None], np.array([tolerance]))
    if isSeparated[0]:
        return NO_COLLISION
    # a face's vertices are off its plane by their rounding, and by more at its far end
    patchTolerance = FEATURE_TOLERANCE * size + 32 * EPS * largest
    isCollision, depth, normal, point = _collide(
        hulls, tuple(t.tolist()), tolerance, patchTolerance, stretch=_stretch(hulls)
    )
    if not isCollision:
        return NO_COLLISION
    if not math.isfinite(depth * unit):
        raise ValueError("the hulls are in each other by more than the largest number")
    position = np.array([point]) + centres[1]
    return True, depth * unit, np.array([normal]), position * unit


def _power_of_two(*tables):
    """A power of two near the largest number in the tables; 1 for usual numbers, or none."""
    largest = max(float(np.max(np.abs(table), initial=0.0)) for table in tables)
    if not math.isfinite(largest) or largest == 0.0 or 1e-50 < largest < 1e50:
        return 1.0
    return math.ldexp(1.0, math.frexp(largest)[1] - 1)


def collide_rotated(rotated1, rotated2, t, axis=None):
    """Whether two rotated hulls meet, for a simulation, which knows hulls and orientations.

    rotated1, rotated2 : `RBSFunctions.RotatedHull`
    t : tuple of 3, centre of the second minus centre of the first
    axis : tuple of 3, unit, that may separate them; where it does not, or None, they are looked at.
        It changes no result

    Returns `(isCollision, depth, normal, point)`: bool; float ≥ 0; tuple of 3, unit, the axis along
    which they overlap least or are apart; and the point of hull 2 that is deepest inside hull 1,
    relative to the centre of hull 2, or None without a collision.
    """
    hull1, hull2 = rotated1.hull, rotated2.hull
    size = hull1.radius + hull2.radius
    if axis is not None:
        highest = triples.dot(axis, rotated1.hullVertices).max()
        lowest = triples.dot(axis, rotated2.hullVertices).min()
        if lowest + triples.dot(axis, t) - highest > LEAST_GAP * size:
            return False, 0.0, axis, None
    hulls = _hull_pair(hull1, hull2).rotated(
        np.array((rotated1.rotation, rotated2.rotation)).T,
        np.concatenate((rotated1.hullVertices, rotated2.hullVertices), axis=1),
    )
    return _collide(hulls, t, TOUCH_TOLERANCE * size, FEATURE_TOLERANCE * size, axis)


@lru_cache(maxsize=1024)
def _hull_pair(hull1, hull2):
    """The `HullSet` of two hulls at rest."""
    return HullSet([hull1, hull2])


def _collide(hulls, t, tolerance, patchTolerance, axis=None, stretch=None):
    """`collide_rotated` for a `HullSet` of two.

    tolerance : hulls that are apart by no more touch; patchTolerance : see `contact_point`;
    stretch : as of `_stretch`, or None
    """
    translation = np.array([t]).T
    if stretch is not None:
        facets = _stretched_facets(hulls, translation, *stretch)
    elif hulls.edgeCount[0] * hulls.edgeCount[1] <= FEW_COMBINATIONS:
        facets = all_facets(hulls, *_PAIR, translation)
    else:
        axes = None if axis is None else np.array([axis]).T
        facets = find_facets(hulls, *_PAIR, translation, np.array([tolerance]), axes)
    penetration, normal = facets.minimal_penetration(0, t)
    if penetration < -tolerance:
        return False, 0.0, normal, None
    vertices1, vertices2 = hulls.body_vertices(0), hulls.body_vertices(1)
    point = contact_point(vertices1, vertices2, t, normal, patchTolerance)
    return True, max(penetration, 0.0), normal, point


def _stretch(hulls):
    """`(axes (3, 3), extents (3, 1))`: what makes a thin Minkowski difference round; else None.

    axes : its principal ones, in rows; extents : along them, the largest where it is flat
    """
    padded = np.concatenate((hulls.vertices, np.zeros((3, 3))), axis=1)
    axes = np.linalg.svd(padded, full_matrices=False)[0].T
    projections = np.abs(axes @ hulls.vertices)
    extents = np.maximum.reduceat(projections, hulls.vertexStart, axis=1).sum(axis=1)
    extents = np.where(extents > FLAT_EXTENT * extents.max(), extents, extents.max())
    return (axes, extents[:, None]) if extents.min() < THIN_ASPECT * extents.max() else None


def _stretched_facets(hulls, translation, axes, extents):
    """All facets of a pair of needles or blades, found where they are as wide as they are long.

    An affine map takes facets to facets. Where all edges are nearly parallel, rounding would hide
    which of them span one.
    """
    stretched = [build_hull((axes @ hulls.body_vertices(b) / extents).T) for b in range(2)]
    facets = all_facets(HullSet(stretched), *_PAIR, axes @ translation / extents)
    normal = axes.T @ (facets.normal / extents)
    normal /= np.sqrt(dot(normal, normal))
    offset = support_offsets(hulls, *np.repeat([[0], [1]], normal.shape[1], axis=1), normal)
    return Facets(facets.start, normal, offset, facets.completeUpTo)


# --------------------------------------------------------------------------------------------------
# GJK
# --------------------------------------------------------------------------------------------------


def separating_axes(hulls, first, second, translation, gap, axes=None):
    """GJK on P pairs: which are further apart than `gap`, and along which axis.

    hulls : HullSet
    first, second : (P,), the bodies of each pair
    translation : (3, P), centre of the second minus centre of the first
    gap : (P,), ≥ 0; distance that has to be exceeded
    axes : (3, P), unit axes to try first; where a column is zero, and by default, those from centre
        to centre

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
    v = -axes_or_centre_lines(axes, translation)
    simplex = np.zeros((3, 4, count))
    used = np.zeros((4, count), dtype=bool)
    for iteration in range(GJK_ITERATIONS):
        # w, the point of D that is least along v: all of D lies beyond it
        bodies = np.concatenate((first[active], second[active]))
        _, lowest, *_ = support_features(hulls, bodies, np.concatenate((v, -v), axis=1))
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
