"""Measurements of how the program scales: pairs tested, chaos, batches, visits, times.

Functions are as in `laws.py`. Times are read from times.json, which `timings.py` measures.
"""

import json
from unittest.mock import patch

import numpy as np
import style
from laws import H, panel, scene, silent
from timings import BEFORE, COLLAPSING, SCHEDULED, TIMES, boxes_of, heap

import rbs.stepping.batches
import rbs.stepping.constraints
from rbs.geometry import broadphase

HEAP, LATER = 1000, 50  # bodies; steps after a heap has begun to collapse


def pairs_tested(meshes):
    """Pairs tested by the grid and along one sorted axis, and pairs whose boxes overlap."""
    box, count = boxes_of(meshes), len(meshes)
    with patch.object(broadphase, "overlapping", wraps=broadphase.overlapping) as spy:
        first, _ = broadphase.grid_overlaps(box, np.zeros(count, dtype=bool))
    tested = sum(len(call.args[1]) for call in spy.call_args_list)
    inRange = np.sort(box[0]).searchsorted(-box[3], side="right").sum()
    return tested, int(inRange) - count * (count + 1) // 2, len(first)


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
        (rows[:, 1], style.VERMILION, "^-", "one axis"),
        (rows[:, 0], style.GREEN, "D-", "grid"),
        (rows[:, 2], style.BLUE, "o--", "overlapping"),
    ):
        axis.loglog(n, values, mark, color=colour)
        names[label] = colour
    style.name_lines(axis, names, columns=2)
    axis.set(xlabel="bodies", ylabel="pairs tested", ylim=(60, 1e8), yticks=[1e2, 1e4, 1e6])
    tested, along, _ = rows[PAIR_SIZES.index(HEAP)]
    return {"ratio": along / tested}


@silent
def chaos():
    """Seconds until a heap and the same one listed backwards are a metre apart."""
    forward, backward = (heap(200, contactScheduling="batches") for _ in range(2))
    bodies = list(backward.meshes)
    backward.meshes.reverse()
    apart = 0.0
    while apart < 1.0:
        forward.step()
        backward.step()
        pairs = zip(forward.meshes, bodies, strict=True)
        apart = max(np.abs(a.position - b.position).max() for a, b in pairs)
    return {"seconds": forward.time}


FEW = 20  # bodies of a small heap


@silent
def batches():
    """How many times more pairs and batches a step of a collapsing heap has than one of FEW."""
    calls, means, in_batches = [], [], rbs.stepping.batches.in_batches

    def recorded(*arguments):
        order, starts = in_batches(*arguments)
        calls.append((len(order), len(starts) - 1))
        return order, starts

    for count in (FEW, HEAP):
        simulation = heap(count, COLLAPSING, contactScheduling="batches")
        calls.clear()
        with patch.object(rbs.stepping.batches, "in_batches", recorded):
            simulation.run(LATER)
        means.append(np.mean(calls, axis=0))
    pairs, batches = means[1] / means[0]
    return {"few": FEW, "pairs": pairs, "batches": batches}


FROM, TO = 60, 80


@silent
def visits():
    """Per cent of the visits of a sweep that the queue saves.

    Bounds that cannot be violated, such as a least distance of zero, are visited by neither.
    """

    def made(name, schedule):
        count, original = 0, getattr(rbs.stepping.constraints, schedule)

        def counted(visit, *arguments):
            def counting(c):
                nonlocal count
                count += 1
                return visit(c)

            return original(counting, *arguments)

        simulation = scene(name, constraintScheduling=schedule, broadPhase="grid").run(FROM)
        with patch.object(rbs.stepping.constraints, schedule, counted):
            simulation.run(TO - FROM)
        return count

    return {name: 100 * (1 - made(name, "queue") / made(name, "sweep")) for name in SCHEDULED}


def read_times():
    return json.loads(TIMES.read_text())


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
    axis.minorticks_off()
    axis.axhline(1e3 * H, color=style.GREY, linewidth=0.8, linestyle=":")
    style.name_lines(axis, {name: colour for name, (colour, _) in lines.items()}, columns=2)
    return rows


