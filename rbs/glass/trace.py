"""The events of a step as a table of text, and the first difference between two steps."""

import numpy as np

from rbs.glass.events import CONTACT_PARTS, Kind
from rbs.glass.terms import terms, unit, values
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
    if isinstance(ours, str):
        return ours != theirs
    gap = np.max(np.abs(np.subtract(theirs, ours)))
    return not gap <= TOLERANCE * max(1.0, np.max(np.abs(ours)))


def deviations(event, own=None):
    """Returns the symbols whose values differ from those of our formula, by what the call did.

    own : our event, from the same start; by default, the formula is that of the event itself

    If the states after an event agree, there are none: a small impulse and its K are rounding.
    """
    ours, theirs = terms(own or event), values(event)
    found = [s for s, value in ours.items() if s not in theirs or differs(value, theirs[s])]
    tellsStates = any("′" in symbol for symbol in ours)
    return found if not tellsStates or any("′" in symbol for symbol in found) else []


def first_difference(ours, theirs, meshes):
    """Returns lines on the first event in which two lists from the same start differ, and on the
    quantities in which its effects on the bodies differ; or []. With it, their event if it is the
    same as ours but for these, or None.
    """
    pairs = ([e for e in events if e.kind != Kind.BOXES] for events in (ours, theirs))
    for own, other in zip(*pairs, strict=False):
        what = heading(own, meshes)
        if (own.kind, own.bodies) != (other.kind, other.bodies):
            return [f"{what} in ours, {heading(other, meshes)} in theirs"], None
        if deviations(other, own):
            return [what, *term_lines(own, other, showsAll=False)], other
    return [], None


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
