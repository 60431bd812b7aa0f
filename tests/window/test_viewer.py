"""The viewer: what is drawn where, and what buttons and keys do.

Pictures are judged by their pixels. Polyscope draws off-screen here; the real window is opened by
tests/window/test_window.py.
"""

import colorsys
import json
import math
import time
from collections import Counter
from dataclasses import asdict
from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest
from opengl import require_opengl
from program import DATA, record

from Quaternion import QConj, QRotate
from rbs.appearance.colours import (
    COLOURINGS,
    CONSTRAINT_COLOURS,
    FIXED_COLOUR,
    LONE_COLOUR,
    PALETTE,
    PICKED_COLOUR,
    SEEN_BACKGROUND,
    VIRIDIS,
    BodyColours,
    contact_islands,
)
from rbs.appearance.drawables import (
    GROUND_SQUARES,
    SHADOW_SLANT,
    ConstraintLines,
    box_lines,
    cast_shadows,
    find_creases,
    flatten_meshes,
    grid_cells,
    ground_squares,
    surface_points,
)
from rbs.appearance.framing import FRAME_MARGIN, VIEW_DIRECTION, frame_camera
from rbs.appearance.pictureoptions import OVERLAYS, VIDEO_ENDINGS, PictureOptions, video_timing
from rbs.geometry.broadphase import grid_overlaps
from rbs.pictures.cameras import CameraError, load_camera, save_camera
from rbs.pictures.capture import (
    SEEN_THROUGH,
    SHADOW_OPACITY,
    PictureSeries,
    Video,
    averaged,
    start_view,
    take_picture,
)
from rbs.pictures.overlays import HELD_CONTACT_STEPS
from rbs.pictures.view import LAYERS, MOST_CREASES, SceneView, start_polyscope
from rbs.program.catalogue import SCENES
from rbs.program.opening import find_file, list_files, open_file
from rbs.program.suggestions import SceneOpener, apply_settings
from rbs.recordings.recording import Recording
from rbs.recordings.replay import Replay, restored_settings, verify
from rbs.recordings.statistics import step_quantities
from rbs.scenes.changes import fix
from rbs.scenes.grabbing import shot
from rbs.scenes.messages import counted
from rbs.scenes.scenefiles import list_scenes, scene_name
from rbs.scenes.simulation import Simulation
from rbs.scenes.textfiles import SceneError
from rbs.stepping.reports import StepReport
from rbs.stepping.settings import CHOSEN, Settings
from rbs.window.layout import TIMELINE_HEIGHT, arrange
from rbs.window.panel import Panel
from rbs.window.playback import SPEEDS, STEPPING_SECONDS, Playback, speed_name
from rbs.window.viewer import Viewer
from RBSFunctions import refresh_vertices
from RigidBodySimulation import load_mesh_file, load_scene_file

# Shading changes the brightness and the saturation of a colour, and moves its hue, on a circle of
# length 1, by less than this. The ends of the scale of densities lie 0.4 apart.
SAME_HUE = 0.03
# What the ground, the shadows and fixed bodies stay below, in HSV's saturation, and what the
# colours of the others stay above.
GREY = 0.12


class StillView:
    """Stands for a SceneView where nothing is drawn; counts what it is asked for."""

    def __init__(self):
        self.refreshed = self.rebuilt = 0
        self.picked = None

    def refresh(self):
        self.refreshed += 1

    def rebuild(self, simulation):
        self.rebuilt += 1

    def picked_point(self):
        return np.array([1.0, 2.0, 3.0])

    def set_resizable(self, isResizable):
        pass

    def show_spring(self, ends):
        self.spring = ends


def make_viewer(simulation, view):
    opener = SceneOpener(simulation, {}, isBasic=True)
    return Viewer(simulation, view, opener, list_files, step_quantities)


@pytest.fixture
def viewer():
    """A Viewer of the mixed scene that draws nothing."""
    return make_viewer(Simulation(DATA / "mixed-scene.txt"), StillView())


@pytest.fixture
def replay(tmp_path):
    """A Viewer of a recording of 40 steps of the tower that draws nothing."""
    path = record(tmp_path / "tower.h5", Simulation(DATA / "tower-scene.txt"), 40)
    return make_viewer(open_file(path), StillView())


# --------------------------------------------------------------------------------------------------
# What the buttons do
# --------------------------------------------------------------------------------------------------


@pytest.fixture
def instant(monkeypatch):
    """Stepping takes no time, however busy the machine is."""
    monkeypatch.setattr("rbs.window.playback.time", SimpleNamespace(perf_counter=lambda: 0.0))


def test_playing_keeps_pace_with_the_clock(viewer, instant):
    viewer.play(1.0)
    assert viewer.simulation.stepCount == 0  # paused
    viewer.toggle_play()
    for _ in range(10):
        viewer.play(0.008)  # 0.08 s in all, of steps of 0.02 s
    assert viewer.simulation.stepCount == 4
    viewer.play(0.041)
    assert viewer.simulation.stepCount == 6
    assert viewer.view.refreshed == 11
    viewer.toggle_play()
    viewer.play(0.1)
    assert viewer.simulation.stepCount == 6


def test_a_long_pause_in_drawing_is_not_caught_up_with(viewer):
    viewer.toggle_play()
    viewer.play(3600.0)
    assert 1 <= viewer.simulation.stepCount <= 5


def test_slow_steps_do_not_keep_the_window_from_drawing(viewer, monkeypatch):
    made = []

    def slow_step():
        made.append(1)
        time.sleep(0.06)

    viewer.simulation.stepSeconds = 0.06
    monkeypatch.setattr(viewer.simulation, "step", slow_step)
    viewer.toggle_play()
    viewer.play(0.1)
    assert len(made) == 1


def test_long_time_steps_play_too(viewer, instant):
    viewer.simulation.settings.timeStep = 0.5
    viewer.toggle_play()
    for _ in range(11):
        viewer.play(0.1)
    assert viewer.simulation.stepCount == 2


def test_step_and_reset_pause(viewer):
    start = viewer.simulation.state()["positions"]
    viewer.toggle_play()
    viewer.step_once()
    assert not viewer.isPlaying and viewer.simulation.stepCount == 1
    viewer.toggle_play()
    viewer.reset()
    assert not viewer.isPlaying and viewer.step_milliseconds() == {}
    np.testing.assert_array_equal(viewer.simulation.state()["positions"], start)


@pytest.mark.parametrize("solver", ["impulse", "soft-step"])
def test_milliseconds_of_phases_add_up_to_those_of_the_step(solver):
    simulation = Simulation(DATA / "tower-scene.txt", Settings(contactSolver=solver))
    viewer = make_viewer(simulation, StillView())
    seconds = []
    for _ in range(3):
        viewer.step_once()
        seconds.append(simulation.stepSeconds)
    step, *phases, other = viewer.step_milliseconds().items()
    assert step == ("step", pytest.approx(1e3 * np.mean(seconds)))
    assert other[0] == "other" and other[1] >= 0.0
    assert [name for name, _ in phases] == {
        "impulse": ["integrate", "collisions", "ground", "constraints"],
        "soft-step": ["gather", "collisions", "contactSolver", "writeBack"],
    }[solver]
    assert sum(ms for _, ms in phases) + other[1] == pytest.approx(step[1])


def test_filming_and_reading_are_not_called_simulating(viewer, replay, monkeypatch):
    clock = [0.0]
    for module in ("viewer", "playback"):
        monkeypatch.setattr(f"rbs.{module}.time", SimpleNamespace(perf_counter=lambda: clock[0]))

    def takes(seconds):
        def act(*arguments):
            clock[0] += seconds

        return act

    monkeypatch.setattr(viewer.simulation, "step", takes(0.001))
    monkeypatch.setattr(replay.simulation, "seek", takes(0.002))
    viewer.video = SimpleNamespace(add=takes(0.016))
    for one in (viewer, replay):
        one.toggle_play()
        for _ in range(4):
            one.play(0.021)
    assert viewer.frame_milliseconds() == pytest.approx(
        {"frame": 21.0, "simulating": 1.0, "filming": 16.0, "drawing, waiting": 4.0}
    )
    assert replay.frame_milliseconds() == pytest.approx(
        {"frame": 21.0, "reading the recording": 2.0, "drawing, waiting": 19.0}
    )


@pytest.mark.parametrize(("speed", "steps"), [(0.1, 1), (0.25, 2), (1.0, 10), (4.0, 40)])
def test_scene_plays_at_the_speed_that_is_asked_for(viewer, instant, speed, steps):
    viewer.playback.speed = speed
    viewer.toggle_play()
    for _ in range(20):
        viewer.play(0.0101)  # 0.202 s in all, of steps of 0.02 s
    assert viewer.simulation.stepCount == steps
    assert viewer.playback.pace() == pytest.approx(steps * 0.02 / 0.202)
    viewer.toggle_play()
    viewer.play(0.01)
    assert viewer.playback.pace() is None


def test_as_fast_as_possible_fills_the_time_of_a_frame(viewer, monkeypatch):
    clock = [0.0]
    monkeypatch.setattr("rbs.window.playback.time", SimpleNamespace(perf_counter=lambda: clock[0]))
    step = viewer.simulation.step

    def timed_step():
        clock[0] += 0.003
        step()

    monkeypatch.setattr(viewer.simulation, "step", timed_step)
    viewer.playback.speed = math.inf
    viewer.toggle_play()
    viewer.play(0.001)
    assert viewer.simulation.stepCount == math.ceil(STEPPING_SECONDS / 0.003)


def test_pace_is_that_of_the_last_second():
    playback = Playback()
    assert playback.pace() is None
    for k in range(100):
        playback.note(0.1, 0.1 if k < 80 else 0.025)
    assert playback.pace() == pytest.approx(0.25)
    assert [speed_name(speed) for speed in SPEEDS] == [
        "0.1 ×",
        "0.25 ×",
        "1 ×",
        "4 ×",
        "unlimited",
    ]


def test_values_out_of_range_are_refused_and_change_nothing():
    settings = Simulation(DATA / "tet-scene.txt").settings
    for name, values, cause in (
        ("restitution", (-0.1, 1.0001, math.nan, math.inf), "restitution must be .*, 0 to 1, not"),
        ("timeStep", (0.0, -0.02, math.nan, math.inf), "timeStep must be .*, 1e-12 to 1000, not"),
        ("friction", (-0.1, math.nan, math.inf), "friction must be .* of 0 or more, not"),
    ):
        before = getattr(settings, name)
        for value in values:
            with pytest.raises(ValueError, match=cause):
                settings.change(name, value)
        assert getattr(settings, name) == before
        settings.change(name, 0.123456789)
        assert getattr(settings, name) == 0.123456789


