"""How the program scales, drawn from the running program: grid, ordered batches, constraint queue.

Each function draws its panel and returns the numbers that the text quotes, as in `experiments.py`.
What the program does inside a step is observed by `watched`, which counts the calls that a step
makes and changes nothing.
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

HEAP_STEP = 150  # by which a heap has begun to collapse
MATERIAL = {"friction": 0.5, "restitution": 0.0}


def thousands(number):
    """A whole number with thin spaces between its thousands."""
    return f"{number:,.0f}".replace(",", "\u202f")


def heap(count, steps=HEAP_STEP, **settings):
    """A dense heap of so many bodies, after some steps."""
    settings = {"broadPhase": "grid", **MATERIAL, **settings}
    simulation = Simulation(heap_scene(count), Settings(**settings))
    for _ in range(steps):
        simulation.step()
    return simulation


def boxes(meshes):
    """The bodies' bounding boxes as `rbs.geometry.broadphase` has them, (6, n)."""
    low = np.array([mesh.currVertices.min(axis=0) for mesh in meshes])
    high = np.array([mesh.currVertices.max(axis=0) for mesh in meshes])
    return np.concatenate([low, -high], axis=1).T


@contextmanager
def watched(module, name, wrapper):
    """Within it, the module has `wrapper` of its own function or class of this name."""
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
    """The columns of the grid seen along x: which bodies one body is compared with."""
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
    # the body that is asked for: of those near the middle of the heap, the one with most partners
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
    """Pairs that are looked at, against the number of bodies: all, along one axis, the grid's."""
    rows = []
    for count in CANDIDATE_SIZES:
        meshes = heap(count).meshes
        box = boxes(meshes)
        first, _ = grid_overlaps(box, np.zeros(count, dtype=bool))
        order = np.sort(box[0])
        alongX = np.sum(order.searchsorted(-box[3], side="right")) - count * (count + 1) / 2
        # spheres about the centres, all of the largest radius: what a k-d tree of points can find
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
    """What the grid steps of a simulation do: the wrapped `Pass` writes here.

    steps : list of lists, a dict a pass: batches, how many; isComplete; and of each pair keys, for
    their order, batch, touches, isNew (P,), whether the first pass was without it
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


SQUEEZED = 0.8  # of the distances between the bodies of a heap, which then overlap


@experiment
def batches(axis):
    """The pairs of one step in their batches, and those that a roll-back has added.

    In a collapsing heap no step is rolled back, so the step that is drawn is the first one of a
    heap whose bodies start inside each other: nothing is known of how far they are going to move.
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
    """The visits that schedules make: the wrapped functions write here.

    steps : list of lists, `(constraint, was violated)` for each visit; of batches, how many
    """

    def __init__(self):
        self.steps = []

    def schedule(self, original):
        """Of `sweep` and `queue`, which are handed a visit."""

        def watching(visit, *arguments):
            self.steps.append([])
            return original(self.visit(visit), *arguments)

        return watching

    def step(self, original):
        """Of `project_in_batches`."""

        def watching(*arguments):
            self.steps.append([])
            return original(*arguments)

        return watching

    def visit(self, original):
        """Of one visit, or of `visit_batch`."""

        def watching(*arguments):
            isViolated = original(*arguments)
            c = arguments[4] if len(arguments) > 1 else arguments[0]
            self.steps[-1].append((c, isViolated))
            return isViolated

        return watching

    def counts(self):
        """Visits to constraints that can be violated at all, of each step."""
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
    """`(Visits, worst violation in metres)` of a scene, from CONSTRAINED_FROM on."""
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
    """Which constraints of the net the queue visits in one step, in each sweep's place."""
    visits, _ = visits_of("net", "queue", CONSTRAINED_FROM + 1)
    (made,) = visits.steps
    constraints = np.array([c for c, _ in made])
    violated = np.array([isViolated for _, isViolated in made])
    sweeps = np.cumsum(np.diff(constraints, prepend=-1) <= 0)
    everyone = np.unique(constraints)  # in its first sweep all are dirty
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
    """Real visits and the worst violation that each schedule leaves, in four scenes."""
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
