"""A folder with a small scene."""

import pytest
from test_loading import FILES, write


@pytest.fixture
def sceneFolder(tmp_path, monkeypatch):
    """The current folder, with a scene of two meshes and three bodies, and a constraint."""
    for name, text in FILES.items():
        write(tmp_path, name, text)
    monkeypatch.chdir(tmp_path)
    return tmp_path
