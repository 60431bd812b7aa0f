"""The options of pictures and videos: what can be chosen, and what there is without a choice.

The command line names these choices without importing what draws. From the top: the choices; the
options of a picture; the timing of a video.
"""

from dataclasses import dataclass

# Width and height in pixels where nobody asks for others.
PICTURE_SIZE = (1280, 720)
# The least and the largest width and height of pictures: a thumbnail, and 8K.
PICTURE_SIZES = (16, 8192)
# What can be drawn over the bodies. `rbs.pictures.view` has a function for each.
OVERLAYS = (
    "contacts",
    "impulses",
    "friction impulses",
    "velocities",
    "bounding boxes",
    "grid cells",
    "trails",
)
# How pictures are drawn: as the window is, or with sky light and soft shadows, which takes seconds.
LOOKS = ("plain", "studio")
# How much of what is behind a body is seen where bodies are see-through.
SEEN_THROUGH = 0.55
VIDEO_ENDINGS = (".mp4", ".gif")
# Pictures a second that a video has where nobody says: enough for motion to look smooth, and a
# divisor of the usual 50 steps a second.
VIDEO_RATE = 25.0
# Pictures a second: what an encoder can still write down, what screens can still show, and, of
# what time step and --every make together, what an encoder can write down again.
SLOWEST_VIDEO, FASTEST_VIDEO, FASTEST_ENCODER = 0.01, 240.0, 1e4


@dataclass
class PictureOptions:
    """What pictures and videos look like, apart from the scene.

    size : (width, height) in pixels; camera : as `load_camera` gives it, or None to see all of the
    scene; isTransparent : whether the background, and the ground, are left out; colouring : a name
    of COLOURINGS; overlays : names of OVERLAYS; hasLegend : whether their meaning is in the
    picture; look : one of LOOKS
    """

    size: tuple = PICTURE_SIZE
    camera: dict | None = None
    isTransparent: bool = False
    colouring: str = "body"
    overlays: tuple = ()
    hasLegend: bool = False
    look: str = "plain"


def video_timing(timeStep, rate=None, every=None):
    """How often a video takes a picture, and how fast it plays; in real time, as far as possible.

    timeStep : seconds; rate : pictures a second, or None; every : steps between two pictures, or
    None. Given both, the video plays `rate · every · timeStep` times as fast as the scene.
    returns (rate, every)
    """
    if every is None:
        every = max(1, round(1.0 / ((rate or VIDEO_RATE) * timeStep)))
    return rate or 1.0 / (every * timeStep), every
