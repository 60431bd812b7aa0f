"""Statistics of a run: the quantities of a step, a table of them, and its plot.

From the top: the quantities and their units; `StatsWriter`, a table of them; `PlotWriter`.

Units: metres, kilograms, seconds; times of phases in milliseconds.
"""

import csv
import math
from contextlib import suppress
from pathlib import Path

import numpy as np

from rbs.scenes.files import atomic_write, named_errors, partial_path, put_in_place
from rbs.scenes.messages import shown_path
from rbs.scenes.scenefiles import scene_name
from rbs.stepping.reports import PHASES

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
    and in a replay, and so are the times of phases that a step does not have. The deepest
    penetration is that which contacts were found with, before they were corrected; without a
    contact it is 0.
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
            max((contact.depth for contact in report.contacts), default=0.0),
            report.contactCount,
            report.candidatePairs,
            report.constraintVisits,
            *(1e3 * report.seconds.get(phase, math.nan) for phase in PHASES),
        ]
    values += [math.nan] * (len(QUANTITY_UNITS) - len(values))
    return dict(zip(QUANTITY_UNITS, values, strict=True))


class StatsWriter:
    """Writes `step_quantities` of every step into a .csv file, as they come.

    A column each, named "name (unit)", after the number of the step; a number that is unknown is
    left out. Until `save`, the table is FILE.part.csv.
    """

    def __init__(self, path):
        """Raises OSError that names `path` when nothing can be written there."""
        self.path, self._partial = Path(path), partial_path(path)
        with named_errors(path):
            self._file = open(self._partial, "w", encoding="utf-8", newline="", buffering=1)
            self._writer = csv.writer(self._file, lineterminator="\n")
            names = [f"{name} ({unit})" if unit else name for name, unit in QUANTITY_UNITS.items()]
            self._writer.writerow(["step", *names])

    def add(self, simulation):
        """Writes the line of the simulation's present step; raises OSError."""
        values = step_quantities(simulation).values()
        with named_errors(self.path):
            self._writer.writerow(
                [simulation.stepCount, *("" if math.isnan(value) else value for value in values)]
            )

    def save(self, simulation):
        """Puts the file in its place, instead of an old one; raises OSError."""
        with named_errors(self.path):
            self._file.close()
            put_in_place(self._partial, self.path)

    def close(self):
        """Removes what was not saved."""
        with suppress(OSError):  # on a full disk, for what is still to be written
            self._file.close()
        if self._partial.is_file() and self._partial != self.path:
            self._partial.unlink()

    def summary(self, simulation):
        """Name and text of its row in the summary of a run."""
        return "statistics", shown_path(self.path)


class PlotWriter:
    """Plots `step_quantities` of every step as a PNG. Needs matplotlib, and no display."""

    def __init__(self, path):
        """Raises ImportError, which says what to install, where nothing can be plotted."""
        try:
            import matplotlib  # noqa: F401
        except ImportError:
            raise ImportError("--plot needs matplotlib: pip install matplotlib") from None
        self.path = Path(path)
        with named_errors(path):
            partial_path(path).parent.stat()
        self._rows = []

    def add(self, simulation):
        """Keeps the numbers of the simulation's present step."""
        self._rows.append(list(step_quantities(simulation).values()))

    def save(self, simulation):
        """Draws the plot, in place of an old one; raises OSError."""
        title = f"{scene_name(simulation.scenePath)}, to step {simulation.stepCount}"
        with atomic_write(self.path) as partial:
            plot_quantities(self._rows, partial, title)

    def close(self):
        """There is nothing to remove."""

    def summary(self, simulation):
        """Name and text of its row in the summary of a run."""
        return "plot", shown_path(self.path)


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


def plot_quantities(rows, path, title):
    """Draws what `step_quantities` gave of each step as a PNG over time; raises OSError."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = dict(zip(QUANTITY_UNITS, np.array(rows).T, strict=True))
    figure = Figure(figsize=PLOT_INCHES, dpi=PLOT_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title)
    panels = figure.subplots(3, 2, sharex=True)
    for axes, (name, unit, quantities) in zip(panels.flat, PLOT_PANELS, strict=True):
        shown = [q for q in quantities if np.isfinite(columns[q]).any()]
        prefix = quantities[0][:-1] if quantities[0].endswith("X") else ""
        for quantity, colour, dashes in zip(shown, PLOT_COLOURS, PLOT_DASHES, strict=False):
            axes.plot(
                columns["time"],
                columns[quantity],
                color=colour,
                linestyle=dashes,
                linewidth=1.2,
                label=quantity.removesuffix("Time").removeprefix(prefix),
            )
        axes.set_ylabel(f"{name} ({unit})" if unit else name)
        axes.grid(alpha=0.3)
        if shown:
            # Above the axes, where it hides nothing.
            axes.legend(
                loc="lower right",
                bbox_to_anchor=(1.0, 1.0),
                ncols=len(shown),
                fontsize="small",
                frameon=False,
                borderaxespad=0.2,
                columnspacing=1.0,
                handlelength=1.8,
            )
        else:
            axes.text(0.5, 0.5, "not in a recording", ha="center", transform=axes.transAxes)
        if shown and name in LOGARITHMIC_PANELS:
            axes.set_yscale("symlog", linthresh=LOGARITHMIC_PANELS[name])
    for axes in panels[-1]:
        axes.set_xlabel("time (s)")
    figure.savefig(path, format="png")
