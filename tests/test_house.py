"""Which module imports which, found in the source of `rbs/` and of the four modules at the top.

Every import counts, also one inside a function.
"""

import ast
import re
import subprocess
import sys

import pytest
from mutations import FAULTS
from oracles import ROOT

TOP = ("RBSFunctions", "RigidBodySimulation", "Quaternion", "GJK")
# The packages of rbs/, each of which imports only those before it.
PACKAGES = "geometry stepping softstep scenes recordings opening appearance exports"
PACKAGES = tuple(f"{PACKAGES} pictures window program".split())
# The last package that a module at the top may import; Quaternion imports none.
ABOVE = {"GJK": "geometry", "RBSFunctions": "softstep", "RigidBodySimulation": "program"}
MOST_LINES_OF_A_PACKAGE = 2000
# Folders that use the modules and that no module uses.
USERS = {"tests", "report", "graders"}
# Lines; a longer file is to be split.
MOST_LINES = 750


def rooms():
    """The sources of all rooms: dict of module name and path."""
    found = {name: ROOT / f"{name}.py" for name in TOP}
    for path in sorted(ROOT.glob("rbs/**/*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(part for part in parts if part != "__init__")] = path
    return found


def imports(source, known):
    """What a module imports: a set of the known modules, or top-level names of others.

    known : names of modules; `from rbs import drawing` imports `rbs.drawing` if that is one of them
    """
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                found.add(inner if inner in known else node.module)
    return {name if name in known else name.split(".")[0] for name in found}


def is_private(name):
    return name.startswith("_") and not name.startswith("__")


def foreign_privates(source, known):
    """The private names of others that a module uses: a set of names.

    `from x import _y` and "x._y" in a text, as it is handed to monkeypatch, where x is one of the
    known modules; and `x._y` for any x but self and cls, unless the module defines _y itself or has
    x from elsewhere. `_replace` and its like are what a named tuple offers to all;
    notebooks call `_repr_html_`.
    """
    tree = ast.parse(source)
    found, elsewhere, own = set(), set(), {"_replace", "_asdict", "_fields", "_make"}
    own.add("_repr_html_")
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name not in known:
                    elsewhere.add((alias.asname or alias.name).split(".")[0])
        elif isinstance(node, ast.ImportFrom):
            if node.module not in known:
                elsewhere |= {alias.asname or alias.name for alias in node.names}
            else:
                found |= {alias.name for alias in node.names if is_private(alias.name)}
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            own.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            own.add(node.id)
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            if ast.unparse(node.value) == "self":
                own.add(node.attr)
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and is_private(node.attr):
            root = ast.unparse(node.value).split(".")[0]
            if root not in {"self", "cls"} | elsewhere and node.attr not in own:
                found.add(node.attr)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            module, _, name = node.value.rpartition(".")
            if module in known and is_private(name) and name.isidentifier():
                found.add(name)
    return found


# --------------------------------------------------------------------------------------------------
# The checkers find what is planted
# --------------------------------------------------------------------------------------------------


def test_imports_are_found():
    known = {"rbs", "rbs.low", "rbs.middle"}
    assert imports("from rbs.low import f\nfrom rbs import middle", known) == {
        "rbs.low",
        "rbs.middle",
    }
    assert imports("def late():\n    import rbs.low", known) == {"rbs.low"}
    for source in (
        "import polyscope as ps",
        "def f():\n    import polyscope.imgui as psim",
        "from polyscope import imgui",
        "if True:\n    from polyscope.core import x",
    ):
        assert imports(source, {"rbs"}) == {"polyscope"}
    assert imports('"import polyscope"', {"rbs"}) == set()


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("from rbs.low import _y", {"_y"}),
        ("from rbs.low import _y as y", {"_y"}),
        ("def f():\n    from rbs.low import _y", {"_y"}),
        ("import rbs.low\nrbs.low._y(1)", {"_y"}),
        ("import rbs.low as low\nx = low._y", {"_y"}),
        ("from rbs import low\nlow.z._y = 1", {"_y"}),
        ("from rbs.low import Y\nY._z(1)", {"_z"}),
        ("from rbs.low import y\ndef f(x):\n    return x[0]._z", {"_z"}),
        ("patch('rbs.low._y', 1)", {"_y"}),
        ("from rbs.low import y\ny.__name__", set()),
        ("from rbs.low import y\nself._y = y(_z)", set()),
        ("class A:\n    def f(self, other):\n        self._x = other._x", set()),
        ("def _f(x):\n    return x._replace(y=1)\nPLACES = [A._f]", set()),
        ("import numpy as np\nnp._core", set()),
        ("import threading\nfrom rbs import __version__", set()),
    ],
)
def test_planted_private_names_are_found(source, expected):
    assert foreign_privates(source, {"rbs", "rbs.low"}) == expected


