"""The program: simulates a scene, in a window or without one.

    python RigidBodySimulation.py mixed                 opens a window
    python RigidBodySimulation.py mixed --headless      needs no display and no OpenGL

Here are also the loaders, by the names that they are known by: `load_scene_file`, `load_mesh_file`,
`load_constraint_file` and `flatten_meshes`. What draws, and with it Polyscope, is imported only
when something is to be seen.

Units: metres, kilograms, seconds. The y axis points up and the ground is the plane y = 0.
"""

import os
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from rbs.backends import find_backend
from rbs.drawables import flatten_meshes
from rbs.files import files_noted
from rbs.headless import run_without_window, step_progress
from rbs.interrupts import (
    Interrupt,
    breakable,
    ignore_signals,
    signals_left_alone,
    signals_watched,
    watch_signals,
)
from rbs.meshfiles import load_mesh_file
from rbs.messages import InputError, drop_stream, print_error, reason_of, shown_path
from rbs.opening import (
    changed_files,
    list_files,
    load_recorded_scene,
    open_recording,
    tell_changes,
)
from rbs.options import (
    DEFAULT_EVERY,
    DEFAULT_SCENE,
    DEFAULT_STEPS,
    SETTING_FIELDS,
    STEP_PARAMETERS,
    WITHOUT_WINDOW,
    check_options,
    follows_suggestions,
    given_options,
    make_parser,
    option_name,
    settings_of,
)
from rbs.pictureoptions import FASTEST_ENCODER, SLOWEST_VIDEO, PictureOptions, video_timing
from rbs.recording import Recorder, finish
from rbs.replay import Replay, resume, verify
from rbs.scenes import (
    NonConvexWarning,
    find_scene,
    load_constraint_file,
    load_scene_file,
    scene_name,
)
from rbs.simulation import Simulation
from rbs.statistics import StatsWriter, step_quantities
from rbs.submittedsteps import SubmittedSteps
from rbs.suggestions import SceneOpener, suggested_settings, tell_suggestion

# The loaders, by the names that they are known by.
__all__ = ["flatten_meshes", "load_constraint_file", "load_mesh_file", "load_scene_file", "main"]

# What the program draws where it was asked for a window and there is no display.
FALLBACK_PICTURES = 5


def main(arguments=None):
    """Runs the command line.

    returns the exit code: 0, 1 where --verify finds a difference, 2 for bad input, 3 where the
    numbers of a run go wrong, 130 after Ctrl-C, 143 after kill
    """
    parser = make_parser()
    options = parser.parse_args(arguments)
    given = given_options(arguments)
    with warnings.catch_warnings(), signals_watched(), files_noted():
        warnings.simplefilter("always", NonConvexWarning)
        warnings.showwarning = lambda message, *where: print_error(f"warning: {message}")
        if hasattr(sys.stdout, "reconfigure"):  # a name may hold what the terminal has no sign for
            sys.stdout.reconfigure(errors="backslashreplace")
        try:
            check_options(parser, options, given)
            code = run_asked_mode(options, given)
            if sys.stdout is not None:  # it was closed before the start
                sys.stdout.flush()
            return code
        except (InputError, ImportError) as error:
            print_error(with_what_is_kept(error, error))
        except OSError as error:
            cause = f"{error.filename or 'cannot write'}: {reason_of(error)}"
            print_error(with_what_is_kept(cause, error))
            discard_output()
        except MemoryError as error:
            print_error(with_what_is_kept("there is not enough memory", error))
        except Interrupt as error:
            print_error(with_what_is_kept(error, error))
            return error.exitCode
        except KeyboardInterrupt as error:  # where signals are not watched: in the window
            print_error(with_what_is_kept("stopped by Ctrl-C", error))
            return 130
    return 2


