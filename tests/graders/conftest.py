"""Data and runs that the tests of the graders share."""

import io
import runpy
import signal
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout

import pytest
from oracles import ROOT

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
    """Runs a script of graders/, but not a student's code, in this process, as `subprocess.run`."""

    def run(script, *arguments, cwd="."):
        streams = [io.TextIOWrapper(io.BytesIO(), "utf-8") for _ in range(2)]
        handler = signal.getsignal(signal.SIGINT)
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(cwd)
            patch.setattr(sys, "argv", [script, *map(str, arguments)])
            with redirect_stdout(streams[0]), redirect_stderr(streams[1]):
                with pytest.raises(SystemExit) as ended:
                    runpy.run_path(str(ROOT / "graders" / script), run_name="__main__")
        signal.signal(signal.SIGINT, handler)
        texts = []
        for stream in streams:
            stream.flush()
            texts.append(stream.buffer.getvalue().decode())
        return subprocess.CompletedProcess([], ended.value.code, *texts)

    return run
