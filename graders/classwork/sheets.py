"""Prints and writes what `grade.py` reports: a table, marks.csv, sheets, a summary.

Texts from a submission, such as an exception's message or the name of a file, are made harmless for
a terminal and a spreadsheet.
"""

import csv
import math
import re
import statistics
from collections import Counter

from classwork.marks import SCHEME
from rbs.scenes.files import atomic_write
from rbs.scenes.messages import InputError, one_line, short

BETWEEN = " | "
# Characters of a note in the printed table; the sheet has the whole note.
NOTE_WIDTH = 72
# A text that a spreadsheet takes for a formula, unless an apostrophe precedes it.
FORMULA = re.compile(r"^('?)([=+@-].+)")
# Notes in the summary; and submissions that a remark must be true of to be the class's.
MOST_NOTES, FEWEST = 8, 3
AGREE = "The steps agree with ours."


def row_of(outcome):
    """Returns the row of marks.csv, a dict of texts, without the marks."""
    handIn = outcome.handIn
    row = {"submission": handIn.name, "path": str(handIn.path)}
    row |= {"state": outcome.state, "seconds": f"{outcome.seconds:.1f}"}
    row |= {"contents": handIn.digest, "passed": "-", "largest error": "-", "notes": ""}
    if outcome.refusal:
        failed = outcome.state if outcome.remedy else "everything (refused)"
        return row | {"remarks": outcome.refusal, "failed": failed}
    grades = outcome.grades.values()
    quantities = [one for grade in grades for one in grade.quantities]
    errors = [grade.largest_error for grade in grades if not math.isnan(grade.largest_error)]
    row["passed"] = f"{sum(one.isRight for one in quantities)} of {len(quantities)}"
    row["largest error"] = f"{max(errors):.1e}" if errors else "-"
    failed = dict.fromkeys(one.part for one in quantities if not one.isRight)
    notes = [f"{what}: {text}" for grade in grades for what, text in grade.notes]
    row |= {"failed": BETWEEN.join(failed), "notes": BETWEEN.join(notes)}
    return row | {"remarks": BETWEEN.join(outcome.remarks)}


def passes(row):
    return row["state"] == "graded" and not row["failed"]


def write_rows(path, columns, rows):
    """Writes a whole CSV file, with the byte-order mark that Excel needs. Raises OSError."""
    form = {"encoding": "utf-8-sig", "newline": ""}
    with atomic_write(path) as partial, open(partial, "w", **form) as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for row in rows:
            writer.writerow(re.sub(FORMULA, r"'\2", one_line(row[column])) for column in columns)


def read_rows(path, columns):
    """Reads the rows of `write_rows`; none if there is no file. Raises InputError, OSError."""
    if not path.exists():
        return []
    with open(path, encoding="utf-8-sig", newline="") as file:
        reader = csv.DictReader(file)
        if list(reader.fieldnames or ()) != list(columns):
            raise InputError(f"{path}: has other columns; cannot resume")
        return [{key: re.sub(FORMULA, r"\2", text) for key, text in row.items()} for row in reader]


def print_table(rows):
    """Prints a line for each submission, with its first note or remark."""
    table = [("submission", "marks", "passed", "largest error", "hint")]
    for row in rows:
        notes = _split(row["notes"]) + _split(row["remarks"])
        note = one_line("".join(notes[:1]))
        note = re.sub(r"^[^:]*: (hint: )?(?=.)", "", note) if row["notes"] else note
        note = short(note, limit=NOTE_WIDTH) + f" (+{len(notes) - 1})" * (len(notes) > 1)
        passed = row["passed"] if row["state"] == "graded" else "refused"
        table.append((row["submission"], row["total"], passed, row["largest error"], note))
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for row in table:
        print("  ".join(map(str.ljust, row, widths)).rstrip())


def _split(cell):
    return cell.split(BETWEEN) if cell else []


def take_common(rows):
    """Takes the remarks that more than half of a class have out of its rows, because they are said
    once for the class. Returns a dict from remark to how many have it. rows : of marks.csv
    """
    told = Counter(one for row in rows for one in _split(row["remarks"]))
    common = {one: count for one, count in told.items() if count > max(FEWEST, 0.5 * len(rows))}
    for row in rows:
        own = (one for one in _split(row["remarks"]) if one not in common)
        row["remarks"] = BETWEEN.join(own)
    return common


def summary_of(rows, common=()):
    """Returns lines on the class: marks, failing parts, commonest notes, and what needs attention.

    rows : of marks.csv; common : of `take_common`
    """
    totals = [float(row["total"].replace(",", ".")) for row in rows if row["total"]] or [0.0]
    waiting = [row for row in rows if row["state"] == "needs attention"]
    failed = Counter(part for row in rows for part in _split(row["failed"]))
    notes = Counter(note for row in rows for note in _split(row["notes"]))
    return [
        f"marks: mean {statistics.mean(totals):.1f}, median {statistics.median(totals):g}",
        *(f"needs attention: {row['submission']}: {one_line(row['remarks'])}" for row in waiting),
        *(f"{count:4} of {len(rows)}: {one_line(text)}" for text, count in dict(common).items()),
        *(f"{count:4} of {len(rows)} fail: {part}" for part, count in failed.most_common()),
        *(f"{count:4} x {one_line(note)}" for note, count in notes.most_common(MOST_NOTES)),
    ]


def sheet_of(outcome, marks, seed):
    """Returns what is written for the student and the marker; marks : its row of marks.csv."""
    known = [one for grade in outcome.grades.values() for one in grade.remarks]
    lines = [outcome.handIn.name, *(one for one in outcome.remarks if one not in known), ""]
    if outcome.refusal:
        lines.append(f"Not graded, {outcome.state}: {outcome.refusal}")
    else:
        verdict = "passes" if passes(marks) else "does not pass"
        lines.append(f"The submission {verdict}. Seed of the fresh samples: {seed}.")
        lines.append(f"Marks: {marks['total']} of {marks['of']}.")
        lines += (f"By the marker: {name}, of {SCHEME[name]}" for name in SCHEME if not marks[name])
    for grade in outcome.grades.values():
        lines += ["", *grade.lines()]
    for (name, _item), one in outcome.scenes.items():
        lines += ["", f"Scene {name}: {one.problem or AGREE}", *one.told()]
    return "".join(f"{one_line(one)}\n" for one in lines)
