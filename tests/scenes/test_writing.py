"""Files are written whole or not at all, through links and devices, and over no input."""

import errno
import os

import pytest
from program import call

from rbs.recordings.recording import Recording
from rbs.recordings.replay import verify
from rbs.scenes.files import atomic_write, check_outputs, partial_path
from rbs.scenes.messages import InputError

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
    assert (code, output) == (2, "")
    assert errors == f"RigidBodySimulation.py: {path}: {os.strerror(errno.ENOSPC)}\n"
    assert [one.name for one in tmp_path.iterdir()] == ["r.h5"]
    if isOld:
        assert path.read_bytes() == OLD
    else:
        assert Recording(path).lastStep > 3 and verify(Recording(path)) == ""


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


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such links")
def test_links_and_devices_are_written_through_and_known(tmp_path):
    (tmp_path / "folder").mkdir()
    link = tmp_path / "link.txt"
    link.symlink_to("folder/a.txt")
    with atomic_write(link) as partial:
        partial.write_text("one")
    assert link.is_symlink() and (tmp_path / "folder" / "a.txt").read_text() == "one"
    assert partial_path(os.devnull).is_char_device()
    with pytest.raises(InputError, match="--plot .*, because this run reads it"):
        check_outputs({"--stats": tmp_path / "b", "--plot": link}, [tmp_path / "folder" / "a.txt"])
