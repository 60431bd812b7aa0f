"""Grade collision detection and resolution against collision-resolution.data.

    python graders/ResolveCollisionsGrading.py [--data DIR] [--convention exact|released-2024]

Detection, `Mesh.detect_collision`, is graded in the exact convention only: the released one is
approximate (quirk 7 of the contract). Resolution, `resolve_collision`, is graded on the depth,
normal and point that the data give, and so apart from detection.
"""

import sys

import numpy as np
from conventions import RESULT_ATTRIBUTES, moving_mesh, resting_mesh
from gradingTools import COLLISION_LAYOUT, EXACT, Grade, run_grader

from RBSFunctions import resolve_collision

RESTITUTION = 0.5


def grade_detection(grade, data, convention):
    """Compare detect_collision with the data on every pose, and its contact where both have one."""
    sampleCount = len(data["isCollision"])
    isCollision = np.zeros(sampleCount, dtype=bool)
    contacts = {
        "depth": np.zeros(sampleCount),
        "intNormal": np.zeros((sampleCount, 3)),
        "intPosition": np.zeros((sampleCount, 3)),
    }
    mesh1 = resting_mesh(data, convention)
    for sample in range(sampleCount):
        isCollision[sample], *contact = mesh1.detect_collision(
            moving_mesh(data, sample, convention)
        )
        if isCollision[sample]:
            for values, value in zip(contacts.values(), contact, strict=True):
                values[sample] = np.reshape(value, values[sample].shape)

    grade.compare("isCollision", isCollision, data["isCollision"])
    samples = np.flatnonzero(isCollision & data["isCollision"])
    for key, values in contacts.items():
        grade.compare(key, values[samples], data[key][samples], samples)


def grade_resolution(grade, data, convention):
    """Compare both bodies after resolve_collision; samples that do not collide stay as they are."""
    computed = {key: np.zeros_like(data[key]) for key in RESULT_ATTRIBUTES}
    for sample, isCollision in enumerate(data["isCollision"]):
        meshes = resting_mesh(data, convention), moving_mesh(data, sample, convention)
        if isCollision:
            contact = (data[key][sample].copy() for key in ("depth", "intNormal", "intPosition"))
            resolve_collision(*meshes, *contact, RESTITUTION)
        for key, attribute in RESULT_ATTRIBUTES.items():
            for k, mesh in enumerate(meshes):
                computed[key][k, sample] = np.reshape(getattr(mesh, attribute), -1)
    for key, values in computed.items():
        grade.compare_pairs(key, values, data[key])


def grade_collisions(data, convention):
    grade = Grade("Collision detection and resolution")
    grade.remarks.append(f"{data['isCollision'].sum()} of {len(data['isCollision'])} poses collide")
    if convention == EXACT:
        grade_detection(grade, data, convention)
    else:
        grade.remarks.append("detection is not graded: the released one is approximate")
    grade_resolution(grade, data, convention)
    return grade


if __name__ == "__main__":
    sys.exit(run_grader(__doc__, "collision-resolution.data", COLLISION_LAYOUT, grade_collisions))
