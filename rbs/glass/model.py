"""The coursework's formulas in plain NumPy, for all samples at once, one on each line.

`mistakes.md` lists edits of these lines: the formulas of programs with known mistakes. The graders
compute their results by them, and `terms` the symbols of an event. They stand apart from the
simulation that they judge: nothing is imported from it, quaternions neither.

Arrays have the sample first: vectors (n, 3), quaternions (n, 4), tensors (n, 3, 3). Units are m,
kg, s and rad. Two bodies are a `Pair`.
"""

from typing import NamedTuple

import numpy as np

UP = np.array([[0.0, 1.0, 0.0]])
GRAVITY = -9.8 * UP  # m/s²
NEXT, LAST = np.array([1, 2, 0]), np.array([2, 0, 1])  # axes after and before each, in a circle
INERTIA_DIVISOR = 6  # factor by which the inertia tensor of the 2024 release is too small


def dot(a, b):
    return np.add.reduce(a * b, axis=1)


def length_of(a):
    """Lengths of the rows, (n,)."""
    return np.sqrt(dot(a, a))


def unit(a):
    """The rows, each divided by its length."""
    return a / length_of(a)[:, None]


def direction(a):
    """`unit`; upwards if a row is zero."""
    length = length_of(a)[:, None]
    isZero = length == 0.0
    return np.where(isZero, UP, a / np.where(isZero, 1.0, length)) if isZero.any() else a / length


def scaled(factor, a):
    """The rows (n, w), each times its factor (n,)."""
    return factor[:, None] * a


def cross(a, b):
    """The cross products of the rows; np.cross takes five times as long for as few."""
    return a.take(NEXT, 1) * b.take(LAST, 1) - a.take(LAST, 1) * b.take(NEXT, 1)


def times(T, a):
    """The products of tensors (n, 3, 3), or a number, and the rows."""
    return np.add.reduce(T * a[:, None], axis=2) if np.ndim(T) else T * a


def inverse_of(tensor):
    adjugate = cross(tensor[NEXT], tensor[LAST]).T
    return adjugate / (tensor[0] @ adjugate[:, 0])


def multiply(p, q):
    """Hamilton products of the rows: (s t − u·v, s v + t u + u × v)."""
    s, u, t, v = p[:, :1], p[:, 1:], q[:, :1], q[:, 1:]
    return np.hstack([s * t - dot(u, v)[:, None], s * v + t * u + cross(u, v)])


def exponential(q):
    """Exponentials of the rows (s, u): e^s (cos |u|, sin |u| u/|u|)."""
    angle = np.linalg.norm(q[:, 1:], axis=1, keepdims=True)
    return np.exp(q[:, :1]) * np.hstack([np.cos(angle), np.sinc(angle / np.pi) * q[:, 1:]])


def rotation_matrices(q):
    """R (n, 3, 3) with R v = q v q⁻¹, for quaternions (n, 4) of any length but zero."""
    q = np.reshape(q, (-1, 4))
    w, x, y, z = (q / np.sqrt(np.sum(q * q, axis=1, keepdims=True))).T
    row0 = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    row1 = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    row2 = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return np.array((row0, row1, row2)).transpose(2, 0, 1)


def step(x, q, v, w, h, count, mass, g=GRAVITY):
    """The state after a time step h (n, 1) of semi-implicit Euler, the count-th one."""
    gravity = g
    newV = v + h * gravity
    newX = x + h * newV
    half = h / 2 * w
    turn = exponential(np.insert(half, 0, 0.0, axis=1))
    newQ = multiply(turn, q)
    return newX, newQ, newV, w


def world_inverse_tensors(body, q, isSmall=False, isReleased=False):
    """Inverse inertia tensors (n, 3, 3) of orientations q: R I⁻¹ Rᵀ, or the release's.

    body : with mass, centre and tensor; isSmall, isReleased : whether the tensor is six times too
        small, and turned as Rᵀ I⁻¹ R, as released
    """
    centre, mass = body.centre, body.mass  # noqa: F841, for edits
    R = rotation_matrices(q)
    inertia = body.tensor / (INERTIA_DIVISOR if isSmall else 1)
    inverse = inverse_of(inertia)
    return in_world_axes(R, inverse, isReleased)


def in_world_axes(R, inverse, isReleased):
    """R I⁻¹ Rᵀ, or Rᵀ I⁻¹ R as released (quirk 2). R, inverse : (3, 3), or (n, 3, 3)"""
    if isReleased:
        R = np.swapaxes(R, -1, -2)
    return R @ inverse @ np.swapaxes(R, -1, -2)


class Pair(NamedTuple):
    """Two bodies: pairs of positions, orientations, linear and angular velocities; inverse masses
    (numbers); inverse inertia tensors in world axes.
    """

    x: list
    q: list
    v: list
    w: list
    m: list
    T: list


