"""Meshes, scenes and constraints, whole and broken; and what those of data/ promise."""

import math
import subprocess
import sys
import warnings
from collections import Counter
from functools import partial

import numpy as np
import pytest
from foreignFiles import CUBE, OBJ, TETRAHEDRON, cases, soup_text
from oracles import COURSE, DATA, minkowski_depth, state_of
from program import call
from scipy.spatial import ConvexHull
from scipy.spatial.distance import cdist

from rbs.recordings.lookup import list_files
from rbs.scenes import shapes
from rbs.scenes.files import SceneError
from rbs.scenes.meshfiles import NonConvexWarning, tetrahedron_volumes
from rbs.scenes.scenefiles import SceneSource, find_constraints, find_scene
from RigidBodySimulation import load_body, load_constraint_file, load_mesh_file, load_scene_file

# Sums over some hundred tetrahedra in double precision, relative to the volume.
ROUNDING = 1e-12
CUBE_OBJ = OBJ["halves that touch"] + "\n"


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
    """Those of data/ are convex, without slivers."""
    vertices, _, tets = mesh = load_mesh_file(path)
    assert_is_body(*mesh)
    if path.parent == DATA:
        hull, volumes = ConvexHull(vertices), tetrahedron_volumes(vertices, tets)
        inner = path.suffix == ".off"  # the vertex that tetrahedra need
        assert len(hull.vertices) == len(vertices) - inner and volumes.min() > 5e-5 * hull.volume
        assert volumes.sum() == pytest.approx(hull.volume, rel=1e-13)


def rows_of(path):
    """The words of each line of a scene or constraint file, without comments and the count."""
    lines = [line.split() for line in path.read_text().splitlines() if line.split()]
    return [fields for fields in lines if not fields[0].startswith("#")][1:]


@pytest.mark.filterwarnings("ignore::rbs.scenes.meshfiles.NonConvexWarning")
@parametrized_files("-scene.txt")
def test_scene_file_loads_with_its_constraints(path):
    meshes, rows = load_scene_file(path), rows_of(path)
    for index, (mesh, row) in enumerate(zip(meshes, rows, strict=True)):
        assert mesh.name == f"{row[0].rsplit('.', 1)[0]} {index}"
        assert mesh.density == float(row[1]) and mesh.isFixed == (row[2] == "1")
    numbers = np.array([row[3:10] for row in rows], dtype=float)
    numbers[:, 3:] /= np.linalg.norm(numbers[:, 3:], axis=1)[:, None]
    np.testing.assert_allclose(state_of(meshes)[:, :7], numbers, rtol=0, atol=1e-15)
    file = path.with_name(path.name.replace("-scene", "-constraints"))
    assert find_constraints(path) == (file if file.exists() else None)
    if file.exists():
        constraints = load_constraint_file(file, meshes)
        corners = [mesh.currVertices for mesh in meshes]
        for row, low, high in zip(rows_of(file), constraints[::2], constraints[1::2], strict=True):
            m1, v1, m2, v2 = ends = [int(x) for x in row[:4]]
            distance = math.dist(corners[m1][v1], corners[m2][v2])
            assert low == [*ends, float(row[4]) * distance, False]
            assert high == [*ends, float(row[5]) * distance, True]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("case", [*cases()], ids=lambda case: case[0])
def test_file_of_another_program_is_the_body_that_it_describes(tmp_path, case):
    name, content, counts = case
    path = write(tmp_path, name, content)
    mesh, body = load_mesh_file(path), load_body(path, 2.0, scale=0.5)
    assert tuple(map(len, mesh)) == counts
    assert body.mass == pytest.approx(2.0 / 8.0) and body.hullVolume == pytest.approx(1.0 / 8.0)
    if name not in ("a vertex twice.mesh", "halves that touch.obj"):  # four faces at an edge
        assert_is_body(*mesh)
    # constraints refer to the file's numbers of vertices
    if path.suffix in (".mesh", ".off") and name != "vertices of each face.off":
        text, count = (CUBE, 8) if path.suffix == ".off" else (TETRAHEDRON, 5)
        plain = load_mesh_file(write(tmp_path, f"plain{path.suffix}", text))
        assert mesh[0][:count].tolist() == plain[0][:count].tolist()


