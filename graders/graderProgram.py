"""The command line of the three graders."""

import argparse
import sys
from pathlib import Path

from archives import find_submissions, modules_of
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
from isolation import (
    Limits,
    Stopped,
    add_limit_arguments,
    limits_of,
    prepare_terminal,
    run_isolated,
)
from likeness import origin_remarks
from trials import Results

from rbs.submissions import SubmissionError


def run_grader(description, grader):
    """Runs a grader's command line; returns the exit code.

    Exit codes: PASSED, FAILED, or BAD_DATA with one line on stderr.
    """
    parser = OneLineParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--data",
        metavar="DIR",
        type=Path,
        default=DATA_DIRECTORY,
        help=f"the folder that holds {grader.fileName} (default: the project's data)",
    )
    add_convention_argument(parser, default=None)
    parser.add_argument(
        "--modules",
        metavar="DIR",
        type=Path,
        help="grade the RBSFunctions.py and Quaternion.py of this folder, a copy of which is run "
        "in a process of its own (default: the project's)",
    )
    add_limit_arguments(parser)
    arguments = parser.parse_args()
    limits = limits_of(arguments)
    if arguments.modules is None and limits != Limits():
        parser.error("--time-limit and --memory-limit go with --modules")
    prepare_terminal()
    path = arguments.data / grader.fileName
    try:
        data = grader.load(arguments.data, arguments.convention)
        remark = f"data {path}, convention {data['convention']}"
        if arguments.modules is None:
            grade = grade_own_modules(grader, data)
        else:
            given = {grader.module: data}
            (entry,) = find_submissions([arguments.modules])
            with modules_of(entry) as (folder, remarks):
                grades = grade_submission([grader], folder, arguments.data, given, limits)
                grade = grades[grader.module]
                grade.remarks += [*remarks, *origin_remarks(folder)]
            remark += f", modules {arguments.modules}"
    except GraderDataError as problem:
        print(printable(f"{parser.prog}: {path}: {problem}"), file=sys.stderr)
        return BAD_DATA
    except SubmissionError as problem:
        print(printable(f"{parser.prog}: {problem}"), file=sys.stderr)
        return BAD_DATA
    except (KeyboardInterrupt, Stopped) as problem:
        print(f"{parser.prog}: stopped", file=sys.stderr)
        return STOPPED
    grade.remarks.append(printable(remark))
    return grade.report()


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


def grade_submission(graders, folder, dataFolder, data, limits):
    """A dict from a grader's module to the Grade of a student's modules.

    folder : with the modules, of which a copy is run; dataFolder : where the data come from
    data : dict from a grader's module to its data. Raises GraderDataError.
    """
    outcomes = run_isolated(graders, folder, dataFolder, data, limits)
    return {
        grader.module: make_grade(grader, outcomes[grader.module], data[grader.module])
        for grader in graders
    }
