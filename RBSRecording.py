"""Recordings: written while a scene is simulated, replayed, resumed, verified; and its statistics.

From the top: what a scene in some state is and can be asked, the part that a simulation and a
replay have in common; the file, and `Recording`, which reads it; `Replay`; resuming and verifying;
`Recorder`, which writes it; statistics. Nothing here loads a scene, and only a plot is drawn.

Units: metres, kilograms, seconds.
"""

import csv
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
from RBSFiles import (
    PART_ENDING,
    check_regular,
    check_target,
    lock_folder,
    named_errors,
    one_line,
    part_of,
    put_in_place,
    written_whole,
)
from RBSFunctions import GRAVITY, StateError, __version__

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

# The shapes of the values of a body that its energies and momenta are made of.
_ROWS = {
    "mass": (1,), "IT": (3, 3), "position": (3,), "orientation": (4,), "linVelocity": (3,),
    "angVelocity": (3,),
}  # fmt: skip


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
            plural: np.array([getattr(mesh, name) for mesh in self.meshes], dtype=np.float64)
            .reshape(len(self.meshes), STATE_WIDTHS[plural])
            for plural, name in STATE_NAMES.items()
        }  # fmt: skip

    def set_state(self, state):
        """Puts the bodies into a state that `state()` gave, in this scene."""
        for plural, name in STATE_NAMES.items():
            for mesh, row in zip(self.meshes, state[plural], strict=True):
                setattr(mesh, name, np.array(row, dtype=np.float64).reshape(1, -1))
        # In one go, which a replay is played with: NumPy's calls would take most of the time.
        counts = [len(mesh.origVertices) for mesh in self.meshes]
        turns, shifts = (
            np.repeat(np.concatenate([getattr(mesh, name) for mesh in self.meshes]), counts, axis=0)
            for name in ("orientation", "position")
        )
        vertices = np.concatenate([mesh.origVertices for mesh in self.meshes])
        vertices = QRotate(turns, vertices) + shifts
        ends = np.cumsum(counts)[:-1]
        for mesh, own in zip(self.meshes, np.split(vertices, ends), strict=True):
            mesh.currVertices = own

    def _free(self, *names):
        """Attributes of all free bodies as arrays with a row for each of the m bodies."""
        free = [mesh for mesh in self.meshes if not mesh.isFixed]
        return [
            np.array([getattr(mesh, name) for mesh in free]).reshape(len(free), *_ROWS[name])
            for name in names
        ]

    def _spin(self):
        """(m, 3) each: the free bodies' ω and I ω in body axes, where I = IT."""
        q, angVelocity, IT = self._free("orientation", "angVelocity", "IT")
        spin = QRotate(QConj(q), angVelocity)
        return spin, np.einsum("mij,mj->mi", IT, spin)

    def kinetic_energy(self):
        """Of all free bodies, in J: ½ m v² + ½ ωᵀ I ω."""
        mass, v = self._free("mass", "linVelocity")
        spin, spinMomentum = self._spin()
        return float(0.5 * np.sum(mass * v * v) + 0.5 * np.sum(spin * spinMomentum))

    def momentum(self):
        """(3,) of all free bodies, in kg m/s: m v."""
        mass, v = self._free("mass", "linVelocity")
        return np.sum(mass * v, axis=0)

    def angular_momentum(self):
        """(3,) of all free bodies about the origin, in kg m²/s: m r × v + R I Rᵀ ω."""
        mass, r, v, q = self._free("mass", "position", "linVelocity", "orientation")
        return np.sum(np.cross(r, mass * v) + QRotate(q, self._spin()[1]), axis=0)

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
# Nothing in it is compressed. Compression would save 61 % of the stress scene's 4.3 kB per step, at
# 0.13 ms; but then no state could be read on its own, and a small file could unpack to any size.

