"""What the three graders share: safe reading of grader data, and options.

Grader data are Python pickles (contract, section 3). A pickle is a program that may call any
function it names, so they are read through an unpickler that knows a handful of names only.

This module knows nothing of the simulation, so that `make_reference.py` can use it too.
"""

import argparse
import io
import os
import pickle
import pickletools
import stat
import sys
from dataclasses import dataclass
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


@dataclass(frozen=True)
class Layout:
    """One entry of a data file: its kind of number and its shape.

    kind : float, int (an index) or bool
    shape : lengths of the axes; one given by name must be the same wherever the name appears
    isInput : whether the graders compute with it, so that it has to be finite
    """

    kind: type
    shape: tuple
    isInput: bool = True


VECTORS = Layout(float, ("samples", 3))
QUATERNIONS = Layout(float, ("samples", 4))
FLAGS = Layout(bool, ("samples",), isInput=False)
RESULT_VECTORS = Layout(float, ("samples", 3), isInput=False)
RESULT_QUATERNIONS = Layout(float, ("samples", 4), isInput=False)
RESULT_VECTOR_PAIRS = Layout(float, (2, "samples", 3), isInput=False)
RESULT_QUATERNION_PAIRS = Layout(float, (2, "samples", 4), isInput=False)

_STATES = {
    "randomPositions": VECTORS,
    "randomOrientations": QUATERNIONS,
    "randomLinVelocities": VECTORS,
    "randomAngVelocities": VECTORS,
}
_MESHES = {
    f"{part}{k}": Layout(kind, (f"{part}{k}", width))
    for k in (1, 2)
    for part, kind, width in (("origVertices", float, 3), ("faces", int, 3), ("tets", int, 4))
}

INTEGRATION_LAYOUT = _STATES | {
    "resultPositions": RESULT_VECTORS,
    "resultOrientations": RESULT_QUATERNIONS,
    "resultLinVelocities": RESULT_VECTORS,
    "resultAngVelocities": RESULT_VECTORS,
}
COLLISION_LAYOUT = (
    _MESHES
    | _STATES
    | {
        "isCollision": FLAGS,
        # Of no meaning, and not bound to be finite, where there is no collision.
        "depth": Layout(float, ("samples",), isInput=False),
        "intNormal": RESULT_VECTORS,
        "intPosition": RESULT_VECTORS,
        "resultPositions": RESULT_VECTOR_PAIRS,
        "resultOrientations": RESULT_QUATERNION_PAIRS,
        "resultLinVelocities": RESULT_VECTOR_PAIRS,
        "resultAngVelocities": RESULT_VECTOR_PAIRS,
    }
)
CONSTRAINT_LAYOUT = (
    _MESHES
    | _STATES
    | {
        "refValues": Layout(float, ("samples", 1)),
        "positionWasValidUpper": FLAGS,
        "correctedPositionsUpper": RESULT_VECTOR_PAIRS,
        "positionWasValidLower": FLAGS,
        "correctedPositionsLower": RESULT_VECTOR_PAIRS,
        "velocityWasValid": FLAGS,
        "correctedLinVelocities": RESULT_VECTOR_PAIRS,
        "correctedAngVelocities": RESULT_VECTOR_PAIRS,
    }
)


# ---- Reading pickles that may be hostile --------------------------------------------------------

