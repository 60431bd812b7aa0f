"""Cameras: viewpoints that show a whole scene, those saved in files, and options of pictures.

Units: metres, degrees, pixels.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rbs.appearance.drawables import SUN
from rbs.geometry.triples import dot
from rbs.scenes.files import check_readable
from rbs.scenes.messages import InputError, one_line
from RBSFunctions import refresh_vertices

# Direction from the middle of the scene to the camera: slightly from the right and from above.
VIEW_DIRECTION = (0.45, 0.36, 1.0)
# Free margin of a picture, as a fraction of its size.
FRAME_MARGIN = 0.08
# For newly framed stills: the direction, which is lower; the vertical field of view in degrees; the
# additional free margin above and below.
STILL_DIRECTION, STILL_ANGLE, STILL_MARGIN = (0.45, 0.28, 1.0), 30.0, 0.11
# A body is an outlier if it is this many times farther from the middle than all nearer bodies
# reach. The nearer ones are at least the fraction MAIN_SHARE of all.
FLUNG, MAIN_SHARE = 2.5, 0.8
# Slope of the cone into which free bodies may fall apart. Less leaves more room beside them.
PILE_SLOPE = 0.27
# Required content of a camera file, for the message.
CONTENT = "it needs viewMat, a rigid motion as 16 numbers, and fov, an angle in degrees"
# Largest entry of a camera matrix, in metres, well beyond what single precision can draw.
FARTHEST_CAMERA = 1e9
# Default width and height of a picture, and the least and largest: a thumbnail, and 8K.
PICTURE_SIZE, PICTURE_SIZES = (1280, 720), (16, 8192)
# Height of a picture in which marks have their usual sizes; they grow with larger ones.
USUAL_HEIGHT = 720
# Looks of pictures: as in the window, or with sky light and soft shadows, which takes seconds.
LOOKS = ("plain", "studio")
# Default frame rate of videos, in frames per second: smooth, and a divisor of the usual step rate.
VIDEO_RATE = 25.0
# The least and most frames per second that an encoder accepts.
SLOWEST_VIDEO, FASTEST_VIDEO = 0.01, 1e4


class Camera(NamedTuple):
    """A viewpoint.

    eye (3,) : its position; axes (3, 3) : unit vectors to the right, up and ahead, as rows
    angle : vertical field of view; centre (3,) : the point that it looks at, or None
    """

    eye: np.ndarray
    axes: np.ndarray
    angle: float
    centre: np.ndarray | None = None

    @classmethod
    def looking(cls, eye, centre, angle):
        """Returns the camera that looks from `eye` to `centre` (3,), upright."""
        eye, centre = (np.asarray(place, dtype=np.float64) for place in (eye, centre))
        ahead = (centre - eye) / np.linalg.norm(centre - eye)
        right = np.cross(ahead, [0.0, 1.0, 0.0])
        right /= np.linalg.norm(right)
        return cls(eye, np.array([right, np.cross(right, ahead), ahead]), angle, centre)

    @property
    def matrix(self):
        """The matrix (4, 4) from the world to the camera, which looks along its -z."""
        turn = self.axes * [[1.0], [1.0], [-1.0]]
        return np.block([[turn, (-turn @ self.eye)[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]])

    def pixel_angle(self, size):
        """Tangent of a pixel's angle. size : width and height of the picture"""
        return 2.0 * math.tan(math.radians(self.angle) / 2.0) / size[1]

    def depths(self, points):
        """Distances (n,) of points (n, 3) ahead of the camera, negative behind it."""
        return (np.reshape(points, (-1, 3)) - self.eye) @ self.axes[2]

    def pixels(self, points, size):
        """Pixels (n, 2) at which points (n, 3) are seen in a picture; NaN behind the camera."""
        x, y, depth = self.axes @ (np.reshape(points, (-1, 3)) - self.eye).T
        scale = 1.0 / (self.pixel_angle(size) * np.where(depth > 0.0, depth, np.nan))
        return np.stack([0.5 * size[0] + scale * x, 0.5 * size[1] - scale * y], axis=1)

    def rays(self, row, column, size):
        """Unit vectors (3, m), float32, through places (m,); a pixel's middle is at 0.5."""
        right, up, ahead = self.axes.astype(np.float32)[:, :, None]
        pixel = self.pixel_angle(size)
        x = ((column - size[0] / 2.0) * pixel).astype(np.float32)
        y = ((size[1] / 2.0 - row) * pixel).astype(np.float32)
        rays = ahead + x * right + y * up
        rays /= np.sqrt(dot(rays, rays))
        return rays

    def towards(self, other, share):
        """Returns the upright camera on the way to another one, share 0 to 1."""
        eye, centre = (
            here + share * (there - here)
            for here, there in ((self.eye, other.eye), (self.centre, other.centre))
        )
        return Camera.looking(eye, centre, self.angle)


