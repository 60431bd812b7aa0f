"""Milliseconds per step against the number of bodies: `python tests/benchmarkPiles.py`.

    python tests/benchmarkPiles.py --sizes 50 200 1000 --kinds pile --out out/benchmark
    python tests/benchmarkPiles.py --sizes 200 1000 --kinds pile --peers

Scenes are those of data/make_pile.py. For each kind and size, the runs take turns step by step, so
that a busy machine is busy for all of them: the basic loop over all pairs up to --all-up-to bodies,
the grid, and the grid with coloured pairs; with --peers also MuJoCo and PyBullet, where they are
installed (`pip install mujoco pybullet`), on the same hulls, poses, density and time step. Prints
medians over the last third of the steps and growth exponents, and writes piles.csv, and piles.png
and phases.png where matplotlib is installed.
"""

import argparse
import csv
import importlib.util
import math
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmark import describe_machine

from rbs.scenes import DATA_FOLDER
from rbs.simulation import Settings, Simulation
from RBSFunctions import PHASES

TIME_STEP = 0.02
RESTITUTION = 0.5
SIZES = [50, 200, 1000, 2000, 5000, 10000]
KINDS = {"pile": [], "spread": ["--spread"]}
OWN = {
    "default": {},
    "grid": {"broadPhase": "grid"},
    "coloured": {"broadPhase": "grid", "pairOrder": "coloured"},
}
COLUMNS = ["kind", "bodies", "run", "milliseconds", "low quartile", "high quartile",
           "candidate pairs", "contacts", *PHASES, "peak memory MB"]  # fmt: skip
# Okabe and Ito's colours, told apart by the colour-blind.
COLOURS = ["#000000", "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"]


class OwnRun:
    """This program on a scene file."""

    def __init__(self, scene, **settings):
        self.simulation = Simulation(scene, Settings(RESTITUTION, TIME_STEP, **settings))

    def step(self):
        self.simulation.step()

    def counts(self):
        """`(candidate pairs, contacts, seconds by phase)` of the last step."""
        report = self.simulation.report
        return report.candidatePairs, len(report.contacts), report.seconds


class MuJoCoRun:
    """MuJoCo on the bodies of a simulation; a plane stands for the ground."""

    def __init__(self, simulation, hasFriction):
        import mujoco

        self.mujoco = mujoco
        spec = mujoco.MjSpec()
        spec.option.timestep = TIME_STEP
        spec.option.gravity = (0.0, -9.8, 0.0)
        # left to itself, MuJoCo asks for more memory than there is from some thousand bodies on
        spec.memory = max(2**30, len(simulation.meshes) * 2**18)
        condim = 3 if hasFriction else 1
        # the plane's normal is its z axis: turned to y
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(1, 1, 1), condim=condim,
                                quat=(math.sqrt(0.5), -math.sqrt(0.5), 0, 0))  # fmt: skip
        known = {}
        for mesh in simulation.meshes:
            if id(mesh.hull) not in known:
                known[id(mesh.hull)] = f"mesh{len(known)}"
                spec.add_mesh(name=known[id(mesh.hull)], uservert=mesh.hull.vertices.ravel())
            body = spec.worldbody.add_body(pos=mesh.position[0], quat=mesh.orientation[0])
            body.add_freejoint()
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=known[id(mesh.hull)],
                          density=mesh.density, condim=condim)  # fmt: skip
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)

    def step(self):
        self.mujoco.mj_step(self.model, self.data)

    def counts(self):
        pairs = np.sort(self.data.contact.geom[: self.data.ncon], axis=1)
        return None, len(np.unique(pairs, axis=0)), {}


