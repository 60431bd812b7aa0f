"""What is drawn where, judged by pixels and rays; pictures, cameras and videos. Off-screen."""

import colorsys
import json
from functools import partial

import numpy as np
import pytest
from opengl import pixel_of
from oracles import body
from program import DATA

from rbs.appearance.camera import load_camera, video_timing
from rbs.appearance.colours import (
    BOX_COLOUR,
    COLOURINGS,
    FIXED_COLOUR,
    MARK_COLOUR,
    PICKED_COLOUR,
    VELOCITY_COLOUR,
    Highlight,
)
from rbs.appearance.drawables import Arrows
from rbs.appearance.shading import poses_of
from rbs.pictures.capture import draw_frame, draw_still, take_picture
from rbs.pictures.overlays import OVERLAYS
from rbs.pictures.view import SceneView
from rbs.pictures.viewpoint import apply_camera, save_camera
from rbs.recordings.encoder import CODECS, Video
from rbs.scenes.simulation import SceneSimulation

# Shading changes brightness and saturation, and moves the hue by less than this on a circle of
# length 1. The ends of the scale of densities are 0.4 apart.
SAME_HUE = 0.03
# The saturation, in HSV, below which a pixel counts as grey.
GREY = 0.12


@pytest.fixture(scope="module")
def ps(polyscope):
    polyscope.set_window_size(640, 360)
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


def picture(ps):
    """What the camera sees, (height, width, 3) floats from 0 to 1."""
    return ps.screenshot_to_buffer(transparent_bg=False)[:, :, :3] / 255.0


def front(mesh):
    """The middle of a box's face towards the camera, away from all edges."""
    return mesh.position[0] + [0.0, 0.0, 4.0]


def shows(seen, colour):
    """Whether the pixel `seen` may be a body of this colour, both RGB, in some light."""
    hue, saturation, _ = colorsys.rgb_to_hsv(*seen)
    expectedHue, expectedSaturation, _ = colorsys.rgb_to_hsv(*colour)
    if expectedSaturation < GREY:
        return saturation < GREY
    apart = abs(hue - expectedHue)
    return saturation > GREY and min(apart, 1.0 - apart) < SAME_HUE


@pytest.mark.parametrize("colouring", COLOURINGS)
def test_bodies_are_drawn_where_they_stand_in_their_colours(ps, view, colouring):
    view.colouring, simulation = colouring, view.simulation
    for _ in range(40):
        simulation.step()
    assert simulation.meshes[0].position[0, 1] < 9.0
    view.refresh()
    shot, colours = picture(ps), view.body_colours()
    seen = [shot[pixel_of(ps, front(mesh))] for mesh in simulation.meshes]
    assert all(map(shows, seen, colours)) and view.legend()[-1] == ("fixed", FIXED_COLOUR)
    if colouring == "density":
        isShown = [[shows(pixel, colour) for colour in colours] for pixel in seen]
        assert isShown == np.eye(3, dtype=bool).tolist()


def test_camera_comes_back_from_its_file(tmp_path, ps, view):
    path = tmp_path / "camera.json"
    ps.set_vertical_fov_degrees(30.0)
    ps.look_at((60.0, 30.0, 50.0), (0.0, 9.0, 0.0))
    seen, size = picture(ps), ps.get_window_size()
    save_camera(path)
    ps.set_vertical_fov_degrees(45.0)
    view.rebuild(view.simulation)
    assert np.abs(picture(ps) - seen).max() > 0.2
    # The file is Polyscope's own, which would change the window's size too.
    path.write_text(json.dumps(json.loads(path.read_text()) | {"windowWidth": 320, "farClip": 1.0}))
    apply_camera(load_camera(path))
    # In single precision, hair lines may fall into the next pixel.
    assert ps.get_window_size() == size and np.mean(np.abs(picture(ps) - seen)) < 1e-3
    ps.set_vertical_fov_degrees(45.0)


