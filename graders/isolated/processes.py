"""Runs a student's modules in a process of its own, on a copy of their folder, within limits.

The modules may hang, end or crash the interpreter, or write beside themselves without harm to the
grader or to other submissions. This is not a sandbox: the process has the rights of the person who
grades, and can read and write their files. From the top: processes and their limits; grading.
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

from verdict.parts import Results

from rbs.program.parsing import at_least, option_type
from rbs.program.submissions import SubmissionError

WORKER = Path(__file__).resolve().with_name("worker.py")
# Seconds that a process may take in addition to the time limits of its parts, to start and to end.
GRACE = 20
# The environment of a student's program: same numbers each time, no window, one thread because
# each would take memory of its own.
_ONES = "PYTHONDONTWRITEBYTECODE PYTHONUTF8 OPENBLAS_NUM_THREADS OMP_NUM_THREADS".split()
ENVIRONMENT = {"PYTHONHASHSEED": "0", "MPLBACKEND": "Agg"} | dict.fromkeys(_ONES, "1")
DROPPED = ("PYTHON", "DISPLAY", "WAYLAND_DISPLAY")


def add_limit_arguments(parser, seconds=30):
    """Adds two options, whose values `seconds` and `megabytes` are called limits here."""
    form = {"type": option_type(float, at_least(0.1, 86400), "number"), "default": seconds}
    text = "time limit for each part of a grader, and each scene (default: %(default)g)"
    parser.add_argument("--time-limit", dest="seconds", metavar="SECONDS", **form, help=text)
    form = {"type": option_type(int, at_least(1, 1 << 20), "whole number"), "default": 2048}
    text = "memory limit of a submission (default: %(default)d)"
    parser.add_argument("--memory-limit", dest="megabytes", metavar="MB", **form, help=text)


@contextmanager
def copied(folder):
    """Yields a copy of a folder, beside one of its ../data; an empty folder for None."""
    with tempfile.TemporaryDirectory(prefix="running-", ignore_cleanup_errors=True) as place:
        work = Path(place).resolve() / "work"
        work.mkdir()
        if folder is not None:
            shutil.copytree(folder.with_name("data"), work.with_name("data"))
            shutil.copytree(folder, work, dirs_exist_ok=True)
        yield work


def run_limited(words, folder, seconds, megabytes, errors=subprocess.DEVNULL):
    """Runs `worker.py` with these words, and ends all processes that it has started.

    errors : a file for its standard error; its output is dropped

    Returns its exit code, negative if a signal ended it, None if the time was up. Raises
    SubmissionError after a call of `stop_all`.
    """
    if _isStopped.is_set():
        raise SubmissionError("stopped")
    kept = {name: text for name, text in os.environ.items() if not name.startswith(DROPPED)}
    words = megabytes, int(seconds) + 1, os.getpid(), *words
    command = [sys.executable, "-B", WORKER, *map(str, words)]
    form = {"cwd": folder, "env": kept | ENVIRONMENT | {"TMPDIR": str(folder.parent)}}
    form |= {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": errors}
    process = subprocess.Popen(command, start_new_session=True, **form)
    _running.add(process)
    try:
        return process.wait(0 if _isStopped.is_set() else seconds)  # stopped meanwhile
    except subprocess.TimeoutExpired:
        return None
    finally:
        _running.discard(process)
        _end(process)


# The processes of all threads, and whether no more may be started.
_running = set()
_isStopped = threading.Event()


def stop_all():
    """Ends all processes, and prevents new ones."""
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


def run_isolated(graders, folder, dataFolder, data, limits):
    """Runs all parts of the graders; returns a dict from a grader's module to [(Part, Results)].

    One process runs all parts. A part during which it ends is given up, and another process
    continues with the next one. If the modules cannot be imported, all parts are given up; if that
    is not the student's mistake, a SubmissionError is raised, with a remedy.

    data : dict from a grader's module to its data, which the process reads from dataFolder
    limits : with `seconds` for each part, and `megabytes`
    """
    parts = {
        (one.module, part.name): part for one in graders for part in one.asked(data[one.module])
    }
    outcomes = {}
    order = {"data": str(dataFolder.resolve()), "seconds": limits.seconds}
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
    modules = {one.module: [key for key in parts if key[0] == one.module] for one in graders}
    return {name: [(parts[key], outcomes[key]) for key in keys] for name, keys in modules.items()}


def _run(order, folder, limits):
    """Runs `worker.py` once, on a copy of a folder, and reads the files that it has written.

    Returns a dict from (module, part) to results as `Results.as_json` gives them, whether the
    modules could be imported, and why the process ended.
    """
    contents, isLoaded, cause, remedy = {}, False, None, None
    with copied(folder) as work:
        answers, trace = work.parent / "answers.jsonl", work.parent / "trace.txt"
        places = {"folder": str(work), "answers": str(answers), "trace": str(trace)}
        seconds = (len(order["parts"]) + 1) * limits.seconds + GRACE
        code = run_limited([json.dumps(order | places)], work, seconds, limits.megabytes)
        for line in answers.read_text(encoding="utf-8").splitlines() if answers.exists() else ():
            with suppress(ValueError):  # a line that is cut off
                answer = json.loads(line)
                isLoaded = isLoaded or "loaded" in answer
                cause = answer.get("refused")
                remedy = answer.get("remedy")
                if "part" in answer:
                    contents[tuple(answer["part"])] = answer["results"]
        isLate, place = traced(trace, work)
    if remedy:
        raise SubmissionError(cause, remedy)
    if code is None or isLate:
        reason = f"stopped after {limits.seconds:g} s"
    elif code < 0:
        reason = f"crashed the interpreter ({signal.Signals(-code).name})"
    else:
        reason = f"ended the interpreter with exit code {code}"
    reason += "" if isLoaded else " while the modules were imported"
    return contents, isLoaded, cause or reason + place


def traced(path, folder):
    """What the trace file of a process says: whether it ran out of time, and the innermost line of
    code in the folder as ", at FILE:LINE"; "" if there is none.
    """
    said = path.read_text(errors="replace") if path.exists() else ""
    lines = re.findall(r'File "([^"\n]+)", line (\d+)', said)
    own = [(Path(file), line) for file, line in lines if Path(file).is_relative_to(folder)]
    place = f", at {own[0][0].relative_to(folder)}:{own[0][1]}" if own else ""
    return "Timeout (" in said, place
