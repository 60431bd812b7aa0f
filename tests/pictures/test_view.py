"""What is drawn where, judged by buffers, rays and cameras; pictures and videos. Off-screen."""

import json
from functools import partial

import numpy as np
import pytest
from oracles import body
from program import DATA

from rbs.appearance.camera import Camera, load_camera, video_timing
from rbs.appearance.colours import COLOURINGS, FIXED_COLOUR, Highlight
from rbs.appearance.drawables import Arrows
from rbs.pictures.capture import draw_frame, take_picture
from rbs.pictures.overlays import OVERLAYS, VELOCITY_SECONDS
from rbs.pictures.view import SceneView
from rbs.pictures.viewpoint import FRONT, SIDE, TOP, apply_camera, present_camera, save_camera
from rbs.recordings.encoder import CODECS, Video
from rbs.scenes.simulation import SceneSimulation
from rbs.window.hand import shot

WINDOW = (640, 360)


@pytest.fixture(scope="module")
def ps(polyscope):
    polyscope.set_window_size(*WINDOW)
    return polyscope


@pytest.fixture
def view(ps):
    """A SceneView of a light box on the left, a heavy one on the right, a fixed one between."""
    boxes = [body("box", (x, 12, 0), density=density) for x, density in ((-25, 1), (25, 9), (0, 3))]
    boxes[2].isFixed = True
    view = SceneView(SceneSimulation.from_meshes(boxes))
    view.colouring = "density"
    view.refresh()
    return view


def front(mesh):
    """The middle of a box's face towards the camera, away from all edges."""
    return mesh.position[0] + [0.0, 0.0, 4.0]


@pytest.mark.parametrize("colouring", COLOURINGS)
def test_bodies_are_drawn_where_they_stand_in_their_colours(ps, view, colouring):
    view.colouring, simulation = colouring, view.simulation
    for _ in range(40):
        simulation.step()
    view.refresh()
    drawn, surface = ps.get_surface_mesh("bodies"), view.surface
    corners, light = drawn.get_buffer("vertexPositions"), surface.lit(view.body_colours())
    colours = drawn.get_quantity_buffer("colour", "colors")
    vertices = np.concatenate([mesh.currVertices for mesh in simulation.meshes])[surface.source]
    for k in range(0, len(vertices), 7):
        np.testing.assert_allclose(corners.get_value(k).as_tuple(), vertices[k], atol=1e-4)
        np.testing.assert_allclose(colours.get_value(k).as_tuple(), light[k], atol=1e-6)
    assert view.legend()[-1] == ("fixed", FIXED_COLOUR)


def test_bodies_keep_their_colours_when_others_come_and_go(ps):
    simulation = SceneSimulation(DATA / "mixed-scene.txt")
    view = SceneView(simulation)
    before, state = view.body_colours(), simulation.state()
    simulation.add(shot(simulation.meshes, 40.0, [0.0, 9.0, 30.0], [0.0, 0.0, -1.0]))
    view.refresh()
    np.testing.assert_array_equal(view.body_colours()[:-1], before)
    ball, indices = view.body_colours()[-1], set(view.bodyColours.index.tolist())
    assert len(indices) == len(simulation.meshes)
    late = simulation.state()
    for one in (state, late):
        simulation.restore(one)
        view.refresh()
    np.testing.assert_array_equal(view.body_colours()[-1], ball)
    assert not any(hasattr(mesh, "colourIndex") for mesh in simulation.meshes)


def seen(view, bodies):
    """Whether each body is seen in the picture."""
    width, height = WINDOW
    x, y = view.pixels_of(view.poses[:3, bodies].T).T
    return (x > 0) & (x < width) & (y > 0) & (y < height)


