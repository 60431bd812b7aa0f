"""The command line by subprocess, and the simulation behind it."""

import errno
import io
import json
import math
import os
import signal
import struct
import subprocess
import sys
import time

import numpy as np
import pytest
from opengl import require_opengl
from oracles import COURSE, ROOT, needs_course
from program import CAMERA, DATA, by_hand, environment, run, summary_of

from rbs import headless
from rbs.backends import DEBIAN_PACKAGES
from rbs.headless import run_steps
from rbs.simulation import DEFAULT_RESTITUTION, DEFAULT_TIME_STEP, Simulation
from rbs.state import STATE_NAMES
from rbs.textfiles import SceneError
from RBSFunctions import Mesh
from RigidBodySimulation import FALLBACK_PICTURES, load_constraint_file, load_scene_file, main

onLinux = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="displays and EGL are found this way on Linux only"
)


def picture_size(path):
    """(width, height) out of a PNG's header."""
    content = path.read_bytes()
    assert content[:8] == b"\x89PNG\r\n\x1a\n" and content[12:16] == b"IHDR"
    return struct.unpack(">II", content[16:24])


# --------------------------------------------------------------------------------------------------
# The simulation
# --------------------------------------------------------------------------------------------------


def test_energies_are_those_of_the_closed_forms():
    simulation = Simulation(DATA / "singlebox-scene.txt")
    (mesh,) = simulation.meshes
    mesh.linVelocity = np.array([[3.0, -1.0, 2.0]])
    # Spinning about the body's own axes by (1, 2, 3) rad/s while it stands turned by a third of a
    # turn about (1, 1, 1), which takes x to y, y to z and z to x.
    mesh.orientation = np.array([[0.5, 0.5, 0.5, 0.5]])
    mesh.angVelocity = np.array([[3.0, 1.0, 2.0]])
    mesh.position = np.array([[0.0, 7.0, 0.0]])
    a, b, c = 12.0, 6.0, 8.0
    turning = (b * b + c * c) * 1.0 + (c * c + a * a) * 4.0 + (a * a + b * b) * 9.0
    kinetic = mesh.mass * (0.5 * (9.0 + 1.0 + 4.0) + 0.5 * turning / 12.0)
    assert simulation.kinetic_energy() == pytest.approx(kinetic, rel=1e-12)
    assert simulation.potential_energy() == pytest.approx(mesh.mass * 9.8 * 7.0, rel=1e-12)


def test_fixed_bodies_have_no_energy(tmp_path):
    (tmp_path / "box.mesh").write_bytes((DATA / "box.mesh").read_bytes())
    scene = tmp_path / "fixed-scene.txt"
    scene.write_text("1\nbox.mesh 1 1 0 9 0 1 0 0 0\n")
    simulation = Simulation(scene)
    simulation.step()
    assert simulation.kinetic_energy() == simulation.potential_energy() == 0.0
    assert simulation.lowest_point() == (6.0, "box 0")


def test_reset_leads_to_the_same_bits_again():
    simulation = Simulation(DATA / "mixed-scene.txt")
    start = simulation.state()
    for _ in range(80):
        simulation.step()
    first = simulation.state()
    assert simulation.stepCount == 80 and simulation.time == pytest.approx(1.6)
    simulation.reset()
    assert simulation.stepCount == 0 and simulation.time == 0.0
    for name in STATE_NAMES:
        np.testing.assert_array_equal(simulation.state()[name], start[name])
        assert not np.array_equal(first[name], start[name]), name
    for _ in range(80):
        simulation.step()
    for name in STATE_NAMES:
        np.testing.assert_array_equal(simulation.state()[name], first[name])


