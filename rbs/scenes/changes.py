"""Changes that a user makes to the bodies between two steps, and how they are recorded.

A body can be pushed (dragging pushes it in every step), moved, fixed, freed, added, removed, put
under a constant force, or linked to another. All changes go through `SceneSimulation.change`, so
that they can be recorded and repeated bit for bit.

Units: metres, kilograms, seconds.
"""

from contextlib import suppress
from typing import NamedTuple

import numpy as np

from rbs.scenes.messages import shown_value
from rbs.scenes.state import differing_rows, rows_of
from rbs.stepping.meshes import set_inertia
from RBSFunctions import Mesh


class Shape(NamedTuple):
    """A body's shape: name, vertices (V, 3), and indices faces (F, 3) and tets (T, 4)."""

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    tets: np.ndarray


class Change(NamedTuple):
    """A change of one body.

    kind, numbers : "push" with an impulse (3,) in N s and a point (3,) in world axes; "move" with
        a position (3,), which an orientation (4,) may follow; "velocity" with a linear and an
        angular velocity (3,); "fix" with 1 to fix and 0 to free; "inertia" with invMass, IT (9,)
        and invIT (9,); "add" with density, position, orientation and velocities; "remove" without
        any; "force" with a force (3,) in N and a torque (3,) in N m, in world axes, which act until
        the next one; "link" with the index of another body, a point (3,) of each at rest, relative
        to its COM, and the least and the greatest distance of the points; "constraints" with all
        rows of the new list; "name" with a text
    body : its index
    shape : of a body that is added, else None
    """

    kind: str
    body: int
    numbers: tuple
    shape: Shape | None = None

    @property
    def isInState(self):
        """Whether it changes positions and velocities only."""
        return self.kind in ("push", "move", "velocity")

    @property
    def isOfOneBody(self):
        """Whether it changes nothing but a body that there is."""
        return self.isInState or self.kind in ("fix", "inertia", "force")

    def apply(self, meshes, constraints):
        """Applies it to the lists of a scene. Raises ValueError if that is impossible."""
        numbers = self.numbers
        if self.kind == "add":
            meshes.append(self.added_mesh())
        elif self.kind == "remove":
            del meshes[self.body]
            constraints[:] = [
                [m1 - (m1 > self.body), v1, m2 - (m2 > self.body), v2, refValue, upper]
                for m1, v1, m2, v2, refValue, upper in constraints
                if self.body not in (m1, m2)
            ]
        elif self.kind == "link":
            m1, m2 = self.body, int(numbers[0])
            kept = meshes[m1].origVertices
            v1 = meshes[m1].vertex_at(numbers[1:4])
            try:
                v2 = meshes[m2].vertex_at(numbers[4:7])
            except ValueError:
                meshes[m1].keep_vertices(kept)
                raise
            constraints += [[m1, v1, m2, v2, numbers[7 + upper], upper] for upper in (False, True)]
        elif self.kind == "force":
            meshes[self.body].set_force(numbers[:3], numbers[3:])
        elif self.kind == "fix":
            meshes[self.body].isFixed = bool(numbers[0])
        elif self.kind == "inertia":
            set_inertia(meshes[self.body], numbers)
        elif self.kind == "move":
            meshes[self.body].position = np.array([numbers[:3]])
            if numbers[3:]:
                meshes[self.body].orientation = np.array([numbers[3:]])
        elif self.kind == "velocity":
            meshes[self.body].linVelocity = np.array([numbers[:3]])
            meshes[self.body].angVelocity = np.array([numbers[3:]])
        elif self.kind == "name":
            (meshes[self.body].name,) = numbers
        elif self.kind == "constraints":
            rows = zip(*[iter(numbers)] * 6, strict=True)
            constraints[:] = [[*map(int, row[:4]), row[4], bool(row[5])] for row in rows]
        else:
            meshes[self.body].push(numbers[:3], numbers[3:])

    def added_mesh(self):
        """Returns the body that it adds. Raises ValueError if its numbers make no body."""
        numbers = np.array(self.numbers)
        mesh = Mesh(*self.shape, numbers[0], numbers[1:4], numbers[4:8], False)
        with np.errstate(all="ignore"):
            inertia = np.linalg.inv(mesh.IT)
        if not (np.isfinite(mesh.IT).all() and np.isfinite(inertia).all()):
            raise ValueError(f"mesh {mesh.name}: its inertia is out of range")
        mesh.linVelocity, mesh.angVelocity = numbers[None, 8:11], numbers[None, 11:14]
        return mesh


def push(body, impulse, point):
    """Returns the Change that applies an impulse (3,) at a point (3,) in world axes."""
    return Change("push", body, (*checked("impulse", impulse), *checked("point", point)))


def move(body, position, orientation=None):
    """Returns the Change that moves a body to a position (3,), and an orientation (4,) if given."""
    turn = () if orientation is None else checked("orientation", orientation, 4)
    if not any(turn) and orientation is not None:
        raise ValueError("orientation must not be zero")
    return Change("move", body, (*checked("position", position), *turn))


