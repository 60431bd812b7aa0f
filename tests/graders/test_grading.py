"""Grading submissions: a whole class by `grade.py`, and single ones by the graders themselves."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys

import handIns
import pytest
import studentVariants
from handIns import EXPECTED, LIMIT, RIGHT, TEXT, WRONG, rows_in, start, stopped
from isolated.archives import find_submissions, read
from oracles import ROOT
from program import wait_for
from studentVariants import FUNCTIONS, VARIANTS, edited, grades_of, write_submission, written


def test_each_hand_in_is_found_and_read_and_stays_as_it_was(tmp_path):
    """All of them, without grading: the name, the remark or refusal, and the module."""
    handIns.write_hand_ins(tmp_path / "in")
    sizes = {path: path.stat().st_size for path in tmp_path.rglob("*")}
    found = find_submissions([tmp_path / "in"])
    assert sorted(handIn.name for handIn in found) == sorted(EXPECTED)
    plain = 0
    for handIn in found:
        fate, text = EXPECTED[handIn.name]
        read(handIn)
        if fate not in (RIGHT, WRONG) and not re.search("to do: |opens a window", fate):
            assert fate in handIn.problem
            continue
        assert not handIn.problem
        if re.search("found|read as|^in |not graded|name", text):
            assert text in " ".join(handIn.remarks)
        plain += handIn.files["code/RBSFunctions.py"] == TEXT.encode()
    assert plain >= 7
    assert sizes == {path: path.stat().st_size for path in tmp_path.rglob("*")}
    assert not os.path.exists("/tmp/escaped.py") and not list(tmp_path.rglob("escaped.py"))


def graded(place):
    """Grades all hand-ins until Ctrl-C, and resumes where the output lacks letters of hints.

    Returns (output folder, what the first run said, the second one's output, its errors).
    """
    handIns.write_hand_ins(place / "in")
    arguments = place / "in", "--out", place / "out", "--time-limit", LIMIT, "--jobs", 2
    (place / "tmp").mkdir()
    process, seen = start(*arguments, env=os.environ | {"TMPDIR": str(place / "tmp")}), set()
    # so many processes that one hand-in is graded
    wait_for(lambda: seen.update((place / "tmp").glob("running-*")) or len(seen) > 12)
    first = stopped(process, place / "out", signal.SIGINT)
    kept = (place / "out" / "marks.csv").read_bytes().splitlines()[1:]
    process = start(*arguments, "--resume", env=os.environ | {"PYTHONIOENCODING": "cp1252"})
    printed, errors = process.communicate(timeout=900)
    assert process.returncode == 1, errors
    assert set(kept) < set((place / "out" / "marks.csv").read_bytes().splitlines())
    return place / "out", first, printed, errors


@pytest.mark.slow
def test_each_gets_the_expected_outcome_also_after_ctrl_c(tmp_path):
    """In marks, sheets and results alike."""
    out, (code, said, count), printed, errors = graded(tmp_path)
    assert (code, errors) == (130, "") and 0 < count < len(EXPECTED)
    assert said.startswith(f"grade.py: stopped with {count} of {len(EXPECTED)} graded")
    assert handIns.mismatches(out) == {}
    passing = sum(fate == RIGHT for fate, _text in EXPECTED.values())
    assert printed.splitlines()[-1].startswith(f"{passing} of {len(EXPECTED)} pass, ")
    marks = rows_in(out / "marks.csv")
    for name, (row,) in marks.items():
        results = json.loads((out / "gradescope" / name / "results.json").read_text("utf-8"))
        isRefused = row["state"] != "graded"
        assert row["of"] == ("" if isRefused else "30")  # a refusal is no mark
        assert float(row["total"] or 0) == pytest.approx(results["score"])
        assert sum(test["max_score"] for test in results["tests"]) == (0 if isRefused else 30)
        assert sum(test["score"] for test in results["tests"]) == pytest.approx(results["score"])
        sheet = (out / f"{name}.txt").read_text("utf-8")
        for note in row["notes"].split(" | "):
            assert note in sheet
        assert (EXPECTED[name][0] == RIGHT) == (row["total"] == "30")
    assert marks["skeleton"][0]["total"] == "0"  # nothing for what stays right of itself
    assert "\x1b" not in (out / "=SUM(1).txt").read_text("utf-8")
    assert "\n'=SUM(1)," in (out / "marks.csv").read_text("utf-8-sig")


def test_a_loose_file_makes_no_hand_in_of_a_class_and_who_leaves_leaves_no_sheet(tmp_path, run):
    files = {f"in/{one}/RBSFunctions.py": "1 / 0" for one in "abc"} | {"in/RBSFunctions.py": ""}
    written(tmp_path, files)
    for count, options in ((4, ()), (3, ("--resume",))):
        graded = run("grade.py", "in", "--out", "out", *options, cwd=tmp_path)
        assert "a loose .py file is not read" in graded.stdout
        assert f"0 of {count} pass" in graded.stdout
        for kind in ("*.txt", "gradescope/*"):
            assert len([*(tmp_path / "out").glob(kind)]) == count
        shutil.rmtree(tmp_path / "in" / "b", ignore_errors=True)


def test_a_scene_that_differs_fails(tmp_path, run):
    frozen = "    m1.isFixed = True\n    # interpenetration\n"
    write_submission(tmp_path / "in" / "frozen", [("    # interpenetration\n", frozen)])
    graded = run("grade.py", "in", "--scenes", "--out", "out", cwd=tmp_path)
    assert (graded.returncode, graded.stderr) == (1, "") and "0 of 1 pass" in graded.stdout
    (row,) = rows_in(tmp_path / "out" / "marks.csv")["frozen"]
    assert row["failed"] == "scene mixed" and row["passed"] == "36 of 36"
    assert row["notes"].startswith("scene mixed: step 43: resolve_collision: isFixed of cyl")
    assert float(row["total"]) < float(row["of"]) == 45


def test_two_mistakes_are_found_together():
    edits = VARIANTS["restitution-twice"] + VARIANTS["no-rotational-term"]
    twice, rotational = grades_of(edited(*edits))[1].told
    assert twice.startswith("resolve_collision: hint: ") and "counted twice: (1 + 2 CR" in twice
    assert "leaves out the rotational part" in rotational


IMPULSE = "    # velocities\n"
LAST = "    m1.update_vertices()\n    m2.update_vertices()\n"
SHAPE = "the mesh's position has shape \\(3, 3\\) instead of 3 numbers"
FAULTS = (
    (IMPULSE, "    raise ValueError('so\\n\\x1b[31mwrong')\n", ":{line}.*ValueError: so \\[31mwr"),
    (IMPULSE, "    raise NotImplementedError\n", "not implemented: RBSFunctions.py:{line}"),
    (LAST, "    m2.position = np.eye(3)\n", SHAPE),
    ("class Mesh:", "class Body:", "not implemented: RBSFunctions.py has no Mesh"),
)


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault[1].strip()[:30])
def test_an_error_is_reported_with_its_line_and_the_rest_is_graded(fault):
    old, new, expected = fault
    files = edited((old, new))
    lines = files[FUNCTIONS].splitlines()
    (line,) = [k for k, text in enumerate(lines, start=1) if new.strip() in text]
    grade = grades_of(files)[1]
    assert grade.wrong
    assert any(re.search(expected.format(line=line), note) for note in grade.told), grade.told
    right = [one.name for one in grade.quantities if one.isRight]
    assert ("rotated inverse inertia" in right) == (old in (IMPULSE, LAST))


def test_a_number_is_no_truth():
    told = grades_of(edited(("return True, currPositions", "return 0.5, currPositions")))[2].told
    assert told[0].startswith("positionWasValidUpper is 0.5, neither True nor False")


def test_a_students_modules_may_have_the_names_of_ours(tmp_path, run):
    """Also the names of the graders' folders and modules, and of Python's own."""
    top = "import reference, worker, GJK, random\n"
    top += "assert reference.k + worker.k + GJK.k + random.k == 4\n"
    top += "import polyscope as ps, polyscope.imgui as psim\nps.init()\nps.show()\n"
    top += "while not ps.window_requests_close():\n    ps.frame_tick()\n"
    write_submission(tmp_path / "student", [(TEXT[:40], top + TEXT[:40])])
    for name in ("reference", "worker", "GJK", "random"):
        (tmp_path / "student" / f"{name}.py").write_text("k = 1\n")
    graded = run("Constraints.py", "--modules", tmp_path / "student")
    assert graded.returncode == 0, graded.stdout


# The released skeleton as students have it, and a right solution on top of it.
BOTH = studentVariants.on_skeleton()
# As a whole folder is handed in: with what the release's folder holds.
WHOLE = {f"code/{name}": text for name, text in BOTH.items()}
WHOLE |= {
    "code/vec3.py": "import cppyy\ncppyy.cppdef('never compiled')\n",
    "code/RBSLoadVis.py": "from RBSFunctions import Mesh\n",
    "code/RigidBodySimulation.py": "import polyscope\npolyscope.init()\npolyscope.show()\n",
    "data/singletet-scene.txt": "0\n",
    "report.pdf": "%PDF-1.4\n",
}
SUPPLIED = "Quaternion.py is not in the submission; the coursework supplies it"


@pytest.fixture(scope="module")
def marked(tmp_path_factory, run):
    """A folder with `in` and `out`: a solution alone and as a whole, and an untouched skeleton."""
    place = tmp_path_factory.mktemp("class")
    submissions = {"s1234567": {FUNCTIONS: BOTH[FUNCTIONS], "report.pdf": "%PDF"}, "whole": WHOLE}
    for name, files in (submissions | {"=untouched": studentVariants.UNTOUCHED}).items():
        written(place / "in" / name, files)
    graded = run("grade.py", place / "in", "--out", place / "out")
    assert graded.returncode == 1 and graded.stdout.splitlines()[-1].startswith("2 of 3 pass, ")
    return place


def test_a_right_solution_passes_alone_and_with_what_is_supplied(marked):
    marks = rows_in(marked / "out" / "marks.csv")
    for name in ("s1234567", "whole"):
        remarks = marks[name][0]["remarks"]
        assert marks[name][0]["total"] == marks[name][0]["of"] == "30"
        assert marks[name][0]["notes"] == ""
        assert (SUPPLIED in remarks) == (name == "s1234567")
    assert "By the marker: report, of 25\n" in (marked / "out" / "whole.txt").read_text("utf-8")
    assert "\n'=untouched," in (marked / "out" / "marks.csv").read_text("utf-8-sig")


def test_a_submission_that_was_replaced_is_graded_again(marked, tmp_path, run):
    shutil.copytree(marked, tmp_path / "class")
    source, out = tmp_path / "class" / "in", tmp_path / "class" / "out"
    before = rows_in(out / "marks.csv")
    (source / "=untouched" / "RBSFunctions.py").write_text(BOTH[FUNCTIONS])
    run("grade.py", source, "--out", out, "--resume")
    after = rows_in(out / "marks.csv")
    assert (before["=untouched"][0]["total"], after["=untouched"][0]["total"]) == ("0", "30")
    assert before["whole"] == after["whole"]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Gradescope runs Linux")
def test_gradescope_runs_it_in_its_layout(tmp_path):
    """/autograder/source, submission and results, as its documentation has them."""
    (tmp_path / "source").symlink_to(ROOT)
    path = f"{os.path.dirname(sys.executable)}{os.pathsep}{os.environ['PATH']}"
    form = {"env": os.environ | {"AUTOGRADER_ROOT": str(tmp_path), "PATH": path}}
    program = ROOT / "graders" / "gradescope" / "run_autograder"
    for files in (studentVariants.files_of_variant("skeleton-no-reshape"), {"report.pdf": ""}):
        shutil.rmtree(tmp_path / "submission", ignore_errors=True)
        written(tmp_path / "submission", {f"my code/{name}": text for name, text in files.items()})
        ended = subprocess.run([program], capture_output=True, timeout=600, **form)
        assert ended.returncode == 0, ended.stderr
        results = json.loads((tmp_path / "results" / "results.json").read_text("utf-8"))
        if FUNCTIONS in files:
            assert results["score"] == pytest.approx(29.53)
        else:
            assert (results["score"], results["output"]) == (0, "has no RBSFunctions.py")
