"""What the program is given and cannot use: each case ends in one line and exit code 2.

The line names the file, the line in it where there is one, and the cause; nothing is written. What
makes a text file a broken one stands in `test_loading.py`, what makes grader data so in
`test_graders.py`, and the fuzzing in `test_fuzzing.py`.
"""

import json
import os
import runpy
import subprocess
import sys

import h5py
import numpy as np
import pytest
from oracles import ROOT
from program import CAMERA, DATA, record, run
from test_loading import BROKEN, CUBE, SCENE, TETRAHEDRON, replaced

import rbs.cameras
import rbs.textfiles
from rbs.files import read_bytes
from rbs.recording import Recording
from rbs.simulation import Simulation
from rbs.textfiles import SceneError
from RigidBodySimulation import load_scene_file, main

FILES = {
    "cube.off": CUBE,
    "t.mesh": TETRAHEDRON,
    "a-scene.txt": SCENE,
    "a-constraints.txt": "1\n0 1 1 2 0.5 1.25\n",
    "camera.json": json.dumps(CAMERA),
}
# What would be written.
RECORDED = ["--steps", "1", "--record", "new.h5", "--stats", "s.csv"]


def as_bytes(content):
    return content if isinstance(content, bytes) else content.encode()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with FILES in it, and a folder."""
    for name, content in FILES.items():
        (tmp_path / name).write_bytes(as_bytes(content))
    (tmp_path / "folder.mesh").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def snapshot(folder):
    """Names and contents of all files below a folder."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
    }


def outcome(arguments, capsys):
    """(exit code, output, errors) of the program, run in this process."""
    try:
        code = main([str(argument) for argument in arguments])
    except SystemExit as ended:  # argparse does not return
        code = ended.code
    return code, *capsys.readouterr()


def assert_refused(folder, arguments, message, capsys, code=2):
    """One line that goes on like the message after the program's name, that exit code, no file."""
    before = snapshot(folder)
    got, output, errors = outcome(arguments, capsys)
    assert (got, output) == (code, ""), errors
    (line,) = errors.splitlines()
    assert line.startswith(f"RigidBodySimulation.py: {message}"), line
    assert line.isprintable() and len(line) < 400
    assert snapshot(folder) == before


# --------------------------------------------------------------------------------------------------
# Text files
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", BROKEN)
def test_text_file_that_cannot_be_used(folder, capsys, case):
    name, change, message = BROKEN[case]
    (folder / name).write_bytes(as_bytes(change(FILES[name])))
    assert_refused(folder, ["a-scene.txt", *RECORDED], name + message, capsys)


def with_vertices_twice(text):
    """Each vertex of the tetrahedra once more behind the others; nothing uses them."""
    vertices = text[text.index("5\n") + 2 : text.index("Triangles")]
    return text.replace("5\n" + vertices, "10\n" + vertices + vertices)


LEGAL_MESHES = {
    "every vertex twice": ("t.mesh", with_vertices_twice),
    "reference numbers of any kind": ("t.mesh", replaced("0 2 0 1", "0 2 0 -1.5")),
    "numbers with a sign": ("t.mesh", replaced("0 2 0 1", "+0 +2.0e+0 -0 1")),
    "a face of no area": ("cube.off", lambda text: text.replace("8 6 12", "9 7 12").replace(
        "4 3 2 1 0", "5 3 2 1 8 0\n3 0 8 1", 1).replace("0 1 1\n", "0 1 1\n0.5 0 0\n", 1)),
    "quaternion of huge numbers": ("a-scene.txt", replaced("2 0 0 0", "1e308 1e308 1e308 1e308")),
    "quaternion of tiny numbers": ("a-scene.txt", replaced("2 0 0 0", "5e-324 0 0 0")),
    "mesh in a folder below": ("a-scene.txt", replaced("t.mesh", "folder.mesh/../t.mesh")),
}  # fmt: skip


@pytest.mark.parametrize("case", LEGAL_MESHES)
def test_odd_and_legal_file_is_simulated(folder, capsys, case):
    name, change = LEGAL_MESHES[case]
    mass = load_scene_file("a-scene.txt")[2].mass
    (folder / name).write_bytes(as_bytes(change(FILES[name])))
    code, output, errors = outcome(["a-scene.txt", "--headless", "--steps", "3"], capsys)
    assert (code, errors) == (0, "") and "all finite" in output
    assert load_scene_file("a-scene.txt")[2].mass == pytest.approx(mass, rel=1e-12)


# --------------------------------------------------------------------------------------------------
# Files that are missing, folders, or too long
# --------------------------------------------------------------------------------------------------


