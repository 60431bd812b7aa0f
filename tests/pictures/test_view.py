"""What is drawn where, judged by pixels and rays; pictures, cameras and videos. Off-screen."""

import colorsys
import json
import shutil

import numpy as np
import pytest
from opengl import pixel_of
from program import DATA

from rbs.appearance.camerafiles import load_camera
from rbs.appearance.colours import (
    BOX_COLOUR,
    COLOURINGS,
    FIXED_COLOUR,
    MARK_COLOUR,
    PICKED_COLOUR,
    VELOCITY_COLOUR,
    Highlight,
)
from rbs.appearance.drawables import SHADOW_SLANT, Arrows
from rbs.appearance.pictureoptions import VIDEO_ENDINGS, video_timing
from rbs.appearance.pixels import averaged, with_legend
from rbs.appearance.shading import poses_of
from rbs.pictures.cameras import apply_camera, save_camera
from rbs.pictures.capture import SHADOW_OPACITY, Video, take_picture
from rbs.pictures.overlays import HELD_CONTACT_STEPS, OVERLAYS
from rbs.pictures.view import LAYERS, SceneView
from rbs.scenes.simulation import SceneSimulation
from RBSFunctions import refresh_vertices

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
def view(tmp_path, ps):
    """A SceneView of a light box on the left, a heavy one on the right, a fixed one between."""
    shutil.copy(DATA / "box.mesh", tmp_path)
    rows = (f"box.mesh {row} 12 0 1 0 0 0" for row in ("1 0 -25", "9 0 25", "3 1 0"))
    (tmp_path / "a-scene.txt").write_text("\n".join(["3", *rows]))
    view = SceneView(SceneSimulation(tmp_path / "a-scene.txt"))
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


def test_constraints_are_drawn_only_while_they_are_enforced(ps):
    simulation = SceneSimulation(DATA / "cube-scene.txt")
    view = SceneView(simulation)
    lines = ps.get_curve_network("constraints")
    assert (lines.n_edges(), lines.is_enabled()) == (28, True)
    simulation.settings.enforceConstraints = False
    view.refresh()
    assert not lines.is_enabled()
    view.rebuild(SceneSimulation(DATA / "tet-scene.txt"))
    assert not ps.has_curve_network("constraints")


def test_edges_are_drawn_dark(ps, view):
    shot, mesh = picture(ps), view.simulation.meshes[0]
    x, top, near = mesh.position[0, 0], *mesh.currVertices.max(axis=0)[1:]
    row, column = pixel_of(ps, [x, top, near])
    plain = shot[pixel_of(ps, front(mesh))].sum()
    assert shot[row - 1 : row + 3, column].sum(axis=1).min() < 0.7 * plain


def test_what_rests_is_not_drawn_again(ps, view, monkeypatch):
    drawn = []
    monkeypatch.setattr(ps.SurfaceMesh, "update_vertex_positions", lambda *row: drawn.append(row))
    view.refresh()
    assert drawn == []
    view.simulation.step()
    view.refresh()
    assert len(drawn) == 2  # the bodies and their shadows


def test_nothing_is_drawn_below_the_panels_except_in_pictures(ps, view):
    expected, (width, height) = take_picture(view), ps.get_window_size()
    view.set_callback(lambda: None)
    view.set_margins((200, 0, 100, 40), (width, height))
    before = picture(ps)
    ps.set_background_color((1.0, 0.0, 0.0))
    changed = (picture(ps) != before).any(axis=2)
    inside = np.zeros_like(changed)
    inside[: height - 40, 200 : width - 100] = True
    assert changed[inside].mean() > 0.05 and not changed[~inside].any()
    # Edges are those of a moving picture.
    assert np.abs(take_picture(view) - expected.astype(float)).mean() < 0.5
    assert np.abs(picture(ps)[inside] - before[inside]).mean() < 1e-3
    view.set_callback(None)


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
    camera = json.loads(path.read_text())
    assert (camera["windowWidth"], camera["windowHeight"]) == size
    path.write_text(json.dumps(camera | {"windowWidth": 320, "windowHeight": 240, "farClip": 1.0}))
    apply_camera(load_camera(path))
    # In single precision, hair lines may fall into the next pixel.
    assert ps.get_window_size() == size and np.mean(np.abs(picture(ps) - seen)) < 1e-3
    ps.set_vertical_fov_degrees(45.0)


