"""Measurements of how the program scales: pairs tested, identical bits, batches, schedules, times.

Functions are as in `laws.py`. Times are read from times.json, which `timings.py` measures.
"""

import json

import numpy as np
import style
from laws import BOX, SOFT, H, panel, scene, silent
from timings import COLLAPSING, RESTING, SCHEDULED, SCHEDULES, TIMES, boxes_of, heap, replaced

import rbs.geometry.broadphase
import rbs.stepping.batches
import rbs.stepping.constraints
from rbs.geometry.broadphase import grid_overlaps
from rbs.scenes.scenefiles import find_scene
from rbs.scenes.simulation import SceneSimulation, Settings

HEAP, LATER = 1000, 50  # bodies; steps after a heap has begun to collapse


def pairs_tested(meshes):
    """Pairs tested by the grid and along one sorted axis, and pairs whose boxes overlap."""
    box, count, tested = boxes_of(meshes), len(meshes), []

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
    heaps = [heap(count, COLLAPSING, contactScheduling="batches") for count in PAIR_SIZES]
    rows = np.array([pairs_tested(one.meshes) for one in heaps])
    n = np.array(PAIR_SIZES)
    names = {}
    for values, colour, mark, label in (
        (n * (n - 1) / 2, style.BLACK, ":", "all pairs"),
        (rows[:, 1], style.VERMILION, "^-", "one sorted axis"),
        (rows[:, 0], style.BLUE, "s-", "grid"),
        (rows[:, 2], style.GREEN, "o--", "overlapping"),
    ):
        axis.loglog(n, values, mark, color=colour)
        names[label] = colour
    style.name_lines(axis, names)
    axis.set(
        xlabel="bodies", ylabel="pairs of boxes tested", ylim=(60, 3e9), yticks=[1e2, 1e4, 1e6]
    )
    tested, along, overlapping = rows[PAIR_SIZES.index(HEAP)]
    start = pairs_tested(heap(HEAP).meshes)
    return {
        "bodies": HEAP,
        "step": COLLAPSING,
        "startGrid": start[0],
        "startAxis": start[1],
        "startRatio": start[1] / start[0],
        "ratio": along / tested,
        "floorRatio": tested / overlapping,
    }


SAME_BODIES, SAME_STEPS = 200, 100


@silent
def bits():
    """Largest difference from the loop; when the same heap in another order is 1 m away."""
    loop, *others = (
        heap(SAME_BODIES, **one)
        for one in ({}, {"broadPhase": "grid"}, {"contactScheduling": "batches"})
    )
    difference = 0.0
    for _ in range(SAME_STEPS):
        loop.step()
        state = loop.state()
        for other in others:
            other.step()
            rows = other.state()
            difference = max(difference, *(abs(state[key] - rows[key]).max() for key in state))
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
    """Pairs and batches of a step of a collapsing heap; passes that a later step makes again."""
    passes = []

    def wrapper(original):
        def in_batches(first, second, isFixed):
            order, starts = original(first, second, isFixed)
            passes.append((len(order), len(starts) - 1))
            return order, starts

        return in_batches

    with replaced(rbs.stepping.batches, "in_batches", wrapper):
        simulation = heap(HEAP, COLLAPSING, contactScheduling="batches")
        pairs, count = passes[-1]
        passes.clear()
        for _ in range(LATER):
            simulation.step()
    again = len(passes) / LATER - 1
    return {"pairs": pairs, "batches": count, "mean": pairs / count, "again": again}


FROM, TO = 60, 80


@silent
def visits():
    """Per cent of visits that the queue saves, and the largest difference from the sweep.

    Bounds that cannot be violated, such as a least distance of zero, are visited by neither.
    """
    numbers = {}
    for name in SCHEDULED:
        counts, places = {}, {}
        for schedule in ("sweep", "queue"):

            def wrapper(original, schedule=schedule, counts=counts):
                def call(visit, *arguments):
                    def counting(c):
                        counts[schedule] += 1
                        return visit(c)

                    return original(counting, *arguments)

                return call

            simulation = scene(name, constraintScheduling=schedule, broadPhase="grid")
            with replaced(rbs.stepping.constraints, schedule, wrapper):
                for step in range(TO):
                    counts[schedule] = counts[schedule] if step > FROM else 0
                    simulation.step()
            places[schedule] = simulation.state()["positions"]
        difference = float(abs(places["queue"] - places["sweep"]).max())
        saved = 100 * (1 - counts["queue"] / counts["sweep"])
        numbers[name] = {"saved": saved, "difference": difference}
    return numbers


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


def read_times():
    return json.loads(TIMES.read_text())


# Names of lines that are not those of times.json.
FULL_NAMES = {"MuJoCo": "MuJoCo, Newton"}


