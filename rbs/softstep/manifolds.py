"""Contact manifolds: up to four contact points per pair of hulls, kept between steps.

A manifold has the normal n of the pair, from the first body to the second, and points that each
receive an impulse. The points are corners of the overlap of two faces, one of either hull, seen
along n. Four of them are kept that span the overlap and include the deepest one, as in van den
Bergen: Collision Detection in Interactive 3D Environments, 2003, and in Bullet.
"""

from types import SimpleNamespace

import numpy as np

from rbs.geometry.arrays import find_sorted, indices, ranges, row_minima, take
from rbs.geometry.facets import find_facets
from rbs.geometry.hulls import FEATURE_TOLERANCE, face_corners, support_offsets, tangents
from rbs.geometry.patches import Features, Polygons, overlap_corners
from rbs.geometry.vectors import cross, dot, mat_vec, mul_add, norm

POINTS = 4

# Lengths are fractions of the thickness of the thinner body.

# Separation beyond the least one from which on points are omitted, unless the bodies can close the
# gap within the step; the manifold is rebuilt before they touch. With more, the four points of a
# rolling cylinder lie too far apart, and it sinks between them; with none, boxes fall that stand on
# lighter ones.
CULL = 0.05
# Change of the relative pose after which a manifold is rebuilt. With more, its normal becomes
# visibly outdated; with less, time is spent on finding the same manifold again.
KEEP = 0.03
# The same for a pair of bodies that go farther in STEPS_KEPT steps. With more, bodies of a
# collapsing heap, and then also of one at rest, are deeper in each other; with less, half of the
# manifolds that are rebuilt are rebuilt in every step, an eighth of the time.
KEEP_MOVING = 0.1
STEPS_KEPT = 4
# Difference of penetration up to which two facets of the Minkowski difference share a normal. With
# more, the edges of adjacent boxes push each other apart; with less, the normal jumps.
RIDGE = 0.02
# Least turn between such facets, one minus the cosine of the angle. With more, the normal jumps at
# blunt ridges; without, the balls of a cradle hit each other askew.
LEAST_TURN = 0.05


class Manifolds(SimpleNamespace):
    """Table of M manifolds, sorted by key. The ground is body n.

    key : (M,), i · (n + 1) + j for the pair i < j
    normal, tangent : (3, M), unit, n and t1 in the frame of the first body
    anchor1, anchor2 : (3, 4, M), contact points on either body, in its frame
    isPoint : (4, M) bool; the anchors are meaningless if false
    translation, rotation : (3, M), (4, M), pose of the second body in the first one's frame when
        the manifold was built
    impulse, friction : (4, M), along the normal at the points; (3, M), along t1, t2 and as a twist
        about n; mass · speed, from the last substep, for warm starting
    offset : (4, M), lengths, penetration from which the points' springs act
    """

    def renewed(self, **columns):
        """Returns a copy in which the given columns are replaced."""
        return Manifolds(**vars(self) | columns)

    def bodies(self, count):
        """Returns the two bodies (2, M) of each manifold; the ground is body `count`."""
        return np.array(np.divmod(self.key, count + 1))

    def rows(self, some):
        """Returns the manifolds `some` (m,), ascending."""
        if len(some) == len(self.key):
            return self
        return Manifolds(**{name: take(x, some, axis=-1) for name, x in vars(self).items()})

    def resized(self, old, count):
        """`(manifolds, left)` for `count` bodies instead of `old`, after changes at the list's end.

        left : (K,), bodies that touched a removed body
        """
        first, second = self.bodies(old)
        isGround = second == old
        isKept = (first < count) & (isGround | (second < count))
        left = first[~isKept & (first < count)]
        key = first * (count + 1) + np.where(isGround, count, second)
        return self.renewed(key=key).rows(indices(isKept)), left

    def joined(self, other):
        """Returns these manifolds and others, sorted by key."""
        if len(other.key) == 0:
            return self
        order = np.append(self.key, other.key).argsort(kind="stable")
        both = {n: np.concatenate((x, vars(other)[n]), axis=-1) for n, x in vars(self).items()}
        return Manifolds(**{name: take(x, order, axis=-1) for name, x in both.items()})

    def inherit(self, old):
        """Takes over impulses of the manifolds that these replace.

        Each point in turn inherits from the nearest old point that is left, in the first body's
        frame. Friction is carried over as a vector.
        """
        if len(self.key) == 0:
            return
        known = find_sorted(self.key, old.key)
        mine = indices(known >= 0)
        old, column = old.rows(known[mine]), np.arange(len(mine))
        free = old.isPoint.copy()
        for k in range(POINTS):
            away = self.anchor1[:, k, mine][:, None] - old.anchor1
            nearest = np.where(free, dot(away, away), np.inf).argmin(axis=0)
            source = nearest, column
            inherits = free[source] & self.isPoint[k, mine]
            self.impulse[k, mine] = np.where(inherits, old.impulse[source], 0.0)
            self.offset[k, mine] = np.where(inherits, old.offset[source], 0.0)
            free[source] &= ~inherits
        force = old.tangent * old.friction[0] + cross(old.normal, old.tangent) * old.friction[1]
        normal, tangent = self.normal[:, mine], self.tangent[:, mine]
        self.friction[:, mine] = np.stack(
            (dot(force, tangent), dot(force, cross(normal, tangent)), old.friction[2])
        )


