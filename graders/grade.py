"""Grade submissions with all three graders, each in a process of its own.

    python graders/grade.py SUBMISSION... [--resume] [--scenes] [--anonymous]
    python graders/grade.py --merge FILE    adds a marker's numbers to marks.csv

A SUBMISSION is a folder with RBSFunctions.py in it, a ZIP or tar of one, or a folder of such, as
downloaded from Moodle or Canvas. After each submission, grades.csv, marks.csv, its Markdown sheet
and its results.json for Gradescope are written; at the end a table, a summary of the class, and
likeness.csv, the pairs of submissions whose code is alike. The exit code is 0 if all pass, 1 if one
fails, and 2 if nothing can be graded.
"""

import os
import random
import sys
import time
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass, field, replace
from pathlib import Path

import Constraints
import integrationGrading
import ResolveCollisionsGrading
from classwork import graderProgram, sheets
from classwork.graderProgram import FAILED, PASSED
from classwork.likeness import fingerprint, origin_remarks, write_likeness
from classwork.marks import DEFAULT_SCHEME, load_scheme, marks_row, merge_marks, write_gradescope
from compare import SCENES, compare_scene, measured
from isolated.archives import Entry, digest_of, documents_of, find_submissions, modules_of
from isolated.processes import stop_all
from tqdm import tqdm

from rbs.program.parsing import at_least, option_type
from rbs.program.submissions import SubmissionError
from rbs.scenes.messages import one_line

GRADERS = (integrationGrading.GRADER, ResolveCollisionsGrading.GRADER, Constraints.GRADER)
KEY = ("id", "name", "path")


@dataclass
class Outcome:
    """The result of grading a submission.

    name, path : as they are shown; grades : dict from a grader's module to its Grade
    refusal : why the submission was not graded, or ""; remedy : what would let it be graded
    id, digest, documents, measures : of the submission, as in `archives` and `compare`
    scenes : list of `compare.SceneResult`; seconds : time that grading took
    fingerprint : of its code, for `likeness`
    """

    name: str
    path: str
    grades: dict = field(default_factory=dict)
    refusal: str = ""
    remedy: str = ""
    id: str = ""
    digest: str = ""
    documents: list = field(default_factory=list)
    measures: dict = field(default_factory=dict)
    remarks: list = field(default_factory=list)
    scenes: list = field(default_factory=list)
    seconds: float = 0.0
    fingerprint: frozenset = frozenset()

    @property
    def state(self):
        """The state in marks.csv."""
        return "needs attention" if self.remedy else "refused" if self.refusal else "graded"


def grade_entry(entry, isKnown, data, arguments):
    """Returns the Outcome of a submission; if it is known already, only with the fingerprint.

    data : dict from a grader's module to its data
    """
    begin = time.perf_counter()
    outcome = Outcome(entry.name, "" if entry.isAnonymous else str(entry.path))
    outcome.id, outcome.digest = "" if entry.isAnonymous else entry.id, digest_of(entry)
    try:
        with modules_of(entry) as (folder, remarks):
            outcome.fingerprint = fingerprint(folder)
            if isKnown:
                return outcome
            grades = graderProgram.grade_submission(GRADERS, folder, data, arguments)
            outcome.documents = [] if entry.isAnonymous else documents_of(entry)
            remarks += origin_remarks(folder)
            remarks += [one for grade in grades.values() for one in grade.remarks]
            outcome.remarks = list(dict.fromkeys(remarks))
            if arguments.scenes:
                pictures = arguments.out / "pictures" / entry.name
                outcome.scenes = [compare_scene(one, folder, pictures, arguments) for one in SCENES]
                outcome.measures = measured(folder, arguments)
                found = [f"{one.name}: {one.problem}" for one in outcome.scenes if one.problem]
                outcome.remarks += found
            outcome.grades = grades
    except SubmissionError as error:
        outcome.refusal, outcome.remedy = str(error), error.remedy
    except Exception as error:  # a bug of ours must not cost the others their grades
        outcome.refusal = one_line(f"cannot be graded: {type(error).__name__}: {error}")
    outcome.seconds = time.perf_counter() - begin
    return outcome


