"""What a `Mesh` has beyond the coursework: checks, snapshots, its row in a table, loads."""

from __future__ import annotations

import itertools
import math
import numbers
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from Quaternion import rotation_matrices
from rbs.geometry import triples
from rbs.geometry.hulls import FEATURE_TOLERANCE, rotate_columns
from rbs.geometry.triples import ZERO, floats, mul_add, number, row, shown_value, vector
from rbs.stepping.settings import EARTH, as_numbers

# Largest number allowed in a state, in any unit. Products of four such numbers are still finite.
LARGEST_NUMBER = 1e75

# Attributes that form the state of a mesh, and how many numbers each has.
STATE_WIDTHS = {"position": 3, "orientation": 4, "linVelocity": 3, "angVelocity": 3}
_state = attrgetter(*STATE_WIDTHS)


class StateError(ArithmeticError):
    """A step would give a body a number that is NaN, infinite or beyond LARGEST_NUMBER."""


def check_states(meshes, when):
    """Raises StateError, as `Snapshot.check`, if a number in the state of meshes is invalid."""
    values = [value for mesh in meshes for value in _state(mesh)]
    try:
        table = np.concatenate(values, axis=1)
    except ValueError:  # slow path: different shapes, or no mesh
        table = np.concatenate([np.zeros(1), *values], axis=None)
    sizes = np.abs(table)
    if not sizes.item(sizes.argmax()) <= LARGEST_NUMBER:  # also for NaN; faster than max
        Snapshot.of(meshes).check(meshes, when)


def check_distinct(meshes):
    """Raises ValueError if a mesh is listed twice, because it cannot collide with itself."""
    if len({id(mesh) for mesh in meshes}) < len(meshes):
        twice = next(k for k, mesh in enumerate(meshes) if any(mesh is m for m in meshes[:k]))
        raise ValueError(f"mesh {twice}, {meshes[twice].name!r}, is listed twice")


def check_methods(meshes, Mesh):
    """Raises ValueError if a step on arrays would ignore a method that a subclass overrides."""
    for kind in dict.fromkeys(map(type, meshes)):
        for base in itertools.takewhile(lambda base: base is not Mesh, kind.__mro__):
            for name in vars(base):
                if hasattr(Mesh, name) and not name.startswith("_"):
                    raise ValueError(f"{kind.__name__}.{name} would not be called on arrays")


class Snapshot(dict):
    """The state of a list of meshes at one moment: tables (w, n), by name in STATE_WIDTHS.

    Nothing modifies them, so that a snapshot may be kept.
    """

    @classmethod
    def of(cls, meshes):
        """Returns the present state of meshes, ours or a student's."""
        table = table_of(meshes)
        if table is not None:
            return table.snapshot()
        return cls({name: columns_of(meshes, name) for name in STATE_WIDTHS})

    def check(self, meshes, when):
        """Raises StateError, which names the body, if a number is NaN, infinite or too large.

        when : what the step has just done
        """
        for name, table in self.items():
            isFine = abs(table) <= LARGEST_NUMBER  # false for NaN
            if not isFine.all():
                b = int(isFine.all(axis=0).argmin())
                told = f"{name} holds {float(table[~isFine[:, b], b][0]):g} after {when}"
                raise StateError(f"body {b}, {meshes[b].name!r}: {told}")

    def check_start(self, meshes):
        """Raises StateError or ValueError, which names the body, if no step can begin here."""
        self.check(meshes, "the last step")
        isTurn = (self["orientation"] ** 2).sum(axis=0) > 0.0
        if not isTurn.all():
            b = int(isTurn.argmin())
            raise ValueError(f"body {b}, {meshes[b].name!r}: the orientation is zero")

    def restore(self, meshes):
        """Puts the meshes into this state."""
        for name, columns in self.items():
            for mesh, value in zip(meshes, columns.T[:, None].copy(), strict=True):
                setattr(mesh, name, value)


