"""The files of a recording: what is in one, reading it row by row, writing it.

From the top: the layout; `RecordingFile`, which trusts nothing that a file announces;
`write_recording_file`. What the numbers mean, and how files follow each other in an interrupted
recording, is `rbs.recording`'s.

Units: metres, kilograms, seconds.
"""

import math
import os
import struct
import zipfile
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rbs.files import check_regular, replace_file
from rbs.messages import InputError, one_line
from rbs.state import HASH_SIZE, STATE_WIDTHS

# A recording is an .npz file that `np.load(FILE)` reads. With s steps of n bodies it holds
#
#   positions (s + 1, n, 3), orientations (s + 1, n, 4), linVelocities, angVelocities (s + 1, n, 3)
#   times (s + 1,)      seconds; hashes (s + 1, 16), of each state, as `hash_of` has it
#   firstStep           the number of the first state: 0, unless the recording began later
#   settingsHistory     JSON, rows [step, settings]: what the steps from that one on were made with
#   restitution, ...    each field of the settings as it was at the end
#   scene, constraints  paths as given, "" for none; meshNames (n,)
#   version, numpyVersion, format
#   solver....          what the soft-step solver had left at the first state, where it had anything
#
# Nothing in it is compressed. Compression would save 61 % of the stress scene's 4.3 kB per step, at
# 0.13 ms; but then no state could be read on its own, and a small file could unpack to any size.

FORMAT = 1
# The arrays with a row for each state, in the order of the file: the type of their numbers and the
# shape of a row, of a body's share of it where there is one for each body.
SERIES = {
    **{name: ("<f8", (width,)) for name, width in STATE_WIDTHS.items()},
    "times": ("<f8", ()),
    "hashes": ("|u1", (HASH_SIZE,)),
}
# The most bytes of an array that is read as a whole, as the names of the bodies are.
LARGEST_ARRAY = 64 << 20
# The most characters that are told of what a file says.
QUOTE_LENGTH = 80
# What stands before each array in a zip file: a signature and, after what its end repeats, the
# lengths of the name and of the extra field that follow.
LOCAL_HEADER = struct.Struct("<4s22xHH")
LOCAL_SIGNATURE = b"PK\3\4"


class RecordingError(InputError):
    """A recording that cannot be used, or not written. Reads "file: cause" in one line."""

    def __init__(self, path, cause):
        super().__init__(f"{path}: {cause}")


class ArrayMember(NamedTuple):
    """An array in a recording's file: its numbers start at byte `start` and go on to the end."""

    dtype: np.dtype
    shape: tuple
    start: int


