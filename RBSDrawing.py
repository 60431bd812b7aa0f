"""What is seen: bodies, shadows, constraints, overlays; pictures and videos of them.

Polyscope is imported inside the functions that use it, never with this module, and only after
`find_backend` has found out, in a process of its own, that it can draw here: where a graphics
library is missing, Polyscope may end the whole process instead of raising an error.

All bodies together are one surface, their shadows another one, and their edges one set of lines,
so that the cost of drawing hardly depends on how many bodies there are. What stands for a
simulation here may as well be a replay: anything with its attributes.
"""

import errno
import json
import math
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from Quaternion import QConj, QRotate
from RBSFiles import (
    check_target,
    named_errors,
    one_line,
    put_in_place,
    read_bytes,
    reason_of,
    written_whole,
)
from RBSFunctions import grid_levels

# ---------------------------------------------------------------------------------------------
# What can be drawn with
# ---------------------------------------------------------------------------------------------

WINDOW_BACKEND = "openGL3_glfw"
OFFSCREEN_BACKEND = "openGL3_egl"

# Polyscope links against the first and loads the others when it starts.
DEBIAN_PACKAGES = "libx11-6 libegl1 libgl1 libgl1-mesa-dri"

# Starting takes about a second; a driver that hangs shall not hang this program.
PROBE_SECONDS = 60


@dataclass
class Backend:
    """What `find_backend` found.

    name : Polyscope's name of the backend, None where nothing can be drawn
    reason : why there is no window, or nothing at all; "" where all is well
    remedy : what to do about it
    """

    name: str | None
    reason: str = ""
    remedy: str = ""

    @property
    def opensWindow(self):
        return self.name == WINDOW_BACKEND


def has_display():
    """Whether a window could be opened at all. Off Linux, there always is a display."""
    if not sys.platform.startswith("linux"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def find_backend(window):
    """Finds out how Polyscope can draw here, without importing it into this process.

    window : whether a window is wanted; without one, only pictures are
    returns a Backend
    """
    onLinux = sys.platform.startswith("linux")  # elsewhere, there is no EGL
    windowed = [WINDOW_BACKEND] if has_display() else []
    offscreen = [OFFSCREEN_BACKEND] if onLinux else [WINDOW_BACKEND]
    candidates = windowed + offscreen if window else offscreen + windowed
    reasons = [] if windowed else ["there is no display"]
    for name in dict.fromkeys(candidates):
        failure = _probe(name)
        if failure is None:
            return Backend(name, "; ".join(reasons))
        reasons.append(failure)
    if "No module named" in reasons[-1]:
        return Backend(None, reasons[-1], "Install it: pip install polyscope")
    remedy = "Update the graphics driver"
    if onLinux:
        remedy = f"On Debian or Ubuntu, apt-get install {DEBIAN_PACKAGES} provides OpenGL"
    return Backend(None, "; ".join(reasons), remedy)


def _probe(backendName):
    """Starts Polyscope in another process: None where that works, else what went wrong."""
    program = (
        "import polyscope; polyscope.set_use_prefs_file(False); "  # else it leaves files behind
        f"polyscope.init({backendName!r})"
    )
    try:
        result = subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, timeout=PROBE_SECONDS
        )
    except subprocess.TimeoutExpired:
        return f"{backendName} did not start within {PROBE_SECONDS} s"
    if result.returncode == 0:
        return None
    lines = (result.stdout + result.stderr).splitlines()
    for mark in ("ImportError: ", "ModuleNotFoundError: ", "emitted error: ", "[ERROR] "):
        for line in lines:
            if mark in line:
                return line.split(mark, 1)[1].split(". ")[0].rstrip(".")
    return f"{backendName} ended with code {result.returncode}"


def start_polyscope(backend, size=None):
    """Starts Polyscope with this backend and the options that no scene changes.

    size : (width, height) of the picture or window in pixels, or None for the usual one
    """
    import polyscope as ps

    ps.set_verbosity(0)
    ps.set_program_name("Rigid bodies")
    ps.set_use_prefs_file(False)
    ps.set_window_size(*(size or PICTURE_SIZE))
    ps.init(backend.name)
    ps.set_automatically_compute_scene_extents(False)
    ps.set_up_dir("y_up")
    ps.set_ground_plane_mode("none")  # `SceneView` has its own, which is drawn three times faster
    ps.set_background_color(BACKGROUND)
    # A window is redrawn all the time; of a picture, smooth edges are worth four times the work.
    ps.set_SSAA_factor(1 if backend.opensWindow else 2)


# ---------------------------------------------------------------------------------------------
# The look
# ---------------------------------------------------------------------------------------------

PICTURE_SIZE = (1280, 720)

BACKGROUND = (0.62, 0.70, 0.80)
# What Polyscope's tone mapping, which leaves flat surfaces alone, makes of it.
SEEN_BACKGROUND = (0.839, 0.886, 0.945)
FIXED_COLOUR = (0.72, 0.72, 0.72)
PICKED_COLOUR = (0.90, 0.10, 0.55)
# Of a body that touches no other free one, where bodies are coloured by what they touch.
LONE_COLOUR = (0.93, 0.93, 0.90)
SHADOW_COLOUR = (0.30, 0.31, 0.33)
CREASE_COLOUR = (0.10, 0.12, 0.15)

# The colour map viridis at equal steps: its lightness falls evenly, also for the colour-blind.
# From light to heavy, and without the map's darkest tenth, on which no edge would show.
VIRIDIS = np.array([
    [253, 231, 37], [181, 222, 43], [110, 206, 88], [53, 183, 121], [31, 158, 137],
    [38, 130, 142], [49, 104, 142], [62, 73, 137], [72, 40, 120],
]) / 255.0  # fmt: skip

