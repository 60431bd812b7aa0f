"""Mesh files: tetrahedra from .mesh (MEDIT text), closed surfaces from .off, .obj, .stl and .ply.

From the top: `load_mesh_file`; MEDIT files, whose tetrahedra orient the faces; OFF files, whose
faces orient each other and are filled with tetrahedra; surfaces that trimesh reads.

Units: metres. Faces are counter-clockwise seen from outside; all indices count from 0.
"""

import io
import os
from pathlib import Path

import numpy as np

from rbs.geometry.surfaces import (
    clean_surface,
    enclosed_volume,
    faces_at_edges,
    fill_surface,
    not_closed,
    orient_surface,
    tetrahedron_volumes,
)
from rbs.scenes.messages import short
from rbs.scenes.textfiles import LineReader, SceneError, read_content

MESH_ENDINGS = (".mesh", ".off", ".obj", ".stl", ".ply")
# m. Beyond, few digits are left for the shape of a body of ordinary size. Products of three such
# coordinates are far from overflowing.
LARGEST_IN_FILE = 1e9
# Least volume of a tetrahedron, relative to the cube of the mesh's extent; smaller ones count as
# flat. Far above the rounding of a volume, and far below the thinnest tetrahedra of usual meshes.
FLAT_VOLUME = 1e-13
# Largest relative difference between the volume inside the triangles and that of the tetrahedra.
VOLUME_TOLERANCE = 1e-9
# The sections of a MEDIT file that are used, with columns per row, without the reference number.
_MEDIT_SECTIONS = {"Vertices": 3, "Triangles": 3, "Tetrahedra": 4}


