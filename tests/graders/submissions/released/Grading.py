"""The three released graders re-created in one, in their structure: runs in ./, data in ../data."""
# ruff: noqa: E402, F403, F405, I001

import os
import pickle
import sys

import numpy as np

sys.path.append(os.path.join("..", "code"))
from InitializeCCD import initialize_libccd
from Quaternion import *
from RBSFunctions import (
    Mesh, resolve_collision, resolve_position_constraint, resolve_velocity_constraint
)  # fmt: skip
from RBSLoadVis import load_mesh_file

NAMES = ("Positions", "Orientations", "LinVelocities", "AngVelocities")
ATTRIBUTES = ("position", "orientation", "linVelocity", "angVelocity")


def load(name):
    with open(os.path.join("..", "data", name + ".data"), "rb") as file:
        return pickle.load(file)


def set_state(mesh, data, i):
    for name, attribute in zip(NAMES, ATTRIBUTES, strict=True):
        setattr(mesh, attribute, np.array(data["random" + name][i, :], copy=True).reshape(1, -1))


def two_meshes(data, i):
    # The arrays of the data themselves, as released: a Mesh that shifts its argument shifts them.
    bodies = [(data["origVertices" + k], data["faces" + k], data["tets" + k]) for k in "12"]
    rest = (1.0, np.zeros([1, 3]), np.array([1.0, 0.0, 0.0, 0.0]), False)
    mesh1, mesh2 = (Mesh("mesh", *body, *rest) for body in bodies)
    set_state(mesh2, data, i)
    return mesh1, mesh2


def report(name, expected, found):
    print(name + " error: ", np.max(np.abs(expected - found)))


data = load("integration")
mesh = Mesh("any mesh", *load_mesh_file(os.path.join("..", "data", "cylinder.mesh")), 1.0,
            data["randomPositions"][0, :], data["randomOrientations"][0, :], False)  # fmt: skip
set_state(mesh, data, 0)
mesh.integrate_timestep(0.1)
for name, attribute in zip(NAMES, ATTRIBUTES, strict=True):
    # the released data have a result for the first sample only
    report(name, data["result" + name][0, :], getattr(mesh, attribute).reshape(-1))

initialize_libccd()
data = load("collision-resolution")
for i in range(data["randomPositions"].shape[0]):
    meshes = two_meshes(data, i)
    if data["isCollision"][i]:
        resolve_collision(*meshes, data["depth"][i], data["intNormal"][i, :],
                          data["intPosition"][i, :], 0.5)  # fmt: skip
    for name, attribute in zip(NAMES, ATTRIBUTES, strict=True):
        for k in (0, 1):
            found = np.array(getattr(meshes[k], attribute), copy=True).reshape(-1)
            report(f"{name} {i} mesh{k + 1}", data["result" + name][k][i], found)

data = load("constraint-resolution")
for i in range(data["randomPositions"].shape[0]):
    meshes = two_meshes(data, i)
    restPoint = meshes[0].origVertices[0, :].reshape(1, 3)  # of mesh 1 on both, as released
    points = tuple(QRotate(m.orientation, restPoint) + m.position for m in meshes)
    positions = tuple(m.position for m in meshes)
    invMasses = tuple(m.invMass for m in meshes)
    found = {}
    for name, factor, upper in (("Upper", 1.2, True), ("Lower", 0.8, False)):
        _, found["correctedPositions" + name] = resolve_position_constraint(
            positions, points, factor * data["refValues"][i], invMasses, upper, 1e-6
        )
    _, found["correctedLinVelocities"], found["correctedAngVelocities"] = (
        resolve_velocity_constraint(
            positions, points, tuple(m.linVelocity for m in meshes),
            tuple(m.angVelocity for m in meshes), invMasses,
            tuple(m.get_rotated_inv_IT() for m in meshes), 10e-6,
        )
    )  # fmt: skip
    for name, pair in found.items():
        for k in (0, 1):
            report(f"{name} {i} mesh{k + 1}", data[name][k][i], np.reshape(pair[k], -1))