def test_state_put_into_another_simulation_goes_on_with_the_same_bits():
    one, other = Simulation(DATA / "stress-scene.txt"), Simulation(DATA / "stress-scene.txt")
    for _ in range(100):
        one.step()
    other.set_state(one.state())
    for mesh, twin in zip(one.meshes, other.meshes, strict=True):
        np.testing.assert_array_equal(mesh.currVertices, twin.currVertices)
    for _ in range(20):
        one.step()
        other.step()
    for name in STATE_NAMES:
        np.testing.assert_array_equal(one.state()[name], other.state()[name])


def test_state_is_a_copy():
    simulation = Simulation(DATA / "singlebox-scene.txt")
    state = simulation.state()
    before = state["positions"].copy()
    simulation.step()
    np.testing.assert_array_equal(state["positions"], before)
    simulation.set_state(state)
    state["positions"][:] = 0.0
    np.testing.assert_array_equal(simulation.meshes[0].position, before)


def test_broken_scene_leaves_the_simulation_as_it_was(tmp_path):
    simulation = Simulation(DATA / "tet-scene.txt")
    simulation.step()
    meshes, state = simulation.meshes, simulation.state()
    (tmp_path / "b-scene.txt").write_text("1\nnothing.mesh 1 0 0 0 0 1 0 0 0\n")
    with pytest.raises(SceneError, match="nothing.mesh"):
        simulation.load(tmp_path / "b-scene.txt")
    assert simulation.meshes is meshes and simulation.stepCount == 1
    assert simulation.scenePath == DATA / "tet-scene.txt"
    np.testing.assert_array_equal(simulation.state()["positions"], state["positions"])


def test_non_finite_numbers_are_noticed():
    simulation = Simulation(DATA / "two_cylinder-scene.txt")
    assert simulation.is_finite()
    simulation.meshes[1].angVelocity = np.array([[0.0, math.nan, 0.0]])
    assert not simulation.is_finite()


def test_ground_is_the_contract_s():
    groundMesh = Simulation(DATA / "singlebox-scene.txt").groundMesh
    assert isinstance(groundMesh, Mesh) and groundMesh.isFixed and groundMesh.invMass == 0.0
    assert groundMesh.origVertices.shape == (0, 3) and groundMesh.faces.shape == (0, 3)
    assert groundMesh.tets.shape == (0, 4) and groundMesh.position.tolist() == [[0, 0, 0]]


# --------------------------------------------------------------------------------------------------
# Headless runs
# --------------------------------------------------------------------------------------------------


def test_headless_run_ends_with_a_summary_of_what_happened(tmp_path):
    summary = summary_of(run(tmp_path, "mixed", "--basic", "--headless", "--steps", 120))
    simulation = Simulation(DATA / "mixed-scene.txt")
    potential = simulation.potential_energy()
    for _ in range(120):
        simulation.step()
    y, name = simulation.lowest_point()
    assert summary["scene"].endswith("mixed-scene.txt")
    assert summary["bodies"] == "7, 0 of them fixed"
    assert summary["steps"] == "120 of 0.02 s: 2.4 s simulated"
    assert float(summary["time per step"].split(" ms median")[0]) > 0.0
    # This scene weighs 480 t.
    assert summary["kinetic energy"] == (
        f"0 J at the start, {simulation.kinetic_energy() / 1e6:.6g} MJ now"
    )
    assert summary["potential energy"] == (
        f"{potential / 1e6:.6g} MJ at the start, {simulation.potential_energy() / 1e6:.6g} MJ now"
    )
    assert summary["lowest point"] == f"y = {y:.4g} m ({name})"
    assert summary["numbers"] == "all finite"
    assert list(tmp_path.iterdir()) == []


def test_headless_run_does_not_import_polyscope(tmp_path):
    fakes = tmp_path / "fakes"
    fakes.mkdir()
    (fakes / "polyscope.py").write_text("raise SystemExit('polyscope was imported')")
    process = run(tmp_path, "tet", "--headless", "--steps", 2, "--record", "r.npz",
                  PYTHONPATH=str(fakes))  # fmt: skip
    assert summary_of(process)["recording"] == "r.npz" and process.stderr == ""


