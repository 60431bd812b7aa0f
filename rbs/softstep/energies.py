"""A bound on the energy that contacts and constraints give to connected bodies.

If several pairs collide in one step, Newton's law of restitution may require more energy than
there was (Stronge: Rigid body collisions with friction. Proceedings of the Royal Society A, 1990).
Springs that push overlaps out give some, too, and so does friction that is not solved exactly.
Without a bound, a heavy body squeezes out a light one that it rests on.
"""

import numpy as np

from Quaternion import exponentials, rotation_matrices
from rbs.geometry.broadphase import islands
from rbs.geometry.vectors import dot, mat_vec, rotate_tensor
from rbs.softstep.rows import adjugate


def bounded_share(motion, links):
    """Leaves each island of connected bodies no more energy than it had, and gravity's work.

    Where it has more, its velocities shrink if it rests on something, and otherwise its impulses,
    which conserves momentum. Islands on which kinematic bodies, forces or torques work are left
    alone. Returns the share (m + 1,) of each body's impulses that is left.

    links : (2, L), connected columns of `Motion`
    """
    last, momenta = len(motion.moving), motion.momenta
    isMovable, share = motion.invMass[:-1] > 0.0, np.ones(last + 1)
    if len(links[0]) == 0:
        return share
    mass = np.where(isMovable, 1.0 / np.where(isMovable, motion.invMass[:-1], 1.0), 0.0)
    inverse = motion.invInertia[:, :-1].reshape(3, 3, last)
    inertia, determinant = adjugate(inverse)
    inertia = (inertia / np.where(isMovable, determinant, 1.0)).reshape(9, last)
    turn = np.stack(rotation_matrices(exponentials((0.0, *(0.5 * motion.turn[:, :-1])))))
    atEnd = np.stack(rotate_tensor(turn, inertia))

    def products(v, w, inertia=atEnd):
        return mass * dot(v[:3], w[:3]) + dot(v[3:], mat_vec(inertia, w[3:]))

    def turned(v):
        """Velocities (6, m) at the end of the step."""
        if momenta is None:
            return v
        inverseAtEnd = np.stack(rotate_tensor(turn, inverse.reshape(9, last)))
        return np.concatenate((v[:3], mat_vec(inverseAtEnd, mat_vec(inertia, v[3:]) + momenta)))

    begin = motion.begin[:, :-1]
    start = begin
    if momenta is not None:
        start = begin.copy()
        start[3:] += mat_vec(inverse.reshape(9, last), momenta)
    limit = 0.5 * products(start, start, inertia) + mass * dot(motion.gravity, motion.shift)[:-1]
    island = islands(links, isMovable)
    count = int(island.max()) + 1
    velocity = motion.velocity[:, :-1]
    now = turned(velocity)
    limit = np.bincount(island, limit, count)
    energy = np.bincount(island, 0.5 * products(now, now), count)
    # what is linked to a kinematic body or driven
    isWorked = np.append(~isMovable | motion.spinUp[:, :-1].any(axis=0), False)
    isWorked[links[:, isWorked[links].any(axis=0)]] = True
    isOver = (energy > limit) & (np.bincount(island, isWorked[:-1], count) == 0.0)
    if not isOver.any():
        return share
    rests = np.zeros(last + 1, dtype=bool)
    rests[links[:, (links == last).any(axis=0)]] = True
    rests = np.bincount(island, rests[:-1], count) > 0.0
    # with the fraction s of the changes since free flight, the energy is that of free flight plus
    # b s + a s²
    free = begin.copy()
    free[:3] += motion.fall[:, :-1]
    atFree = turned(free)
    change = now - atFree
    a = np.bincount(island, 0.5 * products(change, change), count)
    b = np.bincount(island, products(atFree, change), count)
    left = limit - np.bincount(island, 0.5 * products(atFree, atFree), count)
    root = np.sqrt(np.maximum(b * b + 4.0 * a * left, 0.0))
    part = np.clip((root - b) / np.where(a > 0.0, 2.0 * a, 1.0), 0.0, 1.0)
    share[:-1] = np.where(isOver & ~rests, part, 1.0)[island]
    shrink = np.sqrt(np.maximum(limit, 0.0) / np.where(isOver, energy, 1.0))
    shrink = np.where(isOver & rests, shrink, 1.0)[island]
    motion.velocity[:, :-1] = shrink * (free + share[:-1] * (velocity - free))
    return share
