"""Measures what helps a marker to decide; `compare.measured` runs this script within limits."""

import inspect
import json
import math
import os
import re
import sys
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from reference.graderData import give_up_names

from rbs.program.submittedsteps import SubmittedSteps
from rbs.scenes.scenefiles import find_scene
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping.settings import Settings

STEPS, FRICTION = 100, (0.1, 0.3, 0.6)


def simulated(steps, scene, friction=0.0, count=STEPS):
    """Yields the simulation of a scene by a student's functions, at the start and after steps."""
    settings = Settings(timeStep=0.02, restitution=0.5, friction=friction)
    simulation = SceneSimulation(find_scene(scene), settings)
    simulation.submitted = steps
    yield simulation
    for _ in range(count):
        simulation.step()
        yield simulation


def energy(steps):
    """The energy of a run."""
    states = simulated(steps, "mixed")
    E = [1e-6 * (one.kinetic_energy() + one.potential_energy()) for one in states]
    return f"energy in mixed: {E[0]:.3g} MJ, at most {max(E):.3g} MJ, {E[-1]:.3g} MJ after 2 s"


def slides(steps):
    """How far a body slides at most, with three coefficients of friction."""
    if not steps.has_friction():
        steps = SubmittedSteps(Path.cwd(), inOurLoop=True)
    if not steps.has_friction():
        return "no function has a coefficient of friction"
    shown = []
    for friction in FRICTION:
        start, *_, end = (one.state()["positions"] for one in simulated(steps, "slide", friction))
        shown.append(f"{np.hypot(*(end - start)[:, [0, 2]].T).max():.3g}")
    return f"slid {', '.join(shown)} m in 2 s with μ = {', '.join(map(str, FRICTION))}"


def pairs(steps):
    """How many pairs a step tests; also with the student's grid off and on, if it has a switch."""
    parameters = inspect.signature(steps.run_timestep).parameters
    names = [name for name in parameters if re.search("grid|broad|cell|hash", name, re.IGNORECASE)]
    original, tested, (start,) = steps.run_timestep, [0], simulated(steps, "stress", count=0)
    mesh = type(steps.follow(start.meshes, start.source)[0][0])
    detect = mesh.detect_collision

    def counted(*given):
        tested[-1] += 1
        return detect(*given)

    mesh.detect_collision, texts = counted, []
    for options in ({}, *({name: value} for name in names[:1] for value in (False, True))):
        steps.run_timestep = partial(original, **options)
        list(simulated(steps, "stress", count=1))
        texts.append(f"{tested[-1]}" + "".join(f" with {k}={v}" for k, v in options.items()))
        tested.append(0)
    most = math.comb(len(start.meshes), 2)
    return f"tests {', '.join(texts)} of {most} pairs of stress in a step"


def main():
    """Writes a dict from the number of a section to lines."""
    give_up_names()
    answer, steps = {"1": [], "3": []}, SubmittedSteps(Path.cwd())
    for section, measure in (("1", energy), ("3", slides), ("3", pairs)):
        try:
            answer[section].append(measure(steps))
        except Exception as error:
            answer[section].append(f"{measure.__name__}: {error}")
        Path(sys.argv[1]).write_text(json.dumps(answer), encoding="utf-8")
    os._exit(0)


if __name__ == "__main__":
    main()
