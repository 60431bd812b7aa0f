"""Light of studio pictures, and surfaces of bodies for it: smooth normals, rounded edges.

Light is linear, in units in which white paper in the open has about 2, and reflection is diffuse:
sky, sun, and light from bodies and ground. For each of several hundred directions, a map
(`rbs.pictures.studio`) contains the face that the light meets first. Light reaches a point unless
that face belongs to another body and lies in front of the point. No rays need tracing, and faces do
not shade themselves.

Arrays of points, vectors and colours are (3, m), in single precision. Reading order: the skin of
one shape at rest; all bodies of a scene; directions; light in the open; light among bodies. Units:
metres.
"""

import math

import numpy as np

from Quaternion import rotation_matrices
from rbs.appearance.drawables import CREASE_ANGLE, SUN, corner_normals, face_neighbours
from rbs.geometry.broadphase import islands
from rbs.geometry.triples import dot

# Radius of rounded edges, as a fraction of the least extent of the body. More looks like soap; less
# catches no light.
ROUNDING = 0.035
# Number of normals tried to find the least extent of a shape. More takes longer.
MOST_NORMALS = 300
# Least cosine between the normals of faces that form one flat side.
FLAT_COSINE = 1.0 - 1e-9
# Sides of the maps of the sky and of the light from below, in pixels.
MAP_SIDES = {"sky": 192, "below": 128}
# Number of directions in a ring of the hemisphere; a ring of the sun's disc has its square root.
# Angle, in radians, by which the next ring is turned.
RING, GOLDEN_ANGLE = 16, math.pi * (3.0 - math.sqrt(5.0))
# Least distance of a face in front of a point that it shades, as a fraction of the lit size. More
# lets light through at contacts.
LEAST_GAP = 2e-4
# Angle of the sun's disc, in radians. More makes shadows softer.
SUN_ANGLE = math.radians(2.0)
# Irradiance of the sun, and radiance of the sky at the zenith and at the horizon (r, g, b).
SUN_LIGHT = 5.6 * np.array([1.0, 0.945, 0.86])
ZENITH, HORIZON = np.array([0.44, 0.54, 0.72]), np.array([0.58, 0.59, 0.60])
# Reflectance of the ground.
GROUND = np.array([0.54, 0.524, 0.50])
# Initial estimate of a surface's irradiance among others, as a fraction of that in the open.
AROUND = 0.55
# Reflectance of a body's gloss, seen head-on, and sharpness of the sun's reflection.
GLOSS, SHININESS = 0.04, 64
# Least cosine between normal and camera. Less makes outlines white.
LEAST_FACING = 0.15
# Number of samples of the ground along each side, for the light that it reflects.
GROUND_SAMPLES = 128


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


def hemisphere(count):
    """`count` directions (n, 3) of equal solid angle in the upper half space.

    Each RING of them form a ring, rotated relative to the one before. Every RING-th direction,
    starting from any of the first RING, is spread evenly, too. count : a multiple of RING
    """
    k = np.arange(count)
    y = (k + 0.5) / count
    angle = k // RING * GOLDEN_ANGLE + 5 * k % RING * math.tau / RING
    across = np.sqrt(1.0 - y * y)
    return np.stack([across * np.cos(angle), y, across * np.sin(angle)], axis=1)


