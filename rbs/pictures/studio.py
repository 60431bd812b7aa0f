"""Studio pictures: sky light, soft shadows and rounded edges, computed in NumPy.

Polyscope only draws the numbers of faces (`rbs.pictures.facenumbers`). A pixel shows the point
where its ray meets the plane of its face, or the ground; one that several surfaces share is split
into samples. Neighbouring pixels share the directions of light (`rbs.appearance.light`), and are
then averaged over the same surface. Finally, linear light becomes a colour. Arrays of points,
vectors and colours are (3, m), in single precision. Reading order: `Studio`; the lit region;
`Shades`. Units: metres.
"""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import polyscope as ps

from rbs.appearance.colours import linear, toned
from rbs.appearance.drawables import flatten_meshes
from rbs.appearance.light import GROUND, LEAST_GAP, OPEN_GROUND, SceneLight, gloss, irradiance
from rbs.appearance.pixels import laid_over
from rbs.appearance.skins import Surface
from rbs.geometry.triples import dot
from rbs.pictures import facenumbers

# Factor by which pictures are computed larger along each side and then averaged.
SUPERSAMPLING = 2
# Side of a block of pixels that share the directions of light. More is faster and coarser.
SHARED = 4
# Numbers of directions for a still and for a video frame, multiples of SHARED². Fewer leave
# streaks.
STILL_DIRECTIONS = {"sky": 192, "below": 96, "sun": 32}
VIDEO_DIRECTIONS = {"sky": 128, "below": 64, "sun": 16}
# Side of the sun's maps, as a fraction of the picture's width, and its bounds in pixels.
SUN_MAP_FRACTION, SUN_MAP_SIDES = 0.6, (512, 1536)
# Distance from the visible bodies beyond which bodies cast no shadows, as a multiple of the
# picture's larger half. More makes maps coarse if a body is flung away. Every SEEN_STEP-th pixel
# is tested.
REACH, SEEN_STEP = 3.0, 8
# Lines on the ground: factor of the reflectance, and width as a fraction of their distance.
LINE, LINE_WIDTH = 0.72, 0.024
# Displayed colours of the backdrop at the horizon and from a ray's height of BACKDROP_HEIGHT; range
# in which the ground fades into it, in sizes of the scene.
BACKDROP, BACKDROP_HEIGHT = np.array([[0.915, 0.913, 0.907], [0.78, 0.79, 0.805]]), 0.6
FADE_BEGIN, FADE_END = 0.8, 4.5
# Darkening of the picture's corners, 0 to 1.
VIGNETTE = 0.10
# Distance of rays that meet nothing, in metres.
NOWHERE = 1e12
# Number of pixels shaded together, and number of threads. More take more memory.
BAND_PIXELS, THREADS = 240_000, 2


class Studio:
    """Takes studio pictures, and reuses the light of a scene while only the camera moves.

    light : the `SceneLight` of the last picture, or None
    """

    def __init__(self, counts):
        """counts : numbers of directions of light, by kind"""
        self._counts = counts
        self._skins, self._lit, self.light = {}, None, None

    def take(self, view, isTransparent=False, progress=lambda fraction: None):
        """Returns a SceneView in Polyscope's camera: (height, width, 3), or 4, uint8.

        isTransparent : whether the background behind bodies and shadows is omitted
        progress : called with the completed fraction
        """
        meshes = view.simulation.meshes
        hasGround = "ground" in view.shown and not isTransparent
        vertices, faces, bodyOfFace = flatten_meshes(meshes)
        with facenumbers.bodies_only(view, vertices, faces) as (mesh, overlays):
            camera = facenumbers.Camera()
            overlay = facenumbers.draw_overlays(overlays, SUPERSAMPLING)
            facenumbers.number_faces(mesh, len(faces))
            with facenumbers.hiding_ground(view.size if hasGround else None):
                samples = facenumbers.samples(SUPERSAMPLING)
                numbers = np.stack([facenumbers.draw_numbers() for _ in samples])
            box = lit_box(meshes, vertices, bodyOfFace, numbers, camera)
            albedo = linear(view.body_colours())
            sunMapSide = int(np.clip(SUN_MAP_FRACTION * ps.get_window_size()[0], *SUN_MAP_SIDES))
            lit = (vertices.tobytes(), albedo.tobytes(), box.tobytes(), sunMapSide)
            if lit != self._lit:
                self.light = None  # frees the memory of the old one
                surface = Surface(meshes, vertices, faces, bodyOfFace, albedo, self._skins)
                gap = LEAST_GAP * float(np.linalg.norm(box[1] - box[0]))
                maps, region = facenumbers.LightMaps(surface, gap), (vertices, box)
                how = self._counts, sunMapSide, lambda done: progress(0.4 * done)
                self.light = SceneLight(surface, maps, *region, *how)
                self._lit = lit
        shades = Shades(self.light, camera, numbers, view, hasGround, isTransparent)
        picture = shades.picture(lambda fraction: progress(0.4 + 0.6 * fraction))
        return picture if overlay is None else laid_over(overlay, picture)


