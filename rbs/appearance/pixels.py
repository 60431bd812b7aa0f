"""Pictures as arrays of pixels: averaged, laid over each other, with a legend, and with marks.

Marks are lines, arrows and dots on top of a picture. They are drawn with an ink: `PictureInk`, or
that of the window. Its methods are line(begin, end, colour), triangle(corners, colour) and
dot(place, colour), in pixels of the window, from its upper left corner.
"""

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from rbs.appearance.camera import USUAL_HEIGHT

# Legend: size of its text as a fraction of the picture's height; distance from the picture's upper
# left corner, padding, side of colour samples and distance of lines, relative to the text.
LEGEND_TEXT, LEGEND_MARGIN, LEGEND_PADDING, LEGEND_SAMPLE, LEGEND_LINE = 1 / 36, 0.7, 0.5, 1.0, 1.35
LEGEND_COLOURS = (48, 54, 64, 255), (235, 235, 235, 255)  # background and text
# Pixels: width of lines, radius of a dot, and greatest length of an arrow's head.
LINE_WIDTH, DOT_RADIUS, HEAD = 2.0, 4.0, 9.0
# Half the width of a head, relative to its length.
HEAD_WIDTH = 0.4


def averaged(picture, factor):
    """Averages blocks of factor × factor pixels; (height, width, 3 or 4), uint8."""
    height, width, channels = picture.shape
    blocks = picture.reshape(height // factor, factor, width // factor, factor, channels)
    if channels == 3:
        total = blocks.sum(axis=(1, 3), dtype=np.uint16)
        return ((total + factor**2 // 2) // factor**2).astype(np.uint8)
    # weights colours of marks by opacity, because transparent pixels have no colour
    opacity = blocks[..., 3:].astype(np.float32)
    weight = opacity.sum(axis=(1, 3))
    colour = (blocks[..., :3] * opacity).sum(axis=(1, 3)) / np.maximum(weight, 1.0)
    return np.rint(np.concatenate([colour, weight / factor**2], axis=2)).astype(np.uint8)


def laid_over(upper, lower):
    """Composites a picture with opacity (height, width, 4) over another one (height, width, 3)."""
    above = upper[..., 3:].astype(np.float32) / 255.0
    return np.rint(above * upper[..., :3] + (1.0 - above) * lower).astype(np.uint8)


def with_legend(picture, rows):
    """Returns a picture (height, width, 3), uint8, with a legend in its upper left corner.

    rows : (text, (r, g, b))
    """
    size = LEGEND_TEXT * len(picture)
    font, raised = (ImageFont.load_default(share * size) for share in (1.0, 0.6))
    margin, padding, side, line = (
        share * size for share in (LEGEND_MARGIN, LEGEND_PADDING, LEGEND_SAMPLE, LEGEND_LINE)
    )
    left = margin + side + 2.0 * padding
    right = left + max(font.getlength(text) for text, _ in rows) + padding
    bottom = margin + len(rows) * line + padding
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    draw.rectangle([margin, margin, right, bottom], LEGEND_COLOURS[0])
    for k, (text, colour) in enumerate(rows):
        middle = margin + padding / 2.0 + (k + 0.5) * line
        sample = margin + padding, middle - side / 2.0
        corners = [round(place) for place in (*sample, sample[0] + side, sample[1] + side)]
        draw.rectangle(corners, _opaque(colour))
        words, cubed, _ = text.partition("³")  # which the font does not have
        draw.text((left, middle), words, LEGEND_COLOURS[1], font, anchor="lm")
        if cubed:
            place = left + font.getlength(words), middle
            draw.text(place, "3", LEGEND_COLOURS[1], raised, anchor="ls")
    return np.asarray(image)


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
