"""What the program is given and cannot use: each case ends in one line and exit code 2.

The line names the file, the line in it where there is one, and the cause; nothing is written. Each
case is a command line in a folder of small files, of which one is broken or missing. What looks odd
and is legal all the same stands in a table of its own. The fuzzing is in `test_fuzzing.py`.
"""

import io
import json
import os
import pickle
import runpy
import subprocess
import sys
import time
import tracemalloc
import zipfile

import numpy as np
import pytest
from oracles import ROOT
from program import CAMERA, DATA, run
from test_loading import CUBE, SCENE, TETRAHEDRON, replaced
from test_recording import lying_header, rewritten, zip_bomb

from rbs.files import TEXT_BYTES
from rbs.simulation import Simulation
from rbs.textfiles import LONGEST_LINE, SceneError
from RigidBodySimulation import load_constraint_file, load_scene_file, main

FILES = {
    "cube.off": CUBE,
    "t.mesh": TETRAHEDRON,
    "a-scene.txt": SCENE,
    "a-constraints.txt": "1\n0 1 1 2 0.5 1.25\n",
    "camera.json": json.dumps(CAMERA),
}


def as_bytes(content):
    return content if isinstance(content, bytes) else content.encode()


def appended(text):
    return lambda content: content + text


def without(line):
    """A function that takes out a line."""
    return replaced(line + "\n", "")


def always(content):
    return lambda _: content


def without_vertex_5_tet_2(text):
    """The lower half of the tetrahedron only, but the surface of both."""
    return replaced("Tetrahedra\n2", "Tetrahedra\n1")(without("5 2 3 4 1")(text))


# A second copy of the first tetrahedron.
TET_TWICE = replaced("Tetrahedra\n2\n", "Tetrahedra\n3\n1 2 3 5 1\n")
# A tetrahedron of four corners of a square.
WITH_FLAT_TET = """\
MeshVersionFormatted 1
Dimension 3
Vertices
5
0 0 0 1
1 0 0 1
0 2 0 1
0 0 3 1
1 2 0 1
Triangles
4
1 3 2 1
1 2 4 1
1 4 3 1
2 3 4 1
Tetrahedra
2
1 2 3 4 1
1 2 3 5 1
End
"""


def scene_of(row, count=1):
    return f"{count}\n{row}\n"


ROW = "cube.off 1 0 0 5 0 1 0 0 0"

# --------------------------------------------------------------------------------------------------
# Text files: {case: (file, change of its text, message after the file's name)}
# --------------------------------------------------------------------------------------------------

