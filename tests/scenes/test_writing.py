"""Files are written whole or not at all, through links and devices, and never over an input."""

import errno
import os
from functools import partial

import pytest
from opengl import require_opengl
from program import call, run, start, summary_of

from rbs.recordings.recording import Recording
from rbs.recordings.replay import verify
from rbs.scenes.files import atomic_write, check_outputs, partial_path
from rbs.scenes.messages import InputError
from RigidBodySimulation import main

OLD = b"an older file"


@pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="a full disk is found by it")
@pytest.mark.parametrize("isOld", [False, True])
def test_full_disk_keeps_what_was_recorded_or_the_old_file(tmp_path, monkeypatch, capsys, isOld):
    path, allocate, found = tmp_path / "r.h5", os.posix_fallocate, []
    if isOld:
        path.write_bytes(OLD)

    def allocate_a_few(*arguments):
        if len(found) == 8:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        found.append(arguments)
        allocate(*arguments)

    monkeypatch.setattr("rbs.recordings.recording.FLUSH_SECONDS", 0.0)
    monkeypatch.setattr(os, "posix_fallocate", allocate_a_few)
    code, output, errors = call(capsys, "tet", "--steps", 50, "--record", path)
    assert code == 2 and "stopped" not in output
    assert 3 < int(summary_of(output)["steps"].split()[0]) < 50  # nothing is left to run for
    assert errors == f"RigidBodySimulation.py: {path}: {os.strerror(errno.ENOSPC)}\n"
    if isOld:
        assert path.read_bytes() == OLD
        path = tmp_path / "r.part.h5"
    assert len(list(tmp_path.iterdir())) == 1 + isOld
    assert Recording(path).lastStep > 3 and verify(Recording(path)) == ""


@pytest.mark.skipif(os.name == "nt", reason="Windows has no limits of file sizes")
def test_outputs_that_fail_do_not_take_the_others_down(tmp_path):
    """A file may have 30 kB: too little for the recording, some rows of the table."""
    import resource

    words = "--steps 200 --record r.h5 --stats s.csv --export e.glb".split()
    limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (30_000, 30_000))
    process = start(tmp_path, "singletet", *words, preexec_fn=limit)
    output, errors = process.communicate(timeout=60)
    lines = [line.removeprefix("RigidBodySimulation.py: ") for line in errors.splitlines()]
    begins = ["r.h5: ", "s.csv: ", "s.csv: not complete"]
    assert process.returncode == 2 and len(lines) == len(begins), errors
    assert all(map(str.startswith, lines, begins)), lines
    assert "200 of 0.02 s" in output
    assert output.splitlines()[-1].startswith("export            e.glb: 200 steps")
    rows = (tmp_path / "s.part.csv").read_text(encoding="utf-8").splitlines()
    assert 50 < len(rows) < 201 and len({row.count(",") for row in rows}) == 1
    assert {path.name for path in tmp_path.iterdir()} == {"s.part.csv", "e.glb"}


@pytest.mark.skipif(os.name == "nt", reason="the encoder is a shell script")
def test_video_whose_encoder_ends_does_not_take_the_statistics_down(tmp_path):
    require_opengl()
    pytest.importorskip("imageio_ffmpeg", reason="pip install imageio-ffmpeg")
    ffmpeg = tmp_path / "ffmpeg"
    ffmpeg.write_text("#!/bin/sh\nhead -c 100000 >/dev/null\nexit 1\n")
    ffmpeg.chmod(0o755)
    words = "tet --steps 9 --size 160x120 --video v.mp4 --stats s.csv"
    process = run(tmp_path, *words.split(), IMAGEIO_FFMPEG_EXE=str(ffmpeg))
    (line,) = process.stderr.splitlines()
    assert process.returncode == 2
    assert "v.mp4: the video is incomplete, because ffmpeg has ended" in line
    assert process.stdout.splitlines()[-1] == "statistics        s.csv"
    assert (tmp_path / "s.csv").read_text(encoding="utf-8").count("\n") == 11
    assert not list(tmp_path.glob("v*"))


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


@pytest.mark.parametrize("name", ["f.csv", "f.h5", "f.glb"])
def test_a_file_of_the_users_own_is_never_taken_for_a_partial_one(tmp_path, name):
    """Neither one that an earlier run left, nor a folder."""
    stem, ending = name.split(".")
    path, (part, second) = tmp_path / name, (tmp_path / f"{stem}.part{k}.{ending}" for k in ("", 2))
    path.write_bytes(OLD)  # a recording that replaces no file grows in place
    part.write_bytes(OLD)
    second.mkdir()
    option = {"csv": "--stats", "h5": "--record", "glb": "--export"}[ending]
    assert main(["tet", "--steps", "2", option, str(path)]) == 0
    assert path.read_bytes() != OLD == part.read_bytes()
    assert sorted(tmp_path.iterdir()) == sorted([path, part, second])
    with pytest.raises(ZeroDivisionError), atomic_write(path) as partial:
        assert partial not in (part, second)
        raise ZeroDivisionError
    assert part.read_bytes() == OLD and second.is_dir()


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such links")
def test_links_and_devices_are_written_through_and_known(tmp_path):
    (tmp_path / "folder").mkdir()
    link = tmp_path / "link.txt"
    link.symlink_to("folder/a.txt")
    with atomic_write(link) as partial:
        partial.write_text("one")
    assert link.is_symlink() and (tmp_path / "folder" / "a.txt").read_text() == "one"
    assert partial_path(os.devnull).is_char_device()
    with pytest.raises(InputError, match="--export .*, because this run reads it"):
        check_outputs(
            {"--stats": tmp_path / "b", "--export": link}, [tmp_path / "folder" / "a.txt"]
        )