def test_scenes_beside_the_current_one_can_be_chosen(viewer):
    files = {one.name: one.path for one in viewer.files()}
    assert files["tower"] == DATA / "tower-scene.txt" and viewer.name() == "mixed"
    viewer.toggle_play()
    viewer.simulation.settings.restitution = 0.25
    viewer.open(files["tower"])
    assert not viewer.isPlaying and viewer.view.rebuilt == 1
    assert len(viewer.simulation.meshes) == 9 and viewer.simulation.stepCount == 0
    assert viewer.simulation.settings.restitution == 0.25


def test_broken_file_shows_its_error_and_keeps_the_current_scene(viewer, tmp_path):
    for name, cause in (
        ("broken-scene.txt", ":1: the file ends before body 1 of 2"),
        ("poem.txt", ":1: not a scene: the number of bodies"),
        ("broken.h5", ": not a recording"),
        ("broken.json", ":1: this is not a JSON file"),
    ):
        (tmp_path / name).write_text("2\n" if name.endswith("scene.txt") else "nothing")
        viewer.step_once()
        count = viewer.simulation.stepCount
        viewer.open(tmp_path / name)
        assert viewer.message.startswith(f"{tmp_path / name}{cause}")
        assert viewer.simulation.stepCount == count and viewer.view.rebuilt == 0
    viewer.open(DATA / "tet-scene.txt")
    assert viewer.message == ""


def test_video_that_meets_a_full_disk_ends_and_is_told(viewer):
    class FullVideo:
        path, count = "out/v.mp4", 3

        def add(self, simulation):
            raise OSError(28, "the video could not be written", self.path)

        def save(self, simulation):
            pass

    viewer.video = FullVideo()
    viewer.step_once()
    assert viewer.message == "cannot write: the video could not be written"
    assert viewer.video is None and viewer.simulation.stepCount == 1


def test_video_that_cannot_be_put_in_its_place_is_told(viewer):
    class FullVideo:
        path, count, isClosed = "out/v.mp4", 3, False

        def save(self, simulation):
            raise OSError(28, "No space left on device")

        def close(self):
            FullVideo.isClosed = True

    viewer.video = FullVideo()
    viewer.stop_video()
    assert viewer.message == "cannot write: No space left on device" and viewer.saved == ""
    assert viewer.video is None and FullVideo.isClosed


def test_plots_grow_while_they_are_open_and_begin_anew_with_a_reset(viewer):
    viewer.step_once()
    assert len(viewer.history) == 0
    viewer.isMeasuring = True
    viewer.step_once()
    viewer.step_once()
    times = [row[0] for row in viewer.history]
    np.testing.assert_allclose(times, [0.04, 0.06])
    assert viewer.history[0][1]["totalEnergy"] > 0.0
    viewer.reset()
    assert len(viewer.history) == 0


def test_replay_plays_at_any_speed_and_stops_at_its_ends(replay, instant):
    simulation = replay.simulation
    replay.toggle_play()
    replay.play(0.041)
    assert simulation.stepCount == 2
    replay.playback.isBackwards = True
    replay.play(0.021)
    assert simulation.stepCount == 1
    replay.play(0.1)
    assert simulation.stepCount == 0 and not replay.isPlaying
    replay.playback.speed, replay.playback.isBackwards = 4.0, False
    replay.seek(30)
    replay.toggle_play()
    replay.play(0.1)
    replay.play(0.1)
    assert simulation.stepCount == 40 and not replay.isPlaying
    replay.toggle_play()  # from the start again
    assert simulation.stepCount == 0 and replay.isPlaying
    replay.step_once()
    assert simulation.stepCount == 1 and replay.step_milliseconds() == {}


def test_settings_outlive_a_replay(viewer, replay, tmp_path):
    viewer.simulation.settings.friction = 0.7
    viewer.open(tmp_path / "tower.h5")
    assert viewer.isReplay and viewer.simulation.lastStep == 40
    viewer.open(DATA / "tower-scene.txt")
    assert not viewer.isReplay and viewer.simulation.settings.friction == 0.7


# --------------------------------------------------------------------------------------------------
# Bodies that are pushed, fixed and freed
# --------------------------------------------------------------------------------------------------


def test_push_changes_the_momentum_by_the_impulse_and_the_spin_by_its_moment():
    simulation = Simulation(DATA / "mixed-scene.txt")
    for _ in range(30):
        simulation.step()
    mesh = simulation.meshes[3]
    impulse, point = np.array([3e4, -2e4, 5e4]), mesh.position[0] + [1.0, 2.0, -3.0]
    inertia = np.linalg.inv(mesh.get_rotated_inv_IT())
    linear, angular = mesh.linVelocity[0].copy(), mesh.angVelocity[0].copy()
    mesh.push(impulse, point)
    np.testing.assert_allclose(mesh.mass * (mesh.linVelocity[0] - linear), impulse)
    moment = np.cross([1.0, 2.0, -3.0], impulse)
    np.testing.assert_allclose(inertia @ (mesh.angVelocity[0] - angular), moment)


def test_fixed_body_stands_still_and_a_freed_one_falls_as_before(viewer):
    simulation = viewer.simulation
    mesh = simulation.meshes[2]
    invMass, invIT = mesh.invMass, mesh.invIT.copy()
    viewer.step_once()
    viewer.view.picked = 2
    viewer.set_fixed(True)
    where = mesh.position.copy()
    viewer.push([0.0, 1.0, 0.0])
    assert not mesh.linVelocity.any() and not mesh.angVelocity.any()
    viewer.step_once()
    np.testing.assert_array_equal(mesh.position, where)
    viewer.set_fixed(False)
    assert mesh.invMass == invMass
    np.testing.assert_array_equal(mesh.invIT, invIT)
    viewer.step_once()
    np.testing.assert_allclose(mesh.linVelocity, [[0.0, -9.8 * 0.02, 0.0]], rtol=1e-12)
    viewer.set_fixed(True)
    viewer.reset()
    assert not mesh.isFixed and mesh.invMass == invMass


class HandsView(StillView):
    """A StillView in which a pixel is (body, x) and shows that body x metres from its middle."""

    size = 80.0

    def __init__(self, simulation):
        super().__init__()
        self.simulation = simulation
        self.spring = None

    def body_at(self, pixel):
        body, x = pixel
        if body < 0:
            return None, None
        return body, self.simulation.meshes[body].position[0] + [x, 0.0, 0.0]

    def distance_of(self, point):
        return 100.0

    def point_at(self, pixel, distance):
        return np.array([0.0, 30.0, pixel[1]])

    def aim(self, pixel):
        return np.array([0.0, 20.0, 60.0]), np.array([0.0, 0.0, -1.0])


@pytest.fixture
def hands(tmp_path, monkeypatch):
    """A Viewer of the mixed scene with hands, which writes into a folder of its own."""
    monkeypatch.chdir(tmp_path)
    simulation = Simulation(DATA / "mixed-scene.txt")
    return make_viewer(simulation, HandsView(simulation))


def test_dragged_body_follows_the_hand_and_flies_on_when_it_is_let_go(hands):
    simulation, view = hands.simulation, hands.view
    hands.grab_at((-1, 0.0))
    assert hands.grab is None
    hands.grab_at((2, 1.0))
    assert hands.grab.body == 2 and hands.grab.target == pytest.approx(
        simulation.meshes[2].position[0] + [1.0, 0.0, 0.0]
    )
    hands.drag_to((0, 15.0))
    np.testing.assert_allclose(view.spring[1], [0.0, 30.0, 15.0])
    for _ in range(60):
        hands.step_once()
    point = hands.grab.point(simulation.meshes[2])
    assert np.linalg.norm(point - [0.0, 30.0, 15.0]) < 1.0  # it hangs there, and swings
    hands.drag_to((0, 35.0))
    for _ in range(6):
        hands.step_once()
    speed = simulation.meshes[2].linVelocity[0, 2]
    assert speed > 10.0
    hands.release()
    assert hands.grab is None and view.spring is None
    hands.step_once()
    assert simulation.meshes[2].linVelocity[0, 2] == speed


def test_fixed_bodies_and_recordings_are_not_dragged(hands, replay):
    hands.simulation.meshes[1].isFixed = True
    hands.grab_at((1, 0.0))
    assert hands.grab is None and hands.message == "cylinder 1 is fixed"
    replay.view = HandsView(replay.simulation)
    for act in (lambda: replay.grab_at((1, 0.0)), lambda: replay.shoot((0, 0))):
        replay.message = ""
        act()
        assert replay.grab is None
        assert replay.message == "Recordings are read-only; --resume continues from one"


def test_shots_are_counted_and_gone_with_a_reset(hands, monkeypatch):
    monkeypatch.setattr("rbs.window.viewer.MOST_SHOTS", 2)
    for _ in range(3):
        hands.shoot((0, 0))
    assert len(hands.simulation.meshes) == 17 and "Limit of 2 balls" in hands.message
    hands.grab_at((8, 0.0))  # a ball can be dragged too
    hands.step_once()
    hands.reset()
    assert len(hands.simulation.meshes) == 15 and hands.grab is None
    hands.simulation.submitted = object()
    hands.shoot((0, 0))
    assert len(hands.simulation.meshes) == 15 and "--functions" in hands.message


@pytest.mark.parametrize("end", ["button", "reset", "open", "scene's end"])
def test_session_is_recorded_until_it_ends(hands, tmp_path, end):
    simulation = hands.simulation
    hands.step_once()
    hands.view.picked = 3
    hands.push([0.0, 1.0, 0.0])
    hands.toggle_recording()
    for step in range(30):
        if step == 5:
            hands.grab_at((2, 1.0))
            hands.drag_to((0, 15.0))
        if step == 20:
            hands.release()
            hands.shoot((0, 0))
        if step == 25:
            hands.set_fixed(True)
        hands.step_once()
    last = simulation.state()
    hands.push([1.0, 0.0, 0.0])  # before no step
    if end == "button":
        hands.toggle_recording()
    elif end == "reset":
        hands.reset()
    elif end == "open":
        hands.open("tower")
    else:
        hands.stop_recording()
    assert hands.recorder is None
    assert hands.saved == "saved out/mixed/recording.h5, 30 steps"
    recording = Recording(tmp_path / "out" / "mixed" / "recording.h5")
    assert (recording.firstStep, recording.lastStep) == (1, 31)
    frame = recording.frame(31)
    np.testing.assert_array_equal(frame["positions"], last["positions"])
    assert verify(recording) == ""


