"""Runs a student's modules in a process of its own, within limits, and asks it for numbers.

The process gets inputs through a pipe, and returns numbers through another. It works on files that
are written afresh into a private folder. What is prevented where is listed in graders/README.md.
From the top: limits; private folders; starting and ending processes; `Worker`; grading.
"""

import json
import os
import queue
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from functools import cache
from pathlib import Path

from reference import PROJECT_DIRECTORY
from verdict.parts import UNREADABLE

from isolated.archives import read_plain
from rbs.program.parsing import number_type
from rbs.program.submissions import CAUSE_LENGTH, SubmissionError
from rbs.scenes.messages import short

# Seconds that a process may take in addition to the time limits of its parts, to start and to end;
# and that the clock in the process, which names a line, is ahead of ours.
GRACE, AHEAD = 20, 1.5
# The longest answer, and the longest text that is read from a file of a submission, in bytes.
LONGEST_ANSWER, LONGEST_TEXT = 32 << 20, 1 << 16
# The environment of a student's program: same numbers each time, no window, one thread because
# each would take memory of its own.
_ONES = "PYTHONDONTWRITEBYTECODE PYTHONUTF8 OPENBLAS_NUM_THREADS OMP_NUM_THREADS".split()
ENVIRONMENT = {"PYTHONHASHSEED": "0", "MPLBACKEND": "Agg"} | dict.fromkeys(_ONES, "1")
DROPPED = ("PYTHON", "DISPLAY", "WAYLAND_DISPLAY")
# What a process can import of this project: the test for collisions and readers of mesh files,
# which the coursework supplies, and what calls the student's functions.
SUPPLIED = {"graders/released": "rbs/released", "graders/worker": "worker"}
SUPPLIED |= dict.fromkeys(("GJK.py", "Quaternion.py", "rbs/__init__.py", "rbs/geometry"))
SUPPLIED |= {f"rbs/program/{name}.py": None for name in ("__init__", "submissions")}
_READERS = "__init__", "messages", "textfiles", "meshfiles"
SUPPLIED |= {f"rbs/scenes/{name}.py": None for name in _READERS}
PR_SET_DUMPABLE, PR_SET_CHILD_SUBREAPER = 4, 36  # of Linux's prctl
# What limits that another process has lowered lead to.
LIMITED = re.compile(rb"MemoryError|OSError|\[Errno|BlockingIOError|start new thread|Permission")


def add_limit_arguments(parser, seconds=30):
    """Adds two options, whose values `seconds` and `megabytes` are called limits here."""
    form = {"type": number_type(float, 0.1, 86400), "default": seconds}
    text = "time limit for each part of a grader, and each scene (default: %(default)g)"
    parser.add_argument("--time-limit", dest="seconds", metavar="SECONDS", **form, help=text)
    form = {"type": number_type(int, 1, 1 << 20), "default": 2048}
    text = "memory limit of a submission (default: %(default)d)"
    parser.add_argument("--memory-limit", dest="megabytes", metavar="MB", **form, help=text)


@cache
def supplied():
    """What a student's process can import of this project: a dict from path to bytes, read before
    any code of a submission runs.
    """
    files = {}
    for name, target in SUPPLIED.items():
        source, target = PROJECT_DIRECTORY / name, Path("supplied", target or name)
        for path in source.rglob("*.py") if source.is_dir() else [source]:
            files[str(target / path.relative_to(source))] = path.read_bytes()
    return files


class PrivateFolder:
    """A folder with `work`, a submission's code, `data` beside it, and what is `supplied`, for one
    process. work : path of the code
    """

    def __init__(self, files):
        """files : dict from path, "code/..." or "data/...", to bytes"""
        self._folder = tempfile.TemporaryDirectory(prefix="running-", ignore_cleanup_errors=True)
        self.path = Path(self._folder.name).resolve()
        self.work = self.path / "work"
        self.work.mkdir()
        for name, content in (files | supplied()).items():
            path = self.path / re.sub("^code/", "work/", name)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        self._written = self._signature()

    def _signature(self):
        """What changes if anything in the two folders is written, renamed or removed."""
        told, folders = {}, [self.work, self.path / "data"]
        while folders:
            with suppress(OSError), os.scandir(folders.pop()) as entries:
                for one in entries:
                    found = one.stat(follow_symlinks=False)
                    told[one.path] = found.st_ino, found.st_ctime_ns
                    if one.is_dir(follow_symlinks=False):
                        folders.append(one.path)
        return told

    def has_changed(self):
        return self._signature() != self._written

    def remove(self):
        try:
            self._folder.cleanup()
        except RecursionError:  # thousands of nested folders
            subprocess.run(["rm", "-rf", self.path])


