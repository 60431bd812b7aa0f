"""`FileWriter`, the base of the writers of a run's files, and `Outputs`, some of them together."""

import os
from contextlib import contextmanager, suppress
from pathlib import Path

from rbs.scenes.files import named_errors, partial_path, put_in_place, remove_partial
from rbs.scenes.messages import InputError, import_optional, print_error, shown_path
from rbs.scenes.scene import Writer


class OutputError(InputError):
    """A file that cannot be written here; one line."""


class FileWriter(Writer):
    """A `Writer` of one file, which takes its place when it is whole.

    Subclasses take the states in `add`, and complete the file at `partial` in `write`.
    package : that it needs, as pip calls it, or ""; module : the package, imported
    """

    package = ""

    def __init__(self, path):
        """Raises OutputError if the package is missing."""
        self.path, self.partial = path and Path(path), None
        self.target = path and Path(os.path.realpath(path))  # whatever the current folder is later
        if self.package:
            self.module = import_optional(self.package, f"no {self.label}", OutputError)

    def begin(self):
        """Begins a file that grows with the run, at `partial`; raises OSError, naming `path`."""
        with named_errors(self.path):
            self.partial = partial_path(self.target)

    def write(self, simulation):
        """Completes the file at `partial`, after the last state. Raises OSError."""

    def save(self, simulation, isWhole=True):
        """Writes the file and puts it in place. Raises OSError.

        isWhole : whether the run came to its end; if not, an older file stays as it was, and this
            one stands beside it
        """
        with named_errors(self.path):
            if self.partial is None:
                self.begin()
            self.write(simulation)
            if not isWhole and self.partial != self.target and self.target.exists():
                self.keep()
            else:
                put_in_place(self.partial, self.target)
        self.partial = None

    def keep(self):
        """Leaves a file that is not whole beside an older one, and says so."""
        if self.partial != self.target:
            print_error(f"{self.path}: not replaced; {self.kept()} in {shown_path(self.partial)}")
        self.path, self.partial = self.partial, None

    def kept(self):
        """Returns what there is of a run that broke off, in a few words."""
        return "what there is of the run that broke off is"

    def close(self):
        """Ends a file that was not saved, and removes it. Does nothing after `save`."""
        if self.partial is not None:
            remove_partial(self.partial)
            self.partial = None


class Outputs(Writer):
    """The files of a run. One that fails is ended and reported, and the others go on.

    writers : dict of name and `Writer`; haveFailed : whether one has failed
    report : function of an error
    """

    errors = InputError, ImportError, OSError, MemoryError

    def __init__(self, report):
        self.writers, self.report, self.haveFailed = {}, report, False

    def add(self, simulation):
        """Hands each file the present state."""
        for name, writer in list(self.writers.items()):
            with self.reporting(name):
                writer.add(simulation)

    def before(self, simulation):
        """Hands each file what was done to the bodies."""
        for name, writer in list(self.writers.items()):
            with self.reporting(name):
                writer.before(simulation)

    def close(self):
        """Ends the files that were not saved."""
        for writer in self.writers.values():
            writer.close()

    @contextmanager
    def reporting(self, name=None):
        """Reports an error of the `with` block, which ends the writer of this name."""
        try:
            yield
        except self.errors as error:
            self.haveFailed = True
            self.report(error)
            if writer := self.writers.pop(name, None):
                with suppress(OSError):  # reported above
                    writer.close()
