"""Light of the window: bodies as one surface that sun and sky light, and soft shadows.

The light stays in the world, as the shadows do; that of Polyscope's materials moves with the
camera, and its tone mapping turns colours pale. Units: metres. The y axis points up.
"""

import math

import numpy as np

from Quaternion import rotation_matrices
from rbs.appearance import drawables
from rbs.geometry.broadphase import islands
from rbs.geometry.hulls import rotate_columns
from rbs.geometry.vectors import ranges
from rbs.stepping.meshes import Snapshot
from RBSFunctions import refresh_vertices

# Light of the sun on a surface that faces it, of the sky on one that faces up, and from the ground
# on one that faces down: rows for red, green and blue.
LIGHT = ((0.86, 0.33, 0.20), (0.83, 0.36, 0.20), (0.77, 0.41, 0.19))
# Direction towards the sun: that in which the shadows are cast.
TO_SUN = (np.array([0.0, 1.0, 0.0]) - drawables.SHADOW_SLANT).tolist()
TO_SUN = [component / math.hypot(*TO_SUN) for component in TO_SUN]
# Corners of a shadow's outline, least (with many bodies) and most; and of all outlines together.
LEAST_CORNERS, MOST_CORNERS, ALL_CORNERS = 12, 32, 12_000
# Width in metres of a shadow's blurred edge, per metre of height of the point that casts it.
SHADOW_BLUR = 0.09
# Height of the blurred edge's outer side, relative to that of the shadow.
RIM_HEIGHT = 0.2


