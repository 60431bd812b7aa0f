"""How the graders make their bodies: with the right physics, or with that of the 2024 release.

The quirks of the released material (contract, section 4) live in `released/physics2024` and, for
the data, here; and nowhere else.
"""

import numpy as np
from gradingTools import EXACT, RELEASED_2024
from released.physics2024 import INERTIA_FACTOR, inertia_tensor, rotation_matrix
from rigidModel import DENSITY
from trials import NotWritten

UNTURNED = np.array([[1.0, 0.0, 0.0, 0.0]])

# The data's key of a body's state afterwards, and the attribute of Mesh to compare it with.
RESULT_ATTRIBUTES = {
    "resultPositions": "position",
    "resultOrientations": "orientation",
    "resultLinVelocities": "linVelocity",
    "resultAngVelocities": "angVelocity",
}
# How closely, relative to its size, a tensor must be the right one or the release's to be known as
# such: far above its rounding, far below any mistake.
TENSOR_TOLERANCE = 1e-9


class Bodies:
    """Meshes of a grader's data, of the class that is graded.

    functions, quaternion : the modules RBSFunctions and Quaternion that are graded
    data : as `Grader.load` gives them
    """

    def __init__(self, functions, quaternion, data):
        self._modules = {"RBSFunctions": functions, "Quaternion": quaternion}
        self._data = data

    def function(self, name, module="RBSFunctions"):
        """A function of what is graded; raises NotWritten where there is none."""
        function = getattr(self._modules[module], name, None)
        if not callable(function):
            raise NotWritten(f"{module}.py has no {name}")
        return function

    def resting(self, isFixed=False):
        """Mesh 1, which stands still and unturned with its centre of mass at the origin."""
        return self._make(1, np.zeros((1, 3)), UNTURNED.copy(), isFixed)

    def moving(self, sample, isFixed=False):
        """Mesh 2 in the random state of a sample; a fixed one has no velocity."""
        position = self._data["randomPositions"][[sample]]
        orientation = self._data["randomOrientations"][[sample]]
        mesh = self._make(2, position, orientation, isFixed)
        if not isFixed:
            mesh.linVelocity = self._data["randomLinVelocities"][[sample]]
            mesh.angVelocity = self._data["randomAngVelocities"][[sample]]
        return mesh

    def _make(self, k, position, orientation, isFixed):
        # Copies, and new ones each time: the released class changes its arguments.
        shape = [self._data[f"{part}{k}"].copy() for part in ("origVertices", "faces", "tets")]
        mesh = self.function("Mesh")(f"mesh {k}", *shape, DENSITY, position, orientation, isFixed)
        if self._data["convention"] == RELEASED_2024:
            _give_released_inertia(mesh, self._data[f"origVertices{k}"], self._data[f"tets{k}"])
        return mesh


def _give_released_inertia(mesh, vertices, tets):
    """Sets the tensor of the release, absolutely, where the mesh has that one or the right one.

    So a solution passes whether its physics are the release's or right. Another tensor, or one
    that is turned to world axes in neither way, is a mistake: it stays, and shows in the results.
    So does the inverse of zero that a fixed mesh has.
    """
    right = inertia_tensor(vertices, tets, DENSITY)
    own = getattr(mesh, "invIT", None)
    known = [np.linalg.inv(right), np.linalg.inv(INERTIA_FACTOR * right)]
    if not any(_same(own, tensor) for tensor in known):
        return
    own = np.array(own, dtype=np.float64).reshape(3, 3)
    R = rotation_matrix(mesh.orientation)
    try:
        rotated = mesh.get_rotated_inv_IT()
    except Exception:  # it is asked for again where it is needed, and the error told there
        rotated = None
    mesh.IT, mesh.invIT = INERTIA_FACTOR * right, known[1]
    if _same(rotated, R @ own @ R.T) or _same(rotated, R.T @ own @ R):

        def get_rotated_inv_IT():
            R = rotation_matrix(mesh.orientation)
            return R.T @ np.reshape(mesh.invIT, (3, 3)) @ R

        mesh.get_rotated_inv_IT = get_rotated_inv_IT


def _same(value, tensor):
    """Whether a value is an array of a tensor's nine numbers."""
    try:
        value = np.array(value, dtype=np.float64).reshape(3, 3)
    except (TypeError, ValueError):
        return False
    return bool(np.abs(value - tensor).max() <= TENSOR_TOLERANCE * np.abs(tensor).max())


def graded_samples(data):
    """The numbers of the samples that have a result.

    All of them have one, except that quirk 3 left the rows of all but the first at zero.
    """
    hasResult = np.any(np.hstack([data[key] for key in RESULT_ATTRIBUTES]) != 0, axis=1)
    return np.flatnonzero(hasResult | (data["convention"] == EXACT))
