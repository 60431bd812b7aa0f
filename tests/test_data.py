"""The meshes and scenes under data/: made by data/make_data.py, and what they promise.

The files are read by two small parsers of this test's own, so that a fault in the project's
loaders cannot hide one in the data.
"""

import itertools
import math
import shutil
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

DATA = Path(__file__).resolve().parent.parent / "data"

# Per mesh: the number of vertices; how many of them lie in the plane of a face (3 where all faces
# are triangles, 4 in a box's side, 20 in the cylinder's caps); and the volume in closed form.
MESHES = {
    "tetrahedron.mesh": (4, {3}, 8 * 7 * 6 / 3),            # alternate corners of a box
    "box.mesh": (8, {4}, 12 * 6 * 8),
    "octahedron.mesh": (6, {3}, 4 / 3 * 3.4**3),
    "long-octahedron.mesh": (6, {3}, 4 / 3 * 10.4 * 10.4 * 1.4),
    "cylinder.mesh": (40, {4, 20}, 20 * 5**2 / 2 * math.sin(2 * math.pi / 20) * 20),
    "ellipsoid.mesh": (162, {3}, None),
    "ball.mesh": (42, {3}, None),
    "slab.mesh": (8, {4}, 48 * 2 * 14),
    "card.mesh": (8, {4}, 14 * 0.4 * 10),
    "voussoir.mesh": (8, {4}, math.sin(math.pi / 15) / 2 * (42**2 - 34**2) * 14),
    "ring_block.mesh": (8, {4}, math.tan(math.pi / 6) * (11**2 - 5**2) * 6),
    "tray_block.mesh": (8, {4}, 53 / 64 * (3 * 26**2 - (23**3 - 22**3))),
    **{f"dome_block_{ring}.mesh": (8, {4}, None) for ring in (1, 2, 3, 4)},
}

# Per scene: the number of bodies, and how many of them are fixed.
SCENES = {
    "singletet": (1, 0), "singlebox": (1, 0), "single_cylinder": (1, 0), "two_cylinder": (2, 0),
    "tet": (25, 0), "mixed": (15, 8), "tower": (9, 0), "stress": (41, 16), "cube": (8, 0),
    "tower_chain": (9, 1), "two_chain": (33, 10),
    "bridge": (18, 2), "net": (403, 4), "wrecking_ball": (12, 2),
    "incline": (4, 2), "slide": (8, 5), "roll": (7, 4), "settle": (4, 1),
    "stack": (20, 0), "pyramid": (120, 0), "dominoes": (10, 0),
    "arch": (15, 0), "arch_blow": (16, 0), "dome": (44, 0), "round_tower": (67, 0),
    "card_house": (15, 0), "wall": (59, 1), "ramp": (4, 2), "cradle": (15, 10),
    "loaded_bridge": (22, 2), "loaded_net": (418, 4),
}

# Per constraint file: the number of ties.
TIES = {
    "two_cylinder": 2, "cube": 28, "tower_chain": 8, "two_chain": 16,
    "bridge": 28, "net": 2 * 20 * 19, "wrecking_ball": 6, "wall": 6, "cradle": 10,
    "loaded_bridge": 28, "loaded_net": 2 * 20 * 19,
}

FILES = [*MESHES, "box.off", *(f"{name}-scene.txt" for name in SCENES),
         *(f"{name}-constraints.txt" for name in TIES)]

# The data's coordinates are rounded to 1e-9 m. On bodies some metres in size this changes a volume
# by at most about 1e-9 of itself.
ROUNDED_COORDINATES = 1e-9
# A sum of a few hundred products in double precision.
ROUNDING = 1e-13


def read_mesh(path):
    """Read MEDIT text strictly: (V, 3) vertices, (F, 3) faces, (T, 4) tets, zero-based."""
    lines = iter(path.read_text().split("\n"))
    assert [next(lines), next(lines)] == ["MeshVersionFormatted 1", "Dimension 3"]
    sections = []
    for title, columns in (("Vertices", 4), ("Triangles", 4), ("Tetrahedra", 5)):
        assert next(lines) == title
        rows = [next(lines).split() for _ in range(int(next(lines)))]
        assert {len(row) for row in rows} == {columns}
        sections.append([row[:-1] for row in rows])     # without the reference number
    assert list(lines) == ["End", ""]
    vertices, faces, tets = sections
    return np.array(vertices, float), np.array(faces, int) - 1, np.array(tets, int) - 1


