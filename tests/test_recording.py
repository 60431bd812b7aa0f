"""Recordings: what they hold, replaying, resuming and verifying them, damage; statistics."""

import csv
import math
import shutil
import signal
import subprocess
import sys

import h5py
import numpy as np
import pytest
from program import DATA, PROGRAM, by_hand, environment, record, run, summary_of

from rbs import __version__
from rbs.recording import SOLVER_STEPS, Recorder, Recording, RecordingError
from rbs.replay import Replay, resume, verify
from rbs.simulation import Settings, Simulation
from rbs.state import STATE_NAMES
from rbs.statistics import QUANTITY_UNITS, StatsWriter, step_quantities
from RigidBodySimulation import main

STRESS = DATA / "stress-scene.txt"


def assert_same_state(one, other):
    for name in STATE_NAMES:
        assert one[name].tobytes() == other[name].tobytes(), name


# --------------------------------------------------------------------------------------------------
# Writing
# --------------------------------------------------------------------------------------------------


def test_recording_holds_every_step_as_stepping_by_hand_gives_it(tmp_path):
    options = ["--restitution", 0.8, "--time-step", 0.03, "--steps", 130, "--closing-only"]
    scene = DATA / "mixed-scene.txt"
    summary_of(run(tmp_path, scene, "--headless", "--record", "r.h5", *options))
    expected = by_hand(scene, 130, 0.8, 0.03, closingOnly=True)
    with h5py.File(tmp_path / "r.h5") as recording:
        for name, series in expected.items():
            assert recording[name].dtype == np.dtype("<f8") and recording[name].fletcher32
            np.testing.assert_array_equal(recording[name], series)
        np.testing.assert_allclose(recording["times"], 0.03 * np.arange(131), rtol=1e-12)
        settings, head = recording["settings"].attrs, recording.attrs
        assert settings["timeStep"] == 0.03 and settings["restitution"] == 0.8
        assert settings["closingOnly"] and isinstance(settings["maxIterations"], h5py.Empty)
        assert head["scene"] == b"mixed-scene.txt" and head["constraints"] == b""
        assert head["version"].decode() == __version__
        assert head["numpyVersion"].decode() == np.__version__
        assert recording["scene"][()].tobytes() == scene.read_bytes()
    # The two ways of treating contacts that part must differ here, or the flag was not tested.
    assert not np.array_equal(expected["positions"], by_hand(scene, 130, 0.8, 0.03)["positions"])


def test_recording_holds_what_it_was_made_from(tmp_path):
    simulation = Simulation(DATA / "tower_chain-scene.txt")
    source = Recording(record(tmp_path / "r.h5", simulation, 1)).source
    assert source.scene == simulation.source.scene
    assert source.constraints == simulation.source.constraints != ""
    assert list(source.shapes) == list(simulation.source.shapes)
    for name, arrays in source.shapes.items():
        for ours, theirs in zip(arrays, simulation.source.shapes[name], strict=True):
            np.testing.assert_array_equal(ours, theirs)
            assert ours.dtype == theirs.dtype


def test_only_the_next_step_of_the_same_scene_can_follow(tmp_path):
    simulation = Simulation(DATA / "tet-scene.txt")
    recorder = Recorder(tmp_path / "r.h5")
    recorder.add(simulation)
    with pytest.raises(RecordingError, match="only step 1 of the same scene could follow"):
        recorder.add(simulation)
    other = Simulation(DATA / "tet-scene.txt")
    other.step()
    with pytest.raises(RecordingError, match="only step 1 of the same scene could follow"):
        recorder.add(other)
    simulation.step()
    recorder.add(simulation)
    recorder.save()
    assert Recording(tmp_path / "r.h5").lastStep == 1


def test_old_recording_stays_until_the_new_one_is_whole(tmp_path):
    path, simulation = tmp_path / "r.h5", Simulation(DATA / "tet-scene.txt")
    record(path, simulation, 3)
    old = path.read_bytes()
    simulation.reset()
    for end in ("close", "save"):
        recorder = Recorder(path)
        recorder.add(simulation)
        assert path.read_bytes() == old
        assert Recording(tmp_path / "r.part.h5").lastStep == 0  # what a kill would leave
        getattr(recorder, end)()
        assert [one.name for one in tmp_path.iterdir()] == ["r.h5"]
    assert Recording(path).lastStep == 0


