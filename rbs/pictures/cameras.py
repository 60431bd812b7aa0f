"""The camera: where it stands to see a scene, and files that say so.

From the top: reading, applying and writing a camera; framing a scene. Polyscope is imported inside
the functions that use it.

Units: metres, degrees.
"""

import json
import math
from contextlib import contextmanager

import numpy as np

from rbs.appearance.drawables import SUN, cast_shadows
from rbs.scenes.files import atomic_write, read_bytes
from rbs.scenes.messages import InputError, reason_of
from RBSFunctions import refresh_vertices

# From the middle of the scene to the camera: a little from the right, a little from above.
VIEW_DIRECTION = (0.45, 0.36, 1.0)
# The free rim of a picture, as a fraction of its size.
FRAME_MARGIN = 0.08
# Of stills that are framed anew: likewise, but low; the angle upwards in degrees; and the further
# free rim above and below.
STILL_DIRECTION, STILL_ANGLE, STILL_MARGIN = (0.45, 0.28, 1.0), 30.0, 0.11
# By which part of its distance the camera may stand back so that shadows are in the picture too.
SHADOW_ROOM = 0.3
# A body is flung away if it is so many times further from the middle than all nearer ones reach,
# which are at least this share of all.
FLUNG, MAIN_SHARE = 2.5, 0.8
# What a camera file has to hold.
CAMERA = "it needs viewMat, a rigid motion as 16 numbers, and fov, an angle in degrees"
# Metres: as far as Polyscope's single precision still tells what is seen, and more.
FARTHEST_CAMERA = 1e9
# The longest file that is looked at, in bytes: a camera takes some 600.
CAMERA_BYTES = 1 << 20


class CameraError(InputError):
    """A camera that cannot be used. Reads "file: cause" in one line."""


def load_camera(path):
    """Reads a camera as Polyscope writes it, of which it would ignore a broken one silently.

    returns a dict: viewMat (4, 4), from the world to the camera; fov, upwards, in degrees
    raises CameraError that says in one line what is wrong with the file
    """
    try:
        camera = json.loads(read_bytes(path, CAMERA_BYTES))
        viewMat = np.array(camera["viewMat"], dtype=np.float64).reshape(4, 4)
        fov = float(camera["fov"])
        # Of NaN, all of these are false.
        isRigid = np.allclose(viewMat[:3, :3] @ viewMat[:3, :3].T, np.eye(3), atol=1e-3)
        if not (isRigid and np.all(np.abs(viewMat) < FARTHEST_CAMERA) and 0.0 < fov < 180.0):
            raise ValueError("no camera sees a scene from there")
    except OSError as error:
        raise CameraError(f"{path}: {reason_of(error)}") from None
    except json.JSONDecodeError as error:
        raise CameraError(f"{path}:{error.lineno}: this is not a JSON file: {error.msg}") from None
    except (ValueError, TypeError, LookupError, OverflowError, RecursionError):
        raise CameraError(f"{path}: this is not a camera of Polyscope's: {CAMERA}") from None
    return {"viewMat": viewMat, "fov": fov}


def apply_camera(camera):
    """Puts Polyscope's camera where `load_camera` says.

    Polyscope's own `set_view_from_json` would also change the window's size and how far is seen,
    and leaves the angle as it is.
    """
    import polyscope as ps

    ps.set_vertical_fov_degrees(camera["fov"])
    ps.set_camera_view_matrix(camera["viewMat"])


def save_camera(path):
    """Writes Polyscope's camera as JSON, in place of an old file: whole or not at all."""
    import polyscope as ps

    with atomic_write(path) as partial:
        partial.write_text(ps.get_view_as_json() + "\n", encoding="ascii")


@contextmanager
def kept_camera():
    """Within it, Polyscope's camera may be moved; afterwards it is where it was."""
    import polyscope as ps

    matrix = ps.get_camera_view_matrix()
    angle = ps.get_view_camera_parameters().get_fov_vertical_deg()
    try:
        yield
    finally:
        apply_camera({"viewMat": matrix, "fov": angle})


