"""Scenes that recommend the soft step: their settings, and that they show what they are named for.

Each scene runs with the settings that its file recommends, but without sleeping: a building has to
stand by itself. Penetration is measured on the final poses by the hull of the Minkowski difference.
"""

import numpy as np
import pytest
from oracles import DATA, penetrations

from rbs.opening.suggestions import apply_settings, recommended_values
from rbs.scenes.scenefiles import SceneSource
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping.settings import GRAVITY

RESTING = {"contactSolver": "soft-step", "friction": 0.5, "restitution": 0.0}

# Buildings: the number of steps, how far a body may move in them, and how fast it may be after
# them. Joints are 1 mm wide, those of the dome up to 1 cm, and every contact gives by some
# millimetres; a high stack sways for long.
STANDING = {
    "stack": (400, 20 * 0.007, 0.05),
    "pyramid": (150, 15 * 0.005, 5e-3),
    "arch": (400, 0.05, 1e-4),
    "dome": (200, 0.05, 1e-6),
    "card_house": (200, 0.05, 1e-6),
}


def open_scene(name):
    """A `SceneSimulation` as the program opens it, without sleep."""
    path = DATA / f"{name}-scene.txt"
    simulation = SceneSimulation(path)
    apply_settings(simulation, {"sleeping": False})
    return simulation


def run(simulation, steps):
    for _ in range(steps):
        simulation.step()


def positions(simulation):
    return np.array([mesh.position[0] for mesh in simulation.meshes])


def speeds(simulation):
    return np.linalg.norm([mesh.linVelocity[0] for mesh in simulation.meshes], axis=1)


def energy(simulation):
    return simulation.kinetic_energy() + simulation.potential_energy()


def check_building(name):
    steps, most, fastest = STANDING[name]
    simulation = open_scene(name)
    start, before = positions(simulation), energy(simulation)
    run(simulation, steps)
    assert 0 < np.linalg.norm(positions(simulation) - start, axis=1).max() < most
    assert speeds(simulation).max() < fastest
    assert energy(simulation) < before
    assert penetrations(simulation.meshes).max() < 0.01


def check_round_tower():
    simulation = open_scene("round_tower")
    start = positions(simulation)
    run(simulation, 200)
    moved = np.linalg.norm(positions(simulation) - start, axis=1)
    assert moved[:-1].max() < 0.1
    assert start[:-1, 1].max() < positions(simulation)[-1, 1] < start[-1, 1] - 1
    assert speeds(simulation).max() < 0.01


def check_ramp():
    simulation = open_scene("ramp")
    start = positions(simulation)
    run(simulation, 300)
    _, held, _, slid = np.linalg.norm(positions(simulation) - start, axis=1)
    assert held < 0.04
    # Over n steps, semi-implicit Euler goes a h² n (n + 1) / 2; the drop onto the slope costs some.
    angle, h = np.radians(28.0), simulation.settings.timeStep
    pull = -GRAVITY * (np.sin(angle) - simulation.settings.friction * np.cos(angle))
    assert slid == pytest.approx(pull * h**2 * 300 * 301 / 2, rel=0.1)


def check_dominoes():
    simulation = open_scene("dominoes")
    upright = np.array([mesh.currVertices[:, 1].max() for mesh in simulation.meshes])
    fallen = np.full(len(upright), np.inf)
    for step in range(900):
        simulation.step()
        heights = [mesh.currVertices[:, 1].max() for mesh in simulation.meshes]
        fallen = np.where(heights < 0.8 * upright, np.minimum(fallen, step), fallen)
        if np.isfinite(fallen).all():
            break
    assert np.isfinite(fallen).all()
    assert (np.diff(fallen) > 0).all()


def check_wall():
    simulation = open_scene("wall")
    start = positions(simulation)[7:]
    run(simulation, 200)
    assert np.linalg.norm(positions(simulation)[7:] - start, axis=1).max() < 0.05
    assert speeds(simulation)[6] > 10  # the ball is on its way
    run(simulation, 150)
    moved = np.linalg.norm(positions(simulation)[7:] - start, axis=1)
    assert (moved > 5).sum() >= 5


def check_arch_blow():
    simulation = open_scene("arch_blow")
    start = positions(simulation)
    run(simulation, 120)
    assert np.linalg.norm(positions(simulation) - start, axis=1)[:-1].max() < 0.05
    run(simulation, 280)
    assert positions(simulation)[7, 1] < 0.5 * start[7, 1]


def check_cradle():
    simulation = open_scene("cradle")
    start, before = positions(simulation)[:5], energy(simulation)
    least = start[-1, 1]
    risen, moved, gained = least, 0.0, 0.0
    for _ in range(400):
        simulation.step()
        now = positions(simulation)[:5]
        risen = max(risen, now[-1, 1])
        moved = max(moved, np.abs(now - start)[1:-1].max())
        gained = max(gained, energy(simulation) / before - 1)
    # The last ball comes as high as the first one was; those between hardly stir.
    assert (risen - least) == pytest.approx(start[0, 1] - least, rel=0.02)
    assert moved < 1.0
    assert gained < 1e-3


def check_load(name, first, steps):
    simulation = open_scene(name)
    run(simulation, steps)
    lowest = min(mesh.currVertices[:, 1].min() for mesh in simulation.meshes[first:])
    assert lowest > 10.0
    assert simulation.largest_violation() < 0.5


def check_pile():
    simulation = open_scene("pile_200")
    run(simulation, 450)
    assert np.median(speeds(simulation)) < 0.02
    assert np.percentile(penetrations(simulation.meshes), 95) < 0.02


CHECKS = {name: lambda name=name: check_building(name) for name in STANDING}
CHECKS |= {
    "round_tower": check_round_tower,
    "ramp": check_ramp,
    "dominoes": check_dominoes,
    "wall": check_wall,
    "arch_blow": check_arch_blow,
    "cradle": check_cradle,
    "loaded_bridge": lambda: check_load("loaded_bridge", 15, 150),
    "loaded_net": lambda: check_load("loaded_net", 400, 120),
    "pile_200": check_pile,
}


def test_scenes_recommend_what_they_rest_with():
    for name in (*CHECKS, "heap", "pile_1000"):
        values = recommended_values(SceneSource.of_files(DATA / f"{name}-scene.txt"))
        assert values == RESTING or name == "cradle", name


@pytest.mark.slow
@pytest.mark.parametrize("name", CHECKS)
def test_scene_shows_what_it_is_named_for(name):
    CHECKS[name]()
