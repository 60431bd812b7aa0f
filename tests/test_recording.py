"""Recordings: writing, crashing, reading what is hostile, replaying, resuming, verifying."""

import csv
import io
import json
import math
import os
import signal
import subprocess
import sys
import time
import zipfile

import numpy as np
import pytest
from oracles import ROOT
from program import DATA, PROGRAM, by_hand, environment, record, run, summary_of

import rbs.recording
from rbs import __version__
from rbs.recording import Recorder, Recording
from rbs.recordingfiles import RecordingError
from rbs.replay import Replay, resume, verify
from rbs.simulation import DEFAULT_RESTITUTION, DEFAULT_TIME_STEP, Settings, Simulation
from rbs.state import STATE_NAMES, hash_of
from rbs.statistics import QUANTITY_UNITS, StatsWriter, step_quantities
from RigidBodySimulation import load_scene_file, main

STRESS = DATA / "stress-scene.txt"


def assert_same_state(one, other):
    for name in STATE_NAMES:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


# --------------------------------------------------------------------------------------------------
# Writing
# --------------------------------------------------------------------------------------------------


def test_recording_holds_every_step_as_stepping_by_hand_gives_it(tmp_path):
    options = ["--restitution", 0.8, "--time-step", 0.03, "--steps", 130, "--closing-only"]
    scene = DATA / "mixed-scene.txt"
    summary_of(run(tmp_path, scene, "--headless", "--record", "r.npz", *options))
    expected = by_hand(scene, 130, 0.8, 0.03, closingOnly=True)
    with np.load(tmp_path / "r.npz") as recording:
        for name, series in expected.items():
            assert recording[name].dtype == np.float64
            np.testing.assert_array_equal(recording[name], series)
        assert recording["timeStep"] == 0.03 and recording["restitution"] == 0.8
        assert bool(recording["closingOnly"]) and str(recording["scene"]) == str(scene)
        assert recording["meshNames"].tolist() == [m.name for m in load_scene_file(scene)]
    # The two ways of treating contacts that part must differ here, or the flag was not tested.
    assert not np.array_equal(expected["positions"], by_hand(scene, 130, 0.8, 0.03)["positions"])


def test_same_command_twice_writes_the_same_bytes(tmp_path):
    for name in ("a.npz", "b.npz"):
        summary_of(run(tmp_path, "stress", "--steps", 60, "--record", name))
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    with np.load(tmp_path / "a.npz") as recording:
        expected = by_hand(DATA / "stress-scene.txt", 60, DEFAULT_RESTITUTION, DEFAULT_TIME_STEP)
        np.testing.assert_array_equal(recording["orientations"], expected["orientations"])


def start_recording(folder, chunks):
    """A recording of 10⁶ steps that has written so many chunks; the running process."""
    process = subprocess.Popen(
        [sys.executable, PROGRAM, "tower", "--headless", "--steps", "1000000",
         "--record", "r.npz"],
        cwd=folder, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while len(list(folder.glob("r.npz.part/*.npz"))) < chunks and time.monotonic() < deadline:
        time.sleep(0.02)
    return process


@pytest.mark.skipif(os.name == "nt", reason="Windows cannot send Ctrl-C to one process")
def test_ctrl_c_saves_what_was_simulated(tmp_path):
    process = start_recording(tmp_path, chunks=1)
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=60)
    assert process.returncode == 130 and errors == ""
    assert "stopped by Ctrl-C" in output
    assert [path.name for path in tmp_path.iterdir()] == ["r.npz"]
    with np.load(tmp_path / "r.npz") as recording:
        positions = recording["positions"]
    compared = min(len(positions), 40)
    assert compared > 1 and f"{len(positions) - 1} of 0.02 s" in output
    expected = by_hand(
        DATA / "tower-scene.txt", compared - 1, DEFAULT_RESTITUTION, DEFAULT_TIME_STEP
    )
    np.testing.assert_array_equal(positions[:compared], expected["positions"])


