"""Every reader meets thousands of damaged files: real ones, mutated.

Bytes are flipped, lines deleted, doubled and swapped, words replaced by what readers stumble over,
ends cut off. Either something whole is loaded, or the reader's own error comes out, in one line;
and both must come out often, or the damage was too great or too small to test anything.

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
from test_loading import CUBE, SCENE, TETRAHEDRON

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

CASES = 400
# Of all cases, at least this share is loaded, and at least this share refused.
LEAST_SHARE = 0.04

NASTY_WORDS = [
    b"nan", b"-inf", b"inf", b"1e308", b"-1e308", b"1e-320", b"1e9", b"-1e9", b"0", b"-0.0", b"-1",
    b"1", b"2", b"3", b"9", b"1000000000", b"9" * 400, b"0x1F", b"1_000", b"1,5", b"1e", b"--1",
    b"+1", b"true", b"None", b"\xd9\xa3", b"#", b"\xef\xbb\xbf", b"\x00", b"\xff\xfe", b"..",
    b"../../etc/passwd", b"/dev/zero", b"cube.off", b"t.mesh", b"t.mesh/", b"a-scene.txt", b"End",
    b"Vertices", b"Triangles", b"Tetrahedra", b"OFF", b"[", b"}", b'"', b"1e400", b"", b" ",
]  # fmt: skip


def mutated_text(content, operations):
    """The bytes of a text after some operations, each (kind, place, place, number)."""
    for kind, one, other, number in operations:
        lines = content.split(b"\n")
        i, j = one % len(lines), other % len(lines)
        if kind == "flip":
            content = mutated_bytes(content, [(kind, one, other, number)])
        elif kind == "cut":
            content = content[: len(content) - one % (len(content) // 4 + 1)]
        elif kind == "delete":
            content = b"\n".join(lines[:i] + lines[i + 1 :])
        elif kind == "double":
            content = b"\n".join(lines[: i + 1] + lines[i:])
        elif kind == "swap":
            lines[i], lines[j] = lines[j], lines[i]
            content = b"\n".join(lines)
        elif kind == "comment":
            lines[i] += b" # " + NASTY_WORDS[number % len(NASTY_WORDS)]
            content = b"\n".join(lines)
        elif kind == "line end":
            content = content.replace(b"\n", b"\r\n")
        else:
            words = lines[i].split(b" ")
            words[other % len(words)] = NASTY_WORDS[number % len(NASTY_WORDS)]
            lines[i] = b" ".join(words)
            content = b"\n".join(lines)
    return content


def mutated_bytes(content, operations):
    """The bytes of any file after some operations, each (kind, place, place, number)."""
    for kind, one, other, number in operations:
        if not content:
            break
        i, j = one % len(content), other % len(content)
        low, high = min(i, j), min(max(i, j), min(i, j) + 64)
        if kind == "flip":
            content = content[:i] + bytes([content[i] ^ (1 << number % 8)]) + content[i + 1 :]
        elif kind == "cut":
            content = content[: len(content) - one % 300]
        elif kind == "delete":
            content = content[:low] + content[high:]
        elif kind == "double":
            content = content[:high] + content[low:]
        elif kind == "swap":
            content = content[:low] + content[low:high][::-1] + content[high:]
        else:
            word = NASTY_WORDS[number % len(NASTY_WORDS)]
            content = content[:i] + word + content[i + len(word) :]
    return content


KINDS = ["flip", "cut", "delete", "double", "swap", "word", "word", "word", "comment", "line end"]


def operations_of(generator):
    """One to three random operations, as `mutated_text` takes them."""
    number = generator.getrandbits
    return [
        (generator.choice(KINDS), number(30), number(30), number(9))
        for _ in range(generator.choice([1, 1, 1, 2, 3]))
    ]


def fuzz(name, check, error, cases=CASES):
    """Calls check(operations) for so many lists of them; counts what comes out of it.

    name : another name, other cases; check : returns where all is well; raises `error`
    """
    outcomes = Counter()

    def operations_from(seed):
        return operations_of(random.Random(f"{name} {seed}"))

    @settings(
        max_examples=cases, derandomize=True, database=None, deadline=None,
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    # One draw each: drawing every number by itself would take most of the time.
    @given(st.integers(0, 1 << 64).map(operations_from))
    def run(operations):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # a warning would be a second line
                warnings.simplefilter("ignore", NonConvexWarning)
                check(operations)
        except error as told:
            assert str(told).isprintable() and len(str(told)) < 1000
            outcomes["refused"] += 1
        else:
            outcomes["loaded"] += 1

    run()
    print(f"{outcomes['loaded']} loaded, {outcomes['refused']} refused")
    for name in ("loaded", "refused"):
        assert outcomes[name] >= LEAST_SHARE * cases, outcomes


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with a scene of two meshes and a constraint file."""
    files = {"cube.off": CUBE, "t.mesh": TETRAHEDRON, "a-scene.txt": SCENE,
             "a-constraints.txt": "2\n0 1 1 2 0.5 1.25\n2 0 1 3 0 1\n"}  # fmt: skip
    for name, content in files.items():
        (tmp_path / name).write_bytes(content.encode())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def assert_sound(meshes):
    """Bodies that can be simulated."""
    for mesh in meshes:
        assert 0.0 < mesh.mass < math.inf and np.isfinite(mesh.currVertices).all()
        assert np.isfinite(mesh.invIT).all()
        assert abs(np.linalg.norm(mesh.orientation) - 1.0) < 1e-12