def read_off(path):
    """Read a triangulated OFF surface: (V, 3) vertices, (F, 3) faces."""
    lines = path.read_text().splitlines()
    assert lines[0] == "OFF"
    vertexCount, faceCount, _ = map(int, lines[1].split())
    assert len(lines) == 2 + vertexCount + faceCount
    faces = np.array([line.split() for line in lines[2 + vertexCount:]], int)
    assert (faces[:, 0] == 3).all()
    return np.array([line.split() for line in lines[2:2 + vertexCount]], float), faces[:, 1:]


def read_scene(path):
    """Read a scene: a list of (meshFile, density, isFixed, position (3,), orientation (4,))."""
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    assert len(lines) == 1 + int(lines[0])
    bodies = []
    for line in lines[1:]:
        meshFile, density, isFixed, *numbers = line.split()
        assert isFixed in ("0", "1")
        assert len(numbers) == 7
        numbers = np.array(numbers, float)
        bodies.append((meshFile, float(density), isFixed == "1", numbers[:3], numbers[3:]))
    return bodies


def tet_volumes(vertices, tets):
    """Signed volumes (T,)."""
    a, b, c, d = vertices[tets].transpose(1, 0, 2)
    return np.linalg.det(np.stack([b - a, c - a, d - a], axis=1)) / 6


