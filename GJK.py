"""Collision of two convex hulls: whether they touch, how deep, along which normal, and where.

Let M = A - B be the Minkowski difference of two hulls, each relative to its own centre. With
t = centreB - centreA, the hulls intersect exactly if t lies in M, and the least translation that
separates them is the distance from t to the surface of M:

    depth(t) = min over the facets k of M of  h_k - n_k · t,

where n_k is the outward unit normal of the facet and h_k its distance from the origin. Moving B by
depth · n_k of the minimal facet separates the pair. A facet of M is a face of A, a reversed face of
B, or the parallelogram of an edge of A and an edge of B whose arcs on the Gauss map cross.

`is_collide` has three stages. First, GJK searches for a separating axis and stops at the first one
[1, 2]. If it finds none, the facets of M near t are determined from the faces and, with the Gauss
map [3], from the edge pairs. A bound excludes most of them: the penetration of a facet with the
normal n is at least n · (a - b - t) for any points a of A and b of B. Finally, the two features
that support the nearest facet give the contact point.

[1] Gilbert, Johnson, Keerthi: A fast procedure for computing the distance between complex objects
    in three-dimensional space. IEEE J. Robotics and Automation 4(2), 1988.
[2] van den Bergen: Collision Detection in Interactive 3D Environments, chapter 4. 2003.
[3] Gregorius: The separating axis test between convex polyhedra. Game Developers Conference 2013.
"""

import itertools
import math
from functools import lru_cache
from operator import itemgetter

import numpy as np

from rbs.geometry import hulls, vectors
from rbs.geometry.triples import cross, divide, dot, mat_vec, mul_add, norm, scale, sub
from rbs.geometry.vectors import indices

# Least progress of a GJK iteration, as a fraction of the distance to the origin, and most
# iterations. Rounding can make GJK cycle; the facets decide pairs that it leaves open.
GJK_PROGRESS = 1e-12
GJK_ITERATIONS = 48
# Number of distances between faces and vertices up to which `nearest_facet` is faster than
# `find_facets`.
FEW_DISTANCES = 30_000

_ZERO = np.zeros((1, 3))
_ZERO.setflags(write=False)
# Result of `is_collide` without a collision. The arrays are read-only.
NO_COLLISION = (False, 0.0, _ZERO, _ZERO)

IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
# Indices of the only pair in a `HullSet` of two.
PAIR = np.array([0]), np.array([1])
# The sets of recent pairs, not rotated.
_hull_set = lru_cache(maxsize=1024)(hulls.HullSet)


def is_collide(vertices1, vertices2):
    """Tests the convex hulls of two point sets for collision.

    vertices1, vertices2 : (n1, 3), (n2, 3), in any order; interior points are allowed

    Returns `(isCollision, depth, intNormal, intPosition)`:
    isCollision : bool, also if they touch within rounding; if not, the rest is zero and read-only
    depth : float ≥ 0, length of the least translation that separates the hulls
    intNormal : (1, 3), unit; hull 2 moves along it, by depth, to separate
    intPosition : (1, 3), the point of hull 2 deepest inside hull 1. If two edges cross, it lies on
        that of hull 2; if an edge or a face lies flat on the other hull, it is the centroid of
        their overlap. intPosition + depth · intNormal lies on the surface of hull 1

    Raises ValueError if points are thinner than 1e-9 of their length, not finite or beyond ±1e12.
    """
    points = [hulls.checked_points(vertices) for vertices in (vertices1, vertices2)]
    centres = [0.5 * (p.min(axis=0) + p.max(axis=0)) for p in points]
    around = [p - centre for p, centre in zip(points, centres, strict=True)]
    hull1, hull2 = (hulls.RotatedHull(hulls.build_hull(p), p, IDENTITY) for p in around)
    t, size = tuple((centres[1] - centres[0]).tolist()), hull1.hull.radius + hull2.hull.radius
    # rounding error of the coordinates, which grows with their distance from the origin
    blur = hulls.EPS * max(float(np.abs(p).max()) for p in points)
    tolerance = hulls.TOUCH_TOLERANCE * size + 4 * blur
    if separating_axis(hull1.vertices, hull2.vertices, t, max(hulls.LEAST_GAP * size, tolerance)):
        return NO_COLLISION
    # rounding moves a face's vertices off its plane, most at the far end
    patchTolerance = hulls.FEATURE_TOLERANCE * size + 32 * blur
    isCollision, depth, normal, point = _collide(hull1, hull2, t, tolerance, patchTolerance)
    if not isCollision:
        return NO_COLLISION
    return True, depth, np.array([normal]), np.array([point]) + centres[1]