# The processes of all threads; those that this one had started before; and whether no more may be
# started.
_running, _others = set(), set()
_lock, _isStopped = threading.RLock(), threading.Event()


@cache
def adopt():
    """On Linux, makes processes whose parent has ended this process's children, and closes its
    memory and its open files to processes without privileges.
    """
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
        ctypes.CDLL(None).prctl(PR_SET_DUMPABLE, 0, 0, 0, 0)


def _stat(pid):
    """Of a process on Linux: that of its parent, and its processor time in s; or (0, 0)."""
    with suppress(OSError, ValueError, IndexError):
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return int(fields[1]), (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return 0, 0.0


def _children():
    """The process IDs of this process's children, on Linux."""
    found = Path("/proc").glob("[0-9]*") if sys.platform == "linux" else ()
    return {int(one.name) for one in found if _stat(one.name)[0] == os.getpid()}


def stop_all():
    with _lock:  # so that one that is being started is known
        _isStopped.set()
        running = list(_running)
    for process in running:
        end(process)


def end(process):
    """Ends a process, and all that it has started, also in sessions of their own."""
    with suppress(ProcessLookupError, PermissionError):
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
    last = time.monotonic() + GRACE
    while time.monotonic() < last:  # each may leave children in turn, or be traced by one
        with _lock:
            left = _children() - _others - {one.pid for one in _running}
        for pid in left:
            with suppress(OSError):
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, os.WNOHANG)
        if process.poll() is not None and not left:
            break
        time.sleep(0.002)
    with _lock:
        _running.discard(process)


class Ended(Exception):
    """A process has ended, or was ended; the message says why."""

    def __init__(self, cause):
        super().__init__(short(cause, limit=CAUSE_LENGTH))


