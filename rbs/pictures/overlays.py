"""Overlays in Polyscope: contacts, impulses, velocities, boxes and trails.

Reading order: `Overlays`; the painter and the legend of each overlay; arrows and lines.
"""

import math
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import polyscope as ps

from rbs.appearance.colours import (
    BOX_COLOUR,
    CONSTRAINT_COLOURS,
    FRICTION_COLOUR,
    GHOST_COLOUR,
    IMPULSE_COLOUR,
    NORMAL_COLOUR,
    RESTING_COLOUR,
    TRAIL_COLOUR,
    VELOCITY_COLOUR,
)
from rbs.appearance.drawables import box_lines, contact_patches, grid_cells, surface_points
from rbs.scenes.messages import measured
from rbs.stepping.bodies import state_columns

# Overlays that show the contacts of the last steps.
CONTACT_OVERLAYS = frozenset({"contacts", "impulses", "friction impulses"})
# Overlays at or within bodies: drawn on top of the window's picture; pictures show them through the
# bodies.
WITHIN_BODIES = CONTACT_OVERLAYS | {"velocities"}
# Length of the longest impulse, relative to the scene's size; its limit, relative to the median
# body, so that arrows do not cover each other; and length of contact normals, relative to it.
LONGEST_IMPULSE = 0.1
IMPULSE_OF_BODY = 0.5
NORMAL_LENGTH = 0.5
# Number of steps for which a contact stays visible. More smears motion; less hides brief contacts.
HELD_CONTACT_STEPS = 5
# Time in seconds whose displacement is drawn as the velocity. More lengthens the arrows.
VELOCITY_SECONDS = 0.5
# Half the width of contact outlines, relative to the scene's size.
PATCH_RADIUS = 1.6e-3
# Length of a trail in frames, and largest number of trails. If there are more bodies, every second
# one has a trail, or every third, and so on.
TRAIL_LENGTH = 40
MOST_TRAILS = 30
# Largest number of steps between two frames of a trail. More counts as a jump in time.
LONGEST_TRAIL_STEP = 60
# Largest number of boxes and cells drawn, because their lines take time.
MOST_BOXES = 200
# Half the widths of arrows, points and lines, relative to the scene's size.
ARROW_RADIUS = 3e-3
POINT_RADIUS = 4e-3
LINE_RADIUS = 8e-4
# Metres; a coordinate beyond all that the camera sees.
OUT_OF_SIGHT = -1e9
# What each overlay shows.
EXPLAINED = {
    "contacts": "Contact points, and normals towards the body listed first. A recording makes its "
    "steps again for them, with the soft step up to 100 after a jump",
    "impulses": "Normal impulses, the pushes at contacts, on the body listed first, relative to "
    "the largest one",
    "friction impulses": "Friction impulses on the body listed first",
    "velocities": f"Velocity of each centre: the distance covered in {VELOCITY_SECONDS:g} s",
    "bounding boxes": f"Axis-aligned bounding boxes of the first {MOST_BOXES} bodies",
    "grid cells": f"Cells of the broad phase that contain bodies, up to {MOST_BOXES} columns",
    "trails": f"Paths of up to {MOST_TRAILS} bodies over the last {TRAIL_LENGTH} frames",
}


