"""The poses of a run, collected step by step: the base of all exporters.

Units: metres, seconds. The y axis points up.
"""

import numpy as np

from Quaternion import QRotate
from rbs.appearance.camera import STILL_ANGLE, VIEW_DIRECTION, frame_camera, main_bodies
from rbs.appearance.colours import REPORT_COLOURINGS, BodyColours
from rbs.appearance.drawables import BOX_CORNERS
from rbs.appearance.shading import split_at_creases
from rbs.recordings.outputs import FileWriter, OutputError
from rbs.recordings.replay import find_report
from rbs.scenes.messages import counted, shown_path
from rbs.scenes.shapes import cylinder

# States from which the camera is framed. More take longer.
FRAMED_STATES = 8
# Width and height of the picture that the camera is framed for.
ASPECT = (16, 9)
# Radius of the rod that shows a constraint, relative to the size of the scene.
ROD_RADIUS = 0.002


class PoseWriter(FileWriter):
    """Collects the states of a run. Subclasses write them to a file at its end, in `write`.

    meshes : list of all n bodies of the run, in the order in which they appear
    """

    label = "export"

    def __init__(self, path, colouring="body"):
        """colouring : a name of COLOURINGS. Raises OutputError if the package is missing."""
        super().__init__(path)
        self._colouring, self.meshes = colouring, []
        self._index = {}  # of each body in `meshes`, by its id
        self._steps, self._times, self._states = [], [], []
        self._links = {}  # ends of constraints, and the states in which they are first and last

    def add(self, simulation):
        """Keeps poses and colours of the bodies, and the constraints; never twice of one step."""
        if self._steps and self._steps[-1] == simulation.stepCount:
            return
        here, meshes = len(self._times), simulation.meshes
        for mesh in meshes:
            if id(mesh) not in self._index:
                self._index[id(mesh)] = len(self.meshes)
                self.meshes.append(mesh)
        index = np.array([self._index[id(mesh)] for mesh in meshes], dtype=np.intp)
        if simulation.settings.enforceConstraints:
            for m1, v1, m2, v2, *_ in simulation.constraints:
                ends = int(index[m1]), int(v1), int(index[m2]), int(v2)
                self._links[ends] = self._links.get(ends, (here,))[0], here
        if self._colouring in REPORT_COLOURINGS:
            find_report(simulation)
        colours = BodyColours(meshes)
        if len(index) < len(self.meshes):  # after a removal, the others keep their colours
            colours.index = index
        state, colours = simulation.state(), colours.of(simulation, self._colouring)
        self._steps.append(simulation.stepCount)
        self._times.append(simulation.time)
        self._states.append((index, state["positions"], state["orientations"], colours))

    def times(self):
        """Returns the times (T,) since the first state, in s, growing in any case."""
        return np.abs(np.diff(self._times, prepend=self._times[0])).cumsum()

    def poses(self):
        """Returns positions (T, n, 3), orientations (T, n, 4), colours (T, n, 3) and span (2, n).

        The span is the first and the last state with each body; before and after, the tables repeat
        its pose there. Successive quaternions have signs that give the shorter rotation. Raises
        OutputError if there never was a body.
        """
        if not self.meshes:
            raise OutputError("there is nothing to export: the run has no bodies")
        count = len(self._times)
        isThere = np.zeros((count, len(self.meshes)), dtype=bool)
        tables = [np.zeros((*isThere.shape, width)) for width in (3, 4, 3)]
        for t, (index, *rows) in enumerate(self._states):
            isThere[t, index] = True
            for table, row in zip(tables, rows, strict=True):
                table[t, index] = row
        span = np.stack([isThere.argmax(axis=0), count - 1 - isThere[::-1].argmax(axis=0)])
        at = np.clip(np.arange(count)[:, None], *span), np.arange(len(self.meshes))
        positions, orientations, colours = (table[at] for table in tables)
        return positions, continuous(orientations), colours, span

    def shapes(self, colours):
        """Returns each shape in each of the colours (n, 3) once, and the number of each body's.

        A shape is (colour, key of the same shape in any colour, *corner_table).
        """
        tables, shapes, numbers = {}, {}, []
        for mesh, colour in zip(self.meshes, colours.tolist(), strict=True):
            key = mesh.origVertices.tobytes(), mesh.faces.tobytes()
            if key not in tables:
                tables[key] = corner_table(mesh)
            shape = shapes.setdefault((key, *colour), (len(shapes), colour, key, *tables[key]))
            numbers.append(shape[0])
        return [shape for _, *shape in shapes.values()], numbers

    def links(self):
        """Returns the lines of constraints: bodies (R, 2), points (R, 2, 3) at rest, span (2, R).

        span : the first and the last state of each
        """
        ends = np.array(list(self._links), dtype=np.intp).reshape(-1, 2, 2)
        points = [[self.meshes[b].origVertices[v] for b, v in pair] for pair in ends.tolist()]
        span = np.array(list(self._links.values()), dtype=np.intp).reshape(-1, 2).T
        return ends[:, :, 0], np.array(points).reshape(-1, 2, 3), span

    def summary(self):
        steps = counted(abs(self._steps[-1] - self._steps[0]), "step")
        return f"{shown_path(self.path)}: {steps}, real time"


