"""The mistakes that hints report: each changes numbers, and no two give the same ones."""

import itertools

import Constraints
import integrationGrading
import numpy as np
import pytest
import ResolveCollisionsGrading
from oracles import DATA
from reference.graderData import ERROR_BOUND, EXACT, RELEASED_2024
from studentVariants import VARIANTS, edited, first_data, grades_of

from rbs.glass.mistakes import Mistake, mistakes_of

GRADERS = [module.GRADER for module in (integrationGrading, ResolveCollisionsGrading, Constraints)]
FUNCTIONS = {
    f"{part.function}, {convention}": (grader, part.function, convention)
    for convention in (EXACT, RELEASED_2024)
    for grader in GRADERS
    for part in grader.parts
    if mistakes_of(part.function)
}


@np.errstate(all="ignore")
def rows(parts, data, edits=()):
    """All numbers of a function at the samples that are tried, after mistakes, in one array."""
    tables = [(part, part.after_mistakes(part.given(data), edits)) for part in parts]
    return np.concatenate(
        [table[key][part.samples(data)].ravel() for part, table in tables for key in part.shapes]
    )


@pytest.mark.parametrize("case", FUNCTIONS)
def test_each_mistake_changes_numbers_and_no_two_the_same(case, released_data):
    grader, function, convention = FUNCTIONS[case]
    _grader, data = first_data(grader.module, DATA if convention == EXACT else released_data)
    assert data["convention"] == convention
    parts = [part for part in grader.parts if part.function == function]
    outcomes = {one: rows(parts, data, one.edits) for one in mistakes_of(function)}
    outcomes[Mistake((), (), "none")] = rows(parts, data)
    for (one, values1), (two, values2) in itertools.combinations(outcomes.items(), 2):
        isOther = np.abs(values1 - values2).max() > 100.0 * ERROR_BOUND
        assert isOther or one.text == two.text, (one, two)


def test_a_wrong_tensor_costs_its_function_only():
    """The rest is judged by the tensors that it gives, and so are further mistakes."""
    wrong = ("R @ self.invIT @ R.T", "np.identity(3)")
    twice = (" (1.0 + CRCoeff) *", " (1.0 + 2.0 * CRCoeff) *")
    missing = "not implemented"
    for edits, told in (
        ([wrong, twice], [missing, "hint: the resti"]),
        (VARIANTS["tensor-computed-once"], ["hint: your inve"]),
    ):
        grades = grades_of(edited(*edits))
        notes = [note for grade in grades for note in grade.notes]
        assert [text[:15] for _what, text in notes] == told
        assert len({one.function for grade in grades for one in grade.wrong}) == len(told)
