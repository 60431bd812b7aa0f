"""Loading: meshes, scenes and constraints, the coursework's and our own, whole and broken."""

import math
import warnings
from collections import Counter

import numpy as np
import pytest
from oracles import COURSE, ROOT, needs_course

from rbs.meshfiles import tetrahedron_volumes
from rbs.opening import find_file
from rbs.scenes import (
    CONVEXITY_TOLERANCE,
    NonConvexWarning,
    find_constraints,
    find_scene,
    list_scenes,
    scene_name,
)
from rbs.textfiles import SceneError
from RigidBodySimulation import (
    flatten_meshes,
    load_constraint_file,
    load_mesh_file,
    load_scene_file,
)

# Sums over some hundred tetrahedra in double precision, relative to the volume.
ROUNDING = 1e-12

DATA = ROOT / "data"
MESH_ENDINGS = (".mesh", ".off")


def files(folder, *endings):
    """The files of a folder that end so; one None, for a test to be skipped, where there is none"""
    return sorted(path for path in folder.glob("*") if path.name.endswith(endings)) or [None]


def parametrized_files(*endings):
    """A test with each such file of data/ and, where they are at hand, of the coursework."""
    ours = [pytest.param(path, id=f"data/{path.name}") for path in files(DATA, *endings)]
    theirs = [
        pytest.param(path, id=f"course/{path.name if path else ''}", marks=needs_course)
        for path in files(COURSE, *endings)
    ]
    return pytest.mark.parametrize("path", ours + theirs)


