"""Studio pictures: sky light, soft shadows and rounded edges, computed in NumPy.

Polyscope only draws the numbers of visible faces, as flat colours, from camera and light. A pixel
shows the point where its ray meets the plane of its face, or the ground; one that several surfaces
share is split into samples. Neighbouring pixels share the directions of light
(`rbs.appearance.studiolight`), and are then averaged over the same surface. Finally, linear light
becomes a colour. Arrays of points, vectors and colours are (3, m), in single precision. Reading
order: `Studio`; the lit region; `Shades`; drawing numbers; overlays; `LightMaps`. Units: metres.
"""

import math
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import numpy as np
import polyscope as ps
from tqdm import tqdm

from rbs.appearance.colours import BACKGROUND, linear, toned
from rbs.appearance.drawables import BOX_CORNERS, flatten_meshes
from rbs.appearance.pixels import laid_over
from rbs.appearance.studiolight import (
    GROUND,
    LEAST_GAP,
    SceneLight,
    Surface,
    gloss,
    irradiance,
)
from rbs.geometry.triples import dot
from rbs.pictures.backends import CLOSED
from rbs.pictures.viewpoint import kept_camera, present_camera

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
# Options of a surface that hides others.
BLACK = CLOSED | {"color": (0.0, 0.0, 0.0)}
# Free margin of a map in pixels, beyond which everything is lit.
RIM = 3
# Step factor of the sides of maps. Maps move by whole pixels, so that the shadows of resting bodies
# do not flicker in a video. More wastes resolution; less flickers more often.
MAP_GROWTH = 1.15
# Shift from map to map in pixels; its multiples fill a pixel evenly.
MAP_SHIFT = np.array([0.7548776662, 0.5698402910])
# Depth and half the side of the ground that hides what has sunk into it, in sizes of the scene.
# Less depth flickers where bodies rest.
HIDING_DEPTH, HIDING_REACH = 1e-4, 30.0


class Studio:
    """Takes studio pictures, and reuses the light of a scene while only the camera moves.

    framesAnew : whether each still gets its own camera, which shows the whole scene
    light : the `SceneLight` of the last picture, or None
    """

    def __init__(self, framesAnew=False):
        self.framesAnew = framesAnew
        self._skins, self._lit, self.light = {}, None, None

    def take(self, view, isStill=True):
        """Returns a SceneView in Polyscope's camera: (height, width, 3), uint8.

        isStill : whether it may take longer than a frame of a video
        """
        if not isStill:
            return self._take(view, VIDEO_DIRECTIONS, lambda fraction: None)
        with tqdm(total=100, desc="picture", unit="%", leave=False, disable=None) as bar:
            report = lambda fraction: bar.update(round(100.0 * fraction) - bar.n)  # noqa: E731
            return self._take(view, STILL_DIRECTIONS, report)

    def _take(self, view, counts, progress):
        meshes, hasGround = view.simulation.meshes, "ground" in view.shown
        vertices, faces, bodyOfFace = flatten_meshes(meshes)
        with bodies_only(view, vertices, faces) as (mesh, overlays):
            camera, size = present_camera(), ps.get_window_size()
            overlay = draw_overlays(overlays, SUPERSAMPLING)
            number_faces(mesh, len(faces))
            with hiding_ground(view.size if hasGround else None):
                numbers = np.stack([draw_numbers() for _ in samples(SUPERSAMPLING)])
            box = lit_box(meshes, vertices, bodyOfFace, numbers, camera)
            albedo = linear(view.body_colours())
            sunMapSide = int(np.clip(SUN_MAP_FRACTION * size[0], *SUN_MAP_SIDES))
            lit = (vertices.tobytes(), albedo.tobytes(), box.tobytes(), sunMapSide, counts)
            if lit != self._lit:
                self.light = None  # frees the memory of the old one
                surface = Surface(meshes, vertices, faces, bodyOfFace, albedo, self._skins)
                gap = LEAST_GAP * float(np.linalg.norm(box[1] - box[0]))
                maps, region = LightMaps(surface, gap), (vertices, box)
                how = counts, sunMapSide, lambda done: progress(0.4 * done)
                self.light = SceneLight(surface, maps, *region, *how)
                self._lit = lit
        shades = Shades(self.light, camera, numbers, view, hasGround)
        picture = shades.picture(lambda fraction: progress(0.4 + 0.6 * fraction))
        return picture if overlay is None else laid_over(overlay, picture)


