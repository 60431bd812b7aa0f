"""Recordings: written while a scene is simulated, replayed, resumed, verified; and its statistics.

From the top: what a scene in some state is and can be asked, the part that a simulation and a
replay have in common; the file format; `Recorder` writes it, `Recording` reads it, `Replay` shows
it. Nothing here loads a scene or draws.

Units: metres, kilograms, seconds.
"""

import errno
import hashlib
import json
import math
import os
import shutil
import struct
import time
import zipfile
from bisect import bisect_right
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from Quaternion import QConj, QRotate
from RBSFunctions import GRAVITY, __version__

# ---------------------------------------------------------------------------------------------
# A scene in some state
# ---------------------------------------------------------------------------------------------

# The state of a body: the rest of it follows from these and from what never changes.
STATE_NAMES = {
    "positions": "position",
    "orientations": "orientation",
    "linVelocities": "linVelocity",
    "angVelocities": "angVelocity",
}
STATE_WIDTHS = {"positions": 3, "orientations": 4, "linVelocities": 3, "angVelocities": 3}


class Scene:
    """Bodies, and what ties them, in some state: what a simulation and a replay have in common.

    Attributes: meshes, list of Mesh; constraints, rows [m1, v1, m2, v2, refValue, upper].
    """

    meshes = ()
    constraints = ()

    def state(self):
        """Copies of positions (n, 3), orientations (n, 4), linVelocities and angVelocities (n, 3).

        returns a dict with these four names
        """
        return {
            plural: np.array([getattr(mesh, name)[0] for mesh in self.meshes], dtype=np.float64)
            .reshape(len(self.meshes), STATE_WIDTHS[plural])
            for plural, name in STATE_NAMES.items()
        }  # fmt: skip

    def set_state(self, state):
        """Puts the bodies into a state that `state()` gave, in this scene."""
        for plural, name in STATE_NAMES.items():
            for mesh, row in zip(self.meshes, state[plural], strict=True):
                setattr(mesh, name, np.array(row, dtype=np.float64).reshape(1, -1))
        for mesh in self.meshes:
            mesh.currVertices = QRotate(mesh.orientation, mesh.origVertices) + mesh.position

    def kinetic_energy(self):
        """Of all free bodies, in J: ½ m v² + ½ ωᵀ I ω, the latter in body axes, where I = IT."""
        energy = 0.0
        for mesh in self.meshes:
            if not mesh.isFixed:
                spin = QRotate(QConj(mesh.orientation), mesh.angVelocity)[0]
                energy += 0.5 * mesh.mass * float(np.sum(mesh.linVelocity**2))
                energy += 0.5 * float(spin @ mesh.IT @ spin)
        return energy

    def potential_energy(self):
        """Of all free bodies over the ground, in J: m g y of their centres of mass."""
        return sum(
            float(-GRAVITY * mesh.mass * mesh.position[0, 1])
            for mesh in self.meshes
            if not mesh.isFixed
        )

    def largest_violation(self):
        """How far the distance of two tied vertices is beyond its bound, in m; 0 if none is."""
        largest = 0.0
        for m1, v1, m2, v2, refValue, upper in self.constraints:
            distance = math.dist(self.meshes[m1].currVertices[v1], self.meshes[m2].currVertices[v2])
            largest = max(largest, distance - refValue if upper else refValue - distance)
        return largest

    def lowest_point(self):
        """(y in m, name of the body) of the lowest vertex; (nan, "") where there is no body."""
        heights = [(float(np.min(mesh.currVertices[:, 1])), mesh.name) for mesh in self.meshes]
        return min(heights, default=(math.nan, ""))

    def is_finite(self):
        """Whether no number of the state is NaN or infinite."""
        return all(bool(np.all(np.isfinite(values))) for values in self.state().values())


def hash_of(state):
    """BLAKE2b (16,) uint8 of the bytes of a state's four arrays, in the order of STATE_NAMES.

    Two states have the same hash if they are the same to the last bit; that two others have it by
    chance will not happen in any number of steps that a computer can make.
    """
    digest = hashlib.blake2b(digest_size=HASH_SIZE)
    for name in STATE_NAMES:
        digest.update(np.ascontiguousarray(state[name], dtype="<f8"))
    return np.frombuffer(digest.digest(), dtype=np.uint8)


