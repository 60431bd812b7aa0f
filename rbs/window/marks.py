"""What is drawn on top of the picture: the selection, the drag, overlays within bodies, the legend.

Polyscope would hide it in bodies, or draw the bodies as glass that washes it out.
"""

import numpy as np
import polyscope.imgui as psim

from rbs.appearance.colours import MARK_COLOUR, PICKED_COLOUR
from rbs.pictures.overlays import draw_arrows
from rbs.scenes.messages import measured
from rbs.window.widgets import panel, scaled

# Pixels: width of lines, and of those of contact areas; length of an arrow's head, at most.
WIDTH, HEAD = 2.0, 9.0
# Half the width of a head, relative to its length.
HEAD_WIDTH = 0.4


def draw_marks(viewer):
    """Draws everything on top of the present picture, behind the panels."""
    view, ink = viewer.view, psim.GetBackgroundDrawList()
    for parts in view.overlays.onTop.values():
        for draw, (points, others, colour, _) in parts:
            if draw is draw_arrows:
                _draw_arrows(ink, view, points, points + others, packed(colour))
            elif len(others):
                _draw_lines(ink, view.pixels_of(points)[others], packed(colour))
    if view.picked is not None:
        outline = view.picked_outline()
        sides = np.stack([outline, np.roll(outline, 1, axis=0)], axis=1)
        _draw_lines(ink, sides, packed(PICKED_COLOUR))
        _draw_point(ink, view.pixels_of(view.picked_point())[0], MARK_COLOUR)
    if viewer.grab is not None:
        mesh = viewer.simulation.meshes[viewer.grab.body]
        ends = view.pixels_of([viewer.grab.point(mesh), viewer.grab.target])
        _draw_lines(ink, ends[None], packed(PICKED_COLOUR))
        _draw_point(ink, ends[0], PICKED_COLOUR)
        place = (ends[1] + scaled(12)).tolist()
        if viewer.isPlaying and np.isfinite(place).all():
            ink.AddText(place, packed((0.0, 0.0, 0.0)), measured(viewer.drag_force(), "N"))


def packed(colour):
    """Returns an RGB colour as ImGui's number: opacity, blue, green, red."""
    red, green, blue = (round(255 * part) for part in colour)
    return 0xFF << 24 | blue << 16 | green << 8 | red


def _draw_point(ink, pixel, colour):
    if np.isfinite(pixel).all():
        ink.AddCircleFilled(pixel.tolist(), scaled(4), packed(colour))


def _draw_lines(ink, ends, colour):
    """Draws lines between pixels (n, 2, 2), except from behind the camera."""
    for begin, end in ends[np.isfinite(ends).all(axis=(1, 2))].tolist():
        ink.AddLine(begin, end, colour, scaled(WIDTH))


def _draw_arrows(ink, view, begins, ends, colour):
    begins, ends = view.pixels_of(begins), view.pixels_of(ends)
    ways = ends - begins
    lengths = np.hypot(*ways.T)[:, None]
    heads = np.minimum(scaled(HEAD), 0.5 * lengths) * ways / np.where(lengths > 0.0, lengths, 1.0)
    across = HEAD_WIDTH * heads[:, ::-1] * [-1.0, 1.0]
    _draw_lines(ink, np.stack([begins, ends - heads], axis=1), colour)
    corners = np.stack([ends, ends - heads + across, ends - heads - across], axis=1)
    for triangle in corners[np.isfinite(corners).all(axis=(1, 2))].tolist():
        ink.AddTriangleFilled(*triangle, colour)


def draw_legend(rows, picture, above):
    """Draws rows (text, (r, g, b)), if any, in the lower right corner of the picture, a Box.

    above : pixels from its lower edge
    """
    if not rows:
        return
    corner = picture.left + picture.width, picture.top + picture.height - above
    with panel("Legend", corner, (0, 0), picture[2:], "NoTitleBar NoInputs", (1.0, 1.0), 0.7):
        flags, side = psim.ImGuiColorEditFlags_NoTooltip, psim.GetFontSize()
        for text, colour in rows:
            psim.ColorButton(text, (*colour, 1.0), flags, (side, side))
            psim.SameLine()
            psim.Text(text)
