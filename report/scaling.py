"""Measurements of how the program scales: pairs tested, identical bits, batches, schedules, times.

Functions are as in `laws.py`. Times are read from times.json, which `timings.py` measures.
"""

import json

import numpy as np
import style
from laws import BOX, SOFT, H, heap_scene, panel, scene, silent
from timings import RESTING, SCHEDULED, TIMES, replaced

import rbs.geometry.broadphase
import rbs.stepping.batches
import rbs.stepping.constraints
import RBSFunctions
from rbs.geometry.broadphase import grid_overlaps
from rbs.scenes.scenefiles import find_scene
from rbs.scenes.simulation import SceneSimulation, Settings

HEAP, HEAP_STEP = 1000, 150  # by then, a heap has begun to collapse
LATER = 50  # steps after that one


def heap(count, steps=0, **settings):
    simulation = SceneSimulation(heap_scene(count), Settings(**RESTING, **settings))
    for _ in range(steps):
        simulation.step()
    return simulation


def pairs_tested(meshes):
    """Pairs tested by the grid and along one sorted axis, and pairs whose boxes overlap."""
    low = np.array([mesh.currVertices.min(axis=0) for mesh in meshes])
    high = np.array([mesh.currVertices.max(axis=0) for mesh in meshes])
    box, count, tested = np.concatenate([low, -high], axis=1).T, len(meshes), []

    def wrapper(original):
        def call(box, i, *rest):
            tested.append(len(i))
            return original(box, i, *rest)

        return call

    with replaced(rbs.geometry.broadphase, "overlapping", wrapper):
        first, _ = grid_overlaps(box, np.zeros(count, dtype=bool))
    inRange = np.sort(box[0]).searchsorted(-box[3], side="right").sum()
    return sum(tested), int(inRange) - count * (count + 1) // 2, len(first)


PAIR_SIZES = (100, 200, 500, 1000, 2000)


@panel
def pairs(axis):
    """Pairs of boxes tested against the number of bodies, with the overlaps as a floor."""
    heaps = [heap(count, HEAP_STEP, contactScheduling="batches") for count in PAIR_SIZES]
    rows = np.array([pairs_tested(one.meshes) for one in heaps])
    n = np.array(PAIR_SIZES)
    for values, colour, mark, label in (
        (n * (n - 1) / 2, style.BLACK, ":", "all pairs"),
        (rows[:, 1], style.VERMILION, "^-", "one sorted axis"),
        (rows[:, 0], style.BLUE, "s-", "grid"),
        (rows[:, 2], style.GREEN, "o--", "overlapping: the floor"),
    ):
        axis.loglog(n, values, mark, color=colour, label=label)
    axis.set(xlabel="bodies", ylabel="pairs of boxes tested", ylim=(30, 5e8))
    axis.legend(loc="upper left")
    tested, along, overlapping = rows[PAIR_SIZES.index(HEAP)]
    start = pairs_tested(heap(HEAP).meshes)
    return {
        "bodies": HEAP,
        "step": HEAP_STEP,
        "startGrid": start[0],
        "startAxis": start[1],
        "startRatio": start[1] / start[0],
        "ratio": along / tested,
        "floorRatio": tested / overlapping,
    }


SAME_BODIES, SAME_STEPS = 200, 100


@silent
def bits():
    """Largest difference between grid and loop; when the same heap in another order is 1 m away."""
    loop, grid = heap(SAME_BODIES), heap(SAME_BODIES, contactScheduling="batches")
    difference = 0.0
    for _ in range(SAME_STEPS):
        loop.step()
        grid.step()
        states = loop.state(), grid.state()
        difference = max(difference, *(abs(states[0][k] - states[1][k]).max() for k in states[0]))
    forward, backward = (heap(SAME_BODIES, contactScheduling="batches") for _ in range(2))
    bodies = list(backward.meshes)
    backward.meshes.reverse()
    while True:
        forward.step()
        backward.step()
        pairs = zip(forward.meshes, bodies, strict=True)
        if max(np.abs(a.position - b.position).max() for a, b in pairs) > 1.0:
            break
    steps = {"bodies": SAME_BODIES, "steps": SAME_STEPS, "apart": forward.time}
    return {"difference": float(difference), **steps}


@silent
def batches():
    """Pairs and batches of a step of a collapsing heap; percentage of pairs processed again."""
    calls = []

    def wrapper(original):
        def in_batches(first, second, isFixed, isDue):
            order, starts = original(first, second, isFixed, isDue)
            calls.append((len(order), len(starts) - 1, isDue.all()))
            return order, starts

        return in_batches

    with replaced(rbs.stepping.batches, "in_batches", wrapper):
        simulation = heap(HEAP, HEAP_STEP, contactScheduling="batches")
        pairs, count, _ = next(call for call in reversed(calls) if call[2])
        calls.clear()
        for _ in range(LATER):
            simulation.step()
    again = sum(number for number, _, isWhole in calls if not isWhole)
    first = sum(number for number, *_ in calls) - again
    numbers = {"pairs": pairs, "batches": count, "mean": pairs / count}
    return numbers | {"again": 100.0 * again / first, "later": LATER}


FROM, TO = 60, 80


