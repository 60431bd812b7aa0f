"""Files from outside, and files to be kept: reading with a limit, renaming what is whole, locks.

Whatever is read may be missing, a folder, a device that never ends, or made by someone who means
harm; whatever is written may meet a full disk or be cut short by a crash. Nothing here knows what
is in a file. From the top: reading, and what has been read; names; renaming; locks. What a run may
write to is `rbs.outputs`'.
"""

import errno
import hashlib
import os
import stat
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

# The longest text file that is read: about a mesh of a million vertices. What it becomes in memory
# is some ten times as long.
TEXT_BYTES = 256 << 20
# What is added to a file's name while it is written.
PARTIAL_ENDING = ".part"
# Bytes of the hash of a file's content.
CONTENT_HASH_SIZE = 16


class FileRead(NamedTuple):
    """A file that has been read: its path as given, the same with links followed, and a hash of
    its content, or "" where it is read piece by piece."""

    path: str
    realPath: str
    contentHash: str


# A list of FileRead for each `files_noted` that is in force, the innermost last.
_notes = []


@contextmanager
def files_noted():
    """Within it, whatever this program reads is noted: yields a list of FileRead, which grows."""
    _notes.append([])
    try:
        yield _notes[-1]
    finally:
        _notes.pop()


def note_read(path, content=None):
    """Notes that a file is read, with the hash of its content where that is at hand."""
    if _notes:
        path, contentHash = os.fspath(path), "" if content is None else content_hash(content)
        read = FileRead(path, os.path.realpath(path), contentHash)
        for notes in _notes:
            notes.append(read)


def content_hash(content):
    """BLAKE2b of a text file's bytes, in hexadecimal; lines may end in any system's way."""
    content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return hashlib.blake2b(content, digest_size=CONTENT_HASH_SIZE).hexdigest()


def read_under(status):
    """Under which path this program has read the file of that `os.stat`, or None if it has not.

    It is told by its inode: names, links and the way to it make no difference.
    """
    for read in _notes[0] if _notes else ():
        with suppress(OSError):
            if os.path.samestat(os.stat(read.realPath), status):
                return read.path
    return None


def read_bytes(path, limit=TEXT_BYTES):
    """All bytes of a file that is no longer than `limit`, which is found out before it is read.

    raises OSError; ValueError for a name that no file can have
    """
    check_regular(path)
    with open(path, "rb") as file:
        size = os.fstat(file.fileno()).st_size
        # No more than it has, since `read` makes room for as much as it is asked for.
        content = file.read(size + 1) if size <= limit else b""
    if max(size, len(content)) > limit:
        cause = f"it is longer than {limit} bytes, the most that is read"
        raise OSError(errno.EFBIG, cause, str(path))
    note_read(path, content)
    return content


def check_regular(path):
    """Raises OSError unless there is a file whose content has an end: no folder, pipe or device."""
    mode = os.stat(path).st_mode
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "this is a folder, not a file", str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "this is a pipe or a device, not a file", str(path))


def path_of_name(name):
    """The path that a name means which stands in a file: its letters are UTF-8 there.

    Where the system's locale cannot spell them, as with LC_ALL=C, it is the same bytes that count.
    """
    try:
        os.fsencode(name)
    except UnicodeEncodeError:
        with suppress(UnicodeEncodeError):
            return os.fsdecode(os.fspath(name).encode("utf-8", "surrogateescape"))
    return name


def unfinished_path(path):
    """Where a file is written before it is put in its place: in the same folder."""
    path = Path(path)
    return path.with_name(path.name + PARTIAL_ENDING)


def replace_file(partial, path):
    """Renames a finished file, in place of an old one; both have to be in the same file system.

    The content is on the disk before it has the name, so that not even a power cut leaves a file
    of that name that is not whole. raises OSError that names `path`
    """
    with named_errors(path):
        with open(partial, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(partial, path)
        sync_folder(Path(path).parent)


def sync_folder(folder):
    """Brings a folder's names to the disk, where the system lets one do that."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


@contextmanager
def named_errors(path):
    """Within it, an OSError is about the file that the caller knows, whichever it really was."""
    try:
        yield
    except OSError as error:
        error.filename, error.filename2 = str(path), None
        raise


def lock(descriptor):
    """Keeps an open file or folder for this program until the descriptor is closed.

    Nothing happens where the system has no such locks. raises BlockingIOError where it is kept
    already, by this program or another
    """
    if fcntl is None:
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:  # some network file systems
        pass


def lock_folder(folder):
    """Keeps a folder for this program until the result is closed, or the program ends in any way.

    returns a descriptor for `os.close`, or None where the system has no such locks
    raises BlockingIOError where it is kept already
    """
    if fcntl is None:
        return None
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        lock(descriptor)
    except BlockingIOError:
        os.close(descriptor)
        raise
    return descriptor


def partial_path(path):
    """Returns the path under which to write a file until it is whole: film.mp4, film.part.mp4.

    A target that exists and is no regular file, such as /dev/null or a pipe, is its own partial
    path: it is simply opened and written. Links are followed.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        return target
    return target.with_name(f"{target.stem}.part{target.suffix}")


def put_in_place(partial, path):
    """Gives a finished file its name, in place of an old one; partial : of `partial_path`."""
    target = Path(os.path.realpath(path))
    if partial != target:
        os.replace(partial, target)


@contextmanager
def atomic_write(path):
    """Yields the path of a file to write, which replaces `path` if no error is raised.

    Raises OSError that names `path`; an old file of that name then stays as it was.
    """
    partial = partial_path(path)
    try:
        with named_errors(path):
            yield partial
            put_in_place(partial, path)
    finally:
        if partial.is_file():
            partial.unlink()
