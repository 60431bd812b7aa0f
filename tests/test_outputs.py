"""Where a run may write: devices, pipes, links, its own inputs, and what another run writes to.

All devices are made, or linked to, in a scratch folder: no test names one of the system's as an
output, since a program that is wrong would replace it.
"""

import json
import os
import shutil
import signal
import socket
import stat
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from opengl import require_opengl
from oracles import ROOT
from program import CAMERA, DATA, PROGRAM, environment, run

from rbs.recording import Recording

pytestmark = pytest.mark.skipif(os.name == "nt", reason="devices, pipes and links are Unix's here")

STEPS = ["--steps", "3"]
NPZ, PNG = b"PK\3\4", b"\x89PNG\r\n\x1a\n"
# The option, and what its file begins with.
KINDS = {"--stats": b"step,time (s)", "--plot": PNG, "--record": NPZ}


def require(option):
    if option == "--plot":
        pytest.importorskip("matplotlib", reason="pip install matplotlib")
    if option in ("--screenshots", "--video"):
        require_opengl()
        pytest.importorskip("imageio_ffmpeg", reason="pip install imageio-ffmpeg")


def assert_refused(process, message):
    """One line that goes on like the message after the program's name, and exit code 2."""
    assert (process.returncode, process.stdout) == (2, ""), process.stderr
    (line,) = process.stderr.splitlines()
    assert line.startswith(f"RigidBodySimulation.py: {message}"), line


def make_node(path, kind, major, minor):
    try:
        os.mknod(path, kind | 0o600, os.makedev(major, minor))
        if kind == stat.S_IFCHR:
            path.write_bytes(b"x")
    except OSError as error:
        pytest.skip(f"no device can be made here: {error}")


# --------------------------------------------------------------------------------------------------
# What is no file
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("option", KINDS)
def test_a_device_stays_one(tmp_path, option):
    require(option)
    make_node(tmp_path / "null", stat.S_IFCHR, 1, 3)
    process = run(tmp_path, "singletet", option, "null", *STEPS)
    assert process.returncode == 0 and process.stderr == "", process.stderr
    assert stat.S_ISCHR((tmp_path / "null").lstat().st_mode)
    assert [path.name for path in tmp_path.iterdir()] == ["null"]


@pytest.mark.parametrize("option", KINDS)
def test_a_way_through_a_folder_that_is_not_there_harms_no_device(tmp_path, option):
    require(option)
    make_node(tmp_path / "null", stat.S_IFCHR, 1, 3)
    (tmp_path / "loop").symlink_to("loop")
    for name in ("null", "loop"):
        process = run(tmp_path, "singletet", option, f"absent/../{name}", *STEPS)
        assert_refused(process, f"absent/../{name}: No such file")
    assert stat.S_ISCHR((tmp_path / "null").lstat().st_mode) and (tmp_path / "loop").is_symlink()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["loop", "null"]


@pytest.mark.parametrize("option", KINDS)
def test_a_pipe_is_written_to(tmp_path, option):
    require(option)
    pipe, got = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: got.append(pipe.read_bytes()), daemon=True)
    reader.start()
    process = run(tmp_path, "singletet", option, "pipe", *STEPS)
    assert process.returncode == 0 and process.stderr == "", process.stderr
    assert stat.S_ISFIFO(pipe.lstat().st_mode)
    reader.join(10)
    assert not reader.is_alive() and got[0].startswith(KINDS[option])
    assert [path.name for path in tmp_path.iterdir()] == ["pipe"]
    if option == "--record":
        (tmp_path / "r.npz").write_bytes(got[0])
        assert Recording(tmp_path / "r.npz").damage() == ""
        assert np.load(tmp_path / "r.npz")["positions"].shape == (4, 1, 3)
    if option == "--stats":
        assert got[0].count(b"\n") == 5


