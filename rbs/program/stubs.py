"""What a wheel has that is not in `rbs/`: scenes, stand-ins, and types of the modules at the top.

Setuptools calls it. An editable installation is the checkout itself, which has all of it in place.
Type checkers look for types of a module at the top in a package NAME-stubs: a copy of the module.
"""

from pathlib import Path

from setuptools.command.build_py import build_py

# By folder of the wheel: folder of the checkout, and the files that are installed.
COPIED = {
    "rbs/data": ("data", ("*.mesh", "*.off", "*.txt")),
    "rbs/released": ("graders/released", ("**/*.py",)),
}


def copied():
    """Yields (file of the checkout, its path in the wheel)."""
    for target, (folder, patterns) in COPIED.items():
        for pattern in patterns:
            for path in sorted(Path(folder).glob(pattern)):
                yield path, Path(target, path.relative_to(folder))


class BuildStubs(build_py):
    """Builds the modules, the stubs of those at the top, and COPIED."""

    def run(self):
        super().run()
        if not self.editable_mode:
            stubs = ((f"{name}.py", f"{name}-stubs/__init__.pyi") for name in self.py_modules)
            for path, target in (*stubs, *copied()):
                place = Path(self.build_lib, target)
                self.mkpath(str(place.parent))
                self.copy_file(str(path), str(place))

    def get_source_files(self):
        """Returns the files of a source distribution."""
        return [*super().get_source_files(), *(str(path) for path, _ in copied())]
