"""What the graders tell students: right ones, half done ones, and each of the classic mistakes."""

import csv
import re
import subprocess
import sys

import pytest
import studentVariants
from oracles import ROOT
from studentVariants import HALF_DONE, MISTAKES, RELEASED, TURNED_BACK, write_submission

GRADERS = ROOT / "graders"
NAMES = ("integrationGrading", "ResolveCollisionsGrading", "Constraints")
EXACT, RELEASED_2024 = "exact", "released-2024"

# By whom each mistake is noticed, and how many quantities fail: in the exact convention, and in the
# released one, which does not grade detection. Then what is told, and nothing else is.
TOLD = {
    "complete": [],
    "explicit-euler": [("integrationGrading", 1, 1, "explicit Euler: ")],
    "quaternion-order": [("integrationGrading", 1, 1, "multiplied in the wrong order")],
    "normal-sign": [("ResolveCollisionsGrading", 2, 2, "the normal has the wrong sign")],
    "no-rotational-term": [("ResolveCollisionsGrading", 4, 4, "leaves out the rotational part")],
    "velocity-lost": [
        ("ResolveCollisionsGrading", 1, 1, "mesh 2's corrected linear velocity is lost"),
    ],
    "tensor-not-rotated": [
        ("ResolveCollisionsGrading", 5, 5, "is not turned to world axes"),
        ("Constraints", 4, 4, "is not turned to world axes"),
    ],
    "restitution-twice": [("ResolveCollisionsGrading", 4, 4, "counted twice: (1 + 2 CRCoeff)")],
    "fixed-moved": [
        ("integrationGrading", 1, 1, "a fixed mesh falls like a free one"),
        ("ResolveCollisionsGrading", 1, 1, "a fixed mesh is moved and pushed like a free one"),
    ],
    "com-not-subtracted": [
        ("ResolveCollisionsGrading", 9, 5, "the COM is not subtracted"),
        ("Constraints", 10, 10, "the COM is not subtracted"),
    ],
    "bounds-swapped": [("Constraints", 6, 6, "the bounds are exchanged")],
}


@pytest.fixture(scope="session")
def released_data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("released")
    made = run("make_reference.py", "--convention", RELEASED_2024, "--out", folder)
    assert made.returncode == 0, made.stderr
    return folder


def run(script, *arguments, cwd=None):
    return subprocess.run(
        [sys.executable, GRADERS / script, *map(str, arguments)],
        cwd=cwd, capture_output=True, text=True, timeout=300,
    )  # fmt: skip


def grade_student(grader, folder, *arguments):
    return run(f"{grader}.py", "--modules", folder, *arguments)


def notes_of(process):
    """The lines between the table and the verdict, and how many quantities fail."""
    assert process.returncode in (0, 1), process.stderr
    _head, _table, *middle, last = process.stdout.rstrip("\n").split("\n\n")
    assert last.startswith("FAIL:" if process.returncode else "PASS:")
    count = int(re.match(r"FAIL: (\d+)", last).group(1)) if process.returncode else 0
    return middle[0].splitlines() if middle else [], count


# ---- The table of what each is told -------------------------------------------------------------


@pytest.fixture(scope="module", params=[EXACT, RELEASED_2024])
def graded(request, tmp_path_factory, released_data):
    """`grade.py` on all solutions of one convention: (convention, its printout, rows by name)."""
    convention = request.param
    place = tmp_path_factory.mktemp("graded")
    edits = {"complete": [], "half-done": HALF_DONE} | MISTAKES
    for name, edit in edits.items():
        edit = edit if convention == EXACT else studentVariants.released(edit)
        write_submission(place / "handed-in" / name, edit)
    options = ["--data", released_data] if convention == RELEASED_2024 else []
    process = run(
        "grade.py", place / "handed-in", "--out", place / "out", "--jobs", 2,
        "--convention", convention, *options,
    )  # fmt: skip
    assert process.returncode == 1, process.stderr
    assert process.stderr == ""
    with open(place / "out" / "grades.csv", newline="", encoding="utf-8") as file:
        rows = {(row["submission"], row["grader"]): row for row in csv.DictReader(file)}
    assert set(rows) == {(name, grader) for name in edits for grader in NAMES}
    return convention, process.stdout, rows, place / "out"


