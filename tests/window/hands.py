"""The hands that use panels, and what they are compared by."""

from functools import partial
from itertools import count
from types import SimpleNamespace

import numpy as np
import polyscope.imgui as psim


def bits_of(simulation):
    """Everything that a step depends on, to the bit, and the step."""
    rows, settings = simulation.state().rows.tobytes(), vars(simulation.settings)
    return rows, len(simulation.meshes), simulation.stepCount, str(settings)


def make_steps(viewer, count):
    for _ in range(count):
        viewer.step_once()


class Hands:
    """A mouse and keys: what each does takes a frame for every change."""

    def __init__(self, ps, widgets):
        self.ps, self.io, self.widgets = ps, psim.GetIO(), widgets

    def key(self, name, act=lambda: None):
        """Presses and releases a key, and does something between."""
        for isDown in (True, False):
            self.io.AddKeyEvent(getattr(psim, f"ImGui{name}"), isDown)
            self.ps.frame_tick()
            if isDown:
                act()

    def press(self, keys):
        """Presses keys one after the other; + joins modifiers, as in Ctrl+Shift+Z."""
        for key in keys.split():
            *modifiers, name = key.split("+")
            name += "Arrow" * (name in ("Left", "Right"))
            act = partial(self.key, f"Key_{name}")
            for modifier in modifiers:
                act = partial(self.key, f"Mod_{modifier}", act)
            act()

    def click(self, label):
        """Clicks a widget where it was drawn last."""
        self.ps.frame_tick()
        self.ps.frame_tick()
        self.click_at(*self.widgets[label])

    def click_at(self, x, y):
        self.io.AddMousePosEvent(x, y)
        self.ps.frame_tick()
        for isDown in (True, False):
            self.io.AddMouseButtonEvent(0, isDown)
            self.ps.frame_tick()

    def drag(self, begin, end, act=lambda: None):
        """Drags from one pixel (x, y) to another one, and does something when it has begun."""
        for k in range(9):
            x, y = np.array(begin) + k / 8 * np.subtract(end, begin)
            self.io.AddMousePosEvent(x, y)
            self.ps.frame_tick()
            if k in (0, 8):
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
