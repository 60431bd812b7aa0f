"""Keys, mouse and widgets of the panels, drawn off-screen; and a user who does things at random."""

from functools import partial

import numpy as np
import pytest
from hands import WIDGETS, Hands, count_time, make_panel, noting
from program import DATA, record

from rbs.recordings.recording import Recording
from rbs.recordings.replay import Replay
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping.settings import Settings


@pytest.fixture
def panel(polyscope, tmp_path, monkeypatch):
    """The panel over the mixed scene, drawn frame by frame through Polyscope's callback."""
    monkeypatch.chdir(tmp_path)
    simulation = SceneSimulation(DATA / "mixed-scene.txt")
    result = make_panel(simulation, polyscope, monkeypatch, (560, 720))
    yield result
    result.viewer.view.set_callback(None)


@pytest.fixture
def widgets(monkeypatch, polyscope):
    """What is drawn: a list of (kind, label, (x, y) to click at), of tooltips too."""
    import polyscope.imgui as psim

    result = []

    def note(kind, label, x, y, _):
        result.append((kind, label, (x, y)))

    for kind in (*WIDGETS, "SetItemTooltip"):
        monkeypatch.setattr(psim, kind, noting(getattr(psim, kind), partial(note, kind)))
    return result


@pytest.fixture
def hands(polyscope, widgets, panel):
    return Hands(polyscope, widgets)


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


def test_keys_show_help_shoot_and_undo(hands, panel):
    viewer = panel.viewer
    hands.key("Key_H")
    assert panel.isHelpShown
    hands.key("Key_Escape")
    assert not panel.isHelpShown
    hands.io.AddMousePosEvent(480.0, 200.0)  # beside the panel
    hands.key("Key_B")
    assert len(viewer.simulation.meshes) == 16
    hands.key("Mod_Ctrl", lambda: hands.key("Key_Z"))  # what was shot is taken back
    assert len(viewer.simulation.meshes) == 15
    start = viewer.simulation.state()["positions"]
    hands.key("Key_S")
    hands.key("Key_LeftArrow")
    assert viewer.simulation.stepCount == 0
    assert np.array_equal(viewer.simulation.state()["positions"], start)


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


@pytest.mark.parametrize("kind", ["impulse", "soft-step", "recording"])
def test_widgets_write_nothing_while_nobody_touches_them(polyscope, hands, panel, tmp_path, kind):
    viewer, solver = panel.viewer, "impulse" if kind == "recording" else kind
    settings = Settings(friction=0.4, restitution=0.7, contactSolver=solver)
    simulation = SceneSimulation(DATA / "cube-scene.txt", settings)
    if kind == "recording":
        simulation = Replay(Recording(record(tmp_path / "cube.h5", simulation, 3)))
    viewer.simulation, viewer.hand.pushSpeed = simulation, 0.4
    viewer.view.rebuild(simulation)
    simulation.step()
    viewer.view.pick(1, simulation.meshes[1].position[0])
    panel.isSideShown = True
    before = repr(simulation.settings)
    state = {name: values.tobytes() for name, values in simulation.state().items()}
    for _ in range(10):
        polyscope.frame_tick()
    assert repr(simulation.settings) == before and "friction=0.4" in before
    assert {name: values.tobytes() for name, values in simulation.state().items()} == state
    assert repr(viewer.hand.pushSpeed) == "0.4" and simulation.stepCount == 1
    hands.key("Key_S")
    assert simulation.stepCount == 2  # the panel is still Polyscope's callback


def test_panel_goes_on_after_a_picture(polyscope, hands, panel, monkeypatch):
    panel.viewer.view.show("velocities", True)
    hands.click("Picture")
    assert panel.viewer.message.endswith("/out/mixed/picture_000000.png")
    hands.key("Key_S")
    assert panel.viewer.simulation.stepCount == 1

    def fail(**options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(polyscope, "screenshot_to_buffer", fail)
    panel.viewer.outputs.save_picture()
    assert panel.viewer.message == "cannot write: No space left on device"
    hands.key("Key_S")
    assert panel.viewer.simulation.stepCount == 2


def seen(panel):
    """The pixels (n, 2) at which the middles of the bodies are seen."""
    return panel.viewer.view.pixels_of([m.position[0] for m in panel.viewer.simulation.meshes])


def test_a_body_is_thrown_with_ctrl_and_the_mouse(hands, panel, monkeypatch):
    count_time(monkeypatch)
    simulation, begin = panel.viewer.simulation, seen(panel)[3]
    play = partial(hands.key, "Key_Space")
    hands.key("Mod_Ctrl", lambda: hands.drag(begin, begin + [-70.0, -70.0], play))
    assert panel.viewer.hand.grab is None and simulation.stepCount > 5
    velocities = np.array([mesh.linVelocity[0, 1] for mesh in simulation.meshes[:7]])
    assert velocities[3] > 0.0 > np.delete(velocities, 3).max()  # the others fall


@pytest.fixture
def small_panel(polyscope, monkeypatch):
    """The panel over the stack, 800 × 500."""
    simulation = SceneSimulation(DATA / "stack-scene.txt", Settings(contactSolver="soft-step"))
    result = make_panel(simulation, polyscope, monkeypatch, (800, 500))
    yield result
    result.viewer.view.set_callback(None)


def test_a_hidden_overlay_vanishes_from_a_paused_picture(small_panel, polyscope):
    for isShown in (True, False):
        small_panel.viewer.view.show("bounding boxes", isShown)
        assert polyscope.get_redraw_requested()
        for _ in range(2):
            polyscope.frame_tick()
    assert not polyscope.get_redraw_requested()
