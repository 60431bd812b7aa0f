"""Loads scenes and runs them: the program's entry point.

    python RigidBodySimulation.py mixed                 opens a window
    python RigidBodySimulation.py mixed --headless      needs no display and no OpenGL

From the top: the reading of text files and its errors; meshes, scenes and constraints; the
`Simulation` that the window and the command line share; runs without a window; the command line.
Nothing here draws: `RBSViewer`, and with it Polyscope, is imported only when something is to be
seen.

Units: metres, kilograms, seconds. The y axis points up and the ground is the plane y = 0.
"""

import argparse
import io
import math
import operator
import os
import re
import signal
import statistics
import sys
import time
import warnings
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

import RBSDrawing
import RBSViewer
from RBSDrawing import flatten_meshes as flatten_meshes  # also known by this module's name
from RBSFiles import one_line, read_bytes, reason_of
from RBSFunctions import (
    BROAD_PHASES,
    CONSTRAINT_SCHEDULINGS,
    PAIR_ORDERS,
    Mesh,
    StateError,
    run_timestep,
)
from RBSRecording import (
    Recorder,
    Recording,
    RecordingError,
    Replay,
    Scene,
    StatsWriter,
    check_bodies,
    finish,
    resume,
    step_quantities,
    verify,
)

PROGRAM_FOLDER = Path(__file__).resolve().parent
DATA_FOLDER = PROGRAM_FOLDER / "data"
SCENE_ENDING = "-scene.txt"
CONSTRAINTS_ENDING = "-constraints.txt"
RECORDING_ENDING = ".npz"
DEFAULT_SCENE = "mixed"

# Bodies keep half of their closing speed: the first falls visibly bounce and a pile comes to rest
# within ten seconds. With 1, the other natural choice, nothing in a scene would ever settle.
DEFAULT_RESTITUTION = 0.5
# 50 steps a second: what a bounce needs to look smooth, and what the coursework's scenes are
# laid out for.
DEFAULT_TIME_STEP = 0.02
# Ten seconds with the default time step: the falls and the settling of every scene in data/.
DEFAULT_STEPS = 500
# A tie between two bodies of the usual size, 5 to 20 m, is off by a millimetre at most when all is
# well: nobody sees that, and a chain of ten settles on it within a few sweeps.
CONSTRAINT_TOLERANCE = 1e-3
# Constraint visits in a step: as many sweeps as a chain needs to pass a tug along itself a few
# times over, and what the coursework allows where the constraints are few.
SWEEPS = 20
LEAST_VISITS = 1000
# Five pictures a second with the default time step.
DEFAULT_EVERY = 10
# What the program draws where it was asked for a window and there is no display.
FALLBACK_PICTURES = 5
# The least and the largest width and height of pictures: a thumbnail, and 8K.
PICTURE_SIZES = (16, 8192)
# Pictures a second: what an encoder can still write down, what screens can still show, and, of
# what time step and --every make together, what an encoder can write down again.
SLOWEST_VIDEO, FASTEST_VIDEO, FASTEST_ENCODER = 0.01, 240.0, 1e4
# The most steps, or visits, that can be asked for: more than there will be time for, and a number
# that floats hold exactly.
MOST_STEPS = 10**15
# Seconds. Outside of these a step changes nothing to be seen, or all there is to be seen; numbers
# made of it soon overflow.
TIME_STEPS = (1e-12, 1e3)

# A mesh counts as convex while its hull is larger than itself by no more than this fraction.
# Coordinates that were written with four decimals make about 1e-5; what a smaller tolerance would
# report nobody could see, and a dent of 1e-4 shifts a contact by far less than a body's size.
CONVEXITY_TOLERANCE = 1e-4
# The longest line of a text file, in characters: a face of a hundred thousand corners.
LONGEST_LINE = 1 << 20
# Metres: from here on a body of ordinary size has but a few digits left for its shape, and
# products of three coordinates are still far from overflowing.
LARGEST_COORDINATE = 1e9
# kg/m³, for the same reason: a neutron star has less than 1e19.
LARGEST_DENSITY = 1e30
# A tetrahedron is flat when its volume is below this fraction of the cube of the mesh's extent:
# well above the rounding of a volume (1e-16), far below the thinnest of a usual mesh (1e-5).
FLAT_VOLUME = 1e-13
# By what fraction the volume within a mesh's triangles may differ from that of its tetrahedra.
VOLUME_TOLERANCE = 1e-9
# A point lies inside of a face's plane when it is deeper than this fraction of the mesh's extent:
# well above the rounding of a distance (1e-15), and below any tetrahedron worth having.
INSIDE_MARGIN = 1e-9


# ---------------------------------------------------------------------------------------------
# Reading text files
# ---------------------------------------------------------------------------------------------


class SceneError(ValueError):
    """A file, or a name of one, that cannot be used. Reads "file:line: cause" in one line."""

    def __init__(self, path, lineNumber, cause):
        """lineNumber : counted from 1, or None where the file as a whole is meant."""
        place = f"{path}:{lineNumber}" if lineNumber else f"{path}"
        super().__init__(one_line(f"{place}: {cause}"))


class NonConvexWarning(UserWarning):
    """A mesh that collides as its convex hull, which is larger than the mesh itself."""


class LineReader:
    """The lines of a text file that hold something, split at blanks, one after the other.

    Anything from a `#` to the end of its line is a comment. Blank lines, tabs, CR-LF and a
    byte-order mark make no difference. Whatever is wrong is raised as a SceneError that names the
    file and the line read last.
    """

    def __init__(self, path):
        self.path = path
        self.lineNumber = None
        self._lines = self._split(self._read())
        self._next = next(self._lines, None)
        if self._next is None:
            raise self.error("the file is empty")

    def _read(self):
        """The bytes of the file, which are UTF-8."""
        try:
            content = read_bytes(self.path)
        except FileNotFoundError:
            raise self.error("there is no such file") from None
        except IsADirectoryError as error:
            raise self.error(reason_of(error)) from None
        except (OSError, ValueError) as error:  # ValueError: a name that no file can have
            raise self.error(f"cannot be read ({reason_of(error)})") from None
        try:
            if b"\0" in content:
                raise ValueError("NUL bytes do not occur in text")
            content.decode("utf-8-sig")
        except ValueError:
            raise self.error("this is not a text file") from None
        return content

    def _split(self, content):
        """Yields (line number, fields) of the lines with something in them, one at a time."""
        text = io.TextIOWrapper(io.BytesIO(content), encoding="utf-8-sig", newline=None)
        number = 0
        while line := text.readline(LONGEST_LINE + 1):
            number += 1
            if len(line) > LONGEST_LINE:
                self.lineNumber = number
                raise self.error(f"a line must not be longer than {LONGEST_LINE} characters")
            if fields := line.split("#", 1)[0].split():
                yield number, fields

    def error(self, cause):
        """The SceneError that stands at the current line. To be raised by the caller."""
        return SceneError(self.path, self.lineNumber, cause)

    def at_end(self):
        """Whether no line with something in it is left."""
        return self._next is None

    def row(self, what, columns=None):
        """The fields of the next line, a list of str; as many as `columns`, if given.

        what : names the line in the error that is raised where it is missing or has another width
        """
        if self._next is None:
            raise self.error(f"the file ends before {what}")
        self.lineNumber, fields = self._next
        self._next = next(self._lines, None)
        if columns is not None and len(fields) != columns:
            width = "1 column" if columns == 1 else f"{columns} columns"
            raise self.error(f"{what} takes {width}, not {len(fields)}: '{short(*fields)}'")
        return fields

    def count(self, what, low=0):
        """A line that holds nothing but a whole number ≥ low, the number of `what`."""
        (field,) = self.row(f"the number of {what}", columns=1)
        return self.whole(field, f"the number of {what}", low)

    def rows(self, count, what, columns=None):
        """The next `count` lines as lists of fields, one at a time."""
        for index in range(count):
            yield self.row(f"{what} {index + 1} of {count}", columns)

    def number(self, field, what, largest=math.inf):
        """The finite float that `field` spells, between -largest and largest."""
        try:
            value = plain_float(field)
        except ValueError:
            raise self.error(f"{what} must be a number, not '{short(field)}'") from None
        if not math.isfinite(value):
            raise self.error(f"{what} must be finite, not '{short(field)}'")
        if abs(value) > largest:
            raise self.error(f"{what} must not exceed {largest:g}, as '{short(field)}' does")
        return value

    def numbers(self, fields, what, largest=math.inf):
        """The finite floats that the fields spell, as a list."""
        return [self.number(field, what, largest) for field in fields]

    def whole(self, field, what, low=0, high=None):
        """The whole number that `field` spells, low ≤ number and, if `high` is given, ≤ high."""
        try:
            value = plain_int(field)
        except ValueError:
            raise self.error(f"{what} must be a whole number, not '{short(field)}'") from None
        if value < low or (high is not None and value > high):
            allowed = f"between {low} and {high}"
            if high is None:
                allowed = f"at least {low}"
            elif high == low:
                allowed = f"{low}"
            raise self.error(f"{what} must be {allowed}, not {short(str(value))}")
        return value

    def expect_end(self, announced):
        """Raises unless all that is left is blank. `announced`: what the count had promised."""
        if not self.at_end():
            fields = self.row("the end")
            raise self.error(f"more lines than the {announced} announced: '{short(*fields)}'")


