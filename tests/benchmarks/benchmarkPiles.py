"""Milliseconds per step against the number of bodies: `python tests/benchmarks/benchmarkPiles.py`.

    python tests/benchmarks/benchmarkPiles.py --sizes 50 200 1000 --kinds pile --windows 200-300
    python tests/benchmarks/benchmarkPiles.py --sizes 200 1000 --kinds heap --peers PyBullet

Scenes are those of make_pile.py. Each is run without friction and with it; see MATERIALS. For
each kind, size and material, the runs take turns step by step, so that a busy machine is busy for
all of them: the loop over all pairs up to --all-up-to bodies, the grid and the soft step. With
--peers also MuJoCo (Newton's method or CG) and PyBullet (`pip install mujoco pybullet`): on the
same hulls, poses, densities and time step, with the same friction and, in PyBullet, restitution.

Prints, for every window of steps, medians with quartiles, contacts a body and growth exponents, and
writes piles.csv. A contact is a pair that touches, however many points a peer makes of it.
"""

import argparse
import csv
import functools
import itertools
import math
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmark import describe_machine

from rbs.scenes.scenefiles import DATA_FOLDER
from rbs.scenes.simulation import SceneSimulation, Settings
from rbs.stepping.reports import PHASES

TIME_STEP = 0.02
SIZES = [50, 200, 1000, 2000, 5000, 10000]
KINDS = {"pile": [], "spread": ["--spread"], "heap": ["--heap"]}
# Steps that are measured, the last one not included: those in which a heap collapses, and those in
# which what is left of it moves slowly.
WINDOWS = ["200-300", "500-600"]
# Steps from one count of contacts to the next. Our next step takes a tenth longer: it releases the
# list of contacts, which has also displaced its arrays from the processor's caches.
COUNT_EVERY = 10


class Material(NamedTuple):
    """The material of all bodies and of the ground."""

    friction: float  # Coulomb's μ
    restitution: float


MATERIALS = {"no friction": Material(0.0, 0.5), "friction 0.5": Material(0.5, 0.0)}
OWN = {"all pairs": {}, "grid": {"broadPhase": "grid"}}
OWN |= {"batches": {"contactScheduling": "batches"}, "soft step": {"contactSolver": "soft-step"}}
QUARTILES = ["milliseconds", "low quartile", "high quartile"]
COLUMNS = ["kind", "bodies", "material", "run", "steps", *QUARTILES, "candidate pairs", "contacts"]
COLUMNS += ["contacts a body", *PHASES, "peak memory MB"]


class OwnRun:
    """This program on a scene file."""

    def __init__(self, scene, material, **settings):
        settings = Settings(material.restitution, TIME_STEP, friction=material.friction, **settings)
        self.simulation = SceneSimulation(scene, settings)

    def step(self):
        self.simulation.step()

    def counts(self):
        """`(candidate pairs, contacts, seconds by phase)` of the last step."""
        report = self.simulation.report
        pairs = {(contact.body1, contact.body2) for contact in report.contacts}
        return report.candidatePairs, len(pairs), report.seconds


class MuJoCoRun:
    """MuJoCo on the bodies of a simulation; a plane stands for the ground.

    Of the friction of two geoms it takes the greater. It has no restitution: contacts are springs
    with dampers, by default critically damped, so that bodies hardly bounce.
    """

    def __init__(self, simulation, material, solver="newton"):
        """solver : "newton", MuJoCo's default, or "cg" """
        import mujoco

        self.mujoco = mujoco
        spec = mujoco.MjSpec()
        spec.option.timestep = TIME_STEP
        spec.option.gravity = (0.0, -9.8, 0.0)
        spec.option.solver = getattr(mujoco.mjtSolver, f"mjSOL_{solver.upper()}")
        # left to itself, MuJoCo asks for more memory than there is from some thousand bodies on
        spec.memory = max(2**30, len(simulation.meshes) * 2**18)
        # a normal alone, or with two directions to slide in; no friction of torsion or rolling
        surface = {"condim": 3, "friction": (material.friction, 0, 0)}
        if material.friction == 0:
            surface = {"condim": 1}
        # the plane's normal is its z axis: turned to y
        level = {"size": (1, 1, 1), "quat": (math.sqrt(0.5), -math.sqrt(0.5), 0, 0)}
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, **level, **surface)
        known = {}
        for mesh in simulation.meshes:
            if id(mesh.hull) not in known:
                known[id(mesh.hull)] = f"mesh{len(known)}"
                spec.add_mesh(name=known[id(mesh.hull)], uservert=mesh.hull.vertices.ravel())
            body = spec.worldbody.add_body(pos=mesh.position[0], quat=mesh.orientation[0])
            body.add_freejoint()
            shape = {"meshname": known[id(mesh.hull)], "density": mesh.density}
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, **shape, **surface)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)

    def step(self):
        self.mujoco.mj_step(self.model, self.data)

    def counts(self):
        pairs = np.sort(self.data.contact.geom[: self.data.ncon], axis=1)
        return None, len(np.unique(pairs, axis=0)), {}


