"""Stand-in for cppyy: the one C function that the coursework's code calls, without a compiler.

    PYTHONPATH=graders/released python RigidBodySimulation.py

The released files pass C++ source code to cppyy, load the collision library and call
`cppyy.gbl.isCollide`. Here the source code is ignored, and `isCollide` is this project's exact
collision test for convex bodies.
"""

import sys
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np

# The project's folder must not stay on the path: its RBSFunctions would be found before the one in
# ../code that the released graders import.
sys.path.insert(0, project := str(Path(__file__).resolve().parents[2]))
try:
    from rbs.program.submissions import PROGRAM_FOLDER, PrivateModules
finally:
    sys.path.remove(project)


def our_module(name):
    """This project's module of that name, also where a program has another one, as students do."""
    loaded = getattr(sys.modules.get(name), "__file__", None)
    if loaded and Path(loaded).resolve() == PROGRAM_FOLDER / f"{name.replace('.', '/')}.py":
        return sys.modules[name]
    return _ours().load(name)


@cache
def _ours():
    return PrivateModules([PROGRAM_FOLDER])


def _pass_over(*arguments, **options):
    """Ignores source code. Returns True, as cppyy does."""
    return True


cppdef = cppexec = include = c_include = _pass_over
add_include_path = add_library_path = load_library = add_autoload_map = _pass_over


def isCollide(n1, vertices1, COM1, n2, vertices2, COM2, depth, intNormal, intPosition):
    """Tests whether two convex bodies collide; writes the contact into the last three arguments.

    n1, n2 : arrays (1,) or numbers, counts of vertices; vertices1, vertices2 : (V, 3), in world
        axes; COM1, COM2 : unused
    depth : (1,), set to the penetration, ≥ 0
    intNormal : (3,) or (1, 3), set to the unit direction in which body 2 must move to separate
    intPosition : (3,) or (1, 3), set to the point of body 2 that is deepest inside body 1

    Returns a bool. Raises ValueError for arrays of another size.
    """
    counts = (int(np.ravel(n)[0]) for n in (n1, n2))
    hulls = [vertices[:n] for n, vertices in zip(counts, (vertices1, vertices2), strict=True)]
    isCollision, *contact = our_module("GJK").is_collide(*hulls)
    if isCollision:
        for target, value in zip((depth, intNormal, intPosition), contact, strict=True):
            target[...] = np.reshape(value, np.shape(target))
    return bool(isCollision)


class _Global(ModuleType):
    def __getattr__(self, name):
        raise AttributeError(f"the stand-in for cppyy has isCollide only, not {name}")


gbl = _Global("cppyy.gbl", "The part of the C++ global namespace that the coursework uses.")
gbl.isCollide = isCollide
sys.modules[f"{__name__}.gbl"] = gbl  # for `import cppyy.gbl`, `from cppyy.gbl import isCollide`
__path__ = []
