"""The soft-step solver: closed forms, conservation, rest, sleeping, constraints, removed bodies."""

import copy
import itertools

import experiments
import numpy as np
import oracles
import pytest
from engines import throw
from experiments import (
    HANGING,
    beads,
    box,
    energy,
    fall,
    farthest,
    kinetic,
    linked_in_lanes,
    nearest,
    top_speed,
)
from oracles import body, box_body, penetrations, quaternion, random_quaternions, rotation, state_of
from scipy.spatial.transform import Rotation

from rbs.scenes.simulation import SceneSimulation
from rbs.softstep.detection import separation_growths
from rbs.softstep.manifolds import four_points
from rbs.softstep.step import SolverState
from rbs.stepping.settings import GRAVITY

H = 0.02


def simulate(meshes, steps, state=None, CRCoeff=0.0, timeStep=H, **more):
    """Steps of the soft-step solver, with friction 0.5; returns its state and the last report."""
    more["solverState"] = state = SolverState() if state is None else state
    given = "soft step", meshes, steps * timeStep, timeStep, CRCoeff
    return state, experiments.run(*given, **more)[0].report


def test_corners_that_are_selected_twice_are_points_once_in_one_order_on_every_processor():
    """Four are selected out of one to three. How NumPy sorts ties depends on the processor."""
    rng = np.random.default_rng(1)
    row = np.arange(60).repeat(np.arange(60) % 3 + 1)
    u, v, separation, growth = rng.normal(size=(4, len(row)))
    chosen, isPoint = four_points(row, u, v, separation, growth, np.ones(60), np.full(60, 9.0))
    assert np.array_equal(isPoint.sum(axis=0), np.bincount(row))
    isAgain = chosen[1:] == chosen[:-1]
    assert (chosen[1:] >= chosen[:-1]).all() and not (isPoint[1:] & isAgain).any()


def test_the_deepest_point_is_always_in_the_manifold():
    rng = np.random.default_rng(5)
    met = 0
    for _ in range(120):
        names = rng.choice(["box", "octahedron", "tetrahedron", "cylinder"], 2)
        turns = random_quaternions(rng, 2)
        one = body(names[0], (0, 0, 0), turns[0])
        two = body(names[1], rng.normal(size=3) * 4, turns[1])
        isCollision, depth, normal, _ = one.detect_collision(two)
        if isCollision:
            met += 1
            _, report = simulate([one, two], 1, hasGround=False, timeStep=1e-3, gravity=(0, 0, 0))
            assert max(c.depth for c in report.contacts) == pytest.approx(depth, abs=1e-9)
            assert np.allclose([c.normal for c in report.contacts], normal, atol=1e-9)
            assert 1 <= len(report.contacts) <= 4
    assert 40 < met < 120


@pytest.mark.parametrize("seed", range(5))
def test_points_of_two_bodies_end_where_their_ways_bring_them(seed):
    """Points at one place seen along the normal, on either body; along the normal, turns by less
    than 1e-4 rad move them in the same way, to first order.
    """
    rng = np.random.default_rng(seed)
    position, shift, turn = rng.normal(size=(3, 2, 3)) * [[[5.0]], [[1.0]], [[1e-5]]]
    axes = rotation(random_quaternions(rng, 1)[0]).as_matrix()  # tangent, n × tangent, normal
    u, v, t = *rng.normal(size=2), position[1] - position[0]
    ends = [
        place + d + Rotation.from_rotvec(w).apply(position[1] + axes[:, :2] @ (u, v) - place)
        for place, d, w in zip(position, shift, turn, strict=True)
    ]
    displacements = np.concatenate((shift.T, turn.T))[..., None]
    columns = axes[:, 2:], axes[:, :1], t[:, None], displacements, np.array([0]), u, v
    growth = (ends[1] - ends[0]) @ axes[:, 2]
    assert separation_growths(*columns) == pytest.approx([growth], abs=1e-8)