class Terminal(io.StringIO):
    """Takes what a terminal, or a log, is told."""

    def __init__(self, isTerminal):
        super().__init__()
        self._isTerminal = isTerminal

    def isatty(self):
        return self._isTerminal


def progress_of(monkeypatch, stream, steps=30):
    """What a run of so many steps writes to a stream that stands for stderr."""
    monkeypatch.setattr(sys, "stderr", stream)
    simulation = Simulation(DATA / "singletet-scene.txt")
    assert run_steps(simulation, steps) is not None and simulation.stepCount == steps
    return stream.getvalue() if isinstance(stream, io.StringIO) else None


def test_progress_moves_in_a_terminal_and_is_wiped_at_the_end(monkeypatch):
    monkeypatch.setattr(headless, "TERMINAL_SECONDS", 1e-9)
    drawn = [line for line in progress_of(monkeypatch, Terminal(True)).split("\r") if line.strip()]
    assert len(drawn) > 20 and "\n" not in "".join(drawn)
    assert " 1/30" in drawn[0] and "30/30" in drawn[-1] and "step/s" in drawn[-1]


def test_progress_is_told_seldom_in_a_log(monkeypatch):
    assert progress_of(monkeypatch, Terminal(False)) == ""
    assert headless.LOG_SECONDS >= 10.0
    monkeypatch.setattr(headless, "LOG_SECONDS", 1e-9)
    assert "30/30" in progress_of(monkeypatch, Terminal(False))


class Broken(Terminal):
    """Fails as a full disk does."""

    def write(self, text):
        raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("isTerminal", [True, False])
def test_progress_that_cannot_be_shown_ends_no_run(monkeypatch, isTerminal):
    monkeypatch.setattr(headless, "TERMINAL_SECONDS", 1e-9)
    monkeypatch.setattr(headless, "LOG_SECONDS", 1e-9)
    progress_of(monkeypatch, Broken(isTerminal))
    progress_of(monkeypatch, None)


def test_no_step_is_a_run_too(tmp_path):
    summary = summary_of(
        run(tmp_path, "tower", "--headless", "--steps", 0, "--record", "r.npz")
    )
    assert summary["time per step"] == "no step was made"
    assert np.load(tmp_path / "r.npz")["positions"].shape == (1, 9, 3)


@needs_course
def test_dented_mesh_is_told_in_one_line(tmp_path):
    process = run(tmp_path, COURSE / "two_cylinder-scene.txt", "--headless", "--steps", 1)
    assert summary_of(process)["bodies"] == "2, 0 of them fixed"
    (line,) = process.stderr.splitlines()
    assert line.startswith("RigidBodySimulation.py: warning: cylinder.mesh is not convex (volume ")


# --------------------------------------------------------------------------------------------------
# Constraints
# --------------------------------------------------------------------------------------------------

CHAIN = DATA / "tower_chain-scene.txt"
CHAIN_CONSTRAINTS = DATA / "tower_chain-constraints.txt"
# From step 53 on several of its constraints are taut, and the order of visits makes a difference.
CHAIN_STEPS = 70


def recording_of(folder, *arguments):
    """Runs the program in this process for CHAIN_STEPS steps; what it has recorded, as a dict."""
    path = folder / "r.npz"
    options = ["--headless", "--steps", str(CHAIN_STEPS), "--record", str(path)]
    assert main([*map(str, arguments), *options]) == 0
    with np.load(path) as recording:
        return dict(recording)


def chain_by_hand(file=None, **options):
    """Positions of the chain in each step by run_timestep alone, with the constraints of a file."""
    if file is not None:
        options["constraints"] = load_constraint_file(file, load_scene_file(CHAIN))
    return by_hand(CHAIN, CHAIN_STEPS, DEFAULT_RESTITUTION, DEFAULT_TIME_STEP, **options)[
        "positions"]  # fmt: skip


