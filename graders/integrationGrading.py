"""Grade `Mesh.integrate_timestep` against integration.data: one step of 0.1 s per sample.

    python graders/integrationGrading.py [--data DIR]
    python graders/integrationGrading.py --modules CODE   a student's RBSFunctions and Quaternion

The released data hold a result for one sample only (quirk 3 in graders/README.md), which is
graded. A fresh sample makes two steps of other lengths.
"""

import reference

if __name__ == "__main__":
    reference.prepare()

import sys

import numpy as np
from classwork.graderProgram import run_grader
from reference import rigidModel as model
from reference.graderData import EXACT, INTEGRATION_LAYOUT, WIDTHS
from verdict.parts import Grader, Part, few_samples

# The step does not depend on the body's shape, and the data have none: any body will do.
TETRAHEDRON = {
    "origVertices2": np.vstack([np.zeros((1, 3)), np.eye(3)]),
    "faces2": np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
    "tets2": np.array([[0, 1, 2, 3]]),
}


def graded_samples(data):
    """The samples that have a result: all of them, except for quirk 3."""
    results = np.hstack([data[f"result{name}"] for name in WIDTHS])
    return np.flatnonzero(np.any(results != 0, axis=1) | (data["convention"] == EXACT))


FURTHER = "integrate_timestep of a fixed mesh, and currVertices"
EXTRA = {"samples": few_samples, "isExtra": True}
STATE = {f"result{name}": width for name, width in WIDTHS.items()}
UNSEEN = {"a fixed mesh's pose": 7, "currVertices": 12}
STEPS, NAME = {"inputs": model.steps_of}, "integrate_timestep"
PARTS = (
    Part(NAME, STATE, "integrate", model.integration, samples=graded_samples, **STEPS),
    Part(FURTHER, UNSEEN, "integrate_further", model.further_integration, **EXTRA, **STEPS),
)
TITLE, DATA = "Integration of one time step", "integration.data"
GRADER = Grader("integrationGrading", TITLE, DATA, INTEGRATION_LAYOUT, PARTS, TETRAHEDRON)

if __name__ == "__main__":
    sys.exit(run_grader(__doc__, GRADER))