def test_recording_that_cannot_be_written_ends_and_is_told(hands, tmp_path):
    hands.toggle_recording()
    hands.step_once()

    def fail(simulation):
        raise OSError(28, "No space left on device")

    hands.recorder.add = fail
    hands.step_once()
    assert hands.recorder is None and hands.simulation.stepCount == 2
    assert hands.message == "cannot write: No space left on device"


def test_all_steps_of_a_paused_session_can_be_read(hands, monkeypatch):
    monkeypatch.setattr("rbs.recordings.recording.FLUSH_SECONDS", math.inf)
    hands.toggle_recording()
    path = hands.recorder.path
    for _ in range(7):
        hands.step_once()
    hands.play(0.02)  # a frame while nothing moves
    frame = Recording(path).frame(7)
    for name, values in hands.simulation.state().items():
        np.testing.assert_array_equal(frame[name], values)
    hands.step_once()
    hands.stop_recording()
    assert Recording(path).lastStep == 8


def test_a_replay_is_not_recorded(replay, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    replay.toggle_recording()
    assert replay.recorder is None
    assert replay.message == "Recordings are read-only; --resume continues from one"
    replay.step_once()
    assert replay.simulation.stepCount == 1 and not (tmp_path / "out").exists()


def test_reset_restores_what_the_scene_began_with_and_restart_does_not(tmp_path):
    simulation = Simulation(DATA / "slide-scene.txt")
    apply_settings(simulation, {})
    opener = SceneOpener(simulation, {})
    viewer = Viewer(simulation, StillView(), opener, list_files, step_quantities)
    viewer.simulation.settings.friction = 0.9
    viewer.step_once()
    viewer.restart()
    assert viewer.simulation.settings.friction == 0.9 and viewer.simulation.stepCount == 0
    viewer.reset()
    assert viewer.simulation.settings.friction == 0.2
    # What was changed by hand goes on to the next scene, which begins with it.
    viewer.simulation.settings.timeStep = 0.01
    viewer.open("incline")
    settings = viewer.simulation.settings
    assert (settings.friction, settings.timeStep) == (0.4, 0.01)
    settings.friction = 0.9
    viewer.reset()
    assert (settings.friction, settings.timeStep) == (0.4, 0.01)


def test_names_are_found_as_the_command_line_takes_them(tmp_path, monkeypatch):
    home, beside = tmp_path / "home", tmp_path / "scenes"
    for folder in (home, beside):
        folder.mkdir()
        (folder / "box.mesh").write_bytes((DATA / "box.mesh").read_bytes())
        (folder / "own-scene.txt").write_text("1\nbox.mesh 1 0 0 9 0 1 0 0 0\n")
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.chdir(tmp_path)
    assert find_file("~/own-scene.txt", beside) == home / "own-scene.txt"
    assert find_file("own-scene.txt", beside) == beside / "own-scene.txt"
    assert find_file("own", beside) == beside / "own-scene.txt"
    assert find_file("scenes/own-scene.txt", "/").resolve() == beside / "own-scene.txt"
    assert find_file("tower", beside) == DATA / "tower-scene.txt"
    with pytest.raises(SceneError, match="no such scene.*; similar: tower"):
        find_file("towr", beside)
    with pytest.raises(SceneError, match="no such file"):
        find_file("~nobody-at-all/x-scene.txt", beside)
    listed = list_files(beside)
    assert listed[0][:2] == ("beside this scene", "own")
    names = [one.name for one in listed]
    assert len(names) == len(set(names)) and {"tower", "bridge"} <= set(names)


def test_every_scene_of_ours_has_a_line():
    known = {name for lines in SCENES.values() for name in lines}
    assert {scene_name(path) for path in list_scenes(DATA)} == known
    assert all(line and len(line) <= 60 for lines in SCENES.values() for line in lines.values())


def test_words_are_counted():
    assert counted(1, "contact") == "1 contact" and counted(0, "body") == "0 bodies"
    assert counted(2, "constraint visit") == "2 constraint visits"


# --------------------------------------------------------------------------------------------------
# The look, as numbers
# --------------------------------------------------------------------------------------------------


def test_colours_go_by_the_logarithm_of_the_density(tmp_path):
    (tmp_path / "box.mesh").write_bytes((DATA / "box.mesh").read_bytes())
    densities = [10, 1000, 100, 5]
    rows = [f"box.mesh {d} {int(d == 5)} 0 {20 * k} 0 1 0 0 0" for k, d in enumerate(densities)]
    (tmp_path / "a-scene.txt").write_text("\n".join(["4", *rows]))
    meshes = load_scene_file(tmp_path / "a-scene.txt")
    colours = BodyColours(meshes)
    scene = SimpleNamespace(meshes=meshes, report=None)
    before = colours.of(scene, "density")
    light, heavy, middle, fixed = before
    np.testing.assert_allclose(light, VIRIDIS[0])
    np.testing.assert_allclose(heavy, VIRIDIS[-1])
    np.testing.assert_allclose(middle, VIRIDIS[len(VIRIDIS) // 2])
    np.testing.assert_allclose(fixed, FIXED_COLOUR)
    rows = colours.legend(scene, "density")
    assert [text for text, _ in rows] == [
        "density 10 kg/m³",
        "density 100 kg/m³",
        "density 1000 kg/m³",
        "fixed",
    ]
    np.testing.assert_allclose(rows[1][1], middle)
    one = SimpleNamespace(meshes=meshes[:1])
    alone = BodyColours(one.meshes).of(one, "density")
    np.testing.assert_allclose(alone, VIRIDIS[[len(VIRIDIS) // 2]])
    # What is fixed or freed recolours no other.
    meshes[0].isFixed, meshes[3].isFixed = True, False
    np.testing.assert_array_equal(colours.of(scene, "density")[1:3], before[1:3])
    np.testing.assert_array_equal(colours.of(scene, "density")[0], FIXED_COLOUR)


def test_lightness_falls_from_light_to_heavy():
    # Relative luminance: what remains of a colour for those who see none.
    linear = np.where(VIRIDIS > 0.04045, ((VIRIDIS + 0.055) / 1.055) ** 2.4, VIRIDIS / 12.92)
    assert np.all(np.diff(linear @ [0.2126, 0.7152, 0.0722]) < 0.0)


@pytest.mark.parametrize(
    ("name", "count"),
    # A box has 12 edges, four of which are no diagonals. The cylinder shows its two rims.
    [("box", 12), ("tetrahedron", 6), ("octahedron", 12), ("cylinder", 40), ("ellipsoid", 0)],
)
def test_bodies_show_their_edges_and_no_diagonals(name, count):
    vertices, faces, _ = load_mesh_file(DATA / f"{name}.mesh")
    creases = find_creases(vertices, faces)
    assert len(creases) == count
    assert len({frozenset(edge) for edge in creases.tolist()}) == count
    if name == "box":  # along one axis each
        assert np.all(np.count_nonzero(np.diff(vertices[creases], axis=1), axis=2) == 1)


def lines_along_x(*bounds):
    """`ConstraintLines` of two bodies: per pair of bounds, between the next vertices of both."""
    meshes = [SimpleNamespace(currVertices=np.zeros((len(bounds) + 2, 3))) for _ in range(2)]
    constraints = [
        [0, k, 1, k, bound, upper]
        for k, pair in enumerate(bounds)
        for bound, upper in zip(pair, (False, True), strict=True)
    ]
    return ConstraintLines(SimpleNamespace(meshes=meshes, constraints=constraints))


@pytest.mark.parametrize(
    ("bounds", "places"),
    # Distance to place on the scale: 0 slack, 1 taut, 2 exceeded by a twentieth of the upper bound.
    [
        pytest.param((0.0, 2.0), {0.0: 0, 0.5: 0.25, 2.0: 1, 2.05: 1.5, 2.1: 2, 9.0: 2}, id="rope"),
        pytest.param(
            (0.9, 1.1), {1.0: 0, 0.95: 0.5, 0.9: 1, 1.1: 1, 1.155: 2, 0.845: 2, 0.2: 2}, id="band"
        ),
        pytest.param((4.0, 4.0), {4.0: 1, 4.1: 1.5, 3.9: 1.5, 4.2: 2, 3.8: 2}, id="rod"),
        pytest.param((0.0, 0.0), {0.0: 1, 0.5: 1.5, 1.0: 2}, id="no length"),
    ],
)
def test_constraint_lines_show_by_their_colour_how_taut_they_are(bounds, places):
    lines = lines_along_x(*[bounds] * len(places))
    distances = np.array(list(places))
    vertices = np.zeros((2 * (len(places) + 2), 3))
    vertices[len(places) + 2 : 2 * len(places) + 2, 0] = distances
    assert lines.ends.tolist() == [[k, len(places) + 2 + k] for k in range(len(places))]
    nodes = lines.nodes(vertices)
    assert np.array_equal(nodes[1::2, 0] - nodes[::2, 0], distances)
    low = np.minimum(np.array(list(places.values()), dtype=float).astype(int), 1)
    part = (np.array(list(places.values())) - low)[:, None]
    expected = (1 - part) * CONSTRAINT_COLOURS[low] + part * CONSTRAINT_COLOURS[low + 1]
    np.testing.assert_allclose(lines.colours(vertices), expected, atol=1e-12)


def test_two_bounds_are_one_line_and_the_tighter_ones_count():
    simulation = Simulation(DATA / "cube-scene.txt")
    lines = ConstraintLines(simulation)
    assert len(simulation.constraints) == 56 and lines.ends.shape == (28, 2)
    vertices = np.concatenate([mesh.currVertices for mesh in simulation.meshes])
    lengths = np.linalg.norm(np.diff(vertices[lines.ends], axis=1)[:, 0], axis=1)
    np.testing.assert_allclose([lines.least, lines.most], [lengths, lengths], rtol=1e-14)
    # Rods as long as at the start: taut.
    np.testing.assert_allclose(lines.colours(vertices), [CONSTRAINT_COLOURS[1]] * 28, atol=1e-9)
    simulation.constraints += [
        [*simulation.constraints[0][:4], bound, upper]
        for bound in (1.0, 99.0)
        for upper in (False, True)
    ]
    lines = ConstraintLines(simulation)
    assert (lines.least[0], lines.most[0], len(lines.ends)) == (99.0, 1.0, 28)
    assert ConstraintLines(Simulation(DATA / "tet-scene.txt")).ends.shape == (0, 2)


def test_camera_sees_all_of_a_scene_and_stands_no_further_than_it_must():
    generator = np.random.default_rng(3)
    for aspect in (0.5, 1.0, 16 / 9):
        points = generator.normal(size=(50, 3)) * [30.0, 5.0, 10.0] + [7.0, 20.0, -3.0]
        position, target = frame_camera(points, VIEW_DIRECTION, 45.0, (900 * aspect, 900))
        x, y, depth = in_camera(points, position, target)
        half = math.tan(math.radians(22.5))
        reach = np.maximum(np.abs(x) / (depth * half * aspect), np.abs(y) / (depth * half))
        assert np.all(depth > 0.0)
        assert np.max(reach) == pytest.approx(1.0 - FRAME_MARGIN)


@pytest.mark.parametrize("margins", [(320, 0, 320, 0), (240, 0, 0, 66), (0, 30, 250, 90)])
def test_camera_frames_a_scene_beside_the_panels(margins):
    generator = np.random.default_rng(4)
    points = generator.normal(size=(60, 3)) * [40.0, 6.0, 12.0] + [-3.0, 9.0, 5.0]
    width, height = 1280, 720
    position, target = frame_camera(points, VIEW_DIRECTION, 45.0, (width, height), margins)
    right, up, depth = in_camera(points, position, target)
    scale = height / 2 / math.tan(math.radians(22.5)) / depth
    x, y = width / 2 + scale * right, height / 2 - scale * up
    left, top, rightMargin, bottom = margins
    seenWidth, seenHeight = width - left - rightMargin, height - top - bottom
    x, y = (x - left) / seenWidth, (y - top) / seenHeight
    assert x.min() >= FRAME_MARGIN / 2 - 1e-9 and x.max() <= 1.0 - FRAME_MARGIN / 2 + 1e-9
    assert y.min() >= FRAME_MARGIN / 2 - 1e-9 and y.max() <= 1.0 - FRAME_MARGIN / 2 + 1e-9
    # As large as possible: it touches both sides, or top and bottom, and stands in the middle.
    assert max(np.ptp(x), np.ptp(y)) == pytest.approx(1.0 - FRAME_MARGIN)


@pytest.mark.parametrize("hasTimeline", [False, True])
@pytest.mark.parametrize("hasSide", [False, True])
@pytest.mark.parametrize("size", [(800, 500), (1280, 720), (1920, 1080), (3840, 2160)])
def test_panels_lie_at_the_edges_and_beside_the_picture(size, hasSide, hasTimeline):
    width, height = size
    layout = arrange(width, height, hasSide, hasTimeline)
    boxes = [box for box in layout if box is not None]
    assert len(boxes) == 2 + hasSide + hasTimeline
    covered = np.zeros((height, width), dtype=int)
    for left, top, wide, high in boxes:
        assert left >= 0 and top >= 0 and left + wide <= width and top + high <= height
        covered[top : top + high, left : left + wide] += 1
    assert (covered == 1).sum() >= width * height - width * TIMELINE_HEIGHT
    assert covered.max() == 1
    assert layout.picture.width >= 0.35 * width and layout.picture.height >= 0.8 * height
    assert layout.main.width >= 260
    left, top, right, bottom = layout.margins(width, height)
    assert (left, top) == layout.picture[:2]
    assert (width - right - left, height - bottom - top) == layout.picture[2:]


def in_camera(points, position, target):
    """(right, up, forward) of points (n, 3) seen from a camera whose up is y: three (n,)."""
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    arms = points - position
    return arms @ right, arms @ up, arms @ forward


def contact(body1, body2):
    return SimpleNamespace(body1=body1, body2=body2)


def test_islands_are_what_hangs_together_by_contacts_of_free_bodies():
    meshes = [SimpleNamespace(isFixed=k == 3, density=1.0) for k in range(8)]
    pairs = [(5, 6), (1, 5), (0, 3), (3, 4), (2, -1)]  # 3 is fixed, -1 the ground
    simulation = SimpleNamespace(
        meshes=meshes, report=SimpleNamespace(contacts=[contact(*pair) for pair in pairs])
    )
    assert contact_islands(meshes, pairs).tolist() == [-1, 1, -1, -1, -1, 1, 1, -1]
    colours = BodyColours(meshes).of(simulation, "contact island")
    np.testing.assert_array_equal(colours[[1, 5, 6]], PALETTE[[1, 1, 1]])
    np.testing.assert_allclose(colours[[0, 3]], [LONE_COLOUR, FIXED_COLOUR])
    assert contact_islands(meshes, []).tolist() == [-1] * 8
    simulation.report = None
    colours = BodyColours(meshes).of(simulation, "contact island")
    np.testing.assert_allclose(colours[[0, 1, 5]], [LONE_COLOUR] * 3)


def sleeping_tower():
    """A Simulation of the tower with the soft-step solver after a step, its second body asleep."""
    simulation = Simulation(DATA / "tower-scene.txt", Settings(contactSolver="soft-step"))
    simulation.step()
    simulation.report.isAsleep[1] = True
    return simulation


def test_balls_are_coloured_by_sleep_before_their_first_step():
    simulation = sleeping_tower()
    meshes = simulation.meshes
    simulation.change(shot(meshes, 10.0, [0.0, 90.0, 0.0], [0.0, 1.0, 0.0]))
    colours = BodyColours(meshes).of(simulation, "sleep")
    np.testing.assert_array_equal(colours[1], LONE_COLOUR)
    np.testing.assert_array_equal(colours[[2, 9]], PALETTE[[2, 9]])


def test_legend_knows_that_contacts_of_sleeping_bodies_are_not_listed():
    simulation = sleeping_tower()
    colours = BodyColours(simulation.meshes)
    assert colours.legend(simulation, "contact island")[0][0] == "touches no other awake body"
    simulation.report.isAsleep[:] = False
    assert colours.legend(simulation, "contact island")[0][0] == "touches no other free body"


@pytest.mark.parametrize("settings", [{}, {"broadPhase": "grid"}, {"contactSolver": "soft-step"}])
def test_contacts_are_counted_without_being_listed(settings):
    simulation = Simulation(DATA / "stack-scene.txt", Settings(**settings))
    for _ in range(20):
        simulation.step()
    count = simulation.report.contactCount
    assert count == len(simulation.report.contacts) > 0
    assert count == simulation.report.contactCount


def test_velocities_begin_where_they_leave_the_body():
    simulation = Simulation(DATA / "cube-scene.txt")
    vertices, faces, bodyOfFace = flatten_meshes(simulation.meshes)
    centres = np.concatenate([mesh.position for mesh in simulation.meshes])
    directions = np.random.default_rng(2).normal(size=centres.shape)
    directions[0] = 0.0
    points = surface_points(vertices, faces, bodyOfFace, centres, directions)
    np.testing.assert_array_equal(points[0], centres[0])
    # On an octahedron, the coordinates along its axes have absolute values of one sum.
    for mesh, point, direction in list(zip(simulation.meshes, points, directions, strict=True))[1:]:
        arm = QRotate(QConj(mesh.orientation), point - mesh.position)[0]
        assert np.abs(arm).sum() == pytest.approx(3.4)
        assert np.dot(point - mesh.position[0], direction) > 0.0
        np.testing.assert_allclose(np.cross(point - mesh.position[0], direction), 0.0, atol=1e-9)


def test_shadows_fall_aside_and_begin_under_what_stands():
    vertices = np.array([[1.0, 0.0, 2.0], [1.0, 10.0, 2.0], [1.0, -0.5, 2.0]])
    foot, top, sunk = cast_shadows(vertices, 0.01)
    np.testing.assert_allclose(foot, [1.0, 0.01, 2.0])
    np.testing.assert_allclose(top, [1.0 + 10 * SHADOW_SLANT[0], 0.01, 2.0 + 10 * SHADOW_SLANT[2]])
    np.testing.assert_allclose(sunk, foot)


def test_boxes_have_twelve_edges_along_the_axes():
    low, high = np.array([[0.0, 0, 0], [5, 5, 5]]), np.array([[1.0, 2, 3], [6, 7, 8]])
    nodes, edges = box_lines(low, high)
    assert nodes.shape == (16, 3) and edges.shape == (24, 2)
    sides = np.abs(np.diff(nodes[edges], axis=1)[:, 0])
    assert np.all(np.count_nonzero(sides, axis=1) == 1)
    np.testing.assert_allclose(sides.sum(axis=0), [8.0, 16.0, 24.0])
    assert edges[:12].max() == 7 and edges[12:].min() == 8


def test_grid_cells_hold_the_corners_that_the_broad_phase_sorts_by():
    generator = np.random.default_rng(5)
    low = generator.uniform(-20.0, 20.0, (60, 3))
    high = low + generator.uniform(0.5, 9.0, (60, 3))
    cellLow, cellHigh = grid_cells(low, high)
    assert 0 < len(cellLow) < 60
    held = (cellLow <= low[:, None]).all(axis=2) & (low[:, None] <= cellHigh).all(axis=2)
    assert held.any(axis=1).all()
    # Two boxes that overlap stand in the same cell or in neighbours: no cell is narrower.
    first, _ = grid_overlaps(np.concatenate([low, -high], axis=1).T, np.zeros(60, dtype=bool))
    assert len(first) > 5
    assert np.min((cellHigh - cellLow)[:, 1:]) >= 9.0 / 8.0


@pytest.mark.parametrize("size", [0.3, 7.0, 120.0, 5000.0])
def test_ground_is_chequered_in_round_numbers_and_fades(size):
    middle, reach = np.array([3.0 * size, 0.4 * size, -size]), 9.0 * size
    vertices, faces, colours, side = ground_squares(size, middle, reach)
    digit = side / 10.0 ** math.floor(math.log10(side) + 1e-9)
    assert round(digit, 9) in (1.0, 2.0, 5.0)
    squares = vertices[vertices[:, 1] == 0.0]
    assert len(squares) > 3 * GROUND_SQUARES**2 and len(squares) < 4 * GROUND_SQUARES**2
    np.testing.assert_allclose(squares / side, np.round(squares / side), atol=1e-9)
    # All else lies a little lower, and as far as the ground is seen.
    assert -0.01 * size < vertices[:, 1].min() < 0.0
    distance = np.linalg.norm((vertices - middle)[:, [0, 2]], axis=1)
    assert distance.max() == pytest.approx(reach)
    near = (distance < 0.5 * size) & (vertices[:, 1] == 0.0)
    assert len(np.unique(np.round(colours[near], 9), axis=0)) == 2
    # It ends in the colour of the sky, and the squares in that of what lies under them.
    rim = distance > 0.999 * reach
    assert rim.any()
    np.testing.assert_allclose(colours[rim], np.tile(SEEN_BACKGROUND, (rim.sum(), 1)), atol=1e-5)
    outer = (vertices[:, 1] == 0.0) & (distance > 0.98 * side * GROUND_SQUARES / 2)
    assert len(np.unique(np.round(colours[outer & (distance < 0.1 * reach)], 9), axis=0)) <= 1
    normals = np.cross(
        vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]]
    )
    assert np.all(normals[: 2 * len(squares) // 4, 1] > 0.0)


@pytest.mark.parametrize(
    ("timeStep", "rate", "every", "expected"),
    [
        (0.02, None, None, (25.0, 2)),
        (0.01, None, None, (25.0, 4)),
        (0.1, None, None, (10.0, 1)),  # no more pictures than steps
        (0.02, 10.0, None, (10.0, 5)),
        (0.02, None, 1, (50.0, 1)),
        (0.02, 30.0, 10, (30.0, 10)),  # a time lapse, six times as fast
    ],
)
def test_videos_play_in_real_time_unless_told_otherwise(timeStep, rate, every, expected):
    assert video_timing(timeStep, rate, every) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        ("", "1: this is not a JSON file: Expecting value"),
        ("[1, 2]", "this is not a Polyscope camera: it needs viewMat"),
        ('{"viewMat": [1, 2, 3], "fov": 45}', "this is not a Polyscope camera"),
    ],
)
def test_broken_camera_files_are_told_in_one_line(tmp_path, text, cause):
    path = tmp_path / "camera.json"
    path.write_text(text)
    with pytest.raises(CameraError) as error:
        load_camera(path)
    told = str(error.value)
    assert told.startswith((f"{path}: {cause}", f"{path}:{cause}")) and "\n" not in told
    with pytest.raises(CameraError, match="No such file"):
        load_camera(tmp_path / "none.json")


# --------------------------------------------------------------------------------------------------
# Pictures
# --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def polyscope():
    """Polyscope, drawing off-screen in this process; started once, for it cannot be twice."""
    backend = require_opengl()
    import polyscope as ps

    if not ps.is_initialized():
        start_polyscope(backend)
    ps.set_frame_tick_limit_fps_mode("ignore_limits")  # else a tick soon after another does nothing
    return ps


def picture(ps):
    """What the camera sees, (height, width, 3) floats from 0 to 1."""
    return ps.screenshot_to_buffer(transparent_bg=False)[:, :, :3] / 255.0


def pixel_of(ps, point):
    """(row, column) of a point (3,) in the picture."""
    camera = ps.get_view_camera_parameters()
    x, y, z = (
        float(part[0])
        for part in in_camera(
            np.array([point]),
            np.array(camera.get_position()),
            np.array(camera.get_position()) + np.array(camera.get_look_dir()),
        )
    )
    width, height = ps.get_window_size()
    scale = 0.5 * height / math.tan(math.radians(camera.get_fov_vertical_deg()) / 2.0) / z
    return round(0.5 * height - scale * y), round(0.5 * width + scale * x)


def shows(seen, colour):
    """Whether the pixel `seen` may be a body of this colour, both RGB, in some light."""
    hue, saturation, _ = colorsys.rgb_to_hsv(*seen)
    expectedHue, expectedSaturation, _ = colorsys.rgb_to_hsv(*colour)
    if expectedSaturation < GREY:
        return saturation < GREY
    apart = abs(hue - expectedHue)
    return saturation > GREY and min(apart, 1.0 - apart) < SAME_HUE


@pytest.fixture
def twoBoxes(tmp_path, polyscope):
    """A light box on the left, a heavy one on the right, and a fixed one between: their view."""
    (tmp_path / "box.mesh").write_bytes((DATA / "box.mesh").read_bytes())
    rows = [
        "box.mesh 1 0 -25 12 0 1 0 0 0",
        "box.mesh 9 0 25 12 0 1 0 0 0",
        "box.mesh 3 1 0 12 0 1 0 0 0",
    ]
    (tmp_path / "two-scene.txt").write_text("\n".join(["3", *rows]))
    view = SceneView(Simulation(tmp_path / "two-scene.txt"))
    view.colouring = "density"
    view.refresh()
    return view


def test_bodies_are_drawn_in_their_colours_where_they_stand(polyscope, twoBoxes):
    colours = [VIRIDIS[0], VIRIDIS[-1], FIXED_COLOUR]
    shot = picture(polyscope)
    for mesh, colour in zip(twoBoxes.simulation.meshes, colours, strict=True):
        # The middle of the face towards the camera, 4 in front of the centre: off all edges.
        seen = shot[pixel_of(polyscope, mesh.position[0] + [0.0, 0.0, 4.0])]
        assert [shows(seen, other) for other in colours] == [other is colour for other in colours]


def test_ground_sky_and_shadows_are_seen(polyscope, twoBoxes):
    shot = picture(polyscope)
    sky, bare = shot[5, 5], shot[pixel_of(polyscope, [-12.5, 0.0, 8.0])]
    # Of the middle of the right box, whose light comes from the upper left.
    shadow = shot[pixel_of(polyscope, [25.0, 0.0, 0.0] + 12.0 * SHADOW_SLANT)]
    assert sky[2] > sky[0] + 0.02  # bluish
    assert np.ptp(bare) < 0.02 and 0.3 < np.mean(bare) < 0.9  # grey
    assert np.ptp(shadow) < 0.06 and np.mean(shadow) < 0.75 * np.mean(bare)
    # The lowest row looks at the ground right in front of the camera.
    assert np.max(np.ptp(shot[-1], axis=1)) < 0.05


def test_bodies_move_in_the_picture_as_they_do_in_the_scene(polyscope, twoBoxes):
    simulation = twoBoxes.simulation
    before = picture(polyscope)
    for _ in range(40):
        simulation.step()
    fallen = simulation.meshes[0].position[0]
    assert fallen[1] < 9.0
    np.testing.assert_array_equal(picture(polyscope), before)  # not refreshed yet
    twoBoxes.refresh()
    after = picture(polyscope)
    changed = np.mean(np.any(np.abs(after - before) > 0.05, axis=2))
    assert 0.005 < changed < 0.2
    front = fallen + [0.0, 0.0, 4.0]
    assert shows(after[pixel_of(polyscope, front)], VIRIDIS[0])
    # Where its upper edge was before, there is no body any more.
    row, column = pixel_of(polyscope, [-25.0, 14.5, 4.0])
    assert shows(before[row, column], VIRIDIS[0])
    assert not shows(after[row, column], VIRIDIS[0])
    # What is fixed stands where it stood.
    place = pixel_of(polyscope, [0.0, 12.0, 4.0])
    np.testing.assert_allclose(after[place], before[place], atol=0.02)


def test_ties_are_drawn_where_the_bodies_are_and_only_while_they_count(polyscope):
    simulation = Simulation(DATA / "cube-scene.txt")
    view = SceneView(simulation)
    lines = polyscope.get_curve_network("constraints")
    assert (lines.n_edges(), lines.is_enabled()) == (28, True)
    with_lines = picture(polyscope)
    simulation.settings.enforceConstraints = False
    view.refresh()
    assert not lines.is_enabled()
    changed = np.mean(np.any(np.abs(picture(polyscope) - with_lines) > 0.05, axis=2))
    assert 0.001 < changed < 0.1
    simulation.settings.enforceConstraints = True
    view.refresh()
    np.testing.assert_array_equal(picture(polyscope), with_lines)
    # The next scene has none.
    view.rebuild(Simulation(DATA / "tet-scene.txt"))
    assert not polyscope.has_curve_network("constraints")


def test_many_bodies_are_drawn_without_lines(tmp_path, polyscope):
    (tmp_path / "box.mesh").write_bytes((DATA / "box.mesh").read_bytes())
    count = MOST_CREASES // 12 + 1
    rows = [f"box.mesh 1 0 {20 * (k % 20)} {9 + 12 * (k // 20)} 0 1 0 0 0" for k in range(count)]
    (tmp_path / "many-scene.txt").write_text("\n".join([str(count), *rows]))
    view = SceneView(Simulation(tmp_path / "many-scene.txt"))
    view.refresh()
    assert not polyscope.has_curve_network("creases")
    middle = view.simulation.meshes[30].position[0] + [0.0, 0.0, 4.0]
    assert shows(picture(polyscope)[pixel_of(polyscope, middle)], PALETTE[30 % len(PALETTE)])


def test_camera_is_kept_by_a_reset_and_comes_back_from_its_file(tmp_path, polyscope, twoBoxes):
    polyscope.set_vertical_fov_degrees(30.0)
    polyscope.look_at((60.0, 30.0, 50.0), (0.0, 9.0, 0.0))
    seen, size = picture(polyscope), polyscope.get_window_size()
    save_camera(tmp_path / "camera.json")
    viewer = make_viewer(twoBoxes.simulation, twoBoxes)
    viewer.step_once()
    viewer.reset()
    np.testing.assert_allclose(picture(polyscope), seen, atol=0.02)
    polyscope.set_vertical_fov_degrees(45.0)
    twoBoxes.rebuild(twoBoxes.simulation)
    assert np.abs(picture(polyscope) - seen).max() > 0.2
    # It is Polyscope's own file, which would change the window's size too.
    camera = json.loads((tmp_path / "camera.json").read_text())
    assert (camera["windowWidth"], camera["windowHeight"]) == size
    camera |= {"windowWidth": 320, "windowHeight": 240, "farClip": 1.0}
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    viewer.open(tmp_path / "camera.json")
    assert viewer.message == "" and polyscope.get_window_size() == size
    # A single-precision camera: hair lines may fall into the next pixel.
    assert np.mean(np.abs(picture(polyscope) - seen)) < 1e-3
    polyscope.set_vertical_fov_degrees(45.0)


def test_picked_body_is_the_one_that_is_seen_there_and_is_marked(polyscope, twoBoxes):
    for index, mesh in enumerate(twoBoxes.simulation.meshes):
        front = mesh.position[0] + [0.0, 0.0, 4.0]
        row, column = pixel_of(polyscope, front)
        body, point = twoBoxes.body_at((column, row))
        assert body == index
        np.testing.assert_allclose(point, front, atol=0.2)
        twoBoxes.pick(body, point)
        np.testing.assert_allclose(twoBoxes.picked_point(), point)
        twoBoxes.refresh()
        # A metre beside the mark that lies over the point.
        assert shows(
            picture(polyscope)[pixel_of(polyscope, front + [2.0, 0.0, 0.0])], PICKED_COLOUR
        )
    assert twoBoxes.body_at((3, 3)) == (None, None)


def test_overlays_are_drawn_from_the_present_state_and_go_away(polyscope):
    simulation = Simulation(DATA / "stress-scene.txt")
    simulation.settings.friction = 0.5
    view = SceneView(simulation)
    for name in OVERLAYS:
        view.show(name, True)
    assert not polyscope.has_point_cloud("contacts")  # no step yet
    while simulation.report is None or not any(any(c.friction) for c in simulation.report.contacts):
        simulation.step()
        assert simulation.stepCount < 200
    view.refresh()
    simulation.step()
    view.refresh()
    contacts = len(simulation.report.contacts)
    # Those of pairs that have parted a moment ago are still shown.
    assert contacts and polyscope.get_point_cloud("contacts").n_points() >= contacts
    recent = set()
    for _ in range(HELD_CONTACT_STEPS):
        simulation.step()
        view.refresh()
        recent |= {(c.body1, c.body2) for c in simulation.report.contacts}
    assert polyscope.get_point_cloud("contacts").n_points() >= len(recent)
    for name in ("impulses", "velocities"):
        assert polyscope.has_point_cloud(name)
    for name in ("bounding boxes", "grid cells", "trails"):
        assert polyscope.has_curve_network(name)
    assert polyscope.get_curve_network("bounding boxes").n_edges() == 12 * len(simulation.meshes)
    for name in LAYERS:
        view.show(name, False)
    assert not any(
        polyscope.has_point_cloud(name) or polyscope.has_curve_network(name) for name in OVERLAYS
    )
    simulation.reset()
    for name in LAYERS:
        view.show(name, True)
    assert not polyscope.has_point_cloud("contacts")


@pytest.mark.parametrize("colouring", COLOURINGS)
def test_scenes_can_be_coloured_in_all_ways(polyscope, twoBoxes, colouring):
    twoBoxes.colouring = colouring
    for _ in range(3):
        twoBoxes.simulation.step()
    twoBoxes.refresh()
    shot = picture(polyscope)
    colours = BodyColours(twoBoxes.simulation.meshes).of(twoBoxes.simulation, colouring)
    for mesh, colour in zip(twoBoxes.simulation.meshes, colours, strict=True):
        assert shows(shot[pixel_of(polyscope, mesh.position[0] + [0.0, 0.0, 4.0])], colour)
    assert all(len(colour) == 3 for _, colour in twoBoxes.legend())
    assert ("fixed", FIXED_COLOUR) in twoBoxes.legend()


def test_pictures_without_background_are_transparent_there(tmp_path, polyscope, twoBoxes):
    from matplotlib.image import imread

    twoBoxes.show("ground", False)
    PictureSeries(tmp_path, [0], twoBoxes, isTransparent=True).add(twoBoxes.simulation)
    shot = imread(tmp_path / "frame_000000.png")
    twoBoxes.show("ground", True)
    front = twoBoxes.simulation.meshes[0].position[0] + [0.0, 0.0, 4.0]
    assert shot[5, 5, 3] == 0.0 and shot[pixel_of(polyscope, front)][3] == 1.0


def test_shadows_on_nothing_are_black_and_let_the_background_through(polyscope, twoBoxes):
    twoBoxes.show("ground", False)
    shot = take_picture(twoBoxes, isTransparent=True)
    place = pixel_of(polyscope, [25.0, 0.0, 0.0] + 12.0 * SHADOW_SLANT)
    assert shot[place].tolist() == [0, 0, 0, round(255 * SHADOW_OPACITY)]
    twoBoxes.show("shadows", False)
    assert take_picture(twoBoxes, isTransparent=True)[place][3] == 0
    for name in ("ground", "shadows"):
        twoBoxes.show(name, True)


def test_edges_are_smooth_and_pictures_the_same_each_time(polyscope, twoBoxes):
    rough, smooth = picture(polyscope), take_picture(twoBoxes)
    assert smooth.shape == rough.shape and smooth.dtype == np.uint8
    np.testing.assert_array_equal(smooth, take_picture(twoBoxes))
    np.testing.assert_allclose(smooth.mean() / 255.0, rough.mean(), atol=0.005)
    # They differ along edges and nowhere else: inside of faces there is nothing to average.
    isOther = np.any(np.abs(smooth / 255.0 - rough) > 0.04, axis=2)
    assert 0.002 < isOther.mean() < 0.08
    place = pixel_of(polyscope, twoBoxes.simulation.meshes[0].position[0] + [0.0, 0.0, 4.0])
    np.testing.assert_allclose(smooth[place] / 255.0, rough[place], atol=0.005)


def test_averages_are_those_of_the_pixels_and_what_is_not_there_has_no_colour():
    generator = np.random.default_rng(1)
    large = generator.integers(0, 256, (6, 8, 3)).astype(np.uint8)
    small = averaged(large, 2)
    expected = large.reshape(3, 2, 4, 2, 3).mean(axis=(1, 3))
    assert np.abs(small - expected).max() <= 0.5
    red, nothing = [255, 0, 0, 255], [0, 255, 0, 0]
    np.testing.assert_array_equal(
        averaged(np.array([[red, nothing], [nothing, nothing]], np.uint8), 2),
        [[[255, 0, 0, 64]]],
    )


def test_bodies_are_seen_through_while_contacts_are_shown(polyscope, twoBoxes):
    place = pixel_of(polyscope, twoBoxes.simulation.meshes[0].position[0] + [0.0, 0.0, 4.0])
    body = take_picture(twoBoxes)[place]
    twoBoxes.show_bodies(False)
    behind = take_picture(twoBoxes)[place]
    twoBoxes.show_bodies(True)
    twoBoxes.show("contacts", True)
    mixed = (1.0 - SEEN_THROUGH) * body + SEEN_THROUGH * behind
    np.testing.assert_allclose(take_picture(twoBoxes)[place], mixed, atol=2.0)
    twoBoxes.show("contacts", False)
    np.testing.assert_array_equal(take_picture(twoBoxes)[place], body)


def test_bodies_are_seen_through_from_the_start_where_contacts_are_asked_for(
    polyscope, twoBoxes, monkeypatch
):
    monkeypatch.setattr("rbs.pictures.capture.start_polyscope", lambda *arguments: None)
    simulation = twoBoxes.simulation
    place = pixel_of(polyscope, simulation.meshes[0].position[0] + [0.0, 0.0, 4.0])
    shots = []
    for overlays in ((), ("contacts",)):
        view = start_view(simulation, None, PictureOptions(overlays=overlays))
        shots.append(picture(polyscope)[place])
    view.refresh()
    np.testing.assert_allclose(picture(polyscope)[place], shots[1], atol=0.01)
    assert np.abs(shots[1] - shots[0]).max() > 0.1
    view.show("contacts", False)


def test_legend_says_that_there_is_no_friction(polyscope):
    simulation = Simulation(DATA / "tower-scene.txt")
    view = SceneView(simulation)
    view.show("friction impulses", True)
    simulation.step()
    view.refresh()
    assert view.legend()[-1][0] == "no friction impulse this step"
    view.show("friction impulses", False)


def test_legend_is_in_the_picture_where_it_is_asked_for(polyscope, twoBoxes):
    bare = take_picture(twoBoxes)
    twoBoxes.hasLegend = True
    twoBoxes.show("velocities", True)
    texts = [text for text, _ in twoBoxes.legend()]
    assert texts[:3] == ["density 1 kg/m³", "density 9 kg/m³", "fixed"]
    assert texts[3:] == [f"velocity (one floor square = {twoBoxes.squareSide / 0.5:g} m/s)"]
    seen = take_picture(twoBoxes)
    changed = np.any(seen != bare, axis=2)
    assert changed[14:60, 14:120].mean() > 0.95 and not changed[:10].any()
    samples = {tuple(pixel) for pixel in seen[14:120, 14:40].reshape(-1, 3).tolist()}
    assert tuple(np.rint(255 * np.array(FIXED_COLOUR)).astype(int).tolist()) in samples
    view = SceneView(Simulation(DATA / "cube-scene.txt"))
    assert [text for text, _ in view.legend()] == [
        "constraint slack",
        "constraint taut",
        "constraint exceeded",
    ]


def test_frame_all_and_follow_keep_the_bodies_in_the_picture(polyscope):
    simulation = Simulation(DATA / "mixed-scene.txt")
    view = SceneView(simulation)
    for mesh in simulation.meshes:
        mesh.position = mesh.position + [300.0, 0.0, -200.0]
    refresh_vertices(simulation.meshes)
    width, height = polyscope.get_window_size()

    def are_seen():
        pixels = [pixel_of(polyscope, mesh.position[0]) for mesh in simulation.meshes]
        return all(0 <= row < height and 0 <= column < width for row, column in pixels)

    view.refresh()
    assert not are_seen()
    view.frame_all()
    assert are_seen()
    # The ground has come along: below all of them it is grey, not of the sky's colour.
    ground = picture(polyscope)[pixel_of(polyscope, [300.0, 0.0, -200.0])]
    assert np.ptp(ground) < 0.05
    view.follows = True
    before = [pixel_of(polyscope, mesh.position[0]) for mesh in simulation.meshes]
    for mesh in simulation.meshes:
        mesh.position = mesh.position - [900.0, 0.0, 700.0]
    refresh_vertices(simulation.meshes)
    view.refresh()
    after = [pixel_of(polyscope, mesh.position[0]) for mesh in simulation.meshes]
    np.testing.assert_allclose(after, before, atol=1.0)


def frames_of(path):
    """The pictures of a video, (n, height, width, 3)."""
    import imageio_ffmpeg

    reader = imageio_ffmpeg.read_frames(str(path))
    width, height = next(reader)["size"]
    return np.array([np.frombuffer(data, np.uint8).reshape(height, width, 3) for data in reader])


@pytest.mark.parametrize("ending", VIDEO_ENDINGS)
def test_videos_have_each_picture_once_and_nothing_half_written(
    tmp_path, polyscope, twoBoxes, ending
):
    pytest.importorskip("imageio_ffmpeg", reason="pip install imageio-ffmpeg")
    simulation, path = twoBoxes.simulation, tmp_path / f"fall{ending}"
    path.write_bytes(b"old")
    video = Video(path, twoBoxes, 25.0, 4)
    video.add(simulation)
    for _ in range(41):
        simulation.step()
        video.add(simulation)
        video.add(simulation)  # as after a frame in which no step was made
    assert video.count == 11 and path.read_bytes() == b"old"
    assert "in real time" not in video.summary(simulation)
    video.save(simulation)
    video.close()
    assert [entry.name for entry in tmp_path.iterdir() if entry.suffix == ending] == [path.name]
    frames = frames_of(path)
    assert frames.shape[0] == 11
    # The boxes fall from picture to picture.
    moved = np.mean(np.abs(np.diff(frames.astype(int), axis=0)), axis=(1, 2, 3))
    assert np.all(moved > 0.01)
    interrupted = Video(tmp_path / f"cut{ending}", twoBoxes, 25.0, 1)
    interrupted.add(simulation)
    interrupted.close()
    assert not list(tmp_path.glob("cut*"))


# --------------------------------------------------------------------------------------------------
# The panel
# --------------------------------------------------------------------------------------------------


@pytest.fixture
def panel(polyscope):
    """The panel over the mixed scene, drawn frame by frame through Polyscope's callback."""
    simulation = Simulation(DATA / "mixed-scene.txt")
    result = Panel(make_viewer(simulation, SceneView(simulation)))
    result.viewer.view.set_callback(result.frame)
    polyscope.frame_tick()
    yield result
    result.viewer.view.set_callback(None)


def press(ps, key):
    """Presses and releases a key, with a frame for each."""
    import polyscope.imgui as psim

    for isDown in (True, False):
        psim.GetIO().AddKeyEvent(key, isDown)
        ps.frame_tick()


def click(ps, x, y):
    """Moves the mouse there and clicks, with a frame for each."""
    import polyscope.imgui as psim

    psim.GetIO().AddMousePosEvent(x, y)
    ps.frame_tick()
    for isDown in (True, False):
        psim.GetIO().AddMouseButtonEvent(0, isDown)
        ps.frame_tick()


@pytest.fixture
def places(monkeypatch, polyscope):
    """Where the panel's widgets lie: label to the (x, y) of its middle, filled frame by frame."""
    import polyscope.imgui as psim

    result = {}
    for kind in (
        "Button",
        "Selectable",
        "BeginCombo",
        "InputDouble",
        "Checkbox",
        "SliderFloat",
        "SliderInt",
        "CollapsingHeader",
    ):
        monkeypatch.setattr(psim, kind, noting(getattr(psim, kind), result))
    return result


def noting(widget, places):
    """The widget's function, noting where it has drawn."""
    import polyscope.imgui as psim

    def draw(label, *arguments, **options):
        answer = widget(label, *arguments, **options)
        low, high = psim.GetItemRectMin(), psim.GetItemRectMax()
        # A field's rectangle holds its label, and buttons: its number is at the left.
        places[label.split("#")[0]] = (low[0] + 15.0, 0.5 * (low[1] + high[1]))
        return answer

    return draw


def test_keys_play_step_and_reset(polyscope, panel):
    import polyscope.imgui as psim

    viewer = panel.viewer
    press(polyscope, psim.ImGuiKey_Space)
    assert viewer.isPlaying
    press(polyscope, psim.ImGuiKey_Space)
    assert not viewer.isPlaying
    count = viewer.simulation.stepCount
    press(polyscope, psim.ImGuiKey_S)
    press(polyscope, psim.ImGuiKey_RightArrow)
    assert viewer.simulation.stepCount == count + 2
    press(polyscope, psim.ImGuiKey_R)
    assert viewer.simulation.stepCount == 0


def test_edges_are_smooth_while_nothing_moves(polyscope, panel):
    import polyscope.imgui as psim

    view = panel.viewer.view
    assert view.isSmooth
    for _ in range(2):
        press(polyscope, psim.ImGuiKey_Space)
        assert view.isSmooth != panel.viewer.isPlaying
    psim.GetIO().AddMousePosEvent(640, 300)
    polyscope.frame_tick()
    for isDown in (True, False):
        psim.GetIO().AddMouseButtonEvent(0, isDown)
        polyscope.frame_tick()
        assert view.isSmooth != isDown


def test_buttons_play_step_and_reset(polyscope, places, panel):
    viewer = panel.viewer
    click(polyscope, *places["Play"])
    assert viewer.isPlaying
    # It says Pause now, at the same place.
    polyscope.frame_tick()
    click(polyscope, *places["Pause"])
    assert not viewer.isPlaying
    count = viewer.simulation.stepCount
    click(polyscope, *places["Step"])
    assert viewer.simulation.stepCount == count + 1
    click(polyscope, *places["Reset"])
    assert viewer.simulation.stepCount == 0


def type_into(ps, place, text):
    """Replaces the number in a field, and presses Enter."""
    import polyscope.imgui as psim

    click(ps, *place)
    for isDown in (True, False):
        psim.GetIO().AddKeyEvent(psim.ImGuiKey_LeftCtrl, isDown)
        psim.GetIO().AddKeyEvent(psim.ImGuiMod_Ctrl, isDown)
        ps.frame_tick()
        if isDown:
            press(ps, psim.ImGuiKey_A)
    for character in text:
        psim.GetIO().AddInputCharacter(ord(character))
        ps.frame_tick()
    press(ps, psim.ImGuiKey_Enter)
    ps.frame_tick()


def test_numbers_typed_into_the_fields_are_checked(polyscope, places, panel):
    simulation = panel.viewer.simulation
    before = dict(places)
    for typed, expected in (("0.005", 0.005), ("0", 1e-4), ("7", 1.0)):
        type_into(polyscope, places["time step (s)"], typed)
        assert simulation.settings.timeStep == expected
    assert panel.viewer.message == "" and places == before  # nothing has moved
    assert simulation.stepCount == 0 and not panel.viewer.isPlaying


def test_sliders_are_dragged_and_typed_into(polyscope, places, panel):
    import polyscope.imgui as psim

    settings = panel.viewer.simulation.settings
    x, y = places["friction"]
    click(polyscope, x + 20.0, y)
    assert 0.05 < settings.friction < 0.95 and settings.friction == round(settings.friction, 3)
    for typed, expected in (("0.9", 0.9), ("1.1", 1.0), ("-3", 0.0)):
        for isDown in (True, False):
            psim.GetIO().AddKeyEvent(psim.ImGuiMod_Ctrl, isDown)
            polyscope.frame_tick()
            if isDown:
                click(polyscope, *places["restitution"])
        for character in typed:
            psim.GetIO().AddInputCharacter(ord(character))
            polyscope.frame_tick()
        press(polyscope, psim.ImGuiKey_Enter)
        polyscope.frame_tick()
        assert settings.restitution == expected


def test_checkbox_and_scene_list_work(polyscope, places, panel):
    viewer = panel.viewer
    click(polyscope, *places["approaching contacts only"])
    assert viewer.simulation.settings.closingOnly
    click(polyscope, *places["scene"])
    polyscope.frame_tick()
    click(polyscope, *places["cube"])
    assert viewer.simulation.scenePath == DATA / "cube-scene.txt"
    assert len(viewer.simulation.meshes) == 8


def test_every_control_says_what_it_is_for_unless_an_error_is_shown(
    polyscope, panel, monkeypatch, tmp_path
):
    import polyscope.imgui as psim

    calls = []

    def told(name, function):
        def call(*arguments, **options):
            calls.append((name, arguments[0]))
            return function(*arguments, **options)

        return call

    kinds = (
        "Button",
        "Checkbox",
        "SliderFloat",
        "SliderInt",
        "InputDouble",
        "InputTextWithHint",
        "BeginCombo",
        "CollapsingHeader",
        "SetItemTooltip",
    )
    for kind in kinds:
        monkeypatch.setattr(psim, kind, told(kind, getattr(psim, kind)))
    header = psim.CollapsingHeader
    monkeypatch.setattr(psim, "CollapsingHeader", lambda *rest: bool(header(*rest)) or True)
    panel.viewer.open(DATA / "cube-scene.txt")
    panel.viewer.view.pick(1, panel.viewer.simulation.meshes[1].position[0])
    panel.isSideShown = True
    polyscope.frame_tick()
    calls.clear()
    polyscope.frame_tick()
    controls = [k for k, (name, _) in enumerate(calls) if name != "SetItemTooltip"]
    assert len(controls) > 40
    silent = [
        calls[k][1]
        for k in controls
        if calls[k + 1 : k + 2] == [] or calls[k + 1][0] != "SetItemTooltip"
    ]
    assert silent == []
    panel.viewer.message = "something is wrong"
    calls.clear()
    polyscope.frame_tick()
    assert calls and all(name != "SetItemTooltip" for name, _ in calls)


@pytest.fixture
def texts(monkeypatch, polyscope):
    """The texts of the panel, in the order in which they are drawn."""
    import polyscope.imgui as psim

    result, draw = [], psim.Text
    monkeypatch.setattr(psim, "Text", lambda text: (result.append(text), draw(text)))
    return result


def test_numbers_are_called_what_they_are(polyscope, panel, texts, monkeypatch):
    viewer = panel.viewer
    panel.isSideShown = True
    viewer.open(DATA / "cube-scene.txt")
    viewer.step_once()
    polyscope.frame_tick()
    report = viewer.simulation.report
    assert {
        f"{report.constraintVisits} constraint visits, 56 constraint bounds",
        "0 contacts",
        "28 candidate pairs",
    } <= set(texts)
    viewer.open(DATA / "tower-scene.txt")
    viewer.simulation.settings.change("contactSolver", "soft-step")
    # Contacts are counted, not listed: that takes long where there are thousands of them.
    monkeypatch.setattr(StepReport, "contacts", None)
    viewer.step_once()
    texts.clear()
    polyscope.frame_tick()
    assert {"contact solver", "write back", "other"} <= set(texts)
    assert f"{viewer.simulation.report.contactCount} contacts" in texts
    viewer.simulation.report.isAsleep[:] = True
    texts.clear()
    polyscope.frame_tick()
    assert f"{viewer.simulation.report.contactCount} contacts of awake bodies" in texts


@pytest.mark.parametrize("kind", ["impulse", "soft-step", "recording"])
def test_widgets_write_nothing_while_nobody_touches_them(polyscope, panel, tmp_path, kind, texts):
    import polyscope.imgui as psim

    viewer = panel.viewer
    settings = Settings(
        friction=0.4, restitution=0.7, contactSolver="impulse" if kind == "recording" else kind
    )
    simulation = Simulation(DATA / "cube-scene.txt", settings)
    if kind == "recording":
        simulation = Replay(Recording(record(tmp_path / "cube.h5", simulation, 3)))
    viewer.simulation, viewer.pushSpeed = simulation, 0.4
    viewer.view.rebuild(simulation)
    simulation.step()
    viewer.view.pick(1, simulation.meshes[1].position[0])
    panel.isSideShown = True
    before = repr(simulation.settings)
    state = {name: values.tobytes() for name, values in simulation.state().items()}
    for _ in range(10):
        polyscope.frame_tick()
    assert repr(simulation.settings) == before and "friction=0.4," in before
    assert {name: values.tobytes() for name, values in simulation.state().items()} == state
    assert repr(viewer.pushSpeed) == "0.4" and simulation.stepCount == 1
    assert viewer.playback.isBackwards is False and viewer.view.follows is False
    press(polyscope, psim.ImGuiKey_S)
    assert simulation.stepCount == 2  # the panel is still Polyscope's callback


def test_line_about_a_file_is_forgotten_in_the_next_scene(polyscope, panel, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    panel.viewer.save_camera()
    assert panel.viewer.saved
    panel.viewer.open("tet")
    assert panel.viewer.saved == ""


def test_panel_goes_on_after_a_picture_with_a_legend(
    polyscope, places, panel, tmp_path, monkeypatch
):
    import polyscope.imgui as psim

    monkeypatch.chdir(tmp_path)
    panel.viewer.view.hasLegend = True
    panel.viewer.view.show("velocities", True)
    click(polyscope, *places["Save"])
    click(polyscope, *places["Picture"])
    assert panel.viewer.saved == "saved out/mixed/picture_000000.png"
    press(polyscope, psim.ImGuiKey_S)
    assert panel.viewer.simulation.stepCount == 1
    shoot = polyscope.screenshot_to_buffer

    def fail(**options):
        if options.get("include_UI"):
            raise OSError(28, "No space left on device")
        return shoot(**options)

    monkeypatch.setattr(polyscope, "screenshot_to_buffer", fail)
    panel.viewer.save_picture()
    assert panel.viewer.message == "cannot write: No space left on device"
    press(polyscope, psim.ImGuiKey_S)
    assert panel.viewer.simulation.stepCount == 2


def test_file_dropped_onto_the_window_is_opened(polyscope, panel, tmp_path):
    panel.dropped([str(DATA / "tet-scene.txt"), str(DATA / "cube-scene.txt")])
    polyscope.frame_tick()
    assert panel.viewer.simulation.scenePath == DATA / "cube-scene.txt"
    panel.dropped([str(tmp_path / "none-scene.txt")])
    polyscope.frame_tick()
    assert "no such file" in panel.viewer.message


def test_constraints_can_be_switched_off_and_their_scheduling_chosen(polyscope, places, panel):
    polyscope.frame_tick()
    assert "scheduling" not in places  # the mixed scene has no constraints
    panel.viewer.open(DATA / "cube-scene.txt")
    settings = panel.viewer.simulation.settings
    polyscope.frame_tick()
    polyscope.frame_tick()  # the panel has grown
    click(polyscope, *places["constraints"])
    assert not settings.enforceConstraints
    assert not polyscope.get_curve_network("constraints").is_enabled()
    click(polyscope, *places["constraints"])
    assert settings.enforceConstraints
    assert polyscope.get_curve_network("constraints").is_enabled()
    for name in ("batches", "queue", "sweep"):
        click(polyscope, *places["scheduling"])
        polyscope.frame_tick()
        click(polyscope, *places[name])
        assert settings.constraintScheduling == name
        polyscope.frame_tick()


# --------------------------------------------------------------------------------------------------
# Somebody who presses everything
# --------------------------------------------------------------------------------------------------

SMALL_SCENES = (
    "cube",
    "mixed",
    "tower",
    "two_chain",
    "slide",
    "stack",
    "cradle",
    "ramp",
    "arch",
    "dominoes",
)


class RandomUser:
    """Does at random what the window allows. Attribute: counts, how often each thing was done."""

    def __init__(self, ps, panel, recordings, seed):
        self.ps, self.panel, self.viewer = ps, panel, panel.viewer
        self.recordings = recordings
        self.random = np.random.default_rng(seed)
        self.counts = Counter()
        self.note_settings()

    def note_settings(self):
        self.expected = asdict(self.viewer.simulation.settings)

    def choice(self, values):
        values = list(values)
        return values[self.random.integers(len(values))]

    def pixel(self):
        """Of a body, as far as it is in the picture."""
        width, height = self.ps.get_window_size()
        row, column = pixel_of(self.ps, self.choice(self.viewer.simulation.meshes).position[0])
        return min(max(column, 0), width - 1), min(max(row, 0), height - 1)

    def act(self):
        """Does something that can be done now, rather what was seldom done, and draws a frame."""
        names = [name for name in vars(RandomUser) if name.startswith("do_")]
        # These are possible only while a body is picked, or held.
        isRare = np.isin(names, ("do_push", "do_fix", "do_drag", "do_release"))
        weights = 0.8 ** np.array([self.counts[name] for name in names]) * np.where(isRare, 6, 1)
        isDone = False
        while not isDone:
            name = str(self.random.choice(names, p=weights / weights.sum()))
            isDone = getattr(self, name)() is not False
        self.counts[name] += 1
        if self.viewer.grab is None:  # else the panel would let go: no mouse button is down
            self.ps.frame_tick()
        else:
            self.viewer.play(0.04)

    def do_play(self):
        self.viewer.playback.speed = self.choice(SPEEDS)
        self.viewer.playback.isBackwards = bool(self.random.integers(2))
        self.viewer.toggle_play()

    def do_step(self):
        for _ in range(self.random.integers(1, 4)):
            self.viewer.step_once()

    def do_seek(self):
        if not self.viewer.isReplay:
            return False
        self.viewer.seek(int(self.random.integers(-2, self.viewer.simulation.lastStep + 3)))

    def do_reset(self):
        self.viewer.reset()
        if not self.viewer.isReplay:
            self.expected = asdict(self.viewer.simulation.startSettings)

    def do_restart(self):
        self.viewer.restart()

    def do_pick(self):
        self.viewer.pick_at(self.pixel())
        return self.viewer.picked() is not None

    def do_push(self):
        if self.viewer.isReplay or self.viewer.picked() is None or self.viewer.picked().isFixed:
            return False
        direction = self.random.normal(size=3)
        self.viewer.push(direction / np.linalg.norm(direction))

    def do_fix(self):
        if self.viewer.isReplay or self.viewer.picked() is None:
            return False
        self.viewer.set_fixed(not self.viewer.picked().isFixed)

    def do_grab(self):
        self.viewer.grab_at(self.pixel())
        return self.viewer.grab is not None

    def do_drag(self):
        if self.viewer.grab is None:
            return False
        self.viewer.drag_to(self.pixel())
        self.viewer.step_once()

    def do_release(self):
        if self.viewer.grab is None:
            return False
        self.viewer.release()

    def do_shoot(self):
        self.viewer.shoot(self.pixel())
        return not self.viewer.isReplay

    def do_open_scene(self):
        self.viewer.open(self.choice(SMALL_SCENES))
        assert self.viewer.message == ""
        self.note_settings()

    def do_open_recording(self):
        self.viewer.open(self.choice(self.recordings))
        assert self.viewer.isReplay

    def do_colours(self):
        self.viewer.view.colouring = self.choice(COLOURINGS)
        self.viewer.view.refresh()

    def do_overlay(self):
        name = self.choice(LAYERS)
        self.viewer.view.show(name, name not in self.viewer.view.shown)

    def do_camera(self):
        self.viewer.view.follows = not self.viewer.view.follows
        self.viewer.view.frame_all()

    def do_picture(self):
        self.viewer.view.hasLegend = bool(self.random.integers(2))
        self.viewer.save_picture()
        assert self.viewer.saved.endswith(".png") and self.viewer.message == ""

    def do_video(self):
        self.viewer.toggle_video()

    def do_recording(self):
        self.viewer.toggle_recording()
        return not self.viewer.isReplay

    def do_setting(self):
        settings = self.viewer.simulation.settings
        heeded = [one for one in CHOSEN.values() if one.solver in (None, settings.contactSolver)]
        one = self.choice(one for one in heeded if one.label)
        if self.viewer.isReplay:
            return False
        if one.kind is bool:
            value = not getattr(settings, one.name)
        elif isinstance(one.kind, tuple):
            value = self.choice(one.kind)
        else:
            low, high = one.sliderEnds or (0.005, 0.03)
            value = one.kind(self.random.uniform(low, high))
        settings.change(one.name, value)
        assert getattr(settings, one.name) == value
        if one.name != "contactSolver":
            self.expected[one.name] = value
        else:  # what the new solver ignores gets its default
            ignored = [other.name for other in CHOSEN.values() if other.solver not in (None, value)]
            self.expected |= {name: CHOSEN[name].default for name in ignored} | {one.name: value}


def test_random_actions_raise_nothing_and_change_only_what_they_are_for(
    polyscope, tmp_path, monkeypatch
):
    import polyscope.imgui as psim

    monkeypatch.chdir(tmp_path)
    clock = count(step=0.004)
    for module in ("panel", "viewer", "playback"):
        still = SimpleNamespace(perf_counter=lambda: next(clock))
        monkeypatch.setattr(f"rbs.{module}.time", still)
    header = psim.CollapsingHeader
    monkeypatch.setattr(psim, "CollapsingHeader", lambda *rest: bool(header(*rest)) or True)
    size = polyscope.get_window_size()
    polyscope.set_window_size(640, 150)
    monkeypatch.setattr("rbs.pictures.capture.SUPERSAMPLING", 1)

    def change_by_hand(simulation, step):
        if step == 4:
            simulation.change(shot(simulation.meshes, 40.0, [0.0, 9.0, 30.0], [0.0, 0.0, -1.0]))
            simulation.change(fix(1, True))

    recordings = []
    for name, settings in (("tower", {}), ("stack", {"contactSolver": "soft-step"})):
        simulation = Simulation(DATA / f"{name}-scene.txt", Settings(**settings))
        path = record(tmp_path / f"{name}.h5", simulation, 12, change_by_hand)
        recordings.append(path)
    simulation = Simulation(DATA / "mixed-scene.txt")
    view = SceneView(simulation)
    viewer = Viewer(simulation, view, SceneOpener(simulation, {}), list_files, step_quantities)
    panel = Panel(viewer)
    panel.isSideShown = True
    panel.lay_out()
    view.set_callback(panel.frame)
    user, where = RandomUser(polyscope, panel, recordings, seed=2), Counter()
    while user.counts.total() < 500:
        user.act()
        simulation = viewer.simulation
        assert simulation.is_finite()
        settings = asdict(simulation.settings)
        if viewer.isReplay:
            now = restored_settings(simulation.recording, simulation.stepCount, Settings())
            assert settings == asdict(now)
        else:
            assert settings == user.expected
        where["replay" if viewer.isReplay else settings["contactSolver"]] += 1
    viewer.stop_video()
    viewer.stop_recording()
    viewer.release()
    view.set_callback(None)
    polyscope.set_window_size(*size)
    names = {name for name in vars(RandomUser) if name.startswith("do_")}
    assert len(names) == 21 and min(user.counts[name] for name in names) >= 10, user.counts
    assert len(where) == 3 and min(where.values()) >= 50, where
    made = list(tmp_path.glob("out/*/recording*.h5"))
    assert made and all(verify(Recording(path)) == "" for path in made)
