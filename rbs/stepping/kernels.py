"""The formulas of RBSFunctions for many contacts or constraints at once, with the same bits.

Each function has the name of its counterpart there, where it is derived. Both bodies of m pairs are
along the axis before the last: velocities (6, 2, m), linear and angular; inverse masses (2, m);
inverse inertia tensors (9, 2, m); arms (3, 2, m) from the COMs to the points, or `cycled`.
Directions are (3, m). No movable body is in two of the pairs.
"""

import numpy as np

from rbs.geometry.vectors import cross, dot, norm, vec_mat

# Signs of the impulses on body 1 and body 2, which are opposite.
SIGNS = np.array([[-1.0], [1.0]])


def position_corrections(invMasses, distance):
    """Displacements (2, m) along n."""
    return SIGNS * (invMasses / (invMasses[0] + invMasses[1])) * distance


def relative_velocity(velocity, arms):
    """Velocities (3, m) of body 1 relative to body 2 at their arms."""
    atArms = velocity[:3] + cross(velocity[3:], arms)
    return atArms[:, 0] - atArms[:, 1]


def inverse_effective_mass(invMasses, invInertias, rCrossN):
    """Responses to unit impulses: `(K (m,), response (3, 2, m))`, with K of both bodies."""
    response = vec_mat(rCrossN, invInertias)  # symmetric; faster than mat_vec, with the same bits
    k = invMasses + dot(rCrossN, response)
    return k[0] + k[1], response


def apply_impulse(velocity, impulse, invMasses, response, n):
    """Applies impulses (m,) to the velocities, in place."""
    impulses, linear, angular = impulse * SIGNS, velocity[:3], velocity[3:]
    linear += impulses * invMasses * n[:, None]
    angular += impulses * response


def collide(velocity, invMasses, invInertias, arms, n, K, response, step):
    """Impulses of `resolve_collision`: `(impulse (m,), friction (3, m))`.

    K, response : of `inverse_effective_mass`; step : CRCoeff, mu. Changes velocities in place.
    """
    impulse = (1.0 + step.CRCoeff) * dot(relative_velocity(velocity, arms), n) / K
    apply_impulse(velocity, impulse, invMasses, response, n)
    if step.mu == 0.0:
        return impulse, np.zeros(n.shape)
    return impulse, apply_friction(velocity, invMasses, invInertias, arms, n, step.mu * impulse)


def apply_friction(velocity, invMasses, invInertias, arms, n, limit):
    """Changes the velocities in place, and returns the friction impulses (3, m)."""
    u = relative_velocity(velocity, arms)
    across = u - dot(u, n) * n
    speed = norm(across)
    t = across / np.where(speed > 0.0, speed, 1.0)
    K, response = inverse_effective_mass(invMasses, invInertias, cross(arms, t[:, None]))
    impulse = np.minimum(speed / K, np.maximum(limit, 0.0) + 0.0)
    apply_impulse(velocity, impulse, invMasses, response, t)
    return impulse * t


def distance_error(point1, point2, refValue):
    """Distance errors and directions: `(C (m,), n (3, m))`."""
    d = point1 - point2
    length = norm(d)
    apart = length > 0.0
    upwards = np.array([[0.0], [1.0], [0.0]])
    return length - refValue, np.where(apart, d / np.where(apart, length, 1.0), upwards)


def is_violated(C, upper, tolerance):
    """Whether bounds are violated, (m,)."""
    return np.where(upper, C > tolerance, C < -tolerance)


def resolve_velocity_constraint(velocity, invMasses, invInertias, arms, n, tolerance):
    """Stops the change of the distances; changes the velocities in place."""
    rCrossN = cross(arms, n[:, None])
    linear, angular = dot(n[:, None], velocity[:3]), dot(rCrossN, velocity[3:])
    Jv = linear[0] + angular[0] - linear[1] - angular[1]
    K, response = inverse_effective_mass(invMasses, invInertias, rCrossN)
    impulse = np.where(abs(Jv) > tolerance, -Jv / K, 0.0)
    apply_impulse(velocity, -impulse, invMasses, response, n)
