"""Facets of the Minkowski difference of two hulls that can be nearest to the origin.

The theory is at the top of GJK.py, which has the search for a single pair. The penetration of a
pair along a facet is offset - normal · t, where t is the translation from the centre of the first
hull to that of the second. A negative penetration is a separation.
"""

import copy
from typing import NamedTuple

import numpy as np

from rbs.geometry import vectors
from rbs.geometry.hulls import (
    FEATURE_TOLERANCE,
    LEAST_GAP,
    PARALLEL_SINE,
    ROUNDING,
    SURE_SINE,
    TOUCH_TOLERANCE,
)
from rbs.geometry.lowest import supports
from rbs.geometry.vectors import cross, dot, indices, ranges, take


class Pairs:
    """P pairs of hulls.

    hulls : HullSet; first, second : (P,), bodies; size : (P,), sum of their radii
    t : (3, P), centre of the second minus centre of the first

    `along` gives each pair an axis that may separate it or be close to its nearest facet's normal:

    axis : (3, P), unit
    offset : (P,); penetration : (P,), overlap of the hulls along the axis, offset - axis · t
    vertex, level : (2, P), lowest vertex of the second hull along the axis and of the first one
        against it, as columns in the set, and their heights
    """

    def __init__(self, hulls, first, second, t):
        self.hulls, self.first, self.second, self.t = hulls, first, second, t
        self.size = hulls.radius[first] + hulls.radius[second]

    def along(self, axes=None):
        """Sets axes (3, P), unit, or between the centres where zero or None; returns the pairs."""
        length = vectors.norm(self.t)
        lines = self.t / np.where(length > 0, length, 1.0)
        lines[0] += length == 0  # any axis will do
        self.axis = lines if axes is None else np.where(dot(axes, axes) > 0, axes, lines)
        bodies = np.concatenate((self.second, self.first))
        away = np.concatenate((self.axis, -self.axis), axis=1)
        level, vertex = supports(self.hulls, bodies, away)
        self.level, self.vertex = level.reshape(2, -1), vertex.reshape(2, -1)
        self.offset = -self.level[1] - self.level[0]
        self.penetration = self.offset - dot(self.axis, self.t)
        return self

    def of(self, rows):
        """Returns the selected pairs (Q,)."""
        result = copy.copy(self)
        for name, column in vars(self).items():
            if name != "hulls":
                setattr(result, name, take(column, rows, axis=-1))
        return result


def find_facets(pairs, margin, separation=None, level=-np.inf):
    """Returns the `Facets` of pairs that can be nearest within a margin of their translations.

    pairs : Pairs, along axes. Good ones save time without changing the facets of colliding pairs
    margin : (P,), lengths ≥ 0 by which the translation may change before the facets must be found
        again: what is nearest at t + Δ has a penetration ≤ depth(t) + 2 |Δ| at t
    separation : (P,), by default the margin. Pairs further apart need one separating plane only
    level : (P,), penetrations up to which facets are found in any case

    The facets of a pair are ordered: faces of the first hull, faces of the second, edge pairs. The
    order does not depend on the translation, so that ties always favour the same facet.
    """
    leastDepth = -(margin if separation is None else separation) - TOUCH_TOLERANCE * pairs.size
    isApart = pairs.penetration < np.minimum(leastDepth, -LEAST_GAP * pairs.size)
    apart, near = indices(isApart), indices(~isApart)
    offset = pairs.offset[apart] + ROUNDING * pairs.size[apart]
    found = [(apart, take(pairs.axis, apart, axis=1), offset)]
    completeUpTo, level = np.full(len(margin), -np.inf), np.broadcast_to(level, margin.shape)
    entries = pairs.hulls.entryCount[pairs.first] + pairs.hulls.entryCount[pairs.second]
    for some in vectors.blocks(entries[near]):
        rows = near[some]
        search = _FacetSearch(pairs.of(rows))
        facets, completeUpTo[rows] = search.find_near(margin[rows], leastDepth[rows], level[rows])
        found += [(take(rows, pair), normal, offset) for pair, normal, offset in facets]
    pair, normal, offset = (np.concatenate(part, axis=-1) for part in zip(*found, strict=True))
    order = pair.argsort(kind="stable")
    columns = take(pair, order), take(normal, order, axis=1), take(offset, order)
    return Facets(np.bincount(pair, minlength=len(margin)), *columns, completeUpTo)