# Colours that the colour-blind tell apart (Okabe and Ito), and lighter ones of the same kind.
PALETTE = np.array([
    [230, 159, 0], [86, 180, 233], [0, 158, 115], [240, 228, 66], [0, 114, 178],
    [213, 94, 0], [204, 121, 167], [148, 203, 236], [126, 196, 160], [194, 106, 119],
]) / 255.0  # fmt: skip

# The two greys of the ground's squares, and how many squares it has along each side. They fade
# into the background from the first to the second distance, relative to the scene's size.
GROUND_COLOURS = ((0.56, 0.57, 0.58), (0.61, 0.62, 0.63))
GROUND_SQUARES = 48
GROUND_FADES = (0.7, 1.9)

# m/s, of the darkest bodies where they are coloured by speed: a fall from 46 m.
TOP_SPEED = 30.0

# Faces that meet at a smaller angle, in radians, pass for one round surface: a cylinder of 20 sides
# or more, or a finely divided ellipsoid.
CREASE_ANGLE = math.radians(30.0)
# Half the width of the lines that edges are drawn as, relative to the scene's size.
CREASE_RADIUS = 6e-4
# Each line costs about 0.02 ms a frame where no graphics card helps. In a scene with more of them,
# bodies are so small in the picture that lines would only darken it.
MOST_CREASES = 4000

# Half the width of the lines that constraints are drawn as, relative to the scene's size.
TIE_RADIUS = 1.2e-3
# Constraints from slack over taut to too long or too short: light blue, yellow, vermilion, which
# the colour-blind tell apart too (Okabe and Ito's palette).
TIE_COLOURS = np.array([[86, 180, 233], [240, 228, 66], [213, 94, 0]]) / 255.0
# A bound that is exceeded by this fraction of itself gets the last of these colours in full.
FULL_EXCESS = 0.05
# Overlays.
NORMAL_COLOUR = (0.0, 0.25, 0.55)
IMPULSE_COLOUR = (0.90, 0.62, 0.0)
FRICTION_COLOUR = (0.84, 0.15, 0.16)
VELOCITY_COLOUR = (0.0, 0.45, 0.30)
BOX_COLOUR = (0.20, 0.20, 0.25)
TRAIL_COLOUR = (0.35, 0.10, 0.45)
# The longest impulse on screen, and every contact's normal, relative to the scene's size.
LONGEST_IMPULSE = 0.1
NORMAL_LENGTH = 0.05
# A velocity is drawn as the way that it leads in this time, in seconds.
VELOCITY_SECONDS = 0.5
ARROW_RADIUS = 3e-3
POINT_RADIUS = 4e-3
LINE_RADIUS = 8e-4
# Pictures back that a trail goes, and the most bodies that have one: every second body has where
# there are up to twice as many, and so on.
TRAIL_LENGTH = 40
MOST_TRAILS = 30
# A trail goes on over as many steps between two pictures; more is a jump to another time.
LONGEST_TRAIL_STEP = 60
# The most boxes, and cells, that are drawn, for the time that their lines take.
MOST_BOXES = 200

# From the middle of the scene to the camera: a little from the right, a little from above.
VIEW_DIRECTION = (0.45, 0.36, 1.0)
# The free rim of a picture, as a fraction of its size.
FRAME_MARGIN = 0.08
# How far over the ground the shadows lie, relative to the scene's size: the least that keeps the
# two from flickering through each other in a 24-bit depth buffer.
SHADOW_HEIGHT = 1e-3


def viridis(place):
    """RGB (3,) of the colour map: place 0 is its light end, 1 its dark one."""
    steps = np.arange(len(VIRIDIS))
    return np.array([np.interp(place * steps[-1], steps, channel) for channel in VIRIDIS.T])


def colour_of_density(density, lightest, heaviest):
    """RGB (3,) of a body: viridis over the logarithm of the density, from lightest to heaviest.

    Where all bodies are equally dense, the middle of the map.
    """
    if heaviest > lightest:
        return viridis(math.log(density / lightest) / math.log(heaviest / lightest))
    return viridis(0.5)


def colours_by_density(simulation):
    """RGB of every body, (n, 3), by its density among the free bodies."""
    meshes = simulation.meshes
    densities = sorted({mesh.density for mesh in meshes if not mesh.isFixed})
    if not densities:
        return np.tile(FIXED_COLOUR, (len(meshes), 1))
    colours = {d: colour_of_density(d, densities[0], densities[-1]) for d in densities}
    return np.array([colours.get(mesh.density, FIXED_COLOUR) for mesh in meshes])


def colours_by_body(simulation):
    """RGB of every body, (n, 3): the palette over and over."""
    return PALETTE[np.arange(len(simulation.meshes)) % len(PALETTE)]


def colours_by_speed(simulation):
    """RGB of every body, (n, 3): viridis from rest, light, to TOP_SPEED and above, dark."""
    velocities = np.concatenate([mesh.linVelocity for mesh in simulation.meshes])
    place = np.clip(np.linalg.norm(velocities, axis=1) / TOP_SPEED, 0.0, 1.0)
    steps = np.linspace(0.0, 1.0, len(VIRIDIS))
    return np.stack([np.interp(place, steps, channel) for channel in VIRIDIS.T], axis=1)