def test_constraints_of_that_name_are_found_unless_they_are_left_out(tmp_path, capsys):
    bound = recording_of(tmp_path, "tower_chain")
    summary = capsys.readouterr().out
    free = recording_of(tmp_path, "tower_chain", "--no-constraints")
    np.testing.assert_array_equal(bound["positions"], chain_by_hand(CHAIN_CONSTRAINTS))
    np.testing.assert_array_equal(free["positions"], chain_by_hand())
    assert np.abs(bound["positions"] - free["positions"]).max() > 0.01
    assert str(bound["constraints"]) == str(free["constraints"]) == str(CHAIN_CONSTRAINTS)
    assert bool(bound["enforceConstraints"]) and not bool(free["enforceConstraints"])
    (line,) = [line for line in summary.splitlines() if line.startswith("constraints")]
    excess = float(line.removeprefix("constraints       16 bounds, violated by at most ")[:-2])
    assert 0.0 <= excess <= 1e-3
    assert "\nconstraints       16 bounds, left out\n" in capsys.readouterr().out


def test_constraints_of_another_file(tmp_path, capsys):
    # A strut from the fixed foot to the body on top, and nothing in between.
    (tmp_path / "strut.txt").write_text("1\n0 0 8 0 1 2\n")
    recording = recording_of(tmp_path, CHAIN, "--constraints", tmp_path / "strut.txt")
    np.testing.assert_array_equal(recording["positions"], chain_by_hand(tmp_path / "strut.txt"))
    assert np.abs(recording["positions"] - chain_by_hand()).max() > 0.01
    assert np.abs(recording["positions"] - chain_by_hand(CHAIN_CONSTRAINTS)).max() > 0.01
    assert str(recording["constraints"]) == str(tmp_path / "strut.txt")
    (tmp_path / "none.txt").write_text("0\n")
    capsys.readouterr()
    recording = recording_of(tmp_path, CHAIN, "--constraints", tmp_path / "none.txt")
    np.testing.assert_array_equal(recording["positions"], chain_by_hand())
    assert "\nconstraints       none\n" in capsys.readouterr().out


def test_number_of_visits_can_be_limited(tmp_path):
    # Less than the 16 bounds there are: still one sweep. 40: two and a half.
    default = recording_of(tmp_path, "tower_chain")
    assert int(default["maxIterations"]) == 1000
    for most in (3, 40):
        recording = recording_of(tmp_path, "tower_chain", "--max-iterations", most)
        assert int(recording["maxIterations"]) == most
        np.testing.assert_array_equal(
            recording["positions"], chain_by_hand(CHAIN_CONSTRAINTS, maxIterations=most)
        )
        assert not np.array_equal(recording["positions"], default["positions"])


def test_scheduling_can_be_chosen(tmp_path):
    recordings = {
        name: recording_of(tmp_path, "tower_chain", "--scheduling", name)
        for name in ("sweep", "queue", "batches")
    }
    for name, recording in recordings.items():
        assert str(recording["constraintScheduling"]) == name
        expected = chain_by_hand(CHAIN_CONSTRAINTS, constraintScheduling=name)
        np.testing.assert_array_equal(recording["positions"], expected)
    sweep, queue, batches = (recordings[name]["positions"] for name in recordings)
    np.testing.assert_array_equal(sweep, queue)
    assert 0.0 < np.abs(sweep - batches).max() < 0.1


# --------------------------------------------------------------------------------------------------
# Where there is no display, and where there is no OpenGL
# --------------------------------------------------------------------------------------------------


