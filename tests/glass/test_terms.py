"""The terms of each event, held to what the step did and to matrices of all six coordinates."""

import numpy as np
import pytest
from oracles import ROOT

from rbs.glass.events import Kind
from rbs.glass.terms import formulas, sentence, terms, unit, values
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping.settings import Settings

SCENES = {"mixed": 100, "tower_chain": 100, "slide": 80}


def observed(scene, steps, **settings):
    """Events of each step, and the simulation after them."""
    simulation = SceneSimulation(ROOT / f"data/{scene}-scene.txt", Settings(**settings))
    told = []
    for _ in range(steps):
        told.append([])
        simulation.step(told[-1].append)
    return told, simulation


@pytest.fixture(scope="module", params=SCENES)
def events(request):
    told, _ = observed(request.param, SCENES[request.param], friction=0.4)
    return [event for step in told for event in step]


def test_what_is_computed_a_second_time_is_what_the_step_did(events):
    counts = {}
    for event in events:
        computed, done = terms(event), values(event)
        # velocities are rounded, and with them the impulses that they tell
        states = event.before + event.after
        speed = max(1.0, *(np.abs(one[2:4]).max() for one in states))
        momentum = speed / (max(one.invMass for one in event.before) or 1.0)
        scales = {"j": momentum, "f": momentum, "λ": momentum}
        if impulse := done.get("j") or done.get("λ"):
            scales["K"] = computed["K"] * max(1.0, momentum / abs(impulse))
        for symbol, value in done.items():
            if "′" not in symbol and symbol not in scales:
                continue
            scale = scales.get(symbol, max(1.0, np.max(np.abs(value))))
            gap = np.max(np.abs(np.subtract(computed[symbol], value)))
            assert gap <= 1e-12 * scale, (event.kind, symbol)
            counts[event.kind] = counts.get(event.kind, 0) + 1
    assert counts[Kind.FLIGHT] > 500 and counts[Kind.CORRECTION] > 20
    assert counts[Kind.IMPULSE] > 20 and counts[Kind.FRICTION] > 20


def test_every_symbol_of_a_formula_has_a_value_and_every_number_a_unit(events):
    told, _ = observed("slide", 60, contactSolver="soft-step", friction=0.5)
    for event in [*events, *told[-1]]:
        found = terms(event)
        assert sentence(event).endswith(".")
        for line in formulas(event):
            assert any(word in found for word in line.split()), line
        for symbol, value in found.items():
            without = {"n", "t", "e", "μ", "w1", "w2", "q", "q′", "result"}
            assert bool(unit(symbol)) != (symbol in without), symbol
            assert not isinstance(value, np.ndarray) or value.shape in ((3,), (4,))
