"""The camera: where it stands to see a scene, and files that say so.

From the top: reading, applying and writing a camera; framing a scene. Polyscope is imported inside
the functions that use it.

Units: metres, degrees.
"""

import json
import math

import numpy as np

from rbs.files import atomic_write, read_bytes
from rbs.messages import InputError, reason_of

# From the middle of the scene to the camera: a little from the right, a little from above.
VIEW_DIRECTION = (0.45, 0.36, 1.0)
# The free rim of a picture, as a fraction of its size.
FRAME_MARGIN = 0.08
# The names in a camera file, and how many numbers each has.
CAMERA_WIDTHS = {"position": 3, "target": 3, "fieldOfView": 1}
# Degrees, upwards: beyond, a picture is hardly one any more.
FIELDS_OF_VIEW = (1.0, 150.0)
# The longest file that is looked at, in bytes: a camera takes some 200.
CAMERA_BYTES = 1 << 20
# Metres: as far as Polyscope's single precision still tells what is seen, and more.
FARTHEST_CAMERA = 1e9
# The sine of the least angle between the line of sight and the vertical: of single precision too.
STEEPEST_GAZE = 1e-6


class CameraError(InputError):
    """A camera that cannot be used. Reads "file: cause" in one line."""


def load_camera(path):
    """Reads a camera as `save_camera` writes it.

    returns a dict: position (3,) and target (3,), where the camera is and what it looks at, in
    metres; fieldOfView, upwards, in degrees
    raises CameraError that says in one line what is wrong with the file
    """
    try:
        camera = json.loads(read_bytes(path, CAMERA_BYTES))
    except OSError as error:
        raise CameraError(f"{path}: {reason_of(error)}") from None
    except json.JSONDecodeError as error:
        raise CameraError(f"{path}:{error.lineno}: this is not a JSON file: {error.msg}") from None
    except (ValueError, RecursionError):  # of bytes that are no text, of brackets without end
        raise CameraError(f"{path}: this is not a JSON file") from None
    if not isinstance(camera, dict) or set(camera) != set(CAMERA_WIDTHS):
        raise CameraError(f"{path}: a camera has {', '.join(CAMERA_WIDTHS)} and nothing else")
    values = {}
    for name, width in CAMERA_WIDTHS.items():
        numbers = [camera[name]] if width == 1 else camera[name]
        try:
            if len(numbers) != width or not all(type(x) in (int, float) for x in numbers):
                raise TypeError("text, or lists of lists")
            values[name] = np.array(numbers, dtype=np.float64)
        except (TypeError, OverflowError):
            what = "a number" if width == 1 else f"{width} numbers"
            raise CameraError(f"{path}: {name} must be {what}") from None
        if not np.all(np.isfinite(values[name])):
            raise CameraError(f"{path}: {name} must be finite")
        if np.max(np.abs(values[name])) > FARTHEST_CAMERA:
            raise CameraError(f"{path}: {name} must not exceed {FARTHEST_CAMERA:g}")
    values["fieldOfView"] = float(values["fieldOfView"][0])
    low, high = FIELDS_OF_VIEW
    if not low <= values["fieldOfView"] <= high:
        raise CameraError(f"{path}: fieldOfView must lie between {low:g} and {high:g} degrees")
    gaze = values["target"] - values["position"]
    if np.linalg.norm(gaze[[0, 2]]) <= STEEPEST_GAZE * np.linalg.norm(gaze):
        raise CameraError(f"{path}: the camera must not look straight up or down, or nowhere")
    return values


def apply_camera(camera):
    """Puts Polyscope's camera where `load_camera` says."""
    import polyscope as ps

    ps.set_vertical_fov_degrees(camera["fieldOfView"])
    ps.look_at(camera["position"], camera["target"])


def save_camera(path):
    """Writes Polyscope's camera as JSON, in place of an old file: whole or not at all."""
    import polyscope as ps

    parameters = ps.get_view_camera_parameters()
    position = np.array(parameters.get_position(), dtype=np.float64)
    gaze = np.array(parameters.get_look_dir(), dtype=np.float64)
    distance = np.linalg.norm(np.array(ps.get_view_center()) - position)
    camera = {
        "position": position.tolist(),
        "target": (position + distance * gaze).tolist(),
        "fieldOfView": float(parameters.get_fov_vertical_deg()),
    }
    with atomic_write(path) as partial:
        partial.write_text(json.dumps(camera, indent=2) + "\n", encoding="ascii")


def frame_camera(points, direction, fieldOfView, size, margins=(0, 0, 0, 0)):
    """Where a camera must stand to see all points beside the panels, and as large as possible.

    points : (n, 3); direction : from the middle of their bounding box to the camera
    fieldOfView : vertical, in degrees; size : width and height of the window; margins : what the
    panels take of it at the left, top, right and bottom
    returns (position (3,), target (3,))
    """
    backward = np.asarray(direction, dtype=np.float64)
    backward = backward / np.linalg.norm(backward)
    right = np.cross([0.0, 1.0, 0.0], backward)
    right /= np.linalg.norm(right)
    up = np.cross(backward, right)
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
