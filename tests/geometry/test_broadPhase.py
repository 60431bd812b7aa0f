"""The uniform grid: the same pairs as comparing all boxes, and the same motion to the last bit."""

import itertools
from collections import Counter

import numpy as np
import pytest
from oracles import SHAPES, body, box_body, outcome, quaternion

from rbs.geometry.broadphase import grid_overlaps
from rbs.geometry.facets import find_facets
from rbs.stepping import batches
from RBSFunctions import ground as make_ground, run_timestep

# Per kind of scene: the range of the boxes' sides as powers of ten, and half the width of the
# region that their least corners lie in.
KINDS = {
    "alike": ((0.3, 0.7), 15.0),
    "from 0.1 to 1000": ((-1.0, 3.0), 300.0),
    "crowded": ((0.0, 0.5), 8.0),
    "sparse": ((0.0, 0.3), 40.0),
}


def random_boxes(rng, kind, count):
    """(6, n): least coordinates, and greatest ones negated."""
    (low, high), region = KINDS[kind]
    corner = rng.uniform(-region, region, (3, count))
    return np.concatenate((corner, -(corner + 10 ** rng.uniform(low, high, (3, count)))))


def all_overlaps(box):
    """Pairs i < j whose boxes overlap, in that order, by comparing all of them: (2, P)."""
    low, high = box[:3], -box[3:]
    near = ((low[:, :, None] <= high[:, None]) & (low[:, None] <= high[:, :, None])).all(axis=0)
    return np.argwhere(np.triu(near, 1)).T


def assert_same_pairs(box):
    """Asserts that the grid finds the same pairs as comparing all, in order; returns how many."""
    expected, found = all_overlaps(box), grid_overlaps(box)
    assert np.array_equal(expected, found)
    assert (found[0] < found[1]).all()
    return found.shape[1]


@pytest.mark.parametrize("kind", KINDS)
def test_grid_finds_the_pairs_that_comparing_all_finds(kind):
    rng = np.random.default_rng(1)
    pairs = [assert_same_pairs(random_boxes(rng, kind, n)) for n in rng.integers(1, 300, 30)]
    assert sum(pairs) > (10 if kind == "sparse" else 1000)


@pytest.mark.parametrize("places", [0, 999_990, -7_000_000], ids=["near", "far", "beyond"])
def test_boxes_that_touch_within_rounding_on_the_borders_of_cells_are_pairs(places):
    """Sides and corners are whole numbers of sides, more or less by one or a few roundings."""
    rng, total = np.random.default_rng(2), 0
    assert grid_overlaps(np.zeros((6, 0))).shape == (2, 0)
    for _ in range(42):
        side = 10.0 ** rng.integers(-6, 7)
        corners = rng.integers(places, places + 5, (3, 80)) * side
        sides = side * rng.choice([1.0, 0.125, 2.0], 80, p=[0.8, 0.1, 0.1])
        low, high = corners, corners + sides
        for _ in range(2):
            low = np.where(rng.random(low.shape) < 0.3, np.nextafter(low, -np.inf), low)
            high = np.where(rng.random(low.shape) < 0.3, np.nextafter(high, -np.inf), high)
            low = low - rng.choice([0.0, 1e-17 * side], low.shape)
        box = np.concatenate((low, -high))
        box[:, 7], box[:, 9] = np.inf, np.nan  # as of a mesh without vertices
        total += assert_same_pairs(box)
    assert total > 10_000


# Three ways to make the same step.
WAYS = {"all": {}, "grid": {"broadPhase": "grid"}, "batches": {"contactScheduling": "batches"}}
# What rbs/stepping/batches.py makes margins of: too little, with nothing remembered; as usual; too
# much. That changes what a step costs, never what comes of it.
NOTHING = {"vectors.known_columns": lambda keys, *known: np.zeros((3, len(keys)))}
MARGINS = (
    {"LEAST_MARGIN": 1e-9, "MARGIN_GROWTH": 0, "FACET_MARGIN": 0} | NOTHING,
    {},
    {"LEAST_MARGIN": 0.1, "MARGIN_GROWTH": 10.0, "FACET_MARGIN": 2.0},
)