def make_folder(path):
    path.unlink(missing_ok=True)
    path.mkdir()


NO_FILES = {
    "mesh, none": ("t.mesh", os.unlink, "a-scene.txt:4: there is no mesh file 't.mesh' beside"),
    "scene, a folder": ("a-scene.txt", make_folder, "a-scene.txt: this is a folder, not a file"),
    "mesh, a folder": ("cube.off", make_folder, "cube.off: this is a folder, not a file"),
    "constraints, a folder": ("a-constraints.txt", make_folder,
                              "a-constraints.txt: this is a folder, not a file"),
    "camera, none": ("camera.json", os.unlink, "camera.json: No such file or directory"),
    "camera, a folder": ("camera.json", make_folder, "camera.json: Is a directory"),
}  # fmt: skip


@pytest.mark.parametrize("case", NO_FILES)
def test_what_is_no_file_is_not_read(folder, capsys, case):
    name, make, message = NO_FILES[case]
    make(folder / name)
    options = ["--camera", "camera.json", *RECORDED]
    assert_refused(folder, ["a-scene.txt", *options], message, capsys)


def test_name_that_is_not_for_a_terminal_is_told_in_one_line(folder, capsys):
    (folder / "a\nb-scene.txt").write_text("0\n")
    assert_refused(folder, ["a\nb-scene.txt", "--headless"], "a b-scene.txt:1: this is not", capsys)


@pytest.mark.parametrize("name", ["a-scene.txt", "t.mesh", "cube.off", "a-constraints.txt"])
def test_text_file_over_the_limit_is_not_read(folder, monkeypatch, capsys, name):
    limit = 2 * max(map(len, FILES.values()))
    monkeypatch.setattr(rbs.textfiles, "read_bytes", lambda path: read_bytes(path, limit))
    assert outcome(["a-scene.txt", "--headless", "--steps", "1"], capsys)[0] == 0
    with open(folder / name, "ab") as file:
        file.write(b"#" * limit)
    message = f"{name}: cannot be read (longer than {limit} bytes, the most that is read)"
    assert_refused(folder, ["a-scene.txt", *RECORDED], message, capsys)


def test_camera_over_the_limit_is_not_read(folder, monkeypatch, capsys):
    monkeypatch.setattr(rbs.cameras, "CAMERA_BYTES", 50)
    arguments = ["a-scene.txt", "--headless", "--camera", "camera.json"]
    message = "camera.json: longer than 50 bytes, the most that is read"
    assert_refused(folder, arguments, message, capsys)


# --------------------------------------------------------------------------------------------------
# Meshes outside of the scene's folder
# --------------------------------------------------------------------------------------------------


@pytest.fixture
def outside(folder):
    """A folder `scenes` whose scenes reach for t.mesh, which lies beside it, in four ways."""
    scenes = folder / "scenes"
    (scenes / "down").mkdir(parents=True)
    for name, mesh in {
        "dots": "../t.mesh", "absolute": str(folder / "t.mesh"), "link": "link.mesh",
        "folderLink": "up/t.mesh", "inside": "down/../link2.mesh",
    }.items():  # fmt: skip
        (scenes / f"{name}-scene.txt").write_text(f"1\n{mesh} 1 0 0 5 0 1 0 0 0\n")
    (scenes / "link.mesh").symlink_to(folder / "t.mesh")
    (scenes / "up").symlink_to(folder)
    (scenes / "own.mesh").write_text(TETRAHEDRON)
    (scenes / "link2.mesh").symlink_to("own.mesh")
    return scenes


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such links")
@pytest.mark.parametrize("name", ["dots", "absolute", "link", "folderLink"])
def test_mesh_outside_of_the_scenes_folder_is_read_only_when_asked_for(outside, capsys, name):
    scene = f"scenes/{name}-scene.txt"
    assert_refused(outside.parent, [scene, *RECORDED], f"{scene}:2: the mesh file '", capsys)
    for load in (load_scene_file, Simulation):
        with pytest.raises(SceneError, match="lies outside of the scene's folder; --allow-outs"):
            load(scene)
    (mesh,) = load_scene_file(scene, allowOutsideMeshes=True)
    assert len(mesh.tets) == 2
    options = ["--headless", "--steps", "2", "--record", "r.h5", "--allow-outside-meshes"]
    assert outcome([scene, *options], capsys)[0] == 0
    # A recording has its meshes in it.
    assert outcome(["--verify", "r.h5"], capsys)[0] == 0


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such links")
def test_mesh_inside_may_be_reached_in_any_way(outside, monkeypatch):
    assert len(load_scene_file("scenes/inside-scene.txt")) == 1
    # So may all of it through a link to the scene's folder.
    (outside.parent / "alias").symlink_to(outside)
    assert len(load_scene_file("alias/inside-scene.txt")) == 1
    monkeypatch.chdir(outside)
    assert len(load_scene_file("inside-scene.txt")) == 1


