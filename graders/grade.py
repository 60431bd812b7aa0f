"""Grade a class's submissions: folders or ZIPs, with all three graders.

    python graders/grade.py SUBMISSION...    marks and feedback in out/grades

A SUBMISSION is a folder with RBSFunctions.py in it, a ZIP of one, or a folder of such, as
downloaded from Moodle or Canvas. All are read before any code runs. When grading ends, also by
Ctrl-C, marks.csv, sheets and a results.json each for Gradescope are written, and at the end a table
and a summary of the class are printed. The exit code is 0 if all pass, 1 if one fails, and 2 if
nothing can be graded.
"""

import reference

if __name__ == "__main__":
    reference.prepare()

import json
import os
import sys
import time
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import Constraints
import integrationGrading
import ResolveCollisionsGrading
from classwork import graderProgram, sheets
from classwork.graderProgram import FAILED, PASSED
from classwork.marks import SCHEME, gradescope_of, marks_row, unearned
from compare import SCENES, compare_scenes
from isolated import archives
from isolated.archives import HandIn
from isolated.processes import stop_all
from tqdm import tqdm

from rbs.program.parsing import number_type
from rbs.program.submissions import SubmissionError
from rbs.scenes.files import atomic_write
from rbs.scenes.messages import InputError, one_line

GRADERS = (integrationGrading.GRADER, ResolveCollisionsGrading.GRADER, Constraints.GRADER)


@dataclass
class Outcome:
    """The result of grading a submission.

    grades : dict from a grader's module to its Grade
    refusal : why the submission was not graded, or ""; remedy : what would let it be graded
    scenes : of `compare.compare_scenes`
    seconds : time that grading took
    """

    handIn: HandIn
    grades: dict = field(default_factory=dict)
    refusal: str = ""
    remedy: str = ""
    remarks: list = field(default_factory=list)
    scenes: dict = field(default_factory=dict)
    seconds: float = 0.0

    @property
    def state(self):
        return "needs attention" if self.remedy else "refused" if self.refusal else "graded"


def grade_one(handIn, data, arguments):
    """Returns the Outcome of a HandIn. data : dict from a grader's module to its data"""
    begin, outcome = time.perf_counter(), Outcome(handIn)
    try:
        if handIn.problem:
            raise SubmissionError(handIn.problem)
        grades, remarks = graderProgram.grade_submission(GRADERS, handIn, data, arguments)
        if arguments.scenes:
            outcome.scenes = compare_scenes(handIn, arguments)
        remarks += [one for grade in grades.values() for one in grade.remarks]
        outcome.grades, outcome.remarks = grades, list(dict.fromkeys(remarks))
    except SubmissionError as error:
        outcome.refusal, outcome.remedy = str(error), error.remedy
    except Exception as error:  # a bug of ours must not cost the others their grades
        outcome.refusal = one_line(f"cannot be graded: {type(error).__name__}: {error}")
    outcome.seconds = time.perf_counter() - begin
    return outcome


COLUMNS = "submission", "path", "state", *SCHEME, "total", "of", "passed"
COLUMNS += "largest error", "failed", "notes", "remarks", "seconds", "contents"


class Ledger:
    """The class's marks, in the order of the submissions, and each one's files. All are kept in
    memory, and written when grading ends; marks.json is what `--resume` reads.

    rows : dict from a submission's name to its row, of `sheets.row_of` and `marks_row`
    """

    def __init__(self, arguments, handIns, free):
        self._arguments, self._free = arguments, free
        self._table = arguments.out / "marks.json"
        self._texts, found = {}, {}
        if arguments.resume and self._table.exists():
            found = sheets.read_rows(self._table, COLUMNS)
        self.rows = {}
        for one in handIns:
            if found.get(one.name, {}).get("contents") == one.digest:
                self.rows[one.name] = found[one.name]
        self._names = [one.name for one in handIns]
        for name in found.keys() - {*self._names}:  # it has been taken away
            sheet, results = self._files(name)
            sheet.unlink(missing_ok=True)
            results.unlink(missing_ok=True)
            with suppress(OSError):
                (arguments.out / "gradescope" / name).rmdir()
        self.save()

    def _files(self, name):
        """The sheet and the results of a submission."""
        out = self._arguments.out
        results = self._arguments.results or out / "gradescope" / name / "results.json"
        return out / f"{name}.txt", results

    def add(self, outcome):
        """Keeps an Outcome."""
        name = outcome.handIn.name
        row = sheets.row_of(outcome) | marks_row(outcome, self._free)
        sheet, results = self._files(name)
        self._texts[results] = gradescope_of(outcome, self._free)
        self._texts[sheet] = sheets.sheet_of(outcome, row, self._arguments.seed)
        self.rows[name] = row

    def in_order(self):
        return [self.rows[name] for name in self._names if name in self.rows]

    def save(self):
        """Writes all. Raises OSError once the rest is written."""
        rows, trouble = self.in_order(), []
        told = json.dumps({row["submission"]: row for row in rows}, indent=1, ensure_ascii=False)
        tables = {self._table: told, self._table.with_suffix(".csv"): sheets.csv_of(COLUMNS, rows)}
        for path, text in (self._texts | tables).items():
            try:
                write_text(path, text)
            except OSError as error:  # such as a table that is open in Excel
                trouble.append(error)
        if trouble:
            raise trouble[0]


