"""A student's functions on our scenes: `--functions DIR`, headless and drawn; commas in scenes."""

import importlib
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
from opengl import require_opengl
from oracles import DATA, ROOT
from program import record, run, summary_of
from studentVariants import EARLY, HALF_DONE, LOST, MISTAKES, write_submission

from rbs.program.submittedsteps import SubmittedSteps
from rbs.recordings.recording import Recording
from rbs.recordings.replay import resume
from rbs.scenes.scenefiles import fields_of, scene_rows
from rbs.scenes.simulation import Simulation
from rbs.scenes.state import STATE_NAMES
from RigidBodySimulation import load_constraint_file, load_mesh_file, load_scene_file

STEPS = 60


def positions_of(folder, name, *arguments):
    """Positions (steps + 1, n, 3) of a recorded run."""
    path = folder / f"{name}.h5"
    process = run(folder, *arguments, "--steps", STEPS, "--record", path)
    assert process.returncode == 0, process.stderr
    recording = Recording(path)
    return np.array([recording.frame(step)["positions"] for step in range(STEPS + 1)])


@pytest.mark.parametrize("scene", ["mixed", "tower_chain", "two_cylinder"])
def test_a_right_solution_moves_the_bodies_as_ours_does(scene, tmp_path):
    """Two programs that have nothing in common but the test for collisions."""
    student = write_submission(tmp_path / "student")
    ours = positions_of(tmp_path, "ours", scene, "--basic")
    theirs = positions_of(tmp_path, "theirs", scene, "--functions", student)
    assert np.ptp(ours, axis=0).max() > 1.0
    assert theirs == pytest.approx(ours, abs=1e-9)


def test_a_mistake_shows(tmp_path):
    student = write_submission(tmp_path / "student", MISTAKES["explicit-euler"])
    ours = positions_of(tmp_path, "ours", "singlebox")
    theirs = positions_of(tmp_path, "theirs", "singlebox", "--functions", student)
    # Until it lands, each step is h² g behind the semi-implicit one, which falls further.
    behind = theirs[:20, 0, 1] - ours[:20, 0, 1]
    assert behind == pytest.approx(np.arange(20) * 9.8 * 0.02**2, abs=1e-9)


def test_a_com_that_is_not_subtracted_shows_in_the_vertices(tmp_path):
    """The student's meshes are made of the file's vertices, and drawn where the student has them.

    The mesh's COM is not at the origin of its file; the student's vertices are off by as much.
    """
    student = write_submission(tmp_path / "student", MISTAKES["com-not-subtracted"])
    content = (DATA / "tetrahedron.mesh").read_text()
    (tmp_path / "tetrahedron.mesh").write_text(content)
    scene = tmp_path / "a-scene.txt"
    scene.write_text("1\ntetrahedron.mesh 1 0 0 50 0 1 0 0 0\n")
    simulation = Simulation(scene)
    steps = SubmittedSteps(student)
    rest = simulation.meshes[0].origVertices
    offset = load_mesh_file(tmp_path / "tetrahedron.mesh")[0][0] - rest[0]
    steps.step(simulation.source, simulation.meshes, simulation.groundMesh, 0.02, 0.5)
    mesh = simulation.meshes[0]
    assert mesh.position == pytest.approx(np.array([[0.0, 50.0 - 9.8 * 0.02**2, 0.0]]))
    assert mesh.currVertices == pytest.approx(rest + offset + mesh.position)
    assert np.abs(offset).max() > 0.1


def test_our_functions_are_ours_again(tmp_path):
    """Loading a student's modules leaves ours where they were, in this very process."""
    names = ("Quaternion", "RBSFunctions", "GJK")
    before = [importlib.import_module(name) for name in names]
    steps = SubmittedSteps(write_submission(tmp_path / "student"))
    assert [importlib.import_module(name) for name in names] == before
    assert steps.folder == (tmp_path / "student").resolve()


def test_the_window_may_reset_fix_and_free_bodies(tmp_path):
    simulation = Simulation(DATA / "mixed-scene.txt")
    simulation.submitted = SubmittedSteps(write_submission(tmp_path / "student"))
    for _ in range(30):
        simulation.step()
    reached = simulation.state()
    assert simulation.report is None
    simulation.reset()
    simulation.meshes[2].isFixed = True
    held = simulation.meshes[2].position.copy()
    for _ in range(30):
        simulation.step()
    assert np.array_equal(simulation.meshes[2].position, held)
    assert not np.allclose(simulation.state()["positions"], reached["positions"])
    simulation.reset()
    for _ in range(30):
        simulation.step()
    # Not to the bit: the student normalises the first quaternion in another way than we do.
    assert simulation.state()["positions"] == pytest.approx(reached["positions"], abs=1e-9)


