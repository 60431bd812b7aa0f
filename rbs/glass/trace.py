"""The events of a step as a table of text, and the first difference between two steps."""

import math
import sys
from itertools import zip_longest
from typing import NamedTuple

import numpy as np

from rbs.glass.events import CONTACT_PARTS, KEPT, Event
from rbs.glass.terms import terms, unit, values
from rbs.stepping.meshes import LARGEST_NUMBER, STATE_WIDTHS
from rbs.stepping.reports import GROUND

# Significant digits of a number; and largest number that is shown as 0, because it is rounding:
# absolute, and relative to the largest of a vector.
DIGITS, NOTHING, RELATIVE_NOTHING = 9, 1e-14, 1e-12
# Largest difference of numbers that agree, absolute and relative, in the scene's units.
TOLERANCE = 1e-9
# What two steps are called.
OURS_AND_THEIRS = "ours", "theirs"


def heading(event, meshes, of=" of ", joint=" and "):
    """Returns the line of an event: its kind, its contact or constraint, and its bodies."""
    number = event.given.get("contact", event.given.get("constraint"))
    what = event.kind if number is None else f"{event.kind} {number}"
    if event.kind in CONTACT_PARTS:
        what = f"contact {number}: {event.kind}"
    return f"{what}{of}{joint.join(labels(event.bodies, meshes))}"


def labels(bodies, meshes):
    """Returns the names of bodies, given by index."""
    return ["the ground" if b == GROUND else meshes[b].name for b in bodies]


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
            lines += [f"       {s:<22} {shown(v, s)}" for s, v in values(event).items()]
    return lines


def differs(ours, theirs):
    """Whether two values of a symbol differ by more than rounding."""
    return ours != theirs if isinstance(ours, str) else gap(ours, theirs) > TOLERANCE


def gap(ours, theirs, least=1.0):
    """The largest difference relative to ours, or `least`; infinite if theirs are no numbers."""
    ours = np.ravel(np.array(ours, np.float64))
    try:
        theirs = np.array(theirs, np.float64).reshape(ours.shape)
    except (TypeError, ValueError):
        return math.inf
    size = max(least, np.abs(ours).max(initial=0.0))
    found = float(np.abs(theirs - ours).max(initial=0.0) / size)
    return math.inf if math.isnan(found) else found


def same(value, tensor):
    """Whether a value holds a tensor's numbers, but for rounding."""
    return gap(tensor, value, least=sys.float_info.min) <= TOLERANCE


class StateGap(NamedTuple):
    """How far an attribute of a body is apart in ours and in theirs. gap : see `gap`"""

    gap: float
    name: str
    body: str
    ours: np.ndarray
    theirs: np.ndarray

    def told(self, when="", names=OURS_AND_THEIRS):
        """Returns it as text. when : where in the step; names : of both steps"""
        return f"{self.name} of {self.body}{when}{both(self.ours, self.theirs, names)}"


def state_gaps(states, others, names, attributes=tuple(STATE_WIDTHS)):
    """Yields the `StateGap`s of our meshes or `BodyState`s and rows of others.

    names : of bodies; attributes : names of what the rows hold
    """
    for state, rows, body in zip(states, others, names, strict=True):
        for name, row in zip(attributes, rows, strict=True):
            own = getattr(state, name)
            found = gap(own, row, 1.0 if name in STATE_WIDTHS else 1.0 / LARGEST_NUMBER)
            if name == "orientation":  # q and -q are the same
                found = min(found, gap(-own, row))
            yield StateGap(found, name, body, own, row)


def state_difference(states, others, names, attributes=(*KEPT, *STATE_WIDTHS)):
    """Returns where our meshes or `BodyState`s and others first differ, a `StateGap`, or None."""
    rows = ([getattr(one, name) for name in attributes] for one in others)
    gaps = state_gaps(states, rows, names, attributes)
    return next((found for found in gaps if found.gap > TOLERANCE), None)


def both(ours, theirs, names=OURS_AND_THEIRS):
    """A text with both values of a quantity that differs."""
    rows = [
        str(one) if isinstance(one, bool) else shown(np.ravel(np.array(one, float))[:9], digits=5)
        for one in (ours, theirs)
    ]
    return f" is {rows[0]} in {names[0]}, {rows[1]} in {names[1]}"


def deviations(event, own=None):
    """Returns the symbols for which the effect of the call differs from our formula.

    own : our event, from the same start; by default, the formula is that of the event itself

    If the states after an event agree, there are none: a small impulse and its K are rounding. If
    only one of the two found a bound violated, they share few symbols, and the result differs.
    """
    ours, theirs = terms(own or event), values(event)
    found = [s for s, value in ours.items() if s in theirs and differs(value, theirs[s])]
    tellsStates = any("′" in symbol for symbol in ours) and ours.keys() == theirs.keys()
    return found if not tellsStates or any("′" in symbol for symbol in found) else []


class Difference(NamedTuple):
    """Where two steps from the same start first differ.

    own, other : our event and theirs, None if there are no more
    symbols : in which the effects on the bodies differ; [] if the events are not the same
    state : the `StateGap` with which they begin, or end if it is of KEPT; without events, with
        which the steps end
    place : of the event in its step
    step : number of the step; hint : the mistake that explains it, or ""
    """

    own: Event
    other: Event
    symbols: list = []
    state: StateGap = None
    place: int = 0
    step: int = 0
    hint: str = ""

    def lines(self, meshes, names=OURS_AND_THEIRS, digits=DIGITS):
        """Returns lines that tell it. names : of both steps; digits : of numbers"""
        heads = [heading(one, meshes) if one else "the end" for one in self[:2]]
        if self.symbols:
            return [heads[0], *term_lines(self.own, self.other, False, names, digits)]
        if self.state is not None:
            when = f" {'after' if self.state.name in KEPT else 'before'} {heads[0]}"
            return [self.state.told(when if self.own else " at the end of the step", names)]
        return [f"{heads[0]} in {names[0]}, {heads[1]} in {names[1]}"]


def first_difference(ours, theirs, meshes):
    """Returns the `Difference` of two lists of events from the same start, or None."""
    for place, (own, other) in enumerate(zip_longest(ours, theirs)):
        if not (own and other) or (own.kind, own.bodies) != (other.kind, other.bodies):
            return Difference(own, other, place=place)
        bodies = labels(own.bodies, meshes)
        state = state_difference(own.before, other.before, bodies, tuple(STATE_WIDTHS))
        state = state or state_difference(own.after, other.after, bodies, KEPT)
        if state is not None:
            return Difference(own, other, [], state, place)
        if wrong := deviations(other, own):
            return Difference(own, other, wrong, None, place)
    return None


def term_lines(own, other, showsAll=True, names=OURS_AND_THEIRS, digits=DIGITS):
    """Returns lines with the terms of our formula for an event, or only those that differ."""
    others, lines, wrong = values(other), [], deviations(other, own)
    for symbol, value in terms(own).items():
        line = f"{f'  {symbol:<22}' if showsAll else symbol} {shown(value, symbol, digits)}"
        if symbol in wrong:
            found = shown(others.get(symbol, "?"), symbol, digits)
            line += f" in {names[0]}, {found} in {names[1]}"
        lines += [line] * (showsAll or symbol in wrong)
    return lines