class LitSurface:
    """All bodies as one surface, smooth except at creases, in the light of sun and sky.

    Vertices at a crease are split, one for each side. Vertices are numbered through all bodies.

    vertexCounts, firstVertex : (n,), of each body, the number of its vertices and the first one
    source : (S,), the vertex that each split one comes from
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
        self._rest = np.concatenate([mesh.origVertices for mesh in meshes]).T.astype(np.float32)
        self.vertexCounts = np.array([len(mesh.origVertices) for mesh in meshes])
        self.firstVertex = self.vertexCounts.cumsum() - self.vertexCounts
        counts = np.array([len(source) for source in sources])
        self._normalCounts = np.array([len(part) for part in normals])
        bodies = np.arange(len(meshes))
        bodyOfVertex = bodies.repeat(counts)
        self.bodyOfFace = bodies.repeat([len(part) for part in faces])
        firstSplit = counts.cumsum() - counts
        firstNormal = self._normalCounts.cumsum() - self._normalCounts
        self._normal = np.concatenate(normal) + firstNormal[bodyOfVertex]
        self.source = np.concatenate(sources) + self.firstVertex[bodyOfVertex]
        self.faces = np.concatenate(faces) + firstSplit[self.bodyOfFace, None]
        self._normals = np.ascontiguousarray(np.concatenate(normals).T, dtype=np.float32)

    def place(self, poses):
        """Puts the bodies into poses (7, n). Returns their vertices (ΣV, 3)."""
        poses = poses.astype(np.float32)
        rotation = np.stack(rotation_matrices(poses[3:]))
        vertices = rotate_columns(rotation, self._rest, self.vertexCounts)
        vertices += poses[:3].repeat(self.vertexCounts, axis=1)
        x, y, z = rotate_columns(rotation, self._normals, self._normalCounts)
        toSun = np.square(0.5 + 0.5 * (TO_SUN[0] * x + TO_SUN[1] * y + TO_SUN[2] * z))
        up = 0.5 + 0.5 * y
        # sRGB colours are multiplied by it, so it is the root of the linear light
        self._light = np.sqrt([a * toSun + (b - c) * up + c for a, b, c in LIGHT])
        self._turned = np.stack([x, y, z])
        return np.ascontiguousarray(vertices.T)

    def corners(self, vertices):
        """Returns places and normals at the corners of the faces, each (F, 3, 3), where the bodies
        are. vertices : (ΣV, 3), from `place`
        """
        return vertices[self.source[self.faces]], self._turned.T[self._normal[self.faces]]

    def lit(self, colours):
        """Returns the colours (S, 3) of bodies of colours (n, 3) in the light where they are."""
        seen = self._light * colours.T.astype(np.float32).repeat(self._normalCounts, axis=1)
        return np.ascontiguousarray(np.minimum(seen, 1.0).T).take(self._normal, axis=0)

    def edges_of_free(self, meshes):
        """Returns the edges of the bodies that are not fixed: nodes (V, 3), and pairs (E, 2).

        meshes : bodies of the same shapes, which may be elsewhere
        """
        isFree = np.repeat([not mesh.isFixed for mesh in meshes], self.vertexCounts)
        corners = self.source[self.faces]
        edges = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2)[self.isCrease]
        edges = np.unique(np.sort(edges[isFree[edges[:, 0]]]), axis=0)
        return refresh_vertices(meshes), edges


def poses_of(meshes):
    """Returns position and orientation of each body as columns, (7, n)."""
    columns = Snapshot.of(meshes)
    return np.concatenate((columns["position"], columns["orientation"]))


def split_at_creases(vertices, faces):
    """Splits the vertices (V, 3) of closed faces (F, 3) where the surface has creases.

    Returns `(source (S,), normal (S,), normals (N, 3), faces (F, 3), isCrease (F, 3))`: the vertex
    that each split one comes from, the index of its normal, all different normals, faces with split
    vertices, and which of their edges are creases.
    """
    across = drawables.area_vectors(vertices, faces)
    isCrease = drawables.find_creases(vertices, faces)
    # corners at one vertex belong together if their faces meet at an edge that is no crease
    face, k = np.nonzero(~isCrease)
    other = drawables.face_neighbours(faces)[face, k]
    links = []
    for corner in (k, (k + 1) % 3):
        isSame = faces[other] == faces[face, corner][:, None]
        links.append((3 * face + corner, 3 * other + isSame.argmax(axis=1)))
    labels = islands(np.concatenate(links, axis=1), np.ones(faces.size, dtype=bool))
    _, first, split = np.unique(labels, return_index=True, return_inverse=True)
    sums = np.zeros((len(first), 3))
    np.add.at(sums, split.ravel(), across.repeat(3, axis=0))
    normals, normal = np.unique(np.round(drawables.unit_rows(sums), 6), axis=0, return_inverse=True)
    return faces.ravel()[first], normal.ravel(), normals, split.reshape(-1, 3), isCrease


class FloorShadows:
    """Shadows on the floor; the higher the point that casts an edge, the more blurred it is.

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
        # bodies with equally many vertices follow each other
        first = vertexCounts.cumsum() - vertexCounts
        order = vertexCounts.argsort(kind="stable")
        self._vertex = ranges(first[order], vertexCounts[order])[1]
        self._groups = [
            (int(count), int(np.sum(vertexCounts == count))) for count in np.unique(vertexCounts)
        ]
        k = np.arange(corners)
        after = (k + 1) % corners
        inner = np.stack([0 * k, after, k], axis=1)[1:-1]
        rim = [[k, after, k + corners], [after, after + corners, k + corners]]
        rim = np.concatenate([np.stack(part, axis=1) for part in rim])
        # what is on top comes first, which saves drawing what is below
        bodies = np.arange(bodyCount)[:, None, None]
        self.faces = np.concatenate(
            [(bodyCount * part + bodies).reshape(-1, 3) for part in (inner, rim)]
        )
        self.darkness = np.repeat([1.0, 0.0], corners * bodyCount)

    def place(self, vertices, height):
        """Returns the vertices (V, 3) of the shadows at a height in metres, and a little below.

        vertices : (ΣV, 3), of all bodies
        """
        x, y, z = vertices.astype(np.float32).take(self._vertex, axis=0).T
        y = np.maximum(y, 0.0)
        slantX, _, slantZ = drawables.SHADOW_SLANT.tolist()
        floor = np.stack([x + slantX * y, z + slantZ * y])
        reach = self._away.T @ floor
        begin, furthest, middles = 0, [], []
        for count, bodyCount in self._groups:
            vertex = np.arange(begin, begin + count * bodyCount, count)
            begin += count * bodyCount
            some = reach[:, vertex[0] : begin].reshape(-1, bodyCount, count)
            furthest.append(vertex + some.argmax(axis=2))
            middles.append(floor[:, vertex[0] : begin].reshape(2, bodyCount, count).mean(axis=2))
        # of each body, the vertices that reach furthest in each direction
        furthest = np.concatenate(furthest, axis=1)
        outline, blur = floor[:, furthest], SHADOW_BLUR * y[furthest]
        arms = outline - np.concatenate(middles, axis=1)[:, None]
        inwards = np.minimum(0.5 * blur / (np.hypot(*arms) + 1e-9), 0.5)
        sides = outline - inwards * arms, outline + 0.5 * blur * self._away[:, :, None]
        x, z = np.stack(sides, axis=1).reshape(2, -1)
        y = height * (RIM_HEIGHT + (1.0 - RIM_HEIGHT) * self.darkness)
        return np.stack([x, y, z], axis=1, dtype=np.float32)
