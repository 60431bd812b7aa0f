"""What a program does first, before it loads the modules that take a while."""

import os
import signal
import sys


def prepare():
    """Lets Ctrl-C end the program without a traceback, until its `main` begins, and opens the
    standard streams that are closed: the next pipe or file would get their numbers.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:  # open takes the lowest number that is free
            stream = open(os.devnull, mode)
            os.set_inheritable(stream.fileno(), True)
            setattr(sys, name, stream)
