"""Mesh files: tetrahedra from .mesh (MEDIT text), closed surfaces from .off.

From the top: `load_mesh_file`; MEDIT files, whose tetrahedra orient the faces; OFF files, whose
faces orient each other and are filled with tetrahedra; volumes and edges.

Units: metres. Faces are counter-clockwise seen from outside; all indices count from 0.
"""

import os

import numpy as np

from rbs.scenes.messages import counted, short
from rbs.scenes.textfiles import LineReader, SceneError

# m. Beyond, few digits are left for the shape of a body of ordinary size. Products of three such
# coordinates are far from overflowing.
LARGEST_COORDINATE = 1e9
# Least volume of a tetrahedron, relative to the cube of the mesh's extent; smaller ones count as
# flat. Far above the rounding of a volume, and far below the thinnest tetrahedra of usual meshes.
FLAT_VOLUME = 1e-13
# Largest relative difference between the volume inside the triangles and that of the tetrahedra.
VOLUME_TOLERANCE = 1e-9
# Least depth of an inner point below the plane of each face, relative to the mesh's extent. Far
# above the rounding of a distance. Larger values refuse more surfaces.
INSIDE_MARGIN = 1e-9
# The sections of a MEDIT file that are used, with columns per row, without the reference number.
_MEDIT_SECTIONS = {"Vertices": 3, "Triangles": 3, "Tetrahedra": 4}


def load_mesh_file(path):
    """Reads a tetrahedral mesh (.mesh, MEDIT text) or a closed surface (.off).

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
        If the file is missing or malformed, a tetrahedron is flat, or the triangles are not closed
        surfaces, each given once, around the volume of the tetrahedra.
    """
    readers = {".mesh": _read_medit, ".off": _read_off}
    read = readers.get(os.path.splitext(path)[1].lower())
    if read is None:
        raise SceneError(path, None, "the name of a mesh file must end in .mesh or .off")
    reader = LineReader(path)
    return read(reader)


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
            table.append(reader.numbers(row[:-1], "a coordinate", LARGEST_COORDINATE))
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
    for (low, high), owners in _faces_at_edges(faces).items():
        line = lines[owners[0][0]]
        if len(owners) != 2:
            raise SceneError(path, line, _not_closed(low + 1, high + 1, len(owners)))
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
            reader.numbers(row, "a coordinate", LARGEST_COORDINATE)
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
    try:
        faces = orient_surface(vertices, np.array(triangles, dtype=np.int64))
        return fill_surface(vertices, faces)
    except ValueError as error:
        raise SceneError(reader.path, None, str(error)) from None


def orient_surface(vertices, faces):
    """Orients the triangles of a closed surface counter-clockwise seen from outside.

    Neighbours are made consistent, starting from one triangle of each connected piece, and a piece
    of negative volume is flipped as a whole. The surface need not be convex.

    Returns
    -------
    (F, 3)

    Raises
    ------
    ValueError
        If an edge does not belong to exactly two triangles, or the surface is not orientable.
    """
    neighbours = [[] for _ in faces]
    for (low, high), owners in _faces_at_edges(faces).items():
        if len(owners) != 2:
            raise ValueError(_not_closed(low, high, len(owners)))
        (one, oneAscends), (other, otherAscends) = owners
        # Consistent neighbours traverse their common edge in opposite directions.
        neighbours[one].append((other, oneAscends == otherAscends))
        neighbours[other].append((one, oneAscends == otherAscends))

    result = faces.copy()
    turned = [None] * len(faces)
    for start in range(len(faces)):
        if turned[start] is None:
            piece = _agree_with(start, neighbours, turned)
            flips = [face for face in piece if turned[face]]
            result[flips] = result[flips][:, ::-1]
            a, b, c = (vertices[result[piece, k]] for k in range(3))
            if np.sum(a * np.cross(b, c)) < 0.0:  # six times the enclosed volume
                result[piece] = result[piece][:, ::-1]
    return result


