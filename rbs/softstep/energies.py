"""A bound on the energy that contacts and infeasible constraints give to connected bodies.

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


def bounded_share(motion, touching, normal, tied, strained, infeasible):
    """Leaves each island of connected bodies no more energy than it had, plus the work of gravity.

    Where it has more, its velocities shrink if it rests on something, apart from the mean one along
    that, and otherwise its impulses: momentum is conserved where nothing takes it. Islands on which
    torques work, or supports that move differently, are left alone, and so are those without a
    contact: constraints give back only what they took. Strained ones would give more, and where
    some are infeasible, gravity's work does not count.
    Returns the share (m + 1,) of each body's impulses that is left.

    touching : (2, C), columns of `Motion` that touch
    normal : (3, C), their unit normals, or 0 where friction acts, too
    tied, strained, infeasible : (2, L), (2, S), (2, K), those that constraints join, and that
        strained and infeasible ones join
    """
    last, isTumbling = len(motion.moving), motion.drift is not None
    isMovable, share = motion.invMass[:-1] > 0.0, np.ones(last + 1)
    if len(touching[0]) + len(strained[0]) == 0:
        return share
    links = np.concatenate((touching, tied), axis=1)
    mass = 1.0 / np.where(isMovable, motion.invMass[:-1], np.inf)
    inertia = motion.inertia
    turn = np.stack(turn_matrix(motion.turn[:, :-1]))

    def products(v, w):
        return mass * dot(v[:3], w[:3]) + dot(v[3:], mat_vec(inertia, w[3:]))

    def turned(v):
        """Velocities (6, m) at the end of the step, the angular ones in axes that turn with it."""
        if not isTumbling:
            return np.concatenate((v[:3], vec_mat(v[3:], turn)))
        inverse = inverted(inertia.reshape(3, 3, last)).reshape(9, last)
        momentum = vec_mat(mat_vec(inertia, v[3:]), turn)
        return np.concatenate((v[:3], mat_vec(inverse, momentum)))

    island = islands(links, isMovable)
    count = int(island.max()) + 1
    frame, rests, isWorked = _surroundings(motion, island, mass, links)
    begin, velocity = motion.begin[:, :-1] - frame, motion.velocity[:, :-1] - frame
    way = motion.shift[:, :-1] - motion.timeStep * frame[:3]
    work = mass * dot(motion.gravity[:, :-1], way)
    isBound, isInfeasible = np.zeros((2, last + 1), dtype=bool)
    isBound[touching], isBound[strained] = True, True
    isInfeasible[infeasible] = True
    isBound, isInfeasible = (
        np.bincount(island, x[:-1], count) > 0.0 for x in (isBound, isInfeasible)
    )
    limit = 0.5 * products(begin, begin) + np.where(isInfeasible[island], 0.0, work)
    now = turned(velocity)
    limit = np.bincount(island, limit, count)
    energy = np.bincount(island, 0.5 * products(now, now), count)
    isBound &= ~isWorked
    isOver = isBound & (energy > limit)
    if not (isOver.any() or isTumbling):
        return share
    # with the fraction s of the changes since free flight, the energy is that of free flight plus
    # b s + a s²
    free = begin.copy()
    free[:3] += motion.timeStep * motion.gravity[:, :-1]
    atFree = turned(free)
    change = now - atFree
    a = np.bincount(island, 0.5 * products(change, change), count)
    b = np.bincount(island, products(atFree, change), count)
    if isTumbling:  # as they turn on, bodies that have bounced keep what the impulses have left
        isElastic = isBound & (a > 0.0) & (b > -BOUNCED * a)
        kept = np.bincount(island, 0.5 * products(velocity, velocity), count)
        limit = np.where(isElastic, np.minimum(limit, kept), limit)
        isOver |= isElastic
    left = limit - np.bincount(island, 0.5 * products(atFree, atFree), count)
    root = np.sqrt(np.maximum(b * b + 4.0 * a * left, 0.0))
    part = np.maximum((root - b) / np.where(a > 0.0, 2.0 * a, 1.0), 0.0)
    share[:-1] = np.where(isOver & ~rests, part, 1.0)[island]
    isShrunk = isOver & rests
    along = _means_along(motion, island, mass, velocity, links, normal, isShrunk)
    own = np.bincount(island, 0.5 * mass * dot(along, along), count)
    shrink = np.maximum(limit - own, 0.0) / np.maximum(energy - own, TINY)
    shrink = np.where(isShrunk, np.sqrt(shrink), 1.0)[island]
    velocity = free + share[:-1] * (velocity - free)
    motion.velocity[:, :-1] = frame + along + shrink * (velocity - along)
    return share


def _means_along(motion, island, mass, velocity, links, normal, isAsked):
    """Parts (6, m) of the mean velocities of islands along all that they rest on, or 0.

    Friction, and links that are no contacts, take momentum in any direction.

    velocity : (6, m), relative to what they rest on; links : (2, L), of which the first C are
        contacts; normal : (3, C), as for `bounded_share`; isAsked : (I,), islands
    """
    asked, along = indices(isAsked), np.zeros((6, len(isAsked)))
    if len(asked) == 0:
        return along[:, island]
    axes = np.eye(3)[:, :, None].repeat(len(links[0]), axis=2)
    axes[..., : len(normal[0])] *= 1.0 - dot(normal, normal)
    axes[..., : len(normal[0])] += normal[:, None] * normal
    isHeld = motion.invMass[links] == 0.0
    some = indices(isHeld[0] != isHeld[1])
    held = island[np.where(isHeld[0], *links[::-1])[some]]
    axes, count = take(axes.reshape(9, -1), some, 1), len(isAsked)
    blocked = np.array([np.bincount(held, axis, count)[asked] for axis in axes])
    values, vectors = np.linalg.eigh(blocked.T.reshape(-1, 3, 3))
    vectors *= (values <= ROUNDING * values[:, 2:])[:, None]
    total = np.bincount(island, mass, count)[asked]
    mean = np.array([np.bincount(island, mass * v, count)[asked] for v in velocity[:3]]) / total
    along[:3, asked] = np.einsum("iak,ibk,bi->ai", vectors, vectors, mean)
    return along[:, island]


def _surroundings(motion, island, mass, links):
    """`(frame (6, m), rests (I,), isWorked (I,))` of I islands.

    frame : velocities of what they rest on, or of their centres of mass
    isWorked : whether torques work on one, or its supports turn, or move differently
    island, mass : (m,); links : (2, L), columns that touch or that a constraint links
    """
    count = int(island.max()) + 1
    total = np.maximum(np.bincount(island, mass, count), TINY)
    frame = np.zeros((6, count))
    frame[:3] = [np.bincount(island, mass * v, count) / total for v in motion.begin[:3, :-1]]
    body, support = np.concatenate((links, links[::-1]), axis=1)
    isHeld = (motion.invMass[body] > 0.0) & (motion.invMass[support] == 0.0)
    held, support = island[body[isHeld]], motion.velocity[:, support[isHeld]]
    frame[:, held] = support
    isWorked = np.bincount(island, motion.spinUp[:, :-1].any(axis=0), count) > 0.0
    isWorked[held[(support != frame[:, held]).any(axis=0) | support[3:].any(axis=0)]] = True
    return frame[:, island], np.bincount(held, minlength=count) > 0, isWorked
