"""This program's steps, MuJoCo and PyBullet on the same bodies, and what a step of a heap takes.

Heaps are those of make_pile.py, with friction 0.5, restitution 0 and steps of 0.02 s. All engines
start from one state of the soft step, without its impulses, and no body sleeps. They take turns, so
that a busy machine is busy for all of them. Prints medians of processor time, and ratios. MuJoCo
and PyBullet take part where they are installed (`pip install mujoco pybullet`).
"""

import copy
import itertools
import json
import math
import shutil
import subprocess
import sys
import tempfile
import time
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from benchmark import describe_machine
from oracles import ground, rotation

from rbs.geometry.broadphase import grid_overlaps
from rbs.scenes.scenefiles import DATA_FOLDER, load_scene_file
from rbs.softstep.step import SolverState
from RBSFunctions import run_timestep

TIME_STEP, EARTH = 0.02, (0.0, -9.8, 0.0)


def throw(mesh, velocity=(0, 0, 0), spin=(0, 0, 0)):
    mesh.linVelocity, mesh.angVelocity = np.array([velocity], float), np.array([spin], float)
    return mesh


class Own:
    """This program: takes the settings of `run_timestep`."""

    def __init__(self, meshes, mu, restitution, h=TIME_STEP, gravity=EARTH, hasGround=True, **more):
        """more : other settings"""
        self.meshes, self.ground = meshes, ground() if hasGround else None
        self.arguments = h, restitution
        self.settings = {"mu": mu, "gravity": gravity, "solverState": SolverState(), **more}

    def step(self):
        self.report = run_timestep(self.meshes, self.ground, *self.arguments, **self.settings)

    def read(self):
        """Writes the state into the meshes. Here it is there."""


class MuJoCo:
    """MuJoCo; a plane stands for the ground.

    It takes the greater friction of two geoms. It has no restitution: contacts are damped springs.
    """

    def __init__(
        self, meshes, mu, _=0.0, h=TIME_STEP, gravity=EARTH, hasGround=True, solver="newton"
    ):
        """solver : "newton", MuJoCo's default, or "cg" """
        import mujoco

        self.mujoco, self.meshes = mujoco, meshes
        spec = mujoco.MjSpec()
        spec.option.timestep, spec.option.gravity = h, gravity
        spec.option.solver = getattr(mujoco.mjtSolver, f"mjSOL_{solver.upper()}")
        # left to itself, MuJoCo asks for more memory than there is from some thousand bodies on
        spec.memory = max(2**30, len(meshes) * 2**18)
        # a normal alone, or with two directions to slide in; no friction of torsion or rolling
        surface = {"condim": 3, "friction": (mu, 0, 0)} if mu else {"condim": 1}
        if hasGround:  # the plane's normal is its z axis: turned to y
            level = {"size": (1, 1, 1), "quat": (math.sqrt(0.5), -math.sqrt(0.5), 0, 0)}
            spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, **level, **surface)
        for name, hull in {str(id(mesh.hull)): mesh.hull for mesh in meshes}.items():
            spec.add_mesh(name=name, uservert=hull.vertices.ravel())
        for mesh in meshes:
            body = spec.worldbody.add_body(pos=mesh.position[0], quat=mesh.orientation[0])
            if not mesh.isFixed:
                body.add_freejoint()
            shape = {"meshname": str(id(mesh.hull)), "density": mesh.density}
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, **shape, **surface)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        for mesh, pose, speed in self._rows():  # a free joint turns in the body's frame
            speed[:] = *mesh.linVelocity[0], *rotation(pose[3:]).inv().apply(mesh.angVelocity[0])

    def _rows(self):
        """Yields (mesh, pose (7,), velocities (6,)) of each body that moves."""
        moving = [mesh for mesh in self.meshes if not mesh.isFixed]
        poses, speeds = self.data.qpos.reshape(-1, 7), self.data.qvel.reshape(-1, 6)
        return zip(moving, poses, speeds, strict=True)

    def step(self):
        self.mujoco.mj_step(self.model, self.data)

    def read(self):
        for mesh, pose, speed in self._rows():
            mesh.position, mesh.orientation = pose[None, :3].copy(), pose[None, 3:].copy()
            mesh.linVelocity = speed[None, :3].copy()
            mesh.angVelocity = rotation(pose[3:]).apply(speed[None, 3:])


