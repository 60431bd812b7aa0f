"""Mesh files: tetrahedra from .mesh (MEDIT text), closed surfaces from .off and others.

From the top: `load_mesh_file`; MEDIT; OFF and OBJ; surfaces that trimesh reads; closed surfaces of
triangles, which are turned outwards and filled with tetrahedra.

Units: metres. Faces are counter-clockwise seen from outside; all indices count from 0.
"""

import io
import logging
import os
import re
import warnings
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from rbs.scenes.files import LineReader, SceneError, check_path, read_content, read_text
from rbs.scenes.messages import import_optional, short

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
# Least volume of a tetrahedron or of a surface, relative to the cube of the mesh's extent; smaller
# ones count as flat. Far above the rounding of a volume, far below the thinnest of usual meshes.
FLAT_VOLUME = 1e-13
# Digits to which numbers of 32 and 64 bits are exact.
DIGITS_32, DIGITS_64 = 7, 15
# Largest relative excess of the hull's volume over that of a convex mesh. Coordinates rounded to
# four decimals make about 1e-5. Smaller values report invisible dents; larger ones hide visible
# ones.
CONVEXITY_TOLERANCE = 1e-4
# Corners of a hull from which a body is warned of. In contact, time and memory grow with the
# product of the numbers of corners; beyond some hundred, the motion hardly differs.
MANY_CORNERS = 5000


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


class NonConvexWarning(UserWarning):
    """A mesh is not convex, and collides as its convex hull."""


def clean_surface(vertices, faces):
    """Merges coincident vertices (V, 3), drops those without a face, and returns both tables.

    Faces (F, 3) that lose a corner are dropped, too. Otherwise the order stays the same. Raises
    ValueError if the faces are not triangles of these vertices.
    """
    last = len(vertices) - 1
    if faces.size and (faces.shape[1:] != (3,) or not 0 <= faces.min() <= faces.max() <= last):
        raise ValueError(f"faces must be rows of 3 indices, 0 to {last}")
    used, faces = np.unique(joined_faces(vertices, faces), return_inverse=True)
    return vertices[used], faces.reshape(-1, 3)


def joined_faces(vertices, faces, tolerance=0.0):
    """Returns the faces (F, 3) with the first of coincident vertices as corners.

    Vertices within a tolerance of each other count as coincident, and so do those that are joined
    by others. Faces that lose a corner are dropped.
    """
    if tolerance:
        pairs = cKDTree(vertices).query_pairs(tolerance, output_type="ndarray").T
        graph = coo_array((np.ones(pairs.shape[1]), pairs), 2 * (len(vertices),))
        merged = connected_components(graph, directed=False)[1]
        first = np.unique(merged, return_index=True)[1]
    else:
        # 0.0, not -0.0
        places = vertices + 0.0
        _, first, merged = np.unique(places, axis=0, return_index=True, return_inverse=True)
    faces = first[merged.ravel()][faces]
    return faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]