def test_killed_run_keeps_its_whole_chunks_and_the_old_recording(tmp_path, monkeypatch, capsys):
    (tmp_path / "r.npz").write_bytes(b"an older recording")
    process = start_recording(tmp_path, chunks=2)
    process.kill()  # SIGKILL: the program can do nothing about it
    process.communicate(timeout=60)
    assert (tmp_path / "r.npz").read_bytes() == b"an older recording"
    (tmp_path / "r.npz").unlink()
    monkeypatch.chdir(tmp_path)

    recording = Recording("r.npz")
    assert recording.wasInterrupted and recording.firstStep == 0 and recording.lastStep >= 40
    expected = by_hand(DATA / "tower-scene.txt", 40, DEFAULT_RESTITUTION, DEFAULT_TIME_STEP)
    for step in range(41):
        assert_same_state(
            recording.frame(step), {name: expected[name][step] for name in STATE_NAMES}
        )
    assert main(["--headless", "--replay", "r.npz"]) == 0
    output, errors = capsys.readouterr()
    assert f"steps             {recording.lastStep} of 0.02 s" in output
    (line,) = errors.splitlines()
    assert f"an interrupted recording, of the steps 0 to {recording.lastStep}" in line
    # It is not written over, nor lost, by a new recording of that name.
    assert main(["tower", "--steps", "3", "--record", "r.npz"]) == 2
    assert "r.npz.part: an interrupted recording is kept here" in capsys.readouterr().err
    assert Recording("r.npz.part").lastStep == recording.lastStep


def test_chunks_make_the_same_file_as_one(tmp_path, monkeypatch):
    one = record(tmp_path / "one.npz", Simulation(STRESS), 30)
    monkeypatch.setattr(rbs.recording, "BLOCK_BYTES", 7 * 41 * 13 * 8)  # seven states a chunk
    chunks = []
    rename = os.replace
    monkeypatch.setattr(os, "replace", lambda old, new: (chunks.append(new), rename(old, new)))
    other = record(tmp_path / "other.npz", Simulation(STRESS), 30)
    assert [path.name for path in chunks] == [
        *(f"chunk_{k:06d}.npz" for k in range(math.ceil(31 / 7))), "other.npz"
    ]  # fmt: skip
    assert one.read_bytes() == other.read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.npz", "other.npz"]


def test_recording_tells_how_it_was_made(tmp_path):
    def change(simulation, step):  # as the window does
        if step == 5:
            simulation.settings.friction = 0.3
        if step == 8:
            simulation.settings.timeStep = 0.01

    scene = DATA / "tower_chain-scene.txt"
    simulation = Simulation(scene, Settings(maxIterations=50))
    path = record(tmp_path / "r.npz", simulation, 10, change)
    with np.load(path, allow_pickle=False) as file:
        history = json.loads(str(file["settingsHistory"]))
        assert [step for step, _ in history] == [0, 5, 8]
        assert [fields["friction"] for _, fields in history] == [0.0, 0.3, 0.3]
        assert set(history[0][1]) == set(vars(Settings()))
        assert file["friction"] == 0.3 and file["timeStep"] == 0.01 and file["maxIterations"] == 50
        assert str(file["version"]) == __version__
        assert str(file["numpyVersion"]) == np.__version__
        assert str(file["constraints"]).endswith("tower_chain-constraints.txt")
        assert file["times"][7] == pytest.approx(0.14) and file["times"][10] == simulation.time
        for step in range(11):
            state = {name: file[name][step] for name in STATE_NAMES}
            np.testing.assert_array_equal(file["hashes"][step], hash_of(state))


def test_memory_of_a_recorder_is_that_of_a_chunk(tmp_path, monkeypatch):
    monkeypatch.setattr(rbs.recording, "BLOCK_BYTES", 10_000)
    simulation = Simulation(DATA / "tet-scene.txt")
    recorder = Recorder(tmp_path / "r.npz")
    frameBytes = sum(values.nbytes for values in simulation.state().values())
    for step in range(50):
        simulation.stepCount = step
        recorder.add(simulation)
        assert len(recorder._frames) * frameBytes < 10_000 + frameBytes
    recorder.save()
    assert Recording(tmp_path / "r.npz").lastStep == 49


