"""Bodies as arrays: what a step in tables reads and writes of thousands of meshes, in few arrays.

From the top: the state of meshes as arrays, and what is checked of it; free flight; `Bodies`, which
has a column a body for what follows from the orientations as well: rotated hulls, boxes, inverse
inertia in world axes.

The gyroscopic term is made implicit as in Catto: Numerical Methods. Game Developers Conference
2015.
"""

import math
import reprlib
from collections import deque
from contextlib import contextmanager
from functools import lru_cache
from itertools import repeat
from operator import attrgetter, is_

import numpy as np

from Quaternion import exponentials, multiply, rotation_matrices
from rbs.geometry import triples
from rbs.geometry.arrays import indices, ranges, row_minima, take
from rbs.geometry.hulls import FEATURE_TOLERANCE, NO_HULL, HullSet, rotate_columns
from rbs.geometry.vectors import rotate_tensor

# No number of a state may be larger: products of four of them are still finite, and nothing that
# is to be looked at is as far away or as fast.
LARGEST_NUMBER = 1e75

# The state of a mesh: how many numbers each attribute has.
STATE_WIDTHS = {"position": 3, "orientation": 4, "linVelocity": 3, "angVelocity": 3}


class StateError(ArithmeticError):
    """A step that would give a body a number that is NaN, infinite or beyond LARGEST_NUMBER."""


def check_numbers(columns, meshes, when):
    """Raises StateError, which names the body, where a number is NaN, infinite or too large.

    columns : as of `state_columns`
    when : what the step has just done, for the message
    """
    # NaN is the maximum of whatever holds it, and not less than anything
    if all(abs(table).max(initial=0.0) <= LARGEST_NUMBER for table in columns.values()):
        return
    for name, table in columns.items():
        isWrong = ~(abs(table) <= LARGEST_NUMBER)
        if isWrong.any():
            b = int(isWrong.any(axis=0).argmax())
            value = float(table[isWrong[:, b], b][0])
            raise StateError(f"body {b}, {meshes[b].name!r}: {name} holds {value:g} after {when}")


def check_distinct(meshes):
    """Raises ValueError where a mesh is in the list twice: it cannot collide with itself."""
    if len({id(mesh) for mesh in meshes}) < len(meshes):
        twice = next(k for k, mesh in enumerate(meshes) if any(mesh is m for m in meshes[:k]))
        raise ValueError(f"mesh {twice}, {meshes[twice].name!r}, is in the list twice")


def check_objects(groundMesh, solverState):
    """Raises TypeError unless each is None, or a Mesh and a SolverState."""
    for name, value, kind, attribute in (
        ("groundMesh", groundMesh, "Mesh", "invMass"),
        ("solverState", solverState, "SolverState", "begun"),
    ):
        if value is not None and not hasattr(value, attribute):
            raise TypeError(f"{name} must be a {kind} or None, not {reprlib.repr(value)}")


@contextmanager
def named_faults(meshes):
    """Within it, an error from an attribute of a mesh becomes a ValueError that names both."""
    try:
        yield
    except (AttributeError, TypeError, ValueError):
        if not isinstance(meshes, list | tuple):
            raise TypeError(f"meshes must be a list of Mesh, not {reprlib.repr(meshes)}") from None
        for b, mesh in enumerate(meshes):
            for name, width in STATE_WIDTHS.items():
                try:
                    triples.floats(getattr(mesh, name), width)
                except AttributeError:
                    raise TypeError(f"meshes[{b}] must be a Mesh, not {mesh!r}") from None
                except (TypeError, ValueError):
                    value = reprlib.repr(getattr(mesh, name))
                    raise ValueError(
                        f"body {b}, {mesh.name!r}: {name} must be {width} numbers, not {value}"
                    ) from None
        raise


def state_columns(meshes):
    """The state of meshes as arrays: dict, of each name in STATE_WIDTHS a table (w, n)."""
    return {name: _columns(meshes, name, width) for name, width in STATE_WIDTHS.items()}


def _columns(meshes, name, width):
    """An attribute of that many numbers, in any shape, of all meshes: a table (width, n)."""
    values = list(map(attrgetter(name), meshes))
    try:
        table = np.concatenate(values)
    except ValueError:  # shapes that differ, which takes twice as long; or no mesh
        table = np.concatenate([np.empty(0), *values], axis=None)
    return np.ascontiguousarray(table.reshape(-1, width).T, dtype=np.float64)


@contextmanager
def restored_on_error(meshes):
    """Within it, whatever is raised leaves the state of the meshes as it was at the beginning."""
    before = [[getattr(m, name).copy() for name in STATE_WIDTHS] for m in meshes]
    try:
        yield
    except BaseException:
        for mesh, state in zip(meshes, before, strict=True):
            for name, value in zip(STATE_WIDTHS, state, strict=True):
                setattr(mesh, name, value)
        raise


# --------------------------------------------------------------------------------------------------
# Free flight
# --------------------------------------------------------------------------------------------------

