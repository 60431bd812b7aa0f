"""Where a student's steps leave ours: the first step, and the first call and quantity in it.

    python graders/compare.py CODE SCENE [--steps N] [--time-step S] [--restitution E]

CODE is a folder, or a ZIP, with RBSFunctions.py in it; SCENE is taken, with the constraints beside
it, as RigidBodySimulation.py takes it. Each step of the student's begins with our state. All steps
run in a process of their own, within the limits. The exit code is 0 if no step differs, 1 if one
does, and 2 for what cannot be compared.
"""

import argparse
import json
import re
import shutil
import sys
import tempfile
import time
import warnings
from dataclasses import dataclass, field
from pathlib import Path

from archives import find_submissions, modules_of
from graderProgram import run_program
from gradingTools import FAILED, PASSED, PROJECT_DIRECTORY, OneLineParser, printable
from isolation import add_limit_arguments, copied, run_limited

from rbs.program.options import POSITIVE_NUMBER, setting_type
from rbs.program.submissions import SubmissionError, brief
from rbs.scenes.messages import InputError
from rbs.scenes.scenefiles import SceneSource, find_scene
from rbs.stepping.settings import BY_OPTION

COMPARISON = Path(__file__).resolve().with_name("stepComparison.py")
# A fall, many collisions, and constraints; with pictures, so many steps apart.
SCENES = ("singlebox", "mixed", "tower_chain")
STEPS, EVERY, TIME_STEP, SIZE = 150, 50, 0.02, "320x180"
# The address space that drawing takes, beside what a submission may have: OpenGL in software.
DRAWING_MEGABYTES = 2048
# The part of the time limit after which no step is begun: a program that is slow is not wrong.
TIME_SHARE = 0.8


@dataclass
class SceneResult:
    """What a student's functions do in a scene.

    steps : how many there was time for; problem : the first difference from ours, or what went
        wrong, or ""; largest : relative difference of what agrees
    remarks : list of str; pictures : list of (time in s, path)
    """

    name: str
    steps: int = 0
    problem: str = ""
    remarks: list = field(default_factory=list)
    largest: float = 0.0
    pictures: list = field(default_factory=list)


def compare_steps(scene, folder, limits, **order):
    """The SceneResult of a scene, without pictures.

    folder : of the modules; a copy is run, in a process of its own, as long as the limits allow
    order : constraints, steps, timeStep and restitution, where they are not the usual ones
    """
    order = {"constraints": None, "steps": STEPS, "timeStep": TIME_STEP, "restitution": 0.5} | order
    end = time.time() + TIME_SHARE * limits.seconds
    order |= {"scene": str(find_scene(scene).resolve()), "end": end}
    with copied(folder) as work:
        answer = work.parent / "answer.json"
        words = [COMPARISON, json.dumps(order | {"answer": str(answer)})]
        code = run_limited(words, work, limits.seconds, limits.megabytes)
        try:
            result = SceneResult(scene, **json.loads(answer.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError):  # what is written is up to the submission as well
            result = SceneResult(scene)
    if code != 0:
        how = f"stopped after {limits.seconds:g} s" if code is None else f"exit code {code}"
        result.problem = f"step {result.steps + 1}: {how}"
    elif not result.problem and result.steps < order["steps"]:
        result.remarks.append(f"the time limit ended the comparison after {result.steps} steps")
    return result


def compare_scene(scene, folder, target, limits):
    """The SceneResult of a scene, with pictures of what the student's functions do.

    target : a folder that the pictures are put into; the rest as for `compare_steps`
    """
    result = compare_steps(scene, folder, limits)
    with copied(folder) as work, tempfile.TemporaryFile("w+", encoding="utf-8") as said:
        words = [
            PROJECT_DIRECTORY / "RigidBodySimulation.py",
            scene,
            "--functions",
            work,
            "--time-step",
            TIME_STEP,
            "--steps",
            STEPS,
            "--screenshots",
            work.parent / "frames",
            "--every",
            EVERY,
            "--size",
            SIZE,
        ]
        megabytes = limits.megabytes + DRAWING_MEGABYTES
        if run_limited(words, work, limits.seconds, megabytes, said) != 0:
            said.seek(0)
            line = (said.read().splitlines() or [f"stopped after {limits.seconds:g} s"])[-1]
            result.remarks.append(brief(f"not all pictures: {line}"))
        target.mkdir(parents=True, exist_ok=True)
        for frame in sorted(work.parent.glob("frames/frame_*.png")):
            step = int(re.sub(r"\D", "", frame.stem))
            path = target / f"{scene}_{step:04d}.png"
            shutil.copyfile(frame, path)
            result.pictures.append((step * TIME_STEP, path))
    return result


def main(given):
    """Compares as the command line asks; returns the exit code."""
    try:
        source = SceneSource.of_files(find_scene(given.scene), given.constraints)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of meshes that are not convex
            source.make()
    except InputError as error:
        raise SubmissionError(error) from None
    constraints = source.constraintPath and str(source.constraintPath.resolve())
    entry, *_others = find_submissions([given.code])
    with modules_of(entry) as (folder, remarks):
        result = compare_steps(
            given.scene,
            folder,
            given,
            constraints=constraints,
            steps=given.steps,
            timeStep=given.time_step,
            restitution=given.restitution,
        )
    agree = f"{result.steps} steps agree; the largest relative difference is {result.largest:.1e}"
    for line in (*remarks, *result.remarks, result.problem or agree):
        print(printable(line))
    return FAILED if result.problem else PASSED


def make_parser():
    parser = OneLineParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("code", metavar="CODE", help="a student's folder or ZIP, a copy of which is run")
    add("scene", metavar="SCENE", help="a scene file, or the name of a scene of data/")
    add("--constraints", metavar="FILE", help="the constraints (default: those beside the scene)")
    add(
        "--steps",
        metavar="N",
        type=POSITIVE_NUMBER,
        default=STEPS,
        help="how many steps are compared (default: %(default)s)",
    )
    for option, default in (("time-step", TIME_STEP), ("restitution", 0.5)):
        one = BY_OPTION[option]
        add(
            f"--{option}",
            metavar="X",
            type=setting_type(one),
            default=default,
            help=f"{one.help} (default: {default})",
        )
    add_limit_arguments(parser)
    parser.set_defaults(seconds=300.0)
    return parser


if __name__ == "__main__":
    sys.exit(run_program(make_parser(), main))
