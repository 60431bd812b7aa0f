"""Light of the window: bodies as one surface that sun and sky light, and soft shadows.

The light stays in the world, as the shadows do; that of Polyscope's materials moves with the
camera, and its tone mapping turns colours pale. Units: metres. The y axis points up.
"""

import math

import numpy as np

from Quaternion import rotation_matrices
from rbs.appearance.drawables import (
    CREASE_ANGLE,
    SHADOW_SLANT,
    cast_shadows,
    face_neighbours,
    unit_rows,
)
from rbs.geometry.hulls import rotate_columns
from rbs.softstep.contacts import islands

# Light of the sun on a surface that faces it, of the sky on one that faces up, and from the ground
# on one that faces down: rows for red, green and blue.
LIGHT = ((0.86, 0.33, 0.20), (0.83, 0.36, 0.20), (0.77, 0.41, 0.19))
# Direction towards the sun: that in which the shadows are cast.
TO_SUN = (np.array([0.0, 1.0, 0.0]) - SHADOW_SLANT).tolist()
TO_SUN = [component / math.hypot(*TO_SUN) for component in TO_SUN]
# Layers of a shadow from the darkest, which is the narrowest, on top, and is drawn first: growth in
# metres per metre of height, and darkness from 0 to 1.
SHADOW_LAYERS = ((-0.05, 1.0), (0.01, 0.62), (0.07, 0.28))


class LitSurface:
    """All bodies as one surface, smooth except at creases, in the light of sun and sky.

    Vertices at a crease are split, one for each side. Vertices are numbered through all bodies.

    Attributes
    ----------
    firstVertex : (n,), the first vertex of each body
    source, bodyOfVertex : (S,), the vertex that each split one comes from, and its body
    faces, bodyOfFace : (F, 3), of split vertices; (F,)
    """

    def __init__(self, meshes):
        kinds, parts = {}, []
        for mesh in meshes:
            key = mesh.origVertices.tobytes(), mesh.faces.tobytes()
            if key not in kinds:
                kinds[key] = split_at_creases(mesh.origVertices, mesh.faces)
            parts.append(kinds[key])
        sources, normal, normals, faces = zip(*parts, strict=True)
        self._rest = np.concatenate([mesh.origVertices for mesh in meshes]).T
        self._vertexCounts = np.array([len(mesh.origVertices) for mesh in meshes])
        self.firstVertex = self._vertexCounts.cumsum() - self._vertexCounts
        counts = np.array([len(source) for source in sources])
        self._normalCounts = np.array([len(part) for part in normals])
        bodies = np.arange(len(meshes))
        self.bodyOfVertex = bodies.repeat(counts)
        self.bodyOfFace = bodies.repeat([len(part) for part in faces])
        firstSplit = counts.cumsum() - counts
        firstNormal = self._normalCounts.cumsum() - self._normalCounts
        self._normal = np.concatenate(normal) + firstNormal[self.bodyOfVertex]
        self.source = np.concatenate(sources) + self.firstVertex[self.bodyOfVertex]
        self.faces = np.concatenate(faces) + firstSplit[self.bodyOfFace, None]
        self._normals = np.ascontiguousarray(np.concatenate(normals).T, dtype=np.float32)

    def place(self, poses):
        """Returns the vertices (ΣV, 3) of bodies in poses (n, 7), and the light (S, 3) on them.

        Colours in sRGB are multiplied by the light, so it is the root of the linear light.
        """
        rotation = np.stack(rotation_matrices(poses.T[3:]))
        vertices = rotate_columns(rotation, self._rest, self._vertexCounts)
        vertices += poses.T[:3].repeat(self._vertexCounts, axis=1)
        x, y, z = rotate_columns(rotation.astype(np.float32), self._normals, self._normalCounts)
        toSun = np.square(0.5 + 0.5 * (TO_SUN[0] * x + TO_SUN[1] * y + TO_SUN[2] * z))
        up = 0.5 + 0.5 * y
        light = [a * toSun + (b - c) * up + c for a, b, c in LIGHT]
        return np.ascontiguousarray(vertices.T), np.sqrt(np.stack(light, axis=1)).take(
            self._normal, axis=0
        )


def poses_of(meshes):
    """Returns position and orientation of each body, (n, 7)."""
    positions = np.concatenate([mesh.position for mesh in meshes])
    return np.concatenate((positions, np.concatenate([m.orientation for m in meshes])), axis=1)


def split_at_creases(vertices, faces):
    """Splits the vertices (V, 3) of closed faces (F, 3) where the surface has creases.

    Returns `(source (S,), normal (S,), normals (N, 3), faces (F, 3))`: the vertex that each split
    one comes from, the index of its normal, all different normals, and faces with split vertices.
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    normals = unit_rows(across)
    # corners at one vertex belong together if their faces meet at an edge that is no crease
    neighbour = face_neighbours(faces)
    cosines = np.sum(normals[:, None] * normals[neighbour], axis=2)
    face, k = np.nonzero(cosines > math.cos(CREASE_ANGLE))
    other = neighbour[face, k]
    links = []
    for corner in (k, (k + 1) % 3):
        isSame = faces[other] == faces[face, corner][:, None]
        links.append((3 * face + corner, 3 * other + isSame.argmax(axis=1)))
    labels = islands(np.concatenate(links, axis=1), np.ones(faces.size, dtype=bool))
    _, first, split = np.unique(labels, return_index=True, return_inverse=True)
    sums = np.zeros((len(first), 3))
    np.add.at(sums, split.ravel(), across.repeat(3, axis=0))
    normals, normal = np.unique(np.round(unit_rows(sums), 6), axis=0, return_inverse=True)
    return faces.ravel()[first], normal.ravel(), normals, split.reshape(-1, 3)


def soft_shadows(vertices, firstVertex, height):
    """Returns the vertices (k V, 3) of the k SHADOW_LAYERS, one above the other up to a height.

    The higher a point is, the more its layers spread, as in the light of a sun with a disc.
    vertices : (V, 3), of all bodies; firstVertex : (n,), the first one of each body
    """
    x, _, z = cast_shadows(vertices, height).T
    counts = np.diff(firstVertex, append=len(vertices))
    awayX, awayZ = (
        part - (np.add.reduceat(part, firstVertex) / counts).repeat(counts) for part in (x, z)
    )
    rise = np.maximum(vertices[:, 1], 0.0) / (np.hypot(awayX, awayZ) + 1e-9)
    layers = np.empty((len(SHADOW_LAYERS), len(vertices), 3), dtype=np.float32)
    for place, (growth, _) in enumerate(SHADOW_LAYERS):
        spread = np.maximum(growth * rise, -0.9)
        layers[place, :, 0], layers[place, :, 2] = x + spread * awayX, z + spread * awayZ
        layers[place, :, 1] = height * (1.0 - place / len(SHADOW_LAYERS))
    return layers.reshape(-1, 3)


def nearest_creases(bodyOfCrease, distance, most):
    """Returns the indices of the creases of the nearest bodies: `most` of them, or all if fewer.

    bodyOfCrease : (E,), body of each crease; distance : (n,), of the bodies
    """
    if len(bodyOfCrease) <= most:
        return np.arange(len(bodyOfCrease))
    order = distance.argsort()
    isNear = np.empty(len(distance), dtype=bool)
    isNear[order] = np.bincount(bodyOfCrease, minlength=len(distance))[order].cumsum() <= most
    chosen = np.flatnonzero(isNear[bodyOfCrease])
    return np.pad(chosen, (0, most - len(chosen)), "edge")  # repeats one: the number is constant
