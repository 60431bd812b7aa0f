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

from rbs.messages import InputError, one_line, short

# The modules beside the package, whose names a submission may take.
OUR_MODULES = ("Quaternion", "GJK", "RBSFunctions", "RigidBodySimulation")
PROGRAM_FOLDER = Path(__file__).resolve().parents[1]
# What the released code imports besides NumPy and SciPy: cppyy, InitializeCCD, RBSLoadVis. It lies
# within the package where that is installed, as `rbs.scenes.DATA_FOLDER` does.
_INSTALLED = PROGRAM_FOLDER / "rbs" / "released"
STAND_INS = _INSTALLED if _INSTALLED.is_dir() else PROGRAM_FOLDER / "graders" / "released"
# The modules that a submission may bring. Where it lacks one, ours takes its place.
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
    """Loaded modules of a student, or ours where the student has none.

    folder : where they lie
    functions, quaternion : the modules RBSFunctions and Quaternion
    missing : names of the modules that are ours
    """

    folder: Path
    functions: ModuleType
    quaternion: ModuleType
    missing: tuple


def check_folder(folder):
    """Raises SubmissionError unless the folder holds a module that a submission may bring."""
    folder = Path(folder)
    if not folder.is_dir():
        raise SubmissionError(f"{folder}: there is no such folder")
    if not any((folder / f"{name}.py").is_file() for name in SUBMITTED_MODULES):
        files = " nor ".join(f"{name}.py" for name in SUBMITTED_MODULES)
        raise SubmissionError(f"{folder}: holds neither {files}")


def load_submission(folder, keepsNames=True):
    """Imports a student's modules.

    keepsNames : whether they have the names in this process from now on; if not, ours have them
        again as soon as the student's are loaded, and the folder goes to the end of the path

    Imports look in the folder first, then among the stand-ins for what the released code needs.
    If RBSFunctions.py is missing, ours is used with our own Quaternion, since ours needs more of
    it than the coursework asks for.

    Returns a Submission. Raises SubmissionError, with file and line where the cause has them.
    """
    check_folder(folder)
    folder = Path(folder).resolve()
    missing = tuple(name for name in SUBMITTED_MODULES if not (folder / f"{name}.py").is_file())
    ours = {name: our_module(name) for name in missing}
    dropped = _give_up_names(folder)
    sys.modules.update(ours)
    theirs = [str(folder), str(STAND_INS)]
    sys.path[:0] = theirs
    try:
        modules = [importlib.import_module(name) for name in SUBMITTED_MODULES]
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever a student's module raises, SystemExit included
        raise SubmissionError(f"cannot be imported: {describe(error, folder)}") from None
    if not keepsNames:
        sys.path[:] = sys.path[2:] + theirs
        sys.modules.update(dropped)
    return Submission(folder, *modules, missing)


def _give_up_names(folder):
    """Drops, and returns in a dict, our modules and stand-ins whose names the folder has files of.

    Modules of Python and of installed packages stay: a student's random.py is not ours to load in
    place of Python's own.
    """
    dropped = {}
    for name in {path.stem for path in folder.iterdir()} & set(sys.modules):
        module = sys.modules[name]
        file = getattr(module, "__file__", None)
        isStandIn = file is not None and Path(file).resolve().parent == STAND_INS
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
        return Path(file).resolve().is_relative_to(folder)
    except (OSError, ValueError):
        return False
