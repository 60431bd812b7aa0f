"""The state of meshes in tables: what a step reads and writes of thousands of them, in few arrays.

`StateColumn` makes an attribute of a mesh a view of its row in the `StateTables` of its last step.
`Bodies` has the tables of one step with a column a body, and what follows from the orientations:
rotated hulls, boxes, inverse inertia in world axes. Nothing here is physics: bodies are moved by
whoever assigns to the tables.
"""

import math
from contextlib import contextmanager
from functools import lru_cache

import numpy as np

from Quaternion import rotation_matrices
from rbs.arrays import find_sorted, indices, ranges, row_minima, take
from rbs.flight import gyroscopic_velocity
from rbs.hulls import FEATURE_TOLERANCE, NO_HULL, HullSet, rotate_columns
from rbs.vectors import rotate_tensor

# No number of a state may be larger: products of four of them are still finite, and nothing that
# is to be looked at is as far away or as fast.
LARGEST_NUMBER = 1e75

# The state of a mesh, and what else a step reads of it; the shape of each.
STATE_SHAPES = {
    "position": (1, 3),
    "orientation": (1, 4),
    "linVelocity": (1, 3),
    "angVelocity": (1, 3),
}
COLUMN_SHAPES = {**STATE_SHAPES, "invIT": (3, 3), "invMass": ()}


class StateError(ArithmeticError):
    """A step that would give a body a number that is NaN, infinite or beyond LARGEST_NUMBER."""


def check_numbers(columns, meshes, when):
    """Raises StateError, which names the body, where a number is NaN, infinite or too large.

    columns : dict, of each name in STATE_SHAPES an array (w, n)
    when : what the step has just done, for the message
    """
    # NaN is the maximum of whatever holds it, and not less than anything
    if all(abs(columns[name]).max(initial=0.0) <= LARGEST_NUMBER for name in STATE_SHAPES):
        return
    for name in STATE_SHAPES:
        isWrong = ~(abs(columns[name]) <= LARGEST_NUMBER)
        if isWrong.any():
            b = int(isWrong.any(axis=0).argmax())
            value = float(columns[name][isWrong[:, b], b][0])
            raise StateError(
                f"body {b}, {meshes[b].name!r}: {name} holds {value:g} after {when}"
            )


def check_distinct(meshes):
    """Raises ValueError where a mesh is in the list twice: it cannot collide with itself."""
    if len({id(mesh) for mesh in meshes}) < len(meshes):
        twice = next(k for k, mesh in enumerate(meshes) if any(mesh is m for m in meshes[:k]))
        raise ValueError(f"mesh {twice}, {meshes[twice].name!r}, is in the list twice")


def state_columns(meshes):
    """The state of meshes as arrays: dict, of each name in STATE_SHAPES a table (w, n).

    Right after a step in tables, they are views of these, which saves looking at every mesh.
    """
    tables = meshes[0].__dict__.get("_tables") if len(meshes) else None
    if tables is not None and tables.holds(meshes):
        return {name: tables.tables[name].reshape(len(meshes), -1).T for name in STATE_SHAPES}
    return {
        name: _table([getattr(m, name) for m in meshes], math.prod(shape)).T
        for name, shape in STATE_SHAPES.items()
    }


@contextmanager
def restored_on_error(meshes):
    """Within it, whatever is raised leaves the state of the meshes as it was at the beginning."""
    before = [[getattr(m, name).copy() for name in STATE_SHAPES] for m in meshes]
    try:
        yield
    except BaseException:
        for mesh, state in zip(meshes, before, strict=True):
            for name, value in zip(STATE_SHAPES, state, strict=True):
                setattr(mesh, name, value)
        raise


# --------------------------------------------------------------------------------------------------
# Between steps
# --------------------------------------------------------------------------------------------------


class StateColumn:
    """Descriptor: a view of this mesh's row in the state tables of its last step.

    Assignment stores an override in the mesh itself and marks the mesh dirty until the next gather.
    So a step reads and writes the state of a thousand meshes without touching one of them.
    """

    def __set_name__(self, owner, name):
        self.name = name

    def __get__(self, mesh, owner=None):
        if mesh is None:
            return self
        own = mesh.__dict__
        if self.name in own:
            return own[self.name]
        if own.get("_tables") is None:
            raise AttributeError(f"the mesh has no {self.name} yet")
        return own["_tables"].row(self.name, own["_row"])

    def __set__(self, mesh, value):
        own = mesh.__dict__
        own[self.name] = value
        tables = own.get("_tables")
        if tables is not None:
            tables.dirty[own["_row"]] = None


