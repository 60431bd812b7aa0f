"""Panels drawn off-screen, frame by frame, and the hands that use them."""

import math
from itertools import count
from types import SimpleNamespace

import numpy as np

from rbs.pictures.view import SceneView
from rbs.pictures.viewpoint import Viewpoint
from rbs.recordings.lookup import SceneOpener
from rbs.window.panel import Panel
from rbs.window.viewer import Viewer

WIDGETS = "Button", "SliderFloat", "InvisibleButton"
# Pixels. A field's rectangle holds its label, and buttons: its number is at the left.
INTO_FIELD = 15.0


def noting(draw, note):
    """A function of ImGui's that draws a widget, and then note(label, x, y to click at)."""
    import polyscope.imgui as psim

    def noted(label, *arguments, **options):
        answer = draw(label, *arguments, **options)
        (left, top), (_, bottom) = psim.GetItemRectMin(), psim.GetItemRectMax()
        name = label.split("###")[0] or label.split("###")[-1]
        note(name, left + INTO_FIELD, 0.5 * (top + bottom))
        return answer

    return noted


def make_panel(simulation, polyscope, monkeypatch, size, isBasic=True):
    """The panel over a simulation, drawn through Polyscope's callback in a window of this size.

    isBasic : whether scenes that it opens ignore the settings that they recommend
    """
    monkeypatch.setattr(Viewpoint, "move", lambda viewpoint, seconds: False)
    monkeypatch.setattr("rbs.window.panel.SLOW_SECONDS", math.inf)  # frames are slow here
    polyscope.set_window_size(*size)
    monkeypatch.setattr(polyscope, "set_SSAA_factor", lambda factor: None)  # takes most of the time
    view = SceneView(simulation)
    panel = Panel(Viewer(simulation, view, SceneOpener(isBasic=isBasic)))
    panel.viewer.view.set_callback(panel.frame)
    for _ in range(3):  # until the height of the hint is known
        polyscope.frame_tick()
    return panel


def bits_of(simulation):
    """Everything that a step depends on, to the bit, and the step."""
    rows, settings = simulation.state().rows.tobytes(), vars(simulation.settings)
    return rows, len(simulation.meshes), simulation.stepCount, str(settings)


class Hands:
    """A mouse and keys: what each does takes a frame for every change."""

    def __init__(self, ps, widgets):
        import polyscope.imgui as psim

        self.ps, self.psim, self.io, self.widgets = ps, psim, psim.GetIO(), widgets

    def key(self, name, act=lambda: None):
        """Presses and releases a key, and does something between."""
        for isDown in (True, False):
            self.io.AddKeyEvent(getattr(self.psim, f"ImGui{name}"), isDown)
            self.ps.frame_tick()
            if isDown:
                act()

    def press(self, keys):
        """Presses keys one after the other; + joins modifiers, as in Ctrl+Shift+Z."""
        for key in keys.split():
            *modifiers, name = key.split("+")
            name += "Arrow" * (name in ("Left", "Right"))
            act = lambda name=name: self.key(f"Key_{name}")  # noqa: E731
            for modifier in modifiers:
                act = lambda act=act, modifier=modifier: self.key(f"Mod_{modifier}", act)  # noqa: E731
            act()

    def click(self, label):
        """Clicks a widget where it was drawn last."""
        self.ps.frame_tick()
        self.ps.frame_tick()
        self.click_at(*self.widgets[label])

    def click_at(self, x, y):
        """Clicks at a pixel."""
        self.io.AddMousePosEvent(x, y)
        self.ps.frame_tick()
        for isDown in (True, False):
            self.io.AddMouseButtonEvent(0, isDown)
            self.ps.frame_tick()

    def drag(self, begin, end, act=lambda: None, steps=8):
        """Drags from one pixel (x, y) to another one, and does something when it has begun."""
        for k in range(steps + 1):
            x, y = np.array(begin) + k / steps * np.subtract(end, begin)
            self.io.AddMousePosEvent(x, y)
            self.ps.frame_tick()
            if k in (0, steps):
                self.io.AddMouseButtonEvent(0, k == 0)
                self.ps.frame_tick()
            if k == 0:
                act()

    def type_into(self, label, text):
        """Replaces the number in a field or slider, which Ctrl and a click make a field."""
        self.key("Mod_Ctrl", lambda: self.click(label))
        for character in text:
            self.io.AddInputCharacter(ord(character))
            self.ps.frame_tick()
        self.key("Key_Enter")
        self.ps.frame_tick()


def count_time(monkeypatch):
    """Makes each look at the clock take 4 ms, and nothing else."""
    clock = count(step=0.004)
    for module in ("panel", "viewer", "history"):
        still = SimpleNamespace(perf_counter=lambda: next(clock), sleep=lambda seconds: None)
        monkeypatch.setattr(f"rbs.window.{module}.time", still)
