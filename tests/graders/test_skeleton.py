"""The released skeleton as students have it, and a right solution on top of it."""

import re

import pytest
from handIns import rows_in
from skeletonVariants import (
    ALONE,
    BOTH,
    MISTAKES,
    QUATERNION,
    TEXT,
    WHOLE,
    variant,
    written,
)

GRADERS = ("integrationGrading.py", "ResolveCollisionsGrading.py", "Constraints.py")
HAND_INS = {"alone": ALONE, "both": BOTH, "whole": WHOLE}
SUPPLIED = "Quaternion.py is not in the submission; the coursework supplies it"


# ---- A right solution ---------------------------------------------------------------------------


@pytest.mark.parametrize("name", HAND_INS)
@pytest.mark.parametrize("grader", GRADERS)
def test_a_right_solution_passes_alone_and_with_what_is_supplied(grader, name, tmp_path, run):
    graded = run(grader, "--modules", written(tmp_path / "a", HAND_INS[name]))
    assert graded.returncode == 0, graded.stdout + graded.stderr
    assert "<-- wrong" not in graded.stdout
    assert (SUPPLIED in graded.stdout) == (name == "alone")
    if grader == "integrationGrading.py":
        told = "wrong, but not graded, because the coursework supplies QExp (Quaternion.py:"
        assert (f"QExp of several rows: {told}" in graded.stdout) == (name != "alone")
    if grader == "ResolveCollisionsGrading.py":
        assert re.search(
            "fixed on the ground: wrong, but not graded: .*wrecking_ball", graded.stdout
        )


@pytest.mark.parametrize("name", HAND_INS)
def test_its_steps_agree(name, tmp_path, run):
    compared = run("compare.py", written(tmp_path / "a", HAND_INS[name]), "mixed", "--steps", 40)
    assert compared.returncode == 0, compared.stdout
    assert compared.stdout.splitlines()[-1].startswith("40 steps agree")


def test_a_fixed_body_on_the_ground_needs_the_guard(tmp_path, run):
    """Which the graders tell, and the coursework's scenes do not ask for."""
    for name, files, code in (("a", BOTH, 1), ("b", variant(*MISTAKES["guarded"][0]), 0)):
        compared = run("compare.py", written(tmp_path / name, files), "wrecking_ball", "--steps", 9)
        assert compared.returncode == code, compared.stdout
        assert ("ZeroDivisionError" in compared.stdout) == bool(code)


# ---- Mistakes -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def graded(tmp_path_factory, run):
    """The grades of all variants, in one run: (rows of grades.csv, rows of marks.csv)."""
    place = tmp_path_factory.mktemp("variants")
    for name, (edits, _hint) in MISTAKES.items():
        written(place / "in" / name, variant(*edits))
    written(place / "in" / "skeleton", {"RBSFunctions.py": TEXT, "Quaternion.py": QUATERNION})
    assert run("grade.py", place / "in", "--out", place / "out").returncode == 1
    return rows_in(place / "out" / "grades.csv"), rows_in(place / "out" / "marks.csv")


@pytest.mark.parametrize("name", MISTAKES)
def test_each_variant_gets_its_verdict_and_hint(name, graded):
    hint = MISTAKES[name][1]
    notes = " ".join(row["notes"] for row in graded[0][name]).strip()
    assert (hint in notes) and bool(notes) == bool(hint), notes
    assert notes.count("hint: ") == notes.count(hint) or not hint, notes  # and no other one


def test_the_skeleton_gets_nothing_and_a_share_counts(graded):
    marks = {name: float(row["total"]) for name, (row,) in graded[1].items()}
    assert marks["skeleton"] == 0.0
    assert marks["guarded"] == marks["lists"] == marks["NumPy's zeros"] > marks["no-reshape"]
    assert float(graded[1]["no-reshape"][0]["integrate_timestep"]) == pytest.approx(6.3)
    assert "gives lists where run_timestep needs arrays" in graded[0]["lists"][0]["remarks"]


def test_a_wrong_exponential_of_ones_own_is_told_and_costs_nothing(tmp_path, run):
    """Where integrate_timestep does not call it."""
    own = "\nright = QExp\nQExp = lambda q: np.hstack([np.cos(q[:, :1]), q[:, 1:]])\n"
    files = variant(("QExp(half)", "right(half)"), **{"Quaternion.py": QUATERNION + own})
    graded = run(GRADERS[0], "--modules", written(tmp_path / "a", files))
    assert graded.returncode == 0
    assert re.search("QExp of one row: wrong, but not graded, .*differs by [1-9]", graded.stdout)
