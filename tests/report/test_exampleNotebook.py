"""The notebook, executed in an empty folder."""

import pytest
from opengl import require_opengl
from oracles import ROOT

from rbs.recordings.recording import Recording
from rbs.recordings.replay import verify


@pytest.mark.slow
def test_the_notebook_runs_and_shows_what_it_promises(tmp_path, monkeypatch):
    require_opengl()
    nbclient, nbformat = map(pytest.importorskip, ("nbclient", "nbformat"))
    for library in ("k3d", "matplotlib", "ipykernel"):
        pytest.importorskip(library)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    notebook = nbformat.read(ROOT / "report" / "notebook.ipynb", as_version=4)
    assert len(notebook.cells) == 9
    assert not any(cell.get("outputs") for cell in notebook.cells)  # none are stored
    where = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=600, resources=where).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    shown = [output.get("data", {}) for output in outputs]
    html = "".join(data.get("text/html", "") for data in shown)
    assert html.count("<iframe") == 1 and html.count("<img") == 2
    assert sum("image/png" in data for data in shown) == 3  # two plots and a picture
    (text,) = [output.text for output in outputs if output.output_type == "stream"]
    assert float(text.split()[2]) < 0.05  # m, between a sliding box and the formula
    assert (tmp_path / "ramp.html").stat().st_size > 1e6
    assert verify(Recording(tmp_path / "ramp.h5")) == ""
