"""The camera: where it stands to see a scene, and files that say so.

From the top: reading, applying and writing a camera; the camera of stills. Polyscope is imported
inside the functions that use it.

Units: metres, degrees.
"""

import json
from contextlib import contextmanager

import numpy as np

from rbs.appearance.framing import STILL_ANGLE, frame_still
from rbs.scenes.files import atomic_write, read_bytes
from rbs.scenes.messages import InputError, reason_of

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
    """Points Polyscope's camera at bodies and their shadows, as `frame_still` has it."""
    import polyscope as ps

    eye, target = frame_still(meshes, ps.get_window_size())
    ps.set_vertical_fov_degrees(STILL_ANGLE)
    ps.look_at(eye, target)
