"""Compares experiments with closed forms, with independent predictors, and with other engines.

Prints the rows of experiments.txt: what is due, and what the soft step and the basic step give;
MuJoCo and PyBullet as well, where they are installed and the experiment suits them. Lengths are in
metres; friction is 0.5, restitution 0, a time step 0.02 s and the density 1, unless the row says
otherwise. Tests hold the soft step to the rows with a tolerance.
"""

import copy
import itertools
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from benchmark import describe_machine
from engines import ENGINES, OWN, TIME_STEP, heap_states, throw
from oracles import DATA, body, box_body, penetrations, quaternion, random_quaternions, rotation
from scipy.integrate import quad, solve_ivp
from scipy.spatial.transform import Rotation

from rbs.scenes.messages import InputError
from RigidBodySimulation import load_scene_file, shapes

G = 9.8
UNIT = (1.0, 1.0, 1.0)
FREE = {"gravity": (0, 0, 0), "hasGround": False}
HANGING = {"hasGround": False, "sleeping": False}


class UnsuitedError(Exception):
    """The engine has no such thing."""


def run(engine, meshes, seconds, h=TIME_STEP, e=0.0, mu=0.5, act=None, watch=None, **settings):
    """Makes steps; returns (the engine, an array with what watch() gave after each step).

    act(k, world) : called before step k, may change all
    """
    peer, track = engine not in OWN, []
    if peer:
        moves = any(m.isFixed and (m.linVelocity.any() or m.angVelocity.any()) for m in meshes)
        isPushed = any(m.load for m in meshes)
        if act or moves or isPushed or "constraints" in settings or (e and engine == "MuJoCo"):
            raise UnsuitedError
        settings = {name: settings[name] for name in FREE if name in settings}
    elif engine != "soft step":
        settings = {k: v for k, v in settings.items() if k not in ("sleeping", "substeps")}
    world = ENGINES[engine](meshes, mu, e, h, **settings)
    for k in range(round(seconds / h)):
        if act is not None:
            act(k, world)
        world.step()
        if watch is not None:
            world.read()
            track.append(watch())
    world.read()
    return world, np.array(track)


def box(x=0.0, y=0.5, z=0.0, sides=UNIT, **settings):
    return box_body(*sides, (x, y, z), **settings)


def above(mesh, gap=0.0):
    """The mesh, moved so that its lowest vertex is `gap` above the ground."""
    mesh.position = mesh.position + [[0.0, gap - mesh.currVertices[:, 1].min(), 0.0]]
    return mesh


def in_lanes(*worlds, width=40.0):
    """All bodies of these lists in one list, each list in a lane of its own along x."""
    for k, mesh in ((k, mesh) for k, meshes in enumerate(worlds) for mesh in meshes):
        mesh.position = mesh.position + (0, 0, width * k)
    return [mesh for meshes in worlds for mesh in meshes]


def linked_in_lanes(*worlds):
    """`(meshes, constraints)` of such pairs, each in a lane of its own."""
    ties, first = [], 0
    for meshes, own in worlds:
        ties += [[a + first, i, b + first, *ends] for a, i, b, *ends in own]
        first += len(meshes)
    return in_lanes(*(meshes for meshes, _ in worlds)), ties


def farthest(mesh, way):
    """The index of the vertex of a mesh that is farthest along a direction (3,), at rest."""
    return int((mesh.origVertices @ way).argmax())


def nearest(mesh, point):
    """The index of the vertex of a mesh that is nearest to a point (3,) or (1, 3)."""
    return int(np.linalg.norm(mesh.currVertices - point, axis=1).argmin())


def kinetic(meshes):
    total = 0.0
    for mesh in (mesh for mesh in meshes if not mesh.isFixed):
        spin = rotation(mesh.orientation[0]).inv().apply(mesh.angVelocity[0])
        total += 0.5 * (mesh.mass * (mesh.linVelocity**2).sum() + spin @ mesh.IT @ spin)
    return total


def energy(meshes):
    """The kinetic energy, and the potential energy above y = 0."""
    return kinetic(meshes) + G * sum(m.mass * m.position[0, 1] for m in meshes if not m.isFixed)


def top_speed(meshes):
    return max(np.linalg.norm(mesh.linVelocity) for mesh in meshes)


# What slides over flush blocks


