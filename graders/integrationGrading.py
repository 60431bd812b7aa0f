"""Grade `Mesh.integrate_timestep` against integration.data: one step of 0.1 s per sample.

    python graders/integrationGrading.py [--data DIR]
    python graders/integrationGrading.py --modules DIR    a student's RBSFunctions and Quaternion

The released data hold a result for one sample only (quirk 3 in graders/README.md), which is
graded.
"""

import sys

import numpy as np
from classwork.graderProgram import run_grader
from reference import rigidModel as model
from reference.graderData import EXACT, INTEGRATION_LAYOUT, WIDTHS
from verdict.parts import Grader, Part, WrongResult, few_samples, numbers, results_of, state_of

# The step does not depend on the body's shape, and the data have none: any body will do.
TETRAHEDRON = {
    "origVertices2": np.vstack([np.zeros((1, 3)), np.eye(3)]),
    "faces2": np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
    "tets2": np.array([[0, 1, 2, 3]]),
}


def integrate(bodies, data, sample):
    mesh = bodies.moving(sample)
    mesh.integrate_timestep(model.TIME_STEP)
    yield from results_of(mesh)


def integrate_further(bodies, data, sample):
    fixed = bodies.moving(sample, isFixed=True)
    fixed.integrate_timestep(model.TIME_STEP)
    yield "a fixed mesh's pose", state_of(fixed)[:7]
    mesh = bodies.moving(sample)
    mesh.integrate_timestep(model.TIME_STEP)
    position, orientation = state_of(mesh)[None, :3], state_of(mesh)[None, 3:7]
    vertices = numbers(mesh.currVertices, 12, "the mesh's currVertices")
    yield "currVertices", vertices - model.carried(data, position, orientation)


def exponentiate(bodies, data, sample):
    rows = np.vstack([part[sample] for part in model.turn_rows(data)])
    for name, some in (("QExp of one row", rows[1:2]), ("QExp of several rows", rows)):
        value = bodies.function("QExp", "Quaternion")(some.copy())
        if np.shape(value) not in (some.shape, some[0].shape):
            value = WrongResult(f"QExp returns {np.shape(value)} for an array {some.shape}")
        yield name, value


def graded_samples(data):
    """The samples that have a result: all of them, except for quirk 3."""
    results = np.hstack([data[f"result{name}"] for name in WIDTHS])
    return np.flatnonzero(np.any(results != 0, axis=1) | (data["convention"] == EXACT))


FURTHER = "integrate_timestep of a fixed mesh, and currVertices"
EXTRA = {"samples": few_samples, "isExtra": True}
STATE = {f"result{name}": width for name, width in WIDTHS.items()}
UNSEEN = {"a fixed mesh's pose": 7, "currVertices": 12}
SUPPLIED = ", because the coursework supplies QExp"
ROWS = {"QExp of one row": 4, "QExp of several rows": 12}
GRADER = Grader(
    "integrationGrading",
    "Integration of one time step",
    "integration.data",
    INTEGRATION_LAYOUT,
    (
        Part("integrate_timestep", STATE, integrate, model.integration, graded_samples),
        Part(FURTHER, UNSEEN, integrate_further, model.further_integration, **EXTRA),
        Part("QExp", ROWS, exponentiate, model.exponentials, **EXTRA, advice=SUPPLIED),
    ),
    TETRAHEDRON,
)

if __name__ == "__main__":
    sys.exit(run_grader(__doc__, GRADER))
