"""Full disks, folders that cannot be written to, files that are written whole or not at all.

A disk is filled by a small file system in memory where tests may mount one, and by a limit on the
size of a file otherwise; both are tested where both can be.
"""

import os
import signal
import subprocess
import sys

import pytest
from opengl import require_opengl
from oracles import ROOT
from program import DATA, environment, run

from rbs.files import atomic_write, check_outputs, partial_path, read_bytes
from rbs.messages import InputError
from rbs.recording import Recording
from rbs.replay import verify
from RigidBodySimulation import main

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="file systems and limits are Linux's here"
)

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
# case: (arguments, the file, the kB that are too few, whether it takes OpenGL)
OUTPUTS = {
    "recording": (["stress", "--steps", "1500", "--record", "o.h5"], "o.h5", 4000, False),
    "statistics": (["tet", "--steps", "400", "--stats", "o.csv"], "o.csv", 64, False),
    "plot": (["tet", "--steps", "20", "--plot", "o.png"], "o.png", 32, False),
    "picture": (["tet", "--steps", "0", "--screenshots", ".", *DRAWN], "frame_000000.png", 12,
                True),
    "mp4": (["tet", "--steps", "60", "--video", "o.mp4", *DRAWN], "o.mp4", 12, True),
}  # fmt: skip


def require(case, drawn):
    if drawn:
        require_opengl()
    if case in ("mp4", "gif"):
        pytest.importorskip("imageio_ffmpeg", reason="pip install imageio-ffmpeg")
    if case == "plot":
        pytest.importorskip("matplotlib", reason="pip install matplotlib")


@pytest.mark.parametrize("isOld", [False, True])
@pytest.mark.parametrize("way", ["full disk", "limited file"])
@pytest.mark.parametrize("case", OUTPUTS)
def test_full_disk(tmp_path, mount, case, way, isOld):
    arguments, name, kilobytes, drawn = OUTPUTS[case]
    if drawn and isOld:
        pytest.skip("slow, and written as the others are")
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
    if case == "mp4":
        cause = f"the video is not whole: Error closing file: {FULL}"
        if way == "limited file":  # a signal has ended the encoder
            cause = f"the video is not whole: exit code {-signal.SIGXFSZ}"
    assert line == f"RigidBodySimulation.py: {name}: {cause}"
    left = {path.name for path in folder.iterdir()} - {"disk"}
    if isOld:
        assert left == {name} and (folder / name).read_bytes() == OLD
    elif case == "recording":
        assert left == {name} and verify(Recording(folder / name)) == ""
    else:
        assert left == set()


@pytest.mark.parametrize("case", OUTPUTS)
def test_read_only_folder(tmp_path, mount, case):
    arguments, name, _, drawn = OUTPUTS[case]
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


# --------------------------------------------------------------------------------------------------
# Files
# --------------------------------------------------------------------------------------------------


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


def test_no_output_is_an_input_or_another_output(tmp_path):
    paths = [tmp_path / name for name in ("a", "b", "link")]
    paths[2].symlink_to("a")
    check_outputs({"--stats": paths[1]}, [paths[0]])
    for outputs in ({"--stats": paths[0]}, {"--plot": paths[2]}):
        with pytest.raises(InputError, match="not written, because this run reads it"):
            check_outputs(outputs, [paths[0]])
    with pytest.raises(InputError, match="not written, because --stats writes it too"):
        check_outputs({"--stats": paths[0], "--plot": paths[2]}, [])


@pytest.mark.parametrize("name", ["own-scene.txt", "own-constraints.txt", "box.mesh"])
def test_a_run_does_not_write_over_what_it_reads(tmp_path, capsys, name):
    (tmp_path / "own-scene.txt").write_text("1\nbox.mesh 1 0 0 9 0 1 0 0 0\n")
    (tmp_path / "own-constraints.txt").write_text("0\n")
    (tmp_path / "box.mesh").write_bytes((DATA / "box.mesh").read_bytes())
    before = (tmp_path / name).read_bytes()
    assert main([str(tmp_path / "own-scene.txt"), "--stats", str(tmp_path / name)]) == 2
    assert "not written, because this run reads it" in capsys.readouterr().err
    assert (tmp_path / name).read_bytes() == before


def test_statistics_may_go_to_a_device(capsys):
    assert main(["tet", "--steps", "2", "--stats", os.devnull]) == 0
    assert not os.path.isfile(os.devnull)


def test_no_more_is_read_than_the_limit(tmp_path):
    (tmp_path / "a").write_bytes(bytes(100))
    assert read_bytes(tmp_path / "a", 100) == bytes(100)
    with pytest.raises(OSError, match="longer than 99 bytes"):
        read_bytes(tmp_path / "a", 99)
