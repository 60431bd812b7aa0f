"""Where a body is, and what follows from that for its shape: what the test of one pair looks at.

A `Pose` is made from a position and an orientation and never changes. `world_vertices` works out
the vertices of many bodies in one go, for those who draw them or look at all of them.
"""

from weakref import WeakKeyDictionary

import numpy as np

from Quaternion import rotation_matrices
from rbs.arrays import take
from rbs.bodies import COLUMN_SHAPES
from rbs.hulls import rotate_columns
from rbs.vectors import floats, mat_vec


class Shape:
    """A body's rest vertices and hull as the test of a pair reads them: columns, about the COM.

    vertices : (3, V); hull : `Hull`; hullColumns : (Vh,), where the hull's vertices are in
    `vertices`, or None where that is all of them, in the same order
    """

    def __init__(self, origVertices, hull):
        self.vertices = np.ascontiguousarray(origVertices.T)
        self.hull = hull
        isAll = np.array_equal(hull.vertexIndex, np.arange(len(origVertices)))
        self.hullColumns = None if isAll else hull.vertexIndex


class RotatedShape:
    """A `Shape` rotated to an orientation.

    key : bytes of the orientation; rotation : nine floats, matrix row by row
    vertices : (3, V), relative to the COM; hullVertices : (3, Vh), those of the hull
    low, high : three floats each, the box of the hull relative to the COM
    """

    def __init__(self, shape, key, orientation):
        self.key = key
        self.shape = shape
        self.rotation = rotation_matrices(orientation)
        matrix = np.array(self.rotation)
        self.vertices = self.hullVertices = mat_vec(matrix, shape.vertices)
        if shape.hullColumns is not None:
            self.hullVertices = take(self.vertices, shape.hullColumns, axis=1)
        self.low = self.hullVertices.min(axis=1).tolist()
        self.high = self.hullVertices.max(axis=1).tolist()


class Pose:
    """A `RotatedShape` at a position.

    key : bytes of the position; position : three floats
    box : six floats, least x, y, z and greatest x, y, z of the hull in the world
    """

    def __init__(self, rotated, key, position):
        self.rotated = rotated
        self.key = key
        self.position = x, y, z = position
        lowX, lowY, lowZ = rotated.low
        highX, highY, highZ = rotated.high
        self.box = (lowX + x, lowY + y, lowZ + z, highX + x, highY + y, highZ + z)

    def vertices(self):
        """The vertices in the world, (V, 3)."""
        return np.ascontiguousarray((self.rotated.vertices + np.array(self.position)[:, None]).T)


# The attributes of a mesh that are kept to save time, its state in tables included.
KEPT_NAMES = ("_shape", "_pose", "_currVertices", "cachedAxes", "_tables", "_row")


class Posed:
    """What a mesh keeps of its pose, until position or orientation change: the base of `Mesh`.

    Expects the attributes position, orientation, origVertices and hull. Whatever is kept can be
    made again, and copies and pickles leave it out.

    cachedAxes : by other mesh, the axis along which the two were apart, or overlapped least, when
        they were last looked at
    """

    @property
    def currVertices(self):
        """They cannot be written into: they follow from the pose. What is assigned can be."""
        key = self._pose_key()
        if self._currVertices[0] != key:
            pose = self.pose()
            vertices = np.zeros((0, 3)) if pose is None else pose.vertices()
            vertices.flags.writeable = False
            self._currVertices = key, vertices
        return self._currVertices[1]

    @currVertices.setter
    def currVertices(self, vertices):
        """Holds until position or orientation change."""
        self._currVertices = self._pose_key(), vertices

    def pose(self):
        """The `Pose` at the present position and orientation; None without vertices.

        It is kept until one of them changes, by assignment or in place.
        """
        own = self.__dict__
        kept = own["_pose"]
        try:
            if (
                kept.key == own["position"].tobytes()
                and kept.rotated.key == own["orientation"].tobytes()
            ):
                return kept
        except (KeyError, AttributeError):  # in the state tables, not an array, or none yet
            pass
        return self._renewed_pose()

    def _renewed_pose(self):
        positionKey, orientationKey = self._pose_key()
        kept = self._pose
        if kept is not None and kept.key == positionKey and kept.rotated.key == orientationKey:
            return kept
        if self.hull is None:
            return None
        if self._shape is None:
            self._shape = Shape(self.origVertices, self.hull)
        if kept is not None and kept.rotated.key == orientationKey:
            rotated = kept.rotated
        else:
            rotated = RotatedShape(self._shape, orientationKey, floats(self.orientation, 4))
        self._pose = Pose(rotated, positionKey, floats(self.position, 3))
        return self._pose

    def _pose_key(self):
        """The bytes of position and of orientation, by which a pose is known."""
        return (
            np.asarray(self.position, dtype=np.float64).tobytes(),
            np.asarray(self.orientation, dtype=np.float64).tobytes(),
        )

    def _forget(self):
        """Drops what is kept."""
        self._shape = self._pose = None
        self._currVertices = None, None
        self.cachedAxes = WeakKeyDictionary()

    def __getstate__(self):
        """What copies and pickles take along: the attributes, not what is kept to save time."""
        state = {**vars(self), **{name: getattr(self, name) for name in COLUMN_SHAPES}}
        return {name: value for name, value in state.items() if name not in KEPT_NAMES}

    def __setstate__(self, state):
        self.__dict__.update(state)
        self._forget()


def world_vertices(restVertices, counts, positions, orientations):
    """The vertices of n bodies in the world, (ΣV, 3), with the bits of `Pose.vertices`.

    restVertices : (3, ΣV), of one body after the other; counts : (n,), how many each has
    positions : (3, n); orientations : (4, n)
    """
    rotated = rotate_columns(np.stack(rotation_matrices(orientations)), restVertices, counts)
    return np.ascontiguousarray((rotated + positions.repeat(counts, axis=1)).T)


def refresh_vertices(meshes):
    """Works out the currVertices that are not at hand of all these meshes, in one go.

    For those who look at all of them: mesh by mesh, NumPy's calls would take most of the time.
    returns the currVertices of one mesh after the other, (ΣV, 3), to be read only
    """
    keys = [m._pose_key() for m in meshes]
    stale = [k for k, m in enumerate(meshes) if m._currVertices[0] != keys[k]]
    if stale:
        moved = [meshes[k] for k in stale]
        counts = np.array([len(m.origVertices) for m in moved])
        vertices = world_vertices(
            np.concatenate([m.origVertices for m in moved]).T, counts,
            np.array([np.ravel(m.position) for m in moved], dtype=np.float64).T,
            np.array([np.ravel(m.orientation) for m in moved], dtype=np.float64).T,
        )  # fmt: skip
        vertices.flags.writeable = False
        ends = counts.cumsum().tolist()
        for k, begin, end in zip(stale, [0, *ends[:-1]], ends, strict=True):
            meshes[k]._currVertices = keys[k], vertices[begin:end]
        if len(stale) == len(meshes):
            return vertices
    return np.concatenate([np.empty((0, 3)), *(m._currVertices[1] for m in meshes)])
