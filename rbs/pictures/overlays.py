"""Overlays: contacts, impulses, velocities, boxes and trails.

Each is declared once, by `@overlay` above the method that makes it. Those at or within bodies are
drawn on top of the picture, by `SceneView.draw_marks`, because bodies would hide them; the others
are `SceneLines`. The command line lists them without Polyscope.
"""

import math
from typing import NamedTuple

import numpy as np

from rbs.appearance import colours
from rbs.appearance.drawables import Arrows, Lines, box_lines, grid_cells
from rbs.scenes.messages import measured
from rbs.stepping.meshes import Snapshot

# Length of the longest impulse's arrow, relative to the scene's size; its limit, relative to the
# median body, so that arrows do not cover each other; length of normals, relative to this arrow.
LONGEST_IMPULSE = 0.1
IMPULSE_OF_BODY = 0.5
NORMAL_LENGTH = 0.5
# Time in seconds whose displacement is drawn as the velocity. More lengthens the arrows.
VELOCITY_SECONDS = 0.5
# Length of a trail in frames, and largest number of trails. If there are more bodies, every second
# one has a trail, or every third, and so on.
TRAIL_LENGTH = 40
MOST_TRAILS = 30
# Largest number of boxes and cells drawn, because their lines take time.
MOST_BOXES = 200
# Width of lines in pixels, in a picture of the usual height, and of constraints.
LINE_WIDTH, CONSTRAINT_WIDTH = 1.6, 2.6
# Kinds of constraints, in the order of CONSTRAINT_COLOURS.
CONSTRAINT_KINDS = ("slack", "taut", "exceeded")


class Overlay(NamedTuple):
    """An overlay.

    shows : what it shows, for the tooltip; ofContacts : whether it needs contacts
    legend, paint : functions of the `Overlays`, which return its row (text, (r, g, b)) of the
        legend, and what to draw: `Arrows`, or `Lines`, which bodies hide
    """

    shows: str
    legend: object
    paint: object
    ofContacts: bool


# All overlays, by name.
OVERLAYS = {}


def overlay(name, shows, legend, ofContacts=False):
    """Declares the decorated method as the `paint` of an Overlay. legend : its row, or function"""

    def declare(paint):
        row = legend if callable(legend) else lambda overlays: legend
        OVERLAYS[name] = Overlay(shows, row, paint, ofContacts)
        return paint

    return declare