def short(*words, limit=40):
    """The words as one string that fits into an error line."""
    text = " ".join(words)
    return text if len(text) <= limit else text[: limit - 3] + "..."


def plain_float(text):
    """The float that a text spells; ValueError for what only Python takes for one, as 1_000."""
    if "_" in text or not text.isascii():
        raise ValueError(f"not a number: {text!r}")
    return float(text)


def plain_int(text):
    """The whole number that a text spells; ValueError for what only Python takes for one."""
    if "_" in text or not text.isascii():
        raise ValueError(f"not a whole number: {text!r}")
    return int(text)


# ---------------------------------------------------------------------------------------------
# Meshes
# ---------------------------------------------------------------------------------------------


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


def tetrahedron_volumes(vertices, tets):
    """Signed volumes (T,): positive where d lies on the side that a, b, c turn clockwise from."""
    a, b, c, d = (vertices[tets[:, k]] for k in range(4))
    return np.sum(np.cross(b - a, c - a) * (d - a), axis=1) / 6.0


# The sections of a MEDIT file that are used: the width of their rows without the reference number.
_MEDIT_SECTIONS = {"Vertices": 3, "Triangles": 3, "Tetrahedra": 4}


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
            reader.whole(value, "the dimension", low=3, high=3)
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
    faces = _turn_faces_outward(reader.path, lines["Triangles"], vertices, faces, tets)
    enclosed, filled = enclosed_volume(vertices, faces), float(np.sum(np.abs(volumes)))
    if not abs(enclosed - filled) <= VOLUME_TOLERANCE * filled:
        raise SceneError(
            reader.path, None,
            f"the triangles enclose a volume of {enclosed:.6g}, the tetrahedra have {filled:.6g}",
        )  # fmt: skip
    return vertices, faces, tets


def _read_medit_section(reader, keyword, fields, sections):
    """The rows of one section, without the reference number: (n, width) floats or indices.

    returns (the array, list of the lines that its rows stand in)
    """
    width = _MEDIT_SECTIONS[keyword]
    if fields:  # the count stands behind the keyword
        count = reader.whole(fields[0], f"the number of {keyword}")
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


def _read_corners(reader, fields, first, vertexCount):
    """Vertex indices counted from `first`, as a list counted from 0; no vertex twice."""
    last = first + vertexCount - 1
    corners = [reader.whole(field, "a vertex index", first, last) - first for field in fields]
    if len(set(corners)) < len(corners):
        raise reader.error(f"a vertex is used twice: '{short(*fields)}'")
    return corners


def _turn_faces_outward(path, lines, vertices, faces, tets):
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
        f"belongs to {count} triangle{'s' * (count != 1)}, not to 2"
    )


def _read_off(reader):
    """A closed surface of polygons, cut into triangles and filled with tetrahedra."""
    header, *counts = reader.row("OFF")
    if header != "OFF":
        raise reader.error("an .off file starts with OFF")
    counts = counts or reader.row("the counts")
    if len(counts) not in (2, 3):  # the number of edges may be left out
        raise reader.error(f"expected the numbers of vertices and faces: '{short(*counts)}'")
    vertexCount = reader.whole(counts[0], "the number of vertices", low=4)
    faceCount = reader.whole(counts[1], "the number of faces", low=4)
    vertices = np.array([
        reader.numbers(row, "a coordinate", LARGEST_COORDINATE)
        for row in reader.rows(vertexCount, "vertex", columns=3)
    ])
    triangles = []
    for row in reader.rows(faceCount, "face"):
        corners = reader.whole(row[0], "the number of a face's corners", low=3)
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


# ---------------------------------------------------------------------------------------------
# Scenes and constraints
# ---------------------------------------------------------------------------------------------


def find_scene(name):
    """The path of a scene: `name` itself if it is one, else data/<name>-scene.txt.

    raises SceneError that lists the scenes of data/ when there is neither
    """
    path = Path(name)
    if os.path.exists(path):  # unlike path.exists(), does not raise where it cannot look
        return path
    ours = DATA_FOLDER / f"{name}{SCENE_ENDING}"
    if path.name == str(name) and os.path.exists(ours):
        return ours
    known = ", ".join(scene_name(scene) for scene in list_scenes(DATA_FOLDER))
    raise SceneError(name, None, f"there is no such scene, neither a file nor one of: {known}")


def list_scenes(folder):
    """The paths of all scenes in a folder, by name."""
    return sorted(Path(folder).glob(f"*{SCENE_ENDING}"))


def find_constraints(scenePath):
    """The constraint file that belongs to NAME-scene.txt, NAME-constraints.txt, or None."""
    path = Path(scenePath).with_name(scene_name(scenePath) + CONSTRAINTS_ENDING)
    return path if os.path.exists(path) else None


def scene_name(path):
    """What a person calls a scene: the file's name without its ending."""
    name = Path(path).name
    return name[: -len(SCENE_ENDING)] if name.endswith(SCENE_ENDING) else Path(path).stem


