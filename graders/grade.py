"""Grade a class's submissions: folders, ZIPs or tars, with all three graders.

    python graders/grade.py SUBMISSION...    marks and feedback in out/grades

A SUBMISSION is a folder with RBSFunctions.py in it, a ZIP or tar of one, or a folder of such, as
downloaded from Moodle or Canvas. All are read before any code runs. After each submission,
marks.csv, its sheet and its results.json for Gradescope are written; at the end a table
and a summary of the class. The exit code is 0 if all pass, 1 if one fails, and 2 if
nothing can be graded.
"""

import os
import sys
import threading
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
from classwork.origins import origin_remarks
from compare import SCENES, compare_scenes
from isolated import measures
from isolated.archives import Entry, find_submissions, read_entry
from isolated.processes import stop_all
from tqdm import tqdm

from rbs.program.parsing import number_type
from rbs.program.submissions import SubmissionError
from rbs.scenes.files import atomic_write
from rbs.scenes.messages import one_line

GRADERS = (integrationGrading.GRADER, ResolveCollisionsGrading.GRADER, Constraints.GRADER)
BEGUN = "grading ended while this was running, alone or with others: grade it again by itself"


@dataclass
class Outcome:
    """The result of grading a submission.

    name, path : as they are shown; grades : dict from a grader's module to its Grade
    refusal : why the submission was not graded, or ""; remedy : what would let it be graded
    id, digest, measures : of the submission, as in `archives` and `compare`
    scenes : list of `compare.SceneResult`; seconds : time that grading took
    isDisturbed : whether another submission may have changed its result
    """

    name: str
    path: str
    grades: dict = field(default_factory=dict)
    refusal: str = ""
    remedy: str = ""
    id: str = ""
    digest: str = ""
    measures: list = field(default_factory=list)
    remarks: list = field(default_factory=list)
    scenes: list = field(default_factory=list)
    seconds: float = 0.0
    isDisturbed: bool = False

    @property
    def state(self):
        """The state in marks.csv."""
        return "needs attention" if self.remedy else "refused" if self.refusal else "graded"


def grade_entry(entry, handIn, data, arguments):
    """Returns the Outcome of a submission. data : dict from a grader's module to its data"""
    begin = time.perf_counter()
    outcome = Outcome(entry.name, str(entry.path), id=entry.id, digest=handIn.digest)
    try:
        if handIn.problem:
            raise SubmissionError(handIn.problem)
        found = graderProgram.grade_submission(GRADERS, handIn, data, arguments)
        grades, told, outcome.isDisturbed = found
        remarks = [*handIn.remarks, *told, *origin_remarks(handIn.files)]
        remarks += [one for grade in grades.values() for one in grade.remarks]
        outcome.remarks = list(dict.fromkeys(remarks))
        if arguments.scenes:
            outcome.scenes = compare_scenes(handIn, arguments)
            outcome.isDisturbed |= any(one.isDisturbed for one in outcome.scenes)
            outcome.measures = measures.measured(handIn, arguments)
            found = [f"{one.name}: {one.problem}" for one in outcome.scenes if one.problem]
            outcome.remarks += found
        outcome.grades = grades
    except SubmissionError as error:
        outcome.refusal, outcome.remedy = str(error), error.remedy
        outcome.isDisturbed = getattr(error, "isDisturbed", False)
    except Exception as error:  # a bug of ours must not cost the others their grades
        outcome.refusal = one_line(f"cannot be graded: {type(error).__name__}: {error}")
    outcome.seconds = time.perf_counter() - begin
    return outcome


COLUMNS = "submission", "id", "path", "state", *SCHEME, "total", "of", "passed"
COLUMNS += "largest error", "failed", "notes", "remarks", "seconds", "contents"


