"""The command line by subprocess, and the simulation behind it."""

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

from rbs.backends import DEBIAN_PACKAGES
from rbs.headless import run_steps
from rbs.recording import Recording
from rbs.simulation import Settings, Simulation
from rbs.state import STATE_NAMES
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


def test_state_is_a_copy():
    simulation = Simulation(DATA / "singlebox-scene.txt")
    state = simulation.state()
    before = state["positions"].copy()
    simulation.step()
    np.testing.assert_array_equal(state["positions"], before)
    simulation.set_state(state)
    state["positions"][:] = 0.0
    np.testing.assert_array_equal(simulation.meshes[0].position, before)


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
    assert summary["bodies"] == "15, 8 of them fixed"
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


class Terminal(io.StringIO):
    """Takes what a terminal is told."""

    def isatty(self):
        return True


@pytest.mark.parametrize("stream", [Terminal(), io.StringIO()], ids=["terminal", "log"])
def test_progress_is_shown_in_a_terminal_only_and_wiped_at_the_end(monkeypatch, stream):
    monkeypatch.setattr(sys, "stderr", stream)
    simulation = Simulation(DATA / "singletet-scene.txt")
    run_steps(simulation, 30)
    assert simulation.stepCount == 30
    first, *_, last = stream.getvalue().split("\r")[1:] or ["", ""]
    assert ("/30" in first) == stream.isatty() and last.strip() == "" and "\n" not in last


def test_no_step_is_a_run_too(tmp_path):
    summary = summary_of(
        run(tmp_path, "tower", "--headless", "--steps", 0, "--record", "r.h5")
    )
    assert summary["time per step"] == "no step was made"
    recording = Recording(tmp_path / "r.h5")
    assert recording.firstStep == recording.lastStep == 0
    assert recording.frame(0)["positions"].shape == (9, 3)


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
    """Runs the program in this process for CHAIN_STEPS steps: (Recording, positions of all)."""
    path = folder / "r.h5"
    options = ["--headless", "--steps", str(CHAIN_STEPS), "--record", str(path)]
    assert main([*map(str, arguments), *options]) == 0
    recording = Recording(path)
    frames = [recording.frame(step) for step in range(CHAIN_STEPS + 1)]
    path.unlink()
    return recording, np.array([frame["positions"] for frame in frames])


def chain_by_hand(file=None, **options):
    """Positions of the chain in each step by run_timestep alone, with the constraints of a file."""
    if file is not None:
        options["constraints"] = load_constraint_file(file, load_scene_file(CHAIN))
    defaults = Settings()
    states = by_hand(
        CHAIN, CHAIN_STEPS, defaults.restitution, defaults.timeStep, **options
    )
    return states["positions"]


def test_constraints_of_that_name_are_found_unless_they_are_left_out(tmp_path, capsys):
    recording, bound = recording_of(tmp_path, "tower_chain")
    summary = capsys.readouterr().out
    freeRecording, free = recording_of(tmp_path, "tower_chain", "--no-constraints")
    np.testing.assert_array_equal(bound, chain_by_hand(CHAIN_CONSTRAINTS))
    np.testing.assert_array_equal(free, chain_by_hand())
    assert np.abs(bound - free).max() > 0.01
    for one, isBound in ((recording, True), (freeRecording, False)):
        assert one.source.constraints == CHAIN_CONSTRAINTS.read_text()
        assert one.settings_at(0)[1]["enforceConstraints"] is isBound
    (line,) = [line for line in summary.splitlines() if line.startswith("constraints")]
    excess = float(line.removeprefix("constraints       16 bounds, violated by at most ")[:-2])
    assert 0.0 <= excess <= 1e-3
    assert "\nconstraints       16 bounds, left out\n" in capsys.readouterr().out


def test_constraints_of_another_file(tmp_path, capsys):
    # A strut from the fixed foot to the body on top, and nothing in between.
    (tmp_path / "strut.txt").write_text("1\n0 0 8 0 1 2\n")
    recording, strut = recording_of(tmp_path, CHAIN, "--constraints", tmp_path / "strut.txt")
    np.testing.assert_array_equal(strut, chain_by_hand(tmp_path / "strut.txt"))
    assert np.abs(strut - chain_by_hand()).max() > 0.01
    assert np.abs(strut - chain_by_hand(CHAIN_CONSTRAINTS)).max() > 0.01
    assert recording.source.constraintPath.name == "strut.txt"
    (tmp_path / "none.txt").write_text("0\n")
    capsys.readouterr()
    _, free = recording_of(tmp_path, CHAIN, "--constraints", tmp_path / "none.txt")
    np.testing.assert_array_equal(free, chain_by_hand())
    assert "\nconstraints       none\n" in capsys.readouterr().out


def test_number_of_visits_can_be_limited(tmp_path):
    _, default = recording_of(tmp_path, "tower_chain")
    # Less than the 16 bounds there are: still one sweep. 40: two and a half.
    for most in (3, 40):
        recording, positions = recording_of(tmp_path, "tower_chain", "--max-iterations", most)
        assert recording.settings_at(0)[1]["maxIterations"] == most
        expected = chain_by_hand(CHAIN_CONSTRAINTS, maxIterations=most)
        np.testing.assert_array_equal(positions, expected)
        assert not np.array_equal(positions, default)


def test_scheduling_can_be_chosen(tmp_path):
    found = []
    for name in ("sweep", "queue", "batches"):
        recording, positions = recording_of(tmp_path, "tower_chain", "--scheduling", name)
        assert recording.settings_at(0)[1]["constraintScheduling"] == name
        expected = chain_by_hand(CHAIN_CONSTRAINTS, constraintScheduling=name)
        np.testing.assert_array_equal(positions, expected)
        found.append(positions)
    sweep, queue, batches = found
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
    (line,) = process.stderr.splitlines()
    assert "no window: there is no display" in line and "out/mixed" in line
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
    process = run(tmp_path, "tet", "--video", "a.mp4", "--record", "r.h5", "--steps", 20, *options)
    assert summary_of(process)["video"] == "a.mp4: 11 frames at 25 fps (real time)"
    process = run(tmp_path, "--replay", "r.h5", "--video", "b.gif", "--fps", 5, "--every", 5,
                  *options)  # fmt: skip
    assert summary_of(process)["video"] == "b.gif: 5 frames at 5 fps (0.5 × real time)"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mp4", "b.gif", "r.h5"]


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
    assert count > 1 and f" {count} frames" in said


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
    process = run(tmp_path, "tower", "--screenshots", "shots", "--record", "r.h5", **NO_OPENGL)
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
# Help, and what is imported
# --------------------------------------------------------------------------------------------------


def test_help_names_every_option_with_its_default(tmp_path):
    process = run(tmp_path, "--help")
    assert process.returncode == 0 and process.stderr == ""
    for words in ("SCENE", "mixed", "--restitution X", "0.5", "--time-step X", "0.02",
                  "--closing-only", "--constraints FILE", "--no-constraints",
                  "--max-iterations N", "--scheduling NAME", "--headless", "--steps N", "500",
                  "--screenshots DIR", "--every K", "--video FILE", "--fps R",
                  "--size WxH", "--camera FILE.json", "--transparent", "--colours NAME",
                  "--show NAME", "--record FILE.h5", "--replay FILE.h5",
                  "--resume FILE.h5", "--verify FILE.h5", "--from STEP", "--stats FILE.csv",
                  "--plot FILE.png", "--allow-outside-meshes"):  # fmt: skip
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
        ["tet", "--steps", "2", "--record", "r.h5", "--stats", "s.csv"],
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
