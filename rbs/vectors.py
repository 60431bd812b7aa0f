"""Vector algebra on components: the same formula for one vector and for thousands of them.

A vector is a tuple of three floats, or an array whose first axis has the three components and whose
last, long axis has the vectors: (3, n). Matrices are tuples of nine floats, row by row, or arrays
(9, n). Both forms take the same operations in the same order, so they give the same bits: sums of
products are written out, and nothing here goes through BLAS, `einsum` or a pairwise sum.
"""

import math

import numpy as np

# The components x y z x y: the factors of a vector product stand next to each other in it.
_CYCLE = np.array([0, 1, 2, 0, 1])


def floats(value, count):
    """`count` Python floats, as a tuple, out of an array of any shape with that many entries."""
    if isinstance(value, tuple) and len(value) == count and isinstance(value[0], float):
        return value
    return tuple(np.asarray(value, dtype=np.float64).reshape(count).tolist())


def number(value):
    """A Python float out of a number, or of an array that holds one."""
    return value if type(value) is float else floats(value, 1)[0]


def add(a, b):
    """a + b."""
    if isinstance(a, np.ndarray):
        return a + b
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def sub(a, b):
    """a - b."""
    if isinstance(a, np.ndarray):
        return a - b
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scale(factor, v):
    """factor · v."""
    if isinstance(v, np.ndarray):
        return factor * v
    return (factor * v[0], factor * v[1], factor * v[2])


def divide(v, divisor):
    """v / divisor, which rounds otherwise than 1 / divisor · v."""
    if isinstance(v, np.ndarray):
        return v / divisor
    return (v[0] / divisor, v[1] / divisor, v[2] / divisor)


def mul_add(v, factor, direction):
    """v + factor · direction."""
    if isinstance(v, np.ndarray):
        return v + factor * direction
    return (
        v[0] + factor * direction[0],
        v[1] + factor * direction[1],
        v[2] + factor * direction[2],
    )


def dot(a, b):
    """Scalar product of each pair of vectors."""
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):  # the same in fewer calls
        products = a * b
        total = products[0]
        total += products[1]
        total += products[2]
        return total
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a, b):
    """Vector product a × b of each pair of vectors."""
    if isinstance(a, np.ndarray):
        a, b = a.take(_CYCLE, axis=0), b.take(_CYCLE, axis=0)
        return a[1:4] * b[2:5] - a[2:5] * b[1:4]
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def sqrt(x):
    """Square root of a float, or of each number of an array."""
    return np.sqrt(x) if isinstance(x, np.ndarray) else math.sqrt(x)


def norm(v):
    """Length of each vector: a float, or (n,)."""
    return sqrt(dot(v, v))


def mat_vec(matrix, v):
    """Matrix times vector: nine entries row by row and three, or (9, n) and (3, n)."""
    if isinstance(v, np.ndarray):
        products = matrix.reshape(3, 3, *(matrix.shape[1:] or (1,))) * v
        result = products[:, 0]
        result += products[:, 1]
        result += products[:, 2]
        return result
    return (
        matrix[0] * v[0] + matrix[1] * v[1] + matrix[2] * v[2],
        matrix[3] * v[0] + matrix[4] * v[1] + matrix[5] * v[2],
        matrix[6] * v[0] + matrix[7] * v[1] + matrix[8] * v[2],
    )


def transpose(matrix):
    """The transposed matrix, nine entries or (9, n)."""
    order = (0, 3, 6, 1, 4, 7, 2, 5, 8)
    if isinstance(matrix, np.ndarray):
        return matrix[list(order)]
    return tuple(matrix[k] for k in order)


def rotate_tensor(rotation, tensor):
    """R T Rᵀ for a symmetric tensor T; symmetric to the last bit. Nine entries each, or (9, n)."""
    columns = [mat_vec(rotation, tensor[k::3]) for k in range(3)]  # of R T
    rows = [tuple(column[k] for column in columns) for k in range(3)]
    xx, yy, zz = (dot(rows[k], rotation[3 * k : 3 * k + 3]) for k in range(3))
    xy, xz = (dot(rows[0], rotation[3 * k : 3 * k + 3]) for k in (1, 2))
    yz = dot(rows[1], rotation[6:9])
    return (xx, xy, xz, xy, yy, yz, xz, yz, zz)
