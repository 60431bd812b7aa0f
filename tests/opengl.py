"""What the tests that draw need, and what happens where it is missing."""

import os
from functools import lru_cache

import pytest

from rbs.pictures.backends import find_backend

# Set where a missing OpenGL is a failure, as in CI, and not a reason to skip.
REQUIRED = os.environ.get("RBS_REQUIRE_OPENGL") == "1"


def skip_or_fail(reason):
    """Skips the test with this reason, or fails it where RBS_REQUIRE_OPENGL=1 is set."""
    if REQUIRED:
        pytest.fail(f"RBS_REQUIRE_OPENGL=1, but {reason}")
    pytest.skip(reason)


@lru_cache
def _backend():
    return find_backend(window=False)


def require_opengl():
    """The Backend that draws off-screen here; where there is none, the test ends."""
    backend = _backend()
    if backend.name is None:
        skip_or_fail(f"nothing can be drawn here: {backend.reason}. {backend.remedy}")
    return backend