class Facets(NamedTuple):
    """Facets of the Minkowski differences of P pairs that can be nearest."""

    count: np.ndarray  # (P,), number of columns of each pair, > 0
    row: np.ndarray  # (K,), pair of each column, ascending
    normal: np.ndarray  # (3, K), unit; the second body moves along it to separate
    offset: np.ndarray  # (K,)
    # (P,), penetration up to which all facets are there; -inf if they only prove separation
    completeUpTo: np.ndarray

    def of_pairs(self, pairs):
        """Returns the facets of the selected pairs (Q,), in their order."""
        count = self.count[pairs]
        row, column = ranges((self.count.cumsum() - self.count)[pairs], count)
        normal, offset = take(self.normal, column, axis=1), take(self.offset, column)
        return Facets(count, row, normal, offset, self.completeUpTo[pairs])

    def penetrations(self, t):
        """Penetrations (K,) along the facets, at t (3, P)."""
        return self.offset - dot(self.normal, take(t, self.row, axis=1))

    def minimal_penetrations(self, t):
        """`(penetration (P,), normal (3, P))` along the nearest facet of each pair, at t (3, P).

        A negative penetration proves separation.
        """
        least, column = vectors.row_minima(self.penetrations(t), self.row)
        return least, take(self.normal, column, axis=1)


