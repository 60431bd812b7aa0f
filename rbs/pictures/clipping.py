"""Clipping of what Polyscope draws to the part of the window beside the panels.

Polyscope fills the whole window and has no setting for this, so OpenGL's scissor test is set
directly. Without a graphics card, it saves a quarter of the time of a frame.
"""

import ctypes
import sys
from contextlib import suppress
from functools import lru_cache

# File names of OpenGL, by platform; others use that of Linux.
LIBRARIES = {"win32": "opengl32", "darwin": "/System/Library/Frameworks/OpenGL.framework/OpenGL"}
# OpenGL's number of the scissor test.
SCISSOR_TEST = 0x0C11


@lru_cache
def opengl():
    """Returns OpenGL's functions, which act on Polyscope's window; None if they are not found."""
    with suppress(OSError):
        return ctypes.CDLL(LIBRARIES.get(sys.platform, "libGL.so.1"))


def clip_drawing(box=None):
    """Draws only within a box from now on, or everywhere; ImGui's panels are always drawn.

    box : (left, bottom, width, height) in pixels of the frame buffer, from its lower left corner
    """
    if (functions := opengl()) is None:
        return
    if box is None:
        functions.glDisable(SCISSOR_TEST)
    else:
        functions.glEnable(SCISSOR_TEST)
        functions.glScissor(*map(int, box))
