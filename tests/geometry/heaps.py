"""Seeded heaps of mixed sizes collapse with both steps, which are compared bit by bit.

The accelerated step guesses how far contacts will move the bodies, and looks for pairs and facets
within that margin. Here the margin is next to nothing, always too small; as usual; and much too
large. That may change what a step costs, never what comes of it.
"""

from collections import Counter
from contextlib import contextmanager

import numpy as np
import pytest
from oracles import body, ground, outcome

from rbs.stepping import batches
from RBSFunctions import run_timestep

SHAPES = ("box", "tetrahedron", "octahedron", "cylinder")
SIZES = (0.3, 3.0)  # the least and the largest body, in multiples of a shape's
# What rbs/stepping/batches.py makes margins of: too little, with nothing remembered; as usual; too
# much.
MARGINS = {
    "too small": {
        "LEAST_MARGIN": 1e-9,
        "MARGIN_GROWTH": 0.0,
        "FACET_MARGIN": 0.0,
        "memory_of": batches.Memory,
    },
    "as usual": {},
    "too large": {"LEAST_MARGIN": 0.1, "MARGIN_GROWTH": 10.0, "FACET_MARGIN": 2.0},
}


def make_heap(seed, count):
    """`count` meshes of mixed shapes and sizes, turned at random, that overlap above the ground."""
    rng = np.random.default_rng(seed)
    meshes = []
    side = 9.0 * count ** (1 / 3)
    for k in range(count):
        size = np.exp(rng.uniform(*np.log(SIZES)))
        orientation = rng.normal(size=4)
        position = rng.uniform((-side / 2, 4.0, -side / 2), (side / 2, 4.0 + side, side / 2))
        density = rng.uniform(0.5, 2.0)
        mesh = body(SHAPES[k % len(SHAPES)], position, orientation, density, k % 11 == 10, size)
        if not mesh.isFixed:
            mesh.linVelocity = rng.normal(size=(1, 3)) * [3.0, 10.0, 3.0]
            mesh.angVelocity = rng.normal(size=(1, 3))
        meshes.append(mesh)
    return meshes


@contextmanager
def counting():
    """Counts the searches for facets and the passes over pairs within the block: a Counter."""
    counts = Counter()

    def counted(name, function):
        def call(*arguments):
            counts[name] += 1
            return function(*arguments)

        return call

    with pytest.MonkeyPatch.context() as patch:
        for place, attribute, name in (
            (batches, "find_facets", "searches"),
            (batches.Pass, "process_expected", "passes"),
        ):
            patch.setattr(place, attribute, counted(name, getattr(place, attribute)))
        yield counts


def outcomes_of(seed, count, steps, mu, **way):
    """`(outcomes, contacts)` of a heap: the `outcome` of each step, and its contacts."""
    meshes, outcomes, contacts = make_heap(seed, count), [], 0
    for _ in range(steps):
        report = run_timestep(meshes, ground(), 0.02, 0.3, mu=mu, **way)
        contacts += len(report.contacts)
        outcomes.append(outcome(meshes, report))
    return outcomes, contacts


def compare(seed, count, steps):
    """Runs a heap with all of MARGINS, and with the grid: `(differing, contacts, counts)`.

    differing : names of those that give other bits; contacts : number of contacts
    counts : (3, 2), searches and passes with each of MARGINS
    """
    mu = 0.5 * (seed % 2)
    expected, contacts = outcomes_of(seed, count, steps, mu)
    found, _ = outcomes_of(seed, count, steps, mu, broadPhase="grid")
    differing, counts = ["of the grid"] * (found != expected), []
    for margins, values in MARGINS.items():
        with pytest.MonkeyPatch.context() as patch, counting() as counted:
            for name, value in values.items():
                patch.setattr(batches, name, value)
            found, _ = outcomes_of(seed, count, steps, mu, contactScheduling="batches")
        counts.append((counted["searches"], counted["passes"]))
        if found != expected:
            differing.append(margins)
    return differing, contacts, np.array(counts)
