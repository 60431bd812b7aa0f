"""Mesh files: tetrahedra from .mesh (MEDIT text), closed surfaces from .off.

From the top: `load_mesh_file`; MEDIT files, whose faces are turned outward by their tetrahedra; OFF
files, whose faces are turned by each other and filled with tetrahedra; volumes and edges.

Units: metres. Faces are counter-clockwise seen from outside; all indices count from 0.
"""

import os

import numpy as np

from rbs.scenes.messages import counted, short
from rbs.scenes.textfiles import LineReader, SceneError

# Metres: from here on a body of ordinary size has but a few digits left for its shape, and
# products of three coordinates are still far from overflowing.
LARGEST_COORDINATE = 1e9
# A tetrahedron is flat when its volume is below this fraction of the cube of the mesh's extent:
# well above the rounding of a volume (1e-16), far below the thinnest of a usual mesh (1e-5).
FLAT_VOLUME = 1e-13
# By what fraction the volume within a mesh's triangles may differ from that of its tetrahedra.
VOLUME_TOLERANCE = 1e-9
# A point lies inside of a face's plane when it is deeper than this fraction of the mesh's extent:
# well above the rounding of a distance (1e-15), and below any tetrahedron worth having.
INSIDE_MARGIN = 1e-9
# The sections of a MEDIT file that are used: the width of their rows without the reference number.
_MEDIT_SECTIONS = {"Vertices": 3, "Triangles": 3, "Tetrahedra": 4}


def load_mesh_file(path):
    """Reads a tetrahedral mesh (.mesh, MEDIT text) or a closed surface (.off).

    Faces are turned to be counter-clockwise seen from outside, and tetrahedra to have
    det(b - a, c - a, d - a) > 0, whichever way the file has them. A surface is filled with the
    tetrahedra of its faces and one inner point, which becomes the last vertex. Vertices may
    coincide, and may be used by nothing.

    The triangles must be one or more closed surfaces, none of them twice; they must enclose the
    volume that the tetrahedra have; and no tetrahedron may be flat.

    path : str or Path
    returns (vertices (V, 3) float64, faces (F, 3) int64, tets (T, 4) int64), indices from 0
    raises SceneError when the file is missing, malformed, or not a body of some volume
    """
    readers = {".mesh": _read_medit, ".off": _read_off}
    read = readers.get(os.path.splitext(path)[1].lower())
    if read is None:
        raise SceneError(path, None, "the name of a mesh file must end in .mesh or .off")
    reader = LineReader(path)
    return read(reader)


