"""Quaternion algebra on rows.

A quaternion is a row (w, x, y, z), scalar part first; a batch of n of them has shape (n, 4). Every
function takes (n, 4), (1, 4) or (4,) arrays, a single one being broadcast against a batch, returns
a new float64 array with rows, and leaves its arguments as they are.

The products are written out by component: the result of a row does not depend on how many rows
are worked on together, which neither `einsum` nor BLAS promises.
"""

import math

import numpy as np

# Below this angle, in radians, sin(a)/a is taken as 1 - a²/6: the next term, a⁴/120, is under half
# a unit in the last place of 1, and the division 0/0 is avoided.
SMALL_ANGLE = 1e-4


def _components(rows, width):
    """The columns of (n, width) or (width,) rows, as a tuple of contiguous (n,) arrays."""
    array = np.asarray(rows, dtype=np.float64)
    if array.ndim not in (1, 2) or array.shape[-1] != width:
        raise ValueError(f"expected rows of {width} numbers, got an array of shape {array.shape}")
    return tuple(np.ascontiguousarray(array.reshape(-1, width).T))


def _rows(components):
    """The inverse of `_components`: n-vectors, broadcast against each other, to rows (n, width)."""
    return np.stack(np.broadcast_arrays(*components), axis=-1)


def multiply(a, b):
    """Hamilton product of two quaternions given as tuples (w, x, y, z) of floats or of arrays.

    Nothing but products and sums of components, as in `rotation_matrices`: one body serves both.
    """
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def exponential(q):
    """`QExp` of one quaternion given as a tuple (w, x, y, z) of floats.

    NumPy's sin, cos and exp serve here too: those of `math` have other last bits on some machines.
    """
    w, x, y, z = q
    angle = math.sqrt(x * x + y * y + z * z)
    if angle < SMALL_ANGLE:
        sinc = 1.0 - angle * angle / 6.0
    else:
        sinc = float(np.sin(angle)) / angle
    cosine, scale = float(np.cos(angle)), float(np.exp(w))
    return scale * cosine, scale * sinc * x, scale * sinc * y, scale * sinc * z


def exponentials(q):
    """`exponential` of many, given as a tuple (w, x, y, z) of arrays, with the same bits."""
    w, x, y, z = q
    angle = np.sqrt(x * x + y * y + z * z)
    isSmall = angle < SMALL_ANGLE
    safe = np.where(isSmall, 1.0, angle)
    sinc = np.where(isSmall, 1.0 - angle * angle / 6.0, np.sin(safe) / safe)
    cosine, scale = np.cos(angle), np.exp(w)
    return scale * cosine, scale * sinc * x, scale * sinc * y, scale * sinc * z


def rotation_matrices(q):
    """The nine entries of the rotation matrix of q, or of each, row by row.

    q : tuple (w, x, y, z) of floats or of arrays; any length but zero, since q v q⁻¹ does not
    depend on it. Dividing by |q|² keeps the matrix orthogonal to rounding when q has drifted.
    """
    w, x, y, z = q
    s = 2.0 / (w * w + x * x + y * y + z * z)
    xs, ys, zs = x * s, y * s, z * s
    wx, wy, wz = w * xs, w * ys, w * zs
    xx, xy, xz = x * xs, x * ys, x * zs
    yy, yz, zz = y * ys, y * zs, z * zs
    return (
        1.0 - (yy + zz),
        xy - wz,
        xz + wy,
        xy + wz,
        1.0 - (xx + zz),
        yz - wx,
        xz - wy,
        yz + wx,
        1.0 - (xx + yy),
    )


def QMult(q1, q2):
    """Hamilton product of the rows: (n, 4) and (n, 4), or (1, 4) for either, to (n, 4)."""
    return _rows(multiply(_components(q1, 4), _components(q2, 4)))


def QConj(q):
    """Conjugate (w, -x, -y, -z) of each row: (n, 4) to (n, 4)."""
    w, x, y, z = _components(q, 4)
    return _rows((w, -x, -y, -z))


def QInv(q):
    """Inverse of each row, conjugate over squared length: (n, 4) to (n, 4). No row may be zero."""
    w, x, y, z = _components(q, 4)
    squared = w * w + x * x + y * y + z * z
    return _rows((w / squared, -x / squared, -y / squared, -z / squared))


def QRotate(q, v):
    """Rotates the vectors v by the quaternions q: q v q⁻¹.

    q : (1, 4), one rotation for all vectors, or (n, 4), one for each
    v : (n, 3), or (1, 3) to be rotated by each of n quaternions
    returns (n, 3)
    """
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = rotation_matrices(_components(q, 4))
    x, y, z = _components(v, 3)
    return _rows(
        (
            r00 * x + r01 * y + r02 * z,
            r10 * x + r11 * y + r12 * z,
            r20 * x + r21 * y + r22 * z,
        )
    )


def QExp(q):
    """Exponential of each row: e^w (cos |u|, sin |u| u / |u|) for q = (w, u); (n, 4) to (n, 4).

    For a rotation, q = (0, axis · angle/2) gives the unit quaternion that turns by `angle` radians,
    counter-clockwise seen against the axis. A vanishing vector part gives (e^w, 0, 0, 0).
    """
    return _rows(exponentials(_components(q, 4)))


def Q2RotMatrix(q):
    """Rotation matrix R (3, 3) of a unit quaternion (1, 4) or (4,): R v = q v q⁻¹ for columns v."""
    components = _components(q, 4)
    if len(components[0]) != 1:
        raise ValueError(f"expected one quaternion, got {len(components[0])}")
    return np.array(rotation_matrices(components)).reshape(3, 3)
