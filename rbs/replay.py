"""What a recording is good for: replaying it, resuming it, verifying it.

From the top: `Replay`, which stands in for a simulation; `resume` and `verify`, which need one;
whether bodies and settings fit.

Units: metres, kilograms, seconds.
"""

from dataclasses import asdict, replace

import numpy as np

from rbs.bodies import StateError
from rbs.messages import one_line
from rbs.recordingfiles import QUOTE_LENGTH
from rbs.solverstate import SolverState
from rbs.state import STATE_NAMES, Scene, hash_of

# A setting that recordings of version 0.1.0 have. Its one value that is left is what is done now;
# with the other, pairs were resolved in rounds of a graph colouring.
PAIR_ORDER, PRESENT_ORDER = "pairOrder", "sequential"


class Replay(Scene):
    """A recording in place of a simulation: has its attributes, and steps, but simulates nothing.

    Attributes, as a simulation's: meshes, groundMesh, constraints, settings (those that the present
    step was made with), scenePath, constraintPath, stepCount, time; report and stepSeconds, always
    None. Of its own: recording; firstStep, lastStep; lastTime, of the last step, in s.

    What was added by hand is in `meshes` from its step on: they are another list then.
    """

    report = None
    stepSeconds = None

    def __init__(self, recording, simulation):
        """Stands at the recording's first step.

        simulation : of the recorded scene; its meshes are moved from now on
        raises RecordingError when the bodies or the settings do not fit
        """
        self.recording = recording
        self.scenePath, self.constraintPath = simulation.scenePath, simulation.constraintPath
        self.meshes, self.groundMesh = simulation.meshes, simulation.groundMesh
        self.constraints = simulation.constraints
        check_bodies(recording, simulation)
        self.firstStep, self.lastStep = recording.firstStep, recording.lastStep
        self.lastTime = float(recording.frame(self.lastStep)["times"])
        self._startFixed = {
            change.body: simulation.meshes[change.body].isFixed
            for _, change in recording.changes
            if change.kind == "fix" and change.body < len(simulation.meshes)
        }
        for _, change in recording.changes:
            if change.kind == "add":
                redo(recording, change, simulation)
        self._allMeshes = simulation.meshes
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
        self.stepCount = step
        self.time = float(frame["times"])
        self.settings = self._settings[self.recording.settings_at(step)[0]]

    def _fix_bodies(self, step):
        """Fixes and frees the bodies that this was done to, as they were after a step."""
        isFixed = dict(self._startFixed)
        for when, change in self.recording.changes:
            if when <= step and change.kind == "fix":
                isFixed[change.body] = bool(change.numbers[0])
            elif when <= step and change.kind == "add":
                isFixed.setdefault(change.body, False)
        for body, isSo in isFixed.items():
            if self.meshes[body].isFixed != isSo:
                self.meshes[body].isFixed = isSo

    def step(self):
        """One step on; at the end, it stays there."""
        if self.stepCount < self.lastStep:
            self.seek(self.stepCount + 1)

    def reset(self):
        """Back to the first step."""
        self.seek(self.firstStep)


def resume(recording, step, simulation):
    """Puts a simulation to where a recorded step has left it, to go on with the same bits.

    Its settings become those that the recording went on with; later changes are not followed. What
    the soft-step solver leaves to the next step is recorded at the beginning and at the end only:
    to go on in between, the steps before are made again.
    raises RecordingError
    """
    check_pair_order(recording)
    first = recording.firstStep
    isRemembering = any(
        fields.get("contactSolver") == "soft-step" for _, fields in recording.settingsHistory
    )
    solver = recording.solver_arrays(step)
    if isRemembering and step > first and not solver:
        resume(recording, first, simulation)
        for k in range(first + 1, step + 1):
            simulation.settings = restored_settings(recording, k, simulation.settings)
            redo_changes(recording, k, simulation)
            simulation.step()
        if not np.array_equal(hash_of(simulation.state()), recording.frame(step)["hashes"]):
            raise recording.error(
                f"step {step} cannot be resumed: the steps before it do not lead there any more"
            )
    else:
        for k in range(first, step + 1):
            redo_changes(recording, k, simulation, withPushes=False)
    frame = recording.frame(step)
    if not np.array_equal(hash_of(frame), frame["hashes"]):
        raise recording.error(f"step {step} is damaged: its state does not match its hash")
    simulation.settings = restored_settings(
        recording, min(step + 1, recording.lastStep), simulation.settings
    )
    simulation.set_state(frame)
    if solver or step == first:
        try:
            simulation.solverState = SolverState.from_arrays(solver)
        except (KeyError, ValueError, TypeError):
            raise recording.error("its solver state cannot be read") from None
    simulation.stepCount, simulation.time = step, float(frame["times"])