class Worker:
    """A process that has imported a student's modules, and answers orders; a context manager.

    If another submission may have led to what happens, because it has the same rights, the HandIn
    is marked as disturbed.

    remarks : on the modules that were supplied
    """

    def __init__(self, handIn, limits, end):
        """Raises SubmissionError if the modules cannot be imported for a reason that is not a
        mistake in the code, and Ended for any other.

        end : the time, of `time.monotonic`, at which it is ended
        """
        adopt()
        self._handIn, self._folder = handIn, PrivateFolder(handIn.files)
        self._limits, self._end = limits, end
        self._number, self._answers, self._orders = 0, queue.Queue(1), queue.Queue()
        self._busy = 0.0  # the processor time when the last order was sent
        self._trace, self._process = self._folder.path / "trace.txt", None
        try:
            self._start()
        except BaseException:
            self.close()
            raise

    def _start(self):
        """Starts `worker/main.py` within limits. After a call of `stop_all`, raises Ended."""
        kept = {name: text for name, text in os.environ.items() if not name.startswith(DROPPED)}
        kept |= ENVIRONMENT | dict.fromkeys(("TMPDIR", "HOME"), str(self._folder.path))
        form = {"cwd": self._folder.work, "env": kept, "start_new_session": True}
        form |= {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
        seconds = int(max(1.0, self._end - time.monotonic())) + 1
        program = self._folder.path / "supplied" / "worker" / "main.py"
        words = program, self._limits.megabytes, seconds, os.getpid()
        with _lock:
            if _isStopped.is_set():
                raise Ended("stopped")
            if not _running:
                _others.clear()
                _others.update(_children())
            self._process = subprocess.Popen([sys.executable, "-B", *map(str, words)], **form)
            _running.add(self._process)
        for target in (self._read, self._write):
            threading.Thread(target=target, args=(self._process,), daemon=True).start()
        begin = {"folder": str(self._folder.work), "trace": str(self._trace)}
        found = self._told(begin | {"seconds": self._limits.seconds}, self._limits.seconds + 5)
        if "refused" in found:
            cause, remedy = str(found["refused"]), short(str(found.get("remedy") or ""), limit=80)
            raise SubmissionError(cause, remedy) if remedy else Ended(cause)
        remarks = found.get("remarks")
        remarks = remarks if isinstance(remarks, list) else []
        self.remarks = [short(str(one), limit=CAUSE_LENGTH) for one in remarks]

    def _read(self, process):
        with suppress(OSError, ValueError):
            while line := process.stdout.readline(LONGEST_ANSWER):
                self._answers.put(line)
        self._answers.put(b"")

    def _write(self, process):
        with suppress(OSError, ValueError):
            while (order := self._orders.get()) is not None:
                process.stdin.write(json.dumps(order).encode() + b"\n")
                process.stdin.flush()

    def ask(self, order, seconds=None):
        """Returns the answer to an order, a dict. Raises Ended."""
        self._number += 1
        seconds = seconds or self._limits.seconds
        answer = self._told(order | {"number": self._number, "seconds": seconds}, seconds)
        if answer.get("number") != self._number:
            raise self._unreadable()
        return answer

    def _unreadable(self):
        self._handIn.isDisturbed = True
        return Ended(UNREADABLE)

    def _told(self, order, seconds):
        self._orders.put(order)
        self._busy = _stat(self._process.pid)[1]
        left = min(seconds + AHEAD, self._end - time.monotonic())
        try:
            line = self._answers.get(timeout=max(left, 0.0))
        except queue.Empty:
            line = None
        if not line:
            raise self._ended(line is None, left < seconds)
        self._handIn.isDisturbed |= bool(LIMITED.search(line))
        with suppress(ValueError, RecursionError):
            if isinstance(answer := json.loads(line), dict):
                return answer
        raise self._unreadable()

    def _ended(self, isLate, isLast):
        """Ends the process; returns the Ended that says why."""
        busy = _stat(self._process.pid)[1] - self._busy if isLate else self._limits.seconds
        if not isLate:
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(AHEAD)
        isLate = isLate or self._process.poll() is None
        end(self._process)
        said = read_plain(self._trace, LONGEST_TEXT).decode("utf-8", "replace")
        code = self._process.returncode
        if isLate or "Timeout (" in said:
            cause = f"stopped after {self._limits.seconds:g} s"
            if isLast:
                cause = "stopped, because all parts together took too long"
            self._handIn.isDisturbed |= busy < 0.5 * self._limits.seconds
            return Ended(cause + self._place(said))
        self._handIn.isDisturbed |= code < 0
        if code < 0:
            cause = f"crashed the interpreter ({signal.Signals(-code).name})"
        else:
            cause = f"ended the interpreter with exit code {code}"
        return Ended(cause + self._place(said))

    def _place(self, said):
        """The innermost line of the student's code in the trace, as ", at FILE:LINE", or ""."""
        lines = re.findall(r'File "([^"\n]+)", line (\d+)', said)
        work = self._folder.work
        own = [(Path(file), line) for file, line in lines if Path(file).is_relative_to(work)]
        return f", at {own[0][0].relative_to(work)}:{own[0][1]}" if own else ""

    def close(self):
        self._orders.put(None)
        if self._process is not None:
            end(self._process)
        self._handIn.isDisturbed |= self._folder.has_changed()
        self._folder.remove()

    def __enter__(self):
        return self

    def __exit__(self, *_error):
        self.close()


def run_isolated(graders, handIn, data, limits):
    """Runs all parts of the graders; returns (dict from a grader's module to [(Part, Results)],
    remarks).

    One process runs all parts. A part during which it ends is given up, and another process
    continues with the next one. If the modules cannot be imported, all parts are given up; if that
    is not the student's mistake, a SubmissionError is raised, with a remedy.

    handIn : of `archives`; data : dict from a grader's module to its data
    limits : with `seconds` for each part, and `megabytes`
    """
    parts = [(one.module, part) for one in graders for part in one.parts]
    waiting, outcomes, remarks = parts[:], {one.module: [] for one in graders}, []
    last = time.monotonic() + (len(parts) + 1) * limits.seconds + GRACE
    while waiting:
        try:
            with Worker(handIn, limits, last) as worker:
                remarks = remarks or worker.remarks
                answer = None
                while waiting and not isinstance(answer, str):
                    module, part = waiting.pop(0)
                    try:
                        answer = worker.ask(part.order(data[module]))
                    except Ended as ended:
                        answer = str(ended)
                    outcomes[module].append((part, part.read(answer, data[module])))
        except Ended as ended:  # nothing could be imported
            how = str(ended)
            if not how.startswith("cannot be imported"):
                how = re.sub("(, at |$)", r" while the modules were imported\1", how, count=1)
            for module, part in waiting:
                outcomes[module].append((part, part.read(how, data[module])))
            break
    return outcomes, remarks
