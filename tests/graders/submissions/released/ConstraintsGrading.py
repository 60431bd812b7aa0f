"""Of the shape of the released grader of constraints, re-created: runs in ./, data in ../data."""
# ruff: noqa: F403, F405, I001

import os
import pickle
import sys

import numpy as np

sys.path.append(os.path.join("..", "code"))
from Quaternion import *
from RBSFunctions import Mesh, resolve_position_constraint, resolve_velocity_constraint
from RBSLoadVis import load_mesh_file as load_mesh_file  # as released: imported, not used

with open(os.path.join("..", "data", "constraint-resolution.data"), "rb") as file:
    data = pickle.load(file)
PAIRS = ("correctedPositionsUpper", "correctedPositionsLower", "correctedLinVelocities",
         "correctedAngVelocities")  # fmt: skip
results = {name: [np.zeros_like(data["randomLinVelocities"]) for _ in (1, 2)] for name in PAIRS}
for i in range(data["randomPositions"].shape[0]):
    mesh1 = Mesh("mesh 1", data["origVertices1"], data["faces1"], data["tets1"], 1.0,
                 np.zeros([1, 3]), np.array([1.0, 0.0, 0.0, 0.0]), False)  # fmt: skip
    mesh2 = Mesh("mesh 2", data["origVertices2"], data["faces2"], data["tets2"], 1.0,
                 np.array(data["randomPositions"][i, :], copy=True).reshape(1, 3),
                 np.array(data["randomOrientations"][i, :], copy=True).reshape(1, 4),
                 False)  # fmt: skip
    mesh2.linVelocity = np.array(data["randomLinVelocities"][i, :], copy=True).reshape(1, 3)
    mesh2.angVelocity = np.array(data["randomAngVelocities"][i, :], copy=True).reshape(1, 3)
    restPoint = mesh1.origVertices[0, :].reshape(1, 3)  # of mesh 1 on both meshes, as released
    points = tuple(QRotate(m.orientation, restPoint) + m.position for m in (mesh1, mesh2))
    positions = (mesh1.position, mesh2.position)
    invMasses = (mesh1.invMass, mesh2.invMass)
    for name, factor, upper in (("Upper", 1.2, True), ("Lower", 0.8, False)):
        _, corrected = resolve_position_constraint(
            positions, points, factor * data["refValues"][i], invMasses, upper, 1e-6
        )
        for k in (0, 1):
            results["correctedPositions" + name][k][i, :] = corrected[k]
    _, linVelocities, angVelocities = resolve_velocity_constraint(
        positions, points, (mesh1.linVelocity, mesh2.linVelocity),
        (mesh1.angVelocity, mesh2.angVelocity), invMasses,
        (mesh1.get_rotated_inv_IT(), mesh2.get_rotated_inv_IT()), 10e-6,
    )  # fmt: skip
    for k in (0, 1):
        results["correctedLinVelocities"][k][i, :] = linVelocities[k]
        results["correctedAngVelocities"][k][i, :] = angVelocities[k]
for name in PAIRS:
    for k in (0, 1):
        error = np.max(np.abs(data[name][k] - results[name][k]))
        print(f"{name} error Mesh{k + 1}: ", error)