def hit_by(ray, eye, meshes):
    """(index of the first convex body that a ray hits, point), or (None, None)."""
    best = np.inf, None
    for index, mesh in enumerate(meshes):
        a, b, c = (mesh.currVertices[mesh.faces[:, k]] for k in range(3))
        normals = np.cross(b - a, c - a)
        speed, height = normals @ ray, np.sum(normals * (a - eye), axis=1)
        enter, leave = (height / speed)[speed < 0].max(), (height / speed)[speed > 0].min()
        if enter < leave:
            best = min(best, (enter, index))
    return (None, None) if best[1] is None else (best[1], eye + best[0] * ray)


def test_click_picks_the_body_that_a_ray_through_the_pixel_hits(ps):
    view = SceneView(SceneSimulation(DATA / "stack-scene.txt"))
    meshes = view.simulation.meshes
    camera = ps.get_view_camera_parameters()
    axes = np.array([camera.get_right_dir(), camera.get_up_dir(), camera.get_look_dir()])
    eye, (width, height) = np.array(camera.get_position()), ps.get_window_size()
    focal = 0.5 * height / np.tan(np.radians(camera.get_fov_vertical_deg()) / 2.0)
    generator, found = np.random.default_rng(6), []
    middles = np.array([pixel_of(ps, mesh.position[0])[::-1] for mesh in meshes])
    for pixel in generator.uniform(middles.min(axis=0) - 20, middles.max(axis=0) + 20, (60, 2)):
        pixel = np.rint(pixel)

        def cast(pixel, dx, dy):
            x, y = pixel[0] + 0.5 + dx - 0.5 * width, 0.5 * height - pixel[1] - 0.5 - dy
            return hit_by(np.array([x, y, focal]) @ axes, eye, meshes)

        body, point = cast(pixel, 0, 0)
        if any(cast(pixel, dx, dy)[0] != body for dx in (-3, 3) for dy in (-3, 3)):
            continue  # too near an edge, which is drawn as a thick line
        picked, place = view.body_at(tuple(int(x) for x in pixel))
        assert picked == body
        assert body is None or np.linalg.norm(place - point) < 0.5
        found.append(body)
    assert len(found) > 30 and None in found and len(set(found)) > 5


def test_overlays_are_drawn_from_the_present_state_and_go_away(ps):
    simulation = SceneSimulation(DATA / "stress-scene.txt")
    simulation.settings.friction = 0.5
    view = SceneView(simulation)
    for name in OVERLAYS:
        view.show(name, True)
    assert not view.overlays.onTop["contacts"]  # no step yet
    while simulation.report is None or not any(any(c.friction) for c in simulation.report.contacts):
        simulation.step()
        assert simulation.stepCount < 200
    recent = set()
    # Contacts that have ended a moment ago are still shown.
    for _ in range(HELD_CONTACT_STEPS):
        simulation.step()
        view.refresh()
        recent |= {(c.body1, c.body2) for c in simulation.report.contacts}
    onTop = view.overlays.onTop
    assert recent and len(onTop["contacts"][0].points) == len(recent)
    for name in ("impulses", "friction impulses", "velocities"):
        assert isinstance(onTop[name][0], Arrows) and onTop[name][0].vectors.any()
    assert all(map(ps.has_curve_network, ("bounding boxes", "grid cells", "trails")))
    assert 0 <= ps.get_curve_network("bounding boxes").n_edges() - 12 * len(simulation.meshes) < 64
    for name in LAYERS:
        view.show(name, False)
    assert not any(map(ps.has_curve_network, OVERLAYS)) and not view.overlays.onTop