TEXT = {
    # any text
    "empty scene": ("a-scene.txt", always(""), ": the file is empty"),
    "empty mesh": ("t.mesh", always(""), ": the file is empty"),
    "empty surface": ("cube.off", always(""), ": the file is empty"),
    "empty constraints": ("a-constraints.txt", always(""), ": the file is empty"),
    "only a mark": ("a-scene.txt", always("\ufeff"), ": the file is empty"),
    "only comments": ("a-scene.txt", always("# 1\n#\n"), ": the file is empty"),
    "binary scene": ("a-scene.txt", always(b"\x7fELF\2\1\1\0"), ": this is not a text file"),
    "binary mesh": ("t.mesh", always(bytes(range(256)) * 20), ": this is not a text file"),
    "binary constraints": ("a-constraints.txt", always(b"1\n\0"), ": this is not a text file"),
    "UTF-16": ("a-scene.txt", always(SCENE.encode("utf-16")), ": this is not a text file"),
    "Latin-1": ("t.mesh", always("# Würfel\n".encode("latin-1")), ": this is not a text file"),
    "endless line": ("a-scene.txt", always("1 " * LONGEST_LINE),
                     f":1: a line must not be longer than {LONGEST_LINE} characters"),
    "orders to the terminal": ("a-scene.txt", replaced("50.0", "\x1b]0;x\x07"),
                               ":2: the density must be a number, not ' ]0;x '"),
    "endless word": ("a-scene.txt", replaced("50.0", "9" * 500 + "x"),
                     f":2: the density must be a number, not '{'9' * 37}...'"),
    # .mesh
    "mesh: another format": ("t.mesh", always("solid t\nfacet normal 0 0 1\n"),
                             ":1: a .mesh file starts with MeshVersionFormatted"),
    "mesh: OFF inside": ("t.mesh", always(CUBE), ":1: a .mesh file starts with MeshVersionF"),
    "mesh: two dimensions": ("t.mesh", replaced("Dimension 3", "Dimension 2"),
                             ":2: the dimension must be 3, not 2"),
    "mesh: dimension cut off": ("t.mesh", always("MeshVersionFormatted 1\nDimension\n"),
                                ":2: the file ends before the dimension"),
    "mesh: no vertices": ("t.mesh", always("MeshVersionFormatted 1\nDimension 3\nEnd\n"),
                          ": there are no Vertices"),
    "mesh: zero vertices": ("t.mesh", always("MeshVersionFormatted 1\nVertices 0\n"),
                            ": there are no Vertices"),
    "mesh: no triangles": ("t.mesh", lambda t: t[:t.index("Tri")] + t[t.index("Tet"):],
                           ": there are no Triangles"),
    "mesh: no tetrahedra": ("t.mesh", lambda t: t[:t.index("Tet")], ": there are no Tetrahedra"),
    "mesh: count cut off": ("t.mesh", lambda t: t[:t.index("2\n1 2 3 5")],
                            ":18: the file ends before the number of Tetrahedra"),
    "mesh: a vertex fewer": ("t.mesh", without("0 2 0 1"),
                             ":9: row Vertices 5 of 5 takes 4 columns, not 1: 'Triangles'"),
    "mesh: a vertex more": ("t.mesh", replaced("0 2 0 1", "0 2 0 1\n0 2 0 1"),
                            ":10: expected the name of a section, not '0 0 1.5 1'"),
    "mesh: a triangle fewer": ("t.mesh", without("5 4 3 1"),
                               ":17: row Triangles 6 of 6 takes 4 columns, not 1: 'Tetrahedra'"),
    "mesh: a tetrahedron fewer": ("t.mesh", without("5 2 3 4 1"),
                                  ":21: row Tetrahedra 2 of 2 takes 5 columns, not 1: 'End'"),
    "mesh: 10^9 tetrahedra": ("t.mesh", replaced("Tetrahedra\n2", "Tetrahedra\n1000000000"),
                              ":22: row Tetrahedra 3 of 1000000000 takes 5 columns, not 1: 'End'"),
    "mesh: count of 5000 digits": ("t.mesh", replaced("Vertices\n5", "Vertices\n" + "5" * 5000),
                                   ":4: the number of Vertices must be a whole number, not '555"),
    "mesh: count of 500 digits": ("t.mesh", replaced("Vertices\n5", "Vertices\n-" + "5" * 500),
                                  ":4: the number of Vertices must be at least 0, not -555"),
    "mesh: count with a fraction": ("t.mesh", replaced("Vertices\n5", "Vertices\n5.0"),
                                    ":4: the number of Vertices must be a whole number, not '5.0'"),
    "mesh: a column fewer": ("t.mesh", replaced("0 2 0 1", "0 2 0"),
                             ":7: row Vertices 3 of 5 takes 4 columns, not 3: '0 2 0'"),
    "mesh: reference is text": ("t.mesh", replaced("0 2 0 1", "0 2 0 wall"),
                                ":7: the reference number must be a number, not 'wall'"),
    "mesh: decimal comma": ("t.mesh", replaced("0 0 1.5 1", "0 0 1,5 1"),
                            ":9: a coordinate must be a number, not '1,5'"),
    "mesh: underscore": ("t.mesh", replaced("0 0 3 1", "0 0 3_0 1"),
                         ":8: a coordinate must be a number, not '3_0'"),
    "mesh: other digits": ("t.mesh", replaced("0 0 3 1", "0 0 ٣ 1"),
                           ":8: a coordinate must be a number, not '٣'"),
    "mesh: Fortran's exponent": ("t.mesh", replaced("0 0 3 1", "0 0 3.0D0 1"),
                                 ":8: a coordinate must be a number, not '3.0D0'"),
    "mesh: hexadecimal": ("t.mesh", replaced("0 0 3 1", "0 0 0x3 1"),
                          ":8: a coordinate must be a number, not '0x3'"),
    "mesh: NaN": ("t.mesh", replaced("0 2 0 1", "0 NaN 0 1"),
                  ":7: a coordinate must be finite, not 'NaN'"),
    "mesh: infinity": ("t.mesh", replaced("0 2 0 1", "0 -Infinity 0 1"),
                       ":7: a coordinate must be finite, not '-Infinity'"),
    "mesh: too far": ("t.mesh", replaced("0 2 0 1", "0 2e10 0 1"),
                      ":7: a coordinate must not exceed 1e+09, as '2e10' does"),
    "mesh: counted from zero": ("t.mesh", replaced("1 3 2 1", "0 2 1 1"),
                                ":12: a vertex index must be between 1 and 5, not 0"),
    "mesh: index too large": ("t.mesh", replaced("1 2 3 5 1", "1 2 3 9 1"),
                              ":20: a vertex index must be between 1 and 5, not 9"),
    "mesh: index negative": ("t.mesh", replaced("1 3 2 1", "-1 3 2 1"),
                             ":12: a vertex index must be between 1 and 5, not -1"),
    "mesh: corner twice": ("t.mesh", replaced("1 2 3 5 1", "1 2 3 3 1"),
                           ":20: a vertex is used twice: '1 2 3 3'"),
    "mesh: flat tetrahedron": ("t.mesh", always(WITH_FLAT_TET), ":19: the tetrahedron is flat"),
    "mesh: all flat": ("t.mesh", lambda t: t.replace("0 0 3 1", "3 3 0 1")
                       .replace("0 0 1.5 1", "2 0 0 1"), ": the mesh has no volume"),
    "mesh: a point": ("t.mesh", lambda t: t.replace("1 0 0 1", "0 0 0 1").replace("0 2 0 1",
                      "0 0 0 1").replace("0 0 3 1", "0 0 0 1").replace("1.5", "0"),
                      ": the mesh has no volume"),
    "mesh: not closed": ("t.mesh", lambda t: without("1 3 2 1")(t).replace("s\n6", "s\n5"),
                         ":12: the surface is not closed: the edge between the vertices 1 and 2 "
                         "belongs to 1 triangle, not to 2"),
    "mesh: triangle twice": ("t.mesh", lambda t: replaced("1 3 2 1\n", "1 3 2 1\n2 1 3 1\n")(t)
                             .replace("s\n6", "s\n7"),
                             ":13: triangle 2 is the same as triangle 1"),
    "mesh: inner triangle": ("t.mesh", lambda t: replaced("1 3 2 1\n", "1 3 2 1\n2 3 5 1\n")(t)
                             .replace("s\n6", "s\n7"),
                             ":12: the surface is not closed: the edge between the vertices 2 and "
                             "3 belongs to 3 triangles, not to 2"),
    "mesh: triangle of nothing": ("t.mesh", replaced("1 3 2 1", "1 3 4 1"),
                                  ":12: triangle 1 is not a face of any tetrahedron"),
    "mesh: not filled": ("t.mesh", without_vertex_5_tet_2,
                         ":14: triangle 3 is not a face of any tetrahedron"),
    "mesh: tetrahedron twice": ("t.mesh", TET_TWICE,
                                ": the triangles enclose a volume of 1, the tetrahedra have 1.5"),
    "mesh: section twice": ("t.mesh", replaced("Tetrahedra", "Vertices"),
                            ":18: there is a second section Vertices"),
    "mesh: too small": ("t.mesh", lambda t: t.replace("1 0 0 1", "1e-80 0 0 1").replace(
                        "0 2 0 1", "0 2e-80 0 1").replace("0 0 3 1", "0 0 3e-80 1").replace(
                        "0 0 1.5 1", "0 0 1.5e-80 1"), None),
    # .off
    "off: another format": ("cube.off", always("ply\nformat ascii 1.0\n"),
                            ":1: an .off file starts with OFF"),
    "off: with colours": ("cube.off", replaced("OFF", "COFF"), ":1: an .off file starts with OFF"),
    "off: counts missing": ("cube.off", always("OFF\n"), ":1: the file ends before the counts"),
    "off: four counts": ("cube.off", replaced("8 6 12", "8 6 12 0"),
                         ":2: expected the numbers of vertices and faces: '8 6 12 0'"),
    "off: counts are text": ("cube.off", replaced("8 6 12", "eight 6 12"),
                             ":2: the number of vertices must be a whole number, not 'eight'"),
    "off: no vertices": ("cube.off", always("OFF\n0 0 0\n"),
                         ":2: the number of vertices must be at least 4, not 0"),
    "off: three faces": ("cube.off", replaced("8 6 12", "8 3 12"),
                         ":2: the number of faces must be at least 4, not 3"),
    "off: 10^9 vertices": ("cube.off", replaced("8 6 12", "1000000000 6 12"),
                           ":11: vertex 9 of 1000000000 takes 3 columns, not 5: '4 3 2 1 0'"),
    "off: 10^9 faces": ("cube.off", replaced("8 6 12", "8 1000000000 12"),
                        ":16: the file ends before face 7 of 1000000000"),
    "off: a vertex fewer": ("cube.off", without("1 1 0"),
                            ":10: vertex 8 of 8 takes 3 columns, not 5: '4 3 2 1 0'"),
    "off: a vertex more": ("cube.off", replaced("8 6 12", "7 6 12"),
                           ":10: the number of a face's corners must be at least 3, not 0"),
    "off: two columns": ("cube.off", replaced("1 1 0", "1 1"),
                         ":5: vertex 3 of 8 takes 3 columns, not 2: '1 1'"),
    "off: NaN": ("cube.off", replaced("1 1 0", "1 nan 0"),
                 ":5: a coordinate must be finite, not 'nan'"),
    "off: text": ("cube.off", replaced("1 1 0", "1 one 0"),
                  ":5: a coordinate must be a number, not 'one'"),
    "off: counted from one": ("cube.off", replaced("4 4 5 6 7", "4 5 6 7 8"),
                              ":12: a vertex index must be between 0 and 7, not 8"),
    "off: negative index": ("cube.off", replaced("4 4 5 6 7", "4 4 5 6 -1"),
                            ":12: a vertex index must be between 0 and 7, not -1"),
    "off: 10^9 corners": ("cube.off", replaced("4 4 5 6 7", "1000000000 4 5 6 7"),
                          ":12: a face of 1000000000 corners has only 4"),
    "off: corner twice": ("cube.off", replaced("4 4 5 6 7", "4 4 5 6 6"),
                          ":12: a vertex is used twice: '4 5 6 6'"),
    "off: not closed": ("cube.off", lambda t: without("4 3 0 4 7")(t).replace("8 6", "8 5"),
                        ": the surface is not closed: the edge between the vertices 0 and 3 "
                        "belongs to 1 triangle, not to 2"),
    "off: face twice": ("cube.off", lambda t: t.replace("8 6", "8 7") + "4 3 0 4 7\n",
                        ": the surface is not closed: the edge between the vertices 0 and 3 "
                        "belongs to 3 triangles, not to 2"),
    "off: a line": ("cube.off", lambda t: t.replace(" 1\n", " 0\n").replace("1 1 0\n", "1 0 0\n")
                    .replace("0 1 0\n", "0 0 0\n"), ": the mesh has no volume"),
    # scenes
    "scene: count is text": ("a-scene.txt", replaced("3\n", "three\n"),
                             ":1: this is not a scene: the number of bodies must be a whole num"),
    "scene: count missing": ("a-scene.txt", without("3"),
                             ":1: this is not a scene: the number of bodies takes 1 column, not"),
    "scene: no body": ("a-scene.txt", always("0\n"),
                       ":1: this is not a scene: the number of bodies must be at least 1, not 0"),
    "scene: 10^9 bodies": ("a-scene.txt", replaced("3\n", "1000000000\n"),
                           ":4: the file ends before body 4 of 1000000000"),
    "scene: a body fewer": ("a-scene.txt", replaced("3\n", "4\n"),
                            ":4: the file ends before body 4 of 4"),
    "scene: a body more": ("a-scene.txt", replaced("3\n", "1\n"),
                           ":3: more lines than the 1 bodies announced: 'cube.off 100 1"),
    "scene: a column fewer": ("a-scene.txt", replaced("50.0", ""),
                              ":2: body 1 of 3 takes 10 columns, not 9: 'cube.off 0 0 10 0 2"),
    "scene: a column more": ("a-scene.txt", replaced("50.0", "50.0 1"),
                             ":2: body 1 of 3 takes 10 columns, not 11: 'cube.off 50.0 1 0"),
    "scene: density is text": ("a-scene.txt", replaced("50.0", "heavy"),
                               ":2: the density must be a number, not 'heavy'"),
    "scene: density zero": ("a-scene.txt", replaced("50.0", "0.0"),
                            ":2: the density must be positive, not 0.0"),
    "scene: density negative": ("a-scene.txt", replaced("50.0", "-50"),
                                ":2: the density must be positive, not -50"),
    "scene: density NaN": ("a-scene.txt", replaced("50.0", "nan"),
                           ":2: the density must be finite, not 'nan'"),
    "scene: density 10^308": ("a-scene.txt", replaced("50.0", "1e308"),
                              ":2: the density must not exceed 1e+30, as '1e308' does"),
    "scene: density 10^-320": ("a-scene.txt", replaced("50.0", "1e-320"),
                               ":2: this cannot be a body: its mass, 9.99989e-321, is beyond"),
    "scene: isFixed 2": ("a-scene.txt", replaced("50.0  0", "50.0  2"),
                         ":2: isFixed must be between 0 and 1, not 2"),
    "scene: isFixed true": ("a-scene.txt", replaced("50.0  0", "50.0  true"),
                            ":2: isFixed must be a whole number, not 'true'"),
    "scene: position NaN": ("a-scene.txt", replaced("10.5", "nan"),
                            ":3: a coordinate must be finite, not 'nan'"),
    "scene: position infinite": ("a-scene.txt", replaced("10.5", "1e400"),
                                 ":3: a coordinate must be finite, not '1e400'"),
    "scene: position too far": ("a-scene.txt", replaced("10.5", "-1e300"),
                                ":3: a coordinate must not exceed 1e+09, as '-1e300' does"),
    "scene: position is text": ("a-scene.txt", replaced("10.5", "up"),
                                ":3: a coordinate must be a number, not 'up'"),
    "scene: quaternion zero": ("a-scene.txt", replaced("2 0 0 0", "0 0 -0 0.0"),
                               ":2: the quaternion must not be zero"),
    "scene: quaternion NaN": ("a-scene.txt", replaced("2 0 0 0", "2 0 nan 0"),
                              ":2: the quaternion must be finite, not 'nan'"),
    "scene: quaternion is text": ("a-scene.txt", replaced("2 0 0 0", "2 0 i 0"),
                                  ":2: the quaternion must be a number, not 'i'"),
    "scene: no such mesh": ("a-scene.txt", replaced("t.mesh", "u.mesh"),
                            ":4: there is no mesh file 'u.mesh' beside the scene"),
    "scene: mesh of no name": ("a-scene.txt", replaced("t.mesh", "." + "x" * 300 + ".mesh"),
                               f":4: there is no mesh file '.{'x' * 36}...' beside the scene"),
    "scene: mesh is a folder": ("a-scene.txt", replaced("t.mesh", "folder.mesh"), None),
    "scene: mesh is the scene": ("a-scene.txt", replaced("t.mesh", "a-scene.txt"), None),
    "scene: mesh by ..": ("a-scene.txt", replaced("t.mesh", "../t.mesh"),
                          ":4: the mesh file '../t.mesh' lies outside of the scene's folder; "
                          "--allow-outside-meshes reads it"),
    "scene: mesh by an absolute path": ("a-scene.txt", replaced("t.mesh", "/etc/passwd"),
                                        ":4: the mesh file '/etc/passwd' lies outside of the "),
    # constraints
    "constraints: count is text": ("a-constraints.txt", replaced("1\n", "one\n"),
                                   ":1: the number of constraints must be a whole number, not "
                                   "'one'"),
    "constraints: 10^9": ("a-constraints.txt", replaced("1\n", "1000000000\n"),
                          ":2: the file ends before constraint 2 of 1000000000"),
    "constraints: none but one": ("a-constraints.txt", replaced("1\n", "0\n"),
                                  ":2: more lines than the 0 constraints announced: '0 1 1 2"),
    "constraints: five columns": ("a-constraints.txt", replaced(" 1.25", ""),
                                  ":2: constraint 1 of 1 takes 6 columns, not 5: '0 1 1 2 0.5'"),
    "constraints: seven columns": ("a-constraints.txt", replaced("1.25", "1.25 0"),
                                   ":2: constraint 1 of 1 takes 6 columns, not 7: '0 1 1 2 0.5"),
    "constraints: mesh": ("a-constraints.txt", replaced("0 1 1 2", "3 1 1 2"),
                          ":2: a mesh index must be between 0 and 2, not 3"),
    "constraints: mesh -1": ("a-constraints.txt", replaced("0 1 1 2", "-1 1 1 2"),
                             ":2: a mesh index must be between 0 and 2, not -1"),
    "constraints: vertex": ("a-constraints.txt", replaced("0 1 1 2", "0 1 2 5"),
                            ":2: a vertex index must be between 0 and 4, not 5"),
    "constraints: index 0.5": ("a-constraints.txt", replaced("0 1 1 2", "0.5 1 1 2"),
                               ":2: a mesh index must be a whole number, not '0.5'"),
    "constraints: lower above upper": ("a-constraints.txt", replaced("0.5 1.25", "1.5 1.25"),
                                       ":2: the bounds must be 0 ≤ lower ≤ upper, not 1.5 and"),
    "constraints: negative": ("a-constraints.txt", replaced("0.5 1.25", "-0.5 1.25"),
                              ":2: the bounds must be 0 ≤ lower ≤ upper, not -0.5 and 1.25"),
    "constraints: infinite": ("a-constraints.txt", replaced("0.5 1.25", "0.5 inf"),
                              ":2: a bound must be finite, not 'inf'"),
    "constraints: NaN": ("a-constraints.txt", replaced("0.5 1.25", "nan nan"),
                         ":2: a bound must be finite, not 'nan'"),
    "constraints: 10^308": ("a-constraints.txt", replaced("0.5 1.25", "0.5 1e308"),
                            ":2: the upper bound 1e308 is beyond reckoning"),
}  # fmt: skip
# Where the message names another file, or takes more than a prefix to tell.
WHOLE_MESSAGES = {
    "mesh: too small": "a-scene.txt:4: this cannot be a body: ",
    "scene: mesh is a folder": "folder.mesh: this is a folder, not a file",
    "scene: mesh is the scene": "a-scene.txt: the name of a mesh file must end in .mesh or .off",
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with FILES in it."""
    for name, content in FILES.items():
        (tmp_path / name).write_bytes(as_bytes(content))
    (tmp_path / "folder.mesh").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def snapshot(folder):
    """Names and contents of all files below a folder."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*") if not path.is_fifo()
    }  # fmt: skip


