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
STATES = ("positions", "orientations", "linVelocities", "angVelocities")
HIDDEN = ("DISPLAY", "WAYLAND_DISPLAY", "PYTHONPATH")
ENVIRONMENT = {name: value for name, value in os.environ.items() if name not in HIDDEN}


def call(*command):
    """Runs a command without a display; ends the program if it fails."""
    words, form = [str(word) for word in command], {"capture_output": True, "text": True}
    print(" ".join(words), flush=True)
    process = subprocess.run(words, env=ENVIRONMENT, timeout=600, **form)
    # Compiled code may print an exception, ignore it, and go on with wrong numbers.
    if process.returncode != 0 or "Traceback" in process.stderr:
        sys.exit(f"{process.stdout}{process.stderr}FAILED with exit code {process.returncode}")


def record_and_repeat():
    """Records a scene that is then deleted, verifies it, resumes it to the same bits, replays."""
    shutil.copytree(DATA_FOLDER, "own")
    call(PROGRAM, "own/tower_chain-scene.txt", "--steps", 60, "--record", "run.h5")
    shutil.rmtree("own")
    call(PROGRAM, "stack", "--steps", 130, "--record", "stack.h5")
    for first, begin in (("run.h5", 30), ("stack.h5", 115)):
        call(PROGRAM, "--verify", first)
        words = "--from", begin, "--steps", 10, "--record", "again.h5"
        call(PROGRAM, "--resume", first, *words)
        with h5py.File(first) as before, h5py.File("again.h5") as after:
            for name in STATES:
                if before[name][begin : begin + 11].tobytes() != after[name][:].tobytes():
                    sys.exit(f"FAILED: {name}, resumed from step {begin}, have other bits")
    call(PROGRAM, "--replay", "run.h5", "--headless")


def draw():
    """Draws a picture, unless nothing can be drawn here."""
    backend = find_backend(window=False)
    if backend.name is None and os.environ.get("RBS_REQUIRE_OPENGL") != "1":
        print(f"no picture: {backend.reason}. {backend.remedy}")
        return
    call(PROGRAM, "mixed", "--steps", 0, "--screenshots", ".", "--size", "320x180")
    with Image.open("frame_000000.png") as picture:
        if len(picture.convert("RGB").getcolors(320 * 180)) == 1:
            sys.exit("FAILED: the picture is of one colour")


if __name__ == "__main__":
    if DATA_FOLDER.resolve() == CHECKOUT / "data":
        sys.exit("the program is installed with -e; install it without")
    print(f"Python {platform.python_version()}, NumPy {np.__version__}, h5py {h5py.__version__}")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        os.chdir(folder)
        record_and_repeat()
        for grader in ("integrationGrading", "ResolveCollisionsGrading", "Constraints"):
            call(sys.executable, CHECKOUT / "graders" / f"{grader}.py")
        draw()
        os.chdir(CHECKOUT)  # Windows does not remove the current folder
