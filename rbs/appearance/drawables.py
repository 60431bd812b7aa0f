"""Geometry of pictures as arrays: surfaces and lines of bodies, constraints, boxes and the ground.

Units: metres. The y axis points up.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial import Delaunay

from rbs.appearance.colours import GROUND_COLOUR, LINE_COLOUR, SEEN_BACKGROUND
from rbs.geometry.broadphase import grid_levels
from RBSFunctions import Mesh, refresh_vertices

# Angle in radians below which two faces look like one round surface, as those of a cylinder of 20
# sides or more. A larger one smooths real edges; a smaller one shows the facets of round bodies.
CREASE_ANGLE = math.radians(30.0)
# Distance from its bound within which a constraint is taut, and beyond which it is exceeded, as a
# fraction of the bound.
NEAR_BOUND = 0.01
# Number of squares between the ground's lines, from side to side, and least side of a square
# relative to the view's size.
GROUND_SQUARES = 56
SQUARE_SIZE = 0.08
# Lines between the squares: width in squares near the middle, and height above the ground relative
# to the view's size. The darker parts of a shadow lie above them.
LINE_WIDTH, LINE_HEIGHT = 0.014, 7e-4
# The ground's disc: numbers of rings and sectors, and where it begins to fade, as a fraction of its
# radius.
GROUND_RINGS, GROUND_SECTORS = 8, 64
FADE_BEGIN = 0.12
# Shadow of a point 1 m above the ground. The light comes from the upper left, over the shoulder of
# the usual camera, as in the shading of the bodies.
SHADOW_SLANT = np.array([0.50, 0.0, -0.22])
# Direction towards the sun in studio pictures, which is lower.
SUN = np.array([-0.58, 0.70, 0.42]) / math.sqrt(0.58**2 + 0.70**2 + 0.42**2)
# Corners of a box, with 0 for its low and 1 for its high end along x, y, z, and its edges.
BOX_CORNERS = np.array([[k >> 2 & 1, k >> 1 & 1, k & 1] for k in range(8)])
BOX_EDGES = np.array(
    [(a, b) for a in range(8) for b in range(a) if np.sum(BOX_CORNERS[a] != BOX_CORNERS[b]) == 1]
)


class Arrows(NamedTuple):
    """Arrows of one colour: points (m, 3), and vectors (m, 3) from there, in metres."""

    points: np.ndarray
    vectors: np.ndarray
    colour: tuple


class Lines(NamedTuple):
    """Lines of one colour: points (n, 3), and edges (m, 2) between them."""

    points: np.ndarray
    edges: np.ndarray
    colour: tuple


def flatten_meshes(meshes: list[Mesh]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Joins all bodies to one surface, which is the fastest to draw.

    Returns `(vertices, faces, bodyOfFace)`: (ΣV, 3), in the world; (ΣF, 3), numbered through all
    bodies; (ΣF,), the body of each face. Indexing turns a value per body into a value per face, as
    in densities[bodyOfFace].
    """
    refresh_vertices(meshes)
    vertices = [np.reshape(mesh.currVertices, (-1, 3)) for mesh in meshes]
    faces = [np.reshape(mesh.faces, (-1, 3)).astype(np.int64) for mesh in meshes]
    firstVertex = np.cumsum([0] + [len(v) for v in vertices])
    bodyOfFace = np.repeat(np.arange(len(meshes)), [len(f) for f in faces])
    return (
        np.concatenate([np.empty((0, 3)), *vertices]),
        np.concatenate([np.empty((0, 3), np.int64), *faces]) + firstVertex[bodyOfFace, None],
        bodyOfFace,
    )


def find_creases(vertices, faces):
    """Returns whether edges are visible, (F, 3): two faces meet there at more than CREASE_ANGLE.

    Edge k of a face runs from its corner k to the next one. A box has twelve visible edges and no
    diagonals, an ellipsoid none. vertices : (V, 3); faces : (F, 3) of closed surfaces
    """
    normals = unit_rows(area_vectors(vertices, faces))
    cosines = np.sum(normals[:, None] * normals[face_neighbours(faces)], axis=2)
    return cosines <= math.cos(CREASE_ANGLE)


def area_vectors(vertices, faces):
    """Returns outward normals (F, 3) of faces (F, 3), whose length is twice the face's area."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def unit_rows(vectors):
    """Unit vectors (m, 3); zero where a face has no area."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.maximum(lengths, np.finfo(float).tiny)


def face_neighbours(faces):
    """Returns the faces (F, 3) across each face's edges; faces (F, 3) of closed surfaces."""
    # half-edge 3 f + k runs along face f from its corner k to the next one; its twin runs back
    count = faces.max(initial=0) + 1
    tails, heads = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    order, twinPlaces = np.argsort(tails * count + heads), np.argsort(heads * count + tails)
    neighbour = np.empty(len(tails), dtype=np.int64)
    neighbour[twinPlaces] = order // 3
    return neighbour.reshape(-1, 3)