LINES = {  # name in times.json → colour, marker
    "loop": (style.VERMILION, "^-"),
    "grid": (style.GREEN, "D-"),
    "batches": (style.SKY, "o-"),
    "soft step": (style.BLUE, "s-"),
}


@panel
def growth(axis):
    """Milliseconds per step of a collapsing heap: now, and before with another checkout."""
    times = read_times()
    steps = draw_times(axis, times["steps"], LINES, list)
    for name, (colour, _) in LINES.items():
        former = {n: row[name + BEFORE][1] for n, row in steps.items() if name + BEFORE in row}
        axis.plot(list(former), list(former.values()), "--", color=colour, linewidth=0.9)
    axis.set(ylim=(0.25, 2.5e4), xlim=(3, 9000))
    least, looped = min(steps), max(n for n, row in steps.items() if "loop" in row)
    now = {name: values[1] for name, values in steps[looped].items()}
    numbers = {"looped": looped, "least": least, "before": times["before"]}
    numbers |= {"gain": now["loop"] / now["batches"], "gridShare": 100 * now["grid"] / now["loop"]}
    for name in ("loop", "batches"):
        numbers[f"{name}Least"] = steps[least][name][1]
        numbers[f"{name}Before"] = now[name + BEFORE] / now[name]
    for name in ("grid", "batches"):
        numbers[f"{name}Growth"] = now[name] / steps[FEW][name][1]
    return numbers


SCENES = {"net": "net", "two_chain": "chains", "bridge": "bridge", "cube": "cube"}


@panel
def schedules(axis):
    """Time of a step of scenes with constraints, relative to the sweep's, medians and quartiles."""
    times = read_times()["schedules"]
    numbers = {name: {"ms": times[name]["sweep"]["ms"][1]} for name in SCENES}
    colours = {"queue": style.BLUE, "batches": style.SKY}
    for k, (kind, colour) in enumerate(colours.items()):
        rows = [times[name][kind]["relative"] for name in SCENES]
        low, median, high = np.array(rows).T
        places, spread = np.arange(len(SCENES)) + 0.38 * k - 0.19, [median - low, high - median]
        whiskers = {"yerr": spread, "error_kw": {"elinewidth": 0.8, "capsize": 1.5}}
        axis.bar(places, median, width=0.36, color=colour, **whiskers)
        for name, own in zip(SCENES, median, strict=True):
            numbers[name][kind] = own
    style.name_lines(axis, colours)
    axis.axhline(1.0, color=style.BLACK, linewidth=0.8, linestyle="--")
    labels = [f"{label}\n{numbers[name]['ms']:#.2g}".strip(".") for name, label in SCENES.items()]
    axis.set_xticks(range(len(SCENES)), labels, fontsize=7)
    axis.set(ylabel="relative time", ylim=(0, 2.2))
    axis.grid(False)
    return numbers | {"netGain": 1 / numbers["net"]["batches"]}


ENGINES = {  # name in times.json → colour, marker
    "soft step": (style.BLUE, "s-"),
    "PyBullet": (style.GREEN, "D--"),
    "MuJoCo, CG": (style.VERMILION, "^--"),
}


@panel
def engines(axis):
    """Milliseconds per step of three engines from one heap, medians with quartiles."""
    times = read_times()
    rows = draw_times(axis, times["engines"], ENGINES, lambda record: record["ms"])
    numbers = {"machine": times["machine"].split(", Python")[0].replace("(R)", "")}
    for key, n in zip(("least", "middle"), rows, strict=False):
        numbers[key] = n
        for name in ENGINES:
            own = numbers.setdefault(name.replace(", ", "").replace(" step", ""), {})
            own[key] = rows[n][name]["ms"][1]
            own[f"{key}Overlap"] = 100 * rows[n][name]["overlap"]
            own[f"{key}Speed"] = 100 * rows[n][name]["speed"]
    axis.set(ylim=(1, 3e3), xlim=(150, 9000))
    axis.set_xticks(list(rows), list(map(str, rows)))
    return numbers
