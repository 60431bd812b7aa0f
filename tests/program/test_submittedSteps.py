"""A student's functions in our step: `--functions DIR`, and the first difference from ours."""

import re
import signal
import sys

import numpy as np
import pytest
import studentVariants
from oracles import DATA
from program import bits, call, start, wait_for
from studentVariants import edited, files_of_variant, table_rows, write_submission, written

from rbs.program.submittedsteps import SubmittedSteps
from rbs.recordings.recording import Recording
from rbs.scenes.simulation import SceneSimulation, go_beside
from rbs.scenes.state import inertias_of
from rbs.stepping.settings import Settings

STEPS = 60
# Those that return other contacts fail in no part, but their bodies move otherwise.
RIGHT = [name for name, row in table_rows().items() if row[3] == "0" and row[2][:6] != "detect"]
QUICK = "lists-and-plain-vectors released vertices-as-a-property box-kept-by-the-constructor"
SLOW = [pytest.param(one, marks=pytest.mark.slow) for one in RIGHT if one not in QUICK.split()]


def beside(folder, scene="mixed", **settings):
    """A simulation with the functions in a folder, with ours beside it."""
    submitted, settings = SubmittedSteps(folder), Settings(**settings)
    theirs = SceneSimulation(DATA / f"{scene}-scene.txt", settings, submitted=submitted)
    go_beside(theirs)
    return theirs


def first_difference(theirs, steps=STEPS):
    while theirs.beside.difference is None and theirs.stepCount < steps:
        theirs.step()
    return theirs.beside.difference


@pytest.mark.parametrize("name", [*QUICK.split(), *SLOW])
def test_a_right_solution_does_not_differ_from_ours(name, tmp_path):
    """Whatever its form, and whatever its own run_timestep does."""
    folder = written(tmp_path, files_of_variant(name))
    for scene in ("mixed", "tower_chain"):
        theirs, impulses = beside(folder, scene), ([], [])
        for step in range(STEPS):
            if step == 20:  # a copy takes a body's place
                theirs.add(theirs.meshes[3]), theirs.remove(3)
            theirs.step()
            for found, run in zip(impulses, (theirs, theirs.beside.ours), strict=True):
                found += [contact.impulse for contact in run.report.contacts]
        assert theirs.beside.difference is None
        assert ("allowed for" in theirs.beside.remark) == (name == "released")
        assert impulses[0] == pytest.approx(impulses[1], rel=1e-6) and any(impulses[0])


NO_SPIN = "total + np.sum(c1 * (c1 @ invI1.T)) + ", "total + "
EVEN_SHARES = "invMasses[1] / total * push", "0.5 * push"
LAST_BLOCK = "-n, -np.cross(r2, n)", "-n, np.cross(r2, n)"
UNTURNED = "R @ self.invIT @ R.T", "self.invIT"
GROUND_TURNS = "m2.get_rotated_inv_IT()", "invI1"
HALF_GRAVITY = "timeStep * gravity", "0.5 * timeStep * gravity"
NO_TORQUE = "j * c1 @ invI1.T\n    m2.angV", "0.0\n    m2.angV"
ASIDE = "    m1.update_vertices", "    m1.orientation = m1.orientation[:, ::-1]"
# Scene, mistake, step, symbol that differs, words of the hint.
WRONG = [
    ("mixed", NO_SPIN, 43, "K", "leaves out the rotational part"),
    ("mixed", UNTURNED, 43, "K", "inertia tensor is not turned to world axes"),
    ("mixed", GROUND_TURNS, 43, "K", "mesh 1's inertia tensor is used for mesh 2 as well"),
    ("mixed", NO_TORQUE, 43, "ω1′", "the angular velocities stay as they were"),
    ("tower_chain", EVEN_SHARES, 27, "COM2′", "half of the correction"),
    ("tower_chain", LAST_BLOCK, 27, "ω2′", "the last block of J has the wrong sign"),
    ("mixed", HALF_GRAVITY, 1, "v′", "the velocity changes by g h/2"),
    ("mixed", (ASIDE[0], "\n".join(ASIDE[::-1])), 43, "", ""),
]


@pytest.mark.parametrize(("scene", "edit", "step", "symbol", "hint"), WRONG)
def test_the_first_difference_is_named(scene, edit, step, symbol, hint, tmp_path):
    theirs = beside(write_submission(tmp_path, [edit]), scene)
    found = first_difference(theirs)
    assert found.step == step == theirs.stepCount and hint in found.hint
    assert symbol in found.symbols if symbol else found.state.name == "orientation"
    assert all("theirs" in line for line in found.lines(theirs.meshes)[bool(symbol) :])
    theirs.step()


