"""Options of pictures and videos, with their choices and defaults.

The command line lists the choices without importing drawing code. Reading order: the choices; the
options of a picture; the timing of a video.
"""

from dataclasses import dataclass

# Default width and height in pixels.
PICTURE_SIZE = (1280, 720)
# Least and largest width and height in pixels: a thumbnail, and 8K.
PICTURE_SIZES = (16, 8192)
# Looks of pictures: as in the window, or with sky light and soft shadows, which takes seconds.
LOOKS = ("plain", "studio")
VIDEO_ENDINGS = (".mp4", ".gif")
# Default frame rate of videos, in frames per second: smooth, and a divisor of the usual step rate.
VIDEO_RATE = 25.0
# Frames per second: the least that an encoder accepts, the most that screens show, and the most
# that an encoder accepts for a time step and --every.
SLOWEST_VIDEO, FASTEST_VIDEO, FASTEST_ENCODER = 0.01, 240.0, 1e4


@dataclass
class PictureOptions:
    """Appearance of pictures and videos, apart from the scene.

    size : (width, height) in pixels; camera : from `load_camera`, or None to show the whole scene;
    isTransparent : whether background and ground are omitted; colouring : a name of COLOURINGS;
    overlays : names of OVERLAYS; hasLegend : whether the picture explains them; look : one of LOOKS
    """

    size: tuple = PICTURE_SIZE
    camera: dict | None = None
    isTransparent: bool = False
    colouring: str = "body"
    overlays: tuple = ()
    hasLegend: bool = False
    look: str = "plain"


def video_timing(timeStep, rate=None, every=None):
    """Returns frame rate and steps per frame, `(rate, every)`, for real time as far as possible.

    timeStep : seconds; rate : frames per second, or None; every : steps per frame, or None. If
        both are given, the video plays `rate · every · timeStep` times as fast as the scene.
    """
    if every is None:
        every = max(1, round(1.0 / ((rate or VIDEO_RATE) * timeStep)))
    return rate or 1.0 / (every * timeStep), every
