"""Section 2: how distance constraints converge, and what their order in the step does."""

import math
from collections import Counter
from types import SimpleNamespace

import numpy as np
import runs
import style
from oracles import body
from runs import AWAKE, BATCHED, H, experiment, finish, run, scene, throw

import RBSFunctions
from RBSFunctions import resolve_position_constraint, resolve_velocity_constraint

ROPE, PULL, SWEEPS = 2.0, 0.01, 400  # m, m
LINKS = (5, 10, 20)
PANEL = (3.6, 4.0)


def errors_of_chain(links):
    """Largest error of a chain after each sweep, in m, once its free end has been pulled.

    Links are rods between centres, visited from the anchor, which is fixed, to the free end.
    """
    places = [np.array([[0.0, -ROPE * k, 0.0]]) for k in range(links + 1)]
    places[-1][0, 1] -= PULL
    errors = []
    for sweep in range(SWEEPS * links):
        k = sweep % links
        for isUpper in (False, True):
            ends, invMasses = (places[k], places[k + 1]), (float(k > 0), 1.0)
            _, moved = resolve_position_constraint(ends, ends, ROPE, invMasses, isUpper, 0.0)
            places[k], places[k + 1] = (np.reshape(one, (1, 3)) for one in moved)
        if k == links - 1:
            errors.append(np.abs(-np.diff(np.concatenate(places)[:, 1]) - ROPE).max())
    return np.array(errors)


