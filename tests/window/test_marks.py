"""What is drawn on top of the picture, seen in the window's list of lines."""

from unittest.mock import MagicMock

import numpy as np
import pytest
from opengl import pixel_of
from program import DATA
from views import make_viewer

from rbs.pictures.view import SceneView
from rbs.scenes.messages import measured
from rbs.scenes.simulation import SceneSimulation
from rbs.window import marks


@pytest.fixture
def ink(polyscope, monkeypatch):
    """The window's list of lines."""
    result = MagicMock()
    monkeypatch.setattr(marks.psim, "GetBackgroundDrawList", lambda: result)
    return result


def test_arrows_lie_on_top_of_the_picture(ink):
    simulation = SceneSimulation(DATA / "mixed-scene.txt")
    simulation.step()
    view = SceneView(simulation)
    view.show("velocities", True)
    marks.draw_marks(make_viewer(simulation, view))
    assert ink.AddLine.call_count == sum(not mesh.isFixed for mesh in simulation.meshes)
    for begin, end, *_ in (call.args for call in ink.AddLine.call_args_list):
        assert end[1] > begin[1]  # all fall


def test_a_drag_shows_the_point_the_spring_and_its_force(polyscope, ink):
    simulation = SceneSimulation(DATA / "mixed-scene.txt")
    viewer = make_viewer(simulation, SceneView(simulation))
    mesh = simulation.meshes[2]
    viewer.hand.grab_at(tuple(reversed(pixel_of(polyscope, mesh.position[0]))))
    body = simulation.meshes[viewer.hand.grab.body]
    viewer.isPlaying = True
    viewer.hand.grab.target = viewer.hand.grab.point(body) + [0.0, 1.0, 0.0]
    marks.draw_marks(viewer)
    ends = np.array(ink.AddLine.call_args.args[:2])
    places = [viewer.hand.grab.point(body), viewer.hand.grab.target]
    expected = [pixel_of(polyscope, place)[::-1] for place in places]
    np.testing.assert_allclose(ends, expected, atol=1.0)
    # critically damped at 2 Hz, and 1 m long, against the mass that a step feels
    stiffness = body.mass * (4.0 * np.pi) ** 2
    assert 0.3 * stiffness < viewer.hand.force() < stiffness
    assert ink.AddText.call_args.args[2] == measured(viewer.hand.force(), "N")
