"""Scripts structured as the released ones run unchanged on the stand-ins, without a compiler.

The scripts are `submissions/released`, re-created in the released structure: `grading` and `code`
beside `data`, modules looked for in `../code`.
"""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
import studentVariants
from oracles import DATA, ROOT
from program import by_hand, python

from RigidBodySimulation import load_constraint_file, load_scene_file

STAND_INS = ROOT / "graders" / "released"
SCRIPTS = Path(__file__).parent / "submissions" / "released"
GRADER = "Grading.py"
BOUND = 1e-9


def run(script, folder, *path, **changes):
    """Runs a script in its folder with these folders on the PYTHONPATH; the finished process."""
    return python(folder, "-B", script, PYTHONPATH=os.pathsep.join(map(str, path)), **changes)


@pytest.fixture
def place(tmp_path, released_data):
    """A folder with `grading` and `data`, as released; `code` is up to the test."""
    shutil.copytree(SCRIPTS, tmp_path / "grading")
    shutil.copytree(released_data, tmp_path / "data")
    for name in ("cylinder.mesh", "two_cylinder-scene.txt", "two_cylinder-constraints.txt"):
        shutil.copy(DATA / name, tmp_path / "data")
    return tmp_path


def errors_of(process):
    assert process.returncode == 0, process.stderr
    return [float(line.split()[-1]) for line in process.stdout.splitlines()]


def test_released_code_passes_the_released_graders_and_ours_those_with_our_data(place):
    folder = place / "grading"
    studentVariants.write_submission(place / "code", studentVariants.VARIANTS["released"])
    wanted = errors_of(run(GRADER, folder, STAND_INS))
    assert max(wanted) < BOUND and len(wanted) == 4 + 100 * 16
    shutil.rmtree(place / "code")
    for path in DATA.glob("*.data"):
        shutil.copy(path, place / "data")
    assert max(errors_of(run(GRADER, folder, STAND_INS, ROOT))) < BOUND


@pytest.mark.slow
@pytest.mark.parametrize("part", range(4))  # which can run side by side
def test_each_variant_gets_the_hints_of_the_table(part):
    rows = list(studentVariants.table_rows().items())
    for name, (_name, edits, _where, *verdict) in rows[part::4]:
        assert len(studentVariants.VARIANTS[name]) == edits.count("→")
        assert studentVariants.verdict_on(name) == verdict, name


# As the released driver does it, without a window. A student's GJK is not what the stand-in needs.
DRIVER = """
import cppyy, cppyy.gbl, numpy as np
from RBSFunctions import run_timestep
from RBSLoadVis import (Mesh, flatten_meshes, load_constraint_file, load_scene_file,
                        update_visual_constraints)
cppyy.cppdef('#define never compiled'); cppyy.include('ccd.h'); cppyy.load_library('ccd')
import GJK
n, box, out = np.array([4.0]), np.eye(4)[:, :3], np.zeros((3, 3))
print(cppyy.gbl.isCollide(n, box, 0, n, box + 0.1, 0, out[0, :1], *out[1:]), GJK.mine)
meshes = load_scene_file('../data/two_cylinder-scene.txt')
constraints = load_constraint_file('../data/two_cylinder-constraints.txt', meshes)
*tables, edges = flatten_meshes(meshes, constraints=constraints)
none = np.empty([0, 3])
ground = Mesh(none, none, none, np.empty([0, 4]), 0.0, out[:1], np.array([1.0, 0, 0, 0]), True)
for _ in range(50):
    run_timestep(meshes, ground, 0.02, 0.5, enforceConstraints=True, constraints=constraints,
                 tolerance=1e-3)
nodes, lines = update_visual_constraints(None, flatten_meshes(meshes, flattenFaces=False)[0], edges)
print(*(len(one) for one in (*tables, edges, nodes, lines)))
for mesh in meshes:
    print(*np.concatenate([np.ravel(mesh.position), np.ravel(mesh.orientation)]))
"""


def test_a_driver_of_the_released_shape_runs_and_moves_the_bodies_as_our_step_does(place):
    studentVariants.write_submission(place / "code")
    (place / "code" / "GJK.py").write_text("mine = True\n")
    (place / "code" / "driver.py").write_text(DRIVER)
    process = run("driver.py", place / "code", STAND_INS)
    assert process.returncode == 0, process.stderr
    hit, counts, *rows = process.stdout.splitlines()
    scene = DATA / "two_cylinder-scene.txt"
    meshes = load_scene_file(scene)
    sizes = [sum(len(getattr(m, name)) for m in meshes) for name in ("origVertices", "faces")]
    assert hit == "True True"
    assert [*map(int, counts.split())] == [*sizes, sizes[0], 4, 8, 4]
    constraints = load_constraint_file(DATA / "two_cylinder-constraints.txt", meshes)
    states = by_hand(scene, 50, 0.5, 0.02, constraints=constraints, tolerance=1e-3)
    expected = np.hstack([states[name][-1] for name in ("positions", "orientations")])
    found = np.array([row.split() for row in rows], dtype=float)
    assert found == pytest.approx(expected, abs=1e-9)
    assert np.abs(states["positions"][-1] - states["positions"][0]).max() > 0.5
