"""Sleeping: bodies at rest are skipped until something disturbs them.

The rule is local: a body falls asleep once it has been slow, and near the same place, for a while.
Box2D and Bullet put whole islands to sleep instead. In a heap, which is one island, a few rolling
bodies would keep nearly all of it awake.

A sleeping body has no velocity, and supports others like a fixed one. It wakes if it is changed
from outside, if a constraint of it or the scene changes, or if it touches a body that has been
changed or is fast. Such a disturbance spreads by one body per step. A whole island wakes at once if
it loses a support, or rests on something that moves, where it stays awake however slow it is.

Forces, blows and ties reach farther. Bodies that a force could move wake. Those that blows or ties
could move visibly, before friction stopped them again, are on trial: they move in this step. If
they still lie at rest at its end, they have not moved; otherwise they stay awake.
"""

from copy import deepcopy
from types import SimpleNamespace

import numpy as np

from rbs.geometry.broadphase import islands
from rbs.geometry.vectors import cross, dot, find_sorted, indices, norm, take, vec_mat
from rbs.softstep.contacts import SLEEP_SECONDS
from rbs.softstep.manifolds import PlacedManifolds
from rbs.softstep.rows import reached

# Largest speed of a slow body, in √(g r) with its radius r. More stops visible motion; less keeps
# piles awake: with half of it, 40 % of a heap of 1000 sleep, not 95 %.
SLOW = 0.01
# Largest steady acceleration of a body at rest, as a fraction of that of gravity: in SLEEP_SECONDS,
# it moves a body that was still by the length that counts as no motion. With more, what glides at
# 1 mm/s falls asleep, and slow pendulums where they turn; with less, piles stay awake.
STEADY = 4e-4
# Seconds: this, times the acceleration of gravity, is the speed that leads as far in that time.
GLIDE = 0.5 * STEADY * SLEEP_SECONDS


class Sleep(SimpleNamespace):
    """Sleeping state of n bodies, and how long the others have been at rest.

    isAsleep : (n,) bool; timer : (n,), seconds at rest, inf for fixed bodies
    way : (6, n), displacements and rotation vectors in this time; 0 of sleepers
    state : (13, n), of `Bodies`, at the end of the last step
    """

    COLUMNS = ("isAsleep", "timer", "way", "state")

    @classmethod
    def none(cls, bodies):
        """Returns a `Sleep` in which all bodies are awake."""
        timer, way = np.where(bodies.isFixed, np.inf, 0.0), np.zeros((6, len(bodies.isFixed)))
        state = bodies.state[:, :-1]
        return cls(isAsleep=np.zeros_like(bodies.isFixed), timer=timer, way=way, state=state)

    def renumbered(self, bodies, number):
        """Returns the `Sleep` after bodies were added or removed; number : see
        `Manifolds.renumbered`. New bodies count as moved, so bodies that they touch wake.
        """
        sleep = Sleep.none(bodies)
        sleep.state = np.full_like(sleep.state, np.nan)
        isKept = number[:-1] >= 0
        for name, column in vars(sleep).items():
            column[..., number[:-1][isKept]] = getattr(self, name)[..., isKept]
        return sleep

    def settled(self, step, frames, motion, isTried):
        """Returns the `Sleep` at the end of a `Step`, and stops bodies that fall asleep. Of these,
        those on trial, isTried (n,), are put back to where they were.
        """
        bodies, timeStep, own = frames.bodies, step.timeStep, motion.bodies
        if not step.sleeping:
            return Sleep.none(bodies)
        way = self.way + timeStep * bodies.velocity
        mean = bodies.velocity.copy()
        mean[:, own] = motion.displacement[:, : len(own)] / timeStep
        # what glides, or starts to slide, leaves its place; a tremor does not
        seconds = np.where(isTried, timeStep, SLEEP_SECONDS)
        isNear = _speeds(bodies, way) <= GLIDE * bodies.fallRate * seconds
        speed = np.maximum(_speeds(bodies, bodies.velocity), _speeds(bodies, mean))
        rests = isNear & (speed <= _slow_speeds(bodies))
        timer = np.where(bodies.isFixed, np.inf, np.where(rests, self.timer + timeStep, 0.0))
        isAsleep = (timer >= SLEEP_SECONDS) & ~bodies.isFixed
        bodies.velocity[:] = np.where(isAsleep, 0.0, bodies.velocity)
        bodies.state[:, :-1] = np.where(isTried & isAsleep, self.state, bodies.state[:, :-1])
        way, state = np.where(rests & ~isAsleep, way, 0.0), bodies.state[:, :-1]
        return Sleep(isAsleep=isAsleep, timer=timer, way=way, state=state)


