"""Marks a submission by a scheme in a file, and writes Gradescope's results.json."""

import configparser
import json
from pathlib import Path

import numpy as np
from reference.graderData import ERROR_BOUND
from verdict.hints import mistakes_of

from rbs.scenes.files import atomic_write
from rbs.scenes.messages import InputError

DEFAULT_SCHEME = Path(__file__).resolve().parents[1] / "marks.ini"
SCENE_MARKS = "scenes"


def load_scheme(path, graders, data):
    """Reads the marks of each function. Raises InputError, OSError.

    data : dict from a grader's module to its data

    Returns a dict from each name to (its marks, quantities that do not count).
    """
    free = {SCENE_MARKS: []}
    for grader in graders:
        for part in grader.parts:
            free.setdefault(part.function, []).extend(_free(part, data[grader.module]))
    parser = configparser.ConfigParser(delimiters=("=",), interpolation=None)
    parser.optionxform = str  # keeps capitals
    scheme = {}
    try:
        parser.read_string(path.read_text("utf-8-sig"), str(path))
        items = [item for heading in parser.sections() for item in parser[heading].items()]
        for name, text in items:
            if name not in free:
                raise ValueError(f"'{name}' is not one of {', '.join(free)}")
            scheme[name] = float(text), free[name]
    except (configparser.Error, ValueError) as problem:
        raise InputError(f"{path}: {problem}") from None
    return scheme


def _free(part, data):
    """The quantities of a part that are right even if nothing is written."""
    expected, mistakes = part.expected(data), mistakes_of(part.function)
    stubs = [one.names for one in mistakes if one.text.startswith("not implemented")]
    results = [part.after_mistakes(data, names) for names in stubs]

    def is_free(key):
        return all(np.allclose(one[key], expected[key], 0, ERROR_BOUND) for one in results)

    return [key for key in expected if results and is_free(key)]


def marks_of(outcome, scheme):
    """Returns a dict from each graded part of the scheme to (marks, maximum, what is wrong)."""
    if outcome.refusal:
        return {name: (0.0, most, [outcome.refusal]) for name, (most, _free) in scheme.items()}
    scenes = [(f"{one.name}: {one.problem}", not one.problem) for one in outcome.scenes]
    tried = {SCENE_MARKS: scenes}
    for quantity in (one for grade in outcome.grades.values() for one in grade.quantities):
        tried.setdefault(quantity.part.split()[0], []).append((quantity.name, quantity.share))
    marks = {}
    for name, (most, free) in scheme.items():
        counted = [one for one in tried.get(name, ()) if one[1] < 1 or one[0] not in free]
        wrong = [text for text, share in counted if share < 1]
        if tried.get(name):
            given = most * sum(share for _text, share in counted) / max(1, len(counted))
            marks[name] = round(given, 2), most, wrong
    return marks


def marks_row(outcome, scheme):
    """Returns columns of marks.csv: each part, empty if not graded, and "total" and "of"."""
    given = marks_of(outcome, scheme)
    row = dict.fromkeys(scheme, "") | {name: f"{one[0]:g}" for name, one in given.items()}
    total, most = (sum(one[k] for one in given.values()) for k in (0, 1))
    return row | {"total": f"{round(total, 2):g}", "of": f"{most:g}"}


def write_gradescope(path, outcome, scheme):
    """Writes results.json as Gradescope expects it of an autograder. Raises OSError.

    https://gradescope-autograders.readthedocs.io/en/latest/specs/
    """
    tests, given = [], marks_of(outcome, scheme)
    for name, (marks, most, wrong) in given.items():
        test = {"name": name, "score": marks, "max_score": most, "visibility": "visible"}
        tests.append(test | {"output": f"wrong: {'; '.join(wrong)}" if wrong else "right"})
    notes = [f"{what}: {text}" for grade in outcome.grades.values() for what, text in grade.notes]
    results = {
        "score": round(sum(marks for marks, _most, _wrong in given.values()), 2),
        "execution_time": round(outcome.seconds),
        "output": "\n".join(filter(None, [outcome.refusal, *outcome.remarks, *notes])),
        "visibility": "visible",
        "tests": tests,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as partial, open(partial, "w", encoding="utf-8") as file:
        json.dump(results, file, indent=1, ensure_ascii=False)
