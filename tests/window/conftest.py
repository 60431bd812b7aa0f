"""The panel over the mixed scene, and hands on it."""

import pytest
from hands import WIDGETS, Hands, make_panel, noting
from program import DATA

from rbs.scenes.simulation import SceneSimulation


@pytest.fixture
def open_panel(polyscope, monkeypatch, tmp_path):
    """A function of a simulation, or the name of a scene: the panel over it, in a folder of its
    own.
    """
    monkeypatch.chdir(tmp_path)
    panels = []

    def start(simulation, settings=None, size=(640, 400), isBasic=True):
        if isinstance(simulation, str):
            simulation = SceneSimulation(DATA / f"{simulation}-scene.txt", settings)
        panels.append(make_panel(simulation, polyscope, monkeypatch, size, isBasic))
        return panels[-1]

    yield start
    panels[-1].viewer.view.set_callback(None)


@pytest.fixture
def panel(open_panel):
    return open_panel("mixed", size=(560, 720))


@pytest.fixture
def widgets(monkeypatch, polyscope):
    """What is drawn: a dict of label and (x, y) to click at."""
    import polyscope.imgui as psim

    result = {}

    def note(label, x, y):
        result[label] = x, y

    for kind in WIDGETS:
        monkeypatch.setattr(psim, kind, noting(getattr(psim, kind), note))
    return result


@pytest.fixture
def hands(polyscope, widgets, panel):
    return Hands(polyscope, widgets)