# ---------------------------------------------------------------------------------------------
# The file
# ---------------------------------------------------------------------------------------------
#
# A recording is an .npz file that `np.load(FILE)` reads. With s steps of n bodies it holds
#
#   positions (s + 1, n, 3), orientations (s + 1, n, 4), linVelocities, angVelocities (s + 1, n, 3)
#   times (s + 1,)      seconds; hashes (s + 1, 16), of each state, as `hash_of` has it
#   firstStep           the number of the first state: 0, unless the recording began later
#   settingsHistory     JSON, rows [step, settings]: what the steps from that one on were made with
#   restitution, ...    each field of the settings as it was at the end
#   scene, constraints  paths as given, "" for none; meshNames (n,)
#   version, numpyVersion, format
#
# Nothing in it is compressed. Positions and velocities are as good as random in most of their bits,
# so compression would save a few per cent for several times the work, and a state could no longer
# be read on its own.

FORMAT = 1
HASH_SIZE = 16
# What a state's number says about it, in the order of the file.
SERIES = {
    **{name: ("<f8", (width,)) for name, width in STATE_WIDTHS.items()},
    "times": ("<f8", ()),
    "hashes": ("|u1", (HASH_SIZE,)),
}
# The folder beside FILE.npz that a recording grows in, and what its files begin with.
PART_ENDING = ".part"
CHUNK_PREFIX = "chunk_"
# Bytes that are looked at together, here and wherever a file is walked through.
BLOCK_BYTES = 4 << 20
# A zip file's local header: its length, and where it says how long the name and the extra are.
LOCAL_HEADER = struct.Struct("<26xHH")


class RecordingError(ValueError):
    """A recording that cannot be used, or not written. Reads "file: cause" in one line."""

    def __init__(self, path, cause):
        super().__init__(f"{path}: {cause}")


class _Member(NamedTuple):
    """An array in a recording's file: its numbers start at byte `start` and go on to the end."""

    dtype: np.dtype
    shape: tuple
    start: int


class _File:
    """One .npz file whose arrays are read row by row, and only those that are asked for.

    Opening it reads headers only. What they announce is compared with the size of the file, and
    nothing may be compressed, so that no file makes this program allocate more than it is long.
    """

    def __init__(self, path):
        """Raises RecordingError, also where the file is missing."""
        self.path = Path(path)
        self._members = {}
        try:
            size = os.path.getsize(self.path)
            with open(self.path, "rb") as file, zipfile.ZipFile(file) as archive:
                entries = archive.infolist()
                if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):
                    raise self.error("its arrays are compressed, those of a recording are not")
                announced = sum(max(entry.file_size, entry.compress_size) for entry in entries)
                if announced > size:
                    raise self.error(
                        f"it announces {announced} bytes, more than the {size} that it has"
                    )
                for entry in entries:
                    self._members[entry.filename.removesuffix(".npy")] = self._locate(
                        file, archive, entry
                    )
        except RecordingError:
            raise
        except OSError as error:
            raise self.error(f"cannot be read ({error.strerror or error})") from None
        except Exception as error:
            # Whatever zipfile and NumPy's header parser raise about bytes that are neither.
            raise self.error(f"this is not a recording ({_one_line(error)})") from None

    def error(self, cause):
        """The RecordingError about this file. To be raised by the caller."""
        return RecordingError(self.path, cause)

    def _locate(self, file, archive, entry):
        """The _Member that a zip entry holds."""
        name = _one_line(entry.filename)
        with archive.open(entry) as member:
            version = np.lib.format.read_magic(member)
            read_header = {
                (1, 0): np.lib.format.read_array_header_1_0,
                (2, 0): np.lib.format.read_array_header_2_0,
            }.get(version)
            if read_header is None:
                raise self.error(f"the array {name} is of an unknown kind")
            shape, isFortran, dtype = read_header(member)
            headerSize = member.tell()
        if dtype.hasobject or isFortran or dtype.itemsize == 0 or min(shape, default=0) < 0:
            raise self.error(f"the array {name} is of a kind that no recording holds")
        if math.prod(shape) * dtype.itemsize != entry.file_size - headerSize:
            raise self.error(f"the array {name} is not as long as it announces")
        file.seek(entry.header_offset)
        nameSize, extraSize = LOCAL_HEADER.unpack(file.read(LOCAL_HEADER.size))
        start = entry.header_offset + LOCAL_HEADER.size + nameSize + extraSize + headerSize
        return _Member(dtype, shape, start)

    def member(self, name):
        """The _Member of that name; raises RecordingError where there is none."""
        if name not in self._members:
            raise self.error(f"this is not a recording (there is no array '{name}' in it)")
        return self._members[name]

    def whole(self, name, kind):
        """A whole array, for the small ones; its checksum is checked.

        kind : of the dtype: "U" or "i"
        """
        member = self.member(name)
        if member.dtype.kind != kind:
            raise self.error(f"the array {name} holds the wrong kind of values")
        try:
            with zipfile.ZipFile(self.path) as archive:
                content = archive.read(name + ".npy")
            content = content[-math.prod(member.shape) * member.dtype.itemsize :]
            return np.frombuffer(content, member.dtype).reshape(member.shape)
        except zipfile.BadZipFile:
            raise self.error(f"the array {name} is damaged: its checksum is wrong") from None
        except OSError as error:
            raise self.error(f"cannot be read ({error.strerror or error})") from None

    def rows(self, names, begin, end):
        """Rows begin ≤ row < end of some arrays, as a dict of arrays."""
        result = {}
        try:
            with open(self.path, "rb") as file:
                for name in names:
                    dtype, shape, start = self.member(name)
                    rowBytes = math.prod(shape[1:]) * dtype.itemsize
                    file.seek(start + begin * rowBytes)
                    content = file.read((end - begin) * rowBytes)
                    if len(content) < (end - begin) * rowBytes:
                        raise self.error("the file has become shorter since it was opened")
                    result[name] = np.frombuffer(content, dtype).reshape(-1, *shape[1:])
        except OSError as error:
            raise self.error(f"cannot be read ({error.strerror or error})") from None
        return result

    def damaged_member(self):
        """The name of the first array whose checksum is wrong, or None."""
        try:
            with zipfile.ZipFile(self.path) as archive:
                name = archive.testzip()  # reads in blocks
        except (OSError, zipfile.BadZipFile) as error:
            raise self.error(f"cannot be read ({_one_line(error)})") from None
        return name and name.removesuffix(".npy")


