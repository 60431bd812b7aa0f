"""A step under glass: its events one by one, with arrows, what each did, and its formulas."""

import math
import re
from collections import Counter
from functools import partial

import numpy as np
import polyscope.imgui as psim

from rbs.appearance import colours
from rbs.appearance.colours import Highlight
from rbs.appearance.shading import poses_of
from rbs.glass.events import CONTACT_PARTS, Kind
from rbs.glass.mistakes import mistake_in
from rbs.glass.terms import IMPULSES, terms, unit, values
from rbs.glass.trace import NOTHING, deviations, heading, labels, shown
from rbs.scenes.messages import counted, measured
from rbs.stepping.reports import GROUND
from rbs.window import widgets
from rbs.window.marks import WindowInk
from rbs.window.widgets import scaled

# Most events in the list, around the present one, and the fewest lines of the list in view.
MOST_LISTED, LEAST_LINES = 200, 4
# First height of the panel, in pixels; greatest one, as a fraction of the picture's height; pixels
# between symbols.
PANEL_HEIGHT, MOST_SHARE, GAP = 272, 2 / 3, 8
# Number of listed differences from the reference, and of their digits.
MOST_DIFFERENCES, FEW_DIGITS = 3, 4
# Number of listed contacts of the selected body, those with the largest impulses.
LISTED_CONTACTS = 3
# Significant digits of numbers in formulas; symbols with more, since their difference is small.
DIGITS, FINE_DIGITS, FINE = 6, 9, ("‖p1−p2‖", "refValue")
# Colours of numbers, of a student's numbers that differ from the formula, and of units.
NUMBER_TEXT, WRONG_TEXT = (1.0, 0.85, 0.45, 1.0), (1.0, 0.45, 0.4, 1.0)
UNIT_TEXT = (0.65, 0.65, 0.65, 1.0)
# Length of velocities and impulses, relative to normals, which are the overlays' longest arrow.
VELOCITY_SHARE, IMPULSE_SHARE = 2.0, 1.6
# Arrows that are named at their middles; shifts, in lines, by which a name avoids others.
ARMS, LINES = ("r1", "r2"), (0.0, -1.0, 1.0, -2.0, 2.0)
# What several formulas have in common; r1 and r2 are those after the position correction.
K = "K = m1⁻¹ + m2⁻¹ + (r1×n)ᵀI1⁻¹(r1×n) + (r2×n)ᵀI2⁻¹(r2×n)"
U = "u = v1 + ω1 × r1 − ( v2 + ω2 × r2 )"
PUSHED = (
    "v1′ = v1 − j m1⁻¹ n; ω1′ = ω1 − j I1⁻¹(r1×n); v2′ = v2 + j m2⁻¹ n; ω2′ = ω2 + j I2⁻¹(r2×n)"
)
LEVERS = "r1 = p − COM1; r2 = p − COM2"
# The formulas of each kind, as the coursework writes them, with ′ for values after the event. Words
# between blanks have a value if they are symbols of `terms`.
FORMULAS = {
    Kind.FLIGHT: "v′ = v + g h; COM′ = COM + v′ h; q′ = exp( ½ h ω ) ◦ q , w first",
    Kind.CONTACT: "depth d; normal n , from 1 to 2; deepest point p",
    Kind.CORRECTION: "w1 = m1⁻¹ / ( m1⁻¹ + m2⁻¹ ); w2 = 1 − w1; COM1′ = COM1 − w1 d n; "
    "COM2′ = COM2 + w2 d n",
    Kind.IMPULSE: f"j = (1 + e ) u·n / K; {K}; {U}; {PUSHED}; {LEVERS}",
    Kind.FRICTION: "f = min( (u·t)/K , μj ) : the body result; "
    f"{K.replace('×n', '×t')}; u·t along t; {U}; {LEVERS}",
    Kind.CONSTRAINT: "C = ‖p1−p2‖ − refValue : result; COM1′ = COM1 − w1 C n; "
    "COM2′ = COM2 + w2 C n; λ = − Jv / K; Jv = n·v1 + (r1×n)·ω1 − n·v2 − (r2×n)·ω2; "
    f"{K}; {PUSHED.translate(str.maketrans('j−+', 'λ+−'))}; "
    "n = ( p1 − p2 ) / ‖p1−p2‖; r1 = p1 − COM1; r2 = p2 − COM2",
    Kind.POINT: "depth d at the start of the step; normal n; u·n after the step, > 0 if "
    "approaching; j along n; |f| ≤ μj : result",
}
# What an event did, and why, by its kind or result. Of a vector, the length is shown.
TOLD = {
    Kind.FLIGHT: "Gravity changes the velocity, and the new velocity moves the body.",
    Kind.CONTACT: "The bodies overlap by {d} along n, which points from body 1 to body 2.",
    "the ground": "The body is {d} deep in the ground. n points from body 1 to body 2; the "
    "coursework passes −d and −n, to the same effect.",
    Kind.CORRECTION: "The bodies are moved apart by the depth, {d}, each by its share w.",
    Kind.IMPULSE: "The bodies {before} along n. The impulse changes {changes}.",
    "sticks": "The contact slides at {u·t} along t. Friction stops this, and changes {changes}.",
    "slides": "The contact slides at {u·t} along t. Friction reaches its limit μj, and changes "
    "{changes}.",
    "rests": "The contact does not slide. Friction changes {changes}.",
    "holds": "The distance of the points is within its bound: nothing is corrected.",
    "violated": "The distance of the points is wrong by {C}. They are moved until C = 0, and the "
    "impulse λ changes {changes}.",
    Kind.POINT: "The contact pushes with {F} on average. All points and constraints of a step are "
    "solved together.",
}


