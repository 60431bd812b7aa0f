"""Studio pictures: sky light, soft shadows and rounded edges, worked out in NumPy.

Polyscope draws numbers of faces only (`rbs.facenumbers`): from the camera, and from each of several
hundred directions of light. What a pixel shows is where its ray meets the plane of its face. Light
from a direction reaches that point unless the face that it meets first, which a map tells, is
another body's and lies before the point: there is nothing to bias, and nothing to trace.

Light is linear, in units in which white paper in the open is about 2; reflection is diffuse, with a
little gloss. Neighbouring samples share the directions, and a mean over samples of the same surface
mixes them. Arrays of points, vectors and colours are (3, m), in single precision.

From the top: the light of the studio; the light at a scene's points; pictures.
"""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from rbs.drawables import SUN, flatten_meshes
from rbs.facenumbers import (
    Camera,
    LightMaps,
    bodies_only,
    draw_numbers,
    draw_overlays,
    number_faces,
    samples,
)
from rbs.pictureoptions import SEEN_THROUGH
from rbs.skins import Surface, dot

# A picture is worked out so many times as large along each side, and averaged.
SUPERSAMPLING = 2
# Each of SHARED × SHARED neighbouring samples takes its share of the directions of light.
SHARED = 4
# Directions of a still and of a video's frame, multiples of SHARED²: fewer leave streaks.
STILL_DIRECTIONS = {"sky": 256, "below": 128, "sun": 32}
VIDEO_DIRECTIONS = {"sky": 128, "below": 64, "sun": 16}
# Sides of the maps in pixels; that of the sun is a fraction of the picture's width, within bounds.
MAP_SIDES = {"sky": 288, "below": 224}
SUN_MAP_FRACTION, SUN_MAP_SIDES = 0.7, (512, 1536)
# How far a face has to lie before a point to shade it, as a fraction of the size of what is lit.
LEAST_GAP = 2e-4
# Bodies further from those that are seen than so many times the picture's larger half cast no
# shadows: one that was flung away would leave the maps coarse. To find out, every SEEN_STEP-th
# sample is looked at.
REACH, SEEN_STEP = 3.0, 16
# Of the sun's disc: four times the real one's, for soft shadows.
SUN_ANGLE = math.radians(2.0)
# Irradiance of the sun, and radiance of the sky at the zenith and at the horizon.
SUN_LIGHT = 5.6 * np.array([1.0, 0.945, 0.86])
ZENITH, HORIZON = np.array([0.44, 0.54, 0.72]), np.array([0.58, 0.59, 0.60])
# Reflectance of the ground and, as a factor of it, of the lines on it; their width as a fraction of
# the distance between them.
GROUND, LINE, LINE_WIDTH = np.array([0.50, 0.483, 0.458]), 0.72, 0.024
# Of what a surface receives in the open, as a first guess of what it receives among others.
AROUND = 0.55
# Reflectance of a body's gloss seen head-on, and the sharpness of the sun's reflection.
GLOSS, SHININESS = 0.04, 64
# Cosines below this one between normal and camera count as this: else outlines would be white.
LEAST_FACING = 0.15
# What light is multiplied by before the tone curve: more is brighter and paler.
EXPOSURE = 0.60
# The backdrop as seen, at the horizon and from a ray's height of BACKDROP_HEIGHT on; and where the
# ground fades into it, in sizes of what is lit from what the camera looks at.
BACKDROP = np.array([[0.885, 0.882, 0.872], [0.76, 0.765, 0.77]])
BACKDROP_HEIGHT = 0.6
# How much darker the corners of the picture are than its middle.
VIGNETTE = 0.14
FADE_BEGIN, FADE_END = 0.8, 4.5
# Samples of the ground along each side, for the light that it sends up.
GROUND_SAMPLES = 128
# Samples that are shaded together, 200 bytes each, by each of so many threads.
BAND_SAMPLES, THREADS = 300_000, 2


# ---- The light of the studio --------------------------------------------------------------------


def hemisphere(count):
    """`count` directions (n, 3) of equal solid angle over the upper half space, on a spiral."""
    k = np.arange(count) + 0.5
    y, angle = k / count, k * math.pi * (3.0 - math.sqrt(5.0))
    across = np.sqrt(1.0 - y * y)
    return np.stack([across * np.cos(angle), y, across * np.sin(angle)], axis=1)


