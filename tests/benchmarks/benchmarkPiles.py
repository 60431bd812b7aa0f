"""Milliseconds per step of heaps, by the number of bodies, beside other engines.

    python tests/benchmarks/benchmarkPiles.py --sizes 200 1000 --windows 200-300 --peers PyBullet

Scenes are heaps of make_pile.py, each without friction and with it; see MATERIALS. The runs of one
take turns step by step, so that a busy machine is busy for all of them: the loop over all pairs and
the grid up to --all-up-to bodies, batches and the soft step. With --peers also MuJoCo (Newton's
method or CG) and PyBullet (`pip install mujoco pybullet`): on the same hulls, poses, densities and
time step, with the same friction and, in PyBullet, restitution.

Prints medians with quartiles, and contacts per body. A contact is a pair that touches, however many
points a peer makes of it.
"""

import argparse
import functools
import itertools
import math
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmark import describe_machine, quartiles

from rbs.scenes.scenefiles import DATA_FOLDER
from rbs.scenes.simulation import SceneSimulation, Settings

TIME_STEP = 0.02
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


class OwnRun:
    """This program on a scene file."""

    def __init__(self, scene, material, **settings):
        settings = Settings(material.restitution, TIME_STEP, friction=material.friction, **settings)
        self.simulation = SceneSimulation(scene, settings)

    def step(self):
        self.simulation.step()

    def contacts(self):
        """The number of pairs that touched in the last step."""
        return len({(contact.body1, contact.body2) for contact in self.simulation.report.contacts})


class MuJoCoRun:
    """MuJoCo on the bodies of a simulation; a plane stands for the ground.

    It takes the greater friction of two geoms. It has no restitution: contacts are springs
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

    def contacts(self):
        pairs = np.sort(self.data.contact.geom[: self.data.ncon], axis=1)
        return len(np.unique(pairs, axis=0))


class PyBulletRun:
    """PyBullet on the bodies of a simulation; a plane stands for the ground.

    The engine multiplies the values of two bodies, so each has the root of friction or restitution.
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

    def contacts(self):
        points = self.pybullet.getContactPoints(physicsClientId=self.client) or ()
        return len({(point[1], point[2]) for point in points if point[8] <= 0})  # the distance


# name in the table → package, what makes the run
PEERS = {
    "MuJoCo": ("mujoco", MuJoCoRun),
    "MuJoCo, CG": ("mujoco", functools.partial(MuJoCoRun, solver="cg")),
    "PyBullet": ("pybullet", PyBulletRun),
}


def make_heap(count, folder, seed=1):
    """A scene file of data/scripts/make_pile.py, in `folder`, with the meshes beside it."""
    path = Path(folder) / f"heap_{count}-scene.txt"
    words = [DATA_FOLDER / "scripts" / "make_pile.py", str(count), "--heap", "--seed", str(seed)]
    subprocess.run([sys.executable, *words, "--out", path], check=True)
    for mesh in DATA_FOLDER.glob("*.mesh"):
        shutil.copy(mesh, folder)
    return path


def make_runs(scene, count, material, options):
    """Returns name → run of everything that is asked for."""
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
    """Steps the runs in turns; returns (window, name) → (seconds, contacts of some steps)."""
    kept = {key: ([], []) for key in itertools.product(windows, runs)}
    for step in range(max(window.stop for window in windows)):
        for name, run in runs.items():
            begin = time.perf_counter()
            run.step()
            end = time.perf_counter()
            for window in windows:
                if step in window:
                    seconds, contacts = kept[window, name]
                    seconds.append(end - begin)
                    if step in window[::COUNT_EVERY]:
                        contacts.append(run.contacts())
    return kept


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", nargs="+", type=int, default=[200, 1000, 5000], metavar="N")
    windows = {"nargs": "+", "type": read_window, "default": list(map(read_window, WINDOWS))}
    text = f"steps that are measured (default: {' '.join(WINDOWS)})"
    parser.add_argument("--windows", metavar="K-N", help=text, **windows)
    text = "largest scene for the loop over all pairs (default: %(default)s)"
    parser.add_argument("--all-up-to", type=int, default=1000, metavar="N", help=text)
    peers = {"nargs": "+", "choices": PEERS, "default": [], "metavar": "NAME"}
    parser.add_argument("--peers", help=f"of {', '.join(map(repr, PEERS))}", **peers)
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of the scenes")
    options = parser.parse_args()

    print(f"{describe_machine()}\nmilliseconds, medians (quartiles); steps of {TIME_STEP} s")
    for count, (name, material) in itertools.product(options.sizes, MATERIALS.items()):
        with tempfile.TemporaryDirectory() as folder:
            runs = make_runs(make_heap(count, folder, options.seed), count, material, options)
        print(f"\n{count} bodies, {name}, restitution {material.restitution:g}")
        for (window, run), (seconds, contacts) in measure(runs, options.windows).items():
            where = f"{window.start}-{window.stop} {run:<11}"
            share = f"{np.median(contacts) / count:.2f} contacts a body"
            print(f"  {where} {quartiles(seconds)}; {share}", flush=True)


if __name__ == "__main__":
    main()