@pytest.mark.parametrize("roll", [8.0, 9.0, 9.5])
def test_a_cylinder_in_the_ground_touches_it_with_both_ends_of_its_side(roll):
    """The next sides, which are above the ground, end farther away from the deepest corner. If that
    counted, a loaded cylinder would rock from one end to the other, and sink deeper.
    """
    tilted = rotation(quaternion((1, 0, 0), 0.06)) * rotation(quaternion((0, 0, 1), roll))
    cylinder, state = body("cylinder", orientation=tilted.as_quat()[[3, 0, 1, 2]]), SolverState()
    cylinder.position[0, 1] -= cylinder.lowest_vertex()[1] + 0.16
    order = np.argsort(cylinder.currVertices[:, 1])
    assert ((cylinder.currVertices[order, 1] < -0.1) == (np.arange(len(order)) < 2)).all()
    side = tilted.inv().apply(cylinder.currVertices[order[:2]] - cylinder.position)
    simulate([cylinder], 1, state)
    points = state.manifolds.anchor1[:, state.manifolds.isPoint[:, 0], 0].T
    assert np.linalg.norm(points[:, None] - side, axis=2).min(axis=0).max() < 1e-9


@pytest.mark.parametrize("scale, timeStep", [(0.05, 1 / 240), (50.0, 1 / 30)])
def test_a_stack_rests_whatever_its_size_and_the_time_step(scale, timeStep):
    side = 2 * scale
    meshes = [box_body(side, side, side, (0, (i + 0.5) * side, 0)) for i in range(4)]
    start = state_of(meshes)
    simulate(meshes, 60, timeStep=timeStep, sleeping=False)
    # Springs whose frequency is relative to the substeps' give way by a part of g h², whatever the
    # size: a load of N m g on a contact with the mass m/K sinks by K N g / (2 π f)², with f = 0.165
    # per substep. N = 4, 3, 2, 1. A body with two contacts counts as 0.8 m in each, so K = 1/0.8
    # on the ground, 2/0.8 between two such bodies, and 1 + 1/0.8 below the top one.
    split = np.array([1.25, 2.5, 2.5, 2.25])
    sinks = np.cumsum(split * [4, 3, 2, 1]) * -GRAVITY * (timeStep / 6 / (2 * np.pi * 0.165)) ** 2
    assert (start - state_of(meshes))[:, 1] == pytest.approx(sinks, rel=0.05)
    assert top_speed(meshes) < 0.01 * np.sqrt(-GRAVITY * scale)


def test_a_cylinder_that_wobbles_on_its_edge_gains_no_energy():
    """It is 20 m high, with a radius of 5 m. If springs that lift it did work, it would gain up to
    0.54 J/kg on a slab.
    """
    cylinders, slabs, energies = [], [], []
    for k, (tilt, turn, isOnSlab) in enumerate(
        [(0.02, 1.0, False), (0.02, 1.6, False), (0.02, 1.6, True), (0.05, 1.6, True)]
    ):
        axis = np.array([np.cos(turn), 0.0, np.sin(turn)])
        upright = rotation(quaternion((1, 0, 0), 90))
        tilted = (rotation(quaternion(axis, np.degrees(tilt))) * upright).as_quat()[[3, 0, 1, 2]]
        cylinders.append(body("cylinder", (100.0 * k, 0.0, 0.0), tilted))
        cylinders[k].position[0, 1] += 2.0 * isOnSlab - cylinders[k].lowest_vertex()[1]
        if isOnSlab:
            slabs.append(box_body(60, 2, 60, (100.0 * k, 1, 0), isFixed=True))
    watch = {"watch": lambda: energies.append([energy([one]) / one.mass for one in cylinders])}
    simulate(cylinders + slabs, 170, sleeping=False, **watch)
    gains = energies - np.minimum.accumulate(energies)
    assert gains.max() < 0.05
    assert np.min(np.subtract(energies[0], energies[-1])) > 0.3  # it has wobbled