def lit_box(meshes, vertices, bodyOfFace, numbers, camera):
    """Corners (2, 3) of the lit region, the box around the bodies near the visible ones.

    vertices, bodyOfFace : from `flatten_meshes`; numbers, camera : as of `Shades`
    """
    first = np.cumsum([0] + [len(mesh.origVertices) for mesh in meshes[:-1]])
    low, high = np.minimum.reduceat(vertices, first), np.maximum.reduceat(vertices, first)
    number = numbers[0, ::SEEN_STEP, ::SEEN_STEP]
    depth = camera.depths(0.5 * (low + high))
    depth = depth[bodyOfFace[number[number > 0] - 1]]
    depth = depth[depth > 0.0]
    if len(depth):
        # in steps, so that the box does not follow every motion in a video
        depth = float(np.median(depth))
        height, width = numbers.shape[1:]
        reach = REACH * depth * camera.halfHeight * max(1.0, width / height)
        reach = 1.25 ** math.ceil(math.log(reach, 1.25))
        middle = reach / 8.0 * np.round((camera.eye + depth * camera.axes[2]) / (reach / 8.0))
        isNear = ((low < middle + reach) & (high > middle - reach)).all(axis=1)
        low = np.maximum(low[isNear], middle - reach)
        high = np.minimum(high[isNear], middle + reach)
    return np.stack([low.min(axis=0), high.max(axis=0)])


class Shades:
    """Shades a picture, given the numbers of its faces.

    A pixel whose samples show one surface is shaded once, at its middle if they show one face;
    others are split into their samples.
    """

    def __init__(self, light, camera, numbers, view, hasGround):
        """light : `SceneLight`; numbers : (SUPERSAMPLING², height, width); view : `SceneView`"""
        self._light, self._numbers = light, numbers.reshape(len(numbers), -1)
        self._camera, self._eye = camera, camera.eye.astype(np.float32)
        self._height, self._width = numbers.shape[1:]
        self._pixel = camera.pixel_angle((self._width, self._height))
        self._lineDistance, self._groundPlace = view.squareSide, view.groundPlace
        self._hasGround = hasGround
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
        """Returns the picture (height, width, 3), uint8."""
        height, width = self._height, self._width
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
        pixels = np.arange(band[0] * self._width, band[1] * self._width)
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
        first, end = (row * self._width for row in band)
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
        height = np.clip(ray[1] / BACKDROP_HEIGHT, 0.0, 1.0)
        low, high = BACKDROP.astype(np.float32)[:, :, None]
        colour, part = (1.0 - height) * low + height * high, fade.take(some)
        shown = self._shown(x, rounded, light, *parts)
        colour[:, some] = (1.0 - part) * shown + part * colour[:, some]
        row, column = self._places(pixels)
        x, y = (column + 0.5) / self._width - 0.5, (row + 0.5) / self._height - 0.5
        colour *= 1.0 - VIGNETTE * (2.0 * (x**2 + y**2)).astype(np.float32)
        return self._averaged(colour, split - first)

    def _places(self, pixels):
        """Row and column of pixels, flat indices."""
        return np.divmod(pixels, self._width)

    def _met(self, pixels, sample):
        """Intersects rays: `(number (m,), ray (3, m), distance (m,), fade (m,))`.

        pixels (m,) : flat indices; sample : of split pixels, one number or (m,)

        number is 0 if there is no face; fade is the part of the backdrop, 0 to 1.
        """
        eye, surface = self._eye, self._light.surface
        number, isWhole = self._numbers[sample, pixels], self._isWhole.take(pixels)
        within = ((one + 0.5) / SUPERSAMPLING for one in np.divmod(sample, SUPERSAMPLING))
        places = zip(self._places(pixels), within, strict=True)
        places = (place + np.where(isWhole, 0.5, one) for place, one in places)
        ray = self._camera.rays(*places, (self._width, self._height))
        distance = np.full(len(number), NOWHERE, dtype=np.float32)
        if eye[1] > 0.0 and self._hasGround:
            down = np.flatnonzero(ray[1] < -1e-6)
            distance[down] = -eye[1] / ray[1].take(down)
        on = np.flatnonzero(number)
        plane = surface.plane.take(number.take(on), axis=1)
        slope = np.minimum(dot(plane, ray.take(on, axis=1)), -1e-9)
        distance[on] = (plane[3] - dot(plane, eye)) / slope
        middle, size = self._groundPlace
        away = np.hypot(*(distance * ray[k] + (eye[k] - middle[k]) for k in (0, 2))) / size
        fade = np.clip((away - FADE_BEGIN) / (FADE_END - FADE_BEGIN), 0.0, 1.0)
        fade = 1.0 - (1.0 - fade) ** 2
        fade[on] = 0.0
        return number, ray, distance, fade

    def _surface_at(self, number, ray, distance):
        """Points, and their normals with sharp and with rounded edges, each (3, m)."""
        x = self._eye[:, None] + distance * ray
        normal = np.zeros_like(x)
        normal[1] = 1.0
        rounded = normal.copy()
        on = np.flatnonzero(number)
        detail = 2.0 * self._pixel * distance.take(on)
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

    def _shown(self, x, normal, light, number, ray, distance):
        """Colours (3, m) of surfaces in this light, see `SceneLight.received`."""
        onGround, onBody = (np.flatnonzero(isThat) for isThat in (number == 0, number > 0))
        albedo = self._light.surface.albedo.take(number, axis=1)
        ground = (a.take(onGround, axis=-1) for a in (x, ray, distance))
        albedo[:, onGround] = GROUND[:, None] * self._lines(*ground)
        colour = albedo / np.float32(math.pi) * irradiance(normal, light)
        colour[:, onBody] += gloss(*(a.take(onBody, axis=1) for a in (normal, ray, light)))
        return toned(colour)

    def _lines(self, x, ray, distance):
        """Factor (m,) by which lines darken the ground."""
        size = self._pixel * distance / self._lineDistance / np.hypot(ray[0], ray[2])
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

    def _averaged(self, colour, split):
        """Averages the samples of split pixels: rows of the picture, uint8.

        colour (3, m) : of all pixels, and then of the other samples of split ones
        """
        count = len(self._numbers)
        mean = colour[:, : colour.shape[1] - (count - 1) * len(split)]
        others = colour[:, mean.shape[1] :].reshape(3, count - 1, -1).sum(axis=1)
        mean[:, split] = (mean[:, split] + others) / count
        picture = mean.reshape(3, -1, self._width)
        return np.rint(255.0 * np.moveaxis(picture, 0, 2)).astype(np.uint8, order="C")


