"""What the program is given and cannot use: each case ends in one line and exit code 2.

The line names the file, the line in it where there is one, and the cause; nothing is written. What
makes a text file a broken one stands in `test_loading.py`, the fuzzing in `test_fuzzing.py`.
"""

import json
import os

import h5py
import numpy as np
import pytest
from program import CAMERA, call, record, run
from test_loading import BROKEN, FILES, TETRAHEDRON, broken, write

from rbs.scenes.simulation import SceneSimulation
from rbs.scenes.textfiles import SceneError
from RigidBodySimulation import load_scene_file

# What would be written.
RECORDED = ["--steps", "1", "--record", "new.h5", "--stats", "s.csv"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with a scene, a camera, and a folder in it."""
    for name, text in FILES.items():
        write(tmp_path, name, text)
    write(tmp_path, "camera.json", json.dumps(CAMERA))
    (tmp_path / "folder.mesh").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def snapshot(folder):
    """Names and contents of all files below a folder."""
    return {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


def assert_refused(folder, capsys, arguments, beginning, cause="", code=2):
    """One line that begins and goes on like this after the program's name, and no file."""
    before = snapshot(folder)
    got, output, errors = call(capsys, *arguments)
    assert (got, output) == (code, ""), errors
    (line,) = errors.splitlines()
    assert line.startswith(f"RigidBodySimulation.py: {beginning}") and cause in line, line
    assert line.isprintable() and len(line) < 400
    assert snapshot(folder) == before


@pytest.mark.parametrize("case", BROKEN[::6])
def test_broken_text_file(folder, capsys, case):
    name, old, new, line, cause = case
    write(folder, name, broken(FILES[name], old, new))
    beginning = f"{name}:{line}: " if line else f"{name}: "
    assert_refused(folder, capsys, ["a-scene.txt", *RECORDED], beginning, cause)


@pytest.mark.parametrize("isFolder", [False, True])
@pytest.mark.parametrize("name", [*FILES, "camera.json"])
def test_what_is_no_file_is_not_read(folder, capsys, name, isFolder):
    (folder / name).unlink()
    if isFolder:
        (folder / name).mkdir()
    options = ["--camera", "camera.json", "--constraints", "a-constraints.txt", *RECORDED]
    options += ["--screenshots", "p"]
    lines = {} if isFolder else {"cube.off": "a-scene.txt:2: ", "t.mesh": "a-scene.txt:4: "}
    assert_refused(folder, capsys, ["a-scene.txt", *options], lines.get(name, f"{name}: "))


@pytest.fixture
def outside(folder):
    """A folder `scenes` whose scenes reach for t.mesh, which lies beside it, in four ways."""
    scenes = folder / "scenes"
    (scenes / "down").mkdir(parents=True)
    ways = {"dots": "../t.mesh", "link": "link.mesh", "folderLink": "up/t.mesh"}
    ways |= {"absolute": folder / "t.mesh", "inside": "down/../link2.mesh"}
    for name, mesh in ways.items():
        write(scenes, f"{name}-scene.txt", f"1\n{mesh} 1 0 0 5 0 1 0 0 0\n")
    (scenes / "link.mesh").symlink_to(folder / "t.mesh")
    (scenes / "up").symlink_to(folder)
    write(scenes, "own.mesh", TETRAHEDRON)
    (scenes / "link2.mesh").symlink_to("own.mesh")
    return scenes


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such links")
@pytest.mark.parametrize("name", ["dots", "absolute", "link", "folderLink"])
def test_mesh_outside_of_the_scenes_folder_is_read_only_when_asked_for(outside, capsys, name):
    scene = f"scenes/{name}-scene.txt"
    assert_refused(outside.parent, capsys, [scene, *RECORDED], f"{scene}:2: ", "--allow-outside")
    for load in (load_scene_file, SceneSimulation):
        with pytest.raises(SceneError, match="outside the scene's folder"):
            load(scene)
    (mesh,) = load_scene_file(scene, allowOutsideMeshes=True)
    assert len(mesh.tets) == 2
    options = ["--headless", "--steps", "2", "--record", "r.h5", "--allow-outside-meshes"]
    assert call(capsys, scene, *options)[0] == 0
    assert call(capsys, "--verify", "r.h5")[0] == 0  # a recording has its meshes in it
    # Inside, a mesh may be reached in any way; so may all of it through a link to the folder.
    (outside.parent / "alias").symlink_to(outside)
    for folder in ("scenes", "alias"):
        assert len(load_scene_file(f"{folder}/inside-scene.txt")) == 1


def test_camera_that_cannot_be_used(folder, capsys):
    cameras = ["[" * 100_000, '{"fov": 20}', json.dumps(CAMERA).replace("20", "2" * 5000)]
    cameras += [json.dumps(CAMERA).replace("-90", word) for word in ("NaN", "9e300", '"far"')]
    cameras += [json.dumps(CAMERA | {"viewMat": [0] * count}) for count in (15, 16)]
    for text in (*cameras, json.dumps(CAMERA | {"fov": 180})):
        write(folder, "camera.json", text)
        arguments = ["a-scene.txt", "--camera", "camera.json", *RECORDED, "--screenshots", "p"]
        assert_refused(folder, capsys, arguments, "camera.json: this is not a Polyscope camera")


def test_recording_that_cannot_be_used(folder, capsys):
    (folder / "empty.h5").touch()
    with h5py.File("other.h5", "w") as file:
        file["numbers"] = np.arange(9)
    for name in ("none.h5", "folder.mesh", "empty.h5", "t.mesh", "other.h5"):
        cause = "not a recording" if (folder / name).is_file() else "cannot be read"
        for option in ("--replay", "--resume", "--verify"):
            assert_refused(folder, capsys, [option, name], f"{name}: ", cause)


# Words behind the scene's name, and what the line begins with, each with another cause.
OPTIONS = [
    ("--rest 0.5", "unrecognized arguments: --rest 0.5"),
    ("--gra\nvity", "unrecognized arguments: --gra vity"),
    ("--steps ٣", "argument --steps: "),
    ("--steps " + "1" * 5000, "argument --steps: "),
    ("--video v.avi", "argument --video: "),
    ("--every 3", "--every "),
    ("--video v.mp4 --screenshots s --transparent", "--transparent cannot be used with --video"),
    ("--replay r.h5", "SCENE cannot be used with --replay"),
    ("--video v.mp4 --time-step 200", "v.mp4: "),
    (
        "--camera camera.json --screenshots p --stats ./camera.json",
        "--stats ./camera.json: not written",
    ),
    ("--export b.gltf", "argument --export: "),
    ("--plot p.pdf", "argument --plot: the name of a plot must end in .png"),
    ("--record r.h5x", "argument --record: the name of a recording must end in .h5 or .hdf5"),
    ("--stats -", "argument --stats: must name a file"),
    ("--screenshots -", "argument --screenshots: must name a file or folder"),
    ("--look studio", "--look needs --screenshots or --video, or the window"),
    ("--show contacts", "--show needs --screenshots or --video, or the window"),
    ("--colours speed", "--colours needs --screenshots or --video, or the window"),
    ("--legend --stats s.csv", "--legend needs --screenshots or --video, or the window"),
    ("--size 320x180", "--size needs --screenshots or --video, or the window"),
    ("--camera camera.json", "--camera needs --screenshots or --video, or the window"),
    ("--look nice --screenshots p", "argument --look: "),
    ("--record no/r.h5", "no/r.h5: No such file"),
    ("--stats folder.mesh", "folder.mesh: Is a directory"),
    (f"--record {'x' * 300}.h5", "x" * 100),
]


@pytest.mark.parametrize("case", OPTIONS, ids=[words[:40] for words, _ in OPTIONS])
def test_option_that_cannot_be_used(folder, capsys, case):
    words, beginning = case
    assert_refused(folder, capsys, ["tet", "--headless", *words.split(" ")], beginning)


@pytest.mark.parametrize("scene", ["", "nosuch", ".", "camera.json", "a\nb-scene.txt"])
def test_scene_that_is_none(folder, capsys, scene):
    write(folder, "a\nb-scene.txt", "0\n")
    beginning = scene.replace("\n", " ") + ":" if scene else "argument SCENE: "
    assert_refused(folder, capsys, [scene, *RECORDED], beginning)


@pytest.mark.parametrize("name", [*FILES, "r.h5"])
def test_a_run_does_not_write_over_what_it_reads(folder, capsys, name):
    record("r.h5", SceneSimulation("a-scene.txt"), 1)
    arguments = ["--resume", "r.h5", "--record"] if name == "r.h5" else ["a-scene.txt", "--stats"]
    message = f"{arguments[-1]} ./{name}: not written, because this run reads it"
    assert_refused(folder, capsys, [*arguments, f"./{name}"], message)


def test_program_ends_with_one_line_and_code_2(folder):
    before = snapshot(folder)
    process = run(folder, "t.mesh", *RECORDED)
    assert (process.returncode, process.stdout) == (2, "")
    (line,) = process.stderr.splitlines()
    assert line.startswith("RigidBodySimulation.py: t.mesh:1: not a scene: ")
    assert snapshot(folder) == before
