"""Grade submissions: all three graders on each, side by side, none harming another.

    python graders/grade.py SUBMISSION... [--resume] [--scenes] [--anonymous]

A SUBMISSION is a folder with RBSFunctions.py in it, a ZIP or tar of one, or a folder of such, as
Moodle and Canvas give them. After each one, these are written: grades.csv, marks.csv, its Markdown
sheet, and its results.json for Gradescope. In the end come a table, a summary of the class, and
likeness.csv, the pairs of submissions whose code is alike. The exit code is 0 if all pass, 1 if one
does not, and 2 for what cannot be graded at all.
"""

import os
import random
import sys
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from pathlib import Path

import Constraints
import integrationGrading
import ResolveCollisionsGrading
from archives import find_submissions, modules_of
from compare import SCENES, compare_scene
from graderProgram import grade_submission, load_data, make_parser, run_program
from gradingTools import FAILED, PASSED, printable
from isolation import stop_all
from likeness import fingerprint, origin_remarks, write_likeness
from marks import DEFAULT_SCHEME, SCENE_MARKS, load_scheme, marks_row, write_gradescope
from sheets import (
    BETWEEN,
    GRADES,
    passes,
    print_table,
    read_rows,
    rows_of,
    summary_of,
    write_rows,
    write_sheet,
)
from tqdm import tqdm

from rbs.program.options import at_least, option_type
from rbs.program.submissions import SubmissionError

GRADERS = (integrationGrading.GRADER, ResolveCollisionsGrading.GRADER, Constraints.GRADER)
JOBS = option_type(int, at_least(1, 64), "whole number")
KEY = ("id", "name", "path")


@dataclass
class Outcome:
    """What has become of a submission.

    name, path : as they are shown; refusal : why there are no grades, or ""; remarks : list of str
    grades, conventions : dicts from a grader's module to its Grade, and to its data's convention
    scenes : list of `compare.SceneResult`
    seconds : it took; fingerprint : of its code, for `likeness`
    """

    name: str
    path: str
    conventions: dict
    grades: dict = field(default_factory=dict)
    refusal: str = ""
    remarks: list = field(default_factory=list)
    scenes: list = field(default_factory=list)
    seconds: float = 0.0
    fingerprint: frozenset = frozenset()


def grade_entry(entry, isKnown, data, arguments):
    """The Outcome of a submission; of one that is known already, its fingerprint only.

    data : dict from a grader's module to its data
    """
    begin = time.perf_counter()
    conventions = {module: one["convention"] for module, one in data.items()}
    outcome = Outcome(entry.name, "" if entry.isAnonymous else str(entry.path), conventions)
    try:
        with modules_of(entry) as (folder, remarks):
            outcome.fingerprint = fingerprint(folder)
            if isKnown:
                return outcome
            grades = grade_submission(GRADERS, folder, data, arguments)
            remarks += origin_remarks(folder)
            for grader in GRADERS:
                common = grader.remarks(data[grader.module])
                remarks += [one for one in grades[grader.module].remarks if one not in common]
            outcome.remarks = [printable(one) for one in dict.fromkeys(remarks)]
            if arguments.scenes:
                pictures = arguments.out / "pictures" / entry.name
                outcome.scenes = [compare_scene(one, folder, pictures, arguments) for one in SCENES]
                found = [f"{one.name}: {one.problem}" for one in outcome.scenes if one.problem]
                outcome.remarks += map(printable, found)
            outcome.grades = grades
    except SubmissionError as error:
        outcome.refusal = str(error)
    except Exception as error:  # a mistake of ours in one must not cost the others their grades
        outcome.refusal = printable(f"cannot be graded: {type(error).__name__}: {error}")
    outcome.seconds = time.perf_counter() - begin
    return outcome


class Ledger:
    """The rows of grades.csv and marks.csv, in the order of the submissions, and the other files.

    marks, grades : dicts from a submission's name to its row, and to its list of rows
    """

    def __init__(self, arguments, names, scheme):
        self._out, self._names, self._scheme = arguments.out, names, scheme
        self._columns = ("submission", "path", *scheme, "total", "of", "seconds", "remarks")
        self.marks, self.grades = {}, {}
        if arguments.resume:
            rows = read_rows(self._out / "marks.csv", self._columns)
            self.marks = {row["submission"]: row for row in rows if row["submission"] in names}
            for row in read_rows(self._out / "grades.csv", GRADES):
                if row["submission"] in self.marks:
                    self.grades.setdefault(row["submission"], []).append(row)
        self.save()

    def rows(self):
        return [row for name in self._names for row in self.grades.get(name, ())]

    def save(self):
        """Writes both files, whole. OSError"""
        marks = [self.marks[name] for name in self._names if name in self.marks]
        write_rows(self._out / "grades.csv", GRADES, self.rows())
        write_rows(self._out / "marks.csv", self._columns, marks)

    def add(self, outcome):
        """Takes in an Outcome, and writes all that there is of it, its rows last. OSError"""
        name = outcome.name
        row = marks_row(outcome, self._scheme) | {
            "submission": name,
            "path": outcome.path,
            "seconds": f"{outcome.seconds:.1f}",
            "remarks": outcome.refusal or BETWEEN.join(outcome.remarks),
        }
        write_sheet(self._out / f"{name}.md", outcome, row)
        write_gradescope(self._out / "gradescope" / name / "results.json", outcome, self._scheme)
        self.grades[name], self.marks[name] = rows_of(outcome), row
        self.save()


