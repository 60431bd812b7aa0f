"""The process of a student's code: reads orders, and writes an answer to each, as lines of JSON.

    python main.py MEGABYTES SECONDS PARENT

PARENT is the process ID of the starting process; SECONDS are of processor time. The first order
names the folder of the modules. Orders come through standard input, answers go through standard
output; both are moved out of reach of `print` and `input` before the student's code is imported.
"""

import faulthandler
import json
import os
import signal
import sys
from pathlib import Path

# The largest file, in bytes, that a submission may write.
LARGEST_FILE = 64 << 20
# Of Linux's prctl; and the version of capabilities, and how many there may be.
PR_SET_PDEATHSIG, PR_SET_DUMPABLE, PR_CAPBSET_DROP = 1, 4, 24
CAPABILITIES, MOST_CAPABILITIES = 0x20080522, 64


def limit(megabytes, seconds, parent):
    """Limits memory, files and processor time of this process and its children.

    On Linux the process also ends when its parent does, has none of root's privileges, and closes
    its memory and its open files to others.
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

        system = ctypes.CDLL(None)
        system.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        for number in range(MOST_CAPABILITIES):
            system.prctl(PR_CAPBSET_DROP, number, 0, 0, 0)
        system.capset((ctypes.c_uint32 * 2)(CAPABILITIES, 0), (ctypes.c_uint32 * 6)())
        system.prctl(PR_SET_DUMPABLE, 0, 0, 0, 0)
        if os.getppid() != parent:  # it has ended before
            os._exit(1)


def hide_project():
    """Takes what an editable installation of this project adds off the path for imports."""
    sys.path[:] = [one for one in sys.path if not (Path(one) / "RBSFunctions.py").is_file()]
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

    def start_clock(seconds):
        faulthandler.dump_traceback_later(seconds, file=trace, exit=True)

    sys.path[0] = str(Path(__file__).resolve().parents[1])
    hide_project()
    from rbs.program.submissions import SubmissionError, load_submission
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
        if "call" in order:
            answer = calls.answer(order, *modules, folder)
        elif "bodies" in order:
            scene = steps.Scene(order, submission.functions, folder)
            answer = scene.built()
        else:
            answer = scene.step(order)
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
