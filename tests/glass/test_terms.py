"""The terms of each event, held to what the step did and to matrices of all six coordinates."""

import numpy as np
import pytest
from oracles import ROOT

from Quaternion import Q2RotMatrix
from rbs.glass.events import Kind
from rbs.glass.terms import formulas, seen, terms, unit
from rbs.glass.trace import first_difference, shown, trace_lines
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


def inverse_mass_matrix(states):
    M = np.zeros((12, 12))
    for k, one in enumerate(states):
        R = Q2RotMatrix(one.orientation[None])
        M[6 * k : 6 * k + 3, 6 * k : 6 * k + 3] = one.invMass * np.eye(3)
        M[6 * k + 3 : 6 * k + 6, 6 * k + 3 : 6 * k + 6] = R @ one.invIT @ R.T
    return M


def jacobian(n, r1, r2):
    return np.concatenate([n, np.cross(r1, n), -n, -np.cross(r2, n)])


def velocities(states):
    return np.concatenate([np.concatenate([one.linVelocity, one.angVelocity]) for one in states])


def test_what_is_computed_a_second_time_is_what_the_step_did(events):
    counts = {}
    for event in events:
        computed, done = terms(event), seen(event)
        # velocities are rounded, and with them the impulses that they tell
        speed = max(1.0, *(np.abs(velocities(event.before + event.after))))
        momentum = speed / (max(one.invMass for one in event.before) or 1.0)
        scales = {"j": momentum, "f": momentum, "λ": momentum}
        if "K" in done:
            impulse = done.get("j") or done.get("λ")
            scales["K"] = computed["K"] * max(1.0, momentum / abs(impulse))
        for symbol, value in done.items():
            scale = scales.get(symbol, max(1.0, np.max(np.abs(value))))
            gap = np.max(np.abs(np.subtract(computed[symbol], value)))
            assert gap <= 1e-12 * scale, (event.kind, symbol)
            counts[event.kind] = counts.get(event.kind, 0) + 1
    assert counts[Kind.FLIGHT] > 500 and counts[Kind.CORRECTION] > 20
    assert counts[Kind.IMPULSE] > 20 and counts[Kind.FRICTION] > 20


def test_impulses_by_matrices_of_all_coordinates(events):
    count = 0
    for event in events:
        if event.kind != Kind.IMPULSE:
            continue
        count += 1
        found, n = terms(event), event.given["normal"]
        J, M = jacobian(n, found["r1"], found["r2"]), inverse_mass_matrix(event.before)
        v = velocities(event.before)
        assert found["u·n"] == pytest.approx(J @ v, rel=1e-9, abs=1e-9)
        assert found["K"] == pytest.approx(J @ M @ J, rel=1e-12)
        e = event.given["CRCoeff"]
        after = v - M @ J * ((1 + e) * (J @ v) / (J @ M @ J))
        assert np.allclose(velocities(event.after), after, rtol=1e-9, atol=1e-9)
        assert J @ velocities(event.after) == pytest.approx(-e * (J @ v), rel=1e-6, abs=1e-9)
    assert count > 20


def test_friction_by_matrices_and_its_limit(events):
    results = set()
    for event in events:
        if event.kind != Kind.FRICTION:
            continue
        found = terms(event)
        results.add(found["result"])
        J = jacobian(found["t"], found["r1"], found["r2"])
        M, v = inverse_mass_matrix(event.before), velocities(event.before)
        assert found["K"] == pytest.approx(J @ M @ J, rel=1e-12)
        assert abs(found["t"] @ found["n"]) < 1e-12
        stop, limit = J @ v / (J @ M @ J), max(event.given["mu"] * event.given["impulse"], 0.0)
        after = v - M @ J * min(stop, limit)
        assert np.allclose(velocities(event.after), after, rtol=1e-9, atol=1e-9)
        assert found["result"] == ("sticks" if stop <= limit else "slides")
    assert "slides" in results


