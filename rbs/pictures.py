"""Pictures and videos of a scene, drawn off-screen or from the window.

From the top: starting to draw; series of pictures; videos; whether a file is complete. Polyscope is
imported inside the functions that use it.
"""

import errno
import os
from pathlib import Path

import numpy as np

from rbs.cameras import apply_camera
from rbs.colours import BACKGROUND
from rbs.drawing import SceneView, start_polyscope
from rbs.messages import InputError
from rbs.outputs import Output, OutputFolder, find_target
from rbs.pictureoptions import PICTURE_NAME

# What is told of a file that has no end; neither Polyscope nor the encoder says so.
INCOMPLETE = "the {} could not be written to its end; is the disk full?"
FFMPEG_REMEDY = "Install it: pip install imageio-ffmpeg"
# Of H.264 in imageio-ffmpeg's scale up to 10: no artefacts to be seen.
VIDEO_QUALITY = 7
# Whose pictures have even sides.
EVEN_FILTER = "crop=trunc(iw/2)*2:trunc(ih/2)*2"
# One palette for all of a GIF, without dithering, which would flicker and make it larger.
GIF_FILTER = "split[a][b];[a]palettegen=stats_mode=full[p];[b][p]paletteuse=dither=none"


class VideoError(InputError):
    """A video that cannot be made; one line."""


def start_view(simulation, backend, options, sideWidth=0):
    """Starts Polyscope for pictures with these PictureOptions; returns a SceneView."""
    start_polyscope(backend, options.size)
    view = SceneView(simulation, sideWidth)
    if options.camera is not None:
        apply_camera(options.camera)
    view.colouring = options.colouring
    view.shown.update(options.overlays)
    view.show("ground", not options.isTransparent)
    return view


class PictureSeries:
    """Pictures of chosen steps, DIR/frame_<step, six digits>.png.

    Attributes: folder; count, the pictures so far; path, the last one.
    """

    def __init__(self, folder, steps, view, isTransparent=False):
        """Makes the folder; raises OSError when that cannot be done.

        steps : whole numbers, those of which `add` takes a picture; view : SceneView
        """
        self.folder = Path(folder)
        self._place = OutputFolder(folder)
        try:
            Output(self.folder / "frame.png", keepsEnding=True).close()
            for path in self.folder.iterdir():
                if PICTURE_NAME.fullmatch(path.name):  # it may be written over
                    find_target(path)
        except BaseException:
            self._place.close()
            raise
        self.count = 0
        self._steps = steps
        self._view = view
        self._isTransparent = isTransparent

    def add(self, simulation):
        """Takes a picture if the simulation stands at one of the steps."""
        if simulation.stepCount in self._steps:
            self._view.refresh()
            path = self.folder / f"frame_{simulation.stepCount:06d}.png"
            save_picture(path, self._isTransparent)
            self.count += 1

    def close(self):
        """Gives the folder up, to other runs."""
        self._place.close()


def save_picture(path, isTransparent=False):
    """Writes what the camera sees as PNG, in place of an old file: whole or not at all."""
    import polyscope as ps

    output = Output(path, keepsEnding=True)
    # Polyscope asks for both: a background of no opacity, and that this be kept.
    ps.set_background_color((*BACKGROUND, 0.0 if isTransparent else 1.0))
    try:
        ps.screenshot(str(output.partialPath), transparent_bg=isTransparent)
        if not is_complete_png(output.partialPath):  # it does not say that the disk is full
            raise OSError(errno.ENOSPC, INCOMPLETE.format("picture"), str(path))
        output.put()
    finally:
        output.close()


class Video:
    """A video (.mp4 or .gif) of every `every`-th step.

    Written beside its place under another name and put there by `save`. Attributes: path; count,
    the pictures so far; rate, pictures a second; every.
    """

    def __init__(self, path, view, rate, every):
        """Starts the encoder; raises VideoError where there is none, OSError where it cannot
        write at `path`."""
        import polyscope as ps

        try:
            import imageio_ffmpeg
        except ImportError:
            raise VideoError(f"no video: imageio-ffmpeg is missing. {FFMPEG_REMEDY}") from None

        self.path = Path(path)
        self.rate, self.every = rate, every
        self.count = 0
        self._view = view
        self._firstStep = self._lastStep = None
        self._output = Output(path, keepsEnding=True)
        if self.path.suffix.lower() == ".gif":
            options = {"codec": "gif", "pix_fmt_out": "pal8", "quality": None}
            parameters = ["-filter_complex", GIF_FILTER]
        else:
            options = {"codec": "libx264", "quality": VIDEO_QUALITY}
            parameters = ["-vf", EVEN_FILTER, "-movflags", "+faststart"]
        self._writer = imageio_ffmpeg.write_frames(
            str(self._output.partialPath), ps.get_buffer_size(), fps=rate, macro_block_size=1,
            output_params=parameters, ffmpeg_log_level="quiet", **options,
        )  # fmt: skip
        self._writer.send(None)

    def add(self, simulation):
        """Takes a picture each `every` steps, from the first call on, but of no step twice.

        raises OSError where the encoder has given up
        """
        step = simulation.stepCount
        if self._firstStep is None:
            self._firstStep = step
        if (step - self._firstStep) % self.every == 0 and step != self._lastStep:
            import polyscope as ps

            self._view.refresh()
            picture = ps.screenshot_to_buffer(transparent_bg=False)[:, :, :3]
            try:
                self._writer.send(np.ascontiguousarray(picture))
            except (OSError, StopIteration):  # of several lines, about a pipe
                raise OSError(errno.ENOSPC, INCOMPLETE.format("video"), str(self.path)) from None
            self.count += 1
            self._lastStep = step

    def save(self):
        """Ends the video and puts it in its place, where an old one may be; raises OSError."""
        self._writer.close()
        if not is_complete_video(self._output.partialPath):  # the encoder says nothing
            raise OSError(errno.ENOSPC, INCOMPLETE.format("video"), str(self.path))
        self._output.put()

    def summary(self, simulation):
        """How long it is, and how fast it plays, in words."""
        factor = self.rate * self.every * simulation.settings.timeStep
        pace = "in real time" if abs(factor - 1.0) < 0.01 else f"at {factor:.3g} times real time"
        return f"{self.count} pictures, {self.rate:.4g} a second, {pace}"

    def close(self):
        """Removes what was written beside the place. Does nothing after `save`."""
        self._writer.close()
        self._output.close()


def is_complete_png(path):
    """Whether a file begins and ends like a PNG. What is missing at the end is found so."""
    content = Path(path).read_bytes()
    return content.startswith(b"\x89PNG\r\n\x1a\n") and content.endswith(b"IEND\xaeB`\x82")


def is_complete_video(path):
    """Whether an .mp4 or .gif has its beginning and its end; its pictures are not looked at."""
    with open(path, "rb") as file:
        size = file.seek(0, os.SEEK_END)
        if Path(path).suffix.lower() == ".gif":
            file.seek(max(size - 1, 0))
            return size > 0 and file.read() == b";"
        # A row of boxes, each with its length and kind before it.
        position, kinds = 0, set()
        while position < size:
            file.seek(position)
            head = file.read(16)
            length, kind = int.from_bytes(head[:4], "big"), head[4:8]
            if length == 1:  # the length follows in eight bytes
                length = int.from_bytes(head[8:16], "big")
            if length < 8 or position + length > size:
                return False
            kinds.add(kind)
            position += length
    return {b"moov", b"mdat"} <= kinds
