"""Submissions for the graders: one student's solution, and variants of it.

    python tests/graders/studentVariants.py    writes submissions/variants.md anew

`submissions/student` holds the solution, with the right physics. Variants are made of it by small
edits with names; an edit that no longer fits the solution raises. `variants.md` holds the hints for
each, and for those of `skeletonVariants`, and the verdict of graders of the released shape.
"""

import contextlib
import functools
import importlib
import io
import os
import pickle
import runpy
import shutil
import sys
import tempfile
import zipfile
from pathlib import Path
from types import ModuleType

import numpy as np
import skeletonVariants

FIXTURES = Path(__file__).resolve().parent / "submissions"
STUDENT = FIXTURES / "student"
ROOT = FIXTURES.parents[2]
sys.path.insert(0, str(ROOT / "graders"))
DATA = ROOT / "data"
FUNCTIONS, QUATERNION = "RBSFunctions.py", "Quaternion.py"
# Enough to tell all of them apart.
SAMPLES = 30
GRADERS = ("integrationGrading", "ResolveCollisionsGrading", "Constraints")
# As the release calls them.
SCRIPTS = ("IntegrationGrading.py", "ResolveCollisionsGrading.py", "ConstraintsGrading.py")

# An edit: (old text, which occurs once in the two files; new text).
SMALL_TENSOR = ("np.sum(6.0 * volumes[:, None, None]", "np.sum(volumes[:, None, None]")
TURNED_BACK = ("return R @ self.invIT @ R.T", "return R.T @ self.invIT @ R")
RELEASED = (SMALL_TENSOR, TURNED_BACK)
# Of run_timestep: a corrected velocity that is lost, and visits that end early, as in the release.
LOST = (
    "            pair[k].linVelocity = linVelocities[k]\n",
    "        pair[0].linVelocity, pair[1].linVelocty = linVelocities\n        for k in (0, 1):\n",
)
EARLY = ("and visits < maxIterations", "and visits * len(constraints) < maxIterations")

POSITION = "self.position = self.position + timeStep * self.linVelocity"
VELOCITY = "self.linVelocity = self.linVelocity + timeStep * gravity"
GRAVITY = "gravity = np.array([[0.0, -9.8, 0.0]])"
STEP = "QMult(QExp(half), self.orientation)"
HALF = "0.5 * timeStep * self.angVelocity"
START = "    # interpenetration\n"
FACTOR = "j = (1.0 + CRCoeff) *"
VALID = "isValid = bool(C <= tolerance) if upper else bool(C >= -tolerance)"
TENSOR, TENSOR2 = "return R @ self.invIT @ R.T", "invI2 = m2.get_rotated_inv_IT()"
LINEAR1 = "m1.linVelocity = m1.linVelocity - m1.invMass * j * n"
LINEAR2 = "m2.linVelocity = m2.linVelocity + m2.invMass * j * n"
ANGULAR1 = "m1.angVelocity = m1.angVelocity - j * c1 @ invI1.T"
ANGULAR2 = "m2.angVelocity = m2.angVelocity + j * c2 @ invI2.T"
MOVE1 = "m1.position - m1.invMass / total * depth * n"
MOVE2 = "m2.position + m2.invMass / total * depth * n"
ARM1, ARM2 = "r1 = contact - m1.position", "r2 = contact - m2.position\n"
DETECTED = "return isCollision, depth, normal, point"
FLAG, PUSHED = "    return False, ", "(currPositions[0] - invMasses[0] / total * push,"
PUSHED += "\n                   currPositions[1] + invMasses[1] / total * push)"
UPDATE = "self.orientation = QMult(QExp(half), self.orientation)"
RETURNED = "    return False, (v1, v2), (w1, w2)"


def within(text, old, new):
    """The edit of a part of a text that occurs once."""
    return text, text.replace(old, new)


