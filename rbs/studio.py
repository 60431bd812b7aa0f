"""Studio pictures: sky light, soft shadows and rounded edges, shaded in NumPy.

Polyscope only draws numbers of faces (`rbs.facenumbers`): once from the camera, and once from each
of several hundred light directions. A point of the picture is where its pixel's ray meets the plane
of its face, and a direction's light reaches it unless the plane of another body's face, found in
that direction's map, lies before it. As bodies are convex, none shades itself.

All light is linear; units are arbitrary. From the top: the light; the surface of the bodies; a
picture, band by band.
"""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from rbs.drawables import CREASE_ANGLE

# The picture is drawn so many times as large along each side, and averaged.
SUPERSAMPLING = 2
# Neighbouring samples share the light directions: CLASSES × CLASSES of them see all.
CLASSES = 4
SKY_DIRECTIONS, GROUND_DIRECTIONS, SUN_DIRECTIONS = 128, 32, 32
# Towards the sun, whose disc is this wide.
SUN = np.array([-0.58, 1.0, 0.40]) / math.sqrt(0.58**2 + 1.0 + 0.40**2)
SUN_ANGLE = math.radians(2.0)
# Irradiance of the sun, and radiance of the sky at the zenith and at the horizon.
SUN_LIGHT = 4.6 * np.array([1.0, 0.95, 0.87])
ZENITH, HORIZON = np.array([0.52, 0.64, 0.86]), np.array([0.78, 0.79, 0.80])
# Reflectance of the ground, of the lines on it, and of a glossy surface seen head-on.
GROUND, LINE, GLOSS = np.array([0.50, 0.485, 0.465]), 0.72, 0.04
# How much light reaches a surface in the neighbourhood, whose own shadows are not worked out.
AROUND = 0.55
# Sharpness of the sun's reflection.
SHININESS = 60.0
EXPOSURE = 0.56
# Radius of rounded edges, relative to the thinnest extent of the body.
ROUNDING = 0.035
# The backdrop at the horizon and high above, as seen, and where the ground fades into it, in sizes
# of the scene.
BACKDROP_LOW, BACKDROP_HIGH = np.array([0.885, 0.882, 0.872]), np.array([0.76, 0.765, 0.77])
FADE_BEGIN, FADE_END = 0.8, 4.5
# Points of a band that are shaded together.
BAND_POINTS = 600_000
# How far another face has to lie before a point to shade it, relative to the scene's size.
LEAST_GAP = 2e-4


# ---- The light ----------------------------------------------------------------------------------


def hemisphere(count):
    """`count` directions (n, 3) of equal solid angle over the upper half space."""
    k = np.arange(count) + 0.5
    y, angle = k / count, k * math.pi * (3.0 - math.sqrt(5.0))
    across = np.sqrt(1.0 - y * y)
    return np.stack([across * np.cos(angle), y, across * np.sin(angle)], axis=1)


def sun_disc(count):
    """`count` directions (n, 3) over the sun's disc."""
    k = np.arange(count) + 0.5
    radius, angle = np.sqrt(k / count), k * math.pi * (3.0 - math.sqrt(5.0))
    side = np.cross(SUN, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    x, y = (math.tan(0.5 * SUN_ANGLE) * radius * f(angle) for f in (np.cos, np.sin))
    towards = SUN + x[:, None] * side + y[:, None] * np.cross(side, SUN)
    return towards / np.linalg.norm(towards, axis=1, keepdims=True)


def sky_radiance(height):
    """The sky's radiance (n, 3) in directions of this sine of elevation (n,)."""
    share = np.sqrt(np.clip(height, 0.0, 1.0))[:, None]
    return (1.0 - share) * HORIZON + share * ZENITH


SKY = hemisphere(SKY_DIRECTIONS)
BELOW = hemisphere(GROUND_DIRECTIONS) * [1.0, -1.0, 1.0]
SUNS = sun_disc(SUN_DIRECTIONS)


def _irradiance_table(directions, radiance, heights):
    """Irradiance (n, 3) of surfaces whose normals have these heights, from open directions."""
    normals = np.stack([np.sqrt(1.0 - heights**2), heights, 0.0 * heights], axis=1)
    cosines = np.maximum(normals @ directions.T, 0.0)
    return cosines @ radiance * (2.0 * math.pi / len(directions))


_HEIGHTS = np.linspace(-1.0, 1.0, 65)
_FINE_SKY = hemisphere(4096)
_SKY_TABLE = _irradiance_table(_FINE_SKY, sky_radiance(_FINE_SKY[:, 1]), _HEIGHTS)
_BELOW_TABLE = _irradiance_table(_FINE_SKY * [1, -1, 1], np.ones((4096, 3)), _HEIGHTS)[:, :1]
OPEN_SKY = _SKY_TABLE[-1]
# Radiance of ground in the sun, and in shadow.
SHADED_GROUND = GROUND / math.pi * AROUND * OPEN_SKY
SUNLIT_GROUND = SHADED_GROUND + GROUND / math.pi * SUN[1] * SUN_LIGHT


def open_irradiance(height):
    """What normals (n,) of these heights receive: `(sky (n, 3), form factor of what is below)`."""
    columns = [np.interp(height, _HEIGHTS, column) for column in _SKY_TABLE.T]
    return np.stack(columns, axis=1), np.interp(height, _HEIGHTS, _BELOW_TABLE[:, 0])


def linear(colours):
    """Linear light of sRGB colours."""
    colours = np.asarray(colours, dtype=np.float64)
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)


