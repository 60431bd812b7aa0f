"""Numbers of visible faces, which Polyscope draws as flat colours, from camera and light.

Reading order: drawing numbers; the overlays; the camera; the maps of the faces that light meets
first. Arrays of points are (3, m), in single precision. Units: metres.
"""

import math
from contextlib import contextmanager

import numpy as np
import polyscope as ps

from rbs.appearance.colours import BACKGROUND
from rbs.appearance.drawables import BOX_CORNERS
from rbs.geometry.triples import dot
from rbs.pictures.backends import CLOSED
from rbs.pictures.cameras import kept_camera

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
GROUND_DEPTH, GROUND_REACH = 1e-4, 30.0


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
    x, _, z = ps.get_view_camera_parameters().get_position()
    corners = np.array([[-1, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1]]) * GROUND_REACH * size
    corners += [x, -GROUND_DEPTH * size, z]
    ps.register_surface_mesh("hiding", corners, np.array([[0, 1, 2], [0, 2, 3]]), **BLACK)
    yield
    ps.remove_surface_mesh("hiding")


def samples(factor):
    """Turns the camera to each of factor² samples per pixel in turn; yields row, column."""
    matrix, camera = ps.get_camera_view_matrix(), Camera()
    for row in range(factor):
        for column in range(factor):
            shear = np.eye(4)
            shear[0, 2] = ((column + 0.5) / factor - 0.5) * camera.pixelAngle
            shear[1, 2] = (0.5 - (row + 0.5) / factor) * camera.pixelAngle
            ps.set_camera_view_matrix(shear @ matrix)
            yield row, column
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


class Camera:
    """Polyscope's camera.

    eye, ahead (3,) : position and viewing direction; axes (3, 3) : rows to the right, up and ahead
    width, height : of the picture; halfHeight : tangent of half the vertical field of view
    pixelAngle : tangent of a pixel's angle
    """

    def __init__(self):
        view = ps.get_view_camera_parameters()
        self.eye = np.array(view.get_position(), dtype=np.float32)
        axes = view.get_right_dir(), view.get_up_dir(), view.get_look_dir()
        self.axes = np.array(axes, dtype=np.float32)
        self.ahead = self.axes[2]
        self.width, self.height = ps.get_window_size()
        self.halfHeight = math.tan(math.radians(view.get_fov_vertical_deg()) / 2.0)
        self.pixelAngle = 2.0 * self.halfHeight / self.height

    def rays(self, row, column):
        """Unit vectors (3, m) through places (m,) of the picture; a pixel's middle is at 0.5."""
        right, up, ahead = self.axes[:, :, None]
        x = ((column - self.width / 2.0) * self.pixelAngle).astype(np.float32)
        y = ((self.height / 2.0 - row) * self.pixelAngle).astype(np.float32)
        rays = ahead + x * right + y * up
        rays /= np.sqrt(dot(rays, rays))
        return rays

    def corner_nearness(self, row, column):
        """Squared distances (m,) of pixels from the middle; 1 at the corners."""
        x, y = (column + 0.5) / self.width - 0.5, (row + 0.5) / self.height - 0.5
        return (2.0 * (x**2 + y**2)).astype(np.float32)


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