NO_MANIFOLDS = Manifolds(
    key=np.zeros(0, dtype=np.int64),
    isPoint=np.zeros((POINTS, 0), dtype=bool),
    rotation=np.zeros((4, 0)),
    **{name: np.zeros((3, 0)) for name in ("normal", "tangent", "translation", "friction")},
    **{name: np.zeros((3, POINTS, 0)) for name in ("anchor1", "anchor2")},
    **{name: np.zeros((POINTS, 0)) for name in ("impulse", "offset")},
)


def turn_points(matrix, points):
    """Multiplies matrices (9, M) by points (3, 4, M)."""
    return mat_vec(matrix[:, None], points)


def contact_normals(pairs, separation, width):
    """`(penetration (K,), normal (3, K))` of K ≥ 1 `Pairs`; normals are continuous across ridges.

    separation : (K,), lengths: of pairs farther apart, the penetration is only known to be less
        than -separation
    width : (K,), lengths

    The direction of least penetration jumps where two facets of the Minkowski difference are
    equally near, as where two cards lean on each other, edge to edge: the normal is then that of
    either card, and with neither of them can friction hold the cards up. Rounding the edges by a
    small radius would give a normal in between. Therefore a facet less than `width` farther than
    the nearest one is blended with it: of several, the one with the most different direction,
    except the opposite side of a nearly flat hull.
    """
    facets = find_facets(pairs, 0.5 * width, separation)
    penetration, normal = facets.minimal_penetrations(pairs.t)
    count = np.diff(facets.start)
    pair = np.arange(len(count)).repeat(count)
    excess = facets.offset - dot(facets.normal, take(pairs.t, pair, axis=1))
    excess -= take(penetration, pair)
    weight = np.maximum(1.0 - excess / take(width, pair), 0.0)
    turn = 1.0 - dot(facets.normal, take(normal, pair, axis=1))
    turn = weight * np.where(turn < 2.0 - LEAST_TURN, turn, 0.0)
    least, other = row_minima(-turn, pair, facets.start[:-1])
    ridge = indices(least < -LEAST_TURN)
    if len(ridge):
        other = other[ridge]
        mean = normal[:, ridge] + weight[other] * facets.normal[:, other]
        mean /= norm(mean)
        normal[:, ridge] = mean
        offset = support_offsets(pairs.hulls, pairs.first[ridge], pairs.second[ridge], mean)
        penetration[ridge] = offset - dot(mean, pairs.t[:, ridge])
    return penetration, normal


def pair_manifolds(pairs, normal, depth, size, reach):
    """Builds the manifolds of K `Pairs` that touch or nearly do: `(point1, point2, isPoint)`.

    normal : (3, K); depth : (K,), penetration along the normal, negative if separated
    size : (K,), least thickness
    reach : (K,), largest distance by which points of the two bodies can approach in the step
    point1, point2 : (3, 4, K), on the first and second body, relative to its COM, world axes. A
        point and its partner lie on one line along the normal
    """
    hulls, t, tolerance = pairs.hulls, pairs.t, FEATURE_TOLERANCE * pairs.size
    features = Features(hulls, pairs.first, pairs.second, t, normal, tolerance)
    u = tangents(normal)
    frame = u, cross(normal, u), normal  # at the second COM
    faces = (
        _Faces(hulls, pairs.first, normal, features.ends[0], tolerance, -t, frame),
        _Faces(hulls, pairs.second, -normal, features.ends[1], tolerance, np.zeros_like(t), frame),
    )
    row, uv = overlap_corners(*faces, tolerance)
    heights = [face.heights(row, *uv) for face in faces]

    # If the deepest point is a vertex or a crossing of edges, it is added exactly. For faces and
    # parallel edges it is a corner of the overlap, unless rounding has left none.
    deepest, isPatch = features.sharp_points()
    hasCorner = np.bincount(row, minlength=len(size)) > 0
    isLost = indices(isPatch & ~hasCorner)
    if len(isLost):
        deepest[:, isLost] = features.patch_centres(isLost)
    sharp = indices(~(isPatch & hasCorner))
    exact = [dot(take(deepest, sharp, axis=1), take(axis, sharp, axis=1)) for axis in frame]
    points = np.stack((*exact[:2], exact[2] + depth[sharp], exact[2])), np.stack((*uv, *heights))
    row, points = np.concatenate((sharp, row)), np.concatenate(points, axis=1)
    order = row.argsort(kind="stable")
    row, points = row[order], take(points, order, axis=1)

    u, v, height1, height2 = points
    separation = height2 - height1
    chosen, isPoint = _four_points(row, u, v, separation, separation, size, reach)
    u, v, height1, height2 = points[:, chosen]  # (4, K) each
    flat = frame[0][:, None] * u + frame[1][:, None] * v
    point1 = mul_add(flat, height1, normal[:, None]) + t[:, None]
    return point1, mul_add(flat, height2, normal[:, None]), isPoint


