"""The command line of the three graders, and its parts that `grade.py` and `compare.py` share."""

import argparse
import os
import re
import secrets
import sys
from pathlib import Path

import numpy as np
from isolated.archives import read_submission
from isolated.processes import add_limit_arguments, run_isolated
from reference.graderData import DATA_DIRECTORY
from verdict.gradeReport import make_grade

from classwork.marks import SCHEME
from rbs.program.parsing import OneLineParser, number_type
from rbs.scenes.files import signals_kept, signals_raised
from rbs.scenes.messages import InputError, cause_of, one_line

PASSED, FAILED, BAD_DATA = 0, 1, 2
STOPPED = 130  # 128 + SIGINT, the shell's code for a program that Ctrl-C ended
# Exceptions that code for another Python or NumPy raises: syntax, what their modules lack, and
# conversions and products that were allowed.
_MODULES = "|".join(sorted({*sys.stdlib_module_names, "numpy"}))
OTHER_VERSION = re.compile(
    rf"SyntaxError|removed in the NumPy|(module|from|named) '({_MODULES})\b"
    r"|'numpy\.\w+' object has no|avoid copy"
    r"|\d-dimensional (arrays|vectors)|length-1 arrays|element with a sequence"
)
VERSIONS = (
    f"a person should look: the code may be for another Python than {sys.version.split()[0]}, "
    f"or another NumPy than {np.__version__}"
)


def run_grader(description, grader):
    """Runs a grader's command line; returns the exit code."""
    parser = make_parser(description, seconds=10)
    text = "grade the modules in this folder or ZIP (default: the project's own)"
    parser.add_argument("--modules", metavar="CODE", help=text)

    def main(arguments):
        data = grader.load(arguments.data, arguments.seed)
        fresh = f"samples from {data['inFile']} on are fresh, by --seed {arguments.seed}"
        remarks = [f"data {arguments.data / grader.fileName}; {fresh}"]
        if arguments.modules is None:
            import Quaternion
            import RBSFunctions

            outcomes = grader.judge(RBSFunctions, Quaternion, data)
            grade = make_grade(grader, outcomes, data)
        else:
            handIn, given = read_submission(arguments.modules), {grader.module: data}
            grades, told = grade_submission([grader], handIn, given, arguments)
            grade = grades[grader.module]
            remarks += [f"modules {arguments.modules}", *told]
        grade.remarks += remarks
        print(*grade.lines(what_next(grader, grade) if arguments.modules else ()), sep="\n")
        return FAILED if grade.wrong else PASSED

    return run_program(parser, main)


# What follows when a grader passes.
NEXT = {"integrationGrading": "ResolveCollisionsGrading.py"}
NEXT |= {"ResolveCollisionsGrading": "Constraints.py", "Constraints": "compare.py"}


def what_next(grader, grade):
    """Names what to write or correct next, a function with its marks, or else the next program."""
    if not grade.wrong:
        return [f"Next: {NEXT[grader.module]}"]
    if any(text.startswith("cannot be imported") for _names, text in grade.notes):
        return ["Next: correct what keeps RBSFunctions.py from being imported"]
    function = grade.wrong[0].function
    return [f"Next: {function}, {SCHEME[function]} marks"]


def make_parser(description, seconds=30):
    """Returns a parser with the options that all graders share."""
    form = argparse.RawDescriptionHelpFormatter
    parser = OneLineParser(description=description, formatter_class=form)
    text = "folder of the graders' data (default: the project's data)"
    parser.add_argument("--data", metavar="DIR", type=Path, default=DATA_DIRECTORY, help=text)
    text = "seed of the fresh samples (default: another one each time)"
    form = {"type": number_type(int, 0, 1 << 32)}
    form["default"] = secrets.randbelow(1 << 32)
    parser.add_argument("--seed", metavar="N", **form, help=text)
    add_limit_arguments(parser, seconds)
    return parser


def run_program(parser, main):
    """Calls `main` with the arguments; SIGTERM ends it as Ctrl-C does.

    Returns the exit code: that of `main`, or BAD_DATA or STOPPED after one line on stderr.
    """
    arguments = parser.parse_args()
    try:
        with signals_raised(), signals_kept():
            code = main(arguments)
            print(end="", flush=True)
        return code
    except InputError as problem:
        code, cause = BAD_DATA, problem
    except OSError as problem:
        code, cause = BAD_DATA, cause_of(problem)
        if problem.filename is None:  # what could not be printed is not to be tried again
            sys.stdout = open(os.devnull, "w")
        if isinstance(problem, BrokenPipeError):  # of `| head`
            code, cause = STOPPED, "the output was closed"
    except KeyboardInterrupt as problem:
        told = [one for one in problem.args if isinstance(one, str)]
        code, cause = STOPPED, " ".join(["stopped", *told])
    print(f"{parser.prog}: {one_line(cause)}", file=sys.stderr)
    return code


def grade_submission(graders, handIn, data, arguments):
    """Grades a HandIn; returns (dict from a grader's module to its Grade, remarks).

    data : dict from a grader's module to its data; arguments : of the command line
    """
    outcomes, remarks = run_isolated(graders, handIn, data, arguments)
    grades = {
        one.module: make_grade(one, outcomes[one.module], data[one.module]) for one in graders
    }
    remarks = [*handIn.remarks, *remarks]
    notes = [text for grade in grades.values() for _what, text in grade.notes]
    if any(map(OTHER_VERSION.search, notes)):
        remarks.append(VERSIONS)
    return grades, remarks
