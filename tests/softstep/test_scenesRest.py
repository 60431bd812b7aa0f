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


def open_scene(name):
    """`(Simulation, positions)` with the settings of the scene, without sleep."""
    simulation = Simulation(name)
    simulation.settings.sleeping = False
    return simulation, positions(simulation)


def positions(simulation):
    return np.array([mesh.position[0] for mesh in simulation.meshes])


@pytest.mark.slow
def test_dominoes_fall_in_turn():
    simulation, _ = open_scene("dominoes")
    upright = np.array([mesh.currVertices[:, 1].max() for mesh in simulation.meshes])
    fallen = np.full(len(upright), np.inf)
    for step in range(900):
        simulation.step()
        heights = [mesh.currVertices[:, 1].max() for mesh in simulation.meshes]
        fallen = np.where(heights < 0.8 * upright, np.minimum(fallen, step), fallen)
        if np.isfinite(fallen).all():
            break
    assert np.isfinite(fallen).all() and (np.diff(fallen) > 0).all()


@pytest.mark.slow
def test_the_wall_stands_until_the_ball_breaks_it():
    simulation, start = open_scene("wall")
    simulation.run(200)
    assert np.linalg.norm((positions(simulation) - start)[7:], axis=1).max() < 0.05
    assert np.linalg.norm(simulation.meshes[6].linVelocity) > 10  # the ball is on its way
    simulation.run(150)
    moved = np.linalg.norm((positions(simulation) - start)[7:], axis=1)
    assert (moved > 5).sum() >= 5


@pytest.mark.slow
def test_the_arch_falls_when_it_is_hit():
    simulation, start = open_scene("arch_blow")
    simulation.run(120)
    assert np.linalg.norm(positions(simulation) - start, axis=1)[:-1].max() < 0.05
    simulation.run(280)
    assert positions(simulation)[7, 1] < 0.5 * start[7, 1]


@pytest.mark.slow
def test_the_last_ball_of_the_cradle_rises_like_the_first():
    simulation, start = open_scene("cradle")
    start, before = start[:5], energy(simulation.meshes)
    risen, moved, gained = (least := start[-1, 1]), 0.0, 0.0
    for _ in range(400):
        simulation.step()
        now = positions(simulation)[:5]
        risen = max(risen, now[-1, 1])
        moved = max(moved, np.abs(now - start)[1:-1].max())
        gained = max(gained, energy(simulation.meshes) / before - 1)
    # The last ball comes as high as the first one was; those between hardly stir.
    assert (risen - least) == pytest.approx(start[0, 1] - least, rel=0.02)
    assert moved < 1.0 and gained < 1e-3


@pytest.mark.slow
def test_the_bridge_holds_its_load():
    simulation, _ = open_scene("loaded_bridge")
    simulation.run(150)
    lowest = min(mesh.currVertices[:, 1].min() for mesh in simulation.meshes[15:])
    assert lowest > 10.0 and simulation.largest_violation() < 0.5


def test_scenes_recommend_what_they_rest_with():
    for name in SCENES:
        values = recommended_values(SceneSource.of_files(DATA / f"{name}-scene.txt"))
        assert values == RESTING or name == "cradle", name