def test_click_picks_the_body_that_is_seen_there(ps):
    """In the stack, all boxes are seen; above them and beside them is nothing."""
    view = SceneView(SceneSimulation(DATA / "stack-scene.txt"))
    for k, mesh in enumerate(view.simulation.meshes):
        point = front(mesh)
        row, column = pixel_of(ps, point)
        body, place = view.body_at((column, row))
        assert body == k and np.linalg.norm(place - point) < 0.5
        for x in (-40.0, 40.0):
            row, column = pixel_of(ps, point + [x, 0.0, 0.0])
            assert view.body_at((column, row)) == (None, None)


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
    simulation, bare = view.simulation, take_picture(view)
    mesh = simulation.meshes[0]
    mesh.linVelocity = np.array([[0.0, 20.0, 0.0]])
    view.show("velocities", True)
    arrows = view.overlays.onTop["velocities"]
    tip = pixel_of(ps, arrows.points[0] + 0.8 * arrows.vectors[0])
    np.testing.assert_allclose(take_picture(view)[tip], np.multiply(255, VELOCITY_COLOUR), atol=40)
    view.show("velocities", False)
    view.pick(0, front(mesh))
    np.testing.assert_allclose(view.picked_point(), front(mesh))
    seen, mark = take_picture(view), 255 * np.array(MARK_COLOUR)
    np.testing.assert_allclose(seen[pixel_of(ps, front(mesh))], mark, atol=2)
    # The outline holds all vertices.
    outline = view.outline(view.picked)
    pixels = np.array([pixel_of(ps, vertex)[::-1] for vertex in mesh.currVertices])
    assert len(outline) >= 4
    np.testing.assert_allclose(np.ptp(outline, axis=0), np.ptp(pixels, axis=0), atol=2.0)

    def is_outlined(picture, colour):
        for column, row in np.rint(0.5 * (outline + np.roll(outline, 1, axis=0))).astype(int):
            around = picture[row - 2 : row + 3, column - 2 : column + 3]
            yield np.abs(around - np.multiply(255, colour)).sum(axis=2).min() < 150

    assert all(is_outlined(seen, PICKED_COLOUR))
    view.pick(None)
    np.testing.assert_array_equal(take_picture(view), bare)
    view.highlight = Highlight(poses_of(simulation.meshes), [0], {})
    assert all(is_outlined(take_picture(view), BOX_COLOUR))
    view.highlight = None


@pytest.mark.parametrize("isFramed", [True, False])
def test_a_still_shows_what_has_rolled_away_unless_a_camera_was_given(ps, tmp_path, isFramed):
    view = SceneView(SceneSimulation(DATA / "mixed-scene.txt"))
    view.framesStills = isFramed
    meshes, size = view.simulation.meshes, ps.get_window_size()[::-1]
    meshes[1].position = np.array([[70.0, 5.0, 0.0]])
    draw_still(view, tmp_path / "still.png")
    pixels = np.array([pixel_of(ps, mesh.position[0]) for mesh in meshes])
    assert ((pixels >= 0) & (pixels < size)).all() == isFramed


# Time step and steps per frame that are asked for; frames per second and steps as used.
TIMINGS = [
    ((0.02, None), (25.0, 2)),
    ((0.1, None), (10.0, 1)),  # no more pictures than steps
    ((0.02, 10), (5.0, 10)),
    ((1e-9, 1), (1e4, 1)),  # as far as an encoder can
    ((1e3, None), (0.01, 1)),
]


@pytest.mark.parametrize(("asked", "expected"), TIMINGS)
def test_videos_play_in_real_time(asked, expected):
    assert video_timing(*asked) == pytest.approx(expected)


@pytest.mark.parametrize("ending", CODECS)
def test_videos_have_each_picture_once_and_are_written_whole_or_not_at_all(tmp_path, view, ending):
    reader = pytest.importorskip("imageio_ffmpeg", reason="pip install imageio-ffmpeg")
    simulation, path = view.simulation, tmp_path / f"fall{ending}"
    path.write_bytes(b"old")
    video = Video(path, partial(draw_frame, view), 25.0, 4)
    video.add(simulation)
    for _ in range(21):
        simulation.step()
        video.add(simulation)
        video.add(simulation)  # as after a frame in which no step was made
    assert video.count == 6 and path.read_bytes() == b"old"
    video.save(simulation)
    video.close()
    _, *frames = reader.read_frames(str(path))
    frames = np.array([np.frombuffer(frame, np.uint8) for frame in frames], dtype=int)
    # The boxes fall from picture to picture.
    assert len(frames) == 6 and (np.abs(np.diff(frames, axis=0)).mean(axis=1) > 0.01).all()
    interrupted = Video(tmp_path / f"cut{ending}", partial(draw_frame, view), 25.0, 1)
    interrupted.add(simulation)
    interrupted.close()
    assert [one.name for one in tmp_path.iterdir() if one.suffix == ending] == [path.name]
