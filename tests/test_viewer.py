"""The viewer: what is drawn where, what buttons and keys do, and the window itself.

Pictures are judged by their pixels. In the process of the tests, Polyscope draws off-screen; only
the last test opens a window, in a process of its own.
"""

import colorsys
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
from opengl import require_opengl, skip_or_fail
from oracles import ROOT

import RBSDrawing
from RBSDrawing import (
    FIXED_COLOUR,
    MOST_CREASES,
    TIE_COLOURS,
    VIEW_DIRECTION,
    VIRIDIS,
    SceneView,
    Ties,
    body_colours,
    find_creases,
    frame_camera,
)
from RBSRecording import Recorder, step_quantities
from RBSViewer import Panel, Viewer, legend
from RigidBodySimulation import (
    Simulation,
    list_files,
    load_mesh_file,
    load_scene_file,
    open_file,
)

DATA = ROOT / "data"

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


def make_viewer(simulation, view):
    return Viewer(simulation, view, open_file, list_files, step_quantities)


@pytest.fixture
def viewer():
    """A Viewer of the mixed scene that draws nothing."""
    return make_viewer(Simulation(DATA / "mixed-scene.txt"), StillView())


@pytest.fixture
def replay(tmp_path):
    """A Viewer of a recording of 40 steps of the tower that draws nothing."""
    simulation = Simulation(DATA / "tower-scene.txt")
    recorder = Recorder(tmp_path / "tower.npz")
    recorder.add(simulation)
    for _ in range(40):
        simulation.step()
        recorder.add(simulation)
    recorder.save()
    return make_viewer(open_file(tmp_path / "tower.npz", None), StillView())


# --------------------------------------------------------------------------------------------------
# What the buttons do
# --------------------------------------------------------------------------------------------------


def test_playing_keeps_pace_with_the_clock(viewer):
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


def test_long_time_steps_play_too(viewer):
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
    assert viewer.milliseconds() == pytest.approx(1e3 * viewer.simulation.stepSeconds)
    viewer.toggle_play()
    viewer.reset()
    assert not viewer.isPlaying and viewer.milliseconds() is None
    np.testing.assert_array_equal(viewer.simulation.state()["positions"], start)


def test_steps_per_frame_do_not_look_at_the_clock(viewer):
    viewer.stepsPerFrame = 3
    viewer.toggle_play()
    viewer.play(0.0)
    viewer.play(5.0)
    assert viewer.simulation.stepCount == 6


def test_values_out_of_range_are_refused_and_change_nothing():
    settings = Simulation(DATA / "tet-scene.txt").settings
    for name, values, cause in (
        ("restitution", (-0.1, 1.0001, math.nan, math.inf), "the restitution must lie between 0"),
        ("timeStep", (0.0, -0.02, math.nan, math.inf), "the time step must be positive"),
        ("friction", (-0.1, math.nan, math.inf), "the friction must be finite"),
    ):
        before = getattr(settings, name)
        for value in values:
            with pytest.raises(ValueError, match=cause):
                settings.change(name, value)
        assert getattr(settings, name) == before
        settings.change(name, 0.123456789)
        assert getattr(settings, name) == 0.123456789


def test_scenes_beside_the_current_one_can_be_chosen(viewer):
    files = viewer.files()
    assert files["tower"] == DATA / "tower-scene.txt" and viewer.name() == "mixed"
    viewer.toggle_play()
    viewer.simulation.settings.restitution = 0.25
    viewer.open(files["tower"])
    assert not viewer.isPlaying and viewer.view.rebuilt == 1
    assert len(viewer.simulation.meshes) == 9 and viewer.simulation.stepCount == 0
    assert viewer.simulation.settings.restitution == 0.25


def test_broken_file_shows_its_error_and_keeps_the_current_scene(viewer, tmp_path):
    for name, cause in (("broken-scene.txt", ":1: the file ends before body 1 of 2"),
                        ("broken.npz", ": this is not a recording"),
                        ("broken.json", ": this is not a JSON file")):  # fmt: skip
        (tmp_path / name).write_text("2\n" if name.endswith("txt") else "nothing")
        viewer.step_once()
        count = viewer.simulation.stepCount
        viewer.open(tmp_path / name)
        assert viewer.message.startswith(f"{tmp_path / name}{cause}")
        assert viewer.simulation.stepCount == count and viewer.view.rebuilt == 0
    viewer.open(DATA / "tet-scene.txt")
    assert viewer.message == ""


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


