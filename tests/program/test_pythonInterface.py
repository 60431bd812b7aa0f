"""Simulations from Python: from meshes, restored, recorded, drawn."""

import copy
import pickle
import re
import subprocess
import sys

import numpy as np
import pytest
from opengl import require_opengl
from oracles import ROOT, box_body
from PIL import Image
from program import environment

from rbs.recordings.recording import Recording
from rbs.recordings.replay import Replay, verify
from RBSFunctions import Mesh
from RigidBodySimulation import Settings, Simulation

CONSTRAINTS = [[0, 0, 1, 0, 3.0, True], [0, 0, 1, 0, 1.0, False]]


def boxes():
    """Three tilted boxes over each other, the first of which moves."""
    turns = [(1, 0.1 * k, 0.2, 0.05 * k) for k in range(3)]
    meshes = [
        box_body(2, 1, 2, (0.2 * k, 2 + 1.7 * k, 0), orientation=turn)
        for k, turn in enumerate(turns)
    ]
    meshes[0].linVelocity = np.array([[0.3, 0.1, -0.2]])
    return meshes


@pytest.mark.parametrize("solver", ["impulse", "soft-step"])
def test_a_state_is_copied_pickled_and_restored_to_the_same_bits(solver):
    settings = Settings(contactSolver=solver, friction=0.3)
    simulation = Simulation.from_meshes(boxes(), CONSTRAINTS, settings)
    state = pickle.loads(pickle.dumps(copy.deepcopy(simulation.run(30).state())))
    end = simulation.run(40).state()
    simulation.restore(state)
    assert simulation.stepCount == 30 and simulation.report is None
    again = simulation.run(40).state()
    assert all(end[name].tobytes() == again[name].tobytes() for name in end)
    assert simulation.time == end.time == pytest.approx(70 * 0.02)
    simulation.reset()
    assert simulation.meshes[0].linVelocity[0, 0] == 0.3


@pytest.mark.parametrize("solver", ["impulse", "soft-step"])
def test_a_recording_of_meshes_is_replayed_and_verified(solver, tmp_path):
    meshes = boxes()
    settings = Settings(contactSolver=solver, gravity=1.62)
    simulation = Simulation.from_meshes(meshes, CONSTRAINTS, settings, name="three")
    with simulation.record(tmp_path / "three.h5"):
        reports = list(simulation.steps(50))
    assert len(reports) == 50 and meshes[0].position[0, 1] == 2.0  # the simulation has copies
    simulation.run(5)  # not recorded any more
    recording = Recording(tmp_path / "three.h5")
    assert recording.lastStep == 50 and verify(recording) == ""
    replay = Replay(recording)
    replay.seek(50)
    assert replay.settings.gravity == 1.62 and replay.constraints == CONSTRAINTS
    assert replay.potential_energy() == pytest.approx(
        sum(1.62 * m.mass * m.position[0, 1] for m in replay.meshes)
    )


def test_what_is_no_mesh_and_constraints_of_nothing_are_refused():
    with pytest.raises(TypeError, match=r"meshes\[1\] must be a Mesh, not str"):
        Simulation.from_meshes([boxes()[0], "box"])
    with pytest.raises(ValueError, match="constraint 0"):
        Simulation.from_meshes(boxes(), [[0, 0, 7, 0, 1.0, True]])


def test_a_state_of_another_scene_is_refused_and_changes_nothing():
    simulation = Simulation("mixed").run(3)
    before = simulation.state()
    for other in (Simulation("singlebox"), Simulation("tet")):
        bodies = "1 body" if len(other.meshes) == 1 else "25 bodies"
        with pytest.raises(ValueError, match=rf"^a state of {bodies} is not one of .*'mixed', 15"):
            simulation.restore(other.state())
    assert len(simulation.meshes) == 15 and simulation.stepCount == 3
    assert all(
        values.tobytes() == before[name].tobytes() for name, values in simulation.state().items()
    )


def test_a_negative_number_of_steps_is_refused():
    simulation = Simulation("singlebox")
    with pytest.raises(ValueError, match="count must be 0 or more, not -1"):
        simulation.run(-1)
    assert simulation.run(0).stepCount == 0


def test_reprs_say_what_matters():
    simulation = Simulation("tower_chain").run(2)
    assert re.match(
        r"Simulation\('tower_chain', \d+ bodies, \d+ constraints, step 2, ", repr(simulation)
    )
    assert re.match(r"StepReport\(\d+ contacts, \d+ candidate pairs, ", repr(simulation.report))
    assert repr(Settings(gravity=1.62)) == "Settings(gravity=1.62)"
    assert "8 vertices, fixed, at (0, 9, 0)" in repr(box_body(2, 2, 2, (0, 9, 0), isFixed=True))


def test_a_picture_is_drawn(tmp_path):
    require_opengl()
    Simulation.from_meshes(boxes()).picture(tmp_path / "three.png", size=(320, 180))
    with Image.open(tmp_path / "three.png") as picture:
        assert picture.size == (320, 180) and np.ptp(np.asarray(picture)[..., 0]) > 50


def test_the_readmes_example_runs_in_an_empty_folder(tmp_path):
    require_opengl()
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    example = re.search(r"```python\n(.*?)```", text, re.DOTALL)[1]
    lines = [line for line in example.splitlines() if line.strip()]
    assert 5 < len(lines) <= 12
    changes = {"PYTHONPATH": str(ROOT)}
    process = subprocess.run(
        [sys.executable, "-c", example],
        cwd=tmp_path,
        env=environment(**changes),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert process.returncode == 0, process.stderr
    assert list(tmp_path.glob("*.png")) and process.stdout


def test_a_surface_becomes_a_body_as_scipy_and_trimesh_hand_it_out():
    """A box of 2 × 4 × 6 by SciPy's hull, whose triangles look to either side."""
    from scipy.spatial import ConvexHull

    rng = np.random.default_rng(3)
    corners = np.array([[x, y, z] for x in (1, 3) for y in (2, 6) for z in (0, 6)], dtype=float)
    inner = corners.mean(axis=0) + rng.uniform(-0.5, 0.5, (20, 3))
    hull = ConvexHull(np.concatenate([inner, corners]))
    body = Mesh.from_surface("box", hull.points, hull.simplices, density=2.0)
    assert body.mass == pytest.approx(2.0 * 48.0)
    np.testing.assert_allclose(body.position, [[2.0, 4.0, 3.0]])
    square = np.array([2.0, 4.0, 6.0]) ** 2
    np.testing.assert_allclose(np.diag(body.IT), 96.0 / 12.0 * (square.sum() - square))
    with pytest.raises(ValueError, match="hole: the surface is not closed"):
        Mesh.from_surface("hole", hull.points, hull.simplices[1:], 1.0)
    points = hull.points.copy()
    points[hull.vertices[0], 1] = np.nan
    with pytest.raises(ValueError, match="mesh lost: a vertex is not finite"):
        Mesh.from_surface("lost", points, hull.simplices, 1.0)
    for scale, message in (([1, 1, 1e-8], "the points are flat"), (1e12, "a coordinate is not")):
        with pytest.raises(ValueError, match=f"mesh thin: {message}"):
            Mesh.from_surface("thin", hull.points * scale, hull.simplices, 1.0)
