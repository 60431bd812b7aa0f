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

from rbs.files import check_regular, note_read, replace_file
from rbs.messages import InputError, one_line, reason_of
from rbs.state import HASH_SIZE, STATE_WIDTHS

# A recording is an .npz file that `np.load(FILE)` reads. With s steps of n bodies it holds
#
#   positions (s + 1, n, 3), orientations (s + 1, n, 4), linVelocities, angVelocities (s + 1, n, 3)
#   times (s + 1,)      seconds; hashes (s + 1, 16), of each state, as `hash_of` has it
#   firstStep           the number of the first state: 0, unless the recording began later
#   settingsHistory     JSON, rows [step, settings]: what the steps from that one on were made with
#   restitution, ...    each field of the settings as it was at the end
#   scene, constraints  paths as given, "" for none; meshNames (n,)
#   contentHashes       JSON, hashes of what these and the meshes held; older recordings have none
#   version, numpyVersion, format
#   solver...., solverAtEnd....   what the soft-step solver had left at the first state and at the
#                       last one, where it had anything; older recordings do not have the latter
#   changes, changeNumbers, added....   what was done by hand, if anything was: see rbs/changes.py
#
# A change belongs to the step before which it was done, or to the first state, which it is part of.
# Until a body is added, its rows are zeros, and its orientation is that of no rotation.
#
# Nothing in it is compressed. Compression would save 61 % of the stress scene's 4.3 kB per step, at
# 0.13 ms; but then no state could be read on its own, and a small file could unpack to any size.

FORMAT = 1
# Of recordings with changes: an older program would not do them.
FORMAT_WITH_CHANGES = 2
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
# The whole of it, what repeats it at the file's end, and what comes after that; PKWARE's APPNOTE,
# sections 4.3.7 to 4.3.16. Numbers that do not fit have all bits set, and stand elsewhere.
WHOLE_LOCAL_HEADER = struct.Struct("<4sHHHHHIIIHH")
DIRECTORY_ENTRY = struct.Struct("<4sHHHHHHIIIHHHHHII")
DIRECTORY_SIGNATURE = b"PK\1\2"
END_RECORD = struct.Struct("<4sHHHHIIH")
END_SIGNATURE = b"PK\5\6"
LARGE_LOCATOR = struct.Struct("<4sIQI")
LARGE_LOCATOR_SIGNATURE = b"PK\6\7"
LARGE_END_RECORD = struct.Struct("<4sQHHIIQQQQ")
LARGE_END_SIGNATURE = b"PK\6\6"
UNFIT_16, UNFIT_32, LARGE_KIND = 0xFFFF, 0xFFFFFFFF, 1


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
            note_read(self.path)
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
            raise self.error(f"cannot be read ({reason_of(error)})") from None
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
            raise self.error(f"cannot be read ({reason_of(error)})") from None
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
            raise self.error(f"cannot be read ({reason_of(error)})") from None
        return result

    def damaged_member(self):
        """The name of the first array whose checksum is wrong, or None."""
        try:
            with zipfile.ZipFile(self.path) as archive:
                name = archive.testzip()  # reads in blocks
        except Exception as error:
            raise self.error(f"cannot be read ({one_line(error, QUOTE_LENGTH)})") from None
        return name and name.removesuffix(".npy")

    def damage(self):
        """What is wrong with the file, apart from what its arrays mean, in a few words; or ""."""
        name = self.damaged_member()
        if name is not None:
            return f"the array {self.path}: {name} is damaged: its checksum is wrong"
        try:
            with open(self.path, "rb") as file:
                place = misplaced_byte(file)
        except (OSError, ValueError, struct.error) as error:
            raise self.error(f"cannot be read ({one_line(error, QUOTE_LENGTH)})") from None
        return "" if place is None else f"{self.path} is damaged: the archive's {place} is wrong"


