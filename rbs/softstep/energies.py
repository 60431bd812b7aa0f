"""A bound on the energy that contacts and constraints give to connected bodies.

If several pairs collide in one step, Newton's law of restitution may require more energy than
there was (Stronge: Rigid body collisions with friction. Proceedings of the Royal Society A, 1990).
Springs that push overlaps out give some, too, and so does friction that is not solved exactly.
Without a bound, a heavy body squeezes out a light one that it rests on.
"""

import numpy as np

from rbs.geometry.broadphase import islands
from rbs.geometry.vectors import dot, indices, mat_vec, take, vec_mat
from rbs.softstep.manifolds import ROUNDING, TINY
from rbs.softstep.rows import inverted
from rbs.stepping.flight import turn_matrix

# Changes of velocities grow, so that tumbling bodies lose nothing as they turn on, where the energy
# b s + a s², of the fraction s of all changes, grows at s = 1 by at least (2 - BOUNCED) a, as with
# a restitution of 0.25. With more, after plastic blows, a little energy changes velocities by much;
# with less, rods that tumble lose some as they bounce.
BOUNCED = 1.6
# Fraction of its energy that an island joined by constraints alone may gain in a step. With less,
# rings that turn fast lose up to half of theirs, as gains by rounding are cut and losses stay; with
# more, a chain that is jerked tight may end with 13 times what it had.
ROUNDED = 0.2


def bounded_share(motion, touching, normal, tied, rate, infeasible):
    """Leaves each island of connected bodies no more energy than it had, plus the work of gravity.

    If an island that rests on something has more, its velocities shrink, except their mean along
    the support. If another one has more, its impulses shrink: momentum is conserved where nothing
    takes it. Islands on which torques work, or bounds that change, or supports that move
    differently, are left alone, and so are those that constraints alone join, if they gain less
    than the fraction ROUNDED. Of bodies that infeasible ones join, half of the energy counts, and
    no work: they come to rest, or move with the mean of their supports.

    Returns the share (m + 1,) of each body's impulses that is left.

    touching : (2, C), columns of `Motion` that touch
    normal : (3, C), their unit normals, or 0 where friction acts, too
    tied, infeasible : (2, L), (2, K), those that constraints join, all and some
    rate : (L,), speeds with which bounds of constraints change
    """
    share, isTumbling = np.ones(len(motion.moving) + 1), motion.drift is not None
    if len(touching[0]) + len(tied[0]) == 0:
        return share
    links, mass, inertia = np.concatenate((touching, tied), axis=1), motion.mass, motion.inertia
    turn, island = np.array(turn_matrix(motion.turn[:, :-1])), islands(links, mass > 0.0)
    count = len(island)

    def total(x):
        """Sums (I,) over the bodies of each island."""
        return np.bincount(island, x, count)

    def with_one_of(ends):
        """Whether islands (I,) have a body in the columns `ends`, and nothing else does work."""
        return ~isWorked & (np.bincount(island[ends[ends < count]], minlength=count) > 0)

    def products(v, w):
        return mass * dot(v[:3], w[:3]) + dot(v[3:], mat_vec(inertia, w[3:]))

    some, held, frame, isWorked = _supports(motion, links, mass, island, count)
    driven, halved = (ends[ends < count] for ends in (tied[:, rate != 0.0], infeasible))
    isWorked[island[driven]] = True
    isWorked[island[halved]] = False
    normal = np.concatenate((normal, np.zeros((3, len(tied[0])))), axis=1)
    normal = take(normal, some, axis=1)  # of what islands rest on
    frame, rests = take(frame, island, axis=1), np.bincount(held, minlength=count) > 0
    begin, velocity = motion.begin[:, :-1] - frame, motion.velocity[:, :-1] - frame
    isBound, isTied = with_one_of(touching), with_one_of(tied)
    way = motion.shift[:, :-1] - motion.timeStep * frame[:3]
    # what constraints push moves, but becomes no faster
    way = np.where(isTied[island], 0.5 * motion.timeStep * (begin + velocity)[:3], way)
    before, work = 0.5 * products(begin, begin), mass * dot(motion.gravity[:, :-1], way)
    before[halved], work[halved] = 0.5 * before[halved], 0.0
    limit, now = total(before + work), _turned(velocity, inertia, turn, isTumbling)
    energy = total(0.5 * products(now, now))
    isOver = (isBound & (energy > limit)) | (isTied & ((1.0 - ROUNDED) * energy > limit))
    if not (isOver.any() or isTumbling):
        return share
    # with the fraction s of the changes since free flight, the energy is that of free flight plus
    # b s + a s²
    free = begin.copy()
    free[:3] += motion.timeStep * motion.gravity[:, :-1]
    if isTumbling or (isOver & ~rests).any():
        atFree = _turned(free, inertia, turn, isTumbling)
        change = now - atFree
        a, b = total(0.5 * products(change, change)), total(products(atFree, change))
        if isTumbling:  # as they turn on, bodies that have bounced keep what impulses have left
            isElastic = isBound & (a > 0.0) & (b > -BOUNCED * a)
            kept = total(0.5 * products(velocity, velocity))
            limit = np.where(isElastic, np.minimum(limit, kept), limit)
            isOver |= isElastic
        room = limit - total(0.5 * products(atFree, atFree))
        root = np.sqrt(np.maximum(b * b + 4.0 * a * room, 0.0))
        part = np.maximum((root - b) / np.where(a > 0.0, 2.0 * a, 1.0), 0.0)
        share[:-1] = np.where(isOver & ~rests, part, 1.0)[island]

    isSlowed = isOver & rests
    along = _along_supports(velocity, mass, normal, held, isSlowed, island)
    own = total(0.5 * mass * dot(along, along))
    left = np.maximum(limit - own, 0.0) / np.maximum(energy - own, TINY)
    shrink = np.sqrt(np.where(isSlowed, left, 1.0))[island]
    velocity = free + share[:-1] * (velocity - free)
    velocity = frame + along + shrink * (velocity - along)
    np.copyto(motion.velocity[:, :-1], velocity, where=isOver[island])
    return share


