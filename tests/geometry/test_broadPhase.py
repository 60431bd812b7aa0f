"""The uniform grid: the same pairs as comparing all boxes, and the same motion to the last bit."""

import itertools
import subprocess
import sys
from collections import Counter

import numpy as np
import pytest
from oracles import SHAPES, body, box_body, outcome, quaternion, rotation

from rbs.geometry.broadphase import grid_overlaps
from rbs.geometry.facets import find_facets
from rbs.scenes.scenefiles import DATA_FOLDER
from rbs.stepping import batches
from RBSFunctions import ground as make_ground, run_timestep
from RigidBodySimulation import load_scene_file

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


def all_overlaps(box, isFixed):
    """Pairs i < j whose boxes overlap, in that order, by comparing all of them: (2, P)."""
    low, high = box[:3], -box[3:]
    near = ((low[:, :, None] <= high[:, None]) & (low[:, None] <= high[:, :, None])).all(axis=0)
    near &= ~(isFixed[:, None] & isFixed)
    return np.argwhere(np.triu(near, 1)).T


def assert_same_pairs(box, isFixed):
    """The grid finds the pairs that comparing all finds, in order; returns how many."""
    expected, found = all_overlaps(box, isFixed), grid_overlaps(box, isFixed)
    assert np.array_equal(expected, found)
    assert (found[0] < found[1]).all()
    return found.shape[1]


@pytest.mark.parametrize("kind", KINDS)
def test_grid_finds_the_pairs_that_comparing_all_finds(kind):
    rng = np.random.default_rng(1)
    pairs = [
        assert_same_pairs(random_boxes(rng, kind, n), rng.random(n) < rng.random())
        for n in rng.integers(1, 300, 30)
    ]
    assert sum(pairs) > (10 if kind == "sparse" else 1000)


def test_boxes_that_only_touch_on_the_borders_of_cells_are_pairs():
    # Unit boxes on whole numbers: each touches its 26 neighbours, on cell borders throughout.
    corner = np.stack(np.meshgrid(*[np.arange(5.0)] * 3)).reshape(3, -1)
    box = np.concatenate((corner, -(corner + 1.0)))
    # Along an axis of 5 there are 5 + 2 · 4 = 13 ordered pairs at a distance of at most 1, of
    # which 5 are of a place with itself: (13³ - 5³) / 2 unordered pairs of boxes.
    assert assert_same_pairs(box, np.zeros(125, bool)) == (13**3 - 5**3) // 2


def test_what_has_no_box_is_in_no_pair():
    box = random_boxes(np.random.default_rng(3), "crowded", 100)
    box[:, 7], box[:, 9] = np.inf, np.nan  # as of a mesh without vertices
    assert assert_same_pairs(box, np.zeros(100, bool)) > 0
    assert not np.isin((7, 9), grid_overlaps(box, np.zeros(100, bool))).any()
    assert grid_overlaps(np.zeros((6, 0)), np.zeros(0, bool)).shape == (2, 0)


def test_batches_keep_the_order_of_pairs_that_share_a_moving_body():
    rng = np.random.default_rng(4)
    isFixed = rng.random(40) < 0.2
    pairs = np.unique(np.sort(rng.integers(0, 40, (400, 2)), axis=1), axis=0)
    pairs = pairs[(pairs[:, 0] < pairs[:, 1]) & ~isFixed[pairs].all(axis=1)]
    order, starts = batches.in_batches(*pairs.T, isFixed)
    assert sorted(order) == list(range(len(pairs))) == list(range(starts[-1]))
    batch = np.empty(len(pairs), dtype=int)
    batch[order] = np.arange(len(starts) - 1).repeat(np.diff(starts))
    shared = 0
    for earlier, later in itertools.combinations(range(len(pairs)), 2):
        if any(not isFixed[b] for b in {*pairs[earlier]} & {*pairs[later]}):
            shared += 1
            assert batch[earlier] < batch[later]
    assert shared > 1000 and batch.max() < len(pairs) - 1


# Three ways to make the same step.
WAYS = {"all": {}, "grid": {"broadPhase": "grid"}, "batches": {"contactScheduling": "batches"}}
# What rbs/stepping/batches.py makes margins of: too little, with nothing remembered; as usual; too
# much. That changes what a step costs, never what comes of it.
MARGINS = (
    {"LEAST_MARGIN": 1e-9, "MARGIN_GROWTH": 0, "FACET_MARGIN": 0, "memory_of": batches.Memory},
    {},
    {"LEAST_MARGIN": 0.1, "MARGIN_GROWTH": 10.0, "FACET_MARGIN": 2.0},
)


