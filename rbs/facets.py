"""The facets of the Minkowski difference of two hulls, those that can be nearest to the origin.

`find_facets` is the entrance: arrays of pairs in, `Facets` out, which tell how deep each pair
penetrates and along which normal. `CachedAxes` saves most of the search where an axis is at hand
that separates a pair, or nearly. The theory stands at the top of GJK.py; facets spanned by two
edges are found on the Gauss map, with the pruning of Gregorius: The separating axis test between
convex polyhedra. Game Developers Conference 2013.

A pair's penetration along a facet is offset - normal · t, with t the translation from the centre
of the first hull to that of the second; negative, it is a separation.
"""

import numpy as np

from rbs import triples
from rbs.arrays import blocks, indices, ranges, row_minima, take
from rbs.hulls import (
    FEATURE_TOLERANCE,
    ROUNDING,
    TOUCH_TOLERANCE,
    approximate_supports,
    rotate_columns,
    support_features,
    support_offsets,
)
from rbs.vectors import cross, dot, mat_vec, norm

# Two edges with a sine below this are parallel and span no facet: the neighbouring facets are then
# within this angle times the edges' length of the truth.
PARALLEL_SINE = 1e-12

# Where an edge makes a larger sine than this with both faces of the other one, their facet is
# beyond the doubts of rounding, for coordinates up to a million times the size of the bodies.
SURE_SINE = 1e-5

# A cached axis proves a pair apart only when the gap along it exceeds this fraction of the size;
# below it the sign of the facets' least penetration decides, so that one rule stands behind every
# touching pair.
LEAST_GAP = 1e-6


def find_facets(hulls, first, second, translation, margin, axes=None, separation=None):
    """The facets of P pairs that can be nearest within a margin of the given translations.

    hulls : HullSet
    first, second : (P,), the bodies of each pair
    translation : (3, P), centre of the second minus centre of the first
    margin : (P,), lengths ≥ 0; how far the translation may change before the facets have to be
        found anew. A facet that is nearest at t + Δ has a penetration ≤ depth(t) + 2 |Δ| at t,
        hence the rest is dropped
    axes : `CachedAxes`, or the axes (3, P) that it takes. The better they are, the less there is to
        do; they do not change what `Facets` say of a pair that collides

    Returns `Facets`, those of a pair in the order: faces of the first, faces of the second, edge
    pairs. The order does not depend on the translation, so the same facet wins a tie. A pair that
    is further apart than its separation need not be complete: one plane shows that it is apart.
    """
    if not isinstance(axes, CachedAxes):
        axes = CachedAxes(hulls, first, second, translation, axes)
    size = hulls.radius[first] + hulls.radius[second]
    leastDepth = -(margin if separation is None else separation) - TOUCH_TOLERANCE * size
    isApart = axes.penetration < np.minimum(leastDepth, -LEAST_GAP * size)
    apart, near = indices(isApart), indices(~isApart)
    offset = axes.offset[apart] + ROUNDING * size[apart]
    found = [(apart, take(axes.axis, apart, axis=1), offset)]
    completeUpTo = np.full(len(first), -np.inf)
    i, j = first[near], second[near]
    for some in blocks(hulls.entryCount[i] + hulls.entryCount[j]) if len(near) else ():
        rows = near[some]
        search = _FacetSearch(hulls, i[some], j[some], take(translation, rows, axis=1))
        search.find_near(
            axes.penetration[rows], take(axes.vertex, rows, axis=1),
            margin[rows], leastDepth[rows], size[rows],
        )  # fmt: skip
        found += [(take(rows, pair), *facets) for pair, *facets in search.found]
        completeUpTo[rows] = search.completeUpTo
    return Facets.gathered(found, completeUpTo)


def all_facets(hulls, first, second, translation):
    """All `Facets` of P pairs, at least one, whose order is that of `find_facets`.

    For a single pair of bodies with few edges that takes less time than to rule most of them out.
    """
    search = _FacetSearch(hulls, first, second, translation)
    search.find_all()
    return Facets.gathered(search.found, search.completeUpTo)


