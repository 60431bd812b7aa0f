"""Statistics of a run: the quantities of a step, a table of them, and its plot.

From the top: the quantities and their units; `StatsWriter`, which writes a table; plotting one.

Units: metres, kilograms, seconds; times of phases in milliseconds.
"""

import csv
import io
import math
from contextlib import suppress
from pathlib import Path

import numpy as np

from rbs.files import named_errors
from rbs.interrupts import breakable
from rbs.outputs import Output, open_stream
from rbs.reports import PHASES

# What `step_quantities` gives, each with its unit. A phase's time is called after the phase.
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
    """The numbers about a simulation's present step, or a replay's: dict of the names above.

    What only the step itself can tell, from `deepestPenetration` on, is NaN before the first step
    and in a replay. The deepest penetration is that which contacts were found with, before they
    were corrected; without a contact it is 0.
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
        contacts = report.contacts
        values += [
            max((contact.depth for contact in contacts), default=0.0),
            len(contacts),
            report.candidatePairs,
            report.constraintVisits,
            *(1e3 * report.seconds.get(phase, 0.0) for phase in PHASES),
        ]
    values += [math.nan] * (len(QUANTITY_UNITS) - len(values))
    return dict(zip(QUANTITY_UNITS, values, strict=True))


class StatsWriter:
    """Writes `step_quantities` of every step into a .csv file, as they come, and may plot them.

    A column each, named "name (unit)", after the number of the step; a number that is unknown is
    left out. They go to FILE.csv.part line by line, which stays where the run does not end well;
    those for a pipe or a device go there at once.

    Attributes: path, plotPath, as given; partialPath, of the table that is written to a file, which
    a plot needs too, or None.
    """

    def __init__(self, path=None, plotPath=None):
        """path, plotPath : of the .csv and the .png; of the two, one may be None

        raises OSError when nothing can be written there, ImportError when nothing can be plotted
        """
        if plotPath is not None:
            check_plotting()
        self.path = None if path is None else Path(path)
        self.plotPath = None if plotPath is None else Path(plotPath)
        self._table = self._plot = self._stream = self._file = None
        self._isEmpty, self._isSaved = True, False
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    def _open(self):
        streams = []
        if self.plotPath is not None:
            self._plot = Output(self.plotPath)
        if self.path is not None:
            self._table = Output(self.path)
            if self._table.isStream:
                self._table.close()
                self._table = None
                self._stream = open_stream(self.path)
                streams.append(io.TextIOWrapper(self._stream, "utf-8", newline="",
                                                write_through=True))  # fmt: skip
        if self._table is None and self._plot is not None:
            self._table = Output(self._plot.partialPath.with_name(f"{self.plotPath.name}.csv"))
        self.partialPath = None
        if self._table is not None:
            self.partialPath = self._table.partialPath
            with named_errors(self.path or self.plotPath):  # the name that the caller knows
                self._file = open(
                    self.partialPath, "w", encoding="utf-8", newline="", buffering=1
                )
            streams.append(self._file)
        self._writers = [csv.writer(stream, lineterminator="\n") for stream in streams]

    def add(self, simulation):
        """Writes the line of the simulation's present step; raises OSError."""
        values = step_quantities(simulation).values()
        values = ["" if math.isnan(value) else value for value in values]
        with named_errors(self.path or self.plotPath):
            if self._isEmpty:
                names = [f"{name} ({unit})" if unit else name
                         for name, unit in QUANTITY_UNITS.items()]  # fmt: skip
                self._write(["step", *names])
                self._isEmpty = False
            self._write([simulation.stepCount, *values])

    def _write(self, row):
        for writer in self._writers:
            if self._stream is None:
                writer.writerow(row)
            else:
                with breakable():  # who reads the pipe may have stopped
                    writer.writerow(row)

    def save(self, title=""):
        """Plots, with that title, and puts the file in its place, instead of an old one."""
        with named_errors(self.path or self.plotPath):
            if self._file is not None:
                self._file.close()
        try:
            if self._plot is not None:
                with named_errors(self.plotPath):
                    plot_stats(self.partialPath, self._plot.partialPath, title)
                self._plot.put()
        finally:
            if self.path is not None and self._stream is None:
                self._table.put()
            self._isSaved = True
            self.close()

    def close(self):
        """Keeps in FILE.csv.part what has not been saved; removes it where there is nothing.

        returns the path of what is kept, or None
        """
        for file in (self._file, self._stream):
            with suppress(OSError):  # the disk may be full: what is on it is kept
                if file is not None:
                    file.close()
        isKept = not (self._isEmpty or self._isSaved) and self._table is not None
        for output in (self._plot, self._table):
            if output is not None:
                output.close(keepsPartial=isKept and output is self._table)
        return self.partialPath if isKept else None


