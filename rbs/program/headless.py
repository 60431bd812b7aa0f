"""Runs without a window: stepping, signals, and the summary at the end.

From the top: `run_without_window`; stepping, with its progress; signals; the summary.

Units: metres, kilograms, seconds.
"""

import signal
import statistics
import threading
from contextlib import contextmanager
from dataclasses import dataclass

from tqdm import tqdm

from rbs.scenes.messages import print_error, shown_path
from rbs.stepping.bodies import StateError

# Names of the signals that ask a program to end, for messages. Windows has no SIGHUP.
SIGNAL_NAMES = {
    getattr(signal, name): text
    for name, text in {"SIGINT": "Ctrl-C", "SIGTERM": "kill", "SIGHUP": "a hang-up"}.items()
    if hasattr(signal, name)
}
# Seconds that a student's step may take after the first signal.
PATIENCE = 2.0
# Joules per unit, from the largest unit down.
ENERGY_UNITS = {"TJ": 1e12, "GJ": 1e9, "MJ": 1e6, "kJ": 1e3}


def run_without_window(simulation, steps, writers=()):
    """Runs a simulation, writes its outputs and prints the summary. Returns the exit code.

    Parameters
    ----------
    writers : list
        Each has `add(simulation)`, called at the start and after every step, then
        `save(simulation)` and `summary(simulation)`, the name and text of a row. See `Recorder`.
    """
    startEnergies = simulation.kinetic_energy(), simulation.potential_energy()
    run = run_steps(simulation, steps, [writer.add for writer in writers])
    for writer in writers:
        writer.save(simulation)
    print(summarise(simulation, run, startEnergies))
    for writer in writers:
        print("{:<17} {}".format(*writer.summary(simulation)))
    if run.failure:
        print_error(run.failure)
        return 128 + run.stoppedBy if run.stoppedBy else 3
    return 128 + run.stoppedBy if run.stoppedBy else 0


@dataclass
class Run:
    """The result of `run_steps`."""

    stepSeconds: list
    stoppedBy: int = 0  # the number of a signal
    failure: str = ""  # the message of a StateError, or where a student's step was stopped


def run_steps(simulation, steps, observers=()):
    """Simulates `steps` steps, or fewer if a signal arrives or a number becomes invalid.

    Parameters
    ----------
    observers : functions of the simulation, called at its start and after every step

    Returns
    -------
    Run
        Its times are empty for a replay.
    """
    run, hasStudents = Run([]), getattr(simulation, "submitted", None) is not None
    with signals_noted(PATIENCE if hasStudents else None) as noted, step_progress(steps) as advance:
        for observe in observers:
            observe(simulation)
        for _ in range(steps):
            if noted:
                run.stoppedBy = noted[0]
                break
            try:
                simulation.step()
            except StateError as error:
                run.failure = str(error)
                break
            except KeyboardInterrupt as error:
                if not hasStudents:
                    raise
                run.stoppedBy = noted[0]
                step, name = simulation.stepCount + 1, SIGNAL_NAMES[noted[0]]
                run.failure = f"step {step} was stopped by {name}{error.args[-1]}"
                break
            if simulation.stepSeconds is not None:
                run.stepSeconds.append(simulation.stepSeconds)
            for observe in observers:
                observe(simulation)
            advance()
    return run


@contextmanager
def step_progress(steps):
    """Shows a progress bar in a terminal. Yields a function to call after every step."""
    with tqdm(total=steps, unit="step", leave=False, disable=None) as progress:
        yield progress.update


@contextmanager
def signals_handled(handle):
    """Makes Ctrl-C, kill and a hang-up call handle(number, frame). Respects nohup."""
    before = {number: signal.getsignal(number) for number in SIGNAL_NAMES}
    for number, handler in before.items():
        if handler != signal.SIG_IGN or number == signal.SIGINT:
            signal.signal(number, handle)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def signals_noted(patience=None):
    """Yields a list that collects the numbers of signals, so that a run can end after its step.

    A second signal raises KeyboardInterrupt, in case a step never ends. It comes by itself after
    `patience` seconds, if they are given.
    """
    noted, again = [], None

    def note(number, frame):
        nonlocal again
        if noted:
            raise KeyboardInterrupt(number)
        noted.append(number)
        if patience is not None:
            again = threading.Timer(patience, signal.raise_signal, [number])
            again.daemon = True
            again.start()

    with signals_handled(note):
        try:
            yield noted
        finally:
            if again is not None:
                again.cancel()


def interrupt(number, frame):
    """Signal handler: raises KeyboardInterrupt with the signal's number."""
    raise KeyboardInterrupt(number)


def summarise(simulation, run, startEnergies):
    """Returns the summary of a run. startEnergies : (kinetic, potential) in J"""
    meshes = simulation.meshes
    fixedCount = sum(mesh.isFixed for mesh in meshes)
    kinetic, potential = startEnergies
    y, lowestName = simulation.lowest_point()
    stepTime = "none (a recording)" if simulation.isReplay else "no step was made"
    if run.stepSeconds:
        median = statistics.median(run.stepSeconds)
        stepTime = f"{1e3 * median:.2f} ms median, {sum(run.stepSeconds):.1f} s in total"
    where = f"y = {y:.4g} m ({lowestName})" if meshes else "none"
    rows = {
        "scene": shown_path(simulation.scenePath),
        "bodies": f"{len(meshes)} ({fixedCount} fixed)",
        "constraints": constraint_summary(simulation),
        "steps": f"{simulation.stepCount} of {simulation.settings.timeStep:g} s: "
        f"{simulation.time:.6g} s simulated"
        + (f", stopped by {SIGNAL_NAMES[run.stoppedBy]}" if run.stoppedBy else "")
        + ", stopped by an error" * bool(run.failure and not run.stoppedBy),
        "time per step": stepTime,
        "kinetic energy": f"{shown_energy(kinetic)} at the start, "
        f"{shown_energy(simulation.kinetic_energy())} now",
        "potential energy": f"{shown_energy(potential)} at the start, "
        f"{shown_energy(simulation.potential_energy())} now",
        "lowest point": where,
        "state": "all values finite" if simulation.is_finite() else "NOT ALL VALUES FINITE",
    }
    return "\n".join(f"{name:<17} {value}" for name, value in rows.items())


def shown_energy(energy):
    """Returns an energy in J as text, with one to three digits before the point."""
    for unit, size in ENERGY_UNITS.items():
        if abs(energy) >= size:
            return f"{energy / size:.6g} {unit}"
    return f"{energy:.6g} J"


def constraint_summary(simulation):
    """Returns the number of constraint bounds and the largest violation, as text."""
    if not simulation.constraints:
        return "none"
    count = f"{len(simulation.constraints)} bounds"
    if not simulation.settings.enforceConstraints:
        return f"{count}, ignored"
    return f"{count}, violated by at most {simulation.largest_violation():.3g} m"