# --------------------------------------------------------------------------------------------------
# Cameras
# --------------------------------------------------------------------------------------------------


def camera(**changes):
    return json.dumps(CAMERA | changes)


NO_CAMERA = ": this is not a camera of Polyscope's: it needs viewMat, a rigid motion as 16 numbers"
MATRIX = CAMERA["viewMat"]
CAMERAS = {
    "empty": ("", ":1: this is not a JSON file: Expecting value"),
    "binary": (b"\x89PNG\r\n\x1a\n\xff", NO_CAMERA),
    "comma missing": ('{"viewMat": [0, 1, 2]\n"fov": 3}', ":2: this is not a JSON file: Expecting"),
    "bracket without end": ("[" * 100_000, NO_CAMERA),
    "number of 5000 digits": (camera().replace("20", "2" * 5000), NO_CAMERA),
    "number of 400 digits": (camera().replace("90", "9" * 400), NO_CAMERA),
    "a list": ("[1, 2, 3]", NO_CAMERA),
    "key missing": ('{"fov": 20}', NO_CAMERA),
    "15 numbers": (camera(viewMat=MATRIX[:15]), NO_CAMERA),
    "words": (camera(viewMat=["far"] * 16), NO_CAMERA),
    "null": (camera(fov=None), NO_CAMERA),
    "NaN": (camera(viewMat=[*MATRIX[:15], float("nan")]), NO_CAMERA),
    "too far": (camera().replace("90", "9e300"), NO_CAMERA),
    "no motion": (camera(viewMat=[0] * 16), NO_CAMERA),
    "angle": (camera(fov=180), NO_CAMERA),
}


@pytest.mark.parametrize("case", CAMERAS)
def test_camera_that_cannot_be_used(folder, capsys, case):
    content, message = CAMERAS[case]
    (folder / "camera.json").write_bytes(as_bytes(content))
    arguments = ["a-scene.txt", "--camera", "camera.json", *RECORDED]
    assert_refused(folder, arguments, f"camera.json{message}", capsys)


# --------------------------------------------------------------------------------------------------
# Recordings
# --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """(the bytes of a recording of 31 states, the place of the positions of step 20 in them)."""
    path = tmp_path_factory.mktemp("recorded") / "r.h5"
    record(path, Simulation(DATA / "tower_chain-scene.txt"), 30)
    content = path.read_bytes()
    return content, content.index(Recording(path).frame(20)["positions"].tobytes())


def write_other_hdf5(path):
    with h5py.File(path, "w") as file:
        file["numbers"] = np.arange(9)


def write_flipped(path, content, place):
    path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])


RECORDINGS = {
    "none": (lambda path, *_: None, "cannot be read (No such file or directory)"),
    "a folder": (lambda path, *_: path.mkdir(), "cannot be read (Is a directory)"),
    "empty": (lambda path, *_: path.write_bytes(b""), "this is not a recording"),
    "text": (lambda path, *_: path.write_text(SCENE), "this is not a recording"),
    "another HDF5 file": (lambda path, *_: write_other_hdf5(path),
                          "this is an HDF5 file, but not a recording"),
    "cut off": (lambda path, content, _: path.write_bytes(content[:-300]), "it is damaged ("),
    "a flipped bit": (write_flipped, "it is damaged ("),
}  # fmt: skip


@pytest.mark.parametrize("option", ["--replay", "--resume", "--verify"])
@pytest.mark.parametrize("case", RECORDINGS)
def test_recording_that_cannot_be_used(folder, recorded, capsys, case, option):
    make, message = RECORDINGS[case]
    make(folder / "bad.h5", *recorded)
    outputs = [] if option == "--verify" else ["--stats", "s.csv"]
    # What --verify finds in a recording that can be opened is its result.
    code = 1 if (option, case) == ("--verify", "a flipped bit") else 2
    assert_refused(folder, [option, "bad.h5", *outputs], f"bad.h5: {message}", capsys, code)


# --------------------------------------------------------------------------------------------------
# Options
# --------------------------------------------------------------------------------------------------