def wake(step, frames, state, manifolds, tied, lost, isDisturbed, isBereft):
    """`(sleep, isTried (n,))`: the `Sleep` with which the bodies of a `Step` move, and which
    of those that sleep, or are about to fall asleep, are on trial.

    state : `SolverState` of the last step; manifolds : of this one; tied : as for `Frames`
    lost : (2, K), see `unloaded`
    isDisturbed, isBereft : (n,), bodies that were changed, and that have lost a support
    """
    bodies, sleep, isFree = frames.bodies, state.sleep, ~frames.bodies.isFixed
    isTried = np.zeros_like(isFree)
    if not step.sleeping:
        return Sleep.none(bodies), isTried
    links = np.concatenate((manifolds.bodies(frames.count), tied), axis=1)
    carriers = bodies.isFixed & (isDisturbed | bodies.isKinematic)
    isWoken = (isBereft | beside(carriers, links, frames.isGroundMoving)) & isFree
    isWoken = isDisturbed | connected(isWoken, isFree, links)
    # also what would fall asleep in this step, and lose the momentum that it has just received
    isDue = isFree & (sleep.timer + step.timeStep >= SLEEP_SECONDS)
    if isDue.any():
        slow = _slow_speeds(bodies)
        isFast = ~isDue & (_speeds(bodies, bodies.velocity) > slow)
        isLeft = np.isin(np.arange(frames.count), lost)
        isWoken |= isDue & (isLeft | beside(isDisturbed | isFast, links))
        mass = 1.0 / np.where(isFree, bodies.invMass[:-1], np.inf)
        load = bodies.acceleration - np.reshape([*step.gravity, 0.0, 0.0, 0.0], (6, 1))
        force, least = _speeds(bodies, load), STEADY * bodies.fallRate
        isWoken |= isDue & reached(force > least, force, mass, links, least)
        # friction stops what is slower before it has left its place
        stopped = np.sqrt(STEADY * step.mu) * SLEEP_SECONDS * bodies.fallRate
        least = np.maximum(np.minimum(stopped, slow), GLIDE * bodies.fallRate)
        isSource = isDisturbed.copy()
        isSource[tied] = True
        blow = _striking_speeds(step, frames, manifolds, isSource)
        isTried = isDue & ~isWoken & reached(blow > least, blow, mass, links, least)
    isAsleep, timer = sleep.isAsleep & ~isWoken & ~isTried, np.where(isWoken, 0.0, sleep.timer)
    return Sleep(**vars(sleep) | {"isAsleep": isAsleep, "timer": timer}), isTried


def _striking_speeds(step, frames, manifolds, isSource):
    """Speeds (n,) of bodies whose momentum others may receive in the step: own ones of isSource
    (n,), and of all, the greatest towards what they meet in the step and, as its last sweep stops
    that, too, in one more substep. The former are relative to what is still: a body also pushes
    what the one before it pushes.
    """
    bodies, ends = frames.bodies, manifolds.bodies(frames.count)
    isFixed = np.append(bodies.isFixed, True)
    speed = np.where(isFixed, -1.0, np.append(_speeds(bodies, bodies.velocity), 0.0))
    rows = indices((speed > 0.0)[ends].any(axis=0))
    placed, ends = PlacedManifolds(manifolds, frames, rows), ends[:, rows]
    arms = np.stack((placed.arm, placed.arm - placed.t[:, None]), axis=1)  # (3, 2, 4, M)
    v, w = take(frames.velocity, ends, axis=1)[:, :, None].reshape(2, 3, 2, 1, -1)
    velocity = v + cross(w, arms)
    towards = dot(placed.normal[:, None, None], velocity)
    towards[1] *= -1.0
    seconds = frames.timeStep * (1.0 + 1.0 / step.substeps)
    way = seconds * (towards[0] + towards[1] + frames.timeStep * bodies.fallRate)
    isMet = placed.isPoint & (placed.gap <= way)
    blow = (1.0 + step.CRCoeff) * np.where(isMet, towards, 0.0).max(axis=1)
    speed *= np.append(isSource, False)
    np.maximum.at(speed, ends, blow)
    return speed[:-1]


