"""Scaling of the program, as seen in its own runs: grid, ordered batches, constraint queue.

Each function draws its panel and returns the numbers in the text, as in `experiments.py`. `watched`
observes the calls that a step makes, without changing them.
"""

from contextlib import contextmanager

import numpy as np
import style
from experiments import BOX, body, experiment, heap_scene, scene, shape, silent, slope, text
from matplotlib.patches import Rectangle
from scipy.spatial import cKDTree

import rbs.stepping.batches
import rbs.stepping.constraints
import RBSFunctions
from rbs.geometry.broadphase import grid_levels, grid_overlaps
from rbs.scenes.simulation import Settings, Simulation

HEAP_STEP = 150  # by then, a heap has begun to collapse
MATERIAL = {"friction": 0.5, "restitution": 0.0}


def thousands(number):
    """Formats a whole number with thin spaces between its thousands."""
    return f"{number:,.0f}".replace(",", "\u202f")


def heap(count, steps=HEAP_STEP, **settings):
    """Returns a dense heap of so many bodies, after some steps."""
    settings = {"broadPhase": "grid", **MATERIAL, **settings}
    simulation = Simulation(heap_scene(count), Settings(**settings))
    for _ in range(steps):
        simulation.step()
    return simulation


def boxes(meshes):
    """Bounding boxes of the bodies, (6, n), as in `rbs.geometry.broadphase`."""
    low = np.array([mesh.currVertices.min(axis=0) for mesh in meshes])
    high = np.array([mesh.currVertices.max(axis=0) for mesh in meshes])
    return np.concatenate([low, -high], axis=1).T


@contextmanager
def watched(module, name, wrapper):
    """Replaces a function or class of the module by `wrapper` of it within the `with` block."""
    original = getattr(module, name)
    setattr(module, name, wrapper(original))
    try:
        yield
    finally:
        setattr(module, name, original)


# --------------------------------------------------------------------------------------------------
# The grid
# --------------------------------------------------------------------------------------------------


@experiment
def grid(axis):
    """Columns of the grid seen along x, and the bodies with which one body is compared."""
    meshes = heap(1000).meshes
    low = np.min([mesh.currVertices.min(axis=0) for mesh in meshes], axis=0)
    high = np.max([mesh.currVertices.max(axis=0) for mesh in meshes], axis=0)
    middle, size = (low + high) / 2, 1.6 * (high - low)
    floor = body(
        "box",
        (middle[0], low[1] - 8.0, middle[2]),
        size=np.array([size[0], 10.0, size[2]]) / BOX,
        isFixed=True,
    )
    meshes = [*meshes, floor]
    box = boxes(meshes)
    isFixed = np.array([mesh.isFixed for mesh in meshes])
    levels = [(level, width) for level, _, width in grid_levels(box)]
    (large, _), (small, width) = levels
    first, second = grid_overlaps(box, isFixed)
    # the body whose query is drawn: the one with most partners near the middle of the heap
    centre = (box[:3] - box[3:]) / 2
    away = np.linalg.norm(centre - middle[:, None], axis=0)
    partners = np.bincount(np.concatenate((first, second)), minlength=len(meshes))
    asked = np.where((away < 1.2 * width) & ~isFixed, partners, -1).argmax()
    cell = np.floor(box[1:3] / width)
    isNear = (np.abs(cell - cell[:, asked, None]) <= 1).all(axis=0) & np.isin(
        np.arange(len(meshes)), small
    )
    alongX = isNear & (box[0] <= -box[3, asked]) & (box[0, asked] <= -box[3])
    partners = np.concatenate((second[first == asked], first[second == asked]))
    assert alongX[partners[partners != len(meshes) - 1]].all()

    y, z = cell[:, asked]
    axis.add_patch(
        Rectangle(
            ((z - 1) * width, (y - 1) * width),
            3 * width,
            3 * width,
            facecolor="#DCE9F5",
            edgecolor="none",
            zorder=0,
        )
    )
    for k in range(len(meshes)):
        corner = box[2, k], box[1, k]
        sides = -box[5, k] - box[2, k], -box[4, k] - box[1, k]
        look = {"facecolor": "none", "edgecolor": "0.82", "linewidth": 0.25, "zorder": 1}
        if k == asked:
            look = {"facecolor": style.VERMILION, "edgecolor": "0.2", "zorder": 4}
        elif k in partners and k in small:
            look = {"facecolor": style.ORANGE, "edgecolor": "0.2", "zorder": 3}
        elif alongX[k]:
            look = {"facecolor": "none", "edgecolor": style.BLUE, "linewidth": 0.7, "zorder": 2}
        axis.add_patch(Rectangle(corner, *sides, **{"linewidth": 0.5, **look}))
    bottom, height = low[1] - 0.3 * width, 3.6 * width
    axis.set(
        xlim=((z + 0.5) * width - 0.7 * height, (z + 0.5) * width + 0.7 * height),
        ylim=(bottom, bottom + height),
        aspect="equal",
        xlabel="z / m",
        ylabel="y / m",
    )
    ticks = np.arange(-20, 21) * width
    axis.grid(False)
    for tick in ticks:
        axis.axvline(tick, color="0.7", linewidth=0.5, zorder=0.5)
        axis.axhline(tick, color="0.7", linewidth=0.5, zorder=0.5)
    return {
        "bodies": "1000",
        "levels": str(len(levels)),
        "width": text(width, 1),
        "large": str(len(large)),
        "near": str(int(isNear.sum()) - 1),
        "alongX": str(int(alongX.sum()) - 1),
        "partners": str(int(np.isin(partners, small).sum())),
        "step": str(HEAP_STEP),
    }


