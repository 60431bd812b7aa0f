"""Off-screen drawing for tests: whether it works here."""

import os
from functools import lru_cache

import pytest

from rbs.pictures.backends import find_backend

found_backend = lru_cache(find_backend)


def skip_or_fail(reason):
    """Skips the test for this reason, or fails it if RBS_REQUIRE_OPENGL=1 is set, as in CI."""
    if os.environ.get("RBS_REQUIRE_OPENGL") == "1":
        pytest.fail(f"RBS_REQUIRE_OPENGL=1, but {reason}")
    pytest.skip(reason)


def require_opengl():
    """Returns the Backend that draws off-screen here; ends the test if there is none."""
    backend = found_backend(window=False)
    if backend.name is None:
        skip_or_fail(f"nothing can be drawn here: {backend.reason}. {backend.remedy}")
    return backend