def ground_manifolds(frames, bodies):
    """Builds manifolds of bodies (K,) with the ground, as `pair_manifolds`: `(point1, isPoint)`.

    frames : `Frames`, whose flight predicts which points meet the ground
    """
    hulls, (shift, turn) = frames.hulls, (frames.shift[:, bodies], frames.turn[:, bodies])
    row, column = ranges(take(hulls.vertexStart, bodies), take(hulls.vertexCount, bodies))
    x, y, z = take(hulls.vertices, column, axis=1)
    separation = y + take(frames.position[1, bodies], row)
    # (shift + turn × r)_y
    later = separation + take(shift[1], row) + take(turn[2], row) * x - take(turn[0], row) * z
    size, reach = hulls.thickness[bodies], frames.reach[bodies]
    chosen, isPoint = _four_points(row, x, z, separation, later, size, reach)
    return take(hulls.vertices, column[chosen].ravel(), axis=1).reshape(3, POINTS, -1), isPoint


class _Faces(Polygons):
    """The face of each body (K,), of those at the support, that is turned most to a direction.

    Other faces may be turned more to it, but the deepest point does not lie on them.
    """

    def __init__(self, hulls, bodies, direction, ends, tolerance, origin, frame):
        """ends, tolerance : as in `Features`; origin : (3, K), the COMs; frame : axes (3, K)"""
        count = take(hulls.faceCount, bodies)
        row, face = ranges(take(hulls.faceStart, bodies), count)
        normal, offset = take(hulls.normals, face, axis=1), take(hulls.offsets, face)
        # a face has both ends if their mean is on its plane
        middle = take(0.5 * (take(hulls.vertices, ends, axis=1).sum(axis=1)), row, axis=1)
        hasEnds = dot(normal, middle) >= offset - 4.0 * take(tolerance, row)
        cosine = np.where(hasEnds, dot(normal, take(direction, row, axis=1)), -1.0)
        best = row_minima(-cosine, row, count.cumsum() - count)[1]

        row, corner, count = face_corners(hulls, bodies, take(face, best))
        corner += take(origin, row, axis=1)
        uv = [dot(corner, take(axis, row, axis=1)) for axis in frame[:2]]
        super().__init__(count, np.stack(uv))
        normal = take(normal, best, axis=1)
        self._slopes = [dot(normal, axis) for axis in frame]
        self._offset = take(offset, best) + dot(normal, origin)

    def heights(self, row, u, v):
        """Heights (Q,) along n of the planes of the faces `row` at the points u, v (Q,)."""
        slopeU, slopeV, slopeN = (take(slope, row) for slope in self._slopes)
        return (take(self._offset, row) - slopeU * u - slopeV * v) / slopeN


def _four_points(row, u, v, separation, later, size, reach):
    """Selects up to four points of each row that span it: `(chosen (4, K), isPoint (4, K))`.

    row : (Q,), ascending, each of 0 … K - 1 at least once; u, v : (Q,)
    separation, later : (Q,), now, and predicted for the end of the step; size, reach : (K,)

    In this order: the deepest point; the predicted deepest one or, if that is the same, the
    farthest from it; the point that forms the largest triangle with these; and the point that adds
    most to the triangle. If none is left, isPoint is false.
    """
    start = row.searchsorted(np.arange(len(size)))
    least, first = row_minima(separation, row, start)
    isFar = separation - take(least, row) > take(np.maximum(CULL * size, reach), row)
    merge = FEATURE_TOLERANCE * size

    def farthest(measure):
        """Returns the point (K,) of each row with the largest measure, and that measure."""
        negative, point = row_minima(np.where(isFar, np.inf, -measure), row, start)
        return point, -negative

    def area(p, q):
        """Returns twice the signed area of each point's triangle with p and q (K,)."""
        du, dv = u - take(u[p], row), v - take(v[p], row)
        return take(u[q] - u[p], row) * dv - take(v[q] - v[p], row) * du

    away = np.hypot(u - take(u[first], row), v - take(v[first], row))
    deepest, following = row_minima(later, row, start)
    second = np.where(later[first] - deepest > merge, following, farthest(away)[0])
    length = away[second]
    areas = area(first, second)
    third, size3 = farthest(np.abs(areas))
    sense = np.where(areas[third] < 0, 1.0, -1.0)
    beyond = np.maximum.reduce(
        [take(sense, row) * outside for outside in (areas, area(second, third), area(third, first))]
    )
    fourth, size4 = farthest(beyond)
    isPoint = np.ones((POINTS, len(size)), dtype=bool)
    isPoint[1], isPoint[2] = length > merge, size3 > merge * length
    isPoint[3] = isPoint[2] & (size4 > merge * length)
    return np.stack((first, second, third, fourth)), isPoint