CANDIDATE_SIZES = (50, 100, 200, 500, 1000, 2000)


@experiment
def candidates(axis):
    """Candidate pairs against the number of bodies: all, along one axis, and of the grid."""
    rows = []
    for count in CANDIDATE_SIZES:
        meshes = heap(count).meshes
        box = boxes(meshes)
        first, _ = grid_overlaps(box, np.zeros(count, dtype=bool))
        order = np.sort(box[0])
        alongX = np.sum(order.searchsorted(-box[3], side="right")) - count * (count + 1) / 2
        # spheres of the largest radius about the centres, as a k-d tree of points would find them
        centre = ((box[:3] - box[3:]) / 2).T
        radius = max(np.linalg.norm(shape(m.name.split(" ")[0])[0], axis=1).max() for m in meshes)
        tree = len(cKDTree(centre).query_pairs(2 * radius))
        rows.append((count * (count - 1) / 2, alongX, tree, len(first)))
    every, alongX, tree, own = np.array(rows, dtype=float).T
    n = np.array(CANDIDATE_SIZES, dtype=float)
    for values, colour, mark, label in (
        (every, style.BLACK, ":", "all pairs"),
        (alongX, style.VERMILION, "^-", "one axis sorted"),
        (tree, style.GREEN, "v-", "tree of centres"),
        (own, style.BLUE, "s-", "grid"),
    ):
        axis.loglog(n, values, mark, color=colour, label=label)
    axis.set(xlabel="bodies N", ylabel="candidate pairs", ylim=(30, 2e7))
    axis.set_xticks([50, 200, 1000], ["50", "200", "1000"])
    axis.minorticks_off()
    axis.legend(loc="upper left", ncols=1)
    return {
        "least": str(CANDIDATE_SIZES[0]),
        "most": thousands(n[-1]),
        "count": str(len(n)),
        "step": str(HEAP_STEP),
        "all": thousands(every[-1]),
        "grid": thousands(own[-1]),
        "tree": thousands(tree[-1]),
        "axis": thousands(alongX[-1]),
        "aBody": text(own[-1] / n[-1], 1),
        "share": text(100 * own[-1] / every[-1], 2),
        "exponent": text(slope(n, own), 2),
        "axisExponent": text(slope(n, alongX), 2),
        "treeRatio": text(tree[-1] / own[-1], 1),
        "axisRatio": text(alongX[-1] / own[-1], 0),
    }


# --------------------------------------------------------------------------------------------------
# Batches of contacts
# --------------------------------------------------------------------------------------------------