def test_the_camera_moves_only_when_asked_and_frames_what_belongs_together(ps):
    simulation = SceneSimulation(DATA / "mixed-scene.txt")
    view = SceneView(simulation)
    first = present_camera()
    for mesh in simulation.meshes[:2]:  # one has left, and is the only thing in motion
        mesh.position = mesh.position + [500.0, 0.0, 0.0]
        view.refresh()
        assert not view.viewpoint.move(1.0)
        assert np.array_equal(present_camera().matrix, first.matrix)
    simulation.add(shot(simulation.meshes, 40.0, [0.0, 9.0, 900.0], [0.0, 0.0, 1.0]))
    view.refresh()
    ps.look_at(tuple(view.poses[:3, 7] + [0.0, 5.0, 25.0]), tuple(view.poses[:3, 7]))
    near = present_camera()
    view.viewpoint.come_back()  # it sees some of the scene
    assert np.array_equal(present_camera().matrix, near.matrix) and not seen(view, range(15)).all()
    for direction in (None, FRONT, SIDE, TOP):
        view.viewpoint.frame(direction)
        ahead = present_camera().axes[2]
        if direction is not None:
            np.testing.assert_allclose(ahead, np.negative(direction), atol=2e-3)
        assert seen(view, range(2, 15)).all() and not seen(view, [0, 1, 15]).any()
        pixels = view.pixels_of(view.vertices_of(7))
        assert np.ptp(pixels, axis=0).max() > 0.1 * WINDOW[0]
    ps.look_at((0.0, 10.0, 90.0), (0.0, 20.0, 900.0))
    view.viewpoint.come_back()
    np.testing.assert_allclose(present_camera().matrix, first.matrix, atol=1e-4)
    view.pick(0, view.poses[:3, 0])
    view.viewpoint.frame()
    assert seen(view, [0]).all() and not seen(view, range(2, 15)).any()


def test_the_camera_goes_gently_to_an_event_and_stays_there(ps):
    view = SceneView(SceneSimulation(DATA / "mixed-scene.txt"))
    eyes = [present_camera().eye]
    arrows = {"n": (view.poses[:3, 3], np.array([0.0, 5.0, 0.0]), (0.0, 0.0, 0.0))}
    view.show_event(Highlight(view.poses, [3], arrows))
    while view.viewpoint.move(0.1):
        eyes.append(present_camera().eye)
        assert len(eyes) < 60
    ways = np.linalg.norm(np.diff(eyes, axis=0), axis=1)
    assert len(eyes) > 10 and ways.argmax() == 0 and ways.max() < 0.4 * ways.sum()
    assert np.ptp(view.pixels_of(view.vertices_of(3)), axis=0).max() > 0.3 * WINDOW[1]
    view.show_event(None)


def test_camera_comes_back_from_its_file(tmp_path, ps, view):
    path, angle = tmp_path / "camera.json", present_camera().angle
    camera = Camera.looking((60.0, 30.0, 50.0), (0.0, 9.0, 0.0), 30.0)
    apply_camera(camera)
    save_camera(path)
    apply_camera(camera._replace(angle=angle))
    view.rebuild(view.simulation)
    # The file is Polyscope's own, which would change the window's size too.
    path.write_text(json.dumps(json.loads(path.read_text()) | {"windowWidth": 320, "farClip": 1.0}))
    apply_camera(load_camera(path))
    np.testing.assert_allclose(present_camera().matrix, camera.matrix, rtol=1e-5, atol=1e-4)
    assert ps.get_window_size() == WINDOW and present_camera().angle == pytest.approx(30.0)
    ps.set_vertical_fov_degrees(angle)


def test_click_picks_the_body_that_is_seen_there(ps):
    """In the stack, all boxes are seen; above them and beside them is nothing."""
    view = SceneView(SceneSimulation(DATA / "stack-scene.txt"))
    for k, mesh in enumerate(view.simulation.meshes):
        point = front(mesh)
        at, *beside = view.pixels_of(point + [[0, 0, 0], [-40, 0, 0], [40, 0, 0]]).round()
        body, place = view.body_at(at.astype(int))
        assert body == k and np.linalg.norm(place - point) < 0.5
        assert [view.body_at(one.astype(int)) for one in beside] == 2 * [(None, None)]


