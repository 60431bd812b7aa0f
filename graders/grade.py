"""Grade submissions: all three graders on each, side by side, none harming another.

    python graders/grade.py SUBMISSION... [--resume] [--scenes] [--anonymous]

A SUBMISSION is a folder with RBSFunctions.py in it, a ZIP or tar of one, or a folder of such, as
Moodle and Canvas give them. What is written, after each submission: grades.csv, marks.csv, a
Markdown sheet, and a results.json for Gradescope; and in the end a table, a summary of the class,
and likeness.csv, the pairs of submissions whose code is alike. The exit code is 0 if all pass, 1 if
one does not, and 2 for what cannot be graded at all.
"""

import argparse
import dataclasses
import os
import random
import sys
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import Constraints
import integrationGrading
import ResolveCollisionsGrading
from archives import find_submissions, modules_of
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
from isolation import Stopped, add_limit_arguments, limits_of, prepare_terminal, stop_all
from likeness import fingerprint, origin_remarks, write_likeness
from marks import DEFAULT_SCHEME, load_scheme, marks_row, write_gradescope
from scenePictures import SCENES, draw_scene
from sheets import (
    GRADES,
    passes,
    read_rows,
    rows_of,
    summary_of,
    table_of,
    write_rows,
    write_sheet,
)

from rbs.submissions import SubmissionError

GRADERS = (integrationGrading.GRADER, ResolveCollisionsGrading.GRADER, Constraints.GRADER)
DEFAULT_OUT = Path("out") / "grades"
MOST_JOBS = 64
KEY = ("id", "name", "path")


@dataclass
class Outcome:
    """What has become of a submission.

    name, path : as they are shown; refusal : why there are no grades, or ""; remarks : list of str
    grades, conventions : dicts from a grader's module to its Grade, and to its data's convention
    scenes : list of objects with `name`, `problem`, "" if all is right, and `pictures`
    seconds : it took; fingerprint : of its code, for `likeness`
    """

    name: str
    path: str
    grades: dict = field(default_factory=dict)
    conventions: dict = field(default_factory=dict)
    refusal: str = ""
    remarks: list = field(default_factory=list)
    scenes: list = field(default_factory=list)
    seconds: float = 0.0
    fingerprint: frozenset = frozenset()


def grade_entry(entry, isKnown, dataFolder, data, limits, picturesFolder):
    """The Outcome of a submission.

    isKnown : whether it has been graded before, and only its fingerprint is asked for
    data : dict from a grader's module to its data; picturesFolder : of scenes, or None for none
    """
    outcome = Outcome(entry.name, "" if entry.isAnonymous else str(entry.path))
    begin = time.perf_counter()
    try:
        with modules_of(entry) as (folder, remarks):
            outcome.fingerprint = fingerprint(folder)
            if isKnown:
                return outcome
            remarks += origin_remarks(folder)
            outcome.grades = grade_submission(GRADERS, folder, dataFolder, data, limits)
            for grader in GRADERS:
                outcome.conventions[grader.module] = data[grader.module]["convention"]
                common = grader.remarks(data[grader.module])
                own = outcome.grades[grader.module].remarks
                remarks += [one for one in own if one not in common]
            outcome.remarks = [printable(one) for one in dict.fromkeys(remarks)]
            if picturesFolder is not None:
                pictures = picturesFolder / entry.name
                outcome.scenes = [draw_scene(one, folder, pictures, limits) for one in SCENES]
    except SubmissionError as error:
        outcome.grades.clear()
        outcome.refusal = str(error)
    except OSError as error:
        outcome.grades.clear()
        outcome.refusal = printable(f"cannot be graded: {error.strerror or error}")
    outcome.seconds = time.perf_counter() - begin
    return outcome


class Ledger:
    """The rows of grades.csv and marks.csv, in the order of the submissions, and the other files.

    marks, grades : dicts from a submission's name to its row, and to its list of rows
    """

    def __init__(self, out, names, scheme, resumes):
        """resumes : whether the rows that are there are kept. OSError, SubmissionError"""
        self._out, self._names, self._scheme = out, names, scheme
        self._columns = ("submission", "path", *scheme, "total", "of", "seconds", "remarks")
        self.marks, self.grades = {}, {}
        if resumes:
            for row in read_rows(out / "marks.csv", self._columns):
                self.marks[row["submission"]] = row
            for row in read_rows(out / "grades.csv", GRADES):
                if row["submission"] in self.marks:
                    self.grades.setdefault(row["submission"], []).append(row)
        self.save()

    def save(self):
        names = [name for name in self._names if name in self.grades]
        rows = [row for name in names for row in self.grades[name]]
        write_rows(self._out / "grades.csv", GRADES, rows)
        rows = [self.marks[name] for name in names if name in self.marks]
        write_rows(self._out / "marks.csv", self._columns, rows)

    def add(self, outcome):
        """Takes in an Outcome, and writes all that there is of it. OSError"""
        name, remarks = outcome.name, " | ".join(outcome.remarks)
        self.grades[name] = rows_of(outcome)
        self.marks[name] = {
            "submission": name, "path": outcome.path, **marks_row(outcome, self._scheme),
            "seconds": f"{outcome.seconds:.1f}", "remarks": outcome.refusal or remarks,
        }  # fmt: skip
        self.save()
        write_sheet(self._out / f"{name}.md", outcome, self.marks[name])
        write_gradescope(self._out / "gradescope" / name / "results.json", outcome, self._scheme)


