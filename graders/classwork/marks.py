"""Marks a submission by a scheme in a file, and writes Gradescope's results.json."""

import configparser
import json
from pathlib import Path

import numpy as np
from reference.graderData import ERROR_BOUND, GraderDataError
from verdict.hints import mistakes_of

from rbs.scenes.files import atomic_write

DEFAULT_SCHEME = Path(__file__).resolve().parents[1] / "marks.ini"
SCENE_MARKS = "scenes"


def load_scheme(path, graders, data):
    """Reads the marks of each function or part.

    Parameters
    ----------
    data : dict from a grader's module to its data

    Returns
    -------
    dict from each name to (its marks, quantities that do not count)

    Raises
    ------
    GraderDataError, OSError
    """
    parts = [(part, data[one.module]) for one in graders for part in one.parts]
    names = [*dict.fromkeys(name for one, _ in parts for name in (one.function, one.name))]
    names.append(SCENE_MARKS)
    parser = configparser.ConfigParser(delimiters=("=",), interpolation=None)
    parser.optionxform = str  # keeps capitals
    scheme = {}
    try:
        with open(path, encoding="utf-8-sig") as file:
            parser.read_file(file)
        for heading in parser.sections():
            for name, text in parser[heading].items():
                if name not in names:
                    raise ValueError(f"'{name}' is not one of {', '.join(names)}")
                free = [_free(*one) for one in parts if _is_of(one[0].name, name)]
                scheme[name] = float(text), [key for keys in free for key in keys]
    except (configparser.Error, ValueError) as problem:
        raise GraderDataError(f"{path}: {' '.join(str(problem).split())}") from None
    return scheme


def _is_of(part, name):
    return part == name or part.startswith(f"{name} ")


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
    quantities = [one for grade in outcome.grades.values() for one in grade.quantities]
    marks = {}
    for name, (most, free) in scheme.items():
        nearer = [one for one in scheme if _is_of(one, name) and one != name]
        own = [q for q in quantities if _is_of(q.part, name)]
        own = [q for q in own if not any(_is_of(q.part, other) for other in nearer)]
        tried = [(q.name, q.isRight) for q in own]
        if name == SCENE_MARKS:
            tried = [(f"{one.name}: {one.problem}", not one.problem) for one in outcome.scenes]
        counted = [one for one in tried if not one[1] or one[0] not in free]
        wrong = [text for text, isRight in counted if not isRight]
        if tried:
            given = most * (1 - len(wrong) / max(1, len(counted)))
            marks[name] = round(given, 2), most, wrong
    return marks


def marks_row(outcome, scheme):
    """Returns columns of marks.csv: each part, empty if not graded, and "total" and "of"."""
    given = marks_of(outcome, scheme)
    row = {name: f"{given[name][0]:g}" if name in given else "" for name in scheme}
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