def columns_of(scheme):
    """The columns of marks.csv."""
    last = "total", "of", "seconds", "contents", "remarks"
    return "submission", "id", "path", "state", *scheme, *last


class Ledger:
    """Writes grades.csv and marks.csv, in the order of the submissions, and each one's files.

    digests : dict from a submission's name to that of its contents
    marks, grades : dicts from a submission's name to its row, and to its list of rows
    """

    def __init__(self, arguments, digests, scheme):
        self._out, self._names, self._scheme = arguments.out, list(digests), scheme
        self._failing, self._results = arguments.failing, arguments.results
        self._columns = columns_of(scheme)
        self.marks, self.grades = {}, {}
        if arguments.resume:
            rows = sheets.read_rows(self._out / "marks.csv", self._columns)
            rows = [row for row in rows if digests.get(row["submission"]) == row["contents"]]
            self.marks = {row["submission"]: row for row in rows}
            for row in sheets.read_rows(self._out / "grades.csv", sheets.GRADES):
                if row["submission"] in self.marks:
                    self.grades.setdefault(row["submission"], []).append(row)
        self.save()

    def rows(self):
        """The rows of grades.csv."""
        return [row for name in self._names for row in self.grades.get(name, ())]

    def save(self):
        """Writes both files. Raises OSError."""
        marks = [self.marks[name] for name in self._names if name in self.marks]
        sheets.write_rows(self._out / "grades.csv", sheets.GRADES, self.rows())
        sheets.write_rows(self._out / "marks.csv", self._columns, marks)

    def add(self, outcome):
        """Writes an Outcome's files, its rows last. Raises OSError."""
        name, remarks = outcome.name, outcome.refusal or sheets.BETWEEN.join(outcome.remarks)
        row = {"submission": name, "id": outcome.id, "path": outcome.path, "state": outcome.state}
        row |= {"seconds": f"{outcome.seconds:.1f}", "contents": outcome.digest, "remarks": remarks}
        row |= marks_row(outcome, self._scheme)
        sheets.write_sheet(self._out / f"{name}.md", outcome, row, self._scheme)
        results = self._results or self._out / "gradescope" / name / "results.json"
        write_gradescope(results, outcome, self._scheme, self._failing)
        self.grades[name], self.marks[name] = sheets.rows_of(outcome), row
        self.save()


def anonymous(entries, path):
    """Returns the entries with numbers, drawn at random, for names.

    path : of the file that tells whose they are; numbers in it already are kept. Raises OSError,
        SubmissionError.
    """
    rows = {row["path"]: row for row in sheets.read_rows(path, KEY)}
    for one in random.sample(entries, len(entries)):
        row = dict(zip(KEY, (f"{len(rows) + 1:03}", one.name, str(one.path)), strict=True))
        rows.setdefault(row["path"], row)
    sheets.write_rows(path, KEY, sorted(rows.values(), key=lambda row: row["id"]))
    changed = {"isAnonymous": True, "remarks": ()}  # which name the earlier attempts
    entries = [replace(one, name=rows[str(one.path)]["id"], **changed) for one in entries]
    return sorted(entries, key=lambda one: one.name)


def make_options():
    """Returns the command line's parser."""
    parser = graderProgram.make_parser(__doc__)
    option = parser.add_argument
    text = "a folder, a ZIP or tar, or a folder of them"
    option("submissions", metavar="SUBMISSION", nargs="*", help=text)
    out, text = Path("out") / "grades", "folder for all output (default: %(default)s)"
    option("--out", metavar="DIR", type=Path, default=out, help=text)
    option("--resume", action="store_true", help="continue a run that was stopped")
    text = "marks of each part (default: graders/marks.ini)"
    option("--marks", metavar="FILE", type=Path, default=DEFAULT_SCHEME, help=text)
    text = f"also compare the steps of {', '.join(SCENES)} with ours, and draw them"
    option("--scenes", action="store_true", help=text)
    text = "CSV file with a marker's numbers, to be put into the marks.csv in DIR"
    option("--merge", metavar="FILE", type=Path, help=text)
    text = "grade one submission, and write its results.json for Gradescope to FILE"
    option("--results", metavar="FILE", type=Path, help=text)
    shown = ("visible", "hidden", "after_due_date", "after_published")
    text = "visibility of failing tests in results.json (default: %(default)s)"
    option("--failing", choices=shown, default="visible", help=text)
    option("--anonymous", action="store_true", help="write numbers instead of names and paths")
    text = "list of numbers and names (default: DIR-key.csv)"
    option("--key", metavar="FILE", type=Path, help=text)
    form = {"type": option_type(int, at_least(1, 64), "whole number"), "default": os.cpu_count()}
    text = "submissions graded at a time (default: one per processor)"
    option("--jobs", metavar="N", **form, help=text)
    return parser


