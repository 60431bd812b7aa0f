"""Full disks, folders that cannot be written to, and kill -9.

Whatever ends a run, a file of the given name is the old one, or a new one that is whole; and the
program, where it lives, says what happened in one line.

A disk is filled by a small file system in memory where tests may mount one, and by a limit on the
size of a file otherwise; both are tested where both can be.
"""

import csv
import os
import shutil
import signal
import subprocess
import sys
import tracemalloc

import numpy as np
import pytest
from opengl import require_opengl
from oracles import ROOT
from PIL import Image
from program import DATA, environment, run

import rbs.recording
from rbs.cameras import load_camera
from rbs.files import atomic_write, partial_path
from rbs.recording import Recorder, Recording, finish
from rbs.recordingfiles import RecordingError
from rbs.simulation import Simulation
from rbs.statistics import StatsWriter
from RigidBodySimulation import main

onLinux = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="file systems and limits are Linux's here"
)
pytestmark = onLinux

OLD = b"an older file"


# --------------------------------------------------------------------------------------------------
# Disks that are full, folders that are read only
# --------------------------------------------------------------------------------------------------


@pytest.fixture
def mount(tmp_path):
    """A function of a size in kB that mounts a file system in memory; returns its folder."""
    folder = tmp_path / "disk"
    folder.mkdir()

    def mount(kilobytes):
        command = ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", str(folder)]
        try:
            process = subprocess.run(command, capture_output=True, text=True)
        except OSError as error:
            pytest.skip(f"nothing can be mounted here: {error}")
        if process.returncode != 0:
            pytest.skip(f"nothing can be mounted here: {process.stderr.strip()}")
        return folder

    yield mount
    if os.path.ismount(folder):
        subprocess.run(["umount", "-l", str(folder)], check=True)


def run_with_short_files(folder, kilobytes, *arguments):
    """Runs the program with no file getting longer than so many kB."""
    import resource

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (kilobytes << 10, kilobytes << 10))

    return subprocess.run(
        [sys.executable, "-B", ROOT / "RigidBodySimulation.py", *map(str, arguments)],
        cwd=folder, env=environment(), capture_output=True, text=True, timeout=120,
        preexec_fn=limit,
    )  # fmt: skip


FULL, TOO_LONG = "No space left on device", "File too large"
DRAWN = ["--size", "640x480"]
# case: (arguments, the file, the kB that are too few, whether it takes OpenGL, a part that is kept)
OUTPUTS = {
    "recording": (["stress", "--steps", "100", "--record", "o.npz"], "o.npz", 128, False, None),
    "statistics": (["tet", "--steps", "400", "--stats", "o.csv"], "o.csv", 64, False,
                   "o.csv.part"),
    "plot": (["tet", "--steps", "20", "--plot", "o.png"], "o.png", 32, False, None),
    "picture": (["tet", "--steps", "0", "--screenshots", ".", *DRAWN], "frame_000000.png", 12,
                True, None),
    "mp4": (["tet", "--steps", "60", "--video", "o.mp4", *DRAWN], "o.mp4", 12, True, None),
    "gif": (["tet", "--steps", "30", "--video", "o.gif", *DRAWN], "o.gif", 12, True, None),
}  # fmt: skip


def require(case, drawn):
    if drawn:
        require_opengl()
    if case in ("mp4", "gif"):
        pytest.importorskip("imageio_ffmpeg", reason="pip install imageio-ffmpeg")
    if case == "plot":
        pytest.importorskip("matplotlib", reason="pip install matplotlib")


# What starts neither Polyscope nor matplotlib is quick: all four.
QUICK = [(way, isOld) for way in ("full disk", "limited file") for isOld in (False, True)]
WAYS = {
    "recording": QUICK, "statistics": QUICK, "plot": QUICK[1:3], "picture": QUICK[1:3],
    "mp4": QUICK[1:2], "gif": QUICK[1:3],
}  # fmt: skip


