"""`State`, a moment of a run to go back to, and the numbers of its bodies as rows.

Units: metres, kilograms, seconds.
"""

from __future__ import annotations

import numpy as np

from rbs.glass.trace import differs
from rbs.stepping.meshes import STATE_WIDTHS, Snapshot, inertias_of, set_inertia

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
            try:
                row[:] = np.ravel(mesh.load)
            except ValueError:
                what = "load must be a force and a torque, of 3 numbers each"
                raise ValueError(f"mesh {mesh.name}: {what}") from None
    columns = [table.T for table in Snapshot.of(meshes).values()]
    return np.concatenate([*columns, inertias_of(meshes), loads], axis=1)


def set_numbers(meshes, rows):
    """Gives meshes their rows of `rows_of`, but for what has the same bits already."""
    isOther = differing_bits(rows, rows_of(meshes))
    for b in np.flatnonzero(isOther.any(axis=1)).tolist():
        for name, columns in zip(STATE_WIDTHS, COLUMNS.values(), strict=True):
            if isOther[b, columns].any():
                setattr(meshes[b], name, rows[b : b + 1, columns].copy())
        if isOther[b, INERTIA].any():
            set_inertia(meshes[b], rows[b, INERTIA])
        if isOther[b, LOAD].any():
            force, torque = map(tuple, rows[b, LOAD].reshape(2, 3).tolist())
            meshes[b].load = (force, torque) if any(force + torque) else None


def arrays_of(rows):
    """Returns the arrays of a `State`, by name, as views of rows (..., 38) of `rows_of`."""
    return {name: rows[..., columns] for name, columns in COLUMNS.items()}


def differing_bits(one, other):
    """Returns where two arrays of floats differ in any bit, bool of their shape."""
    one, other = np.ascontiguousarray(one), np.ascontiguousarray(other)
    return one.view(np.uint64) != other.view(np.uint64)
