"""Of the shape of the released grader of integration, re-created: runs in ./, data in ../data."""

# ruff: noqa: I001, E402

import os
import pickle
import sys

import numpy as np

sys.path.append(os.path.join("..", "code"))
from RBSFunctions import Mesh
from RBSLoadVis import load_mesh_file

dataPath = os.path.join("..", "data")
vertices, faces, tets = load_mesh_file(os.path.join(dataPath, "cylinder.mesh"))
with open(os.path.join(dataPath, "integration.data"), "rb") as file:
    data = pickle.load(file)

mesh = Mesh("any mesh", vertices, faces, tets, 1.0, data["randomPositions"][0, :],
            data["randomOrientations"][0, :], False)  # fmt: skip
results = {
    name: np.zeros_like(data["random" + name])
    for name in ("Positions", "Orientations", "LinVelocities", "AngVelocities")
}
attributes = ("position", "orientation", "linVelocity", "angVelocity")
for i in range(1):  # the released data have a result for the first sample only
    for name, attribute in zip(results, attributes, strict=True):
        setattr(mesh, attribute, np.array(data["random" + name][i, :], copy=True).reshape(1, -1))
    mesh.integrate_timestep(0.1)
    for name, attribute in zip(results, attributes, strict=True):
        results[name][i, :] = getattr(mesh, attribute).reshape(1, -1)
for name, values in results.items():
    print(name + " error: ", np.max(np.abs(data["result" + name] - values)))