@pytest.mark.parametrize("e, lifts", [(0.0, (0.1, 0.4)), (0.5, (0.0,))])
def test_linked_bodies_do_not_press_each_other_into_the_ground(e, lifts):
    """Those that the ground stops whip the others, which would pass through it within a step, and
    press those down again in every substep.
    """
    worlds = []
    for lift in lifts:
        one = SceneSimulation(oracles.DATA / "cube-scene.txt")
        for mesh in one.meshes:
            mesh.position = mesh.position + [[0.0, lift, 0.0]]
        worlds.append((one.meshes, one.constraints))
    meshes, links = linked_in_lanes(*worlds)
    lowest, settings = [], {"mu": 0.0, "constraints": links}
    settings["watch"] = lambda: lowest.append(min(mesh.lowest_vertex()[1] for mesh in meshes))
    simulate(meshes, 120, None, e, **settings)
    assert 0.1 > min(lowest) > -0.03


def test_a_body_that_is_pulled_hard_stops_at_a_wall():
    """It was at rest. The rope would pull it through the wall within a step."""
    meshes = [box_body(0.4, 0.4, 0.4, (0, 0, 0)), box_body(0.2, 99, 9, (0.7, 0, 0), isFixed=True)]
    meshes.append(throw(box_body(1, 1, 1, (3, 3, 0)), (30, 30, 0)))
    corner = farthest(meshes[0], (1, 1, 1))
    other = nearest(meshes[2], meshes[0].currVertices[corner])
    length = np.linalg.norm(meshes[2].currVertices[other] - meshes[0].currVertices[corner])
    state, rope = SolverState(), [[0, corner, 2, other, length, True]]
    for _ in range(5):
        simulate(meshes, 1, state, hasGround=False, mu=0.0, constraints=rope, gravity=(0, 0, 0))
        assert meshes[0].position[0, 0] < 0.45
    assert meshes[0].position[0, 1] > 6.0


def test_a_rod_that_spins_does_not_pass_a_peg():
    """Which its end would do within a step: it moves by 0.6 m, and the peg is 0.1 m thick."""
    rods = [throw(box_body(4, 0.2, 0.2, (0, 0, 9 * k)), spin=(0, 0, 15)) for k in range(12)]
    pegs = []
    for k, angle in enumerate(np.linspace(0.3, 0.6, 12)):
        place, turn = 1.9 * np.array([np.cos(angle), np.sin(angle), 0]), quaternion((0, 0, 1), 30)
        pegs.append(box_body(0.1, 0.1, 1, place + [0, 0, 9 * k], orientation=turn, isFixed=True))
    simulate(rods + pegs, 8, hasGround=False, gravity=(0, 0, 0))
    assert max(rod.angVelocity[0, 2] for rod in rods) < 5.0


def test_bars_hold_a_body_as_thin_as_a_needle():
    """Rounding makes the equations of its bars indefinite."""
    turn = random_quaternions(np.random.default_rng(1), 1)[0]
    meshes, bars = [box_body(1.0, 1e-6, 1e-6, (0, 10, 0), orientation=turn)], []
    for k, way in itertools.product(range(8), (*np.eye(3), *-np.eye(3))):
        tip = meshes[0].currVertices[k]
        meshes.append(box_body(0.1, 0.1, 0.1, tip + 3.0 * way, isFixed=True))
        length = np.linalg.norm(tip - meshes[-1].currVertices[0])
        bars += [[0, k, len(meshes) - 1, 0, length, isUpper] for isUpper in (True, False)]
    simulate(meshes, 5, hasGround=False, constraints=bars)
    assert np.linalg.norm(meshes[0].angVelocity) < 0.5 and top_speed(meshes) < 1e-4


