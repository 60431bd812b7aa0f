"""Moments of a run: `State`, to go back to; `Energies`; `Change`, what was done between two steps.

Whatever way a body was pushed, moved, fixed, added, linked, or assigned to: `changes_since` finds
what that has made of its numbers, and of the lists of bodies and constraints, and `make_change`
repeats it bit for bit.

Units: metres, kilograms, seconds. Vectors are in world axes.
"""

from __future__ import annotations

import math
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from Quaternion import QConj, QRotate
from rbs.glass.trace import differs
from rbs.stepping.meshes import STATE_WIDTHS, Snapshot
from RBSFunctions import Mesh, refresh_vertices

# The arrays of a state, and their columns in `rows_of`; the attribute of a body that each holds.
COLUMNS = {
    "positions": slice(0, 3),
    "orientations": slice(3, 7),
    "linVelocities": slice(7, 10),
    "angVelocities": slice(10, 13),
}
STATE_NAMES, STATE_WIDTH = dict(zip(COLUMNS, STATE_WIDTHS, strict=True)), 13
# The other columns.
INERTIA, LOAD = slice(13, 32), slice(32, 38)


class State(dict):
    """A moment of a run, to go back to; copies and pickles of it serve as well.

    A dict of positions (n, 3), orientations (n, 4), linVelocities and angVelocities (n, 3); if it
    is empty, the bodies stay where they are.
    Attributes: meshes, the bodies; rows, see `rows_of`, names and restVertices of them;
    constraints; settings, or None to keep those of the run; stepCount; time in s; report and
    stepSeconds of the last step, which copies lack; and of a simulation its solver and beside. In a
    copy, `meshes` has numbers in place of the bodies of the scene file.
    """

    solver = beside = None

    def __getstate__(self):
        """Returns the attributes of a copy."""
        number = {id(mesh): k for k, mesh in enumerate(self.sceneMeshes or [])}
        meshes = [number.get(id(mesh), mesh) for mesh in self.meshes]
        others = {"meshes": meshes, "sceneMeshes": None, "report": None, "stepSeconds": None}
        return vars(self) | others

    def is_like(self, other: State) -> bool:
        """Returns whether positions and velocities of two states agree up to rounding."""
        return not any(map(differs, self.values(), other.values()))


def rows_of(meshes):
    """Returns all numbers of n bodies that may be assigned and that a step reads, (n, 38).

    The columns are the state, `inertias_of`, and the force and the torque of `Mesh.load`. Raises
    ValueError, which names the body.
    """
    loads = np.zeros((len(meshes), 6))
    for row, mesh in zip(loads, meshes, strict=True):
        if mesh.load is not None:
            row[:] = np.reshape(mesh.load, 6)
    columns = [table.T for table in Snapshot.of(meshes).values()]
    return np.concatenate([*columns, inertias_of(meshes), loads], axis=1)


def inertias_of(meshes):
    """Returns invMass, which is 0 if fixed, IT and invIT of n meshes as rows (n, 19)."""
    rows = np.empty((len(meshes), 19))
    if len(meshes):
        rows[:, 0], *tensors = zip(*map(attrgetter("invMass", "IT", "invIT"), meshes), strict=True)
        for begin, these in zip((1, 10), tensors, strict=True):
            rows[:, begin : begin + 9] = np.concatenate(these).reshape(-1, 9)
    return rows


def set_inertia(mesh, numbers):
    """Gives a mesh a row (19,) of `inertias_of`."""
    numbers = np.asarray(numbers, dtype=np.float64)
    mesh.invMass, mesh.IT, mesh.invIT = numbers[0], *numbers[1:].reshape(2, 3, 3)


