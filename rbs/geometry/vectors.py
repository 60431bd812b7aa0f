"""Arrays of vectors: the algebra of thousands of bodies or pairs.

The first axis has the components, the last one the vectors: (3, n), and matrices (9, n), row by
row. `rbs.geometry.triples` has the same functions for single vectors, with the same bits: sums of
products are written out, without BLAS, `einsum` or pairwise summation.
"""

import numpy as np

from rbs.geometry.triples import rotate_tensor as rotate_tensor  # works on arrays, too

# Indices of the components x y z x y, in which the factors of a vector product are adjacent.
_CYCLE = np.array([0, 1, 2, 0, 1])


def mul_add(v, factor, direction):
    return v + factor * direction


def dot(a, b):
    products = a * b
    total = products[0]
    total += products[1]
    total += products[2]
    return total


def cross(a, b):
    a, b = a.take(_CYCLE, axis=0), b.take(_CYCLE, axis=0)
    return a[1:4] * b[2:5] - a[2:5] * b[1:4]


def norm(v):
    return np.sqrt(dot(v, v))


def mat_vec(matrix, v):
    """Matrix times vector, (9, n) and (3, n); either may be single, (9,) or (3, 1)."""
    products = matrix.reshape(3, 3, *(matrix.shape[1:] or (1,))) * v
    result = products[:, 0]
    result += products[:, 1]
    result += products[:, 2]
    return result


def vec_mat(v, matrix):
    """Transposed matrix times vector, (9, n) and (3, n)."""
    products = v[:, None] * matrix.reshape(3, 3, *matrix.shape[1:])
    result = products[0]
    result += products[1]
    result += products[2]
    return result
