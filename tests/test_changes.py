"""What is done by hand: the spring that drags, the ball that is shot, and recordings of both."""

import json
import math
import shutil

import h5py
import numpy as np
import pytest
from oracles import ROOT
from program import run

from Quaternion import QRotate
from rbs import changes
from rbs.changes import from_record, to_record
from rbs.grabbing import GRAB_FREQUENCY, Grab, shot, spring_impulse
from rbs.recording import Recorder, Recording, RecordingError
from rbs.replay import Replay, resume, verify
from rbs.simulation import Settings, Simulation
from rbs.state import STATE_NAMES
from RBSFunctions import Mesh
from RigidBodySimulation import load_mesh_file

DATA = ROOT / "data"
OMEGA = 2.0 * math.pi * GRAB_FREQUENCY


def make_mesh(name="box", density=1.0, scale=1.0, orientation=(1.0, 0.0, 0.0, 0.0)):
    vertices, faces, tets = load_mesh_file(DATA / f"{name}.mesh")
    return Mesh(name, scale * vertices, faces, tets, density, np.zeros((1, 3)), orientation, False)


# --------------------------------------------------------------------------------------------------
# The spring
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("timeStep", [1e-4, 0.02, 1.0])
@pytest.mark.parametrize("density", [1e-3, 60.0, 1e6])
def test_spring_at_the_centre_of_mass_is_critically_damped(timeStep, density):
    mesh = make_mesh(density=density)
    target = np.array([3.0, -2.0, 7.0])
    start, speed = mesh.position[0] - target, np.array([5.0, 0.0, -1.0])
    mesh.linVelocity = speed[None]
    # Both eigenvalues of the step are 1 / (1 + ω h): x_n = (a + b n) λⁿ, with a and b from the
    # start and the first step, x_1 = x_0 + h v_1 and v_1 = (v_0 - h ω² x_0) λ².
    decay = 1.0 / (1.0 + OMEGA * timeStep)
    first = start + timeStep * (speed - timeStep * OMEGA**2 * start) * decay**2
    slope = first / decay - start
    for n in range(1, 40):
        point = mesh.position[0]
        mesh.push(spring_impulse(mesh, point, target, timeStep), point)
        mesh.position = mesh.position + timeStep * mesh.linVelocity
        expected = (start + n * slope) * decay**n
        np.testing.assert_allclose(mesh.position[0] - target, expected, rtol=1e-8, atol=1e-9)
    np.testing.assert_array_equal(mesh.angVelocity, np.zeros((1, 3)))


def test_short_steps_lead_where_the_differential_equation_does():
    mesh, target, timeStep = make_mesh(), np.array([4.0, 0.0, 0.0]), 1e-4
    for _ in range(2000):
        point = mesh.position[0]
        mesh.push(spring_impulse(mesh, point, target, timeStep), point)
        mesh.position = mesh.position + timeStep * mesh.linVelocity
    expected = -4.0 * (1.0 + OMEGA * 0.2) * math.exp(-OMEGA * 0.2)
    assert mesh.position[0, 0] - 4.0 == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("timeStep", [1e-3, 0.02, 0.3])
def test_spring_is_stable_whatever_it_holds_and_wherever(timeStep):
    """A body that is held somewhere near its rim comes to hang or to rest; it is never driven."""
    generator = np.random.default_rng(8)
    held = 0
    for name in ("box", "tetrahedron", "cylinder", "long-octahedron"):
        for density in (1e-4, 1e5):
            mesh = make_mesh(name, density, orientation=generator.normal(size=4))
            corner = mesh.currVertices[generator.integers(len(mesh.currVertices))]
            grab = Grab(mesh, 0, corner)
            grab.target = corner + generator.normal(size=3) * 20.0
            largest = []
            for _ in range(400):
                impulse = grab.change(mesh, timeStep).numbers
                mesh.push(impulse[:3], impulse[3:])
                largest.append(np.linalg.norm(grab.point(mesh) - grab.target))
                mesh.integrate_timestep(timeStep)
            # It hangs within a few sizes of the hand, and swings no further out than at the start.
            sag = 9.8 / OMEGA**2 * (1.0 + OMEGA * timeStep) ** 2
            assert max(largest[-100:]) < 0.5 * largest[0] + sag
            held += np.linalg.norm(mesh.linVelocity) < 1e3
    assert held == 8


