"""Loading a student's modules, which have the same names as this project's.

A submission is a folder with a student's `RBSFunctions.py`, `Quaternion.py` and the modules that
they import. Loading it runs its code with the rights of the user.
"""

import builtins
import importlib
import os
import re
import sys
import traceback
from contextlib import contextmanager
from importlib.machinery import PathFinder, SourceFileLoader
from itertools import count
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np

from rbs.scenes.files import UTF16_MARKS
from rbs.scenes.messages import InputError, short

# This project's modules whose names a submission may use.
OUR_MODULES = ("Quaternion", "GJK", "RBSFunctions", "RigidBodySimulation")
PROGRAM_FOLDER = Path(__file__).resolve().parents[2]
# Stand-ins for the modules that the released code imports: cppyy, InitializeCCD, RBSLoadVis. An
# installed package contains them, as it does `rbs.scenes.scenefiles.DATA_FOLDER`.
_INSTALLED = PROGRAM_FOLDER / "rbs" / "released"
STAND_INS = _INSTALLED if _INSTALLED.is_dir() else PROGRAM_FOLDER / "graders" / "released"
# Modules that the coursework supplies, and that a submission may lack.
SUPPLIED = ("Quaternion", "RBSLoadVis", "InitializeCCD", "RigidBodySimulation")
# What a step calls of a student's module, and of its Mesh.
POSITION, VELOCITY = "resolve_position_constraint", "resolve_velocity_constraint"
FUNCTIONS = "resolve_collision", POSITION, VELOCITY
TENSOR, DETECT = "get_rotated_inv_IT", "detect_collision"
METHODS = "integrate_timestep", TENSOR, DETECT
# Folders without a solution, in lower case; those that begin with a dot are skipped, too.
SKIPPED = {"__pycache__", "__macosx", "env", "venv", "node_modules", "site-packages"}
# Characters, the most that are quoted of a message of a student's code.
CAUSE_LENGTH = 300
# Before the names of a student's modules.
PRIVATE = re.compile(r"\bprivate\d+[.]")
STREAMS = "stdout", "stderr", "__stdout__", "__stderr__"


class SubmissionError(InputError):
    """A submission cannot be loaded. The message gives the cause in one line.

    remedy : what lets it be imported, if that is not a matter of the student's code; or ""
    """

    def __init__(self, cause, remedy=""):
        super().__init__(short(cause, limit=CAUSE_LENGTH))
        self.remedy = remedy


def is_skipped(name):
    """Whether a file or folder of this name is no part of a submission."""
    return name.startswith(".") or name.lower() in SKIPPED


class PrivateModules:
    """Modules of some folders, under names of their own, whatever else has their names.

    They import each other by their plain names, and everything else as usual.
    """

    _numbers = count()

    def __init__(self, folders, hidden=()):
        """folders : where modules are looked for, in this order
        hidden : names of modules that those in the first folder cannot import from elsewhere
        """
        package = ModuleType(f"private{next(self._numbers)}")
        package.__path__ = [str(folder) for folder in folders]
        self.name, self._folders, self._hidden = package.__name__, package.__path__, hidden
        sys.modules[self.name] = package
        sys.meta_path.insert(0, self)

    def load(self, name):
        """Imports the module of that name, and returns it."""
        return importlib.import_module(f"{self.name}.{name}")

    def find_spec(self, name, path=None, target=None):
        """Finds these modules for Python's import system."""
        spec = PathFinder.find_spec(name, path) if name.startswith(f"{self.name}.") else None
        if spec is not None and isinstance(spec.loader, SourceFileLoader):
            spec.loader = _Loader(spec.loader.name, spec.loader.path)
            spec.loader.import_ = self._import
        return spec

    def _has(self, name):
        folders = [Path(one) for one in self._folders]
        isFile = any((one / f"{name}.py").is_file() for one in folders)
        return isFile or any(any((one / name).glob("*.py")) for one in folders)

    def _import(self, name, variables=None, local=None, fromList=(), level=0):
        """What `__import__` is for these modules."""
        top, given = name.partition(".")[0], (variables, local, fromList, level)
        if level == 0 and top not in sys.builtin_module_names and self._has(top):
            if fromList:
                return builtins.__import__(f"{self.name}.{name}", *given)
            self.load(name)
            return sys.modules[f"{self.name}.{top}"]
        file = (variables or {}).get("__file__") or ""
        if level == 0 and top in self._hidden and file.startswith(self._folders[0]):
            raise ModuleNotFoundError(f"No module named {top!r}", name=top)
        return builtins.__import__(name, *given)


class _Loader(SourceFileLoader):
    def exec_module(self, module):
        vars(module)["__builtins__"] = vars(builtins) | {"__import__": self.import_}
        super().exec_module(module)


class _Stream:
    """A stream that a student's code may write to, wrap, as by io.TextIOWrapper, and not close."""

    def __init__(self, stream):
        self._stream = stream

    def __getattr__(self, name):
        found = getattr(self._stream, name)
        return _Stream(found) if name == "buffer" else found

    def detach(self):
        return self.buffer

    def close(self):
        pass


