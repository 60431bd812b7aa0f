"""The meshes and scenes under data/: made by data/scripts/make_data.py, and what they promise.

The files are read by two small parsers of this test's own, so that a fault in the project's
loaders cannot hide one in the data.
"""

import itertools
import math
import subprocess
import sys
from fractions import Fraction
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

DATA = Path(__file__).resolve().parents[2] / "data"

# Per mesh: the number of vertices; how many of them lie in the plane of a face (3 where all faces
# are triangles, 4 in a box's side, 20 in the cylinder's caps); and the volume in closed form.
MESHES = {
    "tetrahedron.mesh": (4, {3}, 8 * 7 * 6 / 3),  # alternate corners of a box
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
# Made by make_pile.py, of which the heaps below are a test.
PILES = ("pile_200", "pile_1000", "heap")
SCENES = sorted(path.name.removesuffix("-scene.txt") for path in DATA.glob("*-scene.txt"))
# The data's coordinates are rounded to 1e-9 m. On bodies some metres in size this changes a volume
# by at most about 1e-9 of itself.
ROUNDED_COORDINATES = 1e-9
# A sum of a few hundred products in double precision.
ROUNDING = 1e-13


@lru_cache
def read_mesh(path):
    """Read MEDIT text strictly: (V, 3) vertices, (F, 3) faces, (T, 4) tets, zero-based."""
    lines = iter(path.read_text().split("\n"))
    assert [next(lines), next(lines)] == ["MeshVersionFormatted 1", "Dimension 3"]
    sections = []
    for title, columns in (("Vertices", 4), ("Triangles", 4), ("Tetrahedra", 5)):
        assert next(lines) == title
        rows = [next(lines).split() for _ in range(int(next(lines)))]
        assert {len(row) for row in rows} == {columns}
        sections.append([row[:-1] for row in rows])  # without the reference number
    assert list(lines) == ["End", ""]
    vertices, faces, tets = sections
    return np.array(vertices, float), np.array(faces, int) - 1, np.array(tets, int) - 1


def read_scene(path):
    """Read a scene: a list of (meshFile, density, isFixed, position (3,), orientation (4,))."""
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    assert len(lines) == 1 + int(lines[0])
    bodies = []
    for line in lines[1:]:
        meshFile, density, isFixed, *numbers = line.split()
        assert isFixed in ("0", "1") and len(numbers) == 7
        numbers = np.array(numbers, float)
        bodies.append((meshFile, float(density), isFixed == "1", numbers[:3], numbers[3:]))
    return bodies


def placed_corners(bodies):
    """The vertices of each body of a scene, (V, 3), in the world."""
    placed = []
    for meshFile, _, _, position, orientation in bodies:
        # The centre of mass comes from the tetrahedra, so a box.off borrows those of box.mesh.
        vertices, _, tets = read_mesh(DATA / meshFile.replace(".off", ".mesh"))
        centre = np.average(vertices[tets].mean(axis=1), axis=0, weights=volumes_of(vertices, tets))
        turn = Rotation.from_quat(orientation[[1, 2, 3, 0]])  # SciPy has the scalar part last
        placed.append(turn.apply(vertices - centre) + position)
    return placed


def volumes_of(vertices, tets):
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


def test_script_reproduces_the_files(tmp_path):
    folder = tmp_path / "new" / "folder"
    command = [sys.executable, DATA / "scripts" / "make_data.py", "--out", folder]
    subprocess.run(command, cwd=tmp_path, check=True)
    made = {path.name for path in folder.iterdir()}
    ours = {path.name for ending in ("mesh", "off", "txt") for path in DATA.glob(f"*.{ending}")}
    assert made == ours - {f"{name}-scene.txt" for name in PILES}
    for name in made:
        assert (folder / name).read_bytes() == (DATA / name).read_bytes(), name
    assert [path.name for path in tmp_path.iterdir()] == ["new"]


@pytest.mark.parametrize("name", MESHES)
def test_mesh_is_exactly_convex_closed_and_filled(name):
    vertices, faces, tets = read_mesh(DATA / name)
    vertexCount, planeSizes, volume = MESHES[name]
    heights = exact_heights(vertices, faces)
    # No vertex stands over any face, not by one bit.
    assert (heights <= 0).all()
    # The flat faces are exactly flat, and no other vertices happen to lie in one plane.
    assert set((heights == 0).sum(axis=1)) == planeSizes
    assert len(vertices) == vertexCount == len(ConvexHull(vertices).vertices)
    # Every edge is passed once in each direction: two triangles meet there, turned alike.
    edges = [edge for a, b, c in faces.tolist() for edge in ((a, b), (b, c), (c, a))]
    assert len(edges) == len(set(edges)) and set(edges) == {(b, a) for a, b in edges}
    assert len(vertices) - len(edges) // 2 + len(faces) == 2  # Euler: one sphere
    volumes = volumes_of(vertices, tets)
    # Slivers would be positive too; our smallest, at the ellipsoid's vertex 0, is 8e-5 of it.
    assert volumes.min() > 5e-5 * volumes.sum()
    assert volumes.sum() == pytest.approx(ConvexHull(vertices).volume, rel=ROUNDING)
    assert volume is None or volumes.sum() == pytest.approx(volume, rel=ROUNDED_COORDINATES)
    # The tetrahedra's triangles cancel in pairs, but for those of the surface.
    triangles = [frozenset(t) for tet in tets.tolist() for t in itertools.combinations(tet, 3)]
    outer = {triangle for triangle in triangles if triangles.count(triangle) == 1}
    assert outer == {frozenset(face) for face in faces.tolist()}


def are_apart(points1, points2):
    """Whether two convex hulls do not touch: their Minkowski difference leaves the origin out."""
    differences = (points1[:, None] - points2[None]).reshape(-1, 3)
    return ConvexHull(differences).equations[:, 3].max() > 0  # n · x + d ≤ 0 inside each facet


@pytest.mark.parametrize("name", [name for name in SCENES if name not in PILES])
def test_scene_starts_above_the_ground_with_its_bodies_apart(name):
    bodies = read_scene(DATA / f"{name}-scene.txt")
    hulls = placed_corners(bodies)
    assert min(hull[:, 1].min() for hull in hulls) > 0 and min(body[1] for body in bodies) > 0
    for i, j in itertools.combinations(range(len(hulls)), 2):
        reach = sum(np.linalg.norm(hulls[k] - bodies[k][3], axis=1).max() for k in (i, j))
        if np.linalg.norm(bodies[i][3] - bodies[j][3]) <= reach:
            assert are_apart(hulls[i], hulls[j]), f"bodies {i} and {j} overlap"


def test_heap_is_packed_box_to_box(tmp_path):
    """As high as it is wide."""
    words = "60", "--heap", "--out", tmp_path / "heap.txt"
    subprocess.run([sys.executable, DATA / "scripts/make_pile.py", *words], check=True)
    bodies = read_scene(tmp_path / "heap.txt")
    hulls = placed_corners(bodies)
    assert len(bodies) == 60 and not any(body[2] for body in bodies)
    low, high = (np.array([end(hull, axis=0) for hull in hulls]) for end in (np.min, np.max))
    # one row for each of two boxes: by how much they are apart, along the axis where that is most
    apart = np.maximum(low[:, None] - high, low - high[:, None]).max(axis=2)
    np.fill_diagonal(apart, math.inf)
    assert apart.min() > 0 and low[:, 1].min() > 0
    # A block and no cloud: nearly every box has another one within some millimetres. A body that
    # is not its own mirror image leaves a part of its place empty, hence not every one.
    assert (apart.min(axis=1) < 0.01).mean() > 0.7
    width = (high - low.min(axis=0))[:, [0, 2]].max()
    assert high[:, 1].max() == pytest.approx(width, rel=0.2)
