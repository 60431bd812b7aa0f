"""Pictures as PNG files, which Polyscope writes of what is on its screen only.

Section numbers are those of the PNG specification, https://www.w3.org/TR/png-3/.
"""

import struct
import zlib

import numpy as np

# How hard zlib tries, up to 9: beyond, pictures are drawn no smaller by a hundredth.
COMPRESSION = 8
# Of eight bits a channel: (colour type 2, RGB, or 6, with opacity) by the number of channels.
COLOUR_TYPES = {3: 2, 4: 6}


def png_bytes(picture):
    """The PNG file of a picture (height, width, 3 or 4), uint8; bytes."""
    height, width, channels = picture.shape
    header = struct.pack(">IIBBBBB", width, height, 8, COLOUR_TYPES[channels], 0, 0, 0)
    rows = zlib.compress(_filtered(picture).tobytes(), COMPRESSION)
    chunks = (b"IHDR", header), (b"IDAT", rows), (b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(*chunk) for chunk in chunks)


def _chunk(kind, data):
    """Length, kind, data and checksum (5.3)."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _filtered(picture):
    """Each row as its differences from the left or from above, where that is less (9.2, 12.7)."""
    height = len(picture)
    left, above = np.zeros_like(picture), np.zeros_like(picture)
    left[:, 1:], above[1:] = picture[:, :-1], picture[:-1]
    filters = [
        (picture - other).reshape(height, -1) for other in (np.zeros_like(picture), left, above)
    ]
    sizes = [np.abs(rows.view(np.int8).astype(np.int16)).sum(axis=1) for rows in filters]
    best = np.argmin(sizes, axis=0)
    rows = np.choose(best[:, None], filters)
    return np.concatenate([best[:, None].astype(np.uint8), rows], axis=1)