def test_spring_moves_no_fixed_body_and_follows_the_point_that_was_picked():
    mesh = make_mesh(orientation=(1.0, 2.0, 0.5, -1.0))
    point = np.array([1.0, 2.0, 3.0])
    grab = Grab(mesh, 5, point)
    assert grab.body == 5
    np.testing.assert_allclose(grab.point(mesh), point, atol=1e-12)
    arm = mesh.origVertices[0]
    grab = Grab(mesh, 0, (QRotate(mesh.orientation, arm[None]) + mesh.position)[0])
    mesh.position, mesh.orientation = mesh.position + 9.0, np.array([[0.6, 0.0, 0.8, 0.0]])
    np.testing.assert_allclose(grab.point(mesh), mesh.currVertices[0], atol=1e-12)
    mesh.isFixed = True
    np.testing.assert_array_equal(spring_impulse(mesh, point, point + 1.0, 0.02), np.zeros(3))


# --------------------------------------------------------------------------------------------------
# Bodies that are shot
# --------------------------------------------------------------------------------------------------


def test_shot_ball_flies_and_is_gone_after_a_reset():
    simulation = Simulation(DATA / "tet-scene.txt")
    count = len(simulation.meshes)
    simulation.change(shot(simulation.meshes, 50.0, [0.0, 30.0, 40.0], [0.0, 0.0, -1.0]))
    ball = simulation.meshes[-1]
    assert len(simulation.meshes) == count + 1 and not ball.isFixed
    assert ball.hullVolume == pytest.approx(ball.volume)
    radii = np.linalg.norm(ball.origVertices, axis=1)
    assert radii.min() > 0.95 * radii.max() == pytest.approx(0.03 * 50.0 * 0.95, rel=0.05)
    simulation.step()
    np.testing.assert_allclose(ball.position, [[0.0, 30.0 - 9.8 * 0.02**2, 39.0]])
    simulation.reset()
    assert len(simulation.meshes) == count and simulation.changes == []


def test_shot_ball_hits_what_stands_in_its_way():
    for solver in ("impulse", "soft-step"):
        simulation = Simulation(DATA / "stack-scene.txt", Settings(contactSolver=solver))
        box = simulation.meshes[5].position[0]
        simulation.change(shot(simulation.meshes, 60.0, box + [0, 0, 25.0], [0.0, 0.0, -1.0]))
        for _ in range(60):
            simulation.step()
        assert simulation.meshes[5].position[0, 2] < box[2] - 0.2, solver


# --------------------------------------------------------------------------------------------------
# Recordings of it
# --------------------------------------------------------------------------------------------------


def hands(simulation, recorder, step, grab):
    """What is done before a step of the recording: a push, a grab, shots, one body fixed."""

    def change(one):
        simulation.change(one)
        recorder.note(simulation, one)

    meshes = simulation.meshes
    if step == 5:
        change(changes.push(1, [2e4, 0.0, 1e3], meshes[1].position[0] + 1.0))
    if step == 10:
        grab.append(Grab(meshes[2], 2, meshes[2].currVertices[0]))
    if 10 <= step < 40:
        grab[0].target = np.array([10.0 * math.sin(step / 5.0), 30.0, 0.0])
        change(grab[0].change(meshes[2], simulation.settings.timeStep))
    if step in (20, 50):
        change(shot(meshes, 80.0, [0.0, 20.0, 60.0], [0.0, -0.2, -0.98]))
    if step == 30:
        change(changes.fix(4, True))
    if step == 60:
        change(changes.fix(15, True))  # a ball that was shot


@pytest.fixture(params=["impulse", "soft-step"])
def played(request, tmp_path):
    """A recording of 80 steps of the mixed scene with hands in it: path, states by step."""
    settings = Settings(friction=0.5, contactSolver=request.param)
    simulation = Simulation(DATA / "mixed-scene.txt", settings)
    # Before the recording begins.
    simulation.change(changes.push(3, [0.0, 3e4, 0.0], simulation.meshes[3].position[0]))
    recorder, grab = Recorder(tmp_path / "hands.h5"), []
    recorder.add(simulation)
    states = [simulation.state()]
    for step in range(1, 81):
        hands(simulation, recorder, step, grab)
        simulation.step()
        recorder.add(simulation)
        states.append(simulation.state())
    recorder.note(simulation, changes.push(0, [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]))  # of no step
    recorder.save()
    return tmp_path / "hands.h5", states


def scene():
    return Simulation(DATA / "mixed-scene.txt")