def contact_islands(simulation):
    """For every body the lowest index among those that it is connected with by contacts.

    Fixed bodies and the ground connect nothing. returns (n,) int, -1 for a body that touches no
    other free one, and where no step has been made
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(simulation.meshes)
    free = np.array([not mesh.isFixed for mesh in simulation.meshes] + [False])  # last: the ground
    report = simulation.report
    pairs = [(c.body1, c.body2) for c in report.contacts] if report is not None else []
    pairs = np.array(pairs, dtype=np.intp).reshape(-1, 2)
    first, second = pairs[free[pairs].all(axis=1)].T
    links = coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    labels = connected_components(links, directed=False)[1]
    lowest = np.unique(labels, return_index=True)[1]
    touched = np.isin(np.arange(count), np.concatenate([first, second]))
    return np.where(touched, lowest[labels], -1)


def colours_by_island(simulation):
    """RGB of every body, (n, 3): one colour for all that hang together by contacts."""
    islands = contact_islands(simulation)
    return np.where(islands[:, None] < 0, LONE_COLOUR, PALETTE[islands % len(PALETTE)])


COLOURINGS = {
    "density": colours_by_density,
    "body": colours_by_body,
    "speed": colours_by_speed,
    "contact island": colours_by_island,
}


def body_colours(simulation, colouring="density"):
    """RGB of every body, (n, 3): grey if fixed, else by a name of COLOURINGS."""
    isFixed = np.array([[mesh.isFixed] for mesh in simulation.meshes])
    return np.where(isFixed, FIXED_COLOUR, COLOURINGS[colouring](simulation))


def flatten_meshes(meshes):
    """All bodies as the one surface that a viewer draws fastest.

    meshes : list of Mesh
    returns (vertices (ΣV, 3), where the bodies are now; faces (ΣF, 3), counted through all bodies;
    bodyOfFace (ΣF,), the index in `meshes` of the body that each face belongs to). A value per
    body becomes a value per face by indexing: densities[bodyOfFace].
    """
    vertices = [np.reshape(mesh.currVertices, (-1, 3)) for mesh in meshes]
    faces = [np.reshape(mesh.faces, (-1, 3)).astype(np.int64) for mesh in meshes]
    firstVertex = np.cumsum([0] + [len(v) for v in vertices])
    bodyOfFace = np.repeat(np.arange(len(meshes)), [len(f) for f in faces])
    return (
        np.concatenate([np.empty((0, 3)), *vertices]),
        np.concatenate([np.empty((0, 3), np.int64), *faces]) + firstVertex[bodyOfFace, None],
        bodyOfFace,
    )


def find_creases(vertices, faces):
    """The edges that a body shows: where two faces meet at more than CREASE_ANGLE.

    So a box shows twelve edges and no diagonals, and an ellipsoid none.

    vertices (V, 3); faces (F, 3) of closed surfaces
    returns (E, 2) vertex indices
    """
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1), np.finfo(float).tiny)[:, None]
    # Half-edge 3 f + k runs along face f from its corner k to the next one; its twin runs back.
    tails, heads = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    faceOf = np.repeat(np.arange(len(faces)), 3)
    order = np.argsort(tails * len(vertices) + heads)
    twinPlaces = np.argsort(heads * len(vertices) + tails)
    neighbour = np.empty(len(tails), dtype=np.int64)
    neighbour[twinPlaces] = faceOf[order]
    cosines = np.sum(normals[faceOf] * normals[neighbour], axis=1)
    isCrease = (tails < heads) & (cosines < math.cos(CREASE_ANGLE))
    return np.column_stack([tails[isCrease], heads[isCrease]])


def frame_camera(points, direction, fieldOfView, aspect):
    """Where a camera must stand to see all points, and as large as possible.

    points : (n, 3); direction : from the middle of their bounding box to the camera
    fieldOfView : vertical, in degrees; aspect : width over height of the picture
    returns (position (3,), target (3,))
    """
    backward = np.asarray(direction, dtype=np.float64)
    backward = backward / np.linalg.norm(backward)
    right = np.cross([0.0, 1.0, 0.0], backward)
    right /= np.linalg.norm(right)
    up = np.cross(backward, right)
    middle = (np.min(points, axis=0) + np.max(points, axis=0)) / 2.0
    arms = points - middle
    # A point at (x, y) beside the line of sight, z towards the camera, is seen from the distance D
    # while |x| ≤ (D - z) tan(horizontal half angle), and |y| likewise.
    vertical = math.tan(math.radians(fieldOfView) / 2.0) * (1.0 - FRAME_MARGIN)
    sideways, upwards = np.abs(arms @ right) / (vertical * aspect), np.abs(arms @ up) / vertical
    distance = np.max(np.maximum(sideways, upwards) + arms @ backward)
    return middle + distance * backward, middle


def ground_squares(size, middle):
    """The ground as a chequered square under `middle` (3,), for a scene of `size` metres.

    returns (vertices (V, 3), faces (F, 4), colours (F, 3), side of a square in metres: 1, 2 or 5
    times a power of ten)
    """
    least = 2.0 * GROUND_FADES[1] * size / GROUND_SQUARES
    power = 10.0 ** math.floor(math.log10(least))
    side = next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= least)
    ticks = side * (np.arange(GROUND_SQUARES + 1) - GROUND_SQUARES // 2)
    # Whole pairs of squares: the colours of the ground do not depend on the scene's place.
    shiftX, _, shiftZ = 2.0 * side * np.round(np.asarray(middle) / (2.0 * side))
    z, x = np.meshgrid(ticks + shiftZ, ticks + shiftX, indexing="ij")
    vertices = np.stack([x, np.zeros_like(x), z], axis=-1).reshape(-1, 3)
    index = np.arange(len(vertices)).reshape(len(ticks), -1)
    corners = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.stack(corners, axis=-1).reshape(-1, 4)
    rows, columns = np.divmod(np.arange(len(faces)), GROUND_SQUARES)
    colours = np.array(GROUND_COLOURS)[(rows + columns) % 2]
    arms = (vertices[faces].mean(axis=1) - middle)[:, [0, 2]]
    distance = np.linalg.norm(arms, axis=1) / size
    fading = np.interp(distance, GROUND_FADES, (0.0, 1.0))[:, None]
    return vertices, faces, (1.0 - fading) * colours + fading * SEEN_BACKGROUND, side


# The corners of a box, as 0 for its low and 1 for its high end along x, y, z, and its edges.
BOX_CORNERS = np.array([[k >> 2 & 1, k >> 1 & 1, k & 1] for k in range(8)])
BOX_EDGES = np.array([
    (a, b) for a in range(8) for b in range(a) if np.sum(BOX_CORNERS[a] != BOX_CORNERS[b]) == 1
])  # fmt: skip


def box_lines(low, high):
    """The edges of boxes as lines: low, high (n, 3); returns nodes (8 n, 3), edges (12 n, 2)."""
    corners = np.where(BOX_CORNERS, high[:, None], low[:, None])
    edges = BOX_EDGES + 8 * np.arange(len(low))[:, None, None]
    return corners.reshape(-1, 3), edges.reshape(-1, 2)


def grid_cells(low, high):
    """The cells of the uniform-grid broad phase that hold a body, from its first to its last one.

    A cell is a column along x. low, high : (n, 3), the boxes of the bodies
    returns (low, high), both (m, 3)
    """
    cells = {}
    for level, _, width in grid_levels(np.concatenate([low, -high], axis=1).T):
        for b in level.tolist():
            place = (width, math.floor(low[b, 1] / width), math.floor(low[b, 2] / width))
            begin, end = cells.get(place, (math.inf, -math.inf))
            cells[place] = min(begin, low[b, 0]), max(end, high[b, 0])
    rows = [
        ((begin, y * width, z * width), (end, (y + 1) * width, (z + 1) * width))
        for (width, y, z), (begin, end) in cells.items()
    ]
    cellLow, cellHigh = np.array(rows, dtype=np.float64).reshape(-1, 2, 3).transpose(1, 0, 2)
    return cellLow, cellHigh


class Ties:
    """The constraints of a simulation as lines between the vertices that they tie.

    Two bounds on the distance of the same two vertices are one line. Vertices are counted through
    all bodies, as `flatten_meshes` counts them.
    """

    def __init__(self, simulation):
        firstVertex = np.cumsum([0] + [len(mesh.currVertices) for mesh in simulation.meshes])
        bounds = {}
        for m1, v1, m2, v2, refValue, upper in simulation.constraints:
            ends = (firstVertex[m1] + v1, firstVertex[m2] + v2)
            least, most = bounds.get(ends, (0.0, math.inf))
            bounds[ends] = (least, min(most, refValue)) if upper else (max(least, refValue), most)
        self.ends = np.array(list(bounds), dtype=np.int64).reshape(-1, 2)
        self.least, self.most = np.array(list(bounds.values())).reshape(-1, 2).T

    def nodes(self, vertices):
        """The lines' ends (2 T, 3), each line's two after each other; vertices (ΣV, 3)."""
        return vertices[self.ends].reshape(-1, 3)

    def colours(self, vertices):
        """RGB (T, 3): how much of the allowed band is used, or by how much it is exceeded."""
        tails, heads = vertices[self.ends[:, 0]], vertices[self.ends[:, 1]]
        distance = np.linalg.norm(tails - heads, axis=1)
        middle, half = (self.least + self.most) / 2.0, (self.most - self.least) / 2.0
        # A rope, which has no lower bound, is used by as much as it is pulled out.
        isRope = self.least == 0.0
        middle, half = np.where(isRope, 0.0, middle), np.where(isRope, self.most, half)
        off = np.abs(distance - middle)
        used = np.clip(off / np.where(half > 0.0, half, 1.0), 0.0, 1.0)
        used = np.where(half > 0.0, used, 1.0)  # a rod has no slack
        excess = (off - half) / np.where(self.most > 0.0, FULL_EXCESS * self.most, 1.0)
        place = used + np.clip(excess, 0.0, 1.0)
        return np.stack([np.interp(place, (0, 1, 2), c) for c in TIE_COLOURS.T], axis=1)


class SceneView:
    """A simulation's bodies, shadows and constraints in Polyscope, which must have been started.

    Attributes: simulation; colouring, a name of COLOURINGS; shown, a set of names of LAYERS;
    picked, the index of the body that is marked, or None, and pickedPoint, a point (3,) of it at
    rest; squareSide, of the ground's squares in metres.
    """

    def __init__(self, simulation, sideWidth=0):
        """sideWidth : pixels on either side of the picture in which nothing shall be seen"""
        self._sideWidth = sideWidth
        self.colouring = "density"
        self.shown = {"ground", "shadows"}
        self.rebuild(simulation)

    def rebuild(self, simulation):
        """Registers the bodies of a new scene and points the camera at them."""
        import polyscope as ps

        self.simulation = simulation
        self.pick(None)
        vertices, faces, self.bodyOfFace = flatten_meshes(simulation.meshes)
        ground = vertices * [1.0, 0.0, 1.0]
        points = np.concatenate([vertices, ground])
        low, high = np.min(points, axis=0), np.max(points, axis=0)
        self._size = float(np.linalg.norm(high - low))
        ps.set_length_scale(self._size)
        ps.set_bounding_box(low, high)
        self._firstVertex = np.cumsum([0] + [len(m.currVertices) for m in simulation.meshes[:-1]])
        self._trail = []
        self._trailStep = None

        # What lies behind is not drawn: bodies are closed, and it would cost half as much again.
        self._bodies = ps.register_surface_mesh(
            "bodies", vertices, faces, material="clay", back_face_policy="cull"
        )
        self._bodies.set_selection_mode("faces_only")
        self._shadows = ps.register_surface_mesh(
            "shadows", self._shadow_of(vertices), faces,
            material="flat", back_face_policy="cull", color=SHADOW_COLOUR,
        )  # fmt: skip
        self._register_ground((low + high) / 2.0)
        self._register_creases(vertices, faces)
        self._register_ties(vertices)
        for name in LAYERS:
            self._show_layer(name)
        self._colours = None
        self.refresh()
        self._point_camera(points)

    def _register_ground(self, middle):
        import polyscope as ps

        vertices, faces, colours, self.squareSide = ground_squares(self._size, middle)
        self._ground = ps.register_surface_mesh(
            "ground", vertices, faces, material="flat", back_face_policy="cull"
        )
        self._ground.add_color_quantity("squares", colours, defined_on="faces", enabled=True)

    def _register_creases(self, vertices, faces):
        import polyscope as ps

        ps.remove_curve_network("creases", error_if_absent=False)
        creases = find_creases(vertices, faces)
        self._creases = None
        if 0 < len(creases) <= MOST_CREASES:
            # A curve network draws a dot at each of its nodes: it gets only those in use.
            self._creaseNodes, ends = np.unique(creases, return_inverse=True)
            self._creaseEnds = creases
            self._creases = ps.register_curve_network(
                "creases", vertices[self._creaseNodes], ends.reshape(-1, 2),
                radius=CREASE_RADIUS, color=CREASE_COLOUR, material="flat",
            )  # fmt: skip

    def _register_ties(self, vertices):
        import polyscope as ps

        ps.remove_curve_network("constraints", error_if_absent=False)
        self._ties = Ties(self.simulation)
        if len(self._ties.ends):
            nodes = self._ties.nodes(vertices)
            self._lines = ps.register_curve_network(
                "constraints", nodes, np.arange(len(nodes)).reshape(-1, 2),
                radius=TIE_RADIUS, material="flat",
            )  # fmt: skip

    def _refresh_ties(self, vertices):
        self._lines.update_node_positions(self._ties.nodes(vertices))
        self._lines.add_color_quantity(
            "use", self._ties.colours(vertices), defined_on="edges", enabled=True
        )
        self._lines.set_enabled(self.simulation.settings.enforceConstraints)

    def _point_camera(self, points):
        import polyscope as ps

        width, height = ps.get_window_size()
        fieldOfView = ps.get_view_camera_parameters().get_fov_vertical_deg()
        aspect = max(width - 2 * self._sideWidth, width / 3) / height
        ps.look_at(*frame_camera(points, VIEW_DIRECTION, fieldOfView, aspect))

    def _shadow_of(self, vertices):
        """The bodies pressed onto the ground: straight below them, where they are going to fall."""
        return vertices * [1.0, 0.0, 1.0] + [0.0, SHADOW_HEIGHT * self._size, 0.0]

    def refresh(self):
        """Draws everything as it is now, all from one instant, from the next frame on."""
        vertices = np.concatenate([mesh.currVertices for mesh in self.simulation.meshes])
        self._bodies.update_vertex_positions(vertices)
        if "shadows" in self.shown:
            self._shadows.update_vertex_positions(self._shadow_of(vertices))
        if self._creases is not None:
            self._creases.update_node_positions(vertices[self._creaseNodes])
        if len(self._ties.ends):
            self._refresh_ties(vertices)
        self._refresh_colours()
        if "trails" in self.shown:
            self._extend_trails()
        for name, draw in OVERLAYS.items():
            if name in self.shown:
                draw(self, name, vertices)
        self._refresh_mark()

    def _refresh_colours(self):
        colours = body_colours(self.simulation, self.colouring)
        if self.picked is not None:
            colours[self.picked] = PICKED_COLOUR
        if self._colours is None or not np.array_equal(colours, self._colours):
            self._bodies.add_color_quantity(
                "colour", colours[self.bodyOfFace], defined_on="faces", enabled=True
            )
        self._colours = colours

    def show(self, name, isShown):
        """Switches one of LAYERS on or off."""
        if isShown:
            self.shown.add(name)
        else:
            self.shown.discard(name)
        self._show_layer(name)
        self.refresh()

    def _show_layer(self, name):
        if name == "ground":
            self._ground.set_enabled(name in self.shown)
        elif name == "shadows":
            self._shadows.set_enabled(name in self.shown)
        else:
            remove_overlay(name)
            self._trail = []

    def set_resizable(self, isResizable):
        """Lets the window be resized, or not."""
        import polyscope as ps

        ps.set_window_resizable(isResizable)

    def pick(self, body, point=None):
        """Marks a body (its index) and a point (3,) of the world on it; None marks none."""
        self.picked, self.pickedPoint = body, None
        if body is not None:
            mesh = self.simulation.meshes[body]
            self.pickedPoint = QRotate(QConj(mesh.orientation), point - mesh.position)[0]

    def picked_point(self):
        """Where the marked point is now, (3,) in the world."""
        mesh = self.simulation.meshes[self.picked]
        return (QRotate(mesh.orientation, self.pickedPoint[None]) + mesh.position)[0]

    def body_at(self, pixel):
        """The body that is seen at a pixel (x, y) from the top left corner of the window.

        returns (index, point (3,) on its surface), or (None, None)
        """
        import polyscope as ps

        hit = ps.pick(screen_coords=pixel)
        if not hit.is_hit or hit.structure_name not in ("bodies", "creases"):
            return None, None
        if hit.structure_name == "bodies":
            return int(self.bodyOfFace[hit.structure_data["index"]]), hit.position
        vertices = self._creaseNodes
        if hit.structure_data["element_type"] == "edge":
            vertices = self._creaseEnds[:, 0]
        vertex = vertices[hit.structure_data["index"]]
        return int(np.searchsorted(self._firstVertex, vertex, side="right")) - 1, hit.position

    def _refresh_mark(self):
        import polyscope as ps

        ps.remove_point_cloud("picked point", error_if_absent=False)
        if self.picked is not None:
            ps.register_point_cloud(
                "picked point", self.picked_point()[None], color=CREASE_COLOUR,
                radius=2.0 * POINT_RADIUS,
            )  # fmt: skip

    # What the overlays consist of.

    def _contacts(self):
        """The last step's contacts, and where they are now (m, 3): they go along with body 1."""
        report = self.simulation.report
        contacts = [] if report is None else report.contacts
        positions = [self.simulation.meshes[c.body1].position[0] for c in contacts]
        arms = [contact.arm for contact in contacts]
        return contacts, np.array(positions).reshape(-1, 3) + np.array(arms).reshape(-1, 3)

    def _draw_contacts(self, name, vertices):
        contacts, points = self._contacts()
        normals = -NORMAL_LENGTH * self._size * np.array([c.normal for c in contacts])
        draw_arrows(name, points, normals, NORMAL_COLOUR)

    def _draw_impulses(self, name, vertices):
        contacts, points = self._contacts()
        normals = np.array([c.normal for c in contacts]).reshape(-1, 3)
        # Body 1 receives the opposite of what the contact gives to body 2.
        arrows = -normals * np.array([c.impulse for c in contacts]).reshape(-1, 1)
        draw_arrows(name, points, self._scaled(arrows), IMPULSE_COLOUR)

    def _draw_friction(self, name, vertices):
        contacts, points = self._contacts()
        arrows = -np.array([c.friction for c in contacts]).reshape(-1, 3)
        some = arrows.any(axis=1)
        draw_arrows(name, points[some], self._scaled(arrows[some]), FRICTION_COLOUR)

    def _scaled(self, arrows):
        longest = np.linalg.norm(arrows, axis=1).max(initial=0.0)
        return arrows * (LONGEST_IMPULSE * self._size / longest if longest > 0.0 else 0.0)

    def _draw_velocities(self, name, vertices):
        moving = [mesh for mesh in self.simulation.meshes if not mesh.isFixed]
        points = np.array([mesh.position[0] for mesh in moving])
        arrows = VELOCITY_SECONDS * np.array([mesh.linVelocity[0] for mesh in moving])
        draw_arrows(name, points, arrows, VELOCITY_COLOUR)

    def _boxes(self, vertices):
        """Bounding boxes of the bodies, low and high (n, 3)."""
        return (
            np.minimum.reduceat(vertices, self._firstVertex),
            np.maximum.reduceat(vertices, self._firstVertex),
        )

    def _draw_boxes(self, name, vertices):
        low, high = (side[:MOST_BOXES] for side in self._boxes(vertices))
        draw_lines(name, *box_lines(low, high), BOX_COLOUR)

    def _draw_cells(self, name, vertices):
        low, high = (side[:MOST_BOXES] for side in grid_cells(*self._boxes(vertices)))
        draw_lines(name, *box_lines(low, high), TIE_COLOURS[2])

    def _extend_trails(self):
        """Adds the present positions to the trails; after a jump in time, they begin anew."""
        step = self.simulation.stepCount
        if self._trail and step == self._trailStep:
            return
        if self._trail and not 0 < step - self._trailStep <= LONGEST_TRAIL_STEP:
            self._trail = []
        moving = [mesh for mesh in self.simulation.meshes if not mesh.isFixed]
        moving = moving[:: math.ceil(len(moving) / MOST_TRAILS) or 1]
        self._trail.append(np.array([mesh.position[0] for mesh in moving]).reshape(-1, 3))
        self._trail = self._trail[-TRAIL_LENGTH:]
        self._trailStep = step

    def _draw_trails(self, name, vertices):
        if len({len(row) for row in self._trail}) > 1:  # a body was fixed or freed
            self._trail = self._trail[-1:]
        nodes = np.array(self._trail)  # (times, bodies, 3)
        index = np.arange(nodes[..., 0].size).reshape(nodes.shape[:2])
        edges = np.stack([index[:-1], index[1:]], axis=-1).reshape(-1, 2)
        draw_lines(name, nodes.reshape(-1, 3), edges, TRAIL_COLOUR)


