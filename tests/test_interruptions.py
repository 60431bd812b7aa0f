"""Signals at any time, and standard error that takes nothing: what a run has is never lost."""

import os
import signal
import subprocess
import sys
import time

import pytest
from oracles import ROOT
from program import PROGRAM, environment, run

from rbs.recording import Recording

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals and shells are Unix's here")

# Sends itself signals at the n-th call of a function, before it does anything. Every state is a
# chunk by itself.
SIGNALLED = """
import importlib, os, signal, sys
import rbs.recording
rbs.recording.CHUNK_SECONDS = rbs.recording.CHUNK_SHARE = 0.0
rbs.recording.JOIN_PATIENCE = float(sys.argv[4])
module, function = sys.argv[1].rsplit(".", 1)
count, numbers = int(sys.argv[2]), sys.argv[3].split()
module = importlib.import_module(module)
real, calls = getattr(module, function), 0
def signalling(*arguments, **options):
    global calls
    calls += 1
    if calls == count:
        for number in numbers:
            os.kill(os.getpid(), int(number))
    return real(*arguments, **options)
setattr(module, function, signalling)
import RigidBodySimulation
sys.argv[1:] = sys.argv[5:]
getattr(RigidBodySimulation, "command", lambda: sys.exit(RigidBodySimulation.main()))()
"""
RECORD = ["tet", "--steps", "6", "--record", "r.npz"]
# Of seven chunks, each is brought to the disk, renamed, and removed; the whole file follows them.
CHUNKS = 7


def signalled(folder, function, count, numbers, arguments=RECORD, patience=1000.0):
    numbers = " ".join(str(int(number)) for number in numbers)
    return subprocess.run(
        [sys.executable, "-c", SIGNALLED, function, str(count), numbers, str(patience),
         *arguments],
        cwd=folder, env=environment(PYTHONPATH=str(ROOT)), capture_output=True, text=True,
        timeout=120,
    )  # fmt: skip


def assert_whole(path):
    recording = Recording(path)
    assert not recording.wasInterrupted and recording.damage() == ""
    assert (recording.firstStep, recording.lastStep) == (0, 6)


@pytest.fixture(scope="module")
def arrays(tmp_path_factory):
    """How many arrays a recording's file has, and each of its chunks."""
    folder = tmp_path_factory.mktemp("arrays")
    assert run(folder, *RECORD).returncode == 0
    return len(Recording(folder / "r.npz").files[0].names())


@pytest.mark.parametrize("numbers", [[signal.SIGINT] * 3, [signal.SIGTERM], [signal.SIGHUP] * 2])
@pytest.mark.parametrize(
    ("function", "count"),
    [
        ("rbs.recordingfiles._write_member", None),
        ("os.fsync", 2 * CHUNKS + 1),
        ("os.replace", CHUNKS + 1),
        ("os.unlink", 3),
        ("os.rmdir", 1),
    ],
)
def test_signals_while_a_recording_is_saved_do_it_no_harm(
    tmp_path, arrays, function, count, numbers
):
    count = count or CHUNKS * arrays + 3  # of the whole file, the third array
    process = signalled(tmp_path, function, count, numbers)
    assert process.returncode == 0 and process.stderr == "", process.stderr
    assert "steps             6 of 0.02 s" in process.stdout
    assert [path.name for path in tmp_path.iterdir()] == ["r.npz"]
    assert_whole(tmp_path / "r.npz")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_long_saving_can_be_left_to_finish(tmp_path, arrays, number):
    arguments = ["rbs.recordingfiles._write_member", CHUNKS * arrays + 3, [number, number]]
    process = signalled(tmp_path, *arguments, patience=0.0)
    called = {"SIGINT": "Ctrl-C", "SIGTERM": "kill", "SIGHUP": "a hang-up"}[number.name]
    assert process.returncode == 128 + number and process.stdout == ""
    assert process.stderr == (
        f"RigidBodySimulation.py: stopped by {called}; what there is of the run is in r.npz.part\n"
    )
    assert [path.name for path in tmp_path.iterdir()] == ["r.npz.part"]
    process = signalled(tmp_path, arguments[0], 3, [number], ["--finish", "r.npz"], 0.0)
    assert process.returncode == 128 + number
    assert process.stderr == f"RigidBodySimulation.py: stopped by {called}\n"
    assert not (tmp_path / "r.npz").exists()
    assert run(tmp_path, "--finish", "r.npz").returncode == 0
    assert [path.name for path in tmp_path.iterdir()] == ["r.npz"]
    assert_whole(tmp_path / "r.npz")


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_kill_ends_a_run_as_ctrl_c_does(tmp_path, number, code):
    command = [sys.executable, PROGRAM, "tower", "--steps", "1000000", "--record", "r.npz",
               "--stats", "s.csv"]  # fmt: skip
    process = subprocess.Popen(
        command, cwd=tmp_path, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True,
    )  # fmt: skip
    end = time.monotonic() + 60
    while not list(tmp_path.glob("r.npz.part/chunk_*")) and time.monotonic() < end:
        time.sleep(0.02)
    process.send_signal(number)
    output, _ = process.communicate(timeout=60)
    assert process.returncode == code and ", stopped by " in output
    assert sorted(path.name for path in tmp_path.iterdir()) == ["r.npz", "s.csv"]
    last = Recording(tmp_path / "r.npz").lastStep
    assert last > 0 and len((tmp_path / "s.csv").read_text().splitlines()) == last + 2


