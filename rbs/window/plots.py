"""The window's plots of quantities over time."""

import numpy as np
import polyscope.imgui as psim
import polyscope.implot as implot

from rbs.scenes.messages import PREFIXES, prefix_of
from rbs.window.widgets import scaled

# Pixels: height of a plot, and width of its curves. Free margin around them, relative to the plot.
PLOT_HEIGHT, LINE_WIDTH, MARGIN = 220, 2.0, 0.1
# Plots from top to bottom: title and unit, and its curves: label and quantity.
PLOTS = {
    "energy (J)": {kind: f"{kind}Energy" for kind in ("kinetic", "potential", "total")},
    "momentum (N s)": {"x": "momentumX", "y": "momentumY", "z": "momentumZ"},
    "deepest penetration (m)": {"depth": "deepestPenetration"},
    "largest constraint violation (m)": {"violation": "largestViolation"},
}
NOW_COLOUR = (0.85, 0.85, 0.85, 0.8)


def draw_plots(plotted, now, seek):
    """Draws dict of step and (time in s, dict of quantities), with a line at `now`, in s.

    seek : called with the step that is clicked. Unknown quantities are left out.
    """
    if not plotted:
        return psim.TextWrapped("No data yet: press Play.")
    steps = sorted(plotted)
    history = [plotted[step] for step in steps]
    times = np.array([row[0] for row in history])
    for title, names in PLOTS.items():
        values = np.array([[row[1][name] for name in names.values()] for row in history])
        if not np.all(np.isnan(values)):
            clicked = draw_plot(title, names, times, values, now)
            if clicked is not None:
                seek(steps[int(np.argmin(np.abs(times - clicked)))])


def draw_plot(title, names, times, values, now):
    """Draws a plot. Returns the time that was clicked, or None."""
    flags = implot.ImPlotFlags_NoMenus
    if len(names) == 1:
        flags |= implot.ImPlotFlags_NoLegend
    prefix, clicked = prefix_of(np.abs(values).max(initial=0.0)), None
    shown = title.replace("(", f"({prefix}") + f"###{title}"
    implot.PushStyleVar(implot.ImPlotStyleVar_FitPadding, (0.0, MARGIN))
    if implot.BeginPlot(shown, (-1.0, scaled(PLOT_HEIGHT)), flags):
        fit = implot.ImPlotAxisFlags_AutoFit | implot.ImPlotAxisFlags_NoHighlight
        implot.SetupAxes("time (s)", "", fit, fit | implot.ImPlotAxisFlags_NoLabel)
        implot.SetupAxisFormat(implot.ImAxis_Y1, "%.3g")
        outside = implot.ImPlotLegendFlags_Outside | implot.ImPlotLegendFlags_Horizontal
        implot.SetupLegend(implot.ImPlotLocation_North, outside)
        for name, column in zip(names, values.T / PREFIXES[prefix], strict=True):
            implot.SetNextLineStyle(weight=scaled(LINE_WIDTH))
            implot.PlotLine(name, times, np.ascontiguousarray(column))
        implot.SetNextLineStyle(NOW_COLOUR, 1.0)
        noFit = implot.ImPlotItemFlags_NoFit | implot.ImPlotItemFlags_NoLegend
        implot.PlotInfLines("##now", np.array([now]), noFit)
        if implot.IsPlotHovered() and psim.IsMouseClicked(0):
            clicked = implot.GetPlotMousePos()[0]
        implot.EndPlot()
    implot.PopStyleVar()
    return clicked
