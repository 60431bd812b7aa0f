"""Of the shape of the released grader of collisions, re-created: runs in ./, data in ../data."""

# ruff: noqa: I001, E402

import os
import pickle
import sys

import numpy as np

sys.path.append(os.path.join("..", "code"))
from InitializeCCD import initialize_libccd
from RBSFunctions import Mesh, resolve_collision

NAMES = ("Positions", "Orientations", "LinVelocities", "AngVelocities")
ATTRIBUTES = ("position", "orientation", "linVelocity", "angVelocity")

initialize_libccd()
with open(os.path.join("..", "data", "collision-resolution.data"), "rb") as file:
    data = pickle.load(file)
results = {name: [np.zeros_like(data["random" + name]) for _ in (1, 2)] for name in NAMES}
for i in range(data["randomPositions"].shape[0]):
    # The arrays of the data themselves, as released: a Mesh that shifts its argument shifts them.
    mesh1 = Mesh("mesh 1", data["origVertices1"], data["faces1"], data["tets1"], 1.0,
                 np.zeros([1, 3]), np.array([1.0, 0.0, 0.0, 0.0]), False)  # fmt: skip
    mesh2 = Mesh("mesh 2", data["origVertices2"], data["faces2"], data["tets2"], 1.0,
                 np.array(data["randomPositions"][i, :], copy=True).reshape(1, 3),
                 np.array(data["randomOrientations"][i, :], copy=True).reshape(1, 4),
                 False)  # fmt: skip
    mesh2.linVelocity = np.array(data["randomLinVelocities"][i, :], copy=True).reshape(1, 3)
    mesh2.angVelocity = np.array(data["randomAngVelocities"][i, :], copy=True).reshape(1, 3)
    if data["isCollision"][i]:
        resolve_collision(mesh1, mesh2, data["depth"][i], data["intNormal"][i, :],
                          data["intPosition"][i, :], 0.5)  # fmt: skip
    for name, attribute in zip(NAMES, ATTRIBUTES, strict=True):
        for k, mesh in enumerate((mesh1, mesh2)):
            results[name][k][i] = np.array(getattr(mesh, attribute), copy=True).reshape(1, -1)
for name in NAMES:
    for k in (0, 1):
        error = np.max(np.abs(data["result" + name][k] - results[name][k]))
        print(f"{name} error mesh{k + 1}: ", error)