def outcome(arguments, capsys):
    """(exit code, output, errors) of the program, run in this process."""
    try:
        code = main([str(argument) for argument in arguments])
    except SystemExit as ended:  # argparse does not return
        code = ended.code
    return code, *capsys.readouterr()


def assert_refused(folder, arguments, message, capsys):
    """One line that goes on like the message after the program's name, exit code 2, no file."""
    before = snapshot(folder)
    code, output, errors = outcome(arguments, capsys)
    assert (code, output) == (2, ""), errors
    (line,) = errors.splitlines()
    assert line.startswith(f"RigidBodySimulation.py: {message}"), line
    assert line.isprintable() and len(line) < 400
    assert snapshot(folder) == before


RECORDED = ["--steps", "1", "--record", "r.npz", "--stats", "s.csv"]


@pytest.mark.parametrize("case", TEXT)
def test_text_file_that_cannot_be_used(folder, capsys, case):
    name, change, message = TEXT[case]
    (folder / name).write_bytes(as_bytes(change(FILES[name])))
    message = WHOLE_MESSAGES.get(case) or name + message
    assert_refused(folder, ["a-scene.txt", *RECORDED], message, capsys)
    # The loaders say so too, and nothing else comes out of them.
    with pytest.raises(SceneError) as raised:
        meshes = load_scene_file("a-scene.txt")
        load_constraint_file("a-constraints.txt", meshes)
    assert str(raised.value).startswith(message)