def set_numbers(meshes, rows):
    """Gives meshes their rows of `rows_of`, except numbers that have the same bits already."""
    isOther = differing_bits(rows, rows_of(meshes))
    for b in np.flatnonzero(isOther.any(axis=1)).tolist():
        for name, columns in zip(STATE_WIDTHS, COLUMNS.values(), strict=True):
            if isOther[b, columns].any():
                setattr(meshes[b], name, rows[b : b + 1, columns].copy())
        if isOther[b, INERTIA].any():
            set_inertia(meshes[b], rows[b, INERTIA])
        if isOther[b, LOAD].any():
            meshes[b].load = rows[b, LOAD].reshape(2, 3)


def arrays_of(rows):
    """Returns the arrays of a `State`, by name, as views of rows (..., 38) of `rows_of`."""
    return {name: rows[..., columns] for name, columns in COLUMNS.items()}


def differing_bits(one, other):
    """Returns where two arrays of floats differ in any bit, bool of their shape."""
    one, other = np.ascontiguousarray(one), np.ascontiguousarray(other)
    return one.view(np.uint64) != other.view(np.uint64)


class Energies:
    """The measures of a `Scene`."""

    def _free(self, name, *shape):
        """Returns an attribute of all m free bodies, (m, *shape)."""
        values = [getattr(mesh, name) for mesh in self.meshes if not mesh.isFixed]
        return np.array(values, dtype=np.float64).reshape(-1, *shape)

    def _spin(self):
        """Returns ω and I ω of the free bodies in body axes, (m, 3) each. I is IT."""
        spin = QRotate(QConj(self._free("orientation", 4)), self._free("angVelocity", 3))
        return spin, np.einsum("mij,mj->mi", self._free("IT", 3, 3), spin)

    def kinetic_energy(self) -> float:
        """Returns the kinetic energy of all free bodies, in J: ½ m v² + ½ ωᵀ I ω."""
        v, m, (spin, turned) = self._free("linVelocity", 3), self._free("mass", 1), self._spin()
        return float(0.5 * np.sum(m * v * v) + 0.5 * np.sum(spin * turned))

    def momentum(self) -> np.ndarray:
        """Returns the momentum (3,) of all free bodies, in kg m/s: m v."""
        return np.sum(self._free("mass", 1) * self._free("linVelocity", 3), axis=0)

    def angular_momentum(self) -> np.ndarray:
        """Returns Σ m r × v + R I Rᵀ ω (3,) of all free bodies, about the origin, in kg m²/s."""
        r, p = self._free("position", 3), self._free("mass", 1) * self._free("linVelocity", 3)
        spin = QRotate(self._free("orientation", 4), self._spin()[1])
        return np.sum(np.cross(r, p) + spin, axis=0)

    def potential_energy(self) -> float:
        """Returns the potential energy of all free bodies, zero at the origin, in J: −m g · r."""
        height = self._free("position", 3) @ np.array(self.settings.acceleration)
        return float(-np.sum(self._free("mass", 1) * height[:, None]))

    def largest_violation(self) -> float:
        """Returns the largest violation of a constraint, in m; 0 if none is violated."""
        if self.constraints:
            refresh_vertices(self.meshes)
        largest = 0.0
        for m1, v1, m2, v2, refValue, upper in self.constraints:
            distance = math.dist(self.meshes[m1].currVertices[v1], self.meshes[m2].currVertices[v2])
            largest = max(largest, distance - refValue if upper else refValue - distance)
        return largest


# The changes of a body's numbers, and the columns of `rows_of` that each sets.
COLUMNS_OF = {"inertia": INERTIA, "force": LOAD, "move": slice(0, 7), "velocity": slice(7, 13)}


class Change(NamedTuple):
    """A change of one body, or of the constraints.

    kind : of COLUMNS_OF; "name"; "points", rest vertices that a body gets for its constraints;
        "add", "remove"; or "constraints", with all rows of the new list
    body : its index, or -1
    numbers : the new numbers; of "add", the density and the pose of the body as it was made
    shape : of a body that is added, else None: name, vertices (V, 3), and indices faces (F, 3) and
        tets (T, 4)
    """

    kind: str
    body: int
    numbers: tuple = ()
    shape: tuple | None = None

    @property
    def isInState(self):
        """Whether it changes positions and velocities only."""
        return self.kind in ("move", "velocity")


