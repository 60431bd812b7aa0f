"""Runs without a window: stepping, what watches it, and the summary at its end.

From the top: `run_without_window`; stepping, with its progress; signals; the summary.

Units: metres, kilograms, seconds.
"""

import signal
import statistics
from contextlib import contextmanager
from dataclasses import dataclass

from tqdm import tqdm

from rbs.scenes.messages import print_error, shown_path
from rbs.stepping.bodies import StateError

# What people call the signals that ask a program to end. Windows has no SIGHUP.
SIGNAL_NAMES = {
    getattr(signal, name): text
    for name, text in {"SIGINT": "Ctrl-C", "SIGTERM": "kill", "SIGHUP": "a hang-up"}.items()
    if hasattr(signal, name)
}
# Of what is told of energies, from the largest on.
ENERGY_UNITS = {"TJ": 1e12, "GJ": 1e9, "MJ": 1e6, "kJ": 1e3}


def run_without_window(simulation, steps, writers=()):
    """Runs, writes what is asked for and prints the summary; returns the exit code.

    writers : each has add(simulation), called at the start and after every step; then
        save(simulation) and summary(simulation), the name and text of a row; see `Recorder`
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
        return 3
    return 128 + run.stoppedBy if run.stoppedBy else 0


@dataclass
class Run:
    """What `run_steps` measured."""

    stepSeconds: list
    stoppedBy: int = 0  # a signal's number
    failure: str = ""  # of a StateError


def run_steps(simulation, steps, observers=()):
    """Simulates `steps` steps, or fewer if a signal asks for the end or a number goes wrong.

    observers : functions of the simulation, called at its start and after every step
    returns a Run; of a replay, which measures nothing, its times are empty
    """
    run = Run([])
    with signals_noted() as noted, step_progress(steps) as advance:
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
            if simulation.stepSeconds is not None:
                run.stepSeconds.append(simulation.stepSeconds)
            for observe in observers:
                observe(simulation)
            advance()
    return run


@contextmanager
def step_progress(steps):
    """Shows in a terminal how far a run has come; yields a function to call after every step."""
    with tqdm(total=steps, unit="step", leave=False, disable=None) as progress:
        yield progress.update


@contextmanager
def signals_handled(handle):
    """Within it, Ctrl-C, kill and a hang-up call handle(number, frame); nohup is respected."""
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
def signals_noted():
    """Within it, signals are noted in the list that it yields, so that a run ends after its step.

    The second one raises KeyboardInterrupt, in case a step never ends.
    """
    noted = []

    def note(number, frame):
        if noted:
            raise KeyboardInterrupt(number)
        noted.append(number)

    with signals_handled(note):
        yield noted


def interrupt(number, frame):
    """Handles any signal as Python handles Ctrl-C; the exception's argument is the number."""
    raise KeyboardInterrupt(number)


def summarise(simulation, run, startEnergies):
    """The lines that a run without a window ends with. startEnergies : (kinetic, potential) in J"""
    meshes = simulation.meshes
    fixedCount = sum(mesh.isFixed for mesh in meshes)
    kinetic, potential = startEnergies
    y, lowestName = simulation.lowest_point()
    stepTime = "a recording" if simulation.isReplay else "no step was made"
    if run.stepSeconds:
        median = statistics.median(run.stepSeconds)
        stepTime = f"{1e3 * median:.2f} ms median, {sum(run.stepSeconds):.1f} s in total"
    where = f"y = {y:.4g} m ({lowestName})" if meshes else "none"
    rows = {
        "scene": shown_path(simulation.scenePath),
        "bodies": f"{len(meshes)}, {fixedCount} of them fixed",
        "constraints": constraint_summary(simulation),
        "steps": f"{simulation.stepCount} of {simulation.settings.timeStep:g} s: "
        f"{simulation.time:.6g} s simulated"
        + (f", stopped by {SIGNAL_NAMES[run.stoppedBy]}" if run.stoppedBy else "")
        + ", stopped by an error" * bool(run.failure),
        "time per step": stepTime,
        "kinetic energy": f"{shown_energy(kinetic)} at the start, "
        f"{shown_energy(simulation.kinetic_energy())} now",
        "potential energy": f"{shown_energy(potential)} at the start, "
        f"{shown_energy(simulation.potential_energy())} now",
        "lowest point": where,
        "numbers": "all finite" if simulation.is_finite() else "NOT ALL FINITE",
    }
    return "\n".join(f"{name:<17} {value}" for name, value in rows.items())


def shown_energy(energy):
    """An energy, given in J, in the unit that leaves one to three digits before the point."""
    for unit, size in ENERGY_UNITS.items():
        if abs(energy) >= size:
            return f"{energy / size:.6g} {unit}"
    return f"{energy:.6g} J"


def constraint_summary(simulation):
    """How many constraints there are, and how far the one that is off most is off."""
    if not simulation.constraints:
        return "none"
    count = f"{len(simulation.constraints)} bounds"
    if not simulation.settings.enforceConstraints:
        return f"{count}, left out"
    return f"{count}, violated by at most {simulation.largest_violation():.3g} m"
