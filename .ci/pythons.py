"""Runs the quick set, tests/quick.py, with every Python of this machine that is promised.

    python3 .ci/pythons.py

Looks for CPython, from pyproject.toml's requires-python on, among pyenv's versions, on PATH and in
/usr/bin. Each gets a fresh environment with the newest dependencies. The oldest gets a second one,
with the oldest dependencies that pyproject.toml allows; there, a slice of the suite runs too.
Two environments are made at a time. Ends with exit code 1 if anything failed.
"""

import glob
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
ASK = (
    "import os, sys; print(sys.implementation.name, *sys.version_info[:3], "
    "os.path.realpath(sys.executable), sep='\\n')"
)
# Quaternions, meshes, and what SciPy's sparse matrices and graphs do in the soft step.
SLICE = [
    "tests/geometry/test_quaternion.py",
    "tests/stepping/test_mesh.py",
    "tests/softstep/test_softstep.py",
    "-k",
    "quaternion or mesh or elastic or manifold or sleep or wakes",
]
# Seconds, for a command that hangs.
TIME_LIMIT = 600


def find_pythons():
    """The interpreters, oldest first and each once: list of (version, path)."""
    pyenv = os.path.expanduser(os.environ.get("PYENV_ROOT") or "~/.pyenv")
    folders = [*glob.glob(f"{pyenv}/versions/*/bin"), *os.get_exec_path(), "/usr/bin"]
    paths = [path for folder in folders for path in glob.glob(f"{folder}/python3*")]
    oldest = (3, int(re.search(r'requires-python = ">=3\.(\d+)"', PROJECT)[1]))
    found = set()
    for path in filter(re.compile(r".*/python3(\.\d+)?").fullmatch, paths):
        try:
            # One of pyenv's shims may fail, as the version that it stands for is not selected.
            answer = subprocess.run([path, "-c", ASK], capture_output=True, text=True, timeout=60)
        except (OSError, subprocess.TimeoutExpired):
            continue
        name, *version, executable = answer.stdout.splitlines() or [""] * 5
        if answer.returncode == 0 and name == "cpython":
            found.add((tuple(map(int, version)), executable))
    return sorted(one for one in found if one[0] >= oldest)


def oldest_versions():
    """The lower bounds of all dependencies, as the lines of pip's constraints file."""
    bounds = set(re.findall(r'"([\w-]+)>=([\d.]+)"', PROJECT.partition("[project]")[2]))
    return "".join(f"{name}=={version}\n" for name, version in sorted(bounds))


def run_all(python, wheel, isOldest, folder):
    """Makes an environment in a folder, and runs there what is to be run.

    Yields (name, seconds, finished process) of each part, whose output is in one string; the last
    part is the first that fails.
    """
    new = folder / "environment/bin/python"
    pip = [new, "-m", "pip", "install", "-q", "--disable-pip-version-check", "--only-binary=:all:"]
    constraints = folder / "oldest.txt"
    constraints.write_text(oldest_versions())
    wanted = [f"{wheel}[test,plot,video]", "-c", constraints] if isOldest else [wheel]
    parts = [
        ("venv", [python, "-m", "venv", folder / "environment"], folder),
        ("install", [*pip, *wanted], folder),
        ("quick set", [new, ROOT / "tests/quick.py"], folder),
    ]
    if isOldest:
        parts.append(("slice", [new, "-m", "pytest", "-q", *SLICE], ROOT))
    for name, command, place in parts:
        start = time.monotonic()
        process = run(command, place)
        yield name, time.monotonic() - start, process
        if process.returncode != 0:
            return


def run(command, folder=ROOT):
    """Runs a command; returns the finished process, with all its output in one string."""
    return subprocess.run(
        [str(word) for word in command],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=TIME_LIMIT,
    )


def passes(python, version, wheel, isOldest):
    """Prints what became of all parts; returns whether they pass."""
    lines = []
    with tempfile.TemporaryDirectory() as folder:
        for name, seconds, process in run_all(python, wheel, isOldest, Path(folder)):
            lines += [f"{name}, {seconds:.0f} s", *process.stdout.splitlines()]
    isWell = process.returncode == 0
    which = "oldest" if isOldest else "newest"
    title = f"{python} ({'.'.join(map(str, version))}), {which} dependencies"
    print(f"{title}: {'passed' if isWell else 'FAILED'}", *lines, sep="\n    ", flush=True)
    return isWell


def main():
    pythons = find_pythons()
    if not pythons:
        sys.exit("no Python was found that the project promises to run with")
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(2) as pool:
        oldest = pythons[0][1]
        tools, source = Path(folder, "tools"), Path(folder, "source")
        # A copy is built, since the build leaves files behind.
        shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns(".*", "build", "report"))
        for command in (
            [oldest, "-m", "venv", tools],
            [tools / "bin/pip", "wheel", "-q", "--no-deps", "-w", folder, source],
        ):
            process = run(command)
            if process.returncode != 0:
                sys.exit(f"{process.stdout}the program cannot be built")
        (wheel,) = Path(folder).glob("*.whl")
        runs = [(oldest, pythons[0][0], True)]
        runs += [(python, version, False) for version, python in pythons]
        results = list(pool.map(lambda one: passes(one[0], one[1], wheel, one[2]), runs))
    print(f"{sum(results)} of {len(results)} environments pass")
    sys.exit(not all(results))


if __name__ == "__main__":
    main()