def collide(pair, depth, n, point, e):
    """Resolves a contact as `resolve_collision` does; returns the states (x, v, w) of both, and the
    terms p, r1, r2, u, u·n, I1⁻¹(r1×n), I2⁻¹(r2×n), K and j.
    """
    (x1, x2), (v1, v2), (w1, w2), (m1, m2), (T1, T2) = pair.x, pair.v, pair.w, pair.m, pair.T
    before = (x1, v1, w1), (x2, v2, w2)  # noqa: F841, for edits
    weight1, weight2 = m1 / (m1 + m2), m2 / (m1 + m2)
    shift = scaled(depth, n)
    x1, x2 = x1 - weight1 * shift, x2 + weight2 * shift
    p = point + weight2 * shift
    r1, r2 = p - x1, p - x2
    c1, c2 = cross(r1, n), cross(r2, n)
    u1 = v1 + cross(w1, r1)
    u2 = v2 + cross(w2, r2)
    closing = dot(u1 - u2, n)
    a1, a2 = times(T1, c1), times(T2, c2)
    K = m1 + m2 + dot(c1, a1) + dot(c2, a2)
    j = (1.0 + e) * closing / K
    newV1 = v1 - scaled(m1 * j, n)
    newV2 = v2 + scaled(m2 * j, n)
    newW1 = w1 - scaled(j, a1)
    newW2 = w2 + scaled(j, a2)
    after = (x1, newV1, newW1), (x2, newV2, newW2)
    return after, (p, r1, r2, u1 - u2, closing, a1, a2, K, j)


def rub(pair, n, p, mu, impulse):
    """Resolves friction, after the impulse (n,) along the normal; returns the states (v, w) of
    both, and the terms r1, r2, u, t, u·t, I1⁻¹(r1×t), I2⁻¹(r2×t), K, the limit and f.
    """
    (x1, x2), (v1, v2), (w1, w2), (m1, m2), (T1, T2) = pair.x, pair.v, pair.w, pair.m, pair.T
    r1, r2 = p - x1, p - x2
    u = v1 + cross(w1, r1) - v2 - cross(w2, r2)
    across = u - scaled(dot(u, n), n)
    sliding = length_of(across)
    t = scaled(1.0 / np.where(sliding == 0.0, 1.0, sliding), across)
    c1, c2 = cross(r1, t), cross(r2, t)
    a1, a2 = times(T1, c1), times(T2, c2)
    K = m1 + m2 + dot(c1, a1) + dot(c2, a2)
    limit = mu * np.maximum(impulse, 0.0)
    f = np.minimum(sliding / K, limit)
    newV1 = v1 - scaled(m1 * f, t)
    newV2 = v2 + scaled(m2 * f, t)
    newW1 = w1 - scaled(f, a1)
    newW2 = w2 + scaled(f, a2)
    return ((newV1, newW1), (newV2, newW2)), (r1, r2, u, t, sliding, a1, a2, K, limit, f)


def holds(C, isUpper, tolerance, refValue):
    upper = C <= tolerance
    lower = C >= -tolerance
    return upper if isUpper else lower


def move(pair, p1, p2, refValue, isUpper, tolerance, others):
    """Corrects the positions as `resolve_position_constraint` does.

    Returns whether they were valid, (n,), also with other tolerances; both positions; the terms n,
    ‖p1−p2‖ and C.
    """
    (x1, x2), (m1, m2) = pair.x, pair.m
    d = p1 - p2
    n = direction(d)
    length = length_of(d)
    C = length - refValue
    wasValid = holds(C, isUpper, tolerance, refValue)
    weight1, weight2 = m1 / (m1 + m2), m2 / (m1 + m2)
    shift = scaled(C, n)
    newX1 = x1 - weight1 * shift
    newX2 = x2 + weight2 * shift
    isKept = wasValid[:, None]
    after = [np.where(isKept, x1, newX1), np.where(isKept, x2, newX2)]
    return [wasValid, *(holds(C, isUpper, one, refValue) for one in others)], after, (n, length, C)


def stop(pair, p1, p2):
    """Corrects the velocities as `resolve_velocity_constraint` does, by one impulse.

    Returns J v (n,); the corrected linear and angular velocities, two each; the terms r1, r2,
    I1⁻¹(r1×n), -I2⁻¹(r2×n), K and λ.
    """
    (x1, x2), (v1, v2), (w1, w2), (m1, m2), (T1, T2) = pair.x, pair.v, pair.w, pair.m, pair.T
    d = p1 - p2
    n = direction(d)
    r1, r2 = p1 - x1, p2 - x2
    J = n, cross(r1, n), -n, -cross(r2, n)
    v = v1, w1, v2, w2
    invM = m1, T1, m2, T2
    Jv = sum(map(dot, J, v))
    MJ = list(map(times, invM, J))
    K = sum(map(dot, J, MJ))
    impulse = -Jv / K
    changes = [scaled(impulse, one) for one in MJ]
    newV1, newW1, newV2, newW2 = (old + new for old, new in zip(v, changes, strict=True))
    after = Jv, (newV1, newV2), (newW1, newW2)
    return *after, (r1, r2, MJ[1], MJ[3], K, impulse)


def is_slow(Jv, tolerance):
    return np.abs(Jv) <= tolerance