def make_heap(seed, count=20):
    """`count` meshes of mixed shapes and sizes, turned at random, that overlap above the ground."""
    rng = np.random.default_rng(seed)
    meshes = []
    for k in range(count):
        name, size = SHAPES[k % len(SHAPES)], np.exp(rng.uniform(*np.log([0.3, 3.0])))
        position, density = rng.uniform((-12, 4, -12), (12, 28, 12)), rng.uniform(0.5, 2.0)
        mesh = body(name, position, rng.normal(size=4), density, k % 11 == 10, size)
        if not mesh.isFixed:
            mesh.linVelocity = rng.normal(size=(1, 3)) * [3.0, 10.0, 3.0]
            mesh.angVelocity = rng.normal(size=(1, 3))
        meshes.append(mesh)
    return meshes


def motion(meshes, steps, **options):
    """`(outcomes, contacts)` of some steps: the `outcome` of each, and the number of contacts."""
    outcomes, contacts = [], 0
    for _ in range(steps):
        report = run_timestep(meshes, make_ground(), 0.02, 0.3, **options)
        contacts += len(report.contacts)
        outcomes.append(outcome(meshes, report))
    return outcomes, contacts


@pytest.mark.parametrize("seed", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in (2, 3))])
def test_margins_change_no_bit_of_heaps_of_mixed_sizes(seed, monkeypatch):
    """Small margins cost repeated passes and searches for facets, and nothing else."""
    mu, counts = 0.5 * (seed % 2), []
    expected, contacts = motion(make_heap(seed), 20, mu=mu)
    assert contacts > 150
    assert motion(make_heap(seed), 20, mu=mu, **WAYS["grid"])[0] == expected

    def counted(name, function):
        def call(*arguments):
            counts[-1][name] += 1
            return function(*arguments)

        return call

    for margins in MARGINS:
        counts.append(Counter())
        with monkeypatch.context() as patch:
            for name, value in margins.items():
                patch.setattr(batches, name, value)
            patch.setattr(batches, "find_facets", counted("searches", find_facets))
            passing = counted("passes", batches.Pass.process_expected)
            patch.setattr(batches.Pass, "process_expected", passing)
            assert motion(make_heap(seed), 20, mu=mu, **WAYS["batches"])[0] == expected
    small, usual, large = ([count["searches"], count["passes"]] for count in counts)
    assert small[0] > 1.5 * usual[0] and usual[0] > 1.2 * large[0]
    assert small[1] > 1.5 * usual[1] > 0


def test_all_ways_give_the_same_bits_of_a_scene():
    scenes = (load_scene_file(DATA_FOLDER / "stress-scene.txt") for _ in WAYS)
    runs = [
        motion(meshes, 170, mu=0.4, closingOnly=True, **way)
        for meshes, way in zip(scenes, WAYS.values(), strict=True)
    ]
    assert runs[0] == runs[1] == runs[2] and runs[0][1] > 100