class ConstraintLines:
    """Constraints of a simulation as lines, one for all bounds on the same two vertices.

    ends : (T, 2), vertices, numbered through all bodies; least, most : (T,), bounds
    """

    def __init__(self, simulation):
        firstVertex = np.cumsum([0] + [len(mesh.currVertices) for mesh in simulation.meshes])
        bounds = {}
        for m1, v1, m2, v2, refValue, upper in simulation.constraints:
            ends = (firstVertex[m1] + v1, firstVertex[m2] + v2)
            least, most = bounds.get(ends, (0.0, math.inf))
            bounds[ends] = (least, min(most, refValue)) if upper else (max(least, refValue), most)
        self.ends = np.array(list(bounds), dtype=np.int64).reshape(-1, 2)
        self.least, self.most = np.array(list(bounds.values())).reshape(-1, 2).T

    def kinds(self, vertices):
        """The kind (T,) of each: 0 for slack, 1 for taut, 2 for exceeded."""
        distance = np.linalg.norm(np.subtract(*vertices[self.ends.T]), axis=1)
        below = np.where(self.least > 0.0, self.least - distance, -math.inf)
        beyond = np.maximum(distance - self.most, below)
        near = NEAR_BOUND * np.where(np.isfinite(self.most), self.most, self.least)
        return (beyond >= -near).astype(int) + (beyond > near)


def ground_lines(size, middle, reach):
    """Builds the ground: a plain disc that fades away, and lines on it.

    size : metres, of the view; middle : (3,), above the middle of the disc; reach : metres, its
    radius

    Returns `(vertices (V, 3), faces (F, 3), colours (V, 3), side)`, with the distance of the lines
    in metres: 1, 2 or 5 times a power of ten.
    """
    least = SQUARE_SIZE * size
    power = 10.0 ** math.floor(math.log10(least))
    side = next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= least)
    radius, angle = np.meshgrid(
        np.geomspace(0.02 * reach, reach, GROUND_RINGS),
        np.linspace(0.0, 2.0 * math.pi, GROUND_SECTORS, endpoint=False),
    )
    disc = np.stack([radius * np.cos(angle), 0.0 * angle, radius * np.sin(angle)], axis=2)
    disc = disc.reshape(-1, 3)
    discFaces = Delaunay(disc[:, [2, 0]]).simplices
    # lines: pieces that grow wider and paler with the distance, as thin ones would flicker
    half, shift = GROUND_SQUARES // 2, side * np.round(middle / side) - middle
    ends = np.arange(-half, half + 1, 4)
    across, k = np.indices((2 * half + 1, len(ends) - 1)).reshape(2, -1)
    lines = []
    for axis, other, order in ((0, 2, 1), (2, 0, -1)):
        piece = np.full((len(k), 4, 3), LINE_HEIGHT * size)
        piece[..., axis] = shift[axis] + side * (across[:, None] - half)
        piece[..., other] = shift[other] + side * ends[np.stack([k, k, k + 1, k + 1], axis=1)]
        spread = 1.0 + 0.5 * np.hypot(piece[..., 0], piece[..., 2]) / size
        piece[..., axis] += 0.5 * LINE_WIDTH * side * spread * [-1, 1, 1, -1]
        lines.append(piece[:, ::order])  # all upwards
    lines = np.concatenate(lines).reshape(-1, 3)
    corners = 4 * np.arange(len(lines) // 4)[:, None, None] + [[0, 2, 1], [0, 3, 2]]
    vertices = np.concatenate([disc, lines])
    away = np.hypot(vertices[:, 0], vertices[:, 2])[:, None]
    contrast = (1.0 - _smooth(away, 0.2 * half * side, 0.95 * half * side)) / (
        1.0 + 0.5 * away / size
    )
    contrast[: len(disc)] = 0.0
    colours = GROUND_COLOUR + contrast * (LINE_COLOUR - GROUND_COLOUR)
    colours += _smooth(away, FADE_BEGIN * reach, reach) * (SEEN_BACKGROUND - colours)
    faces = np.concatenate([discFaces, corners.reshape(-1, 3) + len(disc)])
    return vertices + middle * [1.0, 0.0, 1.0], faces, colours, side


def _smooth(values, low, high):
    place = np.clip((values - low) / (high - low), 0.0, 1.0)
    return place * place * (3.0 - 2.0 * place)


def box_lines(low, high):
    """Edges of boxes low, high (n, 3) as lines: nodes (8 n, 3), edges (12 n, 2)."""
    corners = np.where(BOX_CORNERS, high[:, None], low[:, None])
    edges = BOX_EDGES + 8 * np.arange(len(low))[:, None, None]
    return corners.reshape(-1, 3), edges.reshape(-1, 2)


def grid_cells(low, high):
    """Returns the occupied cells of the uniform-grid broad phase as boxes: low, high (m, 3).

    A cell is a column along x, drawn from its first to its last body. low, high : (n, 3), boxes of
    the bodies
    """
    cells = {}
    for level, _, width in grid_levels(np.concatenate([low, -high], axis=1).T):
        for b in level.tolist():
            cell = (width, math.floor(low[b, 1] / width), math.floor(low[b, 2] / width))
            begin, end = cells.get(cell, (math.inf, -math.inf))
            cells[cell] = min(begin, low[b, 0]), max(end, high[b, 0])
    rows = [
        ((begin, y * width, z * width), (end, (y + 1) * width, (z + 1) * width))
        for (width, y, z), (begin, end) in cells.items()
    ]
    cellLow, cellHigh = np.array(rows, dtype=np.float64).reshape(-1, 2, 3).transpose(1, 0, 2)
    return cellLow, cellHigh
