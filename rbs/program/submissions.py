"""Someone else's modules in place of ours: finding, loading and describing a student's work.

A submission is a folder with a student's `RBSFunctions.py`, `Quaternion.py` and whatever they
import, under the very names that our own modules have. Both can be loaded in one process:
`load_submission` gives the names to the student, and `our_module` finds ours all the same.

Loading a submission runs its code with the rights of whoever asks for it.
"""

import importlib
import sys
import traceback
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from rbs.scenes.messages import InputError, one_line, short

# The modules beside the package, whose names a submission may take.
OUR_MODULES = ("Quaternion", "GJK", "RBSFunctions", "RigidBodySimulation")
PROGRAM_FOLDER = Path(__file__).resolve().parents[2]
# What the released code imports besides NumPy and SciPy: cppyy, InitializeCCD, RBSLoadVis. It lies
# within the package where that is installed, as `rbs.scenes.scenefiles.DATA_FOLDER` does.
_INSTALLED = PROGRAM_FOLDER / "rbs" / "released"
STAND_INS = _INSTALLED if _INSTALLED.is_dir() else PROGRAM_FOLDER / "graders" / "released"
# The modules that a submission brings: the first in any case, the second where the first needs it.
SUBMITTED_MODULES = ("RBSFunctions", "Quaternion")


class SubmissionError(InputError):
    """A submission that cannot be loaded. The message is the cause, in one line."""

    def __init__(self, cause):
        super().__init__(brief(cause))


def brief(text, limit=300):
    """What a submission says, in one line with single blanks, cut off at `limit` characters."""
    return short(*one_line(text or " ").split(), limit=limit)


# ---- Our own modules ----------------------------------------------------------------------------

_OURS = {}  # our modules that are loaded but not in sys.modules, by name


def our_module(name):
    """This project's module of that name, whoever has the name in this process.

    name : of a module in the project's folder, such as "GJK" or "RBSFunctions"
    """
    loaded = sys.modules.get(name)
    if _is_ours(loaded):
        return loaded
    with _our_names():
        return importlib.import_module(name)


def _is_ours(module):
    """Whether it is one of our modules; where they are installed, others lie beside them."""
    if getattr(module, "__name__", None) not in OUR_MODULES:
        return False
    file = getattr(module, "__file__", None)
    return file is not None and Path(file).resolve().parent == PROGRAM_FOLDER


@contextmanager
def _our_names():
    """Within it, imports find the modules in the project's folder; afterwards, those from before.

    Our modules get to know each other by these imports, and keep working when their names are
    given back.
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


# ---- A student's modules ------------------------------------------------------------------------


@dataclass(frozen=True)
class Submission:
    """Loaded modules of a student.

    folder : where they lie
    functions, quaternion : the modules RBSFunctions and Quaternion; without a Quaternion.py both
        are RBSFunctions, which then has its functions or does without
    missing : names of the modules that are not there
    """

    folder: Path
    functions: ModuleType
    quaternion: ModuleType
    missing: tuple


def check_folder(folder):
    """Raises SubmissionError unless the folder holds RBSFunctions.py."""
    folder = Path(folder)
    if not folder.is_dir():
        raise SubmissionError(f"{folder}: there is no such folder")
    if not (folder / "RBSFunctions.py").is_file():
        raise SubmissionError(f"{folder}: holds no RBSFunctions.py")


def load_submission(folder, keepsNames=True):
    """Imports a student's modules.

    keepsNames : whether they have the names in this process from now on; if not, ours have them
        again as soon as the student's are loaded, and the folder goes to the end of the path

    Imports look in the folder first, then among the stand-ins for what the released code needs.
    Our own modules are not found, so that none takes the place of one that the folder lacks.

    Returns a Submission. Raises SubmissionError, with file and line where the cause has them.
    """
    check_folder(folder)
    folder = Path(folder).resolve()
    lacking = [name for name in OUR_MODULES if not (folder / f"{name}.py").is_file()]
    missing = tuple(name for name in SUBMITTED_MODULES if name in lacking)
    dropped = _give_up_names({path.stem for path in folder.iterdir()} | set(lacking))
    sys.modules.update(dict.fromkeys(lacking))  # None: no import finds them
    theirs = [str(folder), str(STAND_INS)]
    sys.path[:0] = theirs
    try:
        functions = importlib.import_module("RBSFunctions")
        quaternion = functions if missing else importlib.import_module("Quaternion")
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever a student's module raises, SystemExit included
        cause = describe(error, folder)
        if isinstance(error, ImportError) and error.name in lacking:
            cause = cause.partition("ModuleNotFoundError")[0] + f"there is no {error.name}.py"
        raise SubmissionError(f"cannot be imported: {cause}") from None
    finally:
        if not keepsNames:
            sys.path[:] = sys.path[2:] + theirs
            for name in lacking:
                sys.modules.pop(name, None)
            sys.modules.update(dropped)
    return Submission(folder, functions, quaternion, missing)


def _give_up_names(names):
    """Drops, and returns in a dict, our modules, graders and stand-ins of these names.

    Modules of Python and of installed packages stay: a student's random.py is not ours to load in
    place of Python's own.
    """
    dropped = {}
    for name in sorted(names & set(sys.modules)):
        module = sys.modules[name]
        file = getattr(module, "__file__", None)
        isStandIn = file is not None and STAND_INS in (
            Path(file).resolve().parent,
            Path(file).resolve().parent / "released",
        )
        if isStandIn or _is_ours(module):
            dropped[name] = sys.modules.pop(name)
            if _is_ours(module):
                _OURS[name] = module
    return dropped


def describe(error, folder):
    """An exception as "file:line in function, called from file:line in function: type: message".

    The lines are the student's own, the innermost first, and three at most; where no line of theirs
    had a part in it, they are left out. folder : of the submission
    """
    folder = Path(folder).resolve()
    message = brief(str(error))
    text = f"{type(error).__name__}: {message}" if message else type(error).__name__
    places = []
    for frame, line in traceback.walk_tb(error.__traceback__):
        code = frame.f_code
        if _within(code.co_filename, folder):
            function = "" if code.co_name == "<module>" else f" in {code.co_name}"
            places.insert(0, f"{Path(code.co_filename).name}:{line}{function}")
    if isinstance(error, SyntaxError) and error.filename and _within(error.filename, folder):
        places = [f"{Path(error.filename).name}:{error.lineno}"]
        text = f"{type(error).__name__}: {brief(error.msg)}"
    return ": ".join([", called from ".join(places[:3]), text] if places else [text])


def _within(file, folder):
    try:
        return not file.startswith("<") and Path(file).resolve().is_relative_to(folder)
    except (OSError, ValueError):
        return False