@contextmanager
def bodies_only(view, vertices, faces):
    """Makes Polyscope draw only the bodies of a SceneView, in black, in the `with` block.

    Yields their SurfaceMesh, and the structures that were drawn over them. Restores window and
    camera.
    """
    size = ps.get_window_size()
    with kept_camera(), view.hidden() as overlays:
        mesh = ps.register_surface_mesh("numbers", vertices, faces, **BLACK)
        ps.set_background_color((0.0, 0.0, 0.0, 0.0))
        try:
            yield mesh, overlays
        finally:
            ps.remove_surface_mesh("numbers")
            ps.set_background_color((*BACKGROUND, 1.0))
            ps.set_view_projection_mode("perspective")
            ps.set_length_scale(view.size)
            ps.set_window_size(*size)


@contextmanager
def hiding_ground(size):
    """Makes a black ground hide what is below it, in the `with` block.

    size : of the scene, in metres; None for no ground
    """
    if size is None:
        yield
        return
    x, _, z = present_camera().eye
    corners = np.array([[-1, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1]]) * HIDING_REACH * size
    corners += [x, -HIDING_DEPTH * size, z]
    ps.register_surface_mesh("hiding", corners, np.array([[0, 1, 2], [0, 2, 3]]), **BLACK)
    try:
        yield
    finally:
        ps.remove_surface_mesh("hiding")


def samples(factor):
    """Turns the camera to each of factor² samples per pixel in turn; yields row, column."""
    matrix, pixel = ps.get_camera_view_matrix(), present_camera().pixel_angle(ps.get_window_size())
    try:
        for row in range(factor):
            for column in range(factor):
                shear = np.eye(4)
                shear[0, 2] = ((column + 0.5) / factor - 0.5) * pixel
                shear[1, 2] = (0.5 - (row + 0.5) / factor) * pixel
                ps.set_camera_view_matrix(shear @ matrix)
                yield row, column
    finally:
        ps.set_camera_view_matrix(matrix)


def draw_overlays(overlays, factor):
    """Draws the overlays over black bodies: (height, width, 4), uint8, or None if there are none.

    factor : as for `samples`
    """
    if not overlays:
        return None
    width, height = ps.get_window_size()
    total = np.zeros((4, width * height), dtype=np.float32)
    for structure in overlays:
        structure.set_enabled(True)
    for _ in samples(factor):
        number = draw_numbers().ravel()  # of colours; bodies are black
        some = np.flatnonzero(number)
        number = number.take(some)
        total[3, some] += 255.0
        for c in range(3):
            total[c, some] += number >> 8 * c & 255
    for structure in overlays:
        structure.set_enabled(False)
    total[:3] *= 255.0 / np.maximum(total[3], 1.0)
    total[3] /= factor**2
    return np.rint(total.T).astype(np.uint8).reshape(height, width, 4)


