"""Running a student's modules in a process of its own, on a copy of their folder, with limits.

What is run may never end, end the interpreter, crash it, or write where it stands: none of this
reaches the grader or another submission. It is not a prison, though: the process has the rights of
whoever grades, and can read and write their files if it sets out to.
"""

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from trials import Results

from rbs.submissions import SubmissionError, brief

GRADERS = Path(__file__).resolve().parent
# A submission is a few text files; the released folder with its meshes and C library has some MB.
MOST_FILES = 2000
MOST_BYTES = 200 << 20
# Folders that are not part of anybody's solution.
PASSED_OVER = {"__pycache__", ".git", ".idea", ".vscode", "venv", ".venv", "__MACOSX"}
# Seconds, of the time limit, that are kept to write down where the program is.
TRACE_TIME = 0.5
DEFAULT_SECONDS = 60.0
DEFAULT_MEGABYTES = 2048


@dataclass(frozen=True)
class Limits:
    """seconds : of a process, by the clock; megabytes : of its address space"""

    seconds: float = DEFAULT_SECONDS
    megabytes: int = DEFAULT_MEGABYTES


def add_limit_arguments(parser):
    parser.add_argument(
        "--time-limit",
        metavar="SECONDS",
        type=_positive(float, 86400),
        default=DEFAULT_SECONDS,
        help="how long a submission may take for a part of a grader (default: %(default)g)",
    )
    parser.add_argument(
        "--memory-limit",
        metavar="MB",
        type=_positive(int, 1 << 20),
        default=DEFAULT_MEGABYTES,
        help="how much memory a submission may ask for (default: %(default)d)",
    )


def _positive(kind, high):
    """An argparse type: a number above 0, and not above `high`."""

    def parse(text):
        try:
            value = kind(text)
        except ValueError:
            value = 0
        if not 0 < value <= high:
            raise argparse.ArgumentTypeError(
                f"must be a number above 0 and up to {high}, not '{brief(text, 40)}'"
            )
        return value

    return parse


def limits_of(arguments):
    return Limits(arguments.time_limit, arguments.memory_limit)


# ---- A copy of a folder -------------------------------------------------------------------------


@contextmanager
def copied(folder):
    """Yields the path of a copy of a folder, which is removed in the end; links are left out.

    Raises SubmissionError where the folder cannot be read, or holds more than a submission does.
    """
    with tempfile.TemporaryDirectory(prefix="submission-", ignore_cleanup_errors=True) as place:
        target = Path(place).resolve() / "work"
        try:
            _copy(Path(folder), target)
        except OSError as error:
            raise SubmissionError(f"{folder}: cannot be copied: {error.strerror}") from None
        yield target


def _copy(folder, target):
    count = size = 0
    for root, folders, files in os.walk(folder):
        folders[:] = sorted(
            name
            for name in folders
            if name not in PASSED_OVER and not os.path.islink(os.path.join(root, name))
        )
        here = target / os.path.relpath(root, folder)
        here.mkdir(parents=True, exist_ok=True)
        for name in files:
            path = Path(root) / name
            if not path.is_file() or path.is_symlink():
                continue
            count, size = count + 1, size + path.stat().st_size
            if count > MOST_FILES or size > MOST_BYTES:
                raise SubmissionError(
                    f"{folder}: holds more than {MOST_FILES} files or {MOST_BYTES >> 20} MB"
                )
            shutil.copyfile(path, here / name)


# ---- Processes ----------------------------------------------------------------------------------


