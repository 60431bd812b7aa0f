"""Bodies, shadows, constraints and overlays in Polyscope.

Import it only after `rbs.pictures.backends.find_backend` has found that Polyscope can draw here.

All bodies form one surface and their shadows another one, so that the cost of drawing hardly
depends on the number of bodies. A replay may take the place of a simulation, as may anything with
its attributes.

Reading order: starting Polyscope; `SceneView`.
"""

import math
from contextlib import contextmanager

import numpy as np
import polyscope as ps
from scipy.spatial import ConvexHull

from Quaternion import QConj, QRotate
from rbs.appearance import framing
from rbs.appearance.colours import (
    BACKGROUND,
    BOX_COLOUR,
    CREASE_COLOUR,
    GROUND_COLOUR,
    MARK_COLOUR,
    PICKED_COLOUR,
    REPORT_COLOURINGS,
    SHADOW_COLOUR,
    BodyColours,
    constraint_legend,
)
from rbs.appearance.drawables import Arrows, ConstraintLines, flatten_meshes, ground_lines
from rbs.appearance.pictureoptions import PICTURE_SIZE
from rbs.appearance.pixels import draw_arrows, draw_dot, draw_lines
from rbs.appearance.shading import FloorShadows, LitSurface, poses_of
from rbs.pictures.backends import CLOSED, clip_drawing
from rbs.pictures.cameras import kept_camera, look, present_camera
from rbs.pictures.overlays import OVERLAYS, Overlays
from RBSFunctions import refresh_vertices

# Layers that can be switched on and off, and what they show.
LAYERS = {"ground": "Plane y = 0, with lines", "shadows": "Shadows cast on the floor"}
LAYERS |= {name: one.shows for name, one in OVERLAYS.items()}
# Pixels, the width of an edge on each of its faces.
CREASE_WIDTH = 1.0
# In the moving picture of the window, which is not supersampled: wider and paler, since thin dark
# ones look dashed.
MOVING_WIDTH, MOVING_COLOUR = 1.3, (0.30, 0.30, 0.34)
# Half the width of constraints, relative to the scene's size.
CONSTRAINT_RADIUS = 1.2e-3
# The ground, in sizes of the scene: its visible radius; the camera's usual distance from its
# target; the steps of shift and of growth in which the ground follows the view; and the distance at
# which Polyscope clips, with a small margin.
GROUND_REACH = 9.0
USUAL_DISTANCE = 1.6
GROUND_SHIFT, GROUND_GROWTH = 0.5, 1.6
FAR_CLIP = 19.0
# Cosine of the least angle between camera and vertical at which `frame_all` keeps the direction.
STEEPEST = 0.99
# Least height of the camera above the ground, as a fraction of the scene's size.
LOWEST_EYE = 0.01
# Start of a shot, as a fraction of the way from the camera to its target.
SHOT_BEGIN = 0.4
# Height of shadows above the ground, relative to the scene's size: the least that does not flicker
# in a 24-bit depth buffer.
SHADOW_HEIGHT = 1e-3


def start_polyscope(backend, size=None):
    """Starts Polyscope with this backend and the options common to all scenes.

    size : (width, height) of picture or window in pixels; None for the default
    """
    ps.set_verbosity(0)
    ps.set_program_name("Rigid bodies")
    ps.set_use_prefs_file(False)
    ps.set_window_size(*(size or PICTURE_SIZE))
    ps.init(backend.name)
    ps.set_automatically_compute_scene_extents(False)
    ps.set_up_dir("y_up")
    ps.set_build_default_gui_panels(False)
    ps.set_open_imgui_window_for_user_callback(False)
    ps.set_ground_plane_mode("none")  # that of `SceneView` is faster
    ps.set_background_color(BACKGROUND)
    # more has no effect off-screen; see rbs/pictures/capture.py and rbs/window/panel.py
    ps.set_SSAA_factor(1)