def load_scene_file(path, allowOutsideMeshes=False):
    """Reads a scene: the number of bodies, then `meshfile density isFixed x y z qw qx qy qz` each.

    Mesh files are looked up beside the scene file, and each is read once; their names may have
    blanks in them, and `\\` separates folders as `/` does. A body is named after its mesh file and
    its place in the scene, "box 3": the index that constraints know it by.
    A mesh that is not convex gives one NonConvexWarning, however many bodies use it.

    path : str or Path
    allowOutsideMeshes : whether mesh files may lie outside of the scene's folder, by an absolute
        path, by `..` or through a symbolic link; without it, a scene of unknown origin makes this
        program read nothing but what came with it
    returns a list of Mesh
    raises SceneError
    """
    reader = LineReader(path)
    bodyCount = reader.count("bodies", low=1)
    loaded = {}
    meshes = []
    for index, row in enumerate(reader.rows(bodyCount, "body")):
        row = _body_row(reader, row, f"body {index + 1} of {bodyCount}")
        fileName = row[0]
        density = reader.number(row[1], "the density", LARGEST_DENSITY)
        if density <= 0.0:
            raise reader.error(f"the density must be positive, not {row[1]}")
        isFixed = bool(reader.whole(row[2], "isFixed", 0, 1))
        position = reader.numbers(row[3:6], "a coordinate", LARGEST_COORDINATE)
        orientation = reader.numbers(row[6:10], "the quaternion")
        largest = max(map(abs, orientation))
        if largest == 0.0:
            raise reader.error("the quaternion must not be zero")
        # hypot neither overflows nor vanishes where the sum of the squares would; of the largest
        # numbers that there are, it does.
        scale = 1.0 if largest < 1e300 else largest
        length = math.hypot(*(component / scale for component in orientation))
        orientation = [component / scale / length for component in orientation]
        isNew = fileName not in loaded
        if isNew:
            loaded[fileName] = _load_mesh_beside(reader, fileName, allowOutsideMeshes)
        name = f"{Path(fileName).stem} {index}"
        mesh = _make_body(
            reader, name, *loaded[fileName], density, position, orientation, isFixed
        )  # fmt: skip
        meshes.append(mesh)
        if isNew:
            _warn_unless_convex(fileName, mesh)
    reader.expect_end(f"{bodyCount} bodies")
    return meshes


def _body_row(reader, fields, what):
    """The ten columns of a body's line, the name of its mesh file with `/` between folders.

    A name may have blanks in it, which is seen from its ending. `\\` stands for `/` on every
    system, so that a scene means the same on all of them.
    """
    name = " ".join(fields[:-9])
    if len(fields) < 10 or (len(fields) > 10 and not name.lower().endswith((".mesh", ".off"))):
        raise reader.error(f"{what} takes 10 columns, not {len(fields)}: '{short(*fields)}'")
    return [name.replace("\\", "/"), *fields[-9:]]


def _load_mesh_beside(reader, fileName, allowOutside):
    """The mesh of a scene's current line; where there is none, the error names that line."""
    folder = Path(reader.path).parent
    path = folder / fileName
    # realpath follows links and `..` as the system would.
    home, target = os.path.realpath(folder), os.path.realpath(path)
    if not allowOutside and not Path(target).is_relative_to(home):
        raise reader.error(
            f"the mesh file '{short(fileName)}' lies outside of the scene's folder; "
            "--allow-outside-meshes reads it"
        )
    if not os.path.exists(path):
        raise reader.error(f"there is no mesh file '{short(fileName)}' beside the scene")
    return load_mesh_file(path)


def _make_body(reader, name, vertices, faces, tets, density, *state):
    """The Mesh of a scene's current line; raises SceneError where its mass has no sense."""
    try:
        with np.errstate(all="ignore"):
            mesh = Mesh(name, vertices, faces, tets, density, *state)
            inverses = 1.0 / mesh.mass, np.linalg.inv(mesh.IT)
    except (ValueError, ZeroDivisionError) as error:
        raise reader.error(f"this cannot be a body: {error}") from None
    if not all(np.isfinite(value).all() for value in (mesh.IT, *inverses)):
        raise reader.error(f"this cannot be a body: its mass, {mesh.mass:g}, is beyond reckoning")
    if 0.0 < mesh.hullVolume * (1.0 + CONVEXITY_TOLERANCE) < mesh.volume:
        raise reader.error(
            f"the tetrahedra of {name} overlap: their volume is {mesh.volume:.6g}, that of their "
            f"convex hull {mesh.hullVolume:.6g}"
        )
    return mesh


def _warn_unless_convex(fileName, mesh):
    """Warns if the hull of a Mesh is larger than itself; stacklevel: whoever loads the scene."""
    if mesh.hullVolume > mesh.volume * (1.0 + CONVEXITY_TOLERANCE):
        warnings.warn(
            f"{fileName} is not convex (volume {mesh.volume:.6g}, its convex hull "
            f"{mesh.hullVolume:.6g}): it collides as its hull",
            NonConvexWarning,
            stacklevel=3,
        )


def load_constraint_file(path, meshes):
    """Reads distance constraints: their number, then `m1 v1 m2 v2 lower upper` each.

    Vertex v1 of mesh m1 and vertex v2 of mesh m2 (counted from 0) stay between `lower` and `upper`
    times the distance that they have now, by their currVertices.

    meshes : list of Mesh
    returns a list of [m1, v1, m2, v2, refValue, upper], two for each line: first the lower bound,
    then the upper one; refValue in metres, upper a bool
    raises SceneError
    """
    reader = LineReader(path)
    lineCount = reader.count("constraints")
    constraints = []
    for row in reader.rows(lineCount, "constraint", columns=6):
        m1, v1 = _read_end(reader, row[0], row[1], meshes)
        m2, v2 = _read_end(reader, row[2], row[3], meshes)
        lower, upper = reader.numbers(row[4:], "a bound")
        if not 0.0 <= lower <= upper:
            raise reader.error(f"the bounds must be 0 ≤ lower ≤ upper, not {row[4]} and {row[5]}")
        distance = math.dist(meshes[m1].currVertices[v1], meshes[m2].currVertices[v2])
        if upper * distance == math.inf:
            raise reader.error(f"the upper bound {row[5]} is beyond reckoning")
        constraints.append([m1, v1, m2, v2, lower * distance, False])
        constraints.append([m1, v1, m2, v2, upper * distance, True])
    reader.expect_end(f"{lineCount} constraints")
    return constraints


def _read_end(reader, meshField, vertexField, meshes):
    """(mesh index, vertex index) of one end of a constraint."""
    mesh = reader.whole(meshField, "a mesh index", 0, len(meshes) - 1)
    vertex = reader.whole(vertexField, "a vertex index", 0, len(meshes[mesh].currVertices) - 1)
    return mesh, vertex


# ---------------------------------------------------------------------------------------------
# Simulation
# ---------------------------------------------------------------------------------------------

def make_ground():
    """The ground as the contract has it: a fixed mesh of nothing at the origin."""
    noTriangles, noTets = np.empty((0, 3), dtype=np.int64), np.empty((0, 4), dtype=np.int64)
    return Mesh(
        "ground", np.empty((0, 3)), noTriangles, noTets,
        0.0, np.zeros((1, 3)), [[1.0, 0.0, 0.0, 0.0]], True,
    )  # fmt: skip


def checked_restitution(value):
    """The value, if it lies in [0, 1]; else ValueError. Above, every contact would add energy."""
    if not 0.0 <= value <= 1.0:
        raise ValueError(f"the restitution must lie between 0 and 1, not {value:g}")
    return value


def checked_time_step(value):
    """The value in seconds, if it is positive and within TIME_STEPS; else ValueError."""
    if not 0.0 < value < math.inf:
        raise ValueError(f"the time step must be positive and finite, not {value:g}")
    low, high = TIME_STEPS
    if not low <= value <= high:
        raise ValueError(f"the time step must be between {low:g} and {high:g} s, not {value:g}")
    return value