def anonymous(entries, path):
    """The entries in a random order under numbers; path : of the file that says whose they are.

    Who has a number there already keeps it. Raises OSError, SubmissionError.
    """
    rows = {row["path"]: row for row in read_rows(path, KEY)}
    for one in random.sample(entries, len(entries)):
        row = dict(zip(KEY, (f"{len(rows) + 1:03}", one.name, str(one.path)), strict=True))
        rows.setdefault(row["path"], row)
    write_rows(path, KEY, sorted(rows.values(), key=lambda row: row["id"]))
    entries = [replace(one, name=rows[str(one.path)]["id"], isAnonymous=True) for one in entries]
    return sorted(entries, key=lambda one: one.name)


def make_options():
    parser = make_parser(__doc__)
    option = parser.add_argument
    option(
        "submissions",
        metavar="SUBMISSION",
        nargs="+",
        help="a folder, a ZIP or tar, or a folder of them",
    )
    option(
        "--out",
        metavar="DIR",
        type=Path,
        default=Path("out") / "grades",
        help="the folder for all that is written (default: %(default)s)",
    )
    option(
        "--resume",
        action="store_true",
        help="keep what an earlier run has graded before it was stopped",
    )
    option(
        "--marks",
        metavar="FILE",
        type=Path,
        default=DEFAULT_SCHEME,
        help="the marks that each part gives (default: graders/marks.ini)",
    )
    option(
        "--scenes",
        action="store_true",
        help=f"compare the steps of {', '.join(SCENES)} with ours, too",
    )
    option("--anonymous", action="store_true", help="write numbers in place of names and paths")
    option(
        "--key",
        metavar="FILE",
        type=Path,
        help="the file that says whose number is whose (default: DIR-key.csv)",
    )
    option(
        "--jobs",
        metavar="N",
        type=JOBS,
        default=os.cpu_count() or 1,
        help="how many are graded at a time (default: one for each processor)",
    )
    return parser


def main(arguments):
    begin, out = time.perf_counter(), arguments.out
    entries = find_submissions(arguments.submissions)
    data = load_data(GRADERS, arguments)
    scheme = load_scheme(arguments.marks, GRADERS, data)
    if not arguments.scenes:
        scheme.pop(SCENE_MARKS, None)
    out.mkdir(parents=True, exist_ok=True)
    if arguments.anonymous:
        beside = out.resolve().with_name(f"{out.resolve().name}-key.csv")
        entries = anonymous(entries, arguments.key or beside)
    ledger = Ledger(arguments, [entry.name for entry in entries], scheme)

    known, prints, trouble = set(ledger.grades), {}, None
    with ThreadPoolExecutor(arguments.jobs) as executor:
        try:
            waiting = [
                executor.submit(grade_entry, entry, entry.name in known, data, arguments)
                for entry in entries
            ]
            for done in tqdm(
                as_completed(waiting), total=len(waiting), disable=None, unit=" graded"
            ):
                outcome = done.result()
                prints[outcome.name] = outcome.fingerprint
                try:
                    if outcome.name not in known:
                        ledger.add(outcome)
                except OSError as problem:  # such as a table that is open in Excel
                    trouble = problem
        except KeyboardInterrupt:
            executor.shutdown(wait=False, cancel_futures=True)
            stop_all()
            ledger.save()
            raise KeyboardInterrupt(
                f"with {len(ledger.marks)} of {len(entries)} graded; --resume goes on"
            ) from None
    ledger.save()
    alike = write_likeness(out / "likeness.csv", {one.name: prints[one.name] for one in entries})
    if trouble:
        raise trouble
    rows = ledger.rows()
    passed = sum(passes(ledger.grades[entry.name]) for entry in entries)
    print_table(rows)
    print(
        "", *summary_of(rows, ledger.marks), f"{alike} pairs of submissions are alike", "", sep="\n"
    )
    print(
        f"{passed} of {len(entries)} pass, {time.perf_counter() - begin:.1f} s; "
        f"sheets, grades.csv and marks.csv in {out}"
    )
    return PASSED if passed == len(entries) else FAILED


if __name__ == "__main__":
    sys.exit(run_program(make_options(), main))