class Facets:
    """Facets of the Minkowski differences of P pairs, those that can be the nearest ones.

    start : (P + 1,); pair p has the columns start[p] … start[p + 1]
    normal : (3, K), unit; the second body moves along it to separate
    offset : (K,); the penetration along facet k at the translation t is offset_k - normal_k · t
    completeUpTo : (P,); every facet with a penetration up to this, at the translation that the
        facets were found at, is among them. -inf where they can only prove that the pair is apart

    A translation by Δ changes no penetration by more than |Δ|. So the least one at t + Δ is that of
    the nearest facet while it is at most completeUpTo - |Δ|: see `still_valid`.
    """

    def __init__(self, start, normal, offset, completeUpTo):
        self.start = start
        self.normal = normal
        self.offset = offset
        self.completeUpTo = completeUpTo

    @classmethod
    def gathered(cls, found, completeUpTo):
        """From a list of `(pair (K,), normal (3, K), offset (K,))`, in this order for each pair."""
        pair, normal, offset = (np.concatenate(part, axis=-1) for part in zip(*found, strict=True))
        order = pair.argsort(kind="stable")
        start = pair[order].searchsorted(np.arange(len(completeUpTo) + 1))
        return cls(start, take(normal, order, axis=1), offset[order], completeUpTo)

    @classmethod
    def joined(cls, sets):
        """The pairs of several `Facets`, one set after the other."""
        start, normal, offset, completeUpTo = zip(
            *((s.start, s.normal, s.offset, s.completeUpTo) for s in sets), strict=True
        )
        count = np.concatenate([np.diff(s) for s in start])
        return cls(
            np.concatenate(([0], count.cumsum())), np.concatenate(normal, axis=1),
            np.concatenate(offset), np.concatenate(completeUpTo),
        )  # fmt: skip

    def of_pairs(self, pairs):
        """The facets of these pairs (Q,), in this order, as new `Facets`."""
        count = np.diff(self.start)[pairs]
        column = ranges(self.start[pairs], count)[1]
        return Facets(
            np.concatenate(([0], count.cumsum())), take(self.normal, column, axis=1),
            self.offset[column], self.completeUpTo[pairs],
        )  # fmt: skip

    def still_valid(self, p, penetration, shift):
        """Whether the least penetration of pair p, at a translation that differs by `shift` from
        where its facets were found, is that of its nearest facet.

        p, penetration : a number or (m,); shift : (3,) or (3, m)

        True while penetration + |shift| ≤ completeUpTo: no facet outside the list can be nearer.
        """
        return penetration + norm(shift) <= self.completeUpTo[p]

    def minimal_penetration(self, p, t):
        """`(penetration, normal)` of pair p along its nearest facet, at the translation t.

        t : tuple of 3 floats; so is the normal. A negative penetration proves that p is apart.
        """
        own = slice(self.start[p], self.start[p + 1])
        normal = self.normal[:, own]
        penetration = self.offset[own] - triples.dot(normal, t)
        k = penetration.argmin()
        return float(penetration[k]), tuple(normal[:, k].tolist())

    def minimal_penetrations(self, t):
        """`minimal_penetration` of all pairs at once: (P,) and (3, P), from t (3, P)."""
        count = np.diff(self.start)
        pair = np.repeat(np.arange(len(count)), count)
        penetration = self.offset - dot(self.normal, take(t, pair, axis=1))
        least, column = row_minima(penetration, pair, self.start[:-1])
        return least, take(self.normal, column, axis=1)


def axes_or_centre_lines(axes, translation):
    """The axes (3, P), and in place of columns of zeros the unit vectors along the translation."""
    length = norm(translation)
    # two centres in one point have no line between them, and any other axis will do
    lines = translation / np.where(length > 0, length, 1.0)
    lines[0] += length == 0
    return lines if axes is None else np.where(dot(axes, axes) > 0, axes, lines)


class CachedAxes:
    """An axis for each of P pairs that may separate it, or be near the nearest facet's normal.

    axis : (3, P), unit
    offset : (P,); penetration (P,) = offset - axis · translation: how far the hulls overlap along
        the axis, no less than their depth, or, negative, are apart; up to rounding
    vertex : (2, P), columns in the set: the vertex of the second hull that is lowest along the
        axis, and that of the first one that is highest
    """

    def __init__(self, hulls, first, second, translation, axes=None):
        """axes : (3, P), unit; where a column is zero, and by default, those between the centres"""
        self.axis = axes_or_centre_lines(axes, translation)
        bodies = np.concatenate((second, first))
        level, vertex = approximate_supports(
            hulls, bodies, np.concatenate((self.axis, -self.axis), axis=1)
        )
        level, self.vertex = level.reshape(2, -1), vertex.reshape(2, -1)
        self.offset = -level[1] - level[0]
        self.penetration = self.offset - dot(self.axis, translation)


# --------------------------------------------------------------------------------------------------
# The search
# --------------------------------------------------------------------------------------------------


