"""The table of settings: what it declares is what every place that uses settings offers."""

import math
from dataclasses import asdict

import pytest
from oracles import ground
from program import call

from rbs.program.options import make_parser
from rbs.stepping.settings import SETTINGS, TABLE, Settings
from RBSFunctions import run_timestep


def test_every_setting_is_an_option_and_explains_itself():
    options = make_parser().format_help()
    for one in SETTINGS.values():
        assert f"--{one.option}" in options and one.help
        assert one.tooltip and bool(one.label) == (one.name != "maxIterations")
        assert one.checked(one.default) == one.default
        assert one.isOfConstraints or one.name not in ("constraintScheduling", "maxIterations")


def test_help_describes_every_field():
    """help(Settings) has kind, limits, default and meaning, of the field and not of the option."""
    text = Settings.__doc__
    for name, one in SETTINGS.items():
        assert f"\n{name} : " in text and f"default {one.default!r}\n" in text
    assert "restitution : float, 0 to 1, default 0.5\n    How bouncy" in text
    assert "broadPhase : str, one of 'all', 'grid', default 'all'" in text
    assert "sleeping : bool, default True\n    Skip bodies at rest" in text and "--" not in text


WRONG = {
    "restitution": [-0.01, 1.01, math.nan, math.inf, "much", None, [0.5, 0.5]],
    "timeStep": [0.0, -0.02, 1e-13, 1001.0, math.nan, None],
    "gravity": [-1.1e6, 1.1e6, math.nan, "moon", None],
    "friction": [-0.1, math.nan, math.inf, None],
    "contactSolver": ["simplex", None, 3],
    "substeps": [0, 1001, 2.5, math.inf, math.nan, None],
    "sleeping": ["no", None, 2],
    "broadPhase": ["tree"],
    "contactScheduling": ["queue", None],
    "closingOnly": ["yes"],
    "gyroscopic": [None],
    "enforceConstraints": ["no", None],
    "constraintScheduling": ["quick", ["sweep"]],
    "maxIterations": [-1, 0.5, math.inf],
    "tolerance": [-1.0, math.nan],
}
# Allowed in a step, where they have a meaning or are the same formula.
ALLOWED_IN_STEP = {"restitution": (-0.01, 1.01), "timeStep": (0.0, 1e-13, 1001.0)}


@pytest.mark.parametrize("one", TABLE, ids=lambda one: one.name)
def test_a_wrong_value_is_refused_by_name_and_changes_nothing(one):
    solver = one.solver or "impulse"
    settings = Settings(contactSolver=solver)
    before = asdict(settings)
    for value in WRONG[one.name]:
        if one.option is not None:
            with pytest.raises(ValueError, match=f"^{one.name} must be "):
                Settings(**{"contactSolver": solver, one.name: value})
            with pytest.raises(ValueError, match=f"^{one.name} must be "):
                settings.change(one.name, value)
            with pytest.raises(ValueError, match=f"^{one.name} must be "):
                setattr(settings, one.name, value)
        if value not in ALLOWED_IN_STEP.get(one.name, ()):
            with pytest.raises(ValueError, match=f"^{one.parameter} must be "):
                run_timestep(
                    [], ground(), **{"timeStep": 0.02, "CRCoeff": 0.5, one.parameter: value}
                )
    assert asdict(settings) == before


def test_a_misspelt_setting_is_refused():
    settings = Settings()
    with pytest.raises(AttributeError, match="no setting frcition; there are restitution, "):
        settings.frcition = 3
    settings.friction = 3
    assert asdict(settings) == asdict(Settings(friction=3.0))


OTHER_VALUES = {"substeps": 3, "sleeping": False, "broadPhase": "grid", "closingOnly": True}
OTHER_VALUES |= {"constraintScheduling": "queue", "maxIterations": 7}
OTHER_VALUES |= {"contactScheduling": "batches"}


@pytest.mark.parametrize("name", OTHER_VALUES)
def test_what_the_solver_ignores_is_refused_by_name(capsys, name):
    one, value = SETTINGS[name], OTHER_VALUES[name]
    other = "impulse" if one.solver == "soft-step" else "soft-step"
    with pytest.raises(ValueError, match=f"^{name} has no effect with contactSolver {other}"):
        Settings(**{"contactSolver": other, name: value})
    with pytest.raises(ValueError, match=f"^{name} has no effect with contactSolver '{other}'"):
        run_timestep([], ground(), 0.02, 0.5, contactSolver=other, **{one.parameter: value})
    words = [f"--{one.option}"] + [value] * (one.kind is not bool)
    code, _, errors = call(capsys, "tower", "--solver", other, *words, "--headless")
    message = f"--{one.option} has no effect with --solver {other}"
    assert (code, errors) == (2, f"RigidBodySimulation.py: {message}\n")
    # It is no hindrance to changing the solver by hand.
    settings = Settings(**{"contactSolver": one.solver, name: value})
    settings.change("contactSolver", other)
    assert settings == Settings(contactSolver=other)
