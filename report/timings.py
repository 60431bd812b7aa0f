"""What takes how long: the part of the report that differs from run to run.

Both tables are kept as text files beside this one, with the machine and the date in their first
lines, so that the report can be built from them without measuring again.
"""

import csv
import datetime
import importlib.util
import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import style
from experiments import BOX, ROOT, STACK_SECONDS, H, scene, text

sys.path.insert(0, str(ROOT / "tests"))
import benchmark
import benchmarkPiles

from rbs.simulation import CONSTRAINT_TOLERANCE

FOLDER = Path(__file__).resolve().parent
SCALE, SCHEDULING = FOLDER / "scale.csv", FOLDER / "scheduling.csv"
SIZES = [50, 200, 1000, 3000]
QUICK_SIZES = [50, 200]
# What all runs are compared on: dense heaps, with one friction and restitution for all of them.
KIND, MATERIAL_NAME = "heap", "friction 0.5"
MATERIAL = benchmarkPiles.MATERIALS[MATERIAL_NAME]
FIRST_STEP, LAST_STEP = 200, 300

TIED_SCENES = ("cube", "two_chain", "bridge", "net")
SCHEDULINGS = ("sweep", "queue", "batches")
TIED_STEPS, TIED_FROM = 100, 50

RUNS = {  # name in the table → label, colour, marker, dash
    "all pairs": ("all pairs", style.BLACK, "o", "-"),
    "grid": ("grid, same bits", style.BLUE, "s", "-"),
    "PyBullet": ("PyBullet", style.GREEN, "D", "--"),
    "MuJoCo": ("MuJoCo", style.PURPLE, "v", "--"),
    "MuJoCo, CG": ("MuJoCo, CG", style.VERMILION, "^", "--"),
}


