"""Statistics of a run: the quantities of each step.

Units: metres, kilograms, seconds; times of phases in milliseconds.
"""

import csv
import math
from contextlib import suppress

import numpy as np

from rbs.recordings.outputs import FileWriter
from rbs.scenes.files import named_errors
from rbs.scenes.messages import counted, print_error, shown_path
from rbs.scenes.scene import Writer
from rbs.stepping.reports import PHASES

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
        with named_errors(self.path):
            self._writer.writerow(
                [simulation.stepCount, *("" if math.isnan(value) else value for value in values)]
            )

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
