"""Running what is graded, sample by sample, whatever it does; and the numbers that come of it.

Nothing here is known of the quantities: a grader's parts say what to call and what to keep.
"""

from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from gradingTools import CONVENTIONS, ERROR_BOUND, WIDTHS, load_grader_data
from rigidModel import solids_of

from rbs.program.submissions import brief, describe

ATTRIBUTES = ("position", "orientation", "linVelocity", "angVelocity")  # as in WIDTHS
# Of what the data do not show, the number of samples that are tried.
FEW = 20


class NotWritten(Exception):
    """Something that a student has not written yet; the message says what, in one line."""


class WrongResult(Exception):
    """A result that is not what its function is to give; the message says so, in one line."""


# ---- What functions return ----------------------------------------------------------------------


def returned(values, function, sizes):
    """The values that a function has returned, as a tuple.

    sizes : dict from what is to be returned, in order, to how many numbers it is
    Raises NotWritten or WrongResult for values that are not as many, or in another order.
    """
    order = f"({', '.join(sizes)})"
    if values is None:
        raise NotWritten(f"{function} returns nothing")
    if not hasattr(values, "__iter__"):
        raise WrongResult(f"{function} returns a {type(values).__name__}, not {order}")
    values = tuple(values)
    if len(values) != len(sizes):
        raise WrongResult(f"{function} returns {len(values)} values, not {len(sizes)}: {order}")
    lists = [value if isinstance(value, list | tuple) else [value] for value in values]
    found = [sum(map(np.size, one)) for one in lists]
    if found != [*sizes.values()] and sorted(found) == sorted(sizes.values()):
        raise WrongResult(f"{function} returns its values in the wrong order: it must be {order}")
    return values


def numbers(value, count, what):
    """An array (count,) out of one of any shape with so many entries; of count `bool`, a bool."""
    if value is None:
        raise NotWritten(f"{what} is None")
    size = 1 if count is bool else count
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise WrongResult(f"{what} is not an array of numbers") from None
    if array.size != size:
        raise WrongResult(f"{what} has shape {array.shape} where {size} numbers are expected")
    if count is bool and array.item() not in (0.0, 1.0):
        raise WrongResult(f"{what} is {array.item():g}, neither True nor False")
    return array.reshape(size)


def results_of(mesh, ending=""):
    """Yields what `Part.compute` does, of a mesh's state: "resultPositions", or with an ending."""
    for name, attribute in zip(WIDTHS, ATTRIBUTES, strict=True):
        yield f"result{name}{ending}", getattr(mesh, attribute, None), f"the mesh's {attribute}"


def state_of(mesh):
    """The state of a mesh in one array (13,): position, orientation and velocities."""
    values = zip(results_of(mesh), WIDTHS.values(), strict=True)
    return np.concatenate([numbers(value, width, what) for (_, value, what), width in values])


def by_mesh(key, pair):
    """Yields what `Part.compute` does, of a pair of vectors, one for each mesh."""
    for k, value in enumerate(returned(pair, key, {"mesh 1": 3, "mesh 2": 3}), start=1):
        yield f"{key}, mesh {k}", value


# ---- Results ------------------------------------------------------------------------------------


class Results:
    """Numbers of all samples, NaN where there are none, and why not.

    values : dict from quantity to array (n, w)
    problems : dict from quantity to (cause, number of samples, the first of them)
    remarks : list of str, of the bodies
    """

    def __init__(self, shapes, sampleCount, folder=None):
        """shapes : dict from quantity to how many numbers it has in a sample, or `bool`

        folder : of the student's modules, which causes name files relative to
        """
        self.values = {
            key: np.full((sampleCount, int(width)), np.nan) for key, width in widths(shapes)
        }
        self.problems = {}
        self.remarks = []
        self._folder = folder

    @contextmanager
    def attempt(self, sample, keys):
        """Within it, whatever goes wrong is noted as the problem of these quantities."""
        try:
            yield
        except (KeyboardInterrupt, GeneratorExit):
            raise
        except BaseException as error:  # SystemExit, too, must not end the grader
            cause = str(error)
            if not isinstance(error, NotWritten | WrongResult):
                cause = brief(error) if self._folder is None else describe(error, self._folder)
            if isinstance(error, NotWritten | NotImplementedError):
                cause = f"not implemented: {cause}"
            for key in keys:
                known, count, first = self.problems.get(key, (cause, 0, int(sample)))
                self.problems[key] = known, count + 1, first

    def as_json(self):
        """What `read_json` takes over, for JSON; NaN and infinities are in it as they are."""
        values = {key: array.tolist() for key, array in self.values.items()}
        return {"values": values, "problems": self.problems, "remarks": self.remarks}

    def read_json(self, content):
        """Takes over what `as_json` gave; raises ValueError or KeyError for anything else."""
        for key, array in self.values.items():
            array[...] = np.array(content["values"][key], dtype=np.float64).reshape(array.shape)
        for key, (cause, count, first) in content["problems"].items():
            if key in self.values:
                self.problems[key] = brief(cause), int(count), int(first)
        self.remarks = [brief(text) for text in content["remarks"]]

    def give_up(self, cause, sampleCount):
        """Notes one cause for all quantities and samples: nothing could be run."""
        self.problems = dict.fromkeys(self.values, (brief(cause), sampleCount, 0))