def write(folder, name, text):
    """Writes a file, bytes or str, and returns its path."""
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def enclosed_volume(vertices, faces):
    """By the divergence theorem, from the surface alone; negative if the faces look inward."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.sum(a * np.cross(b, c)) / 6.0


def assert_is_body(vertices, faces, tets):
    """The faces are one closed surface seen from outside, and the tetrahedra fill it."""
    assert vertices.dtype == np.float64 and vertices.shape[1:] == (3,)
    assert faces.dtype == np.int64 and faces.shape[1:] == (3,)
    assert tets.dtype == np.int64 and tets.shape[1:] == (4,)
    edges = Counter((face[k - 1], face[k]) for face in faces.tolist() for k in range(3))
    assert all(edges[b, a] == count == 1 for (a, b), count in edges.items())
    volumes = tetrahedron_volumes(vertices, tets)
    assert np.all(volumes > 0.0)
    assert enclosed_volume(vertices, faces) == pytest.approx(np.sum(volumes), rel=ROUNDING)


# --------------------------------------------------------------------------------------------------
# The files that are there
# --------------------------------------------------------------------------------------------------


@parametrized_files(*MESH_ENDINGS)
def test_mesh_file_loads(path):
    assert_is_body(*load_mesh_file(path))


@needs_course
def test_course_surfaces_have_the_volume_of_their_tetrahedral_meshes():
    pairs = [(path, path.with_suffix(".mesh")) for path in files(COURSE, ".off")]
    pairs = [(off, mesh) for off, mesh in pairs if mesh.exists()]
    assert len(pairs) == 6
    for off, mesh in pairs:
        surface, solid = (tetrahedron_volumes(v, t) for v, _, t in map(load_mesh_file, (off, mesh)))
        # One of a pair has its coordinates written with six decimals.
        assert np.sum(surface) == pytest.approx(np.sum(solid), rel=1e-6), off.name


@parametrized_files("-scene.txt")
def test_scene_file_loads(path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NonConvexWarning)
        meshes = load_scene_file(path)
    lines = [line.split() for line in path.read_text().splitlines() if line.split()]
    rows = [fields for fields in lines if not fields[0].startswith("#")][1:]
    assert len(meshes) == len(rows)
    for index, (mesh, row) in enumerate(zip(meshes, rows, strict=True)):
        assert mesh.name == f"{row[0].rsplit('.', 1)[0]} {index}"
        assert mesh.density == float(row[1])
        assert mesh.isFixed == (row[2] == "1")
        np.testing.assert_array_equal(mesh.position, [[float(x) for x in row[3:6]]])
        quaternion = np.array([[float(x) for x in row[6:10]]])
        np.testing.assert_allclose(
            mesh.orientation, quaternion / np.linalg.norm(quaternion), rtol=0, atol=1e-15
        )


@parametrized_files("-constraints.txt")
def test_constraint_file_loads(path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NonConvexWarning)
        meshes = load_scene_file(path.with_name(path.name.replace("-constraints", "-scene")))
    constraints = load_constraint_file(path, meshes)
    lines = [line.split() for line in path.read_text().splitlines()]
    rows = [fields for fields in lines if len(fields) == 6]
    assert len(constraints) == 2 * len(rows)
    for row, lower, upper in zip(rows, constraints[::2], constraints[1::2], strict=True):
        ends = [int(x) for x in row[:4]]
        distance = math.dist(
            meshes[ends[0]].currVertices[ends[1]], meshes[ends[2]].currVertices[ends[3]]
        )
        assert lower == [*ends, float(row[4]) * distance, False]
        assert upper == [*ends, float(row[5]) * distance, True]


@needs_course
def test_released_cylinder_gives_one_warning_however_often_it_is_used():
    with pytest.warns(NonConvexWarning) as warned:
        meshes = load_scene_file(COURSE / "stress-scene.txt")
    assert sum(mesh.name.startswith("cylinder") for mesh in meshes) > 1
    (warning,) = [str(w.message) for w in warned if w.category is NonConvexWarning]
    assert "cylinder.mesh" in warning and "1397.06" in warning and "1445.44" in warning


def test_our_scenes_give_no_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for path in list_scenes(DATA):
            load_scene_file(path)


# --------------------------------------------------------------------------------------------------
# .mesh
# --------------------------------------------------------------------------------------------------

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


def as_tables(mesh):
    """The arrays of a loaded mesh as comparable lists."""
    return [array.tolist() for array in mesh]


def test_mesh_gives_the_numbers_of_the_file_counted_from_zero(tmp_path):
    vertices, faces, tets = mesh = load_mesh_file(write(tmp_path, "t.mesh", TETRAHEDRON))
    assert vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3], [0, 0, 1.5]]
    assert faces.tolist() == [[0, 2, 1], [0, 1, 4], [4, 1, 3], [0, 4, 2], [4, 3, 2], [1, 2, 3]]
    assert tets.tolist() == [[0, 1, 2, 4], [4, 1, 2, 3]]
    assert_is_body(*mesh)


@pytest.mark.parametrize(
    "variant",
    [
        pytest.param(lambda text: text.replace("End\n", ""), id="no End"),
        pytest.param(lambda text: text.replace("End", "End\nof the numbers"), id="after End"),
        pytest.param(lambda text: text.replace("Vertices\n5", "Vertices 5"), id="count beside"),
        pytest.param(lambda text: text.replace("Dimension 3", "Dimension\n3"), id="3 below"),
        pytest.param(lambda text: text.replace(" 1\n", " 0\n"), id="reference 0"),
        pytest.param(
            lambda text: text.replace("End", "Edges\n1\n1 2 7\nCorners 2\n1\n2\nEnd"),
            id="other sections at the end",
        ),
        pytest.param(
            lambda text: text.replace("Triangles", "Corners\n2\n1\n2\nTriangles"),
            id="other sections between",
        ),
    ],
)
def test_mesh_variants_load_alike(tmp_path, variant):
    reference = load_mesh_file(write(tmp_path, "reference.mesh", TETRAHEDRON))
    mesh = load_mesh_file(write(tmp_path, "variant.mesh", variant(TETRAHEDRON)))
    assert as_tables(mesh) == as_tables(reference)


def test_mesh_sections_in_another_order_load_alike(tmp_path):
    head, rest = TETRAHEDRON.split("Triangles")
    triangles, tets = rest.replace("End\n", "").split("Tetrahedra")
    swapped = f"{head}Tetrahedra{tets}Triangles{triangles}"
    reference = load_mesh_file(write(tmp_path, "reference.mesh", TETRAHEDRON))
    assert as_tables(load_mesh_file(write(tmp_path, "s.mesh", swapped))) == as_tables(reference)


def medit(vertices, faces, tets):
    """MEDIT text of a mesh counted from zero."""
    blocks = ["MeshVersionFormatted 1", "Dimension 3"]
    named = {"Vertices": vertices, "Triangles": faces + 1, "Tetrahedra": tets + 1}
    for name, table in named.items():
        rows = [" ".join(repr(x) for x in row) + " 1" for row in table.tolist()]
        blocks += [name, str(len(rows)), *rows]
    return "\n".join(blocks)


@pytest.mark.parametrize("name", ["box", "ellipsoid"])
def test_mesh_with_faces_and_tets_turned_at_random_loads_outward(tmp_path, name):
    vertices, faces, tets = load_mesh_file(DATA / f"{name}.mesh")
    generator = np.random.default_rng(20)
    flipFace, flipTet = generator.random(len(faces)) < 0.5, generator.random(len(tets)) < 0.5
    assert flipFace.any() and not flipFace.all() and flipTet.any()
    mixedFaces = np.where(flipFace[:, None], faces[:, ::-1], faces)
    mixedTets = np.where(flipTet[:, None], tets[:, [1, 0, 2, 3]], tets)
    path = write(tmp_path, "mixed.mesh", medit(vertices, mixedFaces, mixedTets))
    loaded = load_mesh_file(path)
    assert_is_body(*loaded)
    np.testing.assert_array_equal(loaded[1], faces)


# --------------------------------------------------------------------------------------------------
# .off
# --------------------------------------------------------------------------------------------------

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


def prism(outline, height):
    """OFF text of an upright prism over a polygon, given counter-clockwise as (x, z) pairs."""
    n = len(outline)
    vertices = [(x, y, z) for y in (0.0, height) for x, z in outline]
    # The outline turns from x to z; seen from above, along -y, that is clockwise.
    sides = [[i, i + n, (i + 1) % n + n, (i + 1) % n] for i in range(n)]
    triangles = triangulate(outline)
    caps = triangles + [[c + n for c in reversed(face)] for face in triangles]
    faces = [f"{len(face)} {' '.join(map(str, face))}" for face in sides + caps]
    rows = [" ".join(map(str, vertex)) for vertex in vertices]
    return "\n".join(["OFF", f"{2 * n} {len(faces)} 0", *rows, *faces])


def triangulate(outline):
    """Triangles of a simple polygon, by cutting off one ear after the other."""

    def area(a, b, c):
        return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])

    left, triangles = list(range(len(outline))), []
    while len(left) > 2:
        for k in range(len(left)):
            i, j, m = left[k - 1], left[k], left[(k + 1) % len(left)]
            a, b, c = outline[i], outline[j], outline[m]
            inside = [
                p for p in left if p not in (i, j, m) and min(
                    area(a, b, outline[p]), area(b, c, outline[p]), area(c, a, outline[p])) >= 0
            ]  # fmt: skip
            if area(a, b, c) > 0 and not inside:
                triangles.append([i, j, m])
                left.pop(k)
                break
    return triangles


# An L of three unit squares' width: its corners' mean (4/3, 4/3) lies outside of it, and all of it
# is seen from the unit square at the corner. Its area is 3 + 2 = 5.
L_OUTLINE = [(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)]
# A U: what sees all of one leg's inside does not see the other's.
U_OUTLINE = [(0, 0), (3, 0), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)]


def test_off_polygons_are_cut_into_fans_and_filled_from_the_mean(tmp_path):
    vertices, faces, tets = mesh = load_mesh_file(write(tmp_path, "cube.off", CUBE))
    assert_is_body(*mesh)
    assert (len(vertices), len(faces), len(tets)) == (9, 12, 12)
    assert vertices[8].tolist() == [0.5, 0.5, 0.5]
    assert faces[:2].tolist() == [[3, 2, 1], [3, 1, 0]]
    assert np.sum(tetrahedron_volumes(vertices, tets)) == pytest.approx(1.0, rel=ROUNDING)


@pytest.mark.parametrize(
    "variant",
    [
        pytest.param(lambda text: text.replace("8 6 12", "8 6"), id="two counts"),
        pytest.param(lambda text: text.replace("OFF\n8", "OFF 8"), id="counts beside OFF"),
        pytest.param(lambda text: text.replace("4 3 2 1 0", "4 3 2 1 0 255 0 0"), id="colour"),
    ],
)
def test_off_variants_load_alike(tmp_path, variant):
    reference = load_mesh_file(write(tmp_path, "reference.off", CUBE))
    mesh = load_mesh_file(write(tmp_path, "variant.off", variant(CUBE)))
    assert as_tables(mesh) == as_tables(reference)


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_off_with_faces_turned_at_random_loads_outward(tmp_path, share):
    vertices, faces, _ = load_mesh_file(DATA / "ellipsoid.mesh")
    turn = np.random.default_rng(21).random(len(faces)) < share
    turned = np.where(turn[:, None], faces[:, ::-1], faces)
    rows = [" ".join(map(repr, row)) for row in vertices.tolist()]
    rows += [f"3 {a} {b} {c}" for a, b, c in turned.tolist()]
    text = "\n".join(["OFF", f"{len(vertices)} {len(faces)}", *rows])
    loaded = load_mesh_file(write(tmp_path, "turned.off", text))
    assert_is_body(*loaded)
    np.testing.assert_array_equal(loaded[1], faces)


def test_off_with_an_outline_that_is_seen_from_a_corner_only(tmp_path):
    vertices, _, tets = mesh = load_mesh_file(write(tmp_path, "L.off", prism(L_OUTLINE, 2.0)))
    assert_is_body(*mesh)
    # The kernel is the box [0, 1] × [0, 2] × [0, 1]: at most 1/2 from all planes.
    x, y, z = vertices[-1]
    assert (x, z) == (pytest.approx(0.5), pytest.approx(0.5)) and 0.5 <= y <= 1.5
    assert np.sum(tetrahedron_volumes(vertices, tets)) == pytest.approx(10.0, rel=ROUNDING)


# The least triangulation of the projective plane: every edge belongs to two triangles, and yet
# there is no inside.
PROJECTIVE_PLANE = """\
OFF
6 10 15
1 0 0
0 1 0
0 0 1
-1 0 0
0 -1 0
0 0 -1
3 0 1 2
3 0 2 3
3 0 3 4
3 0 4 5
3 0 5 1
3 1 2 4
3 2 3 5
3 3 4 1
3 4 5 2
3 5 1 3
"""


# --------------------------------------------------------------------------------------------------
# Scenes and constraints
# --------------------------------------------------------------------------------------------------

SCENE = """\
3
cube.off   50.0  0   0 10 0   2 0 0 0
cube.off  100    1   4 10.5 0  1 0 0 1
t.mesh     7     0   0 20 -3.25   0.5 0.5 0.5 0.5
"""


@pytest.fixture
def sceneFolder(tmp_path):
    """A folder with a scene of two meshes and three bodies, and a constraint file."""
    write(tmp_path, "cube.off", CUBE)
    write(tmp_path, "t.mesh", TETRAHEDRON)
    write(tmp_path, "a-scene.txt", SCENE)
    write(tmp_path, "a-constraints.txt", "1\n0 1 1 2 0.5 1.25\n")
    return tmp_path


def test_scene_bodies_have_names_poses_and_masses(sceneFolder):
    first, second, third = load_scene_file(sceneFolder / "a-scene.txt")
    assert [m.name for m in (first, second, third)] == ["cube 0", "cube 1", "t 2"]
    assert (first.mass, third.mass) == (pytest.approx(50.0), pytest.approx(7.0))
    assert second.isFixed and second.invMass == 0.0 and not first.isFixed
    assert first.orientation.tolist() == [[1, 0, 0, 0]]
    np.testing.assert_allclose(second.orientation, [[math.sqrt(0.5), 0, 0, math.sqrt(0.5)]])
    # A quarter turn about z takes the corner (1/2, -1/2, -1/2) of the cube to (1/2, 1/2, -1/2).
    np.testing.assert_allclose(second.currVertices[1], [4.5, 11.0, -0.5], atol=1e-14)


LEGAL_TEXT = {
    "CR-LF": lambda text: text.replace("\n", "\r\n"),
    "CR": lambda text: text.replace("\n", "\r"),
    "byte-order mark": lambda text: "\ufeff" + text,
    "tabs": lambda text: text.replace(" ", "\t \t"),
    "blank lines": lambda text: "\n\n" + text.replace("\n", "\n \n"),
    "comments": lambda text: "# Würfel, 立方体\n" + text.replace("\n", "  # and so\n"),
    "no line end at the end": lambda text: text.rstrip("\n"),
    "form feeds": lambda text: text.replace("\n", " \x0c\n"),
}


@pytest.mark.parametrize("name", ["a-scene.txt", "t.mesh", "cube.off", "a-constraints.txt"])
@pytest.mark.parametrize("variant", LEGAL_TEXT)
def test_legal_variant_of_a_text_file_loads_alike(sceneFolder, name, variant):
    def load():
        meshes = load_scene_file(sceneFolder / "a-scene.txt")
        arrays = [as_tables((m.currVertices, m.faces, m.tets, m.orientation)) for m in meshes]
        return arrays, load_constraint_file(sceneFolder / "a-constraints.txt", meshes)

    before, path = load(), sceneFolder / name
    write(sceneFolder, name, LEGAL_TEXT[variant](path.read_text()))
    assert load() == before


def test_scene_reads_each_mesh_file_once(sceneFolder, monkeypatch):
    read = []

    def counting(path):
        read.append(path.name)
        return load_mesh_file(path)

    monkeypatch.setattr("rbs.scenes.load_mesh_file", counting)
    load_scene_file(sceneFolder / "a-scene.txt")
    assert read == ["cube.off", "t.mesh"]


def test_bodies_with_one_mesh_file_share_no_array(sceneFolder):
    first, second, _ = load_scene_file(sceneFolder / "a-scene.txt")
    for name in ("origVertices", "currVertices", "faces", "tets"):
        assert not np.shares_memory(getattr(first, name), getattr(second, name))


def test_scene_finds_its_meshes_whatever_the_current_folder_is(sceneFolder, monkeypatch):
    monkeypatch.chdir(sceneFolder)
    assert len(load_scene_file("a-scene.txt")) == 3
    (sceneFolder / "below a blank").mkdir()
    monkeypatch.chdir(sceneFolder / "below a blank")
    assert len(load_scene_file("../a-scene.txt")) == 3


def test_dented_mesh_gives_one_warning_with_both_volumes(sceneFolder):
    write(sceneFolder, "L.off", prism(L_OUTLINE, 2.0))
    rows = [f"L.off 1 0 0 {10 * k} 0 1 0 0 0" for k in range(3)]
    path = write(sceneFolder, "b-scene.txt", "\n".join(["3", *rows]))
    with pytest.warns(NonConvexWarning) as warned:
        load_scene_file(path)
    # The hull closes the triangle between (3, 1) and (1, 3): 2 more in area, and twice the volume.
    assert [str(w.message) for w in warned] == [
        "L.off is not convex (volume 10, its convex hull 14): it collides as its hull"
    ]


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_convexity_tolerance_is_the_stated_one(sceneFolder, factor):
    # A pyramid of depth h is taken out of the cube's top, of area 1: volume 1 - h/3.
    depth = 3.0 * factor * CONVEXITY_TOLERANCE
    lines = CUBE.replace("8 6 12", "9 9 16").splitlines()
    lines.remove("4 2 3 7 6")
    lines.insert(10, f"0.5 {1 - depth} 0.5")
    lines += [f"3 {a} {b} 8" for a, b in ((2, 3), (3, 7), (7, 6), (6, 2))]
    write(sceneFolder, "dent.off", "\n".join(lines))
    path = write(sceneFolder, "b-scene.txt", "1\ndent.off 1 0 0 0 0 1 0 0 0\n")
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        (mesh,) = load_scene_file(path)
    assert mesh.volume == pytest.approx(1.0 - depth / 3.0, rel=ROUNDING)
    assert len(warned) == (factor > 1)


def test_constraint_line_becomes_a_lower_and_an_upper_bound(sceneFolder):
    meshes = load_scene_file(sceneFolder / "a-scene.txt")
    # Corner (1, 0, 0) of the first cube, whose centre is at (0, 10, 0), stands at
    # (0.5, 9.5, -0.5). Corner (1, 1, 0) of the second one, turned by a quarter about z, at
    # (4 - 0.5, 10.5 + 0.5, -0.5). Their distance: √(3² + 1.5²).
    lower, upper = load_constraint_file(sceneFolder / "a-constraints.txt", meshes)
    distance = math.sqrt(11.25)
    assert lower == [0, 1, 1, 2, pytest.approx(0.5 * distance), False]
    assert upper == [0, 1, 1, 2, pytest.approx(1.25 * distance), True]


def test_constraint_file_may_hold_none(sceneFolder):
    meshes = load_scene_file(sceneFolder / "a-scene.txt")
    for text in ("0", "0\n", "# none\r\n\r\n0  # bounds\r\n\n"):
        assert load_constraint_file(write(sceneFolder, "none.txt", text), meshes) == []
    # Coincident vertices, here one and the same, have bounds of zero.
    path = write(sceneFolder, "zero.txt", "1\n1 3 1 3 1 2\n")
    assert load_constraint_file(path, meshes) == [[1, 3, 1, 3, 0.0, False], [1, 3, 1, 3, 0.0, True]]


def test_constraints_of_a_scene_are_found_by_its_name(sceneFolder):
    assert find_constraints(sceneFolder / "a-scene.txt") == sceneFolder / "a-constraints.txt"
    assert find_constraints(str(sceneFolder / "a-scene.txt")) == sceneFolder / "a-constraints.txt"
    assert find_constraints(sceneFolder / "b-scene.txt") is None
    # A scene may have any name.
    assert find_constraints(sceneFolder / "a.txt") == sceneFolder / "a-constraints.txt"


def test_constraints_refer_to_the_bodies_as_they_stand_now(sceneFolder):
    meshes = load_scene_file(sceneFolder / "a-scene.txt")
    meshes[0].currVertices = meshes[1].currVertices[[2, 2, 2, 2, 2, 2, 2, 2, 2]] + [0, 3, 4]
    lower, _ = load_constraint_file(sceneFolder / "a-constraints.txt", meshes)
    assert lower[4] == pytest.approx(0.5 * 5.0)


def test_flattened_bodies_are_one_surface(sceneFolder):
    meshes = load_scene_file(sceneFolder / "a-scene.txt")
    meshes[2].currVertices = meshes[2].currVertices + [0.0, 100.0, 0.0]
    vertices, faces, bodyOfFace = flatten_meshes(meshes)
    assert vertices.shape == (9 + 9 + 5, 3) and faces.shape == (12 + 12 + 6, 3)
    for body, mesh in enumerate(meshes):
        np.testing.assert_array_equal(
            vertices[faces[bodyOfFace == body]], mesh.currVertices[mesh.faces]
        )
    vertices[:] = 0.0
    assert np.any(meshes[0].currVertices != 0.0)


def test_nothing_flattens_to_nothing():
    vertices, faces, bodyOfFace = flatten_meshes([])
    assert vertices.shape == (0, 3) and faces.shape == (0, 3) and bodyOfFace.shape == (0,)


def test_scenes_are_found_by_path_and_by_bare_name(sceneFolder, monkeypatch):
    monkeypatch.chdir(sceneFolder)
    assert find_scene("tower") == DATA / "tower-scene.txt"
    assert load_scene_file(find_scene("a-scene.txt"))[0].name == "cube 0"
    assert scene_name(find_scene("tower")) == "tower" and scene_name("some/thing.txt") == "thing"
    with pytest.raises(SceneError, match=r"^a: there is no such scene.* which --help lists$"):
        find_scene("a")  # of this folder, not of data/: only by its file's name
    with pytest.raises(SceneError, match=r"which --help lists; similar: mixed$"):
        find_scene("mxied")
    with pytest.raises(SceneError, match="there is no such scene"):
        find_scene("../data/tower")
    (sceneFolder / "tower").mkdir()  # does not hide the scene
    assert find_scene("tower") == find_file("tower", ".") == DATA / "tower-scene.txt"


# --------------------------------------------------------------------------------------------------
# What cannot be loaded
# --------------------------------------------------------------------------------------------------
#
# Each case: which file is broken, how, and how the error reads after the file's path.


def replaced(old, new, count=1):
    """A function that replaces the first `count` occurrences, and sees to it that there is one."""

    def change(text):
        assert old in text
        return text.replace(old, new, count)

    return change


BROKEN = {
    # any text file
    "empty": ("t.mesh", lambda _: "", ": the file is empty"),
    "blank": ("a-scene.txt", lambda _: "\n \t\n# nothing\n", ": the file is empty"),
    "binary": ("cube.off", lambda _: b"\x89PNG\0\0\x1a", ": this is not a text file"),
    "not UTF-8": ("a-scene.txt", lambda _: b"3\n\xff\xfe", ": this is not a text file"),
    "NUL": ("a-constraints.txt", lambda text: text + "\0", ": this is not a text file"),
    "orders to the terminal": ("a-scene.txt", replaced("50.0", "\x1b]0;x\x07"),
                               ":2: the density must be a number, not ' ]0;x '"),
    "endless word": ("a-scene.txt", replaced("50.0", "9" * 500 + "x"),
                     f":2: the density must be a number, not '{'9' * 37}...'"),
    # .mesh
    "mesh: header": ("t.mesh", replaced("MeshVersion", "Mesh"),
                     ":1: a .mesh file starts with MeshVersionFormatted"),
    "mesh: flat": ("t.mesh", replaced("Dimension 3", "Dimension 2"),
                   ":2: the dimension must be 3, not 2"),
    "mesh: ends early": ("t.mesh", lambda text: text[: text.index("0 2 0 1")],
                         ":6: the file ends before row Vertices 3 of 5"),
    "mesh: count too large": ("t.mesh", replaced("Vertices\n5", "Vertices\n6"),
                              ":10: row Vertices 6 of 6 takes 4 columns, not 1: 'Triangles'"),
    "mesh: count too small": ("t.mesh", replaced("Vertices\n5", "Vertices\n4"),
                              ":9: expected the name of a section, not '0 0 1.5 1'"),
    "mesh: count negative": ("t.mesh", replaced("Vertices\n5", "Vertices\n-5"),
                             ":4: the number of Vertices must be at least 0, not -5"),
    "mesh: count is text": ("t.mesh", replaced("Vertices\n5", "Vertices\nfive"),
                            ":4: the number of Vertices must be a whole number, not 'five'"),
    "mesh: count of 5000 digits": ("t.mesh", replaced("Vertices\n5", "Vertices\n" + "5" * 5000),
                                   ":4: the number of Vertices must be a whole number, not '555"),
    "mesh: dimension cut off": ("t.mesh", lambda _: "MeshVersionFormatted 1\nDimension\n",
                                ":2: the file ends before the dimension"),
    "mesh: underscore": ("t.mesh", replaced("0 0 3 1", "0 0 3_0 1"),
                         ":8: a coordinate must be a number, not '3_0'"),
    "mesh: other digits": ("t.mesh", replaced("0 0 3 1", "0 0 ٣ 1"),
                           ":8: a coordinate must be a number, not '٣'"),
    "mesh: reference is text": ("t.mesh", replaced("0 2 0 1", "0 2 0 wall"),
                                ":7: the reference number must be a number, not 'wall'"),
    "mesh: too far": ("t.mesh", replaced("0 2 0 1", "0 2e10 0 1"),
                      ":7: a coordinate must not exceed 1e+09, as '2e10' does"),
    "mesh: column too many": ("t.mesh", replaced("0 2 0 1", "0 2 0 1 1"),
                              ":7: row Vertices 3 of 5 takes 4 columns, not 5: '0 2 0 1 1'"),
    "mesh: text for a number": ("t.mesh", replaced("0 2 0 1", "0 two 0 1"),
                                ":7: a coordinate must be a number, not 'two'"),
    "mesh: NaN": ("t.mesh", replaced("0 2 0 1", "0 nan 0 1"),
                  ":7: a coordinate must be finite, not 'nan'"),
    "mesh: index 0": ("t.mesh", replaced("1 3 2 1", "0 3 2 1"),
                      ":12: a vertex index must be between 1 and 5, not 0"),
    "mesh: vertex twice": ("t.mesh", replaced("1 3 2 1", "1 3 3 1"),
                           ":12: a vertex is used twice: '1 3 3'"),
    "mesh: no tetrahedra": ("t.mesh", lambda text: text[: text.index("Tetrahedra")],
                            ": there are no Tetrahedra"),
    "mesh: no triangles": ("t.mesh", lambda t: t[:t.index("Tri")] + t[t.index("Tet"):],
                           ": there are no Triangles"),
    "mesh: no vertices": ("t.mesh", lambda _: "MeshVersionFormatted 1\nVertices\n0\nEnd",
                          ": there are no Vertices"),
    "mesh: faces first": ("t.mesh", replaced("Vertices", "Triangles"),
                          ":3: the section Triangles comes before the section Vertices"),
    "mesh: section twice": ("t.mesh", replaced("Tetrahedra", "Triangles"),
                            ":18: there is a second section Triangles"),
    "mesh: loose face": ("t.mesh", replaced("1 3 2 1", "1 3 4 1"),
                         ":12: triangle 1 is not a face of any tetrahedron"),
    "mesh: no volume": ("t.mesh", lambda text: text.replace("0 0 3 1", "3 3 0 1")
                        .replace("0 0 1.5 1", "2 0 0 1"), ": the mesh has no volume"),
    "mesh: flat tetrahedron": ("t.mesh", replaced("0 0 1.5 1", "0.2 0.2 0 1"),
                               ":20: the tetrahedron is flat"),
    "mesh: not closed": ("t.mesh", lambda t: t.replace("1 3 2 1\n", "").replace("s\n6", "s\n5"),
                         ":12: the surface is not closed: the edge between the vertices 1 and 2 "
                         "belongs to 1 triangle, not to 2"),
    "mesh: triangle twice": ("t.mesh", lambda t: t.replace("1 3 2 1\n", "1 3 2 1\n2 1 3 1\n")
                             .replace("s\n6", "s\n7"),
                             ":13: triangle 2 is the same as triangle 1"),
    "mesh: tetrahedron twice": ("t.mesh", replaced("a\n2\n", "a\n3\n1 2 3 5 1\n"),
                                ": the triangles enclose a volume of 1, the tetrahedra have 1.5"),
    # .off
    "off: header": ("cube.off", replaced("OFF", "COFF"), ":1: an .off file starts with OFF"),
    "off: one count": ("cube.off", replaced("8 6 12", "8"),
                       ":2: expected the numbers of vertices and faces: '8'"),
    "off: few vertices": ("cube.off", replaced("8 6 12", "3 6 12"),
                          ":2: the number of vertices must be at least 4, not 3"),
    "off: few faces": ("cube.off", replaced("8 6 12", "8 3 12"),
                       ":2: the number of faces must be at least 4, not 3"),
    "off: vertices end": ("cube.off", replaced("8 6 12", "9 6 12"),
                          ":11: vertex 9 of 9 takes 3 columns, not 5: '4 3 2 1 0'"),
    "off: NaN": ("cube.off", replaced("1 1 0", "1 nan 0"),
                 ":5: a coordinate must be finite, not 'nan'"),
    "off: corner twice": ("cube.off", replaced("4 4 5 6 7", "4 4 5 6 6"),
                          ":12: a vertex is used twice: '4 5 6 6'"),
    "off: face too short": ("cube.off", replaced("4 4 5 6 7", "4 4 5 6"),
                            ":12: a face of 4 corners has only 3"),
    "off: face of two": ("cube.off", replaced("4 4 5 6 7", "2 4 5"),
                         ":12: the number of a face's corners must be at least 3, not 2"),
    "off: index": ("cube.off", replaced("4 4 5 6 7", "4 4 5 6 8"),
                   ":12: a vertex index must be between 0 and 7, not 8"),
    "off: missing face": ("cube.off", lambda text: text.replace("6 12", "5 12")
                          .replace("4 3 0 4 7\n", ""),
                          ": the surface is not closed: the edge between the vertices 0 and 3 "
                          "belongs to 1 triangle, not to 2"),
    "off: face too many": ("cube.off", lambda text: text + "3 0 1 2\n",
                           ":17: more lines than the 6 faces announced: '3 0 1 2'"),
    "off: no inside": ("cube.off", lambda _: PROJECTIVE_PLANE,
                       ": the surface has no inside: it cannot be turned consistently"),
    "off: no kernel": ("cube.off", lambda _: prism(U_OUTLINE, 1.0),
                       ": the surface cannot be filled from one point"),
    "off: flat": ("cube.off", lambda text: text.replace(" 1\n", " 0\n"),
                  ": the surface cannot be filled from one point"),
    # scenes
    "scene: no count": ("a-scene.txt", replaced("3\n", ""),
                        ":1: this is not a scene: the number of bodies takes 1 column, not 10"),
    "scene: no bodies": ("a-scene.txt", lambda _: "0\n",
                         ":1: this is not a scene: the number of bodies must be at least 1, not 0"),
    "scene: count too small": ("a-scene.txt", replaced("3\n", "2\n"),
                               ":4: more lines than the 2 bodies announced: 't.mesh 7 0"),
    "scene: column missing": ("a-scene.txt", replaced("2 0 0 0", "2 0 0"),
                              ":2: body 1 of 3 takes 10 columns, not 9: 'cube.off 50.0 0"),
    "scene: no density": ("a-scene.txt", replaced("50.0", "0"),
                          ":2: the density must be positive, not 0"),
    "scene: column too many": ("a-scene.txt", replaced("50.0", "50.0 1"),
                               ":2: body 1 of 3 takes 10 columns, not 11: 'cube.off 50.0 1 0"),
    "scene: huge density": ("a-scene.txt", replaced("50.0", "1e308"),
                            ":2: the density must not exceed 1e+30, as '1e308' does"),
    "scene: tiny density": ("a-scene.txt", replaced("50.0", "1e-320"),
                            ":2: this cannot be a body: its mass, 9.99989e-321, is beyond"),
    "scene: too far": ("a-scene.txt", replaced("10.5", "-1e300"),
                       ":3: a coordinate must not exceed 1e+09, as '-1e300' does"),
    "scene: isFixed": ("a-scene.txt", replaced("  1   4", "  2   4"),
                       ":3: isFixed must be between 0 and 1, not 2"),
    "scene: NaN": ("a-scene.txt", replaced("10.5", "NaN"),
                   ":3: a coordinate must be finite, not 'NaN'"),
    "scene: zero quaternion": ("a-scene.txt", replaced("2 0 0 0", "0 0 0 0"),
                               ":2: the quaternion must not be zero"),
    "scene: mesh missing": ("a-scene.txt", replaced("t.mesh", "u.mesh"),
                            ":4: there is no mesh file 'u.mesh' beside the scene"),
    "scene: mesh of another kind": ("a-scene.txt", replaced("t.mesh", "a-scene.txt"),
                                    ": the name of a mesh file must end in .mesh or .off"),
    # constraints
    "constraints: column": ("a-constraints.txt", replaced("0.5 1.25", "0.5"),
                            ":2: constraint 1 of 1 takes 6 columns, not 5: '0 1 1 2 0.5'"),
    "constraints: mesh": ("a-constraints.txt", replaced("0 1 1 2", "0 1 3 2"),
                          ":2: a mesh index must be between 0 and 2, not 3"),
    "constraints: vertex": ("a-constraints.txt", replaced("0 1 1 2", "0 9 1 2"),
                            ":2: a vertex index must be between 0 and 8, not 9"),
    "constraints: bounds": ("a-constraints.txt", replaced("0.5 1.25", "1.25 0.5"),
                            ":2: the bounds must be 0 ≤ lower ≤ upper, not 1.25 and 0.5"),
    "constraints: NaN": ("a-constraints.txt", replaced("0.5 1.25", "nan 1"),
                         ":2: a bound must be finite, not 'nan'"),
    "constraints: huge bound": ("a-constraints.txt", replaced("0.5 1.25", "0.5 1e308"),
                                ":2: the upper bound 1e308 is beyond reckoning"),
    "constraints: count": ("a-constraints.txt", replaced("1\n", "2\n"),
                           ":2: the file ends before constraint 2 of 2"),
    "constraints: too many": ("a-constraints.txt", replaced("1.25\n", "1.25\n0 0 1 0 0 1\n"),
                              ":3: more lines than the 1 constraints announced: '0 0 1 0 0 1'"),
    "constraints: negative count": ("a-constraints.txt", replaced("1\n", "-1\n"),
                                    ":1: the number of constraints must be at least 0, not -1"),
}  # fmt: skip


@pytest.mark.parametrize("case", BROKEN)
def test_broken_file_is_named_with_line_and_cause(sceneFolder, case):
    name, change, message = BROKEN[case]
    path = sceneFolder / name
    meshes = load_scene_file(sceneFolder / "a-scene.txt")
    write(sceneFolder, name, change(path.read_text()))
    with pytest.raises(SceneError) as raised:
        if name.endswith("-constraints.txt"):
            load_constraint_file(path, meshes)
        else:
            load_scene_file(sceneFolder / "a-scene.txt")
    error = str(raised.value)
    assert error.startswith(f"{path}{message}")
    assert "\n" not in error


def test_missing_and_unreadable_files_are_named(tmp_path):
    (tmp_path / "folder.mesh").mkdir()
    for path, cause in [
        (tmp_path / "none.mesh", "there is no such file"),
        (tmp_path / "none-scene.txt", "there is no such file"),
        (tmp_path / "folder.mesh", "this is a folder, not a file"),
        (tmp_path / "m.obj", "the name of a mesh file must end in .mesh or .off"),
    ]:
        load = load_scene_file if str(path).endswith(".txt") else load_mesh_file
        with pytest.raises(SceneError) as raised:
            load(path)
        assert str(raised.value) == f"{path}: {cause}"


def test_paths_may_be_str_or_path(sceneFolder):
    path = sceneFolder / "t.mesh"
    assert as_tables(load_mesh_file(str(path))) == as_tables(load_mesh_file(path))