def checked_friction(value):
    """The value, if it is finite and not negative; else ValueError."""
    if not 0.0 <= value < math.inf:
        raise ValueError(f"the friction must be finite and not negative, not {value:g}")
    return value


@dataclass
class Settings:
    """What a scene is simulated with, apart from its bodies. The defaults are the basic behaviour.

    restitution : 0 to 1; timeStep : s; closingOnly : see `resolve_collision`; friction : μ ≥ 0
    enforceConstraints : whether a scene's constraints are used
    constraintScheduling : a name of CONSTRAINT_SCHEDULINGS
    maxIterations : constraint visits in a step at most, or None for the default
    broadPhase : a name of BROAD_PHASES; pairOrder : a name of PAIR_ORDERS
    """

    restitution: float = DEFAULT_RESTITUTION
    timeStep: float = DEFAULT_TIME_STEP
    closingOnly: bool = False
    friction: float = 0.0
    enforceConstraints: bool = True
    constraintScheduling: str = "sweep"
    maxIterations: int | None = None
    broadPhase: str = "all"
    pairOrder: str = "sequential"

    def change(self, name, value):
        """Sets a field; raises ValueError, and changes nothing, where it cannot have this value."""
        setattr(self, name, getattr(replace(self, **{name: value}), name))

    def __post_init__(self):
        """Raises ValueError or TypeError for what has no sense: a recording may say anything."""
        self.restitution = checked_restitution(float(self.restitution))
        self.timeStep = checked_time_step(float(self.timeStep))
        self.friction = checked_friction(float(self.friction))
        if not (isinstance(self.closingOnly, bool) and isinstance(self.enforceConstraints, bool)):
            raise ValueError("closingOnly and enforceConstraints must be true or false")
        if self.constraintScheduling not in CONSTRAINT_SCHEDULINGS:
            raise ValueError(f"there is no scheduling {self.constraintScheduling!r}")
        if self.broadPhase not in BROAD_PHASES:
            raise ValueError(f"there is no broad phase {self.broadPhase!r}")
        if self.pairOrder not in PAIR_ORDERS:
            raise ValueError(f"there is no pair order {self.pairOrder!r}")
        if self.maxIterations is not None:
            at_least(0)(operator.index(self.maxIterations))


class Simulation(Scene):
    """A scene, what it is simulated with, and how far it has come.

    Attributes: scenePath; meshes, list of Mesh; constraintPath, or None; constraints, a list as
    `load_constraint_file` gives it; groundMesh; settings; stepCount, the whole steps since the
    start; report, the last step's `StepReport`, and stepSeconds, how long it took (None before the
    first).
    """

    def __init__(
        self, scenePath, settings=None, constraintPath=None, *, allowOutsideMeshes=False
    ):
        """Loads the scene; raises SceneError.

        constraintPath : a constraint file; by default the one that belongs to the scene by its
            name, if there is one
        allowOutsideMeshes : see `load_scene_file`
        """
        self._allowOutsideMeshes = allowOutsideMeshes
        self.settings = Settings() if settings is None else settings
        self.groundMesh = make_ground()
        self.load(scenePath, constraintPath)

    def load(self, scenePath, constraintPath=None):
        """Changes to another scene, at its start. Where that raises SceneError, nothing changes."""
        meshes = load_scene_file(scenePath, self._allowOutsideMeshes)
        if constraintPath is None:
            constraintPath = find_constraints(scenePath)
        constraints = [] if constraintPath is None else load_constraint_file(constraintPath, meshes)
        self.meshes, self.constraints = meshes, constraints
        self.scenePath = Path(scenePath)
        self.constraintPath = constraintPath
        self._startState = self.state()
        self._startFixed = [mesh.isFixed for mesh in meshes]
        self._begin()

    def _begin(self):
        self.stepCount = 0
        self.time = 0.0
        self.stepSeconds = self.report = None

    def reset(self):
        """Puts every body back to where the scene has it, at rest, and free or fixed as it was."""
        for mesh, isFixed in zip(self.meshes, self._startFixed, strict=True):
            mesh.set_fixed(isFixed)
        self.set_state(self._startState)
        self._begin()

    def max_iterations(self):
        """Constraint visits in a step at most: as set, or twenty sweeps and at least a thousand."""
        if self.settings.maxIterations is not None:
            return self.settings.maxIterations
        return max(LEAST_VISITS, SWEEPS * len(self.constraints))

    def step(self):
        """Goes on by one time step.

        raises StateError, which names the step and the body, where a number would become NaN,
        infinite or absurdly large; the simulation then stays as it was before the step
        """
        settings = self.settings
        begin = time.perf_counter()
        try:
            with np.errstate(all="ignore"):  # what overflows is told in one line below
                self.report = run_timestep(
                    self.meshes,
                    self.groundMesh,
                    settings.timeStep,
                    settings.restitution,
                    settings.enforceConstraints,
                    self.constraints,
                    self.max_iterations(),
                    CONSTRAINT_TOLERANCE,
                    closingOnly=settings.closingOnly,
                    constraintScheduling=settings.constraintScheduling,
                    mu=settings.friction,
                    broadPhase=settings.broadPhase,
                    pairOrder=settings.pairOrder,
                )
        except StateError as error:
            raise StateError(f"step {self.stepCount + 1} cannot be made: {error}") from None
        self.stepSeconds = time.perf_counter() - begin
        self.stepCount += 1
        self.time += settings.timeStep


# ---------------------------------------------------------------------------------------------
# Running without a window
# ---------------------------------------------------------------------------------------------


class Progress:
    """Shows how far a run has come: a bar where there is a terminal and tqdm, else now and then
    a line, on stderr in both cases."""

    # Seldom enough that a log of an hour's run stays readable.
    SECONDS_BETWEEN_LINES = 10.0

    def __init__(self, steps):
        self._steps = steps
        self._done = 0
        self._start = self._lastLine = time.monotonic()
        self._bar = None
        if sys.stderr.isatty():
            try:
                from tqdm import tqdm
            except ImportError:
                return
            self._bar = tqdm(total=steps, unit="step", leave=False)

    def advance(self):
        """One step more is done."""
        self._done += 1
        if self._bar is not None:
            self._bar.update()
        elif time.monotonic() - self._lastLine >= self.SECONDS_BETWEEN_LINES:
            self._lastLine = time.monotonic()
            left = (self._lastLine - self._start) * (self._steps / self._done - 1.0)
            line = f"step {self._done} of {self._steps}, about {left:.0f} s left"
            print(line, file=sys.stderr, flush=True)

    def close(self):
        if self._bar is not None:
            self._bar.close()


@contextmanager
def interrupt_noted():
    """Within it, Ctrl-C does not break into a step: the list that it yields becomes non-empty.

    A second Ctrl-C acts as ever, in case a step never ends.
    """
    noted = []

    def note(signalNumber, frame):
        noted.append(signalNumber)
        signal.signal(signal.SIGINT, previous)

    previous = signal.signal(signal.SIGINT, note)
    try:
        yield noted
    finally:
        signal.signal(signal.SIGINT, previous)


@dataclass
class Run:
    """What `run_steps` measured."""

    stepSeconds: list
    wasInterrupted: bool
    failure: str = ""  # of a StateError


