"""Surfaces of bodies for lighting: smooth normals, rounded edges, planes of faces.

Arrays of points and vectors are (3, m), in single precision, which NumPy processes fastest. Reading
order: the skin of one shape at rest; all bodies of a scene. Units: metres.
"""

import math

import numpy as np

from Quaternion import rotation_matrices
from rbs.appearance.drawables import CREASE_ANGLE, corner_normals, face_neighbours
from rbs.geometry.broadphase import islands
from rbs.geometry.triples import dot

# Radius of rounded edges, as a fraction of the least extent of the body. More looks like soap; less
# catches no light.
ROUNDING = 0.035
# Number of normals tried to find the least extent of a shape. More takes longer.
MOST_NORMALS = 300
# Least cosine between the normals of faces that form one flat side.
FLAT_COSINE = 1.0 - 1e-9


class Skin:
    """Surface of one shape at rest.

    normal (F, 3), offset (F,), area (F,) : of the faces and their planes
    smooth (F, 3, 4) : the interpolated normal at a point x has the direction of smooth · (x, 1)
    group (F,) : number shared by faces that look like one round surface
    rims (F, E, 7) : creases around the flat side of a face. A point x of the side has the distance
        rims[e, 3] - rims[e, :3] · x from crease e, beyond which the normal is rims[e, 4:7]
    rimCount (F,) : number of creases in use
    radius : of the rounded edges, m
    """

    def __init__(self, vertices, faces):
        corners = vertices[faces]  # (F, 3, 3): face, corner, xyz
        edges = np.roll(corners, -1, axis=1) - corners
        normal = np.cross(edges[:, 0], edges[:, 1])
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        self.area = length[:, 0] / 2.0
        self.normal = normal = normal / np.maximum(length, np.finfo(float).tiny)
        self.offset = np.sum(normal * corners[:, 0], axis=1)
        heights = vertices @ normal[:: max(1, len(faces) // MOST_NORMALS)].T
        self.radius = ROUNDING * float(np.ptp(heights, axis=0).min())
        neighbours = face_neighbours(faces)
        cosine = np.sum(normal[:, None] * normal[neighbours], axis=2)  # (F, 3)
        isRound = cosine > math.cos(CREASE_ANGLE)
        self.group = _joined(neighbours, isRound)
        self._interpolate(corner_normals(vertices, faces), corners, edges)
        side = _joined(neighbours, cosine > FLAT_COSINE)
        self._find_rims(corners, edges, neighbours, isRound, side)

    def _interpolate(self, n, corners, edges):
        """Interpolates the normals n (F, 3, 3) of the corners over the faces."""
        # the weight of corner k grows from 0 on the opposite edge to 1 at the corner
        growth = np.cross(self.normal[:, None], np.roll(edges, -1, axis=1))
        growth /= np.maximum(2.0 * self.area, np.finfo(float).tiny)[:, None, None]
        share = np.concatenate(
            [growth, 1.0 - np.sum(growth * corners, axis=2, keepdims=True)], axis=2
        )
        self.smooth = np.einsum("fki,fkj->fij", n, share)

    def _find_rims(self, corners, edges, neighbours, isRound, side):
        rims = [[] for _ in range(side.max() + 1)]
        for f, k in np.argwhere(~isRound):
            outwards = np.cross(edges[f, k], self.normal[f])
            outwards /= max(np.linalg.norm(outwards), np.finfo(float).tiny)
            rim = [*outwards, outwards @ corners[f, k], *self.normal[neighbours[f, k]]]
            rims[side[f]].append(rim)
        self.rimCount = np.array([len(rims[s]) for s in side])
        self.rims = np.zeros((len(side), self.rimCount.max(), 7))
        for f, s in enumerate(side):
            self.rims[f, : len(rims[s])] = np.reshape(rims[s], (-1, 7))


def _joined(neighbours, isJoined):
    """Returns a number (F,) for each set of faces joined across edges."""
    face, edge = np.nonzero(isJoined)
    links = np.stack([face, neighbours[face, edge]])
    return islands(links, np.ones(len(neighbours), dtype=bool))


class Surface:
    """Surfaces of all bodies in their poses. Faces count through all bodies from 1; 0 is none.

    body, group (F + 1,) : of each face; -1 for no face
    plane (4, F + 1) : of the faces; plane[:3] · x - plane[3] is the height of x above it
    albedo (3, F + 1) : linear reflectance of the faces
    centre (3, F + 1), area (F + 1,) : of the faces
    """

    def __init__(self, meshes, vertices, faces, bodyOfFace, albedo, skins):
        """skins : dict that caches the skins of shapes; albedo : (n, 3), of the bodies.

        vertices, faces, bodyOfFace : from `flatten_meshes`
        """
        used, rows = {}, []  # each shape's first row, and each body's, in the tables below
        for mesh in meshes:
            key = mesh.origVertices.tobytes(), mesh.faces.tobytes()
            if key not in skins:
                skins[key] = Skin(mesh.origVertices, mesh.faces)
            if key not in used:
                used[key] = sum(len(skins[k].normal) for k in used)
            rows.append(used[key])
        kinds = [skins[key] for key in used]
        names = "normal", "offset", "area", "group", "smooth", "rimCount"
        normal, offset, area, group, smooth, self._rimCount = (
            np.concatenate([getattr(kind, name) for kind in kinds]) for name in names
        )
        self._smooth = np.ascontiguousarray(smooth.reshape(-1, 12).T, dtype=np.float32)
        width = max(kind.rims.shape[1] for kind in kinds)
        rims = [np.pad(k.rims, ((0, 0), (0, width - k.rims.shape[1]), (0, 0))) for k in kinds]
        self._rims = np.concatenate(rims).transpose(1, 2, 0).astype(np.float32)
        radii = np.array([kind.radius for kind in kinds], dtype=np.float32)
        self._radius = radii.repeat([len(kind.normal) for kind in kinds])
        firstFace = np.searchsorted(bodyOfFace, np.arange(len(meshes)))
        row = np.arange(len(faces)) - firstFace[bodyOfFace] + np.array(rows)[bodyOfFace]
        self._row = _with_none(row, 0)
        rotation = rotation_matrices(np.concatenate([mesh.orientation for mesh in meshes]).T)
        rotation = np.moveaxis(np.reshape(rotation, (3, 3, -1)), 2, 0)
        position = np.concatenate([mesh.position for mesh in meshes])
        self._rotation = np.ascontiguousarray(rotation.reshape(-1, 9).T, dtype=np.float32)
        self._position = np.ascontiguousarray(position.T, dtype=np.float32)
        normal = np.einsum("fij,fj->fi", rotation[bodyOfFace], normal[row])
        height = offset[row] + np.sum(normal * position[bodyOfFace], axis=1)
        self.plane = _with_none(np.concatenate([normal.T, height[None]]), 0).astype(np.float32)
        self.body = _with_none(bodyOfFace, -1).astype(np.int32)
        most = int(group.max()) + 1
        self.group = _with_none(bodyOfFace * most + group[row], -1).astype(np.int32)
        self.area = _with_none(area[row], 0)
        self.albedo = _with_none(albedo[bodyOfFace].T, 0).astype(np.float32)
        self.centre = _with_none(vertices[faces].mean(axis=1).T, 0).astype(np.float32)

    def normals(self, number, x, detail):
        """`(smooth, rounded)` unit normals (3, m) at points x (3, m) of the faces `number` (m,).

        detail (m,) : size of the least visible detail, m; finer edges are drawn wider and flatter
        """
        body, row = self.body.take(number), self._row.take(number)
        R = self._rotation.take(body, axis=1).reshape(3, 3, -1)
        x = x - self._position.take(body, axis=1)
        rest = np.stack([R[0, i] * x[0] + R[1, i] * x[1] + R[2, i] * x[2] for i in range(3)])
        table = self._smooth.take(row, axis=1).reshape(3, 4, -1)
        smooth = np.stack([dot(table[i], rest) + table[i, 3] for i in range(3)])
        smooth /= np.sqrt(dot(smooth, smooth))
        rounded, count, radius = smooth.copy(), self._rimCount.take(row), self._radius.take(row)
        width = np.maximum(radius, detail)
        bend = 0.5 * radius / width
        for k, rims in enumerate(self._rims):
            some = np.flatnonzero(count > k)
            place = row.take(some)
            rim = rims[:4].take(place, axis=1)
            near = 1.0 - (rim[3] - dot(rim, rest.take(some, axis=1))) / width.take(some)
            bent = np.flatnonzero(near > 0.0)
            some = some.take(bent)
            share = bend.take(some) * np.minimum(near.take(bent), 1.0) ** 2
            rounded[:, some] += share * (rims[4:7].take(place.take(bent), axis=1) - smooth[:, some])
        rounded /= np.sqrt(dot(rounded, rounded))
        return tuple(np.stack([dot(R[i], n) for i in range(3)]) for n in (smooth, rounded))


def _with_none(values, none):
    """Prepends the value for no face to values (..., F)."""
    return np.concatenate([np.full((*values.shape[:-1], 1), none), values], axis=-1)