class RecordingFile:
    """One .npz file whose arrays are read row by row, and only those that are asked for.

    Opening it reads headers only. What they announce is compared with the size of the file, and
    nothing may be compressed, so that no file makes this program allocate more than it is long.
    """

    def __init__(self, path):
        """Raises RecordingError, also where the file is missing."""
        self.path = Path(path)
        self._members = {}
        try:
            check_regular(self.path)
            size = os.path.getsize(self.path)
            with open(self.path, "rb") as file, zipfile.ZipFile(file) as archive:
                entries = archive.infolist()
                if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):
                    raise self.error("its arrays are compressed, those of a recording are not")
                announced = sum(max(entry.file_size, entry.compress_size) for entry in entries)
                if announced > size:
                    raise self.error(
                        f"it announces {announced} bytes, more than the {size} that it has"
                    )
                for entry in entries:
                    name = entry.filename.removesuffix(".npy")
                    self._members[name] = self._locate(file, entry)
        except RecordingError:
            raise
        except OSError as error:
            raise self.error(f"cannot be read ({error.strerror or error})") from None
        except Exception as error:
            # Whatever zipfile and NumPy's header parser raise about bytes that are neither.
            raise self.error(f"this is not a recording ({one_line(error, QUOTE_LENGTH)})") from None

    def error(self, cause):
        """The RecordingError about this file. To be raised by the caller."""
        return RecordingError(self.path, cause)

    def _locate(self, file, entry):
        """The ArrayMember that a zip entry holds. Its checksum is not looked at."""
        name = one_line(entry.filename, QUOTE_LENGTH)
        file.seek(entry.header_offset)
        signature, nameSize, extraSize = LOCAL_HEADER.unpack(file.read(LOCAL_HEADER.size))
        if signature != LOCAL_SIGNATURE or file.read(nameSize) != entry.filename.encode():
            raise self.error(f"the array {name} is not where the end of the file says")
        begin = file.seek(extraSize, os.SEEK_CUR)
        read_header = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }.get(np.lib.format.read_magic(file))
        if read_header is None:
            raise self.error(f"the array {name} is of an unknown kind")
        shape, isFortran, dtype = read_header(file)
        start = file.tell()
        if dtype.hasobject or isFortran or dtype.itemsize == 0 or min(shape, default=0) < 0:
            raise self.error(f"the array {name} is of a kind that no recording holds")
        if math.prod(shape) * dtype.itemsize != begin + entry.file_size - start:
            raise self.error(f"the array {name} is not as long as it announces")
        return ArrayMember(dtype, shape, start)

    def member(self, name):
        """The ArrayMember of that name; raises RecordingError where there is none."""
        if name not in self._members:
            raise self.error(f"this is not a recording (there is no array '{name}' in it)")
        return self._members[name]

    def names(self):
        """The names of all arrays, in the order of the file."""
        return list(self._members)

    def read_array(self, name, kinds):
        """A whole array, for the small ones; its checksum is checked.

        kinds : of the dtype, "U" or "i" for instance; any of these letters will do
        """
        member = self.member(name)
        if member.dtype.kind not in kinds:
            raise self.error(f"the array {name} holds the wrong kind of values")
        if math.prod(member.shape) * member.dtype.itemsize > LARGEST_ARRAY:
            raise self.error(f"the array {name} is longer than {LARGEST_ARRAY} bytes")
        try:
            with zipfile.ZipFile(self.path) as archive:
                content = archive.read(name + ".npy")
            content = content[len(content) - math.prod(member.shape) * member.dtype.itemsize :]
            return np.frombuffer(content, member.dtype).reshape(member.shape)
        except OSError as error:
            raise self.error(f"cannot be read ({error.strerror or error})") from None
        except Exception:  # whatever zipfile raises where the file's two directories disagree
            raise self.error(f"the array {name} is damaged: its checksum is wrong") from None

    def rows(self, names, begin, end):
        """Rows begin ≤ row < end of some arrays, as a dict of arrays."""
        result = {}
        try:
            with open(self.path, "rb") as file:
                for name in names:
                    dtype, shape, start = self.member(name)
                    rowBytes = math.prod(shape[1:]) * dtype.itemsize
                    file.seek(start + begin * rowBytes)
                    content = file.read((end - begin) * rowBytes)
                    if len(content) < (end - begin) * rowBytes:
                        raise self.error("the file has become shorter since it was opened")
                    result[name] = np.frombuffer(content, dtype).reshape(-1, *shape[1:])
        except OSError as error:
            raise self.error(f"cannot be read ({error.strerror or error})") from None
        return result

    def damaged_member(self):
        """The name of the first array whose checksum is wrong, or None."""
        try:
            with zipfile.ZipFile(self.path) as archive:
                name = archive.testzip()  # reads in blocks
        except Exception as error:
            raise self.error(f"cannot be read ({one_line(error, QUOTE_LENGTH)})") from None
        return name and name.removesuffix(".npy")


def write_recording_file(partial, path, rows, head):
    """Writes an .npz file as `partial`, brings it to the disk and renames it; or leaves nothing.

    rows : dict of (shape, blocks that follow each other); head : dict of what is small
    """
    head = {name: np.asarray(value) for name, value in head.items()}
    arrays = rows | {name: (value.shape, [value]) for name, value in head.items()}
    try:
        with open(partial, "wb") as file, zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
            for name, (shape, blocks) in arrays.items():
                dtype = np.dtype(SERIES[name][0]) if name in SERIES else head[name].dtype
                _write_member(archive, name, shape, dtype, blocks)
        replace_file(partial, path)
    except BaseException:
        with suppress(OSError):
            Path(partial).unlink(missing_ok=True)
        raise


def _write_member(archive, name, shape, dtype, blocks):
    """Writes one array as `np.savez` would, a block at a time."""
    # An entry made like this has no time of day: the same run writes the same bytes.
    with archive.open(zipfile.ZipInfo(name + ".npy"), "w", force_zip64=True) as member:
        np.lib.format.write_array_header_1_0(
            member,
            {
                "descr": np.lib.format.dtype_to_descr(dtype),
                "fortran_order": False,
                "shape": shape,
            },
        )
        for block in blocks:
            member.write(np.ascontiguousarray(block, dtype).tobytes())
