"""A student's functions on our scenes: `--functions DIR`, headless and drawn."""

import re
import signal
import sys
import time

import numpy as np
import pytest
from oracles import DATA
from program import bits, call, start
from studentVariants import VARIANTS, edited, on_skeleton, write_submission, written

from rbs.program.submittedsteps import SubmittedSteps
from rbs.recordings.recording import Recording
from rbs.scenes.simulation import SceneSimulation

STEPS, BOX = 60, DATA / "singlebox-scene.txt"


@pytest.fixture
def program(tmp_path, monkeypatch, capsys):
    """Runs the program in a folder of its own: (exit code, output, errors)."""
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: call(capsys, *arguments)


@pytest.fixture
def positions(program):
    """Returns the positions (steps + 1, n, 3) of a recorded run."""

    def run(*arguments):
        code, _, errors = program(*arguments, "--steps", STEPS, "--record", "p.h5")
        assert code == 0, errors
        recording = Recording("p.h5")
        return np.array([recording.frame(step)["positions"] for step in range(STEPS + 1)])

    return run


def refusal(program, *arguments, code=2):
    """The one line that a run ends with."""
    ended, output, errors = program(*arguments)
    assert ended == code and (code != 2 or output == ""), errors
    (line,) = errors.splitlines()
    return line


# What a student may add to see how often a step is made.
WRAPPER = """
_step = run_timestep
def run_timestep(*arguments, **options):
    return _step(*arguments, **options)
"""


def write_more(folder, text):
    """Writes the solution, and this text at its end; the folder."""
    with (write_submission(folder) / "RBSFunctions.py").open("a") as file:
        file.write(f"\n\n{text}\n")
    return folder


@pytest.mark.parametrize("scene", ["mixed", "tower_chain"])
def test_a_right_solution_moves_the_bodies_as_ours_does(scene, tmp_path, positions):
    """The two programs share nothing but the test for collisions."""
    ours = positions(scene, "--basic")
    assert np.ptp(ours, axis=0).max() > 1.0
    student = write_more(tmp_path / "student", WRAPPER)
    assert positions(scene, "--functions", student) == pytest.approx(ours, abs=1e-9)


# What a student may have instead of each function that our loop calls for an observer, and one that
# changes the arrays that it was given.
BROKEN = {
    "integrate_timestep": "Mesh.integrate_timestep = lambda self, h: None",
    "detect_collision": "Mesh.detect_collision = lambda self, m: (False, [], [], [])",
    "resolve_collision": "resolve_collision = lambda *contact: None",
    "resolve_position_constraint": "resolve_position_constraint = lambda x, *rest: (True, x)",
    "resolve_velocity_constraint": "resolve_velocity_constraint = lambda x, p, v, w, *_: (1, v, w)",
    "careless": """right = resolve_collision
def resolve_collision(m1, m2, depth, n, p, e):
    right(m1, m2, depth, n, p, e); n *= 0.0; p += 9.0
""",
}


def test_an_observed_step_calls_each_function_of_a_student(tmp_path):
    ends = {}
    for name, broken in {"": "", **BROKEN}.items():
        submitted = SubmittedSteps(write_more(tmp_path / f"student {name}", broken))
        simulation = SceneSimulation(DATA / "tower_chain-scene.txt", submitted=submitted)
        for _ in range(STEPS):
            simulation.step(lambda event: None)
        ends[name] = simulation.state()["positions"]
    gaps = {name: np.abs(end - ends[""]).max() for name, end in ends.items()}
    assert gaps.pop("") == 0.0 == gaps.pop("careless") and min(gaps.values()) > 1e-3, gaps


def test_options_that_the_student_does_not_know_are_refused(tmp_path, program):
    given = "mixed", "--headless", "--functions", write_submission(tmp_path / "student")
    line = refusal(program, *given, "--friction", "0.3")
    assert "has no parameter mu, only " in line and line.endswith(", tolerance")
    line = refusal(program, *given, "--scheduling", "queue")
    assert "has no parameter constraintScheduling, only meshes, " in line
    line = refusal(program, *given, "--set", "dirtyFlags=true")
    assert line.startswith("RigidBodySimulation.py: --set: the run_timestep in")
    assert "'dirtyFlags' is not NAME=VALUE" in refusal(program, *given, "--set", "dirtyFlags")


def test_options_that_the_student_knows_are_passed_on(tmp_path, program):
    """Quaternion.py is supplied, with a note."""
    known = "maxIterations=1000, tolerance=0.0"
    more = "frictionMu=0.0, dirtyFlags=False"
    edit = (f"{known}):", f"{known}, {more}):\n    print(frictionMu, maxIterations, dirtyFlags)")
    student = written(tmp_path / "student", on_skeleton(edit))
    (student / "Quaternion.py").unlink()
    options = "--headless --steps 1 --friction 0.25 --max-iterations 7".split()
    given = "singlebox", "--functions", student, "--set", "dirtyFlags=true"
    code, output, errors = program(*given, *options)
    assert code == 0 and output.splitlines()[0] == "0.25 7 True"
    code, output, _ = program(*given, "--trace", 1)  # by our loop, which does not have them
    assert code == 0 and "free flight" in output
    assert "Quaternion.py is not in the submission; the coursework supplies" in errors


