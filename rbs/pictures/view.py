"""Bodies, shadows, constraints and overlays in Polyscope.

Import it only after `rbs.pictures.backends.find_backend` has found that Polyscope can draw here.
All bodies form one surface and their shadows another one, so that the cost of drawing hardly
depends on the number of bodies.
"""

import math

import numpy as np
import polyscope as ps
from scipy.spatial import ConvexHull

from Quaternion import QConj, QRotate
from rbs.appearance import colours
from rbs.appearance.camera import PICTURE_SIZE, USUAL_HEIGHT
from rbs.appearance.drawables import Arrows, ConstraintLines, ground_lines
from rbs.appearance.pixels import draw_arrows, draw_dot, draw_lines
from rbs.appearance.shading import FloorShadows, LitSurface, poses_of
from rbs.pictures.backends import CLOSED
from rbs.pictures.overlays import Overlays
from rbs.pictures.viewpoint import Viewpoint, present_camera
from rbs.recordings.replay import find_report
from rbs.scenes.simulation import go_beside
from RBSFunctions import refresh_vertices

# Pixels, the width of an edge on each of its faces.
CREASE_WIDTH = 1.0
# In the moving picture of the window, which is not supersampled: wider and paler, since thin dark
# ones look dashed.
MOVING_WIDTH, MOVING_COLOUR = 1.3, (0.30, 0.30, 0.34)
# The ground, in sizes of the scene: its visible radius; the camera's usual distance from its
# target; the steps of shift and of growth in which the ground follows the view; and the distance at
# which Polyscope clips, with a small margin.
GROUND_REACH = 9.0
USUAL_DISTANCE = 1.6
GROUND_SHIFT, GROUND_GROWTH = 0.5, 1.6
FAR_CLIP = 19.0
# Start of a shot, as a fraction of the way from the camera to its target.
SHOT_BEGIN = 0.4
# Height of shadows above the ground, relative to the scene's size: the least that does not flicker
# in a 24-bit depth buffer.
SHADOW_HEIGHT = 1e-3
# Surfaces that are seen only with a ground.
FLOOR = "terrain", "shadows"
# Metres: the radius of lines behind the camera.
LEAST_RADIUS = 1e-6


def start_polyscope(backend, size=PICTURE_SIZE):
    """Starts Polyscope. size : (width, height) of picture or window in pixels"""
    ps.set_verbosity(0)
    ps.set_program_name("Rigid bodies")
    ps.set_use_prefs_file(False)
    ps.set_window_size(*size)
    ps.init(backend.name)
    ps.set_automatically_compute_scene_extents(False)
    ps.set_up_dir("y_up")
    ps.set_build_default_gui_panels(False)
    ps.set_open_imgui_window_for_user_callback(False)
    ps.set_ground_plane_mode("none")  # that of `SceneView` is faster
    ps.set_background_color(colours.BACKGROUND)
    # more has no effect off-screen; see rbs/pictures/capture.py and rbs/window/panel.py
    ps.set_SSAA_factor(1)


