"""Time steps by a student's functions, for --functions; `StudentFunctions`, for compare.py, too.

The program's own `run_timestep` makes the steps. It calls the student's methods and functions in
place of its own; their run_timestep is not called. They work on meshes of the student's own class,
which have the state of ours while they do: both classes may use any name.
"""

import copy
import ctypes
import inspect
import re
import threading
from contextlib import contextmanager, suppress
from functools import partial
from hashlib import sha256
from pathlib import Path
from signal import SIGINT
from types import SimpleNamespace
from weakref import WeakKeyDictionary

import numpy as np

import GJK
from rbs.geometry.triples import ZERO
from rbs.glass.events import KEPT, applied_impulse
from rbs.program import submissions
from rbs.program.returned import RETURNED, WrongResult, by_mesh, numbers, returned
from rbs.program.submissions import DETECT, METHODS, POSITION, TENSOR, VELOCITY, at_home
from rbs.scenes.files import SIGNAL_NAMES
from rbs.scenes.messages import print_error
from rbs.scenes.simulation import is_turned_back
from rbs.scenes.state import inertias_of, set_inertia
from rbs.stepping.meshes import STATE_WIDTHS, StateError
from rbs.stepping.settings import EARTH
from RBSFunctions import Mesh, run_timestep

GIVEN = "name origVertices faces tets density position orientation isFixed".split()
# Attributes that a student's mesh gets from ours, and those that ours also takes over from it.
LENT = "origVertices currVertices mass".split()
TAKEN = *KEPT, *STATE_WIDTHS
# What students call our `mu`.
FRICTION_NAME = re.compile("μ|mu|mu_?[ks]|.*fric.*", re.IGNORECASE)


class TookTooLong(BaseException):
    """Ends a student's function, which may catch any Exception."""

    def __str__(self):
        return "stopped after the time limit, as it may never end"


@contextmanager
def time_limit(seconds):
    """Raises TookTooLong in the `with` block, in its thread, if it takes longer; None: never."""
    # as in a signal's handler, between two instructions; but on every platform
    raising = ctypes.pythonapi.PyThreadState_SetAsyncExc, ctypes.c_ulong(threading.get_ident())
    stop = partial(*raising, ctypes.py_object(TookTooLong))
    timer = threading.Timer(seconds or 0.0, stop)
    timer.daemon = True
    if seconds is not None:
        timer.start()
    try:
        yield
    finally:
        timer.cancel()


class Fault(StateError):
    """A student's function fails, or returns or leaves something that is no result.

    function : its name; text : what is wrong
    """

    def __init__(self, function, text):
        super().__init__(f"{function}: {text}")
        self.function, self.text = function, text


@contextmanager
def judged(function):
    """Makes a WrongResult in the `with` block the Fault of a function."""
    try:
        yield
    except WrongResult as error:
        raise Fault(function, str(error).removeprefix(f"{function} ")) from None


class StudentFunctions:
    """A student's functions as `functions` of our `run_timestep`, and their methods for its meshes.

    Arguments have the shapes of the coursework's, results those of ours. Raises Fault for what is
    no result.

    A subclass has `call(name, meshes, *given, **named)`. It calls a function with meshes of theirs
    in the state of ours, or a method of the first of them, and returns the result. Our meshes take
    over what the call has changed.
    """

    def __init__(self, friction=None):
        """friction : the name of their parameter for friction, or None"""
        self._friction, self._Mesh = friction, mesh_class(self)

    @contextmanager
    def methods_of(self, meshes):
        """Gives meshes the student's methods, in the `with` block."""
        kinds = list(map(type, meshes))
        try:
            for mesh in meshes:
                mesh.__class__ = self._Mesh
            yield
        finally:
            for mesh, kind in zip(meshes, kinds, strict=True):
                mesh.__class__ = kind

    def is_turned_back(self, meshes):
        """Whether their tensors in world axes are Rᵀ I⁻¹ R, as in the release's solution; the
        events of their steps tell it from now on.
        """
        with self.methods_of(meshes):
            isTurnedBack = any(is_turned_back(one) for one in meshes if not one.isFixed)
        self._Mesh.isTurnedBack = isTurnedBack
        return isTurnedBack

    def resolve_collision(self, m1, m2, depth, normal, point, CRCoeff, mu=0.0):
        """Calls theirs; returns as ours the impulses that it has applied, and their arm."""
        before, isOnGround = [pose_of(mesh) for mesh in (m1, m2)], len(m2.origVertices) == 0
        n, point = np.array(normal, dtype=np.float64), np.array(point, dtype=np.float64)
        contact = np.array(depth), n.reshape(1, 3) if isOnGround else n, point
        named = {self._friction: mu} if mu else {}
        self.call("resolve_collision", [m1, m2], *contact, CRCoeff, **named)
        after = [pose_of(mesh) for mesh in (m1, m2)]
        impulse, n = applied_impulse(before, after), n.ravel() * (-1.0 if isOnGround else 1.0)
        j = float(impulse @ n)
        friction = tuple((impulse - j * n).tolist()) if mu else ZERO
        arm = point.ravel() + after[1].position - before[1].position - after[0].position
        return j, friction, tuple(arm.tolist())

    def resolve_position_constraint(self, *given):
        return self._resolved(POSITION, given)

    def resolve_velocity_constraint(self, *given):
        return self._resolved(VELOCITY, given)

    def _resolved(self, name, given):
        """Returns a flag, and pairs of arrays (1, 3)."""
        values = self.call(name, [], *given)
        with judged(name):
            (flag, *keys), (wasValid, *pairs) = RETURNED[name], returned(values, name)
            pairs = map(by_mesh, keys, pairs)
            pairs = [[numbers(one, 3, what)[None] for one, what in pair] for pair in pairs]
            return bool(numbers(wasValid, "bool", flag)), *pairs


