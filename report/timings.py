"""Timings: the part of the report that differs from run to run.

The tables are text files in this folder, with machine and date in their first lines, so that the
report can be built from them without measuring again. The runs of one row take turns, step by step,
so that other load on the machine affects all of them.
"""

import csv
import datetime
import importlib.util
import math
import os
import subprocess
import sys
import time
from pathlib import Path

import mechanisms
import numpy as np
import resting
import style
from experiments import ROOT, H, heap_scene, scene, slope, text

sys.path.insert(0, str(ROOT / "tests" / "benchmarks"))
import benchmark
import benchmarkPiles

from rbs.scenes.simulation import Simulation

FOLDER = Path(__file__).resolve().parent
SCALE, SCHEDULING, RESTING = (FOLDER / f"{name}.csv" for name in ("scale", "scheduling", "resting"))
SIZES = [100, 200, 500, 1000, 2000]
QUICK_SIZES = [50, 100, 150, 200]
FRICTION, FRICTIONLESS = "friction 0.5", "no friction"
WINDOW, QUICK_WINDOW = range(200, 260), range(60, 80)  # steps
# Numbers of bodies beyond which the loop over all pairs, and heaps without friction, are too slow.
MOST_LOOPED, MOST_FRICTIONLESS = 500, 1000
# Number of bodies in the heaps that the table compares, with and without friction, or the largest
# one measured below it.
COMPARED = 1000

RUNS = {  # name in the table → label, colour, marker, dash
    "all pairs": ("loop over all pairs", style.BLACK, "o", "-"),
    "grid": ("grid, same bits", style.BLUE, "s", "-"),
    "soft step": ("soft step", style.ORANGE, "P", "-"),
    "PyBullet": ("PyBullet", style.GREEN, "D", "--"),
    "MuJoCo": ("MuJoCo", style.PURPLE, "v", "--"),
    "MuJoCo, CG": ("MuJoCo, CG", style.VERMILION, "^", "--"),
}
KEYS = {
    "all pairs": "loop",
    "grid": "grid",
    "soft step": "soft",
    "PyBullet": "pybullet",
    "MuJoCo": "mujoco",
    "MuJoCo, CG": "mujocoCG",
}


