"""Scene and constraint files: finding and reading them.

Units: metres, kilograms, seconds. The y axis points up.
"""

import json
import math
import os
import re
import warnings
from dataclasses import dataclass, field
from numbers import Real
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from rbs.geometry.triples import floats
from rbs.scenes.files import RECORDING_ENDINGS, LineReader, SceneError, check_path, read_text
from rbs.scenes.meshfiles import LARGEST_IN_FILE, MESH_ENDINGS, load_mesh_file, warn_of_shape
from rbs.scenes.messages import PROGRAM_NAME, check_kind, did_you_mean, measured, short
from rbs.scenes.state import inertias_of, set_inertia
from rbs.stepping.constraints import constraint_table
from rbs.stepping.meshes import STATE_WIDTHS
from RBSFunctions import Mesh

# The project's scenes and meshes: inside an installed package, beside the package in a checkout.
_PACKAGE = Path(__file__).resolve().parents[1]
DATA_FOLDER = next(filter(Path.is_dir, [_PACKAGE / "data"]), _PACKAGE.parent / "data")

# The end of a mesh file's name, before the separator.
_NAME_END = re.compile(f"(?:{'|'.join(map(re.escape, MESH_ENDINGS))})(?=[\\s,])", re.IGNORECASE)

SCENE_ENDING = "-scene.txt"
CONSTRAINTS_ENDING = "-constraints.txt"
# What follows the name of a mesh file in a scene, before the metres per unit.
SCALE = " scale="
# kg/m³. Larger ones are refused, before masses overflow. A neutron star has less than 1e19.
LARGEST_DENSITY = 1e30
# kg, m. A larger body hardly seems to fall: in the first second it covers less than a hundredth of
# its size. Its file is probably in millimetres.
HUGE_MASS, HUGE_SIZE = 1e8, 490.0


def load_scene_file(path: str | Path) -> list[Mesh]:
    """Reads a scene: the number of bodies, then `meshfile density isFixed x y z qw qx qy qz` each.

    Mesh files are looked up beside the scene file. Their names may contain blanks, and `\\`
    separates folders as `/` does. `scale=0.001` after a name means that the file is in millimetres.
    A body is named after its mesh file and its index, such as "box 3"; constraints refer to this
    index. Warns of a mesh that is not convex, or so large that its file may be in millimetres.

    Raises SceneError, with file and line, if a file is missing or malformed.
    """
    return _make_bodies(LineReader(path, fields_of), {})


def _make_bodies(reader, shapes):
    """Returns the list of Mesh of a scene's lines.

    shapes : dict from mesh file names to results of `load_mesh_file`; missing ones are added
    """
    meshes = []
    for fileName, density, isFixed, position, orientation in _rows(reader):
        path, _, scale = fileName.partition(SCALE)
        if isNew := fileName not in shapes:
            file = Path(reader.path).parent / path
            if not os.path.exists(file):
                known = sorted(one.name for one in file.parent.glob("*") if is_mesh(one.name))
                meant = did_you_mean(file.name, known)
                raise reader.error(f"no mesh file '{short(path)}' beside the scene{meant}")
            if not is_mesh(path):
                raise reader.error(f"'{short(path)}' does not have the ending of a mesh file")
            try:
                vertices, faces, tets = load_mesh_file(file)
            except SceneError as error:
                error.args = (f"{error}; named in {reader.path}:{reader.lineNumber}",)
                raise
            shapes[fileName] = vertices * float(scale or 1.0), faces, tets
        orientation /= math.hypot(*orientation[0].tolist())
        name, pose = f"{Path(path).stem} {len(meshes)}", (position, orientation)
        try:
            meshes.append(Mesh(name, *shapes[fileName], density, *pose, isFixed))
        except (ValueError, ZeroDivisionError) as error:
            raise reader.error(f"invalid body: {error}") from None
        if isNew:
            _warn_of_shape(fileName, meshes[-1], stacklevel=3)
    return meshes


def scene_rows(path, text=None):
    """Returns the rows of a scene file, one for each body. Raises SceneError.

    A row is (mesh file, density, isFixed, position (1, 3), orientation (1, 4)), with the numbers of
    the file: the quaternion is not normalised, and " scale=0.001" belongs to the mesh file.
    text : content of the file, or None to read it
    """
    return list(_rows(LineReader(path, fields_of, text)))