def draw_times(axis, rows, lines, quartiles):
    """Draws milliseconds against bodies on logarithmic axes, with the names of the lines.

    rows : bodies as text → name → record; lines : name → colour, marker; quartiles : of a record
    Returns the rows, with numbers of bodies as keys.
    """
    rows = {int(n): row for n, row in rows.items()}
    for name, (colour, mark) in lines.items():
        own = {n: quartiles(row[name]) for n, row in rows.items() if name in row}
        low, median, high = np.array(list(own.values())).T
        spread = [median - low, high - median]
        axis.errorbar(list(own), median, spread, fmt=mark, color=colour, capsize=1.5)
    axis.set(xlabel="bodies", ylabel="ms per step", xscale="log", yscale="log")
    axis.set_yticks([1, 10, 100, 1000])
    axis.axhline(1e3 * H, color=style.GREY, linewidth=0.8, linestyle=":")
    style.name_lines(axis, {FULL_NAMES.get(name, name): lines[name][0] for name in lines})
    return rows


WAYS = {  # name in times.json → colour, marker
    "loop": (style.VERMILION, "^-"),
    "grid": (style.ORANGE, "D-"),
    "batches": (style.SKY, "o-"),
    "soft step": (style.BLUE, "s-"),
}


@panel
def growth(axis):
    """Milliseconds per step of a collapsing heap: loop, grid, batches, soft step."""
    steps = draw_times(axis, read_times()["steps"], WAYS, list)
    axis.set(ylim=(0.3, 3e4), xlim=(3, 9000))
    most, looped = max(steps), max(n for n, row in steps.items() if "loop" in row)
    numbers = {"most": most, "looped": looped, "least": min(steps)}
    for name, key in zip(WAYS, ("loop", "grid", "batches", "soft"), strict=True):
        numbers[key] = steps[looped][name][1]
        numbers[f"{key}Most"] = steps[most].get(name, [0, 0, 0])[1]
        numbers[f"{key}Least"] = steps[min(steps)][name][1]
    numbers["gain"] = numbers["loop"] / numbers["batches"]
    numbers["halfLoop"] = numbers["loop"] / 2
    return numbers


SCENES = {"net": "net", "two_chain": "chains", "bridge": "bridge", "cube": "cube"}


@panel
def schedules(axis):
    """Milliseconds per step of a scene with constraints, by schedule, relative to the sweep."""
    times, numbers = read_times()["schedules"], {}
    colours = (style.ORANGE, style.BLUE, style.SKY)
    for k, (kind, colour) in enumerate(zip(SCHEDULES, colours, strict=True)):
        medians = [times[name][kind][1] / times[name]["sweep"][1] for name in SCENES]
        axis.bar(np.arange(len(SCENES)) + 0.27 * (k - 1), medians, width=0.25, color=colour)
        for name in SCENES:
            numbers.setdefault(name, {})[kind] = times[name][kind][1]
    for row in numbers.values():
        row["gained"] = 100 * (1 - row["queue"] / row["sweep"])
        row["batchesGain"] = row["sweep"] / row["batches"]
    style.name_lines(axis, dict(zip(SCHEDULES, colours, strict=True)))
    axis.set_xticks(range(len(SCENES)), list(SCENES.values()), fontsize=7)
    axis.set(ylabel="relative time", ylim=(0, 1.75))
    axis.grid(False)
    return numbers


ENGINES = {  # name in times.json → colour, marker
    "soft step": (style.BLUE, "s-"),
    "PyBullet": (style.GREEN, "D--"),
    "MuJoCo, CG": (style.VERMILION, "^--"),
    "MuJoCo": (style.PURPLE, "v--"),
}


@panel
def engines(axis):
    """Milliseconds per step of four engines from one heap at rest, medians with quartiles."""
    times = read_times()
    rows = draw_times(axis, times["engines"], ENGINES, lambda record: record["ms"])
    sizes = dict(zip(("least", "middle", "most"), rows, strict=True))
    numbers = sizes | {"machine": times["machine"].split(", Python")[0]}
    for name in ENGINES:
        own = numbers.setdefault(name.replace(", ", "").replace("soft step", "soft"), {})
        for key, n in sizes.items():
            if name in rows[n]:
                own[key] = rows[n][name]["ms"][1]
                own[f"{key}Overlap"] = 100 * rows[n][name]["overlap"]
                own[f"{key}Speed"] = 100 * rows[n][name]["speed"]
    axis.set(ylim=(1, 1e6), xlim=(150, 9000))
    axis.set_xticks(list(sizes.values()), list(map(str, sizes.values())))
    axis.minorticks_off()
    return numbers
