"""Distance constraints: the two corrections, the three ways to visit them, and what they do.

The corrections are judged by the constraint's own mathematics, with J written out as a row and M as
a matrix; sweep and queue by a literal loop over meshes; the whole by a pendulum whose period
follows from its linearised equations.
"""

import itertools
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from oracles import (
    DATA,
    body,
    box_body,
    frozen,
    ground,
    quaternion,
    random_quaternions,
    restore,
    state_of,
)
from scipy.linalg import block_diag, eigh
from scipy.spatial.transform import Rotation

import rbs.stepping.constraints
import RBSFunctions
from rbs.scenes.simulation import SceneSimulation, Settings
from rbs.stepping.settings import CONSTRAINT_TOLERANCE, SETTINGS
from RBSFunctions import resolve_position_constraint, resolve_velocity_constraint, run_timestep

G = 9.8
H = 0.02  # seconds
UP = np.array([0.0, 1.0, 0.0])

schedulings = pytest.mark.parametrize("scheduling", SETTINGS["constraintScheduling"].kind)


def step(meshes, groundMesh, constraints, scheduling="sweep", **options):
    options |= {"constraints": constraints, "constraintScheduling": scheduling}
    return run_timestep(meshes, groundMesh, H, 0.5, **options)


def random_tie(rng, fixed=()):
    """Two bodies, a point of each, and how they move, at random: read-only arrays.

    fixed : which of the two bodies cannot move. masses are those that they would have.
    """
    masses = 10 ** rng.uniform(-3, 3, size=2)
    positions, arms, linVelocities, angVelocities = rng.normal(size=(4, 2, 1, 3)) * np.reshape(
        [10, 3, 5, 2], (4, 1, 1, 1)
    )
    inertias = []
    for mass in masses:
        turn = Rotation.random(random_state=rng).as_matrix()
        inertias.append(turn @ np.diag(mass * rng.uniform(0.5, 5, size=3)) @ turn.T)
    movable = [float(k not in fixed) for k in range(2)]
    return SimpleNamespace(
        masses=masses,
        inertias=inertias,
        positions=tuple(map(frozen, positions)),
        points=tuple(map(frozen, positions + arms)),
        linVelocities=tuple(map(frozen, linVelocities)),
        angVelocities=tuple(map(frozen, angVelocities)),
        invMasses=tuple(np.divide(movable, masses)),
        invInertias=[frozen(m * np.linalg.inv(t)) for m, t in zip(movable, inertias, strict=True)],
    )


def distance_of(points):
    return np.linalg.norm(points[0] - points[1])


