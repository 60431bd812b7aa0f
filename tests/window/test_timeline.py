"""What is done by hand, kept, undone, branched off and recorded; over an off-screen panel."""

import numpy as np
import pytest
from hands import bits_of, make_steps
from oracles import body
from program import DATA, record
from studentVariants import write_submission

from rbs.program.submittedsteps import SubmittedSteps
from rbs.recordings.lookup import SceneOpener
from rbs.recordings.outputs import QUANTITY_UNITS, step_quantities
from rbs.recordings.recording import Recording
from rbs.recordings.replay import verify
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping.settings import Settings
from rbs.window.hand import PUSH_SPEED, Grab
from rbs.window.history import Playback


def run_of(scene, count, **settings):
    """Bits and quantities of each state of a run without the window."""
    simulation = SceneSimulation(DATA / f"{scene}-scene.txt", Settings(**settings))
    rows = [(bits_of(simulation), step_quantities(simulation))]
    for _ in range(count):
        simulation.step()
        rows.append((bits_of(simulation), step_quantities(simulation)))
    return rows


ACTS = {
    "drag": lambda viewer: move(viewer, 3, 40),
    "push": lambda viewer: viewer.hand.push([0.0, 1.0, 0.0]),
    "fix": lambda viewer: viewer.hand.set_fixed(True),
    "shot": lambda viewer: viewer.hand.shoot((300, 200)),
    "setting": lambda viewer: viewer.set("friction", 0.7),
    "restart": lambda viewer: viewer.restart(),
    "reset": lambda viewer: viewer.restart(True),
}


def grab(viewer, body):
    """Grabs a body, and returns the pixel (x, y)."""
    pixel = tuple(viewer.view.pixels_of(viewer.view.poses[:3, body])[0].round().tolist())
    viewer.hand.grab_at(pixel)
    return pixel


def move(viewer, body, way):
    """Drags a body by some pixels, while paused."""
    x, y = grab(viewer, body)
    for share in (0.5, 1.0):
        viewer.hand.drag_to((x + way, y - share * way))
    viewer.hand.release()


@pytest.mark.parametrize("name", ACTS)
def test_what_is_done_is_undone_and_redone_with_all_that_was_ahead(viewer, name):
    viewer.view.pick(3, viewer.view.poses[:3, 3])
    make_steps(viewer, 9)
    for place in (9, 4):  # at the end, and in the past
        viewer.seek(place)
        kept, before = list(viewer.history.axis), bits_of(viewer.simulation)
        ACTS[name](viewer)
        after = bits_of(viewer.simulation)
        assert after != before and not viewer.history.isAhead
        assert (name in ("restart", "reset")) == (len(viewer.history.axis) == 1)
        make_steps(viewer, 2)
        for _ in range(3):
            viewer.step_back()
        assert bits_of(viewer.simulation) == before
        assert viewer.history.axis[:10] == kept[:10] and viewer.history.place == place
        viewer.redo()
        assert bits_of(viewer.simulation) == after
        viewer.step_back()
        assert bits_of(viewer.simulation) == before


def test_a_push_adds_its_speed_and_a_drag_moves_a_body_with_the_mouse(viewer):
    view, meshes = viewer.view, viewer.simulation.meshes
    for k in (2, 3):  # of other masses
        view.pick(k, view.poses[:3, k])
        viewer.hand.push([0.0, 1.0, 0.0])
        assert meshes[k].linVelocity[0] == pytest.approx([0.0, PUSH_SPEED, 0.0])
    before = view.pixels_of(view.poses[:3, 3])[0]
    move(viewer, 3, 40)
    assert view.pixels_of(view.poses[:3, 3])[0] - before == pytest.approx([40, -40], abs=4.0)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("density", "timeStep"), [(1e-4, 0.3), (60.0, 0.02), (1e5, 4e-3)])