def completed(jobs):
    """Yields futures as they complete.

    No wait lasts longer than a second, because a signal that arrives just before a wait may take
    effect only after it.
    """
    while jobs:
        wait(jobs, timeout=1.0, return_when=FIRST_COMPLETED)
        done = [job for job in jobs if job.done()]
        yield from done
        jobs = [job for job in jobs if job not in done]


def grade_all(entries, ledger, data, arguments):
    """Grades all entries that the ledger lacks.

    Returns a dict from name to fingerprint, and the last OSError of writing a file, or None.
    """
    known, prints, trouble = set(ledger.grades), {}, None
    with ThreadPoolExecutor(arguments.jobs) as executor:
        try:
            jobs = [(entry, entry.name in known, data, arguments) for entry in entries]
            waiting = [executor.submit(grade_entry, *job) for job in jobs]
            bar = {"total": len(waiting), "disable": None, "unit": " graded"}
            for done in tqdm(completed(waiting), **bar):
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
            text = f"with {len(ledger.marks)} of {len(entries)} graded; --resume continues"
            raise KeyboardInterrupt(text) from None
    ledger.save()
    return prints, trouble


def merge(arguments, scheme):
    """Adds a marker's numbers to marks.csv; returns the exit code."""
    path, columns = arguments.out / "marks.csv", columns_of(scheme)
    rows = sheets.read_rows(path, columns)
    incomplete = merge_marks(arguments.merge, rows, scheme)
    sheets.write_rows(path, columns, rows)
    print(f"{len(rows) - len(incomplete)} of {len(rows)} are complete; totals in {path}")
    print(*(f"incomplete: {name}" for name in incomplete), sep="\n", end="\n" * bool(incomplete))
    return FAILED if incomplete else PASSED


def main(arguments):
    """Grades as the command line says; returns the exit code."""
    begin, out = time.perf_counter(), arguments.out
    data = {one.module: one.load(arguments.data) for one in GRADERS}
    scheme = load_scheme(arguments.marks, GRADERS, data, arguments.scenes)
    if arguments.merge:
        return merge(arguments, scheme)
    entries = find_submissions(arguments.submissions)
    if arguments.results:
        entries = [Entry("submission", Path(arguments.submissions[0]))]
    elif not entries:
        raise SubmissionError("name a SUBMISSION, or --merge FILE")
    out.mkdir(parents=True, exist_ok=True)
    if arguments.anonymous:
        beside = out.resolve().with_name(f"{out.resolve().name}-key.csv")
        entries = anonymous(entries, arguments.key or beside)
    ledger = Ledger(arguments, {entry.name: digest_of(entry) for entry in entries}, scheme)
    prints, trouble = grade_all(entries, ledger, data, arguments)
    alike = write_likeness(out / "likeness.csv", {one.name: prints[one.name] for one in entries})
    if trouble:
        raise trouble
    rows = ledger.rows()
    passed = sum(sheets.passes(ledger.grades[entry.name]) for entry in entries)
    sheets.print_table(rows)
    print("", *sheets.summary_of(rows, ledger.marks), sep="\n")
    print(f"pairs of submissions that are alike: {alike}\n")
    took = f"{time.perf_counter() - begin:.1f} s"
    print(f"{passed} of {len(entries)} pass, {took}; sheets, grades.csv and marks.csv in {out}")
    return PASSED if passed == len(entries) else FAILED


if __name__ == "__main__":
    sys.exit(graderProgram.run_program(make_options(), main))
