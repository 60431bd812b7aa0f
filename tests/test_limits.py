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


def test_help_has_the_numbers_of_readme(capsys):
    from RigidBodySimulation import main as program

    with pytest.raises(SystemExit):
        program(["--help"])
    said = " ".join(capsys.readouterr().out.split())
    gains = [float(re.findall(r"[\d.]+", told(name))[0]) for name in NAMES[:4]]
    assert f"{min(gains):.0f} to {max(gains):.0f} % in 1500 steps" in said
    assert "soft-step: none" in said
    assert all(told(name).split(" | ")[3].startswith("0.0 %") for name in NAMES[:4])
    assert "10 of 10 rad/s; soft-step: 0" in said and told("spin").endswith("| 0.0 rad/s |")
    pressed = [cell.split(",")[0] for cell in told("ground").split(" | ")[1:]]
    assert f"by {pressed[0]}; soft-step: {pressed[2]}" in said
