"""The program as it is installed: from a wheel, and from a source distribution, without a checkout.

Slow: each makes an environment of its own, which takes the libraries from this one.
"""

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest
from oracles import ROOT
from program import environment
from studentVariants import STUDENT

PROJECT = ("rbs", "data", "graders", "README.md", "LICENSE", "pyproject.toml")


def call(folder, *command, **changes):
    """Runs a command in a folder, without this project on any path; the finished process."""
    clean = {k: v for k, v in environment(**changes).items() if k != "PYTHONPATH"}
    return subprocess.run([str(word) for word in command], cwd=folder, env=clean,
                          capture_output=True, text=True, timeout=180)  # fmt: skip


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """(folder, {"wheel": path, "sdist": path}), of a copy of what is built from."""
    folder = tmp_path_factory.mktemp("build")
    source = folder / "source"
    source.mkdir()
    for name in PROJECT:
        path = ROOT / name
        if path.is_dir():
            shutil.copytree(path, source / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(path, source)
    for path in ROOT.glob("*.py"):
        shutil.copy(path, source)
    # A build needs a newer setuptools than this environment may have: one of its own.
    tools = folder / "tools"
    venv.create(tools, with_pip=True)
    python = tools / ("Scripts" if os.name == "nt" else "bin") / "python"
    process = call(folder, python, "-m", "pip", "install", "-q", "setuptools>=77")
    if process.returncode != 0:
        pytest.skip(f"no setuptools to build with: {process.stderr.strip().splitlines()[-1]}")
    build = (
        "import setuptools.build_meta as b, sys; "
        "print(getattr(b, 'build_' + sys.argv[1])(sys.argv[2]))"
    )
    paths = {}
    for kind in ("wheel", "sdist"):
        process = call(source, python, "-c", build, kind, folder)
        assert process.returncode == 0, process.stderr
        paths[kind] = folder / process.stdout.splitlines()[-1]
    shutil.rmtree(source)
    return folder, python, paths


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["wheel", "sdist"])
def test_an_installed_program_needs_no_checkout(built, tmp_path, kind):
    folder, tools, paths = built
    place, here = tmp_path / "environment", tmp_path / "elsewhere"
    here.mkdir()
    venv.create(place)
    scripts = place / ("Scripts" if os.name == "nt" else "bin")
    names = {"base": str(place), "platbase": str(place)}
    site = Path(sysconfig.get_path("purelib", sysconfig.get_preferred_scheme("prefix"), names))
    # The libraries of this environment; of this project, only what is installed.
    (site / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    wheel = paths[kind]
    if kind == "sdist":  # which is made a wheel of first, by whichever pip
        process = call(folder, tools, "-m", "pip", "wheel", "-q", "--no-deps", "--no-index",
                       "--no-build-isolation", "-w", tmp_path, paths[kind])  # fmt: skip
        assert process.returncode == 0, process.stderr
        (wheel,) = tmp_path.glob("*.whl")
    process = call(folder, tools, "-m", "pip", "--python", scripts / "python", "install", "-q",
                   "--no-deps", "--no-index", wheel)  # fmt: skip
    assert process.returncode == 0, process.stderr
    shipped = {path.name for path in (site / "rbs" / "data").iterdir()} - {"__pycache__"}
    assert shipped == {path.name for path in (ROOT / "data").iterdir()} - {"__pycache__"}
    # What else may be called `data` beside the package is none of ours.
    (site / "data").mkdir(exist_ok=True)
    program = scripts / "rigid-body-simulation"
    process = call(here, program, "cube", "--steps", 3, "--record", "r.h5", "--stats", "s.csv")
    assert process.returncode == 0 and process.stderr == "", process.stderr
    assert "constraints       " in process.stdout and str(site) in process.stdout
    process = call(here, program, "--verify", "r.h5")
    assert process.stdout == "r.h5: steps 0–3 are identical, bit for bit\n", process.stderr
    process = call(here, program, "tet", "--steps", 3, "--functions", STUDENT)
    assert process.returncode == 0, process.stderr
    process = call(here, program, "wrecking", "--headless")
    assert process.returncode == 2 and "wrecking_ball" in process.stderr
    code = "import RBSFunctions; print(RBSFunctions.__file__)"
    process = call(here, scripts / "python", "-c", code)
    assert Path(process.stdout.strip()).parent == site


def test_a_checkout_has_its_data_at_the_top():
    code = "from rbs.scenes import DATA_FOLDER; print(DATA_FOLDER)"
    process = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert Path(process.stdout.strip()) == ROOT / "data"
