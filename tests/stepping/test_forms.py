"""The two forms of each formula give the same bits: for a pair in floats, for many in arrays."""

from types import SimpleNamespace

import numpy as np
import pytest
from oracles import SHAPES, body, random_quaternions, state_of

from Quaternion import exponential, exponentials
from rbs.geometry import triples, vectors
from rbs.stepping import kernels
from rbs.stepping.bodies import bodies_of
from RBSFunctions import (
    Body,
    direction,
    resolve_collision,
    resolve_position_constraint,
    resolve_velocity_constraint,
)

COUNT = 2000


class Stub:
    """A mesh as far as `resolve_collision` uses it."""

    origVertices = (0,)

    def __init__(self, *state):
        self.body = Body(*state)

    def body_state(self):
        return self.body

    def set_body_state(self, body):
        self.body = body


def column(table, c):
    """Vector, matrix or number c of a table (…, m), as a tuple of floats or a float."""
    return table[c].item() if table.ndim == 1 else tuple(table[:, c].tolist())


def random_pairs(seed):
    """invMasses (2, m), invInertias (9, 2, m), motion (9, 2, m) of pairs, and normals (3, m).

    A third of the first bodies are fixed, and a third of the second ones. A fiftieth of the pairs
    meet along the normal, without spin: they do not slide.
    """
    rng = np.random.default_rng(seed)
    invMasses = 10.0 ** rng.uniform(-3, 3, (2, COUNT))
    for k in range(2):
        invMasses[k, k::3] = 0.0
    root = rng.normal(size=(2, COUNT, 3, 3))
    tensors = (root @ root.transpose(0, 1, 3, 2)).reshape(2, COUNT, 9)
    invInertias = invMasses * tensors.transpose(2, 0, 1)
    motion = rng.normal(size=(9, 2, COUNT)) * 10.0 ** rng.uniform(-1, 1, (2, COUNT))
    n = rng.normal(size=(3, COUNT))
    n /= vectors.norm(n)
    motion[3:6, 0, ::50], motion[3:6, 1, ::50], motion[6:, :, ::50] = n[:, ::50], -n[:, ::50], 0.0
    return rng, invMasses, np.ascontiguousarray(invInertias), motion, n


def states_of(invMasses, invInertias, motion, c):
    """The two bodies of pair c: the arguments of `Body`."""
    tables = [(invMasses[k], invInertias[:, k], *motion[:, k].reshape(3, 3, -1)) for k in (0, 1)]
    return [[column(table, c) for table in tables[k]] for k in (0, 1)]


def test_free_flight():
    """By the methods of `Mesh` and those of `Bodies`, with fast and slow turns, also if fixed."""
    rng = np.random.default_rng(2)
    q = rng.normal(size=(4, COUNT))
    q[1:] *= 10.0 ** rng.uniform(-7, 1, COUNT)
    q[1:, :5] = 0.0
    many = exponentials(tuple(q))
    assert all(exponential(column(q, c)) == column(np.array(many), c) for c in range(COUNT))

    for gyroscopic in (False, True):
        runs = []
        for inTables in (False, True):
            rng = np.random.default_rng(3)
            meshes = []
            for k, turn in enumerate(random_quaternions(rng, 200)):
                place, name = rng.normal(size=(1, 3)), SHAPES[k % len(SHAPES)]
                mesh = body(name, place, turn, isFixed=k % 5 == 0)
                mesh.linVelocity, mesh.angVelocity = rng.normal(size=(2, 1, 3)) * 10.0
                meshes.append(mesh)
            if inTables:
                bodies = bodies_of(meshes)
                bodies.integrate(0.02, gyroscopic)
                bodies.write_back()
            else:
                for mesh in meshes:
                    (mesh.integrate_tumbling if gyroscopic else mesh.integrate_timestep)(0.02)
                    if mesh.isFixed:
                        mesh.follow_velocity(0.02)
            runs.append(state_of(meshes))
        assert runs[0].tobytes() == runs[1].tobytes()