def test_recording_of_a_played_scene_is_verified(played):
    path, states = played
    recording = Recording(path)
    counts = [recording.body_count(step) for step in (0, 19, 20, 49, 50, 80)]
    assert counts == [15, 15, 16, 16, 17, 17]
    kinds = [change.kind for _, change in recording.changes]
    assert kinds.count("push") == 32 and kinds.count("add") == kinds.count("fix") == 2
    assert verify(recording) == ""
    # Without what was done by hand it would come out otherwise.
    for wanted, step in (("push", 0), ("add", 20), ("fix", 30)):
        recording = Recording(path)
        left = next(k for k, (_, one) in enumerate(recording.changes) if one.kind == wanted)
        if wanted != "add":
            del recording.changes[left]
        else:
            when, one = recording.changes[left]
            slower = one._replace(numbers=(*one.numbers[:8], 1.0, *one.numbers[9:]))
            recording.changes[left] = when, slower
        assert verify(recording).startswith(f"step {step} differs")


@pytest.mark.parametrize("step", [0, 15, 20, 45, 80])
def test_played_scene_is_resumed_with_the_same_bits(played, step):
    path, states = played
    recording = Recording(path)
    simulation = resume(recording, step)
    assert simulation.stepCount == step
    for name in STATE_NAMES:
        np.testing.assert_array_equal(simulation.state()[name], states[step][name])
    assert simulation.meshes[4].isFixed == (step >= 30)
    if step == 80:
        return
    for later in range(step + 1, 81):
        for change in recording.changes_before(later):
            simulation.change(change)
        simulation.step()
        for name in STATE_NAMES:
            np.testing.assert_array_equal(simulation.state()[name], states[later][name])


def test_recording_of_what_was_resumed_is_verified_too(played, tmp_path):
    path, _ = played
    simulation = resume(Recording(path), 55)
    recorder = Recorder(tmp_path / "later.h5")
    recorder.add(simulation)
    for step in range(20):
        if step == 7:
            one = changes.push(16, [1e4, 0.0, 0.0], simulation.meshes[16].position[0])
            simulation.change(one)
            recorder.note(simulation, one)
        simulation.step()
        recorder.add(simulation)
    recorder.save()
    recording = Recording(tmp_path / "later.h5")
    assert recording.firstStep == 55 and recording.body_count(55) == 17
    assert verify(recording) == ""


def test_replay_has_the_bodies_of_its_step(played):
    path, states = played
    replay = Replay(Recording(path))
    for step in (0, 25, 60, 35, 10, 80):
        replay.seek(step)
        assert len(replay.meshes) == len(states[step]["positions"])
        assert replay.meshes[4].isFixed == (step >= 30)
        assert len(replay.meshes) < 16 or replay.meshes[15].isFixed == (step >= 60)
        for name in STATE_NAMES:
            np.testing.assert_array_equal(replay.state()[name], states[step][name])


def test_command_line_verifies_what_was_done_by_hand(played, tmp_path):
    done = run(tmp_path, "--verify", played[0])
    assert done.returncode == 0 and "steps 0–80 are identical, bit for bit" in done.stdout


def test_changes_come_back_from_their_text():
    mesh = shot(scene().meshes, 50.0, [0, 9, 0], [1, 0, 0])
    for one in (changes.push(1, [1, 2, 3], [4, 5, 0.1]), changes.fix(2, True), mesh):
        found = from_record(json.loads(json.dumps(to_record(one))))
        assert found[:3] == one[:3]
        for ours, theirs in zip(found.shape or (), one.shape or (), strict=True):
            np.testing.assert_array_equal(ours, theirs)


def with_event(path, target, edit):
    """A copy of a recording in which edit(record) has changed the first body that was shot."""
    shutil.copy(path, target)
    with h5py.File(target, "r+") as file:
        lines = file["events"][()].tobytes().decode().splitlines()
        events = [json.loads(line) for line in lines]
        edit(next(e["change"] for e in events if e.get("change", {}).get("kind") == "add"))
        text = "".join(json.dumps(event) + "\n" for event in events).encode()
        file["events"].resize((len(text),))
        file["events"][:] = np.frombuffer(text, np.uint8)
    return target


@pytest.mark.parametrize(
    "edit",
    [
        lambda change: change["shape"][2][0].__setitem__(0, 99),
        lambda change: change["numbers"].__setitem__(0, 0.0),  # the density
        lambda change: change.__delitem__("numbers"),
        lambda change: change["shape"].pop(),
    ],
)
def test_bodies_that_are_none_are_refused_in_one_line(played, tmp_path, edit):
    path = with_event(played[0], tmp_path / "bad.h5", edit)
    with pytest.raises(RecordingError, match="bad.h5: it is damaged") as error:
        Replay(Recording(path))
    assert "\n" not in str(error.value)