FORMAT = 1
HASH_SIZE = 16
# The arrays with a row for each state, in the order of the file: the type of their numbers and the
# shape of a row, of a body's part of it where there is one for each body.
SERIES = {
    **{name: ("<f8", (width,)) for name, width in STATE_WIDTHS.items()},
    "times": ("<f8", ()),
    "hashes": ("|u1", (HASH_SIZE,)),
}
# What the files begin with in the folder FILE.npz.part/ that a recording grows in.
CHUNK_PREFIX = "chunk_"
# Bytes that are looked at together, here and wherever a file is walked through.
BLOCK_BYTES = 4 << 20
# The most bytes of an array that is read as a whole, as the names of the bodies are.
WHOLE_BYTES = 64 << 20
# The most characters that are told of what a file says.
SAID = 80
# How far the length of a recorded quaternion may be from 1. Rounding makes about 1e-16 a step.
UNIT_TOLERANCE = 1e-3
# What stands before each array in a zip file: a signature and, after what its end repeats, the
# lengths of the name and of the extra field that follow.
LOCAL_HEADER = struct.Struct("<4s22xHH")
LOCAL_SIGNATURE = b"PK\3\4"


class RecordingError(ValueError):
    """A recording that cannot be used, or not written. Reads "file: cause" in one line."""

    def __init__(self, path, cause):
        super().__init__(one_line(f"{path}: {cause}"))


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
            check_regular(self.path)
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
                    name = entry.filename.removesuffix(".npy")
                    self._members[name] = self._locate(file, entry)
        except RecordingError:
            raise
        except OSError as error:
            raise self.error(f"cannot be read ({error.strerror or error})") from None
        except Exception as error:
            # Whatever zipfile and NumPy's header parser raise about bytes that are neither.
            raise self.error(f"this is not a recording ({one_line(error, SAID)})") from None

    def error(self, cause):
        """The RecordingError about this file. To be raised by the caller."""
        return RecordingError(self.path, cause)

    def _locate(self, file, entry):
        """The _Member that a zip entry holds. Its checksum is not looked at."""
        name = one_line(entry.filename, SAID)
        file.seek(entry.header_offset)
        signature, nameSize, extraSize = LOCAL_HEADER.unpack(file.read(LOCAL_HEADER.size))
        if signature != LOCAL_SIGNATURE or file.read(nameSize) != entry.filename.encode():
            raise self.error(f"the array {name} is not where the end of the file says")
        begin = file.seek(extraSize, os.SEEK_CUR)
        read_header = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }.get(np.lib.format.read_magic(file))
        if read_header is None:
            raise self.error(f"the array {name} is of an unknown kind")
        shape, isFortran, dtype = read_header(file)
        start = file.tell()
        if dtype.hasobject or isFortran or dtype.itemsize == 0 or min(shape, default=0) < 0:
            raise self.error(f"the array {name} is of a kind that no recording holds")
        if math.prod(shape) * dtype.itemsize != begin + entry.file_size - start:
            raise self.error(f"the array {name} is not as long as it announces")
        return _Member(dtype, shape, start)

    def member(self, name):
        """The _Member of that name; raises RecordingError where there is none."""
        if name not in self._members:
            raise self.error(f"this is not a recording (there is no array '{name}' in it)")
        return self._members[name]

    def names(self):
        """The names of all arrays, in the order of the file."""
        return list(self._members)

    def whole(self, name, kinds):
        """A whole array, for the small ones; its checksum is checked.

        kinds : of the dtype, "U" or "i" for instance; any of these letters will do
        """
        member = self.member(name)
        if member.dtype.kind not in kinds:
            raise self.error(f"the array {name} holds the wrong kind of values")
        if math.prod(member.shape) * member.dtype.itemsize > WHOLE_BYTES:
            raise self.error(f"the array {name} is longer than {WHOLE_BYTES} bytes")
        try:
            with zipfile.ZipFile(self.path) as archive:
                content = archive.read(name + ".npy")
            content = content[len(content) - math.prod(member.shape) * member.dtype.itemsize :]
            return np.frombuffer(content, member.dtype).reshape(member.shape)
        except OSError as error:
            raise self.error(f"cannot be read ({error.strerror or error})") from None
        except Exception:  # whatever zipfile raises where the file's two directories disagree
            raise self.error(f"the array {name} is damaged: its checksum is wrong") from None

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
        except Exception as error:
            raise self.error(f"cannot be read ({one_line(error, SAID)})") from None
        return name and name.removesuffix(".npy")


