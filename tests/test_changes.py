"""What is done by hand: the spring that drags, the ball that is shot, and recordings of both."""

import math

import numpy as np
import pytest
from oracles import ROOT
from program import record, run

from Quaternion import QRotate
from rbs import changes
from rbs.changes import KIND_WIDTHS, pack_changes, unpack_changes
from rbs.grabbing import GRAB_FREQUENCY, Grab, shot, spring_impulse
from rbs.recording import Recorder, Recording, finish
from rbs.recordingfiles import RecordingError
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
        change(changes.fix(7, True))  # a ball that was shot


@pytest.fixture(params=["impulse", "soft-step"])
def played(request, tmp_path):
    """A recording of 80 steps of the mixed scene with hands in it: path, states by step."""
    settings = Settings(friction=0.5, contactSolver=request.param)
    simulation = Simulation(DATA / "mixed-scene.txt", settings)
    # Before the recording begins.
    simulation.change(changes.push(3, [0.0, 3e4, 0.0], simulation.meshes[3].position[0]))
    recorder, grab = Recorder(tmp_path / "hands.npz"), []
    recorder.add(simulation)
    states = [simulation.state()]
    for step in range(1, 81):
        hands(simulation, recorder, step, grab)
        simulation.step()
        recorder.add(simulation)
        states.append(simulation.state())
    recorder.note(simulation, changes.push(0, [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]))  # of no step
    recorder.save()
    return tmp_path / "hands.npz", states


def scene():
    return Simulation(DATA / "mixed-scene.txt")


def test_recording_of_a_played_scene_is_verified(played):
    path, states = played
    recording = Recording(path)
    assert len(recording.meshNames) == 9 and recording.meshNames[7:] == ["shot 7", "shot 8"]
    assert [recording.body_count(step) for step in (0, 19, 20, 49, 50, 80)] == [7, 7, 8, 8, 9, 9]
    kinds = [change.kind for _, change in recording.changes]
    assert kinds.count("push") == 32 and kinds.count("add") == kinds.count("fix") == 2
    assert verify(recording, scene()) == ""
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
        assert verify(recording, scene()).startswith(f"step {step} differs")


@pytest.mark.parametrize("step", [0, 15, 20, 45, 80])
def test_played_scene_is_resumed_with_the_same_bits(played, step):
    path, states = played
    recording, simulation = Recording(path), scene()
    resume(recording, step, simulation)
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
    simulation = scene()
    resume(Recording(path), 55, simulation)
    recorder = Recorder(tmp_path / "later.npz")
    recorder.add(simulation)
    for step in range(20):
        if step == 7:
            one = changes.push(8, [1e4, 0.0, 0.0], simulation.meshes[8].position[0])
            simulation.change(one)
            recorder.note(simulation, one)
        simulation.step()
        recorder.add(simulation)
    recorder.save()
    recording = Recording(tmp_path / "later.npz")
    assert recording.firstStep == 55 and recording.body_count(55) == 9
    assert verify(recording, scene()) == ""


def test_replay_has_the_bodies_of_its_step(played):
    path, states = played
    replay = Replay(Recording(path), scene())
    for step in (0, 25, 60, 35, 10, 80):
        replay.seek(step)
        assert len(replay.meshes) == len(states[step]["positions"])
        assert replay.meshes[4].isFixed == (step >= 30)
        assert len(replay.meshes) < 8 or replay.meshes[7].isFixed == (step >= 60)
        for name in STATE_NAMES:
            np.testing.assert_array_equal(replay.state()[name], states[step][name])


def test_command_line_verifies_and_refuses_what_was_changed(played, tmp_path):
    path, _ = played
    done = run(tmp_path, DATA / "mixed-scene.txt", "--verify", path)
    assert done.returncode == 0 and "the steps 0 to 80 are the same" in done.stdout
    content = bytearray(path.read_bytes())
    with np.load(path) as file:
        numbers = file["changeNumbers"]
    place = content.find(numbers.tobytes())
    assert place > 0
    content[place + 8] ^= 1
    path.write_bytes(content)
    done = run(tmp_path, DATA / "mixed-scene.txt", "--verify", path)
    assert done.returncode != 0 and "changeNumbers is damaged" in done.stderr


def test_chunks_of_a_killed_session_are_one_recording(tmp_path, monkeypatch):
    monkeypatch.setattr("rbs.recording.CHUNK_SECONDS", 0.0)
    monkeypatch.setattr("rbs.recording.CHUNK_SHARE", 0.0)
    files = []
    for name in ("killed", "saved"):
        simulation = scene()
        recorder, grab = Recorder(tmp_path / f"{name}.npz"), []
        recorder.add(simulation)
        for step in range(1, 61):
            hands(simulation, recorder, step, grab)
            simulation.step()
            recorder.add(simulation)
        if name == "killed":
            recorder.close()
            recording = Recording(tmp_path / "killed.npz")
            assert recording.wasInterrupted and recording.body_count(60) == 9
            assert verify(recording, scene()) == ""
            finish(tmp_path / "killed.npz")
        else:
            recorder.save()
        files.append((tmp_path / f"{name}.npz").read_bytes())
    assert files[0] == files[1]


