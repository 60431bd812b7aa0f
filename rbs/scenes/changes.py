"""What a user does to the bodies between two steps: `Change`, and changes as text for recordings.

A body is pushed, which dragging does with every step; fixed or freed; or added to the scene. A
change is made through `Simulation.change` only, so that what is done by hand can be recorded, and
done again to the last bit.

Units: metres, kilograms, seconds.
"""

from typing import NamedTuple

import numpy as np

from RBSFunctions import Mesh


class Shape(NamedTuple):
    """A body's shape: name; vertices (V, 3); faces (F, 3) and tets (T, 4), indices into them."""

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    tets: np.ndarray


class Change(NamedTuple):
    """What is done to a body (its index) with some numbers; shape : of a body that is added.

    kind, numbers : "push" with an impulse (3,), in N s, and a point (3,) of the world; "fix" with
        1 to fix and 0 to free; "add" with density, position, orientation and velocities
    """

    kind: str
    body: int
    numbers: tuple
    shape: Shape | None = None

    def apply(self, meshes):
        """Does it to a list of Mesh; raises ValueError where it cannot be done."""
        if self.kind == "add":
            meshes.append(self._added_mesh())
        elif self.kind == "fix":
            meshes[self.body].isFixed = bool(self.numbers[0])
        else:
            meshes[self.body].push(self.numbers[:3], self.numbers[3:])

    def _added_mesh(self):
        numbers = np.array(self.numbers)
        mesh = Mesh(*self.shape, numbers[0], numbers[1:4], numbers[4:8], False)
        with np.errstate(all="ignore"):
            inertia = np.linalg.inv(mesh.IT)
        if not (np.isfinite(mesh.IT).all() and np.isfinite(inertia).all()):
            raise ValueError(f"mesh {mesh.name}: its inertia is beyond reckoning")
        mesh.linVelocity, mesh.angVelocity = numbers[None, 8:11], numbers[None, 11:14]
        return mesh


def push(body, impulse, point):
    """The Change that gives a body an impulse (3,) at a point (3,) of the world."""
    return Change("push", body, (*_floats(impulse), *_floats(point)))


def fix(body, isFixed):
    """The Change that fixes a body, or frees it."""
    return Change("fix", body, (float(isFixed),))


def add(body, shape, density, position, linVelocity):
    """The Change that adds a body, which will have the index `body`; it does not spin."""
    pose = (*_floats(position), 1.0, 0.0, 0.0, 0.0)
    numbers = (float(density), *pose, *_floats(linVelocity), 0.0, 0.0, 0.0)
    return Change("add", body, numbers, shape)


def _floats(vector):
    return np.ravel(vector).astype(np.float64).tolist()


def to_record(change):
    """A Change as a dict that JSON holds to the last bit; `from_record` takes it back."""
    record = change._asdict()
    if change.shape is None:
        del record["shape"]
    else:
        vertices, faces, tets = (np.asarray(part).tolist() for part in change.shape[1:])
        record["shape"] = [change.shape.name, vertices, faces, tets]
    return record


def from_record(record):
    """The Change that `to_record` made the dict of; raises KeyError, TypeError or ValueError."""
    shape = record.get("shape")
    if shape is not None:
        name, vertices, *indices = shape
        faces, tets = (np.array(part, dtype=np.int64) for part in indices)
        shape = Shape(name, np.array(vertices, dtype=np.float64), faces, tets)
    return Change(record["kind"], record["body"], tuple(record["numbers"]), shape)


def initial_changes(changes, isStart):
    """What has to be done to a scene's bodies before they are put into a state of the run.

    changes : list of Change, all so far; isStart : whether the state is that before the first step,
    which pushes are part of
    """
    return [one for one in changes if isStart or one.kind != "push"]
