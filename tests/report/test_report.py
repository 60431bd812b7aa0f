"""The report: its length, where its numbers come from, that its claims hold, and that some of the
numbers come out again. `python report/build.py --check` measures all of them again.
"""

import copy
import importlib.util
import json
import re
import sys

import pytest
from oracles import ROOT

REPORT = ROOT / "report"
TEXT = (REPORT / "report.typ").read_text()
NUMBERS = json.loads((REPORT / "numbers.json").read_text())
QUICK = ("settings", "fall", "rolling", "schedules")  # experiments of a second or two

pytestmark = pytest.mark.skipif(
    not importlib.util.find_spec("matplotlib"), reason="Matplotlib is not installed"
)


@pytest.fixture(scope="module")
def report():
    """A function that imports a module of report/."""
    sys.path.insert(0, str(REPORT))
    yield importlib.import_module
    sys.path.remove(str(REPORT))


def test_the_pdf_has_three_pages_at_most():
    pdf = (REPORT / "report.pdf").read_bytes()
    counts = [int(count) for count in re.findall(rb"/Type\s*/Pages\b[^>]*?/Count\s+(\d+)", pdf)]
    counts += [int(count) for count in re.findall(rb"/Count\s+(\d+)[^>]*?/Type\s*/Pages\b", pdf)]
    assert counts and 1 <= max(counts) <= 3


def test_the_text_has_at_most_1600_words(report):
    assert 1000 < report("build").words(TEXT) <= 1600


def test_no_number_is_typed_into_the_text():
    """Apart from formulas, references and layout."""
    text = TEXT
    for pattern in (
        r"//[^\n]*",
        r"#(let|import|set|show)[^\n]*",
        r"#formula\(\$.*?\$\)",
        r"\$[^$]*\$",
        r"\b(f|to|see)\([^()]*\)",
        r"\bn(\.\w+)+",
        r"\d(\.\d+)?cm|\d(\.\d+)?em|\d(\.\d+)?pt|columns: \d",
        r"@\w+",
        r"(Fig\.|Table)~\d[abcd]?(, \d[abcd])?|Section \d|body \d",
    ):
        text = re.sub(pattern, " ", text, flags=re.DOTALL if "formula" in pattern else 0)
    assert re.findall(r"[^\n]*\d[^\n]*", text) == []


def test_every_number_that_the_text_quotes_is_there():
    paths = re.findall(r"\bn\.([\w.]*\w)", TEXT)
    assert len(paths) > 60
    for path in paths:
        value = NUMBERS
        for key in path.split("."):
            assert key in value, path
            value = value[key]


def test_every_figure_is_there_cited_and_described():
    figures = re.findall(r'\("(\w+\.(?:svg|jpg))", "[^"]{30,}"\)', TEXT)
    assert sorted(figures) == sorted(path.name for path in (REPORT / "figures").iterdir())
    for panel in "2a 2b 3a 3b 3c 3d 4b 5a 5b 6 7a 7b 7c 7d".split():
        assert re.search(rf"Fig\.~{panel}\b", TEXT), panel


def test_claims_hold_and_the_list_is_theirs(report):
    claims = report("claims")
    assert claims.broken(NUMBERS) == []
    assert (REPORT / "claims.md").read_text() == claims.table(NUMBERS)


def test_every_claim_fails_on_numbers_that_contradict_it(report):
    claims = report("claims")
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


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stack", "cube"])
def test_stills_show_the_effect_by_default_and_not_once_cured(report, name):
    pair = report("shots").PAIRS[name]
    for isCured, simulation in pair.halves():
        for _ in range(pair.still):
            simulation.step()
        assert pair.effect(simulation)[2] != bool(isCured)
