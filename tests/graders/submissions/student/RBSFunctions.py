"""A student's solution of the coursework in plain NumPy, written from its text, not from ours.

The right physics; `studentVariants` makes the release's and the classic mistakes out of it.
"""
# ruff: noqa: F401, F403, F405, I001

import os
import numpy as np
import cppyy
import scipy.linalg
from Quaternion import *


def resolve_velocity_constraint(currPositions, currConstPoints, currLinVelocities,
                                currAngVelocities, invMasses, invInertiaTensors, tolerance):
    n = (currConstPoints[0] - currConstPoints[1]).reshape(3)
    n = n / np.linalg.norm(n)
    r1 = (currConstPoints[0] - currPositions[0]).reshape(3)
    r2 = (currConstPoints[1] - currPositions[1]).reshape(3)

    # the Jacobian of the distance, with respect to v1, w1, v2, w2
    J = np.concatenate((n, np.cross(r1, n), -n, -np.cross(r2, n)))
    velocities = np.concatenate(
        [np.reshape(x, 3) for x in (currLinVelocities[0], currAngVelocities[0],
                                    currLinVelocities[1], currAngVelocities[1])])
    if abs(J @ velocities) <= tolerance:
        return True, currLinVelocities, currAngVelocities

    invM = scipy.linalg.block_diag(invMasses[0] * np.eye(3), invInertiaTensors[0],
                                   invMasses[1] * np.eye(3), invInertiaTensors[1])
    velocities = velocities - invM @ J * (J @ velocities) / (J @ invM @ J)
    v1, w1, v2, w2 = velocities.reshape(4, 1, 3)
    return False, (v1, v2), (w1, w2)


def resolve_position_constraint(currPositions, currConstPoints, refValue, invMasses, upper,
                                tolerance):
    difference = currConstPoints[0] - currConstPoints[1]
    length = np.linalg.norm(difference)
    C = length - refValue
    isValid = bool(C <= tolerance) if upper else bool(C >= -tolerance)
    if isValid:
        return True, currPositions

    total = invMasses[0] + invMasses[1]
    push = C * difference / length
    return False, (currPositions[0] - invMasses[0] / total * push,
                   currPositions[1] + invMasses[1] / total * push)


def run_timestep(meshes, groundMesh, timeStep, CRCoeff, enforceConstraints=True, constraints=(),
                 maxIterations=1000, tolerance=0.0):
    for mesh in meshes:
        mesh.integrate_timestep(timeStep)

    for i in range(len(meshes)):
        for j in range(i + 1, len(meshes)):
            isCollision, depth, normal, point = meshes[i].detect_collision(meshes[j])
            if isCollision:
                resolve_collision(meshes[i], meshes[j], depth, normal, point, CRCoeff)

    up = np.array([[0.0, 1.0, 0.0]])
    for mesh in meshes:
        lowest = mesh.currVertices[np.argmin(mesh.currVertices[:, 1])]
        if lowest[1] <= 0.0:
            resolve_collision(mesh, groundMesh, lowest[1], up, lowest, CRCoeff)

    if not enforceConstraints or len(constraints) == 0:
        return
    good = 0
    visits = 0
    while good < len(constraints) and visits < maxIterations:
        m1, v1, m2, v2, refValue, upper = constraints[visits % len(constraints)]
        visits += 1
        pair = (meshes[m1], meshes[m2])
        positions = (pair[0].position, pair[1].position)
        points = tuple(QRotate(m.orientation, m.origVertices[[v]]) + m.position
                       for m, v in zip(pair, (v1, v2)))  # noqa: B905
        invMasses = (pair[0].invMass, pair[1].invMass)
        if sum(invMasses) == 0.0:
            good += 1
            continue
        wasValid, corrected = resolve_position_constraint(positions, points, refValue, invMasses,
                                                          upper, tolerance)
        if wasValid:
            good += 1
            continue
        good = 0
        _, linVelocities, angVelocities = resolve_velocity_constraint(
            positions, points, [m.linVelocity for m in pair], [m.angVelocity for m in pair],
            invMasses, [m.get_rotated_inv_IT() for m in pair], tolerance)
        for k in (0, 1):
            pair[k].position = corrected[k]
            pair[k].linVelocity = linVelocities[k]
            pair[k].angVelocity = angVelocities[k]
    for mesh in meshes:
        mesh.update_vertices()


