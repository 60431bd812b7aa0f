"""Time steps by a student's functions, for --functions.

The program draws and records its own meshes. Each has a counterpart of the student's `Mesh` class,
which gets its state before a step and gives it back afterwards.
"""

import inspect
import re
from contextlib import suppress
from functools import cache, partial
from hashlib import sha256
from types import SimpleNamespace

import numpy as np

from Quaternion import QRotate
from rbs.glass.beside import TURN
from rbs.program.submissions import SubmissionError, describe, is_skipped, load_submission
from rbs.scenes.messages import print_error, short
from rbs.scenes.scenefiles import scene_rows
from rbs.stepping.meshes import STATE_WIDTHS, StateError
from rbs.stepping.settings import DEFAULTS_IN_STEP
from RBSFunctions import run_timestep

# The parameters of the coursework's run_timestep.
COURSEWORK_PARAMETERS = {
    name
    for name, one in inspect.signature(run_timestep).parameters.items()
    if one.kind is one.POSITIONAL_OR_KEYWORD
}
# What students call our `mu`.
FRICTION_NAME = re.compile("μ|mu|mu_?[ks]|.*fric.*", re.IGNORECASE)
# Relative, and in m: smaller differences between the two states leave the student's vertices alone.
# They come from other ways to normalise quaternions.
ROUNDING = 1e-12


class SubmittedSteps:
    """A student's run_timestep and Mesh, called in place of this project's.

    folder : of the student's modules, resolved; functions : their module RBSFunctions
    digest : of the Python files, also in subfolders, and of the parameters; recordings know the
        functions by it
    """

    def __init__(self, folder, parameters=None):
        """Raises SubmissionError if the modules cannot be loaded, or lack a function or parameter.

        parameters : of run_timestep, a dict, that the student has added
        """
        submission = load_submission(folder)
        for remark in submission.remarks:
            print_error(f"{submission.folder}: {remark}")
        self.folder, self.functions = submission.folder, submission.functions
        self._set, self._source = parameters or {}, None
        self.digest = self._digest()
        self._Mesh = self._function("Mesh")
        self._own = inspect.signature(self._function("run_timestep")).parameters
        self._friction = friction_name(self._own)
        if lacking := self._lacking(self._set):
            raise SubmissionError(f"--set: {lacking}")

    def again(self):
        """Loads the modules of the folder again. Raises SubmissionError."""
        return type(self)(self.folder, self._set)

    def _digest(self):
        digest = sha256()
        for file in sorted(one.relative_to(self.folder) for one in self.folder.rglob("*.py")):
            if not any(map(is_skipped, file.parts)):
                content = (self.folder / file).read_bytes()
                digest.update(file.as_posix().encode() + b"\0" + content + b"\0")
        for name, value in sorted(self._set.items()):
            digest.update(f"{name}={value!r}".encode())
        return digest.hexdigest()

    def _function(self, name):
        function = getattr(self.functions, name, None)
        if not callable(function):
            raise SubmissionError(f"{self.folder}: RBSFunctions.py has no {name}")
        return function

    def _takes(self, name):
        name = self._friction if name == "mu" else name
        takesAll = any(one.kind is one.VAR_KEYWORD for one in self._own.values())
        return takesAll or name in self._own or name in ("timeStep", "CRCoeff")

    def _lacking(self, names):
        for name in names:
            if not self._takes(name):
                parameters = f"has no parameter {name}, only {', '.join(self._own)}"
                return f"the run_timestep in {self.folder} {parameters}"
        return ""

    def lacking(self, settings):
        """Returns a line if run_timestep lacks the parameter of a setting that is used, or ""."""
        values = settings.arguments().items()
        return self._lacking(name for name, value in values if value != DEFAULTS_IN_STEP[name])

    def step(self, source, *scene, settings, observer=None, solverState=None, **limits):
        """Makes one step of the program's meshes in place.

        source : the SceneSource of the meshes; the rest as for `run_timestep`. Parameters that the
            coursework lacks are passed on only if they are not default. With an observer,
            `our_loop` makes the step.

        Raises StateError if the student's step raises, lacks a parameter, or gives an invalid
        state. The meshes then stay as they were.
        """
        meshes, _ground, timeStep, CRCoeff, isEnforced, constraints = scene
        if lacking := self.lacking(settings):
            raise StateError(lacking)
        options = limits | {"enforceConstraints": isEnforced, "constraints": constraints}
        for name, value in settings.arguments().items():
            if name not in COURSEWORK_PARAMETERS and value != DEFAULTS_IN_STEP[name]:
                options[name] = value
        options = {name: value for name, value in options.items() if self._takes(name)}
        if observer is not None:
            advance = partial(our_loop, self.functions)
            options["observer"] = observer
        else:
            advance = self.functions.run_timestep
            if "mu" in options:
                options[self._friction] = options.pop("mu")
            options |= self._set
        try:
            theirs, ground = self.follow(meshes, source)
            advance(theirs, ground, timeStep, CRCoeff, **options)
        except KeyboardInterrupt as error:
            place = describe(error, self.folder).rpartition(": KeyboardInterrupt")[0]
            raise KeyboardInterrupt(*error.args, f" at {place}" * bool(place)) from None
        except BaseException as error:  # a student's function may raise anything
            raise StateError(describe(error, self.folder)) from None
        states = [state_of(*pair) for pair in zip(meshes, theirs, strict=True)]
        for mesh, state in zip(meshes, states, strict=True):
            for name, value in state.items():
                setattr(mesh, name, value)

    def inertia_of(self, simulation):
        """Returns of each student's mesh invIT, and the tensor in world axes at `beside.TURN`."""
        found = []
        with suppress(Exception, SystemExit):  # reported where a step needs them
            for mesh in self.follow(simulation.meshes, simulation.source)[0]:
                before, mesh.orientation = mesh.orientation, TURN.copy()
                found.append((mesh.invIT, mesh.get_rotated_inv_IT()))
                mesh.orientation = before
        return found

    def follow(self, meshes, source):
        """Gives the student's meshes the state of ours, which are relative to the COM: theirs are
        made from the numbers in the scene's files. Returns their meshes, and their ground.
        """
        if self._source is not source:
            self._source = source
            self._rows = scene_rows(source.path, source.scene)
            self._meshes = [None] * len(meshes)
            nothing = np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros((0, 4), int)
            unturned = np.array([1.0, 0.0, 0.0, 0.0])
            self._ground = self._Mesh("ground", *nothing, 0.0, np.zeros((1, 3)), unturned, True)
        for k, mesh in enumerate(meshes):
            theirs = self._meshes[k]
            if theirs is None or bool(theirs.isFixed) != mesh.isFixed:
                theirs = self._meshes[k] = self._make(k, mesh.isFixed)
            hasMoved = False
            for name in STATE_WIDTHS:
                value = np.array(getattr(mesh, name), dtype=np.float64)
                own = np.asarray(getattr(theirs, name), dtype=np.float64).reshape(value.shape)
                if own.tobytes() != value.tobytes():
                    setattr(theirs, name, value)
                    hasMoved |= not np.allclose(own, value, rtol=ROUNDING, atol=ROUNDING)
            if hasMoved:
                theirs.currVertices = np.array(mesh.currVertices)
        return self._meshes, self._ground

    def _make(self, k, isFixed):
        name, density, _isFixed, position, orientation = self._rows[k]
        # Copies, because the released class changes its arrays.
        shape = [array.copy() for array in self._source.shapes[name]]
        return self._Mesh(name, *shape, density, position.copy(), orientation.copy(), isFixed)


