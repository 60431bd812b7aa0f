"""Contact manifolds: up to four contact points per pair of hulls, kept between steps.

A manifold has the normal n of the pair, from the first body to the second, and points that each
receive an impulse. The points are corners of the overlap of two faces, one of either hull, seen
along n. Four of them are kept that span the overlap and include the deepest one, as in van den
Bergen: Collision Detection in Interactive 3D Environments, 2003, and in Bullet.
"""

from types import SimpleNamespace

import numpy as np

from rbs.geometry.facets import find_facets
from rbs.geometry.hulls import FEATURE_TOLERANCE, face_corners
from rbs.geometry.lowest import touching_faces
from rbs.geometry.patches import Polygons, overlap_corners
from rbs.geometry.vectors import cross, dot, find_sorted, indices, mat_vec, norm, row_minima, take
from rbs.stepping.reports import GROUND, ContactColumns

POINTS = 4
# Ratio of the masses of two bodies in contact from which their island is solved until it converges.
# With more, heavy bodies squeeze out light ones; with less than 30, this includes heaps of the
# meshes in data/, which then take several times as long.
UNEVEN = 32.0

# Part of a thickness, or of the largest speed in the step, that counts as rounding. With none,
# rounding decides which of equal corners count, whether a gap that has just closed is one, and
# without gravity, whether a point closes.
ROUNDING = 1e-6
# Least divisor, in place of zero.
TINY = 1e-100
# Columns (3, 2, 1): the normal from a body towards the ground, and the first tangent of friction.
GROUND_AXES = np.array([[0.0, 1.0], [-1.0, 0.0], [0.0, 0.0]])[:, :, None]


class Manifolds(SimpleNamespace):
    """Table of M manifolds, sorted by key. The ground is body n.

    key : (M,), i · (n + 1) + j for the pair i < j
    normal, tangent : (3, M), unit, n and t1 in the frame of the first body
    anchor1, anchor2 : (3, 4, M), contact points on either body, in its frame
    isPoint : (4, M) bool; the anchors are meaningless if false
    translation, rotation : (3, M), (4, M), pose of the second body in the first one's frame when
        the manifold was built
    breakingThreshold : (M,), change of this pose, in m, up to which the manifold is kept
    impulse, friction : (4, M), along the normal at the points; (3, M), along t1, t2 and as a twist
        about n; mass · speed, from the last substep, for warm starting
    """

    def bodies(self, count):
        """Returns the two bodies (2, M) of each manifold; the ground is body `count`."""
        return np.array(np.divmod(self.key, count + 1))

    def rows(self, some):
        """Returns the manifolds `some` (m,), in this order."""
        return Manifolds(**{name: take(x, some, axis=-1) for name, x in vars(self).items()})

    def renumbered(self, number):
        """Returns `(manifolds, left)` after bodies have been added or removed.

        number : (n + 1,), new index of each old body and of the ground, ascending; -1 if removed
        left : (K,), new indices of bodies that touched a removed body
        """
        first, second = (number[b] for b in self.bodies(len(number) - 1))
        isKept = (first >= 0) & (second >= 0)
        left = np.concatenate((first, second))[~np.tile(isKept, 2)]
        key = first * (number[-1] + 1) + second
        kept = Manifolds(**vars(self) | {"key": key}).rows(indices(isKept))
        return kept, left[(left >= 0) & (left < number[-1])]

    def joined(self, other):
        """Returns these manifolds and others, sorted by key."""
        both = {n: np.concatenate((x, vars(other)[n]), axis=-1) for n, x in vars(self).items()}
        return Manifolds(**both).rows(both["key"].argsort(kind="stable"))

    def inherit(self, old):
        """Takes over impulses of the manifolds that these replace.

        The impulse of each old point passes on to the nearest new one, in the first body's frame.
        Friction is carried over as a vector.
        """
        known = find_sorted(self.key, old.key)
        mine = indices(known >= 0)
        given = old.anchor1, old.impulse, old.normal, old.tangent, old.friction
        points, impulse, *axes, (along, across, twist) = (take(x, known[mine], -1) for x in given)
        away = norm(take(self.anchor1, mine, axis=2)[:, :, None] - points[:, None])
        away += np.where(take(self.isPoint, mine, axis=1), 0.0, np.inf)[:, None]
        place = (away.argmin(axis=0) * len(known) + mine).ravel()
        self.impulse.flat = np.bincount(place, impulse.ravel(), self.impulse.size)
        force = axes[1] * along + cross(*axes) * across
        normal, tangent = take(self.normal, mine, axis=1), take(self.tangent, mine, axis=1)
        self.friction[:, mine] = dot(force, tangent), dot(force, cross(normal, tangent)), twist


