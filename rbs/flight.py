"""Free flight: gravity, semi-implicit Euler and the gyroscopic term, on components.

The integrator is that of Baraff: Physically Based Modeling: Rigid Body Simulation. SIGGRAPH course
notes, 2001. The gyroscopic term is made implicit as in Catto: Numerical Methods. Game Developers
Conference 2015.
"""

import numpy as np

from Quaternion import exponential, multiply, rotation_matrices
from rbs.vectors import add, cross, dot, mat_vec, mul_add, scale, sqrt, sub, transpose

# Acceleration of free fall, length units / s².
GRAVITY = -9.8


def free_flight(linVelocity, angVelocity, position, orientation, timeStep):
    """Semi-implicit Euler: the new `(linVelocity, position, orientation)` after timeStep seconds.

    All on components: the velocity first, v ← v + g h; then the COM with the new velocity, x ← x +
    v h; then the orientation, q ← exp(ω h/2) ∘ q, of unit length again.
    """
    down = (0.0, GRAVITY, 0.0)
    if isinstance(linVelocity, np.ndarray):
        down = np.reshape(down, (3, 1))
    linVelocity = mul_add(linVelocity, timeStep, down)
    position = mul_add(position, timeStep, linVelocity)
    return linVelocity, position, turned(orientation, scale(timeStep, angVelocity))


def turned(orientation, angle):
    """exp(φ/2) ∘ q, of unit length: the orientation after a turn by the rotation vector φ."""
    rotation = exponential((0.0, *scale(0.5, angle)))
    w, x, y, z = multiply(rotation, orientation)
    # a product of unit quaternions drifts from unit length by rounding
    length = sqrt(w * w + (x * x + y * y + z * z))
    return w / length, x / length, y / length, z / length


def gyroscopic_velocity(angVelocity, orientation, inertia, timeStep):
    """The angular velocity after timeStep seconds without torque, on components.

    inertia : nine entries, the tensor at rest about the COM; angVelocity in world axes

    Euler's equation in body axes is I ω' + ω × I ω = 0. An explicit step gains energy and explodes
    for long bodies; the implicit one, f(ω) = I (ω - ω₀) + h ω × I ω = 0, only loses some. One step
    of Newton's method from ω₀, where f = h ω₀ × I ω₀ and
    f' = I + h ([ω₀]× I - [I ω₀]×), is enough: ω = ω₀ - f'⁻¹ f. The columns c_k of f' are
    I e_k + h (ω₀ × I e_k - (I ω₀) × e_k), and f' x = b is solved by Cramer's rule.
    """
    rotation = rotation_matrices(orientation)
    if isinstance(angVelocity, np.ndarray):
        rotation = np.stack(rotation)
    omega = mat_vec(transpose(rotation), angVelocity)
    spin = mat_vec(inertia, omega)
    residual = scale(timeStep, cross(omega, spin))
    one = omega[0] * 0.0 + 1.0
    columns = []
    for k in range(3):
        unit = tuple(one if i == k else one * 0.0 for i in range(3))
        column = inertia[k::3]
        if isinstance(omega, np.ndarray):
            unit = np.stack(unit)
        turning = sub(cross(omega, column), cross(spin, unit))
        columns.append(add(column, scale(timeStep, turning)))
    c0, c1, c2 = columns
    c12 = cross(c1, c2)
    determinant = dot(c0, c12)
    change = (
        dot(residual, c12) / determinant,
        dot(c0, cross(residual, c2)) / determinant,
        dot(c0, cross(c1, residual)) / determinant,
    )
    if isinstance(omega, np.ndarray):
        change = np.stack(change)
    return mat_vec(rotation, sub(omega, change))