class StateTables:
    """The tables that a list of meshes has its state in, a row a mesh. See `StateColumn`.

    meshes : list of the n meshes
    tables : dict, of each name in COLUMN_SHAPES a table (n, …)
    dirty : dict, its keys the rows of the meshes that something has been assigned to
    isDetached : whether a mesh has its state elsewhere: before the first step, or after one of
        another list of meshes

    A step makes new tables, so that what somebody has kept of the old ones stays as it was.
    """

    def __init__(self):
        self.meshes = []
        self.tables = {}
        self.dirty = {}
        self.isDetached = True

    def holds(self, meshes):
        """Whether the state of these meshes is that of the tables, row by row."""
        return not (self.isDetached or self.dirty) and self.meshes == list(meshes)

    def row(self, name, index):
        """The row of the mesh with this index."""
        row = self.tables[name][index]
        return row if row.ndim else row.item()

    def gather(self, meshes):
        """Brings the tables up to date with what users have assigned.

        What they have written into their rows is in the tables already.
        """
        if self.isDetached:
            self.dirty = dict.fromkeys(range(len(meshes)))
            for name, shape in COLUMN_SHAPES.items():
                table = _table([getattr(m, name) for m in meshes], math.prod(shape))
                self.tables[name] = table.reshape(-1, *shape)
        elif self.dirty:
            self.tables = {name: table.copy() for name, table in self.tables.items()}
            for b in self.dirty:
                for name, shape in COLUMN_SHAPES.items():
                    self.tables[name][b] = np.reshape(getattr(meshes[b], name), shape)

    def scatter(self, meshes, tables):
        """Puts new tables in place of those named, and gives the meshes their rows."""
        self.tables = {**self.tables, **tables}
        for b in self.dirty:
            own = meshes[b].__dict__
            for name in COLUMN_SHAPES:
                own.pop(name, None)
            if own.get("_tables") not in (None, self):
                own["_tables"].isDetached = True
            own["_tables"], own["_row"] = self, b
        self.meshes = list(meshes)
        self.dirty = {}
        self.isDetached = False


def _table(values, width):
    """A table (n, width) of values with that many entries each, whatever their shapes."""
    try:
        table = np.array(values, dtype=np.float64)
    except ValueError:  # shapes that differ
        table = np.concatenate([np.ravel(value) for value in values], dtype=np.float64)
    return table.reshape(len(values), width)


# --------------------------------------------------------------------------------------------------
# Within a step
# --------------------------------------------------------------------------------------------------


class BodyState:
    """What a contact or a constraint reads and changes of a body: components, floats or arrays.

    invMass : 1 / kg, 0 for what cannot move; invInertia : nine entries row by row, world axes
    position, linVelocity, angVelocity : vectors

    Where only positions or only velocities are worked on, the rest may be None.
    """

    __slots__ = ("angVelocity", "invInertia", "invMass", "linVelocity", "position")

    def __init__(self, invMass, invInertia, position, linVelocity, angVelocity):
        self.invMass = invMass
        self.invInertia = invInertia
        self.position = position
        self.linVelocity = linVelocity
        self.angVelocity = angVelocity


class _Shapes:
    """What never changes of a list of meshes: rest vertices and hulls, in tables.

    vertices : (3, ΣV), rest vertices of all meshes; body b has vertexStart[b] … of them
    hulls : HullSet at rest; a mesh without vertices has a point for a hull
    hullColumn : (ΣVh,), the columns in `vertices` of the hulls' vertices; None where that is all
    hasShape : (n,) bool
    state : `StateTables` of these meshes
    axes : `AxisCache` of these meshes
    """

    def __init__(self, meshes):
        check_distinct(meshes)
        self.vertexCount = np.array([len(m.origVertices) for m in meshes], dtype=np.intp)
        self.vertexStart = self.vertexCount.cumsum() - self.vertexCount
        self.hasShape = self.vertexCount > 0
        self.vertices = np.ascontiguousarray(np.concatenate([m.origVertices for m in meshes]).T)
        hulls = [NO_HULL if m.hull is None else m.hull for m in meshes]
        self.hulls = HullSet(hulls)
        # where a mesh has no vertices, any column does for its point: it meets nothing
        starts = np.minimum(self.vertexStart, max(0, len(self.vertices.T) - 1))
        self.hullColumn = np.concatenate(
            [hull.vertexIndex + start for hull, start in zip(hulls, starts, strict=True)]
        )
        if np.array_equal(self.hullColumn, np.arange(self.vertices.shape[1])):
            self.hullColumn = None
        self.state = StateTables()
        self.axes = AxisCache(len(meshes))


