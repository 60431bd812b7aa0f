"""Distance constraints: the ways to visit them, by a literal loop over meshes, and their limit."""

import itertools
from collections import Counter
from types import SimpleNamespace

import numpy as np
import oracles
import pytest
from oracles import box_body, ground, restore, state_of

import RBSFunctions
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping import kernels
from rbs.stepping.settings import CONSTRAINT_TOLERANCE, SETTINGS, Settings
from RBSFunctions import resolve_position_constraint, resolve_velocity_constraint, run_timestep

H = 0.02  # seconds

schedulings = pytest.mark.parametrize("scheduling", SETTINGS["constraintScheduling"].kind)


def step(meshes, groundMesh, constraints, scheduling="sweep", **options):
    options |= {"constraints": constraints, "constraintScheduling": scheduling}
    return run_timestep(meshes, groundMesh, H, 0.5, **options)


@pytest.mark.parametrize(
    ("invMasses", "up", "down"), [((1.0, 3.0), 0.5, 1.5), ((0.0, 3.0), 0, 2), ((1.0, 0.0), 2, 0)]
)
def test_coincident_points_are_parted_along_y(invMasses, up, down):
    """The first one upwards. Inverse masses 1 : 3: of 2 m it goes 0.5."""
    point = np.array([[1.0, 2.0, 3.0]])
    positions = (point - [[0.0, 1.0, 0.0]], point + [[2.0, 0.0, 0.0]])
    # C = -refValue: no upper bound is exceeded, and no lower one of zero
    for refValue, upper in (0.0, True), (2.0, True), (0.0, False), (2.0, False):
        wasValid, corrected = resolve_position_constraint(
            positions, (point, point), refValue, invMasses, upper, 1e-3
        )
        assert wasValid == (upper or refValue == 0.0)
        expected = np.zeros((2, 3)) if wasValid else [[0, up, 0], [0, -down, 0]]
        assert np.array_equal(np.subtract(corrected, positions)[:, 0], expected)


@pytest.mark.parametrize("upper", [True, False])
def test_the_formulas_on_arrays_have_the_bits_of_the_taught_functions(upper):
    """For many constraints at once; two bodies in three move, points of every seventh coincide."""
    rng, count, tolerance = np.random.default_rng(5), 1000, 0.3
    w, root = 10.0 ** rng.uniform(-3, 3, (2, count)), rng.normal(size=(2, count, 3, 3))
    w[0, ::3] = w[1, 1::3] = 0.0
    tensors = w[..., None, None] * (root @ root.swapaxes(2, 3))
    x, v, omega, arm = rng.normal(size=(4, 2, count, 3)) * 10.0 ** rng.uniform(-1, 1, (2, count, 1))
    points = x + arm
    points[1, ::7] = points[0, ::7]
    refValue = np.linalg.norm(points[0] - points[1], axis=1) * rng.uniform(0.5, 1.5, count)
    refValue[::7] = 0.4

    tables = [np.moveaxis(table, 2, 0) for table in (x, points, np.concatenate((v, omega), axis=2))]
    position, point, velocity = map(np.copy, tables)
    C, n = kernels.distance_error(*point.swapaxes(0, 1), refValue)
    isViolated = kernels.is_violated(C, upper, tolerance)
    moved = position + kernels.position_corrections(w, C) * n[:, None]
    inertia = np.moveaxis(tensors.reshape(2, count, 9), 2, 0)
    kernels.resolve_velocity_constraint(velocity, w, inertia, point - position, n, tolerance)
    stopped = 0
    for c in range(count):
        at, masses = (x[:, c], points[:, c]), w[:, c]
        wasValid, found = resolve_position_constraint(*at, refValue[c], masses, upper, tolerance)
        assert wasValid is not bool(isViolated[c])
        assert wasValid or np.array_equal(np.ravel(found), moved[..., c].T.ravel())
        given = *at, v[:, c], omega[:, c], masses, tensors[:, c], tolerance
        wasValid, *found = resolve_velocity_constraint(*given)
        found = np.reshape(found, (2, 2, 3)).swapaxes(1, 2)
        assert np.array_equal(found.reshape(6, 2), velocity[..., c])
        stopped += not wasValid
    assert 100 < np.count_nonzero(isViolated) < 900 and stopped > 500


def tangle(rng, count=24, fixed=2):
    """Eight cubes far from each other and links between corners of any two: (meshes, links).

    Some are between fixed bodies, some bounds are zero; bodies move and turn.
    """
    places = 12.0 * np.array(list(itertools.product((0, 1), repeat=3))) + [0, 100, 0]
    meshes = []
    for k, place in enumerate(rng.permutation(places)):
        q, density = oracles.random_quaternions(rng, 1)[0], 10 ** rng.uniform(-1, 1)
        meshes.append(box_body(1, 1, 1, place, orientation=q, density=density, isFixed=k < fixed))
        if k >= fixed:
            meshes[-1].linVelocity = rng.normal(size=(1, 3))
            meshes[-1].angVelocity = rng.normal(size=(1, 3))
    constraints = []
    ends = rng.integers(8, size=(count, 2))
    for m1, m2 in ends[ends[:, 0] != ends[:, 1]].tolist():
        v1, v2 = rng.integers(8, size=2).tolist()
        distance = np.linalg.norm(meshes[m1].currVertices[v1] - meshes[m2].currVertices[v2])
        # zero, or within the tolerance, or about the distance
        lengths = [0.0, 5e-4, distance * rng.uniform(0.98, 1.02)]
        refValue = float(rng.choice(lengths, p=[0.05, 0.05, 0.9]))
        # No point is pulled onto another one of a body 12 m away.
        constraints.append([m1, v1, m2, v2, refValue, refValue > 1.0 and bool(rng.integers(2))])
    return meshes, constraints


