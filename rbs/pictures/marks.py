"""What is drawn on top of a picture: overlays at or within bodies, and the selected body.

Bodies would hide it, and glass bodies wash it out. `draw_marks` draws with an ink: `PictureInk`, or
that of the window. Its methods are line(begin, end, colour), triangle(corners, colour) and
dot(place, colour). Units: pixels of the window, from its upper left corner.
"""

import numpy as np
import polyscope as ps
from PIL import Image, ImageDraw

from rbs.appearance.colours import MARK_COLOUR, PICKED_COLOUR
from rbs.appearance.pixels import averaged, laid_over
from rbs.pictures.overlays import Arrows

# Width of lines, radius of a dot, and length of an arrow's head, at most.
LINE_WIDTH, DOT_RADIUS, HEAD = 2.0, 4.0, 9.0
# Half the width of a head, relative to its length.
HEAD_WIDTH = 0.4
# Height of a picture in which they have these sizes; they grow with larger ones.
USUAL_HEIGHT = 720


def draw_marks(view, ink):
    """Draws the overlays and the selected body of a SceneView in its present camera."""
    for one in (one for parts in view.overlays.onTop.values() for one in parts):
        if isinstance(one, Arrows):
            ends = view.pixels_of(one.points + one.vectors)
            draw_arrows(ink, view.pixels_of(one.points), ends, one.colour)
        else:
            draw_lines(ink, view.pixels_of(one.points)[one.edges], one.colour)
    if view.picked is not None:
        outline = view.picked_outline()
        draw_lines(ink, np.stack([outline, np.roll(outline, 1, axis=0)], axis=1), PICKED_COLOUR)
        draw_dot(ink, view.pixels_of(view.picked_point())[0], MARK_COLOUR)


def draw_dot(ink, pixel, colour):
    """Draws a dot at a pixel (2,), unless it is behind the camera."""
    if np.isfinite(pixel).all():
        ink.dot(pixel.tolist(), colour)


def draw_lines(ink, ends, colour):
    """Draws lines between pixels (n, 2, 2), except from behind the camera."""
    for begin, end in ends[np.isfinite(ends).all(axis=(1, 2))].tolist():
        ink.line(begin, end, colour)


def draw_arrows(ink, begins, ends, colour):
    """Draws arrows between pixels (n, 2), except from behind the camera."""
    ways = ends - begins
    lengths = np.hypot(*ways.T)[:, None]
    heads = np.minimum(ink.scale * HEAD, 0.5 * lengths) * ways / np.maximum(lengths, 1e-9)
    across = HEAD_WIDTH * heads[:, ::-1] * [-1.0, 1.0]
    draw_lines(ink, np.stack([begins, ends - heads], axis=1), colour)
    corners = np.stack([ends, ends - heads + across, ends - heads - across], axis=1)
    for triangle in corners[np.isfinite(corners).all(axis=(1, 2))].tolist():
        ink.triangle(triangle, colour)


class PictureInk:
    """Draws onto a transparent layer of a picture. scale : of all sizes, in pixels of the window"""

    def __init__(self, size, factor):
        """size : (width, height) of the picture; factor : by which the layer is larger"""
        self.layer = Image.new("RGBA", (factor * size[0], factor * size[1]))
        self._draw = ImageDraw.Draw(self.layer)
        width, height = ps.get_window_size()
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


def with_marks(picture, view, factor):
    """Returns a picture (height, width, 3 or 4), uint8, with the marks of its SceneView.

    factor : by which the marks are drawn larger, and then averaged
    """
    if not any(view.overlays.onTop.values()) and view.picked is None:
        return picture
    ink = PictureInk(picture.shape[1::-1], factor)
    draw_marks(view, ink)
    return laid_over(averaged(np.asarray(ink.layer), factor), picture)
