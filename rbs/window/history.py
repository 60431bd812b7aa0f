"""Time in the window: the pace of playing, and the moments that can be gone back to."""

import math
import time
from functools import cached_property
from itertools import repeat
from operator import attrgetter, is_, itemgetter

import numpy as np

from rbs.recordings.outputs import step_quantities
from rbs.recordings.replay import find_report, resume
from rbs.scenes.state import STATE_WIDTH, State, arrays_of, differing_bits
from rbs.stepping.meshes import StateError

# Speeds relative to real time. The last makes as many steps as possible.
SPEEDS = (0.01, 0.02, 0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0, math.inf)
# Seconds of stepping after which a frame is drawn, so that a scene too slow for real time plays in
# slow motion. More make the window sluggish; fewer slow the scene down.
STEPPING_SECONDS = 0.04
# Seconds of simulation that are caught up after a pause in drawing, such as while the window is
# dragged. With more, the scene leaps.
CATCH_UP_SECONDS = 0.25
# Seconds over which the speed that is reached is averaged.
MEASURED_SECONDS = 1.0
# Bytes of all moments that are kept, of one besides its numbers, and of each body's part of a
# solver's state: 40 s of 1000 bodies, an hour of 15.
KEPT_BYTES, MOMENT_BYTES, SOLVER_BYTES = 500_000_000, 1000, 1500
# Latest moments that keep the step's report and the solver's state; older ones keep the latter
# every SOLVER_STEPS. More take memory, fewer repeat more steps to go on from an older moment.
WHOLE_MOMENTS, SOLVER_STEPS = 20, 20
# Seconds in a frame for the quantities of moments.
MEASURING_SECONDS = 0.04
# Steps of free fall that change a velocity as much as a jump does, at least.
JUMP = 5
# m/s: a change that is no jump but rounding.
LEAST_JUMP = 1e-6


class Playback:
    """Plays steps at a speed. Attributes: speed, one of SPEEDS; reached, the speed in fact."""

    def __init__(self):
        self.speed = 1.0
        self.stop()

    def stop(self):
        """Clears the steps that are due."""
        self._due = 0.0  # simulated seconds still to be played
        self.reached, self._seconds, self._played = None, 0.0, 0.0

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
        self._seconds += elapsed
        for _ in repeat(0) if isUnlimited else range(self.due(elapsed, timeStep)):
            isOn = step()
            self._played += timeStep
            if not isOn or time.perf_counter() >= end:
                break
        if self._seconds >= MEASURED_SECONDS:
            self.reached = self._played / self._seconds
            self._seconds = self._played = 0.0


class Moment:
    """A moment of a run that is kept.

    rows : (n, 13), positions, orientations, velocities; scene : a `State` with the rest, shared by
        moments between which nothing else has changed; stepCount; time in s
    isStep : whether a step led here from the moment before, and not something done by hand
    report : of the last step, or None; error : why it cannot be found; deepest : its penetration
    solver : its state, or None if it was left out; quantities : for plots, once they are known
    """

    quantities, error, deepest = None, "", math.nan

    def __init__(self, run, before=None, isStep=False, start=None):
        """before : the moment before, or None

        start : `State` from which the step began, if a body was pulled before it, or None
        """
        state, self.isStep, self._start = run.state(), isStep, start
        self.rows, rest = state.rows[:, :STATE_WIDTH].copy(), state.rows[:, STATE_WIDTH:].copy()
        self.stepCount, self.time, self.report = state.stepCount, state.time, state.report
        self.solver, self.beside = state.solver, state.beside
        if self.report is not None:
            self.deepest = self.report.deepest
        state.clear()
        state.rows, state.report, state.solver, state.beside = rest, None, None, None
        self.scene = before.scene if before is not None and is_same(before.scene, state) else state

    @property
    def size(self):
        """Bytes that it takes, roughly."""
        ofSolver = SOLVER_BYTES / SOLVER_STEPS * (self.scene.settings.contactSolver != "impulse")
        return MOMENT_BYTES + len(self.rows) * (8 * STATE_WIDTH + ofSolver)

    def thin(self):
        """Leaves out what making the step again brings back."""
        if self.isStep:
            self.report = None
            if self.solver and self.solver.count is not None and self.stepCount % SOLVER_STEPS:
                self.solver = None

    def enter(self, run):
        """Takes the run here."""
        rows = np.hstack([self.rows, self.scene.rows])
        state = State(arrays_of(rows))
        own = {"stepCount": self.stepCount, "time": self.time, "report": self.report}
        vars(state).update(vars(self.scene) | own | {"rows": rows})
        state.solver, state.beside = self.solver, self.beside
        run.restore(state)

    def begin(self, run, before):
        """Takes the run to where the step began that led here from the moment before."""
        before.enter(run)
        if self._start is not None:
            run.set_state(self._start)

    def remake(self, run, before, observer=None):
        """Makes the step that led here again, from the moment before."""
        self.begin(run, before)
        run.advance(observer)
        now = run.state()
        if now.is_like(State(arrays_of(self.rows))):  # functions of a student may be others now
            self.report, self.solver = now.report, now.solver
        else:
            self.error = "This step cannot be made again: it now leads to another state."