@pytest.mark.parametrize("e", [0.0, 0.5])
def test_the_ground_takes_no_momentum_without_friction(e):
    """Heaps slide as they fall, one starts in the ground, and a box hits a sleeping row."""
    groups = [], []
    for k, heap in enumerate(groups):
        rng = np.random.default_rng(k)
        for i, q in enumerate(random_quaternions(rng, 4)):
            place = rng.uniform(-3, 3), 4 + 4 * i, 100 * k + rng.uniform(-3, 3)
            name = ("box", "octahedron", "cylinder", "box")[i]
            mesh = body(name, place, q, density=rng.uniform(1, 5))
            heap.append(throw(mesh, (rng.uniform(1, 7), 0.0, rng.uniform(-3, 3))))
    assert groups[0][0].currVertices[:, 1].min() < 0.0
    row = [box_body(1, 1, 1, (x, 0.5, -100)) for x in (-1.8, *range(5))]
    throw(row[0], (1.0, 0.0, 0.0))
    groups = *groups, row

    def momenta():
        sums = [sum(m.mass * m.linVelocity[0, ::2] for m in meshes) for meshes in groups]
        return np.linalg.norm(sums, axis=1)

    before, meshes = momenta(), list(itertools.chain(*groups))
    state, report = simulate(meshes, 35, CRCoeff=e, mu=0.0)
    assert report.isAsleep[-5:].all()
    report = simulate(meshes, 45, state, CRCoeff=e, mu=0.0)[1]
    assert not report.isAsleep[-5:].any()
    np.testing.assert_allclose(momenta(), before, rtol=1e-6)


def test_friction_keeps_to_coulombs_law_as_boxes_fall_on_each_other():
    rng, meshes, state, shares = np.random.default_rng(1), [], None, []
    for k in range(12):
        x, y, z = rng.uniform(-1, 1, 3) + (0, 2 + 1.2 * k, 0)
        meshes.append(throw(box(x, y, z, rng.uniform(0.4, 1.6, 3)), *rng.uniform(-2, 2, (2, 3))))
    for _ in range(80):
        state, report = simulate(meshes, 1, state)
        limits = [(np.linalg.norm(c.friction), 0.5 * c.impulse) for c in report.contacts]
        shares += [friction / limit for friction, limit in limits if friction > 0.0]
    assert np.max(shares) < 1.0 + 1e-9 and np.sum(np.array(shares) > 0.999) > 100


def test_a_torque_turns_what_stands_on_ice():
    """Its work is no energy that contacts give. A cube has the moment of inertia m/6."""
    mesh = box_body(1, 1, 1, (0, 0.5, 0))
    mesh.set_force((0, 0, 0), (0, 0.5 * mesh.mass, 0))
    simulate([mesh], 10, mu=0.0)
    assert mesh.angVelocity[0, 1] == pytest.approx(3.0 * 10 * H, abs=1e-6)


def test_two_bodies_collide_alike_whichever_is_the_first():
    """As they spin, in ten pairs far apart; the other way round, the list is in reverse. While a
    contact lasts, its normal turns with the first body.
    """
    results = []
    for order in (slice(None), slice(None, None, -1)):
        rng, meshes = np.random.default_rng(1), []
        for k, x in itertools.product(range(10), (0.0, 1.5)):
            place = np.array([x, *rng.uniform(-0.3, 0.3, 2)]) + (0, 0, 10 * k)
            mesh = box_body(1, 1, 1, place, orientation=random_quaternions(rng, 1)[0])
            meshes.append(throw(mesh, (1.0 if x == 0.0 else -1.0, 0.0, 0.0), rng.normal(size=3)))
        simulate(meshes[order], 20, hasGround=False, gravity=(0, 0, 0))
        results.append(state_of(meshes))
    assert (np.abs(results[0][::2, 7] - 1.0) > 0.1).all()  # they have hit each other
    assert results[0][::2, 7:10] == pytest.approx(-results[0][1::2, 7:10], abs=1e-12)  # momentum
    assert results[0] == pytest.approx(results[1], abs=1e-6)