# The classic mistakes.
MISTAKES = {
    "explicit-euler": [(POSITION, f"{POSITION} - timeStep * timeStep * gravity")],
    "quaternion-order": [(STEP, "QMult(self.orientation, QExp(half))")],
    "normal-sign": [within("n = np.reshape(contactNormal, (1, 3))", "= np", "= -np")],
    "no-rotational-term": [(" + np.sum(c1 * (c1 @ invI1.T)) + np.sum(c2 * (c2 @ invI2.T))", "")],
    "velocity-lost": [("m2.linVelocity = m2", "m2.comVelocity = m2")],
    "tensor-not-rotated": [(TENSOR, "return self.invIT")],
    "restitution-twice": [(FACTOR, "j = (1.0 + CRCoeff + CRCoeff) *")],
    "fixed-moved": [
        within("if not self.isFixed:\n            gravity", "not self.isFixed", "True"),
        within("if self.isFixed:\n            self.invMass", "self.isFixed", "False"),
    ],
    "com-not-subtracted": [
        ("self.origVertices -= COM\n        corners = corners - COM\n", "pass\n")
    ],
    "bounds-swapped": [within(VALID, "if upper", "if not upper")],
    "turned-back": [TURNED_BACK],
    "gravity-upwards": [within(GRAVITY, "-", "")],
    "whole-angle": [within(HALF, "0.5 * ", "")],
    "turned-backwards": [(HALF, f"-{HALF}")],
    "first-order": [(STEP, "self.orientation + QMult(half, self.orientation)")],
    "weights-exchanged": [
        within(MOVE1, "m1.invMass", "m2.invMass"),
        within(MOVE2, "m2.invMass", "m1.invMass"),
        within("(1, 3)) + m2.invMass / total", "m2", "m1"),
    ],
    "equal-weights": [(f"invMasses[{k}] / total * push", "0.5 * push") for k in (0, 1)],
    "impulse-sign": [within(FACTOR, "= (", "= -(")],
    "closing-only": [(FACTOR, f"{FACTOR} (np.sum((v1 - v2) * n) > 0) *")],
    "flag-inverted": [
        ("return True, currPositions", "return False, currPositions"),
        ("return False, (currP", "return True, (currP"),
    ],
    "depth-sign": [within(DETECTED, "depth", "-depth")],
}

# The commonest first ones.
FIRST_MISTAKES = {
    "no-h-in-velocity": [within(VELOCITY, "timeStep * ", "")],
    "no-h-in-position": [within(POSITION, "timeStep * ", "")],
    "no-h-in-orientation": [within(HALF, "timeStep * ", "")],
    "gravity-9.81": [within(GRAVITY, "9.8", "9.81")],
    "gravity-along-z": [within(GRAVITY, "-9.8, 0.0", "0.0, -9.8")],
    "gravity-times-mass": [(GRAVITY, f"{GRAVITY} * self.mass")],
    "half-acceleration": [(POSITION, f"{POSITION} - 0.5 * timeStep ** 2 * gravity")],
    "tensor-not-inverted": [within(TENSOR, "invIT", "IT")],
    "tensor-1-for-2": [(TENSOR2, "invI2 = invI1")],
    "tensor-2-for-1": [("invI1 = m1.", "invI1 = m2.")],
    "tensors-exchanged": [(TENSOR2, "invI1, invI2 = m2.get_rotated_inv_IT(), invI1")],
    "arms-exchanged": [(ARM2, f"{ARM2}    r1, r2 = r2, r1\n")],
    "arms-reversed": [(ARM1, "r1 = m1.position - contact"), (ARM2, "r2 = m2.position - contact\n")],
    "spin-without-inertia": [
        within(text, f" @ invI{k}.T", "") for k, text in enumerate((ANGULAR1, ANGULAR2), start=1)
    ],
    "impulse-without-mass": [
        within(text, f"m{k}.invMass * ", "") for k, text in enumerate((LINEAR1, LINEAR2), start=1)
    ],
    "one-minus-restitution": [within(FACTOR, "+", "-")],
    "restitution-alone": [(FACTOR, "j = CRCoeff *")],
    "detection-order": [within(DETECTED, "normal, point", "point, normal")],
    "position-order": [(FLAG + PUSHED, f"    return {PUSHED}, False")],
    "velocity-order": [within(RETURNED, "(v1, v2), (w1, w2)", "(w1, w2), (v1, v2)")],
}