# What can be drawn over the bodies.
OVERLAYS = {
    "contacts": SceneView._draw_contacts,
    "impulses": SceneView._draw_impulses,
    "friction impulses": SceneView._draw_friction,
    "velocities": SceneView._draw_velocities,
    "bounding boxes": SceneView._draw_boxes,
    "grid cells": SceneView._draw_cells,
    "trails": SceneView._draw_trails,
}
# All that can be switched on and off.
LAYERS = ["ground", "shadows", *OVERLAYS]


def remove_overlay(name):
    """Removes what `draw_arrows` or `draw_lines` has drawn under this name, if anything."""
    import polyscope as ps

    ps.remove_point_cloud(name, error_if_absent=False)
    ps.remove_curve_network(name, error_if_absent=False)


def draw_arrows(name, points, arrows, colour):
    """Points (m, 3) with arrows (m, 3) in metres, in place of the last ones of this name."""
    import polyscope as ps

    remove_overlay(name)
    if len(points):
        cloud = ps.register_point_cloud(
            name, points, color=colour, radius=POINT_RADIUS, material="flat"
        )
        cloud.add_vector_quantity(
            "arrows", arrows, vectortype="ambient", radius=ARROW_RADIUS, color=colour,
            material="flat", enabled=True,
        )  # fmt: skip


