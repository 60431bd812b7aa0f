"""The program, which simulates a scene in a window or without one, and the loaders.

    python RigidBodySimulation.py mixed                 opens a window
    python RigidBodySimulation.py mixed --headless      needs no display and no OpenGL

The loaders have the coursework's names: `load_scene_file`, `load_mesh_file`, `load_constraint_file`
and `flatten_meshes`. Polyscope is imported only if something is drawn.

Units: metres, kilograms, seconds. The y axis points up and the ground is the plane y = 0.
"""

import signal
import sys
import warnings
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np

from rbs.appearance.camerafiles import load_camera
from rbs.appearance.drawables import flatten_meshes
from rbs.appearance.pictureoptions import (
    FASTEST_ENCODER,
    SLOWEST_VIDEO,
    PictureOptions,
    video_timing,
)
from rbs.geometry.surfaces import NonConvexWarning
from rbs.pictures.backends import find_backend
from rbs.program import headless, options as commandLine
from rbs.program.options import given_settings
from rbs.program.pythoninterface import Simulation
from rbs.program.submittedsteps import SubmittedSteps
from rbs.recordings.formats import export_writer
from rbs.recordings.lookup import SceneOpener, open_replay
from rbs.recordings.recording import Recorder, Recording
from rbs.recordings.replay import resume, verify
from rbs.recordings.statistics import PlotWriter, StatsWriter
from rbs.scenes import scenefiles
from rbs.scenes.files import check_outputs
from rbs.scenes.meshfiles import load_mesh_file
from rbs.scenes.messages import InputError, print_error, shown_path
from rbs.scenes.scenefiles import load_body, load_constraint_file, load_scene_file
from rbs.scenes.simulation import SceneSimulation
from rbs.scenes.suggestions import apply_settings, note_recommended
from rbs.stepping.settings import IgnoredSetting, Settings
from RBSFunctions import Mesh, ground, run_timestep

# Names for Python programs. The loaders have the coursework's names.
__all__ = ["Mesh", "Settings", "Simulation", "ground", "load_body", "main", "run_timestep"]
__all__ += ["flatten_meshes", "load_constraint_file", "load_mesh_file", "load_scene_file"]

# Number of pictures that are drawn instead of a window if there is no display.
FALLBACK_PICTURES = 5


def main(arguments: list[str] | None = None) -> int:
    """Runs the command line.

    Returns the exit code: 0; 1 if --verify finds a difference; 2 for bad input, or if an output
    cannot be written; 3 if a number of a run becomes invalid; 130 after Ctrl-C; 143 after kill.
    """
    options = commandLine.parse_options(arguments)
    with warnings.catch_warnings(), headless.signals_handled(headless.interrupt):
        warnings.simplefilter("always", NonConvexWarning)
        warnings.showwarning = lambda message, *where: print_error(f"warning: {message}")
        if hasattr(sys.stdout, "reconfigure"):  # the terminal may lack characters of a name
            sys.stdout.reconfigure(errors="backslashreplace")
        try:
            return run_mode(options)
        except headless.EXPECTED_ERRORS as error:
            print_error(headless.message_of(error))
        except KeyboardInterrupt as error:
            number = error.args[0] if error.args else signal.SIGINT
            where = error.args[1] if len(error.args) > 1 else ""
            print_error(f"stopped by {headless.SIGNAL_NAMES[number]}{where}")
            return 128 + number
    return 2


def run_mode(options):
    """Runs the mode that the options select. Returns the exit code."""
    submitted = submitted_steps(options)
    if options.verify is not None:
        return run_verify(options, submitted)
    simulation = simulation_of(options, submitted)
    outputs = [one for one in "record stats plot video export".split() if one in options]
    inputs = [one for one in (options.replay, options.resume, options.camera) if one]
    check_outputs(
        {commandLine.option_name(one): getattr(options, one) for one in outputs},
        inputs + simulation.source.files(),
    )
    pictureOptions = picture_options_of(options)
    if options.trace is not None:
        return headless.trace_step(simulation, *options.trace)
    if commandLine.WITHOUT_WINDOW & set(options):
        return run_headless(simulation, options, pictureOptions)
    choices = given_settings(options), ignores_recommendations(options)
    opener = SceneOpener(*choices, options.allow_outside_meshes, submitted)
    return open_window_or_fall_back(simulation, options, pictureOptions, opener)


def submitted_steps(options):
    """Returns the SubmittedSteps of --functions, or None. Raises SubmissionError."""
    if options.functions is None:
        return None
    # the coursework's run_timestep has no broad phase
    inOurLoop = bool(options.our_loop) or "broad_phase" in options
    submitted = SubmittedSteps(options.functions, inOurLoop, options.set or ())
    used = [item for item in commandLine.SETTING_OPTIONS.items() if item[0] in options]
    submitted.check_options({commandLine.option_name(dest): one.parameter for dest, one in used})
    return submitted