def is_same(one, other):
    """Whether two `State`s agree in what steps do not change."""
    lists = "meshes", "restVertices"
    pairs = [(getattr(one, name), getattr(other, name)) for name in lists]
    return (
        all(len(some) == len(others) and all(map(is_, some, others)) for some, others in pairs)
        and (one.names, one.constraints) == (other.names, other.constraints)
        and one.settings == other.settings
        and not differing_bits(one.rows, other.rows).any()
    )


class RecordedMoment(Moment):
    """A moment of a recording, which is read from the file once somebody asks for it."""

    report = solver = beside = _start = None  # what was done by hand is in the file

    def __init__(self, replay, step):
        self._replay, self.stepCount, self.isStep = replay, step, step > replay.firstStep

    @cached_property
    def _read(self):
        replay, here, report = self._replay, self._replay.stepCount, self._replay.report
        replay.seek(self.stepCount)
        moment = Moment(replay)
        replay.seek(here)
        replay.report = report
        return moment

    rows, scene, time = (property(attrgetter(f"_read.{one}")) for one in ("rows", "scene", "time"))

    def enter(self, run):
        """Takes the run here, which may be the replay itself."""
        if run is self._replay:
            run.seek(self.stepCount)
            run.report = self.report
        else:
            super().enter(run)

    def remake(self, run, before, observer=None):
        """Makes the step that led here again."""
        replay = self._replay
        replay.seek(self.stepCount)
        find_report(replay, observer)
        self.report, self.error = replay.report, replay.reportError
        if run is not replay:
            step = replay.recording, self.stepCount
            self.solver = resume(*step, submitted=replay.submitted).solverState


