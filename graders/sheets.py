"""What `grade.py` prints and writes: the table, grades.csv, a Markdown sheet for each submission.

Texts may come from a submission: an exception's message, the name of a file. They are made
harmless for a terminal, a spreadsheet and Markdown.
"""

import csv
import math
import os
import re

from gradingTools import ERROR_BOUND, printable

COLUMNS = ("submission", "grader", "passed", "of", "largest error", "notes")
# Characters of a note in the printed table; the sheet has all of it.
NOTE_WIDTH = 72
# What a spreadsheet takes for a formula.
FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")


def rows_of(outcome):
    """Rows (submission, grader, passed, of, largest error, list of notes) of texts."""
    if outcome.refusal:
        return [(outcome.name, "-", "0", "-", "-", [outcome.refusal])]
    rows = []
    for module, grade in outcome.grades.items():
        count = len(grade.quantities)
        error = grade.largest_error
        shown = "not a number" if math.isnan(error) else f"{error:.1e}"
        if all(quantity.error is None for quantity in grade.quantities):
            shown = "-"
        notes = [f"{what}: {text}" for what, text in grade.notes]
        passed = str(count - len(grade.failures))
        rows.append((outcome.name, module, passed, str(count), shown, notes))
    return rows


def print_table(outcomes):
    """One line for each submission and grader."""
    table = [("submission", "grader", "passed", "largest error", "hint")]
    for outcome in outcomes:
        for name, module, passed, count, error, notes in rows_of(outcome):
            note = printable(notes[0]) if notes else ""
            note = re.sub(r"^[^:]*: (hint: )?(?=.)", "", note) if module != "-" else note
            if len(note) > NOTE_WIDTH:
                note = note[: NOTE_WIDTH - 3] + "..."
            more = f" (+{len(notes) - 1})" if len(notes) > 1 else ""
            of = f"{passed}/{count}" if module != "-" else "refused"
            table.append((name, module, of, error, note + more))
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    for row in table:
        cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=True)]
        print("  ".join(cells).rstrip())


def write_csv(path, outcomes, convention):
    """grades.csv: a row for each submission and grader. raises OSError"""
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow((*COLUMNS, "convention"))
        for outcome in outcomes:
            for *cells, notes in rows_of(outcome):
                cells = (*cells, " | ".join(notes), convention)
                writer.writerow([_plain_cell(cell) for cell in cells])


def _plain_cell(text):
    text = printable(text)
    return f"'{text}" if text.startswith(FORMULA_STARTS) and text != "-" else text


def write_sheet(path, outcome, convention):
    """The Markdown sheet of a submission. raises OSError"""
    verdict = "passes" if outcome.passes else "does not pass"
    lines = [f"# {_plain(outcome.name)}", ""]
    if outcome.refusal:
        lines += [f"Not graded: {_plain(outcome.refusal)}", ""]
    else:
        lines += [
            f"It {verdict} under the convention `{convention}`; a quantity passes if its largest "
            f"error is below {ERROR_BOUND:g}.",
            "",
        ]
    lines += [f"- {_plain(remark)}" for remark in outcome.remarks]
    lines += [""] * bool(outcome.remarks)
    for grade in outcome.grades.values():
        passed = len(grade.quantities) - len(grade.failures)
        lines += [f"## {grade.title}: {passed} of {len(grade.quantities)}", ""]
        lines += [f"- {_plain(what)}: {_plain(text)}" for what, text in grade.notes]
        lines += [""] * bool(grade.notes)
        lines += ["| | quantity | largest error | at sample | samples |", "|---|---|--:|--:|--:|"]
        for quantity in grade.quantities:
            mark = "✓" if quantity.isRight else "✗"
            lines.append(f"| {mark} | {' | '.join(map(_plain, quantity.cells()))} |")
        lines += ["", *(f"{_plain(remark)}  " for remark in grade.remarks), ""]
    if outcome.scenes:
        lines += ["## Scenes", ""]
        for scene in outcome.scenes:
            lines += _contact_sheet(scene, path.parent)
    with open(path, "w", encoding="utf-8", newline="\n") as file:
        file.write("\n".join(lines).rstrip() + "\n")


def _contact_sheet(scene, folder):
    """The pictures of a scene in a row, with their times below."""
    lines = [f"### {_plain(scene.name)}", ""]
    if scene.problem:
        lines += [_plain(scene.problem), ""]
    if scene.pictures:
        paths = [os.path.relpath(path, folder) for _time, path in scene.pictures]
        paths = [path.replace(os.sep, "/") for path in paths]
        lines += [
            "| " + " | ".join(f"![{scene.name}]({path})" for path in paths) + " |",
            "|" + ":-:|" * len(paths),
            "| " + " | ".join(f"{time:g} s" for time, _path in scene.pictures) + " |",
            "",
        ]
    return lines


def _plain(text):
    """The text in one line in which Markdown sees nothing but text."""
    return re.sub(r"([\\`*_{}\[\]<>#|~])", r"\\\1", printable(str(text)))
