"""Reads grader data, and checks them against their layout.

Grader data are Python pickles, with the keys and shapes in the layouts below. A pickle is a program
that may call any function it names, so the unpickler admits a handful of names only.
From the top: the layout of the data; reading pickles.
"""

import codecs
import pickle

import numpy as np

from rbs.scenes.messages import InputError
from rbs.scenes.state import STATE_NAMES
from rbs.stepping.meshes import STATE_WIDTHS
from reference import PROJECT_DIRECTORY

DATA_DIRECTORY = PROJECT_DIRECTORY / "data"

# The right physics, and those of the 2024 release (quirks 1 to 3 in graders/README.md).
CONVENTIONS = EXACT, RELEASED_2024 = "exact", "released-2024"

# The largest absolute error allowed. Quantities are of size 1 to 100 and take a few dozen
# roundings, about 1e-13 in all; a wrong formula changes them by 1e-3 or more.
ERROR_BOUND = 1e-9

# Attributes of a mesh by the names of the data, and how many numbers each has.
ATTRIBUTES = {key[0].upper() + key[1:]: name for key, name in STATE_NAMES.items()}
WIDTHS = {key: STATE_WIDTHS[name] for key, name in ATTRIBUTES.items()}

# An entry of a file is a kind of number and the lengths of its axes; a named axis has the same
# length wherever the name appears.
_FLAG, _VECTOR, _PAIR = (bool, "samples"), (float, "samples", 3), (float, 2, "samples", 3)

_STATES = {f"random{name}": (float, "samples", width) for name, width in WIDTHS.items()}
_MESHES = {
    f"{part}{k}": (kind, f"{part}{k}", width)
    for k in (1, 2)
    for part, kind, width in (("origVertices", float, 3), ("faces", int, 3), ("tets", int, 4))
}
_CONTACT = {"isCollision": _FLAG, "depth": (float, "samples")}
_CONTACT |= {"intNormal": _VECTOR, "intPosition": _VECTOR}
_RESULTS = {f"result{name}": (float, 2, "samples", width) for name, width in WIDTHS.items()}
_BOUNDS = {"positionWasValidUpper": _FLAG, "correctedPositionsUpper": _PAIR}
_BOUNDS |= {"positionWasValidLower": _FLAG, "correctedPositionsLower": _PAIR}
_RATES = {"velocityWasValid": _FLAG}
_RATES |= {"correctedLinVelocities": _PAIR, "correctedAngVelocities": _PAIR}

INTEGRATION_LAYOUT = _STATES | {key: (float, *axes[1:]) for key, (_, *axes) in _RESULTS.items()}
COLLISION_LAYOUT = _MESHES | _STATES | _CONTACT | _RESULTS
CONSTRAINT_LAYOUT = _MESHES | _STATES | {"refValues": (float, "samples", 1)} | _BOUNDS | _RATES


# By names without `numpy.core` or `numpy._core`, between which NumPy 2 has moved them.
_ARRAY = np.zeros(1)
_ADMITTED = {
    "numpy.dtype": np.dtype,
    "numpy.ndarray": np.ndarray,
    "multiarray._reconstruct": _ARRAY.__reduce__()[0],
    "multiarray.scalar": _ARRAY[0].__reduce__()[0],
    "numeric._frombuffer": _ARRAY.__reduce_ex__(5)[0],
    "_codecs.encode": codecs.encode,
}


class PlainUnpickler(pickle.Unpickler):
    """Reads NumPy arrays and plain containers; refuses all else by name."""

    def find_class(self, module, name):
        short = module.removeprefix("numpy.core.").removeprefix("numpy._core.")
        if f"{short}.{name}" not in _ADMITTED:
            raise pickle.UnpicklingError(
                f"{module}.{name} is refused: only NumPy arrays and plain containers are admitted"
            )
        return _ADMITTED[f"{short}.{name}"]


def load_grader_data(path, layout):
    """Reads a pickle and checks it against a layout. Raises InputError.

    layout : dict from key to (kind, axes...); further keys in the file are ignored

    Returns a dict from key to array, of dtype float64, int64 or bool and of the layout's shape.
    """
    try:
        with open(path, "rb") as file:
            stored = PlainUnpickler(file).load()
    except OSError as problem:
        raise InputError(f"cannot be read: {problem.strerror}") from None
    except Exception as problem:  # a damaged pickle can raise almost anything
        raise InputError(f"not a readable data file: {problem}") from None
    if not isinstance(stored, dict):
        raise InputError(f"holds a {type(stored).__name__} instead of a dictionary")
    missing = [key for key in layout if key not in stored]
    if missing:
        raise InputError(f"has no entry {', '.join(missing)}")
    lengths, data = {}, {}
    for key, (kind, *axes) in layout.items():
        array = np.array(stored[key])
        if array.ndim == len(axes) + 1 and array.shape[-1] == 1:
            array = array[..., 0]  # numbers that were collected in arrays of one
        for axis, length in zip(axes, array.shape, strict=False):
            lengths.setdefault(axis, axis if isinstance(axis, int) else length)
        expected = tuple(lengths.get(axis, axis) for axis in axes)
        if array.dtype.kind not in "fiub" or array.shape != expected:
            found = f"holds {array.dtype} of shape {array.shape}"
            raise InputError(f"{key} {found}, not numbers of shape {expected}")
        if not np.isfinite(array).all():
            raise InputError(f"{key} holds a number that is not finite")
        data[key] = array.astype(kind)
    for key in sorted(data.keys() & {"tets1", "tets2"}):
        if not np.isin(data[key], np.arange(lengths[f"origVertices{key[-1]}"])).all():
            raise InputError(f"{key} refers to a vertex that does not exist")
    return data


def draw(data, layout, generator):
    """Returns as many fresh samples as the data have: a dict of the keys that are no results.

    Each number is uniform in the range that it has in the data; orientations and normals are
    uniform on their sphere. Velocities that are zero stay so; about half of the samples collide.
    "timeStep" and "secondStep" are those of two time steps, in s.
    """
    count = len(data["randomPositions"])

    def uniform(key, rows=slice(None)):
        low, high = data[key][rows].min(axis=0), data[key][rows].max(axis=0)
        return low + (high - low) * generator.random(data[key].shape)

    def on_sphere(width):
        rows = generator.normal(size=(count, width))
        return rows / np.sqrt(np.sum(rows * rows, axis=1, keepdims=True))

    fresh = {f"random{name}": uniform(f"random{name}") for name in WIDTHS}
    fresh["randomOrientations"] = on_sphere(4)
    for key in ("randomLinVelocities", "randomAngVelocities"):
        fresh[key] *= np.any(data[key] != 0.0, axis=1, keepdims=True)
    if "isCollision" in layout:
        hit = data["isCollision"] if data["isCollision"].any() else slice(None)
        isHit = generator.random(count) < 0.5
        fresh |= {"isCollision": isHit, "depth": uniform("depth", hit) * isHit}
        fresh["intNormal"] = on_sphere(3) * isHit[:, None]
        fresh["intPosition"] = uniform("intPosition", hit) * isHit[:, None]
    if "refValues" in layout:
        fresh["refValues"] = uniform("refValues")
    fresh |= {key: 0.02 + 0.18 * generator.random(count) for key in ("timeStep", "secondStep")}
    return fresh | {"inFile": 0}
