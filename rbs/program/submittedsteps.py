"""Time steps by a student's functions, for --functions.

The program draws and records its own meshes. Each has a counterpart of the student's `Mesh` class,
which gets its state before a step and gives it back afterwards.
"""

import inspect
import itertools
from difflib import get_close_matches
from functools import partial
from hashlib import sha256

import numpy as np

from Quaternion import QRotate
from rbs.program.submissions import SubmissionError, brief, describe, load_submission
from rbs.scenes.messages import print_note
from rbs.scenes.scenefiles import scene_rows
from rbs.stepping.bodies import STATE_WIDTHS, StateError
from RBSFunctions import run_timestep, sweep

# The parameters of run_timestep in order, with their defaults.
DEFAULTS = {name: one.default for name, one in inspect.signature(run_timestep).parameters.items()}
PARAMETERS = tuple(DEFAULTS)
# The parameters of the coursework's run_timestep: four by position, the others by name.
COURSEWORK_PARAMETERS = set(PARAMETERS[:8])

# Relative, and in m: smaller differences between the two states leave the student's vertices alone.
# They come from other ways to normalise quaternions.
ROUNDING = 1e-12


class SubmittedSteps:
    """A student's run_timestep and Mesh, called in place of this project's.

    Parameters
    ----------
    folder : of the student's modules
    inOurLoop : whether `basic_step` replaces the student's run_timestep

    Attributes
    ----------
    folder : the same, resolved
    digest : of the Python files and inOurLoop; recordings identify the functions by it
    functions : the module RBSFunctions
    run_timestep : the function that makes the steps

    Raises
    ------
    SubmissionError
        If the modules cannot be loaded, or have no run_timestep or Mesh.
    """

    def __init__(self, folder, inOurLoop=False):
        submission = load_submission(folder, keepsNames=False)
        self.folder = submission.folder
        files = sorted(self.folder.glob("*.py"))
        texts = [file.name.encode() + b"\0" + file.read_bytes() + b"\0" for file in files]
        self.digest = sha256(b"".join(texts) + b"our loop" * inOurLoop).hexdigest()
        self.functions = submission.functions
        self._Mesh = self._function("Mesh")
        if inOurLoop:
            self.run_timestep = partial(basic_step, self.functions)
        else:
            self.run_timestep = self._function("run_timestep")
        parameters = inspect.signature(self.run_timestep).parameters
        takesAll = any(one.kind is one.VAR_KEYWORD for one in parameters.values())
        self._known = set(PARAMETERS if takesAll else parameters)
        self._source = None
        self._attributes = set(STATE_WIDTHS) | {"currVertices"}

    def _function(self, name):
        function = getattr(self.functions, name, None)
        if not callable(function):
            raise SubmissionError(f"{self.folder}: RBSFunctions.py has no {name}")
        return function

    def check_options(self, options):
        """Raises SubmissionError if the student's run_timestep lacks the parameter of an option.

        options : dict from the name of an option to that of its parameter
        """
        for option, parameter in options.items():
            if parameter not in PARAMETERS[:5] and parameter not in self._known:
                raise SubmissionError(
                    f"{option} cannot be used with these --functions: the run_timestep in "
                    f"{self.folder} has no parameter {parameter}"
                )

    def step(self, source, meshes, groundMesh, timeStep, CRCoeff, *arguments, **options):
        """Makes one step of the program's meshes in place.

        source : the SceneSource of the meshes; the rest as for `run_timestep`. Parameters that the
            coursework lacks are passed on only if they are not default.

        Raises StateError if the student's step raises, lacks a parameter, or gives an invalid
        state. The meshes then stay as they were.
        """
        options |= dict(zip(PARAMETERS[4:], arguments, strict=False))
        for name in options.keys() - COURSEWORK_PARAMETERS:
            if options[name] == DEFAULTS[name]:
                del options[name]
            elif name not in self._known:
                raise StateError(f"the run_timestep in {self.folder} has no parameter {name}")
        options = {name: value for name, value in options.items() if name in self._known}
        try:
            theirs, ground = self.follow(meshes, source)
            self.run_timestep(theirs, ground, timeStep, CRCoeff, **options)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # a student's function may raise anything
            raise StateError(describe(error, self.folder)) from None
        self._note_misspelt(theirs)
        states = [self._state(*pair) for pair in zip(meshes, theirs, strict=True)]
        for mesh, state in zip(meshes, states, strict=True):
            for name, value in state.items():
                setattr(mesh, name, value)

    def _note_misspelt(self, theirs):
        """Prints a note, once, if a step adds an attribute named almost like one of the state."""
        names = (name for mesh in theirs for name in getattr(mesh, "__dict__", ()))
        added = [name for name in names if name not in self._attributes]
        self._attributes |= set(added)
        for name in dict.fromkeys(added):
            for meant in get_close_matches(name, STATE_WIDTHS, cutoff=0.85):
                print_note(
                    f"{self.folder}: a step assigns {brief(name, 60)}, so {meant} keeps its value, "
                    "as in the coursework's released run_timestep; --our-loop avoids this"
                )

    def follow(self, meshes, source):
        """Gives the student's meshes the state of the program's, and makes them if necessary.

        They are made from the numbers in the scene's files, because the vertices of the program's
        meshes are already relative to the COM.

        Returns the list of student's meshes, and the student's ground.
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
        return self._meshes, self._ground

    def _make(self, k, isFixed):
        name, density, _isFixed, position, orientation = self._rows[k]
        # Copies, because the released class changes its arrays.
        shape = [array.copy() for array in self._source.shapes[name]]
        mesh = self._Mesh(name, *shape, density, position.copy(), orientation.copy(), isFixed)
        self._attributes |= set(getattr(mesh, "__dict__", ()))
        return mesh

    def _state(self, mesh, theirs):
        """Returns the state of a student's mesh in the program's shapes: a dict of arrays."""
        state = {}
        for name, width in STATE_WIDTHS.items():
            state[name] = _numbers(mesh.name, name, getattr(theirs, name, None), (1, width))
        vertices, shape = getattr(theirs, "currVertices", None), mesh.currVertices.shape
        state["currVertices"] = _numbers(mesh.name, "currVertices", vertices, shape)
        return state


def basic_step(
    functions,
    meshes,
    groundMesh,
    timeStep,
    CRCoeff,
    enforceConstraints=True,
    constraints=(),
    maxIterations=1000,
    tolerance=0.0,
):
    """The basic run_timestep, with another module's functions and meshes.

    functions : module with `resolve_collision` and the two constraint functions; the rest as for
        `run_timestep`. currVertices are updated whenever a mesh has moved
    """

    def move(mesh):
        mesh.currVertices = QRotate(mesh.orientation, mesh.origVertices) + mesh.position

    for mesh in meshes:
        mesh.integrate_timestep(timeStep)
        move(mesh)
    for m1, m2 in itertools.combinations(meshes, 2):
        isCollision, *contact = m1.detect_collision(m2)
        if isCollision and not (m1.isFixed and m2.isFixed):
            functions.resolve_collision(m1, m2, *contact, CRCoeff)
            move(m1)
            move(m2)
    for mesh in meshes:
        lowest = mesh.currVertices[mesh.currVertices[:, 1].argmin()].copy()
        if lowest[1] <= 0.0 and not mesh.isFixed:
            up = np.array([0.0, 1.0, 0.0])
            functions.resolve_collision(mesh, groundMesh, lowest[1], up, lowest, CRCoeff)
            move(mesh)

    def visit(c):
        """Corrects constraint c if it is violated. Returns whether it was."""
        m1, v1, m2, v2, refValue, upper = constraints[c]
        pair = meshes[m1], meshes[m2]
        position, linVelocity, angVelocity = (
            [np.array(getattr(mesh, name)) for mesh in pair]
            for name in ("position", "linVelocity", "angVelocity")
        )
        points = [pair[0].currVertices[[v1]], pair[1].currVertices[[v2]]]
        invMasses = [mesh.invMass for mesh in pair]
        wasValid, positions = functions.resolve_position_constraint(
            position, points, refValue, invMasses, upper, tolerance
        )
        if wasValid:
            return False
        # the points move along the line that joins them, so the arms and the direction still hold
        tensors = [mesh.get_rotated_inv_IT() for mesh in pair]
        moving = linVelocity, angVelocity, invMasses, tensors, tolerance
        _, *velocities = functions.resolve_velocity_constraint(position, points, *moving)
        for mesh, *state in zip(pair, positions, *velocities, strict=True):
            mesh.position, mesh.linVelocity, mesh.angVelocity = state
            move(mesh)
        return True

    if enforceConstraints and len(constraints) > 0:
        ends = [(meshes[row[0]], meshes[row[2]]) for row in constraints]
        isMovable = [m1 is not m2 and not (m1.isFixed and m2.isFixed) for m1, m2 in ends]
        movable = set(np.flatnonzero(isMovable).tolist())
        sweep(visit, movable, len(constraints), max(maxIterations, len(constraints)))


def _numbers(meshName, name, value, shape):
    """Returns a copy of an array in the given shape. Raises StateError if that is impossible."""
    try:
        array = np.array(value, dtype=np.float64).reshape(shape)
    except (TypeError, ValueError):
        raise StateError(
            f"{brief(meshName, 60)}: {name} has shape {np.shape(value)}, not {shape}"
        ) from None
    if not np.isfinite(array).all():
        raise StateError(f"{brief(meshName, 60)}: {name} is not finite")
    return array
