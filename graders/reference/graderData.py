"""Reads grader data safely, and checks them against their layout.

Grader data are Python pickles (contract, section 3). A pickle is a program that may call any
function it names, so an unpickler is used that admits a handful of names only. `make_reference.py`
uses this module, too, so it knows nothing of the simulation.
"""

import io
import pickle
import pickletools
import sys
from pathlib import Path

import numpy as np

PROJECT_DIRECTORY = Path(__file__).resolve().parents[2]
DATA_DIRECTORY = PROJECT_DIRECTORY / "data"
# Lets graders that are started anywhere find the project's modules. Import this module first.
sys.path.insert(0, str(PROJECT_DIRECTORY))

# The right physics, and those of the coursework's 2024 release (quirks 1 to 3 of the contract).
CONVENTIONS = EXACT, RELEASED_2024 = "exact", "released-2024"

# The largest absolute error allowed. Quantities are of size 1 to 100 and take a few dozen
# roundings, about 1e-13 in all; a wrong formula changes them by 1e-3 or more.
ERROR_BOUND = 1e-9


def give_up_names():
    """Lets a student's modules have the names of the graders' folders, once these are imported."""
    folders = {path.name for path in Path(__file__).resolve().parents[1].iterdir() if path.is_dir()}
    for name in [name for name in sys.modules if name.partition(".")[0] in folders]:
        del sys.modules[name]


def printable(text):
    """Returns the text in one line, without characters that control a terminal."""
    return "".join(c if c.isprintable() else " " for c in text)


class GraderDataError(Exception):
    """Data that cannot be graded against. The message is the cause, in one line."""

    def __init__(self, cause):
        super().__init__(printable(str(cause)))


# ---- Layout of the data -------------------------------------------------------------------------

# An entry of a file is a kind of number and the lengths of its axes; a named axis has the same
# length wherever the name appears. Inputs (float) must be finite; results need not be, such as the
# depth of bodies that do not touch.
RESULT = "result"
KINDS = {  # the NumPy kinds that may be stored, and the dtype that they are converted to
    float: ("fiu", np.float64),
    RESULT: ("fiu", np.float64),
    int: ("iu", np.int64),
    bool: ("biu", np.bool_),
}
WIDTHS = {"Positions": 3, "Orientations": 4, "LinVelocities": 3, "AngVelocities": 3}


def _entries(names, kind, *axes):
    return {name: (kind, *axes) for name in names.split()}


_STATES = {f"random{name}": (float, "samples", width) for name, width in WIDTHS.items()}
_MESHES = {
    f"{part}{k}": (kind, f"{part}{k}", width)
    for k in (1, 2)
    for part, kind, width in (("origVertices", float, 3), ("faces", int, 3), ("tets", int, 4))
}
INTEGRATION_LAYOUT = _STATES | {
    f"result{name}": (RESULT, "samples", width) for name, width in WIDTHS.items()
}
COLLISION_LAYOUT = {
    **_MESHES,
    **_STATES,
    **_entries("isCollision", bool, "samples"),
    **_entries("depth", RESULT, "samples"),
    **_entries("intNormal intPosition", RESULT, "samples", 3),
    **{f"result{name}": (RESULT, 2, "samples", width) for name, width in WIDTHS.items()},
}
CONSTRAINT_LAYOUT = {
    **_MESHES,
    **_STATES,
    **_entries("refValues", float, "samples", 1),
    **_entries("positionWasValidUpper", bool, "samples"),
    **_entries("correctedPositionsUpper", RESULT, 2, "samples", 3),
    **_entries("positionWasValidLower", bool, "samples"),
    **_entries("correctedPositionsLower", RESULT, 2, "samples", 3),
    **_entries("velocityWasValid", bool, "samples"),
    **_entries("correctedLinVelocities correctedAngVelocities", RESULT, 2, "samples", 3),
}


# ---- Reading pickles ----------------------------------------------------------------------------

PLAIN_DTYPES = "f4 f8 i1 i2 i4 i8 u1 u2 u4 u8 b1".split()


class _Dtype:
    """Stands in for `numpy.dtype`, which trusts the state in the file and may crash."""

    def __init__(self, code, *_):
        if code not in PLAIN_DTYPES:
            raise pickle.UnpicklingError(f"an array of dtype {code!r} is not plain numbers")
        self.dtype = np.dtype(code)

    def __setstate__(self, state):
        self.dtype = self.dtype.newbyteorder(state[1])


class _Array(np.ndarray):
    def __setstate__(self, state):
        version, shape, stored, *rest = state
        super().__setstate__((version, shape, stored.dtype, *rest))


