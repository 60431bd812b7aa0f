"""The program, which simulates a scene in a window or without one, and the loaders.

    python RigidBodySimulation.py mixed                 opens a window
    python RigidBodySimulation.py mixed --headless      needs no display and no OpenGL

The loaders have the coursework's names: `load_scene_file`, `load_mesh_file`, `load_constraint_file`
and `flatten_meshes`. Polyscope is imported only if something is drawn.

Units: metres, kilograms, seconds. The y axis points up and the ground is the plane y = 0.
"""

from rbs.scenes.messages import COMMAND, PROGRAM_NAME, open_streams, prepare

if __name__ == "__main__" or PROGRAM_NAME == COMMAND:
    prepare()

import math
import os
import signal
import warnings
from contextlib import closing
from functools import partial
from pathlib import Path

from rbs.appearance.camera import PictureOptions
from rbs.appearance.drawables import flatten_meshes
from rbs.pictures.backends import find_backend
from rbs.pictures.drawing import frames_of, picture_options, start_drawing
from rbs.program import headless, options as commandLine
from rbs.program.options import given_values
from rbs.program.pythoninterface import Simulation
from rbs.program.submittedsteps import SubmittedSteps
from rbs.recordings.encoder import PictureSeries
from rbs.recordings.lookup import SceneOpener
from rbs.recordings.outputs import Outputs
from rbs.recordings.recording import Recording
from rbs.recordings.replay import Replay, resume, verify
from rbs.recordings.writers import OUTPUTS
from rbs.scenes import files, scenefiles, shapes
from rbs.scenes.meshfiles import NonConvexWarning, load_mesh_file
from rbs.scenes.messages import InputError, print_error, shown_path
from rbs.scenes.scene import steps_of_run
from rbs.scenes.scenefiles import load_body, load_constraint_file, load_scene_file
from rbs.scenes.settingtexts import changed_settings, note_recommended
from rbs.stepping.settings import SETTINGS, Settings
from RBSFunctions import Mesh, ground, run_timestep

# Names for Python programs.
__all__ = ["Mesh", "Settings", "Simulation", "ground", "load_body", "main", "run_timestep"]
__all__ += ["flatten_meshes", "load_constraint_file", "load_mesh_file", "load_scene_file", "shapes"]

# Largest number of pictures that are drawn instead of a window if there is no display.
FALLBACK_PICTURES = 5


def main(arguments: list[str] | None = None) -> int:
    """Runs the command line.

    Returns the exit code: 0; 1 if --verify finds a difference; 2 for bad input, or if an output
    cannot be written; 3 if a number of a run becomes invalid; 130 after Ctrl-C; 143 after kill.
    """
    open_streams()
    options = commandLine.parse_options(arguments)
    with warnings.catch_warnings(), files.signals_raised():
        warnings.simplefilter("always", NonConvexWarning)
        warnings.showwarning = lambda message, *where: print_error(f"warning: {message}")
        try:
            with files.signals_kept():
                return run_mode(options)
        except Outputs.errors as error:
            print_error(error)
        except KeyboardInterrupt as error:
            number, *place = error.args or (signal.SIGINT,)
            print_error(f"stopped by {files.SIGNAL_NAMES[number]}{''.join(place)}")
            return 128 + number
    return 2


def program():
    """Runs `main`, and ends the process in spite of threads and exit handlers of a student."""
    code = main()
    try:
        headless.show(end="", flush=True)
    except OSError as error:
        print_error(error)
        code = 2
    os._exit(code)


