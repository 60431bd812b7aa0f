"""The report: its length, where its numbers come from, that its claims hold, and that some of the
numbers come out again.

Those that take long are measured again by `python report/build.py --check`.
"""

import importlib.util
import json
import re
import sys

import numpy as np
import pytest
from oracles import ROOT

import rbs.stepping.batches
import rbs.stepping.constraints

REPORT = ROOT / "report"
TEXT = (REPORT / "report.typ").read_text()
NUMBERS = json.loads((REPORT / "numbers.json").read_text())

# Experiments, and pictures whose captions are looked at, that take a second or two.
QUICK = ("constants", "rolling")
QUICK_PICTURES = ("picture_tunnel", "picture_cube")

drawn = pytest.mark.skipif(
    not importlib.util.find_spec("matplotlib"), reason="Matplotlib is not installed"
)


@pytest.fixture(scope="module")
def report():
    """A function that imports a module of report/."""
    sys.path.insert(0, str(REPORT))
    yield importlib.import_module
    sys.path.remove(str(REPORT))


def without(pattern, text):
    return re.sub(pattern, " ", text, flags=re.DOTALL)


def quoted():
    """The paths of numbers that the text names, each as a list of keys."""
    return [path.strip(".").split(".") for path in re.findall(r"\bn((?:\.\w+)+)", TEXT)]


def test_the_pdf_has_three_pages_at_most():
    pdf = (REPORT / "report.pdf").read_bytes()
    counts = [int(count) for count in re.findall(rb"/Type\s*/Pages\b[^>]*?/Count\s+(\d+)", pdf)]
    counts += [int(count) for count in re.findall(rb"/Count\s+(\d+)[^>]*?/Type\s*/Pages\b", pdf)]
    assert counts and 1 <= max(counts) <= 3


def test_no_number_is_typed_into_the_text():
    """Apart from exponents and halves in formulas, figures' own numbers, and layout."""
    text = without(r"//[^\n]*", TEXT)
    text = without(r"#let [^\n]*|#import [^\n]*|#set [^\n]*|#show: [^\n]*|#table1\[", text)
    text = without(r"#formula\(\$.*?\$\)", text)
    text = without(r"#n(\.\w+)+", text)
    text = without(r"#table\(.*?\n {0,2}\)\]?\n", text)
    text = without(r"\"[\w.]+\"", text)
    text = without(r"@\w+", text)
    text = without(r"Fig\.~\d[abc]|Table \d", text)
    text = without(r"\$[^$\n]*\$", text)
    assert re.findall(r"[^\n]*\d[^\n]*", text) == []


def test_every_number_that_the_text_quotes_is_there():
    assert quoted()
    for path in quoted():
        value = NUMBERS
        for key in path:
            if key in ("pairs", "at"):
                break
            assert key in value, path
            value = value[key]


@drawn
def test_every_figure_is_there_and_listed_with_what_makes_it(report):
    figures = re.findall(r'"(\w+)\.(svg|png)"', TEXT)
    assert figures
    listed = {name for _, names in report("claims").FIGURES for name in names}
    for name, ending in figures:
        assert (REPORT / "figures" / f"{name}.{ending}").is_file()
        assert name in listed
    shown = {f"{name}.{ending}" for name, ending in figures}
    assert {path.name for path in (REPORT / "figures").iterdir()} == shown


@drawn
def test_every_measurement_that_the_text_quotes_has_a_claim_or_a_figure(report):
    claims = report("claims")
    groups = {
        path.split(".")[0]
        for claim in claims.CLAIMS
        for path in claims.PATH.findall(claim.sentence)
    }
    groups |= {name for _, names in claims.FIGURES for name in names}
    assert {path[0] for path in quoted()} <= groups | {"constants", "videos", "code", "figures"}


@drawn
def test_no_number_contradicts_a_sentence(report):
    assert report("claims").contradictions(NUMBERS) == []


@drawn
def test_a_number_that_contradicts_a_sentence_is_told(report):
    claims = report("claims")
    broken = json.loads(json.dumps(NUMBERS))
    broken["stack"]["up10"] = "2.9"
    broken["standing"]["pyramidBasic"] = "1.0"
    told = claims.contradictions(broken)
    assert len(told) == 2
    assert any("ten boxes overlap by 2.9 m" in line for line in told)


@drawn
def test_the_list_of_claims_is_that_of_the_numbers(report):
    assert (REPORT / "claims.md").read_text() == report("claims").table(NUMBERS)


@drawn
@pytest.mark.parametrize("name", QUICK)
def test_what_is_quick_to_measure_comes_out_again(report, name):
    assert report("build").run_experiment(name, isDrawn=False)[0] == NUMBERS[name]


@drawn
@pytest.mark.parametrize("name", QUICK_PICTURES)
def test_captions_are_true_of_what_is_drawn(report, name):
    pictures = report("pictures")
    assert all(pictures.checked(name).facts.values())


@drawn
def test_a_caption_that_is_not_true_is_not_drawn(report, monkeypatch):
    pictures = report("pictures")
    monkeypatch.setattr(pictures, "STACK_STEPS", 1)  # nothing overlaps yet
    with pytest.raises(SystemExit, match="the caption is not true of the state drawn"):
        pictures.checked("picture_stack")


@drawn
@pytest.mark.parametrize(("name", "where"), [("queue", "two_chain"), ("Pass", "stack")])
def test_what_is_watched_goes_the_same_way(report, name, where):
    mechanisms, scene = report("mechanisms"), report("experiments").scene
    watch = mechanisms.Visits() if name == "queue" else mechanisms.Passes()
    module, wrapper = (
        (rbs.stepping.constraints, watch.schedule)
        if name == "queue"
        else (rbs.stepping.batches, watch.wrapper)
    )

    def positions():
        simulation = scene(where, constraintScheduling="queue", broadPhase="grid")
        for _ in range(100):
            simulation.step()
        return np.concatenate([mesh.position for mesh in simulation.meshes])

    alone = positions()
    with mechanisms.watched(module, name, wrapper):
        assert (positions() == alone).all()
    assert sum(map(len, watch.steps)) > 20