@pytest.mark.parametrize("name", TOLD)
def test_each_is_told_its_mistake_and_nothing_else(name, graded):
    convention, _printed, rows, _out = graded
    told = {grader: (exact, released, text) for grader, exact, released, text in TOLD[name]}
    for grader in NAMES:
        row = rows[name, grader]
        failing = int(row["of"]) - int(row["passed"])
        assert row["convention"] == convention
        if grader not in told:
            assert failing == 0
            assert row["notes"] == ""
            assert float(row["largest error"]) < 1e-9
            continue
        exact, released, text = told[grader]
        assert failing == (exact if convention == EXACT else released)
        assert float(row["largest error"]) > 1e-3
        for note in row["notes"].split(" | "):
            assert text in note
            assert "hint: " in note


def test_who_is_half_done_is_told_what_is_missing(graded):
    _convention, _printed, rows, _out = graded
    integration, collisions, constraints = (rows["half-done", grader] for grader in NAMES)
    assert integration["passed"] == integration["of"]
    assert collisions["notes"].split(" | ") == [
        "get_rotated_inv_IT: not implemented: get_rotated_inv_IT gives the identity",
        "resolve_collision: not implemented: the impulse; the velocities stay as they were",
    ]
    assert int(collisions["of"]) - int(collisions["passed"]) == 5
    assert constraints["passed"] == "0"
    assert constraints["notes"].split(" | ") == [
        "resolve_position_constraint: not implemented: every position is called valid and left as "
        "it was",
        "resolve_velocity_constraint: not implemented: RBSFunctions.py has no "
        "resolve_velocity_constraint",
    ]


@pytest.mark.parametrize("grader", NAMES)
def test_the_skeleton_is_told_what_is_missing_and_nothing_else(grader, tmp_path):
    write_submission(tmp_path / "student", studentVariants.SKELETON)
    notes, count = notes_of(grade_student(grader, tmp_path / "student"))
    failing = {"integrationGrading": 3, "ResolveCollisionsGrading": 7, "Constraints": 11}
    assert count == failing[grader]
    missing = {
        "integrationGrading": ["integrate_timestep leaves the mesh as it was"],
        "ResolveCollisionsGrading": [
            "get_rotated_inv_IT gives the identity",
            "resolve_collision leaves both meshes as they were",
        ],
        "Constraints": [
            "every position is called valid and left as it was",
            "every velocity is called valid and left as it was",
        ],
    }
    told = [note.split(": ", 1)[1] for note in notes]
    assert told == [f"not implemented: {what}" for what in missing[grader]]


@pytest.mark.parametrize("grader", NAMES)
def test_a_solution_may_change_its_arguments(grader, tmp_path):
    write_submission(tmp_path / "student", studentVariants.IN_PLACE)
    assert notes_of(grade_student(grader, tmp_path / "student")) == ([], 0)


def test_table_and_sheets_say_the_same(graded):
    convention, printed, rows, out = graded
    header, *lines = printed.splitlines()
    assert header.split() == ["submission", "grader", "passed", "largest", "error", "hint"]
    assert re.fullmatch(
        rf"1 of 12 pass, convention {convention}, [\d.]+ s; sheets and grades.csv in .*", lines[-1]
    )
    for (name, grader), row in rows.items():
        (line,) = [line for line in lines if line.split()[:2] == [name, grader]]
        assert line.split()[2] == f"{row['passed']}/{row['of']}"
        sheet = (out / f"{name}.md").read_text(encoding="utf-8")
        assert f": {row['passed']} of {row['of']}\n" in sheet
        for note in filter(None, row["notes"].split(" | ")):
            assert note in sheet.replace("\\", "")
    assert len(list(out.iterdir())) == 12 + 1


# ---- Conventions --------------------------------------------------------------------------------


@pytest.mark.parametrize("grader", NAMES)
def test_a_right_solution_passes_under_the_released_convention(grader, tmp_path, released_data):
    """The released tensor is set absolutely; a student whose tensor is right is not told off."""
    write_submission(tmp_path / "student")
    options = ("--data", released_data, "--convention", RELEASED_2024)
    assert notes_of(grade_student(grader, tmp_path / "student", *options)) == ([], 0)
    assert notes_of(grade_student(grader, ROOT, *options)) == ([], 0)
    assert notes_of(grade_student(grader, ROOT)) == ([], 0)


