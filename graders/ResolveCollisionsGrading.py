"""Grade collision detection and resolution against collision-resolution.data.

    python graders/ResolveCollisionsGrading.py [--data DIR]
    python graders/ResolveCollisionsGrading.py --modules DIR    a student's modules

Detection, `Mesh.detect_collision`, is not graded on the released data, because the release's is
approximate (quirk 6 in graders/README.md). Resolution, `resolve_collision`, is graded on the depth,
normal and point in the data, so it does not depend on detection.
"""

import sys

import numpy as np
from classwork.graderProgram import run_grader
from reference import rigidModel as model
from reference.graderData import COLLISION_LAYOUT, EXACT, WIDTHS
from verdict.parts import Grader, Part, first_of, in_file

CONTACT = ("isCollision", "depth", "intNormal", "intPosition")
TENSOR = "rotated inverse inertia"  # in units of the mean one


def contacts(data):
    restitution = {"restitution": model.RESTITUTION, "groundRestitution": model.GROUND_RESTITUTION}
    return {key: data[key] for key in CONTACT} | restitution


def colliding_samples(data):
    return first_of(np.flatnonzero(data["isCollision"]), data)


FOUND = {"isCollision": "bool", "depth": 1, "intNormal": 3, "intPosition": 3}
EXACT_ONLY = {"samples": in_file, "conditional": CONTACT[1:], "conventions": (EXACT,)}
UNIT = {"inputs": lambda data: {"unit": model.tensor_unit(data)}, "isExtra": True}
STATES = {f"result{name}, mesh {k}": width for name, width in WIDTHS.items() for k in (1, 2)}
FURTHER = "resolve_collision with fixed meshes and the ground"
UNSEEN = {"a fixed mesh's state": 13, "on the ground": 13}
EXTRA = {"inputs": contacts, "samples": colliding_samples, "isExtra": True}
MORE = model.further_resolution
GRADER = Grader(
    "ResolveCollisionsGrading",
    "Collision detection and resolution",
    "collision-resolution.data",
    COLLISION_LAYOUT,
    (
        Part("detect_collision", FOUND, "detect", model.detection, **EXACT_ONLY),
        Part("get_rotated_inv_IT", {TENSOR: 9}, "rotate_tensor", model.rotated_tensors, **UNIT),
        Part("resolve_collision", STATES, "resolve", model.resolution, contacts),
        Part(FURTHER, UNSEEN, "resolve_further", MORE, **EXTRA),
    ),
)

if __name__ == "__main__":
    sys.exit(run_grader(__doc__, GRADER))