def test_replay_plays_at_any_speed_and_stops_at_its_ends(replay):
    simulation = replay.simulation
    replay.toggle_play()
    replay.play(0.041)
    assert simulation.stepCount == 2
    replay.speed = -1.0
    replay.play(0.021)
    assert simulation.stepCount == 1
    replay.play(0.1)
    assert simulation.stepCount == 0 and not replay.isPlaying
    replay.speed = 8.0
    replay.seek(30)
    replay.toggle_play()
    replay.play(0.1)
    assert simulation.stepCount == 40 and not replay.isPlaying
    replay.toggle_play()  # from the start again
    assert simulation.stepCount == 0 and replay.isPlaying
    replay.step_once()
    assert simulation.stepCount == 1 and replay.milliseconds() is None


def test_settings_outlive_a_replay(viewer, replay, tmp_path):
    viewer.simulation.settings.friction = 0.7
    viewer.open(tmp_path / "tower.npz")
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


# --------------------------------------------------------------------------------------------------
# The look, as numbers
# --------------------------------------------------------------------------------------------------


def test_colours_go_by_the_logarithm_of_the_density(tmp_path):
    (tmp_path / "box.mesh").write_bytes((DATA / "box.mesh").read_bytes())
    densities = [10, 1000, 100, 5]
    rows = [f"box.mesh {d} {int(d == 5)} 0 {20 * k} 0 1 0 0 0" for k, d in enumerate(densities)]
    (tmp_path / "a-scene.txt").write_text("\n".join(["4", *rows]))
    meshes = load_scene_file(tmp_path / "a-scene.txt")
    light, heavy, middle, fixed = body_colours(SimpleNamespace(meshes=meshes))
    np.testing.assert_allclose(light, VIRIDIS[0])
    np.testing.assert_allclose(heavy, VIRIDIS[-1])
    np.testing.assert_allclose(middle, VIRIDIS[len(VIRIDIS) // 2])
    np.testing.assert_allclose(fixed, FIXED_COLOUR)
    assert [text for text, _ in legend(meshes)] == [
        "density 10", "density 100", "density 1000", "fixed"
    ]  # fmt: skip
    np.testing.assert_allclose(legend(meshes)[1][1], middle)
    np.testing.assert_allclose(body_colours(SimpleNamespace(meshes=meshes[:1])), VIRIDIS[[len(VIRIDIS) // 2]])


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


def ties_along_x(*bounds):
    """`Ties` between vertices of two bodies: per pair of bounds, the next vertex of either."""
    meshes = [SimpleNamespace(currVertices=np.zeros((len(bounds) + 2, 3))) for _ in range(2)]
    constraints = [
        [0, k, 1, k, bound, upper]
        for k, pair in enumerate(bounds)
        for bound, upper in zip(pair, (False, True), strict=True)
    ]
    return Ties(SimpleNamespace(meshes=meshes, constraints=constraints))


@pytest.mark.parametrize(
    ("bounds", "places"),
    # Distance to place on the scale: 0 slack, 1 taut, 2 exceeded by a twentieth of the upper bound.
    [
        pytest.param((0.0, 2.0), {0.0: 0, 0.5: 0.25, 2.0: 1, 2.05: 1.5, 2.1: 2, 9.0: 2}, id="rope"),
        pytest.param((0.9, 1.1), {1.0: 0, 0.95: 0.5, 0.9: 1, 1.1: 1, 1.155: 2, 0.845: 2, 0.2: 2},
                     id="band"),
        pytest.param((4.0, 4.0), {4.0: 1, 4.1: 1.5, 3.9: 1.5, 4.2: 2, 3.8: 2}, id="rod"),
        pytest.param((0.0, 0.0), {0.0: 1, 0.5: 1.5, 1.0: 2}, id="no length"),
    ],
)  # fmt: skip
def test_ties_show_by_their_colour_how_taut_they_are(bounds, places):
    ties = ties_along_x(*[bounds] * len(places))
    distances = np.array(list(places))
    vertices = np.zeros((2 * (len(places) + 2), 3))
    vertices[len(places) + 2 : 2 * len(places) + 2, 0] = distances
    assert ties.ends.tolist() == [[k, len(places) + 2 + k] for k in range(len(places))]
    nodes = ties.nodes(vertices)
    assert np.array_equal(nodes[1::2, 0] - nodes[::2, 0], distances)
    low = np.minimum(np.array(list(places.values()), dtype=float).astype(int), 1)
    part = (np.array(list(places.values())) - low)[:, None]
    expected = (1 - part) * TIE_COLOURS[low] + part * TIE_COLOURS[low + 1]
    np.testing.assert_allclose(ties.colours(vertices), expected, atol=1e-12)


def test_two_bounds_are_one_line_and_the_tighter_ones_count():
    simulation = Simulation(DATA / "cube-scene.txt")
    ties = Ties(simulation)
    assert len(simulation.constraints) == 56 and ties.ends.shape == (28, 2)
    vertices = np.concatenate([mesh.currVertices for mesh in simulation.meshes])
    lengths = np.linalg.norm(np.diff(vertices[ties.ends], axis=1)[:, 0], axis=1)
    np.testing.assert_allclose([ties.least, ties.most], [lengths, lengths], rtol=1e-14)
    # Rods as long as at the start: taut.
    np.testing.assert_allclose(ties.colours(vertices), [TIE_COLOURS[1]] * 28, atol=1e-9)
    simulation.constraints += [[*simulation.constraints[0][:4], bound, upper]
                               for bound in (1.0, 99.0) for upper in (False, True)]  # fmt: skip
    ties = Ties(simulation)
    assert (ties.least[0], ties.most[0], len(ties.ends)) == (99.0, 1.0, 28)
    assert Ties(Simulation(DATA / "tet-scene.txt")).ends.shape == (0, 2)


def test_camera_sees_all_of_a_scene_and_stands_no_further_than_it_must():
    generator = np.random.default_rng(3)
    for aspect in (0.5, 1.0, 16 / 9):
        points = generator.normal(size=(50, 3)) * [30.0, 5.0, 10.0] + [7.0, 20.0, -3.0]
        position, target = frame_camera(points, VIEW_DIRECTION, 45.0, aspect)
        x, y, depth = in_camera(points, position, target)
        half = math.tan(math.radians(22.5))
        reach = np.maximum(np.abs(x) / (depth * half * aspect), np.abs(y) / (depth * half))
        assert np.all(depth > 0.0)
        assert np.max(reach) == pytest.approx(1.0 - RBSDrawing.FRAME_MARGIN)


def in_camera(points, position, target):
    """(right, up, forward) of points (n, 3) seen from a camera whose up is y: three (n,)."""
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    arms = points - position
    return arms @ right, arms @ up, arms @ forward


# --------------------------------------------------------------------------------------------------
# Pictures
# --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def polyscope():
    """Polyscope, drawing off-screen in this process; started once, for it cannot be twice."""
    backend = require_opengl()
    import polyscope as ps

    if not ps.is_initialized():
        RBSDrawing.start_polyscope(backend)
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
    rows = ["box.mesh 1 0 -25 12 0 1 0 0 0", "box.mesh 9 0 25 12 0 1 0 0 0",
            "box.mesh 3 1 0 12 0 1 0 0 0"]  # fmt: skip
    (tmp_path / "two-scene.txt").write_text("\n".join(["3", *rows]))
    return SceneView(Simulation(tmp_path / "two-scene.txt"))


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
    shadow = shot[pixel_of(polyscope, [25.0, 0.0, 3.0])]
    assert sky[2] > sky[0] + 0.02  # bluish
    assert np.ptp(bare) < 0.02 and 0.3 < np.mean(bare) < 0.9  # grey
    assert np.mean(shadow) < 0.6 * np.mean(bare)
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
    assert shows(picture(polyscope)[pixel_of(polyscope, middle)], VIRIDIS[4])


# --------------------------------------------------------------------------------------------------
# The panel
# --------------------------------------------------------------------------------------------------


@pytest.fixture
def panel(polyscope):
    """The panel over the mixed scene, drawn frame by frame through Polyscope's callback."""
    simulation = Simulation(DATA / "mixed-scene.txt")
    result = Panel(make_viewer(simulation, SceneView(simulation)))
    polyscope.set_build_default_gui_panels(False)
    polyscope.set_open_imgui_window_for_user_callback(False)
    polyscope.set_user_callback(result.frame)
    polyscope.frame_tick()
    yield result
    polyscope.clear_user_callback()


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
    for kind in ("Button", "Selectable", "BeginCombo", "InputDouble", "Checkbox"):
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
    restitution, timeStep = panel.fields
    type_into(polyscope, places["restitution"], "0.9")
    assert simulation.settings.restitution == 0.9 and restitution.message == ""
    type_into(polyscope, places["restitution"], "1.5")
    assert simulation.settings.restitution == 0.9
    assert restitution.message == "the restitution must lie between 0 and 1, not 1.5"
    polyscope.frame_tick()  # the message has moved the field below it
    type_into(polyscope, places["time step (s)"], "0.005")
    assert simulation.settings.timeStep == 0.005 and timeStep.message == ""
    assert simulation.stepCount == 0 and not panel.viewer.isPlaying


def test_checkbox_and_scene_list_work(polyscope, places, panel):
    viewer = panel.viewer
    click(polyscope, *places["closing contacts only"])
    assert viewer.simulation.settings.closingOnly
    click(polyscope, *places["scene"])
    polyscope.frame_tick()
    click(polyscope, *places["cube"])
    assert viewer.simulation.scenePath == DATA / "cube-scene.txt"
    assert len(viewer.simulation.meshes) == 8


def test_constraints_can_be_switched_off_and_their_scheduling_chosen(polyscope, places, panel):
    settings = panel.viewer.simulation.settings
    polyscope.frame_tick()
    assert "scheduling" not in places  # the mixed scene has no constraints
    panel.viewer.open(DATA / "cube-scene.txt")
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
# The window
# --------------------------------------------------------------------------------------------------

# Opens the window on a scene, and tells line by line: the middle of the button Play when it is
# first drawn, and the step count at the end, which Ctrl-C brings about: without a window manager,
# nobody could ask the window to close.
WINDOW_PROGRAM = """
import sys
import polyscope.imgui as psim
from RBSViewer import find_backend, show_window
from RigidBodySimulation import Simulation

drawButton, told = psim.Button, []

def button(label, *arguments):
    answer = drawButton(label, *arguments)
    if label.startswith("Play") and not told:
        (left, top), (right, bottom) = psim.GetItemRectMin(), psim.GetItemRectMax()
        told.append(label)
        print(int(left + right) // 2, int(top + bottom) // 2, flush=True)
    return answer

psim.Button = button
simulation = Simulation(sys.argv[1])
backend = find_backend(window=True)
if not backend.opensWindow:
    sys.exit(backend.reason)
try:
    show_window(simulation, backend)
except KeyboardInterrupt:
    print(simulation.stepCount, flush=True)
"""


@pytest.fixture
def display():
    """The name of a virtual screen."""
    missing = [tool for tool in ("Xvfb", "xdotool") if shutil.which(tool) is None]
    if missing:
        skip_or_fail(f"{' and '.join(missing)} missing: apt-get install xvfb xdotool")
    reader, writer = os.pipe()
    # It chooses a free number itself, and writes it when it is ready.
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(writer), "-screen", "0", "1280x900x24"],
        pass_fds=[writer], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    os.close(writer)
    with os.fdopen(reader) as answer:
        number = answer.readline().strip()
    yield f":{number}"
    server.terminate()
    server.wait(timeout=20)


def test_a_click_on_play_plays_the_scene_in_the_window(display, tmp_path):
    environment = {**os.environ, "DISPLAY": display, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        [sys.executable, "-c", WINDOW_PROGRAM, DATA / "tower-scene.txt"],
        cwd=tmp_path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip

    def xdotool(*arguments):
        done = subprocess.run(
            ["xdotool", *map(str, arguments)], env=environment, capture_output=True, text=True,
            timeout=30,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout.split()

    try:
        first = process.stdout.readline().split()
        if len(first) != 2:
            skip_or_fail(f"no window opens on the virtual screen: {process.stderr.read()}")
        x, y = map(int, first)
        window = xdotool("search", "--sync", "--onlyvisible", "--name", "Rigid bodies")[0]
        # A busy machine draws a frame now and then only; it has to see the button down, and play.
        xdotool("mousemove", "--window", window, x, y, "sleep", 1)
        xdotool("mousedown", 1, "sleep", 0.5, "mouseup", 1, "sleep", 6)
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=30)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 0, errors
    assert int(output.split()[-1]) >= 5
    assert list(tmp_path.iterdir()) == []
