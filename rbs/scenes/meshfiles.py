"""Mesh files: tetrahedra from .mesh (MEDIT text), closed surfaces from .off and others.

From the top: `load_mesh_file`; MEDIT; OFF; surfaces that trimesh reads, and what it misreads.

Units: metres. Faces are counter-clockwise seen from outside; all indices count from 0.
"""

import io
import os
import re
import warnings
from pathlib import Path

import numpy as np

from rbs.geometry.surfaces import (
    clean_surface,
    enclosed_volume,
    fill_surface,
    flat_volume,
    joined_faces,
    orient_surface,
    tetrahedron_volumes,
)
from rbs.scenes.messages import short
from rbs.scenes.textfiles import LineReader, SceneError, read_content

MESH_ENDINGS = (".mesh", ".off", ".obj", ".stl", ".ply", ".glb", ".gltf")
# m. Beyond, few digits are left for the shape of a body of ordinary size. Products of three such
# coordinates are far from overflowing.
LARGEST_IN_FILE = 1e9
# Largest relative difference between the volume inside a file's triangles and that of its
# tetrahedra that is not worth a warning: coordinates of single precision make about 1e-7.
VOLUME_TOLERANCE = 1e-6
# The sections of a MEDIT file that are used, with columns per row, without the reference number.
_MEDIT_SECTIONS = {"vertices": 3, "triangles": 3, "tetrahedra": 4}
# How the names of sections with other cells begin.
_OTHER_CELLS = ("hexa", "penta", "prism", "pyramid", "poly", "tetrahedrap")
# Faces of a tetrahedron of positive volume, counter-clockwise seen from outside.
_OUTWARD = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]
# The types in a PLY file's header, and their letters in NumPy.
_PLY_NAMES = "char uchar short ushort int uint float double"
_PLY_SIZES = "int8 uint8 int16 uint16 int32 uint32 float32 float64"
_PLY_TYPES = dict(zip(f"{_PLY_NAMES} {_PLY_SIZES}".split(), 2 * "bBhHiIfd", strict=True))