def unloaded(step, frames, state, gravity, manifolds, isDisturbed, isBereft):
    """`(manifolds, isBereft (n,), lost (2, K))`: without the loads of what falls in this step,
    because it has lost what it rested on, which bodies have lost a support, and between which there
    was a contact that carried a load, and is none now.

    state : `SolverState`, with the manifolds of the last step; gravity : m/s², along which they
        carried loads; manifolds : of this `Step`
    isDisturbed, isBereft : (n,), bodies that were changed, and that touched a removed one

    A support is also lost that moves away faster than a body falls. If nothing else holds the
    body, the loads of the manifolds above it end at once, and their points no longer overlap.
    Otherwise, each body would still press on the next as it falls.
    """
    old, isLeft = state.manifolds, np.append(isBereft, False)
    isLost = old.impulse.any(axis=0) & (find_sorted(old.key, manifolds.key) < 0)
    lost = old.bodies(frames.count)[:, isLost]
    if len(old.key) == 0 or not (isBereft | isDisturbed).any():
        return manifolds, isBereft, lost
    isLeft[lost[:, np.append(isDisturbed, False)[lost].any(axis=0)]] = True

    isStill, manifolds = np.append(frames.bodies.isFixed, True), deepcopy(manifolds)
    placed = PlacedManifolds(manifolds, frames, np.arange(len(manifolds.key)))
    along = dot(np.reshape(gravity, (3, 1)), placed.normal)
    lower, upper = (placed.first, placed.second), (placed.second, placed.first)
    lower, upper = np.where(along < 0.0, lower, upper)
    # without forces, because loads may hold down what they lift
    fall = np.where(isStill, 0.0, frames.timeStep * np.reshape(step.gravity, (3, 1)))
    velocity = frames.velocity[:3] + fall
    way = take(velocity, placed.second, axis=1) - take(velocity, placed.first, axis=1)
    isLeaving = isStill[lower] & (dot(way, placed.normal) > 0.0)
    isLoaded = manifolds.impulse.any(axis=0) & (along != 0.0)
    isLeft[upper[isLoaded & isLeaving]] = True
    isHeld = isStill.copy()
    isTouching = ((placed.gap <= 0.0) & placed.isPoint).any(axis=0) & (along != 0.0)
    isHeld[upper[isTouching & ~isLeaving]] = True
    falls, found = isLeft & ~isHeld, -1
    while np.count_nonzero(falls) > found:
        found = np.count_nonzero(falls)
        falls[upper[isLoaded & falls[lower]]] = True
    rows = indices(falls[lower] | (isLeaving & falls[upper]))
    manifolds.impulse[:, rows] = manifolds.friction[:, rows] = 0.0
    lift = placed.normal[:, None, rows] * np.maximum(-placed.gap[:, rows], 0.0)
    rotation = take(frames.rotation, placed.second[rows], axis=1)
    manifolds.anchor2[:, :, rows] += vec_mat(lift, rotation[:, None])
    return manifolds, isLeft[:-1], lost


def connected(some, isFree, links):
    """Which bodies (n,) are in the islands of `some` (n,); links, isFree : see `islands`"""
    if not some.any():
        return some
    island = islands(links, isFree)
    return np.isin(island, island[some]) & isFree


def beside(some, links, ground=False):
    """Which bodies (n,) are linked to one of `some` (n,), or to the ground if that is one."""
    some = np.append(some, ground)
    found = np.zeros_like(some)
    found[links[some[links[::-1]]]] = True
    return found[:-1]


def _slow_speeds(bodies):
    return SLOW * np.sqrt(bodies.fallRate * bodies.hulls.radius)


def _speeds(bodies, velocity):
    """Upper bounds (n,) of the speed of any point of each body, |v| + |ω| r; velocity : (6, n)"""
    return norm(velocity[:3]) + norm(velocity[3:]) * bodies.hulls.radius
