"""The window's plots of quantities over time, with a cursor."""

import numpy as np
import polyscope.imgui as psim
import polyscope.implot as implot

from rbs.window.widgets import scaled

# Pixels: height of each plot if all are shown, least height of a single one, and height of the line
# of values below it.
PLOT_HEIGHT, LARGE_PLOT_HEIGHT, READING_HEIGHT = 250, 320, 70
# Width of the curves in pixels, and free margin around them as a fraction of the plot.
LINE_WIDTH, MARGIN = 2.0, 0.1
# Prefixes of the units, and their values; a plot has the largest that its greatest value reaches.
PREFIXES = {"G": 1e9, "M": 1e6, "k": 1e3, "": 0.0}
# Plots from top to bottom: title and unit, and its curves: label and quantity.
PLOTS = {
    "energy (J)": {
        "kinetic": "kineticEnergy",
        "potential": "potentialEnergy",
        "total": "totalEnergy",
    },
    "momentum (N s)": {"x": "momentumX", "y": "momentumY", "z": "momentumZ"},
    "deepest penetration (m)": {"depth": "deepestPenetration"},
    "largest constraint violation (m)": {"violation": "largestViolation"},
}
ALL_PLOTS = "all"
CURSOR_COLOUR = (0.85, 0.85, 0.85, 0.8)


class Plots:
    """Draws PLOTS. Attributes: chosen, a title or ALL_PLOTS; cursor, time at the mouse in s."""

    def __init__(self):
        self.chosen = ALL_PLOTS
        self.cursor = None

    def draw(self, history, room):
        """Draws rows (time in s, dict of quantities). Unknown quantities are left out.

        room : pixels, the height available to a single plot
        """
        if not history:
            psim.TextWrapped("No data yet: press Play.")
            return
        times = np.array([row[0] for row in history])
        cursor, self.cursor = self.cursor, None
        for title, names in PLOTS.items():
            values = np.array([[row[1][name] for name in names.values()] for row in history])
            if self.chosen in (ALL_PLOTS, title) and not np.all(np.isnan(values)):
                height = max(LARGE_PLOT_HEIGHT, room - READING_HEIGHT)
                height = PLOT_HEIGHT if self.chosen == ALL_PLOTS else height
                self._draw_one(title, names, times, values, cursor, height)

    def _draw_one(self, title, names, times, values, cursor, height):
        flags = implot.ImPlotFlags_NoMenus | implot.ImPlotFlags_NoMouseText
        if len(names) == 1:
            flags |= implot.ImPlotFlags_NoLegend
        prefix = prefix_of(np.abs(values).max(initial=0.0))
        values = values / (PREFIXES[prefix] or 1.0)
        shown = title.replace("(", f"({prefix}") + f"###{title}"
        implot.PushStyleVar(implot.ImPlotStyleVar_FitPadding, (0.0, MARGIN))
        if implot.BeginPlot(shown, (-1.0, height), flags):
            fit = implot.ImPlotAxisFlags_AutoFit | implot.ImPlotAxisFlags_NoHighlight
            implot.SetupAxes("time (s)", "", fit, fit | implot.ImPlotAxisFlags_NoLabel)
            implot.SetupAxisFormat(implot.ImAxis_Y1, "%.3g")
            outside = implot.ImPlotLegendFlags_Outside | implot.ImPlotLegendFlags_Horizontal
            implot.SetupLegend(implot.ImPlotLocation_North, outside)
            for name, column in zip(names, values.T, strict=True):
                implot.SetNextLineStyle(weight=scaled(LINE_WIDTH))
                implot.PlotLine(name, times, np.ascontiguousarray(column))
            if cursor is not None:
                implot.SetNextLineStyle(CURSOR_COLOUR, 1.0)
                noFit = implot.ImPlotItemFlags_NoFit | implot.ImPlotItemFlags_NoLegend
                implot.PlotInfLines("##cursor", np.array([cursor]), noFit)
            if implot.IsPlotHovered():
                self.cursor = float(np.clip(implot.GetPlotMousePos()[0], times[0], times[-1]))
            implot.EndPlot()
        implot.PopStyleVar()
        place = len(times) - 1 if cursor is None else int(np.argmin(np.abs(times - cursor)))
        psim.TextWrapped(reading(times[place], list(names), values[place]))


def prefix_of(value):
    """Returns the one of PREFIXES with which a value is shown in few digits."""
    return next(prefix for prefix, size in PREFIXES.items() if not value < size)


def reading(time, names, values):
    """Returns the values of the curves at a time, in one line."""
    numbers = ", ".join(f"{name} {value:.3g}" for name, value in zip(names, values, strict=True))
    return f"at {time:.2f} s: {numbers}"
