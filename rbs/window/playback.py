"""Playback: the number of steps per frame of the window, and the resulting pace.

Nothing here draws. Units: seconds.
"""

import math
import time
from collections import deque
from itertools import repeat

# Speeds relative to real time. The last makes as many steps as possible.
SPEEDS = (0.01, 0.02, 0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0, math.inf)
# Least and most seconds of stepping per frame, and between them as many as the frame takes to draw.
# After them the frame is drawn, so that a scene too slow for real time plays in slow motion and the
# window stays responsive. More make the window sluggish; fewer slow the scene down.
STEPPING_SECONDS, MOST_STEPPING_SECONDS = 0.02, 0.1
# Seconds of simulation that are caught up after a pause in drawing, such as while the window is
# dragged. With more, the scene leaps. A replay, whose steps take no time, catches up with more.
CATCH_UP_SECONDS, REPLAY_CATCH_UP_SECONDS = 0.25, 1.0
# Falls from the top of a scene, in seconds, outside which gravity looks too fast or too slow, and
# the fall that looks right.
SHORTEST_FALL, LONGEST_FALL, USUAL_FALL = 0.25, 5.0, 2.0
# Seconds over which the pace is averaged.
PACE_SECONDS = 1.0


def fitting_speed(fall):
    """Returns the one of SPEEDS at which gravity looks right.

    fall : seconds that a fall takes from the top of the scene to the ground
    """
    if SHORTEST_FALL <= fall <= LONGEST_FALL:
        return 1.0
    return min(SPEEDS[:-1], key=lambda speed: abs(math.log(max(fall, 1e-9) / (USUAL_FALL * speed))))


def speed_name(speed):
    """Returns one of SPEEDS as text."""
    return "unlimited" if speed == math.inf else f"{speed:g} ×"


class Playback:
    """Plays steps at a speed. Attributes: speed, one of SPEEDS; isBackwards, for recordings."""

    def __init__(self):
        self.speed, self.isBackwards = 1.0, False
        self.stop()

    def stop(self):
        """Clears the steps that are due, and the pace."""
        self._due = 0.0  # simulated seconds still to be played
        self._paces = deque()  # per frame: its seconds, and the simulated ones
        self._stepping = 0.0  # seconds that the steps of the last frame have taken

    def due(self, elapsed, timeStep, isReplay=False):
        """Returns the number of steps of timeStep that are due `elapsed` seconds after the last
        frame, at a speed that is not infinite.
        """
        catchUp = REPLAY_CATCH_UP_SECONDS if isReplay else CATCH_UP_SECONDS
        most = max(catchUp * max(self.speed, 1.0), timeStep)
        self._due = min(self._due + elapsed * self.speed, most)
        count = int(self._due / timeStep * (1.0 + 1e-12))
        self._due -= count * timeStep
        return count

    def advance(self, elapsed, timeStep, step):
        """Makes the steps that are due `elapsed` seconds after the last frame.

        step : function that makes one step of timeStep and returns whether to continue
        """
        begin = time.perf_counter()
        drawing = elapsed - self._stepping
        most = min(max(STEPPING_SECONDS, drawing), MOST_STEPPING_SECONDS)
        isUnlimited, self._stepping = self.speed == math.inf, 0.0
        for _ in repeat(0) if isUnlimited else range(self.due(elapsed, timeStep)):
            goesOn = step()
            self._stepping = time.perf_counter() - begin
            if not goesOn or self._stepping >= most:
                break

    def note(self, elapsed, simulated):
        """Adds a frame of `elapsed` seconds, with its simulated seconds, to the pace."""
        self._paces.append((elapsed, simulated))
        while sum(wall for wall, _ in self._paces) - self._paces[0][0] > PACE_SECONDS:
            self._paces.popleft()

    def pace(self):
        """Returns simulated seconds per second over the last frames, or None without frames."""
        wall = sum(elapsed for elapsed, _ in self._paces)
        return sum(simulated for _, simulated in self._paces) / wall if wall > 0.0 else None
