"""Indexing of long arrays in few calls: rows of different lengths that lie one after the other."""

import numpy as np


def take(table, index, axis=None):
    """`table.take(index, axis)` for indices that are known to be in range.

    To clip them is twice as fast as to check them; without an axis, the table counts as flat.
    The rows of what `table[:, index]` makes are not contiguous, and all that is worked out from it
    later is slow, a soft step by a fifth; here they are.
    """
    return table.take(index, axis=axis, mode="clip")


def indices(mask):
    """Where (K,) a mask (n,) is true; `np.flatnonzero` takes four times as long for short ones."""
    return mask.nonzero()[0]


def ranges(first, length):
    """Concatenated ranges: `(row, index)`, both (Σ length,), row k with first[k] … and so on.

    first, length : (R,); where each range begins, and how many numbers it has
    """
    row = np.arange(len(first)).repeat(length)
    index = np.arange(len(row))
    index += take(first + length - length.cumsum(), row)
    return row, index


def row_minima(values, row, start):
    """`(least (R,), index (R,))`: the least value of each row, and of equals the first one's index.

    values, row : (K,), one row after the other, none of them empty; start : (R,), where they begin
    """
    least = np.minimum.reduceat(values, start)
    equal = indices(values == take(least, row))
    return least, take(equal, equal.searchsorted(start))


def find_sorted(keys, known):
    """Index (m,) of each key (m,) among the known ones, ascending; -1 if absent."""
    if len(known) == 0:
        return np.full(len(keys), -1)
    index = np.minimum(known.searchsorted(keys), len(known) - 1)
    return np.where(known[index] == keys, index, -1)


# Table entries that are worked on at a time: their vectors stay in the processor's cache.
BLOCK_ENTRIES = 200_000


def blocks(length):
    """Slices of consecutive rows that have up to BLOCK_ENTRIES entries together, or are single.

    length : (R,), the entries of each row. Of no rows, an empty slice.
    """
    if length.sum() <= BLOCK_ENTRIES:
        yield slice(0, len(length))
        return
    end = length.cumsum()
    begin = 0
    while begin < len(length):
        limit = end[begin] - length[begin] + BLOCK_ENTRIES
        stop = max(begin + 1, int(end.searchsorted(limit, side="right")))
        yield slice(begin, stop)
        begin = stop
