"""The mistakes that hints are made of: each changes numbers, and no two the same ones."""

import itertools
import sys

import numpy as np
import pytest
from oracles import DATA, ROOT

sys.path.insert(0, str(ROOT / "graders"))

import Constraints
import integrationGrading
import make_reference
import ResolveCollisionsGrading
from decimalMath import extended_precision
from gradingTools import EXACT, RELEASED_2024
from hints import explain

GRADERS = [module.GRADER for module in (integrationGrading, ResolveCollisionsGrading, Constraints)]
PARTS = {
    f"{part.name}, {convention}": (grader, part, convention)
    for convention in (EXACT, RELEASED_2024)
    for grader in GRADERS
    for part in grader.parts
    if convention in part.conventions
}


@pytest.fixture(scope="module")
def released_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("released")
    with extended_precision():
        make_reference.make_reference(folder, RELEASED_2024)
    return folder


@pytest.fixture(params=PARTS)
def case(request, released_folder):
    """(part, data)"""
    grader, part, convention = PARTS[request.param]
    return part, grader.load(DATA if convention == EXACT else released_folder, convention)


def rows(part, outcome, data):
    """All of a part's numbers at the samples that are tried, in one array."""
    samples = part.samples(data)
    columns = [np.asarray(outcome[key], float)[samples].ravel() for key in part.shapes]
    return np.concatenate(columns)


def test_without_a_mistake_the_model_gives_the_expected_numbers(case):
    part, data = case
    computed = rows(part, part.model(data, frozenset()), data)
    expected = rows(part, part.expected(data), data)
    assert computed == pytest.approx(expected, abs=1e-11)


def test_each_mistake_changes_numbers_and_no_two_the_same(case):
    part, data = case
    base = rows(part, part.model(data, frozenset()), data)
    outcomes = {}
    for one in part.mistakes:
        outcomes[one.text] = rows(part, part.model(data, one.names), data)
    changing = {text for text, values in outcomes.items() if np.abs(values - base).max() > 1e-6}
    if "fixed" not in part.name:  # there, all others act only on a mesh that is not fixed
        assert changing == set(outcomes)
    for (text1, values1), (text2, values2) in itertools.combinations(outcomes.items(), 2):
        if text1 in changing and text2 in changing:
            assert np.abs(values1 - values2).max() > 1e-6, (text1, text2)


def test_each_mistake_is_told_by_its_own_text(case):
    part, data = case
    for one in part.mistakes:
        values = {
            key: np.asarray(value, float)
            for key, value in part.model(data, one.names).items()
        }
        told = explain(part, values, data)
        if "fixed" in part.name and one.group != "fixed":
            assert told == {}
            continue
        assert told, one.text
        for texts in told.values():
            (text,) = texts
            assert text.startswith(one.text.split("{")[0])


def test_numbers_that_nothing_explains_get_no_hint(case):
    part, data = case
    generator = np.random.Generator(np.random.PCG64(1))
    values = {}
    for key, value in part.expected(data).items():
        value = np.asarray(value, float)
        values[key] = value + 1e-6 * generator.normal(size=value.shape)
    assert explain(part, values, data) == {}
