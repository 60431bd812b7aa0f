"""Where a run may write, and how: whole or not at all, alone, and over nothing that it reads.

From the top: `Output`, one file on its way to its place, and `atomic_write` over it; folders; pipes
and devices; which places are refused; what a run that was killed has left.
"""

import errno
import os
import shutil
import stat
import sys
import tempfile
from contextlib import contextmanager, suppress
from pathlib import Path

from rbs.files import (
    PARTIAL_ENDING,
    lock,
    lock_folder,
    named_errors,
    read_under,
    replace_file,
)
from rbs.files import unfinished_path as partial_path
from rbs.interrupts import breakable
from rbs.messages import print_note, shown_path

BUSY = "another run is writing to it"
# Bytes that are put into a pipe or a device at once.
STREAM_BYTES = 1 << 20


class Output:
    """A file that is written as `partialPath`, and takes its place by `put` when it is whole.

    The place is kept for this run, which is a matter of the partial file's lock, until `close`.
    Links are followed, so that the file behind them is replaced, and not the link. What is written
    for a pipe or a character device, such as /dev/null, goes into it by `put`.

    Attributes: path, as given; target, the path behind all links; isStream, whether that is a pipe
    or a device; partialPath.
    """

    def __init__(self, path, keepsEnding=False):
        """Raises OSError, whose line names `path`, where nothing can or may be written.

        keepsEnding : whether the partial file's name must end as `path` does, for those who tell
            the kind of a file by that
        """
        self.path = Path(path)
        self._descriptor = self._scratch = None
        with named_errors(path):
            self.target, self.isStream = find_target(path)
            if self.isStream:
                self._scratch = Path(tempfile.mkdtemp(prefix="rbs-"))
                self.partialPath = self._scratch / (self.path.name + self.target.suffix)
                self.partialPath.touch()
                return
            self.partialPath = partial_path(self.target)
            if keepsEnding:
                self.partialPath = ending_kept(self.target, PARTIAL_ENDING)
            self._descriptor = _keep_file(self.partialPath)

    def put(self):
        """Puts what has been written in its place; raises OSError that names `path`."""
        with named_errors(self.path):
            if self.isStream:
                copy_to_stream(self.partialPath, self.path)
                return
            if not os.path.samestat(os.stat(self.partialPath), os.fstat(self._descriptor)):
                raise OSError(errno.EBUSY, "something else took its place while it was written")
            replace_file(self.partialPath, self.target)
        self._release()

    def close(self, keepsPartial=False):
        """Gives the place up; removes what has not been put there, unless it is to be kept."""
        if self._scratch is not None:
            if not keepsPartial:
                shutil.rmtree(self._scratch, ignore_errors=True)
        elif self._descriptor is not None:
            if not keepsPartial:
                with suppress(OSError):
                    if os.path.samestat(os.stat(self.partialPath), os.fstat(self._descriptor)):
                        self.partialPath.unlink()
            self._release()

    def _release(self):
        os.close(self._descriptor)
        self._descriptor = None


@contextmanager
def atomic_write(path, mode="wb", **options):
    """Yields a file to write to, which takes the place of `path` when all went well.

    Otherwise an old file of that name stays as it was, and nothing of the new one is left, except
    FILE.part where the process is killed. raises OSError that names `path`
    """
    output = Output(path)
    try:
        with named_errors(path), open(output.partialPath, mode, **options) as file:
            yield file
        output.put()
    finally:
        output.close()


class OutputFolder:
    """A folder that is kept for this run: made where it is missing, and locked until `close`."""

    def __init__(self, folder):
        """Raises BlockingIOError where another run has it, or another OSError; each names it."""
        self.path = Path(folder)
        with named_errors(folder):
            check_name(self.path)
            self.path.mkdir(parents=True, exist_ok=True)
            self._descriptor = keep_folder(self.path)

    def close(self):
        """Gives the folder up."""
        release(self._descriptor)
        self._descriptor = None


def release(descriptor):
    """Closes what `keep_folder` has returned; None, of systems without locks, is nothing."""
    if descriptor is not None:
        os.close(descriptor)


def keep_folder(folder):
    """Makes a folder if there is none, and keeps it for this run: what `lock_folder` returns.

    raises BlockingIOError where another run has it, or another OSError
    """
    while True:
        try:
            os.mkdir(folder)
        except FileExistsError:
            if os.path.isfile(folder):
                raise
        try:
            descriptor = lock_folder(folder)
        except BlockingIOError as error:
            raise BlockingIOError(errno.EBUSY, BUSY, error.filename) from None
        except FileNotFoundError:
            if os.path.islink(folder):  # to nowhere
                raise
            continue  # who had it has just removed it
        if descriptor is None or _is_at(descriptor, folder):
            return descriptor
        os.close(descriptor)


