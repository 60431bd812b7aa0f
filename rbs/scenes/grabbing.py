"""The spring that drags a body, and the ball that is shot. Nothing here draws.

Units: metres, kilograms, seconds.
"""

import math

import numpy as np

from Quaternion import QConj, QRotate
from RBSFunctions import Mesh

# Hz, the frequency of the spring. The body reaches the cursor within half a second, and hangs
# g / ω² = 6 cm below it, invisible on bodies of metres. Stiffer springs tear it through others.
GRAB_FREQUENCY = 2.0
# Radius of the ball, and its distance covered in a second, as fractions of the scene's size.
SHOT_RADIUS, SHOT_SPEED = 0.03, 1.0
# Corners of the ball; a rounder one slows its contacts.
SHOT_CORNERS = 42
# Density of the ball, relative to the median body. A lighter ball bounces off a wall.
SHOT_DENSITY = 4.0
# Limit of balls in a scene. Each ball slows drawing and enlarges recordings.
MOST_SHOTS = 200


def spring_impulse(mesh, point, target, timeStep):
    """Returns the impulse (3,), in N s, of a damped spring from a point of a body to a target.

    The spring has stiffness k = m ω² with ω = 2π GRAB_FREQUENCY, and is critically damped,
    d = 2 m ω. It is evaluated at the end of the step, like Catto's soft constraints (GDC 2011).
    With C = p − target, v the point's velocity, K its response to an impulse, v' = v + K J and
    J = −h (k (C + h v') + d v'):

        (K + γ 1) J = −(v + h k γ C),    γ = 1 / (h (d + h k))

    This is stable for every mass and every step h. For a point mass, the error after n steps is
    (a + b n) / (1 + ω h)ⁿ.

    point, target : (3,), in world axes; timeStep : s
    """
    omega = 2.0 * math.pi * GRAB_FREQUENCY
    stiffness, damping = mesh.mass * omega**2, 2.0 * mesh.mass * omega
    arm = np.asarray(point) - mesh.position[0]
    velocity = mesh.linVelocity[0] + np.cross(mesh.angVelocity[0], arm)
    x, y, z = arm
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    response = mesh.invMass * np.eye(3) - cross @ mesh.get_rotated_inv_IT() @ cross
    softness = 1.0 / (timeStep * (damping + timeStep * stiffness))
    error = np.asarray(point) - target
    wanted = velocity + timeStep * stiffness * softness * error
    return np.linalg.solve(response + softness * np.eye(3), -wanted)


class Grab:
    """A body, an index, held at a point (3,) in world axes. target (3,) : the cursor"""

    def __init__(self, mesh, body, point):
        self.body = body
        self.target = np.array(point, dtype=np.float64)
        self._arm = QRotate(QConj(mesh.orientation), self.target - mesh.position)

    def point(self, mesh):
        """Returns the point (3,) where the body is held, in world axes."""
        return (QRotate(mesh.orientation, self._arm) + mesh.position)[0]

    def pull(self, mesh, timeStep):
        """Pulls the body before a step while it is held.

        A fixed body follows the cursor by itself; the soft step lets it carry what it touches.
        """
        point = self.point(mesh)
        if mesh.isFixed:
            share = min(2.0 * math.pi * GRAB_FREQUENCY * timeStep, 1.0)
            mesh.position = mesh.position + share * (self.target - point)
        else:
            mesh.push(spring_impulse(mesh, point, self.target, timeStep), point)


def shot(meshes, size, position, direction):
    """Returns a ball that is shot from a position (3,) along a unit direction (3,), to be added.

    size : of the scene, in metres
    """
    density, name = SHOT_DENSITY * np.median([m.density for m in meshes]), f"shot {len(meshes)}"
    ball = Mesh.sphere(SHOT_RADIUS * size, density, position, name, SHOT_CORNERS)
    ball.linVelocity = SHOT_SPEED * size * np.asarray(direction)[None]
    return ball
