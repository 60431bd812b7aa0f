"""Runs the quick set, tests/quick.py, with every Python of this machine that is promised.

    python -m nox -f .ci/noxfile.py

Each CPython gets a fresh environment: the oldest with the oldest dependencies that pyproject.toml
allows, where a slice of the suite runs, too, and the others with the newest ones.
"""

import os
import re
from glob import glob
from pathlib import Path

import nox

ROOT = Path(__file__).resolve().parents[1]
PROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
OLDEST = int(re.search(r'requires-python = ">=3\.(\d+)"', PROJECT)[1])
# Quaternions, meshes with what SciPy's graphs do for them, and the soft step.
SLICE = "geometry/test_quaternion.py stepping/test_mesh.py softstep/test_softstep.py".split()
SLICE_NAMES = "quaternion or mesh or elastic or sleep"

nox.options.default_venv_backend = "virtualenv"


def pythons():
    """The paths of all Pythons, oldest first: pyenv's, those on PATH, and the system's."""
    pyenv = os.path.expanduser(os.environ.get("PYENV_ROOT") or "~/.pyenv")
    folders = [*glob(f"{pyenv}/versions/*/bin"), *os.get_exec_path(), "/usr/bin"]
    found = {}
    for folder in folders:
        for path in glob(f"{folder}/python3.*[0-9]"):  # without pyenv's shims, which may fail
            minor = int(path.rpartition(".")[2])
            if minor >= OLDEST and Path(path).parent.name != "shims":
                found[os.path.realpath(path)] = minor
    return sorted(found, key=found.get)


def oldest_versions():
    """The lower bounds of all dependencies, as pip's constraints."""
    bounds = set(re.findall(r'"([\w-]+)>=([\d.]+)"', PROJECT.partition("[project]")[2]))
    return "".join(f"{name}=={version}\n" for name, version in sorted(bounds))


@nox.session(python=pythons()[1:])
def newest(session):
    session.chdir(ROOT)
    session.install("--no-compile", ".")
    session.run("python", "tests/quick.py")


@nox.session(python=pythons()[0])
def oldest(session):
    constraints = Path(session.create_tmp()).resolve() / "oldest.txt"
    constraints.write_text(oldest_versions())
    session.chdir(ROOT)
    session.install("--no-compile", ".", "pytest", "-c", str(constraints))
    session.run("python", "tests/quick.py")
    session.run(
        "python", "-m", "pytest", "-q", *(f"tests/{file}" for file in SLICE), "-k", SLICE_NAMES
    )
