"""Scenes that recommend the soft step: their settings, and that they show what they are named for.

Each runs with the settings that its file recommends, but without sleeping. Those that stand have
rows in tests/byhand/experiments.txt.
"""

import numpy as np
import pytest
from experiments import energy
from oracles import DATA

from rbs.scenes.scenefiles import SceneSource
from rbs.scenes.settingtexts import recommended_values
from RigidBodySimulation import Simulation

RESTING = {"contactSolver": "soft-step", "friction": 0.5, "restitution": 0.0}
SCENES = """stack pyramid arch card_house ramp dominoes wall arch_blow cradle loaded_bridge heap
pile_200 pile_1000""".split()


def tracked(name, steps):
    """A scene's `Simulation` after steps without sleep, and of all moments: positions (T, n, 3),
    heights (T, n) of the highest vertices, energies (T,).
    """
    simulation, track = Simulation(name), []
    simulation.settings.sleeping = False
    for k in range(steps + 1):
        simulation.run(min(k, 1))
        meshes = simulation.meshes
        tops = [mesh.currVertices[:, 1].max() for mesh in meshes]
        track.append(([mesh.position[0] for mesh in meshes], tops, energy(meshes)))
    return simulation, *map(np.array, zip(*track, strict=True))


@pytest.mark.slow
def test_dominoes_fall_in_turn():
    _, _, tops, _ = tracked("dominoes", 900)
    isDown = tops < 0.8 * tops[0]
    assert isDown[-1].all() and (np.diff(isDown.argmax(axis=0)) > 0).all()


@pytest.mark.slow
def test_the_wall_stands_until_the_ball_breaks_it():
    _, places, *_ = tracked("wall", 350)
    moved = np.linalg.norm(places - places[0], axis=2)[:, 7:]
    assert np.linalg.norm(places[201, 6] - places[200, 6]) > 0.2  # the ball is on its way
    assert moved[200].max() < 0.05 and (moved[-1] > 5).sum() >= 5


@pytest.mark.slow
def test_the_arch_falls_when_it_is_hit():
    _, places, *_ = tracked("arch_blow", 400)
    assert np.linalg.norm(places[120] - places[0], axis=1)[:-1].max() < 0.05
    assert places[-1, 7, 1] < 0.5 * places[0, 7, 1]


@pytest.mark.slow
def test_the_last_ball_of_the_cradle_rises_like_the_first():
    """Those between hardly stir."""
    _, places, _, energies = tracked("cradle", 400)
    first, last = places[:, 0, 1], places[:, 4, 1]
    assert last.max() - last[0] == pytest.approx(first[0] - last[0], rel=0.02)
    assert np.abs(places - places[0])[:, 1:4].max() < 1.0
    assert energies.max() < 1.001 * energies[0]


@pytest.mark.slow
def test_the_bridge_holds_its_load():
    simulation, *_ = tracked("loaded_bridge", 150)
    lowest = min(mesh.currVertices[:, 1].min() for mesh in simulation.meshes[15:])
    assert lowest > 10.0 and simulation.largest_violation() < 0.5


def test_scenes_recommend_what_they_rest_with():
    for name in SCENES:
        values = recommended_values(SceneSource.of_files(DATA / f"{name}-scene.txt"))
        assert values == RESTING or name == "cradle", name
