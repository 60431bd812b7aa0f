"""Bodies and runs of the report, and its experiments by name.

An experiment is a function that returns numbers, `{name: number or text}`, for numbers.json. One
that takes an axis draws a panel as well. Units: metres, kilograms, seconds.
"""

import itertools
import math
import sys
import tempfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "byhand"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import engines
from oracles import body

from Quaternion import QConj, QRotate
from rbs.softstep.step import SolverState
from rbs.stepping.settings import SETTINGS
from RBSFunctions import ground as make_ground, run_timestep
from RigidBodySimulation import Settings, Simulation

G, H, E = (SETTINGS[name].default for name in ("gravity", "timeStep", "restitution"))
SUBSTEPS = SETTINGS["substeps"].default
BOX = np.array([12.0, 6.0, 8.0])  # sizes of data/box.mesh
SOFT, AWAKE = ({"contactSolver": "soft-step"} | one for one in ({}, {"sleeping": False}))
BATCHED = {"contactScheduling": "batches"}
RESTING = {"restitution": 0.0, "friction": 0.5}  # of heaps
STEPS = (H, H / 2, H / 4)
throw = engines.throw


class Experiment(NamedTuple):
    function: Callable
    size: tuple | None  # width and height of its panel in cm
    isTimed: bool  # whether it measures time


EXPERIMENTS = {}


def experiment(size=None, isTimed=False):
    """Decorator that registers an experiment; size : (width, height) in cm, if it draws."""

    def register(function):
        EXPERIMENTS[function.__name__] = Experiment(function, size, isTimed)
        return function

    return register


@experiment()
def settings():
    """What the text quotes of the settings."""
    numbers = {"h": H, "e": E, "mu": SETTINGS["friction"].default, "g": G, "substeps": SUBSTEPS}
    return numbers | {"box": " × ".join(f"{side:g}" for side in BOX)}


def box(position, sizes=BOX, **settings):
    return body("box", position, size=np.array(sizes) / BOX, **settings)


def stacked(count):
    return [box((0, BOX[1] * (k + 0.5), 0)) for k in range(count)]


def run(meshes, steps, h=H, e=E, ground=True, **options):
    """Makes steps; yields the `StepReport` of each."""
    if options.get("contactSolver") == "soft-step":
        options["solverState"] = SolverState()
    groundMesh = make_ground() if ground else None
    for _ in range(steps):
        yield run_timestep(meshes, groundMesh, h, e, **options)


def finish(meshes, *arguments, **options):
    """Makes steps, see `run`; returns the meshes."""
    for _ in run(meshes, *arguments, **options):
        pass
    return meshes


NEAR = 0.05  # m, corners that count as touching


def push(mesh, arm, normal, mu, impulse):
    """Stops a corner at an arm; returns the sum of its impulses (3,), which limits its friction."""
    inverse = mesh.get_rotated_inv_IT()
    for isFriction in (False, True):
        u = mesh.linVelocity[0] + np.cross(mesh.angVelocity[0], arm)
        u = u - (u @ normal) * normal if isFriction else (u @ normal) * normal
        turn = np.cross(arm, u)
        own = u @ u * mesh.invMass + turn @ inverse @ turn
        new = impulse - (u * (u @ u) / own if u.any() else 0.0)
        up = new @ normal * normal
        if isFriction:
            size = np.linalg.norm(new - up)
            new = up + (new - up) * min(1.0, mu * np.linalg.norm(up) / max(size, 1e-300))
        elif up @ normal < 0.0:
            new = new - up
        mesh.linVelocity = mesh.linVelocity + mesh.invMass * (new - impulse)
        mesh.angVelocity = mesh.angVelocity + inverse @ np.cross(arm, new - impulse)
        impulse = new
    return impulse


def on_corners(mesh, normal, steps, sweeps, mu=0.0, isFrictionFirst=False, isSummed=False):
    """Makes steps in which each corner of a mesh that touches a plane through the origin gets an
    impulse (e = 0), in sweeps over the corners; isFrictionFirst : whether it moves afterwards;
    isSummed : whether the sum of a corner's impulses limits its friction, not each by itself.
    """
    for _ in range(steps):
        if isFrictionFirst:
            mesh.linVelocity = mesh.linVelocity - [[0.0, G * H, 0.0]]
        else:
            mesh.integrate_timestep(H)
        mesh.position = mesh.position - min(0.0, (mesh.currVertices @ normal).min()) * normal
        arms = (mesh.currVertices - mesh.position)[mesh.currVertices @ normal < NEAR]
        sums = np.zeros((len(arms), 3))
        for k in sweeps * [*range(len(arms))]:
            sums[k] = push(mesh, arms[k], normal, mu, isSummed * sums[k])
        if isFrictionFirst:
            mesh.integrate_timestep(H, (0.0, 0.0, 0.0))
        yield


def scene(name, steps=0, **settings):
    """Returns a Simulation of a scene after so many steps; only given settings differ."""
    return Simulation(name, Settings(**settings), recommended=False).run(steps)


@lru_cache
def heap_file(count):
    """Returns the path of a dense block from make_pile.py, which collapses when released."""
    return engines.heap_file(count, tempfile.mkdtemp())


def heap(count, steps=0, **settings):
    return scene(heap_file(count), steps, **RESTING, **settings)


def tilt_of(mesh):
    """Angle in degrees between a mesh's own y axis and the vertical."""
    up = QRotate(mesh.orientation, np.array([[0.0, 1.0, 0.0]]))[0]
    return math.degrees(math.acos(min(1.0, up[1])))


def energy_of(mesh):
    """Energy in J, kinetic and potential."""
    spin, speed = QRotate(QConj(mesh.orientation), mesh.angVelocity)[0], mesh.linVelocity[0]
    height = float(mesh.position[0, 1])
    return float(spin @ mesh.IT @ spin) / 2 + mesh.mass * (float(speed @ speed) / 2 + G * height)


def overlap_of(meshes):
    """Returns the deepest overlap of neighbours in a stack, and of its foot with the ground."""
    depths = [lower.detect_collision(upper)[1] for lower, upper in itertools.pairwise(meshes)]
    return max(0.0, -meshes[0].currVertices[:, 1].min(), *depths)


def exponent(x, y):
    """Fits p of y ∝ x^p on logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])