def test_overlays_that_were_moved_look_as_those_drawn_anew(ps):
    view = SceneView(SceneSimulation(DATA / "mixed-scene.txt"))
    shown = "bounding boxes", "grid cells"
    for name in (*shown, "trails"):
        view.show(name, True)
    while view.simulation.stepCount < 60:
        view.simulation.step()
        view.refresh()
    view.refresh()
    view.show("trails", False)  # which start anew
    before = picture(ps)
    for name in shown:
        view.show(name, False)
        view.show(name, True)
    np.testing.assert_array_equal(picture(ps), before)
    for name in shown:
        view.show(name, False)


def test_transparent_pictures_have_bodies_and_black_shadows(ps, view):
    view.show("ground", False)
    shot = take_picture(view, isTransparent=True)
    shadow = pixel_of(ps, [25.0, 0.0, 0.0] + 12.0 * SHADOW_SLANT)
    assert shot[shadow].tolist() == [0, 0, 0, round(255 * SHADOW_OPACITY)]
    assert shot[5, 5, 3] == 0 and shot[pixel_of(ps, front(view.simulation.meshes[0]))][3] == 255
    view.show("shadows", False)
    assert take_picture(view, isTransparent=True)[shadow][3] == 0


def test_edges_are_smooth_and_pictures_the_same_each_time(ps, view):
    rough, smooth = picture(ps), take_picture(view)
    np.testing.assert_array_equal(smooth, take_picture(view))
    np.testing.assert_allclose(smooth.mean() / 255.0, rough.mean(), atol=0.005)
    # They differ along edges; inside of faces there is nothing to average.
    isOther = np.any(np.abs(smooth / 255.0 - rough) > 0.04, axis=2)
    assert 0.002 < isOther.mean() < 0.08
    place = pixel_of(ps, front(view.simulation.meshes[0]))
    np.testing.assert_allclose(smooth[place] / 255.0, rough[place], atol=0.005)


def test_averages_are_means_of_pixels_weighted_by_opacity():
    large = np.random.default_rng(1).integers(0, 256, (6, 8, 3)).astype(np.uint8)
    expected = large.reshape(3, 2, 4, 2, 3).mean(axis=(1, 3))
    assert np.abs(averaged(large, 2) - expected).max() <= 0.5
    red, nothing = [255, 0, 0, 255], [0, 255, 0, 0]
    square = np.array([[red, nothing], [nothing, nothing]], np.uint8)
    np.testing.assert_array_equal(averaged(square, 2), [[[255, 0, 0, 64]]])


