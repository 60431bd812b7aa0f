"""The impulses of a contact by their laws, and the time step by a slow literal loop."""

import itertools
from collections import Counter
from functools import partial

import experiments as laws
import numpy as np
import pytest
from engines import throw
from oracles import DATA, SHAPES, body, box_body, ground, random_quaternions, rotation, state_of

from RBSFunctions import resolve_collision, run_timestep
from RigidBodySimulation import load_scene_file

H = 0.02  # seconds
UP = np.array([0.0, 1.0, 0.0])
MIXED = partial(load_scene_file, DATA / "mixed-scene.txt")


def crowd():
    """Boxes so deep in each other that what separates two of them brings them into others."""
    places = np.random.default_rng(7).uniform(0.0, 4.0, (40, 3))
    return [box_body(1.5, 0.75, 1.0, place) for place in places]


def relative_velocity(states, arms):
    velocities = states[:, 7:10] + np.cross(states[:, 10:], arms)
    return velocities[0] - velocities[1]


def response(direction, arms, masses, inverse):
    """(changes (2, 6) of both velocities, K) for opposite unit impulses along a direction.

    masses : inverse ones, (2, 1); inverse : tensors (2, 3, 3)
    """
    levers = np.cross(arms, direction)
    spins = np.einsum("kij,kj->ki", inverse, levers)
    changes = np.concatenate((masses * direction, spins), axis=1) * [[-1.0], [1.0]]
    return changes, masses.sum() + (levers * spins).sum()


def test_impulses_are_newtons_and_coulombs_at_random_contacts():
    """Bodies part by the depth, split by inverse mass; then the closing speed c becomes -e c.

    What is expected are two opposite impulses at one point: j = (1 + e) c/K along the normal, with
    K the sum of the inverse masses there, and across it what stops the sliding, up to μ j. Nothing
    needs the contact to be where the shapes touch.
    """
    rng, outcomes = np.random.default_rng(500), Counter()
    for k in range(600):
        kind, meshes = ("free", "fixed first", "fixed second", "ground")[k % 4], []
        for i, q in enumerate(random_quaternions(rng, 2)):
            name, density = rng.choice(SHAPES), 10 ** rng.uniform(-3, 3)
            isFixed = kind == ("fixed first", "fixed second")[i]
            place = rng.normal(size=3) * 4
            meshes.append(body(name, place, q, density=density, isFixed=isFixed))
            if not isFixed:
                throw(meshes[-1], rng.normal(size=3) * 5, rng.normal(size=3) * 2)
        depth, e = rng.choice([0.0, 0.01, 0.5]), rng.choice([-0.5, 0.0, 0.3, 1.0, 1.5])
        mu = rng.choice([0.0, 10.0 ** rng.uniform(-1.5, 1)], p=[0.3, 0.7])
        n = rng.normal(size=3)
        n, point = n / np.linalg.norm(n), rng.normal(size=3) * 3
        sign = 1.0
        if kind == "ground":  # which has the mesh first, a negative depth, and its normal upwards
            meshes[1], depth, n, sign = ground(), -depth, UP, -1.0
        before = state_of(meshes)
        resolve_collision(*meshes, depth, n, point, e, mu)

        masses = np.array([[mesh.invMass] for mesh in meshes])
        turns = rotation(before[:, 3:7]).as_matrix()
        inverse = np.stack([r @ m.invIT @ r.T for r, m in zip(turns, meshes, strict=True)])
        inverse *= masses[:, None] > 0.0
        expected, share = before.copy(), masses / masses.sum()
        expected[:, :3] += share * depth * n * [[-1.0], [1.0]]
        arms = point + share[1] * depth * n - expected[:, :3]
        c = relative_velocity(before, arms) @ n
        changes, K = response(n, arms, masses, inverse)
        isClosing = sign * c > 0
        j = (1 + e) * c / K
        expected[:, 7:] += j * changes
        slip = relative_velocity(expected, arms)
        slip -= slip @ n * n
        speed = np.linalg.norm(slip)
        changes, K = response(slip / speed, arms, masses, inverse)
        friction = min(speed / K, mu * max(sign * j, 0.0))
        expected[:, 7:] += friction * changes
        assert np.abs(state_of(meshes) - expected).max() < 1e-12 * np.abs(expected).max()
        outcomes[kind, isClosing] += 1
        outcomes["sticks" if friction == speed / K else "slides" if friction else "none"] += 1
    assert len(outcomes) == 11 and min(outcomes.values()) > 15, outcomes


def test_a_tumbling_body_keeps_momentum_and_energy():
    """It turns over whenever Euler's equation in body axes has it, at 5 rad/s; also at 20."""
    momentum, energy, flips, first = laws.tumbling("basic step")
    due = laws.tumbling_ode(20.0)
    assert momentum < 1e-12 and energy < 1e-8
    assert flips == len(due) >= 4 and first == pytest.approx(due[0], abs=H)
    assert laws.tumbling("basic step", 2.5, 4.0 * laws.SPIN)[1] < 3e-6


def literal_step(meshes, groundMesh, timeStep, e):
    """`run_timestep` as the coursework words it, by the meshes' methods. Returns its contacts."""
    contacts = []
    for mesh in meshes:
        mesh.integrate_timestep(timeStep)
    for i, j in itertools.combinations(range(len(meshes)), 2):
        isCollision, *contact = meshes[i].detect_collision(meshes[j])
        if isCollision:
            resolve_collision(meshes[i], meshes[j], *contact, e)
            contacts.append((i, j))
    for i, mesh in enumerate(meshes):
        if len(mesh.currVertices) > 0 and not mesh.isFixed:
            lowest = mesh.currVertices[mesh.currVertices[:, 1].argmin()].copy()
            if lowest[1] <= 0:
                resolve_collision(mesh, groundMesh, lowest[1], UP, lowest, e)
                contacts.append((i, -1))
    return contacts


@pytest.mark.parametrize(("make", "steps"), [(MIXED, 130), (crowd, 3)])
@pytest.mark.parametrize("way", [{}, {"contactScheduling": "batches"}, {"broadPhase": "grid"}])
def test_a_step_is_the_literal_loop(way, make, steps):
    fast, slow = ([*make(), ground()] for _ in range(2))  # the last one is nothing, and stays
    seen = Counter()
    for _ in range(steps):
        report = run_timestep(fast, ground(), H, 0.5, **way)
        contacts = literal_step(slow, ground(), H, 0.5)
        assert [(contact.body1, contact.body2) for contact in report.contacts] == contacts
        assert all(type(contact.impulse) is float for contact in report.contacts)
        seen.update(contacts)
        assert np.array_equal(state_of(fast), state_of(slow))
        for a, b in zip(fast, slow, strict=True):
            assert np.array_equal(a.currVertices, b.currVertices)
    pairs = [pair for pair in seen if pair[1] >= 0]
    assert len(pairs) >= 6 and len(seen) - len(pairs) >= 3 and seen.total() > 40


@pytest.mark.parametrize(("height", "touches"), [(0.0, True), (1e-12, False), (1e-6, False)])
def test_the_ground_is_touched_at_0_and_not_above(height, touches):
    mesh = box_body(2.0, 2.0, 2.0, (0.0, 1.0 + height, 0.0))
    report = run_timestep([mesh], ground(), 0.0, 0.5)
    assert len(report.contacts) == touches
    assert mesh.position[0, 1] == 1.0 + height
