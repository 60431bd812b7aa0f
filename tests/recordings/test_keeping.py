"""Nothing that Python has recorded is lost, and nothing that was done by hand is left out."""

import copy
import os
import pickle
from contextlib import suppress

import h5py
import numpy as np
import pytest
from program import bits

from rbs.recordings.recording import Recording, RecordingError
from rbs.recordings.replay import Replay, resume, verify
from rbs.recordings.writers import OUTPUTS
from rbs.scenes.scene import Writer, followed_by
from rbs.window.hand import Grab, shot
from RigidBodySimulation import Mesh, Settings, Simulation, ground, shapes

bothSolvers = pytest.mark.parametrize("solver", ["impulse", "soft-step"])


def boxes(solver="impulse", width=2):
    """Three boxes over each other; the lowest and the highest are fixed."""
    places = [(0, 1 + 0.7 * k, 0) for k in range(3)]
    meshes = [shapes.box((width, 0.4, 1), 100.0, at, isFixed=at != places[1]) for at in places]
    return Simulation.from_meshes(meshes, settings=Settings(contactSolver=solver, friction=0.5))


def check(path, lastStep):
    with Recording(path) as recording:
        assert recording.lastStep == lastStep and verify(recording) == ""


ENDS = [(ValueError, 0), (KeyboardInterrupt, 2), (SystemExit, 30), (GeneratorExit, 2)]


@pytest.mark.parametrize(("end", "count"), ENDS)
@pytest.mark.parametrize("isOld", [False, True])
def test_a_run_that_breaks_off_is_kept_and_replaces_no_other(tmp_path, capsys, end, count, isOld):
    path, simulation = tmp_path / "run.h5", boxes()
    if isOld:
        path.write_bytes(b"an older one")
    with pytest.raises(end), simulation.record(path):
        simulation.run(count)
        raise end
    kept = tmp_path / ("run.part.h5" if isOld else "run.h5")
    assert {one.name for one in tmp_path.iterdir()} == {"run.h5", kept.name}
    assert not isOld or path.read_bytes() == b"an older one"
    errors = capsys.readouterr().err
    assert errors.count("\n") == isOld and (not isOld or kept.name in errors)
    check(kept, count)
    simulation.run(3)  # no longer recorded


@pytest.mark.parametrize(("option", "end"), [("record", ".h5"), ("stats", ".csv")])
def test_a_file_stays_in_its_folder_if_the_current_one_changes(tmp_path, monkeypatch, option, end):
    path, elsewhere = tmp_path / f"run{end}", tmp_path / "elsewhere"
    elsewhere.mkdir()
    path.write_bytes(b"old")
    monkeypatch.chdir(tmp_path)
    writer = OUTPUTS[option].start(path.name)
    with followed_by(boxes(), writer) as simulation:
        simulation.run(2)
        monkeypatch.chdir(elsewhere)
        simulation.run(2)
    writer.save(simulation)
    assert len(path.read_bytes()) > 100 and sorted(tmp_path.iterdir()) == [elsewhere, path]
    assert not list(elsewhere.iterdir())


@pytest.mark.parametrize("method", ["before", "add"])
def test_a_writer_that_fails_hides_no_state_from_a_recorder(tmp_path, method):
    def fail(simulation):
        if simulation.stepCount == 10:
            raise ZeroDivisionError

    failing, simulation = Writer(), boxes()
    setattr(failing, method, fail)
    with followed_by(simulation, failing), simulation.record(tmp_path / "a.h5"):
        for act in (lambda: simulation.run(10), lambda: simulation.add(shapes.sphere(1, 1.0))):
            with suppress(ZeroDivisionError):
                act()
        failing.before = failing.add = lambda _: None
        simulation.run(10)
    check(tmp_path / "a.h5", 20)


def test_a_run_that_is_recorded_cannot_go_back_nor_be_recorded_twice_to_one_file(tmp_path):
    simulation = boxes()
    start = simulation.state()
    with simulation.record(tmp_path / "a.h5"), simulation.record(tmp_path / "b.h5"):
        simulation.run(5)
        for act in (simulation.reset, lambda: simulation.restore(start)):
            with pytest.raises(ValueError, match="being recorded cannot go back"):
                act()
        with pytest.raises(RecordingError, match=r"a.h5: it is being recorded already"):
            simulation.record(tmp_path / "a.h5").__enter__()
        simulation.run(5)
    check(tmp_path / "a.h5", 10)
    check(tmp_path / "b.h5", 10)
    simulation.reset()


