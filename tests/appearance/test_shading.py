"""The light of the window: smooth bodies, the sun, and soft shadows."""

import numpy as np
from program import DATA

from rbs.appearance.shading import SHADOW_LAYERS, LitSurface, poses_of, soft_shadows
from rbs.scenes.simulation import Simulation

HALF_TURN = np.array([[0.0, 0.0, 1.0, 0.0]])


def scene_of(folder, names):
    rows = [f"{name} 1 0 {20 * k} 12 0 1 0 0 0" for k, name in enumerate(names)]
    for name in set(names):
        (folder / name).write_bytes((DATA / name).read_bytes())
    (folder / "row-scene.txt").write_text("\n".join([str(len(names)), *rows]))
    return Simulation(folder / "row-scene.txt")


def test_vertices_are_split_at_creases_and_keep_their_places(tmp_path):
    simulation = scene_of(tmp_path, ["box.mesh", "ball.mesh", "box.mesh"])
    surface = LitSurface(simulation.meshes)
    count = np.bincount(surface.bodyOfVertex)
    ball = simulation.meshes[1]
    assert count.tolist() == [24, len(ball.origVertices), 24]
    vertices, light = surface.place(poses_of(simulation.meshes))
    for body, mesh in enumerate(simulation.meshes):
        corners = vertices[surface.source][surface.faces[surface.bodyOfFace == body]]
        np.testing.assert_allclose(corners, mesh.currVertices[mesh.faces], atol=1e-9)
    # Each side of a box has one light, the upper one the most.
    sides = light[surface.faces[surface.bodyOfFace == 0]]
    assert np.ptp(sides, axis=1).max() < 1e-6
    heights = vertices[surface.source][surface.faces[surface.bodyOfFace == 0]][..., 1]
    assert sides[:, 0, 0].argmax() in np.flatnonzero(heights.min(axis=1) > 12.0)


def test_light_stays_in_the_world_while_a_body_turns(tmp_path):
    simulation = scene_of(tmp_path, ["box.mesh"])
    surface = LitSurface(simulation.meshes)
    before, light = surface.place(poses_of(simulation.meshes))
    simulation.meshes[0].orientation = HALF_TURN
    after, turned = surface.place(poses_of(simulation.meshes))
    left, leftAfter = (v[surface.source][:, 0] < 0.0 for v in (before, after))
    assert (left != leftAfter).all()
    np.testing.assert_allclose(light[left].mean(), turned[leftAfter].mean(), atol=1e-6)
    assert light[left].mean() > light[~left].mean() + 0.05  # the sun is on the left


def test_shadows_are_sharp_where_bodies_stand_and_wider_below_high_points():
    vertices = np.array([[0.0, 0, 0], [4, 0, 0], [0, 20, 0], [4, 20, 0]])
    layers = soft_shadows(vertices, np.array([0]), 0.01).reshape(len(SHADOW_LAYERS), 4, 3)
    assert (np.diff(layers[:, 0, 1]) < 0.0).all()  # the darkest is on top
    np.testing.assert_allclose(layers[:, :2, [0, 2]] - layers[0, :2, [0, 2]].T, 0.0, atol=1e-9)
    widths = np.linalg.norm(layers[:, 3] - layers[:, 0], axis=1)
    assert (np.diff(widths) > 0.3).all()
