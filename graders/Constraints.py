"""Grade the resolution of distance constraints against constraint-resolution.data.

    python graders/Constraints.py [--data DIR] [--convention exact|released-2024]
    python graders/Constraints.py --modules DIR    a student's RBSFunctions and Quaternion

The upper and the lower bound are resolved on the same state, and the velocities with the positions
uncorrected.
"""

import sys

import numpy as np
from graderProgram import run_grader
from gradingTools import CONSTRAINT_LAYOUT
from hints import POSITION_CONSTRAINT_MISTAKES, VELOCITY_CONSTRAINT_MISTAKES
from rigidModel import (
    LOWER_FACTOR,
    POSITION_TOLERANCE,
    UPPER_FACTOR,
    VELOCITY_TOLERANCE,
    position_constraints,
    velocity_constraints,
)
from trials import Grader, Part, by_mesh, flag, numbers, returned

BOUNDS = (("Upper", UPPER_FACTOR), ("Lower", LOWER_FACTOR))
VELOCITY_KEYS = ("correctedLinVelocities", "correctedAngVelocities")
POSITION_SHAPES = {
    quantity: shape
    for bound, _factor in BOUNDS
    for quantity, shape in (
        (f"positionWasValid{bound}", ()),
        (f"correctedPositions{bound}, mesh 1", (3,)),
        (f"correctedPositions{bound}, mesh 2", (3,)),
    )
}
VELOCITY_SHAPES = {"velocityWasValid": ()} | {
    f"{key}, mesh {k}": (3,) for key in VELOCITY_KEYS for k in (1, 2)
}


def constrained_points(bodies, mesh1, mesh2):
    """World positions, a pair of (1, 3), of the two points that the constraint joins.

    As in the released grader, both are rest vertex 0 of mesh 1, carried along by either mesh.
    """
    rotate = bodies.function("QRotate", "Quaternion")
    restPoint = np.array(mesh1.origVertices[:1])
    return tuple(
        np.reshape(rotate(mesh.orientation, restPoint), (1, 3)) + mesh.position
        for mesh in (mesh1, mesh2)
    )


def resolve_positions(bodies, data, samples, results):
    for sample in samples:
        with results.attempt(sample, *POSITION_SHAPES):
            for bound, factor in BOUNDS:
                keys = [key for key in POSITION_SHAPES if bound in key]
                with results.attempt(sample, *keys):
                    # Meshes of their own for each bound, should the function change its arguments.
                    meshes = bodies.resting(), bodies.moving(sample)
                    wasValid, corrected = returned(
                        bodies.function("resolve_position_constraint")(
                            tuple(mesh.position for mesh in meshes),
                            constrained_points(bodies, *meshes),
                            factor * data["refValues"][sample],
                            tuple(mesh.invMass for mesh in meshes),
                            bound == "Upper",
                            POSITION_TOLERANCE,
                        ),
                        2,
                        "resolve_position_constraint",
                    )
                    store_flag(results, keys[0], sample, wasValid)
                    store_pair(results, f"correctedPositions{bound}", sample, corrected)


def resolve_velocities(bodies, data, samples, results):
    for sample in samples:
        with results.attempt(sample, *VELOCITY_SHAPES):
            meshes = bodies.resting(), bodies.moving(sample)
            wasValid, *corrected = returned(
                bodies.function("resolve_velocity_constraint")(
                    tuple(mesh.position for mesh in meshes),
                    constrained_points(bodies, *meshes),
                    tuple(mesh.linVelocity for mesh in meshes),
                    tuple(mesh.angVelocity for mesh in meshes),
                    tuple(mesh.invMass for mesh in meshes),
                    tuple(mesh.get_rotated_inv_IT() for mesh in meshes),
                    VELOCITY_TOLERANCE,
                ),
                3,
                "resolve_velocity_constraint",
            )
            store_flag(results, "velocityWasValid", sample, wasValid)
            for key, pair in zip(VELOCITY_KEYS, corrected, strict=True):
                store_pair(results, key, sample, pair)


def store_flag(results, key, sample, wasValid):
    with results.attempt(sample, key):
        results.values[key][sample] = flag(wasValid, key)


def store_pair(results, key, sample, pair):
    rows = [f"{key}, mesh {k}" for k in (1, 2)]
    with results.attempt(sample, *rows):
        for row, value in zip(rows, returned(pair, 2, key), strict=True):
            with results.attempt(sample, row):
                results.values[row][sample] = numbers(value, 3, row)


def expected_in(shapes):
    """A function that takes the expected values of these quantities out of the data."""
    keys = {quantity.split(",")[0] for quantity in shapes}
    return lambda data: by_mesh({key: np.array(data[key]) for key in keys})


def remarks(data):
    keys = ("positionWasValidUpper", "positionWasValidLower", "velocityWasValid")
    return [f"{key}: True in {data[key].sum()} of {len(data[key])} samples" for key in keys]


GRADER = Grader(
    "Constraints",
    "Resolution of distance constraints",
    "constraint-resolution.data",
    CONSTRAINT_LAYOUT,
    (
        Part(
            "resolve_position_constraint", POSITION_SHAPES, resolve_positions,
            expected_in(POSITION_SHAPES), lambda *arguments: by_mesh(
                position_constraints(*arguments)
            ),
            POSITION_CONSTRAINT_MISTAKES,
        ),
        Part(
            "resolve_velocity_constraint", VELOCITY_SHAPES, resolve_velocities,
            expected_in(VELOCITY_SHAPES), lambda *arguments: by_mesh(
                velocity_constraints(*arguments)
            ),
            VELOCITY_CONSTRAINT_MISTAKES,
        ),
    ),
    remarks,
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(run_grader(__doc__, GRADER))
