"""The exporter of a file, chosen by the ending of its name."""

from pathlib import Path

from rbs.recordings.gltf import GltfWriter
from rbs.recordings.page import PageWriter

WRITERS = {".html": PageWriter, ".glb": GltfWriter}
EXPORT_ENDINGS = tuple(WRITERS)


def export_writer(path, colouring="body"):
    """Returns the `PoseWriter` of a path. Raises ExportError if its library is missing."""
    return WRITERS[Path(path).suffix.lower()](path, colouring)
