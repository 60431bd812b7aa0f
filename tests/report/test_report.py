"""The report: its length, where its numbers come from, that its claims hold, and that some of the
numbers come out again. `python report/build.py --check` measures all of them again.
"""

import copy
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
QUICK = ("settings", "chain", "rope", "bounce", "feedback")  # experiments of a second


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


def test_every_number_that_the_text_quotes_was_measured():
    paths = re.findall(r"\bn\.((?:\w+\.)*\w+)\b(?!\.?\()", TEXT)
    assert len(paths) > 60
    for path in paths:
        value = NUMBERS
        for key in path.split("."):
            assert key in value, path
            value = value[key]


def test_every_figure_is_drawn_described_and_cited_in_order():
    figures = re.findall(r'\("(\w+\.(?:svg|jpg))", "[^"]{30,}"\)', TEXT)
    assert sorted(figures) == sorted(path.name for path in (REPORT / "figures").iterdir())
    first = [TEXT.index(name) for name in figures]
    assert first == sorted(first)
    cited = [int(number) for number in re.findall(r"Fig\.~(\d+)", TEXT)]
    assert max(cited) == len(re.findall(r"^#(?:across|column)\(", TEXT, re.MULTILINE))


def test_claims_hold_and_each_fails_on_numbers_that_contradict_it(report):
    claims = report("claims")
    assert claims.broken(NUMBERS) == []
    assert (REPORT / "claims.md").read_text() == claims.table(NUMBERS)
    for claim in claims.CLAIMS:
        wrong = copy.deepcopy(NUMBERS)
        *path, last = claim.measured.split(".")
        group = wrong
        for key in path:
            group = group[key]
        group[last] = {"=": 7.7e5, "<": 7.7e5, ">": -1.0}[claim.relation]
        assert not claims.holds(claim, wrong), claim
        del group[last]
        assert not claims.holds(claim, wrong), claim


@pytest.mark.parametrize("name", QUICK)
def test_what_is_quick_to_measure_comes_out_again(report, name):
    assert report("build").run_part(name, isDrawn=False)[0] == NUMBERS[name]


@pytest.mark.parametrize("words", [["--help"], ["nothing"]])
def test_the_gallery_answers_without_a_traceback(words):
    pytest.importorskip("imageio_ffmpeg")
    command = [sys.executable, REPORT / "gallery.py", *words]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == (2 if words == ["nothing"] else 0)
    assert "wall.mp4" in result.stdout + result.stderr and "Traceback" not in result.stderr
