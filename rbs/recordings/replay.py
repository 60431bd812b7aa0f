"""Replaying, resuming and verifying recordings.

From the top: `Replay`, used in place of a simulation; `resume` and `verify`; recorded settings.

Units: metres, kilograms, seconds.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import groupby
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from rbs.recordings.recording import Recording, RecordingError, row_at
from rbs.scenes.messages import InputError
from rbs.scenes.scene import Scene
from rbs.scenes.simulation import SceneSimulation
from rbs.scenes.state import State, differing_bits, make_change
from rbs.softstep.step import SolverState
from rbs.stepping.meshes import StateError
from rbs.stepping.reports import Contact
from rbs.stepping.settings import Settings

if TYPE_CHECKING:
    from typing import Self  # since Python 3.11

# Settings that no longer exist, with the value that old recordings may give them.
GONE = (("closingOnly", False),)


class RecordedSettings(Settings):
    """Settings of a recorded step, which cannot be changed."""

    def __setattr__(self, name, value):
        if name in vars(self):
            self.change(name, value)
        super().__setattr__(name, value)

    def change(self, name: str, value: Any) -> None:
        """Raises ValueError: a recording is read-only."""
        raise ValueError(f"{name} cannot be changed, because a recording is read-only; resume it")

    def __eq__(self, other):
        return isinstance(other, Settings) and vars(self) == vars(other)


class Replay(Scene):
    """A recording with the interface of a simulation.

    Attributes, besides those of `Scene`: recording; firstStep, lastStep. Settings, bodies and
    constraints are those of the present step: where bodies were added or removed by hand, `meshes`
    becomes a new list.
    """

    isEditable = False
    recording: Recording
    firstStep: int
    lastStep: int

    def __init__(self, recording: Recording, submitted: Any = None) -> None:
        """Starts at the first recorded step. Raises RecordingError or SceneError."""
        with recording.reading():
            super().__init__(recording.source, *recording.source.make())
        self.recording, self.submitted = recording, submitted
        self.firstStep, self.lastStep = recording.firstStep, recording.lastStep
        self._settings = {
            first: RecordedSettings(**vars(restored_settings(recording, first)))
            for first, _ in recording.settingsHistory
        }
        self.settings = self._settings[self.firstStep]
        # of each step before which something was changed by hand: (step, State without arrays)
        self._states, self._state = [(self.firstStep, self._without_arrays())], None
        changes = (item for item in recording.changes if not item[1].isInState)
        with recording.reading():
            for step, some in groupby(changes, itemgetter(0)):
                for _, change in some:
                    make_change(self, change)
                self._states.append((step, self._without_arrays()))
        vars(self)["again"] = None  # SceneSimulation that makes steps again
        self.reset()

    def restore(self, state: State) -> None:
        """Goes to the step of a `State` of this recording."""
        self._own_meshes(state)  # checks it
        self.seek(state.stepCount)

    def _without_arrays(self):
        state = super().state()
        state.clear()  # the recording has the arrays
        state.settings = None
        return state

    def seek(self, step: int) -> None:
        """Puts the bodies into their state after a step, or after the nearest recorded one."""
        step = min(max(int(step), self.firstStep), self.lastStep)
        if step != self.stepCount:
            self.report = None
        frame = self.recording.frame(step)
        _, state = row_at(self._states, step)
        if state is not self._state:
            self._restore(state)
            self._state = state
        self.set_state(frame)
        self.stepCount, self.time = step, frame["times"]
        self.settings = self._settings[self.recording.settings_at(step)[0]]

    def contacts(self) -> list[Contact]:
        """Returns the list of `Contact` of the present step, which is made again for it.

        It is empty at the first recorded step. Raises InputError if the step cannot be made again.
        """
        find_report(self)
        if self.reportError:
            raise InputError(self.reportError)
        return self.report.contacts if self.report else []

    def advance(self, observer: Callable | None = None) -> None:
        """Moves to the next step, if there is one. The observer is not called."""
        if self.stepCount < self.lastStep:
            self.seek(self.stepCount + 1)

    def reset(self) -> None:
        """Goes back to the first step."""
        self.seek(self.firstStep)

    def close(self) -> None:
        """Closes the recording's file, after which only the present step can be used."""
        self.recording.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def find_report(run, observer=None):
    """Makes the present step of a replay again, as recordings hold no reports; sets `report`.

    A simulation has it already.

    observer : see `run_timestep`; the step is made again for it in any case

    After a call for the step before, this makes one step. Otherwise, with the soft-step solver,
    it makes all steps since that solver's state was last recorded.
    """
    isKnown = run.isEditable or (run.report is not None and observer is None)
    if isKnown or run.reportError or run.stepCount == run.firstStep:
        return
    try:
        if run.again is None or run.again.stepCount != run.stepCount - 1:
            run.again = resume(run.recording, run.stepCount - 1, run.again, replay=run)
        if gap := step_again(run.recording, run.again, observer):
            raise run.recording.error(f"step {run.stepCount} differs: {gap}")
    except (RecordingError, StateError) as error:
        run.reportError = str(error)
    else:
        run.report = run.again.report