def run_asked_mode(options, given):
    """What the command line asks for; returns the exit code."""
    if options.finish is not None:
        return finish_as_asked(options)
    if options.verify is not None:
        with breakable():
            return verify_as_asked(options)
    with breakable():
        if options.functions is not None:
            steps = SubmittedSteps(options.functions, load_mesh_file)
            steps.check_options({option_name(one): STEP_PARAMETERS[one]
                                 for one in STEP_PARAMETERS if one in given})  # fmt: skip
            steps.replace_those_of(Simulation)
        simulation = simulation_of(options, given)
        pictureOptions = picture_options_of(options)
    if given & WITHOUT_WINDOW:
        return run_as_asked(simulation, options, pictureOptions)
    follows = follows_suggestions(given)
    opener = SceneOpener(simulation.settings, follows, options.allow_outside_meshes)
    return open_window_or_fall_back(simulation, options, pictureOptions, opener)


def simulation_of(options, given):
    """The Simulation, or Replay, that the command line asks for."""
    if options.replay is not None:
        recording = open_recording(options.replay)
        scene = scene_of(recording, options)
        tell_changes(recording, scene)
        return Replay(recording, scene)
    if options.resume is not None:
        recording = open_recording(options.resume)
        simulation = scene_of(recording, options)
        if changed := changed_files(recording, simulation):
            raise recording.error(f"{changed}, so it cannot be gone on with")
        step = recording.lastStep if options.from_step is None else options.from_step
        resume(recording, step, simulation)
        asked = settings_of(options)
        changes = {field: getattr(asked, field)
                   for name, field in SETTING_FIELDS.items() if name in given}  # fmt: skip
        try:
            simulation.settings = replace(simulation.settings, **changes)
        except ValueError as error:  # of what was recorded and what is asked for now
            raise InputError(str(error)) from None
        return simulation
    scenePath = find_scene(DEFAULT_SCENE if options.scene is None else options.scene)
    simulation = Simulation(
        scenePath, settings_of(options), options.constraints,
        allowOutsideMeshes=options.allow_outside_meshes,
    )  # fmt: skip
    if follows_suggestions(given):
        simulation.settings, simulation.suggestion = suggested_settings(scenePath)
        simulation.startSettings = replace(simulation.settings)
    return simulation


def scene_of(recording, options):
    """The Simulation of a recording's scene, whose files may be where the options say."""
    return load_recorded_scene(
        recording, options.scene, options.constraints, options.allow_outside_meshes
    )


def run_as_asked(simulation, options, pictureOptions):
    """A run without a window, with what is to be written of it; returns the exit code."""
    recorder = stats = pictures = video = None
    steps = steps_of(simulation, options)
    timing = None if options.video is None else video_timing_of(simulation, options)
    try:
        if options.record is not None:
            recorder = Recorder(options.record)
        if options.stats is not None or options.plot is not None:
            stats = StatsWriter(options.stats, options.plot)
        if options.screenshots is not None or options.video is not None:
            from rbs.pictures import PictureSeries, Video, start_view

            backend = find_backend(window=False)
            if backend.name is None:
                print_error(f"no pictures can be drawn: {backend.reason}. {backend.remedy}")
                return 2
            view = start_view(simulation, backend, pictureOptions)
        if options.screenshots is not None:
            first = simulation.stepCount
            drawn = range(first, first + steps + 1, options.every or DEFAULT_EVERY)
            pictures = PictureSeries(options.screenshots, drawn, view, options.transparent)
        if options.video is not None:
            video = Video(options.video, view, *timing)
        tell_suggestion(simulation)
        return run_without_window(simulation, steps, recorder, stats, pictures, video)
    except BaseException as error:
        kept = close_all(recorder, stats, video)
        error.keptPaths = [str(shown_path(path)) for path in kept if path is not None]
        raise
    finally:
        close_all(recorder, stats, video)