@pytest.mark.parametrize("name", ["t.mesh", "cube.off", "octahedron.mesh", "tetrahedron.mesh"])
def test_mesh(folder, name):
    source = folder / name
    content = (source if source.exists() else DATA / name).read_bytes()

    def check(operations):
        source.write_bytes(mutated_text(content, operations))
        vertices, faces, tets = load_mesh_file(source)
        assert np.isfinite(vertices).all() and faces.shape[1:] == (3,) and tets.shape[1:] == (4,)
        for indices in (faces, tets):
            assert 0 <= indices.min() <= indices.max() < len(vertices)
        assert np.all(tetrahedron_volumes(vertices, tets) > 0.0)

    fuzz(f"mesh {name}", check, SceneError)


@pytest.mark.parametrize("name", ["a-scene.txt", "t.mesh", "cube.off"])
def test_scene(folder, name):
    content = (folder / name).read_bytes()

    def check(operations):
        (folder / name).write_bytes(mutated_text(content, operations))
        meshes = load_scene_file("a-scene.txt")
        assert len(meshes) >= 1
        assert_sound(meshes)

    fuzz(f"scene {name}", check, SceneError)


def test_constraints(folder):
    path = folder / "a-constraints.txt"
    content, meshes = path.read_bytes(), load_scene_file("a-scene.txt")

    def check(operations):
        path.write_bytes(mutated_text(content, operations))
        for m1, v1, m2, v2, refValue, _ in load_constraint_file(path, meshes):
            assert 0 <= v1 < len(meshes[m1].origVertices)
            assert 0 <= v2 < len(meshes[m2].origVertices)
            assert 0.0 <= refValue < math.inf

    fuzz("constraints", check, SceneError)


def test_what_is_loaded_can_be_simulated(folder):
    content = (folder / "a-scene.txt").read_bytes()

    def check(operations):
        (folder / "a-scene.txt").write_bytes(mutated_text(content, operations))
        simulation = Simulation("a-scene.txt")
        simulation.step()
        simulation.step()
        assert simulation.is_finite()

    fuzz("simulated", check, SceneError, cases=300)


def test_camera(folder):
    path = folder / "camera.json"
    content = json.dumps(CAMERA, indent=1).encode()

    def check(operations):
        path.write_bytes(mutated_text(content, operations))
        camera = load_camera(path)
        assert camera["viewMat"].shape == (4, 4) and np.isfinite(camera["viewMat"]).all()
        assert 0.0 < camera["fov"] < 180.0

    fuzz("camera", check, CameraError)


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

    def check(operations):
        # Behind these bytes, most are in no use yet.
        changed = mutated_bytes(content[:12_000], operations)
        path.write_bytes(changed + content[len(changed) :])
        recording = Recording(path)
        Replay(recording).seek(recording.lastStep)
        verify(recording)

    fuzz(f"recording {isKilled}", check, (RecordingError, SceneError))
    assert verify(Recording("r.h5")) == ""


@pytest.mark.parametrize("protocol", [0, 2, 5])
def test_grader_data(folder, protocol):
    path = folder / "integration.data"
    data = pickle.loads((DATA / path.name).read_bytes())
    few = {key: np.array(value)[:3] for key, value in data.items()}
    content = pickle.dumps(few, protocol=protocol)

    def check(operations):
        path.write_bytes(mutated_bytes(content, operations))
        data = load_grader_data(path, INTEGRATION_LAYOUT)
        for key in INTEGRATION_LAYOUT:
            assert data[key].dtype == np.float64
        assert np.isfinite(data["randomPositions"]).all()

    fuzz(f"grader {protocol}", check, GraderDataError)


NUMBERS = ["--restitution", "--time-step", "--friction", "--max-iterations", "--steps", "--every",
           "--fps", "--size", "--from"]  # fmt: skip


def test_options():
    parser = make_parser()
    alphabet = "0123456789.eE+-_xX \n\u0663naif"

    class Refused(Exception):
        pass

    def check(operations):
        generator = random.Random(str(operations))
        word = generator.choice(NASTY_WORDS).decode(errors="replace")
        if generator.random() < 0.6:
            word = "".join(generator.choices(alphabet, k=generator.randint(0, 6)))
        told = io.StringIO()
        try:
            with contextlib.redirect_stderr(told):
                options = vars(parser.parse_args([f"{generator.choice(NUMBERS)}={word}"]))
            assert len(options) == 1
        except SystemExit as ended:
            assert ended.code == 2
            raise Refused(told.getvalue().removesuffix("\n")) from None
        for name in {"restitution", "time_step", "friction", "fps"} & set(options):
            assert 0.0 <= options[name] < math.inf
        for name in {"max_iterations", "steps", "every", "from_step"} & set(options):
            assert 0 <= options[name] <= MOST_STEPS

    fuzz("options", check, Refused)
