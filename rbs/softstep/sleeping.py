"""Sleeping: bodies at rest are skipped until something disturbs them.

The rule is local: a body falls asleep if it has been slow for a while, and stayed where it was.
Box2D and Bullet put whole islands to sleep instead. In a heap, which is one island, a few rolling
bodies would keep nearly all of it awake.

A sleeping body has no velocity, and supports others like a fixed one. It wakes if it or a body that
it touches has been changed from outside or is fast, if a constraint changes, and if the scene does.
This spreads by one body per step. But a whole island wakes at once where it loses a support from
outside, or stands on one that moves; on that, it stays awake, however slow it is.

A sleeper is no wall, either. Those that a blow could make fast, if its momentum passed on to them,
are tried: they move in this step with their masses. Those that still lie at rest at its end have
never moved; others stay awake until they do. Those that a force could move wake.
"""

from copy import deepcopy
from types import SimpleNamespace

import numpy as np

from rbs.geometry.broadphase import islands
from rbs.geometry.vectors import cross, dot, find_sorted, indices, norm, take, vec_mat
from rbs.softstep.contacts import SLEEP_SECONDS
from rbs.softstep.manifolds import ROUNDING, PlacedManifolds
from rbs.softstep.rows import reached

# Largest speed of a slow body, in √(g r) with its radius r. More stops visible motion; less keeps
# piles awake: with half of it, 40 % of a heap of 1000 sleep, not 95 %.
SLOW = 0.01
# Largest steady acceleration of a body at rest, as a fraction of that of gravity: in SLEEP_SECONDS,
# it moves a body that was still by the length that counts as no motion. With more, what glides at
# 1 mm/s falls asleep, and slow pendulums where they turn; with less, piles stay awake.
STEADY = 4e-4


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
        """Returns the `Sleep` at the end of a `Step`, and stops bodies that fall asleep; those on
        trial, isTried (n,), that do so have not moved.
        """
        bodies, timeStep = frames.bodies, step.timeStep
        if not step.sleeping:
            return Sleep.none(bodies)
        isStill, way = self.isAsleep & ~isTried, self.way + timeStep * bodies.velocity
        speed = 0.5 * STEADY * bodies.fallRate * SLEEP_SECONDS
        # what glides, or starts to slide, leaves its place; a tremor does not
        isNear = _speeds(bodies, way) <= speed * np.where(isTried, timeStep, SLEEP_SECONDS)
        rests = isStill | (isNear & _are_slow(bodies, motion))
        timer = np.where(bodies.isFixed, np.inf, np.where(rests, self.timer + timeStep, 0.0))
        isAsleep = (timer >= SLEEP_SECONDS) & ~bodies.isFixed
        bodies.velocity[:] = np.where(isAsleep, 0.0, bodies.velocity)
        bodies.state[:, :-1] = np.where(isTried & isAsleep, self.state, bodies.state[:, :-1])
        way, state = np.where(rests & ~isAsleep, way, 0.0), bodies.state[:, :-1]
        return Sleep(isAsleep=isAsleep, timer=timer, way=way, state=state)


def wake(step, frames, state, gravity, manifolds, tied, isDisturbed, isBereft):
    """`(manifolds, sleep, isTried (n,))`: the manifolds and the `Sleep` with which the bodies of a
    `Step` move, and which sleepers are tried.

    state : `SolverState`; gravity : (3,), of the last step; tied : as for `detect`
    isDisturbed, isBereft : (n,), bodies that were changed, and that touched a removed one
    """
    bodies, count, sleep, isFree = frames.bodies, frames.count, state.sleep, ~frames.bodies.isFixed
    isBereft = isBereft | (np.isinf(sleep.timer) & isFree)  # of itself, if it was fixed
    if isBereft.any() or (isDisturbed.any() and len(state.manifolds.key)):
        lost = state.manifolds.rows(indices(find_sorted(state.manifolds.key, manifolds.key) < 0))
        isLeft = np.append(isBereft, False)
        isLeft[lost.bodies(count)[:, lost.impulse.any(axis=0)]] = True
        manifolds, isBereft = released(manifolds, frames, isLeft, gravity)
    isTried = np.zeros(count, dtype=bool)
    if not step.sleeping:
        return manifolds, Sleep.none(bodies), isTried
    links = np.concatenate((manifolds.bodies(count), tied), axis=1)
    # what stands on the ground, or on a fixed body, that moves, and what has lost its support
    carriers = bodies.isFixed & (isDisturbed | bodies.isKinematic)
    isWoken = (isBereft | beside(carriers, links, frames.isGroundMoving)) & isFree
    isWoken = isDisturbed | connected(isWoken, isFree, links)
    if sleep.isAsleep.any():
        isMoving = isDisturbed | ~(sleep.isAsleep | _are_slow(bodies))
        isWoken |= sleep.isAsleep & beside(isMoving, links)
        load = bodies.acceleration - np.reshape([*step.gravity, 0.0, 0.0, 0.0], (6, 1))
        force = bodies.isDriven * _speeds(bodies, load)
        mass = 1.0 / np.where(isFree, bodies.invMass[:-1], np.inf)
        least = STEADY * bodies.fallRate
        isWoken |= sleep.isAsleep & reached(force >= least, force, mass, links, least)
        isAwake = ~sleep.isAsleep | isWoken
        blow = (1.0 + step.CRCoeff) * isAwake * _striking_speeds(step, frames, manifolds, isAwake)
        least = _slow_speeds(bodies)
        isTried = ~isAwake & reached(blow >= least, blow, mass, links, least)
    timer = np.where(isWoken, 0.0, sleep.timer)
    sleep = Sleep(**vars(sleep) | {"isAsleep": sleep.isAsleep & ~isWoken, "timer": timer})
    return manifolds, sleep, isTried