# --------------------------------------------------------------------------------------------------
# What is odd, and legal
# --------------------------------------------------------------------------------------------------

LEGAL_TEXT = {
    "CR-LF": lambda text: text.replace("\n", "\r\n"),
    "CR": lambda text: text.replace("\n", "\r"),
    "byte-order mark": lambda text: "\ufeff" + text,
    "tabs": lambda text: text.replace(" ", "\t \t"),
    "blank lines": lambda text: "\n\n" + text.replace("\n", "\n \n"),
    "comments": lambda text: "# so\n" + text.replace("\n", "  # and so\n"),
    "no line end at the end": lambda text: text.rstrip("\n"),
    "form feeds": lambda text: text.replace("\n", " \x0c\n"),
    "UTF-8 in comments": lambda text: "# Würfel, 立方体\n" + text,
}


def arrays_of(meshes):
    return [
        getattr(mesh, name).tolist()
        for mesh in meshes
        for name in ("currVertices", "faces", "tets", "orientation")
    ]


@pytest.mark.parametrize("name", ["a-scene.txt", "t.mesh", "cube.off", "a-constraints.txt"])
@pytest.mark.parametrize("variant", LEGAL_TEXT)
def test_legal_variant_of_a_text_file_loads_alike(folder, name, variant):
    meshes = load_scene_file("a-scene.txt")
    constraints = load_constraint_file("a-constraints.txt", meshes)
    (folder / name).write_bytes(as_bytes(LEGAL_TEXT[variant](FILES[name])))
    again = load_scene_file("a-scene.txt")
    assert arrays_of(again) == arrays_of(meshes)
    assert load_constraint_file("a-constraints.txt", again) == constraints


def with_vertices_twice(text):
    """Each vertex of the tetrahedra once more behind the others; nothing uses them."""
    vertices = text[text.index("5\n") + 2 : text.index("Triangles")]
    return text.replace("5\n" + vertices, "10\n" + vertices + vertices)


LEGAL_MESHES = {
    "tetrahedra turned inside out": ("t.mesh", replaced("1 2 3 5 1", "2 1 3 5 1")),
    "triangles turned inside out": ("t.mesh", replaced("1 3 2 1", "2 3 1 1")),
    "every vertex twice": ("t.mesh", with_vertices_twice),
    "reference numbers of any kind": ("t.mesh", replaced("0 2 0 1", "0 2 0 -1.5")),
    "numbers with a sign": ("t.mesh", replaced("0 2 0 1", "+0 +2.0e+0 -0 1")),
    "faces turned inside out": ("cube.off", replaced("4 4 5 6 7", "4 7 6 5 4")),
    "a face of no area": ("cube.off", lambda text: text.replace("8 6 12", "9 7 12").replace(
        "4 3 2 1 0", "5 3 2 1 8 0\n3 0 8 1", 1).replace("0 1 1\n", "0 1 1\n0.5 0 0\n", 1)),
    "quaternion of huge numbers": ("a-scene.txt", replaced("2 0 0 0", "1e308 1e308 1e308 1e308")),
    "quaternion of tiny numbers": ("a-scene.txt", replaced("2 0 0 0", "5e-324 0 0 0")),
    "mesh in a folder below": ("a-scene.txt", replaced("t.mesh", "folder.mesh/../t.mesh")),
    "bounds of zero": ("a-constraints.txt", replaced("0.5 1.25", "0 0")),
    "a constraint of a body with itself": ("a-constraints.txt", replaced("0 1 1 2", "0 1 0 2")),
}  # fmt: skip


@pytest.mark.parametrize("case", LEGAL_MESHES)
def test_odd_and_legal_file_is_simulated(folder, capsys, case):
    name, change = LEGAL_MESHES[case]
    mass = load_scene_file("a-scene.txt")[2].mass
    (folder / name).write_bytes(as_bytes(change(FILES[name])))
    code, output, errors = outcome(["a-scene.txt", "--headless", "--steps", "3"], capsys)
    assert (code, errors) == (0, "") and "all finite" in output
    assert load_scene_file("a-scene.txt")[2].mass == pytest.approx(mass, rel=1e-12)


# --------------------------------------------------------------------------------------------------
# Files that are missing, or no files
# --------------------------------------------------------------------------------------------------


def make_fifo(path):
    path.unlink(missing_ok=True)
    os.mkfifo(path)


def make_folder(path):
    path.unlink(missing_ok=True)
    path.mkdir()


def make_loop(path):
    path.unlink(missing_ok=True)
    path.symlink_to(path.name)


def make_endless(path):
    path.unlink(missing_ok=True)
    path.symlink_to("/dev/zero")


def make_long(path):
    with open(path, "wb") as file:
        file.truncate(TEXT_BYTES + 1)  # takes no room on the disk


LONG = f"cannot be read (it is longer than {TEXT_BYTES} bytes, the most that is read)"
NO_FILES = {
    "scene, none": ("b-scene.txt", None, "b-scene.txt: there is no such scene, neither a file nor"),
    "scene, a folder": ("a-scene.txt", make_folder, "a-scene.txt: this is a folder, not a file"),
    "scene, a pipe": ("a-scene.txt", make_fifo,
                      "a-scene.txt: cannot be read (this is a pipe or a device, not a file)"),
    "scene, a device": ("a-scene.txt", make_endless, "a-scene.txt: cannot be read (this is a pipe"),
    "scene, a loop": ("a-scene.txt", make_loop, "a-scene.txt: there is no such scene"),
    "scene, too long": ("a-scene.txt", make_long, f"a-scene.txt: {LONG}"),
    "mesh, none": ("t.mesh", os.unlink, "a-scene.txt:4: there is no mesh file 't.mesh' beside"),
    "mesh, a pipe": ("t.mesh", make_fifo, "t.mesh: cannot be read (this is a pipe or a device"),
    "mesh, a folder": ("cube.off", make_folder, "cube.off: this is a folder, not a file"),
    "mesh, too long": ("t.mesh", make_long, f"t.mesh: {LONG}"),
    "mesh, a link to outside": ("t.mesh", make_endless,
                                "a-scene.txt:4: the mesh file 't.mesh' lies outside of the scene"),
    "mesh, a loop": ("t.mesh", make_loop, "a-scene.txt:4: there is no mesh file 't.mesh' beside"),
    "constraints, a folder": ("a-constraints.txt", make_folder,
                              "a-constraints.txt: this is a folder, not a file"),
    "constraints, a pipe": ("a-constraints.txt", make_fifo,
                            "a-constraints.txt: cannot be read (this is a pipe or a device"),
    "constraints, too long": ("a-constraints.txt", make_long, f"a-constraints.txt: {LONG}"),
}  # fmt: skip


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such pipes and links")
@pytest.mark.parametrize("case", NO_FILES)
def test_what_is_no_file_is_not_read(folder, capsys, case):
    name, make, message = NO_FILES[case]
    if make is not None:
        make(folder / name)
    scene = name if name.endswith("-scene.txt") else "a-scene.txt"
    begin = time.monotonic()
    if make is make_long:  # no snapshot of that
        code, output, errors = outcome([scene, "--headless"], capsys)
        assert (code, output) == (2, "") and errors.startswith(f"RigidBodySimulation.py: {message}")
    else:
        assert_refused(folder, [scene, *RECORDED], message, capsys)
    assert time.monotonic() - begin < 10.0