def load_camera(path):
    """Returns the Camera in a file of Polyscope's, which itself would silently ignore a broken one.

    Raises InputError, one line, if the file cannot be read or holds no camera.
    """
    try:
        check_readable(path)
        camera = json.loads(Path(path).read_bytes())
        matrix = np.array(camera["viewMat"], dtype=np.float64).reshape(4, 4)
        angle, turn = float(camera["fov"]), matrix[:3, :3]
        # all of these are false for NaN
        isRigid = np.allclose(turn @ turn.T, np.eye(3), atol=1e-3)
        if not (isRigid and np.all(np.abs(matrix) < FARTHEST_CAMERA) and 0.0 < angle < 180.0):
            raise ValueError("no camera sees a scene from there")
    except OSError as error:
        raise InputError(f"{path}: {one_line(error)}") from None
    except json.JSONDecodeError as error:
        raise InputError(f"{path}:{error.lineno}: this is not a JSON file: {error.msg}") from None
    except (ValueError, TypeError, LookupError, OverflowError, RecursionError):
        raise InputError(f"{path}: this is not a Polyscope camera: {CONTENT}") from None
    return Camera(-turn.T @ matrix[:3, 3], turn * [[1.0], [1.0], [-1.0]], angle)


def frame_still(meshes, size):
    """Returns the Camera of a still, which is low and sees the bodies, except those flung far from
    the others, and their shadows in the sun. size : width and height of the picture in pixels
    """
    vertices = refresh_vertices([meshes[body] for body in main_bodies(meshes)])
    shadows, rim = vertices - vertices[:, 1:2] * SUN / SUN[1], 0.5 * FRAME_MARGIN
    margins = 0, STILL_MARGIN * size[1], 0, STILL_MARGIN * size[1]
    near, far = (
        frame_camera(points, STILL_DIRECTION, STILL_ANGLE, size, margins)
        for points in (vertices, np.concatenate([vertices, shadows]))
    )
    # points seen by two cameras are seen from between them, too; the bodies stay near the middle
    for share in np.linspace(0.0, 1.0, 9):
        camera = near.towards(far, share)
        if are_seen(shadows, camera, size, [rim * side for side in (*size, *size)]).all():
            break
    return camera


def boxes_of(meshes):
    """Returns the bounding boxes of bodies, low and high (n, 3)."""
    vertices = refresh_vertices(meshes)
    first = np.cumsum([0] + [len(mesh.origVertices) for mesh in meshes[:-1]])
    return np.minimum.reduceat(vertices, first), np.maximum.reduceat(vertices, first)


def main_bodies(meshes):
    """Returns the indices of the bodies except those flung far from the others."""
    return main_boxes(*boxes_of(meshes))


def main_boxes(low, high):
    """Returns the indices of boxes low, high (n, 3), except those far from the others."""
    middles = 0.5 * (low + high)
    away = np.linalg.norm(middles - np.median(middles, axis=0), axis=1)
    order = np.argsort(away, kind="stable")
    reach = np.maximum.accumulate((away + np.linalg.norm(high - low, axis=1))[order])
    isGap = away[order][1:] > FLUNG * reach[:-1]
    isGap[: math.ceil(MAIN_SHARE * len(away)) - 1] = False
    return order[: 1 + isGap.argmax()] if isGap.any() else order


def framed_points(meshes, constraints):
    """Returns what a view shows: points (n, 3) of the bodies except outliers, and below them.

    It leaves room for what follows. Bodies tied to fixed ones swing: their mirror images in the
    vertical line through the middle of the fixed ones. Bodies in the air fall: the rim of a cone
    into which they may fall apart.
    """
    main = [meshes[body] for body in main_bodies(meshes)]
    vertices = [refresh_vertices(main)]
    tied = [meshes[body] for body in sorted({body for one in constraints for body in one[0:3:2]})]
    fixed, free = ([one for one in tied if one.isFixed == isFixed] for isFixed in (True, False))
    if fixed and free:
        middle = np.mean([mesh.position[0] for mesh in fixed], axis=0)
        vertices.append(middle + (refresh_vertices(free) - middle) * [-1.0, 1.0, -1.0])
    vertices.append(pile_rim(main))
    points = np.concatenate(vertices)
    return np.concatenate([points, points * [1.0, 0.0, 1.0]])


