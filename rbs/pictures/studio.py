"""Studio pictures: sky light, soft shadows and rounded edges, computed in NumPy.

Polyscope only draws the numbers of visible faces, as flat colours, from camera and lamps. A pixel
shows the point where its ray meets the plane of its face. Neighbouring pixels share the lamps of
the sky (`rbs.appearance.studiolight`); their light is then averaged over the same surface, and
their normals over the same body, which rounds its edges. Images are (..., height, width).
"""

import math
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import numpy as np
import polyscope as ps

from rbs.appearance.camera import main_boxes
from rbs.appearance.colours import BACKGROUND, linear, toned
from rbs.appearance.drawables import BOX_CORNERS
from rbs.appearance.studiolight import CREASE_COSINE, Faces, Light, gloss, shaded, unit
from rbs.geometry.triples import dot
from rbs.pictures.backends import CLOSED
from rbs.pictures.overlays import OVERLAYS
from rbs.pictures.view import FLOOR
from rbs.pictures.viewpoint import kept_camera, present_camera

# Numbers of samples of a pixel along each side.
SAMPLES = 2
# Side of a block of pixels that share the lamps. More is faster and coarser.
SHARED = 4
# Numbers of lamps for a still and for a frame of a video. Fewer leave streaks.
STILL_LAMPS = {"sky": 160, "below": 48, "sun": 16}
VIDEO_LAMPS = {"sky": 112, "below": 32, "sun": 10}
# Side of the maps of sky and ground in pixels; that of the sun's, as a fraction of the picture's
# width, and its bounds.
MAP_SIDE, SUN_MAP_FRACTION, SUN_MAP_SIDES = 128, 0.6, (512, 1536)
# Step factor of the sides of maps. Maps move by whole pixels, so that the shadows of resting bodies
# do not flicker in a video. More wastes resolution; less flickers more often.
MAP_GROWTH = 1.15
# Free margin of a map in pixels, beyond which everything is lit.
RIM = 4
# Least distance of a face in front of a point that it shades, as a fraction of the lit size. More
# lets light through at contacts.
LEAST_GAP = 2e-4
# Number of threads.
THREADS = 2
# Lines on the ground: factor of the reflectance, and width as a fraction of their distance.
LINE, LINE_WIDTH = 0.72, 0.024
# Displayed colour of the backdrop; range in which the ground fades into it, in sizes of the scene.
BACKDROP = np.array([0.90, 0.90, 0.897], dtype=np.float32)[:, None, None]
FADE_BEGIN, FADE_END = 0.8, 4.5
# Darkening of the picture's corners, twice as a fraction.
VIGNETTE = 0.20
# Distance of rays that meet nothing, in metres.
NOWHERE = 1e12
# Depth and half the side of the ground that hides what has sunk into it, in sizes of the scene.
# Less depth flickers where bodies rest.
HIDING_DEPTH, HIDING_REACH = 1e-4, 30.0


def take_studio(view, isStill):
    """Returns a SceneView in Polyscope's camera: (height, width, 3), uint8."""
    camera = present_camera()
    faces, numbers, overlay, light = drawn(view, STILL_LAMPS if isStill else VIDEO_LAMPS)
    samples, isOver = blocks(numbers), blocks(overlay != numbers)
    picture = antialiased(colours(samples[0], faces, light, camera, view), samples, faces)
    if isOver.any():
        colour = np.stack([blocks(overlay >> 8 * c & 255) for c in range(3)])
        picture += np.mean(isOver * (colour - picture[:, None]), axis=1)
    return np.rint(np.moveaxis(picture, 0, 2)).astype(np.uint8)


def drawn(view, counts):
    """Returns the Faces of a SceneView, their numbers in the picture, SAMPLES times as large, the
    same with overlays, which have the numbers of their colours, and the Light with its maps.

    counts : numbers of lamps
    """
    size, surface = ps.get_window_size(), view.surface
    corners, normals = surface.corners(view.vertices)
    faces = Faces(corners, normals, surface.bodyOfFace, linear(view.body_colours()))
    low, high = view.boxes()
    main = main_boxes(low, high)
    box = np.stack([low[main].min(axis=0), high[main].max(axis=0)])
    scale = float(np.linalg.norm(box[1] - box[0]))
    light = Light(faces, counts, LEAST_GAP * scale, view.simulation.settings.ground)
    with numbered(view, corners) as overlays:
        ps.set_window_size(*(SAMPLES * side for side in size))
        numbers = overlay = draw_numbers()
        if overlays:
            for one in overlays:
                one.set_enabled(True)
            overlay = draw_numbers()
            for one in overlays:
                one.set_enabled(False)
        # Polyscope draws only a range of its length scale, at angles above a minimum
        ps.set_length_scale(scale)
        ps.set_view_projection_mode("orthographic")
        side = int(np.clip(SUN_MAP_FRACTION * size[0], *SUN_MAP_SIDES))
        for lamps, pixels in ((light.sun, side), (light.around, MAP_SIDE)):
            ps.set_window_size(pixels, pixels)
            for lamp in lamps:
                draw_map(lamp, box, pixels)
    return faces, numbers, overlay, light


