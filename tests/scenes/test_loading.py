"""Loading: meshes, scenes and constraints, the coursework's and our own, whole and broken."""

import math
import sys
from collections import Counter

import numpy as np
import pytest
from oracles import COURSE, ROOT

from rbs.geometry.surfaces import NonConvexWarning, tetrahedron_volumes
from rbs.recordings.lookup import find_file, list_files
from rbs.scenes.scenefiles import find_constraints, find_scene
from rbs.scenes.textfiles import SceneError
from RigidBodySimulation import load_body, load_constraint_file, load_mesh_file, load_scene_file

# Sums over some hundred tetrahedra in double precision, relative to the volume.
ROUNDING = 1e-12
DATA = ROOT / "data"


def parametrized_files(*endings):
    """A test with each such file of data/ and, where they are at hand, of the coursework."""
    paths = [path for folder in (DATA, COURSE) for path in sorted(folder.glob("*"))]
    paths = [path for path in paths if path.name.endswith(endings)]
    return pytest.mark.parametrize("path", paths, ids=[f"{p.parent.name}/{p.name}" for p in paths])


def write(folder, name, text):
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def assert_is_body(vertices, faces, tets):
    """The faces are one closed surface seen from outside, and the tetrahedra fill it."""
    assert vertices.dtype == np.float64 and vertices.shape[1:] == (3,)
    assert faces.dtype == np.int64 and faces.shape[1:] == (3,)
    assert tets.dtype == np.int64 and tets.shape[1:] == (4,)
    edges = Counter((face[k - 1], face[k]) for face in faces.tolist() for k in range(3))
    assert all(edges[b, a] == count == 1 for (a, b), count in edges.items())
    volumes = tetrahedron_volumes(vertices, tets)
    assert np.all(volumes > 0.0)
    # By the divergence theorem, from the surface alone; negative if the faces look inward.
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    assert np.sum(a * np.cross(b, c)) / 6.0 == pytest.approx(np.sum(volumes), rel=ROUNDING)


@parametrized_files(".mesh", ".off")
def test_mesh_file_loads(path):
    assert_is_body(*load_mesh_file(path))


def rows_of(path):
    """The words of each line of a scene or constraint file, without comments and the count."""
    lines = [line.split() for line in path.read_text().splitlines() if line.split()]
    return [fields for fields in lines if not fields[0].startswith("#")][1:]


@pytest.mark.filterwarnings("ignore::rbs.geometry.surfaces.NonConvexWarning")
@parametrized_files("-scene.txt")
def test_scene_file_loads_with_its_constraints(path):
    meshes, rows = load_scene_file(path), rows_of(path)
    for index, (mesh, row) in enumerate(zip(meshes, rows, strict=True)):
        assert mesh.name == f"{row[0].rsplit('.', 1)[0]} {index}"
        assert mesh.density == float(row[1]) and mesh.isFixed == (row[2] == "1")
        numbers = np.array(row[3:], dtype=float)
        np.testing.assert_array_equal(mesh.position, numbers[None, :3])
        unit = numbers[None, 3:7] / np.linalg.norm(numbers[3:7])
        np.testing.assert_allclose(mesh.orientation, unit, rtol=0, atol=1e-15)
    file = path.with_name(path.name.replace("-scene", "-constraints"))
    assert find_constraints(path) == (file if file.exists() else None)
    if file.exists():
        constraints = load_constraint_file(file, meshes)
        for row, low, high in zip(rows_of(file), constraints[::2], constraints[1::2], strict=True):
            m1, v1, m2, v2 = ends = [int(x) for x in row[:4]]
            distance = math.dist(meshes[m1].currVertices[v1], meshes[m2].currVertices[v2])
            assert low == [*ends, float(row[4]) * distance, False]
            assert high == [*ends, float(row[5]) * distance, True]


# A right-angled tetrahedron with legs 1, 2, 3 (volume 1), of two tetrahedra: vertex 5 halves the
# leg of 3. Its faces look outward.
TETRAHEDRON = """\
MeshVersionFormatted 1
Dimension 3
Vertices
5
0 0 0 1
1 0 0 1
0 2 0 1
0 0 3 1
0 0 1.5 1
Triangles
6
1 3 2 1
1 2 5 1
5 2 4 1
1 5 3 1
5 4 3 1
2 3 4 1
Tetrahedra
2
1 2 3 5 1
5 2 3 4 1
End
"""
# The unit cube of six squares.
CUBE = """\
OFF
8 6 12
0 0 0
1 0 0
1 1 0
0 1 0
0 0 1
1 0 1
1 1 1
0 1 1
4 3 2 1 0
4 4 5 6 7
4 0 1 5 4
4 1 2 6 5
4 2 3 7 6
4 3 0 4 7
"""


