"""Common style of the report's plots: size, type, colours."""

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot

# Okabe and Ito's colours for the colour-blind. Lines differ in dash or marker as well.
BLACK, BLUE, VERMILION, GREEN, ORANGE, SKY = (
    "#000000 #0072B2 #D55E00 #009E73 #E69F00 #56B4E9".split()
)
GREY = "0.55"
CENTIMETRE = 1 / 2.54
# Width and height of a panel, and of those that differ.
QUARTER = 4.4 * CENTIMETRE, 4.0 * CENTIMETRE
SIZES = {"contact": (8.2 * CENTIMETRE, 3.7 * CENTIMETRE)}
SIZES |= dict.fromkeys(
    ("pairs", "growth", "schedules", "engines"), (4.4 * CENTIMETRE, 5.4 * CENTIMETRE)
)
# Typst sets the text of plots in the report's own type; this one has the nearest widths.
MEASURED_TYPE, TYPE = "STIXGeneral", "New Computer Modern"

SETTINGS = {
    "font.family": MEASURED_TYPE,
    "mathtext.fontset": "stix",
    "font.size": 8,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "legend.fontsize": 7,
    "axes.linewidth": 0.6,
    "lines.markersize": 3.0,
    "xtick.major.pad": 2,
    "ytick.major.pad": 2,
    "axes.labelpad": 2,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "legend.handlelength": 1.4,
    "legend.labelspacing": 0.25,
    "legend.handletextpad": 0.5,
    "axes.grid": True,
    "grid.color": "0.92",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    # identical plots give identical bytes
    "svg.hashsalt": "rigid bodies",
    "svg.fonttype": "none",
}


def name_lines(axis, names, columns=1):
    """Writes the names of lines, text → colour, row by row, at the panel's upper left."""
    for k, (name, colour) in enumerate(names.items()):
        row, column = divmod(k, columns)
        at = {"transform": axis.transAxes, "va": "top", "fontsize": 7}
        axis.text(0.04 + 0.51 * column, 0.97 - 0.115 * row, name, color=colour, **at)


def draw(function, path):
    """Calls `function(axis)` on an empty panel, saves it to path (.svg), and returns its result."""
    with pyplot.rc_context(SETTINGS):
        figure, axis = pyplot.subplots(
            figsize=SIZES.get(function.__name__, QUARTER), layout="constrained"
        )
        figure.get_layout_engine().set(w_pad=0.02, h_pad=0.03)
        answer = function(axis)
        figure.savefig(path, metadata={"Date": None})
        pyplot.close(figure)
    path.write_text(path.read_text().replace(f"'{MEASURED_TYPE}'", f"'{TYPE}'"))
    return answer
