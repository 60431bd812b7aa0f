"""Schedules of constraints: which one is visited when. What a visit does is passed in.

A visit looks at one constraint, corrects it if it is violated, and returns whether it was. A
schedule ends when every constraint is satisfied, or when the visits are used up. Of the list's
`total` constraints, some can never be corrected, those between two fixed bodies for instance: they
are not among the `constraints`, and a visit to them counts as one that found nothing.
"""

from functools import lru_cache

import numpy as np

from rbs.arrays import indices


def sweep(visit, constraints, total, maximumVisits):
    """Visits in the list's order, over and over, until as many in a row as there are found nothing.

    visit : function of an index; constraints : indices that can be corrected, a dict or set; total
    Returns the number of visits.
    """
    visits = satisfiedInARow = 0
    while satisfiedInARow < total and visits < maximumVisits:
        c = visits % total
        satisfiedInARow = 0 if c in constraints and visit(c) else satisfiedInARow + 1
        visits += 1
    return visits


def queue(visit, constraints, total, maximumVisits):
    """The sweep without the visits that cannot find anything: same result, bit for bit.

    constraints : dict, of each index that can be corrected the bodies of it that can move

    A visit depends on the positions of two bodies, so a constraint that was found satisfied is
    clean until a body of it moves. The dirty ones are the bits of one integer: `dirty & -dirty` is
    the lowest that is set, the next constraint in the sweep's order, and a body that moves sets
    those of its constraints with a single `or`. Visits that are left out count as made, so that the
    maximum ends at the same constraint.

    Returns the number of visits that were made.
    """
    constraintsOf = {}
    dirty = 0
    for c, bodies in constraints.items():
        dirty |= 1 << c
        for b in bodies:
            constraintsOf[b] = constraintsOf.get(b, 0) | 1 << c
    visits = begin = c = 0  # visits made; the sweep's count at constraint 0; where it is
    while dirty:
        ahead = dirty >> c
        if not ahead:  # the next dirty one belongs to the next sweep
            begin, c = begin + total, 0
            continue
        c += (ahead & -ahead).bit_length() - 1
        if begin + c >= maximumVisits:
            break
        dirty ^= 1 << c
        if visit(c):
            for b in constraints[c]:
                dirty |= constraintsOf[b]
        visits += 1
        c += 1
    return visits


def batches(visit_batch, bodies1, bodies2, isFixed, total, maximumVisits):
    """Visits batch by batch, each an array of constraints that move no body in common.

    visit_batch : function of an array of rows that returns whether one had to be corrected
    bodies1, bodies2 : (C,), the bodies of those that can be corrected; isFixed : (n,) bool

    As many visits as the sweep's, in another order: the result differs, within the same bounds.
    Returns their number.
    """
    coloured = coloured_batches(bodies1, bodies2, isFixed)
    left = total - len(bodies1)  # visits that find nothing, counted once a sweep
    visits = satisfiedInARow = 0
    while coloured and visits < maximumVisits:
        visits = min(visits + left, maximumVisits)
        for batch in coloured:
            batch = batch[: max(0, maximumVisits - visits)]
            visits += len(batch)
            satisfiedInARow = 0 if visit_batch(batch) else satisfiedInARow + len(batch)
            if satisfiedInARow >= len(bodies1) or visits >= maximumVisits:
                return visits
    return visits


def coloured_batches(bodies1, bodies2, isFixed):
    """Rows of constraints in batches in which no two move the same body: a list of arrays.

    bodies1, bodies2, isFixed : as for `batches`
    """
    return _coloured(bodies1.tobytes(), bodies2.tobytes(), isFixed.tobytes())


@lru_cache(maxsize=8)
def _coloured(bodies1, bodies2, isFixed):
    """`coloured_batches` by greedy colouring, of the bytes of its arrays.

    A constraint gets the first batch that has neither of its bodies, fixed ones apart. The bits of
    an integer tell which batches have a body.
    """
    first, second = (np.frombuffer(bodies, np.intp).tolist() for bodies in (bodies1, bodies2))
    isFixed = np.frombuffer(isFixed, bool).tolist()
    taken = [0] * len(isFixed)
    colours = []
    for i, j in zip(first, second, strict=True):
        free = ~(taken[i] | taken[j])
        bit = free & -free
        if not isFixed[i]:
            taken[i] |= bit
        if not isFixed[j]:
            taken[j] |= bit
        colours.append(bit.bit_length() - 1)
    colours = np.array(colours, dtype=np.intp)
    return [indices(colours == k) for k in range(colours.max(initial=-1) + 1)]
