"""Runs a script, or grades a student's modules, within limits kept by the operating system.

    python graders/isolated/worker.py MEGABYTES SECONDS PARENT SCRIPT ARGUMENT...
    python graders/isolated/worker.py MEGABYTES SECONDS PARENT ORDER    JSON from `processes`

PARENT is the process ID of the starting process; SECONDS are of processor time, and the order holds
a part's time by the clock. Grading writes a line of JSON after each part, so that results are kept
however the process ends.
"""

import faulthandler
import importlib
import json
import os
import runpy
import signal
import sys
from pathlib import Path

# The largest file, in bytes, that a submission may write.
LARGEST_FILE = 64 << 20
PR_SET_PDEATHSIG = 1  # of Linux's prctl


def limit(megabytes, seconds, parent):
    """Limits memory, files and processor time of this process and its children.

    On Linux the process also ends when its parent does.
    """
    try:
        import resource
    except ImportError:  # Windows
        return
    bounds = {"AS": megabytes << 20, "FSIZE": LARGEST_FILE, "CPU": seconds, "CORE": 0}
    for name, bound in bounds.items():
        what = getattr(resource, f"RLIMIT_{name}")
        _soft, hard = resource.getrlimit(what)
        if hard != resource.RLIM_INFINITY:
            bound = min(bound, hard)
        resource.setrlimit(what, (bound, bound))
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it has ended before
            os._exit(1)


def grade(order):
    """Grades as the order says, and writes the answers."""
    trace = open(order["trace"], "w")  # stays open as long as the process lives
    faulthandler.enable(trace)

    def start_clock():
        faulthandler.dump_traceback_later(order["seconds"], file=trace, exit=True)

    sys.path[0] = str(Path(__file__).resolve().parents[1])
    from reference.graderData import give_up_names
    from verdict.bodies import Bodies

    from rbs.program.submissions import SubmissionError, load_submission

    graders = {module: importlib.import_module(module).GRADER for module, _ in order["parts"]}
    data = {module: one.load(Path(order["data"])) for module, one in graders.items()}
    give_up_names()
    with open(order["answers"], "w", encoding="utf-8") as answers:

        def answer(**content):
            print(json.dumps(content), file=answers, flush=True)

        os.chdir(folder := order["folder"])
        start_clock()
        try:
            submission = load_submission(folder)
        except SubmissionError as error:
            return answer(refused=str(error), remedy=error.remedy)
        answer(loaded=True)
        *modules, told = submission.functions, submission.quaternion, submission.remarks
        bodies = {module: Bodies(*modules, one, told) for module, one in data.items()}
        for module, name in order["parts"]:
            start_clock()
            (part,) = (one for one in graders[module].parts if one.name == name)
            results = part.run(bodies[module], data[module], folder)
            answer(part=[module, name], results=results.as_json())


if __name__ == "__main__":
    *numbers, script = sys.argv[1:5]
    limit(*map(int, numbers))
    if script.endswith(".py"):
        del sys.argv[:4]
        sys.path[0] = str(Path(script).resolve().parent)
        runpy.run_path(script, run_name="__main__")
    else:
        sys.argv[1:] = []
        grade(json.loads(script))
        os._exit(0)  # skips exit handlers and threads of the submission