def test_pictures_show_arrows_and_the_selected_body_on_top(ps, view):
    simulation, bare = view.simulation, take_picture(view)
    mesh = simulation.meshes[0]
    mesh.linVelocity = np.array([[0.0, 20.0, 0.0]])
    view.show("velocities", True)
    arrows = view.overlays.onTop["velocities"][0]
    middle, green = pixel_of(ps, arrows.points[0] + 0.5 * arrows.vectors[0]), VELOCITY_COLOUR
    np.testing.assert_allclose(take_picture(view)[middle], np.multiply(255, green), atol=40)
    view.show("velocities", False)
    colours = view.body_colours()
    view.pick(0, front(mesh))
    np.testing.assert_array_equal(view.body_colours(), colours)  # what is fixed stays recognisable
    np.testing.assert_allclose(view.picked_point(), front(mesh))
    seen, place, mark = take_picture(view), pixel_of(ps, front(mesh)), 255 * np.array(MARK_COLOUR)
    np.testing.assert_allclose(seen[place], mark, atol=2)
    outline = view.outline(view.picked)
    # The outline holds all vertices, and each of its corners is one of them.
    pixels = np.array([pixel_of(ps, vertex)[::-1] for vertex in mesh.currVertices])
    away = np.abs(outline[:, None] - pixels[None]).max(axis=2)
    assert len(outline) >= 4 and away.min(axis=1).max() <= 1.0
    np.testing.assert_allclose(np.ptp(outline, axis=0), np.ptp(pixels, axis=0), atol=2.0)

    def is_outlined(picture, colour):
        for one, other in zip(outline, np.roll(outline, 1, axis=0), strict=True):
            column, row = np.rint(0.5 * (one + other)).astype(int)
            around = picture[row - 2 : row + 3, column - 2 : column + 3]
            yield np.abs(around - np.multiply(255, colour)).sum(axis=2).min() < 150

    assert all(is_outlined(seen, PICKED_COLOUR))
    assert 0.001 < (seen != bare).any(axis=2).mean() < 0.02
    transparent = take_picture(view, isTransparent=True)
    assert transparent[place].tolist() == [*np.rint(mark), 255]
    view.pick(None)
    np.testing.assert_array_equal(take_picture(view), bare)
    view.highlight = Highlight(poses_of(simulation.meshes), [0], {})
    assert all(is_outlined(take_picture(view), BOX_COLOUR))
    view.highlight = None


def test_legend_is_in_the_picture(view):
    bare = take_picture(view)
    view.hasLegend = True
    seen = take_picture(view)
    changed = np.any(seen != bare, axis=2)
    assert changed[9:40, 9:90].mean() > 0.95 and not changed[:7].any()
    samples = {tuple(pixel) for pixel in seen[9:120, 9:40].reshape(-1, 3).tolist()}
    colours = np.array([colour for _, colour in view.legend()])
    assert {tuple(row) for row in np.rint(255 * colours).astype(int).tolist()} <= samples


