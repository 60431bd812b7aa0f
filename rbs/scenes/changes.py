"""Changes that a user makes to the bodies between two steps, and how they are recorded.

A body can be pushed (dragging pushes it in every step), moved, fixed, freed, added, removed, put
under a constant force, or linked to another. All changes go through `SceneSimulation.change`, so
that they can be recorded and repeated bit for bit. `assigned` makes them of direct assignments.

Units: metres, kilograms, seconds. Vectors are in world axes.
"""

from functools import partial
from itertools import islice
from typing import NamedTuple

import numpy as np

from rbs.geometry.triples import shown_value
from rbs.scenes.state import differing_bits, rows_of
from rbs.stepping.meshes import checked_numbers, set_inertia
from RBSFunctions import Mesh

# The numbers of a change of each kind, in order: names, and how many there are of each.
NUMBERS = {
    "push": {"impulse": 3, "point": 3},
    "move": {"position": 3, "orientation": 4},  # which may be left out
    "velocity": {"linear": 3, "angular": 3},
    "force": {"force": 3, "torque": 3},  # which act until the next one
    "fix": {"isFixed": 1},
    "inertia": {"invMass": 1, "IT": 9, "invIT": 9},
    "add": {"density": 1, "position": 3, "orientation": 4, "linVelocity": 3, "angVelocity": 3},
    "remove": {},
    # another body, a point of each at rest, relative to its COM, and the bounds of their distance
    "link": {"other": 1, "point1": 3, "point2": 3, "lower": 1, "upper": 1},
}
# The columns of `rows_of` that a kind of change sets.
ASSIGNED = {
    "inertia": slice(13, 32),
    "force": slice(32, 38),
    "move": slice(0, 7),
    "velocity": slice(7, 13),
}


class Change(NamedTuple):
    """A change of one body.

    kind, numbers : see NUMBERS; also "constraints" with all rows of the new list, and "name" with a
        text
    body : its index
    shape : of a body that is added, else None: name, vertices (V, 3), and indices faces (F, 3) and
        tets (T, 4)
    """

    kind: str
    body: int
    numbers: tuple
    shape: tuple | None = None

    @property
    def isInState(self):
        """Whether it changes positions and velocities only."""
        return self.kind in ("push", "move", "velocity")

    @property
    def isOfOneBody(self):
        """Whether it changes nothing but numbers of a body that there is."""
        return self.isInState or self.kind in ("fix", "inertia", "force")

    def apply(self, meshes, constraints):
        """Applies it to the lists of a scene. Raises ValueError if that is impossible."""
        kind, body, numbers = self.kind, self.body, iter(self.numbers)
        parts = [list(islice(numbers, count)) for count in NUMBERS.get(kind, {}).values()]
        if kind == "push":
            meshes[body].push(*parts)
        elif kind == "move":
            meshes[body].position = np.array(parts[:1])
            if parts[1]:
                meshes[body].orientation = np.array(parts[1:])
        elif kind == "velocity":
            meshes[body].linVelocity, meshes[body].angVelocity = np.array(parts)[:, None]
        elif kind == "force":
            meshes[body].set_force(*parts)
        elif kind == "fix":
            meshes[body].isFixed = bool(*parts[0])
        elif kind == "inertia":
            set_inertia(meshes[body], self.numbers)
        elif kind == "name":
            (meshes[body].name,) = numbers
        elif kind == "add":
            meshes.append(Mesh(*self.shape, *parts[0], *parts[1:3], False))
            meshes[-1].linVelocity, meshes[-1].angVelocity = np.array(parts[3:])[:, None]
        elif kind == "remove":
            del meshes[body]
            constraints[:] = [
                [m1 - (m1 > body), v1, m2 - (m2 > body), v2, refValue, upper]
                for m1, v1, m2, v2, refValue, upper in constraints
                if body not in (m1, m2)
            ]
        elif kind == "link":
            (other,), point1, point2, *bounds = parts
            ends, kept = (meshes[body], meshes[int(other)]), meshes[body].origVertices
            v1 = ends[0].vertex_at(point1)
            try:
                v2 = ends[1].vertex_at(point2)
            except ValueError:
                ends[0].keep_vertices(kept)
                raise
            constraints += [
                [body, v1, int(other), v2, *bound, upper == 1] for upper, bound in enumerate(bounds)
            ]
        else:
            rows = zip(*[numbers] * 6, strict=True)
            constraints[:] = [[*map(int, row[:4]), row[4], bool(row[5])] for row in rows]


def change_of(kind, body, *vectors, shape=None):
    """Returns the Change of a body with some of NUMBERS. Raises ValueError, naming wrong ones."""
    pairs = zip(NUMBERS[kind].items(), vectors, strict=False)
    parts = [checked_numbers(name, vector, w, 1)[0].tolist() for (name, w), vector in pairs]
    if kind == "move" and parts[1:] and not any(parts[1]):
        raise ValueError("orientation must not be zero")
    return Change(kind, body, tuple(sum(parts, [])), shape)


# Functions of a body's index, and of what NUMBERS lists.
push, velocity, force, inertia, remove, link = (
    partial(change_of, kind) for kind in "push velocity force inertia remove link".split()
)


def move(body, position, orientation=None):
    """Returns the Change that moves a body to a position (3,), and an orientation (4,) if given."""
    return change_of("move", body, position, *([] if orientation is None else [orientation]))


def fix(body, isFixed):
    """Returns the Change that fixes or frees a body."""
    if not isinstance(isFixed, bool | np.bool_):
        raise ValueError(f"isFixed must be True or False, not {shown_value(isFixed)}")
    return Change("fix", body, (float(isFixed),))


def add(body, mesh):
    """Returns the Change that adds a copy of a Mesh with index `body`, with its velocity."""
    shape = mesh.name, *(part.copy() for part in (mesh.origVertices, mesh.faces, mesh.tets))
    state = mesh.position, mesh.orientation, mesh.linVelocity, mesh.angVelocity
    return change_of("add", body, mesh.density, *state, shape=shape)


def assigned(known, run):
    """Returns the Changes that lead from a State to the present one of the same bodies of a run.

    Raises ValueError if bodies were put into the list or taken from it, or if a number is wrong.
    """
    found, meshes = [], run.meshes
    if known.meshes != meshes:
        raise ValueError("bodies were added to `meshes`, or removed, without `add` or `remove`")
    constraints = [list(row) for row in run.constraints]
    if known.constraints != constraints:
        found.append(
            Change("constraints", -1, tuple(np.ravel(constraints).astype(np.float64).tolist()))
        )
    for b, (mesh, name) in enumerate(zip(meshes, known.names, strict=True)):
        if mesh.name != name:
            found.append(Change("name", b, (str(mesh.name),)))
    rows = rows_of(meshes)
    isOther = differing_bits(rows, known.rows)
    for b in np.flatnonzero(isOther.any(axis=1)).tolist():
        for kind, columns in ASSIGNED.items():
            if isOther[b, columns].any():
                ends = np.cumsum([*NUMBERS[kind].values()])[:-1]
                try:
                    found.append(change_of(kind, b, *np.split(rows[b, columns], ends)))
                except ValueError as error:
                    raise ValueError(f"body {b}, {meshes[b].name!r}: {error}") from None
    return found