def run_steps(simulation, steps, observers=()):
    """Simulates `steps` steps, or fewer when Ctrl-C is pressed or a number goes wrong.

    observers : functions of the simulation, called at its start and after every step
    returns a Run; of a replay, which measures nothing, its times are empty
    """
    stepSeconds = []
    done = 0
    failure = ""
    for observe in observers:
        observe(simulation)
    progress = Progress(steps)
    with interrupt_noted() as interrupts:
        while done < steps and not interrupts:
            try:
                simulation.step()
            except StateError as error:
                failure = str(error)
                break
            done += 1
            if simulation.stepSeconds is not None:
                stepSeconds.append(simulation.stepSeconds)
            for observe in observers:
                observe(simulation)
            progress.advance()
    progress.close()
    return Run(stepSeconds, bool(interrupts), failure)


def summarise(simulation, run, startEnergies):
    """The lines that a run without a window ends with. startEnergies : (kinetic, potential) in J"""
    meshes = simulation.meshes
    fixedCount = sum(mesh.isFixed for mesh in meshes)
    kinetic, potential = startEnergies
    y, lowestName = simulation.lowest_point()
    stepTime = "a recording" if isinstance(simulation, Replay) else "no step was made"
    if run.stepSeconds:
        median = statistics.median(run.stepSeconds)
        stepTime = f"{1e3 * median:.2f} ms median, {sum(run.stepSeconds):.1f} s in total"
    where = f"y = {y:.4g} m ({lowestName})" if meshes else "none"
    rows = {
        "scene": shown_path(simulation.scenePath),
        "bodies": f"{len(meshes)}, {fixedCount} of them fixed",
        "constraints": constraint_summary(simulation),
        "steps": f"{simulation.stepCount} of {simulation.settings.timeStep:g} s: "
        f"{simulation.time:.6g} s simulated" + ", stopped by Ctrl-C" * run.wasInterrupted
        + ", stopped by an error" * bool(run.failure),
        "time per step": stepTime,
        "kinetic energy": f"{kinetic:.6g} J at the start, {simulation.kinetic_energy():.6g} J now",
        "potential energy": f"{potential:.6g} J at the start, "
        f"{simulation.potential_energy():.6g} J now",
        "lowest point": where,
        "numbers": "all finite" if simulation.is_finite() else "NOT ALL FINITE",
    }
    return "\n".join(f"{name:<17} {value}" for name, value in rows.items())


def constraint_summary(simulation):
    """How many constraints there are, and how far the one that is off most is off."""
    if not simulation.constraints:
        return "none"
    count = f"{len(simulation.constraints)} bounds"
    if not simulation.settings.enforceConstraints:
        return f"{count}, left out"
    return f"{count}, violated by at most {simulation.largest_violation():.3g} m"


def shown_path(path):
    """The path relative to the current folder where it lies in it, which is shorter to read."""
    try:
        return Path(os.path.realpath(path)).relative_to(Path.cwd())
    except ValueError:
        return Path(path)


def run_without_window(simulation, steps, recorder=None, stats=None, pictures=None, video=None):
    """Runs, records, takes pictures and prints the summary; returns the exit code.

    recorder, stats : a Recorder and a StatsWriter, or None
    pictures, video : RBSDrawing.PictureSeries and RBSDrawing.Video, or None
    """
    helpers = (recorder, stats, pictures, video)
    observers = [helper.add for helper in helpers if helper is not None]
    startEnergies = simulation.kinetic_energy(), simulation.potential_energy()
    run = run_steps(simulation, steps, observers)
    if recorder is not None:
        recorder.save()
    if stats is not None:
        stats.save(f"{scene_name(simulation.scenePath)}, to step {simulation.stepCount}")
    if video is not None:
        video.save()
    print(summarise(simulation, run, startEnergies))
    if pictures is not None:
        print(f"{'pictures':<17} {pictures.count} in {shown_path(pictures.folder)}")
    if video is not None:
        print(f"{'video':<17} {shown_path(video.path)}: {video.summary(simulation)}")
    if recorder is not None:
        print(f"{'recording':<17} {shown_path(recorder.path)}")
    if stats is not None and stats.path is not None:
        print(f"{'statistics':<17} {shown_path(stats.path)}")
    if stats is not None and stats.plotPath is not None:
        print(f"{'plot':<17} {shown_path(stats.plotPath)}")
    if run.failure:
        print_error(run.failure)
        return 3
    if run.wasInterrupted:
        return 130  # 128 + SIGINT, as a shell reports a program that Ctrl-C ended
    return 0


# ---------------------------------------------------------------------------------------------
# Command line
# ---------------------------------------------------------------------------------------------

EXAMPLES = """\
Without options, the mixed scene opens in a window. Where there is no display, a scene runs
off-screen: pictures go to out/<scene>, and a summary is printed."""
# An example for each group of options.
PHYSICS_EXAMPLES = "RigidBodySimulation.py stress --friction 0.5 --restitution 0.2"
CONSTRAINT_EXAMPLES = "RigidBodySimulation.py bridge --scheduling queue"
OUTPUT_EXAMPLES = """\
RigidBodySimulation.py stress --screenshots out/stress --every 25
RigidBodySimulation.py bridge --video bridge.mp4 --steps 300"""
RECORDING_EXAMPLES = """\
RigidBodySimulation.py tower --record tower.npz --stats tower.csv --steps 1000
RigidBodySimulation.py --replay tower.npz
RigidBodySimulation.py --resume tower.npz --from 500 --friction 0.4"""


class OneLineParser(argparse.ArgumentParser):
    """Reports a wrong command line in one line: argparse itself puts the whole usage before it."""

    def error(self, message):
        self.exit(2, f"{self.prog}: {one_line(message)} (--help lists the options)\n")


def option_type(convert, check, kind):
    """An argparse type whose errors say what is wrong. check : value -> value, or ValueError"""

    def parse(text):
        try:
            value = convert(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"'{short(text)}' is not a {kind}") from None
        try:
            return check(value)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return parse


def at_least(low, high=math.inf):
    """A check that numbers are not below `low`, and not above `high`."""

    def check(value):
        if value < low:
            raise ValueError(f"must be {low} or more, not {short(str(value))}")
        if value > high:
            raise ValueError(f"must be {high} or less, not {short(str(value))}")
        return value

    return check


def checked_size(text):
    """(width, height) of "1280x720"; else ValueError."""
    match = re.fullmatch(r"([0-9]{1,9})x([0-9]{1,9})", text)
    size = tuple(map(int, match.groups())) if match else (0, 0)
    low, high = PICTURE_SIZES
    if not low <= min(size) <= max(size) <= high:
        allowed = f"WIDTHxHEIGHT, from {low} to {high} pixels each"
        raise ValueError(f"must be {allowed}, not '{short(text)}'")
    return size


def checked_video(path):
    """The path, if its ending is that of a video; else ValueError."""
    if Path(path).suffix.lower() not in RBSDrawing.VIDEO_ENDINGS:
        endings = " or ".join(RBSDrawing.VIDEO_ENDINGS)
        raise ValueError(f"the name of a video must end in {endings}, not '{path}'")
    return path


def checked_path(path):
    """The path, if it is one at all; else ValueError."""
    if not path or "\0" in path:
        raise ValueError("the name of a file or folder must not be empty")
    return path


def checked_rate(value):
    """Pictures a second, if a video can have as many; else ValueError."""
    if not SLOWEST_VIDEO <= value <= FASTEST_VIDEO:
        raise ValueError(f"must lie between {SLOWEST_VIDEO:g} and {FASTEST_VIDEO:g}, not {value:g}")
    return value