def _one_line(text, limit=80):
    """What an error or a file says, fit for one line."""
    line = "".join(c if c.isprintable() else " " for c in str(text)[:limit])
    return line or type(text).__name__


class Recording:
    """A recording that is read, state by state; it is never in memory as a whole.

    Attributes: path, of the file, or of the folder that an interrupted recording has left;
    wasInterrupted, whether it is the latter; firstStep, lastStep; scene, constraints, paths as
    recorded ("" for none); meshNames, list of str; settingsHistory, list of (step, dict), the
    fields of the settings that the steps from that one on were made with; version, numpyVersion.

    Where FILE.npz does not exist and FILE.npz.part/ does, that is what is read.
    """

    def __init__(self, path):
        """Reads everything but the states, and looks through these for numbers that are none.

        raises RecordingError
        """
        self.path = Path(path)
        part = self.path.with_name(self.path.name + PART_ENDING)
        if not self.path.exists() and part.is_dir():
            self.path = part
        self.wasInterrupted = self.path.is_dir()
        if not self.path.exists():
            raise self.error("there is no such file")
        paths = [self.path]
        if self.wasInterrupted:
            paths = sorted(self.path.glob(f"{CHUNK_PREFIX}*.npz"))
            if not paths:
                raise self.error("this is a folder, not a recording")
        self._files = [_File(chunk) for chunk in paths]
        self._read_heads()
        self._check_states()

    def error(self, cause):
        """The RecordingError about this recording. To be raised by the caller."""
        return RecordingError(self.path, cause)

    def _read_heads(self):
        """Everything but the states; the chunks must follow each other."""
        heads = [_Head(file) for file in self._files]
        first, last = heads[0], heads[-1]
        self.firstStep = expected = first.firstStep
        for head in heads:
            if head.firstStep != expected or head.meshNames != first.meshNames:
                raise head.file.error(f"the states from step {expected} on are missing before it")
            expected += head.count
        self.lastStep = expected - 1
        self._firstSteps = [head.firstStep for head in heads]
        self.meshNames = first.meshNames
        self.scene, self.constraints = first.scene, first.constraints
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

    def blocks(self, names):
        """Walks through some arrays: yields (step of the first row, dict of arrays)."""
        for file, first in zip(self._files, self._firstSteps, strict=True):
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
        rows = self._files[chunk].rows(SERIES, row, row + 1)
        return {name: values[0] for name, values in rows.items()}

    def settings_at(self, step):
        """The fields of the settings that a step was made with, as a dict."""
        steps = [first for first, _ in self.settingsHistory]
        return self.settingsHistory[max(0, bisect_right(steps, step) - 1)][1]

    def damaged_member(self):
        """Where a checksum is wrong: "file: array", or None."""
        for file in self._files:
            name = file.damaged_member()
            if name:
                return f"{file.path}: {name}"
        return None