FRICTION = """    slip = m1.linVelocity + np.cross(m1.angVelocity, r1) - m2.linVelocity
    slip = slip - np.cross(m2.angVelocity, r2)
    slip = slip - np.sum(slip * n) * n
    speed = max(np.linalg.norm(slip), 1e-12)
    t = slip / speed
    c1, c2 = np.cross(r1, t), np.cross(r2, t)
    K = total + np.sum(c1 * (c1 @ invI1.T)) + np.sum(c2 * (c2 @ invI2.T))
    f = min(speed / K, mu * max(j, 0.0))
    m1.linVelocity = m1.linVelocity - m1.invMass * f * t
    m2.linVelocity = m2.linVelocity + m2.invMass * f * t
    m1.angVelocity = m1.angVelocity - f * c1 @ invI1.T
    m2.angVelocity = m2.angVelocity + f * c2 @ invI2.T
    m1.update_vertices"""
RUBBED = [("f = min", "f = min", ""), ("f = min", "f = -min", "friction has the wrong sign")]
RUBBED += [("mu * max(j, 0.0)", "1e9", "friction has no limit")]


@pytest.mark.parametrize(("old", "new", "hint"), RUBBED)
def test_friction_by_the_students_own_name(old, new, hint, tmp_path):
    edits = [("penPoint, CRCoeff):", "penPoint, CRCoeff, frictionCoeff=0.0):")]
    body = FRICTION.replace(old, new).replace("mu *", "frictionCoeff *")
    edits += [("    m1.update_vertices", body)]
    found = first_difference(beside(write_submission(tmp_path, edits), "slide", friction=0.3), 20)
    assert bool(found) == bool(hint) and (not hint or hint in found.hint)


def write_more(folder, text):
    """Writes the solution, and this text at its end; the folder."""
    with (write_submission(folder) / "RBSFunctions.py").open("a") as file:
        file.write(f"\n\n{text}\n")
    return folder


# A function, what it also does to its first body, and the step, place and words of the difference.
KEPT = [
    ("resolve_collision", "isFixed = True", 43, "impulse", "is False in ours, True in theirs"),
    ("resolve_collision", "invMass *= 2", 43, "impulse", "invMass of cylinder 1 after contact 1"),
    ("resolve_collision", "invIT = given[0].get_rotated_inv_IT()", 43, "impulse", "invIT of"),
    ("Mesh.integrate_timestep", "isFixed = True", 1, "free flight", "isFixed of"),
    ("Mesh.integrate_timestep", "isFixed = False", 1, "the end", "is True in ours, False in"),
    ("Mesh.detect_collision", "IT = 3 * given[0].IT", 1, "the end", "IT of long-octahedron 0 at"),
]


@pytest.mark.parametrize(("function", "change", "step", "place", "words"), KEPT)
def test_what_no_step_changes_is_named_where_theirs_does(
    function, change, step, place, words, tmp_path
):
    text = "def changed(*given, right={0}):\n    found = right(*given)\n    given[0].{1}\n"
    text += "    return found\n{0} = changed"
    theirs = beside(write_more(tmp_path, text.format(function, change)))
    found = first_difference(theirs)
    (line,) = found.lines(theirs.meshes)
    assert found.step == step and words in line and place in line
    before = inertias_of(theirs.beside.ours.meshes)
    theirs.step()
    assert np.array_equal(inertias_of(theirs.beside.ours.meshes), before)


def test_their_detection_counts(tmp_path):
    never = "Mesh.detect_collision = lambda self, m: (False, [], [], [])"
    assert first_difference(beside(write_more(tmp_path, never), "tower_chain")) is not None
    short, none = never.replace("False", "True"), "Mesh.get_rotated_inv_IT = lambda self: None"
    for text, name in ((short, "detect_collision"), (none, "get_rotated_inv_IT")):
        with pytest.raises(ArithmeticError, match=f"{name}: .*(depth has shape|is None)"):
            first_difference(beside(write_more(tmp_path / name, text), "tower_chain"))


