"""Time steps by a student's functions, for --functions.

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
from rbs.geometry.triples import ZERO, shown_value
from rbs.glass.events import applied_impulse
from rbs.program import submissions
from rbs.scenes.files import SIGNAL_NAMES
from rbs.scenes.messages import print_error
from rbs.scenes.simulation import TURN, is_turned_back
from rbs.scenes.state import inertias_of, set_inertia
from rbs.stepping.meshes import STATE_WIDTHS, StateError
from rbs.stepping.settings import EARTH
from RBSFunctions import Mesh, run_timestep

GIVEN = "name origVertices faces tets density position orientation isFixed".split()
# Attributes that a student's mesh gets from ours, and those that it may also change.
LENT = "origVertices currVertices mass".split()
SHARED = "isFixed invMass IT invIT".split()
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


class SubmittedSteps:
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
        for name in (*submissions.METHODS, "bounding_box_collision"):
            if not callable(getattr(self._theirs.Mesh, name, None)):
                raise self._error(f"the Mesh in RBSFunctions.py has no {name}")
        self._Mesh, self._own = mesh_class(self), WeakKeyDictionary()
        parameters = inspect.signature(self._theirs.resolve_collision).parameters
        self._friction = next(filter(FRICTION_NAME.fullmatch, parameters), None)
        digest = sha256()
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
        """Whether their tensors in world axes are Rᵀ I⁻¹ R, as in the release's solution; the
        events of their steps tell it from now on.
        """
        with suppress(Exception, SystemExit), submissions.at_home(self.folder):  # told where needed
            for mesh in filter(lambda one: not one.isFixed, map(copy.copy, meshes)):
                mesh.orientation, mesh.__class__ = TURN, self._Mesh
                if is_turned_back(mesh.invIT, mesh.get_rotated_inv_IT()):
                    self._Mesh.isTurnedBack = True
                    return True
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
            with time_limit(self.seconds), submissions.at_home(self.folder):
                for mesh in theirs:
                    mesh.__class__ = self._Mesh
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
            for mesh, inertia in zip(theirs, inertias, strict=True):
                mesh.__class__ = Mesh
                if report is None:
                    set_inertia(mesh, inertia)

    @contextmanager
    def lend(self, function, *meshes):
        """Yields meshes of the student's class in the state of ours; then, ours take over theirs.

        Each mesh of ours has one of theirs, so that attributes of the student's last until somebody
        fixes or frees it. Attributes that they leave alone are not set again.
        function : name of theirs that gets them. Raises TypeError if it leaves no such state
        """
        theirs, before = [], []
        for mesh in meshes:
            own = self._own.get(mesh)
            if own is None or own.isFixed != mesh.isFixed:
                own = submissions.built(self._theirs.Mesh, *(getattr(mesh, one) for one in GIVEN))
                self._own[mesh] = own
            for name in (*LENT, *SHARED, *STATE_WIDTHS):
                value = getattr(mesh, name)
                if content(getattr(own, name, None)) != content(value):
                    with suppress(Exception):  # a property of theirs may refuse
                        setattr(own, name, copy.copy(value))
            theirs.append(own)
            before.append([content(getattr(own, name, None)) for name in (*SHARED, *STATE_WIDTHS)])
        yield theirs
        for mesh, own, contents in zip(meshes, theirs, before, strict=True):
            for name, was in zip((*SHARED, *STATE_WIDTHS), contents, strict=True):
                value = getattr(own, name, None)
                if content(value) == was:
                    continue
                if width := STATE_WIDTHS.get(name):
                    try:
                        value = real(value, 1, width)
                    except (TypeError, ValueError):
                        what = f"{name} of {mesh.name!r}, which must be {width} numbers"
                        told = f"{function} sets {what}, to {shown_value(value)}"
                        raise TypeError(told) from None
                setattr(mesh, name, value)

    # What the step calls: theirs, with copies of its arrays, in the shapes of the coursework's.

    def resolve_collision(self, m1, m2, depth, normal, point, CRCoeff, mu=0.0):
        """Calls theirs; returns as ours the impulses that it has applied, and their arm."""
        before, isOnGround = [pose_of(mesh) for mesh in (m1, m2)], len(m2.origVertices) == 0
        n, point = np.array(normal, dtype=np.float64), np.array(point, dtype=np.float64)
        contact = np.array(depth), n.reshape(1, 3) if isOnGround else n.copy(), point.copy()
        with self.lend("resolve_collision", m1, m2) as meshes:
            more = {self._friction: mu} if mu else {}
            self._theirs.resolve_collision(*meshes, *contact, CRCoeff, **more)
        after = [pose_of(mesh) for mesh in (m1, m2)]
        impulse, n = applied_impulse(before, after), n.ravel() * (-1.0 if isOnGround else 1.0)
        j = float(impulse @ n)
        friction = tuple((impulse - j * n).tolist()) if mu else ZERO
        arm = point.ravel() + after[1].position - before[1].position - after[0].position
        return j, friction, tuple(arm.tolist())

    def resolve_position_constraint(self, positions, points, *others):
        found = self._theirs.resolve_position_constraint(copies(positions), copies(points), *others)
        return returned("resolve_position_constraint", found, 2)

    def resolve_velocity_constraint(self, positions, points, v, omega, invMasses, tensors, *others):
        given = (*map(copies, (positions, points, v, omega)), invMasses, copies(tensors))
        found = self._theirs.resolve_velocity_constraint(*given, *others)
        return returned("resolve_velocity_constraint", found, 3)


def mesh_class(submitted):
    """Returns a subclass of our Mesh whose methods are those of a student's, by METHODS."""

    class StudentMesh(Mesh):
        def get_rotated_inv_IT(self):
            with submitted.lend("get_rotated_inv_IT", self) as (own,):
                tensor = own.get_rotated_inv_IT()
            with understood("get_rotated_inv_IT", "3 × 3 numbers", tensor):
                return real(tensor, 3, 3)

        def integrate_timestep(self, timeStep, gravity=EARTH):
            if gravity != EARTH and not self.isFixed:  # theirs adds that of the Earth
                self.linVelocity = self.linVelocity + timeStep * np.subtract(gravity, EARTH)
            with submitted.lend("integrate_timestep", self) as (own,):
                own.integrate_timestep(timeStep)

        def detect_collision(self, m):
            if self.isFixed and m.isFixed:
                return GJK.NO_COLLISION
            with submitted.lend("detect_collision", self, m) as (own, other):
                found = own.detect_collision(other)
            what = "whether they collide, a depth, a normal and a point"
            with understood("detect_collision", what, found):
                isCollision, *contact = found
                if isCollision:
                    contact = [real(one, n) for one, n in zip(contact, (1, 3, 3), strict=True)]
                depth, normal, point = contact
            return isCollision, depth, normal, point

    return StudentMesh