def load_mesh_file(path: str | Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Reads a tetrahedral mesh (.mesh, MEDIT text) or a closed surface (.off, .obj, .stl, .ply).

    The last three are read by trimesh, and vertices in the same place are merged.
    Faces are oriented counter-clockwise seen from outside, and tetrahedra so that
    det(b - a, c - a, d - a) > 0, whatever their orientation in the file. A surface is filled with
    tetrahedra from its faces to one inner point, which becomes the last vertex. Vertices may
    coincide or be unused.

    Returns
    -------
    vertices : (V, 3) float64
    faces : (F, 3) int64, indices from 0
    tets : (T, 4) int64, indices from 0

    Raises
    ------
    SceneError
        If the file is missing or malformed, a tetrahedron is flat, a triangle is repeated, the
        triangles are not the closed surface of the tetrahedra, or trimesh is missing.
    """
    ending = os.path.splitext(path)[1].lower()
    if ending not in MESH_ENDINGS:
        names = ", ".join(MESH_ENDINGS)
        raise SceneError(path, None, f"the name of a mesh file must end in one of {names}")
    if ending == ".mesh":
        return _read_medit(LineReader(path))
    if ending == ".off":
        return _read_off(LineReader(path))
    return _read_surface(path, ending)


def _read_medit(reader):
    """Reads the sections of a .mesh file, in any order if the vertices come first.

    Other sections (Edges, Corners, ...) are skipped. Reading stops at `End` or the end of the file.
    """
    if reader.row("MeshVersionFormatted")[0] != "MeshVersionFormatted":
        raise reader.error("a .mesh file must start with MeshVersionFormatted")
    sections, lines = {}, {}
    passingOver = False
    while not reader.at_end():
        keyword, *fields = reader.row("a section")
        if keyword == "End":
            break
        if keyword == "Dimension":
            value = (fields or reader.row("the dimension"))[0]
            reader.integer(value, "the dimension", low=3, high=3)
        elif keyword in _MEDIT_SECTIONS:
            passingOver = False
            if keyword in sections:
                raise reader.error(f"second section {keyword}")
            if keyword != "Vertices" and "Vertices" not in sections:
                raise reader.error(f"the section {keyword} comes before the section Vertices")
            table = _read_medit_section(reader, keyword, fields, sections)
            sections[keyword], lines[keyword] = table
        elif keyword[0].isalpha():
            passingOver = True
        elif not passingOver:
            raise reader.error(f"expected the name of a section, not '{short(keyword, *fields)}'")
    for keyword in _MEDIT_SECTIONS:
        if not len(sections.get(keyword, ())):
            raise SceneError(reader.path, None, f"no {keyword}")
    vertices, faces, tets = (sections[keyword] for keyword in _MEDIT_SECTIONS)
    volumes = tetrahedron_volumes(vertices, tets)
    isFlat = np.abs(volumes) <= FLAT_VOLUME * np.max(np.ptp(vertices[tets.ravel()], axis=0)) ** 3
    if isFlat.all():
        raise SceneError(reader.path, None, "the mesh has no volume")
    if isFlat.any():
        row = int(np.argmax(isFlat))
        raise SceneError(reader.path, lines["Tetrahedra"][row], "the tetrahedron is flat")
    tets[volumes < 0.0] = tets[volumes < 0.0][:, [0, 1, 3, 2]]
    faces = _orient_faces_outward(reader.path, lines["Triangles"], vertices, faces, tets)
    enclosed, filled = enclosed_volume(vertices, faces), float(np.sum(np.abs(volumes)))
    if not abs(enclosed - filled) <= VOLUME_TOLERANCE * filled:
        raise SceneError(
            reader.path,
            None,
            f"the triangles enclose a volume of {enclosed:.6g}, the tetrahedra have {filled:.6g}",
        )
    return vertices, faces, tets


def _read_medit_section(reader, keyword, fields, sections):
    """Reads the rows of one section. Returns (array (n, width), line numbers of its rows).

    The reference numbers are left out.
    """
    width = _MEDIT_SECTIONS[keyword]
    if fields:  # the count may follow the keyword
        count = reader.integer(fields[0], f"the number of {keyword}")
    else:
        count = reader.count(keyword)
    table, lines = [], []
    for row in reader.rows(count, f"row {keyword}", columns=width + 1):
        lines.append(reader.lineNumber)
        reader.number(row[-1], "the reference number")
        if keyword == "Vertices":
            table.append(reader.numbers(row[:-1], "a coordinate", LARGEST_IN_FILE))
        else:
            table.append(_read_corners(reader, row[:-1], 1, len(sections["Vertices"])))
    return np.array(table, dtype=np.float64 if keyword == "Vertices" else np.int64), lines


def _orient_faces_outward(path, lines, vertices, faces, tets):
    """Returns the faces, each oriented so that its tetrahedron lies behind it.

    Each face is decided by itself, so a file may mix both orientations.
    lines : line numbers of the faces
    Raises SceneError unless the faces are a closed surface of the tetrahedra.
    """
    opposite = {}
    for tet in tets.tolist():
        for k in range(4):
            opposite[frozenset(tet[:k] + tet[k + 1 :])] = tet[k]
    keys = [frozenset(face) for face in faces.tolist()]
    first = {}
    for row, (key, line) in enumerate(zip(keys, lines, strict=True), start=1):
        if key not in opposite:
            raise SceneError(path, line, f"triangle {row} is not a face of any tetrahedron")
        if first.setdefault(key, row) != row:
            raise SceneError(path, line, f"triangle {row} repeats triangle {first[key]}")
    inner = [opposite[key] for key in keys]
    # The inner vertex of an outward face lies at a negative distance from it.
    inward = tetrahedron_volumes(vertices, np.column_stack([faces, inner])) > 0.0
    faces = np.where(inward[:, None], faces[:, ::-1], faces)
    for (low, high), owners in faces_at_edges(faces).items():
        line = lines[owners[0][0]]
        if len(owners) != 2:
            raise SceneError(path, line, not_closed(low + 1, high + 1, len(owners)))
        if owners[0][1] == owners[1][1]:
            raise SceneError(path, line, "the tetrahedra on both sides of an edge overlap")
    return faces


def _read_off(reader):
    """Reads a closed surface of polygons, cuts it into triangles and fills it with tetrahedra."""
    header, *counts = reader.row("OFF")
    if header != "OFF":
        raise reader.error("an .off file must start with OFF")
    counts = counts or reader.row("the counts")
    if len(counts) not in (2, 3):  # the number of edges may be left out
        raise reader.error(f"expected the numbers of vertices and faces, not '{short(*counts)}'")
    vertexCount = reader.integer(counts[0], "the number of vertices", low=4)
    faceCount = reader.integer(counts[1], "the number of faces", low=4)
    vertices = np.array(
        [
            reader.numbers(row, "a coordinate", LARGEST_IN_FILE)
            for row in reader.rows(vertexCount, "vertex", columns=3)
        ]
    )
    triangles = []
    for row in reader.rows(faceCount, "face"):
        corners = reader.integer(row[0], "the number of a face's corners", low=3)
        if len(row) <= corners:
            raise reader.error(f"a face of {corners} corners has only {len(row) - 1}")
        # A colour may follow the corners.
        polygon = _read_corners(reader, row[1 : corners + 1], 0, vertexCount)
        triangles += [[polygon[0], a, b] for a, b in zip(polygon[1:], polygon[2:], strict=False)]
    reader.expect_end(f"{faceCount} faces")
    return _filled(reader.path, vertices, np.array(triangles, dtype=np.int64))


def _filled(path, vertices, faces):
    """Orients a closed surface and fills it with tetrahedra. Raises SceneError."""
    try:
        return fill_surface(vertices, orient_surface(vertices, faces))
    except ValueError as error:
        raise SceneError(path, None, str(error)) from None


def _read_surface(path, ending):
    """Reads a closed surface with trimesh, which sees this file only. Raises SceneError."""
    try:
        import trimesh
    except ImportError:
        raise SceneError(path, None, f"{ending} files need trimesh: pip install trimesh") from None
    content = io.BytesIO(read_content(path))
    try:
        surface = trimesh.load_mesh(content, ending[1:], process=False, skip_materials=True)
        vertices = np.array(surface.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.array(surface.faces, dtype=np.int64).reshape(-1, 3)
        vertices[faces]  # an index may be out of range
    except Exception as error:  # of many kinds; for text that is none, it wants a further package
        why = "no text" if isinstance(error, ImportError) else short(error, limit=80)
        raise SceneError(path, None, f"not an {ending} file that trimesh reads ({why})") from None
    if len(faces) == 0:
        raise SceneError(path, None, "no triangles")
    if not np.abs(vertices[faces]).max() <= LARGEST_IN_FILE:
        raise SceneError(path, None, f"a coordinate is not finite or exceeds {LARGEST_IN_FILE:g}")
    return _filled(path, *clean_surface(vertices, faces))


def _read_corners(reader, fields, first, vertexCount):
    """Returns a list of vertex indices from 0, read from fields that count from `first`."""
    last = first + vertexCount - 1
    corners = [reader.integer(field, "a vertex index", first, last) - first for field in fields]
    if len(set(corners)) < len(corners):
        raise reader.error(f"a vertex is used twice: '{short(*fields)}'")
    return corners
