"""Time in the window: the pace of playing, and the moments that can be gone back to."""

import math
import time
from itertools import repeat

from rbs.scenes.scene import Writer

# Speeds relative to real time. The last makes as many steps as possible.
SPEEDS = (0.01, 0.02, 0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0, math.inf)
# Seconds of stepping after which a frame is drawn, so that a scene too slow for real time plays in
# slow motion. More make the window sluggish; fewer slow the scene down.
STEPPING_SECONDS = 0.04
# Seconds of simulation that are caught up after a pause in drawing, such as while the window is
# dragged. With more, the scene leaps.
CATCH_UP_SECONDS = 0.25
# Moments that are kept to go back to: their number, and the number of bodies in all of them, which
# limits their memory to about 200 MB.
MOST_STATES, MOST_KEPT_BODIES = 500, 100_000


class Playback:
    """Plays steps at a speed. Attribute: speed, one of SPEEDS."""

    def __init__(self):
        self.speed = 1.0
        self.stop()

    def stop(self):
        """Clears the steps that are due."""
        self._due = 0.0  # simulated seconds still to be played

    def due(self, elapsed, timeStep):
        """Returns the number of steps of timeStep that are due `elapsed` seconds after the last
        frame, at a speed that is not infinite.
        """
        most = max(CATCH_UP_SECONDS * max(self.speed, 1.0), timeStep)
        self._due = min(self._due + elapsed * self.speed, most)
        count = int(self._due / timeStep * (1.0 + 1e-12))
        self._due -= count * timeStep
        return count

    def advance(self, elapsed, timeStep, step):
        """Makes the steps that are due `elapsed` seconds after the last frame.

        step : function that makes one step of timeStep and returns whether to continue
        """
        end, isUnlimited = time.perf_counter() + STEPPING_SECONDS, self.speed == math.inf
        for _ in repeat(0) if isUnlimited else range(self.due(elapsed, timeStep)):
            if not step() or time.perf_counter() >= end:
                break


class History(Writer):
    """What was done to a simulation: its State before each step, change by hand and setting.

    states, place : the States, and the index of the present one, or their number as long as the
        present is newer than all
    """

    def __init__(self, simulation):
        self._simulation, self.states, self.place = simulation, [], 0
        self._topic = None

    def keep(self, topic=None):
        """Keeps the present before something new, which takes the place of what was ahead.

        topic : of changes that count as one while nothing else is done, as of a slider
        """
        if topic is None or topic != self._topic or self.isAhead:
            self.states[self.place :] = [self._simulation.state()]
            most = min(MOST_STATES, 1 + MOST_KEPT_BODIES // max(len(self._simulation.meshes), 1))
            del self.states[1 : 1 + max(len(self.states) - most, 0)]  # the start is always kept
            self.place = len(self.states)
        self._topic = topic

    def forget(self):
        """Forgets the State kept last, because what was to follow has failed."""
        self.place -= 1
        del self.states[-1]

    @property
    def isAhead(self):
        """Whether there is something to go forward to."""
        return self.place < len(self.states) - 1

    @property
    def last(self):
        """The last place to which `go` can go."""
        return max(self.place, len(self.states) - 1)

    def go(self, place):
        """Goes to a State, by its index."""
        if self.place == len(self.states):
            self.states.append(self._simulation.state())
        self.place, self._topic = place, None
        self._simulation.restore(self.states[place])

    def place_of(self, step):
        """Returns the last place at which the simulation was after a step, or None."""
        if step == self._simulation.stepCount:
            return self.place
        places = [k for k, state in enumerate(self.states) if state.stepCount == step]
        return max(places, key=lambda k: (k < self.place, k), default=None)

    def ends(self):
        """Returns the numbers of the first and of the last step that can be gone to."""
        steps = [state.stepCount for state in self.states] + [self._simulation.stepCount]
        return min(steps), max(steps)