def misplaced_byte(file):
    """What is wrong first in a zip file's bookkeeping, in a few words, or None.

    Whatever is not an array's content must be there twice, or can be told from the rest: the
    header before each array and the directory at the end agree, arrays follow each other without
    gaps, all entries are made alike, and nothing else is in the file. The contents have checksums,
    which are not looked at here.

    file : open for reading, without compression; raises struct.error where it ends too soon
    """
    size = file.seek(0, os.SEEK_END)
    end = size - END_RECORD.size
    signature, disk, firstDisk, here, count, length, begin, comment = _unpack(
        file, END_RECORD, end
    )
    if (signature, disk, firstDisk, here, comment) != (END_SIGNATURE, 0, 0, count, 0):
        return "last record"
    # Where a number does not fit, all its bits are set, and a second record before has it.
    locator = _unpack(file, LARGE_LOCATOR, end - LARGE_LOCATOR.size)
    if locator[0] == LARGE_LOCATOR_SIGNATURE:
        end -= LARGE_LOCATOR.size + LARGE_END_RECORD.size
        if locator[1:] != (0, end, 1):
            return "large locator"
        small = count, length, begin
        record = _unpack(file, LARGE_END_RECORD, end)
        signature, recordSize, made, need, disk, firstDisk, here, largeCount, length, begin = record
        expected = LARGE_END_SIGNATURE, LARGE_END_RECORD.size - 12, need, 0, 0, largeCount
        if (signature, recordSize, made, disk, firstDisk, here) != expected:
            return "large last record"
        count, unfits = largeCount, (UNFIT_16, UNFIT_32, UNFIT_32)
        large = zip((count, length, begin), unfits, strict=True)
        if any(value not in pair for value, pair in zip(small, large, strict=True)):
            return "last record"
    if begin + length != end:
        return "last record"
    position, offset, kinds = begin, 0, set()
    for _ in range(count):
        entry = _unpack(file, DIRECTORY_ENTRY, position)
        signature, *kind, method, clock, date, checksum, packed, full = entry[:10]
        nameSize, extraSize, commentSize, disk, kind3, kind4, start = entry[10:]
        name, extra = file.read(nameSize), file.read(extraSize)
        kinds.add((*kind, method, kind3, kind4))
        position += DIRECTORY_ENTRY.size + nameSize + extraSize
        label = f"entry of {one_line(name.decode('utf-8', 'replace'), QUOTE_LENGTH)}"
        # The numbers that do not fit above, in this order.
        unfit = [value == UNFIT_32 for value in (full, packed, start)]
        large = iter(_large_numbers(extra, sum(unfit)))
        full, packed, start = (
            next(large, None) if isUnfit else value
            for value, isUnfit in zip((full, packed, start), unfit, strict=True)
        )
        if (signature, commentSize, disk) != (DIRECTORY_SIGNATURE, 0, 0) or start != offset:
            return label
        if len(extra) != (4 + 8 * sum(unfit) if any(unfit) else 0):
            return label
        local = _unpack(file, WHOLE_LOCAL_HEADER, start)
        localName, localExtra = file.read(local[9]), file.read(local[10])
        sizes = local[7:9]
        if sizes == (UNFIT_32, UNFIT_32):
            sizes = tuple(_large_numbers(localExtra, 2))[::-1]
            if len(localExtra) != 20:
                return label
        elif localExtra:
            return label
        expected = LOCAL_SIGNATURE, *kind[1:], method, clock, date, checksum
        if (*local[:7], localName, *sizes) != (*expected, name, packed, full):
            return label
        offset = start + WHOLE_LOCAL_HEADER.size + len(localName) + len(localExtra) + packed
    if position != end or offset != begin:
        return "directory"
    return None if len(kinds) < 2 else "directory: not all entries are of one kind, and one"


def _unpack(file, layout, position):
    """The fields of a record that stands at a position of a file."""
    file.seek(max(position, 0))
    return layout.unpack(file.read(layout.size))


def _large_numbers(extra, count):
    """The numbers of 8 bytes in a zip entry's extra field, `count` of them, or none."""
    layout = struct.Struct(f"<HH{count}Q")
    if count == 0 or len(extra) != layout.size:
        return ()
    kind, length, *numbers = layout.unpack(extra)
    return numbers if (kind, length) == (LARGE_KIND, 8 * count) else ()


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