@pytest.mark.parametrize(
    ("options", "cause"),
    [
        (
            ["--friction", "0.3"],
            "--friction cannot be used with these --functions: the run_timestep in {folder} has no "
            "parameter mu",
        ),
        (["--closing-only"], "no parameter closingOnly"),
        (["--scheduling", "queue"], "no parameter constraintScheduling"),
        (["--broad-phase", "grid"], "no parameter broadPhase"),
        (["--our-loop", "--friction", "0.3"], "no parameter mu"),
    ],
)
def test_options_that_the_student_does_not_know_are_refused(options, cause, tmp_path):
    student = write_submission(tmp_path / "student")
    process = run(tmp_path, "mixed", "--headless", "--functions", student, *options)
    assert process.returncode == 2
    assert process.stdout == ""
    (line,) = process.stderr.splitlines()
    assert line.endswith(cause.format(folder=student.resolve()))


def test_options_that_the_student_knows_are_passed_on(tmp_path):
    edit = (
        "maxIterations=1000, tolerance=0.0):",
        "maxIterations=1000, tolerance=0.0, mu=0.0):\n    print('mu', mu, maxIterations)",
    )
    student = write_submission(tmp_path / "student", [edit])
    process = run(
        tmp_path,
        "singlebox",
        "--headless",
        "--steps",
        1,
        "--functions",
        student,
        "--friction",
        "0.25",
        "--max-iterations",
        "7",
    )
    assert process.returncode == 0, process.stderr
    assert process.stdout.splitlines()[0] == "mu 0.25 7"


@pytest.mark.parametrize(
    ("edit", "code", "cause"),
    [
        (
            (
                "    for mesh in meshes:\n        mesh.integrate",
                "    1 / 0\n    for mesh in meshes:\n        mesh.integrate",
            ),
            3,
            "step 1 cannot be made: RBSFunctions.py:{line} in run_timestep: ZeroDivisionError: "
            "division by zero",
        ),
        (
            (
                "self.orientation = QMult(QExp(half), self.orientation)",
                "self.orientation = np.eye(3)",
            ),
            3,
            "step 1 cannot be made: ",
        ),
        (
            ("gravity = np.array([[0.0, -9.8, 0.0]])", "gravity = np.array([[0.0, np.nan, 0.0]])"),
            3,
            "step 1 cannot be made: box 0: position is not finite",
        ),
        (("def run_timestep(", "def run_step("), 2, "RBSFunctions.py has no run_timestep"),
        (("class Mesh:", "class Body:"), 2, "RBSFunctions.py has no Mesh"),
        (
            ("import cppyy\n", "import cppyy.gbl.nothing\n"),
            2,
            "cannot be imported: RBSFunctions.py:{line}: ModuleNotFoundError",
        ),
    ],
)
def test_what_goes_wrong_is_told_in_one_line(edit, code, cause, tmp_path):
    student = write_submission(tmp_path / "student", [edit])
    lines = (student / "RBSFunctions.py").read_text().splitlines()
    line = 1 + next((k for k, text in enumerate(lines) if text in edit[1].splitlines()), 0)
    process = run(tmp_path, "singlebox", "--headless", "--steps", 3, "--functions", student)
    assert process.returncode == code, process.stderr
    (told,) = process.stderr.splitlines()
    assert cause.format(line=line) in told


def test_our_loop_takes_the_place_of_the_released_one(tmp_path):
    """The released one drops a velocity and ends early: the bridge is torn apart."""
    student = write_submission(tmp_path / "student", [LOST, EARLY])
    scene = "bridge", "--headless", "--steps", 60, "--functions", student
    process = run(tmp_path, *scene)
    torn = float(summary_of(process)["constraints"].split()[-2])
    (line,) = process.stderr.splitlines()
    assert "student: a step assigns linVelocty, so linVelocity keeps its value, as in" in line
    process = run(tmp_path, *scene, "--our-loop")
    held = float(summary_of(process)["constraints"].split()[-2])
    assert (process.stderr, held < 0.1, torn > 5.0) == ("", True, True)
    ours = float(summary_of(run(tmp_path, *scene[:4]))["constraints"].split()[-2])
    assert held == pytest.approx(ours, rel=0.01)