def exact_heights(vertices, faces):
    """Height of each vertex over each outward face plane times a positive number: (F, V) ints.

    A double is an integer over a power of two, so that scaled by one such power all coordinates
    are Python integers, and the result is exact.
    """
    scale = max(Fraction(x).denominator for x in vertices.flat)
    points = np.array([int(Fraction(x) * scale) for x in vertices.flat], object).reshape(-1, 3)
    a, b, c = points[faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    return normals @ points.T - (normals * a).sum(axis=1)[:, None]


@pytest.fixture(scope="module", params=[*MESHES, "box.off"])
def surface(request):
    """(file name, vertices, faces) of each mesh file."""
    read = read_off if request.param.endswith(".off") else read_mesh
    return request.param, *read(DATA / request.param)[:2]


@pytest.mark.parametrize("givesFolder", [False, True], ids=["beside the script", "--out"])
def test_script_reproduces_the_files(tmp_path, givesFolder):
    if givesFolder:
        folder = tmp_path / "new" / "folder"
        command = [sys.executable, str(DATA / "make_data.py"), "--out", str(folder)]
    else:
        folder = tmp_path / "data"
        folder.mkdir()
        command = [sys.executable, shutil.copy(DATA / "make_data.py", folder)]
    subprocess.run(command, cwd=tmp_path, check=True)

    made = {path.name for path in folder.iterdir()} - {"make_data.py"}
    assert made >= set(FILES)
    for name in made:
        assert (folder / name).read_bytes() == (DATA / name).read_bytes(), name
    assert {path.name for path in tmp_path.iterdir()} == {folder.relative_to(tmp_path).parts[0]}


def test_surface_is_exactly_convex_and_outward(surface):
    name, vertices, faces = surface
    vertexCount, planeSizes, _ = MESHES[name.replace(".off", ".mesh")]
    heights = exact_heights(vertices, faces)
    # No vertex stands over any face, not by one bit. A face turned inside out would have nearly
    # all of them over it.
    assert (heights <= 0).all()
    # The flat faces are exactly flat, and no other vertices happen to lie in one plane.
    assert set((heights == 0).sum(axis=1)) == planeSizes
    # Every vertex is a corner: at least three different planes meet there.
    planes = {tuple(np.flatnonzero(row)) for row in heights == 0}
    assert all(sum(i in plane for plane in planes) >= 3 for i in range(len(vertices)))
    assert len(vertices) == vertexCount == len(ConvexHull(vertices).vertices)


def test_surface_is_closed_and_two_manifold(surface):
    _, vertices, faces = surface
    edges = [edge for a, b, c in faces.tolist() for edge in ((a, b), (b, c), (c, a))]
    # Every edge is passed once in each direction: two triangles meet there, turned alike.
    assert len(edges) == len(set(edges))
    assert set(edges) == {(b, a) for a, b in edges}
    # Around each vertex the triangles form one ring: following the edge opposite to the vertex
    # from triangle to triangle comes back after all of them.
    for i in range(len(vertices)):
        following = {}
        for a, b, c in faces[(faces == i).any(axis=1)].tolist():
            following |= {b: c} if a == i else {c: a} if b == i else {a: b}
        corner, ring = next(iter(following)), []
        while corner not in ring:
            ring.append(corner)
            corner = following[corner]
        assert len(ring) == len(following) >= 3
    assert len(vertices) - len(edges) // 2 + len(faces) == 2        # Euler: one sphere


@pytest.mark.parametrize("name", MESHES)
def test_tets_are_positive_and_fill_the_hull(name):
    vertices, faces, tets = read_mesh(DATA / name)
    volumes = tet_volumes(vertices, tets)
    # Slivers would be positive too; our smallest, at the ellipsoid's vertex 0, is 8e-5 of it.
    assert volumes.min() > 5e-5 * volumes.sum()
    assert volumes.sum() == pytest.approx(ConvexHull(vertices).volume, rel=ROUNDING)
    # The tetrahedra's triangles cancel in pairs, but for those of the surface.
    triangles = [frozenset(t) for tet in tets.tolist() for t in itertools.combinations(tet, 3)]
    outer = {triangle for triangle in triangles if triangles.count(triangle) == 1}
    assert outer == {frozenset(face) for face in faces.tolist()}


@pytest.mark.parametrize("name", [name for name, mesh in MESHES.items() if mesh[2] is not None])
def test_volume_in_closed_form(name):
    vertices, _, tets = read_mesh(DATA / name)
    assert tet_volumes(vertices, tets).sum() == pytest.approx(MESHES[name][2],
                                                             rel=ROUNDED_COORDINATES)


def test_round_shapes_touch_what_they_approximate():
    cylinder, _, _ = read_mesh(DATA / "cylinder.mesh")
    assert np.hypot(cylinder[:, 0], cylinder[:, 1]) == pytest.approx(5, rel=ROUNDED_COORDINATES)
    assert set(cylinder[:, 2]) == {-10.0, 10.0}

    ellipsoid, faces, _ = read_mesh(DATA / "ellipsoid.mesh")
    sphere = ellipsoid / [2, 3, 5]
    assert np.linalg.norm(sphere, axis=1) == pytest.approx(1, rel=ROUNDED_COORDINATES)
    # Well spread: on the sphere no edge is longer than 1.3 times another, and the hull fills more
    # than 95 % of the ellipsoid.
    edges = np.linalg.norm(sphere[faces] - sphere[np.roll(faces, 1, axis=1)], axis=2)
    assert edges.max() < 1.3 * edges.min()
    assert 0.95 < ConvexHull(sphere).volume / (4 / 3 * math.pi) < 1


def test_blocks_make_a_whole_ring():
    """Blocks of a dome: as many sectors of a circle as there are, and as much of the next joint."""
    rings = [read_mesh(DATA / f"dome_block_{ring}.mesh")[0] for ring in (1, 2, 3, 4)]
    for vertices in rings:
        angles = np.arctan2(np.abs(vertices[:, 2]), vertices[:, 0])
        assert 0.9995 * math.pi / 11 < angles.min() and angles.max() < math.pi / 11
    for below, above in itertools.pairwise(rings):
        joints = [{tuple(vertex) for vertex in vertices} for vertices in (below, above)]
        assert len(joints[0] & joints[1]) == 4


def test_off_is_the_surface_of_the_mesh():
    offVertices, offFaces = read_off(DATA / "box.off")
    vertices, faces, _ = read_mesh(DATA / "box.mesh")
    assert np.array_equal(offVertices, vertices)
    assert np.array_equal(offFaces, faces)


def are_apart(points1, points2):
    """Whether two convex hulls do not touch: their Minkowski difference leaves the origin out."""
    differences = (points1[:, None] - points2[None]).reshape(-1, 3)
    return ConvexHull(differences).equations[:, 3].max() > 0    # n · x + d ≤ 0 inside each facet


def test_are_apart_can_tell():
    box = np.array(list(itertools.product([-1.0, 1.0], repeat=3)))
    assert are_apart(box, box + [2.001, 0, 0])
    assert not are_apart(box, box + [1.999, 1.9, 0])
    assert not are_apart(box, box)


@pytest.mark.parametrize("name", SCENES)
def test_scene(name):
    bodies = read_scene(DATA / f"{name}-scene.txt")
    assert (len(bodies), sum(body[2] for body in bodies)) == SCENES[name]

    hulls = []
    for meshFile, density, _, position, orientation in bodies:
        assert density > 0
        # The centre of mass comes from the tetrahedra, so a box.off borrows those of box.mesh.
        vertices, _, tets = read_mesh(DATA / meshFile.replace(".off", ".mesh"))
        assert (DATA / meshFile).is_file()
        volumes = tet_volumes(vertices, tets)
        centre = np.average(vertices[tets].mean(axis=1), axis=0, weights=volumes)
        turn = Rotation.from_quat(orientation[[1, 2, 3, 0]])    # SciPy has the scalar part last
        hulls.append(turn.apply(vertices - centre) + position)
        assert hulls[-1][:, 1].min() > 0, "starts below the ground"

    for i, j in itertools.combinations(range(len(hulls)), 2):
        reach = sum(np.linalg.norm(hulls[k] - bodies[k][3], axis=1).max() for k in (i, j))
        if np.linalg.norm(bodies[i][3] - bodies[j][3]) <= reach:
            assert are_apart(hulls[i], hulls[j]), f"bodies {i} and {j} overlap"


def test_scenes_use_every_mesh():
    used = {body[0] for name in SCENES for body in read_scene(DATA / f"{name}-scene.txt")}
    assert used == {*MESHES, "box.off"}


@pytest.mark.parametrize("name", TIES)
def test_ties_name_vertices_of_their_scene(name):
    bodies = read_scene(DATA / f"{name}-scene.txt")
    count, *lines = (DATA / f"{name}-constraints.txt").read_text().splitlines()
    assert int(count) == len(lines) == TIES[name]
    vertexCounts = [len(read_mesh(DATA / body[0])[0]) for body in bodies]
    for line in lines:
        body1, vertex1, body2, vertex2, lower, upper = line.split()
        for body, vertex in ((body1, vertex1), (body2, vertex2)):
            assert 0 <= int(vertex) < vertexCounts[int(body)]
        assert body1 != body2
        assert 0 <= float(lower) <= float(upper)


def write_heap(path, count, *arguments):
    """A heap of data/make_pile.py."""
    command = [sys.executable, DATA / "make_pile.py", str(count), "--heap", *arguments]
    subprocess.run([*command, "--out", path], check=True)
    return path


@pytest.mark.parametrize("count, height", [(1, None), (60, None), (400, None), (1000, 130.0)])
def test_heap_is_packed_box_to_box(tmp_path, count, height):
    """Height: in metres, where it does not come from the width."""
    bodies = read_scene(write_heap(tmp_path / "heap.txt", count))
    assert len(bodies) == count and not any(body[2] for body in bodies)
    meshes = {name: read_mesh(DATA / name) for name in {body[0] for body in bodies}}
    low, high = np.empty((2, count, 3))
    for i, (meshFile, _, _, position, orientation) in enumerate(bodies):
        vertices, _, tets = meshes[meshFile]
        centre = np.average(
            vertices[tets].mean(axis=1), axis=0, weights=tet_volumes(vertices, tets)
        )
        turn = Rotation.from_quat(orientation[[1, 2, 3, 0]])    # SciPy has the scalar part last
        corners = turn.apply(vertices - centre) + position
        low[i], high[i] = corners.min(axis=0), corners.max(axis=0)
    # one row for each of two boxes: by how much they are apart, along the axis where that is most
    apart = np.maximum(low[:, None] - high, low - high[:, None]).max(axis=2)
    np.fill_diagonal(apart, math.inf)
    assert apart.min() > 0
    assert low[:, 1].min() > 0
    if count == 1:
        return
    # A block and no cloud: nearly every box has another one within some millimetres. A body that
    # is not its own mirror image leaves a part of its place empty, hence not every one.
    assert (apart.min(axis=1) < 0.01).mean() > 0.7
    width = (high - low.min(axis=0))[:, [0, 2]].max()
    assert high[:, 1].max() == pytest.approx(width if height is None else height, rel=0.2)
    assert height is None or width > height


def test_heaps_are_made_as_asked(tmp_path):
    """Same arguments, same bytes; the shapes take turns; another seed gives another heap."""
    scenes = [
        write_heap(tmp_path / f"{k}.txt", 90, "--seed", seed, "--shapes", "box", "slab", "ball")
        for k, seed in enumerate("335")
    ]
    first, again, other = (scene.read_bytes() for scene in scenes)
    assert first == again != other
    names = [body[0] for body in read_scene(scenes[0])]
    assert [names.count(f"{name}.mesh") for name in ("box", "slab", "ball")] == [30, 30, 30]
    both = [sys.executable, DATA / "make_pile.py", "9", "--heap", "--spread"]
    assert subprocess.run(both, capture_output=True).returncode == 2
