"""The report: its length, that its claims hold, and that some of its numbers come out again."""

import copy
import functools
import importlib
import json
import re
import subprocess
import sys

import pytest
from oracles import ROOT

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
