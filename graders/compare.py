"""Find the first step, call and quantity in which a student's steps differ from ours.

    python graders/compare.py CODE SCENE [--steps N] [--time-step S] [--restitution E]

CODE is a folder, or a ZIP, with RBSFunctions.py in it; SCENE is a scene file, or the name of a
scene of data/, with the constraints beside it. Each of the student's steps begins with our state.
All steps run in a process of their own, within the limits. The exit code is 0 if all steps agree,
1 if one differs or is not made, and 2 if the comparison is impossible.
"""

import argparse
import functools
import re
import sys
import tempfile
import threading
import time
import warnings
from dataclasses import dataclass, field
from types import SimpleNamespace

from classwork.graderProgram import FAILED, PASSED, run_program
from isolated import measures
from isolated.archives import read_plain, read_submission
from isolated.processes import (
    GRACE,
    Ended,
    PrivateFolder,
    Worker,
    add_limit_arguments,
    run_script,
)
from isolated.stepComparison import Comparison
from reference import PROJECT_DIRECTORY
from tqdm import tqdm
from verdict.parts import UNREADABLE

from rbs.program.parsing import OWN_PARAMETERS, POSITIVE_NUMBER, OneLineParser, setting_type
from rbs.program.submissions import CAUSE_LENGTH, SubmissionError
from rbs.scenes.messages import one_line, short
from rbs.scenes.scenefiles import SceneSource, find_scene
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping.meshes import StateError
from rbs.stepping.settings import BY_OPTION, Settings

# A fall, many collisions, and constraints: the item of the marks, and the steps that are compared;
# with pictures every so many steps.
SCENES = {"singlebox": ("scenes", 100), "mixed": ("scenes", 100)}
SCENES |= {"tower_chain": ("constraint scenes", 60)}
EVERY, SIZE, STEPS, TIME_STEP, RESTITUTION = 30, "320x180", 150, 0.02, 0.5
# Address space for drawing, in addition to the submission's own: OpenGL in software.
DRAWING_MEGABYTES = 2048
LARGEST_PICTURE = 4 << 20


@dataclass
class SceneResult:
    """The result of a student's functions in a scene.

    steps : how many agree with ours, of `asked`
    problem : the first difference from ours, or another failure, or ""
    terms : lines with the terms of our formula where it differs, and those of theirs
    largest : the largest relative difference of numbers that agree
    pictures : list of (time in s, path); isDisturbed : as in `processes.Ended`
    """

    name: str
    asked: int
    steps: int = 0
    problem: str = ""
    remarks: list = field(default_factory=list)
    terms: list = field(default_factory=list)
    largest: float = 0.0
    pictures: list = field(default_factory=list)
    isDisturbed: bool = False

    @property
    def item(self):
        """The item of the scheme of marks."""
        return SCENES[self.name][0]

    @property
    def share(self):
        """The share of the steps that agree."""
        return self.steps / self.asked


def compare_steps(source, handIn, limits, steps=STEPS, settings=None, options=None, bar=False):
    """Compares the steps of a scene, without pictures; returns a SceneResult.

    source : SceneSource; limits : `seconds`, for each step and for all of them, and `megabytes`
    options : of the student's run_timestep; bar : whether a progress bar is shown
    """
    name = source.path.name.removesuffix("-scene.txt")
    result, comparison = SceneResult(name, steps), None
    settings = settings or Settings(timeStep=TIME_STEP, restitution=RESTITUTION)
    end = time.monotonic() + limits.seconds
    try:
        with Worker(handIn.files, limits, end + GRACE) as worker:
            result.remarks += worker.remarks
            ours = SceneSimulation(source, settings)
            comparison = Comparison(worker.ask, ours, options)
            shown = {"total": steps, "disable": None if bar else True, "unit": " steps"}
            with tqdm(leave=False, **shown) as progress:
                while not comparison.problem and result.steps < steps and time.monotonic() < end:
                    comparison.step()
                    result.steps += not comparison.problem
                    progress.update()
            result.problem, result.terms = comparison.problem, comparison.terms
            result.isDisturbed = worker.has_changed()
    except SubmissionError:
        raise
    except (Ended, StateError) as problem:
        result.problem = str(problem)
        if not result.problem.startswith("cannot be imported"):
            result.problem = f"step {result.steps + 1}: {problem}"
        result.isDisturbed = getattr(problem, "isDisturbed", False)
    except (ValueError, TypeError, KeyError, IndexError, AttributeError):  # an answer made up
        result.problem = f"step {result.steps + 1}: {UNREADABLE}"
    if not result.problem and result.steps < steps:
        result.problem = (
            f"step {result.steps + 1}: stopped after {limits.seconds:g} s for all steps"
        )
    if comparison is not None:
        pairs = comparison.remarks.items()
        result.remarks += [f"from step {k} on: {one}" * (k > 0) or one for one, k in pairs]
        result.largest = float(comparison.largest)
    return result


