"""What a recording is good for: replaying it, resuming it, verifying it.

From the top: `Replay`, which stands in for a simulation; `resume` and `verify`; the settings.

Units: metres, kilograms, seconds.
"""

from dataclasses import replace

import numpy as np

from rbs.recordings.recording import QUOTE_LENGTH
from rbs.scenes.messages import one_line
from rbs.scenes.simulation import Simulation
from rbs.scenes.state import Scene
from rbs.softstep.step import SolverState
from rbs.stepping.bodies import StateError
from rbs.stepping.settings import CHOSEN


class Replay(Scene):
    """A recording in place of a simulation: has its attributes, and steps, but simulates nothing.

    Attributes: see `Scene`; the settings are those that the present step was made with. Of its own:
    recording; firstStep, lastStep; lastTime, of the last step, in s.

    What was added by hand is in `meshes` from its step on: they are another list then.
    """

    isReplay = True

    def __init__(self, recording):
        """Stands at the recording's first step; raises RecordingError or SceneError."""
        self.recording = recording
        simulation = recorded_scene(recording)
        self.source, self.scenePath = simulation.source, simulation.scenePath
        self.groundMesh, self.constraints = simulation.groundMesh, simulation.constraints
        self.firstStep, self.lastStep = recording.firstStep, recording.lastStep
        self.lastTime = recording.frame(self.lastStep)["times"]
        self._startFixed = [mesh.isFixed for mesh in simulation.meshes]
        for _, change in recording.changes:
            if change.kind == "add":
                redo(recording, change, simulation)
        self.meshes = self._allMeshes = simulation.meshes
        self._settings = {
            first: restored_settings(recording, first, simulation.settings)
            for first, _ in recording.settingsHistory
        }
        self.reset()

    def seek(self, step):
        """Puts the bodies to where they were after that step, or after the nearest recorded one."""
        step = min(max(int(step), self.firstStep), self.lastStep)
        frame = self.recording.frame(step)
        count = len(frame["positions"])
        if len(self.meshes) != count:
            self.meshes = self._allMeshes[:count]
        self._fix_bodies(step)
        self.set_state(frame)
        self.stepCount, self.time = step, frame["times"]
        self.settings = self._settings[self.recording.settings_at(step)[0]]

    def _fix_bodies(self, step):
        """Fixes and frees the bodies that this was done to, as they were after a step."""
        changes = self.recording.changes
        for body in {one.body: None for _, one in changes if one.kind == "fix"}:
            isFixed = self._startFixed[body] if body < len(self._startFixed) else False
            for when, one in changes:
                if one.kind == "fix" and one.body == body and when <= step:
                    isFixed = bool(one.numbers[0])
            if self._allMeshes[body].isFixed != isFixed:
                self._allMeshes[body].isFixed = isFixed

    def step(self):
        """One step on; at the end, it stays there."""
        if self.stepCount < self.lastStep:
            self.seek(self.stepCount + 1)

    def reset(self):
        """Back to the first step."""
        self.seek(self.firstStep)


def recorded_scene(recording):
    """The Simulation of a recording's scene, at the scene's start; raises RecordingError."""
    with recording.reading():
        return Simulation(recording.source)


def check_functions(recording, submitted):
    """Raises RecordingError unless a recording was made with these functions.

    submitted : `SubmittedSteps`, or None for this program's own functions
    """
    if recording.functions and submitted is None:
        raise recording.error(
            f"it was made with the functions in {recording.functionsFolder}, which --functions "
            "must name"
        )
    if submitted is not None and not recording.functions:
        raise recording.error("it was made without --functions")
    if submitted is not None and recording.functions != submitted.digest:
        raise recording.error(f"the functions in {submitted.folder} are not those that made it")


