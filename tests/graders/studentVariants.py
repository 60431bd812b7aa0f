"""Submissions for the graders: one student's solution, variants of it, and the skeleton's.

    python tests/graders/studentVariants.py    writes the hints in submissions/variants.md anew

`submissions/student` holds the solution, with the right physics. `submissions/variants.md` lists
small edits of it with names; an edit that no longer fits the solution raises.
"""

import atexit
import functools
import importlib
import re
import shutil
import sys
import tempfile
import zipfile
from pathlib import Path

import numpy as np

FIXTURES = Path(__file__).resolve().parent / "submissions"
STUDENT, TABLE = FIXTURES / "student", FIXTURES / "variants.md"
ROOT = FIXTURES.parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "graders")]

from rbs.program.submissions import load_submission  # noqa: E402

DATA = ROOT / "data"
FUNCTIONS, QUATERNION = "RBSFunctions.py", "Quaternion.py"
# Enough to tell all of them apart.
SAMPLES = 30
GRADERS = ("integrationGrading", "ResolveCollisionsGrading", "Constraints")


def table_rows():
    """The cells of each row of the table, by the variant's name."""
    lines = TABLE.read_text(encoding="utf-8").splitlines()
    rows = [line[2:-2].split(" | ") for line in lines if line.startswith("| ")]
    return {row[0]: row for row in rows[1:]}


# Of each variant the edits: (old text, which occurs once in the two files; new text).
VARIANTS = {
    name: re.findall("`([^`]+)` → `([^`]*)`", row[1].replace("⏎", "\n"))
    for name, row in table_rows().items()
}
# Of run_timestep: a corrected velocity that is lost, and visits that end early, as in the release.
LOST = (
    "            pair[k].linVelocity = linVelocities[k]\n",
    "        pair[0].linVelocity, pair[1].linVelocty = linVelocities\n        for k in (0, 1):\n",
)
EARLY = ("and visits < maxIterations", "and visits * len(constraints) < maxIterations")
START = "    # interpenetration\n"
HOSTILE = {
    "endless-loop": [(START, "    while True:\n        pass\n")],
    "returns-nothing": [("        return isCollision, depth, normal, point\n", "")],
}


def changed(files, edits):
    files = dict(files)
    for old, new in edits:
        counts = {name: text.count(old) for name, text in files.items()}
        assert sum(counts.values()) == 1, f"{sum(counts.values())} times: {old}"
        files = {name: text.replace(old, new) for name, text in files.items()}
    return files


SOLUTION = {name: (STUDENT / name).read_text("utf-8") for name in (FUNCTIONS, QUATERNION)}
# QExp as the coursework supplies it: for one row, and (4,) for a vector part that vanishes.
SUPPLIED_QEXP = """
def QExp(q):
    norm = np.linalg.norm(q[:, 1:4], axis=1)
    if norm < 1e-15:  # ambiguous for more than one row
        return np.exp(q[0, 0]) * np.array([1.0, 0.0, 0.0, 0.0])
    return np.exp(q[:, 0:1]) * np.hstack([np.cos(norm)[:, None], np.sin(norm) / norm * q[:, 1:4]])
"""
# What the released skeleton gives otherwise than the solution does.
SKELETON = [
    ("    if total == 0.0:\n        return\n\n", ""),
    ("        if sum(invMasses) == 0.0:\n            good += 1\n            continue\n", ""),
    LOST,
    EARLY,
    ("np.array(origVertices, dtype=float)", "origVertices"),
    ("np.array(position, dtype=float).reshape(1, 3)", "position"),
    ("        self.mass = 0.0\n        self.invMass = 0.0\n        self.IT = np.zeros((3, 3))\n",
     "        self.invMass = 0.0\n"),
    ("compute_mass()\n        self.", "compute_mass()\n            self."),
    ("6.0 * volumes[:, None", "volumes[:, None"),
    ("        self.invMass = 1.0 / self.mass\n        self.invIT = np.linalg.inv(self.IT)\n"
     "        if self.isFixed:\n            self.invMass = 0.0\n"
     "            self.invIT = np.zeros((3, 3))\n",
     "        if not self.isFixed:\n            self.invMass = 1.0 / self.mass\n"
     "            self.invIT = np.linalg.inv(self.IT)\n"),
    ("        return isCollision, depth, normal, point",
     "        return (True, depth, normal, point) if isCollision else (False, [], [], [])"),
]  # fmt: skip
# With the reshape that the supplied QExp needs.
RESHAPED = ("QMult(QExp(half),", "QMult(QExp(half).reshape(1, 4),")
STUBS = {
    "resolve_velocity_constraint": "    return True, currLinVelocities, currAngVelocities",
    "resolve_position_constraint": "    return True, currPositions",
    "resolve_collision": "    # TODO\n    m1.update_vertices()\n    m2.update_vertices()",
    "get_rotated_inv_IT": "        return np.identity(3)",
    "integrate_timestep": "        self.update_vertices()\n",
}