def sun_disc(count):
    """`count` directions (n, 3) towards the sun's disc, of equal solid angle."""
    k = np.arange(count) + 0.5
    radius, angle = np.sqrt(k / count), k * math.pi * (3.0 - math.sqrt(5.0))
    side = np.cross(SUN, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    x, y = (math.tan(0.5 * SUN_ANGLE) * radius * f(angle) for f in (np.cos, np.sin))
    towards = SUN + x[:, None] * side + y[:, None] * np.cross(side, SUN)
    return towards / np.linalg.norm(towards, axis=1, keepdims=True)


def directions(counts):
    """Directions of light by kind: dict of (n, 3), likewise of their numbers."""
    below = hemisphere(counts["below"]) * [1.0, -1.0, 1.0]
    return {"sky": hemisphere(counts["sky"]), "below": below, "sun": sun_disc(counts["sun"])}


def sky_radiance(height):
    """Radiance (n, 3) of the sky in directions of this sine of elevation (n,)."""
    share = np.sqrt(np.clip(height, 0.0, 1.0))[:, None]
    return (1.0 - share) * HORIZON + share * ZENITH


class ByHeight:
    """A table (k, n) of quantities over the y component, -1 to 1, of unit vectors."""

    def __init__(self, quantities):
        """quantities : function of heights (n,) that gives (n, k)"""
        self.table = quantities(np.linspace(-1.0, 1.0, 513)).T.astype(np.float32)

    def __call__(self, y):
        """The quantities (k, m) of vectors of which this is the y component, (m,)."""
        return self.table.take(((y + 1.0) * 256.0 + 0.5).astype(np.int32), axis=1, mode="clip")


def _open_irradiance(height):
    """What surfaces whose normals have these heights receive in the open: columns r, g, b of the
    sky, and of half spaces of radiance 1 above and below the horizon."""
    fine = hemisphere(4096)
    normal = np.stack([np.sqrt(1.0 - height**2), height, 0.0 * height], axis=1)
    each = 2.0 * math.pi / len(fine)
    above = np.maximum(normal @ fine.T, 0.0) * each
    below = np.maximum(normal @ (fine * [1.0, -1.0, 1.0]).T, 0.0) * each
    return np.column_stack([above @ sky_radiance(fine[:, 1]), above.sum(axis=1), below.sum(axis=1)])


def linear(colours):
    """Linear light of sRGB colours."""
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)


def seen(light):
    """sRGB colours of linear light, through the tone curve of the Academy Color Encoding System in
    Narkowicz's fit."""
    x = EXPOSURE * light
    x = np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1.0 / 2.4) - 0.055)


# `seen` as a table over light from 0 to MOST_LIGHT, all of which is white.
MOST_LIGHT, TONES = 12.0, 1 << 16
_TONE_TABLE = seen(np.arange(TONES) * MOST_LIGHT / TONES).astype(np.float32)
OPEN = ByHeight(_open_irradiance)
OPEN_SKY = OPEN.table[:3, -1]
# Radiance of the ground in the open and, as a first guess, near bodies.
OPEN_GROUND = GROUND / math.pi * (OPEN_SKY + SUN[1] * SUN_LIGHT)
# What polished surfaces mirror.
SURROUNDINGS = ByHeight(lambda y: np.where(y[:, None] < 0.0, OPEN_GROUND, sky_radiance(y)))


def toned(light):
    """`seen`, from a table."""
    place = (light * (TONES / MOST_LIGHT)).astype(np.int32)
    return _TONE_TABLE.take(place, mode="clip")


# ---- The light at a scene's points --------------------------------------------------------------