@pytest.mark.parametrize(
    ("edits", "text"),
    [
        (RELEASED, "are those of --convention released-2024, with whose data this passes"),
        ([studentVariants.SMALL_TENSOR], "your inertia tensor is 6 times too small"),
        ([TURNED_BACK], "turned to world axes the other way round"),
    ],
    ids=["released", "small", "turned back"],
)
def test_the_exact_convention_tells_the_quirks_of_the_release(edits, text, tmp_path):
    write_submission(tmp_path / "student", edits)
    for grader in NAMES[1:]:
        notes, count = notes_of(grade_student(grader, tmp_path / "student"))
        assert count == {"ResolveCollisionsGrading": 5, "Constraints": 4}[grader]
        assert notes
        assert all(text in note for note in notes)


def test_data_of_the_other_convention_are_told_apart_from_a_mistake(tmp_path, released_data):
    write_submission(tmp_path / "student")
    graded = grade_student(
        "Constraints", tmp_path / "student", "--data", released_data, "--convention", EXACT
    )
    assert notes_of(graded) == (
        ["resolve_velocity_constraint: hint: these are the numbers of --convention exact, but not "
         "those of the data"],
        4,
    )  # fmt: skip


# ---- Hints --------------------------------------------------------------------------------------


def test_two_mistakes_are_told_together(tmp_path):
    write_submission(
        tmp_path / "student", MISTAKES["restitution-twice"] + MISTAKES["no-rotational-term"]
    )
    notes, count = notes_of(grade_student("ResolveCollisionsGrading", tmp_path / "student"))
    assert count == 4
    assert [note.split(": ")[:2] for note in notes] == [["resolve_collision", "hint"]] * 2
    assert "counted twice: (1 + 2 CRCoeff)" in notes[0]
    assert "leaves out the rotational part" in notes[1]


@pytest.mark.parametrize(
    ("grader", "edit", "failing"),
    [
        ("integrationGrading", ("-9.8", "-9.81"), 2),
        ("ResolveCollisionsGrading", ("j = (1.0 + CRCoeff) *", "j = (1.0001 + CRCoeff) *"), 4),
        ("Constraints", ("push = C * difference", "push = 0.999 * C * difference"), 4),
    ],
)  # fmt: skip
def test_what_no_known_mistake_explains_gets_no_hint(grader, edit, failing, tmp_path):
    write_submission(tmp_path / "student", [edit])
    assert notes_of(grade_student(grader, tmp_path / "student")) == ([], failing)


# ---- What is not written yet, or fails ----------------------------------------------------------


def line_of(folder, text):
    """The number of the line of RBSFunctions.py that holds a text."""
    lines = (folder / "RBSFunctions.py").read_text(encoding="utf-8").splitlines()
    (number,) = [number for number, line in enumerate(lines, start=1) if text in line]
    return number


IMPULSE = "    # velocities\n"


@pytest.mark.parametrize(
    ("new", "told"),
    [
        ("    raise ValueError('so\\n\\x1b[31mwrong | <b>')\n",
         "RBSFunctions.py:{line}: ValueError: so [31mwrong | <b>"),
        ("    raise NotImplementedError('later')\n",
         "not implemented: RBSFunctions.py:{line}: NotImplementedError: later"),
        ("    raise SystemExit(0)\n", "RBSFunctions.py:{line}: SystemExit: 0"),
        ("    raise KeyError\n", "RBSFunctions.py:{line}: KeyError (in 51 of"),
        ("    m1.linVelocity = np.zeros((3, 3)); raise IndexError\n",
         "RBSFunctions.py:{line}: IndexError"),
    ],
)  # fmt: skip
def test_exceptions_are_told_with_their_line_and_the_rest_is_graded(new, told, tmp_path):
    folder = write_submission(tmp_path / "student", [(IMPULSE, new)])
    line = line_of(folder, new.strip())
    notes, count = notes_of(grade_student("ResolveCollisionsGrading", folder))
    assert notes[0].startswith("resolve_collision: " + told.format(line=line))
    assert " (in 51 of 100 samples, first in " in notes[0]
    assert count == 8 + 1  # resolve_collision, and that with a fixed mesh
    assert "isCollision                        0 differ" in grade_student(
        "ResolveCollisionsGrading", folder
    ).stdout


