"""Time steps by a student's functions, in place of our own, on a scene that our program shows.

The program keeps its own meshes, which it draws and records; a student's `Mesh` stands behind each
of them. Before a step the student's meshes get the state of ours, and afterwards ours get theirs.
"""

import inspect
from hashlib import sha256

import numpy as np

from rbs.bodies import StateError
from rbs.scenelines import scene_rows
from rbs.submissions import SubmissionError, brief, describe, load_submission
from RBSFunctions import run_timestep

# Our run_timestep's parameters in their order, and the values that they have where none is given.
DEFAULTS = {name: one.default for name, one in inspect.signature(run_timestep).parameters.items()}
PARAMETERS = tuple(DEFAULTS)
# Those that the coursework's run_timestep has: the first four by their place, the others by name.
COURSEWORK_PARAMETERS = set(PARAMETERS[:8])

# A student's vertices are left as they are while the state is that of ours to within this, relative
# to the size and in m: quaternions may be normalised in other ways.
ROUNDING = 1e-12

STATE_WIDTHS = {"position": 3, "orientation": 4, "linVelocity": 3, "angVelocity": 3}


class SubmittedSteps:
    """A student's run_timestep and Mesh, to be called in place of ours.

    folder : with the student's modules, which are loaded

    Attributes: folder, resolved; digest, of the Python files in it: recordings tell by it whether
    these functions made them.

    Raises SubmissionError where the modules cannot be loaded, or have no run_timestep or Mesh.
    """

    def __init__(self, folder):
        submission = load_submission(folder, keepsNames=False)
        if "RBSFunctions" in submission.missing:
            raise SubmissionError(f"{folder}: there is no RBSFunctions.py")
        self.folder = submission.folder
        files = sorted(self.folder.glob("*.py"))
        texts = [file.name.encode() + b"\0" + file.read_bytes() + b"\0" for file in files]
        self.digest = sha256(b"".join(texts)).hexdigest()
        self._run_timestep, self._Mesh = (
            self._function(submission.functions, name) for name in ("run_timestep", "Mesh")
        )
        try:
            parameters = inspect.signature(self._run_timestep).parameters
        except (TypeError, ValueError):
            parameters = {}
        self._takesAll = any(one.kind is one.VAR_KEYWORD for one in parameters.values())
        self._known = set(parameters)
        self._source = None

    def _function(self, module, name):
        function = getattr(module, name, None)
        if not callable(function):
            raise SubmissionError(f"{self.folder}: RBSFunctions.py has no {name}")
        return function

    def check_options(self, options):
        """Raises SubmissionError for an option that the student's run_timestep does not know.

        options : dict from the name of an option to that of the parameter
        """
        for option, parameter in options.items():
            if parameter not in PARAMETERS[:5] and not self._knows(parameter):
                raise SubmissionError(
                    f"{option} does not go with --functions: the run_timestep in {self.folder} "
                    f"takes no {parameter}"
                )

    def _knows(self, parameter):
        return self._takesAll or parameter in self._known

    def step(self, source, meshes, groundMesh, timeStep, CRCoeff, *arguments, **options):
        """One step of our meshes, in place; returns None, as there is no report of it.

        source : the SceneSource that the meshes are from; then as for our `run_timestep`. What has
            its default there is not handed on, unless the coursework has it too.

        Raises StateError, and leaves our meshes as they were, where the student's step raises, does
        not know an option, or gives what is not a state.
        """
        options |= dict(zip(PARAMETERS[4:], arguments, strict=False))
        for name in options.keys() - COURSEWORK_PARAMETERS:
            if options[name] == DEFAULTS[name]:
                del options[name]
            elif not self._knows(name):
                raise StateError(f"the run_timestep in {self.folder} takes no {name}")
        options = {name: value for name, value in options.items() if self._knows(name)}
        try:
            self._follow(meshes, source)
            self._run_timestep(self._meshes, self._ground, timeStep, CRCoeff, **options)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # whatever a student's function raises
            raise StateError(describe(error, self.folder)) from None
        states = [self._state(*pair) for pair in zip(meshes, self._meshes, strict=True)]
        for mesh, state in zip(meshes, states, strict=True):
            for name, value in state.items():
                setattr(mesh, name, value)

    def _follow(self, meshes, source):
        """Gives the student's meshes the state of ours; makes them first where it is needed.

        They are made of the numbers in the scene's files, not of our meshes, whose vertices have
        their COM subtracted already.
        """
        if self._source is not source:
            self._source = source
            self._rows = scene_rows(source.scene, len(meshes))
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

    def _make(self, k, isFixed):
        name, density, _isFixed, position, orientation = self._rows[k]
        # The released class changes its arrays.
        shape = [array.copy() for array in self._source.shapes[name]]
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
            f"{brief(meshName, 60)}: {name} has shape {np.shape(value)}, not {shape}"
        ) from None
    if not np.isfinite(array).all():
        raise StateError(f"{brief(meshName, 60)}: {name} is not finite")
    return array
