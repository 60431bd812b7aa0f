"""Grade the resolution of collisions against collision-resolution.data.

    python graders/ResolveCollisionsGrading.py [--data DIR]
    python graders/ResolveCollisionsGrading.py --modules CODE   a student's modules

`resolve_collision` is given the depth, normal and point in the data, so it does not depend on
detection, which the coursework supplies.
"""

import reference

if __name__ == "__main__":
    reference.prepare()

import sys

import numpy as np
from classwork.graderProgram import run_grader
from reference import rigidModel as model
from reference.graderData import COLLISION_LAYOUT, WIDTHS
from verdict.parts import Grader, Part, first_of

CONTACT = ("isCollision", "depth", "intNormal", "intPosition")
TENSOR = "rotated inverse inertia"  # in units of the mean one


def contacts(data):
    restitution = {"restitution": model.RESTITUTION, "groundRestitution": model.GROUND_RESTITUTION}
    return {key: data[key] for key in CONTACT} | restitution


def colliding_samples(data):
    return first_of(np.flatnonzero(data["isCollision"]), data)


UNIT = {"inputs": lambda data: {"unit": model.tensor_unit(data)}, "isExtra": True}
STATES = {f"result{name}, mesh {k}": width for name, width in WIDTHS.items() for k in (1, 2)}
FURTHER = "resolve_collision with fixed meshes and the ground"
UNSEEN = {"a fixed mesh's state": 13, "on the ground": 13, "currVertices": 1}
EXTRA = {"inputs": contacts, "samples": colliding_samples, "isExtra": True}
PARTS = (
    Part("get_rotated_inv_IT", {TENSOR: 9}, "rotate_tensor", model.rotated_tensors, **UNIT),
    Part("resolve_collision", STATES, "resolve", model.resolution, contacts),
    Part(FURTHER, UNSEEN, "resolve_further", model.further_resolution, **EXTRA),
)
TITLE, DATA = "Resolution of collisions", "collision-resolution.data"
GRADER = Grader("ResolveCollisionsGrading", TITLE, DATA, COLLISION_LAYOUT, PARTS)

if __name__ == "__main__":
    sys.exit(run_grader(__doc__, GRADER))