def _striking_speeds(step, frames, manifolds, isAwake):
    """Largest speed (n,) at which points of bodies come towards one that they meet in the step, or
    would in one more substep: its last sweep stops them, too. The speed is relative to what is
    still, because a body also pushes what the one before it pushes.

    isAwake : (n,); at least one of the two bodies is
    """
    ends, found = manifolds.bodies(frames.count), np.zeros(frames.count + 1)
    rows = indices(np.append(isAwake, False)[ends].any(axis=0))
    placed, towards = PlacedManifolds(manifolds, frames, rows), []
    arms = placed.arm, placed.arm - placed.t[:, None]
    for end, arm, sign in zip((placed.first, placed.second), arms, (1.0, -1.0), strict=True):
        v, w = take(frames.velocity, end, 1).reshape(2, 3, 1, -1)
        velocity = v + cross(np.broadcast_to(w, arm.shape), arm)
        towards.append(sign * dot(placed.normal[:, None], velocity))
    seconds = frames.timeStep * (1.0 + 1.0 / step.substeps)
    way = seconds * (towards[0] + towards[1] + frames.timeStep * frames.bodies.fallRate)
    isMet = placed.isPoint & (placed.gap <= way)
    speeds = np.where(isMet, towards, 0.0).max(axis=1)
    np.maximum.at(found, np.concatenate((placed.first, placed.second)), speeds.ravel())
    return found[:-1]


def released(manifolds, frames, isLeft, gravity):
    """`(manifolds, isBereft (n,))`, after bodies (n + 1,) have lost a contact that carried a load.

    gravity : m/s², of the last step

    A support is also lost that moves away faster than a body falls. If nothing else holds the
    body, the loads of the manifolds above it end at once, and their points no longer overlap.
    Otherwise, each body would still press on the next as it falls.
    """
    isStill, manifolds = np.append(frames.bodies.isFixed, True), deepcopy(manifolds)
    placed = PlacedManifolds(manifolds, frames, np.arange(len(manifolds.key)))
    height = dot(np.reshape(gravity, (3, 1)), placed.normal)
    isUp = height < 0.0  # the second body lies above the first
    lower, upper = np.where(isUp, (placed.first, placed.second), (placed.second, placed.first))
    fall = frames.timeStep * ~frames.bodies.isFixed * frames.bodies.acceleration[:3]
    velocity = frames.velocity[:3] + np.column_stack((fall, np.zeros(3)))
    way = take(velocity, placed.second, axis=1) - take(velocity, placed.first, axis=1)
    rounding = ROUNDING * frames.timeStep * norm(gravity)
    isLeaving = isStill[lower] & (dot(way, placed.normal) > rounding)
    isLoaded = manifolds.impulse.any(axis=0) & (height != 0.0)
    isLeft[upper[isLoaded & isLeaving]] = True
    isHeld = isStill.copy()
    isTouching = ((placed.gap <= 0.0) & placed.isPoint).any(axis=0) & (height != 0.0)
    isHeld[upper[isTouching & ~isLeaving]] = True
    free, found = isLeft & ~isHeld, -1
    while np.count_nonzero(free) > found:
        found = np.count_nonzero(free)
        free[upper[isLoaded & free[lower]]] = True
    rows = indices(free[lower] | (isLeaving & free[upper]))
    manifolds.impulse[:, rows] = manifolds.friction[:, rows] = 0.0
    lift = placed.normal[:, None, rows] * np.maximum(-placed.gap[:, rows], 0.0)
    rotation = take(frames.rotation, placed.second[rows], axis=1)
    manifolds.anchor2[:, :, rows] += vec_mat(lift, rotation[:, None])
    return manifolds, isLeft[:-1]


def _slow_speeds(bodies):
    return SLOW * np.sqrt(bodies.fallRate * bodies.hulls.radius)


def _are_slow(bodies, motion=None):
    """Whether bodies (n,) are slow; after a step with a `Motion`, also on average in it."""
    speed, mean = _speeds(bodies, bodies.velocity), bodies.velocity.copy()
    if motion is not None:
        mean[:, motion.bodies] = motion.displacement[:, : len(motion.bodies)] / motion.timeStep
        speed = np.maximum(speed, _speeds(bodies, mean))
    return speed <= _slow_speeds(bodies)


def connected(some, isFree, links):
    """Which bodies (n,) are in the islands of `some` (n,); isFree : see `islands`."""
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


def _speeds(bodies, velocity):
    """Upper bounds (n,) of the speed of any point of each body, |v| + |ω| r; velocity : (6, n)"""
    return norm(velocity[:3]) + norm(velocity[3:]) * bodies.hulls.radius