class Recording:
    """A recording that is read, state by state; it is never in memory as a whole.

    Attributes: path, of the file, or of the folder that an interrupted recording has left;
    wasInterrupted, whether it is the latter; firstStep, lastStep; scene, constraints, paths as
    recorded ("" for none); meshNames, list of str; files, a _File of each chunk;
    settingsHistory, list of (step, dict), the fields of the settings that the steps from that one
    on were made with; version, numpyVersion.

    Where FILE.npz does not exist and FILE.npz.part/ does, that is what is read.
    """

    def __init__(self, path, mustBeFinite=True):
        """Reads everything but the states; raises RecordingError.

        mustBeFinite : whether to look through the states for numbers that are not finite, and
            for orientations that are none
        """
        self.path = Path(path)
        part = Path(str(path) + PART_ENDING)
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
        self.files = [_File(chunk) for chunk in paths]
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
            with np.errstate(over="ignore"):
                lengths = np.linalg.norm(block["orientations"], axis=2)
            isUnit = (np.abs(lengths - 1.0) <= UNIT_TOLERANCE).all(axis=1)
            if not isUnit.all():
                step = begin + int(np.argmin(isUnit))
                raise self.error(f"step {step}: orientations holds a quaternion that is no turn")

    def blocks(self, names):
        """Walks through some arrays: yields (step of the first row, dict of arrays)."""
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
        return {name: values[0] for name, values in rows.items()}

    def hashes(self, step, count):
        """The hashes (count, 16) of the states from a step on."""
        return np.array([self.frame(k)["hashes"] for k in range(step, step + count)])

    def settings_at(self, step):
        """What a step was made with: (the first step made so, dict of the settings' fields)."""
        steps = [first for first, _ in self.settingsHistory]
        return self.settingsHistory[max(0, bisect_right(steps, step) - 1)]

    def head(self):
        """What it holds beside the states at its end, as arrays: dict, in the order of the file."""
        first, last = self.files[0], self.files[-1]
        names = [name for name in last.names() if name not in SERIES]
        head = {name: last.whole(name, "Uifb") for name in names}
        return head | {"firstStep": first.whole("firstStep", "i")}

    def damaged_member(self):
        """Where a checksum is wrong: "file: array", or None."""
        for file in self.files:
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
            first: restored_settings(recording, first, simulation.settings)
            for first, _ in recording.settingsHistory
        }
        self.reset()

    def seek(self, step):
        """Puts the bodies to where they were after that step, or after the nearest recorded one."""
        step = min(max(int(step), self.firstStep), self.lastStep)
        frame = self.recording.frame(step)
        self.set_state(frame)
        self.stepCount = step
        self.time = float(frame["times"])
        self.settings = self._settings[self.recording.settings_at(step)[0]]

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
                f"its body '{one_line(theirs, SAID)}' is called '{ours}' in {simulation.scenePath}"
            )


def restored_settings(recording, step, settings):
    """The settings that a recorded step was made with.

    settings : of the type that is wanted; has what the recording does not know
    raises RecordingError when the recording has a setting that is unknown or has no sense
    """
    _, fields = recording.settings_at(step)
    unknown = sorted(set(fields) - set(asdict(settings)))
    if unknown:
        raise recording.error(
            f"it has a setting that this version does not know: {one_line(unknown[0], SAID)}"
        )
    try:
        return replace(settings, **fields)
    except ValueError as error:
        raise recording.error(f"step {step}: {one_line(error, SAID)}") from None
    except (TypeError, OverflowError):  # a list where a number belongs, for instance
        raise recording.error(f"step {step}: its settings are not of the right kind") from None


# ---------------------------------------------------------------------------------------------
# Resuming and verifying
# ---------------------------------------------------------------------------------------------