def corner_table(mesh):
    """Returns the corners of a body's faces, each once, at rest and in single precision.

    These are points (C, 3) and normals (C, 3), and the indices (F, 3) of each face's corners.
    """
    source, normal, normals, corners, _ = split_at_creases(mesh.origVertices, mesh.faces)
    normals = normals.astype(np.float32)[normal]
    normals[np.linalg.norm(normals, axis=1) < 0.5] = [0.0, 1.0, 0.0]  # of a face without area
    return mesh.origVertices[source].astype(np.float32), normals, corners


def rod(size):
    """Returns vertices and faces of a thin rod along y, from 0 to 1; size : of the scene, in m."""
    mesh = cylinder(ROD_RADIUS * size, 1.0, 1.0, sides=6)
    return mesh.origVertices + np.array([0.0, 0.5, 0.0]), mesh.faces


def continuous(quaternions):
    """Returns quaternions (T, ..., 4), each with the sign that is nearer to the one before it."""
    turns = np.sum(quaternions[1:] * quaternions[:-1], axis=-1, keepdims=True) < 0.0
    signs = np.concatenate([np.ones_like(quaternions[:1, ..., :1]), np.where(turns, -1.0, 1.0)])
    return np.cumprod(signs, axis=0) * quaternions


def placed(positions, orientations, points):
    """Returns points (..., 3) of bodies, given in body axes, in world axes."""
    turns = orientations.reshape(-1, 4), np.broadcast_to(points, positions.shape).reshape(-1, 3)
    return positions + QRotate(*turns).reshape(positions.shape)


def frame_run(meshes, positions, orientations, covered=(0.0, 0.0, 0.0, 0.0)):
    """Returns the `Camera` of a run, and the size of the scene in m.

    The camera has the vertical angle STILL_ANGLE and sees the bodies at all times, except those
    that end far from the others. positions, orientations : (T, n, 3) and (T, n, 4); covered : of
    a picture of the size ASPECT, the pixels at the left, top, right and bottom
    """
    main = main_bodies(meshes)
    states = np.linspace(0, len(positions) - 1, FRAMED_STATES).round().astype(int)[:, None]
    bodies = [meshes[b].origVertices for b in main]
    low, high = (np.array([end(one, axis=0) for one in bodies]) for end in (np.min, np.max))
    corners = np.where(BOX_CORNERS, high[:, None], low[:, None])
    place = np.broadcast_to(positions[states, main, None], (len(states), *corners.shape))
    turn = np.broadcast_to(orientations[states, main, None], (*place.shape[:-1], 4))
    points = placed(place, turn, corners).reshape(-1, 3)
    camera = frame_camera(points, VIEW_DIRECTION, STILL_ANGLE, ASPECT, covered)
    return camera, float(np.linalg.norm(np.ptp(points, axis=0)))