MATERIALS = [(0.0, 0.3), (0.5, 0.6), (1.0, 5.0), (0.3, 0.0)]


@pytest.mark.parametrize(("e", "mu"), MATERIALS)
def test_contacts(e, mu):
    rng, invMasses, invInertias, motion, n = random_pairs(4)
    depth, point = rng.uniform(0, 1, COUNT), rng.normal(size=(3, COUNT))
    after = motion.copy()
    shift = kernels.position_corrections(invMasses, depth)
    after[:3] += shift * n[:, None]
    arms = (point + shift[1] * n)[:, None] - after[:3]
    masses = invMasses, invInertias
    effective = kernels.inverse_effective_mass(*masses, vectors.cross(arms, n[:, None]))
    step = SimpleNamespace(CRCoeff=e, mu=mu)
    impulse, friction = kernels.collide(after[3:], *masses, arms, n, *effective, step)
    sliding = limited = 0
    for c in range(COUNT):
        pair = [Stub(*state) for state in states_of(invMasses, invInertias, motion, c)]
        answer = resolve_collision(*pair, *(column(x, c) for x in (depth, n, point)), e, mu)
        if answer is None:
            assert not invMasses[:, c].any()
            continue
        j, across, arm = answer
        assert (j, across, arm) == (impulse[c], column(friction, c), column(arms[:, 0], c))
        for k in range(2):
            one = pair[k].body
            found = one.position + one.linVelocity + one.angVelocity
            assert found == column(after[:, k], c)
        sliding += any(across)
        limited += triples.norm(across) > mu * j * (1 - 1e-12) > 0
    if mu:
        assert 500 < sliding < COUNT and 50 < limited < sliding


@pytest.mark.parametrize("upper", [True, False])
def test_constraints(upper):
    rng, invMasses, invInertias, motion, _ = random_pairs(5)
    invMasses = np.where(invMasses.sum(axis=0) > 0.0, invMasses, 1.0)
    points = motion[:3] + rng.normal(size=(3, 2, COUNT))
    points[:, 1, ::7] = points[:, 0, ::7]
    refValue = vectors.norm(points[:, 0] - points[:, 1]) * rng.uniform(0.5, 1.5, COUNT)
    refValue[::7] = 0.2
    arms, tolerance = points - motion[:3], 0.3
    C, n = kernels.distance_error(points[:, 0], points[:, 1], refValue)
    isViolated = kernels.is_violated(C, np.full(COUNT, upper), tolerance)
    moved = motion[:3] + kernels.position_corrections(invMasses, C) * n[:, None]
    velocity = motion[3:].copy()
    kernels.resolve_velocity_constraint(velocity, invMasses, invInertias, arms, n, tolerance)
    stopped = 0
    for c in range(COUNT):
        (w1, I1, x1, v1, omega1), (w2, I2, x2, v2, omega2) = states_of(
            invMasses, invInertias, motion, c
        )
        p1, p2 = (column(points[:, k], c) for k in range(2))
        d = triples.sub(p1, p2)
        assert direction(d, triples.norm(d)) == column(n, c)
        wasValid, positions = resolve_position_constraint(
            (x1, x2), (p1, p2), refValue[c], (w1, w2), upper, tolerance
        )
        assert wasValid is not bool(isViolated[c])
        if not wasValid:
            assert np.array_equal(np.concatenate(positions).T, moved[..., c])
        wasValid, *velocities = resolve_velocity_constraint(
            (x1, x2), (p1, p2), (v1, v2), (omega1, omega2), (w1, w2), (I1, I2), tolerance
        )
        found = np.reshape(velocities, (2, 2, 3)).transpose(0, 2, 1).reshape(6, 2)
        assert np.array_equal(found, velocity[..., c])
        stopped += not wasValid
    assert 200 < np.count_nonzero(isViolated) < 1800 and stopped > 1000
