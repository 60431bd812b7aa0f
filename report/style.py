"""Common style of the report's plots: size, type, colours. Lines differ in dash or marker, too."""

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot
from matplotlib.ticker import NullFormatter

# Okabe and Ito's colours for the colour-blind.
COLOURS = "#000000 #0072B2 #D55E00 #009E73 #E69F00 #56B4E9"
BLACK, BLUE, VERMILION, GREEN, ORANGE, SKY = COLOURS.split()
LOOKS = ((BLUE, "o"), (VERMILION, "s"), (GREEN, "^"))
# Typst sets the text of plots in the report's own type; this one has the nearest widths.
MEASURED_TYPE, TYPE = "STIXGeneral", "Libertinus Serif"

# identical plots give identical bytes
SETTINGS = {"font.family": MEASURED_TYPE, "svg.hashsalt": "rigid bodies", "svg.fonttype": "none"}
SETTINGS |= {"mathtext.fontset": "stix", "font.size": 8.5}
SETTINGS |= {"lines.markersize": 3.5, "lines.linewidth": 1.0}
SETTINGS |= dict.fromkeys(("xtick.labelsize", "ytick.labelsize", "legend.fontsize"), 8)
SETTINGS |= dict.fromkeys(("xtick.major.pad", "ytick.major.pad", "axes.labelpad"), 2)
SETTINGS |= dict.fromkeys(("axes.spines.top", "axes.spines.right", "legend.frameon"), False)
SETTINGS |= {"legend.borderaxespad": 0.2, "legend.handlelength": 1.6, "legend.labelspacing": 0.2}
SETTINGS |= {"legend.handletextpad": 0.5, "axes.linewidth": 0.6, "axes.axisbelow": True}
SETTINGS |= {"axes.grid": True, "grid.color": "0.92", "grid.linewidth": 0.5}


def ticks(axis, x=(), y=()):
    """Labels these places alone on axes with logarithms."""
    for own, places in ((axis.xaxis, x), (axis.yaxis, y)):
        if len(places):
            own.set_minor_formatter(NullFormatter())
            own.set_ticks(places, [f"{place:g}" for place in places])


def measure(one, path):
    """Returns the numbers of an `Experiment`; if it draws a panel, saves it to path (.svg)."""
    if one.size is None:
        return one.function()
    with pyplot.rc_context(SETTINGS):
        size = [side / 2.54 for side in one.size]
        figure, axis = pyplot.subplots(figsize=size, layout="constrained")
        figure.get_layout_engine().set(w_pad=0.02, h_pad=0.03)
        answer = one.function(axis)
        figure.savefig(path, metadata={"Date": None})
        pyplot.close(figure)
    path.write_text(path.read_text().replace(f"'{MEASURED_TYPE}'", f"'{TYPE}'"))
    return answer