class SceneLight:
    """What light the points of a scene receive, as its bodies stand.

    surface : `Surface`; size : m, of what is lit
    """

    def __init__(self, surface, vertices, box, counts, sunMapSide, progress):
        """Draws maps, in place of what the window shows, for which `numbers` must be drawn.

        vertices (V, 3) : of all bodies; box (2, 3) : what is lit; counts : of directions, by kind
        progress : called with the fraction that is done
        """
        self.surface, self.size = surface, float(np.linalg.norm(box[1] - box[0]))
        self._directions = directions(counts)
        self._maps = LightMaps(surface, LEAST_GAP * self.size)
        drawn = 0

        def advance():
            nonlocal drawn
            drawn += 1
            progress(drawn / sum(counts.values()))

        for kind, towards in self._directions.items():
            side = MAP_SIDES.get(kind, sunMapSide)
            self._maps.draw(kind, towards, side, box, vertices, advance)
        # What bodies and ground send to each other is guessed at first.
        normal = surface.plane[:3]
        inTheOpen = np.array([[1.0, 1.0, 0.0, 0.0, 0.0]], dtype=np.float32).T
        self._sent = self._body_radiance(AROUND * irradiance(normal, inTheOpen))
        margin = 0.7 * (box[1, 1] - box[0, 1])
        self._low, self._high = box[0, [0, 2]] - margin, box[1, [0, 2]] + margin
        self._ground = self._ground_radiance()
        received = self.received(surface.centre, normal, surface.body)
        self._sent = self._body_radiance(irradiance(normal, received))

    def _body_radiance(self, received):
        """The mean radiance of each body as seen against each direction of light, dict by kind of
        lists of (3, n): a map does not tell which face is seen. received (3, F + 1) : by the faces
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
        """The light (3, GROUND_SAMPLES²) that the ground sends up, x by x in rows of z."""
        place = (np.arange(GROUND_SAMPLES) + 0.5) / GROUND_SAMPLES
        x, z = (a + place * (b - a) for a, b in zip(self._low, self._high, strict=True))
        points = np.zeros((3, GROUND_SAMPLES**2), dtype=np.float32)
        points[0], points[2] = np.tile(x, GROUND_SAMPLES), np.repeat(z, GROUND_SAMPLES)
        normal = np.zeros_like(points)
        normal[1] = 1.0
        received = self.received(points, normal, np.full(points.shape[1], -1))
        return (GROUND[:, None] / math.pi * irradiance(normal, received)).astype(np.float32)

    def received(self, x, normal, body, first=0, stride=1):
        """What points x (3, m) receive, (5, m): the shares of the sun and of the sky that they see,
        and the irradiance r, g, b from bodies and ground.

        normal (3, m) : unit; body (m,) : that they are of, -1 for the ground
        first, stride : take every stride-th direction, from the first on
        """
        result = np.zeros((5, x.shape[1]), dtype=np.float32)
        some = np.flatnonzero(dot(normal, SUN.astype(np.float32)) > 0.0)
        lit = np.ones(len(some), dtype=np.float32)
        suns = range(first, len(self._directions["sun"]), stride)
        points, bodies = x.take(some, axis=1), body.take(some)
        for k in suns:
            lit[self._maps.blockers("sun", k, points, bodies)[1]] -= 1.0 / len(suns)
        result[0, some] = lit

        irradiance = OPEN(normal[1])
        free, around, total = self._gathered("sky", x, normal, body, first, stride)
        result[1] = free / total
        result[2:] = around * (irradiance[3] / total)
        # hardly anything from below is seen by what faces up
        some = np.flatnonzero((body >= 0) & (irradiance[4] > 0.06))
        if len(some):
            x, normal, body = x.take(some, axis=1), normal.take(some, axis=1), body.take(some)
            _, around, total = self._gathered("below", x, normal, body, first, stride)
            result[2:, some] += around * (irradiance[4].take(some) / total)
        return result

    def _gathered(self, kind, x, normal, body, first, stride):
        """Sums over directions, each weighted by its cosine with the normal: of those in which
        nothing is in the way (m,), of the radiance from what is (3, m), and of all (m,)."""
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
        """Which sample (m,) of the ground is met from points x (3, m) in a direction downwards."""
        columns = []
        for axis, low, high in zip((0, 2), self._low, self._high, strict=True):
            place = x[axis] - (towards[axis] / towards[1]) * x[1]
            place = (place - low) * (GROUND_SAMPLES / (high - low))
            columns.append(np.clip(place, 0.0, GROUND_SAMPLES - 1.0).astype(np.int32))
        return columns[1] * GROUND_SAMPLES + columns[0]


# ---- Pictures -----------------------------------------------------------------------------------


class Studio:
    """Takes studio pictures, and keeps the light of a scene of which only the camera moves.

    light : the `SceneLight` of the last picture, or None
    """

    def __init__(self, counts):
        """counts : numbers of directions of light, by kind"""
        self._counts = counts
        self._skins, self._lit, self.light = {}, None, None

    def take(self, view, isTransparent=False, progress=lambda fraction: None):
        """What Polyscope's camera sees of a SceneView, (height, width, 3), or 4, uint8.

        isTransparent : whether there is nothing behind bodies and shadows
        progress : called with the fraction that is done
        """
        import polyscope as ps

        meshes = view.simulation.meshes
        vertices, faces, bodyOfFace = flatten_meshes(meshes)
        view.set_see_through(False)
        with bodies_only(view, vertices, faces) as (mesh, overlays):
            camera = Camera(SUPERSAMPLING)
            hidden = SEEN_THROUGH if view.isSeeThrough else 0.0
            overlay = draw_overlays(mesh, overlays, hidden, SUPERSAMPLING)
            number_faces(mesh, len(faces))
            numbers = np.empty((camera.height, camera.width), dtype=np.int32)
            for row, column in samples(SUPERSAMPLING):
                numbers[row::SUPERSAMPLING, column::SUPERSAMPLING] = draw_numbers()
            box = lit_box(meshes, vertices, bodyOfFace, numbers, camera)
            albedo = linear(view.body_colours())
            sunMapSide = int(np.clip(SUN_MAP_FRACTION * ps.get_window_size()[0], *SUN_MAP_SIDES))
            lit = (vertices.tobytes(), albedo.tobytes(), box.tobytes(), sunMapSide)
            if lit != self._lit:
                self.light = None  # the old one makes room
                surface = Surface(meshes, vertices, faces, bodyOfFace, albedo, self._skins)
                self.light = SceneLight(
                    surface, vertices, box, self._counts, sunMapSide,
                    lambda fraction: progress(0.4 * fraction),
                )  # fmt: skip
                self._lit = lit
        view.set_see_through(view.isSeeThrough)
        hasGround = "ground" in view.shown and not isTransparent
        shades = Shades(self.light, camera, numbers, view, hasGround, isTransparent)
        picture = shades.picture(lambda fraction: progress(0.4 + 0.6 * fraction))
        return picture if overlay is None else laid_over(overlay, picture)


def lit_box(meshes, vertices, bodyOfFace, numbers, camera):
    """Low and high corner (2, 3) of what the light is worked out for: all bodies, as far as they
    are near those that are seen. numbers : of the faces that the camera sees
    """
    first = np.cumsum([0] + [len(mesh.origVertices) for mesh in meshes[:-1]])
    low, high = np.minimum.reduceat(vertices, first), np.maximum.reduceat(vertices, first)
    number = numbers[::SEEN_STEP, ::SEEN_STEP]
    depth = (0.5 * (low + high) - camera.eye) @ camera.ahead
    depth = depth[bodyOfFace[number[number > 0] - 1]]
    depth = depth[depth > 0.0]
    if len(depth):
        # in steps, so that in a video the box does not move with every body
        depth = float(np.median(depth))
        reach = REACH * depth * camera.halfHeight * max(1.0, camera.width / camera.height)
        reach = 1.25 ** math.ceil(math.log(reach, 1.25))
        middle = reach / 8.0 * np.round((camera.eye + depth * camera.ahead) / (reach / 8.0))
        isNear = ((low < middle + reach) & (high > middle - reach)).all(axis=1)
        low = np.maximum(low[isNear], middle - reach)
        high = np.minimum(high[isNear], middle + reach)
    return np.stack([low.min(axis=0), high.max(axis=0)])


class Shades:
    """Shades a picture of which the numbers of faces are known."""

    def __init__(self, light, camera, numbers, view, hasGround, isTransparent):
        """light : `SceneLight`; numbers (height, width) : as the camera sees them, each
        SUPERSAMPLING times the picture's; view : `SceneView`, which knows where the ground is
        """
        self._light, self._camera, self._numbers = light, camera, numbers
        self._lineDistance, self._groundPlace = view.squareSide, view.groundPlace
        self._hasGround, self._isTransparent = hasGround, isTransparent

    def picture(self, progress):
        """The picture (height, width, 3), or 4, uint8."""
        height, width = self._numbers.shape
        step = max(1, BAND_SAMPLES // width // SHARED) * SHARED
        tops = range(0, height, step)
        rows = []
        with ThreadPoolExecutor(THREADS) as executor:
            for part in executor.map(self._rows, tops, (min(t + step, height) for t in tops)):
                rows.append(part)
                progress(len(rows) / len(tops))
        return np.concatenate(rows)

    def _rows(self, top, bottom):
        """The rows of the picture from these samples' rows, `top` to before `bottom`."""
        # beyond them, what the mean over neighbours reaches
        first, last = max(0, top - 1), min(len(self._numbers), bottom + SHARED - 2)
        width = self._numbers.shape[1]
        surface = self._light.surface
        number, ray, distance, fade = self._met(first, last)
        some = np.flatnonzero(fade < 1.0)
        rows, columns = np.divmod(some, width)
        own, towards = number.take(some), ray.take(some, axis=1)
        x = self._camera.eye[:, None] + distance.take(some) * towards
        normal = np.zeros_like(x)
        normal[1] = 1.0
        rounded = normal.copy()
        on = np.flatnonzero(own)
        detail = 2.0 * SUPERSAMPLING * self._camera.pixelAngle * distance.take(some.take(on))
        normal[:, on], rounded[:, on] = surface.normals(own.take(on), x.take(on, axis=1), detail)

        light = np.zeros((5, len(number)), dtype=np.float32)
        share = (rows + first) % SHARED * SHARED + columns % SHARED
        body = surface.body.take(own)
        for c in range(SHARED**2):
            those = np.flatnonzero(share == c)
            light[:, some[those]] = self._light.received(
                x.take(those, axis=1), normal.take(those, axis=1), body.take(those), c, SHARED**2
            )
        group = np.where(fade < 1.0, surface.group.take(number), -2)
        light = mixed(light.reshape(5, -1, width), group.reshape(-1, width)).reshape(5, -1)

        inner = slice((top - first) * width, (bottom - first) * width)
        wanted = np.flatnonzero((rows >= top - first) & (rows < bottom - first))
        some, own = some.take(wanted), own.take(wanted)
        parts = [a.take(wanted, axis=1) for a in (x, towards, rounded)]
        colour, opacity = self._backdrop(ray[1, inner])
        place = some - inner.start
        shown, opaque = self._shown(own, *parts, light.take(some, axis=1), distance.take(some))
        part = fade.take(some)
        colour[:, place] = (1.0 - part) * shown + part * colour[:, place]
        opacity[place] = opaque
        if not self._isTransparent:
            colour *= 1.0 - VIGNETTE * self._camera.corner_nearness(top, bottom)
        return self._averaged(colour, opacity, width)

    def _met(self, first, last):
        """What the rays of some rows meet: the number of a face (m,), or 0; ray (3, m); distance
        (m,); and how far it has faded into the backdrop (m,), 0 to 1."""
        camera, surface = self._camera, self._light.surface
        number, ray = self._numbers[first:last].ravel(), camera.rays(first, last)
        distance = np.full(len(number), np.inf, dtype=np.float32)
        if camera.eye[1] > 0.0 and (self._hasGround or self._isTransparent):
            down = np.flatnonzero(ray[1] < -1e-6)
            distance[down] = -camera.eye[1] / ray[1].take(down)
        on = np.flatnonzero(number)
        plane = surface.plane.take(number.take(on), axis=1)
        slope = np.minimum(dot(plane, ray.take(on, axis=1)), -1e-9)
        toFace = (plane[3] - dot(plane, camera.eye)) / slope
        if self._hasGround:  # which hides what has sunk into it
            isAbove = toFace < distance.take(on) + LEAST_GAP * self._light.size
            number[on[~isAbove]] = 0
            on, toFace = on[isAbove], toFace[isAbove]
        distance[on] = toFace
        middle, size = self._groundPlace
        away = np.hypot(*(distance * ray[k] + (camera.eye[k] - middle[k]) for k in (0, 2))) / size
        fade = np.clip((away - FADE_BEGIN) / (FADE_END - FADE_BEGIN), 0.0, 1.0)
        fade = 1.0 - (1.0 - fade) ** 2
        fade[on] = 0.0
        return number, ray, distance, fade

    def _backdrop(self, rise):
        """Colours (3, m) and opacity (m,) of what is behind all, seen along rays of this y (m,)."""
        if self._isTransparent:
            return np.zeros((3, len(rise)), np.float32), np.zeros(len(rise), np.float32)
        height = np.clip(rise / BACKDROP_HEIGHT, 0.0, 1.0)
        low, high = BACKDROP.astype(np.float32)[:, :, None]
        return (1.0 - height) * low + height * high, np.ones(len(rise), np.float32)

    def _shown(self, number, x, ray, normal, light, distance):
        """Colours (3, m) and opacity (m,) of what is lit so, as `SceneLight.received` has it."""
        onGround, onBody = (np.flatnonzero(isThat) for isThat in (number == 0, number > 0))
        received = irradiance(normal, light)
        albedo = self._light.surface.albedo.take(number, axis=1)
        albedo[:, onGround] = GROUND[:, None]
        opacity = np.ones(len(number), dtype=np.float32)
        if self._isTransparent:
            full = toned(OPEN_GROUND[:, None].astype(np.float32))
            dark = toned(albedo[:, onGround] / math.pi * received[:, onGround]) / full
            opacity[onGround] = 1.0 - np.minimum(dark.mean(axis=0), 1.0)
            albedo[:, onGround] = 0.0
        else:
            ground = (a.take(onGround, axis=-1) for a in (x, ray, distance))
            albedo[:, onGround] *= self._lines(*ground)
        colour = albedo / np.float32(math.pi) * received
        colour[:, onBody] += gloss(*(a.take(onBody, axis=1) for a in (normal, ray, light)))
        return toned(colour), opacity

    def _lines(self, x, ray, distance):
        """What the lines on the ground leave of its light, (m,)."""
        pixel = self._camera.pixelAngle * distance / np.maximum(-ray[1], 0.05) / self._lineDistance
        left = np.ones(len(distance), dtype=np.float32)
        for axis in (0, 2):
            place = x[axis] / self._lineDistance
            away = np.abs(place - np.rint(place))
            cover = np.clip((0.5 * (LINE_WIDTH + pixel) - away) / pixel, 0.0, 1.0)
            left *= 1.0 - (1.0 - LINE) * cover * np.minimum(1.0, LINE_WIDTH / pixel)
        return left

    def _averaged(self, colour, opacity, width):
        """Samples (3, m) and (m,), in rows of `width`, as rows of the picture."""
        s = SUPERSAMPLING
        shape = -1, s, width // s, s
        weight = opacity.reshape(shape).sum(axis=(1, 3))
        total = (colour * opacity).reshape(3, *shape).sum(axis=(2, 4)) / np.maximum(weight, 1e-6)
        if self._isTransparent:
            total = np.concatenate([total, weight[None] / s**2])
        return np.rint(255.0 * np.moveaxis(total, 0, 2)).astype(np.uint8, order="C")