def _rows(reader):
    """Yields the rows of `scene_rows`.

    `\\` in a mesh file's name is replaced by `/`, so that a scene means the same on every system.
    Warns of Young's modulus and Poisson's ratio after the density, which are left out.
    """
    what, softLine = "not a scene: the number of bodies", None
    count = reader.integer(*reader.row(what, columns=1), what, low=1)
    for index in range(count):
        what = f"body {index + 1} of {count}"
        fields = reader.row(what)
        name = fields[0].replace("\\", "/")
        if fields[1:] and fields[1].startswith(SCALE.strip()):
            scale = reader.number(fields.pop(1)[len(SCALE) - 1 :], "the scale", LARGEST_IN_FILE)
            if scale <= 0.0:
                raise reader.error(f"the scale must be positive, not {scale:g}")
            name += f"{SCALE}{scale!r}"
        if len(fields) == 12:  # of a soft body
            reader.numbers(fields[2:4], "Young's modulus or Poisson's ratio")
            del fields[2:4]
            softLine = softLine or reader.lineNumber
        if len(fields) != 10:
            raise reader.wrong_width(what, 10, fields)
        density = reader.number(fields[1], "the density", LARGEST_DENSITY)
        if density <= 0.0:
            raise reader.error(f"the density must be positive, not {fields[1]}")
        isFixed = bool(reader.integer(fields[2], "isFixed", 0, 1))
        position = reader.numbers(fields[3:6], "a coordinate", LARGEST_IN_FILE)
        orientation = reader.numbers(fields[6:], "the quaternion", LARGEST_IN_FILE)
        if not math.hypot(*orientation):
            raise reader.error("the quaternion must not be zero")
        yield name, density, isFixed, np.array([position]), np.array([orientation])
    reader.expect_end(count, "body")
    if softLine:
        cause = "Young's modulus and Poisson's ratio are ignored, because bodies are rigid"
        warnings.warn(f"{reader.path}:{softLine}: {cause}", stacklevel=2)


def load_body(
    path: str | Path,
    density: float,
    position: ArrayLike | None = None,
    orientation: ArrayLike = (1.0, 0.0, 0.0, 0.0),
    isFixed: bool = False,
    scale: float = 1.0,
) -> Mesh:
    """Reads a mesh file, see `load_mesh_file`; returns the Mesh, named after the file.

    density : kg/m³; position : (3,), of the COM; None leaves the body where the file has it
    scale : metres per unit of the file, 0.001 for millimetres

    Warns as `load_scene_file` does. Raises SceneError, or ValueError as `Mesh` does.
    """
    check_path(path, "a mesh file")
    if not isinstance(scale, Real) or not 0 < scale < math.inf:
        raise ValueError(f"scale must be a positive, finite number, not {scale!r}")
    vertices, faces, tets = load_mesh_file(path)
    vertices *= scale
    pose = (0.0, 0.0, 0.0) if position is None else position, orientation
    mesh = Mesh(Path(path).stem, vertices, faces, tets, density, *pose, isFixed)
    if position is None:
        mesh.position = vertices[:1] - mesh.origVertices[:1]
    _warn_of_shape(Path(path).name, mesh, stacklevel=2)
    return mesh


def load_constraint_file(path: str | Path, meshes: list[Mesh]) -> list[list]:
    """Reads distance constraints: their number, then `m1 v1 m2 v2 lower upper` each.

    The distance between vertex v1 of mesh m1 and vertex v2 of mesh m2, counted from 0, stays
    between `lower` and `upper` times its present value, by currVertices.

    Returns rows [m1, v1, m2, v2, refValue, upper], two per line, the lower bound first; refValue in
    metres, upper a bool. Raises SceneError.
    """
    return _make_constraints(LineReader(path, fields_of), meshes)


