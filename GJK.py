"""Collision of two convex hulls: whether they touch, how deep, along which normal, and where.

`is_collide` tests two point sets, and `collide_rotated` two hulls that a simulation has rotated.
Hulls, facets and contact points are in hulls.py, facets.py and patches.py of rbs/geometry.

Let M = A - B be the Minkowski difference of two hulls, each relative to its own centre. With
t = centreB - centreA, the hulls intersect exactly if t lies in M, and the least translation that
separates them is the distance from t to the surface of M:

    depth(t) = min over the facets k of M of  h_k - n_k · t,

where n_k is the outward unit normal of the facet and h_k its distance from the origin. Moving B by
depth · n_k of the minimal facet separates the pair. A facet of M is a face of A, a reversed face of
B, or the parallelogram of an edge of A and an edge of B whose arcs on the Gauss map cross.

`is_collide` has three stages. First, GJK searches for a separating axis and stops at the first one
[1, 2]. If it finds none, the facets of M near t are determined from the faces and, with the Gauss
map [3], from the edge pairs. If there are many edge pairs, a bound excludes most of them: the
penetration of a facet with the normal n is at least n · (a - b - t) for any points a of A and b of
B. Finally, the two features that support the minimal facet give the contact point. As n_k and h_k
do not depend on t, the facets of a pair remain valid while its bodies only translate.

A simulation step first tries the axis of the step before, which separates most pairs that are
apart. For a pair that touched then, it leaves out GJK.

[1] Gilbert, Johnson, Keerthi: A fast procedure for computing the distance between complex objects
    in three-dimensional space. IEEE J. Robotics and Automation 4(2), 1988.
[2] van den Bergen: Collision Detection in Interactive 3D Environments, chapter 4. 2003.
[3] Gregorius: The separating axis test between convex polyhedra. Game Developers Conference 2013.
"""

import itertools
from functools import lru_cache

import numpy as np

from rbs.geometry.facets import LEAST_GAP, Pairs, all_facets, find_facets
from rbs.geometry.hulls import (
    EPS,
    FEATURE_TOLERANCE,
    TOUCH_TOLERANCE,
    HullSet,
    build_hull,
    checked_points,
)
from rbs.geometry.patches import contact_points
from rbs.geometry.triples import cross, divide, dot, mul_add, norm, scale, sub

# Largest ratio of the sizes of two point sets. Beyond it, rounding leaves little of the smaller.
LARGEST_RATIO = 1e12

# Least progress of a GJK iteration, as a fraction of the distance to the origin, and most
# iterations. Rounding can make GJK cycle; the facets decide pairs that it leaves open.
GJK_PROGRESS = 1e-12
GJK_ITERATIONS = 48

# Number of edge combinations up to which enumerating all facets is faster. Affects speed only.
FEW_COMBINATIONS = 4000

_ZERO = np.zeros((1, 3))
_ZERO.setflags(write=False)
# Result of `is_collide` without a collision. The arrays are read-only.
NO_COLLISION = (False, 0.0, _ZERO, _ZERO)

# Row indices of the only pair in a `HullSet` of two, and the sets of recent pairs at rest.
_PAIR = np.array([0]), np.array([1])
_hull_pair = lru_cache(maxsize=1024)(HullSet)


def is_collide(vertices1, vertices2):
    """Tests the convex hulls of two point sets for collision.

    vertices1, vertices2 : (n1, 3), (n2, 3), in any order; interior points are allowed

    Returns
    -------
    isCollision : bool, True also if they touch within rounding; if False, the rest is zero and
        read-only
    depth : float ≥ 0, length of the least translation that separates the hulls
    intNormal : (1, 3), unit; hull 2 moves along it, by depth, to separate
    intPosition : (1, 3), the point of hull 2 deepest inside hull 1. If two edges cross, it lies on
        that of hull 2; if an edge or a face lies flat on the other hull, it is the centroid of
        their overlap. intPosition + depth · intNormal lies on the surface of hull 1

    Raises ValueError if points are flat (thinner than a millionth of their length), not finite or
    beyond ±1e12, or one set is over 1e12 times as large as the other.
    """
    points = [checked_points(vertices) for vertices in (vertices1, vertices2)]
    centres = [0.5 * (p.min(axis=0) + p.max(axis=0)) for p in points]
    hulls = HullSet([build_hull(p - centre) for p, centre in zip(points, centres, strict=True)])
    radius1, radius2 = hulls.radius.tolist()
    if max(radius1, radius2) > LARGEST_RATIO * min(radius1, radius2):
        raise ValueError(f"one point set is over {LARGEST_RATIO:g} times as large as the other")
    t = tuple((centres[1] - centres[0]).tolist())
    size = radius1 + radius2
    # rounding error of the coordinates, which grows with their distance from the origin
    blur = EPS * max(float(np.abs(p).max()) for p in points)
    tolerance = TOUCH_TOLERANCE * size + 4 * blur
    vertices = np.split(hulls.vertices, hulls.vertexStart[1:], axis=1)
    if separating_axis(*vertices, t, max(LEAST_GAP * size, tolerance)):
        return NO_COLLISION
    # rounding moves a face's vertices off its plane, most at the far end
    patchTolerance = FEATURE_TOLERANCE * size + 32 * blur
    isCollision, depth, normal, point = _collide(hulls, t, tolerance, patchTolerance)
    if not isCollision:
        return NO_COLLISION
    return True, depth, np.array([normal]), np.array([point]) + centres[1]


