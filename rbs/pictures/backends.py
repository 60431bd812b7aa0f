"""What can be drawn with on this machine: a window, off-screen pictures, or nothing.

Polyscope is tried out in a process of its own, because on a display that has no GLX or no driver,
opening its window ends the process by a segmentation fault.
"""

import os
import subprocess
import sys
from dataclasses import dataclass

WINDOW_BACKEND = "openGL3_glfw"
OFFSCREEN_BACKEND = "openGL3_egl"
# Polyscope links against the first and loads the others when it starts.
DEBIAN_PACKAGES = "libx11-6 libegl1 libgl1 libgl1-mesa-dri"
# Ends well if Polyscope starts with the backend that is given, or else prints the cause.
PROBE = """
import os, sys
try:
    import polyscope as ps
    ps.set_use_prefs_file(False)  # else it leaves files behind
    ps.set_errors_throw_exceptions(True)
    ps.init(sys.argv[1])
except Exception as error:
    print(error, flush=True)
    os._exit(1)  # at its usual end, Polyscope would add that it has not been started
"""


@dataclass
class Backend:
    """What `find_backend` found.

    name : Polyscope's name of the backend, None where nothing can be drawn
    reason : why there is no window, or nothing at all; "" where all is well
    remedy : what to do about it
    """

    name: str | None
    reason: str = ""
    remedy: str = ""

    @property
    def opensWindow(self):
        """Whether a window can be opened; else only pictures can be drawn, if a name is given."""
        return self.name == WINDOW_BACKEND


def find_backend(window):
    """Finds out how Polyscope can draw here, without importing it into this process.

    window : whether a window is wanted; without one, only pictures are
    returns a Backend
    """
    onLinux = sys.platform.startswith("linux")  # elsewhere, there is no EGL
    windowed = [WINDOW_BACKEND] if has_display() else []
    offscreen = [OFFSCREEN_BACKEND] if onLinux else [WINDOW_BACKEND]
    candidates = windowed + offscreen if window else offscreen + windowed
    reasons = [] if windowed else ["there is no display"]
    for name in dict.fromkeys(candidates):
        failure = _probe(name)
        if failure is None:
            return Backend(name, "; ".join(reasons))
        reasons.append(failure)
    if "No module named" in reasons[-1]:
        return Backend(None, reasons[-1], "Install it: pip install polyscope")
    remedy = "Update the graphics driver"
    if onLinux:
        remedy = f"On Debian or Ubuntu, apt-get install {DEBIAN_PACKAGES} provides OpenGL"
    return Backend(None, "; ".join(reasons), remedy)


def has_display():
    """Whether a window could be opened at all. Off Linux, there always is a display."""
    if not sys.platform.startswith("linux"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _probe(backendName):
    """Starts Polyscope in another process: None where that works, else what went wrong."""
    command = [sys.executable, "-c", PROBE, backendName]
    result = subprocess.run(command, capture_output=True, text=True)
    if result.returncode == 0:
        return None
    if result.returncode == 1 and result.stdout:
        cause = result.stdout.splitlines()[-1].rpartition("] ")[2]
        return cause.removeprefix("ERROR: ").split(". ")[0].rstrip(".")
    return f"{backendName} ended with code {result.returncode}"
