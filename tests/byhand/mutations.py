"""Plants faults in copies of the code, one at a time, and tells whether a test notices each.

Each process has a copy of the project of its own, in a temporary folder. For each fault, the test
named with it runs, without its slow cases.
"""

import os
import queue
import re
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from importlib.util import cache_from_source
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
# also the tests of the report, which need its built files
LEFT_OUT = shutil.ignore_patterns(".*", "__pycache__", "out", "report")


class Fault(NamedTuple):
    file: str
    what: str
    test: str  # that must notice it, as FILE::TEST
    text: str  # occurs once in the file
    wrong: str


ROW = re.compile(r"^(\S+): (.+) \((.+)\)\n {4}(.+) -> (.+)$", re.MULTILINE)
TABLE = Path(__file__).with_name("faults.txt").read_text(encoding="utf-8")
FAULTS = [Fault(*row) for row in ROW.findall(TABLE)]
KEPT = {name: os.environ[name] for name in os.environ if name != "PYTHONDONTWRITEBYTECODE"}


def path_of(test, project):
    file, _, name = test.partition("::")
    (path,) = project.glob(f"tests/*/test_{file}.py")
    return f"{path}::{name}"


def first_failure(project, *words):
    """Runs pytest in a copy of the project; returns the first test that fails, or ""."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *words]
    process = subprocess.run(command, cwd=project, capture_output=True, text=True, env=KEPT)
    failed = re.search(r"^(?:FAILED|ERROR) (\S+)", process.stdout, re.MULTILINE)
    if (process.returncode != 0) != bool(failed):
        raise RuntimeError(f"pytest ended otherwise than expected:\n{process.stdout[-2000:]}")
    return failed[1] if failed else ""


def noticed(fault, project):
    """Returns the first case of the test that fails with the fault, or ""."""
    path = project / fault.file
    source = path.read_text(encoding="utf-8")
    path.write_text(source.replace(fault.text, fault.wrong), encoding="utf-8")
    try:
        return first_failure(project, path_of(fault.test, project))
    finally:
        shutil.copy2(ROOT / fault.file, path)
        # which would stand for another fault of this size in the same second
        Path(cache_from_source(path)).unlink(missing_ok=True)


def chosen_faults(words):
    """The (number, fault) whose number is among the words, or whose file and name contain one, all
    if there are none.
    """
    return [
        (number, fault)
        for number, fault in enumerate(FAULTS, start=1)
        if not words
        or str(number) in words
        or any(not one.isdecimal() and one in f"{fault.file}: {fault.what}" for one in words)
    ]


def main(options):
    begin, chosen = time.monotonic(), chosen_faults(options.words)
    if not chosen:
        print("there is no such fault")
        return 2
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(options.jobs) as executor:
        copies = queue.SimpleQueue()
        for k in range(options.jobs):
            copies.put(Path(shutil.copytree(ROOT, Path(folder, str(k)), ignore=LEFT_OUT)))
        project = copies.get()
        tests = sorted({path_of(fault.test, project) for _, fault in chosen})
        if failed := first_failure(project, "-n", str(options.jobs), "--dist", "worksteal", *tests):
            print(f"without a fault, {failed} fails")
            return 1
        copies.put(project)

        def tried(fault):
            started, project = time.monotonic(), copies.get()
            try:
                return noticed(fault, project), time.monotonic() - started
            finally:
                copies.put(project)

        results, survivors = executor.map(tried, [fault for _, fault in chosen]), 0
        for (number, fault), (failed, seconds) in zip(chosen, results, strict=True):
            survivors += not failed
            told = failed or "SURVIVED"
            print(f"{number:3} {seconds:4.0f} s  {fault.file}: {fault.what}: {told}", flush=True)
    count, minutes = len(chosen), (time.monotonic() - begin) / 60
    print(f"{count - survivors} of {count} faults are noticed, {minutes:.1f} minutes")
    return int(survivors > 0)