def compare_scene(scene, handIn, target, limits):
    """Compares the steps of a scene, and draws them; returns a SceneResult.

    Steps that agree with ours look like ours, which are drawn once for all submissions.
    target : folder for the pictures; the others are those of `compare_steps`
    """
    result = compare_steps(source_of(scene), handIn, limits, SCENES[scene][1])
    given = SimpleNamespace(seconds=limits.seconds, megabytes=limits.megabytes)
    if result.problem:
        frames, problem = _frames(scene, handIn.files, given)
    else:
        with _isDrawing:
            frames, problem = _our_frames(scene, given.seconds, given.megabytes)
    result.remarks += [problem] if problem else []
    target.mkdir(parents=True, exist_ok=True)
    for step, frame in frames:
        path = target / f"{scene}_{step:04d}.png"
        path.write_bytes(frame)
        result.pictures.append((step * TIME_STEP, path))
    return result


def _frames(scene, files, limits):
    """Draws a scene; returns [(step, PNG)], and a problem or "". files : of a HandIn, or None"""
    folder = PrivateFolder(files or {})
    try:
        with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as said:
            words = [PROJECT_DIRECTORY / "RigidBodySimulation.py", scene]
            words += ["--functions", folder.work] if files else ["--basic"]
            words += ["--time-step", TIME_STEP, "--steps", SCENES[scene][1], "--every", EVERY]
            words += ["--size", SIZE, "--screenshots", folder.path / "frames"]
            code, problem = run_script(words, folder, limits, DRAWING_MEGABYTES, said), ""
            if code != 0:
                said.seek(0)
                line = (said.read().splitlines() or [f"stopped after {limits.seconds:g} s"])[-1]
                problem = short(f"not all pictures: {line}", limit=CAUSE_LENGTH)
        paths = sorted((folder.path / "frames").glob("frame_*.png"))
        frames = [(re.sub(r"\D", "", one.stem), read_plain(one, LARGEST_PICTURE)) for one in paths]
        isPicture = b"\x89PNG"
        return [(int(k), png) for k, png in frames if k and png.startswith(isPicture)], problem
    finally:
        folder.remove()


def measured(handIn, limits):
    """Returns a dict from the number of a section to lines that help a marker."""
    return measures.measured(functools.partial(Worker, handIn.files, limits), limits)


def source_of(scene, constraints=None):
    """Returns the SceneSource of a scene, by name or path. Raises SceneError."""
    source = SceneSource.of_files(find_scene(scene), constraints)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of meshes that are not convex
        source.make()
    return source


_isDrawing = threading.Lock()


@functools.cache
def _our_frames(scene, seconds, megabytes):
    return _frames(scene, None, SimpleNamespace(seconds=seconds, megabytes=megabytes))


def main(given):
    """Compares as the command line says; returns the exit code."""
    source = source_of(given.scene, given.constraints)
    settings = Settings(timeStep=given.time_step, restitution=given.restitution)
    handIn = read_submission(given.code)
    result = compare_steps(source, handIn, given, given.steps, settings, given.set, bar=True)
    if result.problem.startswith("cannot be imported"):
        raise SubmissionError(result.problem)
    agree = f"{result.steps} steps agree; the largest relative difference is {result.largest:.1e}"
    for line in (*handIn.remarks, *result.remarks, result.problem or agree, *result.terms):
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
        setting = BY_OPTION[option]
        form = {"type": setting_type(setting), "default": default}
        add(f"--{option}", metavar="X", help=f"{setting.help} (default: {default})", **form)
    text = "parameters of the student's run_timestep"
    add("--set", metavar="NAME=VALUE,...", type=OWN_PARAMETERS, help=text)
    add_limit_arguments(parser, seconds=300.0)
    return parser


if __name__ == "__main__":
    sys.exit(run_program(make_parser(), main))
