"""Where a camera has to stand to see a scene, beside the panels and as large as possible.

Units: metres, degrees.
"""

import math

import numpy as np

from rbs.appearance.drawables import SUN, cast_shadows
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


def frame_still(meshes, size):
    """Where the camera of a still stands: low down, it sees bodies and their shadows in the sun.

    size : width and height of the picture in pixels. Bodies that are flung far from the others do
    not count. Returns (position (3,), target (3,)), for the angle STILL_ANGLE.
    """
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
    width, height = size
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
    return eye, target


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
