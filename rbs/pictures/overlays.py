"""Overlays: contacts, impulses, velocities, boxes and trails.

Each is declared once, by `@overlay` above the method that makes it. Those at or within bodies are
drawn on top of the picture, by `SceneView.draw_marks`, because bodies would hide them; the others
are lines in Polyscope, which is imported inside the functions that use it: the command line lists
the overlays without it.
"""

import math
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from rbs.appearance import colours
from rbs.appearance.camera import USUAL_HEIGHT
from rbs.appearance.drawables import (
    Arrows,
    Lines,
    box_lines,
    contact_patches,
    grid_cells,
    surface_points,
)
from rbs.scenes.messages import measured
from rbs.stepping.meshes import Snapshot

# Length of the longest impulse's arrow, relative to the scene's size; its limit, relative to the
# median body, so that arrows do not cover each other; length of normals, relative to this arrow.
LONGEST_IMPULSE = 0.1
IMPULSE_OF_BODY = 0.5
NORMAL_LENGTH = 0.5
# Number of steps for which a contact stays visible. More smears motion; less hides brief contacts.
HELD_CONTACT_STEPS = 5
# Time in seconds whose displacement is drawn as the velocity. More lengthens the arrows.
VELOCITY_SECONDS = 0.5
# Length of a trail in frames, and largest number of trails. If there are more bodies, every second
# one has a trail, or every third, and so on.
TRAIL_LENGTH = 40
MOST_TRAILS = 30
# Largest number of steps between two frames of a trail. More counts as a jump in time.
LONGEST_TRAIL_STEP = 60
# Largest number of boxes and cells drawn, because their lines take time.
MOST_BOXES = 200
# Width of lines in pixels, in a picture of the usual height, and of constraints.
LINE_WIDTH, CONSTRAINT_WIDTH = 1.6, 2.6
# Updates of the picture for which the legend keeps what has just vanished.
KEPT_IN_LEGEND = 40
# Metres: a coordinate beyond all that the camera sees, and the radius of lines there.
OUT_OF_SIGHT, LEAST_RADIUS = -1e9, 1e-6


class Overlay(NamedTuple):
    """An overlay.

    shows : what it shows, for the tooltip; ofContacts : whether it needs the last contacts
    legend, paint : functions of the `Overlays`, which return its row (text, (r, g, b)) of the
        legend, and what to draw: a list of `Arrows` and `Lines`
    isInScene : whether paint returns one `Lines`, which bodies may hide, instead of such a list
    """

    shows: str
    legend: object
    paint: object
    ofContacts: bool
    isInScene: bool


# All overlays, by name.
OVERLAYS = {}


def overlay(name, shows, legend, ofContacts=False, isInScene=False):
    """Declares the decorated method as the `paint` of an Overlay. legend : its row, or function"""

    def declare(paint):
        row = legend if callable(legend) else lambda overlays: legend
        OVERLAYS[name] = Overlay(shows, row, paint, ofContacts, isInScene)
        return paint

    return declare


