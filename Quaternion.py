"""Quaternion algebra on rows.

A quaternion is a row (w, x, y, z), scalar part first, and n of them have shape (n, 4). The
coursework's functions, Q…, take (n, 4), (1, 4) or (4,) arrays, broadcast a single one against
several, and return a new float64 array of rows.

Products are written out: unlike with `einsum` or BLAS, no row depends on the number of rows.
"""

import math

import numpy as np

# Angle in radians below which sin(a)/a is taken as 1 - a²/6. This avoids 0/0; the next term,
# a⁴/120, is less than half a unit in the last place of 1.
SMALL_ANGLE = 1e-4


def _components(rows, width):
    """Returns the columns of (n, width) or (width,) rows as contiguous (n,) arrays."""
    array = np.asarray(rows, dtype=np.float64)
    if array.ndim not in (1, 2) or array.shape[-1] != width:
        raise ValueError(f"expected rows of {width} numbers, not an array of shape {array.shape}")
    return tuple(np.ascontiguousarray(array.reshape(-1, width).T))


def _rows(components):
    """Inverse of `_components`: broadcasts n-vectors and joins them to rows (n, width)."""
    return np.stack(np.broadcast_arrays(*components), axis=-1)


def multiply(a, b):
    """Hamilton product of two quaternions given as tuples (w, x, y, z) of floats or of arrays."""
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

    Uses NumPy's sin, cos and exp, because those of `math` differ in the last bits on some machines.
    """
    w, x, y, z = q
    angle = math.sqrt(x * x + y * y + z * z)
    sinc = 1.0 - angle * angle / 6.0 if angle < SMALL_ANGLE else float(np.sin(angle)) / angle
    cosine, scale = float(np.cos(angle)), float(np.exp(w))
    return scale * cosine, scale * sinc * x, scale * sinc * y, scale * sinc * z


def exponentials(q):
    """`exponential` of a tuple (w, x, y, z) of arrays, with the same bits."""
    w, x, y, z = q
    angle = np.sqrt(x * x + y * y + z * z)
    isSmall = angle < SMALL_ANGLE
    safe = np.where(isSmall, 1.0, angle)
    sinc = np.where(isSmall, 1.0 - angle * angle / 6.0, np.sin(safe) / safe)
    cosine, scale = np.cos(angle), np.exp(w)
    return scale * cosine, scale * sinc * x, scale * sinc * y, scale * sinc * z


def rotation_matrices(q):
    """Returns the nine entries of the rotation matrix of each quaternion, row by row.

    q : tuple (w, x, y, z) of floats or of arrays, not zero. As q v q⁻¹ does not depend on |q|,
        dividing by |q|² keeps the matrix orthogonal to rounding even if q has drifted.
    """
    w, x, y, z = q
    s = 2.0 / (w * w + x * x + y * y + z * z)
    xs, ys, zs = x * s, y * s, z * s
    wx, wy, wz = w * xs, w * ys, w * zs
    xx, xy, xz = x * xs, x * ys, x * zs
    yy, yz, zz = y * ys, y * zs, z * zs
    row0 = 1.0 - (yy + zz), xy - wz, xz + wy
    row1 = xy + wz, 1.0 - (xx + zz), yz - wx
    row2 = xz - wy, yz + wx, 1.0 - (xx + yy)
    return row0 + row1 + row2


def QMult(q1, q2):
    """Hamilton product of rows: (n, 4) and (n, 4) to (n, 4)."""
    return _rows(multiply(_components(q1, 4), _components(q2, 4)))


def QConj(q):
    """Conjugate (w, -x, -y, -z) of each row: (n, 4) to (n, 4)."""
    w, x, y, z = _components(q, 4)
    return _rows((w, -x, -y, -z))


def QInv(q):
    """Inverse of each nonzero row, conjugate over squared length: (n, 4) to (n, 4)."""
    w, x, y, z = _components(q, 4)
    squared = w * w + x * x + y * y + z * z
    return _rows((w / squared, -x / squared, -y / squared, -z / squared))


def QRotate(q, v):
    """Rotates vectors by quaternions, q v q⁻¹: (n, 4) and (n, 3) to (n, 3)."""
    r = rotation_matrices(_components(q, 4))
    x, y, z = _components(v, 3)
    return _rows([r[k] * x + r[k + 1] * y + r[k + 2] * z for k in (0, 3, 6)])


def QExp(q):
    """Exponential of each row q = (w, u): e^w (cos |u|, sin |u| u / |u|); (n, 4) to (n, 4).

    For q = (0, axis · angle/2), the result is the unit quaternion of a rotation by `angle` radians,
    counter-clockwise seen against the axis. If u is zero, the result is (e^w, 0, 0, 0).
    """
    return _rows(exponentials(_components(q, 4)))


def Q2RotMatrix(q):
    """Rotation matrix R (3, 3) of one unit quaternion (1, 4) or (4,): R v = q v q⁻¹."""
    components = _components(q, 4)
    if len(components[0]) != 1:
        raise ValueError(f"expected one quaternion, not {len(components[0])}")
    return np.array(rotation_matrices(components)).reshape(3, 3)