def test_a_bounce_far_away_moves_nothing():
    """Not even a stack whose first loads are new to it."""
    results = []
    for height in (0.55, 50.0):  # one lands in the first step, one in none
        meshes = [box_body(1, 1, 1, (0, k + 0.5, 0)) for k in range(4)]
        meshes.append(throw(box_body(1, 1, 1, (100, height, 0)), (0.0, -5.0, 0.0)))
        simulate(meshes, 10, CRCoeff=1.0)
        results.append(state_of(meshes))
    assert results[0][4, 8] > 2.0  # it has bounced
    assert results[0][:4] == pytest.approx(results[1][:4], abs=1e-12)


def test_bodies_in_each_other_part_whatever_the_time_step_was():
    meshes = [box_body(2, 2, 2, (0, 1 + 1.5 * i, 0)) for i in range(2)]
    state, _ = simulate(meshes, 2)
    # at most at √(g r), with the radius √3; springs alone would push them out at 12 m/s
    assert meshes[1].position[0, 1] < 2.5 + 2 * H * np.sqrt(9.8 * np.sqrt(3))
    assert top_speed(meshes) < 3.0
    simulate(meshes, 100, state, timeStep=0.002, sleeping=False)
    assert penetrations(meshes).max(initial=0.0) < 0.01


def test_without_gravity_what_rests_sleeps_on_while_others_fly():
    meshes, state, isAsleep = [box_body(1, 1, 1, (3 * i, 0, 0)) for i in range(2)], None, []
    meshes[1].linVelocity = [0.0, 1.0, 0.0]
    for _ in range(60):
        state, report = simulate(meshes, 1, state, hasGround=False, gravity=(0, 0, 0))
        isAsleep.append(report.isAsleep.tolist())
    assert isAsleep[30:] == 30 * [[True, False]]


@pytest.fixture(scope="module")
def asleep():
    """Three boxes on each other, and one apart, with the state of the solver."""
    meshes = [box_body(2, 2, 2, (0, 1 + 2 * i, 0)) for i in range(3)]
    meshes.append(box_body(2, 2, 2, (20, 1, 0)))
    state, report = simulate(meshes, 100)
    assert report.isAsleep.all() and top_speed(meshes) == 0.0
    return meshes, state


@pytest.fixture
def sleeping(asleep):
    return copy.deepcopy(asleep)


def added(*place):
    return lambda meshes: meshes.append(box_body(2, 2, 2, place))


# What is done to a sleeping stack, which of its bodies moves then, and where that one ends.
DISTURBED = {
    "a blow": (lambda meshes: throw(meshes[2], (5, 0, 0)), 2, lambda place: place[0] > 1.0),
    "a body that comes down": (added(0.6, 12.0, 0.0), 2, lambda place: place[1] > 4.9),
    "a body that is added on top": (added(0.3, 7.0, 0.0), 2, lambda place: place[1] > 4.9),
}


@pytest.mark.parametrize("act, moved, isThere", DISTURBED.values(), ids=DISTURBED)
def test_what_is_disturbed_wakes_and_nothing_else(act, moved, isThere, sleeping):
    meshes, state = sleeping
    act(meshes)
    woken = False
    for _ in range(70):
        simulate(meshes, 1, state)
        woken |= not state.sleep.isAsleep[moved]
        assert state.sleep.isAsleep[3]
    assert woken and isThere(meshes[moved].position[0])


def test_a_fixed_body_that_is_moved_wakes_what_it_gets_into(sleeping):
    meshes, state = sleeping
    meshes.append(box_body(2, 2, 2, (-20, 1, 0), isFixed=True))
    simulate(meshes, 1, state)
    meshes[4].position = np.array([[18.5, 1.0, 0.0]])
    simulate(meshes, 1, state)
    assert meshes[3].position[0, 0] > 20.01
    assert state.sleep.isAsleep.tolist() == [True] * 3 + [False] * 2