class PyBulletRun:
    """PyBullet on the bodies of a simulation; a plane stands for the ground.

    It multiplies the frictions of two bodies, and so their restitutions: each body has the root.
    """

    def __init__(self, simulation, material):
        import pybullet

        self.pybullet = pybullet
        self.client = pybullet.connect(pybullet.DIRECT)
        pybullet.setTimeStep(TIME_STEP, physicsClientId=self.client)
        pybullet.setGravity(0.0, -9.8, 0.0, physicsClientId=self.client)
        here = {"physicsClientId": self.client}
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, planeNormal=(0, 1, 0), **here)
        bodies = [pybullet.createMultiBody(0, plane, **here)]
        shapes = {}
        for mesh in simulation.meshes:
            if id(mesh.hull) not in shapes:
                vertices = mesh.hull.vertices.tolist()
                shape = pybullet.createCollisionShape(pybullet.GEOM_MESH, vertices=vertices, **here)
                shapes[id(mesh.hull)] = shape
            w, *xyz = mesh.orientation[0].tolist()
            pose = mesh.position[0].tolist(), (*xyz, w)
            body = mesh.mass, shapes[id(mesh.hull)], -1, *pose
            bodies.append(pybullet.createMultiBody(*body, useMaximalCoordinates=1, **here))
        friction, restitution = map(math.sqrt, (material.friction, material.restitution))
        surface = {"lateralFriction": friction, "restitution": restitution}
        for body in bodies:
            pybullet.changeDynamics(body, -1, **surface, **here)

    def step(self):
        self.pybullet.stepSimulation(physicsClientId=self.client)

    def counts(self):
        points = self.pybullet.getContactPoints(physicsClientId=self.client) or ()
        touching = {(point[1], point[2]) for point in points if point[8] <= 0}  # the distance
        return None, len(touching), {}


# name in the table → package, what makes the run
PEERS = {
    "MuJoCo": ("mujoco", MuJoCoRun),
    "MuJoCo, CG": ("mujoco", functools.partial(MuJoCoRun, solver="cg")),
    "PyBullet": ("pybullet", PyBulletRun),
}


def make_scene(kind, count, folder, seed=1):
    """A scene file of data/scripts/make_pile.py, in `folder`, with the meshes beside it."""
    command = [sys.executable, DATA_FOLDER / "scripts" / "make_pile.py", str(count), *KINDS[kind]]
    path = Path(folder) / f"{kind}_{count}-scene.txt"
    subprocess.run([*command, "--seed", str(seed), "--out", path], check=True)
    for mesh in DATA_FOLDER.glob("*.mesh"):
        shutil.copy(mesh, folder)
    return path


def make_runs(scene, count, material, options):
    """Name → run, for everything that is asked for."""
    runs = {
        name: OwnRun(scene, material, **settings)
        for name, settings in OWN.items()
        if name not in ("all pairs", "grid") or count <= options.all_up_to
    }
    for name in options.peers:
        try:
            runs[name] = PEERS[name][1](SceneSimulation(scene), material)
        except (ValueError, MemoryError) as error:  # some do not take so many
            print(f"{name} left out at {count} bodies: {error}")
    return runs


def read_window(text):
    """A range of steps from "K-N"; raises ValueError."""
    begin, end = map(int, text.split("-"))
    if not 0 <= begin < end:
        raise ValueError("no step is in there")
    return range(begin, end)


def measure(runs, windows):
    """Steps the runs in turns; (window, name) → `(seconds of each step, counts of some steps)`."""
    kept = {key: ([], []) for key in itertools.product(windows, runs)}
    for step in range(max(window.stop for window in windows)):
        for name, run in runs.items():
            begin = time.perf_counter()
            run.step()
            end = time.perf_counter()
            for window in windows:
                if step in window:
                    seconds, counts = kept[window, name]
                    seconds.append(end - begin)
                    if step in window[::COUNT_EVERY]:
                        counts.append(run.counts())
    return kept