RETURN = "        return isCollision, depth, normal, point"
LAST = "    m1.update_vertices()\n    m2.update_vertices()\n"


@pytest.mark.parametrize(
    ("edits", "told"),
    [
        ([(LAST, "    m2.position = np.eye(3)\n")],
         "resultPositions, mesh 2: the mesh's position has shape (3, 3) where 3 numbers are "
         "expected (in 51 of 100 samples, first in "),
        ([(LAST, "    m2.position = None\n")],
         "resultPositions, mesh 2: not implemented: the mesh's position is None"),
        ([(RETURN, "        pass")],
         "detect_collision: not implemented: Mesh.detect_collision returns nothing"),
        ([(RETURN, "        return isCollision, depth")],
         "detect_collision: Mesh.detect_collision returns 2 values, not 4"),
        ([(RETURN, "        return 7, 0, 0, 0")],
         "detect_collision: isCollision is 7, neither True nor False"),
        ([("class Mesh:", "class Body:")], "detect_collision: not implemented: RBSFunctions.py has "
         "no Mesh"),
        ([("def resolve_collision(", "def resolve_collisions(")],
         "resolve_collision: not implemented: RBSFunctions.py has no resolve_collision"),
    ],
)  # fmt: skip
def test_wrong_results_and_missing_functions_are_told(edits, told, tmp_path):
    write_submission(tmp_path / "student", edits)
    notes, count = notes_of(grade_student("ResolveCollisionsGrading", tmp_path / "student"))
    assert count > 0
    assert any(note.startswith(told) for note in notes), notes


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("def f(:\n", "cannot be imported: RBSFunctions.py:1: SyntaxError: "),
        ("import np_does_not_exist\n",
         "cannot be imported: RBSFunctions.py:1: ModuleNotFoundError: "),
        ("import sys\nsys.exit('bye')\n", "cannot be imported: RBSFunctions.py:2: SystemExit: bye"),
    ],
)  # fmt: skip
def test_modules_that_cannot_be_imported_fail_everything_with_the_cause(text, told, tmp_path):
    write_submission(tmp_path / "student")
    (tmp_path / "student" / "RBSFunctions.py").write_text(text)
    notes, count = notes_of(grade_student("integrationGrading", tmp_path / "student"))
    assert count == 5
    assert len(notes) == 2
    assert all(told in note for note in notes)


def test_what_the_folder_lacks_is_ours(tmp_path):
    write_submission(tmp_path / "student")
    (tmp_path / "student" / "Quaternion.py").unlink()
    graded = grade_student("Constraints", tmp_path / "student")
    assert notes_of(graded) == ([], 0)
    assert "Quaternion.py is not there: this project's is used" in graded.stdout
    write_submission(tmp_path / "other")
    (tmp_path / "other" / "RBSFunctions.py").unlink()
    graded = grade_student("ResolveCollisionsGrading", tmp_path / "other")
    assert notes_of(graded) == ([], 0)
    assert "RBSFunctions.py is not there: this project's is used" in graded.stdout


# ---- Command lines ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "cause"),
    [
        (["--modules", "nowhere"], "nowhere: there is no such folder"),
        (["--modules", "."], ".: holds neither RBSFunctions.py nor Quaternion.py"),
        (["--time-limit", "3"], "--time-limit and --memory-limit go with --modules"),
        (["--modules", ".", "--time-limit", "0"], "must be a number above 0 and up to 86400"),
        (["--modules", ".", "--memory-limit", "much"], "must be a number above 0"),
        (["--modules", ".", "--data", "nowhere"], "integration.data: cannot be read"),
    ],
)
def test_wrong_options_get_one_line(options, cause, tmp_path):
    graded = run("integrationGrading.py", *options, cwd=tmp_path)
    assert graded.returncode == 2
    assert graded.stdout == ""
    (line,) = graded.stderr.splitlines()
    assert cause in line