def number_faces(mesh, count):
    """Colours the `count` faces of a SurfaceMesh with their numbers, from 1."""
    number = np.arange(1, count + 1)
    colours = np.stack([number & 255, number >> 8 & 255, number >> 16], axis=1) / 255.0
    mesh.add_color_quantity("numbers", colours, defined_on="faces", enabled=True)


def draw_numbers(isUpright=True):
    """Returns the numbers (height, width), int32, of the visible faces; 0 is no face.

    isUpright : whether the first row is the top one
    """
    shot = ps.screenshot_to_buffer(transparent_bg=True, vertical_flip=isUpright)
    return shot.view("<i4")[..., 0] & 0xFFFFFF


class LightMaps:
    """Orthographic maps of the faces that light meets first, for each direction of light."""

    def __init__(self, surface, gap):
        """surface : `Surface`; gap : m, least distance of a face in front of a shaded point"""
        self._surface, self._gap = surface, gap
        self._maps = {}
        self._numberType = np.min_scalar_type(len(surface.body))

    def draw(self, kind, directions, size, box, vertices, progress):
        """Draws maps of size × size pixels, stored as `kind`, instead of the window's content.

        directions : (n, 3), towards the light; box : (2, 3), corners of the region; vertices : (V,
            3), of all bodies; progress : called after each map
        """
        # Polyscope draws only a range of its length scale, at angles above a minimum
        scale = float(np.linalg.norm(box[1] - box[0]))
        ps.set_length_scale(scale)
        ps.set_view_projection_mode("orthographic")
        ps.set_window_size(size, size)
        corners = np.where(BOX_CORNERS, box[1], box[0])
        self._maps[kind] = []
        for k, direction in enumerate(directions):
            up = np.eye(3)[np.abs(direction).argmin()]
            right = np.cross(up, direction)
            right /= np.linalg.norm(right)
            axes = np.stack([right, np.cross(direction, right), direction])
            places = corners @ axes.T
            low, high = places.min(axis=0), places.max(axis=0)
            half = (high - low)[:2].max() / 2.0 * size / (size - 2.0 * RIM)
            half = MAP_GROWTH ** math.ceil(math.log(half, MAP_GROWTH))
            pixel = 2.0 * half / size
            # each map at another fraction of a pixel, so that their steps average out
            shift = *np.modf(k * MAP_SHIFT)[0], 0.0
            middle = pixel * (np.round((low + high) / 2.0 / pixel) + shift)
            top = min((vertices @ direction).max(), high[2] + 10.0 * scale)
            matrix = np.eye(4)
            matrix[:3, :3] = axes
            matrix[:3, 3] = -middle[0], -middle[1], -(top + 0.1 * scale)
            ps.set_camera_view_matrix(matrix)
            ps.set_vertical_fov_degrees(math.degrees(2.0 * math.atan(half / (2.0 * scale))))
            number = draw_numbers(isUpright=False).astype(self._numberType)
            for edge in (number[0], number[-1], number[:, 0], number[:, -1]):
                edge[:] = 0
            # maps a point to its row and column
            toPixels = np.concatenate([axes[1::-1], -middle[1::-1, None]], axis=1) / pixel
            toPixels[:, 3] += size / 2.0
            self._maps[kind].append((number.ravel(), size, toPixels.astype(np.float32)))
            progress()

    def blockers(self, kind, k, x, body):
        """Finds the faces that block light of direction k from points x (3, m) of the bodies (m,).

        Bodies are convex, so none shades itself. Returns `(number (b,), index (b,))`: blocking
        faces, and the points that they shade.
        """
        number, size, toPixels = self._maps[kind][k]
        row, column = (
            np.clip(dot(toPixel, x) + toPixel[3], 0.0, size - 1.0).astype(np.int32)
            for toPixel in toPixels
        )
        met = number.take(row * size + column)
        index = np.flatnonzero(met)
        met = met.take(index)
        other = np.flatnonzero(self._surface.body.take(met) != body.take(index))
        index, met = index.take(other), met.take(other)
        plane = self._surface.plane
        depth = plane[3].take(met)
        for i in range(3):
            depth -= plane[i].take(met) * x[i].take(index)
        isBefore = np.flatnonzero(depth > self._gap)
        return met.take(isBefore), index.take(isBefore)
