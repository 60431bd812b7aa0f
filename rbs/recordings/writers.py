"""The files that a run can be written to, by option and by the ending of their names.

A further kind of file is a `Writer` and a row of OUTPUTS.
"""

from pathlib import Path
from typing import NamedTuple

from rbs.recordings.encoder import CODECS, Video
from rbs.recordings.gltf import GltfWriter
from rbs.recordings.outputs import StatsWriter
from rbs.recordings.page import PageWriter
from rbs.recordings.recording import Recorder
from rbs.scenes.files import RECORDING_ENDINGS, check_ending


class Output(NamedTuple):
    """A kind of output. what : as in "must name a video"; writers : by ending, in small letters."""

    what: str
    writers: dict

    def checked(self, path):
        """Returns the path. Raises ValueError unless it has one of the endings, in any case."""
        check_ending(path, tuple(self.writers), self.what)
        return path

    def start(self, path, *options, **others):
        """Returns the `Writer` of a path; options : of its class. Raises OutputError or OSError."""
        return self.writers[Path(self.checked(path)).suffix.lower()](path, *options, **others)


# By option of the command line.
OUTPUTS = {
    "record": Output("a recording", dict.fromkeys(RECORDING_ENDINGS, Recorder)),
    "stats": Output("a table", {".csv": StatsWriter}),
    "video": Output("a video", dict.fromkeys(CODECS, Video)),
    "export": Output("an export", {".html": PageWriter, ".glb": GltfWriter}),
}
