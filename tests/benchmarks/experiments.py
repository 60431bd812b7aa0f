"""Compares experiments with closed forms, with independent predictors, and with other engines.

    python tests/benchmarks/experiments.py [ROW …]

Each line gives the experiment, what is predicted, and what each step does; MuJoCo and PyBullet as
well where they are installed and the experiment suits them. For piles, it gives what the soft step
reaches, and the goal. Penetration is measured on the final poses by the hull of the Minkowski
difference (tests/oracles.py). Lengths are in metres, and a step is 0.02 s unless the row says
otherwise.
"""

import argparse
import copy
import importlib.util
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from engines import MuJoCo, PyBullet, heap_file
from oracles import BOX, body, box_body, ground, penetrations, rotation

from rbs.scenes.scenefiles import load_scene_file
from rbs.softstep.step import SolverState
from rbs.stepping.settings import SETTINGS
from RBSFunctions import run_timestep

G, TIME_STEP, SUBSTEPS = 9.8, 0.02, SETTINGS["substeps"].default
SOFT = {"contactSolver": "soft-step"}
STEPS = {"basic": {}, "soft": SOFT}


def run(meshes, seconds, timeStep=TIME_STEP, e=0.0, before=None, hasGround=True, **settings):
    """Makes steps with friction 0.5 unless it is given; before : called before each step."""
    settings = {"mu": 0.5, "solverState": SolverState(), **settings}
    for k in range(round(seconds / timeStep)):
        if before is not None:
            before(k, settings)
        run_timestep(meshes, ground() if hasGround else None, timeStep, e, **settings)
    return meshes


def tell(what, predicted, **measured):
    values = ", ".join(f"{name} {value:.4g}" for name, value in measured.items())
    print(f"{what:<58} predicted {predicted:<8.4g} {values}", flush=True)


def four_corners(sides, velocity, spin, mu):
    """Displacement (2,) of a box that slides on its four lower corners until it rests.

    Friction opposes the slip of each corner, and its moment about the COM shifts the loads. Of all
    loads in balance, those nearest to a quarter each are taken.
    """
    a, b, c = sides
    corners = 0.5 * np.array([(a, c), (-a, c), (-a, -c), (a, -c)])
    inertia = (a * a + c * c) / 12  # per mass

    def forces(state):
        angle, v, spin = state[2], state[3:5], state[5]
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        arms = corners @ turn.T
        slip = v + spin * np.stack((-arms[:, 1], arms[:, 0]), axis=1)
        direction = -slip / np.maximum(np.linalg.norm(slip, axis=1), 1e-9)[:, None]
        # Σ N = m g, and Σ N (r + (b/2) μ direction) = 0: no moment about horizontal axes
        rows = np.vstack((np.ones(4), (arms + 0.5 * b * mu * direction).T))
        loads = 0.25 * G + np.linalg.pinv(rows) @ (np.array([G, 0, 0]) - rows @ np.full(4, G / 4))
        push = mu * loads[:, None] * direction
        return push.sum(axis=0), (arms[:, 0] * push[:, 1] - arms[:, 1] * push[:, 0]).sum()

    def derivative(_, state):
        push, twist = forces(state)
        return np.concatenate((state[3:6], push, [twist / inertia]))

    def rests(_, state):
        return np.linalg.norm(state[3:5]) + abs(state[5]) - 0.01

    rests.terminal = True
    start = np.array([0, 0, 0, *velocity, spin])
    return solve_ivp(derivative, (0, 20), start, events=rests, max_step=0.002).y[:2, -1]


def slide(sides, velocity, spin, mu, before=None, **settings):
    """Distance that a box slides on the ground; its sides are along x, y and z."""
    mesh = box_body(*sides, (0, sides[1] / 2, 0))
    mesh.linVelocity, mesh.angVelocity = np.array([velocity]), np.array([[0.0, spin, 0.0]])
    run([mesh], 8, mu=mu, before=before, **settings)
    return np.hypot(mesh.position[0, 0], mesh.position[0, 2])