def test_visits_by_matrices():
    told, _ = observed("tower_chain", 100)
    corrected = [e for step in told for e in step if e.kind == Kind.CONSTRAINT]
    corrected = [event for event in corrected if not event.given["isValid"]]
    assert len(corrected) > 200
    for event in corrected:
        found = terms(event)
        J = jacobian(found["n"], found["r1"], found["r2"])
        M, v = inverse_mass_matrix(event.before), velocities(event.before)
        assert found["Jv"] == pytest.approx(J @ v, rel=1e-9, abs=1e-9)
        after = v - M @ J * (J @ v) / (J @ M @ J) * (abs(J @ v) > found["tolerance"])
        assert np.allclose(velocities(event.after), after, rtol=1e-9, atol=1e-9)
        moves = [b.position - a.position for a, b in zip(event.before, event.after, strict=True)]
        ends = np.add(event.given["points"], moves)
        assert np.linalg.norm(ends[0] - ends[1]) == pytest.approx(event.given["refValue"], abs=1e-9)


def test_every_symbol_of_a_formula_has_a_value_and_every_number_a_unit(events):
    told, _ = observed("slide", 60, contactSolver="soft-step", friction=0.5)
    for event in [*events, *told[-1]]:
        values = terms(event)
        for line in formulas(event):
            symbols = [word for word in line.split() if word in values]
            assert symbols, line
        for symbol, value in values.items():
            without = {"n", "t", "e", "μ", "w1", "w2", "q", "q′", "result"}
            assert bool(unit(symbol)) != (symbol in without), symbol
            assert not isinstance(value, np.ndarray) or value.shape in ((3,), (4,))


def test_closing_only_has_no_negative_impulse():
    told, _ = observed("cube", 120, closingOnly=True)
    impulses = [e for step in told for e in step if e.kind == Kind.IMPULSE]
    found = [terms(event) for event in impulses]
    assert min(one["u·n"] for one in found) < 0.0 <= min(one["j"] for one in found)
    assert any("max( 0," in line for line in formulas(impulses[0]))
    for event, one in zip(impulses, found, strict=True):
        assert seen(event)["j"] == pytest.approx(one["j"], rel=1e-9, abs=1e-6)


def test_a_table_has_a_line_for_each_event_and_each_symbol():
    told, simulation = observed("slide", 41, friction=0.5)
    lines = trace_lines(told[-1], simulation.meshes)
    heads = [line for line in lines if not line.startswith("       ")]
    assert len(heads) == len(told[-1])
    assert len(lines) == len(heads) + sum(len(terms(event)) for event in told[-1])
    some = trace_lines(told[-1], simulation.meshes, 7)
    assert set(some) <= set(lines) and any("box 7" in line for line in some)
    assert all("box 7" in line for line in some if not line.startswith("       "))


def test_rounding_is_not_shown():
    assert shown(np.array([1.0, 1e-15, -0.0])) == "(1, 0, 0)"
    assert shown(-1e-17, "u·n") == "0 m/s"
    assert shown(2.5e-8, "K") == "2.5e-08 1/kg"


def test_the_first_difference_names_event_and_symbol():
    told, simulation = observed("slide", 41, friction=0.5)
    ours = told[-1]
    assert first_difference(ours, ours, simulation.meshes) == []
    at = next(k for k, event in enumerate(ours) if event.kind == Kind.IMPULSE)
    event = ours[at]
    after = [one._replace(linVelocity=0.5 * one.linVelocity) for one in event.after]
    theirs = [*ours[:at], event._replace(after=after), *ours[at + 1 :]]
    lines = first_difference(ours, theirs, simulation.meshes)
    assert "impulse of" in lines[0] and ": K is " in lines[0]
    assert any(line.startswith("  j  ") and "theirs" in line for line in lines)
    (line,) = first_difference(ours, ours[:at] + ours[at + 1 :], simulation.meshes)
    assert "impulse of" in line and "friction of" in line
