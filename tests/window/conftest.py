"""The panels over a scene, drawn off-screen frame by frame, and hands on them."""

import polyscope.imgui as psim
import pytest
from hands import Hands
from program import DATA

from rbs.pictures.view import SceneView
from rbs.pictures.viewpoint import Viewpoint
from rbs.recordings.lookup import SceneOpener
from rbs.scenes.simulation import SceneSimulation
from rbs.window.panel import Panel
from rbs.window.viewer import Viewer

# Pixels. A field's rectangle holds its label, and buttons: its number is at the left.
INTO_FIELD = 15.0


@pytest.fixture
def open_panel(polyscope, monkeypatch, tmp_path):
    """A function of a simulation, or the name of a scene: the panel over it, in a folder of its
    own. isBasic : whether scenes that it opens ignore the settings that they recommend
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Viewpoint, "move", lambda viewpoint, seconds: False)
    monkeypatch.setattr(polyscope, "set_SSAA_factor", lambda factor: None)  # takes most of the time
    views = []

    def start(simulation, settings=None, size=(640, 400), isBasic=True):
        if isinstance(simulation, str):
            simulation = SceneSimulation(DATA / f"{simulation}-scene.txt", settings)
        polyscope.set_window_size(*size)
        views.append(SceneView(simulation))
        panel = Panel(Viewer(simulation, views[-1], SceneOpener(isBasic=isBasic)))
        views[-1].set_callback(panel.frame)
        for _ in range(3):  # until all panels have their sizes
            polyscope.frame_tick()
        return panel

    yield start
    views[-1].set_callback(None)


@pytest.fixture
def viewer(open_panel):
    return open_panel("mixed").viewer


@pytest.fixture
def panel(open_panel):
    return open_panel("mixed", size=(560, 720))


@pytest.fixture
def hands(polyscope, panel, monkeypatch):
    """Hands on the panel, which know where its fields and its axis are drawn."""
    widgets = {}

    def noting(draw):
        def noted(label, *arguments):
            answer = draw(label, *arguments)
            (left, top), (_, bottom) = psim.GetItemRectMin(), psim.GetItemRectMax()
            widgets[label.strip("#")] = left + INTO_FIELD, 0.5 * (top + bottom)
            return answer

        return noted

    for kind in ("SliderFloat", "SliderInt"):
        monkeypatch.setattr(psim, kind, noting(getattr(psim, kind)))
    return Hands(polyscope, widgets)