def pile_rim(meshes):
    """Returns points (n, 3) on the ground around the cone that bodies in the air may fall into."""
    low, high = boxes_of(meshes)
    below = low - [[0.0, 0.05, 0.0]] * (high - low)
    isApart = (below[:, None] > high).any(axis=2) | (below > high[:, None]).any(axis=2)
    np.fill_diagonal(isApart, True)
    isFree = ~np.array([mesh.isFixed for mesh in meshes])
    falls = isFree & isApart.all(axis=1) & (below[:, 1] > 0.0)
    if not falls.any():
        return np.zeros((0, 3))
    volume = 0.5 * np.prod(high - low, axis=1)[falls].sum()
    radius = (3.0 * volume / (math.pi * PILE_SLOPE)) ** (1.0 / 3.0)
    angle = np.linspace(0.0, 2.0 * math.pi, 16, endpoint=False)
    rim = radius * np.stack([np.cos(angle), 0.0 * angle, np.sin(angle)], axis=1)
    return rim + 0.5 * (low + high)[falls].mean(axis=0) * [1.0, 0.0, 1.0]


def are_seen(points, camera, size, margins):
    """Whether a Camera sees points (n, 3) in a picture, within margins (left, top, ...): (n,)."""
    pixels = camera.pixels(points, size)  # NaN is not seen
    return ((pixels > margins[:2]) & (pixels < np.subtract(size, margins[2:]))).all(axis=1)


def frame_camera(points, direction, angle, size, margins=(0, 0, 0, 0)):
    """Returns the nearest Camera that sees all points beside the panels.

    points : (n, 3); direction : from the middle of their bounding box to the camera
    angle : vertical field of view; size : width and height of the window; margins : pixels covered
        by panels at the left, top, right and bottom
    """
    backward = np.divide(direction, np.linalg.norm(direction))
    facing = Camera.looking(backward, np.zeros(3), angle)
    right, up, _ = facing.axes
    middle = (np.min(points, axis=0) + np.max(points, axis=0)) / 2.0
    arms = points - middle
    # A camera at (X, Z), with z towards it, sees a point (x, z) if -(Z - z) s ≤ x - X ≤ (Z - z) t,
    # where s and t are the tangents of the angles to the picture's sides. Hence X + Z t ≥ x + z t
    # and -X + Z s ≥ -x + z s. Both sides touch the points for the nearest camera.
    depths = arms @ backward
    width, height = size
    left, top, rightMargin, bottom = margins
    perPixel = facing.pixel_angle(size)
    sides = []
    for axis, low, high in (
        (right, width / 2.0 - left, width / 2.0 - rightMargin),
        (up, height / 2.0 - bottom, height / 2.0 - top),
    ):
        rim = FRAME_MARGIN / 2.0 * (low + high)
        s, t = perPixel * (low - rim), perPixel * (high - rim)
        ends = np.max(arms @ axis + t * depths), np.max(-arms @ axis + s * depths)
        sides.append((axis, s, t, *ends))
    distance = max((high + low) / (s + t) for _, s, t, high, low in sides)
    centre = middle.copy()
    for axis, s, t, high, low in sides:
        centre += ((high - distance * t) - (low - distance * s)) / 2.0 * axis
    return Camera.looking(centre + distance * backward, centre, angle)


@dataclass
class PictureOptions:
    """Appearance of pictures and videos, apart from the scene.

    size : (width, height) in pixels; camera : `Camera`, or None to show the whole scene;
    colouring : a name of COLOURINGS; overlays : names of OVERLAYS; look : one of LOOKS
    """

    size: tuple = PICTURE_SIZE
    camera: Camera | None = None
    colouring: str = "body"
    overlays: tuple = ()
    look: str = "plain"


def video_timing(timeStep, every=None):
    """Returns frames per second and steps per frame, `(rate, every)`, of a video in real time.

    timeStep : seconds; every : steps per frame, or None for about VIDEO_RATE
    """
    if every is None:
        every = max(1, round(1.0 / (VIDEO_RATE * timeStep)))
    return min(max(1.0 / (every * timeStep), SLOWEST_VIDEO), FASTEST_VIDEO), every