@onLinux
def test_without_a_display_it_says_so_and_draws_off_screen(tmp_path):
    require_opengl()
    process = run(tmp_path, "mixed", "--steps", 40)
    assert summary_of(process)["pictures"] == f"{FALLBACK_PICTURES} in out/mixed"
    line, suggestion, *_ = process.stderr.splitlines()  # progress, where it takes long
    assert "no window: there is no display" in line and "out/mixed" in line
    assert "mixed-scene.txt suggests friction" in suggestion
    pictures = sorted((tmp_path / "out" / "mixed").iterdir())
    assert [p.name for p in pictures] == [f"frame_{k:06d}.png" for k in (0, 10, 20, 30, 40)]
    assert {picture_size(p) for p in pictures} == {(1280, 720)}
    assert len({p.read_bytes() for p in pictures}) == FALLBACK_PICTURES
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_screenshots_are_numbered_by_step(tmp_path):
    require_opengl()
    process = run(tmp_path, "tet", "--screenshots", "a/b", "--every", 15, "--steps", 40)
    assert summary_of(process)["pictures"].startswith("3 in a")
    names = sorted(path.name for path in (tmp_path / "a" / "b").iterdir())
    assert names == ["frame_000000.png", "frame_000015.png", "frame_000030.png"]


def test_size_camera_and_look_are_those_asked_for(tmp_path):
    require_opengl()
    # A size in the file has no effect on the picture's.
    camera = {**CAMERA, "windowWidth": 640, "windowHeight": 640}
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    looks = {
        "a": [], "b": ["--camera", "camera.json"], "c": ["--colours", "density"],
        "d": ["--show", "bounding boxes", "trails"],
    }  # fmt: skip
    for folder, options in looks.items():
        summary_of(run(tmp_path, "tet", "--screenshots", folder, "--steps", 0,
                       "--size", "320x200", *options))  # fmt: skip
        assert picture_size(tmp_path / folder / "frame_000000.png") == (320, 200)
    shots = {(tmp_path / folder / "frame_000000.png").read_bytes() for folder in looks}
    assert len(shots) == len(looks)


def test_video_of_a_run_and_of_its_replay(tmp_path):
    require_opengl()
    pytest.importorskip("imageio_ffmpeg", reason="pip install imageio-ffmpeg")
    options = ["--size", "161x121"]  # odd: H.264 takes even sides only
    process = run(tmp_path, "tet", "--video", "a.mp4", "--record", "r.npz", "--steps", 20, *options)
    assert summary_of(process)["video"] == "a.mp4: 11 pictures, 25 a second, in real time"
    process = run(tmp_path, "--replay", "r.npz", "--video", "b.gif", "--fps", 5, "--every", 5,
                  *options)  # fmt: skip
    assert summary_of(process)["video"] == (
        "b.gif: 5 pictures, 5 a second, at 0.5 times real time"
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mp4", "b.gif", "r.npz"]


@pytest.mark.skipif(os.name == "nt", reason="Windows cannot send Ctrl-C to one process")
def test_video_that_ctrl_c_ends_is_whole(tmp_path):
    require_opengl()
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="pip install imageio-ffmpeg")
    process = subprocess.Popen(
        [sys.executable, ROOT / "RigidBodySimulation.py", "tet", "--video", "v.mp4", "--steps",
         "100000", "--size", "160x120", "--every", "1"],
        cwd=tmp_path, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, start_new_session=True,
    )  # fmt: skip
    part, end = tmp_path / "v.part.mp4", time.monotonic() + 60
    while not (part.exists() and part.stat().st_size) and time.monotonic() < end:
        time.sleep(0.1)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the encoder as well
    output, errors = process.communicate(timeout=60)
    assert process.returncode == 130 and "stopped by Ctrl-C" in output, errors
    assert [path.name for path in tmp_path.iterdir()] == ["v.mp4"]
    said = next(line for line in output.splitlines() if line.startswith("video"))
    count, _ = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "v.mp4"))
    assert count > 1 and f" {count} pictures" in said


def test_without_ffmpeg_it_says_what_to_install(tmp_path):
    require_opengl()
    fakes = tmp_path / "fakes"
    fakes.mkdir()
    (fakes / "imageio_ffmpeg.py").write_text("raise ImportError('there is none')")
    process = run(tmp_path, "tet", "--video", "v.mp4", PYTHONPATH=str(fakes))
    assert process.returncode == 2 and process.stdout == ""
    (line,) = process.stderr.splitlines()
    assert "imageio-ffmpeg is missing. Install it: pip install imageio-ffmpeg" in line
    assert list(tmp_path.iterdir()) == [fakes]