def row_of(kind, count, material, name, window, seconds, counts):
    """One line of the table: a dict with the COLUMNS as its keys."""
    low, median, high = np.percentile(1e3 * np.array(seconds), (25, 50, 75))
    pairs, contacts, phases = zip(*counts, strict=True)
    times = {
        phase: f"{1e3 * np.median([one.get(phase, 0.0) for one in phases]):.3f}"
        for phase in phases[0]
    }
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {
        "kind": kind,
        "bodies": count,
        "material": material,
        "run": name,
        "steps": f"{window.start}-{window.stop}",
        "milliseconds": f"{median:.3f}",
        "low quartile": f"{low:.3f}",
        "high quartile": f"{high:.3f}",
        "candidate pairs": "" if pairs[0] is None else f"{np.median(pairs):g}",
        "contacts": f"{np.median(contacts):g}",
        "contacts a body": f"{np.median(contacts) / count:.2f}",
        **times,
        "peak memory MB": f"{peak:.0f}",
    }


def group_of(row):
    """The columns by which rows are compared."""
    return row["kind"], row["material"], row["steps"]


def print_row(row):
    kind, material, steps = group_of(row)
    details = [f"{row['contacts a body']} contacts a body"]
    if row["candidate pairs"]:
        details.append(f"{row['candidate pairs']} pairs")
    details += [f"{phase} {float(row[phase]):.1f}" for phase in PHASES if row.get(phase)]
    print(
        f"{kind:<7}{row['bodies']:>6} {material:<13}{steps:<8} {row['run']:<11}"
        f"{float(row['milliseconds']):9.2f} ms "
        f"({float(row['low quartile']):.2f} – {float(row['high quartile']):.2f}); "
        f"{', '.join(details)}",
        flush=True,
    )


def print_growth(rows):
    """Prints d log(time) / d log(bodies) between the sizes, for each group and run."""
    for group, run in dict.fromkeys((group_of(row), row["run"]) for row in rows):
        own = [
            (row["bodies"], float(row["milliseconds"]))
            for row in rows
            if (group_of(row), row["run"]) == (group, run)
        ]
        for (n1, t1), (n2, t2) in itertools.pairwise(own):
            exponent = math.log(t2 / t1) / math.log(n2 / n1)
            kind, material, steps = group
            print(
                f"{kind:<7}{material:<13}{steps:<8} {run:<11} {n1:>6} to {n2:>6}: "
                f"time grows as N^{exponent:.2f}"
            )


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", nargs="+", type=int, default=SIZES, metavar="N")
    kinds = {"nargs": "+", "choices": KINDS, "default": list(KINDS), "metavar": "NAME"}
    parser.add_argument("--kinds", help=", ".join(KINDS), **kinds)
    windows = {"nargs": "+", "type": read_window, "default": list(map(read_window, WINDOWS))}
    text = f"steps that are measured (default: {' '.join(WINDOWS)})"
    parser.add_argument("--windows", metavar="K-N", help=text, **windows)
    text = "largest scene for the loop over all pairs (default: %(default)s)"
    parser.add_argument("--all-up-to", type=int, default=1000, metavar="N", help=text)
    peers = {"nargs": "+", "choices": PEERS, "default": [], "metavar": "NAME"}
    parser.add_argument("--peers", help=f"of {', '.join(map(repr, PEERS))}", **peers)
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of the scenes")
    options = parser.parse_args()

    out = Path("out/benchmark")
    out.mkdir(parents=True, exist_ok=True)
    print(describe_machine())
    print(f"medians (quartiles); steps of {TIME_STEP} s")
    for name, material in MATERIALS.items():
        print(f"{name}: μ = {material.friction:g}, restitution {material.restitution:g}")
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for case in itertools.product(options.kinds, options.sizes, MATERIALS):
            kind, count, material = case
            scene = make_scene(kind, count, folder, options.seed)
            runs = make_runs(scene, count, MATERIALS[material], options)
            new = [
                row_of(*case, name, window, *kept)
                for (window, name), kept in measure(runs, options.windows).items()
            ]
            for row in new:
                print_row(row)
            rows += new
    print_growth(rows)
    with (out / "piles.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
    print(f"written to {out}")


if __name__ == "__main__":
    main()