def test_a_hang_up_that_is_ignored_stays_so(tmp_path):
    command = f"trap '' HUP; exec '{sys.executable}' '{PROGRAM}' tower --steps 400 --record r.npz"
    process = subprocess.Popen(["sh", "-c", command], cwd=tmp_path, env=environment(),
                               stdout=subprocess.PIPE, text=True)  # fmt: skip
    while not (tmp_path / "r.npz.part").exists() and process.poll() is None:
        time.sleep(0.01)
    process.send_signal(signal.SIGHUP)
    output, _ = process.communicate(timeout=60)
    assert process.returncode == 0 and "steps             400 of" in output


# What is removed after the whole file has been made: the chunks, and what they were joined in.
@pytest.mark.parametrize("count", [1, 2, 4, CHUNKS])
def test_a_run_that_is_killed_while_it_removes_the_chunks_can_be_finished(tmp_path, count):
    process = signalled(tmp_path, "os.unlink", count, [signal.SIGKILL])
    assert process.returncode == -signal.SIGKILL
    assert sorted(path.name for path in tmp_path.iterdir()) == ["r.npz", "r.npz.part"]
    content = (tmp_path / "r.npz").read_bytes()
    process = run(tmp_path, "--finish", "r.npz")
    assert process.returncode == 0, process.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["r.npz"]
    assert (tmp_path / "r.npz").read_bytes() == content
    assert_whole(tmp_path / "r.npz")


@pytest.mark.parametrize("left", [[], ["chunk_000000.tmp"]])
def test_the_folder_of_a_run_without_a_chunk_is_finished_too(tmp_path, left):
    (tmp_path / "r.npz.part").mkdir()
    for name in left:
        (tmp_path / "r.npz.part" / name).write_bytes(b"PK")
    process = run(tmp_path, "--finish", "r.npz")
    assert process.returncode == 0 and process.stderr == ""
    assert process.stdout.startswith("r.npz: the run had ended before anything was recorded")
    assert list(tmp_path.iterdir()) == []
    # What is somebody else's is left where it is.
    (tmp_path / "r.npz.part").mkdir()
    (tmp_path / "r.npz.part" / "letter.txt").write_text("dear")
    process = run(tmp_path, "--finish", "r.npz")
    assert process.returncode == 2 and "this is a folder, not a recording" in process.stderr
    assert (tmp_path / "r.npz.part" / "letter.txt").read_text() == "dear"


# --------------------------------------------------------------------------------------------------
# Standard error that is closed or broken
# --------------------------------------------------------------------------------------------------

# A tetrahedron on another, whose tip is so far aside that the two are not convex.
DENTED = """MeshVersionFormatted 1
Dimension 3
Vertices
5
0 0 0 0
4 0 0 0
0 4 0 0
1 1 4 0
9 9 -3 0
Triangles
6
1 2 4 0
2 3 4 0
3 1 4 0
1 2 5 0
2 3 5 0
3 1 5 0
Tetrahedra
2
1 2 3 4 0
1 2 3 5 0
End
"""
# Shows its progress at every step, as it does in a terminal.
BUSY = """
import sys
from rbs import headless
headless.LOG_SECONDS = headless.TERMINAL_SECONDS = 1e-9
import RigidBodySimulation
getattr(RigidBodySimulation, "command", lambda: sys.exit(RigidBodySimulation.main()))()
"""
BROKEN = {
    "closed": "{} 2>&-",
    "full": "{} 2>/dev/full",
    "reader gone": "{{ sleep 3; {}; echo $? >code; }} 2>&1 >/dev/null | true; while ! [ -s code ]; "
    "do sleep 0.1; done; exit $(cat code)",
    "all closed": "{} 2>&- >&- <&-",
}


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full here")
@pytest.mark.parametrize("case", BROKEN)
@pytest.mark.parametrize("mesh", ["dented", "convex"])
def test_standard_error_ends_no_run(tmp_path, case, mesh):
    (tmp_path / "dented.mesh").write_text(DENTED)
    (tmp_path / "convex.mesh").write_bytes((ROOT / "data" / "box.mesh").read_bytes())
    (tmp_path / "a-scene.txt").write_text(f"1\n{mesh}.mesh 1 0 0 30 0 1 0 0 0\n")
    (tmp_path / "busy.py").write_text(BUSY)
    program = f"'{sys.executable}' busy.py a-scene.txt --steps 40 --record r.npz --stats s.csv"
    process = subprocess.run(
        ["sh", "-c", BROKEN[case].format(program)], cwd=tmp_path, capture_output=True, text=True,
        env=environment(PYTHONPATH=str(ROOT)), timeout=120,
    )  # fmt: skip
    assert process.returncode == 0, process.stderr
    assert Recording(tmp_path / "r.npz").lastStep == 40
    assert Recording(tmp_path / "r.npz").damage() == ""
    table = (tmp_path / "s.csv").read_text().splitlines()
    assert len(table) == 42 and all(row.count(",") == table[0].count(",") for row in table)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full here")
@pytest.mark.parametrize("redirection", ["2>&-", "2>/dev/full"])
def test_an_error_that_cannot_be_told_has_its_exit_code(tmp_path, redirection):
    for arguments in ("nosuch --headless", "--steps many"):
        command = f"'{sys.executable}' '{PROGRAM}' {arguments} {redirection}"
        process = subprocess.run(
            ["sh", "-c", command], cwd=tmp_path, capture_output=True, text=True,
            env=environment(), timeout=120,
        )  # fmt: skip
        assert (process.returncode, process.stdout, process.stderr) == (2, "", "")