def draw_lines(name, nodes, edges, colour):
    """Lines between nodes (n, 3), edges (m, 2), in place of the last ones of this name."""
    import polyscope as ps

    remove_overlay(name)
    if len(edges):
        ps.register_curve_network(
            name, nodes, edges, radius=LINE_RADIUS, color=colour, material="flat"
        )


# ---------------------------------------------------------------------------------------------
# Camera
# ---------------------------------------------------------------------------------------------


class DrawingError(ValueError):
    """A camera that cannot be used, or a video that cannot be made; one line."""

    def __init__(self, message):
        super().__init__(one_line(message))


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


def load_camera(path):
    """Reads a camera as `save_camera` writes it.

    returns a dict: position (3,) and target (3,), where the camera is and what it looks at, in
    metres; fieldOfView, upwards, in degrees
    raises DrawingError that says in one line what is wrong with the file
    """
    try:
        camera = json.loads(read_bytes(path, CAMERA_BYTES))
    except OSError as error:
        raise DrawingError(f"{path}: {reason_of(error)}") from None
    except json.JSONDecodeError as error:
        raise DrawingError(f"{path}:{error.lineno}: this is not a JSON file: {error.msg}") from None
    except (ValueError, RecursionError):  # of bytes that are no text, of brackets without end
        raise DrawingError(f"{path}: this is not a JSON file") from None
    if not isinstance(camera, dict) or set(camera) != set(CAMERA_WIDTHS):
        raise DrawingError(f"{path}: a camera has {', '.join(CAMERA_WIDTHS)} and nothing else")
    values = {}
    for name, width in CAMERA_WIDTHS.items():
        numbers = [camera[name]] if width == 1 else camera[name]
        try:
            if len(numbers) != width or not all(type(x) in (int, float) for x in numbers):
                raise TypeError("text, or lists of lists")
            values[name] = np.array(numbers, dtype=np.float64)
        except (TypeError, OverflowError):
            what = "a number" if width == 1 else f"{width} numbers"
            raise DrawingError(f"{path}: {name} must be {what}") from None
        if not np.all(np.isfinite(values[name])):
            raise DrawingError(f"{path}: {name} must be finite")
        if np.max(np.abs(values[name])) > FARTHEST_CAMERA:
            raise DrawingError(f"{path}: {name} must not exceed {FARTHEST_CAMERA:g}")
    values["fieldOfView"] = float(values["fieldOfView"][0])
    low, high = FIELDS_OF_VIEW
    if not low <= values["fieldOfView"] <= high:
        raise DrawingError(f"{path}: fieldOfView must lie between {low:g} and {high:g} degrees")
    gaze = values["target"] - values["position"]
    if np.linalg.norm(gaze[[0, 2]]) <= STEEPEST_GAZE * np.linalg.norm(gaze):
        raise DrawingError(f"{path}: the camera must not look straight up or down, or nowhere")
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
    with written_whole(path, "w", encoding="ascii") as file:
        file.write(json.dumps(camera, indent=2) + "\n")


