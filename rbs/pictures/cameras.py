"""Camera files, and the camera of stills.

Reading order: reading, applying and writing a camera; the camera of stills. Polyscope is imported
inside the functions that use it. Units: metres, degrees.
"""

import json
from contextlib import contextmanager

import numpy as np

from rbs.appearance.framing import STILL_ANGLE, frame_still
from rbs.scenes.files import atomic_write, read_bytes
from rbs.scenes.messages import InputError, reason_of

# Required content of a camera file, for the message.
CAMERA = "it needs viewMat, a rigid motion as 16 numbers, and fov, an angle in degrees"
# Largest entry of a camera matrix, in metres, well beyond what single precision can draw.
FARTHEST_CAMERA = 1e9
# Largest camera file in bytes, well above the size of a valid one.
CAMERA_BYTES = 1 << 20


class CameraError(InputError):
    """A camera that cannot be used. The message is one line, "file: cause"."""


def load_camera(path):
    """Reads and checks a camera written by Polyscope, which would silently ignore a broken one.

    Returns
    -------
    dict : viewMat (4, 4), from the world to the camera; fov, vertical field of view in degrees

    Raises
    ------
    CameraError : the file cannot be read or is not a camera; one line
    """
    try:
        camera = json.loads(read_bytes(path, CAMERA_BYTES))
        viewMat = np.array(camera["viewMat"], dtype=np.float64).reshape(4, 4)
        fov = float(camera["fov"])
        # all of these are false for NaN
        isRigid = np.allclose(viewMat[:3, :3] @ viewMat[:3, :3].T, np.eye(3), atol=1e-3)
        if not (isRigid and np.all(np.abs(viewMat) < FARTHEST_CAMERA) and 0.0 < fov < 180.0):
            raise ValueError("no camera sees a scene from there")
    except OSError as error:
        raise CameraError(f"{path}: {reason_of(error)}") from None
    except json.JSONDecodeError as error:
        raise CameraError(f"{path}:{error.lineno}: this is not a JSON file: {error.msg}") from None
    except (ValueError, TypeError, LookupError, OverflowError, RecursionError):
        raise CameraError(f"{path}: this is not a Polyscope camera: {CAMERA}") from None
    return {"viewMat": viewMat, "fov": fov}


def apply_camera(camera):
    """Applies a camera from `load_camera` to Polyscope, with what it orbits about, if "centre".

    Polyscope's `set_view_from_json` would also change the window's size and the clipping range, and
    not the field of view.
    """
    import polyscope as ps

    ps.set_vertical_fov_degrees(camera["fov"])
    ps.set_camera_view_matrix(camera["viewMat"])
    if "centre" in camera:
        ps.set_view_center_raw(camera["centre"])


def save_camera(path):
    """Writes Polyscope's camera as JSON, replacing an old file atomically."""
    import polyscope as ps

    with atomic_write(path) as partial:
        partial.write_text(ps.get_view_as_json() + "\n", encoding="ascii")


@contextmanager
def kept_camera():
    """Restores Polyscope's camera after the `with` block."""
    camera = present_camera()
    try:
        yield
    finally:
        apply_camera(camera)


def present_camera():
    """Returns Polyscope's camera as from `load_camera`, with "centre", what it orbits about."""
    import polyscope as ps

    angle = ps.get_view_camera_parameters().get_fov_vertical_deg()
    matrix, centre = ps.get_camera_view_matrix(), ps.get_view_center()
    return {"viewMat": matrix, "fov": angle, "centre": centre}


def point_still_camera(meshes):
    """Points Polyscope's camera at bodies and their shadows, see `frame_still`."""
    import polyscope as ps

    eye, target = frame_still(meshes, ps.get_window_size())
    ps.set_vertical_fov_degrees(STILL_ANGLE)
    look(eye, target)


def look(eye, target):
    """Points Polyscope's camera at a target, about which it then orbits."""
    import polyscope as ps

    ps.look_at(eye, target)
    ps.set_view_center_raw(target)  # otherwise the centre stays as far away as before
