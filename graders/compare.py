"""Find the first step, call and quantity in which a student's steps differ from ours.

    python graders/compare.py CODE SCENE [--steps N] [--time-step S] [--restitution E]

CODE is a folder, or a ZIP, with RBSFunctions.py in it; SCENE is a scene file, or the name of a
scene of data/, with the constraints beside it. Each of the student's steps begins with our state.
All steps run in a process of their own, within the limits. The exit code is 0 if all steps agree,
1 if one differs or is not made, and 2 if the comparison is impossible.
"""

import reference

if __name__ == "__main__":
    reference.prepare()

import argparse
import sys
import time
import warnings
from contextlib import suppress

from classwork.graderProgram import FAILED, PASSED, run_program
from isolated.archives import read_submission
from isolated.processes import GRACE, PATIENCE, Ended, Worker, add_limit_arguments
from isolated.stepComparison import Comparison
from tqdm import tqdm
from verdict.parts import UNREADABLE

from rbs.program.parsing import OneLineParser, number_type, option_type
from rbs.program.submissions import SubmissionError
from rbs.scenes.messages import InputError, counted, one_line, short
from rbs.scenes.scenefiles import SceneSource, find_scene
from rbs.scenes.settingtexts import BY_OPTION
from rbs.scenes.simulation import SceneSimulation
from rbs.stepping.meshes import StateError
from rbs.stepping.settings import Settings

# A fall, many collisions, and constraints: the item of the marks, and the steps that are compared.
SCENES = {"singlebox": ("scenes", 100), "mixed": ("scenes", 100)}
SCENES |= {"tower_chain": ("constraint scenes", 60)}
STEPS, TIME_STEP, RESTITUTION = 150, 0.02, 0.5


def compare_steps(source, handIn, limits, steps=STEPS, settings=None, options=None, bar=False):
    """Compares the steps of a scene; returns a Comparison.

    source : SceneSource; limits : `seconds` of processor time for each step, and `megabytes`
    options : of the student's run_timestep; bar : whether a progress bar is shown
    """
    settings = settings or Settings(timeStep=TIME_STEP, restitution=RESTITUTION)
    comparison = Comparison(SceneSimulation(source, settings), steps, options)
    end, problem = time.monotonic() + PATIENCE * limits.seconds, ""
    try:
        with Worker(handIn, limits, end + GRACE) as worker:
            comparison.build(worker.ask)
            form = {"total": steps, "disable": None if bar else True, "unit": " steps"}
            with tqdm(leave=False, **form) as progress:
                while not comparison.isOver and time.monotonic() < end:
                    comparison.step()
                    progress.update()
        if not comparison.isOver:
            problem = f"stopped, because all steps took more than {PATIENCE} times the limit"
    except SubmissionError:
        raise
    except (Ended, StateError) as error:
        problem = str(error)
    except (ValueError, TypeError, KeyError, IndexError, AttributeError):  # an answer made up
        problem = UNREADABLE
    if problem:
        isImport = problem.startswith("cannot be imported")
        comparison.problem = problem if isImport else f"step {comparison.steps + 1}: {problem}"
    return comparison


def compare_scenes(handIn, limits):
    """Compares the steps of all SCENES: a dict from (name, item of the marks) to Comparison."""
    return {
        (name, item): compare_steps(source_of(name), handIn, limits, steps)
        for name, (item, steps) in SCENES.items()
    }


def source_of(scene, constraints=None):
    """Returns the SceneSource of a scene, by name or path. Raises SceneError."""
    source = SceneSource.of_files(find_scene(scene), constraints)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of meshes that are not convex
        source.make()
    return source


def main(given):
    source = source_of(given.scene, given.constraints)
    settings = Settings(timeStep=given.time_step, restitution=given.restitution)
    handIn = read_submission(given.code)
    result = compare_steps(source, handIn, given, given.steps, settings, given.set, bar=True)
    if result.problem.startswith("cannot be imported"):
        raise InputError(f"{given.code}: {result.problem}")
    verb = "agrees" if result.steps == 1 else "agree"
    agree = f"{counted(result.steps, 'step')} {verb}; the largest relative difference is "
    agree += f"{result.largest:.1e}"
    for line in (*handIn.remarks, *result.told(), result.problem or agree, *result.terms):
        print(one_line(line))
    return FAILED if result.problem else PASSED


def own_parameters(text):
    """Returns a dict of NAME=VALUE,...: numbers, true, false, or texts. Raises ValueError."""
    found = {}
    for one in text.split(","):
        name, sign, value = one.partition("=")
        if not sign or not name.isidentifier():
            raise ValueError(f"'{short(one)}' is not NAME=VALUE")
        found[name] = {"true": True, "false": False}.get(value.lower(), value)
        for kind in (float, int):
            with suppress(ValueError):
                found[name] = kind(value)
    return found


def make_parser():
    form = argparse.RawDescriptionHelpFormatter
    parser = OneLineParser(description=__doc__, formatter_class=form)
    add = parser.add_argument
    add("code", metavar="CODE", help="a student's folder or ZIP; a copy of it is run")
    add("scene", metavar="SCENE", help="a scene file, or the name of a scene of data/")
    add("--constraints", metavar="FILE", help="constraints (default: those beside the scene)")
    text = "number of steps to compare (default: %(default)s)"
    add("--steps", metavar="N", type=number_type(int, 1), default=STEPS, help=text)
    for option, default in (("time-step", TIME_STEP), ("restitution", RESTITUTION)):
        text = BY_OPTION[option]
        form = {"type": option_type(text.parsed), "default": default}
        text = text.help.partition(". ")[0]
        add(f"--{option}", metavar="X", help=f"{text} (default: {default})", **form)
    text = "parameters of the student's run_timestep"
    add("--set", metavar="NAME=VALUE,...", type=option_type(own_parameters), help=text)
    add_limit_arguments(parser)
    return parser


if __name__ == "__main__":
    sys.exit(run_program(make_parser(), main))
