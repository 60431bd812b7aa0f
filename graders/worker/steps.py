"""Makes steps of a scene, and single calls, by a student's functions."""

import inspect
from contextlib import suppress

import numpy as np

from rbs.program.submissions import CAUSE_LENGTH, FUNCTIONS, METHODS, built, describe
from rbs.scenes.messages import short

BUILT = ("origVertices", "invMass", "invIT")
FIXED = ("isFixed", "invMass")  # what no step changes
# Relative, and in m: smaller differences between two states leave the student's vertices alone.
ROUNDING = 1e-12


class Scene:
    """The bodies of a scene, of the student's class.

    order : "bodies", a list of (name, vertices, faces, tets, density, position, orientation,
        isFixed); "turn", the orientation in which tensors are told; "names" of a mesh's state, the
        last "currVertices", which the released ground lacks
    """

    def __init__(self, order, functions, folder):
        self._functions, self._folder, self._turn = functions, folder, order["turn"]
        if not callable(getattr(functions, "Mesh", None)):
            raise AttributeError("RBSFunctions.py has no Mesh")
        self._names = order["names"]
        self._meshes = [built(functions.Mesh, *one) for one in order["bodies"]]
        self._fixed = [{one: getattr(mesh, one, None) for one in FIXED} for mesh in self._meshes]
        self._ground = built(functions.Mesh)
        self._still = {name: getattr(self._ground, name, None) for name in self._names[:-1]}
        self._still = {name: np.array(value) for name, value in self._still.items()}

    def built(self):
        """What the constructors have computed, and the parameters of the functions."""
        meshes, kind = [], type(self._ground)
        for mesh in self._meshes:
            before, mesh.orientation = mesh.orientation, np.array(self._turn)
            told = {name: as_list(getattr(mesh, name, None)) for name in BUILT}
            try:
                told["tensor"] = as_list(mesh.get_rotated_inv_IT())
            except Exception:  # told where it is needed
                told["tensor"] = None
            mesh.orientation = before
            meshes.append(told)
        named = {"Mesh": kind.__init__}
        named |= {one: getattr(self._functions, one, None) for one in ("run_timestep", *FUNCTIONS)}
        named |= {one: getattr(kind, one, None) for one in METHODS}
        self._step = named["run_timestep"]
        parameters = inspect.signature(self._step).parameters if callable(self._step) else ()
        places = {name: place_of(function) for name, function in named.items()}
        return {"meshes": meshes, "places": places, "parameters": list(parameters)}

    def step(self, order):
        """Makes a step from the states in the order; returns the states after it, and "changed",
        the name and the body of what has changed that no step changes, or None.

        order : "states", rows of these names for each mesh; "step", arguments of run_timestep;
            "options", its named ones
        """
        for mesh, rows in zip(self._meshes, order["states"], strict=True):
            self._follow(mesh, rows)
        self._rest()
        timeStep, restitution, isEnforced, constraints = order["step"]
        count = len(self._meshes)
        scene = self._meshes, self._ground, timeStep, restitution, isEnforced, constraints
        problem, bodies = self._problem(self._step, *scene, **order["options"])[1], range(count)
        told = {"problem": problem, "states": self._states(bodies)}
        return told | {"changed": self._changed(bodies)}

    def call(self, order):
        """Makes calls; returns of each "result", "problem", "states" of its bodies, "changed", and
        "hasLists": whether lists are left in these.

        order : "calls", lists of a function's name, its bodies, their states, and what else it is
            given, in lists; a body beyond the last is the ground
        """
        answers = []
        for name, bodies, states, given in order["calls"]:
            meshes = [[*self._meshes, self._ground][k] for k in bodies]
            self._rest()
            for mesh, rows in zip(meshes, states, strict=False):
                if mesh is not self._ground:
                    self._follow(mesh, rows)
            owner = meshes.pop(0) if name in METHODS else self._functions
            function = getattr(owner, name, None)
            given = [as_given(one, pairs=not bodies) for one in given]
            result, problem = self._problem(function, *meshes, *given)
            if isinstance(result, list | tuple):
                result = [as_list(one) for one in result]
            told = {"problem": problem, "result": as_list(result), "states": self._states(bodies)}
            told["changed"] = self._changed(bodies)
            state = [getattr(one, key, None) for one in meshes for key in self._names[:-1]]
            answers.append(told | {"hasLists": any(isinstance(one, list) for one in state)})
        return {"calls": answers}

    def _problem(self, function, *given, **options):
        if not callable(function):
            return None, "is not in RBSFunctions.py"
        try:
            with np.errstate(all="ignore"):
                return function(*given, **options), ""
        except BaseException as error:  # a student's function may raise anything
            return None, describe(error, self._folder)

    def _changed(self, bodies):
        """What has changed that no step changes, [name, body] or None; it is put back."""
        found = None
        for k in bodies:
            for name, value in self._fixed[k].items() if k < len(self._meshes) else ():
                if repr(as_list(getattr(self._meshes[k], name, None))) != repr(as_list(value)):
                    found = found or [name, k]
                    with suppress(AttributeError):  # of a property
                        setattr(self._meshes[k], name, value)
        return found

    def _rest(self):
        for name, value in self._still.items():
            setattr(self._ground, name, value.copy())

    def _states(self, bodies):
        meshes = [*self._meshes, self._ground]
        return [[as_list(getattr(meshes[k], one, None)) for one in self._names] for k in bodies]

    def _follow(self, mesh, rows):
        """Gives a mesh a state, in lists where it has lists; vertices only if it has moved."""
        hasMoved = False
        for name, row in zip(self._names[:-1], rows[:-1], strict=True):
            now, row = getattr(mesh, name, None), np.array(row, float)
            try:
                own = np.asarray(now, float).reshape(row.shape)
            except (TypeError, ValueError):  # the student's mistake in an earlier step
                own = np.full(row.shape, np.nan)
            if own.tobytes() != row.tobytes():
                isList = isinstance(now, list)
                setattr(mesh, name, row.reshape(np.shape(now)).tolist() if isList else row)
                hasMoved |= not np.abs(own - row).max() <= ROUNDING * (1.0 + np.abs(row).max())
        if hasMoved:
            with suppress(AttributeError):  # of a property
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
