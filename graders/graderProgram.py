"""The command line of the three graders, and what it shares with that of `grade.py`."""

import argparse
import os
import signal
import sys
from pathlib import Path

from archives import find_submission, modules_of
from conventions import Bodies
from gradeReport import make_grade
from gradingTools import (
    BAD_DATA,
    DATA_DIRECTORY,
    STOPPED,
    GraderDataError,
    OneLineParser,
    add_convention_argument,
    printable,
)
from isolation import add_limit_arguments, run_isolated
from likeness import origin_remarks
from trials import Results

from rbs.program.submissions import SubmissionError


def run_grader(description, grader):
    """Runs a grader's command line; returns the exit code, PASSED, FAILED or as `run_program`."""
    parser = make_parser(description)
    parser.add_argument(
        "--modules",
        metavar="DIR",
        help="grade the RBSFunctions.py and Quaternion.py of this folder, a copy of which is run "
        "in a process of its own (default: the project's)",
    )

    def main(arguments):
        data = load_data([grader], arguments)
        remarks = [f"data {arguments.data / grader.fileName}"]
        if arguments.modules is None:
            grade = grade_own_modules(grader, data[grader.module])
        else:
            with modules_of(find_submission(arguments.modules)) as (folder, found):
                (grade,) = grade_submission([grader], folder, data, arguments).values()
                remarks += [f"modules {arguments.modules}", *found, *origin_remarks(folder)]
        grade.remarks += map(printable, remarks)
        return grade.report()

    return run_program(parser, main)


def make_parser(description):
    parser = OneLineParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--data",
        metavar="DIR",
        type=Path,
        default=DATA_DIRECTORY,
        help="the folder that holds the graders' data (default: the project's data)",
    )
    add_convention_argument(parser, default=None)
    add_limit_arguments(parser)
    return parser


def run_program(parser, main):
    """Calls `main` with the arguments; returns what it does, or else BAD_DATA or STOPPED, after one
    line on stderr that says why. SIGTERM ends it as Ctrl-C does."""
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    for stream in (sys.stdout, sys.stderr):  # hints have letters that not every terminal has
        stream.reconfigure(errors="replace")
    try:
        code = main(arguments)
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # of `| head`
        sys.stdout = open(os.devnull, "w")
        code, cause = STOPPED, "the output was closed"
    except (SubmissionError, GraderDataError) as problem:
        code, cause = BAD_DATA, problem
    except OSError as problem:
        code, cause = BAD_DATA, f"{problem.filename}: {problem.strerror}"
    except KeyboardInterrupt as problem:
        code, cause = STOPPED, " ".join(["stopped", *map(str, problem.args)])
    print(f"{parser.prog}: {printable(str(cause))}", file=sys.stderr)
    return code


def load_data(graders, arguments):
    """A dict from each grader's module to its data. GraderDataError names the file."""
    data = {}
    for grader in graders:
        try:
            data[grader.module] = grader.load(arguments.data, arguments.convention)
        except GraderDataError as problem:
            raise GraderDataError(f"{arguments.data / grader.fileName}: {problem}") from None
    return data


def grade_own_modules(grader, data):
    """The Grade of this project's modules, which run in this process."""
    import Quaternion
    import RBSFunctions

    bodies = Bodies(RBSFunctions, Quaternion, data)
    outcomes = []
    for part in grader.asked(data, withExtras=False):
        results = Results(part.shapes, len(data["randomPositions"]))
        part.run(bodies, data, part.samples(data), results)
        outcomes.append((part, results))
    return make_grade(grader, outcomes, data)


def grade_submission(graders, folder, data, arguments):
    """A dict from each grader's module to the Grade of a student's modules.

    folder : with the modules, of which a copy is run
    data : dict from a grader's module to its data; arguments : where they are from, and the limits
    """
    outcomes = run_isolated(graders, folder, arguments.data, data, arguments)
    return {one.module: make_grade(one, outcomes[one.module], data[one.module]) for one in graders}
