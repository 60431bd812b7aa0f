"""The program by subprocess, what it must agree with, recordings made without it, and OpenGL."""

import io
import os
import runpy
import signal
import subprocess
import sys
import time
from contextlib import redirect_stderr, redirect_stdout
from functools import lru_cache

import numpy as np
import pytest
from oracles import ROOT, ground

from rbs.pictures.backends import find_backend
from rbs.recordings.recording import Recorder
from rbs.scenes.state import STATE_NAMES
from RBSFunctions import run_timestep
from RigidBodySimulation import load_scene_file, main

PROGRAM = ROOT / "RigidBodySimulation.py"
DATA = ROOT / "data"
# A camera file's content: it stands at (0, 10, 90) and looks along -z.
CAMERA = {"viewMat": [1, 0, 0, 0, 0, 1, 0, -10, 0, 0, 1, -90, 0, 0, 0, 1], "fov": 20}


def environment(**changes):
    """This process's environment without a display, and with these variables changed."""
    result = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    return result | changes


def python(folder, *words, preexec_fn=None, **changes):
    """Runs Python in a folder, with environment variables changed; the finished process."""
    command, form = [sys.executable, *map(str, words)], {"text": True, "timeout": 600}
    form["preexec_fn"] = preexec_fn
    form |= {"cwd": folder, "env": environment(**changes), "capture_output": True}
    return subprocess.run(command, **form)


def run_script(script, *arguments, cwd="."):
    """Runs a script, but not a student's code, in this process, as `python` does in another."""
    streams = [io.TextIOWrapper(io.BytesIO(), "utf-8") for _ in range(2)]
    handler = signal.getsignal(signal.SIGINT)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(cwd)
        patch.setattr(sys, "argv", [str(script), *map(str, arguments)])
        with redirect_stdout(streams[0]), redirect_stderr(streams[1]):
            with pytest.raises(SystemExit) as ended:
                runpy.run_path(str(script), run_name="__main__")
            code = ended.value.code
            if isinstance(code, str):  # as Python itself does
                print(code, file=sys.stderr)
                code = 1
    signal.signal(signal.SIGINT, handler)
    texts = []
    for stream in streams:
        stream.flush()
        texts.append(stream.buffer.getvalue().decode())
    return subprocess.CompletedProcess([], code, *texts)


def start(folder, *arguments, **options):
    """Starts the program in a folder; returns the running Popen. options : of Popen"""
    command, pipe = [sys.executable, PROGRAM, *map(str, arguments)], subprocess.PIPE
    options |= {"cwd": folder, "env": environment(), "text": True}
    return subprocess.Popen(command, stdout=pipe, stderr=pipe, **options)


def wait_for(condition, isAlive=lambda: True):
    """What condition() returns as soon as it is true, however busy the machine is; fails if
    isAlive() is false first, or after ten minutes, when something hangs.
    """
    end = time.monotonic() + 600
    while not (found := condition()):
        assert isAlive() and time.monotonic() < end
        time.sleep(0.05)
    return found


def call(capsys, *arguments):
    """(exit code, output, errors) of the program, run in this process."""
    capsys.readouterr()
    try:
        code = main([str(argument) for argument in arguments])
    except SystemExit as ended:  # argparse does not return
        code = ended.code
    return code, *capsys.readouterr()


def summary_of(output):
    """The lines of a run's summary as a dict; output : what it printed, or a process that ended."""
    if not isinstance(output, str):
        assert output.returncode == 0, output.stderr
        output = output.stdout
    return {line[:17].strip(): line[18:] for line in output.splitlines()}


def by_hand(scene, steps, restitution, timeStep, **options):
    """States of every step by run_timestep alone: dict of arrays (steps + 1, n, 3 or 4)."""
    meshes = load_scene_file(scene)
    states = {plural: [] for plural in STATE_NAMES}
    for step in range(steps + 1):
        if step > 0:
            run_timestep(meshes, ground(), timeStep, restitution, **options)
        for plural, name in STATE_NAMES.items():
            states[plural].append([getattr(mesh, name).ravel() for mesh in meshes])
    return {plural: np.array(series) for plural, series in states.items()}


def bits(state):
    """The bytes of a state or of a recorded frame, to be compared to the last bit."""
    return [state[name].tobytes() for name in STATE_NAMES]


def record(path, simulation, steps, change=None):
    """Records `steps` steps; change(simulation, step) is called before each of them."""
    recorder = Recorder(path)
    recorder.add(simulation)
    for step in range(1, steps + 1):
        if change is not None:
            change(simulation, step)
        simulation.step()
        recorder.add(simulation)
    recorder.save()
    return path


found_backend = lru_cache(find_backend)


def skip_or_fail(reason):
    """Skips the test for this reason, or fails it if RBS_REQUIRE_OPENGL=1 is set, as in CI."""
    if os.environ.get("RBS_REQUIRE_OPENGL") == "1":
        pytest.fail(f"RBS_REQUIRE_OPENGL=1, but {reason}")
    pytest.skip(reason)


def require_opengl():
    """Returns the Backend that draws off-screen here; ends the test if there is none."""
    backend = found_backend(window=False)
    if backend.name is None:
        skip_or_fail(f"nothing can be drawn here: {backend.reason}. {backend.remedy}")
    return backend
