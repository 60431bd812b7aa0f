"""Recordings: what they hold, replaying, resuming and verifying them, damage; statistics."""

import csv
import re
import shutil
import signal

import h5py
import numpy as np
import pytest
from oracles import box_body
from program import DATA, bits, call, record, start, wait_for

from rbs.recordings.outputs import QUANTITY_UNITS, step_quantities
from rbs.recordings.recording import Recording, RecordingError
from rbs.recordings.replay import verify
from rbs.scenes.simulation import SceneSimulation, Settings
from RigidBodySimulation import Simulation


@pytest.mark.parametrize("solver", ["impulse", "soft-step"])
def test_contacts_of_a_recorded_step_are_those_of_its_report(tmp_path, solver):
    simulation = Simulation("tower", Settings(contactSolver=solver))
    with simulation.record(tmp_path / "r.h5"):
        contacts = [[], *(simulation.run(1).report.contacts for _ in range(80))]
    assert sum(map(len, contacts)) > 10
    opened = Simulation.open(tmp_path / "r.h5")
    for step in (0, 1, 10, 69, 80, 70):
        opened.seek(step)
        assert opened.contacts() == contacts[step] and opened.reportError == ""
    assert opened.stats(99)["step"].tolist() == list(range(70, 81))


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    """The path of a recording of 60 steps: tied bodies, and settings that change."""

    def change(simulation, step):
        if step == 31:
            simulation.settings.friction = 0.5

    simulation = SceneSimulation(DATA / "tower_chain-scene.txt")
    return record(tmp_path_factory.mktemp("chain") / "chain.h5", simulation, 60, change)