def test_recording_of_nothing_leaves_nothing(tmp_path):
    for end in ("close", "save"):
        getattr(Recorder(tmp_path / "r.h5"), end)()
        assert list(tmp_path.iterdir()) == []


def test_bytes_held_back_are_limited(tmp_path, monkeypatch):
    monkeypatch.setattr("rbs.recording.FLUSH_SECONDS", 1e9)
    monkeypatch.setattr("rbs.recording.PENDING_BYTES", 41 * 13 * 8 * 10)
    simulation, recorder = Simulation(STRESS), Recorder(tmp_path / "r.h5")
    counts = []
    for _ in range(25):
        recorder.add(simulation)
        counts.append(Recording(tmp_path / "r.h5").lastStep if recorder.frameCount >= 10 else -1)
        simulation.step()
    recorder.save()
    assert counts[9] == 9 and counts[18] == 9 and counts[19:] == [19] * 6


def test_other_programs_read_a_recording_while_it_grows(tmp_path, monkeypatch):
    monkeypatch.setattr("rbs.recording.FLUSH_SECONDS", 0.0)
    simulation, recorder = Simulation(STRESS), Recorder(tmp_path / "r.h5")
    for _ in range(4):
        recorder.add(simulation)
        simulation.step()
    summary = summary_of(run(tmp_path, "--headless", "--replay", "r.h5"))
    assert summary["steps"].startswith("3 of")
    recorder.add(simulation)
    recorder.save()
    assert verify(Recording(tmp_path / "r.h5")) == ""


# --------------------------------------------------------------------------------------------------
# Replay
# --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    """(path of a recording of 60 steps, its states): tied bodies, and settings that change."""
    simulation = Simulation(DATA / "tower_chain-scene.txt")
    states = []

    def keep_and_change(simulation, step):
        states.append(simulation.state())
        if step == 31:
            simulation.settings.friction = 0.5

    path = tmp_path_factory.mktemp("chain") / "chain.h5"
    record(path, simulation, 60, keep_and_change)
    return path, [*states, simulation.state()]


def test_replay_stands_where_the_simulation_stood(chain):
    path, states = chain
    replay = Replay(Recording(path))
    live = Simulation(DATA / "tower_chain-scene.txt")
    assert (replay.firstStep, replay.lastStep, replay.stepCount) == (0, 60, 0)
    assert replay.report is None and replay.stepSeconds is None
    for step in range(61):
        assert replay.stepCount == step and replay.time == live.time
        assert_same_state(replay.state(), states[step])
        for mesh, twin in zip(replay.meshes, live.meshes, strict=True):
            np.testing.assert_array_equal(mesh.currVertices, twin.currVertices)
        assert replay.kinetic_energy() == live.kinetic_energy()
        assert replay.largest_violation() == live.largest_violation()
        assert replay.settings.friction == (0.5 if step > 30 else 0.0)
        live.settings.friction = 0.5 if step >= 30 else 0.0
        live.step()
        replay.step()
    assert replay.stepCount == 60  # it stays at the end


def test_replay_can_be_sought_through(chain):
    path, states = chain
    replay = Replay(Recording(path))
    for step, found in ((47, 47), (3, 3), (60, 60), (0, 0), (59, 59), (1000, 60), (-1, 0)):
        replay.seek(step)
        assert replay.stepCount == found
        assert_same_state(replay.state(), states[found])
    replay.step()
    replay.reset()
    assert replay.stepCount == 0 and replay.time == 0.0


def test_replay_simulates_nothing(chain, monkeypatch, capsys):
    monkeypatch.setattr("rbs.simulation.run_timestep", None)
    assert main(["--headless", "--replay", str(chain[0]), "--steps", "20"]) == 0
    output = capsys.readouterr().out
    assert "steps             20 of 0.02 s: 0.4 s simulated" in output
    assert "time per step     a recording" in output


# --------------------------------------------------------------------------------------------------
# Resume and verify
# --------------------------------------------------------------------------------------------------


