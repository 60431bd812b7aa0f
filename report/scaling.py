"""Measurements of how the program scales: pairs tested, visits, times.

Functions are as in `laws.py`. Times are read from times.json, which `timings.py` measures.
"""

import json
from unittest.mock import patch

import numpy as np
import style
from laws import H, panel, scene, silent
from timings import (
    BEFORE,
    COLLAPSING,
    ENGINES as PEERS,
    FEW,
    LIMITED,
    SCHEDULED,
    TIMES,
    boxes_of,
    heap,
)

import rbs.stepping.constraints
from rbs.geometry import broadphase

HEAP = 1000  # bodies


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
        (rows[:, 0], style.ORANGE, "D-", "grid"),
        (rows[:, 2], style.BLUE, "o--", "overlapping"),
    ):
        axis.loglog(n, values, mark, color=colour)
        names[label] = colour
    style.name_lines(axis, names, columns=2)
    axis.set(xlabel="bodies", ylabel="pairs tested", ylim=(60, 1e8), yticks=[1e2, 1e4, 1e6])
    tested, along, _ = rows[PAIR_SIZES.index(HEAP)]
    return {"ratio": along / tested, "heap": HEAP}


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


def by_size(rows):
    """Returns rows of times.json with their numbers of bodies as keys."""
    return {int(n): row for n, row in rows.items()}


def quartiles_of(rows, name, of=list):
    """Returns numbers of bodies (n,), and medians (n,) with lengths of whiskers (2, n).

    of : function from the record of `name` to its quartiles
    """
    own = {n: of(row[name]) for n, row in rows.items() if name in row}
    low, median, high = np.array(list(own.values())).T
    return np.array(list(own)), median, np.array([median - low, high - median])


LINES = {  # name in times.json → colour, marker, size and shift in points of the label
    "loop": (style.VERMILION, "^-", 1000, (5, 3)),
    "grid": (style.ORANGE, "D-", 1000, (5, -7)),
    "batches": (style.BLUE, "o-", 20, (-17, -19)),
    "soft step": (style.GREEN, "s-", 200, (-31, -19)),
}
FORMER = ("loop", "soft step")  # those whose former times are drawn


def in_real_time(rows, name):
    """Returns the number of bodies whose step takes as long as it simulates, to two digits."""
    n, median, _ = quartiles_of(rows, name)
    return float(f"{np.exp(np.interp(np.log(1e3 * H), np.log(median), np.log(n))):.2g}")


@panel
def growth(axis):
    """Milliseconds per step and body of a collapsing heap: now, and with another checkout."""
    times = read_times()
    steps = by_size(times["steps"])
    for name, (colour, mark, size, away) in LINES.items():
        n, median, spread = quartiles_of(steps, name)
        look = {"color": colour, "markerfacecolor": "white", "capsize": 1.5, "linewidth": 0.9}
        axis.errorbar(n, median / n, spread / n, fmt=mark, **look)
        place = size, steps[size][name][1] / size
        points = {"xytext": away, "textcoords": "offset points"}
        axis.annotate(name, place, color=colour, fontsize=7, **points)
        if name in FORMER:
            n, median, _ = quartiles_of(steps, name + BEFORE)
            axis.plot(n, median / n, "--", color=colour, linewidth=0.9)
    sizes = np.array(list(steps))
    axis.plot(sizes, 1e3 * H / sizes, ":", color=style.GREY, linewidth=0.8)
    axis.annotate("real time", (9, 3.1), color="0.4", fontsize=7)
    axis.set(xlabel="bodies", ylabel="ms per step and body", xscale="log", yscale="log")
    axis.set(ylim=(0.012, 4.5), xlim=(4, 7000))
    axis.set_yticks([0.1, 1], ["0.1", "1"])
    least, looped = min(steps), max(n for n, row in steps.items() if "loop" in row)
    now = {name: values[1] for name, values in steps[looped].items()}
    numbers = {"looped": looped, "least": least}
    numbers["gain"] = now["loop"] / now["batches"]
    numbers |= {f"{name}Least": steps[least][name][1] for name in ("loop", "batches")}
    for name in FORMER:
        key = name.removesuffix(" step")
        numbers[f"{key}Before"] = now[name + BEFORE] / now[name]
        numbers[f"{key}RealTime"] = in_real_time(steps, name)
    return numbers


SCENES = {"net": "net", "two_chain": "chains", "bridge": "bridge", "cube": "cube"}


@panel
def schedules(axis):
    """Time of a step of scenes with constraints, relative to the sweep's, medians and quartiles."""
    times = read_times()["schedules"]
    numbers = {name: {"ms": times[name]["sweep"]["ms"][1]} for name in SCENES}
    colours = {"queue": style.GREY, "batches": style.BLUE}
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
    "soft step": (style.GREEN, "s-"),
    "PyBullet": (style.BLUE, "D--"),
    "MuJoCo, CG": (style.VERMILION, "^--"),
}


@panel
def engines(axis):
    """Milliseconds per step of three engines from one heap, medians with quartiles."""
    times = read_times()
    rows = by_size(times["engines"])
    for name, (colour, mark) in ENGINES.items():
        axis.errorbar(
            *quartiles_of(rows, name, lambda record: record["ms"]),
            fmt=mark,
            color=colour,
            capsize=1.5,
        )
    axis.axhline(1e3 * H, color=style.GREY, linewidth=0.8, linestyle=":")
    axis.annotate("real time", (1900, 11), color="0.4", fontsize=7)
    style.name_lines(axis, {name: colour for name, (colour, _) in ENGINES.items()})
    axis.set(xlabel="bodies", ylabel="ms per step", xscale="log", yscale="log")
    axis.minorticks_off()
    axis.set(ylim=(1, 3e3), xlim=(150, 9000))
    axis.set_xticks(list(rows), list(map(str, rows)))
    numbers = {"machine": times["machine"].split(", Python")[0].replace("(R)", "")}
    numbers["few"] = FEW
    for key, n in zip(("least", "middle"), rows, strict=False):
        numbers[key] = n
        for name in rows[n]:
            words = name.replace(LIMITED, " Limited").replace(" step", "")
            own = numbers.setdefault(words.replace(",", "").replace(" ", ""), {})
            own |= {"iterations": PEERS[name]} if name in PEERS else {}
            own[key] = rows[n][name]["ms"][1]
            own[f"{key}Overlap"] = 100 * rows[n][name]["overlap"]
            own[f"{key}Speed"] = 100 * rows[n][name]["speed"]
    return numbers