def encoded(light):
    """sRGB colours of linear light, 0 to 1."""
    light = np.clip(light, 0.0, 1.0)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1.0 / 2.4) - 0.055)


def filmic(light):
    """The tone curve: a rational fit to that of the Academy Color Encoding System (Narkowicz)."""
    x = EXPOSURE * light
    return x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14)


# ---- The surface --------------------------------------------------------------------------------


class Skin:
    """How light meets the surface of one shape, at rest.

    normal (F, 3), offset (F,) : of the faces' planes
    smooth (F, 3, 4) : the interpolated normal at a point x is smooth · (x, 1), before normalisation
    group (F,) : faces that pass for one round surface share a number
    rims (F, E, 8) : the creases around each flat side: at x, the distance to a crease is
        rim[3] - rim[:3] · x, and its other side has the normal rim[4:7]; rimCount (F,)
    radius : of the rounded edges, m
    """

    def __init__(self, vertices, faces):
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        area = np.linalg.norm(normal, axis=1, keepdims=True)
        self.normal = normal = normal / np.maximum(area, np.finfo(float).tiny)
        self.offset = np.sum(normal * a, axis=1)
        heights = vertices @ normal.T
        self.radius = ROUNDING * float((heights.max(axis=0) - heights.min(axis=0)).min())
        neighbours = _neighbours(faces)
        turn = np.sum(normal[:, None] * normal[neighbours], axis=2)  # (F, 3), cosines
        isRound = turn > math.cos(CREASE_ANGLE)
        self.group = _labels(neighbours, isRound)
        self._interpolate(vertices, faces, area)
        self._find_rims(vertices, faces, neighbours, isRound, _labels(neighbours, turn > 1 - 1e-9))

    def _interpolate(self, vertices, faces, area):
        """The corners' normals, of the faces around them that pass for one surface with theirs."""
        isCorner = np.zeros((len(vertices), len(faces)), dtype=bool)
        isCorner[faces, np.arange(len(faces))[:, None]] = True
        isAlike = self.normal @ self.normal.T > math.cos(CREASE_ANGLE)
        self.smooth = np.zeros((len(faces), 3, 4))
        for f, corners in enumerate(faces):
            x = np.column_stack([vertices[corners], np.ones(3)])
            weights = (isCorner[corners] & isAlike[f]) * area[:, 0]
            n = weights @ self.normal
            n /= np.linalg.norm(n, axis=1, keepdims=True)
            # the least change of the normal that gives these corners: none across the face
            self.smooth[f] = np.linalg.lstsq(x, n, rcond=None)[0].T

    def _find_rims(self, vertices, faces, neighbours, isRound, side):
        rims = [[] for _ in range(side.max() + 1)]
        for f, k in np.argwhere(~isRound):
            tail, head = vertices[faces[f, k]], vertices[faces[f, (k + 1) % 3]]
            outwards = np.cross(head - tail, self.normal[f])
            outwards /= np.linalg.norm(outwards)
            rims[side[f]].append([*outwards, outwards @ tail, *self.normal[neighbours[f, k]], 0.0])
        self.rimCount = np.array([len(rims[s]) for s in side])
        self.rims = np.zeros((len(faces), max(1, self.rimCount.max()), 8))
        for f, s in enumerate(side):
            self.rims[f, : len(rims[s])] = np.reshape(rims[s], (-1, 8))


