"""Files are written whole or not at all, through links and devices, and never over an input."""

import os
import signal
from functools import partial

import pytest
from oracles import ROOT
from program import python, start

from rbs.recordings.recording import Recording
from rbs.recordings.replay import verify
from rbs.scenes.files import atomic_write, check_outputs, interrupts_held, partial_path
from rbs.scenes.messages import InputError
from RigidBodySimulation import main

OLD = b"an older file"


FILLED = """
from RigidBodySimulation import Simulation, shapes
boxes = [shapes.box((1, 1, 1), 1.0, (0, 2 * k, 0), isFixed=True) for k in range(200)]
run, count = Simulation.from_meshes(boxes), 0
try:
    with run.record("r.h5"):
        for count in range(10**4):
            run.meshes[0].name = "n" * 9 ** 5 * (count == 37)
            run.step()
except OSError as error:
    print(count, error)
"""


def test_full_disk_loses_no_step_that_was_made(tmp_path):
    resource = pytest.importorskip("resource", reason="Windows has no limits of file sizes")
    (tmp_path / "r.h5").write_bytes(OLD)
    limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (2**22, 2**22))
    process = python(tmp_path, "-c", FILLED, PYTHONPATH=str(ROOT), preexec_fn=limit)
    count, told = process.stdout.split(" ", 1)
    last = Recording(tmp_path / "r.part.h5").lastStep
    assert last >= int(count) > 37 and f"r.part.h5 has steps 0 to {last}" in told, process
    assert verify(Recording(tmp_path / "r.part.h5")) == ""
    assert (tmp_path / "r.h5").read_bytes() == OLD and "r.part.h5" in process.stderr
    assert len(list(tmp_path.iterdir())) == 2


def test_outputs_that_fail_do_not_take_the_others_down(tmp_path):
    """A file may have 30 kB: too little for the recording, some rows of the table."""
    resource = pytest.importorskip("resource", reason="Windows has no limits of file sizes")
    words = "--steps 200 --record r.h5 --stats s.csv --export e.glb".split()
    limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (30_000, 30_000))
    process = start(tmp_path, "singletet", *words, preexec_fn=limit)
    output, errors = process.communicate(timeout=300)
    lines = [line.removeprefix("RigidBodySimulation.py: ") for line in errors.splitlines()]
    begins = ["r.h5: ", "s.csv: ", "s.csv: not complete"]
    assert process.returncode == 2 and len(lines) == len(begins), errors
    assert all(map(str.startswith, lines, begins)), lines
    assert "200 of 0.02 s" in output
    assert output.splitlines()[-1].startswith("export            e.glb: 200 steps")
    rows = (tmp_path / "s.part.csv").read_text(encoding="utf-8").splitlines()
    assert 50 < len(rows) < 201 and len({row.count(",") for row in rows}) == 1
    assert {path.name for path in tmp_path.iterdir()} == {"s.part.csv", "e.glb"}


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
    whole = path.read_bytes()
    with pytest.raises(ZeroDivisionError), atomic_write(path) as partial:
        assert partial not in (part, second)
        partial.write_text("a half")
        raise ZeroDivisionError
    assert path.read_bytes() == whole and part.read_bytes() == OLD and second.is_dir()
    assert sorted(tmp_path.iterdir()) == sorted([path, part, second])


@pytest.mark.parametrize("second", [signal.SIGINT, None])
def test_an_interrupt_that_is_held_acts_also_where_a_step_fails(second):
    """The second one acts at once."""
    done = []
    with pytest.raises(KeyboardInterrupt), interrupts_held():
        signal.raise_signal(signal.SIGINT)
        done.append("first")
        if second:
            signal.raise_signal(second)
        done.append("second")
        raise ZeroDivisionError
    assert done == ["first", "second"][: 1 if second else 2]


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
        check_outputs({"--stats": tmp_path / "b", "--export": link}, [tmp_path / "folder/a.txt"])
