"""Grade the resolution of distance constraints against constraint-resolution.data.

    python graders/Constraints.py [--data DIR] [--convention exact|released-2024]

The upper and the lower bound are resolved on the same state, and the velocities with the positions
uncorrected.
"""

import sys

import numpy as np
from conventions import moving_mesh, resting_mesh
from gradingTools import CONSTRAINT_LAYOUT, Grade, run_grader

from Quaternion import QRotate
from RBSFunctions import resolve_position_constraint, resolve_velocity_constraint

# The bounds, in units of the sample's reference value.
UPPER_FACTOR = 1.2
LOWER_FACTOR = 0.8

POSITION_TOLERANCE = 1e-6  # m
VELOCITY_TOLERANCE = 1e-5  # m/s

FLAG_KEYS = ("positionWasValidUpper", "positionWasValidLower", "velocityWasValid")
PAIR_KEYS = (
    "correctedPositionsUpper",
    "correctedPositionsLower",
    "correctedLinVelocities",
    "correctedAngVelocities",
)


def constrained_points(mesh1, mesh2):
    """World positions, a pair of (1, 3), of the two points that the constraint joins.

    As in the released grader, both are rest vertex 0 of mesh 1, carried along by either mesh.
    """
    restPoint = mesh1.origVertices[:1]
    return tuple(QRotate(mesh.orientation, restPoint) + mesh.position for mesh in (mesh1, mesh2))


def resolve_sample(data, sample, convention):
    """A dict from key to what the functions return for the sample: a bool, or a pair of rows."""
    meshes = resting_mesh(data, convention), moving_mesh(data, sample, convention)
    points = constrained_points(*meshes)
    positions = tuple(mesh.position for mesh in meshes)
    inverseMasses = tuple(mesh.invMass for mesh in meshes)
    refValue = data["refValues"][sample]

    results = {}
    for bound, factor in (("Upper", UPPER_FACTOR), ("Lower", LOWER_FACTOR)):
        wasValid, corrected = resolve_position_constraint(
            positions,
            points,
            factor * refValue,
            inverseMasses,
            bound == "Upper",
            POSITION_TOLERANCE,
        )
        results[f"positionWasValid{bound}"] = wasValid
        results[f"correctedPositions{bound}"] = corrected
    wasValid, linVelocities, angVelocities = resolve_velocity_constraint(
        positions,
        points,
        tuple(mesh.linVelocity for mesh in meshes),
        tuple(mesh.angVelocity for mesh in meshes),
        inverseMasses,
        tuple(mesh.get_rotated_inv_IT() for mesh in meshes),
        VELOCITY_TOLERANCE,
    )
    return results | {
        "velocityWasValid": wasValid,
        "correctedLinVelocities": linVelocities,
        "correctedAngVelocities": angVelocities,
    }


def grade_constraints(data, convention):
    computed = {key: np.zeros_like(data[key]) for key in FLAG_KEYS + PAIR_KEYS}
    for sample in range(len(data["refValues"])):
        results = resolve_sample(data, sample, convention)
        for key in FLAG_KEYS:
            computed[key][sample] = np.all(results[key])
        for key in PAIR_KEYS:
            for k in (0, 1):
                computed[key][k, sample] = np.reshape(results[key][k], -1)

    grade = Grade("Resolution of distance constraints")
    for key in FLAG_KEYS:
        grade.remarks.append(f"{key}: True in {data[key].sum()} of {len(data[key])} samples")
        grade.compare(key, computed[key], data[key])
    for key in PAIR_KEYS:
        grade.compare_pairs(key, computed[key], data[key])
    return grade


if __name__ == "__main__":
    sys.exit(
        run_grader(__doc__, "constraint-resolution.data", CONSTRAINT_LAYOUT, grade_constraints)
    )