def peers(sides, velocity, spin, mu):
    """The same distance in the other engines that are installed."""
    found = {}
    for make in (MuJoCo, PyBullet):
        if importlib.util.find_spec(make.__name__.lower()):
            mesh = box_body(*sides, (0, sides[1] / 2, 0))
            mesh.linVelocity, mesh.angVelocity = np.array([velocity]), np.array([[0.0, spin, 0.0]])
            engine = make([mesh], mu, 0.0)
            for _ in range(round(8 / TIME_STEP)):
                engine.step()
            engine.read()
            found[make.__name__] = np.hypot(mesh.position[0, 0], mesh.position[0, 2])
    return found


def slides():
    square, long = (1.0, 0.5, 1.0), (2.0, 0.5, 1.0)
    cases = [(square, (3.0, 0.0, 0.0), spin) for spin in (0.0, 5.0, 10.0, 20.0)]
    cases += [(square, (3 * np.cos(a), 0.0, 3 * np.sin(a)), 10.0) for a in np.radians((30, 45))]
    # a blow of 3 m/s across the long side, 0.25 and 0.5 m off the centre
    cases += [(long, (0.0, 0.0, 3.0), -3.0 * arm / (5 / 12)) for arm in (0.25, 0.5)]
    for sides, velocity, spin in cases:
        x, _, z = velocity
        # the predictor's plane has the axes z and x, so that its turns are those about y
        turned = sides[2], sides[1], sides[0]
        predicted = np.hypot(*four_corners(turned, (z, x), spin, 0.3))
        ours = {n: slide(sides, velocity, spin, 0.3, **s) for n, s in STEPS.items()}
        text = f"slide: {sides[0]:g} wide, ({x:.3g}, {z:.3g}) m/s, {spin:.3g} rad/s, mu 0.3"
        tell(text, predicted, **ours, **peers(sides, velocity, spin, 0.3))


def disturbances():
    """Name → (function of the step, settings) of what should wake a box that sleeps after 2 s."""

    def tilt(k, settings):
        angle = np.radians(min(max(k - 100, 0) * 0.1, 31.0))
        settings["gravity"] = (G * np.sin(angle), -G * np.cos(angle), 0.0)

    def tilted(k, settings):
        settings["gravity"] = (G * np.sin(0.35), -G * np.cos(0.35), 0.0)
        settings["mu"] = 1.0 if k < 100 else 0.0

    return {"gravity tilted by 0.1° a step to 31°, mu 0.5": tilt, "mu 1 to 0 at 20°": tilted}


def tilted_distance(name, sleeping):
    """Distance of a box of 1 m after 10 s."""
    mesh = box_body(1, 1, 1, (0, 0.5, 0))
    run([mesh], 10, before=disturbances()[name], sleeping=sleeping, **SOFT)
    return mesh.position[0, 0]


def pushed_speed(share, sleeping):
    """Speed after 4 s of a box without friction that is pushed with `share` of g from 2 s on."""
    mesh = box_body(1, 1, 1, (0, 0.5, 0))

    def push(k, settings):
        if k >= 100:
            mesh.linVelocity = mesh.linVelocity + [[share * G * TIME_STEP, 0.0, 0.0]]

    run([mesh], 4, before=push, sleeping=sleeping, mu=0.0, **SOFT)
    return mesh.linVelocity[0, 0]


def hanging_fall():
    """How far a box that hung for 3 s falls within 0.5 s once its ties are removed."""
    meshes = [box_body(1, 1, 1, (0, 10, 0), isFixed=True), box_body(1, 1, 1, (0, 8, 0))]
    upper = np.flatnonzero(meshes[1].origVertices[:, 1] > 0)
    lower = np.flatnonzero(meshes[0].origVertices[:, 1] < 0)
    ties = [[0, a, 1, b, 1.0, True] for a, b in zip(lower, upper, strict=True)]
    start = []

    def remove(k, settings):
        settings["constraints"] = ties if k < 150 else []
        if k == 150:
            start.append(meshes[1].position[0, 1])

    run(meshes, 3.5, before=remove, **SOFT)
    return start[0] - meshes[1].position[0, 1]