def test_a_body_that_is_dragged_comes_to_the_hand_and_is_never_driven(density, timeStep, seed):
    """Whatever its mass and the step: held at its centre without gravity, it does not overshoot;
    held at a corner with gravity, it swings no further out, and comes to hang below the hand.
    """
    rng = np.random.default_rng(seed)
    for isAtCentre in (True, False):
        mesh = body("long-octahedron", density=density, orientation=rng.normal(size=4))
        grab = Grab(mesh, 0, mesh.position[0] if isAtCentre else mesh.currVertices[0])
        start, gaps = grab.target.copy(), []
        grab.target = start + rng.normal(size=3) * 20.0
        for _ in range(int(2.0 / timeStep) + 200):
            grab.pull(mesh, timeStep)
            gaps.append(grab.target - grab.point(mesh))
            if isAtCentre:
                mesh.position = mesh.position + timeStep * mesh.linVelocity
            else:
                mesh.integrate_timestep(timeStep)
        left, sizes = np.array(gaps) @ (grab.target - start), np.linalg.norm(gaps, axis=1)
        if isAtCentre:
            assert (left >= -1e-9 * left[0]).all() and (np.diff(left) <= 1e-9 * left[0]).all()
            assert sizes[-1] < 1e-3 * sizes[0] and not mesh.angVelocity.any()
        else:
            assert sizes.max() <= 1.5 * sizes[0] and np.abs(mesh.linVelocity).max() < 1e3
            assert sizes[-60:].max() < 0.5 * sizes[0]


@pytest.mark.parametrize("scene", ["mixed", "tower_chain", "stack"])
def test_kept_steps_and_plots_are_those_of_a_run_without_the_window(open_panel, scene):
    settings = {"contactSolver": "soft-step"} if scene == "stack" else {}
    expected = run_of(scene, 45, **settings)
    viewer = open_panel(scene, Settings(**settings)).viewer
    make_steps(viewer, 45)
    for place in (45, 7, 23, 0, 41, 12):
        viewer.seek(place)
        assert bits_of(viewer.simulation) == expected[place][0]
        viewer.history.measure([place, 0])
        found = viewer.history.now.quantities
        assert bits_of(viewer.simulation) == expected[place][0]
        for name in list(QUANTITY_UNITS)[: list(QUANTITY_UNITS).index("contacts")]:
            due = pytest.approx(expected[place][1][name], 1e-9, 1e-9, nan_ok=True)
            assert found[name] == due, name
    viewer.find_report()
    assert viewer.simulation.report is not None
    # and it goes on with the same bits, also from a moment without the solver's state
    viewer.seek(23)
    assert scene != "stack" or viewer.history.now.solver is None
    viewer.history.axis = viewer.history.axis[:24]  # as if nothing were ahead
    for step in range(24, 41):
        viewer.step_once()
        assert bits_of(viewer.simulation) == expected[step][0]


def test_memory_is_limited_and_the_axis_shows_the_gap(viewer, monkeypatch):
    monkeypatch.setattr("rbs.window.history.KEPT_BYTES", 50 * viewer.history.now.size)
    start = bits_of(viewer.simulation)
    make_steps(viewer, 120)
    steps = [moment.stepCount for moment in viewer.history.axis]
    assert steps == [0, *range(steps[1], 121)] and len(steps) <= 51
    assert viewer.history.gap == [0, steps[1]]
    for asked, given in ((2, 0), (steps[1] - 2, steps[1]), (100, 100)):
        viewer.seek_step(asked)
        assert viewer.simulation.stepCount == given
    viewer.seek(0)
    assert bits_of(viewer.simulation) == start
    viewer.restart()  # nothing has changed: no second start
    assert len(viewer.history.axis) == len(steps)


def test_a_click_on_the_axis_gives_the_step_that_it_tells(hands, panel):
    viewer = panel.viewer
    make_steps(viewer, 50)
    hands.click("axis")
    assert 0 < viewer.simulation.stepCount < 20 and len(viewer.history.axis) == 51
    place = viewer.simulation.stepCount
    for key, step in (("Right", 1), ("Ctrl+Shift+Z", 2), ("Left", 1), ("Ctrl+Z", 0)):
        hands.press(key)
        assert viewer.simulation.stepCount == place + step


