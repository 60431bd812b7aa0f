"""Data and runs that the tests of the graders share."""

import subprocess
import sys

import pytest
from oracles import ROOT

sys.path.insert(0, str(ROOT / "data" / "scripts"))
sys.path.insert(0, str(ROOT / "graders"))

import make_reference

# The first samples do not depend on how many there are.
FEW_SAMPLES = 30


@pytest.fixture(scope="session")
def released_data(tmp_path_factory):
    """A folder of data with the quirks of the coursework's 2024 release, of few samples."""
    folder = tmp_path_factory.mktemp("released")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(make_reference, "SAMPLE_COUNT", FEW_SAMPLES)
        make_reference.make_reference(folder, "released-2024")
    return folder


@pytest.fixture(scope="session")
def run():
    """Runs a script of graders/ as a user does; returns the finished process."""

    def run(script, *arguments, cwd=None):
        command = [sys.executable, ROOT / "graders" / script, *map(str, arguments)]
        form = {"capture_output": True, "text": True, "timeout": 300}
        return subprocess.run(command, cwd=cwd, **form)

    return run
