"""What tests of the panels share."""

import pytest


@pytest.fixture
def all_open(monkeypatch, polyscope):
    """All sections of the panels are open."""
    import polyscope.imgui as psim

    header = psim.CollapsingHeader
    monkeypatch.setattr(psim, "CollapsingHeader", lambda *rest: bool(header(*rest)) or True)