def test_off_polygons_are_cut_into_fans_and_filled_from_the_mean(tmp_path):
    vertices, faces, tets = mesh = load_mesh_file(write(tmp_path, "cube.off", CUBE))
    assert_is_body(*mesh)
    assert (len(vertices), len(faces), len(tets)) == (9, 12, 12)
    assert vertices[8].tolist() == [0.5, 0.5, 0.5]
    assert faces[:2].tolist() == [[3, 2, 1], [3, 1, 0]]
    assert np.sum(tetrahedron_volumes(vertices, tets)) == pytest.approx(1.0, rel=ROUNDING)
    turned = CUBE.replace("4 3 2 1 0", "4 0 1 2 3").replace("4 1 2 6 5", "4 5 6 2 1")
    assert_is_body(*load_mesh_file(write(tmp_path, "turned.off", turned)))


def as_tables(mesh):
    return [array.tolist() for array in mesh]


# Of a file's text, what is replaced by what with no effect.
LEGAL_MESHES = [
    ("t.mesh", "End", "End\nof the numbers"),
    ("t.mesh", "Vertices\n5", "Vertices 5"),
    ("t.mesh", "0 2 0 1", "+0 +2.0e+0 -0 -1.5"),
    ("t.mesh", "1 3 2 1", "2 3 1 1"),  # a triangle, and a tetrahedron, turned over
    ("t.mesh", "End", "Edges\n1\n1 2 7\nCorners 2\n1\n2\nEnd"),
    ("cube.off", "4 3 2 1 0", "4 3 2 1 0 255 0 0"),
]


@pytest.mark.parametrize(("name", "old", "new"), LEGAL_MESHES)
def test_legal_variant_of_a_mesh_loads_alike(tmp_path, name, old, new):
    text = {"t.mesh": TETRAHEDRON, "cube.off": CUBE}[name]
    assert text.count(old) == 1
    one, other = (load_mesh_file(write(tmp_path, name, t)) for t in (text, text.replace(old, new)))
    assert as_tables(one) == as_tables(other)


def off(vertices, faces):
    """OFF text of polygons, counted from zero."""
    rows = [" ".join(map(repr, row)) for row in vertices]
    rows += [f"{len(face)} {' '.join(map(str, face))}" for face in faces]
    return "\n".join(["OFF", f"{len(vertices)} {len(faces)}", *rows])


def test_dented_off_is_filled_from_where_all_is_seen_and_warned_of_once(tmp_path):
    """An L of area 5: its corners' mean lies outside of it; all is seen from the inner square."""
    outline = [(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)]
    sides = [[i, i + 6, (i + 1) % 6 + 6, (i + 1) % 6] for i in range(6)]
    caps = [[3, 4, 5, 0, 1, 2], [9, 10, 11, 6, 7, 8]]
    text = off([(x, y, z) for y in (0.0, 2.0) for x, z in outline], sides + caps)
    vertices, _, tets = mesh = load_mesh_file(write(tmp_path, "L.off", text))
    assert_is_body(*mesh)
    # The kernel is the box [0, 1] × [0, 2] × [0, 1]: at most 1/2 from all planes.
    x, y, z = vertices[-1]
    assert (x, z) == (pytest.approx(0.5), pytest.approx(0.5)) and 0.5 <= y <= 1.5
    assert np.sum(tetrahedron_volumes(vertices, tets)) == pytest.approx(10.0, rel=ROUNDING)
    rows = [f"L.off 1 0 0 {10 * k} 0 1 0 0 0" for k in range(3)]
    with pytest.warns(NonConvexWarning) as warned:
        load_scene_file(write(tmp_path, "b-scene.txt", "\n".join(["3", *rows])))
    # The hull closes the triangle between (3, 1) and (1, 3): 2 more in area, and twice the volume.
    (warning,) = [str(w.message) for w in warned]
    assert warning.startswith("L.off ") and "volume 10" in warning and "hull 14" in warning


