"""Runs without a window: stepping, what watches it, and the summary at its end.

From the top: `run_without_window`; stepping, with its progress and Ctrl-C; the summary.

Units: metres, kilograms, seconds.
"""

import statistics
from contextlib import contextmanager
from dataclasses import dataclass

from tqdm import tqdm

from rbs.bodies import StateError
from rbs.interrupts import SIGNAL_NAMES, breakable, exit_code, noted, signals_watched
from rbs.messages import QuietStream, print_error, print_note, shown_path
from rbs.replay import Replay
from rbs.scenes import scene_name
from rbs.simulation import ADVICE_STEP

# Seconds between two updates of the progress: so that it moves in a terminal, and so seldom that
# the log of an hour's run stays readable.
TERMINAL_SECONDS, LOG_SECONDS = 0.1, 10.0

# Of what is told of energies, from the largest on.
ENERGY_UNITS = {"TJ": 1e12, "GJ": 1e9, "MJ": 1e6, "kJ": 1e3}


def run_without_window(simulation, steps, recorder=None, stats=None, pictures=None, video=None):
    """Runs, records, takes pictures and prints the summary; returns the exit code.

    recorder, stats : a Recorder and a StatsWriter, or None
    pictures, video : a PictureSeries and a Video, or None
    """
    helpers = (recorder, stats, pictures, video)
    observers = [helper.add for helper in helpers if helper is not None]
    startEnergies = simulation.kinetic_energy(), simulation.potential_energy()
    run = run_steps(simulation, steps, observers)
    if recorder is not None:
        recorder.save()
    if stats is not None:
        stats.save(f"{scene_name(simulation.scenePath)}, to step {simulation.stepCount}")
    if video is not None:
        video.save()
    print(summarise(simulation, run, startEnergies))
    if pictures is not None:
        print(f"{'pictures':<17} {pictures.count} in {shown_path(pictures.folder)}")
    if video is not None:
        print(f"{'video':<17} {shown_path(video.path)}: {video.summary(simulation)}")
    if recorder is not None:
        print(f"{'recording':<17} {shown_path(recorder.path)}")
    if stats is not None and stats.path is not None:
        print(f"{'statistics':<17} {shown_path(stats.path)}")
    if stats is not None and stats.plotPath is not None:
        print(f"{'plot':<17} {shown_path(stats.plotPath)}")
    if run.failure:
        print_error(run.failure)
        return 3
    return exit_code(run.stoppedBy) if run.stoppedBy else 0


@dataclass
class Run:
    """What `run_steps` measured."""

    stepSeconds: list
    stoppedBy: int = 0  # a signal's number
    failure: str = ""  # of a StateError


def run_steps(simulation, steps, observers=()):
    """Simulates `steps` steps, or fewer when Ctrl-C is pressed or a number goes wrong.

    Ctrl-C, and other signals that ask for the end, do not break into a step, only the second does:
    it raises Interrupt, in case a step never ends.

    observers : functions of the simulation, called at its start and after every step
    returns a Run; of a replay, which measures nothing, its times are empty
    """
    stepSeconds = []
    done = 0
    failure = ""
    with signals_watched(), step_progress(steps) as advance:
        for observe in observers:
            observe(simulation)
        while done < steps and not noted():
            try:
                with breakable(2):
                    simulation.step()
            except StateError as error:
                failure = str(error)
                break
            done += 1
            if simulation.stepSeconds is not None:
                stepSeconds.append(simulation.stepSeconds)
            for observe in observers:
                observe(simulation)
            advance()
            if done == ADVICE_STEP and not isinstance(simulation, Replay):
                print_note(simulation.advice())
        stoppedBy = noted()[0] if noted() and done < steps else 0
    return Run(stepSeconds, stoppedBy, failure)


@contextmanager
def step_progress(steps):
    """Shows how far a run has come, on stderr; yields a function to call after every step.

    What cannot be shown, since stderr is closed or its disk is full, does not end the run.
    """
    stream = QuietStream()
    seconds = TERMINAL_SECONDS if stream.isatty() else LOG_SECONDS
    # Without the delay, it would write as soon as it is made.
    progress = tqdm(
        total=steps, unit="step", leave=False, miniters=1, mininterval=seconds, delay=seconds,
        file=stream,
    )  # fmt: skip
    try:
        yield progress.update
    finally:
        progress.close()


def summarise(simulation, run, startEnergies):
    """The lines that a run without a window ends with. startEnergies : (kinetic, potential) in J"""
    meshes = simulation.meshes
    fixedCount = sum(mesh.isFixed for mesh in meshes)
    kinetic, potential = startEnergies
    y, lowestName = simulation.lowest_point()
    stepTime = "a recording" if isinstance(simulation, Replay) else "no step was made"
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