def test_only_the_next_step_of_the_same_scene_can_follow(tmp_path):
    simulation = Simulation(DATA / "tet-scene.txt")
    recorder = Recorder(tmp_path / "r.npz")
    recorder.add(simulation)
    simulation.step()
    recorder.add(simulation)
    simulation.reset()
    with pytest.raises(RecordingError, match="only step 2 of the same scene could follow"):
        recorder.add(simulation)
    simulation.load(DATA / "tower-scene.txt")
    simulation.stepCount = 2
    with pytest.raises(RecordingError, match="only step 2"):
        recorder.add(simulation)
    recorder.save()
    assert Recording(tmp_path / "r.npz").lastStep == 1


def test_full_disk_leaves_the_old_file_and_the_chunks_before_it(tmp_path, monkeypatch):
    (tmp_path / "r.npz").write_bytes(b"an older recording")
    simulation = Simulation(DATA / "tet-scene.txt")
    recorder = Recorder(tmp_path / "r.npz")
    recorder.add(simulation)
    recorder._write_chunk()
    simulation.step()

    def full_disk(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full_disk)
    recorder.add(simulation)
    with pytest.raises(OSError, match="No space left"):
        recorder.save()
    assert recorder.close() == tmp_path / "r.npz.part"
    assert (tmp_path / "r.npz").read_bytes() == b"an older recording"
    assert [path.name for path in (tmp_path / "r.npz.part").iterdir()] == ["chunk_000000.npz"]
    assert Recording(tmp_path / "r.npz.part").lastStep == 0


def test_folder_of_a_run_that_ended_before_its_first_chunk_is_used(tmp_path):
    (tmp_path / "r.npz.part").mkdir()
    (tmp_path / "r.npz.part" / "chunk_000000.tmp").write_bytes(b"half")
    record(tmp_path / "r.npz", Simulation(DATA / "tet-scene.txt"), 1)
    assert [path.name for path in tmp_path.iterdir()] == ["r.npz"]


def test_number_of_visits_that_fits_no_integer_can_be_recorded(tmp_path):
    path = record(
        tmp_path / "r.npz", Simulation(DATA / "tet-scene.txt", Settings(maxIterations=10**30)), 1
    )
    assert Recording(path).settings_at(1)[1]["maxIterations"] == 10**30


def test_recording_of_nothing_leaves_nothing(tmp_path):
    assert Recorder(tmp_path / "r.npz").close() is None
    assert list(tmp_path.iterdir()) == []


# --------------------------------------------------------------------------------------------------
# Replay
# --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    """(path of a recording of 60 steps, its states): tied bodies, and settings that change."""

    def change(simulation, step):
        if step == 31:
            simulation.settings.friction = 0.5

    states = []
    simulation = Simulation(DATA / "tower_chain-scene.txt")
    states.append(simulation.state())

    def change_and_keep(simulation, step):
        if step > 1:
            states.append(simulation.state())
        change(simulation, step)

    path = tmp_path_factory.mktemp("chain") / "chain.npz"
    record(path, simulation, 60, change_and_keep)
    return path, [*states, simulation.state()]


def replay_of(path, scene="tower_chain"):
    return Replay(Recording(path), Simulation(DATA / f"{scene}-scene.txt"))


def test_replay_stands_where_the_simulation_stood(chain):
    path, states = chain
    replay = replay_of(path)
    live = Simulation(DATA / "tower_chain-scene.txt")
    assert (replay.firstStep, replay.lastStep, replay.stepCount) == (0, 60, 0)
    assert replay.report is None and replay.stepSeconds is None
    for step in range(61):
        assert replay.stepCount == step and replay.time == live.time
        assert_same_state(replay.state(), states[step])
        for mesh, twin in zip(replay.meshes, live.meshes, strict=True):
            np.testing.assert_array_equal(mesh.currVertices, twin.currVertices)
        assert replay.kinetic_energy() == live.kinetic_energy()
        assert replay.potential_energy() == live.potential_energy()
        assert replay.largest_violation() == live.largest_violation()
        assert replay.lowest_point() == live.lowest_point() and replay.is_finite()
        assert replay.settings.friction == (0.5 if step > 30 else 0.0)
        live.settings.friction = 0.5 if step >= 30 else 0.0
        live.step()
        replay.step()
    assert replay.stepCount == 60  # it stays at the end


