"""Prints and writes what `grade.py` reports: a table, marks.csv, sheets, a summary.

Texts from a submission, such as an exception's message or the name of a file, are made harmless for
a terminal and a spreadsheet.
"""

import csv
import io
import json
import math
import re
import statistics
from collections import Counter

from classwork.marks import SCHEME
from rbs.scenes.messages import InputError, one_line, short

BETWEEN = " | "
# Characters of a note in the printed table; the sheet has the whole note.
NOTE_WIDTH = 72
# A text that a spreadsheet takes for a formula, unless an apostrophe precedes it.
FORMULA = re.compile(r"^([=+@-].+)")
# Notes in the summary; and submissions that a remark must be true of to be the class's.
MOST_NOTES, FEWEST = 8, 3
LOOK = "a person should look"
AGREE = "The steps agree with ours."


def row_of(outcome):
    """Returns the row of marks.csv without the marks, a dict of texts and lists of texts."""
    handIn, grades = outcome.handIn, outcome.grades.values()
    row = {"submission": handIn.name, "path": str(handIn.path)}
    row |= {"state": outcome.state, "seconds": f"{outcome.seconds:.1f}"}
    row |= {"contents": handIn.digest, "passed": "-", "largest error": "-", "notes": []}
    if outcome.refusal:
        failed = outcome.state if outcome.remedy else "everything (refused)"
        return row | {"remarks": [outcome.refusal, *handIn.remarks], "failed": [failed]}
    quantities = [one for grade in grades for one in grade.quantities]
    errors = [grade.largest_error for grade in grades if not math.isnan(grade.largest_error)]
    row["passed"] = f"{sum(one.isRight for one in quantities)} of {len(quantities)}"
    row["largest error"] = f"{max(errors):.1e}" if errors else "-"
    row["failed"] = list(dict.fromkeys(one.part for grade in grades for one in grade.wrong))
    row["notes"] = [text for grade in grades for text in grade.told]
    for (name, _item), one in outcome.scenes.items():
        row["failed"] += [f"scene {name}"] * bool(one.problem)
        row["notes"] += [f"scene {name}: {one.problem}"] * bool(one.problem)
    return row | {"remarks": list(outcome.remarks)}


def passes(row):
    return row["state"] == "graded" and not row["failed"]


def csv_of(columns, rows):
    """Returns the text of a CSV file, with the byte-order mark that Excel needs."""
    writer = csv.writer(text := io.StringIO("\ufeff", newline=""))
    text.seek(1)
    writer.writerow(columns)
    for row in rows:
        cells = (row[one] for one in columns)
        cells = (BETWEEN.join(one) if isinstance(one, list) else one for one in cells)
        writer.writerow(re.sub(FORMULA, r"'\1", one_line(one)) for one in cells)
    return text.getvalue()


def read_rows(path, columns):
    """Reads the rows that an earlier run has kept, by name. Raises InputError, OSError."""
    try:
        rows = json.loads(path.read_text("utf-8"))
        if all(set(row) == set(columns) for row in rows.values()):
            return rows
    except (ValueError, AttributeError, TypeError):
        pass
    raise InputError(f"{path}: was not written by this program; cannot resume")


def print_table(rows):
    """Prints a line for each submission, with its first hint, or else what is wrong."""
    table = [("submission", "marks", "passed", "largest error", "hint")]
    for row in rows:
        isGraded = row["state"] == "graded"
        notes = row["notes"] if isGraded else row["remarks"][:1]
        notes = sorted(notes, key=lambda text: ": hint: " not in text)
        note = one_line("".join(notes[:1]))
        note = re.sub(r"^[^:]*: (hint: )?(?=.)", "", note) if isGraded else note
        note = short(note, limit=NOTE_WIDTH) + f" (+{len(notes) - 1})" * (len(notes) > 1)
        passed = row["passed"] if isGraded else row["state"]
        table.append((row["submission"], row["total"], passed, row["largest error"], note))
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for row in table:
        print("  ".join(map(str.ljust, row, widths)).rstrip())


def summary_of(rows):
    """Returns lines on the class: marks, failing parts, commonest notes, and what needs attention.

    rows : of marks.csv
    """
    totals = [float(row["total"]) for row in rows if row["total"]]
    left = f"; {len(rows) - len(totals)} without marks left out" * (len(totals) < len(rows))
    mean = f"{statistics.mean(totals or [0]):.1f}, median {statistics.median(totals or [0]):.1f}"
    waiting = [row for row in rows if row["state"] == "needs attention"]
    waiting = [f"{row['submission']}: {one_line(row['remarks'][0])}" for row in waiting]
    failed = Counter(part for row in rows for part in row["failed"])
    notes = Counter(note for row in rows for note in row["notes"])
    told = Counter(one for row in rows for one in row["remarks"]).items()
    common = [one for one in told if one[1] > max(FEWEST, 0.5 * len(rows))]  # which are said once
    looks = [(row, one) for row in rows for one in row["remarks"] if one.startswith(LOOK)]
    return [
        f"marks: mean {mean}{left}",
        *(f"needs attention: {one}" for one in waiting),
        *(f"{row['submission']}: {one_line(one)}" for row, one in looks),
        *(f"{count:4} of {len(rows)}: {one_line(k)}" for k, count in common),
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
