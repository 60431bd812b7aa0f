"""Files: atomic writing, with signals held back, and checks of output paths."""

import errno
import os
import signal
import threading
from contextlib import ExitStack, contextmanager, suppress
from itertools import chain, count
from pathlib import Path

from rbs.scenes.messages import InputError

RECORDING_ENDINGS = (".h5", ".hdf5")


def partial_path(path):
    """Makes an empty file to write to until it is whole, film.part.mp4 for film.mp4; its path.

    If there is one of that name, it is film.part2.mp4, and so on. A target that exists and is not a
    regular file, such as /dev/null or a pipe, is written in place and is its own partial path.
    Links are followed. Raises OSError, naming `path`.
    """
    target = Path(os.path.realpath(path))
    if os.path.isdir(target):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if os.path.exists(target) and not os.path.isfile(target):
        return target
    for number in chain([""], count(2)):
        partial = target.with_name(f"{target.stem}.part{number}{target.suffix}")
        with suppress(FileExistsError), named_errors(path):
            open(partial, "x").close()
            return partial


def put_in_place(partial, path):
    """Renames a file from its partial path to `path`, replacing an old file.

    Raises OSError, naming `path`, also if somebody has removed the file.
    """
    target = Path(os.path.realpath(path))
    with named_errors(path):
        if partial != target:
            os.replace(partial, target)
        else:
            os.stat(target)


@contextmanager
def named_errors(path):
    """Makes an OSError name `path` instead of the partial path."""
    try:
        yield
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None


@contextmanager
def atomic_write(path):
    """Yields the path of a temporary file, which replaces `path` if no error is raised.

    Raises OSError, naming `path`. An old file of that name then stays as it was.
    """
    partial = partial_path(path)
    try:
        with named_errors(path):
            yield partial
        put_in_place(partial, path)
    finally:
        remove_partial(partial)


def remove_partial(partial):
    """Removes a partial file, if it is still there."""
    if partial.is_file():
        partial.unlink()


def check_outputs(outputs, inputs):
    """Checks the output files of a run before it begins.

    outputs : dict from the name of an option to its path
    inputs : paths of the files that the run reads

    Raises InputError if the run would overwrite an input, or write a file twice; OSError if a file
    cannot be written.
    """
    taken = {os.path.realpath(path): "this run reads it" for path in inputs}
    for option, path in outputs.items():
        target = os.path.realpath(path)
        if target in taken:
            raise InputError(f"{option} {path}: not written, because {taken[target]}")
        taken[target] = f"{option} writes it too"
    for path in outputs.values():
        remove_partial(partial_path(path))


def check_path(path, what="a file"):
    """Raises TypeError unless this is the name of a file. what : kind of file, as `a video`"""
    if not isinstance(path, str | os.PathLike):
        raise TypeError(f"the name of {what} must be a path, not {type(path).__name__}")


def check_readable(path):
    """Raises OSError if this is a pipe or a device, which may never end."""
    if os.path.exists(path) and not (os.path.isfile(path) or os.path.isdir(path)):
        raise OSError(errno.EINVAL, "not a regular file", str(path))


def check_ending(path, endings, what):
    """Raises TypeError or ValueError unless the name of a file has one of these endings, in any
    case. what : kind of file
    """
    check_path(path, what)
    if Path(path).suffix.lower() not in endings:
        raise ValueError(f"the name of {what} must end in {' or '.join(endings)}, not '{path}'")


# Their names for messages. Windows has no SIGHUP.
SIGNAL_NAMES = {
    getattr(signal, name): text
    for name, text in {"SIGINT": "Ctrl-C", "SIGTERM": "kill", "SIGHUP": "a hang-up"}.items()
    if hasattr(signal, name)
}


_noted = []  # signals that no `signals_kept` has passed on yet


@contextmanager
def signals_raised():
    """Makes kill and a hang-up raise KeyboardInterrupt, as Ctrl-C does, with the signal's number.

    Respects nohup.
    """

    def interrupt(number, frame):
        _noted.append(number)
        raise KeyboardInterrupt(number)

    with ExitStack() as stack:
        for number in SIGNAL_NAMES:
            if signal.getsignal(number) != signal.SIG_IGN or number == signal.SIGINT:
                stack.callback(signal.signal, number, signal.signal(number, interrupt))
        yield


@contextmanager
def signals_kept():
    """Raises KeyboardInterrupt for a signal in the `with` block that NumPy or a student's code has
    dropped, or made another error of.
    """
    try:
        yield
    except Exception:
        if not _noted:
            raise
    finally:
        numbers = _noted[:]
        _noted.clear()
    if numbers:
        raise KeyboardInterrupt(numbers[0])


@contextmanager
def interrupts_held():
    """Lets signals with a handler, such as Ctrl-C, act at the end of the `with` block, or at once
    the second time.
    """
    noted, handlers = [], {}

    def note(number, frame):
        noted.append(number)
        if len(noted) > 1:
            handlers[number](number, frame)

    isMain = threading.current_thread() is threading.main_thread()
    for number in SIGNAL_NAMES if isMain else ():
        if callable(handler := signal.getsignal(number)):
            handlers[number] = handler
            signal.signal(number, note)
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        if noted:
            handlers[noted[0]](noted[0], None)