def _make_constraints(reader, meshes):
    what, constraints = "the number of constraints", []
    lineCount = reader.integer(*reader.row(what, columns=1), what)
    for index in range(lineCount):
        row, ends = reader.row(f"constraint {index + 1} of {lineCount}", columns=6), []
        for mesh, vertex in (row[:2], row[2:4]):
            ends.append(reader.integer(mesh, "the number of a body", 0, len(meshes) - 1))
            last = len(meshes[ends[-1]].currVertices) - 1
            ends.append(reader.integer(vertex, "the number of a vertex", 0, last))
        m1, v1, m2, v2 = ends
        if m1 == m2:
            raise reader.error(f"body {m1} cannot be linked to itself")
        lower, upper = reader.numbers(row[4:], "a bound")
        if not 0.0 <= lower <= upper:
            raise reader.error(f"the bounds must be 0 ≤ lower ≤ upper, not {row[4]} and {row[5]}")
        distance = math.dist(meshes[m1].currVertices[v1], meshes[m2].currVertices[v2])
        if upper * distance == math.inf:
            raise reader.error(f"the upper bound {row[5]} is out of range")
        constraints += [*ends, lower * distance, False], [*ends, upper * distance, True]
    reader.expect_end(lineCount, "constraint")
    return constraints


@dataclass
class SceneSource:
    """The contents of a scene's files, from which the scene can be made again without them.

    path, constraintPath : paths of the files; constraintPath is None if there are no constraints
    scene, constraints : texts of these files, or ""
    shapes : dict from mesh files, as in `scene_rows`, to (vertices, faces, tets) in metres; `make`
        reads missing ones
    """

    path: Path
    scene: str
    constraintPath: Path | None = None
    constraints: str = ""
    shapes: dict = field(default_factory=dict)

    @classmethod
    def of_files(cls, scenePath, constraintPath=None):
        """Reads the texts. Raises SceneError.

        constraintPath : by default NAME-constraints.txt of NAME-scene.txt, if it exists
        """
        source = cls(Path(scenePath), read_text(scenePath))
        if path := constraintPath or find_constraints(scenePath):
            source.constraintPath, source.constraints = Path(path), read_text(path)
        return source

    def make(self):
        """Returns (list of Mesh, list of constraints). Raises SceneError."""
        reader = LineReader(self.path, fields_of, self.scene)
        meshes = _make_bodies(reader, self.shapes)
        if self.constraintPath is None:
            return meshes, []
        reader = LineReader(self.constraintPath, fields_of, self.constraints)
        return meshes, _make_constraints(reader, meshes)

    def files(self):
        """Returns the paths of all files that were read."""
        meshes = [self.path.parent / name.partition(SCALE)[0] for name in self.shapes]
        return [self.path, *filter(None, [self.constraintPath]), *meshes]


class BodySource(SceneSource):
    """Meshes and constraints as a scene without files: its text is JSON, exact to the bit."""

    @classmethod
    def of_meshes(cls, meshes, constraints=(), name="scene"):
        """Keeps copies; raises TypeError or ValueError, which says what cannot be used."""
        kinds, what = list | tuple | np.ndarray, "a list of rows (see settings=)"
        check_kind("constraints", constraints, kinds, what)
        shapes, names, bodies = {}, {}, []
        for b, mesh in enumerate(meshes):
            check_kind(f"meshes[{b}]", mesh, Mesh, "a Mesh")
            check_shape(f"meshes[{b}]", mesh)
            arrays = mesh.origVertices.copy(), mesh.faces.copy(), mesh.tets.copy()
            shape = names.setdefault(tuple(map(bytes, arrays)), str(len(names)))
            shapes.setdefault(shape, arrays)
            row = {"name": str(mesh.name), "shape": shape, "density": mesh.density}
            row |= {"isFixed": mesh.isFixed, "load": mesh.load}
            row["inertia"] = inertias_of([mesh])[0].tolist()
            row |= {state: floats(getattr(mesh, state), n) for state, n in STATE_WIDTHS.items()}
            bodies.append(row)
        table = constraint_table(constraints, meshes).T.tolist()
        rows = [[*map(int, row[:4]), row[4], bool(row[5])] for row in table]
        text = json.dumps({"bodies": bodies, "constraints": rows})
        return cls(Path(str(name)), text, shapes=shapes)

    def make(self):
        """Returns (list of Mesh, list of constraints)."""
        content, meshes = json.loads(self.scene), []
        for row in content["bodies"]:
            shape = self.shapes[row["shape"]]
            state = row["density"], row["position"], row["orientation"], row["isFixed"]
            mesh = Mesh(row["name"], *shape, *state)
            if "inertia" in row:  # unless an earlier version recorded it
                set_inertia(mesh, row["inertia"])
            if row["load"] is not None:
                mesh.set_force(*row["load"])
            for name in ("linVelocity", "angVelocity"):
                setattr(mesh, name, np.reshape(row[name], (1, 3)).astype(np.float64))
            meshes.append(mesh)
        return meshes, [[*row[:5], bool(row[5])] for row in content["constraints"]]

    def files(self):
        """Returns no paths, because no file was read."""
        return []