@pytest.mark.parametrize(
    ("case", "way", "isOld"), [(case, *way) for case, ways in WAYS.items() for way in ways]
)
def test_full_disk(tmp_path, mount, case, way, isOld):
    arguments, name, kilobytes, drawn, kept = OUTPUTS[case]
    require(case, drawn)
    folder = mount(kilobytes) if way == "full disk" else tmp_path
    if isOld:
        (folder / name).write_bytes(OLD)
    if way == "full disk":
        process = run(folder, *arguments, PYTHONDONTWRITEBYTECODE="1")
    else:
        process = run_with_short_files(folder, kilobytes, *arguments)
    assert (process.returncode, process.stdout) == (2, ""), process.stderr
    (line,) = process.stderr.splitlines()
    cause = FULL if way == "full disk" else TOO_LONG
    if case in ("mp4", "gif"):
        cause = f"the video is not whole: Error closing file: {FULL}"
        if way == "limited file":  # a signal has ended the encoder
            cause = f"the video is not whole: exit code {-signal.SIGXFSZ}"
    shown = os.path.normpath(os.path.join(".", name))
    expected = f"RigidBodySimulation.py: {shown}: {cause}"
    if kept:
        expected += f"; what there is of the run is in {kept}"
    assert line == expected
    left = {path.name for path in folder.iterdir()} - {"disk"}
    assert left == ({name} if isOld else set()) | ({kept} if kept else set())
    if isOld:
        assert (folder / name).read_bytes() == OLD


@pytest.mark.parametrize("case", ["recording", "statistics", "plot", "picture", "mp4"])
def test_read_only_folder(tmp_path, mount, case):
    arguments, name, _, drawn, _ = OUTPUTS[case]
    require(case, drawn)
    folder = tmp_path
    if os.geteuid() == 0:  # whom permissions do not stop
        folder = mount(1024)
    (folder / name).write_bytes(OLD)
    if os.geteuid() == 0:
        subprocess.run(["mount", "-o", "remount,ro", str(folder)], check=True)
        cause = "Read-only file system"
    else:
        folder.chmod(0o555)
        cause = "Permission denied"
    try:
        process = run(folder, *arguments, PYTHONDONTWRITEBYTECODE="1")
        assert (process.returncode, process.stdout) == (2, ""), process.stderr
        (line,) = process.stderr.splitlines()
        assert line == f"RigidBodySimulation.py: {name}: {cause}"
        assert (folder / name).read_bytes() == OLD
        assert [path.name for path in folder.iterdir() if path.name != "disk"] == [name]
    finally:
        folder.chmod(0o755) if os.geteuid() else None


def save_camera(backend, path):
    """Writes a camera in a process of its own, which is returned."""
    program = (
        "import polyscope; from rbs import backends, cameras, drawing; "
        f"drawing.start_polyscope(backends.Backend({backend.name!r})); "
        "polyscope.look_at((0, 10, 90), (0, 10, 0)); "
        f"cameras.save_camera({str(path)!r})"
    )
    return subprocess.run(
        [sys.executable, "-B", "-c", program], cwd=ROOT, env=environment(), capture_output=True,
        text=True, timeout=120,
    )  # fmt: skip


def test_camera_on_a_full_disk(tmp_path, mount):
    backend = require_opengl()

    def save():
        return save_camera(backend, path)

    folder = mount(8)
    path = folder / "camera.json"
    path.write_bytes(OLD)
    (folder / "filler").write_bytes(bytes(4096))
    process = save()
    assert process.returncode == 1 and f"{FULL}: '{path}'" in process.stderr
    assert path.read_bytes() == OLD and not (folder / "camera.part.json").exists()
    (folder / "filler").unlink()
    assert save().returncode == 0
    assert load_camera(path)["fov"] > 0.0


# --------------------------------------------------------------------------------------------------
# kill -9
# --------------------------------------------------------------------------------------------------

# Ends itself by SIGKILL at the n-th call of a function, before it does anything.
KILLED = """
import importlib, os, signal, sys
module, function = sys.argv[1].rsplit(".", 1)
count = int(sys.argv[2])
module = importlib.import_module(module)
real, calls = getattr(module, function), 0
def deadly(*arguments, **options):
    global calls
    calls += 1
    if calls == count:
        os.kill(os.getpid(), signal.SIGKILL)
    return real(*arguments, **options)
setattr(module, function, deadly)
from RigidBodySimulation import main
sys.exit(main(sys.argv[3:]))
"""


def whole_recording(path):
    assert Recording(path).lastStep == 6 and Recording(path).damage() == ""
    assert np.load(path)["positions"].shape == (7, 25, 3)