def lit_box(meshes, vertices, bodyOfFace, numbers, camera):
    """Corners (2, 3) of the lit region, the box around the bodies near the visible ones.

    vertices, bodyOfFace : from `flatten_meshes`; numbers, camera : as of `Shades`
    """
    first = np.cumsum([0] + [len(mesh.origVertices) for mesh in meshes[:-1]])
    low, high = np.minimum.reduceat(vertices, first), np.maximum.reduceat(vertices, first)
    number = numbers[0, ::SEEN_STEP, ::SEEN_STEP]
    depth = (0.5 * (low + high) - camera.eye) @ camera.ahead
    depth = depth[bodyOfFace[number[number > 0] - 1]]
    depth = depth[depth > 0.0]
    if len(depth):
        # in steps, so that the box does not follow every motion in a video
        depth = float(np.median(depth))
        reach = REACH * depth * camera.halfHeight * max(1.0, camera.width / camera.height)
        reach = 1.25 ** math.ceil(math.log(reach, 1.25))
        middle = reach / 8.0 * np.round((camera.eye + depth * camera.ahead) / (reach / 8.0))
        isNear = ((low < middle + reach) & (high > middle - reach)).all(axis=1)
        low = np.maximum(low[isNear], middle - reach)
        high = np.minimum(high[isNear], middle + reach)
    return np.stack([low.min(axis=0), high.max(axis=0)])