def bytes_of(numbers):
    """Returns the bytes of an array, or of what somebody has assigned in its place."""
    try:
        return numbers.tobytes()
    except AttributeError:
        return np.array(numbers, dtype=np.float64).tobytes()


def columns_of(meshes, name, some=None):
    """Returns an attribute of STATE_WIDTHS as a new table (width, n), of all meshes, or of some by
    index. Raises ValueError, which names the body.
    """
    width = STATE_WIDTHS[name]
    values = list(map(attrgetter(name), meshes if some is None else [meshes[b] for b in some]))
    try:
        table = np.concatenate(values)
    except ValueError:  # different shapes, or no mesh
        table = np.zeros(0)
    if table.shape != (len(values), width):
        table = np.zeros((len(values), width))
        some = range(len(meshes)) if some is None else some
        for row, b, value in zip(table, some, values, strict=True):
            try:
                row[:] = floats(as_numbers(value), width)
            except (TypeError, ValueError, OverflowError):
                what = f"{name} must be {width} numbers, not {shown_value(value)}"
                raise ValueError(f"body {b}, {meshes[b].name!r}: {what}") from None
    return np.ascontiguousarray(table.T, dtype=np.float64)


def table_of(meshes):
    """Returns the `Bodies` that has the state of exactly these meshes, in this order, or None."""
    table = getattr(meshes[0], "_table", None) if len(meshes) else None
    isTheirs = table is not None and not table.isLeft and table.meshes == tuple(meshes)
    return table if isTheirs else None


class TableRow:
    """Descriptor of a `Mesh`'s attribute: its own value, once it is read or assigned, or its row of
    the last step's `Bodies`.
    """

    def __set_name__(self, kind, name):
        self._name = name

    if TYPE_CHECKING:

        def __set__(self, mesh: Any, value: ArrayLike) -> None: ...

    def __get__(self, mesh: Any, kind: Any = None) -> np.ndarray:
        if mesh is None:
            return self
        vars(mesh)[self._name] = value = mesh._table.row(self._name, mesh._row)
        return value


# Difference of two entries of an inertia tensor that are equal but for rounding, relative to the
# largest. With less, what other programs print to nine digits is refused.
INERTIA_ROUNDING = 1e-8


def checked(name: str, count: int, width: int) -> Any:
    """Returns a property that keeps what is assigned to it, in any shape, as finite numbers (count,
    width), or as one float ≥ 0 if the width is 1. An assignment of anything else raises ValueError.
    """

    def assign(mesh, value):
        numbers = mesh._numbers(name, value, width, count)
        if width == 1:
            numbers = numbers.item() + 0.0  # not -0.0
            if numbers < 0.0:
                raise ValueError(f"mesh {mesh.name}: {name} must be 0 or more, not {numbers}")
        elif numbers.any() and not is_inertia(numbers):
            what = "symmetric and positive definite, or 0"
            raise ValueError(f"mesh {mesh.name}: {name} must be {what}, not {shown_value(value)}")
        setattr(mesh, f"_{name}", numbers)
        mesh._tell_table("isOutdated")

    return property(attrgetter(f"_{name}"), assign)


def is_inertia(tensor):
    """Returns whether a tensor (3, 3) is symmetric, up to rounding, and positive definite."""
    isSymmetric = np.abs(tensor - tensor.T).max() <= INERTIA_ROUNDING * np.abs(tensor).max()
    return bool(isSymmetric and np.linalg.eigvalsh(tensor)[0] > 0.0)


def checked_numbers(what, value, width, count=None, dtype=np.float64):
    """Returns finite numbers as a new array (count or n, width). Raises ValueError."""
    try:
        array = as_numbers(value)
        if count or array.size == 0:
            array = array.reshape(count or 0, width)
    except (TypeError, ValueError, OverflowError):
        array = np.array(np.nan)
    isFitting = array.ndim == 2 and array.shape[1] == width and np.isfinite(array).all()
    if not isFitting or (array != array.astype(dtype)).any():
        kind = "finite" if dtype is np.float64 else "whole"
        rows = {None: "rows of ", 1: ""}.get(count, f"{count} rows of ")
        size = "a" if count == width == 1 else f"{rows}{width}"
        kind = f"{size} {kind} number{'s' * (width > 1)}"
        raise ValueError(f"{what} must be {kind}, not {shown_value(value)}")
    return array.astype(dtype)


