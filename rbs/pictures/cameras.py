"""The camera: applying, keeping and writing it. Units: metres, degrees."""

from contextlib import contextmanager

import polyscope as ps

from rbs.scenes.files import atomic_write


def apply_camera(camera):
    """Gives Polyscope a camera from `load_camera`, and the centre of its orbits, if it has one.

    Polyscope's `set_view_from_json` would also change the window's size and the clipping range, and
    not the field of view.
    """
    ps.set_vertical_fov_degrees(camera["fov"])
    ps.set_camera_view_matrix(camera["viewMat"])
    if "centre" in camera:
        ps.set_view_center_raw(camera["centre"])


def save_camera(path):
    """Writes Polyscope's camera as JSON, replacing an old file atomically."""
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
    """Returns Polyscope's camera as from `load_camera`, with "centre", the point that it orbits."""
    angle = ps.get_view_camera_parameters().get_fov_vertical_deg()
    matrix, centre = ps.get_camera_view_matrix(), ps.get_view_center()
    return {"viewMat": matrix, "fov": angle, "centre": centre}


def look(eye, target):
    """Points Polyscope's camera at a target, about which it then orbits."""
    ps.look_at(eye, target)
    ps.set_view_center_raw(target)  # otherwise the centre stays as far away as before
