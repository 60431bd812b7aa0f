"""The bodies that are graded: of the student's class, with the inertia behind the data.

The quirks of the released material (contract, section 4) are in `released/physics2024`; here they
are put right where they are not the student's own work.
"""

import copy
import pickle
from functools import partial

import numpy as np
from gradingTools import RELEASED_2024
from released.physics2024 import INERTIA_FACTOR, in_world_axes, rotation_matrices
from rigidModel import DENSITY
from trials import NotWritten, few_samples

UNTURNED = np.array([[1.0, 0.0, 0.0, 0.0]])
# How closely, relative to its size, a tensor must be the right one or the release's to be known as
# such: far above its rounding, far below any mistake.
TENSOR_TOLERANCE = 1e-9
# Samples at which copies must be what the class makes, for copies to be taken at all others.
PROBES = 3

# What is said of a tensor, and of its turn to world axes, that are not those of the data: where the
# data are right, and where they are the release's.
TENSOR_REMARKS = (
    "IT is six times too small, as in the released skeleton",
    "IT is right, but the data have the released skeleton's, six times too small",
)
TURN_REMARKS = (
    "get_rotated_inv_IT gives Rᵀ I⁻¹ R, as in the release's reference solution: that is the wrong "
    "way round, and R I⁻¹ Rᵀ is right",
    "get_rotated_inv_IT gives R I⁻¹ Rᵀ, which is right, but the data have Rᵀ I⁻¹ R",
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

    def ground(self):
        """The ground, as the released driver makes it."""
        return self._made(0, (np.zeros((1, 3)), UNTURNED), True)

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

    def _pose(self, sample):
        return tuple(
            self._data[f"random{name}"][[sample]] for name in ("Positions", "Orientations")
        )

    def _made(self, k, pose, isFixed):
        """Mesh k in a pose: a copy of one made before, which takes 0.2 ms where the released class
        takes 13; or a new one, where copies are not the same."""
        if (k, isFixed) not in self._originals:
            self._originals[k, isFixed] = self._original(k, pose, isFixed)
        original = self._originals[k, isFixed]
        if original is None:
            return self._with_the_datas_inertia(self._built(k, pose, isFixed), k)
        return self._copy(original, k, pose)

    def _built(self, k, pose, isFixed):
        # New arrays each time: the released class changes its arguments.
        shape = [np.empty((0, width)) for width in (3, 3, 4)]
        if k:
            shape = [self._data[f"{part}{k}"].copy() for part in ("origVertices", "faces", "tets")]
        pose = [array.copy() for array in pose]
        return self.function("Mesh")(f"mesh {k}", *shape, DENSITY * (k > 0), *pose, isFixed)

    def _copy(self, original, k, pose):
        """A copy, with what the released constructor derives from the pose."""
        mesh = copy.deepcopy(original)
        if k == 2:
            mesh.position, mesh.orientation = pose[0].copy(), pose[1] / np.linalg.norm(pose[1])
            rotate = self.function("QRotate", "Quaternion")
            mesh.currVertices = rotate(mesh.orientation, mesh.origVertices) + mesh.position
        return mesh

    def _original(self, k, pose, isFixed):
        """A mesh to be copied; None for a class whose copies are not, in all attributes and to the
        last bit, what it makes itself in the poses of some samples."""
        poses = [self._pose(s) for s in few_samples(self._data)[:PROBES]] if k == 2 else [pose]
        built = [self._built(k, one, isFixed) for one in poses]
        try:
            copies = [self._copy(built[0], k, one) for one in poses]
            if all(
                _content(one) == _content(other) for one, other in zip(copies, built, strict=True)
            ):
                return self._with_the_datas_inertia(built[0], k)
        except Exception:  # there is no telling what a student's attributes are
            pass
        return None

    def _with_the_datas_inertia(self, mesh, k):
        """The mesh with the data's tensor, where it has that of the other convention.

        A skeleton's tensor is not the student's work. The turn to world axes is: it is replaced
        where the data are the release's, and of the release's whole solution. What is neither
        right nor the release's is a mistake: it stays, and shows in the results.
        """
        if 1 not in self._data["solids"] or k == 0:  # no result depends on it
            return mesh
        right = self._data["solids"][k].tensor
        tensors = right, INERTIA_FACTOR * right
        known = [_is_tensor(getattr(mesh, "invIT", None), np.linalg.inv(one)) for one in tensors]
        if known[not self._isReleased]:
            mesh.IT = tensors[self._isReleased]
            mesh.invIT = np.linalg.inv(mesh.IT)
            self._remark(TENSOR_REMARKS)
        if known[1] or known[0] and self._isReleased:
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
        text = f"{texts[self._isReleased]}; it was replaced for this verdict"
        if text not in self.remarks:
            self.remarks.append(text)


def _content(mesh):
    return pickle.dumps(vars(mesh))


def _world_tensor(mesh, isReleased):
    inverse = np.reshape(mesh.invIT, (3, 3))
    return in_world_axes(rotation_matrices(mesh.orientation)[0], inverse, isReleased)


def _is_tensor(value, tensor):
    """Whether a value is an array of a tensor's nine numbers."""
    try:
        value = np.array(value, dtype=np.float64).reshape(3, 3)
    except (TypeError, ValueError):
        return False
    return bool(np.abs(value - tensor).max() <= TENSOR_TOLERANCE * np.abs(tensor).max())
