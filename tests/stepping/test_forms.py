"""A step pair by pair, with the grid, and in batches on arrays: the same motion to the last bit."""

import itertools
from collections import Counter

import numpy as np
import pytest
from engines import throw
from oracles import SHAPES, body, box_body, ground, quaternion, random_quaternions, state_of

from rbs.geometry.facets import find_facets
from rbs.stepping import batches
from RBSFunctions import run_timestep

# Three ways to make the same step.
WAYS = {}, {"broadPhase": "grid"}, {"contactScheduling": "batches"}
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
            throw(mesh, rng.normal(size=3) * [3.0, 10.0, 3.0], rng.normal(size=3))
        meshes.append(mesh)
    return meshes


def in_all_ways(make, groundMesh, timeStep, e, steps=1, **options):
    """Steps the meshes that make() makes, in all WAYS, which have to give the same bits, the signs
    of zeros included.

    Returns the meshes at the end, and the contacts of all steps.
    """
    outcomes = []
    for way in WAYS:
        meshes, contacts = make(), []
        outcomes.append([])
        for _ in range(steps):
            report = run_timestep(meshes, groundMesh, timeStep, e, **way, **options)
            contacts += report.contacts
            outcomes[-1].append((state_of(meshes).tobytes(), repr(report.contacts)))
    assert outcomes[0] == outcomes[1] == outcomes[2]
    return meshes, contacts


def make_pairs():
    """300 pairs of bodies of all shapes, masses and speeds, far apart; two thirds of them meet.

    In every third pair, neither is turned, so that faces and edges rest on each other.
    """
    rng, meshes = np.random.default_rng(4), []
    for k, turns in enumerate(random_quaternions(rng, 600).reshape(300, 2, 4)):
        for i in range(2):
            q, density = turns[i] if k % 3 else (1, 0, 0, 0), 10.0 ** rng.uniform(-3, 3)
            mesh = body(rng.choice(SHAPES), (100.0 * k, 0, 0), q, density, isFixed=k % 5 == i)
            speed, spin = rng.normal(size=(2, 3)) * 10.0 ** rng.uniform([[-1], [-6]], 1, (2, 1))
            meshes.append(throw(mesh, speed, spin if k % 11 else (0, 0, 0)))
        way = rng.normal(size=3)
        way *= (meshes[-2].hull.radius + mesh.hull.radius) / np.linalg.norm(way)
        mesh.position = mesh.position + rng.uniform() * way
    return meshes


@pytest.mark.parametrize(("timeStep", "mu"), [(0.02, 0.4), (0.3, 2.0)])
def test_a_contact_has_the_same_bits_alone_and_in_batches(timeStep, mu):
    given = {"mu": mu, "gyroscopic": timeStep == 0.02}
    _, contacts = in_all_ways(make_pairs, None, timeStep, 0.5, **given)
    closing = [c for c in contacts if c.impulse > 0.0]
    sliding = sum(np.linalg.norm(c.friction) > mu * c.impulse * (1 - 1e-12) for c in closing)
    assert len(contacts) > 150 and 10 < sliding < len(closing) - 10


def test_zeros_keep_their_sign_on_the_ground():
    """Cubes beside each other, with positions and velocities of 0.0 and -0.0, on the ground."""

    def cubes():
        meshes = []
        for k, row in enumerate(np.array([*itertools.product((0.0, -0.0), repeat=3)])):
            meshes.append(box_body(1.0, 1.0, 1.0, (2.0 * k, 0.4, row[2])))
            meshes[-1].linVelocity, meshes[-1].angVelocity = row, row[::-1]
        return meshes

    meshes, contacts = in_all_ways(cubes, ground(), 0.0, 0.5, mu=0.5)
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
    counts, turntable = [], throw(ground(), (1.0, 0.0, -2.0), (0.0, 3.0, 0.0))

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
            step = turntable, 0.02, 0.3, 14
            contacts = in_all_ways(lambda: make_heap(seed), *step, mu=0.5 * (seed % 2))[1]
    assert len(contacts) > 150
    small, usual, large = ([count["searches"], count["passes"]] for count in counts)
    assert small[0] > 1.3 * usual[0] and usual[0] > 1.2 * large[0]
    assert small[1] > 1.5 * large[1] > 0
