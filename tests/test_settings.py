"""The table of settings: what it declares is what every place that uses settings offers."""

import inspect
import math
from dataclasses import asdict

import numpy as np
import pytest
from oracles import ground
from program import DATA, run

from rbs.options import make_parser
from rbs.settings import CHOSEN, TABLE, Settings, check_arguments
from rbs.simulation import Simulation
from RBSFunctions import run_timestep

NAMES = list(CHOSEN)


def test_run_timestep_has_every_setting_with_its_default():
    parameters = inspect.signature(run_timestep).parameters
    others = {"meshes", "groundMesh", "constraints", "solverState"}
    assert set(parameters) - others == {one.parameter for one in TABLE}
    for one in TABLE:
        default = parameters[one.parameter].default
        expected = one.default if one.defaultInStep is None else one.defaultInStep
        assert default is inspect.Parameter.empty or default == expected, one.name


def test_every_setting_is_an_option_and_explains_itself():
    options = make_parser().format_help()
    for one in CHOSEN.values():
        assert f"--{one.option}" in options and one.help
        assert bool(one.label) == bool(one.tooltip) == (one.name != "maxIterations")
        assert one.checked(one.default) == one.default
        assert one.isOfConstraints or one.name not in ("constraintScheduling", "maxIterations")


WRONG = {
    "restitution": [-0.01, 1.01, math.nan, math.inf, "much", None, [0.5, 0.5]],
    "timeStep": [0.0, -0.02, 1e-13, 1001.0, math.nan, None],
    "friction": [-0.1, math.nan, math.inf, None],
    "contactSolver": ["simplex", None, 3],
    "substeps": [0, 1001, 2.5, math.inf, math.nan, None],
    "sleeping": ["no", None, 2],
    "broadPhase": ["tree"],
    "closingOnly": ["yes"],
    "gyroscopic": [None],
    "enforceConstraints": ["no", None],
    "constraintScheduling": ["quick", ["sweep"]],
    "maxIterations": [-1, 0.5, math.inf],
}


@pytest.mark.parametrize("name", NAMES)
def test_a_wrong_value_is_refused_by_name_and_changes_nothing(name):
    solver = CHOSEN[name].solver or "impulse"
    settings = Settings(contactSolver=solver)
    before = asdict(settings)
    for value in WRONG[name]:
        with pytest.raises(ValueError, match=f"^{name} must be "):
            Settings(**{"contactSolver": solver, name: value})
        with pytest.raises(ValueError, match=f"^{name} must be "):
            settings.change(name, value)
    assert asdict(settings) == before


@pytest.mark.parametrize("parameter", [one.parameter for one in TABLE])
def test_the_step_refuses_what_has_no_meaning_by_name(parameter):
    wrong = {
        "CRCoeff": [math.nan, math.inf, None], "timeStep": [-0.02, math.nan, math.inf],
        "mu": [-0.1, math.nan, math.inf], "tolerance": [-1.0, math.nan],
        "substeps": [0, math.inf, None, 1.5], "maxIterations": ["a", math.inf],
    }.get(parameter, ["no such", None, 7])  # fmt: skip
    for value in wrong:
        with pytest.raises(ValueError, match=f"^{parameter} must be "):
            check_arguments(**{parameter: value})
        arguments = {"timeStep": 0.02, "CRCoeff": 0.5, parameter: value}
        with pytest.raises(ValueError, match=f"^{parameter} must be "):
            run_timestep([], ground(), **arguments)


def test_numbers_come_in_any_shape_that_holds_one():
    checked = check_arguments(CRCoeff=np.array([0.25]), mu=np.float32(0.5), substeps=np.int64(3))
    assert checked == {"CRCoeff": 0.25, "mu": 0.5, "substeps": 3}
    assert {type(value) for value in checked.values()} == {float, int}


OTHER_VALUES = {"substeps": 3, "sleeping": False, "broadPhase": "grid", "closingOnly": True,
                "constraintScheduling": "queue", "maxIterations": 7}  # fmt: skip


@pytest.mark.parametrize("name", OTHER_VALUES)
def test_what_the_solver_ignores_is_refused_by_name(tmp_path, name):
    one, value = CHOSEN[name], OTHER_VALUES[name]
    other = "impulse" if one.solver == "soft-step" else "soft-step"
    with pytest.raises(ValueError, match=f"^{name} has no effect with contactSolver {other}"):
        Settings(**{"contactSolver": other, name: value})
    with pytest.raises(ValueError, match=f"^{name} has no effect with contactSolver '{other}'"):
        run_timestep([], ground(), 0.02, 0.5, contactSolver=other, **{one.parameter: value})
    words = [f"--{one.option}"] + [value] * (one.kind is not bool)
    process = run(tmp_path, "tower", "--solver", other, *words, "--headless")
    message = f"--{one.option} has no effect with --solver {other}"
    assert process.returncode == 2
    assert process.stderr == f"RigidBodySimulation.py: {message}\n"
    # It is no hindrance to changing the solver by hand.
    settings = Settings(**{"contactSolver": one.solver, name: value})
    settings.change("contactSolver", other)
    assert settings == Settings(contactSolver=other)


def test_scenes_of_the_basic_kind_recommend_nothing():
    basic = ("singletet", "singlebox", "single_cylinder", "two_cylinder", "tet", "mixed", "tower",
             "stress", "cube", "tower_chain", "two_chain", "bridge", "net")  # fmt: skip
    for name in basic:
        assert "# suggests" not in Simulation(DATA / f"{name}-scene.txt").source.scene
