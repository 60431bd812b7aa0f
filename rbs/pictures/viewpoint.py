"""Polyscope's camera as a `Camera`; and `Viewpoint`, which shows a scene beside the panels.

Units: metres, degrees, pixels.
"""

import math
from contextlib import contextmanager

import numpy as np
import polyscope as ps

from rbs.appearance.camera import (
    VIEW_DIRECTION,
    Camera,
    are_seen,
    frame_camera,
    framed_points,
    main_boxes,
)
from rbs.appearance.drawables import BOX_CORNERS
from rbs.scenes.files import atomic_write

# Cosine of the least angle between camera and vertical at which `frame` keeps the direction.
STEEPEST = 0.99
# Directions to the camera from the front, the right and above.
FRONT, SIDE, TOP = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 1e-3)
# Size of the region that is framed around a selected body, in sizes of the body.
AROUND_BODY = 3.0
# Least height of the camera above the ground, as a fraction of the scene's size.
LOWEST_EYE = 0.01
# Seconds in which the camera covers two thirds of its way to an event; and the distance, as a
# fraction of the scene's size, at which it has arrived.
EASE, ARRIVED = 0.3, 2e-3
# Pixels left free around an event, for the names of its arrows.
EVENT_MARGINS = np.array([24, 28, 24, 28])


def present_camera():
    """Returns Polyscope's camera, a `Camera`."""
    view = ps.get_view_camera_parameters()
    axes = view.get_right_dir(), view.get_up_dir(), view.get_look_dir()
    eye, axes, centre = (
        np.array(part, dtype=np.float64)
        for part in (view.get_position(), axes, ps.get_view_center())
    )
    return Camera(eye, axes, view.get_fov_vertical_deg(), centre)


def apply_camera(camera):
    """Gives Polyscope a `Camera`, and the centre of its orbits, if it has one.

    Polyscope's `set_view_from_json` would also change the window's size and the clipping range, and
    not the field of view.
    """
    if not np.isfinite(camera.matrix).all():
        return  # it would crash when a body is picked
    ps.set_vertical_fov_degrees(camera.angle)
    ps.set_camera_view_matrix(camera.matrix)
    if camera.centre is not None:
        ps.set_view_center_raw(camera.centre)


def save_camera(path):
    """Writes Polyscope's camera as JSON, replacing an old file atomically."""
    with atomic_write(path) as partial:
        partial.write_text(ps.get_view_as_json() + "\n", encoding="ascii")


@contextmanager
def kept_camera():
    """Restores Polyscope's camera after the `with` block, to the bit; yields it."""
    camera, matrix = present_camera(), ps.get_camera_view_matrix()
    try:
        yield camera
    finally:
        apply_camera(camera)
        ps.set_camera_view_matrix(matrix)


