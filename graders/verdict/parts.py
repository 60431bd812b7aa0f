"""What a grader asks of a submission: parts, their samples and their results.

From the top: `Results`, read from an answer of `worker.calls`; `Part`; `Grader`.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from reference import PROJECT_DIRECTORY, rigidModel
from reference.graderData import ATTRIBUTES, CONVENTIONS, ERROR_BOUND, draw, load_grader_data
from worker import calls

from rbs.glass.mistakes import edited
from rbs.program.submissions import CAUSE_LENGTH
from rbs.scenes.messages import InputError, short

# The number of samples that are tried if the data do not hold the expected results, of those in
# the file, and of the fresh ones.
FEW = 20
UNREADABLE = "its answer cannot be read"


@dataclass
class Results:
    """Numbers of all samples, NaN where a number is missing, and the causes.

    values : dict from quantity to array (n, w)
    problems : dict from quantity to (cause, number of samples, first sample)
    remarks : list of str; inertia : of `worker.calls.inertia`
    """

    values: dict
    problems: dict = field(default_factory=dict)
    remarks: list = field(default_factory=list)
    inertia: list = field(default_factory=list)


def every_sample(data):
    return np.arange(len(data["randomPositions"]))


def first_of(samples, data):
    """The first of these samples in the file, and of the fresh ones."""
    fresh = samples >= data["inFile"]
    return np.concatenate([samples[~fresh][:FEW], samples[fresh][:FEW]])


def few_samples(data):
    """The indices of the first samples, for results that the data do not hold."""
    return first_of(every_sample(data), data)


@dataclass(frozen=True)
class Part:
    """Something that is graded by itself: if it fails or hangs, the other parts are still graded.

    name : the function that is called, and perhaps how
    shapes : dict from quantity to how many numbers it has in a sample, or "bool"
    call : of `worker.calls.CALLS`
    model : function of the data and the inputs that returns the values;
        those of "KEY, mesh 1" and "KEY, mesh 2" as KEY, (2, n, w)
    inputs : function of the data that returns what the call is given beside the states: a dict from
        name to array (n, ...), or to one number
    samples : function of the data that returns the indices of the samples to try
    isExtra : whether the data lack the expected results
    """

    name: str
    shapes: dict
    call: str
    model: Callable
    inputs: Callable = lambda data: {}
    samples: Callable = every_sample
    isExtra: bool = False

    @property
    def function(self):
        return self.name.split()[0]

    def order(self, data):
        """Returns what `worker.calls.answer` is given: inputs, and nothing else."""
        samples = self.samples(data)
        inputs = {
            key: np.asarray(value)[samples].tolist() if np.ndim(value) else float(value)
            for key, value in self.inputs(data).items()
        }
        meshes = {
            k: [data[f"{part}{k}"].tolist() for part in ("origVertices", "faces", "tets")]
            for k in "12"
            if f"tets{k}" in data
        }
        states = {name: data[f"random{key}"].tolist() for key, name in ATTRIBUTES.items()}
        order = {"call": self.call, "function": self.function, "shapes": self.shapes}
        order |= {"samples": samples.tolist(), "inputs": inputs}
        return order | {"meshes": meshes, "states": states}

    def read(self, answer, data):
        """Returns the Results of an answer to the order, which a submission may have made up; or of
        a text: why there is none.
        """
        n, samples = len(data["randomPositions"]), self.samples(data)
        results = Results({key: np.full((n, w), np.nan) for key, w in calls.widths(self.shapes)})
        try:
            found = {key: np.array(answer["values"][key], np.float64) for key in self.shapes}
            for key, rows in found.items():
                rows.shape = len(samples), results.values[key].shape[1]  # or raises
                rows[~np.isfinite(rows)] = np.nan
            problems = {
                key: (short(str(cause), limit=CAUSE_LENGTH), int(count), int(first))
                for key, (cause, count, first) in answer["problems"].items()
                if key in found
            }
            remarks = [short(str(one), limit=CAUSE_LENGTH) for one in answer["remarks"]][:FEW]
            inertia = [np.array(one, np.float64).reshape(3, 3) for one in answer["inertia"][:5]]
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
            cause = answer if isinstance(answer, str) else UNREADABLE
            cause = short(cause, limit=CAUSE_LENGTH), len(samples), 0
            results.problems = dict.fromkeys(self.shapes, cause)
            return results
        for key, rows in found.items():
            results.values[key][samples] = rows
        return Results(results.values, problems, remarks, inertia)

    def expected(self, data):
        """The right values: the data's own, or the model's if the data lack them."""
        isComputed = self.isExtra or data["isOther"]
        return self.computed(data) if isComputed else self._by_quantity(data)

    def computed(self, data):
        return self._by_quantity(self.model(data | self.inputs(data)))

    def given(self, data, rows=slice(None)):
        """What the model is given of some samples: the data and the inputs."""
        n, given = len(data["randomPositions"]), data | self.inputs(data)
        isMesh = {f"{part}{k}" for part in ("origVertices", "faces", "tets") for k in (1, 2)}
        some = {key for key, rows in given.items() if np.shape(rows)[:1] == (n,)} - isMesh
        return given | {key: given[key][rows] for key in some}

    def after_mistakes(self, given, edits, *most):
        """The values after edits of the model: dict from quantity to array (n, w)."""
        model = edited(self.function, edits, rigidModel, *most)[self.model.__name__]
        return self._by_quantity(model(given))

    def _by_quantity(self, values):
        rows = {}
        for quantity, width in calls.widths(self.shapes):
            key, _comma, mesh = quantity.partition(", mesh ")
            array = values[key][int(mesh) - 1] if mesh else values[key]
            rows[quantity] = array.astype(np.float64).reshape(-1, width)
        return rows


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

    def load(self, folder, seed=None):
        """Loads the grader's data, with `added`, "solids" and "convention", and fresh samples.

        The convention is the one whose formulas fit the data best. Raises InputError.

        seed : of as many fresh samples as are in the file, or None for none
        """
        path = folder / self.fileName
        try:
            data = load_grader_data(path, self.layout) | self.added
            data["solids"] = rigidModel.solids_of(data)
        except InputError as problem:
            raise InputError(f"{path}: {problem}") from None
        data |= {"inFile": len(data["randomPositions"]), "isOther": False}
        data = min((data | {"convention": one} for one in CONVENTIONS), key=self._misfits)
        return data if seed is None else self.with_fresh(data, seed)

    def with_fresh(self, data, seed):
        """The data with as many fresh samples, whose results the model computes."""
        data = data | {"seed": seed}
        fresh = data | draw(data, self.layout, np.random.Generator(np.random.PCG64(seed)))
        results = {}
        for part in self.parts:
            if not part.isExtra:
                results |= part.model(fresh | part.inputs(fresh))
        fresh |= {key: results[key] for key in self.layout if key in results}
        joined = {}
        for key, (_kind, *axes) in self.layout.items():
            if "samples" in axes:
                joined[key] = np.concatenate([data[key], fresh[key]], axis=axes.index("samples"))
        for key in ("timeStep", "secondStep"):
            joined[key] = np.concatenate([rigidModel.steps_of(one)[key] for one in (data, fresh)])
        return data | joined

    def _misfits(self, data):
        """The number of results in the data that this convention's formulas do not reproduce."""
        count = 0
        for part in (part for part in self.parts if not part.isExtra):
            expected, computed = part.expected(data), part.computed(data)
            for key in part.shapes:
                rows = part.samples(data)
                count += np.sum(~(np.abs(computed[key] - expected[key])[rows] < ERROR_BOUND))
        return count

    def judge(self, functions, quaternion, data, folder=PROJECT_DIRECTORY):
        """Runs all parts in this process; returns a list of (Part, Results)."""
        given = functions, quaternion, folder
        return [(one, one.read(calls.answer(one.order(data), *given), data)) for one in self.parts]