def sleepers():
    for name in disturbances():
        awake, asleep = (tilted_distance(name, sleeping) for sleeping in (False, True))
        tell(f"slept on: {name}, distance", awake, soft=asleep)
    tell("slept on: pushed by 0.05 g for 2 s, mu 0, speed", 0.1 * G, soft=pushed_speed(0.05, True))
    fall = G * (TIME_STEP / 6) ** 2 * 150 * 151 / 2  # of semi-implicit Euler in six substeps
    tell("slept on: tie removed, fall in 0.5 s", fall, soft=hanging_fall())
    tell("slept on: weight on the ground's contacts, of m g", 1.0, soft=resting_weight())


def resting_weight(steps=100):
    """The ground's push on two stacked, sleeping boxes, as a fraction of their weight."""
    meshes = [box_body(1, 1, 1, (0, 0.5 + k, 0)) for k in range(2)]
    settings = {"mu": 0.5, "solverState": SolverState(), **SOFT}
    for _ in range(steps):
        report = run_timestep(meshes, ground(), TIME_STEP, 0.0, **settings)
    assert report.isAsleep.all()
    push = sum(c.impulse for c in report.contacts if c.body2 < 0)
    return push / TIME_STEP / (2 * meshes[0].mass * G)


# What is predicted. A rider slides until it has the speed of the belt: v t - v²/(2 μ g).
CARRIED = dict.fromkeys(("conveyor", "belt that stays"), 2 * 0.5 - 0.25 / (2 * 0.5 * G))
CARRIED |= {"turntable": np.degrees(1.0), "paddle": 2.0, "paddle, by position": 2.0}


def carried(kind, settings):
    """Effect of a fixed body with a velocity on one that it touches, after 2 s."""
    if kind in ("conveyor", "belt that stays"):
        stays = kind != "conveyor"
        belt = box_body(4 if stays else 20, 1, 4, (0, 0.5, 0), isFixed=True)
        belt.linVelocity = np.array([[0.5, 0.0, 0.0]])
        start = belt.position.copy()
        rider = box_body(1, 0.5, 1, (0, 1.25, 0))

        def put_back(*_):
            belt.position = start

        run([belt, rider], 2, before=put_back if stays else None, **settings)
        return rider.position[0, 0]
    if kind == "turntable":
        floor = box_body(6, 1, 6, (0, 0.5, 0), isFixed=True)
        floor.angVelocity = np.array([[0.0, 0.5, 0.0]])
        rider = box_body(1, 0.5, 1, (1.5, 1.25, 0))
        rider.linVelocity, rider.angVelocity = np.array([[0.0, 0.0, -0.75]]), floor.angVelocity
        run([floor, rider], 2, **settings)
        return np.degrees(np.arctan2(-rider.position[0, 2], rider.position[0, 0]))
    paddle = box_body(0.2, 4, 4, (-1, 2, 0), isFixed=True)
    paddle.linVelocity = np.array([[1.0, 0.0, 0.0]])
    if kind == "paddle, by position":
        paddle.linVelocity[:] = 0.0
    ball = box_body(0.5, 0.5, 0.5, (0, 2, 0))

    def move(_, settings):
        if kind == "paddle, by position":
            paddle.position = paddle.position + [[TIME_STEP, 0.0, 0.0]]

    run([paddle, ball], 2, before=move, hasGround=False, gravity=(0, 0, 0), e=1.0, **settings)
    return ball.linVelocity[0, 0]


def carriers():
    for kind, predicted in CARRIED.items():
        found = {name: carried(kind, settings) for name, settings in STEPS.items()}
        tell(f"carried: {kind}, 2 s, m or degrees or m/s", predicted, **found)


def row_energy(count, gap, settings, timeStep=0.01):
    """Energies of a row's last body and of all, relative to that of the first, which hits it."""
    meshes = [box_body(1, 1, 1, (0, 0, 0)) for _ in range(count)]
    for k, mesh in enumerate(meshes):
        mesh.position = np.array([[(1.0 + gap) * k if k else -0.5, 0.0, 0.0]])
    meshes[0].linVelocity = np.array([[1.0, 0.0, 0.0]])
    seconds = 1.0 + gap * count
    run(meshes, seconds, timeStep, 1.0, hasGround=False, gravity=(0, 0, 0), mu=0.0, **settings)
    energies = np.array([(m.linVelocity**2).sum() for m in meshes])
    return energies[-1], energies.sum()