class SceneView:
    """A simulation's bodies, shadows and constraints in Polyscope, which must be running.

    Attributes
    ----------
    simulation; colouring : a name of COLOURINGS; shown : set of names of LAYERS
    picked, pickedPoint : index of the selected body, or None; (3,), a point of it at rest
    squareSide : side of the ground's squares in metres
    groundPlace : middle (3,) of the ground, and size of what stands on it in metres
    hasLegend, isSmooth : whether pictures have a legend; whether the window's edges are smooth
    highlight : `Highlight` of a moment within a step, or None
    follows : whether the camera follows the selected body
    studio : `StudioLook` if pictures have that look, or None
    callback : function that draws the panels in each frame, or None
    """

    def __init__(self, simulation):
        self._margins = (0, 0, 0, 0)  # pixels covered by panels: left, top, right, bottom
        self._windowSize = ps.get_window_size()
        self.callback = self.studio = self.highlight = None
        self.overlays = Overlays(self)
        self.colouring = "body"
        self.shown = {"ground", "shadows"}
        self.hasLegend = self.follows = self.isSmooth = False
        self.rebuild(simulation)

    def rebuild(self, simulation):
        """Registers the bodies of a new scene and points the camera at them."""
        self.simulation = simulation
        self.groundPlace = self.highlight = None
        self.pick(None)
        vertices, _, _ = flatten_meshes(simulation.meshes)
        ground = vertices * [1.0, 0.0, 1.0]
        points = np.concatenate([vertices, ground])
        low, high = np.min(points, axis=0), np.max(points, axis=0)
        self._size = float(np.linalg.norm(high - low))
        ps.set_length_scale(self._size)
        ps.set_bounding_box(low, high)
        simulation.go_beside()
        vertices = self._register_bodies()
        bodySize = np.median(np.linalg.norm(np.subtract(*self.boxes(vertices)), axis=1))
        self.overlays.restart(self._size, bodySize)
        self._register_constraints(vertices)
        self._point_camera(framing.framed_points(simulation.meshes, simulation.constraints))
        self.spread_ground()
        for name in LAYERS:
            self._show_layer(name)
        self.refresh()

    @property
    def size(self):
        """Diagonal of the box around the scene and its ground at the start, in metres."""
        return self._size

    def _register_bodies(self):
        """Registers bodies and shadows; returns the vertices."""
        meshes = self.simulation.meshes
        self.bodyColours = BodyColours(meshes)
        vertices, self.faces, self.bodyOfFace = flatten_meshes(meshes)
        self._shown = self._shown_bodies()
        self._surface = LitSurface(meshes)
        self._firstVertex = self._surface.firstVertex
        # surfaces are drawn in alphabetical order: what bodies hide of the others takes no time
        corners = vertices[self._surface.source]
        self._bodies = ps.register_surface_mesh("bodies", corners, self._surface.faces, **CLOSED)
        self._bodies.set_selection_mode("faces_only")
        self._style_edges()
        # Polyscope would draw all edges of the triangles
        creases = self._surface.isCrease.astype(np.float64).repeat(3, axis=0)
        self._bodies.get_buffer("edgeIsReal").update_data(creases)
        self._floorShadows = FloorShadows(np.diff(self._firstVertex, append=len(vertices)))
        places = self._floorShadows.place(vertices, SHADOW_HEIGHT * self._size)
        shadows = "shadows", places, self._floorShadows.faces
        self._shadows = ps.register_surface_mesh(*shadows, **CLOSED)
        darkness = self._floorShadows.darkness[:, None]
        colours = GROUND_COLOUR + darkness * (SHADOW_COLOUR - GROUND_COLOUR)
        self._shadows.add_color_quantity("darkness", colours, defined_on="vertices", enabled=True)
        self._painted = []  # structures that have colours
        self._poses = self._colours = None
        return vertices

    def _style_edges(self):
        isMoving = self.callback is not None and not self.isSmooth
        self._bodies.set_edge_width(MOVING_WIDTH if isMoving else CREASE_WIDTH)
        self._bodies.set_edge_color(MOVING_COLOUR if isMoving else CREASE_COLOUR)

    def _shown_bodies(self):
        """Returns what is registered: bodies with their numbers of vertices, and constraints."""
        bodies = [(mesh, len(mesh.origVertices)) for mesh in self.simulation.meshes]
        return bodies, list(self.simulation.constraints)

    def _follow_bodies(self):
        """Registers bodies and constraints again if some have changed; the camera stays."""
        if self._shown_bodies() == self._shown:
            return
        before, after = (list(some) for some in (self._shown[0], self.simulation.meshes))
        if self.picked is not None and before[self.picked][0] not in after:
            self.pick(None)
        elif self.picked is not None:
            self.picked = after.index(before[self.picked][0])
        for (mesh, _), index in zip(before, self.bodyColours.index.tolist(), strict=True):
            mesh.colourIndex = index  # it keeps its colour
        if len(after) <= len(before):  # indices have changed
            self.overlays.memory.trail, self.overlays.memory.heldContacts = [], {}
        self._register_constraints(self._register_bodies())
        self._shadows.set_enabled("shadows" in self.shown)

    def show_instead(self, simulation):
        """Shows a simulation of the same bodies in place of the present one; the camera stays."""
        self.simulation = simulation
        simulation.go_beside()
        self.refresh()

    def spread_ground(self):
        """Moves the ground below the camera's target, in steps that depend on the view alone."""
        middle = np.array(ps.get_view_center(), dtype=np.float64)
        distance = float(np.linalg.norm(self._eye() - middle))
        growth = round(math.log(max(distance / USUAL_DISTANCE / self._size, 1.0), GROUND_GROWTH))
        size = self._size * GROUND_GROWTH**growth
        middle = GROUND_SHIFT * size * np.round(middle / (GROUND_SHIFT * size))
        if self.groundPlace == (tuple(middle), size):
            return
        self.groundPlace = tuple(middle), size
        # Polyscope clips everything beyond
        reach = min(GROUND_REACH * size, max(FAR_CLIP * self._size - distance, 2.0 * self._size))
        vertices, faces, colours, self.squareSide = ground_lines(size, middle, reach)
        self._ground = ps.register_surface_mesh(
            "terrain", vertices, faces, material="flat", enabled="ground" in self.shown
        )
        self._ground.add_color_quantity("lines", colours, defined_on="vertices", enabled=True)

    def _register_constraints(self, vertices):
        ps.remove_curve_network("constraints", error_if_absent=False)
        self._constraintLines = ConstraintLines(self.simulation)
        if len(self._constraintLines.ends):
            nodes = self._constraintLines.nodes(vertices)
            lines = "constraints", nodes, np.arange(len(nodes)).reshape(-1, 2)
            self._lines = ps.register_curve_network(
                *lines, radius=CONSTRAINT_RADIUS, material="flat"
            )

    def _refresh_constraints(self):
        if len(self._constraintLines.ends):
            self._lines.update_node_positions(self._constraintLines.nodes(self._vertices))
            self._paint(self._lines, self._constraintLines.colours(self._vertices), "edges")

    def _point_camera(self, points, margins=None, direction=framing.VIEW_DIRECTION):
        """Frames points (n, 3) between the panels; margins : instead of the present ones."""
        fieldOfView = ps.get_view_camera_parameters().get_fov_vertical_deg()
        margins = self._margins if margins is None else margins
        size = ps.get_window_size()
        look(*framing.frame_camera(points, direction, fieldOfView, size, margins))
        self._framed = points, self._viewpoint(), direction

    def keep_above_ground(self):
        """Raises a camera that has been turned below the ground, at its distance."""
        eye, lowest = self._eye(), LOWEST_EYE * self._size
        target = np.array(ps.get_view_center(), dtype=np.float64)
        if eye[1] < lowest:
            target[1] = max(target[1], lowest)
            arm, down = eye - target, lowest - target[1]
            across = math.sqrt(max(arm @ arm - down * down, 0.0)) / math.hypot(arm[0], arm[2])
            look(target + [across * arm[0], down, across * arm[2]], target)

    def set_margins(self, margins, size):
        """Sets the pixels that panels cover at the left, top, right and bottom of the window.

        size : of the window, (width, height). A camera that frames the scene, or centres a body,
        continues to do so.
        """
        if (margins, size) != (self._margins, self._windowSize):
            isFramed = self._is_framed()
            isCentred = np.array_equal(self._viewpoint(), self._centred)
            self._margins, self._windowSize = margins, size
            if isFramed:
                self._point_camera(self._framed[0], direction=self._framed[2])
            elif isCentred:
                self.centre_picked()
            self._clip()

    def _clip(self, isOn=True):
        """Draws nothing behind the panels, unless the window is supersampled."""
        if not isOn or self.callback is None or self.isSmooth:
            clip_drawing()
        else:
            scale = np.divide(ps.get_buffer_size(), self._windowSize)
            left, top, right, bottom = self._margins
            width, height = np.subtract(self._windowSize, (left + right, top + bottom))
            clip_drawing((*(scale * (left, bottom)), *np.ceil(scale * (width, height))))

    def _is_framed(self):
        """Whether the camera has not moved since it framed the scene."""
        _, viewpoint, _ = self._framed
        return np.allclose(self._viewpoint(), viewpoint, rtol=1e-4, atol=1e-4 * self._size)

    def _viewpoint(self):
        """Position of the camera, and the centre of its orbits, (2, 3)."""
        return np.array([self._eye(), ps.get_view_center()])

    def _eye(self):
        """Position of the camera, (3,)."""
        return np.array(ps.get_view_camera_parameters().get_position(), dtype=np.float64)

    def frame_all(self):
        """Points the camera at all bodies in their present poses, or at those that stand out and
        their arrows, in its present direction.

        Bodies flung far from the others are left out. If the camera has not moved since the last
        time, it takes the usual direction.
        """
        direction = -np.array(ps.get_view_camera_parameters().get_look_dir())
        if self._is_framed() or abs(direction[1]) > STEEPEST:
            direction = framing.VIEW_DIRECTION
        meshes, constraints = self.simulation.meshes, self.simulation.constraints
        if self.highlight is None:
            points = framing.framed_points(meshes, constraints)
        else:
            tips = [point + arrow for point, arrow, _ in self.highlight.arrows.values()]
            points = refresh_vertices([meshes[b] for b in self.highlight.bodies])
            points = np.concatenate([points, *np.reshape(tips, (-1, 1, 3))])
        self._point_camera(points, direction=direction)
        self.spread_ground()

    def centre_picked(self):
        """Turns the camera to the selected body, which appears in the middle between the panels;
        it then orbits and zooms about the body's centre.
        """
        if self.picked is None:
            return
        centre, eye = self.simulation.meshes[self.picked].position[0], self._eye()
        ps.look_at(eye, centre)
        camera = ps.get_view_camera_parameters()
        left, top, right, bottom = self._margins
        angle = math.radians(camera.get_fov_vertical_deg())
        perPixel = 2.0 * math.tan(angle / 2.0) / ps.get_window_size()[1]
        shift = (right - left) * np.array(camera.get_right_dir())
        shift = shift + (top - bottom) * np.array(camera.get_up_dir())
        shift *= 0.5 * perPixel * np.linalg.norm(centre - eye)
        ps.look_at(eye + shift, centre + shift)
        ps.set_view_center_raw(centre)
        self._centred = self._viewpoint()

    def frame_still(self):
        """Points the camera at the present bodies from a low position."""
        ps.set_vertical_fov_degrees(framing.STILL_ANGLE)
        look(*framing.frame_still(self.simulation.meshes, ps.get_window_size()))
        self.spread_ground()

    @contextmanager
    def framed_still(self):
        """Applies `frame_still` within the `with` block."""
        with kept_camera():
            self.frame_still()
            yield
        self.spread_ground()

    def picture_camera(self):
        """Returns size in pixels and camera, as from `load_camera`, of a picture of the window."""
        with self.whole_width():
            return ps.get_window_size(), present_camera()

    def memory(self):
        """Returns the data of pictures from earlier steps: dict, for `recall`."""
        names = "_size colouring shown hasLegend bodyColours groundPlace squareSide picked "
        names += "pickedPoint _lastFocus"
        memory = {name: vars(self)[name] for name in names.split()}
        return memory | {"overlays": self.overlays.memory}

    def recall(self, memory):
        """Adopts the `memory` of another SceneView, so that pictures look the same."""
        self.shown = memory["shown"]
        for name in LAYERS:
            self._show_layer(name)
        self.overlays.memory = memory["overlays"]
        vars(self).update({name: memory[name] for name in memory if name != "overlays"})
        ps.set_length_scale(self._size)
        self.refresh()

    @contextmanager
    def whole_width(self):
        """Draws behind the panels too, within the `with` block.

        A camera that frames the scene uses their area.
        """
        self._clip(False)
        points, _, direction = self._framed
        isFramed = any(self._margins) and self._is_framed()
        if isFramed:
            self._point_camera(points, (0, 0, 0, 0), direction)
        try:
            yield
        finally:
            if isFramed:
                self._point_camera(points, direction=direction)
            self._clip()

    def _follow(self):
        """Moves the camera, if it follows, as far as the selected body has moved."""
        if self.picked is None:
            return
        focus = self.simulation.meshes[self.picked].position[0].copy()
        way, self._lastFocus = focus - self._lastFocus, focus
        if self.follows and way.any():
            matrix, centre = ps.get_camera_view_matrix(), np.array(ps.get_view_center()) + way
            matrix[:3, 3] -= matrix[:3, :3] @ way
            ps.set_camera_view_matrix(matrix)
            ps.set_view_center_raw(centre)
            self.spread_ground()

    def refresh(self):
        """Draws everything in its present state, at one instant, from the next frame on.

        What has not moved is not drawn again.
        """
        self._follow_bodies()
        self._follow()
        if self.showsReport:
            self.simulation.find_report()
        poses = poses_of(self.simulation.meshes) if self.highlight is None else self.highlight.poses
        if not np.array_equal(poses, self._poses):
            self._poses, self._colours = poses, None
            self._vertices = self._surface.place(poses)
            self._bodies.update_vertex_positions(self._vertices.take(self._surface.source, axis=0))
            height = SHADOW_HEIGHT * self._size
            shadows = self._floorShadows.place(self._vertices, height)
            self._shadows.update_vertex_positions(shadows)
            self._refresh_constraints()
        if len(self._constraintLines.ends):
            self._lines.set_enabled(self.simulation.settings.enforceConstraints)
        self._refresh_colours()
        self.overlays.refresh(self._vertices)

    @property
    def showsReport(self):
        """Whether the picture shows something of the last step's report."""
        return self.overlays.needContacts or self.colouring in REPORT_COLOURINGS

    def body_colours(self):
        """RGB of every body, (n, 3), in the current colouring."""
        colours = self.bodyColours.of(self.simulation, self.colouring)
        return colours if self.highlight is None else self.highlight.paled(colours)

    def colour_by(self, colouring):
        """Colours the bodies by a name of COLOURINGS."""
        self.colouring = colouring
        self.refresh()

    def _refresh_colours(self):
        """Colours of the bodies in their light."""
        colours = self.body_colours()
        if self._colours is not None and np.array_equal(colours, self._colours):
            return
        self._colours = colours
        self._paint(self._bodies, self._surface.lit(colours), "vertices")

    def _paint(self, structure, colours, places):
        """Gives a structure its colours (m, 3), without registering them again."""
        if structure in self._painted:
            structure.get_quantity_buffer("colour", "colors").update_data(colours)
        else:
            structure.add_color_quantity("colour", colours, defined_on=places, enabled=True)
            self._painted.append(structure)

    def legend(self):
        """Returns the legend of colours and arrows: rows (text, (r, g, b))."""
        rows = self.bodyColours.legend(self.simulation, self.colouring)
        if len(self._constraintLines.ends) and self.simulation.settings.enforceConstraints:
            rows += constraint_legend()
        return rows + self.overlays.meanings()

    def toggle(self, name):
        """Switches one of LAYERS on if it is off, and off if it is on."""
        self.show(name, name not in self.shown)

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
            self.overlays.remove(name)

    def ghost_lines(self):
        """Returns the edges of our free bodies beside a student's, (V, 3) and (E, 2), or None."""
        if self.simulation.beside is None:
            return None
        return self._surface.edges_of_free(self.simulation.beside.ours.meshes)

    def boxes(self, vertices):
        """Bounding boxes of the bodies: low, high (n, 3)."""
        return (
            np.minimum.reduceat(vertices, self._firstVertex),
            np.maximum.reduceat(vertices, self._firstVertex),
        )

    @contextmanager
    def hidden(self):
        """Hides the scene within the `with` block; yields the structures drawn over bodies."""
        names = ("constraints", *OVERLAYS)
        overlays = [ps.get_curve_network(name) for name in names if ps.has_curve_network(name)]
        overlays = [one for one in overlays if one.is_enabled()]
        scene = [self._bodies, self._shadows, self._ground]
        scene = [one for one in scene if one.is_enabled()]
        for structure in overlays + scene:
            structure.set_enabled(False)
        try:
            yield overlays
        finally:
            for structure in overlays + scene:
                structure.set_enabled(True)

    def set_supersampling(self, isOn):
        """Switches supersampling of the window on or off."""
        if isOn != self.isSmooth:  # Polyscope draws everything again
            self.isSmooth = isOn
            ps.set_SSAA_factor(2 if isOn else 1)
            self._clip()
            self._style_edges()

    def set_callback(self, callback):
        """Sets the function that draws the panels in each frame; None removes it."""
        self.callback = callback
        ps.set_user_callback(callback)
        self._clip()
        self._style_edges()

    def set_resizable(self, isResizable):
        ps.set_window_resizable(isResizable)

    def pick(self, body, point=None):
        """Marks a body, by index, and a world point (3,) on it; None marks nothing."""
        self.picked, self.pickedPoint, self._lastFocus = body, None, None
        self._centred = None  # the viewpoint that centres the body
        if body is not None:
            mesh = self.simulation.meshes[body]
            self._lastFocus = mesh.position[0].copy()
            self.pickedPoint = QRotate(QConj(mesh.orientation), point - mesh.position)[0]

    def picked_point(self):
        """Present position (3,) of the marked point in the world."""
        mesh = self.simulation.meshes[self.picked]
        return (QRotate(mesh.orientation, self.pickedPoint[None]) + mesh.position)[0]

    def body_at(self, pixel):
        """Returns body and point (3,) at a pixel (x, y) from the window's top left corner.

        The result is (None, None) if there is no body.
        """
        hit = ps.pick(screen_coords=pixel)
        if not hit.is_hit or hit.structure_name != "bodies":
            return None, None
        return int(self.bodyOfFace[hit.structure_data["index"]]), hit.position

    def distance_of(self, point):
        """Depth of a point (3,) along the camera's line of sight, in metres."""
        return float((point - self._eye()) @ ps.get_view_camera_parameters().get_look_dir())

    def point_at(self, pixel, distance):
        """Returns the point (3,) seen at a pixel, at this distance along the view direction."""
        ray = ps.screen_coords_to_world_ray(pixel)
        gaze = np.array(ps.get_view_camera_parameters().get_look_dir())
        return self._eye() + distance / float(ray @ gaze) * ray

    def aim(self, pixel):
        """Returns start (3,), above ground, and direction (3,), unit, of a shot towards a pixel."""
        ray = np.array(ps.screen_coords_to_world_ray(pixel), dtype=np.float64)
        distance = np.linalg.norm(np.array(ps.get_view_center()) - self._eye())
        begin = self._eye() + SHOT_BEGIN * distance * ray
        begin[1] = max(begin[1], 0.05 * self._size)
        return begin, ray / np.linalg.norm(ray)

    def pixels_of(self, points):
        """Pixels (n, 2) at which points (n, 3) are seen; NaN behind the camera."""
        camera = ps.get_view_camera_parameters()
        axes = camera.get_right_dir(), camera.get_up_dir(), camera.get_look_dir()
        x, y, depth = np.array(axes) @ (np.reshape(points, (-1, 3)) - self._eye()).T
        width, height = ps.get_window_size()
        angle = math.radians(camera.get_fov_vertical_deg())
        scale = height / (2.0 * math.tan(angle / 2.0) * np.where(depth > 0.0, depth, np.nan))
        return np.stack([0.5 * width + scale * x, 0.5 * height - scale * y], axis=1)

    def outline(self, body):
        """Pixels (k, 2) around a body, which is convex; none behind the camera."""
        first, count = self._firstVertex[body], len(self.simulation.meshes[body].origVertices)
        pixels = self.pixels_of(self._vertices[first : first + count])
        if not np.isfinite(pixels).all():
            return np.zeros((0, 2))
        return pixels[ConvexHull(pixels, "QJ").vertices]

    @property
    def hasMarks(self):
        """Whether anything is drawn on top of the picture."""
        return bool(self.picked is not None or self.highlight or any(self.overlays.onTop.values()))

    def draw_marks(self, ink):
        """Draws overlays on top, and the selected body. ink : see `rbs.appearance.pixels`"""
        for one in (one for parts in self.overlays.onTop.values() for one in parts):
            begins = self.pixels_of(one.points)
            if isinstance(one, Arrows):
                draw_arrows(ink, begins, self.pixels_of(one.points + one.vectors), one.colour)
            else:
                draw_lines(ink, begins[one.edges], one.colour)
        bodies = [] if self.highlight is None else self.highlight.bodies
        outlined = [(body, BOX_COLOUR) for body in bodies]
        if self.picked is not None:
            outlined.append((self.picked, PICKED_COLOUR))
            draw_dot(ink, self.pixels_of(self.picked_point())[0], MARK_COLOUR)
        for body, colour in outlined:
            outline = self.outline(body)
            draw_lines(ink, np.stack([outline, np.roll(outline, 1, axis=0)], axis=1), colour)