class _Head:
    """What one file of a recording holds beside the states, checked."""

    def __init__(self, file):
        self.file = file
        self.firstStep = self._whole_number("firstStep")
        if self._whole_number("format") != FORMAT:
            raise file.error("it was written by a newer version of this program")
        self.scene, self.constraints, self.version, self.numpyVersion = (
            self._text(name) for name in ("scene", "constraints", "version", "numpyVersion")
        )
        names = file.whole("meshNames", "U")
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
        self.settingsHistory = self._history()

    def _whole_number(self, name):
        value = self.file.whole(name, "i")
        if value.shape != () or value < 0:
            raise self.file.error(f"the array {name} is not a whole number")
        return int(value)

    def _text(self, name):
        value = self.file.whole(name, "U")
        text = str(value) if value.shape == () else "\0"
        if not text.isprintable():
            raise self.file.error(f"the array {name} is not a line of text")
        return text

    def _history(self):
        try:
            history = [
                (int(step), {str(name): value for name, value in fields.items()})
                for step, fields in json.loads(self._text("settingsHistory"))
            ]
        except (ValueError, TypeError, AttributeError, RecursionError):
            history = []
        steps = [step for step, _ in history]
        if not steps or steps != sorted(set(steps)):
            raise self.file.error("the history of its settings cannot be read")
        return history


# ---------------------------------------------------------------------------------------------
# Replay
# ---------------------------------------------------------------------------------------------


class Replay(Scene):
    """A recording in place of a simulation: has its attributes, and steps, but simulates nothing.

    Attributes, as a simulation's: meshes, groundMesh, constraints, settings (those that the present
    step was made with), scenePath, constraintPath, stepCount, time; report and stepSeconds, always
    None. Of its own: recording; firstStep, lastStep.
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
        self._settings = {
            id(fields): restored_settings(recording, step, simulation.settings)
            for step, fields in recording.settingsHistory
        }
        self.reset()

    def seek(self, step):
        """Puts the bodies to where they were after that step, or after the nearest recorded one."""
        step = min(max(int(step), self.firstStep), self.lastStep)
        frame = self.recording.frame(step)
        self.set_state(frame)
        self.stepCount = step
        self.time = float(frame["times"])
        self.settings = self._settings[id(self.recording.settings_at(step))]

    def step(self):
        """One step on; at the end, it stays there."""
        if self.stepCount < self.lastStep:
            self.seek(self.stepCount + 1)

    def reset(self):
        """Back to the first step."""
        self.seek(self.firstStep)


def check_bodies(recording, simulation):
    """Raises RecordingError unless the simulation's scene has the bodies of the recording."""
    names = [mesh.name for mesh in simulation.meshes]
    if len(names) != len(recording.meshNames):
        raise recording.error(
            f"it has {len(recording.meshNames)} bodies, but {simulation.scenePath} has {len(names)}"
        )
    for ours, theirs in zip(names, recording.meshNames, strict=True):
        if ours != theirs:
            raise recording.error(
                f"its body '{_one_line(theirs)}' is called '{ours}' in {simulation.scenePath}"
            )


def restored_settings(recording, step, settings):
    """The settings that a recorded step was made with.

    settings : of the type that is wanted; has what the recording does not know
    raises RecordingError when the recording has a setting that is unknown or has no sense
    """
    fields = recording.settings_at(step)
    unknown = sorted(set(fields) - set(asdict(settings)))
    if unknown:
        raise recording.error(
            f"it has a setting that this version does not know: {_one_line(unknown[0])}"
        )
    try:
        return replace(settings, **fields)
    except (ValueError, TypeError) as error:
        raise recording.error(f"step {step}: {_one_line(error)}") from None


# ---------------------------------------------------------------------------------------------
# Recording
# ---------------------------------------------------------------------------------------------

WHOLE_NAME = "whole.tmp"
# What a crash may cost: the states since the last chunk, a second's worth, or a hundredth of the
# run where that is more. So a run of a day leaves hundreds of files, not a hundred thousand.
CHUNK_SECONDS = 1.0
CHUNK_SHARE = 0.01


def _write_npz(path, rows, head):
    """Writes an .npz file and brings it to the disk; a half-written one is removed.

    rows : dict of (shape, blocks that follow each other); head : dict of what is small
    """
    head = {name: np.asarray(value) for name, value in head.items()}
    arrays = rows | {name: (value.shape, [value]) for name, value in head.items()}
    try:
        with open(path, "wb") as file:
            with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
                for name, (shape, blocks) in arrays.items():
                    dtype = np.dtype(SERIES[name][0]) if name in SERIES else head[name].dtype
                    _write_member(archive, name, shape, dtype, blocks)
            file.flush()
            os.fsync(file.fileno())
    except BaseException:
        Path(path).unlink(missing_ok=True)
        raise


