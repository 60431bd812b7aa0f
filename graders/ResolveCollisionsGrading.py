"""Grade collision detection and resolution against collision-resolution.data.

    python graders/ResolveCollisionsGrading.py [--data DIR] [--convention exact|released-2024]
    python graders/ResolveCollisionsGrading.py --modules DIR    a student's modules

Detection, `Mesh.detect_collision`, is graded in the exact convention only: the released one is
approximate (quirk 7 of the contract). Resolution, `resolve_collision`, is graded on the depth,
normal and point that the data give, and so apart from detection.
"""

import sys

import numpy as np
from conventions import RESULT_ATTRIBUTES
from graderProgram import run_grader
from gradingTools import COLLISION_LAYOUT, EXACT
from hints import (
    DETECTION_MISTAKES,
    FIXED_RESOLUTION_MISTAKES,
    RESOLUTION_MISTAKES,
    TENSOR_MISTAKES,
)
from rigidModel import (
    RESTITUTION,
    detection,
    fixed_resolution,
    resolution,
    rotated_tensors,
    tensor_unit,
)
from trials import Grader, Part, attribute, by_mesh, flag, numbers, returned

CONTACT_SHAPES = {"depth": (), "intNormal": (3,), "intPosition": (3,)}
RESULT_WIDTHS = {key: 4 if key == "resultOrientations" else 3 for key in RESULT_ATTRIBUTES}
RESULT_SHAPES = {
    f"{key}, mesh {k}": (width,) for key, width in RESULT_WIDTHS.items() for k in (1, 2)
}
FIXED = "a fixed mesh's state"
TENSOR = "rotated inverse inertia"  # in units of the mean one


def detect(bodies, data, samples, results):
    for sample in samples:
        with results.attempt(sample, "isCollision", *CONTACT_SHAPES):
            mesh1, mesh2 = bodies.resting(), bodies.moving(sample)
            isCollision, *contact = returned(
                mesh1.detect_collision(mesh2), 4, "Mesh.detect_collision"
            )
            isCollision = flag(isCollision, "isCollision")
            results.values["isCollision"][sample] = isCollision
            for (key, shape), value in zip(CONTACT_SHAPES.items(), contact, strict=True):
                if isCollision:
                    with results.attempt(sample, key):
                        value = numbers(value, 3 if shape else 1, f"Mesh.detect_collision's {key}")
                        results.values[key][sample] = value.reshape(shape)


def rotate_tensor(bodies, data, samples, results):
    unit = tensor_unit(data)
    for sample in samples:
        with results.attempt(sample, TENSOR):
            tensor = bodies.moving(sample).get_rotated_inv_IT()
            results.values[TENSOR][sample] = numbers(tensor, 9, TENSOR) / unit


def resolve(bodies, data, samples, results):
    """Samples that do not collide stay as they are."""
    for sample in samples:
        with results.attempt(sample, *RESULT_SHAPES):
            meshes = bodies.resting(), bodies.moving(sample)
            if data["isCollision"][sample]:
                bodies.function("resolve_collision")(*meshes, *contact_of(data, sample))
            for key, name in RESULT_ATTRIBUTES.items():
                for k, mesh in enumerate(meshes, start=1):
                    row = f"{key}, mesh {k}"
                    with results.attempt(sample, row):
                        value = attribute(mesh, name, RESULT_WIDTHS[key])
                        results.values[row][sample] = value


def contact_of(data, sample):
    """What follows the two meshes in a call of resolve_collision; copies of the data."""
    contact = [data[key][sample].copy() for key in CONTACT_SHAPES]
    return *contact, RESTITUTION


def colliding_samples(data):
    return np.flatnonzero(data["isCollision"])


def resolve_fixed(bodies, data, samples, results):
    for sample in samples:
        with results.attempt(sample, FIXED):
            meshes = bodies.resting(isFixed=True), bodies.moving(sample)
            bodies.function("resolve_collision")(*meshes, *contact_of(data, sample))
            state = [
                attribute(meshes[0], name, RESULT_WIDTHS[key])
                for key, name in RESULT_ATTRIBUTES.items()
            ]
            results.values[FIXED][sample] = np.concatenate(state)


def expected_contacts(data):
    return {key: data[key] for key in ("isCollision", *CONTACT_SHAPES)}


def expected_results(data):
    return by_mesh({key: np.array(data[key]) for key in RESULT_ATTRIBUTES})


def expected_tensors(*arguments):
    return {TENSOR: rotated_tensors(*arguments)}


def fixed_state(*arguments):
    return {FIXED: fixed_resolution(*arguments)}


def remarks(data):
    hits = f"{data['isCollision'].sum()} of {len(data['isCollision'])} poses collide"
    if data["convention"] == EXACT:
        return [hits]
    return [hits, "detection is not graded: the released one is approximate"]


GRADER = Grader(
    "ResolveCollisionsGrading",
    "Collision detection and resolution",
    "collision-resolution.data",
    COLLISION_LAYOUT,
    (
        Part(
            "detect_collision", {"isCollision": ()} | CONTACT_SHAPES, detect, expected_contacts,
            detection, DETECTION_MISTAKES, conditional=tuple(CONTACT_SHAPES), conventions=(EXACT,),
        ),
        Part(
            "get_rotated_inv_IT", {TENSOR: (9,)}, rotate_tensor, expected_tensors,
            expected_tensors, TENSOR_MISTAKES, isExtra=True,
        ),
        Part(
            "resolve_collision", RESULT_SHAPES, resolve, expected_results,
            lambda *arguments: by_mesh(resolution(*arguments)), RESOLUTION_MISTAKES,
        ),
        Part(
            "resolve_collision with a fixed mesh", {FIXED: (13,)}, resolve_fixed,
            fixed_state, fixed_state, FIXED_RESOLUTION_MISTAKES, colliding_samples, isExtra=True,
        ),
    ),
    remarks,
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(run_grader(__doc__, GRADER))