def resume(recording, step, simulation):
    """Puts a simulation to where a recorded step has left it, to go on with the same bits.

    Its settings become those that the recording went on with; later changes are not followed.
    raises RecordingError
    """
    frame = recording.frame(step)
    if not np.array_equal(hash_of(frame), frame["hashes"]):
        raise recording.error(f"step {step} is damaged: its state does not match its hash")
    simulation.settings = restored_settings(
        recording, min(step + 1, recording.lastStep), simulation.settings
    )
    simulation.set_state(frame)
    simulation.stepCount, simulation.time = step, float(frame["times"])


def verify(recording, simulation, advance=None):
    """Simulates a recording once more and compares the states, to the last bit.

    simulation : of the recorded scene, at its start; advance : called after every step
    returns what is wrong first, in a few words, or ""
    raises RecordingError when the recording cannot be read or its settings have no sense
    """
    for begin, block in recording.blocks([*STATE_NAMES, "hashes"]):
        for row, expected in enumerate(block["hashes"]):
            if not np.array_equal(hash_of({n: block[n][row] for n in STATE_NAMES}), expected):
                return f"step {begin + row} is damaged: its state does not match its hash"
    damaged = recording.damaged_member()
    if damaged is not None:
        return f"the array {damaged} is damaged: its checksum is wrong"
    first = recording.firstStep
    if first > 0:  # what came before was not recorded
        resume(recording, first, simulation)
    for begin, block in recording.blocks(["hashes", "times"]):
        for step, (expected, when) in enumerate(
            zip(block["hashes"], block["times"], strict=True), start=begin
        ):
            simulation.settings = restored_settings(recording, step, simulation.settings)
            if step > first:
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
    furthest = {name: np.max(np.abs(state[name] - other[name])) for name in STATE_NAMES}
    name = max(furthest, key=furthest.get)
    return f"{name} by up to {furthest[name]:.3g}"


# ---------------------------------------------------------------------------------------------
# Recording
# ---------------------------------------------------------------------------------------------

WHOLE_NAME = "whole.tmp"
# What a crash may cost: the states since the last chunk, a second's worth, or a hundredth of the
# run where that is more. So a run of a day leaves hundreds of files, not a hundred thousand.
CHUNK_SECONDS = 1.0
CHUNK_SHARE = 0.01


