"""The report: its length, claims and numbers; the notebook; and the coursework's one ZIP."""

import copy
import functools
import importlib
import json
import re
import subprocess
import sys
import zipfile

import pytest
from oracles import ROOT
from program import python, require_opengl

from rbs.recordings.recording import Recording
from rbs.recordings.replay import verify

REPORT = ROOT / "report"
TEXT = (REPORT / "report.typ").read_text()
NUMBERS = json.loads((REPORT / "numbers.json").read_text())
BUILT = {".data", ".jpg", ".mp4", ".pdf"}  # what is not text, and a script here makes
QUICK = ("settings", "chain", "bounce", pytest.param("blow", marks=pytest.mark.slow))


@pytest.fixture(scope="module")
def report():
    """A function that imports a module of report/."""
    pytest.importorskip("matplotlib")
    pytest.importorskip("imageio_ffmpeg")
    sys.path.insert(0, str(REPORT))
    yield importlib.import_module
    sys.path.remove(str(REPORT))


def test_three_pages_and_1500_words_at_most(report):
    pdf = (REPORT / "report.pdf").read_bytes()
    counts = re.findall(rb"/Type\s*/Pages\b[^>]*?/Count\s+(\d+)", pdf)
    counts += re.findall(rb"/Count\s+(\d+)[^>]*?/Type\s*/Pages\b", pdf)
    assert 1 <= max(map(int, counts)) <= 3
    assert 1000 < report("build").words(TEXT) <= 1500


def test_claims_hold_and_each_fails_on_numbers_that_contradict_it(report):
    claims = report("claims")
    assert claims.broken(NUMBERS) == []
    for claim in claims.CLAIMS:
        wrong = copy.deepcopy(NUMBERS)
        *path, last = claim.measured.split(".")
        group = functools.reduce(dict.get, path, wrong)
        group[last] = {"=": 7.7e5, "<": 7.7e5, ">": -1.0}[claim.relation]
        assert not claims.holds(claim, wrong), claim
        del group[last]
        assert not claims.holds(claim, wrong), claim


@pytest.mark.parametrize("name", ["README.md", "tests/README.md"])
def test_readmes_have_the_times_beside_engines_that_the_report_has(report, name):
    quoted, text = report("claims").quoted, (ROOT / name).read_text()
    assert quoted(NUMBERS, text) == text
    other = json.loads(json.dumps(NUMBERS).replace('"softToCg": ', '"softToCg": 7'))
    assert quoted(other, text) != text


def test_nothing_large_and_nothing_that_no_script_builds_is_tracked():
    run = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if run.returncode:
        pytest.skip("not a clone")
    paths = [ROOT / name for name in run.stdout.split("\0") if (ROOT / name).is_file()]
    assert len(paths) > 100
    assert not [path for path in paths if path.stat().st_size > 1_000_000]
    binary = {path.suffix for path in paths if b"\0" in path.read_bytes()[:8000]}
    assert binary <= BUILT


@pytest.mark.parametrize("name", QUICK)
def test_what_is_quick_to_measure_comes_out_again(report, name):
    assert report("build").run_part(name, isDrawn=False)[0] == NUMBERS[name]


@pytest.mark.slow
def test_the_notebook_runs_and_shows_what_it_promises(tmp_path, monkeypatch):
    require_opengl()
    nbclient, nbformat = map(pytest.importorskip, ("nbclient", "nbformat"))
    for library in ("k3d", "matplotlib", "ipykernel"):
        pytest.importorskip(library)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    notebook = nbformat.read(ROOT / "report" / "notebook.ipynb", as_version=4)
    assert len(notebook.cells) == 9
    assert not any(cell.get("outputs") for cell in notebook.cells)  # none are stored
    where = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=600, resources=where).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    shown = [output.get("data", {}) for output in outputs]
    html = "".join(data.get("text/html", "") for data in shown)
    assert html.count("<iframe") == 1 and html.count("<img") == 2
    assert sum("image/png" in data for data in shown) == 3  # two plots and a picture
    (text,) = [output.text for output in outputs if output.output_type == "stream"]
    assert float(text.split()[2]) < 0.05  # m, between a sliding box and the formula
    assert (tmp_path / "ramp.html").stat().st_size > 1e6
    assert verify(Recording(tmp_path / "ramp.h5")) == ""


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
        *(f"graders/{one}.py" for one in ("ResolveCollisionsGrading", "Constraints")),
        "graders/integrationGrading.py",
        "RigidBodySimulation.py singlebox --headless --steps 5",
    ):
        result = python(tmp_path / "code", *words.split(), PYTHONPATH="")
        assert result.returncode == 0, result.stdout + result.stderr