@pytest.mark.parametrize("ending", ["obj", "stl", "ply"])
def test_surfaces_of_other_programs_are_read_by_trimesh(tmp_path, monkeypatch, ending):
    """A box of 2 × 4 × 6, off the origin, as trimesh writes it, and one with a waist."""
    trimesh = pytest.importorskip("trimesh")
    box = trimesh.creation.box((2.0, 4.0, 6.0))
    box.apply_translation((1.0, 2.0, 3.0))
    box.export(tmp_path / f"a box.{ending}")
    vertices, _, tets = mesh = load_mesh_file(tmp_path / f"a box.{ending}")
    assert_is_body(*mesh)
    assert len(vertices) == 9 and tetrahedron_volumes(vertices, tets).sum() == pytest.approx(48.0)
    body = load_body(tmp_path / f"a box.{ending}", 2.0)
    assert body.name == "a box" and body.mass == pytest.approx(96.0)
    np.testing.assert_allclose(body.position, [[1.0, 2.0, 3.0]])
    moved = load_body(tmp_path / f"a box.{ending}", 2.0, (0, 9, 0), (1, 0, 0, 1), True)
    assert moved.position.tolist() == [[0, 9, 0]] and moved.isFixed
    scene = write(tmp_path, "a-scene.txt", f"1\na box.{ending} 2 0 0 9 0 1 0 0 0")
    assert load_scene_file(scene)[0].mass == pytest.approx(96.0)
    waist = trimesh.creation.box((2.0, 4.0, 6.0)).subdivide()
    waist.vertices[np.abs(waist.vertices[:, 1]) < 1.0] *= [0.6, 1.0, 0.6]
    waist.export(tmp_path / f"waist.{ending}")
    with pytest.warns(NonConvexWarning, match=rf"^waist.{ending} is not convex \(volume "):
        load_body(tmp_path / f"waist.{ending}", 1.0)
    content = (tmp_path / f"a box.{ending}").read_bytes()
    cut = write(tmp_path, f"cut.{ending}", content[: len(content) // 2])
    with pytest.raises(SceneError, match=rf"^[^\n]*cut.{ending}: [^\n]*$"):
        load_mesh_file(cut)
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(SceneError, match=rf".{ending} files need trimesh: pip install trimesh"):
        load_mesh_file(cut)


SCENE = """\
3
cube.off   50.0  0   0 10 0   2 0 0 0
cube.off  100    1   4 10.5 0  1 0 0 1
t.mesh     7     0   0 20 -3.25   0.5 0.5 0.5 0.5
"""
FILES = {"cube.off": CUBE, "t.mesh": TETRAHEDRON, "a-scene.txt": SCENE}
FILES["a-constraints.txt"] = "1\n0 1 1 2 0.5 1.25\n"


def test_bodies_of_one_mesh_share_nothing_and_stand_turned(sceneFolder):
    first, second, _ = load_scene_file(str(sceneFolder / "a-scene.txt"))
    # A quarter turn about z takes the corner (1/2, -1/2, -1/2) of the cube to (1/2, 1/2, -1/2).
    np.testing.assert_allclose(second.currVertices[1], [4.5, 11.0, -0.5], atol=1e-14)
    for name in ("origVertices", "currVertices", "faces", "tets"):
        assert not np.shares_memory(getattr(first, name), getattr(second, name))


LEGAL_TEXT = {
    "CR-LF": lambda text: text.replace("\n", "\r\n"),
    "byte-order mark": lambda text: "\ufeff" + text,
    "blank lines": lambda text: "\n\n" + text.replace("\n", "\n \n"),
    "comments": lambda text: "# Würfel, 立方体\n" + text.replace("\n", "  # and so\n"),
}


@pytest.mark.parametrize("variant", LEGAL_TEXT)
def test_legal_variant_of_text_files_loads_alike(sceneFolder, variant):
    def load():
        meshes = load_scene_file("a-scene.txt")
        arrays = [as_tables((m.currVertices, m.faces, m.tets, m.orientation)) for m in meshes]
        return arrays, load_constraint_file("a-constraints.txt", meshes)

    before = load()
    for name, text in FILES.items():
        write(sceneFolder, name, LEGAL_TEXT[variant](text))
    assert load() == before


def test_blanks_any_letter_and_either_separator_in_names(tmp_path):
    folder = tmp_path / "Räume, Körper & 物体" / "alle Netze"
    folder.mkdir(parents=True)
    write(folder.parent, "ein großer Würfel.off", CUBE)
    write(folder, "Vierflächner é.MESH", TETRAHEDRON)
    for separator in ("/", "\\"):
        scene = f"2\n.{separator}ein großer Würfel.off 1 0 0 9 0 1 0 0 0\n"
        scene += f"alle Netze{separator}Vierflächner é.MESH 2, 0, 0, 30, 0, 1, 0, 0, 0\n"
        meshes = load_scene_file(write(folder.parent, "ein Turm-scene.txt", scene))
        assert [mesh.name for mesh in meshes] == ["ein großer Würfel 0", "Vierflächner é 1"]


def test_scenes_are_found_by_path_and_by_name(sceneFolder, monkeypatch):
    assert load_scene_file(find_scene("a-scene.txt"))[0].name == "cube 0"
    for name in ("a", "../data/tower"):  # of this folder, not of data/: only by its file's name
        with pytest.raises(SceneError, match=f"^{name}: "):
            find_scene(name)
    with pytest.raises(SceneError, match=r"did you mean mixed\?$"):
        find_scene("mxied")
    (sceneFolder / "tower").mkdir()  # does not hide the scene
    assert find_scene("tower") == find_file("tower", ".") == DATA / "tower-scene.txt"
    (sceneFolder / "own").mkdir()
    beside = write(sceneFolder, "own/b-scene.txt", "1\nbox.mesh 1 0 0 9 0 1 0 0 0\n")
    monkeypatch.setenv("HOME", str(sceneFolder))
    assert find_file("b", "own").resolve() == find_file("b-scene.txt", "own").resolve() == beside
    assert find_file("~/own/b-scene.txt", "/") == beside
    assert [one.name for one in list_files(beside.parent)][0] == "b"


# The least triangulation of the projective plane: every edge belongs to two triangles, and yet
# there is no inside.
PLANE = "OFF\n6 10 15\n1 0 0\n0 1 0\n0 0 1\n-1 0 0\n0 -1 0\n0 0 -1\n" + "".join(
    f"3 {' '.join(face)}\n"
    for face in ("012", "023", "034", "045", "051", "124", "235", "341", "452", "513")
)
# Which file is broken; what replaces which text, or all of it for None; the line that the error
# names, None for the file as a whole; and a word of its cause. Each has another cause.
BROKEN = [
    ("a-scene.txt", None, b"3\n\xff\xfe", None, "not a text file"),
    ("t.mesh", "0 2 0 1", "0 nan 0 1", 7, "finite"),
    ("t.mesh", "Dimension 3", "Dimension 2", 2, "dimension"),
    ("t.mesh", None, TETRAHEDRON[:54], 5, "Vertices 2 of 5"),
    ("t.mesh", "1 3 2 1", "0 3 2 1", 12, "between 1 and 5"),
    ("t.mesh", "1 3 2 1", "1 3 4 1", 12, "not a face"),
    ("t.mesh", "6\n1 3 2 1\n", "5\n", 12, "closed"),
    ("t.mesh", "a\n2\n", "a\n3\n1 2 3 5 1\n", None, "1.5"),
    ("t.mesh", "0 0 1.5 1", "0.2 0.2 0 1", 20, "flat"),
    ("t.mesh", "Tetrahedra\n2\n1 2 3 5 1\n5 2 3 4 1\n", "", None, "no Tetrahedra"),
    ("t.mesh", "1 2 5 1", "1 3 2 1", 13, "triangle 2 repeats triangle 1"),
    ("cube.off", "4 4 5 6 7", "4 4 5 6", 12, "only 3"),
    ("cube.off", "4 4 5 6 7", "4 4 5 5 7", 12, "used twice"),
    ("a-scene.txt", "50.0", "1e99", 2, "must not exceed"),
    ("cube.off", None, PLANE, None, "no inside"),
    ("cube.off", None, CUBE.replace(" 1\n", " 0\n"), None, "filled"),
    ("a-scene.txt", "3\n", "", 1, "not a scene"),
    ("a-scene.txt", "50.0", "50.0 1", 2, "10 columns, not 11"),
    ("a-scene.txt", "50.0", "0", 2, "positive"),
    ("a-scene.txt", "2 0 0 0", "0 0 0 0", 2, "zero"),
    ("a-scene.txt", "t.mesh", "u.mesh", 4, "u.mesh"),
    ("a-constraints.txt", "0 1 1 2", "0 9 1 2", 2, "vertex index"),
    ("a-constraints.txt", "0.5 1.25", "1.25 0.5", 2, "lower ≤ upper"),
]


def broken(text, old, new):
    """A text with the first `old`, which must occur, replaced by `new`; or `new` if it is None."""
    assert old is None or old in text
    return new if old is None else text.replace(old, new, 1)


@pytest.mark.parametrize("case", BROKEN, ids=[f"{case[0]}: {case[4]}" for case in BROKEN])
def test_broken_file_is_named_with_line_and_cause(sceneFolder, case):
    name, old, new, line, cause = case
    meshes = load_scene_file("a-scene.txt")
    path = write(sceneFolder, name, broken(FILES[name], old, new))
    with pytest.raises(SceneError) as raised:
        if name.endswith("-constraints.txt"):
            load_constraint_file(path, meshes)
        else:
            load_scene_file(sceneFolder / "a-scene.txt")
    error = str(raised.value)
    assert error.startswith(f"{path}:{line}: " if line else f"{path}: "), error
    assert cause in error and error.isprintable() and len(error) < 300 + len(str(path)), error