def point_still_camera(meshes):
    """Points Polyscope's camera, from low down, at bodies and their shadows in the studio's sun.

    Bodies that are flung far from the others do not count.
    """
    import polyscope as ps

    refresh_vertices(meshes)
    middles = np.array([np.mean(mesh.currVertices, axis=0) for mesh in meshes])
    away = np.linalg.norm(middles - np.median(middles, axis=0), axis=1)
    sizes = [np.linalg.norm(np.ptp(mesh.currVertices, axis=0)) for mesh in meshes]
    order = np.argsort(away, kind="stable")
    reach = np.maximum.accumulate((away + sizes)[order])
    isGap = away[order][1:] > FLUNG * reach[:-1]
    isGap[: math.ceil(MAIN_SHARE * len(meshes)) - 1] = False
    main = order[: 1 + isGap.argmax()] if isGap.any() else order
    vertices = np.concatenate([meshes[b].currVertices for b in main])
    width, height = ps.get_window_size()
    margins = 0, STILL_MARGIN * height, 0, STILL_MARGIN * height
    how = STILL_DIRECTION, STILL_ANGLE, (width, height), margins
    near = np.array(frame_camera(vertices, *how))
    shadows = cast_shadows(vertices, 0.0, -SUN / SUN[1])
    far = np.array(frame_camera(np.concatenate([vertices, shadows]), *how))
    distance, farDistance = (np.linalg.norm(eye - target) for eye, target in (near, far))
    # What is seen by two cameras is seen from between them, too: no further on than is needed.
    most = min(1.0, SHADOW_ROOM * distance / max(farDistance - distance, 1e-9 * distance))
    for share in most * np.linspace(0.0, 1.0, 9):
        eye, target = near + share * (far - near)
        if are_seen(shadows, eye, target, STILL_ANGLE, width / height):
            break
    ps.set_vertical_fov_degrees(STILL_ANGLE)
    ps.look_at(eye, target)


def are_seen(points, eye, target, fieldOfView, aspect):
    """Whether a camera sees all points (n, 3), and a little rim around them."""
    backward, right, up = view_axes(eye - target)
    away = points - eye
    half = -math.tan(math.radians(fieldOfView) / 2.0) * (1.0 - FRAME_MARGIN) * (away @ backward)
    return bool((np.abs(away @ up) < half).all() and (np.abs(away @ right) < aspect * half).all())


def view_axes(direction):
    """Unit vectors (3,) of a camera that stands in this direction: towards it, right and up."""
    backward = np.asarray(direction, dtype=np.float64)
    backward = backward / np.linalg.norm(backward)
    right = np.cross([0.0, 1.0, 0.0], backward)
    right /= np.linalg.norm(right)
    return backward, right, np.cross(backward, right)


def frame_camera(points, direction, fieldOfView, size, margins=(0, 0, 0, 0)):
    """Where a camera must stand to see all points beside the panels, and as large as possible.

    points : (n, 3); direction : from the middle of their bounding box to the camera
    fieldOfView : vertical, in degrees; size : width and height of the window; margins : what the
    panels take of it at the left, top, right and bottom
    returns (position (3,), target (3,))
    """
    backward, right, up = view_axes(direction)
    middle = (np.min(points, axis=0) + np.max(points, axis=0)) / 2.0
    arms = points - middle
    # A point at (x, z), z towards the camera, is seen by a camera at (X, Z) while
    # -(Z - z) s ≤ x - X ≤ (Z - z) t, s and t the tangents of the angles to the picture's sides:
    # X + Z t ≥ x + z t, and -X + Z s ≥ -x + z s. The nearest camera has both sides touch.
    depths = arms @ backward
    width, height = size
    left, top, rightMargin, bottom = margins
    perPixel = 2.0 * math.tan(math.radians(fieldOfView) / 2.0) / height
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
    shift = np.zeros(3)
    for axis, s, t, high, low in sides:
        shift += ((high - distance * t) - (low - distance * s)) / 2.0 * axis
    return middle + shift + distance * backward, middle + shift
