"""Polyscope's camera as a `Camera`; and `Viewpoint`, which follows what happens beside the panels.

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
from rbs.pictures.backends import clip_drawing
from rbs.scenes.files import atomic_write

# Cosine of the least angle between camera and vertical at which `frame_all` keeps the direction.
STEEPEST = 0.99
# Least height of the camera above the ground, as a fraction of the scene's size.
LOWEST_EYE = 0.01
# Seconds in which a camera that follows covers two thirds of its way; those between looking where
# to; and the distance, as a fraction of the scene's size, at which it has arrived.
EASE, LOOK_SECONDS, ARRIVED = 0.4, 0.1, 2e-3
# Pixels left free around an event, for the names of its arrows.
EVENT_MARGINS = np.array([24, 28, 24, 28])
# Least part of the free picture that bodies fill, before a camera that follows comes nearer.
LOOSE = 0.55


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
    """The camera of a SceneView. It follows what happens, until the user turns it."""

    def __init__(self, view):
        self._view = view
        # pixels covered by panels at the left, top, right and bottom; the box outside which nothing
        # is drawn, or None
        self._margins, self._clipBox, self._windowSize = np.zeros(4), None, ps.get_window_size()

    def restart(self):
        """Shows a new scene."""
        self._held = self._goal = None  # Cameras: set here last, and to go to
        self._sinceLook = 0.0
        self._set(self._framing(self._scene_points(), VIEW_DIRECTION))

    def _scene_points(self):
        simulation = self._view.simulation
        return framed_points(simulation.meshes, simulation.constraints)

    def _set(self, camera):
        apply_camera(camera)
        self._held = present_camera()
        self._view.spread_ground()

    def _is_at(self, there):
        if there is None:
            return False
        now = present_camera()
        places = (now.eye, now.centre), (there.eye, there.centre)
        return np.allclose(*places, rtol=1e-4, atol=1e-4 * self._view.size)

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

    def frame_all(self):
        """Points the camera at all bodies in their present poses, or at those of an event and their
        arrows, in its present direction.

        Bodies flung far from the others are left out. If the camera has not moved since the last
        time, it takes the usual direction.
        """
        isSteep = abs(present_camera().axes[2][1]) > STEEPEST
        isThere = self._goal is None and self._is_at(self._held)
        points, self._goal = self._view.event_points(), None
        points = self._scene_points() if points is None else points
        self._set(self._framing(points, VIEW_DIRECTION if isThere or isSteep else None))

    def go_to_event(self):
        """Begins to move to the event that the view shows, in the present direction."""
        self._held, self._goal = present_camera(), self._framing(self._view.event_points())

    def follow(self, seconds):
        """Moves the camera gently towards an event, or to where it sees all bodies.

        seconds : since the last call. Returns whether it moves.
        """
        if not self._is_at(self._held):
            self._goal = None
        elif self._goal is None:
            self._sinceLook += seconds
            if self._sinceLook > LOOK_SECONDS:
                self._sinceLook = 0.0
                self._look_for_goal()
        if self._goal is None:
            return False
        camera = self._held.towards(self._goal, 1.0 - math.exp(-seconds / EASE))
        if np.linalg.norm(camera.eye - self._goal.eye) < ARRIVED * self._view.size:
            camera, self._goal = self._goal, None
        self._set(camera)
        return True

    def _look_for_goal(self):
        """Finds where the camera should go, if what it shows is covered or outside, or small."""
        points = self._view.event_points()
        if points is None:
            low, high = self._view.boxes()
            main = main_boxes(low, high)
            low, high = low[main] * [1.0, 0.0, 1.0], high[main]
            points = np.where(BOX_CORNERS, high[:, None], low[:, None]).reshape(-1, 3)
        camera, size, margins = present_camera(), self._windowSize, self._room()
        isSeen = are_seen(points, camera, size, margins)
        room = np.subtract(size, np.add(margins[:2], margins[2:]))
        isSmall = (np.ptp(camera.pixels(points, size), axis=0) < LOOSE * room).all()
        if not isSeen or isSmall:
            goal = self._framing(points)
            if np.linalg.norm(goal.eye - camera.eye) > ARRIVED * self._view.size:
                self._goal = goal

    def keep_in_view(self):
        """Points the camera at all bodies except outliers if it does not see them."""
        self._look_for_goal()
        if self._goal is not None:
            self._set(self._goal)
            self._goal = None

    def keep_above_ground(self):
        """Raises a camera that has been turned below the ground."""
        camera, lowest = present_camera(), LOWEST_EYE * self._view.size
        if camera.eye[1] < lowest:
            ends = np.array([camera.eye, camera.centre])
            ends[:, 1] = np.maximum(ends[:, 1], lowest)
            apply_camera(Camera.looking(*ends, camera.angle))

    def set_margins(self, margins, size):
        """Sets the pixels that panels cover at the left, top, right and bottom of the window.

        size : of the window. A camera that follows then sees everything beside them.
        """
        isOther, self._windowSize = size != self._windowSize, size
        self._margins = np.array(margins)
        if isOther:
            self.clip()

    def set_clip(self, clipBox):
        """Sets the box (left, top, width, height) outside which nothing is drawn, or None."""
        if clipBox != self._clipBox:
            self._clipBox = clipBox
            self.clip()

    def clip(self, isOn=True):
        """Draws nothing behind the panels, unless the window is supersampled."""
        view, size = self._view, self._windowSize
        if not isOn or self._clipBox is None or view.callback is None or view.isSmooth:
            clip_drawing()
        else:
            left, top, width, height = self._clipBox
            scale, corner = np.divide(ps.get_buffer_size(), size), (left, size[1] - top - height)
            clip_drawing((*(scale * corner), *np.ceil(scale * (width, height))))

    def _off_centre(self, camera):
        """Way (3,) from the camera's centre to what is in the middle between the panels."""
        left, top, right, bottom = self._room()
        pixel = camera.pixel_angle(self._windowSize) * np.linalg.norm(camera.centre - camera.eye)
        return 0.5 * pixel * np.array([left - right, bottom - top, 0.0]) @ camera.axes

    @contextmanager
    def whole_width(self):
        """Draws behind the panels too, within the `with` block, around what is between them."""
        self.clip(False)
        try:
            with kept_camera() as camera:
                apply_camera(camera.moved(self._off_centre(camera)))
                yield
        finally:
            self.clip()