def _write_member(archive, name, shape, dtype, blocks):
    """Writes one array as `np.savez` would, a block at a time."""
    # An entry made like this has no time of day: the same run writes the same bytes.
    with archive.open(zipfile.ZipInfo(name + ".npy"), "w", force_zip64=True) as member:
        np.lib.format.write_array_header_1_0(
            member,
            {
                "descr": np.lib.format.dtype_to_descr(dtype),
                "fortran_order": False,
                "shape": shape,
            },
        )
        for block in blocks:
            member.write(np.ascontiguousarray(block, dtype).tobytes())


def _joined(files, name):
    """The rows of one array through several files, a file at a time."""
    for file in files:
        yield file.rows([name], 0, file.member(name).shape[0])[name]


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
        if self.path.is_dir():
            raise IsADirectoryError(errno.EISDIR, "this is a folder, not a file", str(path))
        self.partPath = self.path.with_name(self.path.name + PART_ENDING)
        try:
            # Now: a missing folder, or missing rights, are found out before hours are spent.
            self.partPath.mkdir()
        except FileExistsError:
            raise RecordingError(
                self.partPath,
                "an interrupted recording is kept here; look at it with --replay, or remove it",
            ) from None
        except OSError as error:
            error.filename = str(path)  # the name that the caller knows
            raise
        self.frameCount = 0
        self._chunks = []  # paths
        self._frames = []
        self._history = []
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
        step = self._firstStep + self.frameCount
        if simulation.meshes is not self._meshes or simulation.stepCount != step:
            raise RecordingError(self.path, f"only step {step} of the same scene could follow")
        state = simulation.state()
        self._frames.append({**state, "times": simulation.time, "hashes": hash_of(state)})
        self.frameCount += 1
        fields = asdict(simulation.settings)
        if not self._history or self._history[-1][1] != fields:
            self._history.append((step, fields))
        now = time.monotonic()
        patience = max(CHUNK_SECONDS, CHUNK_SHARE * (now - self._start))
        self._maxIterations = simulation.max_iterations()
        frameBytes = sum(values.nbytes for values in state.values())
        if now - self._lastChunk >= patience or len(self._frames) * frameBytes >= BLOCK_BYTES:
            self._write_chunk()

    def save(self):
        """Writes the file, in place of an old one of that name: whole or not at all."""
        self._write_chunk()
        files = [_File(path) for path in self._chunks]
        rows = {
            name: ((self.frameCount, *files[0].member(name).shape[1:]), _joined(files, name))
            for name in SERIES
        }
        whole = self.partPath / WHOLE_NAME
        _write_npz(whole, rows, self._head(0))
        os.replace(whole, self.path)
        self._chunks = []
        self.close()

    def close(self):
        """Keeps in FILE.npz.part/ what has not been saved; removes it where there is nothing.

        returns the path of the folder if something is kept there, else None
        """
        with suppress(OSError):  # the disk may be full: what is on it is kept
            self._write_chunk()
        self._frames = []
        if self._chunks:
            return self.partPath
        if self.partPath.is_dir():
            shutil.rmtree(self.partPath)
        return None

    def _write_chunk(self):
        if not self._frames:
            return
        series = {name: np.array([frame[name] for frame in self._frames]) for name in SERIES}
        rows = {name: (values.shape, [values]) for name, values in series.items()}
        path = self.partPath / f"{CHUNK_PREFIX}{len(self._chunks):06d}.npz"
        _write_npz(path.with_suffix(".tmp"), rows, self._head(self.frameCount - len(self._frames)))
        os.replace(path.with_suffix(".tmp"), path)
        self._chunks.append(path)
        self._frames = []
        self._lastChunk = time.monotonic()

    def _head(self, first):
        """What a file holds beside the states. first : the place of its first state, from 0."""
        return {
            "firstStep": self._firstStep + first,
            "settingsHistory": json.dumps(self._history),
            **self._history[-1][1],
            "maxIterations": self._maxIterations,
            "scene": self._scene,
            "constraints": self._constraints,
            "meshNames": np.array([mesh.name for mesh in self._meshes], dtype=np.str_),
            "version": __version__,
            "numpyVersion": np.__version__,
            "format": FORMAT,
        }
