"""Measures what helps a marker to decide, from states that a student's steps lead to."""

import math
import re
import time

import numpy as np

from isolated.processes import GRACE, Ended, Worker
from isolated.stepComparison import scene_order, states_in
from rbs.program.submittedsteps import FRICTION_NAME
from rbs.scenes.scenefiles import SceneSource, find_scene
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping.settings import Settings

STEPS, FRICTION = 100, (0.1, 0.3, 0.6)
# What students call switches of the broad phase, and of the queue of constraints.
GRID_NAME = re.compile(r".*(grid|broad|cell|hash).*", re.IGNORECASE)
QUEUE_NAME = re.compile(r".*(dirty|queue).*", re.IGNORECASE)
# How far distances slid may be from ours, relative; and how much energy may grow.
NEAR, GROWTH = 0.2, 0.01


class Run:
    """Steps of a scene by a student's functions, each from where the one before ended.

    ours : the SceneSimulation that takes over the states; counts : calls in the last step, by name
    """

    def __init__(self, worker, scene):
        self.ours, self.counts = simulation_of(scene), {}
        order = scene_order(self.ours.source, [mesh.isFixed for mesh in self.ours.meshes])
        self._worker, self._known = worker, worker.ask(order)["parameters"]["run_timestep"]

    def parameter(self, pattern):
        """The first parameter of the student's run_timestep with such a name, or ""."""
        return next(filter(pattern.fullmatch, self._known), "")

    def states(self, count, **options):
        """Yields `ours` at the start, and after each step."""
        yield self.ours
        start = states_in(self.ours.meshes)
        for _ in range(count):
            step = 0.02, 0.5, True, [list(one) for one in self.ours.constraints]
            order = {"states": start, "step": step, "isTold": False}
            told = self._worker.ask(order | {"options": options})
            if told["problem"]:
                raise ValueError(str(told["problem"]))
            rows, start, self.counts = told["states"], None, told["counts"]
            columns = zip(*(rows[str(k)][:4] for k in range(len(self.ours.meshes))), strict=True)
            columns = [np.array([np.ravel(one) for one in column], float) for column in columns]
            self.ours.set_state(dict(zip(self.ours.state(), columns, strict=False)))
            yield self.ours


def simulation_of(scene, friction=0.0):
    settings = Settings(timeStep=0.02, restitution=0.5, friction=friction)
    return SceneSimulation(SceneSource.of_files(find_scene(scene)), settings)


def _slid(states):
    """How far a body slides at most, in m, and whether the energy grows."""
    found = [(one.kinetic_energy() + one.potential_energy(), one.state()) for one in states]
    energies, ends = [energy for energy, _state in found], (found[0][1], found[-1][1])
    way = np.subtract(*(state["positions"] for state in ends))[:, [0, 2]]
    return float(np.hypot(*way.T).max()), max(energies) > (1.0 + GROWTH) * energies[0]


def _our_states(friction):
    ours = simulation_of("slide", friction)
    yield ours
    for _ in range(STEPS):
        ours.step()
        yield ours


def slides(make):
    """How far a body slides at most, with three coefficients of friction, and what is wrong."""
    slid, ours, grown = [], [], False
    for friction in FRICTION:
        with make() as worker:
            run = Run(worker, "slide")
            if not (name := run.parameter(FRICTION_NAME)):
                return "run_timestep has no coefficient of friction"
            way, hasGrown = _slid(run.states(STEPS, **{name: friction}))
        slid.append(way)
        ours.append(_slid(_our_states(friction))[0])
        grown |= hasGrown
    shown, usual = (", ".join(f"{one:.3g}" for one in some) for some in (slid, ours))
    text = f"slid {shown} m in 2 s with μ = {', '.join(map(str, FRICTION))} (ours {usual} m)"
    if all(abs(a - b) <= NEAR * max(b, 0.1) for a, b in zip(slid, ours, strict=True)):
        return text
    if slid[-1] > slid[0] or grown:
        why = "more friction moves the body further, so its sign is wrong"
    elif max(slid) - min(slid) <= NEAR * max(slid):
        why = "the distance does not depend on μ, so the limit is missing"
    else:
        why = "the distances are not ours"
    return f"{text}; a person should look: {why}"


def pairs(make):
    """How many pairs a step tests; also with the student's grid off and on, if it has a switch."""
    shown, ours = _counts(make, "stress", GRID_NAME, "detect_collision")
    return f"tests {shown} of {math.comb(len(ours.meshes), 2)} pairs of stress in a step"


def visits(make):
    """How many constraints a step visits; also with the student's queue off and on."""
    shown, ours = _counts(make, "net", QUEUE_NAME, "resolve_position_constraint")
    return f"visits {shown} constraints of net's {len(ours.constraints)} in a step"


def _counts(make, scene, switch, function):
    """Calls of a function in a step, as text, by the student's switch; and our simulation."""
    with make() as worker:
        run, texts = Run(worker, scene), []
        name = run.parameter(switch)
        for options in ({}, {name: False}, {name: True}) if name else ({},):
            list(run.states(1, **options))
            count = int(run.counts.get(function, 0))
            texts.append(f"{count}" + "".join(f" with {k}={v}" for k, v in options.items()))
    return ", ".join(texts), run.ours


def measured(handIn, limits):
    def make():
        return Worker(handIn, limits, time.monotonic() + limits.seconds + GRACE)

    lines = []
    for measure in (slides, pairs, visits):
        try:
            lines.append(measure(make))
        except (Ended, ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
            lines.append(f"{measure.__name__}: {error}")
    return lines