# Kinds of option values, each with its message when it is something else.
WHOLE_NUMBER = option_type(plain_int, at_least(0, MOST_STEPS), "whole number")
POSITIVE_NUMBER = option_type(plain_int, at_least(1, MOST_STEPS), "whole number")
PATH = option_type(str, checked_path, "path")


def make_parser():
    """The ArgumentParser of all options; their order is that of --help."""
    parser = OneLineParser(
        prog="RigidBodySimulation.py",
        description="Simulates rigid bodies that fall, collide and bounce, and shows them.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument(
        "scene", metavar="SCENE", nargs="?", type=PATH,
        help=f"a scene file, or the name of a scene of data/ (default: {DEFAULT_SCENE})",
    )  # fmt: skip
    parser.add_argument(
        "--allow-outside-meshes", action="store_true",
        help="read meshes that a scene names by an absolute path, by .. or through a symbolic link "
        "out of its folder too (default: only those in its folder, or below)",
    )  # fmt: skip

    add_physics_options(parser)
    add_constraint_options(parser)
    add_output_options(parser)
    add_recording_options(parser)
    return parser


def add_physics_options(parser):
    physics = parser.add_argument_group("simulation", PHYSICS_EXAMPLES)
    physics.add_argument(
        "--restitution", metavar="E", type=option_type(plain_float, checked_restitution, "number"),
        default=DEFAULT_RESTITUTION,
        help="how much of their closing speed bodies keep in a collision, from 0 to 1 "
        "(default: %(default)s, so that they bounce and come to rest)",
    )  # fmt: skip
    physics.add_argument(
        "--time-step", metavar="H", type=option_type(plain_float, checked_time_step, "number"),
        default=DEFAULT_TIME_STEP,
        help="seconds per step (default: %(default)s)",
    )  # fmt: skip
    physics.add_argument(
        "--friction", metavar="MU", type=option_type(plain_float, checked_friction, "number"),
        default=0.0, help="coefficient of friction between bodies and with the ground "
        "(default: %(default)s)",
    )  # fmt: skip
    physics.add_argument(
        "--closing-only", action="store_true",
        help="leave contacts alone that already separate (default: they receive an impulse too, "
        "as in the coursework)",
    )  # fmt: skip

    physics.add_argument(
        "--broad-phase", metavar="NAME", choices=BROAD_PHASES, default="all",
        help="all: every pair in turn; grid: the same motion to the last bit, found through a "
        "uniform grid, for hundreds of bodies (default: %(default)s)",
    )  # fmt: skip
    physics.add_argument(
        "--pair-order", metavar="NAME", choices=PAIR_ORDERS, default="sequential",
        help="sequential: pairs of bodies as in the coursework, the first with all others, then "
        "the second; coloured: in as few rounds of disjoint pairs as a greedy colouring finds, "
        "which ends elsewhere, up to a tenth faster or slower (default: %(default)s)",
    )  # fmt: skip


def add_constraint_options(parser):
    ties = parser.add_argument_group("constraints", CONSTRAINT_EXAMPLES)
    source = ties.add_mutually_exclusive_group()
    source.add_argument(
        "--constraints", metavar="FILE", type=PATH,
        help="what ties the bodies together (default: NAME-constraints.txt beside NAME-scene.txt, "
        "if there is one)",
    )  # fmt: skip
    source.add_argument(
        "--no-constraints", action="store_true", help="let all bodies go free",
    )  # fmt: skip
    ties.add_argument(
        "--max-iterations", metavar="N", type=WHOLE_NUMBER,
        help=f"constraint visits in a step at most, but at least one of each (default: {SWEEPS} of "
        f"each, and at least {LEAST_VISITS})",
    )  # fmt: skip
    ties.add_argument(
        "--scheduling", metavar="NAME", choices=CONSTRAINT_SCHEDULINGS, default="sweep",
        help="sweep: in order, over and over; queue: the same result with fewer visits; batches: "
        "in another order, many at once, for hundreds of constraints (default: %(default)s)",
    )  # fmt: skip


def add_output_options(parser):
    output = parser.add_argument_group("without a window", OUTPUT_EXAMPLES)
    output.add_argument(
        "--headless", action="store_true",
        help="simulate without a window and print a summary; needs no display and no OpenGL",
    )  # fmt: skip
    output.add_argument(
        "--steps", metavar="N", type=WHOLE_NUMBER,
        help=f"how many steps a run without a window has (default: {DEFAULT_STEPS}, or all that "
        "are recorded)",
    )  # fmt: skip
    output.add_argument(
        "--screenshots", metavar="DIR", type=PATH,
        help="draw off-screen into DIR/frame_<step>.png; no window opens",
    )  # fmt: skip
    output.add_argument(
        "--video", metavar="FILE", type=option_type(str, checked_video, "path"),
        help="draw off-screen into a video, .mp4 or .gif; no window opens",
    )  # fmt: skip
    output.add_argument(
        "--every", metavar="K", type=POSITIVE_NUMBER,
        help=f"one picture each K steps (default: {DEFAULT_EVERY} for --screenshots; for --video, "
        "so that it plays in real time)",
    )  # fmt: skip
    output.add_argument(
        "--fps", metavar="R", type=option_type(plain_float, checked_rate, "number"),
        help=f"pictures a second in a video (default: near {RBSDrawing.VIDEO_RATE:g}, so that it "
        "plays in real time)",
    )  # fmt: skip
    look = parser.add_argument_group("picture")
    look.add_argument(
        "--size", metavar="WxH", type=option_type(str, checked_size, "size"),
        default=RBSDrawing.PICTURE_SIZE, help="in pixels, also of the window (default: "
        f"{'x'.join(map(str, RBSDrawing.PICTURE_SIZE))})",
    )  # fmt: skip
    look.add_argument(
        "--camera", metavar="FILE.json", type=PATH,
        help="where to look from, as saved from the window (default: all of the scene is seen)",
    )  # fmt: skip
    look.add_argument(
        "--colours", metavar="NAME", choices=RBSDrawing.COLOURINGS, default="density",
        help=f"what bodies are coloured by: {', '.join(RBSDrawing.COLOURINGS)} "
        "(default: %(default)s)",
    )  # fmt: skip
    look.add_argument(
        "--show", metavar="NAME", choices=RBSDrawing.OVERLAYS, action="extend", nargs="+",
        help=f"what is drawn over them: {', '.join(RBSDrawing.OVERLAYS)}",
    )  # fmt: skip
    look.add_argument(
        "--transparent", action="store_true",
        help="with --screenshots: no background and no ground, only bodies and their shadows",
    )  # fmt: skip


def add_recording_options(parser):
    recordings = parser.add_argument_group("recordings", RECORDING_EXAMPLES)
    recordings.add_argument(
        "--record", metavar="FILE.npz", type=PATH,
        help="write the state after every step, and the starting state; no window opens. What a "
        "crash leaves is in FILE.npz.part, and is found there by the options below",
    )  # fmt: skip
    source = recordings.add_mutually_exclusive_group()
    source.add_argument(
        "--replay", metavar="FILE.npz", type=PATH,
        help="show a recording, simulating nothing. SCENE and --constraints say where its files "
        "are now, if they have moved; so they do with --resume and --verify",
    )  # fmt: skip
    source.add_argument(
        "--resume", metavar="FILE.npz", type=PATH,
        help="go on from a recorded state, with the settings of the recording and those that are "
        "given as options",
    )  # fmt: skip
    source.add_argument(
        "--verify", metavar="FILE.npz", type=PATH,
        help="simulate once more and compare every state to the last bit; exit code 1, and the "
        "first step that differs, where they are not the same",
    )  # fmt: skip
    recordings.add_argument(
        "--finish", metavar="FILE.npz", type=PATH,
        help="make a recording of what a run that was killed has left in FILE.npz.part, and remove "
        "that folder",
    )  # fmt: skip
    recordings.add_argument(
        "--from", dest="from_step", metavar="STEP", type=WHOLE_NUMBER,
        help="with --resume, the step to go on from (default: the last one)",
    )  # fmt: skip
    recordings.add_argument(
        "--stats", metavar="FILE.csv", type=PATH,
        help="write energies, momenta, contacts, violations and times of every step; no window "
        "opens",
    )  # fmt: skip
    recordings.add_argument(
        "--plot", metavar="FILE.png", type=PATH,
        help="draw the same numbers over time; needs matplotlib; no window opens",
    )  # fmt: skip


