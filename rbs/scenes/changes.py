"""What was done to the bodies between two steps, found by comparison, and how it is recorded.

Whatever way a body was pushed, moved, fixed, added, linked, or assigned to: `changes_since` finds
what that has made of its numbers, and of the lists of bodies and constraints, and `make_change`
repeats it bit for bit.

Units: metres, kilograms, seconds. Vectors are in world axes.
"""

from typing import NamedTuple

import numpy as np

from rbs.scenes.state import INERTIA, LOAD, differing_bits, rows_of, set_numbers
from RBSFunctions import Mesh

# The changes of a body's numbers, and the columns of `rows_of` that each sets.
COLUMNS_OF = {
    "inertia": INERTIA,
    "force": LOAD,
    "move": slice(0, 7),
    "velocity": slice(7, 13),
}


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

    Raises ValueError or TypeError, naming the body, if what was assigned is no such number.
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
