"""The bodies that are graded: of the student's class, with the inertia that the data were made with.

The quirks of the released material (contract, section 4) are in `released/physics2024`; here they
are put right where they are not the student's own work.
"""

import copy
from functools import partial

import numpy as np
from gradingTools import RELEASED_2024
from released.physics2024 import (
    INERTIA_FACTOR,
    in_world_axes,
    inertia_tensor,
    rotation_matrices,
)
from rigidModel import DENSITY
from trials import NotWritten

UNTURNED = np.array([[1.0, 0.0, 0.0, 0.0]])
# How closely, relative to its size, a tensor must be the right one or the release's to be known as
# such: far above its rounding, far below any mistake.
TENSOR_TOLERANCE = 1e-9
# Samples at which a copy must be what the class makes, for copies to be taken at all others.
PROBES = 3

REPLACED = "it was replaced for this verdict"
# What is said of a tensor, and of its turn to world axes, that are not those of the data: of right
# data, and of the release's.
TENSOR_REMARKS = (
    f"IT is six times too small, as in the released skeleton; {REPLACED}",
    f"IT is right, but the data have the released skeleton's, six times too small; {REPLACED}",
)
TURN_REMARKS = (
    "get_rotated_inv_IT gives Rᵀ I⁻¹ R, as in the release's reference solution: that is the wrong "
    f"way round, and R I⁻¹ Rᵀ is right; {REPLACED}",
    f"get_rotated_inv_IT gives R I⁻¹ Rᵀ, which is right, but the data have Rᵀ I⁻¹ R; {REPLACED}",
)


class Bodies:
    """Meshes of a grader's data, of the class that is graded.

    functions, quaternion : the modules RBSFunctions and Quaternion that are graded
    data : as `Grader.load` gives them
    remarks : what was replaced, each once
    """

    def __init__(self, functions, quaternion, data):
        self._modules = {"RBSFunctions": functions, "Quaternion": quaternion}
        self._data = data
        self._isReleased = data["convention"] == RELEASED_2024
        self._originals = {}
        self.remarks = []

    def function(self, name, module="RBSFunctions"):
        """A function of what is graded; raises NotWritten where there is none."""
        function = getattr(self._modules[module], name, None)
        if not callable(function):
            raise NotWritten(f"{module}.py has no {name}")
        return function

    def resting(self, isFixed=False):
        """Mesh 1, which stands still and unturned with its centre of mass at the origin."""
        return self._made(1, (np.zeros((1, 3)), UNTURNED), isFixed)

    def moving(self, sample, isFixed=False):
        """Mesh 2 in the random state of a sample; a fixed one has no velocity."""
        mesh = self._made(2, self._pose(sample), isFixed)
        if not isFixed:
            mesh.linVelocity = self._data["randomLinVelocities"][[sample]]
            mesh.angVelocity = self._data["randomAngVelocities"][[sample]]
        return mesh

    def ground(self):
        """The ground, as the released driver makes it."""
        nothing = np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 4))
        return self.function("Mesh")(
            "ground", *nothing, 0.0, np.zeros((1, 3)), UNTURNED.copy(), True
        )

    def _pose(self, sample):
        return tuple(self._data[f"random{name}"][[sample]] for name in ("Positions", "Orientations"))

    def _made(self, k, pose, isFixed):
        """Mesh k in a pose: a copy of one made before, where that is the same, or a new one.

        The released class takes 13 ms for a mesh, and a copy 0.02 ms.
        """
        if (k, isFixed) not in self._originals:
            self._originals[k, isFixed] = self._original(k, isFixed)
        original = self._originals[k, isFixed]
        if original is None:
            return self._with_the_datas_inertia(self._build(k, pose, isFixed), k)
        return self._placed(copy.deepcopy(original), pose)

    def _build(self, k, pose, isFixed):
        # Copies, and new ones each time: the released class changes its arguments.
        shape = [self._data[f"{part}{k}"].copy() for part in ("origVertices", "faces", "tets")]
        pose = [array.copy() for array in pose]
        return self.function("Mesh")(f"mesh {k}", *shape, DENSITY, *pose, isFixed)

    def _original(self, k, isFixed):
        """A mesh to be copied, or None for a class whose copies are not, to the last bit, what it
        makes itself: of some samples' poses, whatever attributes there are."""
        poses = [(np.zeros((1, 3)), UNTURNED)]
        if k == 2:
            poses = [self._pose(sample) for sample in range(len(self._data["randomPositions"]))]
        built = [self._build(k, pose, isFixed) for pose in poses[:PROBES]]
        try:
            copies = [self._placed(copy.deepcopy(built[0]), pose) for pose in poses[:PROBES]]
            if _same([vars(mesh) for mesh in copies], [vars(mesh) for mesh in built]):
                return self._with_the_datas_inertia(built[0], k)
        except Exception:  # there is no telling what a student's attributes are
            pass
        return None

    def _placed(self, mesh, pose):
        """The mesh with what the released constructor derives from the pose."""
        position, orientation = pose
        mesh.position = position.copy()
        mesh.orientation = orientation / np.linalg.norm(orientation)
        rotated = self.function("QRotate", "Quaternion")(mesh.orientation, mesh.origVertices)
        mesh.currVertices = rotated + mesh.position
        return mesh

    def _with_the_datas_inertia(self, mesh, k):
        """The mesh with the data's tensor, where it has that of the other convention.

        A skeleton's tensor is not the student's work. The turn to world axes is: it is replaced
        where the data are the release's, and of the release's whole solution. What is neither
        right nor the release's is a mistake: it stays, and shows in the results.
        """
        if "tets1" not in self._data:  # no result depends on it
            return mesh
        right = inertia_tensor(self._data[f"origVertices{k}"], self._data[f"tets{k}"], DENSITY)
        tensors = [right, INERTIA_FACTOR * right]
        inverses = [np.linalg.inv(tensor) for tensor in tensors]
        known = [_is_tensor(getattr(mesh, "invIT", None), inverse) for inverse in inverses]
        if not any(known):  # also the zero of a fixed mesh
            return mesh
        if known[not self._isReleased]:
            mesh.IT, mesh.invIT = tensors[self._isReleased], inverses[self._isReleased]
            self._remark(TENSOR_REMARKS)
        if known[1] or self._isReleased:
            try:
                turned = mesh.get_rotated_inv_IT()
            except Exception:  # it is asked for again where it is needed, and reported there
                return mesh
            wanted, other = (_world_tensor(mesh, self._isReleased == one) for one in (True, False))
            if _is_tensor(turned, other) and not _is_tensor(turned, wanted):
                mesh.get_rotated_inv_IT = partial(_world_tensor, mesh, self._isReleased)
                self._remark(TURN_REMARKS)
        return mesh

    def _remark(self, texts):
        if texts[self._isReleased] not in self.remarks:
            self.remarks.append(texts[self._isReleased])


def _world_tensor(mesh, isReleased):
    inverse = np.reshape(mesh.invIT, (3, 3))
    return in_world_axes(rotation_matrices(mesh.orientation)[0], inverse, isReleased)


def _same(a, b):
    """Whether two values, containers and arrays included, are equal to the last bit."""
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, dict):
        return list(a) == list(b) and all(_same(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple):
        return len(a) == len(b) and all(map(_same, a, b))
    return bool(a == b)


def _is_tensor(value, tensor):
    """Whether a value is an array of a tensor's nine numbers."""
    try:
        value = np.array(value, dtype=np.float64).reshape(3, 3)
    except (TypeError, ValueError):
        return False
    return bool(np.abs(value - tensor).max() <= TENSOR_TOLERANCE * np.abs(tensor).max())
