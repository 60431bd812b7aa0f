"""Signals that ask the program to end: noted at once, obeyed where nothing can come to harm.

Ctrl-C (SIGINT), kill (SIGTERM) and a terminal that closes (SIGHUP) are treated alike. A Python
program is broken into between any two of its instructions, which may be in the middle of a file.
Here a signal is noted, and raises `Interrupt` only within `breakable`; who writes asks `noted`, or
calls `raise_if_more`, where it can stop.

From the top: the error; watching; asking.
"""

import math
import signal
import threading
from contextlib import contextmanager

# How a person calls them. Windows has no SIGHUP.
SIGNAL_NAMES = {
    number: text
    for name, text in {"SIGINT": "Ctrl-C", "SIGTERM": "kill", "SIGHUP": "a hang-up"}.items()
    if (number := getattr(signal, name, None)) is not None
}


class Interrupt(KeyboardInterrupt):
    """A signal has asked the program to end. Attributes: signalNumber; exitCode, as shells do."""

    def __init__(self, signalNumber):
        super().__init__(f"stopped by {SIGNAL_NAMES[signalNumber]}")
        self.signalNumber = signalNumber
        self.exitCode = exit_code(signalNumber)


class _Watch:
    """What has come, and how many signals it takes to break into what is done now."""

    def __init__(self):
        self.isOn = self.hasBroken = False
        self.noted = []  # signal numbers
        self.breaksAt = math.inf

    def note(self, signalNumber, frame):
        """The handler. Breaks once only: whatever tidies up after that is left in peace."""
        self.noted.append(signalNumber)
        if len(self.noted) >= self.breaksAt and not self.hasBroken:
            self.hasBroken = True
            raise Interrupt(signalNumber)


_watch = _Watch()


def watch_signals():
    """Notes signals from now on, to the end of the process; returns the handlers of before.

    A hang-up or a kill that is ignored stays so, as `nohup` wants it. Outside of the main thread,
    which is the only one that gets signals, nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        return {}
    _watch.__init__()
    _watch.isOn = True
    handlers = {number: signal.getsignal(number) for number in SIGNAL_NAMES}
    handlers = {
        number: handler for number, handler in handlers.items()
        if handler is not None and (handler != signal.SIG_IGN or number == signal.SIGINT)
    }  # fmt: skip
    for number in handlers:
        signal.signal(number, _watch.note)
    return handlers


@contextmanager
def signals_watched():
    """Within it signals are noted; where they are already, it makes no difference."""
    if _watch.isOn:
        yield
        return
    handlers = watch_signals()
    try:
        yield
    finally:
        _watch.isOn = False
        for number, handler in handlers.items():
            signal.signal(number, handler)


@contextmanager
def breakable(count=1):
    """Within it, the `count`-th signal since watching began raises Interrupt at once.

    For what may take for ever and writes nothing of its own: loading, a step, a pipe without a
    reader.
    """
    before, _watch.breaksAt = _watch.breaksAt, count
    try:
        if len(_watch.noted) >= count and not _watch.hasBroken:  # it came before
            _watch.hasBroken = True
            raise Interrupt(_watch.noted[-1])
        yield
    finally:
        _watch.breaksAt = before


@contextmanager
def signals_left_alone():
    """Within it signals do what they did before they were watched: for a window's own loop."""
    wasOn, _watch.isOn = _watch.isOn, False
    handlers = {number: signal.getsignal(number) for number in SIGNAL_NAMES} if wasOn else {}
    ours = [number for number, handler in handlers.items() if handler == _watch.note]
    for number in ours:
        usual = signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL
        signal.signal(number, usual)
    try:
        yield
    finally:
        _watch.isOn = wasOn
        for number in ours:
            signal.signal(number, _watch.note)


def ignore_signals():
    """For the end of the process, when all is written: as it ends, Python stops watching."""
    for number in SIGNAL_NAMES:
        if signal.getsignal(number) == _watch.note:
            signal.signal(number, signal.SIG_IGN)


def noted():
    """The signals that have come since watching began: a tuple of their numbers."""
    return tuple(_watch.noted)


def raise_if_more(count):
    """Raises Interrupt if more than so many signals have come. Nothing else may be in its way."""
    if len(_watch.noted) > count:
        _watch.hasBroken = True
        raise Interrupt(_watch.noted[-1])


def exit_code(signalNumber):
    """What a shell reports of a program that this signal has ended: 130 for Ctrl-C."""
    return 128 + int(signalNumber)
