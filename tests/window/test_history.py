"""Going back, undo and redo with real keys, also while an event is shown; errors in a frame."""

import pytest
from hands import Hands, make_panel
from program import DATA
from studentVariants import write_submission

from rbs.program.submittedsteps import SubmittedSteps
from rbs.scenes.changes import remove
from rbs.scenes.simulation import SceneSimulation
from rbs.window.history import Playback


@pytest.fixture
def user(polyscope, tmp_path, monkeypatch):
    """Hands over the panel of the mixed scene, which is their attribute `panel`."""
    monkeypatch.chdir(tmp_path)
    simulation = SceneSimulation(DATA / "mixed-scene.txt")
    hands = Hands(polyscope, {})
    hands.panel = make_panel(simulation, polyscope, monkeypatch, (800, 500))
    hands.io.AddMousePosEvent(500.0, 200.0)
    yield hands
    hands.panel.viewer.view.set_callback(None)


def press(user, keys):
    """Presses keys one after the other; + joins modifiers, as in Ctrl+Shift+Z."""
    for key in keys.split():
        *modifiers, name = key.split("+")
        name += "Arrow" * (name in ("Left", "Right"))
        act = lambda name=name: user.key(f"Key_{name}")  # noqa: E731
        for modifier in modifiers:
            act = lambda act=act, modifier=modifier: user.key(f"Mod_{modifier}", act)  # noqa: E731
        act()


def bits(user):
    simulation = user.panel.viewer.simulation
    return [rows.tobytes() for rows in simulation.state().values()], simulation.stepCount


# What changes bodies or the present state; what is pressed before, with an event shown at its end.
ACTS = {
    "a shot": lambda user: press(user, "B"),
    "a start over": lambda user: press(user, "R"),
    "undo": lambda user: press(user, "Ctrl+Z"),
    "another scene": lambda user: user.panel.viewer.open("tower"),
    "a program": lambda user: user.panel.viewer.simulation.change(remove(3)),
    "playing": lambda user: press(user, "Space"),
}


@pytest.mark.parametrize("act", ACTS.values(), ids=ACTS)
@pytest.mark.parametrize("before", ["B S S E", "S S Left E"])
def test_what_changes_bodies_leaves_the_event_first(user, before, act):
    user.panel.glass.skips = False
    press(user, before)
    assert user.panel.viewer.view.highlight is not None
    act(user)
    user.ps.frame_tick()
    view, viewer = user.panel.viewer.view, user.panel.viewer
    viewer.view.refresh()
    assert view.highlight is None and not viewer.message
    user.ps.frame_tick()
    press(user, "S")  # the window is alive
    assert viewer.simulation.stepCount >= 1 and not viewer.message


@pytest.mark.parametrize("key", ["Right", "Ctrl+Shift+Z"])
def test_going_forward_brings_back_what_was_kept(user, key):
    press(user, "B S S S S S")
    after = bits(user)
    press(user, "Left " * 8)
    assert bits(user)[1] == 0 and len(user.panel.viewer.simulation.meshes) == 15
    press(user, f"{key} " * 6)
    assert bits(user) == after and len(user.panel.viewer.simulation.meshes) == 16
    press(user, key)
    assert user.panel.viewer.simulation.stepCount == (5 if "+" in key else 6)


def test_only_something_new_begins_a_new_branch(user):
    press(user, "B S S S Left Left F H Escape N E Escape")
    viewer = user.panel.viewer
    assert viewer.history.isAhead
    press(user, "B")
    assert not viewer.history.isAhead and len(viewer.simulation.meshes) == 17
    press(user, "Ctrl+Z")
    assert len(viewer.simulation.meshes) == 16


def test_an_error_in_a_frame_becomes_a_message_and_the_others_go_on(user, monkeypatch, capfd):
    viewer = user.panel.viewer
    viewer.outputs.toggle("recording")
    path = viewer.outputs.writers["recording"].path

    def fail(*rest):
        raise ValueError("shapes (15,) and (16,)")

    user.panel.isSideShown = True
    glass, overlays = user.panel.glass, viewer.view.overlays
    for owner, name in ((user.panel, "_draw_save"), (glass, "draw_list"), (overlays, "refresh")):
        with monkeypatch.context() as context:
            context.setattr(owner, name, fail)
            press(user, "S S")
            assert "internal error, ValueError: shapes" in viewer.message and not viewer.isPlaying
        count = viewer.simulation.stepCount
        press(user, "S")
        assert viewer.simulation.stepCount == count + 1 and viewer.message == ""
    viewer.outputs.stop()
    assert path.is_file() and "_draw_save" in capfd.readouterr().err


def test_a_pause_in_drawing_is_not_caught_up():
    playback = Playback()
    assert 5 < playback.due(60.0, 0.02) < 20 and playback.due(0.02, 0.02) == 1


def test_speed_and_what_else_belongs_to_a_scene_stays_with_it(user):
    viewer = user.panel.viewer
    viewer.playback.speed = 0.1
    viewer.set("friction", 0.9)
    viewer.step_once()
    viewer.open("tower")
    assert viewer.playback.speed == 1.0
    assert viewer.simulation.settings == viewer.simulation.startSettings
    assert viewer.history.last == 0 and not viewer.plotted


def test_a_body_moved_while_paused_has_no_old_contacts_and_undo_brings_them_back(user):
    viewer = user.panel.viewer
    viewer.view.show("contacts", True)
    while not viewer.simulation.report or not viewer.simulation.report.contactCount:
        viewer.step_once()
    body = viewer.simulation.report.contacts[0].body1
    count = viewer.simulation.report.contactCount
    place = viewer.view.pixels_of(viewer.view.poses[:3, body])[0]
    viewer.hand.grab_at(tuple(map(int, place)))
    viewer.hand.drag_to((int(place[0]) + 30, int(place[1]) - 90))
    viewer.hand.release()
    arrows = viewer.view.overlays.onTop["contacts"]
    assert viewer.simulation.report is None and not len(arrows.points)
    press(user, "Left")
    assert viewer.simulation.report.contactCount == count
    assert len(viewer.view.overlays.onTop["contacts"].points)


def test_a_students_file_is_loaded_again_when_it_is_saved_and_with_r(
    polyscope, tmp_path, monkeypatch
):
    folder = write_submission(tmp_path / "theirs", [])
    source = (folder / "RBSFunctions.py").read_text()
    broken = source.replace("integrate_timestep(self, ", "integrate_timestep(self, oops, ", 1)
    (folder / "RBSFunctions.py").write_text(broken)
    simulation = SceneSimulation(DATA / "mixed-scene.txt", submitted=SubmittedSteps(folder))
    panel = make_panel(simulation, polyscope, monkeypatch, (800, 500))
    monkeypatch.setattr("rbs.window.viewer.WATCH_SECONDS", 0.0)
    viewer = panel.viewer
    viewer.step_once()
    assert viewer.simulation.stepCount == 0 and "TypeError" in viewer.message
    (folder / "RBSFunctions.py").write_text(source + "\n# mended\n")
    polyscope.frame_tick()
    assert "loaded again" in viewer.message
    viewer.step_once()
    assert viewer.simulation.beside.ours.stepCount == 1 and not viewer.message
    (folder / "RBSFunctions.py").write_text("this is no Python\n")
    viewer.restart()
    assert "RBSFunctions.py" in viewer.message
    viewer.step_once()  # with those that worked
    panel.viewer.view.set_callback(None)
    assert viewer.simulation.stepCount == 1
