"""Time steps by a student's functions, in place of our own, on a scene that our program shows.

The program keeps its own meshes, which it draws and records; a student's `Mesh` stands behind each
of them. Before a step the student's meshes get the state of ours, and afterwards ours get theirs.
"""

import inspect
from pathlib import Path

import numpy as np

from rbs.submissions import SubmissionError, describe, one_line, scene_rows
from RBSFunctions import StateError

STATE_WIDTHS = {"position": 3, "orientation": 4, "linVelocity": 3, "angVelocity": 3}


class SubmittedSteps:
    """Called like `run_timestep`, it makes the step with a student's functions.

    submission : `rbs.submissions.Submission`
    load_mesh_file : function that reads a mesh file

    Raises SubmissionError where there is no run_timestep or Mesh to be used.
    """

    def __init__(self, submission, load_mesh_file):
        if "RBSFunctions" in submission.missing:
            raise SubmissionError(f"{submission.folder}: there is no RBSFunctions.py")
        self._folder = submission.folder
        self._load_mesh_file = load_mesh_file
        self._run_timestep, self._Mesh = (
            self._function(submission.functions, name) for name in ("run_timestep", "Mesh")
        )
        try:
            parameters = inspect.signature(self._run_timestep).parameters
        except (TypeError, ValueError):
            parameters = {}
        self._takesAll = any(one.kind is one.VAR_KEYWORD for one in parameters.values())
        self._known = set(parameters)
        self._meshes = self._ground = self._scene = None

    def _function(self, module, name):
        function = getattr(module, name, None)
        if not callable(function):
            raise SubmissionError(f"{self._folder}: RBSFunctions.py has no {name}")
        return function

    def knows(self, parameter):
        """Whether the student's run_timestep takes a parameter of this name."""
        return self._takesAll or parameter in self._known

    def __call__(
        self, meshes, groundMesh, timeStep, CRCoeff, enforceConstraints, constraints,
        maxIterations, tolerance, *, scenePath, **options,
    ):  # fmt: skip
        """One step of our meshes, in place; `run_timestep` has the parameters.

        scenePath : of the scene that the meshes are from
        options : parameters beyond the coursework's, only those that are not at their defaults

        Raises StateError, and leaves our meshes as they were, where the student's step raises,
        knows an option not, or gives what is not a state.
        """
        unknown = [name for name in options if not self.knows(name)]
        if unknown:
            raise StateError(f"run_timestep of RBSFunctions.py takes no {', '.join(unknown)}")
        further = {
            "enforceConstraints": enforceConstraints,
            "constraints": constraints,
            "maxIterations": maxIterations,
            "tolerance": tolerance,
        }
        further = {name: value for name, value in further.items() if self.knows(name)} | options
        try:
            self._follow(meshes, scenePath)
            self._run_timestep(self._meshes, self._ground, timeStep, CRCoeff, **further)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # whatever a student's function raises
            raise StateError(describe(error, self._folder)) from None
        states = [self._state(*pair) for pair in zip(meshes, self._meshes, strict=True)]
        for mesh, state in zip(meshes, states, strict=True):
            for name, value in state.items():
                setattr(mesh, name, value)

    def _follow(self, meshes, scenePath):
        """Gives the student's meshes the state of ours; makes them first where it is needed.

        They are made of the numbers in the scene's files, not of our meshes, whose vertices have
        their COM subtracted already.
        """
        if self._scene != (scenePath, len(meshes)):
            self._scene = scenePath, len(meshes)
            self._rows = scene_rows(scenePath, len(meshes))
            self._shapes = {}
            self._meshes = [None] * len(meshes)
            nothing = np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros((0, 4), int)
            unturned = np.array([1.0, 0.0, 0.0, 0.0])
            self._ground = self._Mesh("ground", *nothing, 0.0, np.zeros((1, 3)), unturned, True)
        for k, mesh in enumerate(meshes):
            theirs = self._meshes[k]
            if theirs is None or bool(theirs.isFixed) != mesh.isFixed:
                theirs = self._meshes[k] = self._make(k, mesh.isFixed)
            for name in STATE_WIDTHS:
                value = np.array(getattr(mesh, name), dtype=np.float64)
                if not np.array_equal(getattr(theirs, name, None), value):
                    setattr(theirs, name, value)
                    theirs.currVertices = np.array(mesh.currVertices)

    def _make(self, k, isFixed):
        name, density, _isFixed, position, orientation = self._rows[k]
        if name not in self._shapes:
            self._shapes[name] = self._load_mesh_file(Path(self._scene[0]).parent / name)
        shape = [array.copy() for array in self._shapes[name]]  # the released class changes them
        return self._Mesh(
            name, *shape, density, position.copy(), orientation.copy(), isFixed
        )  # fmt: skip

    def _state(self, mesh, theirs):
        """The state of a student's mesh, in the shapes of ours: a dict of arrays."""
        state = {}
        for name, width in STATE_WIDTHS.items():
            state[name] = _numbers(mesh.name, name, getattr(theirs, name, None), (1, width))
        vertices = getattr(theirs, "currVertices", None)
        state["currVertices"] = _numbers(
            mesh.name, "currVertices", vertices, mesh.currVertices.shape
        )
        return state


def _numbers(meshName, name, value, shape):
    """A copy of an array in the given shape; StateError where it is none of finite numbers."""
    try:
        array = np.array(value, dtype=np.float64).reshape(shape)
    except (TypeError, ValueError):
        raise StateError(
            f"{one_line(meshName, 60)}: {name} has shape {np.shape(value)}, not {shape}"
        ) from None
    if not np.isfinite(array).all():
        raise StateError(f"{one_line(meshName, 60)}: {name} is not finite")
    return array
