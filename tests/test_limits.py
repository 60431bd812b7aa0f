"""README's numbers of what the basic step does wrong are those that tests/limits.py measures."""

import re

import pytest
from limits import NAMES, WAYS, main, measured, row_of
from oracles import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")
# What takes seconds.
QUICK = ("flat cube", "spin")


def told(name):
    """README's row of that name: what it has for each way."""
    (row,) = re.findall(rf"^\| {name} \| .* \|$", README, re.MULTILINE)
    return row


@pytest.mark.parametrize("name", QUICK)
def test_readme_has_what_is_measured(name):
    assert row_of(name) == told(name)


def test_the_cube_scene_is_pressed_into_the_ground_as_readme_has_it():
    """By the time it has landed; the deepest of all steps is reached then."""
    deepest = measured("ground", "basic", 150).split(",")[0]
    assert told("ground").split(" | ")[1].startswith(deepest) and deepest != "0.00 m"


def test_readme_and_help_have_every_row(capsys, monkeypatch):
    for name in NAMES:
        assert told(name).count(" | ") == len(WAYS)
    for way in WAYS:
        assert way in README
    monkeypatch.setattr("sys.argv", ["limits.py", "spin", "--steps", "3"])
    main()
    assert capsys.readouterr().out.splitlines()[-1].startswith("| spin | 10.0 rad/s |")
