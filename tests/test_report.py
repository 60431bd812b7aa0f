"""The report: its length, where its numbers come from, and that some of them come out again.

Those that take long are measured again by `python report/build.py --check`.
"""

import importlib.util
import json
import re
import sys

import pytest
from oracles import ROOT

REPORT = ROOT / "report"
TEXT = (REPORT / "report.typ").read_text()
NUMBERS = json.loads((REPORT / "numbers.json").read_text())

# What is quoted from what has been timed; there where the peers were installed.
QUICK = ("constants", "rolling")


def without(pattern, text):
    return re.sub(pattern, " ", text, flags=re.DOTALL)


def test_the_pdf_has_three_pages_at_most():
    pdf = (REPORT / "report.pdf").read_bytes()
    counts = [int(count) for count in re.findall(rb"/Type\s*/Pages\b[^>]*?/Count\s+(\d+)", pdf)]
    counts += [int(count) for count in re.findall(rb"/Count\s+(\d+)[^>]*?/Type\s*/Pages\b", pdf)]
    assert counts and 1 <= max(counts) <= 3


def test_no_number_is_typed_into_the_text():
    """Apart from exponents and halves in formulas, figures' own numbers, and layout."""
    text = without(r"//[^\n]*", TEXT)
    text = without(r"#let [^\n]*|#import [^\n]*|#set [^\n]*|#show: [^\n]*", text)
    text = without(r"#n(\.\w+)+", text)
    text = without(r"#align\(center, text\(8\.3pt, table\(.*?\)\)\)", text)
    text = without(r"\"[\w.]+\"", text)
    text = without(r"`[^`]*`", text)
    text = without(r"@\w+", text)
    text = without(r"Figs?\. \d[abc](, \d[abc])*|Figure \d", text)
    text = without(r"\^\d|slash \d|\$5 slash 7 thin v_0\$|v_0|exact 5/7", text)
    assert re.findall(r"[^\n]*\d[^\n]*", text) == []


def test_every_number_that_the_text_quotes_is_there():
    for path in re.findall(r"#n((?:\.\w+)+)", TEXT):
        value = NUMBERS
        for key in path.strip(".").split("."):
            if key in ("flatten", "at"):
                break
            assert key in value, path
            value = value[key]


def test_every_figure_is_there_and_named_by_its_command():
    commands = set(re.findall(r'#cmd\("(\w+)"\)', TEXT))
    figures = re.findall(r'"(\w+)\.(svg|png)"', TEXT)
    assert figures
    for name, ending in figures:
        assert (REPORT / "figures" / f"{name}.{ending}").is_file()
        assert name in commands


@pytest.mark.skipif(
    not importlib.util.find_spec("matplotlib"), reason="Matplotlib is not installed"
)
@pytest.mark.parametrize("name", QUICK)
def test_what_is_quick_to_measure_comes_out_again(name):
    sys.path.insert(0, str(REPORT))
    try:
        import build
    finally:
        sys.path.remove(str(REPORT))
    assert build.run_experiment(name, isDrawn=False)[0] == NUMBERS[name]


@pytest.mark.skipif(
    not importlib.util.find_spec("matplotlib"), reason="Matplotlib is not installed"
)
def test_scenes_made_for_pictures_load():
    """They lie in a folder of their own, away from the meshes."""
    sys.path.insert(0, str(REPORT))
    try:
        import pictures
    finally:
        sys.path.remove(str(REPORT))
    (mesh,) = pictures.made_scene([("box.mesh", 10, False, (0, 9, 0), (1, 0, 0, 0))]).meshes
    assert mesh.name == "box 0" and mesh.position[0, 1] == 9.0