class Viewpoint:
    """The camera of a SceneView. In the window, it moves only when it is asked to."""

    def __init__(self, view):
        self._view = view
        self.stay()
        # pixels covered by panels at the left, top, right and bottom
        self._margins, self._windowSize = np.zeros(4), ps.get_window_size()

    def restart(self):
        """Takes the first view of a scene, with room for what falls and swings."""
        self.stay()
        simulation = self._view.simulation
        points = framed_points(simulation.meshes, simulation.constraints)
        self._extent = points.min(axis=0), points.max(axis=0)
        self._first = self._framing(points, VIEW_DIRECTION)
        self._set(self._first)

    def _set(self, camera):
        apply_camera(camera)
        self._view.spread_ground()

    def _room(self):
        """Returns the margins, larger around an event, which leave a third of the window."""
        names = EVENT_MARGINS if self._view.highlight is not None else 0
        margins, most = self._margins + names, 2 / 3 * np.tile(self._windowSize, 2)
        return margins * np.minimum(most / np.maximum(np.tile(margins[:2] + margins[2:], 2), 1), 1)

    def _framing(self, points, direction=None):
        """Returns the nearest Camera that sees points (n, 3) beside the panels.

        direction : to the camera, by default the present one
        """
        now = present_camera()
        direction = -now.axes[2] if direction is None else direction
        return frame_camera(points, direction, now.angle, self._windowSize, self._room())

    def _box_points(self, bodies):
        """Corners (n, 3) of the boxes of bodies, by index, down to the ground."""
        low, high = (side[bodies] for side in self._view.boxes())
        low[:, 1] = np.minimum(low[:, 1], 0.0)
        return np.where(BOX_CORNERS, high[:, None], low[:, None]).reshape(-1, 3)

    def _together(self):
        """Indices of the scene's bodies that are not farther from its first view than its size."""
        view, (low, high) = self._view, self._extent
        reach = max(high - low)
        place = view.poses[:3, : view.simulation.sceneCount].T
        isNear = ((place > low - reach) & (place < high + reach)).all(axis=1)
        return np.flatnonzero(isNear) if isNear.any() else main_boxes(*view.boxes())

    def frame(self, direction=None):
        """Points the camera at an event, or else the selected body, or else all that belong
        together, from a direction, by default the present one.
        """
        self.stay()
        view, points = self._view, self._view.event_points()
        if points is None and view.picked is not None:
            middle = view.poses[:3, view.picked]
            points = middle + AROUND_BODY * (view.vertices_of(view.picked) - middle)
        elif points is None:
            points = self._box_points(self._together())
        isSteep = direction is None and abs(present_camera().axes[2][1]) > STEEPEST
        self._set(self._framing(points, VIEW_DIRECTION if isSteep else direction))

    def come_back(self):
        """Takes the first view again if the present one shows nothing of the scene."""
        places = self._view.poses[:3, self._together()].T
        if not are_seen(places, present_camera(), self._windowSize, self._room()).any():
            self.stay()
            self._set(self._first)

    def go_to_event(self):
        """Begins to move to the event that the view shows, in the present direction."""
        self._isGoing, self._left = True, self._left or present_camera()

    def stay(self):
        """Ends the move to an event, and forgets where the camera was before the events."""
        # whether the camera moves to an event; where it was before the first event, or None
        self._isGoing, self._left = False, None

    def leave_events(self):
        """Goes back to where the camera was before the events."""
        if self._left is not None:
            self._set(self._left)
        self.stay()

    def move(self, seconds):
        """Moves the camera gently towards an event, until it is there or `stay` is called.

        seconds : since the last call. Returns whether it moves.
        """
        if not self._isGoing or (points := self._view.event_points()) is None:
            return False
        goal = self._framing(points)
        camera = present_camera().towards(goal, 1.0 - math.exp(-seconds / EASE))
        self._isGoing = np.linalg.norm(camera.eye - goal.eye) > ARRIVED * self._view.size
        self._set(camera if self._isGoing else goal)
        return True

    def frame_all(self):
        """Points the camera at all bodies except outliers, from the present direction."""
        self._set(self._framing(self._box_points(main_boxes(*self._view.boxes()))))

    def keep_above_ground(self):
        """Raises a camera that has been turned below the ground."""
        camera, lowest = present_camera(), LOWEST_EYE * self._view.size
        if self._view.simulation.settings.ground and camera.eye[1] < lowest:
            ends = np.array([camera.eye, camera.centre])
            ends[:, 1] = np.maximum(ends[:, 1], lowest)
            apply_camera(Camera.looking(*ends, camera.angle))

    def set_picture(self, box, size, above=0, below=0):
        """Sets the box (left, top, width, height) beside the panels of a window of this size, and
        how much messages cover at its top and bottom; the camera's target is seen in the rest.
        """
        left, top, width, height = box
        right, bottom = np.subtract(size, (left + width, top + height))
        self._margins = np.array([left, top + above, right, bottom + below])
        self._windowSize = size

    def _off_centre(self, camera):
        """Shift (3,) from the camera's centre to the point in the middle between the panels."""
        left, top, right, bottom = self._room()
        pixel = camera.pixel_angle(self._windowSize) * np.linalg.norm(camera.centre - camera.eye)
        return 0.5 * pixel * np.array([left - right, bottom - top, 0.0]) @ camera.axes

    @contextmanager
    def whole_width(self):
        """Centres what is seen between the panels in the window, in the `with` block."""
        with kept_camera() as camera:
            shift = self._off_centre(camera)
            apply_camera(camera._replace(eye=camera.eye + shift, centre=camera.centre + shift))
            yield