OPTIONS = {
    "no such option": (["--gravity", "9"], "unrecognized arguments: --gravity 9"),
    "abbreviation": (["--rest", "0.5"], "unrecognized arguments: --rest 0.5"),
    "two lines": (["--gra\nvity"], "unrecognized arguments: --gra vity"),
    "two scenes": (["b"], "unrecognized arguments: b"),
    "value missing": (["--steps"], "argument --steps: expected one argument"),
    "dashes for a value": (["--steps=--"], "argument --steps: '--' is not a value"),
    **{
        f"{option} {value}": ([option, value], f"argument {option}: {message}")
        for option, value, message in [
            ("--restitution", "high", "must be a finite number, 0 to 1, not 'high'"),
            ("--restitution", "nan", "must be a finite number, 0 to 1, not nan"),
            ("--restitution", "1.1", "must be a finite number, 0 to 1, not 1.1"),
            ("--restitution", "0_1", "must be a finite number, 0 to 1, not '0_1'"),
            ("--time-step", "0", "must be a finite number, 1e-12 to 1000, not 0"),
            ("--time-step", "inf", "must be a finite number, 1e-12 to 1000, not inf"),
            ("--friction", "-1", "must be a finite number of 0 or more, not -1"),
            ("--broad-phase", "tree", "must be one of all, grid, not 'tree'"),
            ("--show", "stars", "invalid choice: 'stars'"),
            ("--max-iterations", "-1", "must be a whole number, 0 to 1e+15, not -1"),
            ("--steps", "1" * 400, "must be 1000000000000000 or less, not 1111"),
            ("--steps", "1.5", "'1.5' is not a whole number"),
            ("--steps", "-1", "must be 0 or more, not -1"),
            ("--steps", "٣", "'٣' is not a whole number"),
            ("--steps", "1" * 5000, "'1111"),
            ("--every", "0", "must be 1 or more, not 0"),
            ("--fps", "nan", "must lie between 0.01 and 240, not nan"),
            ("--size", "0x0", "must be WIDTHxHEIGHT, from 16 to 8192 pixels each, not '0x0'"),
            ("--size", "640", "must be WIDTHxHEIGHT, from 16 to 8192 pixels each, not '640'"),
            ("--video", "v.avi", "the name of a video must end in .mp4 or .gif, not 'v.avi'"),
            ("--record", "r.npz", "the name of a recording must end in .h5 or .hdf5, not 'r.npz'"),
            *((option, "", "the name of a file or folder must not be empty") for option in (
                "--constraints", "--screenshots", "--camera", "--replay", "--stats", "--plot")),
        ]
    },
    # what does not go together
    "every alone": (["--every", "3"], "--every says how often --screenshots or --video draws"),
    "fps alone": (["--fps", "30"], "--fps says how fast --video plays, which is missing"),
    "transparent alone": (["--transparent"], "--transparent says how --screenshots draws"),
    "from alone": (["--from", "3"], "--from says where --resume starts, which is missing"),
    "substeps alone": (["--substeps", "3"], "--substeps has no effect with --solver impulse"),
    "transparent video": (["--video", "v.mp4", "--screenshots", "s", "--transparent"],
                          "--transparent does not go with --video: videos have no transparency"),
    "constraints or not": (["--constraints", "a", "--no-constraints"],
                           "--constraints does not go with --no-constraints: all bodies go free"),
    "replay of a scene": (["--replay", "r.h5"], "SCENE does not go with --replay: a replay simul"),
    "resume of a scene": (["--resume", "r.h5"], "SCENE does not go with --resume: it goes on wit"),
    "verify of a scene": (["--verify", "r.h5"], "SCENE does not go with --verify: it only compar"),
    "replay and verify": (["--replay", "r.h5", "--verify", "r.h5"],
                          "argument --verify: not allowed with argument --replay"),
    # files
    "no constraint file": (["--constraints", "none.txt"], "none.txt: there is no such file"),
    "constraints are a mesh": (["--constraints", "cube.off"], "cube.off:1: the number of constra"),
    "statistics over the camera": (["--camera", "camera.json", "--stats", "./camera.json"],
                                   "--stats ./camera.json: not written, because this run reads"),
    "plot over the statistics": (["--plot", "x.png", "--stats", "folder.mesh/../x.png"],
                                 "--plot x.png: not written, because --stats writes it too"),
    "record to nowhere": (["--record", "no/r.h5"], "no/r.h5: No such file or directory"),
    "statistics to nowhere": (["--stats", "no/s.csv"], "no/s.csv: No such file or directory"),
    "plot below a file": (["--plot", "cube.off/p.png"], "cube.off/p.png: Not a directory"),
    "record below a file": (["--record", "cube.off/r.h5"], "cube.off/r.h5: Not a directory"),
    "statistics to a folder": (["--stats", "folder.mesh"], "folder.mesh: Is a directory"),
    "record to a long name": (["--record", "x" * 300 + ".h5"], "x" * 100),
    "video of a still": (["--video", "v.mp4", "--time-step", "200"],
                         "v.mp4: in real time there would be 0.005 pictures a second; say with"),
    "video of an instant": (["--video", "v.mp4", "--time-step", "1e-9", "--every", "1"],
                            "v.mp4: in real time there would be 1e+09 pictures a second; say with"),
}  # fmt: skip