class Ledger:
    """Writes marks.csv, in the order of the submissions, and each one's files.

    Which submissions are running is kept in begun.txt: those that are in it when grading is
    resumed may have ended it, and are passed over.

    digests : dict from a submission's name to that of its contents
    marks : dict from a submission's name to its row
    """

    def __init__(self, arguments, digests, free):
        self._out, self._names, self._free = arguments.out, list(digests), free
        self._results, self._seed = arguments.results, arguments.seed
        self._lock = threading.Lock()
        self.marks, self._texts, self._begun = {}, {}, {}
        self._stopped = set()  # names of those that were running at the last Ctrl-C
        if arguments.resume:
            rows = sheets.read_rows(self._out / "marks.csv", COLUMNS)
            rows = [row for row in rows if digests.get(row["submission"]) == row["contents"]]
            self.marks = {row["submission"]: row for row in rows}
            self._pass_over(digests)
        self.save()
        self._note(begun={})

    def _pass_over(self, digests):
        """Marks what was running when grading ended, if it is handed in unchanged; what was running
        at Ctrl-C, or a signal that looks like it, only at the second time.
        """
        path = self._out / "begun.txt"
        lines = path.read_text("utf-8").splitlines() if path.is_file() else []
        for line in lines:
            _name, _digest, *isStopped = line.split("\t")
            if not isStopped:  # no table is trusted that was there when the grader was ended
                self.marks = {}
        for line in lines:
            name, digest, *isStopped = line.split("\t")
            if digests.get(name) == digest and name not in self.marks:
                if isStopped:
                    self._stopped.add(name)
                else:
                    told = {"refusal": BEGUN, "remedy": "grade it alone", "digest": digest}
                    self.add(Outcome(name, "", **told))

    def _write(self, name, text):
        """Writes a text file. Raises OSError."""
        path = self._out / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as part, open(part, "w", encoding="utf-8", newline="\n") as file:
            file.write(text)

    def rows(self):
        """The rows of marks.csv."""
        return [self.marks[name] for name in self._names if name in self.marks]

    def save(self):
        """Writes the table. Raises OSError."""
        sheets.write_rows(self._out / "marks.csv", COLUMNS, self.rows())

    def stop(self):
        """Notes that what is running is stopped, and writes all again that differs."""
        self._restore()
        with self._lock:
            both = {
                name: digest + "\tstopped" * (name not in self._stopped)
                for name, digest in self._begun.items()
            }
            self._write("begun.txt", "".join(f"{name}\t{rest}\n" for name, rest in both.items()))

    def finish(self):
        """Writes all again, and returns what the class has in common: remarks, and how many have
        each. Raises OSError.
        """
        common = sheets.common_remarks(self.rows())
        for row in self.rows():
            row["remarks"] = sheets.without(row["remarks"], common)
        self._restore()
        return common

    def _restore(self):
        """Writes all again that differs from what was written. Raises OSError."""
        self.save()
        for name, text in self._texts.items():
            found = None
            with suppress(OSError, ValueError):
                found = (self._out / name).read_text("utf-8")
            if found != text:
                self._write(name, text)

    def begin(self, name, digest):
        """Notes that a submission is about to run; from any thread. Raises OSError."""
        self._note(begun={name: digest})

    def _note(self, begun, ended=""):
        with self._lock:
            self._begun |= begun
            self._begun.pop(ended, None)
            lines = [f"{name}\t{digest}\n" for name, digest in self._begun.items()]
            self._write("begun.txt", "".join(lines))

    def add(self, outcome):
        """Writes an Outcome's files, its rows last. Raises OSError."""
        name = outcome.name
        row = sheets.row_of(outcome) | marks_row(outcome, self._free)
        sheet = f"{name}.txt"
        self._texts[sheet] = sheets.sheet_of(outcome, row, self._seed)
        results = self._results and self._results.resolve()
        results = str(results or Path("gradescope") / name / "results.json")
        self._texts[results] = gradescope_of(outcome, self._free)
        self.marks[name] = row
        for path in (sheet, results):
            self._write(path, self._texts[path])
        self.save()
        self._note({}, name)


def make_options():
    """Returns the command line's parser."""
    parser = graderProgram.make_parser(__doc__)
    option = parser.add_argument
    text = "a folder, a ZIP or tar, or a folder of them"
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


def grade_all(entries, handIns, ledger, data, arguments):
    """Grades all entries that the ledger lacks; returns the last OSError of writing, or None.

    Submissions that another one may have disturbed are graded again, one at a time.
    """
    trouble, again, jobs = None, [], arguments.jobs

    def run(entry):
        with suppress(OSError):  # told when its rows are written
            ledger.begin(entry.name, handIns[entry.name].digest)
        return grade_entry(entry, handIns[entry.name], data, arguments)

    def keep(outcome):
        nonlocal trouble
        try:
            ledger.add(outcome)
        except OSError as problem:  # such as a table that is open in Excel
            trouble = problem

    waiting = [entry for entry in entries if entry.name not in ledger.marks]
    byName = {entry.name: entry for entry in waiting}
    with ThreadPoolExecutor(jobs) as executor:
        try:
            futures = [executor.submit(run, entry) for entry in waiting]
            bar = tqdm(total=len(futures), disable=None, unit=" graded")
            for done in completed(futures):
                outcome = done.result()
                if outcome.isDisturbed and jobs > 1 and len(waiting) > 1:
                    again.append(byName[outcome.name])
                else:
                    keep(outcome)
                    bar.update()
            for entry in again:
                outcome = executor.submit(run, entry).result()
                outcome.remarks.append("graded twice, the second time alone")
                keep(outcome)
                bar.update()
            bar.close()
        except KeyboardInterrupt:
            executor.shutdown(wait=False, cancel_futures=True)
            stop_all()
            ledger.stop()
            text = f"with {len(ledger.marks)} of {len(entries)} graded; --resume continues"
            raise KeyboardInterrupt(text) from None
    return trouble


def main(arguments):
    """Grades as the command line says; returns the exit code."""
    begin, out = time.perf_counter(), arguments.out
    data = {one.module: one.load(arguments.data, arguments.seed) for one in GRADERS}
    if arguments.results:
        entries = [Entry("submission", Path(arguments.submissions[0]))]
    else:
        entries = find_submissions(arguments.submissions)
    out.mkdir(parents=True, exist_ok=True)
    handIns = {entry.name: read_entry(entry) for entry in entries}
    digests = {name: one.digest for name, one in handIns.items()}
    ledger = Ledger(arguments, digests, unearned(GRADERS, data))
    trouble = grade_all(entries, handIns, ledger, data, arguments)
    try:
        common = ledger.finish()
    except OSError as problem:  # the table is printed all the same
        trouble, common = problem, {}
    rows = ledger.rows()
    passed = sum(map(sheets.passes, rows))
    sheets.print_table(rows)
    print("", *sheets.summary_of(rows, common), "", sep="\n")
    took = f"{time.perf_counter() - begin:.1f} s"
    if trouble:
        raise trouble
    print(f"{passed} of {len(entries)} pass, {took}; sheets and marks.csv in {out}")
    return PASSED if passed == len(entries) else FAILED


if __name__ == "__main__":
    sys.exit(graderProgram.run_program(make_options(), main))
