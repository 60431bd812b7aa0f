"""The light of the window: smooth bodies, the sun, and soft shadows."""

import numpy as np
from oracles import body

from rbs.appearance.shading import LitSurface, poses_of

HALF_TURN = np.array([[0.0, 0.0, 1.0, 0.0]])


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


def test_light_stays_in_the_world_while_a_body_turns():
    box = body("box", (0, 12, 0))
    surface = LitSurface([box])
    before, light = surface.place(poses_of([box])), surface.lit(np.ones((1, 3)))
    box.orientation = HALF_TURN
    after, turned = surface.place(poses_of([box])), surface.lit(np.ones((1, 3)))
    left, leftAfter = (v[surface.source][:, 0] < 0.0 for v in (before, after))
    assert (left != leftAfter).all()
    np.testing.assert_allclose(light[left].mean(), turned[leftAfter].mean(), atol=1e-6)
    assert light[left].mean() > light[~left].mean() + 0.05  # the sun is on the left