def overlap(x, y, size, other):
    """Whether a text of a size at (x, y) overlaps another one: x, y, width, height."""
    a, b, width, height = other
    return -size[0] < x - a < width and -size[1] < y - b < height


def in_words(hint):
    """Returns a hint in the window's words: the coursework's meshes 1 and 2 are bodies here."""
    return re.sub(r"\bmesh(?= [12]\b)", "body", hint)


def formulas(event):
    """Returns the formulas of an event, without those of a body that cannot move, and without the
    corrections of a valid constraint.
    """
    lines = FORMULAS.get(event.kind, "").split("; ")
    if event.given.get("isValid"):
        return lines[:1]
    still = [f"{k}′ = " for k, one in enumerate(event.before, 1) if one.invMass == 0.0]
    return [one for one in lines if one and not any(text in one for text in still)]


def size_of(value, symbol):
    """Returns the length of a symbol's value, 0 if it is rounding, and this as text with a unit."""
    size = float(np.linalg.norm(value))
    size *= size > NOTHING
    return size, measured(size, unit(symbol))


def sentence(event):
    """Returns what an event did, and why."""
    found, key = values(event), event.kind
    lengths = {s: size_of(v, s)[1] for s, v in found.items() if s != "result"}
    changes = [
        f"{name} by {told}"
        for k, state in enumerate(event.before, 1)
        for name in (f"v{k}", f"ω{k}")
        if state.invMass and f"{name}′" in found
        for size, told in [size_of(found[f"{name}′"] - found[name], name)]
        if size
    ]
    lengths["changes"] = ", ".join(changes) or "nothing"
    if key in (Kind.FRICTION, Kind.CONSTRAINT):
        key = found["result"].split()[-1]
        key = "rests" if event.kind == Kind.FRICTION and not size_of(found["u·t"], "")[0] else key
    elif key == Kind.CONTACT and event.bodies[1] == GROUND:
        key = "the ground"
    elif key == Kind.IMPULSE:
        ends = found["u·n"], float(terms(event._replace(before=event.after))["u·n"])
        for name, u in zip(("before", "after"), ends, strict=True):
            size, told = size_of(u, "u·n")
            way = "separate" if u < 0.0 else "approach"
            lengths[name] = f"{way} at {told}" if size else "neither approach nor separate"
        lengths["changes"] += f": now they {lengths['after']}" * bool(changes)
    text = TOLD[key].format_map(lengths)
    isPulled = key == Kind.IMPULSE and found["u·n"] < 0.0 < -found["j"]
    return text + " The coursework applies the impulse whatever the sign of u·n." * isPulled