class PyBulletRun:
    """PyBullet on the bodies of a simulation; a plane stands for the ground."""

    def __init__(self, simulation, hasFriction):
        import pybullet

        self.pybullet = pybullet
        self.client = pybullet.connect(pybullet.DIRECT)
        pybullet.setTimeStep(TIME_STEP, physicsClientId=self.client)
        pybullet.setGravity(0.0, -9.8, 0.0, physicsClientId=self.client)
        plane = pybullet.createCollisionShape(
            pybullet.GEOM_PLANE, planeNormal=(0, 1, 0), physicsClientId=self.client
        )
        bodies = [pybullet.createMultiBody(0, plane, physicsClientId=self.client)]
        shapes = {}
        for mesh in simulation.meshes:
            if id(mesh.hull) not in shapes:
                shapes[id(mesh.hull)] = pybullet.createCollisionShape(
                    pybullet.GEOM_MESH, vertices=mesh.hull.vertices.tolist(),
                    physicsClientId=self.client,
                )  # fmt: skip
            w, *xyz = mesh.orientation[0].tolist()
            bodies.append(pybullet.createMultiBody(
                mesh.mass, shapes[id(mesh.hull)], -1, mesh.position[0].tolist(), (*xyz, w),
                useMaximalCoordinates=1, physicsClientId=self.client,
            ))  # fmt: skip
        if not hasFriction:
            for body in bodies:
                pybullet.changeDynamics(
                    body, -1, lateralFriction=0.0, physicsClientId=self.client
                )

    def step(self):
        self.pybullet.stepSimulation(physicsClientId=self.client)

    def counts(self):
        points = self.pybullet.getContactPoints(physicsClientId=self.client) or ()
        return None, len({(point[1], point[2]) for point in points}), {}


PEERS = {"MuJoCo": ("mujoco", MuJoCoRun), "PyBullet": ("pybullet", PyBulletRun)}


def make_scene(kind, count, folder):
    """A scene file of data/make_pile.py, in `folder`, with the meshes beside it."""
    command = [sys.executable, DATA_FOLDER / "make_pile.py", str(count), *KINDS[kind]]
    path = Path(folder) / f"{kind}_{count}-scene.txt"
    subprocess.run([*command, "--out", path], check=True)
    for mesh in DATA_FOLDER.glob("*.mesh"):
        shutil.copy(mesh, folder)
    return path


def make_runs(scene, count, options):
    """Name → run, for everything that is asked for."""
    runs = {
        name: OwnRun(scene, **settings)
        for name, settings in OWN.items()
        if name != "default" or count <= options.all_up_to
    }
    if options.peers:
        simulation = Simulation(scene)
        for name, (package, peer) in PEERS.items():
            if not importlib.util.find_spec(package):
                continue
            for hasFriction, friction in ((False, "no friction"), (True, "default friction")):
                try:
                    runs[f"{name}, {friction}"] = peer(simulation, hasFriction)
                except (ValueError, MemoryError) as error:  # some do not take so many
                    print(f"{name}, {friction}, left out at {count} bodies: {error}")
    return runs


