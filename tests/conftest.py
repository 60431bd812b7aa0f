"""What holds for all tests."""

import signal

# The background jobs of a shell ignore interrupts, and those of nohup hang-ups. What a test starts
# would inherit that, and the tests send both.
signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP"):
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