class Overlays:
    """Overlays of a `SceneView`.

    onTop : what is drawn on top of the picture, by name of the overlay: lists of Arrows and Lines
    lines : `SceneLines`, among the bodies
    memory : data from earlier steps: longestArrow in metres, heldContacts, trail and trailStep
    """

    def __init__(self, view):
        self._view = view
        self.memory, self.onTop, self.lines = None, {}, SceneLines()
        # number of updates, and the last one in which each row of the legend was seen
        self._updates, self._seen = 0, {}

    def restart(self, size, bodySize):
        """Forgets all steps. size, bodySize : of the scene and of a typical body, in metres"""
        self._seen = {}
        self.memory = SimpleNamespace(
            longestArrow=min(LONGEST_IMPULSE * size, IMPULSE_OF_BODY * bodySize),
            trail=[],
            trailStep=None,
            heldContacts={},  # step -> its contacts
        )

    def remove(self, name):
        """Removes an overlay, and restarts the trails."""
        self.lines.remove(name)
        self.onTop.pop(name, None)
        self.memory.trail = []

    def refresh(self, vertices):
        """Draws the visible overlays. vertices : (V, 3), of all bodies"""
        self._vertices, self._updates = vertices, self._updates + 1
        if self.needContacts:
            self._find_contacts()
        self.onTop = {}
        self._draw_constraints()
        for name, one in OVERLAYS.items():
            if name in self._view.shown and one.isInScene:
                parts = [one.paint(self)]
                self.lines.draw(name, *parts[0], LINE_WIDTH)
            elif name in self._view.shown:
                parts = self.onTop[name] = one.paint(self)
            else:
                continue
            if any(len(part[1]) for part in parts):
                self._seen[name] = self._updates
        if (highlight := self._view.highlight) is not None:
            for name, (point, arrow, colour) in highlight.arrows.items():
                self.onTop[name] = [Arrows(point[None], arrow[None], colour)]
        if ghosts := self._view.ghost_lines():
            self.onTop["ghosts"] = [Lines(*ghosts, colours.GHOST_COLOUR)]

    @property
    def needContacts(self):
        """Whether a visible overlay needs the contacts of the last steps."""
        return any(OVERLAYS[name].ofContacts for name in OVERLAYS.keys() & self._view.shown)

    def meanings(self):
        """Returns the legend of the visible overlays: rows (text, (r, g, b)).

        What has vanished a moment ago stays in it, or it would flicker.
        """
        error = self._view.simulation.reportError
        kinds = enumerate(("slack", "taut", "exceeded"))
        rows = [(f"constraint {k}", tuple(colours.CONSTRAINT_COLOURS[i])) for i, k in kinds]
        rows = [row for row in rows if self._is_recent(row[0])]
        rows += [o.legend(self) for name, o in OVERLAYS.items() if self._is_recent(name)]
        if "ghosts" in self.onTop:
            rows.append(("reference solution", colours.GHOST_COLOUR))
        if error and self.needContacts:
            rows.append((f"contacts unknown: {error}", colours.NORMAL_COLOUR))
        return rows

    def _is_recent(self, name):
        """Whether lines of this name are seen, or were a moment ago."""
        isShown = name in self._view.shown or name not in OVERLAYS
        return isShown and self._updates - self._seen.get(name, -math.inf) < KEPT_IN_LEGEND

    def _draw_constraints(self):
        """Draws the constraints, unless they are not enforced."""
        lines, settings = self._view.constraintLines, self._view.simulation.settings
        if not (settings.enforceConstraints and len(lines.ends)):
            self.lines.remove("constraints")
            self._seen = {name: k for name, k in self._seen.items() if name in OVERLAYS}
            return
        nodes, place = lines.nodes(self._vertices), lines.places(self._vertices)
        pairs = np.arange(len(nodes)).reshape(-1, 2)
        self.lines.draw("constraints", nodes, pairs, lines.colours(place), CONSTRAINT_WIDTH)
        for kind in np.unique(np.rint(place).astype(int)):
            self._seen[f"constraint {('slack', 'taut', 'exceeded')[kind]}"] = self._updates

    def _find_contacts(self):
        """Collects the contacts of the last steps at their present places; they move with body 1.

        For each pair of bodies, its latest contacts count. A bounce would be too brief to see.
        """
        report, step = self._view.simulation.report, self._view.simulation.stepCount
        if report is None:
            self.memory.heldContacts = {}
        else:
            self.memory.heldContacts[step] = report.contacts
        contacts, pairs = [], set()
        for other in sorted(self.memory.heldContacts, reverse=True):
            if not 0 <= step - other < HELD_CONTACT_STEPS:
                del self.memory.heldContacts[other]
                continue
            found = [c for c in self.memory.heldContacts[other] if (c.body1, c.body2) not in pairs]
            pairs |= {(c.body1, c.body2) for c in found}
            contacts += found
        positions = [self._view.simulation.meshes[c.body1].position[0] for c in contacts]
        arms = [contact.arm for contact in contacts]
        self._contacts = contacts
        self._contactPoints = np.array(positions).reshape(-1, 3) + np.array(arms).reshape(-1, 3)

    def _contact_legend(self):
        """Grey if all contacts are of bodies that sleep, which keep their last ones."""
        report = self._view.simulation.report
        isAtRest = report is not None and report.hasSleepers and bool(self._contacts)
        isAtRest = isAtRest and all(report.isAsleep[one.body1] for one in self._contacts)
        text = "last " * isAtRest + "contact area and normal (on the body listed first)"
        return text, colours.RESTING_COLOUR if isAtRest else colours.NORMAL_COLOUR

    @overlay(
        "contacts",
        "Contact points, and normals towards the body listed first. In a recording, steps are "
        "repeated to find them: with the soft step up to 100 after a jump",
        _contact_legend,
        ofContacts=True,
    )
    def _contact_areas(self):
        """Each pair's points with their outline, and one normal from their middle."""
        contacts, points = self._contacts, self._contactPoints
        if not contacts:
            return []
        edges, middles, normals = contact_patches(
            np.array([(c.body1, c.body2) for c in contacts]),
            points,
            np.array([c.normal for c in contacts]),
        )
        arrows = -NORMAL_LENGTH * self.memory.longestArrow * normals
        _, colour = self._contact_legend()
        return [Arrows(middles, arrows, colour), Lines(points, edges, colour)]

    def _scaled(self, arrows):
        longest = np.linalg.norm(arrows, axis=1).max(initial=0.0)
        return arrows * (self.memory.longestArrow / longest if longest > 0.0 else 0.0)

    def _impulse_scale(self, what, name):
        """Text of the legend for an attribute of contacts, whose values are numbers or vectors."""
        impulses = [np.linalg.norm(getattr(contact, name)) for contact in self._contacts]
        longest = max(impulses, default=0.0)
        if not longest:
            return f"no {what} this step"
        return f"{what} (longest: {measured(longest, 'N s')})"

    @overlay(
        "impulses",
        "Normal impulses, the pushes at contacts, on the body listed first, relative to the "
        "largest one",
        lambda self: (self._impulse_scale("normal impulse", "impulse"), colours.IMPULSE_COLOUR),
        ofContacts=True,
    )
    def _normal_impulses(self):
        normals = np.array([c.normal for c in self._contacts]).reshape(-1, 3)
        # body 1 receives the opposite of the impulse on body 2
        arrows = -normals * np.array([c.impulse for c in self._contacts]).reshape(-1, 1)
        return [Arrows(self._contactPoints, self._scaled(arrows), colours.IMPULSE_COLOUR)]

    @overlay(
        "friction impulses",
        "Friction impulses on the body listed first",
        lambda self: (self._impulse_scale("friction impulse", "friction"), colours.FRICTION_COLOUR),
        ofContacts=True,
    )
    def _friction_impulses(self):
        arrows = -np.array([c.friction for c in self._contacts]).reshape(-1, 3)
        some = arrows.any(axis=1)
        points, arrows = self._contactPoints[some], self._scaled(arrows[some])
        return [Arrows(points, arrows, colours.FRICTION_COLOUR)]

    def _velocity_legend(self):
        speed = self._view.squareSide / VELOCITY_SECONDS
        return f"velocity (one floor square = {speed:g} m/s)", colours.VELOCITY_COLOUR

    @overlay(
        "velocities",
        f"Velocity of each centre: the distance covered in {VELOCITY_SECONDS:g} s",
        _velocity_legend,
    )
    def _velocities(self):
        """Arrows that start at the surface, where the line from the centre of mass leaves it."""
        view, columns = self._view, Snapshot.of(self._view.simulation.meshes)
        places, ways = view.poses[:3].T, VELOCITY_SECONDS * columns["linVelocity"].T
        points = surface_points(self._vertices, view.faces, view.bodyOfFace, places, ways)
        moves = ways.any(axis=1)  # a fixed body has no velocity
        return [Arrows(points[moves], ways[moves], colours.VELOCITY_COLOUR)]

    @overlay(
        "bounding boxes",
        f"Axis-aligned bounding boxes of the first {MOST_BOXES} bodies",
        ("bounding box", colours.BOX_COLOUR),
        isInScene=True,
    )
    def _boxes(self):
        low, high = (side[:MOST_BOXES] for side in self._view.boxes())
        return Lines(*box_lines(low, high), colours.BOX_COLOUR)

    @overlay(
        "grid cells",
        f"Cells of the broad phase that contain bodies, up to {MOST_BOXES} columns",
        ("grid cell of the broad phase", colours.CELL_COLOUR),
        isInScene=True,
    )
    def _cells(self):
        low, high = grid_cells(*self._view.boxes())
        low, high = low[:MOST_BOXES], high[:MOST_BOXES]
        return Lines(*box_lines(low, high), colours.CELL_COLOUR)

    def _extend_trails(self):
        """Adds the present positions to the trails, which restart after a jump in time."""
        step = self._view.simulation.stepCount
        if self.memory.trail and step == self.memory.trailStep:
            return
        if self.memory.trail and not 0 < step - self.memory.trailStep <= LONGEST_TRAIL_STEP:
            self.memory.trail = []
        moving = [mesh for mesh in self._view.simulation.meshes if not mesh.isFixed]
        moving = moving[:: math.ceil(len(moving) / MOST_TRAILS) or 1]
        self.memory.trail.append(np.array([mesh.position[0] for mesh in moving]).reshape(-1, 3))
        self.memory.trail = self.memory.trail[-TRAIL_LENGTH:]
        self.memory.trailStep = step

    @overlay(
        "trails",
        f"Paths of up to {MOST_TRAILS} bodies over the last {TRAIL_LENGTH} frames",
        ("path of a centre of mass", colours.TRAIL_COLOUR),
        isInScene=True,
    )
    def _trails(self):
        self._extend_trails()
        if len({len(row) for row in self.memory.trail}) > 1:  # a body was fixed or freed
            self.memory.trail = self.memory.trail[-1:]
        nodes = np.array(self.memory.trail)  # (times, bodies, 3)
        index = np.arange(nodes[..., 0].size).reshape(nodes.shape[:2])
        edges = np.stack([index[:-1], index[1:]], axis=-1).reshape(-1, 2)
        return Lines(nodes.reshape(-1, 3), edges, colours.TRAIL_COLOUR)