def elastic():
    for count in (5, 7, 9):
        for gap in (0.0, 1e-4, 1e-3, 0.05):
            found = {n: row_energy(count, gap, s)[0] for n, s in STEPS.items()}
            tell(f"elastic: {count} cubes {1e3 * gap:g} mm apart, energy of the last", 1, **found)


def plastic_rest(settings, height=1.5):
    """Fraction of the speed that a cube keeps as it lands flat with e = 0, and its largest spin."""
    mesh = box_body(1, 1, 1, (0, height, 0))
    speeds = []

    def watch(k, _):
        speeds.append((abs(mesh.linVelocity[0, 1]), np.linalg.norm(mesh.angVelocity)))

    run([mesh], 0.6, before=watch, e=0.0, **settings)
    speeds = np.array(speeds)
    hit = speeds[:, 0].argmax() + 1
    return speeds[hit, 0] / speeds[hit - 1, 0], speeds[hit:, 1].max()


def plastic():
    found = {name: plastic_rest(settings) for name, settings in STEPS.items()}
    tell("landing, e 0: part of the speed left", 0, **{n: v[0] for n, v in found.items()})
    tell("landing, e 0: largest spin, rad/s", 0, **{n: v[1] for n, v in found.items()})


SPINNER, SPIN = (1.0, 0.2, 0.5), np.array([0.01, 0.01, 5.0])  # about the middle axis


def tumbling_ode(inertia, seconds):
    """Times at which the body's middle axis turns over, by Euler's equation in body axes."""

    def derivative(_, w):
        return -np.linalg.solve(inertia, np.cross(w, inertia @ w))

    def flip(_, w):
        return w[2]

    found = solve_ivp(derivative, (0, seconds), SPIN, events=flip, rtol=1e-11, atol=1e-12)
    return found.t_events[0]


def tumbling(settings, seconds=60.0, timeStep=TIME_STEP):
    """(largest relative change of |L|, that of the energy, times of flips)."""
    mesh = box_body(*SPINNER, (0, 0, 0))
    mesh.angVelocity = SPIN[None].copy()
    track, middle = [], []

    def watch(*_):
        turn = rotation(mesh.orientation[0]).as_matrix()
        momentum = turn @ mesh.IT @ turn.T @ mesh.angVelocity[0]
        track.append((*momentum, mesh.angVelocity[0] @ momentum))
        middle.append((turn.T @ mesh.angVelocity[0])[2])

    settings = {"gyroscopic": True, "hasGround": False, "gravity": (0, 0, 0), **settings}
    run([mesh], seconds, timeStep, before=watch, **settings)
    track, middle = np.array(track), np.array(middle)
    change = np.linalg.norm(track[:, :3] - track[0, :3], axis=1) / np.linalg.norm(track[0, :3])
    k = np.flatnonzero(middle[:-1] * middle[1:] < 0)
    flips = timeStep * (k + middle[k] / (middle[k] - middle[k + 1]))
    return change.max(), np.abs(track[:, 3] / track[0, 3] - 1).max(), flips


def spins():
    flips = tumbling_ode(box_body(*SPINNER, (0, 0, 0)).IT, 60.0)
    steps = {**STEPS, "batches": {"contactScheduling": "batches"}}
    found = {name: tumbling(settings) for name, settings in steps.items()}
    tell("tumbling 60 s: largest relative change of L", 0, **{n: v[0] for n, v in found.items()})
    tell("tumbling 60 s: of the energy", 0, **{n: v[1] for n, v in found.items()})
    tell("tumbling 60 s: flips", len(flips), **{n: len(v[2]) for n, v in found.items()})
    first = {n: v[2][0] for n, v in found.items()}
    tell("tumbling 60 s: first flip, s", flips[0], **first)