class History:
    """What was done to a run: a moment after each step, change by hand and setting.

    axis : list of moments, in order of time; place : index of the present one

    Something new in the past begins another axis, and so does a start over. Undoing it brings back
    the axis that was left, with all that was ahead.
    """

    def __init__(self, run, earlier=()):
        """run : SceneSimulation or Replay; earlier : moments, the present one among them"""
        self._run, self.axis, self._topic, self._isCold = run, list(earlier), None, False
        self.axis = self.axis or [Moment(run)]
        self.place = self.place_of(run.stepCount)
        # rows (axis, place, first own place of the axis after it) of axes that were left, and of
        # those to which redo leads, with the row that undo has taken
        self._left, self._undone = [], []

    @property
    def now(self):
        """The present moment."""
        return self.axis[self.place]

    @property
    def isAhead(self):
        """Whether there is something to go forward to."""
        return self.place < len(self.axis) - 1

    @property
    def gap(self):
        """The steps before and after those that are no longer kept, or None."""
        ends = [moment.stepCount for moment in self.axis[:2]]
        return ends if ends[-1] - ends[0] > 1 else None

    def place_of(self, step):
        """Returns the last place after a step, or after the nearest one that is kept."""
        places = reversed(range(len(self.axis)))
        return min(places, key=lambda place: abs(self.axis[place].stepCount - step))

    def add(self, topic=None, isStep=False, start=None, startsOver=False):
        """Adds the present moment after something new: a step, or something done by hand.

        topic : of changes that count as one while nothing else is done, as of a slider
        start : see `Moment`; startsOver : whether this is another start, and not a continuation
        """
        before = self.now
        if topic is not None and topic == self._topic and not self.isAhead:
            self.axis.pop()
        elif startsOver or self.isAhead:
            first = 0 if startsOver else self.place + 1
            self._left.append((self.axis, self.place, first))
            self.axis = self.axis[:first]
        self.axis.append(Moment(self._run, before, isStep, start))
        self.place, self._topic, self._isCold = len(self.axis) - 1, topic, False
        self._undone.clear()
        self._thin()

    def _thin(self):
        """Keeps within KEPT_BYTES: axes that were left go first, then moments after the start."""
        if self.place > WHOLE_MOMENTS:
            self.axis[self.place - WHOLE_MOMENTS].thin()
        most = max(KEPT_BYTES // self.now.size, 2 * WHOLE_MOMENTS)
        while self._left and most < len(self.axis) + sum(
            len(axis) - first for axis, _, first in self._left
        ):
            del self._left[0]
        # until a step can be made from what follows the gap
        while len(self.axis) > most or self.gap and self.axis[1].solver is None:
            del self.axis[1]
            self.place -= 1

    def go(self, place):
        """Goes to a moment of the axis."""
        self.place, self._topic = place, None
        self.now.enter(self._run)
        self._isCold = self.now.solver is None

    def undo(self):
        """Goes back to the moment before the present one. Returns whether there is one."""
        if self._left and self.place == self._left[-1][2]:
            self._undone.append((self._left.pop(), self.axis, self.place))
            self.axis, place, _ = self._undone[-1][0]
        else:
            place = self.place - 1
        if place >= 0:
            self.go(place)
        return place >= 0

    def redo(self):
        """Goes forward to what was undone, or else along the axis. Returns whether it could."""
        place, isAhead = self.place + 1, self.isAhead
        if self._undone and self._undone[-1][0][:2] == (self.axis, self.place):
            left, self.axis, place = self._undone.pop()
            self._left.append(left)
            isAhead = True
        if isAhead:
            self.go(place)
        return isAhead

    def jump_of(self, body):
        """Returns the place of the last step that changed a body's velocity by much more than
        gravity does, or by the most; None if none did.
        """
        changes = [(LEAST_JUMP, None)]
        for place in range(self.place, 0, -1):
            before, moment = self.axis[place - 1 : place + 1]
            if body >= min(len(before.rows), len(moment.rows)):
                break
            settings, isFree = moment.scene.settings, moment.scene.rows[body, 0] > 0.0
            fall = settings.timeStep * np.array(settings.acceleration)
            change = moment.rows[body, 7:10] - before.rows[body, 7:10] - isFree * fall
            size = float(np.linalg.norm(change)) * moment.isStep
            if size > JUMP * np.linalg.norm(fall) > 0.0:
                return place
            changes.append((size, place))
        return max(changes, key=itemgetter(0))[1]

    def measure(self, places):
        """Finds the `step_quantities` of moments that lack them, as far as there is time."""
        end = time.perf_counter() + MEASURING_SECONDS
        unknown = [self.axis[place] for place in places if self.axis[place].quantities is None]
        for moment in unknown:
            moment.enter(self._run)
            moment.quantities = step_quantities(self._run) | {"deepestPenetration": moment.deepest}
            if time.perf_counter() > end:
                break
        if unknown:
            self.now.enter(self._run)

    def make_whole(self):
        """Brings back the solver's state if it was left out, so that a step can be made."""
        if self._isCold:
            self._remake(self.place)
            self.go(self.place)

    def remake(self, observer=None):
        """Makes the last step again, if the bodies are as it left them, for its report.

        observer : see `run_timestep`. Returns "", or why this is impossible
        """
        steps = range(self.place, -1, -1)
        place = next((k for k in steps if self.axis[k].isStep), self.place)
        moment = self.axis[place]
        if not moment.isStep:
            return "This is the first step."
        if place != self.place and not np.array_equal(moment.rows, self.now.rows):
            return "Bodies were changed by hand since the last step: undo that, or make a step."
        try:
            self._remake(place, observer)
        except (StateError, ValueError) as error:
            moment.error = str(error)
        self.go(self.place)
        return moment.error

    def _remake(self, place, observer=None):
        moment, before = self.axis[place], self.axis[place - 1]
        if before.solver is None and not isinstance(moment, RecordedMoment):
            self._remake(place - 1)
        moment.remake(self._run, before, observer)
