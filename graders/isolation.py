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
DEFAULT_SECONDS = 30.0
DEFAULT_MEGABYTES = 2048
# Seconds that a process may take beside the time limits of its parts, to start and to end.
GRACE = 20


@dataclass(frozen=True)
class Limits:
    """seconds : of a part, by the clock; megabytes : of a process's address space"""

    seconds: float = DEFAULT_SECONDS
    megabytes: int = DEFAULT_MEGABYTES


def add_limit_arguments(parser):
    parser.add_argument(
        "--time-limit",
        metavar="SECONDS",
        type=_positive(float, 86400),
        default=DEFAULT_SECONDS,
        help="how long a submission may take for each part of a grader (default: %(default)g)",
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
        with suppress(ValueError):
            if 0 < kind(text) <= high:
                return kind(text)
        raise argparse.ArgumentTypeError(
            f"must be a number above 0 and up to {high}, not '{brief(text, 40)}'"
        )

    return parse


def limits_of(arguments):
    return Limits(arguments.time_limit, arguments.memory_limit)


class Stopped(BaseException):
    """SIGTERM or a hang-up; its argument is the exit code. Ctrl-C is Python's KeyboardInterrupt."""


def prepare_terminal():
    """Lets a signal end the program in good order, and print what its output has no letters for."""

    def stop(number, _frame):
        raise Stopped(128 + number)

    for name in ("SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), stop)
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(errors="replace")


# ---- Processes ----------------------------------------------------------------------------------


@contextmanager
def copied(folder):
    """Yields the path of a copy of a folder, which is removed in the end."""
    with tempfile.TemporaryDirectory(prefix="running-", ignore_cleanup_errors=True) as place:
        yield Path(shutil.copytree(folder, Path(place).resolve() / "work"))


def environment(folder):
    """The environment of a student's program: nothing that would change its numbers or its ways,
    and no display on which it could open a window."""
    dropped = {"DISPLAY", "WAYLAND_DISPLAY"}
    kept = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith("PYTHON") and name not in dropped
    }
    return kept | {
        "PYTHONHASHSEED": "0",
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONUTF8": "1",
        "MPLBACKEND": "Agg",
        "OPENBLAS_NUM_THREADS": "1",  # each thread would ask for memory of its own
        "OMP_NUM_THREADS": "1",
        "TMPDIR": str(folder),
    }


def run_limited(words, folder, seconds, megabytes, errors=subprocess.DEVNULL):
    """Runs `worker.py` with these words, and whatever it starts, for so many seconds.

    errors : a file that its standard error goes to; its output is dropped
    Raises SubmissionError once `stop_all` has been called.

    Returns its exit code, negative where a signal ended it, and None where the time was up.
    """
    if _isStopped.is_set():
        raise SubmissionError("stopped")
    limits = megabytes, int(seconds) + 1
    process = subprocess.Popen(
        [sys.executable, "-B", GRADERS / "worker.py", *map(str, (*limits, *words))],
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


# ---- Grading ------------------------------------------------------------------------------------


def run_isolated(graders, folder, dataFolder, data, limits):
    """What a student's modules compute: a dict from a grader's module to a list of (Part, Results).

    data : dict from a grader's module to its data, which the process reads from dataFolder

    One process runs all parts. A part at which it ends is given up, and another process goes on
    with the next one.
    """
    parts = {
        (grader.module, part.name): part
        for grader in graders
        for part in grader.asked(data[grader.module], withExtras=True)
    }
    outcomes = {}
    conventions = {grader.module: data[grader.module]["convention"] for grader in graders}
    while missing := [key for key in parts if key not in outcomes]:
        order = {"parts": missing, "conventions": conventions, "data": str(dataFolder.resolve())}
        contents, begun, cause = _run(order, folder, limits)
        for key in missing:
            given = data[key[0]]
            results = Results(parts[key].shapes, len(given["randomPositions"]))
            tried = len(parts[key].samples(given))
            if key in contents:
                try:
                    results.read_json(contents[key])
                except (ValueError, KeyError, TypeError, AttributeError):
                    results.give_up("gave no readable results", tried)
            elif key == begun or begun is None and not contents:
                results.give_up(cause, tried)
            else:
                continue
            outcomes[key] = results
    return {
        grader.module: [(parts[key], outcomes[key]) for key in parts if key[0] == grader.module]
        for grader in graders
    }


def _run(order, folder, limits):
    """One process of `worker.py`, on a copy of a folder, and what it has left.

    Returns a dict from (module, part) to results as `Results.as_json` has them; the part at which
    it has ended, or None; and why it has ended.
    """
    contents, begun, isLoaded, cause = {}, None, False, None
    with copied(folder) as work:
        answers, trace = work.parent / "answers.jsonl", work.parent / "trace.txt"
        for path in (answers, trace):
            path.touch()
        places = {"folder": str(work), "answers": str(answers), "trace": str(trace)}
        seconds = (len(order["parts"]) + 1) * limits.seconds + GRACE
        words = [json.dumps(order | places | {"seconds": limits.seconds})]
        code = run_limited(words, work, seconds, limits.megabytes)
        for line in answers.read_text(encoding="utf-8", errors="replace").splitlines():
            try:
                answer = json.loads(line)
                isLoaded = isLoaded or "loaded" in answer
                cause = answer.get("refused", cause)
                if "begun" in answer:
                    begun = tuple(answer["begun"])
                elif "results" in answer and tuple(answer["part"]) == begun:
                    contents[begun], begun = answer["results"], None
            except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
                continue  # cut off, or not ours
        if cause is None:
            during = "" if isLoaded else " while the modules were imported"
            said = trace.read_text(errors="replace")
            cause = _reason(code, said, limits) + during + _place(said, work)
    return contents, begun, brief(cause)


def _reason(code, said, limits):
    """Why a process has ended before its time; said : what it has left in its trace."""
    if code is None or "Timeout (" in said:
        return f"stopped after {limits.seconds:g} s"
    if code < 0:
        name = signal.Signals(-code).name if -code in set(signal.Signals) else str(-code)
        return f"crashed the interpreter ({name})"
    return f"ended the interpreter with exit code {code}"


def _place(said, work):
    """Where the student's program was, as ", at FILE:LINE"; or nothing."""
    for file, line in re.findall(r'File "([^"\n]+)", line (\d+)', said):
        if Path(file).is_relative_to(work):
            return f", at {brief(Path(file).relative_to(work))}:{line}"
    return ""
