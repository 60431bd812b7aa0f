"""Scene and constraint files: where they are, and what is in them.

From the top: loading a scene and its constraints; what a scene is made from, so that a recording
can hold it; finding files by name; the parts of a scene's lines.

Units: metres, kilograms, seconds. The y axis points up.
"""

import json
import math
import os
import re
import warnings
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from rbs.geometry.triples import floats
from rbs.scenes.meshfiles import LARGEST_COORDINATE, load_mesh_file
from rbs.scenes.messages import short
from rbs.scenes.textfiles import LineReader, SceneError, read_text
from rbs.stepping.bodies import STATE_WIDTHS
from rbs.stepping.constraints import constraint_rows
from RBSFunctions import Mesh

# Our own scenes and meshes: within the package where it is installed, else beside it, as in a
# checkout. An installed package has other packages' folders beside it.
_PACKAGE = Path(__file__).resolve().parents[1]
DATA_FOLDER = next(filter(Path.is_dir, [_PACKAGE / "data"]), _PACKAGE.parent / "data")

# The end of a mesh file's name, with what separates it from the numbers behind it.
_NAME_END = re.compile(r"\.(?:mesh|off)(?=[\s,])", re.IGNORECASE)

# A comment line that suggests settings: "# suggests friction 0.5".
_SUGGESTION = re.compile(r"\s*#+\s*suggests\s+(.*)")
SCENE_ENDING = "-scene.txt"
CONSTRAINTS_ENDING = "-constraints.txt"
# kg/m³: a neutron star has less than 1e19, and masses are still far from overflowing.
LARGEST_DENSITY = 1e30
# A mesh counts as convex while its hull is larger than itself by no more than this fraction.
# Coordinates that were written with four decimals make about 1e-5; what a smaller tolerance would
# report nobody could see, and a dent of 1e-4 shifts a contact by far less than a body's size.
CONVEXITY_TOLERANCE = 1e-4


class NonConvexWarning(UserWarning):
    """A mesh that collides as its convex hull, which is larger than the mesh itself."""


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
    return _make_bodies(LineReader(path, fields_of), {}, allowOutsideMeshes)


def _make_bodies(reader, shapes, allowOutsideMeshes=False):
    """The list of Mesh of a scene's lines.

    shapes : dict of what `load_mesh_file` returns, by the names of the mesh files; those that are
        missing are read, and added
    """
    bodyCount = reader.count("bodies", low=1, kind="a scene")
    seen = set()
    meshes = []
    for index, row in enumerate(reader.rows(bodyCount, "body")):
        row = _body_row(reader, row, f"body {index + 1} of {bodyCount}")
        fileName = row[0]
        density = reader.number(row[1], "the density", LARGEST_DENSITY)
        if density <= 0.0:
            raise reader.error(f"the density must be positive, not {row[1]}")
        isFixed = bool(reader.integer(row[2], "isFixed", 0, 1))
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
        if fileName not in shapes:
            shapes[fileName] = _load_mesh_beside(reader, fileName, allowOutsideMeshes)
        name = f"{Path(fileName).stem} {index}"
        mesh = _make_body(reader, name, *shapes[fileName], density, position, orientation, isFixed)
        meshes.append(mesh)
        if fileName not in seen:
            seen.add(fileName)
            _warn_unless_convex(fileName, mesh)
    reader.expect_end(f"{bodyCount} bodies")
    return meshes


def load_constraint_file(path, meshes):
    """Reads distance constraints: their number, then `m1 v1 m2 v2 lower upper` each.

    Vertex v1 of mesh m1 and vertex v2 of mesh m2 (counted from 0) stay between `lower` and `upper`
    times the distance that they have now, by their currVertices.

    meshes : list of Mesh
    returns a list of [m1, v1, m2, v2, refValue, upper], two for each line: first the lower bound,
    then the upper one; refValue in metres, upper a bool
    raises SceneError
    """
    return _make_constraints(LineReader(path, fields_of), meshes)


def _make_constraints(reader, meshes):
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


@dataclass
class SceneSource:
    """What a scene is made from: with it, a scene can be made again without its files.

    path, constraintPath : of the files that it was read from; constraintPath is None for none
    scene, constraints : the texts of these files; constraints is "" for none
    shapes : dict of (vertices, faces, tets), as `load_mesh_file` returns them, by the names that
        the scene has for its mesh files; `make` reads those that are missing
    """

    path: Path
    scene: str
    constraintPath: Path | None = None
    constraints: str = ""
    shapes: dict = field(default_factory=dict)

    @classmethod
    def of_files(cls, scenePath, constraintPath=None):
        """Reads the texts; raises SceneError.

        constraintPath : by default, the file that belongs to the scene by its name, if any
        """
        source = cls(Path(scenePath), read_text(scenePath))
        if constraintPath is None:
            source.constraintPath = find_constraints(scenePath)
        else:
            source.constraintPath = Path(constraintPath)
        if source.constraintPath is not None:
            source.constraints = read_text(source.constraintPath)
        return source

    def make(self, allowOutsideMeshes=False):
        """Returns (list of Mesh, list of constraints); raises SceneError."""
        reader = LineReader(self.path, fields_of, self.scene)
        meshes = _make_bodies(reader, self.shapes, allowOutsideMeshes)
        if self.constraintPath is None:
            return meshes, []
        reader = LineReader(self.constraintPath, fields_of, self.constraints)
        return meshes, _make_constraints(reader, meshes)

    def files(self):
        """The paths of all files that it was read from."""
        meshes = [self.path.parent / name for name in self.shapes]
        return [self.path, *filter(None, [self.constraintPath]), *meshes]