class Overlays:
    """Overlays of a `SceneView`.

    surface : `LitSurface` of the bodies
    onTop : of the overlays WITHIN_BODIES, by name: list of (`draw_arrows` or `draw_lines`, its
        arguments after the name)
    memory : their data from earlier steps: longestArrow in metres, heldContacts, trail and
        trailStep; it may come from another view
    """

    def __init__(self, view):
        self._view = view
        self.memory, self.onTop = None, {}

    def restart(self, size, bodySize):
        """Forgets all steps. size, bodySize : of the scene and of a typical body, in metres"""
        self.memory = SimpleNamespace(
            longestArrow=min(LONGEST_IMPULSE * size, IMPULSE_OF_BODY * bodySize),
            trail=[],
            trailStep=None,
            heldContacts={},  # step -> its contacts
        )

    def remove(self, name):
        """Removes an overlay, and restarts the trails."""
        remove_overlay(name)
        self.onTop.pop(name, None)
        self.memory.trail = []

    @contextmanager
    def in_picture(self):
        """Draws all overlays in Polyscope's picture within the `with` block."""
        self._draw_within(True)
        yield
        self._draw_within(self._view.callback is None)

    def _draw_within(self, isInPicture):
        for name, parts in self.onTop.items():
            if not (parts and isInPicture):
                remove_overlay(name)
            for draw, arguments in parts if isInPicture else ():
                draw(name, *arguments)

    def refresh(self, vertices):
        """Draws the visible overlays. vertices : (V, 3), of all bodies"""
        shown = self._view.shown
        if "trails" in shown:
            self._extend_trails()
        if CONTACT_OVERLAYS & shown:
            self._find_contacts()
        arrows = {} if self._view.highlight is None else self._view.highlight.arrows
        self.onTop = {}
        for name, paint in _PAINTERS.items():
            if name in shown:
                paint(self, name, vertices)
        for name, (point, arrow, colour) in arrows.items():
            self.onTop[name] = [(draw_arrows, (point[None], arrow[None], colour, ARROW_RADIUS))]
        if (beside := self._view.simulation.beside) is not None:
            ghosts = self.surface.edges_of_free(beside.ours.meshes)
            self.onTop["ghosts"] = [(draw_lines, (*ghosts, GHOST_COLOUR, LINE_RADIUS))]
        self._draw_within(self._view.callback is None)

    def meanings(self):
        """Returns the legend of the visible overlays: rows (text, (r, g, b))."""
        shown, error = self._view.shown, self._view.simulation.reportError
        rows = [(text(self), colour) for name, (text, colour) in _MEANINGS.items() if name in shown]
        if self._view.simulation.beside is not None:
            rows.append(("our bodies beside these", GHOST_COLOUR))
        if "contacts" in shown and self._isAtRest():
            rows[0] = f"last {rows[0][0]}", RESTING_COLOUR
        if error and CONTACT_OVERLAYS & shown:
            rows.append((f"contacts unknown: {error}", NORMAL_COLOUR))
        return rows

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

    def _draw_contacts(self, name, vertices):
        """Draws each pair's points with their outline, and one normal from their middle."""
        contacts, points = self._contacts, self._contactPoints
        self.onTop[name] = []
        if contacts:
            edges, middles, normals = contact_patches(
                np.array([(c.body1, c.body2) for c in contacts]),
                points,
                np.array([c.normal for c in contacts]),
            )
            arrows = -NORMAL_LENGTH * self.memory.longestArrow * normals
            colour = RESTING_COLOUR if self._isAtRest() else NORMAL_COLOUR
            self.onTop[name] = [
                (draw_arrows, (middles, arrows, colour, ARROW_RADIUS)),
                (draw_lines, (points, edges, colour, PATCH_RADIUS)),
            ]

    def _isAtRest(self):
        """Whether there are contacts, all of them of sleeping bodies."""
        report = self._view.simulation.report
        if report is None or not report.hasSleepers or not self._contacts:
            return False
        return all(report.isAsleep[contact.body1] for contact in self._contacts)

    def _draw_impulses(self, name, vertices):
        contacts, points = self._contacts, self._contactPoints
        normals = np.array([c.normal for c in contacts]).reshape(-1, 3)
        # body 1 receives the opposite of the impulse on body 2
        arrows = -normals * np.array([c.impulse for c in contacts]).reshape(-1, 1)
        # thicker than the normals, with which they coincide
        some = points, self._scaled(arrows), IMPULSE_COLOUR, 1.5 * ARROW_RADIUS
        self.onTop[name] = [(draw_arrows, some)]

    def _draw_friction(self, name, vertices):
        contacts, points = self._contacts, self._contactPoints
        arrows = -np.array([c.friction for c in contacts]).reshape(-1, 3)
        some = arrows.any(axis=1)
        some = points[some], self._scaled(arrows[some]), FRICTION_COLOUR, ARROW_RADIUS
        self.onTop[name] = [(draw_arrows, some)]

    def _scaled(self, arrows):
        longest = np.linalg.norm(arrows, axis=1).max(initial=0.0)
        return arrows * (self.memory.longestArrow / longest if longest > 0.0 else 0.0)

    def _impulse_scale(self, what, impulse):
        longest = max((math.hypot(*impulse(contact)) for contact in self._contacts), default=0.0)
        if longest == 0.0:
            return f"no {what} this step"
        return f"{what} (longest: {measured(longest, 'N s')})"

    def _velocity_scale(self):
        speed = self._view.squareSide / VELOCITY_SECONDS
        return f"velocity (one floor square = {speed:g} m/s)"

    def _draw_velocities(self, name, vertices):
        """Draws arrows from where the line from the centre of mass leaves the body."""
        view, columns = self._view, state_columns(self._view.simulation.meshes)
        velocities = columns["linVelocity"].T
        points = surface_points(
            vertices, view.faces, view.bodyOfFace, columns["position"].T, velocities
        )
        moves = velocities.any(axis=1)  # a fixed body has no velocity
        some = points[moves], VELOCITY_SECONDS * velocities[moves], VELOCITY_COLOUR, ARROW_RADIUS
        self.onTop[name] = [(draw_arrows, some)]

    def _draw_boxes(self, name, vertices):
        low, high = (side[:MOST_BOXES] for side in self._view.boxes(vertices))
        draw_lines(name, *box_lines(low, high), BOX_COLOUR)

    def _draw_cells(self, name, vertices):
        low, high = (side[:MOST_BOXES] for side in grid_cells(*self._view.boxes(vertices)))
        draw_lines(name, *box_lines(low, high), CONSTRAINT_COLOURS[2])

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

    def _draw_trails(self, name, vertices):
        if len({len(row) for row in self.memory.trail}) > 1:  # a body was fixed or freed
            self.memory.trail = self.memory.trail[-1:]
        nodes = np.array(self.memory.trail)  # (times, bodies, 3)
        index = np.arange(nodes[..., 0].size).reshape(nodes.shape[:2])
        edges = np.stack([index[:-1], index[1:]], axis=-1).reshape(-1, 2)
        draw_lines(name, nodes.reshape(-1, 3), edges, TRAIL_COLOUR)


