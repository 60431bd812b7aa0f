"""Common style of the report's plots: size, type, colours."""

import matplotlib

matplotlib.use("Agg")
from matplotlib import pyplot

# Okabe and Ito's colours for the colour-blind. Lines differ in dash or marker as well.
BLACK, BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY = (
    "#000000",
    "#0072B2",
    "#D55E00",
    "#009E73",
    "#CC79A7",
    "#E69F00",
    "#56B4E9",
)
COLOURS = [BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK]
GREY = "0.55"

CENTIMETRE = 1 / 2.54
# Sizes of panels in centimetres. Plots are printed at this size, so that font sizes are true: a
# third and a half of the text's width, and half of a column.
PANEL, WIDE, NARROW = (
    (width * CENTIMETRE, height * CENTIMETRE)
    for width, height in ((5.75, 4.5), (8.75, 4.5), (4.2, 3.5))
)
SIZES = {"batches": WIDE, "queue": WIDE, "gyroscopic": NARROW, "cliques": NARROW, "slick": NARROW}

SETTINGS = {
    "font.family": "DejaVu Sans",
    "font.size": 7.5,
    "axes.labelsize": 7.5,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "axes.linewidth": 0.6,
    "lines.linewidth": 1.1,
    "lines.markersize": 3.0,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "xtick.minor.size": 1.5,
    "ytick.minor.size": 1.5,
    "xtick.major.pad": 2,
    "ytick.major.pad": 2,
    "axes.labelpad": 2,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "legend.handlelength": 1.6,
    "legend.borderaxespad": 0.2,
    "legend.labelspacing": 0.25,
    "legend.handletextpad": 0.5,
    "axes.grid": True,
    "grid.color": "0.92",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    # identical plots give identical bytes
    "svg.hashsalt": "rigid bodies",
    "svg.fonttype": "path",
}


def draw(function, path):
    """Calls `function(axis)` on an empty panel, saves it to path (.svg), and returns its result."""
    size = SIZES.get(function.__name__, PANEL)
    with pyplot.rc_context(SETTINGS):
        figure, axis = pyplot.subplots(figsize=size, layout="constrained")
        figure.get_layout_engine().set(w_pad=0.02, h_pad=0.04)
        answer = function(axis)
        figure.savefig(path, metadata={"Date": None}, dpi=400)
        pyplot.close(figure)
    return answer