def mesh_class(functions):
    """Returns a subclass of our Mesh whose methods are those of `StudentFunctions`, by METHODS."""

    class StudentMesh(Mesh):
        def get_rotated_inv_IT(self):
            tensor = functions.call(TENSOR, [self])
            with judged(TENSOR):
                return numbers(tensor, 9, "the tensor").reshape(3, 3)

        def integrate_timestep(self, timeStep, gravity=EARTH):
            if gravity != EARTH and not self.isFixed:  # theirs adds that of the Earth
                self.linVelocity = self.linVelocity + timeStep * np.subtract(gravity, EARTH)
            functions.call("integrate_timestep", [self], timeStep)

        def detect_collision(self, m):
            if self.isFixed and m.isFixed:
                return GJK.NO_COLLISION
            found = functions.call(DETECT, [self, m])
            with judged(DETECT):
                isCollision, *contact = zip(returned(found, DETECT), RETURNED[DETECT], strict=True)
                if not numbers(isCollision[0], "bool", isCollision[1]):
                    return GJK.NO_COLLISION
                return True, *(numbers(one, RETURNED[DETECT][key], key) for one, key in contact)

    return StudentMesh


class SubmittedSteps(StudentFunctions):
    """`run_timestep` with the functions of a student.

    folder : of the student's modules, resolved
    digest : of the Python files, also in subfolders; recordings know the functions by it
    seconds : that loading them, and a step, may take; None for any time
    """

    def __init__(self, folder, seconds=None):
        """Raises SubmissionError if the modules cannot be loaded, or lack a function."""
        self.seconds, folder = seconds, Path(folder)
        self.folder = folder.parent if folder.suffix == ".py" else folder
        try:
            with time_limit(seconds):
                submission = submissions.load_submission(self.folder)
        except submissions.SubmissionError as error:
            raise self._error(error) from None
        for remark in submission.remarks:
            print_error(f"{submission.folder}: {remark}")
        self.folder, self._theirs = submission.folder, submission.functions
        for name in ("Mesh", *submissions.FUNCTIONS):
            if not callable(getattr(self._theirs, name, None)):
                raise self._error(f"RBSFunctions.py has no {name}")
        for name in (*METHODS, "bounding_box_collision"):
            if not callable(getattr(self._theirs.Mesh, name, None)):
                raise self._error(f"the Mesh in RBSFunctions.py has no {name}")
        parameters = inspect.signature(self._theirs.resolve_collision).parameters
        super().__init__(next(filter(FRICTION_NAME.fullmatch, parameters), None))
        self._own, digest = WeakKeyDictionary(), sha256()
        for path in sorted(filter(Path.is_file, self.folder.rglob("*.py"))):
            file = path.relative_to(self.folder)
            if not any(map(submissions.is_skipped, file.parts)):
                digest.update(file.as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
        self.digest = digest.hexdigest()

    def _error(self, cause):
        return submissions.SubmissionError(f"{self.folder}: {cause}")

    def again(self):
        """Loads the modules of the folder again. Raises SubmissionError."""
        return type(self)(self.folder, self.seconds)

    def lacking(self, settings):
        """Returns a line if the functions cannot make steps with these settings, or ""."""
        schedules = settings.contactScheduling, settings.constraintScheduling
        if settings.contactSolver != "impulse" or "batches" in schedules:
            return "--functions needs a step that calls them one by one, not one on arrays"
        if settings.friction and self._friction is None:
            return f"the resolve_collision in {self.folder} has no parameter for friction"
        return ""

    def is_turned_back(self, meshes):
        with suppress(Exception, SystemExit), at_home(self.folder):  # told where needed
            return super().is_turned_back(list(map(copy.copy, meshes)))  # none of theirs is kept
        return False

    def step(self, meshes, groundMesh, *, settings, **options):
        """Makes one step in place; the arguments are those of `run_timestep`.

        Raises StateError if a function fails or gives an invalid state; meshes stay as they were.
        """
        if lacking := self.lacking(settings):
            raise StateError(lacking)
        options |= {"settings": settings, "functions": self}
        theirs = [*meshes, groundMesh] if groundMesh is not None else meshes
        inertias, report = inertias_of(theirs), None
        try:
            with self.methods_of(theirs), time_limit(self.seconds), at_home(self.folder):
                report = run_timestep(meshes, groundMesh, **options)
            return report
        except KeyboardInterrupt as error:
            place = submissions.describe(error, self.folder).rpartition(": KeyboardInterrupt")[0]
            number = error.args[0] if error.args and error.args[0] in SIGNAL_NAMES else SIGINT
            raise KeyboardInterrupt(number, f" at {place}" * bool(place)) from None
        except StateError:
            raise
        except BaseException as error:  # a student's function may raise anything
            raise StateError(submissions.describe(error, self.folder)) from None
        finally:
            if report is None:
                for mesh, inertia in zip(theirs, inertias, strict=True):
                    set_inertia(mesh, inertia)

    def call(self, name, meshes, *given, **named):
        """See `StudentFunctions`; a student's code gets copies of arrays.

        Each mesh of ours has one of theirs, so that attributes of the student's last until somebody
        fixes or frees it. Attributes that they leave alone are not set again.
        """
        theirs = list(map(self._lent, meshes))
        before = [[content(getattr(own, key, None)) for key in TAKEN] for own in theirs]
        owner, *others = theirs if name in METHODS else (self._theirs, *theirs)
        found = getattr(owner, name)(*others, *map(copied, given), **named)
        for mesh, own, contents in zip(meshes, theirs, before, strict=True):
            for key, was in zip(TAKEN, contents, strict=True):
                value = getattr(own, key, None)
                if content(value) != was:
                    isState = key in STATE_WIDTHS
                    setattr(mesh, key, state_left(name, mesh, key, value) if isState else value)
        return found

    def _lent(self, mesh):
        """The mesh of theirs in the place of one of ours, in its state."""
        own = self._own.get(mesh)
        if own is None or own.isFixed != mesh.isFixed:
            own = submissions.built(self._theirs.Mesh, *(getattr(mesh, one) for one in GIVEN))
            self._own[mesh] = own
        for name in (*LENT, *TAKEN):
            value = getattr(mesh, name)
            if content(getattr(own, name, None)) != content(value):
                with suppress(Exception):  # a property of theirs may refuse
                    setattr(own, name, copy.copy(value))
        return own


def state_left(function, mesh, name, value):
    """Returns an attribute of STATE_WIDTHS that a function has left in a mesh, in our shape."""
    with judged(function):
        return numbers(value, STATE_WIDTHS[name], f"{name} of {mesh.name!r}")[None]


def content(value):
    """Returns what tells one value from another: shape and bytes of an array, or the value."""
    return (value.shape, value.tobytes()) if isinstance(value, np.ndarray) else value


def pose_of(mesh):
    """Returns what `applied_impulse` needs of a mesh, and its position: arrays (3,)."""
    x, v = (np.array(row, dtype=np.float64).ravel() for row in (mesh.position, mesh.linVelocity))
    return SimpleNamespace(invMass=mesh.invMass, position=x, linVelocity=v)


def copied(value):
    """Returns a copy of an array, or of those in a tuple; other values as they are."""
    if isinstance(value, tuple):
        return tuple(map(copied, value))
    return np.array(value, dtype=np.float64) if isinstance(value, np.ndarray) else value
