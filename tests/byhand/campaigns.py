"""Campaigns: random and hostile input for as long as is wanted, against independent answers.

    pairs    `is_collide` against whole-number arithmetic and stretched Minkowski differences:
             needles, blades, lattices and solids; overlapping, kissing and apart; up to 1e7 from
             the origin, and from 1e-30 to 1e11 in size
    bits     hostile scenes: pair by pair against the grid, the sweep against the queue, a list that
             has been stepped against fresh copies of it, and the soft-step solver twice and after
             it was saved and restored; all bit by bit

Prints counts, and each failure with the number of its case.
"""

import collections
import itertools
import math
import time
import traceback
import warnings

import numpy as np
import oracles
from oracles import IDENTITY, SHAPES, body, quaternion, random_quaternions, turned

import GJK
from rbs.geometry.hulls import TOUCH_TOLERANCE
from rbs.softstep.step import SolverState
from rbs.stepping.meshes import StateError
from RBSFunctions import run_timestep

EPS = np.finfo(float).eps
# Shapes of so few vertices that whole-number arithmetic takes milliseconds; the others are judged
# by Qhull.
FEW = ("tetrahedron", "box", "octahedron", "long-octahedron")
MOST_EXACT_POINTS = 20
KINDS = ("lattice", "curved", "solid", "needle", "blade")
SIZES = (1e-30, 1e-12, 1e-6, 1e6, 1e11)
# Coordinates on a lattice, with zeros of either sign.
LATTICE = (-0.0, 0.0, 1.5, -1.5, 3.0)
# The broad phase and the schedule of contacts in each way to make the same step.
WAYS = (("all", "sequential"), ("grid", "sequential"), ("all", "batches"))


def unit_shape(name):
    vertices = oracles.vertices_of(name)
    return vertices / np.abs(vertices).max(axis=0)


def thinness(rng, kind):
    """Three factors: about 1 for solids; for blades and needles, one or two from 1e-3 to 1e-1."""
    if kind == "solid":
        return rng.uniform(0.3, 1.0, 3)
    thin = 10.0 ** rng.uniform(-3.0, -1.0)
    return np.array([1.0, thin if kind == "needle" else rng.uniform(0.3, 1.0), thin])


def point_set(rng, kind):
    """Points (n, 3) of some kind, about 1 in size, near the origin."""
    if kind == "lattice":
        return rng.integers(-2, 3, size=(rng.integers(4, 9), 3)) * 0.5
    elif kind == "curved":
        points = unit_shape(rng.choice(["cylinder", "ellipsoid"]))
    else:
        points = unit_shape(rng.choice(FEW)) * thinness(rng, kind)
    return turned(points, random_quaternions(rng, 1)[0])


def aligned_pair(rng):
    """Two needles or blades in nearly the same place, with nearly the same axes."""
    factors = thinness(rng, rng.choice(["needle", "blade"]))
    names = rng.choice(SHAPES, 2)
    points1 = unit_shape(names[0]) * factors
    points2 = unit_shape(names[1]) * factors * rng.uniform(0.5, 2.0)
    if rng.random() < 0.5:
        points2 = turned(points2, quaternion(rng.normal(size=3), 10.0 ** rng.uniform(-12.0, -2.0)))
    points2 = points2 + rng.normal(size=3) * factors * rng.choice([0.0, 0.3, 1.0])
    q = random_quaternions(rng, 1)[0]
    return turned(points1, q), turned(points2, q)


def random_pair(rng, counts):
    """`(points1, points2)`: overlapping, kissing or apart; somewhere, and of some size."""
    if rng.random() < 0.2:
        counts["aligned needles and blades"] += 1
        pair = aligned_pair(rng)
    else:
        kinds = rng.choice(KINDS, 2)
        points1, points2 = (point_set(rng, kind) for kind in kinds)
        if rng.random() < 0.3:
            normal = rng.normal(size=3)
            normal /= np.linalg.norm(normal)
            shift = -oracles.gap_along(points1, points2, normal) * normal
            counts["kissing"] += 1
        else:
            shift = rng.normal(size=3) * rng.choice([0.0, 0.3, 1.0])
        pair = points1, points2 + (np.round(2 * shift) / 2 if "lattice" in kinds else shift)
    if rng.random() < 0.3:
        counts["far from the origin"] += 1
        away = 10.0 ** rng.uniform(0.0, 7.0) * rng.normal(size=3)
        return tuple(points + away for points in pair)
    if rng.random() < 0.3:
        counts["of extreme size"] += 1
        size = rng.choice(SIZES)
        return tuple(points * size for points in pair)
    return pair