def test_a_recording_alone_is_replayed_verified_and_resumed(tmp_path):
    home, away = tmp_path / "home", tmp_path / "away"
    home.mkdir(), away.mkdir()
    for path in (*DATA.glob("*.mesh"), *DATA.glob("tower_chain-*")):
        shutil.copy(path, home)
    scene = home / "tower_chain-scene.txt"
    settings = ["--friction", "0.3", "--restitution", "0.7"]
    assert main([str(scene), "--steps", "90", "--record", str(away / "r.h5"), *settings]) == 0
    shutil.rmtree(home)
    assert summary_of(run(away, "--headless", "--replay", "r.h5"))["constraints"].startswith("16")
    assert run(away, "--verify", "r.h5").stdout == "r.h5: steps 0–90 are identical, bit for bit\n"
    options = ["--resume", "r.h5", "--from", "45", "--steps", "45", "--record", "rest.h5"]
    assert summary_of(run(away, *options))["steps"] == "90 of 0.02 s: 1.8 s simulated"
    expected, resumed = Recording(away / "r.h5"), Recording(away / "rest.h5")
    assert (resumed.firstStep, resumed.lastStep) == (45, 90)
    for step in range(45, 91):
        assert_same_state(expected.frame(step), resumed.frame(step))
        assert expected.frame(step)["times"] == resumed.frame(step)["times"]
    assert resumed.settings_at(80)[1] == expected.settings_at(80)[1]
    assert main(["--verify", str(away / "rest.h5")]) == 0


@pytest.mark.parametrize("step", [0, 7, 100, 123, 130])
def test_soft_steps_are_resumed_with_the_same_bits(standing, monkeypatch, step):
    steps = []
    monkeypatch.setattr(Simulation, "step", lambda self, step=Simulation.step: (
        steps.append(self.stepCount + 1), step(self)))  # fmt: skip
    recording = Recording(standing)
    simulation = resume(recording, step)
    kept = 130 if step == 130 else step // SOLVER_STEPS * SOLVER_STEPS
    assert steps == list(range(kept + 1, step + 1))  # from the last state that was kept
    for later in range(step + 1, min(step + 5, 131)):
        simulation.step()
        assert_same_state(simulation.state(), recording.frame(later))


@pytest.fixture(scope="module")
def standing(tmp_path_factory):
    """A recording of 130 soft steps, in which boxes hit the ground and each other."""
    simulation = Simulation(STRESS, Settings(friction=0.5, contactSolver="soft-step"))
    return record(tmp_path_factory.mktemp("soft") / "r.h5", simulation, 130)


def test_resumed_run_can_have_other_settings(chain, tmp_path):
    path, _ = chain
    rest = str(tmp_path / "rest.h5")
    options = ["--restitution", "0.25", "--no-constraints", "--steps", "2", "--record", rest]
    assert main(["--resume", str(path), *options]) == 0
    assert Recording(rest).firstStep == 60
    expected = dict(Recording(path).settings_at(60)[1])
    assert expected["friction"] == 0.5
    expected |= {"restitution": 0.25, "enforceConstraints": False}
    assert Recording(rest).settings_at(62) == (60, expected)