def resume(recording, step, simulation=None):
    """The Simulation of a recording, put to where a step has left it, to go on with the same bits.

    Its settings become those that the recording went on with; later changes are not followed. What
    the soft-step solver leaves to the next step is recorded every few steps: from the last of them,
    the steps up to this one are made again.
    raises RecordingError
    """
    simulation = simulation or recorded_scene(recording)
    check_functions(recording, simulation.submitted)
    frame, start = recording.frame(step), step
    settings = [fields for first, fields in recording.settingsHistory if first <= step]
    if any(fields.get("contactSolver") == "soft-step" for fields in settings):
        start, arrays = recording.solver_state(step)
        with recording.reading():
            simulation.solverState = SolverState.from_arrays(arrays)
    for k in range(recording.firstStep, start + 1):
        redo_changes(recording, k, simulation, withPushes=False)
    begin = recording.frame(start)
    simulation.set_state(begin)
    simulation.stepCount, simulation.time = start, begin["times"]
    for k in range(start + 1, step + 1):
        step_again(recording, k, simulation)
    if difference(simulation, frame):
        raise recording.error(f"step {step} cannot be resumed: {difference(simulation, frame)}")
    simulation.settings = restored_settings(
        recording, min(step + 1, recording.lastStep), simulation.settings
    )
    return simulation


def step_again(recording, step, simulation):
    """Makes a recorded step once more, with its settings and what was done by hand before it."""
    simulation.settings = restored_settings(recording, step, simulation.settings)
    redo_changes(recording, step, simulation)
    simulation.step()


def redo_changes(recording, step, simulation, withPushes=True):
    """Does to a simulation what was done by hand before a step; pushes are in the next state."""
    for change in recording.changes_before(step):
        if withPushes or change.kind != "push":
            redo(recording, change, simulation)


def redo(recording, change, simulation):
    """Does a `Change` once more; raises RecordingError where it cannot be done."""
    with recording.reading():
        simulation.change(change)


def verify(recording, advance=None):
    """Simulates a recording once more and compares the states, to the last bit.

    advance : called after every step
    returns what is wrong first, in a few words, or ""
    raises RecordingError when the recording cannot be read or its settings have no sense
    """
    simulation = recorded_scene(recording)
    first = recording.firstStep
    if first > 0:  # what came before was not recorded
        simulation = resume(recording, first, simulation)
    else:
        redo_changes(recording, first, simulation)
        simulation.settings = restored_settings(recording, first, simulation.settings)
    for step in range(first, recording.lastStep + 1):
        if step > first:
            try:
                step_again(recording, step, simulation)
            except StateError as error:
                return f"step {step} differs: {error}"
            if advance is not None:
                advance()
        if differs := difference(simulation, recording.frame(step)):
            return f"step {step} differs: {differs}"
    return ""


def difference(simulation, frame):
    """How a simulation's state differs most from a recorded one, in a few words; "" if in no bit.

    frame : as `Recording.frame` returns it
    """
    state = {**simulation.state(), "times": np.float64(simulation.time)}
    largest = {
        name: np.max(np.abs(values - frame[name]), initial=0.0)
        for name, values in state.items()
        if values.tobytes() != np.asarray(frame[name]).tobytes()
    }
    if not largest:
        return ""
    name = max(largest, key=largest.get)
    return f"{name} by up to {largest[name]:.3g}"


def restored_settings(recording, step, settings):
    """The settings that a recorded step was made with, as far as there are such settings today.

    settings : of the type that is wanted; has what the recording does not know
    raises RecordingError when the recording has a setting that is unknown or has no sense
    """
    _, fields = recording.settings_at(step)
    unknown = sorted(set(fields) - set(CHOSEN))
    if unknown:
        raise recording.error(
            "it has a setting that this version does not know: "
            f"{one_line(unknown[0], QUOTE_LENGTH)}"
        )
    try:
        return replace(settings, **fields)
    except ValueError as error:
        raise recording.error(f"step {step}: {one_line(error, QUOTE_LENGTH)}") from None
