"""The outlines in which the points of contact manifolds are drawn."""

import numpy as np
from opengl import require_opengl
from oracles import DATA

from rbs.appearance.drawables import contact_patches
from rbs.opening.suggestions import apply_settings
from rbs.scenes.simulation import SceneSimulation

SQUARE = np.array([(-1, 0, -2), (1, 0, 2), (-1, 0, 2), (1, 0, -2)], dtype=float)
UP = np.array([0.0, 1.0, 0.0])


def test_each_pair_has_its_own_outline():
    # four points of one pair, one of a second, two of a third, in a muddle; -1 is the ground
    pairs = np.array([(0, 1), (2, -1), (0, 1), (0, 2), (2, -1), (0, 1), (0, 1)])
    points = np.array([SQUARE[0], (5, 0, 0), SQUARE[1], (9, 9, 9), (7, 0, 0), SQUARE[2], SQUARE[3]])
    edges, middles, normals = contact_patches(pairs, points, np.tile(UP, (7, 1)))
    sides = {tuple(sorted(edge)) for edge in edges.tolist()}
    assert sides == {(0, 5), (2, 5), (2, 6), (0, 6), (1, 4)}
    assert np.allclose(middles, [(0, 0, 0), (9, 9, 9), (6, 0, 0)])
    assert normals.shape == (3, 3)


def test_view_outlines_the_manifolds_of_bodies_awake_and_asleep():
    """A stack that falls asleep: 19 patches of four points between boxes, and one on the ground."""
    backend = require_opengl()
    from rbs.pictures.view import SceneView, start_polyscope

    start_polyscope(backend)
    simulation = SceneSimulation(DATA / "stack-scene.txt")
    apply_settings(simulation, {})
    view = SceneView(simulation)
    view.show("contacts", True)
    for steps, title in (20, "contact area"), (180, "last contact area"):
        for _ in range(steps):
            simulation.step()
        view.refresh()
        arrows, outlines = view.overlays.onTop["contacts"]
        assert len(arrows.points) == 20 and len(outlines.edges) == 80
        assert view.legend()[0][0] == f"{title} and normal (on the body listed first)"
    assert simulation.report.isAsleep.all()
