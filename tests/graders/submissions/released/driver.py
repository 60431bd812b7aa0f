"""The released driver re-created in its structure, without a window: runs in ./, data in ../data.

It compiles the C library out of five files, as released, and steps a scene with constraints.
"""

# ruff: noqa: I001, E402

import os

import cppyy  # noqa: F401
import cppyy.gbl
import numpy as np
from RBSFunctions import run_timestep
from RBSLoadVis import (
    Mesh,
    flatten_meshes,
    load_constraint_file,
    load_scene_file,
    update_visual_constraints,
)

for name in ("vec3.py", "support.py", "mpr.py", "ccd.py", "isCollide.py"):
    exec(open(name).read())

from cppyy.gbl import isCollide as isCollide

corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
depth, normal, position = np.array([0.0]), np.zeros(3), np.zeros(3)
wasHit = cppyy.gbl.isCollide(
    np.array([4.0]), corners, np.mean(corners, axis=0),
    np.array([4.0]), corners + 0.1, np.mean(corners, axis=0) + 0.1, depth, normal, position,
)  # fmt: skip
print("hit:", wasHit, depth[0] > 0.0)

meshes = load_scene_file(os.path.join("..", "data", "two_cylinder-scene.txt"))
path = os.path.join("..", "data", "two_cylinder-constraints.txt")
constraints = load_constraint_file(path, meshes)
vertices, faces, densities, edges = flatten_meshes(meshes, constraints=constraints)
print("shapes:", vertices.shape, faces.shape, densities.shape, edges.shape)
ground = Mesh(np.empty([0, 3]), np.empty([0, 3]), np.empty([0, 3]), np.empty([0, 4]), 0.0,
              np.zeros([1, 3]), np.array([1.0, 0.0, 0.0, 0.0]), True)  # fmt: skip
for _ in range(50):
    run_timestep(
        meshes, ground, 0.02, 0.5, enforceConstraints=True, constraints=constraints, tolerance=1e-3
    )
    vertices, _, _, _ = flatten_meshes(meshes, flattenFaces=False)
    nodes, lines = update_visual_constraints(None, vertices, edges)
print("network:", nodes.shape, lines.shape)
for mesh in meshes:
    print("state:", *np.concatenate([np.ravel(mesh.position), np.ravel(mesh.orientation)]))