class BodySource(SceneSource):
    """Meshes and constraints as a scene without files: its text is JSON, exact to the bit."""

    @classmethod
    def of_meshes(cls, meshes, constraints=(), name="scene"):
        """Keeps copies; raises TypeError or ValueError, which says what cannot be used."""
        if not isinstance(meshes, list | tuple):
            raise TypeError(f"meshes must be a list of Mesh, not {type(meshes).__name__}")
        shapes, names, bodies = {}, {}, []
        for b, mesh in enumerate(meshes):
            if not isinstance(mesh, Mesh):
                raise TypeError(f"meshes[{b}] must be a Mesh, not {type(mesh).__name__}")
            arrays = mesh.origVertices.copy(), mesh.faces.copy(), mesh.tets.copy()
            shape = names.setdefault(tuple(map(bytes, arrays)), str(len(names)))
            shapes.setdefault(shape, arrays)
            row = {"name": mesh.name, "shape": shape, "density": mesh.density}
            row |= {"isFixed": mesh.isFixed}
            row |= {state: floats(getattr(mesh, state), n) for state, n in STATE_WIDTHS.items()}
            bodies.append(row)
        vertexCount = np.array([len(mesh.origVertices) for mesh in meshes], dtype=np.intp)
        rows = constraint_rows(constraints, vertexCount)
        return cls(Path(name), json.dumps({"bodies": bodies, "constraints": rows}), shapes=shapes)

    def make(self, allowOutsideMeshes=False):
        """Returns (list of Mesh, list of constraints)."""
        content, meshes = json.loads(self.scene), []
        for row in content["bodies"]:
            shape = self.shapes[row["shape"]]
            state = row["density"], row["position"], row["orientation"], row["isFixed"]
            mesh = Mesh(row["name"], *shape, *state)
            for name in ("linVelocity", "angVelocity"):
                setattr(mesh, name, np.reshape(row[name], (1, 3)).astype(np.float64))
            meshes.append(mesh)
        return meshes, [[*row[:5], bool(row[5])] for row in content["constraints"]]

    def files(self):
        """No paths."""
        return []


def find_scene(name):
    """The path of a scene: `name` itself if it is one, else data/<name>-scene.txt.

    raises SceneError that names the scenes of data/ whose names are like it when there is neither
    """
    path = Path(name)
    ours = DATA_FOLDER / f"{name}{SCENE_ENDING}"
    isOurs = path.name == str(name) and os.path.exists(ours)
    if isOurs and not os.path.isfile(path):  # a folder of that name does not hide the scene
        return ours
    if os.path.exists(path):  # unlike path.exists(), does not raise where it cannot look
        return path
    known = [scene_name(scene) for scene in list_scenes(DATA_FOLDER)]
    similar = get_close_matches(str(name), known)
    cause = "there is no such scene, neither a file nor one of ours, which --help lists"
    raise SceneError(name, None, cause + f"; similar: {', '.join(similar)}" * bool(similar))


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


def _read_end(reader, meshField, vertexField, meshes):
    """(mesh index, vertex index) of one end of a constraint."""
    mesh = reader.integer(meshField, "a mesh index", 0, len(meshes) - 1)
    vertex = reader.integer(vertexField, "a vertex index", 0, len(meshes[mesh].currVertices) - 1)
    return mesh, vertex


def fields_of(line):
    """The fields of a line, a list of str; what follows a `#` is a comment.

    The coursework's text prints commas between the numbers. They count as blanks, but for those in
    the name of a mesh file.
    """
    line = line.split("#", 1)[0]
    ends = [match.end() for match in _NAME_END.finditer(line)]
    end = ends[-1] if ends else 0
    return line[:end].split() + line[end:].replace(",", " ").split()


def scene_rows(text, count):
    """The bodies of a scene, with the numbers as they stand in its file.

    text : of a scene file that `load_scene_file` has accepted, so that nothing can be wrong with it
    count : how many bodies it has found
    Returns a list of (mesh file, density, isFixed, position (1, 3), orientation (1, 4)).
    """
    lines = [fields for fields in map(fields_of, text.splitlines()) if fields]
    rows = []
    for fields in lines[1 : count + 1]:
        name = " ".join(fields[:-9]).replace("\\", "/")
        density, isFixed, *numbers = fields[-9:]
        numbers = np.array(numbers, dtype=np.float64)
        position, orientation = numbers[:3].reshape(1, 3), numbers[3:].reshape(1, 4)
        rows.append((name, float(density), bool(int(isFixed)), position, orientation))
    return rows


def suggestion_lines(text):
    """The words of a scene's comment lines that begin with `# suggests`.

    Returns a list of (line number, list of words).
    """
    found = ((k, _SUGGESTION.match(line)) for k, line in enumerate(text.splitlines(), start=1))
    return [(number, match[1].split()) for number, match in found if match]