def can_be_corrected(meshes, row, tolerance=CONSTRAINT_TOLERANCE):
    """Returns whether some motion of the bodies would let a visit of this constraint act."""
    m1, _, m2, _, refValue, upper = row
    isFixed = meshes[m1].isFixed and meshes[m2].isFixed
    return not isFixed and (upper or refValue > tolerance)


def literal_sweep(meshes, constraints, maxIterations, tolerance):
    """The constraint stage as the coursework words it, on meshes. Returns three numbers of visits.

    The first counts all; the second those of what can be corrected at all; the third, of these, the
    ones that a dirty flag allows: the first, and any after one of the two meshes has moved.
    """
    total = len(constraints)
    dirty = {c for c, row in enumerate(constraints) if can_be_corrected(meshes, row, tolerance)}
    visits = made = idle = flagged = 0
    while idle < total and visits < max(maxIterations, total):
        c = visits % total
        visits += 1
        made += can_be_corrected(meshes, constraints[c], tolerance)
        flagged += c in dirty
        dirty.discard(c)
        idle += 1
        m1, v1, m2, v2, refValue, upper = constraints[c]
        pair = meshes[m1], meshes[m2]
        invMasses = [m.invMass for m in pair]
        if sum(invMasses) == 0:
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
    return visits, made, flagged


def test_tangles_by_the_literal_loop():
    """Random links, random ends; sweep and queue the same to the bit, the literal loop to 1e-12."""
    rng, seen, worst = np.random.default_rng(306), Counter(), 0.0
    for _ in range(30):
        meshes, constraints = tangle(rng, count=int(rng.integers(2, 40)))
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
            swept, made, flagged = literal_sweep(meshes, constraints, most, CONSTRAINT_TOLERANCE)
            assert visits == [flagged, made]
            worst = max(worst, np.abs(state_of(meshes) - results[1]).max())
            seen["ended by the number"] += swept == max(most, len(constraints))
            seen["fewer visits"] += flagged < made < swept
    assert worst < 1e-12
    assert seen["fewer visits"] > 20 and 10 < seen["ended by the number"] < 55


SCENES = ("bridge", 3), ("chimes", 1), ("cube", 20), ("tower_chain", 60), ("net", 1)


@pytest.mark.parametrize(("scene", "steps"), SCENES)
def test_visits_are_calls_of_the_taught_function(scene, steps):
    """In sweep and queue, with the same bits; batches visit as many constraints at least once."""
    ends = []
    for scheduling in ("sweep", "queue", "batches"):
        settings, calls = Settings(constraintScheduling=scheduling), []

        def counted(*given, calls=calls):
            calls.append(given)
            return resolve_position_constraint(*given)

        simulation = SceneSimulation(oracles.DATA / f"{scene}-scene.txt", settings)
        scenery = simulation.meshes, simulation.groundMesh, H, 0.5, True, simulation.constraints
        functions = SimpleNamespace(**vars(RBSFunctions) | {"resolve_position_constraint": counted})
        own = {"functions": functions} if scheduling != "batches" else {}
        visits = 0
        for _ in range(steps):
            visits += run_timestep(*scenery, settings=settings, **own).constraintVisits
        assert visits == len(calls) or scheduling == "batches"
        ends.append((visits, state_of(simulation.meshes).tobytes()))
    (swept, end), (queued, other), (batched, _) = ends
    assert end == other and queued <= swept and 0.2 * swept <= batched


@schedulings
def test_the_limit_counts_all_constraints(scheduling):
    """Also those that no visit can correct, half of the 56 of bridge: in batches first, otherwise
    in the order of the list. The bridge is far from converged.
    """
    simulation = SceneSimulation(oracles.DATA / "bridge-scene.txt")
    for _ in range(60):
        simulation.step()
    assert simulation.report.constraintVisits == 560
    found, start = [], simulation.state()
    for most in (0, 84, 86, 112):
        simulation.restore(start)
        scene = simulation.meshes, None, simulation.constraints
        found.append(step(*scene, scheduling, maxIterations=most).constraintVisits)
    expected = {"batches": [28, 28, 30, 56], "sweep": [28, 42, 43, 56]}
    assert found == expected.get(scheduling, found) and found[0] == 28 and found[3] <= 56


@schedulings
@pytest.mark.parametrize("seed", range(5))
def test_constraints_keep_momentum_and_common_centre(scheduling, seed):
    """In batches, too, in which no two constraints move the same body."""
    meshes, constraints = tangle(np.random.default_rng(seed), fixed=0)
    masses = np.array([mesh.mass for mesh in meshes])
    step(meshes, None, (), gravity=(0, 0, 0))
    before, arguments = state_of(meshes), (meshes, None, 0.0, 0.5, True, constraints)
    run_timestep(*arguments, gravity=(0, 0, 0), constraintScheduling=scheduling)
    change = state_of(meshes) - before
    assert np.abs(change[:, [0, 7, 10]]).max(axis=0).min() > 1e-3
    assert np.abs(masses @ change[:, [0, 1, 2, 7, 8, 9]]).max() < 1e-10 * masses.sum()