class Overlays:
    """Overlays of a `SceneView`.

    onTop : what is drawn on top of the picture, by name of the overlay: Arrows or Lines
    lines : `SceneLines`, among the bodies; longestArrow : length of the longest impulse, in metres
    """

    def __init__(self, view, lines):
        self._view, self.onTop, self.lines = view, {}, lines

    def restart(self, size, bodySize):
        """Forgets all steps. size, bodySize : of the scene and of a typical body, in metres"""
        self.longestArrow = min(LONGEST_IMPULSE * size, IMPULSE_OF_BODY * bodySize)
        self.forget_steps()
        for name in OVERLAYS:
            self.lines.remove(name)

    def forget_steps(self):
        """Forgets the trails of earlier steps."""
        self._trail, self._trailStep = [], None

    def remove(self, name):
        """Removes an overlay, and restarts the trails."""
        self.lines.remove(name)
        self.onTop.pop(name, None)
        self._trail = []

    def refresh(self, vertices):
        """Draws the visible overlays. vertices : (V, 3), of all bodies"""
        self.onTop = {}
        if self.needContacts:
            self._find_contacts()
        self._draw_constraints(vertices)
        for name, one in OVERLAYS.items():
            if name not in self._view.shown:
                continue
            drawn = one.paint(self)
            if isinstance(drawn, Lines):
                self.lines.draw(name, *drawn, LINE_WIDTH)
            else:
                self.onTop[name] = drawn
        if (highlight := self._view.highlight) is not None:
            for name, (point, arrow, colour) in highlight.arrows.items():
                self.onTop[name] = Arrows(point[None], arrow[None], colour)
        if (beside := self._view.simulation.beside) is not None:
            edges = self._view.surface.edges_of_free(beside.ours.meshes)
            self.onTop["ghosts"] = Lines(*edges, colours.GHOST_COLOUR)

    @property
    def needContacts(self):
        """Whether a visible overlay needs the contacts of the last step."""
        return any(OVERLAYS[name].ofContacts for name in OVERLAYS.keys() & self._view.shown)

    def meanings(self):
        """Returns the legend of what is shown: rows (text, (r, g, b))."""
        error = self._view.simulation.reportError
        kinds = zip(CONSTRAINT_KINDS, map(tuple, colours.CONSTRAINT_COLOURS), strict=True)
        rows = [(f"constraint {kind}", colour) for kind, colour in kinds if self._hasConstraints]
        rows += [one.legend(self) for name, one in OVERLAYS.items() if name in self._view.shown]
        if "ghosts" in self.onTop:
            rows.append(("reference solution", colours.GHOST_COLOUR))
        if error and self.needContacts:
            rows.append((f"contacts unknown: {error}", colours.NORMAL_COLOUR))
        return rows

    def _draw_constraints(self, vertices):
        if not self._hasConstraints:
            return self.lines.remove("constraints")
        lines = self._view.constraintLines
        colour = colours.CONSTRAINT_COLOURS[lines.kinds(vertices)]
        self.lines.draw("constraints", vertices, lines.ends, colour, CONSTRAINT_WIDTH)

    @property
    def _hasConstraints(self):
        simulation = self._view.simulation
        return bool(simulation.settings.enforceConstraints and simulation.constraints)

    def _find_contacts(self):
        # at their present places: they move with body 1
        report, meshes = self._view.simulation.report, self._view.simulation.meshes
        self._contacts = [] if report is None else report.contacts
        points = [meshes[c.body1].position[0] + c.arm for c in self._contacts]
        self._contactPoints = np.array(points).reshape(-1, 3)
        self._contactNormals = np.array([c.normal for c in self._contacts]).reshape(-1, 3)

    @overlay(
        "contacts",
        "Contact points, and normals towards the body listed first",
        ("contact normal (on the body listed first)", colours.NORMAL_COLOUR),
        ofContacts=True,
    )
    def _normals(self):
        arrows = -NORMAL_LENGTH * self.longestArrow * self._contactNormals
        return Arrows(self._contactPoints, arrows, colours.NORMAL_COLOUR)

    def _scaled(self, arrows):
        longest = np.linalg.norm(arrows, axis=1).max(initial=0.0)
        return arrows * (self.longestArrow / longest if longest > 0.0 else 0.0)

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
        impulses = np.array([c.impulse for c in self._contacts])[:, None]
        # body 1 receives the opposite of the impulse on body 2
        arrows = self._scaled(-impulses * self._contactNormals)
        return Arrows(self._contactPoints, arrows, colours.IMPULSE_COLOUR)

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
        return Arrows(points, arrows, colours.FRICTION_COLOUR)

    def _velocity_legend(self):
        text = f"velocity (the distance covered in {VELOCITY_SECONDS:g} s)"
        if self._view.simulation.settings.ground:
            speed = self._view.squareSide / VELOCITY_SECONDS
            text = f"velocity (one floor square = {speed:g} m/s)"
        return text, colours.VELOCITY_COLOUR

    @overlay(
        "velocities",
        f"Velocity of each centre: the distance covered in {VELOCITY_SECONDS:g} s",
        _velocity_legend,
    )
    def _velocities(self):
        columns = Snapshot.of(self._view.simulation.meshes)
        arrows = VELOCITY_SECONDS * columns["linVelocity"].T
        return Arrows(self._view.poses[:3].T, arrows, colours.VELOCITY_COLOUR)

    @overlay(
        "bounding boxes",
        f"Axis-aligned bounding boxes of the first {MOST_BOXES} bodies",
        ("bounding box", colours.BOX_COLOUR),
    )
    def _boxes(self):
        low, high = (side[:MOST_BOXES] for side in self._view.boxes())
        return Lines(*box_lines(low, high), colours.BOX_COLOUR)

    @overlay(
        "grid cells",
        f"Cells of the broad phase that contain bodies, up to {MOST_BOXES} columns",
        ("grid cell of the broad phase", colours.CELL_COLOUR),
    )
    def _cells(self):
        low, high = grid_cells(*self._view.boxes())
        low, high = low[:MOST_BOXES], high[:MOST_BOXES]
        return Lines(*box_lines(low, high), colours.CELL_COLOUR)

    @overlay(
        "trails",
        f"Paths of up to {MOST_TRAILS} bodies over the last {TRAIL_LENGTH} frames",
        ("path of a centre of mass", colours.TRAIL_COLOUR),
    )
    def _trails(self):
        """They restart after going back, and when a body is fixed or freed."""
        step = self._view.simulation.stepCount
        moving = [mesh.position[0] for mesh in self._view.simulation.meshes if not mesh.isFixed]
        places = np.reshape(moving[:: math.ceil(len(moving) / MOST_TRAILS) or 1], (-1, 3))
        if not self._trail or step < self._trailStep or places.shape != self._trail[-1].shape:
            self._trail, self._trailStep = [], step - 1
        if step > self._trailStep:
            self._trail, self._trailStep = [*self._trail, places][-TRAIL_LENGTH:], step
        nodes = np.array(self._trail)  # (times, bodies, 3)
        index = np.arange(nodes[..., 0].size).reshape(nodes.shape[:2])
        edges = np.stack([index[:-1], index[1:]], axis=-1).reshape(-1, 2)
        return Lines(nodes.reshape(-1, 3), edges, colours.TRAIL_COLOUR)
