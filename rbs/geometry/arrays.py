"""Indexing of long arrays in few calls, for tables of consecutive rows with different lengths."""

import numpy as np


def take(table, index, axis=None):
    """`table.take(index, axis)` for indices in range, which are not checked.

    The result is contiguous, unlike that of `table[:, index]`, so that later operations are faster.
    """
    return table.take(index, axis=axis, mode="clip")


def indices(mask):
    """Positions (K,) at which a mask (n,) is true; faster than `np.flatnonzero` for short masks."""
    return mask.nonzero()[0]


def ranges(first, length):
    """Concatenated ranges, range k counting up from first[k]: `(row, index)`, both (Σ length,).

    first, length : (R,)
    """
    row = np.arange(len(first)).repeat(length)
    index = np.arange(len(row))
    index += take(first + length - length.cumsum(), row)
    return row, index


def row_minima(values, row, start):
    """Least value of each row and its first index: `(least (R,), index (R,))`.

    values, row : (K,), one row after the other, none of them empty; start : (R,), start of each row
    """
    least = np.minimum.reduceat(values, start)
    equal = indices(values == take(least, row))
    return least, take(equal, equal.searchsorted(start))


def find_sorted(keys, known):
    """Indices (m,) of the keys (m,) in the ascending `known`; -1 if absent."""
    if len(known) == 0:
        return np.full(len(keys), -1)
    index = np.minimum(known.searchsorted(keys), len(known) - 1)
    return np.where(known[index] == keys, index, -1)


def known_columns(keys, known, table):
    """Columns (k, m) of a table (k, n) for the keys (m,) in the ascending `known`; 0 if absent."""
    withZeros = np.append(table, np.zeros((len(table), 1)), axis=1)
    return withZeros.take(find_sorted(keys, known), axis=1)  # -1 is the last column


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