def test_overlays_are_drawn_from_the_present_state_and_go_away(ps):
    simulation = SceneSimulation(DATA / "stress-scene.txt")
    simulation.settings.friction = 0.5
    view = SceneView(simulation)
    for name in OVERLAYS:
        view.show(name, True)
    assert not len(view.overlays.onTop["contacts"].points)  # no step yet
    while simulation.report is None or not any(any(c.friction) for c in simulation.report.contacts):
        simulation.step()
        view.refresh()
        assert simulation.stepCount < 200
    onTop = view.overlays.onTop
    points = [contact.point for contact in simulation.report.contacts]  # body 1 may move after it
    np.testing.assert_allclose(onTop["contacts"].points, points, atol=0.2)
    for name in ("impulses", "friction impulses", "velocities"):
        assert isinstance(onTop[name], Arrows) and onTop[name].vectors.any()
    assert all(map(ps.has_curve_network, ("bounding boxes", "grid cells", "trails")))
    assert 0 <= ps.get_curve_network("bounding boxes").n_edges() - 12 * len(simulation.meshes) < 64
    for name in OVERLAYS:
        view.show(name, False)
    assert not any(map(ps.has_curve_network, OVERLAYS)) and not view.overlays.onTop


def test_pictures_show_arrows_and_outlined_bodies_on_top(ps, view):
    """Of a picture as a whole: marks change it where they are, and are gone afterwards."""
    mesh, bare = view.simulation.meshes[0], take_picture(view).astype(int)

    def change():
        """The box of what is not as in the bare picture: (x, y) of its corners."""
        changed = np.argwhere(np.abs(take_picture(view) - bare).sum(axis=2) > 60)[:, ::-1]
        return np.array([changed.min(axis=0), changed.max(axis=0)])

    mesh.linVelocity = np.array([[0.0, 20.0, 0.0]])
    view.show("velocities", True)
    tip = mesh.position[0] + VELOCITY_SECONDS * mesh.linVelocity[0]
    ends = view.pixels_of([mesh.position[0], tip])
    assert np.abs(change() - np.sort(ends, axis=0)).max() < 12
    view.show("velocities", False)
    view.pick(0, front(mesh))
    outline = view.pixels_of(mesh.currVertices)
    np.testing.assert_allclose(change(), [outline.min(axis=0), outline.max(axis=0)], atol=6.0)
    view.pick(None)
    np.testing.assert_array_equal(take_picture(view), bare)


@pytest.mark.parametrize("look", ["plain", pytest.param("studio", marks=pytest.mark.slow)])
def test_without_a_ground_there_is_neither_floor_nor_shadow(view, look):
    view.look = look
    view.show("velocities", True)
    for isThere in (True, False, True):
        view.simulation.settings.ground = isThere
        view.refresh()
        assert ("floor" in view.legend()[-1][0]) == isThere
        below = take_picture(view)[-40:].astype(int)
        assert (np.abs(np.diff(below, axis=1)).max() > 4) == isThere


def test_videos_play_in_real_time():
    assert video_timing(0.02) == pytest.approx((25.0, 2))
    assert video_timing(0.1) == pytest.approx((10.0, 1))  # no more pictures than steps
    assert video_timing(1e-9, 1) == pytest.approx((1e4, 1))  # as far as an encoder can


@pytest.mark.parametrize("ending", CODECS)
def test_a_film_is_as_long_as_what_was_seen(tmp_path, view, ending):
    """In a window of few frames a second."""
    pytest.importorskip("imageio_ffmpeg", reason="pip install imageio-ffmpeg")
    film = Video(tmp_path / f"film{ending}", partial(draw_frame, view), 30.0, 1)
    for seconds in (0.0, 0.01, 0.3, 0.31, 2.0):
        film.film(seconds)
    assert film.count == 61
    film.close()
    assert not list(tmp_path.iterdir())