def test_position_correction_through_random_ties():
    """C = 0 afterwards, along p1 - p2, split by inverse mass; nothing at all where it was valid.

    The COM of the pair stays: m1 Δ1 = -m1 w1 C n and m2 Δ2 = +m2 w2 C n, and with the shares
    w_i = m_i⁻¹/(m1⁻¹ + m2⁻¹) both products are the reduced mass. Coordinates are some ten metres,
    known to 1e-14; hence the bounds below.
    """
    rng = np.random.default_rng(300)
    outcomes = Counter()
    for k in range(720):
        fixed = ((), (0,), (1,))[k % 3]
        upper = bool(k // 3 % 2)
        tie = random_tie(rng, fixed)
        distance = distance_of(tie.points)
        refValue = distance * rng.uniform(0.5, 1.5) * (k % 10 > 0)  # a tenth of them zero
        tolerance = rng.choice([0.0, 1e-3, 0.3])
        C = distance - refValue
        expected = C <= tolerance if upper else C >= -tolerance

        wasValid, corrected = resolve_position_constraint(
            tie.positions, tie.points, refValue, tie.invMasses, upper, tolerance
        )
        assert wasValid is bool(expected)
        moves = [after - before for after, before in zip(corrected, tie.positions, strict=True)]
        assert [move.shape for move in moves] == [(1, 3), (1, 3)]
        outcomes["upper" if upper else "lower", bool(wasValid), fixed] += 1
        if wasValid:
            assert corrected is tie.positions
            continue
        for before, after in zip(tie.positions, corrected, strict=True):
            assert not np.shares_memory(before, after)
        points = [point + move for point, move in zip(tie.points, moves, strict=True)]
        assert abs(distance_of(points) - refValue) < 1e-13
        n = (tie.points[0] - tie.points[1]) / distance
        assert np.abs(np.cross(moves, n)).max() < 1e-13
        for body_ in fixed:
            assert np.array_equal(moves[body_], np.zeros((1, 3)))
            assert np.linalg.norm(moves[1 - body_]) == pytest.approx(abs(C), abs=1e-13)
        if not fixed:
            share = tie.masses[1] / tie.masses.sum()  # of body 1: the other one's mass
            assert np.abs(moves[0] + share * C * n).max() < 1e-13
            shift = tie.masses[0] * moves[0] + tie.masses[1] * moves[1]
            assert np.abs(shift).max() < 1e-14 * tie.masses.sum()
    assert len(outcomes) == 12 and min(outcomes.values()) > 25


def test_velocity_correction_through_random_ties():
    """J v = 0 afterwards by the least change that does it: Δv = -M⁻¹Jᵀ (J M⁻¹ Jᵀ)⁻¹ J v.

    J is the row that takes v = (v1, ω1, v2, ω2) to the rate of ‖p1 - p2‖:
    d/dt ‖p1 - p2‖ = n · (v1 + ω1 × r1 - v2 - ω2 × r2), and n · (ω × r) = (r × n) · ω.
    """
    rng = np.random.default_rng(301)
    tolerance = 1e-5
    outcomes = Counter()
    for k in range(600):
        fixed = ((), (0,), (1,))[k % 3]
        tie = random_tie(rng, fixed)
        n = np.ravel(tie.points[0] - tie.points[1]) / distance_of(tie.points)
        r1, r2 = (np.ravel(p - x) for p, x in zip(tie.points, tie.positions, strict=True))
        J = np.concatenate((n, np.cross(r1, n), -n, -np.cross(r2, n)))
        pairs = zip(tie.linVelocities, tie.angVelocities, strict=True)
        v = np.concatenate([row for pair in pairs for row in pair], axis=1)[0]
        if k % 2:  # nearly at rest along the tie: within the tolerance, or just not
            v = v + J * (rng.uniform(-2, 2) * tolerance - J @ v) / (J @ J)
        masses = [w * np.eye(3) for w in tie.invMasses]
        inverse = block_diag(masses[0], tie.invInertias[0], masses[1], tie.invInertias[1])
        expected = v - inverse @ J * (J @ v) / (J @ inverse @ J)
        before = frozen(v.reshape(4, 1, 3))

        motion = tie.positions, tie.points, (before[0], before[2]), (before[1], before[3])
        wasValid, linVelocities, angVelocities = resolve_velocity_constraint(
            *motion, tie.invMasses, tie.invInertias, tolerance
        )
        parts = [linVelocities[0], angVelocities[0], linVelocities[1], angVelocities[1]]
        after = np.concatenate(parts, axis=1)[0]
        assert wasValid is bool(abs(J @ v) <= tolerance)
        outcomes[fixed, wasValid] += 1
        if wasValid:
            assert (linVelocities, angVelocities) == motion[2:] and np.array_equal(after, v)
            continue
        assert not any(np.shares_memory(before, part) for part in parts)
        assert abs(J @ after) < 1e-12 * (np.abs(J) @ np.abs(after))
        assert np.abs(after - expected).max() < 1e-12 * np.abs(expected).max()
        for body_ in fixed:
            assert np.array_equal(after.reshape(2, 6)[body_], v.reshape(2, 6)[body_])
        if not fixed:
            # The kinetic energy that is lost is that of the motion which was stopped.
            m1, m2 = (m * np.eye(3) for m in tie.masses)
            M = block_diag(m1, tie.inertias[0], m2, tie.inertias[1])
            lost = (v @ M @ v - after @ M @ after) / 2
            energy = v @ M @ v
            assert abs(lost - (J @ v) ** 2 / (J @ inverse @ J) / 2) < 1e-12 * energy
    assert len(outcomes) == 6 and min(outcomes.values()) > 40


def vertex(meshes, mesh, index):
    return meshes[mesh].currVertices[index]


def violations(meshes, constraints):
    """Excess over each bound (C,), 0 if the bound holds."""
    rows = []
    for m1, v1, m2, v2, refValue, upper in constraints:
        C = np.linalg.norm(vertex(meshes, m1, v1) - vertex(meshes, m2, v2)) - refValue
        rows.append(max(C if upper else -C, 0.0))
    return np.array(rows)


@pytest.mark.parametrize("fixed", [(), (0,), (1,)])
def test_coincident_points_are_parted_along_y(fixed):
    point = np.array([[1.0, 2.0, 3.0]])
    positions = (point - [[0.0, 1.0, 0.0]], point + [[2.0, 0.0, 0.0]])
    invMasses = [0.0 if k in fixed else (1.0, 3.0)[k] for k in range(2)]
    for refValue, tolerance in ((0.0, 0.0), (2.0, 1e-3)):
        # C = -refValue: no upper bound is exceeded, and no lower one of zero
        wasValid, corrected = resolve_position_constraint(
            positions, (point, point), refValue, invMasses, True, tolerance
        )
        assert wasValid and np.array_equal(corrected, positions)
        wasValid, corrected = resolve_position_constraint(
            positions, (point, point), refValue, invMasses, False, tolerance
        )
        assert wasValid == (refValue == 0.0)
        moves = np.subtract(corrected, positions)[:, 0]
        # The first one upwards. Inverse masses 1 : 3: of 2 m it goes 0.5.
        up, down = {(): (0.5, 1.5), (0,): (0, 2), (1,): (2, 0)}[fixed]
        expected = [[0, up, 0], [0, -down, 0]] if refValue else np.zeros((2, 3))
        assert np.array_equal(moves, expected)
    # Their velocities are made equal along y, and only there: J v = 5 - 1 = 4. The arms (0, 1, 0)
    # and (-2, 0, 0) give r × n = 0 and (0, 0, -2): with unit tensors, K = w1 + w2 + 4, the 4 only
    # while body 2 is free.
    inertias = [np.eye(3) * (k not in fixed) for k in range(2)]
    velocities = (np.array([[1.0, 5.0, 0.0]]), np.array([[0.0, 1.0, 7.0]]))
    still = (np.zeros((1, 3)), np.zeros((1, 3)))
    wasValid, linear, angular = resolve_velocity_constraint(
        positions, (point, point), velocities, still, invMasses, inertias, 1e-5
    )
    j = 4 / (sum(invMasses) + 4 * (1 not in fixed))
    assert not wasValid
    assert linear[0][0] == pytest.approx([1, 5 - j * invMasses[0], 0], abs=1e-15)
    assert linear[1][0] == pytest.approx([0, 1 + j * invMasses[1], 7], abs=1e-15)
    assert angular[1][0] == pytest.approx([0, 0, -2 * j * (1 not in fixed)], abs=1e-15)


@schedulings
def test_a_rope_of_no_length_holds(scheduling):
    # A cube hangs by a corner from the corner of a fixed one; after a first correction the two
    # coincide but for rounding, and the direction between them is arbitrary.
    meshes = [box_body(1, 1, 1, (0, 50, 0), isFixed=True), box_body(1, 1, 1, (1.3, 48.8, 1))]
    constraints = [[0, 5, 1, 2, 0.0, False], [0, 5, 1, 2, 0.0, True]]
    assert 0.1 < np.linalg.norm(vertex(meshes, 0, 5) - vertex(meshes, 1, 2)) < 0.5
    lowest = 50.0
    for _ in range(150):
        report = step(meshes, ground(), constraints, scheduling=scheduling)
        assert report.constraintVisits < 1000
        assert violations(meshes, constraints).max() <= 1e-3
        lowest = min(lowest, meshes[1].position[0, 1])
    assert np.isfinite(state_of(meshes)).all()
    # The COM is √0.75 from a corner at y = 49.5.
    assert 49.5 - np.sqrt(0.75) - 2e-3 < lowest < 49


def tangle(rng, count=24, fixed=2):
    """Eight cubes far from each other and ties between corners of any two of them: (meshes, ties).

    Some are between fixed bodies, some on one body, some bounds are zero; bodies move and turn.
    """
    places = 12.0 * np.array(list(itertools.product((0, 1), repeat=3))) + 100 * UP
    meshes = []
    for k, place in enumerate(rng.permutation(places)):
        q, density = random_quaternions(rng, 1)[0], 10 ** rng.uniform(-1, 1)
        meshes.append(box_body(1, 1, 1, place, orientation=q, density=density, isFixed=k < fixed))
        if k >= fixed:
            meshes[-1].linVelocity = rng.normal(size=(1, 3))
            meshes[-1].angVelocity = rng.normal(size=(1, 3))
    constraints = []
    for m1, m2 in rng.integers(8, size=(count, 2)).tolist():
        v1, v2 = rng.integers(8, size=2).tolist()
        distance = np.linalg.norm(vertex(meshes, m1, v1) - vertex(meshes, m2, v2))
        refValue = float(rng.choice([0.0, distance * rng.uniform(0.98, 1.02)], p=[0.1, 0.9]))
        # No point is pulled onto another one of a body 12 m away.
        constraints.append([m1, v1, m2, v2, refValue, refValue > 0 and bool(rng.integers(2))])
    return meshes, constraints


def can_be_corrected(meshes, row, tolerance=CONSTRAINT_TOLERANCE):
    """Returns whether some motion of the bodies would let a visit of this constraint act."""
    m1, _, m2, _, refValue, upper = row
    return (
        m1 != m2
        and not (meshes[m1].isFixed and meshes[m2].isFixed)
        and (upper or refValue > tolerance)
    )


@schedulings
def test_what_cannot_be_corrected_is_as_if_it_were_not_there(scheduling):
    rng = np.random.default_rng(305)
    dropped = 0
    for _ in range(20):
        meshes, constraints = tangle(rng)
        # a violated one between fixed bodies, and one on a single body, in front of all others
        constraints[:0] = [[0, 0, 1, 0, 1.0, True], [5, 0, 5, 7, 9.0, False]]
        useful = [row for row in constraints if can_be_corrected(meshes, row)]
        dropped += len(constraints) - len(useful)
        start, results = state_of(meshes), []
        for rows in (constraints, useful):
            restore(meshes, start)
            for _ in range(2):
                sweeps = 10 * len(rows)  # whole ones: ten of each list
                step(meshes, None, rows, scheduling, maxIterations=sweeps)
            results.append(state_of(meshes))
        assert np.array_equal(*results)
    assert dropped > 100


def short_chain():
    """A fixed cube and five free ones in a row, each on a rope 0.5 m too short: (meshes, ropes)."""
    meshes = [box_body(1, 1, 1, (4 * k, 50, 0), isFixed=k == 0) for k in range(6)]
    for mesh in meshes[1:]:
        mesh.linVelocity = G * H * UP[None]  # for one step, they do not fall
    # corner 4 of each to corner 0 of the next, 3 m to the right
    return meshes, [[k, 4, k + 1, 0, 2.5, True] for k in range(5)]


@schedulings
@pytest.mark.parametrize("maxIterations", [0, 4])
def test_a_whole_sweep_at_least(scheduling, maxIterations):
    meshes, ropes = short_chain()
    report = step(meshes, None, ropes, maxIterations=maxIterations, scheduling=scheduling)
    assert report.constraintVisits == 5
    shift = state_of(meshes)[:, 0] - 4 * np.arange(6)
    assert shift[0] == 0.0 and shift[5] < -0.2  # the last rope has pulled too
    if scheduling != "batches":
        # In order: rope 0 pulls cube 1 all of its 0.5 to the left, for the other one is fixed.
        # Rope 1 is now 1 too long, and pulls cube 1 back by half of that, and cube 2 to the left
        # by the other half. So do the next ones, up to cube 5, which is not pulled back.
        assert shift == pytest.approx([0, 0, 0, 0, 0, -0.5], abs=1e-12)


def literal_sweep(meshes, constraints, maxIterations, tolerance):
    """The constraint stage as the coursework words it, on meshes. Returns two numbers of visits.

    The first is the sweep's. The second counts those of them that a dirty flag allows: of what can
    be corrected at all, the first visit, and any after one of its two meshes has moved.
    """
    total = len(constraints)
    dirty = {c for c, row in enumerate(constraints) if can_be_corrected(meshes, row, tolerance)}
    visits = idle = flagged = 0
    while idle < total and visits < max(maxIterations, total):
        c = visits % total
        visits += 1
        flagged += c in dirty
        dirty.discard(c)
        idle += 1
        m1, v1, m2, v2, refValue, upper = constraints[c]
        pair = meshes[m1], meshes[m2]
        invMasses = [m.invMass for m in pair]
        if m1 == m2 or sum(invMasses) == 0:
            continue
        points = [pair[0].currVertices[v1], pair[1].currVertices[v2]]
        wasValid, positions = resolve_position_constraint(
            [m.position for m in pair], points, refValue, invMasses, upper, tolerance
        )
        if wasValid:
            continue
        idle = 0
        for m, position in zip(pair, positions, strict=True):
            m.currVertices = m.currVertices + (position - m.position)
            m.position = position
        points = [pair[0].currVertices[v1], pair[1].currVertices[v2]]
        velocities = [m.linVelocity for m in pair], [m.angVelocity for m in pair]
        tensors = [m.get_rotated_inv_IT() for m in pair]
        _, linVelocities, angVelocities = resolve_velocity_constraint(
            positions, points, *velocities, invMasses, tensors, tolerance
        )
        for k, m in enumerate(pair):
            m.linVelocity, m.angVelocity = linVelocities[k], angVelocities[k]
        moved = {m for m in (m1, m2) if not meshes[m].isFixed}
        for other, row in enumerate(constraints):
            if moved & {row[0], row[2]} and can_be_corrected(meshes, row, tolerance):
                dirty.add(other)
    return visits, flagged


def test_tangles_by_the_literal_loop():
    """Random ties, random ends; sweep and queue the same to the bit, the literal loop to 1e-12."""
    rng = np.random.default_rng(306)
    seen = Counter()
    worst = 0.0
    for _ in range(30):
        meshes, constraints = tangle(rng, count=int(rng.integers(2, 30)))
        most = int(rng.choice([0, 10, 50, 300]))
        for _ in range(2):
            start, results, visits = state_of(meshes), [], []
            for scheduling in ("queue", "sweep"):
                restore(meshes, start)
                report = step(meshes, ground(), constraints, scheduling, maxIterations=most)
                results.append(state_of(meshes))
                visits.append(report.constraintVisits)
            assert np.array_equal(results[0], results[1])
            restore(meshes, start)
            run_timestep(meshes, ground(), H, 0.5)
            swept, flagged = literal_sweep(meshes, constraints, most, CONSTRAINT_TOLERANCE)
            assert visits == [flagged, swept]
            worst = max(worst, np.abs(state_of(meshes) - results[1]).max())
            seen["ended by the number"] += swept == max(most, len(constraints))
            seen["fewer visits"] += flagged < swept
    assert worst < 1e-12
    assert seen["fewer visits"] > 30 and 10 < seen["ended by the number"] < 55


def load(name, scheduling="sweep"):
    """The `SceneSimulation` of a scene with its constraints."""
    settings = Settings(constraintScheduling=scheduling, contactScheduling="batches")
    return SceneSimulation(DATA / f"{name}-scene.txt", settings)


# The number of steps; the largest part of the sweep's visits that the queue makes in them; and the
# part of the steps that end before the visits are used up. A rope's lower bound is one visit in two
# that the queue never makes.
@pytest.mark.parametrize(
    "name, steps, share, ending", [("bridge", 60, 0.5, 0.4), ("two_chain", 80, 0.6, 0.7)]
)
def test_queue_and_sweep_agree_to_the_bit(name, steps, share, ending):
    """Every bound holds after a step that ends before its visits are used up."""
    sweep, queue = load(name), load(name, "queue")
    most = sweep.max_iterations()
    visits, ended, corrected = Counter(), 0, 0
    for _ in range(steps):
        sweep.step()
        queue.step()
        assert np.array_equal(state_of(sweep.meshes), state_of(queue.meshes))
        bySweep, byQueue = sweep.report.constraintVisits, queue.report.constraintVisits
        assert byQueue <= bySweep <= most
        visits.update(sweep=bySweep, queue=byQueue)
        corrected += bySweep > len(sweep.constraints)
        if bySweep < most:
            ended += 1
            # the vertices are summed up in another order than the points in the loop
            excess = violations(sweep.meshes, sweep.constraints)
            assert excess.max() <= CONSTRAINT_TOLERANCE + 1e-12
            assert sweep.largest_violation() == pytest.approx(excess.max(), abs=1e-12)
    made = visits["queue"] / visits["sweep"]
    assert made <= share
    assert ended >= ending * steps
    assert corrected >= 3


def test_corrections_in_place_count_in_the_next_visit():
    """Functions may change the arrays that they are given, and return these."""
    before, corrections = [], []

    def positions_in_place(positions, *others):
        wasValid, corrected = resolve_position_constraint(positions, *others)
        before[:] = np.copy(positions)
        for given, new in zip(positions, corrected, strict=True):
            given[:] = new
        corrections.append(not wasValid)
        return wasValid, positions

    def velocities(positions, *others):
        return resolve_velocity_constraint(before, *others)

    scenes = [load("two_chain") for _ in range(2)]
    functions = vars(RBSFunctions) | {"resolve_position_constraint": positions_in_place}
    functions = SimpleNamespace(**functions | {"resolve_velocity_constraint": velocities})
    for _ in range(60):
        for scene, taught in zip(scenes, (None, functions), strict=True):
            settings = {"maxIterations": scene.max_iterations(), "functions": taught}
            step(scene.meshes, scene.groundMesh, scene.constraints, **settings)
        assert np.array_equal(*(state_of(scene.meshes) for scene in scenes))
    assert sum(corrections) > 500 and corrections.count(False) > 500


@pytest.fixture
def visitedBatches(monkeypatch):
    """The batches that steps look at, in order: (index in the list, body 1, body 2) each."""
    seen = []

    def noting(bodies, rows, ends, arms, batch, tolerance):
        seen.append((rows.index[batch], rows.body1[batch], rows.body2[batch]))
        return visit_batch(bodies, rows, ends, arms, batch, tolerance)

    visit_batch = rbs.stepping.constraints.visit_batch
    monkeypatch.setattr(rbs.stepping.constraints, "visit_batch", noting)
    return seen


def test_batches_share_no_body_and_hold_every_constraint_once(visitedBatches):
    rng = np.random.default_rng(307)
    scenes = [(s.meshes, s.constraints) for s in (load("bridge"), load("cube"))]
    for meshes, constraints in [*scenes, *(tangle(rng, count=60) for _ in range(20))]:
        visitedBatches.clear()
        step(meshes, None, constraints, maxIterations=0, scheduling="batches")
        for _, body1, body2 in visitedBatches:
            moved = [b for b in (*body1.tolist(), *body2.tolist()) if not meshes[b].isFixed]
            assert len(set(moved)) == len(moved)
        visited = np.concatenate([index for index, *_ in visitedBatches]).tolist()
        possible = [c for c, row in enumerate(constraints) if can_be_corrected(meshes, row)]
        assert sorted(visited) == possible
        # No more batches than twice the ties of one body, and not one for each constraint.
        ends = Counter(m for c in possible for m in constraints[c][0:3:2])
        assert 1 < len(visitedBatches) <= 2 * max(ends.values())


def test_ties_to_one_fixed_body_are_one_batch(visitedBatches):
    meshes = [body("octahedron", (0, 100, 0), isFixed=True)]
    meshes += [body("octahedron", (10 * k, 80, 0)) for k in range(-9, 10)]
    ropes = [[0, 3, k, 1, 5.0, True] for k in range(1, 20)]
    step(meshes, None, ropes, maxIterations=0, scheduling="batches")
    assert [len(index) for index, *_ in visitedBatches] == [19]
    assert violations(meshes, ropes).max() < 1e-12


def test_batches_end_as_close_as_the_sweep_in_the_same_visits():
    """Compares the violations that remain after the same number of visits from the same state.

    Batches leave about the same sum. It lies on the batches before the last one, while the sweep
    spreads it over all constraints, so the largest violation is up to twice as large.
    """
    simulation = load("bridge", "batches")
    for _ in range(44):  # until its ropes are taut
        simulation.step()
    sums, worst, used = [], [], 0
    for _ in range(20):
        start, excess, visits = state_of(simulation.meshes), {}, {}
        for scheduling in ("sweep", "batches"):
            restore(simulation.meshes, start)
            simulation.settings.constraintScheduling = scheduling
            simulation.step()
            excess[scheduling] = violations(simulation.meshes, simulation.constraints)
            visits[scheduling] = simulation.report.constraintVisits
        if visits["sweep"] < simulation.max_iterations():
            assert excess["batches"].max() <= CONSTRAINT_TOLERANCE + 1e-12
            continue
        assert visits["batches"] <= visits["sweep"]
        used += 1
        sums.append(excess["batches"].sum() / excess["sweep"].sum())
        worst.append(excess["batches"].max() / excess["sweep"].max())
    assert used >= 4
    assert np.mean(sums) < 1.15 and max(sums) < 1.3
    assert max(worst) < 2.2


def slow_swing(rod, drop, inertia):
    """`(period, α/β)` of the slower of the two small oscillations of a body on a rod.

    The rod, without mass, hangs from a fixed point and is turned by α; from its end the body hangs
    by a point `drop` away from its COM, along a line turned by β. The COM is at
    x = rod sin α + drop sin β, so per unit of mass, for small angles,

        2 T = (rod α' + drop β')² + inertia β'²,    2 V = g (rod α² + drop β²),

    and M q'' = -K q for q = (α, β) with the matrices of these forms. With rod → 0 the slow solution
    is the physical pendulum about the point, ω² = g drop/(inertia + drop²); the fast one, ω² → ∞,
    is the rod alone.

    inertia : about the COM over the mass, m²
    """
    M = [[rod * rod, rod * drop], [rod * drop, drop * drop + inertia]]
    squares, modes = eigh(G * np.diag([rod, drop]), M)
    return 2 * np.pi / np.sqrt(squares[0]), modes[0, 0] / modes[1, 0]


# Rod, half-axes of the octahedron sideways and upright, in m; whether the tie is a rod or a rope;
# whether the fixed body comes first.
PENDULA = {
    "regular, about its vertex": (0.05, 3.4, 3.4, "rope", False),
    "on a long rod": (5.0, 8.0, 2.0, "rod", True),
}


@pytest.mark.parametrize("case", PENDULA)
def test_pendulum_has_the_period_of_its_linearised_equations(case):
    """An octahedron hangs by its tip from the tip of a fixed one, and is let go in its slow mode.

    With half-axes a along x and b along y, over the mass: I_zz = (a² + b²)/10. It swings in the
    x-y plane, which its symmetry never leaves. Amplitude 0.05 rad: the period of a pendulum grows
    by 1 + θ²/16, nothing here. The step's error in the period is of second order in ω h = 0.03.
    """
    rod, a, b, kind, fixedFirst = PENDULA[case]
    period, ratio = slow_swing(rod, b, (a * a + b * b) / 10)
    if rod < 0.1:  # all but the physical pendulum about its vertex
        about = 2 * np.pi * np.sqrt(((a * a + b * b) / 10 + b * b) / (G * b))
        assert period == pytest.approx(about, rel=0.01)
    # A point of mass on a string of that length would have another period.
    assert abs(2 * np.pi * np.sqrt((rod + b) / G) / period - 1) > 0.04

    beta = 0.05
    alpha = ratio * beta
    fixed = body("octahedron", (0, 50, 0), isFixed=True, size=0.5)
    tip = fixed.currVertices[3]  # the lowest one
    end = tip + rod * np.array([np.sin(alpha), -np.cos(alpha), 0])
    centre = end + b * np.array([np.sin(beta), -np.cos(beta), 0])
    turn = quaternion([0, 0, 1], np.degrees(beta))
    hanging = body("octahedron", centre, turn, density=2.5, size=np.array([a, b, 1.0]) / 3.4)
    assert np.abs(hanging.currVertices[1] - end).max() < 1e-12
    assert hanging.IT[2, 2] == pytest.approx(hanging.mass * (a * a + b * b) / 10)
    meshes = [fixed, hanging] if fixedFirst else [hanging, fixed]
    ends = [0, 3, 1, 1] if fixedFirst else [0, 1, 1, 3]
    constraints = [[*ends, rod, upper] for upper in ((False, True) if kind == "rod" else (True,))]

    x = [hanging.position[0, 0]]
    for _ in range(round(3.3 * period / H)):
        report = run_timestep(meshes, ground(), H, 0.5, constraints=constraints)
        assert not report.contacts
        x.append(hanging.position[0, 0])
    assert hanging.position[0, 2] == 0.0
    x = np.array(x)
    before = np.flatnonzero(x[:-1] * x[1:] < 0)
    times = H * (before + x[before] / (x[before] - x[before + 1]))
    # at ¼, ¾, … of a period: six or seven times in 3.3, and 5 or 6 half periods between them
    assert len(times) in (6, 7)
    measured = 2 * np.diff(times).mean()
    # half steps in the crossings would make 0.02/15
    assert measured == pytest.approx(period, rel=0.002)
    # It swings on: the corrections cost amplitude, but less than a quarter of it in 3.3 periods.
    last = x[-round(period / H) :]
    assert 0.75 * x[0] < np.abs(last).max() < 1.01 * x[0]
