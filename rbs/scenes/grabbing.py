"""What hands do in the window, as physics: the spring that drags a body, the ball that is shot.

From the top: `spring_impulse`; `Grab`; `ball_shape` and `shot`. Nothing here draws.

Units: metres, kilograms, seconds.
"""

import math
from functools import lru_cache

import numpy as np

from Quaternion import QConj, QRotate
from rbs.scenes.changes import Shape, add, push
from rbs.scenes.meshfiles import load_mesh_file
from rbs.scenes.scenefiles import DATA_FOLDER

# Hz. The body is at the hand within half a second; it hangs g / ω² = 6 cm below, which nobody sees
# of bodies that are metres large. A stiffer spring would tear it through others.
GRAB_FREQUENCY = 2.0
# Of the scene's size: the radius of the ball that is shot, and how far it flies in a second.
SHOT_RADIUS, SHOT_SPEED = 0.03, 1.0
# How many times as dense as the scene's median body: a lighter one bounces off a wall.
SHOT_DENSITY = 4.0
# The most balls that can be shot into a scene: each makes the pictures and recordings larger.
MOST_SHOTS = 200


def spring_impulse(mesh, point, target, timeStep, frequency=GRAB_FREQUENCY):
    """The impulse (3,), in N s, by which a spring and a damper draw a point of a body to a target.

    The spring, of the stiffness k = m ω² with ω = 2π frequency, is critically damped, d = 2 m ω,
    and taken at the end of the step, as Catto's soft constraints are (GDC 2011): with
    C = p − target, v the point's velocity, and K its response to an impulse, v' = v + K J and
    J = −h (k (C + h v') + d v'), so that

        (K + γ 1) J = −(v + h k γ C),    γ = 1 / (h (d + h k))

    It is stable for every mass and every step h. Of a point mass that is drawn, the error after n
    steps is (a + b n) / (1 + ω h)ⁿ. Nothing moves a fixed body.

    point, target : (3,), of the world
    """
    if mesh.isFixed:
        return np.zeros(3)
    omega = 2.0 * math.pi * frequency
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
    """A body that is held by a point of it. Attributes: body, its index; target (3,), the hand."""

    def __init__(self, mesh, body, point):
        """point : (3,), where the body is held, in the world"""
        self.body = body
        self.target = np.array(point, dtype=np.float64)
        self._arm = QRotate(QConj(mesh.orientation), self.target - mesh.position)

    def point(self, mesh):
        """Where the body is held now, (3,)."""
        return (QRotate(mesh.orientation, self._arm) + mesh.position)[0]

    def change(self, mesh, timeStep):
        """The `Change` that a step of timeStep begins with, while the body is held."""
        point = self.point(mesh)
        return push(self.body, spring_impulse(mesh, point, self.target, timeStep), point)


@lru_cache(maxsize=1)
def _unit_ball():
    """Vertices, faces and tets of a ball of radius 1."""
    vertices, faces, tets = load_mesh_file(DATA_FOLDER / "ball.mesh")
    vertices = vertices - vertices.mean(axis=0)
    return vertices / np.linalg.norm(vertices, axis=1).max(), faces, tets


def shot(meshes, size, position, direction):
    """The `Change` that shoots a ball into a scene.

    size : of the scene, in metres; position (3,), of the ball; direction (3,), a unit vector
    """
    vertices, faces, tets = _unit_ball()
    body = len(meshes)
    shape = Shape(f"shot {body}", SHOT_RADIUS * size * vertices, faces, tets)
    density = SHOT_DENSITY * float(np.median([mesh.density for mesh in meshes]))
    velocity = SHOT_SPEED * size * np.asarray(direction)
    return add(body, shape, density, position, velocity)