def test_replay_can_be_sought_through(chain):
    path, states = chain
    replay = replay_of(path)
    for step in (47, 3, 60, 0, 59):
        replay.seek(step)
        assert replay.stepCount == step
        assert_same_state(replay.state(), states[step])
    replay.seek(1000)
    assert replay.stepCount == 60
    replay.seek(-1)
    assert replay.stepCount == 0
    replay.step()
    replay.reset()
    assert replay.stepCount == 0 and replay.time == 0.0
    assert_same_state(replay.state(), states[0])


def test_replay_simulates_nothing(chain, monkeypatch, capsys):
    path, states = chain
    monkeypatch.setattr("rbs.simulation.run_timestep", None)
    assert main(["--headless", "--replay", str(path), "--steps", "20"]) == 0
    output = capsys.readouterr().out
    assert "steps             20 of 0.02 s: 0.4 s simulated" in output
    assert "time per step     a recording" in output


def test_files_of_a_recording_are_looked_for(tmp_path, monkeypatch, capsys):
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    (here / "own-scene.txt").write_text("1\nbox.mesh 1 0 0 9 0 1 0 0 0\n")
    (here / "box.mesh").write_bytes((DATA / "box.mesh").read_bytes())
    monkeypatch.chdir(here)
    assert main(["own-scene.txt", "--steps", "3", "--record", "r.npz"]) == 0
    here.rename(there)
    monkeypatch.chdir(tmp_path)
    assert main(["--headless", "--replay", "there/r.npz"]) == 0  # beside the recording
    assert "there/own-scene.txt" in capsys.readouterr().out
    (there / "r.npz").rename(tmp_path / "r.npz")
    assert main(["--headless", "--replay", "r.npz"]) == 2
    assert capsys.readouterr().err == (
        "RigidBodySimulation.py: r.npz: its file own-scene.txt is not there any more; say with "
        "SCENE where it is\n"
    )
    assert main(["there/own-scene.txt", "--headless", "--replay", "r.npz"]) == 0
    capsys.readouterr()
    assert main(["tower", "--headless", "--replay", "r.npz"]) == 2
    assert "r.npz: it has 1 bodies, but " in capsys.readouterr().err
    assert main(["singletet", "--headless", "--replay", "r.npz"]) == 2
    assert "r.npz: its body 'box 0' is called 'tetrahedron 0' in " in capsys.readouterr().err


# --------------------------------------------------------------------------------------------------
# Resume and verify
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["stress", "tower_chain"])
def test_resumed_run_has_the_bits_of_the_uninterrupted_one(tmp_path, name):
    settings = ["--friction", "0.3", "--restitution", "0.7"]
    whole, part, rest = (str(tmp_path / f"{which}.npz") for which in ("whole", "part", "rest"))
    assert main([name, "--steps", "120", "--record", whole, *settings]) == 0
    assert main([name, "--steps", "60", "--record", part, *settings]) == 0
    # In another process, which cannot remember anything.
    options = ["--resume", part, "--from", "45", "--steps", "75", "--record", rest]
    summary = summary_of(run(tmp_path, *options))
    assert summary["steps"] == "120 of 0.02 s: 2.4 s simulated"
    expected, resumed = Recording(whole), Recording(rest)
    assert (resumed.firstStep, resumed.lastStep) == (45, 120)
    for step in range(45, 121):
        one, other = expected.frame(step), resumed.frame(step)
        assert_same_state(one, other)
        assert one["times"] == other["times"] and (one["hashes"] == other["hashes"]).all()
    assert resumed.settings_at(100)[1] == expected.settings_at(100)[1]
    assert main(["--verify", rest]) == 0


def test_resumed_run_can_have_other_settings(chain, tmp_path):
    path, _ = chain
    rest = str(tmp_path / "rest.npz")
    options = ["--restitution", "0.25", "--no-constraints", "--steps", "2", "--record", rest]
    assert main(["--resume", str(path), *options]) == 0
    assert Recording(rest).firstStep == 60
    expected = dict(Recording(path).settings_at(60)[1])
    assert expected["friction"] == 0.5
    expected |= {"restitution": 0.25, "enforceConstraints": False}
    assert Recording(rest).settings_at(62) == (60, expected)


