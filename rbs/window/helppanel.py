"""The window's help panel: keys and mouse actions."""

import polyscope.imgui as psim

from rbs.window.widgets import panel, scaled

KEYS = {
    "Space": "play, pause",
    "S, Right": "one step forward",
    "Left, Ctrl + Z": "one step back, or undo",
    "E, Shift + E": "next event of the last step, event before: formulas",
    "R": "start over, keeping your settings",
    "Shift + R": "start over, with the scene's own settings",
    "[, ]": "the scene before, the next scene",
    "B": "shoot a ball at the mouse",
    "F": "fit all in view, except what has fled; twice: usual direction",
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
# Pixels, the width of the left column.
INDENT = 180


def draw_help(picture):
    """Draws the panel in the middle of the picture, a Box. Returns whether it stays open."""
    left, top, width, height = picture
    middle = left + width / 2, top + height / 2
    with panel("Help", middle, (0, 0), (width, height), pivot=(0.5, 0.5)):
        for title, rows in (("Keys", KEYS), ("Mouse", MOUSE)):
            psim.SeparatorText(title)
            for name, text in rows.items():
                psim.Text(name)
                psim.SameLine(scaled(INDENT))
                psim.Text(text)
        psim.Separator()
        return not psim.Button("Close")