def test_name_that_is_not_for_a_terminal_is_told_in_one_line(folder, capsys):
    (folder / "a\nb-scene.txt").write_text("0\n")
    assert_refused(folder, ["a\nb-scene.txt", "--headless"], "a b-scene.txt:1: this is not", capsys)


# --------------------------------------------------------------------------------------------------
# Meshes outside of the scene's folder
# --------------------------------------------------------------------------------------------------


@pytest.fixture
def outside(folder):
    """A folder `scenes` whose scenes reach for t.mesh, which lies beside it, in three ways."""
    scenes = folder / "scenes"
    scenes.mkdir()
    for name, mesh in {
        "dots": "../t.mesh", "absolute": str(folder / "t.mesh"), "link": "link.mesh",
        "folderLink": "up/t.mesh", "inside": "down/../link2.mesh",
    }.items():  # fmt: skip
        (scenes / f"{name}-scene.txt").write_text(scene_of(f"{mesh} 1 0 0 5 0 1 0 0 0"))
    (scenes / "link.mesh").symlink_to(folder / "t.mesh")
    (scenes / "up").symlink_to(folder)
    (scenes / "down").mkdir()
    (scenes / "own.mesh").write_text(TETRAHEDRON)
    (scenes / "link2.mesh").symlink_to("own.mesh")
    return scenes


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such links")
@pytest.mark.parametrize("name", ["dots", "absolute", "link", "folderLink"])
def test_mesh_outside_of_the_scenes_folder_is_read_only_when_asked_for(outside, capsys, name):
    scene = f"scenes/{name}-scene.txt"
    assert_refused(outside.parent, [scene, *RECORDED], f"{scene}:2: the mesh file '", capsys)
    with pytest.raises(SceneError, match="lies outside of the scene's folder"):
        load_scene_file(scene)
    with pytest.raises(SceneError, match="lies outside"):
        Simulation(scene)
    (mesh,) = load_scene_file(scene, allowOutsideMeshes=True)
    assert len(mesh.tets) == 2
    options = ["--headless", "--steps", "2", "--record", "r.npz", "--allow-outside-meshes"]
    assert outcome([scene, *options], capsys)[0] == 0
    # A recording's scene is no more to be trusted.
    replay = ["--headless", "--replay", "r.npz"]
    assert_refused(outside.parent, replay, f"{scene}:2: the mesh file", capsys)
    assert outcome([*replay, "--allow-outside-meshes"], capsys)[0] == 0
    assert outcome(["--verify", "r.npz", "--allow-outside-meshes"], capsys)[0] == 0


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such links")
def test_mesh_inside_may_be_reached_in_any_way(outside, monkeypatch):
    assert len(load_scene_file("scenes/inside-scene.txt")) == 1
    # So may all of it through a link to the scene's folder.
    (outside.parent / "alias").symlink_to(outside)
    assert len(load_scene_file("alias/inside-scene.txt")) == 1
    monkeypatch.chdir(outside)
    assert len(load_scene_file("inside-scene.txt")) == 1


# --------------------------------------------------------------------------------------------------
# Cameras
# --------------------------------------------------------------------------------------------------


def camera(**changes):
    return json.dumps(CAMERA | changes)


NOT_JSON = "this is not a JSON file"
NO_CAMERA = ": this is not a camera of Polyscope's: it needs viewMat, a rigid motion as 16 numbers"
MATRIX = CAMERA["viewMat"]
CAMERAS = {
    "empty": ("", f":1: {NOT_JSON}: Expecting value"),
    "binary": (b"\x89PNG\r\n\x1a\n\xff", NO_CAMERA),
    "cut off": (camera()[:-5], f":1: {NOT_JSON}: Expecting"),
    "comma missing": ('{"viewMat": [0, 1, 2]\n"fov": 3}', f":2: {NOT_JSON}: Expecting ',' del"),
    "bracket without end": ("[" * 100_000, NO_CAMERA),
    "number of 5000 digits": (camera().replace("20", "2" * 5000), NO_CAMERA),
    "a list": ("[1, 2, 3]", NO_CAMERA),
    "key missing": ('{"fov": 20}', NO_CAMERA),
    "15 numbers": (camera(viewMat=MATRIX[:15]), NO_CAMERA),
    "a word": (camera(viewMat="far"), NO_CAMERA),
    "words": (camera(viewMat=["far"] * 16), NO_CAMERA),
    "null": (camera(fov=None), NO_CAMERA),
    "NaN": (camera(viewMat=[*MATRIX[:15], float("nan")]), NO_CAMERA),
    "infinite": (camera().replace("90", "1e999"), NO_CAMERA),
    "integer of 400 digits": (camera().replace("90", "9" * 400), NO_CAMERA),
    "too far": (camera().replace("90", "9e300"), NO_CAMERA),
    "zeros": (camera(viewMat=[0] * 16), NO_CAMERA),
    "angle": (camera(fov=180), NO_CAMERA),
}


@pytest.mark.parametrize("case", CAMERAS)
def test_camera_that_cannot_be_used(folder, capsys, case):
    content, message = CAMERAS[case]
    (folder / "camera.json").write_bytes(as_bytes(content))
    arguments = ["a-scene.txt", "--camera", "camera.json", *RECORDED]
    assert_refused(folder, arguments, f"camera.json{message}", capsys)


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such pipes")
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (os.unlink, "No such file or directory"),
        (make_folder, "this is a folder, not a file"),
        (make_fifo, "this is a pipe or a device, not a file"),
        (make_long, "it is longer than 1048576 bytes, the most that is read"),
    ],
)
def test_camera_that_is_no_file(folder, capsys, make, message):
    make(folder / "camera.json")
    code, output, errors = outcome(["a-scene.txt", "--headless", "--camera", "camera.json"], capsys)
    assert (code, output) == (2, "")
    assert errors == f"RigidBodySimulation.py: camera.json: {message}\n"


@pytest.mark.parametrize("variant", ["CR-LF", "byte-order mark", "no line end at the end"])
def test_legal_variant_of_a_camera_loads(folder, capsys, variant):
    text = json.dumps(CAMERA, indent=2) + "\n"
    (folder / "camera.json").write_bytes(as_bytes(LEGAL_TEXT[variant](text)))
    arguments = ["a-scene.txt", "--headless", "--steps", "0", "--camera", "camera.json"]
    assert outcome(arguments, capsys)[0] == 0


