"""Keys, mouse and widgets of the panels, drawn off-screen."""

import signal
from functools import partial

import numpy as np
import polyscope.imgui as psim
import pytest
from hands import count_time


def test_a_window_smaller_than_its_panels_is_drawn(open_panel):
    assert max(open_panel("mixed", size=(90, 20)).picture[2:]) < 0


def test_keys_play_step_and_reset_and_edges_are_smooth_while_nothing_moves(hands, panel):
    viewer = panel.viewer
    for isPlaying in (True, False):
        hands.key("Key_Space")
        assert viewer.isPlaying == isPlaying != viewer.view.isSmooth
    count = viewer.simulation.stepCount
    hands.key("Key_S")
    hands.key("Key_RightArrow")
    assert viewer.simulation.stepCount == count + 2
    hands.key("Key_R")
    assert viewer.simulation.stepCount == 0


def test_numbers_are_typed_in_within_their_bounds(hands, panel):
    settings = panel.viewer.simulation.settings
    for label, name, typed, expected in (
        ("time step (s)", "timeStep", "0.0025", 0.0025),
        ("time step (s)", "timeStep", "0", 0.0025),
        ("restitution", "restitution", "1.1", 1.0),
        ("gravity (m/s²)", "gravity", "24.8", 24.8),  # Jupiter's, beyond the slider
    ):
        hands.type_into(label, typed)
        assert getattr(settings, name) == expected
        assert ("must be a finite number" in panel.viewer.message) == (float(typed) != expected)
    assert panel.viewer.simulation.stepCount == 0


def test_a_body_is_thrown_with_ctrl_and_the_mouse(hands, panel, monkeypatch):
    count_time(monkeypatch)
    simulation, view = panel.viewer.simulation, panel.viewer.view
    begin = view.pixels_of(view.poses[:3, 3])[0]
    play = partial(hands.key, "Key_Space")
    hands.key("Mod_Ctrl", lambda: hands.drag(begin, begin + [-70.0, -70.0], play))
    assert panel.viewer.hand.grab is None and simulation.stepCount > 5
    velocities = np.array([mesh.linVelocity[0, 1] for mesh in simulation.meshes[:7]])
    assert velocities[3] > 0.0 > np.delete(velocities, 3).max()  # the others fall


def test_a_paused_picture_is_drawn_again_only_for_a_change(panel, polyscope):
    for isShown in (True, False):
        panel.viewer.view.show("bounding boxes", isShown)
        assert polyscope.get_redraw_requested()
        for _ in range(3):
            polyscope.frame_tick()
        assert not polyscope.get_redraw_requested()


def test_no_interrupt_is_lost_where_a_name_of_a_key_is_converted(panel, polyscope, monkeypatch):
    """The conversion drops any exception; Ctrl-C became an internal error."""
    numbers = [signal.SIGINT]

    def converted(key):
        if numbers:
            signal.raise_signal(numbers.pop())
        return key._value_

    monkeypatch.setattr(type(psim.ImGuiKey_A), "value", property(converted), raising=False)

    def frame():
        with pytest.raises(KeyboardInterrupt):
            panel.frame()

    panel.viewer.view.set_callback(frame)  # none may leave Polyscope's frame
    polyscope.frame_tick()
    assert not numbers and not panel.viewer.message
