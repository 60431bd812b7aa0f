"""Light of the window: bodies as one surface that sun and sky light, and soft shadows.

Reading order: `LitSurface`; `FloorShadows`.

The light stays in the world, as the shadows do; that of Polyscope's materials moves with the
camera, and its tone mapping turns colours pale. Units: metres. The y axis points up.
"""

import math

import numpy as np

from Quaternion import rotation_matrices
from rbs.appearance.drawables import (
    SHADOW_SLANT,
    face_neighbours,
    find_creases,
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
# Corners of a shadow's outline: from the least, with many bodies, to the most; and in all together.
LEAST_CORNERS, MOST_CORNERS, ALL_CORNERS = 12, 32, 12_000
# Width of the blurred edge of a shadow in metres per metre of height of what casts it.
SHADOW_BLUR = 0.09
# Height of the blurred edge's outer side, relative to that of the shadow.
RIM_HEIGHT = 0.2


class LitSurface:
    """All bodies as one surface, smooth except at creases, in the light of sun and sky.

    Vertices at a crease are split, one for each side. Vertices are numbered through all bodies.

    Attributes
    ----------
    firstVertex : (n,), the first vertex of each body
    source, bodyOfVertex : (S,), the vertex that each split one comes from, and its body
    faces, bodyOfFace : (F, 3), of split vertices; (F,)
    isCrease : (F, 3), whether a face's edge from its corner k to the next one is a crease
    """

    def __init__(self, meshes):
        kinds, parts = {}, []
        for mesh in meshes:
            key = mesh.origVertices.tobytes(), mesh.faces.tobytes()
            if key not in kinds:
                kinds[key] = split_at_creases(mesh.origVertices, mesh.faces)
            parts.append(kinds[key])
        sources, normal, normals, faces, creases = zip(*parts, strict=True)
        self.isCrease = np.concatenate(creases)
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

    Returns `(source (S,), normal (S,), normals (N, 3), faces (F, 3), isCrease (F, 3))`: the vertex
    that each split one comes from, the index of its normal, all different normals, faces with split
    vertices, and which of their edges are creases.
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    isCrease = find_creases(vertices, faces)
    # corners at one vertex belong together if their faces meet at an edge that is no crease
    face, k = np.nonzero(~isCrease)
    other = face_neighbours(faces)[face, k]
    links = []
    for corner in (k, (k + 1) % 3):
        isSame = faces[other] == faces[face, corner][:, None]
        links.append((3 * face + corner, 3 * other + isSame.argmax(axis=1)))
    labels = islands(np.concatenate(links, axis=1), np.ones(faces.size, dtype=bool))
    _, first, split = np.unique(labels, return_index=True, return_inverse=True)
    sums = np.zeros((len(first), 3))
    np.add.at(sums, split.ravel(), across.repeat(3, axis=0))
    normals, normal = np.unique(np.round(unit_rows(sums), 6), axis=0, return_inverse=True)
    return faces.ravel()[first], normal.ravel(), normals, split.reshape(-1, 3), isCrease


class FloorShadows:
    """Shadows on the floor, with edges that are the more blurred the higher what casts them.

    A shadow is the convex outline of its body, and a rim around it in which the darkness falls from
    1 to 0. The darker a point, the higher it lies; so where shadows overlap, the darkest is seen.

    Attributes: faces (F, 3) and darkness (V,), 0 to 1, of the V vertices that `place` returns.
    """

    def __init__(self, vertexCounts):
        """vertexCounts : (n,), of the bodies, all at least 1"""
        bodyCount = len(vertexCounts)
        corners = min(max(ALL_CORNERS // bodyCount, LEAST_CORNERS), MOST_CORNERS)
        angles = np.linspace(0.0, 2.0 * math.pi, corners, endpoint=False)
        self._away = np.stack([np.cos(angles), np.sin(angles)]).astype(np.float32)
        # bodies of equally many vertices at a time
        first = vertexCounts.cumsum() - vertexCounts
        self._groups = [
            first[vertexCounts == count, None] + np.arange(count)
            for count in np.unique(vertexCounts)
        ]
        k = np.arange(corners)
        after = (k + 1) % corners
        inner = np.stack([0 * k, after, k], axis=1)[1:-1]
        rim = [np.stack([k, after, k + corners], axis=1)]
        rim.append(np.stack([after, after + corners, k + corners], axis=1))
        begin = 2 * corners * np.arange(bodyCount)[:, None, None]
        # what is on top comes first, which saves drawing what is below
        parts = inner, np.concatenate(rim)
        self.faces = np.concatenate([(part + begin).reshape(-1, 3) for part in parts])
        self.darkness = np.tile(np.repeat([1.0, 0.0], corners), bodyCount)

    def place(self, vertices, height):
        """Returns the vertices (V, 3) of the shadows at a height in metres, and a little below.

        vertices : (ΣV, 3), of all bodies
        """
        x, y, z = vertices.astype(np.float32).T
        y = np.maximum(y, 0.0)
        floor = np.stack([x + SHADOW_SLANT[0] * y, z + SHADOW_SLANT[2] * y]).astype(np.float32)
        awayX, awayZ = self._away[:, :, None]
        parts = []
        for group in self._groups:
            pointsX, pointsZ = floor[:, group]
            # the vertices that reach furthest in each direction
            reach = awayX * pointsX[:, None] + awayZ * pointsZ[:, None]
            furthest = np.take_along_axis(group, reach.argmax(axis=2), axis=1)
            outline, blur = floor[:, furthest], SHADOW_BLUR * y[furthest]
            arms = outline - np.stack([pointsX, pointsZ]).mean(axis=2, keepdims=True)
            inwards = np.minimum(0.5 * blur / (np.hypot(*arms) + 1e-9), 0.5)
            sides = outline - inwards * arms, outline + 0.5 * blur * self._away[:, None]
            parts.append(np.stack(sides, axis=2).reshape(2, -1))
        x, z = np.concatenate(parts, axis=1)
        return np.stack([x, height * (RIM_HEIGHT + (1.0 - RIM_HEIGHT) * self.darkness), z], axis=1)