def test_recording_without_hands_is_as_it_was(tmp_path):
    with np.load(record(tmp_path / "plain.npz", scene(), 1)) as file:
        assert int(file["format"]) == 1
        assert not any(name.startswith(("change", "added")) for name in file)


def with_changes(**altered):
    """Packed changes of two steps, some of the arrays altered; and the names of the bodies."""
    meshes = scene().meshes
    rows = [(0, changes.push(1, [1, 2, 3], [4, 5, 6])), (3, changes.fix(2, True)),
            (4, shot(meshes, 50.0, [0, 9, 0], [1, 0, 0]))]  # fmt: skip
    arrays = pack_changes(rows)
    names = [*(mesh.name for mesh in meshes), "shot 7"]
    for name, change in altered.items():
        arrays[name] = change(arrays[name].copy())
    return rows, arrays, names


def test_changes_come_back_from_their_arrays():
    rows, arrays, names = with_changes()
    found = unpack_changes(arrays, names, 0, 4)
    assert [(step, one.kind, one.body, one.numbers) for step, one in found] == [
        (step, one.kind, one.body, one.numbers) for step, one in rows
    ]
    for part in ("vertices", "faces", "tets"):
        np.testing.assert_array_equal(getattr(found[2][1].shape, part),
                                      getattr(rows[2][1].shape, part))  # fmt: skip
    assert unpack_changes({}, names, 0, 4) == [] and pack_changes([]) == {}
    assert {len(one.numbers) for _, one in found} == set(KIND_WIDTHS.values())


def put(row, column, value):
    def change(array):
        array[row, column] = value
        return array

    return change


@pytest.mark.parametrize(
    ("altered", "cause"),
    [
        ({"changes": put(0, 0, 9)}, "not in the order of the steps"),
        ({"changes": put(2, 0, 5)}, "not in the order of the steps"),
        ({"changes": put(0, 1, 3)}, "there is no kind 3"),
        ({"changes": put(0, 2, 7)}, "there is no body 7 at step 0"),
        ({"changes": put(1, 2, -1)}, "there is no body -1 at step 3"),
        ({"changes": put(2, 2, 6)}, "there is no body 6 at step 4"),
        ({"changes": lambda a: a[:, :2]}, "not of three columns"),
        ({"changeNumbers": lambda a: a[:2]}, "without 14 finite numbers each"),
        ({"changeNumbers": put(1, 0, np.nan)}, "without 14 finite numbers each"),
        ({"added.7.faces": lambda a: a[:, :2]}, "the faces of body 7 are missing or no such"),
        ({"added.7.tets": lambda a: a.astype(float)}, "the tets of body 7 are missing or no such"),
    ],
)
def test_hostile_changes_are_refused(altered, cause):
    _, arrays, names = with_changes(**altered)
    with pytest.raises(ValueError, match=cause):
        unpack_changes(arrays, names, 0, 4)


def test_more_added_bodies_than_names_are_refused():
    _, arrays, names = with_changes()
    shape = {key.replace(".7.", ".-1."): array for key, array in arrays.items()}
    arrays = shape | {"changes": np.array([[0, 2, -1]]), "changeNumbers": np.ones((1, 14))}
    with pytest.raises(ValueError, match="there is no body -1 at step 0"):
        unpack_changes(arrays, [], 0, 4)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("added.7.faces", put(0, 0, 99)),
        ("added.7.tets", put(0, 0, -1)),
        ("added.7.vertices", lambda a: 0.0 * a),
        ("changeNumbers", lambda a: np.where(np.arange(14) == 0, 0.0, a)),  # the density
        ("changeNumbers", lambda a: np.where(np.arange(14) // 4 == 1, 0.0, a)),  # the orientation
    ],
)
def test_bodies_that_are_none_are_refused_in_one_line(played, tmp_path, name, change):
    path, _ = played
    with np.load(path) as file:
        arrays = {key: file[key] for key in file}
    arrays[name] = change(arrays[name].copy())
    with open(tmp_path / "bad.npz", "wb") as out:
        np.savez(out, **arrays)
    with pytest.raises(RecordingError, match="the changes by hand cannot be made") as error:
        Replay(Recording(tmp_path / "bad.npz"), scene())
    assert "\n" not in str(error.value)