def check_shape(name, mesh):
    """Raises ValueError, naming an argument, if a Mesh has no shape, as the ground."""
    if len(mesh.origVertices) == 0:
        raise ValueError(f"{name}, {mesh.name!r}, has no vertices; a run has its ground already")


def find_scene(text, folder=None):
    """Returns the path of a scene, or of another file, from what a user typed.

    text : a path from the current folder, or from `folder`, with `~` for home; or the name of a
        scene in `folder` or in data/; tried in this order

    Raises SceneError, naming similar scenes in data/, if nothing is found.
    """
    path = Path(os.path.expanduser(text))
    if folder is None and is_recording(path):
        remedy = "--replay shows it, and Simulation.open opens it in Python"
        raise SceneError(text, None, f"a recording, not a scene; {remedy}")
    places = [path]
    if folder is not None:
        places += [Path(folder) / path, Path(folder) / f"{path}{SCENE_ENDING}"]
    if path.name == str(text):
        places.append(DATA_FOLDER / f"{path}{SCENE_ENDING}")
    for place in places:  # a folder must not hide a scene of its name
        if os.path.isfile(place):
            return place
    if os.path.exists(path):  # path.exists() may raise
        return path
    known = [scene_name(scene) for scene in list_scenes(DATA_FOLDER)]
    remedy = did_you_mean(str(text).lower(), known) or f"; {PROGRAM_NAME} --help lists the scenes"
    raise SceneError(text, None, f"no such scene or file{remedy}")


def list_scenes(folder):
    """Returns the sorted paths of all scenes in a folder."""
    return sorted(filter(Path.is_file, Path(folder).glob(f"*{SCENE_ENDING}")))


def find_constraints(scenePath):
    """Returns the path NAME-constraints.txt for NAME-scene.txt, or None if it does not exist."""
    path = Path(scenePath).with_name(scene_name(scenePath) + CONSTRAINTS_ENDING)
    return path if os.path.exists(path) else None


def is_mesh(name):
    """Returns whether the name of a file has the ending of a mesh file."""
    return name.lower().endswith(MESH_ENDINGS)


def is_recording(path):
    """Returns whether the name of a file has the ending of a recording."""
    return Path(path).suffix.lower() in RECORDING_ENDINGS


def scene_name(path):
    """Returns the name of a scene: its file's name without the ending."""
    name = Path(path).name
    return name[: -len(SCENE_ENDING)] if name.endswith(SCENE_ENDING) else Path(path).stem


def _warn_of_shape(name, mesh, stacklevel):
    """Warns if a mesh is not convex, or so large that its file may be in millimetres."""
    warn_of_shape(name, mesh, stacklevel + 1)
    size = np.ptp(mesh.origVertices, axis=0).max()
    if not mesh.isFixed and (mesh.mass > HUGE_MASS or size > HUGE_SIZE):
        mass = measured(mesh.mass / 1e3, "t")
        cause = f"{name} is {size:.3g} m long, has {mass} and will seem to fall slowly"
        remedy = "if its file is in millimetres, scale=0.001 in the scene or in load_body helps"
        warnings.warn(f"{cause}; {remedy}", stacklevel=stacklevel + 1)


def fields_of(line):
    """Splits a line into a list of str, without the comment after `#`.

    Commas count as blanks, as the coursework's text uses them between numbers. The name of a mesh
    file is one field, with its blanks and commas, because its ending marks where it ends.
    """
    line = line.split("#", 1)[0]
    end = max((match.end() for match in _NAME_END.finditer(line)), default=0)
    return [line[:end].strip()] * (end > 0) + line[end:].replace(",", " ").split()
