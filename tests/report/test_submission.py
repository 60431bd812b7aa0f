"""The coursework's one ZIP: what is in it, and that it runs where nothing else is."""

import subprocess
import zipfile

import pytest
from oracles import ROOT
from program import python

GRADERS = ("integrationGrading", "ResolveCollisionsGrading", "Constraints")


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    path = tmp_path_factory.mktemp("handed in") / "submission.zip"
    result = python(path.parent, ROOT / "report/submission.py", path)
    assert result.returncode == 0, result.stderr
    return path


def test_it_has_report_modules_data_and_videos(archive):
    with zipfile.ZipFile(archive) as file:
        names = file.namelist()
    code = "RBSFunctions.py GJK.py Quaternion.py RigidBodySimulation.py data/box.mesh".split()
    code += ["data/collision-resolution.data"]
    assert {"report.pdf", "claims.md", *(f"code/{name}" for name in code)} <= set(names)
    assert sum(name.startswith("videos/") and name.endswith(".mp4") for name in names) == 5
    modules = {f"code/{path.relative_to(ROOT)}" for path in ROOT.glob("rbs/**/*.py")}
    modules |= {"code/rbs/recordings/player.html", "code/rbs/recordings/player.js"}
    assert {name for name in names if name.startswith("code/rbs/")} == modules
    assert not [name for name in names if "__pycache__" in name or name.startswith("/")]
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if tracked.returncode == 0:  # untracked files are left out
        known = set(tracked.stdout.splitlines())
        assert {name.removeprefix("code/") for name in names if name.startswith("code/")} <= known


def test_the_same_files_give_the_same_bytes(archive, tmp_path):
    assert python(tmp_path, ROOT / "report/submission.py", "again.zip").returncode == 0
    assert (tmp_path / "again.zip").read_bytes() == archive.read_bytes()


@pytest.mark.slow
def test_it_runs_in_a_fresh_folder(archive, tmp_path):
    with zipfile.ZipFile(archive) as file:
        file.extractall(tmp_path)
    for words in (
        *(f"graders/{name}.py" for name in GRADERS),
        "RigidBodySimulation.py singlebox --headless --steps 5",
    ):
        result = python(tmp_path / "code", *words.split(), PYTHONPATH="")
        assert result.returncode == 0, result.stdout + result.stderr


def test_videos_are_small():
    sizes = [path.stat().st_size for path in (ROOT / "report/videos").glob("*.mp4")]
    assert len(sizes) == 5 and max(sizes) <= 900_000 and sum(sizes) <= 2_000_000


def test_a_missing_report_is_told_in_a_line(tmp_path):
    code = "import sys; sys.path.insert(0, sys.argv[1]); import submission as s; "
    code += "s.VIDEOS = ('nothing',); sys.argv = ['submission.py', 'a.zip']; s.main()"
    result = python(tmp_path, "-c", code, ROOT / "report")
    assert result.returncode == 2 and "nothing.mp4: missing" in result.stderr
    assert "Traceback" not in result.stderr and not (tmp_path / "a.zip").exists()
