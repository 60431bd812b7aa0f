"""What a program does first, before it loads the modules that take a while."""

import os
import signal
import sys


def prepare():
    """Lets Ctrl-C end the program without a traceback, until its `main` begins."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    open_streams()


def open_streams():
    """Opens the standard streams that are closed, because the next pipe or file would get their
    numbers; and lets the others print what a terminal has no characters for.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        stream = getattr(sys, name)
        if stream is None:  # open takes the lowest number that is free
            setattr(sys, name, stream := open(os.devnull, mode))
            os.set_inheritable(stream.fileno(), True)
        elif hasattr(stream, "reconfigure"):  # a program that runs this one may replace them
            stream.reconfigure(errors="backslashreplace")
