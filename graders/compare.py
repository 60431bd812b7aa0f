"""Find the first step, call and quantity in which a student's steps differ from ours.

    python graders/compare.py CODE SCENE [--steps N] [--time-step S] [--restitution E]

CODE is a folder, or a ZIP, with RBSFunctions.py in it; SCENE is a scene file, or the name of a
scene of data/, with the constraints beside it. Each of the student's steps begins with our state.
All steps run in a process of their own, within the limits. The exit code is 0 if no step differs,
1 if one does, and 2 if the comparison is impossible.
"""

import argparse
import functools
import json
import re
import sys
import tempfile
import threading
import time
import warnings
from dataclasses import dataclass, field
from pathlib import Path

from classwork.graderProgram import FAILED, PASSED, run_program
from isolated.archives import find_submission, modules_of
from isolated.processes import GRACE, add_limit_arguments, copied, run_limited, traced
from reference.graderData import PROJECT_DIRECTORY

from rbs.program.parsing import POSITIVE_NUMBER, OneLineParser, setting_type
from rbs.program.submissions import CAUSE_LENGTH, SubmissionError
from rbs.scenes.messages import one_line, short
from rbs.scenes.scenefiles import SceneSource, find_scene
from rbs.stepping.settings import BY_OPTION

COMPARISON = Path(__file__).resolve().parent / "isolated" / "stepComparison.py"
MEASURES = COMPARISON.with_name("measures.py")
# A fall, many collisions, and constraints: the item of the marks, and the steps that are compared;
# with pictures every so many steps.
SCENES = {"singlebox": ("scenes", 100), "mixed": ("scenes", 100)}
SCENES |= {"tower_chain": ("constraint scenes", 60)}
EVERY, SIZE, STEPS, TIME_STEP, RESTITUTION = 30, "320x180", 150, 0.02, 0.5
USUAL = {"constraints": None, "steps": STEPS, "timeStep": TIME_STEP, "restitution": RESTITUTION}
# Address space for drawing, in addition to the submission's own: OpenGL in software.
DRAWING_MEGABYTES = 2048
# The fraction of the time limit after which no step begins, because a slow program is not wrong.
TIME_SHARE = 0.8


@dataclass
class SceneResult:
    """The result of a student's functions in a scene.

    steps : how many there was time for
    problem : the first difference from ours, or another failure, or ""
    terms : lines with the terms of our formula where it differs, and those of theirs
    largest : the largest relative difference of numbers that agree
    pictures : list of (time in s, path)
    """

    name: str
    steps: int = 0
    problem: str = ""
    remarks: list = field(default_factory=list)
    terms: list = field(default_factory=list)
    largest: float = 0.0
    pictures: list = field(default_factory=list)

    @property
    def item(self):
        """The item of the scheme of marks."""
        return SCENES[self.name][0]