# What the data do not show.
HIDDEN_MISTAKES = {
    "changes-its-arguments": [
        (
            FLAG + PUSHED,
            "    currPositions[0][:] -= invMasses[0] / total * push\n"
            "    currPositions[1][:] += invMasses[1] / total * push\n"
            "    return False, currPositions",
        )
    ],
    "absolute-depth": [(START, "    depth = abs(depth)\n")],
    "two-fixed": [("    if total == 0.0:\n        return\n", "    total = np.float64(total)\n")],
    "qexp-shape": [
        within("return np.exp(q[:, [0]]) * np.conc", "np.exp", "np.squeeze(np.exp"),
        ("q[:, 1:] / safe), axis=1\n    )", "q[:, 1:] / safe), axis=1))"),
        within(STEP, "QExp(half)", "QExp(half).reshape(1, 4)"),
    ],
    "no-tolerance": [(VALID, "isValid = bool(C <= 0.0) if upper else bool(C >= 0.0)")],
    "lower-tolerance-sign": [within(VALID, "-tol", "tol")],
    "stale-vertices": [within(f"{UPDATE}\n        self.update_vertices()", "self.upd", "pass #")],
}

# Right solutions, written otherwise.
IN_PLACE = [
    ("np.array(origVertices, dtype=float)", "origVertices"),
    ("np.array(position, dtype=float).reshape(1, 3)", "position"),
    ("np.array(orientation, dtype=float).reshape(1, 4)", "orientation.reshape(1, 4)"),
    ("m1.linVelocity = m1.linVelocity - m1", "m1.linVelocity -= m1"),
    ("m1.position = m1.position - m1", "m1.position -= m1"),
    ("self.position = self.position + timeStep *", "self.position += timeStep *"),
    within("    push = C * difference / length\n", "length\n", "length\n    difference *= 0.0\n"),
]
RIGHT = {
    "right": [],
    "in-place": IN_PLACE,
    "lists-and-plain-vectors": [
        (
            RETURNED,
            "    return [np.array([False]), [v1[0], v2[0].tolist()], np.array([w1[0], w2[0]])]",
        ),
        (
            "    return True, currPositions\n",
            "    return np.True_, np.concatenate(currPositions)\n",
        ),
        (DETECTED, "return isCollision, float(depth[0]), normal.tolist(), point.reshape(3, 1)"),
        (TENSOR, "return (R @ self.invIT @ R.T).tolist()"),
        ("invI1 = m1.get_rotated_inv_IT()", "invI1 = np.array(m1.get_rotated_inv_IT())"),
        ("invI2 = m2.get_rotated_inv_IT()", "invI2 = np.array(m2.get_rotated_inv_IT())"),
    ],
    "flat-attributes": [
        ("np.array(position, dtype=float).reshape(1, 3)", "np.array(position).reshape(3)"),
        ("self.linVelocity = np.zeros((1, 3))", "self.linVelocity = np.zeros(3)"),
        ("self.angVelocity = np.zeros((1, 3))", "self.angVelocity = np.zeros(3)"),
        ("    difference = currConstPoints[0]", "    difference = np.ravel(currConstPoints[0])"),
        ("- currConstPoints[1]\n    length", "- np.ravel(currConstPoints[1])\n    length"),
    ],
    "vertices-as-a-property": [
        (
            "    def update_vertices(self):\n        self.currVertices = ",
            "    def update_vertices(self):\n        pass\n\n"
            "    @property\n    def currVertices(self):\n        return ",
        )
    ],
    "box-kept-by-the-constructor": [
        (
            "+ self.position\n\n    def get_rotated",
            "+ self.position\n        if len(self.currVertices):\n"
            "            self.low, self.high = self.currVertices.min(0), self.currVertices.max(0)\n"
            "\n    def get_rotated",
        ),
        ("low, high = self.currVertices.min(axis=0), self.currVertices.max(axis=0)", "pass"),
        ("otherLow, otherHigh = m.currVertices.min(axis=0), m.currVertices.max(axis=0)", "pass"),
        ("np.all(high >= otherLow) and", "np.all(self.high >= m.low) and"),
        ("np.all(otherHigh >= low)", "np.all(m.high >= self.low)"),
    ],
    "slots-and-helpers": [
        (
            "class Mesh:\n",
            "class Body:\n    __slots__ = (\n"
            "        'name origVertices faces tets density position orientation isFixed IT '\n"
            "        'invIT linVelocity angVelocity mass invMass currVertices').split()\n\n"
            "    def point_velocity(self, r):\n"
            "        return self.linVelocity + np.cross(self.angVelocity, r)\n"
            "\n\nclass Mesh(Body):\n"
            "    __slots__ = ()\n",
        ),
        ("v1 = m1.linVelocity + np.cross(m1.angVelocity, r1)", "v1 = m1.point_velocity(r1)"),
        ("v2 = m2.linVelocity + np.cross(m2.angVelocity, r2)", "v2 = m2.point_velocity(r2)"),
    ],
    # The skeleton's tensor, alone and with the release's way of turning it.
    "small-tensor": [SMALL_TENSOR],
    "released": RELEASED,
}