def widths(shapes):
    """Pairs of a quantity and how many numbers it has; a bool is one."""
    return [(key, 1 if width is bool else width) for key, width in shapes.items()]


# ---- Parts of a grader --------------------------------------------------------------------------


def every_sample(data):
    """The numbers of all samples."""
    return np.arange(len(data["randomPositions"]))


def few_samples(data):
    """The first samples, for what the data do not show."""
    return every_sample(data)[:FEW]


@dataclass(frozen=True)
class Part:
    """What can be graded by itself: if it fails, or never ends, the others are graded all the same.

    name : what is called, and perhaps how
    shapes : dict from quantity to how many numbers it has in a sample, or `bool`
    compute : generator of (bodies, data, sample) that calls what is graded, and yields quantities,
        in order, with their values or what is wrong with them, and perhaps a name for messages
    model : function of (data, names of mistakes) that gives the values after mistakes, and perhaps
        more; those of "KEY, mesh 1" and "KEY, mesh 2" as KEY, (2, n, w)
    samples : function of the data that gives the numbers of the samples to be tried
    conditional : quantities that mean something only where the first quantity is true, both in what
        is computed and in what is expected
    isExtra : whether it looks at what the data do not show; only a student's modules are asked
    conventions : those in which it is graded
    """

    name: str
    shapes: dict
    compute: Callable
    model: Callable
    samples: Callable = every_sample
    conditional: tuple = ()
    isExtra: bool = False
    conventions: tuple = CONVENTIONS

    @property
    def function(self):
        """The name of what is called."""
        return self.name.split()[0]

    def run(self, bodies, data, samples, results):
        """Fills the results in, at these samples."""
        for sample in samples:
            missing = list(self.shapes)
            # What is not a number in the end shows in the table.
            with results.attempt(sample, missing), np.errstate(all="ignore"):
                for key, value, *what in self.compute(bodies, data, sample):
                    missing.remove(key)
                    with results.attempt(sample, [key]):
                        if isinstance(value, Exception):
                            raise value
                        row = numbers(value, self.shapes[key], *what or [key])
                        results.values[key][sample] = row
        results.remarks = bodies.remarks

    def expected(self, data):
        """Values to compare with: the data's own, or the model's where they show nothing."""
        return self._by_quantity(self.model(data) if self.isExtra else data)

    def after_mistakes(self, data, names):
        """What a program with these mistakes computes: dict from quantity to array (n, w)."""
        return self._by_quantity(self.model(data, names))

    def _by_quantity(self, values):
        rows = {}
        for quantity, width in widths(self.shapes):
            key, _comma, mesh = quantity.partition(", mesh ")
            array = values[key][int(mesh) - 1] if mesh else values[key]
            rows[quantity] = array.astype(np.float64).reshape(-1, width)
        return rows

    def comparable(self, key, samples, *tables):
        """Those of the samples at which a quantity means something in all these tables."""
        for table in tables if key in self.conditional else ():
            samples = samples[table[next(iter(self.shapes))][samples, 0] == 1]
        return samples


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
        data["solids"] = solids_of(data)
        tried = {one: data | {"convention": one} for one in CONVENTIONS}
        return tried[convention] if convention else min(tried.values(), key=self._misfits)

    def _misfits(self, data):
        """How many of the data's results the formulas do not give in the data's convention."""
        count = 0
        for part in self.asked(data, withExtras=False):
            expected, computed = part.expected(data), part.after_mistakes(data, frozenset())
            for key in part.shapes:
                samples = part.comparable(key, part.samples(data), expected)
                difference = np.abs(computed[key] - expected[key])[samples]
                count += np.sum(~(difference < ERROR_BOUND))
        return count

    def asked(self, data, withExtras):
        """The parts that are graded in the data's convention, with or without the extra ones."""
        parts = [part for part in self.parts if data["convention"] in part.conventions]
        return tuple(part for part in parts if withExtras or not part.isExtra)