def measure(runs, steps):
    """Steps the runs in turns; name → `(seconds, counts)` of the steps of the last third."""
    kept = {name: [] for name in runs}
    for step in range(steps):
        for name, run in runs.items():
            begin = time.perf_counter()
            run.step()
            seconds = time.perf_counter() - begin
            if step >= steps - max(1, steps // 3):
                kept[name].append((seconds, run.counts()))
    return kept


def row_of(kind, count, name, kept):
    """One line of the table: a dict with the COLUMNS as its keys."""
    seconds, counts = zip(*kept, strict=True)
    low, median, high = np.percentile(1e3 * np.array(seconds), (25, 50, 75))
    phases = {}
    for phase in counts[0][2]:
        phases[phase] = f"{1e3 * np.median([count[2][phase] for count in counts]):.3f}"
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {
        "kind": kind, "bodies": count, "run": name, "milliseconds": f"{median:.3f}",
        "low quartile": f"{low:.3f}", "high quartile": f"{high:.3f}",
        "candidate pairs": "" if counts[0][0] is None else f"{np.median([c[0] for c in counts]):g}",
        "contacts": f"{np.median([c[1] for c in counts]):g}", **phases,
        "peak memory MB": f"{peak:.0f}",
    }  # fmt: skip


def print_row(row, reference):
    """Prints a row, with its ratio to the reference in ms."""
    ratio = float(row["milliseconds"]) / reference
    details = [f"{row['contacts']} contacts"]
    if row["candidate pairs"]:
        details.insert(0, f"{row['candidate pairs']} pairs")
    details += [f"{phase} {float(row[phase]):.1f}" for phase in PHASES if row.get(phase)]
    print(
        f"{row['kind']:<7}{row['bodies']:>6} {row['run']:<26}{float(row['milliseconds']):9.2f} ms "
        f"({float(row['low quartile']):.2f} – {float(row['high quartile']):.2f}), "
        f"{ratio:5.2f} × the grid; {', '.join(details)}",
        flush=True,
    )


def print_growth(rows):
    """Prints d log(time) / d log(bodies) between the sizes, for each kind and run."""
    for kind, run in dict.fromkeys((row["kind"], row["run"]) for row in rows):
        own = [(row["bodies"], float(row["milliseconds"]))
               for row in rows if (row["kind"], row["run"]) == (kind, run)]  # fmt: skip
        for (n1, t1), (n2, t2) in zip(own, own[1:], strict=False):
            exponent = math.log(t2 / t1) / math.log(n2 / n1)
            print(f"{kind:<7}{run:<26} {n1:>6} to {n2:>6}: time grows as N^{exponent:.2f}")


def draw(rows, folder):
    """piles.png and phases.png; says so where matplotlib is missing."""
    if not importlib.util.find_spec("matplotlib"):
        print("no plots: pip install matplotlib")
        return
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    kinds = list(dict.fromkeys(row["kind"] for row in rows))
    names = list(dict.fromkeys(row["run"] for row in rows))
    figure, axes = pyplot.subplots(
        1, len(kinds), figsize=(4.5 * len(kinds) + 0.5, 4), sharey=True, squeeze=False
    )
    for axis, kind in zip(axes[0], kinds, strict=True):
        for name, colour in zip(names, COLOURS, strict=False):
            own = [row for row in rows if (row["kind"], row["run"]) == (kind, name)]
            axis.loglog([row["bodies"] for row in own],
                        [float(row["milliseconds"]) for row in own], "o-", color=colour,
                        label=name)  # fmt: skip
        axis.axhline(1e3 * TIME_STEP, color="0.6", linewidth=1, linestyle=":")
        axis.set(title=kind, xlabel="bodies")
        axis.grid(which="major", color="0.9")
    axes[0][0].set_ylabel("milliseconds per step (dotted: real time)")
    axes[0][0].legend(frameon=False)
    figure.tight_layout()
    figure.savefig(folder / "piles.png", dpi=150)

    own = [row for row in rows if row["run"] == "grid" and row["kind"] == kinds[0]]
    figure, axis = pyplot.subplots(figsize=(6, 4))
    bottom = np.zeros(len(own))
    for phase, colour in zip(PHASES, COLOURS[1:], strict=True):
        share = np.array([float(row[phase]) / float(row["milliseconds"]) for row in own])
        axis.bar([str(row["bodies"]) for row in own], share, bottom=bottom, color=colour,
                 label=phase)  # fmt: skip
        bottom += share
    axis.set(xlabel=f"bodies ({kinds[0]}, grid)", ylabel="share of the step", ylim=(0, 1))
    axis.legend(frameon=False, bbox_to_anchor=(1, 1))
    figure.tight_layout()
    figure.savefig(folder / "phases.png", dpi=150)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", nargs="+", type=int, default=SIZES, metavar="N")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS), metavar="KIND",
                        help=", ".join(KINDS))  # fmt: skip
    parser.add_argument("--steps", type=int, default=300, metavar="N")
    parser.add_argument("--all-up-to", type=int, default=1000, metavar="N",
                        help="largest scene for the loop over all pairs (default: %(default)s)")
    parser.add_argument("--peers", action="store_true", help="MuJoCo and PyBullet as well")
    parser.add_argument("--out", type=Path, default=Path("out/benchmark"), metavar="DIR")
    options = parser.parse_args()

    options.out.mkdir(parents=True, exist_ok=True)
    print(describe_machine())
    print(f"medians (quartiles) of the last third of {options.steps} steps of {TIME_STEP} s")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for kind in options.kinds:
            for count in options.sizes:
                runs = make_runs(make_scene(kind, count, folder), count, options)
                new = [
                    row_of(kind, count, name, kept)
                    for name, kept in measure(runs, options.steps).items()
                ]
                grid = next(float(row["milliseconds"]) for row in new if row["run"] == "grid")
                for row in new:
                    print_row(row, grid)
                rows += new
    print_growth(rows)
    with (options.out / "piles.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
    draw(rows, options.out)
    print(f"written to {options.out}")


if __name__ == "__main__":
    main()
