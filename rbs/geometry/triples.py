"""Vectors of three floats: the algebra of one pair of bodies.

A vector is a tuple of three floats, a matrix one of nine, row by row. `rbs.geometry.vectors` has
the same functions for arrays of vectors, with the same bits.
"""

import math
import reprlib

import numpy as np

ZERO = (0.0, 0.0, 0.0)


def floats(value, count):
    """Returns an array of `count` numbers, in any shape, as a tuple of floats."""
    isPlain = type(value) is np.ndarray and value.dtype.char == "d" and value.size == count
    value = value.ravel() if isPlain else np.asarray(value, dtype=np.float64).reshape(count)
    return tuple(value.tolist())


def number(value):
    """Returns a number, or an array of one number, as a float."""
    return value if type(value) is float else floats(value, 1)[0]


def shown_value(value):
    """Returns a value as Python text of one line and limited length, without NumPy's names."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, tuple | list):
        value = type(value)(one.item() if isinstance(one, np.generic) else one for one in value)
    return " ".join(reprlib.repr(value).split())


def vector(row):
    """`floats` of three, twice as fast for an array (1, 3)."""
    try:
        ((x, y, z),) = row.tolist()
    except (AttributeError, TypeError, ValueError):
        return floats(row, 3)
    return x, y, z


def matrix(rows):
    """`floats` of nine, twice as fast for an array (3, 3)."""
    try:
        (a, b, c), (d, e, f), (g, h, i) = rows.tolist()
    except (AttributeError, TypeError, ValueError):
        return floats(rows, 9)
    return a, b, c, d, e, f, g, h, i


def row(vector):
    """Returns a vector of three floats as an array (1, 3)."""
    result = np.empty((1, 3))
    result[0, 0], result[0, 1], result[0, 2] = vector
    return result


def add(a, b):
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def sub(a, b):
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scale(factor, v):
    return (factor * v[0], factor * v[1], factor * v[2])


def divide(v, divisor):
    """v / divisor, which rounds differently from (1 / divisor) · v."""
    return (v[0] / divisor, v[1] / divisor, v[2] / divisor)


def mul_add(v, factor, n):
    return (v[0] + factor * n[0], v[1] + factor * n[1], v[2] + factor * n[2])


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a, b):
    (ax, ay, az), (bx, by, bz) = a, b
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


def norm(v):
    x, y, z = v
    return math.sqrt(x * x + y * y + z * z)


def mat_vec(matrix, v):
    (a, b, c, d, e, f, g, h, i), (x, y, z) = matrix, v
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z


def adjugate(matrix):
    """Adjugate of a symmetric matrix of nine floats, and its determinant."""
    a, b, c, _, d, e, _, _, f = matrix
    x, y, z = d * f - e * e, c * e - b * f, b * e - c * d
    u, v, w = a * f - c * c, b * c - a * e, a * d - b * b
    return (x, y, z, y, u, v, z, v, w), a * x + b * y + c * z


def inverse_symmetric(matrix):
    """Inverse of a symmetric matrix of nine floats, by cofactors: unlike LAPACK's, with the same
    bits on every processor. Raises ZeroDivisionError if the determinant is 0.
    """
    cofactors, determinant = adjugate(matrix)
    return tuple(one / determinant for one in cofactors)


def transpose(matrix):
    return (*matrix[0::3], *matrix[1::3], *matrix[2::3])


def rotate_tensor(rotation, tensor):
    """R T Rᵀ for a symmetric tensor T; symmetric to the last bit."""
    r0, r1, r2 = rotation[0:3], rotation[3:6], rotation[6:9]
    columns = transpose(tensor)
    x, y, z = mat_vec(columns, r0), mat_vec(columns, r1), mat_vec(columns, r2)  # rows of R T
    xx, xy, xz = dot(x, r0), dot(x, r1), dot(x, r2)
    yy, yz, zz = dot(y, r1), dot(y, r2), dot(z, r2)
    return xx, xy, xz, xy, yy, yz, xz, yz, zz
