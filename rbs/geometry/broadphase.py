"""Broad phase: pairs of overlapping boxes, found by uniform grids.

A box is a column of six numbers: its least coordinates, then its negated greatest ones. The boxes a
and b overlap if a ≤ `overlap_limits`(b) in every row.

The grid is hierarchical (Ericson: Real-Time Collision Detection, chapter 7.2); see `grid_overlaps`.
"""

import numpy as np

from rbs.geometry.arrays import indices, ranges, take

# Least size of a box in a level, as a fraction of the largest one, which sets the width of the
# columns. Less crowds the columns; more makes more levels and queries.
GRID_SHRINK = 1 / 8
# Number of bodies up to which all pairs of boxes are compared; beyond, that takes more time.
FEW = 64
# Number of cells along a side up to which all cells are numbered; beyond, only those in use.
MOST_CELLS = 1e6


def overlap_limits(box):
    """Upper limits for another box to overlap this one, row by row: (6, …) to (6, …)."""
    return -np.concatenate((box[3:], box[:3]))


def grid_overlaps(box, isFixed):
    """Finds the pairs i < j whose boxes overlap.

    Up to FEW boxes are all compared. More are sorted into levels by their largest side. Each level
    is a grid over y and z whose columns are as wide as its largest box, and within a column the
    boxes are sorted along x. A box is in the one column that contains its least corner. The columns
    of two overlapping boxes are equal or neighbours, and along x the least corner of one box lies
    in the other. As a box queries only its own level and those of larger boxes, a huge floor among
    small boxes costs each of them one candidate.

    Parameters
    ----------
    box : (6, n); isFixed : (n,) bool, pairs of two fixed bodies are omitted

    Returns
    -------
    (first, second) : (P,), (P,) int, in the order i < j
    """
    if len(isFixed) <= FEW:
        meet = (box[:3, :, None] <= -box[3:, None]).all(axis=0)
        return np.array(np.triu(meet & meet.T & ~(isFixed[:, None] & isFixed), 1).nonzero())
    found = []
    for level, smaller, width in grid_levels(box):
        found.append(_level_overlaps(box, level, level, width))
        if len(smaller):
            found.append(_level_overlaps(box, level, smaller, width))
    return np.stack(np.divmod(_pair_keys(found, isFixed), max(1, len(isFixed))))


def overlaps_of(some, box, isFixed):
    """Keys i · n + j, ascending and distinct, of the overlaps that involve a body of `some` (m,).

    The boxes of each level are sorted along x, so that those near a box of `some` form a range.
    """
    found = []
    for level, _, width in grid_levels(box):
        along = level[box[0, level].argsort()]
        lowX = box[0, along]
        begin = lowX.searchsorted(box[0, some] - width, side="left")
        end = lowX.searchsorted(-box[3, some], side="right")
        row, index = ranges(begin, np.maximum(end - begin, 0))
        found.append(overlapping(box, some[row], along[index]))
    keys = _pair_keys(found, isFixed)
    return keys[np.diff(keys, prepend=-1) > 0]  # pairs within `some` are found twice


def grid_levels(box):
    """Sorts boxes into grid levels, from the largest; yields `(level, smaller, width)`.

    level, smaller : indices of the boxes of this level, and of all later ones; width : largest side
        of this level's boxes
    """
    extent = (-box[3:] - box[:3]).max(axis=0)
    rest = indices(np.isfinite(extent))
    while len(rest):
        sides = extent[rest]
        largest = float(sides.max())
        isLarge = sides >= GRID_SHRINK * largest
        level, rest = rest[isLarge], rest[~isLarge]
        yield level, rest, max(largest, np.finfo(float).tiny)


def _pair_keys(found, isFixed):
    """Keys i · n + j of pairs i < j, ascending, with repetitions.

    found : list of pairs (2, m), in any order; omits two fixed bodies, and a body with itself
    """
    first, second = np.concatenate([np.zeros((2, 0), dtype=np.intp), *found], axis=1)
    some = indices((first != second) & ~(isFixed[first] & isFixed[second]))
    first, second = first[some], second[some]
    keys = np.minimum(first, second) * len(isFixed) + np.maximum(first, second)
    keys.sort()
    return keys


def _cell_indices(values):
    """Compact cell indices ≥ 1 of whole floats, neighbours (±1) only if they were so before."""
    least = values.min()
    if values.max() - least < MOST_CELLS:
        return (values - least).astype(np.int64) + 1
    distinct, rank = np.unique(values, return_inverse=True)
    steps = np.minimum(np.diff(distinct, prepend=distinct[:1]), 2.0)
    return steps.cumsum().astype(np.int64)[rank] + 1


def _level_overlaps(box, level, queries, width):
    """Pairs (2, P) of a body in `level` and one in `queries` whose boxes overlap, each pair once.

    level : indices of boxes with sides of at most `width`; queries : the same array, or indices of
        other boxes, none larger
    """
    isOwn = queries is level
    bodies = level if isOwn else np.concatenate((level, queries))
    y = _cell_indices(np.floor(box[1, bodies] / width))
    z = _cell_indices(np.floor(box[2, bodies] / width))
    stride = int(z.max()) + 2
    column = y * stride + z
    # the level's boxes sorted by column, and along x within a column
    along = box[0, level].argsort()
    lowX = box[0, level][along]
    order = np.empty(len(level), dtype=np.int64)
    order[along] = np.arange(len(level))
    count = len(level)
    key = column[:count] * (count + 1) + order
    entries = key.argsort()
    key = key[entries]
    if isOwn:  # bisection is faster for sorted values
        queries, order, column = level[entries], order[entries], column[entries]
    # the range along x that may overlap a query
    end = lowX.searchsorted(-box[3, queries], side="right")
    begin = order + 1 if isOwn else lowX.searchsorted(box[0, queries] - width, side="left")

    around = np.array([dy * stride + dz for dy in (-1, 0, 1) for dz in (-1, 0, 1)])
    around = (column[-len(queries) :] + around[:, None]) * (count + 1)
    first = key.searchsorted((around + begin).ravel())
    length = key.searchsorted((around + end).ravel()) - first
    some = indices(length > 0)
    row, entry = ranges(take(first, some), take(length, some))
    i, j = level[entries[entry]], queries[some[row] % len(queries)]
    # within a level, the range contains exactly the boxes that overlap along x
    return overlapping(box, i, j, (2, 1) if isOwn else (2, 1, 0))


def overlapping(box, i, j, axes=(2, 1, 0)):
    """Those of the pairs i (m,), j (m,) whose boxes overlap along the given axes: (2, P)."""
    for k in axes:
        overlap = (take(box[k], i) <= -take(box[k + 3], j)) & (
            take(box[k], j) <= -take(box[k + 3], i)
        )
        i, j = i[overlap], j[overlap]
    return np.stack((i, j))