class Passes:
    """Records of the grid steps of a simulation, written by the wrapped `Pass`.

    steps : list of lists, one dict per pass: number of batches; isComplete; and per pair keys, its
        position in the order, batch, touches, isNew (P,), whether the first pass missed it
    """

    def __init__(self):
        self.steps = []

    def wrapper(self, original):
        steps = self.steps

        class Watched(original):
            def run(self):
                contacts = super().run()
                if not steps or steps[-1][-1]["isComplete"]:
                    steps.append([])
                first, second = self.bodyPair
                keys = first * len(self.margin) + second
                begun = steps[-1][0]["keys"] if steps[-1] else keys
                sizes = np.diff(self.starts)
                steps[-1].append(
                    dict(
                        keys=keys,
                        batch=np.arange(len(sizes)).repeat(sizes),
                        batches=len(sizes),
                        touches=np.isin(self.rank, contacts.rank),
                        isNew=~np.isin(keys, begun),
                    )
                )
                return contacts

            def has_missed(self, history):
                hasMissed = super().has_missed(history)
                steps[-1][-1]["isComplete"] = not hasMissed
                return hasMissed

        return Watched


SQUEEZED = 0.8  # factor of the distances between the bodies of a heap, which then overlap


@experiment
def batches(axis):
    """Pairs of one step in their batches, including those that a roll-back added.

    No step of a collapsing heap is rolled back. The figure therefore shows the first step of a heap
    whose bodies start inside each other, when their displacements are not yet known.
    """
    usual, squeezed = Passes(), Passes()
    with watched(rbs.stepping.batches, "Pass", usual.wrapper):
        heap(1000, 200)
    simulation = heap(500, 0)
    for mesh in simulation.meshes:
        mesh.position = SQUEEZED * mesh.position
    with watched(rbs.stepping.batches, "Pass", squeezed.wrapper):
        simulation.step()
    (passes,) = squeezed.steps
    assert passes[-1]["isComplete"] and not passes[0]["isComplete"]
    last = passes[-1]
    turn, touches, isNew = last["keys"].argsort().argsort(), last["touches"], last["isNew"]
    for some, colour, size, label in (
        (~touches, "0.7", 2.5, "apart"),
        (touches & ~isNew, style.BLUE, 4.0, "touching"),
        (isNew, style.VERMILION, 9.0, "added by a roll-back"),
    ):
        axis.scatter(
            turn[some], last["batch"][some], s=size, color=colour, label=label, linewidths=0
        )
    axis.set(
        xlabel="turn of the pair in the list's order",
        ylabel="batch",
        xlim=(0, len(turn)),
        ylim=(last["batches"], -1),
    )
    axis.legend(loc="lower left", markerscale=1.5)
    counts = np.array([len(step) for step in usual.steps])
    pairs, rounds = np.array(
        [[len(step[0]["keys"]), step[0]["batches"]] for step in usual.steps[100:]]
    ).T
    looked = sum(len(one["keys"]) for one in passes)
    return {
        "bodies": "1000",
        "steps": str(len(counts)),
        "from": "100",
        "pairs": thousands(np.median(pairs)),
        "batches": text(np.median(rounds), 0),
        "size": text(np.median(pairs / rounds), 0),
        "again": str(int(np.sum(counts > 1))),
        "needs": f"needed {np.sum(counts > 1)} times" if counts.max() > 1 else "never needed",
        "squeezed": f"{100 * (1 - SQUEEZED):.0f}",
        "drawnBodies": "500",
        "drawnPairs": thousands(len(turn)),
        "drawnBatches": str(last["batches"]),
        "drawnNew": str(int(isNew.sum())),
        "drawnPasses": str(len(passes)),
        "cost": text(looked / len(turn), 1),
    }


# --------------------------------------------------------------------------------------------------
# The queue of constraints
# --------------------------------------------------------------------------------------------------