def on_skeleton(*edits):
    """The solution's functions on the skeleton, after edits."""
    filled = edited(*SKELETON, RESHAPED)
    return changed(filled | {QUATERNION: filled[QUATERNION] + SUPPLIED_QEXP}, edits)


def untouched():
    files = on_skeleton()
    for name, body in STUBS.items():
        pattern = rf"(def {name}\(.*?\):\n).*?(?=\n\n\n|\n\n    def |\Z)"
        files[FUNCTIONS], count = re.subn(pattern, rf"\1{body}", files[FUNCTIONS], flags=re.DOTALL)
        assert count == 1, name
    return files


def files_of_variant(name):
    make = on_skeleton if name.startswith("skeleton-") else edited
    return make(*VARIANTS[name])


def edited(*edits):
    return changed(SOLUTION, edits)


UNTOUCHED = untouched()


def written(folder, files):
    """Writes files into a new folder, a dict from path to text or bytes; returns the folder."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder


def write_submission(folder, edits=()):
    return written(Path(folder), edited(*edits))


def write_zip(path, files):
    """Writes a ZIP; files : dict from the name in the archive to its text or bytes."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


@functools.cache
def first_data(name, folder=DATA):
    """(a grader, the first samples of its data in a folder, and as many fresh ones)"""
    grader = importlib.import_module(name).GRADER
    data = grader.load(folder)
    for key, (_kind, *axes) in grader.layout.items():
        first = tuple(slice(SAMPLES if one == "samples" else None) for one in axes)
        data[key] = np.array(data[key])[first]
    data["inFile"] = len(data["randomPositions"])
    return grader, grader.with_fresh(data, 1)


def grades_of(files):
    """The Grades of a submission by each of the three graders."""
    gradeReport = importlib.import_module("verdict.gradeReport")
    grades, folder = [], Path(tempfile.mkdtemp(prefix="variant-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    found = load_submission(written(folder, files))
    for grader, data in map(first_data, GRADERS):
        outcomes = grader.judge(found.functions, found.quaternion, data, found.folder)
        grades.append(gradeReport.make_grade(grader, outcomes, data))
    return grades


def verdict_on(name):
    """The last cells of a variant's row: the number of failures, and all notes and remarks."""
    grades = grades_of(files_of_variant(name))
    lines = []
    for grade in grades:
        told = "the verdict allows for it", "not graded", "gives lists"
        lines += [text for text in grade.remarks if any(one in text for one in told)]
        lines += grade.told
    return [str(sum(len(one.wrong) for one in grades)), "<br>".join(dict.fromkeys(lines))]


if __name__ == "__main__":
    text = TABLE.read_text(encoding="utf-8")
    for name, row in table_rows().items():
        new = " | ".join(row[:3] + verdict_on(name))
        text = text.replace(f"\n| {' | '.join(row)} |\n", f"\n| {new} |\n")
    TABLE.write_text(text, encoding="utf-8")
