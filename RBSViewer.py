"""Everything that draws: pictures off-screen, and the window.

Polyscope is imported inside the functions that use it, never with this module, and only after
`find_backend` has found out, in a process of its own, that it can draw here: where a graphics
library is missing, Polyscope may end the whole process instead of raising an error.

All bodies together are one surface, their shadows another one, and their edges one set of lines,
so that the cost of drawing hardly depends on how many bodies there are.
"""

import math
import os
import subprocess
import sys
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np

from RBSFunctions import CONSTRAINT_SCHEDULINGS
from RigidBodySimulation import (
    SceneError,
    checked_restitution,
    checked_time_step,
    flatten_meshes,
    list_scenes,
    scene_name,
)

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


def start_polyscope(backend):
    """Starts Polyscope with this backend and the options that no scene changes."""
    import polyscope as ps

    ps.set_verbosity(0)
    ps.set_program_name("Rigid bodies")
    ps.set_use_prefs_file(False)
    ps.set_window_size(*PICTURE_SIZE)
    ps.init(backend.name)
    ps.set_automatically_compute_scene_extents(False)
    ps.set_up_dir("y_up")
    ps.set_ground_plane_mode("tile")
    ps.set_ground_plane_height(0.0)
    ps.set_background_color(BACKGROUND)
    # A window is redrawn all the time; of a picture, smooth edges are worth four times the work.
    ps.set_SSAA_factor(1 if backend.opensWindow else 2)


# ---------------------------------------------------------------------------------------------
# The look
# ---------------------------------------------------------------------------------------------

PICTURE_SIZE = (1280, 720)

BACKGROUND = (0.62, 0.70, 0.80)
FIXED_COLOUR = (0.72, 0.72, 0.72)
SHADOW_COLOUR = (0.30, 0.31, 0.33)
CREASE_COLOUR = (0.10, 0.12, 0.15)

# The colour map viridis at equal steps: its lightness falls evenly, also for the colour-blind.
# From light to heavy, and without the map's darkest tenth, on which no edge would show.
VIRIDIS = np.array([
    [253, 231, 37], [181, 222, 43], [110, 206, 88], [53, 183, 121], [31, 158, 137],
    [38, 130, 142], [49, 104, 142], [62, 73, 137], [72, 40, 120],
]) / 255.0  # fmt: skip

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
FRICTION_COLOUR = (0.84, 0.15, 0.16)
# The longest friction impulse on screen, relative to the scene's size.
LONGEST_IMPULSE = 0.1
ARROW_RADIUS = 2.5e-3

# From the middle of the scene to the camera: a little from the right, a little from above.
VIEW_DIRECTION = (0.45, 0.36, 1.0)
# The free rim of a picture, as a fraction of its size.
FRAME_MARGIN = 0.08
# How far over the ground the shadows lie, relative to the scene's size: the least that keeps the
# two from flickering through each other in a 24-bit depth buffer.
SHADOW_HEIGHT = 1e-3


def colour_of_density(density, lightest, heaviest):
    """RGB (3,) of a body: viridis over the logarithm of the density, from lightest to heaviest.

    Where all bodies are equally dense, the middle of the map.
    """
    place = 0.5
    if heaviest > lightest:
        place = math.log(density / lightest) / math.log(heaviest / lightest)
    steps = np.arange(len(VIRIDIS))
    return np.array([np.interp(place * steps[-1], steps, channel) for channel in VIRIDIS.T])