def test_looking_back_does_not_end_a_recording_but_a_step_from_there_does(viewer):
    viewer.outputs.toggle("recording")
    make_steps(viewer, 12)
    for place in (3, 12, 5):
        viewer.seek(place)
        viewer.step_once()
    viewer.seek(13)
    viewer.view.pick(3, viewer.view.poses[:3, 3])
    viewer.hand.push([0.0, 1.0, 0.0])
    viewer.hand.shoot((300, 200))
    make_steps(viewer, 5)
    viewer.seek(8)
    assert "recording" in viewer.outputs.writers
    viewer.set("gravity", 2.0)
    assert "8" in viewer.message and not viewer.outputs.writers
    (path,) = viewer.outputs.written
    recording = Recording(path)
    assert (recording.lastStep, verify(recording)) == (18, "")
    assert "add" in [one.kind for _, one in recording.changes]


def test_what_is_gone_through_again_is_recorded_with_what_was_done(viewer):
    viewer.step_once()
    x, y = grab(viewer, 2)
    viewer.isPlaying = True
    viewer.hand.drag_to((x + 30, y - 60))
    viewer.step_once()  # dragged
    viewer.hand.release()
    viewer.hand.shoot((300, 200))
    make_steps(viewer, 3)
    last = bits_of(viewer.simulation)
    viewer.seek(1)
    viewer.outputs.toggle("recording")
    for _ in range(5):
        viewer.redo()
    assert bits_of(viewer.simulation) == last
    viewer.outputs.stop()
    recording = Recording(viewer.outputs.written[0])
    assert (recording.firstStep, recording.lastStep) == (1, 5) and verify(recording) == ""
    assert "add" in [one.kind for _, one in recording.changes]


@pytest.mark.parametrize("end", ["button", "restart", "open"])
def test_a_recording_ends_with_what_it_is_of(viewer, end):
    paths = []
    for _ in range(2):
        viewer.outputs.toggle("recording")
        paths.append(viewer.outputs.writers["recording"].path)
        make_steps(viewer, 3)
        ends = {"button": lambda: viewer.outputs.toggle("recording"), "restart": viewer.restart}
        ends.get(end, lambda: viewer.open("tower"))()
        assert not viewer.outputs.writers and viewer.message
    assert len(set(paths)) == 2 and all(verify(Recording(path)) == "" for path in paths)


def test_a_recording_is_gone_through_and_continued_with_its_earlier_steps(open_panel, tmp_path):
    path = record(tmp_path / "tower.h5", SceneSimulation(DATA / "tower-scene.txt"), 40)
    viewer = open_panel(SceneOpener(isBasic=True).open(path)).viewer
    expected = run_of("tower", 42)
    viewer.seek(39)
    viewer.toggle_play()
    viewer.play(0.041)
    assert viewer.simulation.stepCount == 40 and not viewer.isPlaying
    viewer.step_once()
    assert viewer.simulation.stepCount == 40 and viewer.message
    viewer.toggle_play()  # from the start again
    assert viewer.simulation.stepCount == 0 and viewer.isPlaying
    viewer.seek(15)
    viewer.history.axis[3].rows.sum()  # looking changes nothing
    assert bits_of(viewer.simulation)[0] == expected[15][0][0]
    for act in (lambda: grab(viewer, 1), lambda: viewer.hand.shoot((300, 200))):
        act()
        assert viewer.hand.grab is None and viewer.message
    viewer.continue_here()
    assert not viewer.isReplay and not viewer.message and viewer.simulation.stepCount == 15
    viewer.step_once()
    assert bits_of(viewer.simulation)[0] == expected[16][0][0]
    viewer.seek_step(4)
    assert bits_of(viewer.simulation)[0] == expected[4][0][0]
    viewer.hand.shoot((300, 200))  # goes on from there
    viewer.step_back()
    viewer.seek_step(16)
    assert bits_of(viewer.simulation)[0] == expected[16][0][0]


def test_settings_are_undone_and_a_dragged_slider_counts_once(viewer):
    settings = viewer.simulation.settings
    for value in (0.1, 0.2, 0.3):
        viewer.set("friction", value)
    viewer.step_once()
    viewer.set("gravity", 1.0)
    for friction, gravity in ((0.3, 9.8), (0.3, 9.8), (0.0, 9.8)):
        viewer.step_back()
        assert (settings.friction, settings.gravity) == (friction, gravity)
    viewer.step_back()
    assert viewer.message and viewer.history.place == 0