@silent
def schedules():
    """Per cent of visits that the queue saves, and the largest difference from the sweep."""
    numbers = {}
    for name in SCHEDULED:
        visits, places = {}, {}
        for schedule in ("sweep", "queue"):
            simulation = scene(name, constraintScheduling=schedule, contactScheduling="batches")
            with (
                counted(RBSFunctions, "sweep", visits, schedule),
                counted(rbs.stepping.constraints, "queue", visits, schedule),
            ):
                for step in range(TO):
                    visits[schedule] = 0 if step <= FROM else visits[schedule]
                    simulation.step()
            places[schedule] = simulation.state()["positions"]
        difference = float(abs(places["queue"] - places["sweep"]).max())
        saved = 100 * (1 - visits["queue"] / visits["sweep"])
        numbers[name] = {"saved": saved, "difference": difference}
    return numbers


def counted(module, name, counts, key):
    """Context in which visits are counted in counts[key]."""

    def wrapper(original):
        def schedule(visit, *arguments):
            def counting(c):
                counts[key] += 1
                return visit(c)

            return original(counting, *arguments)

        return schedule

    return replaced(module, name, wrapper)


@silent
def standing():
    """By how many centimetres the tops of a stack and of a pyramid sink in ten seconds."""
    numbers = {"seconds": 10}
    for name, height in (("stack", 20 * BOX[1]), ("pyramid", 15 * BOX[1])):
        for key, settings in (("Basic", {"contactScheduling": "batches"}), ("Soft", SOFT)):
            simulation = SceneSimulation(find_scene(name), Settings(**RESTING, **settings))
            top = max(simulation.meshes, key=lambda mesh: mesh.position[0, 1])
            for _ in range(round(10 / H)):
                simulation.step()
            numbers[f"{name}Count"] = len(simulation.meshes)
            numbers[name + key] = 100 * (height - BOX[1] / 2 - top.position[0, 1])
    return numbers


ENGINES = {  # name in times.json → label, colour, marker
    "soft step": ("soft step", style.BLUE, "s-"),
    "PyBullet": ("PyBullet", style.GREEN, "D--"),
    "MuJoCo, CG": ("MuJoCo CG", style.VERMILION, "^--"),
    "MuJoCo": ("MuJoCo Newton", style.PURPLE, "v--"),
}
PARTS = {  # phases of the grid step, timed separately → label, colour
    "grid_overlaps": ("which pairs", style.GREEN),
    "find_facets": ("how deep: facets", style.BLUE),
    "find_contacts": ("batches", style.SKY),
    "apply_impulses": ("impulses", style.ORANGE),
}


def read_times():
    return json.loads(TIMES.read_text())


@panel
def parts(axis):
    """Shares of a grid step, in per cent, against the number of bodies."""
    rows = {n: row["shares"] for n, row in read_times()["steps"].items() if int(n) >= 50}
    bottom = np.zeros(len(rows))
    for name, (label, colour) in PARTS.items():
        share = np.array([row[name] for row in rows.values()])
        axis.bar(list(rows), share, bottom=bottom, color=colour, label=label, width=0.7)
        bottom += share
    axis.bar(list(rows), 100 - bottom, bottom=bottom, color="0.8", label="all else", width=0.7)
    axis.set(xlabel="bodies", ylabel="share of a step / %", ylim=(0, 165), yticks=[0, 50, 100])
    axis.grid(False)
    axis.legend(loc="upper left", ncols=2, columnspacing=0.8)
    most = list(rows)[-1]
    return {"bodies": int(most)} | {name: rows[most][name] for name in PARTS}


@panel
def engines(axis):
    """Milliseconds per step of four engines from one heap at rest, medians with quartiles."""
    times, numbers = read_times(), {}
    sizes = dict(zip(("least", "middle", "most"), map(int, times["engines"]), strict=True))
    for name, (label, colour, mark) in ENGINES.items():
        rows = {int(n): row[name] for n, row in times["engines"].items() if name in row}
        low, median, high = np.array([row[:3] for row in rows.values()]).T
        spread = [median - low, high - median]
        axis.errorbar(list(rows), median, spread, fmt=mark, color=colour, label=label, capsize=2)
        own = {key: rows[n][1] for key, n in sizes.items() if n in rows}
        own |= {f"{key}Contacts": rows[n][3] / n for key, n in sizes.items() if n in rows}
        numbers[name.replace(", ", "").replace("soft step", "soft")] = own
    axis.set(xlabel="bodies", ylabel="ms per step", xscale="log", yscale="log", ylim=(1, 3e3))
    axis.axhline(1e3 * H, color=style.GREY, linewidth=0.8, linestyle=":")
    axis.legend(loc="upper left", ncols=2, columnspacing=0.8)
    axis.set_xticks(list(sizes.values()), list(map(str, sizes.values())))
    axis.minorticks_off()
    return numbers | sizes | {"machine": times["machine"].split(", Python")[0]}


@silent
def choice():
    """Milliseconds per step of a collapsing heap, and where the faster step changes."""
    steps = {int(n): row for n, row in read_times()["steps"].items()}
    looped = [n for n, row in steps.items() if "all pairs" in row]
    faster = [n for n in looped if steps[n]["all pairs"][1] <= steps[n]["batches"][1]]
    most, last, net = max(steps), max(looped), read_times()["schedules"]["net"]
    gain = steps[last]["all pairs"][1] / steps[last]["batches"][1]
    grid, soft = steps[most]["batches"][1], steps[most]["soft step"][1]
    numbers = {"loop": max(faster, default=0), "looped": last, "gain": gain}
    return numbers | {
        "most": most,
        "grid": grid,
        "soft": soft,
        "batchesNet": net["sweep"][1] / net["batches"][1],
    }
