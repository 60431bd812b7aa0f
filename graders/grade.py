"""Grade submissions: all three graders on each, side by side, none harming another.

    python graders/grade.py SUBMISSION... [--convention exact|released-2024] [--scenes]

A SUBMISSION is a ZIP, a folder with RBSFunctions.py in it, or a folder of such. Prints a table, and
writes grades.csv and a Markdown sheet for each submission. The exit code is 0 if all pass, 1 if one
does not, and 2 for what cannot be graded at all.
"""

import argparse
import os
import sys
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path

import Constraints
import integrationGrading
import ResolveCollisionsGrading
from archives import find_submissions, modules_of
from gradeReport import Grade
from graderProgram import grade_submission
from gradingTools import (
    BAD_DATA,
    DATA_DIRECTORY,
    FAILED,
    PASSED,
    STOPPED,
    GraderDataError,
    OneLineParser,
    add_convention_argument,
    printable,
)
from isolation import add_limit_arguments, limits_of, stop_all
from scenePictures import SCENES, draw_scene
from sheets import print_table, write_csv, write_sheet

from rbs.submissions import SubmissionError

GRADERS = (integrationGrading.GRADER, ResolveCollisionsGrading.GRADER, Constraints.GRADER)
DEFAULT_OUT = Path("out") / "grades"
MOST_JOBS = 64


@dataclass
class Outcome:
    """What has become of a submission.

    name; grades : dict from a grader's module to its Grade; refusal : why there are none, or ""
    remarks : list of str; scenes : list of `scenePictures.ScenePictures`; seconds : it took
    """

    name: str
    grades: dict[str, Grade] = field(default_factory=dict)
    refusal: str = ""
    remarks: list = field(default_factory=list)
    scenes: list = field(default_factory=list)
    seconds: float = 0.0

    @property
    def passes(self):
        return not self.refusal and not any(grade.failures for grade in self.grades.values())


def grade_entry(entry, dataFolder, data, limits, picturesFolder):
    """The Outcome of a submission. data : dict from a grader's module to its data

    picturesFolder : for pictures of scenes, or None for none
    """
    outcome = Outcome(entry.name)
    begin = time.perf_counter()
    try:
        with modules_of(entry) as (folder, where):
            if where:
                outcome.remarks.append(printable(f"modules found in {where}"))
            for grader in GRADERS:
                outcome.grades[grader.module] = grade_submission(
                    grader, folder, dataFolder, data[grader.module], limits
                )
            if picturesFolder is not None:
                outcome.scenes = [
                    draw_scene(scene, folder, picturesFolder / entry.name, limits)
                    for scene in SCENES
                ]
    except SubmissionError as error:
        outcome.grades.clear()
        outcome.refusal = str(error)
    except OSError as error:
        outcome.grades.clear()
        outcome.refusal = printable(f"cannot be graded: {error.strerror or error}")
    outcome.seconds = time.perf_counter() - begin
    return outcome


def make_parser():
    parser = OneLineParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "submissions", metavar="SUBMISSION", nargs="+", help="a folder, a ZIP, or a folder of them"
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        default=DEFAULT_OUT,
        help="where grades.csv and the sheets are written (default: %(default)s)",
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
    parser.add_argument(
        "--scenes",
        action="store_true",
        help=f"run {', '.join(SCENES)} with each submission, and put pictures into its sheet",
    )
    parser.add_argument(
        "--jobs",
        metavar="N",
        type=int,
        default=os.cpu_count() or 1,
        help="how many submissions are graded at a time (default: as many as there are processors)",
    )
    return parser


def show_progress(count, total):
    """How many are graded, on stderr if that is a terminal."""
    if sys.stderr.isatty():
        end = "\n" if count == total else ""
        print(f"\r{count} of {total} graded", end=end, file=sys.stderr, flush=True)


def main():
    parser = make_parser()
    arguments = parser.parse_args()
    if not 1 <= arguments.jobs <= MOST_JOBS:
        parser.error(f"--jobs must lie between 1 and {MOST_JOBS}, not {arguments.jobs}")
    try:
        entries = find_submissions(arguments.submissions)
        data = {}
        for grader in GRADERS:
            path = arguments.data / grader.fileName
            data[grader.module] = grader.load(arguments.data, arguments.convention)
        convention = ", ".join(dict.fromkeys(one["convention"] for one in data.values()))
        path = arguments.out
        arguments.out.mkdir(parents=True, exist_ok=True)
    except SubmissionError as problem:
        parser.exit(BAD_DATA, printable(f"{parser.prog}: {problem}") + "\n")
    except GraderDataError as problem:
        parser.exit(BAD_DATA, printable(f"{parser.prog}: {path}: {problem}") + "\n")
    except OSError as problem:
        parser.exit(BAD_DATA, printable(f"{parser.prog}: {path}: {problem.strerror}") + "\n")

    begin = time.perf_counter()
    pictures = arguments.out / "pictures" if arguments.scenes else None
    with ThreadPoolExecutor(arguments.jobs) as executor:
        waiting = [
            executor.submit(
                grade_entry, entry, arguments.data, data, limits_of(arguments), pictures
            )
            for entry in entries
        ]  # fmt: skip
        try:
            for count, _done in enumerate(as_completed(waiting), start=1):
                show_progress(count, len(waiting))
        except KeyboardInterrupt:
            executor.shutdown(wait=False, cancel_futures=True)
            stop_all()
            parser.exit(STOPPED, f"{parser.prog}: stopped by Ctrl-C\n")
    outcomes = [one.result() for one in waiting]
    print_table(outcomes)
    try:
        write_csv(arguments.out / "grades.csv", outcomes, convention)
        for outcome in outcomes:
            write_sheet(arguments.out / f"{outcome.name}.md", outcome, convention)
    except OSError as problem:
        where = problem.filename or arguments.out
        parser.exit(BAD_DATA, printable(f"{parser.prog}: {where}: {problem.strerror}") + "\n")
    passed = sum(outcome.passes for outcome in outcomes)
    print()
    print(
        f"{passed} of {len(outcomes)} pass, convention {convention}, "
        f"{time.perf_counter() - begin:.1f} s; sheets and grades.csv in {arguments.out}"
    )
    return PASSED if passed == len(outcomes) else FAILED


if __name__ == "__main__":
    sys.exit(main())
