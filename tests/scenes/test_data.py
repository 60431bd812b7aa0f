"""The meshes and scenes under data/: made by data/scripts/make_data.py, and what they promise."""

import subprocess
import sys

import numpy as np
import pytest
from oracles import DATA, minkowski_depth
from scipy.spatial import ConvexHull
from scipy.spatial.distance import cdist

from rbs.scenes.meshfiles import tetrahedron_volumes
from RigidBodySimulation import load_mesh_file, load_scene_file

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


@pytest.mark.parametrize("path", sorted(DATA.glob("*.mesh")), ids=lambda path: path.stem)
def test_mesh_is_convex_without_slivers(path):
    vertices, _, tets = load_mesh_file(path)
    hull, volumes = ConvexHull(vertices), tetrahedron_volumes(vertices, tets)
    assert len(hull.vertices) == len(vertices) and volumes.min() > 5e-5 * hull.volume
    assert volumes.sum() == pytest.approx(hull.volume, rel=1e-13)


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
