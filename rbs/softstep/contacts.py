"""Contact impulses of the soft step: springs, relaxation, and blows, on `ContactRows`."""

import math
from copy import copy
from functools import cached_property

import numpy as np

from rbs.geometry.vectors import dot, indices, take
from rbs.softstep.detection import KEEP, Frames
from rbs.softstep.energies import bounded_share
from rbs.softstep.manifolds import POINTS, ROUNDING, TINY, UNEVEN
from rbs.softstep.placed import PlacedManifolds
from rbs.softstep.rows import (
    MOST_SWEEPS,
    SWEEPS,
    TOLERANCE,
    Sliders,
    contact_rows,
    islands_of,
    reached,
    split_masses,
)
from rbs.softstep.springs import Spring

# Natural frequency of contact springs, as a fraction of the substep frequency. A higher one makes
# stacks bounce, because the impulses of one sweep per substep lag behind: with 0.2, a stack of
# ten boxes never comes to rest. A lower one is visibly soft.
FREQUENCY = 0.165
# Damping ratio of contact springs. With more, penetration is pushed out more slowly, and a tower
# takes longer to come to rest; with less, down to critical, heavy bodies sink through light ones
# below them.
DAMPING = 6.0
# Seconds for which bodies must be slow before they fall asleep. More keeps piles awake for longer.
# Less stops slow motions: with a single step, bodies fall asleep as they begin to slide, and where
# they are added. In this time, overlapping bodies without weight are pushed apart by their radius.
SLEEP_SECONDS = 0.5
# Largest growth of an impulse from one warm start to the next, as a factor. With more, the impulse
# of an impact is repeated in the next substep and throws bodies apart; less delays a new load.
LOAD_GROWTH = 2.0
# Largest load to which springs yield where bodies of UNEVEN masses touch, in weights of the
# effective mass; of others, more by the square of how much more even their masses are. With more,
# heavy bodies sink into light ones; with less, they push them about.
MOST_LOAD = 20.0


