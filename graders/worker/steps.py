"""Makes steps of a scene by a student's functions, and tells each call with its numbers."""

import inspect
from functools import wraps

import numpy as np

from rbs.program.submissions import CAUSE_LENGTH, describe
from rbs.scenes.messages import short

STATE = ("position", "orientation", "linVelocity", "angVelocity")
STATES = (*STATE, "currVertices")  # the last of which the released ground lacks
BUILT = ("origVertices", "invMass", "invIT")
# The functions that are told, and how many values each returns.
METHODS = {"integrate_timestep": 0, "detect_collision": 4, "get_rotated_inv_IT": 1}
FUNCTIONS = {"resolve_collision": 0, "resolve_position_constraint": 2}
FUNCTIONS["resolve_velocity_constraint"] = 3
# Relative, and in m: smaller differences between two states leave the student's vertices alone.
ROUNDING = 1e-12
TURN = np.array([[0.5, 0.1, -0.7, 0.5]])


class Scene:
    """The bodies of a scene, of the student's class.

    order : "bodies", a list of (name, vertices, faces, tets, density, position, orientation,
        isFixed); "options", keyword arguments of run_timestep, and those of resolve_collision
    """

    def __init__(self, order, functions, folder):
        self._functions, self._folder, self._calls = functions, folder, None
        nothing = np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros((0, 4), int)
        unturned = np.array([1.0, 0.0, 0.0, 0.0])
        made = functions.Mesh("ground", *nothing, 0.0, np.zeros((1, 3)), unturned, True)
        self._meshes, self._ground = [], made
        self._still = {name: getattr(made, name, None) for name in STATE}
        self._still = {name: np.array(value) for name, value in self._still.items()}
        for name, *shape, density, position, orientation, isFixed in order["bodies"]:
            kinds = zip(shape, (float, int, int), strict=True)
            shape = [np.array(rows, kind) for rows, kind in kinds]
            pose = np.array(position, float), np.array(orientation, float)
            self._meshes.append(functions.Mesh(name, *shape, density, *pose, isFixed))
        self._index = {id(one): k for k, one in enumerate([*self._meshes, made])}
        for owner, names in ((type(made), METHODS), (functions, FUNCTIONS)):
            for name in names:
                if hasattr(owner, name):
                    setattr(owner, name, self._watched(getattr(owner, name), name, names[name]))

    def built(self):
        """What the constructors have computed, and the parameters of the functions."""
        meshes = []
        for mesh in self._meshes:
            # in a turned pose, which tells R from its transpose
            before, mesh.orientation = mesh.orientation, TURN.copy()
            told = {name: as_list(getattr(mesh, name, None)) for name in BUILT}
            try:
                told["tensor"] = as_list(mesh.get_rotated_inv_IT())
            except Exception:  # told where it is needed
                told["tensor"] = None
            mesh.orientation = before
            meshes.append(told)
        self._calls = None
        places, parameters = {"Mesh": self._place(type(self._ground).__init__)}, {}
        for name in ("run_timestep", *FUNCTIONS):
            function = getattr(self._functions, name, None)
            if callable(function):
                places[name] = self._place(function)
                parameters[name] = list(inspect.signature(function).parameters)
        for name in METHODS:
            places[name] = self._place(getattr(type(self._ground), name, None))
        return {"meshes": meshes, "places": places, "parameters": parameters}

    def _place(self, function):
        code = getattr(inspect.unwrap(function), "__code__", None) if function else None
        return f"{code.co_filename.rpartition('/')[2]}:{code.co_firstlineno}" if code else ""

    def step(self, order):
        """Makes a step from the states in the order; returns the calls, and the states after it.

        order : "states", rows of STATE and the vertices for each mesh; "step",
            arguments of run_timestep; "options", its named ones; "isTold", whether calls are told
        """
        for mesh, rows in zip(self._meshes, order["states"], strict=True):
            self._follow(mesh, rows)
        for name, value in self._still.items():
            setattr(self._ground, name, value.copy())
        self._calls = [] if order["isTold"] else None
        timeStep, restitution, isEnforced, constraints = order["step"]
        scene = self._meshes, self._ground, timeStep, restitution, isEnforced, constraints
        problem = ""
        try:
            with np.errstate(all="ignore"):
                self._functions.run_timestep(*scene, **order["options"])
        except BaseException as error:  # a student's function may raise anything
            problem = describe(error, self._folder)
        calls, self._calls = self._calls, None
        told = {"calls": calls, "problem": problem}
        return told | {"states": self._states(range(len(self._meshes)), STATES)}

    def _follow(self, mesh, rows):
        """Gives a mesh a state, in lists where it has lists; vertices only if it has moved."""
        hasMoved = False
        for name, row in zip(STATES, rows, strict=True):
            now, row = getattr(mesh, name, None), np.array(row, float)
            if name == "currVertices":
                if hasMoved:
                    mesh.currVertices = row
                continue
            own = np.asarray(now, float).reshape(row.shape)
            if own.tobytes() != row.tobytes():
                isList = isinstance(now, list)
                setattr(mesh, name, row.reshape(np.shape(now)).tolist() if isList else row)
                hasMoved |= not np.allclose(own, row, rtol=ROUNDING, atol=ROUNDING)

    def _states(self, bodies, names):
        meshes = [*self._meshes, self._ground]
        return {k: [as_list(getattr(meshes[k], one, None)) for one in names] for k in bodies}

    def _watched(self, function, name, count):
        @wraps(function)
        def call(*given, **options):
            if self._calls is None:
                return function(*given, **options)
            bodies = [self._index[id(one)] for one in given if id(one) in self._index]
            if not bodies and count:  # constraints receive positions, which tell the bodies
                COMs = np.array([np.ravel(mesh.position) for mesh in self._meshes]).real
                near = (abs(COMs - np.ravel(one).real).sum(axis=1) for one in given[0])
                bodies = [int(one.argmin()) for one in near]
            others = [*given, *options.values()]
            told = {"name": name, "bodies": bodies, "before": self._states(bodies, STATES)}
            told["given"] = [as_list(one) for one in others if id(one) not in self._index]
            result = function(*given, **options)
            told["after"] = self._states(bodies, STATE)
            told["result"] = None
            if result is not None:
                values = [result] if count < 2 else list(result)
                told["result"] = [as_list(one) for one in values]
            told["lists"] = self._lists(bodies)
            self._calls.append(told)
            return result

        return call

    def _lists(self, bodies):
        """Attributes that are lists, where run_timestep may need arrays."""
        meshes = [*self._meshes, self._ground]
        found = ((one, meshes[k]) for k in bodies for one in STATE)
        return [one for one, mesh in found if isinstance(getattr(mesh, one, None), list)]


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