def _read_medit(reader):
    """The sections of a .mesh file, in any order as long as the vertices come first.

    Other sections (Edges, Corners, ...) are passed over. `End` or the end of the file ends it.
    """
    if reader.row("MeshVersionFormatted")[0] != "MeshVersionFormatted":
        raise reader.error("a .mesh file starts with MeshVersionFormatted")
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
                raise reader.error(f"there is a second section {keyword}")
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
            raise SceneError(reader.path, None, f"there are no {keyword}")
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
    """The rows of one section, without the reference number: (n, width) floats or indices.

    returns (the array, list of the lines that its rows stand in)
    """
    width = _MEDIT_SECTIONS[keyword]
    if fields:  # the count stands behind the keyword
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
    """The faces, each turned so that the tetrahedron that it bounds lies behind it.

    That decides for each face by itself, so a file may mix both directions. lines : of the faces
    raises SceneError where the faces are not a closed surface of the tetrahedra
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
            raise SceneError(path, line, f"triangle {row} is the same as triangle {first[key]}")
    inner = [opposite[key] for key in keys]
    # The inner vertex of an outward face stands at a negative distance over it.
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
    """A closed surface of polygons, cut into triangles and filled with tetrahedra."""
    header, *counts = reader.row("OFF")
    if header != "OFF":
        raise reader.error("an .off file starts with OFF")
    counts = counts or reader.row("the counts")
    if len(counts) not in (2, 3):  # the number of edges may be left out
        raise reader.error(f"expected the numbers of vertices and faces: '{short(*counts)}'")
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
        # What follows the corners is the face's colour.
        polygon = _read_corners(reader, row[1 : corners + 1], 0, vertexCount)
        triangles += [[polygon[0], a, b] for a, b in zip(polygon[1:], polygon[2:], strict=False)]
    reader.expect_end(f"{faceCount} faces")
    try:
        faces = orient_surface(vertices, np.array(triangles, dtype=np.int64))
        return fill_surface(vertices, faces)
    except ValueError as error:
        raise SceneError(reader.path, None, str(error)) from None


def orient_surface(vertices, faces):
    """Turns the triangles of a closed surface to be counter-clockwise seen from outside.

    Neighbours are made to agree, starting from one triangle of each connected piece, and a piece
    with a negative volume is turned as a whole. Works on any closed surface, convex or not.

    vertices (V, 3), faces (F, 3); returns (F, 3)
    raises ValueError when an edge does not belong to exactly two triangles, or has no sides
    """
    neighbours = [[] for _ in faces]
    for (low, high), owners in _faces_at_edges(faces).items():
        if len(owners) != 2:
            raise ValueError(_not_closed(low, high, len(owners)))
        (one, oneAscends), (other, otherAscends) = owners
        # Neighbours that agree run along their common edge in opposite directions.
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
    """The triangles connected with `start`; notes in `turned` which must turn to agree with it."""
    turned[start] = False
    piece = [start]
    for face in piece:  # grows while it is walked through
        for other, differs in neighbours[face]:
            if turned[other] is None:
                turned[other] = turned[face] ^ differs
                piece.append(other)
            elif turned[other] != turned[face] ^ differs:
                raise ValueError("the surface has no inside: it cannot be turned consistently")
    return piece


def fill_surface(vertices, faces):
    """Joins every triangle of a closed surface to one inner point.

    vertices (V, 3); faces (F, 3), counter-clockwise seen from outside
    returns (vertices (V+1, 3) with the inner point as last one, faces, tets (T, 4) of positive
    volume); a triangle without area gets no tetrahedron
    raises ValueError when no point sees all faces from behind
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
    """A point (3,) more than `margin` behind all planes normals · x = offsets.

    The vertex mean, if it will do: it always does for a convex body. Else the point whose least
    distance from the planes is largest, which is a linear programme: maximise t under
    normals · x + t ≤ offsets.

    raises ValueError when there is no such point
    """
    mean = np.mean(vertices, axis=0)
    if np.max(normals @ mean - offsets) < -margin:
        return mean
    # Imported here: it takes as long as everything else together, and few files need it.
    from scipy.optimize import linprog

    best = linprog(
        c=[0.0, 0.0, 0.0, -1.0],
        A_ub=np.column_stack([normals, np.ones(len(normals))]),
        b_ub=offsets,
        bounds=[(None, None)] * 4,
    )
    if best.status != 0 or best.x[3] <= margin:
        raise ValueError(
            "the surface cannot be filled from one point, since no point sees all of it from "
            "inside; give it as a .mesh with tetrahedra"
        )
    return best.x[:3]


def tetrahedron_volumes(vertices, tets):
    """Signed volumes (T,): positive where d lies on the side that a, b, c turn clockwise from."""
    a, b, c, d = (vertices[tets[:, k]] for k in range(4))
    return np.sum(np.cross(b - a, c - a) * (d - a), axis=1) / 6.0


def enclosed_volume(vertices, faces):
    """Of closed surfaces, by the divergence theorem; negative if the faces look inward."""
    a, b, c = (vertices[faces[:, k]] - vertices[0] for k in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6.0)


def _faces_at_edges(faces):
    """dict of the edges (low, high), each with its owners: (face, whether low comes first)."""
    owners = {}
    for face, corners in enumerate(faces.tolist()):
        for tail, head in zip(corners, corners[1:] + corners[:1], strict=True):
            key = (min(tail, head), max(tail, head))
            owners.setdefault(key, []).append((face, tail < head))
    return owners


def _not_closed(low, high, count):
    """What is wrong with a surface one of whose edges belongs to so many triangles."""
    return (
        f"the surface is not closed: the edge between the vertices {low} and {high} "
        f"belongs to {counted(count, 'triangle')}, not to 2"
    )


def _read_corners(reader, fields, first, vertexCount):
    """Vertex indices counted from `first`, as a list counted from 0; no vertex twice."""
    last = first + vertexCount - 1
    corners = [reader.integer(field, "a vertex index", first, last) - first for field in fields]
    if len(set(corners)) < len(corners):
        raise reader.error(f"a vertex is used twice: '{short(*fields)}'")
    return corners