def test_a_recording_is_closed_and_h5py_opens_it_beside_ours(tmp_path):
    path = tmp_path / "run.h5"
    with boxes().record(path) as simulation:
        simulation.run(5)
    with Simulation.open(path) as opened, h5py.File(path) as file, Recording(path) as recording:
        assert len(file["times"]) == 6 and recording.lastStep == 5
        opened.seek(3)
    for read in (lambda: opened.seek(4), lambda: recording.frame(2)):
        with pytest.raises(RecordingError, match="run.h5: it has been closed"):
            read()
    with h5py.File(path, "r+"):  # nobody holds it any more
        pass


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such links or signals")
def test_a_recording_goes_through_a_link_to_a_file_that_is_there_or_not(tmp_path):
    link = tmp_path / "link.h5"
    link.symlink_to("run.h5")
    for steps in (3, 5):
        with boxes().record(link) as simulation:
            simulation.run(steps)
        assert link.is_symlink() and not (tmp_path / "run.h5").is_symlink()
        check(link, steps)
    assert len(list(tmp_path.iterdir())) == 2


def acts(simulation, rng):
    """What a user may do between two steps, by methods and by assignment: functions by name."""
    meshes, vector = simulation.meshes, rng.normal(size=3)
    index = int(rng.integers(len(meshes)))
    one, other = meshes[index], (index + 1) % len(meshes)
    grab = Grab(one, index, one.currVertices[0])
    grab.target = grab.target + vector
    ball = shapes.sphere(0.4, 50.0, vector + (0, 4, 0))
    box = shapes.box((1, 1, 1), 30.0, 2 * vector)
    return {
        "push": lambda: simulation.push(one, 50 * vector, one.currVertices[0]),
        "move": lambda: simulation.move(one, one.position[0] + 0.1 * vector, (1, *vector)),
        "lift": lambda: one.position.__setitem__((0, 1), 2.0 + vector[0]),
        "turn": lambda: setattr(one, "orientation", (1, *vector)),
        "convey": lambda: simulation.set_velocity(one, vector),
        "spin": lambda: setattr(one, "angVelocity", tuple(vector)),
        "fix": lambda: simulation.fix(one, not one.isFixed),
        "force": lambda: simulation.set_force(other, 90 * vector, vector),
        "load": lambda: setattr(one, "load", (90 * vector, (1.0, 0, 0))),
        "name": lambda: setattr(one, "name", f"Greifer ü {vector}"),
        "inertia": lambda: setattr(one, "IT", 2.0 * one.IT),
        "mass": lambda: setattr(one, "invMass", 0.3 * one.invMass),
        "response": lambda: one.invIT.__imul__(0.5),
        "drag": lambda: grab.pull(one, 0.02),
        "add": lambda: simulation.add(ball),
        "shoot": lambda: simulation.add(shot(meshes, 9.0, [0, 4, 6], [0, 0, -1.0])),
        "append": lambda: meshes.append(ball),
        "remove": lambda: len(meshes) < 3 or simulation.remove(one),
        "lists": lambda: vars(simulation).update(meshes=[*meshes[::3], box, ball], constraints=[]),
        "link": lambda: simulation.constrain(one, one.position, other, 0, 0.0),
        "row": lambda: simulation.constraints.append([0, 0, 1, 0, 1.5, True]),
        "rub": lambda: simulation.settings.change("friction", rng.uniform()),
    }


@pytest.mark.parametrize(("solver", "seed"), [("impulse", 0), ("soft-step", 1)])
def test_whatever_is_done_by_hand_is_recorded_replayed_resumed_and_restored(tmp_path, solver, seed):
    """Each act twice, in random order."""
    simulation, states, rng = boxes(solver), [], np.random.default_rng(seed)
    simulation.meshes[1].linVelocity = (0.1, 0.0, 0.0)  # before the recording
    names = rng.permutation(2 * list(acts(simulation, rng))).tolist()
    for name, begin, end in (("a.h5", 0, 30), ("b.h5", 30, len(names))):
        with simulation.record(tmp_path / name):
            for act in names[begin:end]:
                states.append(simulation.state())
                acts(simulation, rng)[act]()
                simulation.step()
        check(tmp_path / name, end)
    with Recording(tmp_path / "a.h5") as recording:
        replay = Replay(recording)
        for step in rng.permutation(30).tolist():
            replay.seek(step)
            assert replay.state().rows.tobytes() == states[step].rows.tobytes()
            assert replay.constraints == states[step].constraints
            assert [mesh.name for mesh in replay.meshes] == states[step].names
            assert replay.settings.friction == states[step].settings.friction
            assert (replay.stepCount, replay.time, replay.report) == (step, states[step].time, None)
        for step, found in (99, 30), (-1, 0):
            replay.seek(step)
            assert replay.stepCount == found
        assert bits(resume(recording, 21).state()) == bits(states[21])
    for state in (states[15], pickle.loads(pickle.dumps(states[25])), states[40]):
        simulation.restore(state)
        assert simulation.state().rows.tobytes() == state.rows.tobytes()
        assert simulation.constraints == state.constraints