def _write_npz(part, path, rows, head):
    """Writes an .npz file as `part`, brings it to the disk and renames it; or leaves nothing.

    rows : dict of (shape, blocks that follow each other); head : dict of what is small
    """
    head = {name: np.asarray(value) for name, value in head.items()}
    arrays = rows | {name: (value.shape, [value]) for name, value in head.items()}
    try:
        with open(part, "wb") as file, zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
            for name, (shape, blocks) in arrays.items():
                dtype = np.dtype(SERIES[name][0]) if name in SERIES else head[name].dtype
                _write_member(archive, name, shape, dtype, blocks)
        put_in_place(part, path)
    except BaseException:
        with suppress(OSError):
            Path(part).unlink(missing_ok=True)
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
    """The rows of one array through several files, BLOCK_BYTES at a time."""
    for file in files:
        dtype, shape, _ = file.member(name)
        atOnce = max(1, BLOCK_BYTES // (math.prod(shape[1:]) * dtype.itemsize))
        for begin in range(0, shape[0], atOnce):
            yield file.rows([name], begin, min(begin + atOnce, shape[0]))[name]


def _join_chunks(files, partPath, path, head):
    """Makes one recording of chunks, in place of an old file, and removes their folder.

    files : list of _File; head : what the recording holds beside the states
    raises OSError or RecordingError, and then leaves everything as it was
    """
    rows = {}
    for name in SERIES:
        count = sum(file.member(name).shape[0] for file in files)
        rows[name] = (count, *files[0].member(name).shape[1:]), _joined(files, name)
    with named_errors(path):
        _write_npz(partPath / WHOLE_NAME, path, rows, head)
    # From here on the chunks are not needed, and what of them cannot be removed does no harm.
    shutil.rmtree(partPath, ignore_errors=True)


def finish(path):
    """Makes FILE.npz of the chunks that a killed run has left in FILE.npz.part/, and removes them.

    The file has the very bytes that `Recorder.save` would have written after the last chunk. While
    it is written the states are on the disk twice, and in memory there are BLOCK_BYTES of them.

    path : FILE.npz or FILE.npz.part
    returns (path of FILE.npz, first step, last step)
    raises RecordingError, also where there is another FILE.npz already, or where the run has not
    ended, or OSError; then nothing changes
    """
    path = Path(path)
    if path.suffix == PART_ENDING:
        path = path.with_suffix("")
    partPath = part_of(path)
    if not partPath.is_dir():
        raise RecordingError(path, f"there is no interrupted recording of it, {partPath.name}")
    lock = _lock(partPath)
    try:
        recording = Recording(partPath, mustBeFinite=False)
        if path.exists():
            _check_holds(path, recording)
            shutil.rmtree(partPath)
        else:
            damaged = recording.damaged_member()
            if damaged is not None:
                raise RecordingError(path, f"cannot be made, the array {damaged} is damaged")
            _join_chunks(recording.files, partPath, path, recording.head())
    finally:
        if lock is not None:
            os.close(lock)
    return path, recording.firstStep, recording.lastStep


def _lock(partPath):
    """The descriptor that keeps a recording's folder, or None; RecordingError if it is in use."""
    try:
        return lock_folder(partPath)
    except BlockingIOError:
        raise RecordingError(partPath, "a program is still recording into it") from None


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
        path, f"there is another one already; rename it, or remove {part_of(path).name}"
    )


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
        self.partPath = part_of(self.path)
        try:
            # Now: a missing folder, or missing rights, are found out before hours are spent.
            self.partPath.mkdir()
        except FileExistsError:
            # A run that ended before its first chunk leaves an empty folder, which will do.
            if not self.partPath.is_dir() or any(self.partPath.glob(f"{CHUNK_PREFIX}*.npz")):
                raise RecordingError(
                    self.partPath,
                    "an interrupted recording is kept here; make a file of it with --finish, look "
                    "at it with --replay, or remove it",
                ) from None
        except OSError as error:
            error.filename = str(path)  # the name that the caller knows
            raise
        self._folderLock = _lock(self.partPath)
        self.frameCount = 0
        self._chunks = []  # paths
        self._frames = []
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
        step = self._firstStep + self.frameCount
        if simulation.meshes is not self._meshes or simulation.stepCount != step:
            raise RecordingError(self.path, f"only step {step} of the same scene could follow")
        state = simulation.state()
        self._frames.append({**state, "times": simulation.time, "hashes": hash_of(state)})
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

    def save(self):
        """Writes the file, in place of an old one of that name: whole or not at all."""
        self._write_chunk()
        files = [_File(path) for path in self._chunks]
        _join_chunks(files, self.partPath, self.path, self._head(0))
        self._chunks = []
        self._unlock()

    def _unlock(self):
        if self._folderLock is not None:
            os.close(self._folderLock)
            self._folderLock = None

    def close(self):
        """Keeps in FILE.npz.part/ what has not been saved; removes it where there is nothing.

        returns the path of the folder if something is kept there, else None
        """
        with suppress(OSError):  # the disk may be full: what is on it is kept
            self._write_chunk()
        self._frames = []
        self._unlock()
        if self._chunks:
            return self.partPath
        if self.partPath.is_dir():
            shutil.rmtree(self.partPath, ignore_errors=True)
        return None

    def _write_chunk(self):
        if not self._frames:
            return
        series = {name: np.array([frame[name] for frame in self._frames]) for name in SERIES}
        rows = {name: (values.shape, [values]) for name, values in series.items()}
        path = self.partPath / f"{CHUNK_PREFIX}{len(self._chunks):06d}.npz"
        with named_errors(self.path):
            head = self._head(self.frameCount - len(self._frames))
            _write_npz(path.with_suffix(".tmp"), path, rows, head)
        self._chunks.append(path)
        self._frames = []
        self._lastChunk = time.monotonic()

    def _head(self, first):
        """What a file holds beside the states. first : the place of its first state, from 0."""
        return {
            "firstStep": self._firstStep + first,
            "settingsHistory": json.dumps(self._history),
            **self._history[-1][1],
            "maxIterations": min(self._maxIterations, np.iinfo(np.int64).max),
            "scene": self._scene,
            "constraints": self._constraints,
            "meshNames": np.array([mesh.name for mesh in self._meshes], dtype=np.str_),
            "version": __version__,
            "numpyVersion": np.__version__,
            "format": FORMAT,
        }


