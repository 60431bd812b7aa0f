"""The program as it is installed from a source distribution, without a checkout."""

import os
import shutil
import subprocess
import sysconfig
import venv
from pathlib import Path

import pytest
from oracles import ROOT
from program import environment
from studentVariants import STUDENT

BUILD = "import setuptools.build_meta as b, sys; print(b.build_sdist(sys.argv[1]))"


def call(folder, *command):
    """Runs a command in a folder, without this project on any path; its output."""
    clean = {name: value for name, value in environment().items() if name != "PYTHONPATH"}
    process = subprocess.run(
        [str(word) for word in command], cwd=folder, env=clean, capture_output=True, text=True
    )
    assert process.returncode == 0, process.stderr
    return process.stdout


@pytest.mark.slow
def test_an_installed_program_needs_no_checkout(tmp_path):
    """A wheel is made of what is in the source distribution, and installed."""
    source, place, here = (tmp_path / name for name in ("source", "environment", "elsewhere"))
    here.mkdir()
    left = shutil.ignore_patterns(".*", "tests", "report", "build", "*.egg-info", "__pycache__")
    shutil.copytree(ROOT, source, ignore=left)
    venv.create(place, with_pip=True)
    scripts = place / ("Scripts" if os.name == "nt" else "bin")
    pip = (scripts / "python", "-m", "pip", "install", "-q")
    try:
        call(here, *pip, "setuptools>=77")  # a newer one than this environment may have
    except AssertionError as error:
        pytest.skip(f"no setuptools to build with: {str(error).splitlines()[-1]}")
    sdist = tmp_path / call(source, scripts / "python", "-c", BUILD, tmp_path).splitlines()[-1]
    shutil.rmtree(source)
    call(here, *pip, "--no-deps", "--no-index", "--no-build-isolation", sdist)
    names = {"base": str(place), "platbase": str(place)}
    site = Path(sysconfig.get_path("purelib", sysconfig.get_preferred_scheme("prefix"), names))
    # The libraries of this environment; of this project, only what is installed.
    (site / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n")
    shipped = {path.name for path in (site / "rbs" / "data").iterdir()} - {"__pycache__"}
    present = {path.name for path in (ROOT / "data").iterdir()}
    assert shipped == present - {"__pycache__", "README.md"}
    program = scripts / "rigid-body-simulation"
    output = call(here, program, "cube", "--steps", 3, "--record", "r.h5", "--stats", "s.csv")
    assert "constraints       " in output and str(site) in output
    assert "steps 0–3 are identical" in call(here, program, "--verify", "r.h5")
    call(here, program, "tet", "--steps", 3, "--functions", STUDENT)
