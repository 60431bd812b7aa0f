"""Quaternion.py against SciPy's rotations, 2×2 complex matrices and series."""

import numpy as np
import pytest
from oracles import random_quaternions, rotation
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from Quaternion import SMALL_ANGLE, Q2RotMatrix, QConj, QExp, QInv, QMult, QRotate

EPS = np.finfo(float).eps
# A few sums of four products of numbers of order 1.
ROUNDING = 16 * EPS


@pytest.fixture
def rng():
    return np.random.default_rng(2024)


def as_matrices(q):
    """Quaternions as complex matrices (n, 2, 2), in which their product is the matrix product."""
    w, x, y, z = np.asarray(q, dtype=complex).T
    return np.moveaxis(np.array([[w + 1j * x, y + 1j * z], [-y + 1j * z, w - 1j * x]]), 2, 0)


def as_quaternions(matrices):
    first, second = matrices[:, 0, 0], matrices[:, 0, 1]
    return np.stack([first.real, first.imag, second.real, second.imag], axis=1)


@pytest.mark.parametrize("n", [0, 1, 1000])
def test_products_conjugates_and_inverses(rng, n):
    """Quaternions of any length multiply as complex matrices do."""
    p, q = rng.normal(size=(2, n, 4))
    result = QMult(p, q)
    assert result.shape == (n, 4) and result.dtype == np.float64
    # |p||q| is at most about 20 here
    expected = as_quaternions(as_matrices(p) @ as_matrices(q))
    assert np.abs(result - expected).max(initial=0) < 20 * ROUNDING
    q *= 10 ** rng.uniform(-3, 3, size=(n, 1))
    assert np.array_equal(QConj(q), q * [1, -1, -1, -1])
    for product in (QMult(q, QInv(q)), QMult(QInv(q), q)):
        assert np.abs(product - [1, 0, 0, 0]).max(initial=0) < ROUNDING


def test_rotations_are_scipys(rng):
    q, v = random_quaternions(rng, 1000), rng.normal(size=(1000, 3))
    expected = rotation(q).apply(v)
    assert np.abs(QRotate(q, v) - expected).max() < 8 * ROUNDING
    # q and 5 q turn alike: q v q⁻¹ does not depend on the length
    assert np.abs(QRotate(5 * q, v) - expected).max() < 8 * ROUNDING
    for row in q[:100]:
        R = Q2RotMatrix(row[None])
        assert R.shape == (3, 3)
        assert np.abs(R - rotation(row).as_matrix()).max() < ROUNDING


def test_exponentials_are_those_of_complex_matrices_and_of_rotation_vectors(rng):
    q = rng.normal(size=(100, 4)) * 2
    expected = as_quaternions(np.array([expm(m) for m in as_matrices(q)]))
    # expm squares and scales, and loses a digit or two more than a sine does
    assert np.abs(QExp(q) / np.exp(q[:, :1]) - expected / np.exp(q[:, :1])).max() < 1e-13
    vectors = rng.normal(size=(1000, 3)) * rng.uniform(0, 4, size=(1000, 1))
    q = QExp(np.column_stack((np.zeros(1000), 0.5 * vectors)))
    assert np.abs(np.linalg.norm(q, axis=1) - 1).max() < ROUNDING
    same = rotation(q).as_matrix() - Rotation.from_rotvec(vectors).as_matrix()
    assert np.abs(same).max() < 4 * ROUNDING


def test_vanishing_rotations_are_exact_across_the_switch(rng):
    near = SMALL_ANGLE * (1 + np.linspace(-1e-3, 1e-3, 41))
    lengths = np.concatenate(([1e-300, 1e-160, 1e-20, 1e-12, 1e-8, 1e-5, 1e-3], near))
    assert 20 < (lengths < SMALL_ANGLE).sum() < len(lengths) - 20
    u = rng.normal(size=(len(lengths), 3))
    u *= lengths[:, None] / np.linalg.norm(u, axis=1, keepdims=True)
    result = QExp(np.column_stack((np.zeros(len(u)), u)))
    # cos a = 1 - a²/2 + a⁴/24 - …, sin a / a = 1 - a²/6 + a⁴/120 - …; the next ones are below 1e-20
    a2 = (u.astype(np.longdouble) ** 2).sum(axis=1)
    cosine, sinc = 1 - a2 / 2 + a2 * a2 / 24, 1 - a2 / 6 + a2 * a2 / 120
    # cos: within one unit in the last place. The vector part: within 3 of its own, which near the
    # switch are 3 · 2.2e-16 · 1e-4 = 7e-20, so that neither side of it stands out by 1e-16.
    assert np.abs(result[:, 0] - cosine).max() <= EPS
    assert (np.abs(result[:, 1:] - sinc[:, None] * u) <= 3 * EPS * np.abs(u)).all()
    # no rotation at all: not one bit of a vector part
    assert np.array_equal(QExp([[0.5, 0, 0, 0]]), [[np.exp(0.5), 0, 0, 0]])
