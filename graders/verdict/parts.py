"""Calls what is graded, sample by sample, and collects the numbers, whatever the calls do.

Quantities are up to the graders: a Part says what to call and what to keep. From the top: what
functions return; `Results`; `Part` and `Grader`.
"""

from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from reference import PROJECT_DIRECTORY
from reference.graderData import CONVENTIONS, ERROR_BOUND, WIDTHS, load_grader_data
from reference.rigidModel import solids_of

from rbs.program.submissions import CAUSE_LENGTH, describe
from rbs.scenes.messages import InputError, short

ATTRIBUTES = ("position", "orientation", "linVelocity", "angVelocity")  # as in WIDTHS
LISTS = "{} gives lists where run_timestep needs arrays: in a scene, the next step fails"
# The number of samples that are tried if the data do not hold the expected results.
FEW = 20


class NotWritten(Exception):
    """Something that the student has not written yet; the message names it."""


class WrongResult(Exception):
    """A result of the wrong kind or shape; the message says which."""


def returned(values, function, sizes):
    """Returns the values that a function has returned, as a tuple.

    sizes : dict from the name of each value, in order, to how many numbers it holds

    Raises NotWritten, or WrongResult if there are more or fewer values, or in another order.
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
    """Returns a value of any shape as an array (count,); a count of `bool` means one bool.

    Raises NotWritten or WrongResult, with the name `what`, if the value is something else.
    """
    if value is None:
        raise NotWritten(f"{what} is None")
    try:
        array = np.array(value, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        raise WrongResult(f"{what} is not an array of numbers") from None
    if array.size != (1 if count is bool else count):
        expected = f"where {1 if count is bool else count} numbers are expected"
        raise WrongResult(f"{what} has shape {np.shape(value)} {expected}")
    if count is bool and array[0] not in (0.0, 1.0):
        raise WrongResult(f"{what} is {array[0]:g}, neither True nor False")
    return array


def results_of(mesh, ending=""):
    """Yields a mesh's state as `Part.compute` does: "resultPositions" with an ending, and so on."""
    for name, attribute in zip(WIDTHS, ATTRIBUTES, strict=True):
        yield f"result{name}{ending}", getattr(mesh, attribute, None), f"the mesh's {attribute}"


def state_of(mesh):
    """A mesh's state (13,): position, orientation, linear and angular velocity."""
    values = zip(results_of(mesh), WIDTHS.values(), strict=True)
    return np.concatenate([numbers(value, width, what) for (_, value, what), width in values])


def by_mesh(key, pair):
    """Yields a pair of vectors, one for each mesh, as `Part.compute` does."""
    for k, value in enumerate(returned(pair, key, {"mesh 1": 3, "mesh 2": 3}), start=1):
        yield f"{key}, mesh {k}", value


class Results:
    """Numbers of all samples, NaN where a number is missing, and the causes.

    shapes : dict from quantity to how many numbers it has in a sample, or `bool`
    folder : of the student's modules; causes name files relative to it

    values : dict from quantity to array (n, w)
    problems : dict from quantity to (cause, number of samples, first sample)
    remarks : list of str, those of the bodies
    """

    def __init__(self, shapes, sampleCount, folder=None):
        self.values = {key: np.full((sampleCount, w), np.nan) for key, w in widths(shapes)}
        self.problems = {}
        self.remarks = []
        self._folder = folder

    @contextmanager
    def attempt(self, sample, keys):
        """Context in which any exception becomes the problem of these quantities."""
        try:
            yield
        except (KeyboardInterrupt, GeneratorExit):
            raise
        except BaseException as error:  # not even SystemExit ends the grader
            cause = str(error)
            if not isinstance(error, NotWritten | WrongResult):
                cause = describe(error, self._folder or PROJECT_DIRECTORY)
            if isinstance(error, NotWritten | NotImplementedError):
                cause = f"not implemented: {cause}"
            for key in keys:
                known, count, first = self.problems.get(key, (cause, 0, int(sample)))
                self.problems[key] = known, count + 1, first

    def as_json(self):
        """Returns the contents for JSON and `read_json`; NaN and infinities stay as they are."""
        values = {key: array.tolist() for key, array in self.values.items()}
        return {"values": values, "problems": self.problems, "remarks": self.remarks}

    def read_json(self, content):
        """Restores what `as_json` returned."""
        self.values = {key: np.array(rows, float) for key, rows in content["values"].items()}
        self.problems, self.remarks = content["problems"], content["remarks"]

    def give_up(self, cause, sampleCount):
        """Records one cause for all quantities and samples."""
        self.problems = dict.fromkeys(
            self.values, (short(cause, limit=CAUSE_LENGTH), sampleCount, 0)
        )


