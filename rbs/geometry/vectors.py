"""Arrays of vectors: the algebra of thousands of bodies or pairs at once.

The first axis has the components and the last, long one the vectors: (3, n), matrices (9, n), row
by row. `rbs.geometry.triples` has the same functions for single vectors, with the same operations
in the same order, and so the same bits: sums of products are written out, and nothing here goes
through BLAS, `einsum` or a pairwise sum.
"""

import numpy as np

from rbs.geometry.triples import (
    rotate_tensor as rotate_tensor,  # nothing but products and sums: as it is
)

# The components x y z x y: the factors of a vector product stand next to each other in it.
_CYCLE = np.array([0, 1, 2, 0, 1])


def mul_add(v, factor, direction):
    """v + factor · direction."""
    return v + factor * direction


def dot(a, b):
    """Scalar product of each pair of vectors."""
    products = a * b
    total = products[0]
    total += products[1]
    total += products[2]
    return total


def cross(a, b):
    """Vector product a × b of each pair of vectors."""
    a, b = a.take(_CYCLE, axis=0), b.take(_CYCLE, axis=0)
    return a[1:4] * b[2:5] - a[2:5] * b[1:4]


def norm(v):
    """Length of each vector, (n,)."""
    return np.sqrt(dot(v, v))


def mat_vec(matrix, v):
    """Matrix times vector, (9, n) and (3, n); either may be a single one, (9,) or (3, 1)."""
    products = matrix.reshape(3, 3, *(matrix.shape[1:] or (1,))) * v
    result = products[:, 0]
    result += products[:, 1]
    result += products[:, 2]
    return result


def transpose(matrix):
    """The transposed matrices, (9, n)."""
    return matrix[[0, 3, 6, 1, 4, 7, 2, 5, 8]]