NO_MANIFOLDS = Manifolds(
    key=np.zeros(0, dtype=np.int64),
    isPoint=np.zeros((POINTS, 0), dtype=bool),
    breakingThreshold=np.zeros(0),
    rotation=np.zeros((4, 0)),
    **{name: np.zeros((3, 0)) for name in ("normal", "tangent", "translation", "friction")},
    **{name: np.zeros((3, POINTS, 0)) for name in ("anchor1", "anchor2")},
    impulse=np.zeros((POINTS, 0)),
)


class PlacedManifolds:
    """Geometry of manifolds `rows` (M,), ascending, in world axes.

    first, second : (M,), bodies; the ground is body n, but GROUND in `other`
    t : (3, M), see `Poses.translations`; normal, tangent1, tangent2 : (3, M), unit
    arm : (3, 4, M), from the first COM to the points on the first body
    gap : (4, M), separation at the start of the step, along the normal
    """

    def __init__(self, manifolds, frames, rows):
        self.rows, self.count = rows, len(rows)
        manifolds = manifolds if len(rows) == len(manifolds.key) else manifolds.rows(rows)
        self.key, (self.first, self.second) = manifolds.key, manifolds.bodies(frames.count)
        self.start1 = take(frames.position, self.first, axis=1)
        self.t = frames.translations(self.first, self.second)
        self.isPoint = manifolds.isPoint
        axes = manifolds.normal[:, None], manifolds.tangent[:, None]
        vectors = np.concatenate((*axes, manifolds.anchor1), axis=1)
        turned = mat_vec(take(frames.rotation, self.first, axis=1)[:, None], vectors)
        isOnGround = self.second == frames.count
        self.other = np.where(isOnGround, GROUND, self.second)
        axes = np.where(isOnGround, GROUND_AXES, turned[:, :2])
        self.normal, self.tangent1, self.arm = axes[:, 0], axes[:, 1], turned[:, 2:]
        self.tangent2 = cross(self.normal, self.tangent1)
        across = mat_vec(take(frames.rotation, self.second, axis=1)[:, None], manifolds.anchor2)
        self.gap = dot(across + self.t[:, None] - self.arm, self.normal[:, None])

    def heights(self):
        """Heights (2, M) of the deepest points of the first and of the second body, from its COM
        towards the other body. As a support, a body reaches up to there.
        """
        gap = np.where(self.isPoint, self.gap, np.inf)
        deepest = gap.argmin(axis=0), np.arange(self.count)
        height = dot(self.arm, self.normal[:, None])[deepest]
        return np.array((height, dot(self.t, self.normal) - height - gap[deepest]))

    def reported(self, total):
        """`ContactColumns` of every point that touches or received an impulse, at the start of the
        step.

        total : (7, M), impulses of the rows, see `SoftContacts`

        A manifold's friction is divided in proportion to the normal impulses of its points.
        """
        impulse, load = total[:POINTS], np.add.reduce(total[:POINTS])
        k, m = ((impulse > 0.0) | (self.isPoint & (self.gap <= 0.0))).nonzero()
        share = total[POINTS:] / np.where(load > 0.0, load, 1.0)
        friction = take(self.tangent1 * share[0] + self.tangent2 * share[1], m, axis=1)
        impulse, arm = impulse[k, m], self.arm[:, k, m]
        depth, point = np.maximum(-self.gap[k, m], 0.0), take(self.start1, m, axis=1) + arm
        bodies = (take(x, m) for x in (self.key, self.first, self.other))
        normal, friction = take(self.normal, m, axis=1), friction * impulse
        return ContactColumns(*bodies, depth, normal, point, impulse, friction, arm)


def contact_normals(pairs, separation, approach, slop):
    """Penetrations (K,) and normals (3, K) of K `Pairs`.

    separation : (K,), lengths; if a pair is farther apart, its penetration is only known to be
        less than -separation
    approach : (3, K), way of the first body in the step relative to the second, without gravity
    slop : (K,), depth up to which a facet counts as open

    Bodies that overlap by less than the slop meet along the facet that is the last to close, not
    along the one that is farthest open now: what slides off a slope onto a floor meets its top, and
    not its side.
    """
    facets = find_facets(pairs, np.zeros(len(slop)), separation, slop)
    row, excess = facets.row, facets.penetrations(pairs.t)
    penetration = row_minima(excess, row)[0]
    closing = np.maximum(dot(facets.normal, take(approach, row, axis=1)), 0.0)
    room = take(slop, row) - excess
    time = np.where(room < 0.0, -np.inf, room / np.maximum(closing, TINY))
    time = np.where(take(penetration < slop, row), time, -excess)
    last = row_minima(-time, row)[1]
    return excess[last], take(facets.normal, last, axis=1)