class _FacetSearch:
    """What `find_facets` finds for a block of pairs, at least one.

    found : list of `(pair (K,), normal (3, K), offset (K,))`: faces, and edge pairs; each sorted by
        pair, faces and edges
    completeUpTo : (P,), see `Facets`

    The faces of each hull are compared with points of the other. A face of A with the normal n has,
    for every point x of B, a penetration of at least the depth of x below it: so of the faces, only
    those count below which every point that is looked at lies no deeper than the depth of the pair
    can be. The points are the vertex of B that is lowest along the cached axis, and the vertex that
    is deepest below the face that the first one is least below. The cached axis and that face also
    bound the depth.

    Everything is worked out for both hulls of P pairs together, in rows: row p has the faces and
    edges of the first one, row P + p those of the second.
    """

    def __init__(self, hulls, first, second, t):
        self.hulls = hulls
        self.own, self.other = np.concatenate((first, second)), np.concatenate((second, first))
        self.t = np.concatenate((t, -t), axis=1)
        self.found = []
        self._list_faces()

    def find_all(self):
        """All facets."""
        self.completeUpTo = np.full(len(self.own) // 2, np.inf)
        self._select_faces(np.arange(len(self.row)))
        # with a bound of inf, these leave nothing out
        self.depths = self.selectedPenetration, self.selectedPenetration
        self._add_faces(self.completeUpTo)
        self._add_edge_pairs(self.completeUpTo, np.ones(len(self.completeUpTo), dtype=bool))

    def find_near(self, penetration, vertex, margin, leastDepth, size):
        """The facets within the margin.

        penetration, vertex : as of `CachedAxes`; margin : as for `find_facets`; leastDepth : (P,),
        that of a pair whose facets are asked for; size : (P,), of the pair
        """
        # Ties at rounding level have to survive: FEATURE_TOLERANCE is far above rounding.
        extra = 2.0 * margin + FEATURE_TOLERANCE * size
        # Of a pair that is apart, some facet has a negative penetration, but none need be as low
        # as that along the cached axis.
        depth = self._bound_depth(vertex.ravel(), np.maximum(penetration, 0.0), extra)
        isComplete = depth >= leastDepth
        bound = depth + extra
        self._add_faces(np.where(isComplete, bound, depth))
        self.completeUpTo = np.where(isComplete, depth + 2.0 * margin, -np.inf)
        self._add_edge_pairs(bound, isComplete)

    def _list_faces(self):
        """The faces of all rows: count, start : (2 P,); row, offset : (F,); normal : (3, F)."""
        hulls = self.hulls
        self.count = take(hulls.faceCount, self.own)
        self.start = self.count.cumsum() - self.count
        self.row, face = ranges(take(hulls.faceStart, self.own), self.count)
        self.normal = take(hulls.directions, face, axis=1)
        if hulls.rotation is not None:
            rotation = take(hulls.rotation, self.own, axis=1)
            self.normal = rotate_columns(rotation, self.normal, self.count)
        self.offset = take(hulls.offsets, face)

    def _depths_below_faces(self, vertex):
        """How deep (F,) the vertex (2 P,) of each row's other hull lies below the row's faces."""
        x = take(self.hulls.vertices, vertex, axis=1) + self.t
        return self.offset - dot(self.normal, x.repeat(self.count, axis=1))

    def _bound_depth(self, vertex, penetration, extra):
        """Selects the faces that can have a penetration ≤ the depth + extra.

        Returns a bound (P,) on the depth: the least penetration along a face or the cached axis.
        """
        half = len(penetration)
        first = self._depths_below_faces(vertex)
        best = row_minima(first, self.row, self.start)[1]
        _, vertex = approximate_supports(self.hulls, self.other, take(self.normal, best, axis=1))
        second = self._depths_below_faces(vertex)
        self.depths = first, second
        # to the bit what the faces are compared by, so that a pair that is far apart keeps one
        ofBest = np.maximum(first[best], second[best])
        bound = np.minimum(np.minimum(ofBest[:half], ofBest[half:]), penetration) + extra
        bound = np.concatenate((bound, bound)).repeat(self.count)
        self._select_faces(indices((first <= bound) & (second <= bound)))
        depth = penetration.copy()
        np.minimum.at(depth, take(self.row, self.selected) % half, self.selectedPenetration)
        return depth

    def _select_faces(self, faces):
        """Works out the offsets of these faces (N,) of the Minkowski difference, and penetrations.

        Sets selected, selectedOffset and selectedPenetration, (N,) each.
        """
        row, normal = take(self.row, faces), take(self.normal, faces, axis=1)
        level = support_features(self.hulls, take(self.other, row), normal)[0]
        self.selected = faces
        self.selectedOffset = self.offset[faces] - level
        self.selectedPenetration = self.selectedOffset - dot(normal, take(self.t, row, axis=1))

    def _add_faces(self, bound):
        """Adds the selected faces with a penetration ≤ bound (P,) to what is found."""
        half = len(bound)
        isNear = self.selectedPenetration <= take(bound, take(self.row, self.selected) % half)
        row, face = take(self.row, self.selected[isNear]), self.selected[isNear]
        normal = take(self.normal, face, axis=1) * np.where(row < half, 1.0, -1.0)
        self.found.append((row % half, normal, self.selectedOffset[isNear]))

    def _add_edge_pairs(self, bound, isComplete):
        """Adds the edge-edge facets with a penetration ≤ bound (P,) of the complete pairs.

        On the arc between the normals n1, n2 of an edge, with an end a of it and any point x of
        the other side, the penetration along n is at least n · (a - x). With
        n = (α n1 + β n2)/|…|, α, β ≥ 0, that is at least the smaller of n1 · (a - x) and
        n2 · (a - x), how deep x lies below the two faces, where both are positive. The points x are
        those of the faces and the middle between them: where two edges cross, each face of this
        side's edge has one end of the other's below it.
        """
        hulls, half = self.hulls, len(bound)
        limit = np.where(isComplete, bound, -np.inf)
        limit = np.concatenate((limit, limit)).repeat(self.count)
        first, second = self.depths
        # a bit for each point
        near = (first <= limit).view(np.uint8)
        near = near | (second <= limit).view(np.uint8) << 1
        near |= (0.5 * (first + second) <= limit).view(np.uint8) << 2
        rows = indices(np.concatenate((isComplete, isComplete)))
        own = self.own[rows]
        count = hulls.edgeCount[own]
        row, edge = ranges(hulls.edgeStart[own], count)
        faces = take(hulls.edgeFaces, edge, axis=1) + self.start[rows].repeat(count)
        nearOne, nearOther = take(near, faces)
        kept = indices((nearOne | nearOther) == 0b111)
        row, edge = take(rows, row[kept]), edge[kept]
        normals = take(self.normal, take(faces, kept, axis=1), axis=1)
        edges = _Edges(hulls, edge, self.own[row], normals)
        pair, normal, offset, isDoubtful = _edge_facets(edges, row, half)
        isNear = offset - dot(normal, take(self.t, pair, axis=1)) <= take(bound, pair)
        doubtful = indices(isNear & isDoubtful)
        if len(doubtful):
            own = pair[doubtful]
            i, j = self.own[own], self.other[own]
            offset[doubtful] = support_offsets(hulls, i, j, take(normal, doubtful, axis=1))
        kept = indices(isNear)
        self.found.append((take(pair, kept), take(normal, kept, axis=1), take(offset, kept)))


class _Edges:
    """Edges (K,) of the bodies (K,): vector, tail : (3, K); normals : (3, 2, K), of their faces.

    length2 : (K,), the squares of their lengths
    """

    def __init__(self, hulls, edge, bodies, normals):
        self.normals = normals
        self.vector = take(hulls.edges, edge, axis=1)
        if hulls.rotation is not None:
            self.vector = mat_vec(take(hulls.rotation, bodies, axis=1), self.vector)
        self.length2 = dot(self.vector, self.vector)
        tail = take(hulls.edgeTail, edge) + hulls.vertexStart[bodies]
        self.tail = take(hulls.vertices, tail, axis=1)


def _edge_facets(edges, row, count):
    """`(pair (K,), normal (3, K), offset (K,), isDoubtful (K,))`: facets that edges span.

    edges : `_Edges`; row : of each edge, in ascending order: pair p's of the first hull have p,
        those of the second count + p; count : how many pairs there are
    isDoubtful : bool; where rounding may have let two arcs cross that only touch. There, the offset
        has to be that of the supporting plane, not of the two edges, so that no vertex lies beyond

    The facets are sorted by pair, by edge of A and by edge of B.
    """
    perRow = np.bincount(row, minlength=2 * count)
    begin = perRow.cumsum() - perRow
    pairA = row[: begin[count]]
    a, b = ranges(begin[count + pairA], perRow[count + pairA])  # all combinations of a pair's edges
    a, b, side, sine2 = _crossing_arcs(edges, a, b)
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
    return (
        take(pairA, take(a, spans)), take(normal, spans, axis=1), take(offset, spans),
        sine2[spans] < SURE_SINE**2,
    )  # fmt: skip


def _crossing_arcs(edges, a, b):
    """`(a, b, side, sine2)`: which combinations of edges a (K,) of A and b (K,) of B span a facet.

    side : positive where their facet's normal is along eA × eB, negative where it is opposite
    sine2 : the square of the least sine between one edge and a face at the other

    An edge of A with the arc α1 α2 and an edge of B with the arc β1 β2 span a facet of A - B when
    the arcs α1 α2 and -β1 -β2 cross. Each edge vector is the pole of its arc, so with
    s_i = -eA · β_i and r_i = eB · α_i that is s1 s2 < 0, r1 r2 < 0 and s1 r2 > 0, the last one
    telling the crossing from its antipode (Gregorius 2013); the normal is on the side of r1.
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