def test_gravity_arguments_and_names_are_right_for_a_careless_student(tmp_path):
    """They know only the Earth, edit given arrays, and store numbers in a mesh under our names."""
    careless = """import copy
right, moved = resolve_collision, resolve_position_constraint
make, fly = Mesh.__init__, Mesh.integrate_timestep
def made(self, *given): make(self, *given); self.own, self._row, self.load, self.pose = 1.0, 1, 1, 1
def integrate(self, h):
    fly(self, h * self.own * self._row * self.load * self.box())
    self.currVertices[:] = self.hull = 7
Mesh.__init__, Mesh.integrate_timestep = made, integrate
Mesh.bounding_box = Mesh.box = Mesh.lowest_vertex = lambda self: self.pose
def resolve_collision(m1, m2, depth, n, p, e):
    right(copy.deepcopy(m1), copy.deepcopy(m2), depth, n, p, e)
    right(m1, m2, depth, n, p, e * m1.hull / 7); n *= 0.0; p += 9.0; m1.currVertices[:] = 7.0
def resolve_position_constraint(x, p, *others):
    found = moved(x, p, *others); x[0][:] = p[1][:] = 7.0; return found
"""
    folder = write_more(tmp_path, careless)
    assert first_difference(beside(folder, "tower_chain", gravity=(1.0, -20.0, 3.0)), 40) is None


def test_a_class_that_refuses_or_remembers_what_it_is_given(tmp_path):
    """Rest vertices are known by their id, and isFixed has no setter; a body is freed."""
    careful = """make, known = Mesh.__init__, {}
def made(self, *given):
    make(self, *given); self.kept = known.setdefault(id(self.origVertices), self)
def detect(self, m, right=Mesh.detect_collision):
    return right(self, m) if known[id(self.origVertices)] is self else (False, [], [], [])
def once(self, value):
    if "kept" in vars(self): raise ValueError("set once")
    self.first = value
Mesh.__init__, Mesh.detect_collision = made, detect
Mesh.isFixed = property(lambda self: self.first, once)
"""
    theirs = beside(write_more(tmp_path, careful), "tower_chain")
    for _ in range(2):
        assert first_difference(theirs, theirs.stepCount + STEPS) is None
        fixed = theirs.meshes[0]
        assert fixed.isFixed == (theirs.stepCount == STEPS)
        for run in (theirs, theirs.beside.ours):
            run.meshes[0].isFixed = False


def test_both_go_back_together(tmp_path):
    theirs = beside(write_submission(tmp_path, [HALF_GRAVITY]))
    begin = theirs.state()
    for back in (lambda: theirs.restore(begin), theirs.reset):
        for _ in range(5):
            theirs.step()
        ours = theirs.beside.ours
        assert not np.array_equal(theirs.state()["positions"], ours.state()["positions"])
        back()
        assert bits(theirs.state()) == bits(ours.state()) and ours.stepCount == 0


@pytest.fixture
def program(tmp_path, monkeypatch, capsys):
    """Runs the program in a folder of its own: (exit code, output, errors)."""
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: call(capsys, *arguments)


LOOP, GRAVITY = "        if not self.isFixed:\n            gravity", "np.array([[0.0, -9.8, 0.0]])"
LEAVE = "        'cylinder 0' == self.name or os._exit(7)"
FAIL, STOP = "        fail = lambda: 1 / 0\n        fail()", "        raise KeyboardInterrupt"
# What replaces what in the student's file; options; the exit code, and what the line says.
FAILURES = [
    (LOOP, f"{FAIL}\n{LOOP}", "", 3, "RBSFunctions.py:{line} in <lambda>, called from RBS"),
    (GRAVITY, GRAVITY.replace("-9.8", "np.nan"), "", 3, "'cylinder 0': position holds nan"),
    (LOOP, f"{STOP}\n{LOOP}", "", 130, "RBSFunctions.py:{line} in integrate"),
    (LOOP, f"{LEAVE}\n        self.invMass *= 2\n{LOOP}", "", 3, "SystemExit: 7"),
    (LOOP, f"        self.linVelocity = 'fast'\n        return\n{LOOP}", "", 3, "of 'cylinder 0'"),
    (LOOP, f"        self.position = 1j * self.position\n        return\n{LOOP}", "", 3, "complex"),
    ("def resolve_collision(", "def resolve(", "", 2, "RBSFunctions.py has no resolve_collision"),
    ("import cppyy\n", "import cppyy.gbl.nothing\n", "", 2, "RBSFunctions.py:{line}: ModuleNotF"),
    ("", "", "--friction 0.3", 2, "friction"),
    ("", "", "--solver soft-step", 2, "one by one"),
    ("", "", "--scheduling batches", 2, "one by one"),
]


