"""Running what is graded, sample by sample, whatever it does; and the numbers that come of it.

Nothing here is known of the quantities: a grader's parts say what to call and what to keep.
"""

from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from gradingTools import CONVENTIONS, ERROR_BOUND, EXACT, RELEASED_2024, load_grader_data
from rigidModel import check_bodies

from rbs.submissions import brief, describe


class NotWritten(Exception):
    """Something that a student has not written yet; the message says what, in one line."""


class WrongResult(Exception):
    """A result that is not what its function is to give; the message says so, in one line."""


# ---- What functions return ----------------------------------------------------------------------


def returned(values, count, name):
    """The `count` values that a function has returned; NotWritten or WrongResult if not as many."""
    if values is None:
        raise NotWritten(f"{name} returns nothing")
    try:
        values = tuple(values)
    except TypeError:
        raise WrongResult(f"{name} returns a {type(values).__name__}, not {count} values") from None
    if len(values) != count:
        raise WrongResult(f"{name} returns {len(values)} values, not {count}")
    return values


def numbers(value, count, what):
    """An array (count,) out of one of any shape with so many entries."""
    if value is None:
        raise NotWritten(f"{what} is None")
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise WrongResult(f"{what} is not an array of numbers") from None
    if array.size != count:
        raise WrongResult(f"{what} has shape {array.shape} where {count} numbers are expected")
    return array.reshape(count)


def flag(value, what):
    """A bool out of one, or out of an array of one."""
    (number,) = numbers(value, 1, what)
    if number not in (0.0, 1.0):
        raise WrongResult(f"{what} is {number:g}, neither True nor False")
    return bool(number)


def attribute(mesh, name, count):
    """An attribute of a mesh as an array (count,)."""
    return numbers(getattr(mesh, name, None), count, f"the mesh's {name}")


# ---- Results ------------------------------------------------------------------------------------


class Results:
    """Numbers of all samples, NaN where there are none, and why not.

    values : dict from quantity to array (n,) or (n, w)
    problems : dict from quantity to (cause, number of samples, the first of them)
    """

    def __init__(self, shapes, sampleCount, folder=None):
        """shapes : dict from quantity to the shape of a sample, () for a single number

        folder : of the student's modules, which causes name files relative to
        """
        self.values = {key: np.full((sampleCount, *shape), np.nan) for key, shape in shapes.items()}
        self.problems = {}
        self._folder = folder

    @contextmanager
    def attempt(self, sample, *keys):
        """Within it, whatever goes wrong is noted as the problem of these quantities."""
        try:
            with np.errstate(all="ignore"):  # what is not a number in the end shows in the table
                yield
        except (KeyboardInterrupt, GeneratorExit):
            raise
        except BaseException as error:  # SystemExit, too, must not end the grader
            cause = self._cause(error)
            for key in keys:
                known, count, first = self.problems.get(key, (cause, 0, int(sample)))
                self.problems[key] = known, count + 1, first

    def _cause(self, error):
        if isinstance(error, NotWritten):
            return f"not implemented: {error}"
        if isinstance(error, WrongResult):
            return str(error)
        text = brief(error) if self._folder is None else describe(error, self._folder)
        return f"not implemented: {text}" if isinstance(error, NotImplementedError) else text

    def as_json(self):
        """What `read_json` takes over, for JSON; NaN and infinities are in it as they are."""
        values = {key: array.tolist() for key, array in self.values.items()}
        return {"values": values, "problems": self.problems}

    def read_json(self, content):
        """Takes over what `as_json` gave; raises ValueError or KeyError for anything else."""
        for key, array in self.values.items():
            array[...] = np.array(content["values"][key], dtype=np.float64).reshape(array.shape)
        for key, (cause, count, first) in content["problems"].items():
            if key in self.values:
                self.problems[key] = brief(cause), int(count), int(first)

    def give_up(self, cause, sampleCount):
        """Notes one cause for all quantities and samples: nothing could be run."""
        for key in self.values:
            self.problems[key] = brief(cause), sampleCount, 0


# ---- Parts of a grader --------------------------------------------------------------------------


def every_sample(data):
    """The numbers of all samples."""
    return np.arange(len(data["randomPositions"]))


@dataclass(frozen=True)
class Part:
    """What can be graded by itself: if it fails, or never ends, the others are graded all the same.

    name : what is called, for messages
    shapes : dict from quantity to the shape of its value in a sample, () for a single number
    run : function of (bodies, data, samples, results) that fills the results in
    expected : function of the data that gives a dict of the values to compare with
    model : function of (data, names of mistakes) that gives the values after mistakes;
        None where nothing is known of them
    mistakes : the `hints.Mistake`s that may explain wrong values
    samples : function of the data that gives the numbers of the samples to be tried
    conditional : quantities that mean something only where the first quantity is true, both in what
        is computed and in what is expected
    isExtra : whether it looks at what the data do not show; only a student's modules are asked
    conventions : those in which it is graded
    """

    name: str
    shapes: dict
    run: Callable
    expected: Callable
    model: Callable | None = None
    mistakes: tuple = ()
    samples: Callable = every_sample
    conditional: tuple = ()
    isExtra: bool = False
    conventions: tuple = (EXACT, RELEASED_2024)


@dataclass(frozen=True)
class Grader:
    """One of the three graders.

    module : the name of its file; fileName, layout : of its data; parts : tuple of Part
    remarks : function of the data that gives lines for the head of the report
    added : entries that the graders need and the file does not have
    """

    module: str
    title: str
    fileName: str
    layout: dict
    parts: tuple
    remarks: Callable
    added: dict = field(default_factory=dict)

    def load(self, folder, convention=None):
        """The grader's data out of a folder, with what is added, and with their convention.

        convention : EXACT or RELEASED_2024; None for the one in which the formulas give the data's
            results, or most of them
        Raises GraderDataError.
        """
        data = load_grader_data(folder / self.fileName, self.layout) | self.added
        check_bodies(data)
        tried = [data | {"convention": one} for one in CONVENTIONS]
        if convention is not None:
            return tried[CONVENTIONS.index(convention)]
        return min(tried, key=self._misfits)

    def _misfits(self, data):
        """How many of the data's results the formulas do not give in the data's convention."""
        count = 0
        for part in self.asked(data, withExtras=False):
            expected, computed = part.expected(data), part.model(data)
            for key in part.shapes:
                difference = np.asarray(computed[key], float) - expected[key]
                samples = comparable(part, key, expected, computed, part.samples(data))
                count += np.sum(~(np.abs(difference[samples]) < ERROR_BOUND))
        return count

    def asked(self, data, withExtras):
        """The parts that are graded in the data's convention, with or without the extra ones."""
        return tuple(
            part
            for part in self.parts
            if data["convention"] in part.conventions and (withExtras or not part.isExtra)
        )


def comparable(part, key, values, others, samples):
    """Those of the samples at which a quantity of two sets of values means something in both."""
    if key not in part.conditional:
        return samples
    condition = next(iter(part.shapes))
    both = (np.asarray(values[condition]) == 1) & (np.asarray(others[condition]) == 1)
    return samples[both[samples]]


def by_mesh(values):
    """A dict whose arrays of pairs, (2, n, w), are taken apart: "KEY, mesh 1", "KEY, mesh 2"."""
    rows = {}
    for key, array in values.items():
        array = np.asarray(array)
        if array.ndim == 3:
            rows |= {f"{key}, mesh {k + 1}": array[k] for k in (0, 1)}
        else:
            rows[key] = array
    return rows