def test_a_step_that_fails_is_told_and_changes_nothing(viewer):
    viewer.step_once()
    viewer.simulation.meshes[3].linVelocity = np.full((1, 3), 1e300)
    viewer.step_once()
    assert viewer.message and viewer.history.place == 1
    viewer.step_once()
    assert viewer.simulation.stepCount == 2 and not viewer.message


def test_another_scene_begins_with_its_own_settings_and_so_does_a_reset(open_panel):
    viewer = open_panel("mixed", isBasic=False).viewer
    viewer.playback.speed = 0.1
    viewer.set("friction", 0.9)
    viewer.open("wall")
    assert viewer.playback.speed == 1.0 and len(viewer.history.axis) == 1
    assert viewer.simulation.settings == viewer.simulation.startSettings
    viewer.set("gravity", 1.6)
    for isReset, gravity in ((False, 1.6), (True, 9.8)):
        viewer.restart(isReset)
        assert viewer.simulation.settings.gravity == gravity


def test_a_pause_in_drawing_is_not_caught_up_and_a_slow_scene_says_so():
    playback = Playback()
    assert 5 < playback.due(60.0, 0.02) < 20 and playback.due(0.02, 0.02) == 1
    for _ in range(12):
        playback.advance(0.2, 0.02, lambda: False)  # a step each 0.2 s
    assert playback.reached == pytest.approx(0.1, rel=0.1)


def test_what_cannot_be_opened_is_told(viewer, tmp_path):
    scene = viewer.simulation
    (tmp_path / "broken.json").write_text("2\n")
    for name in (tmp_path / "broken.json", tmp_path / "none.h5", tmp_path, "stresss"):
        viewer.open(name)
        assert viewer.message.startswith(f"{name}:") and viewer.simulation is scene


@pytest.mark.parametrize("method", ["add", "save"])
def test_a_file_that_cannot_be_written_ends_and_is_reported(viewer, monkeypatch, method):
    viewer.outputs.toggle("recording")

    def fail(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(viewer.outputs.writers["recording"], method, fail)
    viewer.step_once()
    assert ("recording" in viewer.outputs.writers) == (method == "save")
    viewer.outputs.stop()
    assert "No space left on device" in viewer.message and not viewer.outputs.writers
    assert viewer.simulation.stepCount == 1


def test_a_students_files_are_dropped_loaded_again_and_an_endless_loop_is_stopped(
    open_panel, polyscope, tmp_path, monkeypatch
):
    folder = write_submission(tmp_path / "theirs", [])
    path = folder / "RBSFunctions.py"
    source = path.read_text()
    # which waits, and is given the time that a busy machine takes for what is right
    loop = "\ndef resolve_collision(*all):\n    import time\n    while True: time.sleep(0.01)\n"
    monkeypatch.setattr("rbs.window.viewer.FUNCTION_SECONDS", 3.0)
    monkeypatch.setattr("rbs.window.viewer.WATCH_SECONDS", 0.0)
    viewer = open_panel("mixed").viewer
    viewer._opener = SceneOpener(isBasic=True, loadFunctions=SubmittedSteps)  # noqa: SLF001
    (folder / "lock.py").symlink_to("nowhere")  # as Emacs locks files
    viewer.open(path)
    assert viewer.simulation.submitted.folder == folder and not viewer.message
    viewer.step_once()
    for text, isTold in (("this is no Python\n", True), (source + loop, False)):
        path.write_text(text)
        polyscope.frame_tick()
        assert (path.name in viewer.message) == isTold and viewer.simulation.stepCount == 0
        viewer.step_once()  # with those that worked, or those that are new
        assert viewer.simulation.beside.ours.stepCount == 1 and not viewer.message
    viewer.simulation.submitted.seconds = 1.0
    while not viewer.message:
        viewer.step_once()
        assert viewer.simulation.stepCount < 60
    assert "RBSFunctions.py:" in viewer.message
    step = viewer.simulation.stepCount
    viewer.step_back()  # the window lives on
    assert viewer.simulation.stepCount == step - 1
    viewer.view.pick(0, viewer.simulation.meshes[0].position[0])
    viewer.hand.set_fixed(True)
    assert viewer.simulation.beside.ours.meshes[0].isFixed