def widths(shapes):
    """Returns pairs (quantity, how many numbers it has); a bool counts as one number."""
    return [(key, 1 if width is bool else width) for key, width in shapes.items()]


def every_sample(data):
    """The indices of all samples."""
    return np.arange(len(data["randomPositions"]))


def few_samples(data):
    """The indices of the first samples, for results that the data do not hold."""
    return every_sample(data)[:FEW]


@dataclass(frozen=True)
class Part:
    """Something that is graded by itself: if it fails or hangs, the other parts are still graded.

    name : the function that is called, and perhaps how
    shapes : dict from quantity to how many numbers it has in a sample, or `bool`
    compute : generator of (bodies, data, sample) that calls the function and yields the quantities,
        in order: name, value or Exception, and perhaps a name for messages
    model : function of (data, names of mistakes) that returns the values after these mistakes;
        those of "KEY, mesh 1" and "KEY, mesh 2" as KEY, (2, n, w)
    samples : function of the data that returns the indices of the samples to try
    conditional : quantities that mean something only if the first quantity is true, both as
        computed and as expected
    isExtra : whether the data lack the expected results
    advice : if not empty, the part does not count, and this is the remark if it fails
    conventions : those in which the part is graded
    """

    name: str
    shapes: dict
    compute: Callable
    model: Callable
    samples: Callable = every_sample
    conditional: tuple = ()
    isExtra: bool = False
    advice: str = ""
    conventions: tuple = CONVENTIONS

    @property
    def function(self):
        """The name of the function that is called."""
        return self.name.split()[0]

    def run(self, bodies, data, folder=None):
        """Returns the Results of the graded class; folder : of the student's modules."""
        results = Results(self.shapes, len(data["randomPositions"]), folder)
        for sample in self.samples(data):
            missing = list(self.shapes)
            # Numbers that overflow or are NaN show in the table.
            with results.attempt(sample, missing), np.errstate(all="ignore"):
                for key, value, *what in self.compute(bodies, data, sample):
                    missing.remove(key)
                    if isinstance(value, list) and self.function.startswith("resolve"):
                        bodies.remarks[LISTS.format(self.function)] = None
                    with results.attempt(sample, [key]):
                        if isinstance(value, Exception):
                            raise value
                        row = numbers(value, self.shapes[key], *what or [key])
                        results.values[key][sample] = row
        results.remarks = list(bodies.remarks)
        return results

    def expected(self, data):
        """The right values: the data's own, or the model's if the data lack them."""
        return self._by_quantity(self.model(data) if self.isExtra else data)

    def after_mistakes(self, data, names):
        """The values after these mistakes: dict from quantity to array (n, w)."""
        return self._by_quantity(self.model(data, names))

    def _by_quantity(self, values):
        rows = {}
        for quantity, width in widths(self.shapes):
            key, _comma, mesh = quantity.partition(", mesh ")
            array = values[key][int(mesh) - 1] if mesh else values[key]
            rows[quantity] = array.astype(np.float64).reshape(-1, width)
        return rows

    def comparable(self, key, samples, *tables):
        """Those of the samples at which a quantity means something in all tables."""
        for table in tables if key in self.conditional else ():
            samples = samples[table[next(iter(self.shapes))][samples, 0] == 1]
        return samples


@dataclass(frozen=True)
class Grader:
    """One of the three graders.

    module : the name of its file; fileName, layout : of its data; parts : tuple of Part
    added : entries that the graders need and the file lacks
    """

    module: str
    title: str
    fileName: str
    layout: dict
    parts: tuple
    added: dict = field(default_factory=dict)

    def load(self, folder):
        """Loads the grader's data, with `added`, "solids" and "convention".

        The convention is the one whose formulas fit the data best. Raises InputError.
        """
        path = folder / self.fileName
        try:
            data = load_grader_data(path, self.layout) | self.added
            data["solids"] = solids_of(data)
        except InputError as problem:
            raise InputError(f"{path}: {problem}") from None
        return min((data | {"convention": one} for one in CONVENTIONS), key=self._misfits)

    def _misfits(self, data):
        """The number of results in the data that this convention's formulas do not reproduce."""
        count = 0
        for part in (part for part in self.asked(data) if not part.isExtra):
            expected, computed = part.expected(data), part.after_mistakes(data, frozenset())
            for key in part.shapes:
                rows = part.comparable(key, part.samples(data), expected)
                count += np.sum(~(np.abs(computed[key] - expected[key])[rows] < ERROR_BOUND))
        return count

    def asked(self, data):
        """The parts that are graded in the data's convention."""
        return [part for part in self.parts if data["convention"] in part.conventions]

    def judge(self, bodies, data, folder=None):
        """Runs all parts in this process; returns a list of (Part, Results)."""
        return [(part, part.run(bodies, data, folder)) for part in self.asked(data)]