# Half done: collisions move the meshes apart but give no impulse, tensor and position constraint
# are the skeleton's stubs, and the velocity constraint is not there at all.
HALF_DONE = [
    ("    # velocities\n", "    return\n"),
    (TENSOR, "return np.identity(3)"),
    ("    C = length - refValue\n", "    return True, currPositions\n    C = length - refValue\n"),
    ("def resolve_velocity_constraint(", "def resolve_velocities_some_day("),
]

# The skeleton as it is handed out: stubs for all that is to be written.
SKELETON = [
    within("if not self.isFixed:\n            gravity", "not self.isFixed", "False"),
    ("    n = np.reshape(contactNormal, (1, 3))\n", "    return\n"),
    *HALF_DONE[1:3],
    (
        "    n = (currConstPoints[0] - currConstPoints[1]).reshape(3)\n",
        "    return True, currLinVelocities, currAngVelocities\n",
    ),
]

UNFINISHED = {
    "half-done": HALF_DONE,
    "skeleton": SKELETON,
    "raises": [("    # velocities\n", "    raise ValueError('an impulse of no size')\n")],
}
VARIANTS = RIGHT | HIDDEN_MISTAKES | FIRST_MISTAKES | MISTAKES | UNFINISHED

HOSTILE = {
    "endless-loop": [(START, "    while True:\n        pass\n")],
    "os-exit": [(START, "    os._exit(7)\n")],
}


def edited(edits):
    """The text of RBSFunctions.py and of Quaternion.py after edits."""
    texts = [(STUDENT / name).read_text(encoding="utf-8") for name in (FUNCTIONS, QUATERNION)]
    for old, new in edits:
        counts = [text.count(old) for text in texts]
        assert sum(counts) == 1, f"{sum(counts)} times: {old}"
        texts[counts.index(1)] = texts[counts.index(1)].replace(old, new)
    return texts


def write_submission(folder, edits=()):
    """Writes the student's files, edited, into a new folder; returns its path."""
    folder = Path(folder)
    folder.mkdir(parents=True)
    for name, text in zip((FUNCTIONS, QUATERNION), edited(edits), strict=True):
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def write_zip(path, files):
    """Writes a ZIP; files : dict from the name in the archive to its text or bytes."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def files_of(folder):
    """For `write_zip`: a submission's files."""
    return {path.name: path.read_bytes() for path in sorted(Path(folder).glob("*.py"))}


def texts_of(name):
    """The texts of RBSFunctions.py and of Quaternion.py of a variant, or of the skeleton's."""
    if name in VARIANTS:
        return edited(VARIANTS[name])
    functions = skeletonVariants.variant(*skeletonVariants.MISTAKES[name])["RBSFunctions.py"]
    return [functions, skeletonVariants.QUATERNION]


@contextlib.contextmanager
def loaded(texts):
    """Within it, RBSFunctions and Quaternion are a student's; yields the two modules.

    texts : of RBSFunctions.py and of Quaternion.py
    """
    sys.path[:0] = paths = [str(ROOT / "graders" / "released")]
    ours = {
        name: sys.modules.pop(name, None) for name in ("RBSFunctions", "Quaternion", "RBSLoadVis")
    }
    try:
        for name, text in zip(("Quaternion", "RBSFunctions"), reversed(texts), strict=True):
            sys.modules[name] = module = ModuleType(name)
            exec(compile(text, STUDENT / f"{name}.py", "exec"), vars(module))
        yield sys.modules["RBSFunctions"], sys.modules["Quaternion"]
    finally:
        for name, module in ours.items():
            sys.modules.pop(name, None)
            if module is not None:
                sys.modules[name] = module
        for path in paths:
            sys.path.remove(path)


