"""Files from outside, and files to be kept: reading with a limit, atomic writes.

Whatever is read may be missing, a folder, a device that never ends, or made by someone who means
harm; whatever is written may meet a full disk or be cut short by a crash. Nothing here knows what
is in a file. From the top: reading; atomic writes and what they are made of; locks.
"""

import errno
import os
import stat
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

# The longest text file that is read: about a mesh of a million vertices. What it becomes in memory
# is some ten times as long.
TEXT_BYTES = 256 << 20
# What is added to a file's name while it is written.
PARTIAL_ENDING = ".part"


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
    return content


def check_regular(path):
    """Raises OSError unless there is a file whose content has an end: no folder, pipe or device."""
    mode = os.stat(path).st_mode
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "this is a folder, not a file", str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "this is a pipe or a device, not a file", str(path))


@contextmanager
def atomic_write(path, mode="wb", **options):
    """Yields a file to write to, which takes the place of `path` when all went well.

    Otherwise an old file of that name stays as it was, and nothing of the new one is left, except
    FILE.part where the process is killed. raises OSError that names `path`
    """
    partial = partial_path(path)
    with named_errors(path):
        try:
            with open(partial, mode, **options) as file:
                yield file
            replace_file(partial, path)
        except BaseException:
            with suppress(OSError):
                partial.unlink(missing_ok=True)
            raise


def check_target(path):
    """Raises OSError where no file can be written at `path`; leaves nothing behind.

    So a missing folder, or missing rights, are found out before hours are spent.
    """
    path = Path(path)
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, "this is a folder, not a file", str(path))
    partial = partial_path(path)
    existed = partial.exists()
    with named_errors(path):
        open(partial, "ab").close()
        if not existed:
            partial.unlink()


def partial_path(path):
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


def lock_folder(folder):
    """Keeps a folder for this program until the result is closed, or the program ends in any way.

    returns a descriptor for `os.close`, or None where the system has no such locks
    raises BlockingIOError where it is kept already
    """
    if fcntl is None:
        return None
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        raise
    except OSError:  # some network file systems
        os.close(descriptor)
        return None
    return descriptor