def print_error(message):
    """Tells what is wrong, or worth knowing, in one line on stderr."""
    print(f"RigidBodySimulation.py: {one_line(message)}", file=sys.stderr)


def main(arguments=None):
    """Runs the command line.

    returns the exit code: 0, 1 where --verify finds a difference, 2 for bad input, 3 where the
    numbers of a run go wrong, 130 after Ctrl-C
    """
    parser = make_parser()
    options = parser.parse_args(arguments)
    given = given_options(arguments)
    with warnings.catch_warnings():
        warnings.simplefilter("always", NonConvexWarning)
        warnings.showwarning = lambda message, *where: print_error(f"warning: {message}")
        if hasattr(sys.stdout, "reconfigure"):  # a name may hold what the terminal has no sign for
            sys.stdout.reconfigure(errors="backslashreplace")
        try:
            check_options(parser, options, given)
            code = run_asked_mode(options, given)
            if sys.stdout is not None:  # it was closed before the start
                sys.stdout.flush()
            return code
        except (SceneError, RecordingError, RBSDrawing.DrawingError, ImportError) as error:
            print_error(with_what_is_kept(error, error))
        except OSError as error:
            cause = f"{error.filename or 'cannot write'}: {reason_of(error)}"
            print_error(with_what_is_kept(cause, error))
            discard_output()
        except MemoryError as error:
            print_error(with_what_is_kept("there is not enough memory", error))
        except KeyboardInterrupt as error:
            print_error(with_what_is_kept("stopped by Ctrl-C", error))
            return 130
    return 2


def run_asked_mode(options, given):
    """What the command line asks for; returns the exit code."""
    if options.finish is not None:
        return finish_as_asked(options)
    if options.verify is not None:
        return verify_as_asked(options)
    simulation = simulation_of(options, given)
    look = look_of(options)
    if given & WITHOUT_WINDOW:
        return run_as_asked(simulation, options, look)
    return open_window_or_fall_back(simulation, options, look)


def with_what_is_kept(message, error):
    """The message, and where to find what there is of the run that the error has ended."""
    kept = getattr(error, "keptPaths", ())
    return f"{message}; what there is of the run is in {' and '.join(kept)}" if kept else message


def discard_output():
    """Drops what standard output could not take: at its end, Python would try, and fail, again."""
    if sys.stdout is None:
        return
    try:
        sys.stdout.flush()
    except OSError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


# Options by what they are for, under the names that argparse gives them. First those that change
# the settings, each with the field that it changes.
SETTING_FIELDS = {
    "restitution": "restitution",
    "time_step": "timeStep",
    "closing_only": "closingOnly",
    "friction": "friction",
    "no_constraints": "enforceConstraints",
    "scheduling": "constraintScheduling",
    "max_iterations": "maxIterations",
    "broad_phase": "broadPhase",
    "pair_order": "pairOrder",
}
WITHOUT_WINDOW = frozenset({"headless", "screenshots", "video", "record", "stats", "plot"})
# What does not go with what, and why.
CONFLICTS = {
    "replay": (
        {*SETTING_FIELDS, "record"},
        "a replay simulates nothing; --resume goes on with other settings, and may be recorded",
    ),
    "verify": (
        {*SETTING_FIELDS, "steps", "every"} | WITHOUT_WINDOW - {"headless"},
        "it only compares, and with the settings of the recording",
    ),
    "finish": (
        {*SETTING_FIELDS, "scene", "constraints", "replay", "resume", "verify", "steps", "camera"}
        | WITHOUT_WINDOW - {"headless"},
        "it only makes one file of the chunks",
    ),
    "video": ({"transparent"}, "videos have no transparency"),
}
# What makes no sense without another option.
COMPANIONS = {
    "every": (
        {"screenshots", "video"},
        "says how often --screenshots or --video draws, which is missing",
    ),
    "fps": ({"video"}, "says how fast --video plays, which is missing"),
    "transparent": ({"screenshots"}, "says how --screenshots draws, which is missing"),
    "from_step": ({"resume"}, "says where --resume starts, which is missing"),
}


def option_name(dest):
    """How an option is written on the command line."""
    names = {"from_step": "--from", "scene": "SCENE"}
    return names.get(dest, "--" + dest.replace("_", "-"))


def given_options(arguments):
    """The set of the options that the command line has, and not only by their defaults."""
    parser = make_parser()
    parser.set_defaults(**dict.fromkeys(vars(parser.parse_args([]))))
    return {name for name, value in vars(parser.parse_args(arguments)).items() if value is not None}


def check_options(parser, options, given):
    """Ends the program with one line where the given options do not go together."""
    named = {}
    # What is read comes first. It may be read twice, but not be written over.
    inputs = ("scene", "constraints", "camera", "replay", "resume")
    for dest in (*inputs, "record", "stats", "plot", "video"):
        path = getattr(options, dest)
        other = named.setdefault(path and os.path.realpath(path), dest)
        if path is not None and other != dest and dest not in inputs:
            parser.error(f"{option_name(dest)} and {option_name(other)} name the same file")
    for dest, (companions, cause) in COMPANIONS.items():
        if dest in given and not given & companions:
            parser.error(f"{option_name(dest)} {cause}")
    for mode, (others, cause) in CONFLICTS.items():
        for dest in sorted(given & others if mode in given else ()):
            parser.error(f"{option_name(dest)} does not go with {option_name(mode)}: {cause}")


def simulation_of(options, given):
    """The Simulation, or Replay, that the command line asks for."""
    if options.replay is not None:
        recording = open_recording(options.replay)
        return Replay(recording, load_recorded_scene(recording, options))
    if options.resume is not None:
        recording = open_recording(options.resume)
        simulation = load_recorded_scene(recording, options)
        step = recording.lastStep if options.from_step is None else options.from_step
        resume(recording, step, simulation)
        asked = settings_of(options)
        fields = {SETTING_FIELDS[name] for name in given & set(SETTING_FIELDS)}
        changes = {field: getattr(asked, field) for field in fields}
        simulation.settings = replace(simulation.settings, **changes)
        return simulation
    scenePath = find_scene(DEFAULT_SCENE if options.scene is None else options.scene)
    return Simulation(
        scenePath, settings_of(options), options.constraints,
        allowOutsideMeshes=options.allow_outside_meshes,
    )  # fmt: skip


def finish_as_asked(options):
    """--finish; returns the exit code, 0."""
    path, first, last = finish(options.finish)
    print(f"{shown_path(path)}: the steps {first} to {last}, of an interrupted recording")
    return 0