def compare_steps(scene, folder, limits, **order):
    """Compares the steps of a scene, without pictures; returns a SceneResult.

    folder : of the modules; a copy is run, in a process of its own
    limits : with `seconds` and `megabytes`
    order : constraints, steps, timeStep and restitution, if they differ from the usual ones
    """
    end = time.time() + TIME_SHARE * limits.seconds
    order = USUAL | order | {"scene": str(find_scene(scene).resolve()), "end": end}
    order |= {"seconds": limits.seconds}
    with copied(folder) as work:
        answer, trace = work.parent / "answer.json", work.parent / "trace.txt"
        words = [COMPARISON, json.dumps(order | {"answer": str(answer), "trace": str(trace)})]
        code = run_limited(words, work, limits.seconds + GRACE, limits.megabytes)
        isLate, place = traced(trace, work)
        try:
            result = SceneResult(scene, **json.loads(answer.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError):  # the submission may write to the file, too
            result = SceneResult(scene)
    if code != 0:
        isStopped = code is None or isLate
        how = f"stopped after {limits.seconds:g} s" if isStopped else f"exit code {code}"
        result.problem = f"step {result.steps + 1}: {how}{place}"
    elif not result.problem and result.steps < order["steps"]:
        result.remarks.append(f"the time limit ended the comparison after {result.steps} steps")
    return result


def compare_scene(scene, folder, target, limits):
    """Compares the steps of a scene, and draws them; returns a SceneResult.

    Steps that agree with ours look like ours, which are drawn once for all submissions.
    target : folder for the pictures; the others are those of `compare_steps`
    """
    steps = SCENES[scene][1]
    result = compare_steps(scene, folder, limits, steps=steps)
    if result.problem or result.steps < steps:
        frames, problem = _frames(scene, folder, limits.seconds, limits.megabytes)
    else:
        with _isDrawing:
            frames, problem = _our_frames(scene, limits.seconds, limits.megabytes)
    result.remarks += [problem] if problem else []
    target.mkdir(parents=True, exist_ok=True)
    for step, frame in frames:
        path = target / f"{scene}_{step:04d}.png"
        path.write_bytes(frame)
        result.pictures.append((step * TIME_STEP, path))
    return result


def _frames(scene, functions, seconds, megabytes):
    """Draws a scene; returns [(step, PNG)], and a problem or "". functions : a folder, or None"""
    with copied(functions) as work, tempfile.TemporaryFile("w+", encoding="utf-8") as said:
        words = [PROJECT_DIRECTORY / "RigidBodySimulation.py", scene]
        words += ["--functions", work] if functions else ["--basic"]
        words += ["--time-step", TIME_STEP, "--steps", SCENES[scene][1], "--every", EVERY]
        words += ["--size", SIZE, "--screenshots", work.parent / "frames"]
        code, problem = run_limited(words, work, seconds, megabytes + DRAWING_MEGABYTES, said), ""
        if code != 0:
            said.seek(0)
            line = (said.read().splitlines() or [f"stopped after {seconds:g} s"])[-1]
            problem = short(f"not all pictures: {line}", limit=CAUSE_LENGTH)
        paths = sorted(work.parent.glob("frames/frame_*.png"))
        return [(int(re.sub(r"\D", "", one.stem)), one.read_bytes()) for one in paths], problem


def measured(folder, limits):
    """Returns a dict from the number of a section to lines that help a marker."""
    with copied(folder) as work:
        answer = work.parent / "answer.json"
        run_limited([MEASURES, answer], work, limits.seconds, limits.megabytes)
        try:
            return json.loads(answer.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}


_isDrawing = threading.Lock()


@functools.cache
def _our_frames(scene, seconds, megabytes):
    return _frames(scene, None, seconds, megabytes)


def main(given):
    """Compares as the command line says; returns the exit code."""
    source = SceneSource.of_files(find_scene(given.scene), given.constraints)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of meshes that are not convex
        source.make()
    order = {"constraints": source.constraintPath and str(source.constraintPath.resolve())}
    order |= {"steps": given.steps, "timeStep": given.time_step, "restitution": given.restitution}
    with modules_of(find_submission(given.code)) as (folder, remarks):
        result = compare_steps(given.scene, folder, given, **order)
    if result.problem.startswith("cannot be imported"):
        raise SubmissionError(result.problem)
    agree = f"{result.steps} steps agree; the largest relative difference is {result.largest:.1e}"
    for line in (*remarks, *result.remarks, result.problem or agree, *result.terms):
        print(one_line(line))
    return FAILED if result.problem else PASSED


def make_parser():
    """Returns the command line's parser."""
    form = argparse.RawDescriptionHelpFormatter
    parser = OneLineParser(description=__doc__, formatter_class=form)
    add = parser.add_argument
    add("code", metavar="CODE", help="a student's folder or ZIP; a copy of it is run")
    add("scene", metavar="SCENE", help="a scene file, or the name of a scene of data/")
    add("--constraints", metavar="FILE", help="constraints (default: those beside the scene)")
    text = "number of steps to compare (default: %(default)s)"
    add("--steps", metavar="N", type=POSITIVE_NUMBER, default=STEPS, help=text)
    for option, default in (("time-step", TIME_STEP), ("restitution", RESTITUTION)):
        form = {"type": setting_type(BY_OPTION[option]), "default": default}
        text = f"{BY_OPTION[option].help} (default: {default})"
        add(f"--{option}", metavar="X", **form, help=text)
    add_limit_arguments(parser, seconds=300.0)
    return parser


if __name__ == "__main__":
    sys.exit(run_program(make_parser(), main))
