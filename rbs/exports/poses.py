"""The poses of a run, collected step by step: the base of all exporters.

Units: metres, seconds. The y axis points up.
"""

import numpy as np

from Quaternion import QRotate
from rbs.appearance.drawables import BOX_CORNERS, ConstraintLines
from rbs.appearance.framing import STILL_ANGLE, VIEW_DIRECTION, frame_camera, main_bodies
from rbs.scenes.messages import InputError, shown_path
from rbs.scenes.state import Writer

# States from which the camera is framed. More take longer.
FRAMED_STATES = 8
# Width and height of the picture that the camera is framed for.
ASPECT = (16, 9)


class ExportError(InputError):
    """A file that cannot be exported; one line."""


class PoseWriter(Writer):
    """Collects the states of a run. Subclasses write them to a file at its end, in `save`."""

    def __init__(self, path):
        self.path = path
        self._steps, self._times, self._states = [], [], []
        self._lines = None  # `ConstraintLines`, if the run starts with constraints

    def add(self, simulation):
        """Keeps the poses of the bodies."""
        isFirst, isTied = not self._times, simulation.settings.enforceConstraints
        if isFirst and isTied and simulation.constraints:
            self._lines = ConstraintLines(simulation)
        state = simulation.state()
        self._steps.append(simulation.stepCount)
        self._times.append(simulation.time)
        self._states.append((state["positions"], state["orientations"]))

    @property
    def count(self):
        """Number of states so far."""
        return len(self._times)

    def times(self):
        """Returns the times (T,) since the first state, in s."""
        return np.array(self._times) - self._times[0]

    def poses(self, count):
        """Returns the poses of all bodies and the state in which each appears first.

        count : n, the bodies at the end. Until a body is added, it has its first pose.

        Returns `(positions (T, n, 3), orientations (T, n, 4), first (n,))`. The signs of the
        quaternions are such that they turn the short way from state to state.
        """
        counts = np.array([len(positions) for positions, _ in self._states])
        first = np.searchsorted(counts, np.arange(count), side="right")
        positions, orientations = (
            np.stack([np.resize(state[k], (count, width)) for state in self._states])
            for k, width in ((0, 3), (1, 4))
        )
        for body in np.flatnonzero(first):
            begin = first[body]
            positions[:begin, body] = positions[begin, body]
            orientations[:begin, body] = orientations[begin, body]
        return positions, continuous(orientations), first

    def link_ends(self, meshes):
        """Returns the ends of the constraints' lines: bodies (R, 2), points (R, 2, 3) in body axes.

        meshes : list of Mesh at the end of the run
        """
        if self._lines is None:
            return np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2, 3))
        counts = [len(mesh.origVertices) for mesh in meshes]
        body = np.repeat(np.arange(len(meshes)), counts)[self._lines.ends]
        return body, np.concatenate([mesh.origVertices for mesh in meshes])[self._lines.ends]

    def summary(self, simulation):
        """Returns name and text of its row in the summary of a run."""
        count = self._steps[-1] - self._steps[0]
        return "export", f"{shown_path(self.path)}: {count} steps, real time"


def continuous(quaternions):
    """The same rotations (T, ..., 4), with the sign of each quaternion closest to the last one."""
    turns = np.sum(quaternions[1:] * quaternions[:-1], axis=-1, keepdims=True) < 0.0
    signs = np.concatenate([np.ones_like(quaternions[:1, ..., :1]), np.where(turns, -1.0, 1.0)])
    return np.cumprod(signs, axis=0) * quaternions


def placed(positions, orientations, points):
    """Returns points (..., 3) in body axes at the places of poses (..., 3) and (..., 4)."""
    turns = orientations.reshape(-1, 4), np.broadcast_to(points, positions.shape).reshape(-1, 3)
    return positions + QRotate(*turns).reshape(positions.shape)


def frame_run(meshes, positions, orientations, covered=(0.0, 0.0, 0.0, 0.0)):
    """Returns the camera of a run, `(position (3,), target (3,))`, and the size of the scene in m.

    The camera has the vertical angle STILL_ANGLE and sees the bodies at all times, except those
    that end far from the others. positions, orientations : (T, n, 3) and (T, n, 4); covered : of a
    picture of the size ASPECT, at the left, top, right and bottom
    """
    main = main_bodies(meshes)
    states = np.linspace(0, len(positions) - 1, FRAMED_STATES).round().astype(int)[:, None]
    low, high = (
        np.array([end(meshes[b].origVertices, axis=0) for b in main]) for end in (np.min, np.max)
    )
    corners = np.where(BOX_CORNERS, high[:, None], low[:, None])
    place = np.broadcast_to(positions[states, main, None], (len(states), *corners.shape))
    turn = np.broadcast_to(orientations[states, main, None], (*place.shape[:-1], 4))
    points = placed(place, turn, corners).reshape(-1, 3)
    camera = frame_camera(points, VIEW_DIRECTION, STILL_ANGLE, ASPECT, covered)
    return camera, float(np.linalg.norm(np.ptp(points, axis=0)))
