"""Recordings: `Recording` reads one, `Recorder` writes one, `finish` repairs an interrupted one.

From the top: reading; writing, in chunks while a scene is simulated; making one file of chunks.
Nothing here loads a scene.

Units: metres, kilograms, seconds.
"""

import json
import math
import os
import shutil
import tempfile
import time
from bisect import bisect_right
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from rbs import __version__
from rbs.changes import body_count, initial_changes, pack_changes, unpack_changes
from rbs.files import PARTIAL_ENDING, lock_folder, named_errors
from rbs.files import unfinished_path as partial_path
from rbs.interrupts import noted, raise_if_more
from rbs.messages import shown_path
from rbs.outputs import copy_to_stream, find_target, keep_folder, release
from rbs.recordingfiles import (
    FORMAT,
    FORMAT_WITH_CHANGES,
    SERIES,
    RecordingError,
    RecordingFile,
    write_recording_file,
)
from rbs.state import STATE_NAMES, hash_of

# What the files begin with in the folder FILE.npz.part/ that a recording grows in.
CHUNK_PREFIX = "chunk_"
# Bytes that are looked at together, here and wherever a file is walked through.
BLOCK_BYTES = 4 << 20
# How far the length of a recorded quaternion may be from 1. Rounding makes about 1e-16 a step.
UNIT_TOLERANCE = 1e-3
# Before the names of the solver state's arrays, at the first state and at the last one.
SOLVER_PREFIX, END_SOLVER_PREFIX = "solver.", "solverAtEnd."
# What added bodies are, and what has been done by hand: the beginnings of the arrays' names.
CHANGE_PREFIXES = ("changes", "changeNumbers", "added.")
# What the file is called while the chunks are joined.
JOINED_NAME = "whole.tmp"
# What a crash may cost: the states since the last chunk, a second's worth, or a hundredth of the
# run where that is more. So a run of a day leaves hundreds of files, not a hundred thousand.
CHUNK_SECONDS = 1.0
CHUNK_SHARE = 0.01
# Seconds for which a signal does not break off the joining of the chunks: nearly all are joined
# sooner, and who has a longer one may want to leave it to `--finish`.
JOIN_PATIENCE = 1.0


