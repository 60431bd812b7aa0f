"""The viewer behind the window: playing, opening, dragging, recording, layout. Nothing is drawn."""

from functools import partial
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest
from program import DATA, record
from views import StillView, make_viewer

from rbs.recordings.lookup import SceneOpener
from rbs.recordings.recording import Recording
from rbs.recordings.replay import verify
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping.meshes import StateError
from rbs.window.panel import arrange


@pytest.fixture
def viewer(tmp_path, monkeypatch):
    """A Viewer of the mixed scene that draws nothing, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    simulation = SceneSimulation(DATA / "mixed-scene.txt")
    return make_viewer(simulation, StillView(simulation))


@pytest.fixture
def replay(tmp_path):
    """A Viewer of a recording of 40 steps of the tower that draws nothing."""
    path = record(tmp_path / "tower.h5", SceneSimulation(DATA / "tower-scene.txt"), 40)
    simulation = SceneOpener(isBasic=True).open(path)
    return make_viewer(simulation, StillView(simulation))


def test_a_scene_opens_with_its_own_settings_whatever_was_changed_before():
    simulation = SceneSimulation(DATA / "mixed-scene.txt")
    viewer = make_viewer(simulation, StillView(simulation), isBasic=False)
    viewer.simulation.settings.change("gravity", 0.0)
    viewer.open("wall")
    assert viewer.simulation.settings == viewer.simulation.startSettings
    assert viewer.simulation.settings.contactSolver == "soft-step"
    viewer.simulation.settings.change("gravity", 1.6)
    viewer.restart()
    assert viewer.simulation.settings.gravity == 1.6  # stays with its scene
    viewer.restart(True)
    assert viewer.simulation.settings.gravity == 9.8
    viewer.step_back()
    assert viewer.simulation.settings.gravity == 1.6


def test_what_was_done_to_bodies_is_undone_bit_by_bit(viewer):
    simulation, view = viewer.simulation, viewer.view
    view.picked = 3

    def drag():
        viewer.hand.grab_at((2, 1.0))
        for z in (5.0, 9.0):
            viewer.hand.drag_to((0, z))
        viewer.hand.release()

    def push():
        before = simulation.meshes[3].linVelocity.copy()
        viewer.hand.push([0.0, 1.0, 0.0])
        np.testing.assert_allclose(simulation.meshes[3].linVelocity - before, [[0.0, 8.0, 0.0]])

    acts = {
        "drag": drag,
        "push": push,
        "fix": lambda: viewer.hand.set_fixed(True),
        "shot": lambda: viewer.hand.shoot((0, 0)),
        "reset": viewer.restart,
    }
    for steps in (0, 3):
        for name, act in acts.items():
            for _ in range(steps):
                viewer.step_once()
            before, changes = bits_of(simulation), list(simulation.changes)
            act()
            after = bits_of(simulation)
            assert after != before or (name, steps) == ("reset", 0)
            if after != before:
                viewer.step_back()
            assert bits_of(simulation) == before, name
            assert [one.kind for one in simulation.changes] == [one.kind for one in changes]
            if after != before:  # and on again
                viewer.seek(viewer.history.last)
                assert bits_of(simulation) == after, name
                viewer.step_back()


def test_a_body_dragged_while_paused_goes_to_the_mouse_by_one_change(viewer):
    mesh, changes = viewer.simulation.meshes[2], []
    viewer.outputs.note = lambda simulation, change: changes.append(change.kind)
    viewer.hand.grab_at((2, 1.0))
    for z in (5.0, 9.0):
        viewer.hand.drag_to((0, z))
    np.testing.assert_allclose(mesh.position[0], [-1.0, 30.0, 9.0], atol=1e-9)
    viewer.hand.release()
    assert changes == ["move"]


def test_a_step_that_fails_is_told_and_leaves_the_history(viewer, monkeypatch):
    viewer.step_once()
    before, place = bits_of(viewer.simulation), viewer.history.place

    def fail(observer=None):
        raise StateError("box: position is not finite")

    monkeypatch.setattr(viewer.simulation, "step", fail)
    viewer.step_once()
    assert viewer.message == "box: position is not finite" and viewer.history.place == place
    assert bits_of(viewer.simulation) == before and len(viewer.history.states) == place


def test_a_file_that_is_there_is_not_written_over(viewer):
    paths = []
    for _ in range(2):
        viewer.outputs.toggle("recording")
        paths.append(viewer.outputs.writers["recording"].path)
        viewer.step_once()
        viewer.outputs.toggle("recording")
    assert len(set(paths)) == 2 and [Recording(path).lastStep for path in paths] == [1, 2]


def bits_of(simulation):
    state = {name: rows.tobytes() for name, rows in simulation.state().items()}
    return state, [mesh.isFixed for mesh in simulation.meshes], simulation.stepCount


def test_a_live_run_is_scrubbed_and_played_from_there(viewer):
    simulation, states = viewer.simulation, []
    simulation.settings.change("contactSolver", "soft-step")
    viewer.step_back()
    assert viewer.message == "This is the first step." and viewer.history.last == 0
    for step in range(12):
        if step == 6:
            viewer.hand.shoot((0, 0))
        states.append(bits_of(simulation))
        viewer.step_once()
    last = bits_of(simulation)
    assert viewer.history.last == viewer.history.place == 13  # the shot is a place of its own
    assert viewer.history.ends() == (0, 12)
    for place in (2, 11, 0, 7, 3):
        viewer.isPlaying = True
        viewer.seek(place)
        assert bits_of(simulation) == states[place - (place > 6)] and not viewer.isPlaying
    for _ in range(10):  # what was kept is there again, with the shot
        viewer.step_once()
    assert bits_of(simulation) == last and viewer.history.last == 13
    viewer.redo()
    assert viewer.message == "Nothing to redo."


def test_the_start_is_kept_however_long_a_run_is(viewer, monkeypatch):
    monkeypatch.setattr("rbs.window.history.MOST_STATES", 10)
    start = bits_of(viewer.simulation)
    for _ in range(30):
        viewer.step_once()
    assert viewer.history.ends() == (0, 30) and len(viewer.history.states) == 10
    viewer.seek(1)
    assert viewer.simulation.stepCount == 21
    viewer.step_back()
    assert bits_of(viewer.simulation) == start
    viewer.outputs.toggle("recording")
    viewer.step_once()  # over the gap, which a recording cannot have
    assert viewer.simulation.stepCount == 21 and not viewer.outputs.writers


def test_settings_are_undone_and_redone_and_a_dragged_slider_counts_once(viewer):
    settings = viewer.simulation.settings
    for value in (0.1, 0.2, 0.3):
        viewer.set("friction", value)
    viewer.step_once()
    viewer.set("friction", 0.7)
    viewer.set("gravity", 1.0)
    for friction, gravity in ((0.7, 9.8), (0.3, 9.8), (0.3, 9.8), (0.0, 9.8)):
        viewer.step_back()
        assert (settings.friction, settings.gravity) == (friction, gravity)
    assert viewer.history.place == 0
    for _ in range(4):
        viewer.redo()
    assert (settings.friction, settings.gravity, viewer.simulation.stepCount) == (0.7, 1.0, 1)


def test_what_is_replayed_from_history_is_recorded_too(viewer):
    viewer.step_once()
    viewer.hand.grab_at((2, 1.0))
    viewer.step_once()  # dragged
    viewer.hand.release()
    viewer.view.picked = 3
    viewer.hand.push([0.0, 1.0, 0.0])
    viewer.step_once()
    viewer.hand.shoot((0, 0))
    for _ in range(3):
        viewer.step_once()
    last = bits_of(viewer.simulation)
    viewer.seek(1)
    viewer.outputs.toggle("recording")
    path = viewer.outputs.writers["recording"].path
    for _ in range(7):
        viewer.step_once()
    assert bits_of(viewer.simulation) == last
    viewer.outputs.stop()
    recording = Recording(path)
    assert [one.kind for _, one in recording.changes] == ["push", "velocity", "add"]
    assert (recording.firstStep, recording.lastStep) == (1, 6) and verify(recording) == ""


@pytest.mark.parametrize("method", ["add", "save"])
@pytest.mark.parametrize("name", ["video", "recording"])
def test_a_file_that_cannot_be_written_ends_and_is_reported(viewer, name, method):
    file = MagicMock(path="v", count=3)
    getattr(file, method).side_effect = OSError(28, "No space left on device")
    viewer.outputs.writers[name] = file
    viewer.step_once()
    assert (name in viewer.outputs.writers) == (method == "save")
    viewer.outputs.stop()
    assert viewer.message == "cannot write: No space left on device"
    assert name not in viewer.outputs.writers and viewer.simulation.stepCount == 1
    assert file.close.called or (name, method) == ("video", "add")


def test_shots_are_counted_and_gone_with_a_reset(viewer, monkeypatch):
    monkeypatch.setattr("rbs.window.hand.MOST_SHOTS", 2)
    for _ in range(3):
        viewer.hand.shoot((0, 0))
    assert len(viewer.simulation.meshes) == 17 and "2 balls" in viewer.message
    viewer.hand.grab_at((16, 0.0))  # a ball can be dragged too
    viewer.step_once()
    viewer.restart(True)
    assert len(viewer.simulation.meshes) == 15 and viewer.hand.grab is None


def test_a_replay_is_continued(replay):
    replay.seek(15)
    before = replay.simulation.state()
    for act in (replay.hand.grab_at, replay.hand.shoot):
        replay.message = ""
        act((1, 0.0))
        assert replay.hand.grab is None and "Continue from here" in replay.message
    replay.continue_here()
    assert replay.message == ""  # it can be changed now
    assert not replay.isReplay and not replay.isPlaying and replay.simulation.stepCount == 15
    now = replay.simulation.state()
    assert all(before[name].tobytes() == now[name].tobytes() for name in before)
    replay.step_once()
    assert replay.simulation.stepCount == 16


@pytest.mark.parametrize("end", ["button", "reset", "open"])
def test_session_is_recorded_until_it_ends(viewer, end):
    simulation = viewer.simulation
    viewer.view.picked = 3
    viewer.outputs.toggle("recording")
    for step in range(30):
        if step == 2:
            viewer.hand.push([0.0, 1.0, 0.0])
        if step == 5:
            viewer.hand.grab_at((2, 1.0))
            viewer.hand.drag_to((0, 15.0))
        if step == 20:
            viewer.hand.release()
            viewer.hand.shoot((0, 0))
        if step == 25:
            viewer.hand.set_fixed(True)
        viewer.step_once()
    last = simulation.state()
    ends = {
        "button": lambda: viewer.outputs.toggle("recording"),
        "reset": partial(viewer.restart, True),
        "open": partial(viewer.open, "tower"),
    }
    ends[end]()
    assert not viewer.outputs.writers
    path = Path("out/mixed/recording.h5").resolve()
    assert viewer.outputs.written == [path] and viewer.message == f"saved {path}"
    recording = Recording(path)
    assert {one.kind for _, one in recording.changes} == {"velocity", "move", "add", "inertia"}
    np.testing.assert_array_equal(recording.frame(30)["positions"], last["positions"])
    assert verify(recording) == ""


def test_a_replay_plays_stops_at_its_end_and_starts_again(replay):
    replay.seek(39)
    replay.toggle_play()
    replay.play(0.041)
    assert replay.simulation.stepCount == 40 and not replay.isPlaying
    replay.toggle_play()  # from the start again
    assert replay.simulation.stepCount == 0 and replay.isPlaying


def test_what_cannot_be_opened_is_told_and_the_scene_stays(viewer, replay, tmp_path):
    viewer.step_once()
    (tmp_path / "broken.json").write_text("2\n")
    for name in (tmp_path / "broken.json", tmp_path / "none.h5", tmp_path, "stresss"):
        viewer.open(name)
        assert viewer.message.startswith(f"{name}:")
    assert viewer.simulation.stepCount == 1 and viewer.view.rebuilt == 0
    for name, isReplay in ((replay.simulation.recording.path, True), ("tet", False)):
        viewer.toggle_play()
        viewer.open(name)
        assert (viewer.isReplay, viewer.isPlaying, viewer.message) == (isReplay, False, "")


@pytest.mark.parametrize("size", [(800, 500), (1280, 720), (1920, 1080)])
def test_panels_leave_the_picture_room(size):
    for hasSide in (False, True):
        _, _, width, height = arrange(*size, hasSide).picture
        assert width >= (2 / 3 if size[0] > 1000 or not hasSide else 0.45) * size[0]
        assert height >= 0.9 * size[1]