# ---------------------------------------------------------------------------------------------
# Pictures and videos
# ---------------------------------------------------------------------------------------------


@dataclass
class Look:
    """What pictures and videos look like, apart from the scene.

    size : (width, height) in pixels; camera : as `load_camera` gives it, or None to see all of the
    scene; isTransparent : whether the background, and the ground, are left out; colouring : a name
    of COLOURINGS; overlays : names of OVERLAYS
    """

    size: tuple = PICTURE_SIZE
    camera: dict | None = None
    isTransparent: bool = False
    colouring: str = "density"
    overlays: tuple = ()


def start_look(simulation, backend, look, sideWidth=0):
    """Starts Polyscope for pictures of this look; returns a SceneView."""
    start_polyscope(backend, look.size)
    view = SceneView(simulation, sideWidth)
    if look.camera is not None:
        apply_camera(look.camera)
    view.colouring = look.colouring
    view.shown.update(look.overlays)
    view.show("ground", not look.isTransparent)
    return view


class PictureSeries:
    """Pictures of chosen steps, DIR/frame_<step, six digits>.png.

    Attributes: folder; count, the pictures so far; path, the last one.
    """

    def __init__(self, folder, steps, view, isTransparent=False):
        """Makes the folder; raises OSError when that cannot be done.

        steps : whole numbers, those of which `add` takes a picture; view : SceneView
        """
        self.folder = Path(folder)
        with named_errors(folder):
            self.folder.mkdir(parents=True, exist_ok=True)
        check_target(self.folder / "frame.png")
        self.count = 0
        self._steps = steps
        self._view = view
        self._isTransparent = isTransparent

    def add(self, simulation):
        """Takes a picture if the simulation stands at one of the steps."""
        if simulation.stepCount in self._steps:
            self._view.refresh()
            path = self.folder / f"frame_{simulation.stepCount:06d}.png"
            save_picture(path, self._isTransparent)
            self.count += 1