def blocks(image):
    """Splits an image into the samples of its pixels, (SAMPLES², height, width)."""
    return np.stack([image[k::SAMPLES, m::SAMPLES] for k in range(SAMPLES) for m in range(SAMPLES)])


@contextmanager
def numbered(view, corners):
    """Makes Polyscope draw only numbers of faces, in the `with` block; the ground is 0, and hides.

    Yields the structures that were drawn over bodies. Restores window and camera.
    """
    size = ps.get_window_size()
    scene = [one for one in map(ps.get_surface_mesh, ("bodies", *FLOOR)) if one.is_enabled()]
    names = filter(ps.has_curve_network, ("constraints", *OVERLAYS))
    overlays = [ps.get_curve_network(name) for name in names]
    with kept_camera() as camera:
        reach = HIDING_REACH * view.size
        x, _, z = camera.eye
        y = -HIDING_DEPTH * view.size if view.simulation.settings.ground else -NOWHERE
        ground = [[x - reach, y, z - reach], [x - reach, y, z + reach], [x + reach, y, z + reach]]
        ground += [ground[0], ground[2], [x + reach, y, z - reach]]
        vertices = np.concatenate([corners.reshape(-1, 3), ground])
        number = np.append(np.arange(1, len(corners) + 1), [0, 0])
        parts = np.stack([number & 255, number >> 8 & 255, number >> 16], axis=1) / 255.0
        indices = np.arange(len(vertices)).reshape(-1, 3)
        mesh = ps.register_surface_mesh("numbers", vertices, indices, **CLOSED)
        mesh.add_color_quantity("numbers", parts, defined_on="faces", enabled=True)
        ps.set_background_color((0.0, 0.0, 0.0, 0.0))
        for one in scene + overlays:
            one.set_enabled(False)
        try:
            yield overlays
        finally:
            for one in scene + overlays:
                one.set_enabled(True)
            ps.remove_surface_mesh("numbers")
            ps.set_background_color((*BACKGROUND, 1.0))
            ps.set_view_projection_mode("perspective")
            ps.set_length_scale(view.size)
            ps.set_window_size(*size)


def draw_numbers(isUpright=True):
    """Returns the numbers (height, width), int32, of the visible faces."""
    shot = ps.screenshot_to_buffer(transparent_bg=True, vertical_flip=isUpright)
    return shot.view("<i4")[..., 0] & 0xFFFFFF


def draw_map(lamp, box, size):
    """Draws the map of a lamp, orthographic. box : (2, 3), the lit region; size : side in pixels"""
    direction, scale = lamp.towards.astype(np.float64), float(np.linalg.norm(box[1] - box[0]))
    right = np.cross(np.eye(3)[np.abs(direction).argmin()], direction)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(direction, right), direction])
    places = np.where(BOX_CORNERS, box[1], box[0]) @ axes.T
    low, high = places.min(axis=0), places.max(axis=0)
    half = (high - low)[:2].max() / 2.0 * size / (size - 2.0 * RIM)
    half = MAP_GROWTH ** math.ceil(math.log(half, MAP_GROWTH))
    pixel = 2.0 * half / size
    # each map at another fraction of a pixel, so that their steps average out
    shift = np.modf(1000.0 * direction)[0]
    middle = pixel * (np.round((low + high) / 2.0 / pixel) + shift)
    matrix = np.eye(4)
    matrix[:3, :3] = axes
    matrix[:3, 3] = -middle[0], -middle[1], -(high[2] + 0.1 * scale)
    ps.set_camera_view_matrix(matrix)
    ps.set_vertical_fov_degrees(math.degrees(2.0 * math.atan(half / (2.0 * scale))))
    number = draw_numbers(isUpright=False)
    for edge in (number[0], number[-1], number[:, 0], number[:, -1]):
        edge[:] = 0
    toPixels = np.concatenate([axes[1::-1], -middle[1::-1, None]], axis=1) / pixel
    toPixels[:, 3] += size / 2.0
    lamp.set_map(number, toPixels)