# Okabe and Ito's colours, which the colour-blind tell apart: black, orange, sky blue, green,
# vermilion, blue. The lines differ in their dashes too.
PLOT_COLOURS = ("#000000", "#E69F00", "#56B4E9", "#009E73", "#D55E00", "#0072B2")
PLOT_DASHES = ("-", "--", ":", "-.", (0, (5, 1)), (0, (3, 1, 1, 1)))
# The panels of a plot: label of the axis, its unit, the quantities, which have that unit.
PLOT_PANELS = (
    ("energy", "J", ("totalEnergy", "kineticEnergy", "potentialEnergy")),
    ("momentum", "kg m/s", ("momentumX", "momentumY", "momentumZ")),
    ("angular momentum", "kg m²/s", ("angularMomentumX", "angularMomentumY", "angularMomentumZ")),
    ("depth", "m", ("deepestPenetration", "largestViolation")),
    ("number per step", "", ("contacts", "candidatePairs", "constraintVisits")),
    ("time per step", "ms", tuple(f"{phase}Time" for phase in PHASES)),
)
# What goes over several powers of ten, and where it turns linear, since there are zeros too.
LOGARITHMIC_PANELS = {"depth": 1e-3, "number per step": 1.0, "time per step": 0.01}
PLOT_INCHES = (12.0, 10.0)
PLOT_DPI = 120


def check_plotting():
    """Raises ImportError, which says what to install, where nothing can be plotted."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise ImportError("--plot needs matplotlib. Install it: pip install matplotlib") from None


def plot_stats(csvPath, imagePath, title):
    """Draws a file of `StatsWriter` as a PNG over time, piece by piece; raises OSError.

    Needs matplotlib, and no display.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    table = np.genfromtxt(csvPath, delimiter=",", skip_header=1, encoding="utf-8", ndmin=2)
    columns = dict(zip(["step", *QUANTITY_UNITS], table.T, strict=True))
    figure = Figure(figsize=PLOT_INCHES, dpi=PLOT_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    # A name that is not Unicode has letters that no font can draw.
    figure.suptitle(title.encode("utf-8", "replace").decode("utf-8"))
    panels = figure.subplots(3, 2, sharex=True)
    for axes, (name, unit, quantities) in zip(panels.flat, PLOT_PANELS, strict=True):
        shown = [q for q in quantities if np.isfinite(columns[q]).any()]
        prefix = quantities[0][:-1] if quantities[0].endswith("X") else ""
        for quantity, colour, dashes in zip(shown, PLOT_COLOURS, PLOT_DASHES, strict=False):
            axes.plot(
                columns["time"], columns[quantity], color=colour, linestyle=dashes, linewidth=1.2,
                label=quantity.removesuffix("Time").removeprefix(prefix),
            )  # fmt: skip
        axes.set_ylabel(f"{name} ({unit})" if unit else name)
        axes.grid(alpha=0.3)
        if shown:
            # Above the axes, where it hides nothing.
            axes.legend(
                loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(shown), fontsize="small",
                frameon=False, borderaxespad=0.2, columnspacing=1.0, handlelength=1.8,
            )  # fmt: skip
        else:
            axes.text(0.5, 0.5, "not in a recording", ha="center", transform=axes.transAxes)
        if shown and name in LOGARITHMIC_PANELS:
            axes.set_yscale("symlog", linthresh=LOGARITHMIC_PANELS[name])
    for axes in panels[-1]:
        axes.set_xlabel("time (s)")
    with open(imagePath, "wb") as file:
        figure.savefig(file, format="png")