def oracle_depth(points1, points2):
    """`(depth, isExact)`; a negative depth is minus the distance if isExact, else only a sign."""
    if len(points1) + len(points2) <= MOST_EXACT_POINTS:
        return oracles.exact_depth(points1, points2), True
    # near the origin, and about 1 in size: neither changes a digit that counts
    unit = math.ldexp(1.0, math.frexp(max(np.abs(points1).max(), np.abs(points2).max()))[1] - 1)
    points1, points2, middle = points1 / unit, points2 / unit, points1[0] / unit
    return oracles.thin_depth(points1 - middle, points2 - middle) * unit, False


def pairs(rng, counts):
    """Checks verdict, depth, normal and point of a pair; returns a list of complaints."""
    points1, points2 = random_pair(rng, counts)
    try:
        result = isCollision, depth, *_ = GJK.is_collide(points1, points2)
    except ValueError as error:
        counts["refused in words"] += 1
        extents = [np.linalg.svd(p - p.mean(axis=0))[1] for p in (points1, points2)]
        isFlat = any(extent[-1] < 1e-5 * extent[0] for extent in extents)
        return [] if isFlat else [f"refused: {error}"]
    expected, isExact = oracle_depth(points1, points2)
    counts["judged in whole numbers" if isExact else "judged by Qhull"] += 1
    counts["collide"] += isCollision
    size = oracles.size_of(points1, points2)
    largest = max(np.abs(points1).max(), np.abs(points2).max())
    # of coordinates, relative to the size and to the distance from the origin
    rounding = 16 * EPS * (size + largest)
    if not isCollision:
        return [f"a miss, {expected:g} deep"] if expected > rounding else []
    found = []
    if expected < -(TOUCH_TOLERANCE * size + rounding):
        # Qhull's is no distance: a corner may be as near as it likes
        found.append(f"hit, {-expected:g} apart") if isExact else None
    elif abs(depth - max(expected, 0.0)) > rounding:
        found.append(f"depth {depth:g} where it is {expected:g}, size {size:g}")
    oracles.assert_contact(points1, points2, result)
    return found


class RandomScene:
    """Bodies, ground, constraints and options; `meshes()` makes the bodies anew, at the start."""

    def __init__(self, rng):
        self.scale = 10.0 ** rng.choice([0.0, 0.0, 0.0, rng.uniform(-12.0, 11.0)])
        self.bodies = [self._random_body(rng) for _ in range(rng.integers(2, 9))]
        self.ground = oracles.ground() if rng.random() < 0.6 else None
        self.timeStep = float(rng.choice([0.02, 0.005, 0.1, 0.0]))
        self.CRCoeff = float(rng.choice([0.0, 0.5, 1.0]))
        self.constraints = []
        for _ in range(rng.choice([0, 0, 3, 12])):
            ends = rng.choice(len(self.bodies), 2, False)
            rows = [x for b in ends for x in (int(b), int(rng.integers(4)))]
            bound = float(rng.uniform(0.0, 5.0)) * self.scale
            self.constraints.append([*rows, bound, bool(rng.integers(2))])
        mu, isGyroscopic = float(rng.choice([0.0, 0.5, 1e6])), bool(rng.integers(2))
        self.options = {"mu": mu, "gyroscopic": isGyroscopic, "constraints": self.constraints}
        # of the impulse solver only
        self.impulseOptions = {"maxIterations": int(rng.choice([0, 7, 1000]))}
        self.impulseOptions["tolerance"] = float(rng.choice([0.0, 1e-3])) * self.scale

    def _random_body(self, rng):
        position = rng.choice(LATTICE, size=3)
        position[1] = abs(position[1]) + rng.integers(0, 4) * 1.4
        q = IDENTITY if rng.random() < 0.5 else random_quaternions(rng, 1)[0]
        name, density = SHAPES[rng.integers(6)], 10.0 ** rng.uniform(-1.0, 1.0)
        isFixed = bool(rng.random() < 0.3)
        velocities = np.zeros((2, 3))
        if not isFixed and rng.random() < 0.5:
            velocities = rng.choice([-0.0, 0.0, 1.0, -2.0], size=(2, 3)) * [[self.scale], [1.0]]
        return (name, position * self.scale, q, density, isFixed, 0.25 * self.scale), velocities

    def meshes(self):
        found = []
        for arguments, (linVelocity, angVelocity) in self.bodies:
            found.append(body(*arguments))
            if not found[-1].isFixed:
                found[-1].linVelocity, found[-1].angVelocity = linVelocity[None], angVelocity[None]
        return found

    def copies(self, meshes):
        """Fresh meshes in the state of others."""
        fresh = self.meshes()
        oracles.restore(fresh, oracles.state_of(meshes))
        return fresh

    def step(self, meshes, **options):
        """Makes a step; returns its `outcome`, or the state and why the step was refused."""
        try:
            options = self.options | options
            report = run_timestep(meshes, self.ground, self.timeStep, self.CRCoeff, **options)
        except StateError as error:
            return oracles.state_of(meshes).tobytes(), f"refused: {error}"
        return oracles.outcome(meshes, report)


