"""What an observer of a step is told and `--trace` prints; terms, held to the step and `model`."""

import copy
from collections import Counter

import numpy as np
import pytest
from oracles import box_body, state_of
from program import call
from studentVariants import write_submission

from rbs.glass.events import Kind
from rbs.glass.terms import terms, values
from rbs.glass.trace import deviations
from RBSFunctions import run_timestep
from RigidBodySimulation import Settings, Simulation

# Scenes with contacts of bodies, constraints, and friction; and a step of each that has them.
SCENES = {"mixed": 100, "tower_chain": 90, "slide": 80}


def events_of(simulation):
    events = []
    simulation.step(events.append)
    return events


WAYS = [{}, {"broadPhase": "grid", "constraintScheduling": "queue"}]
WAYS += [{"friction": 0.5, "contactScheduling": "batches"}]


@pytest.mark.parametrize(
    "scene, settings",
    [*(("tower_chain", way) for way in WAYS), ("mixed", WAYS[1]), ("slide", WAYS[2])],
)
def test_observed_steps_have_the_same_bits_and_the_sum_of_their_events(scene, settings):
    observed = Simulation(scene, Settings(**settings)).run(SCENES[scene] - 60)
    plain, kinds = copy.copy(observed), Counter()
    for _ in range(60):
        before = state_of(plain.meshes)
        events = events_of(observed)
        plain.step()
        kinds += Counter(event.kind for event in events)
        after = state_of(observed.meshes)
        assert after.tobytes() == state_of(plain.meshes).tobytes()
        for k, (total, end) in enumerate(zip(before, after, strict=True)):
            own = [(e, e.bodies.index(k)) for e in events if k in e.bodies]
            for event, place in own:
                ends = (np.hstack(one[place][:4]) for one in (event.after, event.before))
                total = total + np.subtract(*ends)
            assert np.abs(total - end).max() <= 1e-12 * max(1.0, np.abs(end).max())
    expected = {Kind.FLIGHT, Kind.CONTACT, Kind.CORRECTION, Kind.IMPULSE}
    expected |= {Kind.CONSTRAINT} if scene == "tower_chain" else set()
    assert set(kinds) == expected | ({Kind.FRICTION} if "friction" in settings else set())


@pytest.mark.parametrize("settings", [*WAYS[1:], {"contactSolver": "soft-step"}])
def test_an_observer_that_raises_leaves_everything_unchanged(settings):
    """Whenever it does: the run continued has the bits of one that was not disturbed."""
    scene = "mixed" if "contactSolver" in settings else "tower_chain"
    disturbed, raised = Simulation(scene, Settings(**settings)).run(SCENES[scene]), 0
    plain = copy.copy(disturbed)
    for step in range(30):
        told = []

        def stop(event, told=told, after=step * step // 8 % 20):
            told.append(event.kind)
            if len(told) > after:
                raise KeyboardInterrupt

        before = plain.state()
        try:
            disturbed.step(stop)
        except KeyboardInterrupt:
            solver = disturbed.solverState.arrays(), plain.solverState.arrays()
            assert repr(solver[0]) == repr(solver[1])
            for name, rows in disturbed.state().items():
                assert rows.tobytes() == before[name].tobytes()
            disturbed.step()
            raised += 1
        plain.step()
        assert state_of(disturbed.meshes).tobytes() == state_of(plain.meshes).tobytes()
        assert disturbed.report.contacts == plain.report.contacts
    assert raised > 1


def test_fixed_bodies_that_move_in_any_way_have_a_flight():
    meshes = [box_body(1, 1, 1, (9.0 * k, 9, 0), isFixed=True) for k in range(4)]
    _, going, turning, both = meshes
    going.linVelocity, turning.angVelocity = np.array([[1, 0, 0.0]]), np.array([[0, 0, 1e-3]])
    both.linVelocity, both.angVelocity = going.linVelocity, turning.angVelocity
    events = []
    run_timestep(meshes, None, 0.02, 0.5, observer=events.append)
    assert [(e.kind, e.bodies) for e in events] == [(Kind.FLIGHT, (k,)) for k in (1, 2, 3)]
    assert all(deviations(event) == [] for event in events)


@pytest.fixture(scope="module", params=SCENES)
def events(request):
    simulation = Simulation(request.param, Settings(friction=0.4)).run(SCENES[request.param] - 30)
    return [event for _ in range(30) for event in events_of(simulation)]


def test_what_is_computed_a_second_time_is_what_the_step_did(events):
    counts = {}
    for event in events[::3]:
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
    assert counts[Kind.FLIGHT] > 50 and counts[Kind.CORRECTION] > 5
    assert counts[Kind.IMPULSE] > 5 and counts[Kind.FRICTION] > 5


def test_trace_prints_the_events_of_a_step_of_one_body(capsys):
    traced = "slide", "--basic", "--trace"
    code, out, _ = call(capsys, *traced, "41")
    assert code == 0 and "impulse of slab 2 and box 7" in out
    code, some, _ = call(capsys, *traced, "41:box 7")
    assert code == 0 and set(some.splitlines()) < set(out.splitlines())
    assert call(capsys, *traced, "41:7")[1] == some
    told = "no events of tray_block 7, which is fixed, in step 41\n"
    assert call(capsys, "mixed", "--trace", "41:7")[:2] == (0, told)


def test_a_failing_step_is_traced_up_to_where_it_fails(tmp_path, capsys):
    begin = "    denominator = total"
    wrong = write_submission(
        tmp_path / "wrong", [(begin, f"    raise ValueError('none')\n{begin}")]
    )
    code, out, error = call(capsys, "mixed", "--trace", "43", "--functions", wrong)
    assert code == 3 and "none" in error
    heads = [line for line in out.splitlines() if not line.startswith("       ")]
    assert "contact 1 of cylinder 1 and the ground" in heads[-1]
