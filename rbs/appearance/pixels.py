"""Marks on top of a picture: lines, arrows and dots.

They are drawn with an ink: `PictureInk`, or that of the window. Its methods are line(begin, end,
colour), triangle(corners, colour) and dot(place, colour), in pixels of the window, from its upper
left corner.
"""

import numpy as np
from PIL import Image, ImageDraw

from rbs.appearance.camera import USUAL_HEIGHT

# Pixels: width of lines, radius of a dot, and greatest length of an arrow's head.
LINE_WIDTH, DOT_RADIUS, HEAD = 2.0, 4.0, 9.0
# Half the width of a head, relative to its length.
HEAD_WIDTH = 0.4


def draw_dot(ink, pixel, colour):
    """Draws a dot at a pixel (2,), unless it is behind the camera."""
    if np.isfinite(pixel).all():
        ink.dot(pixel.tolist(), colour)


def draw_lines(ink, ends, colour):
    """Draws lines between pixels (n, 2, 2), except those with an end behind the camera."""
    for begin, end in ends[np.isfinite(ends).all(axis=(1, 2))].tolist():
        ink.line(begin, end, colour)


def draw_arrows(ink, begins, ends, colour):
    """Draws arrows between pixels (n, 2), except those with an end behind the camera."""
    ways = ends - begins
    lengths = np.hypot(*ways.T)[:, None]
    heads = np.minimum(ink.scale * HEAD, 0.5 * lengths) * ways / np.maximum(lengths, 1e-9)
    across = HEAD_WIDTH * heads[:, ::-1] * [-1.0, 1.0]
    draw_lines(ink, np.stack([begins, ends - heads], axis=1), colour)
    corners = np.stack([ends, ends - heads + across, ends - heads - across], axis=1)
    for triangle in corners[np.isfinite(corners).all(axis=(1, 2))].tolist():
        ink.triangle(triangle, colour)


class PictureInk:
    """Draws onto a transparent layer of a picture. scale : factor of all sizes"""

    def __init__(self, size, factor, windowSize):
        """size, windowSize : (width, height); factor : by which the layer is larger"""
        self.layer = Image.new("RGBA", (factor * size[0], factor * size[1]))
        self._draw = ImageDraw.Draw(self.layer)
        width, height = windowSize
        self.scale, self._perPixel = max(1.0, height / USUAL_HEIGHT), factor * size[0] / width

    def _placed(self, places):
        return [tuple(self._perPixel * value for value in place) for place in places]

    def line(self, begin, end, colour):
        """Draws a line between two pixels."""
        width = round(self._perPixel * self.scale * LINE_WIDTH)
        self._draw.line(self._placed([begin, end]), _opaque(colour), width)

    def triangle(self, corners, colour):
        """Fills the triangle between three pixels."""
        self._draw.polygon(self._placed(corners), _opaque(colour))

    def dot(self, place, colour):
        """Fills a disc around a pixel."""
        radius = self._perPixel * self.scale * DOT_RADIUS
        self._draw.circle(self._placed([place])[0], radius, _opaque(colour))


def _opaque(colour):
    return tuple(round(255 * part) for part in (*colour, 1.0))