def simulation_of(options, submitted):
    """Returns the Simulation or Replay that the options select.

    submitted : SubmittedSteps of a simulation, or None
    """
    if options.replay is not None:
        return open_replay(options.replay)
    if options.resume is not None:
        recording = Recording(options.resume)
        step = recording.lastStep if options.from_step is None else options.from_step
        simulation = resume(recording, step, submitted=submitted)
        try:
            simulation.settings = simulation.settings.changed(**given_settings(options))
        except IgnoredSetting as error:
            raise InputError(error.inOptions) from None
        return simulation
    simulation = SceneSimulation(
        scenefiles.find_scene(options.scene or commandLine.DEFAULT_SCENE),
        constraintPath=options.constraints,
        allowOutsideMeshes=options.allow_outside_meshes,
        submitted=submitted,
    )
    apply_settings(simulation, given_settings(options), ignores_recommendations(options))
    return simulation


def ignores_recommendations(options):
    """Returns whether recommended settings are ignored, as always with --functions."""
    return bool(options.basic or options.functions)


def run_headless(simulation, options, pictureOptions):
    """Runs without a window and writes the outputs. Returns the exit code."""
    steps = simulation.steps_of_run(options.steps)
    timing = None if options.video is None else video_timing_of(simulation, options)
    writers = []
    with ExitStack() as stack:

        def start(writer):
            stack.callback(writer.close)
            writers.append(writer)

        if options.screenshots is not None or options.video is not None:
            backend = find_backend(window=False)
            if backend.name is None:
                print_error(f"cannot draw pictures: {backend.reason}. {backend.remedy}")
                return 2
            if pictureOptions.look == "studio" and backend.opensWindow:
                raise InputError("--look studio needs EGL, which is missing here")
            from rbs.pictures.capture import PictureSeries, Video, start_view

            view = start_view(simulation, backend, pictureOptions)
        if options.screenshots is not None:
            first = simulation.stepCount
            drawn = range(first, first + steps + 1, options.every or commandLine.DEFAULT_EVERY)
            start(PictureSeries(options.screenshots, drawn, view, bool(options.transparent)))
        if options.video is not None:
            if view.studio is not None:
                view.studio.tell_cost(view, steps // timing[1] + 1)
            start(Video(options.video, view, *timing))
        for path, writer in (
            (options.record, partial(Recorder, hasContacts=bool(options.record_contacts))),
            (options.stats, StatsWriter),
            (options.plot, PlotWriter),
            (options.export, partial(export_writer, colouring=pictureOptions.colouring)),
        ):
            if path is not None:
                start(writer(path))
        note_recommended(simulation)
        return headless.run_without_window(simulation, steps, writers)


def open_window_or_fall_back(simulation, options, pictureOptions, opener):
    """Opens the window. Without a display, draws pictures; without OpenGL, only simulates.

    opener : SceneOpener for files opened in the window
    Returns the exit code.
    """
    backend = find_backend(window=True)
    if backend.opensWindow:
        from rbs.window.panel import show_window

        note_recommended(simulation)
        show_window(simulation, backend, opener, pictureOptions)
        return 0
    writers, steps = [], simulation.steps_of_run(options.steps)
    if backend.name is None:
        print_error(f"no window and no pictures: {backend.reason}. {backend.remedy}")
    else:
        from rbs.pictures.capture import PictureSeries, start_view

        folder = Path("out") / scenefiles.scene_name(simulation.scenePath)
        print_error(f"no window: {backend.reason}. Drawing off-screen into {folder}")
        first = simulation.stepCount
        drawn = np.linspace(first, first + steps, FALLBACK_PICTURES).round().astype(int).tolist()
        view = start_view(simulation, backend, pictureOptions)
        writers = [PictureSeries(folder, drawn, view)]
    note_recommended(simulation)
    return headless.run_without_window(simulation, steps, writers)


def run_verify(options, submitted):
    """Runs --verify. Returns the exit code, 0 or 1. Raises RecordingError."""
    recording = Recording(options.verify)
    steps = f"steps {recording.firstStep}–{recording.lastStep}"
    with headless.step_progress(recording.lastStep - recording.firstStep) as advance:
        wrong = verify(recording, advance, submitted)
    path = shown_path(recording.path)
    if not wrong:
        print(f"{path}: {steps} are identical, bit for bit")
        return 0
    print_error(f"{path}: {wrong}{recording.origin()}")
    return 1


def picture_options_of(options):
    """Returns the PictureOptions that the options select. Raises CameraError."""
    dests = {"size": "size", "transparent": "isTransparent", "colours": "colouring"}
    dests |= {"legend": "hasLegend", "look": "look"}
    given = {name: getattr(options, dest) for dest, name in dests.items() if dest in options}
    given["overlays"] = tuple(options.show or ())
    if options.camera is not None:
        given["camera"] = load_camera(options.camera)
    return PictureOptions(**given)


def video_timing_of(simulation, options):
    """Returns (frames per second, steps per frame) of the video. Raises InputError."""
    rate, every = video_timing(simulation.settings.timeStep, options.fps, options.every)
    if not SLOWEST_VIDEO <= rate <= FASTEST_ENCODER:
        raise InputError(
            f"{options.video}: real time would need {rate:.3g} frames per second; choose a rate "
            "with --fps"
        )
    return rate, every


if __name__ == "__main__":
    sys.exit(main())