def test_a_body_that_is_added_far_away_changes_no_bit_of_what_sleeps(sleeping):
    meshes, state = sleeping
    before, kept = state_of(meshes), state.manifolds
    far = box_body(2, 2, 2, (1e4, 500, 0))
    meshes.append(far)
    simulate(meshes, 10, state)
    assert np.array_equal(state_of(meshes[:4]), before)
    assert state.sleep.isAsleep.tolist() == [True] * 4 + [False]
    pairs = kept.bodies(4)
    assert np.array_equal(state.manifolds.bodies(5), np.where(pairs == 4, 5, pairs))
    assert np.array_equal(state.manifolds.impulse, kept.impulse)
    assert far.position[0, 1] < 500
    del meshes[-1]
    simulate(meshes, 10, state)
    assert np.array_equal(state_of(meshes), before) and state.sleep.isAsleep.all()


# Constraints, and bodies that are removed


def hung(count, length):
    """`(meshes, constraints)` of rods that hang by their corners from a fixed cube, at 60°."""
    turn = quaternion((0, 0, 1), 60)
    way = rotation(turn).apply((0, -1, 0))
    meshes, constraints = [box_body(0.2, 0.2, 0.2, (0, 0, 0), isFixed=True)], []
    low, high = (farthest(meshes[0], (1, s, 3)) for s in (-2, 2))
    for k in range(count):
        mesh = box_body(0.1, 1.0, 0.1, (0, 0, 0), orientation=turn)
        mesh.position = (meshes[k].currVertices[low] + length * way - mesh.currVertices[high])[None]
        constraints += [[k, low, k + 1, high, length, isUpper] for isUpper in (True, False)]
        meshes.append(mesh)
    return meshes, constraints


def tied_at_both_ends():
    """`(meshes, constraints)` of a box, 1 m long, with two corners on fixed ones; it swings."""
    mesh = box_body(1.0, 0.1, 0.1, (0, 0, 0), orientation=quaternion((0, 0, 1), 20))
    meshes, constraints = [mesh], []
    for k, side in enumerate((-1, 1), 1):
        own = farthest(mesh, (side, -2, 3))
        place = mesh.currVertices[own] + 0.1
        meshes.append(box_body(0.2, 0.2, 0.2, place, isFixed=True))
        other = nearest(meshes[k], mesh.currVertices[own])
        constraints += [[0, own, k, other, 0.0, isUpper] for isUpper in (True, False)]
    return meshes, constraints


# Rods and their distances, or a box on two joints; how much of its largest kinetic energy may be
# missing, or added, within 3 s; all but one, which tumbles.
HUNG = [((1, 0.0), 0.01), ((5, 0.0), 0.01), ((1, 0.001), 0.01), ((2, 0.0001), 0.01)]
HUNG += [((1, 0.1), 0.01), ((2, 0.1), 0.03), (None, 0.03)]


@pytest.mark.parametrize("isGyroscopic, cases", [(True, [((2, 0.0), 0.01)]), (False, HUNG)])
def test_rods_on_joints_and_short_bars_keep_their_energy(isGyroscopic, cases):
    worlds = [hung(*rods) if rods else tied_at_both_ends() for rods, _ in cases]
    before = [energy(bodies) for bodies, _ in worlds]
    meshes, constraints = linked_in_lanes(*worlds)
    settings = HANGING | {"constraints": constraints, "linkedBodiesCollide": False}
    settings["gyroscopic"] = isGyroscopic
    settings["watch"] = lambda: [(energy(bodies), kinetic(bodies)) for bodies, _ in worlds]
    _, track = experiments.run("soft step", meshes, 3.0, **settings)
    off = abs(track[..., 0] - before).max(axis=0) / track[..., 1].max(axis=0)
    assert (off < [within for _, within in cases]).all(), off
    for a, i, b, j, length, _ in constraints:
        apart = np.linalg.norm(meshes[a].currVertices[i] - meshes[b].currVertices[j])
        assert apart == pytest.approx(length, abs=5e-4)


