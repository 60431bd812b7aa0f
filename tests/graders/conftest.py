"""Data and runs that the tests of the graders share."""

import sys

import pytest
from oracles import ROOT
from program import run_script

sys.path.insert(0, str(ROOT / "data" / "scripts"))
sys.path.insert(0, str(ROOT / "graders"))

import make_reference


@pytest.fixture(scope="session")
def released_data(tmp_path_factory):
    """A folder of data with the quirks of the coursework's 2024 release."""
    folder = tmp_path_factory.mktemp("released")
    make_reference.make_reference(folder, "released-2024")
    return folder


@pytest.fixture(scope="session")
def run():
    return lambda script, *words, **more: run_script(ROOT / "graders" / script, *words, **more)
