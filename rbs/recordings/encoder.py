"""Video files, encoded by the ffmpeg of the package imageio-ffmpeg."""

import errno
import subprocess
import tempfile
from contextlib import suppress
from fractions import Fraction
from pathlib import Path

from rbs.scenes.messages import InputError, import_optional

# Arguments of ffmpeg by file ending. .mp4: no visible artefacts; even sides, as the codec requires;
# playable while it loads. .gif: one palette for all frames, without dithering, which flickers and
# enlarges the file.
CODECS = {
    ".mp4": "-f mp4 -vcodec libx264 -pix_fmt yuv420p -crf 15"
    " -vf crop=trunc(iw/2)*2:trunc(ih/2)*2 -movflags +faststart".split(),
    ".gif": "-f gif -filter_complex"
    " split[a][b];[a]palettegen=stats_mode=full[p];[b][p]paletteuse=dither=none".split(),
}


class VideoError(InputError):
    """A video cannot be made."""


class Encoder:
    """An ffmpeg process that writes a video.

    It runs in a session of its own, so that Ctrl-C in a terminal does not reach it, and a run that
    ends after its step can finish its video.
    """

    def __init__(self, path, size, rate, arguments):
        """size : (width, height) in pixels; rate : frames per second; arguments : of ffmpeg

        Raises VideoError if ffmpeg is missing, OSError if `path` cannot be written.
        """
        ffmpeg = import_optional("imageio-ffmpeg", "no video", VideoError)
        Path(path).touch()
        self._path = path
        self._errors = tempfile.TemporaryFile()
        raw = "-y -v error -f rawvideo -pix_fmt rgb24".split()
        shape = ["-s", "{}x{}".format(*size), "-r", str(Fraction(rate).limit_denominator())]
        command = [ffmpeg.get_ffmpeg_exe(), *raw, *shape, "-i", "-", *arguments, str(path)]
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=self._errors,
            start_new_session=True,
        )

    def write(self, picture):
        """Adds a frame (height, width, 3), uint8. Raises OSError if the process has ended."""
        try:
            self._process.stdin.write(picture)
        except OSError:
            raise self._failure() from None

    def finish(self):
        """Ends the video. Raises OSError if its file is incomplete."""
        with suppress(OSError):  # the exit status tells if it failed
            self._process.stdin.close()
        if self._process.wait() != 0:
            raise self._failure()
        self._errors.close()

    def stop(self):
        """Ends the process, leaving the file incomplete. Does nothing after `finish`."""
        self._process.kill()
        with suppress(OSError):
            self._process.stdin.close()
        self._process.wait()
        self._errors.close()

    def _failure(self):
        """Returns the OSError of a process that ended too early, with its last line."""
        code = self._process.wait()
        self._errors.seek(0)
        said = self._errors.read().decode(errors="replace").splitlines() or [f"exit code {code}"]
        cause = f"the video is incomplete: {said[-1].rpartition('] ')[2]}"
        return OSError(errno.EIO, cause, str(self._path))
