"""Video files: pictures piped to ffmpeg, which the package imageio-ffmpeg brings along."""

import errno
import subprocess
import tempfile
from contextlib import suppress
from fractions import Fraction
from pathlib import Path

from rbs.scenes.messages import InputError

FFMPEG_REMEDY = "Install it: pip install imageio-ffmpeg"
# Arguments of ffmpeg by a video's ending. Of .mp4: no artefacts to be seen; sides are made even,
# as the codec wants them; and playing can begin before the file is there to its end. Of .gif: one
# palette for all, without dithering, which would flicker and make it larger.
CODECS = {
    ".mp4": "-f mp4 -vcodec libx264 -pix_fmt yuv420p -crf 15"
    " -vf crop=trunc(iw/2)*2:trunc(ih/2)*2 -movflags +faststart".split(),
    ".gif": "-f gif -filter_complex"
    " split[a][b];[a]palettegen=stats_mode=full[p];[b][p]paletteuse=dither=none".split(),
}


class VideoError(InputError):
    """A video that cannot be made; one line."""


class Encoder:
    """An ffmpeg process that writes a video of the pictures that it is given.

    Its exit status tells whether the file is whole. Ctrl-C in a terminal does not reach it, since
    it is in a session of its own: a run ends after its step, and its video is finished.
    """

    def __init__(self, path, size, rate, arguments):
        """size : width and height of the pictures; rate : pictures a second; arguments : of ffmpeg

        Raises VideoError where there is no ffmpeg, OSError where `path` cannot be written.
        """
        try:
            import imageio_ffmpeg
        except ImportError:
            raise VideoError(f"no video: imageio-ffmpeg is missing. {FFMPEG_REMEDY}") from None

        Path(path).touch()
        self._path = path
        self._errors = tempfile.TemporaryFile()
        raw = "-y -v error -f rawvideo -pix_fmt rgb24".split()
        shape = ["-s", "{}x{}".format(*size), "-r", str(Fraction(rate).limit_denominator())]
        program = imageio_ffmpeg.get_ffmpeg_exe()
        command = [program, *raw, *shape, "-i", "-", *arguments, str(path)]
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=self._errors,
            start_new_session=True,
        )

    def write(self, picture):
        """Adds a picture (height, width, 3), uint8; raises OSError where the process has ended."""
        try:
            self._process.stdin.write(picture)
        except OSError:
            raise self._failure() from None

    def finish(self):
        """Ends the video; raises OSError if its file is not whole."""
        with suppress(OSError):  # the exit status tells
            self._process.stdin.close()
        if self._process.wait() != 0:
            raise self._failure()
        self._errors.close()

    def stop(self):
        """Ends the process, whatever there is of the file. Does nothing after `finish`."""
        self._process.kill()
        with suppress(OSError):
            self._process.stdin.close()
        self._process.wait()
        self._errors.close()

    def _failure(self):
        """The OSError of a process that has ended too early, with the last that it has said."""
        code = self._process.wait()
        self._errors.seek(0)
        said = self._errors.read().decode(errors="replace").splitlines() or [f"exit code {code}"]
        cause = f"the video is not whole: {said[-1].rpartition('] ')[2]}"
        return OSError(errno.EIO, cause, str(self._path))