# Corners that are one point, as CAD writes them: the ending, how far they differ, how numbers are
# written, and whether they are merged.
SOUPS = [
    *((ending, wrong, "{!r}", True) for ending in ("obj", "off", "ply") for wrong in (0, 1e-16)),
    ("stl", 4e-7, "{:.6e}", True),
    ("ply", 1e-6, "{:g}", True),
    ("STL", 1e-7, "", True),
    ("obj", 1e-10, "{!r}", False),
    ("ply", 1e-4, "{:g}", False),
    ("STL", 1e-4, "", False),
]


@pytest.mark.parametrize(("ending", "wrong", "form", "isMerged"), SOUPS)
def test_corners_are_merged_within_the_rounding_of_a_file(tmp_path, ending, wrong, form, isMerged):
    pytest.importorskip("trimesh")
    path = write(tmp_path, f"a.{ending}", soup_text(ending, wrong, form))
    if not isMerged:
        with pytest.raises(SceneError, match="not closed"):
            load_mesh_file(path)
        return
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        body = load_body(path, 2.0)
    assert body.mass == pytest.approx(2.0, rel=1e-4) and len(body.hull.vertices) == 8
    assert [("merged" in str(one.message)) for one in told] == [True] * (wrong > 0)


def test_dented_off_is_a_body_and_warned_of_once(tmp_path, monkeypatch, capsys):
    """An L of area 5, whose corners' mean does not see all of it: there are no tetrahedra."""
    outline = [(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)]
    rows = [f"{x} {y} {z}" for y in (0, 2) for x, z in outline]
    rows += [f"4 {i} {i + 6} {(i + 1) % 6 + 6} {(i + 1) % 6}" for i in range(6)]
    rows += ["6 0 1 2 3 4 5", "6 9 10 11 6 7 8"]
    monkeypatch.chdir(tmp_path)
    path = write(tmp_path, "L.off", "\n".join(["OFF", "12 8", *rows]))
    assert [len(table) for table in load_mesh_file(path)] == [12, 20, 0]
    rows = [f"L.off 1 0 0 {10 * k} 0 1 0 0 0" for k in range(3)]
    with pytest.warns(NonConvexWarning) as warned:
        load_scene_file(write(tmp_path, "b-scene.txt", "\n".join(["3", *rows])))
    # The hull closes the triangle between (3, 1) and (1, 3): 2 more in area, and twice the volume.
    (warning,) = [str(w.message) for w in warned]
    assert warning.startswith("L.off ") and "volume 10, convex hull 14, 40.00% more" in warning
    for words in (["b-scene.txt", "--headless", "--steps", "9", "--record"], ["--verify"]):
        assert call(capsys, *words, "r.h5")[0] == 0