def irradiance(normal, light):
    """What surfaces with these normals (3, m) receive, (3, m). light (5, m) : see `received`"""
    cosine = np.maximum(dot(normal, SUN.astype(np.float32)), 0.0)
    sun = SUN_LIGHT.astype(np.float32)[:, None] * (cosine * light[0])
    return sun + OPEN(normal[1])[:3] * light[1] + light[2:]


def gloss(normal, ray, light):
    """The light (3, m) that the surfaces of bodies mirror towards the camera, along -ray (3, m)."""
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


def mixed(light, group):
    """The mean (k, h, w) over SHARED × SHARED neighbours of the same group; group (h, w)."""
    _, height, width = light.shape
    total, count = np.zeros_like(light), np.zeros((height, width), dtype=np.float32)
    for dy in range(-1, SHARED - 1):
        for dx in range(-1, SHARED - 1):
            to = slice(max(0, -dy), height - max(0, dy)), slice(max(0, -dx), width - max(0, dx))
            of = slice(max(0, dy), height + min(0, dy)), slice(max(0, dx), width + min(0, dx))
            isSame = group[to] == group[of]
            count[to] += isSame
            total[(slice(None), *to)] += isSame * light[(slice(None), *of)]
    return total / count


def laid_over(upper, lower):
    """A picture with opacity over one with or without it, as many channels as the lower one."""
    above = upper[..., 3:].astype(np.float32) / 255.0
    if lower.shape[2] == 3:
        return np.rint(above * upper[..., :3] + (1.0 - above) * lower).astype(np.uint8)
    below = (1.0 - above) * (lower[..., 3:] / np.float32(255.0))
    colour = above * upper[..., :3] + below * lower[..., :3]
    colour /= np.maximum(above + below, 1e-6)
    return np.rint(np.concatenate([colour, 255.0 * (above + below)], axis=2)).astype(np.uint8)