# libglvnd looks for its drivers there, and Mesa is one of them.
NO_OPENGL = {"__EGL_VENDOR_LIBRARY_FILENAMES": "/nonexistent"}


@onLinux
def test_without_opengl_it_says_what_to_install_and_simulates(tmp_path):
    process = run(tmp_path, "tower", "--steps", 30, **NO_OPENGL)
    assert summary_of(process)["steps"] == "30 of 0.02 s: 0.6 s simulated"
    (line,) = process.stderr.splitlines()
    assert "no window and no pictures: there is no display" in line
    assert f"apt-get install {DEBIAN_PACKAGES}" in line
    assert list(tmp_path.iterdir()) == []


@onLinux
def test_without_opengl_screenshots_are_refused_at_once(tmp_path):
    process = run(tmp_path, "tower", "--screenshots", "shots", "--record", "r.npz", **NO_OPENGL)
    assert process.returncode == 2 and process.stdout == ""
    (line,) = process.stderr.splitlines()
    assert "no pictures can be drawn" in line and "apt-get install" in line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("polyscope", "words"),
    [
        ("raise ImportError('libX11.so.6: cannot open shared object file')", "libX11.so.6"),
        ("raise ModuleNotFoundError(\"No module named 'polyscope'\")", "pip install polyscope"),
        ("import os; os.abort()", "ended with code"),
    ],
    ids=["library missing", "not installed", "aborts"],
)
def test_polyscope_that_does_not_start_does_not_end_the_program(tmp_path, polyscope, words):
    fakes = tmp_path / "fakes"
    fakes.mkdir()
    (fakes / "polyscope.py").write_text(polyscope)
    process = run(tmp_path, "tower", "--steps", 3, PYTHONPATH=str(fakes))
    assert summary_of(process)["bodies"] == "9, 0 of them fixed"
    (line,) = process.stderr.splitlines()
    assert "no window and no pictures" in line and words in line


# --------------------------------------------------------------------------------------------------
# Wrong command lines
# --------------------------------------------------------------------------------------------------

