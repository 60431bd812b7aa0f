"""What is drawn over the bodies: contacts, impulses, velocities, boxes and trails, in Polyscope.

Polyscope is imported inside the functions that use it. From the top: `Overlays`; what draws and
explains each of them; arrows and lines.
"""

import math
from types import SimpleNamespace

import numpy as np

from rbs.appearance.colours import (
    BOX_COLOUR,
    CONSTRAINT_COLOURS,
    FRICTION_COLOUR,
    IMPULSE_COLOUR,
    NORMAL_COLOUR,
    TRAIL_COLOUR,
    VELOCITY_COLOUR,
)
from rbs.appearance.drawables import box_lines, contact_patches, grid_cells, surface_points

# What shows the contacts of the last steps.
CONTACT_OVERLAYS = frozenset({"contacts", "impulses", "friction impulses"})
# The longest impulse on screen, relative to the scene's size, and relative to the body of medium
# size at most, so that arrows do not cover each other; and every contact's normal, relative to it.
LONGEST_IMPULSE = 0.1
IMPULSE_OF_BODY = 0.5
NORMAL_LENGTH = 0.5
# Steps for which a contact is shown: a tenth of a second, with the usual time step.
HELD_CONTACT_STEPS = 5
# A velocity is drawn as the way that it leads in this time, in seconds.
VELOCITY_SECONDS = 0.5
# Half the width of the outlines of contacts, relative to the scene's size.
PATCH_RADIUS = 1.6e-3
# Pictures back that a trail goes, and the most bodies that have one: every second body has where
# there are up to twice as many, and so on.
TRAIL_LENGTH = 40
MOST_TRAILS = 30
# A trail goes on over as many steps between two pictures; more is a jump to another time.
LONGEST_TRAIL_STEP = 60
# The most boxes, and cells, that are drawn, for the time that their lines take.
MOST_BOXES = 200
# Half the widths of arrows, points and lines, relative to the scene's size.
ARROW_RADIUS = 3e-3
POINT_RADIUS = 4e-3
LINE_RADIUS = 8e-4