def test_copies_of_bodies_keep_their_faces_and_an_inertia_that_was_assigned():
    box = shapes.box((1, 1, 1), 5.0, (0, 4, 0))
    turned = box.origVertices, box.faces[::-1], box.tets
    light = Mesh("light", *turned, 5.0, (0, 9, 0), (1, 0, 0, 0), isFixed=False)
    light.invMass, light.invIT = 9.0, 3.0 * light.invIT
    for one in boxes().add(light), Simulation.from_meshes([box, light]).meshes[1]:
        assert one.invMass == 9.0 and one.invIT.tolist() == light.invIT.tolist()
        assert one.faces.tolist() == light.faces.tolist()


def test_a_change_of_the_solver_and_back_begins_anew():
    """What the soft step has kept is out of date after a step of the other solver."""
    simulation = boxes("soft-step").run(75)
    simulation.settings.change("contactSolver", "impulse")
    simulation.run(1).settings.change("contactSolver", "soft-step")
    new = Simulation(simulation.source, simulation.settings)
    new.set_state(simulation.state())
    assert bits(simulation.run(5).state()) == bits(new.run(5).state())


MOVING = ground()
MOVING.linVelocity = np.array([[1.0, 0, 0]])
# What cannot be recorded: an attribute of a body, or of the run, and a word of the message.
REFUSED = {
    "linVelocity": (1, "linVelocity", "fast"),
    "position": (1, "position", (0, np.nan, 0)),
    "orientation": (1, "orientation", (0, 0, 0, 0)),
    "load": (1, "load", ((1, 0), (0, 0, 0))),
    "ground": (None, "groundMesh", MOVING),
    "time": (None, "time", 5.0),
}


@pytest.mark.parametrize("word", REFUSED)
def test_what_cannot_be_recorded_is_refused_by_name_and_what_was_is_kept(tmp_path, word):
    body, name, value = REFUSED[word]
    refused = pytest.raises((ValueError, ArithmeticError), match=word)
    with refused, boxes().record(tmp_path / "a.h5") as simulation:
        simulation.run(4)
        setattr(simulation if body is None else simulation.meshes[body], name, value)
        simulation.step()
    check(tmp_path / "a.h5", 4)


@bothSolvers
def test_copies_in_the_midst_of_a_recording_go_on_by_themselves(tmp_path, solver):
    simulation = boxes(solver)
    with simulation.record(tmp_path / "a.h5"):
        simulation.run(10).constraints = np.array([[0, 0, 1, 0, 1.5, 1]])
        copies = [copy.copy(simulation.run(10)), pickle.loads(pickle.dumps(simulation))]
        before = bits(simulation.state())
        for one in copies:
            one.run(10)
        assert bits(simulation.state()) == before
        simulation.run(10)
    for one in copies:
        assert bits(one.state()) == bits(simulation.state())
    check(tmp_path / "a.h5", 30)


@bothSolvers
def test_a_state_goes_to_another_process_and_to_other_runs_of_the_scene(solver):
    """With bodies that lie on others, were added and removed, and the settings of its time."""
    simulation = boxes(solver).run(75)
    late = simulation.add(shapes.sphere(0.4, 50.0, (0, 4, 0)))
    simulation.constrain(late, late.position, 1, 0, 0.0)
    simulation.remove(2)
    assert {(m1, m2) for m1, _, m2, *_ in simulation.constraints} == {(2, 1)}
    content = pickle.dumps(simulation.run(5).state())
    settings, end = dict(vars(simulation.settings)), simulation.run(10).state()
    other = Simulation(simulation.source, Settings(friction=0.9)).run(3)
    for one in (simulation, other):
        one.restore(pickle.loads(content))
        assert one.stepCount == 80 and vars(one.settings) == settings
        assert bits(one.run(10).state()) == bits(end)
    with pytest.raises(ValueError, match="a state of 3 bodies is not one of"):
        boxes(width=3).restore(pickle.loads(content))
