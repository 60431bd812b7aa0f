"""Contact patches: where two hulls touch, once the normal between them is known.

`contact_point` answers for one pair, `contact_points` for arrays of pairs. The patch is where the
feature of A that is highest along the normal and the feature of B that is lowest overlap, seen
along the normal; bodies that rest on each other touch at its centre. Features in a plane are lists
of corners (u, v); polygons are clipped as by Sutherland and Hodgman: Reentrant polygon clipping.
Comm. ACM 17(1), 1974.
"""

import itertools
import math

import numpy as np

from rbs.arrays import indices, take
from rbs.hulls import ROUNDING, support_features
from rbs.triples import cross, divide, dot, mul_add, norm, sub

# By how much the sides of a patch are moved out again when that has left nothing of it.
SLACK_GROWTH = 8


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
    point, isPatch = sharp_contact_points(hulls, first, second, t, normal, tolerance)
    for p in indices(isPatch).tolist():
        point[:, p] = contact_point(
            hulls.body_vertices(first[p]), hulls.body_vertices(second[p]), tuple(t[:, p].tolist()),
            tuple(normal[:, p].tolist()), float(tolerance[p]),
        )  # fmt: skip
    return point


def sharp_contact_points(hulls, first, second, t, normal, tolerance):
    """`contact_points` where a corner touches, or two edges cross: `(point (3, P), isPatch (P,))`.

    Where isPatch is true, the hulls touch along a segment or an area, and the point has no meaning.
    """
    count = len(first)
    level, *ends, vertices = support_features(
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
        denominator, numerator, length2 = _crossing_terms(a0, a1, b0, b1, t2, n2)
        crosses = np.abs(denominator) > tolerance[edges] * np.sqrt(length2)
        crossing = edges[crosses]
        s = np.minimum(np.maximum(numerator / np.where(crosses, denominator, 1.0), 0.0), 1.0)
        point[:, crossing] = (b0 + s * (b1 - b0))[:, crosses]
    isPatch = (countA > 1) & (countB > 1)
    isPatch[crossing] = False
    return point, isPatch


def _below_corner(corner, t, normal, level):
    """The corner of A, as seen from B's centre, lowered along the normal to B's lowest plane."""
    seen = sub(corner, t)
    return mul_add(seen, level - dot(normal, seen), normal)


def _patch_centre(featureA, featureB, t, normal, level, tolerance):
    """`contact_point` for features (3, ≥ 2) that are edges or faces."""
    if featureA.shape[1] == 2 and featureB.shape[1] == 2:
        a0, a1 = featureA.T.tolist()
        b0, b1 = featureB.T.tolist()
        s = _crossing(a0, a1, b0, b1, t, normal, tolerance)
        if s is not None:
            return mul_add(b0, s, sub(b1, b0))
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
    denominator, numerator, length2 = _crossing_terms(a0, a1, b0, b1, t, normal)
    if abs(denominator) <= tolerance * math.sqrt(length2):
        return None
    return min(max(numerator / denominator, 0.0), 1.0)


def _crossing_terms(a0, a1, b0, b1, t, normal):
    """`(denominator, numerator, length2)`: where two edges cross, as a fraction of that of B.

    length2 : the square of the longer one; the edges are parallel where the denominator is small
    beside it

    Seen along the normal, a0 - t + x d = b0 + s e, with d and e along the edges of A and B; times
    normal × d, x vanishes.
    """
    d, e = sub(a1, a0), sub(b1, b0)
    across = cross(normal, d)
    d2, e2 = dot(d, d), dot(e, e)
    length2 = max(d2, e2) if isinstance(d2, float) else np.maximum(d2, e2)
    return dot(across, e), dot(across, sub(sub(a0, t), b0)), length2


def _tangents(normal):
    """Two unit vectors (tuples) that make a right-handed frame with the unit vector `normal`."""
    smallest = min(range(3), key=lambda k: abs(normal[k]))
    u = cross(normal, tuple(float(k == smallest) for k in range(3)))
    u = divide(u, norm(u))
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
    length = math.sqrt(_distance2(far, ordered[0]))
    width = max(abs(_left_of(ordered[0], far, p)) for p in ordered) / length
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
    """What of a convex figure, its corners in order, lies left of the line p q moved outwards."""
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
        triangle = _left_of(anchor, p, q)  # twice its area
        area += triangle
        momentU += triangle * (p[0] + q[0] - 2 * anchor[0])
        momentV += triangle * (p[1] + q[1] - 2 * anchor[1])
    far = max(figure, key=lambda p: _distance2(p, anchor))
    length = math.sqrt(_distance2(far, anchor))
    if abs(area) <= tolerance * length or area == 0.0:
        other = max(figure, key=lambda p: _distance2(p, far))
        return 0.5 * (far[0] + other[0]), 0.5 * (far[1] + other[1])
    return anchor[0] + momentU / (3 * area), anchor[1] + momentV / (3 * area)