def verify_as_asked(options):
    """--verify; returns the exit code, 0 or 1."""
    recording = open_recording(options.verify, mustBeFinite=False)
    simulation = load_recorded_scene(recording, options)
    progress = Progress(recording.lastStep - recording.firstStep)
    try:
        wrong = verify(recording, simulation, progress.advance)
    finally:
        progress.close()
    path = shown_path(recording.path)
    if not wrong:
        print(f"{path}: the steps {recording.firstStep} to {recording.lastStep} are the same")
        return 0
    if recording.numpyVersion != np.__version__:
        wrong += f" (recorded with NumPy {recording.numpyVersion}, this is {np.__version__})"
    print_error(f"{path}: {wrong}")
    return 1


def open_recording(path, mustBeFinite=True):
    """The Recording; says so in one line where it is one that was interrupted."""
    recording = Recording(path, mustBeFinite)
    if recording.wasInterrupted:
        print_error(
            f"{shown_path(recording.path)}: an interrupted recording, of the steps "
            f"{recording.firstStep} to {recording.lastStep}"
        )
    return recording


def load_recorded_scene(recording, options):
    """The Simulation of a recording's scene, at the scene's start.

    options.scene and options.constraints : where the files are now, or None for where they were
    raises SceneError, or RecordingError when the bodies are not those of the recording
    """
    if options.scene is not None:
        scenePath = find_scene(options.scene)
    else:
        scenePath = find_recorded_file(recording, recording.scene, "SCENE")
    constraintPath = options.constraints
    if constraintPath is None and recording.constraints:
        constraintPath = find_recorded_file(recording, recording.constraints, "--constraints")
    simulation = Simulation(
        scenePath, constraintPath=constraintPath, allowOutsideMeshes=options.allow_outside_meshes
    )
    if constraintPath is None:  # the scene had none then, whatever lies beside it now
        simulation.constraints, simulation.constraintPath = [], None
    check_bodies(recording, simulation)
    return simulation


def find_recorded_file(recording, name, option):
    """The path of a file that a recording names; `option` is how the caller could give it.

    It may stand where the recording says, seen from the current folder or from the recording's;
    or, under its own name, beside the recording or in data/.
    """
    if not os.path.isfile(name):
        name = name.replace("\\", "/")  # recorded on Windows
    folder, ownName = recording.path.parent, Path(name).name
    for path in (Path(name), folder / name, folder / ownName, DATA_FOLDER / ownName):
        if os.path.isfile(path):
            return path
    raise recording.error(f"its file {name} is not there any more; say with {option} where it is")


def settings_of(options):
    """The `Settings` that the command line's options ask for."""
    return Settings(
        restitution=options.restitution,
        timeStep=options.time_step,
        closingOnly=options.closing_only,
        friction=options.friction,
        enforceConstraints=not options.no_constraints,
        constraintScheduling=options.scheduling,
        maxIterations=options.max_iterations,
        broadPhase=options.broad_phase,
        pairOrder=options.pair_order,
    )


def look_of(options):
    """The `RBSDrawing.Look` that the command line asks for; raises DrawingError."""
    camera = None if options.camera is None else RBSDrawing.load_camera(options.camera)
    return RBSDrawing.Look(
        options.size, camera, options.transparent, options.colours, tuple(options.show or ())
    )


def run_as_asked(simulation, options, look):
    """A run without a window, with what is to be written of it; returns the exit code."""
    recorder = stats = pictures = video = None
    steps = steps_of(simulation, options)
    if options.video is not None:
        timing = RBSDrawing.video_timing(simulation.settings.timeStep, options.fps, options.every)
        if not SLOWEST_VIDEO <= timing[0] <= FASTEST_ENCODER:
            raise RBSDrawing.DrawingError(
                f"{options.video}: in real time there would be {timing[0]:.3g} pictures a second; "
                "say with --fps how many there shall be"
            )
    try:
        if options.record is not None:
            recorder = Recorder(options.record)
        if options.stats is not None or options.plot is not None:
            stats = StatsWriter(options.stats, options.plot)
        if options.screenshots is not None or options.video is not None:
            backend = RBSDrawing.find_backend(window=False)
            if backend.name is None:
                print_error(f"no pictures can be drawn: {backend.reason}. {backend.remedy}")
                return 2
            view = RBSDrawing.start_look(simulation, backend, look)
        if options.screenshots is not None:
            first = simulation.stepCount
            drawn = range(first, first + steps + 1, options.every or DEFAULT_EVERY)
            pictures = RBSDrawing.PictureSeries(
                options.screenshots, drawn, view, look.isTransparent
            )  # fmt: skip
        if options.video is not None:
            video = RBSDrawing.Video(options.video, view, *timing)
        return run_without_window(simulation, steps, recorder, stats, pictures, video)
    except BaseException as error:
        kept = close_all(recorder, stats, video)
        error.keptPaths = [str(shown_path(path)) for path in kept if path is not None]
        raise
    finally:
        close_all(recorder, stats, video)


def close_all(*writers):
    """Closes those that are not None; returns the paths of what they keep, or None of each."""
    return [writer.close() for writer in writers if writer is not None]


def open_window_or_fall_back(simulation, options, look):
    """The window; without a display, pictures; without OpenGL, only the simulation.

    returns the exit code
    """
    backend = RBSDrawing.find_backend(window=True)
    if backend.opensWindow:
        open_here = partial(open_file, allowOutsideMeshes=options.allow_outside_meshes)
        RBSViewer.show_window(simulation, backend, open_here, list_files, step_quantities, look)
        return 0
    pictures = None
    if backend.name is None:
        print_error(f"no window and no pictures: {backend.reason}. {backend.remedy}")
    else:
        folder = Path("out") / scene_name(simulation.scenePath)
        print_error(f"no window: {backend.reason}. Drawing off-screen into {folder}")
        first, last = simulation.stepCount, simulation.stepCount + steps_of(simulation, options)
        steps = np.linspace(first, last, FALLBACK_PICTURES).round().astype(int).tolist()
        view = RBSDrawing.start_look(simulation, backend, look)
        pictures = RBSDrawing.PictureSeries(folder, steps, view)
    return run_without_window(simulation, steps_of(simulation, options), pictures=pictures)


def open_file(path, settings, allowOutsideMeshes=False):
    """The Simulation of a scene file, or the Replay of a recording (.npz), for the window.

    settings : a scene's; None for the usual ones; allowOutsideMeshes : see `load_scene_file`
    raises SceneError or RecordingError
    """
    if path.suffix == RECORDING_ENDING:
        recording = Recording(path)
        whereItWas = argparse.Namespace(
            scene=None, constraints=None, allow_outside_meshes=allowOutsideMeshes
        )
        return Replay(recording, load_recorded_scene(recording, whereItWas))
    return Simulation(path, settings, allowOutsideMeshes=allowOutsideMeshes)


def list_files(folder):
    """Scenes and recordings in a folder: dict of what a person calls them, and their paths."""
    recordings = sorted(Path(folder).glob(f"*{RECORDING_ENDING}"))
    return {scene_name(path): path for path in list_scenes(folder)} | {
        path.name: path for path in recordings
    }


def steps_of(simulation, options):
    """How many steps a run without a window makes: of a replay, no more than were recorded."""
    if isinstance(simulation, Replay):
        left = simulation.lastStep - simulation.stepCount
        return left if options.steps is None else min(left, options.steps)
    return DEFAULT_STEPS if options.steps is None else options.steps


if __name__ == "__main__":
    sys.exit(main())
