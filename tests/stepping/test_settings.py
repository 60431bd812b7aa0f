"""The table of settings: what it declares is what every place that uses settings offers."""

import math
import re
from dataclasses import asdict
from functools import partial

import numpy as np
import pytest
from oracles import box_body, ground
from program import call

from rbs.geometry.triples import shown_value
from rbs.scenes.settingtexts import TEXTS
from rbs.stepping.settings import SETTINGS, Settings, step_arguments
from RBSFunctions import run_timestep

WRONG = {
    "restitution": [-0.01, 1.01, math.nan, math.inf, "much", None, [0.5, 0.5], np.True_],
    "timeStep": [0.0, -0.02, 1e-13, 1001.0, math.nan, None],
    "gravity": [-9.8, 1.1e6, math.nan, None, "123"],
    "friction": [-0.1, math.nan, math.inf, None, "0.5", True, [True], ["0.5"], b"1", 10**400],
    "contactSolver": ["simplex", None, 3],
    "substeps": [0, 1001, 2.5, math.inf, math.nan, None, True, (np.True_,)],
    "broadPhase": ["tree"],
    "contactScheduling": ["queue", None],
    "constraintScheduling": ["quick", ["sweep"]],
    "maxIterations": [-1, 0.5, math.inf],
    "tolerance": [-1.0, math.nan],
}
FLAGS = "sleeping", "ground", "gyroscopic", "enforceConstraints", "linkedBodiesCollide"
WRONG |= dict.fromkeys(FLAGS, ["no", None, 2])
WRONG["gravity"] += (1, 2), (0, math.nan, 0), [0, 1.1e6, 0], (1, True, 0)
STEP = {"meshes": [], "groundMesh": ground(), "timeStep": 0.02, "CRCoeff": 0.5}
# Allowed in a step, where they have a meaning or are the same formula.
ALLOWED_IN_STEP = {"restitution": (-0.01, 1.01), "timeStep": (0.0, 1e-13, 1001.0)}


@pytest.mark.parametrize("one", SETTINGS.values(), ids=lambda one: one.name)
def test_a_wrong_value_is_refused_by_name_and_changes_nothing(one):
    solver = one.solver or "impulse"
    settings = Settings(contactSolver=solver)
    before = asdict(settings)
    for value in WRONG[one.name]:
        told = f"^{one.name} must be .*, not {re.escape(shown_value(value))}"
        with pytest.raises(ValueError, match=told):
            Settings(**{"contactSolver": solver, one.name: value})
        for assign in settings.change, partial(setattr, settings):
            with pytest.raises(ValueError, match=f"^{one.name} must be "):
                assign(one.name, value)
        if value not in (None, *ALLOWED_IN_STEP.get(one.name, ())):  # None: not given
            with pytest.raises(ValueError, match=f"^{one.parameter} must be "):
                run_timestep(**STEP | {one.parameter: value})
    assert asdict(settings) == before


def test_every_setting_is_described():
    assert [*TEXTS] == [*SETTINGS] == re.findall(r"(\w+) :", Settings.__doc__)


def test_gravity_is_a_number_or_a_vector():
    settings = Settings(gravity=(1, -9, 0.5))
    assert settings.gravity == settings.acceleration == (1.0, -9.0, 0.5)
    assert eval(repr(settings)) == settings != Settings(gravity=9.0)
    text = TEXTS["gravity"].shown(settings)
    assert text == "1,-9,0.5" and TEXTS["gravity"].parsed(text) == settings.gravity
    settings.gravity = np.array([0.0, -9000.0, 0.0])
    assert settings == Settings(gravity=9000.0) and settings.acceleration == (0.0, -9000.0, 0.0)


OTHER_VALUES = {"substeps": 3, "sleeping": False, "broadPhase": "grid"}
OTHER_VALUES |= {"constraintScheduling": "queue", "maxIterations": 7}
OTHER_VALUES |= {"contactScheduling": "batches"}


@pytest.mark.parametrize("name", OTHER_VALUES)
def test_what_the_solver_ignores_is_refused_by_name(capsys, name):
    one, value = SETTINGS[name], OTHER_VALUES[name]
    other = "impulse" if one.solver == "soft-step" else "soft-step"
    with pytest.raises(ValueError, match=f"^{name} has no effect with contactSolver '{other}'"):
        Settings(**{"contactSolver": other, name: value})
    with pytest.raises(ValueError, match=f"^{name} has no effect with contactSolver '{other}'"):
        run_timestep([], ground(), 0.02, 0.5, contactSolver=other, **{one.parameter: value})
    option = TEXTS[name].option
    words = [f"--{option}"] + [value] * (one.kind is not bool)
    code, _, errors = call(capsys, "tower", "--solver", other, *words, "--headless")
    message = f"--{option} has no effect with --solver {other}"
    assert (code, errors) == (2, f"RigidBodySimulation.py: {message}\n")


def test_a_step_has_the_values_of_its_settings_unless_others_are_given():
    box, other = box_body(1, 1, 1, (0, 9, 0)), box_body(1, 1, 1, (0, 9, 0))
    rope = [[0, 0, 1, 0, 0.1, True]]
    kept = {"restitution": 0.25, "timeStep": 0.5, "enforceConstraints": False, "friction": 0.5}
    kept |= {"maxIterations": 7, "tolerance": 0.125, "gravity": (1, 2, 3), "gyroscopic": True}
    chosen = Settings(**kept)
    assert step_arguments(chosen, {}) == step_arguments(None, chosen.arguments())
    run_timestep([box, other], None, settings=chosen, constraints=rope)
    assert box.linVelocity.tolist() == [[0.5, 1.0, 1.5]]
    # what is given counts, also if it is the coursework's default
    usual = {"timeStep": 0.02, "CRCoeff": 0.5, "enforceConstraints": True, "maxIterations": 1000}
    usual |= {"tolerance": 1e-3, "mu": 0.0, "gyroscopic": False, "gravity": (0.0, -9.8, 0.0)}
    for name, value in usual.items():
        assert step_arguments(chosen, {name: value})[name] == value
    # the limit of visits is 1000 in the coursework, and grows with the scene in the program
    assert step_arguments(None, usual, 10**5)["maxIterations"] == 1000
    assert step_arguments(Settings(), {}, 10**5)["maxIterations"] == 20 * 10**5
    assert step_arguments(Settings(), {})["maxIterations"] == 1000
    for lacking in ("timeStep", "CRCoeff"):
        given = {"timeStep": 0.02, "CRCoeff": 0.5}
        del given[lacking]
        with pytest.raises(TypeError, match=f"needs {lacking}, or settings"):
            run_timestep([box], None, **given)
