"""Marks a submission by the coursework's scheme, and writes Gradescope's results.json."""

import json

import numpy as np
from verdict.hints import right_by_chance

# In percent of the whole. A function's marks are in proportion to its right quantities, scenes' to
# the steps that agree with ours. All other items are the marker's.
SCHEME = {
    "integrate_timestep": 7,
    "get_rotated_inv_IT": 3,
    "resolve_collision": 10,
    "scenes": 10,
    "report on the basic simulation": 10,
    "resolve_position_constraint": 4,
    "resolve_velocity_constraint": 6,
    "constraint scenes": 5,
    "report on constraints": 5,
    "extension": 10,
    "report on the extension": 5,
    "report": 25,
}


def unearned(graders, data):
    """Returns the quantities that do not count, because they are right even if nothing is written,
    or with the same answer always: a dict from a function's name to a list.

    data : dict from a grader's module to its data
    """
    found = {}
    for grader in graders:
        given = data[grader.module]
        for part in grader.parts:
            for key, rows in part.expected(given).items():
                isConstant = not np.ptp(rows[part.samples(given)], axis=0).any()
                if isConstant or right_by_chance(part, key, given).all():
                    found.setdefault(part.function, []).append(key)
    return found


def marks_of(outcome, free):
    """Returns a dict from each graded item of the scheme to (marks, maximum, what is wrong).

    free : of `unearned`
    """
    tried, marks = {}, {}
    for (name, item), one in outcome.scenes.items():
        tried.setdefault(item, []).append((f"{name}: {one.problem}", one.share))
    for quantity in (one for grade in outcome.grades.values() for one in grade.quantities):
        tried.setdefault(quantity.function, []).append((quantity.name, quantity.share))
    for name, most in SCHEME.items():
        own = free.get(name, ())
        counted = [one for one in tried.get(name, ()) if one[1] == 0 or one[0] not in own]
        if tried.get(name):
            given = most * sum(share for _text, share in counted) / max(1, len(counted))
            marks[name] = round(given, 2), most, [text for text, share in counted if share < 1]
    return marks


def marks_row(outcome, free):
    """Returns columns of marks.csv: each item, empty if not graded, and "total" and "of"."""
    row, given = dict.fromkeys((*SCHEME, "total", "of"), ""), marks_of(outcome, free)
    if given:
        row["total"] = f"{round(sum(one[0] for one in given.values()), 2):g}"
        row["of"] = str(sum(one[1] for one in given.values()))
    return row | {name: f"{one[0]:g}" for name, one in given.items()}


def gradescope_of(outcome, free):
    """Returns results.json as Gradescope expects it of an autograder.

    https://gradescope-autograders.readthedocs.io/en/latest/specs/
    """
    tests, given = [], marks_of(outcome, free)
    for name, (marks, most, wrong) in given.items():
        test = {"name": name, "score": marks, "max_score": most}
        tests.append(test | {"output": f"wrong: {'; '.join(wrong)}" if wrong else "right"})
    notes = [text for grade in outcome.grades.values() for text in grade.told]
    results = {
        "score": round(sum(marks for marks, _most, _wrong in given.values()), 2),
        "execution_time": round(outcome.seconds),
        "output": "\n".join(filter(None, [outcome.refusal, *outcome.remarks, *notes])),
        "visibility": "visible",
        "tests": tests,
    }
    return json.dumps(results, indent=1, ensure_ascii=False)