def test_legends_are_in_proportion_to_the_picture():
    rows, corners = [("density 2 kg/m³", (1.0, 0.0, 0.0)), ("fixed", (0.7, 0.7, 0.7))], []
    for height in (540, 1080):
        picture = with_legend(np.full((height, 16 * height // 9, 3), 255, np.uint8), rows)
        lines, columns = (np.flatnonzero((picture != 255).any(axis=(2, k))) for k in (1, 0))
        corners.append([lines[0], lines[-1], columns[0], columns[-1]])
    np.testing.assert_allclose(corners[1], 2 * np.array(corners[0]), atol=3)


def test_frame_all_and_follow_keep_the_bodies_in_the_picture(ps):
    view = SceneView(SceneSimulation(DATA / "mixed-scene.txt"))
    meshes, (width, height) = view.simulation.meshes, ps.get_window_size()

    def pixels_after(shift):
        for mesh in meshes:
            mesh.position = mesh.position + shift
        refresh_vertices(meshes)
        view.refresh()
        return np.array([pixel_of(ps, mesh.position[0]) for mesh in meshes])

    def are_seen(pixels):
        return ((pixels >= 0) & (pixels < [height, width])).all()

    def turns_about_the_bodies():
        middle = np.delete([mesh.position[0] for mesh in meshes], 2, axis=0).mean(axis=0)
        return np.linalg.norm(np.array(ps.get_view_center()) - middle) < view.size

    assert not are_seen(pixels_after([300.0, 0.0, -200.0]))
    view.frame_all()
    assert are_seen(before := pixels_after(0.0))
    # The ground has come along: below all bodies it is grey, unlike the sky.
    assert np.ptp(picture(ps)[pixel_of(ps, [300.0, 0.0, -200.0])]) < 0.05
    view.follows = True
    assert not np.allclose(before, pixels_after([9.0, 0.0, 7.0]), atol=1.0)
    before = pixels_after([-9.0, 0.0, -7.0])
    view.pick(1, meshes[1].position[0])
    np.testing.assert_allclose(pixels_after([-900.0, 0.0, -700.0]), before, atol=1.0)
    assert turns_about_the_bodies()
    view.follows = False
    meshes[2].position = meshes[2].position + [5000.0, 0.0, 0.0]
    view.frame_all()
    view.frame_all()
    pixels = pixels_after(0.0)
    assert turns_about_the_bodies() and are_seen(np.delete(pixels, 2, axis=0))
    assert not are_seen(pixels[2:3])


def test_the_ground_is_the_same_for_the_same_view(ps):
    view, places = SceneView(SceneSimulation(DATA / "mixed-scene.txt")), {}
    for distance in (1.0, 9.0, 27.0, 9.0, 1.0):
        ps.look_at((0.0, distance * view.size, distance * view.size), (0.0, 0.0, 0.0))
        ps.set_view_center_raw((0.0, 0.0, 0.0))
        view.spread_ground()
        found = view.groundPlace, view.squareSide
        assert places.setdefault(distance, found) == found
    assert len({side for _, side in places.values()}) == 3


def test_the_camera_stays_above_the_ground(ps):
    view = SceneView(SceneSimulation(DATA / "mixed-scene.txt"))
    ps.look_at((30.0, -40.0, 60.0), (0.0, 10.0, 0.0))
    ps.set_view_center_raw((0.0, 10.0, 0.0))
    view.keep_above_ground()
    x, y, z = ps.get_view_camera_parameters().get_position()
    assert x / z == pytest.approx(0.5, rel=1e-4) and 0.0 < y < 0.02 * view.size
    distances = [np.linalg.norm(arm) for arm in ([30.0, -50.0, 60.0], [x, y - 10.0, z])]
    assert distances[1] == pytest.approx(distances[0], rel=1e-4)


# Time step, pictures a second and steps between pictures that are asked for; the last two as used.
TIMINGS = [
    ((0.02, None, None), (25.0, 2)),
    ((0.1, None, None), (10.0, 1)),  # no more pictures than steps
    ((0.02, 10.0, None), (10.0, 5)),
    ((0.02, 30.0, 10), (30.0, 10)),  # a time lapse, six times as fast
]


@pytest.mark.parametrize(("asked", "expected"), TIMINGS)
def test_videos_play_in_real_time_unless_other_rates_are_asked_for(asked, expected):
    assert video_timing(*asked) == pytest.approx(expected)


def frames_of(path):
    """The pictures of a video, (n, height, width, 3)."""
    import imageio_ffmpeg

    reader = imageio_ffmpeg.read_frames(str(path))
    width, height = next(reader)["size"]
    return np.array([np.frombuffer(data, np.uint8).reshape(height, width, 3) for data in reader])


@pytest.mark.parametrize("ending", VIDEO_ENDINGS)
def test_videos_have_each_picture_once_and_are_written_whole_or_not_at_all(
    tmp_path, view, ending, monkeypatch
):
    pytest.importorskip("imageio_ffmpeg", reason="pip install imageio-ffmpeg")
    monkeypatch.setattr("rbs.pictures.capture.SUPERSAMPLING", 1)
    simulation, path = view.simulation, tmp_path / f"fall{ending}"
    path.write_bytes(b"old")
    video = Video(path, view, 25.0, 4)
    video.add(simulation)
    for _ in range(41):
        simulation.step()
        video.add(simulation)
        video.add(simulation)  # as after a frame in which no step was made
    assert video.count == 11 and path.read_bytes() == b"old"
    video.save(simulation)
    video.close()
    frames = frames_of(path)
    assert len(frames) == 11
    # The boxes fall from picture to picture.
    assert np.all(np.mean(np.abs(np.diff(frames.astype(int), axis=0)), axis=(1, 2, 3)) > 0.01)
    interrupted = Video(tmp_path / f"cut{ending}", view, 25.0, 1)
    interrupted.add(simulation)
    interrupted.close()
    assert [one.name for one in tmp_path.iterdir() if one.suffix == ending] == [path.name]
