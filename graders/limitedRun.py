"""Runs a script within limits: of the memory it may ask for, and of the files it may write.

    python graders/limitedRun.py MEGABYTES SCRIPT ARGUMENT...
"""

import runpy
import sys
from pathlib import Path

MEGABYTE = 1 << 20
# The most bytes of a file that a submission may write.
LARGEST_FILE = 64 * MEGABYTE


def limit(megabytes):
    """Bounds the address space and the files of this process, where the system can do that."""
    try:
        import resource
    except ImportError:  # Windows
        return
    for what, bound in (
        (resource.RLIMIT_AS, megabytes * MEGABYTE),
        (resource.RLIMIT_FSIZE, LARGEST_FILE),
        (resource.RLIMIT_CORE, 0),
    ):
        _soft, hard = resource.getrlimit(what)
        if hard != resource.RLIM_INFINITY:
            bound = min(bound, hard)
        resource.setrlimit(what, (bound, bound))


if __name__ == "__main__":
    limit(int(sys.argv[1]))
    del sys.argv[:2]
    sys.path[0] = str(Path(sys.argv[0]).resolve().parent)
    runpy.run_path(sys.argv[0], run_name="__main__")