def make_heap(seed):
    """20 meshes of mixed shapes and sizes, turned at random, that overlap above the ground."""
    rng = np.random.default_rng(seed)
    meshes = []
    for k in range(20):
        name, size = SHAPES[k % len(SHAPES)], np.exp(rng.uniform(*np.log([0.3, 3.0])))
        position, density = rng.uniform((-12, 4, -12), (12, 28, 12)), rng.uniform(0.5, 2.0)
        mesh = body(name, position, rng.normal(size=4), density, k % 11 == 10, size)
        if not mesh.isFixed:
            mesh.linVelocity = rng.normal(size=(1, 3)) * [3.0, 10.0, 3.0]
            mesh.angVelocity = rng.normal(size=(1, 3))
        meshes.append(mesh)
    return meshes


def in_all_ways(make, groundMesh, timeStep, e, steps=1, **options):
    """Steps the meshes that make() makes, in all WAYS, which have to give the same bits.

    Returns the meshes at the end, and the contacts of all steps.
    """
    outcomes = []
    for way in WAYS.values():
        meshes, contacts = make(), []
        outcomes.append([])
        for _ in range(steps):
            report = run_timestep(meshes, groundMesh, timeStep, e, **way, **options)
            contacts += report.contacts
            outcomes[-1].append(outcome(meshes, report))
    assert outcomes[0] == outcomes[1] == outcomes[2]
    return meshes, contacts


def test_zeros_keep_their_sign_on_the_ground():
    """Cubes beside each other, with positions and velocities of 0.0 and -0.0, on the ground."""

    def cubes():
        meshes = []
        for k, row in enumerate(np.array([*itertools.product((0.0, -0.0), repeat=3)])):
            meshes.append(box_body(1.0, 1.0, 1.0, (2.0 * k, 0.4, row[2])))
            meshes[-1].linVelocity, meshes[-1].angVelocity = row, row[::-1]
        return meshes

    meshes, contacts = in_all_ways(cubes, make_ground(), 0.0, 0.5)
    assert len(contacts) == 8
    state = np.array([(mesh.linVelocity, mesh.angVelocity) for mesh in meshes])
    assert 0 < np.signbit(state[state == 0.0]).sum() < (state == 0.0).sum()


@pytest.mark.parametrize("side", [1e2, 1e10])
def test_bodies_thrown_far_out_of_a_huge_one_leave_those_that_they_touched(side, monkeypatch):
    """Facets found where they touched are not valid where they have gone, and are found anew."""
    anew = []

    def watched(pairs, margin, *separation):
        if not margin.any():
            anew.append(len(margin))
        return find_facets(pairs, margin, *separation)

    def bodies():
        rng = np.random.default_rng(1)
        place, turn = (0.9 * side, 0, 0), quaternion([0, 1, 0], 20)
        huge = box_body(2 * side, 4 * side, 3 * side, place, orientation=turn, isFixed=True)
        meshes = [huge]
        for k, y in itertools.product(range(40), (0.0, 0.99)):
            place, turn = (k % 7 * 20, y, k // 7 * 20), quaternion([0, 1, 0], rng.uniform(0, 90))
            meshes.append(box_body(1, 1, 1, place, orientation=turn, isFixed=y > 0))
        return meshes

    monkeypatch.setattr(batches, "find_facets", watched)
    assert len(in_all_ways(bodies, None, 1e-6, 0.0)[1]) >= 20
    assert max(anew) > 10  # many at once, in the batches


@pytest.mark.parametrize("seed", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in (2, 3))])
def test_margins_change_no_bit_of_heaps_of_mixed_sizes(seed, monkeypatch):
    """Small margins cost repeated passes and searches for facets, and nothing else."""
    counts = []

    def counted(name, function):
        def call(*arguments):
            counts[-1][name] += 1
            return function(*arguments)

        return call

    for margins in MARGINS:
        counts.append(Counter())
        with monkeypatch.context() as patch:
            for name, value in margins.items():
                patch.setattr(f"rbs.stepping.batches.{name}", value)
            patch.setattr(batches, "find_facets", counted("searches", find_facets))
            passing = counted("passes", batches.Pass.process)
            patch.setattr(batches.Pass, "process", passing)
            step = make_ground(), 0.02, 0.3, 14
            contacts = in_all_ways(lambda: make_heap(seed), *step, mu=0.5 * (seed % 2))[1]
    assert len(contacts) > 150
    small, usual, large = ([count["searches"], count["passes"]] for count in counts)
    assert small[0] > 1.3 * usual[0] and usual[0] > 1.2 * large[0]
    assert small[1] > 1.5 * large[1] > 0