# Number types that an array in the data may have: floats, integers and bools of fixed size.
_PLAIN_DTYPES = {"f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "b1"}


class _StoredDtype:
    """Stands in for `numpy.dtype` while a file is read.

    NumPy's own takes its inner state from the file on trust: a dtype of Python objects that denies
    being one turns raw bytes into pointers, and the interpreter crashes at the first look.
    """

    __slots__ = ("dtype",)

    def __init__(self, code, *_):
        if code not in _PLAIN_DTYPES:
            raise pickle.UnpicklingError(f"an array of dtype {code!r} is not plain numbers")
        self.dtype = np.dtype(code)

    def __setstate__(self, state):
        _version, byteOrder, *_ = state
        self.dtype = self.dtype.newbyteorder(byteOrder)


class _StoredArray:
    """What an array is read into; `array` holds the real one.

    Called as `_reconstruct(ndarray, (0,), b"b")`, with the contents following by `__setstate__`.
    """

    __slots__ = ("array",)

    def __init__(self, *_):
        self.array = np.empty(0)

    def __setstate__(self, state):
        _version, shape, stored, isFortran, payload = state
        self.fill(payload, stored, shape, "F" if isFortran else "C")

    def fill(self, payload, stored, shape, order):
        self.array = np.frombuffer(payload, stored.dtype).reshape(shape, order=order).copy()


def _array_from_bytes(payload, stored, shape, order):
    """For `_frombuffer(payload, dtype, shape, order)`, as pickle protocol 5 stores arrays."""
    array = _StoredArray()
    array.fill(payload, stored, shape, order)
    return array


def _scalar(stored, payload):
    """For `scalar(dtype, payload)`: a plain Python number."""
    return np.frombuffer(payload, stored.dtype, count=1)[0].item()


def _latin1(text, encoding):
    """For `_codecs.encode(text, "latin1")`, as pickle protocols 0 to 2 store bytes."""
    if encoding != "latin1":
        raise pickle.UnpicklingError(f"bytes in the encoding {encoding!r} are not admitted")
    return text.encode("latin1")


# NumPy 2 moved `numpy.core` to `numpy._core`; files of either kind are read with either. The class
# `ndarray` is only ever handed to `_reconstruct`, and means nothing here.
_ADMITTED = {
    ("numpy", "dtype"): _StoredDtype,
    ("numpy", "ndarray"): None,
    ("numpy.core.multiarray", "_reconstruct"): _StoredArray,
    ("numpy._core.multiarray", "_reconstruct"): _StoredArray,
    ("numpy.core.multiarray", "scalar"): _scalar,
    ("numpy._core.multiarray", "scalar"): _scalar,
    ("numpy.core.numeric", "_frombuffer"): _array_from_bytes,
    ("numpy._core.numeric", "_frombuffer"): _array_from_bytes,
    ("_codecs", "encode"): _latin1,
}


class PlainUnpickler(pickle.Unpickler):
    """Reads NumPy arrays of numbers, scalars and plain containers; refuses all else by name."""

    def find_class(self, module, name):
        try:
            return _ADMITTED[module, name]
        except KeyError:
            raise pickle.UnpicklingError(
                f"{module}.{name} is refused: only NumPy arrays and plain containers are admitted"
            ) from None


def _read_pickle(payload):
    """The contents of a pickle (bytes), arrays as `_StoredArray`.

    Before anything is built, the slots are looked at in which a pickle keeps values for later: the
    unpickler makes room for as many as the largest number says, and five bytes can ask for 32 GB.
    """
    for opcode, argument, _position in pickletools.genops(payload):
        if opcode.name.endswith("PUT") and argument > len(payload):
            raise pickle.UnpicklingError("it numbers more values than it can hold")
    return PlainUnpickler(io.BytesIO(payload)).load()


# Data of a hundred samples take some 100 kB.
MOST_BYTES = 64 << 20


def _read_bytes(path):
    """The bytes of a file; GraderDataError for what has no end, or is too long, or is not there."""
    try:
        with open(path, "rb", opener=_open_at_once) as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise GraderDataError("cannot be read: it is not a file")
            if status.st_size > MOST_BYTES:
                raise GraderDataError(f"is longer than {MOST_BYTES} bytes")
            return file.read(status.st_size)
    except OSError as problem:
        raise GraderDataError(f"cannot be read: {problem.strerror or problem}") from None


def _open_at_once(path, flags):
    """Opens a file, also a pipe that nobody writes to, without waiting."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def load_grader_data(path, layout):
    """The data of a pickle, checked against its layout.

    path : the file
    layout : dict from key to Layout; further keys in the file are ignored
    Returns a dict from key to array, of dtype float64, int64 or bool and of the layout's shape.
    Raises GraderDataError.
    """
    try:
        stored = _read_pickle(_read_bytes(path))
    except GraderDataError:
        raise
    except Exception as problem:  # A damaged pickle can raise almost anything; see `pickle`.
        cause = " ".join(str(problem).split()) or type(problem).__name__
        raise GraderDataError(f"not a readable data file: {cause}") from None

    if not isinstance(stored, dict):
        raise GraderDataError(f"holds a {type(stored).__name__} in place of a dictionary")
    missing = [key for key in layout if key not in stored]
    if missing:
        raise GraderDataError(f"has no entry {', '.join(missing)}")
    lengths = {}
    data = {}
    for key, expected in layout.items():
        try:
            data[key] = _checked_array(stored[key], expected, lengths)
        except ValueError as problem:
            raise GraderDataError(f"{key} {problem}") from None
    _check_meaning(data)
    return data


def _checked_array(value, expected, lengths):
    """The array that a stored value stands for; ValueError tells what is wrong with it.

    lengths : dict from axis name to the length seen first, updated here
    """
    array = np.array(_gather(value, expected.shape, lengths))
    kinds = {float: "fiu", int: "iu", bool: "biu"}[expected.kind]
    if array.dtype.kind not in kinds:
        raise ValueError(f"holds {array.dtype} where {expected.kind.__name__} is expected")
    if expected.kind is bool and not np.isin(array, (0, 1)).all():
        raise ValueError("holds something other than True and False")
    if expected.isInput and not np.isfinite(array).all():
        raise ValueError("holds a number that is not finite")
    return array.astype({float: np.float64, int: np.int64, bool: np.bool_}[expected.kind])


def _gather(value, axes, lengths):
    """Nested lists, and arrays within them, of the given shape; ValueError for any other shape.

    The expected shape leads the way down. A file whose lists contain each other many times over,
    and would fill the memory when written out, is turned away at its first wrong length.
    """
    if isinstance(value, _StoredArray):
        array = value.array
        if not axes and array.size == 1:
            return array.item()
        if array.ndim != len(axes):
            raise ValueError(f"has shape {array.shape} in place of {_shape_text(axes)}")
        for axis, length in zip(axes, array.shape, strict=True):
            _check_length(axis, length, lengths)
        return array
    if not axes:
        if not isinstance(value, bool | int | float):
            raise ValueError(f"holds a {type(value).__name__} in place of a number")
        return value
    if not isinstance(value, list | tuple):
        raise ValueError(f"is a {type(value).__name__} in place of {_shape_text(axes)} numbers")
    _check_length(axes[0], len(value), lengths)
    return [_gather(item, axes[1:], lengths) for item in value]


def _check_length(axis, length, lengths):
    """axis : the length itself, or the name of an axis whose length is the one first met."""
    expected = lengths.setdefault(axis, length) if isinstance(axis, str) else axis
    if length != expected:
        raise ValueError(f"has an axis of length {length} in place of {expected}")
    if length == 0:
        raise ValueError("is empty")


def _shape_text(axes):
    return f"({', '.join(map(str, axes))}{',' if len(axes) == 1 else ''})"


def _check_meaning(data):
    """Refuse numbers of the right shape that no body can have."""
    if not np.all(np.any(data["randomOrientations"] != 0, axis=1)):
        raise GraderDataError("randomOrientations holds a zero quaternion")
    results = [array for key, array in data.items() if key.startswith("result")]
    if results and not any(map(np.any, results)):
        raise GraderDataError("no sample has a result")
    for k in (1, 2):
        for key in (f"faces{k}", f"tets{k}"):
            indices = data.get(key)
            if indices is None:
                continue
            if indices.min() < 0 or indices.max() >= len(data[f"origVertices{k}"]):
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