def check_functions(recording, submitted):
    """Raises RecordingError unless a recording was made with these functions.

    submitted : `SubmittedSteps`, or None for this project's functions
    """
    if recording.functions != ("" if submitted is None else submitted.digest):
        told = "without --functions"
        if recording.functions:
            told = f"with the functions in {recording.functionsFolder}, as they were then"
        remedy = "" if submitted else "; name that folder with --functions"
        raise recording.error(f"it was made {told}{remedy}")


def resume(recording, step, simulation=None, *, submitted=None, replay=None):
    """Returns a SceneSimulation that continues a recording after a step, with the same bits.

    The settings are those of the next recorded step; later changes are ignored. The state of the
    soft-step solver is recorded only every few steps, so the steps since the last one are repeated.
    simulation : of this recording's scene; loaded if None
    submitted : `SubmittedSteps` of a simulation that is loaded
    replay : of this recording, if there is one

    Raises RecordingError if the step is not recorded, or cannot be restored bit for bit.
    """
    replay = replay or Replay(recording, submitted)
    simulation = simulation or SceneSimulation(recording.source, submitted=replay.submitted)
    check_functions(recording, simulation.submitted)
    recording.frame(step)  # which may be missing
    start, arrays, here = step, None, replay.stepCount
    settings = [fields for first, fields in recording.settingsHistory if first <= step]
    if any(fields.get("contactSolver") == "soft-step" for fields in settings):
        start, arrays = recording.solver_state(step)
    replay.seek(start)
    simulation.restore(replay.state())
    replay.seek(here)
    failure = f"step {step} cannot be resumed: "
    if arrays is not None:
        try:
            simulation.solverState = SolverState.from_arrays(arrays)
        except Exception:  # from NumPy, about arrays that lack or have another shape
            told = "its solver state has another form"
            raise recording.error(failure + told + recording.origin()) from None
    while simulation.stepCount < step:
        step_again(recording, simulation)
    if gap := difference(recording, step, simulation):
        raise recording.error(failure + gap)
    simulation.settings = restored_settings(recording, min(step + 1, recording.lastStep))
    return simulation


def prepare(recording, step, simulation):
    """Repeats what was done by hand before a step: settings, and changes of bodies."""
    simulation.settings = restored_settings(recording, step)
    for change in recording.changes_before(step):
        with recording.reading():
            make_change(simulation, change)


def step_again(recording, simulation, observer=None):
    """Makes the next recorded step; returns its difference from the recorded one, or ""."""
    prepare(recording, simulation.stepCount + 1, simulation)
    simulation.step(observer)
    return difference(recording, simulation.stepCount, simulation)


def verify(recording, advance=None, submitted=None):
    """Simulates a recording again, and compares the states bit for bit.

    advance : function, called after every step
    submitted : `SubmittedSteps` that make the steps, or None

    Returns the first difference, in a few words, or "". Raises RecordingError if the recording
    cannot be read, was not made with these functions, or its settings are invalid.
    """
    check_functions(recording, submitted)
    with recording.reading():
        simulation = SceneSimulation(recording.source, submitted=submitted)
    first = recording.firstStep
    if first > 0:  # the steps before were not recorded
        simulation = resume(recording, first, simulation)
    else:
        prepare(recording, first, simulation)
    gap, step = difference(recording, first, simulation), first
    while not gap and step < recording.lastStep:
        step += 1
        try:
            gap = step_again(recording, simulation)
        except StateError as error:
            gap = f"{error}{recording.origin()}"
        if advance is not None:
            advance()
    return gap and f"step {step} differs: {gap}"


def difference(recording, step, simulation):
    """Returns the largest difference of a simulation's state from a recorded one, or ""."""
    state, frame, largest = simulation.state(), recording.frame(step), {}
    for name, values in {**state, "times": simulation.time}.items():
        isOther = differing_bits(values, frame[name])
        if isOther.any():
            largest[name] = np.max(np.abs(values - frame[name]))
    if not largest:
        return ""
    name = max(largest, key=largest.get)
    return f"{name} by up to {largest[name]:.3g}{recording.origin()}"


def restored_settings(recording, step):
    """Returns the settings of a recorded step. Raises RecordingError if they are invalid."""
    _, fields = recording.settings_at(step)
    try:
        return Settings(**{name: one for name, one in fields.items() if (name, one) not in GONE})
    except (TypeError, ValueError) as error:
        raise recording.error(f"step {step}: {error}") from None
