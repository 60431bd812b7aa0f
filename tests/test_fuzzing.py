"""Every reader meets hundreds of damaged files: real ones, mutated.

Bytes are flipped, lines and pieces deleted, doubled and swapped, words replaced by what readers
stumble over, ends cut off. Either something whole is loaded, or the reader's own error comes out,
in one line; and both must come out often, or the damage was too great or too small.

The cases are the same in every run.
"""

import contextlib
import io
import json
import math
import pickle
import random
import sys
import warnings
from collections import Counter

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from oracles import ROOT
from program import CAMERA, DATA, record
from test_loading import FILES, write

import rbs.recording
from rbs.cameras import CameraError, load_camera
from rbs.meshfiles import tetrahedron_volumes
from rbs.options import MOST_STEPS, make_parser
from rbs.recording import Recorder, Recording, RecordingError
from rbs.replay import Replay, verify
from rbs.scenes import NonConvexWarning
from rbs.simulation import Simulation
from rbs.textfiles import SceneError
from RigidBodySimulation import load_constraint_file, load_mesh_file, load_scene_file

sys.path.insert(0, str(ROOT / "graders"))

from gradingTools import INTEGRATION_LAYOUT, GraderDataError, load_grader_data

CASES = 150
# Of all cases, at least this share is loaded, and at least this share refused.
LEAST_SHARE = 0.08

NASTY_WORDS = (
    *(b"nan", b"-inf", b"1e308", b"1e-320", b"1e9", b"0", b"-0.0", b"-1", b"1", b"3", b"9" * 400),
    *(b"0x1F", b"1_000", b"1,5", b"--1", b"+1", b"true", b"\xd9\xa3", b"#", b"\xef\xbb\xbf"),
    *(b"\x00", b"..", b"../../etc/passwd", b"/dev/zero", b"t.mesh/", b"a-scene.txt", b"End"),
    *(b"Vertices", b"Triangles", b"OFF", b"[", b"}", b'"', b"1e400", b"", b" "),
)


def mutated_text(content, generator):
    """The bytes of a text after one to three operations on its lines."""
    for _ in range(generator.choice([1, 1, 1, 2, 3])):
        lines = content.split(b"\n")
        i, j = generator.randrange(len(lines)), generator.randrange(len(lines))
        words, nasty = lines[i].split(b" "), generator.choice(NASTY_WORDS)
        kind = generator.choice("flip cut delete double swap comment ends word word word".split())
        if kind == "flip":
            content = mutated_bytes(content, generator, "flip")
            continue
        if kind == "cut":
            lines[-1:] = [] if i % 2 else [lines[-1][:-3]]
        elif kind == "delete":
            del lines[i]
        elif kind == "double":
            lines.insert(i, lines[i])
        elif kind == "swap":
            lines[i], lines[j] = lines[j], lines[i]
        elif kind == "comment":
            lines[i] += b" # " + nasty
        elif kind == "ends":
            lines = [line + b"\r" for line in lines]
        else:
            words[j % len(words)] = nasty
            lines[i] = b" ".join(words)
        content = b"\n".join(lines)
    return content


def mutated_bytes(content, generator, *kinds):
    """The bytes of any file after one operation on them, of these kinds or any."""
    i = generator.randrange(len(content) + 1)
    j = min(i + generator.randrange(64), len(content))
    piece, word = content[i:j], generator.choice(NASTY_WORDS)
    kind = generator.choice(kinds or ("flip", "flip", "delete", "double", "reverse", "word"))
    if kind == "flip":
        piece = bytes([piece[0] ^ (1 << generator.randrange(8))]) + piece[1:] if piece else b""
    elif kind == "word":
        piece = word + piece[len(word) :]
    else:
        piece = {"delete": b"", "double": piece + piece, "reverse": piece[::-1]}[kind]
    return content[:i] + piece + content[j:]