class Glass:
    """The events of one step in the window.

    events : list of `Event`, or None while closed; place : index of the present one
    skips : whether only contacts and corrected constraints are gone through, if there are any
    height : of the panel in pixels, 0 while closed
    """

    def __init__(self, viewer):
        self.viewer, self.events, self.place, self._moment = viewer, None, 0, None
        self.skips, self.height, self._scrolls, self.hint = True, 0.0, 0, ""

    # Which events.

    def open(self):
        """Finds the events of the last step, or sets a message. Returns whether there are any."""
        viewer, events = self.viewer, []
        viewer.isPlaying, viewer.message = False, ""
        self.follow()
        if self.events is None:
            viewer.message = viewer.history.remake(events.append)
            self.events, self.place = [] if viewer.message else events, -1
            self._moment = viewer.history.now
        return bool(self.events)

    def close(self):
        """Shows the present state again, from where the camera was before the events."""
        self.events = None
        if self.viewer.view.highlight is not None:
            self.viewer.leave_event()
            self.viewer.view.viewpoint.leave_events()

    def follow(self):
        """Closes if something else has changed the present state, or shows it."""
        viewer = self.viewer
        isLeft = self.events and self.place >= 0 and viewer.view.highlight is None
        isOther = viewer.isPlaying or self._moment is not viewer.history.now
        if self.events is not None and (isLeft or isOther):
            self.close()

    def shown(self):
        """Returns the places of the events that are gone through, and the present one."""
        least = [self.skips and e.kind == Kind.FLIGHT for e in self.events]
        lesser = [self.skips and bool(e.given.get("isValid")) for e in self.events]
        isWhole = all(map(max, least, lesser))  # constraints that hold are all that is left
        hidden = [one or other and not isWhole for one, other in zip(least, lesser, strict=True)]
        return [k for k, one in enumerate(hidden) if not one or k == self.place]

    # Which one.

    def go(self, way=1):
        """Goes to the next event, or with way = -1 to the previous one; opens the last step first.

        The first is one of the selected body, if any. From the last event, makes the next step;
        from the first one, goes back by a step.
        """
        isNew = self.events is None
        self.open()
        shown = self.shown() if self.events else []
        ahead = [k for k in shown if self.place < 0 or way * (k - self.place) > 0]
        if not ahead and (way > 0 or not self.viewer.message):
            viewer, history = self.viewer, self.viewer.history
            move = viewer.step_once if way > 0 else viewer.step_back
            move()
            while not (history.now.isStep or viewer.message) and (way > 0 or history.place):
                move()  # past what was done by hand
            ahead = self.shown() if not self.viewer.message and self.open() else []
        if ahead:
            own = [k for k in ahead if self.viewer.view.picked in self.events[k].bodies]
            self.show((own if isNew and own else ahead)[0 if way > 0 else -1])
        elif self.events and not self.viewer.message:
            self.viewer.message = f"Step {self.viewer.simulation.stepCount}: free flights only."

    def _show_largest(self, size):
        if self.open():
            self.show(max(range(len(self.events)), key=lambda place: size(self.events[place])))

    def show_jump(self):
        """Goes back to the last large change of the selected body's velocity, and to its event."""
        viewer, body = self.viewer, self.viewer.view.picked
        place = viewer.history.jump_of(body)
        if place is None:
            viewer.message = f"{viewer.view.picked_mesh.name} has not jumped in the kept steps."
            return
        viewer.seek(place)

        def change(event):
            if body not in event.bodies:
                return -1.0
            if event.kind == Kind.POINT:
                return event.given["impulse"]
            k = event.bodies.index(body)
            return math.dist(event.before[k].linVelocity, event.after[k].linVelocity)

        self._show_largest(change)

    def show_contact(self, number):
        """Goes to the impulse of a contact, by its number in the step."""
        ends = Kind.IMPULSE, Kind.POINT
        self._show_largest(lambda event: event.kind in ends and event.given["contact"] == number)

    def show_difference(self, difference):
        """Goes to the event of a student's `Difference`."""
        if self.viewer.simulation.stepCount != difference.step:
            self.viewer.seek_step(difference.step)
        if self.open():
            self.show(min(difference.place, len(self.events) - 1))

    # What the picture shows.

    def show(self, place):
        """Shows the event at a place, and the bodies as they are after it."""
        self.place, self._scrolls = place, 3  # frames, until all heights are known
        event, view = self.events[place], self.viewer.view
        self.hint = in_words(mistake_in(event, self.events)) if deviations(event) else ""
        poses = poses_of(self.viewer.simulation.meshes)
        for other in reversed(self.events[place + 1 :]):  # back from the end of the step
            for body, state in zip(other.bodies, other.before, strict=True):
                if body >= 0:
                    poses[:, body] = np.concatenate(state[:2])
        bodies = [b for b in event.bodies if b >= 0]
        view.show_event(Highlight(poses, bodies, self._arrows(event)))

    def _arrows(self, event):
        """Returns the arrows of an event: dict of name and (point, arrow in metres, colour).

        Arms are to scale, velocities and moves among themselves; others only have a direction.
        """
        found, longest = values(event), self.viewer.view.overlays.longestArrow
        free = next((k for k, one in enumerate(event.before) if one.invMass), 0)
        points = event.given.get("points", [event.after[0].position] * 2)
        point, arrows, speeds = points[free], {}, {"u": found["u"]} if "u" in found else {}
        if event.kind in (Kind.IMPULSE, Kind.FRICTION):
            speeds["u′"] = values(event._replace(before=event.after))["u"]
        fastest = max(map(np.linalg.norm, speeds.values()), default=0.0) or 1.0
        for name, u in speeds.items():
            if size_of(u, "u")[0]:  # rounding has no direction
                arrow = VELOCITY_SHARE * longest / fastest * u
                arrows[name] = point, arrow, colours.VELOCITY_COLOUR
        for k, end, before, after in zip("12", points, event.before, event.after, strict=False):
            if f"r{k}" in found and before.invMass:
                arrows[f"r{k}"] = end - found[f"r{k}"], found[f"r{k}"], colours.BOX_COLOUR
            move = after.position - before.position
            if event.kind == Kind.CORRECTION and move.any():
                factor = VELOCITY_SHARE * longest / found["d"]
                scale = f"{float(f'{factor:.2g}'):g} ×"
                name = f"COM{k}: {1e3 * math.hypot(*move):.3g} mm, drawn {scale}"
                arrows[name] = before.position, factor * move, colours.VELOCITY_COLOUR
        if "n" in found:
            arrows["n"] = point, longest * found["n"], colours.NORMAL_COLOUR
        for name, along, sign in IMPULSES:
            if along in found and found.get(name):
                push = math.copysign(IMPULSE_SHARE * longest, sign * found[name]) * found[along]
                colour = colours.FRICTION_COLOUR if name == "f" else colours.IMPULSE_COLOUR
                arrows[f"{name} on {free + 1}"] = point, push if free else -push, colour
        return arrows

    # The panels.

    def draw(self, picture):
        """Draws the formula over the lower edge of the picture, a Box."""
        self.follow()
        self.height = 0.0
        if not self.events or self.place < 0:
            return
        event, (left, top, width, height) = self.events[self.place], picture
        corner, least = (left, top + height), 4 * psim.GetTextLineHeightWithSpacing()
        ends = (width, least), (width, MOST_SHARE * height)
        size = width, min(scaled(PANEL_HEIGHT), height / 3)
        with widgets.panel("Event", corner, *ends, "", (0, 1), 0.92, size=size):
            self.height = psim.GetWindowHeight()
            with widgets.child(f"event {self.place}"):
                psim.TextWrapped(self._title(event))
                psim.TextWrapped(sentence(event))
                self._draw_formulas(event)
        self._scrolls -= self._scrolls > 0

    def _title(self, event):
        meshes = self.viewer.simulation.meshes
        if len(event.bodies) < 2:
            return heading(event, meshes)
        what, names = heading(event, meshes).rpartition(" of ")[0], labels(event.bodies, meshes)
        return f"{what}. Body 1: {', body 2: '.join(names)}."

    def draw_labels(self, picture):
        """Names the arrows of the event, if any, beyond their tips, within the picture, a Box."""
        if self.viewer.view.highlight is None:
            return
        view, ink, labels = self.viewer.view, WindowInk(), []
        left, top, width, height = picture
        for name, (point, arrow, _) in view.highlight.arrows.items():
            begin, tip = view.pixels_of([point, point + arrow])
            if not np.isfinite([begin, tip]).all():
                continue
            way = (tip - begin) / max(math.hypot(*(tip - begin)), 1e-9)
            if name in ARMS:  # others begin at their tips
                tip, way = 0.5 * (begin + tip), np.array([way[1], -way[0]])
            size = np.array(psim.CalcTextSize(name))
            # the text's box touches the tip from outside
            x, y = tip + scaled(GAP) * way + 0.5 * size * (way - 1.0)
            x = min(max(x, left), left + width - size[0])
            low, high = top, top + height - self.height - size[1]
            places = [min(max(y + k * size[1], low), high) for k in LINES]
            y = next((y for y in places if not any(map(partial(overlap, x, y, size), labels))), y)
            labels.append((x, y, *size))
            ink.text((x, y), name)

    def _draw_formulas(self, event):
        """Draws the formulas side by side as they fit, each symbol with its value below."""
        width, wrong = psim.GetContentRegionAvail()[0], deviations(event)
        found, ours = values(event), terms(event)
        if wrong:
            texts = [f"{symbol} {shown(ours[symbol], symbol, DIGITS)}" for symbol in wrong]
            with widgets.styled({"Text": WRONG_TEXT}):
                psim.TextWrapped(f"Red: yours. The reference gives {', '.join(texts)}.")
            if self.hint:
                psim.TextWrapped(f"Hint: {self.hint}")
        sought = wrong[0] if wrong and self._scrolls else None
        gap, right, isFirst = scaled(GAP), psim.GetCursorPosX() + width, True
        for formula in formulas(event):
            cells = [self._rows(word, found, word in wrong) for word in formula.split()]
            widths = [max(psim.CalcTextSize(text)[0] for text, _ in rows) for rows in cells]
            whole = sum(widths, gap * len(cells))
            for k, (rows, wide) in enumerate(zip(cells, widths, strict=True)):
                if not isFirst:
                    psim.SameLine(0.0, gap if k else 4 * gap)
                    if psim.GetCursorPosX() + (wide if k else whole) > right:
                        psim.NewLine()
                isFirst = False
                psim.BeginGroup()
                with widgets.styled(sizes={"ItemSpacing": (0.0, 0.0)}):
                    for text, colour in rows:
                        psim.TextColored(colour, text)
                psim.EndGroup()
                if rows[0][0] == sought:
                    psim.SetScrollHereY(1.0)
                    sought = None

    @staticmethod
    def _rows(word, found, isWrong):
        """Returns the rows (text, colour) of a word of a formula: a symbol, its value and unit."""
        rows = [(word, psim.GetStyleColorVec4(psim.ImGuiCol_Text))]
        if word in found:
            value, digits = found[word], FINE_DIGITS if word in FINE else DIGITS
            for one in [value] if isinstance(value, str) else np.ravel(value):
                rows.append((shown(one, digits=digits), WRONG_TEXT if isWrong else NUMBER_TEXT))
            rows += [(unit(word), UNIT_TEXT)] * bool(unit(word))
        return rows

    def draw_list(self):
        """Draws the buttons and the list of the step's events, at the end of the readout.

        With --functions, this begins with where their run first differs from ours.
        """
        self._draw_difference()
        rows = [("Next", self.go, "E: the next event; after the last one, makes the next step")]
        if self.events:
            back = "Shift + E: the previous event, or the last one"
            close = "Escape: back to the bodies after the step, and to where the camera was"
            rows = [("Back", partial(self.go, -1), back), *rows, ("Close", self.close, close)]
        for name, act, tooltip in rows:
            if psim.Button(f"{name}###event {name}"):
                act()
            widgets.tell(tooltip)
            psim.SameLine()
        psim.NewLine()
        tip = "Show contacts and corrected constraints only, no free flights"
        act = partial(setattr, self, "skips")
        widgets.draw_check("skip free flights", self.skips, act, tip)
        if self.events is None:
            return
        if not self.events:
            psim.TextWrapped("No events: this step reported none one by one.")
            return
        least = LEAST_LINES * psim.GetTextLineHeightWithSpacing()
        with widgets.child("events", (0.0, max(psim.GetContentRegionAvail()[1], least))):
            self._draw_rows()
        if self._scrolls:
            psim.SetScrollHereY(1.0)

    def _draw_difference(self):
        """Draws where a student's run first differs: the hint first, then a few of the numbers."""
        if (beside := self.viewer.simulation.beside) is None:
            return
        found, meshes = beside.difference, beside.ours.meshes
        if beside.remark:
            psim.TextWrapped(beside.remark)
        if found is None:
            return psim.TextWrapped("No difference from the reference so far.")
        told = found.lines(meshes, ("the reference", "yours"), FEW_DIGITS)[: 1 + MOST_DIFFERENCES]
        parts = {"Hint": [in_words(found.hint)], f"First difference: step {found.step}": told}
        for title, lines in parts.items():
            if any(lines):
                psim.SeparatorText(title)
                for line in lines:
                    psim.TextWrapped(line)
        if psim.Button("Show the difference"):
            self.show_difference(found)

    def _draw_rows(self):
        places, meshes = self.shown(), self.viewer.simulation.meshes
        before = sum(place < self.place for place in places)
        first = max(0, min(before - MOST_LISTED // 2, len(places) - MOST_LISTED))
        sweeps, counts = [], Counter()  # how often each constraint has been visited so far
        for event in self.events:
            counts[event.given.get("constraint")] += 1
            sweeps.append(counts[event.given.get("constraint")])
        for k in places[first : first + MOST_LISTED]:
            event = self.events[k]
            sweep = f", sweep {sweeps[k]}" * (event.kind == Kind.CONSTRAINT)
            line = heading(event, meshes, f"{sweep}\n  " if len(event.bodies) > 1 else ": ", ", ")
            if event.kind in CONTACT_PARTS:
                line = f"    {event.kind}"
            if psim.Selectable(f"{line}###event {k}", k == self.place):
                self.show(k)
            widgets.tell(heading(event, meshes))
            if k == self.place and self._scrolls:
                psim.SetScrollHereY()

    def draw_contacts(self):
        """Draws the selected body's largest contacts, for the readout: a click shows one."""
        viewer, report = self.viewer, self.viewer.simulation.report
        if psim.Button("Why did it jump?"):
            self.show_jump()
        widgets.tell("Goes back to the last large change of its velocity, and shows the event")
        picked, meshes = viewer.view.picked, viewer.simulation.meshes
        contacts = enumerate(() if report is None else report.contacts, 1)
        own = [(number, c) for number, c in contacts if picked in (c.body1, c.body2)]
        own.sort(key=lambda row: -abs(row[1].impulse))
        psim.TextDisabled(counted(len(own), "contact"))
        for number, one in own[:LISTED_CONTACTS]:
            (name,) = labels([one.body2 if one.body1 == picked else one.body1], meshes)
            row = f"{measured(one.impulse, 'N s')}: {name}"
            if psim.Selectable(f"{row}###contact {number}"):
                self.show_contact(number)
            widgets.tell(f"Normal impulse, {row}")