def pair_corners(pairs, normal, tangent):
    """Corners of the overlaps of K `Pairs`, with vertices along n: `(row (Q,), corners (4, Q))`.

    normal, tangent : (3, K); row : in no order, and without those whose faces do not overlap
    corners : coordinates u and v along the tangent t1 and n × t1, and heights along n on
        the first and the second body, all from the second COM
    """
    hulls, tolerance = pairs.hulls, FEATURE_TOLERANCE * pairs.size
    frame = np.tile(np.stack((tangent, cross(normal, tangent), normal), axis=1), 2)
    bodies = np.concatenate((pairs.first, pairs.second))
    origin = np.concatenate((-pairs.t, np.zeros_like(pairs.t)), axis=1)
    outward = np.concatenate((normal, -normal), axis=1)
    face = touching_faces(hulls, pairs.vertex[::-1].ravel(), outward)
    row, corner, count = face_corners(hulls, bodies, face)
    corner += take(origin, row, axis=1)
    faces = Polygons(count, dot(corner[:, None], take(frame[:, :2], row, axis=2)))
    row, (u, v) = overlap_corners(faces, tolerance)
    # heights of the planes of both faces
    planes = take(hulls.normals, face, axis=1)
    offset = (take(hulls.offsets, face) + dot(planes, origin)).reshape(2, -1)
    slopes = dot(planes[:, None], frame).reshape(3, 2, -1)
    slopeU, slopeV, slopeN = take(slopes, row, axis=2)
    heights = (take(offset, row, axis=1) - slopeU * u - slopeV * v) / slopeN
    return row, np.array((u, v, *heights))


def four_points(row, u, v, separation, growth, size, margin):
    """Selects up to four points of each row that span it: `(chosen (4, K), isPoint (4, K))`.

    row : (Q,), ascending, each of 0 … K - 1 at least once; u, v : (Q,)
    separation, growth : (Q,), now, and by how much it is predicted to grow in the step
    size, margin : (K,), least thickness, and height over the deepest point up to which others count
        if that does not go on

    In this order: the deepest point; the farthest from it; the point that forms the largest
    triangle with these; and the point that adds most to the triangle. Points that are apart, now
    and at the end of the step, count less: a long cylinder touches with the other end of its side,
    even if the next side ends farther away. isPoint is false where no such point is left.
    """
    later, grain = separation + growth, take(ROUNDING * size, row)
    first = row_minima(np.rint(separation / grain), row)[1]
    height = separation - take(np.maximum(separation[first], 0.0), row)
    height = np.maximum(np.minimum(height, later - take(row_minima(later, row)[0], row)), 0.0)
    # others still come down by as much as the deepest point would go on, if it met nothing
    beyond = np.maximum(np.minimum(-later[first], -growth[first]), 0.0)
    weight = 1.0 - height / take(margin + beyond, row)

    isNear = weight >= 0.0  # the others are not selected
    near, place = indices(isNear), isNear.cumsum() - 1
    first, merge = place[first], FEATURE_TOLERANCE * size
    row, u, v, weight = (take(x, near) for x in (row, u, v, weight))
    grain = take(ROUNDING * size * size, row)

    def farthest(measure):
        """Returns the point (K,) of each row with the largest measure, and that measure."""
        point = row_minima(np.rint(-weight * measure / grain), row)[1]
        return point, measure[point]

    def area(q):
        """Returns twice the signed area of each point's triangle with the first and q (K,)."""
        return take(u[q], row) * v - take(v[q], row) * u

    u, v = u - take(u[first], row), v - take(v[first], row)
    second, away = farthest(u * u + v * v)
    length, areas = np.sqrt(away), area(second)
    third, size3 = farthest(np.abs(areas))
    # twice the areas that each point adds beyond the three sides
    sense = take(np.where(areas[third] < 0, 1.0, -1.0), row)
    areas, others = sense * areas, sense * area(third)
    beyond = np.maximum(np.maximum(areas, -others), others - areas - take(size3, row))
    fourth, size4 = farthest(beyond)
    isPoint = np.ones((POINTS, len(size)), dtype=bool)
    isPoint[1], isPoint[2] = length > merge, size3 > merge * length
    isPoint[3] = isPoint[2] & (size4 > merge * length)
    # ascending, so that they are visited in the same order in each step; of one that was selected
    # twice, the point first
    order = 2 * np.array((first, second, third, fourth)) + ~isPoint
    order.sort(axis=0)
    return take(near, order // 2), order % 2 == 0
