"""Videos, encoded by the ffmpeg of the package imageio-ffmpeg, and series of pictures."""

import errno
import re
import subprocess
from contextlib import suppress
from fractions import Fraction
from pathlib import Path

from rbs.recordings.outputs import FileWriter
from rbs.scenes.files import named_errors
from rbs.scenes.messages import counted, shown_path
from rbs.scenes.scene import Writer

# Arguments of ffmpeg by file ending. .mp4: no visible artefacts; even sides, as the codec requires;
# playable while it loads. .gif: one palette for all frames, without dithering, which flickers and
# enlarges the file.
CODECS = {
    ".mp4": "-f mp4 -crf 15 -vf crop=trunc(iw/2)*2:trunc(ih/2)*2 -movflags +faststart".split(),
    ".gif": "-f gif -vcodec gif -pix_fmt pal8 -filter_complex"
    " split[a][b];[a]palettegen=stats_mode=full[p];[b][p]paletteuse=dither=none".split(),
}


class Video(FileWriter):
    """A video (.mp4 or .gif) of every `every`-th step.

    ffmpeg runs in a process group of its own, so that Ctrl-C in a terminal does not reach it, and a
    run that ends after its step can finish its video.
    Attributes: count, number of frames so far; rate, frames per second; every.
    """

    label, package = "video", "imageio-ffmpeg"

    def __init__(self, path, draw, rate, every):
        """Raises OutputError if ffmpeg is missing, OSError if the file cannot be written.

        draw : function that returns the picture of the present state, (height, width, 3) uint8
        """
        super().__init__(path)
        self.rate, self.every, self.count = rate, every, 0
        self._draw, self._frames, self._firstStep, self._lastStep = draw, None, None, None
        self.begin()

    def add(self, simulation):
        """Takes a frame every `every` steps, from the first call on, but never two of one step.

        Raises OSError if ffmpeg has ended.
        """
        step = simulation.stepCount
        if self._firstStep is None:
            self._firstStep = step
        if (step - self._firstStep) % self.every or step == self._lastStep:
            return
        self._lastStep = step
        self._send(1)

    def film(self, seconds):
        """Takes the present view, seconds after the first frame, as often as frames are due.

        Raises OSError as `add` does.
        """
        if (due := int(seconds * self.rate) + 1 - self.count) > 0:
            self._send(due)

    def _send(self, count):
        picture = self._draw()
        if self._frames is None:
            self._start(picture.shape[1::-1])
        try:
            for _ in range(count):
                self._frames.send(picture)
        except (OSError, StopIteration):
            raise self._failure() from None
        self.count += count

    def _start(self, size):
        """Starts ffmpeg. size : (width, height) of the pictures"""
        exactly = ["-r", str(Fraction(self.rate).limit_denominator())]  # the package may round it
        self._frames = self.module.write_frames(
            str(self.partial),
            tuple(size),
            fps=float(self.rate),
            codec="libx264",
            quality=None,
            macro_block_size=1,
            ffmpeg_log_level="quiet",
            input_params=exactly,
            output_params=CODECS[self.path.suffix.lower()],
        )
        with named_errors(self.path):
            self._frames.send(None)

    def write(self, simulation):
        """Finishes the video. Raises OSError if its file lacks a frame."""
        self._frames.close()
        command = [self.module.get_ffmpeg_exe(), "-i", self.partial, "-map", "0:v:0"]
        # in a session of its own, where no Ctrl-C in the terminal reaches it
        form = {"stderr": subprocess.PIPE, "start_new_session": True}
        told = subprocess.run([*command, "-f", "null", "-"], **form).stderr
        if re.findall(rb"frame= *(\d+)", told)[-1:] != [b"%d" % self.count]:
            raise self._failure()

    def _failure(self):
        cause = "the video is incomplete, because ffmpeg has ended; the disk may be full"
        return OSError(errno.EIO, cause, str(self.path))

    def close(self):
        """Ends ffmpeg and removes its file, if the video was not saved."""
        if self._frames is not None:
            with suppress(KeyboardInterrupt):  # which makes the package kill it
                self._frames.throw(KeyboardInterrupt)
        super().close()

    def summary(self):
        return f"{shown_path(self.path)}: {counted(self.count, 'frame')} at {self.rate:.4g} fps"


class PictureSeries(Writer):
    """Pictures of chosen steps, DIR/frame_<step, six digits>.png. count : of pictures so far."""

    label = "pictures"

    def __init__(self, path, steps, draw):
        """Creates the folder; raises OSError if that fails.

        steps : whole numbers, at which `add` takes a picture; draw : function that writes the
            picture of the present state to a path
        """
        self.path, self.count = Path(path).absolute(), 0
        self.path.mkdir(parents=True, exist_ok=True)
        self._steps, self._draw = steps, draw

    def add(self, simulation):
        """Takes a picture if the simulation is at one of the steps."""
        if simulation.stepCount in self._steps:
            self._draw(self.path / f"frame_{simulation.stepCount:06d}.png")
            self.count += 1

    def summary(self):
        return f"{self.count} in {shown_path(self.path)}"