class SceneLines:
    """Lines in Polyscope, which bodies hide, of a constant width in pixels."""

    def __init__(self):
        self._drawn = {}  # ends (n, 3) and width by name

    def draw(self, name, nodes, edges, colour, width):
        """Draws lines, see `draw_lines`, of a width in pixels; takes effect with `resize`."""
        self._drawn[name] = draw_lines(name, nodes, edges, colour), width

    def remove(self, name):
        """Removes the lines of this name, if any."""
        self._drawn.pop(name, None)
        remove_lines(name)

    def resize(self, camera, height):
        """Gives all lines their width, as seen by a `Camera` in a picture of this height."""
        import polyscope as ps

        scale = 0.5 * max(1.0, height / USUAL_HEIGHT) * camera.pixel_angle((0, height))
        for name, (ends, width) in self._drawn.items():
            if len(ends):
                radii = np.maximum(width * scale * camera.depths(ends), LEAST_RADIUS)
                radii[ends[:, 0] == OUT_OF_SIGHT] = LEAST_RADIUS
                values = ps.get_curve_network(name).get_quantity_buffer("radius", "values")
                values.update_data(radii.astype(np.float32))


def remove_lines(name):
    """Removes the lines drawn under this name, if any."""
    import polyscope as ps

    ps.remove_curve_network(name, error_if_absent=False)
    ps.request_redraw()  # which Polyscope does not do itself here