def write(path, columns, rows):
    """A table, under comment lines that say where and when it was measured."""
    revision = subprocess.run(
        ["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True
    ).stdout.strip()
    with path.open("w", newline="") as file:
        file.write(f"# {benchmark.describe_machine()}\n")
        today = datetime.date.today().isoformat()
        load = os.getloadavg()[0] if hasattr(os, "getloadavg") else math.nan
        file.write(f"# {today}, revision {revision}, load average {load:.1f}\n")
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def read(path):
    """`(machine, [date, revision, load average], rows)` of a table."""
    lines = path.read_text().splitlines()
    machine, when = (line.removeprefix("# ") for line in lines[:2])
    return machine, when.split(", "), list(csv.DictReader(lines[2:]))


def measure_scale(sizes):
    """Writes scale.csv: tests/benchmarkPiles.py with these numbers of bodies."""
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable, benchmarkPiles.__file__, "--sizes", *map(str, sizes), "--kinds", KIND,
            "--materials", MATERIAL_NAME, "--windows", f"{FIRST_STEP}-{LAST_STEP}", "--peers",
            "--out", folder,
        ]  # fmt: skip
        subprocess.run(command, check=True)
        with (Path(folder) / "piles.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
    write(SCALE, benchmarkPiles.COLUMNS, rows)


def measure_scheduling():
    """Writes scheduling.csv: visits and milliseconds of the three schedulings."""
    rows = []
    for name in TIED_SCENES:
        simulations = [scene(name, constraintScheduling=s, broadPhase="grid") for s in SCHEDULINGS]
        series = benchmark.measure(simulations, TIED_STEPS, TIED_FROM)
        for scheduling, simulation, kept in zip(SCHEDULINGS, simulations, series, strict=True):
            visits = np.mean([report.constraintVisits for _, report in kept])
            times = [1e3 * report.seconds["constraints"] for _, report in kept]
            rows.append({
                "scene": name, "scheduling": scheduling, "bounds": len(simulation.constraints),
                "visits": f"{visits:.0f}", "milliseconds": f"{np.median(times):.3f}",
            })  # fmt: skip
            print(*rows[-1].values(), flush=True)
    write(SCHEDULING, list(rows[0]), rows)


def batch_size(simulation):
    """How many ties a batch of the scheduling "batches" holds, in the mean.

    Each tie that can be corrected goes into the first batch in which nothing moves its two bodies.
    """
    batches = [set() for _ in simulation.constraints]  # of bodies that are moved in each
    corrected = 0
    for m1, _, m2, _, length, isUpper in simulation.constraints:
        movable = {m for m in (m1, m2) if not simulation.meshes[m].isFixed}
        if m1 == m2 or not movable or not (isUpper or length > CONSTRAINT_TOLERANCE):
            continue
        next(batch for batch in batches if not batch & movable).update(movable)
        corrected += 1
    return corrected / sum(map(bool, batches))


def scheduling():
    """The table of the report, as rows of text, and what the text says of it."""
    _, _, rows = read(SCHEDULING)
    table, numbers = [], {}
    for name in TIED_SCENES:
        own = {row["scheduling"]: row for row in rows if row["scene"] == name}
        if not own:
            continue
        times = [float(own[s]["milliseconds"]) for s in SCHEDULINGS]
        visits = [float(own[s]["visits"]) for s in SCHEDULINGS]
        table.append([
            name.replace("_", " "), own["sweep"]["bounds"],
            *(f"{v:,.0f}".replace(",", "\u202f") for v in visits),
            *(f"{t:.2f}" if t < 10 else f"{t:.0f}" for t in times),
        ])  # fmt: skip
        numbers[name] = {
            "queue": text(100 * times[1] / times[0], 0),
            "visits": text(100 * visits[1] / visits[0], 0),
            "batches": text(times[0] / times[2], 1), "slower": text(times[2] / times[0], 1),
            "batch": text(batch_size(scene(name)), 0),
        }  # fmt: skip
    return {"table": table, "steps": str(TIED_STEPS), "from": str(TIED_FROM), **numbers}


def times_of(rows, run):
    """`(bodies, milliseconds)` of a run, as arrays."""
    own = [(int(row["bodies"]), float(row["milliseconds"])) for row in rows if row["run"] == run]
    return np.array(own).reshape(-1, 2).T


def peers():
    """How far a stack of eight boxes sinks in MuJoCo and PyBullet, where they are installed; cm.

    Without friction, as the stack of our own.
    """
    import pictures

    count, numbers = 8, {}
    for name in ("MuJoCo", "PyBullet"):
        package, peer = benchmarkPiles.PEERS[name]
        if not importlib.util.find_spec(package):
            continue
        rows = [("box.mesh", 500, False, (0, BOX[1] * (k + 0.5), 0), (1, 0, 0, 0))
                for k in range(count)]  # fmt: skip
        run = peer(pictures.made_scene(rows), benchmarkPiles.MATERIALS["no friction"])
        for _ in range(round(STACK_SECONDS / H)):
            run.step()
        if name == "MuJoCo":
            top = run.data.qpos[7 * (count - 1) + 1]
        else:  # the plane is number 0
            place, _ = run.pybullet.getBasePositionAndOrientation(count, physicsClientId=run.client)
            top = place[1]
        numbers[name.lower()] = text(1e2 * (BOX[1] * (count - 0.5) - top), 1)
    return numbers


def scale(axis):
    """Milliseconds per step against the number of bodies."""
    machine, when, rows = read(SCALE)
    for run, (label, colour, mark, dash) in RUNS.items():
        bodies, times = times_of(rows, run)
        if len(bodies):
            axis.loglog(bodies, times, mark + dash, color=colour, label=label)
    axis.axhline(1e3 * H, color=style.GREY, linewidth=0.8, linestyle=":")
    axis.annotate("real time", (SIZES[0], 1e3 * H), xytext=(0, 1), textcoords="offset points",
                  fontsize=7, color="0.35", ha="left", va="bottom")  # fmt: skip
    axis.set(xlabel="bodies N", ylabel="ms per step")
    axis.legend(loc="upper left")
    axis.set_ylim(top=20000)
    sizes = sorted({int(row["bodies"]) for row in rows})
    axis.set_xticks(sizes, list(map(str, sizes)))
    axis.minorticks_off()
    sizes, grid = times_of(rows, "grid")
    at = dict(zip(sizes.astype(int).tolist(), grid, strict=True))
    largest = int(sizes[-1])
    load = [part.rsplit(" ", 1)[1] for part in when if part.startswith("load average")]
    numbers = {
        "machine": machine, "when": when[0], "load": "".join(load) or "not noted",
        "largest": f"{largest:,}".replace(",", "\u202f"), "gridLargest": text(at[largest], 0),
        "exponent": text(math.log(grid[-1] / grid[-2]) / math.log(sizes[-1] / sizes[-2]), 2),
        "from": str(FIRST_STEP), "steps": str(LAST_STEP), "realTime": f"{1e3 * H:g}",
        "mu": f"{MATERIAL.friction:g}", "restitution": f"{MATERIAL.restitution:g}",
    }  # fmt: skip
    own = dict(zip(*times_of(rows, "all pairs"), strict=True))
    middle = int(max(own))
    numbers |= {
        "middle": f"{middle:,}".replace(",", "\u202f"),
        "allPairs": text(own[middle], 0), "gridMiddle": text(at[middle], 0),
        "faster": text(own[middle] / at[middle], 1),
    }  # fmt: skip
    for name, key in (("PyBullet", "pybullet"), ("MuJoCo", "mujoco"), ("MuJoCo, CG", "mujocoCG")):
        other = dict(zip(*times_of(rows, name), strict=True))
        if middle in other:
            numbers[key] = text(other[middle], 0)
            numbers[f"{key}Ratio"] = text(at[middle] / other[middle], 2)
        if largest in other:
            numbers[f"{key}Largest"] = text(other[largest], 0)
            numbers[f"{key}LargestRatio"] = text(at[largest] / other[largest], 2)
    return numbers


def phases(axis):
    """Shares of the step, grid, against the number of bodies."""
    _, _, rows = read(SCALE)
    rows = [row for row in rows if row["run"] == "grid"]
    names = benchmarkPiles.PHASES
    shares = np.array([[float(row[name] or 0) for name in names] for row in rows])
    shares /= shares.sum(axis=1, keepdims=True)
    shown = [name for name, share in zip(names, shares.T, strict=True) if share.max() > 0.02]
    bottom = np.zeros(len(rows))
    for k, name in enumerate(shown):
        share = shares[:, names.index(name)]
        axis.bar(range(len(rows)), 100 * share, bottom=bottom, color=style.COLOURS[k], label=name,
                 width=0.7)  # fmt: skip
        bottom += 100 * share
    axis.set_xticks(range(len(rows)), [row["bodies"] for row in rows])
    axis.set(xlabel="bodies N", ylabel="% of the step", ylim=(0, 100))
    axis.legend(loc="lower center", bbox_to_anchor=(0.45, 1.0), ncols=3, columnspacing=1.0,
                handlelength=1.0)  # fmt: skip
    axis.grid(False)
    last = rows[-1]
    collisions = shares[-1, names.index("collisions")]
    return {
        "collisions": text(100 * collisions, 0), "collisionsFirst":
        text(100 * shares[0, names.index("collisions")], 0),
        "bodies": f"{int(last['bodies']):,}".replace(",", "\u202f"),
        "pairs": f"{float(last['candidate pairs']):,.0f}".replace(",", "\u202f"),
        "contacts": f"{float(last['contacts']):,.0f}".replace(",", "\u202f"),
        "contactsABody": text(float(last["contacts a body"]), 1),
        "perPair": text(1e3 * float(last["collisions"]) / float(last["candidate pairs"]), 0),
    }  # fmt: skip