def _neighbours(faces):
    """The face (F, 3) on the other side of each face's edges, of a closed surface."""
    count = faces.max() + 1
    tails, heads = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    order, twin = np.argsort(tails * count + heads), np.argsort(heads * count + tails)
    neighbour = np.empty(len(tails), dtype=np.int64)
    neighbour[twin] = np.arange(len(faces)).repeat(3)[order]
    return neighbour.reshape(-1, 3)


def _labels(neighbours, isJoined):
    """A number (F,) for each set of faces that are joined over their edges."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    first, edge = np.nonzero(isJoined)
    graph = csr_array((np.ones(len(first)), (first, neighbours[first, edge])), (len(neighbours),) * 2)
    return connected_components(graph, directed=False)[1]


class Surface:
    """All bodies of a scene as they stand: what a picture asks of a face, in single precision.

    body (F + 1,), group (F + 1,), plane (F + 1, 4), colour (F + 1, 3) : by number of the face, of
    which 0 is none; plane · (x, -1) is the height of x over it
    """

    def __init__(self, meshes, faceBodies, colours):
        """faceBodies (F,) : the body of each face; colours (n, 3) : of the bodies, sRGB"""
        skins, self._skins = {}, []
        starts, start = [], 0
        for mesh in meshes:
            key = mesh.origVertices.tobytes(), mesh.faces.tobytes()
            if key not in skins:
                skins[key] = start, Skin(mesh.origVertices, mesh.faces)
                start += len(mesh.faces)
            starts.append(skins[key][0])
        kinds = [skin for _, skin in skins.values()]
        width = max(skin.rims.shape[1] for skin in kinds)
        self._smooth = np.concatenate([s.smooth.reshape(-1, 12) for s in kinds]).astype(np.float32)
        self._rims = np.zeros((start, width, 8), dtype=np.float32)
        first = 0
        for skin in kinds:
            self._rims[first : first + len(skin.rims), : skin.rims.shape[1]] = skin.rims
            first += len(skin.rims)
        self._rimCount = np.concatenate([s.rimCount for s in kinds])
        radius = np.concatenate([np.full(len(s.normal), s.radius) for s in kinds])
        firstFace = np.concatenate([[0], np.cumsum([len(m.faces) for m in meshes])[:-1]])
        self.row = np.arange(len(faceBodies)) - firstFace[faceBodies] + np.array(starts)[faceBodies]
        self._radius = radius.astype(np.float32)
        self.rotation = np.array([_matrix(m.orientation) for m in meshes])
        self.position = np.concatenate([m.position for m in meshes])
        normal = np.concatenate([s.normal for s in kinds])[self.row]
        offset = np.concatenate([s.offset for s in kinds])[self.row]
        normal = np.einsum("fij,fj->fi", self.rotation[faceBodies], normal)
        offset = offset + np.sum(normal * self.position[faceBodies], axis=1)
        self.plane = np.zeros((len(faceBodies) + 1, 4), dtype=np.float32)
        self.plane[1:] = np.column_stack([normal, offset])
        self.body = np.concatenate([[-1], faceBodies]).astype(np.int32)
        groups = np.concatenate([s.group for s in kinds])[self.row]
        most = int(groups.max()) + 1
        self.group = np.concatenate([[-1], faceBodies * most + groups]).astype(np.int32)
        self.albedo = np.concatenate([np.zeros((1, 3)), linear(colours)[faceBodies]])
        self.albedo = self.albedo.astype(np.float32)
        # what a face that is in the way sends back, roughly
        sky, _ = open_irradiance(self.plane[:, 1])
        sun = np.maximum(self.plane[:, :3] @ SUN, 0.0)[:, None] * SUN_LIGHT
        self.radiance = (self.albedo / math.pi * AROUND * (sky + sun)).astype(np.float32)
        self.rotation = self.rotation.astype(np.float32)
        self.position = self.position.astype(np.float32)

    def normals(self, number, x):
        """`(smooth, rounded)` unit normals (m, 3) at points x (m, 3) of the faces (m,)."""
        body, row = self.body[number], self.row[number - 1]
        R = self.rotation[body]
        rest = np.einsum("mji,mj->mi", R, x - self.position[body])
        table = self._smooth[row].reshape(-1, 3, 4)
        smooth = np.einsum("mij,mj->mi", table[:, :, :3], rest) + table[:, :, 3]
        smooth /= np.linalg.norm(smooth, axis=1, keepdims=True)
        rounded = smooth.copy()
        count = self._rimCount[row]
        for k in range(self._rims.shape[1]):
            some = np.flatnonzero(count > k)
            if len(some) == 0:
                break
            rim = self._rims[row[some], k]
            distance = rim[:, 3] - np.einsum("mi,mi->m", rim[:, :3], rest[some])
            near = np.clip(1.0 - distance / self._radius[row[some]], 0.0, 1.0)
            bent = np.flatnonzero(near > 0.0)
            some, share = some[bent], (0.5 * near[bent] ** 2)[:, None]
            rounded[some] += share * (rim[bent, 4:7] - smooth[some])
        rounded /= np.linalg.norm(rounded, axis=1, keepdims=True)
        return tuple(np.einsum("mij,mj->mi", R, n) for n in (smooth, rounded))


def _matrix(q):
    w, x, y, z = np.ravel(q)
    return [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]  # fmt: skip


# ---- A picture ----------------------------------------------------------------------------------


class Studio:
    """Shades a picture of which the numbers of faces are known.

    surface : `Surface`; maps : `rbs.facenumbers.LightMaps`; size : m, of the scene
    """

    def __init__(self, surface, maps, size, squareSide):
        self.surface, self.maps, self.size, self.side = surface, maps, size, squareSide

    def picture(self, numbers, camera, hasGround, isTransparent=False, progress=None):
        """The picture (height, width, 4), uint8, of `numbers` (s height, s width) of faces.

        camera : `rbs.facenumbers.Camera` of the numbers; s is SUPERSAMPLING
        """
        height, width = numbers.shape
        step = max(1, BAND_POINTS // width // CLASSES) * CLASSES
        bands = [(top, min(top + step, height)) for top in range(0, height, step)]

        def shade(band):
            return self._shade(numbers, camera, *band, hasGround, isTransparent)

        with ThreadPoolExecutor(2) as executor:
            rows = []
            for part in executor.map(shade, bands):
                rows.append(part)
                if progress:
                    progress(len(rows) / len(bands))
        return np.concatenate(rows)

    def _shade(self, numbers, camera, top, bottom, hasGround, isTransparent):
        """The rows of the picture between these of the numbers, averaged."""
        first, last = max(0, top - 1), min(len(numbers), bottom + CLASSES - 2)
        shape = last - first, numbers.shape[1]
        number = numbers[first:last].ravel()
        rays = camera.rays(first, last)
        isBody = number > 0
        plane = self.surface.plane[number]
        # the ground is the plane y = 0, where the ray goes down
        toGround = np.where(rays[:, 1] < -1e-6, -camera.eye[1] / np.minimum(rays[:, 1], -1e-6), 0.0)
        slope = np.einsum("mi,mi->m", plane[:, :3], rays)
        toPlane = (plane[:, 3] - plane[:, :3] @ camera.eye) / np.where(slope < 0, slope, -1.0)
        distance = np.where(isBody, toPlane, toGround).astype(np.float32)
        isGround = ~isBody & (distance > 0.0) & hasGround
        x = camera.eye + distance[:, None] * rays
        fade = np.where(isGround, self._fade(x, camera), 0.0)
        isGround &= fade < 1.0
        normal = np.zeros_like(x)
        normal[:, 1] = 1.0
        rounded = normal.copy()
        bodies = np.flatnonzero(isBody)
        normal[bodies], rounded[bodies] = self.surface.normals(number[bodies], x[bodies])

        some = np.flatnonzero(isBody | isGround)
        light = np.zeros((len(number), 5), dtype=np.float32)
        rows, columns = np.divmod(some, shape[1])
        kind = (rows + first) % CLASSES * CLASSES + columns % CLASSES
        for c in range(CLASSES**2):
            own = some[kind == c]
            light[own] = self._received(c, x[own], normal[own], self.surface.body[number[own]])
        key = np.where(isBody, self.surface.group[number], np.where(isGround, -2, -3))
        light = blurred(light.reshape(*shape, 5), key.reshape(shape))
        inner = slice(top - first, bottom - first)

        def cut(values):
            return values.reshape(*shape, -1)[inner].reshape((bottom - top) * shape[1], -1)

        part = Pixels(
            x=cut(x), ray=cut(rays), normal=cut(rounded), light=cut(light),
            isBody=cut(isBody)[:, 0], isGround=cut(isGround)[:, 0], fade=cut(fade),
            albedo=cut(self.surface.albedo[number]), distance=cut(distance)[:, 0],
        )
        seen = self._developed(part, camera, isTransparent)
        s = SUPERSAMPLING
        blocks = seen.reshape((bottom - top) // s, s, shape[1] // s, s, 4)
        opacity = blocks[..., 3:]
        weight = opacity.sum(axis=(1, 3))
        colour = (blocks[..., :3] * opacity).sum(axis=(1, 3)) / np.maximum(weight, 1e-6)
        mean = np.concatenate([colour, weight / s**2], axis=2)
        return np.rint(255.0 * mean).astype(np.uint8)

    def _received(self, c, x, normal, body):
        """(m, 5) for points of class c: shares of the sun and of the sky, and light from around."""
        result = np.zeros((len(x), 5), dtype=np.float32)
        stride = CLASSES**2
        suns = range(c, SUN_DIRECTIONS, stride)
        facing = np.flatnonzero(normal @ SUN > 0.0)
        for k in suns:
            blocker, index = self.maps.blockers("sun", k, x[facing], body[facing])
            lit = np.ones(len(facing), dtype=np.float32)
            lit[index] = 0.0
            result[facing, 0] += lit / len(suns)
        total = np.zeros(len(x), dtype=np.float32)
        open_ = np.zeros(len(x), dtype=np.float32)
        around = np.zeros((len(x), 3), dtype=np.float32)
        for k in range(c, SKY_DIRECTIONS, stride):
            weight = np.maximum(normal @ SKY[k].astype(np.float32), 0.0)
            total += weight
            facing = np.flatnonzero(weight > 0.0)
            blocker, index = self.maps.blockers("sky", k, x[facing], body[facing])
            index = facing[index]
            open_ += weight
            open_[index] -= weight[index]
            around[index] += weight[index, None] * self.surface.radiance[blocker]
        result[:, 1] = open_ / np.maximum(total, 1e-6)
        sky, below = open_irradiance(normal[:, 1])
        up = _UP_TABLE_INTERP(normal[:, 1])
        result[:, 2:] = around / np.maximum(total, 1e-6)[:, None] * up[:, None]
        onBody = np.flatnonzero((body >= 0) & (below > 0.02))
        if len(onBody):
            result[onBody, 2:] += self._from_below(c, x[onBody], normal[onBody], body[onBody]) * (
                below[onBody, None]
            )
        return result

    def _from_below(self, c, x, normal, body):
        """The mean radiance (m, 3) of what lies below the horizon of points on bodies."""
        total = np.full(len(x), 1e-6, dtype=np.float32)
        light = np.zeros((len(x), 3), dtype=np.float32)
        for k in range(c, GROUND_DIRECTIONS, CLASSES**2):
            d = BELOW[k].astype(np.float32)
            weight = np.maximum(normal @ d, 0.0)
            total += weight
            facing = np.flatnonzero(weight > 0.0)
            blocker, index = self.maps.blockers("below", k, x[facing], body[facing])
            ground = x[facing] - d * (x[facing, 1] / d[1])[:, None]
            shaded = self.maps.blockers("sun", 0, ground, np.full(len(facing), -1))[1]
            radiance = np.tile(SUNLIT_GROUND.astype(np.float32), (len(facing), 1))
            radiance[shaded] = SHADED_GROUND
            radiance[index] = self.surface.radiance[blocker]
            light[facing] += weight[facing, None] * radiance
        return light / total[:, None]

    def _fade(self, x, camera):
        """How far (m,) ground points have faded into the backdrop."""
        away = np.hypot(x[:, 0] - camera.target[0], x[:, 2] - camera.target[2]) / self.size
        place = np.clip((away - FADE_BEGIN) / (FADE_END - FADE_BEGIN), 0.0, 1.0)
        return 1.0 - (1.0 - place) ** 2

    def _developed(self, p, camera, isTransparent):
        """The pixels as seen, (m, 4) from 0 to 1."""
        n = p.normal
        albedo = np.where(p.isGround[:, None], GROUND * self._lines(p, camera)[:, None], p.albedo)
        cosine = np.maximum(n @ SUN, 0.0)
        sky, _ = open_irradiance(n[:, 1])
        sun = (cosine * p.light[:, 0])[:, None] * SUN_LIGHT
        received = sun + sky * p.light[:, 1:2] + p.light[:, 2:5]
        colour = albedo / math.pi * received
        # gloss: the sun's reflection, and the sky's, stronger at grazing angles
        towards = -p.ray
        half = towards + SUN
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        facing = np.clip(np.sum(n * towards, axis=1), 0.0, 1.0)
        fresnel = GLOSS + (1.0 - GLOSS) * (1.0 - facing) ** 5
        shine = np.maximum(np.sum(n * half, axis=1), 0.0) ** SHININESS
        shine *= GLOSS * (SHININESS + 8.0) / (8.0 * math.pi) * cosine * p.light[:, 0]
        mirrored = 2.0 * facing[:, None] * n - towards
        reflected = sky_radiance(mirrored[:, 1]) * p.light[:, 1:2]
        gloss = shine[:, None] * SUN_LIGHT + 0.5 * fresnel[:, None] * reflected
        colour = colour + np.where(p.isBody[:, None], gloss, 0.0)
        seen = encoded(filmic(colour))
        height = np.clip(p.ray[:, 1:2], 0.0, 0.6) / 0.6
        backdrop = (1.0 - height) * BACKDROP_LOW + height * BACKDROP_HIGH
        share = np.where(p.isBody[:, None], 0.0, np.where(p.isGround[:, None], p.fade, 1.0))
        opacity = np.ones((len(seen), 1))
        if isTransparent:
            full = SUN[1] * SUN_LIGHT + OPEN_SKY
            shade = 1.0 - encoded(filmic(GROUND / math.pi * received)) / encoded(
                filmic(GROUND / math.pi * full)
            )
            opacity = np.where(p.isBody[:, None], 1.0, shade.mean(axis=1, keepdims=True).clip(0, 1))
            opacity[~(p.isBody | p.isGround)] = 0.0
            seen = np.where(p.isBody[:, None], seen, 0.0)
            return np.concatenate([seen, opacity], axis=1)
        return np.concatenate([(1.0 - share) * seen + share * backdrop, opacity], axis=1)

    def _lines(self, p, camera):
        """What thin lines, `side` apart, leave of the ground's light, (m,)."""
        pixel = camera.pixelAngle * np.maximum(p.distance, 1e-6) / np.maximum(-p.ray[:, 1], 0.05)
        left = np.ones(len(p.x))
        for axis in (0, 2):
            place = p.x[:, axis] / self.side
            away = np.abs(place - np.round(place)) * self.side
            width = 0.012 * self.side
            cover = np.clip((width + 0.5 * pixel - away) / pixel, 0.0, 1.0) * np.minimum(
                1.0, 2.0 * width / pixel
            )
            left *= 1.0 - (1.0 - LINE) * cover
        return left


class Pixels:
    """Columns of some pixels: x, ray, normal, light, isBody, isGround, fade, albedo, distance."""

    def __init__(self, **columns):
        vars(self).update(columns)


_UP_TABLE = _irradiance_table(_FINE_SKY, np.ones((4096, 3)), _HEIGHTS)[:, 0]


def _UP_TABLE_INTERP(height):
    return np.interp(height, _HEIGHTS, _UP_TABLE).astype(np.float32)


def blurred(light, key):
    """The mean over CLASSES × CLASSES neighbours of the same key, (h, w, k)."""
    height, width = key.shape
    total = np.zeros_like(light)
    count = np.zeros((height, width), dtype=np.float32)
    reach = range(-1, CLASSES - 1)
    for dy in reach:
        for dx in reach:
            to = (slice(max(0, -dy), height - max(0, dy)), slice(max(0, -dx), width - max(0, dx)))
            of = (slice(max(0, dy), height + min(0, dy)), slice(max(0, dx), width + min(0, dx)))
            same = (key[to] == key[of]).astype(np.float32)
            total[to] += same[..., None] * light[of]
            count[to] += same
    return total / count[..., None]
