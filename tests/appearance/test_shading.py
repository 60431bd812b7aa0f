"""The light of the window: smooth bodies, the sun, and soft shadows."""

import numpy as np
from program import DATA

from rbs.appearance.shading import LitSurface, poses_of
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
