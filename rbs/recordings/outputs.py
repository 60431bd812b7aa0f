"""`FileWriter`, the base of the writers of a run's files; `Outputs`, some of them; its statistics.

Units: metres, kilograms, seconds; times of phases in milliseconds.
"""

import csv
import math
import os
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from rbs.scenes.files import named_errors, partial_path, put_in_place, remove_partial
from rbs.scenes.messages import InputError, counted, import_optional, print_error, shown_path
from rbs.scenes.scene import Writer
from rbs.stepping.reports import PHASES


class OutputError(InputError):
    """A file that cannot be written here; one line."""


class FileWriter(Writer):
    """A `Writer` of one file, which takes its place when it is whole.

    Subclasses take the states in `add`, and complete the file at `partial` in `write`.
    package : that it needs, as pip calls it, or ""; module : the package, imported
    """

    package = ""

    def __init__(self, path):
        """Raises OutputError if the package is missing."""
        self.path, self.partial = path and Path(path), None
        self.target = path and Path(os.path.realpath(path))  # whatever the current folder is later
        if self.package:
            self.module = import_optional(self.package, f"no {self.label}", OutputError)

    def begin(self):
        """Begins a file that grows with the run, at `partial`; raises OSError, naming `path`."""
        with named_errors(self.path):
            self.partial = partial_path(self.target)

    def write(self, simulation):
        """Completes the file at `partial`, after the last state. Raises OSError."""

    def save(self, simulation, isWhole=True):
        """Writes the file and puts it in place. Raises OSError.

        isWhole : whether the run came to its end; if not, an older file stays as it was, and this
            one stands beside it
        """
        with named_errors(self.path):
            if self.partial is None:
                self.begin()
            self.write(simulation)
            if not isWhole and self.partial != self.target and self.target.exists():
                self.keep()
            else:
                put_in_place(self.partial, self.target)
        self.partial = None

    def keep(self):
        """Leaves a file that is not whole beside an older one, and says so."""
        if self.partial != self.target:
            print_error(f"{self.path}: not replaced; {self.kept()} in {shown_path(self.partial)}")
        self.path, self.partial = self.partial, None

    def kept(self):
        """Returns in a few words what an unfinished file has of the run."""
        return "the unfinished run is"

    def close(self):
        """Ends a file that was not saved, and removes it. Does nothing after `save`."""
        if self.partial is not None:
            remove_partial(self.partial)
            self.partial = None


class Outputs(Writer):
    """The files of a run. One that fails is ended and reported, and the others go on.

    writers : dict of name and `Writer`; haveFailed : whether one has failed
    report : function of an error
    """

    errors = InputError, ImportError, OSError, MemoryError

    def __init__(self, report):
        self.writers, self.report, self.haveFailed = {}, report, False

    def add(self, simulation, method="add"):
        """Hands each file the present state."""
        for name, writer in list(self.writers.items()):
            with self.reporting(name):
                getattr(writer, method)(simulation)

    def before(self, simulation):
        """Hands each file what was done to the bodies."""
        self.add(simulation, "before")

    def close(self):
        """Ends the files that were not saved."""
        for writer in self.writers.values():
            writer.close()

    @contextmanager
    def reporting(self, name=None):
        """Reports an error of the `with` block, which ends the writer of this name."""
        try:
            yield
        except self.errors as error:
            self.haveFailed = True
            self.report(error)
            if writer := self.writers.pop(name, None):
                with suppress(OSError):  # reported above
                    writer.close()


# Quantities of `step_quantities`, with units. The time of a phase is named after the phase.
QUANTITY_UNITS = {
    "time": "s",
    "kineticEnergy": "J",
    "potentialEnergy": "J",
    "totalEnergy": "J",
    **{f"momentum{axis}": "kg m/s" for axis in "XYZ"},
    **{f"angularMomentum{axis}": "kg m²/s" for axis in "XYZ"},
    "largestViolation": "m",
    "deepestPenetration": "m",
    "contacts": "",
    "candidatePairs": "",
    "constraintVisits": "",
    **{f"{phase}Time": "ms" for phase in PHASES},
}


def step_quantities(simulation):
    """Returns the quantities of the present step of a simulation or replay, by name.

    Quantities from `deepestPenetration` on come from the step's report. They are NaN before the
    first step and in a replay, and so is the time of a phase that the step does not have. The
    deepest penetration is measured before the correction, and is 0 without contacts.
    """
    kinetic, potential = simulation.kinetic_energy(), simulation.potential_energy()
    values = [
        simulation.time,
        kinetic,
        potential,
        kinetic + potential,
        *simulation.momentum().tolist(),
        *simulation.angular_momentum().tolist(),
        simulation.largest_violation(),
    ]
    report = simulation.report
    if report is not None:
        values += [
            report.deepest,
            report.contactCount,
            report.candidatePairs,
            report.constraintVisits,
            *(1e3 * report.seconds.get(phase, math.nan) for phase in PHASES),
        ]
    values += [math.nan] * (len(QUANTITY_UNITS) - len(values))
    return dict(zip(QUANTITY_UNITS, values, strict=True))


class StatsWriter(FileWriter):
    """Writes `step_quantities` of every step to a .csv file, row by row.

    The columns are the step and then "name (unit)". Unknown numbers are left empty. Until `save`,
    the table is FILE.part.csv.
    """

    label = "statistics"

    def __init__(self, path):
        """Raises OSError, naming `path`, if it cannot be written."""
        super().__init__(path)
        self.begin()
        with named_errors(path):
            self._file = open(self.partial, "w", encoding="utf-8", newline="", buffering=1)
            self._writer = csv.writer(self._file, lineterminator="\n")
            names = [f"{name} ({unit})" if unit else name for name, unit in QUANTITY_UNITS.items()]
            self._writer.writerow(["step", *names])

    def add(self, simulation):
        """Writes the row of the present step. Raises OSError."""
        values = step_quantities(simulation).values()
        cells = ["" if math.isnan(value) else value for value in values]
        with named_errors(self.path):
            self._writer.writerow([simulation.stepCount, *cells])

    def write(self, simulation):
        """Ends the table. Raises OSError."""
        self._file.close()

    def close(self):
        """Ends a table that was not saved. Its complete rows are kept in FILE.part.csv."""
        with suppress(OSError):  # a full disk may prevent the last write
            self._file.close()
        if self.partial is not None and self.partial.is_file():
            with open(self.partial, "rb+") as file:
                content = file.read()
                file.truncate(content.rfind(b"\n") + 1)
            if (count := content.count(b"\n") - 1) > 0:  # without the heading
                kept = f"{counted(count, 'row')} kept in {shown_path(self.partial)}"
                print_error(f"{self.path}: not complete; {kept}")
                self.partial = None
        super().close()


class Table(Writer):
    """Keeps `step_quantities` of every step."""

    def __init__(self):
        self._rows = []

    def add(self, simulation):
        """Keeps the quantities of the present step."""
        self._rows.append({"step": simulation.stepCount, **step_quantities(simulation)})

    def columns(self):
        """Returns the quantities as arrays, by name."""
        return {name: np.array([row[name] for row in self._rows]) for name in self._rows[0]}
