"""Section 2: how distance constraints converge, and what their order in the step does."""

import math

import numpy as np
import style
from engines import in_turns
from runs import AWAKE, H, experiment, scene

from RBSFunctions import resolve_position_constraint

ROPE, PULL, SWEEPS = 2.0, 0.01, 400  # m
LINKS = (5, 10, 20)
PANEL = (4.25, 4.2)


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


ALLOWED = (1, 2, 4, 8, 16, 32, 64)  # sweeps
FROM, TURNS = 60, 20  # first step that counts; turns
CALMED, CALM = 1500, 0.98  # steps that damp the bridge's swing, and the velocity that one leaves


@experiment(PANEL, isTimed=True)
def bridge(axis):
    """Violation left on a bridge in cm, against milliseconds of a step; medians."""
    count = len(scene("bridge").constraints)
    runs = {"soft": scene("bridge", FROM, **AWAKE)}
    for way in ("sweep", "batches"):
        options = {"contactScheduling": "batches", "constraintScheduling": way}
        for most in ALLOWED:
            runs[way, most] = scene("bridge", FROM, maxIterations=most * count, **options)
    times, errors = [], []
    for _ in range(TURNS):
        times.append([values.mean() for values in in_turns(runs, 1).values()])
        errors.append([100 * one.largest_violation() for one in runs.values()])
    found = np.transpose([np.median(times, axis=0), np.median(errors, axis=0)])
    soft, ways = found[0], dict(zip(("sweep", "batches"), np.split(found[1:], 2), strict=True))
    for (way, points), (colour, mark) in zip(ways.items(), style.LOOKS, strict=False):
        axis.loglog(*points.T, mark + "-", color=colour, label=way)
    for most, point in list(zip(ALLOWED, ways["sweep"], strict=True))[::2]:
        axis.annotate(most, point, (-8, -9), textcoords="offset points", fontsize=8)
    axis.plot(*soft, "D", color=style.BLACK, markersize=5, label="soft step")
    style.ticks(axis, x=(2, 5, 10))
    axis.set(xlabel="ms per step", ylabel="largest violation / cm", ylim=(0.05, 2e3))
    axis.legend(loc="upper right")
    numbers = {"soft": {"ms": soft[0], "cm": soft[1]}, "constraints": count, "most": ALLOWED[-1]}
    return numbers | {"ms": ways["sweep"][-1, 0], "cm": ways["sweep"][-1, 1]}


@experiment()
def kept():
    """Median violation in cm of the bridge at rest, in the soft step: impulses kept or cleared.

    The bridge would swing for minutes, so it is damped until it rests, and measured without.
    """

    def violation(substeps, isKept=True):
        simulation, found = scene("bridge", substeps=substeps, **AWAKE), []
        for k in range(CALMED + 120):
            if not isKept:
                simulation.solverState.clear()
            simulation.step()
            if k < CALMED:
                for mesh in simulation.meshes:
                    mesh.linVelocity = CALM * mesh.linVelocity
                    mesh.angVelocity = CALM * mesh.angVelocity
                continue
            found.append(100 * simulation.largest_violation())
        return float(np.median(found))

    one, six = violation(1), violation(6)
    return {"one": one, "six": six, "ratio": one / six, "cleared": violation(1, False)}


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