# Acceleration of free fall along y, m/s², and as a vector, the default of a step.
GRAVITY = -9.8
EARTH = (0.0, GRAVITY, 0.0)


def turned(orientation, angle):
    """exp(φ/2) ∘ q, of unit length: orientations (4, n) after turns by rotation vectors (3, n)."""
    rotation = exponentials((0.0, *(0.5 * angle)))
    w, x, y, z = multiply(rotation, orientation)
    return np.stack((w, x, y, z)) / np.sqrt(w * w + (x * x + y * y + z * z))


def gyroscopic_velocity(angVelocity, orientation, inertia, timeStep):
    """The angular velocity after timeStep seconds without torque, three components.

    inertia : nine entries, the tensor at rest about the COM; angVelocity in world axes. Components
    may be floats or arrays (n,): there are none but the four basic operations on them

    Euler's equation in body axes is I ω' + ω × I ω = 0. An explicit step gains energy and explodes
    for long bodies; the implicit one, f(ω) = I (ω - ω₀) + h ω × I ω = 0, only loses some. One step
    of Newton's method from ω₀, where f = h ω₀ × I ω₀ and
    f' = I + h ([ω₀]× I - [I ω₀]×), is enough: ω = ω₀ - f'⁻¹ f. The columns c_k of f' are
    I e_k + h (ω₀ × I e_k - (I ω₀) × e_k), and f' x = b is solved by Cramer's rule.
    """
    add, cross, dot, scale, sub = (
        triples.add,
        triples.cross,
        triples.dot,
        triples.scale,
        triples.sub,
    )
    rotation = rotation_matrices(orientation)
    omega = triples.mat_vec(triples.transpose(rotation), angVelocity)
    spin = triples.mat_vec(inertia, omega)
    b = scale(timeStep, cross(omega, spin))
    c0, c1, c2 = (
        add(column, scale(timeStep, sub(cross(omega, column), cross(spin, unit))))
        for column, unit in zip(
            (inertia[0::3], inertia[1::3], inertia[2::3]),
            ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
            strict=True,
        )
    )
    c12 = cross(c1, c2)
    determinant = dot(c0, c12)
    change = (
        dot(b, c12) / determinant,
        dot(c0, cross(b, c2)) / determinant,
        dot(c0, cross(c1, b)) / determinant,
    )
    return triples.mat_vec(rotation, sub(omega, change))


# --------------------------------------------------------------------------------------------------
# Bodies
# --------------------------------------------------------------------------------------------------


class _Shapes:
    """What never changes of a list of meshes: rest vertices and hulls, in tables.

    vertices : (3, ΣV), rest vertices of all meshes; body b has vertexStart[b] … of them
    hulls : HullSet at rest; a mesh without vertices has a point for a hull
    hullColumn : (ΣVh,), the columns in `vertices` of the hulls' vertices
    hasShape : (n,) bool
    given : dict, of each attribute that the last step has given rows `(table (n, …), rows)`
    """

    def __init__(self, meshes):
        check_distinct(meshes)
        self.vertexCount = np.array([len(m.origVertices) for m in meshes], dtype=np.intp)
        self.vertexStart = self.vertexCount.cumsum() - self.vertexCount
        self.hasShape = self.vertexCount > 0
        self.given = {}
        # a column more, for what has no vertices and has to have a point
        vertices = [*(m.origVertices for m in meshes), np.zeros((1, 3))]
        self.vertices = np.ascontiguousarray(np.concatenate(vertices).T)
        hulls = [NO_HULL if m.hull is None else m.hull for m in meshes]
        self.hulls = HullSet(hulls)
        starts = self.vertexStart.tolist()
        self.hullColumn = np.concatenate(
            [hull.vertexIndex + start for hull, start in zip(hulls, starts, strict=True)]
        )


# The tables of the scenes at hand: making them costs more than a step of a small scene.
_shapes = lru_cache(maxsize=4)(_Shapes)