@pytest.mark.parametrize(("solver", "steps"), [("impulse", 60), ("soft-step", 20)])
def test_round_trip_without_the_scene(tmp_path, monkeypatch, capsys, solver, steps):
    home, away = tmp_path / "home", tmp_path / "à côté de"
    home.mkdir(), away.mkdir()
    for path in (*DATA.glob("*.mesh"), *DATA.glob("tower_chain-*")):
        shutil.copy(path, home)
    monkeypatch.chdir(away)
    settings = ["--friction", "0.3", "--restitution", "0.7", "--solver", solver]
    scene = home / "tower_chain-scene.txt"
    (away / "ß r.h5").write_text("an older one")
    assert call(capsys, scene, "--steps", steps, "--record", "ß r.h5", *settings)[0] == 0
    shutil.rmtree(home)
    code, output, _ = call(capsys, "--headless", "--replay", "ß r.h5")
    assert code == 0 and f"{steps} of 0.02 s" in output and "16 bounds" in output
    code, output, _ = call(capsys, "--verify", "ß r.h5")
    assert code == 0 and output.startswith(f"ß r.h5: steps 0–{steps} are identical")
    rest = ["--from", steps // 2, "--steps", steps // 2, "--record", "rest.h5"]
    assert call(capsys, "--resume", "ß r.h5", *rest)[0] == 0
    expected, resumed = Recording("ß r.h5"), Recording("rest.h5")
    assert (resumed.firstStep, resumed.lastStep) == (steps // 2, steps)
    for step in range(steps // 2, steps + 1):
        assert bits(expected.frame(step)) == bits(resumed.frame(step))
    assert resumed.settings_at(steps)[1] == expected.settings_at(steps)[1]
    assert call(capsys, "--verify", "rest.h5")[0] == 0


def edited(path, target, edit):
    shutil.copy(path, target)
    with h5py.File(target, "r+") as file:
        edit(file)
    return target


def put(name, place, value):
    def edit(file):
        (file["settings"].attrs if name == "settings" else file[name])[place] = value

    return edit


def edit_solver_state(file):
    content = file["solverStates"][()].tobytes().replace(b"sleep.", b"sleet.")
    file["solverStates"][...] = np.frombuffer(content, np.uint8)


def edit_origin(**attributes):
    def edit(file):
        file["positions"][33, 4, 1] = 3.5
        file.attrs.update(attributes)

    return edit


OTHER = f"with NumPy 0.1, now NumPy {np.__version__}[)]"
EDITS = {
    "a position": (put("positions", (33, 4, 1), 3.5), "step 33 differs: positions by up to "),
    "the sign of a zero": (put("angVelocities", (0, 0, 0), -0.0), "step 0 differs: angVelocities"),
    "NumPy": (edit_origin(numpyVersion="0.1"), f"step 33 .* [(]recorded {OTHER}$"),
    "the program": (edit_origin(code="0"), "step 33 .* [(]recorded by another version of the pro"),
    "no number": (put("positions", (33, 4, 1), np.nan), "it is damaged .positions must be"),
    "the scene": (put("scene", 0, b"?"), "it is damaged"),
    "a body": (put("meshes/0/tets", (0, 0), 99), "it is damaged"),
    "no state": (lambda file: file["times"].resize(0, axis=0), "it has no states"),
    "a setting": (put("settings", "friction", -1.0), "step 0: friction must be "),
    "one that is gone": (put("settings", "closingOnly", True), "step 0: Settings.__init__"),
    "its default": (put("settings", "closingOnly", False), ""),
}


@pytest.mark.parametrize("case", EDITS)
def test_what_was_changed_in_a_recording_is_found(chain, tmp_path, capsys, case):
    edit, cause = EDITS[case]
    path = edited(chain, tmp_path / "d.h5", edit)
    code, _, errors = call(capsys, "--verify", path)
    assert errors.count("\n") == bool(cause)
    assert code == (1 if case in list(EDITS)[:4] else 2 if cause else 0)
    assert not cause or re.match(f"RigidBodySimulation.py: {path}: {cause}", errors)


def test_resuming_takes_settings_and_needs_a_sound_step(chain, tmp_path, capsys):
    rest = tmp_path / "rest.h5"
    options = ["--restitution", "0.25", "--no-constraints", "--steps", "2", "--record", rest]
    assert call(capsys, "--resume", chain, *options)[0] == 0
    expected = Recording(chain).settings_at(60)[1] | {"restitution": 0.25, "friction": 0.5}
    expected["enforceConstraints"] = False
    assert Recording(rest).settings_at(62) == (60, expected)
    assert [Simulation.resume(chain, k).settings.friction for k in (29, 30)] == [0.0, 0.5]
    soft = SceneSimulation(DATA / "tower-scene.txt", Settings(contactSolver="soft-step"))
    path = record(tmp_path / "soft.h5", soft, 12)
    bad = edited(path, tmp_path / "d.h5", put("positions", (9, 4, 1), 3.5))
    other = edited(path, tmp_path / "e.h5", edit_solver_state)
    for path, step, cause in (
        (chain, 61, "is not recorded"),
        (bad, 9, "cannot be resumed"),
        (other, 12, "cannot be resumed: its solver state has another form"),
    ):
        code, _, errors = call(capsys, "--headless", "--resume", path, "--from", step)
        assert code == 2 and f"{path}: step {step} {cause}" in errors and errors.count("\n") == 1


def test_damaged_bytes_are_told_in_one_line(chain, tmp_path, capsys):
    content, path = chain.read_bytes(), tmp_path / "d.h5"
    place = content.index(Recording(chain).frame(33)["positions"].tobytes())
    places = [place, place + 13, *np.random.default_rng(3).integers(len(content), size=12).tolist()]
    ends = [int(share * len(content)) for share in (0.0, 0.01, 0.3, 0.9, 0.999)]
    damaged = [content[:at] + bytes([content[at] ^ 16]) + content[at + 1 :] for at in places]
    codes = []
    for bad in damaged + [content[:end] for end in ends]:
        path.write_bytes(bad)
        code, _, errors = call(capsys, "--verify", path)
        assert (code, errors.count("\n")) in ((0, 0), (2, 1)), errors
        assert not code or "it is damaged (" in errors or "not a recording" in errors
        codes.append(code)
    assert 0 not in codes[:2] + codes[-5:] and codes.count(0) < 8  # the others are in no use


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_signal_leaves_what_was_simulated(tmp_path, number):
    process = start(tmp_path, "singlebox", "--steps", 10**7, "--record", "r.h5", "--stats", "s.csv")
    table = tmp_path / "s.part.csv"

    def steps_kept():
        """So far on the disk: of a recording, all but the last half second."""
        try:
            if number != signal.SIGKILL:
                return table.read_text().count("\n") - 2  # less the header, and the start
            with Recording(tmp_path / "r.h5") as growing:
                return growing.lastStep
        except (OSError, RecordingError):  # it is tried out, and then begun
            return 0

    count = wait_for(lambda: (count := steps_kept()) > 20 and count, lambda: process.poll() is None)
    process.send_signal(number)
    output, errors = process.communicate(timeout=600)
    recording = Recording(tmp_path / "r.h5")
    assert verify(recording) == ""
    if number == signal.SIGKILL:
        with h5py.File(tmp_path / "r.h5", swmr=True) as file:  # as README says
            assert len(file["times"]) == recording.lastStep + 1 > count and table.exists()
    else:
        assert process.returncode == 128 + number
        assert "stopped by kill" in output and "Traceback" not in errors
        steps = table_of(tmp_path / "s.csv")["step"]
        assert len(steps) > count and steps[-1] == str(recording.lastStep)


def table_of(path):
    """The columns of a .csv file, dict of lists of str."""
    with open(path, encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    return {name: list(column) for name, *column in zip(*rows, strict=True)}


def test_statistics_are_those_of_an_independent_computation(tmp_path, capsys):
    options = ["--restitution", "0.8", "--time-step", "0.04", "--steps", "100"]
    assert call(capsys, "stress", *options, "--stats", tmp_path / "s.csv")[0] == 0
    table = table_of(tmp_path / "s.csv")
    units = [f"{name} ({unit})" if unit else name for name, unit in QUANTITY_UNITS.items()]
    assert list(table) == ["step", *units] and len(table["step"]) == 101
    assert table["contacts"][0] == table["collisionsTime (ms)"][0] == ""
    simulation, contacts = Simulation("stress", Settings(restitution=0.8, timeStep=0.04)), 0
    for step in range(101):
        got = {name: float(column[step]) for name, column in table.items() if column[step]}
        if step > 0:
            simulation.step()
            depths = [contact.depth for contact in simulation.report.contacts]
            contacts += len(depths)
            assert got["contacts"] == len(depths) and got["collisionsTime (ms)"] > 0.0
            assert got["deepestPenetration (m)"] == max(depths, default=0.0)
            assert got["candidatePairs"] == simulation.report.candidatePairs
            took = step_quantities(simulation)["collisionsTime"]
            assert took == 1e3 * simulation.report.seconds["collisions"]
        kinetic, potential, p, L = 0.0, 0.0, np.zeros(3), np.zeros(3)
        for mesh in (mesh for mesh in simulation.meshes if not mesh.isFixed):
            v, w = mesh.linVelocity[0], mesh.angVelocity[0]
            inertia = np.linalg.inv(mesh.get_rotated_inv_IT())
            kinetic += 0.5 * mesh.mass * v @ v + 0.5 * w @ inertia @ w
            potential += mesh.mass * 9.8 * mesh.position[0, 1]
            p += mesh.mass * v
            L += np.cross(mesh.position[0], mesh.mass * v) + inertia @ w
        assert got["time (s)"] == simulation.time
        energies = [got[f"{name}Energy (J)"] for name in ("kinetic", "potential", "total")]
        assert energies == pytest.approx([kinetic, potential, kinetic + potential], rel=1e-12)
        for name, unit, expected in (("momentum", "kg m/s", p), ("angularMomentum", "kg m²/s", L)):
            found = [got[f"{name}{axis} ({unit})"] for axis in "XYZ"]
            np.testing.assert_allclose(found, expected, 1e-11, 1e-11 * (1 + np.abs(expected).max()))
    assert contacts > 20
    rows = [[0, 0, 1, 0, 3.5, False], [0, 0, 1, 0, 2.9, True]]  # the distance is 3
    pair = Simulation.from_meshes([box_body(1, 1, 1, (x, 9, 0)) for x in (0, 3)], rows)
    assert pair.largest_violation() == pytest.approx(0.5)