def body_colours(meshes):
    """RGB of every body, (n, 3): grey if fixed, else by its density among the free bodies."""
    densities = [mesh.density for mesh in meshes if not mesh.isFixed]
    return np.array([
        FIXED_COLOUR
        if mesh.isFixed
        else colour_of_density(mesh.density, min(densities), max(densities))
        for mesh in meshes
    ])  # fmt: skip


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

    Attributes: showsFriction, whether the friction impulses of the last step are drawn.
    """

    showsFriction = False

    def __init__(self, simulation):
        self.simulation = simulation
        self.rebuild()

    def rebuild(self):
        """Registers the bodies of a new scene and points the camera at them."""
        import polyscope as ps

        meshes = self.simulation.meshes
        vertices, faces, bodyOfFace = flatten_meshes(meshes)
        ground = vertices * [1.0, 0.0, 1.0]
        points = np.concatenate([vertices, ground])
        low, high = np.min(points, axis=0), np.max(points, axis=0)
        ps.set_length_scale(float(np.linalg.norm(high - low)))
        ps.set_bounding_box(low, high)
        self._shadowHeight = SHADOW_HEIGHT * ps.get_length_scale()

        self._bodies = ps.register_surface_mesh(
            "bodies", vertices, faces, material="clay", back_face_policy="identical"
        )
        self._bodies.add_color_quantity(
            "density", body_colours(meshes)[bodyOfFace], defined_on="faces", enabled=True
        )
        self._shadows = ps.register_surface_mesh(
            "shadows", self._shadow_of(vertices), faces,
            material="flat", back_face_policy="identical", color=SHADOW_COLOUR,
        )  # fmt: skip
        self._register_creases(vertices, faces)
        self._register_ties(vertices)
        self._point_camera(points)

    def _register_creases(self, vertices, faces):
        import polyscope as ps

        ps.remove_curve_network("creases", error_if_absent=False)
        creases = find_creases(vertices, faces)
        self._creases = None
        if 0 < len(creases) <= MOST_CREASES:
            # A curve network draws a dot at each of its nodes: it gets only those in use.
            self._creaseNodes, ends = np.unique(creases, return_inverse=True)
            self._creases = ps.register_curve_network(
                "creases", vertices[self._creaseNodes], ends.reshape(-1, 2),
                radius=CREASE_RADIUS, color=CREASE_COLOUR, material="flat",
            )  # fmt: skip

    def _register_ties(self, vertices):
        import polyscope as ps

        ps.remove_curve_network("constraints", error_if_absent=False)
        ps.remove_point_cloud("friction", error_if_absent=False)
        self._ties = Ties(self.simulation)
        if len(self._ties.ends):
            nodes = self._ties.nodes(vertices)
            self._lines = ps.register_curve_network(
                "constraints", nodes, np.arange(len(nodes)).reshape(-1, 2),
                radius=TIE_RADIUS, material="flat",
            )  # fmt: skip
            self._refresh_ties(vertices)

    def _refresh_ties(self, vertices):
        self._lines.update_node_positions(self._ties.nodes(vertices))
        self._lines.add_color_quantity(
            "use", self._ties.colours(vertices), defined_on="edges", enabled=True
        )
        self._lines.set_enabled(self.simulation.settings.enforceConstraints)

    def _refresh_friction(self):
        """Arrows of what each body was held back with, where the contact is now."""
        import polyscope as ps

        ps.remove_point_cloud("friction", error_if_absent=False)
        report = self.simulation.report
        contacts = report.contacts if self.showsFriction and report is not None else []
        contacts = [contact for contact in contacts if any(contact.friction)]
        if contacts:
            positions = [self.simulation.meshes[c.body1].position[0] for c in contacts]
            points = np.array(positions) + [c.arm for c in contacts]
            # body 1 receives the opposite of what the contact gives to body 2
            arrows = -np.array([c.friction for c in contacts])
            arrows *= LONGEST_IMPULSE * ps.get_length_scale() / np.linalg.norm(arrows, axis=1).max()
            cloud = ps.register_point_cloud("friction", points, color=FRICTION_COLOUR, radius=2e-3)
            cloud.add_vector_quantity(
                "impulse", arrows, vectortype="ambient", radius=ARROW_RADIUS,
                color=FRICTION_COLOUR, enabled=True,
            )  # fmt: skip

    def _point_camera(self, points):
        import polyscope as ps

        width, height = ps.get_window_size()
        fieldOfView = ps.get_view_camera_parameters().get_fov_vertical_deg()
        ps.look_at(*frame_camera(points, VIEW_DIRECTION, fieldOfView, width / height))

    def _shadow_of(self, vertices):
        """The bodies pressed onto the ground: straight below them, where they are going to fall."""
        return vertices * [1.0, 0.0, 1.0] + [0.0, self._shadowHeight, 0.0]

    def refresh(self):
        """Draws the bodies where they are now, from the next frame on."""
        vertices = np.concatenate([mesh.currVertices for mesh in self.simulation.meshes])
        self._bodies.update_vertex_positions(vertices)
        self._shadows.update_vertex_positions(self._shadow_of(vertices))
        if self._creases is not None:
            self._creases.update_node_positions(vertices[self._creaseNodes])
        if len(self._ties.ends):
            self._refresh_ties(vertices)
        self._refresh_friction()


class PictureSeries:
    """Off-screen pictures of chosen steps, DIR/frame_<step, six digits>.png."""

    def __init__(self, folder, steps, simulation, backend):
        """Makes the folder and starts Polyscope; raises OSError when the former cannot be done.

        steps : whole numbers, those of which `add` takes a picture
        """
        self.folder = Path(folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        self.count = 0
        self._steps = frozenset(steps)
        start_polyscope(backend)
        self._view = SceneView(simulation)

    def add(self, simulation):
        """Takes a picture if the simulation stands at one of the steps."""
        if simulation.stepCount not in self._steps:
            return
        self._view.refresh()
        save_picture(self.folder / f"frame_{simulation.stepCount:06d}.png")
        self.count += 1


def save_picture(path):
    """Writes what the camera sees as PNG, in place of an old file: whole or not at all."""
    import polyscope as ps

    part = path.with_name(f"{path.stem}.part{path.suffix}").resolve()
    ps.screenshot(str(part), transparent_bg=False)
    os.replace(part, path)


# ---------------------------------------------------------------------------------------------
# The window
# ---------------------------------------------------------------------------------------------

# Steps over which the milliseconds on screen are a median: half a second's worth.
TIMED_STEPS = 25
# A frame makes the steps that are due, so that a scene plays at its true speed however fast it is
# drawn, but goes on to draw after this many seconds of stepping: a window that is slower than the
# scene plays in slow motion, and still answers to its buttons.
STEPPING_SECONDS = 0.04
# What is due after a pause in drawing, while the window is dragged for instance, is forgotten but
# for this many seconds, so that the scene does not leap.
CATCH_UP_SECONDS = 0.1
# Densities that the legend has room for; of more, it shows only the ends.
LEGEND_LINES = 6
# In pixels. The panel is as high as its content.
PANEL_POSITION = (12, 12)
PANEL_WIDTH = 330
BUTTON_SIZE = (80, 0)
FIELD_WIDTH = 160

# The slider's end: more than rubber on dry stone.
MOST_FRICTION = 1.0

ERROR_TEXT = (1.0, 0.45, 0.40, 1.0)


class Viewer:
    """What the window's buttons and keys do, apart from how they are drawn.

    Attributes: simulation, view; isPlaying; message, an error line or "".
    """

    def __init__(self, simulation, view):
        self.simulation = simulation
        self.view = view
        self.isPlaying = False
        self.message = ""
        self._due = 0.0  # seconds of simulation that playing has fallen behind by
        self._recentSeconds = deque(maxlen=TIMED_STEPS)

    def toggle_play(self):
        """Plays if paused, pauses if playing."""
        self.isPlaying = not self.isPlaying

    def play(self, elapsed):
        """If playing, makes the steps that are due `elapsed` seconds after the last frame."""
        if not self.isPlaying:
            self._due = 0.0
            return
        timeStep = self.simulation.settings.timeStep
        self._due = min(self._due + elapsed, max(CATCH_UP_SECONDS, timeStep))
        begin = time.perf_counter()
        while self._due >= timeStep:
            self._due -= timeStep
            self._step()
            if time.perf_counter() - begin > STEPPING_SECONDS:
                self._due = 0.0
        self.view.refresh()

    def _step(self):
        self.simulation.step()
        self._recentSeconds.append(self.simulation.stepSeconds)

    def step_once(self):
        """A single step: pauses, if playing."""
        self.isPlaying = False
        self._step()
        self.view.refresh()

    def reset(self):
        """Back to the start of the scene, paused."""
        self.isPlaying = False
        self.simulation.reset()
        self._recentSeconds.clear()
        self.view.refresh()

    def choose_scene(self, path):
        """Changes to another scene, paused. A broken one only leaves its error in `message`."""
        self.message = ""
        try:
            self.simulation.load(path)
        except SceneError as error:
            self.message = str(error)
            return
        self.isPlaying = False
        self._recentSeconds.clear()
        self.view.rebuild()

    def set_restitution(self, value):
        """From the next step on; raises ValueError, and changes nothing, outside of [0, 1]."""
        self.simulation.settings.restitution = checked_restitution(value)

    def set_time_step(self, value):
        """In seconds, from the next step on; raises ValueError unless positive and finite."""
        self.simulation.settings.timeStep = checked_time_step(value)

    def scenes(self):
        """Paths of the scenes beside the current one."""
        return list_scenes(self.simulation.scenePath.parent)

    def milliseconds(self):
        """Median time of the last steps, or None before the first."""
        return 1e3 * median(self._recentSeconds) if self._recentSeconds else None


class NumberField:
    """A number to be typed into the panel. It takes effect with Enter, or on leaving the field."""

    def __init__(self, label, read, write, step):
        """read() gives the value; write(value) sets it, or raises ValueError with what is wrong.

        step : what the field's buttons + and - change it by
        """
        self._label = label
        self._read = read
        self._write = write
        self._step = step
        self._typed = None
        self.message = ""

    def draw(self):
        import polyscope.imgui as psim

        changed, value = psim.InputDouble(self._label, self._read(), self._step, 0.0, "%.4g")
        if changed:
            self._typed = value
        if psim.IsItemDeactivatedAfterEdit() and self._typed is not None:
            self.message = ""
            try:
                self._write(self._typed)
            except ValueError as error:
                self.message = str(error)
            self._typed = None
        if self.message:
            draw_error(self.message)


def draw_error(message):
    """A message in the panel that nobody overlooks."""
    import polyscope.imgui as psim

    psim.PushStyleColor(psim.ImGuiCol_Text, ERROR_TEXT)
    psim.TextWrapped(message)
    psim.PopStyleColor()


class Panel:
    """The window's panel and keys: shows a Viewer and calls its functions, once a frame.

    Attributes: viewer; fields, its two NumberFields, restitution and time step.
    """

    def __init__(self, viewer):
        self.viewer = viewer
        self._lastFrame = time.perf_counter()
        settings = viewer.simulation.settings
        self.fields = [
            NumberField("restitution", lambda: settings.restitution, viewer.set_restitution, 0.1),
            NumberField("time step (s)", lambda: settings.timeStep, viewer.set_time_step, 0.005),
        ]
        self._schedulings = list(CONSTRAINT_SCHEDULINGS)

    def frame(self):
        """Polyscope's callback: keys, panel, and the steps that are due."""
        import polyscope as ps
        import polyscope.imgui as psim

        self._handle_keys()
        psim.SetNextWindowPos(PANEL_POSITION, psim.ImGuiCond_Once)
        psim.SetNextWindowSizeConstraints((PANEL_WIDTH, 0), (PANEL_WIDTH, ps.get_window_size()[1]))
        psim.Begin("Rigid bodies", flags=psim.ImGuiWindowFlags_AlwaysAutoResize)
        psim.PushItemWidth(FIELD_WIDTH)
        self._draw_controls()
        self._draw_settings()
        self._draw_numbers()
        self._draw_legend()
        psim.PopItemWidth()
        psim.End()
        now = time.perf_counter()
        self.viewer.play(now - self._lastFrame)
        self._lastFrame = now

    def _handle_keys(self):
        import polyscope.imgui as psim

        if psim.GetIO().WantTextInput:  # somebody types into a field
            return
        if psim.IsKeyPressed(psim.ImGuiKey_Space, False):
            self.viewer.toggle_play()
        # A key that is held down steps again and again.
        if psim.IsKeyPressed(psim.ImGuiKey_S) or psim.IsKeyPressed(psim.ImGuiKey_RightArrow):
            self.viewer.step_once()
        if psim.IsKeyPressed(psim.ImGuiKey_R, False):
            self.viewer.reset()

    def _draw_controls(self):
        import polyscope.imgui as psim

        viewer = self.viewer
        # ### gives the button one identity, whatever it says.
        if psim.Button("Pause###play" if viewer.isPlaying else "Play###play", BUTTON_SIZE):
            viewer.toggle_play()
        psim.SetItemTooltip("Space")
        psim.SameLine()
        if psim.Button("Step", BUTTON_SIZE):
            viewer.step_once()
        psim.SetItemTooltip("S or Right")
        psim.SameLine()
        if psim.Button("Reset", BUTTON_SIZE):
            viewer.reset()
        psim.SetItemTooltip("R")

    def _draw_settings(self):
        import polyscope.imgui as psim

        viewer = self.viewer
        current = viewer.simulation.scenePath
        if psim.BeginCombo("scene", scene_name(current)):
            for path in viewer.scenes():
                if psim.Selectable(scene_name(path), selected=path == current):
                    viewer.choose_scene(path)
            psim.EndCombo()
        if viewer.message:
            draw_error(viewer.message)
        for field in self.fields:
            field.draw()
        settings = viewer.simulation.settings
        _, settings.closingOnly = psim.Checkbox("closing contacts only", settings.closingOnly)
        psim.SetItemTooltip("Contacts that already separate receive no impulse")
        _, settings.friction = psim.SliderFloat("friction", settings.friction, 0.0, MOST_FRICTION)
        changed, shown = psim.Checkbox("friction impulses", viewer.view.showsFriction)
        if changed:
            viewer.view.showsFriction = shown
            viewer.view.refresh()
        if viewer.simulation.constraints:
            self._draw_constraint_settings()

    def _draw_constraint_settings(self):
        import polyscope.imgui as psim

        settings = self.viewer.simulation.settings
        changed, settings.enforceConstraints = psim.Checkbox(
            "constraints", settings.enforceConstraints
        )
        if changed:
            self.viewer.view.refresh()
        if psim.BeginCombo("scheduling", settings.constraintScheduling):
            for name in self._schedulings:
                if psim.Selectable(name, selected=name == settings.constraintScheduling):
                    settings.constraintScheduling = name
            psim.EndCombo()

    def _draw_numbers(self):
        import polyscope.imgui as psim

        simulation = self.viewer.simulation
        milliseconds = self.viewer.milliseconds()
        psim.Separator()
        psim.Text(f"{len(simulation.meshes)} bodies")
        psim.Text(f"step {simulation.stepCount}, {simulation.time:.2f} s simulated")
        psim.Text("no step yet" if milliseconds is None else f"{milliseconds:.2f} ms per step")
        report = simulation.report
        if report is not None:
            psim.Text(f"{len(report.contacts)} contacts")
        if report is not None and simulation.constraints:
            psim.Text(f"{report.constraintVisits} visits of {len(simulation.constraints)} bounds")

    def _draw_legend(self):
        import polyscope.imgui as psim

        psim.Separator()
        for text, colour in legend(self.viewer.simulation.meshes):
            psim.ColorButton(text, (*colour, 1.0), psim.ImGuiColorEditFlags_NoTooltip)
            psim.SameLine()
            psim.Text(text)


def legend(meshes):
    """What the colours mean: (text, (r, g, b)) for each density, or for the ends of too many."""
    free = [mesh for mesh in meshes if not mesh.isFixed]
    densities = sorted({mesh.density for mesh in free})
    if len(densities) > LEGEND_LINES:
        densities = [densities[0], densities[-1]]
    lines = [
        (f"density {density:g}", tuple(colour_of_density(density, densities[0], densities[-1])))
        for density in densities
    ]
    return lines + [("fixed", FIXED_COLOUR)] * (len(free) < len(meshes))


def show_window(simulation, backend):
    """Opens the window on a simulation; returns when it is closed."""
    import polyscope as ps

    start_polyscope(backend)
    ps.set_build_default_gui_panels(False)
    ps.set_open_imgui_window_for_user_callback(False)
    panel = Panel(Viewer(simulation, SceneView(simulation)))
    ps.set_user_callback(panel.frame)
    ps.show()
    ps.clear_user_callback()