def save_picture(path, isTransparent=False):
    """Writes what the camera sees as PNG, in place of an old file: whole or not at all."""
    import polyscope as ps

    part = picture_part(path)
    # Polyscope asks for both: a background of no opacity, and that this be kept.
    ps.set_background_color((*BACKGROUND, 0.0 if isTransparent else 1.0))
    try:
        with named_errors(path):
            open(part, "wb").close()  # Polyscope would not say why it cannot write
        ps.screenshot(str(part), transparent_bg=isTransparent)
        if not is_whole_png(part):  # nor does it say that the disk is full
            raise OSError(errno.ENOSPC, NOT_WHOLE.format("picture"), str(path))
        put_in_place(part, path)
    finally:
        part.unlink(missing_ok=True)


NOT_WHOLE = "the {} could not be written to its end; is the disk full?"


def picture_part(path):
    """Where a picture or video is written first: beside its place, and with its ending."""
    path = Path(os.path.abspath(path))
    return path.with_name(f"{path.stem}.part{path.suffix}")


def is_whole_png(path):
    """Whether a file begins and ends like a PNG. What is missing at the end is found so."""
    content = Path(path).read_bytes()
    return content.startswith(b"\x89PNG\r\n\x1a\n") and content.endswith(b"IEND\xaeB`\x82")