def collide_rotated(hull1, hull2, t, axis=None, hasTouched=False):
    """Tests two rotated hulls for collision, for a simulation that caches hulls and rotations.

    hull1, hull2 : `RotatedHull`
    t : tuple of 3, centre of the second minus centre of the first
    axis : tuple of 3, unit, that may separate the hulls, as the last one; it only saves time
    hasTouched : whether the hulls touched in the step before; GJK would then rarely find an axis,
        and is left out

    Returns `(isCollision, depth, normal, point)` as `is_collide` does, but in tuples of 3, with the
    point relative to centre 2. Without a collision, normal separates the hulls, and point is None.
    """
    size = hull1.hull.radius + hull2.hull.radius
    if axis is not None:
        direction = np.array(axis)
        heights1, heights2 = direction.dot(hull1.vertices), direction.dot(hull2.vertices)
        # with argmin, four times as fast as min
        gap = heights2[heights2.argmin()] + dot(axis, t) - heights1[heights1.argmax()]
        if gap > hulls.LEAST_GAP * size:
            return False, 0.0, axis, None
    if not hasTouched:
        apart = separating_axis(hull1.vertices, hull2.vertices, t, hulls.LEAST_GAP * size)
        if apart is not None:
            return False, 0.0, apart, None
    tolerances = hulls.TOUCH_TOLERANCE * size, hulls.FEATURE_TOLERANCE * size
    return _collide(hull1, hull2, t, *tolerances, axis)


def _collide(hull1, hull2, t, tolerance, patchTolerance, axis=None):
    """`collide_rotated` of two hulls that touch if they are no more than a tolerance apart."""
    shape1, shape2 = hull1.hull, hull2.hull
    distances = len(shape1.offsets) * len(shape2.vertices)
    distances += len(shape2.offsets) * len(shape1.vertices)
    if distances <= FEW_DISTANCES:
        penetration, normal = nearest_facet(hull1, hull2, t)
    else:
        from rbs.geometry.facets import Pairs, find_facets

        pairs = Pairs(hull_pair(hull1, hull2), *PAIR, np.array([t]).T)
        pairs.along(None if axis is None else np.array([axis]).T)
        found = find_facets(pairs, np.array([tolerance])).minimal_penetrations(pairs.t)
        penetration, normal = float(found[0][0]), tuple(found[1][:, 0].tolist())
    if penetration < -tolerance:
        return False, 0.0, normal, None
    point = contact_point(hull1, hull2, t, normal, patchTolerance)
    return True, max(penetration, 0.0), normal, point


def nearest_facet(hull1, hull2, t):
    """Returns penetration, negative for a separation, and normal (tuple) of the nearest facet.

    The bits are those of `find_facets`. An edge cannot span the nearest facet if a vertex of the
    other hull lies deeper below both adjacent faces than the least penetration along any face.
    """
    margin = hulls.FEATURE_TOLERANCE * (hull1.hull.radius + hull2.hull.radius)  # far above rounding
    sides = (hull1, hull2, t, 1.0), (hull2, hull1, scale(-1.0, t), -1.0)
    depths, penetrations = [], []
    for own, other, shift, _ in sides:
        # (F, V), of the other's vertices below these faces. Uses BLAS, so a hint only
        heights = own.normals.T @ other.vertices
        depths.append((own.hull.offsets - np.array(shift) @ own.normals)[:, None] - heights)
        penetrations.append(np.maximum.reduce(depths[-1], axis=1).tolist())
    least = min(map(min, penetrations))
    facets, edges = [], []
    for (own, other, shift, sense), below, ofFaces in zip(sides, depths, penetrations, strict=True):
        for face, penetration in enumerate(ofFaces):
            if penetration <= least + margin:
                normal = tuple(own.normals[:, face].tolist())
                offset = own.hull.offsets.item(face) - support_level(other, normal)
                facets.append((offset - dot(normal, shift), scale(sense, normal)))
        edges.append(_edges_near(own, below, max(least, 0.0) + margin))
    for edge1, edge2 in itertools.product(*edges):
        spanned = spanned_facet(hull1, hull2, edge1, edge2)
        if spanned is not None:
            normal, offset = spanned
            facets.append((offset - dot(normal, t), normal))
    return min(facets, key=itemgetter(0))


