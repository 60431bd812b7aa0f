"""What the graders share: safe reading of grader data, and options.

Grader data are Python pickles (contract, section 3). A pickle is a program that may call any
function it names, so they are read through an unpickler that knows a handful of names only.

This module knows nothing of the simulation, so that `make_reference.py` can use it too.
"""

import argparse
import io
import pickle
import pickletools
import sys
from pathlib import Path

import numpy as np

PROJECT_DIRECTORY = Path(__file__).resolve().parents[1]
DATA_DIRECTORY = PROJECT_DIRECTORY / "data"
# A grader started from anywhere finds the project's modules. To import this module first is enough.
sys.path.insert(0, str(PROJECT_DIRECTORY))

# The physics as it is, and the physics as the coursework's 2024 release computed it (quirks 1 to 3
# of the contract).
EXACT = "exact"
RELEASED_2024 = "released-2024"
CONVENTIONS = (EXACT, RELEASED_2024)

# The largest absolute error allowed in any quantity. The quantities are of size 1 to 100 and take a
# few dozen roundings, about 1e-13 in all; an error in a formula shows at 1e-3 or more.
ERROR_BOUND = 1e-9

PASSED, FAILED, BAD_DATA = 0, 1, 2
STOPPED = 130  # 128 + SIGINT, as a shell reports a program that Ctrl-C ended


def printable(text):
    """The text in one line, without what a terminal would take for orders."""
    return "".join(c if c.isprintable() else " " for c in text)


class GraderDataError(Exception):
    """The data cannot be graded against; the message is the cause, in one line."""

    def __init__(self, cause):
        super().__init__(printable(str(cause)))


# ---- Layout of the data -------------------------------------------------------------------------

# An entry of a file is a kind of number and the lengths of the axes; an axis given by name has the
# same length wherever the name appears. Floats are computed with, and have to be finite; results
# need not be, such as the depth of bodies that do not touch.
RESULT = "result"
KINDS = {  # kinds of NumPy's that may be stored, and the dtype that is made of them
    float: ("fiu", np.float64),
    RESULT: ("fiu", np.float64),
    int: ("iu", np.int64),
    bool: ("biu", np.bool_),
}
WIDTHS = {"Positions": 3, "Orientations": 4, "LinVelocities": 3, "AngVelocities": 3}

_STATES = {f"random{name}": (float, "samples", width) for name, width in WIDTHS.items()}
_MESHES = {
    f"{part}{k}": (kind, f"{part}{k}", width)
    for k in (1, 2)
    for part, kind, width in (("origVertices", float, 3), ("faces", int, 3), ("tets", int, 4))
}
_PAIR = (RESULT, 2, "samples", 3)
INTEGRATION_LAYOUT = _STATES | {
    f"result{name}": (RESULT, "samples", width) for name, width in WIDTHS.items()
}
COLLISION_LAYOUT = (
    _MESHES
    | _STATES
    | {
        "isCollision": (bool, "samples"),
        "depth": (RESULT, "samples"),
        "intNormal": (RESULT, "samples", 3),
        "intPosition": (RESULT, "samples", 3),
        **{f"result{name}": (RESULT, 2, "samples", width) for name, width in WIDTHS.items()},
    }
)
CONSTRAINT_LAYOUT = (
    _MESHES
    | _STATES
    | {
        "refValues": (float, "samples", 1),
        "positionWasValidUpper": (bool, "samples"),
        "correctedPositionsUpper": _PAIR,
        "positionWasValidLower": (bool, "samples"),
        "correctedPositionsLower": _PAIR,
        "velocityWasValid": (bool, "samples"),
        "correctedLinVelocities": _PAIR,
        "correctedAngVelocities": _PAIR,
    }
)


# ---- Reading pickles ----------------------------------------------------------------------------

PLAIN_DTYPES = {"f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "b1"}


class _Dtype:
    """In place of `numpy.dtype`, which takes its state from the file on trust, and may crash."""

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


# NumPy 2 has moved `numpy.core` to `numpy._core`: both are left out of the names.
_ADMITTED = {
    "numpy.dtype": _Dtype,
    "numpy.ndarray": None,  # is only ever handed to `_reconstruct`
    "multiarray._reconstruct": lambda *_: np.ndarray.__new__(_Array, (0,)),
    "multiarray.scalar": lambda stored, payload: np.frombuffer(payload, stored.dtype)[0],
    "numeric._frombuffer": lambda payload, stored, shape, order: np.frombuffer(
        payload, stored.dtype
    ).reshape(shape, order=order),
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
    """The data of a pickle, checked against its layout.

    layout : dict from key to (kind, axes...); further keys in the file are ignored
    Returns a dict from key to array, of dtype float64, int64 or bool and of the layout's shape.
    Raises GraderDataError.
    """
    try:
        content = Path(path).read_bytes()
        # The unpickler makes room for as many values as the largest number given to one says.
        for opcode, argument, _position in pickletools.genops(content):
            if opcode.name.endswith("PUT") and argument > len(content):
                raise pickle.UnpicklingError("it numbers more values than it can hold")
        stored = PlainUnpickler(io.BytesIO(content)).load()
    except OSError as problem:
        raise GraderDataError(f"cannot be read: {problem.strerror or problem}") from None
    except Exception as problem:  # A damaged pickle can raise almost anything; see `pickle`.
        cause = " ".join(str(problem).split()) or type(problem).__name__
        raise GraderDataError(f"not a readable data file: {cause}") from None

    if not isinstance(stored, dict):
        raise GraderDataError(f"holds a {type(stored).__name__} in place of a dictionary")
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
    """The array that a stored value stands for; ValueError says what is wrong with it.

    lengths : dict from the name of an axis to the length seen first, updated here
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
        raise ValueError(f"has shape {array.shape} in place of {expected}")
    if array.size == 0:
        raise ValueError("is empty")
    if kind is bool and not np.isin(array, (0, 1)).all():
        raise ValueError("holds something other than True and False")
    if kind is float and not np.isfinite(array).all():
        raise ValueError("holds a number that is not finite")
    return array.astype(dtype)


def _check_meaning(data):
    """Refuses numbers of the right shape that no body can have, and results that are not there."""
    if not np.all(np.any(data["randomOrientations"] != 0, axis=1)):
        raise GraderDataError("randomOrientations holds a zero quaternion")
    results = [array for key, array in data.items() if key.startswith("result")]
    if results and not any(map(np.any, results)):
        raise GraderDataError("no sample has a result")
    for key in (f"{part}{k}" for part in ("faces", "tets") for k in (1, 2) if f"tets{k}" in data):
        if not set(data[key].flat) <= set(range(len(data[f"origVertices{key[-1]}"]))):
            raise GraderDataError(f"{key} names a vertex that does not exist")


# ---- Command lines ------------------------------------------------------------------------------


class OneLineParser(argparse.ArgumentParser):
    """Reports a wrong command line in one line, without the usage before it."""

    def error(self, message):
        self.exit(BAD_DATA, f"{self.prog}: {printable(message)} (--help lists the options)\n")


def add_convention_argument(parser, default=EXACT):
    parser.add_argument(
        "--convention",
        choices=CONVENTIONS,
        default=default,
        help="the physics behind the data: right, or as released with the coursework in 2024 "
        f"(default: {default or 'recognised from the data'})",
    )