def checked_count(value, name, low=0, high=math.inf):
    """Returns a whole number from low to high as an int. Raises ValueError, naming it."""
    if not isinstance(value, numbers.Integral) or isinstance(value, bool):
        raise ValueError(f"{name} must be a whole number, not {shown_value(value)}")
    if not low <= value <= high:
        bound = f"{low} or more" if high == math.inf else f"{low} to {high}"
        raise ValueError(f"{name} must be {bound}, not {value}")
    return int(value)


class MeshTools:
    """The methods of `Mesh` that the coursework's step does not need."""

    position, orientation, linVelocity, angVelocity = (TableRow() for _ in range(4))
    invMass, IT, invIT = checked("invMass", 1, 1), checked("IT", 3, 3), checked("invIT", 3, 3)
    # read-only, because others follow from them
    origVertices, faces, tets, density, mass, volume, hullVolume, hull = (
        property(attrgetter(f"_{name}"))
        for name in "origVertices faces tets density mass volume hullVolume hull".split()
    )

    def __getstate__(self):
        """Returns the attributes for a copy, which has no table."""
        return {name: getattr(self, name) for name in STATE_WIDTHS} | vars(self) | {"_table": None}

    def __repr__(self):
        x, y, z = vector(self.position)
        mass = "fixed" if self.isFixed else f"{self.mass:.4g} kg"
        where = f"({x:.4g}, {y:.4g}, {z:.4g})"
        return f"Mesh({self.name!r}, {len(self.origVertices)} vertices, {mass}, at {where})"

    def _numbers(self, what, value, width, count=None, dtype=np.float64):
        return checked_numbers(f"mesh {self.name}: {what}", value, width, count, dtype)

    def _flag(self, what, value):
        if np.ndim(value) or value not in (True, False):
            told = f"{what} must be True or False, not {shown_value(value)}"
            raise ValueError(f"mesh {self.name}: {told}")
        return value

    def set_force(self, force: ArrayLike, torque: ArrayLike = ZERO) -> None:
        """Lets a force (3,) and a torque (3,) act at the COM from now on, in N and N m with metres,
        in world axes. They replace earlier ones.
        """
        force, torque = self._numbers("force", force, 3, 1), self._numbers("torque", torque, 3, 1)
        self.load = force[0], torque[0]

    @property
    def load(self) -> tuple | None:
        """The force and the torque of `set_force`, or None if both are zero."""
        return self._load

    @load.setter
    def load(self, value: ArrayLike | None) -> None:
        if value is not None:
            force, torque = self._numbers("load", value, 3, 2).tolist()
            value = (tuple(force), tuple(torque)) if any(force + torque) else None
        self._load = value
        self._tell_table("isOutdated")

    def _tell_table(self, what: str) -> None:
        """Sets a flag of the `Bodies` that has the state, if any: isLeft or isOutdated."""
        if self._table is not None:
            setattr(self._table, what, True)

    def apply_torque(self, timeStep: float, gravity: tuple) -> tuple:
        """Applies the torque for timeStep seconds: ω ← ω + R I⁻¹ Rᵀ τ h. A fixed mesh stays.

        Returns g + F / m, the acceleration by gravity and the force.
        """
        force, torque = self.load
        response = triples.mat_vec(floats(self.get_rotated_inv_IT(), 9), torque)
        self.angVelocity = row(mul_add(vector(self.angVelocity), number(timeStep), response))
        return mul_add(gravity, self.invMass, force)

    def follow_velocity(self, timeStep: float) -> None:
        """Moves a fixed mesh by the velocity that it has been given, if any."""
        if vector(self.linVelocity) != ZERO or vector(self.angVelocity) != ZERO:
            self._integrate(number(timeStep), ZERO)

    def integrate_tumbling(self, timeStep: float, gravity: tuple = EARTH) -> None:
        """`integrate_timestep` with constant angular momentum; see `torque_free_velocities`."""
        if not self.isFixed:
            from rbs.stepping.flight import torque_free_velocities

            state = vector(self.angVelocity), floats(self.orientation, 4)
            tensors = floats(self.IT, 9), floats(self.invIT, 9)
            mean, end = torque_free_velocities(*state, *tensors, number(timeStep))
            self.angVelocity = row(mean)
            self.integrate_timestep(timeStep, gravity)
            self.angVelocity = row(end)

    def push(self, impulse: ArrayLike, point: ArrayLike) -> None:
        """Applies an impulse (3,), mass · speed, at a world point (3,), unless the mesh is fixed.

        With r from the COM to the point, v ← v + J / m and ω ← ω + R I⁻¹ Rᵀ (r × J).
        """
        J = vector(self._numbers("impulse", impulse, 3, 1))
        arm = triples.sub(vector(self._numbers("point", point, 3, 1)), vector(self.position))
        response = triples.mat_vec(floats(self.get_rotated_inv_IT(), 9), triples.cross(arm, J))
        self.linVelocity = row(mul_add(vector(self.linVelocity), self.invMass, J))
        self.angVelocity = row(triples.add(vector(self.angVelocity), response))

    def pose(self) -> bytes:
        """Returns the bytes of position and orientation, which differ after a change in place."""
        return bytes_of(self.position) + bytes_of(self.orientation)

    def vertex_at(self, point: ArrayLike) -> int:
        """Returns the index of the rest vertex at a point (3,), relative to the COM.

        If there is none, the point becomes the last one. Raises ValueError as `own_point`.
        """
        point = self._numbers("point", point, 3, 1)
        found = (self.origVertices == point).all(axis=1).nonzero()[0].tolist()
        if found:
            return found[0]
        self.keep_vertices(np.concatenate([self.origVertices, self.own_point(point)]))
        return len(self.origVertices) - 1

    def own_point(self, point: ArrayLike) -> np.ndarray:
        """Returns a point (3,), relative to the COM, as (1, 3). Raises ValueError outside."""
        point = self._numbers("point", point, 3, 1)
        above = (self.hull.directions @ point[0] - self.hull.offsets).max()
        if above > FEATURE_TOLERANCE * self.hull.radius:
            raise ValueError(f"mesh {self.name}: the point lies {above:.3g} outside")
        return point

    def keep_vertices(self, vertices: np.ndarray) -> None:
        """Replaces the rest vertices by others, which `vertex_at` has added to or not yet."""
        vertices.flags.writeable = False
        self._origVertices = vertices
        self._rotatedHull = self._currVertices = None, None
        _state(self)  # takes the state from the table, which has the old vertices
        self._tell_table("isLeft")
        self._table = None


def refresh_vertices(meshes):
    """Returns all currVertices (ΣV, 3), read-only, and computes outdated ones together."""
    poses = [m.pose() for m in meshes]
    stale = [k for k, m in enumerate(meshes) if m._currVertices[0] != poses[k]]
    if stale:
        some = [meshes[k] for k in stale]
        counts = np.array([len(m.origVertices) for m in some])
        columns = Snapshot.of(some)
        rotation = np.stack(rotation_matrices(columns["orientation"]))
        rest = np.concatenate([m.origVertices for m in some]).T
        vertices = rotate_columns(rotation, rest, counts)
        vertices = np.ascontiguousarray((vertices + columns["position"].repeat(counts, axis=1)).T)
        vertices.flags.writeable = False
        for k, part in zip(stale, np.split(vertices, counts.cumsum()[:-1]), strict=True):
            meshes[k]._currVertices = poses[k], part
        if len(stale) == len(meshes):
            return vertices
    return np.concatenate([np.empty((0, 3)), *(m._currVertices[1] for m in meshes)])