def write(path, rows):
    """Writes a table, below comment lines with machine and date."""
    revision = subprocess.run(
        ["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True
    ).stdout.strip()
    columns = list(dict.fromkeys(column for row in rows for column in row))
    with path.open("w", newline="") as file:
        file.write(f"# {benchmark.describe_machine()}\n")
        today = datetime.date.today().isoformat()
        load = os.getloadavg()[0] if hasattr(os, "getloadavg") else math.nan
        file.write(f"# {today}, revision {revision}, load average {load:.1f}\n")
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def read(path):
    """Returns `(machine, [date, revision, load average], rows)` of a table."""
    lines = path.read_text().splitlines()
    machine, when = (line.removeprefix("# ") for line in lines[:2])
    return machine, when.split(", "), list(csv.DictReader(lines[2:]))


def heap_runs(count, material):
    """Returns name → run, for all settings compared on a dense heap."""
    path = heap_scene(count)
    own = {
        "all pairs": {},
        "grid": {"broadPhase": "grid"},
        "soft step": {"contactSolver": "soft-step"},
    }
    if count > MOST_LOOPED:
        del own["all pairs"]
    runs = {
        name: benchmarkPiles.OwnRun(path, material, **settings) for name, settings in own.items()
    }
    for name, (package, peer) in benchmarkPiles.PEERS.items():
        if importlib.util.find_spec(package):
            runs[name] = peer(Simulation(path), material)
    return runs


def measure_scale(sizes, window=WINDOW):
    """Writes scale.csv: median milliseconds per step for dense heaps."""
    rows = []
    for material in (FRICTION, FRICTIONLESS):
        for count in sizes:
            if material == FRICTIONLESS and count > MOST_FRICTIONLESS:
                continue
            runs = heap_runs(count, benchmarkPiles.MATERIALS[material])
            for (_, name), kept in benchmarkPiles.measure(runs, [window]).items():
                row = benchmarkPiles.row_of("heap", count, material, name, window, kept)
                rows.append({key: row[key] for key in benchmarkPiles.COLUMNS if key in row})
                print(material, count, name, row["milliseconds"], flush=True)
    write(SCALE, rows)


def measure_scheduling():
    """Writes scheduling.csv: milliseconds per whole step for the three schedules."""
    rows = []
    for name in mechanisms.CONSTRAINED:
        simulations = [
            scene(name, constraintScheduling=schedule, broadPhase="grid")
            for schedule in mechanisms.SCHEDULINGS
        ]
        series = benchmark.measure(
            simulations, mechanisms.CONSTRAINED_STEPS, mechanisms.CONSTRAINED_FROM
        )
        for schedule, kept in zip(mechanisms.SCHEDULINGS, series, strict=True):
            times = 1e3 * np.median([seconds for seconds, _ in kept])
            rows.append({"scene": name, "scheduling": schedule, "milliseconds": f"{times:.3f}"})
            print(*rows[-1].values(), flush=True)
    write(SCHEDULING, rows)


AWAKE, LATE = slice(200, 300), slice(900, 1000)


def measure_resting():
    """Writes resting.csv: milliseconds per step during and after the collapse of a heap."""
    runs = resting.engines(heap_scene(resting.HEAP))
    seconds = {name: [] for name in runs}
    for _ in range(resting.HEAP_STEPS):
        for name, run in runs.items():
            begin = time.perf_counter()
            run.step()
            seconds[name].append(time.perf_counter() - begin)
    rows = [
        {
            "engine": name,
            "awake": f"{1e3 * np.median(values[AWAKE]):.3f}",
            "late": f"{1e3 * np.median(values[LATE]):.3f}",
        }
        for name, values in seconds.items()
    ]
    for row in rows:
        print(*row.values(), flush=True)
    write(RESTING, rows)


def milliseconds(value):
    """Formats milliseconds with two significant digits."""
    value = float(value)
    return text(value, 0 if value >= 10 else 1 if value >= 1 else 2)


def listed(words):
    """Joins words to "a", "a and b" or "a, b and c"."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def scheduling():
    """Returns the rows of the report's table, as text, and the numbers in the text."""
    _, _, rows = read(SCHEDULING)
    times = {(row["scene"], row["scheduling"]): float(row["milliseconds"]) for row in rows}
    numbers = {}
    for name in mechanisms.CONSTRAINED:
        sweep, queue, batches = (times[name, schedule] for schedule in mechanisms.SCHEDULINGS)
        numbers[name] = {
            "sweep": milliseconds(sweep),
            "queue": milliseconds(queue),
            "batches": milliseconds(batches),
            "queueRatio": text(queue / sweep, 2),
            "batchesRatio": text(batches / sweep, 2),
            "batchesFaster": text(sweep / batches, 1),
        }
    slow = [
        name.replace("_", " ")
        for name in mechanisms.CONSTRAINED
        if times[name, "queue"] > 0.95 * times[name, "sweep"]
    ]
    numbers["noGain"] = (
        f"on {listed(slow)} it brings nothing" if slow else "here it pays in all four scenes"
    )
    return numbers


def times_of(rows, material, run):
    """Returns `(bodies, milliseconds)` of a run as arrays."""
    own = [
        (int(row["bodies"]), float(row["milliseconds"]))
        for row in rows
        if (row["material"], row["run"]) == (material, run)
    ]
    return np.array(own).reshape(-1, 2).T


def scale(axis):
    """Milliseconds per step against the number of bodies, with friction."""
    machine, when, rows = read(SCALE)
    numbers = {
        "machine": machine,
        "when": when[0],
        "steps": rows[0]["steps"].replace("-", "–"),
        "load": "".join(part.rsplit(" ", 1)[1] for part in when if part.startswith("load average")),
        "mu": f"{benchmarkPiles.MATERIALS[FRICTION].friction:g}",
        "restitution": f"{benchmarkPiles.MATERIALS[FRICTION].restitution:g}",
        "realTime": f"{1e3 * H:g}",
    }
    sizes = sorted({int(row["bodies"]) for row in rows})
    compared = max([size for size in sizes if size <= COMPARED], default=sizes[0])
    for run, (label, colour, mark, dash) in RUNS.items():
        bodies, times = times_of(rows, FRICTION, run)
        if not len(bodies):
            continue
        axis.loglog(bodies, times, mark + dash, color=colour, label=label)
        key = KEYS[run]
        numbers[f"{key}Exponent"] = text(slope(bodies, times), 2)
        numbers[f"{key}Points"] = str(len(bodies))
        for material, suffix in ((FRICTION, "Friction"), (FRICTIONLESS, "Slick")):
            own = dict(zip(*times_of(rows, material, run), strict=True))
            grid = dict(zip(*times_of(rows, material, "grid"), strict=True))
            soft = dict(zip(*times_of(rows, material, "soft step"), strict=True))
            for count, name in ((compared, ""), (sizes[-1], "Most")):
                if count in own:
                    numbers[key + suffix + name] = milliseconds(own[count])
                    numbers[f"{key}{suffix}{name}Ratio"] = text(grid[count] / own[count], 1)
                    numbers[f"{key}{suffix}{name}SoftRatio"] = text(soft[count] / own[count], 1)
    axis.axhline(1e3 * H, color=style.GREY, linewidth=0.8, linestyle=":")
    axis.set(xlabel="bodies N", ylabel="ms per step")
    axis.set_ylim(top=3e4)
    axis.legend(loc="upper left", ncols=2, columnspacing=0.8, fontsize=6.3)
    axis.set_xticks(sizes, list(map(str, sizes)))
    axis.minorticks_off()
    loop = dict(zip(*times_of(rows, FRICTION, "all pairs"), strict=True))
    grid = dict(zip(*times_of(rows, FRICTION, "grid"), strict=True))
    looped, most = int(max(loop)), sizes[-1]
    last = [row for row in rows if (row["material"], row["run"]) == (FRICTION, "grid")][-1]
    phases = {name: float(last.get(name) or 0) for name in benchmarkPiles.PHASES}
    return numbers | {
        "least": str(sizes[0]),
        "most": mechanisms.thousands(most),
        "compared": mechanisms.thousands(compared),
        "looped": str(looped),
        "loopLooped": milliseconds(loop[looped]),
        "gridLooped": milliseconds(grid[looped]),
        "loopRatio": text(loop[looped] / grid[looped], 1),
        "collisions": text(100 * phases["collisions"] / sum(phases.values()), 0),
        "pairs": mechanisms.thousands(float(last["candidate pairs"])),
        "contacts": mechanisms.thousands(float(last["contacts"])),
        "perPair": text(1e3 * phases["collisions"] / float(last["candidate pairs"]), 0),
    }


def slick(axis):
    """Milliseconds per step against the number of bodies, without friction."""
    _, _, rows = read(SCALE)
    numbers = {}
    for run, (_, colour, mark, dash) in RUNS.items():
        bodies, times = times_of(rows, FRICTIONLESS, run)
        if len(bodies):
            axis.loglog(bodies, times, mark + dash, color=colour, markersize=2.5)
            numbers[f"{KEYS[run]}Exponent"] = text(slope(bodies, times), 2)
            numbers[f"{KEYS[run]}Points"] = str(len(bodies))
    sizes = sorted({int(row["bodies"]) for row in rows if row["material"] == FRICTIONLESS})
    axis.axhline(1e3 * H, color=style.GREY, linewidth=0.8, linestyle=":")
    axis.set(xlabel="bodies N", ylabel="ms per step")
    axis.set_xticks(sizes, list(map(str, sizes)))
    axis.minorticks_off()
    return numbers


def rest_times():
    """Milliseconds per step of the heap of `resting.resting`, awake and late."""
    _, _, rows = read(RESTING)
    numbers = {"bodies": str(resting.HEAP)}
    for name, window in (("awake", AWAKE), ("late", LATE)):
        numbers |= {f"{name}From": str(window.start), f"{name}To": str(window.stop)}
    for row in rows:
        key = resting.ENGINES[row["engine"]][0]
        numbers[f"{key}Awake"] = milliseconds(row["awake"])
        numbers[f"{key}Late"] = milliseconds(row["late"])
    own = {row["engine"]: row for row in rows}
    for name, (key, *_) in resting.ENGINES.items():
        if name in own:
            for when in ("awake", "late"):
                ratio = float(own["soft step"][when]) / float(own[name][when])
                numbers[f"soft{key.capitalize()}{when.capitalize()}"] = text(ratio, 1)
    return numbers