def test_verifying_names_the_first_step_that_another_run_differs_in(tmp_path, capsys):
    def push(simulation, step):
        if step == 12:
            simulation.meshes[3].linVelocity = np.nextafter(simulation.meshes[3].linVelocity, 1.0)

    path = record(tmp_path / "r.h5", Simulation(DATA / "tet-scene.txt"), 20, push)
    assert main(["--verify", str(path)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "r.h5: step 12 differs: linVelocities by up to " in line


def edited(path, target, edit):
    """A copy of a recording in which edit(h5py.File) has changed something."""
    shutil.copy(path, target)
    with h5py.File(target, "r+") as file:
        edit(file)
    return target


def put(name, place, value):
    def edit(file):
        file[name][place] = value

    return edit


EDITS = {
    "a position": (put("positions", (33, 4, 1), 3.5), "step 33 differs: positions by up to "),
    "the sign of a zero": (put("angVelocities", (0, 0, 0), -0.0),
                           "step 0 differs: angVelocities by up to 0"),
    "a time": (put("times", 20, 0.5), "step 20 differs: times by up to 0.1"),
    "the scene": (put("scene", 0, ord("?")), "it is damaged"),
    "an event": (put("events", 0, 0), "it is damaged"),
    "no state": (lambda file: file["times"].resize(0, axis=0), "it holds no state"),
    "a setting": (lambda file: file["settings"].attrs.__setitem__("friction", -1.0),
                  "step 0: friction must be a finite number of 0 or more, not -1"),
    "a new setting": (lambda file: file["settings"].attrs.__setitem__("wind", 1.0),
                      "it has a setting that this version does not know: wind"),
    "the format": (lambda file: file.attrs.__setitem__("format", "x"),
                   "this is an HDF5 file, but not a recording"),
    "no mesh": (lambda file: file.__delitem__("meshes/0"), "it is damaged"),
}  # fmt: skip


@pytest.mark.parametrize("case", EDITS)
def test_what_was_changed_in_a_recording_is_found(chain, tmp_path, capsys, case):
    edit, cause = EDITS[case]
    path = edited(chain[0], tmp_path / "d.h5", edit)
    assert main(["--verify", str(path)]) in (1, 2)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"RigidBodySimulation.py: {path}: {cause}")


def test_resuming_is_refused_where_the_steps_lead_elsewhere(standing, chain, tmp_path, capsys):
    assert main(["--headless", "--resume", str(chain[0]), "--from", "61"]) == 2
    assert "chain.h5: step 61 is not in it, only steps 0 to 60 are" in capsys.readouterr().err
    path = edited(standing, tmp_path / "d.h5", put("positions", (50, 30, 1), 3.5))
    assert main(["--headless", "--resume", str(path), "--from", "50"]) == 2
    assert "d.h5: step 50 cannot be resumed: positions by up to" in capsys.readouterr().err


def test_flipped_bytes_are_told_in_one_line(chain, tmp_path, capsys):
    content = chain[0].read_bytes()
    (positions,) = Recording(chain[0]).frame(33)["positions"][:1]
    place = content.index(positions.tobytes())
    places = [place, place + 13, *np.random.default_rng(3).integers(len(content), size=60)]
    found = 0
    for number, at in enumerate(map(int, places)):
        path = tmp_path / f"{number}.h5"
        path.write_bytes(content[:at] + bytes([content[at] ^ 0x10]) + content[at + 1 :])
        code = main(["--verify", str(path)])
        lines = capsys.readouterr().err.splitlines()
        assert (code, len(lines)) in ((0, 0), (1, 1), (2, 1)), (at, lines)
        found += code > 0
        assert number >= 2 or "it is damaged" in lines[0]
    assert found > 30  # the others are in no use


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.9, 0.999])
def test_truncated_recordings_are_told_in_one_line(chain, tmp_path, capsys, share):
    content = chain[0].read_bytes()
    (tmp_path / "cut.h5").write_bytes(content[: int(share * len(content))])
    assert main(["--headless", "--replay", str(tmp_path / "cut.h5")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "cut.h5: it is damaged (" in line or "cut.h5: this is not a recording" in line


# --------------------------------------------------------------------------------------------------
# Signals
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_signal_leaves_what_was_simulated(tmp_path, number):
    command = [sys.executable, PROGRAM, "stress", "--steps", "100000", "--record", "r.h5"]
    command += ["--stats", "s.csv"]
    process = subprocess.Popen(
        command, cwd=tmp_path, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True,
    )  # fmt: skip
    table, rows = tmp_path / "s.part.csv", []
    try:
        while len(rows) < 300:
            assert process.poll() is None, process.communicate()[1]
            # Without the row that is being written.
            rows = table.read_text().splitlines()[1:-1] if table.exists() else []
        steps = int(rows[-1].split(",")[0])
    except BaseException:
        process.kill()
        raise
    process.send_signal(number)
    output, errors = process.communicate(timeout=60)
    recording = Recording(tmp_path / "r.h5")
    if number == signal.SIGKILL:
        assert process.returncode == -signal.SIGKILL
        assert recording.lastStep > 0 and (tmp_path / "s.part.csv").exists()
    else:
        assert process.returncode == 128 + number
        stopped = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "kill"}[number]
        assert f"stopped by {stopped}" in output and "Traceback" not in errors
        assert recording.lastStep >= steps
        assert table_of(tmp_path / "s.csv")["step"][-1] == str(recording.lastStep)
    assert verify(recording) == ""


# --------------------------------------------------------------------------------------------------
# Statistics
# --------------------------------------------------------------------------------------------------


def table_of(path):
    """The columns of a .csv file, dict of lists of str."""
    with open(path, encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    return {name: list(column) for name, *column in zip(*rows, strict=True)}


def test_statistics_are_those_of_an_independent_computation(tmp_path):
    options = ["--restitution", "0.8", "--steps", "200"]
    assert main(["stress", *options, "--stats", str(tmp_path / "s.csv")]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["s.csv"]
    table = table_of(tmp_path / "s.csv")
    units = [f"{name} ({unit})" if unit else name for name, unit in QUANTITY_UNITS.items()]
    assert list(table) == ["step", *units]
    assert table["step"] == [str(step) for step in range(201)]
    assert table["contacts"][0] == table["collisionsTime (ms)"][0] == ""

    simulation = Simulation(STRESS, Settings(restitution=0.8))
    contacts = 0
    for step in range(201):
        if step > 0:
            simulation.step()
            depths = [contact.depth for contact in simulation.report.contacts]
            contacts += len(depths)
            assert int(table["contacts"][step]) == len(depths)
            assert float(table["deepestPenetration (m)"][step]) == max(depths, default=0.0)
            assert int(table["candidatePairs"][step]) == simulation.report.candidatePairs
            assert float(table["collisionsTime (ms)"][step]) > 0.0
        kinetic = potential = 0.0
        p, L = np.zeros(3), np.zeros(3)
        for mesh in simulation.meshes:
            if mesh.isFixed:
                continue
            v, w = mesh.linVelocity[0], mesh.angVelocity[0]
            inertia = np.linalg.inv(mesh.get_rotated_inv_IT())
            kinetic += 0.5 * mesh.mass * v @ v + 0.5 * w @ inertia @ w
            potential += mesh.mass * 9.8 * mesh.position[0, 1]
            p += mesh.mass * v
            L += np.cross(mesh.position[0], mesh.mass * v) + inertia @ w
        got = {name: float(column[step]) for name, column in table.items() if column[step]}
        assert got["time (s)"] == simulation.time
        assert got["kineticEnergy (J)"] == pytest.approx(kinetic, rel=1e-12)
        assert got["potentialEnergy (J)"] == pytest.approx(potential, rel=1e-12)
        assert got["totalEnergy (J)"] == pytest.approx(kinetic + potential, rel=1e-12)
        momentum = [got[f"momentum{axis} (kg m/s)"] for axis in "XYZ"]
        angular = [got[f"angularMomentum{axis} (kg m²/s)"] for axis in "XYZ"]
        np.testing.assert_allclose(momentum, p, rtol=1e-12, atol=1e-12 * np.abs(p).max())
        np.testing.assert_allclose(angular, L, rtol=1e-11, atol=1e-11 * (1 + np.abs(L).max()))
    assert contacts > 20


def test_statistics_of_constraints(chain, tmp_path):
    scene, path = DATA / "tower_chain-scene.txt", tmp_path / "s.csv"
    assert main([str(scene), "--steps", "70", "--stats", str(path)]) == 0
    table = table_of(path)
    simulation = Simulation(scene)
    for step in range(1, 71):
        simulation.step()
        assert int(table["constraintVisits"][step]) == simulation.report.constraintVisits >= 16
    violation = float(table["largestViolation (m)"][70])
    assert violation == simulation.largest_violation() > 0.0


def test_statistics_of_a_replay_have_what_the_states_tell(chain, tmp_path):
    assert main(["--replay", str(chain[0]), "--stats", str(tmp_path / "s.csv")]) == 0
    table = table_of(tmp_path / "s.csv")
    assert len(table["step"]) == 61
    assert set(table["contacts"]) == {""} and "" not in table["totalEnergy (J)"]


def test_quantities_before_the_first_step_and_of_fixed_bodies_only(tmp_path):
    (tmp_path / "box.mesh").write_bytes((DATA / "box.mesh").read_bytes())
    scene = tmp_path / "fixed-scene.txt"
    scene.write_text("1\nbox.mesh 1 1 0 9 0 1 0 0 0\n")
    simulation = Simulation(scene)
    quantities = step_quantities(simulation)
    assert list(quantities) == list(QUANTITY_UNITS)
    assert quantities["totalEnergy"] == quantities["momentumX"] == 0.0
    assert math.isnan(quantities["contacts"])
    simulation.step()
    assert step_quantities(simulation)["contacts"] == 0


def test_statistics_take_their_place_when_they_are_saved(tmp_path):
    (tmp_path / "s.csv").write_text("older")
    simulation = Simulation(DATA / "tet-scene.txt")
    for isSaved in (False, True):
        writer = StatsWriter(tmp_path / "s.csv")
        writer.add(simulation)
        # Already on the disk, should the program be killed now.
        assert len(table_of(tmp_path / "s.part.csv")["step"]) == 1
        assert (tmp_path / "s.csv").read_text() == "older"
        if isSaved:
            writer.save(simulation)
        writer.close()
        assert [path.name for path in tmp_path.iterdir()] == ["s.csv"]
    assert len(table_of(tmp_path / "s.csv")["step"]) == 1


def test_plot_is_a_picture(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    assert main(["tower_chain", "--steps", "30", "--plot", str(tmp_path / "p.png")]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["p.png"]
    content = (tmp_path / "p.png").read_bytes()
    assert content[:8] == b"\x89PNG\r\n\x1a\n" and len(content) > 20_000
    assert capsys.readouterr().out.splitlines()[-1].startswith("plot   ")


def test_missing_matplotlib_is_told_before_anything_is_simulated(tmp_path):
    fakes = tmp_path / "fakes"
    fakes.mkdir()
    (fakes / "matplotlib.py").write_text("raise ImportError('none')")
    process = run(tmp_path, "tower", "--plot", "p.png", PYTHONPATH=str(fakes))
    assert (process.returncode, process.stdout) == (2, "")
    assert process.stderr == (
        "RigidBodySimulation.py: --plot needs matplotlib: pip install matplotlib\n"
    )
    assert [path.name for path in tmp_path.iterdir()] == ["fakes"]


# --------------------------------------------------------------------------------------------------
# Command line
# --------------------------------------------------------------------------------------------------

CONFLICTING = {
    "replay and record": (["--replay", "r", "--record", "s.h5"],
                          "--record does not go with --replay"),
    "replay and resume": (["--replay", "r", "--resume", "s"], "not allowed with argument --replay"),
    "replay and friction": (["--replay", "r", "--friction", "0"],
                            "--friction does not go with --replay: a replay simulates nothing"),
    "verify and steps": (["--verify", "r", "--steps", "9"], "--steps does not go with --verify"),
    "verify and stats": (["--verify", "r", "--stats", "s"], "--stats does not go with --verify"),
    "from alone": (["--from", "3"], "--from says where --resume starts, which is missing"),
    "from and replay": (["--replay", "r", "--from", "3"], "--from says where --resume starts"),
    "record without ending": (["--record", "r"],
                              "--record: the name of a recording must end in .h5 or .hdf5"),
    "scene and replay": (["tower", "--replay", "r"], "SCENE does not go with --replay"),
    "stats and plot": (["--stats", "s", "--plot", "s"],
                       "--plot s: not written, because --stats writes it too"),
    "replay of here": (["--headless", "--replay", "."], ".: cannot be read (Is a directory)"),
    "verify of nothing": (["--verify", "r.h5"], "r.h5: cannot be read (No such file"),
    "negative from": (["--resume", "r", "--from", "-1"], "--from: must be 0 or more, not -1"),
    "stats to nowhere": (["--stats", "no/s.csv"], "no/s.csv: No such file or directory"),
    "stats to a folder": (["--stats", "."], ".: Is a directory"),
}  # fmt: skip


@pytest.mark.parametrize("case", CONFLICTING)
def test_options_that_do_not_go_together_are_told_in_one_line(tmp_path, monkeypatch, capsys, case):
    arguments, message = CONFLICTING[case]
    monkeypatch.chdir(tmp_path)
    try:
        code = main(arguments)
    except SystemExit as ended:  # argparse does not return
        code = ended.code
    output, errors = capsys.readouterr()
    assert (code, output) == (2, "")
    (line,) = errors.splitlines()
    assert line.startswith("RigidBodySimulation.py: ") and message in line
    assert list(tmp_path.iterdir()) == []
