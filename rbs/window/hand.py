"""What a user does to bodies: selecting, dragging, throwing, pushing, fixing, shooting."""

import numpy as np

from rbs.scenes.grabbing import MOST_SHOTS, Grab, shot

# Speed that a push adds, in m/s.
PUSH_SPEED = 8.0
# Shown if the user drags or shoots in a replay.
UNCHANGEABLE = 'A recording is read-only; "Continue from here" turns it into a simulation'


class Hand:
    """The user's hand in a Viewer. grab : Grab of the dragged body, or None"""

    def __init__(self, viewer):
        self._viewer, self.grab = viewer, None
        self._pixel = self._distance = None  # of the dragged point, and its depth

    def _act(self, act, *given):
        with self._viewer.changing():
            act(*given)

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
        if not self._may_change():
            return
        if len(simulation.meshes) - simulation.sceneCount >= MOST_SHOTS:
            viewer.message = f"Limit of {MOST_SHOTS} balls reached; R removes them"
        else:
            ball = shot(simulation.meshes, viewer.view.size, *viewer.view.aim(pixel))
            self._act(simulation.add, ball)

    def pick_at(self, pixel):
        """Selects the body at a pixel, or none."""
        view = self._viewer.view
        view.pick(*view.body_at(pixel))
        view.refresh()

    def push(self, direction):
        """Pushes the selected body along a unit direction (3,), at the clicked point."""
        viewer, view = self._viewer, self._viewer.view
        viewer.leave_event()
        impulse = view.picked_mesh.mass * PUSH_SPEED * np.asarray(direction)
        self._act(view.picked_mesh.push, impulse, view.picked_point())

    def set_fixed(self, isFixed):
        """Fixes or frees the selected body."""
        self._act(setattr, self._viewer.view.picked_mesh, "isFixed", isFixed)