# Painter of each overlay.
_PAINTERS = {
    "contacts": Overlays._draw_contacts,
    "impulses": Overlays._draw_impulses,
    "friction impulses": Overlays._draw_friction,
    "velocities": Overlays._draw_velocities,
    "bounding boxes": Overlays._draw_boxes,
    "grid cells": Overlays._draw_cells,
    "trails": Overlays._draw_trails,
}


# Legend text of each overlay, as a function of the Overlays, and its colour.
_MEANINGS = {
    "contacts": (lambda _: "contact area and normal (on the body listed first)", NORMAL_COLOUR),
    "impulses": (
        lambda overlays: overlays._impulse_scale("normal impulse", lambda one: [one.impulse]),
        IMPULSE_COLOUR,
    ),
    "friction impulses": (
        lambda overlays: overlays._impulse_scale(
            "friction impulse", lambda contact: contact.friction
        ),
        FRICTION_COLOUR,
    ),
    "velocities": (lambda overlays: overlays._velocity_scale(), VELOCITY_COLOUR),
    "bounding boxes": (lambda overlays: "bounding box", BOX_COLOUR),
    "grid cells": (lambda overlays: "grid cell of the broad phase", tuple(CONSTRAINT_COLOURS[2])),
    "trails": (lambda overlays: "path of a centre of mass", TRAIL_COLOUR),
}


def remove_overlay(name):
    """Removes the arrows or lines drawn under this name, if any."""
    ps.remove_point_cloud(name, error_if_absent=False)
    ps.remove_curve_network(name, error_if_absent=False)


def draw_arrows(name, points, arrows, colour, radius):
    """Draws points (m, 3) with arrows (m, 3) in metres, replacing those of this name."""
    points, arrows = _filled_up(points, OUT_OF_SIGHT), _filled_up(arrows, 0.0)
    if ps.has_point_cloud(name) and ps.get_point_cloud(name).n_points() == len(points):
        cloud = ps.get_point_cloud(name)
        cloud.update_point_positions(points)
        cloud.get_quantity_buffer("arrows", "values").update_data(arrows)
        return
    ps.remove_point_cloud(name, error_if_absent=False)
    if len(points):
        options = {"color": colour, "material": "flat"}
        cloud = ps.register_point_cloud(name, points, radius=POINT_RADIUS, **options)
        options |= {"vectortype": "ambient", "radius": radius, "enabled": True}
        cloud.add_vector_quantity("arrows", arrows, **options)


def draw_lines(name, nodes, edges, colour, radius=LINE_RADIUS):
    """Draws lines between nodes (n, 3), edges (m, 2), replacing those of this name."""
    ends = _filled_up(nodes[edges.ravel()], OUT_OF_SIGHT)
    if ps.has_curve_network(name) and ps.get_curve_network(name).n_nodes() == len(ends):
        ps.get_curve_network(name).update_node_positions(ends)
        return
    ps.remove_curve_network(name, error_if_absent=False)
    if len(ends):
        edges = np.arange(len(ends)).reshape(-1, 2)
        ps.register_curve_network(name, ends, edges, radius=radius, color=colour, material="flat")


def _filled_up(rows, value):
    """Returns rows (m, 3) and more of one value, up to a power of two.

    What is drawn keeps its number of rows as long as possible, as registering it takes much longer
    than moving it.
    """
    count = 1 << (len(rows) - 1).bit_length() if len(rows) else 0
    return np.concatenate([rows, np.full((count - len(rows), 3), value)])