class _FacetSearch:
    """The search of `find_facets` for a block of P ≥ 1 pairs.

    The penetration along a face of A is at least the depth of any point x of B below that face. A
    face is therefore excluded if one of two points lies deeper below it than the pair's bound: the
    lowest vertex of B along the axis, and the deepest vertex below the face that the first one is
    least below. That face and the axis also bound the depth of the pair.

    Row p has the faces and edges of the first hull of pair p, and row P + p those of the second.
    """

    def __init__(self, pairs):
        self.pairs, self.hulls = pairs, pairs.hulls
        hulls = pairs.hulls
        self.own = np.concatenate((pairs.first, pairs.second))
        self.other = np.concatenate((pairs.second, pairs.first))
        self.t = np.concatenate((pairs.t, -pairs.t), axis=1)
        # faces of all rows; count, start : (2 P,); row, offset : (F,); normal : (3, F)
        self.count = take(hulls.faceCount, self.own)
        self.start = self.count.cumsum() - self.count
        self.row, face = ranges(take(hulls.faceStart, self.own), self.count)
        self.normal, self.offset = take(hulls.normals, face, axis=1), take(hulls.offsets, face)

    def find_near(self, margin, leastDepth, level):
        """Finds facets within margin, and up to level if the depth is ≥ leastDepth, each (P,).

        Returns those of faces and those of edges, each `(pair (K,), normal (3, K), offset (K,))`,
        and `Facets.completeUpTo`.
        """
        pairs = self.pairs
        # keeps ties
        extra, level = (x + FEATURE_TOLERANCE * pairs.size for x in (2.0 * margin, level))
        # the facet of a separated pair may have a greater penetration than the axis
        depth = np.maximum(pairs.penetration, 0.0)
        first = self._depths_below_faces(pairs.vertex.ravel())
        best = vectors.row_minima(first, self.row)[1]
        _, vertex = supports(self.hulls, self.other, take(self.normal, best, axis=1))
        second = self._depths_below_faces(vertex)
        # the same bits as in the comparison of faces, so that a separated pair keeps one
        ofBest = np.maximum(first[best], second[best]).reshape(2, -1)
        bound = np.maximum(np.minimum(np.minimum(*ofBest), depth) + extra, level)
        bound = take(np.concatenate((bound, bound)), self.row)
        faces = indices((first <= bound) & (second <= bound))
        row, normal = take(self.row, faces), take(self.normal, faces, axis=1)
        lowest = supports(self.hulls, take(self.other, row), normal)[0]
        half, offset = len(depth), take(self.offset, faces) - lowest
        pair, normal = row % half, normal * np.where(row < half, 1.0, -1.0)
        penetration = offset - dot(normal, take(self.t, pair, axis=1))
        np.minimum.at(depth, pair, penetration)

        isComplete = depth >= leastDepth
        bound = np.maximum(depth + extra, level)
        near = indices(penetration <= take(np.where(isComplete, bound, depth), pair))
        ofFaces = take(pair, near), take(normal, near, axis=1), take(offset, near)
        upTo = np.maximum(depth + 2.0 * margin, level)
        rows = indices(np.concatenate((isComplete, isComplete)))
        ofEdges = self.edge_pairs(bound, *self._edges_near(rows, bound, first, second))
        return (ofFaces, ofEdges), np.where(isComplete, upTo, -np.inf)

    def _depths_below_faces(self, vertex):
        """Depths (F,) of the vertex (2 P,) of each row's other hull below the row's faces."""
        x = take(self.hulls.vertices, vertex, axis=1) + self.t
        return self.offset - dot(self.normal, take(x, self.row, axis=1))

    def _edges_near(self, rows, bound, first, second):
        """Edges of these rows that can span facets with a penetration ≤ bound (P,), and positions
        of their faces: `(edge (K,), faces (2, K))`.

        Along any n = (α n1 + β n2)/|…| between the normals of the faces, with α, β ≥ 0, the
        penetration is at least n · (a - x), where a is an end of the edge and x any point of the
        other hull. If x lies below both faces, this is at least the lesser of its two depths. The
        points x are those of the faces and the middle between them: if two edges cross, each face
        of the one has an end of the other below it.
        """
        own = self.own[rows]
        row, edge = ranges(self.hulls.edgeStart[own], self.hulls.edgeCount[own])
        faces = take(self.hulls.edgeFaces, edge, axis=1) + take(self.start[rows], row)
        bound = take(np.concatenate((bound, bound)), self.row)
        depths = first, second, 0.5 * (first + second)
        near = sum((x <= bound).view(np.uint8) << k for k, x in enumerate(depths))  # one bit each
        nearOne, nearOther = take(near, faces)
        kept = indices((nearOne | nearOther) == 0b111)
        return take(edge, kept), take(faces, kept, axis=1)

    def edge_pairs(self, bound, edge, faces):
        """Facets with a penetration ≤ bound (P,) that edges span, see `_edges_near`.

        An edge of A with the arc α1 α2 and an edge of B with the arc β1 β2 span a facet of A - B if
        the arcs α1 α2 and -β1 -β2 cross. Each edge vector is the pole of its arc. With
        s_i = -eA · β_i and r_i = eB · α_i, the arcs cross if s1 s2 < 0, r1 r2 < 0 and s1 r2 > 0,
        where the last condition excludes the antipode (Gregorius 2013). The facet's normal is along
        eA × eB if r1 > 0, otherwise opposite.
        """
        hulls, half = self.hulls, len(bound)
        row, normals = take(self.row, faces[0]), take(self.normal, faces, axis=1)
        perRow = np.bincount(row, minlength=2 * half)
        rotation = take(hulls.rotation, take(self.own, row), axis=1)
        vector = vectors.mat_vec(rotation, take(hulls.edges, edge, axis=1))

        # all combinations of a pair's edges, a of the first hull and b of the second
        begin = perRow.cumsum() - perRow
        pairA, found = row[: begin[half]], []
        first, count = begin[half + pairA], perRow[half + pairA]
        normalsA = normals[..., : len(count)]
        for some in vectors.blocks(np.append(count, 0)):  # at least one
            a, b = ranges(first[some], count[some])
            r = dot(take(normalsA[..., some], a, axis=2), take(vector, b, axis=1)[:, None])
            kept = indices(r[0] * r[1] < 0)  # excludes most pairs
            a, b, r = take(a, kept) + some.start, take(b, kept), take(r, kept, axis=1)
            s = -dot(take(normals, b, axis=2), take(vector, a, axis=1)[:, None])
            kept = indices((s[0] * s[1] < 0) & (s[0] * r[1] > 0))
            found.append([take(x, kept, axis=-1) for x in (a, b, r, s)])
        a, b, r, s = vectors.joined(*found)

        pair, tail = take(row, a), take(hulls.vertexStart, take(self.own, row))
        tail += take(hulls.edgeTail, edge)
        tailA, tailB = (take(hulls.vertices, take(tail, ends), axis=1) for ends in (a, b))
        vectorA, vectorB = take(vector, a, axis=1), take(vector, b, axis=1)
        lengthA2, lengthB2 = dot(vectorA, vectorA), dot(vectorB, vectorB)
        normal = cross(vectorA, vectorB)
        sine2 = dot(normal, normal)
        spans = sine2 > PARALLEL_SINE**2 * lengthA2 * lengthB2
        normal = normal / np.where(spans, np.copysign(np.sqrt(sine2), r[0]), 1.0)
        # removes the components that rounding leaves along nearly parallel edges
        normal = normal - vectorA * (dot(normal, vectorA) / lengthA2)
        normal = normal - vectorB * (dot(normal, vectorB) / lengthB2)
        normal = normal / np.sqrt(np.where(spans, dot(normal, normal), 1.0))
        offset = dot(normal, tailA - tailB)
        penetration = offset - dot(normal, take(self.t, pair, axis=1))
        isNear = spans & (penetration <= take(bound, pair))
        # Rounding may make arcs cross that only touch. The plane of such a facet is moved outwards
        # to support the hulls, so that no vertex lies beyond it.
        sine2 = np.minimum((r * r).min(axis=0) / lengthB2, (s * s).min(axis=0) / lengthA2)
        doubtful = indices(isNear & (sine2 < SURE_SINE**2))
        if len(doubtful):
            some = self.pairs.of(pair[doubtful])
            offset[doubtful] = some.along(take(normal, doubtful, axis=1)).offset
        near = indices(isNear)
        return take(pair, near), take(normal, near, axis=1), take(offset, near)