def collide_rotated(rotated1, rotated2, t, axis=None, hasTouched=False):
    """Tests two rotated hulls for collision, for a simulation that caches hulls and rotations.

    rotated1, rotated2 : `RBSFunctions.RotatedHull`
    t : tuple of 3, centre of the second minus centre of the first
    axis : tuple of 3, unit, a possible separating axis; it saves time without changing results
    hasTouched : whether the hulls touched in the step before; GJK is then left out, which takes a
        seventh of the test and would rarely find an axis

    Returns `(isCollision, depth, normal, point)` as `is_collide` does, but in tuples of 3, with the
    point relative to centre 2. Without a collision, normal separates the hulls, and point is None.
    """
    hull1, hull2 = rotated1.hull, rotated2.hull
    size = hull1.radius + hull2.radius
    if axis is not None:
        direction = np.array(axis)
        highest = (direction @ rotated1.hullVertices).max()
        lowest = (direction @ rotated2.hullVertices).min()
        if lowest + dot(axis, t) - highest > LEAST_GAP * size:
            return False, 0.0, axis, None
    if not hasTouched:
        vertices = rotated1.hullVertices, rotated2.hullVertices
        apart = separating_axis(*vertices, t, LEAST_GAP * size)
        if apart is not None:
            return False, 0.0, apart, None
    hulls = _hull_pair((hull1, hull2)).rotated(
        np.array((rotated1.rotation, rotated2.rotation)).T,
        np.concatenate((rotated1.hullVertices, rotated2.hullVertices), axis=1),
    )
    return _collide(hulls, t, TOUCH_TOLERANCE * size, FEATURE_TOLERANCE * size, axis)


def _collide(hulls, t, tolerance, patchTolerance, axis=None):
    """`collide_rotated` for a `HullSet` of two.

    tolerance : largest separation that counts as touching; patchTolerance : see `contact_points`
    """
    translation = np.array([t]).T  # (3, 1), an array of one pair
    pairs = Pairs(hulls, *_PAIR, translation)
    if hulls.edgeCount[0] * hulls.edgeCount[1] <= FEW_COMBINATIONS:
        facets = all_facets(pairs)
    else:
        pairs.along(None if axis is None else np.array([axis]).T)
        facets = find_facets(pairs, np.array([tolerance]))
    penetrations = facets.offset - dot(facets.normal, translation)
    nearest = penetrations.argmin()
    penetration, normals = float(penetrations[nearest]), facets.normal[:, nearest, None]
    normal = tuple(normals[:, 0].tolist())
    if penetration < -tolerance:
        return False, 0.0, normal, None
    points = contact_points(hulls, *_PAIR, translation, normals, np.array([patchTolerance]))
    return True, max(penetration, 0.0), normal, tuple(points[:, 0].tolist())


def separating_axis(vertices1, vertices2, t, gap):
    """Searches with GJK for an axis that separates two hulls by more than a gap, a length ≥ 0.

    vertices1, vertices2 : (3, V), relative to the hulls' centres
    t : tuple of 3, centre of the second minus centre of the first

    Returns a tuple of 3, unit, or None if none was found. Along it, every vertex of the second hull
    lies beyond every vertex of the first one by more than the gap.
    """
    # D = A - B - t contains the origin if the hulls intersect. The first v is only a direction;
    # later ones are the points nearest to the origin on a simplex in D.
    v, simplex = (sub((0.0, 0.0, 0.0), t) if any(t) else (1.0, 0.0, 0.0)), ()
    for _ in range(GJK_ITERATIONS):
        # w is the support point of D along -v: all of D lies beyond it
        direction = np.array(v)
        a = vertices1[:, (direction @ vertices1).argmin()].tolist()
        b = vertices2[:, (direction @ vertices2).argmax()].tolist()
        w = sub(sub(a, b), t)
        if dot(v, w) > gap * norm(v):
            return divide(v, -norm(v))
        if simplex and dot(v, v) - dot(v, w) <= GJK_PROGRESS * dot(v, v):
            return None  # v is the point of D nearest to the origin, and within the gap
        simplex, v = nearest_face((*simplex, w))
        if len(simplex) == 4:
            return None
    return None


def nearest_face(simplex):
    """Returns the face of a simplex nearest to the origin and its nearest point: `(corners, v)`.

    simplex : up to four points, tuples of 3, of which the last one is nearer to the origin than the
        face of the others. A face is a corner, an edge or a triangle, or the whole tetrahedron if
        it contains the origin

    As the last point w is nearer, it belongs to the nearest face.
    """
    *others, w = simplex
    found = [((w,), w)]
    for p in others:
        d = sub(p, w)
        along = -dot(w, d)
        if 0.0 < along < dot(d, d):
            found.append(((p, w), mul_add(w, along / dot(d, d), d)))
    isWithin = len(others) == 3
    for k, (a, b) in enumerate(itertools.combinations(others, 2)):
        n = cross(sub(a, w), sub(b, w))
        # a corner's barycentric weight is the area that the projected origin spans with the other
        # two
        if min(dot(cross(b, w), n), dot(cross(w, a), n), dot(cross(a, b), n)) > 0.0:
            found.append(((a, b, w), scale(dot(w, n) / dot(n, n), n)))
        # the other corner of a tetrahedron and the origin lie on the same side of the triangle
        isWithin = isWithin and dot(w, n) * dot(sub(others[2 - k], w), n) < 0.0
    if isWithin:
        return simplex, (0.0, 0.0, 0.0)
    return min(found, key=lambda face: dot(face[1], face[1]))
