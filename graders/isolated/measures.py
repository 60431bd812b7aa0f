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

    ours : the SceneSimulation that takes over the states
    """

    def __init__(self, worker, scene, **contact):
        self.ours = SceneSimulation(SceneSource.of_files(find_scene(scene)), Settings())
        self._worker, fixed = worker, [mesh.isFixed for mesh in self.ours.meshes]
        order = scene_order(self.ours.source, fixed, **contact)
        self.parameters = worker.ask(order)["parameters"]
        self.counts = {}

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


def slides(make):
    """How far a body slides at most, with three coefficients of friction, and what is wrong."""
    slid, grown = [], False
    for friction in FRICTION:
        with make() as worker:
            run, name = Run(worker, "slide"), ""
            names = {}
            for function in ("run_timestep", "resolve_collision"):
                found = filter(FRICTION_NAME.fullmatch, run.parameters.get(function, ()))
                names[function] = next(found, "")
            if not any(names.values()):
                return "no function has a coefficient of friction"
            name, options = names["run_timestep"], {}
            if name:
                options = {name: friction}
            else:
                run = Run(worker, "slide", **{names["resolve_collision"]: friction})
            energies, places = [], []
            for one in run.states(STEPS, **options):
                energies.append(one.kinetic_energy() + one.potential_energy())
                places.append(one.state()["positions"])
            grown |= max(energies) > (1.0 + GROWTH) * energies[0]
        slid.append(_distance(places[0], places[-1]))
    ours = [_our_distance(friction) for friction in FRICTION]
    shown, usual = (", ".join(f"{one:.3g}" for one in some) for some in (slid, ours))
    text = f"slid {shown} m in 2 s with μ = {', '.join(map(str, FRICTION))} (ours {usual} m)"
    isNear = all(abs(a - b) <= NEAR * max(b, 0.1) for a, b in zip(slid, ours, strict=True))
    if not isNear and (slid[-1] > slid[0] or grown):
        text += "; a person should look: more friction moves the body further, so its sign is wrong"
    elif not isNear and max(slid) - min(slid) <= NEAR * max(slid):
        text += "; a person should look: the distance does not depend on μ, so the limit is missing"
    elif not isNear:
        text += "; a person should look: the distances are not ours"
    return text


def _distance(start, end):
    return float(np.hypot(*(end - start)[:, [0, 2]].T).max())


def _our_distance(friction):
    settings = Settings(timeStep=0.02, restitution=0.5, friction=friction)
    ours = SceneSimulation(SceneSource.of_files(find_scene("slide")), settings)
    start = ours.state()["positions"]
    for _ in range(STEPS):
        ours.step()
    return _distance(start, ours.state()["positions"])


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
        names = list(filter(switch.fullmatch, run.parameters.get("run_timestep", ())))
        for options in ({}, *({name: value} for name in names[:1] for value in (False, True))):
            list(run.states(1, **options))
            count = int(run.counts.get(function, 0))
            texts.append(f"{count}" + "".join(f" with {k}={v}" for k, v in options.items()))
    return ", ".join(texts), run.ours


def measured(handIn, limits):
    """Returns lines on the extension."""

    def make():
        return Worker(handIn, limits, time.monotonic() + limits.seconds + GRACE)

    lines = []
    for measure in (slides, pairs, visits):
        try:
            lines.append(measure(make))
        except (Ended, ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
            lines.append(f"{measure.__name__}: {error}")
    return lines
