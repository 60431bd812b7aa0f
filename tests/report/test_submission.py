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
    for name in (path, path.with_name("again.zip")):
        result = python(path.parent, ROOT / "report/submission.py", name)
        assert result.returncode == 0, result.stderr
    assert path.read_bytes() == path.with_name("again.zip").read_bytes()
    return path


def test_it_has_report_modules_data_and_the_videos_of_the_text(archive):
    with zipfile.ZipFile(archive) as file:
        sizes = {entry.filename: entry.file_size for entry in file.infolist()}
    code = {name.removeprefix("code/") for name in sizes if name.startswith("code/")}
    some = "RBSFunctions.py GJK.py Quaternion.py RigidBodySimulation.py data/box.mesh "
    some += "data/collision-resolution.data rbs/recordings/player.html LICENSE"
    assert {"report.pdf", "claims.md"} <= set(sizes) and set(some.split()) <= code
    assert {str(path.relative_to(ROOT)) for path in ROOT.glob("rbs/**/*.py")} <= code
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if tracked.returncode == 0:  # untracked files are left out
        assert code <= set(tracked.stdout.splitlines())
    films = [size for name, size in sizes.items() if name.startswith("videos/")]
    assert len(films) == 8 and max(films) <= 2_000_000 and sum(films) <= 6_000_000


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
