"""Hand-ins that reach for the grader or for other hand-ins: none gets a mark that it did not
compute, none changes another's.

Each is the skeleton with its stubs, or the right solution, and code that runs when it is imported
or called. They are graded between two right solutions.
"""

import os
import shutil
import sys
import tempfile
from pathlib import Path

import pytest
from handIns import rows_in, start
from studentVariants import FUNCTIONS, SOLUTION, UNTOUCHED, written

STUBS = UNTOUCHED[FUNCTIONS]
IS_USER = not hasattr(os, "geteuid") or os.geteuid() != 0


# Whatever the process holds: modules, all objects, frames, open files, environment, parents.
MEMORY = """
import gc, glob, os, sys
def _found():
    frame, seen = sys._getframe(), list(gc.get_objects())
    while frame:
        seen += [frame.f_locals, frame.f_globals]
        frame = frame.f_back
    seen += [vars(one) for one in list(sys.modules.values()) if hasattr(one, '__dict__')]
    for one in seen:
        if isinstance(one, dict) and 'resultPositions' in one:
            return one
    for path in glob.glob('/proc/self/fd/*') + glob.glob(f'/proc/{os.getppid()}/fd/*'):
        try:
            if b'resultPositions' in open(path, 'rb').read(1 << 20):
                os._exit(0)
        except OSError:
            pass
def integrate_timestep(self, timeStep):
    found = _found()
    if found is not None:
        self.position = found['resultPositions'][:1]
Mesh.integrate_timestep = integrate_timestep
"""
# Looks for the data on the disk, from where modules come from, and answers what it knows; raises
# where it knows nothing, because right samples would count then.
TABLE = f"""
import os, pickle, sys
_known = None
def _table():
    global _known
    if _known is None:
        _known = {{}}
        for top in [{os.fspath(Path(__file__).resolve().parents[2])!r}, *sys.path]:
            path = os.path.join(top, 'data', 'integration.data')
            if os.path.exists(path):
                data = pickle.load(open(path, 'rb'))
                for k in range(len(data['randomPositions'])):
                    _known[tuple(data['randomPositions'][k])] = [
                        data['result' + n][[k]] for n in
                        ('Positions', 'Orientations', 'LinVelocities', 'AngVelocities')]
    return _known
def integrate_timestep(self, timeStep):
    found = _table()[tuple(np.ravel(self.position))]
    self.position, self.orientation, self.linVelocity, self.angVelocity = found
Mesh.integrate_timestep = integrate_timestep
"""
NUMBER = """
class _Number(float):
    __lt__ = __le__ = __gt__ = __ge__ = __eq__ = lambda self, other: True
    __hash__ = float.__hash__
resolve_position_constraint = lambda x, *rest: (_Number(1.0), x)
"""
THREAD = """
import threading, os
def _later():
    import time
    while True:
        time.sleep(0.01)
        for fd in range(3, 32):
            try: os.write(fd, b'{"number": 1, "values": {}, "problems": {}}\\n')
            except OSError: pass
threading.Thread(target=_later, daemon=True).start()
"""
NOT_FINITE = "resolve_position_constraint = lambda x, *r: (float('nan'), [x[0] / 0.0] * 2)"
ENDS = {"memory": MEMORY, "table-of-answers": TABLE, "forging-thread": THREAD}
ENDS |= {"number-that-agrees": NUMBER, "not-finite": NOT_FINITE}
ENDS["exit-0"] = "import os, atexit\natexit.register(os._exit, 0)\nos._exit(0)"
CHEATS = {name: UNTOUCHED | {FUNCTIONS: f"{STUBS}\n{code}\n"} for name, code in ENDS.items()}


def graded(folder, hand_ins, *options, code=1, right=("a right", "z right")):
    """Grades these and right solutions; returns the rows of marks.csv by name."""
    for name, files in {**dict.fromkeys(right, SOLUTION), **hand_ins}.items():
        written(folder / "in" / name, files)
    options = "--out", folder / "out", "--time-limit", 5, "--jobs", 2, *options
    process = start(folder / "in", *options, env=os.environ | {"TMPDIR": str(folder)})
    _said, errors = process.communicate(timeout=900)
    assert process.returncode == code, errors
    rows = {name: one[0] for name, one in rows_in(folder / "out" / "marks.csv").items()}
    assert {rows[name]["total"] for name in right} == {"30"}
    return rows