def friction_name(parameters):
    """Returns what a student calls our `mu` among the parameters of a function."""
    return next(filter(FRICTION_NAME.fullmatch, parameters), "mu")


def our_loop(functions, meshes, groundMesh, *arguments, **options):
    """This project's run_timestep, with the functions and meshes of another module."""
    friction = friction_name(inspect.signature(functions.resolve_collision).parameters)

    def resolve_collision(m1, m2, depth, normal, point, CRCoeff, *others):
        named = {friction: others[-1]} if others else {}
        contact = depth, np.array(normal), np.array(point), CRCoeff
        functions.resolve_collision(m1, m2, *contact, **named)  # returns what the loop must not see

    called = SimpleNamespace(**vars(functions) | {"resolve_collision": resolve_collision})
    theirs = [mesh for mesh in (*meshes, groundMesh) if mesh is not None]
    kinds = [type(mesh) for mesh in theirs]
    for mesh, kind in zip(theirs, kinds, strict=True):
        mesh.__class__ = loop_mesh(kind)
    try:
        run_timestep(meshes, groundMesh, *arguments, functions=called, **options)
    finally:
        for mesh, kind in zip(theirs, kinds, strict=True):
            vertices = mesh.currVertices
            mesh.__class__ = kind
            vars(mesh)["currVertices"] = vertices


@cache
def loop_mesh(Mesh):
    """Returns a subclass of a student's Mesh with what the loop of `run_timestep` asks for.

    currVertices are those of the present pose, whenever the student updates them.
    """

    class LoopMesh(Mesh):
        _vertices = None, None

        @property
        def currVertices(self):
            pose = np.asarray(self.position).tobytes() + np.asarray(self.orientation).tobytes()
            if self._vertices[0] != pose:
                vertices = QRotate(self.orientation, self.origVertices) + self.position
                self._vertices = pose, vertices
            return self._vertices[1]

        @currVertices.setter
        def currVertices(self, vertices):
            pass

        def follow_velocity(self, timeStep):
            pass

        def detect_collision(self, m):
            if self.isFixed and m.isFixed:
                return False, 0.0, None, None
            return super().detect_collision(m)

        def bounding_box(self):
            low, high = self.currVertices.min(axis=0), self.currVertices.max(axis=0)
            return (*low.tolist(), *high.tolist())

        def lowest_vertex(self):
            vertices = self.currVertices
            return None if self.isFixed else vertices[vertices[:, 1].argmin()].copy()

        def arms(self):
            return QRotate(self.orientation, self.origVertices)[:, None]

    return LoopMesh


def state_of(mesh, theirs):
    """Returns the state of a student's mesh in the shapes of ours: a dict of arrays.

    Raises StateError if it has others, or is not finite.
    """
    shapes, state = {name: (1, width) for name, width in STATE_WIDTHS.items()}, {}
    for name, shape in (shapes | {"currVertices": mesh.currVertices.shape}).items():
        what = f"{short(mesh.name, limit=60)}: {name}"
        try:
            state[name] = np.array(getattr(theirs, name, None), dtype=np.float64).reshape(shape)
        except (TypeError, ValueError):
            raise StateError(f"{what} is no array of shape {shape}") from None
        if not np.isfinite(state[name]).all():
            raise StateError(f"{what} is not finite")
    return state
