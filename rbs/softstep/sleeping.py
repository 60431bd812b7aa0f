"""Sleeping: bodies that have come to rest are left out of a step until something disturbs them.

The rule is local: a body falls asleep when it and all that it touches, or is tied to, have been
slow for a while. Box2D and Bullet put whole islands to sleep instead; in a heap, where everything
hangs together, a few bodies that still roll would keep nearly all of it awake.

A sleeping body has no velocity, and holds what leans on it as a fixed one would. It wakes where
somebody has moved it or what it touches, where a contact that it had is gone, and where a body that
touches it is fast again; so waking spreads by one body a step.
"""

import numpy as np

from rbs.geometry.vectors import norm

# Seconds that bodies have to be slow for before they sleep.
SLEEP_SECONDS = 0.5
# A body is slow below this part of √(g r), r its radius: a hundredth of the speed that it gets by
# falling for half its radius.
SLOW = 0.01
# What starts to slide is slow for a while, too: nothing falls asleep that is faster than this part
# of what gravity would have added meanwhile. So a slope may be 0.2° too steep for friction, and
# what lies on it still falls asleep.
STARTING = 0.004


class Sleep:
    """Which of n bodies sleep, and for how long the others have been slow.

    isAsleep : (n,) bool; timer : (n,), seconds
    position, orientation, velocity : (3, n), (4, n), (6, n), as the last step has left them
    """

    COLUMNS = ("isAsleep", "timer", "position", "orientation", "velocity")

    def __init__(self, **columns):
        for name in self.COLUMNS:
            setattr(self, name, columns[name])

    @classmethod
    def of(cls, bodies, isAsleep, timer):
        """The `Sleep` of bodies as they are now."""
        return cls(
            isAsleep=isAsleep,
            timer=timer,
            position=bodies.position.copy(),
            orientation=bodies.orientation.copy(),
            velocity=bodies.velocity.copy(),
        )

    @classmethod
    def none(cls, bodies):
        """All are awake."""
        return cls.of(bodies, np.zeros(len(bodies.invMass), dtype=bool), 0.0 * bodies.invMass)

    def resized(self, bodies, stirred):
        """The `Sleep` of bodies some of which, at the end of the list, have come or gone.

        stirred : (K,), those that wake. The new ones count as moved: what they touch wakes.
        """
        columns = vars(Sleep.none(bodies))
        columns["velocity"] = np.full_like(columns["velocity"], np.nan)
        count = min(len(self.timer), len(columns["timer"]))
        for name in self.COLUMNS:
            columns[name][..., :count] = getattr(self, name)[..., :count]
        columns["isAsleep"][stirred], columns["timer"][stirred] = False, 0.0
        return Sleep(**columns)

    def disturbed(self, bodies):
        """Which bodies (n,) are not as the last step has left them."""
        return (
            (bodies.position != self.position).any(axis=0)
            | (bodies.orientation != self.orientation).any(axis=0)
            | (bodies.velocity != self.velocity).any(axis=0)
        )

    def woken(self, bodies, disturbed, links, lost):
        """`isAsleep` (n,) at the beginning of a step.

        disturbed : (n,); links : (2, L), bodies that touch or are tied, the ground being body n
        lost : (K,), those that did, and do no longer
        """
        if not self.isAsleep.any():
            return self.isAsleep
        wakes = np.append(disturbed | ~_are_slow(bodies), False)
        isStirred = wakes | _beside(wakes, links)
        isStirred[lost] = True
        return self.isAsleep & ~isStirred[:-1] & ~bodies.isFixed

    def settled(self, bodies, isAsleep, links, timeStep):
        """`(isAsleep, timer)` (n,) at the end of a step; arguments as for `woken`."""
        isStill = isAsleep | bodies.isFixed
        timer = np.where(isStill | _are_slow(bodies), self.timer + timeStep, 0.0)
        isStarting = speeds(bodies) > STARTING * bodies.fallRate * SLEEP_SECONDS
        isAwake = np.append(~isStill & (isStarting | (timer < SLEEP_SECONDS)), False)
        sleeps = ~(isAwake | _beside(isAwake, links))[:-1] & ~bodies.isFixed
        return isAsleep | sleeps, timer


def _are_slow(bodies):
    """Which bodies (n,) are slow."""
    return speeds(bodies) <= SLOW * np.sqrt(bodies.fallRate * bodies.hulls.radius)


def _beside(some, links):
    """Which bodies (n + 1,) are linked to one of some (n + 1,)."""
    first, second = links
    found = np.zeros_like(some)
    found[first[some[second]]] = True
    found[second[some[first]]] = True
    return found


def speeds(bodies):
    """How fast a point of each body (n,) moves at most: |v| + |ω| r."""
    return norm(bodies.linVelocity) + norm(bodies.angVelocity) * bodies.hulls.radius
