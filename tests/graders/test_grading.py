"""Grading submissions: a whole class by `grade.py`, and single ones by the graders themselves."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys

import pytest
import studentVariants
from handIns import EXPECTED, RIGHT, mismatches, rows_in, start, stopped, write_hand_ins
from oracles import ROOT
from studentVariants import HALF_DONE, MISTAKES, write_submission

GRADERS = ROOT / "graders"
NAMES = ("integrationGrading", "ResolveCollisionsGrading", "Constraints")


def run(script, *arguments, cwd=None):
    return subprocess.run(
        [sys.executable, GRADERS / script, *map(str, arguments)],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=300,
    )


def grade_student(grader, folder, *arguments):
    return run(f"{grader}.py", "--modules", folder, *arguments)


def notes_of(process):
    """The lines between the table and the verdict, and how many quantities fail."""
    assert process.returncode in (0, 1), process.stderr
    _head, _table, *middle, last = process.stdout.rstrip("\n").split("\n\n")
    assert last.startswith("FAIL:" if process.returncode else "PASS:")
    count = int(re.match(r"FAIL: (\d+)", last).group(1)) if process.returncode else 0
    return middle[0].splitlines() if middle else [], count


# ---- A class ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def graded(tmp_path_factory):
    """All hand-ins, stopped by Ctrl-C and gone on with where the output has no letters for hints:
    (folder of the hand-ins, output folder, what the first run said, what the second one did)."""
    place = tmp_path_factory.mktemp("class")
    write_hand_ins(place / "in")
    arguments = place / "in", "--out", place / "out", "--time-limit", 4, "--jobs", 2
    process = start(*arguments)
    first = stopped(process, place / "out", 8, signal.SIGINT)
    kept = (place / "out" / "marks.csv").read_bytes().splitlines()[1:]
    environment = os.environ | {"PYTHONIOENCODING": "cp1252"}
    process = start(*arguments, "--resume", env=environment)
    printed, errors = process.communicate(timeout=600)
    assert process.returncode == 1, errors
    assert set(kept) < set((place / "out" / "marks.csv").read_bytes().splitlines())
    return place / "in", place / "out", first, printed, errors


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one process")
def test_ctrl_c_keeps_what_is_graded(graded):
    code, said, count = graded[2]
    assert code == 130 and 8 <= count < len(EXPECTED)
    assert said == f"grade.py: stopped with {count} of {len(EXPECTED)} graded; --resume goes on"


def test_each_gets_what_it_is_due(graded):
    assert mismatches(graded[1], EXPECTED) == {}


def test_what_is_handed_in_stays_as_it_was(graded, tmp_path):
    write_hand_ins(tmp_path / "again")
    before, after = (
        {path.relative_to(one): path.stat().st_size for path in one.rglob("*")}
        for one in (tmp_path / "again", graded[0])
    )
    assert before == after
    assert not list(graded[0].parent.rglob("escaped.py"))


def test_the_table_says_the_same_where_letters_are_missing(graded):
    _place, out, _first, printed, errors = graded
    assert errors == ""
    rows = [row for rows in rows_in(out / "grades.csv").values() for row in rows]
    lines = printed.splitlines()
    assert lines[0].split() == ["submission", "grader", "passed", "largest", "error", "hint"]
    for row, line in zip(rows, lines[1:], strict=False):
        name = row["submission"].removeprefix("'").encode("ascii", "replace")
        assert line.encode("ascii", "replace").startswith(name)
        assert row["grader"] in line
        assert (f" {row['passed']}/{row['of']} " in line) != (" refused " in line)
    passing = sum(fate == RIGHT for fate, _text in EXPECTED.values())
    assert lines[-1].startswith(f"{passing} of {len(EXPECTED)} pass, ")
    assert f"6 of {len(EXPECTED)} fail: everything: refused" in printed


def test_marks_sheets_and_results_agree(graded):
    _place, out, *_rest = graded
    marks, grades = rows_in(out / "marks.csv"), rows_in(out / "grades.csv")
    assert set(marks) == set(EXPECTED)
    for name, (row,) in marks.items():
        results = json.loads((out / "gradescope" / name / "results.json").read_text("utf-8"))
        of = row["of"]
        assert of == "35"
        assert float(row["total"]) == pytest.approx(results["score"])
        assert sum(test["max_score"] for test in results["tests"]) == float(of)
        assert sum(test["score"] for test in results["tests"]) == pytest.approx(results["score"])
        sheet = (out / f"{name}.md").read_text("utf-8")
        for note in " | ".join(one["notes"] for one in grades[name]).split(" | "):
            assert note in sheet.replace("\\", "")
        assert (EXPECTED[name][0] == RIGHT) == (row["total"] == of)
    assert marks["skeleton"][0]["total"] == "0"  # nothing for what stays right of itself
    assert 0 < float(marks["half"][0]["total"]) < 20
    assert "\x1b" not in (out / "=SUM(1).md").read_text("utf-8")
    assert (out / "grades.csv").read_text("utf-8-sig").count("\n'=SUM(1),") == 3


def test_copies_are_alike_and_others_are_not(graded):
    _place, out, *_rest = graded
    with open(out / "likeness.csv", encoding="utf-8-sig") as file:
        rows = [line.rstrip("\n").rsplit(",", 2) for line in file][1:]
    pairs = {frozenset(names) for *names, _percent in rows}
    percent = {frozenset(names): int(text) for *names, text in rows}
    assert percent[frozenset(("bom", "copy"))] > 90  # other names and layout
    assert not any("ours" in pair or "skeleton" in pair and "ours" in pair for pair in pairs)
    assert [int(text) for *_names, text in rows] == sorted(percent.values(), reverse=True)


def test_names_may_stay_unknown(tmp_path):
    for name in ("Anna", "Bob", "Carl"):
        write_submission(tmp_path / "in" / name / "Anna Bob Carl", HALF_DONE)
    out, key = tmp_path / "out", tmp_path / "key.csv"
    options = ("--out", out, "--anonymous", "--key", key)
    assert run("grade.py", tmp_path / "in", *options).returncode == 1
    numbers, *others = zip(*rows_of_key(key), strict=True)
    assert numbers == ("001", "002", "003")
    assert sorted(zip(*others, strict=True)) == [
        (name, str(tmp_path / "in" / name)) for name in ("Anna", "Bob", "Carl")
    ]
    written = [path for path in out.rglob("*") if path.is_file()]
    assert len(written) == 3 + 2 * 3
    for path in written:
        assert not re.search("Anna|Bob|Carl", str(path.relative_to(out)) + path.read_text("utf-8"))
    first = key.read_bytes()
    (tmp_path / "in" / "Anna").rename(tmp_path / "in" / "Zoë")
    assert run("grade.py", tmp_path / "in", *options).returncode == 1
    assert key.read_bytes() == first + f"004,Zoë,{tmp_path / 'in' / 'Zoë'}\r\n".encode()


def rows_of_key(key):
    return [row.split(",") for row in key.read_text("utf-8-sig").splitlines()[1:]]


def test_a_scheme_of_ones_own_and_another_grading_is_not_gone_on_with(tmp_path):
    write_submission(tmp_path / "student", MISTAKES["normal-sign"])
    scheme = tmp_path / "marks.ini"
    scheme.write_text("[a]\nresolve_collision = 8\nget_rotated_inv_IT = 2\n[b]\nscenes = 5\n")
    options = ("--out", tmp_path / "out", "--marks", scheme)
    assert run("grade.py", tmp_path / "student", *options).returncode == 1
    ((row,),) = rows_in(tmp_path / "out" / "marks.csv").values()
    assert 0 < float(row["resolve_collision"]) < 8 and "scenes" not in row
    assert row["get_rotated_inv_IT"] == "2" and row["of"] == "10"
    scheme.write_text("[a]\nresolve_collision = 8\n")
    graded = run("grade.py", tmp_path / "student", *options, "--resume")
    assert graded.returncode == 2 and "marks.csv: has other columns" in graded.stderr


# ---- The three graders --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def released_data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("released")
    made = run("make_reference.py", "--convention", "released-2024", "--out", folder)
    assert made.returncode == 0, made.stderr
    return folder


@pytest.mark.parametrize("grader", NAMES)
def test_a_right_solution_passes_with_either_data(grader, tmp_path, released_data):
    write_submission(tmp_path / "student")
    for folder in (tmp_path / "student", ROOT):
        assert grade_student(grader, tmp_path / "student").returncode == 0
        assert notes_of(grade_student(grader, folder, "--data", released_data)) == ([], 0)


@pytest.mark.parametrize("grader", NAMES)
def test_a_solution_may_change_its_arguments(grader, tmp_path):
    edits = [edit for edit in studentVariants.IN_PLACE if "push = C" not in edit[0]]
    write_submission(tmp_path / "student", edits)
    assert notes_of(grade_student(grader, tmp_path / "student")) == ([], 0)


def test_two_mistakes_are_told_together(tmp_path):
    write_submission(
        tmp_path / "student", MISTAKES["restitution-twice"] + MISTAKES["no-rotational-term"]
    )
    notes, count = notes_of(grade_student("ResolveCollisionsGrading", tmp_path / "student"))
    assert count > 3
    assert [note.split(": ")[:2] for note in notes] == [["resolve_collision", "hint"]] * 2
    assert "counted twice: (1 + 2 CRCoeff)" in notes[0]
    assert "leaves out the rotational part" in notes[1]


def line_of(folder, text):
    """The number of the line of RBSFunctions.py that holds a text."""
    lines = (folder / "RBSFunctions.py").read_text(encoding="utf-8").splitlines()
    (number,) = [number for number, line in enumerate(lines, start=1) if text in line]
    return number


IMPULSE = "    # velocities\n"
RETURN = "        return isCollision, depth, normal, point"
LAST = "    m1.update_vertices()\n    m2.update_vertices()\n"


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            IMPULSE,
            "    raise ValueError('so\\n\\x1b[31mwrong | <b>')\n",
            "resolve_collision.*RBSFunctions.py:{line}.*: ValueError: so \\[31mwrong \\| <b>",
        ),
        (
            IMPULSE,
            "    raise NotImplementedError('later')\n",
            "not implemented: RBSFunctions.py:{line}.*: NotImplementedError: later",
        ),
        (IMPULSE, "    raise SystemExit(0)\n", "RBSFunctions.py:{line}.*: SystemExit: 0"),
        (
            IMPULSE,
            "    raise KeyError\n",
            "RBSFunctions.py:{line}.*: KeyError \\(in 51 of 100 samples, first in ",
        ),
        (
            LAST,
            "    m2.position = np.eye(3)\n",
            "the mesh's position has shape \\(3, 3\\) where 3 numbers are expected",
        ),
        (LAST, "    m2.position = None\n", "not implemented: the mesh's position is None"),
        (RETURN, "        pass", "detect_collision: not implemented: .* returns nothing"),
        (RETURN, "        return isCollision, depth", "returns 2 values, not 4"),
        (RETURN, "        return 7, 0, [0] * 3, [0] * 3", "isCollision is 7, neither True nor"),
        ("class Mesh:", "class Body:", "not implemented: RBSFunctions.py has no Mesh"),
        (
            "def resolve_collision(",
            "def resolve_collisions(",
            "resolve_collision.*: not implemented: RBSFunctions.py has no resolve_collision",
        ),
    ],
)
def test_what_fails_or_is_wrong_is_told_and_the_rest_is_graded(old, new, told, tmp_path):
    folder = write_submission(tmp_path / "student", [(old, new)])
    told = told.format(line=line_of(folder, new.strip().splitlines()[-1]))
    graded = grade_student("ResolveCollisionsGrading", folder)
    notes, count = notes_of(graded)
    assert count > 0
    assert any(re.search(told, note) for note in notes), notes
    if old is IMPULSE:
        assert "isCollision                        0 differ" in graded.stdout


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("def f(:\n", "cannot be imported: RBSFunctions.py:1: SyntaxError: "),
        (
            "import np_does_not_exist\n",
            "cannot be imported: RBSFunctions.py:1: ModuleNotFoundError: ",
        ),
        ("import sys\nsys.exit('bye')\n", "cannot be imported: RBSFunctions.py:2: SystemExit: bye"),
        ("import Quaternion, GJK\n", "cannot be imported: RBSFunctions.py:1: there is no GJK.py"),
    ],
)
def test_modules_that_cannot_be_imported_fail_everything_with_the_cause(text, told, tmp_path):
    write_submission(tmp_path / "student")
    (tmp_path / "student" / "RBSFunctions.py").write_text(text)
    graded = grade_student("integrationGrading", tmp_path / "student")
    notes, count = notes_of(graded)
    assert count == int(re.search(r"of (\d+) quantities", graded.stdout)[1])
    assert notes and all(told in note for note in notes)


def test_nothing_of_ours_takes_the_place_of_what_is_missing(tmp_path):
    write_submission(tmp_path / "student")
    (tmp_path / "student" / "Quaternion.py").unlink()
    notes, _count = notes_of(grade_student("Constraints", tmp_path / "student"))
    assert all("there is no Quaternion.py" in note for note in notes)
    shutil.copy(GRADERS.parent / "Quaternion.py", tmp_path / "student")
    (tmp_path / "student" / "RBSFunctions.py").rename(tmp_path / "student" / "rbsfunctions.PY")
    graded = grade_student("Constraints", tmp_path / "student")
    assert notes_of(graded) == ([], 0)
    assert "rbsfunctions.PY is read as RBSFunctions.py" in graded.stdout
    (tmp_path / "student" / "rbsfunctions.PY").unlink()
    graded = grade_student("Constraints", tmp_path / "student")
    assert graded.returncode == 1 or "holds no RBSFunctions.py" in graded.stderr


@pytest.mark.parametrize(
    ("options", "cause"),
    [
        (["--modules", "nowhere"], "nowhere: there is no such file or folder"),
        (["--modules", "."], ".: there is no submission in this folder"),
        (["--modules", ".", "--time-limit", "0"], "must be 0.1 or more, not 0.0"),
        (["--modules", ".", "--memory-limit", "much"], "'much' is not a whole number"),
        (["--modules", ".", "--data", "nowhere"], "integration.data: cannot be read"),
    ],
)
def test_wrong_options_get_one_line(options, cause, tmp_path):
    graded = run("integrationGrading.py", *options, cwd=tmp_path)
    assert graded.returncode == 2
    assert graded.stdout == ""
    (line,) = graded.stderr.splitlines()
    assert cause in line
