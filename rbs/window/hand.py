"""What a user does to bodies: selecting, dragging, throwing, pushing, fixing, shooting.

From the top: the spring that drags a body, and the ball that is shot; `Hand`, which uses them.
Units: metres, kilograms, seconds.
"""

import math

import numpy as np

from Quaternion import QConj, QRotate
from rbs.scenes import shapes

# Hz, the frequency of the spring. The body reaches the cursor within half a second, and hangs
# g / ω² = 6 cm below it, invisible on bodies of metres. Stiffer springs tear it through others.
GRAB_FREQUENCY = 2.0
# Radius of the ball, and its distance covered in a second, as fractions of the scene's size.
SHOT_RADIUS, SHOT_SPEED = 0.03, 1.0
# Corners of the ball; a rounder one slows its contacts.
SHOT_CORNERS = 42
# Density of the ball, relative to the median body. A lighter ball bounces off a wall.
SHOT_DENSITY = 4.0
# Speed that a push adds, in m/s.
PUSH_SPEED = 8.0
# Shown if the user drags or shoots in a replay.
UNCHANGEABLE = 'A recording is read-only; "Continue from here" turns it into a simulation'


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
    cross = np.cross(np.eye(3), arm)
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
    ball = shapes.sphere(SHOT_RADIUS * size, density, position, name, SHOT_CORNERS)
    ball.linVelocity = SHOT_SPEED * size * np.asarray(direction)[None]
    return ball


class Hand:
    """The user's hand in a Viewer. grab : Grab of the dragged body, or None"""

    def __init__(self, viewer):
        self._viewer, self.grab = viewer, None
        self._pixel = self._distance = None  # of the dragged point, and its depth

    def _may_change(self):
        self._viewer.message = UNCHANGEABLE if self._viewer.isReplay else ""
        return not self._viewer.isReplay

    def grab_at(self, pixel):
        """Starts dragging the body at a pixel, by the visible point."""
        viewer, view = self._viewer, self._viewer.view
        self.release()
        body, point = view.body_at(pixel)
        if body is not None and self._may_change():
            rest = view.rest_point(body, point)
            viewer.leave_event()
            point = view.world_point(body, rest)
            self.grab = Grab(viewer.simulation.meshes[body], body, point)
            self._pixel, self._distance = pixel, view.distance_of(point)

    def drag_to(self, pixel):
        """Moves the target of the spring to a pixel, at the distance where the drag began.

        While paused, the body itself moves.
        """
        viewer, grab = self._viewer, self.grab
        if grab is None or not viewer.isPlaying and pixel == self._pixel:
            return
        self._pixel = pixel
        grab.target = viewer.view.point_at(pixel, self._distance)
        mesh = viewer.simulation.meshes[grab.body]
        way = grab.target - grab.point(mesh)
        if not viewer.isPlaying and way.any():
            with viewer.changing(topic=grab):  # a drag is a single change
                mesh.position = mesh.position + way
                viewer.simulation.report = None  # of where it was

    def release(self):
        """Ends the drag. The body keeps its velocity."""
        self.grab = None

    def pull(self):
        """Lets the spring of a drag act on the next step. Returns the state after it, or None."""
        if self.grab is None:
            return None
        simulation = self._viewer.simulation
        mesh = simulation.meshes[self.grab.body]
        self.grab.pull(mesh, simulation.settings.timeStep)
        return simulation.state()

    def shoot(self, pixel):
        """Shoots a ball from the camera towards a pixel."""
        viewer, simulation = self._viewer, self._viewer.simulation
        if self._may_change():
            ball = shot(simulation.meshes, viewer.view.size, *viewer.view.aim(pixel))
            with viewer.changing():
                simulation.add(ball)

    def pick_at(self, pixel):
        """Selects the body at a pixel, or none."""
        view = self._viewer.view
        view.pick(*view.body_at(pixel))
        view.refresh()

    def push(self, direction):
        """Pushes the selected body along a unit direction (3,), at the clicked point."""
        viewer, view = self._viewer, self._viewer.view
        impulse = view.picked_mesh.mass * PUSH_SPEED * np.asarray(direction)
        with viewer.changing():
            view.picked_mesh.push(impulse, view.picked_point())

    def set_fixed(self, isFixed):
        """Fixes or frees the selected body; so is ours beside a student's."""
        simulation, body = self._viewer.simulation, self._viewer.view.picked
        with self._viewer.changing():
            for run in (simulation, simulation.beside and simulation.beside.ours):
                if run is not None:
                    run.meshes[body].isFixed = isFixed
