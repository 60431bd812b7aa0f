"""The released skeleton as students have it, and a right solution on top of it."""

import json
import os
import shutil
import subprocess
import sys

import pytest
from handIns import rows_in
from oracles import ROOT
from studentVariants import FUNCTIONS, UNTOUCHED, VARIANTS, on_skeleton, written

BOTH = on_skeleton()
ALONE = {FUNCTIONS: BOTH[FUNCTIONS]}
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
    submissions = {"s1234567": ALONE | {"report.pdf": "%PDF"}, "whole": WHOLE}
    for name, files in (submissions | {"=untouched": UNTOUCHED}).items():
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
    for files in (on_skeleton(*VARIANTS["skeleton-no-reshape"]), {"report.pdf": ""}):
        shutil.rmtree(tmp_path / "submission", ignore_errors=True)
        written(tmp_path / "submission", {f"my code/{name}": text for name, text in files.items()})
        ended = subprocess.run([program], capture_output=True, timeout=600, **form)
        assert ended.returncode == 0, ended.stderr
        results = json.loads((tmp_path / "results" / "results.json").read_text("utf-8"))
        if FUNCTIONS in files:
            assert results["score"] == pytest.approx(29.53)
        else:
            assert (results["score"], results["output"]) == (0, "has no RBSFunctions.py")
