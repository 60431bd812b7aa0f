"""Grade `Mesh.integrate_timestep` against integration.data: one step of 0.1 s per sample.

    python graders/integrationGrading.py [--data DIR] [--convention exact|released-2024]

In the released convention only the samples that have a result are graded (quirk 3 of the contract).
"""

import sys

import numpy as np
from conventions import RESULT_ATTRIBUTES, graded_samples, moving_mesh
from gradingTools import INTEGRATION_LAYOUT, Grade, GraderDataError, run_grader

TIME_STEP = 0.1  # s

# The step does not depend on the body's shape, and the data give none: any free body will do.
TETRAHEDRON = {
    "origVertices2": np.vstack([np.zeros((1, 3)), np.eye(3)]),
    "faces2": np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
    "tets2": np.array([[0, 1, 2, 3]]),
}


def grade_integration(data, convention):
    samples = graded_samples([data[key] for key in RESULT_ATTRIBUTES], convention)
    if len(samples) == 0:
        raise GraderDataError("no sample has a result")
    meshes = [moving_mesh(data | TETRAHEDRON, sample, convention) for sample in samples]
    for mesh in meshes:
        mesh.integrate_timestep(TIME_STEP)

    grade = Grade("Integration of one time step")
    grade.remarks.append(f"{len(samples)} of {len(data['randomPositions'])} samples graded")
    for key, attribute in RESULT_ATTRIBUTES.items():
        computed = np.array([np.reshape(getattr(mesh, attribute), -1) for mesh in meshes])
        grade.compare(key, computed, data[key][samples], samples)
    return grade


if __name__ == "__main__":
    sys.exit(run_grader(__doc__, "integration.data", INTEGRATION_LAYOUT, grade_integration))
