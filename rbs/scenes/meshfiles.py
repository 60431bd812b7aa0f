"""Mesh files: tetrahedra from .mesh (MEDIT text), closed surfaces from .off and others.

From the top: `load_mesh_file`; MEDIT; OFF and OBJ; surfaces that trimesh reads.

Units: metres. Faces are counter-clockwise seen from outside; all indices count from 0.
"""

import io
import logging
import os
import re
from functools import partial
from pathlib import Path

import numpy as np

from rbs.scenes.files import LineReader, SceneError, check_path, read_content, read_text
from rbs.scenes.messages import import_optional, short
from rbs.scenes.surfaces import (
    DIGITS_64,
    clean_surface,
    close_surface,
    fill_surface,
    flat_volume,
    tetrahedron_volumes,
)

logging.getLogger("trimesh").addHandler(logging.NullHandler())  # or it prints tracebacks
MESH_ENDINGS = (".mesh", ".off", ".obj", ".stl", ".ply", ".glb")
# m. Beyond, few digits are left for the shape of a body of ordinary size. Products of three such
# coordinates are far from overflowing.
LARGEST_IN_FILE = 1e9
# The sections of a MEDIT file that are used, with columns per row, without the reference number.
_MEDIT_SECTIONS = {"vertices": 3, "tetrahedra": 4}
# How the names of sections with other cells begin.
_OTHER_CELLS = ("hexa", "penta", "prism", "pyramid", "poly", "tetrahedrap")
# Faces of a tetrahedron of positive volume, counter-clockwise seen from outside.
_OUTWARD = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]
# A text file is taken for exact to the digits that it writes, but for no fewer.
LEAST_DIGITS = 6
# A number, as a text file writes it; its digits are counted.
_NUMBER = re.compile(rb"[-+]?(\d*)\.?(\d*)(?:[eE][-+]?\d+)?$")