def _frombuffer(payload, stored, shape, order):
    return np.frombuffer(payload, stored.dtype).reshape(shape, order=order)


# Names without `numpy.core` or `numpy._core`, between which NumPy 2 has moved them.
_ADMITTED = {
    "numpy.dtype": _Dtype,
    "numpy.ndarray": None,  # is only ever passed to `_reconstruct`
    "multiarray._reconstruct": lambda *_: np.ndarray.__new__(_Array, (0,)),
    "multiarray.scalar": lambda stored, payload: np.frombuffer(payload, stored.dtype)[0],
    "numeric._frombuffer": _frombuffer,
    "_codecs.encode": lambda text, _latin1: text.encode("latin1"),
}


class PlainUnpickler(pickle.Unpickler):
    """Reads NumPy arrays of numbers, scalars and plain containers; refuses all else by name."""

    def find_class(self, module, name):
        short = module.removeprefix("numpy.core.").removeprefix("numpy._core.")
        if f"{short}.{name}" not in _ADMITTED:
            raise pickle.UnpicklingError(
                f"{module}.{name} is refused: only NumPy arrays and plain containers are admitted"
            )
        return _ADMITTED[f"{short}.{name}"]


def load_grader_data(path, layout):
    """Reads a pickle and checks it against a layout.

    Parameters
    ----------
    layout : dict from key to (kind, axes...); further keys in the file are ignored

    Returns
    -------
    dict from key to array, of dtype float64, int64 or bool and of the layout's shape

    Raises
    ------
    GraderDataError
    """
    try:
        content = Path(path).read_bytes()
        # The unpickler allocates as many slots as the largest slot number in the file.
        for opcode, argument, _position in pickletools.genops(content):
            if opcode.name.endswith("PUT") and argument > len(content):
                raise pickle.UnpicklingError("it numbers more values than it can hold")
        stored = PlainUnpickler(io.BytesIO(content)).load()
    except OSError as problem:
        raise GraderDataError(f"cannot be read: {problem.strerror or problem}") from None
    except Exception as problem:  # a damaged pickle can raise almost anything
        cause = " ".join(str(problem).split()) or type(problem).__name__
        raise GraderDataError(f"not a readable data file: {cause}") from None

    if not isinstance(stored, dict):
        raise GraderDataError(f"holds a {type(stored).__name__} instead of a dictionary")
    missing = [key for key in layout if key not in stored]
    if missing:
        raise GraderDataError(f"has no entry {', '.join(missing)}")
    lengths, data = {}, {}
    for key, (kind, *axes) in layout.items():
        try:
            data[key] = _checked_array(stored[key], kind, axes, lengths)
        except (ValueError, TypeError, RecursionError) as problem:
            raise GraderDataError(f"{key} {problem}") from None
    _check_meaning(data)
    return data


def _checked_array(value, kind, axes, lengths):
    """Returns a stored value as an array. Raises ValueError that continues "KEY ...".

    lengths : dict from the name of an axis to its length, filled in here
    """
    array = np.array(value)
    kinds, dtype = KINDS[kind]
    if array.ndim == len(axes) + 1 and array.shape[-1] == 1:
        array = array[..., 0]  # numbers that were collected in arrays of one
    if array.dtype.kind not in kinds:
        raise ValueError(f"holds {array.dtype} where {dtype.__name__} is expected")
    for axis, length in zip(axes, array.shape, strict=False):
        lengths.setdefault(axis, axis if isinstance(axis, int) else length)
    expected = tuple(lengths.get(axis, axis) for axis in axes)
    if array.shape != expected:
        raise ValueError(f"has shape {array.shape} instead of {expected}")
    if array.size == 0:
        raise ValueError("is empty")
    if kind is bool and not np.isin(array, (0, 1)).all():
        raise ValueError("holds something other than True and False")
    if kind is float and not np.isfinite(array).all():
        raise ValueError("holds a number that is not finite")
    return array.astype(dtype)


def _check_meaning(data):
    """Refuses numbers of the right shape that no body can have, and files without results."""
    if not np.all(np.any(data["randomOrientations"] != 0, axis=1)):
        raise GraderDataError("randomOrientations holds a zero quaternion")
    results = [array for key, array in data.items() if key.startswith("result")]
    if results and not any(map(np.any, results)):
        raise GraderDataError("no sample has a result")
    for key in (f"{part}{k}" for part in ("faces", "tets") for k in (1, 2) if f"tets{k}" in data):
        if not set(data[key].flat) <= set(range(len(data[f"origVertices{key[-1]}"]))):
            raise GraderDataError(f"{key} names a vertex that does not exist")
