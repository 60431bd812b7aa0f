"""Recordings that version 0.1.0 wrote, read by this one.

`fixtures/recorded-0.1.0.npz` holds 40 steps of the cube with its constraints and friction 0.3;
`fixtures/recorded-coloured-0.1.0.npz` 10 steps of two_cylinder, with the pairs of a step in another
order, which there is no more. Both name the field pairOrder in their settings.
"""

import hashlib
import json
import shutil

import numpy as np
import pytest
from oracles import ROOT
from program import DATA, run, summary_of

from rbs.opening import load_recorded_scene
from rbs.recording import Recording
from rbs.replay import Replay, restored_settings
from rbs.simulation import Settings
from rbs.state import hash_of

OLD = ROOT / "tests" / "fixtures" / "recorded-0.1.0.npz"
COLOURED = ROOT / "tests" / "fixtures" / "recorded-coloured-0.1.0.npz"
REFUSAL = (
    "step 0: it was recorded with another version, whose pair order 'coloured' has been taken out: "
    "it can be replayed only"
)
# What `numpy_bits` gave where the recordings were made.
RECORDED_BITS = "4c770631e244e535f82bc4c605055a2a"


def numpy_bits():
    """A hash of what NumPy computes here in the functions whose last bits depend on the machine.

    A step takes sines and cosines of as many angles as there are bodies; a mesh has its inertia
    tensor inverted.
    """
    angles = np.linspace(0.0, 3.0, 1000)
    matrices = np.cos(np.arange(900.0)).reshape(100, 3, 3) + 3.0 * np.eye(3)
    results = [np.sin(angles), np.cos(angles), np.linalg.inv(matrices)]
    results += [f(angles[k : k + 8]) for k in range(0, 1000, 8) for f in (np.sin, np.cos)]
    results += [np.linalg.inv(matrix) for matrix in matrices]
    return hashlib.blake2b(b"".join(a.tobytes() for a in results), digest_size=16).hexdigest()


def pair_order(recording):
    return [fields["pairOrder"] for _, fields in recording.settingsHistory]


def test_the_recordings_are_what_they_are_said_to_be():
    assert pair_order(Recording(OLD)) == ["sequential"]
    assert pair_order(Recording(COLOURED)) == ["coloured"]
    for path in (OLD, COLOURED):
        assert path.stat().st_size < 100_000 and Recording(path).version == "0.1.0"
        assert Recording(path).damage() == ""


@pytest.mark.parametrize(("path", "steps"), [(OLD, 40), (COLOURED, 10)])
def test_an_old_recording_is_replayed(tmp_path, path, steps):
    summary = summary_of(run(tmp_path, "--replay", path, "--headless"))
    assert summary["steps"].startswith(f"{steps} of 0.02 s")
    assert summary["time per step"] == "a recording"
    recording = Recording(path)
    replay = Replay(recording, load_recorded_scene(recording))
    for step in (steps, 0, steps // 2):
        replay.seek(step)
        assert np.array_equal(hash_of(replay.state()), recording.frame(step)["hashes"])


def test_an_old_recording_is_verified(tmp_path):
    process = run(tmp_path, "--verify", OLD)
    if numpy_bits() == RECORDED_BITS or process.returncode == 0:
        assert process.returncode == 0, process.stderr
        assert process.stdout == f"{OLD}: the steps 0 to 40 are the same\n"
        return
    # Nothing else may be wrong with it, and what differs may differ by rounding only.
    assert process.returncode == 1 and "differs: " in process.stderr, process.stderr
    assert float(process.stderr.split(" by up to ")[1].split()[0]) < 1e-9
    pytest.skip("NumPy's sines, cosines or inverses have other last bits on this machine")


def test_an_old_recording_is_resumed(tmp_path):
    process = run(tmp_path, "--resume", OLD, "--from", 30, "--steps", 10, "--record", "on.npz")
    assert summary_of(process)["steps"].startswith("40 of 0.02 s")
    resumed, old = Recording(tmp_path / "on.npz"), Recording(OLD)
    (step, fields), = resumed.settingsHistory
    assert step == 30 and "pairOrder" not in fields and fields["friction"] == 0.3
    np.testing.assert_allclose(
        resumed.frame(40)["positions"], old.frame(40)["positions"], rtol=0, atol=1e-9
    )


@pytest.mark.parametrize("mode", ["--verify", "--resume"])
def test_an_order_that_was_taken_out_is_refused_in_one_line(tmp_path, mode):
    process = run(tmp_path, mode, COLOURED, "--headless")
    assert process.returncode == 2 and process.stdout == ""
    assert process.stderr == f"RigidBodySimulation.py: {COLOURED}: {REFUSAL}\n"


def with_order(source, target, order):
    """Copies a recording, with this pair order in its settings."""
    with np.load(source) as arrays:
        arrays = dict(arrays)
    history = json.loads(str(arrays["settingsHistory"]))
    history[-1][1]["pairOrder"] = order
    np.savez(target, **arrays | {"settingsHistory": np.array(json.dumps(history))})


@pytest.mark.parametrize("order", ["", "x" * 1000, "two\nlines", 7, None, ["sequential"]])
def test_an_order_that_never_was_is_refused_in_one_line(tmp_path, order):
    with_order(OLD, tmp_path / "r.npz", order)
    process = run(tmp_path, "--verify", "r.npz")
    assert process.returncode == 2 and process.stderr.count("\n") == 1
    assert process.stderr.startswith("RigidBodySimulation.py: r.npz: step 0: it was recorded with")
    assert len(process.stderr) < 300


def test_an_interrupted_old_recording_becomes_one_file(tmp_path):
    part = tmp_path / "r.npz.part"
    part.mkdir()
    shutil.copy(OLD, part / "chunk_000000.npz")
    process = run(tmp_path, "--finish", "r.npz")
    assert process.returncode == 0 and "the steps 0 to 40" in process.stdout
    with np.load(OLD) as old, np.load(tmp_path / "r.npz") as new:
        assert set(old) == set(new)
        for name in old:
            assert np.array_equal(old[name], new[name]), name


def test_settings_of_an_old_recording_are_what_they_were():
    settings = restored_settings(Recording(OLD), 40, Settings(maxIterations=5))
    assert settings == Settings(friction=0.3)
    assert not hasattr(settings, "pairOrder")
    assert (DATA / "cube-scene.txt").is_file()  # where the recording looks for its scene