def sizes():
    for size in (0.003, 0.004, 0.01, 0.1):
        found = {}
        for name, settings in STEPS.items():
            mesh = box_body(size, size, size, (0, 0.75 * size, 0))
            run([mesh], 2, **settings)
            found[name] = -mesh.currVertices[:, 1].min() / size
        tell(f"cube of {1e3 * size:g} mm on the ground: depth, of its size", 0, **found)
        found = {}
        for name, settings in STEPS.items():
            cubes = [box_body(size, size, size, (0, (0.55 + 1.05 * k) * size, 0)) for k in range(4)]
            run(cubes, 4, **settings)
            found[name] = penetrations(cubes).max(initial=0.0) / size
        tell(f"four cubes of {1e3 * size:g} mm in a stack: overlap, of their size", 0, **found)


def swing_energy(settings, seconds=30.0):
    """Fraction of its energy that a pendulum of 10° has left at the end."""
    length, angle = 2.0, np.radians(10)
    anchor, bob = box_body(1, 1, 1, (0, 10, 0), isFixed=True), box_body(0.2, 0.2, 0.2, (0, 0, 0))
    corner = int(anchor.origVertices.sum(axis=1).argmin())
    tip = int(bob.origVertices.sum(axis=1).argmax())
    point, arm = anchor.currVertices[corner], bob.origVertices[tip]
    string = np.array([-np.sin(angle), np.cos(angle), 0.0])  # from the bob to the point
    turn, _ = Rotation.align_vectors([string], [arm])
    bob.orientation = turn.as_quat()[None, [3, 0, 1, 2]]
    reach = length + np.linalg.norm(arm)
    bob.position = (point - reach * string)[None]
    low, energies = point[1] - reach, []

    def watch(*_):
        height = bob.position[0, 1] - low
        energies.append(0.5 * (bob.linVelocity**2).sum() + G * height)

    tie = [[0, corner, 1, tip, length, upper] for upper in (True, False)]
    run([anchor, bob], seconds, before=watch, constraints=tie, **settings)
    return np.mean(energies[-100:]) / np.mean(energies[:100])


def pendulum():
    found = {name: swing_energy(settings) for name, settings in STEPS.items()}
    tell("pendulum of 10°: energy left after 30 s", 1, **found)


def twists():
    found = {}
    for name, settings in STEPS.items():
        mesh = box_body(2, 2, 2, (0, 3, 0))
        mesh.angVelocity = np.array([[0.0, 10.0, 0.0]])
        run([box_body(10, 2, 10, (0, 1, 0), isFixed=True), mesh], 4.0, **settings)
        found[name] = np.linalg.norm(mesh.angVelocity)
    tell("box that turns flat on another at 10 rad/s, 4 s: spin left", 0, **found)


class Pile:
    """Meshes with the soft-step solver and its state: friction 0.5, and no restitution or sleep.

    Boxes are those of data/box.mesh, or cubes with sides of 2.
    """

    def __init__(self, meshes, **settings):
        self.meshes, self.state = meshes, SolverState()
        self.settings = {"contactSolver": "soft-step", "mu": 0.5, "sleeping": False, **settings}
        self.start = self.positions()

    def run(self, steps):
        """Makes steps; returns the seconds of processor time of each."""
        seconds = []
        for _ in range(steps):
            begin = time.process_time()
            run_timestep(self.meshes, ground(), 0.02, 0.0, solverState=self.state, **self.settings)
            seconds.append(time.process_time() - begin)
        return np.array(seconds)

    def positions(self):
        return np.array([m.position[0] for m in self.meshes])

    def speeds(self):
        return np.linalg.norm([m.linVelocity[0] for m in self.meshes], axis=1)

    def tell(self, what, asked):
        """Prints how far the bodies have drifted and sunk, and how fast they are."""
        moved, speed = self.positions() - self.start, self.speeds().max()
        drift, sinks = np.hypot(*moved[:, [0, 2]].T).max(), -moved[:, 1].min()
        tell_goal(what, f"drift {drift:.4f}, sinks {sinks:.3f}, speed {speed:.2g}", asked)


def tell_goal(what, measured, goal):
    print(f"{what:<58} {measured}; to reach: {goal}", flush=True)


