"""Contact points of two hulls, given the normal.

Along the normal, each hull has a support feature: a vertex, an edge or a face. The contact point is
a vertex that touches, or the crossing of two edges. Otherwise the features, seen along the normal,
overlap in a segment or a polygon, the contact patch. Coordinates (u, v) are along `tangents`.
"""

import numpy as np

from rbs.geometry.hulls import by_angle, tangents
from rbs.geometry.lowest import support_features
from rbs.geometry.vectors import cross, dot, indices, ranges, take

# Factor by which the slack of polygon sides grows if rounding has left no overlap. More moves the
# contact point further; less repeats the clipping more often.
SLACK_GROWTH = 1000.0
# Area below which a patch is a segment: twice the area over the square of the outline's length.
THIN = 1e-9


def contact_points(hulls, first, second, t, normal, tolerance):
    """Contact points (3, P) on the second hulls, from their centres, of P pairs of a `HullSet`.

    t : (3, P), centre of the second minus centre of the first; normal : (3, P), unit
    tolerance : (P,), distance from a supporting plane up to which vertices belong to its feature
    """
    directions, both = np.concatenate((-normal, normal), axis=1), np.append(tolerance, tolerance)
    level, count, column = support_features(hulls, np.append(first, second), directions, both)
    start, count = (count.cumsum() - count).reshape(2, -1), count.reshape(2, -1)
    vertices = take(hulls.vertices, column, axis=1)  # of both features, from the second centre
    vertices[:, : count[0].sum()] -= t.repeat(count[0], axis=1)
    features = start, count, level[len(first) :], normal, tolerance
    point, isPatch = sharp_points(vertices, *features)
    patches = indices(isPatch)
    if len(patches):
        some = (take(table, patches, axis=-1) for table in features)
        point[:, patches] = patch_centres(vertices, *some)
    return point


def sharp_points(vertices, start, count, level, n, tolerance):
    """Contact points at vertices and edge crossings: `(point (3, P), isPatch (P,))`.

    If isPatch is true, the point is meaningless. A vertex of the first hull is lowered along the
    normal to the second. Seen along the normal, edges d and e cross where a0 + x d = b0 + s e; the
    scalar product with normal × d eliminates x.

    start, count : (2, P), vertices of each feature; level : (P,), height of the second along n
    """
    ends = np.concatenate((start, start + count - 1))
    a0, b0, a1, b1 = (take(vertices, end, axis=1) for end in ends)
    (countA, countB), d, e = count, a1 - a0, b1 - b0
    across = cross(n, d)
    denominator, numerator = dot(across, e), dot(across, a0 - b0)
    length = np.sqrt(np.maximum(dot(d, d), dot(e, e)))
    isCrossing = (countA == 2) & (countB == 2)
    isCrossing &= np.abs(denominator) > tolerance * length
    s = np.minimum(np.maximum(numerator / np.where(isCrossing, denominator, 1.0), 0.0), 1.0)
    point = np.where(isCrossing, b0 + s * e, a0 + (level - dot(n, a0)) * n)
    return np.where(countB == 1, b0, point), (countA > 1) & (countB > 1) & ~isCrossing


def patch_centres(vertices, start, count, level, normal, tolerance):
    """Centres (3, R) of the patches of R pairs, as for `sharp_points`."""
    u, half = tangents(normal), len(level)
    v, count = cross(normal, u), count.ravel()
    row, column = ranges(start.ravel(), count)
    corners = take(vertices, column, axis=1)
    uv = np.array([dot(take(axis, row % half, axis=1), corners) for axis in (u, v)])
    order = by_angle(row, uv[0], np.where(row < half, uv[1], -uv[1]))
    figures = Polygons(count, take(uv, order, axis=1))
    slack, isLost = tolerance, True
    while np.any(isLost):
        row, uv = overlap_corners(figures, slack)
        isLost = np.bincount(row, minlength=half) == 0
        slack = np.where(isLost, SLACK_GROWTH * slack, slack)
    centre = centres(row, uv)
    return centre[0] * u + centre[1] * v + level * normal


