"""The window's plots of quantities over time."""

import math
import time

import numpy as np
import polyscope.imgui as psim
import polyscope.implot as implot

from Quaternion import QRotate
from rbs.recordings.outputs import step_quantities
from rbs.scenes.messages import PREFIXES, prefix_of
from rbs.scenes.state import COLUMNS, STATE_NAMES, Energies
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
# Points of a curve, at most; seconds in a frame to compute them in.
MOST_POINTS, MEASURING_SECONDS = 1000, 0.04
# Columns of a moment's rows, by the attribute of a body.
STATE_COLUMNS = {STATE_NAMES[name]: columns for name, columns in COLUMNS.items()}
NOW_COLOUR = (0.85, 0.85, 0.85, 0.8)


class Measured(Energies):
    """The bodies of a `Moment`, as arrays, of which `step_quantities` can be taken."""

    report = None

    def __init__(self, moment):
        scene, self.time, self.settings = moment.scene, moment.time, moment.scene.settings
        self._rows, self._scene = moment.rows, scene
        invMass = scene.rows[:, 0]
        self._isFree = invMass > 0.0
        self._columns = {name: self._rows[:, columns] for name, columns in STATE_COLUMNS.items()}
        self._columns["mass"] = 1.0 / np.where(self._isFree, invMass, 1.0)
        self._columns["IT"] = scene.rows[:, 1:10]

    def _free(self, name, *shape):
        return self._columns[name][self._isFree].reshape(-1, *shape)

    def largest_violation(self):
        """Returns the largest violation of a constraint, in m; 0 if none is violated."""
        if not self._scene.constraints:
            return 0.0
        m1, v1, m2, v2, refValue, upper = zip(*self._scene.constraints, strict=True)
        ends = []
        for m, v in ((m1, v1), (m2, v2)):
            rest = [self._scene.restVertices[k][corner] for k, corner in zip(m, v, strict=True)]
            turned = QRotate(self._columns["orientation"][list(m)], np.array(rest))
            ends.append(turned + self._columns["position"][list(m)])
        gap = np.linalg.norm(np.subtract(*ends), axis=1) - refValue
        return max(0.0, float(np.where(upper, gap, -gap).max()))


def quantities_of(moment):
    """Returns `step_quantities` of a moment, which are computed once."""
    if moment.quantities is None:
        deepest = {"deepestPenetration": moment.deepest}
        moment.quantities = step_quantities(Measured(moment)) | deepest
    return moment.quantities


def draw_plots(axis, now, seek):
    """Draws the quantities of the moments of a `History`'s axis, with a line at `now`, in s.

    seek : called with the place that is clicked. Unknown quantities are left out. Of a long axis,
    some of the moments are drawn, and those that are not known yet follow in the next frames.
    Returns whether all are known.
    """
    every = 1 << max(math.ceil(math.log2(max(len(axis), 1) / MOST_POINTS)), 0)
    places = [k for k, moment in enumerate(axis) if moment.stepCount % every == 0]
    end, rows = time.perf_counter() + MEASURING_SECONDS, []
    for place in reversed(places):
        if axis[place].quantities is not None or time.perf_counter() < end:
            rows.append((place, quantities_of(axis[place])))
    rows.reverse()
    times = np.array([row["time"] for _, row in rows])
    for title, names in PLOTS.items():
        values = np.array([[row[name] for name in names.values()] for _, row in rows])
        if not np.all(np.isnan(values)):
            clicked = draw_plot(title, names, times, values, now)
            if clicked is not None:
                seek(rows[int(np.argmin(np.abs(times - clicked)))][0])
    return len(rows) == len(places)


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
