"""Colours, lines, lit surfaces and the camera's place, as numbers; nothing is drawn."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from oracles import body

from rbs.appearance import camera as framing, drawables
from rbs.appearance.shading import LitSurface, poses_of

# Bounds of a constraint, and a map from distance to kind: 0 slack, 1 taut, 2 exceeded.
TAUTNESS = {
    "rope": ((0.0, 2.0), {0.0: 0, 1.97: 0, 1.99: 1, 2.0: 1, 2.01: 1, 2.03: 2, 9.0: 2}),
    "band": ((0.9, 1.1), {1.0: 0, 0.92: 0, 0.9: 1, 1.1: 1, 1.12: 2, 0.88: 2, 0.2: 2}),
    "rod": ((4.0, 4.0), {4.0: 1, 4.03: 1, 3.97: 1, 4.05: 2, 3.95: 2}),
    "no length": ((0.0, 0.0), {0.0: 1, 0.5: 2, 1.0: 2}),
}


@pytest.mark.parametrize("name", TAUTNESS)
def test_constraint_lines_are_slack_taut_or_exceeded(name):
    (low, high), kinds = TAUTNESS[name]
    count = len(kinds)
    constraints = [
        [0, k, 1, k, *bound] for k in range(count) for bound in ((low, False), (high, True))
    ]
    meshes = [SimpleNamespace(currVertices=np.zeros((count, 3)))] * 2
    lines = drawables.ConstraintLines(SimpleNamespace(meshes=meshes, constraints=constraints))
    assert lines.ends.tolist() == [[k, count + k] for k in range(count)]
    vertices = np.zeros((2 * count, 3))
    vertices[count:, 0] = list(kinds)
    assert lines.kinds(vertices).tolist() == list(kinds.values())


MARGINS = [(0, 0, 0, 0), (320, 0, 320, 0), (240, 0, 0, 66), (0, 30, 250, 90)]


@pytest.mark.parametrize("margins", MARGINS)
def test_camera_sees_all_of_a_scene_beside_the_panels_as_large_as_possible(margins):
    points = np.random.default_rng(4).normal(size=(60, 3)) * [40.0, 6.0, 12.0] + [-3.0, 9.0, 5.0]
    left, top, rightMargin, bottom = margins
    for width, height in ((1280, 720), (720, 1280)):
        camera = framing.frame_camera(
            points, framing.VIEW_DIRECTION, 45.0, (width, height), margins
        )
        ahead = (camera.centre - camera.eye) / np.linalg.norm(camera.centre - camera.eye)
        aside = np.cross(ahead, [0.0, 1.0, 0.0])
        aside /= np.linalg.norm(aside)
        axes = np.array([aside, np.cross(aside, ahead), ahead])
        right, up, depth = axes @ (points - camera.eye).T
        scale = height / 2 / math.tan(math.radians(22.5)) / depth
        assert np.all(depth > 0.0)
        x = (width / 2 + scale * right - left) / (width - left - rightMargin)
        y = (height / 2 - scale * up - top) / (height - top - bottom)
        rim = framing.FRAME_MARGIN / 2 - 1e-9
        assert min(x.min(), y.min()) >= rim and max(x.max(), y.max()) <= 1.0 - rim
        # The points touch the free rims of both sides, or of top and bottom.
        assert max(np.ptp(x), np.ptp(y)) == pytest.approx(1.0 - framing.FRAME_MARGIN)


def test_vertices_are_split_at_creases_and_keep_their_places():
    meshes = [body(name, (20 * k, 12, 0)) for k, name in enumerate(("box", "ball", "box"))]
    surface, ball = LitSurface(meshes), meshes[1]
    assert len(surface.source) == 24 + len(ball.origVertices) + 24
    vertices = surface.place(poses_of(meshes))
    light = surface.lit(np.ones((3, 3)))
    for k, mesh in enumerate(meshes):
        corners = vertices[surface.source][surface.faces[surface.bodyOfFace == k]]
        np.testing.assert_allclose(corners, mesh.currVertices[mesh.faces], atol=1e-5)
    # Each side of a box has one light, the upper one the most.
    sides = light[surface.faces[surface.bodyOfFace == 0]]
    assert np.ptp(sides, axis=1).max() < 1e-6
    heights = vertices[surface.source][surface.faces[surface.bodyOfFace == 0]][..., 1]
    assert sides[:, 0, 0].argmax() in np.flatnonzero(heights.min(axis=1) > 12.0)