class Polygons:
    """K convex polygons in a plane, including segments and points.

    start, count : (K,), first corner and number of corners; row : (C,), polygon of each corner
    uv : (2, C), corners; next : (C,), the following ones; side : (2, C), vectors to these
    """

    def __init__(self, count, uv):
        self.count, self.uv = count, uv
        self.start = count.cumsum() - count
        self.row = np.arange(len(count)).repeat(count)
        self.next = np.arange(1, len(self.row) + 1)
        self.next[self.start + count - 1] = self.start
        self.side = take(uv, self.next, axis=1) - uv
        self.length = np.sqrt(self.side[0] * self.side[0] + self.side[1] * self.side[1])


def overlap_corners(polygons, slack):
    """Corners of the overlaps of 2 K `Polygons` a, b: `(row (Q,), uv (2, Q))`, with repetitions.

    They are the corners of one that lie inside the other, up to a slack (K,), and the crossings of
    the sides. The first K, a, are counter-clockwise and the others, b, clockwise.
    """
    p, half = polygons, len(slack)
    (start, count), rowA = (x[half:] for x in (p.start, p.count)), p.row[: p.count[:half].sum()]
    # all pairs of a corner i of a, with the side after it, and a corner j of b
    length = take(count, rowA)
    i, j = ranges(take(start, rowA), length)
    place = length.cumsum() - take(start + count, rowA)
    du, dv = take(p.uv, j, axis=1) - take(p.uv, i, axis=1)
    (sideAu, sideAv), (sideBu, sideBv) = take(p.side, i, axis=1), take(p.side, j, axis=1)
    # twice the signed areas: positive if a is inside the side of b, and b inside that of a
    insideB = sideBu * dv - sideBv * du
    insideA = sideAu * dv - sideAv * du
    least = -take(np.concatenate((slack, slack)), p.row) * p.length
    isInside = np.ones(len(p.row), dtype=bool)
    isInside[take(i, indices(insideB < take(least, j)))] = False
    isInside[take(j, indices(insideA < take(least, i)))] = False
    corners = indices(isInside)
    # two sides cross if the ends of each lie on different sides of the other
    headA = take(insideB, take(take(place, p.next[: len(place)]), i) + j)
    headB = take(insideA, take(place, i) + take(p.next, j))
    crosses = indices((insideB * headA < 0) & (insideA * headB < 0))
    s, i = insideB[crosses] / (insideB[crosses] - headA[crosses]), i[crosses]
    crossing = take(p.uv, i, axis=1) + s * take(p.side, i, axis=1)
    row = np.concatenate((p.row[corners] % half, rowA[i]))
    uv = np.concatenate((take(p.uv, corners, axis=1), crossing), axis=1)
    # excludes points beyond the ends of a segment or of coincident sides
    box = np.full((4, 2 * half), np.inf)
    for low, x in zip(box, (*p.uv, *-p.uv), strict=True):
        np.minimum.at(low, p.row, x)
    box = box.reshape(4, 2, -1).max(axis=1) - slack
    isWithin = np.concatenate((uv, -uv)) >= take(box, row, axis=1)
    kept = indices(isWithin.all(axis=0))
    return row[kept], take(uv, kept, axis=1)


def centres(row, uv):
    """Centroids (2, K) of the figures with these corners (2, C); of thin ones, of the outline."""
    figure = Polygons(np.bincount(row), take(uv, by_angle(row, *uv), axis=1))
    row, length = figure.row, np.bincount(figure.row, figure.length)
    origin = figure.uv[:, figure.start]
    isPoint = length == 0.0
    outline = np.array([np.bincount(row, figure.length * x) for x in figure.uv + 0.5 * figure.side])
    outline = np.where(isPoint, origin, outline / np.where(isPoint, 1.0, length))
    # triangles from the first corner to each side: twice their areas, and their corner sums
    x, y = figure.uv - take(origin, row, axis=1)
    areas = x * figure.side[1] - y * figure.side[0]
    area = np.bincount(row, areas)
    sums = 2.0 * np.array((x, y)) + figure.side
    moment = np.array([np.bincount(row, areas * total) for total in sums])
    isThin = area <= THIN * length * length
    return np.where(isThin, outline, origin + moment / (3.0 * np.where(isThin, 1.0, area)))