def test_resuming_is_refused_from_a_step_that_is_not_there_or_damaged(chain, tmp_path, capsys):
    path, _ = chain
    assert main(["--headless", "--resume", str(path), "--from", "61"]) == 2
    assert f"{path}: step 61 is not in it, only steps 0 to 60 are" in capsys.readouterr().err
    damaged = flip(path, tmp_path / "d.npz", "positions", 50 * 9 * 3 * 8 + 1)
    with pytest.raises(RecordingError, match="step 50 is damaged: its state does not match"):
        resume(Recording(damaged), 50, Simulation(DATA / "tower_chain-scene.txt"))


def flip(path, target, member, place, bit=1):
    """A copy of a recording with one bit changed, in byte `place` of an array's numbers."""
    content = bytearray(path.read_bytes())
    with np.load(path) as file:
        numbers = file[member].tobytes()
    # Behind the array's name and the blanks that fill up its header.
    start = content.index(b" \n" + numbers, content.index(member.encode() + b".npy")) + 2
    content[start + place] ^= bit
    target.write_bytes(content)
    return target


def test_verifying_finds_the_same_states(chain, capsys):
    path, _ = chain
    assert main(["--verify", str(path)]) == 0
    assert "chain.npz: the steps 0 to 60 are the same" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("member", "row", "place", "words"),
    [
        ("positions", 9 * 3 * 8, 17, "step 33 is damaged: its state does not match its hash"),
        ("orientations", 9 * 4 * 8, 200, "step 33 is damaged: its state does not match its hash"),
        ("angVelocities", 9 * 3 * 8, 0, "step 33 is damaged: its state does not match its hash"),
        ("hashes", 16, 15, "step 33 is damaged: its state does not match its hash"),
        ("times", 8, 2, "the array {path}: times is damaged: its checksum is wrong"),
        ("friction", 0, 3, "the array {path}: friction is damaged: its checksum is wrong"),
    ],
)
def test_one_flipped_bit_is_found_and_named(chain, tmp_path, capsys, member, row, place, words):
    path = flip(chain[0], tmp_path / "d.npz", member, 33 * row + place)
    assert main(["--verify", str(path)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line == f"RigidBodySimulation.py: {path}: {words.format(path=path)}"


def test_damaged_text_is_named_too(chain, tmp_path, capsys):
    path = flip(chain[0], tmp_path / "d.npz", "meshNames", 0)
    assert main(["--verify", str(path)]) == 2
    assert "the array meshNames is damaged: its checksum is wrong" in capsys.readouterr().err


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """A recording of three states of two bodies, of some 8 kB."""
    path = tmp_path_factory.mktemp("short") / "r.npz"
    return record(path, Simulation(DATA / "two_cylinder-scene.txt"), 2)


def test_verifying_looks_at_every_byte_of_the_file(short, tmp_path, capsys):
    """One bit of each byte of what stands between the arrays, and of every 20th byte of those."""
    content = short.read_bytes()
    assert Recording(short).damage() == ""
    with zipfile.ZipFile(short) as archive:
        inside = np.zeros(len(content), dtype=bool)
        for entry in archive.infolist():
            start = entry.header_offset + 30 + len(entry.filename) + 20
            inside[start : start + entry.file_size] = True
    rng = np.random.default_rng(20)
    places = [k for k in range(len(content)) if not inside[k] or k % 20 == 0]
    assert 2000 < len(places) < 6000 and not inside[-500:].any()
    found = {"refused": 0, "told": 0}
    bad = tmp_path / "bad.npz"
    for place in places:
        damaged = bytearray(content)
        damaged[place] ^= 1 << rng.integers(8)
        bad.write_bytes(damaged)
        try:
            assert Recording(bad, mustBeFinite=False).damage(), place
            found["told"] += 1
        except RecordingError as error:
            assert "\n" not in str(error)
            found["refused"] += 1
    assert min(found.values()) > 100
    # As a person sees it: the attributes of an entry, which no reader of zip files looks at.
    damaged = bytearray(content)
    damaged[content.rindex(b"PK\1\2") + 40] ^= 1
    bad.write_bytes(damaged)
    assert main(["--verify", str(bad)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "bad.npz is damaged: the archive's directory" in line
    bad.write_bytes(content + b"\0")
    assert main(["--verify", str(bad)]) in (1, 2)


@pytest.mark.parametrize("limit", [100, 3000])
def test_archives_as_large_as_zip_files_can_be_are_read_too(short, tmp_path, monkeypatch, limit):
    """Written as if 4 GB were that many bytes: lengths and places stand in other fields then."""
    monkeypatch.setattr(zipfile, "ZIP64_LIMIT", limit)
    path = record(tmp_path / "r.npz", Simulation(DATA / "two_cylinder-scene.txt"), 2)
    content = path.read_bytes()
    assert b"PK\6\6" in content and Recording(path).damage() == ""
    rng = np.random.default_rng(21)
    for place in range(content.index(b"PK\1\2"), len(content), 3):
        damaged = bytearray(content)
        damaged[place] ^= 1 << rng.integers(8)
        (tmp_path / "bad.npz").write_bytes(damaged)
        try:
            assert Recording(tmp_path / "bad.npz", mustBeFinite=False).damage(), place
        except RecordingError:
            pass


def test_verifying_names_the_first_step_that_another_run_differs_in(tmp_path, capsys):
    def push(simulation, step):
        if step == 12:
            simulation.meshes[3].linVelocity = np.nextafter(simulation.meshes[3].linVelocity, 1.0)

    path = record(tmp_path / "r.npz", Simulation(DATA / "tet-scene.txt"), 20, push)
    assert main(["--verify", str(path)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "r.npz: step 12 differs: linVelocities by up to " in line
    # A scene that has changed since differs from its start.
    simulation = Simulation(DATA / "tet-scene.txt")
    simulation.meshes[0].position = simulation.meshes[0].position + 1.0
    assert verify(Recording(path), simulation) == "step 0 differs: positions by up to 1"


# --------------------------------------------------------------------------------------------------
# Files that are none
# --------------------------------------------------------------------------------------------------


def rewritten(path, target, leaveOut=(), save=np.savez, **changes):
    """A copy of a recording with some of its arrays changed or left out."""
    with np.load(path) as file:
        arrays = {name: file[name] for name in file if name not in leaveOut} | changes
    with open(target, "wb") as out:
        save(out, **arrays)
    return target


def zip_bomb():
    """A few thousand bytes that announce, and unpack to, 64 MiB of positions."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        header = io.BytesIO()
        shape = {"descr": "<f8", "fortran_order": False, "shape": (1 << 23,)}
        np.lib.format.write_array_header_1_0(header, shape)
        archive.writestr("positions.npy", header.getvalue() + bytes(1 << 26))
    return content.getvalue()


def lying_header(path):
    """A recording whose first array announces 10¹⁵ rows."""
    content = path.read_bytes()
    lie = b"(999999999999999, 9, 3), }"
    header = b"(61, 9, 3), }".ljust(len(lie))
    assert header in content
    return content.replace(header, lie, 1)


def nan_at(series, step):
    series = series.copy()
    series[step, 2, 1] = math.nan
    return series


HOSTILE = {
    "missing": (lambda good, bad: None, "there is no such file"),
    "folder": (lambda good, bad: bad.mkdir(), "this is a folder, not a recording"),
    "empty": (lambda good, bad: bad.write_bytes(b""), "this is not a recording (File is not a zip"),
    "text": (lambda good, bad: bad.write_text("1\nbox.mesh"), "this is not a recording"),
    "garbage": (lambda good, bad: bad.write_bytes(np.random.default_rng(1).bytes(5000)),
                "this is not a recording"),
    "truncated": (lambda good, bad: bad.write_bytes(good.read_bytes()[:30_000]),
                  "this is not a recording (File is not a zip file)"),
    "another zip": (lambda good, bad: zipfile.ZipFile(bad, "w").writestr("a.txt", "hello"),
                    "this is not a recording"),
    "zip bomb": (lambda good, bad: bad.write_bytes(zip_bomb()), "its arrays are compressed"),
    "compressed": (lambda good, bad: rewritten(good, bad, save=np.savez_compressed),
                   "its arrays are compressed"),
    "announces too much": (lambda good, bad: bad.write_bytes(lying_header(good)),
                           "the array positions.npy is not as long as it announces"),
    "pickle": (lambda good, bad: rewritten(good, bad, times=np.array([{}] * 61, dtype=object)),
               "the array times.npy is of a kind that no recording holds"),
    "no velocities": (lambda good, bad: rewritten(good, bad, ["linVelocities"]),
                      "there is no array 'linVelocities' in it"),
    "no hashes": (lambda good, bad: rewritten(good, bad, ["hashes"]), "no array 'hashes' in it"),
    "older file": (lambda good, bad: rewritten(good, bad, ["firstStep", "format"]),
                   "there is no array 'firstStep' in it"),
    "shape": (lambda good, bad: rewritten(good, bad, orientations=np.zeros((61, 9, 3))),
              "the array orientations is of the shape (61, 9, 3) and the type float64, not of "
              "(61, 9, 4) and float64"),
    "type": (lambda good, bad: rewritten(good, bad, times=np.zeros(61, np.float32)),
             "the array times is of the shape (61,) and the type float32"),
    "fewer rows": (lambda good, bad: rewritten(good, bad, times=np.zeros(60)),
                   "not of (60, 9, 3) and float64"),
    "no row": (lambda good, bad: rewritten(good, bad, times=np.zeros(0)), "there is no state in"),
    "nan": (lambda good, bad: rewritten(
                good, bad, angVelocities=nan_at(np.load(good)["angVelocities"], 17)),
            "step 17: angVelocities holds numbers that are not finite"),
    "newer": (lambda good, bad: rewritten(good, bad, format=3), "a newer version of this program"),
    "history": (lambda good, bad: rewritten(good, bad, settingsHistory="[[0, 1]]"),
                "the history of its settings cannot be read"),
    "deep history": (lambda good, bad: rewritten(good, bad, settingsHistory="[" * 100_000),
                     "the history of its settings cannot be read"),
    "later history": (lambda good, bad: rewritten(good, bad, settingsHistory="[[3, {}]]"),
                      "the history of its settings does not start with its first step"),
    "unknown setting": (lambda good, bad: rewritten(
                            good, bad, settingsHistory='[[0, {"wind": 3}]]'),
                        "it has a setting that this version does not know: wind"),
    "senseless setting": (lambda good, bad: rewritten(
                              good, bad, settingsHistory='[[0, {"timeStep": -1}]]'),
                          ": the time step must be positive and finite, not -1"),
    "setting of a kind": (lambda good, bad: rewritten(
                              good, bad, settingsHistory='[[0, {"restitution": [1]}]]'),
                          ": its settings are not of the right kind"),
    "two lines": (lambda good, bad: rewritten(good, bad, scene="a\nb"),
                  "its file a b is not there any more; say with SCENE where it is"),
    "no text": (lambda good, bad: rewritten(good, bad, scene=np.array(["a", "b"])),
                "the array scene is not one text"),
    "endless time step": (lambda good, bad: rewritten(
                              good, bad, settingsHistory=f'[[0, {{"timeStep": {10**400}}}]]'),
                          ": its settings are not of the right kind"),
    "endless history": (lambda good, bad: rewritten(good, bad, settingsHistory="[[1e999, {}]]"),
                        "the history of its settings cannot be read"),
    "other bodies": (lambda good, bad: rewritten(good, bad, meshNames=np.array(["x"] * 9)),
                     "its body 'x' is called 'box 0'"),
}  # fmt: skip


@pytest.mark.parametrize("option", ["--replay", "--resume"])
@pytest.mark.parametrize("case", HOSTILE)
def test_file_that_is_no_recording_is_told_in_one_line(chain, tmp_path, capsys, case, option):
    make, words = HOSTILE[case]
    bad = tmp_path / "bad.npz"
    make(chain[0], bad)
    code = main(["--headless", "--steps", "2", option, str(bad)])
    output, errors = capsys.readouterr()
    assert (code, output) == (2, "")
    (line,) = errors.splitlines()
    assert line.startswith(f"RigidBodySimulation.py: {bad}: ") and words in line, line


def test_every_cut_of_a_file_is_told(chain, tmp_path):
    content = chain[0].read_bytes()
    bad = tmp_path / "bad.npz"
    for length in range(0, len(content), len(content) // 40):
        bad.write_bytes(content[:length])
        with pytest.raises(RecordingError, match="bad.npz: "):
            Recording(bad)


def test_no_flipped_byte_raises_anything_else(chain, tmp_path):
    # In the headers, where it may change what everything else means.
    content = chain[0].read_bytes()
    bad = tmp_path / "bad.npz"
    rng = np.random.default_rng(4)
    places = [*rng.integers(0, 200, 60), *rng.integers(len(content) - 8000, len(content), 200)]
    refused = 0
    for place in places:
        damaged = bytearray(content)
        damaged[place] ^= 1 << rng.integers(8)
        bad.write_bytes(damaged)
        try:
            Recording(bad)
        except RecordingError as error:
            assert "\n" not in str(error)
            refused += 1
    assert 50 < refused < 260


def test_chunk_that_is_missing_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(rbs.recording, "CHUNK_SECONDS", 0.0)
    monkeypatch.setattr(rbs.recording, "CHUNK_SHARE", 0.0)
    simulation = Simulation(DATA / "tet-scene.txt")
    recorder = Recorder(tmp_path / "r.npz")
    for _ in range(4):
        recorder.add(simulation)
        simulation.step()
    assert recorder.close() == tmp_path / "r.npz.part"
    assert Recording(tmp_path / "r.npz").lastStep == 3
    (tmp_path / "r.npz.part" / "chunk_000002.npz").unlink()
    with pytest.raises(RecordingError, match="chunk_000003.npz: the states from step 2 on are mis"):
        Recording(tmp_path / "r.npz")


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


def test_interrupted_statistics_are_kept(tmp_path):
    (tmp_path / "s.csv").write_text("older")
    simulation = Simulation(DATA / "tet-scene.txt")
    writer = StatsWriter(tmp_path / "s.csv")
    writer.add(simulation)
    # Already on the disk, should the program be killed now.
    assert len(table_of(tmp_path / "s.csv.part")["step"]) == 1
    assert writer.close() == tmp_path / "s.csv.part"
    assert (tmp_path / "s.csv").read_text() == "older"
    assert StatsWriter(tmp_path / "t.csv").close() is None
    assert not (tmp_path / "t.csv.part").exists()


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
        "RigidBodySimulation.py: --plot needs matplotlib. Install it: pip install matplotlib\n"
    )
    assert [path.name for path in tmp_path.iterdir()] == ["fakes"]


# --------------------------------------------------------------------------------------------------
# Command line
# --------------------------------------------------------------------------------------------------

CONFLICTING = {
    "replay and record": (["--replay", "r", "--record", "s"], "--record does not go with --replay"),
    "replay and resume": (["--replay", "r", "--resume", "s"], "not allowed with argument --replay"),
    "replay and friction": (["--replay", "r", "--friction", "0"],
                            "--friction does not go with --replay: a replay simulates nothing"),
    "verify and steps": (["--verify", "r", "--steps", "9"], "--steps does not go with --verify"),
    "verify and stats": (["--verify", "r", "--stats", "s"], "--stats does not go with --verify"),
    "from alone": (["--from", "3"], "--from says where --resume starts, which is missing"),
    "from and replay": (["--replay", "r", "--from", "3"], "--from says where --resume starts"),
    "resume and record": (["--resume", "./r", "--record", "r"],
                          "--record and --resume name the same file"),
    "stats and plot": (["--stats", "s", "--plot", "s"], "--plot and --stats name the same file"),
    "replay of here": (["--headless", "--replay", "."], ".: this is a folder, not a recording"),
    "verify of nothing": (["--verify", "."], ".: this is a folder, not a recording"),
    "negative from": (["--resume", "r", "--from", "-1"], "--from: must be 0 or more, not -1"),
    "stats to nowhere": (["--stats", "no/s.csv"], "no/s.csv: No such file or directory"),
    "stats to a folder": (["--stats", "."], ".: this is a folder, not a file"),
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


def test_reading_and_writing_needs_neither_driver_nor_polyscope():
    program = (
        "import sys, rbs.recording, rbs.replay, rbs.statistics; "
        "unwanted = {'polyscope', 'RigidBodySimulation', 'rbs.scenes', 'rbs.viewer'}; "
        "sys.exit(bool(unwanted & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", program], cwd=ROOT).returncode == 0