class SceneView:
    """A simulation's bodies, shadows and constraints in Polyscope, which must be running.

    simulation; colouring : a name of COLOURINGS; shown : set of names of OVERLAYS
    picked, pickedPoint : index of the selected body, or None; (3,), a point of it at rest
    squareSide : side of the ground's squares in metres
    poses : (7, n), of the bodies as they are drawn, see `poses_of`
    constraintLines : `ConstraintLines`; size : diagonal of the box around the scene at the start
    groundPlace : middle (3,) of the ground, and size of what stands on it in metres
    isSmooth : whether the window's edges are smooth
    highlight : `Highlight` of a moment within a step, or None
    viewpoint : `Viewpoint`, the camera
    look : one of LOOKS, of pictures; framesStills : whether stills show the whole scene anew
    callback : function that draws the panels in each frame, or None
    """

    def __init__(self, simulation):
        self.callback, self.isSmooth, self.shown = None, False, set()
        self.look, self.framesStills, self.colouring = "plain", False, "body"
        self.overlays, self.viewpoint = Overlays(self, SceneLines()), Viewpoint(self)
        self.rebuild(simulation)

    def rebuild(self, simulation):
        """Registers the bodies of a new scene and points the camera at them."""
        self.simulation = simulation
        self.groundPlace = self.highlight = None
        self.pick(None)
        vertices = refresh_vertices(simulation.meshes)
        points = np.concatenate([vertices, vertices * [1.0, 0.0, 1.0]])
        low, high = points.min(axis=0), points.max(axis=0)
        self.size = float(np.linalg.norm(high - low))
        ps.set_length_scale(self.size)
        ps.set_bounding_box(low, high)
        go_beside(simulation)
        self.bodyColours, self._colourIndex = colours.BodyColours(simulation.meshes), {}
        self._register_bodies()
        bodySize = np.median(np.linalg.norm(np.subtract(*self.boxes()), axis=1))
        self.overlays.restart(self.size, bodySize)
        self.viewpoint.restart()
        self.refresh()

    def _register_bodies(self):
        meshes, self.constraintLines = self.simulation.meshes, ConstraintLines(self.simulation)
        vertices = refresh_vertices(meshes)
        for mesh in meshes:  # which keeps its colour, also if it is gone for a while
            self._colourIndex.setdefault(id(mesh), (len(self._colourIndex), mesh))
        self.bodyColours.index = np.array([self._colourIndex[id(mesh)][0] for mesh in meshes])
        self._shown = self._shown_bodies()
        self.surface = LitSurface(meshes)
        # surfaces are drawn in alphabetical order: what bodies hide of the others takes no time
        corners = vertices[self.surface.source]
        self._bodies = ps.register_surface_mesh("bodies", corners, self.surface.faces, **CLOSED)
        self._bodies.set_selection_mode("faces_only")
        self._style_edges()
        # Polyscope would draw all edges of the triangles
        creases = self.surface.isCrease.astype(np.float64).repeat(3, axis=0)
        self._bodies.get_buffer("edgeIsReal").update_data(creases)
        self._floorShadows = FloorShadows(self.surface.vertexCounts)
        places = self._floorShadows.place(vertices, SHADOW_HEIGHT * self.size)
        shadows = "shadows", places, self._floorShadows.faces
        self._shadows = ps.register_surface_mesh(*shadows, **CLOSED)
        darkness = self._floorShadows.darkness[:, None]
        shades = colours.GROUND_COLOUR + darkness * (colours.SHADOW_COLOUR - colours.GROUND_COLOUR)
        self._shadows.add_color_quantity("darkness", shades, defined_on="vertices", enabled=True)
        self.vertices, self.poses, self._colours = vertices, None, None

    def _style_edges(self):
        isMoving = self.callback is not None and not self.isSmooth
        self._bodies.set_edge_width(MOVING_WIDTH if isMoving else CREASE_WIDTH)
        self._bodies.set_edge_color(MOVING_COLOUR if isMoving else colours.CREASE_COLOUR)

    def _shown_bodies(self):
        bodies = [(mesh, len(mesh.origVertices)) for mesh in self.simulation.meshes]
        return bodies, list(self.simulation.constraints)

    def _follow_bodies(self):
        """Registers bodies and constraints again if some have changed; the camera stays."""
        if self._shown_bodies() == self._shown:
            return
        self.highlight = None  # of other bodies
        before, after = (list(some) for some in (self._shown[0], self.simulation.meshes))
        if self.picked is not None and before[self.picked][0] not in after:
            self.pick(None)
        elif self.picked is not None:
            self.picked = after.index(before[self.picked][0])
        if len(after) <= len(before):  # indices have changed
            self.overlays.forget_steps()
        self._register_bodies()

    def show_instead(self, simulation):
        """Shows a simulation of the same bodies in place of the present one; the camera stays."""
        self.simulation, self._colourIndex = simulation, {}
        go_beside(simulation)
        self.refresh()

    def spread_ground(self):
        """Moves the ground below the camera's target, in steps that depend on the view alone."""
        camera = present_camera()
        middle, distance = camera.centre, float(np.linalg.norm(camera.eye - camera.centre))
        growth = round(math.log(max(distance / USUAL_DISTANCE / self.size, 1.0), GROUND_GROWTH))
        size = self.size * GROUND_GROWTH**growth
        middle = GROUND_SHIFT * size * np.round(middle / (GROUND_SHIFT * size))
        if self.groundPlace == (tuple(middle), size):
            return
        self.groundPlace = tuple(middle), size
        # Polyscope clips everything beyond
        reach = min(GROUND_REACH * size, max(FAR_CLIP * self.size - distance, 2.0 * self.size))
        vertices, faces, shades, self.squareSide = ground_lines(size, middle, reach)
        ground = ps.register_surface_mesh("terrain", vertices, faces, material="flat")
        ground.add_color_quantity("lines", shades, defined_on="vertices", enabled=True)

    def refresh(self):
        """Draws everything in its present state from the next frame on."""
        self._follow_bodies()
        for one in map(ps.get_surface_mesh, FLOOR):
            if one.is_enabled() != self.simulation.settings.ground:
                one.set_enabled(self.simulation.settings.ground)
        if self.showsReport:
            find_report(self.simulation)
        poses = poses_of(self.simulation.meshes) if self.highlight is None else self.highlight.poses
        if not np.array_equal(poses, self.poses):
            self.poses, self._colours = poses, None
            self.vertices, self._hidden = self.surface.place(poses), None
        self.clear_sight()
        self._refresh_colours()
        self.overlays.refresh(self.vertices)
        self.resize_lines()

    def clear_sight(self):
        """Draws the bodies, except those between an event and the camera."""
        hidden, vertices = np.zeros(self.poses.shape[1], dtype=bool), self.vertices
        if self.highlight is not None:
            camera = present_camera()
            hidden = camera.depths(self.poses[:3].T) < camera.depths(self.event_points()).min()
            hidden[self.highlight.bodies] = False
        if np.array_equal(hidden, self._hidden):
            return
        self._hidden = hidden
        if hidden.any():  # all their vertices lie at one place of the ground
            counts = self.surface.vertexCounts
            places = (self.poses[:3].T * [1.0, 0.0, 1.0]).repeat(counts, axis=0)
            vertices = np.where(hidden.repeat(counts)[:, None], places, vertices)
        self._bodies.update_vertex_positions(vertices.take(self.surface.source, axis=0))
        shadows = self._floorShadows.place(vertices, SHADOW_HEIGHT * self.size)
        self._shadows.update_vertex_positions(shadows)

    def resize_lines(self):
        """Gives the lines in the scene their width in pixels, as seen from the present camera."""
        self.overlays.lines.resize(present_camera(), ps.get_window_size()[1])

    def show_event(self, highlight):
        """Shows a `Highlight` of a moment within a step, or with None the present state."""
        if highlight is not self.highlight:
            self.highlight = highlight
            self.refresh()
            if highlight is not None:
                self.viewpoint.go_to_event()

    def event_points(self):
        """Returns points (n, 3) of the bodies of an event and of its arrows, or None."""
        if self.highlight is None:
            return None
        tips = [point + 1.1 * arrow for point, arrow, _ in self.highlight.arrows.values()]
        bodies = [self.vertices_of(body) for body in self.highlight.bodies]
        return np.concatenate([*bodies, np.reshape(tips, (-1, 3))])

    @property
    def showsReport(self):
        """Whether the picture shows something of the last step's report."""
        return self.overlays.needContacts or self.colouring in colours.REPORT_COLOURINGS

    def body_colours(self):
        """RGB of every body, (n, 3), in the current colouring."""
        found = self.bodyColours.of(self.simulation, self.colouring)
        return found if self.highlight is None else self.highlight.paled(found)

    def colour_by(self, colouring):
        """Colours the bodies by a name of COLOURINGS."""
        self.colouring = colouring
        self.refresh()

    def _refresh_colours(self):
        found = self.body_colours()
        if self._colours is not None and np.array_equal(found, self._colours):
            return
        self._colours, light = found, self.surface.lit(found)
        self._bodies.add_color_quantity("colour", light, defined_on="vertices", enabled=True)

    def legend(self):
        """Returns the legend of colours and arrows: rows (text, (r, g, b))."""
        rows = self.bodyColours.legend(self.simulation, self.colouring)
        return rows + self.overlays.meanings()

    def show(self, name, isShown):
        """Switches one of OVERLAYS on or off."""
        (self.shown.add if isShown else self.shown.discard)(name)
        self.overlays.remove(name)
        self.refresh()

    def vertices_of(self, body):
        """Vertices (V, 3) of a body as it is drawn."""
        first = self.surface.firstVertex[body]
        return self.vertices[first : first + self.surface.vertexCounts[body]]

    def boxes(self):
        """Bounding boxes of the bodies as they are drawn: low, high (n, 3)."""
        ends = np.minimum, np.maximum
        return tuple(end.reduceat(self.vertices, self.surface.firstVertex) for end in ends)

    def set_supersampling(self, isOn):
        """Switches supersampling of the window on or off."""
        if isOn != self.isSmooth:  # Polyscope draws everything again
            self.isSmooth = isOn
            ps.set_SSAA_factor(2 if isOn else 1)
            self._style_edges()

    def set_callback(self, callback):
        """Sets the function that draws the panels in each frame; None removes it."""
        self.callback = callback
        ps.set_user_callback(callback)
        self._style_edges()

    def pick(self, body, point=None):
        """Marks a body, by index, and a point (3,) on it as it is drawn; None marks nothing."""
        self.picked, self.pickedPoint = body, None
        if body is not None:
            self.pickedPoint = self.rest_point(body, point)

    def rest_point(self, body, point):
        """Returns the point (3,) at rest, relative to its COM, that is drawn at a world point."""
        position, orientation = np.split(self.poses[:, body], [3])
        return QRotate(QConj(orientation[None]), (point - position)[None])[0]

    def world_point(self, body, rest):
        """Returns where a point (3,) at rest of a body is drawn."""
        position, orientation = np.split(self.poses[:, body], [3])
        return QRotate(orientation[None], rest[None])[0] + position

    @property
    def picked_mesh(self):
        """The marked Mesh, or None."""
        return None if self.picked is None else self.simulation.meshes[self.picked]

    def picked_point(self):
        """Position (3,) of the marked point in the world, where the body is drawn."""
        return self.world_point(self.picked, self.pickedPoint)

    def body_at(self, pixel):
        """Returns body and point (3,) at a pixel (x, y) of the window, or (None, None)."""
        hit = ps.pick(screen_coords=pixel)
        if not hit.is_hit or hit.structure_name != "bodies":
            return None, None
        return int(self.surface.bodyOfFace[hit.structure_data["index"]]), hit.position

    def distance_of(self, point):
        """Depth of a point (3,) along the camera's line of sight, in metres."""
        return float(present_camera().depths(point)[0])

    def point_at(self, pixel, distance):
        """Returns the point (3,) seen at a pixel, at this distance along the view direction."""
        camera = present_camera()
        ray = camera.rays(*np.array(pixel[::-1])[:, None], ps.get_window_size())[:, 0]
        return camera.eye + distance / float(ray @ camera.axes[2]) * ray

    def aim(self, pixel):
        """Returns start (3,), above ground, and direction (3,), unit, of a shot towards a pixel."""
        camera = present_camera()
        distance = float(np.linalg.norm(camera.centre - camera.eye))
        begin = self.point_at(pixel, SHOT_BEGIN * distance)
        ray = (begin - camera.eye) / np.linalg.norm(begin - camera.eye)
        begin[1] = max(begin[1], 0.05 * self.size)
        return begin, ray

    def pixels_of(self, points):
        """Pixels (n, 2) at which points (n, 3) are seen; NaN behind the camera."""
        return present_camera().pixels(points, ps.get_window_size())

    def outline(self, body):
        """Pixels (k, 2) around a body, which is convex; none behind the camera."""
        pixels = self.pixels_of(self.vertices_of(body))
        if not np.isfinite(pixels).all():
            return np.zeros((0, 2))
        return pixels[ConvexHull(pixels, "QJ").vertices]

    def draw_marks(self, ink):
        """Draws overlays on top, and the selected body. ink : see `rbs.appearance.pixels`"""
        for one in self.overlays.onTop.values():
            begins = self.pixels_of(one.points)
            if isinstance(one, Arrows):
                draw_arrows(ink, begins, self.pixels_of(one.points + one.vectors), one.colour)
            else:
                draw_lines(ink, begins[one.edges], one.colour)
        bodies = [] if self.highlight is None else self.highlight.bodies
        outlined = [(body, colours.BOX_COLOUR) for body in bodies]
        if self.picked is not None:
            outlined.append((self.picked, colours.PICKED_COLOUR))
            draw_dot(ink, self.pixels_of(self.picked_point())[0], colours.MARK_COLOUR)
        for body, colour in outlined:
            outline = self.outline(body)
            draw_lines(ink, np.stack([outline, np.roll(outline, 1, axis=0)], axis=1), colour)