def open_window_or_fall_back(simulation, options, pictureOptions, opener):
    """The window; without a display, pictures; without OpenGL, only the simulation.

    opener : a SceneOpener, for what is opened in the window

    returns the exit code
    """
    with breakable():
        backend = find_backend(window=True)
    if backend.opensWindow:
        from rbs.viewer import show_window

        tell_suggestion(simulation)
        with signals_left_alone():
            show_window(
                simulation, backend, opener, list_files, step_quantities, pictureOptions
            )
        return 0
    pictures = None
    if backend.name is None:
        print_error(f"no window and no pictures: {backend.reason}. {backend.remedy}")
    else:
        from rbs.pictures import PictureSeries, start_view

        folder = Path("out") / scene_name(simulation.scenePath)
        print_error(f"no window: {backend.reason}. Drawing off-screen into {folder}")
        first, last = simulation.stepCount, simulation.stepCount + steps_of(simulation, options)
        steps = np.linspace(first, last, FALLBACK_PICTURES).round().astype(int).tolist()
        view = start_view(simulation, backend, pictureOptions)
        pictures = PictureSeries(folder, steps, view)
    tell_suggestion(simulation)
    return run_without_window(simulation, steps_of(simulation, options), pictures=pictures)


def finish_as_asked(options):
    """--finish; returns the exit code, 0."""
    path, first, last = finish(options.finish)
    steps = f"the steps {first} to {last}, of an interrupted recording"
    if last < first:
        steps = "the run had ended before anything was recorded, and its folder is removed"
    print(f"{shown_path(path)}: {steps}")
    return 0


def verify_as_asked(options):
    """--verify; returns the exit code, 0 or 1."""
    recording = open_recording(options.verify, mustBeFinite=False)
    simulation = scene_of(recording, options)
    wrong = changed_files(recording, simulation)
    if not wrong:
        with step_progress(recording.lastStep - recording.firstStep) as advance:
            wrong = verify(recording, simulation, advance)
    path = shown_path(recording.path)
    if not wrong:
        print(f"{path}: the steps {recording.firstStep} to {recording.lastStep} are the same")
        return 0
    if recording.numpyVersion != np.__version__:
        wrong += f" (recorded with NumPy {recording.numpyVersion}, this is {np.__version__})"
    print_error(f"{path}: {wrong}")
    return 1


def picture_options_of(options):
    """The `PictureOptions` that the command line asks for; raises CameraError."""
    camera = None
    if options.camera is not None:
        from rbs.cameras import load_camera

        camera = load_camera(options.camera)
    return PictureOptions(
        options.size, camera, options.transparent, options.colours, tuple(options.show or ()),
        options.legend,
    )


def video_timing_of(simulation, options):
    """(pictures a second, steps between two) of the video; raises InputError where it has none."""
    rate, every = video_timing(simulation.settings.timeStep, options.fps, options.every)
    if not SLOWEST_VIDEO <= rate <= FASTEST_ENCODER:
        raise InputError(
            f"{options.video}: in real time there would be {rate:.3g} pictures a second; "
            "say with --fps how many there shall be"
        )
    return rate, every


def steps_of(simulation, options):
    """How many steps a run without a window makes: of a replay, no more than were recorded."""
    if isinstance(simulation, Replay):
        left = simulation.lastStep - simulation.stepCount
        return left if options.steps is None else min(left, options.steps)
    return DEFAULT_STEPS if options.steps is None else options.steps


def close_all(*writers):
    """Closes those that are not None; returns the paths of what they keep, or None of each."""
    return [writer.close() for writer in writers if writer is not None]


def with_what_is_kept(message, error):
    """The message, and where to find what there is of the run that the error has ended."""
    kept = getattr(error, "keptPaths", ())
    return f"{message}; what there is of the run is in {' and '.join(kept)}" if kept else message


def discard_output():
    """Drops what standard output could not take: at its end, Python would try, and fail, again."""
    if sys.stdout is None:
        return
    try:
        sys.stdout.flush()
    except OSError:
        drop_stream(sys.stdout)


def command():
    """The program as a process of its own; ends it.

    Signals are watched to its very end, and a standard stream that is closed is opened to nowhere:
    else the next file that is opened would be in its place, and get what libraries print.
    """
    watch_signals()
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    code = main()
    ignore_signals()
    sys.exit(code)


if __name__ == "__main__":
    command()
