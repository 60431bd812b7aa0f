"""Rotation in free flight, of one body in tuples of floats or of many in arrays."""

import numpy as np

from Quaternion import exponentials, multiply, rotation_matrices
from rbs.geometry import vectors
from rbs.geometry.triples import ZERO, add, cross, mat_vec, rotate_tensor, scale, sub, transpose

# Parts in which a step integrates the rotation of a tumbling body. Each costs time. With two, a
# body that spins about its middle axis at 5 rad/s turns over 0.7 s too early after a minute.
FLIGHT_PARTS = 4


def turned(orientation, angle):
    """Unit orientations (4, n) after rotation by vectors φ (3, n): exp(φ/2) ∘ q."""
    w, x, y, z = multiply(quaternions(angle), orientation)
    return np.array((w, x, y, z)) / np.sqrt(w * w + (x * x + y * y + z * z))


def quaternions(angle):
    """Unit quaternions exp(φ/2) (4, n) of rotation vectors φ (3, n)."""
    return np.array(exponentials((0.0, *(0.5 * angle))))


def rotated(q, v):
    """Vectors (3, n), rotated by unit quaternions (4, n): q v q⁻¹."""
    axis = vectors.cycled(q[1:])
    once = 2.0 * vectors.cross(axis, v)
    return v + q[0] * once + vectors.cross(axis, once)


def rotation_vectors(q):
    """Rotation vectors φ (3, n) of unit quaternions (4, n) = exp(φ/2), by up to 2π."""
    sine = np.sqrt((q[1:] * q[1:]).sum(axis=0))
    return q[1:] * (2.0 * np.arctan2(sine, q[0]) / np.where(sine > 0.0, sine, 1.0))


def turn_matrix(angle):
    """Nine entries of the rotation matrix of a rotation vector, floats or arrays (n,)."""
    return rotation_matrices(exponentials((0.0, *scale(0.5, angle))))


def torque_free_velocities(angVelocity, orientation, inertia, invInertia, timeStep):
    """Angular velocities without torque: `(mean, end)`, three components each, in world axes.

    mean : constant velocity that leads to the orientation after timeStep seconds
    end : velocity at that time
    angVelocity : world axes; orientation : (w, x, y, z); inertia, invInertia : nine entries, at
        rest about the COM. Components may be floats or arrays (n,)

    Without torque, L = I ω is constant in world axes, and ω = I⁻¹ L follows from the orientation
    alone. After a rotation by the vector θ from the start, with its matrix E, ω = E I₀⁻¹ Eᵀ L, and
    θ' = ω - θ × ω/2 + θ × (θ × ω)/12 - θ × (θ × (θ × (θ × ω)))/720 + …. Four stages of Runge and
    Kutta integrate θ (Munthe-Kaas: Runge-Kutta Methods on Lie Groups. BIT 38, 1998).
    """
    rotation = rotation_matrices(orientation)
    momentum = mat_vec(rotate_tensor(rotation, inertia), angVelocity)
    atStart = rotate_tensor(rotation, invInertia)

    def velocity(angle):
        E = turn_matrix(angle)
        return mat_vec(E, mat_vec(atStart, mat_vec(transpose(E), momentum)))

    def rate(angle):
        omega = velocity(angle)
        once = cross(angle, omega)
        twice = cross(angle, once)
        fourTimes = cross(angle, cross(angle, twice))
        change = sub(scale(1.0 / 12.0, twice), add(scale(0.5, once), scale(1.0 / 720.0, fourTimes)))
        return add(omega, change)

    h, angle = timeStep / FLIGHT_PARTS, ZERO
    for _ in range(FLIGHT_PARTS):
        k1 = rate(angle)
        k2 = rate(add(angle, scale(0.5 * h, k1)))
        k3 = rate(add(angle, scale(0.5 * h, k2)))
        k4 = rate(add(angle, scale(h, k3)))
        angle = add(angle, scale(h / 6.0, add(add(k1, k4), scale(2.0, add(k2, k3)))))
    mean = scale(1.0 / timeStep if timeStep else 0.0, angle)
    return mean, velocity(angle)