class Shades:
    """Shades a picture, given the numbers of its faces.

    A pixel whose samples show one surface is shaded once, at its middle if they show one face;
    others are split into their samples.
    """

    def __init__(self, light, camera, numbers, view, hasGround, isTransparent):
        """light : `SceneLight`; numbers : (SUPERSAMPLING², height, width); view : `SceneView`"""
        self._light, self._camera, self._numbers = light, camera, numbers.reshape(len(numbers), -1)
        self._lineDistance, self._groundPlace = view.squareSide, view.groundPlace
        self._hasGround, self._isTransparent = hasGround, isTransparent
        group = light.surface.group
        first = group.take(numbers[0])
        self._isSplit = np.zeros(first.size, dtype=bool)
        for others in self._numbers[1:]:
            self._isSplit |= group.take(others) != first.ravel()
        self._isWhole = (self._numbers == self._numbers[0]).all(axis=0)
        # light and group at the first sample of each pixel, with a rim for `_mixed`
        rim = (1, SHARED - 2), (1, SHARED - 2)
        self._group = np.pad(first, rim, constant_values=-2)
        self._received = np.zeros((5, *self._group.shape), dtype=np.float32)

    def picture(self, progress):
        """Returns the picture (height, width, 3), or 4, uint8."""
        height, width = self._camera.height, self._camera.width
        step = max(1, BAND_PIXELS // width)
        bands = [(top, min(top + step, height)) for top in range(0, height, step)]
        rows = []
        with ThreadPoolExecutor(THREADS) as executor:
            for k, _ in enumerate(executor.map(self._receive, bands)):
                progress(0.5 * (k + 1) / len(bands))
            for part in executor.map(self._rows, bands):
                rows.append(part)
                progress(0.5 + 0.5 * len(rows) / len(bands))
        return np.concatenate(rows)

    def _receive(self, band):
        """Finds the light at the pixels of a band of rows `(first, end)`."""
        pixels = np.arange(band[0] * self._camera.width, band[1] * self._camera.width)
        number, ray, distance, fade = self._met(pixels, 0)
        row, column = self._places(pixels)
        share = 8 * (row // 2 % 2) + 4 * (column // 2 % 2) + 2 * (row % 2) + column % 2
        share[fade == 1.0] = -1
        for c in range(SHARED**2):
            those = np.flatnonzero(share == c)
            parts = number.take(those), ray.take(those, axis=1), distance.take(those)
            x, normal, _ = self._surface_at(*parts)
            body = self._light.surface.body.take(parts[0])
            received = self._light.received(x, normal, body, c, SHARED**2)
            self._received[:, row.take(those) + 1, column.take(those) + 1] = received

    def _rows(self, band):
        """Returns the picture's rows of a band `(first, end)`."""
        first, end = (row * self._camera.width for row in band)
        split = first + np.flatnonzero(self._isSplit[first:end])
        count = len(self._numbers)
        pixels = np.concatenate([np.arange(first, end), np.tile(split, count - 1)])
        sample = np.concatenate(
            [np.zeros(end - first, int), np.arange(1, count).repeat(len(split))]
        )
        number, ray, distance, fade = self._met(pixels, sample)
        some = np.flatnonzero(fade < 1.0)
        parts = number.take(some), ray.take(some, axis=1), distance.take(some)
        x, normal, rounded = self._surface_at(*parts)
        light = self._mixed(pixels.take(some), parts[0], x, normal)
        colour, opacity = self._backdrop(ray[1])
        shown, opaque = self._shown(x, rounded, light, *parts)
        part = fade.take(some)
        colour[:, some] = (1.0 - part) * shown + part * colour[:, some]
        opacity[some] = opaque
        if not self._isTransparent:
            colour *= 1.0 - VIGNETTE * self._camera.corner_nearness(*self._places(pixels))
        return self._averaged(colour, opacity, split - first)

    def _places(self, pixels):
        """Row and column of pixels, flat indices."""
        return np.divmod(pixels, self._camera.width)

    def _met(self, pixels, sample):
        """Intersects rays: `(number (m,), ray (3, m), distance (m,), fade (m,))`.

        pixels (m,) : flat indices; sample : of split pixels, one number or (m,)

        number is 0 if there is no face; fade is the part of the backdrop, 0 to 1.
        """
        camera, surface = self._camera, self._light.surface
        number, isWhole = self._numbers[sample, pixels], self._isWhole.take(pixels)
        within = ((one + 0.5) / SUPERSAMPLING for one in np.divmod(sample, SUPERSAMPLING))
        places = zip(self._places(pixels), within, strict=True)
        ray = camera.rays(*(place + np.where(isWhole, 0.5, one) for place, one in places))
        distance = np.full(len(number), NOWHERE, dtype=np.float32)
        if camera.eye[1] > 0.0 and (self._hasGround or self._isTransparent):
            down = np.flatnonzero(ray[1] < -1e-6)
            distance[down] = -camera.eye[1] / ray[1].take(down)
        on = np.flatnonzero(number)
        plane = surface.plane.take(number.take(on), axis=1)
        slope = np.minimum(dot(plane, ray.take(on, axis=1)), -1e-9)
        distance[on] = (plane[3] - dot(plane, camera.eye)) / slope
        middle, size = self._groundPlace
        away = np.hypot(*(distance * ray[k] + (camera.eye[k] - middle[k]) for k in (0, 2))) / size
        fade = np.clip((away - FADE_BEGIN) / (FADE_END - FADE_BEGIN), 0.0, 1.0)
        fade = 1.0 - (1.0 - fade) ** 2
        fade[on] = 0.0
        return number, ray, distance, fade

    def _surface_at(self, number, ray, distance):
        """Points, and their normals with sharp and with rounded edges, each (3, m)."""
        x = self._camera.eye[:, None] + distance * ray
        normal = np.zeros_like(x)
        normal[1] = 1.0
        rounded = normal.copy()
        on = np.flatnonzero(number)
        detail = 2.0 * self._camera.pixelAngle * distance.take(on)
        own = number.take(on), x.take(on, axis=1), detail
        normal[:, on], rounded[:, on] = self._light.surface.normals(*own)
        return x, normal, rounded

    def _mixed(self, pixels, number, x, normal):
        """Light (5, m): the mean over neighbouring pixels that show the same surface.

        It is that of SHARED × SHARED pixels, and of the sun of 2 × 2, for sharp shadows.
        """
        surface, width = self._light.surface, self._group.shape[1]
        own, group = surface.group.take(number), self._group.ravel()
        row, column = self._places(pixels)
        place = (row + 1) * width + column + 1
        light = self._received.reshape(5, -1)
        total, count = (np.zeros((rows, len(own)), dtype=np.float32) for rows in (5, 2))
        for dy in range(-1, SHARED - 1):
            for dx in range(-1, SHARED - 1):
                near = place + (dy * width + dx)
                same = (group.take(near) == own).astype(np.float32)
                isSunny = 0 <= dx < 2 and 0 <= dy < 2
                count[not isSunny :] += same
                for c in range(not isSunny, 5):
                    total[c] += same * light[c].take(near)
        total[0] /= np.maximum(count[0], 1.0)
        total[1:] /= np.maximum(count[1], 1.0)
        few = np.flatnonzero((count[0] < 1.0) | (count[1] < SHARED))
        points = (a.take(few, axis=1) for a in (x, normal))
        total[:, few] = self._light.received(
            *points, surface.body.take(number.take(few)), 0, SHARED
        )
        return total

    def _backdrop(self, rise):
        """Colours (3, m) and opacity (m,) of the backdrop, for rays with this y (m,)."""
        if self._isTransparent:
            return np.zeros((3, len(rise)), np.float32), np.zeros(len(rise), np.float32)
        height = np.clip(rise / BACKDROP_HEIGHT, 0.0, 1.0)
        low, high = BACKDROP.astype(np.float32)[:, :, None]
        return (1.0 - height) * low + height * high, np.ones(len(rise), np.float32)

    def _shown(self, x, normal, light, number, ray, distance):
        """Colours (3, m) and opacity (m,) of surfaces in this light, see `SceneLight.received`."""
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
        """Factor (m,) by which lines darken the ground."""
        size = self._camera.pixelAngle * distance / self._lineDistance / np.hypot(ray[0], ray[2])
        steep = np.maximum(-ray[1], 0.05)
        left = np.ones(len(distance), dtype=np.float32)
        for axis, other in ((0, 2), (2, 0)):
            # a pixel covers more along the view than across
            pixel = size * (np.abs(ray[axis]) / steep + np.abs(ray[other]))
            place = x[axis] / self._lineDistance
            away = np.abs(place - np.rint(place))
            cover = np.clip((0.5 * (LINE_WIDTH + pixel) - away) / pixel, 0.0, 1.0)
            left *= 1.0 - (1.0 - LINE) * cover * np.minimum(1.0, LINE_WIDTH / pixel)
        return left

    def _averaged(self, colour, opacity, split):
        """Averages the samples of split pixels: rows of the picture, uint8.

        colour (3, m), opacity (m,) : of all pixels, and then of the other samples of split ones
        """
        colour *= opacity
        width = self._camera.width
        every = np.concatenate([colour, opacity[None]])
        mean = every[:, : len(opacity) - (len(self._numbers) - 1) * len(split)]
        others = every[:, mean.shape[1] :].reshape(4, len(self._numbers) - 1, -1).sum(axis=1)
        mean[:, split] = (mean[:, split] + others) / len(self._numbers)
        mean[:3] /= np.maximum(mean[3], 1e-6)
        picture = mean[: 4 if self._isTransparent else 3].reshape(-1, mean.shape[1] // width, width)
        return np.rint(255.0 * np.moveaxis(picture, 0, 2)).astype(np.uint8, order="C")