def fuzz(name, check, error, cases=CASES):
    """Calls check(generator) so often; counts what comes out of it.

    name : another name, other cases; check : returns where all is well; raises `error`
    """
    outcomes = Counter()

    @settings(
        max_examples=cases,
        derandomize=True,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )
    # One draw each: drawing every number by itself would take most of the time.
    @given(st.integers(0, 1 << 64))
    def run(seed):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # a warning would be a second line
                warnings.simplefilter("ignore", NonConvexWarning)
                check(random.Random(f"{name} {seed}"))
        except error as told:
            assert str(told).isprintable() and len(str(told)) < 1000
            outcomes["refused"] += 1
        else:
            outcomes["loaded"] += 1

    run()
    print(outcomes)
    assert min(outcomes["loaded"], outcomes["refused"]) >= LEAST_SHARE * cases, outcomes


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with a scene of two meshes, a constraint file and a camera."""
    for name, text in FILES.items():
        write(tmp_path, name, text)
    write(tmp_path, "a-constraints.txt", "2\n0 1 1 2 0.5 1.25\n2 0 1 3 0 1\n")
    write(tmp_path, "camera.json", json.dumps(CAMERA, indent=1))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def check_mesh(path):
    vertices, faces, tets = load_mesh_file(path)
    assert np.isfinite(vertices).all() and faces.shape[1:] == (3,) and tets.shape[1:] == (4,)
    for indices in (faces, tets):
        assert 0 <= indices.min() <= indices.max() < len(vertices)
    assert np.all(tetrahedron_volumes(vertices, tets) > 0.0)


def check_scene(path):
    """Bodies that can be simulated."""
    simulation = Simulation("a-scene.txt")
    for mesh in simulation.meshes:
        assert 0.0 < mesh.mass < math.inf and np.isfinite(mesh.invIT).all()
        assert abs(np.linalg.norm(mesh.orientation) - 1.0) < 1e-12
    simulation.step()
    assert simulation.is_finite()


def check_constraints(path):
    meshes = load_scene_file("a-scene.txt")
    for m1, v1, m2, v2, refValue, _ in load_constraint_file(path, meshes):
        assert 0 <= v1 < len(meshes[m1].origVertices)
        assert 0 <= v2 < len(meshes[m2].origVertices)
        assert 0.0 <= refValue < math.inf


def check_camera(path):
    camera = load_camera(path)
    assert camera["viewMat"].shape == (4, 4) and np.isfinite(camera["viewMat"]).all()
    assert 0.0 < camera["fov"] < 180.0


@pytest.mark.parametrize(
    ("name", "check", "error"),
    [
        ("t.mesh", check_mesh, SceneError),
        ("cube.off", check_mesh, SceneError),
        ("a-scene.txt", check_scene, SceneError),
        ("t.mesh", check_scene, SceneError),
        ("a-constraints.txt", check_constraints, SceneError),
        ("camera.json", check_camera, CameraError),
    ],
)
def test_text_file(folder, name, check, error):
    content = (folder / name).read_bytes()

    def check_mutated(generator):
        (folder / name).write_bytes(mutated_text(content, generator))
        check(folder / name)

    fuzz(f"{name} {check.__name__}", check_mutated, error)


@pytest.mark.parametrize("isKilled", [False, True])
def test_recording(folder, monkeypatch, isKilled):
    """Whole, and as a killed run leaves it."""
    monkeypatch.setattr(rbs.recording, "READ_ATTEMPTS", 10)  # else it would take long
    simulation = Simulation("a-scene.txt")
    if isKilled:
        recorder = Recorder("r.h5")
        for _ in range(3):
            recorder.add(simulation)
            simulation.step()
        recorder.flush()
    else:
        record("r.h5", simulation, 2)
    content, path = (folder / "r.h5").read_bytes(), folder / "bad.h5"

    def check(generator):
        # Behind these bytes, most are in no use yet.
        changed = mutated_bytes(content[:12_000], generator)
        path.write_bytes(changed + content[len(changed) :])
        recording = Recording(path)
        Replay(recording).seek(recording.lastStep)
        verify(recording)

    fuzz(f"recording {isKilled}", check, (RecordingError, SceneError), cases=100)
    assert verify(Recording("r.h5")) == ""


def test_grader_data(folder):
    path = folder / "integration.data"
    data = pickle.loads((DATA / path.name).read_bytes())
    content = pickle.dumps({key: np.array(value)[:3] for key, value in data.items()})

    def check(generator):
        path.write_bytes(mutated_bytes(content, generator))
        data = load_grader_data(path, INTEGRATION_LAYOUT)
        assert all(data[key].dtype == np.float64 for key in INTEGRATION_LAYOUT)
        assert np.isfinite(data["randomPositions"]).all()

    fuzz("grader", check, GraderDataError)


NUMBERS = "restitution time_step friction fps max_iterations steps every from size".split()


def test_options():
    parser = make_parser()

    class Refused(Exception):
        pass

    def check(generator):
        word = generator.choice(NASTY_WORDS).decode(errors="replace")
        if generator.random() < 0.6:
            word = "".join(generator.choices("0123456789.eE+-_xX \n\u0663naif", k=3))
        option = generator.choice(NUMBERS)
        told = io.StringIO()
        try:
            with contextlib.redirect_stderr(told):
                options = vars(parser.parse_args([f"--{option.replace('_', '-')}={word}"]))
        except SystemExit as ended:
            assert ended.code == 2
            raise Refused(told.getvalue().removesuffix("\n")) from None
        (value,) = options.values()
        for number in value if option == "size" else [value]:
            assert 0.0 <= number <= (MOST_STEPS if isinstance(number, int) else 1e308)

    fuzz("options", check, Refused)