class Visits:
    """Visits of the schedules, recorded by the wrapped functions.

    steps : list of lists, `(constraint, was violated)` per visit, or the number for a batch
    """

    def __init__(self):
        self.steps = []

    def schedule(self, original):
        """Wraps `sweep` or `queue`, which take a visit."""

        def watching(visit, *arguments):
            self.steps.append([])
            return original(self.visit(visit), *arguments)

        return watching

    def step(self, original):
        """Wraps `project_in_batches`."""

        def watching(*arguments):
            self.steps.append([])
            return original(*arguments)

        return watching

    def visit(self, original):
        """Wraps a visit, or `visit_batch`."""

        def watching(*arguments):
            isViolated = original(*arguments)
            c = arguments[4] if len(arguments) > 1 else arguments[0]
            self.steps[-1].append((c, isViolated))
            return isViolated

        return watching

    def counts(self):
        """Number of visits per step to constraints that can be violated at all."""
        return np.array(
            [
                sum(len(c) if isinstance(c, np.ndarray) else 1 for c, _ in made)
                for made in self.steps
            ]
        )


SCHEDULINGS = ("sweep", "queue", "batches")
CONSTRAINED = ("cube", "two_chain", "bridge", "net")
CONSTRAINED_FROM, CONSTRAINED_STEPS = 50, 100


def visits_of(name, scheduling, steps=CONSTRAINED_STEPS):
    """`(Visits, worst violation in metres)` of a scene, starting at CONSTRAINED_FROM."""
    visits, worst = Visits(), 0.0
    simulation = scene(name, constraintScheduling=scheduling, broadPhase="grid")
    with (
        watched(RBSFunctions, "sweep", visits.schedule),
        watched(rbs.stepping.constraints, "queue", visits.schedule),
        watched(rbs.stepping.constraints, "project_in_batches", visits.step),
        watched(rbs.stepping.constraints, "visit_batch", visits.visit),
    ):
        for step in range(steps):
            simulation.step()
            if step >= CONSTRAINED_FROM:
                worst = max(worst, simulation.largest_violation())
    visits.steps = visits.steps[CONSTRAINED_FROM:]
    return visits, worst


@experiment
def queue(axis):
    """Constraints of the net that the queue visits in one step, by sweep."""
    visits, _ = visits_of("net", "queue", CONSTRAINED_FROM + 1)
    (made,) = visits.steps
    constraints = np.array([c for c, _ in made])
    violated = np.array([isViolated for _, isViolated in made])
    sweeps = np.cumsum(np.diff(constraints, prepend=-1) <= 0)
    everyone = np.unique(constraints)  # all are dirty in the first sweep
    place = everyone.searchsorted(constraints)
    for some, colour, label in (
        (~violated, style.SKY, "visited: holds"),
        (violated, style.VERMILION, "corrected"),
    ):
        axis.scatter(
            place[some],
            sweeps[some] + 0.5,
            s=1.0,
            color=colour,
            label=label,
            marker="|",
            linewidths=0.4,
            rasterized=True,
        )
    axis.set(
        xlabel="constraint of the net",
        ylabel="sweep",
        xlim=(0, len(everyone)),
        ylim=(sweeps.max() + 1.2, 0),
    )
    axis.grid(False)
    axis.legend(
        loc="lower right",
        markerscale=6.0,
        facecolor="white",
        frameon=True,
        framealpha=0.9,
        edgecolor="none",
    )
    return {
        "constraints": thousands(len(everyone)),
        "step": str(CONSTRAINED_FROM + 1),
        "visits": thousands(len(made)),
        "corrected": text(100 * violated.mean(), 0),
    }


@silent
def schedules():
    """Actual visits and worst remaining violation of each schedule, in four scenes."""
    numbers = {"from": str(CONSTRAINED_FROM), "to": str(CONSTRAINED_STEPS)}
    for name in CONSTRAINED:
        own = {}
        for scheduling in SCHEDULINGS:
            visits, worst = visits_of(name, scheduling)
            own[f"{scheduling}Visits"] = thousands(visits.counts().mean())
            own[f"{scheduling}Worst"] = text(1e3 * worst, 1 if worst < 0.01 else 0)
            own[scheduling], own[f"{scheduling}Left"] = visits.counts().mean(), worst
        own["constraints"] = str(len(scene(name).constraints))
        own["worstRatio"] = text(own["batchesLeft"] / own["sweepLeft"], 1)
        own["saved"] = text(100 * (1 - own["queue"] / own["sweep"]), 0)
        numbers[name] = {key: v for key, v in own.items() if isinstance(v, str)}
    return numbers