class SceneLines:
    """Lines in Polyscope, which bodies hide, of a constant width in pixels."""

    def __init__(self):
        self._drawn, self._seenFrom = {}, None  # ends (n, 3) and width by name

    def draw(self, name, nodes, edges, colour, width):
        """Draws lines between nodes (n, 3), edges (m, 2), replacing those of this name.

        colour : of all, or (m, 3); width : in pixels, which takes effect with `resize`
        """
        if not len(edges):
            self.remove(name)
            return
        ends = nodes[edges.ravel()]
        pairs = np.arange(len(ends)).reshape(-1, 2)
        lines = ps.register_curve_network(name, ends, pairs, material="flat")
        colour = np.broadcast_to(colour, (len(edges), 3))
        lines.add_color_quantity("colour", colour, "edges", enabled=True)
        lines.add_scalar_quantity("radius", np.zeros(len(ends)))
        lines.set_node_radius_quantity("radius", autoscale=False)
        self._drawn[name], self._seenFrom = (ends, width), None

    def remove(self, name):
        """Removes the lines of this name, if any."""
        self._drawn.pop(name, None)
        ps.remove_curve_network(name, error_if_absent=False)
        ps.request_redraw()  # which Polyscope does not do itself here

    def resize(self, camera, height):
        """Gives all lines their width, as seen by a `Camera` in a picture of this height."""
        seenFrom = camera.matrix.tobytes(), height
        if seenFrom == self._seenFrom:  # Polyscope would draw everything again
            return
        self._seenFrom = seenFrom
        scale = 0.5 * max(1.0, height / USUAL_HEIGHT) * camera.pixel_angle((0, height))
        for name, (ends, width) in self._drawn.items():
            radii = np.maximum(width * scale * camera.depths(ends), LEAST_RADIUS)
            values = ps.get_curve_network(name).get_quantity_buffer("radius", "values")
            values.update_data(radii.astype(np.float32))