# --------------------------------------------------------------------------------------------------
# Recordings
# --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """The bytes of a recording of `a-scene.txt`, 61 states, and its arrays."""
    folder = tmp_path_factory.mktemp("recorded")
    for name in ("tower_chain-scene.txt", "tower_chain-constraints.txt"):
        (folder / name).write_bytes((DATA / name).read_bytes())
    path = folder / "r.npz"
    assert main(["tower_chain", "--steps", "60", "--record", str(path)]) == 0
    with np.load(path) as file:
        return path, dict(file)


class Intruder:
    """Pickles to a call: a mark in the current folder, by the shell."""

    def __reduce__(self):
        return os.system, ("touch intruded",)


def runs_code(path, arrays, bad):
    np.savez(bad, **arrays | {"times": np.array([Intruder()] * 61, dtype=object)})


def is_a_pickle(path, arrays, bad):
    bad.write_bytes(pickle.dumps(Intruder()))


def is_an_npy(path, arrays, bad):
    with open(bad, "wb") as file:
        np.save(file, np.array([Intruder()], dtype=object), allow_pickle=True)


def changed(**changes):
    """A recording some of whose arrays are functions of what they were."""

    def make(path, arrays, bad):
        new = {name: value(arrays[name].copy()) for name, value in changes.items()}
        rewritten(path, bad, **new)

    return make


def at(index, value):
    """A function that changes one entry of an array."""

    def change(array):
        array[index] = value
        return array

    return change


def with_long_names(path, arrays, bad):
    """Names of 65 MiB, which the file does have."""
    names = np.zeros(9, dtype=f"U{65 * 2**20 // 36 + 1}")
    rewritten(path, bad, meshNames=names)


def with_absurd_size(path, arrays, bad):
    """The directory at the end says that an array has 4 GB."""
    content = bytearray(path.read_bytes())
    entry = content.index(b"PK\x01\x02")
    content[entry + 20 : entry + 28] = b"\xf0\xff\xff\xff" * 2
    bad.write_bytes(content)


def with_two_entries_for_the_same_bytes(path, arrays, bad):
    """As a bomb of overlapping files has them."""
    array = io.BytesIO()
    np.save(array, np.zeros(1000))
    with zipfile.ZipFile(bad, "w") as archive:
        for k in range(40):
            archive.writestr(f"a{k}.npy", array.getvalue())
        for entry in archive.infolist():
            entry.header_offset = 0


def compressed_lightly(path, arrays, bad):
    np.savez_compressed(bad, **arrays)


def with_header(old, new):
    def make(path, arrays, bad):
        content = path.read_bytes()
        assert old in content and len(new) <= len(old)
        bad.write_bytes(content.replace(old, new.ljust(len(old)), 1))

    return make


RECORDINGS = {
    "none": (lambda path, arrays, bad: None, "there is no such file"),
    "empty": (lambda path, arrays, bad: bad.write_bytes(b""), "this is not a recording (File is"),
    "text": (lambda path, arrays, bad: bad.write_text(SCENE), "this is not a recording (File is"),
    "cut off": (lambda path, arrays, bad: bad.write_bytes(path.read_bytes()[:-300]),
                "this is not a recording (File is not a zip file)"),
    "an empty zip": (lambda path, arrays, bad: zipfile.ZipFile(bad, "w").close(),
                     "this is not a recording (there is no array 'firstStep' in it)"),
    "a folder": (lambda path, arrays, bad: bad.mkdir(), "this is a folder, not a recording"),
    "a pipe": (lambda path, arrays, bad: make_fifo(bad),
               "cannot be read (this is a pipe or a device, not a file)"),
    "a device": (lambda path, arrays, bad: make_endless(bad), "cannot be read (this is a pipe or"),
    "a loop": (lambda path, arrays, bad: make_loop(bad), "there is no such file"),
    "runs code": (runs_code, "the array times.npy is of a kind that no recording holds"),
    "a pickle": (is_a_pickle, "this is not a recording (File is not a zip file)"),
    "an .npy that runs code": (is_an_npy, "this is not a recording (File is not a zip file)"),
    "zip bomb": (lambda path, arrays, bad: bad.write_bytes(zip_bomb()), "its arrays are compresse"),
    "compressed": (compressed_lightly, "its arrays are compressed, those of a recording are not"),
    "announces rows": (lambda path, arrays, bad: bad.write_bytes(lying_header(path)),
                       "the array positions.npy is not as long as it announces"),
    "announces bytes": (with_absurd_size, "it announces 42950"),
    "overlapping": (with_two_entries_for_the_same_bytes, "the array a1.npy is not where the end"),
    "long names": (with_long_names, "the array meshNames is longer than 67108864 bytes"),
    "negative shape": (with_header(b"(61, 9, 3)", b"(61, -9,3)"),
                       "the array positions.npy is of a kind that no recording holds"),
    "shape of code": (with_header(b"(61, 9, 3)", b"exit(1)"), "this is not a recording ("),
    "other order": (with_header(b"'fortran_order': False", b"'fortran_order': True"),
                    "the array positions.npy is of a kind that no recording holds"),
    "strings of no length": (with_header(b"'<f8'", b"'|S0'"),
                             "the array positions.npy is of a kind that no recording holds"),
    "NaN": (changed(positions=at((7, 3, 1), np.nan)),
            "step 7: positions holds numbers that are not finite"),
    "infinity": (changed(linVelocities=at((60, 0, 0), -np.inf)),
                 "step 60: linVelocities holds numbers that are not finite"),
    "time NaN": (changed(times=at(5, np.nan)), "step 5: times holds numbers that are not finite"),
    "zero quaternion": (changed(orientations=at((33, 2), 0.0)),
                        "step 33: orientations holds a quaternion not of length 1"),
    "long quaternion": (changed(orientations=at((33, 2, 0), 1e308)),
                        "step 33: orientations holds a quaternion not of length 1"),
    "too few columns": (changed(positions=lambda a: a[:, :, :2].copy()),
                        "the array positions is of the shape (61, 9, 2) and the type float64, not"),
    "too many bodies": (changed(positions=lambda a: np.repeat(a, 2, axis=1)),
                        "the array positions is of the shape (61, 18, 3)"),
    "text for numbers": (changed(times=lambda a: a.astype(str)),
                         "the array times is of the shape (61,) and the type <U"),
    "negative step": (changed(firstStep=lambda a: a - 5), "the array firstStep is not a whole num"),
    "step with a fraction": (changed(firstStep=lambda a: a + 0.5),
                             "the array firstStep holds the wrong kind of values"),
    "format 99": (changed(format=lambda a: a + 98), "it was written by a newer version of this pr"),
    "negative friction": (changed(settingsHistory=lambda a: np.array('[[0, {"friction": -1}]]')),
                          "step {last}: the friction must be finite and not negative, not -1"),
    "tiny time step": (changed(settingsHistory=lambda a: np.array('[[0, {"timeStep": 5e-324}]]')),
                       "step {last}: the time step must be between 1e-12 and 1000 s, not 4.94"),
    "unknown scheduling": (changed(settingsHistory=lambda a: np.array(
                               '[[0, {"constraintScheduling": "random"}]]')),
                           "step {last}: there is no scheduling 'random'"),
    "a scene that is gone": (changed(scene=lambda a: np.array("gone-scene.txt")),
                             "its file gone-scene.txt is not there any more; say with SCENE where"),
    "a scene of a long name": (changed(scene=lambda a: np.array("x" * 300)), "its file xxxx"),
    "another scene": (changed(scene=lambda a: np.array("a-scene.txt"),
                              constraints=lambda a: np.array("")),
                      "it has 9 bodies, but a-scene.txt has 3"),
}  # fmt: skip


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such pipes and links")
@pytest.mark.parametrize("option", ["--replay", "--resume"])
@pytest.mark.parametrize("case", RECORDINGS)
def test_recording_that_cannot_be_used(folder, recorded, capsys, case, option):
    make, message = RECORDINGS[case]
    make(*recorded, folder / "bad.npz")
    tracemalloc.start()
    try:
        arguments = [option, "bad.npz", "--stats", "s.csv"]
        # What a replay trips over first, and what a resumed run does.
        message = message.format(last=0 if option == "--replay" else 60)
        assert_refused(folder, arguments, f"bad.npz: {message}", capsys)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    # The snapshots of the test itself read the 65 MiB that one of the files does have.
    assert peak < (200 << 20 if case == "long names" else 8 << 20)