def redo_changes(recording, step, simulation, withPushes=True):
    """Does to a simulation what was done by hand before a step; pushes are in the next state."""
    for change in recording.changes_before(step):
        if withPushes or change.kind != "push":
            redo(recording, change, simulation)


def redo(recording, change, simulation):
    """Does a `Change` once more; raises RecordingError where it cannot be done."""
    try:
        simulation.change(change)
    except ValueError as error:
        raise recording.error(f"the changes by hand cannot be made: {error}") from None


def verify(recording, simulation, advance=None):
    """Simulates a recording once more and compares the states, to the last bit.

    simulation : of the recorded scene, at its start; advance : called after every step
    returns what is wrong first, in a few words, or ""
    raises RecordingError when the recording cannot be read or its settings have no sense
    """
    check_pair_order(recording)
    for begin, block in recording.blocks([*STATE_NAMES, "hashes"]):
        for row, expected in enumerate(block["hashes"]):
            count = recording.body_count(begin + row)
            state = {name: block[name][row][:count] for name in STATE_NAMES}
            if not np.array_equal(hash_of(state), expected):
                return f"step {begin + row} is damaged: its state does not match its hash"
    damage = recording.damage()
    if damage:
        return damage
    first = recording.firstStep
    if first > 0:  # what came before was not recorded
        resume(recording, first, simulation)
    else:
        redo_changes(recording, first, simulation)
    for begin, block in recording.blocks(["hashes", "times"]):
        for step, (expected, when) in enumerate(
            zip(block["hashes"], block["times"], strict=True), start=begin
        ):
            simulation.settings = restored_settings(recording, step, simulation.settings)
            if step > first:
                redo_changes(recording, step, simulation)
                try:
                    simulation.step()
                except StateError as error:
                    return f"step {step} differs: {error}"
                if advance is not None:
                    advance()
            state = simulation.state()
            if not np.array_equal(hash_of(state), expected):
                return f"step {step} differs: {_difference(state, recording.frame(step))}"
            if simulation.time != when:
                return f"step {step} differs: its time is {simulation.time!r} s, not {when} s"
    return ""


def _difference(state, other):
    """Which array differs most, and by how much."""
    differences = {name: np.max(np.abs(state[name] - other[name])) for name in STATE_NAMES}
    name = max(differences, key=differences.get)
    return f"{name} by up to {differences[name]:.3g}"


def check_bodies(recording, simulation):
    """Raises RecordingError unless the simulation's scene has the bodies of the recording."""
    names = [mesh.name for mesh in simulation.meshes]
    scene = simulation.scenePath
    theirNames = recording.meshNames[: recording.body_count(recording.firstStep - 1)]
    if len(names) != len(theirNames):
        raise recording.error(f"it has {len(theirNames)} bodies, but {scene} has {len(names)}")
    for ours, theirs in zip(names, theirNames, strict=True):
        if ours != theirs:
            theirs = one_line(theirs, QUOTE_LENGTH)
            raise recording.error(f"its body '{theirs}' is called '{ours}' in {scene}")


def check_pair_order(recording):
    """Raises RecordingError where a step resolved its pairs in an order that there is no more."""
    for step, fields in recording.settingsHistory:
        order = fields.get(PAIR_ORDER, PRESENT_ORDER)
        if order != PRESENT_ORDER:
            raise recording.error(
                f"step {step}: it was recorded with another version, whose pair order "
                f"'{one_line(order, QUOTE_LENGTH)}' has been taken out: it can be replayed only"
            )


def restored_settings(recording, step, settings):
    """The settings that a recorded step was made with, as far as there are such settings today.

    settings : of the type that is wanted; has what the recording does not know
    raises RecordingError when the recording has a setting that is unknown or has no sense
    """
    _, fields = recording.settings_at(step)
    fields = {name: value for name, value in fields.items() if name != PAIR_ORDER}
    unknown = sorted(set(fields) - set(asdict(settings)))
    if unknown:
        raise recording.error(
            "it has a setting that this version does not know: "
            f"{one_line(unknown[0], QUOTE_LENGTH)}"
        )
    try:
        return replace(settings, **fields)
    except ValueError as error:
        raise recording.error(f"step {step}: {one_line(error, QUOTE_LENGTH)}") from None
    except (TypeError, OverflowError):  # a list where a number belongs, for instance
        raise recording.error(f"step {step}: its settings are not of the right kind") from None