def anonymous(entries, path):
    """The entries in a random order under numbers; the key is kept in a file. OSError

    A key that is there already keeps its numbers.
    """
    numbers = {row["path"]: row["id"] for row in read_rows(path, KEY)}
    new = [entry for entry in entries if str(entry.path) not in numbers]
    random.shuffle(new)
    for entry in new:
        numbers[str(entry.path)] = f"{len(numbers) + 1:03}"
    found = sorted((numbers[str(entry.path)], entry) for entry in entries)
    write_rows(path, KEY, [dict(zip(KEY, (k, e.name, e.path), strict=True)) for k, e in found])
    return [dataclasses.replace(entry, name=k, isAnonymous=True) for k, entry in found]


def make_parser():
    parser = OneLineParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "submissions", metavar="SUBMISSION", nargs="+", help="a folder, a ZIP or tar, or a folder of them"
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=Path,
        default=DEFAULT_OUT,
        help="where all is written (default: %(default)s)",
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        help="keep the rows of an earlier run that was stopped, and grade the others",
    )
    parser.add_argument(
        "--marks",
        metavar="FILE",
        type=Path,
        default=DEFAULT_SCHEME,
        help="how many marks each part gives (default: graders/marks.ini)",
    )
    parser.add_argument(
        "--scenes",
        action="store_true",
        help=f"run {', '.join(SCENES)} with each submission, and put pictures into its sheet",
    )
    parser.add_argument(
        "--anonymous",
        action="store_true",
        help="write numbers in place of names and paths, and the key to them into another file",
    )
    parser.add_argument(
        "--key",
        metavar="FILE",
        type=Path,
        help="the file that says whose number is whose (default: beside --out, DIR-key.csv)",
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
    if arguments.key and not arguments.anonymous:
        parser.error("--key goes with --anonymous")
    prepare_terminal()
    begin, out = time.perf_counter(), arguments.out

    def leave(code, text):
        parser.exit(code, printable(f"{parser.prog}: {text}") + "\n")

    try:
        entries = find_submissions(arguments.submissions)
        data = {}
        for grader in GRADERS:
            path = arguments.data / grader.fileName
            data[grader.module] = grader.load(arguments.data, arguments.convention)
        path = arguments.marks
        scheme = load_scheme(path, [part.name for grader in GRADERS for part in grader.parts])
        path = out
        out.mkdir(parents=True, exist_ok=True)
        if arguments.anonymous:
            path = out.resolve()
            entries = anonymous(entries, arguments.key or path.with_name(f"{path.name}-key.csv"))
        ledger = Ledger(out, [entry.name for entry in entries], scheme, arguments.resume)
    except SubmissionError as problem:
        leave(BAD_DATA, problem)
    except GraderDataError as problem:
        leave(BAD_DATA, f"{path}: {problem}")
    except OSError as problem:
        leave(BAD_DATA, f"{problem.filename or path}: {problem.strerror}")

    known = set(ledger.grades)
    pictures = out / "pictures" if arguments.scenes else None
    prints, trouble = {}, None
    with ThreadPoolExecutor(arguments.jobs) as executor:
        given = arguments.data, data, limits_of(arguments), pictures
        waiting = [executor.submit(grade_entry, one, one.name in known, *given) for one in entries]
        try:
            for count, done in enumerate(as_completed(waiting), start=1):
                outcome = done.result()
                prints[outcome.name] = outcome.fingerprint
                if outcome.name not in known:
                    try:
                        ledger.add(outcome)
                    except OSError as problem:  # such as a table that is open in Excel
                        trouble = problem
                show_progress(count, len(waiting))
        except (KeyboardInterrupt, Stopped) as problem:
            executor.shutdown(wait=False, cancel_futures=True)
            stop_all()
            with suppress(OSError):
                ledger.save()
            code = problem.args[0] if problem.args else STOPPED
            leave(code, f"stopped with {len(ledger.marks)} of {len(entries)} graded, which are in "
                  f"{out}; --resume goes on")  # fmt: skip
    rows = [row for entry in entries for row in ledger.grades[entry.name]]
    passed = sum(passes(ledger.grades[entry.name]) for entry in entries)
    summary = summary_of(rows, [float(row["total"]) for row in ledger.marks.values()])
    try:
        ledger.save()
        count = write_likeness(out / "likeness.csv", {one.name: prints[one.name] for one in entries})
        if trouble:
            raise trouble
    except OSError as problem:
        leave(BAD_DATA, f"{problem.filename or out}: {problem.strerror}")
    try:
        print("\n".join([*table_of(rows), "", *summary, f"{count} pairs are alike", ""]))
        print(f"{passed} of {len(entries)} pass, {time.perf_counter() - begin:.1f} s; "
              f"grades.csv, marks.csv and sheets in {out}", flush=True)  # fmt: skip
    except BrokenPipeError:
        sys.stdout = open(os.devnull, "w")
        print(f"{parser.prog}: the output was closed; all is in {out}", file=sys.stderr)
    return PASSED if passed == len(entries) else FAILED


if __name__ == "__main__":
    sys.exit(main())
