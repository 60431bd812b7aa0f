"""Grade the resolution of distance constraints against constraint-resolution.data.

    python graders/Constraints.py [--data DIR]
    python graders/Constraints.py --modules DIR    a student's RBSFunctions and Quaternion

As in the release, the upper and then the lower bound are resolved on the same arrays, and the
velocities with uncorrected positions.
"""

import itertools
import sys

import numpy as np
from classwork.graderProgram import run_grader
from reference import rigidModel as model
from reference.graderData import CONSTRAINT_LAYOUT
from verdict.parts import FEW, Grader, Part, WrongResult, by_mesh, few_samples, returned

POSITION, VELOCITY = "resolve_position_constraint", "resolve_velocity_constraint"
RETURNED = {
    POSITION: {"positionWasValid": 1, "correctedPositions": 6},
    VELOCITY: {"velocityWasValid": 1, "correctedLinVelocities": 6, "correctedAngVelocities": 6},
}
IN_PLACE = (
    f"{POSITION} changes its arguments in place: the released grader calls it for the upper and "
    "then for the lower bound, with the same arrays"
)


def constrained(bodies, sample):
    """Returns the two meshes, [their positions, the world positions of the linked points].

    As in the released grader, both points are rest vertex 0 of mesh 1, carried along by either.
    """
    meshes = bodies.resting(), bodies.moving(sample)
    rotate = bodies.function("QRotate", "Quaternion")
    restPoint = np.array(meshes[0].origVertices[:1])
    turned = [rotate(mesh.orientation, restPoint.copy()) for mesh in meshes]
    pairs = zip(turned, meshes, strict=True)
    points = tuple(np.reshape(point, (1, 3)) + mesh.position for point, mesh in pairs)
    return meshes, [tuple(mesh.position for mesh in meshes), points]


def resolved(bodies, arrays, refValue, invMasses, bound, tolerance):
    """The values that `resolve_position_constraint` returns."""
    others = refValue, invMasses, bound == "Upper", tolerance
    return returned(bodies.function(POSITION)(*arrays, *others), POSITION, RETURNED[POSITION])


def resolve_positions(bodies, data, sample):
    meshes, arrays = constrained(bodies, sample)
    before = [array.copy() for pair in arrays for array in pair]
    invMasses = tuple(mesh.invMass for mesh in meshes)
    for bound, factor in model.BOUNDS.items():
        others = factor * data["refValues"][sample], invMasses, bound, model.POSITION_TOLERANCE
        wasValid, corrected = resolved(bodies, arrays, *others)
        yield f"positionWasValid{bound}", wasValid
        if not all(map(np.array_equal, before, itertools.chain(*arrays))):
            corrected = [WrongResult(IN_PLACE)] * 2
        yield from by_mesh(f"correctedPositions{bound}", corrected)


def check_tolerances(bodies, data, sample):
    def is_valid(bound, tolerance, invMasses=None):
        """The flag for new meshes, with a tolerance relative to C."""
        meshes, arrays = constrained(bodies, sample)
        refValue = model.BOUNDS[bound] * data["refValues"][sample]
        C = float(np.linalg.norm(arrays[1][0] - arrays[1][1]) - refValue[0])
        invMasses = invMasses or tuple(mesh.invMass for mesh in meshes)
        return resolved(bodies, arrays, refValue, invMasses, bound, tolerance * abs(C))[0]

    for bound in model.BOUNDS:
        for place, tolerance in model.TOLERANCES.items():
            yield f"C {place} the tolerance, {bound}", is_valid(bound, tolerance)
    yield "two fixed meshes", is_valid("Upper", model.TOLERANCES["within"], (0.0, 0.0))


def resolved_velocities(bodies, sample, tolerance):
    meshes, arrays = constrained(bodies, sample)
    for name in ("linVelocity", "angVelocity", "invMass"):
        arrays.append(tuple(getattr(mesh, name) for mesh in meshes))
    arrays.append(tuple(mesh.get_rotated_inv_IT() for mesh in meshes))
    return returned(bodies.function(VELOCITY)(*arrays, tolerance), VELOCITY, RETURNED[VELOCITY])


def resolve_velocities(bodies, data, sample):
    values = resolved_velocities(bodies, sample, model.VELOCITY_TOLERANCE)
    wasValid, linear, angular = zip(RETURNED[VELOCITY], values, strict=True)
    yield wasValid
    yield from by_mesh(*linear)
    yield from by_mesh(*angular)


def check_velocity_tolerance(bodies, data, sample):
    for place, factor in model.TOLERANCES.items():
        tolerance = factor * model.distance_rates(data)[sample]
        yield f"|J v| {place} the tolerance", resolved_velocities(bodies, sample, tolerance)[0]


def moving_samples(data):
    return np.flatnonzero(model.distance_rates(data) > model.VELOCITY_TOLERANCE)[:FEW]


def shapes(flags, pairs=()):
    return {key: bool for key in flags} | {f"{key}, mesh {k}": 3 for key in pairs for k in (1, 2)}


UPPER = shapes(["positionWasValidUpper"], ["correctedPositionsUpper"])
LOWER = shapes(["positionWasValidLower"], ["correctedPositionsLower"])
VELOCITIES = shapes(["velocityWasValid"], list(RETURNED[VELOCITY])[1:])
PLACES = [f"C {place} the tolerance, {b}" for b in model.BOUNDS for place in model.TOLERANCES]
POSITION_FLAGS = shapes([*PLACES, "two fixed meshes"])
VELOCITY_FLAGS = shapes(f"|J v| {place} the tolerance" for place in model.TOLERANCES)
OF_POSITIONS = {"model": model.position_constraints}
OF_VELOCITIES = {"model": model.velocity_constraints}
FEW_POSITIONS = OF_POSITIONS | {"samples": few_samples, "isExtra": True}
FEW_VELOCITIES = OF_VELOCITIES | {"samples": moving_samples, "isExtra": True}
TOLERANCE = "and its tolerance"
GRADER = Grader(
    "Constraints",
    "Resolution of distance constraints",
    "constraint-resolution.data",
    CONSTRAINT_LAYOUT,
    (
        Part(POSITION, UPPER | LOWER, resolve_positions, **OF_POSITIONS),
        Part(f"{POSITION} {TOLERANCE}", POSITION_FLAGS, check_tolerances, **FEW_POSITIONS),
        Part(VELOCITY, VELOCITIES, resolve_velocities, **OF_VELOCITIES),
        Part(f"{VELOCITY} {TOLERANCE}", VELOCITY_FLAGS, check_velocity_tolerance, **FEW_VELOCITIES),
    ),
)

if __name__ == "__main__":
    sys.exit(run_grader(__doc__, GRADER))