def open_stream(path):
    """Opens a pipe or device for bytes; a pipe is waited for, until there is somebody who reads."""
    with breakable():
        return open(path, "wb", buffering=0)


def copy_to_stream(source, path):
    """Writes what is in a file into a pipe or device. raises OSError that names `path`"""
    with named_errors(path), open(source, "rb") as content, open_stream(path) as stream:
        with breakable():
            while block := content.read(STREAM_BYTES):
                while block:  # a pipe takes what it has room for
                    block = block[stream.write(block) :]


def find_target(path):
    """Where a file of that name is to be written: (path with links followed, whether a stream).

    raises OSError for a folder, for what is neither file nor pipe nor character device, for a name
    that means an unfinished file, and for what this run reads
    """
    check_name(Path(path))
    try:
        status = os.stat(path)
    except FileNotFoundError:  # nor what a link points at
        if os.path.lexists(os.path.realpath(path)):  # only a folder that a .. leads out of is not
            raise
        status = None
    if status is not None and stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, "this is a folder, not a file", str(path))
    if status is not None and (stat.S_ISCHR(status.st_mode) or stat.S_ISFIFO(status.st_mode)):
        return Path(path), True
    target = Path(os.path.realpath(path))
    check_name(target)
    if status is not None:
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "this is neither a file nor a pipe", str(path))
        if not target.exists() or not os.path.samestat(status, os.stat(target)):
            raise OSError(errno.ENOENT, "this file has been deleted", str(path))
    for written in (target, partial_path(target), ending_kept(target, PARTIAL_ENDING)):
        check_not_in_use(written, path)
    return target, False


def check_name(path):
    """Raises OSError for a name that FILE.part or FILE.part.png may have, while FILE is written."""
    if PARTIAL_ENDING in (path.suffix, Path(path.stem).suffix):
        cause = f"a name with {PARTIAL_ENDING} is for files that are not finished; take another"
        raise OSError(errno.EINVAL, cause, str(path))


def check_not_in_use(path, given):
    """Raises OSError, which names `given`, for a file that this run reads or prints to."""
    try:
        status = os.stat(path)
    except OSError:
        return
    other = read_under(status)
    if other is None and any(_is_same(file, status) for file in program_files()):
        other = "a part of this program"
    cause = other and f"nothing is written over what this run reads, {other}"
    if other == os.fspath(given):
        cause = "this run reads it, so it is not written over"
    for name, number in (("output", 1), ("error", 2)):
        with suppress(OSError):
            if os.path.samestat(os.fstat(number), status):
                cause = f"standard {name} goes there"
    if cause:
        raise OSError(errno.EINVAL, cause, str(given))


def program_files():
    """The paths of the modules that this program consists of, imported or not."""
    rooms = Path(__file__).resolve().parent
    names = ("RigidBodySimulation", "RBSFunctions", "GJK", "Quaternion")
    own = [*rooms.glob("*.py"), *(rooms.parent / f"{name}.py" for name in names)]
    loaded = (getattr(module, "__file__", None) for module in list(sys.modules.values()))
    return [*own, *filter(None, loaded)]


def ending_kept(path, inserted):
    """The path with something put in before its ending: v.mp4 and ".part" give v.part.mp4."""
    return path.with_name(f"{path.stem}{inserted}{path.suffix}")


def _keep_file(partial):
    """Makes a partial file for this run alone; returns a descriptor, which keeps it.

    What a run that was killed has left there is kept under another name, and that is told.
    raises BlockingIOError where another run has it, or another OSError
    """
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
    while True:
        if os.path.lexists(partial) and not stat.S_ISREG(os.lstat(partial).st_mode):
            raise OSError(errno.EEXIST, f"{partial.name} is in the way, which is not a file")
        descriptor = os.open(partial, flags, 0o666)
        try:
            try:
                lock(descriptor)
            except BlockingIOError:
                raise BlockingIOError(errno.EBUSY, BUSY) from None
            if _is_at(descriptor, partial):  # else who had it has just put it in its place
                if os.fstat(descriptor).st_size == 0:
                    return descriptor
                _move_aside(partial)
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)


def _move_aside(partial):
    """Gives what a killed run has left a name that no run takes."""
    number = 1
    while os.path.lexists(free := ending_kept(partial, f"-{number}")):
        number += 1
    os.rename(partial, free)
    print_note(f"{shown_path(partial)}: left by a run that was killed, and kept as {free.name}")


def _is_at(descriptor, path):
    """Whether what is open has that path still."""
    try:
        return os.path.samestat(os.fstat(descriptor), os.stat(path))
    except FileNotFoundError:
        return False


def _is_same(path, status):
    with suppress(OSError):
        return os.path.samestat(os.stat(path), status)
    return False
