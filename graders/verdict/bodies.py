"""Makes the graded meshes: of the student's class, with the inertia that the data were made with.

A right inertia tensor and the release's, which is six times too small, are exchanged where the data
need it, because the skeleton's tensor is not the student's work.
"""

import copy
import pickle
from contextlib import suppress
from functools import partial

import numpy as np
from reference.graderData import RELEASED_2024
from reference.rigidModel import DENSITY
from released.physics2024 import INERTIA_DIVISOR, in_world_axes, rotation_matrices

from verdict.parts import NotWritten, few_samples

REST = np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]])
# Relative difference up to which a tensor counts as the right one or the release's: far above
# rounding, far below any mistake.
TENSOR_TOLERANCE = 1e-9
# Samples at which copies of a mesh are compared with new meshes before copies are used.
PROBES = 3

# Remarks for right data, and for the release's.
TENSOR_REMARKS = (
    "IT is six times too small, as in the released skeleton; it was replaced for this verdict",
    "IT is right, but the data were made with the released skeleton's, six times too small; it was "
    "replaced for this verdict",
)
TURN_REMARKS = (
    "get_rotated_inv_IT gives Rᵀ I⁻¹ R, as in the release's reference solution, but R I⁻¹ Rᵀ is "
    "right; it was replaced for this verdict",
    "get_rotated_inv_IT gives R I⁻¹ Rᵀ, which is right, but the data were made with Rᵀ I⁻¹ R; it "
    "was replaced for this verdict",
)


class Bodies:
    """Makes meshes of a grader's data, of the class that is graded.

    functions, quaternion : the graded modules RBSFunctions and Quaternion
    data : as `Grader.load` returns them
    remarks : dict from str to None: what was replaced, and what else the student is told
    """

    def __init__(self, functions, quaternion, data, remarks=()):
        self._modules = {"RBSFunctions": functions, "Quaternion": quaternion}
        self._data = data
        self._originals = {}
        self.remarks = dict.fromkeys(remarks)

    def function(self, name, module="RBSFunctions"):
        """Returns a graded function. Raises NotWritten if the module lacks it."""
        function = getattr(self._modules[module], name, None)
        if not callable(function):
            raise NotWritten(f"{module}.py has no {name}")
        return function

    def ground(self):
        """The ground, as the released driver makes it."""
        return self._made(0, None, True)

    def resting(self, isFixed=False):
        """Mesh 1, at rest and unturned with its centre of mass at the origin."""
        return self._made(1, None, isFixed)

    def moving(self, sample, isFixed=False):
        """Mesh 2 in the random state of a sample; a fixed one has no velocity."""
        mesh = self._made(2, sample, isFixed)
        if not isFixed:
            mesh.linVelocity = self._data["randomLinVelocities"][[sample]]
            mesh.angVelocity = self._data["randomAngVelocities"][[sample]]
        return mesh

    def _made(self, k, sample, isFixed):
        """Mesh k in the pose of a sample, or at rest, with the data's inertia.

        It is a copy, which is much faster than the released constructor, unless copies differ in
        any bit from new meshes of the class.
        """
        if (k, isFixed) not in self._originals:
            samples = few_samples(self._data)[:PROBES] if k == 2 else [None]
            built = [self._built(k, one, isFixed) for one in samples]
            self._originals[k, isFixed] = None
            with suppress(Exception):  # a student's attributes can be anything
                copies = [self._copied(built[0], one) for one in samples]
                pairs = zip(copies, built, strict=True)
                if all(pickle.dumps(vars(a)) == pickle.dumps(vars(b)) for a, b in pairs):
                    self._originals[k, isFixed] = self._matched(built[0], k)
        original = self._originals[k, isFixed]
        if original is None:
            return self._matched(self._built(k, sample, isFixed), k)
        return self._copied(original, sample)

    def _built(self, k, sample, isFixed):
        # New arrays, because the released class changes its arguments.
        shape, pose = [np.empty((0, width)) for width in (3, 3, 4)], map(np.copy, REST)
        if k:
            shape = [self._data[f"{part}{k}"].copy() for part in ("origVertices", "faces", "tets")]
        if sample is not None:
            pose = self._pose(sample)
        return self.function("Mesh")(f"mesh {k}", *shape, DENSITY * (k > 0), *pose, isFixed)

    def _copied(self, original, sample):
        """A copy, with the attributes that the released constructor derives from the pose."""
        mesh = copy.deepcopy(original)
        if sample is not None:
            mesh.position, orientation = self._pose(sample)
            mesh.orientation = orientation / np.linalg.norm(orientation)
            rotate = self.function("QRotate", "Quaternion")
            mesh.currVertices = rotate(mesh.orientation, mesh.origVertices) + mesh.position
        return mesh

    def _pose(self, sample):
        return [self._data[f"random{name}"][[sample]] for name in ("Positions", "Orientations")]

    def _matched(self, mesh, k):
        if k > 0 and 1 in self._data["solids"]:  # other results do not depend on the inertia
            isReleased = self._data["convention"] == RELEASED_2024
            remarks = match_inertia(mesh, self._data["solids"][k].tensor, isReleased)
            self.remarks |= dict.fromkeys(remarks)
        return mesh


def match_inertia(mesh, right, isReleased=False):
    """Gives a mesh the inertia of the data, if it has that of the other convention.

    The way to turn the tensor to world axes is the student's work. It is replaced if the data are
    the release's, or if the mesh has the release's tensor, too. A tensor that is neither right nor
    the release's is a mistake: it stays, and shows in the results. Returns a list of remarks.

    right : (3, 3), the right inertia tensor; isReleased : whether the data have the release's
    """
    remarks, tensors = [], (right, right / INERTIA_DIVISOR)
    known = [_is_tensor(getattr(mesh, "invIT", None), np.linalg.inv(one)) for one in tensors]
    if known[not isReleased]:
        mesh.IT = tensors[isReleased].copy()
        mesh.invIT = np.linalg.inv(mesh.IT)
        remarks.append(TENSOR_REMARKS[isReleased])
    if known[1] or known[0] and isReleased:
        try:
            turned = mesh.get_rotated_inv_IT()
        except Exception:  # reported where its result is needed
            return remarks
        wanted, other = (_world_tensor(mesh, isReleased == one) for one in (True, False))
        if _is_tensor(turned, other) and not _is_tensor(turned, wanted):
            mesh.get_rotated_inv_IT = partial(_world_tensor, mesh, isReleased)
            remarks.append(TURN_REMARKS[isReleased])
    return remarks


def _world_tensor(mesh, isReleased):
    inverse = np.reshape(mesh.invIT, (3, 3))
    return in_world_axes(rotation_matrices(mesh.orientation)[0], inverse, isReleased)


def _is_tensor(value, tensor):
    """Whether a value holds a tensor's nine numbers."""
    try:
        value = np.array(value, dtype=np.float64).reshape(3, 3)
    except (TypeError, ValueError):
        return False
    return bool(np.abs(value - tensor).max() <= TENSOR_TOLERANCE * np.abs(tensor).max())
