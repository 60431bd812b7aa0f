"""Section 4: what each rung of the ladder saves, and two diagrams of how."""

import itertools

import numpy as np
import style
from engines import in_turns
from links import watched
from matplotlib import pyplot
from matplotlib.patches import Rectangle
from runs import AWAKE, BATCHED, SOFT, H, box, experiment, heap, run, scene

from rbs.geometry.broadphase import grid_levels
from rbs.stepping.batches import in_batches
from rbs.stepping.constraints import coloured_batches
from rbs.stepping.settings import CONSTRAINT_TOLERANCE as TOLERANCE, SWEEPS

# name → settings
RUNGS = {"all": {}, "grid": {"broadPhase": "grid"}, "batches": BATCHED, "soft": AWAKE}
BODIES, COLLAPSING = (20, 200, 1000, 2000, 5000), 150  # steps until a heap collapses
MIDDLE, SLOW = 1000, 2000  # bodies


@experiment(isTimed=True)
def ladder():
    """Milliseconds of the same steps of collapsing heaps, all rungs from one state, medians; and
    with MIDDLE bodies, of the same ones too far apart to touch, for which tests of pairs are left;
    candidate pairs and batches.
    """
    numbers = {}
    for count in BODIES:
        start = heap(count, COLLAPSING, **BATCHED).state()
        runs = {name: heap(count, **settings) for name, settings in RUNGS.items()}
        if count == MIDDLE:
            runs["apart"] = heap(count, gravity=(0.0, 0.0, 0.0))
        times = {name: [] for name in runs}
        for _ in range(1 if count >= SLOW else 4):
            for name, one in runs.items():
                one.set_state(start)
                for mesh in one.meshes if name == "apart" else ():
                    mesh.position = 10.0 * mesh.position
            for name, values in in_turns(runs, 1).items():
                times[name] += values.tolist()
        own = {name: float(np.median(values)) for name, values in times.items()}
        own |= {"gridGain": own["all"] / own["grid"], "gain": own["grid"] / own["batches"]}
        report = runs["grid"].report
        pairs = np.array([(c.body1, c.body2) for c in report.contacts if c.body2 >= 0]).T
        seconds = report.seconds
        own["colliding"] = 100 * seconds["collisions"] / sum(seconds.values())
        own["batchCount"] = len(in_batches(*pairs, np.zeros(count, dtype=bool))[1]) - 1
        own |= {"pairs": count * (count - 1) // 2, "near": report.candidatePairs}
        own["inBatch"] = len(pairs[0]) / own["batchCount"]
        numbers[f"n{count}"] = own | {"contacts": len(pairs[0])}
    many = numbers[f"n{MIDDLE}"]
    return numbers | {"saved": (many["all"] - many["grid"]) / many["apart"]}


CHAIN_LINK = 2.31  # m, upper bound of the links of the long chain of chimes
# name → scene, and step from which it is measured
CASES = {name: (name, 50) for name in ("chimes", "cube", "bridge", "net")} | {
    "loaded": ("net", 120)
}
SCHEDULES, COUNTED = ("sweep", "queue", "batches"), 5  # steps whose visits are counted


@experiment(isTimed=True)
def schedules():
    """Milliseconds (medians) and visits (means over the same steps) of a step of scenes with
    constraints, by schedule; visits of the sweep that correct, and that all its sweeps would make.
    """
    numbers = {"sweeps": SWEEPS}
    for name, (file, begin) in CASES.items():
        start = scene(file, begin, **BATCHED).state()
        runs = {one: scene(file, constraintScheduling=one, **BATCHED) for one in SCHEDULES}
        counted, visits = scene(file), []
        for _ in range(COUNTED):
            for one in (counted, *runs.values()):
                one.set_state(start)
            for one in runs.values():
                one.step()
            own = [one.report.constraintVisits for one in runs.values()]
            visits.append([*own, watched(counted)["corrections"]])
            start = runs["sweep"].state()
        times = {one: np.median(values) for one, values in in_turns(runs, 6).items()}
        *means, corrections = np.mean(visits, axis=0).tolist()
        found = zip(SCHEDULES, means, strict=True)
        numbers[name] = {one: {"ms": times[one], "visits": mean} for one, mean in found}
        rows = runs["sweep"].constraints
        tight = [one for one in rows if one[5] or one[4] > TOLERANCE]
        isFixed = np.array([mesh.isFixed for mesh in runs["sweep"].meshes])
        ends = np.array([(one[0], one[2]) for one in tight]).T
        batches = len(coloured_batches(*ends, isFixed))
        numbers[name] |= {"gain": times["queue"] / times["sweep"], "most": SWEEPS * len(tight)}
        numbers[name] |= {"corrections": corrections, "inBatch": len(tight) / batches}
    chimes = scene("chimes", 50, **BATCHED)
    chimes.constraints = [one for one in chimes.constraints if abs(one[4] - CHAIN_LINK) > 1e-3]
    visits, short = watched(chimes)["visits"], sum(one[5] for one in chimes.constraints)
    return numbers | {"unchained": visits / short, "short": int(short)}


MOMENTS, LAST = (0, 150, 600, 1150), 1500  # steps
LINES = {"batches": "batches", "awake": "soft step, awake", "soft": "soft step"}


@experiment((5.2, 4.8), isTimed=True)
def life(axis):
    """Milliseconds of a step of a heap of 1000 from its release until it rests."""
    ways = {"batches": BATCHED, "awake": AWAKE, "soft": SOFT}
    runs, rows = {name: heap(1000, **way) for name, way in ways.items()}, []
    while runs["batches"].stepCount < LAST:
        rows.append([np.median(values) for values in in_turns(runs, 2).values()])
    step, numbers = LAST / len(rows) * (np.arange(len(rows)) + 0.5), {}
    for name, values, (colour, mark) in zip(runs, np.transpose(rows), style.LOOKS, strict=True):
        axis.plot(H * step, values, mark + "-", color=colour, label=LINES[name], markevery=4)
        numbers |= {f"{name}{k}": float(np.interp(k, step, values)) for k in MOMENTS}
    top = 1.5 * np.max(rows)  # room for the legend
    axis.set(xlabel="time / s", ylabel="ms per step", ylim=(0, top), xlim=(0, H * LAST))
    axis.legend(loc="upper left")
    return numbers | {"asleep": 100 * float(runs["soft"].report.isAsleep.mean())}


BAR = 20  # m, the diagram's scale


@experiment((6.4, 4.8))
def grid(axis):
    """Diagram of the grid: boxes from above, in columns along x, and those compared with one."""
    simulation = scene("pile_200", COLLAPSING, **BATCHED)
    low, high = np.split(np.array([mesh.bounding_box() for mesh in simulation.meshes]), 2, axis=1)
    level, _, width = next(iter(grid_levels(np.concatenate([low, -high], axis=1).T)))
    column = np.floor(low[:, 1:] / width)
    query = min(level, key=lambda k: np.abs(low[k] + high[k])[::2].sum())
    isIn = (np.abs(column - column[query]) <= 1).all(axis=1)
    isIn &= (low[:, 0] <= high[query, 0]) & (low[:, 0] >= low[query, 0] - width)
    meets = ((low <= high[query]) & (low[query] <= high)).all(axis=1)
    x, z = low[query, 0], column[query, 1]
    axis.axhspan((z - 1) * width, (z + 2) * width, color="0.93")
    for k in np.arange(z - 3, z + 5):
        axis.axhline(k * width, color="0.6", linewidth=0.5)
    for k in level:
        look = {"facecolor": "none", "edgecolor": "0.6", "linewidth": 0.5}
        if isIn[k]:
            look = {"facecolor": style.SKY if meets[k] else "white", "edgecolor": style.BLUE}
        if k == query:
            look = {"facecolor": style.VERMILION, "edgecolor": "black"}
        size = (high - low)[k, ::2]
        axis.add_patch(Rectangle(low[k, ::2], *size, zorder=1 + isIn[k] + (k == query), **look))
    axis.set(aspect="equal", xticks=[], yticks=[], xlabel="x", ylabel="z")
    left, bottom = x - 2.4 * width, (z - 1.4) * width
    axis.set(xlim=(left, left + 5.2 * width), ylim=(bottom, bottom + 3.8 * width))
    axis.plot([left + 2, left + 2 + BAR], [bottom + 2] * 2, color="black", linewidth=2)
    axis.text(left + 3 + BAR, bottom + 2, f"{BAR} m", va="center")
    axis.grid(False)
    return {"compared": int(isIn[level].sum()) - 1, "bodies": len(low)}


ROWS, BRICK = 5, np.array([9.0, 6.0, 8.0])  # m


@experiment((6.0, 4.8))
def colours(axis):
    """Diagram of batches: contacts of a pyramid, each with the number of its batch."""
    places = [(c - (ROWS - 1 - r) / 2, r) for r in range(ROWS) for c in range(ROWS - r)]
    meshes = [box((1.02 * BRICK[0] * x, BRICK[1] * (r + 0.5), 0), BRICK) for x, r in places]
    (report,) = run(meshes, 1, contactScheduling="batches")
    pairs = np.array([(c.body1, c.body2) for c in report.contacts if c.body2 >= 0]).T
    order, starts = in_batches(*pairs, np.zeros(len(meshes), dtype=bool))
    middle = np.array([mesh.position[0, :2] for mesh in meshes])
    number = {"fontsize": 8.5, "ha": "center", "va": "center"}
    for k, place in enumerate(middle):
        look = {"facecolor": "0.95", "edgecolor": "0.5", "linewidth": 0.6}
        axis.add_patch(Rectangle(place - BRICK[:2] / 2, *BRICK[:2], **look))
        axis.text(*place, k + 1, color="0.45", **number)
    shades = pyplot.get_cmap("plasma")(np.linspace(0.0, 0.8, len(starts) - 1))
    for batch, some in enumerate(itertools.starmap(slice, itertools.pairwise(starts))):
        for place in middle[pairs[:, order[some]]].mean(axis=0):
            axis.plot(*place, "o", color=shades[batch], markersize=11)
            axis.text(*(place - [0, 0.2]), batch + 1, color="white", **number)
    axis.axis("off")
    axis.set(aspect="equal", xlim=(-24, 24), ylim=(-1, 31))
    return {"pairs": pairs.shape[1], "batches": len(starts) - 1}
