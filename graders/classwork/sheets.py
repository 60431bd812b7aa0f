"""Prints and writes what `grade.py` reports: tables, CSV files, Markdown sheets, a summary.

Texts from a submission, such as an exception's message or the name of a file, are made harmless for
a terminal, a spreadsheet and Markdown.
"""

import csv
import math
import os
import re
import statistics
from collections import Counter
from urllib.parse import quote

from reference.graderData import ERROR_BOUND

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
    row = {"submission": outcome.name, "id": outcome.id, "path": outcome.path}
    row |= {"state": outcome.state, "seconds": f"{outcome.seconds:.1f}"}
    row |= {"contents": outcome.digest, "passed": "-", "largest error": "-", "notes": ""}
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
    """Whether a submission with this row passes."""
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


def common_remarks(marks):
    """Returns the remarks that more than half of a class have, which are said once for the class:
    a dict from remark to how many have it. marks : rows of marks.csv
    """
    told = Counter(one for row in marks for one in _split(row["remarks"]))
    return {one: count for one, count in told.items() if count > max(FEWEST, 0.5 * len(marks))}


def without(cell, remarks):
    """A cell of remarks, without these."""
    return BETWEEN.join(one for one in _split(cell) if one not in remarks)


def summary_of(rows, common=()):
    """Returns lines on the class: marks, failing parts, commonest notes, and what needs attention.

    rows : of marks.csv; common : of `common_remarks`
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


def sheet_of(path, outcome, marks, scheme, seed):
    """Returns a submission's Markdown sheet; marks : its row of marks.csv."""
    lines = [f"# {_plain(outcome.name)}", ""]
    if outcome.refusal:
        lines += [f"Not graded, {outcome.state}: {_plain(outcome.refusal)}", ""]
    else:
        verdict = "passes" if passes(marks) else "does not pass"
        text = f"a quantity passes if its largest error is below {ERROR_BOUND:g}."
        lines += [f"The submission {verdict}; {text}", ""]
        lines += [
            f"Marks: {marks['total']} of {marks['of']}. Seed of the fresh samples: {seed}.",
            "",
        ]
    lines += _listed(outcome.remarks)
    for grade in outcome.grades.values():
        lines += [f"## {grade.title}", ""]
        lines += _listed(f"{what}: {text}" for what, text in grade.notes)
        lines += ["```text", *grade.table(), "", grade.verdict(), "```", ""]
    lines += [] if outcome.refusal else _marker_rows(outcome, marks, scheme, path.parent)
    lines += ["## Scenes", ""] * bool(outcome.scenes)
    for scene in outcome.scenes:
        lines += [f"### {scene.name}", "", _plain(scene.problem or AGREE), ""]
        lines += _listed(scene.remarks)
    return "\n".join(lines).rstrip() + "\n"


def _marker_rows(outcome, marks, scheme, folder):
    """The rows of items that the marker decides, with what helps to decide."""
    lines = ["## By the marker", "", "| item | of | marks | see |", "|---|--:|--:|---|"]
    for name, item in scheme.items():
        if not marks[name]:
            see = [_plain(one) for one in outcome.measures if name == "extension"]
            for text, target in outcome.documents if "report" in name else ():
                see.append(f"[{_plain(text)}]({_relative(target.resolve(), folder)})")
            lines.append(f"| {_plain(name)} | {item.most:g} |  | {'; '.join(see)} |")
    return [*lines, ""]


def _listed(texts):
    lines = [f"- {_plain(text)}" for text in texts]
    return lines + [""] * bool(lines)


def _relative(path, folder):
    return quote(os.path.relpath(path, folder).replace(os.sep, "/"))


def _plain(text):
    """Returns the text in one line, with all Markdown escaped."""
    return re.sub(r"([\\`*_{}\[\]<>#|~])", r"\\\1", one_line(str(text)))