@contextmanager
def at_home(folder):
    """Lets a student's code run in its folder, and then restores the process's working folder,
    streams and NumPy errors. Meanwhile, `os._exit` raises SystemExit.
    """
    before, leave, process = os.getcwd(), os._exit, os.getpid()
    streams = {name: getattr(sys, name) for name in STREAMS}

    def leave_code(code):
        if os.getpid() == process:  # not one that it has forked
            raise SystemExit(code)
        leave(code)

    try:
        os.chdir(folder)
        os._exit = leave_code
        for name, stream in streams.items():
            setattr(sys, name, stream and _Stream(stream))
        with np.errstate():
            yield
    finally:
        os._exit = leave
        vars(sys).update(streams)
        os.chdir(before)


class Submission(NamedTuple):
    """A student's loaded modules.

    folder : their folder; functions, quaternion : the modules RBSFunctions and Quaternion, both
        RBSFunctions if that defines the quaternions itself; remarks : which modules were supplied
    """

    folder: Path
    functions: ModuleType
    quaternion: ModuleType
    remarks: list


def load_submission(folder):
    """Imports a student's modules, under names of their own; returns a `Submission`.

    Imports look in the folder first, then among the stand-ins for the modules that the coursework
    supplies. This project's other modules are hidden.

    Raises SubmissionError, which does not name the folder, if the modules cannot be imported; with
    file and line if they are known, and a remedy if a package, a file or a display is missing.
    """
    if not Path(folder, "RBSFunctions.py").is_file():
        told = "not a folder" if Path(folder).is_file() else "no such folder"
        raise SubmissionError("holds no RBSFunctions.py" if Path(folder).is_dir() else told)
    folder = Path(folder).resolve()
    modules = PrivateModules([folder, STAND_INS, STAND_INS / "supplied"], {*OUR_MODULES, "rbs"})
    lacking = [name for name in SUPPLIED if not (folder / f"{name}.py").is_file()]
    try:
        with at_home(folder):
            quaternion = functions = modules.load("RBSFunctions")
            supplied = [name for name in lacking if f"{modules.name}.{name}" in sys.modules]
            if "Quaternion" not in lacking or not hasattr(functions, "QRotate"):
                quaternion = modules.load("Quaternion")
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a student's module may raise anything, even SystemExit
        cause, remedy = describe(error, folder), _remedy(error, folder)
        if isinstance(error, ImportError) and error.name in OUR_MODULES:
            cause = cause.partition("ModuleNotFoundError")[0] + f"there is no {error.name}.py"
        cause = short(cause, limit=CAUSE_LENGTH - 100) + f"; to do: {remedy}" * bool(remedy)
        raise SubmissionError(f"cannot be imported: {cause}", remedy) from None
    remarks = [f"{one}.py is not in the submission; the coursework supplies it" for one in supplied]
    return Submission(folder, functions, quaternion, remarks)


def _remedy(error, folder):
    if isinstance(error, ModuleNotFoundError):
        name = (error.name or "").partition(".")[0]
        return f"add the file {name}.py, or install the package of that name"
    if isinstance(error, NameError) and "get_ipython" in str(error):
        return "remove get_ipython(), which only notebooks have"
    if isinstance(error, FileNotFoundError):
        return f"hand in {error.filename}, or remove what reads it during the import"
    if isinstance(error, EOFError):
        return "remove the input() that is called during the import"
    if isinstance(error, SyntaxError | ValueError):
        paths = filter(Path.is_file, folder.glob("*.py"))
        wide = [one.name for one in paths if one.read_bytes()[:2] in UTF16_MARKS]
        return f"save {', '.join(wide)} as UTF-8" if wide else ""
    if re.search(r"display|GLFW|OpenGL|libGL|\bX11\b|backend|polyscope", str(error), re.IGNORECASE):
        return "remove what opens a window during the import"
    return ""


def built(Mesh, name="", vertices=(), faces=(), tets=(), density=0.0, position=(0, 0, 0),
          orientation=(1, 0, 0, 0), isFixed=True):  # fmt: skip
    """A student's mesh, of new arrays, as the released one changes them; by default, the ground."""
    tables = (vertices, float, 3), (faces, int, 3), (tets, int, 4)
    tables = [np.array(one, kind).reshape(-1, width) for one, kind, width in tables]
    pose = np.array(position, float).reshape(1, 3), np.array(orientation, float).reshape(1, 4)
    return Mesh(name, *tables, density, *pose, isFixed)


def describe(error, folder):
    """Returns an exception as "file:line in function, called from file:line …: type: message".

    The lines are those of the student's own files, innermost first, at most three, or none.
    folder : of the submission
    """
    folder = Path(folder).resolve()
    message = short(PRIVATE.sub("", str(error)), limit=CAUSE_LENGTH)
    text = f"{type(error).__name__}: {message}" if message else type(error).__name__
    places = []
    for one in traceback.extract_tb(error.__traceback__):
        if _within(one.filename, folder):
            function = "" if one.name == "<module>" else f" in {one.name}"
            places.insert(0, f"{Path(one.filename).name}:{one.lineno}{function}")
    if isinstance(error, SyntaxError) and error.filename and _within(error.filename, folder):
        places = [f"{Path(error.filename).name}:{error.lineno}"]
        text = f"{type(error).__name__}: {short(error.msg, limit=CAUSE_LENGTH)}"
    return ": ".join([", called from ".join(places[:3]), text] if places else [text])


def _within(file, folder):
    try:
        return not file.startswith("<") and Path(file).resolve().is_relative_to(folder)
    except (OSError, ValueError):
        return False
