"""Graphics backends of this machine: a window, off-screen pictures, or nothing.

Polyscope is tried out in a separate process. On a display without GLX or driver, opening its window
ends the process with a segmentation fault. `fit_window`, at the end, is what Polyscope lacks.
"""

import ctypes
import os
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass

from rbs.scenes.messages import pip_install

WINDOW_BACKEND = "openGL3_glfw"
OFFSCREEN_BACKEND = "openGL3_egl"
# Polyscope links against the first package and loads the others at its start.
DEBIAN_PACKAGES = "libx11-6 libegl1 libgl1 libgl1-mesa-dri"
# Options of a Polyscope surface that is not lit, and of which only the front is drawn.
CLOSED = {"material": "flat", "back_face_policy": "cull"}
# Succeeds if Polyscope starts with the given backend, and otherwise prints the cause.
PROBE = """
import os, sys
try:
    import polyscope as ps
    ps.set_use_prefs_file(False)  # leave no files behind
    ps.set_errors_throw_exceptions(True)
    ps.init(sys.argv[1])
except Exception as error:
    print(error, flush=True)
    os._exit(1)  # skip Polyscope's own message
"""


@dataclass
class Backend:
    """A way to draw: Polyscope's name of it, or None; why no window, or nothing, opens; advice."""

    name: str | None
    reason: str = ""
    remedy: str = ""

    @property
    def opensWindow(self):
        """Whether a window can be opened. If not, a backend with a name draws pictures only."""
        return self.name == WINDOW_BACKEND


def find_backend(window):
    """Finds the `Backend` that Polyscope can use here, for a window or off-screen pictures."""
    onLinux = sys.platform.startswith("linux")  # EGL exists only on Linux
    hasDisplay = not onLinux or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    windowed = [WINDOW_BACKEND] if hasDisplay else []
    offscreen = [OFFSCREEN_BACKEND] if onLinux else [WINDOW_BACKEND]
    candidates = windowed + offscreen if window else offscreen + windowed
    reasons = [] if windowed else ["there is no display"]
    for name in dict.fromkeys(candidates):
        failure = _probe(name)
        if failure is None:
            return Backend(name, "; ".join(reasons))
        reasons.append(failure)
    if "No module named" in reasons[-1]:
        return Backend(None, reasons[-1], "Install it: " + pip_install("polyscope"))
    remedy = "Update the graphics driver"
    if onLinux:
        remedy = f"On Debian or Ubuntu, apt-get install {DEBIAN_PACKAGES} provides OpenGL"
    return Backend(None, "; ".join(reasons), remedy)


def _probe(backendName):
    command = [sys.executable, "-c", PROBE, backendName]
    result = subprocess.run(command, capture_output=True, text=True)
    if result.returncode == 0:
        return None
    if result.returncode == 1 and result.stdout:
        cause = result.stdout.splitlines()[-1].rpartition("] ")[2]
        return cause.removeprefix("ERROR: ").split(". ")[0].rstrip(".")
    return f"{backendName} ended with code {result.returncode}"


def fit_window():
    """Moves Polyscope's window into its screen, smaller if it is too large for that."""
    with suppress(OSError, AttributeError, KeyError):
        glfw = ctypes.CDLL(sys.modules["polyscope_bindings"].__file__)
        glfw.glfwGetCurrentContext.restype = glfw.glfwGetPrimaryMonitor.restype = ctypes.c_void_p
        window = ctypes.c_void_p(glfw.glfwGetCurrentContext())
        monitor = ctypes.c_void_p(glfw.glfwGetPrimaryMonitor())
        area, frame, size = ([ctypes.c_int(0) for _ in range(count)] for count in (4, 4, 2))
        glfw.glfwGetMonitorWorkarea(monitor, *map(ctypes.byref, area))
        glfw.glfwGetWindowFrameSize(window, *map(ctypes.byref, frame))
        glfw.glfwGetWindowSize(window, *map(ctypes.byref, size))
        left, top, *room = (one.value for one in area)
        before, above, after, below = (one.value for one in frame)
        free = room[0] - before - after, room[1] - above - below
        wide, high = (min(one.value, max(most, 1)) for one, most in zip(size, free, strict=True))
        glfw.glfwSetWindowSize(window, wide, high)
        place = (free[0] - wide) // 2, (free[1] - high) // 2
        glfw.glfwSetWindowPos(window, left + before + place[0], top + above + place[1])
