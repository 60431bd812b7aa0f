"""Files: reading with a size limit, writing whole files only, and no output over an input."""

import errno
import os
from contextlib import contextmanager
from pathlib import Path

from rbs.scenes.messages import InputError

# Bytes of the longest text file that is read, about a mesh of a million vertices. In memory, it
# takes some ten times as much.
TEXT_BYTES = 256 << 20


def read_bytes(path, limit=TEXT_BYTES):
    """Returns all bytes of a file. Raises OSError, also if it is longer than `limit` bytes."""
    if os.path.getsize(path) > limit:
        raise OSError(errno.EFBIG, f"longer than {limit} bytes, the most that is read", str(path))
    return Path(path).read_bytes()


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
    """Gives a file written at its partial path the name `path`, in place of an old file."""
    target = Path(os.path.realpath(path))
    if partial != target:
        os.replace(partial, target)


@contextmanager
def named_errors(path):
    """Within it, an OSError names the file that the caller knows, not the partial one."""
    try:
        yield
    except OSError as error:
        error.filename, error.filename2 = str(path), None
        raise


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


def check_outputs(outputs, inputs):
    """Raises InputError if a run would write over one of its inputs, or write one file twice.

    outputs : dict from an option's name to the path that it is given
    inputs : paths of the files that the run reads
    """
    taken = {os.path.realpath(path): "this run reads it" for path in inputs}
    for option, path in outputs.items():
        target = os.path.realpath(path)
        if target in taken:
            raise InputError(f"{option} {path}: not written, because {taken[target]}")
        taken[target] = f"{option} writes it too"
