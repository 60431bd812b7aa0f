"""Where a student's steps leave ours: the first step, and the first call and quantity in it.

    python graders/compare.py CODE SCENE [--steps N] [--time-step S] [--restitution E]

CODE is a folder with RBSFunctions.py and Quaternion.py; SCENE, and the constraints beside it, are
as RigidBodySimulation.py takes them. Both get our state before each step. The exit code is 0 if no
step differs, 1 if one does, and 2 for what cannot be compared.
"""

import argparse
import json
import re
import shutil
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

from gradingTools import (
    BAD_DATA,
    FAILED,
    PASSED,
    PROJECT_DIRECTORY,
    STOPPED,
    OneLineParser,
    printable,
)
from isolation import GRADERS, add_limit_arguments, copied, limits_of, run_limited

from rbs.messages import InputError
from rbs.scenes import SceneSource, find_scene
from rbs.settings import BY_OPTION
from rbs.submissions import check_folder

# A fall, a collision, many of both, and constraints.
SCENES = ("singlebox", "mixed", "tower_chain")
STEPS = 150
EVERY = 50
TIME_STEP = 0.02  # s
SIZE = "320x180"
# The address space that drawing takes, beside what a submission may have: OpenGL in software.
DRAWING_MEGABYTES = 2048


@dataclass
class SceneResult:
    """A scene by a student's functions, compared with ours.

    problem : the first difference, or what went wrong; "" for nothing
    remarks : dict to the first step; largest : difference of what agrees, relative to its scale
    pictures : list of (time in s, path)
    """

    name: str
    problem: str = ""
    remarks: dict = field(default_factory=dict)
    largest: float = 0.0
    pictures: list = field(default_factory=list)


def compare_steps(work, scene, limits, constraints=None, steps=STEPS, timeStep=TIME_STEP,
                  restitution=0.5):  # fmt: skip
    """The SceneResult of a scene. work : a copy of the student's modules, which run there"""
    answer = work.parent / "answer.json"
    answer.unlink(missing_ok=True)
    order = {
        "scene": str(Path(find_scene(scene)).resolve()), "steps": steps, "timeStep": timeStep,
        "constraints": constraints and str(Path(constraints).resolve()),
        "restitution": restitution, "answer": str(answer),
    }  # fmt: skip
    code = run_limited(
        [sys.executable, "-B", str(GRADERS / "limitedRun.py"), str(limits.megabytes),
         str(GRADERS / "stepComparison.py"), json.dumps(order)],
        work, limits.seconds,
    )  # fmt: skip
    result, found = SceneResult(scene), {}
    if answer.exists():
        found = json.loads(answer.read_text(encoding="utf-8", errors="replace"))
        result.problem, result.remarks, result.largest = (
            found[name] for name in ("problem", "remarks", "largest")
        )
    if code != 0:
        how = f"ended with exit code {code}"
        how = f"stopped after {limits.seconds:g} s" if code is None else how
        result.problem = f"step {found.get('step', 0)}: {how}"
    return result


def compare_scene(scene, folder, target, limits):
    """The SceneResult of a scene, with pictures of it by the student's functions.

    target : a folder that the pictures are put into. The modules run on a copy, in processes of
    their own, for the time that the limits allow.
    """
    with copied(folder) as work, tempfile.TemporaryDirectory(prefix="scenes-") as place:
        result = compare_steps(work, scene, limits)
        frames = Path(place) / "frames"
        command = [
            sys.executable, "-B", str(GRADERS / "limitedRun.py"),
            str(limits.megabytes + DRAWING_MEGABYTES),
            str(PROJECT_DIRECTORY / "RigidBodySimulation.py"), scene,
            "--functions", str(work), "--time-step", str(TIME_STEP), "--steps", str(STEPS),
            "--screenshots", str(frames), "--every", str(EVERY), "--size", SIZE,
        ]  # fmt: skip
        run_limited(command, work, limits.seconds)
        target.mkdir(parents=True, exist_ok=True)
        for frame in sorted(frames.glob("frame_*.png")):
            step = int(re.sub(r"\D", "", frame.stem))
            path = target / f"{scene}_{step:04d}.png"
            shutil.copyfile(frame, path)
            result.pictures.append((step * TIME_STEP, path))
    return result


def main():
    parser = OneLineParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("code", metavar="CODE", help="the folder of the student's modules, a copy of which is run")
    add("scene", metavar="SCENE", help="a scene file, or the name of a scene of data/")
    add("--constraints", metavar="FILE", help="the constraints (default: those beside the scene)")
    add("--steps", metavar="N", type=int, default=STEPS, help="how many (default: %(default)s)")
    for option, default in (("time-step", TIME_STEP), ("restitution", 0.5)):
        one = BY_OPTION[option]
        text = one.help + " (default: %(default)s)"
        add(f"--{option}", metavar="X", type=one.parsed, default=default, help=text)
    add_limit_arguments(parser)
    given = parser.parse_args()
    try:
        check_folder(given.code)
        SceneSource.of_files(find_scene(given.scene), given.constraints).make()
        with copied(given.code) as work:
            result = compare_steps(work, given.scene, limits_of(given), given.constraints,
                                   given.steps, given.time_step, given.restitution)  # fmt: skip
    except (InputError, OSError) as problem:
        parser.exit(BAD_DATA, printable(f"{parser.prog}: {problem}") + "\n")
    except KeyboardInterrupt:
        parser.exit(STOPPED, f"{parser.prog}: stopped by Ctrl-C\n")
    for text, step in result.remarks.items():
        print(printable(f"from step {step} on: {text}"))
    agree = f"{given.steps} steps agree; the largest relative difference is {result.largest:.1e}"
    print(printable(result.problem or agree))
    return FAILED if result.problem else PASSED


if __name__ == "__main__":
    sys.exit(main())
