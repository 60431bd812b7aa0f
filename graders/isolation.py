"""Running a student's modules in a process of its own, on a copy of their folder, with limits.

What is run may never end, end the interpreter, crash it, or write where it stands: none of this
reaches the grader or another submission. It is not a prison, though: the process has the rights of
whoever grades, and can read and write their files if it sets out to.
"""

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
from pathlib import Path

from trials import Results

from rbs.program.options import at_least, option_type
from rbs.program.submissions import SubmissionError

WORKER = Path(__file__).resolve().with_name("worker.py")
SECONDS = option_type(float, at_least(0.1, 86400), "number")
MEGABYTES = option_type(int, at_least(1, 1 << 20), "whole number")
# Seconds that a process may take beside the time limits of its parts, to start and to end.
GRACE = 20


def add_limit_arguments(parser):
    """Two options; what they give, `seconds` and `megabytes`, is what is called limits here."""
    parser.add_argument(
        "--time-limit",
        dest="seconds",
        metavar="SECONDS",
        type=SECONDS,
        default=30,
        help="how long a submission may take for each part of a grader (default: %(default)g)",
    )
    parser.add_argument(
        "--memory-limit",
        dest="megabytes",
        metavar="MB",
        type=MEGABYTES,
        default=2048,
        help="how much memory a submission may ask for (default: %(default)d)",
    )


# ---- Processes ----------------------------------------------------------------------------------


@contextmanager
def copied(folder):
    """Yields the path of a copy of a folder, which is removed in the end."""
    with tempfile.TemporaryDirectory(prefix="running-", ignore_cleanup_errors=True) as place:
        yield Path(shutil.copytree(folder, Path(place).resolve() / "work"))


def environment(folder):
    """The environment of a student's program: nothing that would change its numbers or its ways,
    and no display on which it could open a window."""
    dropped = ("PYTHON", "DISPLAY", "WAYLAND_DISPLAY")
    kept = {name: text for name, text in os.environ.items() if not name.startswith(dropped)}
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
    Returns its exit code, negative where a signal ended it, and None where the time was up.
    Raises SubmissionError once `stop_all` has been called.
    """
    if _isStopped.is_set():
        raise SubmissionError("stopped")
    words = map(str, (megabytes, int(seconds) + 1, os.getpid(), *words))
    process = subprocess.Popen(
        [sys.executable, "-B", WORKER, *words],
        cwd=folder,
        env=environment(folder.parent),
        start_new_session=True,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=errors,
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
    with the next one; modules that cannot be imported end all parts at once.
    """
    parts = {
        (grader.module, part.name): part
        for grader in graders
        for part in grader.asked(data[grader.module], withExtras=True)
    }
    outcomes = {}
    order = {"conventions": {one.module: data[one.module]["convention"] for one in graders}}
    order |= {"data": str(dataFolder.resolve()), "seconds": limits.seconds}
    while missing := [key for key in parts if key not in outcomes]:
        contents, isLoaded, cause = _run(order | {"parts": missing}, folder, limits)
        for key in missing:
            given = data[key[0]]
            results = outcomes[key] = Results(parts[key].shapes, len(given["randomPositions"]))
            if key in contents:
                results.read_json(contents[key])
                continue
            results.give_up(cause, len(parts[key].samples(given)))
            if isLoaded:
                break
    return {
        grader.module: [(parts[key], outcomes[key]) for key in parts if key[0] == grader.module]
        for grader in graders
    }


def _run(order, folder, limits):
    """One process of `worker.py`, on a copy of a folder, and what it has left.

    Returns a dict from (module, part) to results as `Results.as_json` has them; whether the modules
    could be imported; and why it has ended.
    """
    contents, isLoaded, cause = {}, False, None
    with copied(folder) as work:
        answers, trace = work.parent / "answers.jsonl", work.parent / "trace.txt"
        places = {"folder": str(work), "answers": str(answers), "trace": str(trace)}
        seconds = (len(order["parts"]) + 1) * limits.seconds + GRACE
        code = run_limited([json.dumps(order | places)], work, seconds, limits.megabytes)
        for line in answers.read_text(encoding="utf-8").splitlines() if answers.exists() else ():
            with suppress(ValueError):  # of a line that is cut off
                answer = json.loads(line)
                isLoaded = isLoaded or "loaded" in answer
                cause = answer.get("refused")
                if "part" in answer:
                    contents[tuple(answer["part"])] = answer["results"]
        during = "" if isLoaded else " while the modules were imported"
        said = trace.read_text(errors="replace") if trace.exists() else ""
        cause = cause or _reason(code, said, limits.seconds) + during + _place(said, work)
    return contents, isLoaded, cause


def _reason(code, said, seconds):
    """Why a process has ended before its time; said : what it has left in its trace."""
    if code is None or "Timeout (" in said:
        return f"stopped after {seconds:g} s"
    if code < 0:
        name = signal.Signals(-code).name if -code in set(signal.Signals) else str(-code)
        return f"crashed the interpreter ({name})"
    return f"ended the interpreter with exit code {code}"


def _place(said, work):
    """Where the student's program was, as ", at FILE:LINE"; or nothing."""
    for file, line in re.findall(r'File "([^"\n]+)", line (\d+)', said):
        if Path(file).is_relative_to(work):
            return f", at {Path(file).relative_to(work)}:{line}"
    return ""