# --------------------------------------------------------------------------------------------------
# Options
# --------------------------------------------------------------------------------------------------

OPTIONS = {
    "no such option": (["--gravity", "9"], "unrecognized arguments: --gravity 9"),
    "taken out": (["--pair-order", "coloured"], "unrecognized arguments: --pair-order"),
    "two lines": (["--gra\nvity"], "unrecognized arguments: --gra vity"),
    "two scenes": (["b"], "unrecognized arguments: b"),
    "value missing": (["--steps"], "argument --steps: expected one argument"),
    **{
        f"{option} {value}": ([option, value], f"argument {option}: {message}")
        for option, value, message in [
            ("--restitution", "x", "'x' is not a number"),
            ("--restitution", "", "'' is not a number"),
            ("--restitution", "nan", "the restitution must lie between 0 and 1, not nan"),
            ("--restitution", "-0.1", "the restitution must lie between 0 and 1, not -0.1"),
            ("--restitution", "1.1", "the restitution must lie between 0 and 1, not 1.1"),
            ("--restitution", "0_1", "'0_1' is not a number"),
            ("--time-step", "x", "'x' is not a number"),
            ("--time-step", "nan", "the time step must be positive and finite, not nan"),
            ("--time-step", "inf", "the time step must be positive and finite, not inf"),
            ("--time-step", "0", "the time step must be positive and finite, not 0"),
            ("--time-step", "-1", "the time step must be positive and finite, not -1"),
            ("--time-step", "1e-300", "the time step must be between 1e-12 and 1000 s, not 1e-300"),
            ("--time-step", "1e200", "the time step must be between 1e-12 and 1000 s, not 1e+200"),
            ("--friction", "x", "'x' is not a number"),
            ("--friction", "nan", "the friction must be finite and not negative, not nan"),
            ("--friction", "inf", "the friction must be finite and not negative, not inf"),
            ("--friction", "-1", "the friction must be finite and not negative, not -1"),
            ("--broad-phase", "tree", "invalid choice: 'tree'"),
            ("--scheduling", "sweep2", "invalid choice: 'sweep2'"),
            ("--max-iterations", "x", "'x' is not a whole number"),
            ("--max-iterations", "-1", "must be 0 or more, not -1"),
            ("--max-iterations", "1e3", "'1e3' is not a whole number"),
            ("--max-iterations", "1" * 400, "must be 1000000000000000 or less, not 1111"),
            ("--steps", "x", "'x' is not a whole number"),
            ("--steps", "-1", "must be 0 or more, not -1"),
            ("--steps", "nan", "'nan' is not a whole number"),
            ("--steps", "٣", "'٣' is not a whole number"),
            ("--steps", "1" * 5000, "'1111"),
            ("--every", "0", "must be 1 or more, not 0"),
            ("--every", "0.5", "'0.5' is not a whole number"),
            ("--fps", "0", "must lie between 0.01 and 240, not 0"),
            ("--fps", "nan", "must lie between 0.01 and 240, not nan"),
            ("--fps", "1e9", "must lie between 0.01 and 240, not 1e+09"),
            ("--size", "0x0", "must be WIDTHxHEIGHT, from 16 to 8192 pixels each, not '0x0'"),
            ("--size", "640", "must be WIDTHxHEIGHT, from 16 to 8192 pixels each, not '640'"),
            ("--size", "1e3x9", "must be WIDTHxHEIGHT, from 16 to 8192 pixels each, not '1e3x9'"),
            ("--size", "9" * 5000 + "x9", "must be WIDTHxHEIGHT, from 16 to 8192 pixels each"),
            ("--colours", "mass", "invalid choice: 'mass'"),
            ("--show", "stars", "invalid choice: 'stars'"),
            ("--from", "x", "'x' is not a whole number"),
            ("--from", "-1", "must be 0 or more, not -1"),
            ("--video", "v.avi", "the name of a video must end in .mp4 or .gif, not 'v.avi'"),
            *((option, "", "the name of a file or folder must not be empty") for option in (
                "--constraints", "--screenshots", "--camera", "--record", "--replay", "--resume",
                "--verify", "--finish", "--stats", "--plot")),
        ]
    },
    "empty scene": ([""], "argument SCENE: the name of a file or folder must not be empty"),
    "no constraint file": (["--constraints", "none.txt"], "none.txt: there is no such file"),
    "constraints are a mesh": (["--constraints", "cube.off"], "cube.off:1: the number of constra"),
    "scene is a mesh": (["cube.off"], "cube.off:1: this is not a scene: the number of bodies must"),
    "scene is a camera": (["camera.json"], "camera.json:1: this is not a scene: the number of bod"),
    "recording is a scene": (["--replay", "a-scene.txt"], "a-scene.txt: this is not a recording"),
    "record over the scene": (["a-scene.txt", "--record", "a-scene.txt"],
                              "--record and SCENE name the same file"),
    "statistics over the camera": (["--camera", "camera.json", "--stats", "./camera.json"],
                                   "--stats and --camera name the same file"),
    "plot over the constraints": (["--constraints", "a-constraints.txt", "--plot",
                                   "folder.mesh/../a-constraints.txt"],
                                  "--plot and --constraints name the same file"),
    "record to nowhere": (["--record", "no/r.npz"], "no/r.npz: No such file or directory"),
    "statistics to nowhere": (["--stats", "no/s.csv"], "no/s.csv: No such file or directory"),
    "plot to nowhere": (["--plot", "no/p.png"], "no/p.png: No such file or directory"),
    "record below a file": (["--record", "cube.off/r.npz"], "cube.off/r.npz: Not a directory"),
    "statistics below a file": (["--stats", "cube.off/s.csv"], "cube.off/s.csv: Not a directory"),
    "plot below a file": (["--plot", "cube.off/p.png"], "cube.off/p.png: Not a directory"),
    "record to a folder": (["--record", "folder.mesh"],
                           "folder.mesh: this is a folder, not a file"),
    "plot to a folder": (["--plot", "folder.mesh"], "folder.mesh: this is a folder, not a file"),
    "record to a long name": (["--record", "x" * 300], "x" * 100),
    "finish nothing": (["--finish", "r.npz"], "r.npz: there is no interrupted recording of it, r"),
    "finish and replay": (["--finish", "r.npz", "--replay", "r.npz"],
                          "--replay does not go with --finish: it only makes one file of the chun"),
    "resume and verify": (["--resume", "r.npz", "--verify", "r.npz"],
                          "argument --verify: not allowed with argument --resume"),
    "fps without a video": (["--fps", "30"], "--fps says how fast --video plays, which is missing"),
    "video of a still": (["--video", "v.mp4", "--time-step", "200"],
                         "v.mp4: in real time there would be 0.005 pictures a second; say with"),
    "video of an instant": (["--video", "v.mp4", "--time-step", "1e-9", "--every", "1"],
                            "v.mp4: in real time there would be 1e+09 pictures a second; say with"),
}  # fmt: skip


@pytest.mark.parametrize("case", OPTIONS)
def test_option_that_cannot_be_used(folder, capsys, case):
    arguments, message = OPTIONS[case]
    isWithScene = not arguments[0].startswith("--") or "--finish" in arguments
    arguments = arguments if isWithScene else ["tet", *arguments]
    if case == "two scenes":
        arguments = ["a", *arguments]
    if "--finish" not in arguments:
        arguments = [*arguments, "--headless"]
    assert_refused(folder, arguments, message, capsys)


