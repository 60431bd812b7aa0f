"""The process of a student's code: reads orders, and writes an answer to each, as lines of JSON.

    python main.py MEGABYTES SECONDS USER

SECONDS are of processor time; USER is the ID of the user that it becomes, or 0. The first order
names the folder of the modules. Orders come through standard input, answers go through standard
output; both are moved out of reach of `print` and `input` before the student's code is imported.
"""

import faulthandler
import json
import os
import signal
import sys
from pathlib import Path

# The largest file, in bytes, that a submission may write, and how many processes and threads it may
# have as a user of its own.
LARGEST_FILE, MOST_PROCESSES = 64 << 20, 64


def limit(megabytes, seconds, user):
    """Limits memory, files and processor time of this process and its children.

    user : ID of the user that the process becomes, or 0 for none
    """
    try:
        import resource
    except ImportError:  # Windows
        return
    bounds = {"AS": megabytes << 20, "FSIZE": LARGEST_FILE, "CPU": seconds, "CORE": 0}
    for name, bound in (bounds | ({"NPROC": MOST_PROCESSES} if user else {})).items():
        what = getattr(resource, f"RLIMIT_{name}")
        _soft, hard = resource.getrlimit(what)
        if hard != resource.RLIM_INFINITY:
            bound = min(bound, hard)
        resource.setrlimit(what, (bound, bound))
    if user:
        keep_imports()
        os.setgroups([])
        os.setgid(user)
        os.setuid(user)


def keep_imports():
    """Opens the folders that modules come from, because those above may be closed to others."""
    opened = {
        one: f"/proc/self/fd/{os.open(one, os.O_RDONLY)}" for one in sys.path if os.path.isdir(one)
    }
    sys.path[1:] = [opened.get(one, one) for one in sys.path[1:]]
    for package in [one for one in sys.modules.values() if hasattr(one, "__path__")]:
        for one, new in opened.items():
            package.__path__ = [path.replace(one, new, 1) for path in package.__path__]


def hide_project():
    """Takes what an editable installation of this project adds off the path for imports."""
    sys.path[:] = [
        one for one in sys.path if not os.path.isfile(os.path.join(one, "RBSFunctions.py"))
    ]
    kept = [one for one in sys.meta_path if "__editable__" not in getattr(one, "__module__", "")]
    sys.meta_path[:] = kept


def serve(orders, answers):
    """Imports the modules, and does as each order says."""

    def tell(answer):
        answers.write(json.dumps(answer).encode() + b"\n")
        answers.flush()

    begin = json.loads(orders.readline())
    trace = open(begin["trace"], "w")  # stays open as long as the process lives
    faulthandler.enable(trace)
    hasClock = hasattr(signal, "setitimer")  # of processor time; not on Windows
    if hasClock:
        faulthandler.register(signal.SIGPROF, file=trace, chain=True)  # writes, and then ends it

    def start_clock(seconds):
        if hasClock:
            signal.setitimer(signal.ITIMER_PROF, seconds)
        else:
            faulthandler.dump_traceback_later(seconds, file=trace, exit=True)

    sys.path[0] = str(Path(__file__).resolve().parents[1])
    hide_project()
    from rbs.program.submissions import SubmissionError, describe, load_submission
    from worker import calls, steps

    os.chdir(folder := begin["folder"])
    start_clock(begin["seconds"])
    try:
        submission = load_submission(folder)
    except SubmissionError as error:
        return tell({"refused": str(error), "remedy": error.remedy})
    tell({"loaded": True, "remarks": submission.remarks})
    modules, scene = (submission.functions, submission.quaternion), None
    for line in orders:
        order = json.loads(line)
        start_clock(order["seconds"])
        try:
            if "call" in order:
                answer = calls.answer(order, *modules, folder)
            elif "bodies" in order:
                scene = steps.Scene(order, submission.functions, folder)
                answer = scene.built()
            else:
                answer = scene.call(order)
        except BaseException as error:  # a student's class may raise anything
            answer = {"failed": describe(error, folder)}
        tell(answer | {"number": order["number"]})
    return None


if __name__ == "__main__":
    limit(*map(int, sys.argv[1:]))
    del sys.argv[1:]
    pipes = [os.fdopen(os.dup(number), mode) for number, mode in ((0, "rb"), (1, "wb"))]
    for number in (0, 1):
        os.dup2(os.open(os.devnull, os.O_RDWR), number)
    serve(*pipes)
    os._exit(0)  # skips exit handlers and threads of the submission