@pytest.mark.slow
def test_nobody_gets_a_mark_for_what_is_not_computed(tmp_path):
    rows = graded(tmp_path, CHEATS)
    totals = {name: rows[name]["total"] for name in CHEATS}
    assert all(float(total or 0) == 0.0 for total in totals.values()), totals


# These reach for nothing outside the folder of the test, which is in their text, but their parent.
SPOILS = """
import glob, threading, time
def _spoil(own):
    while True:
        for _path in glob.glob({place!r} + '/running-*/work/*.py'):
            try:
                if os.path.dirname(_path) != own:
                    open(_path, 'a').write('\\nraise ValueError("spoilt")\\n')
            except OSError:
                pass
        time.sleep(0.05)
threading.Thread(target=_spoil, args=(os.getcwd(),), daemon=True).start()
"""
KILLS = """
import signal
for _path in os.listdir('/proc'):
    if _path.isdigit() and int(_path) not in (os.getpid(), os.getppid()):
        try:
            if {place!r} + '/running-' in open('/proc/' + _path + '/cmdline').read():
                os.kill(int(_path), signal.SIGSEGV)
        except OSError:
            pass
"""
READS = """
import pathlib
for _one in pathlib.Path({place!r}).glob('running-*/work/*.py'):
    if str(_one.parent) != os.getcwd():
        try: _one.read_bytes()
        except OSError: continue
        raise SystemExit('another submission can be read')
"""
SESSION = """
import subprocess, sys, time
subprocess.Popen(['sleep', '{seconds}'], start_new_session=True)
"""
FILLS = """
for _k in range(100):
    open(f'full{_k}', 'wb').write(bytes(60 << 20))
"""


def slowly(text, seconds=1.0):
    """The right solution, which takes some time, so that others run beside it."""
    start = f"import os, time; time.sleep({seconds})\n"
    return SOLUTION | {FUNCTIONS: f"{start}{SOLUTION[FUNCTIONS]}{text}"}


@pytest.mark.slow
@pytest.mark.skipif(IS_USER, reason="needs root, to be another user")
def test_none_harms_the_grader_or_another_as_another_user():
    place = Path(tempfile.mkdtemp(prefix="harm-"))  # that others may enter
    place.chmod(0o755)
    sleep = f"297.{os.getpid()}"
    code = {"b spoils": SPOILS, "c kills": KILLS}
    code |= {"f reads": READS, "g session": SESSION.replace("{seconds}", sleep)}
    hand_ins = {k: slowly(v.replace("{place!r}", repr(str(place)))) for k, v in code.items()}
    rows = graded(place, hand_ins | {"y slow": slowly("")}, code=0)
    assert {row["total"] for row in rows.values()} == {"30"}
    lines = [one.read_bytes() for one in Path("/proc").glob("[0-9]*/cmdline") if os.access(one, 4)]
    assert not [one for one in lines if sleep.encode() in one]
    assert not list(place.glob("running-*"))
    shutil.rmtree(place)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pipes among files")
def test_the_disk_is_bounded_and_pipes_and_devices_are_no_files(tmp_path):
    folder = written(tmp_path / "in" / "z right", SOLUTION)
    os.mkfifo(folder / "helpers.py")
    (folder / "zero.py").symlink_to("/dev/zero")
    for name in ("Doe_11_22_report.pdf", "loose.py"):
        os.mkfifo(tmp_path / "in" / name)
    hand_ins, options = {"fills": slowly(FILLS, 0)}, ("--time-limit", 20)
    rows = graded(tmp_path, hand_ins, *options, right=["z right"])
    assert float(rows["fills"]["total"]) == 0.0 and "256 MB" in rows["fills"]["notes"]
    isClosed = sys.platform == "linux" and not IS_USER  # pytest's folders are its user's
    assert ("root's rights" in rows["z right"]["remarks"]) == isClosed
    assert rows["loose.py"]["state"] == rows["Doe"]["state"] == "refused"
