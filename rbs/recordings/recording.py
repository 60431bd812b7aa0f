"""Recordings: `Recorder` writes the states of a run to an HDF5 file, `Recording` reads them.

A recording includes the scene, so that it can be replayed, resumed and verified anywhere. It is
written in HDF5's single-writer-multiple-readers mode (SWMR), so that the file of a run that was
killed, or is still going, can be read up to its last flush; h5py needs `swmr=True` for that.

With s + 1 states of n bodies, the datasets are

    positions (s + 1, n, 3), orientations (s + 1, n, 4), linVelocities, angVelocities (s + 1, n, 3)
    times (s + 1,)          in s; written last, so that its length counts the complete states
    names, masses, isFixed (n,)     of the bodies at the first state: UTF-8, kg, 0 or 1
    scene, constraints (1,) texts of these files
    meshes/K/vertices, faces, tets      mesh files; the attribute file is the name in the scene
    events (e,)             lines of JSON, see `Recorder`; a long one goes on in the next row
    solverIndex (c, 3)      rows (step, begin, end), bytes of `solverStates` that hold the state of
    solverStates            the soft-step solver after that step, as an .npz file

The attributes are format, firstStep, bodies (of the scene), scene and constraints (file names),
functions and functionsFolder (of a student, or ""), version, code and numpyVersion. The attributes
of the group `settings` are the settings of the first state. Only other programs read names, masses
and isFixed, and the attributes `units` and `meaning` of datasets. All numbers are little-endian,
and all texts are strings of fixed length in UTF-8. All datasets have checksums. Rows follow the
list of bodies after that step; rows beyond its end are zero.

Units: metres, kilograms, seconds.
"""

import atexit
import io
import json
import math
import os
import subprocess
import sys
import time
from bisect import bisect_left, bisect_right
from collections import Counter
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from functools import lru_cache
from hashlib import sha256
from operator import itemgetter
from pathlib import Path

import numpy as np

import rbs
from rbs.recordings.outputs import FileWriter
from rbs.scenes.changes import assigned, from_record, to_record
from rbs.scenes.files import RECORDING_ENDINGS, named_errors
from rbs.scenes.messages import InputError, import_optional, one_line, short
from rbs.scenes.scenefiles import BodySource, SceneSource
from rbs.scenes.state import (
    ARRAY_WIDTHS,
    STATE_NAMES,
    STATE_WIDTH,
    Writer,
    arrays_of,
    interrupts_held,
    rows_of,
)

FORMAT = "rigid-body recording 1"
# The oldest HDF5 version that can read the file. Newer ones would save no space.
HDF5_VERSION = ("v110", "v110")
# Seconds between flushes. Fewer cost time; with more, a killed run loses more.
FLUSH_SECONDS = 0.5
# Bytes of states after which they are flushed in any case. Bounds the memory of large scenes.
PENDING_BYTES = 4 << 20
# Bytes of a dataset's chunk, the least that is read at once. Larger chunks make smaller files;
# smaller ones make seeking faster.
CHUNK_BYTES = 16 << 10
# Steps between recorded states of the soft-step solver. More make the file smaller; resuming from
# the middle repeats up to as many steps.
SOLVER_STEPS = 100
# What reads all metadata of a file that is being written, or whose writer was killed, and seconds
# that it may take: HDF5 waits for ever for damaged ones, in case they are still being written.
READ_METADATA = """import h5py, sys
def read(name, one):
    if isinstance(one, h5py.Dataset) and one.chunks:
        one.id.get_num_chunks()
h5py.File(sys.argv[1], swmr=True).visititems(read)"""
PATIENCE = 10.0
# The parts of a mesh, in the order of `load_mesh_file`.
MESH_PARTS = ("vertices", "faces", "tets")
# Attributes of the datasets, for other programs.
MEANINGS = {
    "positions": {"units": "m", "meaning": "centre of mass, x y z in world axes; y points up"},
    "orientations": {"units": "1", "meaning": "unit quaternion w x y z, from body to world axes"},
    "linVelocities": {"units": "m/s", "meaning": "of the centre of mass, x y z in world axes"},
    "angVelocities": {"units": "rad/s", "meaning": "angular velocity, x y z in world axes"},
    "times": {"units": "s", "meaning": "simulated time of each state"},
    "masses": {"units": "kg", "meaning": "mass of each body, also if it is fixed"},
    "isFixed": {"units": "1", "meaning": "1 if the body is fixed at the first state"},
}
# Characters of a row of events, which are ASCII. Longer rows waste space.
EVENT_LENGTH = 120
# Bytes reserved for HDF5's own tables and for chunks that are not full yet.
SPARE_BYTES = 1 << 20
# Bytes of the state of one body.
STATE_BYTES = 8 * STATE_WIDTH
# Characters, the most that are quoted of a library's message about a damaged file.
QUOTE_LENGTH = 80


