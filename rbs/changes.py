"""What a user does to the bodies between two steps: `Change`, and changes as arrays for recordings.

A body is pushed, which dragging does with every step; fixed or freed; or added to the scene. A
change is made through `Simulation.change` only, so that what is done by hand can be recorded, and
done again to the last bit.

Units: metres, kilograms, seconds.
"""

from typing import NamedTuple

import numpy as np

from rbs.messages import short
from RBSFunctions import Mesh

# What can be done, in the order of the numbers that recordings have for it, and how many floats
# each takes: impulse and point; 1 to fix, 0 to free; density, position, orientation, velocities.
KIND_WIDTHS = {"push": 6, "fix": 1, "add": 14}
KINDS = tuple(KIND_WIDTHS)
# The parts of a shape: what numbers it holds, and how many a row.
SHAPE_PARTS = {"vertices": ("<f8", 3), "faces": ("<i8", 3), "tets": ("<i8", 4)}


class Shape(NamedTuple):
    """A body's shape: name; vertices (V, 3); faces (F, 3) and tets (T, 4), indices into them."""

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    tets: np.ndarray


class Change(NamedTuple):
    """One of KINDS, done to a body (its index) with some numbers; shape : of a body that is added.

    `push` gives an impulse (3,), in N s, at a point (3,) of the world.
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


def pack_changes(changes):
    """Changes as arrays for a recording: dict, {} of none. changes : list of (step, Change).

    `changes` (c, 3) has step, kind and body of each, `changeNumbers` (c, 14) its numbers, and
    `added.K.vertices`, `.faces`, `.tets` the shape of the added body K.
    """
    if not changes:
        return {}
    numbers = np.zeros((len(changes), max(KIND_WIDTHS.values())))
    arrays = {
        "changes": np.array([(step, KINDS.index(one.kind), one.body) for step, one in changes]),
        "changeNumbers": numbers,
    }
    for row, (_, one) in zip(numbers, changes, strict=True):
        row[: len(one.numbers)] = one.numbers
        if one.shape is not None:
            for part, (dtype, _) in SHAPE_PARTS.items():
                arrays[f"added.{one.body}.{part}"] = getattr(one.shape, part).astype(dtype)
    return arrays


def unpack_changes(arrays, names, first, last):
    """The list of (step, Change) that `pack_changes` made the arrays of.

    names : of all bodies, those that are added at the end; first, last : of the steps that a change
    may belong to. raises ValueError, which says what is wrong
    """
    rows, numbers = arrays.get("changes"), arrays.get("changeNumbers")
    if rows is None and numbers is None:
        return []
    width = max(KIND_WIDTHS.values())
    if rows is None or numbers is None or rows.ndim != 2 or rows.shape[1] != 3:
        raise ValueError("not of three columns")
    if numbers.shape != (len(rows), width) or not np.isfinite(numbers).all():
        raise ValueError(f"without {width} finite numbers each")
    steps = rows[:, 0]
    if (np.diff(steps) < 0).any() or not ((first <= steps) & (steps <= last)).all():
        raise ValueError("not in the order of the steps")
    isAdded = rows[:, 1] == KINDS.index("add")
    count = len(names) - int(isAdded.sum())
    changes = []
    for (step, kind, body), values in zip(rows.tolist(), numbers.tolist(), strict=True):
        if not 0 <= kind < len(KINDS):
            raise ValueError(f"there is no kind {kind}")
        name, shape = KINDS[kind], None
        if body < 0 or not (body == count if name == "add" else body < count):
            raise ValueError(f"there is no body {short(str(body))} at step {step}")
        if name == "add":
            count += 1
            shape = _shape_of(arrays, body, names[body])
        changes.append((step, Change(name, body, tuple(values[: KIND_WIDTHS[name]]), shape)))
    return changes


def _shape_of(arrays, body, name):
    parts = []
    for part, (dtype, width) in SHAPE_PARTS.items():
        array = arrays.get(f"added.{body}.{part}")
        isRight = array is not None and array.dtype == np.dtype(dtype) and array.ndim == 2
        if not isRight or array.shape[1] != width or not np.isfinite(array).all():
            raise ValueError(f"the {part} of body {body} are missing or no such")
        parts.append(array)
    return Shape(name, *parts)


def body_count(changes, count, step):
    """How many bodies there are after a step. changes : list of (step, Change); count : at last"""
    return count - sum(one.kind == "add" and when > step for when, one in changes)


def initial_changes(changes, isStart):
    """What has to be done to a scene's bodies before they are put into a state of the run.

    changes : list of Change, all so far; isStart : whether the state is that before the first step,
    which pushes are part of
    """
    return [one for one in changes if isStart or one.kind != "push"]
