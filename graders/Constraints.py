"""Grade the resolution of distance constraints against constraint-resolution.data.

    python graders/Constraints.py [--data DIR] [--convention exact|released-2024]
    python graders/Constraints.py --modules DIR    a student's RBSFunctions and Quaternion

As in the release, the upper and then the lower bound are resolved on the same arrays, and the
velocities with the positions uncorrected.
"""

import sys

import numpy as np
from graderProgram import run_grader
from gradingTools import CONSTRAINT_LAYOUT
from rigidModel import (
    BOUNDS,
    POSITION_TOLERANCE,
    TOLERANCES,
    VELOCITY_TOLERANCE,
    distance_rates,
    position_constraints,
    position_tolerances,
    velocity_constraints,
    velocity_tolerances,
)
from trials import FEW, Grader, Part, WrongResult, by_mesh, few_samples, returned

POSITION = {"positionWasValid": 1, "correctedPositions": 6}
VELOCITY = {"velocityWasValid": 1, "correctedLinVelocities": 6, "correctedAngVelocities": 6}


def constrained(bodies, sample):
    """(pair of meshes, their positions, the world positions of the points that are joined).

    As in the released grader, both points are rest vertex 0 of mesh 1, carried along by either.
    """
    meshes = bodies.resting(), bodies.moving(sample)
    rotate = bodies.function("QRotate", "Quaternion")
    restPoint = np.array(meshes[0].origVertices[:1])
    points = tuple(
        np.reshape(rotate(mesh.orientation, restPoint.copy()), (1, 3)) + mesh.position
        for mesh in meshes
    )
    return meshes, tuple(mesh.position for mesh in meshes), points


def resolve_positions(bodies, data, sample):
    name = "resolve_position_constraint"
    meshes, *arrays = constrained(bodies, sample)
    before = [array.copy() for pair in arrays for array in pair]
    invMasses = tuple(mesh.invMass for mesh in meshes)
    for bound, factor in BOUNDS.items():
        values = bodies.function(name)(
            *arrays, factor * data["refValues"][sample], invMasses, bound == "Upper",
            POSITION_TOLERANCE,
        )  # fmt: skip
        wasValid, corrected = returned(values, name, POSITION)
        yield f"positionWasValid{bound}", wasValid
        if not all(map(np.array_equal, before, [array for pair in arrays for array in pair])):
            corrected = [WrongResult(
                f"{name} changes its arguments in place: the released grader calls it with the "
                "same arrays for the upper and then for the lower bound"
            )] * 2  # fmt: skip
        yield from by_mesh(f"correctedPositions{bound}", corrected)


def resolve_within_tolerances(bodies, data, sample):
    name = "resolve_position_constraint"
    meshes, positions, points = constrained(bodies, sample)
    length = np.linalg.norm(points[0] - points[1])

    def is_valid(bound, tolerance, invMasses):
        arrays = [tuple(array.copy() for array in pair) for pair in (positions, points)]
        bound, isUpper = BOUNDS[bound] * data["refValues"][sample], bound == "Upper"
        values = bodies.function(name)(*arrays, bound, invMasses, isUpper, tolerance)
        return returned(values, name, POSITION)[0]

    for bound, factor in BOUNDS.items():
        C = abs(length - float(factor * data["refValues"][sample, 0]))
        for place, tolerance in TOLERANCES.items():
            invMasses = tuple(mesh.invMass for mesh in meshes)
            quantity = f"{bound.lower()} bound, C {place} the tolerance"
            yield quantity, is_valid(bound, tolerance * C, invMasses)
    yield "two fixed meshes", is_valid("Upper", 2.0 * C + length, (0.0, 0.0))


def resolve_velocities(bodies, data, sample):
    wasValid, *corrected = resolved_velocities(bodies, sample, VELOCITY_TOLERANCE)
    yield "velocityWasValid", wasValid
    for key, pair in zip(list(VELOCITY)[1:], corrected, strict=True):
        yield from by_mesh(key, pair)


def resolved_velocities(bodies, sample, tolerance):
    name = "resolve_velocity_constraint"
    meshes, *arrays = constrained(bodies, sample)
    values = bodies.function(name)(
        *arrays,
        *(tuple(getattr(m, key) for m in meshes) for key in ("linVelocity", "angVelocity", "invMass")),
        tuple(mesh.get_rotated_inv_IT() for mesh in meshes),
        tolerance,
    )  # fmt: skip
    return returned(values, name, VELOCITY)


def stop_within_tolerances(bodies, data, sample):
    rate = distance_rates(data)[sample]
    for place, factor in TOLERANCES.items():
        yield f"|J v| {place} the tolerance", resolved_velocities(bodies, sample, factor * rate)[0]


def moving_samples(data):
    return np.flatnonzero(distance_rates(data) > VELOCITY_TOLERANCE)[:FEW]


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
            "resolve_position_constraint",
            {
                quantity: shape
                for bound in BOUNDS
                for quantity, shape in (
                    (f"positionWasValid{bound}", bool),
                    (f"correctedPositions{bound}, mesh 1", 3),
                    (f"correctedPositions{bound}, mesh 2", 3),
                )
            },
            resolve_positions, position_constraints,
        ),
        Part(
            "resolve_position_constraint and its tolerance",
            {
                f"{bound.lower()} bound, C {place} the tolerance": bool
                for bound in BOUNDS for place in TOLERANCES
            } | {"two fixed meshes": bool},
            resolve_within_tolerances, position_tolerances, few_samples, isExtra=True,
        ),
        Part(
            "resolve_velocity_constraint",
            {"velocityWasValid": bool}
            | {f"{key}, mesh {k}": 3 for key in list(VELOCITY)[1:] for k in (1, 2)},
            resolve_velocities, velocity_constraints,
        ),
        Part(
            "resolve_velocity_constraint and its tolerance",
            {f"|J v| {place} the tolerance": bool for place in TOLERANCES},
            stop_within_tolerances, velocity_tolerances, moving_samples, isExtra=True,
        ),
    ),
    remarks,
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(run_grader(__doc__, GRADER))