def colours(number, faces, light, camera, view):
    """Returns the displayed colours (3, height, width), 0 to 255, of faces `number` at pixels."""
    height, width = number.shape
    row, column = np.indices(number.shape, dtype=np.float32) + np.float32(0.5 / SAMPLES)
    ray = camera.rays(row.ravel(), column.ravel(), (width, height)).reshape(3, height, width)
    eye, plane = camera.eye.astype(np.float32), faces.plane.take(number, axis=1)
    # the ground is only seen from above, and bodies only from outside
    distance = (plane[3] - dot(plane, eye)) / np.minimum(dot(plane, ray), -1e-9)
    distance[(distance <= 0.0) | (ray[1] >= 0.0) & (number == 0)] = NOWHERE
    x = eye[:, None, None] + distance * ray
    onGround, (middle, scale) = number == 0, view.groundPlace
    away = np.hypot(x[0] - np.float32(middle[0]), x[2] - np.float32(middle[2])) / scale
    faded = np.clip((away - FADE_BEGIN) / (FADE_END - FADE_BEGIN), 0.0, 1.0)
    clear = 1.0 - onGround * (faded if view.simulation.settings.ground else 1.0)
    normal, sunlight, skylight = light_of(number, x, clear > 0.0, faces, light)
    albedo = faces.albedo.take(faces.body.take(number), axis=1)
    pixel = camera.pixel_angle((width, height)) * distance[onGround] / view.squareSide
    albedo[:, onGround] *= ground_lines(x[:, onGround] / view.squareSide, ray[:, onGround], pixel)
    radiance = shaded(albedo, normal, sunlight, skylight)
    radiance += ~onGround * gloss(normal, ray, sunlight, skylight)
    colour = BACKDROP + clear**2 * (toned(radiance) - BACKDROP)
    corner = (row / height - 0.5) ** 2 + (column / width - 0.5) ** 2
    return 255.0 * colour * (1.0 - VIGNETTE * corner)


def light_of(number, x, isSeen, faces, light):
    """Returns rounded normals (3, height, width), and the light (height, width) of the sun and (3,
    height, width) of the sky, at points x of faces `number`. isSeen : which points matter
    """
    normal, body = faces.normals(number, x), faces.body.take(number)
    sunlight, skylight = np.zeros(number.shape, np.float32), np.zeros_like(x)

    def share(k):
        part = np.s_[..., k // SHARED :: SHARED, k % SHARED :: SHARED]
        some = isSeen[part]
        points = x[part][:, some], normal[part][:, some], body[part][some]
        skylight[part][:, some] = light.skylight(*points, k, SHARED**2)
        sunlight[part][some] = light.sunlight(*points)

    with ThreadPoolExecutor(THREADS) as executor:
        list(executor.map(share, range(SHARED**2)))
    flat = faces.plane[:3].take(number, axis=1)
    rounded, mean, count = np.zeros_like(x), np.zeros_like(x), np.zeros_like(sunlight)
    for near in zip(*map(around, (body, flat, normal, skylight)), strict=True):
        isSame = near[0] == body
        rounded += isSame * near[2]
        isSame &= dot(flat, near[1]) > CREASE_COSINE
        mean += isSame * near[3]
        count += isSame
    return unit(rounded), sunlight, mean / count


def around(image):
    """Yields an image (..., height, width) shifted by each place of a block of pixels."""
    height, width = image.shape[-2:]
    rim = [(0, 0)] * (image.ndim - 2) + [(1, SHARED - 2)] * 2
    wide = np.pad(image, rim, "edge")
    for row in range(SHARED):
        for column in range(SHARED):
            yield wide[..., row : row + height, column : column + width]


def ground_lines(x, ray, size):
    """Factor (m,) by which lines darken the ground. x (3, m), size (m,) : points, and a pixel at
    their distance, in squares
    """
    left, steep = np.ones(len(size), dtype=np.float32), np.maximum(-ray[1], 0.05)
    for axis, other in ((0, 2), (2, 0)):
        # a pixel covers more along the view than across
        pixel = size / np.hypot(ray[0], ray[2]) * (np.abs(ray[axis]) / steep + np.abs(ray[other]))
        away = np.abs(x[axis] - np.rint(x[axis]))
        cover = np.clip((0.5 * (LINE_WIDTH + pixel) - away) / pixel, 0.0, 1.0)
        left *= 1.0 - (1.0 - LINE) * cover * np.minimum(1.0, LINE_WIDTH / pixel)
    return left


def antialiased(colour, samples, faces):
    """Averages the samples of pixels; (3, height, width).

    colour : of the first samples. The others have that of the nearest pixel that shows the same
    surface.
    """
    total, (height, width) = colour.copy(), samples.shape[1:]
    flat = colour.reshape(3, -1)
    for number in samples[1:]:
        own = flat.copy()
        other = np.flatnonzero(~faces.are_alike(number, samples[0]))
        row, column = np.divmod(other, width)
        for dy in (-1, 0, 1):
            for dx in (-1, 0, 1):
                near = np.clip(row + dy, 0, height - 1) * width + np.clip(column + dx, 0, width - 1)
                isSame = faces.are_alike(number.take(other), samples[0].take(near))
                own[:, other[isSame]] = flat[:, near[isSame]]
        total += own.reshape(total.shape)
    return total / len(samples)
