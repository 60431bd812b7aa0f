"""What all tests share: bytecode that is kept, signals, and Polyscope drawing off-screen."""

import os
import signal
import sys

import pytest

# Or every process that a test starts compiles NumPy and SciPy anew, which takes it a second.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# Background jobs of a shell ignore interrupts, and those of nohup ignore hang-ups. Programs that a
# test starts would inherit that, and the tests send both signals.
signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP"):
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.fixture(scope="module")
def polyscope():
    """Polyscope, drawing off-screen in this process with the options of a fresh start."""
    from program import require_opengl

    from rbs.pictures.view import start_polyscope

    backend = require_opengl()
    import polyscope as ps

    start_polyscope(backend)
    ps.set_vertical_fov_degrees(45.0)
    ps.set_frame_tick_limit_fps_mode("ignore_limits")  # or a tick soon after another does nothing
    return ps