def tiles(width=2.0, depth=2.0, rows=3, uneven=0.0, turn=0.0, count=9, isFixed=True):
    """Blocks of height 1 below y = 0 from x = -3 on, or lower by up to `uneven`."""
    q, rng, meshes = quaternion((0, 1, 0), turn), np.random.default_rng(1), []
    for k, r in itertools.product(range(count), range(rows)):
        place = -3 + (k + 0.5) * width, -0.5 - uneven * rng.random(), (r - rows // 2) * depth
        place, settings = rotation(q).apply(place), {"orientation": q, "isFixed": isFixed}
        meshes.append(box(*place, (width, 1, depth), **settings))
    return meshes


FLOORS = {
    "tiles": lambda: tiles(depth=4.0),
    "slab": lambda: [box(0, -0.5, 0, (60, 1, 8), isFixed=True)],
    "wall": lambda: (
        tiles(depth=4.0) + [box(1.5 * k, 1, 1, (1.5, 2, 1), isFixed=True) for k in range(-2, 18)]
    ),
    "free row": lambda: tiles(1.0, 4.0, rows=1, count=14, isFixed=False),
}
CORNERS = 0.6 * np.vstack((np.eye(3), -np.eye(3)))
ON_A_FACE = Rotation.align_vectors([[0, -1, 0]], [[1, 1, 1]])[0].as_quat()[[3, 0, 1, 2]]
MOVERS = {
    "box": box,
    "turned box": lambda: box(orientation=quaternion((0, 1, 0), 30)),
    "slab": lambda: box(y=0.1, sides=(2, 0.2, 1)),
    "ball": lambda: above(shapes.sphere(0.5, 1.0)),
    "octahedron": lambda: above(shapes.convex_hull(CORNERS, 1.0, orientation=ON_A_FACE)),
}


def crossing(engine, mover, speed, floor="tiles", seconds=4.0, mu=0.0, **settings):
    """Way of a body over a floor, of that at constant speed, and its lift in mm."""
    meshes, mover = FLOORS[floor](), throw(MOVERS[mover](), (speed, 0, 0))
    settings |= {"hasGround": floor == "free row", "gravity": (0, -G, 4 * (floor == "wall"))}
    for mesh in (*meshes, mover):  # the row stands on the ground
        mesh.position = mesh.position + [[0.0, float(settings["hasGround"]), 0.0]]
    start, seconds = mover.position[0].copy(), min(seconds, 14 / speed)
    settings["watch"] = lambda: mover.position[0] - start
    _, track = run(engine, [*meshes, mover], seconds, mu=mu, **settings)
    return track[-1, 0] / speed / seconds, 1e3 * track[:, 1].max()


# Blows


def corner_rebounds(engine, e, sides=UNIT):
    """Least and largest separation of a corner that slides as it lands, of its approach.

    Both with the arm at the start of the step in which it lands.
    """
    turns = random_quaternions(np.random.default_rng(7), 25)
    starts = zip(np.linspace(0.001, 0.12, 25), turns, strict=True)
    boxes = [above(box(sides=sides, orientation=q), gap) for gap, q in starts]
    meshes = in_lanes(*([throw(mesh, (3.0, -2.0, 0.0))] for mesh in boxes))
    corners = [int(mesh.currVertices[:, 1].argmin()) for mesh in meshes]

    def watch():
        arms = [m.currVertices[k] - m.position[0] for m, k in zip(meshes, corners, strict=True)]
        return [[m.linVelocity[0] for m in meshes], [m.angVelocity[0] for m in meshes], arms]

    track = [watch(), *run(engine, meshes, 0.24, e=e, mu=1.0, watch=watch)[1]]
    v, w, arm = np.moveaxis(track, 1, 0)
    before = (v[:-1] + np.cross(w[:-1], arm[:-1]))[..., 1]
    after = (v[1:] + np.cross(w[1:], arm[:-1]))[..., 1]
    hits = (after - before > 0.5).argmax(axis=0)
    ratios = -after[hits, range(25)] / before[hits, range(25)]
    return ratios.min(), ratios.max()


def edge_landing(engine, e):
    """Angular velocity of a box that lands on an edge, of that which one impulse gives it."""
    mesh = throw(above(box(orientation=quaternion((0, 0, 1), 30)), 0.001), (0.0, -2.0, 0.0))
    arm = mesh.currVertices[mesh.currVertices[:, 1].argmin(), 0] - mesh.position[0, 0]
    inertia = mesh.mass / 6
    spin = 2 * (1 + e) / (1 / mesh.mass + arm**2 / inertia) * arm / inertia
    run(engine, [mesh], TIME_STEP, e=e, mu=0.0, gravity=(0, 0, 0))
    return mesh.angVelocity[0, 2] / spin


def flat_landing(engine):
    """Most of its speed that a cube keeps as it lands flat with e = 0, and its largest spin."""
    meshes, found = [box(20.0 * k, y) for k, y in enumerate((1.5, 1.51, 1.52, 1.56))], []

    def watch():
        return [(abs(m.linVelocity[0, 1]), abs(m.angVelocity).max()) for m in meshes]

    for speeds, spins in run(engine, meshes, 0.6, watch=watch)[1].transpose(1, 2, 0):
        hit = speeds.argmax() + 1
        found.append((speeds[hit] / speeds[hit - 1], spins[hit:].max()))
    return np.max(found, axis=0)


def bounce(engine, h, e=1.0):
    """Energy that a cube has after it has bounced flat, of that before."""
    mesh, rest = box(y=1.5), energy([box()])
    before = energy([mesh]) - rest
    run(engine, [mesh], 0.8, h, e)
    return (energy([mesh]) - rest) / before


def second_corner(engine, isFixed):
    """Least and greatest energy that is left where a second corner comes close in the same step."""
    pairs = []
    for degrees in np.linspace(0.2, 8, 12):
        mesh = above(box(orientation=quaternion((0, 0, 1), degrees)), 0.01)
        slab = box(0, -0.5, 0, (10, 1, 10), isFixed=isFixed)
        pairs.append((throw(mesh, (0.3, -2.0, 0.0)), slab))
    before = [*map(kinetic, pairs)]
    run(engine, in_lanes(*pairs), 0.3, e=1.0, mu=0.0, **FREE)
    kept = np.array([*map(kinetic, pairs)]) / before
    return kept.min(), kept.max()


def overlapping(engine, counts):
    """Largest speed and energy of a block of cubes that overlap by 0.1, without gravity."""
    meshes = [box(*place) for place in 0.9 * np.array(list(np.ndindex(counts)))]
    run(engine, meshes, 0.6, **FREE)
    return top_speed(meshes), kinetic(meshes)


def tangle(engine, count):
    """Largest speed of hulls of random corners that lie in each other on the ground."""
    rng = np.random.default_rng(5)
    corners = rng.normal(size=(count, 12, 3))
    places = rng.uniform((-2, 2, -2), (2, 6, 2), (count, 3))
    meshes = [shapes.convex_hull(c, 1.0, x) for c, x in zip(corners, places, strict=True)]
    run(engine, meshes, 0.6)
    return (top_speed(meshes),)


def gas(engine, shape, count=60, seconds=24.0, spin=0.0, densities=(1.0,)):
    """Energy left, and the greatest, of bodies that fly about in a closed box with e = 1.

    spin : in rad/s; densities : of cubes, in turn
    """
    rng, side, meshes, masses = np.random.default_rng(0), 6.0, [], itertools.cycle(densities)
    make = {
        "rods": lambda place, q: box(*place, (0.9, 0.4, 0.3), orientation=q),
        "balls": lambda place, q: shapes.sphere(0.35, 1.0, place, orientation=q),
        "hulls": lambda place, q: shapes.convex_hull(
            0.4 * random_quaternions(rng, 12)[:, 1:], 1.0, place, orientation=q
        ),
    }.get(shape, lambda place, q: box(*place, (0.6, 0.6, 0.6), orientation=q, density=next(masses)))
    for axis, sense in itertools.product(range(3), (-1, 1)):
        place, sides = np.zeros(3), np.full(3, side + 2)
        place[axis], sides[axis] = sense * (side / 2 + 0.5), 1.0
        meshes.append(box(*place, sides, isFixed=True))
    cells = list(itertools.product(1.3 * (np.arange(4) - 1.5), repeat=3))[:count]
    for cell, q in zip(cells, random_quaternions(rng, count), strict=True):
        meshes.append(throw(make(cell, q), 2.0 * rng.normal(size=3)))
        if spin:
            meshes[-1].angVelocity = spin * rng.normal(size=(1, 3))
    before, watch = kinetic(meshes), lambda: kinetic(meshes)
    settings = FREE | ({"gyroscopic": True} if engine in OWN else {})
    _, energies = run(engine, meshes, seconds, 0.01, 1.0, 0.0, watch=watch, **settings)
    return energies[-1] / before, energies.max(initial=before) / before


def elastic_row(engine, count, gap):
    """Energies of a row's last cube, and gained by all, of that of the first, which hits it."""
    meshes = [box((1.0 + gap) * k if k else -0.5, 0.0) for k in range(count)]
    throw(meshes[0], (1.0, 0.0, 0.0))
    run(engine, meshes, 1.0 + gap * count, 0.01, 1.0, 0.0, **FREE)
    energies = np.array([(m.linVelocity**2).sum() for m in meshes])
    return energies[-1], max(energies.sum() - 1.0, 0.0)


# Units and frames


def in_units(engine, mass=1.0, length=1.0, time=1.0, e=0.5, steps=90):
    """Largest difference of positions between two systems of units."""
    found = []
    for m, s, t in ((1, 1, 1), (mass, length, time)):
        rng, meshes = np.random.default_rng(4), []
        for k, q in enumerate(random_quaternions(rng, 4)):
            place, density = s * np.array((0.3 * k, 1 + 1.5 * k, 0)), rng.uniform(1, 5) * m / s**3
            meshes.append(box(*place, (s, 0.6 * s, 0.8 * s), orientation=q, density=density))
        settings = {"gravity": (0, -40 * s / t**2, 0), "sleeping": False}
        run(engine, meshes, steps * t / 64, t / 64, e, **settings)
        found.append(np.array([mesh.position[0] for mesh in meshes]) / s)
    return np.abs(found[0] - found[1]).max()


def in_a_frame(engine, *frame, kinds=(), wall=False, height=0.0, seconds=1.0, **settings):
    """Largest difference of positions between two frames.

    kinds : shapes of bodies that spin, in place of cubes; wall : whether they hit one that moves
    """
    found, settings, up = [], FREE | {"mu": 0.4} | settings, np.array([0.0, height, 0.0])
    for velocity in np.zeros(3), np.array(frame):
        rng, meshes = np.random.default_rng(1), []
        for k, q in enumerate(random_quaternions(rng, 5)):
            mesh = box(*rng.normal(size=3) * 1.2 + up, orientation=q)
            start = -1.5 * (mesh.position[0] - up) + 0.3 * rng.normal(size=3)
            if kinds:
                mesh = body(kinds[k % len(kinds)], mesh.position, q, size=0.25)
            meshes.append(throw(mesh, start + velocity, rng.normal(size=3) if kinds else (0, 0, 0)))
        if wall:
            meshes.append(throw(box(0, -2, 0, (8, 1, 8), isFixed=True), velocity))
        before = meshes[0].linVelocity - velocity
        run(engine, meshes, seconds, 0.01, **settings)
        assert np.abs(meshes[0].linVelocity - velocity - before).max() > 0.1  # has collided
        found.append(np.array([mesh.position[0] - seconds * velocity for mesh in meshes]))
    return np.abs(found[0] - found[1]).max()


def as_forces(engine, make, part=1.0, seconds=1.0, **settings):
    """Largest difference of positions if forces on all bodies replace a part of gravity."""
    found = []
    for share in (part, 0.0):
        meshes = make()
        for mesh in (mesh for mesh in meshes if share and not mesh.isFixed):
            mesh.load = (0.0, -share * G * mesh.mass, 0.0, 0.0, 0.0, 0.0)
        given = settings | {"gravity": (0.0, (share - 1.0) * G, 0.0), "sleeping": False}
        run(engine, meshes, seconds, **given)
        found.append(np.array([mesh.position[0] for mesh in meshes]))
    return np.abs(found[0] - found[1]).max()


# Sleep


def slope(engine, degrees, side=1.0, seconds=10.0, mu=0.0, **settings):
    """Way of a cube down a slope."""
    mesh, angle = box(0, side / 2, 0, (side, side, side)), np.radians(degrees)
    settings["gravity"] = (G * np.sin(angle), -G * np.cos(angle), 0)
    floor = box(0, -side / 2, 0, (60 * side, side, 10 * side), isFixed=True)
    run(engine, [floor, mesh], seconds, mu=mu, **settings)
    return mesh.position[0, 0]


def hung(degrees, length, side=0.2, spin=(0, 0, 0)):
    """`(meshes, tie, point, reach)`: an anchor and a bob, the ends of the string between them,
    where it hangs, and how far from there the bob's centre is. side : of the bob, along x
    """
    anchor, bob = box(0, 30, 0, isFixed=True), throw(box(0, 0, 0, (side, 0.2, 0.2)), spin=spin)
    corner, tip = farthest(anchor, (-1, -1, -1)), farthest(bob, (1, 1, 1))
    point, arm = anchor.currVertices[corner], bob.origVertices[tip]
    string = rotation(quaternion((0, 0, 1), degrees)).apply([0, 1, 0])  # from the bob up
    bob.orientation = Rotation.align_vectors([string], [arm])[0].as_quat()[None, [3, 0, 1, 2]]
    reach = length + np.linalg.norm(arm)
    bob.position = (point - reach * string)[None]
    return [anchor, bob], [0, corner, 1, tip], point, reach


def pendulum(engine, degrees, length, seconds=30.0, side=0.2, spin=(0, 0, 0), **settings):
    """Energy that a pendulum has at the end, of that at the start."""
    meshes, tie, point, reach = hung(degrees, length, side, spin)
    low, bob = point[1] - reach, meshes[1]
    settings["constraints"] = [[*tie, length, upper] for upper in (True, False)]
    settings["watch"] = lambda: energy([bob]) - bob.mass * G * low
    _, energies = run(engine, meshes, seconds, **settings)
    return np.mean(energies[-150:]) / np.mean(energies[:150])


def hoisted(engine, pull, isRigid=False):
    """By how much the angle and the speed of a pendulum are off after 2 s, as it is shortened."""
    meshes, tie, point, reach = hung(30.0, 6.0)

    def act(k, world):
        length = 6.0 - pull * TIME_STEP * (k + 1)
        bounds = (True, False) if isRigid else (True,)
        world.settings["constraints"] = [[*tie, length, isUpper] for isUpper in bounds]

    def rates(t, state):
        return state[1], (2 * pull * state[1] - G * np.sin(state[0])) / (reach - pull * t)

    angle, turn = solve_ivp(rates, (0, 2.0), (np.pi / 6, 0.0), rtol=1e-9).y[:, -1]
    run(engine, meshes, 2.0, act=act, **HANGING)
    x, y, _ = meshes[1].position[0] - point
    due = np.hypot(pull, turn * (reach - 2.0 * pull))
    return abs(np.arctan2(x, -y) - angle), abs(top_speed(meshes) - due)


def stack_falls(engine, sleeping, count=20, how="moved aside"):
    """How far the bottom and the top of a stack fall in 0.4 s once its support is removed."""
    meshes = [box(0, 9, 0, (2, 3, 2), isFixed=True)] + [box(0, 11 + k) for k in range(count)]
    support, low, high = meshes[0], meshes[1], meshes[-1]

    def act(k, world):
        if k != 250:
            return
        assert engine != "soft step" or world.report.isAsleep[1:].all() == sleeping
        if how == "moved aside":
            support.position = np.array([[50.0, 9.0, 0.0]])
        elif how == "let go":
            support.isFixed = False
        elif how == "thrown down":
            throw(support, (0, -8, 0))
        else:  # taken out of the list
            world.settings["solverState"].remove(0)
            del world.meshes[0]

    settings = {"watch": lambda: (low.position[0, 1], high.position[0, 1]), "sleeping": sleeping}
    _, track = run(engine, meshes, 5.4, act=act, **settings)
    return track[249] - track[-1]


def thrown(meshes, *velocities):
    return meshes, lambda meshes: throw(meshes[0], *velocities)


def seesaw():
    """A box falls on one end of a plank, on whose other end a smaller one lies."""
    meshes = [box(2.5, 3.5, density=2, isFixed=True), box(0, 0.25, 0, (0.5, 0.5, 2), isFixed=True)]
    meshes += [box(0, 0.55, 0, (6, 0.1, 1)), box(-2.5, 0.75, 0, (0.3, 0.3, 0.3))]
    return thrown(meshes, (0, 0, 0))


def row_hit(count, speed):
    return thrown([box(-1.5)] + [box(k) for k in range(count)], (speed, 0, 0))


def row_rolled_at(count):
    ball = above(shapes.sphere(0.5, 1.0, (-2, 0, 0)))
    return thrown([ball, *(box(k) for k in range(count))], (3, 0, 0), (0, 0, -6))


def row_pushed(count, acceleration=0.5, pushed=1):
    """Forces on the first `pushed` boxes."""

    def push(meshes):
        for mesh in meshes[:pushed]:
            mesh.load = (acceleration * count / pushed * mesh.mass, *np.zeros(5))

    return [box(k) for k in range(count)], push


def asleep(engine, make, *arguments, seconds, e=0.0, mu=0.0):
    """Largest difference between asleep and awake, of the largest way of a body that is awake."""
    (meshes, act), ways = make(*arguments), []
    settled, _ = run(engine, meshes, 1.5, mu=mu, sleeping=True)
    assert settled.report.isAsleep[2:].all()
    start = np.array([mesh.position[0] for mesh in meshes])
    for sleeping in (True, False):
        world = copy.deepcopy(settled)
        world.meshes[0].isFixed = False
        act(world.meshes)
        world.settings["sleeping"], world.arguments = sleeping, (TIME_STEP, e)
        for _ in range(round(seconds / TIME_STEP)):
            world.step()
        ways.append(np.array([mesh.position[0] for mesh in world.meshes]) - start)
    return np.abs(ways[0] - ways[1]).max() / np.abs(ways[1]).max()


def glide(engine, side, speed, seconds=5.0):
    """Way of a cube that glides without friction, of that at constant speed."""
    mesh = throw(box(0, side / 2, 0, (side, side, side)), (speed, 0, 0))
    run(engine, [mesh], seconds, mu=0.0)
    return mesh.position[0, 0] / (seconds * speed)


def against_a_wall(engine, count, e=0.0, distances=(0.3,)):
    """Largest speed of cubes of a row that has hit a wall at the distances, of that before."""
    lanes = []
    for distance in distances:  # which end in different substeps
        wall = box(count + distance, 1, 0, (1, 2, 2), isFixed=True)
        lanes.append([wall, *(throw(box(k), (1, 0, 0)) for k in range(count))])
    run(engine, in_lanes(*lanes), 1.0, e=e, mu=0.0)
    return max(abs(mesh.linVelocity[0, 0]) for _, *row in lanes for mesh in row)


def plastic_row(engine, count, width=1):
    """Least and greatest speed of an awake row, of the common one; the middle of `width` is hit."""
    places = [(i + 1.0, 0.5, k - width // 2) for k in range(width) for i in range(count - 1)]
    meshes = [throw(box(-0.5), (1, 0, 0)), *(box(*place) for place in places)]
    run(engine, meshes, 1.0, mu=0.0, sleeping=False)
    row = [mesh for mesh in meshes if abs(mesh.position[0, 2]) < 0.5]
    speeds = [count * mesh.linVelocity[0, 0] for mesh in row]
    return min(speeds), max(speeds)


def crowd(engine):
    """Momentum that boxes which overlap gain as they are pushed apart, of the sum of theirs."""
    rng, meshes = np.random.default_rng(3), []
    for q in random_quaternions(rng, 30):
        place = 0.8 * rng.normal(size=3)
        mesh = box(*place, (1.2, 0.5, 0.7), orientation=q)
        meshes.append(throw(mesh, rng.normal(size=3) - place))
    before = np.array([mesh.linVelocity[0] for mesh in meshes])
    run(engine, meshes, 0.5, mu=0.3, **FREE)
    gain = sum(mesh.linVelocity[0] for mesh in meshes) - before.sum(axis=0)  # equal masses
    return np.linalg.norm(gain) / np.linalg.norm(before, axis=1).sum()


def time_steps(engine, *steps):
    """By how much a stack of five is faster in steps of these lengths."""
    meshes, fastest = stack(5, UNIT), []
    world, _ = run(engine, meshes, 0.4, sleeping=False)
    for h in (TIME_STEP, *steps * 10):
        world.arguments = h, 0.0
        world.step()
        fastest.append(top_speed(meshes))
    return max(fastest) - fastest[0]


# Loads, and what moves


def loaded(engine, ratio, off=0.0, seconds=20.0):
    """How far a cube sinks and creeps in mm under one that is `ratio` times as dense."""
    meshes = [box(), box(off, 1.5, density=ratio)]
    run(engine, meshes, seconds)
    return 1e3 * (1.5 - meshes[1].position[0, 1]), 1e3 * np.hypot(*meshes[0].position[0, [0, 2]])


def squeezed(engine, *densities, seconds=1.0):
    """By how many mm forces at both ends, of G times their masses, shorten a row of cubes."""
    meshes = [box(k, density=density) for k, density in enumerate(densities)]
    for mesh, sense in ((meshes[0], 1.0), (meshes[-1], -1.0)):
        mesh.load = (sense * G * mesh.mass, 0.0, 0.0, 0.0, 0.0, 0.0)
    run(engine, meshes, seconds, **FREE)
    return 1e3 * (len(meshes) - 1.0 - np.linalg.norm(meshes[-1].position - meshes[0].position))


def lifted(engine, count, weights):
    """By how many mm a stack sinks if the lowest cube is pushed upwards by so many weights."""
    meshes = stack(count, UNIT)

    def act(k, world):
        if k == 75:
            meshes[0].load = (0.0, weights * G * meshes[0].mass, 0.0, 0.0, 0.0, 0.0)

    watch = {"watch": lambda: [mesh.position[0, 1] for mesh in meshes]}
    _, heights = run(engine, meshes, 3.5, act=act, **watch)
    return 1e3 * (heights[74] - heights[-1]).max()


def abandoned(engine, speed):
    """By how much a plank falls as one of its supports glides away from under its end."""
    support = throw(box(1.6), (speed, 0, 0))
    plank = box(0, 1.1, 0, (2.4, 0.2, 1))
    run(engine, [box(-1, isFixed=True), support, plank], 0.1 / speed + 2.0, mu=0.0)
    return 1.1 - plank.position[0, 1]


def hit(engine, ratio):
    """How deep a cube is pressed into the ground by a heavy one that falls on it, in mm."""
    meshes = [box(), box(0, 2.5, density=ratio)]
    _, lows = run(engine, meshes, 5.0, watch=lambda: meshes[0].currVertices[:, 1].min())
    return -1e3 * lows.min(), -1e3 * lows[-1]


def drowsy(engine):
    """Least, greatest momentum left of a light cube that hits one at rest after 18, … 31 steps."""
    lanes = []
    for k in range(18, 32):
        light = box(-1.0 - TIME_STEP * (k + 0.5), density=0.02)
        lanes.append([box(), throw(light, (1, 0, 0))])
    run(engine, in_lanes(*lanes), TIME_STEP * 35, mu=0.0)
    momenta = [a.linVelocity[0, 0] / 0.02 + b.linVelocity[0, 0] for a, b in lanes]
    return min(momenta), max(momenta)


def chain(engine, count=20, ratio=1000.0):
    """Stretch in % of the longest link of a chain with a heavy end, after 10 s."""
    links = [box(0, 20 - 0.5 * k, 0, (0.2, 0.2, 0.2), isFixed=k == 0) for k in range(count)]
    links.append(box(0, 20 - 0.5 * count, 0, (0.2, 0.2, 0.2), density=ratio))
    low, high = (farthest(links[1], (1, s, 1)) for s in (-3, 3))
    ties = [[k, low, k + 1, high, 0.3, True] for k in range(count)]
    run(engine, links, 10.0, constraints=ties, **HANGING)
    ends = [a.currVertices[low] - b.currVertices[high] for a, b in itertools.pairwise(links)]
    return 100 * (max(map(np.linalg.norm, ends)) / 0.3 - 1)


def beads(count, ratio=1.0, degrees=0.0):
    """`(meshes, constraints)` of a straight chain of octahedra, tied at their tips, that leans."""
    way = np.array([np.sin(np.radians(degrees)), -np.cos(np.radians(degrees)), 0.0])
    turned = quaternion((0, 0, 1), degrees)
    links, make = [], partial(shapes.convex_hull, CORNERS / 6, orientation=turned)
    for k, density in enumerate([1.0] * count + [ratio]):
        links.append(make(density, 0.5 * k * way, isFixed=k == 0))
    low, high = (farthest(links[0], (0, s, 0)) for s in (-1, 1))
    return links, [[k, low, k + 1, high, 0.3, True] for k in range(count)]


def swinging(engine, *chains, seconds=4.0, steps=(TIME_STEP,), substeps=(6,), added=False):
    """Energy that chains with heavy ends, let go at an angle, have left, and had at most.

    chains : each the arguments of `beads`; steps, substeps : time steps in s, and numbers of
        substeps, in turn; added : whether a constraint far away is added after 0.5 s, and taken
        away after 1 s
    """
    worlds, rests = [beads(*chain) for chain in chains], []
    for links, ties in worlds:
        tip = links[0].currVertices[ties[0][1], 1]  # below which it hangs at rest
        rests.append(sum(G * m.mass * (tip + 0.1 - 0.5 * k) for k, m in enumerate(links[1:], 1)))
    meshes, ties = linked_in_lanes(*worlds)

    def watch():
        return [energy(links) for links, _ in worlds]

    def act(k, world):
        world.arguments = steps[k % len(steps)], 0.0
        if engine == "soft step":
            world.settings["substeps"] = substeps[k % len(substeps)]
        world.settings["constraints"] = [*ties, far] if added and 25 <= k < 50 else ties

    before, far = watch() - np.array(rests), [len(meshes), 0, len(meshes) + 1, 0, 999.0, True]
    settings = HANGING | {"linkedBodiesCollide": False, "act": act, "watch": watch}
    bodies, h = [*meshes, box(99), box(99, 9)], np.mean(steps)
    _, track = run(engine, bodies, seconds, h, constraints=ties, **settings)
    shares = (track - rests) / before
    return shares[-1].min(), shares.max()


def accompanied(engine, *worlds, seconds=1.0):
    """By how many metres the bodies of the first of these `(meshes, constraints)` are elsewhere in
    the end if the others are in the scene, too, far away.
    """
    ends, (first, _) = [], worlds[0]
    for some in (worlds[:1], worlds):
        meshes, ties = linked_in_lanes(*copy.deepcopy(some))
        run(engine, meshes, seconds, constraints=ties, linkedBodiesCollide=False, **HANGING)
        ends.append([mesh.position for mesh in meshes[: len(first)]])
    return np.abs(np.subtract(*ends)).max()


def spinning(engine, links, ties, speed, seconds, **settings):
    """Energy and angular momentum that linked cubes or octahedra of one mass, which turn freely
    about their centre, have left.
    """
    links[0].isFixed = False
    centre = np.mean([mesh.position[0] for mesh in links], axis=0)
    for mesh in links:
        throw(mesh, np.cross((0, 0, speed), mesh.position[0] - centre), (0, 0, speed))

    def state():
        turns = [
            np.cross(m.position, m.linVelocity)[0] + m.IT[0, 0] * m.angVelocity[0] for m in links
        ]
        return np.array([kinetic(links), np.sum(turns, axis=0)[2]])

    before, settings = state(), settings | FREE | {"sleeping": False, "linkedBodiesCollide": False}
    run(engine, links, seconds, constraints=ties, **settings)
    return tuple(state() / before)


def ring(count):
    """`(meshes, constraints)` of cubes on a circle, with bars from corner to corner."""
    angles, ties = 2 * np.pi * np.arange(count) / count, []
    meshes = [box(1.5 * np.cos(a), 1.5 * np.sin(a), 0, (0.2, 0.2, 0.2)) for a in angles]
    for k, (a, b) in enumerate(zip(meshes, meshes[1:] + meshes[:1], strict=True)):
        i, j = nearest(a, b.position), nearest(b, a.position)
        length = np.linalg.norm(a.currVertices[i] - b.currVertices[j])
        ties += [[k, i, (k + 1) % count, j, length, isUpper] for isUpper in (True, False)]
    return meshes, ties


def overstretched(engine, count, factor):
    """Speed of a chain between anchors that are too far apart by a factor, after 4 s."""
    links, ties = beads(count, 1.0, 90.0)
    links[-1].isFixed = True
    for mesh in links:
        mesh.position = factor * mesh.position
    run(engine, links, 4.0, constraints=ties, linkedBodiesCollide=False, **HANGING)
    return top_speed(links)


def ropes(engine, *directions, side=0.2, length=1.0, **more):
    """Speed and spin of a cube in the end that ropes tie to anchors 5 m away."""
    mesh = box(0, 20, sides=(side, side, side))
    return tied(engine, mesh, directions, lambda apart: length, **more)


def taut(engine, percent, *axes, density=1.0, velocity=(0, 0, 0), spin=(0, 0, 0), **more):
    """Speed and spin in the end of an octahedron that ropes along axes, too short by so many
    percent, tie to anchors 5 m away on both sides.
    """
    mesh = throw(shapes.convex_hull(CORNERS / 6, density, (0, 20, 0)), velocity, spin)
    directions = [sense * np.eye(3)[axis] for axis in axes for sense in (1, -1)]
    return tied(engine, mesh, directions, lambda apart: apart / (1 + percent / 100), **more)


def tied(engine, mesh, directions, length_of, seconds=2.0, rigid=False, parting=0.0):
    """Speed and spin of a body that is tied to anchors that move away at the speed `parting`, m/s.
    length_of : of the distance at the start
    """
    meshes, ties = [mesh], []
    for k, way in enumerate(np.array(directions, dtype=float), 1):
        place = mesh.position[0] + 5 * way / np.linalg.norm(way)
        held = box(*place, (0.2, 0.2, 0.2), isFixed=True)
        meshes.append(throw(held, parting * way / np.linalg.norm(way)))
        own = farthest(mesh, (0.01, 0.02, 0.03) + way)
        anchor = farthest(meshes[k], (0.01, 0.02, 0.03) - way)
        length = length_of(np.linalg.norm(mesh.currVertices[own] - meshes[k].currVertices[anchor]))
        ties += [[0, own, k, anchor, length, isUpper] for isUpper in (True, False)[: 1 + rigid]]
    run(engine, meshes, seconds, constraints=ties, **HANGING)
    return np.linalg.norm(mesh.linVelocity), np.linalg.norm(mesh.angVelocity)


RIDE = 2 * 0.5 - 0.25 / (2 * 0.5 * G)  # slides until it has the speed of the belt


def carried(engine, kind):
    """Effect of a fixed body with a velocity on one that it touches, after 2 s."""
    isPaddle = kind.startswith("paddle")  # strikes, e = 1; others carry
    step = np.array([[1.0 if isPaddle else 0.5, 0.0, 0.0]])
    mover = box(-1.0 * isPaddle, 0.5, 0, (0.2, 4, 4) if isPaddle else (20, 1, 4), isFixed=True)
    rider = box(0, 0.5, 0, (0.5, 0.5, 0.5)) if isPaddle else box(0, 1.25, 0, (1, 0.5, 1))
    if kind == "turntable":  # degrees
        mover.angVelocity, rider.position = np.array([[0.0, 0.5, 0.0]]), np.array([[1.5, 1.25, 0]])
        throw(rider, (0.0, 0.0, -0.75), (0.0, 0.5, 0.0))
    elif kind not in ("paddle, by position", "ground"):
        mover.linVelocity = step
    start = mover.position.copy()

    def act(k, world):
        if kind == "belt that stays":
            mover.position = start
        elif kind == "paddle, by position":
            mover.position = mover.position + TIME_STEP * step
        elif kind == "ground":
            world.ground.linVelocity = step

    if kind == "ground":
        rider.position = np.array([[0, 0.25, 0]])
    meshes = [rider] if kind == "ground" else [mover, rider]
    run(engine, meshes, 2.0, e=float(isPaddle), act=act, **FREE if isPaddle else {})
    if kind == "turntable":
        return np.degrees(np.arctan2(-rider.position[0, 2], rider.position[0, 0]))
    return rider.linVelocity[0, 0] if isPaddle else rider.position[0, 0]


# Rolling, spinning, falling


def roller(sides):
    """A prism of radius 0.5 that lies on one of its sides, with its axis along z."""
    angles = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    points = [(np.sin(a), -np.cos(a), z) for a in angles for z in (-0.5, 0.5)]
    return above(shapes.convex_hull(0.5 * np.array(points), 1.0))


def wheel(engine, h, seconds=8.0, sides=12, degrees=8.0):
    """Mean speed of a polygon that rolls down a slope, of that of the rimless wheel."""
    mesh, half, tilt = roller(sides), np.pi / sides, np.radians(degrees)
    inertia, arm = mesh.IT[2, 2] / mesh.mass + 0.25, 0.5  # about a corner, per mass
    kept = 1 - 0.25 * (1 - np.cos(2 * half)) / inertia  # of the angular velocity, at each impact
    gain = 2 * G * arm * 2 * np.sin(half) * np.sin(tilt) / inertia
    start = kept * np.sqrt(gain / (1 - kept**2))  # after an impact

    def slowness(angle):  # from the slope's normal
        rise = np.cos(angle + tilt) - np.cos(tilt - half)
        return 1 / np.sqrt(start**2 - 2 * G * arm * rise / inertia)

    turn = np.array([0.0, 0.0, -start])
    throw(mesh, np.cross(turn, mesh.position[0] - mesh.currVertices[2]), turn)
    settings = {"gravity": (G * np.sin(tilt), -G * np.cos(tilt), 0), "mu": 1.0}
    _, places = run(engine, [mesh], seconds, h, watch=lambda: mesh.position[0, 0], **settings)
    speed = (places[-1] - places[len(places) // 2 - 1]) / (0.5 * seconds)
    return speed / (2 * arm * np.sin(half) / quad(slowness, -half, half)[0])


SPINNER, SPIN = (1.0, 0.2, 0.5), np.array([0.01, 0.01, 5.0])  # about the middle axis


def tumbling_ode(seconds):
    """Times at which the body's middle axis turns over, by Euler's equation in body axes."""
    inertia = box(sides=SPINNER).IT

    def derivative(_, w):
        return -np.linalg.solve(inertia, np.cross(w, inertia @ w))

    settings = {"events": lambda _, w: w[2], "rtol": 1e-11, "atol": 1e-12}
    return solve_ivp(derivative, (0, seconds), SPIN, **settings).t_events[0]


def tumbling(engine, seconds=20.0, spin=SPIN):
    """Largest relative change of |L|, that of the energy, number of flips, time of the first."""
    mesh = throw(box(sides=SPINNER), spin=spin)

    def watch():
        turn = rotation(mesh.orientation[0]).as_matrix()
        momentum = turn @ mesh.IT @ turn.T @ mesh.angVelocity[0]
        return *momentum, mesh.angVelocity[0] @ momentum, (turn.T @ mesh.angVelocity[0])[2]

    settings = FREE | ({"gyroscopic": True} if engine in OWN else {})
    _, track = run(engine, [mesh], seconds, watch=watch, **settings)
    change = np.linalg.norm(track[:, :3] - track[0, :3], axis=1) / np.linalg.norm(track[0, :3])
    middle = track[:, 4]
    k = np.flatnonzero(middle[:-1] * middle[1:] < 0)
    flips = TIME_STEP * (1 + k + middle[k] / (middle[k] - middle[k + 1]))
    return change.max(), np.abs(track[:, 3] / track[0, 3] - 1).max(), len(flips), flips[0]


ROD, LEAN = (0.1, 4.0, 0.1), np.radians(5)


def rod(engine, **settings):
    """Time in s until a rod that leans by 5° lies flat; friction holds its foot."""
    mesh = above(box(sides=ROD, orientation=quaternion((0, 0, 1), np.degrees(LEAN))))
    watch = {"watch": lambda: mesh.position[0, 1], "mu": 2.0}
    return TIME_STEP * (1 + int((run(engine, [mesh], 8.0, **watch, **settings)[1] < 0.1).argmax()))


def rod_falls():
    """The same where the rod turns about its lower edge; angles are those of its diagonal."""
    corner, diagonal = np.arctan(ROD[0] / ROD[1]), np.hypot(*ROD[:2])

    def slowness(angle):
        return 1 / np.sqrt(3 * G / diagonal * (np.cos(LEAN - corner) - np.cos(angle)))

    return quad(slowness, LEAN - corner, np.pi / 2 - corner)[0]


def pulled(engine):
    """Way in 2 s of a box that is pulled along the ground with 0.9 of the friction's limit."""
    mesh = box()
    run(engine, [mesh], 2.0, gravity=(0.45 * G, -G, 0))
    return mesh.position[0, 0]


def twist(engine):
    """Angular velocity after 4 s of a box that turned flat on a fixed one at 10 rad/s."""
    mesh = throw(box(0, 3, 0, (2, 2, 2)), spin=(0, 10, 0))
    run(engine, [box(0, 1, 0, (10, 2, 10), isFixed=True), mesh], 4.0)
    return np.linalg.norm(mesh.angVelocity)


# Friction, and piles


def four_corners(sides, velocity, spin, mu=0.3):
    """Way of a box that slides on its four lower corners until it rests. sides : (x, y, z)

    Friction opposes the slip of each corner, and its moment about the COM shifts the loads. Of all
    loads in balance, those nearest to a quarter each are taken.
    """
    # the plane has the axes z and x, so that its turns are those about y
    a, b, c = sides[::-1]
    corners = 0.5 * np.array([(a, c), (-a, c), (-a, -c), (a, -c)])
    inertia = (a * a + c * c) / 12  # per mass

    def derivative(_, state):
        angle, v, spin = state[2], state[3:5], state[5]
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        arms = corners @ turn.T
        slip = v + spin * np.stack((-arms[:, 1], arms[:, 0]), axis=1)
        direction = -slip / np.maximum(np.linalg.norm(slip, axis=1), 1e-9)[:, None]
        # Σ N = m g, and Σ N (r + (b/2) μ direction) = 0: no moment about horizontal axes
        rows = np.vstack((np.ones(4), (arms + 0.5 * b * mu * direction).T))
        loads = 0.25 * G + np.linalg.pinv(rows) @ (np.array([G, 0, 0]) - rows @ np.full(4, G / 4))
        push = mu * loads[:, None] * direction
        moment = (arms[:, 0] * push[:, 1] - arms[:, 1] * push[:, 0]).sum()
        return np.concatenate((state[3:6], push.sum(axis=0), [moment / inertia]))

    def rests(_, state):
        return np.linalg.norm(state[3:5]) + abs(state[5]) - 0.01

    rests.terminal = True
    start = np.array([0, 0, 0, *velocity[::-2], spin])
    return np.hypot(*solve_ivp(derivative, (0, 20), start, events=rests, max_step=0.01).y[:2, -1])


def slide(engine, sides, velocity, spin):
    """Way that a box slides on the ground with friction 0.3."""
    mesh = throw(box(0, sides[1] / 2, 0, sides), velocity, (0.0, spin, 0.0))
    run(engine, [mesh], 4.0, mu=0.3)
    return np.hypot(*mesh.position[0, [0, 2]])


BRICK, CUBE = (12.0, 6.0, 8.0), (2.0, 2.0, 2.0)
SQUARE, LONG = (1.0, 0.5, 1.0), (2.0, 0.5, 1.0)


def stack(count, sides, growth=1.0):
    return [box(0, (k + 0.5) * sides[1], 0, sides, density=growth**k) for k in range(count)]


def pyramid(rows):
    places = [(c - (rows - 1 - r) / 2, r) for r in range(rows) for c in range(rows - r)]
    return [box(12.2 * x, 3 + 6 * r, 0, BRICK) for x, r in places]


def table():
    legs = [box(x, 1, z, CUBE) for x in (-2, 2) for z in (-2, 2)]
    return [*legs, box(0, 3, 0, (6, 2, 6), density=400 * 8 / 72)]


def legs():
    """Four, with a load off their middle."""
    load = box(0.3, 1.25, 0, (2, 0.5, 2), density=3.6)
    return [*(box(x, 0.5, z, (0.3, 1, 0.3)) for x in (-0.8, 0.8) for z in (-0.8, 0.8)), load]


def building(name):
    return load_scene_file(DATA / f"{name}-scene.txt")


def pile(engine, make, *arguments, seconds=40.0, **settings):
    """Drift, sinking and speed in m/s: the largest of all bodies, without sleep."""
    meshes = make(*arguments)
    start = np.array([mesh.position[0] for mesh in meshes])
    run(engine, meshes, seconds, sleeping=False, **settings)
    moved = np.array([mesh.position[0] for mesh in meshes]) - start
    return np.hypot(*moved[:, [0, 2]].T).max(), -moved[:, 1].min(), top_speed(meshes)


def heap(engine, seed, count=1000):
    """Median speed and largest overlap of a settled heap; % asleep after 500 more steps."""
    ((_, meshes),) = heap_states(count, ["settled"], seed)
    speed = np.median(np.linalg.norm([mesh.linVelocity[0] for mesh in meshes], axis=1))
    deepest, (world, _) = penetrations(meshes).max(), run(engine, meshes, 10.0)
    return speed, deepest, 100 * world.report.isAsleep.mean()


def fall(steps, substeps=6):
    """Fall in so many steps of semi-implicit Euler in substeps."""
    count = substeps * steps
    return G * (TIME_STEP / substeps) ** 2 * count * (count + 1) / 2


class Row(NamedTuple):
    """An experiment: a line of experiments.txt, whose numbers and call are expressions."""

    what: str  # begins with the number of a kind of fault
    dueText: str
    withinText: str
    call: str

    @property
    def due(self):
        return np.array(eval(f"({self.dueText},)", NAMES))

    @property
    def within(self):
        """Largest deviations from what is due in a test, or None if none is made."""
        text = self.withinText.removeprefix("slow ")
        return None if text == "-" else eval(f"({text},)", NAMES)

    def measure(self, engine):
        """As many numbers as are due, of an engine by its name."""
        name, arguments = self.call.split("(", 1)
        if name in SOFT_ONLY and engine != "soft step":
            raise UnsuitedError
        return np.atleast_1d(eval(f"{name}(engine, {arguments}", NAMES | {"engine": engine}))


NAMES, SOFT_ONLY = globals(), ("asleep", "heap", "pile", "time_steps")
TABLE = Path(__file__).with_name("experiments.txt").read_text(encoding="utf-8")
ROWS = [Row(*line.split(" | ")) for line in TABLE.partition("\n\n")[2].splitlines()]


def measured(one, engine):
    """Text of what an engine gives: a dash if it is not installed, or the row does not suit it."""
    try:
        values = one.measure(engine) if engine in ENGINES else []
    except UnsuitedError:
        values = []
    return ", ".join(f"{value:.4g}" for value in values) or "–"


def main(options):
    names = ("soft step", "basic step", "MuJoCo", "PyBullet")
    rows = [one for one in ROWS if any(word in one.what for word in options.words or [""])]
    if not rows:
        raise InputError(f"no row has any of {', '.join(options.words)} in its name")
    print(f"{describe_machine()}\n| row | due | {' | '.join(names)} |\n|---|{'---|' * 5}")
    for one in rows:
        due = ", ".join(f"{value:.4g}" for value in one.due)
        cells = " | ".join(measured(one, name) for name in names)
        print(f"| {one.what} | {due} | {cells} |", flush=True)
