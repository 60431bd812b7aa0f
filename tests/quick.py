"""The quick set: whether the installed program works with this Python, in less than a minute.

    python -m venv quick && quick/bin/pip install PATH/TO/THE/CHECKOUT
    quick/bin/python PATH/TO/THE/CHECKOUT/tests/quick.py

Works in an empty folder of its own; the graders run from the checkout. Ends with exit code 1 at the
first check that fails. The picture is skipped without OpenGL, unless RBS_REQUIRE_OPENGL=1 is set.
"""

import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np
from PIL import Image

CHECKOUT = Path(__file__).resolve().parent.parent
PROGRAM = Path(sysconfig.get_path("scripts")) / "rigid-body-simulation"
MODULES = ("RBSFunctions", "GJK", "Quaternion", "RigidBodySimulation")
GRADERS = ("integrationGrading", "ResolveCollisionsGrading", "Constraints")
STATES = ("positions", "orientations", "linVelocities", "angVelocities")
HIDDEN = ("DISPLAY", "WAYLAND_DISPLAY", "PYTHONPATH")
ENVIRONMENT = {name: value for name, value in os.environ.items() if name not in HIDDEN}
# Seconds, for a command that hangs.
TIME_LIMIT = 120


class Failed(Exception):
    """A check that failed; the message says what was expected and what came."""


def call(folder, *command):
    """Runs a command in a folder, without a display; returns what it prints, or raises Failed."""
    words = [str(word) for word in command]
    process = subprocess.run(
        words, cwd=folder, env=ENVIRONMENT, timeout=TIME_LIMIT, capture_output=True, text=True
    )
    # Compiled code may print an exception, ignore it, and go on with wrong numbers.
    if process.returncode != 0 or "Traceback" in process.stderr:
        print(process.stdout + process.stderr, end="")
        code = process.returncode
        how = f"ended with exit code {code}" if code else "printed an exception"
        raise Failed(f"{' '.join(words)} {how}")
    return process.stdout + process.stderr


def run(folder, *arguments):
    call(folder, PROGRAM, *arguments)


def imports(folder):
    code = f"import {', '.join(MODULES)}; print({MODULES[0]}.__file__)"
    (line,) = call(folder, sys.executable, "-c", code).splitlines()
    place = Path(line).parent
    if place.resolve() == CHECKOUT:
        raise Failed("the program is installed with -e; install it without")
    return f"{', '.join(MODULES)} print nothing, without a display; they are in {place}"


def records(folder):
    from rbs.scenes.scenefiles import DATA_FOLDER

    shutil.copytree(DATA_FOLDER, folder / "own")
    scene = folder / "own" / "tower_chain-scene.txt"
    run(folder, scene, "--steps", 60, "--record", "run.h5")
    run(folder, "stack", "--steps", 130, "--record", "stack.h5")
    shutil.rmtree(folder / "own")
    return "60 steps of a scene that is then deleted, 130 soft steps of stack"


def verifies(folder):
    for name in ("run", "stack"):
        run(folder, "--verify", f"{name}.h5")
    return "both recordings are the same, simulated once more"


def resumes(folder):
    for first, begin in (("run.h5", 30), ("stack.h5", 115)):
        run(folder, "--resume", first, "--from", begin, "--steps", 10, "--record", "again.h5")
        with h5py.File(folder / first) as before, h5py.File(folder / "again.h5") as after:
            for name in STATES:
                if before[name][begin : begin + 11].tobytes() != after[name][:].tobytes():
                    raise Failed(f"{first}: {name} resumed from step {begin} have other bits")
    return "ten steps of both have the same bits"


def replays(folder):
    elsewhere = folder / "elsewhere"
    elsewhere.mkdir()
    (folder / "run.h5").rename(elsewhere / "run.h5")
    run(elsewhere, "--replay", "run.h5", "--headless")
    return "the recording alone, in another folder"


def grades(folder):
    for name in GRADERS:
        call(folder, sys.executable, CHECKOUT / "graders" / f"{name}.py")
    return f"{', '.join(GRADERS)} pass"


def draws(folder):
    from rbs.pictures.backends import find_backend

    backend = find_backend(window=False)
    if backend.name is None:
        if os.environ.get("RBS_REQUIRE_OPENGL") == "1":
            raise Failed(f"RBS_REQUIRE_OPENGL=1, but nothing can be drawn: {backend.reason}")
        return f"skipped, nothing can be drawn here: {backend.reason}. {backend.remedy}"
    run(folder, "mixed", "--steps", 0, "--screenshots", ".", "--size", "320x180")
    with Image.open(folder / "frame_000000.png") as picture:
        colours = len(picture.convert("RGB").getcolors(320 * 180))
    if colours == 1:
        raise Failed("the picture is of one colour")
    return f"a picture of {colours} colours"


def main():
    print(f"Python {platform.python_version()}, NumPy {np.__version__}, h5py {h5py.__version__}")
    with tempfile.TemporaryDirectory() as folder:
        for check in (imports, records, verifies, resumes, replays, grades, draws):
            start = time.perf_counter()
            try:
                result = check(Path(folder))
            except Exception as error:
                cause = error if isinstance(error, Failed) else f"{type(error).__name__}: {error}"
                sys.exit(f"{check.__name__:9} FAILED: {cause}")
            print(f"{check.__name__:9}{time.perf_counter() - start:5.1f} s  {result}", flush=True)


if __name__ == "__main__":
    main()