class Overlays:
    """The overlays of a `SceneView`.

    memory : what they show of former steps, attributes longestArrow in metres, heldContacts, trail
        and trailStep; it may come from another view
    """

    def __init__(self, view):
        self._view = view
        self.memory = None

    def restart(self, size, bodySize):
        """Forgets all steps. size, bodySize : of the scene and of a usual body, in metres"""
        self.memory = SimpleNamespace(
            longestArrow=min(LONGEST_IMPULSE * size, IMPULSE_OF_BODY * bodySize),
            trail=[],
            trailStep=None,
            heldContacts={},  # step -> its contacts
        )

    def remove(self, name):
        """Removes an overlay; a trail will begin anew."""
        remove_overlay(name)
        self.memory.trail = []

    def refresh(self, vertices):
        """Draws the overlays that are shown. vertices (V, 3) : of all bodies"""
        shown = self._view.shown
        if "trails" in shown:
            self._extend_trails()
        if CONTACT_OVERLAYS & shown:
            self._find_contacts()
        for name, paint in _PAINTERS.items():
            if name in shown:
                paint(self, name, vertices)

    def meanings(self):
        """The legend of the overlays that are shown: rows (text, (r, g, b))."""
        shown = self._view.shown
        return [(text(self), colour) for name, (text, colour) in _MEANINGS.items() if name in shown]

    def _find_contacts(self):
        """Finds the contacts of the last steps, and where they are now: they go with body 1.

        Of each pair of bodies, those of its last step. A bounce is over before it is seen.
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
        """Each pair's points with their outline, and one normal from the middle of them."""
        contacts, points = self._contacts, self._contactPoints
        remove_overlay(name)
        if contacts:
            edges, middles, normals = contact_patches(
                np.array([(c.body1, c.body2) for c in contacts]),
                points,
                np.array([c.normal for c in contacts]),
            )
            arrows = -NORMAL_LENGTH * self.memory.longestArrow * normals
            draw_arrows(name, middles, arrows, NORMAL_COLOUR)
            draw_lines(name, points, edges, NORMAL_COLOUR, PATCH_RADIUS)

    def _contact_meaning(self):
        report = self._view.simulation.report
        isSome = report is not None and report.hasSleepers
        return f"contact manifold{', of bodies awake' if isSome else ''}; normal, towards body 1"

    def _draw_impulses(self, name, vertices):
        contacts, points = self._contacts, self._contactPoints
        normals = np.array([c.normal for c in contacts]).reshape(-1, 3)
        # Body 1 receives the opposite of what the contact gives to body 2.
        arrows = -normals * np.array([c.impulse for c in contacts]).reshape(-1, 1)
        # Thicker than the normals, along which they run.
        draw_arrows(name, points, self._scaled(arrows), IMPULSE_COLOUR, 1.5 * ARROW_RADIUS)

    def _draw_friction(self, name, vertices):
        contacts, points = self._contacts, self._contactPoints
        arrows = -np.array([c.friction for c in contacts]).reshape(-1, 3)
        some = arrows.any(axis=1)
        draw_arrows(name, points[some], self._scaled(arrows[some]), FRICTION_COLOUR)

    def _scaled(self, arrows):
        longest = np.linalg.norm(arrows, axis=1).max(initial=0.0)
        return arrows * (self.memory.longestArrow / longest if longest > 0.0 else 0.0)

    def _impulse_scale(self, what, impulse):
        longest = max((math.hypot(*impulse(contact)) for contact in self._contacts), default=0.0)
        if longest == 0.0:
            return f"no {what} this step"
        return f"{what}; the longest is {longest:.2g} N s"

    def _velocity_scale(self):
        speed = self._view.squareSide / VELOCITY_SECONDS
        return f"velocity; as long as a square is {speed:g} m/s"

    def _draw_velocities(self, name, vertices):
        """Arrows that begin where the line from the centre of mass leaves the body."""
        view, meshes = self._view, self._view.simulation.meshes
        centres = np.concatenate([mesh.position for mesh in meshes])
        velocities = np.concatenate([mesh.linVelocity for mesh in meshes])
        points = surface_points(vertices, view.faces, view.bodyOfFace, centres, velocities)
        moves = velocities.any(axis=1) & [not mesh.isFixed for mesh in meshes]
        draw_arrows(name, points[moves], VELOCITY_SECONDS * velocities[moves], VELOCITY_COLOUR)

    def _draw_boxes(self, name, vertices):
        low, high = (side[:MOST_BOXES] for side in self._view.boxes(vertices))
        draw_lines(name, *box_lines(low, high), BOX_COLOUR)

    def _draw_cells(self, name, vertices):
        low, high = (side[:MOST_BOXES] for side in grid_cells(*self._view.boxes(vertices)))
        draw_lines(name, *box_lines(low, high), CONSTRAINT_COLOURS[2])

    def _extend_trails(self):
        """Adds the present positions to the trails; after a jump in time, they begin anew."""
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


# What draws each overlay.
_PAINTERS = {
    "contacts": Overlays._draw_contacts,
    "impulses": Overlays._draw_impulses,
    "friction impulses": Overlays._draw_friction,
    "velocities": Overlays._draw_velocities,
    "bounding boxes": Overlays._draw_boxes,
    "grid cells": Overlays._draw_cells,
    "trails": Overlays._draw_trails,
}


# What the legend says of each overlay, given the Overlays, and its colour. Lengths in the picture
# are told by the ground's squares.
_MEANINGS = {
    "contacts": (lambda overlays: overlays._contact_meaning(), NORMAL_COLOUR),
    "impulses": (
        lambda overlays: overlays._impulse_scale(
            "normal impulse", lambda contact: [contact.impulse]
        ),
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
    """Removes what `draw_arrows` or `draw_lines` has drawn under this name, if anything."""
    import polyscope as ps

    ps.remove_point_cloud(name, error_if_absent=False)
    ps.remove_curve_network(name, error_if_absent=False)


def draw_arrows(name, points, arrows, colour, radius=ARROW_RADIUS):
    """Points (m, 3) with arrows (m, 3) in metres, in place of the last ones of this name."""
    import polyscope as ps

    ps.remove_point_cloud(name, error_if_absent=False)
    if len(points):
        cloud = ps.register_point_cloud(
            name, points, color=colour, radius=POINT_RADIUS, material="flat"
        )
        cloud.add_vector_quantity(
            "arrows",
            arrows,
            vectortype="ambient",
            radius=radius,
            color=colour,
            material="flat",
            enabled=True,
        )


def draw_lines(name, nodes, edges, colour, radius=LINE_RADIUS):
    """Lines between nodes (n, 3), edges (m, 2), in place of the last ones of this name."""
    import polyscope as ps

    ps.remove_curve_network(name, error_if_absent=False)
    if len(edges):
        ps.register_curve_network(name, nodes, edges, radius=radius, color=colour, material="flat")
