"""Contact impulses of the soft step: springs, relaxation, and blows, on `ContactRows`."""

import math
from copy import copy
from functools import cached_property

import numpy as np

from rbs.geometry.broadphase import islands
from rbs.geometry.vectors import dot, indices, norm, take
from rbs.softstep.detection import Poses
from rbs.softstep.energies import bounded_share
from rbs.softstep.manifolds import POINTS, ROUNDING, TINY, UNEVEN, PlacedManifolds
from rbs.softstep.rows import (
    SWEEPS,
    TOLERANCE,
    PartRows,
    contact_rows,
    islands_of,
    mean_squares,
    reached,
    split_masses,
)
from rbs.softstep.supports import FLUSH

# Natural frequency of contact springs, as a fraction of the substep frequency. A higher one makes
# stacks bounce, because the impulses of one sweep per substep lag behind: with 0.2, a stack of
# ten boxes never comes to rest. A lower one is visibly soft.
FREQUENCY = 0.165
# Damping ratio of contact springs. With more, penetration is pushed out more slowly, and a tower
# takes longer to come to rest; with less, down to critical, heavy bodies sink through light ones
# below them.
DAMPING = 6.0
# Integrated implicitly over a substep of h, such a spring and damper gives the impulse
#     λ ← KEPT (λ - m (u + ω s/a₁)),   KEPT = a₂/(1 + a₂),   a₁ = 2 DAMPING + h ω,   a₂ = h ω a₁,
# where h ω is 2π FREQUENCY, at a separation s that grows with the speed u, with the effective mass
# m (Catto: Soft Constraints. Game Developers Conference 2011).
ANGLE = 2.0 * math.pi * FREQUENCY
A1 = 2.0 * DAMPING + ANGLE
KEPT = ANGLE * A1 / (1.0 + ANGLE * A1)
# Seconds for which bodies must be slow before they fall asleep. More keeps piles awake for longer.
# Less stops slow motions: with a single step, bodies fall asleep as they begin to slide, and where
# they are added. In this time, overlapping bodies without weight are pushed apart by their radius.
SLEEP_SECONDS = 0.5
# Largest growth of an impulse from one warm start to the next, as a factor. With more, the impulse
# of an impact is repeated in the next substep and throws bodies apart; less delays a new load.
LOAD_GROWTH = 2.0
# Most sweeps where bounces lose no energy. With fewer, balls whose points are near each other lose
# some.
MOST_SWEEPS = 200


def push_speeds(motion, radius):
    """Greatest speeds at which overlaps and distance errors are pushed out, for radii of bodies:
    with these, a body has fallen by half its radius.
    """
    return np.maximum(np.sqrt(motion.fallRate * radius), radius / SLEEP_SECONDS)


