"""The quick set: whether the installed program works with this Python, in less than a minute.

    python -m venv quick && quick/bin/pip install PATH/TO/THE/CHECKOUT
    quick/bin/python PATH/TO/THE/CHECKOUT/tests/quick.py

Works in an empty folder of its own; the graders run from the checkout. Ends with exit code 1 at the
first command that fails. The picture is skipped without OpenGL, unless RBS_REQUIRE_OPENGL=1 is set.
"""

import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

import h5py
import numpy as np
from PIL import Image

from rbs.pictures.backends import find_backend
from rbs.scenes.scenefiles import DATA_FOLDER

CHECKOUT = Path(__file__).resolve().parent.parent
PROGRAM = Path(sysconfig.get_path("scripts")) / "rigid-body-simulation"
GRADERS = ("integrationGrading", "ResolveCollisionsGrading", "Constraints")
STATES = ("positions", "orientations", "linVelocities", "angVelocities")
HIDDEN = ("DISPLAY", "WAYLAND_DISPLAY", "PYTHONPATH")
ENVIRONMENT = {name: value for name, value in os.environ.items() if name not in HIDDEN}
# Seconds, for a command that hangs.
TIME_LIMIT = 120


def call(folder, *command):
    """Runs a command in a folder, without a display; ends the program if it fails."""
    words = [str(word) for word in command]
    print(" ".join(words), flush=True)
    process = subprocess.run(
        words, cwd=folder, env=ENVIRONMENT, timeout=TIME_LIMIT, capture_output=True, text=True
    )
    # Compiled code may print an exception, ignore it, and go on with wrong numbers.
    if process.returncode != 0 or "Traceback" in process.stderr:
        sys.exit(f"{process.stdout}{process.stderr}FAILED with exit code {process.returncode}")


def record_and_repeat(folder):
    """Records a scene that is then deleted, verifies it, resumes it to the same bits, replays."""
    shutil.copytree(DATA_FOLDER, folder / "own")
    scene = folder / "own" / "tower_chain-scene.txt"
    call(folder, PROGRAM, scene, "--steps", 60, "--record", "run.h5")
    shutil.rmtree(folder / "own")
    call(folder, PROGRAM, "stack", "--steps", 130, "--record", "stack.h5")
    for first, begin in (("run.h5", 30), ("stack.h5", 115)):
        call(folder, PROGRAM, "--verify", first)
        words = "--from", begin, "--steps", 10, "--record", "again.h5"
        call(folder, PROGRAM, "--resume", first, *words)
        with h5py.File(folder / first) as before, h5py.File(folder / "again.h5") as after:
            for name in STATES:
                if before[name][begin : begin + 11].tobytes() != after[name][:].tobytes():
                    sys.exit(f"FAILED: {name}, resumed from step {begin}, have other bits")
    call(folder, PROGRAM, "--replay", "run.h5", "--headless")


def draw(folder):
    """Draws a picture, unless nothing can be drawn here."""
    backend = find_backend(window=False)
    if backend.name is None and os.environ.get("RBS_REQUIRE_OPENGL") != "1":
        print(f"no picture: {backend.reason}. {backend.remedy}")
        return
    call(folder, PROGRAM, "mixed", "--steps", 0, "--screenshots", ".", "--size", "320x180")
    with Image.open(folder / "frame_000000.png") as picture:
        if len(picture.convert("RGB").getcolors(320 * 180)) == 1:
            sys.exit("FAILED: the picture is of one colour")


def main():
    if DATA_FOLDER.resolve() == CHECKOUT / "data":
        sys.exit("the program is installed with -e; install it without")
    print(f"Python {platform.python_version()}, NumPy {np.__version__}, h5py {h5py.__version__}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        record_and_repeat(folder)
        for grader in GRADERS:
            call(folder, sys.executable, CHECKOUT / "graders" / f"{grader}.py")
        draw(folder)


if __name__ == "__main__":
    main()