def draw_lines(name, nodes, edges, colour, radius=None):
    """Draws lines between nodes (n, 3), edges (m, 2), replacing those of this name.

    colour : of all, or (m, 3); radius : relative to the scene's size, or None if each end has its
        own, which `SceneLines` sets

    Registering lines takes much longer than moving them. Their number is therefore rounded up to a
    power of two, so that it rarely changes; the surplus ones lie out of sight. Returns all ends.
    """
    import polyscope as ps

    ends, colour = nodes[edges.ravel()], np.asarray(colour)
    count = 1 << (len(ends) - 1).bit_length() if len(ends) else 0
    ends = np.concatenate([ends, np.full((count - len(ends), 3), OUT_OF_SIGHT)])
    if not ps.has_curve_network(name) or ps.get_curve_network(name).n_nodes() != count:
        remove_lines(name)
        if not count:
            return ends
        pairs = np.arange(count).reshape(-1, 2)
        lines = ps.register_curve_network(name, ends, pairs, material="flat")
        if radius is not None:
            lines.set_radius(radius)
        if colour.ndim == 2:
            lines.add_color_quantity("colour", np.zeros((count // 2, 3)), "edges", enabled=True)
        if radius is None:
            lines.add_scalar_quantity("radius", np.zeros(count))
            lines.set_node_radius_quantity("radius", autoscale=False)
    lines = ps.get_curve_network(name)
    lines.update_node_positions(ends)
    if colour.ndim == 2:
        colour = np.concatenate([colour, np.zeros((count // 2 - len(colour), 3))])
        lines.get_quantity_buffer("colour", "colors").update_data(colour)
    else:
        lines.set_color(tuple(colour))
    return ends
