"""Playback: how many steps a frame of the window makes, and the pace that comes of it.

Nothing here draws. Units: seconds.
"""

import math
import time
from collections import deque

# Times real time. The last one makes as many steps as there is time for.
SPEEDS = (0.1, 0.25, 1.0, 4.0, math.inf)
# A frame makes the steps that are due, so that a scene plays at its true speed however fast it is
# drawn, but goes on to draw after this many seconds of stepping: a window that is slower than the
# scene plays in slow motion, and still answers to its buttons.
STEPPING_SECONDS = 0.02
# What is due after a pause in drawing, while the window is dragged for instance, is forgotten but
# for this many seconds, so that the scene does not leap.
CATCH_UP_SECONDS = 0.1
# Over how long the pace is measured.
PACE_SECONDS = 1.0


def speed_name(speed):
    """What a person calls one of SPEEDS."""
    return "as fast as possible" if speed == math.inf else f"{speed:g} ×"


class Playback:
    """Plays steps at a speed. Attributes: speed, one of SPEEDS; isBackwards, of a recording."""

    def __init__(self):
        self.speed = 1.0
        self.isBackwards = False
        self.stop()

    def stop(self):
        """Forgets what is due, and the pace: playing is over."""
        self._due = 0.0  # seconds of simulation that playing has fallen behind by
        self._paces = deque()  # of each frame: its seconds, and those simulated in it

    def advance(self, elapsed, timeStep, step):
        """Makes the steps that are due `elapsed` seconds after the last frame.

        step : a function that makes one of timeStep, and returns whether it goes on
        """
        begin = time.perf_counter()
        if self.speed == math.inf:
            while step() and time.perf_counter() - begin < STEPPING_SECONDS:
                pass
            return
        most = max(CATCH_UP_SECONDS * max(self.speed, 1.0), timeStep)
        self._due = min(self._due + elapsed * self.speed, most)
        while self._due >= timeStep:
            self._due -= timeStep
            if not step():
                break
            if time.perf_counter() - begin > STEPPING_SECONDS:
                self._due = 0.0

    def note(self, elapsed, simulated):
        """Keeps what a frame of `elapsed` seconds has simulated, for the pace."""
        self._paces.append((elapsed, simulated))
        while sum(wall for wall, _ in self._paces) - self._paces[0][0] > PACE_SECONDS:
            self._paces.popleft()

    def pace(self):
        """Seconds simulated in a second, over the last frames; None before there are any."""
        wall = sum(elapsed for elapsed, _ in self._paces)
        return sum(simulated for _, simulated in self._paces) / wall if wall > 0.0 else None
