"""The light of the window: smooth bodies, the sun, and soft shadows."""

import math

import numpy as np
from program import DATA

from rbs.appearance.drawables import SHADOW_SLANT
from rbs.appearance.shading import SHADOW_BLUR, FloorShadows, LitSurface, poses_of
from rbs.scenes.simulation import SceneSimulation

HALF_TURN = np.array([[0.0, 0.0, 1.0, 0.0]])


def scene_of(folder, names):
    rows = [f"{name} 1 0 {20 * k} 12 0 1 0 0 0" for k, name in enumerate(names)]
    for name in set(names):
        (folder / name).write_bytes((DATA / name).read_bytes())
    (folder / "row-scene.txt").write_text("\n".join([str(len(names)), *rows]))
    return SceneSimulation(folder / "row-scene.txt")


def test_vertices_are_split_at_creases_and_keep_their_places(tmp_path):
    simulation = scene_of(tmp_path, ["box.mesh", "ball.mesh", "box.mesh"])
    surface = LitSurface(simulation.meshes)
    ball = simulation.meshes[1]
    assert len(surface.source) == 24 + len(ball.origVertices) + 24
    vertices = surface.place(poses_of(simulation.meshes))
    light = surface.lit(np.ones((3, 3)))
    for body, mesh in enumerate(simulation.meshes):
        corners = vertices[surface.source][surface.faces[surface.bodyOfFace == body]]
        np.testing.assert_allclose(corners, mesh.currVertices[mesh.faces], atol=1e-5)
    # Each side of a box has one light, the upper one the most.
    sides = light[surface.faces[surface.bodyOfFace == 0]]
    assert np.ptp(sides, axis=1).max() < 1e-6
    heights = vertices[surface.source][surface.faces[surface.bodyOfFace == 0]][..., 1]
    assert sides[:, 0, 0].argmax() in np.flatnonzero(heights.min(axis=1) > 12.0)


def test_light_stays_in_the_world_while_a_body_turns(tmp_path):
    simulation = scene_of(tmp_path, ["box.mesh"])
    surface = LitSurface(simulation.meshes)
    before, light = surface.place(poses_of(simulation.meshes)), surface.lit(np.ones((1, 3)))
    simulation.meshes[0].orientation = HALF_TURN
    after, turned = surface.place(poses_of(simulation.meshes)), surface.lit(np.ones((1, 3)))
    left, leftAfter = (v[surface.source][:, 0] < 0.0 for v in (before, after))
    assert (left != leftAfter).all()
    np.testing.assert_allclose(light[left].mean(), turned[leftAfter].mean(), atol=1e-6)
    assert light[left].mean() > light[~left].mean() + 0.05  # the sun is on the left


def test_shadows_are_sharp_where_bodies_stand_and_blurred_below_high_points():
    # A triangle that stands on one side, and a square high above it.
    standing = np.array([[-2.0, 0, 0], [2, 0, 0], [0, 20, 0]])
    square = np.array([[-3.0, 10, -3], [3, 10, -3], [3, 10, 3], [-3, 10, 3]])
    shadows = FloorShadows(np.array([3, 4]))
    placed = shadows.place(np.concatenate([standing, square]), 0.01)
    rims = placed.reshape(2, -1, 2, 3).transpose(2, 0, 1, 3)
    assert (rims[:, 0, :, 1] > rims[:, 1, :, 1]).all()  # the darkest is on top
    for rim, vertices in zip(rims, (standing, square), strict=True):
        corners = vertices + vertices[:, 1:2] * SHADOW_SLANT
        apart = np.linalg.norm((rim[:, :, None] - corners)[..., [0, 2]], axis=-1)
        nearest = apart[1].argmin(axis=1)
        assert set(nearest) == set(range(len(corners)))
        half = 0.5 * SHADOW_BLUR * vertices[nearest, 1]
        np.testing.assert_allclose(apart.min(axis=2), [half, half], atol=1e-5)
    # The outline of the square has its area, less the inner half of its blurred edge.
    a, b, c = placed[shadows.faces].transpose(1, 0, 2)
    area = 0.5 * np.cross(b - a, c - a)[:, 1]
    assert area.min() > -1e-5  # all are seen from above
    isInner = shadows.darkness[shadows.faces].min(axis=1) == 1.0
    isSquare = shadows.faces[:, 0] % 2 == 1
    side = 6.0 - math.sqrt(2.0) * 0.5 * SHADOW_BLUR * 10.0
    np.testing.assert_allclose(area[isInner & isSquare].sum(), side**2, rtol=1e-5)