class AxisCache:
    """What a step found out about pairs, to save time in the next one. It never changes a result.

    keys : (P,), sorted; i · n + j of the pairs whose boxes were near each other
    axis : (3, P), along which the pair overlapped least, or was furthest apart
    displacement : (n,), how far corrections moved each body at most within the step
    """

    def __init__(self, count):
        self.count = count
        self.keys = np.zeros(0, dtype=np.int64)
        self.axis = np.zeros((3, 0))
        self.displacement = np.zeros(count)

    def lookup(self, first, second):
        """Axes (3, P) for `CachedAxes`: zero for pairs that were not near."""
        if len(self.keys) == 0:
            return np.zeros((3, len(first)))
        known = find_sorted(first * self.count + second, self.keys)
        return np.where(known >= 0, take(self.axis, known, axis=1), 0.0)

    def store(self, first, second, axis):
        """Keeps the axes (3, P) of a step's pairs, which are in the order i < j."""
        self.keys = first * self.count + second
        self.axis = axis


# The tables of the scenes at hand: making them costs more than a step of a small scene.
_shapes = lru_cache(maxsize=4)(_Shapes)


class Bodies:
    """The meshes of one step as arrays, one column a body.

    motion : (9, n); its parts are position, linVelocity, angVelocity, (3, n) each, the last two
        together velocity
    orientation : (4, n)
    travel : (3, n), how `place` has changed the position
    invMass : (n,); invInertia : (9, n), world axes, row by row
    box : (6, n), bounding boxes in the world before the collisions: least coordinates, then
        greatest ones negated. A mesh without vertices has none
    hulls : HullSet, rotated to the orientations
    vertices : (3, ΣV), all vertices, rotated, relative to their COMs; those of a body begin at
        vertexStart (n,), and it has vertexCount (n,) of them
    axes : `AxisCache`
    """

    def __init__(self, meshes):
        """Gathers the state of the meshes; `place` has to follow before anything else is asked."""
        self.meshes = meshes
        self._shapes = _shapes(tuple(meshes))
        self.axes = self._shapes.axes
        self.vertexStart = self._shapes.vertexStart
        self.vertexCount = self._shapes.vertexCount
        tables = self._shapes.state
        tables.gather(meshes)
        columns = {
            name: np.ascontiguousarray(table.reshape(len(table), -1).T)
            for name, table in tables.tables.items()
        }
        self.motion = np.concatenate(
            (columns["position"], columns["linVelocity"], columns["angVelocity"])
        )
        self._gathered = self.motion.copy()
        self.orientation = columns["orientation"]
        self.invMass = tables.tables["invMass"]
        self.isFixed = self.invMass == 0.0
        self.restInvInertia = np.where(self.isFixed, 0.0, columns["invIT"])

    position = property(lambda self: self.motion[0:3])
    velocity = property(lambda self: self.motion[3:9])
    linVelocity = property(lambda self: self.motion[3:6])
    angVelocity = property(lambda self: self.motion[6:9])

    def columns(self):
        """The state: dict, of each name in STATE_SHAPES a table (w, n)."""
        return {name: getattr(self, name) for name in STATE_SHAPES}

    def place(self, position, linVelocity, orientation):
        """Gives the bodies that are not fixed these positions, velocities and orientations.

        Everything that turns with them follows.
        """
        before = self.position
        moved = np.concatenate((position, linVelocity, self.angVelocity))
        self.motion = np.where(self.isFixed, self.motion, moved)
        self.travel = self.position - before
        self.orientation = np.where(self.isFixed, self.orientation, orientation)
        self.follow_orientations()

    def turn_gyroscopically(self, timeStep):
        """Changes the angular velocities of free bodies as torque-free motion does."""
        inertia = np.array([np.ravel(mesh.IT) for mesh in self.meshes], dtype=np.float64)
        inertia = np.where(self.isFixed, np.eye(3).reshape(9, 1), inertia.T)
        turned = gyroscopic_velocity(self.angVelocity, self.orientation, inertia, timeStep)
        self.motion[6:9] = np.where(self.isFixed, self.angVelocity, turned)

    def follow_orientations(self):
        """Works out what follows from the orientations: vertices, hulls, boxes, inertia."""
        shapes = self._shapes
        rotation = np.stack(rotation_matrices(self.orientation))
        self.invInertia = np.stack(rotate_tensor(rotation, self.restInvInertia))
        self.vertices = rotate_columns(rotation, shapes.vertices, shapes.vertexCount)
        corners = self.vertices
        if shapes.hullColumn is not None:
            corners = take(corners, shapes.hullColumn, axis=1) if corners.size else None
        self.hulls = shapes.hulls.rotated(rotation, corners)
        low, high = self.hulls.boxes()
        self._relativeBox = np.where(shapes.hasShape, np.concatenate((low, -high)), np.inf)
        self.box = self.box_at(np.arange(len(self.meshes)), self.position)

    def box_at(self, b, position):
        """The boxes of the bodies b (m,) at these positions (3, m), as in `box`."""
        return take(self._relativeBox, b, axis=1) + np.concatenate((position, -position))

    def state(self, b):
        """`BodyState` of body b, in floats."""
        return BodyState(
            float(self.invMass[b]), tuple(self.invInertia[:, b].tolist()),
            tuple(self.position[:, b].tolist()),
            tuple(self.linVelocity[:, b].tolist()), tuple(self.angVelocity[:, b].tolist()),
        )  # fmt: skip

    def states(self, b):
        """`BodyState` of the bodies b (m,), or of pairs of them (2, m), in arrays."""
        motion = take(self.motion, b, axis=1)
        return BodyState(
            take(self.invMass, b), take(self.invInertia, b, axis=1),
            motion[0:3], motion[3:6], motion[6:9],
        )  # fmt: skip

    def store(self, b, state):
        """Sets a body b, or bodies, to a `BodyState` that something has changed."""
        self.motion[:, b] = np.concatenate((state.position, state.linVelocity, state.angVelocity))

    def lowest_points(self):
        """`(b (m,), point (3, m))`: bodies that reach down to y = 0, and the lowest vertex of each.

        Of equally low ones, the first.
        """
        shapes = self._shapes
        # the hull's lowest corner; a vertex that is none may lie below it by rounding
        corner = self._relativeBox[1] + self.position[1]
        near = indices((corner <= FEATURE_TOLERANCE * self.hulls.radius) & ~self.isFixed)
        if len(near) == 0:
            return near, np.zeros((3, 0))
        count = shapes.vertexCount[near]
        row, column = ranges(shapes.vertexStart[near], count)
        heights = self.vertices[1][column] + self.position[1][near[row]]
        lowest, index = row_minima(heights, row, count.cumsum() - count)
        below = indices(lowest <= 0.0)
        b, vertex = near[below], column[index[below]]
        return b, take(self.vertices, vertex, axis=1) + take(self.position, b, axis=1)

    def arm(self, b, vertex):
        """From the COM of body b to a vertex of it, world axes: tuple of 3."""
        return tuple(self.vertices[:, self.vertexStart[b] + vertex].tolist())

    @contextmanager
    def in_tables(self):
        """Yields these bodies; see `MeshStates`."""
        yield self

    def write_back(self):
        """Gives the meshes their rows of the step's tables; fixed ones keep what they had."""
        self.motion = np.where(self.isFixed, self._gathered, self.motion)
        tables = {
            name: np.ascontiguousarray(getattr(self, name).T)[:, None] for name in STATE_SHAPES
        }
        self._shapes.state.scatter(self.meshes, tables)


class MeshStates:
    """Meshes as constraints see them one at a time: what `Bodies` has, without tables."""

    def __init__(self, meshes):
        self.meshes = meshes

    @property
    def isFixed(self):
        return np.array([m.isFixed for m in self.meshes], dtype=bool)

    @property
    def vertexCount(self):
        return np.array([len(m.origVertices) for m in self.meshes], dtype=np.intp)

    def state(self, b):
        return self.meshes[b].body_state()

    def store(self, b, state):
        self.meshes[b].set_body_state(state)

    def arm(self, b, vertex):
        return tuple(self.meshes[b].pose().rotated.vertices[:, vertex].tolist())

    @contextmanager
    def in_tables(self):
        """Yields the `Bodies`, and gives the meshes what has become of them."""
        bodies = Bodies(self.meshes)
        bodies.follow_orientations()
        yield bodies
        bodies.write_back()
