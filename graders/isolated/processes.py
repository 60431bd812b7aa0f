"""Runs a student's modules in a process of its own, within limits, and asks it for numbers.

The process gets inputs through a pipe, and returns numbers through another. It works on files that
are written afresh into a private folder, which is removed. What is prevented where is listed in
graders/README.md.
From the top: limits; `Worker`; grading.
"""

import json
import os
import queue
import re
import secrets
import signal
import stat
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

# Time limits are of processor time, so that no verdict depends on what else a machine does. By the
# clock, a part may take PATIENCE times as long, all parts together PARTS times that, and further
# seconds to start and to end.
PATIENCE, PARTS, GRACE, END = 8, 3, 20, 3
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
SUPPLIED |= {f"rbs/program/{name}.py": None for name in ("__init__", "submissions", "returned")}
_READERS = "__init__", "messages", "files", "meshfiles"
SUPPLIED |= {f"rbs/scenes/{name}.py": None for name in _READERS}
WITH_ROOT = "the code had root's rights, because other users cannot reach {}; TMPDIR names another"
# The most that a submission may write, each file counting at least so much, in bytes; seconds
# between looks at it; users whom a system gives to nobody.
MOST_WRITTEN, LEAST_SIZE, CHECK, USERS = 256 << 20, 4096, 0.25, range(30000, 60000)


def add_limit_arguments(parser, seconds=30):
    """Adds two options, whose values `seconds` and `megabytes` are called limits here."""
    form = {"type": number_type(float, 0.1, 86400), "default": seconds}
    text = "processor time for each part of a grader, and each step (default: %(default)g)"
    parser.add_argument("--time-limit", dest="seconds", metavar="SECONDS", **form, help=text)
    form = {"type": number_type(int, 256, 1 << 20), "default": 2048}  # NumPy needs as much
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


# The processes of all threads, and whether no more may be started.
_running = set()
_lock, _isStopped = threading.RLock(), threading.Event()


def stop_all():
    with _lock:  # so that one that is being started is known
        _isStopped.set()
        running = list(_running)
    for worker in running:
        worker.end()


class Ended(Exception):
    """A process has ended, or was ended; the message says why."""

    def __init__(self, cause):
        super().__init__(short(cause, limit=CAUSE_LENGTH))


