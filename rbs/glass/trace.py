"""The events of a step as a table of text, and the first difference between two steps."""

import math
from itertools import zip_longest
from typing import NamedTuple

import numpy as np

from rbs.glass.events import CONTACT_PARTS, Event
from rbs.glass.terms import terms, unit, values
from rbs.stepping.meshes import STATE_WIDTHS
from rbs.stepping.reports import GROUND

# Significant digits of a number; and largest number that is shown as 0, because it is rounding:
# absolute, and relative to the largest of a vector.
DIGITS, NOTHING, RELATIVE_NOTHING = 9, 1e-14, 1e-12
# Largest difference of numbers that agree, absolute and relative, in the scene's units.
TOLERANCE = 1e-9


def heading(event, meshes, of=" of ", joint=" and "):
    """Returns the line of an event: its kind, its contact or constraint, and its bodies."""
    number = event.given.get("contact", event.given.get("constraint"))
    what = event.kind if number is None else f"{event.kind} {number}"
    if event.kind in CONTACT_PARTS:
        what = f"contact {number}: {event.kind}"
    names = ["the ground" if b == GROUND else meshes[b].name for b in event.bodies]
    return f"{what}{of}{joint.join(names)}"


def shown(value, symbol="", digits=DIGITS):
    """Returns a value of `terms` as text, with the unit of its symbol."""
    if isinstance(value, str):
        return value
    numbers = np.array(value, dtype=np.float64).ravel()
    size = np.abs(numbers)
    numbers[size <= max(NOTHING, RELATIVE_NOTHING * size.max())] = 0.0
    text = ", ".join(f"{number:.{digits}g}" for number in numbers.tolist())
    return f"{text if len(numbers) == 1 else f'({text})'} {unit(symbol)}".rstrip()


def trace_lines(events, meshes, body=None):
    """Returns the table of a step's events as lines: headings, and the symbols of each.

    body : only the events of this one, by index
    """
    lines = []
    for number, event in enumerate(events, 1):
        if body is None or body in event.bodies:
            lines.append(f"{number:4} {heading(event, meshes)}")
            for symbol, value in values(event).items():
                lines.append(f"       {symbol:<22} {shown(value, symbol)}")
    return lines


def differs(ours, theirs):
    """Whether two values of a symbol differ by more than rounding."""
    return ours != theirs if isinstance(ours, str) else gap(ours, theirs) > TOLERANCE


def gap(ours, theirs, least=1.0):
    """The largest difference of numbers, relative to the largest of ours, or to `least`; infinite
    if theirs are no such numbers.
    """
    ours = np.ravel(np.array(ours, np.float64))
    try:
        theirs = np.array(theirs, np.float64).reshape(ours.shape)
    except (TypeError, ValueError):
        return math.inf
    found = float(
        np.abs(theirs - ours).max(initial=0.0) / max(least, np.abs(ours).max(initial=0.0))
    )
    return math.inf if math.isnan(found) else found


def state_gaps(pairs):
    """Yields (gap, mesh, name, row) for our meshes and the rows of others, in pairs."""
    for mesh, rows in pairs:
        for name, row in zip(STATE_WIDTHS, rows, strict=True):
            own = np.ravel(getattr(mesh, name))
            isTurn = name == "orientation"  # q and -q are the same
            found = min(gap(own, row), gap(-own, row)) if isTurn else gap(own, row)
            yield found, mesh, name, row


def both(ours, theirs):
    """A text with both values of a quantity that differs."""
    rows = [shown(np.ravel(np.array(one, float))[:4], digits=5) for one in (ours, theirs)]
    return f" is {rows[0]} in ours, {rows[1]} in theirs"


def deviations(event, own=None):
    """Returns the symbols whose values differ from those of our formula, by what the call did.

    own : our event, from the same start; by default, the formula is that of the event itself

    If the states after an event agree, there are none: a small impulse and its K are rounding.
    """
    ours, theirs = terms(own or event), values(event)
    found = [s for s, value in ours.items() if s not in theirs or differs(value, theirs[s])]
    tellsStates = any("′" in symbol for symbol in ours)
    return found if not tellsStates or any("′" in symbol for symbol in found) else []


class Difference(NamedTuple):
    """Where two steps from the same start first differ.

    own, other : our event and theirs, None if there are no more
    symbols : in which the effects on the bodies differ; [] if the events are not the same, or begin
        with other states, as the text says
    """

    own: Event
    other: Event
    symbols: list = []
    text: str = ""

    def lines(self, meshes):
        names = [heading(one, meshes) if one else "the end" for one in self[:2]]
        if self.symbols:
            return [names[0], *term_lines(self.own, self.other, showsAll=False)]
        return [self.text or f"{names[0]} in ours, {names[1]} in theirs"]


def first_difference(ours, theirs, meshes):
    """Returns the `Difference` of two lists of events from the same start, or None."""
    for own, other in zip_longest(ours, theirs):
        if not (own and other) or (own.kind, own.bodies) != (other.kind, other.bodies):
            return Difference(own, other)
        for one, its, body in zip(own.before, other.before, own.bodies, strict=True):
            for name in STATE_WIDTHS:
                pair = getattr(one, name), getattr(its, name)
                if differs(*pair):
                    label = "the ground" if body == GROUND else meshes[body].name
                    text = f"{name} of {label} before {heading(own, meshes)}{both(*pair)}"
                    return Difference(own, other, text=text)
        if wrong := deviations(other, own):
            return Difference(own, other, wrong)
    return None


def term_lines(own, other, showsAll=True):
    """Returns lines with the terms of our formula for an event, or only those that differ."""
    others, lines, wrong = values(other), [], deviations(other, own)
    wrong = [symbol for symbol in wrong if symbol in others] or wrong
    for symbol, value in terms(own).items():
        line = f"{f'  {symbol:<22}' if showsAll else symbol} {shown(value, symbol)}"
        if symbol in wrong:
            line += f" in ours, {shown(others.get(symbol, '?'), symbol)} in theirs"
        lines += [line] * (showsAll or symbol in wrong)
    return lines