@pytest.mark.parametrize(("old", "new", "options", "code", "cause"), FAILURES)
def test_what_goes_wrong_is_reported_in_one_line(old, new, options, code, cause, tmp_path, program):
    student = write_submission(tmp_path / "student", [(old, new)] if old else [])
    lines = (student / "RBSFunctions.py").read_text().splitlines()
    line = 1 + next((k for k, text in enumerate(lines) if text in new.splitlines()), 0)
    arguments = "two_cylinder", "--headless", "--steps", 3, "--functions", student, *options.split()
    ended, output, errors = program(*arguments)
    assert ended == code and (code != 2 or output == "") and errors.count("\n") == 1, errors
    assert cause.format(line=line) in errors
    if code == 3 and not options:
        simulation = beside(student, "two_cylinder")
        before = simulation.state()
        with pytest.raises(ArithmeticError, match="step 1 cannot be made: "):
            simulation.step()
        assert simulation.state().rows.tobytes() == before.rows.tobytes()
        found = simulation.beside.difference
        assert (found.step, found.symbols[0]) == (1, "v′") if "nan" in new else found is None


@pytest.mark.parametrize("outcome", ["pass", "raise TypeError('of another cause')"])
def test_ctrl_c_counts_whatever_a_students_code_makes_of_it(outcome, tmp_path, program):
    stop = f"signal.raise_signal(2)\n        except BaseException: {outcome}"
    lines = f"        import signal\n        try: {stop}\n{LOOP}"
    given = "--functions", write_submission(tmp_path / "student", [(LOOP, lines)])
    for mode in ("--headless", "--trace=5"):
        ended, *told = program("singlebox", mode, *given)
        assert ended == 130 and "stopped by Ctrl-C" in "".join(told)
        assert "cause" not in told[1] and (mode == "--headless" or told[0] == "")


def test_what_a_students_code_leaves_does_not_outlive_the_program(tmp_path):
    left = "import atexit, threading\natexit.register(open, 'late', 'w')\n"
    left += "threading.Timer(60.0, open, ['later', 'w']).start()\n"
    student = write_submission(tmp_path / "student", [("import os\n", f"{left}import os\n")])
    process = start(tmp_path, "tower", "--headless", "--steps", 2, "--functions", student)
    assert "no difference" in process.communicate(timeout=300)[0] and process.returncode == 0
    assert [one.name for one in tmp_path.iterdir()] == ["student"]


def test_code_runs_in_its_folder_and_the_program_in_its_own(tmp_path, program):
    text = "open('mine.txt').close(); os.chdir('..'); io.TextIOWrapper(sys.stdout.buffer)"
    text += "; io.TextIOWrapper(sys.stdout.detach()); sys.stdout.close(); sys.stdout = None"
    text += "; import numpy, polyscope; numpy.seterr(all='raise'); polyscope.init()"
    edits = ("import os\n", f"import io, os, sys\n{text}\n"), (LOOP, f"        {text}\n{LOOP}")
    written(tmp_path / "a" / "student", {"mine.txt": ""} | edited(*edits))
    words = "--steps", 1, "--functions", "a/student", "--record", "kept.h5"
    ended, output, errors = program("singlebox", *words)
    assert (ended, errors) == (0, "") and "kept.h5" in output and (tmp_path / "kept.h5").exists()
    assert np.geterr()["under"] == "ignore"


def test_a_recording_belongs_to_the_functions_that_made_it(tmp_path, program):
    """It is resumed and verified with these functions only; it is replayed without them."""
    student = written(tmp_path / "student", studentVariants.on_skeleton())
    (student / "Quaternion.py").unlink()  # which the coursework supplies
    given = "--functions", student / "RBSFunctions.py"
    for name, *options in (("theirs.h5", *given), ("ours.h5",)):
        words = "mixed", "--basic", "--steps", STEPS, "--record", name
        assert program(*words, *options)[0] == 0
    theirs = Recording("theirs.h5")

    def assert_refused(name, *options):
        for mode in ("--verify", "--resume"):
            assert f"{name}: " in program(mode, name, *options)[2].splitlines()[-1]

    assert_refused("theirs.h5")
    assert_refused("ours.h5", *given)
    assert program("--verify", "theirs.h5", *given)[0] == 0
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


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one process")
def test_one_ctrl_c_ends_an_endless_step_and_tells_the_line(tmp_path):
    loop = "    open('hangs', 'w').close()\n    while True:\n        pass\n"
    hang = "    velocities = velocities -", f"{loop}    velocities = velocities -"
    given = "--functions", written(tmp_path / "student", edited(hang)), "--headless"
    process = start(tmp_path, "tower_chain", *given, "--steps", 40, "--record", "kept.h5")
    wait_for((tmp_path / "student" / "hangs").exists, lambda: process.poll() is None)
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=300)
    assert process.returncode == 130 and "stopped by Ctrl-C\n" in output
    place = r"at RBSFunctions.py:\d+ in resolve_velocity_constraint"
    assert re.search(rf"step 27 was stopped by Ctrl-C {place}", errors)
    assert Recording(tmp_path / "kept.h5").lastStep == 26