class PyBullet:
    """PyBullet; a plane stands for the ground.

    The engine multiplies the values of two bodies, so each has the root of friction or restitution.
    """

    def __init__(self, meshes, mu, restitution, h=TIME_STEP, gravity=EARTH, hasGround=True):
        import pybullet

        self.pybullet, self.meshes, self.bodies = pybullet, meshes, []
        self.here = here = {"physicsClientId": pybullet.connect(pybullet.DIRECT)}
        pybullet.setTimeStep(h, **here)
        pybullet.setGravity(*gravity, **here)
        surface = {"lateralFriction": math.sqrt(mu), "restitution": math.sqrt(restitution)}
        make = partial(pybullet.createCollisionShape, **here)
        if hasGround:
            plane = make(pybullet.GEOM_PLANE, planeNormal=(0, 1, 0))
            level = pybullet.createMultiBody(0, plane, **here)
            pybullet.changeDynamics(level, -1, **surface, **here)
        shapes = {}
        for mesh in meshes:
            if id(mesh.hull) not in shapes:
                vertices = mesh.hull.vertices.tolist()
                shapes[id(mesh.hull)] = make(pybullet.GEOM_MESH, vertices=vertices)
            w, *xyz = mesh.orientation[0].tolist()
            mass = 0.0 if mesh.isFixed else mesh.mass
            row = mass, shapes[id(mesh.hull)], -1, mesh.position[0].tolist(), (*xyz, w)
            self.bodies.append(pybullet.createMultiBody(*row, useMaximalCoordinates=1, **here))
            pybullet.changeDynamics(self.bodies[-1], -1, **surface, **here)
            velocity = mesh.linVelocity[0].tolist(), mesh.angVelocity[0].tolist()
            pybullet.resetBaseVelocity(self.bodies[-1], *velocity, **here)

    def step(self):
        self.pybullet.stepSimulation(**self.here)

    def read(self):
        for mesh, body in zip(self.meshes, self.bodies, strict=True):
            place, (*xyz, w) = self.pybullet.getBasePositionAndOrientation(body, **self.here)
            speeds = self.pybullet.getBaseVelocity(body, **self.here)
            mesh.position, mesh.orientation = np.array([place]), np.array([(w, *xyz)])
            mesh.linVelocity, mesh.angVelocity = (np.array([speed]) for speed in speeds)


OWN = {
    "basic step": Own,
    "batches": partial(Own, contactScheduling="batches"),
    "soft step": partial(Own, contactSolver="soft-step"),
}
PEERS = {"MuJoCo": MuJoCo, "MuJoCo, CG": partial(MuJoCo, solver="cg"), "PyBullet": PyBullet}
ENGINES = OWN | {
    name: make for name, make in PEERS.items() if find_spec(name.split(",")[0].lower())
}


def heap_file(count, folder, seed=1):
    """A scene file of data/scripts/make_pile.py, in `folder`, with the meshes beside it."""
    path = Path(folder) / f"heap_{count}-scene.txt"
    words = [DATA_FOLDER / "scripts" / "make_pile.py", str(count), "--heap", "--seed", str(seed)]
    subprocess.run([sys.executable, *words, "--out", path], check=True)
    for mesh in DATA_FOLDER.glob("*.mesh"):
        shutil.copy(mesh, folder)
    return path


# steps after which a heap is free, collapses, has settled, and rests
REGIMES = {"free": 10, "collapse": 150, "settled": 600, "rest": 1000}