def test_a_pipe_whose_reader_goes_is_told(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    reader = threading.Thread(target=lambda: open(tmp_path / "pipe", "rb").close(), daemon=True)
    reader.start()
    arguments = ["singletet", "--stats", "pipe", "--record", "r.npz", "--steps", "100000"]
    process = run(tmp_path, *arguments)
    assert_refused(process, "pipe: Broken pipe; what there is of the run is in r.npz.part")
    assert run(tmp_path, "--finish", "r.npz").returncode == 0


def test_statistics_can_go_to_standard_output(tmp_path):
    # By a link of its own: a program that replaced it would do so here, and not in /dev.
    (tmp_path / "stdout").symlink_to("/proc/self/fd/1")
    process = run(tmp_path, "singletet", "--stats", "stdout", *STEPS)
    assert process.returncode == 0 and (tmp_path / "stdout").is_symlink(), process.stderr
    assert process.stdout.startswith("step,time (s)") and "\nscene   " in process.stdout


@pytest.mark.parametrize("option", KINDS)
@pytest.mark.parametrize("isThere", [True, False])
def test_links_are_followed(tmp_path, option, isThere):
    require(option)
    folder = tmp_path / "there"
    folder.mkdir()
    if isThere:
        (folder / "file").write_bytes(b"old")
    (tmp_path / "link").symlink_to("there/file")
    process = run(tmp_path, "singletet", option, "link", *STEPS)
    assert process.returncode == 0 and process.stderr == "", process.stderr
    assert (tmp_path / "link").is_symlink()
    assert (folder / "file").read_bytes().startswith(KINDS[option])
    assert [path.name for path in folder.iterdir()] == ["file"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "there"]


def test_an_interrupted_recording_is_found_through_its_link(tmp_path):
    (tmp_path / "there").mkdir()
    (tmp_path / "r.npz").symlink_to("there/long.npz")
    process = start(tmp_path, "tower", "--record", "r.npz", "--steps", "1000000")
    wait_for(lambda: list(tmp_path.glob("there/long.npz.part/chunk_*.npz")))
    process.kill()
    process.communicate()
    process = run(tmp_path, "--replay", "r.npz", "--headless", "--steps", "2")
    assert process.returncode == 0 and "an interrupted recording" in process.stderr
    assert run(tmp_path, "--finish", "r.npz").returncode == 0
    assert (tmp_path / "r.npz").is_symlink() and Recording(tmp_path / "r.npz").lastStep > 0
    assert [path.name for path in (tmp_path / "there").iterdir()] == ["long.npz"]


@pytest.mark.parametrize("option", KINDS)
@pytest.mark.parametrize("kind", ["socket", "block device"])
def test_what_is_neither_file_nor_pipe_is_refused(tmp_path, monkeypatch, option, kind):
    require(option)
    monkeypatch.chdir(tmp_path)
    if kind == "socket":
        with socket.socket(socket.AF_UNIX) as server:
            server.bind("thing")
    else:
        make_node(tmp_path / "thing", stat.S_IFBLK, 7, 200)
    mode = os.lstat("thing").st_mode
    process = run(tmp_path, "singletet", option, "thing", *STEPS)
    assert_refused(process, "thing: this is neither a file nor a pipe")
    assert os.lstat("thing").st_mode == mode and os.listdir() == ["thing"]


def test_a_picture_goes_through_links_and_not_over_devices(tmp_path):
    require("--screenshots")
    folder = tmp_path / "s"
    folder.mkdir()
    (folder / "frame_000000.png").symlink_to("../first.png")
    make_node(folder / "frame_000001.png", stat.S_IFCHR, 1, 3)
    os.mkfifo(tmp_path / "v.gif")
    threading.Thread(target=lambda: (tmp_path / "v.gif").read_bytes(), daemon=True).start()
    process = run(tmp_path, "singletet", "--screenshots", "s", "--steps", "2", "--every", "1",
                  "--size", "64x64", "--video", "v.gif")  # fmt: skip
    assert process.returncode == 0, process.stderr
    assert (folder / "frame_000000.png").is_symlink()
    assert (tmp_path / "first.png").read_bytes().startswith(PNG)
    assert stat.S_ISCHR((folder / "frame_000001.png").lstat().st_mode)
    assert stat.S_ISFIFO((tmp_path / "v.gif").lstat().st_mode)
    assert not list(tmp_path.rglob("*.part*"))


# --------------------------------------------------------------------------------------------------
# What the run reads
# --------------------------------------------------------------------------------------------------


@pytest.fixture
def inputs(tmp_path):
    """A folder with all that a run may read, and other ways to the same files."""
    for name in ("cube-scene.txt", "cube-constraints.txt", "octahedron.mesh"):
        shutil.copy(DATA / name, tmp_path)
    (tmp_path / "camera.json").write_text(json.dumps(CAMERA))
    (tmp_path / "to-the-mesh").symlink_to("octahedron.mesh")
    os.link(tmp_path / "octahedron.mesh", tmp_path / "also-the-mesh")
    os.link(tmp_path / "cube-scene.txt", tmp_path / "s.csv.part")
    (tmp_path / "pictures").mkdir()
    os.link(tmp_path / "octahedron.mesh", tmp_path / "pictures" / "frame_000000.png")
    assert run(tmp_path, "cube-scene.txt", "--record", "r.npz", *STEPS).returncode == 0
    shutil.copytree(tmp_path, tmp_path / "copy")
    (tmp_path / "out").symlink_to(".")
    return tmp_path


OVERWRITING = {
    "scene found by another way": ["--stats", "out/out/cube-scene.txt"],
    "constraints that are found": ["--stats", "cube-constraints.txt"],
    "mesh": ["--record", "octahedron.mesh"],
    "mesh by a link": ["--stats", "to-the-mesh"],
    "mesh by its other name": ["--stats", "also-the-mesh"],
    "plot over a mesh": ["--plot", "./octahedron.mesh"],
    "scene under the name of a part": ["--stats", "s.csv"],
    "camera found by a folder's link": ["--camera", "camera.json", "--stats", "out/camera.json"],
    "scene of a recording": ["--resume", "r.npz", "--stats", "cube-scene.txt"],
    "mesh of a recording": ["--replay", "r.npz", "--stats", "octahedron.mesh"],
    "recording by a folder's link": ["--resume", "r.npz", "--record", "out/r.npz"],
    "picture": ["--screenshots", "pictures", "--size", "64x64"],
}  # fmt: skip


@pytest.mark.parametrize("case", OVERWRITING)
def test_nothing_is_written_over_what_the_run_reads(inputs, case):
    arguments = OVERWRITING[case]
    for option in ("--plot", "--screenshots"):
        if option in arguments:
            require(option)
    if not {"--replay", "--resume"} & set(arguments):
        arguments = ["cube-scene.txt", *arguments]
    before = {path: path.read_bytes() for path in inputs.rglob("*") if path.is_file()}
    process = run(inputs, *arguments, *STEPS)
    assert (process.returncode, process.stdout) == (2, ""), process.stderr
    assert len(process.stderr.splitlines()) == 1
    assert "reads" in process.stderr or "name the same file" in process.stderr, process.stderr
    assert {path: path.read_bytes() for path in inputs.rglob("*") if path.is_file()} == before


def test_the_program_does_not_write_over_itself(tmp_path):
    for name in ("rbs", "data"):
        shutil.copytree(ROOT / name, tmp_path / name)
    for path in ROOT.glob("*.py"):
        shutil.copy(path, tmp_path)
    for name in ("RBSFunctions.py", "rbs/panel.py"):
        before = (tmp_path / name).read_bytes()
        process = subprocess.run(
            [sys.executable, "RigidBodySimulation.py", "singletet", "--stats", name, *STEPS],
            cwd=tmp_path, env=environment(), capture_output=True, text=True, timeout=120,
        )  # fmt: skip
        assert_refused(process, f"{name}: nothing is written over what this run reads, a part of")
        assert (tmp_path / name).read_bytes() == before


def test_output_that_standard_output_goes_to_is_refused(tmp_path):
    with open(tmp_path / "log.txt", "w") as log:
        process = subprocess.run(
            [sys.executable, PROGRAM, "singletet", "--stats", "log.txt", *STEPS], cwd=tmp_path,
            env=environment(), stdout=log, stderr=subprocess.PIPE, text=True, timeout=120,
        )  # fmt: skip
    assert process.returncode == 2
    assert process.stderr == "RigidBodySimulation.py: log.txt: standard output goes there\n"


# --------------------------------------------------------------------------------------------------
# Two runs into one place
# --------------------------------------------------------------------------------------------------

ONE_PLACE = {
    "statistics": ["--stats", "s.csv"],
    "plot": ["--plot", "p.png"],
    "recording": ["--record", "r.npz"],
    "pictures": ["--screenshots", "pictures", "--size", "64x64", "--every", "1000"],
    "video": ["--video", "v.mp4", "--size", "64x64"],
}
STARTED = {
    "statistics": "s.csv.part", "plot": "p.png.csv.part", "recording": "r.npz.part/chunk_*.npz",
    "pictures": "pictures/frame_000000.png", "video": "v.part.mp4",
}  # fmt: skip


def start(folder, *arguments):
    return subprocess.Popen(
        [sys.executable, PROGRAM, *arguments], cwd=folder, env=environment(),
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def wait_for(condition, seconds=60):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.parametrize("kind", ONE_PLACE)
def test_who_comes_second_is_told_so_in_one_line(tmp_path, kind):
    require(ONE_PLACE[kind][0])
    first = start(tmp_path, "singletet", *ONE_PLACE[kind], "--steps", "1000000")
    try:
        wait_for(lambda: list(tmp_path.glob(STARTED[kind])))
        process = run(tmp_path, "tower", *ONE_PLACE[kind], *STEPS)
        assert (process.returncode, process.stdout) == (2, ""), process.stderr
        name = ONE_PLACE[kind][1] + (".part" if kind == "recording" else "")
        cause = "another run is writing to it"
        if kind == "recording":
            cause = "a program is still recording into it"
        assert process.stderr == f"RigidBodySimulation.py: {name}: {cause}\n"
    finally:
        first.send_signal(signal.SIGINT)
        output, errors = first.communicate(timeout=60)
    assert first.returncode == 130 and "singletet-scene.txt" in output, errors
    assert not list(tmp_path.rglob("*.part*"))


def test_three_tables_at_once_are_one(tmp_path):
    runs = [start(tmp_path, "tower", "--stats", "s.csv", "--steps", "300") for _ in range(3)]
    ends = [(*process.communicate(timeout=120), process.returncode) for process in runs]
    codes = sorted(code for _, _, code in ends)
    assert set(codes) <= {0, 2} and codes[0] == 0
    for _, errors, code in ends:
        assert errors == ("" if code == 0 else
                          "RigidBodySimulation.py: s.csv: another run is writing to it\n")
    rows = (tmp_path / "s.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in rows] == ["step", *map(str, range(301))]
    assert [path.name for path in tmp_path.iterdir()] == ["s.csv"]


@pytest.mark.parametrize(
    ("part", "arguments"),
    [("s.csv.part", ["--stats", "s.csv"]), ("p.png.csv.part", ["--plot", "p.png"]),
     ("v.part.mp4", ["--video", "v.mp4", "--size", "64x64"])],
)  # fmt: skip
def test_what_a_killed_run_has_left_is_kept_and_told(tmp_path, part, arguments):
    require(arguments[0])
    (tmp_path / part).write_bytes(b"of an hour")
    process = run(tmp_path, "singletet", *arguments, *STEPS)
    assert process.returncode == 0, process.stderr
    stem, _, ending = part.rpartition(".")
    kept = f"{stem}-1.{ending}"
    assert process.stderr == (
        f"RigidBodySimulation.py: {part}: left by a run that was killed, and kept as {kept}\n"
    )
    assert (tmp_path / kept).read_bytes() == b"of an hour" and not (tmp_path / part).exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--stats", "s.csv", "--plot", "s.csv.part"], "s.csv.part: a name with .part is for"),
        (["--record", "r.npz", "--stats", "r.npz.part"], "r.npz.part: a name with .part is for"),
        (["--video", "v.mp4", "--screenshots", "v.part.mp4"], "v.part.mp4: a name with .part is"),
        (["--stats", "link"], "link: a name with .part is for files"),
        (["--screenshots", "s", "--plot", "s/frame_000002.png"],
         "--plot has the name of a picture of --screenshots"),
    ],
)  # fmt: skip
def test_outputs_of_one_run_do_not_meet(tmp_path, arguments, message):
    for option in arguments[::2]:
        require(option)
    (tmp_path / "link").symlink_to("link-to.part")
    process = run(tmp_path, "singletet", *arguments, *STEPS)
    assert (process.returncode, process.stdout) == (2, ""), process.stderr
    assert len(process.stderr.splitlines()) == 1 and message in process.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["link"]
