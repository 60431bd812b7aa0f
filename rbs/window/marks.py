"""What the window draws on top of the picture: marks, the drag, the legend, the help."""

import numpy as np
import polyscope.imgui as psim

from rbs.appearance import pixels
from rbs.appearance.colours import PICKED_COLOUR
from rbs.scenes.messages import measured
from rbs.window.widgets import panel, scaled

# The help: keys and mouse actions; pixels, the width of its left column.
KEYS = {
    "Space": "play, pause",
    "S, Right": "one step forward",
    "Left, Ctrl + Z": "one step back, or undo",
    "E, Shift + E": "next or previous event of the last step, with formulas",
    "R": "start over, keeping your settings",
    "Shift + R": "start over, with the scene's own settings",
    "[, ]": "previous scene, next scene",
    "B": "shoot a ball at the mouse",
    "F": "fit all in view, except bodies far away; twice: usual direction",
    "1 to 9": "ground, shadows, overlays: see Display",
    "Tab": "show or hide all panels",
    "N": "show or hide the readout",
    "H, F1, ?": "show or hide this help",
    "Escape": "close a list, this help, or the events of a step",
}
MOUSE = {
    "click": "select a body: readout, push, fix",
    "double-click": "orbit and zoom about a body",
    "Ctrl + drag": "drag a body, and throw it; while paused, move it",
    "drag": "orbit",
    "Shift + drag, right drag": "pan",
    "wheel": "zoom",
    "drop a file": "open a scene, a recording or a viewpoint",
}
INDENT = 180


class WindowInk:
    """Draws over the scene and behind the panels; see `rbs.appearance.pixels`."""

    def __init__(self):
        self._list, self.scale = psim.GetBackgroundDrawList(), scaled(1.0)

    def line(self, begin, end, colour):
        """Draws a line between two pixels."""
        self._list.AddLine(begin, end, packed(colour), self.scale * pixels.LINE_WIDTH)

    def triangle(self, corners, colour):
        """Fills the triangle between three pixels."""
        self._list.AddTriangleFilled(*corners, packed(colour))

    def dot(self, place, colour):
        """Fills a disc around a pixel."""
        self._list.AddCircleFilled(place, self.scale * pixels.DOT_RADIUS, packed(colour))

    def text(self, place, text):
        """Writes black text to the right of a pixel."""
        self._list.AddText(place, packed((0.0, 0.0, 0.0)), text)


def draw_marks(viewer):
    """Draws the marks of pictures, and the spring of a drag with its force."""
    view, ink = viewer.view, WindowInk()
    view.draw_marks(ink)
    if viewer.grab is not None:
        mesh = viewer.simulation.meshes[viewer.grab.body]
        ends = view.pixels_of([viewer.grab.point(mesh), viewer.grab.target])
        pixels.draw_lines(ink, ends[None], PICKED_COLOUR)
        pixels.draw_dot(ink, ends[0], PICKED_COLOUR)
        place = (ends[1] + scaled(12)).tolist()
        if viewer.isPlaying and np.isfinite(place).all():
            ink.text(place, measured(viewer.drag_force(), "N"))


def packed(colour):
    """Returns an RGB colour as ImGui's number: opacity, blue, green, red."""
    red, green, blue = (round(255 * part) for part in colour)
    return 0xFF << 24 | blue << 16 | green << 8 | red


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
            psim.PushTextWrapPos(picture.width)
            psim.TextUnformatted(text)
            psim.PopTextWrapPos()


def draw_help(size):
    """Draws the help in the middle of a window of this size. Returns whether it stays open."""
    with panel("Help", (size[0] / 2, size[1] / 2), (0, 0), size, pivot=(0.5, 0.5)) as isOpen:
        for title, rows in (("Keys", KEYS), ("Mouse", MOUSE)):
            psim.SeparatorText(title)
            for name, text in rows.items():
                psim.Text(name)
                psim.SameLine(scaled(INDENT))
                psim.Text(text)
    return isOpen
