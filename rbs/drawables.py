"""What is drawn, as arrays: surfaces and lines made of bodies, constraints, boxes and the ground.

Nothing here draws, or needs Polyscope. From the top: all bodies as one surface, and its creases;
constraint lines; the ground; boxes and grid cells.

Units: metres. The y axis points up.
"""

import math

import numpy as np

from rbs.broadphase import grid_levels
from rbs.colours import CONSTRAINT_COLOURS, GROUND_COLOURS, SEEN_BACKGROUND
from rbs.poses import refresh_vertices

# Faces that meet at a smaller angle, in radians, pass for one round surface: a cylinder of 20 sides
# or more, or a finely divided ellipsoid.
CREASE_ANGLE = math.radians(30.0)
# A bound that is exceeded by this fraction of itself gets the last colour of constraints in full.
FULL_EXCESS = 0.05
# How many squares the ground has along each side. They fade into the background from the first to
# the second distance, relative to the scene's size.
GROUND_SQUARES = 48
GROUND_FADES = (0.7, 1.9)
# The corners of a box, as 0 for its low and 1 for its high end along x, y, z, and its edges.
BOX_CORNERS = np.array([[k >> 2 & 1, k >> 1 & 1, k & 1] for k in range(8)])
BOX_EDGES = np.array([
    (a, b) for a in range(8) for b in range(a) if np.sum(BOX_CORNERS[a] != BOX_CORNERS[b]) == 1
])  # fmt: skip


def flatten_meshes(meshes):
    """All bodies as the one surface that a viewer draws fastest.

    meshes : list of Mesh
    returns (vertices (ΣV, 3), where the bodies are now; faces (ΣF, 3), counted through all bodies;
    bodyOfFace (ΣF,), the index in `meshes` of the body that each face belongs to). A value per
    body becomes a value per face by indexing: densities[bodyOfFace].
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
    """The edges that a body shows: where two faces meet at more than CREASE_ANGLE.

    So a box shows twelve edges and no diagonals, and an ellipsoid none.

    vertices (V, 3); faces (F, 3) of closed surfaces
    returns (E, 2) vertex indices
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1), np.finfo(float).tiny)[:, None]
    # Half-edge 3 f + k runs along face f from its corner k to the next one; its twin runs back.
    tails, heads = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    faceOf = np.repeat(np.arange(len(faces)), 3)
    order = np.argsort(tails * len(vertices) + heads)
    twinPlaces = np.argsort(heads * len(vertices) + tails)
    neighbour = np.empty(len(tails), dtype=np.int64)
    neighbour[twinPlaces] = faceOf[order]
    cosines = np.sum(normals[faceOf] * normals[neighbour], axis=1)
    isCrease = (tails < heads) & (cosines < math.cos(CREASE_ANGLE))
    return np.column_stack([tails[isCrease], heads[isCrease]])


class ConstraintLines:
    """The constraints of a simulation as lines between their vertices.

    Two bounds on the distance of the same two vertices are one line. Vertices are counted through
    all bodies, as `flatten_meshes` counts them.
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

    def nodes(self, vertices):
        """The lines' ends (2 T, 3), each line's two after each other; vertices (ΣV, 3)."""
        return vertices[self.ends].reshape(-1, 3)

    def colours(self, vertices):
        """RGB (T, 3): how much of the allowed band is used, or by how much it is exceeded."""
        tails, heads = vertices[self.ends[:, 0]], vertices[self.ends[:, 1]]
        distance = np.linalg.norm(tails - heads, axis=1)
        middle, half = (self.least + self.most) / 2.0, (self.most - self.least) / 2.0
        # A rope, which has no lower bound, is used by as much as it is pulled out.
        isRope = self.least == 0.0
        middle, half = np.where(isRope, 0.0, middle), np.where(isRope, self.most, half)
        off = np.abs(distance - middle)
        used = np.clip(off / np.where(half > 0.0, half, 1.0), 0.0, 1.0)
        used = np.where(half > 0.0, used, 1.0)  # a rod has no slack
        excess = (off - half) / np.where(self.most > 0.0, FULL_EXCESS * self.most, 1.0)
        place = used + np.clip(excess, 0.0, 1.0)
        return np.stack([np.interp(place, (0, 1, 2), c) for c in CONSTRAINT_COLOURS.T], axis=1)


def ground_squares(size, middle):
    """The ground as a chequered square under `middle` (3,), for a scene of `size` metres.

    returns (vertices (V, 3), faces (F, 4), colours (F, 3), side of a square in metres: 1, 2 or 5
    times a power of ten)
    """
    least = 2.0 * GROUND_FADES[1] * size / GROUND_SQUARES
    power = 10.0 ** math.floor(math.log10(least))
    side = next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= least)
    ticks = side * (np.arange(GROUND_SQUARES + 1) - GROUND_SQUARES // 2)
    # Whole pairs of squares: the colours of the ground do not depend on the scene's place.
    shiftX, _, shiftZ = 2.0 * side * np.round(np.asarray(middle) / (2.0 * side))
    z, x = np.meshgrid(ticks + shiftZ, ticks + shiftX, indexing="ij")
    vertices = np.stack([x, np.zeros_like(x), z], axis=-1).reshape(-1, 3)
    index = np.arange(len(vertices)).reshape(len(ticks), -1)
    corners = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.stack(corners, axis=-1).reshape(-1, 4)
    rows, columns = np.divmod(np.arange(len(faces)), GROUND_SQUARES)
    colours = np.array(GROUND_COLOURS)[(rows + columns) % 2]
    arms = (vertices[faces].mean(axis=1) - middle)[:, [0, 2]]
    distance = np.linalg.norm(arms, axis=1) / size
    fading = np.interp(distance, GROUND_FADES, (0.0, 1.0))[:, None]
    return vertices, faces, (1.0 - fading) * colours + fading * SEEN_BACKGROUND, side


def box_lines(low, high):
    """The edges of boxes as lines: low, high (n, 3); returns nodes (8 n, 3), edges (12 n, 2)."""
    corners = np.where(BOX_CORNERS, high[:, None], low[:, None])
    edges = BOX_EDGES + 8 * np.arange(len(low))[:, None, None]
    return corners.reshape(-1, 3), edges.reshape(-1, 2)


def grid_cells(low, high):
    """The cells of the uniform-grid broad phase that hold a body, from its first to its last one.

    A cell is a column along x. low, high : (n, 3), the boxes of the bodies
    returns (low, high), both (m, 3)
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