def is_whole_video(path):
    """Whether an .mp4 or .gif has its beginning and its end; its pictures are not looked at."""
    with open(path, "rb") as file:
        size = file.seek(0, os.SEEK_END)
        if Path(path).suffix.lower() == ".gif":
            file.seek(max(size - 1, 0))
            return size > 0 and file.read() == b";"
        # A row of boxes, each with its length and kind before it.
        place, kinds = 0, set()
        while place < size:
            file.seek(place)
            head = file.read(16)
            length, kind = int.from_bytes(head[:4], "big"), head[4:8]
            if length == 1:  # the length follows in eight bytes
                length = int.from_bytes(head[8:16], "big")
            if length < 8 or place + length > size:
                return False
            kinds.add(kind)
            place += length
    return {b"moov", b"mdat"} <= kinds


VIDEO_ENDINGS = (".mp4", ".gif")
# Pictures a second that a video has where nobody says: enough for motion to look smooth, and a
# divisor of the usual 50 steps a second.
VIDEO_RATE = 25.0
FFMPEG_REMEDY = "Install it: pip install imageio-ffmpeg"
# Of H.264 in imageio-ffmpeg's scale up to 10: no artefacts to be seen.
VIDEO_QUALITY = 7
# Whose pictures have even sides.
EVEN_FILTER = "crop=trunc(iw/2)*2:trunc(ih/2)*2"
# One palette for all of a GIF, without dithering, which would flicker and make it larger.
GIF_FILTER = "split[a][b];[a]palettegen=stats_mode=full[p];[b][p]paletteuse=dither=none"


def video_timing(timeStep, rate=None, every=None):
    """How often a video takes a picture, and how fast it plays; in real time, as far as possible.

    timeStep : seconds; rate : pictures a second, or None; every : steps between two pictures, or
    None. Given both, the video plays `rate · every · timeStep` times as fast as the scene.
    returns (rate, every)
    """
    if every is None:
        every = max(1, round(1.0 / ((rate or VIDEO_RATE) * timeStep)))
    return rate or 1.0 / (every * timeStep), every


class Video:
    """A video (.mp4 or .gif) of every `every`-th step.

    Written beside its place under another name and put there by `save`. Attributes: path; count,
    the pictures so far; rate, pictures a second; every.
    """

    def __init__(self, path, view, rate, every):
        """Starts the encoder; raises DrawingError where there is none, OSError where it cannot
        write at `path`."""
        import polyscope as ps

        try:
            import imageio_ffmpeg
        except ImportError:
            raise DrawingError(f"no video: imageio-ffmpeg is missing. {FFMPEG_REMEDY}") from None

        self.path = Path(path)
        self.rate, self.every = rate, every
        self.count = 0
        self._view = view
        self._firstStep = self._lastStep = None
        self._partPath = picture_part(self.path)
        check_target(self.path)
        with named_errors(path):
            open(self._partPath, "wb").close()
        if self.path.suffix.lower() == ".gif":
            options = {"codec": "gif", "pix_fmt_out": "pal8", "quality": None}
            parameters = ["-filter_complex", GIF_FILTER]
        else:
            options = {"codec": "libx264", "quality": VIDEO_QUALITY}
            parameters = ["-vf", EVEN_FILTER, "-movflags", "+faststart"]
        self._writer = imageio_ffmpeg.write_frames(
            str(self._partPath), ps.get_buffer_size(), fps=rate, macro_block_size=1,
            output_params=parameters, ffmpeg_log_level="quiet", **options,
        )  # fmt: skip
        self._writer.send(None)

    def add(self, simulation):
        """Takes a picture each `every` steps, from the first call on, but of no step twice.

        raises OSError where the encoder has given up
        """
        step = simulation.stepCount
        if self._firstStep is None:
            self._firstStep = step
        if (step - self._firstStep) % self.every == 0 and step != self._lastStep:
            import polyscope as ps

            self._view.refresh()
            picture = ps.screenshot_to_buffer(transparent_bg=False)[:, :, :3]
            try:
                self._writer.send(np.ascontiguousarray(picture))
            except (OSError, StopIteration):  # of several lines, about a pipe
                raise OSError(errno.ENOSPC, NOT_WHOLE.format("video"), str(self.path)) from None
            self.count += 1
            self._lastStep = step

    def save(self):
        """Ends the video and puts it in its place, where an old one may be; raises OSError."""
        self._writer.close()
        if not is_whole_video(self._partPath):  # the encoder says nothing
            raise OSError(errno.ENOSPC, NOT_WHOLE.format("video"), str(self.path))
        put_in_place(self._partPath, self.path)

    def summary(self, simulation):
        """How long it is, and how fast it plays, in words."""
        factor = self.rate * self.every * simulation.settings.timeStep
        pace = "in real time" if abs(factor - 1.0) < 0.01 else f"at {factor:.3g} times real time"
        return f"{self.count} pictures, {self.rate:.4g} a second, {pace}"

    def close(self):
        """Removes what was written beside the place. Does nothing after `save`."""
        self._writer.close()
        self._partPath.unlink(missing_ok=True)
