"""Submissions for the graders: one student's solution, and what others would have handed in.

`submissions/student` holds the solution, with the right physics. The others are made of it by small
edits that have names; an edit that does not fit the solution any more raises.
"""

import zipfile
from pathlib import Path

STUDENT = Path(__file__).resolve().parent / "submissions" / "student"
FUNCTIONS, QUATERNION = "RBSFunctions.py", "Quaternion.py"

# An edit of RBSFunctions.py: (old text, which occurs in it once; new text).
SMALL_TENSOR = ("np.sum(6.0 * volumes[:, None, None]", "np.sum(volumes[:, None, None]")
TURNED_BACK = ("return R @ self.invIT @ R.T", "return R.T @ self.invIT @ R")
RELEASED = (SMALL_TENSOR, TURNED_BACK)

# The ten classic mistakes.
MISTAKES = {
    "explicit-euler": [
        (
            "self.position = self.position + timeStep * self.linVelocity",
            "self.position = self.position + timeStep * (self.linVelocity - timeStep * gravity)",
        ),
    ],
    "quaternion-order": [
        ("QMult(QExp(half), self.orientation)", "QMult(self.orientation, QExp(half))"),
    ],
    "normal-sign": [
        ("n = np.reshape(contactNormal, (1, 3))", "n = -np.reshape(contactNormal, (1, 3))"),
    ],
    "no-rotational-term": [
        (" + np.sum(c1 * (c1 @ invI1.T)) + np.sum(c2 * (c2 @ invI2.T))", ""),
    ],
    "velocity-lost": [
        ("m2.linVelocity = m2.linVelocity +", "m2.comVelocity = m2.linVelocity +"),
    ],
    "tensor-not-rotated": [("return R @ self.invIT @ R.T", "return self.invIT")],
    "restitution-twice": [("j = (1.0 + CRCoeff) *", "j = (1.0 + CRCoeff + CRCoeff) *")],
    "fixed-moved": [
        ("if not self.isFixed:\n            gravity", "if True:\n            gravity"),
        ("if self.isFixed:\n            self.invMass", "if False:\n            self.invMass"),
    ],
    "com-not-subtracted": [
        ("self.origVertices -= COM\n        corners = corners - COM\n", "pass\n"),
    ],
    "bounds-swapped": [
        (
            "bool(C <= tolerance) if upper else bool(C >= -tolerance)",
            "bool(C >= -tolerance) if upper else bool(C <= tolerance)",
        ),
    ],
}  # fmt: skip

# Half done: collisions move the meshes apart but give no impulse, tensor and position constraint
# are the skeleton's stubs, and the velocity constraint is not there at all.
HALF_DONE = [
    ("    # velocities\n", "    return\n"),
    ("return R @ self.invIT @ R.T", "return np.identity(3)"),
    ("    C = length - refValue\n", "    return True, currPositions\n    C = length - refValue\n"),
    ("def resolve_velocity_constraint(", "def resolve_velocities_some_day("),
]

# The skeleton as it is handed out: stubs for all that is to be written.
SKELETON = [
    ("if not self.isFixed:\n            gravity", "if False:\n            gravity"),
    ("    n = np.reshape(contactNormal, (1, 3))\n", "    return\n"),
    HALF_DONE[1],
    HALF_DONE[2],
    (
        "    n = (currConstPoints[0] - currConstPoints[1]).reshape(3)\n",
        "    return True, currLinVelocities, currAngVelocities\n",
    ),
]
# A solution that changes what it is handed, as the skeleton's Mesh does.
IN_PLACE = [
    ("np.array(origVertices, dtype=float)", "origVertices"),
    ("np.array(position, dtype=float).reshape(1, 3)", "position"),
    ("np.array(orientation, dtype=float).reshape(1, 4)", "orientation.reshape(1, 4)"),
    ("m1.linVelocity = m1.linVelocity - m1", "m1.linVelocity -= m1"),
    ("m1.position = m1.position - m1", "m1.position -= m1"),
    ("self.position = self.position + timeStep *", "self.position += timeStep *"),
    ("    push = C * difference / length\n", "    push = C * difference / length\n"
     "    difference *= 0.0\n    currConstPoints[0][:] = 0.0\n"),
]  # fmt: skip

HOSTILE = {
    "endless-loop": [("    # interpenetration\n", "    while True:\n        pass\n")],
    "os-exit": [("    # interpenetration\n", "    os._exit(7)\n")],
}


def released(edits):
    """The same edits on a solution with the physics of the 2024 release."""
    touched = {old for old, _new in edits}
    return [edit for edit in RELEASED if edit[0] not in touched] + list(edits)


def write_submission(folder, edits=()):
    """Writes the student's files, edited, into a new folder; returns its path."""
    folder = Path(folder)
    folder.mkdir(parents=True)
    text = (STUDENT / FUNCTIONS).read_text(encoding="utf-8")
    for old, new in edits:
        assert text.count(old) == 1, f"{text.count(old)} times: {old}"
        text = text.replace(old, new)
    (folder / FUNCTIONS).write_text(text, encoding="utf-8")
    (folder / QUATERNION).write_bytes((STUDENT / QUATERNION).read_bytes())
    return folder


def write_zip(path, files):
    """Writes a ZIP; files : dict from the name in the archive to its text or bytes."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def files_of(folder, top=""):
    """For `write_zip`: a submission's files, in a folder of the archive."""
    return {f"{top}{path.name}": path.read_bytes() for path in sorted(Path(folder).glob("*.py"))}