def test_zeros_keep_their_sign_on_the_ground():
    """Cubes beside each other, with positions and velocities of 0.0 and -0.0, on the ground."""
    outcomes, rows = [], np.array([*itertools.product((0.0, -0.0), repeat=3)])
    for way in WAYS.values():
        meshes = [box_body(1.0, 1.0, 1.0, (2.0 * k, 0.4, z)) for k, (_, _, z) in enumerate(rows)]
        for mesh, row in zip(meshes, rows, strict=True):
            mesh.linVelocity, mesh.angVelocity = row, row[::-1]
        report = run_timestep(meshes, make_ground(), 0.0, 0.5, **way)
        assert len(report.contacts) == 8
        outcomes.append(outcome(meshes, report))
    assert outcomes[0] == outcomes[1] == outcomes[2]
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

    monkeypatch.setattr(batches, "find_facets", watched)
    outcomes = []
    for way in WAYS.values():
        rng = np.random.default_rng(1)
        turn = quaternion([0, 1, 0], 20)
        place, sizes = (0.9 * side, 0, 0), (2 * side, 4 * side, 3 * side)
        meshes = [box_body(*sizes, place, orientation=turn, isFixed=True)]
        for k, y in itertools.product(range(40), (0.0, 0.99)):
            turn, place = (
                quaternion([0, 1, 0], rng.uniform(0, 90)),
                (20.0 * (k % 7), y, k // 7 * 20),
            )
            meshes.append(box_body(1, 1, 1, place, orientation=turn, isFixed=y > 0))
        report = run_timestep(meshes, None, 1e-6, 0.0, **way)
        outcomes.append(outcome(meshes, report))
        assert len(report.contacts) >= 20
    assert outcomes[0] == outcomes[1] == outcomes[2]
    assert max(anew) > 10  # many at once, in the batches


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
def test_a_body_pushed_out_of_its_box_hits_what_it_is_pushed_into(way):
    """At the start, the boxes of the second and third body are 0.2 apart."""
    meshes = [box_body(1.0, 1.0, 1.0, (x, 0.0, 0.0), isFixed=x != 0.6) for x in (0.0, 0.6, 1.8)]
    contacts = run_timestep(meshes, None, 1e-6, 0.0, **way).contacts
    assert [(contact.body1, contact.body2) for contact in contacts] == [(0, 1), (1, 2)]
    assert [contact.depth for contact in contacts] == pytest.approx([0.4, 0.2])


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
@pytest.mark.parametrize("isPushedFirst", [True, False])
def test_a_body_pushed_over_a_gap_within_its_box_hits_in_the_same_step(isPushedFirst, way):
    """Seen from above, a square beside a diamond: their boxes overlap, they are 0.41 apart.

    A fixed diamond pushes the square by 0.8 along the diagonal: over the gap, into the other one.
    """
    diagonal = np.array([1.0, 0.0, 1.0]) / np.sqrt(2)
    turn = quaternion([0, 1, 0], 45)
    square = box_body(2.0, 2.0, 2.0, (2.0, 0.0, 2.0))
    diamond = box_body(2.0, 2.0, 2.0, (0.0, 0.0, 0.0), orientation=turn)
    place = np.array([2.0, 0.0, 2.0]) + (1.0 + np.sqrt(2) - 0.8) * diagonal
    pusher = box_body(2.0, 2.0, 2.0, place, orientation=turn, isFixed=True)
    meshes = [pusher, square, diamond] if isPushedFirst else [pusher, diamond, square]
    contacts = run_timestep(meshes, None, 1e-6, 0.0, **way).contacts
    k = meshes.index(square)
    assert [(contact.body1, contact.body2) for contact in contacts] == [(0, k), (1, 2)]
    gap = (2.0 - np.sqrt(2)) / np.sqrt(2)
    assert [contact.depth for contact in contacts] == pytest.approx([0.8, 0.8 - gap])


def test_a_body_that_is_pushed_to_and_fro_hits_what_it_meets_on_the_way():
    """A fixed body pushes the first one over a gap into the third, and the fourth one back.

    Neither at the start of the pass nor at its end does the first one touch the third.
    """
    turn = quaternion([0, 0, 1], 30)  # so that boxes overlap in spite of the gap

    def slab(x, y, height, isFixed=True):
        place = rotation(turn).apply((x, y, 0.0))
        return box_body(1.0, height, 1.0, place, orientation=turn, isFixed=isFixed)

    outcomes = []
    for way in WAYS.values():
        meshes = slab(0.0, 0.0, 2.4, isFixed=False), slab(-0.9, 0.0, 1.0)
        meshes = [*meshes, slab(1.05, 0.6, 1.0), slab(0.98, -0.6, 1.0)]
        report = run_timestep(meshes, None, 1e-6, 0.5, **way)
        outcomes.append(outcome(meshes, report))
    assert outcomes[0] == outcomes[1] == outcomes[2]
    assert [contact.body2 for contact in report.contacts] == [1, 2, 3]
    assert [contact.depth for contact in report.contacts] == pytest.approx([0.1, 0.05, 0.07])


def test_piles_are_made_as_asked():
    def pile(*arguments):
        command = [sys.executable, DATA_FOLDER / "scripts" / "make_pile.py", *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout

    assert pile(200) == (DATA_FOLDER / "pile_200-scene.txt").read_text()
    assert pile(1000, "--heap") == (DATA_FOLDER / "heap-scene.txt").read_text()
    layer = [line.split() for line in pile(30, "--spread", "--shapes", "box").splitlines()[2:]]
    assert len(layer) == 30 and {row[0] for row in layer} == {"box.mesh"}
    # one layer, jittered by half a metre up and down
    assert np.ptp([float(row[4]) for row in layer]) <= 1.0
