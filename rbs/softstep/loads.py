"""Loads of sleepers: the least impulses that balance gravity, for the report of a step.

Springs between bodies that have fallen asleep are jammed, so their impulses do not say what carries
what. Each point gets impulses x ≥ 0 along directions of its friction cone, which change momenta by
A x. With masses M, and momenta b by gravity in a step, M v = A x + b is what is left of them, and
v · M v + ε x · x is minimised, by an interior point method.
"""

from functools import cached_property

import numpy as np
from scipy.sparse import bsr_array, coo_array, dia_array
from scipy.sparse.linalg import splu

from rbs.geometry.hulls import tangents
from rbs.geometry.vectors import cross, dot, indices, norm, take
from rbs.softstep.detection import Frames
from rbs.softstep.manifolds import TINY
from rbs.softstep.placed import PlacedManifolds

# Directions of a cone with μ = 1, along its normal and two tangents, of which the first is that of
# gravity. More cost time; with fewer, bodies that hardly stick are not in balance.
CONE = np.array([(1.0, np.cos(a), np.sin(a)) for a in np.arange(8) * (np.pi / 4.0)]).T
# Gap up to which a point may carry, as a fraction of the thickness of the thinner body. With more,
# points carry that hang in the air; with less, bodies that fell asleep there are not in balance.
SLACK = 5e-3
# ε, times the largest mass. With more, bodies are not in balance; with less, it takes longer.
SOFTNESS = 1e-5
# Most iterations, the energy left at a point at which they end, as a fraction of what gravity adds
# to a body, and the share of that energy at which each aims. More cost time, or loads are inexact.
ITERATIONS, GAP, AIM = 40, 1e-9, 0.1
# Options of `splu` for a symmetric matrix, without pivoting. Others take 3 to 20 times as long.
SYMMETRIC = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0}