def environment(folder):
    """The environment of a student's program: nothing that would change its numbers or its ways."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    return kept | {
        "PYTHONHASHSEED": "0",
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONUTF8": "1",
        "MPLBACKEND": "Agg",
        "OPENBLAS_NUM_THREADS": "1",  # each thread would ask for memory of its own
        "OMP_NUM_THREADS": "1",
        "TMPDIR": str(folder),
    }


def run_limited(command, folder, seconds, errors=subprocess.DEVNULL):
    """Runs a command and whatever it starts, for so many seconds; returns its exit code.

    errors : a file that its standard error goes to; its output is dropped
    Raises SubmissionError once `stop_all` has been called.

    The exit code is negative where a signal ended it, and None where the time was up.
    """
    if _isStopped.is_set():
        raise SubmissionError("stopped by Ctrl-C")
    process = subprocess.Popen(
        command,
        cwd=folder,
        env=environment(folder.parent),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=errors,
        start_new_session=True,
    )
    _running.add(process)
    try:
        return process.wait(seconds)
    except subprocess.TimeoutExpired:
        return None
    finally:
        _running.discard(process)
        _end(process)


# The processes that are running, in whichever thread, and whether no more shall be started.
_running = set()
_isStopped = threading.Event()


def stop_all():
    """Ends all processes that are running, and lets none be started any more."""
    _isStopped.set()
    for process in list(_running):
        _end(process)


def _end(process):
    """Ends a process and all that it has started."""
    with suppress(ProcessLookupError, PermissionError):
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
    process.wait()


def run_isolated(grader, folder, dataFolder, data, limits):
    """What a student's modules compute: `(list of (Part, Results), remarks)`.

    A part at which the process ends is given up, and another process goes on with the next one.
    """
    sampleCount = len(data["randomPositions"])
    parts = grader.asked(data, withExtras=True)
    outcomes = {}
    remarks = []
    with copied(folder) as work:
        while missing := [part for part in parts if part.name not in outcomes]:
            place, convention = Path(dataFolder).resolve(), data["convention"]
            run = _Run(grader, work, place, convention, limits, missing)
            for part in missing:
                results = Results(part.shapes, sampleCount)
                if part.name in run.contents and run.read(part, results):
                    outcomes[part.name] = results
                elif part.name == run.begun or not run.isLoaded:
                    results.give_up(run.cause, len(part.samples(data)))
                    outcomes[part.name] = results
            if run.remarks:
                remarks = run.remarks
            if run.begun is None:
                break
    for part in missing:
        if part.name not in outcomes:
            outcomes[part.name] = results = Results(part.shapes, sampleCount)
            results.give_up(run.cause or "gave no results", len(part.samples(data)))
    return [(part, outcomes[part.name]) for part in parts], remarks


class _Run:
    """One process of `worker.py`, and what it has left.

    contents : dict from the name of a part to its results, as `Results.as_json` has them
    isLoaded : whether the modules could be imported; begun : the part at which the process has
        ended before its time, or None; cause : why, or why the modules could not be imported
    """

    def __init__(self, grader, work, dataFolder, convention, limits, parts):
        self._work = work
        self._answers = work.parent / "answers.jsonl"
        self._trace = work.parent / "trace.txt"
        for path in (self._answers, self._trace):
            path.write_text("")
        order = {
            "grader": grader.module,
            "folder": str(work),
            "data": str(dataFolder),
            "convention": convention,
            "parts": [part.name for part in parts],
            "answers": str(self._answers),
            "trace": str(self._trace),
            "seconds": max(limits.seconds - TRACE_TIME, 0.5 * limits.seconds),
            "megabytes": limits.megabytes,
        }
        command = [sys.executable, "-B", str(GRADERS / "worker.py"), json.dumps(order)]
        self._seconds = limits.seconds
        code = run_limited(command, work, limits.seconds)
        self.contents = {}
        self.remarks = []
        self.begun = None
        self.isLoaded = False
        self.cause = None
        isDone = self._read_answers()
        if self.cause is None and not isDone:
            self.cause = self._reason(code)
        if isDone:
            self.begun = None

    def _read_answers(self):
        """Takes in what the process has written; returns whether it came to its end."""
        with open(self._answers, encoding="utf-8", errors="replace") as file:
            for line in file:
                try:
                    answer = json.loads(line)
                    kind, value = answer["kind"], answer["value"]
                except (ValueError, KeyError, TypeError, RecursionError):
                    continue  # cut off, or not ours
                if kind == "loaded":
                    self.isLoaded = True
                    self.remarks = [
                        f"{brief(name)}.py is not there: this project's is used"
                        for name in value
                    ]
                elif kind == "refused":
                    self.cause = brief(value)
                elif kind == "begun":
                    self.begun = value
                elif kind == "results":
                    self.contents[answer["part"]] = value
                elif kind == "done":
                    return True
        return False

    def read(self, part, results):
        """Fills the Results of a part in; returns False where they make no sense."""
        try:
            results.read_json(self.contents[part.name])
        except (ValueError, KeyError, TypeError, AttributeError):
            self.begun, self.cause = part.name, "gave no readable results"
            return False
        return True

    def _reason(self, code):
        """Why the process has ended before its time."""
        place = self._place()
        during = "" if self.isLoaded else " while the modules were imported"
        if code is None:
            return f"stopped after {self._seconds:g} s{during}{place}"
        if code < 0:
            name = signal.Signals(-code).name if -code in set(signal.Signals) else str(-code)
            return f"crashed the interpreter ({name}){during}{place}"
        return f"ended the interpreter with exit code {code}{during}"

    def _place(self):
        """Where the student's program was, as ", at FILE:LINE"; or nothing."""
        trace = self._trace.read_text(errors="replace")
        for file, line in re.findall(r'File "([^"\n]+)", line (\d+)', trace):
            if Path(file).is_relative_to(self._work):
                return f", at {brief(Path(file).relative_to(self._work))}:{line}"
        return ""
