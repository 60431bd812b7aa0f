"""Arrays of vectors, the algebra of thousands of bodies or pairs; indexing of long arrays.

The first axis has the components, the last one the vectors: (3, n), and matrices (9, n), row by
row. `rbs.geometry.triples` has the same functions for single vectors, with the same bits: sums of
products are written out, without BLAS, `einsum` or pairwise summation.
"""

import numpy as np

# Indices of the components x y z x y, in which the factors of a vector product are adjacent.
_CYCLE = np.array([0, 1, 2, 0, 1])
# Of the entries of a symmetric matrix, those on and below the diagonal, twice.
_LOWER = np.array([0, 3, 6, 3, 4, 7, 6, 7, 8])


def dot(a, b):
    products = a * b
    total = products[0]
    total += products[1]
    total += products[2]
    return total


def cycled(v):
    """x, y, z, x, y of vectors, which `cross` takes in less time."""
    return v if len(v) == len(_CYCLE) else v.take(_CYCLE, axis=0)


def cross(a, b):
    a, b = cycled(a), cycled(b)
    return a[1:4] * b[2:5] - a[2:5] * b[1:4]


def norm(v):
    return np.sqrt(dot(v, v))


def mat_vec(matrix, v):
    """Matrix times vector, (9, n) and (3, n); either may be single, (9,) or (3, 1)."""
    rows = matrix.reshape(3, 3, *(matrix.shape[1:] or (1,)))
    return dot(rows.swapaxes(0, 1), v[:, None])


def vec_mat(v, matrix):
    """Transposed matrix times vector, (9, n) and (3, n)."""
    return dot(v[:, None], matrix.reshape(3, 3, *matrix.shape[1:]))


def rotate_tensor(rotation, tensor):
    """R T Rᵀ for symmetric tensors T, (9, n) each; symmetric to the last bit."""
    ofRows = vec_mat(rotation.reshape(3, 3, -1).swapaxes(0, 1), tensor[:, None])  # rows of R T
    return take(mat_vec(rotation[:, None], ofRows).reshape(9, -1), _LOWER, axis=0)


# `take(table, index, axis)` is contiguous, so that what follows is faster than on a view.
take = np.ndarray.take


def indices(mask):
    """Positions (K,) at which a mask (n,) is true; faster than `np.flatnonzero` for short masks."""
    return mask.nonzero()[0]


def joined(*tables):
    """Returns tables, each a sequence of columns (…, K), as one: a list of columns (…, Σ K)."""
    return [np.concatenate(columns, axis=-1) for columns in zip(*tables, strict=True)]


def ranges(first, length):
    """Concatenated ranges, range k counting up from first[k]: `(row, index)`, both (Σ length,).

    first, length : (R,)
    """
    row = np.arange(len(first)).repeat(length)
    index = (first + length - length.cumsum()).repeat(length)
    index += np.arange(len(row))
    return row, index


def row_minima(values, row):
    """Least value of each row and its first index: `(least (R,), index (R,))`.

    values : (K,); row : (K,), ascending, each of 0 … R - 1 at least once
    """
    least = np.full(row[-1] + 1 if len(row) else 0, np.inf)
    np.minimum.at(least, row, values)  # faster than `reduceat` for a few values per row
    index = indices(values == take(least, row))
    if len(index) > len(least):
        row = take(row, index)
        index = index[np.append(True, row[1:] > row[:-1])]
    return least, index


def find_sorted(keys, known):
    """Indices (m,) of the keys (m,) in the ascending `known`; -1 if absent."""
    if len(known) == 0:
        return np.full(len(keys), -1)
    index = np.minimum(known.searchsorted(keys), len(known) - 1)
    return np.where(known[index] == keys, index, -1)


def known_columns(keys, known, table):
    """Columns (k, m) of a table (k, n) for the keys (m,) in the ascending `known`; 0 if absent."""
    withZeros = np.concatenate((table, np.zeros((len(table), 1))), axis=1)
    return take(withZeros, find_sorted(keys, known), axis=1)  # -1 is the last column


# Number of table entries per block. More leave the processor's cache; fewer cost more calls.
BLOCK_ENTRIES = 200_000


def blocks(length):
    """Slices of consecutive rows with up to BLOCK_ENTRIES entries together, or a single row.

    length : (R,), entries of each row
    """
    end, begin = length.cumsum(), 0
    while begin < len(length):
        limit = end[begin] - length[begin] + BLOCK_ENTRIES
        stop = max(begin + 1, int(end.searchsorted(limit, side="right")))
        yield slice(begin, stop)
        begin = stop