# ---------------------------------------------------------------------------------------------
# Statistics
# ---------------------------------------------------------------------------------------------

# What `step_quantities` gives, each with its unit. A phase's time is called after the phase.
PHASES = ("gather", "integrate", "collisions", "ground", "constraints", "vertices")
QUANTITY_UNITS = {
    "time": "s",
    "kineticEnergy": "J",
    "potentialEnergy": "J",
    "totalEnergy": "J",
    **{f"momentum{axis}": "kg m/s" for axis in "XYZ"},
    **{f"angularMomentum{axis}": "kg m²/s" for axis in "XYZ"},
    "largestViolation": "m",
    "deepestPenetration": "m",
    "contacts": "",
    "candidatePairs": "",
    "constraintVisits": "",
    **{f"{phase}Time": "ms" for phase in PHASES},
}


def step_quantities(simulation):
    """The numbers about a simulation's present step, or a replay's: dict of the names above.

    What only the step itself can tell, from `deepestPenetration` on, is NaN before the first step
    and in a replay. The deepest penetration is that which contacts were found with, before they
    were corrected; without a contact it is 0.
    """
    kinetic, potential = simulation.kinetic_energy(), simulation.potential_energy()
    values = [
        simulation.time,
        kinetic,
        potential,
        kinetic + potential,
        *simulation.momentum().tolist(),
        *simulation.angular_momentum().tolist(),
        simulation.largest_violation(),
    ]
    report = simulation.report
    if report is not None:
        contacts = report.contacts
        values += [
            max((contact.depth for contact in contacts), default=0.0),
            len(contacts),
            report.candidatePairs,
            report.constraintVisits,
            *(1e3 * report.seconds.get(phase, 0.0) for phase in PHASES),
        ]
    values += [math.nan] * (len(QUANTITY_UNITS) - len(values))
    return dict(zip(QUANTITY_UNITS, values, strict=True))


class StatsWriter:
    """Writes `step_quantities` of every step into a .csv file, as they come, and may plot them.

    A column each, named "name (unit)", after the number of the step; a number that is unknown is
    left out. They go to FILE.csv.part line by line, which stays where the run does not end well.
    """

    def __init__(self, path=None, plotPath=None):
        """path, plotPath : of the .csv and the .png; of the two, one may be None

        raises OSError when nothing can be written there, ImportError when nothing can be plotted
        """
        if plotPath is not None:
            check_plotting()
        self.path = None if path is None else Path(path)
        self.plotPath = None if plotPath is None else Path(plotPath)
        for target in (self.path, self.plotPath):
            if target is not None:
                check_target(target)
        table = self.path or self.plotPath.with_name(self.plotPath.name + ".csv")
        self.partPath = part_of(table)
        with named_errors(path or plotPath):  # the name that the caller knows
            self._file = open(self.partPath, "w", encoding="utf-8", newline="", buffering=1)
        self._writer = csv.writer(self._file, lineterminator="\n")
        self._isEmpty = True

    def add(self, simulation):
        """Writes the line of the simulation's present step; raises OSError."""
        values = step_quantities(simulation).values()
        values = ["" if math.isnan(value) else value for value in values]
        with named_errors(self.path or self.plotPath):
            if self._isEmpty:
                names = [f"{name} ({unit})" if unit else name
                         for name, unit in QUANTITY_UNITS.items()]  # fmt: skip
                self._writer.writerow(["step", *names])
                self._isEmpty = False
            self._writer.writerow([simulation.stepCount, *values])

    def save(self, title=""):
        """Plots, with that title, and puts the file in its place, instead of an old one."""
        with named_errors(self.path or self.plotPath):
            self._file.close()
        try:
            if self.plotPath is not None:
                plot_stats(self.partPath, self.plotPath, title)
        finally:
            if self.path is None:
                self.partPath.unlink()
            else:
                put_in_place(self.partPath, self.path)

    def close(self):
        """Keeps in FILE.csv.part what has not been saved; removes it where there is nothing.

        returns the path of what is kept, or None
        """
        with suppress(OSError):  # the disk may be full: what is on it is kept
            self._file.close()
        if self._isEmpty:
            self.partPath.unlink(missing_ok=True)
        return self.partPath if self.partPath.exists() else None


