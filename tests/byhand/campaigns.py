"""A campaign: random pairs of hulls for as long as is wanted, against independent answers.

`is_collide` against whole-number arithmetic and stretched Minkowski differences: needles, blades,
lattices and solids; overlapping, kissing and apart; up to 1e7 from the origin, and from 1e-30 to
1e11 in size. Prints counts, and each failure with the number of its case.
"""

import collections
import itertools
import math
import time
import traceback
import warnings

import numpy as np
import oracles
from oracles import SHAPES, quaternion, random_quaternions, turned

import GJK
from rbs.geometry.hulls import TOUCH_TOLERANCE

EPS = np.finfo(float).eps
# Shapes of so few vertices that whole-number arithmetic takes milliseconds; the others are judged
# by Qhull.
FEW = ("tetrahedron", "box", "octahedron", "long-octahedron")
MOST_EXACT_POINTS = 20
KINDS = ("lattice", "curved", "solid", "needle", "blade")
SIZES = (1e-30, 1e-12, 1e-6, 1e6, 1e11)


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
    return oracles.minkowski_depth(points1 - middle, points2 - middle) * unit, False


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


def run_campaign(cases, seed):
    """Runs cases (an iterable of numbers): counts, and failures as a list of `(case, why)`."""
    counts, failures = collections.Counter(), []
    for case in cases:
        rng = np.random.default_rng([seed, case])
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            try:
                found = pairs(rng, counts)
            except Exception:
                found = [traceback.format_exc()[-600:]]
        counts["cases"] += 1
        failures += [(case, complaint) for complaint in found]
    return counts, failures


def main(options):
    end, cases = time.monotonic() + 60 * options.minutes, itertools.count()
    cases = itertools.takewhile(lambda _: time.monotonic() < end, cases)
    cases = cases if options.case is None else [options.case]
    counts, failures = run_campaign(cases, options.seed)
    for case, complaint in failures[:20]:
        print(f"case {case} of seed {options.seed}: {complaint}")
    for name, count in sorted(counts.items()):
        print(f"{name:<48} {count}")
    print(f"{'failures':<48} {len(failures) or 'none'}")
    return int(len(failures) > 0)
