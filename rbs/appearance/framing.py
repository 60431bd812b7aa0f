"""Viewpoints that show a scene as large as possible beside the panels. Units: metres, degrees."""

import math

import numpy as np

from rbs.appearance.drawables import SUN, cast_shadows
from RBSFunctions import refresh_vertices

# Direction from the middle of the scene to the camera: slightly from the right and from above.
VIEW_DIRECTION = (0.45, 0.36, 1.0)
# Free margin of a picture, as a fraction of its size.
FRAME_MARGIN = 0.08
# For newly framed stills: the direction, which is lower; the vertical field of view in degrees; the
# additional free margin above and below.
STILL_DIRECTION, STILL_ANGLE, STILL_MARGIN = (0.45, 0.28, 1.0), 30.0, 0.11
# Largest increase of the camera's distance to show shadows, as a fraction of that distance.
SHADOW_ROOM = 0.7
# A body is an outlier if it is this many times farther from the middle than all nearer bodies
# reach. The nearer ones are at least the fraction MAIN_SHARE of all.
FLUNG, MAIN_SHARE = 2.5, 0.8


def frame_still(meshes, size):
    """Returns the camera of a still, `(position (3,), target (3,))`, for the angle STILL_ANGLE.

    The camera is low and sees the bodies and their shadows in the sun, except bodies flung far from
    the others. size : width and height of the picture in pixels
    """
    vertices = refresh_vertices([meshes[body] for body in main_bodies(meshes)])
    width, height = size
    margins = 0, STILL_MARGIN * height, 0, STILL_MARGIN * height
    how = STILL_DIRECTION, STILL_ANGLE, (width, height), margins
    near = np.array(frame_camera(vertices, *how))
    shadows = cast_shadows(vertices, 0.0, -SUN / SUN[1])
    far = np.array(frame_camera(np.concatenate([vertices, shadows]), *how))
    distance, farDistance = (np.linalg.norm(eye - target) for eye, target in (near, far))
    # points seen by two cameras are seen from between them, too; move no farther than needed
    most = min(1.0, SHADOW_ROOM * distance / max(farDistance - distance, 1e-9 * distance))
    for share in most * np.linspace(0.0, 1.0, 9):
        eye, target = near + share * (far - near)
        if are_seen(shadows, eye, target, STILL_ANGLE, width / height):
            break
    return eye, target


def main_bodies(meshes):
    """Returns the indices of the bodies except those flung far from the others."""
    refresh_vertices(meshes)
    middles = np.array([np.mean(mesh.currVertices, axis=0) for mesh in meshes])
    away = np.linalg.norm(middles - np.median(middles, axis=0), axis=1)
    sizes = [np.linalg.norm(np.ptp(mesh.currVertices, axis=0)) for mesh in meshes]
    order = np.argsort(away, kind="stable")
    reach = np.maximum.accumulate((away + sizes)[order])
    isGap = away[order][1:] > FLUNG * reach[:-1]
    isGap[: math.ceil(MAIN_SHARE * len(meshes)) - 1] = False
    return order[: 1 + isGap.argmax()] if isGap.any() else order


def framed_points(meshes, constraints):
    """Returns what a view shows: points (n, 3) of the bodies except outliers, and below them.

    Bodies tied to fixed ones swing, so it also shows their mirror images in the vertical line
    through the middle of the fixed ones.
    """
    vertices = [refresh_vertices([meshes[body] for body in main_bodies(meshes)])]
    tied = [meshes[body] for body in sorted({body for one in constraints for body in one[0:3:2]})]
    fixed, free = ([one for one in tied if one.isFixed == isFixed] for isFixed in (True, False))
    if fixed and free:
        middle = np.mean([mesh.position[0] for mesh in fixed], axis=0)
        vertices.append(middle + (refresh_vertices(free) - middle) * [-1.0, 1.0, -1.0])
    points = np.concatenate(vertices)
    return np.concatenate([points, points * [1.0, 0.0, 1.0]])


def are_seen(points, eye, target, fieldOfView, aspect):
    """Whether a camera sees all points (n, 3), with a small margin around them.

    eye, target : (3,); fieldOfView : vertical, in degrees; aspect : width over height
    """
    backward, right, up = view_axes(eye - target)
    away = points - eye
    half = -math.tan(math.radians(fieldOfView) / 2.0) * (1.0 - FRAME_MARGIN) * (away @ backward)
    return bool((np.abs(away @ up) < half).all() and (np.abs(away @ right) < aspect * half).all())


def view_axes(direction):
    """Unit vectors (3,) of a camera in this direction from its target: backward, right and up."""
    backward = np.asarray(direction, dtype=np.float64)
    backward = backward / np.linalg.norm(backward)
    right = np.cross([0.0, 1.0, 0.0], backward)
    right /= np.linalg.norm(right)
    return backward, right, np.cross(backward, right)


def frame_camera(points, direction, fieldOfView, size, margins=(0, 0, 0, 0)):
    """Returns the nearest camera that sees all points beside the panels: position, target (3,).

    points : (n, 3); direction : from the middle of their bounding box to the camera
    fieldOfView : vertical, in degrees; size : width and height of the window; margins : pixels
        covered by panels at the left, top, right and bottom
    """
    backward, right, up = view_axes(direction)
    middle = (np.min(points, axis=0) + np.max(points, axis=0)) / 2.0
    arms = points - middle
    # A camera at (X, Z), with z towards it, sees a point (x, z) if -(Z - z) s ≤ x - X ≤ (Z - z) t,
    # where s and t are the tangents of the angles to the picture's sides. Hence X + Z t ≥ x + z t
    # and -X + Z s ≥ -x + z s. Both sides touch the points for the nearest camera.
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