@functools.cache
def first_data(name, folder=DATA):
    """(a grader, the first samples of its data in a folder)"""
    grader = importlib.import_module(name).GRADER
    data = grader.load(folder)
    return grader, data | {
        key: first_samples(data[key], layout[1:]) for key, layout in grader.layout.items()
    }


def first_samples(array, axes):
    """The first ones of an array. axes : as in a layout"""
    return np.array(array)[tuple(slice(SAMPLES if one == "samples" else None) for one in axes)]


def grades_of(texts, folder=DATA):
    """The Grades of two modules by each of the three graders, on the data in a folder."""
    given = [first_data(name, folder) for name in GRADERS]
    bodies = importlib.import_module("verdict.bodies")
    gradeReport = importlib.import_module("verdict.gradeReport")
    grades = []
    with loaded(texts) as modules:
        for grader, data in given:
            outcomes = grader.judge(bodies.Bodies(*modules, data), data, STUDENT)
            grades.append(gradeReport.make_grade(grader, outcomes, data))
    return grades


def hints_of(grades):
    """The notes of grades, and what was replaced, as lines."""
    lines = []
    for grade in grades:
        told = "replaced for this verdict", "not graded", "gives lists"
        lines += [text for text in grade.remarks if any(one in text for one in told)]
        lines += [f"{what}: {text}" for what, text in grade.notes]
    # The skeleton's own, which is no mistake of a variant.
    return [one for one in dict.fromkeys(lines) if not one.startswith("QExp of several rows")]


def released_error(texts, place):
    """The largest error that the graders of the released shape print, infinite if one fails.

    place : a folder with `grading` and `data`
    """
    errors = []
    here = os.getcwd()
    with loaded(texts):
        path = sys.path[:]
        try:
            os.chdir(place / "grading")
            for name in SCRIPTS:
                printed = io.StringIO()
                with contextlib.redirect_stdout(printed), np.errstate(all="ignore"):
                    runpy.run_path(name)
                errors += [float(line.split()[-1]) for line in printed.getvalue().splitlines()]
        except Exception:
            return np.inf
        finally:
            os.chdir(here)
            sys.path[:] = path
    return np.inf if np.isnan(errors).any() else max(errors)


def write_place(place):
    """Fills a folder with `grading` and `data`, our first samples."""
    shutil.copytree(FIXTURES / "released", place / "grading")
    (place / "data").mkdir()
    shutil.copy(DATA / "cylinder.mesh", place / "data")
    for module in GRADERS:
        grader, data = first_data(module)
        stored = {key: data[key].copy() for key in grader.layout}
        if module == "integrationGrading":  # the released grader looks at one sample
            for key in (key for key in stored if key.startswith("result")):
                stored[key][1:] = 0.0
        (place / "data" / grader.fileName).write_bytes(pickle.dumps(stored))
    return place


NAMES = [*VARIANTS, *skeletonVariants.MISTAKES]
HEAD = """# The variants and their hints

Written by `python tests/graders/studentVariants.py`; each is one change of `student`, and
those after the skeleton one of a right solution on top of the skeleton. The last column is the
verdict of graders of the released shape on our data, up to errors of 1e-6.

| variant | fails | hints | released graders |
|---|--:|---|--:|
"""


def row(name, place=None):
    """A variant's cells in the table: name, number of failures, hints, verdict.

    place : of `write_place`, or None for no verdict
    """
    texts = texts_of(name)
    grades = grades_of(texts)
    cells = [name, str(sum(len(grade.failures) for grade in grades)), "<br>".join(hints_of(grades))]
    if place:
        error = released_error(texts, place)
        cells.append("stop" if np.isinf(error) else "fails" if error > 1e-6 else "passes")
    return cells


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        place = write_place(Path(folder))
        rows = [f"| {' | '.join(row(name, place))} |\n" for name in NAMES]
    (FIXTURES / "variants.md").write_text(HEAD + "".join(rows), encoding="utf-8")
