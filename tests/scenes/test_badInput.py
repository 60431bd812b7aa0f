"""What the program is given and cannot use: each case ends in one line and exit code 2.

The line names the file, the line in it where there is one, and the cause; nothing is written.
Broken text files are in `test_loading.py`.
"""

import itertools
import json
import os
import shlex
import sys

import h5py
import numpy as np
import pytest
from program import CAMERA, call, record
from test_loading import FILES, write

from rbs.scenes.simulation import SceneSimulation

# What would be written.
RECORDED = ["--steps", "1", "--record", "new.h5", "--stats", "s.csv"]


@pytest.fixture
def folder(sceneFolder):
    """The current folder, with a scene, a camera, and a folder in it."""
    for name in ("camera.json", "camera.csv"):
        write(sceneFolder, name, json.dumps(CAMERA))
    (sceneFolder / "folder.mesh").mkdir()
    (sceneFolder / "folder.csv").mkdir()
    return sceneFolder


def snapshot(folder):
    return {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


def assert_refused(folder, capsys, arguments, beginning, cause="", code=2):
    """Asserts that one line with this beginning and cause is printed, and no file written."""
    before = snapshot(folder)
    got, output, errors = call(capsys, *arguments)
    assert (got, output) == (code, ""), errors
    (line,) = errors.splitlines()
    assert line.startswith(f"RigidBodySimulation.py: {beginning}") and cause in line, line
    assert line.isprintable() and len(line) < 400
    assert snapshot(folder) == before


MAKERS = {"": lambda path: None, "folder": os.mkdir, "pipe": getattr(os, "mkfifo", os.mkdir)}


@pytest.mark.parametrize("kind", MAKERS)
@pytest.mark.parametrize("name", [*FILES, "camera.json"])
def test_what_is_no_file_is_not_read(folder, capsys, name, kind):
    (folder / name).unlink()
    MAKERS[kind](folder / name)
    options = ["--camera", "camera.json", "--constraints", "a-constraints.txt", *RECORDED]
    options += ["--screenshots", "p"]
    place = {"cube.off": "a-scene.txt:2", "t.mesh": "a-scene.txt:4"}.get(name, "")
    begins = f"{place if place and not kind else name}: "
    assert_refused(folder, capsys, ["a-scene.txt", *options], begins, place)


def test_camera_that_cannot_be_used(folder, capsys):
    cameras = ["[" * 100_000, '{"fov": 20}', json.dumps(CAMERA).replace("20", "2" * 5000)]
    cameras += [json.dumps(CAMERA).replace("-90", word) for word in ("NaN", "9e300", '"far"')]
    for text in (*cameras, json.dumps(CAMERA | {"viewMat": [0] * 16})):
        write(folder, "camera.json", text)
        arguments = ["a-scene.txt", "--camera", "camera.json", *RECORDED, "--screenshots", "p"]
        assert_refused(folder, capsys, arguments, "camera.json: this is not a Polyscope camera")


def test_recording_that_cannot_be_used(folder, capsys):
    (folder / "empty.h5").touch()
    with h5py.File("other.h5", "w") as file:
        file["numbers"] = np.arange(9)
    options = itertools.cycle(("--replay", "--resume", "--verify"))
    for name in ("none.h5", "folder.mesh", "empty.h5", "t.mesh", "other.h5"):
        cause = "not a recording" if (folder / name).is_file() else "cannot be read"
        assert_refused(folder, capsys, [next(options), name], f"{name}: ", cause)


# Words behind the scene's name, and a word of the line: the option or the file.
OPTIONS = [
    ("--gra\nvity", "--gra vity"),
    ("--steps ٣", "--steps"),
    ("--friction 1_0", "--friction"),
    ("--gravity 0,-٣,0", "--gravity"),
    ("--steps -1", "--steps"),
    ("--trace 3:nobody", "--trace"),
    ("--trace 3:٠", "--trace"),
    ("--camera camera.csv --screenshots p --stats ./camera.csv", "./camera.csv"),
    ("--record r.h5x", "--record"),
    ("--size 320x180", "--size"),
    ("--stats folder.csv", "folder.csv: a folder, not a file"),
    ("--record none/r.h5", "none/r.h5: there is no folder none"),
    ("--stats camera.csv/s.csv", "camera.csv/s.csv: there is no folder camera.csv"),
    ("--frction 0.5", "did you mean --friction?"),
    ("-friction 0.5", "did you mean --friction?"),
    ("--restitution 0,5", "not '0,5'"),
    ("--gravity 0,-9,8,0", "not '0,-9,8,0'"),
    ("--colours red --screenshots p", "--colours: invalid choice: 'red' (choose from "),
]


@pytest.mark.parametrize(("words", "named"), OPTIONS, ids=str)
def test_option_that_cannot_be_used(folder, capsys, words, named):
    assert_refused(folder, capsys, ["tet", "--headless", *words.split(" ")], "", named)


# Lines of a scene, and what their messages say: a decimal comma is quoted as it was written.
LINES = [
    ("t.mesh 1,5 0 0 9 0 1 0 0 0", "not 11: 't.mesh 1,5 0 0 9 0 1 0 0 0'"),
    ("t.mesh 1 2 0 9 0 1 0 0 0", "isFixed must be 0 or 1, not 2"),
    ("T.mesh 1 0 0 9 0 1 0 0 0", "beside the scene; did you mean t.mesh?"),
    ("nothing.off 1 0 0 9 0 1 0 0 0", "'nothing.off' beside the scene"),
]


@pytest.mark.parametrize(("line", "cause"), LINES)
def test_line_that_cannot_be_used(folder, capsys, line, cause):
    write(folder, "b-scene.txt", f"1\n{line}\n")
    assert_refused(folder, capsys, ["b-scene.txt", *RECORDED], "b-scene.txt:2: ", cause)


def test_a_missing_package_is_installed_where_it_is_missing(folder, capsys, monkeypatch):
    """The pip that a terminal finds may be another Python's."""
    monkeypatch.setitem(sys.modules, "trimesh", None)
    write(folder, "b-scene.txt", "1\ns.stl 1 0 0 9 0 1 0 0 0\n")
    write(folder, "s.stl", "solid")
    for python in (sys.executable, str(folder / "my env" / "python")):
        monkeypatch.setattr(sys, "executable", python)
        command = shlex.join([python.replace(f"{folder}/", ""), *"-m pip install trimesh".split()])
        cause = f"Install it: {command};".replace("'", '"')
        assert_refused(folder, capsys, ["b-scene.txt", *RECORDED], "s.stl: no .stl files", cause)


@pytest.mark.parametrize("scene", ["", "nosuch", ".", "camera.json", "a\nb-scene.txt", "r.H5"])
def test_scene_that_is_none(folder, capsys, scene):
    write(folder, "a\nb-scene.txt", "0\n")
    write(folder, "r.H5", "")
    beginning = scene.replace("\n", " ") + ":" if scene else "argument SCENE: "
    cause = "--replay shows it" if scene == "r.H5" else ""
    assert_refused(folder, capsys, [scene, *RECORDED], beginning, cause)


@pytest.mark.parametrize("name", ["c.csv", "c.mp4", "r.h5"])
def test_a_run_does_not_write_over_what_it_reads(folder, capsys, name):
    record("r.h5", SceneSimulation("a-scene.txt"), 1)
    os.rename("a-constraints.txt", name) if name != "r.h5" else None
    read = ["--resume", "r.h5"] if name == "r.h5" else ["a-scene.txt", "--constraints", name]
    option = {"c.csv": "--stats", "c.mp4": "--video", "r.h5": "--record"}[name]
    message = f"{option} ./{name}: not written, because this run reads it"
    assert_refused(folder, capsys, [*read, option, f"./{name}"], message)
