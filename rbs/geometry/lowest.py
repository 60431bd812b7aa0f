"""Lowest vertices of hulls along directions, looked up by cells of directions.

A direction in the frame of a hull, as long as its largest component is 1, ends on the surface of a
cube, which is divided into CELLS³ cells. For each cell, a hull's table lists the vertices that can
be lowest along directions that end in it: about two, of 8 or of 40. Only their heights are
computed, with the same bits as if all were.
"""

from functools import lru_cache

import numpy as np

from rbs.geometry.hulls import FEATURE_TOLERANCE
from rbs.geometry.vectors import blocks, dot, indices, joined, ranges, row_minima, take, vec_mat

# Cells along an edge of the cube. With more, fewer vertices are compared, and tables take longer to
# make and leave the processor's cache.
CELLS = 10
# Index of the cell after the others, which lists all vertices; each hull has ALL + 1 cells.
ALL = CELLS**3
# Height above the lowest vertex up to which a cell lists others, as a fraction of the radius: far
# more than FEATURE_TOLERANCE times the size of a pair. With more, more vertices are compared.
MARGIN = 1e-6


@lru_cache(maxsize=64)
def _cells(hulls):
    """Cells of `Hull`s, ALL + 1 of each: `(count (K,), start (K,), vertex)`, the vertices that can
    be lowest, cell by cell and ascending in each, as rows in `Hull`.
    """
    count, vertex = joined(*map(_low_vertices, hulls))
    return count, count.cumsum() - count, vertex


@lru_cache(maxsize=512)
def _low_vertices(hull):
    """Vertices of a hull that can be lowest, cell by cell: `(count (ALL + 1,), vertex)`.

    Let u be the lowest vertex along the middle m of a cell. Along m + d, another one, v, is higher
    by at least m · (v - u) - |d_x (v - u)_x| - |d_y (v - u)_y| - |d_z (v - u)_z|.
    """
    middle = (np.indices((CELLS, CELLS, CELLS)).reshape(3, -1) + 0.5) * (2.0 / CELLS) - 1.0
    outer = np.append(indices(np.abs(middle).max(axis=0) > 1.0 - 1.5 / CELLS), ALL)
    middle = take(np.append(middle, np.zeros((3, 1)), axis=1), outer, axis=1)
    vertices, found = hull.vertices.T, []
    for some in blocks(np.full(len(outer), len(hull.vertices))):
        heights = dot(middle[:, some, None], vertices[:, None])
        lowest = heights.argmin(axis=1)
        away = sum(np.abs(x - x[lowest, None]) for x in vertices)
        least = heights.min(axis=1)[:, None] + 2.0 * MARGIN * hull.radius
        canBe = heights - away / CELLS <= least
        found.append((canBe.sum(axis=1), canBe.nonzero()[1]))
    count = np.zeros(ALL + 1, dtype=np.intp)
    count[outer], vertex = joined(*found)
    return count, vertex


def supports(hulls, bodies, directions):
    """`(level, vertex)`, (R,) each: height of the lowest vertex of each body (R,) of a `HullSet`
    along its direction (3, R), and its column there; of several, the first.
    """
    cell = _cells_of(hulls, bodies, directions)
    row, _, column, heights = _heights(hulls, bodies, directions, cell)
    level, lowest = row_minima(heights, row)
    return level, take(column, lowest)


def support_features(hulls, bodies, directions, tolerance):
    """Vertices of each body up to a tolerance (R,) above the lowest one along its direction, unit:
    `(level (R,), count (R,), column)`, with the level of `supports`.
    """
    isLarge = tolerance > MARGIN * take(hulls.radius, bodies)
    whole = take(hulls.shape, bodies) * (ALL + 1) + ALL
    cell = np.where(isLarge, whole, _cells_of(hulls, bodies, directions))
    row, count, column, heights = _heights(hulls, bodies, directions, cell)
    level = np.minimum.reduceat(heights, count.cumsum() - count)
    lowest = indices(heights <= (level + tolerance).repeat(count))
    return level, np.bincount(take(row, lowest), minlength=len(bodies)), take(column, lowest)


def touching_faces(hulls, vertex, outward):
    """Of the faces at the support point of each body, that which faces the other one most.

    vertex : (R,), columns of these points; outward : (3, R), normals of contact, towards the other
    bodies. Faces elsewhere may be closer to them, but do not contain the deepest point.
    """
    row, face = ranges(take(hulls.vertexFaceStart, vertex), take(hulls.vertexFaceCount, vertex))
    face = take(hulls.vertexFaces, face)
    cosine = dot(take(hulls.normals, face, axis=1), take(outward, row, axis=1))
    return take(face, row_minima(-cosine, row)[1])


def _heights(hulls, bodies, directions, cell):
    """Heights of the vertices in the cells (R,): `(row (K,), count (R,), column (K,), heights)`."""
    cellCount, cellStart, vertex = _cells(hulls.distinct)
    count = take(cellCount, cell)
    row, column = ranges(take(cellStart, cell), count)
    column = take(vertex, column) + take(take(hulls.vertexStart, bodies), row)
    heights = dot(take(directions, row, axis=1), take(hulls.vertices, column, axis=1))
    return row, count, column, heights


def _cells_of(hulls, bodies, directions):
    """Cells (R,) of directions (3, R) in world axes, in the tables of `_cells`."""
    d = vec_mat(directions, take(hulls.rotation, bodies, axis=1))
    # a little less, so that 1 is in the last cell
    d *= (1.0 - FEATURE_TOLERANCE) * 0.5 * CELLS / np.abs(d).max(axis=0)
    d += 0.5 * CELLS
    i, j, k = d.astype(np.intp)
    return ((take(hulls.shape, bodies) * (ALL + 1) + k) + CELLS * j) + CELLS * CELLS * i