def test_our_loop_makes_the_steps_that_a_right_run_timestep_makes(tmp_path):
    student = write_submission(tmp_path / "student")
    for scene in ("mixed", "tower_chain"):
        theirs = positions_of(tmp_path, "a", scene, "--functions", student)
        ours = positions_of(tmp_path, "b", scene, "--functions", student, "--our-loop")
        assert ours == pytest.approx(theirs, abs=1e-9)


def test_a_step_that_fails_changes_nothing(tmp_path):
    edit = ("    up = np.array([[0.0, 1.0, 0.0]])\n", "    raise ValueError\n")
    simulation = Simulation(DATA / "mixed-scene.txt")
    simulation.submitted = SubmittedSteps(write_submission(tmp_path / "student", [edit]))
    before = simulation.state()
    with pytest.raises(ArithmeticError, match=r"step 1 cannot be made: RBSFunctions.py:\d+ in"):
        simulation.step()
    assert all(np.array_equal(before[name], value) for name, value in simulation.state().items())


def test_a_recording_belongs_to_the_functions_that_made_it(tmp_path):
    """It goes on, and is verified, with these functions only; it is replayed without."""
    student, scene = write_submission(tmp_path / "student"), tmp_path / "scene"
    shutil.copytree(DATA, scene)
    for name, *options in (("theirs.h5", "--functions", student), ("ours.h5",)):
        path = scene / "mixed-scene.txt"
        process = run(tmp_path, path, "--basic", "--steps", STEPS, "--record", name, *options)
        assert process.returncode == 0, process.stderr
    shutil.rmtree(scene)
    theirs = Recording(tmp_path / "theirs.h5")
    assert theirs.functions == SubmittedSteps(student).digest
    assert theirs.functionsFolder == "student"
    assert Recording(tmp_path / "ours.h5").functions == ""

    def assert_refused(name, cause, *options):
        for mode in ("--verify", "--resume"):
            process = run(tmp_path, mode, name, *options)
            assert (process.returncode, process.stdout) == (2, "")
            (line,) = process.stderr.splitlines()
            assert f"{name}: {cause}" in line

    assert_refused("theirs.h5", "it was made with the functions in student; name that")
    assert_refused("ours.h5", "it was made without --functions", "--functions", student)
    process = run(tmp_path, "--verify", "theirs.h5", "--functions", student)
    assert (process.returncode, process.stderr) == (0, "")
    process = run(
        tmp_path,
        "--resume",
        "theirs.h5",
        "--from",
        40,
        "--steps",
        STEPS - 40,
        "--record",
        "later.h5",
        "--functions",
        student,
    )
    assert process.returncode == 0, process.stderr
    later = Recording(tmp_path / "later.h5")
    assert (later.firstStep, later.lastStep, later.functions) == (40, STEPS, theirs.functions)
    for step in range(40, STEPS + 1):
        states = later.frame(step), theirs.frame(step)
        assert all(states[0][name].tobytes() == states[1][name].tobytes() for name in STATE_NAMES)
    process = run(tmp_path, "--replay", "theirs.h5", "--headless")
    assert process.returncode == 0
    (line,) = process.stderr.splitlines()
    assert line.endswith("theirs.h5: recorded with the functions in student")
    with open(student / "Quaternion.py", "a") as file:
        file.write("# later\n")
    cause = f"it was not made with the functions in {student.resolve()}"
    assert_refused("theirs.h5", cause, "--functions", student)


def test_a_resumed_run_has_the_same_bits_also_of_the_smallest_spin(tmp_path):
    """The upper box lands flat on the lower one: what turns it is the rounding alone."""
    shutil.copy(DATA / "box.mesh", tmp_path)
    scene = tmp_path / "a-scene.txt"
    scene.write_text("2\nbox.mesh 1 1 0.1 9.3 0.7 1 0 0 0\nbox.mesh 1 0 0.1 35 0.7 1 0 0 0\n")
    simulation = Simulation(scene)
    simulation.submitted = SubmittedSteps(write_submission(tmp_path / "student"))
    recording = Recording(record(tmp_path / "a.h5", simulation, 110))
    again = Simulation(recording.source)
    again.submitted = SubmittedSteps(tmp_path / "student")
    resume(recording, 105, again)
    assert 0.0 < np.abs(again.meshes[1].angVelocity).max() < 1e-12
    for _ in range(5):
        again.step()
    for name, values in again.state().items():
        assert values.tobytes() == recording.frame(110)[name].tobytes()