# --------------------------------------------------------------------------------------------------
# The house
# --------------------------------------------------------------------------------------------------


def test_rooms_import_nothing_that_uses_them():
    known = rooms()
    scripts = [path for user in USERS for path in ROOT.glob(f"{user}/**/*.py")]
    users = {path.stem for path in scripts} | USERS
    assert len(users) > 20
    for name, path in known.items():
        used = imports(path.read_text("utf-8"), known)
        assert not used & (users - set(known)), name
        allowed = set(known) | set(sys.stdlib_module_names)
        allowed |= {"numpy", "scipy", "tqdm", "polyscope", "matplotlib", "imageio_ffmpeg"}
        own = {
            "rbs.scenes.meshfiles": {"trimesh"},
            "rbs.recordings.recording": {"h5py"},
            "rbs.appearance.pixels": {"PIL"},
            "rbs.pictures.capture": {"PIL"},
            "rbs.program.results": {"PIL"},
            "rbs.exports.gltf": {"pygltflib"},
            "rbs.exports.page": {"k3d"},
        }
        allowed |= own.get(name, set())
        assert used <= allowed, name


def test_polyscope_is_imported_by_what_draws_only():
    known = rooms()
    found = {n for n, path in known.items() if "polyscope" in imports(path.read_text(), known)}
    assert len(found) > 5 and {name.split(".")[1] for name in found} == {"pictures", "window"}


def test_nobody_uses_private_names_of_others():
    known = rooms()
    users = [path for user in (*USERS, "data") for path in ROOT.glob(f"{user}/**/*.py")]
    used = {
        path.name: foreign_privates(path.read_text("utf-8"), known)
        for path in (*known.values(), *users)
        if path.name != "test_house.py"
    }
    assert {name: names for name, names in used.items() if names} == {}


def test_the_coursework_loads_few_files():
    """What the steps of many bodies need is imported when a step is handed over to them."""
    program = "import sys, RBSFunctions; print(*sys.modules)"
    command = [sys.executable, "-c", program]
    loaded = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    own = {name for name in set(loaded.split()) & set(rooms()) if name.count(".") != 1}
    assert {"RBSFunctions", "rbs.stepping.bodies"} <= own and len(own - {"rbs"}) <= 12, sorted(own)


def test_every_room_says_what_it_is_for_and_is_not_too_long():
    for name, path in rooms().items():
        source = path.read_text("utf-8")
        assert len(ast.get_docstring(ast.parse(source)) or "") > 40, name
        if name.startswith("rbs") or name == "RigidBodySimulation":
            assert source.count("\n") <= MOST_LINES, name


def listed(name, known):
    """The names in the list of a package's docstring, in its order."""
    text = ast.get_docstring(ast.parse(known[name].read_text("utf-8")))
    return re.findall(r"^ {4}([a-z]+)  ", text, re.MULTILINE)


def test_packages_are_of_a_size_that_can_be_read():
    for package in PACKAGES:
        modules = [path for path in ROOT.glob(f"rbs/{package}/*.py") if path.stem != "__init__"]
        assert 3 <= len(modules) <= 9, package
        lines = sum(path.read_text("utf-8").count("\n") for path in modules)
        assert lines <= MOST_LINES_OF_A_PACKAGE, package


def test_rooms_import_only_what_the_introductions_list_above_them():
    """A package those above it, a module those above it in its package, both as they are listed."""
    known = rooms()
    assert tuple(listed("rbs", known)) == PACKAGES
    order = ["Quaternion", "rbs"]
    for package in PACKAGES:
        order += [f"rbs.{package}.{name}" for name in listed(f"rbs.{package}", known)]
        order += [f"rbs.{package}", *(top for top, last in ABOVE.items() if last == package)]
    assert sorted(order) == sorted(known)
    for name, path in known.items():
        used = imports(path.read_text("utf-8"), known) & set(known)
        assert used <= set(order[: order.index(name)]), name


def test_faults_that_the_tests_must_notice_can_be_put_in():
    for fault in FAULTS:
        source = (ROOT / fault.file).read_text(encoding="utf-8")
        assert source.count(fault.text) == 1, fault.what
        for name in fault.tests.split():
            assert len(list(ROOT.glob(f"tests/*/test_{name}.py"))) == 1, fault.what