@pytest.mark.parametrize("ending", ["obj", "stl", "ply", "glb"])
def test_surfaces_of_other_programs_are_read(tmp_path, monkeypatch, ending):
    """A box of 2 × 4 × 6, off the origin and turned inside out, as trimesh writes it."""
    trimesh = pytest.importorskip("trimesh")
    box = trimesh.creation.box(bounds=[[0, 0, 0], [2, 4, 6]])
    box.invert()
    path = tmp_path / f"a box.{ending}"
    trimesh.Scene(box).export(path)
    vertices, _, tets = mesh = load_mesh_file(path)
    assert_is_body(*mesh)
    assert len(vertices) == 9 and tetrahedron_volumes(vertices, tets).sum() == pytest.approx(48.0)
    body = load_body(path, 2.0)
    assert body.name == "a box" and body.mass == pytest.approx(96.0)
    np.testing.assert_allclose(body.position, [[1.0, 2.0, 3.0]])
    moved = load_body(path, 2.0, (0, 9, 0), (1, 0, 0, 1), True)
    assert moved.position.tolist() == [[0, 9, 0]] and moved.isFixed
    scene = write(tmp_path, "a-scene.txt", f"1\na box.{ending} 2 0 0 9 0 1 0 0 0")
    assert load_scene_file(scene)[0].mass == pytest.approx(96.0)
    cut = write(tmp_path, f"cut.{ending}", path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(SceneError, match=rf"^[^\n]*cut.{ending}:[^\n]*$"):
        load_mesh_file(cut)
    monkeypatch.setitem(sys.modules, "trimesh", None)
    if ending == "obj":
        assert load_body(path, 2.0).mass == pytest.approx(96.0)
    else:
        with pytest.raises(SceneError, match="trimesh is missing. Install it: .* install trimesh"):
            load_mesh_file(cut)


@pytest.mark.parametrize("kind", ["torus", "hollow", "apart"])
def test_surface_that_is_not_star_shaped_has_the_inertia_that_trimesh_integrates(tmp_path, kind):
    """A smaller box in a node of its own is turned inwards: a cavity of the other, or beside it."""
    creation = pytest.importorskip("trimesh").creation
    scene = (creation.torus(2.0, 0.5) if kind == "torus" else creation.box((4, 5, 6))).scene()
    if kind != "torus":
        small, place = creation.box((1.0, 0.5, 1.5)), np.diag([2.0, 2.0, 2.0, 1.0])
        small.invert()
        place[0, 3] = 5.0 if kind == "apart" else 0.25
        scene.add_geometry(small, transform=place)
    whole, density = scene.to_mesh(), 2.0
    scene.export(tmp_path / "a.glb")
    if kind == "apart":
        whole.faces[12:] = whole.faces[12:, ::-1]
    whole.density = density
    of_scene = partial(shapes.from_surface, "a")
    for load, source in ((load_body, tmp_path / "a.glb"), (of_scene, scene)):
        with pytest.warns(NonConvexWarning, match=r"% more\) and collides as its hull"):
            body = load(source, density=density)
        assert len(body.tets) == 0 and body.mass == pytest.approx(whole.mass)
        np.testing.assert_allclose(body.position[0], whole.center_mass, atol=1e-6)
        np.testing.assert_allclose(body.IT, whole.moment_inertia, atol=1e-6 * body.mass)
        assert body.hullVolume == pytest.approx(whole.convex_hull.volume)


@pytest.mark.filterwarnings("error")
def test_body_that_seems_to_be_in_millimetres_is_told_of(tmp_path):
    path = write(tmp_path, "cube.off", CUBE)
    for density, scale in ((1000.0, 64.0), (1e-3, 500.0)):  # 2.6e8 kg; 4.9 m are 1/100 of its size
        with pytest.warns(UserWarning, match=r"^cube.off is ((?!e\+).)*scale=0.001"):
            load_body(path, density, scale=scale)
    text = "2\n" + 2 * "cube.off scale=1D-1 2.6e8 0 0 9 0 1 0 0 0\n"
    scene = write(tmp_path, "a-scene.txt", text)
    load_body(path, 2.6e8, isFixed=True)
    meshes = load_scene_file(scene)
    assert [mesh.volume for mesh in meshes] == [pytest.approx(1e-3)] * 2
    source = SceneSource.of_files(scene)
    assert [source.make()[0][0].mass for _ in range(2)] == [meshes[0].mass] * 2
    assert set(source.files()) == {scene, path}


SCENE = """\
3
cube.off   50.0  0   0 10 0   2 0 0 0
cube.off  100    1   4 10.5 0  1 0 0 1
t.mesh     7     0   0 20 -3.25   0.5 0.5 0.5 0.5
"""
FILES = {"cube.off": CUBE, "t.mesh": TETRAHEDRON, "a-scene.txt": SCENE}
FILES["a-constraints.txt"] = "1\n0 1 1 2 0.5 1.25\n"


# Other forms of the same text files.
LEGAL_TEXT = (
    lambda text: text.replace("\n", "\r\n"),
    lambda text: "\ufeff" + text,
    lambda text: "\n\n" + text.replace("\n", "\n \n"),
    lambda text: f"# Würfel\n{text}# Français".encode("latin-1"),
)


def test_legal_variant_of_text_files_loads_alike(sceneFolder):
    def load():
        meshes = load_scene_file("a-scene.txt")
        arrays = [a.tolist() for m in meshes for a in (m.currVertices, m.faces, m.tets)]
        return arrays, load_constraint_file("a-constraints.txt", meshes)

    before = load()
    for change in LEGAL_TEXT:
        for name, text in FILES.items():
            write(sceneFolder, name, change(text))
        assert load() == before


def test_blanks_any_letter_and_either_separator_in_names(tmp_path):
    folder = tmp_path / "Räume, Körper & 物体" / "alle Netze"
    folder.mkdir(parents=True)
    write(folder.parent, "ein  großer Würfel.off", CUBE)
    write(folder, "Vierflächner é.MESH", TETRAHEDRON)
    for separator in ("/", "\\"):
        scene = f"2\n.{separator}ein  großer Würfel.off  1 0 0 9 0 1 0 0 0\n"
        scene += f"alle Netze{separator}Vierflächner é.MESH 2, 0, 0, 30, 0, 1, 0, 0, 0\n"
        meshes = load_scene_file(write(folder.parent, "ein Turm-scene.txt", scene))
        assert [mesh.name for mesh in meshes] == ["ein  großer Würfel 0", "Vierflächner é 1"]


def test_columns_of_soft_bodies_are_told_of_and_ignored(sceneFolder):
    rigid = load_scene_file("a-scene.txt")
    soft = SCENE.replace("   50.0  0 ", " 50.0 1e5 0.3 0 ").replace("7     0", "7\t2.1e5 .45 0")
    write(sceneFolder, "b-scene.txt", soft)
    with pytest.warns(UserWarning, match=r"^b-scene.txt:2: Young's modulus .* ignored") as told:
        meshes = load_scene_file("b-scene.txt")
    assert len(told) == 1
    for one, other in zip(rigid, meshes, strict=True):
        assert (one.mass, one.isFixed) == (other.mass, other.isFixed)
        assert one.currVertices.tolist() == other.currVertices.tolist()


def test_scenes_are_found_by_path_and_by_name(sceneFolder, monkeypatch):
    for name, told in (("a", "^a: "), ("../data/tower", "^"), ("TOWERR", "did you mean tower")):
        with pytest.raises(SceneError, match=told):
            find_scene(name)
    (sceneFolder / "tower").mkdir()  # does not hide the scene
    assert find_scene("tower") == find_scene("tower", ".") == DATA / "tower-scene.txt"
    (sceneFolder / "own" / "folder-scene.txt").mkdir(parents=True)
    beside = write(sceneFolder, "own/b-scene.txt", "1\nbox.mesh 1 0 0 9 0 1 0 0 0\n")
    monkeypatch.setenv("HOME", str(sceneFolder))
    assert find_scene("b", "own").resolve() == find_scene("b-scene.txt", "own").resolve() == beside
    assert find_scene("~/own/b-scene.txt", "/") == find_scene("~/own/b-scene.txt") == beside
    (sceneFolder / "own" / "r\u200b.h5").touch()  # not printable, nor would the window take all
    assert [name for _, name, *_ in list_files(beside.parent)][:2] == ["b", "r .h5"]


# The least triangulation of the projective plane: every edge belongs to two triangles, and yet
# there is no inside.
PLANE = "OFF\n6 10 15\n1 0 0\n0 1 0\n0 0 1\n-1 0 0\n0 -1 0\n0 0 -1\n" + "".join(
    f"3 {' '.join(face)}\n"
    for face in ("012", "023", "034", "045", "051", "124", "235", "341", "452", "513")
)
# Which file is broken; what replaces which text, or all of it for None; and the line that the error
# names, None for the file as a whole, or a word of the cause. Each has another cause.
BROKEN = [
    ("a-scene.txt", None, b"3\n\0\xfe", None),
    ("t.mesh", "Mesh", "Mash", 1),
    ("t.mesh", "0 2 0 1", "0\n2 0\n1x", 9),
    ("t.mesh", "s\n5", "s\n4", 9),
    ("t.mesh", "a\n2\n", "a\n3\n1 2 3 5 1\n", 21),
    ("t.mesh", "End", "Hexahedra\n1\n1 2 3 4 5 1 2 3 0", 23),
    ("cube.off", "4 4 5 6 7", "4 4 5 6", 12),
    ("cube.off", "8 6 12", "8 5 12", 16),
    ("cube.off", None, PLANE, None),
    ("cube.off", None, CUBE.replace(" 1\n", " 0\n"), None),
    ("a-scene.txt", "3\n", "", 1),
    ("a-scene.txt", "50.0", "50.0 1e5 nan", 2),
    ("a-scene.txt", "50.0", "scale=0 50.0", 2),
    ("a-scene.txt", "2 0 0 0", "0 0 0 0", 2),
    ("a-scene.txt", "t.mesh", "u.mesh", 4),
    ("a-constraints.txt", "0 1 1 2", "0 9 1 2", 2),
    ("a-constraints.txt", "0.5 1.25", "1.25 0.5", 2),
    ("a-constraints.txt", "1.25", "1.7e308", 2),
    ("a.msh", None, "", None),
    ("zero.obj", None, CUBE_OBJ.replace("f 4 ", "f 0 ", 1), 9),
    ("no face.obj", None, CUBE_OBJ.replace("f ", "l "), None),
    ("not finite.ply", None, soup_text("ply", 0).replace("d_header\n", "d_header\nnan ", 1), None),
    ("cut off.ply", None, soup_text("ply", 0)[:-40], None),
    ("no solid.stl", None, "solid\xfc\n" + "vertex 0 0\n" * 3, None),
    ("pointer.obj", None, "version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "Git LFS"),
    ("wide.off", None, CUBE.encode("utf-16"), "UTF-16"),
]


@pytest.mark.parametrize("case", BROKEN, ids=str)
def test_broken_file_is_named_with_its_line(sceneFolder, case):
    name, old, new, line = case
    pytest.importorskip("trimesh")
    meshes = load_scene_file("a-scene.txt")
    assert old is None or old in FILES[name]
    path = write(sceneFolder, name, new if old is None else FILES[name].replace(old, new, 1))
    with pytest.raises(SceneError) as raised:
        if name.endswith("-constraints.txt"):
            load_constraint_file(path, meshes)
        elif name in FILES:
            load_scene_file(sceneFolder / "a-scene.txt")
        else:
            load_mesh_file(path)
    error = str(raised.value)
    assert error.startswith(f"{path}:{line}: " if isinstance(line, int) else f"{path}: "), error
    assert not isinstance(line, str) or line in error
    assert error.isprintable() and len(error) < 300 + len(str(path)), error


# Made by make_pile.py, with these words.
PILES = {"pile_200": "200", "pile_1000": "1000", "heap": "1000 --heap"}
PILE_FILES = {DATA / f"{name}-scene.txt" for name in PILES}


def test_script_reproduces_the_files(tmp_path):
    folder = tmp_path / "new" / "folder"
    command = [sys.executable, DATA / "scripts" / "make_data.py", "--out", folder]
    subprocess.run(command, cwd=tmp_path, check=True)
    made = {path.name for path in folder.iterdir()}
    ours = {path.name for ending in ("mesh", "off", "txt") for path in DATA.glob(f"*.{ending}")}
    assert made == ours - {path.name for path in PILE_FILES}
    for name in made:
        assert (folder / name).read_bytes() == (DATA / name).read_bytes(), name
    assert [path.name for path in tmp_path.iterdir()] == ["new"]


@pytest.mark.parametrize("path", sorted({*DATA.glob("*-scene.txt")} - PILE_FILES), ids=str)
def test_scene_starts_on_or_above_the_ground_with_its_bodies_apart(path):
    meshes = load_scene_file(path)
    assert min(mesh.currVertices[:, 1].min() for mesh in meshes) >= 0
    places = np.vstack([mesh.position for mesh in meshes])
    radii = np.array([np.linalg.norm(mesh.origVertices, axis=1).max() for mesh in meshes])
    isNear = cdist(places, places) <= radii[:, None] + radii
    for i, j in np.argwhere(np.triu(isNear, 1)):
        one, other = meshes[i], meshes[j]
        if not (one.isFixed and other.isFixed):  # such as flush tiles
            assert minkowski_depth(one.currVertices, other.currVertices) < 0, (one.name, other.name)


@pytest.mark.parametrize(("name", "words"), PILES.items())
def test_piles_are_reproduced(name, words):
    command = [sys.executable, DATA / "scripts" / "make_pile.py", *words.split()]
    made = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert made == (DATA / f"{name}-scene.txt").read_text()
