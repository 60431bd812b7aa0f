"""Grade the resolution of distance constraints against constraint-resolution.data.

    python graders/Constraints.py [--data DIR]
    python graders/Constraints.py --modules CODE   a student's RBSFunctions and Quaternion

As in the release, the upper and then the lower bound are resolved on the same arrays, and the
velocities with uncorrected positions.
"""

import reference

if __name__ == "__main__":
    reference.prepare()

import sys

import numpy as np
from classwork.graderProgram import run_grader
from reference import rigidModel as model
from reference.graderData import CONSTRAINT_LAYOUT
from verdict.parts import Grader, Part, few_samples, first_of

from rbs.program.submissions import POSITION, VELOCITY


def bounds(data):
    """The bounds, and tolerances that C is within, and beyond."""
    given = {"tolerance": model.POSITION_TOLERANCE}
    for bound, factor in model.BOUNDS.items():
        given[f"{bound.lower()}Value"] = factor * data["refValues"]
    return given | model.position_tolerances(data)


def rates(data):
    """The tolerance, those that |J v| is within, and beyond, and right tensors."""
    given = {"tolerance": model.VELOCITY_TOLERANCE, "tensors": np.stack(model.pair_of(data).T, 1)}
    return given | model.drawn_tolerances(model.distance_rates(data), data)


def moving_samples(data):
    moves = model.distance_rates(data) > model.VELOCITY_TOLERANCE
    return first_of(np.flatnonzero(moves), data)


def shapes(flags, pairs=()):
    return {key: "bool" for key in flags} | {f"{key}, mesh {k}": 3 for key in pairs for k in (1, 2)}


UPPER = shapes(["positionWasValidUpper"], ["correctedPositionsUpper"])
LOWER = shapes(["positionWasValidLower"], ["correctedPositionsLower"])
VELOCITIES = shapes(["velocityWasValid"], ["correctedLinVelocities", "correctedAngVelocities"])
PLACES = [f"C {place} the tolerance, {b}" for b in model.BOUNDS for place in model.TOLERANCES]
POSITION_FLAGS = shapes([*PLACES, "two fixed meshes"])
VELOCITY_FLAGS = shapes(f"|J v| {place} the tolerance" for place in model.TOLERANCES)
OF_POSITIONS = {"model": model.position_constraints, "inputs": bounds}
OF_VELOCITIES = {"model": model.velocity_constraints, "inputs": rates}
FEW_POSITIONS = OF_POSITIONS | {"samples": few_samples, "isExtra": True}
FEW_VELOCITIES = OF_VELOCITIES | {"samples": moving_samples, "isExtra": True}
TOLERANCE, CHECK = "and its tolerance", "check_velocity_tolerance"
PARTS = (
    Part(POSITION, UPPER | LOWER, "resolve_positions", **OF_POSITIONS),
    Part(f"{POSITION} {TOLERANCE}", POSITION_FLAGS, "check_tolerances", **FEW_POSITIONS),
    Part(VELOCITY, VELOCITIES, "resolve_velocities", **OF_VELOCITIES),
    Part(f"{VELOCITY} {TOLERANCE}", VELOCITY_FLAGS, CHECK, **FEW_VELOCITIES),
)
TITLE, DATA = "Resolution of distance constraints", "constraint-resolution.data"
GRADER = Grader("Constraints", TITLE, DATA, CONSTRAINT_LAYOUT, PARTS)

if __name__ == "__main__":
    sys.exit(run_grader(__doc__, GRADER))