class RestingContacts:
    """Contacts between sleepers, and with what is fixed, computed when somebody asks for them."""

    def __init__(self, step, kept, isAsleep, manifolds, given=None):
        """kept : `SolverState`; isAsleep : (n,), bodies that do not move; manifolds : `Manifolds`
        given : columns of the other contacts, as for `StepReport.add_columns`
        """
        self._bodies, self._manifolds, self._given = step.bodies.copied(), manifolds, given
        self._mu, self._bounds = step.mu, kept.constraint
        self._fall = step.timeStep * np.reshape(step.gravity, (3, 1))
        isSleeper = np.append(isAsleep & ~step.bodies.isFixed, False)
        self._sleepers = indices(isSleeper)
        self._number = np.where(isSleeper, isSleeper.cumsum() - 1, -1)

    @cached_property
    def _points(self):
        """`(placed, k, m)`: points k of manifolds m, which are placed, that may carry."""
        self._bodies.update_rotations()
        frames, rows = Frames(self._bodies), np.arange(len(self._manifolds.key))
        placed = PlacedManifolds(self._manifolds, frames, rows)
        least = SLACK * frames.sizes(placed.first, placed.second)[0]
        return placed, *np.nonzero(placed.isPoint & (placed.gap <= least))

    @property
    def depths(self):
        placed, k, m = self._points
        return np.maximum(-placed.gap[k, m], 0.0)

    @cached_property
    def columns(self):
        """The contacts, as for `StepReport.add_columns`."""
        placed, k, m = self._points
        arm, count, bodies = placed.arm[:, k, m], len(m), self._bodies
        # constraints at a bound are points without friction that pull or push
        tied, vertices = (self._bounds[i:4:2].astype(np.intp) for i in (0, 1))
        corner = bodies.arms(tied, vertices)
        way = np.diff(take(bodies.position, tied, axis=1) + corner, axis=1)[:, 0]
        length, least = norm(way), SLACK * bodies.hulls.thickness[tied].min(axis=0)
        lower, upper = self._bounds[4:]
        pulls, pushes = indices(length >= upper - least), indices(length <= lower + least)
        some, way = np.append(pulls, pushes), way / np.maximum(length, TINY)
        way = np.column_stack((-way[:, pulls], way[:, pushes]))
        tied, corner = tied[:, some], corner[..., some]
        ends = np.column_stack(((placed.first[m], placed.second[m]), tied))
        arms = np.concatenate((np.stack((arm, arm - placed.t[:, m]), axis=1), corner), axis=2)
        n = np.column_stack((placed.normal[:, m], way))
        t = self._fall - n * dot(n, self._fall) + TINY * tangents(n)
        t /= norm(t)
        axes = np.stack((n, t, cross(n, t)), axis=1)
        mu = np.where(np.arange(len(n[0])) < count, self._mu, 0.0)
        impulse = self._solved(ends, arms, axes, mu)[:, :count]
        friction = np.add.reduce(axes[:, 1:, :count] * impulse[1:], axis=1)
        return placed.columns(k, m, impulse[0], friction)

    def _solved(self, ends, arms, axes, mu):
        """Impulses (3, Q) along axes (3, 3, Q) of points with arms (3, 2, Q), see `_effects`."""
        mass = 1.0 / self._bodies.invMass[self._sleepers]
        inertia = mass * self._bodies.hulls.radius[self._sleepers] ** 2
        b = np.zeros((len(mass), 6))
        b[:, :3] = (mass * self._fall).T
        if self._given is not None:
            _, first, second, _, normal, point, impulse, friction, arm = self._given
            others = np.stack((arm, point - take(self._bodies.state[:3], second, 1)), axis=1)
            force = normal * impulse + friction
            effects = self._effects(np.stack((first, second)), others, force[:, None])
            b += (effects @ np.ones(len(impulse))).reshape(-1, 6)
        if len(mu) == 0 or not b.any():
            return np.zeros((3, len(mu)))
        M = np.stack((mass, mass, mass, inertia, inertia, inertia), axis=1)
        return least_loads(self._effects(ends, arms, axes), M.ravel(), b.ravel(), mu)

    def _effects(self, ends, arms, axes):
        """Momenta of the N sleepers by unit impulses along axes (3, K, Q) on the second of two ends
        (2, Q), and against them on the first: sparse, (6 N, Q K); arms : (3, 2, Q), from the COMs
        """
        count, points = axes.shape[1:]
        entries = np.empty((6, 2, count, points))
        entries[:3], entries[3:] = axes[:, None], cross(arms[:, :, None], axes[:, None])
        entries[:, 0] *= -1.0
        row = 6 * self._number[ends][:, None] + np.arange(6)[:, None, None, None]
        column = count * np.arange(points) + np.arange(count)[:, None]
        row, column = (np.broadcast_to(x, entries.shape) for x in (row, column))
        some, shape = row >= 0, (6 * len(self._sleepers), count * points)
        return coo_array((entries[some], (row[some], column[some])), shape=shape).tocsr()


def least_loads(A, M, b, mu):
    """Impulses (3, Q), see above; A : (6 N, 3 Q), sparse; M, b : (6 N,); mu : (Q,)"""
    cone = CONE[:, :, None] * np.stack((np.ones_like(mu), mu, mu))[:, None]
    mass, points = M[::6], np.arange(len(mu) + 1)
    load = norm(b.reshape(-1, 6).T[:3]).mean()
    speed = load / mass.mean()
    x, s, v = np.full(cone[0].shape, load), np.full(cone[0].shape, speed), 0.0 * b
    softness, masses = SOFTNESS / mass.max(), dia_array((M[None], [0]), shape=(len(M), len(M)))
    for _ in range(ITERATIONS):
        gap = (x * s).mean()
        if gap <= GAP * load * speed:
            break
        weight = 1.0 / (softness + s / x)
        W = bsr_array((np.einsum("idq,dq,jdq->qij", cone, weight, cone), points[:-1], points))
        factors = splu((masses + A @ W @ A.T).tocsc(), **SYMMETRIC)
        # towards A x + b = M v, s = ε x + Aᵀ v, and x s = AIM gap
        y = weight * (AIM * gap / x - softness * x - _along(cone, A, v))
        dv = factors.solve(b + A @ np.einsum("idq,dq->qi", cone, x + y).ravel() - M * v)
        dx = y - weight * _along(cone, A, dv)
        ds = (AIM * gap - s * dx) / x - s
        share = min(1.0, -0.995 / min((dx / x).min(), (ds / s).min()))
        x, s, v = x + share * dx, s + share * ds, v + share * dv
    return np.einsum("idq,dq->iq", cone, x)


def _along(cone, A, v):
    return np.einsum("idq,qi->dq", cone, (A.T @ v).reshape(-1, 3))
