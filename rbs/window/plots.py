"""The window's plots of quantities over time."""

import math

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
# Part of a plot's width that names may take for a legend on one line.
LEGEND_SHARE = 0.5
# Points of a curve, at most.
MOST_POINTS = 1000
NOW_COLOUR = (0.85, 0.85, 0.85, 0.8)


def draw_plots(history, seek):
    """Draws the quantities of the moments of a `History`'s axis, with a line at the present one.

    seek : called with the place that is clicked. Unknown quantities are left out. Of a long axis,
    some of the moments are drawn, and those that are not known yet follow in the next frames.
    Returns whether all are known.
    """
    axis = history.axis
    every = 1 << max(math.ceil(math.log2(max(len(axis), 1) / MOST_POINTS)), 0)
    places = [k for k, moment in enumerate(axis) if moment.stepCount % every == 0]
    history.measure(reversed(places))
    known = [place for place in places if axis[place].quantities is not None]
    rows = [axis[place].quantities for place in known]
    times = np.array([row["time"] for row in rows])
    for title, names in PLOTS.items():
        values = np.array([[row[name] for name in names.values()] for row in rows])
        isMeant = history.now.scene.constraints or "violation" not in names
        if isMeant and not np.all(np.isnan(values)):
            clicked = draw_plot(title, names, times, values, history.now.time)
            if clicked is not None:
                seek(known[int(np.argmin(np.abs(times - clicked)))])
    return len(known) == len(places)


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
        flags = implot.ImPlotLegendFlags_Outside
        if psim.CalcTextSize("".join(names))[0] < LEGEND_SHARE * psim.GetContentRegionAvail()[0]:
            flags |= implot.ImPlotLegendFlags_Horizontal
        implot.SetupLegend(implot.ImPlotLocation_North, flags)
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