class Worker:
    """A process that has imported a student's modules, and answers orders; a context manager.

    It works in a private folder with `work`, the submission's code, `data` beside it, and what is
    `supplied`. Under root on Linux, it is the process of a user whom nobody else is.

    user : the ID of this user, or 0; remarks : on the modules that were supplied
    """

    def __init__(self, handIn, limits, end):
        """Raises SubmissionError if the modules cannot be imported for a reason that is not a
        mistake in the code, and Ended for any other.

        end : the time, of `time.monotonic`, at which it is ended
        """
        self._limits, self._end, self._number, self._process = limits, end, 0, None
        self.user, self.remarks = 0, []
        self._answers, self._orders = queue.Queue(1), queue.Queue()
        self._folder = tempfile.TemporaryDirectory(prefix="running-", ignore_cleanup_errors=True)
        self._path = Path(self._folder.name).resolve()
        self._work, self._trace = self._path / "work", self._path / "trace.txt"
        try:
            self._work.mkdir()
            for name, content in (handIn.files | supplied()).items():
                path = self._path / re.sub("^code/", "work/", name)
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
            self._start()
        except BaseException:
            self.close()
            raise

    def _start(self):
        """Starts `worker/main.py` within limits. After a call of `stop_all`, raises Ended."""
        kept = {name: text for name, text in os.environ.items() if not name.startswith(DROPPED)}
        kept |= ENVIRONMENT | dict.fromkeys(("TMPDIR", "HOME"), str(self._path))
        form = {"cwd": self._work, "env": kept, "start_new_session": True}
        form |= {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
        seconds = int(max(1.0, self._end - time.monotonic())) + 1
        program = self._path / "supplied" / "worker" / "main.py"
        with _lock:
            if _isStopped.is_set():
                raise Ended("stopped")
            self.user = self._other_user()
            words = program, self._limits.megabytes, seconds, self.user
            self._process = subprocess.Popen([sys.executable, "-B", *map(str, words)], **form)
            _running.add(self)
        for target in (self._read, self._write):
            threading.Thread(target=target, args=(self._process,), daemon=True).start()
        begin = {"folder": str(self._work), "trace": str(self._trace)}
        found = self._told(begin | {"seconds": self._limits.seconds}, GRACE)
        if "refused" in found:
            cause, remedy = str(found["refused"]), short(str(found.get("remedy") or ""), limit=80)
            raise SubmissionError(cause, remedy) if remedy else Ended(cause)
        remarks = found.get("remarks")
        remarks = remarks if isinstance(remarks, list) else []
        self.remarks += [short(str(one), limit=CAUSE_LENGTH) for one in remarks]

    def _other_user(self):
        """The ID of a user whom nobody else is, and who now owns the folder; or 0: the process has
        the grader's rights, with a remark if they are root's.
        """
        if sys.platform != "linux" or os.geteuid():
            return 0
        import pwd

        taken = {one.pw_uid for one in pwd.getpwall()} | {one.user for one in _running}
        user = secrets.choice([one for one in USERS if one not in taken])
        with suppress(OSError):  # in some containers
            if all(one.stat().st_mode & stat.S_IXOTH for one in self._path.parents):
                for path in (self._path, *self._path.rglob("*")):
                    os.chown(path, user, user)
                return user
        self.remarks.append(WITH_ROOT.format(self._path.parent))
        return 0

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

    def ask(self, order):
        """Returns the answer to an order, a dict. Raises Ended."""
        self._number, seconds = self._number + 1, self._limits.seconds
        answer = self._told(order | {"number": self._number, "seconds": seconds})
        if answer.get("number") != self._number:
            raise Ended(UNREADABLE)
        if "failed" in answer:
            raise Ended(str(answer["failed"]))
        return answer

    def _told(self, order, more=0.0):
        self._orders.put(order)
        last, line = time.monotonic() + PATIENCE * self._limits.seconds + more, None
        last = min(last, self._end)
        while line is None:
            left = last - time.monotonic()
            with suppress(queue.Empty):
                line = self._answers.get(timeout=max(0.0, min(left, CHECK)))
            if line is None and _size(self._path) > MOST_WRITTEN:
                self.end()
                raise Ended(f"stopped after writing {MOST_WRITTEN >> 20} MB")
            if line is None and left <= 0.0:
                raise self._ended(True, last == self._end)
        if not line:
            raise self._ended(False)
        with suppress(ValueError, RecursionError):
            if isinstance(answer := json.loads(line), dict):
                return answer
        raise Ended(UNREADABLE)

    def _ended(self, isLate, isLast=False):
        """Ends the process; returns the Ended that says why."""
        clock = getattr(signal, "SIGPROF", None)
        if isLate and clock:  # so that the line is named
            self._process.send_signal(clock)
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(END)
        isLate = isLate or self._process.poll() is None
        self.end()
        said = read_plain(self._trace, LONGEST_TEXT).decode("utf-8", "replace")
        code = self._process.returncode
        if isLast:
            cause = "stopped, because all parts together took too long"
        elif isLate:
            cause = f"stopped, because it waited for more than {PATIENCE} times the limit"
        elif code == -(clock or 0) or "Timeout (" in said:
            cause = f"stopped after {self._limits.seconds:g} s"
        elif code < 0:
            cause = f"crashed the interpreter ({signal.Signals(-code).name})"
        else:
            cause = f"ended the interpreter with exit code {code}"
        return Ended(cause + self._place(said))

    def _place(self, said):
        """The innermost line of the student's code in the trace, as ", at FILE:LINE", or ""."""
        lines = re.findall(r'File "([^"\n]+)", line (\d+)', said)
        own = [(Path(file), line) for file, line in lines if Path(file).is_relative_to(self._work)]
        return f", at {own[0][0].relative_to(self._work)}:{own[0][1]}" if own else ""

    def end(self):
        """Ends the process and its group; as a user of its own, all that it has started."""
        if self.user:
            form = {"user": self.user, "group": self.user, "extra_groups": ()}
            subprocess.run(["sh", "-c", "kill -KILL -1"], stderr=subprocess.DEVNULL, **form)
        with suppress(ProcessLookupError, PermissionError):
            if hasattr(os, "killpg"):
                os.killpg(self._process.pid, signal.SIGKILL)
            else:
                self._process.kill()
        self._process.wait()
        with _lock:
            _running.discard(self)

    def close(self):
        self._orders.put(None)
        if self._process is not None:
            self.end()
        try:
            self._folder.cleanup()
        except RecursionError:  # thousands of nested folders
            subprocess.run(["rm", "-rf", self._path])

    def __enter__(self):
        return self

    def __exit__(self, *_error):
        self.close()


def _size(folder):
    """How many bytes a folder takes, up to the bound; without `os.walk`, which recurses."""
    total, waiting = 0, [folder]
    while waiting and total <= MOST_WRITTEN:
        with suppress(OSError), os.scandir(waiting.pop()) as entries:
            for one in entries:
                total += LEAST_SIZE
                if one.is_dir(follow_symlinks=False):
                    waiting.append(one.path)
                with suppress(OSError):
                    total += one.stat(follow_symlinks=False).st_size
    return total


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
    last = time.monotonic() + PARTS * PATIENCE * limits.seconds + GRACE
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
