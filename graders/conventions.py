"""How the graders make their bodies: with the right physics, or with that of the 2024 release.

The quirks of the released material (contract, section 4) live here and nowhere else.
"""

import sys
from pathlib import Path

import numpy as np
from gradingTools import EXACT, RELEASED_2024, GraderDataError

# A grader started from anywhere finds the simulation in the folder above. Importing this module
# first is enough for the graders themselves.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from Quaternion import Q2RotMatrix
from RBSFunctions import Mesh

DENSITY = 1.0
UNTURNED = np.array([[1.0, 0.0, 0.0, 0.0]])

# The data's key of a body's state afterwards, and the attribute of Mesh to compare it with.
RESULT_ATTRIBUTES = {
    "resultPositions": "position",
    "resultOrientations": "orientation",
    "resultLinVelocities": "linVelocity",
    "resultAngVelocities": "angVelocity",
}


class ReleasedMesh(Mesh):
    """A body with the inertia of the coursework's 2024 reference solution.

    Quirk 1: the tensor is six times too small, the tetrahedron's volume standing in its integral
    where the Jacobian determinant, 6 × volume, belongs.
    Quirk 2: the inverse tensor is turned to world axes as Rᵀ I⁻¹ R, the wrong way round.
    """

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.IT = self.IT / 6.0
        self.invIT = self.invIT * 6.0

    def get_rotated_inv_IT(self):
        """Inverse inertia tensor (3, 3), 1 / (kg m²), as the release has it in world axes."""
        rotation = Q2RotMatrix(self.orientation)
        return rotation.T @ self.invIT @ rotation


MESH_CLASSES = {EXACT: Mesh, RELEASED_2024: ReleasedMesh}


def resting_mesh(data, convention):
    """Mesh 1 of the data, which stands still and unturned with its centre of mass at the origin."""
    return _make_mesh(data, 1, np.zeros((1, 3)), UNTURNED, convention)


def moving_mesh(data, sample, convention):
    """Mesh 2 of the data in the random state of a sample."""
    position, orientation = data["randomPositions"][[sample]], data["randomOrientations"][[sample]]
    mesh = _make_mesh(data, 2, position, orientation, convention)
    mesh.linVelocity = data["randomLinVelocities"][[sample]]
    mesh.angVelocity = data["randomAngVelocities"][[sample]]
    return mesh


def _make_mesh(data, k, position, orientation, convention):
    shape = (data[f"{part}{k}"] for part in ("origVertices", "faces", "tets"))
    try:
        return MESH_CLASSES[convention](f"mesh {k}", *shape, DENSITY, position, orientation, False)
    except ValueError as problem:
        raise GraderDataError(f"mesh {k} is not a body: {problem}") from None


def graded_samples(results, convention):
    """The numbers of the samples that have a result.

    results : list of (n, ...) arrays, a row a sample
    All of them have one, except that quirk 3 left the rows of all but the first at zero.
    """
    hasResult = np.ones(len(results[0]), dtype=bool)
    if convention == RELEASED_2024:
        hasResult = np.any(np.hstack(results) != 0, axis=1)
    return np.flatnonzero(hasResult)
