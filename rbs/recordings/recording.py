"""Recordings: `Recorder` writes the states of a simulation to an HDF5 file, `Recording` reads them.

A recording includes the scene, so that it can be replayed, resumed and verified anywhere. It is
written in HDF5's single-writer-multiple-readers mode (SWMR), so that the file of a run that was
killed, or is still going, can be read up to its last flush; h5py needs `swmr=True` for that.

With s + 1 states of n bodies, the datasets are

    positions (s + 1, n, 3)         m, centres of mass, in world axes as all vectors
    orientations (s + 1, n, 4)      unit quaternions w x y z, from body to world axes
    linVelocities, angVelocities (s + 1, n, 3)      m/s and rad/s
    times (s + 1,)          s; written last, so that its length counts the complete states
    names, masses, isFixed (n,)     of the bodies at the first state: UTF-8, kg, 0 or 1
    scene, constraints (1,) texts of these files
    meshes/K/vertices, faces, tets      mesh files; the attribute file is the name in the scene
    events (e,)             lines of JSON, see `Recorder`; a long one goes on in the next row
    solverIndex (c, 3)      rows (step, begin, end), bytes of `solverStates` that hold the state of
    solverStates            the soft-step solver after that step, as an .npz file

The attributes are format, firstStep, bodies (of the scene), scene and constraints (file names),
functions and functionsFolder (of a student, or ""), version, code and numpyVersion. The attributes
of the group `settings` are the settings of the first state. Only other programs read names, masses
and isFixed. All numbers are little-endian, and all texts are strings of fixed length in UTF-8. All
datasets have checksums. Rows follow the list of bodies after that step; rows beyond its end are
zero.
"""

import atexit
import io
import json
import math
import time
from bisect import bisect_left, bisect_right
from collections import Counter
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import asdict, replace
from functools import lru_cache
from hashlib import sha256
from operator import itemgetter
from pathlib import Path

import numpy as np

import rbs
from rbs.recordings.outputs import FileWriter
from rbs.scenes.files import check_readable, interrupts_held, named_errors
from rbs.scenes.messages import InputError, import_optional, one_line, short
from rbs.scenes.scenefiles import BodySource, SceneSource
from rbs.scenes.state import COLUMNS, STATE_NAMES, STATE_WIDTH, Change, arrays_of, changes_since
from rbs.stepping.meshes import STATE_WIDTHS, checked_numbers

FORMAT = "rigid-body recording 1"
# The oldest HDF5 version that can read the file. Newer ones would save no space.
HDF5_VERSION = ("v110", "v110")
# Seconds between flushes. Fewer cost time; with more, a killed run loses more, and takes memory.
FLUSH_SECONDS = 0.5
# Bytes of a dataset's chunk, the least that is read at once. Larger chunks make smaller files;
# smaller ones make seeking faster.
CHUNK_BYTES = 16 << 10
# Steps between recorded states of the soft-step solver. More make the file smaller; resuming from
# the middle repeats up to as many steps.
SOLVER_STEPS = 100
# Where an HDF5 file says how long it is: bytes of its beginning.
LENGTH_BYTES = slice(28, 36)
# The parts of a mesh, in the order of `load_mesh_file`.
MESH_PARTS = ("vertices", "faces", "tets")
# A row of events, which are ASCII. Longer rows waste space.
EVENT = np.dtype("S120")
# The datasets that grow, with the types and the sizes of a row, None for that of the bodies. The
# last two are written after the others, so that a reader finds all data that they refer to.
SERIES = {name: ("<f8", None, one.stop - one.start) for name, one in COLUMNS.items()}
SERIES |= {"events": (EVENT,), "solverStates": ("u1",)}
LAST_SERIES = {"solverIndex": ("<i8", 3), "times": ("<f8",)}
# Bytes by which the file is longer than its content, so that pending rows can still be written on a
# full disk; and the same for HDF5's own tables, and for chunks that are not full yet. With more,
# each flush writes more; with fewer, there are more flushes.
PENDING_BYTES, SPARE_BYTES = 1 << 20, 1 << 20
# Characters, the most that are quoted of a library's message about a damaged file.
QUOTE_LENGTH = 80


class RecordingError(InputError):
    """A recording that cannot be used or written. The message reads "file: cause"."""