def whole_table(path):
    with open(path, newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert [row[0] for row in rows] == ["step", *map(str, range(7))]
    assert len({len(row) for row in rows}) == 1


def whole_picture(path):
    with Image.open(path) as picture:
        picture.load()


WHOLE = {"r.npz": whole_recording, "s.csv": whole_table, "p.png": whole_picture}


BOTH = ["--record", "r.npz", "--stats", "s.csv"]


@pytest.mark.parametrize(
    ("function", "options", "names"),
    [
        ("os.fsync", BOTH, ["r.npz", "s.csv"]),
        ("os.replace", BOTH, ["r.npz", "s.csv"]),
        ("rbs.recordingfiles._write_member", BOTH, ["r.npz", "s.csv"]),
        ("os.unlink", BOTH, ["r.npz", "s.csv"]),
        ("os.rmdir", BOTH, ["r.npz", "s.csv"]),
        ("os.replace", ["--plot", "p.png"], ["p.png"]),
    ],
    ids=["fsync", "replace", "write", "unlink", "rmdir", "plot"],
)
def test_kill_at_any_point_leaves_the_old_file_or_a_whole_new_one(
    tmp_path, function, options, names
):
    if "--plot" in options:
        pytest.importorskip("matplotlib", reason="pip install matplotlib")
    arguments = ["tet", "--steps", "6", *options]
    outcomes = set()
    # Of the two dozen arrays of a file, every eleventh will do.
    stride = 11 if function.endswith("member") else 1
    for count in range(1, 200, stride):
        folder = tmp_path / str(count)
        folder.mkdir()
        for name in WHOLE:
            (folder / name).write_bytes(OLD)
        process = subprocess.run(
            [sys.executable, "-c", KILLED, function, str(count), *arguments],
            cwd=folder, env=environment(PYTHONPATH=str(ROOT)), capture_output=True, text=True,
            timeout=120,
        )  # fmt: skip
        for name, assert_whole in WHOLE.items():
            isOld = (folder / name).read_bytes() == OLD
            outcomes.add((name, isOld))
            if not isOld:
                assert_whole(folder / name)
        if process.returncode == 0:
            break
        assert process.returncode == -signal.SIGKILL, process.stderr
        # What was simulated is not lost, once there was a chunk on the disk.
        if list(folder.glob("r.npz.part/chunk_*.npz")):
            left = Recording(folder / "r.npz.part")
            assert left.damage() == ""
    assert process.returncode == 0 and count > 1
    # The last name's file is old while the program is killed, and new in the end.
    assert outcomes >= {(name, False) for name in names} | {(names[-1], True)}


def test_kill_while_a_picture_or_a_video_is_drawn(tmp_path):
    require_opengl()
    pytest.importorskip("imageio_ffmpeg", reason="pip install imageio-ffmpeg")
    arguments = ["tet", "--steps", "4", "--every", "2", "--size", "160x120"]
    arguments += ["--video", "v.mp4", "--screenshots", "."]
    names = ["frame_000000.png", "frame_000002.png", "frame_000004.png", "v.mp4"]
    for count in range(1, 5):  # of the three pictures, then of the video
        for name in names:
            (tmp_path / name).write_bytes(OLD)
        process = subprocess.run(
            [sys.executable, "-c", KILLED, "os.replace", str(count), *arguments],
            cwd=tmp_path, env=environment(PYTHONPATH=str(ROOT)), capture_output=True, text=True,
            timeout=120,
        )  # fmt: skip
        assert process.returncode == -signal.SIGKILL, process.stderr
        for number, name in enumerate(names, 1):
            if number < count:
                whole_picture(tmp_path / name)
            else:
                assert (tmp_path / name).read_bytes() == OLD
    # What it left does not stand in the way of the next run.
    assert run(tmp_path, *arguments).returncode == 0
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    assert imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "v.mp4"))[0] == 3
    assert {path.name for path in tmp_path.iterdir()} == set(names)


# --------------------------------------------------------------------------------------------------
# One file of an interrupted recording
# --------------------------------------------------------------------------------------------------


@pytest.fixture
def inChunks(monkeypatch):
    """Every state is a chunk by itself."""
    monkeypatch.setattr(rbs.recording, "CHUNK_SECONDS", 0.0)
    monkeypatch.setattr(rbs.recording, "CHUNK_SHARE", 0.0)


def interrupted(path, steps, scene="tower_chain"):
    """A recording that was not saved; friction is switched on in its middle."""
    simulation = Simulation(DATA / f"{scene}-scene.txt")
    recorder = Recorder(path)
    for step in range(steps):
        if step == steps // 2:
            simulation.settings.friction = 0.4
        recorder.add(simulation)
        simulation.step()
    return recorder


@pytest.mark.parametrize("given", ["r.npz", "r.npz.part"])
def test_finished_recording_has_the_bytes_of_a_saved_one(
    tmp_path, monkeypatch, capsys, inChunks, given
):
    saved = interrupted(tmp_path / "saved.npz", 9)
    saved.save()
    assert interrupted(tmp_path / "r.npz", 9).close() == tmp_path / "r.npz.part"
    monkeypatch.chdir(tmp_path)
    assert main(["--finish", given]) == 0
    output, errors = capsys.readouterr()
    assert output == "r.npz: the steps 0 to 8, of an interrupted recording\n" and errors == ""
    assert (tmp_path / "r.npz").read_bytes() == (tmp_path / "saved.npz").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["r.npz", "saved.npz"]
    assert main(["--verify", "r.npz"]) == 0