class Bodies:
    """The meshes of one step as arrays, one column a body.

    motion : (9, n); its parts are position, linVelocity, angVelocity, (3, n) each, the last two
        together velocity
    orientation : (4, n)
    invMass : (n,); invInertia : (9, n), world axes, row by row; both 0 of what is fixed
    box : (6, n), bounding boxes in the world when the orientations were last followed: least
        coordinates, then greatest ones negated. A mesh without vertices has none
    hulls : HullSet, rotated to the orientations
    gravity : three floats, the acceleration of free fall; fallRate, its magnitude
    vertices : (3, ΣV), all vertices, rotated, relative to their COMs; those of a body begin at
        vertexStart (n,), and it has vertexCount (n,) of them
    """

    def __init__(self, meshes, gravity=EARTH):
        """Gathers the state of at least one mesh. `fly` or `follow_orientations` has to follow
        before anything is asked that depends on the orientations."""
        self.meshes, self.gravity, self.fallRate = meshes, gravity, math.hypot(*gravity)
        self._shapes = _shapes(tuple(meshes))
        self.vertexStart = self._shapes.vertexStart
        self.vertexCount = self._shapes.vertexCount
        columns = {name: self._gathered(name, width) for name, width in STATE_WIDTHS.items()}
        self.motion = np.concatenate(
            (columns["position"], columns["linVelocity"], columns["angVelocity"])
        )
        self._start = self.motion.copy()
        self.orientation = columns["orientation"]
        self.invMass = np.array([m.invMass for m in meshes], dtype=np.float64)
        self.isFixed = self.invMass == 0.0
        self.restInvInertia = np.where(self.isFixed, 0.0, self._gathered("invIT", 9))

    position = property(lambda self: self.motion[0:3])
    velocity = property(lambda self: self.motion[3:9])
    linVelocity = property(lambda self: self.motion[3:6])
    angVelocity = property(lambda self: self.motion[6:9])

    def columns(self):
        """The state: dict, of each name in STATE_WIDTHS a table (w, n)."""
        return {name: getattr(self, name) for name in STATE_WIDTHS}

    def fly(self, timeStep):
        """Free flight of the bodies that are not fixed: `Mesh.integrate_timestep`."""
        linVelocity = self.linVelocity + timeStep * np.reshape(self.gravity, (3, 1))
        position = self.position + timeStep * linVelocity
        orientation = turned(self.orientation, timeStep * self.angVelocity)
        moved = np.concatenate((position, linVelocity, self.angVelocity))
        self.motion = np.where(self.isFixed, self.motion, moved)
        self.orientation = np.where(self.isFixed, self.orientation, orientation)
        self.follow_orientations()

    def turn_gyroscopically(self, timeStep):
        """Changes the angular velocities of free bodies as torque-free motion does."""
        inertia = np.where(self.isFixed, np.eye(3).reshape(9, 1), _columns(self.meshes, "IT", 9))
        after = gyroscopic_velocity(self.angVelocity, self.orientation, inertia, timeStep)
        self.motion[6:9] = np.where(self.isFixed, self.angVelocity, after)

    def follow_orientations(self):
        """Works out what follows from the orientations: vertices, hulls, boxes, inertia."""
        shapes = self._shapes
        rotation = np.stack(rotation_matrices(self.orientation))
        self.invInertia = np.stack(rotate_tensor(rotation, self.restInvInertia))
        self.vertices = rotate_columns(rotation, shapes.vertices[:, :-1], shapes.vertexCount)
        corners = np.concatenate((self.vertices, shapes.vertices[:, -1:]), axis=1)
        self.hulls = shapes.hulls.rotated(rotation, take(corners, shapes.hullColumn, axis=1))
        low, high = self.hulls.boxes()
        self._relativeBox = np.where(shapes.hasShape, np.concatenate((low, -high)), np.inf)
        self.box = self.box_at(np.arange(len(self.meshes)), self.position)

    def box_at(self, b, position):
        """The boxes of the bodies b (m,) at these positions (3, m), as in `box`."""
        return take(self._relativeBox, b, axis=1) + np.concatenate((position, -position))

    def lowest_points(self):
        """`(b (m,), point (3, m))`: bodies that reach down to y = 0, and the lowest vertex of each.

        Of equally low ones, the first.
        """
        # the hull's lowest corner; a vertex that is none may lie below it by rounding
        corner = self._relativeBox[1] + self.position[1]
        near = indices((corner <= FEATURE_TOLERANCE * self.hulls.radius) & ~self.isFixed)
        if len(near) == 0:
            return near, np.zeros((3, 0))
        count = self.vertexCount[near]
        row, column = ranges(self.vertexStart[near], count)
        heights = self.vertices[1][column] + self.position[1][near[row]]
        lowest, index = row_minima(heights, row, count.cumsum() - count)
        below = indices(lowest <= 0.0)
        b, vertex = near[below], column[index[below]]
        return b, take(self.vertices, vertex, axis=1) + take(self.position, b, axis=1)

    def _gathered(self, name, width):
        """An attribute of all meshes as a table (width, n).

        Where all of them still have the rows that a step has given them, the table is at hand, with
        all that has been written into the rows: to look takes half as long as to gather them.
        """
        table, rows = self._shapes.given.get(name, (None, ()))
        values = map(attrgetter(name), self.meshes)
        if table is None or not all(map(is_, values, rows)):
            table = self._give(name, _columns(self.meshes, name, width))
        return np.ascontiguousarray(table.reshape(-1, width).T)

    def _give(self, name, columns):
        """Makes rows of a new table (n, …) an attribute of the meshes; returns the table.

        A new one each step, so that what somebody has kept of the old rows stays as it was.
        """
        shape = (3, 3) if name == "invIT" else (1, len(columns))
        table = np.ascontiguousarray(columns.T).reshape(-1, *shape)
        rows = list(table)
        deque(map(setattr, self.meshes, repeat(name), rows), maxlen=0)  # in half a loop's time
        self._shapes.given[name] = table, rows
        return table

    def write_back(self):
        """Gives the meshes their rows of new tables; fixed ones keep what they had."""
        self.motion = np.where(self.isFixed, self._start, self.motion)
        for name, columns in self.columns().items():
            self._give(name, columns)