LOOP, GRAVITY = "    for mesh in meshes:\n        mesh.integrate", "np.array([[0.0, -9.8, 0.0]])"
# What replaces what in the student's file; the exit code, and what the line says.
FAILURES = [
    (LOOP, f"    1 / 0\n{LOOP}", 3, "RBSFunctions.py:{line} in run_timestep: ZeroDivisionError: "),
    (GRAVITY, GRAVITY.replace("-9.8", "np.nan"), 3, "box 0: position is not finite"),
    ("def run_timestep(", "def run_step(", 2, "RBSFunctions.py has no run_timestep"),
    ("import cppyy\n", "import cppyy.gbl.nothing\n", 2, "RBSFunctions.py:{line}: ModuleNotFound"),
]


@pytest.mark.parametrize(("old", "new", "code", "cause"), FAILURES)
def test_what_goes_wrong_is_reported_in_one_line(old, new, code, cause, tmp_path, program):
    student = write_submission(tmp_path / "student", [(old, new)])
    lines = (student / "RBSFunctions.py").read_text().splitlines()
    line = 1 + next((k for k, text in enumerate(lines) if text in new.splitlines()), 0)
    arguments = "singlebox", "--headless", "--steps", 3, "--functions", student
    assert cause.format(line=line) in refusal(program, *arguments, code=code)
    if code == 3:
        simulation = SceneSimulation(BOX, submitted=SubmittedSteps(student))
        before = simulation.state()
        with pytest.raises(ArithmeticError, match="step 1 cannot be made: "):
            simulation.step()
        assert bits(simulation.state()) == bits(before)


def test_a_recording_belongs_to_the_functions_that_made_it(tmp_path, program):
    """It is resumed and verified with these functions only; it is replayed without them."""
    student = write_submission(tmp_path / "student")
    given = "--functions", student
    for name, *options in (("theirs.h5", *given), ("ours.h5",)):
        words = "mixed", "--basic", "--steps", STEPS, "--record", name
        assert program(*words, *options)[0] == 0
    theirs = Recording("theirs.h5")

    def assert_refused(name, *options):
        for mode in ("--verify", "--resume"):
            assert f"{name}: " in refusal(program, mode, name, *options)

    assert_refused("theirs.h5")
    assert_refused("ours.h5", *given)
    assert program("--verify", "theirs.h5", *given)[::2] == (0, "")
    rest = "--from", 40, "--steps", STEPS - 40, "--record", "later.h5"
    assert program("--resume", "theirs.h5", *rest, *given)[0] == 0
    later = Recording("later.h5")
    assert (later.firstStep, later.lastStep, later.functions) == (40, STEPS, theirs.functions)
    for step in range(40, STEPS + 1):
        assert bits(later.frame(step)) == bits(theirs.frame(step))
    assert program("--replay", "theirs.h5", "--headless")[::2] == (0, "")
    (student / "helpers").mkdir()  # subfolders count, too
    (student / "helpers" / "late.py").write_text("")
    assert_refused("theirs.h5", *given)


# A student's friction, from run_timestep on.
RUBBING = [
    *VARIANTS["friction"],
    ("maxIterations=1000, tolerance=0.0):", "maxIterations=1000, tolerance=0.0, mu=0.0):"),
    ("normal, point, CRCoeff)", "normal, point, CRCoeff, mu)"),
    ("lowest[1], up, lowest, CRCoeff)", "lowest[1], up, lowest, CRCoeff, mu)"),
]


@pytest.mark.parametrize("name", ["frictionCoeff", "μ"])
def test_friction_is_passed_on_by_the_students_own_name(name, tmp_path, positions):
    edits = [(old, re.sub(r"\bmu\b", name, new)) for old, new in RUBBING]
    student, shifts = write_submission(tmp_path / "student", edits), []
    for friction in (0.0, 0.5):
        options = "--functions", student, "--friction", friction
        shifts.append(np.ptp(positions("slide", *options)[:, :, [0, 2]], axis=0).max())
    assert shifts[1] < 0.8 * shifts[0]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one process")
def test_one_ctrl_c_ends_an_endless_step_and_tells_the_line(tmp_path):
    loop = "    open('hangs', 'w').close()\n    while True:\n        pass\n"
    hang = "    velocities = velocities -", f"{loop}    velocities = velocities -"
    given = "--functions", written(tmp_path / "student", edited(hang)), "--headless"
    process = start(tmp_path, "tower_chain", *given, "--steps", 40, "--record", "kept.h5")
    begin = time.monotonic()
    while not (tmp_path / "hangs").exists():
        assert time.monotonic() - begin < 60
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=30)
    assert process.returncode == 130 and "stopped by Ctrl-C\n" in output
    place = r"at RBSFunctions.py:\d+ in resolve_velocity_constraint, called from RBSFunctions.py:"
    assert re.search(rf"step 27 was stopped by Ctrl-C {place}", errors)
    assert Recording(tmp_path / "kept.h5").lastStep == 26