def test_killed_run_can_be_finished_and_goes_on(tmp_path):
    process = subprocess.run(
        [sys.executable, "-c", KILLED, "os.replace", "3", "tower", "--steps", "100000", "--record",
         "r.npz"], cwd=tmp_path, env=environment(PYTHONPATH=str(ROOT)), timeout=120,
    )  # fmt: skip
    assert process.returncode == -signal.SIGKILL
    process = run(tmp_path, "--finish", "r.npz")
    assert process.returncode == 0 and process.stderr == ""
    assert [path.name for path in tmp_path.iterdir()] == ["r.npz"]
    last = Recording(tmp_path / "r.npz").lastStep
    assert last > 0
    process = run(tmp_path, "--resume", "r.npz", "--steps", "2", "--headless")
    assert process.returncode == 0 and f"steps             {last + 2} of" in process.stdout


def test_finishing_is_refused_where_something_would_be_lost(tmp_path, inChunks):
    interrupted(tmp_path / "r.npz", 5).close()
    part = tmp_path / "r.npz.part"
    (tmp_path / "r.npz").write_bytes(OLD)
    with pytest.raises(RecordingError, match="r.npz: there is another one already; rename it"):
        finish(tmp_path / "r.npz")
    assert (tmp_path / "r.npz").read_bytes() == OLD
    (tmp_path / "r.npz").unlink()
    chunk = part / "chunk_000002.npz"
    content = chunk.read_bytes()
    damaged = bytearray(content)
    damaged[content.index(b" \n", content.index(b"times.npy")) + 2] ^= 1
    chunk.write_bytes(damaged)
    with pytest.raises(RecordingError, match="r.npz: cannot be made: the array .*chunk_000002.npz"):
        finish(tmp_path / "r.npz")
    chunk.unlink()
    with pytest.raises(RecordingError, match="chunk_000003.npz: the states from step 2 on are mis"):
        finish(tmp_path / "r.npz")
    assert len(list(part.glob("chunk_*.npz"))) == 4 and not (tmp_path / "r.npz").exists()
    chunk.write_bytes(content)
    assert finish(tmp_path / "r.npz") == (tmp_path / "r.npz", 0, 4)
    with pytest.raises(RecordingError, match="there is no interrupted recording of it"):
        finish(tmp_path / "r.npz")


@pytest.mark.parametrize("given", ["/", ".", "..", "folder", "folder/", "./", "//"])
def test_finishing_a_folder_is_refused_in_one_line(tmp_path, given):
    (tmp_path / "here" / "folder").mkdir(parents=True)
    process = run(tmp_path / "here", "--finish", given)
    assert (process.returncode, process.stdout) == (2, "")
    (line,) = process.stderr.splitlines()
    assert line.endswith(": this is a folder, not a recording")


def test_an_interrupted_recording_is_finished_from_within(tmp_path, inChunks):
    interrupted(tmp_path / "r.npz", 3).close()
    process = run(tmp_path / "r.npz.part", "--finish", ".")
    assert process.returncode == 0, process.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["r.npz"]


def test_finishing_removes_chunks_that_are_in_the_file_already(tmp_path, inChunks):
    recorder = interrupted(tmp_path / "r.npz", 5)
    recorder.close()
    part, kept = tmp_path / "r.npz.part", tmp_path / "kept"
    shutil.copytree(part, kept)
    finish(tmp_path / "r.npz")
    content = (tmp_path / "r.npz").read_bytes()
    kept.rename(part)
    assert finish(tmp_path / "r.npz") == (tmp_path / "r.npz", 0, 4)
    assert (tmp_path / "r.npz").read_bytes() == content
    assert [path.name for path in tmp_path.iterdir()] == ["r.npz"]
    # A file of other states, as many of them, is no such one.
    other = interrupted(tmp_path / "o.npz", 5, "tower")
    other.save()
    interrupted(tmp_path / "o.npz", 5).close()
    with pytest.raises(RecordingError, match="o.npz: there is another one already"):
        finish(tmp_path / "o.npz")