def load_mesh_file(path: str | Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the vertices (V, 3), faces (F, 3) and tetrahedra (T, 4) of a mesh file, from index 0.

    Faces are oriented counter-clockwise seen from outside, and tetrahedra so that
    det(b - a, c - a, d - a) > 0, whatever the file has. Vertices may coincide; those that are
    unused are moved onto one that is used.

    The faces of a .mesh (MEDIT text) belong to one tetrahedron each. Other files are closed
    surfaces; trimesh reads .stl, .ply and .glb. Their vertices in the same place are merged, those
    of .off only where there are gaps; and if gaps are left, also those that differ by the rounding
    of the file, with a warning. `fill_surface` fills them with tetrahedra if the mean of the
    vertices sees all faces. If not, there are none, and `Mesh` integrates over the faces.

    Raises SceneError if the file is missing or malformed, a tetrahedron is flat, two overlap, a
    surface is not closed, or trimesh is missing.
    """
    check_path(path)
    ending = os.path.splitext(path)[1].lower()
    if ending not in MESH_ENDINGS:
        raise SceneError(path, None, f"a mesh file's name must end in {' or '.join(MESH_ENDINGS)}")
    if ending == ".mesh":
        return _read_medit(LineReader(path, _medit_fields))
    readers = {".off": _read_off, ".obj": _read_obj}
    vertices, faces = readers.get(ending, _read_surface)(path)
    try:
        vertices = np.array(vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.array(faces, dtype=np.int64).reshape(-1, 3)
        if ending != ".off":
            vertices, faces = clean_surface(vertices, faces)
        if not np.abs(vertices[faces]).max(initial=0.0) <= LARGEST_IN_FILE:
            raise ValueError(f"a coordinate is not finite or exceeds {LARGEST_IN_FILE:g}")
        faces = close_surface(path, vertices, faces, 2, lambda: _digits(read_content(path)))
        if ending == ".off":  # constraints refer to the file's numbers of vertices
            _move_unused(vertices, faces)
        else:
            vertices, faces = clean_surface(vertices, faces)
        return fill_surface(vertices, faces)
    except (OverflowError, ValueError) as error:
        raise SceneError(path, None, str(error)) from None


def _digits(content):
    """Returns to how many digits a text file writes its numbers, or 0 of a binary one."""
    if b"\0" in content:
        return 0
    found = filter(None, map(_NUMBER.match, content.split()))
    written = [len((one[1] + one[2]).lstrip(b"0")) for one in found]
    return min(max([*written, LEAST_DIGITS]), DIGITS_64)


def _read_medit(reader):
    """Reads a .mesh file, a stream of fields: sections, each with a count and rows, in any order.

    Other sections (Triangles, ...) are skipped. Reading stops at `End` or the end of the file.
    """
    keyword, sections, isPassingOver = reader.field("MeshVersionFormatted").lower(), {}, False
    if keyword not in ("meshversionformatted", "dimension"):
        raise reader.error("a .mesh file must start with MeshVersionFormatted")
    while keyword != "end":
        what = keyword.capitalize()
        if keyword == "dimension":
            if reader.field("the dimension") != "3":
                raise reader.error("the dimension must be 3")
        elif keyword in sections:
            raise reader.error(f"second section {what}")
        elif keyword in _MEDIT_SECTIONS:
            sections[keyword] = _read_medit_section(reader, what, _MEDIT_SECTIONS[keyword])
        elif keyword.startswith(_OTHER_CELLS) and reader.field(what) != "0":
            raise reader.error(f"{what} are not read; split them into tetrahedra")
        elif not keyword[0].isalpha() and not isPassingOver:
            raise reader.error(f"expected the name of a section, not '{short(keyword)}'")
        isPassingOver = keyword not in (*_MEDIT_SECTIONS, "dimension")
        keyword = "end" if reader.at_end() else reader.field("a section").lower()
    vertices, tets = (sections.get(one, np.zeros((0, 3, 2))) for one in _MEDIT_SECTIONS)
    for table, what in ((vertices, "Vertices"), (tets, "Tetrahedra")):
        if len(table) == 0:
            raise SceneError(reader.path, None, f"no {what}")
    count, lines = len(vertices), tets[:, 0, 1].astype(int)
    isWrong = ~np.isin(tets[..., 0], np.arange(1, count + 1))
    if isWrong.any():
        number, line = tets[isWrong][0]
        cause = f"a vertex index must be a whole number between 1 and {count}, not {number:g}"
        raise SceneError(reader.path, int(line), cause)
    vertices, tets = vertices[..., 0].copy(), tets[..., 0].astype(np.int64) - 1
    _move_unused(vertices, tets)
    volumes = tetrahedron_volumes(vertices, tets)
    isFlat = np.abs(volumes) <= flat_volume(vertices)
    if isFlat.any():
        raise SceneError(reader.path, lines[np.argmax(isFlat)], "the tetrahedron is flat")
    tets[volumes < 0.0] = tets[volumes < 0.0][:, [0, 1, 3, 2]]
    return vertices, _boundary_of(reader.path, len(vertices), tets, lines), tets


def _medit_fields(line):
    """Splits a line into fields, without texts in quotes, which name a file or the mesh."""
    return re.sub('"[^"]*"?', " ", line).split("#", 1)[0].split()


def _read_medit_section(reader, what, width):
    """Returns a section's numbers and their lines (n, width, 2), without the reference numbers."""
    count = reader.integer(reader.field(f"the number of {what}"), f"the number of {what}")
    numbers = []
    for row in range(count):
        name = f"an entry of {what} {row + 1} of {count}"
        for largest in (*[LARGEST_IN_FILE] * width, np.inf):
            numbers.append((reader.number(reader.field(name), name, largest), reader.lineNumber))
    return np.array(numbers).reshape(-1, width + 1, 2)[:, :width]


def _boundary_of(path, count, tets, lines):
    """Returns the faces (F, 3) that belong to one tetrahedron, turned outwards.

    count : of vertices; tets : of positive volume; lines : their line numbers
    Raises SceneError if two tetrahedra lie on the same side of a face.
    """

    def keys(faces):  # one number for the three ways to begin a face
        corners = (np.argmin(faces, axis=1)[:, None] + [0, 1, 2]) % 3
        return np.take_along_axis(faces, corners, axis=1) @ [count * count, count, 1]

    sides = tets[:, _OUTWARD].reshape(-1, 3)
    first = np.unique(keys(sides), return_index=True)[1]
    if len(first) < len(sides):
        again = np.setdiff1d(np.arange(len(sides)), first)[0] // 4
        raise SceneError(path, lines[again], "the tetrahedron overlaps another one at a face")
    return sides[~np.isin(keys(sides), keys(sides[:, ::-1]))]


def _move_unused(vertices, corners):
    """Moves vertices that are no corner onto one that is, so that the hull does not reach them."""
    isUnused = np.isin(np.arange(len(vertices)), corners, invert=True)
    vertices[isUnused] = vertices[corners[:1, 0]]


def _read_off(path):
    """Returns the vertices of an .off file, and its polygons cut into triangles.

    Each has a line, on which more columns may follow: a colour, a normal, ...
    """
    reader = LineReader(path)
    keyword, *counts = reader.row("OFF")
    if keyword.isdecimal():
        counts = [keyword, *counts]
    elif not re.fullmatch("(ST|st|C|c|N)*(?i:off)", keyword):
        cause = f"an .off file must start with OFF, STOFF, COFF or NOFF, not '{short(keyword)}'"
        raise reader.error(cause)
    vertices, triangles, counts = [], [], counts or reader.row("the number of vertices")
    if len(counts) < 2:
        raise reader.error(f"expected the numbers of vertices and faces, not '{short(*counts)}'")
    vertexCount = reader.integer(counts[0], "the number of vertices", low=4)
    faceCount = reader.integer(counts[1], "the number of faces", low=4)
    for k in range(vertexCount):
        vertices.append(_coordinates(reader, reader.row(f"vertex {k + 1} of {vertexCount}")))
    for k in range(faceCount):
        first, *fields = reader.row(f"face {k + 1} of {faceCount}")
        count = reader.integer(first, "the number of a face's corners", low=1)
        if len(fields) < count:
            raise reader.error(f"a face of {count} corners has only {len(fields)}")
        fields = fields[:count]
        corners = [reader.integer(one, "a vertex index", 0, vertexCount - 1) for one in fields]
        if len(set(corners)) < count:
            raise reader.error(f"a vertex is used twice: '{short(*fields)}'")
        triangles += _fan(corners)
    reader.expect_end(faceCount, "face")
    return vertices, triangles


def _coordinates(reader, fields):
    """Returns the three coordinates that begin a vertex's line."""
    if len(fields) < 3:
        raise reader.error(f"a vertex must have 3 coordinates, not '{short(*fields)}'")
    return reader.numbers(fields[:3], "a coordinate", LARGEST_IN_FILE)


def _fan(corners):
    """Returns the triangles into which a polygon is cut."""
    return [[corners[0], *two] for two in zip(corners[1:], corners[2:], strict=False)]


def _read_obj(path):
    """Returns the vertices of an .obj file, and its polygons cut into triangles.

    Corners count from 1, or backwards from the last vertex so far, which trimesh reads otherwise.
    """
    text = read_text(path).replace("\r\n", "\n")
    reader = LineReader(path, text=text.replace("\\\n", " "))
    vertices, triangles = [], []
    while not reader.at_end():
        keyword, *fields = reader.row("the end")
        if keyword == "v":
            vertices.append(_coordinates(reader, fields))
        elif keyword == "f":
            numbers = [field.partition("/")[0] for field in fields]
            corners = [reader.integer(n, "a corner", -len(vertices)) for n in numbers]
            if 0 in corners:
                raise reader.error("a corner must not be 0, because vertices count from 1")
            triangles += _fan([n - 1 if n > 0 else len(vertices) + n for n in corners])
    return vertices, triangles


def _read_surface(path):
    """Returns the vertices and triangles that trimesh, which sees this file only, reads."""
    ending, content = os.path.splitext(path)[1].lower(), read_content(path)
    trimesh = import_optional("trimesh", f"no {ending} files", partial(SceneError, path, None))
    if ending == ".stl":  # bytes may follow, and a name may be in any encoding
        size = 84 + 50 * int.from_bytes(content[80:84], "little")
        isBinary = 84 < size <= len(content)
        content = content[:size] if isBinary else content.decode("utf-8", "replace").encode()
    try:
        options = {"process": False, "skip_materials": True}
        surface = trimesh.load_mesh(io.BytesIO(content), ending[1:], **options)
        return surface.vertices, surface.faces
    except Exception as error:  # of many kinds
        why = short(error, limit=80)
        raise SceneError(path, None, f"not an {ending} file that trimesh reads ({why})") from None