def bits(rng, counts):
    """Steps a scene in all ways that must have the same bits; returns a list of complaints."""
    scene = RandomScene(rng)
    if rng.random() < 0.3:
        return soft_step_bits(rng, counts, scene)
    isBatched = len(scene.constraints) > 0 and rng.random() < 0.4
    schedulings = ["batches"] if isBatched else ["sweep", "queue"]
    names = "broadPhase", "contactScheduling", "constraintScheduling"
    ways = [(*way, scheduling) for way in WAYS for scheduling in schedulings]
    ways = [dict(zip(names, way, strict=True)) | scene.impulseOptions for way in ways]
    runs = [scene.meshes() for _ in ways]
    found = []
    resumes = set(rng.integers(1, 25, size=4).tolist())
    for step in range(25):
        isResumed = step in resumes
        fresh = [scene.copies(m) if isResumed else None for m in runs]
        outcomes = [scene.step(m, **way) for m, way in zip(runs, ways, strict=True)]
        counts["steps"] += len(ways)
        counts["contacts"] += outcomes[0][1].count("Contact(")
        counts["steps with constraints"] += len(scene.constraints) > 0
        for way, outcome, meshes in zip(ways, outcomes, fresh, strict=True):
            found += differences(f"step {step}: {ways[0]} and {way}", outcomes[0], outcome)
            if isResumed:
                counts["resumed"] += 1
                where = f"step {step}: {way}, stepped before and fresh"
                found += differences(where, outcome, scene.step(meshes, **way))
        isRefused = outcomes[0][1].startswith("refused")
        counts["refused in words"] += isRefused
        if found or isRefused:
            break
    return found


def differences(where, one, other):
    """Differences of two outcomes of `RandomScene.step`, as a list of complaints."""
    parts = [part for part, a, b in zip(("state", "report"), one, other, strict=True) if a != b]
    return [f"{where}: the {' and '.join(parts)} differ"] if parts else []


def soft_step_bits(rng, counts, scene):
    """Makes soft steps twice, also saved and restored at random; returns complaints."""
    options = {"contactSolver": "soft-step", "sleeping": bool(rng.integers(2))}
    options["substeps"] = int(rng.choice([1, 4, 8]))
    runs = [(scene.meshes(), SolverState()) for _ in range(3)]
    for step in range(40):
        if rng.random() < 0.2:
            meshes, solver = runs[2]
            runs[2] = scene.copies(meshes), SolverState.from_arrays(solver.arrays())
            counts["soft-step: restored"] += 1
        outcomes = [scene.step(m, solverState=solver, **options) for m, solver in runs]
        counts["soft-step: steps"] += 3
        counts["soft-step: contacts"] += outcomes[0][1].count("Contact(")
        for name, outcome in zip(("the second time", "restored"), outcomes[1:], strict=True):
            if found := differences(f"soft step {step}, {name}", outcomes[0], outcome):
                return found
        if outcomes[0][1].startswith("refused"):
            counts["refused in words"] += 1
            break
    return []


CAMPAIGNS = {one.__name__: one for one in (pairs, bits)}


def run_campaign(name, cases, seconds, seed):
    """Runs cases (an iterable of numbers) while there is time; `(counts, failures)`.

    failures : list of `(case, complaint)`
    """
    counts, failures = collections.Counter(), []
    end = time.monotonic() + seconds
    for case in cases:
        if time.monotonic() > end:
            break
        rng = np.random.default_rng([seed, case])
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            try:
                found = CAMPAIGNS[name](rng, counts)
            except Exception:
                found = [traceback.format_exc()[-600:]]
        counts["cases"] += 1
        failures += [(case, complaint) for complaint in found]
    return counts, failures


def main(options):
    cases = itertools.count() if options.case is None else [options.case]
    counts, failures = run_campaign(options.campaign, cases, 60 * options.minutes, options.seed)
    for case, complaint in failures[:20]:
        print(f"case {case} of seed {options.seed}: {complaint}")
    for name, count in sorted(counts.items()):
        print(f"{name:<48} {count}")
    print(f"{'failures':<48} {len(failures) or 'none'}")
    return int(len(failures) > 0)