def test_recording_that_still_grows_is_left_alone(tmp_path, inChunks):
    recorder = interrupted(tmp_path / "r.npz", 3)
    with pytest.raises(RecordingError, match="r.npz.part: a program is still recording into it"):
        finish(tmp_path / "r.npz")
    (tmp_path / "s.npz.part").mkdir()
    other = Recorder(tmp_path / "s.npz")
    with pytest.raises(RecordingError, match="s.npz.part: a program is still recording into it"):
        Recorder(tmp_path / "s.npz")
    assert other.close() is None
    recorder.save()
    assert [path.name for path in tmp_path.iterdir()] == ["r.npz"]


def test_finishing_on_a_full_disk_keeps_the_chunks(tmp_path, monkeypatch, inChunks):
    interrupted(tmp_path / "r.npz", 5).close()
    before = {path.name: path.read_bytes() for path in (tmp_path / "r.npz.part").iterdir()}

    def full_disk(descriptor):
        raise OSError(28, FULL)

    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(OSError, match=FULL) as raised:
        finish(tmp_path / "r.npz")
    assert raised.value.filename == str(tmp_path / "r.npz")
    after = {path.name: path.read_bytes() for path in (tmp_path / "r.npz.part").iterdir()}
    assert before == after and not (tmp_path / "r.npz").exists()


def test_finishing_takes_the_memory_of_a_block(tmp_path, monkeypatch):
    monkeypatch.setattr(rbs.recording, "BLOCK_BYTES", 200_000)
    simulation = Simulation(DATA / "stress-scene.txt")
    recorder = Recorder(tmp_path / "r.npz")
    for step in range(2000):
        simulation.stepCount = step
        recorder.add(simulation)
    assert len(recorder._chunks) > 20
    recorder.close()
    tracemalloc.start()
    assert finish(tmp_path / "r.npz")[2] == 1999
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    size = (tmp_path / "r.npz").stat().st_size
    assert size > 8_000_000 and peak < 1_500_000


# --------------------------------------------------------------------------------------------------
# The pieces
# --------------------------------------------------------------------------------------------------


def test_run_that_ends_in_between_says_where_its_states_are(
    tmp_path, monkeypatch, capsys, inChunks
):
    sync, calls = os.fsync, []

    def soon_full(descriptor):
        calls.append(descriptor)
        if len(calls) > 20:
            raise OSError(28, FULL)
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", soon_full)
    monkeypatch.chdir(tmp_path)
    assert main(["tet", "--steps", "50", "--record", "r.npz", "--stats", "s.csv"]) == 2
    output, errors = capsys.readouterr()
    assert output == ""
    assert errors == (
        f"RigidBodySimulation.py: r.npz: {FULL}; what there is of the run is in r.npz.part and "
        "s.csv.part\n"
    )
    assert Recording("r.npz").lastStep > 3


def test_file_is_written_whole_or_not_at_all(tmp_path):
    path = tmp_path / "a.txt"
    with atomic_write(path) as partial:
        partial.write_text("one")
        assert partial.name == "a.part.txt" and not path.exists()
    assert path.read_text() == "one"
    with pytest.raises(ZeroDivisionError), atomic_write(path) as partial:
        partial.write_text("two")
        raise ZeroDivisionError
    assert path.read_text() == "one" and [p.name for p in tmp_path.iterdir()] == ["a.txt"]
    with pytest.raises(OSError) as raised, atomic_write(tmp_path / "no" / "a.txt") as partial:
        partial.write_text("three")
    assert raised.value.filename == str(tmp_path / "no" / "a.txt")


def test_links_and_devices_are_written_through(tmp_path):
    (tmp_path / "folder").mkdir()
    link = tmp_path / "link.txt"
    link.symlink_to("folder/a.txt")
    with atomic_write(link) as partial:
        partial.write_text("one")
    assert link.is_symlink() and (tmp_path / "folder" / "a.txt").read_text() == "one"
    with atomic_write("/dev/null") as partial:
        partial.write_text("one")
    assert partial_path("/dev/null") == partial and partial.is_char_device()


def test_statistics_of_a_killed_run_do_not_stand_in_the_way(tmp_path, capsys):
    (tmp_path / "s.csv.part").write_text("step\n0\n1")
    simulation = Simulation(DATA / "tet-scene.txt")
    writer = StatsWriter(tmp_path / "s.csv")
    for _ in range(2):
        writer.add(simulation)
        simulation.step()
    writer.save()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["s.csv", "s.csv-1.part"]
    assert len((tmp_path / "s.csv").read_text().splitlines()) == 3
    assert (tmp_path / "s.csv-1.part").read_text() == "step\n0\n1"
    assert capsys.readouterr().err.endswith(
        "s.csv.part: left by a run that was killed, and kept as s.csv-1.part\n"
    )