def test_a_folder_without_functions_is_refused(tmp_path):
    for arguments, cause in (
        (("--functions", tmp_path), "holds no RBSFunctions.py"),
        (("--functions", tmp_path / "no"), "no such folder"),
        (("--functions", tmp_path, "--replay", "x.h5"), "--functions cannot be used with --replay"),
        (("--our-loop",), "--our-loop needs --functions"),
    ):
        process = run(tmp_path, *arguments, "--headless")
        assert process.returncode == 2
        (line,) = process.stderr.splitlines()
        assert cause in line


# ---- Pictures in the sheets of grade.py ---------------------------------------------------------


def test_a_sheet_has_pictures_of_scenes(tmp_path):
    require_opengl()
    write_submission(tmp_path / "all" / "half-done", HALF_DONE)
    raises = [("    # interpenetration\n", "    raise ValueError('not today')\n")]
    write_submission(tmp_path / "all" / "raises", raises)
    out = tmp_path / "out"
    graded = subprocess.run(
        [sys.executable, ROOT / "graders" / "grade.py", tmp_path / "all", "--out", out, "--scenes"],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert graded.returncode == 1, graded.stderr
    for name in ("half-done", "raises"):
        sheet = (out / f"{name}.md").read_text(encoding="utf-8")
        paths = re.findall(r"!\[\w+\]\((.*?)\)", sheet)
        for path in paths:
            assert (out / path).read_bytes().startswith(b"\x89PNG")
        counts = {
            scene: sum(f"/{scene}_" in path for path in paths)
            for scene in ("singlebox", "mixed", "tower_chain")
        }
        if name == "half-done":
            assert counts == dict.fromkeys(counts, 4)
            assert "| 0 s | 1 s | 2 s | 3 s |" in sheet
            assert "The steps agree with ours" not in sheet
        else:
            assert max(counts.values()) < 4
            assert "not all pictures: RigidBodySimulation.py: step " in sheet.replace("\\", "")


# ---- Commas -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "fields"),
    [
        ("1, 2,3 ,4  # 5, 6", ["1", "2", "3", "4"]),
        ("box.mesh, 1.0,0", ["box.mesh", "1.0", "0"]),
        ("a, b.off,1", ["a,", "b.off", "1"]),
        ("a.mesh,b.OFF 1,2,", ["a.mesh,b.OFF", "1", "2"]),
        (",", []),
        ("x.meshes, 1", ["x.meshes", "1"]),
    ],
)
def test_commas_between_numbers_are_blanks(line, fields):
    assert fields_of(line + "\n") == fields


def test_scenes_and_constraints_may_have_commas(tmp_path):
    for name in ("tower_chain-scene.txt", "tower_chain-constraints.txt"):
        text = (DATA / name).read_text()
        lines = [re.sub(r"[ \t]+", ", ", line.strip()) for line in text.splitlines()]
        (tmp_path / name).write_text("\n".join(lines) + "\n")
        assert lines != text.splitlines()
    for mesh in DATA.glob("*.mesh"):
        shutil.copy(mesh, tmp_path)
    path, plain = tmp_path / "tower_chain-scene.txt", DATA / "tower_chain-scene.txt"
    with_commas, without = load_scene_file(path), load_scene_file(plain)
    for one, other in zip(with_commas, without, strict=True):
        assert one.name == other.name
        assert np.array_equal(one.currVertices, other.currVertices)
    constraints = [
        load_constraint_file(folder / "tower_chain-constraints.txt", meshes)
        for folder, meshes in ((tmp_path, with_commas), (DATA, without))
    ]
    assert constraints[0] == constraints[1] != []
    rows = [scene_rows(each.read_text(), len(without)) for each in (path, plain)]
    for one, other in zip(*rows, strict=True):
        assert one[:3] == other[:3]
        assert all(np.array_equal(a, b) for a, b in zip(one[3:], other[3:], strict=True))
    assert summary_of(run(tmp_path, path, "--headless", "--steps", 1))["state"].startswith("all")