def _agree_with(start, neighbours, turned):
    """Returns the triangles connected with `start`. Marks in `turned` those to be flipped."""
    turned[start] = False
    piece = [start]
    for face in piece:  # grows during the loop
        for other, differs in neighbours[face]:
            if turned[other] is None:
                turned[other] = turned[face] ^ differs
                piece.append(other)
            elif turned[other] != turned[face] ^ differs:
                raise ValueError("the surface has no inside (it is not orientable)")
    return piece


def fill_surface(vertices, faces):
    """Joins every triangle of a closed surface to one inner point.

    Parameters
    ----------
    faces : (F, 3), counter-clockwise seen from outside

    Returns
    -------
    vertices : (V + 1, 3), the inner point last
    faces : the same
    tets : (T, 4) of positive volume, one for each triangle with an area

    Raises
    ------
    ValueError
        If no point sees all faces from behind.
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.sqrt(np.sum(normals * normals, axis=1))
    extent = np.max(np.ptp(vertices, axis=0))
    solid = lengths > INSIDE_MARGIN * extent * extent
    if not solid.any():
        raise ValueError("the mesh has no volume")
    normals = normals[solid] / lengths[solid, None]
    offsets = np.sum(normals * a[solid], axis=1)

    inner = find_inner_point(vertices, normals, offsets, INSIDE_MARGIN * extent)
    apex = np.full((np.count_nonzero(solid), 1), len(vertices))
    return np.vstack([vertices, inner]), faces, np.hstack([apex, faces[solid]])


def find_inner_point(vertices, normals, offsets, margin):
    """Returns a point (3,) more than `margin` behind all planes normals · x = offsets.

    The mean of the vertices is used if it qualifies, as in every convex body. Otherwise a linear
    programme maximises the least distance t from the planes, normals · x + t ≤ offsets. Raises
    ValueError if no point qualifies.
    """
    mean = np.mean(vertices, axis=0)
    if np.max(normals @ mean - offsets) < -margin:
        return mean
    # Imported here, because it takes long and few files need it.
    from scipy.optimize import linprog

    best = linprog(
        c=[0.0, 0.0, 0.0, -1.0],
        A_ub=np.column_stack([normals, np.ones(len(normals))]),
        b_ub=offsets,
        bounds=[(None, None)] * 4,
    )
    if best.status != 0 or best.x[3] <= margin:
        raise ValueError(
            "the surface cannot be filled, because no point sees all of it from inside; give it as "
            "a .mesh with tetrahedra"
        )
    return best.x[:3]


def tetrahedron_volumes(vertices, tets):
    """Returns signed volumes (T,), positive if a, b, c run clockwise seen from d."""
    a, b, c, d = (vertices[tets[:, k]] for k in range(4))
    return np.sum(np.cross(b - a, c - a) * (d - a), axis=1) / 6.0


def enclosed_volume(vertices, faces):
    """Returns the volume inside closed surfaces, by the divergence theorem; signed."""
    a, b, c = (vertices[faces[:, k]] - vertices[0] for k in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6.0)


def _faces_at_edges(faces):
    """Returns a dict from edges (low, high) to lists of (face, whether low comes first)."""
    owners = {}
    for face, corners in enumerate(faces.tolist()):
        for tail, head in zip(corners, corners[1:] + corners[:1], strict=True):
            key = (min(tail, head), max(tail, head))
            owners.setdefault(key, []).append((face, tail < head))
    return owners


def _not_closed(low, high, count):
    """Returns the message for an edge that belongs to `count` triangles."""
    return (
        f"the surface is not closed: the edge between vertices {low} and {high} "
        f"belongs to {counted(count, 'triangle')}, not to 2"
    )


def _read_corners(reader, fields, first, vertexCount):
    """Returns a list of vertex indices from 0, read from fields that count from `first`."""
    last = first + vertexCount - 1
    corners = [reader.integer(field, "a vertex index", first, last) - first for field in fields]
    if len(set(corners)) < len(corners):
        raise reader.error(f"a vertex is used twice: '{short(*fields)}'")
    return corners
