"""Camera files: viewpoints saved in the window.

Units: metres, degrees.
"""

import json

import numpy as np

from rbs.scenes.files import read_bytes
from rbs.scenes.messages import InputError, one_line

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
        raise CameraError(f"{path}: {one_line(error)}") from None
    except json.JSONDecodeError as error:
        raise CameraError(f"{path}:{error.lineno}: this is not a JSON file: {error.msg}") from None
    except (ValueError, TypeError, LookupError, OverflowError, RecursionError):
        raise CameraError(f"{path}: this is not a Polyscope camera: {CAMERA}") from None
    return {"viewMat": viewMat, "fov": fov}
