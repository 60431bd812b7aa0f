"""A skeleton with the traits of the coursework's: five stubs, and all that is given."""
# ruff: noqa: B006, B905, F401, F403, F405, I001

import os
import numpy as np
import cppyy
import scipy.linalg
from Quaternion import *


def resolve_velocity_constraint(currPositions, currConstPoints, currLinVelocities,
                                currAngVelocities, invMasses, invInertiaTensors, tolerance):
    # TODO: the velocity constraint
    return True, currLinVelocities, currAngVelocities


def resolve_position_constraint(currPositions, currConstPoints, refValue, invMasses, upper,
                                tolerance):
    # TODO: the position constraint
    return True, currPositions


def run_timestep(meshes, groundMesh, timeStep, CRCoeff, enforceConstraints=True, constraints=[],
                 maxIterations=1000, tolerance=0.0):
    for mesh in meshes:
        mesh.integrate_timestep(timeStep)

    for i in range(len(meshes)):
        for j in range(i + 1, len(meshes)):
            isCollision, depth, contactNormal, penPoint = meshes[i].detect_collision(meshes[j])
            if isCollision:
                resolve_collision(meshes[i], meshes[j], depth, contactNormal, penPoint, CRCoeff)

    for mesh in meshes:  # a fixed one, too
        lowest = np.argmin(mesh.currVertices[:, 1])
        penPoint = mesh.currVertices[lowest, :]
        if penPoint[1] <= 0.0:
            resolve_collision(mesh, groundMesh, penPoint[1], np.array([[0.0, 1.0, 0.0]]),
                              penPoint, CRCoeff)

    if not enforceConstraints or len(constraints) == 0:
        return
    zeroStreak, visits = 0, 0
    while zeroStreak < len(constraints) and visits * len(constraints) < maxIterations:
        m1, v1, m2, v2, refValue, upper = constraints[visits % len(constraints)]
        visits += 1
        first, second = meshes[m1], meshes[m2]
        positions = (first.position, second.position)
        points = (QRotate(first.orientation, first.origVertices[[v1], :]) + first.position,
                  QRotate(second.orientation, second.origVertices[[v2], :]) + second.position)
        invMasses = (first.invMass, second.invMass)
        wasValid, corrected = resolve_position_constraint(positions, points, refValue, invMasses,
                                                          upper, tolerance)
        if wasValid:
            zeroStreak += 1
            continue
        zeroStreak = 0
        _, linVelocities, angVelocities = resolve_velocity_constraint(
            positions, points, (first.linVelocity, second.linVelocity),
            (first.angVelocity, second.angVelocity), invMasses,
            (first.get_rotated_inv_IT(), second.get_rotated_inv_IT()), tolerance)
        first.position, second.position = corrected
        first.linVelocity, second.linearVelocity = linVelocities
        first.angVelocity, second.angVelocity = angVelocities

    for mesh in meshes:
        mesh.currVertices = QRotate(mesh.orientation, mesh.origVertices) + mesh.position


def resolve_collision(m1, m2, depth, contactNormal, penPoint, CRCoeff):
    # TODO: the interpenetration

    m1.currVertices = QRotate(m1.orientation, m1.origVertices) + m1.position
    m2.currVertices = QRotate(m2.orientation, m2.origVertices) + m2.position

    # TODO: the velocities


class Mesh:
    def __init__(self, name, origVertices, faces, tets, density, position, orientation, isFixed):
        self.name = name
        self.origVertices = origVertices
        self.faces = faces
        self.tets = tets
        self.density = density
        self.position = position
        self.orientation = (orientation / np.linalg.norm(orientation)).reshape(1, 4)
        self.isFixed = isFixed
        self.linVelocity = np.zeros([1, 3])
        self.angVelocity = np.zeros([1, 3])
        self.invMass = 0.0
        self.invIT = np.zeros([3, 3])
        if self.origVertices.shape[0] > 0:
            self.compute_mass_properties()
            self.currVertices = QRotate(self.orientation, self.origVertices) + self.position

    def compute_mass_properties(self):
        corners = self.origVertices[self.tets]
        edges = corners[:, 1:, :] - corners[:, 0:1, :]
        volumes = np.abs(np.einsum("ij,ij->i", edges[:, 0], np.cross(edges[:, 1], edges[:, 2]))) / 6
        self.mass = self.density * np.sum(volumes)
        COM = volumes @ corners.mean(axis=1) / np.sum(volumes)
        self.origVertices -= COM  # the caller's array
        corners = self.origVertices[self.tets]
        self.IT = np.zeros([3, 3])
        for volume, tet in zip(volumes, corners):
            products = tet.T @ (np.ones([4, 4]) + np.eye(4)) @ tet / 120.0 * volume
            self.IT += self.density * (np.trace(products) * np.eye(3) - products)
        if not self.isFixed:
            self.invMass = 1.0 / self.mass
            self.invIT = np.linalg.inv(self.IT)

    def get_rotated_inv_IT(self):
        # TODO: the tensor in world axes
        return np.identity(3)

    def bounding_box_collision(self, m):
        low, high = self.currVertices.min(axis=0), self.currVertices.max(axis=0)
        otherLow, otherHigh = m.currVertices.min(axis=0), m.currVertices.max(axis=0)
        return np.all(low <= otherHigh) and np.all(otherLow <= high)

    def detect_collision(self, m):
        if self.isFixed and m.isFixed:
            return False, [], [], []
        if not self.bounding_box_collision(m):
            return False, [], [], []
        depth, intNormal, intPosition = np.array([0.0]), np.zeros(3), np.zeros(3)
        counts = [np.array([float(one.currVertices.shape[0])]) for one in (self, m)]
        isCollision = cppyy.gbl.isCollide(
            counts[0], self.currVertices, self.position, counts[1], m.currVertices, m.position,
            depth, intNormal, intPosition)
        if not isCollision:
            return False, [], [], []
        return True, depth, intNormal, intPosition

    def integrate_timestep(self, timeStep):
        # TODO: velocity, position and orientation of a body that is not fixed
        self.currVertices = QRotate(self.orientation, self.origVertices) + self.position