def resolve_collision(m1, m2, depth, contactNormal, penPoint, CRCoeff):
    n = np.reshape(contactNormal, (1, 3))
    total = m1.invMass + m2.invMass
    if total == 0.0:
        return

    # interpenetration
    m1.position = m1.position - m1.invMass / total * depth * n
    m2.position = m2.position + m2.invMass / total * depth * n
    contact = np.reshape(penPoint, (1, 3)) + m2.invMass / total * depth * n

    # velocities
    r1 = contact - m1.position
    r2 = contact - m2.position
    c1 = np.cross(r1, n)
    c2 = np.cross(r2, n)
    invI1 = m1.get_rotated_inv_IT()
    invI2 = m2.get_rotated_inv_IT()
    v1 = m1.linVelocity + np.cross(m1.angVelocity, r1)
    v2 = m2.linVelocity + np.cross(m2.angVelocity, r2)
    denominator = total + np.sum(c1 * (c1 @ invI1.T)) + np.sum(c2 * (c2 @ invI2.T))
    j = (1.0 + CRCoeff) * np.sum((v1 - v2) * n) / denominator
    m1.linVelocity = m1.linVelocity - m1.invMass * j * n
    m2.linVelocity = m2.linVelocity + m2.invMass * j * n
    m1.angVelocity = m1.angVelocity - j * c1 @ invI1.T
    m2.angVelocity = m2.angVelocity + j * c2 @ invI2.T
    m1.update_vertices()
    m2.update_vertices()


class Mesh:
    def __init__(self, name, origVertices, faces, tets, density, position, orientation, isFixed):
        self.name = name
        self.origVertices = np.array(origVertices, dtype=float)
        self.faces = faces
        self.tets = tets
        self.density = density
        self.position = np.array(position, dtype=float).reshape(1, 3)
        self.orientation = np.array(orientation, dtype=float).reshape(1, 4)
        self.orientation /= np.linalg.norm(self.orientation)
        self.isFixed = isFixed
        self.linVelocity = np.zeros((1, 3))
        self.angVelocity = np.zeros((1, 3))
        self.mass = 0.0
        self.invMass = 0.0
        self.IT = np.zeros((3, 3))
        self.invIT = np.zeros((3, 3))
        if len(self.origVertices) > 0:
            self.compute_mass()
        self.update_vertices()

    def compute_mass(self):
        corners = self.origVertices[self.tets]
        volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0
        COM = np.sum(volumes[:, None] * np.mean(corners, axis=1), axis=0) / np.sum(volumes)
        self.origVertices -= COM
        corners = corners - COM

        # the second moments of a tetrahedron are 6 V / 120 times its corners' ones, those of a
        # corner with itself twice
        weights = np.eye(4) + 1.0
        second = np.einsum("tki,kl,tlj->tij", corners, weights, corners) / 120.0
        C = self.density * np.sum(6.0 * volumes[:, None, None] * second, axis=0)
        self.mass = self.density * np.sum(volumes)
        self.IT = np.trace(C) * np.eye(3) - C
        self.invMass = 1.0 / self.mass
        self.invIT = np.linalg.inv(self.IT)
        if self.isFixed:
            self.invMass = 0.0
            self.invIT = np.zeros((3, 3))

    def update_vertices(self):
        self.currVertices = QRotate(self.orientation, self.origVertices) + self.position

    def get_rotated_inv_IT(self):
        R = Q2RotMatrix(self.orientation)
        return R @ self.invIT @ R.T

    def bounding_box_collision(self, m):
        low, high = self.currVertices.min(axis=0), self.currVertices.max(axis=0)
        otherLow, otherHigh = m.currVertices.min(axis=0), m.currVertices.max(axis=0)
        return bool(np.all(high >= otherLow) and np.all(otherHigh >= low))

    def detect_collision(self, m):
        if (self.isFixed and m.isFixed) or not self.bounding_box_collision(m):
            return False, [], [], []
        depth = np.zeros(1)
        normal = np.zeros(3)
        point = np.zeros(3)
        isCollision = cppyy.gbl.isCollide(
            np.array([float(len(self.currVertices))]), self.currVertices, self.position,
            np.array([float(len(m.currVertices))]), m.currVertices, m.position,
            depth, normal, point)
        return isCollision, depth, normal, point

    def integrate_timestep(self, timeStep):
        if not self.isFixed:
            gravity = np.array([[0.0, -9.8, 0.0]])
            self.linVelocity = self.linVelocity + timeStep * gravity
            self.position = self.position + timeStep * self.linVelocity
            half = np.concatenate((np.zeros((1, 1)), 0.5 * timeStep * self.angVelocity), axis=1)
            self.orientation = QMult(QExp(half), self.orientation)
        self.update_vertices()
