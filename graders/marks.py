"""Marks: a scheme in a file, what a hand-in gets by it, and Gradescope's results.json."""

import configparser
import json
from pathlib import Path

from gradingTools import GraderDataError

from rbs.files import atomic_write

DEFAULT_SCHEME = Path(__file__).resolve().with_name("marks.ini")
SCENES = "scenes"


def load_scheme(path, partNames):
    """The marks of a file: dict from a part's name to its marks. Raises GraderDataError, OSError.

    partNames : of the parts that there are
    """
    parser = configparser.ConfigParser(delimiters=("=",), interpolation=None)
    parser.optionxform = str  # capitals stay
    scheme = {}
    try:
        with open(path, encoding="utf-8-sig") as file:
            parser.read_file(file)
        for heading in parser.sections():
            for name, text in parser[heading].items():
                if name not in (*partNames, SCENES):
                    known = ", ".join((*partNames, SCENES))
                    raise GraderDataError(f"there is no part '{name}', but {known}")
                if name in scheme or not 0 <= float(text) <= 1000:
                    raise GraderDataError(f"{name} has two marks, or none from 0 to 1000")
                scheme[name] = float(text)
    except (configparser.Error, ValueError) as problem:
        raise GraderDataError(" ".join(str(problem).split())) from None
    return scheme


def marks_of(outcome, scheme):
    """dict from a part of the scheme to (marks, the most, what is wrong); None if not graded.

    A refused hand-in has no marks for any part.
    """
    marks = {}
    quantities = [one for grade in outcome.grades.values() for one in grade.quantities]
    for name, most in scheme.items():
        if name == SCENES:
            wrong = [f"{one.name}: {one.problem}" for one in outcome.scenes if one.problem]
            count = len(outcome.scenes)
        else:
            wrong = [one.name for one in quantities if one.part == name and not one.isRight]
            count = sum(one.part == name for one in quantities)
        marks[name] = (round(most * (1 - len(wrong) / count), 2), most, wrong) if count else None
    if outcome.refusal:
        return {name: (0.0, most, [outcome.refusal]) for name, most in scheme.items()}
    return marks


def marks_row(outcome, scheme):
    """The row of marks.csv: marks by part, empty where not graded; their sum, and of how many."""
    given = {name: one for name, one in marks_of(outcome, scheme).items() if one is not None}
    return {
        **{name: f"{given[name][0]:g}" if name in given else "" for name in scheme},
        "total": f"{sum(one[0] for one in given.values()):g}",
        "of": f"{sum(one[1] for one in given.values()):g}",
    }


def write_gradescope(path, outcome, scheme):
    """results.json as Gradescope's autograders leave it. raises OSError

    https://gradescope-autograders.readthedocs.io/en/latest/specs/
    """
    notes = [f"{what}: {text}" for grade in outcome.grades.values() for what, text in grade.notes]
    tests = [
        {
            "name": name,
            "score": one[0],
            "max_score": one[1],
            "output": f"wrong: {'; '.join(one[2])}" if one[2] else "right",
            "visibility": "visible",
        }
        for name, one in marks_of(outcome, scheme).items()
        if one is not None
    ]
    results = {
        "score": round(sum(test["score"] for test in tests), 2),
        "execution_time": round(outcome.seconds),
        "output": "\n".join(filter(None, [outcome.refusal, *outcome.remarks, *notes])),
        "visibility": "visible",
        "tests": tests,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as partial, open(partial, "w", encoding="utf-8") as file:
        json.dump(results, file, indent=1, ensure_ascii=False)