class Recording:
    """A recording that is read, state by state; it is never in memory as a whole.

    Attributes: path, of the file, or of the folder that an interrupted recording has left;
    wasInterrupted, whether it is the latter; firstStep, lastStep; scene, constraints, paths as
    recorded ("" for none); contentHashes, a simulation's, of what these and the meshes held, or
    None in an older recording; meshNames, list of str; files, a RecordingFile of each chunk;
    settingsHistory, list of (step, dict), the fields of the settings that the steps from that one
    on were made with; changes, list of (step, Change), what was done by hand before a step, or
    before the recording began; version, numpyVersion.

    Where FILE.npz does not exist and FILE.npz.part/ does, that is what is read.
    """

    def __init__(self, path, mustBeFinite=True):
        """Reads everything but the states; raises RecordingError.

        mustBeFinite : whether to look through the states for numbers that are not finite, and
            for orientations that are none
        """
        self.path = Path(path)
        # Beside the file that a link points at, since that is what is written.
        partialPath = Path(str(os.path.realpath(path) if self.path.is_symlink() else path)
                           + PARTIAL_ENDING)  # fmt: skip
        if not self.path.exists() and partialPath.is_dir():
            self.path = partialPath
        self.wasInterrupted = self.path.is_dir()
        if not self.path.exists():
            raise self.error("there is no such file")
        paths = [self.path]
        if self.wasInterrupted:
            paths = sorted(self.path.glob(f"{CHUNK_PREFIX}*.npz"))
            if not paths:
                raise self.error("this is a folder, not a recording")
        self.files = [RecordingFile(chunk) for chunk in paths]
        self._read_heads()
        if mustBeFinite:
            self._check_states()

    def error(self, cause):
        """The RecordingError about this recording. To be raised by the caller."""
        return RecordingError(self.path, cause)

    def _read_heads(self):
        """Everything but the states; the chunks must follow each other."""
        heads = [_Head(file) for file in self.files]
        first, last = heads[0], heads[-1]
        self.firstStep = expected = first.firstStep
        names, self.changes = [], []
        for head in heads:
            before = body_count(head.changes, len(head.meshNames), head.firstStep - 1)
            names = names or head.meshNames[:before]
            if head.firstStep != expected or head.meshNames[:before] != names:
                raise head.file.error(f"the states from step {expected} on are missing before it")
            names = head.meshNames
            self.changes += head.changes
            expected += head.count
        self.lastStep = expected - 1
        self._firstSteps = [head.firstStep for head in heads]
        self.meshNames = names
        self.scene, self.constraints = first.scene, first.constraints
        self.contentHashes = first.contentHashes
        self.version, self.numpyVersion = first.version, first.numpyVersion
        # A chunk's history goes back to the start of the recording.
        self.settingsHistory = last.settingsHistory
        if self.settingsHistory[0][0] != self.firstStep:
            raise last.file.error("the history of its settings does not start with its first step")

    def _check_states(self):
        for begin, block in self.blocks(["times", *STATE_NAMES]):
            for name, rows in block.items():
                isFinite = np.isfinite(rows).reshape(len(rows), -1).all(axis=1)
                if not isFinite.all():
                    step = begin + int(np.argmin(isFinite))
                    raise self.error(f"step {step}: {name} holds numbers that are not finite")
            with np.errstate(over="ignore"):
                lengths = np.linalg.norm(block["orientations"], axis=2)
            isUnit = (np.abs(lengths - 1.0) <= UNIT_TOLERANCE).all(axis=1)
            if not isUnit.all():
                step = begin + int(np.argmin(isUnit))
                raise self.error(f"step {step}: orientations holds a quaternion not of length 1")

    def body_count(self, step):
        """How many bodies there are after a step: the first ones of `meshNames`."""
        return body_count(self.changes, len(self.meshNames), step)

    def changes_before(self, step):
        """What was done by hand before a step was made; of the first one, before it all began."""
        return [change for when, change in self.changes if when == step]

    def blocks(self, names):
        """Walks through some arrays: yields (step of the first row, dict of arrays).

        They have rows for bodies that are added later, and none for those of later chunks.
        """
        for file, first in zip(self.files, self._firstSteps, strict=True):
            members = [file.member(name) for name in names]
            count = members[0].shape[0]
            rowBytes = sum(math.prod(m.shape[1:]) * m.dtype.itemsize for m in members)
            atOnce = max(1, BLOCK_BYTES // rowBytes)
            for begin in range(0, count, atOnce):
                end = min(begin + atOnce, count)
                yield first + begin, file.rows(names, begin, end)

    def frame(self, step):
        """Everything recorded of a step: a dict of the state's arrays, times () and hashes (16,).

        raises ValueError unless firstStep ≤ step ≤ lastStep
        """
        if not self.firstStep <= step <= self.lastStep:
            raise self.error(
                f"step {step} is not in it, only steps {self.firstStep} to {self.lastStep} are"
            )
        chunk = bisect_right(self._firstSteps, step) - 1
        row = step - self._firstSteps[chunk]
        rows = self.files[chunk].rows(SERIES, row, row + 1)
        count = self.body_count(step)
        return {
            name: values[0][:count] if name in STATE_NAMES else values[0]
            for name, values in rows.items()
        }

    def hashes(self, step, count):
        """The hashes (count, 16) of the states from a step on."""
        return np.array([self.frame(k)["hashes"] for k in range(step, step + count)])

    def solver_arrays(self, step):
        """What the soft-step solver had left at a step, as a dict; {} where that is not known.

        It is known of the first and of the last step.
        """
        ends = (self.lastStep, self.files[-1], END_SOLVER_PREFIX), (
            self.firstStep, self.files[0], SOLVER_PREFIX
        )  # fmt: skip
        for end, file, prefix in ends:
            names = [name for name in file.names() if step == end and name.startswith(prefix)]
            if names:
                return {name.removeprefix(prefix): file.read_array(name, "uifb") for name in names}
        return {}

    def settings_at(self, step):
        """What a step was made with: (the first step made so, dict of the settings' fields)."""
        steps = [first for first, _ in self.settingsHistory]
        return self.settingsHistory[max(0, bisect_right(steps, step) - 1)]

    def head(self):
        """What it holds beside the states at its end, as arrays: dict, in the order of the file."""
        first, last = self.files[0], self.files[-1]
        names = [name for name in last.names() if name not in SERIES]
        names = [name for name in names if not name.startswith(CHANGE_PREFIXES)]
        head = {name: last.read_array(name, "Uifb") for name in names}
        head |= {"firstStep": first.read_array("firstStep", "i")}
        return head | _head_of_changes(self.changes)

    def damage(self):
        """What is wrong with its files as such, in a few words, or "": checksums, bookkeeping."""
        return next(filter(None, (file.damage() for file in self.files)), "")


class _Head:
    """What one file of a recording holds beside the states, checked."""

    def __init__(self, file):
        self.file = file
        self.firstStep = self._integer("firstStep")
        if self._integer("format") not in (FORMAT, FORMAT_WITH_CHANGES):
            raise file.error("it was written by a newer version of this program")
        self.scene, self.constraints, self.version, self.numpyVersion = (
            self._text(name) for name in ("scene", "constraints", "version", "numpyVersion")
        )
        names = file.read_array("meshNames", "U")
        self.meshNames = names.tolist()
        self.count = file.member("times").shape[0] if file.member("times").shape else 0
        if names.ndim != 1 or len(names) == 0 or self.count == 0:
            raise file.error("there is no state in it")
        for name, (dtype, row) in SERIES.items():
            bodies = (len(names),) if name in STATE_NAMES else ()
            member, shape = file.member(name), (self.count, *bodies, *row)
            if member.dtype != np.dtype(dtype) or member.shape != shape:
                raise file.error(
                    f"the array {name} is of the shape {member.shape} and the type {member.dtype}, "
                    f"not of {shape} and {np.dtype(dtype)}"
                )
        self.changes = self._changes()
        self.settingsHistory = self._history()
        self.contentHashes = self._hashes() if "contentHashes" in file.names() else None

    def _changes(self):
        names = [name for name in self.file.names() if name.startswith(CHANGE_PREFIXES)]
        arrays = {name: self.file.read_array(name, "if") for name in names}
        last = self.firstStep + self.count - 1
        try:
            return unpack_changes(arrays, self.meshNames, self.firstStep, last)
        except ValueError as error:
            raise self.file.error(f"the changes by hand cannot be read: {error}") from None

    def _hashes(self):
        try:
            hashes = json.loads(self._text("contentHashes"))
            texts = [hashes["scene"], hashes["constraints"], *hashes["meshes"].values()]
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            texts = [None]
        if not all(isinstance(text, str) for text in texts):
            raise self.file.error("the hashes of its scene's files cannot be read")
        return hashes

    def _integer(self, name):
        value = self.file.read_array(name, "i")
        if value.shape != () or value < 0:
            raise self.file.error(f"the array {name} is not a whole number")
        return int(value)

    def _text(self, name):
        value = self.file.read_array(name, "U")
        if value.shape != ():
            raise self.file.error(f"the array {name} is not one text")
        return str(value)

    def _history(self):
        try:
            history = [
                (int(step), {str(name): value for name, value in fields.items()})
                for step, fields in json.loads(self._text("settingsHistory"))
            ]
        except (ValueError, TypeError, AttributeError, OverflowError, RecursionError):
            history = []
        steps = [step for step, _ in history]
        if not steps or steps != sorted(set(steps)):
            raise self.file.error("the history of its settings cannot be read")
        return history


class Recorder:
    """Writes the states of a simulation into a file, as they come.

    They go to FILE.npz.part/ in chunks, each of them a recording by itself, written beside its
    place, brought to the disk and renamed: whatever ends the program, the chunks are whole. `save`
    joins them to FILE.npz, and an old file of that name stays as it is until the new one is whole.
    While that is done the states are on the disk twice. In memory there is never more of them than
    a chunk, of BLOCK_BYTES at most.
    """

    def __init__(self, path):
        """Makes the folder; raises OSError when that cannot be done, or RecordingError."""
        self.path = Path(path)
        with named_errors(path):
            self._target, self._isStream = find_target(path)
            if self._isStream:  # a pipe, or /dev/null: the chunks are kept elsewhere
                scratch = Path(tempfile.mkdtemp(prefix="rbs-"))
                self._target = scratch / f"{self.path.name}.npz"
            self.partialPath = partial_path(self._target)
            try:
                # Now: a missing folder, or missing rights, are found before hours are spent.
                self._folderLock = keep_folder(self.partialPath)
            except BlockingIOError:
                raise _in_use(self.partialPath) from None
        # A run that ended before its first chunk leaves an empty folder, which will do.
        if any(self.partialPath.glob(f"{CHUNK_PREFIX}*.npz")):
            release(self._folderLock)
            raise RecordingError(
                shown_path(self.partialPath),
                "an interrupted recording is kept here; make a file of it with --finish, look "
                "at it with --replay, or remove it",
            )
        self._isOpen = True
        self.frameCount = 0
        self._chunks = []  # paths
        self._frames = []
        self._changes = []  # (step, Change) since the last chunk
        self._history = []
        self._settings = None  # the last ones in the history
        self._start = self._lastChunk = time.monotonic()

    def add(self, simulation):
        """Keeps the simulation's present state.

        raises RecordingError when that is not one step after the last one kept, in the same scene:
        after a reset or a change of the scene, `save` ends the recording
        """
        if self.frameCount == 0:
            self._firstStep = simulation.stepCount
            self._meshes = simulation.meshes
            self._scene = str(simulation.scenePath)
            self._constraints = str(simulation.constraintPath or "")
            self._contentHashes = json.dumps(simulation.contentHashes)
            self._solver = simulation.solverState.arrays()
            initial = initial_changes(simulation.changes, simulation.stepCount == 0)
            self._changes = [(simulation.stepCount, change) for change in initial]
        step = self._firstStep + self.frameCount
        if simulation.meshes is not self._meshes or simulation.stepCount != step:
            raise RecordingError(self.path, f"only step {step} of the same scene could follow")
        self._bodyCount = len(simulation.meshes)
        state = simulation.state()
        self._frames.append({**state, "times": simulation.time, "hashes": hash_of(state)})
        self._endSolver = simulation.solverState.arrays()
        self.frameCount += 1
        if simulation.settings != self._settings:
            self._settings = replace(simulation.settings)
            self._history.append((step, asdict(self._settings)))
        now = time.monotonic()
        patience = max(CHUNK_SECONDS, CHUNK_SHARE * (now - self._start))
        self._maxIterations = simulation.max_iterations()
        frameBytes = sum(values.nbytes for values in state.values())
        if now - self._lastChunk >= patience or len(self._frames) * frameBytes >= BLOCK_BYTES:
            self._write_chunk()

    def note(self, simulation, change):
        """Keeps a `Change` that has been done to the simulation since the last state was kept."""
        if self.frameCount:
            self._changes.append((simulation.stepCount + 1, change))

    def save(self):
        """Writes the file, in place of an old one of that name: whole or not at all."""
        self._write_chunk()
        files = [RecordingFile(path) for path in self._chunks]
        with named_errors(self.path):
            changes = [change for file in files for change in _Head(file).changes]
            _join_chunks(files, self.partialPath, self._target, self._head(0, changes))
        if self._isStream:
            copy_to_stream(self._target, self.path)
        self._chunks = []
        self._give_up()

    def _give_up(self):
        """Leaves the folder, if it is there still, to others. Nothing is written from now on."""
        self._isOpen = False
        if self._isStream and not self._chunks:
            shutil.rmtree(self._target.parent, ignore_errors=True)
        release(self._folderLock)
        self._folderLock = None

    def close(self):
        """Keeps in FILE.npz.part/ what has not been saved; removes it where there is nothing.

        returns the path of the folder if something is kept there, else None
        """
        with suppress(OSError):  # the disk may be full: what is on it is kept
            self._write_chunk()
        self._frames = []
        kept = None
        if self._chunks:
            # A pipe that has broken leaves the file that was to go into it.
            kept = self.partialPath if self.partialPath.is_dir() else self._target
        elif self._isOpen:
            _remove_chunks(self.partialPath)
        self._give_up()
        return kept

    def _write_chunk(self):
        if not self._frames:
            return
        # What has been done since then is part of no state yet.
        lastStep = self._firstStep + self.frameCount - 1
        changes = [(step, change) for step, change in self._changes if step <= lastStep]
        series = {
            name: np.array([_with_rows(frame[name], name, self._bodyCount)
                            for frame in self._frames])
            for name in SERIES
        }  # fmt: skip
        rows = {name: (values.shape, [values]) for name, values in series.items()}
        path = self.partialPath / f"{CHUNK_PREFIX}{len(self._chunks):06d}.npz"
        with named_errors(self.path):
            head = self._head(self.frameCount - len(self._frames), changes)
            write_recording_file(path.with_suffix(".tmp"), path, rows, head)
        self._chunks.append(path)
        self._frames = []
        self._changes = self._changes[len(changes) :]
        self._lastChunk = time.monotonic()

    def _head(self, first, changes):
        """What a file holds beside the states.

        first : the place of its first state, from 0; changes : list of (step, Change)
        """
        return {
            "firstStep": self._firstStep + first,
            "settingsHistory": json.dumps(self._history),
            **self._history[-1][1],
            "maxIterations": min(self._maxIterations, np.iinfo(np.int64).max),
            "scene": self._scene,
            "constraints": self._constraints,
            "contentHashes": self._contentHashes,
            "meshNames": np.array(
                [mesh.name for mesh in self._meshes[: self._bodyCount]], dtype=np.str_
            ),
            "version": __version__,
            "numpyVersion": np.__version__,
            "format": FORMAT,
            **{SOLVER_PREFIX + name: values for name, values in self._solver.items()},
            **{END_SOLVER_PREFIX + name: values for name, values in self._endSolver.items()},
            **_head_of_changes(changes),
        }


def _head_of_changes(changes):
    """What a head says of changes: {} where there are none."""
    return {"format": FORMAT_WITH_CHANGES, **pack_changes(changes)} if changes else {}


def _with_rows(values, name, count):
    """The rows of a state's array, and those of bodies that are not there yet, up to a count."""
    if name not in STATE_NAMES or len(values) == count:
        return values
    rows = np.zeros((count, *values.shape[1:]))
    rows[:, 0] = name == "orientations"
    rows[: len(values)] = values
    return rows


def finish(path):
    """Makes FILE.npz of the chunks that a killed run has left in FILE.npz.part/, and removes them.

    The file has the very bytes that `Recorder.save` would have written after the last chunk. While
    it is written the states are on the disk twice, and in memory there are BLOCK_BYTES of them.

    path : FILE.npz or FILE.npz.part
    returns (path of FILE.npz, first step, last step); the last is before the first where the run
    was killed before its first chunk, and nothing but its empty folder was there to be removed
    raises RecordingError, also where there is another FILE.npz already, or where the run has not
    ended, or OSError; then nothing changes
    """
    path = Path(path)
    if path.name in ("", ".."):  # also of "."
        with named_errors(path):
            path = Path(os.path.abspath(path))
    if path.suffix == PARTIAL_ENDING:
        path = path.with_suffix("")
    elif path.is_dir():
        raise RecordingError(path, "this is a folder, not a recording")
    with named_errors(path):
        target = Path(os.path.realpath(path))
    partialPath = partial_path(target)
    if not partialPath.is_dir():
        raise RecordingError(path, f"there is no interrupted recording of it, {partialPath.name}")
    lock = _lock(partialPath)
    try:
        if not any(partialPath.glob(f"{CHUNK_PREFIX}*.npz")):
            _remove_chunks(partialPath)
            if partialPath.is_dir():
                raise RecordingError(partialPath, "this is a folder, not a recording")
            return path, 0, -1
        recording = Recording(partialPath, mustBeFinite=False)
        if target.exists():
            _check_holds(target, recording)
            _remove_chunks(partialPath)
        else:
            damage = recording.damage()
            if damage:
                raise RecordingError(path, f"cannot be made: {damage}")
            with named_errors(path):
                _join_chunks(recording.files, partialPath, target, recording.head())
    finally:
        release(lock)
    return path, recording.firstStep, recording.lastStep


def _join_chunks(files, partialPath, path, head):
    """Makes one recording of chunks, in place of an old file, and removes their folder.

    files : list of RecordingFile; head : what the recording holds beside the states
    raises OSError or RecordingError, and then leaves everything as it was
    """
    rows = {}
    check = _signal_check()
    for name in SERIES:
        count = sum(file.member(name).shape[0] for file in files)
        shape = files[-1].member(name).shape[1:]
        rows[name] = (count, *shape), _joined(files, name, shape, check)
    with named_errors(path):
        write_recording_file(partialPath / JOINED_NAME, path, rows, head)
    # From here on the chunks are not needed, and what of them cannot be removed does no harm.
    _remove_chunks(partialPath)


def _signal_check():
    """A function that raises Interrupt if there was a signal since now, and patience is at an end.

    Between two blocks, where the chunks are whole and what is joined of them can be dropped.
    """
    start, before = time.monotonic(), len(noted())

    def check():
        if time.monotonic() - start >= JOIN_PATIENCE:
            raise_if_more(before)

    return check


def _remove_chunks(partialPath):
    """Removes an interrupted recording, and its folder where there is nothing else in it.

    The last chunk first: should the program be killed meanwhile, the others are a recording of the
    first steps, which `finish` finds in the file that has been made of them all.
    """
    with suppress(OSError):
        for pattern in (f"{CHUNK_PREFIX}*.npz", f"{CHUNK_PREFIX}*.tmp", JOINED_NAME):
            for path in sorted(partialPath.glob(pattern), reverse=True):
                os.unlink(path)
        os.rmdir(partialPath)


def _joined(files, name, rowShape, check):
    """The rows of one array through several files, BLOCK_BYTES at a time.

    rowShape : of the last file, which has all bodies; check : called before each
    """
    for file in files:
        dtype, shape, _ = file.member(name)
        atOnce = max(1, BLOCK_BYTES // (math.prod(shape[1:]) * dtype.itemsize))
        for begin in range(0, shape[0], atOnce):
            check()
            block = file.rows([name], begin, min(begin + atOnce, shape[0]))[name]
            if shape[1:] != rowShape:
                block = np.array([_with_rows(row, name, rowShape[0]) for row in block])
            yield block


def _check_holds(path, chunks):
    """Raises RecordingError unless a file has all that is in the chunks.

    It has, where the program was killed after it had made the file and before they were removed.
    """
    with suppress(RecordingError):
        whole = Recording(path, mustBeFinite=False)
        same = whole.firstStep == chunks.firstStep and whole.lastStep >= chunks.lastStep
        if same and all(
            np.array_equal(block["hashes"], whole.hashes(begin, len(block["hashes"])))
            for begin, block in chunks.blocks(["hashes"])
        ):
            return
    raise RecordingError(
        path, f"there is another one already; rename it, or remove {partial_path(path).name}"
    )


def _lock(partialPath):
    """The descriptor that keeps a recording's folder, or None; RecordingError if it is in use."""
    try:
        return lock_folder(partialPath)
    except BlockingIOError:
        raise _in_use(partialPath) from None


def _in_use(partialPath):
    """The RecordingError about a folder that another run has. To be raised by the caller."""
    return RecordingError(shown_path(partialPath), "a program is still recording into it")