class Chain:
    """A chain of six with an end of 1000 times their mass, let go at 60°, among other bodies."""

    def __init__(self, before, after):
        self.links, constraints = beads(6, 1000.0, 60.0)
        self.others = [box_body(1, 1, 1, (50.0 + 3 * k, 0, 0)) for k in range(before + after)]
        self.meshes = [*self.others[:before], *self.links, *self.others[before:]]
        self.constraints = [[a + before, i, b + before, *end] for a, i, b, *end in constraints]
        self.state = SolverState()

    def remove(self, mesh):
        gone = next(k for k, other in enumerate(self.meshes) if other is mesh)
        self.state.remove(gone)
        del self.meshes[gone]
        rows = [row for row in self.constraints if gone not in (row[0], row[2])]
        self.constraints = [[a - (a > gone), i, b - (b > gone), *end] for a, i, b, *end in rows]

    def run(self, steps):
        settings = {"constraints": self.constraints, "linkedBodiesCollide": False}
        simulate(self.meshes, steps, self.state, hasGround=False, **settings)
        return self


def test_a_chain_swings_on_bit_for_bit_while_other_bodies_are_removed():
    same = Chain(3, 3).run(20)
    given, chains = same.state.constraintImpulse.copy(), [copy.deepcopy(same) for _ in range(4)]
    due = state_of(same.run(20).links)
    for chain, gone in zip(chains, ((0,), (5,), (4, 0, 1), (3, 2, 5)), strict=True):
        for k in gone:
            chain.remove(chain.others[k])
        assert np.array_equal(chain.state.constraintImpulse, given) and given.any()
        assert np.array_equal(state_of(chain.run(20).links), due), gone


def test_a_link_that_is_removed_takes_only_its_own_constraints_along():
    """What hangs below falls freely; what is left above swings on, as if the link were untied."""
    chain, untied = Chain(1, 0).run(20), Chain(1, 0).run(20)
    upper, lower = chain.links[1:3], chain.links[4:]
    mass = np.array([[mesh.mass] for mesh in lower])
    place, speed = (
        (mass * [getattr(m, name)[0] for m in lower]).sum(axis=0) / mass.sum()
        for name in ("position", "linVelocity")
    )
    chain.remove(chain.links[3])
    untied.constraints = [row for row in untied.constraints if 4 not in (row[0], row[2])]
    chain.run(10), untied.run(10)
    centre = (mass * [m.position[0] for m in lower]).sum(axis=0) / mass.sum()
    assert centre == pytest.approx(place + 0.2 * speed - [0, fall(10), 0], abs=1e-5)
    assert state_of(upper) == pytest.approx(state_of(untied.links[1:3]), abs=1e-9)


@pytest.mark.parametrize("isNoted", [True, False])
def test_what_sleeps_on_ropes_falls_when_its_anchor_is_removed(isNoted):
    """The anchor is fixed or, as the last of the list, also removed without a word."""
    meshes = [box_body(1, 1, 1, (0, 0, 0)), box_body(1, 1, 1, (0, 3, 0), isFixed=True)]
    upper = [(i, at + (0, 2, 0)) for i, at in enumerate(meshes[0].currVertices) if at[1] > 0]
    ropes = [[0, i, 1, nearest(meshes[1], above), 2.0, True] for i, above in upper]
    state, _ = simulate(meshes, 100, hasGround=False, constraints=ropes)
    assert state.sleep.isAsleep[0]
    if isNoted:
        state.remove(1)
    simulate(meshes[:1], 1, state, hasGround=False)
    assert meshes[0].linVelocity[0, 1] == pytest.approx(H * GRAVITY)