class Recorder(FileWriter):
    """Writes the states of a simulation to a file, one by one.

    If a file of that name exists, the recording grows beside it as FILE.part.h5, and replaces it in
    `save`. Otherwise it grows in place. A file that holds states is never removed.
    count : number of states so far

    Events are dicts with a `step` and either `settings`, valid from this step on, or `change`,
    which was made before it; see `rbs.scenes.state`.
    """

    label, needsEachStep, package = "recording", True, "h5py"
    running = {}  # by the path of the file that each writes

    def __init__(self, path):
        """Creates the file. Raises OSError, naming `path`, RecordingError, or OutputError."""
        super().__init__(path)
        self._file, self.count, self._lastFlush = None, 0, 0.0
        if self.target in self.running:
            raise RecordingError(f"{path}: it is being recorded already")
        self.begin()
        self._file = self.module.File(self.partial, "w", libver=HDF5_VERSION)
        self.running[self.target] = self
        # rows of each dataset: the numbers of those written, and those still to be written
        self._ends, self._solverEnd, self._room, self._most = Counter(), 0, 0, PENDING_BYTES
        self._states, self._pending = [], {name: [] for name in SERIES | LAST_SERIES}

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
        step = self._nextStep
        if simulation.source is not self._source or simulation.stepCount != step:
            raise RecordingError(f"{self.path}: expected step {step} of the same scene")
        if simulation.settings != self._settings:
            self._settings = replace(simulation.settings)
            self._add_event(settings=asdict(self._settings))
        if self._states and len(self._states[0]) != len(simulation.meshes):
            self.flush()
        known, self._solver = simulation.state(), simulation.solverState
        if self.count % SOLVER_STEPS == 0:
            self._add_solver_state(step)
        self._take_room(known.rows.nbytes)
        self._known = known
        self._states.append(known.rows[:, :STATE_WIDTH])
        self._pending["times"].append([simulation.time])
        self.count += 1
        if time.monotonic() - self._lastFlush >= FLUSH_SECONDS or self._room < known.rows.nbytes:
            self.flush()

    @property
    def _nextStep(self):
        return self._firstStep + self.count

    def before(self, simulation):
        """Records what has been done to the bodies since the last state."""
        ground = simulation.groundMesh
        if ground is not None and (ground.linVelocity.any() or ground.angVelocity.any()):
            cause = "with a ground that moves, a run cannot be recorded"
            raise RecordingError(f"{self.path}: {cause}")
        if simulation.time != self._known.time:
            raise RecordingError(f"{self.path}: the time of a recorded run cannot be changed")
        if changes := changes_since(self._known, simulation):
            self._add_changes(changes)
            self._known = simulation.state()

    def flush(self, isLast=False):
        """Writes all states so far to the file, so that other programs see them.

        Raises OSError if the disk has no room for more.
        """
        rows = {name: np.concatenate(parts) for name, parts in self._pending.items() if parts}
        if self._states:
            rows |= arrays_of(np.array(self._states))
        if not rows:
            return
        for names in (SERIES, LAST_SERIES):
            for name in filter(rows.__contains__, names):
                self._write_rows(name, rows[name])
            self._file.flush()
        self._ends.update({name: len(values) for name, values in rows.items()})
        self._states, self._pending = [], {name: [] for name in self._pending}
        self._lastFlush = time.monotonic()
        if not isLast:
            self._reserve(self._most)

    def save(self, simulation=None, isWhole=True):
        """Ends the recording after the last state, and puts the file in place, as `FileWriter`.

        A recording without a state is removed. Raises OSError if it cannot be written.
        """
        if self._file is None:
            return
        with interrupts_held():
            if self.count:
                super().save(simulation, isWhole)
            else:
                self.close()

    def write(self, simulation):
        self._add_solver_state(self._nextStep - 1)
        self._end()

    def _end(self):
        try:
            self.flush(isLast=True)
        finally:
            self._file.close()
            self._file = None
            del self.running[self.target]
        with open(self.partial, "rb+") as file:
            file.truncate(int.from_bytes(file.read(LENGTH_BYTES.stop)[LENGTH_BYTES], "little"))

    def close(self):
        """Ends a recording that was not saved. An old file stays, and FILE.part.h5 beside it."""
        if self._file is not None:
            with suppress(OSError):  # the last flush stays
                self._end()
        if self.count and self.partial is not None:
            self.keep()
        super().close()

    def kept(self):
        return f"steps {self._firstStep} to {self._nextStep - 1}"

    def _begin(self, simulation):
        """Writes the scene and the settings, and creates the datasets of the states."""
        file, source, submitted = self._file, simulation.source, simulation.submitted
        self._source, self._firstStep = source, simulation.stepCount
        self._settings, self._known = replace(simulation.settings), simulation.state()
        changes = changes_since(simulation.startState, simulation)
        # the first state has the rest
        self._add_changes(one for one in changes if not (one.isInState and simulation.stepCount))
        meshes, names = simulation.meshes, [str(mesh.name) for mesh in simulation.meshes]
        datasets = {"scene": _texts([source.scene]), "constraints": _texts([source.constraints])}
        datasets["names"] = _texts(names)
        datasets["masses"] = np.array([mesh.mass for mesh in meshes], "<f8")
        datasets["isFixed"] = np.array([mesh.isFixed for mesh in meshes], "u1")
        for k, arrays in enumerate(source.shapes.values()):
            names = [f"meshes/{k}/{part}" for part in MESH_PARTS]
            datasets |= dict(zip(names, arrays, strict=True))
        self._reserve(sum(values.nbytes for values in datasets.values()))
        for name, values in datasets.items():
            # checksums need chunks, which must not be empty
            checked = {"chunks": values.shape, "fletcher32": True} if values.size else {}
            file.create_dataset(name, data=values, **checked)
        header = {
            "format": FORMAT,
            "firstStep": self._firstStep,
            "bodies": simulation.sceneCount,
            "scene": source.path.name,
            "constraints": getattr(source.constraintPath, "name", ""),
            "functions": "" if submitted is None else submitted.digest,
            "functionsFolder": "" if submitted is None else submitted.folder.name,
            "version": rbs.__version__,
            "code": code_digest(),
            "numpyVersion": np.__version__,
        }
        _set_attributes(file, header)
        _set_attributes(file.create_group("settings"), asdict(self._settings))
        for k, fileName in enumerate(source.shapes):
            _set_attributes(file[f"meshes/{k}"], {"file": fileName})
        for name, (dtype, *most) in (SERIES | LAST_SERIES).items():
            row = [max(len(meshes), 1) if size is None else size for size in most]
            chunk = CHUNK_BYTES // (np.dtype(dtype).itemsize * math.prod(row))
            form = {"maxshape": (None, *most), "chunks": (max(1, chunk), *row)}
            file.create_dataset(name, (0, *row), dtype, fletcher32=True, **form)
        file.swmr_mode = True
        self._most = max(PENDING_BYTES, 4 * self._known.rows.nbytes)
        self._reserve(self._most)

    def _reserve(self, size):
        """Makes the file so many bytes longer than its content, and SPARE_BYTES for HDF5's tables.

        HDF5 crashes if one of its writes fails. Raises OSError, which names the steps in the file.
        """
        try:
            with open(self.partial, "rb+") as file:
                end, needed = file.seek(0, 2), self._file.id.get_filesize() + size + SPARE_BYTES
                file.write(bytes(max(needed - end, 0)))
        except OSError as error:
            has = f"; {self.partial.name} has {self.kept()}" if self.count else ""
            raise OSError(error.errno, f"{error.strerror}{has}", str(self.path)) from None
        self._room = size

    def _take_room(self, size):
        """Makes sure that `size` bytes can be written, whatever the disk does until then."""
        if size > self._room:
            self.flush()
            self._reserve(max(size, self._most))
        self._room -= size

    def _write_rows(self, name, values):
        """Writes rows after those of the last flush; once again if that failed half-way."""
        dataset, begin = self._file[name], self._ends[name]
        grown = np.maximum(dataset.shape[1:], values.shape[1:])
        dataset.resize((begin + len(values), *grown.tolist()))
        dataset[(slice(begin, None), *map(slice, values.shape[1:]))] = values

    def _add_changes(self, changes):
        for one in changes:
            self._add_event(change=one._asdict())

    def _add_event(self, **event):
        line = json.dumps({"step": self._nextStep, **event}, default=np.ndarray.tolist) + "\n"
        length = -(-len(line) // EVENT.itemsize) * EVENT.itemsize
        self._take_room(length)
        self._pending["events"].append(np.frombuffer(line.encode().ljust(length, b"\0"), EVENT))

    def _add_solver_state(self, step):
        content = io.BytesIO()
        np.savez(content, **self._solver.arrays())
        self._take_room(content.tell())
        begin, self._solverEnd = self._solverEnd, self._solverEnd + content.tell()
        self._pending["solverStates"].append(np.frombuffer(content.getvalue(), "u1"))
        self._pending["solverIndex"].append([(step, begin, self._solverEnd)])


@atexit.register
def close_all():
    """Ends recordings that are open as the program ends, such as in a suspended generator."""
    for one in list(Recorder.running.values()):
        one.close()


class Recording(AbstractContextManager):
    """A recording, read state by state; it is never in memory as a whole.

    path, firstStep, lastStep
    source : SceneSource
    settingsHistory : list of (step, dict), the settings from that step on
    changes : list of (step, Change), made by hand before that step, or before the recording
    functions, functionsFolder : digest of the student's functions and name of their folder, or ""
    code, numpyVersion : of the program that recorded it; see `code_digest`
    """

    _file = True  # not closed, as long as it is opened

    def __init__(self, path):
        """Reads all but the states. Raises RecordingError, or InputError without h5py."""
        self.path = Path(path)
        h5py = import_optional("h5py", path, InputError)
        try:
            check_readable(path)
            open(path, "rb").close()
        except OSError as error:
            raise self.error(f"cannot be read ({one_line(error)})") from None
        if not h5py.is_hdf5(path):
            raise self.error("not a recording")
        with self.reading():
            self._file = _open(h5py, path)
            head = _attributes_of(self._file)
            if head.get("format") != FORMAT:
                raise self.error("an HDF5 file, but not a recording")
            self.firstStep = int(head["firstStep"])
            self.lastStep = self.firstStep + self._file["times"].shape[0] - 1
            if self.lastStep < self.firstStep:
                raise self.error("it has no states")
            for name in ("functions", "functionsFolder", "numpyVersion", "code"):
                setattr(self, name, head.get(name, ""))
            self.source = self._read_source(head)
            self._read_events(head)

    def error(self, cause):
        """Returns a RecordingError about this recording, for the caller to raise."""
        return RecordingError(f"{self.path}: {cause}")

    def close(self):
        """Closes the file, after which nothing can be read."""
        self._file.close()

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
            told = short(error, limit=QUOTE_LENGTH)
            raise self.error(f"it is damaged ({told})") from None

    def _read_source(self, head):
        path, constraintPath = (self.path.parent / head[name] for name in ("scene", "constraints"))
        text, constraints = (self._file[name][0].decode() for name in ("scene", "constraints"))
        kind = BodySource if text.startswith('{"bodies"') else SceneSource
        source = kind(path, text)
        if head["constraints"]:
            source.constraintPath, source.constraints = constraintPath, constraints
        meshes = self._file.get("meshes", ())  # none of a scene without bodies
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
                step, change = event["step"], Change(**event["change"])
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

    def changes_before(self, step):
        """Returns the changes made by hand before a step."""
        ends = (find(self.changes, step, key=itemgetter(0)) for find in (bisect_left, bisect_right))
        return [change for _, change in self.changes[slice(*ends)]]

    def frame(self, step):
        """Returns the state after a step: the dict of `Scene.state`, with the float `times`.

        Raises RecordingError, also if the step is not between firstStep and lastStep.
        """
        if not self.firstStep <= step <= self.lastStep:
            kept = f"only steps {self.firstStep} to {self.lastStep} are"
            raise self.error(f"step {step} is not recorded, {kept}")
        row, count = step - self.firstStep, row_at(self._bodyCounts, step)[1]
        with self.reading():
            frame = {"times": float(self._file["times"][row])}
            for name, one in STATE_NAMES.items():
                rows = self._file[name][row, :count]
                frame[name] = checked_numbers(name, rows, STATE_WIDTHS[one], count)
            return frame

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
        return row_at(self.settingsHistory, step)


def row_at(rows, step):
    """Returns the last of rows (first step, ...) that is valid at a step, or the first one."""
    return rows[max(0, bisect_right(rows, step, key=itemgetter(0)) - 1)]


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
    with open(path, "rb") as file:  # HDF5 would wait for ever for the rest
        length = int.from_bytes(file.read(LENGTH_BYTES.stop)[LENGTH_BYTES], "little")
        if file.seek(0, 2) < length:
            raise OSError("cut off while it was being written")
    return h5py.File(path, "r", swmr=True)


@lru_cache
def code_digest():
    """Returns a digest of the source that makes steps."""
    folder = Path(rbs.__file__).parents[1]
    parts = "geometry", "stepping", "softstep"
    files = [folder / f"{name}.py" for name in ("GJK", "Quaternion", "RBSFunctions")]
    files += sorted(one for part in parts for one in (folder / "rbs" / part).glob("*.py"))
    return sha256(b"".join(one.read_bytes() for one in files)).hexdigest()


def _texts(values):
    """Returns a text, or a list of them, as an array of fixed length, which can have a checksum."""
    import h5py

    encoded = np.char.encode(np.array(values, dtype=str), "utf-8", "replace")
    return encoded.astype(h5py.string_dtype("utf-8", encoded.itemsize))


def _set_attributes(group, values):
    import h5py

    for name, value in values.items():
        value = _texts(value) if isinstance(value, str) else value
        group.attrs[name] = h5py.Empty("<i8") if value is None else value


def _attributes_of(group):
    """Returns the attributes of a group as a dict of Python values."""
    import h5py

    found = {}
    for name, value in group.attrs.items():
        value = None if isinstance(value, h5py.Empty) else np.asarray(value).tolist()
        found[name] = value.decode("utf-8") if isinstance(value, bytes) else value
    return found
