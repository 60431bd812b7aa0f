"""The mistakes that hints are made of: each changes numbers, and no two the same ones."""

import itertools
import sys

import numpy as np
import pytest
from oracles import DATA, ROOT
from studentVariants import first_data

sys.path.insert(0, str(ROOT / "graders"))

import Constraints
import integrationGrading
import make_reference
import ResolveCollisionsGrading
from reference.graderData import EXACT, RELEASED_2024
from verdict.hints import TABLE, explain, mistakes_of

GRADERS = [module.GRADER for module in (integrationGrading, ResolveCollisionsGrading, Constraints)]
FUNCTIONS = {
    f"{part.function}, {convention}": (grader, part.function, convention)
    for convention in (EXACT, RELEASED_2024)
    for grader in GRADERS
    for part in grader.parts
    if convention in part.conventions and mistakes_of(part.function)
}


@pytest.fixture(scope="module")
def released_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("released")
    make_reference.make_reference(folder, RELEASED_2024)
    return folder


@pytest.fixture(params=FUNCTIONS)
def case(request, released_folder):
    """(function, the parts that call it, data, whose convention is recognised)"""
    grader, function, convention = FUNCTIONS[request.param]
    _grader, data = first_data(grader.module, DATA if convention == EXACT else released_folder)
    assert data["convention"] == convention
    parts = [part for part in grader.asked(data, withExtras=True) if part.function == function]
    return function, parts, data


def rows(parts, data, names=frozenset()):
    """All numbers of a function at the samples that are tried, after mistakes, in one array."""
    tables = [(part, part.after_mistakes(data, names)) for part in parts]
    return np.concatenate(
        [table[key][part.samples(data)].ravel() for part, table in tables for key in part.shapes]
    )


def test_without_a_mistake_the_model_gives_the_expected_numbers(case):
    _function, parts, data = case
    for part in parts:
        expected, computed = part.expected(data), part.after_mistakes(data, frozenset())
        for key in part.shapes:
            samples = part.samples(data)
            assert computed[key][samples] == pytest.approx(expected[key][samples], abs=1e-11)


def test_each_mistake_changes_numbers_and_no_two_the_same(case):
    function, parts, data = case
    outcomes = {one.text: rows(parts, data, one.names) for one in mistakes_of(function)}
    outcomes["none"] = rows(parts, data)
    for (text1, values1), (text2, values2) in itertools.combinations(outcomes.items(), 2):
        assert np.abs(values1 - values2).max() > 1e-6, (text1, text2)


def test_each_mistake_is_told_by_its_own_text(case):
    function, parts, data = case
    for one in mistakes_of(function):
        outcomes = [(part, part.after_mistakes(data, one.names)) for part in parts]
        told = explain(function, outcomes, data)
        assert told, one.text
        assert all(texts == [one.text] for texts in told.values())


def test_numbers_that_nothing_explains_get_no_hint(case):
    function, parts, data = case
    generator = np.random.Generator(np.random.PCG64(1))
    outcomes = [
        (
            part,
            {
                key: value + 1e-6 * generator.normal(size=value.shape)
                for key, value in part.expected(data).items()
            },
        )
        for part in parts
    ]
    assert explain(function, outcomes, data) == {}


def test_every_mistake_of_the_table_belongs_to_a_function():
    tried = {one for _grader, function, _c in FUNCTIONS.values() for one in mistakes_of(function)}
    assert tried == set(TABLE)
