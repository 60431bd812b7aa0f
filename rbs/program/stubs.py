"""Types of the modules at the top for type checkers, which look for them only in packages.

Setuptools calls it when it builds a wheel: the stubs of a module are a copy of the module.
"""

from pathlib import Path

from setuptools.command.build_py import build_py


class BuildStubs(build_py):
    """Builds the modules, and a package NAME-stubs of each one at the top."""

    def run(self):
        super().run()
        for name in () if self.editable_mode else self.py_modules:
            folder = Path(self.build_lib, f"{name}-stubs")
            self.mkpath(str(folder))
            self.copy_file(f"{name}.py", str(folder / "__init__.pyi"))