def spanned_facet(hull1, hull2, edge1, edge2):
    """Returns `(normal, offset)` of the facet that two edges span, or None.

    `_FacetSearch.edge_pairs` derives the conditions.
    """
    e1, tail1, face1, face2 = edge1
    e2, tail2, face3, face4 = edge2
    r1, r2 = dot(face1, e2), dot(face2, e2)
    if not r1 * r2 < 0.0:  # excludes most pairs
        return None
    s1, s2 = -dot(face3, e1), -dot(face4, e1)
    if not (s1 * s2 < 0.0 and s1 * r2 > 0.0):
        return None
    length1, length2 = dot(e1, e1), dot(e2, e2)
    normal = cross(e1, e2)
    sine2 = dot(normal, normal)
    if sine2 <= hulls.PARALLEL_SINE**2 * length1 * length2:
        return None
    normal = divide(normal, math.copysign(math.sqrt(sine2), r1))
    # removes the components that rounding leaves along nearly parallel edges
    normal = mul_add(normal, -(dot(normal, e1) / length1), e1)
    normal = mul_add(normal, -(dot(normal, e2) / length2), e2)
    normal = divide(normal, norm(normal))
    offset = dot(normal, sub(tail1, tail2))
    if min(min(r1 * r1, r2 * r2) / length2, min(s1 * s1, s2 * s2) / length1) < hulls.SURE_SINE**2:
        # rounding may make arcs cross that only touch: no vertex shall lie beyond the plane
        offset = -support_level(hull1, scale(-1.0, normal)) - support_level(hull2, normal)
    return normal, offset


def support_level(hull, direction):
    """Height of the lowest vertex of a rotated hull along a direction, a tuple of 3."""
    return float(vectors.dot(np.array([direction]).T, hull.vertices).min())


def _edges_near(hull, depths, bound):
    """Edges that may span a facet with a penetration ≤ bound: (vector, tail, normals of its faces).

    depths : (F, V), of the other hull's vertices below the faces of this one
    """
    shape, (face1, face2) = hull.hull, hull.hull.edgeFaces.T
    lesser = np.minimum(depths.take(face1, axis=0), depths.take(face2, axis=0))
    some = indices(np.maximum.reduce(lesser, axis=1) <= bound)
    edges = [mat_vec(hull.rotation, e) for e in shape.edgeVector.take(some, axis=0).tolist()]
    tails = hull.vertices.take(shape.edgeTail.take(some), axis=1).T.tolist()
    ends = (hull.normals.take(face.take(some), axis=1).T.tolist() for face in (face1, face2))
    return list(zip(edges, tails, *ends, strict=True))


def contact_point(hull1, hull2, t, normal, tolerance):
    """Returns the contact point on the second hull, relative to its centre: a tuple of 3.

    tolerance : distance from a supporting plane up to which vertices belong to its feature

    The bits are those of `contact_points`, which computes the centres of contact patches.
    """
    features = []
    for hull, direction in ((hull1, scale(-1.0, normal)), (hull2, normal)):
        heights = vectors.dot(np.array([direction]).T, hull.vertices)
        level = float(heights.min())
        features.append(hull.vertices[:, heights <= level + tolerance].T.tolist())
    # level is now that of the second hull
    corners1, corners2 = features
    if len(corners2) == 1:
        return tuple(corners2[0])
    if len(corners1) == 1:
        corner = sub(corners1[0], t)
        return mul_add(corner, level - dot(normal, corner), normal)
    if len(corners1) == len(corners2) == 2:
        a0, a1 = (sub(corner, t) for corner in corners1)
        b0, b1 = corners2
        d, e = sub(a1, a0), sub(b1, b0)
        across = cross(normal, d)
        denominator = dot(across, e)
        if abs(denominator) > tolerance * math.sqrt(max(dot(d, d), dot(e, e))):
            s = min(max(dot(across, sub(a0, b0)) / denominator, 0.0), 1.0)
            return mul_add(b0, s, e)
    from rbs.geometry.patches import contact_points

    columns = (np.array([v]).T for v in (t, normal))
    points = contact_points(hull_pair(hull1, hull2), *PAIR, *columns, np.array([tolerance]))
    return tuple(points[:, 0].tolist())


def hull_pair(hull1, hull2):
    """Returns the `HullSet` of two rotated hulls, which are its bodies 0 and 1."""
    rotation = np.array((hull1.rotation, hull2.rotation)).T
    vertices = np.concatenate((hull1.vertices, hull2.vertices), axis=1)
    return _hull_set((hull1.hull, hull2.hull)).rotated(rotation, vertices)


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
        a = vertices1[:, direction.dot(vertices1).argmin()].tolist()
        b = vertices2[:, direction.dot(vertices2).argmax()].tolist()
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

    simplex : up to four points, tuples of 3. The last one, w, lies on the origin's side of the
        plane through v, the nearest point of the others' face, perpendicular to v, and thus belongs
        to the nearest face: a corner, edge, triangle, or the tetrahedron if it contains the origin
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
        # barycentric weight of a corner: the area of the projected origin and the other two
        if min(dot(cross(b, w), n), dot(cross(w, a), n), dot(cross(a, b), n)) > 0.0:
            found.append(((a, b, w), scale(dot(w, n) / dot(n, n), n)))
        # the other corner of a tetrahedron and the origin lie on the same side of the triangle
        isWithin = isWithin and dot(w, n) * dot(sub(others[2 - k], w), n) < 0.0
    if isWithin:
        return simplex, (0.0, 0.0, 0.0)
    return min(found, key=lambda face: dot(face[1], face[1]))
