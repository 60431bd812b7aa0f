"""The window's plots of quantities over time, with a cursor."""

from functools import partial

import numpy as np
import polyscope.imgui as psim
import polyscope.implot as implot

from rbs.scenes.messages import PREFIXES, prefix_of
from rbs.window.widgets import draw_choice, scaled

# Pixels: height of each plot if all are shown, least height of a single one, and height of the line
# of values below it.
PLOT_HEIGHT, LARGE_PLOT_HEIGHT, READING_HEIGHT = 250, 320, 70
# Width of the curves in pixels, and free margin around them as a fraction of the plot.
LINE_WIDTH, MARGIN = 2.0, 0.1
# Plots from top to bottom: title and unit, and its curves: label and quantity.
PLOTS = {
    "energy (J)": {kind: f"{kind}Energy" for kind in ("kinetic", "potential", "total")},
    "momentum (N s)": {"x": "momentumX", "y": "momentumY", "z": "momentumZ"},
    "deepest penetration (m)": {"depth": "deepestPenetration"},
    "largest constraint violation (m)": {"violation": "largestViolation"},
}
ALL_PLOTS = "all"
CURSOR_COLOUR = (0.85, 0.85, 0.85, 0.8)


class Plots:
    """Draws PLOTS. Attributes: chosen, a title or ALL_PLOTS; cursor, s, at the mouse, or None."""

    chosen, cursor = ALL_PLOTS, None

    def draw(self, plotted, now, room, seek):
        """Draws dict of step and (time in s, dict of quantities), in a panel of `room` pixels.

        now : s, of the present; seek : called with the step that is clicked. Unknown quantities are
        left out.
        """
        act, about = partial(setattr, self, "chosen"), "All plots, or a single large one"
        draw_choice("plot", self.chosen, [ALL_PLOTS, *PLOTS], act, about)
        if not plotted:
            return psim.TextWrapped("No data yet: press Play.")
        steps = sorted(plotted)
        history = [plotted[step] for step in steps]
        isAll, room = self.chosen == ALL_PLOTS, room - psim.GetCursorPosY() - READING_HEIGHT
        height = PLOT_HEIGHT if isAll else max(LARGE_PLOT_HEIGHT, room)
        times = np.array([row[0] for row in history])
        cursor, self.cursor = now if self.cursor is None else self.cursor, None
        for title, names in PLOTS.items():
            values = np.array([[row[1][name] for name in names.values()] for row in history])
            if (isAll or title == self.chosen) and not np.all(np.isnan(values)):
                if self._draw_one(title, names, times, values, cursor, height):
                    seek(steps[int(np.argmin(np.abs(times - self.cursor)))])

    def _draw_one(self, title, names, times, values, cursor, height):
        """Draws a plot. Returns whether it was clicked."""
        flags = implot.ImPlotFlags_NoMenus | implot.ImPlotFlags_NoMouseText
        if len(names) == 1:
            flags |= implot.ImPlotFlags_NoLegend
        prefix = prefix_of(np.abs(values).max(initial=0.0))
        values = values / PREFIXES[prefix]
        shown = title.replace("(", f"({prefix}") + f"###{title}"
        isClicked = False
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
            implot.SetNextLineStyle(CURSOR_COLOUR, 1.0)
            noFit = implot.ImPlotItemFlags_NoFit | implot.ImPlotItemFlags_NoLegend
            implot.PlotInfLines("##cursor", np.array([cursor]), noFit)
            if implot.IsPlotHovered():
                self.cursor = float(np.clip(implot.GetPlotMousePos()[0], times[0], times[-1]))
                isClicked = psim.IsMouseClicked(0)
            implot.EndPlot()
        implot.PopStyleVar()
        place = int(np.argmin(np.abs(times - cursor)))
        numbers = (f"{name} {value:.3g}" for name, value in zip(names, values[place], strict=True))
        psim.TextWrapped(f"at {times[place]:.2f} s: {', '.join(numbers)}")
        return isClicked
