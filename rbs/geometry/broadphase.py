"""Broad phase: pairs of overlapping boxes, found by uniform grids; islands of connected bodies.

Boxes in arrays are columns of six numbers: least coordinates, then negated greatest ones.

The grid is hierarchical (Ericson: Real-Time Collision Detection, chapter 7.2): boxes are sorted
into levels by their largest side. Each level is a grid over y and z whose columns are as wide as
its largest box, and within a column the boxes are sorted along x. A box is in the column that
contains its least corner, so that the columns of two overlapping boxes are equal or neighbours. A
box queries its own level and those of larger boxes.
"""

from heapq import heappop, heappush

import numpy as np

from rbs.geometry.vectors import indices, ranges, take

# Least size of a box in a level, as a fraction of the largest one. With less, columns are crowded;
# with more, there are more levels and queries.
GRID_SHRINK = 1 / 8
# Number of bodies up to which all pairs of boxes are compared; beyond, that takes more time.
FEW = 64
# Distance from the origin, in cells, beyond which boxes belong to the outermost cells. With less,
# those are crowded; with far more, the numbers of columns overflow.
FAR = 1_000_000
# Margin of a body's reach, as a fraction of the largest side of its box. With more, more pairs are
# tested that do not touch; with less, more bodies leave it and are looked up again.
MARGIN = 0.05
# Excess of a column's width over the largest box, as a fraction: more than what rounding may make
# of a coordinate in FAR columns. Without it, the columns of two boxes that touch may be one apart.
SLACK = 1e-9


def grid_pairs(current, isFixed):
    """Yields the pairs i < j whose boxes may overlap when it is their turn, in order.

    Corrections move bodies between two pairs. A body whose box has left its reach, the box with a
    margin, gets a new one, and its later pairs join the queue. Pairs of fixed bodies are left out.

    current : list of boxes, least and greatest x, y, z, which the caller keeps up to date
    isFixed : list of bools
    """
    count, boxes, isFixed = len(current), current.copy(), np.array(isFixed, dtype=bool)
    reach = np.array([_reach(box) for box in boxes]).reshape(-1, 6).T
    first, second = grid_overlaps(reach)
    isPair = ~(isFixed[first] & isFixed[second])
    queue = (first * count + second)[isPair].tolist()  # sorted, so it is a heap
    known = set(queue)
    while queue:
        key = heappop(queue)
        pair = divmod(key, count)
        yield pair
        for b in pair:
            box = current[b]
            if box is boxes[b] or (_column(box) >= reach[:, b]).all():
                continue
            boxes[b], reach[:, b] = box, _reach(box)
            meets = boxes_meet(reach, reach[:, b, None]) & ~(isFixed & isFixed[b])
            for other in indices(meets).tolist():
                found = min(b, other) * count + max(b, other)
                if found > key and found not in known and other != b:
                    known.add(found)
                    heappush(queue, found)


def _column(box):
    """A mesh's box as a column for `grid_overlaps`."""
    return np.array((*box[:3], -box[3], -box[4], -box[5]))


def _reach(box):
    margin = MARGIN * max(box[3] - box[0], box[4] - box[1], box[5] - box[2])
    return _column(box) - margin


def grid_overlaps(box):
    """Returns the pairs i < j (2, P) whose boxes (6, n) overlap or touch, in this order."""
    count = box.shape[1]
    if count <= FEW:
        return np.array(np.triu(boxes_meet(box[:, :, None], box[:, None]), 1).nonzero())
    found = [np.zeros((2, 0), dtype=np.intp)]
    for level, smaller, width in grid_levels(box):
        found.append(_level_overlaps(box, level, level, width))
        if len(smaller):
            found.append(_level_overlaps(box, level, smaller, width))
    i, j = np.concatenate(found, axis=1)
    keys = np.minimum(i, j) * count + np.maximum(i, j)
    keys.sort()
    return np.array(np.divmod(keys, count))


def grid_levels(box):
    """Sorts finite boxes into grid levels, from the largest; yields `(level, smaller, width)`.

    level, smaller : indices of the boxes of this level, and of all later ones
    width : largest side of this level's boxes
    """
    extent = (-box[3:] - box[:3]).max(axis=0)
    rest = indices(np.isfinite(extent))
    while len(rest):
        sides = extent[rest]
        largest = float(sides.max())
        isLarge = sides >= GRID_SHRINK * largest
        level, rest = rest[isLarge], rest[~isLarge]
        yield level, rest, (1.0 + SLACK) * max(largest, np.finfo(float).tiny)


def _level_overlaps(box, level, queries, width):
    """Pairs (2, P) of a body in `level` and one in `queries` whose boxes overlap, each pair once.

    queries : the same array as level, or indices of boxes that are no larger
    """
    isOwn, count = queries is level, len(level)
    bodies = level if isOwn else np.concatenate((level, queries))
    with np.errstate(over="ignore"):
        y, z = np.floor(box[1:3, bodies] / width).clip(-FAR, FAR).astype(np.int64)
    stride = 2 * FAR + 3
    column = y * stride + z
    # the level's boxes sorted by column, and along x within a column
    along = box[0, level].argsort()
    lowX = box[0, level][along]
    order = np.empty(count, dtype=np.int64)
    order[along] = np.arange(count)
    key = column[:count] * (count + 1) + order
    entries = key.argsort()
    key = key[entries]
    around = np.array([0, 1, stride - 1, stride, stride + 1])
    if isOwn:  # bisection is faster for sorted queries
        queries, column = level[entries], column[entries]
    else:
        column, around = column[count:], np.append(around, -around[1:])
    # the range along x that may overlap a query
    begin = lowX.searchsorted(box[0, queries] - width, side="left")
    end = lowX.searchsorted(-box[3, queries], side="right")
    around = (column + around[:, None]) * (count + 1)
    begin = around + begin
    if isOwn:  # each pair in one column once
        begin[0] = key + 1
    first = key.searchsorted(begin.ravel())
    length = key.searchsorted((around + end).ravel()) - first
    some = indices(length > 0)
    row, entry = ranges(take(first, some), take(length, some))
    i, j = take(level[entries], entry), take(queries[some % len(queries)], row)
    return overlapping(box, i, j)


def boxes_meet(one, other):
    """Whether two boxes (6, …) overlap or touch."""
    return ((one[:3] <= -other[3:]) & (other[:3] <= -one[3:])).all(axis=0)


def overlapping(box, i, j):
    """Those of the pairs i (m,), j (m,) whose boxes overlap: (2, P)."""
    for k in (2, 1, 0):
        low, high = box[k], -box[k + 3]
        some = indices((take(low, i) <= take(high, j)) & (take(low, j) <= take(high, i)))
        i, j = take(i, some), take(j, some)
    return np.array((i, j))


def islands(links, isFree):
    """Returns the island (n,) of each body, its connected component: the least body in it.

    links : (2, L), connected bodies; n or -1 is the ground
    isFree : (n,) bool; other bodies, and the ground, connect nothing
    """
    some = indices(take(np.concatenate((isFree, [False])), links).all(axis=0))
    first, second = take(links, some, axis=1)
    island = np.arange(len(isFree))
    while True:
        one, other = take(island, first), take(island, second)
        if not np.count_nonzero(one != other):
            return island
        np.minimum.at(island, np.maximum(one, other), np.minimum(one, other))
        island = take(island, take(island, island))  # a third of the way to the least body
