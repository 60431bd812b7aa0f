"""Makes steps of a scene, and single calls, by a student's functions."""

import inspect
from contextlib import suppress

import numpy as np

from rbs.program.submissions import CAUSE_LENGTH, FUNCTIONS, METHODS, built, describe
from rbs.scenes.messages import short

BUILT = ("origVertices", "invMass", "invIT")
# Relative, and in m: smaller differences between two states leave the student's vertices alone.
ROUNDING = 1e-12


class Scene:
    """The bodies of a scene and, as the last one, the ground, of the student's class.

    order : "bodies", a list of (name, vertices, faces, tets, density, position, orientation,
        isFixed); "names" of what is told of a mesh, the last "currVertices", which the released
        ground lacks
    """

    def __init__(self, order, functions, folder):
        self._functions, self._folder, self._names = functions, folder, order["names"]
        if not callable(getattr(functions, "Mesh", None)):
            raise AttributeError("RBSFunctions.py has no Mesh")
        self._meshes = [built(functions.Mesh, *one) for one in [*order["bodies"], ()]]

    def built(self):
        """What the constructors have computed, and the parameters of the functions."""
        *meshes, ground = self._meshes
        meshes = [{key: as_list(getattr(one, key, None)) for key in BUILT} for one in meshes]
        kind = type(ground)
        named = {"Mesh": kind.__init__}
        named |= {one: getattr(self._functions, one, None) for one in ("run_timestep", *FUNCTIONS)}
        named |= {one: getattr(kind, one, None) for one in METHODS}
        step = named["run_timestep"]
        parameters = inspect.signature(step).parameters if callable(step) else ()
        places = {name: place_of(function) for name, function in named.items()}
        return {"meshes": meshes, "places": places, "parameters": list(parameters)}

    def call(self, order):
        """Makes a call; returns "result", "problem", the "states" of its meshes after it, and
        "hasLists": whether lists are left in those that it is given.

        order : "function", its name; "meshes", by index; "states", rows of what is told of each;
            "given", a list of what else it is given; "options", its named arguments
        """
        name, meshes = order["function"], [self._meshes[k] for k in order["meshes"]]
        for mesh, rows in zip(meshes, order["states"], strict=True):
            self._follow(mesh, rows)
        result, problem = self._made(name, meshes, order["given"], order["options"])
        rows = [[getattr(one, key, None) for key in self._names] for one in meshes]
        hasLists = any(isinstance(one, list) for row in rows[name in METHODS :] for one in row[:-1])
        told = {"result": result, "problem": problem, "hasLists": hasLists}
        return told | {"states": [list(map(as_list, row)) for row in rows]}

    def _made(self, name, meshes, given, options):
        """Makes a call; returns its result, as JSON can hold it, and its error, or ""."""
        owner, first = self._functions, meshes
        if name == "run_timestep":
            first = meshes[:-1], meshes[-1]
        else:
            given = [as_given(one, pairs=not meshes) for one in given]
        if name in METHODS:
            owner, *first = meshes
        function = getattr(owner, name, None)
        if not callable(function):
            return None, "is not in RBSFunctions.py"
        try:
            with np.errstate(all="ignore"):
                return as_list(function(*first, *given, **options)), ""
        except BaseException as error:  # a student's function may raise anything
            return None, describe(error, self._folder)

    def _follow(self, mesh, rows):
        """Gives a mesh a state, in lists where it has lists; vertices only if it has moved."""
        hasMoved = False
        for name, given in zip(self._names[:-1], rows[:-1], strict=True):
            now, row = getattr(mesh, name, None), np.array(given, float)
            try:
                own = np.asarray(now, float).reshape(row.shape)
            except (TypeError, ValueError):  # the student's mistake in an earlier step
                own = np.full(row.shape, np.nan)
            if own.tobytes() != row.tobytes():
                isList, row = isinstance(now, list), row if row.ndim else given
                with suppress(AttributeError):  # of a property
                    setattr(mesh, name, row.reshape(np.shape(now)).tolist() if isList else row)
                hasMoved |= not np.abs(own - row).max() <= ROUNDING * (1.0 + np.abs(row).max())
        if hasMoved:
            with suppress(AttributeError):
                mesh.currVertices = np.array(rows[-1], float)


def place_of(function):
    code = getattr(inspect.unwrap(function), "__code__", None) if function else None
    return f"{code.co_filename.rpartition('/')[2]}:{code.co_firstlineno}" if code else ""


def as_given(value, pairs):
    """An argument in the shape that run_timestep gives it: a list of lists of rows is a pair."""
    if np.ndim(value) == 3 or pairs and np.ndim(value) == 1:
        return tuple(np.array(one, float) if np.ndim(one) else one for one in value)
    return np.array(value, float) if np.ndim(value) else value


def as_list(value):
    """A value as JSON can hold it: numbers, or a short text."""
    if value is None or isinstance(value, str | bool):
        return value
    try:
        array = np.array(value)
        return array.astype(float).tolist() if not np.iscomplexobj(array) else "complex"
    except (TypeError, ValueError):
        if isinstance(value, list | tuple):
            return [as_list(one) for one in value]
        return short(str(type(value).__name__), limit=CAUSE_LENGTH)
