"""Loading a student's modules, which have the same names as this project's.

A submission is a folder with a student's `RBSFunctions.py`, `Quaternion.py` and the modules that
they import. Both sets of modules can be loaded in one process: `load_submission` gives the names to
the student's, and `our_module` still finds this project's.

Loading a submission runs its code with the rights of the user. From the top: this project's
modules; a student's.
"""

import importlib
import re
import sys
import traceback
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

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
# Packages that students import, and what pip calls them.
_NAMES = "numba torch seaborn pandas sympy matplotlib scipy jax tensorflow trimesh networkx plotly"
PACKAGES = dict.fromkeys(_NAMES.split())
PACKAGES |= {"cv2": "opencv-python", "sklearn": "scikit-learn", "PIL": "pillow"}


# Characters, the most that are quoted of a message of a student's code.
CAUSE_LENGTH = 300


class SubmissionError(InputError):
    """A submission cannot be loaded. The message gives the cause in one line.

    remedy : what lets it be imported, if that is not a matter of the student's code; or ""
    """

    def __init__(self, cause, remedy=""):
        super().__init__(short(cause, limit=CAUSE_LENGTH))
        self.remedy = remedy


_OURS = {}  # modules of this project that are loaded but not in sys.modules, by name


def our_module(name):
    """Returns this project's module of that name, even if a submission uses the name.

    name : of a module at the top of the project, such as "GJK" or "RBSFunctions"
    """
    loaded = sys.modules.get(name)
    if _is_ours(loaded):
        return loaded
    with _our_names():
        return importlib.import_module(name)


def _is_ours(module):
    """Returns whether a module is one of this project's."""
    if getattr(module, "__name__", None) not in OUR_MODULES:
        return False
    file = getattr(module, "__file__", None)
    return file is not None and Path(file).resolve().parent == PROGRAM_FOLDER


@contextmanager
def _our_names():
    """Makes imports find the project's modules, then restores the previous ones.

    The project's modules import each other meanwhile, and keep working afterwards.
    """
    names = set(OUR_MODULES)
    hidden = {name: sys.modules.pop(name) for name in names & set(sys.modules)}
    sys.modules.update({name: module for name, module in hidden.items() if _is_ours(module)})
    sys.modules.update(_OURS)
    path = sys.path[:]
    sys.path.insert(0, str(PROGRAM_FOLDER))
    try:
        yield
    finally:
        sys.path[:] = path
        _OURS.update({name: sys.modules.pop(name) for name in names & set(sys.modules)})
        sys.modules.update(hidden)


@dataclass(frozen=True)
class Submission:
    """A student's loaded modules.

    folder : their folder
    functions, quaternion : the modules RBSFunctions and Quaternion. Both are RBSFunctions if that
        defines the quaternions itself
    remarks : list of str, which modules were supplied
    """

    folder: Path
    functions: ModuleType
    quaternion: ModuleType
    remarks: list


def check_folder(folder):
    """Raises SubmissionError unless the folder contains RBSFunctions.py."""
    folder = Path(folder)
    if not folder.is_dir():
        raise SubmissionError(f"{folder}: no such folder")
    if not (folder / "RBSFunctions.py").is_file():
        raise SubmissionError(f"{folder}: holds no RBSFunctions.py")


def load_submission(folder, keepsNames=True):
    """Imports a student's modules; returns a `Submission`.

    Imports look in the folder first, then among the stand-ins for the released modules, and last
    among those of `SUPPLIED` that this project has. Its other modules are hidden.
    keepsNames : whether the student's modules keep the names in this process. If not, this
        project's get them back after loading, and the folder moves to the end of the path

    Raises SubmissionError if the modules cannot be imported; with file and line if they are known,
    and a remedy if a package, a file or a display is missing.
    """
    check_folder(folder)
    folder = Path(folder).resolve()
    lacking = {*OUR_MODULES, *SUPPLIED} - {path.stem for path in folder.glob("*.py")}
    dropped = _give_up_names({path.stem for path in folder.iterdir()} | lacking)
    hidden = lacking - set(SUPPLIED)
    sys.modules.update(dict.fromkeys(hidden))  # None: no import finds them
    theirs = [str(folder), str(STAND_INS), str(STAND_INS / "ours")]
    sys.path[:0] = theirs
    try:
        quaternion = functions = importlib.import_module("RBSFunctions")
        supplied = [name for name in SUPPLIED if name in lacking and name in sys.modules]
        if "Quaternion" not in lacking or not hasattr(functions, "QRotate"):
            quaternion = importlib.import_module("Quaternion")
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a student's module may raise anything, even SystemExit
        cause, remedy = describe(error, folder), _remedy(error)
        if isinstance(error, ImportError) and error.name in hidden:
            cause = cause.partition("ModuleNotFoundError")[0] + f"there is no {error.name}.py"
        cause += f"; to do: {remedy}" * bool(remedy)
        raise SubmissionError(f"cannot be imported: {cause}", remedy) from None
    finally:
        if not keepsNames:
            sys.path[:] = sys.path[3:] + theirs
            for name in lacking:
                sys.modules.pop(name, None)
            sys.modules.update(dropped)
    remarks = [f"{one}.py is not in the submission; the coursework supplies it" for one in supplied]
    return Submission(folder, functions, quaternion, remarks)


def _remedy(error):
    """What to do if an import fails for a reason that is not the student's mistake, or ""."""
    if isinstance(error, ModuleNotFoundError):
        name = (error.name or "").partition(".")[0]
        if name in PACKAGES:
            return f"pip install {PACKAGES[name] or name}"
        return f"add the file {name}.py, or the package of that name"
    if isinstance(error, EOFError):
        return "remove the input() that is called during the import"
    if re.search(r"display|GLFW|OpenGL|libGL|\bX11\b", str(error)):
        return "remove what opens a window during the import"
    return ""


def _give_up_names(names):
    """Drops this project's modules, graders and stand-ins of these names. Returns them in a dict.

    Modules of Python and of installed packages stay: a student's random.py must not replace
    Python's own.
    """
    dropped = {}
    for name in sorted(names & set(sys.modules)):
        module = sys.modules[name]
        file = getattr(module, "__file__", None)
        isStandIn = file is not None and STAND_INS in (
            *Path(file).resolve().parents[:2],
            Path(file).resolve().parent / "released",
        )
        if isStandIn or _is_ours(module):
            dropped[name] = sys.modules.pop(name)
            if _is_ours(module):
                _OURS[name] = module
    return dropped


def describe(error, folder):
    """Returns an exception as "file:line in function, called from file:line …: type: message".

    The lines are those of the student's own files, innermost first, at most three, or none.
    folder : of the submission
    """
    folder = Path(folder).resolve()
    message = short(str(error), limit=CAUSE_LENGTH)
    text = f"{type(error).__name__}: {message}" if message else type(error).__name__
    places = []
    for frame, line in traceback.walk_tb(error.__traceback__):
        code = frame.f_code
        if _within(code.co_filename, folder):
            function = "" if code.co_name == "<module>" else f" in {code.co_name}"
            places.insert(0, f"{Path(code.co_filename).name}:{line}{function}")
    if isinstance(error, SyntaxError) and error.filename and _within(error.filename, folder):
        places = [f"{Path(error.filename).name}:{error.lineno}"]
        text = f"{type(error).__name__}: {short(error.msg, limit=CAUSE_LENGTH)}"
    return ": ".join([", called from ".join(places[:3]), text] if places else [text])


def _within(file, folder):
    try:
        return not file.startswith("<") and Path(file).resolve().is_relative_to(folder)
    except (OSError, ValueError):
        return False