def is_recording_name(path):
    """Returns whether a path has the ending of a recording."""
    return Path(path).suffix.lower() in RECORDING_ENDINGS


class RecordingError(InputError):
    """A recording that cannot be used or written. The message reads "file: cause"."""

    def __init__(self, path, cause):
        super().__init__(f"{path}: {cause}")


class Recorder(FileWriter):
    """Writes the states of a simulation to a file, one by one.

    If a file of that name exists, the recording grows beside it as FILE.part.h5, and replaces it in
    `save`. Otherwise it grows in place. A file that holds states is never removed.
    count : number of states so far

    Events are dicts with a `step` and either `settings`, valid from this step on, or `change`, made
    by hand before it; see `rbs.scenes.changes`. Direct assignments are recorded as changes.
    """

    label, needsEachStep, package = "recording", True, "h5py"
    _open = {}  # by the path of the file that it writes

    def __init__(self, path):
        """Creates the file. Raises OSError, naming `path`, RecordingError, or OutputError."""
        super().__init__(path)
        self._file, self.count = None, 0
        if self.target in self._open:
            raise RecordingError(path, "it is being recorded already")
        self.begin()
        self._file = self.module.File(self.partial, "w", libver=HDF5_VERSION)
        self._open[self.target] = self
        self._ends = Counter()  # lengths of the datasets
        self._states, self._events, self._solverStates = [], [], []

    def begin(self):
        """Creates the file, in place if there is none yet. Raises OSError, naming `path`."""
        if self.target.exists():
            super().begin()
        else:
            with named_errors(self.path):
                self.target.touch()
            self.partial = self.target

    def add(self, simulation):
        """Records the present state of the simulation.

        Raises RecordingError unless it is one step after the last state, in the same scene, and
        OSError if it cannot be written.
        """
        if self.count == 0:
            self._begin(simulation)
        step = self._firstStep + self.count
        if simulation.source is not self._source or simulation.stepCount != step:
            raise RecordingError(self.path, f"expected step {step} of the same scene")
        if len(simulation.meshes) != self._bodyCount:
            self.flush()
            self._bodyCount = len(simulation.meshes)
        if simulation.settings != self._settings:
            self._settings = replace(simulation.settings)
            self._events.append({"step": step, "settings": asdict(self._settings)})
        self._known = simulation.state()
        self._solver = simulation.solverState
        if self.count % SOLVER_STEPS == 0:
            self._keep_solver_state(step)
        self._states.append((self._known.rows[:, :STATE_WIDTH].copy(), simulation.time))
        self.count += 1
        isLate = time.monotonic() - self._lastFlush >= FLUSH_SECONDS
        size = len(self._states) * self._bodyCount * STATE_BYTES
        if isLate or size >= PENDING_BYTES:
            self.flush()

    def before(self, simulation, body=None):
        """Records what has been assigned to one body, or to all, since the last state or change."""
        ground = simulation.groundMesh
        if ground is None or np.any(ground.linVelocity) or np.any(ground.angVelocity):
            raise RecordingError(self.path, "without a ground at rest, a run cannot be recorded")
        if simulation.time != self._known.time:
            raise RecordingError(self.path, "the time of a run that is recorded cannot be changed")
        for change in assigned(self._known, simulation, body):
            self.note(simulation, change)

    def note(self, simulation, change):
        """Records a `Change` that was made since the last recorded state."""
        self._events.append({"step": simulation.stepCount + 1, "change": to_record(change)})
        if change.isOfOneBody:
            (self._known.rows[change.body],) = rows_of(simulation.meshes, [change.body])
        else:
            self._known = simulation.state()

    def flush(self):
        """Writes all states so far to the file, so that other programs see them."""
        if not (self._states or self._events or self._solverStates):
            return
        states, times = zip(*self._states, strict=True) if self._states else ((), ())
        rows = arrays_of(np.array(states)) if states else {}
        lines = [json.dumps(event) + "\n" for event in self._events]
        pieces = [
            line[k : k + EVENT_LENGTH] for line in lines for k in range(0, len(line), EVENT_LENGTH)
        ]
        rows["events"] = np.array([piece.encode() for piece in pieces], f"S{EVENT_LENGTH}")
        content = b"".join(content for _, content in self._solverStates)
        rows["solverStates"] = np.frombuffer(content, np.uint8)
        end, index = self._ends["solverStates"], []
        for step, content in self._solverStates:
            index.append((step, end, end + len(content)))
            end += len(content)
        self._check_room(sum(values.nbytes for values in rows.values()))
        for name, values in rows.items():
            self._write_rows(name, values)
        self._file.flush()
        # Last, so that a reader finds all data that they refer to.
        last = {"solverIndex": np.array(index, dtype="<i8"), "times": np.array(times)}
        for name, values in last.items():
            self._write_rows(name, values)
        self._file.flush()
        self._ends.update({name: len(values) for name, values in (rows | last).items()})
        self._states, self._events, self._solverStates = [], [], []
        self._lastFlush = time.monotonic()

    def save(self, simulation=None):
        """Ends the recording after the last state, and puts the file in place.

        A recording without a state is removed. Raises OSError if it cannot be written.
        """
        if self._file is None:
            return
        with interrupts_held():
            if self.count:
                super().save(simulation)
            else:
                self.close()

    def write(self, simulation):
        """Writes what is left, and closes the file."""
        self._keep_solver_state(self._firstStep + self.count - 1)
        self.flush()
        self._end()

    def _end(self):
        self._file.close()
        self._file = None
        del self._open[self.target]

    def close(self):
        """Ends a recording that was not saved. An old file stays, and FILE.part.h5 beside it."""
        if self._file is not None:
            with suppress(OSError):  # the last flush stays
                self.flush()
            self._end()
        if self.partial is not None and self.count:
            self.partial = None
        super().close()

    @classmethod
    def close_all(cls):
        """Ends what is still recorded when the program ends, as by a generator that goes on."""
        for one in list(cls._open.values()):
            one.close()

    @classmethod
    def leave_to_parent(cls):
        """Makes all recorders of a forked process do nothing: its parent writes the files."""
        for one in cls._open.values():
            one.__class__ = Writer

    def _begin(self, simulation):
        """Writes the scene and the settings, and creates the datasets of the states."""
        file, source, submitted = self._file, simulation.source, simulation.submitted
        self._source, self._firstStep = source, simulation.stepCount
        self._bodyCount = len(simulation.meshes)
        self._settings = replace(simulation.settings)
        initial = [*simulation.changes, *assigned(simulation.accounted_state(), simulation)]
        self._events = [{"step": self._firstStep, "change": to_record(one)} for one in initial]
        meshes = [array.nbytes for arrays in source.shapes.values() for array in arrays]
        scene, constraints = (text.encode() for text in (source.scene, source.constraints))
        self._check_room(sum(meshes) + len(scene) + len(constraints))
        _set_attributes(
            file,
            {
                "format": FORMAT,
                "firstStep": self._firstStep,
                "bodies": simulation.sceneCount,
                "scene": _shown_name(source.path),
                "constraints": _shown_name(source.constraintPath),
                "functions": "" if submitted is None else submitted.digest,
                "functionsFolder": "" if submitted is None else _shown_name(submitted.folder),
                "version": rbs.__version__,
                "code": code_digest(),
                "numpyVersion": np.__version__,
            },
        )
        _set_attributes(file.create_group("settings"), asdict(self._settings))
        self._write_texts("scene", [scene])
        self._write_texts("constraints", [constraints])
        for k, (fileName, arrays) in enumerate(source.shapes.items()):
            _set_attributes(file.create_group(f"meshes/{k}"), {"file": fileName})
            for part, values in zip(MESH_PARTS, arrays, strict=True):
                self._write_whole(f"meshes/{k}/{part}", values)
        names = [str(mesh.name).encode("utf-8", "backslashreplace") for mesh in simulation.meshes]
        self._write_texts("names", names)
        self._write_whole("masses", np.array([mesh.mass for mesh in simulation.meshes], "<f8"))
        self._write_whole("isFixed", np.array([mesh.isFixed for mesh in simulation.meshes], "u1"))
        for name, width in ARRAY_WIDTHS.items():
            self._make_series(name, "<f8", (self._bodyCount, width), (None, width))
        self._make_series("times", "<f8")
        for name, meaning in MEANINGS.items():
            if name in file:  # a scene may have no bodies
                _set_attributes(file[name], meaning)
        self._make_series("events", f"S{EVENT_LENGTH}")
        self._make_series("solverIndex", "<i8", (3,), (3,))
        self._make_series("solverStates", "u1")
        file.swmr_mode = True
        self._lastFlush = 0.0

    def _check_room(self, size):
        """Raises OSError unless the disk has room for `size` bytes and HDF5's own tables.

        HDF5 crashes if one of its writes fails. Windows and macOS cannot check without writing.
        """
        if hasattr(os, "posix_fallocate"):
            descriptor = self._file.id.get_vfd_handle()
            end = os.fstat(descriptor).st_size
            with named_errors(self.path):
                os.posix_fallocate(descriptor, end, size + SPARE_BYTES)
                os.ftruncate(descriptor, end)

    def _write_whole(self, name, values):
        """Writes a dataset of fixed size. Checksums need chunks, which must not be empty."""
        checked = {"chunks": values.shape, "fletcher32": True} if values.size else {}
        self._file.create_dataset(name, data=values, **checked)

    def _write_texts(self, name, contents):
        """Writes a dataset of strings, given as bytes. Strings have a fixed length."""
        length = max(map(len, contents), default=0)
        self._write_whole(
            name, np.array(contents, self.module.string_dtype("utf-8", max(length, 1)))
        )

    def _make_series(self, name, dtype, row=(), mostRow=()):
        """Creates an empty dataset that can grow along axis 0, and where mostRow is None."""
        rowBytes = np.dtype(dtype).itemsize * math.prod(row)
        self._file.create_dataset(
            name,
            (0, *row),
            dtype,
            maxshape=(None, *mostRow),
            chunks=(max(1, CHUNK_BYTES // rowBytes), *row),
            fletcher32=True,
        )

    def _write_rows(self, name, values):
        """Writes rows after those of the last flush; once again if that failed half-way."""
        if len(values):
            dataset, begin = self._file[name], self._ends[name]
            grown = np.maximum(dataset.shape[1:], values.shape[1:])
            dataset.resize((begin + len(values), *grown.tolist()))
            dataset[(slice(begin, None), *map(slice, values.shape[1:]))] = values

    def _keep_solver_state(self, step):
        content = io.BytesIO()
        np.savez(content, **self._solver.arrays())
        self._solverStates.append((step, content.getvalue()))


atexit.register(Recorder.close_all)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=Recorder.leave_to_parent)


class Recording:
    """A recording, read state by state; it is never in memory as a whole.

    path, firstStep, lastStep
    source : SceneSource
    settingsHistory : list of (step, dict), the settings from that step on
    changes : list of (step, Change), made by hand before that step, or before the recording
    functions, functionsFolder : digest of the student's functions and name of their folder, or ""
    code, numpyVersion : of the program that recorded it; see `code_digest`
    """

    def __init__(self, path):
        """Reads all but the states. Raises RecordingError, or InputError without h5py."""
        self.path = Path(path)
        h5py = import_optional("h5py", path, InputError)
        try:
            open(path, "rb").close()
        except OSError as error:
            raise self.error(f"cannot be read ({one_line(error)})") from None
        if not h5py.is_hdf5(path):
            raise self.error("not a recording")
        try:
            self._file = _open(h5py, path)
        except OSError as error:
            raise self.damage(error) from None
        with self.reading():
            head = _attributes_of(self._file)
            if head.get("format") != FORMAT:
                raise self.error("an HDF5 file, but not a recording")
            self.firstStep = int(head["firstStep"])
            self.lastStep = self.firstStep + self._file["times"].shape[0] - 1
            if self.lastStep < self.firstStep:
                raise self.error("it has no states")
            for name in ("functions", "functionsFolder", "numpyVersion"):
                setattr(self, name, head[name])
            self.code = head.get("code", "")
            self.source = self._read_source(head)
            self._read_events(head)

    def error(self, cause):
        """Returns a RecordingError about this recording, for the caller to raise."""
        return RecordingError(self.path, cause)

    def damage(self, error):
        """Returns a RecordingError about damage, which a library's exception has told."""
        return self.error(f"it is damaged ({short(error, limit=QUOTE_LENGTH)})")

    def close(self):
        """Closes the file, after which nothing can be read."""
        self._file.close()

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self.close()

    @contextmanager
    def reading(self):
        """Turns any error about damaged bytes into a RecordingError."""
        if not self._file:
            raise self.error("it has been closed")
        try:
            yield
        except RecordingError:
            raise
        except Exception as error:  # from h5py, JSON, zipfile or NumPy
            raise self.damage(error) from None

    def _read_source(self, head):
        path, constraintPath = (self.path.parent / head[name] for name in ("scene", "constraints"))
        text, constraints = (self._file[name][0].decode() for name in ("scene", "constraints"))
        kind = BodySource if text.startswith('{"bodies"') else SceneSource
        source = kind(path, text)
        if head["constraints"]:
            source.constraintPath, source.constraints = constraintPath, constraints
        meshes = self._file["meshes"]
        for k in range(len(meshes)):
            group = meshes[str(k)]
            fileName = _attributes_of(group)["file"]
            source.shapes[fileName] = tuple(group[part][()] for part in MESH_PARTS)
        return source

    def _read_events(self, head):
        self.settingsHistory = [(self.firstStep, _attributes_of(self._file["settings"]))]
        self.changes, counts = [], [(self.firstStep - 1, int(head["bodies"]))]
        for line in b"".join(self._file["events"][()].tolist()).decode().splitlines():
            event = json.loads(line)
            if event["step"] > self.lastStep:  # the run was killed before this step
                continue
            if "settings" in event:
                self.settingsHistory.append((event["step"], event["settings"]))
            else:
                step, change = event["step"], from_record(event["change"])
                self.changes.append((step, change))
                if grows := {"add": 1, "remove": -1}.get(change.kind):
                    counts.append((step, counts[-1][1] + grows))
        self._bodyCounts = counts

    def origin(self):
        """Returns what made the recording, in parentheses, or "" if it is what runs here.

        Other code may step otherwise. Another NumPy may change the last bits of a sum, and then all
        that follows.
        """
        told = ["by another version of the program"] * (self.code != code_digest())
        if self.numpyVersion != np.__version__:
            told.append(f"with NumPy {self.numpyVersion}, now NumPy {np.__version__}")
        return f" (recorded {', '.join(told)})" if told else ""

    def body_count(self, step):
        """Returns the number of bodies after a step."""
        return self._bodyCounts[bisect_right(self._bodyCounts, step, key=itemgetter(0)) - 1][1]

    def changes_before(self, step):
        """Returns the changes made by hand before a step."""
        ends = (
            bisect(self.changes, step, key=itemgetter(0)) for bisect in (bisect_left, bisect_right)
        )
        return [change for _, change in self.changes[slice(*ends)]]

    def frame(self, step):
        """Returns the state after a step: the dict of `Scene.state`, with the float `times`.

        Raises RecordingError, also if the step is not between firstStep and lastStep.
        """
        if not self.firstStep <= step <= self.lastStep:
            raise self.error(
                f"step {step} is not recorded, only steps {self.firstStep} to {self.lastStep} are"
            )
        row, count = step - self.firstStep, self.body_count(step)
        with self.reading():
            frame = {name: self._file[name][row, :count] for name in STATE_NAMES}
            return {**frame, "times": float(self._file["times"][row])}

    def solver_state(self, step):
        """Returns the last solver state up to a step: (its step, dict of arrays)."""
        with self.reading():
            index = self._file["solverIndex"][()]
            kept, begin, end = index[index[:, 0] <= step][-1].tolist()
            content = self._file["solverStates"][begin:end].tobytes()
            with np.load(io.BytesIO(content)) as arrays:
                return kept, dict(arrays)

    def settings_at(self, step):
        """Returns the settings of a step: (first step with them, dict by field)."""
        steps = [first for first, _ in self.settingsHistory]
        return self.settingsHistory[max(0, bisect_right(steps, step) - 1)]


def _open(h5py, path):
    """Opens an HDF5 file for reading, even if it is being written, or its writer was killed."""
    with suppress(OSError):
        # unlike the default driver, this one does not mind how others have opened the file
        return h5py.File(path, "r", driver="stdio", locking=False)
    try:
        return h5py.File(path, "r")
    except OSError as error:
        if "already open for write" not in str(error):
            raise
    try:
        command = [sys.executable, "-c", READ_METADATA, path]
        subprocess.run(command, capture_output=True, timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        raise OSError("cut off while it was being written") from None
    return h5py.File(path, "r", swmr=True)


def _shown_name(path):
    """Returns a file's name, or "" for None. Bytes that are not Unicode become `?`."""
    return "" if path is None else path.name.encode("utf-8", "replace").decode("utf-8")


@lru_cache
def code_digest():
    """Returns a digest of the source that makes steps."""
    folder = Path(rbs.__file__).parents[1]
    parts = "geometry", "stepping", "softstep"
    files = [folder / f"{name}.py" for name in ("GJK", "Quaternion", "RBSFunctions")]
    files += sorted(one for part in parts for one in (folder / "rbs" / part).glob("*.py"))
    return sha256(b"".join(one.read_bytes() for one in files)).hexdigest()


def _set_attributes(group, values):
    """Sets attributes of a group. Texts get a fixed length, because only these have checksums."""
    import h5py

    for name, value in values.items():
        if isinstance(value, str):
            content = value.encode("utf-8")
            value = np.array(content, h5py.string_dtype("utf-8", max(1, len(content))))
        group.attrs[name] = h5py.Empty("<i8") if value is None else value


def _attributes_of(group):
    """Returns the attributes of a group as a dict of Python values."""
    import h5py

    found = {}
    for name, value in group.attrs.items():
        if isinstance(value, bytes):
            value = value.decode("utf-8")
        elif isinstance(value, h5py.Empty):
            value = None
        found[name] = value.tolist() if isinstance(value, np.generic | np.ndarray) else value
    return found