class SoftContacts(PlacedManifolds):
    """Impulses of a step on the `ContactRows` of the manifolds that have a movable body.

    Speeds are in m/s, impulses in mass · m/s.

    system : their `ContactRows`; ends : (2, M), columns of `Motion`; others : manifolds without one
    impulse, total : (7, M), in the last substep, and in all of them; pending : not applied yet
    started, carried : (4, M), with which normal impulses a substep starts; the first, in a step
    separation : (4, M), m; speed : (7, M), of the rows when last measured
    closing : (4, M), normal speeds at which points meet after free flight has closed their gaps
    fallSpeeds, fallSpeed : (m + 1,), (M,), that gravity and forces add to bodies in a step, and the
        greater one of the two; weight : (4, M), impulses that stop it in a substep
    rounding, slow : speeds that count as rounding, and as none in a blow
    pushSpeed : (M,), < 0, with which points are pushed out at most
    most : (4, M), by which springs lower impulses at most, as they yield
    isUneven, tolerance : (M,), what is always solved until it converges, and the error where all
        such sweeps end; sinkSpeed : (M,), beyond which more than one sweep is needed
    """

    def __init__(self, manifolds, frames, motion, mu, h, ratio):
        """h : s, length of a substep, `ratio` times that of the last step"""
        self.h, self.timeStep = h, motion.timeStep
        ends, bodies = manifolds.bodies(frames.count), frames.bodies
        columns = take(motion.column, ends)
        isMovable = (motion.invMass[columns] > 0.0).any(axis=0)
        self.others = indices(~isMovable)
        super().__init__(manifolds, frames, indices(isMovable))
        self.ends = take(columns, self.rows, axis=1)
        radius = frames.sizes(self.first, self.second)[1]
        self.pushSpeed = -push_speeds(motion, radius)
        impulse = manifolds.impulse[:, self.rows] * self.isPoint
        self.impulse = ratio * np.concatenate((impulse, manifolds.friction[:, self.rows]))
        self.separation = self.gap.copy()
        inverse = np.concatenate((bodies.invMass[None], bodies.invInertia))
        self._bodies, self._inverse = ends, inverse
        self.system = contact_rows(self, self._masses(motion), frames, motion, mu)
        self.system.turn(0.5)  # arms are those in the middle of the next substep
        self.speed = self.system.speeds(motion)
        self.rounding = ROUNDING * np.abs(self.speed[:6]).max(initial=0.0)
        self.closing = self._closing_speeds(motion)
        rates = self._fall_rates(motion, bodies.isDriven)
        self.fallSpeeds = np.maximum(rates * self.timeStep, self.rounding)
        self.fallSpeed = take(self.fallSpeeds, self.ends).max(axis=0)
        hardest = max(self.fallSpeed.max(initial=0.0), -self.closing.min(initial=0.0))
        self.slow = max(TOLERANCE * hardest, self.rounding)
        self.started = self.impulse[:POINTS]
        self.carried = self.started * (self.timeStep / h)
        self.weight = self.system.mass * (take(rates, self.ends).max(axis=0) * h)
        self.pending, self.total = np.zeros((2, 7, self.count))
        least = TOLERANCE * self.fallSpeed * h / self.timeStep
        least = np.maximum(least, max(self.rounding, TINY))
        self.system.let_slide(np.where(self._may_slide(), least, 0.0))
        isUneven, loads = self._weighed(self._inverse[0], motion)
        self.most = (1.0 - KEPT) * loads * self.weight
        # impulses of longer or shorter substeps are a wrong start, which one sweep would leave
        self.isUneven = isUneven | (ratio != 1.0)
        # in every substep, constraints may pull down again what one sweep has stopped
        isTied = (take(frames.tiedReach, ends[:, self.rows]) > 0.0).any(axis=0)
        self.sinkSpeed = np.where(isTied, self.fallSpeed, FLUSH * radius / h)
        self.tolerance = np.where(self.isUneven, TOLERANCE * self.fallSpeed, self.sinkSpeed)

    def _closing_speeds(self, motion):
        """`closing`: u² = u₀² - 2 a s, with the relative acceleration a along the normal."""
        gravity = np.subtract(*take(motion.gravity, self.ends[::-1], axis=1).swapaxes(0, 1))
        gain = -2.0 * dot(self.normal, gravity) * np.maximum(self.gap, 0.0)
        speed = self.speed[:POINTS]
        return -np.sqrt(np.maximum(speed * speed + gain, 0.0)) * (speed < 0.0)

    def _fall_rates(self, motion, isDriven):
        """Accelerations (m + 1,) that press bodies together: the greatest, by gravity and forces,
        of those in contact. A field of forces is gravity.

        isDriven : (n,)
        """
        rates = np.full(len(motion.invMass), motion.fallRate)
        if isDriven.any():
            island = islands(self.ends, motion.invMass[:-1] > 0.0)
            np.maximum.at(rates, island, norm(motion.gravity[:, :-1]))
            rates[:-1] = rates[island]
        return rates

    def _weighed(self, invMass, motion):
        """`(isUneven (M,), loads (M,))`: whether manifolds are in islands in which bodies of UNEVEN
        masses touch, and the largest loads to which their springs yield, in weights of the
        effective mass. That is half of UNEVEN where masses are so uneven; of others, more by the
        square of how much more even they are. With more, heavy bodies sink into light ones; with
        less, they push them about, and stacks of 20 equal ones sway.

        What rests on a light body presses it on its supports, too, so the heaviest of the bodies
        that touch either one counts. What sleeps weighs as much as what is awake.

        invMass : (n + 1,), of all bodies
        """
        ends = np.array((self.first, self.second))
        inverse = take(invMass, ends)
        heavier, lighter = np.minimum(*inverse), np.maximum(*inverse)  # inverse masses
        isUneven = (heavier > 0.0) & (lighter > UNEVEN * heavier)
        if isUneven.any():
            island = islands_of(self.ends, motion.invMass)
            isUneven = np.isin(island, island[isUneven])
        heavier, heaviest = np.where(heavier > 0.0, heavier, lighter), np.full(len(invMass), np.inf)
        np.minimum.at(heaviest, ends.ravel(), np.tile(heavier, 2))
        heaviest[invMass == 0.0] = np.inf
        heaviest = take(heaviest, ends).min(axis=0)
        return isUneven, 0.5 * UNEVEN * np.maximum(UNEVEN * heaviest / lighter, 1.0) ** 2

    def _may_slide(self):
        """Whether manifolds (M,) of several points may touch in the step, and their points slip, on
        average of the squares, by more than gravity adds.
        """
        isFast = mean_squares(self.speed[POINTS:], self.system.spread) > self.fallSpeed**2
        isNear = self.separation < self.timeStep * (self.fallSpeed - self.speed[:POINTS])
        return isFast & (isNear & self.isPoint).any(axis=0) & self.system.limits[1].any(axis=0)

    def weigh(self, motion):
        """Takes over the masses of bodies, to which constraints add some."""
        if not np.array_equal(self._inverse[:, motion.moving], motion.inverse[:, :-1]):
            self.system.weigh(self._masses(motion))

    def _masses(self, motion):
        self._inverse[:, motion.moving] = motion.inverse[:, :-1]
        return split_masses(self, self._bodies, self._inverse, motion)

    def measure(self, motion):
        """Computes the speeds (7, M) of the rows, with all impulses applied."""
        self.apply(motion)
        self.speed = self.system.speeds(motion)

    def apply(self, motion):
        """Applies the impulses accumulated since the last call to the bodies."""
        self.system.apply(motion, self.pending)
        self.pending = np.zeros(self.pending.shape)

    def warm_start(self):
        """Starts with the impulses of the last substep, limited by LOAD_GROWTH."""
        self.impulse = self._grown(self.started, self.weight)
        self.started = self.impulse[:POINTS]
        self.pending = self.pending + self.impulse

    def _grown(self, before, least):
        """Impulses (7, M), if those at the points were (4, M) before, limited by LOAD_GROWTH.

        least : (4, M), up to which they always grow
        """
        normal, friction = self.impulse[:POINTS], self.impulse[POINTS:]
        grown = np.minimum(normal, np.maximum(LOAD_GROWTH * before, least))
        grown[:, self.isUneven] = normal[:, self.isUneven]
        share = np.add.reduce(grown) / np.maximum(np.add.reduce(normal), TINY)
        return np.concatenate((grown, friction * share))

    def soft_sweep(self, motion):
        """Pushes penetration out, and goes on with what still sinks and with uneven islands."""
        approach = self.separation / self.h  # a gap may close within the substep, but not more
        push = ANGLE / (self.h * A1) * self.separation
        bias = np.maximum(np.maximum(push, self.pushSpeed), approach)
        softness = np.maximum(approach > self.rounding, KEPT)
        self.measure(motion)
        self._sweep(bias, softness, self.most)
        self.measure(motion)
        self._go_on(motion, self.isUneven | self._sinking(motion), bias, softness, self.most)
        self.separation += self.h * self.speed[:POINTS]

    def relax(self, motion):
        """Removes the velocity added by the springs."""
        bias = np.maximum(self.separation, 0.0) / self.h
        self._sweep(bias)
        if self.isUneven.any():
            self.apply(motion)
            self._go_on(motion, self.isUneven, bias)
        self.total += self.impulse
        self.system.turn()

    def _sweep(self, bias, softness=None, most=None):
        before = self.impulse
        self.impulse = self.system.solved(before, self.speed, bias, softness, most)
        self.pending = self.impulse - before

    def _sinking(self, motion):
        """All manifolds (M,) of bodies of which a point sinks faster than `sinkSpeed`."""
        speed = np.maximum(self.separation, 0.0) / self.h + self.speed[:POINTS]
        isBody = np.zeros(len(motion.invMass), dtype=bool)
        isBody[self.ends[:, (speed < -self.sinkSpeed).any(axis=0)]] = True
        return (isBody & (motion.invMass > 0.0))[self.ends].any(axis=0)

    def _go_on(self, motion, isPart, *terms):
        """Goes on with the manifolds isPart (M,), once all impulses are applied, until their errors
        are within `tolerance`.
        """
        if not isPart.any():
            return
        part = PartRows(self.system, isPart, self.isPoint, motion, self.system.leastSlip)
        self.impulse = part.converged(motion, self.impulse, self.tolerance, *terms)
        self.system.applied[:, part.some] += part.applied
        self.speed = self.system.speeds(motion)

    def impact(self, motion, CRCoeff, distances):
        """Solves the blows of the step, and bounds the energy that it has added.

        Points are struck that closed faster than gravity makes them in a step. With the restitution
        e, the impulses of the step become (1 - e) P + e E, and the velocities likewise: P are
        plastic, so that struck bodies do not separate, and E elastic.
        """
        fall = np.abs(dot(self.normal[:, None], take(motion.gravity, self.ends, axis=1)))
        fall = self.timeStep * fall.max(axis=0)
        isPressed, isNear = self.total[:POINTS] > 0.0, self.separation < self.h * self.fallSpeed
        isStruck = isPressed & (self.closing < -np.maximum(fall, self.slow))
        if isStruck.any():
            # gaps count that the speed which gravity adds in a step would close in a substep
            isTouching = isPressed | (self.isPoint & isNear)
            before, total, isPart = motion.velocity.copy(), self.total, isStruck.any(axis=0)
            if CRCoeff < 1.0:
                self.total, isPart = self._plastic(motion, isStruck, isPressed, isTouching)
            if CRCoeff > 0.0:
                velocity, motion.velocity[:] = motion.velocity.copy(), before
                elastic = self._elastic(motion, total, isStruck, isTouching, CRCoeff)
                motion.velocity += (1.0 - CRCoeff) * (velocity - motion.velocity)
                self.total = self.total + CRCoeff * (elastic - self.total)
            # what blows add more across gravity than along it is no load, and would be repeated in
            # the next step; along it, heavy bodies that fall would press light ones into the ground
            isLevel = isPart & (2.0 * fall**2 <= self.fallSpeed**2)
            loads = self.carried * (self.h / self.timeStep), self.weight * (fall / self.fallSpeed)
            np.copyto(self.impulse, self._grown(*loads), where=isLevel)
            self.impulse[:POINTS][isStruck] *= 1.0 - CRCoeff  # what bounces carries nothing on
        some = indices(self.total.any(axis=0))
        smooth = self.normal * ~self.total[POINTS:].any(axis=0)
        given = take(self.ends, some, 1), take(smooth, some, 1), distances.columns, distances.rate
        share = bounded_share(motion, *given, distances.columns[:, distances.isInfeasible])
        self.total *= take(share, self.ends.min(axis=0))

    def _plastic(self, motion, isStruck, isPressed, isTouching):
        """Solves blows that do not bounce: no point of a struck body separates that was pressed.
        Returns the total impulses, and which manifolds (M,) take part. Masks are (4, M).

        All manifolds of struck bodies take part: others are what they are pressed against. Those
        count as struck, too, that the blow makes faster than gravity does in a substep. Points that
        were pressed and open without a blow keep what they have carried, as corners that a body
        rolls off.
        """
        inverse, speed = take(motion.invMass, self.ends), np.zeros(len(motion.invMass))
        blow = np.where(isStruck, -self.closing, 0.0).max(axis=0)
        change = inverse / np.add.reduce(inverse) * blow
        np.maximum.at(speed, self.ends.ravel(), change.ravel())
        mass = 1.0 / np.where(motion.invMass > 0.0, motion.invMass, np.inf)
        isPart, least = isTouching.any(axis=0), self.fallSpeeds * self.h / self.timeStep
        isHit = reached(speed > 0.0, speed, mass, self.ends[:, isPart], least)
        isPart &= isHit[self.ends].any(axis=0)
        bias = np.where(isPressed, 0.0, np.maximum(self.separation, 0.0) / self.h)
        isOpening = self.system.speeds(motion)[:POINTS] > self.rounding
        hasLeft = isPressed & isOpening & ~isStruck & (self.total[:POINTS] <= self.carried)
        isActive = self.isPoint & ~hasLeft
        solved = self._solved(motion, self.total, isPart & isActive.any(axis=0), bias, isActive)
        return solved, isPart

    def _elastic(self, motion, total, bounces, isTouching, CRCoeff):
        """Returns total impulses with which points separate as fast as they closed, then the points
        that this makes close, and so on, as in a row of balls.

        First, other manifolds of their islands lose the blows of the substeps. Points that still
        close after the last round bounce in the next step. Slow ones do not count, as only the part
        CRCoeff of all this reaches the bodies. Masks are (4, M).
        """
        load, carried = np.add.reduce(total[:POINTS]), np.add.reduce(self.carried)
        island = islands_of(self.ends, motion.invMass)
        isBlow = np.isin(island, island[bounces.any(axis=0)])
        isBlow &= load - carried > self.fallSpeed * np.add.reduce(self.system.mass)
        share = np.where(isBlow, np.minimum(carried / np.maximum(load, TINY), 1.0), 1.0)
        total = total * share
        self.system.push(motion, (share - 1.0) * self.system.applied)
        self.system.turn(-self.timeStep / self.h)  # to the arms with which points closed
        closing = self.closing
        # Restitution lets a motion last for about 1/(1 - e) bounces, and more exact sweeps bring
        # nothing. A bounce counts for three, since friction answers the normal impulses of a sweep
        # in the next one.
        sweeps = math.ceil(min(3.0 / max(1.0 - CRCoeff, TINY), MOST_SWEEPS))
        for _ in range(SWEEPS):
            speed = self.system.speeds(motion)[:POINTS]
            isActive = bounces | (isTouching & (np.abs(speed) <= self.slow))
            given = bounces.any(axis=0), np.where(bounces, closing, 0.0), isActive
            total = self._solved(motion, total, *given, sweeps)
            closing = self.system.speeds(motion)[:POINTS]
            isMet = self.isPoint & (self.separation < -self.timeStep * closing)
            bounces = isMet & (CRCoeff * closing < -self.fallSpeed) & isTouching.any(axis=0)
            if not bounces.any():
                break
        return total

    def _solved(self, motion, total, isPart, bias, isActive, sweeps=SWEEPS):
        """Solves manifolds, isPart (M,), for a bias (4, M); returns the total impulses (7, M).

        isActive : (4, M), points whose impulses may change
        """
        tolerance = TOLERANCE * np.maximum(-bias.min(initial=0.0), self.fallSpeed)
        part = PartRows(self.system, isPart, isActive, motion, np.zeros(self.count))
        return part.converged(motion, total, tolerance, bias, sweeps=sweeps)

    def store(self, manifolds, isStill):
        """Returns the manifolds with the values from which the next step starts. What is between
        bodies that have not moved, isStill (n + 1,), stays as it was.
        """
        kept = copy(manifolds)
        kept.impulse, kept.friction = kept.impulse.copy(), kept.friction.copy()
        some = indices(~(isStill[self.first] & isStill[self.second]))
        rows, values = self.rows[some], take(self.impulse, some, 1)
        kept.impulse[:, rows], kept.friction[:, rows] = values[:POINTS], values[POINTS:]
        return kept


class StillContacts:
    """Contacts between bodies that do not move, which are listed when somebody asks for them.

    Their impulses are those that acted last while one of the two was awake.
    """

    def __init__(self, step, manifolds):
        self._bodies, self._substeps = copy(step.bodies), step.substeps
        self._manifolds = manifolds

    @cached_property
    def columns(self):
        """The contacts, as `ContactColumns`."""
        self._bodies.update_rotations()
        manifolds, rows = self._manifolds, np.arange(len(self._manifolds.key))
        placed = PlacedManifolds(manifolds, Poses(self._bodies), rows)
        impulses = manifolds.impulse * placed.isPoint, manifolds.friction
        return placed.reported(self._substeps * np.concatenate(impulses))
