"""Distance constraints of a scene as columns, and the schedules by which they are visited.

A visit corrects a constraint if it is violated. A schedule ends when every constraint is satisfied,
or at the maximum number of visits, to which all `total` constraints of the list count, in order. It
returns the number of visits that it made. Constraints that no motion can correct are not visited.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from rbs.geometry.triples import number
from rbs.geometry.vectors import indices, take
from rbs.stepping import kernels
from rbs.stepping.bodies import bodies_of


class ConstraintRows:
    """The C constraints that a step has to visit.

    No motion changes the distance between two fixed meshes. A lower bound of no more than the
    tolerance, as in a rope, is always satisfied.

    index : (C,), positions in the caller's list, which has `total` rows
    ends : (4, C), body1, vertex1, body2, vertex2; refValue, upper : (C,)
    """

    def __init__(self, constraints, meshes, tolerance):
        self.total = len(constraints)
        self.isFixed = isFixed = np.array([m.isFixed for m in meshes], dtype=bool)
        table = constraint_table(constraints, meshes)
        ends, isUpper = table[:4].astype(np.intp), table[5] != 0
        movable = ~(isFixed[ends[0]] & isFixed[ends[2]])
        movable &= isUpper | (table[4] > tolerance)
        self.index = indices(movable)
        self.ends = take(ends, self.index, axis=1)
        self.refValue, self.upper = take(table[4], self.index), take(isUpper, self.index)

    def links(self, meshes):
        """Returns a list of `Link`: constraints between the same points, one after the other."""
        bounds = zip(self.index.tolist(), self.refValue.tolist(), self.upper.tolist(), strict=True)
        # vectors (V, 1, 3) from the COM to the rest vertices, rotated
        arms = cache(lambda b: meshes[b].rotated_hull().points.T.copy()[:, None])
        links, last = [], None
        for ends, bound in zip(self.ends.T.tolist(), bounds, strict=True):
            if ends != last:
                b1, v1, b2, v2 = last = ends
                invMasses = meshes[b1].invMass, meshes[b2].invMass
                links.append(Link(b1, b2, arms(b1)[v1], arms(b2)[v2], invMasses, []))
            links[-1].bounds.append(bound)
        return links


def linked_keys(step, width):
    """Sorted keys i · width + j (L,) of the pairs i < j of bodies of a `Step` that do not collide,
    because constraints link them; by default, there are none.
    """
    if step.linkedBodiesCollide or len(step.constraints) == 0:
        return np.zeros(0, dtype=np.intp)
    rows = ConstraintRows(step.constraints, step.meshes, 0.0)
    first, second = np.sort(rows.ends[0::2], axis=0)
    return np.unique(first * width + second)


@dataclass(slots=True)
class Link:
    """Points of two bodies, of which a visit may move one, and the bounds of their distance.

    The coursework's files have two bounds for each pair of points.
    """

    body1: int
    body2: int
    arm1: np.ndarray  # (1, 3), from the COM of body 1 to its point
    arm2: np.ndarray
    invMasses: tuple
    bounds: list  # of (index, refValue, upper), in the order of the list of constraints


def constraint_table(constraints, meshes):
    """Returns rows [m1, v1, m2, v2, refValue, upper] as columns (6, C) of floats.

    Raises ValueError, which names the constraint and what is wrong.
    """
    if len(constraints) == 0:
        return np.zeros((6, 0))
    try:
        rows = np.array(constraints, dtype=np.float64)
        if rows.shape != (len(constraints), 6):
            raise ValueError
    except (TypeError, ValueError):
        try:  # arrays of one number among the numbers
            rows = np.array([[number(value) for value in row] for row in constraints])
            rows = rows.reshape(len(constraints), 6)
        except (TypeError, ValueError):
            what = "a constraint is a row of six numbers: m1, v1, m2, v2, refValue, upper"
            raise ValueError(what) from None
    table = rows.T
    mesh, vertex = table[0:4:2], table[1:4:2]
    isIndex = (table[:4] >= 0) & (table[:4] == np.floor(table[:4]))
    vertexCount = np.array([len(m.origVertices) for m in meshes] + [0])
    known = isIndex[0::2] & (mesh < len(meshes))
    count = vertexCount[np.where(known, mesh, -1).astype(np.intp)]
    fits = known & isIndex[1::2] & (vertex < count)
    if not fits.all():
        c, end = np.argwhere(~fits.T)[0].tolist()
        what, most = f"mesh {mesh[end, c]:g} has no vertex {vertex[end, c]:g}", count[end, c] - 1
        if not known[end, c]:
            what, most = f"mesh {mesh[end, c]:g} does not exist", len(meshes) - 1
        raise ValueError(f"constraint {c}: {what}, only 0 to {most}")
    refValue, upper = table[4:]
    for k, isFine, what in (
        (2, mesh[0] != mesh[1], "a mesh cannot be linked to itself, as"),
        (4, (refValue >= 0.0) & (refValue < np.inf), "refValue must be finite, and 0 or more, not"),
        (5, (upper == 0.0) | (upper == 1.0), "upper must be True or False, not"),
    ):
        if not isFine.all():
            c = int(isFine.argmin())
            raise ValueError(f"constraint {c}: {what} {table[k, c]:g}")
    return table


def up_to(links, end):
    """Returns the links of the constraints before an index: the same list if these are all."""
    if not links or links[-1].bounds[-1][0] < end:
        return links
    parts = (replace(one, bounds=[b for b in one.bounds if b[0] < end]) for one in links)
    return [one for one in parts if one.bounds]


def sweep(visit, links, total, maximumVisits):
    """Visits all `links`, over and over, until a whole sweep corrects none: number of visits."""
    visits = satisfiedInARow = 0
    for begin in range(0, maximumVisits, total):
        for link in up_to(links, maximumVisits - begin):
            satisfiedInARow = 0 if visit(link) else satisfiedInARow + 1
            visits += len(link.bounds)
            if satisfiedInARow == len(links):
                return visits
    return visits


def queue(visit, links, total, maximumVisits):
    """The sweep without unnecessary visits, with bitwise identical results.

    A satisfied link is clean until one of its bodies moves. The dirty links are the set bits of one
    integer: `dirty & -dirty` is the lowest one, which is next in the sweep's order, and a moving
    body sets the bits of all its links with a single `or`. Omitted visits count towards the
    maximum, so that the queue ends at the same constraint as the sweep. Returns the number made.
    """
    linksOf, movable = {}, []
    for k, link in enumerate(links):
        ends = zip((link.body1, link.body2), link.invMasses, strict=True)
        movable.append([b for b, invMass in ends if invMass])
        for b in movable[k]:
            linksOf[b] = linksOf.get(b, 0) | 1 << k
    visits, dirty = 0, (1 << len(links)) - 1
    for begin in range(0, maximumVisits, total):
        some, k = up_to(links, maximumVisits - begin), 0
        while ahead := dirty >> k:
            k += (ahead & -ahead).bit_length() - 1
            if k >= len(some):
                break
            dirty ^= 1 << k
            if visit(some[k]):
                for b in movable[k]:
                    dirty |= linksOf[b]
            visits += len(some[k].bounds)
            k += 1
        if not dirty:
            break
    return visits


def project_in_batches(step, rows, maximumVisits):
    """Visits batches of constraints without a common movable body; returns the number of visits.

    The order differs from the sweep's, and so does the result, within the same bounds.
    """
    bodies = bodies_of(step.meshes)
    bodies.update_rotations()
    ends, vertices = rows.ends[0::2], rows.ends[1::2]
    arms = bodies.arms(ends, vertices)
    coloured = coloured_batches(*ends, rows.isFixed)
    visits = satisfiedInARow = 0
    for begin in range(0, maximumVisits, rows.total):
        left = maximumVisits - begin - (rows.total - len(rows.index))
        for batch in coloured:
            batch = batch[: max(left, 0)]
            if len(batch) and satisfiedInARow < len(rows.index):
                hasCorrected = visit_batch(bodies, rows, ends, arms, batch, step.tolerance)
                satisfiedInARow = 0 if hasCorrected else satisfiedInARow + len(batch)
                visits, left = visits + len(batch), left - len(batch)
        if satisfiedInARow >= len(rows.index):
            break
    bodies.write_back()
    return visits


def visit_batch(bodies, rows, ends, arms, batch, tolerance):
    """Corrects the violated constraints of a `batch` (m,); returns whether there were any."""
    points = take(bodies.position, ends[:, batch], axis=1) + arms[..., batch]
    C, n = kernels.distance_error(points[:, 0], points[:, 1], rows.refValue[batch])
    violated = indices(kernels.is_violated(C, rows.upper[batch], tolerance))
    if len(violated) == 0:
        return False
    b, r, n = ends[:, batch[violated]], arms[..., batch[violated]], n[:, violated]
    invMasses = take(bodies.invMass, b)
    motion = take(bodies.motion, b, axis=1)
    motion[:3] += kernels.position_corrections(invMasses, C[violated]) * n[:, None]
    state = motion[3:], invMasses, take(bodies.invInertia, b, axis=1)
    kernels.resolve_velocity_constraint(*state, r, n, tolerance)
    bodies.motion[:, b] = motion
    return True


def coloured_batches(bodies1, bodies2, isFixed):
    """Returns a list of arrays of constraint rows, in each of which no two move the same body.

    A constraint takes the first batch that contains none of its movable bodies. The batches of a
    body are the set bits of an integer.
    """
    isFixed = isFixed.tolist()
    taken = [0] * len(isFixed)
    colours = []
    for i, j in zip(bodies1.tolist(), bodies2.tolist(), strict=True):
        free = ~(taken[i] | taken[j])
        bit = free & -free
        if not isFixed[i]:
            taken[i] |= bit
        if not isFixed[j]:
            taken[j] |= bit
        colours.append(bit.bit_length() - 1)
    colours = np.array(colours, dtype=np.intp)
    return [indices(colours == k) for k in range(colours.max(initial=-1) + 1)]
