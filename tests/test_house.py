"""Which module imports which, found in the source of `rbs/` and of the four modules at the top.

Every import counts, also one inside a function. That no module uses private names of another is a
rule of ruff's (pyproject.toml).
"""

import ast
import re
import subprocess
import sys

from mutations import FAULTS
from oracles import ROOT

TOP = ("RBSFunctions", "RigidBodySimulation", "Quaternion", "GJK")
# The packages of rbs/, each of which imports only those before it.
PACKAGES = (
    *("geometry", "stepping", "softstep", "glass", "scenes"),
    *("appearance", "recordings", "pictures", "window", "program"),
)
# The last package that a module at the top may import; Quaternion imports none.
ABOVE = {"GJK": "geometry", "RBSFunctions": "glass", "RigidBodySimulation": "program"}
# Packages of others that every module may import, and one of them.
EVERYWHERE = ("numpy", "scipy", "tqdm", "imageio_ffmpeg")
IN_ONE = {"rbs.scenes.meshfiles": "trimesh", "rbs.recordings.recording": "h5py"}
IN_ONE["rbs.program.stubs"] = "setuptools"
IN_ONE |= dict.fromkeys(
    ("rbs.appearance.pixels", "rbs.pictures.capture", "rbs.program.results"), "PIL"
)


def modules():
    """The sources of all modules: dict of name and path."""
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


def test_modules_import_each_other_and_few_packages():
    known = modules()
    for name, path in known.items():
        allowed = {*known, *sys.stdlib_module_names, *EVERYWHERE, IN_ONE.get(name)}
        if name.startswith(("rbs.pictures.", "rbs.window.")):
            allowed.add("polyscope")
        assert imports(path.read_text("utf-8"), known) <= allowed, name


def test_the_coursework_loads_few_files():
    """Modules that only the steps on arrays need are imported when such a step is made."""
    program = "import sys, RBSFunctions; print(*sys.modules)"
    command = [sys.executable, "-c", program]
    loaded = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    loaded = set(loaded.split())
    own = loaded & {*modules(), "rbs", *(f"rbs.{package}" for package in PACKAGES)}
    assert {"RBSFunctions", "rbs.stepping.meshes"} <= own and len(own) <= 12, sorted(own)
    assert "scipy" not in loaded  # takes several times as long as all of these


def listed(name, known):
    """The names in the list of a package's docstring, in its order."""
    text = ast.get_docstring(ast.parse(known[name].read_text("utf-8")))
    return re.findall(r"^ {4}([a-z]+)  ", text, re.MULTILINE)


def test_every_package_is_installed():
    configuration = (ROOT / "pyproject.toml").read_text("utf-8")
    assert [name for name in PACKAGES if f'"rbs.{name}"' not in configuration] == []


def test_modules_import_only_what_the_introductions_list_above_them():
    """A package may import those listed above it, a module those above it in its package."""
    known = modules()
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