def write_text(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    # a name may have bytes that are not UTF-8; JSON reads what replaces them as the same name
    form = {"encoding": "utf-8", "errors": "backslashreplace", "newline": "\n"}
    with atomic_write(path) as part, open(part, "w", **form) as file:
        file.write(text)


def make_options():
    parser = graderProgram.make_parser(__doc__)
    option = parser.add_argument
    text = "a folder, a ZIP, or a folder of them"
    option("submissions", metavar="SUBMISSION", nargs="+", help=text)
    out, text = Path("out") / "grades", "folder for all output (default: %(default)s)"
    option("--out", metavar="DIR", type=Path, default=out, help=text)
    option("--resume", action="store_true", help="continue a run that was stopped")
    text = f"also compare the steps of {', '.join(SCENES)} with ours"
    option("--scenes", action="store_true", help=text)
    text = "grade one submission, and write its results.json for Gradescope to FILE"
    option("--results", metavar="FILE", type=Path, help=text)
    form = {"type": number_type(int, 1, 64), "default": os.cpu_count()}
    text = "submissions graded at a time (default: one per processor)"
    option("--jobs", metavar="N", **form, help=text)
    return parser


def grade_all(handIns, ledger, data, arguments):
    """Grades these submissions, some at a time."""
    with ThreadPoolExecutor(arguments.jobs) as executor:
        bar = tqdm(total=len(handIns), disable=None, unit=" graded")
        try:
            jobs = {executor.submit(grade_one, one, data, arguments) for one in handIns}
            while jobs:
                # a signal may reach another thread, which does not end a longer wait
                done, jobs = wait(jobs, timeout=1.0, return_when=FIRST_COMPLETED)
                for one in done:
                    ledger.add(one.result())
                    bar.update()
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            stop_all()
            ledger.save()
            raise
        bar.close()


def main(arguments):
    """Grades as the command line says; returns the exit code."""
    begin, out = time.perf_counter(), arguments.out
    data = {one.module: one.load(arguments.data, arguments.seed) for one in GRADERS}
    if arguments.results:
        if len(arguments.submissions) > 1:
            raise InputError(f"--results is of one submission, not of {len(arguments.submissions)}")
        handIns = [HandIn("submission", Path(arguments.submissions[0]).resolve())]
        arguments.results = arguments.results.resolve()
    else:
        handIns = archives.find_submissions(arguments.submissions)
    out.mkdir(parents=True, exist_ok=True)
    for one in handIns:
        archives.read(one)
    ledger = Ledger(arguments, handIns, unearned(GRADERS, data))
    try:
        waiting = [one for one in handIns if one.name not in ledger.rows]
        grade_all(waiting, ledger, data, arguments)
    except KeyboardInterrupt:
        text = f"with {len(ledger.rows)} of {len(handIns)} graded; --resume continues"
        raise KeyboardInterrupt(text) from None
    rows = ledger.in_order()
    passed = sum(map(sheets.passes, rows))
    sheets.print_table(rows)
    print("", *sheets.summary_of(rows), "", sep="\n")
    ledger.save()
    took, verb = f"{time.perf_counter() - begin:.1f} s", "passes" if passed == 1 else "pass"
    print(f"{passed} of {len(handIns)} {verb}, {took}; sheets and marks.csv in {out}")
    return PASSED if passed == len(handIns) else FAILED


if __name__ == "__main__":
    sys.exit(graderProgram.run_program(make_options(), main))
