"""Stand-in for Polyscope: a student's module that opens a window while it is imported goes on.

Whatever is asked of it is the stand-in again. It counts as true, so that a loop until the window
closes ends.
"""

import sys
from types import ModuleType


class Nothing(ModuleType):
    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return self

    def __call__(self, *_given, **_named):
        return self

    def __iter__(self):
        return iter(())


_this = sys.modules[__name__]
_this.__class__ = Nothing
sys.modules |= dict.fromkeys((f"{__name__}.imgui", f"{__name__}.implot"), _this)
