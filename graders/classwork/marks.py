"""Marks a submission by a scheme in a file, and writes Gradescope's results.json."""

import configparser
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
from verdict.hints import right_by_chance

from rbs.scenes.messages import InputError

DEFAULT_SCHEME = Path(__file__).resolve().parents[1] / "marks.ini"
MARKER = "by the marker"


class Item(NamedTuple):
    """An item of the scheme. free : quantities that do not count, or None if it is the marker's"""

    most: float
    free: list | None
    section: str


def load_scheme(path, graders, data, hasScenes=True, isWhole=True):
    """Reads the marks of each item. Raises InputError, OSError.

    data : dict from a grader's module to its data; hasScenes : whether scenes are graded
    isWhole : whether each item is the marker's or belongs to one of the graders

    Returns a dict from name to Item.
    """
    free = {name: [] if hasScenes else None for name in ("scenes", "constraint scenes")}
    for grader in graders:
        for part in grader.parts:
            free.setdefault(part.function, []).extend(_free(part, data[grader.module]))
    parser = configparser.ConfigParser(delimiters=("=",), interpolation=None)
    parser.optionxform = str  # keeps capitals
    scheme = {}
    try:
        parser.read_string(path.read_text("utf-8-sig"), str(path))
        for section in parser.sections():
            for name, text in parser[section].items():
                if isWhole and name not in free and not text.endswith(MARKER):
                    raise ValueError(f"'{name}' is not one of {', '.join(free)}, nor {MARKER}")
                most = float(text.removesuffix(MARKER))
                scheme[name] = Item(most, free.get(name), section)
    except (configparser.Error, ValueError) as problem:
        raise InputError(f"{path}: {problem}") from None
    return scheme


def _free(part, data):
    """The quantities that are right even if nothing is written, or with the same answer always."""
    expected, samples = part.expected(data), part.samples(data)
    isConstant = {key: not np.ptp(rows[samples], axis=0).any() for key, rows in expected.items()}
    return [key for key in expected if isConstant[key] or right_by_chance(part, key, data).all()]


def marks_of(outcome, scheme):
    """Returns a dict from each graded item of the scheme to (marks, maximum, what is wrong)."""
    tried, marks = {}, {}
    for one in outcome.scenes:
        tried.setdefault(one.item, []).append((f"{one.name}: {one.problem}", one.share))
    for quantity in (one for grade in outcome.grades.values() for one in grade.quantities):
        tried.setdefault(quantity.part.split()[0], []).append((quantity.name, quantity.share))
    for name, (most, free, _section) in scheme.items():
        counted = [one for one in tried.get(name, ()) if one[1] == 0 or one[0] not in free]
        if tried.get(name):
            given = most * sum(share for _text, share in counted) / max(1, len(counted))
            marks[name] = round(given, 2), most, [text for text, share in counted if share < 1]
    return marks


def marks_row(outcome, scheme):
    """Returns columns of marks.csv: each item, empty if not graded, and "total" and "of"."""
    given = marks_of(outcome, scheme)
    row = dict.fromkeys((*scheme, "total", "of"), "")
    row |= {name: f"{one[0]:g}" for name, one in given.items()}
    return row | (_total(row, scheme) if given else {})


def _total(row, scheme):
    filled = {name: float(row[name]) for name in scheme if row[name]}
    total, most = sum(filled.values()), sum(scheme[name].most for name in filled)
    return {"total": f"{round(total, 2):g}", "of": f"{most:g}"}


def gradescope_of(outcome, scheme):
    """Returns results.json as Gradescope expects it of an autograder.

    https://gradescope-autograders.readthedocs.io/en/latest/specs/
    """
    tests, given = [], marks_of(outcome, scheme)
    for name, (marks, most, wrong) in given.items():
        test = {"name": name, "score": marks, "max_score": most}
        tests.append(test | {"output": f"wrong: {'; '.join(wrong)}" if wrong else "right"})
    notes = [f"{what}: {text}" for grade in outcome.grades.values() for what, text in grade.notes]
    results = {
        "score": round(sum(marks for marks, _most, _wrong in given.values()), 2),
        "execution_time": round(outcome.seconds),
        "output": "\n".join(filter(None, [outcome.refusal, *outcome.remarks, *notes])),
        "visibility": "visible",
        "tests": tests,
    }
    return json.dumps(results, indent=1, ensure_ascii=False)
