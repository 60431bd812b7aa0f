"""Grade `Mesh.integrate_timestep` against integration.data: one step of 0.1 s per sample.

    python graders/integrationGrading.py [--data DIR] [--convention exact|released-2024]
    python graders/integrationGrading.py --modules DIR    a student's RBSFunctions and Quaternion

In the released convention only the samples that have a result are graded (quirk 3 of the contract).
"""

import sys

import numpy as np
from conventions import RESULT_ATTRIBUTES, graded_samples
from graderProgram import run_grader
from gradingTools import INTEGRATION_LAYOUT
from hints import FIXED_INTEGRATION_MISTAKES, INTEGRATION_MISTAKES
from rigidModel import TIME_STEP, fixed_integration, integration
from trials import Grader, Part, attribute

# The step does not depend on the body's shape, and the data give none: any free body will do.
TETRAHEDRON = {
    "origVertices2": np.vstack([np.zeros((1, 3)), np.eye(3)]),
    "faces2": np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
    "tets2": np.array([[0, 1, 2, 3]]),
}
SHAPES = {key: (4,) if key == "resultOrientations" else (3,) for key in RESULT_ATTRIBUTES}
FIXED = "a fixed mesh's pose"


def integrate(bodies, data, samples, results):
    for sample in samples:
        with results.attempt(sample, *RESULT_ATTRIBUTES):
            mesh = bodies.moving(sample)
            mesh.integrate_timestep(TIME_STEP)
            for key, name in RESULT_ATTRIBUTES.items():
                with results.attempt(sample, key):
                    results.values[key][sample] = attribute(mesh, name, *SHAPES[key])


def integrate_fixed(bodies, data, samples, results):
    for sample in samples:
        with results.attempt(sample, FIXED):
            mesh = bodies.moving(sample, isFixed=True)
            mesh.integrate_timestep(TIME_STEP)
            pose = attribute(mesh, "position", 3), attribute(mesh, "orientation", 4)
            results.values[FIXED][sample] = np.concatenate(pose)


def expected_results(data):
    return {key: data[key] for key in RESULT_ATTRIBUTES}


def fixed_pose(*arguments):
    return {FIXED: fixed_integration(*arguments)}


def remarks(data):
    count = len(graded_samples(data))
    return [f"{count} of {len(data['randomPositions'])} samples graded"]


GRADER = Grader(
    "integrationGrading",
    "Integration of one time step",
    "integration.data",
    INTEGRATION_LAYOUT,
    (
        Part(
            "integrate_timestep", SHAPES, integrate, expected_results, integration,
            INTEGRATION_MISTAKES, graded_samples,
        ),
        Part(
            "integrate_timestep of a fixed mesh", {FIXED: (7,)}, integrate_fixed, fixed_pose,
            fixed_pose, FIXED_INTEGRATION_MISTAKES, isExtra=True,
        ),
    ),
    remarks,
    TETRAHEDRON,
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(run_grader(__doc__, GRADER))