@pytest.mark.parametrize("case", OPTIONS)
def test_option_that_cannot_be_used(folder, capsys, case):
    arguments, message = OPTIONS[case]
    assert_refused(folder, ["tet", "--headless", *arguments], message, capsys)


SCENES = {
    "": "argument SCENE: the name of a file or folder must not be empty",
    "nosuch": "nosuch: there is no such scene, neither a file nor one of ours",
    "b-scene.txt": "b-scene.txt: there is no such scene, neither a file nor one of ours",
    ".": ".: this is a folder, not a file",
    "cube.off": "cube.off:1: this is not a scene: the number of bodies must be a whole number, n",
    "camera.json": "camera.json:1: this is not a scene: the number of bodies takes 1 column, not",
}


@pytest.mark.parametrize("scene", SCENES)
def test_scene_that_is_none(folder, capsys, scene):
    assert_refused(folder, [scene, *RECORDED], SCENES[scene], capsys)


def test_a_recording_is_not_written_over_while_it_is_read(folder, recorded, capsys):
    (folder / "r.h5").write_bytes(recorded[0])
    message = "--record ./r.h5: not written, because this run reads it"
    assert_refused(folder, ["--resume", "r.h5", "--record", "./r.h5"], message, capsys)


# --------------------------------------------------------------------------------------------------
# Graders
# --------------------------------------------------------------------------------------------------

GRADERS = ROOT / "graders"


def test_grader_data_over_the_limit_are_not_read(folder, monkeypatch, capsys):
    with open("integration.data", "wb") as file:
        file.truncate((64 << 20) + 1)  # takes no room on the disk
    message = f"integration.data: is longer than {64 << 20} bytes"
    assert_grader_refuses(monkeypatch, capsys, [], message)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--data", "cube.off"], "cube.off/integration.data: cannot be read: Not a directory"),
        (["--data", "nowhere"], "nowhere/integration.data: cannot be read: No such file"),
        (["--convention", "newton"], "argument --convention: invalid choice: 'newton'"),
        (["everything"], "unrecognized arguments: everything"),
    ],
)
def test_grader_options_that_cannot_be_used(folder, monkeypatch, capsys, options, message):
    assert_grader_refuses(monkeypatch, capsys, options, message)


def assert_grader_refuses(monkeypatch, capsys, options, message):
    monkeypatch.setattr(sys, "argv", ["integrationGrading.py", "--data", ".", *options])
    monkeypatch.syspath_prepend(str(GRADERS))
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(GRADERS / "integrationGrading.py"), run_name="__main__")
    output, errors = capsys.readouterr()
    assert (ended.value.code, output) == (2, ""), errors
    (line,) = errors.splitlines()
    assert line.startswith(f"integrationGrading.py: {message}") and len(line) < 400, line


def test_reference_that_cannot_be_written_is_told_in_one_line(folder):
    command = [sys.executable, GRADERS / "make_reference.py", "--out", "cube.off"]
    process = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert (process.returncode, process.stdout) == (2, "")
    assert process.stderr == "make_reference.py: cube.off: File exists\n"


# --------------------------------------------------------------------------------------------------
# As a person meets it
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["a-scene.txt", "--steps", "many"], "argument --steps: 'many' is not a whole number"),
        (["t.mesh"], "t.mesh:1: this is not a scene: the number of bodies takes 1 column, not 2"),
        (["--verify", "camera.json"], "camera.json: this is not a recording"),
        (["a-scene.txt", "--camera", "t.mesh"], "t.mesh:1: this is not a JSON file: Expecting val"),
    ],
)
def test_program_ends_with_one_line_and_code_2(folder, arguments, message):
    before = snapshot(folder)
    process = run(folder, *arguments)
    assert (process.returncode, process.stdout) == (2, "")
    (line,) = process.stderr.splitlines()
    assert line.startswith(f"RigidBodySimulation.py: {message}")
    assert snapshot(folder) == before