@experiment(PANEL)
def chain(axis):
    """Error of chains against sweeps; a sweep leaves cos²(π/2k) of it."""
    rates, numbers, sweeps = [], {}, np.arange(1, SWEEPS + 1)
    for links, (colour, mark) in zip(LINKS, style.LOOKS, strict=True):
        errors, law = errors_of_chain(links), math.cos(math.pi / (2 * links)) ** 2
        last = int((errors > 1e-10).sum()) - 1  # beyond, rounding shows
        measured = np.log(errors[last] / errors[last // 2]) / (last - last // 2)
        rates.append(measured / math.log(law))
        axis.semilogy(sweeps, 1e3 * errors[last] * law ** (sweeps - 1.0 - last), color=colour)
        look = {"color": colour, "markevery": (links, 40), "label": f"{links} links"}
        axis.semilogy(sweeps, 1e3 * errors, mark, **look)
        numbers[f"tenfold{links}"] = math.log(0.1) / math.log(law)
    axis.set(xlabel="sweeps", ylabel="largest error / mm", ylim=(1e-4, 30), xlim=(0, SWEEPS))
    style.ticks(axis, y=(1e-3, 1e-1, 10))
    axis.legend(loc="upper right")
    return numbers | {"worst": 100 * np.abs(np.array(rates) - 1).max()}


TRIED = (5, 10, 20, 40)  # sweeps
CALMED, CALM = 800, 0.98  # steps that damp the bridge's swing, and the velocity that one leaves


def calmed(**settings):
    """Returns the bridge, damped until it rests; by itself, it would swing for minutes."""
    simulation = scene("bridge", **settings)
    for _ in range(CALMED):
        simulation.step()
        for mesh in simulation.meshes:
            mesh.linVelocity = CALM * mesh.linVelocity
            mesh.angVelocity = CALM * mesh.angVelocity
    return simulation


@experiment(PANEL)
def bridge(axis):
    """Median violation in cm of the bridge at rest, which is no longer damped: in the basic step
    against sweeps, and in the soft step with one substep and with six.
    """

    def violation(**settings):
        simulation, found = calmed(**settings), []
        for _ in range(120):
            simulation.step()
            found.append(100 * simulation.largest_violation())
        return float(np.median(found))

    count = len(scene("bridge").constraints)
    found = [violation(maxIterations=sweeps * count, **BATCHED) for sweeps in TRIED]
    one, six = violation(substeps=1, **AWAKE), violation(**AWAKE)
    axis.loglog(TRIED, found, "s-", color=style.VERMILION, label="basic step")
    axis.axhline(six, color=style.GREEN, linestyle="--", label="soft step")
    style.ticks(axis, TRIED, (0.01, 0.1, 1, 10))
    axis.set(xlabel="sweeps in a step", ylabel="largest violation / cm", ylim=(0.005, 500))
    axis.legend(loc="upper right")
    numbers = {f"sweeps{n}": one for n, one in zip(TRIED, found, strict=True)}
    return numbers | {"power": runs.exponent(TRIED[:3], found[:3]), "one": one, "six": six}


class Watched(SimpleNamespace):
    """The coursework's functions, which count visits and corrections, and those in which the points
    of a rope approach; isOneWay : whether they may then go on.
    """

    def __init__(self, isOneWay=False):
        super().__init__(isOneWay=isOneWay, isUpper=True, counts=Counter())
        self.resolve_collision = RBSFunctions.resolve_collision

    def resolve_position_constraint(self, *arguments):
        answer = resolve_position_constraint(*arguments)
        self.isUpper = arguments[4]
        self.counts.update(visits=1, corrections=not answer[0])
        return answer

    def resolve_velocity_constraint(self, places, points, linear, angular, *others):
        apart = points[0] - points[1]
        first, second = (linear[k] + np.cross(angular[k], points[k] - places[k]) for k in range(2))
        isApproaching = self.isUpper and ((first - second) * apart).sum() < 0.0
        self.counts["approaching"] += isApproaching
        if isApproaching and self.isOneWay:
            return True, linear, angular
        return resolve_velocity_constraint(places, points, linear, angular, *others)


def watched(simulation, steps=1):
    """Makes steps of a simulation in the basic step, with sweeps; returns the counts."""
    functions, settings = Watched(), simulation.settings.arguments(len(simulation.constraints))
    settings |= {"contactScheduling": "sequential", "constraintScheduling": "sweep"}
    more = {"constraints": simulation.constraints, "functions": functions}
    h, e = settings.pop("timeStep"), settings.pop("CRCoeff")
    finish(simulation.meshes, steps, h, e, **settings, **more)
    return functions.counts


ROPE_LENGTH, TOO_LONG, NEARING, ROPE_STEPS = 4.0, 0.5, 1.0, 75  # m, m, m/s


@experiment(PANEL)
def rope(axis):
    """Distance of two bodies that approach while their rope is still too long: the bilateral
    projection, one that lets them go on, and the soft step; and how often the bridge meets this.
    """
    numbers, tip = {"speed": NEARING, "long": 100 * TOO_LONG}, 2 * 3.4 + ROPE_LENGTH
    time = H * np.arange(ROPE_STEPS + 1)
    for (key, name, options), (colour, mark) in zip(
        (
            ("basic", "basic step", {}),
            ("oneWay", "one-sided", {"functions": Watched(isOneWay=True)}),
            ("soft", "soft step", AWAKE),
        ),
        style.LOOKS[1::-1] + style.LOOKS[2:],
        strict=True,
    ):
        left, right = (body("octahedron", (x, 0, 0)) for x in (0.0, tip + TOO_LONG))
        throw(left, (NEARING / 2, 0, 0)), throw(right, (-NEARING / 2, 0, 0))
        rope = [0, 0, 1, 2, ROPE_LENGTH, True]
        options = options | {"constraints": [rope], "gravity": (0.0, 0.0, 0.0)}
        gaps = [ROPE_LENGTH + TOO_LONG]
        for _ in run([left, right], ROPE_STEPS, ground=False, **options):
            gaps.append(float(right.position[0, 0] - left.position[0, 0]) - 2 * 3.4)
        look = {"color": colour, "markevery": (5 * len(numbers), 20), "label": name}
        axis.plot(time, gaps, mark + "-", **look)
        numbers[key] = (gaps[-2] - gaps[-1]) / H
    axis.set(xlabel="time / s", ylabel="distance / m", xlim=(0, time[-1]), ylim=(2.4, 5.4))
    axis.legend(loc="upper right")
    counts = watched(scene("bridge"), 200)
    return numbers | {"share": 100 * counts["approaching"] / counts["corrections"]}


@experiment()
def ground():
    """Depth in m to which constraints press bodies, each linked to all others, into the ground."""

    def depth(**settings):
        simulation, low = scene("cube", **settings), 0.0
        for _ in range(round(4.0 / H)):
            simulation.step()
            low = min(low, *(mesh.currVertices[:, 1].min() for mesh in simulation.meshes))
        return -low

    numbers = {"basic": depth(), "without": depth(enforceConstraints=False)}
    return numbers | {"cured": depth(contactSolver="soft-step")}