def orient_surface(vertices, faces):
    """Orients the triangles (F, 3) of a closed surface counter-clockwise seen from outside.

    Neighbours are made consistent. A connected piece of negative volume is flipped, unless it is a
    cavity in another. Where solids touch along an edge, it may belong to more than two triangles,
    half of them each way; all must then be consistent. Raises ValueError if an edge does not belong
    to two triangles otherwise, or the surface is not orientable.
    """
    count = len(faces)
    if count == 0:
        raise ValueError("no triangles")
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    edges, edge, owners = np.unique(
        np.sort(ends, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    ways = np.bincount(edge.ravel(), np.where(ends[:, 0] < ends[:, 1], 1, -1))
    if (owners != 2).any() and not ways.any():
        return faces if enclosed_volume(vertices, faces) >= 0.0 else faces[:, ::-1].copy()
    if (owners != 2).any():
        k = edge.ravel()[(owners != 2)[edge.ravel()].argmax()]
        (low, high), count = edges[k], int(owners[k])
        raise ValueError(
            f"the surface is not closed: the edge between vertices {low} and {high} belongs to "
            f"{count} triangle{'s'[count == 1 :]}, not to 2"
        )
    # Each triangle has two nodes, as it is and turned over (+ count). Those that agree are linked:
    # consistent neighbours traverse their common edge in opposite directions.
    sides = np.argsort(edge.ravel(), kind="stable").reshape(-1, 2)
    one, other = sides.T // 3
    differ = np.equal(*(ends[:, 0] < ends[:, 1])[sides.T]) * count
    links = np.append(one, one + count), np.append(other + differ, other + count - differ)
    graph = coo_array((np.ones(len(links[0])), links), (2 * count, 2 * count))
    asItIs, turned = connected_components(graph, directed=False)[1].reshape(2, -1)
    if (asItIs == turned).any():
        raise ValueError("the surface has no inside (it is not orientable)")
    _, first, piece = np.unique(np.minimum(asItIs, turned), return_index=True, return_inverse=True)
    # the first triangle of each piece stays, and so do those that agree with it
    result = np.where((asItIs != asItIs[first][piece])[:, None], faces[:, ::-1], faces)
    if enclosed_volume(vertices, result) < 0.0:
        result = result[:, ::-1].copy()
    pieces = [np.flatnonzero(piece == k) for k in range(len(first))]
    boxes = [[f(vertices[faces[piece]], axis=(0, 1)) for f in (np.min, np.max)] for piece in pieces]
    for piece, (low, high) in zip(pieces, boxes, strict=True):
        if enclosed_volume(vertices, result[piece]) < 0.0:
            if not any((one < low).all() and (high < other).all() for one, other in boxes):
                result[piece] = result[piece][:, ::-1]
    return result


def close_surface(name, vertices, faces, stacklevel, digits_of=None):
    """Returns the faces (F, 3) of a closed surface, oriented outwards.

    If there are gaps, corners are merged that coincide, then those within the rounding of their
    numbers, with a warning that begins with `name`. Raises ValueError if gaps are left.

    digits_of : function that returns to how many digits the coordinates are exact, relative to the
        largest; None or 0 are those of single precision if all fit in it, else of double precision
    """
    try:
        return orient_surface(vertices, faces)
    except ValueError as error:
        gaps = error
    if not (digits := digits_of and digits_of()):
        with np.errstate(over="ignore"):
            isSingle = (vertices == vertices.astype(np.float32)).all()
        digits = DIGITS_32 if isSingle else DIGITS_64
    for tolerance in (0.0, 2.0 * 10.0 ** (1 - digits) * np.abs(vertices).max(initial=0.0)):
        joined = joined_faces(vertices, faces, tolerance)
        with suppress(ValueError):
            closed = orient_surface(vertices, joined)
            if tolerance and (count := len(np.unique(faces)) - len(np.unique(joined))):
                told = f"within {tolerance:.1g} of others, the rounding of their numbers: {count}"
                warnings.warn(f"{name}: merged corners that lie {told}", stacklevel=stacklevel + 1)
            return closed
    raise gaps


def fill_surface(vertices, faces):
    """Joins the triangles (F, 3) of a closed surface, oriented outwards, to the vertices' mean.

    Returns `(vertices (V + 1, 3), faces, tets (T, 4))`: the mean is the last vertex, and each
    triangle has a tetrahedron, unless that is flat. If the mean does not see all faces from inside,
    as in a torus, there are no tetrahedra and no further vertex. Raises ValueError without volume.
    """
    points = np.vstack([vertices, np.mean(vertices, axis=0)])
    tets = np.insert(faces, 0, len(vertices), axis=1)
    volumes, least = tetrahedron_volumes(points, tets), flat_volume(vertices)
    if not volumes.sum() > least:
        raise ValueError("the surface has no volume")
    if volumes.min() < -least:
        return vertices, faces, tets[:0]
    return points, faces, tets[volumes > least]


def flat_volume(vertices):
    """Returns the volume up to which a solid with these vertices (V, 3) counts as flat."""
    return FLAT_VOLUME * np.max(np.ptp(vertices, axis=0)) ** 3


def tetrahedron_volumes(vertices, tets):
    """Returns the signed volumes (T,) of tetrahedra (T, 4) with corners a, b, c, d.

    They are positive if a, b, c run counter-clockwise seen from d.
    """
    a, b, c, d = (vertices[tets[:, k]] for k in range(4))
    return np.sum((b - a) * np.cross(c - a, d - a), axis=1) / 6.0


def enclosed_volume(vertices, faces):
    """Returns the signed volume inside closed surfaces, by the divergence theorem."""
    return float(tetrahedron_volumes(vertices, np.insert(faces, 0, 0, axis=1)).sum())


def warn_of_shape(name, mesh, stacklevel):
    """Warns if a mesh is not convex, or its hull has more corners than a motion needs.

    stacklevel : 2 for the caller's caller, see `warnings.warn`
    """
    volume, hullVolume, count = mesh.volume, mesh.hullVolume, len(mesh.hull.vertices)
    if hullVolume > volume * (1.0 + CONVEXITY_TOLERANCE):
        hull = f"convex hull {hullVolume:.6g}, {hullVolume / volume - 1.0:.2%} more"
        told = f"{name} is not convex (volume {volume:.6g}, {hull}) and collides as its hull"
        warnings.warn(told, NonConvexWarning, stacklevel=stacklevel + 1)
    if count > MANY_CORNERS:
        told = f"{name} has {count} corners, which makes its contacts slow; some hundred are enough"
        warnings.warn(told, stacklevel=stacklevel + 1)