WRONG = {
    "unknown scene": (["nosuch"], "nosuch: there is no such scene, neither a file nor one of ours"),
    "folder": (["."], ".: this is a folder, not a file"),
    "broken scene": (["bad-scene.txt"], "bad-scene.txt:2: the density must be positive, not -1"),
    "broken mesh": (["mesh-scene.txt"], "broken.mesh:1: a .mesh file starts with"),
    "restitution nan": (["--restitution", "nan"], "--restitution: the restitution must lie"),
    "restitution 2": (["--restitution", "2"], "must lie between 0 and 1, not 2"),
    "dashes for a value": (["--steps=--"], "argument --steps: '--' is not a value"),
    "restitution text": (["--restitution", "high"], "--restitution: 'high' is not a number"),
    "no time step": (["--time-step", "0"], "the time step must be positive and finite, not 0"),
    "time step inf": (["--time-step", "inf"], "must be positive and finite, not inf"),
    "negative steps": (["--steps", "-3"], "--steps: must be 0 or more, not -3"),
    "steps with a fraction": (["--steps", "1.5"], "--steps: '1.5' is not a whole number"),
    "every 0": (["--screenshots", "s", "--every", "0"], "--every: must be 1 or more, not 0"),
    "every alone": (["--every", "3"], "--every says how often --screenshots or --video draws"),
    "fps alone": (["--fps", "30"], "--fps says how fast --video plays, which is missing"),
    "fps 0": (["--video", "v.mp4", "--fps", "0"], "--fps: must lie between 0.01 and 240, not 0"),
    "video of unknown kind": (["--video", "v.avi"], "the name of a video must end in .mp4 or .gif"),
    "video to nowhere": (["--video", "no/v.mp4"], "no/v.mp4: No such file or directory"),
    "transparent alone": (["--transparent"], "--transparent says how --screenshots draws"),
    "transparent video": (["--video", "v.mp4", "--screenshots", "s", "--transparent"],
                          "--transparent does not go with --video: videos have no transparency"),
    "size without x": (["--size", "640"], "--size: must be WIDTHxHEIGHT, from 16 to 8192 pixels"),
    "size too large": (["--size", "640x9999"], "pixels each, not '640x9999'"),
    "no camera": (["--camera", "no.json"], "no.json: No such file or directory"),
    "unknown colours": (["--colours", "mass"], "--colours: invalid choice: 'mass'"),
    "unknown overlay": (["--show", "trails", "stars"], "--show: invalid choice: 'stars'"),
    "broken camera": (["--camera", "empty.txt"],
                      "empty.txt:2: this is not a JSON file: Expecting value"),
    "no constraint file": (["--constraints", "no.txt"], "no.txt: there is no such file"),
    "broken constraints": (["tet", "--constraints", "bad-constraints.txt"],
                           "bad-constraints.txt:2: a mesh index must be between 0 and 24, not 99"),
    "empty constraints": (["tet", "--constraints", "empty.txt"], "empty.txt: the file is empty"),
    "constraints or not": (["--constraints", "a", "--no-constraints"], "not allowed with argument"),
    "negative visits": (["--max-iterations", "-1"], "--max-iterations: must be 0 or more, not -1"),
    "unknown scheduling": (["--scheduling", "random"], "--scheduling: invalid choice: 'random'"),
    "abbreviation": (["--rest", "0.5"], "unrecognized arguments: --rest"),
    "two scenes": (["tet", "tower"], "unrecognized arguments: tower"),
    "record to nowhere": (["--record", "no/r.npz"], "no/r.npz: No such file or directory"),
    "record to a folder": (["--record", "."], ".: this is a folder, not a file"),
    "record a broken scene": (["bad-scene.txt", "--record", "r.npz"], "bad-scene.txt:2: "),
    "draw a broken scene": (["bad-scene.txt", "--screenshots", "s"], "bad-scene.txt:2: "),
}  # fmt: skip


@pytest.fixture
def brokenFolder(tmp_path):
    """A folder with a scene that is broken, one whose mesh is, and two broken constraint files."""
    (tmp_path / "broken.mesh").write_text("nothing of the kind")
    (tmp_path / "mesh-scene.txt").write_text("1\nbroken.mesh 1 0 0 0 0 1 0 0 0\n")
    (tmp_path / "bad-scene.txt").write_text("1\nbroken.mesh -1 0 0 0 0 1 0 0 0\n")
    (tmp_path / "bad-constraints.txt").write_text("1\n0 0 99 0 0 1\n")
    (tmp_path / "empty.txt").write_text("\n# nothing\n")
    return tmp_path


def assert_one_line(errors, message):
    (line,) = errors.splitlines()
    assert line.startswith("RigidBodySimulation.py: ") and message in line


@pytest.mark.parametrize("case", WRONG)
def test_wrong_command_line_is_told_in_one_line(brokenFolder, monkeypatch, capsys, case):
    arguments, message = WRONG[case]
    before = sorted(brokenFolder.iterdir())
    monkeypatch.chdir(brokenFolder)
    try:
        code = main(["--headless", *arguments])
    except SystemExit as ended:  # argparse does not return
        code = ended.code
    output, errors = capsys.readouterr()
    assert (code, output) == (2, "")
    assert_one_line(errors, message)
    assert sorted(brokenFolder.iterdir()) == before