# Okabe and Ito's colours, which the colour-blind tell apart: black, orange, sky blue, green,
# vermilion, blue. The lines differ in their dashes too.
PLOT_COLOURS = ("#000000", "#E69F00", "#56B4E9", "#009E73", "#D55E00", "#0072B2")
PLOT_DASHES = ("-", "--", ":", "-.", (0, (5, 1)), (0, (3, 1, 1, 1)))
# The panels of a plot: label of the axis, its unit, the quantities, which have that unit.
PLOT_PANELS = (
    ("energy", "J", ("totalEnergy", "kineticEnergy", "potentialEnergy")),
    ("momentum", "kg m/s", ("momentumX", "momentumY", "momentumZ")),
    ("angular momentum", "kg m²/s", ("angularMomentumX", "angularMomentumY", "angularMomentumZ")),
    ("depth", "m", ("deepestPenetration", "largestViolation")),
    ("number per step", "", ("contacts", "candidatePairs", "constraintVisits")),
    ("time per step", "ms", tuple(f"{phase}Time" for phase in PHASES)),
)
# What goes over several powers of ten, and where it turns linear, since there are zeros too.
LOGARITHMIC_PANELS = {"depth": 1e-3, "number per step": 1.0, "time per step": 0.01}
PLOT_INCHES = (12.0, 10.0)
PLOT_DPI = 120


def check_plotting():
    """Raises ImportError, which says what to install, where nothing can be plotted."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise ImportError("--plot needs matplotlib. Install it: pip install matplotlib") from None


def plot_stats(csvPath, imagePath, title):
    """Draws a file of `StatsWriter` as a PNG over time; raises OSError.

    Needs matplotlib, and no display.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    table = np.genfromtxt(csvPath, delimiter=",", skip_header=1, encoding="utf-8", ndmin=2)
    columns = dict(zip(["step", *QUANTITY_UNITS], table.T, strict=True))
    figure = Figure(figsize=PLOT_INCHES, dpi=PLOT_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title)
    panels = figure.subplots(3, 2, sharex=True)
    for axes, (name, unit, quantities) in zip(panels.flat, PLOT_PANELS, strict=True):
        shown = [q for q in quantities if np.isfinite(columns[q]).any()]
        prefix = quantities[0][:-1] if quantities[0].endswith("X") else ""
        for quantity, colour, dashes in zip(shown, PLOT_COLOURS, PLOT_DASHES, strict=False):
            axes.plot(
                columns["time"], columns[quantity], color=colour, linestyle=dashes, linewidth=1.2,
                label=quantity.removesuffix("Time").removeprefix(prefix),
            )  # fmt: skip
        axes.set_ylabel(f"{name} ({unit})" if unit else name)
        axes.grid(alpha=0.3)
        if shown:
            # Above the axes, where it hides nothing.
            axes.legend(
                loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(shown), fontsize="small",
                frameon=False, borderaxespad=0.2, columnspacing=1.0, handlelength=1.8,
            )  # fmt: skip
        else:
            axes.text(0.5, 0.5, "not in a recording", ha="center", transform=axes.transAxes)
        if shown and name in LOGARITHMIC_PANELS:
            axes.set_yscale("symlog", linthresh=LOGARITHMIC_PANELS[name])
    for axes in panels[-1]:
        axes.set_xlabel("time (s)")
    with written_whole(imagePath) as file:
        figure.savefig(file, format="png")
