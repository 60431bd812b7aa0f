"""The program as it is installed from a source distribution, without a checkout."""

import importlib.util
import shutil
import tarfile
import zipfile

import pytest
from oracles import ROOT
from program import DATA, python
from studentVariants import STUDENT

# A user's program, in which mypy finds an error in each line whose comment says so.
TYPED = """
from RigidBodySimulation import Settings, Simulation, shapes

simulation = Simulation.from_meshes([shapes.box((1, 1, 1), 2.0)], settings=Settings(friction=0.5))
with simulation.record("run.h5") as same:
    same.run(3).report.contcts  # error
for mesh in simulation.meshes:
    mesh.linVelocity = (1, 0, 0)
    mesh.linVelocity.shap  # error
simulation.settings.frction = 0.5  # error
Settings(frction=0.5)  # error
simulation.friction = 0.5  # error
with Simulation.open("run.h5") as opened:
    opened.stepCount.shape  # error
"""
BUILD = "import setuptools.build_meta as b, sys; print(b.build_{}(sys.argv[1]))"


def call(folder, *command, path=""):
    """Runs Python in a folder, with only `path` before the installed packages; its output."""
    process = python(folder, *command, PYTHONPATH=str(path))
    assert process.returncode == 0, process.stderr
    return process.stdout


@pytest.mark.slow
def test_an_installed_program_needs_no_checkout(tmp_path):
    source, tools, site, here = (tmp_path / name for name in ("source", "tools", "site", "here"))
    here.mkdir()
    left = shutil.ignore_patterns(".*", "tests", "report", "build", "*.egg-info", "__pycache__")
    shutil.copytree(ROOT, source, ignore=left)
    try:  # a newer one than this environment may have
        call(here, "-m", "pip", "install", "-q", "--target", tools, "setuptools>=77")
    except AssertionError as error:
        pytest.skip(f"no setuptools to build with: {str(error).splitlines()[-1]}")
    sdist = call(source, "-c", BUILD.format("sdist"), tmp_path, path=tools).splitlines()[-1]
    shutil.rmtree(source)
    with tarfile.open(tmp_path / sdist) as archive:
        archive.extractall(source)
    (folder,) = source.iterdir()
    wheel = call(folder, "-c", BUILD.format("wheel"), tmp_path, path=tools).splitlines()[-1]
    with zipfile.ZipFile(tmp_path / wheel) as archive:
        archive.extractall(site)
    shipped = {path.name for path in (site / "rbs" / "data").iterdir()}
    used = {path.name for ending in ("mesh", "off", "txt") for path in DATA.glob(f"*.{ending}")}
    assert shipped == used and len(used) > 50
    assert not list(site.glob("**/make_*.py")) and not list(site.glob("**/*.data"))
    assert (site / "rbs" / "py.typed").is_file()
    (entries,) = site.glob("*.dist-info/entry_points.txt")
    assert "rigid-body-simulation = RigidBodySimulation:program" in entries.read_text()
    program = "-c", "import RigidBodySimulation as r; r.program()"
    options = "--steps", 3, "--record", "r.h5", "--stats", "s.csv", "--export", "r.html"
    output = call(here, *program, "cube", *options, path=site)
    assert "constraints       " in output and str(site) in output
    assert "steps 0–3 are identical" in call(here, *program, "--verify", "r.h5", path=site)
    call(here, *program, "tet", "--steps", 3, "--functions", STUDENT, path=site)
    if importlib.util.find_spec("mypy") is None:
        return
    (here / "program.py").write_text(TYPED)
    process = python(here, "-m", "mypy", "program.py", PYTHONPATH=str(site))
    told = {int(line.split(":")[1]) for line in process.stdout.splitlines() if ": error: " in line}
    lines = TYPED.splitlines()
    assert told == {k for k, line in enumerate(lines, 1) if "# error" in line}, process.stdout
