"""Numbers of faces, drawn by Polyscope as flat colours: from the camera, and from the light.

Polyscope is imported inside the functions that use it.
"""

import math
from contextlib import contextmanager

import numpy as np

from rbs.colours import BACKGROUND

# Pixels along each side of the maps from the sky, from below, and from the sun.
MAP_SIZES = {"sky": 384, "below": 256, "sun": 768}
# Free rim of a map, in pixels: what lies beyond it is lit.
RIM = 4


class Camera:
    """Where the picture is seen from. eye, target (3,); rays(first, last) of its rows of pixels."""

    def __init__(self, width, height):
        import polyscope as ps

        view = ps.get_view_camera_parameters()
        self.eye = np.array(view.get_position(), dtype=np.float32)
        self.target = np.array(ps.get_view_center(), dtype=np.float32)
        axes = view.get_right_dir(), view.get_up_dir(), view.get_look_dir()
        self._axes = [np.array(axis, dtype=np.float32) for axis in axes]
        self._size = width, height
        self.pixelAngle = 2.0 * math.tan(math.radians(view.get_fov_vertical_deg()) / 2.0) / height

    def rays(self, first, last):
        """Unit vectors ((last - first) · width, 3) through the pixels of these rows."""
        width, height = self._size
        right, up, ahead = self._axes
        x = (np.arange(width) + 0.5 - width / 2.0) * self.pixelAngle
        y = (height / 2.0 - np.arange(first, last) - 0.5) * self.pixelAngle
        x, y = x.astype(np.float32), y.astype(np.float32)
        rays = ahead + x[None, :, None] * right + y[:, None, None] * up
        rays /= np.linalg.norm(rays, axis=2, keepdims=True)
        return rays.reshape(-1, 3)


def face_numbers(isFlipped=True):
    """The numbers (height, width) of the faces that are seen, from 1; 0 where there is none."""
    import polyscope as ps

    shot = ps.screenshot_to_buffer(transparent_bg=True, vertical_flip=isFlipped)
    number = shot[..., 0].astype(np.int32)
    number <<= 8
    number |= shot[..., 1]
    number <<= 8
    number |= shot[..., 2]
    return number


def number_colours(count):
    """The colours (F, 3) that stand for the numbers 1 to `count`."""
    number = np.arange(1, count + 1)
    return np.stack([number >> 16, number >> 8 & 255, number & 255], axis=1) / 255.0


class LightMaps:
    """For each light direction, which face the light meets first: orthographic maps of numbers.

    surface : `rbs.studio.Surface`; gap : m, by which a face has to lie before a point to shade it
    """

    def __init__(self, surface, gap):
        self.surface, self.gap = surface, gap
        self._maps = {}

    def draw(self, kind, directions, vertices, lengthScale, progress=None):
        """Draws the maps of these directions (n, 3), towards the light, in the present window."""
        import polyscope as ps

        size = MAP_SIZES[kind]
        ps.set_window_size(size, size)
        kept = []
        for direction in directions:
            up = np.eye(3)[np.abs(direction).argmin()]
            right = np.cross(up, direction)
            right /= np.linalg.norm(right)
            up = np.cross(direction, right)
            places = vertices @ np.stack([right, up, direction], axis=1)
            low, high = places.min(axis=0), places.max(axis=0)
            middle, half = (low + high) / 2.0, (high - low).max() / 2.0
            half *= size / (size - 2.0 * RIM)
            ps.set_vertical_fov_degrees(math.degrees(2.0 * math.atan(half / (2.0 * lengthScale))))
            centre = middle[0] * right + middle[1] * up + middle[2] * direction
            eye = centre + 1.2 * half * direction + 0.1 * lengthScale * direction
            matrix = np.eye(4)
            matrix[:3, :3] = right, up, direction
            matrix[:3, 3] = -matrix[:3, :3] @ eye
            ps.set_camera_view_matrix(matrix)
            number = face_numbers(isFlipped=False)
            scale = size / (2.0 * half)
            axes = (scale * np.stack([right, up], axis=1)).astype(np.float32)
            offset = (size / 2.0 - scale * middle[:2]).astype(np.float32)
            kept.append((number.ravel(), axes, offset))
            if progress:
                progress()
        self._maps[kind] = kept

    def blockers(self, kind, k, x, body):
        """What keeps the light of direction k from points x (m, 3): `(number (b,), index (b,))`.

        body (m,) : that the points are of, which does not shade them; index : of the points
        """
        number, axes, offset = self._maps[kind][k]
        size = MAP_SIZES[kind]
        place = x @ axes
        place += offset
        np.clip(place, 0.0, size - 1.0, out=place)
        place = place.astype(np.int32)
        met = number.take(place[:, 1] * size + place[:, 0])
        index = np.flatnonzero(met)
        met = met.take(index)
        other = self.surface.body.take(met) != body.take(index)
        index, met = index[other], met[other]
        plane = self.surface.plane.take(met, axis=0)
        height = np.einsum("mi,mi->m", plane[:, :3], x.take(index, axis=0))
        isBefore = plane[:, 3] - height > self.gap
        return met[isBefore], index[isBefore]


@contextmanager
def numbers_only(view, vertices, faces):
    """Within it, Polyscope draws nothing but the numbers of the bodies' faces."""
    import polyscope as ps

    with view.hidden():
        mesh = ps.register_surface_mesh(
            "numbers", vertices, faces, material="flat", back_face_policy="cull"
        )
        mesh.add_color_quantity(
            "numbers", number_colours(len(faces)), defined_on="faces", enabled=True
        )
        ps.set_background_color((0.0, 0.0, 0.0, 0.0))
        try:
            yield
        finally:
            ps.set_background_color((*BACKGROUND, 1.0))
            ps.remove_surface_mesh("numbers")
