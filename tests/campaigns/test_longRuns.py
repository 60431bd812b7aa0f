"""A shortened form of longRuns.py, and whether its bounds notice what they are for."""

import numpy as np
import pytest
from longRuns import RUNS, Watch, run_long

from rbs.scenes.scenefiles import find_scene
from rbs.scenes.simulation import Simulation


@pytest.mark.parametrize("scene", RUNS)
def test_bounds_hold_in_a_short_run(scene, capsys):
    assert run_long(scene, 20 if scene == "pile_200" else 150)
    assert "BROKEN" not in capsys.readouterr().out


def test_what_is_watched_is_found():
    simulation = Simulation(find_scene("tower"))
    watch, mesh = Watch(simulation, 10), simulation.meshes[3]
    mesh.orientation = mesh.orientation * (1 + 3e-12)
    mesh.currVertices = mesh.currVertices - (0.0, 100.0, 0.0)
    mesh.linVelocity = np.array([[0.0, 1e4, 0.0]])
    watch.look(simulation)
    assert watch.unitError == pytest.approx(3e-12, rel=1e-3)
    assert watch.lowest == mesh.currVertices[:, 1].min() < -40
    gained = 0.5 * mesh.mass * 1e8
    assert watch.energy - watch.startEnergy == pytest.approx(gained, rel=1e-9)
    mesh.linVelocity = np.array([[0.0, np.nan, 0.0]])
    watch.look(simulation)
    watch.memoryGrowth = 9.0
    assert not any(holds for _, holds in watch.rows(depth=1e-9))