def heap_states(count, regimes=REGIMES, seed=1, sleeping=False):
    """Yields (regime, meshes) of a heap in the soft step."""
    with tempfile.TemporaryDirectory() as folder:
        meshes = load_scene_file(heap_file(count, folder, seed))
    world, done = OWN["soft step"](meshes, 0.5, 0.0, sleeping=sleeping), 0
    for regime in regimes:
        for _ in range(REGIMES[regime] - done):
            world.step()
        done = REGIMES[regime]
        yield regime, meshes


def started(meshes, names=ENGINES, sleeping=False):
    """Returns name → engine, each with its own copies of the bodies of a heap."""
    awake = {"soft step": {"sleeping": sleeping}}
    return {
        name: ENGINES[name]([copy.copy(mesh) for mesh in meshes], 0.5, 0.0, **awake.get(name, {}))
        for name in names
    }


TURN = 5  # steps


def in_turns(runs, turns):
    """Steps runs in turns; returns name → milliseconds of processor time of each step (n,).

    A turn has TURN steps after one that does not count, as it finds another's data in the caches.
    """
    times = {name: [] for name in runs}
    for _ in range(turns):
        for name, one in runs.items():
            one.step()
            for _ in range(TURN):
                begin = time.process_time()
                one.step()
                times[name].append(1e3 * (time.process_time() - begin))
    return {name: np.array(values) for name, values in times.items()}


KEYS = {"batches": "batches", "soft": "soft step", "cg": "MuJoCo, CG", "bullet": "PyBullet"}
NEWTON = {"newton": "MuJoCo"}
SIZES, MIDDLE = (200, 1000, 5000), 1000  # bodies
LOOKS, FEW = 25, 4  # turns with MIDDLE bodies at rest, and with others
DROWSY = 100  # steps within which all falls asleep that can


def deepest(engine):
    """Deepest overlap in cm of an engine's bodies."""
    engine.read()
    meshes = engine.meshes
    low, high = np.split(np.array([mesh.bounding_box() for mesh in meshes]), 2, axis=1)
    near = grid_overlaps(np.concatenate([low, -high], axis=1).T)
    depths = [meshes[a].detect_collision(meshes[b])[1] for a, b in near.T.tolist()]
    return 100 * max(0.0, -low[:, 1].min(), *depths)


def compare(meshes, isQuiet):
    """Milliseconds of a step of each engine from one state, medians, and ratios. If isQuiet, also
    the deepest overlap in cm in LOOKS turns, and the soft step with sleepers.
    """
    names = KEYS | NEWTON if len(meshes) == MIDDLE else KEYS
    runs = dict(zip(names, started(meshes, names.values()).values(), strict=True))
    if isQuiet:
        (runs["asleep"],) = started(meshes, ["soft step"], sleeping=True).values()
        for _ in range(DROWSY):
            runs["asleep"].step()
    times, numbers = {key: [] for key in runs}, {}
    for look in range(LOOKS if isQuiet else FEW):
        if look == FEW:
            runs.pop("newton")  # a second a step
        for key, values in in_turns(runs, 1).items():
            times[key] += values.tolist()
            if isQuiet:
                numbers[f"{key}Most"] = max(numbers.get(f"{key}Most", 0.0), deepest(runs[key]))
    numbers |= {key: float(np.median(values)) for key, values in times.items()}
    for own, peer in itertools.product(("soft", "asleep"), ("cg", "bullet")):
        if own in runs:
            numbers[f"{own}To{peer.title()}"] = numbers[own] / numbers[peer]
    if isQuiet:
        numbers["sleepers"] = 100 * float(runs["asleep"].report.isAsleep.mean())
    return numbers


def measured(sizes=SIZES, seed=1):
    """Returns {"steps": looked at, state: {"n<bodies>": see `compare`}}."""
    states = {"free": {}, "collapse": {}, "rest": {}}
    for count in sizes:
        for state, meshes in heap_states(count, states, seed, sleeping=True):
            states[state][f"n{count}"] = compare(meshes, (count, state) == (MIDDLE, "rest"))
    return {"steps": (TURN + 1) * LOOKS} | states


def main(options):
    print(describe_machine())
    print(json.dumps(measured(options.sizes, options.seed), indent=1))
