"""Signals that ask a program to end, held back while a file is written."""

import signal
import threading
from contextlib import contextmanager

# Their names for messages. Windows has no SIGHUP.
SIGNAL_NAMES = {
    getattr(signal, name): text
    for name, text in {"SIGINT": "Ctrl-C", "SIGTERM": "kill", "SIGHUP": "a hang-up"}.items()
    if hasattr(signal, name)
}


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