def load_mesh_file(path: str | Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the vertices (V, 3), faces (F, 3) and tetrahedra (T, 4) of a mesh file, from index 0.

    Faces are oriented counter-clockwise seen from outside, and tetrahedra so that
    det(b - a, c - a, d - a) > 0, whatever the file has. Vertices may coincide; those that are
    unused are moved onto one that is used.

    The faces of a .mesh (MEDIT text) belong to one tetrahedron each; those that the file lists come
    first, in its order. Other files are closed surfaces; all but .off are read by trimesh, with
    vertices in the same place merged. `fill_surface` fills them with tetrahedra if the mean of the
    vertices sees all faces. If not, there are none, and `Mesh` integrates over the faces.

    Warns if the triangles of a .mesh enclose another volume than the tetrahedra have. Raises
    SceneError if the file is missing or malformed, a tetrahedron is flat, two overlap, a surface is
    not closed, or trimesh is missing.
    """
    ending = os.path.splitext(path)[1].lower()
    if ending not in MESH_ENDINGS:
        cause = "binary MEDIT is not read; save the mesh as text" * (ending == ".meshb")
        known = f"a mesh file's name must end in {' or '.join(MESH_ENDINGS)}"
        raise SceneError(path, None, cause or known)
    if ending == ".mesh":
        return _read_medit(LineReader(path, _medit_fields))
    vertices, faces = _read_off(path) if ending == ".off" else _read_surface(path, ending)
    try:
        _move_unused(vertices, faces)
        return fill_surface(vertices, _closed(vertices, faces))
    except ValueError as error:
        raise SceneError(path, None, str(error)) from None


def _read_medit(reader):
    """Reads a .mesh file, a stream of fields: sections, each with a count and rows, in any order.

    Other sections (Edges, Corners, ...) are skipped. Reading stops at `End` or the end of the file.
    """
    keyword, sections, isPassingOver = reader.field("MeshVersionFormatted").lower(), {}, False
    if keyword not in ("meshversionformatted", "dimension"):
        raise reader.error("a .mesh file must start with MeshVersionFormatted")
    while keyword != "end":
        what = keyword.capitalize()
        if keyword == "dimension":
            reader.integer(reader.field("the dimension"), "the dimension", low=3, high=3)
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
    vertices, triangles, tets = (sections.get(one, np.zeros((0, 3, 2))) for one in _MEDIT_SECTIONS)
    for table, what in ((vertices, "Vertices"), (tets, "Tetrahedra")):
        if len(table) == 0:
            raise SceneError(reader.path, None, f"no {what}")
    count, lines = len(vertices), tets[:, 0, 1].astype(int)
    for table in (triangles, tets):
        isWrong = ~np.isin(table[..., 0], np.arange(1, count + 1))
        if isWrong.any():
            number, line = table[isWrong][0]
            cause = f"a vertex index must be a whole number between 1 and {count}, not {number:g}"
            raise SceneError(reader.path, int(line), cause)
    vertices = vertices[..., 0].copy()
    triangles, tets = (table[..., 0].astype(np.int64) - 1 for table in (triangles, tets))
    _move_unused(vertices, tets)
    volumes = tetrahedron_volumes(vertices, tets)
    isFlat = np.abs(volumes) <= flat_volume(vertices)
    if isFlat.any():
        raise SceneError(reader.path, lines[np.argmax(isFlat)], "the tetrahedron is flat")
    tets[volumes < 0.0] = tets[volumes < 0.0][:, [0, 1, 3, 2]]
    faces = _boundary_of(reader.path, len(vertices), triangles, tets, lines)
    _compare_volumes(reader.path, vertices, triangles, float(np.sum(np.abs(volumes))))
    return vertices, faces, tets


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


def _boundary_of(path, count, triangles, tets, lines):
    """Returns the faces (F, 3) that belong to one tetrahedron, turned outwards.

    Those that are among the file's triangles come first, in its order.
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
    boundary = sides[~np.isin(keys(sides), keys(sides[:, ::-1]))]
    isInward = np.isin(keys(triangles[:, ::-1]), keys(boundary))
    faces = np.where(isInward[:, None], triangles[:, ::-1], triangles)
    faces = np.concatenate([faces[np.isin(keys(faces), keys(boundary))], boundary])
    return faces[np.sort(np.unique(keys(faces), return_index=True)[1])]


def _compare_volumes(path, vertices, triangles, filled):
    """Warns if triangles of a .mesh are closed and do not enclose the tetrahedra's volume."""
    try:
        enclosed = enclosed_volume(vertices, orient_surface(vertices, triangles))
    except ValueError:  # none, a part of the surface, or inner faces, too
        return
    if not abs(enclosed - filled) <= VOLUME_TOLERANCE * filled:
        volumes = (
            f"the triangles enclose a volume of {enclosed:.6g}, the tetrahedra have {filled:.6g}"
        )
        warnings.warn(f"{path}: {volumes}, which is the body's", stacklevel=2)


def _move_unused(vertices, corners):
    """Moves vertices that are no corner onto one that is, so that the hull does not reach them."""
    isUnused = np.isin(np.arange(len(vertices)), corners, invert=True)
    vertices[isUnused] = vertices[corners[:1, 0]]


def _closed(vertices, faces):
    """Returns the faces, turned outwards. Coincident vertices are joined if there are gaps."""
    try:
        return orient_surface(vertices, faces)
    except ValueError:
        return orient_surface(vertices, joined_faces(vertices, faces))


def _read_off(path):
    """Returns the vertices (V, 3) of an .off file, and its polygons cut into triangles (F, 3)."""
    if re.search(rb"^\s*\w*OFF[ \t]+BINARY", read_content(path), re.MULTILINE):
        raise SceneError(path, 1, "OFF BINARY is not read; save the surface as text")
    reader = LineReader(path)
    header, *counts = fields = reader.row("OFF")
    name = re.fullmatch("(?:ST|st|C|c|N)*(4?n?)(?i:off)", header)
    if name and name[1]:
        raise reader.error(f"{header} is not read; vertices must have three coordinates")
    if not name and not header.isdecimal():
        raise reader.error("an .off file must start with OFF")
    counts = (counts if name else fields) or reader.row("the counts")
    if len(counts) not in (2, 3):  # the number of edges may be left out
        raise reader.error(f"expected the numbers of vertices and faces, not '{short(*counts)}'")
    vertexCount = reader.integer(counts[0], "the number of vertices", low=4)
    faceCount = reader.integer(counts[1], "the number of faces", low=4)
    vertices, triangles = [], []
    for row in reader.rows(vertexCount, "vertex"):  # a normal, a colour, ... may follow
        row = _continued(reader, row, 3, "a vertex must have 3 coordinates")
        vertices.append(reader.numbers(row[:3], "a coordinate", LARGEST_IN_FILE))
    for row in reader.rows(faceCount, "face"):  # a colour may follow
        count = reader.integer(row[0], "the number of a face's corners", low=1)
        what = f"a face of {count} corners has only {len(row) - 1}"
        row = _continued(reader, row, count + 1, what)
        fields = row[1 : count + 1]
        corners = [reader.integer(one, "a vertex index", 0, vertexCount - 1) for one in fields]
        if len(set(corners)) < count:
            raise reader.error(f"a vertex is used twice: '{short(*fields)}'")
        triangles += [[corners[0], *two] for two in zip(corners[1:], corners[2:], strict=False)]
    reader.expect_end(f"{faceCount} faces")
    return np.array(vertices), np.array(triangles, dtype=np.int64)


def _continued(reader, row, width, what):
    """Returns a row of at least `width` fields, which may stand on several lines.

    Raises SceneError, with what is wrong with the row, unless its last line ends with it.
    """
    error, fields = reader.error(f"{what}: '{short(*row)}'"), list(row)
    while len(fields) < width and not reader.at_end():
        fields += reader.row(what)
        if len(fields) > width:
            raise error
    if len(fields) < width:
        raise error
    return fields


def _read_surface(path, ending):
    """Reads a closed surface with trimesh, which sees this file only. Raises SceneError."""
    try:
        import trimesh
    except ImportError:
        raise SceneError(path, None, f"{ending} files need trimesh: pip install trimesh") from None
    content = read_content(path)
    try:
        plain = {".obj": _plain_obj, ".ply": _ply_as_text, ".stl": _stl_of_length}
        content = plain.get(ending, bytes)(content)
        options = {"process": False, "skip_materials": True}
        surface = trimesh.load_mesh(io.BytesIO(content), ending[1:], **options)
        vertices = np.array(surface.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.array(surface.faces, dtype=np.int64).reshape(-1, 3)
        vertices[faces]  # an index may be out of range
    except Exception as error:  # of many kinds; for text that is none, it wants a further package
        why = "no text" if isinstance(error, ImportError) else short(error, limit=80)
        if ending == ".gltf" and re.search(rb'"uri"\s*:\s*"(?!data:)', content):
            why = "its numbers are in other files; save it as .glb"
        raise SceneError(path, None, f"not an {ending} file that trimesh reads ({why})") from None
    if not np.abs(vertices[faces]).max(initial=0.0) <= LARGEST_IN_FILE:
        raise SceneError(path, None, f"a coordinate is not finite or exceeds {LARGEST_IN_FILE:g}")
    return clean_surface(vertices, faces)


def _plain_obj(content):
    """Returns vertices and faces of an OBJ file, counted from its beginning.

    trimesh counts relative corners from the end of the file, and takes 0 for the last vertex.
    """
    count, lines = 0, []
    for line in re.sub(rb"\\\r?\n", b" ", content.removeprefix(b"\xef\xbb\xbf")).splitlines():
        keyword, *fields = line.split() or [b""]
        if keyword == b"v":
            count += 1
            lines.append(b" ".join([keyword, *fields]))
        elif keyword == b"f":
            corners = [int(field.partition(b"/")[0]) for field in fields]
            corners = [n + (count + 1) * (n < 0) for n in corners]
            if min(corners, default=1) < 1:
                raise ValueError("a corner is no vertex")
            lines.append(b"f " + b" ".join(b"%d" % n for n in corners))
    return b"\n".join(lines)


def _stl_of_length(content):
    """Returns an STL file without what follows the triangles that its binary header counts."""
    end = 84 + 50 * int.from_bytes(content[80:84], "little")
    return content[:end] if 84 < end <= len(content) else content


def _ply_as_text(content):
    """Returns a PLY file as text, without texture: of others, trimesh takes all faces for alike."""
    content = content.replace(b" texcoord", b" unused", 1)
    binary = rb"(?s)(.*?\nformat )binary_(little|big)_endian(.*?\nend_header)\r?\n(.*)"
    if not (found := re.fullmatch(binary, content)):
        return content
    header, order = found[1] + b"ascii" + found[3], "<" if found[2] == b"little" else ">"
    place, elements, rows = 0, [], [header]
    for keyword, *words in filter(None, map(str.split, header.decode().splitlines())):
        if keyword == "element":
            elements.append((int(words[1]), []))
        elif keyword == "property":
            elements[-1][1].append([_PLY_TYPES[word] for word in words[:-1] if word != "list"])
    for count, properties in elements:
        for _ in range(count):
            row = []
            for letters in properties:
                size = 1
                for letter in letters:  # of a list: its length, then what it lists
                    values = np.frombuffer(found[4], order + letter, size, place).tolist()
                    place += size * np.dtype(letter).itemsize
                    row, size = row + values, (values or [0])[0]
            rows.append(" ".join(map(str, row)).encode())
    return b"\n".join(rows)
