"""Which module imports which, found in the source of `rbs/` and of the four modules at the top.

Every import counts, also one inside a function. That no module uses private names of another is a
rule of ruff's (pyproject.toml).
"""

import ast
import re
import subprocess
import sys
from pathlib import Path

from mutations import FAULTS, ROW, TABLE, path_of
from oracles import ROOT

TOP = ("RBSFunctions", "RigidBodySimulation", "Quaternion", "GJK")
# The packages of rbs/, each of which imports only those before it.
PACKAGES = "geometry stepping softstep glass scenes appearance recordings pictures window program"
PACKAGES = PACKAGES.split()
# The last package that a module at the top may import; Quaternion imports none.
ABOVE = {"GJK": "geometry", "RBSFunctions": "glass", "RigidBodySimulation": "program"}
# Packages of others that every module may import, and that one or two may.
EVERYWHERE = ("numpy", "scipy", "tqdm", "imageio_ffmpeg")
IN_ONE = {"rbs.appearance.pixels": "PIL", "rbs.pictures.capture": "PIL"}
IN_ONE["rbs.recordings.recording"] = "h5py"
IN_ONE |= {"rbs.program.results": "PIL", "rbs.program.stubs": "setuptools"}
# The sources of all modules, by name.
SOURCES = {name: (ROOT / f"{name}.py").read_text("utf-8") for name in TOP}
for path in sorted(ROOT.glob("rbs/**/*.py")):
    parts = path.relative_to(ROOT).with_suffix("").parts
    SOURCES[".".join(parts).removesuffix(".__init__")] = path.read_text("utf-8")


def imports(name):
    """What a module imports: a set of our modules, or top-level names of others.

    `from rbs import drawing` imports `rbs.drawing` if that is a module.
    """
    found = set()
    for node in ast.walk(ast.parse(SOURCES[name])):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            inner = [f"{node.module}.{alias.name}" for alias in node.names]
            found |= {one if one in SOURCES else node.module for one in inner}
    return {one if one in SOURCES else one.split(".")[0] for one in found}


def test_modules_import_each_other_and_few_packages():
    for name in SOURCES:
        allowed = {*SOURCES, *sys.stdlib_module_names, *EVERYWHERE, IN_ONE.get(name)}
        if name.startswith(("rbs.pictures.", "rbs.window.")):
            allowed.add("polyscope")
        assert imports(name) <= allowed, name


def test_the_coursework_loads_few_files():
    """Modules that only the steps on arrays need are imported when such a step is made."""
    command = [sys.executable, "-c", "import sys, RBSFunctions; print(*sys.modules)"]
    loaded = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    loaded = set(loaded.split())
    own = loaded & {*SOURCES, "rbs", *(f"rbs.{package}" for package in PACKAGES)}
    assert {"RBSFunctions", "rbs.stepping.meshes"} <= own and len(own) <= 12, sorted(own)
    assert "scipy" not in loaded  # takes several times as long as all of these


def listed(name):
    """The names in the list of a package's docstring, in its order."""
    return re.findall(r"^ {4}([a-z]+)  ", ast.get_docstring(ast.parse(SOURCES[name])), re.MULTILINE)


def test_modules_import_only_what_the_introductions_list_above_them():
    assert listed("rbs") == PACKAGES
    order = ["Quaternion", "rbs"]
    for package in PACKAGES:
        order += [f"rbs.{package}.{name}" for name in listed(f"rbs.{package}")]
        order += [f"rbs.{package}", *(top for top, last in ABOVE.items() if last == package)]
    assert sorted(order) == sorted(SOURCES)
    for name in SOURCES:
        assert imports(name) & {*SOURCES} <= {*order[: order.index(name)]}, name


def test_a_students_process_can_import_all_that_its_modules_need(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "graders")
    from isolated.processes import supplied

    paths = {Path(path).relative_to("supplied").with_suffix("") for path in supplied()}
    names = {".".join(path.parts).removesuffix(".__init__") for path in paths} & {*SOURCES}
    assert {"GJK", "rbs.scenes.meshfiles"} <= names
    for name in names:
        assert imports(name) & {*SOURCES} <= names, name


def test_faults_that_the_tests_must_notice_can_be_put_in():
    assert not ROW.sub("", TABLE.partition("\n\n")[2]).strip()  # as marks of a merge
    for fault in FAULTS:
        source = (ROOT / fault.file).read_text(encoding="utf-8")
        assert source.count(fault.text) == 1, fault.what
        file, _, test = path_of(fault.test, ROOT).partition("::")
        assert f"\ndef {test}(" in Path(file).read_text(encoding="utf-8"), fault.what