@pytest.mark.parametrize("case", ["unknown scene", "broken mesh", "negative steps"])
def test_wrong_command_line_ends_the_program_without_a_traceback(brokenFolder, case):
    arguments, message = WRONG[case]
    process = run(brokenFolder, *arguments)
    assert (process.returncode, process.stdout) == (2, "")
    assert_one_line(process.stderr, message)


def test_help_names_every_option_with_its_default(tmp_path):
    process = run(tmp_path, "--help")
    assert process.returncode == 0 and process.stderr == ""
    for words in ("SCENE", "mixed", "--restitution E", "0.5", "--time-step H", "0.02",
                  "--closing-only", "--constraints FILE", "--no-constraints",
                  "--max-iterations N", "--scheduling NAME", "--headless", "--steps N", "500",
                  "--screenshots DIR", "--every K", "--video FILE", "--fps R",
                  "--size WxH", "--camera FILE.json", "--transparent", "--colours NAME",
                  "--show NAME", "--record FILE.npz", "--replay FILE.npz",
                  "--resume FILE.npz", "--verify FILE.npz", "--from STEP", "--stats FILE.csv",
                  "--plot FILE.png", "--finish FILE.npz", "--allow-outside-meshes"):  # fmt: skip
        assert words in process.stdout
    assert max(map(len, process.stdout.splitlines())) <= 100
    # It begins with what people want, and lists the scenes.
    lines = process.stdout.splitlines()
    commands = [line for line in lines[:15] if line.startswith("  RigidBodySimulation.py")]
    assert len(commands) == 5
    scenes = {line.split()[0] for line in lines[5:] if line.startswith("    ") and line.split()}
    assert {path.name.removesuffix("-scene.txt") for path in DATA.glob("*-scene.txt")} <= scenes


def run_then_ask(folder, arguments, question):
    """What a Python expression says after the program has run with these arguments; a str."""
    program = f"import sys, RigidBodySimulation\ncode = RigidBodySimulation.main({arguments!r})\n"
    program += f"assert code == 0\nprint({question}, file=sys.stderr)"
    process = subprocess.run(
        [sys.executable, "-c", program], cwd=folder, env=environment(PYTHONPATH=str(ROOT)),
        capture_output=True, text=True,
    )  # fmt: skip
    assert process.returncode == 0, process.stderr
    return process.stderr.strip()


LOADED = "sorted(n for n in sys.modules if n.startswith(('rbs.', 'polyscope')) and n in {0!r})"
# What is seen, and the window.
SEEN = ["polyscope", "rbs.cameras", "rbs.drawing", "rbs.panel", "rbs.pictures", "rbs.viewer",
        "rbs.widgets", "rbs.plots", "rbs.helppanel"]  # fmt: skip


@pytest.mark.parametrize(
    "arguments",
    [
        ["tet", "--headless", "--steps", "2"],
        ["tet", "--steps", "2", "--record", "r.npz", "--stats", "s.csv"],
    ],
    ids=["headless", "recorded"],
)
def test_what_draws_is_imported_when_something_is_to_be_seen_only(tmp_path, arguments):
    assert run_then_ask(tmp_path, arguments, LOADED.format(SEEN)) == "[]"


def test_pictures_need_no_window(tmp_path):
    require_opengl()
    arguments = ["tet", "--steps", "1", "--screenshots", ".", "--size", "160x120"]
    assert run_then_ask(tmp_path, arguments, LOADED.format(SEEN)) == str(
        ["polyscope", "rbs.cameras", "rbs.drawing", "rbs.pictures"]
    )


def test_importing_the_modules_needs_no_display_and_no_polyscope(tmp_path):
    modules = ["RigidBodySimulation", *(f"rbs.{path.stem}" for path in ROOT.glob("rbs/*.py"))]
    program = (
        f"import sys, {', '.join(modules)}, RBSFunctions, GJK, Quaternion; "
        "sys.exit('polyscope' in sys.modules)"
    )
    process = subprocess.run([sys.executable, "-c", program], cwd=ROOT, env=environment())
    assert process.returncode == 0