class SoftContacts(PlacedManifolds):
    """Impulses of a step on the `ContactRows` of the manifolds that have a movable body.

    impulse, total : (7, M), in the last substep, and in all of them; separation : (4, M)
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
        size, radius = frames.sizes(self.first, self.second)
        # no faster than the smaller one falls by half its radius
        self.pushSpeed = -np.maximum(np.sqrt(motion.fallRate * radius), radius / SLEEP_SECONDS)
        impulse = np.concatenate((manifolds.impulse, manifolds.friction))[:, self.rows]
        impulse[:POINTS] *= self.isPoint
        self.impulse, self.separation = ratio * impulse, self.gap.copy()
        # What sleeps takes part in the soft step's springs as if it were awake, but is not lighter
        # than what touches it. Otherwise, springs on it would be stiffer, and jam what is between.
        inverse = np.concatenate((bodies.invMass[None], bodies.invInertia))
        inverse[:, motion.moving] = motion.inverse[:, :-1]
        masses = take(split_masses(ends, inverse), self.rows, 2)
        most = masses[0, ::-1] / np.maximum(masses[0], TINY)
        masses *= np.where(motion.invMass[self.ends] == 0.0, np.minimum(most, 1.0), 1.0)
        self.system = contact_rows(self, self.ends, masses, frames, motion, mu)
        self.system.turn(0.5 * h)  # arms are those in the middle of the next substep
        self.speed = self.system.speeds(motion)
        self.rounding = ROUNDING * np.abs(self.speed).max(initial=0.0)
        # that gravity adds in a step, in m/s
        self.fallSpeed = max(motion.fallRate * self.timeStep, self.rounding)
        self.slow = max(TOLERANCE * self.fallSpeed, self.rounding)
        self.spring = Spring(FREQUENCY, DAMPING, h)
        self.started = self.impulse[:POINTS]
        # in a step as in the last substep
        self.carried = self.started * (self.timeStep / h)
        self.weight = self.system.mass * (motion.fallRate * h)
        self.pending, self.total = np.zeros((2, 7, self.count))
        self.isSlider = self._may_slide()
        self.sliders = self._sliders(self.system, self.isSlider)
        # impulses of substeps of another length are a wrong start, which one sweep would leave
        self.isUneven = self._uneven(motion.invMass) | (ratio > 1.0)
        self.sweeps = SWEEPS if ratio <= 1.0 else MOST_SWEEPS
        self.sinkSpeed = KEEP * size / h
        # error at which sweeps over what one has left unsolved end, in m/s
        self.tolerance = np.where(self.isUneven, TOLERANCE * self.fallSpeed, self.sinkSpeed)
        # without gravity, nothing is a load
        load = np.full(self.weight.shape, 1.0 / TINY)
        if motion.fallRate > 0.0:
            load = self._most_loads(motion.invMass) * self.weight
        self.most = (1.0 - self.spring.softness) * load

    def _uneven(self, invMass):
        """Whether manifolds (M,) are in islands in which bodies of UNEVEN masses touch."""
        low, high = np.sort(take(invMass, self.ends), axis=0)
        isUneven = (low > 0.0) & (high > UNEVEN * low)
        if isUneven.any():
            island = islands_of(self.ends, invMass)
            isUneven = np.isin(island, island[isUneven])
        return isUneven

    def _may_slide(self):
        """Whether manifolds (M,) may touch, and slip by more than gravity adds, in the step."""
        x, y, spin = self.speed[POINTS:]
        isFast = x * x + y * y + self.system.gyration * (spin * spin) > self.fallSpeed**2
        isNear = self.separation < self.timeStep * (self.fallSpeed - self.speed[:POINTS])
        isNear = (isNear & self.isPoint).any(axis=0)
        return isFast & isNear & (self.fallSpeed > 0.0) & self.system.limits[1].any(axis=0)

    def _sliders(self, system, isSlider):
        least = max(TOLERANCE * self.fallSpeed * self.h / self.timeStep, self.rounding, TINY)
        return Sliders(system, isSlider, least)

    def _most_loads(self, invMass):
        """Largest load (M,) to which the springs of each manifold yield, see MOST_LOAD.

        What rests on a light body presses it on its supports, too: counts the heaviest of those
        that touch either body.
        """
        inverse = take(invMass, self.ends)
        isMovable = inverse > 0.0
        heavier = np.where(isMovable, inverse, np.inf).min(axis=0)
        heaviest = np.full(len(invMass), np.inf)
        for end in self.ends:
            np.minimum.at(heaviest, end, heavier)
        heaviest = np.where(isMovable, take(heaviest, self.ends), np.inf).min(axis=0)
        lightest = np.where(isMovable, inverse, 0.0).max(axis=0)
        return MOST_LOAD * np.maximum(UNEVEN * heaviest / lightest, 1.0) ** 2

    def impact_speeds(self, motion):
        """Normal speeds (4, M) at which points meet after free flight has closed their gaps s.

        u² = u₀² - 2 a s, with the relative acceleration a along the normal.
        """
        speed = self.speed[:POINTS]
        gravity = motion.gravity[:, self.ends[1]] - motion.gravity[:, self.ends[0]]
        gain = -2.0 * dot(self.normal, gravity) * np.maximum(self.separation, 0.0)
        return -np.sqrt(np.maximum(speed * speed + gain, 0.0)) * (speed < 0.0)

    def measure(self, motion):
        """Computes the speeds (7, M) of the rows, with all impulses applied."""
        self.apply(motion)
        self.speed = self.system.speeds(motion)

    def apply(self, motion):
        """Applies the impulses accumulated since the last call to the bodies."""
        self.system.apply(motion, self.pending)
        self.pending = np.zeros_like(self.pending)

    def warm_start(self):
        """Starts with the impulses of the last substep, limited by LOAD_GROWTH."""
        self.impulse = self._grown(self.started)
        self.started = self.impulse[:POINTS]
        self.pending = self.pending + self.impulse

    def _grown(self, before):
        """Impulses (7, M), if those at the points were (4, M) before, limited by LOAD_GROWTH."""
        normal, friction = self.impulse[:POINTS], self.impulse[POINTS:]
        grown = np.minimum(normal, np.maximum(LOAD_GROWTH * before, self.weight))
        grown[:, self.isUneven] = normal[:, self.isUneven]
        share = np.add.reduce(grown) / np.maximum(np.add.reduce(normal), TINY)
        return np.concatenate((grown, friction * share))

    def soft_sweep(self, motion):
        """Pushes penetration out. Returns what one sweep leaves unsolved, see `_unsolved`."""
        approach = self.separation / self.h  # a gap may close within the substep, but not more
        wanted, s = self.spring.rate * self.separation, self.spring.softness
        bias = np.maximum(np.maximum(wanted, self.pushSpeed), approach)
        # the push is limited, but not the load s/(1 - s) m β C that it holds
        excess = np.maximum(wanted / self.pushSpeed, 1.0)
        softness = excess / (excess + (1.0 - s) / s)
        softness[approach > self.rounding] = 1.0  # a gap
        self.measure(motion)
        self._sweep(bias, softness, self.most)
        self.measure(motion)
        unsolved = self._unsolved(motion)
        self._converge(motion, unsolved, bias, softness, self.most)
        self.separation += self.h * self.speed[:POINTS]
        return unsolved

    def relax(self, motion, unsolved):
        """Removes the velocity added by the springs; unsolved : from `soft_sweep`"""
        bias = np.maximum(self.separation, 0.0) / self.h
        self._sweep(bias)
        self._converge(motion, unsolved, bias)
        self.total += self.impulse
        self.system.turn(self.h)

    def _sweep(self, bias, softness=None, most=None):
        before = self.impulse
        given = bias, softness, most, self.sliders
        self.impulse = self.system.solved(before, self.speed, *given)
        self.pending = self.impulse - before

    def _unsolved(self, motion):
        """`(manifolds (K,), their `ContactRows`, and `Sliders`)` that one sweep leaves unsolved.

        Those of uneven islands, and all of bodies with a point that would still sink by KEEP.
        """
        sinking = np.maximum(self.separation, 0.0) / self.h + self.speed[:POINTS] < -self.sinkSpeed
        isSinking = np.zeros(len(motion.invMass), dtype=bool)
        isSinking[self.ends[:, (sinking & self.isPoint).any(axis=0)]] = True
        isSinking &= motion.invMass > 0.0
        some = indices(self.isUneven | isSinking[self.ends].any(axis=0))
        if len(some) == 0:
            return some, None, None
        part = self.system.of(some, take(self.isPoint, some, 1), motion)
        return some, part, self._sliders(part, self.isSlider[some])

    def _converge(self, motion, unsolved, *terms):
        """Goes on with what is unsolved until its errors are within `tolerance`."""
        some, part, sliders = unsolved
        if len(some):
            self.apply(motion)
            given = (take(x, some, -1) for x in (self.impulse, self.tolerance, *terms))
            part.applied[:] = 0.0
            found = part.converged(motion, *given, sliders=sliders, sweeps=self.sweeps)
            self.impulse[:, some] = found
            self.system.applied[:, some] += part.applied
            self.measure(motion)

    def impact(self, motion, CRCoeff, closing, distances):
        """Solves the blows of the step, and bounds the energy that it has added.

        closing : (4, M), from `impact_speeds`; distances : `SoftConstraints`

        Points are struck that closed faster than gravity makes them in a step. With the restitution
        e, the impulses of the step become (1 - e) P + e E, and the velocities likewise: P are
        plastic, so that struck bodies do not separate, and E elastic.
        """
        fall = np.abs(dot(self.normal[:, None], take(motion.gravity, self.ends, axis=1)))
        fall = self.timeStep * fall.max(axis=0)
        isStruck = (closing < -np.maximum(fall, self.slow)) & (self.total[:POINTS] > 0.0)
        if isStruck.any():
            before = motion.velocity.copy()
            plastic = self._plastic(motion, isStruck, closing) if CRCoeff < 1.0 else self.total
            velocity = motion.velocity.copy()
            if CRCoeff > 0.0:
                motion.velocity[:] = before
                elastic = self._elastic(motion, isStruck, closing, CRCoeff)
                motion.velocity += (1.0 - CRCoeff) * (velocity - motion.velocity)
                plastic = plastic + CRCoeff * (elastic - plastic)
            self.total = plastic
            # a hard blow more across gravity than along it is no load, and would be repeated in the
            # next step; along it, heavy bodies that fall would press light ones into the ground
            isHard = (isStruck & (closing < -self.fallSpeed)).any(axis=0)
            some = indices(isHard & (2.0 * fall**2 <= self.fallSpeed**2))
            begun = self._grown(self.carried * (self.h / self.timeStep))
            self.impulse[:, some] = take(begun, some, 1)
            self.impulse[:POINTS][isStruck] *= 1.0 - CRCoeff  # what bounces carries nothing on
        isPressed = (self.total[:POINTS] > 0.0).any(axis=0)
        some, smooth = indices(isPressed), self.normal * ~self.total[POINTS:].any(axis=0)
        given = take(self.ends, some, 1), take(smooth, some, 1), distances.columns
        share = bounded_share(motion, *given, *distances.strained())
        self.total *= take(share, self.ends.min(axis=0))

    def _plastic(self, motion, isStruck, closing):
        """Returns total impulses with which no point of a struck body separates that was pressed.

        All manifolds of struck bodies take part: others are what they are pressed against. Points
        that open without a blow keep what they have carried, as corners that a body rolls off.
        """
        isPressed = self.total[:POINTS] > 0.0
        speed, blow = np.zeros(len(motion.invMass)), np.where(isStruck, -closing, 0.0).max(axis=0)
        inverse = take(motion.invMass, self.ends)
        for end, change in zip(self.ends, inverse / np.add.reduce(inverse) * blow, strict=True):
            np.maximum.at(speed, end, change)
        mass = 1.0 / np.where(motion.invMass > 0.0, motion.invMass, np.inf)
        touching = take(self.ends, indices(isPressed.any(axis=0)), 1)
        isHit = reached(speed > 0.0, speed, mass, touching, self.slow)
        some = indices(isHit[self.ends].any(axis=0) & isPressed.any(axis=0))
        bias = np.where(isPressed, 0.0, np.maximum(self.separation, 0.0) / self.h)
        isOpening = self.system.speeds(motion)[:POINTS] > self.rounding
        hasLeft = isOpening & ~isStruck & (self.total[:POINTS] <= self.carried)
        return self._solved(motion, some, bias, self.isPoint & ~hasLeft)

    def _elastic(self, motion, bounces, closing, CRCoeff):
        """Returns total impulses with which points separate as fast as they closed, then the points
        that this makes close, and so on, as in a row of balls.

        First, other manifolds of their islands lose the blows of the substeps. Points that still
        close after the last round bounce in the next step. Slow ones do not count, as only the part
        CRCoeff of all this reaches the bodies.
        """
        load, carried = np.add.reduce(self.total[:POINTS]), np.add.reduce(self.carried)
        isTouching = (self.total[:POINTS] > 0.0) | (self.isPoint & (self.separation <= 0.0))
        isPressed = self.isPoint & isTouching.any(axis=0)
        blow = load - carried
        island = islands_of(self.ends, motion.invMass)
        isBlow = np.isin(island, island[bounces.any(axis=0)])
        isBlow &= blow > self.fallSpeed * np.add.reduce(self.system.mass)
        share = np.where(isBlow, np.minimum(carried / np.maximum(load, TINY), 1.0), 1.0)
        total = self.total * share
        self.system.withdraw(motion, 1.0 - share)
        self.system.turn(-self.timeStep)  # to the arms with which points closed
        # Restitution lets a motion last for about 1/(1 - e) bounces, and more exact sweeps bring
        # nothing. A bounce counts for three, since friction answers the normal impulses of a sweep
        # in the next one.
        sweeps = math.ceil(min(3.0 / max(1.0 - CRCoeff, TINY), MOST_SWEEPS))
        for _ in range(SWEEPS):
            some = indices(bounces.any(axis=0))
            speed = self.system.speeds(motion)[:POINTS]
            isActive = bounces | (isTouching & (np.abs(speed) <= self.slow))
            self.total = total
            bias = np.where(bounces, closing, 0.0)
            total = self._solved(motion, some, bias, isActive, sweeps)
            closing = self.system.speeds(motion)[:POINTS]
            isMet = isPressed & (self.separation < -self.timeStep * closing)
            bounces = isMet & (CRCoeff * closing < -self.fallSpeed)
            if not bounces.any():
                break
        return total

    def _solved(self, motion, some, bias, isActive, sweeps=SWEEPS):
        """Solves manifolds `some` (K,) for a bias (4, M); returns the total impulses.

        isActive : (4, M), points whose impulses may change; sweeps : at most so many
        """
        system = self.system.of(some, take(isActive, some, 1), motion)
        bias, total = take(bias, some, 1), self.total.copy()
        tolerance = TOLERANCE * max(-bias.min(initial=0.0), self.fallSpeed)
        given = take(self.total, some, 1), tolerance, bias
        total[:, some] = system.converged(motion, *given, sweeps=sweeps)
        return total

    def store(self, manifolds, isStill):
        """Returns the manifolds with the values from which the next step starts.

        isStill : (n + 1,), bodies that have not moved; what is between them stays as it was
        """
        impulse, friction = manifolds.impulse.copy(), manifolds.friction.copy()
        some = indices(~(isStill[self.first] & isStill[self.second]))
        values = np.split(take(self.impulse, some, 1), [POINTS])
        impulse[:, self.rows[some]], friction[:, self.rows[some]] = values
        return manifolds.renewed(impulse=impulse, friction=friction)


class StillContacts:
    """Contacts between bodies that do not move, which are listed when somebody asks for them.

    Their impulses are those that acted last while one of the two was awake.
    """

    def __init__(self, step, manifolds):
        self._bodies, self._manifolds = copy(step.bodies), manifolds
        self._substeps = step.substeps

    @cached_property
    def columns(self):
        """The contacts, as for `StepReport.add_columns`."""
        self._bodies.update_rotations()
        rows = np.arange(len(self._manifolds.key))
        placed = PlacedManifolds(self._manifolds, Frames(self._bodies), rows)
        impulses = self._manifolds.impulse * placed.isPoint, self._manifolds.friction
        return placed.reported(self._substeps * np.concatenate(impulses))

    @property
    def depths(self):
        return self.columns[3]