def _turned(velocity, inertia, turn, isTumbling):
    """Velocities (6, m) at the end of the step, the angular ones in axes that turn with it.

    turn : (9, m), rotation matrices of the step. If isTumbling, angular momenta last
    """
    linear, angular = velocity[:3], velocity[3:]
    if not isTumbling:
        return np.concatenate((linear, vec_mat(angular, turn)))
    inverse = inverted(inertia.reshape(3, 3, -1)).reshape(9, -1)
    return np.concatenate((linear, mat_vec(inverse, vec_mat(mat_vec(inertia, angular), turn))))


def _supports(motion, links, mass, island, count):
    """`(some, held, frame (6, I), isWorked (I,))` of I islands, `count`.

    some, held : (K,), links of which one end is still or moves by itself, and the islands of the
        other ends, which rest on it
    frame : mean velocities of what islands rest on, or of their centres of mass
    isWorked : whether torques work on one, or its supports turn, or move differently
    """
    isStill = motion.invMass[links] == 0.0
    some = indices(isStill[0] != isStill[1])
    ends = take(links, some, axis=1)
    body, support = np.where(take(isStill[0], some), ends[::-1], ends)
    held, support = island[body], motion.velocity[:, support]
    frame, total = np.zeros((6, count)), np.maximum(np.bincount(island, mass, count), TINY)
    frame[:3] = [np.bincount(island, mass * v, count) / total for v in motion.begin[:3, :-1]]
    frame[:, held] = support
    # their mean, and to the bit where all have the same
    apart, number = support - frame[:, held], np.maximum(np.bincount(held, minlength=count), 1)
    isWorked = np.bincount(island, motion.spinUp[:, :-1].any(axis=0), count) > 0.0
    isWorked[held[apart.any(axis=0) | support[3:].any(axis=0)]] = True
    frame += [np.bincount(held, v, count) / number for v in apart]
    return some, held, frame, isWorked


def _along_supports(velocity, mass, normal, held, isSlowed, island):
    """Parts (6, m) of the mean velocities of the islands isSlowed (I,) along all that they rest on.
    They stay. Friction, and links that are no contacts, take momentum in any direction.

    normal, held : (3, L), (L,), of what islands rest on, or 0, and these
    """
    count = len(isSlowed)
    along, isHeldFast = np.zeros((6, count)), np.bincount(held, ~normal.any(axis=0), count) > 0.0
    some = indices(isSlowed & ~isHeldFast)
    if len(some):
        total = [np.bincount(island, x, count)[some] for x in (*(mass * velocity[:3]), mass)]
        axes = np.eye(3)[:, :, None] * (1.0 - dot(normal, normal)) + normal[:, None] * normal
        blocked = [np.bincount(held, axis, count)[some] for axis in axes.reshape(9, -1)]
        values, vectors = np.linalg.eigh(np.transpose(blocked).reshape(-1, 3, 3))
        vectors *= (values <= ROUNDING * values[:, 2:])[:, None]
        mean = np.array(total[:3]) / total[3]
        along[:3, some] = np.einsum("iak,ibk,bi->ai", vectors, vectors, mean)
    return take(along, island, axis=1)