def run_mode(options):
    """Runs the mode that the options select. Returns the exit code."""
    submitted = options.functions and SubmittedSteps(options.functions)
    if options.verify is not None:
        return run_verify(options, submitted)
    isBasic = bool(options.basic or options.functions)
    opener = SceneOpener(given_values(options, SETTINGS), isBasic, submitted, SubmittedSteps)
    simulation = simulation_of(options, opener, submitted)
    if submitted and (lacking := submitted.lacking(simulation.settings)):
        raise InputError(lacking)
    inputs = [one for one in (options.replay, options.resume, options.camera) if one]
    outputs = {f"--{name}": path for name, path in given_values(options, OUTPUTS).items()}
    files.check_outputs(outputs, inputs + simulation.source.files())
    pictureOptions = picture_options(given_values(options, vars(PictureOptions())))
    if options.trace is not None:
        return headless.trace_step(simulation, *options.trace)
    if commandLine.is_without_window(options):
        return run_outputs(simulation, options, pictureOptions)
    return run_window(simulation, options, pictureOptions, opener)


def run_window(simulation, options, pictureOptions, opener):
    """Opens the window or, if there is no display, draws pictures. Returns the exit code."""
    backend, every = find_backend(window=True), None
    if backend.opensWindow:
        with files.interrupts_held():  # raised while Polyscope is loaded, they would abort it
            from rbs.window.panel import show_window

        note_recommended(simulation)
        show_window(simulation, backend, opener, pictureOptions)
        return 0
    if backend.name is None:
        print_error(f"no window and no pictures: {backend.reason}. {backend.remedy}")
    else:
        options.screenshots = Path("out") / scenefiles.scene_name(simulation.scenePath)
        print_error(f"no window: {backend.reason}. Drawing off-screen into {options.screenshots}")
        every = max(1, math.ceil(steps_of_run(simulation, options.steps) / (FALLBACK_PICTURES - 1)))
    return run_outputs(simulation, options, pictureOptions, every, backend)


def run_outputs(simulation, options, pictureOptions, every=None, backend=None):
    """Makes the steps and the outputs, without a window. Returns the exit code.

    every : steps between screenshots; backend : a `Backend`, or None to find one if it is needed
    """
    steps, given = steps_of_run(simulation, options.steps), {"export": (pictureOptions.colouring,)}
    with closing(Outputs(print_error)) as outputs:
        if options.screenshots or options.video:
            view = start_drawing(simulation, pictureOptions, backend)
            given["video"] = frames_of(view, options.every)
        if options.screenshots:
            from rbs.pictures.capture import draw_still

            every = every or options.every or commandLine.DEFAULT_EVERY
            drawn = range(simulation.stepCount, simulation.stepCount + steps + 1, every)
            still = partial(draw_still, view)
            outputs.writers["screenshots"] = PictureSeries(options.screenshots, drawn, still)
        for name, path in given_values(options, OUTPUTS).items():
            outputs.writers[name] = OUTPUTS[name].start(path, *given.get(name, ()))
        note_recommended(simulation)
        return headless.run_without_window(simulation, steps, outputs)


def simulation_of(options, opener, submitted):
    """Returns the simulation or replay that the options select, from a SceneOpener."""
    if options.replay is not None:
        return Replay(Recording(options.replay))
    if options.resume is not None:
        recording = Recording(options.resume)
        step = recording.lastStep if options.from_step is None else options.from_step
        simulation = resume(recording, step, submitted=submitted)
        given = given_values(options, SETTINGS)
        simulation.settings = changed_settings(simulation.settings, given)
        return simulation
    scene = options.scene or commandLine.DEFAULT_SCENE
    return opener.simulation(scenefiles.find_scene(scene), options.constraints, isFirst=True)


def run_verify(options, submitted):
    """Runs --verify. Returns the exit code, 0 or 1. Raises RecordingError."""
    recording = Recording(options.verify)
    with headless.progress(range(recording.lastStep - recording.firstStep)) as steps:
        wrong = verify(recording, steps.update, submitted)
    path = shown_path(recording.path)
    if wrong:
        print_error(f"{path}: {wrong}")
        return 1
    print(f"{path}: steps {recording.firstStep}–{recording.lastStep} are identical, bit for bit")
    return 0


if __name__ == "__main__":
    program()