@contextmanager
def understood(name, what, value):
    """Raises TypeError in the `with` block if a function of this name has not returned `what`."""
    try:
        yield
    except (TypeError, ValueError):
        raise TypeError(f"{name} must return {what}, not {shown_value(value)}") from None


def real(value, *shape):
    """Returns numbers of a student's as an array of floats. Raises TypeError or ValueError."""
    array = np.array(value)
    if np.iscomplexobj(array):
        raise TypeError
    return array.astype(np.float64).reshape(shape)


def content(value):
    """Returns what tells one value from another: shape and bytes of an array, or the value."""
    return (value.shape, value.tobytes()) if isinstance(value, np.ndarray) else value


def pose_of(mesh):
    """Returns what `applied_impulse` needs of a mesh, and its position: arrays (3,)."""
    x, v = (np.array(row, dtype=np.float64).ravel() for row in (mesh.position, mesh.linVelocity))
    return SimpleNamespace(invMass=mesh.invMass, position=x, linVelocity=v)


def copies(arrays):
    """Returns a tuple of copies of arrays."""
    return tuple(np.array(one, dtype=np.float64) for one in arrays)


def returned(name, values, count):
    """Returns a flag and pairs of arrays (1, 3) of what a student's function has returned.

    Raises TypeError if these are no `count` values of that kind.
    """
    what = "a flag and pairs of vectors" if count > 2 else "a flag and a pair of vectors"
    with understood(name, what, values):
        isValid, *pairs = values
        pairs = [[real(one, 1, 3) for one in two] for two in pairs]
        if [len(pair) for pair in pairs] != [2] * (count - 1):
            raise ValueError
        return (bool(np.all(isValid)), *pairs)
