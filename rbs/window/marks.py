"""What the window draws on top of the picture: marks, the drag, the help."""

import polyscope.imgui as psim

from rbs.appearance import pixels
from rbs.appearance.colours import PICKED_COLOUR
from rbs.window.widgets import packed, panel, scaled

# Mouse actions of the help; pixels, the width of the help's left column.
MOUSE = {
    "click": "select a body: readout, push, fix",
    "double-click": "look at a point, to orbit and zoom about it",
    "Ctrl + drag": "drag a body, and throw it; while paused, move it",
    "drag": "orbit",
    "Shift + drag, right drag": "pan",
    "wheel": "zoom",
    "drop a file": "open a scene, a recording, a viewpoint or your .py",
}
INDENT = 210
# Pixels by which a text's halo is shifted, and its colour.
HALO = [(x, y) for x in (-1.5, 0.0, 1.5) for y in (-1.5, 0.0, 1.5) if x or y]
HALO_COLOUR = (0.97, 0.97, 0.97)


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
        """Writes black text with a pale halo to the right of a pixel."""
        for x, y in HALO:
            shifted = place[0] + self.scale * x, place[1] + self.scale * y
            self._list.AddText(shifted, packed(HALO_COLOUR), text)
        self._list.AddText(tuple(place), packed((0.0, 0.0, 0.0)), text)


def draw_marks(viewer):
    """Draws the marks of pictures, and the spring of a drag."""
    view, ink = viewer.view, WindowInk()
    view.draw_marks(ink)
    if (grab := viewer.hand.grab) is not None:
        ends = view.pixels_of([grab.point(viewer.simulation.meshes[grab.body]), grab.target])
        pixels.draw_lines(ink, ends[None], PICKED_COLOUR)
        pixels.draw_dot(ink, ends[0], PICKED_COLOUR)


def draw_help(keys, size):
    """Draws the help in the middle of a window of this size. Returns whether it stays open.

    keys : rows that begin with the names of ImGui's and the meaning
    """
    rows = {}
    for chords, text, _ in keys:
        names = [one for one in chords.replace("Arrow", "").split() if "Keypad" not in one]
        rows[", ".join(names).replace("+", " + ")] = text
    middle, limits = (size[0] / 2, size[1] / 2), ((0, 0), size)
    with panel("Help", middle, *limits, pivot=(0.5, 0.5), isFront=True) as isOpen:
        for title, part in (("Keys", rows), ("Mouse", MOUSE)):
            psim.SeparatorText(title)
            for name, text in part.items():
                psim.Text(name)
                psim.SameLine(scaled(INDENT))
                psim.Text(text)
    return isOpen