def sun_disc(count):
    """`count` directions (n, 3) of equal solid angle towards the sun's disc, as in `hemisphere`."""
    k, ring = np.arange(count), math.isqrt(RING)
    radius = np.sqrt((k + 0.5) / count)
    angle = k // ring * GOLDEN_ANGLE + k % ring * math.tau / ring
    side = np.cross(SUN, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    x, y = (math.tan(0.5 * SUN_ANGLE) * radius * f(angle) for f in (np.cos, np.sin))
    towards = SUN + x[:, None] * side + y[:, None] * np.cross(side, SUN)
    return towards / np.linalg.norm(towards, axis=1, keepdims=True)


def directions(counts):
    """Returns the directions of light, dict of (n, 3) by kind; counts : dict of their numbers."""
    below = hemisphere(counts["below"]) * [1.0, -1.0, 1.0]
    return {"sky": hemisphere(counts["sky"]), "below": below, "sun": sun_disc(counts["sun"])}


def sky_radiance(height):
    """Radiance (n, 3) of the sky at these sines of elevation (n,)."""
    share = np.sqrt(np.clip(height, 0.0, 1.0))[:, None]
    return (1.0 - share) * HORIZON + share * ZENITH


class ByHeight:
    """Table (k, n) of quantities that depend on the y component, -1 to 1, of unit vectors."""

    def __init__(self, quantities):
        """quantities : function of heights (n,) that returns (n, k)"""
        self.table = quantities(np.linspace(-1.0, 1.0, 513)).T.astype(np.float32)

    def __call__(self, y):
        """Returns the quantities (k, m) of vectors with this y component, (m,)."""
        return self.table.take(((y + 1.0) * 256.0 + 0.5).astype(np.int32), axis=1, mode="clip")


def _open_irradiance(height):
    """Irradiance in the open by the height of normals: sky r, g, b, and unit half spaces."""
    sky = hemisphere(4096)
    normal = np.stack([np.sqrt(1.0 - height**2), height, 0.0 * height], axis=1)
    received = np.maximum(normal @ sky.T, 0.0) @ sky_radiance(sky[:, 1]) * (math.tau / len(sky))
    return np.column_stack([received, math.pi / 2 * (1.0 + height), math.pi / 2 * (1.0 - height)])


OPEN = ByHeight(_open_irradiance)
OPEN_SKY = OPEN.table[:3, -1]
# Radiance of the ground in the open, also the initial estimate near bodies.
OPEN_GROUND = GROUND / math.pi * (OPEN_SKY + SUN[1] * SUN_LIGHT)


def irradiance(normal, light):
    """Irradiance (3, m) of surfaces with these normals (3, m); light : (5, m), see `received`."""
    cosine = np.maximum(dot(normal, SUN.astype(np.float32)), 0.0)
    sun = SUN_LIGHT.astype(np.float32)[:, None] * (cosine * light[0])
    return sun + OPEN(normal[1])[:3] * light[1] + light[2:]


# Surroundings mirrored by glossy surfaces.
SURROUNDINGS = ByHeight(lambda y: np.where(y[:, None] < 0.0, OPEN_GROUND, sky_radiance(y)))


def gloss(normal, ray, light):
    """Light (3, m) that the surfaces of bodies mirror towards the camera, along -ray (3, m)."""
    sun = SUN.astype(np.float32)
    cosine = np.maximum(dot(normal, sun), 0.0)
    half = sun[:, None] - ray
    half /= np.sqrt(dot(half, half))
    shine = np.maximum(dot(normal, half), 0.0)
    for _ in range(SHININESS.bit_length() - 1):
        shine *= shine
    shine *= GLOSS * (SHININESS + 8.0) / (8.0 * math.pi) * cosine * light[0]
    facing = np.clip(-dot(normal, ray), LEAST_FACING, 1.0)
    grazing = 1.0 - facing
    fresnel = GLOSS + (1.0 - GLOSS) * grazing * (grazing * grazing) ** 2  # Schlick's
    mirrored = SURROUNDINGS(2.0 * facing * normal[1] + ray[1])
    return SUN_LIGHT.astype(np.float32)[:, None] * shine + 0.5 * fresnel * light[1] * mirrored


class SceneLight:
    """Light received by the points of a scene, with its bodies in their present poses.

    surface : `Surface`; size : m, of the lit region
    """

    def __init__(self, surface, maps, vertices, box, counts, sunMapSide, progress):
        """Draws the maps; call within `bodies_only`, with the faces numbered.

        maps : `LightMaps` of the surface; vertices : (V, 3), of all bodies
        box : (2, 3), corners of the lit region
        counts : numbers of directions, by kind; progress : called with the completed fraction
        """
        self.surface, self.size = surface, float(np.linalg.norm(box[1] - box[0]))
        self._directions = directions(counts)
        self._maps = maps
        drawn = 0

        def advance():
            nonlocal drawn
            drawn += 1
            progress(drawn / sum(counts.values()))

        for kind, towards in self._directions.items():
            side = MAP_SIDES.get(kind, sunMapSide)
            self._maps.draw(kind, towards, side, box, vertices, advance)
        # initial estimate of the light between bodies and ground
        normal = surface.plane[:3]
        inTheOpen = np.array([[1.0, 1.0, 0.0, 0.0, 0.0]], dtype=np.float32).T
        self._sent = self._body_radiance(AROUND * irradiance(normal, inTheOpen))
        margin = 0.7 * (box[1, 1] - box[0, 1])
        self._low, self._high = box[0, [0, 2]] - margin, box[1, [0, 2]] + margin
        self._ground = self._ground_radiance()
        received = self.received(surface.centre, normal, surface.body)
        self._sent = self._body_radiance(irradiance(normal, received))

    def _body_radiance(self, received):
        """Mean radiance of each body by direction of light, dict by kind of lists (3, n), because a
        map does not contain the visible face. received : (3, F + 1)
        """
        surface, result = self.surface, {}
        body, sent = surface.body[1:], (surface.albedo * received / math.pi)[:, 1:]
        for kind in ("sky", "below"):
            result[kind] = []
            for towards in self._directions[kind]:
                seen = surface.area[1:] * np.maximum(-(towards @ surface.plane[:3, 1:]), 0.0)
                total = np.maximum(np.bincount(body, seen), np.finfo(float).tiny)
                mean = [np.bincount(body, seen * sent[c]) / total for c in range(3)]
                result[kind].append(np.array(mean, dtype=np.float32))
        return result

    def _ground_radiance(self):
        """Radiance (3, GROUND_SAMPLES²) of the ground, x by x in rows of z."""
        place = (np.arange(GROUND_SAMPLES) + 0.5) / GROUND_SAMPLES
        x, z = (a + place * (b - a) for a, b in zip(self._low, self._high, strict=True))
        points = np.zeros((3, GROUND_SAMPLES**2), dtype=np.float32)
        points[0], points[2] = np.tile(x, GROUND_SAMPLES), np.repeat(z, GROUND_SAMPLES)
        normal = np.zeros_like(points)
        normal[1] = 1.0
        received = self.received(points, normal, np.full(points.shape[1], -1))
        return (GROUND[:, None] / math.pi * irradiance(normal, received)).astype(np.float32)

    def received(self, x, normal, body, first=0, stride=1):
        """Returns the light (5, m) that reaches points x (3, m).

        The rows are the visible fractions of sun and sky, and the irradiance r, g, b from bodies
        and ground. normal : (3, m), unit; body : (m,), that of the points, -1 for the ground;
        first, stride : use every stride-th direction from the first on, and of the sun's, which
            are few, every √stride-th
        """
        result = np.zeros((5, x.shape[1]), dtype=np.float32)
        some = np.flatnonzero(dot(normal, SUN.astype(np.float32)) > 0.0)
        lit = np.ones(len(some), dtype=np.float32)
        suns = math.isqrt(stride)
        suns = range(first % suns, len(self._directions["sun"]), suns)
        points, bodies = x.take(some, axis=1), body.take(some)
        for k in suns:
            lit[self._maps.blockers("sun", k, points, bodies)[1]] -= 1.0 / len(suns)
        result[0, some] = lit

        irradiance = OPEN(normal[1])
        free, around, total = self._gathered("sky", x, normal, body, first, stride)
        result[1] = free / total
        result[2:] = around * (irradiance[3] / total)
        # light from below hardly reaches surfaces that face up
        some = np.flatnonzero((body >= 0) & (irradiance[4] > 0.06))
        if len(some):
            x, normal, body = x.take(some, axis=1), normal.take(some, axis=1), body.take(some)
            _, around, total = self._gathered("below", x, normal, body, first, stride)
            result[2:, some] += around * (irradiance[4].take(some) / total)
        return result

    def _gathered(self, kind, x, normal, body, first, stride):
        """Sums over directions, weighted by cosine: `(free (m,), radiance (3, m), total (m,))`.

        Free directions are not blocked; the radiance is that of blocking bodies, and of the ground.
        """
        total = np.full(x.shape[1], 1e-6, dtype=np.float32)
        free = np.zeros(x.shape[1], dtype=np.float32)
        around = np.zeros(x.shape, dtype=np.float32)
        for k in range(first, len(self._directions[kind]), stride):
            towards = self._directions[kind][k].astype(np.float32)
            weight = np.maximum(dot(normal, towards), 0.0)
            total += weight
            number, index = self._maps.blockers(kind, k, x, body)
            blocked, blocker = weight.take(index), self.surface.body.take(number)
            for c in range(3):
                around[c, index] += blocked * self._sent[kind][k][c].take(blocker)
            weight[index] = 0.0
            free += weight
            if kind == "below":
                around += weight * self._ground.take(self._ground_sample(x, towards), axis=1)
        return free, around, total

    def _ground_sample(self, x, towards):
        """Returns the ground sample (m,) that a ray from x (3, m) in a downward direction meets."""
        columns = []
        for axis, low, high in zip((0, 2), self._low, self._high, strict=True):
            place = x[axis] - (towards[axis] / towards[1]) * x[1]
            place = (place - low) * (GROUND_SAMPLES / (high - low))
            columns.append(np.clip(place, 0.0, GROUND_SAMPLES - 1.0).astype(np.int32))
        return columns[1] * GROUND_SAMPLES + columns[0]