# --------------------------------------------------------------------------------------------------
# Graders
# --------------------------------------------------------------------------------------------------

GRADERS = ROOT / "graders"
INTEGRATION = pickle.loads((DATA / "integration.data").read_bytes())


def grader_data(**changes):
    return pickle.dumps(INTEGRATION | {k: change(INTEGRATION[k]) for k, change in changes.items()})


GRADER_DATA = {
    "none": (None, "cannot be read: No such file or directory"),
    "empty": (b"", "not a readable data file: "),
    "text": (b"1 2 3\n", "not a readable data file: "),
    "an .npz": (zip_bomb(), "not a readable data file: "),
    "cut off": (pickle.dumps(INTEGRATION)[:-1000], "not a readable data file: "),
    "runs code": (pickle.dumps(Intruder()), "not a readable data file: posix.system is refused"),
    "a list": (pickle.dumps([1]), "holds a list in place of a dictionary"),
    "no entries": (pickle.dumps({}), "has no entry randomPositions, "),
    "NaN": (grader_data(randomPositions=lambda a: at((3, 1), np.nan)(a.copy())),
            "randomPositions holds a number that is not finite"),
    "infinity": (grader_data(randomAngVelocities=lambda a: at((99, 1), np.inf)(a.copy())),
                 "randomAngVelocities holds a number that is not finite"),
    "zero quaternion": (grader_data(randomOrientations=lambda a: at(9, 0.0)(a.copy())),
                        "randomOrientations holds a zero quaternion"),
    "two columns": (grader_data(randomPositions=lambda a: a[:, :2]),
                    "randomPositions has an axis of length 2 in place of 3"),
    "a sample fewer": (grader_data(resultPositions=lambda a: a[1:]),
                       "resultPositions has an axis of length 99 in place of 100"),
    "no sample": (grader_data(randomPositions=lambda a: a[:0]), "randomPositions is empty"),
    "text for numbers": (grader_data(randomPositions=lambda a: a.astype(str).tolist()),
                         "randomPositions holds a str in place of a number"),
    "an array of text": (grader_data(randomPositions=lambda a: a.astype(str)),
                         "not a readable data file: an array of dtype 'U"),
    "complex": (grader_data(randomPositions=lambda a: a.astype(complex)),
                "not a readable data file: an array of dtype 'c16' is not plain numbers"),
    "integers of 400 digits": (grader_data(randomPositions=lambda a: [[10**400] * 3] * 100),
                               "randomPositions holds object where float is expected"),
    "bytes that are not there": (b"\x80\x04\x8e" + b"\xff" * 7 + b"\x7f.",
                                 "not a readable data file: "),
}  # fmt: skip


@pytest.mark.parametrize("case", GRADER_DATA)
def test_grader_data_that_cannot_be_used(folder, monkeypatch, capsys, case):
    content, message = GRADER_DATA[case]
    if content is not None:
        (folder / "integration.data").write_bytes(content)
    assert_grader_refuses(monkeypatch, capsys, [], f"integration.data: {message}")
    assert not (folder / "intruded").exists()


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such pipes")
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (make_folder, "cannot be read: "),
        (make_fifo, "cannot be read: it is not a file"),
        (make_endless, "cannot be read: it is not a file"),
        (make_loop, "cannot be read: Too many levels of symbolic links"),
        (make_long, "is longer than 67108864 bytes"),
    ],
)
def test_grader_data_that_are_no_file(folder, monkeypatch, capsys, make, message):
    make(folder / "integration.data")
    assert_grader_refuses(monkeypatch, capsys, [], f"integration.data: {message}")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--data", "cube.off"], "cube.off/integration.data: cannot be read: Not a directory"),
        (["--data", "nowhere"], "nowhere/integration.data: cannot be read: No such file"),
        (["--convention", "newton"], "argument --convention: invalid choice: 'newton'"),
        (["--data"], "argument --data: expected one argument"),
        (["everything"], "unrecognized arguments: everything"),
    ],
)
def test_grader_options_that_cannot_be_used(folder, monkeypatch, capsys, options, message):
    assert_grader_refuses(monkeypatch, capsys, options, message)


def assert_grader_refuses(monkeypatch, capsys, options, message):
    monkeypatch.setattr(sys, "argv", ["integrationGrading.py", "--data", ".", *options])
    monkeypatch.syspath_prepend(str(GRADERS))
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(GRADERS / "integrationGrading.py"), run_name="__main__")
    output, errors = capsys.readouterr()
    assert (ended.value.code, output) == (2, ""), errors
    (line,) = errors.splitlines()
    assert line.startswith(f"integrationGrading.py: {message}") and len(line) < 400, line


def test_reference_that_cannot_be_written_is_told_in_one_line(folder):
    command = [sys.executable, GRADERS / "make_reference.py", "--out", "cube.off"]
    process = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert (process.returncode, process.stdout) == (2, "")
    assert process.stderr == "make_reference.py: cube.off: File exists\n"


# --------------------------------------------------------------------------------------------------
# As a person meets it
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["a-scene.txt", "--steps", "many"], "argument --steps: 'many' is not a whole number"),
        (["t.mesh"], "t.mesh:1: this is not a scene: the number of bodies takes 1 column, not 2"),
        (["a-scene.txt", "--constraints", "camera.json"], "camera.json:1: the number of constrain"),
        (["--replay", "camera.json"], "camera.json: this is not a recording (File is not a zip fi"),
        (["--verify", "folder.mesh"], "folder.mesh: this is a folder, not a recording"),
        (["--resume", "r.npz"], "r.npz: there is no such file"),
        (["a-scene.txt", "--camera", "t.mesh"], "t.mesh:1: this is not a JSON file: Expecting val"),
        (["a-scene.txt", "--stats", "no/s.csv"], "no/s.csv: No such file or directory"),
    ],
)
def test_program_ends_with_one_line_and_code_2(folder, arguments, message):
    before = snapshot(folder)
    process = run(folder, *arguments)
    assert (process.returncode, process.stdout) == (2, "")
    (line,) = process.stderr.splitlines()
    assert line.startswith(f"RigidBodySimulation.py: {message}")
    assert snapshot(folder) == before


@pytest.mark.skipif(os.name == "nt", reason="Windows' names are text")
def test_name_that_is_not_unicode_can_be_simulated_and_recorded(folder):
    name = os.fsdecode(b"\xff-scene.txt")
    (folder / name).write_text(scene_of(ROW))
    process = run(folder, name, "--headless", "--steps", 1, "--record", "r.npz")
    assert process.returncode == 0 and process.stderr == ""
    process = run(folder, "--headless", "--replay", "r.npz")
    assert process.returncode == 0 and process.stderr == ""


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full here")
def test_summary_that_nobody_can_take_is_told_in_one_line(folder):
    command = [sys.executable, ROOT / "RigidBodySimulation.py", "a-scene.txt", "--headless",
               "--steps", "1"]  # fmt: skip
    with open("/dev/full", "wb") as full:
        process = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert process.returncode == 2
    assert process.stderr == "RigidBodySimulation.py: cannot write: No space left on device\n"


@pytest.mark.skipif(os.name == "nt", reason="a shell of Unix is needed")
@pytest.mark.parametrize(("redirection", "code"), [(">&-", 0), ("<&-", 0)])
def test_program_runs_without_standard_streams(folder, redirection, code):
    program = f"'{sys.executable}' '{ROOT / 'RigidBodySimulation.py'}'"
    command = f"{program} a-scene.txt --headless --steps 1 {redirection}"
    process = subprocess.run(command, shell=True, capture_output=True, text=True)
    assert (process.returncode, process.stderr) == (code, "")