def stack():
    kinds = {"boxes": (6, BOX), "cubes": (2, (2, 2, 2))}
    for count, asked in ((10, "drift 0.01"), (20, "drift 0.02"), (40, "drift 0.1")):
        for name, (height, sides) in kinds.items():
            substeps = 20 if (count, name) == (40, "cubes") else SUBSTEPS
            boxes = [box_body(*sides, (0, (i + 0.5) * height, 0)) for i in range(count)]
            pile = Pile(boxes, substeps=substeps)
            pile.run(2000)
            pile.tell(f"stack of {count} {name}, {substeps} substeps", f"{asked}, speed 0.02")


def pyramid():
    for rows, asked in ((15, 1e-3), (30, 5e-3)):
        places = [(c - (rows - 1 - r) / 2, r) for r in range(rows) for c in range(rows - r)]
        pile = Pile([body("box", (12.2 * x, 3 + 6 * r, 0)) for x, r in places])
        pile.run(1000)
        pile.tell(f"pyramid of {rows} rows, 1000 steps", f"speed {asked:g}")


def masses():
    light = [box_body(2, 2, 2, (x, 1, z)) for x in (-2, 2) for z in (-2, 2)]
    pile = Pile([*light, box_body(6, 2, 6, (0, 3, 0), density=400 * 8 / 72)])
    pile.run(1000)
    pile.tell("one of 100 times their mass on four cubes", "sinks 0.15, rests")
    for name, height, sides, substeps in (("boxes", 6, BOX, SUBSTEPS), ("cubes", 2, (2, 2, 2), 20)):
        places = [(0, (i + 0.5) * height, 0) for i in range(4)]
        boxes = [box_body(*sides, p, density=10.0**i) for i, p in enumerate(places)]
        pile = Pile(boxes, substeps=substeps)
        pile.run(1000)
        pile.tell(f"{name} of density 1 to 1000, {substeps} substeps", "stands")


def heap(count=1000):
    with tempfile.TemporaryDirectory() as folder:
        meshes = load_scene_file(heap_file(count, folder))
    pile = Pile(meshes)
    for steps, asked in ((600, "speed 0.01, p95 0.012, max 0.06"), (400, "speed 0.001")):
        seconds = pile.run(steps)
        depths = penetrations(meshes)
        speed, p95 = np.median(pile.speeds()), np.percentile(depths, 95)
        measured = f"median speed {speed:.4f}, penetration p95 {p95:.4f}, max {depths.max():.4f}"
        milliseconds = 1e3 * np.median(seconds[-50:])
        tell_goal(f"heap of {count}, {steps} steps", f"{measured}, {milliseconds:.1f} ms", asked)


def asleep(count=1000, seeds=(4, 3, 2, 1)):
    shares = []
    for seed in seeds:
        with tempfile.TemporaryDirectory() as folder:
            meshes = load_scene_file(heap_file(count, folder, seed))
        pile = Pile(meshes)
        pile.run(600)
        pile.settings["sleeping"] = True
        pile.run(500)
        shares.append(100 * pile.state.sleep.isAsleep.mean())
    # the last heap's state without sleeping, in turns
    awake = Pile([copy.copy(mesh) for mesh in meshes])
    awake.state = SolverState.from_arrays(pile.state.arrays())
    seconds = np.array([(pile.run(1)[0], awake.run(1)[0]) for _ in range(100)])
    sleeping, awake = np.median(seconds[10:], axis=0)
    single = ", ".join(f"{share:.1f}" for share in shares)
    share = f"{np.mean(shares):.1f} % ({single})"
    measured = f"{share}, a step takes {sleeping / awake:.2f} of one awake"
    tell_goal(f"{len(seeds)} heaps of {count} asleep 10 s after step 600", measured, "95 %, 0.3")


ROWS = {f.__name__: f for f in (slides, sleepers, carriers, elastic, plastic, spins)}
ROWS |= {f.__name__: f for f in (sizes, pendulum, twists, stack, pyramid, masses, heap, asleep)}


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("rows", metavar="ROW", nargs="*", choices=[[], *ROWS], help=", ".join(ROWS))
    for name in parser.parse_args().rows or ROWS:
        ROWS[name]()


if __name__ == "__main__":
    main()