def removed_from(before, after):
    """Returns the bodies that were taken from a list, one by one: the index of each in the list
    without those before. What is left stands at the beginning of `after`.
    """
    removed, kept = [], 0
    for mesh in before:
        if kept < len(after) and after[kept] is mesh:
            kept += 1
        else:
            removed.append(kept)
    return removed


def changes_since(known, run):
    """Returns the list of Changes that lead from a `State` to the present one of the same run.

    Raises ValueError or TypeError, naming the body, if something invalid was assigned.
    """
    meshes, removed = run.meshes, removed_from(known.meshes, run.meshes)
    found = [Change("remove", b) for b in removed]
    kept = len(known.meshes) - len(removed)
    place = {id(mesh): k for k, mesh in enumerate(known.meshes)}
    old = [place[id(mesh)] for mesh in meshes[:kept]]
    rows = rows_of(meshes)
    isOther = np.ones(rows.shape, dtype=bool)
    isOther[:kept] = differing_bits(rows[:kept], known.rows[old])
    names, counts = [known.names[b] for b in old], [len(known.restVertices[b]) for b in old]
    for mesh in meshes[kept:]:
        shape = str(mesh.name), mesh.givenVertices.copy(), mesh.faces.copy(), mesh.tets.copy()
        state = mesh.density, *np.ravel(mesh.position), *np.ravel(mesh.orientation)
        found.append(Change("add", len(names), tuple(map(float, state)), shape))
        names.append(mesh.name)
        counts.append(len(mesh.givenVertices))
    for b, (mesh, name, count) in enumerate(zip(meshes, names, counts, strict=True)):
        if mesh.name != name:
            found.append(Change("name", b, (str(mesh.name),)))
        if len(mesh.origVertices) != count:
            found.append(Change("points", b, tuple(mesh.origVertices[count:].ravel().tolist())))
    for b in np.flatnonzero(isOther.any(axis=1)).tolist():
        for kind, columns in COLUMNS_OF.items():
            if isOther[b, columns].any():
                found.append(Change(kind, b, tuple(rows[b, columns].tolist())))
    constraints = [list(row) for row in run.constraints]
    if removed or known.constraints != constraints:
        numbers = np.array(constraints, dtype=np.float64).ravel()
        found.append(Change("constraints", -1, tuple(numbers.tolist())))
    return found


def make_change(run, change):
    """Makes a `Change` of a run. Raises ValueError if it is of a kind that is not known."""
    kind, body, numbers, shape = change
    mesh = run.meshes[body] if 0 <= body < len(run.meshes) else None
    if kind == "add":
        pose = numbers[0], numbers[1:4], numbers[4:8], False
        run.meshes = [*run.meshes, Mesh(*shape, *pose)]
    elif kind == "remove":
        run.meshes = run.meshes[:body] + run.meshes[body + 1 :]
    elif kind == "constraints":
        rows = zip(*[iter(numbers)] * 6, strict=True)
        run.constraints = [[*map(int, row[:4]), row[4], bool(row[5])] for row in rows]
    elif kind == "name":
        (mesh.name,) = numbers
    elif kind == "points":
        points = np.reshape(numbers, (-1, 3))
        mesh.keep_vertices(np.concatenate([mesh.origVertices, points]))
    elif kind in COLUMNS_OF:
        row = rows_of([mesh])
        row[0, COLUMNS_OF[kind]] = numbers
        set_numbers([mesh], row)
    else:
        raise ValueError(f"a change that is not known, '{kind}'; another version recorded it")


def without_body(constraints, body):
    """Returns the constraints that are left when a body is removed, with the new indices."""
    return [
        [m1 - (m1 > body), v1, m2 - (m2 > body), v2, refValue, upper]
        for m1, v1, m2, v2, refValue, upper in constraints
        if body not in (m1, m2)
    ]