def velocity(body, linear, angular):
    """Returns the Change that gives a body a linear and an angular velocity (3,)."""
    numbers = *checked("linear", linear), *checked("angular", angular)
    return Change("velocity", body, numbers)


def remove(body):
    """Returns the Change that removes a body and its constraints; later bodies move up."""
    return Change("remove", body, ())


def force(body, force, torque):
    """Returns the Change that lets a force (3,) and a torque (3,) act on a body from now on."""
    return Change("force", body, (*checked("force", force), *checked("torque", torque)))


def link(body1, point1, body2, point2, lower, upper):
    """Returns the Change that keeps the distance of two points between two bounds, in m.

    point1, point2 : (3,), of each body at rest, relative to its COM
    """
    points = float(body2), *_floats(point1), *_floats(point2)
    return Change("link", body1, (*points, float(lower), float(upper)))


def fix(body, isFixed):
    """Returns the Change that fixes or frees a body."""
    if not isinstance(isFixed, bool | np.bool_):
        raise ValueError(f"isFixed must be True or False, not {shown_value(isFixed)}")
    return Change("fix", body, (float(isFixed),))


def inertia(body, numbers):
    """Returns the Change that gives a body invMass, IT and invIT, a row (19,) of `inertias_of`."""
    return Change("inertia", body, tuple(_floats(numbers)))


def add(body, shape, density, position, linVelocity):
    """Returns the Change that adds a body with index `body` and no angular velocity."""
    pose = (*_floats(position), 1.0, 0.0, 0.0, 0.0)
    numbers = (float(density), *pose, *_floats(linVelocity), 0.0, 0.0, 0.0)
    return Change("add", body, numbers, shape)


def add_mesh(body, mesh):
    """Returns the Change that adds a copy of a Mesh with index `body`, with its velocity."""
    shape = Shape(mesh.name, *(part.copy() for part in (mesh.origVertices, mesh.faces, mesh.tets)))
    state = mesh.position, mesh.orientation, mesh.linVelocity, mesh.angVelocity
    numbers = (mesh.density, *(number for part in state for number in _floats(part)))
    return Change("add", body, numbers, shape)


def assigned(known, run, body=None):
    """Returns the Changes that lead from a State to the present one of the same bodies of a run.

    They are what was assigned directly, instead of by a Change. body : only those of this body
    Raises ValueError if bodies were put into the list or taken from it, or if a number is wrong.
    """
    found, meshes = [], run.meshes
    if body is None:
        if known.meshes != meshes:
            raise ValueError("bodies were added to `meshes`, or removed, without `add` or `remove`")
        rows = [list(row) for row in run.constraints]
        if known.constraints != rows:
            found.append(Change("constraints", -1, tuple(_floats(rows))))
        names = [mesh.name for mesh in meshes]
        if names != known.names:
            pairs = enumerate(zip(names, known.names, strict=True))
            found += [Change("name", b, (str(name),)) for b, (name, old) in pairs if name != old]
    some = None if body is None else [body]
    before, after = known.rows[some or slice(None)], rows_of(meshes, some)
    for k in differing_rows(before, after):
        b = k if body is None else body
        try:
            pairs = zip(_assignments(b, before[k]), _assignments(b, after[k]), strict=True)
        except ValueError as error:
            raise ValueError(f"body {b}, {meshes[b].name!r}: {error}") from None
        found += [new for old, new in pairs if repr(new) != repr(old)]  # it tells -0.0 from 0.0
    return found


def _assignments(body, row):
    """Returns the Changes that give a body all numbers of a row of `rows_of`."""
    position, orientation, linear, angular, own, acting, torque = np.split(
        row, np.cumsum([3, 4, 3, 3, 19, 3])
    )
    return [
        inertia(body, own),
        force(body, acting, torque),
        move(body, position, orientation),
        velocity(body, linear, angular),
    ]


def checked(name, vector, count=3):
    """Returns a vector as a list of floats. Raises ValueError, naming it."""
    with suppress(TypeError, ValueError):
        numbers = np.ravel(vector)
        isReal = numbers.dtype.kind in "fiub"
        if isReal and len(numbers) == count and np.isfinite(numbers).all():
            return _floats(numbers)
    what = f"{count} finite numbers" if count > 1 else "a finite number"
    raise ValueError(f"{name} must be {what}, not {shown_value(vector)}")


def _floats(vector):
    return np.ravel(vector).astype(np.float64).tolist()


def to_record(change):
    """Returns a Change as a dict that JSON keeps bit for bit. `from_record` is the inverse."""
    record = change._asdict()
    if change.shape is None:
        del record["shape"]
    else:
        vertices, faces, tets = (np.asarray(part).tolist() for part in change.shape[1:])
        record["shape"] = [change.shape.name, vertices, faces, tets]
    return record


def from_record(record):
    """Returns the Change of a dict by `to_record`. Raises KeyError, TypeError or ValueError."""
    shape = record.get("shape")
    if shape is not None:
        name, vertices, *indices = shape
        faces, tets = (np.array(part, dtype=np.int64) for part in indices)
        shape = Shape(name, np.array(vertices, dtype=np.float64), faces, tets)
    return Change(record["kind"], record["body"], tuple(record["numbers"]), shape)
