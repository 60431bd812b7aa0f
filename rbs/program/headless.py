"""Runs without a window: stepping, outputs, signals, and the summary at the end."""

import statistics
import sys
from contextlib import suppress
from dataclasses import dataclass

from tqdm import tqdm

from rbs.glass.trace import trace_lines
from rbs.scenes.files import SIGNAL_NAMES, signals_kept
from rbs.scenes.messages import InputError, measured, print_error, short, shown_path
from rbs.scenes.scene import followed_by
from rbs.scenes.simulation import go_beside
from rbs.stepping.meshes import StateError


def run_without_window(simulation, steps, outputs):
    """Runs a simulation, prints the summary and saves the `Outputs`. Returns the exit code."""
    go_beside(simulation)
    begin = state_summary(simulation)
    run = run_steps(simulation, steps, outputs)
    show(summarise(simulation, run, begin))
    save(outputs, simulation, not (run.stoppedBy or run.failure))
    print_error(run.failure)
    if run.stoppedBy:
        return 128 + run.stoppedBy
    return 3 if run.failure else 2 * outputs.haveFailed


def save(outputs, simulation, isWhole):
    """Saves each of the `Outputs`, and prints its row of the summary. isWhole : see `Writer`"""
    for name, writer in list(outputs.writers.items()):
        with outputs.reporting(name):
            writer.save(simulation, isWhole)
            show(f"{writer.label:<17} {writer.summary()}")


def show(text="", end="\n", flush=False):
    """Prints a text. If its reader has gone, as with a closed pipe, the run goes on."""
    with suppress(BrokenPipeError):
        print(text, end=end, flush=flush)


def trace_step(simulation, step, body=None):
    """Simulates up to a step, and prints the events of this one. Returns the exit code.

    step : number ≥ 1; body : index or name of the body whose events are printed, as text, or None
    """
    if step <= simulation.stepCount:
        raise InputError(f"--trace: the first step is {simulation.stepCount + 1}, not {step}")
    index = None if body is None else body_index(simulation.meshes, body)
    events, failure = [], ""
    try:
        for number in progress(range(simulation.stepCount + 1, step + 1)):
            with signals_kept():
                simulation.step(events.append if number == step else None)
    except StateError as error:
        failure = str(error)
    lines = trace_lines(events, simulation.meshes, index)
    if not (lines or failure):
        whose = "" if index is None else f" of {simulation.meshes[index].name}"
        if index is not None and simulation.meshes[index].isFixed:
            whose += ", which is fixed,"
        lines = [f"no events{whose} in step {step}"]
    for line in lines:
        show(line)
    print_error(failure)
    return 3 * bool(failure)


def body_index(meshes, text):
    """Returns the index of a body, given by number or name. Raises InputError."""
    names = [mesh.name for mesh in meshes]
    if text in names:
        return names.index(text)
    if text.isascii() and text.isdecimal() and int(text) < len(names):
        return int(text)
    raise InputError(f"--trace: no body '{short(text)}'; there are 0 to {len(names) - 1}")


@dataclass
class Run:
    """The result of `run_steps`."""

    stepSeconds: list
    stoppedBy: int = 0  # the number of a signal
    failure: str = ""  # the message of a StateError, or where a student's step was stopped


def run_steps(simulation, steps, outputs):
    """Simulates `steps` steps; returns the `Run`, without times for a replay.

    It ends earlier if a signal arrives, a number becomes invalid, or all `Outputs` have failed.
    """
    run = Run([])
    try:
        with signals_kept(), followed_by(simulation, outputs):
            for _ in progress(range(steps)):
                if outputs.haveFailed and not outputs.writers:
                    break
                with signals_kept():
                    simulation.step()
                if simulation.stepSeconds is not None:
                    run.stepSeconds.append(simulation.stepSeconds)
    except StateError as error:
        run.failure = str(error)
    except KeyboardInterrupt as error:  # after a step, or in a student's
        run.stoppedBy, *place = error.args
        if place:
            step, name = simulation.stepCount + 1, SIGNAL_NAMES[run.stoppedBy]
            run.failure = f"step {step} was stopped by {name}{place[0]}"
    return run


def progress(steps):
    """Returns an iterator over steps that shows a progress bar in a terminal."""
    return tqdm(steps, unit="step", leave=False, disable=None if sys.stderr else True)


def summarise(simulation, run, begin):
    """Returns the summary of a run. begin : its `state_summary` at the start"""
    rows = {"scene": shown_path(simulation.scenePath)} | state_summary(simulation)
    for name in ("kinetic energy", "potential energy"):
        rows[name] = f"{begin[name]} at the start, {rows[name]} now"
    if run.stoppedBy:
        rows["steps"] += f", stopped by {SIGNAL_NAMES[run.stoppedBy]}"
    elif run.failure:
        rows["steps"] += ", stopped by an error"
    if run.stepSeconds:
        median, total = statistics.median(run.stepSeconds), sum(run.stepSeconds)
        rows["time per step"] = f"{1e3 * median:.2f} ms median, {total:.1f} s in total"
    if (beside := simulation.beside) is not None:
        rows["beside ours"] = "no difference" + " before that" * bool(run.failure)
        if (found := beside.difference) is not None:
            lines = [f"step {found.step}", *found.lines(beside.ours.meshes)[:2]]
            rows |= {"beside ours": ", ".join(lines), "hint": found.hint}
        rows["remark"] = beside.remark
    return "\n".join(f"{name:<17} {value}" for name, value in rows.items() if value)


def state_summary(simulation):
    """Returns the present state of a simulation in words: dict from row to text."""
    fixedCount = sum(mesh.isFixed for mesh in simulation.meshes)
    constraints, kept = "none", "ignored"
    if simulation.constraints:
        if simulation.settings.enforceConstraints:
            kept = f"violated by at most {simulation.largest_violation():.3g} m"
        constraints = f"{len(simulation.constraints)} bounds, {kept}"
    timeStep = simulation.settings.timeStep
    return {
        "bodies": f"{len(simulation.meshes)} ({fixedCount} fixed)",
        "constraints": constraints,
        "steps": f"{simulation.stepCount} of {timeStep:g} s: {simulation.time:.6g} s simulated",
        "kinetic energy": measured(simulation.kinetic_energy(), "J", digits=6),
        "potential energy": measured(simulation.potential_energy(), "J", digits=6),
    }
