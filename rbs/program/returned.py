"""What a student's functions must return: how many values, in which order, of which sizes.

The graders, `compare.py` and --functions check results here.
"""

import numpy as np

from rbs.geometry.triples import shown_value
from rbs.program.submissions import DETECT, POSITION, VELOCITY
from rbs.scenes.messages import counted

# For each function, the names of its values, in order, and how many numbers each holds.
RETURNED = {
    DETECT: {"isCollision": 1, "depth": 1, "intNormal": 3, "intPosition": 3},
    POSITION: {"positionWasValid": 1, "correctedPositions": 6},
    VELOCITY: {"velocityWasValid": 1, "correctedLinVelocities": 6, "correctedAngVelocities": 6},
}


class WrongResult(Exception):
    """A result of the wrong kind or shape; the message says which."""


class NotWritten(WrongResult):
    """Something that the student has not written yet; the message names it."""


def returned(values, name, sizes=None):
    """Returns the values of a result as a tuple.

    name : of the function, or of a value that holds others; sizes : dict from the names of these to
        how many numbers each holds; by default, those of the function in RETURNED

    Raises NotWritten, or WrongResult if there are more or fewer values, or in another order.
    """
    verb, sizes = "holds" if sizes else "returns", sizes or RETURNED[name]
    order = f"({', '.join(sizes)})"
    if values is None:
        raise NotWritten(f"{name} {verb} nothing")
    if not hasattr(values, "__iter__"):
        raise WrongResult(f"{name} {verb} a {type(values).__name__}, not {order}")
    values = tuple(values)
    if len(values) != len(sizes):
        found = counted(len(values), "value")
        raise WrongResult(f"{name} {verb} {found}, not {len(sizes)}: {order}")
    lists = [value if isinstance(value, list | tuple) else [value] for value in values]
    found = [sum(map(np.size, one)) for one in lists]
    if found != [*sizes.values()] and sorted(found) == sorted(sizes.values()):
        raise WrongResult(f"{name} {verb} its values in the wrong order: it must be {order}")
    return values


def numbers(value, count, what):
    """Returns a value of any shape as an array (count,); a count of "bool" means one bool.

    Raises NotWritten or WrongResult, with the name `what`, if the value is something else.
    """
    if value is None:
        raise NotWritten(f"{what} is None")
    try:
        array = np.array(value)
        if np.iscomplexobj(array):
            raise WrongResult(f"{what} holds complex numbers, where real ones are expected")
        array = array.astype(np.float64).ravel()
    except (TypeError, ValueError):
        raise WrongResult(f"{what} is {shown_value(value)}, not an array of numbers") from None
    if array.size != (size := 1 if count == "bool" else count):
        told = f"has shape {np.shape(value)} instead of {counted(size, 'number')}"
        raise WrongResult(f"{what} {told}")
    if count == "bool" and array[0] not in (0.0, 1.0):
        raise WrongResult(f"{what} is {array[0]:g}, neither True nor False")
    return array


def by_mesh(key, pair):
    """Yields `(value, name)` of the two vectors that a value of this name holds, one per mesh."""
    for k, value in enumerate(returned(pair, key, {"mesh 1": 3, "mesh 2": 3}), start=1):
        yield value, f"{key}, mesh {k}"
